"""Faces against faces over time."""

from __future__ import annotations

import math

import numpy as np

from flexapod.contact import kernels, rate_kernels, track_kernels
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.dynamics.contacts import (
    DEPTH,
    FORCE,
    FRICTION,
    TOTALS,
    History,
    rate_margin,
)
from flexapod.fem.contacts import surface_passes

SKIN = 5e-3  # distance up to which faces are watched [m], unless given

# Shares of the skin. Faces are searched anew after so much motion relative to each other, which
# two faces may each have gone; ways are counted, at the latest, after the second. A near face whose
# own way and that of what it may touch add up to the third is looked at, so points are followed
# that were closer than what they may come nearer by until then: that, and twice the second not yet
# counted. All of it is less than what the search leaves of the skin.
SEARCH_SHARE = 0.4
WAY_SHARE = 0.02
LOOK_SHARE = 0.06
CLOSE_SHARE = LOOK_SHARE + 2.0 * WAY_SHARE
# How much deeper than before a point may be on a face that is new to it, and how near a face has
# to be to count in the stable step.
SLACK_SHARE = 0.05
COUNT_SHARE = 0.05
# Both surfaces take the slave's part in turn, so each point counts by half.
SHARE = 0.5
# Candidates of a face before those out of reach are struck: a large one has many small ones near.
CANDIDATES = 32


