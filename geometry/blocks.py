"""Bodies made of boxes: Gmsh meshes half a unit, the lattice repeats it without a seam.

A body is a row of equal units along x, each symmetric about its middle plane. Half a unit is
described by painted boxes; the planes of all boxes cut it into blocks that Gmsh fills with
transfinite, recombined hexahedra. All nodes lie on one integer lattice, so that mirrored and
shifted copies merge exactly and the numbering is the same on every machine.

The price is that a plane needed anywhere runs through the whole cross-section (a tensor grid):
refining one wall refines everything beside, above and below it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexapod.core.errors import InputError
from flexapod.geometry.gmsh_session import HEXAHEDRON, generate, gmsh_model
from flexapod.geometry.tagged import HEX_FACES, TaggedMesh, cavity_names

SYMMETRIES = ("whole", "half", "quarter")

# Lattice step to the neighbour behind each face of HEX_FACES, as (axis, step).
_FACE_STEPS = ((2, -1), (2, 1), (1, -1), (0, 1), (1, 1), (0, -1))
# Corner offsets of a hexahedron on the lattice, VTK order.
_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
_PLANE_TOLERANCE = 1e-9  # [m], planes nearer than this are one plane


@dataclass(frozen=True)
class Box:
    """One painted box of half a unit; later boxes paint over earlier ones.

    Attributes
    ----------
    x, y, z
        Intervals [m]; x from the unit's middle to half the pitch, y >= 0.
    material
        Cell group of the solid, or "" for a void.
    air
        Name of the void: "cavity_..." encloses air, "gap_..." is open space between chambers.
        A box with both is air between two units and solid at the body's ends (an air path).
    sided
        The void has separate left (y < 0) and right (y > 0) copies with those suffixes.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]
    material: str = ""
    air: str = ""
    sided: bool = False


@dataclass(frozen=True)
class Sizing:
    """How finely the planes are subdivided.

    Attributes
    ----------
    max_length
        Longest element edge [m].
    wall_elements
        Least number of elements through each wall named by the builder.
    """

    max_length: float
    wall_elements: int


@dataclass(frozen=True)
class UnitRow:
    """Half a unit as boxes, and how many units make the body.

    Attributes
    ----------
    boxes
        Painted boxes of half a unit (x >= 0 from its middle) and half the width (y >= 0).
    walls
        Per axis, the intervals [m] that count as walls for the subdivision.
    unit_count
        Units of the whole body.
    servo_boxes
        Boxes painted over a servo station: solids that are servo as the limit groups are.
    slot_boxes
        Boxes painted over a whole unit that makes room for a station; an air path that they
        paint over is solid also in the unit next to it.
    slot_length
        Length of what a station must neither cut nor touch, centred in a unit [m].

    The boxes of servo and slot add no planes: their sides lie on planes of the others.
    """

    boxes: tuple[Box, ...]
    walls: tuple[tuple[tuple[float, float], ...], ...]
    unit_count: int
    servo_boxes: tuple[Box, ...] = ()
    slot_boxes: tuple[Box, ...] = ()
    slot_length: float = 0.0

    @property
    def pitch(self) -> float:
        """Length of a unit [m]."""
        return 2.0 * max(box.x[1] for box in self.boxes)


def subdivide(
    planes: np.ndarray, walls: tuple[tuple[float, float], ...], sizing: Sizing
) -> np.ndarray:
    """Number of elements between neighbouring planes.

    Each interval gets the fewest elements not longer than `sizing.max_length`; then each wall
    gets `sizing.wall_elements` by splitting its longest element again and again.

    Parameters
    ----------
    planes
        Ascending plane positions [m], shape (n,).
    walls
        Intervals [m] whose ends are planes.
    sizing
        Longest edge and elements through walls.

    Returns
    -------
    Element counts, shape (n - 1,).
    """
    lengths = np.diff(planes)
    counts = np.maximum(1, np.ceil(lengths / sizing.max_length - 1e-9)).astype(int)
    for low, high in walls:
        first = int(np.argmin(np.abs(planes - low)))
        last = int(np.argmin(np.abs(planes - high)))
        while counts[first:last].sum() < sizing.wall_elements:
            # The small bias makes ties fall on the same interval whatever the rounding.
            edges = lengths[first:last] / counts[first:last]
            counts[first + int(np.flatnonzero(edges > edges.max() - 1e-9)[0])] += 1
    return counts


