"""C-shaped legs: their mesh against the closed forms, their rolling against brute force."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.dynamics.rigid import mass_properties
from flexapod.geometry.legs import CLeg, LegMesh
from flexapod.geometry.tagged import TaggedMesh

HALF = CLeg()
# 5/8 of a circle as for pronking, with an uneven split into patches and more than one layer.
LONG = CLeg(height=0.060, extent=1.25 * math.pi, arc_elements=97, thickness_elements=2)
SHORT = CLeg(extent=0.3 * math.pi)
NEARLY = CLeg(extent=1.9 * math.pi)
LEGS = pytest.mark.parametrize(
    "leg", [HALF, LONG, SHORT, NEARLY], ids=["half", "long", "short", "nearly"]
)
ANGLES = np.linspace(-7.0, 7.0, 401)
built = cache(CLeg.build)


def _normals(nodes: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = nodes[faces]
    return 0.5 * np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]), p.mean(axis=1)


def _section(leg: CLeg, count: int = 4001) -> np.ndarray:
    """Places (x, z) all over the outline of the leg's section, shape (n, 2) [m]."""
    phi = np.linspace(0.0, leg.extent, count)
    r = np.linspace(leg.radius - leg.thickness, leg.radius, 21)
    parts: list[tuple[Any, Any]] = [
        (leg.radius, phi),
        (leg.radius - leg.thickness, phi),
        (r, 0.0),
        (r, leg.extent),
    ]
    rows = []
    for radius, angle in parts:
        x, z = np.broadcast_arrays(radius * np.sin(angle), radius * np.cos(angle) - leg.radius)
        rows.append(np.stack([x, z], axis=1))
    return np.concatenate(rows)


