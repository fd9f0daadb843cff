"""Mesh files: what is written comes back, and what cannot be used is named."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.geometry.hexapod import CurlBuilder
from flexapod.geometry.meshfile import read_mesh, write_mesh
from flexapod.geometry.pneunet import PneunetBuilder
from flexapod.geometry.quality import cell_volumes, mesh_quality, scaled_jacobians
from flexapod.geometry.tagged import HEX_FACES, TaggedMesh, boundary_facets, orient_outward

CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
)
HEX = np.arange(8)[None, :]


@pytest.fixture(scope="module")
def curl() -> TaggedMesh:
    return CurlBuilder(
        units=2, size="coarse", symmetry="whole", servos=True, servo_centres=(0.0,),
        servo_length=0.01,
    ).build()  # fmt: skip


def quad_set(quads: np.ndarray) -> set[tuple[int, ...]]:
    """Quads up to cyclic shifts, so that orientation counts and the first corner does not."""
    start = np.argmin(quads, axis=1)[:, None]
    return {tuple(q) for q in np.take_along_axis(quads, (start + np.arange(4)) % 4, 1).tolist()}


@pytest.mark.parametrize("suffix", [".msh", ".vtu", ".vtk"])
def test_round_trip(
    curl: TaggedMesh, tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_mesh(curl, tmp_path / f"body{suffix}")
    back = read_mesh(path)
    assert capsys.readouterr().out == ""
    np.testing.assert_array_equal(back.nodes, curl.nodes)
    np.testing.assert_array_equal(back.cells, curl.cells)
    assert set(back.cell_groups) == set(curl.cell_groups)
    for name, cells in curl.cell_groups.items():
        np.testing.assert_array_equal(back.cell_groups[name], cells)
    assert set(back.facet_groups) == set(curl.facet_groups)
    for name, quads in curl.facet_groups.items():
        assert quad_set(back.facet_groups[name]) == quad_set(quads)
        assert len(back.facet_groups[name]) == len(quads)
    assert set(back.cavities) == set(curl.cavities)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_reads_what_gmsh_writes(tmp_path: Path, version: float) -> None:
    import gmsh

    path = tmp_path / "box.msh"
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        base = gmsh.model.geo.addPoint(0, 0, 0)
        line = gmsh.model.geo.extrude([(0, base)], 2, 0, 0, [2], recombine=True)
        face = gmsh.model.geo.extrude([line[1]], 0, 1, 0, [2], recombine=True)
        body = gmsh.model.geo.extrude([face[1]], 0, 0, 1, [3], recombine=True)
        gmsh.model.geo.synchronize()
        gmsh.model.addPhysicalGroup(3, [body[1][1]], name="rubber")
        gmsh.model.addPhysicalGroup(3, [body[1][1]], name="everything")
        gmsh.model.addPhysicalGroup(2, [face[1][1]], name="foot")
        gmsh.model.addPhysicalGroup(2, [body[0][1]], name="cavity_top")
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    mesh = read_mesh(path, scale=1e-3)
    assert len(mesh.cells) == 12
    assert cell_volumes(mesh.nodes, mesh.cells).sum() == pytest.approx(2e-9)
    assert {n: len(c) for n, c in mesh.cell_groups.items()} == {"rubber": 12, "everything": 12}
    assert {n: len(f) for n, f in mesh.facet_groups.items()} == {"foot": 4, "cavity_top": 4}
    assert mesh.cavities == ("cavity_top",)
    for name, up in (("foot", -1.0), ("cavity_top", 1.0)):
        x = mesh.nodes[mesh.facet_groups[name]]
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]) / 2
        np.testing.assert_allclose(normal.sum(axis=0), [0, 0, up * 2e-6], atol=1e-15)


def test_gmsh_opens_what_is_written(curl: TaggedMesh, tmp_path: Path) -> None:
    import gmsh

    path = write_mesh(curl, tmp_path / "body.msh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        types, tags, _ = gmsh.model.mesh.getElements(3)
        names = {gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups(3)}
    finally:
        gmsh.finalize()
    assert list(types) == [5]
    assert len(tags[0]) == len(curl.cells)
    assert "servo_0+limit_layer" in names


def test_reads_cell_sets(tmp_path: Path) -> None:
    nodes = np.vstack([CUBE, CUBE[4:] + [0, 0, 1]])
    cells = np.array([np.arange(8), [4, 5, 6, 7, 8, 9, 10, 11]])
    data = meshio.Mesh(nodes, [("hexahedron", cells)], cell_sets={"upper": [np.array([1])]})
    path = tmp_path / "two.inp"
    meshio.write(path, data)
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.cell_groups["upper"], [1])


def test_facets_are_turned_outward_and_loose_nodes_dropped(tmp_path: Path) -> None:
    path = tmp_path / "one.vtu"
    nodes = np.vstack([[9.0, 9.0, 9.0], CUBE])
    inward = HEX_FACES[[1]][:, ::-1] + 1
    meshio.write(
        path,
        meshio.Mesh(
            nodes,
            [("hexahedron", HEX + 1), ("quad", inward), ("vertex", np.array([[0]]))],
            cell_data={"group_lid": [np.array([0]), np.array([1]), np.array([0])]},
        ),
    )
    mesh = read_mesh(path)
    assert len(mesh.nodes) == 8
    assert quad_set(mesh.facet_groups["lid"]) == quad_set(HEX_FACES[[1]])
    assert mesh.cell_groups == {}


def write_raw(path: Path, nodes: np.ndarray, cells: list[tuple[str, np.ndarray]], **data) -> Path:
    meshio.write(path, meshio.Mesh(nodes, cells, **data))
    return path


def test_unusable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such mesh file"):
        read_mesh(tmp_path / "none.vtu")
    broken = tmp_path / "broken.vtu"
    broken.write_text("nonsense")
    with pytest.raises(InputError, match=r"broken\.vtu.*meshio cannot read"):
        read_mesh(broken)
    odd = tmp_path / "odd.xyzzy"
    odd.write_text("nonsense")
    with pytest.raises(InputError, match="meshio cannot read"):
        read_mesh(odd)
    path = write_raw(
        tmp_path / "mixed.vtu",
        CUBE,
        [("hexahedron", HEX), ("tetra", np.array([[0, 1, 2, 4]])), ("triangle", [[0, 1, 2]])],
    )
    with pytest.raises(InputError, match="found tetra, triangle"):
        read_mesh(path)
    path = write_raw(tmp_path / "flat.vtu", CUBE, [("quad", HEX_FACES[:1])])
    with pytest.raises(InputError, match="no hexahedron"):
        read_mesh(path)
    two = np.vstack([CUBE, CUBE + [3, 0, 0]])
    path = write_raw(
        tmp_path / "folded.vtu",
        two,
        [("hexahedron", np.array([np.arange(8), np.r_[12:16, 8:12]]))],
    )
    with pytest.raises(InputError, match=r"1 hexahedra are folded.*hexahedron 1 "):
        read_mesh(path)
    for stray in ([0, 1, 6, 7], [8, 9, 10, 11]):
        path = write_raw(
            tmp_path / "stray.vtu",
            two,
            [("hexahedron", HEX), ("quad", np.array([stray]))],
            cell_data={"group_skin": [np.array([0]), np.array([1])]},
        )
        with pytest.raises(InputError, match="'skin' belong"):
            read_mesh(path)


def test_a_failed_write_leaves_the_old_file(
    curl: TaggedMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "body.vtu"
    path.write_text("old")

    def fail(target: Path, *_: object, **__: object) -> None:
        Path(target).write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(meshio, "write", fail)
    with pytest.raises(OSError, match="disk full"):
        write_mesh(curl, path)
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InputError, match="is written as"):
        write_mesh(curl, tmp_path / "body.stl")
    with pytest.raises(InputError, match="does not exist"):
        write_mesh(curl, tmp_path / "nowhere" / "body.vtu")


def test_skfem_round_trip() -> None:
    mesh = PneunetBuilder(units=2, size="coarse").build()
    there = mesh.to_skfem()
    assert there.is_valid()
    back = TaggedMesh.from_skfem(there)
    np.testing.assert_array_equal(back.cells, mesh.cells)
    np.testing.assert_array_equal(back.nodes, mesh.nodes)
    for name, quads in mesh.facet_groups.items():
        assert quad_set(back.facet_groups[name]) == quad_set(quads)
    for name, cells in mesh.cell_groups.items():
        np.testing.assert_array_equal(back.cell_groups[name], cells)
    assert back.cavities == mesh.cavities


def test_copies_with_changes() -> None:
    mesh = TaggedMesh(CUBE, HEX)
    tagged = mesh.with_cell_group("rubber", [0]).with_facet_group("cavity_a", HEX_FACES[:, ::-1])
    assert mesh.cell_groups == {} and mesh.facet_groups == {}
    assert tagged.cavities == ("cavity_a",)
    assert quad_set(tagged.facet_groups["cavity_a"]) == quad_set(HEX_FACES)
    np.testing.assert_array_equal(tagged.facet_nodes("cavity_a"), np.arange(8))
    moved = tagged.with_nodes(CUBE * 2.0)
    # The faces of a solid seen as a cavity enclose minus its volume.
    assert moved.cavity_volume("cavity_a") == pytest.approx(-8.0)
    with pytest.raises(InputError, match="no surface is named 'lid'; the mesh has: cavity_a"):
        moved.facet_nodes("lid")
    with pytest.raises(InputError, match="outside"):
        mesh.with_cell_group("x", [1])
    with pytest.raises(InputError, match="crosswise"):
        orient_outward(HEX, HEX_FACES[:1][:, [0, 2, 1, 3]])
    assert quad_set(boundary_facets(HEX)) == quad_set(HEX_FACES)


def test_quality_of_known_shapes() -> None:
    sheared = CUBE + np.outer(CUBE[:, 2], [1.0, 0.0, 0.0])
    # Triple product 1 over edges 1, 1, sqrt(2).
    np.testing.assert_allclose(scaled_jacobians(sheared, HEX), 1 / np.sqrt(2))
    np.testing.assert_allclose(cell_volumes(sheared, HEX), 1.0)
    frustum = CUBE.copy()
    frustum[4:, :2] = 0.25 + 0.5 * frustum[4:, :2]
    # Prismoid: (A0 + 4 Am + A1) / 6 with areas 1, 9/16, 1/4.
    np.testing.assert_allclose(cell_volumes(frustum, HEX), (1 + 4 * 9 / 16 + 1 / 4) / 6)
    pulled = CUBE.copy()
    pulled[6] = [0.2, 0.2, 0.2]
    assert scaled_jacobians(pulled, HEX)[0] < 0.0
    quality = mesh_quality(TaggedMesh(CUBE * [1, 2, 4], HEX), expected_volume=8.0, density=2.0)
    assert (quality.volume, quality.mass, quality.expected_mass) == pytest.approx((8, 16, 16))
    assert (quality.shortest_edge, quality.longest_edge, quality.largest_aspect) == (1, 4, 4)
