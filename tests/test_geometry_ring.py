"""The circular robot's layouts: what they weigh, how stiff they are and what they join."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.geometry.builders import BUILDERS
from flexapod.geometry.quality import cell_volumes, scaled_jacobians
from flexapod.geometry.ring import (
    LETTERS,
    RingBuilder,
    RingLayout,
    RingSizes,
    lumped_ring,
    lumped_sphere,
    solid_ring,
    solid_section,
)
from flexapod.geometry.tagged import boundary_facets, orient_outward

ROUND_OFF = 1e-12  # sums of some hundred numbers of 1e-16 each, with a margin
COUNTS = (8, 16, 32, 64, 128)


def _layouts(sizes: RingSizes) -> list[tuple[RingLayout, int]]:
    return [(lumped_ring(sizes), 1), (lumped_sphere(sizes), 3)]


def _angle(layout: RingLayout, ring: int, node: int) -> float:
    """Of a node about the ring's normal from where the ring begins unturned [deg]."""
    normal = layout.ring_normals[ring]
    start = np.array([0.0, -1.0, 0.0]) if ring == 1 else np.array([0.0, 0.0, -1.0])
    arm = layout.nodes[node] - layout.nodes[layout.hub]
    return math.degrees(math.atan2(np.dot(normal, np.cross(start, arm)), np.dot(start, arm))) % 360


def test_the_default_is_the_paper_s_robot() -> None:
    sizes = RingSizes()
    layout = lumped_ring(sizes)
    assert (sizes.diameter, sizes.mass) == (0.04, 3e-3)
    assert sizes.mass_of_hub == pytest.approx(3e-4, rel=ROUND_OFF)
    assert RingSizes(hub_mass=1e-3).shell_mass == pytest.approx(2e-3, rel=ROUND_OFF)
    assert np.ptp(layout.nodes[:, 0]) == 0.04 and np.ptp(layout.nodes[:, 2]) == 0.04
    assert layout.nodes[0].tolist() == [0.0, 0.0, 0.0]
    assert layout.nodes[layout.hub].tolist() == [0.0, 0.0, 0.02]
    assert not layout.nodes[:, 1].any()


@pytest.mark.parametrize("n", COUNTS)
def test_counts(n: int) -> None:
    for layout, rings in _layouts(RingSizes(node_count=n)):
        shell = {1: n, 3: 3 * n - 6}[rings]
        assert layout.nodes.shape == (shell + 1, 3) and layout.hub == shell
        assert [len(ring) for ring in layout.rings] == [n] * rings
        assert layout.segments.shape == (rings * n, 2) == (len(layout.segment_length), 2)
        assert layout.hinges.shape == (rings * n, 3) and layout.rest_angle.shape == (rings * n,)
        np.testing.assert_array_equal(np.unique(layout.segments), np.arange(shell))
        assert layout.node_mass.shape == (shell + 1,)


@pytest.mark.parametrize("n", COUNTS)
def test_lengths_masses_and_areas(n: int) -> None:
    sizes = RingSizes(node_count=n, width=5e-3)
    chord = sizes.diameter * math.sin(math.pi / n)
    for layout, rings in _layouts(sizes):
        a, b = layout.segments.T
        distance = np.linalg.norm(layout.nodes[b] - layout.nodes[a], axis=1)
        np.testing.assert_allclose(layout.segment_length, chord, rtol=ROUND_OFF)
        np.testing.assert_allclose(distance, chord, rtol=ROUND_OFF)
        assert layout.node_mass.min() > 0.0
        total = rings * (sizes.mass - 3e-4) + 3e-4
        assert layout.node_mass.sum() == pytest.approx(total, rel=ROUND_OFF)
        centre = layout.node_mass @ layout.nodes / total
        np.testing.assert_allclose(centre, [0.0, 0.0, 0.02], atol=1e-17)
        for refine in (1, 3):
            touching = layout.touching(refine)
            assert touching.areas.shape == (rings * n * refine, 4) == touching.faces.shape
            # A polygon's sides are shorter than the circle by sin(x)/x, x = pi/n.
            area = rings * math.pi * sizes.diameter * sizes.width
            polygon = math.sin(math.pi / n) / (math.pi / n)
            assert touching.areas.sum() == pytest.approx(area * polygon, rel=ROUND_OFF)


