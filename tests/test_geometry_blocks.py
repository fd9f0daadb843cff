"""The built bodies: tags, shapes, volumes, cavities, walls, counts."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from flexapod.app.assemble import make_builder
from flexapod.app.spec import MeshSpec
from flexapod.core.errors import InputError
from flexapod.geometry.blocks import Sizing, build_row, subdivide
from flexapod.geometry.builders import BUILDERS
from flexapod.geometry.hexapod import CurlBuilder, TurnBuilder, servo_intervals
from flexapod.geometry.pneunet import (
    ASSISTANT_CURL,
    MAIN_CURL,
    TURNING,
    PneumaticNetwork,
    PneunetBuilder,
    change_network,
)
from flexapod.geometry.quality import cell_volumes, mesh_quality, scaled_jacobians
from flexapod.geometry.tagged import TaggedMesh, boundary_facets, orient_outward

ROUND_OFF = 1e-12  # measured 1e-15 relative for volumes of 1e-4 m3

IN_ROWS = {"servos": True, "servo_length": 0.030, "servo_place": "turning_rows"}
BUILDS = {
    "pneunet whole": PneunetBuilder(units=3),
    "pneunet half, odd": PneunetBuilder(units=3, symmetry="half"),
    "pneunet quarter": PneunetBuilder(units=4, symmetry="quarter"),
    "curl whole": CurlBuilder(units=4, size="coarse", symmetry="whole", servos=True,
                              servo_length=0.01),
    "curl half": CurlBuilder(units=4, size="coarse", symmetry="half"),
    "curl quarter": CurlBuilder(units=4),
    "curl quarter, one unit": CurlBuilder(units=1),
    "curl quarter, no paths": CurlBuilder(units=4, air_paths=False),
    "curl half, row feed": CurlBuilder(units=3, size="coarse", symmetry="half",
                                       assistant_feed="row"),
    "curl quarter, row feed, no paths": CurlBuilder(units=2, air_paths=False,
                                                    assistant_feed="row"),
    "turn whole": TurnBuilder(units=3, symmetry="whole"),
    "turn half": TurnBuilder(units=4),
    "turn low spine": TurnBuilder(units=4, spine_height=0.015),
    "curl whole, rows aligned": CurlBuilder(units=4, symmetry="whole", size=20e-3,
                                            air_paths=False, aligned_rows=True),
    "curl quarter, rows aligned": CurlBuilder(units=4, aligned_rows=True),
    "curl whole, servos in rows": CurlBuilder(units=9, size="coarse", symmetry="whole", **IN_ROWS,
                                              servo_centres=(-0.04, 0.03)),
    "curl half, servos in rows": CurlBuilder(units=9, size="coarse", symmetry="half", **IN_ROWS),
    "curl quarter, servos in rows": CurlBuilder(units=10, **IN_ROWS),
    "curl quarter, servos in rows, no paths": CurlBuilder(units=10, air_paths=False, **IN_ROWS),
    "turn whole, servos in rows": TurnBuilder(units=8, size="coarse", symmetry="whole", **IN_ROWS),
    "turn half, servos in rows": TurnBuilder(units=9, spine_height=0.015, **IN_ROWS),
    # In mid gap, and in no chamber's way.
    "curl whole, servo in a gap": CurlBuilder(units=4, size="coarse", symmetry="whole",
                                              **{**IN_ROWS, "servo_length": 0.003},
                                              servo_centres=(0.0,)),
}  # fmt: skip


@pytest.fixture(scope="module", params=list(BUILDS), ids=lambda n: n.replace(" ", "_"))
def built(request: pytest.FixtureRequest) -> tuple[PneunetBuilder | CurlBuilder, TaggedMesh]:
    builder = BUILDS[request.param]
    return builder, builder.build()


def area_vector(mesh: TaggedMesh, name: str) -> np.ndarray:
    x = mesh.nodes[mesh.facet_groups[name]]
    return np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]).sum(axis=0) / 2.0


def area(mesh: TaggedMesh, name: str) -> float:
    x = mesh.nodes[mesh.facet_groups[name]]
    return float(np.linalg.norm(np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]), axis=1).sum() / 2)


def test_volume_is_the_formula(built) -> None:
    builder, mesh = built
    volumes = cell_volumes(mesh.nodes, mesh.cells)
    assert volumes.min() > 0.0
    np.testing.assert_allclose(volumes.sum(), builder.expected_volume(), rtol=ROUND_OFF)
    np.testing.assert_allclose(scaled_jacobians(mesh.nodes, mesh.cells), 1.0, rtol=1e-9)


def test_cavity_volumes_are_the_formula(built) -> None:
    builder, mesh = built
    expected = builder.expected_cavity_volumes()
    assert set(mesh.cavities) == set(expected)
    for name, volume in expected.items():
        np.testing.assert_allclose(mesh.cavity_volume(name), volume, rtol=ROUND_OFF)


def test_cavities_are_closed_but_for_symmetry_planes(built) -> None:
    builder, mesh = built
    open_axes = {"whole": 0, "half": 1, "quarter": 2}[builder.symmetry]
    for name in mesh.cavities:
        vector = area_vector(mesh, name) / area(mesh, name)
        np.testing.assert_allclose(vector[open_axes:], 0.0, atol=1e-13)


def test_groups_partition_surface_and_cells(built) -> None:
    _, mesh = built
    everything = boundary_facets(mesh.cells)
    parts = ["outer", *mesh.cavities, *(n for n in mesh.facet_groups if n.startswith("symmetry"))]
    named = np.concatenate([mesh.facet_groups[n] for n in parts])

    def as_set(quads: np.ndarray) -> set[tuple[int, ...]]:
        return {tuple(q) for q in np.sort(quads, axis=1).tolist()}

    assert len(named) == len(everything)
    assert as_set(named) == as_set(everything)
    for name, quads in mesh.facet_groups.items():
        assert as_set(quads) <= as_set(everything)
        np.testing.assert_array_equal(orient_outward(mesh.cells, quads, name), quads)
    material = np.concatenate([mesh.cell_groups[n] for n in mesh.material_groups])
    np.testing.assert_array_equal(np.sort(material), np.arange(len(mesh.cells)))


def test_nodes_are_unique_and_used(built) -> None:
    _, mesh = built
    assert len(np.unique(np.round(mesh.nodes * 1e9), axis=0)) == len(mesh.nodes)
    np.testing.assert_array_equal(np.unique(mesh.cells), np.arange(len(mesh.nodes)))


def test_surfaces_lie_where_their_names_say(built) -> None:
    builder, mesh = built
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    assert high[0] == pytest.approx(builder_length(builder) / 2, abs=1e-12)
    planes = {"symmetry_x": (0, 0.0), "symmetry_y": (1, 0.0), "end": (0, high[0]),
              "end_left": (0, low[0]), "underside": (2, 0.0), "side_right": (1, high[1]),
              "side_left": (1, low[1])}  # fmt: skip
    for name, (axis, value) in planes.items():
        if name in mesh.facet_groups:
            x = mesh.nodes[mesh.facet_groups[name]]
            np.testing.assert_allclose(x[..., axis], value, atol=1e-12)
            assert abs(area_vector(mesh, name)[axis]) == pytest.approx(area(mesh, name))
    cut = {"whole": set(), "half": {"symmetry_x"}, "quarter": {"symmetry_x", "symmetry_y"}}
    assert {n for n in mesh.facet_groups if n.startswith("symmetry")} == cut[builder.symmetry]
    rows = {"pneunet": ["main"], "curl": ["main", "assistant", "turn"], "turn": ["turn"]}
    kind = next(name for name in BUILDERS if isinstance(builder, BUILDERS[name]))
    assert {"end", "end_spine", "underside", "top", "outer", "chamber_faces", "side_right"} | {
        f"chamber_faces_{row}" for row in rows[kind]
    } <= set(mesh.facet_groups)
    assert ("end_left" in mesh.facet_groups) == (builder.symmetry == "whole")
    assert area_vector(mesh, "top")[2] == pytest.approx(area(mesh, "top"))


def builder_length(builder: object) -> float:
    if isinstance(builder, PneunetBuilder):
        return builder.units * builder.dimensions.pitch
    return builder.length


def test_chamber_faces_have_the_area_of_the_gaps() -> None:
    # Main row, whole, n units: 2 n faces of b x (c + h - e) and n gap floors of d x b.
    builder = PneunetBuilder(units=3)
    n = builder.dimensions
    free = n.top_wall + n.chamber_height - n.connection_thickness
    expected = 3 * (2 * n.network_width * free + n.gap * n.network_width)
    assert area(builder.build(), "chamber_faces_main") == pytest.approx(expected, rel=1e-12)


def test_sides_are_named_by_the_sign_of_y() -> None:
    mesh = CurlBuilder(units=2, size="coarse", symmetry="whole", assistant_feed="row").build()
    for row in ("assistant", "turn"):
        for side, sign in (("left", -1.0), ("right", 1.0)):
            assert np.all(sign * mesh.nodes[mesh.facet_groups[f"cavity_{row}_{side}"]][..., 1] > 0)


@pytest.mark.parametrize("units", [2, 3])
def test_faces_at_the_mirror_gap(units: int) -> None:
    # An even row is cut in mid gap, an odd one in mid chamber.
    builder = PneunetBuilder(units=units, symmetry="half")
    mesh, n = builder.build(), builder.dimensions
    if units % 2:
        assert "chamber_faces_symmetry_x" not in mesh.facet_groups
        return
    assert mesh.nodes[mesh.facet_groups["chamber_faces_symmetry_x"]][..., 0].max() == (
        pytest.approx(n.gap / 2)
    )
    face = n.network_width * (n.top_wall + n.chamber_height - n.connection_thickness)
    floor = n.network_width * n.gap / 2
    assert area(mesh, "chamber_faces_symmetry_x") == pytest.approx(face + floor)


def test_missing_gmsh_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(InputError, match="libglu1-mesa libxft2 libxcursor1 libxinerama1"):
        PneunetBuilder(units=1).build()


def test_changed_dimensions() -> None:
    wider = change_network(MAIN_CURL, {"gap": 0.004, "network_width": 0.040})
    builder = PneunetBuilder(units=2, dimensions=wider)
    volumes = mesh_quality(builder.build(), builder.expected_volume())
    assert abs(volumes.volume_error) < ROUND_OFF
    with pytest.raises(InputError, match="unknown dimension 'wall'"):
        change_network(MAIN_CURL, {"wall": 0.001})


def test_cavity_faces_point_into_the_air() -> None:
    mesh = PneunetBuilder(units=1).build()
    x = mesh.nodes[mesh.facet_groups["cavity_main"]]
    normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    towards = np.array([0.0, 0.0, 4e-3 + 12.5e-3]) - x.mean(axis=1)
    assert np.all(np.einsum("ij,ij->i", normal, towards) > 0.0)


def part_count(mesh: TaggedMesh, cavity: str) -> int:
    """Number of separate chambers that a cavity's facets bound."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    quads = mesh.facet_groups[cavity]
    nodes, local = np.unique(quads, return_inverse=True)
    local = local.reshape(-1, 4)
    rows, columns = local.ravel(), np.roll(local, 1, axis=1).ravel()
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(nodes),) * 2)
    return int(connected_components(links, directed=False)[0])


