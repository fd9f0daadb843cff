"""Contact as a part of a static problem: search, law and forces put together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexapod.contact import kernels
from flexapod.contact.law import ContactLaw
from flexapod.contact.search import CANDIDATE_COUNT, Rest, candidate_faces, radii
from flexapod.fem.loads import Stiffness


@dataclass(frozen=True)
class ContactReport:
    """What one contact shows at one state."""

    force: np.ndarray  # resultant on the (first) surface [N], shape (3,)
    area: float  # reference area in touch [m2]
    largest_penetration: float  # [m]
    largest_pressure: float  # [Pa]


class Contact(Protocol):
    """What the path asks of a contact."""

    name: str

    def couplings(self) -> list[np.ndarray]:
        """Node sets this contact may couple, for the matrix pattern."""
        ...

    def update(self, x: np.ndarray) -> None:
        """Search again for what may touch at positions `x` [m]."""
        ...

    def add_residual(self, x: np.ndarray, residual: np.ndarray) -> float:
        """Add contact forces [N] to `residual`; return the contact energy [J]."""
        ...

    def stiffness(self, x: np.ndarray) -> list[Stiffness]:
        """Return the tangent at positions `x`."""
        ...

    def freeze(self, frozen: bool) -> None:
        """Let points keep the partners they have, or choose anew again."""
        ...

    def commit(self) -> None:
        """Accept the last trial's history (friction anchors)."""
        ...

    def nodal_pressure(self, x: np.ndarray) -> np.ndarray:
        """Contact pressure averaged to nodes [Pa], shape (node_count,)."""
        ...

    def report(self, x: np.ndarray) -> ContactReport:
        """Resultant, area and penetration."""
        ...


class FaceContact:
    """Faces against faces, each side taking the other's part: self-contact or two surfaces.

    Parameters
    ----------
    name
        For reports.
    nodes
        Reference positions [m], shape (node_count, 3).
    surface
        Corner quadruples, outward, shape (face_count, 4).
    partner
        The other surface; the same array for self-contact.
    law
        The contact law. Friction is not used between faces (the paper sets it to zero).
    depth
        Largest penetration [m] that still counts as contact; less than half the thinnest wall.
    margin
        How far over its rim (in local coordinates, a face spans 2) a face still takes points,
        with a force that fades to nothing.
    joint_gap
        Self-contact only: faces whose normal distance at rest is smaller [m] are joined, see
        `flexapod.contact.search.candidate_faces`.
    """

    def __init__(
        self,
        name: str,
        nodes: np.ndarray,
        surface: np.ndarray,
        partner: np.ndarray,
        law: ContactLaw,
        depth: float = 1e-3,
        margin: float = 0.3,
        joint_gap: float = 5e-4,
    ) -> None:
        self.name = name
        self.law = law
        self.depth = depth
        self.margin = margin
        self.frozen = False  # points keep their partners and shares, see `StaticProblem.freeze`
        self._passes = surface_passes(nodes, surface, partner, joint_gap)
        self.update(nodes)

    def couplings(self) -> list[np.ndarray]:
        """See `Contact`: each slave face with every candidate."""
        return [p.couplings for p in self._passes]

    def update(self, x: np.ndarray) -> None:
        """See `Contact`."""
        if self.frozen:
            return
        for p in self._passes:
            p.search(x, self.depth, self.margin)

    def add_residual(self, x: np.ndarray, residual: np.ndarray) -> float:
        """See `Contact`."""
        return sum(self._evaluate(p, x, residual, False)[0] for p in self._passes)

    def stiffness(self, x: np.ndarray) -> list[Stiffness]:
        """See `Contact`."""
        scratch = np.zeros_like(x)
        out: list[Stiffness] = []
        for p in self._passes:
            _, count = self._evaluate(p, x, scratch, True)
            if count:
                out.append((p.nodes[:count], p.stiffness[:count]))
        return out

    def _evaluate(
        self, p: SurfacePass, x: np.ndarray, residual: np.ndarray, tangent: bool
    ) -> tuple[float, int]:
        if self.frozen:
            kernels.project_on_partners(
                x, p.slaves, kernels.POINTS, p.masters, p.partner, p.local, p.gap
            )
        else:
            kernels.find_partners(
                x,
                p.slaves,
                kernels.POINTS,
                p.masters,
                p.candidates,
                self.depth,
                self.margin,
                p.partner,
                p.local,
                p.gap,
                p.fade,
            )
        if tangent:
            p.reserve(int((p.gap < 0.0).sum()))
        energy, count = kernels.pair_contact(
            x,
            p.slaves,
            kernels.POINTS,
            p.areas,
            p.masters,
            p.partner,
            p.local,
            p.gap,
            p.fade,
            self.law.traction_coefficient,
            self.law.stiffness_exponent,
            0.5,
            residual,
            p.pressure,
            p.nodes,
            p.stiffness,
            tangent,
        )
        return float(energy), int(count)

    def freeze(self, frozen: bool) -> None:
        """See `Contact`."""
        self.frozen = frozen

    def commit(self) -> None:
        """See `Contact`: frictionless contact has no history."""

    def nodal_pressure(self, x: np.ndarray) -> np.ndarray:
        """See `Contact`."""
        total, area = np.zeros(x.shape[0]), np.zeros(x.shape[0])
        scratch = np.zeros_like(x)
        for p in self._passes:
            self._evaluate(p, x, scratch, False)
            kernels.nodal_average(p.slaves, kernels.POINTS, p.areas, p.pressure, total, area)
        return np.asarray(np.divide(total, area, out=np.zeros_like(total), where=area > 0.0))

    def report(self, x: np.ndarray) -> ContactReport:
        """See `Contact`; for two surfaces the force is the one on the first."""
        area, deepest, highest = 0.0, 0.0, 0.0
        first = np.zeros_like(x)
        for p in self._passes:
            self._evaluate(p, x, first, False)
            touching = p.pressure > 0.0
            area += 0.5 * float(p.areas[touching].sum())
            if touching.any():
                deepest = max(deepest, -float(p.gap[p.fade > 0.0].min()))
                highest = max(highest, float(p.pressure.max()))
        on_first = -first[np.unique(self._passes[0].slaves)].sum(axis=0)
        return ContactReport(on_first, area, deepest, highest)