def test_what_touches_is_a_smooth_curve_through_the_nodes() -> None:
    """Catmull-Rom: at half a step h/2 of a circle its radius is 9/8 cos(h/2) - 1/8 cos(3h/2)."""
    for layout, _ in _layouts(RingSizes(node_count=32)):
        chords = layout.touching(1)
        np.testing.assert_array_equal(chords.nodes[:, 1], np.concatenate(layout.rings))
        np.testing.assert_array_equal(
            chords.weights, np.tile([0.0, 1.0, 0.0, 0.0], (len(chords.nodes), 1))
        )
        curve = layout.touching(2)
        np.testing.assert_allclose(curve.weights.sum(axis=1), 1.0, rtol=ROUND_OFF)
        x = np.einsum("pa,pai->pi", curve.weights, layout.nodes[curve.nodes])
        radius = np.linalg.norm(x - layout.nodes[layout.hub], axis=1)
        h = 2.0 * math.pi / 32
        middle = 9.0 / 8.0 * math.cos(h / 2) - math.cos(3 * h / 2) / 8.0
        np.testing.assert_allclose(radius[0::2], 0.02, rtol=1e-14)
        np.testing.assert_allclose(radius[1::2], 0.02 * middle, rtol=1e-14)
        # Pieces follow one another round each loop.
        assert (np.sort(curve.faces[:, 0]) == np.sort(curve.faces[:, 1])).all()
        with pytest.raises(InputError, match="contact_refine must be a whole number >= 1, got 0"):
            layout.touching(0)


@pytest.mark.parametrize("n", COUNTS)
def test_rigidities_do_not_depend_on_the_count(n: int) -> None:
    sizes = RingSizes(node_count=n)
    element = math.pi * sizes.diameter / n
    arc = math.pi * 0.04 / 8
    assert sizes.element_stiffness * element == pytest.approx(500.0 * arc, rel=ROUND_OFF)
    assert sizes.element_damping * element == pytest.approx(0.1 * arc, rel=ROUND_OFF)
    assert sizes.hinge_stiffness * element == pytest.approx(0.0015 * arc, rel=ROUND_OFF)
    assert sizes.stretch_rigidity == pytest.approx(500.0 * arc, rel=ROUND_OFF)
    assert sizes.bend_rigidity == pytest.approx(0.0015 * arc, rel=ROUND_OFF)
    # n/8 springs in a row are the paper's arc.
    assert sizes.element_stiffness / (n / 8) == pytest.approx(500.0, rel=ROUND_OFF)


