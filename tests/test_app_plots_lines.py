"""Shells and coils of lines in a results folder, and their pictures: rings that roll."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from flexapod.app import plots, plots_line_frames, plots_lines, plots_sweep, plots_tubes
from flexapod.app.outputs import OutputLines, OutputState, ResultsFolder
from flexapod.app.plots_voltage import plot_voltage
from flexapod.core.errors import InputError

RADIUS, NODES, GAP = 0.02, 16, 0.05  # of the ring [m], its nodes, time between frames [s]


@pytest.fixture(autouse=True)
def _matplotlib(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")
    yield
    plots.renderer.cache_clear()


def _ring() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, hub last, lines, and the coil of each: shell, spokes A to H, chord I."""
    angle = 2.0 * math.pi * np.arange(NODES) / NODES - 0.5 * math.pi
    shell = RADIUS * np.column_stack([np.cos(angle), 0.0 * angle, 1.0 + np.sin(angle)])
    nodes = np.vstack([shell, [0.0, 0.0, RADIUS]])
    lines = [(k, (k + 1) % NODES) for k in range(NODES)]
    lines += [(NODES, k * NODES // 8) for k in range(8)] + [(NODES // 8, 7 * NODES // 8)]
    return nodes, np.array(lines), np.array([-1] * NODES + list(range(9)), dtype=np.int32)


def _sphere() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three rings at right angles that share the nodes where they cross, and their spokes."""
    angle = 2.0 * math.pi * np.arange(NODES) / NODES
    c, s, o = np.cos(angle), np.sin(angle), 0.0 * angle
    rings = [np.column_stack(r) for r in ((c, o, s), (c, s, o), (o, c, s))]
    nodes, number = np.unique(np.round(np.concatenate(rings), 9), axis=0, return_inverse=True)
    number = number.reshape(3, NODES)
    lines = [(r[k], r[(k + 1) % NODES]) for r in number for k in range(NODES)]
    spokes = [(len(nodes), r[k * NODES // 8]) for r in number for k in range(8)]
    coil = np.array([-1] * len(lines) + [9 * (k // 8) + k % 8 for k in range(24)])
    nodes = RADIUS * (np.vstack([nodes, np.zeros(3)]) + [0.0, 0.0, 1.0])
    return nodes, np.array([*lines, *spokes]), coil


def _turned(nodes: np.ndarray, angle: float, shift: np.ndarray) -> np.ndarray:
    """Nodes after rolling by an angle towards +x, flattened a little, and a shift."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = (nodes - [0.0, 0.0, RADIUS]).T
    x, z = c * x + s * z, c * z - s * x
    return np.column_stack([1.1 * x, y, 0.9 * z + 0.9 * RADIUS]) + shift


def _folder(
    path: Path,
    shape: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    way: tuple[float, float] = (0.3, 0.0),
    frames: int = 9,
    **case: Any,
) -> Path:
    """A results folder in which a ring, or another shape, rolls by `way` (x and z, m)."""
    nodes, lines, coil = shape or _ring()
    last = (frames - 1) * GAP
    table: dict[str, Any] = {
        "title": "A ring on its way",
        "dynamics": {"duration": f"{last:g} s", "interval": f"{GAP} s"},
        "contact": [{"type": "ground", "surface": ["shell"], "friction": 0.8}],
        "resolved": {"flexapod_version": "0.1.0", "source": str(path / "case.toml")},
        **case,
    }
    folder = ResultsFolder.open(path, table, resume=False)
    for k in range(frames):
        f = k / max(frames - 1, 1)
        shift = np.array([way[0] * f, 0.0, way[1] * f])
        x = _turned(nodes, way[0] * f / RADIUS, shift)
        on = (coil >= 0) & (coil % 4 == k % 4)
        folder.write_state(*_NOTHING, _state(k * GAP, nodes, lines, x, coil, on))
    folder.write_summary({"status": "done"})
    return path


_NOTHING = np.zeros((0, 3)), np.zeros((0, 8), dtype=int)


def _state(
    time: float, nodes: np.ndarray, lines: np.ndarray, x: np.ndarray, coil: Any, on: np.ndarray
) -> OutputState:
    row = {"time_s": time, "speed_m_s": 0.1, "turn_deg": 0.0}
    row |= {f"centre_{a}_mm": 1e3 * v for a, v in zip("xyz", x.mean(axis=0), strict=True)}
    names = ("kinetic", "strain", "weight", "lines", "rheology_loss", "coil_work", "unaccounted")
    row |= {f"{name}_J": 1e-3 * time * (k + 1) for k, name in enumerate(names)}
    cells = {
        "coil": np.asarray(coil),
        "on": on.astype(np.int32),
        "active_force": np.where(on, 0.15, 0.02) * (np.asarray(coil) >= 0),
        "force": np.linspace(-0.1, 0.2, len(lines)),
        "elongation": np.zeros(len(lines)),
    }
    return OutputState(
        time, row, np.zeros((0, 3)), lines=OutputLines(nodes, lines, x - nodes, {}, cells)
    )


def _image(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


# --------------------------------------------------------------------------- files


def test_lines_come_back_as_they_were_written(tmp_path: Path) -> None:
    nodes, lines, coil = _ring()
    x = _turned(nodes, 1.0, np.array([0.1, 0.0, 0.0]))
    on = coil == 1
    folder = ResultsFolder.open(tmp_path, {"resolved": {"flexapod_version": "0"}}, resume=False)
    folder.write_state(*_NOTHING, _state(0.0, nodes, lines, x, coil, on))
    mesh = meshio.read(tmp_path / "fields" / "lines_0000.vtu")
    assert [block.type for block in mesh.cells] == ["line"]
    assert set(mesh.cell_data) == {"coil", "on", "active_force", "force", "elongation"}
    np.testing.assert_array_equal(mesh.points, nodes)
    # Fields are kept in single precision: 2**-24 of their largest value.
    np.testing.assert_allclose(
        mesh.cell_data["force"][0], np.linspace(-0.1, 0.2, len(lines)), rtol=0.0, atol=1.2e-8
    )
    shape = plots_lines.read_lines(tmp_path / "fields" / "lines_0000.vtu")
    np.testing.assert_array_equal(shape.lines, lines)
    np.testing.assert_array_equal(shape.coil, coil)
    np.testing.assert_array_equal(shape.on, on)
    np.testing.assert_allclose(shape.points, x, rtol=0.0, atol=0.12 * 2.0**-24)
    np.testing.assert_allclose(shape.force[on], 0.15, rtol=1e-7)


def test_states_without_hexahedra_are_numbered_and_listed(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", frames=3)
    files = sorted(file.name for file in (path / "fields").iterdir())
    assert files == ["lines_0000.vtu", "lines_0001.vtu", "lines_0002.vtu"]
    assert not (path / "fields.pvd").exists()
    text = (path / "lines.pvd").read_text()
    assert text.count("<DataSet") == 3
    assert f'timestep="{2 * GAP:g}" part="0" file="fields/lines_0002.vtu"' in text
    results = plots.read_results(path)
    assert len(results.columns["time_s"]) == 3
    assert results.times == pytest.approx((0.0, GAP, 2 * GAP))
    assert [file.name for file in results.lines] == files


def test_lines_beside_hexahedra_share_their_times(tmp_path: Path) -> None:
    nodes, lines, coil = _ring()
    corners = RADIUS * np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        dtype=float,
    )
    folder = ResultsFolder.open(tmp_path, {"resolved": {"flexapod_version": "0"}}, resume=False)
    for k in range(2):
        state = _state(k * GAP, nodes, lines, nodes, coil, coil == k)
        solid = OutputState(state.time, state.row, np.zeros((8, 3)), lines=state.lines)
        folder.write_state(corners, np.arange(8)[None], solid)
    for kind, name in (("state", "fields.pvd"), ("lines", "lines.pvd")):
        assert (tmp_path / name).read_text().count(f"fields/{kind}_000") == 2
    results = plots.read_results(tmp_path)
    assert len(results.fields) == len(results.lines) == len(results.times) == 2


def test_going_back_to_a_checkpoint_drops_later_lines(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", frames=4)
    folder = ResultsFolder(path)
    rows = [{"time_s": 0.0}, {"time_s": GAP}]
    folder.keep(rows, [0.0, GAP])
    left = sorted(file.name for file in (path / "fields").iterdir())
    assert left == ["lines_0000.vtu", "lines_0001.vtu"]
    assert (path / "lines.pvd").read_text().count("<DataSet") == 2
    nodes, lines, coil = _ring()
    state = _state(9.0, nodes, lines, nodes, coil, coil == 0)
    folder.write_state(
        *_NOTHING, OutputState(9.0, {"time_s": 9.0}, state.displacement, lines=state.lines)
    )
    assert (path / "fields" / "lines_0002.vtu").is_file()
    assert 'timestep="9" part="0" file="fields/lines_0002.vtu"' in (path / "lines.pvd").read_text()
    folder.keep([], [])
    assert not (path / "lines.pvd").exists()


def test_a_new_run_clears_lines_and_their_pictures(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", frames=2)
    for name in ("voltage.png", "sweep.png", "mine.txt"):
        (path / "plots").mkdir(exist_ok=True)
        (path / "plots" / name).write_text("x")
    ResultsFolder.open(path, {"resolved": {"flexapod_version": "0"}}, resume=False)
    assert list((path / "fields").iterdir()) == []
    assert not (path / "lines.pvd").exists()
    assert [file.name for file in (path / "plots").iterdir()] == ["mine.txt"]


def test_what_is_wrong_with_a_file_of_lines_is_said(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", frames=2)
    results = plots.read_results(path)
    file = path / "fields" / "lines_0001.vtu"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"lines_0001\.vtu: cannot be read, perhaps it was cut"):
        plots_line_frames.read_line_frames(results)
    file.unlink()
    with pytest.raises(InputError, match=r"lines_0001\.vtu: is in lines\.pvd but missing"):
        plots_line_frames.read_line_frames(results)
    nodes, lines, _ = _ring()
    meshio.Mesh(
        nodes, [("line", lines)], point_data={"displacement": nodes},
        cell_data={"force": [np.zeros(len(lines))]},
    ).write(file)  # fmt: skip
    with pytest.raises(InputError, match='no cell field "coil"; its fields are: force'):
        plots_line_frames.read_line_frames(results)
    meshio.Mesh(nodes, [("vertex", np.array([[0]]))]).write(file)
    with pytest.raises(InputError, match="holds no lines"):
        plots_line_frames.read_line_frames(results)


# --------------------------------------------------------------------------- parts


def _shape(parts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> plots_lines.LineShape:
    nodes, lines, coil = parts
    return plots_lines.LineShape(nodes, lines, coil, coil == 1, np.zeros(len(lines)))


def test_parts_of_a_ring() -> None:
    parts = plots_lines.line_parts(_shape(_ring()))
    (shell,) = parts.shells
    assert shell[0] == shell[-1] and sorted(shell[1:]) == list(range(NODES))
    assert parts.hubs.tolist() == [NODES]
    assert parts.ends[1] == (NODES, NODES // 8)
    assert parts.ends[8] == (NODES // 8, 7 * NODES // 8)


def test_rings_of_a_sphere_go_straight_on_where_they_cross() -> None:
    nodes, lines, coil = _sphere()
    # In any order of the lines.
    order = np.random.default_rng(3).permutation(len(lines))
    shape = _shape((nodes, lines[order], coil[order]))
    parts = plots_lines.line_parts(shape)
    assert len(parts.shells) == 3
    for shell in parts.shells:
        assert len(shell) == NODES + 1 and shell[0] == shell[-1]
        # A plane ring: its smallest extent is none, up to the rounding of the nodes' places.
        assert np.ptp(nodes[shell], axis=0).min() < 1e-10
    assert parts.hubs.tolist() == [len(nodes) - 1]


def test_a_coil_of_several_lines_has_two_ends() -> None:
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [3, 0, 1]])
    lines = np.array([[1, 2], [0, 1], [2, 3], [3, 4]])
    shape = _shape((nodes, lines, np.array([0, 0, 0, -1])))
    parts = plots_lines.line_parts(shape)
    assert sorted(parts.ends[0]) == [0, 3]
    assert parts.hubs.size == 0


def test_a_smooth_ring_is_a_circle() -> None:
    nodes, _, _ = _ring()
    curve = plots_lines.smooth_curve(nodes[[*range(NODES), 0]], 6)
    r = np.linalg.norm(curve - [0.0, 0.0, RADIUS], axis=1)
    # Slopes are sin(h) instead of h, the angle of a piece. Halfway the curve bulges by
    # sin(h) sin(h/2) / 4 instead of 1 - cos(h/2): off by 3 h**4 / 128 of it, to leading order.
    np.testing.assert_allclose(r, RADIUS, rtol=1.05 * 3.0 * (2.0 * math.pi / NODES) ** 4 / 128.0)
    np.testing.assert_allclose(curve[0], curve[-1], atol=1e-15)


def test_a_zigzag_lies_about_its_axis() -> None:
    points = plots_lines.zigzag(np.array([1.0, 1.0]), np.array([1.0, 3.0]), 5, 0.1)
    assert len(points) == 13
    np.testing.assert_allclose(points[[0, -1]], [[1.0, 1.0], [1.0, 3.0]])
    assert np.abs(points[:, 0] - 1.0).max() == pytest.approx(0.1)
    assert (np.diff(points[:, 1]) > 0.0).all()


@pytest.mark.parametrize("closed", [False, True])
def test_a_tube_holds_what_it_should(closed: bool) -> None:
    radius, sides = 0.1, 24
    angle = np.linspace(0.0, 2.0 * math.pi, 61)
    # In no plane, so that the frame along it twists.
    path = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * np.sin(2.0 * angle)])
    if not closed:
        path = np.column_stack([np.linspace(0.0, 2.0, 5), np.zeros(5), np.zeros(5)])
    points, quads = plots_tubes.tube(path, radius, sides)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    corners = points[quads]
    normal = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    middle = corners.mean(axis=1)
    if closed:
        # Pappus: the volume is the section, a polygon, times the way of its middle; also from the
        # divergence theorem, which is right only if all quads face outwards and none is missing.
        section = 0.5 * sides * radius**2 * math.sin(2.0 * math.pi / sides)
        volume = float((normal * middle).sum()) / 3.0
        # Chords of 6 degrees instead of the curve, and sections across them: 1 %.
        assert volume == pytest.approx(section * length, rel=0.01)
        # Without twist, at the seam too, quads are no longer than the pieces of the path, but for
        # the bend on the outside (here a tenth) and half a side at the seam.
        longest = float(np.linalg.norm(np.diff(path, axis=0), axis=1).max())
        assert np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1).max() < 1.3 * longest
    else:
        side = 2.0 * radius * math.sin(math.pi / sides)
        assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(sides * side * length)
        assert (np.einsum("ij,ij->i", normal[:, 1:], middle[:, 1:]) > 0.0).all()


# --------------------------------------------------------------------------- pictures


def test_pictures_of_a_ring(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run")
    written, notices = plots.draw_all(path)
    names = {file.name for file in written}
    assert names == {"curve.png", "energy.png", "snapshots.png", "final.png", "animation.gif"}
    assert notices == []
    for file in written:
        assert file.stat().st_size > 5000, file
    assert (path / "plots" / "animation.gif").stat().st_size < plots_line_frames.GIF_SIZE
    from PIL import Image

    with Image.open(path / "plots" / "animation.gif") as film:
        assert getattr(film, "n_frames", 1) == 9
    # Coils with voltage are bright, on a strip that is wider than high.
    strip = _image(path / "plots" / "snapshots.png")
    assert strip.shape[1] > 2 * strip.shape[0]
    bright = (strip[:-70, :, 0] > 240) & (strip[:-70, :, 2] < 140)
    assert bright.sum() > 200


def test_pictures_of_a_sphere(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", _sphere(), frames=3)
    results = plots.read_results(path)
    frames = plots_line_frames.read_line_frames(results)
    assert frames is not None and not frames.plane and frames.view == "corner"
    written, _ = plots.draw_all(path)
    assert {"snapshots.png", "final.png", "animation.gif"} <= {file.name for file in written}
    final = _image(path / "plots" / "final.png")
    assert ((final[:-70, :, 0] > 200) & (final[:-70, :, 2] < 110)).sum() > 100


def _hoop() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and hexahedra of a solid shell, two millimetres thick and four wide."""
    angle = 2.0 * math.pi * np.arange(NODES) / NODES
    nodes = [
        [r * math.cos(a), y, RADIUS + r * math.sin(a)]
        for a in angle for r in (RADIUS - 0.001, RADIUS + 0.001) for y in (-0.002, 0.002)
    ]  # fmt: skip
    # Around, across and outwards is a right-handed order, since the angle goes from x to z.
    cells = []
    for k in range(NODES):
        here, there = 4 * k, 4 * ((k + 1) % NODES)
        cells.append([here, here + 2, here + 3, here + 1, there, there + 2, there + 3, there + 1])
    return np.array(nodes), np.array(cells)


def test_a_solid_shell_is_drawn_from_its_hexahedra(tmp_path: Path) -> None:
    nodes, lines, coil = _ring()
    hoop, cells = _hoop()
    path = _folder(tmp_path / "run", frames=1)
    folder = ResultsFolder(path)
    spokes = coil >= 0
    state = _state(0.0, nodes, lines[spokes], nodes, coil[spokes], coil[spokes] == 1)
    solid = OutputState(0.0, state.row, np.zeros_like(hoop), lines=state.lines)
    folder.write_state(hoop, cells, solid)
    results = plots.read_results(path)
    frames = plots_line_frames.read_line_frames(results)
    assert frames is not None and frames.plane and frames.parts.shells == ()
    skin = frames.solid(0)
    assert skin is not None
    # Of the four sides of each hexahedron in sight, one looks towards -y.
    facing = plots_lines._facing(skin)
    assert len(facing) == NODES and (facing[:, :, 1] == -0.002).all()
    target = tmp_path / "final.png"
    plots_line_frames.plot_line_final(results, [], frames, target)
    image = _image(target)
    shell = np.abs(image - [0x5D, 0x6F, 0x87]).max(axis=2) < 12
    assert shell.sum() > 5000


def test_a_ring_at_rest_and_one_frame_can_be_drawn(tmp_path: Path) -> None:
    path = _folder(
        tmp_path / "run", way=(0.0, 0.0), frames=1, dynamics={"duration": "1 s", "interval": "1 s"}
    )
    written, _ = plots.draw_all(path)
    assert "animation.gif" in {file.name for file in written}


def test_a_last_state_that_is_none_is_left_out(tmp_path: Path) -> None:
    path = _folder(tmp_path / "run", frames=3)
    nodes, lines, coil = _ring()
    file = path / "fields" / "lines_0002.vtu"
    meshio.Mesh(
        nodes, [("line", lines)], point_data={"displacement": np.full_like(nodes, np.nan)},
        cell_data={n: [np.asarray(coil)] for n in ("coil", "on", "active_force")},
    ).write(file)  # fmt: skip
    frames = plots_line_frames.read_line_frames(plots.read_results(path))
    assert frames is not None and frames.index == (0, 1)


def test_the_camera_goes_along_a_long_way_only() -> None:
    times = np.linspace(0.0, 10.0, 101)
    # A steady way with a gait's swing of 0.6 s.
    x = 0.026 * times + 0.004 * np.sin(2.0 * math.pi * times / 0.6)
    middle = np.column_stack([x, np.full(101, 0.02)])
    window, along = plots_line_frames.camera(middle, times, np.array([0.30, 0.05]), 0.04)
    assert window == pytest.approx([0.168, 0.05])
    # The swing is gone: a Gaussian of 10/12 s leaves exp(-(2 pi/0.6 * 0.83)**2 / 2) of it, nothing,
    # but for the ends, where the mirrored swing has another phase.
    np.testing.assert_allclose(along[20:80, 0], 0.026 * times[20:80], rtol=0.0, atol=2e-4)
    # And at the ends it is with the robot, to the swing.
    np.testing.assert_allclose(along[[0, -1], 0], x[[0, -1]], rtol=0.0, atol=0.005)
    assert (np.abs(along[:, 0] - x) < 0.5 * window[0] - 0.02).all()
    window, along = plots_line_frames.camera(middle[:30], times[:30], np.array([0.12, 0.05]), 0.04)
    assert window == pytest.approx([0.12, 0.05])
    assert np.ptp(along, axis=0).tolist() == [0.0, 0.0]


# --------------------------------------------------------------------------- voltage, sweep


def _edges(image: np.ndarray) -> np.ndarray:
    """Where the bands of voltage begin and end, as shares of the axes' width."""
    bright = (image[:, :, 0] > 240) & (image[:, :, 2] < 190) & (image[:, :, 2] > 120)
    row = bright[np.flatnonzero(bright.any(axis=1))[5]]
    return np.flatnonzero(np.diff(row.astype(int)))


def test_the_voltage_diagram_is_true_to_time(tmp_path: Path) -> None:
    times = np.array([0.0, 0.5, 1.0, 1.5])
    states = np.array([[False, True], [True, False], [False, True], [False, False]])
    plot_voltage("AB", times, states, 2.0, "two coils", tmp_path / "voltage.png", 0.5)
    image = _image(tmp_path / "voltage.png")
    # The upper row is A's: on from a quarter to half of the time.
    on, off = _edges(image)[[0, -1]]
    line = image.max(axis=2) < 60
    wide = np.flatnonzero(line[np.argmax(line.sum(axis=1))])
    left, right = wide.min(), wide.max()
    # The line beside the band is 2.7 dots wide, and pale where it begins.
    assert 0.5 * (on + off) == pytest.approx(left + 0.375 * (right - left), abs=4.0)
    assert off - on == pytest.approx(0.25 * (right - left), abs=10.0)


def test_the_voltage_of_a_case(tmp_path: Path) -> None:
    pytest.importorskip("flexapod.dynamics.actuation")
    from flexapod.app.plots_voltage import read_actuation

    actuation = {"pattern": "BF", "interval": "0.6 s", "direction": 1, "duty": 1.0}
    dynamics = {"duration": "30 s", "interval": "50 ms"}
    path = _folder(tmp_path / "run", frames=2, actuation=actuation, dynamics=dynamics)
    events, end, words = read_actuation(plots.read_results(path))
    assert words == "pattern BF, interval 0.6 s"
    # Two rounds of eight steps; in the first step B and F, in the last A and E.
    assert end == pytest.approx(16 * 0.6)
    assert "".join(n for n, on in zip(events.letters, events.on(0.3), strict=True) if on) == "BF"
    last = events.on(end - 0.1)
    assert "".join(n for n, on in zip(events.letters, last, strict=True) if on) == "AE"
    table = {"table": {"A": [["0 s", "1 s"]], "I": [["0.5 s", "1.5 s"]]}}
    path = _folder(tmp_path / "jump", frames=2, actuation=table, dynamics=dynamics)
    events, end, words = read_actuation(plots.read_results(path))
    assert events.on_time(30.0).sum() == pytest.approx(2.0)
    assert end == pytest.approx(1.65)
    written, _ = plots.draw_all(path)
    assert path / "plots" / "voltage.png" in written


def _sweep(path: Path, over: list[dict[str, Any]], rows: list[dict[str, float | str]]) -> Path:
    case = {
        "title": "Distance against interval",
        "dynamics": {"duration": "10 s", "interval": "5 ms"},
        "sweep": {
            "of": "distance_m",
            "result": "distances",
            "over": over,
            "reference": [{"name": "measured BF", "x": [0.6], "y": [0.26]}],
        },
        "resolved": {"flexapod_version": "0.1.0"},
    }
    folder = ResultsFolder.open(path, case, resume=False)
    for row in rows:
        folder.write_row(row)
    folder.write_summary({"status": "done"})
    return path


def test_a_sweep_has_a_line_for_each_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    over = [{"key": "actuation.pattern", "values": ["BF", "BG"]},
            {"key": "actuation.interval", "values": ["0.2 s", "0.6 s"]}]  # fmt: skip
    rows: list[dict[str, float | str]] = [
        {"run": 1.0, "pattern": "BF", "interval_s": 0.6, "distance_m": 0.25, "done": 1.0},
        {"run": 2.0, "pattern": "BF", "interval_s": 0.2, "distance_m": 0.3, "done": 1.0},
        {"run": 3.0, "pattern": "BG", "interval_s": 0.2, "distance_m": 0.1, "done": 1.0},
        {"run": 4.0, "pattern": "BG", "interval_s": 0.6, "distance_m": math.nan, "done": 0.0},
    ]
    path = _sweep(tmp_path / "run", over, rows)
    assert (path / "curve.csv").read_text().splitlines()[1] == "1,BF,0.6,0.25,1"
    written, _ = plots.draw_all(path)
    assert [file.name for file in written] == ["sweep.png"]
    assert written[0].stat().st_size > 5000
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(plots_sweep, "plot_curves", lambda *a: drawn.update(a=a))
    plots.draw_all(path)
    title, x_label, y_label, series, references, _ = drawn["a"]
    assert (title, x_label, y_label) == (
        "Distance against interval", "interval [s]", "distance [mm]",
    )  # fmt: skip
    assert list(series) == ["BF", "BG"]
    np.testing.assert_allclose(series["BF"][0], [0.6, 0.2])
    np.testing.assert_allclose(series["BF"][1], [250.0, 300.0])
    assert references[0]["y"] == pytest.approx([260.0])


def test_a_sweep_of_keys_that_end_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    over = [
        {"key": "contact.0.friction", "values": [0.1]},
        {"key": "b.friction", "values": [0.2, 0.4]},
    ]
    rows: list[dict[str, float | str]] = [
        {"run": 1.0, "friction_1": 0.1, "friction_2": 0.2, "distance_m": 3.0},
        {"run": 2.0, "friction_1": 0.1, "friction_2": 0.4, "distance_m": 4.0},
    ]
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(plots_sweep, "plot_curves", lambda *a: drawn.update(a=a))
    plots.draw_all(_sweep(tmp_path / "run", over, rows))
    _, x_label, y_label, series, _, _ = drawn["a"]
    assert (x_label, y_label) == ("friction 2", "distance [m]")
    ((_, (x, y)),) = series.items()
    assert x.tolist() == [0.2, 0.4] and y.tolist() == [3.0, 4.0]


def test_a_sweep_without_numbers_or_columns_says_so(tmp_path: Path) -> None:
    over = [{"key": "actuation.pattern", "values": ["BF"]}]
    path = _sweep(tmp_path / "a", over, [{"run": 1.0, "pattern": "BF", "distance_m": 1.0}])
    with pytest.raises(InputError, match="none of the swept keys has numbers"):
        plots.draw_all(path)
    path = _sweep(tmp_path / "b", over, [{"run": 1.0, "other": 1.0, "distance_m": 1.0}])
    with pytest.raises(InputError, match=r'no column of "actuation\.pattern"; the columns are run'):
        plots.draw_all(path)
