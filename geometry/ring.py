"""The circular soft robot: a shell on eight spokes, as masses on lines or as hexahedra.

The shell is a ring in the x-z plane, y across it, z up. Seen with x to the right and z up (from
-y), angles run counter-clockwise from straight down; the ring's normal by the right hand is -y.
The sphere is three rings in planes at right angles about one hub.

The paper gives the shell's stiffness, damping and bending stiffness once; here they belong to the
arc between two neighbouring spokes, 45 degrees. What a line of elements then resists, EA =
stiffness x arc and EI = bending stiffness x arc, does not depend on how many there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flexapod.core.errors import InputError, check_finite, check_positive
from flexapod.geometry.blocks import _CORNERS, _FACE_STEPS, _cells_on_lattice, _lines, gmsh_blocks
from flexapod.geometry.tagged import HEX_FACES, TaggedMesh

LETTERS = "ABCDEFGH"
CHORD = ("B", "H")  # shell ends that coil I joins, the two beside A
DIRECTIONS = ("counter-clockwise", "clockwise")
_ARCS = 8  # arcs between neighbouring spokes in a ring
_ALIGNED = 1e-9  # [rad], angles nearer than this are equal
_MOST_CELLS = 200_000  # more is a slip of the keyboard for a body of a few centimetres


@dataclass(frozen=True)
class RingSizes:
    """Sizes, mass and stiffness of one ring (SI).

    Attributes
    ----------
    diameter
        Of the shell's middle line [m]; the paper's robot is 40 mm across.
    mass
        Of a robot of one ring, hub included [kg].
    hub_mass
        Mass in the middle, where the spokes meet [kg]. The paper does not divide the mass; by
        default a tenth of it, for the hub only joins thin coils.
    node_count
        Masses around one ring, a multiple of 8.
    stretch_stiffness, stretch_damping
        Of the spring and the dashpot beside it that stand for an arc of 45 degrees [N/m], [N s/m].
    bend_stiffness
        Of an arc of 45 degrees: moment over the angle between its ends [N m/rad].
    bend_damping
        Dashpot over spring of the bending [s]; 0 because the paper gives none.
    out_of_plane_ratio
        Bending stiffness out of the ring's plane over that in it. 1 is a round or square section:
        the paper's model is plane and says nothing of it. A rectangle has (width/thickness)**2.
    width
        Of the shell across its plane [m], for the area in contact; assumed, the paper gives none.
    first_angle
        Where spoke A points [rad], counter-clockwise from straight down.
    letters_direction
        Way round from A to B: "counter-clockwise" or "clockwise" as seen from -y (in a sphere,
        against the ring's normal).

    Raises
    ------
    InputError
        For a value out of its range, with its name.
    """

    diameter: float = 0.04
    mass: float = 3e-3
    hub_mass: float | None = None
    node_count: int = 32
    stretch_stiffness: float = 500.0
    stretch_damping: float = 0.1
    bend_stiffness: float = 0.0015
    bend_damping: float = 0.0
    out_of_plane_ratio: float = 1.0
    width: float = 4e-3
    first_angle: float = 0.0
    letters_direction: str = "counter-clockwise"

    def __post_init__(self) -> None:
        for name, unit in (
            ("diameter", "m"),
            ("mass", "kg"),
            ("stretch_stiffness", "N/m"),
            ("bend_stiffness", "N m/rad"),
            ("out_of_plane_ratio", ""),
            ("width", "m"),
        ):
            check_positive(name, getattr(self, name), unit, "ring")
        for name, unit in (("stretch_damping", "N s/m"), ("bend_damping", "s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} must be finite and >= 0, got {value:g} {unit}", "ring")
        if self.hub_mass is not None:
            check_positive("hub_mass", self.hub_mass, "kg", "ring")
            if not self.hub_mass < self.mass:
                raise InputError(
                    f"hub_mass must be less than mass, the shell weighs something too; got "
                    f"{self.hub_mass:g} kg of {self.mass:g} kg",
                    "ring",
                )
        _check_around("node_count", self.node_count, "ring")
        check_finite("first_angle", self.first_angle, "rad", "ring")
        if self.letters_direction not in DIRECTIONS:
            raise InputError(
                f"letters_direction must be {' or '.join(DIRECTIONS)}, got "
                f"{self.letters_direction!r}",
                "ring",
            )

    @property
    def radius(self) -> float:
        """Of the middle line [m]."""
        return 0.5 * self.diameter

    @property
    def mass_of_hub(self) -> float:
        """Mass of the hub: `hub_mass`, or a tenth of the mass [kg]."""
        return 0.1 * self.mass if self.hub_mass is None else self.hub_mass

    @property
    def shell_mass(self) -> float:
        """Mass of one ring's shell, what the hub leaves of the mass [kg]."""
        return self.mass - self.mass_of_hub

    @property
    def arc(self) -> float:
        """Length of the middle line between neighbouring spokes, pi D / 8 [m]."""
        return math.pi * self.diameter / _ARCS

    @property
    def element_stiffness(self) -> float:
        """Of the spring between neighbouring nodes [N/m]; n/8 of them in a row are an arc."""
        return self.stretch_stiffness * self.node_count / _ARCS

    @property
    def element_damping(self) -> float:
        """Of the dashpot between neighbouring nodes [N s/m]."""
        return self.stretch_damping * self.node_count / _ARCS

    @property
    def hinge_stiffness(self) -> float:
        """Moment over change of angle at a node, in the ring's plane [N m/rad]."""
        return self.bend_stiffness * self.node_count / _ARCS

    @property
    def stretch_rigidity(self) -> float:
        """EA, stretch_stiffness x arc [N]."""
        return self.stretch_stiffness * self.arc

    @property
    def bend_rigidity(self) -> float:
        """EI in the ring's plane, bend_stiffness x arc [N m2]."""
        return self.bend_stiffness * self.arc


def _is_whole(count: object) -> bool:
    return isinstance(count, int | np.integer) and not isinstance(count, bool)


def _check_around(name: str, count: int, where: str) -> None:
    if not _is_whole(count) or count < _ARCS or count % _ARCS:
        raise InputError(
            f"{name} must be a multiple of {_ARCS}, at least {_ARCS}, so that a node lies at the "
            f"end of each spoke; got {count}",
            where,
        )


@dataclass(frozen=True)
class TouchingCurve:
    """Points of a shell that may touch, and the pieces between them.

    Attributes
    ----------
    nodes, weights
        Point p lies at ``sum_a weights[p, a] x[nodes[p, a]]``; both of shape (point_count, 4).
    faces
        One degenerate quadrilateral (a, b, b, a) of points per piece, shape (piece_count, 4): of
        its four contact points both rows lie on the piece.
    areas
        Of each contact point, width x length / 4 [m2], shape (piece_count, 4).
    """

    nodes: np.ndarray
    weights: np.ndarray
    faces: np.ndarray
    areas: np.ndarray


@dataclass(frozen=True)
class RingLayout:
    """Masses on lines: nodes and what joins them.

    The lowest node is at z = 0 and the hub above the origin. A sphere's rings only share nodes
    where they cross: nothing but the lines themselves keeps their planes apart.

    Attributes
    ----------
    sizes
        What it was made of; stiffness and damping of an element and a hinge are read there.
    nodes
        Positions [m], shape (N, 3), stress-free along the lines.
    node_mass
        Masses [kg], shape (N,).
    hub
        Index of the hub, the last node.
    rings
        Node indices of each closed loop, counter-clockwise about `ring_normals` (the last node is
        followed by the first). The loop begins at the ring's lowest node, in the x-y plane at
        that of least y, before a `first_angle` between nodes turns it.
    ring_normals
        Unit normal of each loop by the right hand, shape (ring_count, 3): -y for the ring in
        x-z, then +z for x-y and +x for y-z.
    segments
        Pairs of neighbouring nodes in the order of the loops, shape (S, 2).
    segment_length
        Stress-free lengths [m], shape (S,): chords of the circle, so that the sum is a little
        under pi D.
    hinges
        Previous node, own node, next node, shape (H, 3).
    hinge_ring
        The loop a hinge bends in, shape (H,). A node where loops cross has a hinge in each.
    rest_angle
        Stress-free angle from the segment before to the segment behind the node [rad], positive
        about the ring's normal, shape (H,).
    spokes
        Name to (hub, shell node): "A".."H", in a sphere "A1".."H1", "A2".., "A3"... Where two
        rings cross, the two names stand for one and the same pair.
    chords
        Coil "I" ("I1", "I2", "I3"): shell nodes of B and H.
    """

    sizes: RingSizes
    nodes: np.ndarray
    node_mass: np.ndarray
    hub: int
    rings: tuple[np.ndarray, ...]
    ring_normals: np.ndarray
    segments: np.ndarray
    segment_length: np.ndarray
    hinges: np.ndarray
    hinge_ring: np.ndarray
    rest_angle: np.ndarray
    spokes: dict[str, tuple[int, int]]
    chords: dict[str, tuple[int, int]]

    def touching(self, refine: int = 4) -> TouchingCurve:
        """What of the shell touches the ground: a smooth curve through the nodes of each loop.

        Cubic between two nodes, with the slopes of their neighbours' chord (E. Catmull & R. Rom,
        A class of local interpolating splines, 1974): of a circle of 32 nodes it is off by 4e-5 of
        the radius. As chords, the ring would be a polygon and had to tip over each of its corners.

        Parameters
        ----------
        refine
            Straight pieces per segment; 1 leaves the chords.

        Raises
        ------
        InputError
            If `refine` is no whole number >= 1.
        """
        if refine != int(refine) or refine < 1:
            raise InputError(f"contact_refine must be a whole number >= 1, got {refine}", "ring")
        t = np.arange(refine)[:, None] / refine
        cubic = 0.5 * np.concatenate(
            [
                -t + 2 * t**2 - t**3,
                2 - 5 * t**2 + 3 * t**3,
                t + 4 * t**2 - 3 * t**3,
                -(t**2) + t**3,
            ],
            axis=1,
        )
        nodes, weights, faces, first = [], [], [], 0
        for loop in self.rings:
            around = np.stack([np.roll(loop, -k) for k in (-1, 0, 1, 2)], axis=1)
            nodes.append(np.repeat(around, refine, axis=0))
            weights.append(np.tile(cubic, (len(loop), 1)))
            own = first + np.arange(len(loop) * refine)
            behind = np.roll(own, -1)
            faces.append(np.stack([own, behind, behind, own], axis=1))
            first += own.size
        length = np.repeat(self.segment_length / refine, refine)
        return TouchingCurve(
            np.concatenate(nodes),
            np.concatenate(weights),
            np.concatenate(faces),
            np.repeat((0.25 * self.sizes.width * length)[:, None], 4, axis=1),
        )

    def coil_pairs(self) -> tuple[np.ndarray, dict[str, int]]:
        """The pairs of nodes that coils join, each once.

        Returns
        -------
        Pairs, shape (coil_count, 2), spokes before chords in the order of their names, and the
        row of each name.
        """
        rows: dict[tuple[int, int], int] = {}
        names = {
            name: rows.setdefault(pair, len(rows))
            for name, pair in {**self.spokes, **self.chords}.items()
        }
        return np.array(list(rows), dtype=np.int64).reshape(-1, 2), names


def lumped_ring(sizes: RingSizes, rest_curvature: float = 1.0) -> RingLayout:
    """The robot of one ring, in the x-z plane.

    Parameters
    ----------
    sizes
        Sizes, mass and stiffness.
    rest_curvature
        Stress-free curvature over that of the circle: 1 for a shell moulded as a ring, 0 for a
        straight strip bent to one. The paper does not say; as a circle it is stress-free.

    Raises
    ------
    InputError
        If `rest_curvature` is not finite.
    """
    frame = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return _lumped(sizes, (frame,), ("",), rest_curvature)


def lumped_sphere(sizes: RingSizes, rest_curvature: float = 1.0) -> RingLayout:
    """The robot of three rings in the planes x-z, x-y and y-z, in this order.

    They cross at the six points on the axes through the hub and share the nodes there. The mass
    is three times a ring's shell and one hub, 3 (mass - hub) + hub; the shell's is spread by
    length, so that a node of two rings has twice the mass of another. Spoke A of the rings in
    x-z and y-z is counted from straight down, that of x-y from -y.

    Parameters
    ----------
    sizes
        Sizes, mass and stiffness of each ring; `hub_mass` is that of the one hub.
    rest_curvature
        As for `lumped_ring`.

    Raises
    ------
    InputError
        If `first_angle` is no multiple of 45 degrees: rings could not share the spokes at their
        crossings. If `rest_curvature` is not finite.
    """
    steps = sizes.first_angle / (2.0 * math.pi / _ARCS)
    if abs(steps - round(steps)) > _ALIGNED:
        raise InputError(
            f"first_angle of a sphere must be a multiple of 45 degrees, so that its rings share "
            f"the spokes where they cross; got {math.degrees(sizes.first_angle):g} degrees",
            "ring",
        )
    x, y, z = np.eye(3)
    frames = (np.stack([x, z]), np.stack([x, y]), np.stack([y, z]))
    return _lumped(sizes, frames, ("1", "2", "3"), rest_curvature)


def _lumped(
    sizes: RingSizes,
    frames: tuple[np.ndarray, ...],
    suffixes: tuple[str, ...],
    rest_curvature: float,
) -> RingLayout:
    """Rings about one hub; `frames` (2, 3) are the axes each takes for right and up."""
    check_finite("rest_curvature", rest_curvature, "", "ring")
    n = sizes.node_count
    circle, first = _circle(n, sizes.first_angle)
    number: dict[tuple[float, ...], int] = {}
    places: list[np.ndarray] = []
    rings, normals = [], []
    spokes: dict[str, int] = {}
    for frame, suffix in zip(frames, suffixes, strict=True):
        loop = np.empty(n, dtype=np.int64)
        for k, place in enumerate(circle @ frame):
            # The circle is exact on the axes, where rings meet.
            key = tuple(float(c) + 0.0 for c in place)
            if key not in number:
                number[key] = len(places)
                places.append(place)
            loop[k] = number[key]
        rings.append(loop)
        normals.append(np.cross(frame[0], frame[1]))
        for name, k in _letter_places(n, first, sizes.letters_direction).items():
            spokes[name + suffix] = int(loop[k])
    hub = len(places)
    unit = np.array([*places, np.zeros(3)])
    nodes = sizes.radius * unit
    nodes[:, 2] = sizes.radius * (unit[:, 2] - unit[:, 2].min())

    segments = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in rings])
    hinges = [np.stack([np.roll(loop, 1), loop, np.roll(loop, -1)], axis=1) for loop in rings]
    length = np.linalg.norm(nodes[segments[:, 1]] - nodes[segments[:, 0]], axis=1)
    # All segments have the same length: half of each goes to either end.
    mass = np.bincount(segments.ravel(), minlength=hub + 1) * (0.5 * sizes.shell_mass / n)
    mass[hub] = sizes.mass_of_hub
    one, two = CHORD
    return RingLayout(
        sizes=sizes,
        nodes=nodes,
        node_mass=mass,
        hub=hub,
        rings=tuple(rings),
        ring_normals=np.array(normals) + 0.0,
        segments=segments,
        segment_length=length,
        hinges=np.concatenate(hinges),
        hinge_ring=np.repeat(np.arange(len(rings)), n),
        rest_angle=np.full(len(segments), rest_curvature * 2.0 * math.pi / n),
        spokes={name: (hub, node) for name, node in spokes.items()},
        chords={f"I{s}": (spokes[one + s], spokes[two + s]) for s in suffixes},
    )