def surface_passes(
    nodes: np.ndarray, surface: np.ndarray, partner: np.ndarray, joint_gap: float
) -> list[SurfacePass]:
    """One pass of each surface against the other; a single one for a surface against itself.

    In self-contact every point is once slave and meets its partner as a slave too.
    """
    surface = np.ascontiguousarray(surface, dtype=np.int64)
    partner = np.ascontiguousarray(partner, dtype=np.int64)
    if np.array_equal(surface, partner):
        return [SurfacePass(nodes, surface, surface, joint_gap)]
    return [SurfacePass(nodes, surface, partner, None), SurfacePass(nodes, partner, surface, None)]


class SurfacePass:
    """One surface as slave against another as master, with its work arrays."""

    def __init__(
        self, nodes: np.ndarray, slaves: np.ndarray, masters: np.ndarray, joint_gap: float | None
    ) -> None:
        self._rest = None if joint_gap is None else Rest.of(nodes, slaves, masters)
        self._joint_gap = joint_gap or 0.0
        self.slaves = slaves
        self.masters = masters
        count = (slaves.shape[0], kernels.POINTS.shape[0])
        self.areas = np.empty(count)
        kernels.point_areas(nodes, slaves, kernels.POINTS, self.areas)
        self.partner = np.full(count, -1, dtype=np.int32)
        self.local = np.zeros((*count, 2))
        self.gap = np.full(count, np.inf)
        self.fade = np.zeros(count)
        self.pressure = np.zeros(count)
        self.nodes = np.empty((0, 8), dtype=np.int64)
        self.stiffness = np.empty((0, 24, 24))
        self.candidates = np.full((slaves.shape[0], 1), -1, dtype=np.int32)
        self.couplings = np.empty((0, 8), dtype=np.int64)

    def find_candidates(
        self, x: np.ndarray, room: float, margin: float, count: int = CANDIDATE_COUNT
    ) -> None:
        """List up to `count` master faces each slave face may touch at positions `x` [m].

        Surfaces may come nearer by `room` [m] until the next time; masters take points up to
        `margin` (in local coordinates) beside their rims.
        """
        first = second = radii(x, self.slaves)
        if self.masters is not self.slaves:
            second = radii(x, self.masters)
        self.candidates = candidate_faces(
            x,
            self.slaves,
            self.masters,
            room,
            self._rest,
            self._joint_gap,
            (first, (1.0 + margin) * second),
            count,
        )

    def search(self, x: np.ndarray, depth: float, margin: float) -> None:
        """Candidates, partners and what they may couple, all anew."""
        self.find_candidates(x, depth, margin)
        kernels.find_partners(
            x,
            self.slaves,
            kernels.POINTS,
            self.masters,
            self.candidates,
            depth,
            margin,
            self.partner,
            self.local,
            self.gap,
            self.fade,
        )
        near = np.unique(
            np.stack([np.nonzero(self.gap < 0.5 * depth)[0], self.partner[self.gap < 0.5 * depth]]),
            axis=1,
        )
        self.couplings = np.concatenate([self.slaves[near[0]], self.masters[near[1]]], axis=1)

    def reserve(self, count: int) -> None:
        if self.nodes.shape[0] < count:
            size = int(1.5 * count) + 16
            self.nodes = np.empty((size, 8), dtype=np.int64)
            self.stiffness = np.empty((size, 24, 24))