def test_chambers_of_a_cavity_are_connected() -> None:
    expected = {
        "ventilation": {"curl": 1, "turn_left": 1, "turn_right": 1},
        "row": {"main": 1, "assistant_left": 1, "assistant_right": 1, "turn_left": 1,
                "turn_right": 1},
    }  # fmt: skip
    for feed, counts in expected.items():
        for air_paths in (True, False):
            builder = CurlBuilder(
                units=3, size="coarse", symmetry="whole", assistant_feed=feed, air_paths=air_paths
            )
            mesh = builder.build()
            assert set(mesh.cavities) == {f"cavity_{name}" for name in counts}
            for name, count in counts.items():
                alone = 9 if name == "curl" else 3
                assert part_count(mesh, f"cavity_{name}") == (count if air_paths else alone)


def test_ventilation_holes_are_where_the_docs_say() -> None:
    # In mm: |x - xc| < 1.5, 15 < y < 19, 22 < z < 25, bounded by four faces of 3 x 4.
    mesh = CurlBuilder(units=1).build()
    x = mesh.nodes[mesh.facet_groups["cavity_curl"]] * 1e3
    middle = x.mean(axis=1)
    inside = (middle[:, 1] > 15.1) & (middle[:, 1] < 18.9)
    hole = x[inside].reshape(-1, 3)
    np.testing.assert_allclose(hole.min(axis=0), [0.0, 15.0, 22.0], atol=1e-9)
    np.testing.assert_allclose(hole.max(axis=0), [1.5, 19.0, 25.0], atol=1e-9)
    sides = np.cross(x[inside, 2] - x[inside, 0], x[inside, 3] - x[inside, 1])
    # The quarter has half the floor, half the ceiling and one of the two sides.
    assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(3 * 4 + 3 * 4)


