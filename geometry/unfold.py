"""The whole of a body of which symmetry planes left a part."""

from __future__ import annotations

import numpy as np

from flexapod.core.errors import InputError
from flexapod.geometry.tagged import TaggedMesh, cavity_names

# A mirrored hexahedron has a positive volume when both its layers are read backwards, and a
# mirrored quadrilateral looks outward when it is.
_CELL = np.array([0, 3, 2, 1, 4, 7, 6, 5])
_QUAD = np.array([0, 3, 2, 1])


def unfold(mesh: TaggedMesh, axis: int) -> tuple[TaggedMesh, np.ndarray]:
    """Join a mesh with its mirror image in the plane through the origin normal to `axis`.

    The first nodes and cells are the mesh's own. A group in the plane goes, one that touches it
    grows. Away from the plane, facet groups of one name are united, only ends ("end", "end_...")
    get a twin named "..._mirrored", as do the cell groups of a material: they are other parts of
    the body. In a mirror along y, "right" and "left" in a name change places.

    Returns
    -------
    The mesh, and for each of its nodes the node of `mesh` it is or mirrors, shape (node_count,);
    nodes from ``len(mesh.nodes)`` on are images.
    """
    nodes = mesh.nodes
    size = float(np.ptp(nodes, axis=0).max())
    on_plane = np.abs(nodes[:, axis]) < 1e-9 * size
    if not on_plane.any() or (nodes[:, axis] < -1e-9 * size).any():
        raise InputError(
            f"a mesh is unfolded where it ends at the plane {'xyz'[axis]} = 0 and lies on its "
            "positive side"
        )
    count = len(nodes)
    own = np.flatnonzero(~on_plane)
    image = np.arange(count)
    image[own] = count + np.arange(len(own))
    mirror = np.ones(3)
    mirror[axis] = -1.0
    source = np.concatenate([np.arange(count), own])
    cells = np.concatenate([mesh.cells, image[mesh.cells[:, _CELL]]])
    shift = len(mesh.cells)
    cell_groups: dict[str, np.ndarray] = {}
    for name, members in mesh.cell_groups.items():
        members = np.asarray(members)
        touches = on_plane[mesh.cells[members]].any()
        if touches or name not in mesh.material_groups:
            cell_groups[name] = np.concatenate([members, members + shift])
        else:
            cell_groups[name] = members
            cell_groups[f"{name}_mirrored"] = members + shift
    quads: dict[str, list[np.ndarray]] = {}
    for name, faces in mesh.facet_groups.items():
        if on_plane[faces].all():
            continue
        quads.setdefault(name, []).append(faces)
        quads.setdefault(_swapped(name, axis), []).append(image[faces[:, _QUAD]])
    facet_groups = {name: np.concatenate(parts) for name, parts in quads.items()}
    whole = TaggedMesh(
        np.concatenate([nodes, nodes[own] * mirror]),
        cells,
        cell_groups,
        facet_groups,
        cavity_names(facet_groups),
    )
    return whole, source


def unfold_vectors(
    vectors: np.ndarray, source: np.ndarray, node_count: int, axis: int
) -> np.ndarray:
    """Nodal vectors of a mesh on its unfolded one: mirrored on the images."""
    out = np.asarray(vectors)[source].copy()
    out[node_count:, axis] *= -1.0
    return out


def unfold_shares(values: np.ndarray, source: np.ndarray, node_count: int) -> np.ndarray:
    """Nodal shares (mass, area) of a mesh on its unfolded one: nodes in the plane count twice."""
    out = np.asarray(values)[source].copy()
    images = np.zeros(node_count, dtype=bool)
    images[source[node_count:]] = True
    out[:node_count][~images] *= 2.0
    return out


def _swapped(name: str, axis: int) -> str:
    """What the mirror image of a facet group is called."""
    if axis == 0 and (name == "end" or name.startswith("end_")):
        return f"{name}_mirrored"
    if axis != 1:
        return name
    swap = {"right": "left", "left": "right"}
    return "_".join(swap.get(part, part) for part in name.split("_"))