class PlaneContact:
    """Faces on a rigid plane, frictionless or with Coulomb friction.

    Parameters
    ----------
    name
        For reports.
    nodes
        Reference positions [m], shape (node_count, 3).
    surface
        Corner quadruples, outward, shape (face_count, 4).
    origin, normal
        A point of the plane [m] and its unit normal, towards the body.
    law
        The contact law, with its friction coefficient.
    """

    def __init__(
        self,
        name: str,
        nodes: np.ndarray,
        surface: np.ndarray,
        origin: tuple[float, float, float],
        normal: tuple[float, float, float],
        law: ContactLaw,
    ) -> None:
        self.name = name
        self.law = law
        self.surface = np.ascontiguousarray(surface, dtype=np.int64)
        self.origin = np.asarray(origin, dtype=float)
        self.normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
        count = (self.surface.shape[0], kernels.POINTS.shape[0])
        self.areas = np.empty(count)
        kernels.point_areas(nodes, self.surface, kernels.POINTS, self.areas)
        self.anchor = np.full((*count, 4), np.nan)  # and the accepted traction
        self._trial = self.anchor.copy()
        self.pressure = np.zeros(count)
        self._nodes = np.empty((0, 4), dtype=np.int64)
        self._stiffness = np.empty((0, 12, 12))

    def couplings(self) -> list[np.ndarray]:
        """See `Contact`: a face couples its own corners only, which the elements do already."""
        return []

    def update(self, x: np.ndarray) -> None:
        """See `Contact`: a plane needs no search."""

    def add_residual(self, x: np.ndarray, residual: np.ndarray) -> float:
        """See `Contact`."""
        return self._evaluate(x, residual, False)[0]

    def stiffness(self, x: np.ndarray) -> list[Stiffness]:
        """See `Contact`."""
        if not self._nodes.shape[0]:
            size = self.areas.size
            self._nodes = np.empty((size, 4), dtype=np.int64)
            self._stiffness = np.empty((size, 12, 12))
        _, count = self._evaluate(x, np.zeros_like(x), True)
        return [(self._nodes[:count], self._stiffness[:count])] if count else []

    def _evaluate(self, x: np.ndarray, residual: np.ndarray, tangent: bool) -> tuple[float, int]:
        law = self.law
        energy, count = kernels.plane_contact(
            x,
            self.anchor,
            self.surface,
            kernels.POINTS,
            self.areas,
            self.origin,
            self.normal,
            law.traction_coefficient,
            law.stiffness_exponent,
            law.friction,
            law.stick_stiffness,
            residual,
            self.pressure,
            self._trial,
            self._nodes,
            self._stiffness,
            tangent,
        )
        return float(energy), int(count)

    def freeze(self, frozen: bool) -> None:
        """See `Contact`: a plane is the only partner there is."""

    def commit(self) -> None:
        """See `Contact`: the trial anchors of the last evaluation become history."""
        self.anchor[:] = self._trial

    def nodal_pressure(self, x: np.ndarray) -> np.ndarray:
        """See `Contact`."""
        self._evaluate(x, np.zeros_like(x), False)
        total, area = np.zeros(x.shape[0]), np.zeros(x.shape[0])
        kernels.nodal_average(self.surface, kernels.POINTS, self.areas, self.pressure, total, area)
        return np.asarray(np.divide(total, area, out=np.zeros_like(total), where=area > 0.0))

    def report(self, x: np.ndarray) -> ContactReport:
        """See `Contact`."""
        residual = np.zeros_like(x)
        self._evaluate(x, residual, False)
        touching = self.pressure > 0.0
        law = self.law
        highest = float(self.pressure.max(initial=0.0))
        depth = (highest / law.traction_coefficient) ** (1.0 / law.stiffness_exponent)
        return ContactReport(
            -residual.sum(axis=0), float(self.areas[touching].sum()), depth, highest
        )