def _circle(count: int, first_angle: float) -> tuple[np.ndarray, int]:
    """Unit circle from straight down, counter-clockwise, and the node where spoke A ends.

    Positions to the right and up, shape (count, 2). A circle turned by whole steps is the same
    circle with other letters; only what is left over turns it.
    """
    step = 2.0 * math.pi / count
    first = round(first_angle / step)
    rest = first_angle - first * step
    # One eighth is computed, the others mirror it: left and right are equal to the last bit.
    k = np.arange(count)
    quarter = count // 4
    low = k % quarter
    near = np.minimum(low, quarter - low)
    half = 2 * near == quarter  # sine and cosine of 45 degrees differ in the last bit
    small = np.where(half, math.sqrt(0.5), np.sin(near * step))
    large = np.where(half, math.sqrt(0.5), np.cos(near * step))
    sine = np.where(low <= quarter - low, small, large)
    cosine = np.where(low <= quarter - low, large, small)
    turn = k // quarter
    right = np.choose(turn, [sine, cosine, -sine, -cosine])
    up = np.choose(turn, [-cosine, sine, cosine, -sine])
    if abs(rest) > _ALIGNED:
        c, s = math.cos(rest), math.sin(rest)
        right, up = c * right - s * up, s * right + c * up
    return np.stack([right, up], axis=1) + 0.0, first % count