def _pinch_compliance(layout: RingLayout) -> float:
    """Shortening of a ring's upright diameter over the two forces that press it [m/N], linear."""
    sizes, n = layout.sizes, layout.hub
    x = layout.nodes[:, [0, 2]]

    def turn(a: int, b: int) -> np.ndarray:
        """Gradient of the direction of the segment from a to b."""
        along = x[b] - x[a]
        row = np.zeros((n, 2))
        row[b] = np.array([-along[1], along[0]]) / (along @ along)
        row[a] = -row[b]
        return row.ravel()

    stiffness = np.zeros((2 * n, 2 * n))
    for a, b in layout.segments:
        along = (x[b] - x[a]) / np.linalg.norm(x[b] - x[a])
        row = np.zeros((n, 2))
        row[b], row[a] = along, -along
        stiffness += sizes.element_stiffness * np.outer(row, row)
    for a, b, c in layout.hinges:
        change = turn(b, c) - turn(a, b)
        stiffness += sizes.hinge_stiffness * np.outer(change, change)
    force = np.zeros((n, 2))
    force[0, 1], force[n // 2, 1] = 1.0, -1.0
    # The forces are in balance: the least squares leave the three rigid motions out.
    moved = np.linalg.lstsq(stiffness, force.ravel(), rcond=1e-10)[0].reshape(n, 2)
    return float(moved[0, 1] - moved[n // 2, 1])


def test_a_pinched_ring_gives_way_as_the_circular_beam() -> None:
    """(pi/4 - 2/pi) R^3/EI + (pi/4) R/EA; Timoshenko, Strength of materials II, article 14.

    The error is of second order in the angle of an element: a quarter at twice the count.
    Measured: 10.5 % at 16 nodes, 2.64 % at 32, 0.66 % at 64.
    """
    errors = []
    for n in (16, 32, 64):
        sizes = RingSizes(node_count=n)
        beam = (math.pi / 4 - 2 / math.pi) * sizes.radius**3 / sizes.bend_rigidity
        beam += math.pi / 4 * sizes.radius / sizes.stretch_rigidity
        errors.append(abs(_pinch_compliance(lumped_ring(sizes)) / beam - 1.0))
        print(f"{n} nodes: {errors[-1]:.3%}")
    assert errors[1] < 0.03
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.05)


@pytest.mark.parametrize("n", COUNTS)
def test_hinges_turn_about_the_ring_s_normal(n: int) -> None:
    for layout, rings in _layouts(RingSizes(node_count=n)):
        before, own, after = layout.nodes[layout.hinges].transpose(1, 0, 2)
        one, two = own - before, after - own
        normal = layout.ring_normals[layout.hinge_ring]
        sine = np.einsum("ij,ij->i", normal, np.cross(one, two))
        turned = np.arctan2(sine, np.einsum("ij,ij->i", one, two))
        np.testing.assert_allclose(turned, layout.rest_angle, rtol=0.0, atol=ROUND_OFF)
        total = np.bincount(layout.hinge_ring, layout.rest_angle)
        np.testing.assert_allclose(total, np.full(rings, 2.0 * math.pi), rtol=ROUND_OFF)
        for ring, loop in enumerate(layout.rings):
            mine = layout.hinges[layout.hinge_ring == ring]
            np.testing.assert_array_equal(mine[:, 1], loop)
            np.testing.assert_array_equal(np.roll(mine[:, 2], 1), loop)
    strip = lumped_ring(RingSizes(node_count=n), rest_curvature=0.0)
    assert not strip.rest_angle.any()


def test_a_ring_is_its_own_mirror_image_to_the_last_bit() -> None:
    for n in COUNTS:
        nodes = lumped_ring(RingSizes(node_count=n)).nodes[:-1]
        mirrored = nodes[(-np.arange(n)) % n]
        np.testing.assert_array_equal(mirrored[:, 0], -nodes[:, 0])
        np.testing.assert_array_equal(mirrored[:, 2], nodes[:, 2])


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("first", [0.0, 22.5, 90.0, -7.3, 400.0])
def test_spokes_and_chord(first: float, direction: int) -> None:
    word = {1: "counter-clockwise", -1: "clockwise"}[direction]
    sizes = RingSizes(first_angle=math.radians(first), letters_direction=word)
    layout = lumped_ring(sizes)
    assert list(layout.spokes) == list(LETTERS)
    for j, (hub, node) in enumerate(layout.spokes.values()):
        assert hub == layout.hub
        wanted = (first + direction * 45.0 * j) % 360
        off = (_angle(layout, 0, node) - wanted + 180.0) % 360.0 - 180.0
        assert abs(off) < 1e-9
    assert layout.chords == {"I": (layout.spokes["B"][1], layout.spokes["H"][1])}
    assert layout.nodes[:, 2].min() == 0.0
    assert layout.nodes[layout.hub, :2].tolist() == [0.0, 0.0]
    arms = layout.nodes[:-1] - layout.nodes[-1]
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), 0.02, rtol=ROUND_OFF)
    pairs, rows = layout.coil_pairs()
    assert pairs.shape == (9, 2) and rows == {name: i for i, name in enumerate("ABCDEFGHI")}
    assert tuple(pairs[8]) == layout.chords["I"]


