"""Read and write tagged hexahedral meshes through meshio.

Convention
----------
A file holds hexahedra and, for the surfaces, the quads that lie on them. Groups are stored

- in Gmsh files (.msh) as physical groups. An element in several groups has one physical name
  that joins theirs with "+", for example ``silicone+main``; no element is written twice. Read
  are formats 2.2 and 4.1, written is 2.2 (binary).
- in all other files as one integer array per group over the cells, ``group_<name>``, 1 inside
  and 0 outside: on hexahedra a cell group, on quads a facet group. Cell sets, where a format
  has them, are read as groups too.

Lengths are metres. Facet groups whose name begins with "cavity" enclose air. Facets are turned
outward by the hexahedron they belong to. Nodes that no hexahedron uses are dropped, as are
groups without a member.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.core.errors import InputError
from flexapod.geometry.quality import corner_jacobians
from flexapod.geometry.tagged import TaggedMesh, cavity_names, orient_outward

_PREFIX = "group_"
_JOIN = "+"
_IGNORED = ("vertex", "line", "line3")
_SUFFIXES = (".msh", ".vtu", ".vtk")


def read_mesh(path: str | Path, scale: float = 1.0) -> TaggedMesh:
    """Read a mesh of eight-node hexahedra in any format meshio knows.

    Parameters
    ----------
    path
        The file.
    scale
        Metres per length unit of the file.

    Returns
    -------
    The mesh with its cell groups, facet groups and cavities.

    Raises
    ------
    InputError
        If the file cannot be read, holds other solid or surface elements, a folded
        hexahedron, or facets that belong to no hexahedron.
    """
    import meshio

    path = Path(path)
    where = str(path)
    if not path.is_file():
        raise InputError("no such mesh file", where)
    # meshio prints its failed guesses to standard output, which belongs to the caller, and ends
    # the process on some bad files.
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            data = meshio.read(path)
    except (Exception, SystemExit) as problem:
        reason = " ".join(said.getvalue().split()) or str(problem) or type(problem).__name__
        raise InputError(f"meshio cannot read it: {reason}", where) from None
    types = {block.type for block in data.cells}
    foreign = sorted(types - {"hexahedron", "quad", *_IGNORED})
    if foreign:
        raise InputError(
            f"only eight-node hexahedra and four-node surface quads can be used, found "
            f"{', '.join(foreign)}: mesh with hexahedra of first order",
            where,
        )
    if "hexahedron" not in types:
        raise InputError("the file holds no hexahedron", where)
    points = np.asarray(data.points, dtype=float) * scale
    if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
        raise InputError("node positions must be three finite numbers each", where)

    hexes, hex_groups = _collect(data, "hexahedron")
    quads, quad_groups = _collect(data, "quad")
    hexes, hex_groups = _without_repeats(hexes, hex_groups)
    used, cells = np.unique(hexes, return_inverse=True)
    cells = cells.reshape(-1, 8)
    nodes = points[used]
    worst = corner_jacobians(nodes, cells).min(axis=1)
    folded = np.flatnonzero(worst <= 0.0)
    if len(folded):
        every = (
            " (all of them: the corners are listed mirrored)" if len(folded) == len(cells) else ""
        )
        raise InputError(
            f"{len(folded)} hexahedra are folded or inside out{every}; the first is hexahedron "
            f"{folded[0]} with nodes {hexes[folded[0]].tolist()}",
            where,
        )
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    facet_groups = {}
    for name, members in quad_groups.items():
        corners = number[quads[members]]
        if np.any(corners < 0):
            raise InputError(f"a facet of {name!r} belongs to no hexahedron", where)
        facet_groups[name] = corners
    try:
        facet_groups = _orient_all(cells, facet_groups)
    except InputError as problem:
        raise InputError(str(problem), where) from None
    return TaggedMesh(nodes, cells, hex_groups, facet_groups, cavity_names(facet_groups))


def _collect(data: Any, kind: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """All elements of one type and the groups they are in, as indices into them."""
    width = 8 if kind == "hexahedron" else 4
    blocks = [i for i, block in enumerate(data.cells) if block.type == kind]
    parts = [np.asarray(data.cells[i].data, dtype=np.int64) for i in blocks]
    elements = np.concatenate([np.empty((0, width), dtype=np.int64), *parts])
    starts = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)
    members: dict[str, list[np.ndarray]] = {}

    def put(names: Iterable[str], indices: np.ndarray) -> None:
        for name in names:
            if name and len(indices):
                members.setdefault(name, []).append(np.asarray(indices, dtype=np.int64))

    dimension = 3 if kind == "hexahedron" else 2
    physical = {
        int(tag): name for name, (tag, dim) in data.field_data.items() if int(dim) == dimension
    }
    for name, arrays in data.cell_sets.items():
        # meshio's own bookkeeping ("gmsh:bounding_entities") is no group.
        if name.startswith("gmsh:"):
            continue
        for start, i in zip(starts, blocks, strict=False):
            if arrays[i] is not None:
                put(name.split(_JOIN), start + np.asarray(arrays[i], dtype=np.int64))
    for name, arrays in data.cell_data.items():
        for start, i in zip(starts, blocks, strict=False):
            values = np.asarray(arrays[i]).reshape(len(data.cells[i].data), -1)[:, 0]
            if name == "gmsh:physical":
                for tag in np.unique(np.abs(values)):
                    # Volumes without a name still carry their number as one.
                    label = physical.get(int(tag), f"physical_{int(tag)}" if tag else "")
                    put(label.split(_JOIN), start + np.flatnonzero(np.abs(values) == tag))
            elif name.startswith(_PREFIX):
                put([name.removeprefix(_PREFIX)], start + np.flatnonzero(values != 0))
    return elements, {name: np.unique(np.concatenate(m)) for name, m in members.items()}


def _orient_all(cells: np.ndarray, groups: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Turn the facets of all groups outward in one search."""
    ends = np.cumsum([len(quads) for quads in groups.values()])
    try:
        turned = orient_outward(
            cells, np.concatenate([np.empty((0, 4), dtype=np.int64), *groups.values()])
        )
    except InputError:
        # Once more, group by group, to say which one is wrong.
        return {name: orient_outward(cells, quads, name) for name, quads in groups.items()}
    return dict(zip(groups, np.split(turned, ends[:-1]), strict=True)) if groups else {}


