"""Faces on fixed ground over time."""

from __future__ import annotations

import math

import numpy as np

from flexapod.contact import ground_kernels, kernels, rate_kernels
from flexapod.contact.ground import Ground, Plane
from flexapod.contact.law import ContactLaw
from flexapod.core.errors import InputError, SolverError, Status
from flexapod.dynamics import kernels as dynamics_kernels
from flexapod.dynamics import line_kernels
from flexapod.dynamics.contacts import DEPTH, TOTALS, History
from flexapod.dynamics.line_kernels import GroundArrays


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
        self.deeper = False  # its deepest point is looked at instead
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

    def _search(self, x: np.ndarray, history: History) -> bool:
        return bool(line_kernels.search_ground(self._at_points(x, 0), self.packed(history)))

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """See `DynamicContact`: a face out of the skin cannot arrive before it has crossed it."""
        history["way"][0] += self.reach * travel
        if history["way"][0] <= self.skin:
            return False
        return self._search(x, history)

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
        rate_kernels.contact_rates(
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
        return float(history["depth"][0]) + margin

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

    def dropped(self, history: History) -> float:
        """See `DynamicContact`; the ground has no rims."""
        return 0.0

    def begin_anew(self, history: History) -> None:
        """See `DynamicContact`."""


def gaps(ground: Ground, x: np.ndarray) -> np.ndarray:
    """Signed distance of points (count, 3) from the ground [m]."""
    out = np.empty(len(x))
    dynamics_kernels.ground_gaps(np.ascontiguousarray(x), *ground.packed(), out)
    return out