def test_counter_clockwise_is_seen_from_the_side_of_minus_y() -> None:
    layout = lumped_ring(RingSizes())
    at = {name: layout.nodes[node] for name, (_, node) in layout.spokes.items()}
    np.testing.assert_allclose(at["C"], [0.02, 0.0, 0.02], atol=1e-18)
    np.testing.assert_allclose(at["E"], [0.0, 0.0, 0.04], atol=1e-18)
    clockwise = lumped_ring(RingSizes(letters_direction="clockwise"))
    np.testing.assert_array_equal(clockwise.nodes, layout.nodes)
    assert clockwise.spokes["C"] == layout.spokes["G"]


@pytest.mark.parametrize("n", COUNTS)
def test_the_rings_of_a_sphere_share_six_nodes(n: int) -> None:
    sizes = RingSizes(node_count=n)
    layout = lumped_sphere(sizes)
    scale = 1e9 / sizes.diameter
    assert len(np.unique(np.round(layout.nodes * scale), axis=0)) == len(layout.nodes)
    times = np.bincount(np.concatenate(layout.rings), minlength=layout.hub)
    crossings = np.flatnonzero(times == 2)
    assert times.max() == 2 and len(crossings) == 6
    arms = layout.nodes - layout.nodes[layout.hub]
    axes = {tuple(np.round(arms[k] / sizes.radius).astype(int)) for k in crossings}
    assert axes == {tuple(s * e) for e in np.eye(3, dtype=int) for s in (1, -1)}
    once = (sizes.mass - 3e-4) / n
    np.testing.assert_allclose(layout.node_mass[crossings], 2 * once, rtol=ROUND_OFF)
    np.testing.assert_allclose(
        np.delete(layout.node_mass, [*crossings, layout.hub]), once, rtol=ROUND_OFF
    )
    for loop, normal in zip(layout.rings, layout.ring_normals, strict=True):
        np.testing.assert_allclose(arms[loop] @ normal, 0.0, atol=1e-18)
    np.testing.assert_array_equal(layout.ring_normals, [[0, -1, 0], [0, 0, 1], [1, 0, 0]])


@pytest.mark.parametrize("first", [0.0, 45.0, -90.0])
def test_coils_of_a_sphere_are_shared_at_the_crossings(first: float) -> None:
    layout = lumped_sphere(RingSizes(first_angle=math.radians(first)))
    assert list(layout.spokes) == [f"{letter}{ring}" for ring in (1, 2, 3) for letter in LETTERS]
    for name, (_, node) in layout.spokes.items():
        ring, j = int(name[1]) - 1, LETTERS.index(name[0])
        off = (_angle(layout, ring, node) - first - 45.0 * j + 180.0) % 360.0 - 180.0
        assert abs(off) < 1e-9
    pairs, rows = layout.coil_pairs()
    # 24 names of spokes, 12 of them at six crossings, and three chords.
    assert len(rows) == 27 and len(pairs) == 18 + 3 == len(np.unique(pairs, axis=0))
    for name, pair in {**layout.spokes, **layout.chords}.items():
        assert tuple(pairs[rows[name]]) == pair
    assert sorted(layout.chords) == ["I1", "I2", "I3"]
    if first == 0.0:
        assert layout.spokes["A1"] == layout.spokes["A3"]
        assert layout.spokes["C1"] == layout.spokes["C2"]


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("diameter", 0.0, "> 0"),
        ("mass", -1.0, "> 0"),
        ("hub_mass", 3e-3, "less than mass"),
        ("hub_mass", 0.0, "> 0"),
        ("node_count", 12, "multiple of 8"),
        ("node_count", 0, "multiple of 8"),
        ("node_count", 32.0, "multiple of 8"),
        ("stretch_stiffness", math.nan, "finite"),
        ("stretch_damping", -0.1, ">= 0"),
        ("bend_stiffness", 0.0, "> 0"),
        ("bend_damping", math.inf, "finite"),
        ("out_of_plane_ratio", 0.0, "> 0"),
        ("width", 0.0, "> 0"),
        ("first_angle", math.inf, "finite"),
        ("letters_direction", "left", "clockwise"),
    ],
)
def test_bad_sizes_are_named(name: str, value: Any, word: str) -> None:
    with pytest.raises(InputError, match=f"{name}.*{word}"):
        RingSizes(**{name: value})