def _without_repeats(
    hexes: np.ndarray, groups: dict[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Merge hexahedra listed once per group, as Gmsh's format 2.2 does."""
    _, first, inverse = np.unique(
        np.sort(hexes, axis=1), axis=0, return_index=True, return_inverse=True
    )
    if len(first) == len(hexes):
        return hexes, groups
    kept = np.sort(first)
    row = np.searchsorted(kept, first)[inverse.ravel()]
    return hexes[kept], {name: np.unique(row[members]) for name, members in groups.items()}


def write_mesh(mesh: TaggedMesh, path: str | Path) -> Path:
    """Write a mesh with its groups, whole or not at all.

    Parameters
    ----------
    mesh
        The mesh.
    path
        File ending in .msh (Gmsh 2.2), .vtu or .vtk; an existing file is replaced.

    Returns
    -------
    The path written.
    """
    import meshio

    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError(
            f"a mesh is written as {', '.join(_SUFFIXES)}, got {path.suffix or 'no suffix'!r}",
            str(path),
        )
    quads, quad_groups = _merged_facets(mesh)
    for name in (*mesh.cell_groups, *mesh.facet_groups):
        if _JOIN in name or '"' in name or not name:
            raise InputError(f"group name {name!r} cannot be written: no {_JOIN!r} or quotes")
    cells = [("hexahedron", mesh.cells)] + ([("quad", quads)] if len(quads) else [])
    memberships = [_membership(len(mesh.cells), mesh.cell_groups)]
    if len(quads):
        memberships.append(_membership(len(quads), quad_groups))
    if suffix == ".msh":
        data = meshio.Mesh(mesh.nodes, cells, **_gmsh_tags(memberships))

        def write(target: Path) -> None:
            meshio.write(target, data, file_format="gmsh22", binary=True)
    else:
        names = list(dict.fromkeys([*mesh.cell_groups, *mesh.facet_groups]))
        arrays = {
            _PREFIX + name: [
                groups.get(name, np.zeros(len(block), dtype=bool)).astype(np.int32)
                for groups, (_, block) in zip(memberships, cells, strict=True)
            ]
            for name in names
        }
        data = meshio.Mesh(mesh.nodes, cells, cell_data=arrays)

        def write(target: Path) -> None:
            meshio.write(target, data, file_format=suffix[1:])

    _replace_whole(path, write)
    return path


def _replace_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Write beside `path`, then put the finished file in its place."""
    if not path.parent.is_dir():
        raise InputError(f"folder {path.parent} does not exist", str(path))
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix.lower()}")
    try:
        write(partial)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _merged_facets(mesh: TaggedMesh) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Each facet once, in order of first appearance, and the groups as indices into them."""
    names = list(mesh.facet_groups)
    parts = [np.asarray(mesh.facet_groups[n], dtype=np.int64).reshape(-1, 4) for n in names]
    quads = np.concatenate([np.empty((0, 4), dtype=np.int64), *parts])
    _, first, inverse = np.unique(
        np.sort(quads, axis=1), axis=0, return_index=True, return_inverse=True
    )
    kept = np.sort(first)
    row = np.searchsorted(kept, first)[inverse.ravel()]
    ends = np.cumsum([0] + [len(p) for p in parts])
    groups = {n: row[ends[i] : ends[i + 1]] for i, n in enumerate(names)}
    return quads[kept], groups


def _membership(count: int, groups: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Each group as a mask over `count` elements."""
    masks = {}
    for name, members in groups.items():
        masks[name] = np.zeros(count, dtype=bool)
        masks[name][members] = True
    return masks


def _gmsh_tags(memberships: list[dict[str, np.ndarray]]) -> dict[str, Any]:
    """Physical numbers and names: one per combination of groups that occurs."""
    field_data: dict[str, np.ndarray] = {}
    tags = []
    for groups, dimension in zip(memberships, (3, 2), strict=False):
        masks = np.stack(list(groups.values()), axis=1) if groups else None
        if masks is None:
            raise InputError("a mesh without cell groups cannot be written as .msh: add one")
        rows, inverse = np.unique(masks, axis=0, return_inverse=True)
        numbers = np.zeros(len(rows), dtype=np.int32)
        for i, row in enumerate(rows):
            name = _JOIN.join(n for n, inside in zip(groups, row, strict=True) if inside)
            if name:
                numbers[i] = len(field_data) + 1
                # A surface and a solid may share a name, but meshio keeps one entry per name.
                if name in field_data:
                    raise InputError(f"a cell group and a facet group are both named {name!r}")
                field_data[name] = np.array([numbers[i], dimension])
        tags.append(numbers[inverse.ravel()])
    return {
        "field_data": field_data,
        "cell_data": {"gmsh:physical": tags, "gmsh:geometrical": [t.copy() for t in tags]},
    }