def _unique_planes(values: list[float]) -> np.ndarray:
    """Sorted positions with those closer than the tolerance merged."""
    ordered = np.unique(np.array(values))
    keep = np.concatenate([[True], np.diff(ordered) > _PLANE_TOLERANCE])
    return ordered[keep]


def _lines(planes: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """All lattice positions [m] between the planes."""
    parts = [
        np.linspace(planes[i], planes[i + 1], counts[i], endpoint=False)
        for i in range(len(planes) - 1)
    ]
    return np.concatenate([*parts, planes[-1:]])


def _paint(boxes: tuple[Box, ...], lines: list[np.ndarray]) -> np.ndarray:
    """Index of the box that owns each lattice cell, plus one; zero is the outside."""
    middles = [(line[:-1] + line[1:]) / 2.0 for line in lines]
    owner = np.zeros([len(m) for m in middles], dtype=int)
    for number, box in enumerate(boxes):
        inside = [
            (m > low) & (m < high)
            for m, (low, high) in zip(middles, (box.x, box.y, box.z), strict=True)
        ]
        owner[np.ix_(*inside)] = number + 1
    return owner


def _lattice(
    row: UnitRow, sizing: Sizing
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Planes of half a unit, elements between them and all lattice positions, per axis."""
    planes = [
        _unique_planes([v for box in row.boxes for v in interval(box)])
        for interval in (lambda b: b.x, lambda b: b.y, lambda b: b.z)
    ]
    counts = [subdivide(p, w, sizing) for p, w in zip(planes, row.walls, strict=True)]
    return planes, counts, [_lines(p, c) for p, c in zip(planes, counts, strict=True)]


def _row_lines(half_line: np.ndarray, unit_count: int, first: int) -> np.ndarray:
    """Lattice positions along x [m] from half unit `first` of 2 n to the body's right end."""
    pitch = 2.0 * float(half_line[-1])
    parts: list[np.ndarray] = []
    for half in range(first, 2 * unit_count):
        middle = (half // 2 + 0.5 - unit_count / 2.0) * pitch
        x = middle - half_line[::-1] if half % 2 == 0 else middle + half_line
        parts.append(x[1:] if parts else x)
    lines = np.concatenate(parts)
    if first == unit_count:
        lines[0] = 0.0
    return lines


@dataclass(frozen=True)
class Stations:
    """Servo stations on the lattice, and what gives way to them.

    Attributes
    ----------
    intervals
        Intervals of x [m] between lattice planes.
    slots
        Whether a unit makes room, shape (unit_count,); never without `UnitRow.servo_boxes`.
    shut
        Whether the slot's air path is closed between two units or at an end of the body, shape
        (unit_count + 1,).
    """

    intervals: tuple[tuple[float, float], ...]
    slots: np.ndarray
    shut: np.ndarray


def place_stations(
    row: UnitRow, sizing: Sizing, servos: tuple[tuple[float, float], ...]
) -> Stations:
    """Snap servo stations to the lattice and see which units make room for them.

    Parameters
    ----------
    row
        Half a unit and the number of units.
    sizing
        Longest edge and elements through walls.
    servos
        Intervals of x [m]; each end moves to the nearest lattice plane, of two equally near
        ones to that nearer the middle, so that what is symmetric stays so.
    """
    count = row.unit_count
    right = _row_lines(_lattice(row, sizing)[2][0], count, count)  # the left is its mirror image

    def snap(x: float) -> float:
        return float(np.copysign(right[np.argmin(np.abs(right - abs(x)))], x))

    intervals = tuple((snap(start), snap(stop)) for start, stop in servos)
    slots, shut = np.zeros(count, dtype=bool), np.zeros(count + 1, dtype=bool)
    shut[[0, -1]] = True
    if row.servo_boxes:
        middles = (np.arange(count) + 0.5 - count / 2.0) * row.pitch
        reach = row.slot_length / 2.0 + _PLANE_TOLERANCE
        for start, stop in intervals:
            if not start < stop:
                raise InputError(
                    "a servo station is shorter than an element: lengthen it or refine",
                    "mesh.servo_length",
                )
            slots |= (middles - reach < stop) & (middles + reach > start)
            shut[1:-1] |= (middles[:-1] < stop) & (middles[1:] > start)
        shut[:-1] |= slots
        shut[1:] |= slots
    return Stations(intervals, slots, shut)


def gmsh_blocks(
    planes: list[np.ndarray], counts: list[np.ndarray], solid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Let Gmsh fill the solid blocks of a box grid with transfinite hexahedra.

    Parameters
    ----------
    planes
        Plane positions [m] along x, y, z.
    counts
        Elements between neighbouring planes along x, y, z.
    solid
        Which blocks are filled, shape (nx, ny, nz) in blocks.

    Returns
    -------
    Node positions [m], shape (n, 3), and hexahedra, shape (m, 8), in Gmsh's corner order.
    """
    with gmsh_model("blocks") as gmsh:
        _draw_blocks(gmsh.model.geo, planes, counts, solid)
        return generate(gmsh, HEXAHEDRON, "blocks")


def _draw_blocks(
    geo: Any, planes: list[np.ndarray], counts: list[np.ndarray], solid: np.ndarray
) -> None:
    """Volumes of the solid blocks in Gmsh's own kernel; what they share is made once."""
    points: dict[tuple[int, ...], int] = {}
    curves: dict[tuple[tuple[int, ...], int], int] = {}
    surfaces: dict[tuple[tuple[int, ...], int], int] = {}

    def step(corner: tuple[int, ...], axis: int) -> tuple[int, ...]:
        return tuple(c + (a == axis) for a, c in enumerate(corner))

    def point(corner: tuple[int, ...]) -> int:
        if corner not in points:
            points[corner] = geo.addPoint(*(float(planes[a][c]) for a, c in enumerate(corner)))
        return points[corner]

    def curve(corner: tuple[int, ...], axis: int) -> int:
        key = (corner, axis)
        if key not in curves:
            curves[key] = geo.addLine(point(corner), point(step(corner, axis)))
            geo.mesh.setTransfiniteCurve(curves[key], int(counts[axis][corner[axis]]) + 1)
        return curves[key]

    def surface(corner: tuple[int, ...], normal: int) -> int:
        key = (corner, normal)
        if key not in surfaces:
            u, v = [a for a in range(3) if a != normal]
            loop = geo.addCurveLoop(
                [
                    curve(corner, u),
                    curve(step(corner, u), v),
                    -curve(step(corner, v), u),
                    -curve(corner, v),
                ]
            )
            surfaces[key] = geo.addPlaneSurface([loop])
            geo.mesh.setTransfiniteSurface(surfaces[key])
            geo.mesh.setRecombine(2, surfaces[key])
        return surfaces[key]

    for block in np.argwhere(solid):
        corner = tuple(int(c) for c in block)
        faces = [surface(corner, a) for a in range(3)]
        faces += [surface(step(corner, a), a) for a in range(3)]
        volume = geo.addVolume([geo.addSurfaceLoop(faces)])
        geo.mesh.setTransfiniteVolume(volume)


def _cells_on_lattice(nodes: np.ndarray, cells: np.ndarray, lines: list[np.ndarray]) -> np.ndarray:
    """Lowest lattice corner of each of Gmsh's hexahedra, shape (m, 3)."""
    index = np.empty(nodes.shape, dtype=int)
    for axis, line in enumerate(lines):
        middles = (line[:-1] + line[1:]) / 2.0
        index[:, axis] = np.searchsorted(middles, nodes[:, axis])
        miss = float(np.abs(line[index[:, axis]] - nodes[:, axis]).max())
        if miss > _PLANE_TOLERANCE:
            raise RuntimeError(f"Gmsh put a node {miss:g} m off the lattice")
    corners = index[cells]
    low, high = corners.min(axis=1), corners.max(axis=1)
    if not np.all(high - low == 1):
        raise RuntimeError("Gmsh made a hexahedron that is not one lattice cell")
    return low


def _check_symmetry(symmetry: str) -> None:
    if symmetry not in SYMMETRIES:
        raise InputError(
            f"symmetry must be one of {', '.join(SYMMETRIES)}, got {symmetry!r}", "mesh.symmetry"
        )


@dataclass(frozen=True)
class BuiltRow:
    """A meshed row and the lattice it lies on.

    Attributes
    ----------
    mesh
        The mesh with its groups.
    lines
        Lattice positions [m] along x, y, z.
    """

    mesh: TaggedMesh
    lines: tuple[np.ndarray, np.ndarray, np.ndarray]


def build_row(
    row: UnitRow,
    symmetry: str,
    sizing: Sizing,
    limit_groups: tuple[str, ...] = ("limit_layer",),
    servos: tuple[tuple[float, float], ...] = (),
) -> BuiltRow:
    """Mesh half a unit in Gmsh and repeat it to the body asked for.

    Parameters
    ----------
    row
        Half a unit and the number of units; the body is centred on x = 0.
    symmetry
        "whole", "half" (x >= 0) or "quarter" (x >= 0 and y >= 0).
    sizing
        Longest edge and elements through walls.
    limit_groups
        Cell groups whose cells may become servos.
    servos
        Intervals of x [m]. Their ends add no planes but snap to the nearest lattice plane (at
        most half an element, about 1 mm); the cells of `limit_groups` and of the row's servo
        boxes inside the n-th go to the cell group "servo_n", numbered along the whole body also
        where a part is modelled.

    Returns
    -------
    Mesh and lattice lines.
    """
    _check_symmetry(symmetry)
    x_cut, y_cut = symmetry != "whole", symmetry == "quarter"
    boxes = (*row.boxes, *row.slot_boxes, *row.servo_boxes)
    planes, counts, half_lines = _lattice(row, sizing)
    stations = place_stations(row, sizing, servos)
    has_material = np.array([False] + [bool(box.material) for box in boxes])
    is_plug = np.array([False] + [bool(box.material and box.air) for box in boxes])

    # Half a unit as it is, as one that makes room for a station, and inside a station.
    ends = (len(row.boxes), len(row.boxes) + len(row.slot_boxes), len(boxes))
    blocks = np.any([has_material[_paint(boxes[:end], planes)] for end in ends], axis=0)
    nodes, cells = gmsh_blocks(planes, counts, blocks)
    low = _cells_on_lattice(nodes, cells, half_lines)
    meshed = np.zeros([len(line) - 1 for line in half_lines], dtype=bool)
    meshed[tuple(low.T)] = True
    owners = np.stack([_paint(boxes[:end], half_lines) for end in ends])
    in_slot = owners[0] != owners[1]

    # Half units from left to right: the left half of a unit is the mirrored right half.
    first = row.unit_count if x_cut else 0
    x_lines = _row_lines(half_lines[0], row.unit_count, first)
    x_middle = (x_lines[:-1] + x_lines[1:]) / 2.0
    in_station = np.zeros(len(x_middle), dtype=bool)
    for start, stop in stations.intervals:
        in_station |= (x_middle > start) & (x_middle < stop)
    owner_parts: list[np.ndarray] = []
    solid_parts: list[np.ndarray] = []
    width = owners.shape[1]
    for half in range(first, 2 * row.unit_count):
        slices = np.arange(width)[:: -1 if half % 2 == 0 else 1]
        inside = in_station[(half - first) * width :][:width]
        owner = owners[np.where(inside, 2, int(stations.slots[half // 2])), slices]
        # Only the outward half of the outermost units keeps its plugs: the ends are closed.
        is_end = half in (0, 2 * row.unit_count - 1)
        plugged = is_end | (stations.shut[(half + 1) // 2] & in_slot[slices])
        owner_parts.append(owner)
        solid_parts.append(meshed[slices] & has_material[owner] & (~is_plug[owner] | plugged))
    owner, solid = np.concatenate(owner_parts), np.concatenate(solid_parts)
    y_lines = half_lines[1]
    if not y_cut:
        y_lines = np.concatenate([-y_lines[:0:-1], y_lines])
        owner = np.concatenate([owner[:, ::-1], owner], axis=1)
        solid = np.concatenate([solid[:, ::-1], solid], axis=1)
    lines = (x_lines, y_lines, half_lines[2])
    housings = tuple(box.material for box in row.servo_boxes)
    cuts, intervals = (x_cut, y_cut), stations.intervals
    mesh = _tag(boxes, owner, solid, lines, cuts, limit_groups, housings, intervals)
    return BuiltRow(mesh, lines)


def _tag(
    boxes: tuple[Box, ...],
    owner: np.ndarray,
    solid: np.ndarray,
    lines: tuple[np.ndarray, np.ndarray, np.ndarray],
    cuts: tuple[bool, bool],
    limit_groups: tuple[str, ...],
    housings: tuple[str, ...],
    servos: tuple[tuple[float, float], ...],
) -> TaggedMesh:
    """Number the nodes of a solid lattice and name its cells and facets."""
    low = np.argwhere(solid)  # lexicographic: x slowest, so that the matrix profile is small
    shape = np.array(solid.shape) + 1
    corners = low[:, None, :] + _CORNERS[None, :, :]
    flat = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), tuple(shape))
    used, cells = np.unique(flat, return_inverse=True)
    cells = cells.reshape(-1, 8)
    ijk = np.unravel_index(used, tuple(shape))
    nodes = np.stack([line[i] for line, i in zip(lines, ijk, strict=True)], axis=1)

    cell_owner = owner[tuple(low.T)]
    names = np.array([""] + [box.material for box in boxes])[cell_owner]
    x_middle = ((lines[0][:-1] + lines[0][1:]) / 2.0)[low[:, 0]]
    cell_groups: dict[str, np.ndarray] = {}
    is_limit = np.isin(names, limit_groups)
    may_be_servo = np.isin(names, (*limit_groups, *housings))
    is_servo = np.zeros(len(cells), dtype=bool)
    for number, (start, stop) in enumerate(servos):
        inside = may_be_servo & (x_middle > start) & (x_middle < stop)
        if inside.any():
            cell_groups[f"servo_{number}"] = np.flatnonzero(inside)
        if np.any(is_servo & inside):
            raise InputError("servo stations overlap: move the centres apart", "mesh")
        is_servo |= inside
    cell_groups = {"silicone": np.flatnonzero(~is_servo), **cell_groups}
    for name in dict.fromkeys(box.material for box in boxes if box.material):
        cell_groups[name] = np.flatnonzero(names == name)

    # What lies behind each exposed facet decides its names.
    groups: dict[str, list[np.ndarray]] = {}

    def put(name: str, quads: np.ndarray) -> None:
        if len(quads):
            groups.setdefault(name, []).append(quads)

    hull = {
        (0, -1): "symmetry_x" if cuts[0] else "end_left",
        (0, 1): "end",
        (1, -1): "symmetry_y" if cuts[1] else "side_left",
        (1, 1): "side_right",
        (2, -1): "underside",
        (2, 1): "top",
    }
    first_gap = {box.air: _first_gap(boxes, owner, box.air) for box in boxes}
    for face, (axis, step) in zip(HEX_FACES, _FACE_STEPS, strict=True):
        beyond = low.copy()
        beyond[:, axis] += step
        off = (beyond[:, axis] < 0) | (beyond[:, axis] >= solid.shape[axis])
        name = hull[axis, step]
        put(name, cells[off][:, face])
        if not name.startswith("symmetry"):
            put("outer", cells[off][:, face])
            put("servo_faces", cells[off & is_servo][:, face])
        if name == "end":
            put("end_spine", cells[off & is_limit][:, face])
        inner = np.flatnonzero(~off)
        behind = tuple(beyond[inner].T)
        open_ = ~solid[behind]
        inner, behind = inner[open_], tuple(b[open_] for b in behind)
        void = owner[behind]
        right = behind[1] >= (0 if cuts[1] else solid.shape[1] // 2)
        for number, box in enumerate([Box((0, 0), (0, 0), (0, 0)), *boxes]):
            mine = void == number
            if not mine.any():
                continue
            if box.air.startswith("cavity"):
                for side, suffix in ((right, "_right"), (~right, "_left")):
                    chosen = mine & side if box.sided else mine & (side | ~side)
                    put(box.air + (suffix if box.sided else ""), cells[inner[chosen]][:, face])
                    if not box.sided:
                        break
                continue
            quads = cells[inner[mine]][:, face]
            put("outer", quads)
            put("servo_faces", quads[is_servo[inner[mine]]])
            if box.air.startswith("gap"):
                put("chamber_faces", quads)
                put("chamber_faces" + box.air.removeprefix("gap"), quads)
                if cuts[0]:
                    near = behind[0][mine] < first_gap[box.air]
                    put("chamber_faces_symmetry_x", quads[near])
            elif (axis, step) == (2, 1):
                put("top", quads)
    facet_groups = {name: np.concatenate(parts) for name, parts in sorted(groups.items())}
    return TaggedMesh(nodes, cells, cell_groups, facet_groups, cavity_names(facet_groups))


def _first_gap(boxes: tuple[Box, ...], owner: np.ndarray, air: str) -> int:
    """Lattice cells along x that belong to this row's gap at the start of the body."""
    is_gap = np.array([False] + [box.air == air and air.startswith("gap") for box in boxes])
    has_gap = is_gap[owner].any(axis=(1, 2))
    return int(np.argmin(has_gap)) if not has_gap.all() else 0
