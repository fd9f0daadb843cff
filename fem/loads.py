"""Loads and supports. Each load remembers nothing: the path says how much of it acts.

A load adds its part of the residual (internal minus external force) at positions `x` for a
factor, and lists its stiffness as dense symmetric matrices over node sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexapod.core.errors import InputError
from flexapod.fem import load_kernels

Stiffness = tuple[np.ndarray, np.ndarray]
"""Node sets (item_count, k) and symmetric matrices (item_count, 3k, 3k) [N/m]."""


class Load(Protocol):
    """What the path asks of a load."""

    name: str

    def add_residual(self, x: np.ndarray, factor: float, residual: np.ndarray) -> None:
        """Add this load's part [N] to `residual` (node_count, 3) at positions `x` [m]."""
        ...

    def stiffness(self, x: np.ndarray, factor: float) -> Stiffness | None:
        """Return the load stiffness, or None for a dead load."""
        ...

    def scale(self, x: np.ndarray) -> float:
        """Largest nodal force [N] at factor one: the size convergence is measured against."""
        ...


@dataclass(frozen=True)
class CavityPressure:
    """Follower pressure [Pa] on faces that look into a cavity (their normal leaves the solid)."""

    name: str
    faces: np.ndarray  # corner quadruples, shape (face_count, 4)
    pressure: float  # at factor one [Pa], positive pushes the walls apart

    def add_residual(self, x: np.ndarray, factor: float, residual: np.ndarray) -> None:
        """See `Load`."""
        load_kernels.pressure_force(x, self.faces, factor * self.pressure, residual)

    def stiffness(self, x: np.ndarray, factor: float) -> Stiffness | None:
        """See `Load`; symmetric, exact for a closed cavity."""
        if factor * self.pressure == 0.0:
            return None
        out = np.empty((self.faces.shape[0], 12, 12))
        load_kernels.pressure_stiffness(x, self.faces, factor * self.pressure, out)
        return self.faces, out

    def scale(self, x: np.ndarray) -> float:
        """See `Load`."""
        force = np.zeros_like(x)
        self.add_residual(x, 1.0, force)
        return float(np.abs(force).max())


@dataclass(frozen=True)
class DeadLoad:
    """Forces on nodes that keep size and direction: gravity, tractions, point forces."""

    name: str
    force: np.ndarray  # at factor one [N], shape (node_count, 3)

    def add_residual(self, x: np.ndarray, factor: float, residual: np.ndarray) -> None:
        """See `Load`."""
        residual -= factor * self.force

    def stiffness(self, x: np.ndarray, factor: float) -> Stiffness | None:
        """See `Load`."""
        return None

    def scale(self, x: np.ndarray) -> float:
        """See `Load`."""
        return float(np.abs(self.force).max())


def gravity(name: str, node_mass: np.ndarray, acceleration: Sequence[float]) -> DeadLoad:
    """Weight of nodes of `node_mass` [kg] under `acceleration` [m/s2]."""
    return DeadLoad(name, node_mass[:, None] * np.asarray(acceleration, dtype=float))


def traction(name: str, nodes: np.ndarray, faces: np.ndarray, value: Sequence[float]) -> DeadLoad:
    """A traction [Pa] of fixed direction over the reference area of `faces`."""
    share = face_node_areas(nodes, faces)
    return DeadLoad(name, share[:, None] * np.asarray(value, dtype=float))


def surface_force(
    name: str, nodes: np.ndarray, faces: np.ndarray, total: Sequence[float]
) -> DeadLoad:
    """A total force [N] spread evenly over the reference area of `faces`."""
    share = face_node_areas(nodes, faces)
    return DeadLoad(name, share[:, None] / share.sum() * np.asarray(total, dtype=float))