def test_bad_layouts_are_named() -> None:
    with pytest.raises(InputError, match=r"first_angle.*45 degrees"):
        lumped_sphere(RingSizes(first_angle=math.radians(11.25)))
    with pytest.raises(InputError, match="rest_curvature"):
        lumped_ring(RingSizes(), rest_curvature=math.nan)


# --------------------------------------------------------------------------- solid


def test_the_section_stretches_bends_and_weighs_as_the_lumped_ring() -> None:
    sizes = RingSizes()
    section = solid_section(sizes, density=1080.0, poisson=0.45)
    t, w, e = section.thickness, section.width, section.youngs_modulus
    assert t == pytest.approx(6.0e-3, rel=ROUND_OFF)
    assert e * t * w == pytest.approx(sizes.stretch_rigidity, rel=ROUND_OFF)
    assert e * w * t**3 / 12 == pytest.approx(sizes.bend_rigidity, rel=ROUND_OFF)
    volume = math.pi * w * ((0.02 + t / 2) ** 2 - (0.02 - t / 2) ** 2)
    assert 1080.0 * volume == pytest.approx(sizes.shell_mass, rel=ROUND_OFF)
    # E = 9 K G / (3 K + G)
    k, g = section.bulk_modulus, section.shear_modulus
    assert 9 * k * g / (3 * k + g) == pytest.approx(e, rel=ROUND_OFF)
    other = solid_section(RingSizes(node_count=64), 1080.0, 0.45)
    assert dataclasses.astuple(other) == dataclasses.astuple(section)
    with pytest.raises(InputError, match="density"):
        solid_section(sizes, 0.0, 0.45)
    with pytest.raises(InputError, match="poisson"):
        solid_section(sizes, 1080.0, 0.5)
    with pytest.raises(InputError, match="no hole"):
        solid_section(RingSizes(bend_stiffness=0.1), 1080.0, 0.45)


@pytest.mark.parametrize("counts", [(8, 2, 2), (32, 4, 2), (64, 2, 4)])
def test_the_solid_ring_is_whole(counts: tuple[int, int, int]) -> None:
    sizes = RingSizes()
    section = solid_section(sizes, 1080.0, 0.45)
    ring = solid_ring(sizes, section, *counts)
    mesh, (around, through, across) = ring.mesh, counts
    assert len(mesh.cells) == around * through * across
    assert len(mesh.nodes) == around * (through + 1) * (across + 1)
    assert len(np.unique(np.round(mesh.nodes * 1e9), axis=0)) == len(mesh.nodes)
    np.testing.assert_array_equal(np.unique(mesh.cells), np.arange(len(mesh.nodes)))

    t, w, n = section.thickness, section.width, around
    outer, inner = 0.02 + t / 2, 0.02 - t / 2
    volumes = cell_volumes(mesh.nodes, mesh.cells)
    polygons = 0.5 * n * math.sin(2 * math.pi / n) * (outer**2 - inner**2)
    assert volumes.min() > 0.0
    assert volumes.sum() == pytest.approx(polygons * w, rel=ROUND_OFF)
    # Each corner of a sector leans by half its angle.
    least = scaled_jacobians(mesh.nodes, mesh.cells)
    np.testing.assert_allclose(least, math.cos(math.pi / n), rtol=ROUND_OFF)

    assert mesh.nodes[:, 2].min() == 0.0
    np.testing.assert_allclose(ring.centre, [0.0, 0.0, outer], rtol=ROUND_OFF)
    radius = np.linalg.norm((mesh.nodes - ring.centre)[:, [0, 2]], axis=1)
    np.testing.assert_allclose([radius.min(), radius.max()], [inner, outer], rtol=ROUND_OFF)