@pytest.mark.parametrize("symmetry", ["whole", "half", "quarter"])
def test_end_of_the_spine_and_servo_faces(symmetry: str) -> None:
    width = 0.018 if symmetry == "quarter" else 0.036
    plain = CurlBuilder(units=2, size="coarse", symmetry=symmetry).build()
    assert "servo_faces" not in plain.facet_groups
    x = plain.nodes[plain.facet_groups["end_spine"]]
    assert area(plain, "end_spine") == pytest.approx(width * 0.015)
    assert (x[..., 2].min(), x[..., 2].max()) == pytest.approx((0.029, 0.044))
    mesh = CurlBuilder(
        units=2, size="coarse", symmetry=symmetry, servos=True, servo_centres=(0.0, 0.0135),
        servo_length=0.007,
    ).build()  # fmt: skip
    assert area(mesh, "end_spine") == pytest.approx(width * 0.015)
    servo = np.concatenate([c for n, c in mesh.cell_groups.items() if n.startswith("servo")])
    quads = mesh.facet_groups["servo_faces"]
    orient_outward(mesh.cells[servo], quads, "servo_faces")
    # Tops (lengths as snapped to the lattice) and the end face.
    length = cell_volumes(mesh.nodes, mesh.cells[servo]).sum() / (width * 0.015)
    assert area(mesh, "servo_faces") == pytest.approx(width * (length + 0.015))


