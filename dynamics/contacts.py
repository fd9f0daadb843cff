"""Contact over time: who may touch is looked up when motion asks for it, and kept in a history.

The laws are those of the statics (`contact.law`), with the paper's damping added. A history holds
all a contact remembers, so that a run that goes on from a checkpoint goes on with the same bits.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from flexapod.contact import ground_kernels, kernels, law_kernels, track_kernels
from flexapod.contact.ground import Ground, Plane
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.core.errors import InputError, SolverError, Status
from flexapod.dynamics import kernels as dynamics_kernels
from flexapod.dynamics import line_kernels
from flexapod.dynamics.line_kernels import GroundArrays
from flexapod.fem.contacts import surface_passes

History = dict[str, np.ndarray]

# Entries of a contact's totals, see `contact.law_kernels`.
ENERGY, STICK, AREA, DEPTH = (
    law_kernels.ENERGY,
    law_kernels.STICK,
    law_kernels.AREA,
    law_kernels.DEPTH,
)
FORCE = slice(law_kernels.FORCE, law_kernels.FORCE + 3)
FRICTION = slice(law_kernels.FRICTION, law_kernels.FRICTION + 3)
COUNT, TOTALS = law_kernels.COUNT, law_kernels.TOTALS

# Entries of a history's "spent": way slid on average over the area in touch [m], what friction
# and what damping took [J].
SLID, BY_FRICTION, BY_DAMPING = 0, 1, 2


class DynamicContact(Protocol):
    """What the engine asks of a contact.

    Its histories hold "depth" (1,), the deepest point's [m], and "spent" (3,), see `account`.
    """

    name: str
    totals: np.ndarray  # (TOTALS,), see the indices above; of the last `add_forces`

    def start(self, x: np.ndarray) -> History:
        """History of a contact that begins at positions `x` [m]."""
        ...

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """Search again if motion asks for it; `travel` [m] bounds a node's way since the last.

        Returns whether it did: `add_rates` knows of no other faces than those found last.
        """
        ...

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        history: History,
        elastic: np.ndarray,
        dissipative: np.ndarray,
    ) -> None:
        """Add external forces [N] of shape (node_count, 3); fills `totals`."""
        ...

    def near_travel(self, v: np.ndarray, history: History, dt: float, travel: float) -> float:
        """How far what is near comes nearer in `dt` [s]; `travel` [m] is the fastest node's way."""
        ...

    def add_rates(
        self,
        history: History,
        inverse_mass: np.ndarray,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
    ) -> None:
        """Add per node what may come to the squared highest frequency [1/s2], and damping [1/s].

        Points are taken `margin` [m] deeper than they are.
        """
        ...

    def pressing(self) -> float:
        """Normal traction of the last `add_forces`, summed over the area in touch [N]."""
        ...

    def rubbing(self) -> float:
        """Shear traction of the last `add_forces`, summed over the area in touch [N]."""
        ...

    def nodal_pressure(self, node_count: int) -> np.ndarray:
        """Normal traction of the last `add_forces`, averaged to nodes [Pa]."""
        ...


def account(contact: DynamicContact, history: History, dt: float) -> None:
    """Add what the last forces slid and dissipated in a step of `dt` [s] to ``history["spent"]``.

    Sliding is counted by the return mapping itself, so it is exact; the damping's power is taken
    constant over the step. The energy ledger has its own count, by the work of the forces.
    """
    totals, spent = contact.totals, history["spent"]
    if totals[AREA] > 0.0:
        spent[SLID] += totals[law_kernels.SLIDING] / totals[AREA]
    spent[BY_FRICTION] += totals[law_kernels.FRICTION_LOSS]
    spent[BY_DAMPING] += dt * totals[law_kernels.DAMPING_POWER]