def test_every_face_of_the_solid_ring_has_one_name() -> None:
    sizes = RingSizes()
    section = solid_section(sizes, 1080.0, 0.45)
    ring = solid_ring(sizes, section)
    mesh = ring.mesh
    assert list(mesh.facet_groups) == ["outer", "inner", "side_front", "side_back"]
    named = np.sort(np.concatenate(list(mesh.facet_groups.values())), axis=1)
    everything = np.sort(boundary_facets(mesh.cells), axis=1)
    assert sorted(named.tolist()) == sorted(everything.tolist())
    radius = np.linalg.norm((mesh.nodes - ring.centre)[:, [0, 2]], axis=1)
    t, w = section.thickness, section.width
    for name, quantity, value in (
        ("outer", radius, 0.02 + t / 2),
        ("inner", radius, 0.02 - t / 2),
        ("side_front", mesh.nodes[:, 1], -w / 2),
        ("side_back", mesh.nodes[:, 1], w / 2),
    ):
        quads = mesh.facet_groups[name]
        np.testing.assert_allclose(quantity[quads], value, rtol=ROUND_OFF)
        np.testing.assert_array_equal(orient_outward(mesh.cells, quads), quads)
    np.testing.assert_array_equal(mesh.cell_groups["silicone"], np.arange(len(mesh.cells)))
    assert mesh.material_groups == ("silicone",) and mesh.cavities == ()


@pytest.mark.parametrize("word", ["counter-clockwise", "clockwise"])
@pytest.mark.parametrize("first", [0.0, 45.0, 11.25, -7.3])
def test_anchors_lie_where_the_lumped_spokes_end(first: float, word: str) -> None:
    sizes = RingSizes(first_angle=math.radians(first), letters_direction=word)
    layout = lumped_ring(sizes)
    ring = solid_ring(sizes, solid_section(sizes, 1080.0, 0.45), 32, 2, 4)
    assert list(ring.anchors) == list(layout.spokes)
    for name, (hub, node) in layout.spokes.items():
        across = ring.mesh.nodes[ring.anchors[name]]
        assert len(across) == 5 and len(np.unique(across[:, 1])) == 5
        lumped = layout.nodes[node] - layout.nodes[hub]
        np.testing.assert_allclose(across.mean(axis=0) - ring.centre, lumped, atol=1e-17)
        np.testing.assert_allclose(np.ptp(across[:, [0, 2]], axis=0), 0.0, atol=1e-18)
        assert across.mean(axis=0)[1] == pytest.approx(0.0, abs=1e-18)
    assert ring.mesh.nodes[:, 2].min() == 0.0
    assert scaled_jacobians(ring.mesh.nodes, ring.mesh.cells).min() > 0.99


def test_a_case_can_name_the_ring() -> None:
    builder = BUILDERS["ring"]()
    assert isinstance(builder, RingBuilder)
    mesh = builder.build()
    volume = cell_volumes(mesh.nodes, mesh.cells).sum()
    assert volume == pytest.approx(builder.expected_volume(), rel=ROUND_OFF)
    assert builder.expected_cavity_volumes() == {}
    again = builder.build()
    assert again.nodes.tobytes() == mesh.nodes.tobytes()
    np.testing.assert_array_equal(again.cells, mesh.cells)


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("diameter", -0.04, "> 0"),
        ("thickness", 0.04, "no hole"),
        ("width", 0.0, "> 0"),
        ("around", 20, "multiple of 8"),
        ("through", 3, "even"),
        ("across", 1, "even"),
        ("around", 80_000, "cells"),
    ],
)
def test_bad_solids_are_named(name: str, value: Any, word: str) -> None:
    with pytest.raises(InputError, match=f"{name}.*{word}"):
        RingBuilder(**{name: value})