def _turn(angle: float) -> np.ndarray:
    """Right-hand rotation about +y, on (x, z)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])


@pytest.mark.parametrize("leg", [HALF, LONG], ids=["half", "long"])
def test_the_boundary_is_closed_outward_and_fully_named(leg: CLeg) -> None:
    made: LegMesh = built(leg)
    mesh, surface = made.mesh, made.surface
    n, w, t = leg.arc_elements, leg.width_elements, leg.thickness_elements
    counts = {"sole": n * w, "inner": n * w, "tip": w * t, "hip": w * t, "sides": 2 * n * t}
    assert {name: len(q) for name, q in mesh.facet_groups.items() if name != "outer"} == counts
    assert np.array_equal(mesh.cell_groups["leg"], np.arange(n * w * t))
    # The five groups share the boundary out.
    groups = np.concatenate([mesh.facet_groups[name] for name in counts])
    assert {tuple(q) for q in groups} == {tuple(q) for q in mesh.facet_groups["outer"]}
    assert len(groups) == len(mesh.facet_groups["outer"])

    # Each edge is run through once either way: closed and turned alike; Euler 2: one piece.
    edges = surface.faces[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)
    both = {tuple(e) for e in edges}
    assert both == {(b, a) for a, b in both}
    assert len(surface.nodes) - len(edges) // 2 + len(surface.faces) == 2
    assert np.array_equal(np.unique(surface.faces), np.arange(len(surface.nodes)))
    assert np.array_equal(mesh.nodes[made.surface_nodes], surface.nodes)
    assert np.array_equal(made.surface_nodes[surface.faces], mesh.facet_groups["outer"])

    # Outward: the directions of the five faces, and by the divergence theorem the mesh's volume.
    axis = np.array([0.0, 0.0, -leg.radius])
    for name, quads in mesh.facet_groups.items():
        normal, middle = _normals(mesh.nodes, quads)
        if name in ("sole", "inner"):
            radial = np.einsum("ij,ij->i", normal, (middle - axis) * [1.0, 0.0, 1.0])
            assert (radial > 0.0).all() if name == "sole" else (radial < 0.0).all()
        elif name == "sides":
            assert (normal[:, 1] * middle[:, 1] > 0.0).all()
        elif name in ("tip", "hip"):
            phi, sign = (leg.extent, 1.0) if name == "tip" else (0.0, -1.0)
            along = sign * np.array([math.cos(phi), 0.0, -math.sin(phi)])
            area = leg.thickness * leg.width
            assert np.allclose(normal.sum(axis=0), area * along, rtol=0.0, atol=1e-12 * area)
    normal, middle = _normals(surface.nodes, surface.faces)
    volume = np.einsum("ij,ij->", normal, middle) / 3.0
    assert volume == pytest.approx(mass_properties(mesh.nodes, mesh.cells, 1.0)[0], rel=1e-12)

    touching = np.concatenate([mesh.facet_groups["sole"], mesh.facet_groups["tip"]])
    assert np.array_equal(made.surface_nodes[made.touching], touching)


@pytest.mark.parametrize("leg", [HALF, LONG], ids=["half", "long"])
def test_the_sole_is_on_the_circle(leg: CLeg) -> None:
    mesh: TaggedMesh = built(leg).mesh
    sole = mesh.nodes[mesh.facet_nodes("sole")]
    distance = np.hypot(sole[:, 0], sole[:, 2] + leg.radius)
    # Round-off of a few operations on numbers of the radius' size.
    assert np.abs(distance - leg.radius).max() < 4 * np.finfo(float).eps * leg.height
    for name, radius in (("sole", leg.radius), ("inner", leg.radius - leg.thickness)):
        points = mesh.nodes[mesh.facet_nodes(name)]
        assert np.allclose(np.hypot(points[:, 0], points[:, 2] + leg.radius), radius, rtol=1e-14)
    # From the hip over the front to the tip, as the module says.
    assert np.abs(sole).min(axis=0)[1] == 0.0
    assert np.abs(sole - [0.0, 0.0, 0.0]).sum(axis=1).min() == 0.0
    assert sole[:, 0].max() == pytest.approx(leg.radius, rel=1e-3)
    assert np.ptp(sole[:, 1]) == leg.width and sole[:, 1].max() == 0.5 * leg.width
    tip = mesh.nodes[mesh.facet_nodes("tip")]
    outside = tip[np.argmax(np.hypot(tip[:, 0], tip[:, 2] + leg.radius))]
    x, z = leg.radius * math.sin(leg.extent), leg.radius * (math.cos(leg.extent) - 1.0)
    assert np.allclose(outside[[0, 2]], [x, z], rtol=0.0, atol=1e-16)
    # Middles of the flats are the deepest inside the circle.
    _, middle = _normals(mesh.nodes, mesh.facet_groups["sole"])
    inside = leg.radius - np.hypot(middle[:, 0], middle[:, 2] + leg.radius)
    assert np.allclose(inside, leg.sagitta(), rtol=1e-9)


def test_the_flats_of_the_usual_leg_are_3_um_inside() -> None:
    h = HALF.radius * math.pi / 96
    # The sagitta is h^2 / 8 R to the order (h / R)^2 = 1e-3.
    assert HALF.sagitta() == pytest.approx(h * h / (8.0 * HALF.radius), rel=1e-3)
    assert HALF.sagitta() == pytest.approx(3.3e-6, abs=0.05e-6)


@pytest.mark.parametrize("name", ["half", "long"])
def test_mass_centre_and_inertia_converge_to_the_closed_forms(name: str) -> None:
    """Chords for arcs: errors fall with the square of the edge, d^2 / 6 for the volume."""
    base: Any = {"half": CLeg, "long": lambda **n: CLeg(0.06, 1.25 * math.pi, 0.02, 0.007, **n)}[
        name
    ]
    errors = []
    for count in (24, 48, 96):
        leg = base(arc_elements=count)
        mesh = built(leg).mesh
        mass, centre, inertia = mass_properties(mesh.nodes, mesh.cells, 1.0)
        d = leg.extent / count
        # The polygon's area is known: only round-off is left.
        assert mass == pytest.approx(leg.expected_volume() * math.sin(d) / d, rel=1e-12)
        exact = leg.expected_inertia()
        errors.append(
            [
                1.0 - mass / leg.expected_volume(),
                np.abs(centre - leg.expected_centre()).max() / leg.radius,
                np.abs(inertia - exact).max() / exact.max(),
            ]
        )
        # Zero by the leg's symmetry in y.
        assert abs(centre[1]) < 1e-15
        assert np.abs(inertia[1, [0, 2]]).max() < 1e-12 * exact.max()
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    # Measured: 1.995 to 2.000; the next term of the error is smaller by d^2 < 0.03.
    assert np.abs(rates - 2.0).max() < 0.01, (errors, rates)
    # Measured at 96 elements: half 1.8e-4, 5.2e-5 and 3.6e-4; long 2.8e-4, 5.4e-5 and 5.6e-4.
    assert np.max(errors[-1]) < 1e-3


@LEGS
def test_closed_forms_equal_a_fine_sum_over_the_section(leg: CLeg) -> None:
    """Midpoint rule over the ring; measured at most 4.3e-7 of the radius and 1.4e-6."""
    n = 800
    phi = leg.extent * (np.arange(n) + 0.5) / n
    r = leg.radius - leg.thickness * (np.arange(n) + 0.5)[:, None] / n
    weight = np.broadcast_to(r, (n, n)) * (leg.extent / n) * (leg.thickness / n) * leg.width
    x, z = r * np.sin(phi), r * np.cos(phi) - leg.radius
    volume = weight.sum()
    cx, cz = (weight * x).sum() / volume, (weight * z).sum() / volume
    xx, zz = (weight * (x - cx) ** 2).sum(), (weight * (z - cz) ** 2).sum()
    xz, yy = (weight * (x - cx) * (z - cz)).sum(), volume * leg.width**2 / 12.0
    inertia = np.array([[yy + zz, 0, -xz], [0, xx + zz, 0], [-xz, 0, xx + yy]])
    assert leg.expected_volume() == pytest.approx(volume, rel=1e-9)  # linear in r: exact
    assert np.allclose(leg.expected_centre(), [cx, 0.0, cz], rtol=0.0, atol=1e-6 * leg.radius)
    assert np.allclose(leg.expected_inertia(), inertia, rtol=0.0, atol=3e-6 * inertia.max())


def test_two_builds_are_alike() -> None:
    one, two = CLeg(arc_elements=12).build(), CLeg(arc_elements=12).build()
    assert one.mesh.nodes.tobytes() == two.mesh.nodes.tobytes()
    assert np.array_equal(one.mesh.cells, two.mesh.cells)
    assert list(one.mesh.facet_groups) == list(two.mesh.facet_groups)
    for name, quads in one.mesh.facet_groups.items():
        assert np.array_equal(quads, two.mesh.facet_groups[name])
    assert one.surface.nodes.tobytes() == two.surface.nodes.tobytes()
    assert np.array_equal(one.surface.faces, two.surface.faces)
    assert np.array_equal(one.touching, two.touching)


@LEGS
def test_extreme_arcs_and_coarse_meshes_are_built(leg: CLeg) -> None:
    coarse = CLeg(leg.height, leg.extent, leg.width, leg.thickness, 5, 1, 1)
    mesh = built(coarse).mesh
    d = leg.extent / 5
    mass = mass_properties(mesh.nodes, mesh.cells, 1.0)[0]
    assert mass == pytest.approx(leg.expected_volume() * math.sin(d) / d, rel=1e-12)


@LEGS
def test_the_lowest_point_is_that_of_the_section(leg: CLeg) -> None:
    section = _section(leg)
    # The lowest of dense points is above the arc's by less than the sagitta of their spacing.
    missing = leg.radius * (leg.extent / 4000) ** 2 / 8.0
    for angle in ANGLES:
        z = (section @ _turn(angle).T)[:, 1]
        depth = leg.lowest(angle)
        assert -1e-15 <= depth + z.min() <= missing + 1e-15, angle
        phi = leg.contact_phi(angle)
        assert 0.0 <= phi <= leg.extent
        # The place named is as low, or an end face's inner edge is.
        radii = [leg.radius]
        if phi in (0.0, leg.extent):
            radii.append(leg.radius - leg.thickness)
        places = [[r * math.sin(phi), r * math.cos(phi) - leg.radius] for r in radii]
        assert (np.array(places) @ _turn(angle).T)[:, 1].min() == pytest.approx(-depth, abs=1e-15)


def test_contact_goes_from_the_tip_along_the_arc_to_the_hip() -> None:
    at = np.radians([-90.0, -46.0, -44.0, 0.0, 90.0, 179.0, 181.0])
    phi = np.degrees([LONG.contact_phi(angle) for angle in at])
    assert np.allclose(phi, [225.0, 225.0, 224.0, 180.0, 90.0, 1.0, 0.0], rtol=0.0, atol=1e-9)
    assert HALF.lowest(0.0) == pytest.approx(HALF.height, rel=1e-15)
    # A quarter turn back the C lies on its front, a quarter forward on its two ends.
    assert HALF.lowest(0.5 * math.pi) == pytest.approx(HALF.radius, rel=1e-15)
    assert HALF.lowest(-0.5 * math.pi) == pytest.approx(0.0, abs=1e-16)


@LEGS
def test_a_turn_advances_by_the_girth_of_the_hull(leg: CLeg) -> None:
    r = leg.radius - leg.thickness
    chord = 2.0 * math.sin(0.5 * leg.extent)
    girth = leg.radius * leg.extent + chord * leg.radius
    if leg.extent < math.pi:  # the inner edges stand out of the chord
        girth += 2.0 * leg.thickness + chord * (r - leg.radius)
    for start in (0.0, 1.0, -2.5):
        assert leg.rolling_advance(start, start + 2.0 * math.pi) == pytest.approx(girth, rel=1e-13)
    assert leg.rolling_advance(1.0, 1.0 - 6.0 * math.pi) == pytest.approx(-3 * girth, rel=1e-13)
    parts = [leg.rolling_advance(a, b) for a, b in pairwise(ANGLES)]
    assert sum(parts) == pytest.approx(leg.rolling_advance(-7.0, 7.0), rel=1e-12)
    assert leg.rolling_advance(0.3, 0.3) == 0.0


def test_the_half_circle_rolls_as_worked_by_hand() -> None:
    r = HALF.radius
    # About the tip, 2 R below: 2 R sin; on the arc the centre rolls and the hip turns about it.
    assert HALF.rolling_advance(-0.5 * math.pi, 0.0) == pytest.approx(2.0 * r, rel=1e-14)
    assert HALF.rolling_advance(0.0, 0.5 * math.pi) == pytest.approx(r * (0.5 * math.pi + 1.0))
    assert HALF.rolling_advance(0.0, math.pi) == pytest.approx(math.pi * r, rel=1e-14)
    assert HALF.rolling_advance(math.pi, 1.5 * math.pi) == pytest.approx(0.0, abs=1e-16)
    # The tripod's stance, 60 deg about 30 deg.
    assert HALF.rolling_advance(0.0, math.pi / 3.0) == pytest.approx(
        r * (math.pi / 3.0 + math.sqrt(0.75)), rel=1e-14
    )


@LEGS
@pytest.mark.parametrize(("start", "stop"), [(-2.0, 1.2), (0.4, 5.5), (2.0, -3.0)])
def test_rolling_advance_equals_a_simulated_roll(leg: CLeg, start: float, stop: float) -> None:
    """Turn about the lowest of dense points by small steps; nothing else of the leg is used.

    A step d on the arc leaves the circle by R d^3 / 6, a change from corner to corner comes late
    by at most the height times d^2 / 2, four times in a turn; the points lie inside the arc by a
    sagitta. Measured: a quarter of their sum at most.
    """
    count = 2000
    step = (stop - start) / count
    section = _section(leg, 2001)
    hip = 0.0
    for k in range(count):
        pose = section @ _turn(start + k * step).T
        pivot = pose[np.argmin(pose[:, 1])]
        # The hip, at -pivot from it, turns about it.
        hip += (pivot - _turn(step) @ pivot)[0]
    swept = abs(stop - start)
    tolerance = leg.radius * swept * (step**2 / 6.0 + (leg.extent / 2000) ** 2 / 8.0)
    tolerance += 4.0 * leg.height * step**2 / 2.0
    assert leg.rolling_advance(start, stop) == pytest.approx(hip, abs=tolerance)


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"height": 0.0}, "height must be finite and > 0"),
        ({"width": -0.01}, "width must be"),
        ({"thickness": math.nan}, "thickness must be"),
        ({"thickness": 0.025}, "less than half the height, 25 mm, got 25 mm"),
        ({"extent": 0.0}, "extent must be within"),
        ({"extent": 2.0 * math.pi}, "extent must be within"),
        ({"extent": math.nan}, "extent must be within"),
        ({"arc_elements": 3}, "arc_elements must be a whole number >= 4, got 3"),
        ({"arc_elements": 96.0}, "arc_elements must be a whole number"),
        ({"width_elements": 0}, "width_elements must be"),
        ({"thickness_elements": True}, "thickness_elements must be"),
        ({"arc_elements": 10000}, "more than 20000; write smaller ones"),
    ],
)
def test_bad_sizes_are_refused(bad: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        CLeg(**bad)  # type: ignore[arg-type]


def test_bad_angles_are_refused() -> None:
    for call in (HALF.lowest, HALF.contact_phi, lambda a: HALF.rolling_advance(0.0, a)):
        with pytest.raises(InputError, match="must be finite"):
            call(math.inf)