class GroundContact:
    """Faces on fixed ground, with friction.

    Parameters
    ----------
    name
        For reports.
    nodes
        Reference positions [m], shape (node_count, 3): areas are those at rest.
    faces
        Corner quadruples, outward, shape (face_count, 4).
    ground
        Plane, step or height field, with its friction.
    law
        Normal contact law; friction is the ground's own.
    skin
        Height [m] above the ground up to which faces are watched.
    deepest
        Penetration [m] at which the body counts as fallen through the ground.
    areas
        Of the contact points [m2], shape (face_count, 4); None takes the faces' own. A line has
        faces (a, b, b, a) without an area: it gets its length times its width.
    curve
        Nodes and weights, both (point_count, 4): what touches is not the nodes but points between
        them, ``x_p = sum_a weights[p, a] x[nodes[p, a]]``, and `faces` number these points. So a
        line of few nodes touches as a smooth curve does. None: the nodes themselves.
    """

    def __init__(
        self,
        name: str,
        nodes: np.ndarray,
        faces: np.ndarray,
        ground: Ground,
        law: ContactLaw,
        skin: float = 5e-3,
        deepest: float = 5e-3,
        areas: np.ndarray | None = None,
        curve: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.name = name
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self.ground = ground
        self.law = law
        self.skin = skin
        self.deepest = deepest
        self._kind, self._params, self._heights = ground.packed()
        count = (self.faces.shape[0], kernels.POINTS.shape[0])
        if areas is not None and areas.shape != count:
            raise InputError(f"{name}: areas of contact points must have the shape {count}")
        self.areas = np.empty(count) if areas is None else np.array(areas, dtype=float)
        if areas is None:
            kernels.point_areas(nodes, self.faces, kernels.POINTS, self.areas)
        self.pressure = np.zeros(count)
        self.shear = np.zeros(count)
        self.totals = np.zeros(TOTALS)
        nodes_of, weights = curve if curve is not None else (np.zeros((0, 4)), np.zeros((0, 4)))
        self.curve_nodes = np.ascontiguousarray(nodes_of, dtype=np.int64)
        self.curve_weights = np.ascontiguousarray(weights, dtype=float)
        # A point may move faster than any of its nodes, by this factor at most.
        self.reach = float(np.abs(self.curve_weights).sum(axis=1).max(initial=1.0))
        shape = (len(self.curve_nodes), 3)
        self._points = tuple(np.zeros(shape) for _ in range(4))  # x, v, elastic, dissipative

    def _coefficients(self) -> tuple[float, ...]:
        """Of the law and the friction, in the order of `ground_kernels.ground_contact`."""
        law, friction = self.law, self.ground.friction
        return (
            law.traction_coefficient,
            law.stiffness_exponent,
            law.damping_coefficient,
            law.damping_exponent,
            law.indentation_exponent,
            friction.static,
            friction.dynamic,
            friction.static_speed,
            friction.dynamic_speed,
            law.stick_stiffness,
        )

    def _at_points(self, values: np.ndarray, which: int) -> np.ndarray:
        """`values` (node_count, 3) at what touches."""
        if not len(self.curve_nodes):
            return values
        out = self._points[which]
        line_kernels.curve_points(values, self.curve_nodes, self.curve_weights, out)
        return out

    def start(self, x: np.ndarray) -> History:
        """See `DynamicContact`."""
        count = self.faces.shape[0]
        history = {
            "anchor": np.full((count, kernels.POINTS.shape[0], 3), np.nan),
            "active": np.zeros(count, dtype=np.int64),
            "count": np.zeros(1, dtype=np.int64),
            "way": np.zeros(1),
            "depth": np.zeros(1),
            "spent": np.zeros(3),
            "pressure": np.zeros((count, kernels.POINTS.shape[0])),
        }
        self._search(x, history)
        return history

    def _search(self, x: np.ndarray, history: History) -> None:
        line_kernels.search_ground(self._at_points(x, 0), self.packed(history))

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """See `DynamicContact`: a face out of the skin cannot arrive before it has crossed it."""
        history["way"][0] += self.reach * travel
        if history["way"][0] <= self.skin:
            return False
        self._search(x, history)
        return True

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        history: History,
        elastic: np.ndarray,
        dissipative: np.ndarray,
    ) -> None:
        """See `DynamicContact`."""
        on_nodes = elastic, dissipative
        curved = len(self.curve_nodes) > 0
        if curved:
            elastic, dissipative = self._points[2:]
            elastic[:] = 0.0
            dissipative[:] = 0.0
        ground_kernels.ground_contact(
            self._at_points(x, 0),
            self._at_points(v, 1),
            self.faces,
            history["active"][: history["count"][0]],
            kernels.POINTS,
            self.areas,
            self._kind,
            self._params,
            self._heights,
            *self._coefficients(),
            history["anchor"],
            elastic,
            dissipative,
            history["pressure"],
            self.shear,
            self.totals,
        )
        self.pressure = history["pressure"]
        history["depth"][0] = self.totals[DEPTH]
        if self.totals[DEPTH] > self.deepest:
            self.look_for_fall(x)
        if curved:
            for force, out in zip((elastic, dissipative), on_nodes, strict=True):
                line_kernels.curve_forces(force, self.curve_nodes, self.curve_weights, out)

    def look_for_fall(self, x: np.ndarray, time: float | None = None) -> None:
        """Raise SolverError with the deepest face where one has fallen through the ground."""
        x = self._at_points(x, 0)
        depths = gaps(self.ground, x[self.faces.ravel()])
        at = int(depths.argmin()) // 4
        if -depths.min() <= self.deepest:
            return
        place = x[self.faces[at]].mean(axis=0)
        when = "" if time is None else f"at {time:.6g} s "
        raise SolverError(
            Status.FELL_THROUGH,
            f"{when}{self.name}: the face of nodes {self.faces[at].tolist()} at ({place[0]:.4g}, "
            f"{place[1]:.4g}, {place[2]:.4g}) m is {-1e3 * depths.min():.3g} mm deep in the "
            "ground",
        )

    def packed(self, history: History) -> GroundArrays:
        """For the kernel that walks through many steps; arrays are shared."""
        return GroundArrays(
            self.faces,
            self.areas,
            self._kind,
            self._params,
            self._heights,
            self._coefficients(),
            self.skin,
            self.deepest,
            self.reach,
            history["anchor"],
            history["active"],
            history["count"],
            history["way"],
            history["depth"],
            history["spent"],
            history["pressure"],
            self.shear,
            self.totals,
            self.curve_nodes,
            self.curve_weights,
            *self._points,
        )

    def near_travel(self, v: np.ndarray, history: History, dt: float, travel: float) -> float:
        """See `DynamicContact`."""
        near = self.faces[history["active"][: history["count"][0]]]
        speed = self._at_points(v, 1)[near.ravel()]
        if isinstance(self.ground, Plane):
            return dt * max(0.0, -float((speed @ self.ground.normal).min(initial=0.0)))
        # Steps and stones have sides: any direction may be the one into the ground.
        return dt * math.sqrt(float((speed * speed).sum(axis=1).max(initial=0.0)))

    def add_rates(
        self,
        history: History,
        inverse_mass: np.ndarray,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
    ) -> None:
        """See `DynamicContact`."""
        law = self.law
        pressure = history["pressure"]
        # Damping's part of it is left in: a little careful while points sink in.
        depth = (pressure / law.traction_coefficient) ** (1.0 / law.stiffness_exponent)
        gap = np.where(pressure > 0.0, -depth, np.inf)
        on_nodes = springs, dashpots
        curved = len(self.curve_nodes) > 0
        nodal = inverse_mass
        if curved:
            springs, dashpots = np.zeros((2, len(self.curve_nodes)))
            inverse_mass = np.ones(len(self.curve_nodes))
        track_kernels.contact_rates(
            self.faces,
            history["active"],
            int(history["count"][0]),
            kernels.POINTS,
            self.areas,
            gap,
            margin,
            law.traction_coefficient,
            law.stiffness_exponent,
            law.damping_coefficient,
            law.indentation_exponent,
            law.stick_stiffness if self.ground.friction.static > 0.0 else 0.0,
            1.0,
            inverse_mass,
            springs,
            dashpots,
        )
        if curved:
            # A point's stiffness k between nodes of the weights w: rows |w_a| k sum |w_b|.
            size = np.abs(self.curve_weights)
            share = size * size.sum(axis=1, keepdims=True)
            for rates, out in zip((springs, dashpots), on_nodes, strict=True):
                part = share * rates[:, None] * nodal[self.curve_nodes]
                np.add.at(out, self.curve_nodes, part)

    def pressing(self) -> float:
        """See `DynamicContact`."""
        return float((self.pressure * self.areas).sum())

    def rubbing(self) -> float:
        """See `DynamicContact`."""
        return float((self.shear * self.areas).sum())

    def nodal_pressure(self, node_count: int) -> np.ndarray:
        """See `DynamicContact`."""
        count = len(self.curve_nodes) or node_count
        total, area = np.zeros(count), np.zeros(count)
        kernels.nodal_average(self.faces, kernels.POINTS, self.areas, self.pressure, total, area)
        if len(self.curve_nodes):
            # Of each point to the node it is nearest to.
            nearest = np.take_along_axis(
                self.curve_nodes, self.curve_weights.argmax(axis=1)[:, None], axis=1
            )[:, 0]
            total, area = (
                np.bincount(nearest, weights=values, minlength=node_count).astype(float)
                for values in (total, area)
            )
        return np.asarray(np.divide(total, area, out=np.zeros_like(total), where=area > 0.0))