def test_end_of_the_turning_spine() -> None:
    assert area(TurnBuilder(units=2).build(), "end_spine") == pytest.approx(0.036 * 0.023)
    low = TurnBuilder(units=2, spine_height=0.015, servos=True, servo_length=0.01).build()
    assert area(low, "end_spine") == pytest.approx(0.036 * 0.015)
    assert "servo_faces" in low.facet_groups


def wall_runs(builder: object, sizing: Sizing) -> list[tuple[int, float, int]]:
    """(axis, thickness [m], elements) of each solid run between two voids or outsides.

    Symmetry planes count as mirrors. The brute-force twin of the walls a builder names.
    """
    row = build_row(builder.row(), builder.symmetry, sizing)
    mesh, lines = row.mesh, row.lines
    solid = np.zeros([len(line) - 1 for line in lines], dtype=bool)
    low = mesh.nodes[mesh.cells].min(axis=1)
    index = [np.abs(lines[a][None, :] - low[:, a : a + 1]).argmin(axis=1) for a in range(3)]
    solid[tuple(index)] = True
    runs = set()
    for axis in range(3):
        line, cells = lines[axis], np.moveaxis(solid, axis, -1)
        if axis == 0 or (axis == 1 and builder.symmetry == "quarter"):
            line = np.concatenate([-line[:0:-1], line])
            cells = np.concatenate([cells[..., ::-1], cells], axis=-1)
        padded = np.pad(cells.reshape(-1, cells.shape[-1]), ((0, 0), (1, 1)))
        steps = np.diff(padded.astype(int), axis=1)
        for pencil in steps[np.any(steps != 0, axis=1)]:
            starts, stops = np.flatnonzero(pencil == 1), np.flatnonzero(pencil == -1)
            for start, stop in zip(starts, stops, strict=True):
                runs.add((axis, round(float(line[stop] - line[start]), 6), int(stop - start)))
    return sorted(runs)


