"""Line elements between nodes, coils that contract, and the bending of closed curves.

A model of the explicit engine gets them as `Model(..., lines=LineSystem(...))`, beside a soft body
of hexahedra (the ends of a line are then middles of its nodes) or alone, on `points`, the nodes
without a body::

    points = Points(x, mass, fixed)                      # the ring's nodes and its hub
    lines = Lines.between(pairs, length=..., stiffness=..., damping=...)   # Voigt: the shell
    coils = Lines.between(spokes, ..., flow_damping=..., limit=..., coil=np.arange(8))
    system = LineSystem(Lines.joined(lines, coils), Coils(...), Hinges(...))
    model = Model(None, points=points, lines=system, contacts=[ground])

What they remember is in `State.lines`. Energies: what lines and hinges store is `Energies.lines`,
what rheology and bending dissipate `line_loss`, and what active forces put in `coil_work`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flexapod.core.errors import InputError
from flexapod.dynamics import line_kernels
from flexapod.dynamics.actuation import Actuation
from flexapod.dynamics.line_kernels import (
    CoilArrays,
    HingeArrays,
    LineArrays,
    LineHistory,
)

History = dict[str, np.ndarray]


@dataclass(frozen=True)
class Points:
    """Nodes without a body: point masses.

    Attributes
    ----------
    x
        Positions at the start [m], shape (point_count, 3).
    mass
        Masses [kg], shape (point_count,).
    fixed
        Ways they cannot move, shape (point_count, 3); None for none. A robot that moves in one
        plane has its third direction fixed.
    """

    x: np.ndarray
    mass: np.ndarray
    fixed: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.x.shape != (len(self.mass), 3):
            raise InputError(f"{len(self.mass)} point masses need as many positions")
        if not (np.isfinite(self.mass).all() and (self.mass > 0.0).all()):
            raise InputError("point masses must be finite and > 0")
        if self.fixed is not None and self.fixed.shape != self.x.shape:
            raise InputError("fixed must be of the shape of the positions of points")


@dataclass(frozen=True)
class Lines:
    """Line elements: three-element models with slider (`materials.rheology`), tension positive.

    Attributes
    ----------
    ends
        Node numbers of both ends of each element; an end is the middle of its nodes.
    length
        Without force [m], shape (line_count,).
    stiffness, damping
        Of the Voigt part [N/m], [N s/m], each (line_count,).
    flow_damping, limit
        Of the dashpot in series [N s/m], and the force beyond which it yields [N], each
        (line_count,); an infinite limit is a Voigt element.
    excess
        1 where the dashpot carries only what exceeds the limit, shape (line_count,).
    coil
        Row of the coil whose active force pulls the ends together, or -1, shape (line_count,).
    """

    ends: tuple[tuple[np.ndarray, np.ndarray], ...]
    length: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    flow_damping: np.ndarray
    limit: np.ndarray
    excess: np.ndarray
    coil: np.ndarray

    @classmethod
    def between(
        cls,
        ends: Sequence[tuple[int | np.ndarray, int | np.ndarray]],
        *,
        length: float | np.ndarray,
        stiffness: float | np.ndarray,
        damping: float | np.ndarray = 0.0,
        flow_damping: float | np.ndarray = np.inf,
        limit: float | np.ndarray = np.inf,
        excess: int = 0,
        coil: int | np.ndarray = -1,
    ) -> Lines:
        """Elements between pairs of nodes (or of groups of nodes); scalars count for all.

        Raises
        ------
        InputError
            A stiffness, damping or limit is negative or no number, or a length is not positive.
        """
        count = len(ends)
        pairs = tuple(
            (np.atleast_1d(np.asarray(a, np.int64)), np.atleast_1d(np.asarray(b, np.int64)))
            for a, b in ends
        )

        def spread(name: str, value: float | np.ndarray, unit: str, least: str) -> np.ndarray:
            array = np.array(np.broadcast_to(np.asarray(value, dtype=float), (count,)))
            bad = np.isnan(array) | (array < 0.0) | ((array == 0.0) if least == ">" else False)
            if bad.any():
                first = float(array[np.flatnonzero(bad)[0]])
                raise InputError(f"{name} of a line must be {least} 0, got {first:g} {unit}")
            return array

        return cls(
            pairs,
            spread("length", length, "m", ">"),
            spread("stiffness", stiffness, "N/m", ">="),
            spread("damping", damping, "N s/m", ">="),
            spread("flow_damping", flow_damping, "N s/m", ">"),
            spread("limit", limit, "N", ">="),
            np.full(count, excess, dtype=np.int64),
            np.array(np.broadcast_to(np.asarray(coil, dtype=np.int64), (count,))),
        )

    @classmethod
    def joined(cls, *parts: Lines) -> Lines:
        """All elements of several groups, in order."""
        names = ("length", "stiffness", "damping", "flow_damping", "limit", "excess", "coil")
        return cls(
            tuple(pair for part in parts for pair in part.ends),
            **{n: np.concatenate([getattr(part, n) for part in parts]) for n in names},
        )

    def __len__(self) -> int:
        return len(self.length)

    def packed(self) -> LineArrays:
        """For the kernels."""
        flat = [end for pair in self.ends for end in pair]
        start = np.concatenate([[0], np.cumsum([len(end) for end in flat])]).astype(np.int64)
        nodes = np.concatenate(flat) if flat else np.zeros(0, dtype=np.int64)
        return LineArrays(
            start,
            nodes.astype(np.int64),
            self.length,
            self.stiffness,
            self.damping,
            self.flow_damping,
            self.limit,
            self.excess,
            self.coil,
        )


@dataclass(frozen=True)
class Coils:
    """Active forces of shape-memory coils, and when they are switched (Sugiyama & Hirai, eq. 5).

    Attributes
    ----------
    rate_on, rate_off
        Of the force while on and off [N/s], shape (coil_count,).
    largest
        Active force [N], shape (coil_count,).
    actuation
        Which are on when; its columns are the coils.
    """

    rate_on: np.ndarray
    rate_off: np.ndarray
    largest: np.ndarray
    actuation: Actuation

    def __post_init__(self) -> None:
        for name in ("rate_on", "rate_off", "largest"):
            value = getattr(self, name)
            if not (np.isfinite(value).all() and (value >= 0.0).all()):
                raise InputError(f"{name} of coils must be finite and >= 0")
        if self.actuation.states.shape[1] != len(self.largest):
            raise InputError(
                f"{len(self.largest)} coils, but the actuation switches "
                f"{self.actuation.states.shape[1]}"
            )

    def packed(self) -> CoilArrays:
        """For the kernels."""
        return CoilArrays(
            np.array(self.rate_on, dtype=float),
            np.array(self.rate_off, dtype=float),
            np.array(self.largest, dtype=float),
            np.ascontiguousarray(self.actuation.times, dtype=float),
            np.ascontiguousarray(self.actuation.states, dtype=bool),
        )


@dataclass(frozen=True)
class Hinges:
    """Bending of closed curves between their segments, see `line_kernels.hinge_forces`.

    Twist of the curve is left out: what it resists is part of the stiffness out of the plane.

    Attributes
    ----------
    rings
        Node numbers of each closed curve, in order.
    stiffness
        In the curve's plane and out of it [N m/rad], one pair per ring: of each hinge.
    rest_angle
        Turn at each hinge without moment [rad], one per ring; a regular n-gon has 2 pi/n.
    damping_time
        Dashpot over stiffness of bending [s], one per ring.
    """

    rings: tuple[np.ndarray, ...] = ()
    stiffness: tuple[tuple[float, float], ...] = ()
    rest_angle: tuple[float, ...] = ()
    damping_time: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not len(self.rings) == len(self.stiffness) == len(self.rest_angle):
            raise InputError("each ring needs a pair of stiffnesses and a rest angle")
        for pair in self.stiffness:
            if not all(np.isfinite(k) and k >= 0.0 for k in pair):
                raise InputError(f"bending stiffness must be finite and >= 0, got {pair} N m/rad")

    def packed(self) -> HingeArrays:
        """For the kernels."""
        nodes, ring, stiffness, rest, damping = [], [], [], [], []
        times = self.damping_time or (0.0,) * len(self.rings)
        for k, loop in enumerate(self.rings):
            nodes.append(np.stack([np.roll(loop, 1), loop, np.roll(loop, -1)], axis=1))
            ring.append(np.full(len(loop), k))
            stiffness.append(np.broadcast_to(self.stiffness[k], (len(loop), 2)))
            rest.append(np.full(len(loop), self.rest_angle[k]))
            damping.append(np.full(len(loop), times[k]))
        start = np.concatenate([[0], np.cumsum([len(loop) for loop in self.rings])])
        return HingeArrays(
            np.concatenate([np.zeros((0, 3)), *nodes]).astype(np.int64),
            np.concatenate([np.zeros(0), *ring]).astype(np.int64),
            start.astype(np.int64),
            np.concatenate([np.zeros(0), *self.rings]).astype(np.int64),
            np.concatenate([np.zeros((0, 2)), *stiffness]).astype(float),
            np.concatenate([np.zeros(0), *rest]).astype(float),
            np.concatenate([np.zeros(0), *damping]).astype(float),
        )


@dataclass(frozen=True)
class LineSystem:
    """All line elements of a model, its coils and its bending curves."""

    lines: Lines
    coils: Coils | None = None
    hinges: Hinges = field(default_factory=Hinges)

    def __post_init__(self) -> None:
        count = 0 if self.coils is None else len(self.coils.largest)
        if (self.lines.coil >= count).any():
            raise InputError(f"a line belongs to coil {self.lines.coil.max()}, of {count} coils")
        packed = self.coils.packed() if self.coils is not None else _no_coils()
        object.__setattr__(self, "arrays", self.lines.packed())
        object.__setattr__(self, "coil_arrays", packed)
        object.__setattr__(self, "hinge_arrays", self.hinges.packed())
        object.__setattr__(self, "active_before", np.zeros(len(packed.largest)))

    arrays: LineArrays = field(init=False, repr=False, compare=False)
    coil_arrays: CoilArrays = field(init=False, repr=False, compare=False)
    hinge_arrays: HingeArrays = field(init=False, repr=False, compare=False)
    active_before: np.ndarray = field(init=False, repr=False, compare=False)

    def start(self, x: np.ndarray) -> History:
        """What the elements remember when a motion begins at positions `x` [m].

        The Voigt parts hold all the elongation there is, and no coil pulls.
        """
        length = np.empty(len(self.lines))
        line_kernels.line_lengths(x, self.arrays, length)
        history: History = {
            "length": length,
            "extension": length - self.lines.length,
            "active": np.zeros(len(self.active_before)),
            "force": np.zeros(len(self.lines)),
            "angle": np.zeros((len(self.hinge_arrays.ring), 2)),
            "spent": np.zeros(2),
        }
        # Bending remembers its angles; that of the first step is the one it starts with.
        line_kernels.hinge_forces(
            x, 0.0, self.hinge_arrays, pack_history(history), np.zeros_like(x)
        )
        return history

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        time: float,
        dt_before: float,
        history: History,
        out: np.ndarray,
    ) -> float:
        """Add forces [N] to `out` at `time` [s], after a step of `dt_before`; return the energy."""
        packed = pack_history(history)
        line_kernels.advance_active(
            self.coil_arrays, time - dt_before, time, packed.active, self.active_before
        )
        stored = line_kernels.line_forces(
            x, v, dt_before, self.arrays, self.active_before, packed, out
        )
        stored += line_kernels.hinge_forces(x, dt_before, self.hinge_arrays, packed, out)
        return float(stored)

    def add_rates(
        self,
        nodes: np.ndarray,
        history: History,
        inverse_mass: np.ndarray,
        springs: np.ndarray,
        dashpots: np.ndarray,
    ) -> None:
        """Add per node what may come to the squared highest frequency [1/s2], and damping [1/s].

        `nodes` are the reference positions [m].
        """
        ends = self.hinge_arrays.nodes
        edge = np.stack(
            [np.linalg.norm(nodes[ends[:, k + 1]] - nodes[ends[:, k]], axis=1) for k in range(2)],
            axis=1,
        )
        line_kernels.line_rates(
            self.arrays,
            self.hinge_arrays,
            pack_history(history),
            edge,
            inverse_mass,
            springs,
            dashpots,
        )

    def stored_parts(self, x: np.ndarray, history: History) -> tuple[float, float, float]:
        """Energy stored [J] in lines without a coil, in those with one, and in bending."""
        energy = 0.5 * self.lines.stiffness * history["extension"] ** 2
        coil = self.lines.coil >= 0
        copy = {name: value.copy() for name, value in history.items()}
        bending = line_kernels.hinge_forces(
            x, 0.0, self.hinge_arrays, pack_history(copy), np.zeros_like(x)
        )
        return float(energy[~coil].sum()), float(energy[coil].sum()), float(bending)


def pack_history(history: History) -> LineHistory:
    """For the kernels, which write in place."""
    return LineHistory(
        history["length"],
        history["extension"],
        history["active"],
        history["force"],
        history["angle"],
        history["spent"],
    )


def _no_coils() -> CoilArrays:
    none = np.zeros(0)
    return CoilArrays(none, none, none, np.zeros(1), np.zeros((1, 0), dtype=bool))