def face_node_areas(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Reference area each node stands for on `faces` [m2], shape (node_count,)."""
    from flexapod.contact import kernels as contact_kernels

    areas = np.empty((faces.shape[0], 4))
    contact_kernels.point_areas(nodes, faces, contact_kernels.POINTS, areas)
    total = np.zeros(nodes.shape[0])
    weight = np.zeros(nodes.shape[0])
    contact_kernels.nodal_average(
        faces, contact_kernels.POINTS, areas, np.ones_like(areas), total, weight
    )
    return total


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement of some nodes along one axis; zero makes a support.

    Several may be given for a node and an axis as long as they agree; see `Conditions`.
    """

    name: str
    node_index: np.ndarray  # shape (count,)
    axis: int  # 0, 1 or 2
    value: float = 0.0  # at factor one [m]


class Conditions:
    """All prescribed degrees of freedom of a problem.

    Raises
    ------
    InputError
        A node and axis are held and moved, moved by two names (whose factors differ along the
        path), or given two values by one name. Any number of supports may meet at a node.
    """

    def __init__(self, node_count: int, displacements: Sequence[Displacement]) -> None:
        self.fixed = np.zeros((node_count, 3), dtype=bool)
        self._parts = list(displacements)
        owner = np.zeros((node_count, 3), dtype=int)  # index of the first part, where fixed
        value = np.zeros((node_count, 3))
        named = np.array([part.name for part in self._parts], dtype=object)
        for index, part in enumerate(self._parts):
            at = (np.asarray(part.node_index, dtype=int), part.axis)
            other = (value[at] != part.value) | (
                (part.value != 0.0) & (named[owner[at]] != part.name)
            )
            clash = at[0][self.fixed[at] & other]
            if clash.size:
                first = self._parts[owner[clash[0], part.axis]]
                raise InputError(_clash(int(clash[0]), first, part))
            owner[at] = np.where(self.fixed[at], owner[at], index)
            value[at] = part.value
            self.fixed[at] = True

    @property
    def names(self) -> list[str]:
        """Names of the parts that move."""
        return sorted({p.name for p in self._parts if p.value != 0.0})

    def apply(self, u: np.ndarray, factors: dict[str, float]) -> None:
        """Write the prescribed values into `u` (node_count, 3) [m]."""
        u[self.fixed] = 0.0
        for part in self._parts:
            if part.value != 0.0:
                u[part.node_index, part.axis] = part.value * factors.get(part.name, 0.0)


def _clash(node: int, first: Displacement, second: Displacement) -> str:
    """What is wrong with two displacements of one node along one axis."""
    axis = "xyz"[first.axis]
    if first.name == second.name:
        return (
            f"node {node} is given two displacements along axis {axis} by {first.name!r}: "
            f"{first.value:g} m and {second.value:g} m"
        )
    if first.value != 0.0 and second.value != 0.0:
        return f"node {node} is moved along axis {axis} by both {first.name!r} and {second.name!r}"
    held, moved = (first, second) if first.value == 0.0 else (second, first)
    return (
        f"node {node} is held along axis {axis} by {held.name!r} and moved by {moved.name!r}; "
        "take it out of one of them"
    )


class Cavity:
    """The volume inside named faces, closed across symmetry planes by flat lids."""

    def __init__(self, name: str, faces: np.ndarray) -> None:
        self.name = name
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        edges = np.concatenate([np.roll(self.faces, -k, axis=1)[:, :2] for k in range(4)])
        forward = {(int(a), int(b)) for a, b in edges}
        open_edges = [(a, b) for a, b in sorted(forward) if (b, a) not in forward]
        self._lids = _loops(open_edges)

    @property
    def closed(self) -> bool:
        """Whether the faces enclose the volume without lids."""
        return not self._lids

    def volume(self, x: np.ndarray) -> float:
        """Enclosed volume at positions `x` [m3]."""
        total = float(load_kernels.enclosed_volume(x, self.faces))
        for loop in self._lids:
            a, b = x[loop[:, 0]], x[loop[:, 1]]
            # The lid runs against the surface's own edges; its triangles close the volume.
            total -= float((np.cross(b, a) @ _lid_centre(a)).sum()) / 6.0
        return total


def _lid_centre(rim: np.ndarray) -> np.ndarray:
    """A point in every coordinate plane that parts of a rim lie in, so that its fan is flat.

    A cavity cut by several symmetry planes has one rim that turns from plane to plane.
    """
    centre = rim.mean(axis=0)
    size = float(np.ptp(rim, axis=0).max())
    for axis in range(3):
        for value in (rim[:, axis].min(), rim[:, axis].max()):
            if (np.abs(rim[:, axis] - value) < 1e-9 * size).sum() >= 3:
                centre[axis] = value
                break
    return np.asarray(centre)


def _loops(edges: list[tuple[int, int]]) -> list[np.ndarray]:
    """Group directed boundary edges into connected sets."""
    if not edges:
        return []
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    array = np.array(edges)
    nodes, local = np.unique(array, return_inverse=True)
    local = local.reshape(array.shape)
    graph = coo_matrix(
        (np.ones(len(array)), (local[:, 0], local[:, 1])), shape=(nodes.size, nodes.size)
    )
    _, label = connected_components(graph, directed=False)
    return [array[label[local[:, 0]] == k] for k in range(label.max() + 1)]