@pytest.mark.parametrize(
    "builder",
    [
        PneunetBuilder(units=2, symmetry="quarter"),
        CurlBuilder(units=4),
        CurlBuilder(units=4, assistant_feed="row"),
        TurnBuilder(),
    ],
)
def test_two_elements_through_every_wall_by_default(builder: object) -> None:
    from flexapod.geometry.hexapod import _CURL_SIZES, _TURN_SIZES
    from flexapod.geometry.pneunet import _SIZES

    table = {PneunetBuilder: _SIZES, CurlBuilder: _CURL_SIZES, TurnBuilder: _TURN_SIZES}
    runs = wall_runs(builder, table[type(builder)]["default"])
    thin = [run for run in runs if run[2] < 2]
    # The one exception: a 1 mm skin between the assistant row's air path and the main row's gap.
    has_skin = isinstance(builder, CurlBuilder) and builder.assistant_feed == "row"
    allowed = [(1, 0.001, 1)] if has_skin else []
    assert [run for run in thin if run not in allowed] == []
    three = [run for run in wall_runs(builder, table[type(builder)]["fine"]) if run[2] < 3]
    assert [run for run in three if run not in allowed] == []


def test_counts_of_the_robot_models() -> None:
    count = {
        (name, size): len(BUILDERS[name](size=size).build().cells)
        for name in ("curl", "turn")
        for size in ("default", "fine")
    }
    assert 11_000 <= count["curl", "default"] <= 15_000
    assert count["curl", "fine"] == pytest.approx(37_078, rel=0.15)
    assert count["turn", "fine"] == pytest.approx(31_887, rel=0.15)


def test_whole_robot_silicone_weighs_what_the_notes_say() -> None:
    builder = CurlBuilder(size="coarse", symmetry="whole")
    mesh = builder.build()
    quality = mesh_quality(mesh, builder.expected_volume(), density=1080.0)
    assert quality.mass == pytest.approx(0.92, abs=0.02)
    assert abs(quality.volume_error) < ROUND_OFF
    np.testing.assert_allclose(np.ptp(mesh.nodes, axis=0), [0.306, 0.104, 0.048], rtol=1e-12)
    for word in ("hexahedra", "scaled Jacobian", "by formula", "kg/m3", "cavity_turn_left"):
        assert word in quality.text()


def test_symmetric_parts_are_parts_of_the_whole() -> None:
    meshes = {s: CurlBuilder(units=4, symmetry=s).build() for s in ("whole", "half", "quarter")}
    volume = {s: cell_volumes(m.nodes, m.cells).sum() for s, m in meshes.items()}
    np.testing.assert_allclose(volume["whole"], 2 * volume["half"], rtol=ROUND_OFF)
    np.testing.assert_allclose(volume["whole"], 4 * volume["quarter"], rtol=ROUND_OFF)
    assert len(meshes["whole"].cells) == 4 * len(meshes["quarter"].cells)
    assert len(meshes["whole"].facet_groups["cavity_curl"]) == 4 * len(
        meshes["quarter"].facet_groups["cavity_curl"]
    )


def test_numbering_is_reproducible() -> None:
    first, second = CurlBuilder(units=2).build(), CurlBuilder(units=2).build()
    np.testing.assert_array_equal(first.nodes, second.nodes)
    np.testing.assert_array_equal(first.cells, second.cells)
    # A Gmsh session the caller holds open is left as it was.
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("mine")
        third = CurlBuilder(units=2).build()
        assert gmsh.model.getCurrent() == "mine"
    finally:
        gmsh.finalize()
    np.testing.assert_array_equal(first.cells, third.cells)


def test_servo_stations() -> None:
    plain = CurlBuilder(size="coarse").build()
    assert plain.material_groups == ("silicone",)
    whole = CurlBuilder(size="coarse", symmetry="whole", servos=True).build()
    assert whole.material_groups == ("silicone", "servo_0", "servo_1", "servo_2")
    volumes = cell_volumes(whole.nodes, whole.cells)
    for number, centre in enumerate((-0.1305, 0.0, 0.1305)):
        cells = whole.cell_groups[f"servo_{number}"]
        assert np.isin(cells, whole.cell_groups["limit_layer"]).all()
        x = whole.nodes[whole.cells[cells]]
        assert abs(x[..., 0].min() - (centre - 0.0225)) < 1.25e-3
        assert abs(x[..., 0].max() - (centre + 0.0225)) < 1.25e-3
        assert volumes[cells].sum() == pytest.approx(0.045 * 0.036 * 0.015, rel=0.06)
        assert (x[..., 2].min(), x[..., 2].max()) == pytest.approx((0.029, 0.044))
    half = CurlBuilder(size="coarse", servos=True).build()
    assert half.material_groups == ("silicone", "servo_1", "servo_2")
    turn = TurnBuilder(size="coarse", servos=True).build()
    assert turn.material_groups == ("silicone", "servo_1", "servo_2")


