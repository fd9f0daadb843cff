"""Rheological line elements with history: Voigt, Maxwell, three elements, and a slider.

All are one chain: a Voigt element (spring k beside a damper b) in series with a dashpot c that
flows only while the force in it exceeds a limit B. Tension and elongation are positive.

    e = e_v + e_d,   f = k e_v + b e_v',   e_d' = 0 while |f| <= B, else f = c e_d'

Source: Y. Sugiyama, S. Hirai, Crawling and jumping of deformable soft robot, Proc. IEEE/RSJ Int.
Conf. Intelligent Robots and Systems (2004), equations 1 to 4; forces there are those *of* the
element, of opposite sign. Between standing and flowing the law jumps, and a slider at the limit
lies between them: `materials.rheology_kernels` says how, and solves each step exactly.

Left open by the source is whether the flow answers the whole force or only what exceeds the limit:
`flow` of `ThreeElementSlider`. Leaves out: slack (a wire or a coil that cannot push), large
strains, and any dependence on temperature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from flexapod.core.errors import InputError, check_finite, check_positive
from flexapod.materials import rheology_kernels as kernels

FLOWS = ("full", "excess")

Packed = tuple[float, float, float, float, int]


@dataclass(frozen=True)
class Response:
    """What an element did over time; arrays of shape (n,), read-only."""

    times: np.ndarray  # [s]
    elongation: np.ndarray  # of the whole [m]
    voigt: np.ndarray  # elongation of the Voigt part [m]
    force: np.ndarray  # tension [N]
    work: np.ndarray  # done on the element since the first time [J]
    dissipated: np.ndarray  # since the first time [J]

    def __post_init__(self) -> None:
        for array in vars(self).values():
            array.flags.writeable = False

    @property
    def flowed(self) -> np.ndarray:
        """Elongation of the dashpot in series [m], shape (n,)."""
        return np.asarray(self.elongation - self.voigt)


class Element:
    """What every rheological element offers; `packed` is all that tells them apart."""

    def packed(self) -> Packed:
        """Numbers for `rheology_kernels.advance`: k, b, c, B and whether the excess flows."""
        raise NotImplementedError

    def drive(
        self, times: ArrayLike, elongations: ArrayLike, voigt: float | None = None
    ) -> Response:
        """Stretch the element to `elongations` at `times`, straight in between.

        Exact for any spacing of times. A damper's force jumps where the rate does: `force` is that
        at the end of each interval, and at the first time that of the first rate.

        Parameters
        ----------
        times
            [s], ascending, shape (n,), n >= 2.
        elongations
            Of the whole element [m], shape (n,).
        voigt
            Elongation of the Voigt part at the first time [m]; all of it unless given.
        """
        t = _times(times)
        e = _values("elongations", elongations, t)
        start = float(e[0]) if voigt is None else check_finite("voigt", voigt, "m", "drive")
        return self._driven(t, e, start)

    def relaxation(self, elongation: float, times: ArrayLike) -> Response:
        """Stretch the element by `elongation` [m] all at once at the first time and hold it.

        In a step damper and dashpot share the infinite force, so the Voigt part gets c/(b + c) of
        it, whatever the limit. Work and dissipation (infinite with a damper) are counted from
        after the step.
        """
        t = _times(times)
        check_finite("elongation", elongation, "m", "relaxation")
        _, b, c, limit, _ = self.packed()
        share = 1.0 if math.isinf(c) or math.isinf(limit) else c / (b + c)
        return self._driven(t, np.full(t.shape, float(elongation)), share * elongation)

    def creep(self, force: ArrayLike, times: ArrayLike) -> Response:
        """Load the element, at rest with no elongation, with a given force.

        At the very limit the dashpot stands still (the law leaves its rate open there). Without a
        damper the spring answers at once, in the values of that very time; as the limit of ever
        weaker damping, half the work of such a jump is dissipated.

        Parameters
        ----------
        force
            Tension [N]; one number, or shape (n,), each held until the next time.
        times
            [s], ascending, shape (n,), n >= 2.
        """
        t = _times(times)
        f = np.broadcast_to(np.asarray(force, dtype=float), t.shape).copy()
        if not np.isfinite(f).all():
            raise InputError("force must be finite", "creep")
        k, b, c, limit, excess = self.packed()
        voigt, flowed, dissipated, work = (np.zeros(t.shape) for _ in range(4))
        for i in range(t.size):
            v, loss, flow = 0.0, 0.0, 0.0
            if i > 0:
                dt = t[i] - t[i - 1]
                pull = f[i - 1]
                v, loss = _voigt_creep(k, b, voigt[i - 1], pull, dt)
                if abs(pull) > limit and not math.isinf(c):
                    flow = (pull - excess * math.copysign(limit, pull)) / c * dt
                loss += pull * flow
                flowed[i] = flowed[i - 1] + flow
                work[i] = work[i - 1] + pull * (v - voigt[i - 1] + flow)
                dissipated[i] = dissipated[i - 1] + loss
            if b == 0.0:
                jump = f[i] / k - v
                work[i] += f[i] * jump
                dissipated[i] += 0.5 * k * jump * jump
                v = f[i] / k
            voigt[i] = v
        return Response(t, voigt + flowed, voigt, f, work, dissipated)

    def _driven(self, t: np.ndarray, e: np.ndarray, start: float) -> Response:
        voigt, force, work, dissipated = (np.empty(t.shape) for _ in range(4))
        voigt[0] = start
        kernels.drive(*self.packed(), t, e, voigt, force, work, dissipated)
        return Response(t, e, voigt, force, work, dissipated)


@dataclass(frozen=True)
class Voigt(Element):
    """Spring beside a damper: ``f = k e + b e'``. A stiffness or damping of zero leaves it out."""

    stiffness: float  # k [N/m], >= 0
    damping: float  # b [N s/m], >= 0

    def __post_init__(self) -> None:
        _check_voigt(self.stiffness, self.damping, "voigt")

    def packed(self) -> Packed:
        """See `Element`."""
        return float(self.stiffness), float(self.damping), math.inf, math.inf, 0