def gaps(ground: Ground, x: np.ndarray) -> np.ndarray:
    """Signed distance of points (count, 3) from the ground [m]."""
    out = np.empty(len(x))
    dynamics_kernels.ground_gaps(np.ascontiguousarray(x), *ground.packed(), out)
    return out


# Deeper than now by this much [m], at least and at most, is the contact the stable step allows
# for. The paper's damping grows with the square of the depth: at 0.3 mm its dashpot alone asks for
# steps of 4 us, so more than the body is likely to sink in within a few steps is not allowed for
# but looked at again, which is cheap. A walking robot's steps are longer by a third with 15 um;
# what comes 25 um nearer in one step needs the larger margin. It is the deepest point of a contact
# that is watched: others may come up to its depth unseen until the next search or interval.
LEAST_MARGIN, RATE_MARGIN = 1.5e-5, 5e-5


def rate_margin(travel: float) -> float:
    """How much deeper than now [m] to allow for where what is near goes `travel` [m] in a step."""
    return min(max(2.0 * travel, LEAST_MARGIN), RATE_MARGIN)


# Motion of the surfaces relative to each other, as a share of the skin, after which faces are
# searched anew, and near faces looked at. Two faces may each move so far: twice the first and
# twice the second is what is left of the skin.
SEARCH_SHARE = 0.4
LOOK_SHARE = 0.05