ROBOT_SERVOS = {"servos": True, "servo_length": 0.045, "servo_place": "turning_rows"}


@pytest.mark.parametrize("builder_class", [CurlBuilder, TurnBuilder])
def test_servos_in_the_turning_rows(builder_class: type[CurlBuilder] | type[TurnBuilder]) -> None:
    # In mm: stations end at 23 (22.5 snapped) and 108; the blocks of units are 11 long and 17
    # apart from 8.5 on. 20..31 and 105..116 are cut, so that 4 of 9 units are left on each side.
    mesh = builder_class(size="coarse", symmetry="whole", **ROBOT_SERVOS).build()
    base, high, spine_z = (0.0, 0.023, (0.0, 0.023))
    if builder_class is CurlBuilder:
        base, high, spine_z = (0.025, 0.048, (0.029, 0.044))
    assert mesh.material_groups == ("silicone", "servo_0", "servo_1", "servo_2")
    volumes = cell_volumes(mesh.nodes, mesh.cells)
    middle = mesh.nodes[mesh.cells].mean(axis=1)
    stations = ((-0.153, -0.108), (-0.023, 0.023), (0.108, 0.153))
    section = 2 * 0.034 * 0.023 + 0.036 * (spine_z[1] - spine_z[0])
    for number, (start, stop) in enumerate(stations):
        cells = mesh.cell_groups[f"servo_{number}"]
        x = mesh.nodes[mesh.cells[cells]].reshape(-1, 3)
        np.testing.assert_allclose(x.min(axis=0), [start, -0.052, base], atol=1e-12)
        np.testing.assert_allclose(x.max(axis=0), [stop, 0.052, high], atol=1e-12)
        assert volumes[cells].sum() == pytest.approx((stop - start) * section, rel=1e-12)
        spine = cells[np.abs(middle[cells, 1]) < 0.018]
        assert np.isin(spine, mesh.cell_groups["limit_layer"]).all()
        assert np.isin(np.setdiff1d(cells, spine), mesh.cell_groups["housing"]).all()
    for side in ("left", "right"):
        air = mesh.nodes[mesh.facet_groups[f"cavity_turn_{side}"]].mean(axis=1)
        # Two runs of four chambers joined by paths: nothing between runs, nothing at a servo.
        for sign in (-1.0, 1.0):
            run = sign * air[sign * air[:, 0] > 0.0][:, 0]
            assert (run.min(), run.max()) == pytest.approx((0.040, 0.096))
        assert part_count(mesh, f"cavity_turn_{side}") == 2
    # Outside the stations the connection runs on, and over the assistants the floor.
    turn = middle[mesh.cell_groups["turn"]]
    beside = turn[(np.abs(turn[:, 0]) > 0.023) & (np.abs(turn[:, 0]) < 0.037)]
    beyond = beside[np.abs(beside[:, 1]) > 0.023]
    if builder_class is CurlBuilder:
        assert np.abs(beyond[:, 0]).max() < 0.031
        assert beyond[:, 2].max() < 0.029
    else:
        assert len(beyond) == 0
    assert np.abs(beside[:, 1]).min() > 0.018
    # The blocks' sides can meet the chambers that are left.
    faces = mesh.nodes[mesh.facet_groups["chamber_faces_turn"]]
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1]) / 2.0
    for x, sign in ((-0.108, 1.0), (-0.023, -1.0), (0.023, 1.0), (0.108, -1.0)):
        here = np.all(np.abs(faces[..., 0] - x) < 1e-9, axis=1)
        floor = 0.004 if builder_class is CurlBuilder else 0.0
        free = 2 * 0.029 * (0.023 - floor)  # beside connection and floor
        assert normal[here].sum(axis=0)[0] * sign == pytest.approx(free)
    servo = np.concatenate([mesh.cell_groups[f"servo_{n}"] for n in range(3)])
    orient_outward(mesh.cells[servo], mesh.facet_groups["servo_faces"], "servo_faces")
    assert area(mesh, "end_spine") == pytest.approx(0.036 * (spine_z[1] - spine_z[0]))


