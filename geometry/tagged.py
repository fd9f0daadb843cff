"""The mesh record every floor shares: nodes, hexahedra and their names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexapod.core.errors import InputError

# Corner quadruples of a hexahedron's six faces in VTK/Gmsh node order, counter-clockwise
# seen from outside.
HEX_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)

# scikit-fem lists the corners of a hexahedron in another order: its corner i is VTK's
# _SKFEM_FROM_VTK[i].
_SKFEM_FROM_VTK = np.array([0, 4, 3, 1, 7, 5, 2, 6])


def _facet_keys(quads: np.ndarray) -> np.ndarray:
    """Corner numbers of each facet in ascending order, as one sortable record per facet."""
    ordered = np.sort(np.ascontiguousarray(quads, dtype=np.int64), axis=1)
    return ordered.view([(name, np.int64) for name in "abcd"]).ravel()


def boundary_facets(cells: np.ndarray) -> np.ndarray:
    """Outward quads that belong to one hexahedron only.

    Parameters
    ----------
    cells
        Hexahedra in VTK order, shape (m, 8).

    Returns
    -------
    Corner quadruples, counter-clockwise from outside, shape (n, 4), ordered by cell.
    """
    quads = np.asarray(cells)[:, HEX_FACES].reshape(-1, 4)
    ordered = np.sort(quads, axis=1)
    rank = np.lexsort(ordered.T[::-1])
    ordered = ordered[rank]
    same = np.all(ordered[1:] == ordered[:-1], axis=1)
    single = np.ones(len(quads), dtype=bool)
    single[rank[1:][same]] = False
    single[rank[:-1][same]] = False
    return quads[single]


def orient_outward(cells: np.ndarray, quads: np.ndarray, name: str = "facets") -> np.ndarray:
    """Turn each quad so that it is counter-clockwise seen from outside its hexahedron.

    A quad between two hexahedra takes the orientation of the one with the lower index.

    Parameters
    ----------
    cells
        Hexahedra in VTK order, shape (m, 8).
    quads
        Corner quadruples in cyclic order, either way round, shape (n, 4).
    name
        What to call the quads in an error.

    Returns
    -------
    Quads with the same first corner, shape (n, 4).
    """
    quads = np.asarray(quads, dtype=np.int64).reshape(-1, 4)
    if not len(quads):
        return quads
    faces = np.asarray(cells)[:, HEX_FACES].reshape(-1, 4)
    face_keys, quad_keys = _facet_keys(faces), _facet_keys(quads)
    rank = np.argsort(face_keys, kind="stable", order=("a", "b", "c", "d"))
    found = np.minimum(np.searchsorted(face_keys[rank], quad_keys), len(faces) - 1)
    owner = rank[found]
    stray = np.flatnonzero(face_keys[owner] != quad_keys)
    if len(stray):
        raise InputError(
            f"{len(stray)} of {len(quads)} facets of {name!r} belong to no hexahedron "
            f"(the first has nodes {quads[stray[0]].tolist()}): remove them or mesh them together"
        )
    face = faces[owner]
    start = np.argmax(face == quads[:, :1], axis=1)
    turned = np.take_along_axis(face, (start[:, None] + np.arange(4)) % 4, axis=1)
    forward = np.all(turned == quads, axis=1)
    backward = np.all(turned[:, [0, 3, 2, 1]] == quads, axis=1)
    crossed = np.flatnonzero(~(forward | backward))
    if len(crossed):
        raise InputError(
            f"facet {quads[crossed[0]].tolist()} of {name!r} lists the corners of a face crosswise"
        )
    return turned


@dataclass(frozen=True)
class TaggedMesh:
    """Eight-node hexahedra with named groups; a change makes a copy.

    Attributes
    ----------
    nodes
        Node positions [m], shape (node_count, 3).
    cells
        Hexahedra in VTK/Gmsh corner order, shape (cell_count, 8).
    cell_groups
        Name to cell indices. Groups that carry a material do not overlap.
    facet_groups
        Name to corner quadruples, shape (facet_count, 4), each counter-clockwise seen from
        outside the solid (the normal points out of the material, into a cavity for a cavity).
    cavities
        The names in `facet_groups` that enclose air.
    """

    nodes: np.ndarray
    cells: np.ndarray
    cell_groups: dict[str, np.ndarray] = field(default_factory=dict)
    facet_groups: dict[str, np.ndarray] = field(default_factory=dict)
    cavities: tuple[str, ...] = ()

    @property
    def material_groups(self) -> tuple[str, ...]:
        """Names of the cell groups that partition a built mesh: "silicone" and "servo_..."."""
        return tuple(n for n in self.cell_groups if n == "silicone" or n.startswith("servo_"))

    def facet_nodes(self, name: str) -> np.ndarray:
        """Sorted node indices of a facet group."""
        return np.unique(self._facets(name))

    def _facets(self, name: str) -> np.ndarray:
        if name not in self.facet_groups:
            known = ", ".join(sorted(self.facet_groups)) or "none"
            raise InputError(f"no surface is named {name!r}; the mesh has: {known}")
        return self.facet_groups[name]

    def with_nodes(self, nodes: np.ndarray) -> TaggedMesh:
        """Copy with other node positions [m], shape (node_count, 3)."""
        nodes = np.asarray(nodes, dtype=float)
        if nodes.shape != self.nodes.shape:
            raise InputError(f"nodes must have shape {self.nodes.shape}, got {nodes.shape}")
        return replace(self, nodes=nodes)

    def with_cell_group(self, name: str, cells: np.ndarray) -> TaggedMesh:
        """Copy with the cell indices `cells` under a name."""
        indices = np.unique(np.asarray(cells, dtype=np.int64))
        if len(indices) and not 0 <= indices[0] <= indices[-1] < len(self.cells):
            raise InputError(f"cell group {name!r} names cells outside 0..{len(self.cells) - 1}")
        return replace(self, cell_groups={**self.cell_groups, name: indices})

    def with_facet_group(self, name: str, quads: np.ndarray) -> TaggedMesh:
        """Copy with a facet group, its quads turned outward; "cavity..." becomes a cavity."""
        groups = {**self.facet_groups, name: orient_outward(self.cells, quads, name)}
        return replace(self, facet_groups=groups, cavities=cavity_names(groups))

    def cavity_volume(self, name: str) -> float:
        """Air volume inside a facet group by the divergence theorem [m3].

        Exact for a closed group, also with warped quads; a group cut by symmetry planes
        through the origin is closed by them at no cost.
        """
        corners = self.nodes[self._facets(name)]
        one, two, three, four = np.moveaxis(corners, 1, 0)
        middle = corners.mean(axis=1)
        pairs = ((one, two), (two, three), (three, four), (four, one))
        # Normals leave the material, hence the sign.
        return -sum(
            float(np.einsum("ij,ij->i", np.cross(start, stop), middle).sum()) / 6.0
            for start, stop in pairs
        )

    def to_skfem(self) -> Any:
        """Convert to a scikit-fem `MeshHex`; groups become subdomains and boundaries."""
        import skfem

        mesh = skfem.MeshHex(
            np.ascontiguousarray(self.nodes.T),
            np.ascontiguousarray(self.cells[:, _SKFEM_FROM_VTK].T),
        )
        keys = np.sort(mesh.facets.T, axis=1)
        rank = np.lexsort(keys.T[::-1])
        ordered = _facet_keys(keys[rank])
        boundaries = {
            name: np.unique(rank[np.searchsorted(ordered, _facet_keys(quads))])
            for name, quads in self.facet_groups.items()
        }
        subdomains = {name: np.asarray(cells) for name, cells in self.cell_groups.items()}
        return mesh.with_boundaries(boundaries).with_subdomains(subdomains)

    @classmethod
    def from_skfem(cls, mesh: Any) -> TaggedMesh:
        """Take nodes, hexahedra, subdomains and boundaries from a scikit-fem `MeshHex`."""
        cells = np.empty((mesh.t.shape[1], 8), dtype=np.int64)
        cells[:, _SKFEM_FROM_VTK] = mesh.t.T
        faces = cells[:, HEX_FACES].reshape(-1, 4)
        face_keys = _facet_keys(faces)
        rank = np.argsort(face_keys, kind="stable", order=("a", "b", "c", "d"))
        facet_groups = {}
        for name, facets in (mesh.boundaries or {}).items():
            keys = _facet_keys(mesh.facets.T[np.asarray(facets)])
            facet_groups[name] = faces[rank[np.searchsorted(face_keys[rank], keys)]]
        cell_groups = {n: np.asarray(c) for n, c in (mesh.subdomains or {}).items()}
        return cls(mesh.p.T.copy(), cells, cell_groups, facet_groups, cavity_names(facet_groups))


def box_mesh(low: np.ndarray, high: np.ndarray, counts: tuple[int, int, int]) -> TaggedMesh:
    """A box of even hexahedra between two corners [m], all of its surface in the group "outer"."""
    lines = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape([n + 1 for n in counts])
    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    a, b, c = counts
    cells = np.stack(
        [number[i : a + i, j : b + j, k : c + k].ravel() for i, j, k in corners], axis=1
    )
    return TaggedMesh(
        nodes,
        cells,
        {"silicone": np.arange(len(cells))},
        {"outer": boundary_facets(cells)},
        (),
    )


def cavity_names(facet_groups: Iterable[str]) -> tuple[str, ...]:
    """The facet groups that enclose air: those whose name begins with "cavity"."""
    return tuple(name for name in facet_groups if name.startswith("cavity"))