@dataclass(frozen=True)
class Maxwell(Element):
    """Spring in series with a dashpot: ``e' = f'/k + f/c``."""

    stiffness: float  # k [N/m], > 0
    flow_damping: float  # c [N s/m], > 0

    def __post_init__(self) -> None:
        check_positive("stiffness", self.stiffness, "N/m", "maxwell")
        check_positive("flow_damping", self.flow_damping, "N s/m", "maxwell")

    def packed(self) -> Packed:
        """See `Element`."""
        return float(self.stiffness), 0.0, float(self.flow_damping), 0.0, 0


@dataclass(frozen=True)
class ThreeElement(Element):
    """Voigt element in series with a dashpot (figure 4a of the source): it creeps for ever."""

    stiffness: float  # k [N/m], >= 0
    damping: float  # b [N s/m], >= 0
    flow_damping: float  # c [N s/m], > 0; infinite: a Voigt element

    def __post_init__(self) -> None:
        _check_voigt(self.stiffness, self.damping, "three-element")
        _check_not_nan("flow_damping", self.flow_damping, "N s/m", "three-element", zero=False)

    def packed(self) -> Packed:
        """See `Element`."""
        return float(self.stiffness), float(self.damping), float(self.flow_damping), 0.0, 0


@dataclass(frozen=True)
class ThreeElementSlider(Element):
    """Voigt element in series with a dashpot that flows beyond a limit (figure 4b of the source).

    Attributes
    ----------
    stiffness, damping
        k [N/m] and b [N s/m] of the Voigt element, >= 0, not both zero.
    flow_damping
        c [N s/m] > 0; infinite: it never flows.
    limit
        B [N] >= 0; infinite: it never flows.
    flow
        "full": beyond the limit ``f = c e_d'``, as equation 4 has it, so the force drops to the
        limit at most while the dashpot starts to move. "excess": ``f = B + c e_d'`` (Bingham),
        which has no jump; for those who take the slider to be a friction beside the dashpot.
    """

    stiffness: float
    damping: float
    flow_damping: float
    limit: float
    flow: str = "full"

    def __post_init__(self) -> None:
        where = "three-element slider"
        _check_voigt(self.stiffness, self.damping, where)
        _check_not_nan("flow_damping", self.flow_damping, "N s/m", where, zero=False)
        _check_not_nan("limit", self.limit, "N", where, zero=True)
        if self.flow not in FLOWS:
            raise InputError(f'flow must be one of {", ".join(FLOWS)}; got "{self.flow}"', where)

    def packed(self) -> Packed:
        """See `Element`."""
        return (
            float(self.stiffness),
            float(self.damping),
            float(self.flow_damping),
            float(self.limit),
            int(self.flow == "excess"),
        )


def _voigt_creep(k: float, b: float, v: float, force: float, dt: float) -> tuple[float, float]:
    """Elongation [m] of a Voigt element after `dt` under `force`, and its dissipation [J]."""
    if b == 0.0:
        return force / k, 0.0  # the jump was made when the force came
    speed = (force - k * v) / b
    decay = k / b
    if decay == 0.0:
        return v + speed * dt, b * speed * speed * dt
    return (
        v - speed * math.expm1(-decay * dt) / decay,
        -b * speed * speed * math.expm1(-2.0 * decay * dt) / (2.0 * decay),
    )


def _check_voigt(stiffness: float, damping: float, where: str) -> None:
    for name, value, unit in (("stiffness", stiffness, "N/m"), ("damping", damping, "N s/m")):
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"{name} must be finite and >= 0, got {value:g} {unit}", where)
    if stiffness == 0.0 and damping == 0.0:
        raise InputError(
            "stiffness and damping are both 0, so it could bear no force: give one of them", where
        )


def _check_not_nan(name: str, value: float, unit: str, where: str, zero: bool) -> None:
    """Refuse what is no number and what is below zero; infinity is fine."""
    if not (value > 0.0 or (zero and value == 0.0)):
        raise InputError(
            f"{name} must be {'>=' if zero else '>'} 0 (infinite: no flow), got {value:g} {unit}",
            where,
        )


def _times(times: ArrayLike) -> np.ndarray:
    t = np.array(times, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise InputError(f"times must be a list of two or more, got shape {t.shape}", "rheology")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise InputError("times must be finite and ascending", "rheology")
    return t


def _values(name: str, values: ArrayLike, t: np.ndarray) -> np.ndarray:
    array = np.array(values, dtype=float)
    if array.shape != t.shape:
        raise InputError(f"{name} {array.shape} and times {t.shape} must have one length", "drive")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite", "drive")
    return array