def test_servos_in_the_turning_rows_are_the_same_in_every_part() -> None:
    curl = {
        s: CurlBuilder(size="coarse", symmetry=s, **ROBOT_SERVOS).build()
        for s in ("whole", "half", "quarter")
    }
    turn = {
        s: TurnBuilder(size="coarse", symmetry=s, **ROBOT_SERVOS).build() for s in ("whole", "half")
    }
    for parts, pieces in ((curl, {"half": 2, "quarter": 4}), (turn, {"half": 2})):
        whole = parts["whole"]
        for name, count in pieces.items():
            part = parts[name]
            assert part.material_groups == ("silicone", "servo_1", "servo_2")
            assert len(whole.cells) == count * len(part.cells)
            for group in ("chamber_faces", "servo_faces", "outer", "underside"):
                assert area(whole, group) == pytest.approx(count * area(part, group), rel=1e-12)
            for group in ("servo_1", "turn", "housing", "limit_layer"):
                assert len(whole.cell_groups[group]) == count * len(part.cell_groups[group])
            np.testing.assert_allclose(
                whole.cavity_volume("cavity_turn_right"),
                2 * part.cavity_volume("cavity_turn_right"),
                rtol=ROUND_OFF,
            )


def test_mirror_gap_behind_a_servo() -> None:
    # The station fills the turning rows' gap, up to 3 mm, and opens one beside it, 3 to 20 mm. So
    # from 0 to 20 mm some row has a gap; the mirror gaps are those of main and assistant rows.
    builder = CurlBuilder(units=4, size="coarse", symmetry="half", servo_centres=(0.0,),
                          **{**IN_ROWS, "servo_length": 0.006})  # fmt: skip
    mesh = builder.build()
    faces = mesh.nodes[mesh.facet_groups["chamber_faces_symmetry_x"]]
    assert faces[..., 0].max() == pytest.approx(ASSISTANT_CURL.gap / 2)
    assert faces[..., 2].max() == pytest.approx(0.024)


def test_rows_full_of_servos_have_no_air() -> None:
    builder = TurnBuilder(units=2, symmetry="whole", **{**IN_ROWS, "servo_length": 0.0339},
                          servo_centres=(0.0,))  # fmt: skip
    mesh = builder.build()
    assert mesh.cavities == ()
    assert builder.expected_cavity_volumes() == {}
    assert cell_volumes(mesh.nodes, mesh.cells).sum() == pytest.approx(
        0.034 * 0.104 * 0.023, rel=1e-12
    )


def test_servo_place_without_servos_changes_nothing() -> None:
    for builder in (CurlBuilder(units=4), TurnBuilder(units=3, symmetry="whole")):
        meshes = [
            dataclasses.replace(builder, servo_place=place).build()
            for place in ("limit_layer", "turning_rows")
        ]
        np.testing.assert_array_equal(meshes[0].nodes, meshes[1].nodes)
        np.testing.assert_array_equal(meshes[0].cells, meshes[1].cells)
        assert list(meshes[0].facet_groups) == list(meshes[1].facet_groups)
        for name, quads in meshes[0].facet_groups.items():
            np.testing.assert_array_equal(quads, meshes[1].facet_groups[name])
        assert list(meshes[0].cell_groups) == list(meshes[1].cell_groups)


def test_servo_place_in_a_case() -> None:
    table = {"builder": "turn", "servos": True, "servo_place": "turning_rows"}
    assert make_builder(MeshSpec(**table), "my.toml").servo_place == "turning_rows"
    with pytest.raises(
        InputError, match=r"mesh\.servo_place: .*one of limit_layer, turning_rows; got .attic."
    ):
        make_builder(MeshSpec(**{**table, "servo_place": "attic"}), "my.toml")


