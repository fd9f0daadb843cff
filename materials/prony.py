"""Linear viscoelasticity by a Prony series, and its fit to a stress-relaxation record.

The hyperelastic law is the *long-term* law. Branch i adds `moduli[i]` times the law's isochoric
stress at once and forgets it with the time constant `times[i]`, so that after a step the
isochoric stress is the law's times the relaxation function

    g(t) = 1 + sum_i g_i exp(-t/tau_i)

The volumetric part stays elastic. Finite strain: J. C. Simo, Comput. Methods Appl. Mech. Eng. 60
(1987) 153, doi:10.1016/0045-7825(87)90107-1. Recurrence in time: R. L. Taylor, K. S. Pister,
G. L. Goudreau, Int. J. Numer. Methods Eng. 2 (1970) 45, doi:10.1002/nme.1620020106.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares, nnls

from flexapod.core.errors import InputError, check_positive

SPACINGS = ("fitted", "log-spaced")

_WHERE = "prony"
_STARTS = 4  # sets of time constants that are polished
_MOST_SETS = 3000  # tried before polishing
# Branches weaker than this part of the whole, or closer in time, are one branch.
_WEAK = 1e-8
_SAME_TIME = 1e-3


@dataclass(frozen=True)
class Prony:
    """Branches of a relaxation function ``1 + sum_i g_i exp(-t/tau_i)``.

    Convention: `moduli` are fractions of the **long-term** modulus, which the hyperelastic law
    gives; they may exceed 1. Abaqus and others state fractions of the instantaneous modulus:
    convert with `from_normalised` and `to_normalised`.

    Range: isochoric stress of materials whose relaxation does not depend on the strain. Leaves
    out temperature, damage (Mullins) and relaxation of the volume.
    """

    moduli: tuple[float, ...]  # g_i [-], > 0
    times: tuple[float, ...]  # tau_i [s], > 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "moduli", tuple(float(v) for v in self.moduli))
        object.__setattr__(self, "times", tuple(float(v) for v in self.times))
        if len(self.moduli) != len(self.times) or not self.moduli:
            raise InputError(
                "needs as many moduli as times and at least one of each, got "
                f"{len(self.moduli)} moduli and {len(self.times)} times",
                _WHERE,
            )
        for i, (modulus, time) in enumerate(zip(self.moduli, self.times, strict=True), start=1):
            check_positive(f"moduli[{i}]", modulus, "", _WHERE)
            check_positive(f"times[{i}]", time, "s", _WHERE)

    @property
    def instantaneous(self) -> float:
        """Instantaneous over long-term modulus ``1 + sum_i g_i`` [-]."""
        return 1.0 + math.fsum(self.moduli)

    @classmethod
    def from_normalised(cls, moduli: Sequence[float], times: Sequence[float]) -> Prony:
        """Take fractions of the instantaneous modulus (Abaqus ``*VISCOELASTIC, TIME=PRONY``).

        There ``g(t) = 1 - sum_i k_i (1 - exp(-t/tau_i))`` times the instantaneous modulus, so
        ``g_i = k_i / (1 - sum k)``. A hyperelastic law stated for the instant has to be divided
        by `instantaneous` too.
        """
        rest = 1.0 - math.fsum(moduli)
        if not rest > 0.0:
            raise InputError(
                "fractions of the instantaneous modulus must add up to less than 1, got "
                f"{math.fsum(moduli):g}: nothing is left for the long-term law",
                _WHERE,
            )
        return cls(tuple(k / rest for k in moduli), tuple(times))

    def to_normalised(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return fractions of the instantaneous modulus and the times [s]."""
        whole = self.instantaneous
        return tuple(g / whole for g in self.moduli), self.times

    def relaxation(self, t: ArrayLike) -> np.ndarray:
        """Relaxation function [-] at times `t` >= 0 [s] after a step, shape of `t`."""
        t = np.asarray(t, dtype=float)
        if not (t >= 0.0).all():
            raise InputError("times after the step must be >= 0", _WHERE)
        decay = np.exp(-t[..., None] / np.array(self.times))
        return np.asarray(1.0 + decay @ np.array(self.moduli))

    def storage_loss(self, omega: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Storage and loss modulus over the long-term modulus [-] at `omega` >= 0 [rad/s].

        ``1 + sum_i g_i x_i**2/(1 + x_i**2)`` and ``sum_i g_i x_i/(1 + x_i**2)`` with
        ``x_i = omega tau_i``.
        """
        omega = np.asarray(omega, dtype=float)
        if not (omega >= 0.0).all():
            raise InputError("angular frequencies must be >= 0", _WHERE)
        x = omega[..., None] * np.array(self.times)
        share = 1.0 / (1.0 + x * x)
        g = np.array(self.moduli)
        return np.asarray(1.0 + (1.0 - share) @ g), np.asarray((x * share) @ g)


@dataclass(frozen=True)
class PronyFit:
    """A fitted series and how well it follows the record."""

    prony: Prony  # in ascending times; fewer branches than asked where the record shows fewer
    long_term: float  # fitted value after all time, in the record's unit
    r_squared: float
    rms_relative_error: float
    point_count: int


def fit_prony(
    times: ArrayLike, values: ArrayLike, terms: int = 3, spacing: str = "fitted"
) -> PronyFit:
    """Fit a series to a stress-relaxation record.

    Least squares of ``c_0 + sum_i c_i exp(-t/tau_i)`` with every c >= 0 (nonnegative least
    squares), then ``g_i = c_i/c_0``. The strain is taken as a step at t = 0: leave out what was
    read during the ramp and some ten times its length. Every point weighs the same, so an evenly
    sampled record is fitted best at its long times. The result is the same at every call.

    Parameters
    ----------
    times
        Since the step [s], ascending, shape (n,).
    values
        Stress or modulus at constant strain, in any unit, shape (n,); all of one sign.
    terms
        Number of branches.
    spacing
        "fitted": the time constants are unknowns too, sought between the first time above zero
        and the last (others look like a step or a plateau). "log-spaced": they are spread evenly
        over that range on a logarithmic scale, each in the middle of its share.
    """
    t, y, sign = _record(times, values, terms, spacing)
    first, last = float(t[t > 0.0][0]), float(t[-1])
    if spacing == "fitted":
        tau = _fitted_times(t, y, terms, first, last)
    else:
        tau = _spread(first, last, terms)
    c = _weights(t, y, tau)
    model = _columns(t, tau) @ c
    long_term, moduli, kept = _merged(c, tau)
    if not long_term > _WEAK:
        raise InputError(
            "the record still falls towards zero at its end, so it shows no long-term modulus: "
            "record for longer, or ask for fewer terms",
            _WHERE,
        )
    if not moduli:
        raise InputError("the record does not relax: there is nothing to fit", _WHERE)
    residual = y - model
    spread = float(np.sum((y - y.mean()) ** 2))
    return PronyFit(
        prony=Prony(tuple(m / long_term for m in moduli), tuple(kept)),
        long_term=sign * long_term,
        r_squared=1.0 - float(np.sum(residual**2)) / spread,
        rms_relative_error=float(np.sqrt(np.mean((residual / y) ** 2))),
        point_count=t.size,
    )


def _record(
    times: ArrayLike, values: ArrayLike, terms: int, spacing: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """Checked times and absolute values, and their scale with its sign."""
    t = np.asarray(times, dtype=float)
    y = np.asarray(values, dtype=float)
    if spacing not in SPACINGS:
        raise InputError(f'spacing must be one of {", ".join(SPACINGS)}; got "{spacing}"', _WHERE)
    if terms < 1:
        raise InputError(f"terms must be >= 1, got {terms}", _WHERE)
    if t.ndim != 1 or t.shape != y.shape:
        raise InputError(f"times {t.shape} and values {y.shape} must have one length", _WHERE)
    unknowns = 2 * terms + 1 if spacing == "fitted" else terms + 1
    if t.size <= unknowns:
        raise InputError(f"{terms} terms need more than {unknowns} points, got {t.size}", _WHERE)
    if not (np.isfinite(t).all() and t[0] >= 0.0 and (np.diff(t) > 0.0).all()):
        raise InputError("times must be finite, >= 0 and ascending", _WHERE)
    if not np.isfinite(y).all() or not ((y > 0.0).all() or (y < 0.0).all()):
        raise InputError("values must be finite, not zero and of one sign", _WHERE)
    scale = float(np.abs(y).max())
    return t, np.abs(y) / scale, math.copysign(scale, y[0])


def _columns(t: np.ndarray, tau: np.ndarray) -> np.ndarray:
    return np.concatenate([np.ones((t.size, 1)), np.exp(-t[:, None] / tau)], axis=1)


def _triangle(t: np.ndarray, y: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """The triangle of a QR: same residuals as the long record, and nnls is quick on it."""
    return np.asarray(np.linalg.qr(np.column_stack([_columns(t, tau), y]), mode="r"))


def _weights(t: np.ndarray, y: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Nonnegative c_0 and c_i of the least residual."""
    r = _triangle(t, y, tau)
    return np.asarray(nnls(r[:, :-1], r[:, -1])[0])


def _spread(first: float, last: float, count: int) -> np.ndarray:
    share = (np.arange(count) + 0.5) / count
    return np.asarray(first * (last / first) ** share)


def _fitted_times(
    t: np.ndarray, y: np.ndarray, terms: int, first: float, last: float
) -> np.ndarray:
    """Best time constants: every set from a grid, then the best few polished."""
    grid_count = terms + 1
    while grid_count < 24 and math.comb(grid_count + 1, terms) <= _MOST_SETS:
        grid_count += 1
    grid = _spread(first, last, grid_count)
    # One QR serves all sets, for a set's columns of the triangle keep their residual.
    r = _triangle(t, y, grid)
    tried = []
    for chosen in itertools.combinations(range(grid_count), terms):
        columns = [0, *(k + 1 for k in chosen)]
        tried.append((nnls(r[:, columns], r[:, -1])[1], chosen))
    tried.sort()

    def residual(x: np.ndarray) -> np.ndarray:
        tau = np.exp(x)
        return np.asarray(_columns(t, tau) @ _weights(t, y, tau) - y)

    def jacobian(x: np.ndarray) -> np.ndarray:
        # Variable projection with Kaufman's Jacobian (doi:10.1007/BF01932995): what the time
        # constants change and the weights cannot make good.
        tau = np.exp(x)
        columns, c = _columns(t, tau), _weights(t, y, tau)
        change = columns[:, 1:] * (t[:, None] / tau) * c[1:]
        q = np.linalg.qr(columns[:, c > 0.0])[0]
        return np.asarray(change - q @ (q.T @ change))

    bounds = (math.log(first) - 1e-12, math.log(last) + 1e-12)
    best: tuple[float, np.ndarray] | None = None
    for _, chosen in tried[:_STARTS]:
        start = np.log(grid[list(chosen)])
        found = least_squares(
            residual, start, jacobian, bounds, xtol=1e-12, ftol=1e-15, gtol=1e-15, max_nfev=100
        )
        if best is None or found.cost < best[0]:
            best = (found.cost, found.x)
    assert best is not None
    return np.sort(np.exp(best[1]))


def _merged(c: np.ndarray, tau: np.ndarray) -> tuple[float, list[float], list[float]]:
    """Long-term value, moduli and ascending times without empty and doubled branches."""
    moduli: list[float] = []
    times: list[float] = []
    for weight, time in zip(c[1:], tau, strict=True):
        if weight <= _WEAK:
            continue
        if times and time < times[-1] * (1.0 + _SAME_TIME):
            moduli[-1] += float(weight)
        else:
            moduli.append(float(weight))
            times.append(float(time))
    return float(c[0]), moduli, times