class SurfaceContact:
    """Faces against faces: of one body with itself, of two bodies, or of a body and rigid parts.

    Three searches, each cheaper and more frequent than the one before: candidates on a grid once
    the surfaces have moved by 0.4 of `skin` relative to each other, partners of the points of a
    near face once it and what is near it have closed by 0.06 of it, and in every step the points
    that touch or nearly do. Rigid motion of the whole does not count: a rolling wheel is searched
    no more often than one at rest.

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
        skin: float = SKIN,
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
        self._half = [half_edges(nodes, p.masters) for p in self.passes]
        self.watched = np.unique(np.concatenate([p.slaves.ravel() for p in self.passes]))
        self._moved = np.zeros(len(nodes))
        self.totals = np.zeros(TOTALS)
        self.deeper = False
        self._partial = np.zeros(TOTALS)

    def start(self, x: np.ndarray) -> History:
        """See `DynamicContact`."""
        history: History = {
            "x": np.array(x[self.watched]),
            "x_near": np.array(x[self.watched]),
            "age": np.zeros(1, dtype=np.int64),
            "next": np.ones(1, dtype=np.int64),
            "way": np.zeros(1),
            "gone": np.zeros(1),
            "since": np.zeros(1),
            "depth": np.zeros(1),
            "spent": np.zeros(3),
        }
        for k, p in enumerate(self.passes):
            count = p.slaves.shape[0]
            history[f"candidates{k}"] = np.full((count, 1), -1, dtype=np.int32)
            history[f"near{k}"] = np.zeros(count, dtype=np.int64)
            history[f"count{k}"] = np.zeros(1, dtype=np.int64)
            history[f"allowed{k}"] = np.zeros(p.gap.shape)
            history[f"way{k}"] = np.zeros(count)
            history[f"ready{k}"] = np.zeros(count)
            history[f"offset{k}"] = np.zeros(p.gap.shape)
            history[f"dropped{k}"] = np.zeros(count)
            for key in ("partner", "local", "gap"):
                history[f"{key}{k}"] = np.array(getattr(p, key))
            history[f"anchor_face{k}"] = np.full(p.gap.shape, -1, dtype=np.int32)
            history[f"anchor_local{k}"] = np.zeros_like(p.local)
        self._search(x, history, first=True)
        self.prepare(x, history, 0.0)  # says when each face is to be looked at
        return history

    def _search(self, x: np.ndarray, history: History, first: bool = False) -> None:
        """Candidates and near faces anew; points keep their partners, but for the first time."""
        for k, p in enumerate(self.passes):
            near = np.zeros(p.slaves.shape[0], dtype=np.int64)
            if first:
                p.search(x, self.depth, self.margin)
                for key in ("partner", "local", "gap"):
                    history[f"{key}{k}"][:] = getattr(p, key)
            # A point may slide in over a rim, or over a partner's margin.
            p.find_candidates(x, self.depth + self.skin, self.margin, CANDIDATES)
            history[f"candidates{k}"] = p.candidates
            track_kernels.mark_near(
                x,
                p.slaves,
                kernels.POINTS,
                p.masters,
                p.candidates,
                max(self.skin, self.depth),
                self.margin,
                near,
            )
            near[(history[f"gap{k}"] < 0.0).any(axis=1)] = 1
            listed = np.flatnonzero(near)
            history[f"near{k}"][: listed.size] = listed
            history[f"count{k}"][0] = listed.size
            history[f"way{k}"][listed] = np.inf  # partners are looked for at once
            far = near == 0
            history[f"partner{k}"][far] = -1
            history[f"gap{k}"][far] = np.inf
            history[f"offset{k}"][far] = 0.0
            history[f"anchor_face{k}"][far] = -1
            p.pressure[far] = 0.0
            self.shear[k][far] = 0.0
        np.take(x, self.watched, axis=0, out=history["x"], mode="clip")
        history["x_near"][:] = history["x"]
        history["since"][0] = 0.0

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """See `DynamicContact`."""
        history["gone"][0] += travel
        self._measure(x, history, travel)
        late = 0
        for k, p in enumerate(self.passes):
            late += track_kernels.track_partners(
                x,
                p.slaves,
                history[f"near{k}"],
                int(history[f"count{k}"][0]),
                kernels.POINTS,
                p.areas,
                p.masters,
                history[f"candidates{k}"],
                self.depth,
                self.margin,
                history[f"way{k}"],
                LOOK_SHARE * self.skin,
                CLOSE_SHARE * self.skin,
                SLACK_SHARE * self.skin,
                float(history["gone"][0]),
                history[f"ready{k}"],
                max(0.5 * COUNT_SHARE * self.skin, 2.0 * rate_margin(travel)),
                history[f"allowed{k}"],
                self.law.traction_coefficient,
                self.law.stiffness_exponent,
                SHARE,
                history[f"partner{k}"],
                history[f"local{k}"],
                history[f"gap{k}"],
                history[f"offset{k}"],
                history[f"dropped{k}"],
            )
        # A search may have found more faces: those that are near enough to matter are late too.
        return late > 0

    def _measure(self, x: np.ndarray, history: History, travel: float) -> None:
        """Count the ways of near faces, and search where a search is due.

        Relative motion is measured when any node may have gone far enough at all, and when half of
        what is left would be used up at the pace so far.
        """
        limit = WAY_SHARE * self.skin
        history["age"][0] += 1
        history["way"][0] += travel
        age = int(history["age"][0])
        if history["way"][0] <= limit or age < history["next"][0]:
            return
        moved = self._relative_motion(history["x_near"], x)
        left = limit - moved
        if left > 0.2 * limit:
            wait = int(0.5 * left * age / max(moved, 1e-300)) if moved > 0.0 else self.check_every
            # Nor longer than it takes the fastest node to go as far as ways may go uncounted.
            wait = min(wait, self.check_every, int(limit / max(travel, 1e-300)))
            history["next"][0] = age + max(wait, 1)
            return
        for k, p in enumerate(self.passes):
            track_kernels.add_ways(
                p.slaves,
                p.masters,
                history[f"candidates{k}"],
                history[f"near{k}"],
                int(history[f"count{k}"][0]),
                self._moved,
                history[f"way{k}"],
            )
        # No point has moved farther than the sum of its ways.
        history["since"][0] += moved
        if history["since"][0] > SEARCH_SHARE * self.skin:
            history["since"][0] = self._relative_motion(history["x"], x)
        if history["since"][0] > SEARCH_SHARE * self.skin:
            self._search(x, history)
        else:
            np.take(x, self.watched, axis=0, out=history["x_near"], mode="clip")
        history["way"][0] = 0.0
        history["age"][0] = 0
        wait = min(age // 2, self.check_every, int(limit / max(travel, 1e-300)))
        history["next"][0] = max(wait, 1)

    def _relative_motion(self, before: np.ndarray, x: np.ndarray) -> float:
        """Largest way of a node [m] beyond a rigid motion; `_moved` has the way of each."""
        return float(track_kernels.relative_motion(before, x, self.watched, self._moved))

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
        deeper = 0
        for k, p in enumerate(self.passes):
            self._partial[:] = 0.0
            deeper += track_kernels.pair_forces(
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
                history[f"offset{k}"],
                self.depth,
                self.margin,
                history[f"allowed{k}"],
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
                SHARE,
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
        self.deeper = deeper > 0

    def near_travel(self, v: np.ndarray, history: History, dt: float, travel: float) -> float:
        """See `DynamicContact`; both surfaces move, at most so far each."""
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
            near = self._counted(history, k, margin)
            rate_kernels.pair_rates(
                p.slaves,
                near,
                near.size,
                kernels.POINTS,
                p.areas,
                p.masters,
                self._half[k],
                history[f"partner{k}"],
                history[f"local{k}"],
                history[f"gap{k}"],
                history[f"offset{k}"],
                margin,
                self.margin,
                law.traction_coefficient,
                law.stiffness_exponent,
                law.damping_coefficient,
                law.indentation_exponent,
                law.stick_stiffness if self.friction.static > 0.0 else 0.0,
                SHARE,
                inverse_mass,
                springs,
                dashpots,
            )

    def _counted(self, history: History, k: int, margin: float) -> np.ndarray:
        """Near faces that touch or may within some steps, of pass `k`.

        What comes nearer later is noticed by `prepare`, two steps before it touches.
        """
        near = history[f"near{k}"][: int(history[f"count{k}"][0])]
        nearest = history[f"gap{k}"][near].min(axis=1, initial=np.inf)
        return near[nearest < max(COUNT_SHARE * self.skin, 4.0 * margin)]

    def allow(
        self,
        history: History,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
        elements: np.ndarray,
        omega: float,
    ) -> float:
        """See `DynamicContact`."""
        growth = max(self.law.stiffness_exponent - 1.0, self.law.indentation_exponent)
        for k, p in enumerate(self.passes):
            rate_kernels.allowed_depths(
                p.slaves,
                self._counted(history, k, margin),
                p.masters,
                history[f"partner{k}"],
                history[f"local{k}"],
                history[f"gap{k}"],
                history[f"offset{k}"],
                margin,
                growth,
                springs,
                dashpots,
                elements,
                omega,
                history[f"allowed{k}"],
            )
        return math.inf

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

    def dropped(self, history: History) -> float:
        """See `DynamicContact`."""
        return sum(float(history[f"dropped{k}"].sum()) for k in range(len(self.passes)))

    def begin_anew(self, history: History) -> None:
        """See `DynamicContact`."""
        for k in range(len(self.passes)):
            history[f"dropped{k}"][:] = 0.0


def half_edges(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Half of the shortest edge of each face [m]: what a local coordinate of one stands for."""
    corners = nodes[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return np.asarray(0.5 * edges.min(axis=1))