def test_impossible_servos_in_the_turning_rows() -> None:
    with pytest.raises(InputError, match="symmetric about x = 0"):
        TurnBuilder(units=8, servo_centres=(0.0, 0.05), **IN_ROWS).build()
    with pytest.raises(InputError, match="shorter than an element"):
        TurnBuilder(
            units=8, size="coarse", servo_centres=(0.0085,), symmetry="whole",
            **{**IN_ROWS, "servo_length": 0.001},
        ).build()  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"outer_length": 0.015}, "l = a + 2 f: 15 mm != 14 mm"),
        ({"inner_wall": 0.004}, "l = a + 2 f: 14 mm != 16 mm"),
        ({"outer_wall": 0.018}, "b > 2 g: 36 mm <= 36 mm"),
        ({"connection_thickness": 0.029}, "e < c + h: 29 mm >= 29 mm"),
        ({"air_path": 0.005}, "k < e: 5 mm >= 5 mm"),
        ({"network_width": 0.009}, "k < b - 2 g: 3 mm >= 3 mm"),
        ({"gap": -0.001}, "d > 0: gap is -1 mm"),
        ({"top_wall": float("nan")}, "c > 0: top_wall is nan mm"),
        ({"gap": 3.0}, "d < 100 l: 3000 mm: is the gap in metres?"),
    ],
)
def test_impossible_dimensions_name_the_relation(change: dict[str, float], words: str) -> None:
    with pytest.raises(InputError) as caught:
        dataclasses.replace(MAIN_CURL, **change)
    assert words in str(caught.value)


def test_impossible_bodies() -> None:
    longer = dataclasses.replace(MAIN_CURL, gap=0.004)
    with pytest.raises(InputError, match=r"l \+ d of main = .*18 mm != 17 mm"):
        CurlBuilder(main=longer)
    with pytest.raises(InputError, match=r"b of main = t of turning: 36 mm != 30 mm"):
        CurlBuilder(turning=dataclasses.replace(TURNING, limit_layer=0.030))
    with pytest.raises(InputError, match="assistant_feed must be one of ventilation, row"):
        CurlBuilder(assistant_feed="hose")
    deep = dataclasses.replace(ASSISTANT_CURL, air_path=0.0045)
    CurlBuilder(assistant=deep)
    with pytest.raises(InputError, match="k of assistant < e of turning"):
        CurlBuilder(assistant=deep, assistant_feed="row")
    short = {"chamber_length": 0.0025, "outer_length": 0.0085, "gap": 0.0085}
    with pytest.raises(InputError, match=r"a of assistant: 3 mm >= 2\.5 mm"):
        CurlBuilder(assistant=dataclasses.replace(ASSISTANT_CURL, **short))
    with pytest.raises(InputError, match="t > 0"):
        PneunetBuilder(dimensions=ASSISTANT_CURL)
    with pytest.raises(InputError, match="symmetry must be"):
        TurnBuilder(symmetry="quarter")
    with pytest.raises(InputError, match="symmetry must be one of"):
        CurlBuilder(symmetry="third").build()
    with pytest.raises(InputError, match="size must be coarse, default, fine or a length"):
        CurlBuilder(size="medium").build()
    with pytest.raises(InputError, match=r"0\.2 mm and 100 mm"):
        CurlBuilder(size=3.0).build()
    with pytest.raises(InputError, match="units must be"):
        CurlBuilder(units=0)
    with pytest.raises(InputError, match="spine_height"):
        TurnBuilder(spine_height=0.010)
    with pytest.raises(InputError, match="overlap"):
        servo_intervals(0.306, (0.0, 0.02), 0.045)
    with pytest.raises(InputError, match="outside the body"):
        servo_intervals(0.306, (0.2,), 0.045)


def test_table_columns() -> None:
    assert isinstance(TURNING, PneumaticNetwork)
    for column in (MAIN_CURL, ASSISTANT_CURL, TURNING):
        assert column.pitch == pytest.approx(0.017)
    assert MAIN_CURL.chamber_volume == pytest.approx(8e-3 * 30e-3 * 25e-3)


def test_size_as_a_length_bounds_every_edge() -> None:
    quality = mesh_quality(CurlBuilder(units=2, size=3e-3).build())
    assert quality.longest_edge <= 3e-3 + 1e-12


def test_subdivide_splits_the_longest_part_of_a_wall() -> None:
    planes = np.array([0.0, 3.0, 4.0, 20.0])
    counts = subdivide(planes, ((0.0, 4.0),), Sizing(max_length=8.0, wall_elements=3))
    np.testing.assert_array_equal(counts, [2, 1, 2])
