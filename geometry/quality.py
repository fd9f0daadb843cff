"""What a mesh is worth: shapes, sizes, counts, volumes and mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexapod.geometry.tagged import TaggedMesh

# The three corners joined to each corner, so that their edges form a right-handed frame.
_FRAMES = np.array(
    [[1, 3, 4], [2, 0, 5], [3, 1, 6], [0, 2, 7], [7, 5, 0], [4, 6, 1], [5, 7, 2], [6, 4, 3]]
)
_EDGES = np.array(
    [
        [0, 1],
        [1, 2],
        [2, 3],
        [3, 0],
        [4, 5],
        [5, 6],
        [6, 7],
        [7, 4],
        [0, 4],
        [1, 5],
        [2, 6],
        [3, 7],
    ]
)
_SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]]
    + [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
)


def corner_jacobians(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Determinant of the three edges at each corner [m3], shape (cell_count, 8)."""
    return _corner_jacobians(nodes, cells)[0]


def _corner_jacobians(nodes: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Determinants and products of edge lengths at each corner [m3]."""
    x = nodes[cells]
    edges = x[:, _FRAMES, :] - x[:, :, None, :]
    return np.linalg.det(edges), np.prod(np.linalg.norm(edges, axis=-1), axis=-1)


def scaled_jacobians(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Least scaled Jacobian of each hexahedron: 1 for a brick, <= 0 for a folded one.

    The least, over the corners, of the triple product of the three edges divided by the
    product of their lengths. Shape (cell_count,).
    """
    determinant, product = _corner_jacobians(nodes, cells)
    return np.min(determinant / np.where(product > 0.0, product, 1.0), axis=1)


def cell_volumes(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Volume of each trilinear hexahedron by two Gauss points per direction [m3]."""
    x = nodes[cells]
    volumes = np.zeros(len(cells))
    for point in _SIGNS / np.sqrt(3.0):
        factors = 1.0 + _SIGNS * point
        gradient = np.stack(
            [
                _SIGNS[:, a] * factors[:, (a + 1) % 3] * factors[:, (a + 2) % 3] / 8.0
                for a in range(3)
            ]
        )
        volumes += np.linalg.det(np.einsum("an,cni->cai", gradient, x))
    return volumes


@dataclass(frozen=True)
class MeshQuality:
    """Report of a mesh.

    Attributes
    ----------
    node_count, cell_count
        Nodes and hexahedra.
    least_scaled_jacobian
        1 for bricks, <= 0 if an element is folded.
    shortest_edge, longest_edge
        Edge lengths [m].
    largest_aspect
        Longest over shortest edge of one element, the largest of all.
    volume
        Volume of all hexahedra [m3].
    group_volumes
        Volume of each cell group [m3].
    cavity_volumes
        Air inside each cavity [m3]; exact when symmetry planes pass through the origin.
    expected_volume
        Closed-form volume [m3], or None.
    density
        Density for the mass [kg/m3], or None.
    """

    node_count: int
    cell_count: int
    least_scaled_jacobian: float
    shortest_edge: float
    longest_edge: float
    largest_aspect: float
    volume: float
    group_volumes: dict[str, float]
    cavity_volumes: dict[str, float]
    expected_volume: float | None = None
    density: float | None = None

    @property
    def volume_error(self) -> float | None:
        """Relative difference of the volume from the closed form."""
        if self.expected_volume is None:
            return None
        return self.volume / self.expected_volume - 1.0

    @property
    def mass(self) -> float | None:
        """Mass of all hexahedra at the density [kg]."""
        return None if self.density is None else self.density * self.volume

    @property
    def expected_mass(self) -> float | None:
        """Mass of the closed-form volume at the density [kg]."""
        if self.density is None or self.expected_volume is None:
            return None
        return self.density * self.expected_volume

    def text(self) -> str:
        """The report in lines of text."""
        lines = [
            f"hexahedra              {self.cell_count}",
            f"nodes                  {self.node_count}",
            f"edges                  {self.shortest_edge * 1e3:.4g} to "
            f"{self.longest_edge * 1e3:.4g} mm",
            f"largest aspect ratio   {self.largest_aspect:.3g}",
            f"least scaled Jacobian  {self.least_scaled_jacobian:.4g}",
            f"volume                 {self.volume * 1e6:.6g} cm3",
        ]
        if self.expected_volume is not None:
            lines.append(
                f"volume by formula      {self.expected_volume * 1e6:.6g} cm3 "
                f"(relative difference {self.volume_error:.1e})"
            )
        if self.mass is not None:
            formula = "" if self.expected_mass is None else f", {self.expected_mass:.5g} by formula"
            lines.append(
                f"mass                   {self.mass:.5g} kg at {self.density:g} kg/m3{formula}"
            )
        for label, volumes in (("cells", self.group_volumes), ("cavity", self.cavity_volumes)):
            lines += [f"{label:7}{name:24}{v * 1e6:.6g} cm3" for name, v in volumes.items()]
        return "\n".join(lines)


def mesh_quality(
    mesh: TaggedMesh, expected_volume: float | None = None, density: float | None = None
) -> MeshQuality:
    """Measure a mesh.

    Parameters
    ----------
    mesh
        The mesh.
    expected_volume
        Closed-form volume [m3] to compare with, from a builder.
    density
        Density [kg/m3] for the mass.
    """
    volumes = cell_volumes(mesh.nodes, mesh.cells)
    x = mesh.nodes[mesh.cells]
    edges = np.linalg.norm(x[:, _EDGES[:, 1]] - x[:, _EDGES[:, 0]], axis=-1)
    shortest, longest = edges.min(axis=1), edges.max(axis=1)
    with np.errstate(divide="ignore"):
        aspect = float(np.max(longest / shortest))
    return MeshQuality(
        node_count=len(mesh.nodes),
        cell_count=len(mesh.cells),
        least_scaled_jacobian=float(scaled_jacobians(mesh.nodes, mesh.cells).min()),
        shortest_edge=float(shortest.min()),
        longest_edge=float(longest.max()),
        largest_aspect=aspect,
        volume=float(volumes.sum()),
        group_volumes={n: float(volumes[c].sum()) for n, c in mesh.cell_groups.items()},
        cavity_volumes={n: mesh.cavity_volume(n) for n in mesh.cavities},
        expected_volume=expected_volume,
        density=density,
    )
