"""Surfaces of rigid boxes, spheres and cylinders: quadrilaterals from Gmsh.

Each surface is a handful of four-sided patches that Gmsh fills with transfinite, recombined
quadrilaterals; all nodes lie on the true surface. Flats between them lie inside a sphere or a
cylinder, by ``h**2 / 8 R`` at most in the middle of an edge of length h.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexapod.core.errors import InputError, check_positive
from flexapod.geometry.gmsh_session import QUADRILATERAL, generate, gmsh_model

# More would make each step of a motion slower than any soft body beside it.
MOST_FACES = 20000
# Half diagonal of the square in the middle of a cylinder's ends, over the radius: the
# quadrilaterals around it are then about as wide as those inside.
_CORE = 0.6


@dataclass(frozen=True)
class RigidSurface:
    """Closed surface of a convex body about its centre.

    Attributes
    ----------
    nodes
        Positions from the body's centre [m], shape (node_count, 3).
    faces
        Corner quadruples, counter-clockwise seen from outside, shape (face_count, 4).
    sides
        Faces by the name of the side they are of, where a shape has such; together all of them.
    """

    nodes: np.ndarray
    faces: np.ndarray
    sides: dict[str, np.ndarray] = field(default_factory=dict)


def box_surface(size: tuple[float, float, float], mesh_size: float | None = None) -> RigidSurface:
    """Surface of a box with edges `size` [m] along x, y, z.

    `mesh_size` [m] is the longest edge of a face; by default a quarter of the shortest edge of the
    box, or a sixteenth of its longest.
    """
    for axis, length in zip("xyz", size, strict=True):
        check_positive(f"box size along {axis}", length, "m")
    h = _size(mesh_size, max(min(size) / 4.0, max(size) / 16.0))
    counts = [_count(length, h) for length in size]
    _check(2 * sum(counts[i] * counts[i - 1] for i in range(3)), h)
    half = 0.5 * np.array(size)

    def draw(sketch: _Sketch) -> None:
        for corners, (u, v) in _cube_sides():
            sketch.patch([half * c for c in corners], (counts[u], counts[v]))

    return _mesh(draw)


def wedge_corners(
    size: tuple[float, float, float], front_angle: float, back_angle: float
) -> np.ndarray:
    """Corners of a box whose ends along x are cut so that it stands on less than its length.

    As the hexahedron (-1, 1)^3 orders them, about the middle of the box with edges `size` [m].
    `front_angle` at +x and `back_angle` at -x [rad] are those of the ends with the ground under
    it: 90 degrees is upright, and an end of 60 degrees lies flat once the wedge has been turned
    by 60.
    """
    for axis, length in zip("xyz", size, strict=True):
        check_positive(f"wedge size along {axis}", length, "m")
    x, y, z = 0.5 * np.array(size)
    cut = []
    for name, angle in (("front_angle", front_angle), ("back_angle", back_angle)):
        if not math.radians(10.0) <= angle <= 0.5 * math.pi + 1e-12:
            raise InputError(f"{name} must lie in [10, 90] deg, got {math.degrees(angle):g} deg")
        cut.append(2.0 * z / math.tan(angle))
    front, back = cut
    if not front + back < 2.0 * x:
        raise InputError(
            f"the wedge has no underside left: its ends cut off {1e3 * (front + back):.3g} mm of "
            f"{2e3 * x:.3g} mm"
        )
    low = [(-x + back, -y), (x - front, -y), (x - front, y), (-x + back, y)]
    high = [(-x, -y), (x, -y), (x, y), (-x, y)]
    return np.array([(a, b, -z) for a, b in low] + [(a, b, z) for a, b in high])


def wedge_surface(
    size: tuple[float, float, float],
    front_angle: float,
    back_angle: float,
    mesh_size: float | None = None,
) -> RigidSurface:
    """Surface of a wedge about the middle of its box, see `wedge_corners`.

    Its `sides` are "bottom", "top", "front", "back" and "flanks". `mesh_size` as for a box.
    """
    corner = wedge_corners(size, front_angle, back_angle)
    h = _size(mesh_size, max(min(size) / 4.0, max(size) / 16.0))
    x, y, z = (_count(length, h) for length in size)
    _check(2 * (x * y + y * z + z * x), h)
    patches = {
        "bottom": ((0, 1, 2, 3), (x, y)),
        "top": ((4, 5, 6, 7), (x, y)),
        "front": ((1, 2, 6, 5), (y, z)),
        "back": ((0, 3, 7, 4), (y, z)),
        "right": ((0, 1, 5, 4), (x, z)),
        "left": ((3, 2, 6, 7), (x, z)),
    }

    def draw(sketch: _Sketch) -> None:
        for numbers, counts in patches.values():
            sketch.patch([corner[k] for k in numbers], counts)

    surface = _mesh(draw)
    middle = surface.nodes[surface.faces].mean(axis=1)
    sides: dict[str, list[np.ndarray]] = {}
    for name, (numbers, _) in patches.items():
        a, b, c, _ = corner[list(numbers)]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        on = np.abs((middle - a) @ normal) < 1e-6 * max(size)
        key = "flanks" if name in ("right", "left") else name
        sides.setdefault(key, []).append(surface.faces[on])
    return RigidSurface(
        surface.nodes, surface.faces, {key: np.concatenate(parts) for key, parts in sides.items()}
    )


def sphere_surface(radius: float, mesh_size: float | None = None) -> RigidSurface:
    """Surface of a sphere about its centre: a cube's six sides blown up.

    `radius` and `mesh_size` in [m]; the latter is a fifth of the radius by default.
    """
    check_positive("sphere radius", radius, "m")
    h = _size(mesh_size, radius / 5.0)
    # A side's edge spans the angle between two corners of the cube, acos(1/3).
    count = _even(radius * math.acos(1.0 / 3.0), h)
    _check(6 * count**2, h)
    middle = np.zeros(3)

    def draw(sketch: _Sketch) -> None:
        for corners, _ in _cube_sides():
            points = [radius / math.sqrt(3.0) * c for c in corners]
            sketch.patch(points, (count, count), [middle] * 4, middle)

    return _mesh(draw)


def cylinder_surface(
    radius: float, length: float, mesh_size: float | None = None, axis: int = 1
) -> RigidSurface:
    """Surface of a cylinder about its centre, with its ends.

    Parameters
    ----------
    radius, length
        Radius and length along the axis [m].
    mesh_size
        Longest edge of a face [m], about; a fifth of the radius by default.
    axis
        0, 1 or 2: the cylinder lies along x, y or z.
    """
    check_positive("cylinder radius", radius, "m")
    check_positive("cylinder length", length, "m")
    if axis not in (0, 1, 2):
        raise InputError(f"cylinder axis must be 0, 1 or 2, got {axis}")
    h = _size(mesh_size, radius / 5.0)
    around = _even(0.5 * math.pi * radius, h)
    inward = _count((1.0 - _CORE) * radius, h)
    along = _count(length, h)
    _check(4 * around * along + 2 * (around**2 + 4 * around * inward), h)
    angles = math.pi * (0.25 + 0.5 * np.arange(4))
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], axis=1)
    up = np.array([0.0, 0.0, 0.5 * length])

    def draw(sketch: _Sketch) -> None:
        for k in range(4):
            a, b = radius * ring[k], radius * ring[(k + 1) % 4]
            sketch.patch([a - up, b - up, b + up, a + up], (around, along), [-up, None, up, None])
        for end in (-up, up):
            core = [_CORE * radius * r + end for r in ring]
            sketch.patch(core, (around, around))
            for k in range(4):
                n = (k + 1) % 4
                rim = radius * ring[n] + end, radius * ring[k] + end
                sketch.patch([core[k], core[n], *rim], (around, inward), [None, None, end, None])

    surface = _mesh(draw)
    # x, y, z follow each other: a cyclic change of places is a rotation.
    nodes = np.roll(surface.nodes, axis - 2, axis=1)
    return RigidSurface(np.ascontiguousarray(nodes), surface.faces)


def _size(given: float | None, default: float) -> float:
    return default if given is None else check_positive("mesh_size", given, "m")


def _count(length: float, size: float) -> int:
    return max(1, math.ceil(length / size - 1e-9))


def _even(length: float, size: float) -> int:
    """As `_count`, but even: then the ends of the axes are nodes."""
    return 2 * _count(0.5 * length, size)


def _check(faces: int, size: float) -> None:
    if faces > MOST_FACES:
        raise InputError(
            f"mesh_size {size * 1e3:.3g} mm gives {faces} faces, more than {MOST_FACES}; write a "
            "larger one"
        )


def _cube_sides() -> list[tuple[list[np.ndarray], tuple[int, int]]]:
    """Corners of the cube (-1, 1)^3, side by side, and the axes each side spans."""
    sides = []
    for normal in range(3):
        u, v = (normal + 1) % 3, (normal + 2) % 3
        for end in (-1.0, 1.0):
            corners = []
            for s, t in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)):
                corner = np.empty(3)
                corner[[normal, u, v]] = end, s, t
                corners.append(corner)
            sides.append((corners, (u, v)))
    return sides


class _Sketch:
    """Points and curves of a model in Gmsh's own kernel, each made once."""

    def __init__(self, geo: Any) -> None:
        self.geo = geo
        self.points: dict[tuple[float, ...], int] = {}
        self.curves: dict[tuple[int, int], int] = {}

    def point(self, place: np.ndarray) -> int:
        # Corners of patches that meet are computed in the same way: round-off at most.
        key = tuple(float(f"{c:.9g}") + 0.0 for c in place)
        if key not in self.points:
            self.points[key] = self.geo.addPoint(*(float(c) for c in place))
        return self.points[key]

    def curve(self, one: np.ndarray, two: np.ndarray, count: int, middle: Any) -> int:
        """Line or, about `middle`, arc; minus its number where it was made the other way."""
        a, b = self.point(one), self.point(two)
        if (b, a) in self.curves:
            return -self.curves[b, a]
        if (a, b) not in self.curves:
            tag = (
                self.geo.addLine(a, b)
                if middle is None
                else self.geo.addCircleArc(a, self.point(middle), b)
            )
            self.geo.mesh.setTransfiniteCurve(tag, count + 1)
            self.curves[a, b] = tag
        return self.curves[a, b]

    def patch(
        self,
        corners: list[np.ndarray],
        counts: tuple[int, int],
        middles: Any = (None, None, None, None),
        sphere: np.ndarray | None = None,
    ) -> None:
        """Four-sided patch; `middles` of its arcs, `sphere` the centre of the one it lies on."""
        edges = [
            self.curve(corners[k], corners[(k + 1) % 4], counts[k % 2], middles[k])
            for k in range(4)
        ]
        centre = -1 if sphere is None else self.point(sphere)
        loop = self.geo.addCurveLoop(edges)
        surface = self.geo.addSurfaceFilling([loop], sphereCenterTag=centre)
        self.geo.mesh.setTransfiniteSurface(surface)
        self.geo.mesh.setRecombine(2, surface)


def _mesh(draw: Callable[[_Sketch], None]) -> RigidSurface:
    """Let Gmsh fill what `draw` sketches."""
    with gmsh_model("rigid") as gmsh:
        draw(_Sketch(gmsh.model.geo))
        nodes, faces = generate(gmsh, QUADRILATERAL, "a surface")
    # Centres of arcs are nodes of no face.
    used, corners = np.unique(faces, return_inverse=True)
    nodes, faces = nodes[used], corners.reshape(-1, 4)
    return RigidSurface(np.ascontiguousarray(nodes), _outward(nodes, faces))


def _outward(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces of a convex body about 0, each counter-clockwise seen from outside."""
    p = nodes[faces]
    normal = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
    inward = np.einsum("ij,ij->i", normal, p.mean(axis=1)) < 0.0
    return np.ascontiguousarray(np.where(inward[:, None], faces[:, ::-1], faces), dtype=np.int64)


__all__ = [
    "MOST_FACES",
    "RigidSurface",
    "box_surface",
    "cylinder_surface",
    "sphere_surface",
    "wedge_corners",
    "wedge_surface",
]