class SurfaceContact:
    """Faces against faces: of one body with itself, of two bodies, or of a body and rigid parts.

    Three searches, each cheaper and more frequent than the one before: candidates by a tree once
    the surfaces have moved by 0.4 of `skin` relative to each other, partners of near points
    without one after a twentieth of it, and in every step the points that touch or nearly do. Rigid
    motion of the whole does not count: a rolling wheel is searched no more often than one at rest.

    Parameters
    ----------
    name
        For reports.
    nodes
        Reference positions [m], shape (node_count, 3).
    surface, partner
        Corner quadruples, outward; the same array twice for self-contact.
    law
        Normal contact law, and `stick_stiffness` of what sticks.
    friction
        Of the faces on each other; None for none (the paper sets it to zero between chambers).
        Friction acts at the point and at its projection, which lie the penetration apart: it keeps
        momentum, and angular momentum but for that arm.
    depth, margin, joint_gap
        See `flexapod.fem.contacts.FaceContact`.
    skin
        Distance [m] up to which faces are watched.
    check_every
        Steps after which motion is measured, at the latest; sooner where the surfaces deform fast,
        not at all while nothing can have moved far enough.
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
        skin: float = 3e-3,
        check_every: int = 10,
        friction: FrictionLaw | None = None,
    ) -> None:
        self.name = name
        self.law = law
        self.friction = friction or FrictionLaw.constant(0.0)
        self.depth = depth
        self.margin = margin
        self.skin = skin
        self.check_every = check_every
        self.passes = surface_passes(nodes, surface, partner, joint_gap)
        self.shear = [np.zeros_like(p.pressure) for p in self.passes]
        self.watched = np.unique(np.concatenate([p.slaves.ravel() for p in self.passes]))
        self.totals = np.zeros(TOTALS)
        self._partial = np.zeros(TOTALS)

    def start(self, x: np.ndarray) -> History:
        """See `DynamicContact`."""
        history: History = {
            "x": np.array(x[self.watched]),
            "x_near": np.array(x[self.watched]),
            "age": np.zeros(1, dtype=np.int64),
            "next": np.ones(1, dtype=np.int64),
            "way": np.zeros(1),
            "since": np.zeros(1),
            "depth": np.zeros(1),
            "spent": np.zeros(3),
        }
        for k, p in enumerate(self.passes):
            count = p.slaves.shape[0]
            history[f"candidates{k}"] = np.full((count, 1), -1, dtype=np.int32)
            history[f"near{k}"] = np.zeros(count, dtype=np.int64)
            history[f"count{k}"] = np.zeros(1, dtype=np.int64)
            for key in ("partner", "local", "gap", "fade"):
                history[f"{key}{k}"] = np.array(getattr(p, key))
            history[f"anchor_face{k}"] = np.full(p.gap.shape, -1, dtype=np.int32)
            history[f"anchor_local{k}"] = np.zeros_like(p.local)
        self._search(x, history, first=True)
        return history

    def _search(self, x: np.ndarray, history: History, first: bool = False) -> None:
        """Candidates and near faces anew; points keep their partners, but for the first time."""
        for k, p in enumerate(self.passes):
            near = np.zeros(p.slaves.shape[0], dtype=np.int64)
            if first:
                p.search(x, self.depth, self.margin)
                for key in ("partner", "local", "gap", "fade"):
                    history[f"{key}{k}"][:] = getattr(p, key)
            p.find_candidates(x, self.depth + self.skin)
            history[f"candidates{k}"] = p.candidates
            # A point may slide in over a rim by the skin: half a face, about, and more is rare.
            track_kernels.mark_near(
                x,
                p.slaves,
                kernels.POINTS,
                p.masters,
                p.candidates,
                self.depth,
                self.skin,
                self.margin + 0.5,
                near,
            )
            near[(history[f"gap{k}"] < 0.0).any(axis=1)] = 1
            listed = np.flatnonzero(near)
            history[f"near{k}"][: listed.size] = listed
            history[f"count{k}"][0] = listed.size
            far = near == 0
            history[f"partner{k}"][far] = -1
            history[f"gap{k}"][far] = np.inf
            history[f"fade{k}"][far] = 0.0
            history[f"anchor_face{k}"][far] = -1
            p.pressure[far] = 0.0
            self.shear[k][far] = 0.0
        np.take(x, self.watched, axis=0, out=history["x"], mode="clip")
        history["x_near"][:] = history["x"]
        history["since"][0] = 0.0

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """See `DynamicContact`."""
        anew, searched = self._look(x, history, travel)
        for k, p in enumerate(self.passes):
            track_kernels.track_partners(
                x,
                p.slaves,
                history[f"near{k}"],
                int(history[f"count{k}"][0]),
                kernels.POINTS,
                p.masters,
                history[f"candidates{k}"],
                self.depth,
                self.margin,
                anew,
                2.0 * LOOK_SHARE * self.skin,
                LOOK_SHARE * self.skin,
                history[f"partner{k}"],
                history[f"local{k}"],
                history[f"gap{k}"],
                history[f"fade{k}"],
            )
        return searched

    def _look(self, x: np.ndarray, history: History, travel: float) -> tuple[bool, bool]:
        """Whether near points without a partner are to look for one now, and a search was due.

        Relative motion is measured when any node may have gone far enough at all, and when half of
        what is left would be used up at the pace so far.
        """
        limit = LOOK_SHARE * self.skin
        history["age"][0] += 1
        history["way"][0] += travel
        age = int(history["age"][0])
        if history["way"][0] <= limit or age < history["next"][0]:
            return False, False
        moved = _relative_motion(history["x_near"], x, self.watched)
        left = limit - moved
        if left > 0.2 * limit:
            wait = int(0.5 * left * age / max(moved, 1e-300)) if moved > 0.0 else self.check_every
            history["next"][0] = age + min(max(wait, 1), self.check_every)
            return False, False
        # No point has moved farther than the sum of its ways.
        history["since"][0] += moved
        if history["since"][0] > SEARCH_SHARE * self.skin:
            history["since"][0] = _relative_motion(history["x"], x, self.watched)
        searched = bool(history["since"][0] > SEARCH_SHARE * self.skin)
        if searched:
            self._search(x, history)
        else:
            np.take(x, self.watched, axis=0, out=history["x_near"], mode="clip")
        history["way"][0] = 0.0
        history["age"][0] = 0
        history["next"][0] = min(max(age // 2, 1), self.check_every)
        return True, searched

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        history: History,
        elastic: np.ndarray,
        dissipative: np.ndarray,
    ) -> None:
        """See `DynamicContact`; `totals` holds the force on the first surface."""
        law, friction = self.law, self.friction
        self.totals[:] = 0.0
        for k, p in enumerate(self.passes):
            self._partial[:] = 0.0
            track_kernels.pair_forces(
                x,
                v,
                p.slaves,
                history[f"near{k}"],
                int(history[f"count{k}"][0]),
                kernels.POINTS,
                p.areas,
                p.masters,
                history[f"partner{k}"],
                history[f"local{k}"],
                history[f"gap{k}"],
                history[f"fade{k}"],
                law.traction_coefficient,
                law.stiffness_exponent,
                law.damping_coefficient,
                law.damping_exponent,
                law.indentation_exponent,
                friction.static,
                friction.dynamic,
                friction.static_speed,
                friction.dynamic_speed,
                law.stick_stiffness,
                0.5,
                history[f"anchor_face{k}"],
                history[f"anchor_local{k}"],
                elastic,
                dissipative,
                p.pressure,
                self.shear[k],
                self._partial,
            )
            deepest = max(self.totals[DEPTH], self._partial[DEPTH])
            if k == 1:  # on the second surface
                self._partial[FORCE] *= -1.0
                self._partial[FRICTION] *= -1.0
            self.totals += self._partial
            self.totals[DEPTH] = deepest
        history["depth"][0] = self.totals[DEPTH]

    def near_travel(self, v: np.ndarray, history: History, dt: float, travel: float) -> float:
        """See `DynamicContact`; both surfaces move, at most so far each.

        So the factor two of `rate_margin` is used up, and a search or a greater depth must help.
        """
        return travel

    def add_rates(
        self,
        history: History,
        inverse_mass: np.ndarray,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
    ) -> None:
        """See `DynamicContact`."""
        law = self.law
        for k, p in enumerate(self.passes):
            track_kernels.contact_rates(
                p.slaves,
                history[f"near{k}"],
                int(history[f"count{k}"][0]),
                kernels.POINTS,
                p.areas,
                history[f"gap{k}"],
                margin,
                law.traction_coefficient,
                law.stiffness_exponent,
                law.damping_coefficient,
                law.indentation_exponent,
                law.stick_stiffness if self.friction.static > 0.0 else 0.0,
                2.0,
                inverse_mass,
                springs,
                dashpots,
            )

    def pressing(self) -> float:
        """See `DynamicContact`; both surfaces feel it, it is counted once."""
        return 0.5 * sum(float((p.pressure * p.areas).sum()) for p in self.passes)

    def rubbing(self) -> float:
        """See `DynamicContact`; both surfaces feel it, it is counted once."""
        pairs = zip(self.passes, self.shear, strict=True)
        return 0.5 * sum(float((shear * p.areas).sum()) for p, shear in pairs)

    def nodal_pressure(self, node_count: int) -> np.ndarray:
        """See `DynamicContact`."""
        total, area = np.zeros(node_count), np.zeros(node_count)
        for p in self.passes:
            kernels.nodal_average(p.slaves, kernels.POINTS, p.areas, p.pressure, total, area)
        return np.asarray(np.divide(total, area, out=np.zeros_like(total), where=area > 0.0))


def _relative_motion(before: np.ndarray, x: np.ndarray, nodes: np.ndarray) -> float:
    """Largest way of a node [m] beyond the rigid motion that fits all of them best."""
    sums = np.empty((5, 3))
    track_kernels.rigid_fit_sums(before, x, nodes, sums)
    left, _, right = np.linalg.svd(sums[2:])
    if np.linalg.det(left @ right) < 0.0:
        left[:, -1] *= -1.0
    turn = left @ right
    return track_kernels.relative_motion(before, x, nodes, turn, sums[1] - turn @ sums[0])