def _letter_places(count: int, first: int, direction: str) -> dict[str, int]:
    """Place of each spoke's end among `count` nodes around."""
    sense = 1 if direction == DIRECTIONS[0] else -1
    step = count // _ARCS
    return {name: (first + sense * j * step) % count for j, name in enumerate(LETTERS)}


# --------------------------------------------------------------------------- solid


@dataclass(frozen=True)
class SolidSection:
    """Rectangular section and modulus of a solid shell.

    Attributes
    ----------
    thickness
        In the ring's plane, along the radius [m].
    width
        Across the plane [m].
    youngs_modulus
        For small strains [Pa].
    density
        [kg/m3].
    poisson
        Poisson's ratio [-].
    """

    thickness: float
    width: float
    youngs_modulus: float
    density: float
    poisson: float

    @property
    def shear_modulus(self) -> float:
        """E / (2 (1 + nu)) [Pa]."""
        return 0.5 * self.youngs_modulus / (1.0 + self.poisson)

    @property
    def bulk_modulus(self) -> float:
        """E / (3 (1 - 2 nu)) [Pa]."""
        return self.youngs_modulus / (3.0 * (1.0 - 2.0 * self.poisson))


def solid_section(sizes: RingSizes, density: float, poisson: float) -> SolidSection:
    """The rectangle that stretches, bends and weighs as the lumped shell does.

    Stress is plane across the width: the sides are free and the width is about the thickness,
    so that a fibre along the shell has modulus E and Poisson's ratio does not stiffen it (a wide
    shell would have E / (1 - nu**2)). With thickness t and width w, ::

        E t w       = EA = stretch_stiffness arc
        E w t^3/12  = EI = bend_stiffness arc

    and their quotient is ``t = sqrt(12 EI / EA)``, 6.0 mm for the paper's numbers. The ring has
    the volume t w pi D (Pappus, the middle line passes through the section's centre), hence
    ``w = shell mass / (density t pi D)`` and at last ``E = EA / (t w)``.

    Left out is what a thick ring adds: with t/R = 0.3 the strain is no longer linear across the
    section (of order (t/R)**2/15 in the bending stiffness) and shear takes part. The ratio of out
    of plane to in-plane bending is (w/t)**2, whatever `out_of_plane_ratio` says, and
    `RingSizes.width` is not used.

    Parameters
    ----------
    sizes
        The lumped ring.
    density
        Of the solid [kg/m3].
    poisson
        Poisson's ratio, above -1 and below 0.5; it sets the moduli of the material, not the
        section.

    Raises
    ------
    InputError
        If the density is not positive, Poisson's ratio out of its range, or the section so thick
        that the ring has no hole.
    """
    check_positive("density", density, "kg/m3", "ring")
    if not -1.0 < poisson < 0.5:
        raise InputError(f"poisson must lie above -1 and below 0.5, got {poisson:g}", "ring")
    thickness = math.sqrt(12.0 * sizes.bend_rigidity / sizes.stretch_rigidity)
    width = sizes.shell_mass / (density * thickness * math.pi * sizes.diameter)
    _check_hole(sizes.diameter, thickness, "ring")
    return SolidSection(
        thickness, width, sizes.stretch_rigidity / (thickness * width), density, poisson
    )