class SlidingWeight:
    """A body that lies on a plane outside the model and slides on it under its own weight.

    For bodies that move along the plane only, as in a model cut by a plane of symmetry parallel to
    it: no face of the model touches the plane, each node presses on it with its share of the
    weight. Friction is Coulomb's, ``mu m g s / sqrt(|s|**2 + s0**2)`` against the slip ``s`` since
    the last accepted state: it has a potential, so its tangent is exact and symmetric. What it
    does not know is sticking with a memory: a load that rests lets its friction go.

    Parameters
    ----------
    name
        For reports.
    nodes
        Reference positions [m], shape (node_count, 3).
    weight
        Nodal mass times the acceleration of gravity [N], shape (node_count,).
    normal
        Of the plane.
    friction
        Coulomb coefficient.
    slip
        s0 [m]: the slip within an increment at which friction has 0.7 of its full force.
    """

    def __init__(
        self,
        name: str,
        nodes: np.ndarray,
        weight: np.ndarray,
        normal: tuple[float, float, float],
        friction: float,
        slip: float,
    ) -> None:
        self.name = name
        self.limit = friction * np.asarray(weight, dtype=float)
        self.slip = slip
        unit = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
        self._along = np.eye(3) - np.outer(unit, unit)
        self.anchor = np.array(nodes, dtype=float)
        self._trial = self.anchor.copy()
        self._nodes = np.arange(nodes.shape[0])[:, None]

    def couplings(self) -> list[np.ndarray]:
        """See `Contact`: a node couples with itself only."""
        return []

    def update(self, x: np.ndarray) -> None:
        """See `Contact`: nothing to search."""

    def _slips(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slips = (x - self.anchor) @ self._along
        return slips, np.sqrt((slips**2).sum(axis=1) + self.slip**2)

    def add_residual(self, x: np.ndarray, residual: np.ndarray) -> float:
        """See `Contact`."""
        self._trial[:] = x
        slips, size = self._slips(x)
        residual += (self.limit / size)[:, None] * slips
        return float((self.limit * (size - self.slip)).sum())

    def stiffness(self, x: np.ndarray) -> list[Stiffness]:
        """See `Contact`."""
        slips, size = self._slips(x)
        outer = slips[:, :, None] * slips[:, None, :] / (size**2)[:, None, None]
        return [(self._nodes, (self.limit / size)[:, None, None] * (self._along - outer))]

    def freeze(self, frozen: bool) -> None:
        """See `Contact`: the table is the only partner there is."""

    def commit(self) -> None:
        """See `Contact`: the accepted state is where slip is counted from."""
        self.anchor[:] = self._trial

    def nodal_pressure(self, x: np.ndarray) -> np.ndarray:
        """See `Contact`: the plane touches no face of the model."""
        return np.zeros(x.shape[0])

    def report(self, x: np.ndarray) -> ContactReport:
        """See `Contact`: the friction of the last increment."""
        slips, size = self._slips(x)
        force = -((self.limit / size)[:, None] * slips).sum(axis=0)
        return ContactReport(force, 0.0, 0.0, 0.0)
