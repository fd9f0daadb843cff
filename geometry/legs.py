"""Rigid C-shaped legs: part of a ring about an axis beside the hip, meshed and rolled.

A leg's own axes are those of the robot when the leg's angle is 0: x forward, y along the hip axis,
z up. The origin is the hip, the point on the axis in the middle of the leg's width. The outer
circle has the radius R = height / 2 and its centre at (0, 0, -R): it passes through the hip, and
its lowest point lies `height` below. The outer face is::

    (R sin phi, y, -R + R cos phi),   0 <= phi <= extent, |y| <= width / 2

from the hip to the front (phi = 90 deg: the convex side looks forward), to the lowest point
(180 deg) and, for 5/8 of a circle (225 deg), on to behind. The thickness goes inwards. A positive
angle turns the leg about +y by the right hand: what hangs below the hip goes to the back, and on
the ground the robot goes forward.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from flexapod.core.errors import InputError, check_finite, check_positive
from flexapod.geometry.gmsh_session import HEXAHEDRON, generate, gmsh_model
from flexapod.geometry.rigid_shapes import MOST_FACES, RigidSurface
from flexapod.geometry.tagged import TaggedMesh, boundary_facets

_TURN = 2.0 * math.pi
# Nearer to nothing or to a full circle, the two end faces would be one to Gmsh.
LEAST_ANGLE = 1e-3  # [rad]
# As many patches may share the arc, and an arc of fewer edges is no circle.
LEAST_ARC_ELEMENTS = 4


@dataclass(frozen=True)
class LegMesh:
    """What a leg is made of, about its hip.

    Attributes
    ----------
    mesh
        Hexahedra in the cell group "leg", numbered along the arc, then across the width, then
        inwards. Facet groups: "sole" (the outer arc), "tip" (the end face at phi = extent),
        "hip" (the one at phi = 0), "inner", "sides"; "outer" is all of them, the whole boundary.
    surface
        The whole boundary with a numbering of its own, faces in the order of "outer". The leg is
        neither convex nor about its centre of mass, as the other rigid surfaces are.
    surface_nodes
        The node of `mesh` behind each node of `surface`, shape (surface_node_count,).
    touching
        Faces of the sole, then of the tip, which walk on the ground: corners in the numbering of
        `surface`, counter-clockwise seen from outside, shape (face_count, 4).
    """

    mesh: TaggedMesh
    surface: RigidSurface
    surface_nodes: np.ndarray
    touching: np.ndarray


@dataclass(frozen=True)
class CLeg:
    """Sizes of a C-shaped leg, its closed forms and its mesh.

    Attributes
    ----------
    height
        Diameter of the outer circle [m]. The robot's legs: 50 mm; 60 mm for pronking.
    extent
        Angle the arc spans [rad]: half a circle; 5/8 of one (1.25 pi) for pronking.
    width
        Size along the hip axis [m]. The robot's legs: 12 mm; 65 mm for rolling.
    thickness
        From the outer face inwards [m]. Not published; 4 mm is assumed, as a printed PLA part that
        does not bend visibly under a robot's weight. It only sets the leg's mass and inertia.
    arc_elements, width_elements, thickness_elements
        Hexahedra along the arc, across the width and through the thickness. 96 along half a
        circle of 50 mm leave its flats 3.3 um inside the circle (`sagitta`).

    Raises
    ------
    InputError
        If a size is not positive, the thickness not below the radius, the extent not within
        `LEAST_ANGLE` and a turn less `LEAST_ANGLE`, or a count too small or too large.
    """

    height: float = 0.050
    extent: float = math.pi
    width: float = 0.012
    thickness: float = 0.004
    arc_elements: int = 96
    width_elements: int = 2
    thickness_elements: int = 1

    def __post_init__(self) -> None:
        for name in ("height", "width", "thickness"):
            check_positive(name, getattr(self, name), "m", "leg")
        if not self.thickness < self.radius:
            raise InputError(
                f"thickness must be less than half the height, {self.radius * 1e3:g} mm, "
                f"got {self.thickness * 1e3:g} mm",
                "leg",
            )
        if not LEAST_ANGLE <= self.extent <= _TURN - LEAST_ANGLE:
            raise InputError(
                f"extent must be within {LEAST_ANGLE:g} and 2 pi - {LEAST_ANGLE:g} rad, "
                f"got {self.extent:g} rad; half a circle is 3.14159 rad",
                "leg",
            )
        counts = []
        for name, least in (
            ("arc_elements", LEAST_ARC_ELEMENTS),
            ("width_elements", 1),
            ("thickness_elements", 1),
        ):
            value = getattr(self, name)
            try:
                count = operator.index(value)
            except TypeError:
                count = -1
            if isinstance(value, bool) or count < least:
                raise InputError(f"{name} must be a whole number >= {least}, got {value!r}", "leg")
            counts.append(count)
        n, w, t = counts
        faces = 2 * (n * w + n * t + w * t)
        if faces > MOST_FACES:
            raise InputError(
                f"arc_elements {n}, width_elements {w} and thickness_elements {t} give {faces} "
                f"faces, more than {MOST_FACES}; write smaller ones",
                "leg",
            )

    @property
    def radius(self) -> float:
        """Radius of the outer circle [m], half the height."""
        return 0.5 * self.height

    def sagitta(self) -> float:
        """Farthest that the mesh's flats lie inside the outer circle [m].

        R (1 - cos(d / 2)) in the middle of an edge over the angle d; h^2 / 8 R for its length h.
        """
        return 2.0 * self.radius * math.sin(0.25 * self.extent / self.arc_elements) ** 2

    def expected_volume(self) -> float:
        """Volume of the leg with true arcs [m3]: extent / 2 (R^2 - r^2) width.

        The mesh has chords for arcs: its volume is smaller by the factor sin(d) / d for edges over
        the angle d = extent / arc_elements, 1 - d^2 / 6 in the first order.
        """
        return 0.5 * self.extent * self._ring(2) * self.width

    def expected_centre(self) -> np.ndarray:
        """Centre of mass of the leg with true arcs, from the hip [m], shape (3,)."""
        x, z = self._mean()
        return np.array([x, 0.0, z - self.radius])

    def expected_inertia(self) -> np.ndarray:
        """Inertia about the centre of mass at unit density [m5], shape (3, 3).

        From the second moments of a sector of a ring about the circle's centre,
        (R^4 - r^4) / 4 times the integrals of sin^2, cos^2 and sin cos, and Steiner's theorem.
        Times the density [kg/m3] it is the inertia [kg m2].
        """
        e, quartic = self.extent, 0.25 * self._ring(4) * self.width
        volume = self.expected_volume()
        x, z = self._mean()
        xx = quartic * (0.5 * e - 0.25 * math.sin(2.0 * e)) - volume * x * x
        zz = quartic * (0.5 * e + 0.25 * math.sin(2.0 * e)) - volume * z * z
        xz = quartic * 0.5 * math.sin(e) ** 2 - volume * x * z
        yy = volume * self.width**2 / 12.0
        return np.array([[yy + zz, 0.0, -xz], [0.0, xx + zz, 0.0], [-xz, 0.0, xx + yy]])

    def _ring(self, power: int) -> float:
        """R^power - r^power of the outer and inner radius."""
        return float(self.radius**power - (self.radius - self.thickness) ** power)

    def _mean(self) -> tuple[float, float]:
        """Centre of mass in x and z from the circle's centre [m]."""
        arm = 2.0 * self._ring(3) / (3.0 * self.extent * self._ring(2))
        return 2.0 * arm * math.sin(0.5 * self.extent) ** 2, arm * math.sin(self.extent)

    # How the leg stands and rolls. Its lowest point is on the outer arc straight below the
    # circle's centre where the arc has one (phi = pi - angle), else it is one of the four corners
    # of its section: along the inner arc and the end faces an end is always lower.

    def lowest(self, angle: float) -> float:
        """How far the lowest point of the leg with true arcs lies below the hip [m], >= 0.

        R (1 + cos(angle)) on the arc; x sin(angle) - z cos(angle) on a corner (x, z).

        Parameters
        ----------
        angle
            Angle of the leg about +y [rad], any number of turns.
        """
        return self._contact(check_finite("angle", angle, "rad", "leg"))[0]

    def contact_phi(self, angle: float) -> float:
        """Where on the outer arc the leg with true arcs is lowest: phi within 0 and extent [rad].

        `extent` while it stands on the tip, 0 on the hip's end, for the inner edges of these two
        end faces as well. Of an end face or a chord flat on the ground it is one end.

        Parameters
        ----------
        angle
            Angle of the leg about +y [rad], any number of turns.
        """
        return self._contact(check_finite("angle", angle, "rad", "leg"))[1]

    def rolling_advance(self, angle_from: float, angle_to: float) -> float:
        """Way the hip goes forward while the leg rolls on level ground without slipping [m].

        At each instant the leg turns about what touches the ground, at the depth `lowest` under
        the hip, and a turn by d(angle) carries the hip forward by lowest(angle) d(angle), on the
        arc and on a corner alike. So the way is the integral of `lowest`; what touches changes
        where two depths are equal, hence without a jump of the hip. Its parts are::

            arc                R (angle + sin(angle))       the circle's centre rolls, and the
                                                            hip turns about it
            corner at (x, z)   -x cos(angle) - z sin(angle)

        Over a whole turn this is the girth of the leg's convex hull. With the hip's end lowest
        (angle about 180 deg) the leg turns on the spot; a body around the hip is not looked at.

        Parameters
        ----------
        angle_from, angle_to
            Angles of the leg about +y [rad]; rolling back (angle_to < angle_from) is negative.
        """
        start = check_finite("angle_from", angle_from, "rad", "leg")
        stop = check_finite("angle_to", angle_to, "rad", "leg")
        low, high = min(start, stop), max(start, stop)
        # Whole turns apart: the rest stays within one, whatever the angles are.
        turns = math.floor((high - low) / _TURN)
        way = self._way(low, high - turns * _TURN)
        if turns:
            way += turns * self._way(0.0, _TURN)
        return way if stop >= start else -way

    def _corners(self) -> list[tuple[float, float, float]]:
        """Corners of the section: phi and the place (x, z) from the hip."""
        out = []
        for phi in (self.extent, 0.0):
            for r in (self.radius, self.radius - self.thickness):
                out.append((phi, r * math.sin(phi), r * math.cos(phi) - self.radius))
        return out

    def _contact(self, angle: float) -> tuple[float, float, tuple[float, float] | None]:
        """Depth of the lowest point, its phi, and its (x, z) if it is a corner."""
        phi = (math.pi - angle) % _TURN
        if phi <= self.extent:
            return self.radius * (1.0 + math.cos(angle)), phi, None
        sine, cosine = math.sin(angle), math.cos(angle)
        # Ties go to the first, whose order is tip before hip and outside before inside.
        depth, phi, x, z = max(
            ((x * sine - z * cosine, phi, x, z) for phi, x, z in self._corners()),
            key=lambda corner: corner[0],
        )
        return depth, phi, (x, z)

    def _way(self, low: float, high: float) -> float:
        """Integral of `lowest` over not much more than a turn."""
        corners = self._corners()
        changes = [math.pi - self.extent, math.pi]
        for k, (_, x1, z1) in enumerate(corners):
            for _, x2, z2 in corners[:k]:
                # Both equally deep: (x1 - x2) sin = (z1 - z2) cos.
                level = math.atan2(z1 - z2, x1 - x2)
                changes += [level, level + math.pi]
        inside = {low + (change - low) % _TURN for change in changes}
        cuts = [low, *sorted(cut for cut in inside if low < cut < high), high]
        way = 0.0
        for a, b in pairwise(cuts):
            place = self._contact(0.5 * (a + b))[2]
            if place is None:
                way += self.radius * (b - a + math.sin(b) - math.sin(a))
            else:
                x, z = place
                way -= x * (math.cos(b) - math.cos(a)) + z * (math.sin(b) - math.sin(a))
        return way

    def build(self) -> LegMesh:
        """Mesh the leg with Gmsh: transfinite sectors of the ring, extruded along the hip axis.

        All nodes of the sole lie on the outer circle to round-off, at equal angles.
        """
        lattice, cells = self._gmsh_cells()
        along, across, inward = self.arc_elements, self.width_elements, self.thickness_elements
        shape = (along + 1, across + 1, inward + 1)
        i, j, k = np.indices(shape).reshape(3, -1)
        # Gmsh spaces the nodes of an arc to 1e-7 of an edge only; their places are known better.
        phi = self.extent * i / along
        r = self.radius - self.thickness * k / inward
        nodes = np.stack(
            [r * np.sin(phi), self.width * (j / across - 0.5), r * np.cos(phi) - self.radius],
            axis=1,
        )
        cells = np.ravel_multi_index(tuple(np.moveaxis(lattice, -1, 0)), shape)[cells]
        cells = cells[np.argsort(cells.min(axis=1))].astype(np.int64)

        outer = boundary_facets(cells)
        on = {
            "sole": (k == 0)[outer].all(axis=1),
            "tip": (i == along)[outer].all(axis=1),
            "hip": (i == 0)[outer].all(axis=1),
            "inner": (k == inward)[outer].all(axis=1),
            "sides": (j == 0)[outer].all(axis=1) | (j == across)[outer].all(axis=1),
        }
        used, numbers = np.unique(outer, return_inverse=True)
        faces = numbers.reshape(-1, 4).astype(np.int64)
        return LegMesh(
            mesh=TaggedMesh(
                nodes,
                cells,
                {"leg": np.arange(len(cells))},
                {**{name: outer[pick] for name, pick in on.items()}, "outer": outer},
            ),
            surface=RigidSurface(np.ascontiguousarray(nodes[used]), faces),
            surface_nodes=used,
            touching=np.concatenate([faces[on["sole"]], faces[on["tip"]]]),
        )

    def _gmsh_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Hexahedra from Gmsh, and of each node its number along, across and inward."""
        with gmsh_model("leg") as gmsh:
            self._draw(gmsh.model.geo)
            nodes, corners = generate(gmsh, HEXAHEDRON, "a leg")
        # The centre of the arcs is a node of no hexahedron.
        used, cells = np.unique(corners, return_inverse=True)
        cells = cells.reshape(-1, 8)
        x, y, z = nodes[used].T

        # The jump of the angle goes to the middle of the opening.
        half_gap = 0.5 * (_TURN - self.extent)
        phi = (np.arctan2(x, z + self.radius) + half_gap) % _TURN - half_gap
        r = np.hypot(x, z + self.radius)
        counts = np.array([self.arc_elements, self.width_elements, self.thickness_elements])
        places = counts * np.stack(
            [phi / self.extent, y / self.width + 0.5, (self.radius - r) / self.thickness], axis=1
        )
        lattice = np.rint(places).astype(np.int64)
        distinct = len(np.unique(lattice, axis=0))
        off = float(np.abs(places - lattice).max())
        if len(cells) != counts.prod() or distinct != (counts + 1).prod() or off > 1e-3:
            raise RuntimeError(
                f"Gmsh filled a leg with {len(cells)} hexahedra on {distinct} nodes, {off:.1e} of "
                f"an edge off, expected {counts.prod()} on {(counts + 1).prod()}"
            )
        return lattice, cells

    def _draw(self, geo: Any) -> None:
        """The section at y = -width / 2 in patches below a quarter turn, extruded along y.

        An arc of Gmsh must stay below half a turn.
        """
        patches = math.ceil(self.extent / (0.5 * math.pi) - 1e-9)
        cuts = [self.arc_elements * p // patches for p in range(patches + 1)]
        y = -0.5 * self.width
        centre = geo.addPoint(0.0, y, -self.radius)
        radii = (self.radius - self.thickness, self.radius)
        spokes, rims = [], []
        for cut in cuts:
            phi = self.extent * cut / self.arc_elements
            rims.append(
                [geo.addPoint(r * math.sin(phi), y, r * math.cos(phi) - self.radius) for r in radii]
            )
            spokes.append(geo.addLine(*rims[-1]))
            geo.mesh.setTransfiniteCurve(spokes[-1], self.thickness_elements + 1)
        surfaces = []
        for p in range(patches):
            inner, outer = (
                geo.addCircleArc(one, centre, two)
                for one, two in zip(rims[p], rims[p + 1], strict=True)
            )
            for arc in (inner, outer):
                geo.mesh.setTransfiniteCurve(arc, cuts[p + 1] - cuts[p] + 1)
            loop = geo.addCurveLoop([spokes[p], outer, -spokes[p + 1], -inner])
            surfaces.append(geo.addPlaneSurface([loop]))
            geo.mesh.setTransfiniteSurface(surfaces[-1])
            geo.mesh.setRecombine(2, surfaces[-1])
        geo.extrude(
            [(2, surface) for surface in surfaces],
            0.0,
            self.width,
            0.0,
            numElements=[self.width_elements],
            recombine=True,
        )


__all__ = ["LEAST_ANGLE", "LEAST_ARC_ELEMENTS", "CLeg", "LegMesh"]