def _check_hole(diameter: float, thickness: float, where: str) -> None:
    if not thickness < diameter:
        raise InputError(
            f"thickness must be less than diameter or the ring has no hole; got "
            f"{thickness * 1e3:.4g} mm of {diameter * 1e3:.4g} mm",
            where,
        )


@dataclass(frozen=True)
class RingBuilder:
    """A solid ring of rectangular section, for a case's ``[mesh]`` table.

    The ring stands in the x-z plane on z = 0, its axis along y, its middle above the origin. The
    surfaces are "outer" (the cylinder outside alone, unlike that of the other builders), "inner",
    "side_front" (-y) and "side_back"; all cells are "silicone".

    Attributes
    ----------
    diameter
        Of the middle line [m]; outside the ring is one thickness wider.
    thickness, width
        Of the section, along the radius and across the plane [m]. The defaults are what
        `solid_section` makes of the paper's numbers (6.0 mm) and an assumed width.
    around
        Elements around, a multiple of 8.
    through, across
        Elements through the thickness and across the width, even: there is a node in the middle
        of each. Two is the least that bends.
    """

    diameter: float = 0.04
    thickness: float = 6e-3
    width: float = 4e-3
    around: int = 64
    through: int = 2
    across: int = 2

    symmetry: ClassVar[str] = "whole"

    def __post_init__(self) -> None:
        for name in ("diameter", "thickness", "width"):
            check_positive(name, getattr(self, name), "m", "mesh")
        _check_hole(self.diameter, self.thickness, "mesh")
        _check_around("around", self.around, "mesh")
        for name in ("through", "across"):
            count = getattr(self, name)
            if not _is_whole(count) or count < 2 or count % 2:
                raise InputError(
                    f"{name} must be an even whole number, at least 2, for a node on the middle "
                    f"line; got {count}",
                    "mesh",
                )
        cells = self.around * self.through * self.across
        if cells > _MOST_CELLS:
            raise InputError(
                f"around x through x across is {cells} cells, more than {_MOST_CELLS}", "mesh"
            )

    def build(self) -> TaggedMesh:
        """Mesh the ring with Gmsh: a straight strip of transfinite blocks, bent and closed.

        The strip lies along x with its outer face down, so that bending it upward keeps the
        orientation. The nodes around come first in the numbering, then those across and at last
        those through the thickness from outside: number (i (across + 1) + j) (through + 1) + k.
        """
        counts = (self.around, self.across, self.through)
        length = math.pi * self.diameter
        planes = [
            np.linspace(0.0, length, _ARCS + 1),
            np.array([-0.5, 0.0, 0.5]) * self.width,
            np.array([0.0, 0.5, 1.0]) * self.thickness,
        ]
        split = [
            np.full(len(p) - 1, c // (len(p) - 1)) for p, c in zip(planes, counts, strict=True)
        ]
        lines = [_lines(p, c) for p, c in zip(planes, split, strict=True)]
        solid = np.ones((_ARCS, 2, 2), dtype=bool)
        low = _cells_on_lattice(*gmsh_blocks(planes, split, solid), lines)
        low = low[np.lexsort(low.T[::-1])]

        corner = low[:, None, :] + _CORNERS[None, :, :]
        corner[..., 0] %= self.around  # the strip's ends meet
        shape = (self.around, self.across + 1, self.through + 1)
        cells = np.ravel_multi_index(tuple(np.moveaxis(corner, -1, 0)), shape)

        circle, _ = _circle(self.around, 0.0)
        inward = np.arange(self.through + 1) / self.through
        radius = 0.5 * self.diameter + self.thickness * (0.5 - inward)
        nodes = np.empty((*shape, 3))
        nodes[..., 0] = circle[:, None, None, 0] * radius
        nodes[..., 1] = self.width * (np.arange(self.across + 1) / self.across - 0.5)[:, None]
        nodes[..., 2] = circle[:, None, None, 1] * radius + radius[0]

        ends = {(2, -1): "outer", (2, 1): "inner", (1, -1): "side_front", (1, 1): "side_back"}
        facets = {}
        for face, side in zip(HEX_FACES, _FACE_STEPS, strict=True):
            if side in ends:
                axis, step = side
                at_end = low[:, axis] == (0 if step < 0 else counts[axis] - 1)
                facets[ends[side]] = cells[at_end][:, face]
        groups = {name: facets[name] for name in ends.values()}
        return TaggedMesh(nodes.reshape(-1, 3), cells, {"silicone": np.arange(len(cells))}, groups)

    def middle_line(self) -> np.ndarray:
        """Nodes half way through the thickness, shape (around, across + 1), from the lowest."""
        i = np.arange(self.around)[:, None] * (self.across + 1) + np.arange(self.across + 1)
        return i * (self.through + 1) + self.through // 2

    def expected_volume(self) -> float:
        """Volume of the ring whose two circles are polygons, n sin(2 pi/n) R t w [m3]."""
        n = self.around
        section = self.thickness * self.width
        return n * math.sin(2.0 * math.pi / n) * 0.5 * self.diameter * section

    def expected_cavity_volumes(self) -> dict[str, float]:
        """No air is enclosed."""
        return {}


@dataclass(frozen=True)
class SolidRing:
    """A meshed shell and where its spokes end.

    Attributes
    ----------
    section
        Section, modulus and density.
    mesh
        Hexahedra with the surfaces "outer", "inner", "side_front" and "side_back"; the lowest
        node is at z = 0, half a thickness under the middle line.
    anchors
        Letter of a spoke to the nodes across the width on the middle line there, shape
        (across + 1,): the spoke ends in their mean, which is the middle node.
    centre
        Of the ring, where the hub is [m], shape (3,).
    """

    section: SolidSection
    mesh: TaggedMesh
    anchors: dict[str, np.ndarray]
    centre: np.ndarray


def solid_ring(
    sizes: RingSizes, section: SolidSection, around: int = 64, through: int = 2, across: int = 2
) -> SolidRing:
    """Mesh the shell of `sizes` as a solid of a section, as a rule that of `solid_section`.

    Parameters
    ----------
    sizes
        Diameter, place and order of the spokes.
    section
        Thickness and width.
    around, through, across
        Elements around (a multiple of 8), through the thickness and across the width (even).

    Raises
    ------
    InputError
        For counts that put no node on the middle line or at a spoke's end.
    """
    builder = RingBuilder(sizes.diameter, section.thickness, section.width, around, through, across)
    mesh = builder.build()
    circle, first = _circle(around, sizes.first_angle)
    middle = builder.middle_line()
    anchors = {
        name: middle[k]
        for name, k in _letter_places(around, first, sizes.letters_direction).items()
    }
    height = sizes.radius + 0.5 * section.thickness
    # The first place of an unturned circle is (0, -1) exactly.
    sine, cosine = float(circle[0, 0]), -float(circle[0, 1])
    if sine != 0.0:
        x, z = mesh.nodes[:, 0], mesh.nodes[:, 2] - height
        nodes = np.stack([cosine * x - sine * z, mesh.nodes[:, 1], sine * x + cosine * z], axis=1)
        height = -float(nodes[:, 2].min())
        nodes[:, 2] += height
        mesh = mesh.with_nodes(nodes)
    return SolidRing(section, mesh, anchors, np.array([0.0, 0.0, height]))


__all__ = [
    "CHORD",
    "DIRECTIONS",
    "LETTERS",
    "RingBuilder",
    "RingLayout",
    "RingSizes",
    "SolidRing",
    "SolidSection",
    "lumped_ring",
    "lumped_sphere",
    "solid_ring",
    "solid_section",
]
