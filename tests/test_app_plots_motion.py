"""Pictures of a motion, from a small folder made here: a box that rolls, jumps or stands."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexapod.app import (
    plots,
    plots_film,
    plots_frames,
    plots_ground,
    plots_motion,
    plots_stage,
)
from flexapod.app.outputs import OutputState, ResultsFolder
from flexapod.contact.ground import Ground, HeightField, Step, slope
from flexapod.core.errors import InputError

SIDE = 0.04  # of the box [m]; half of it, y from 0 up, is modelled
FRAMES, PER_FRAME, INTERVAL = 5, 3, 0.01
GAP = PER_FRAME * INTERVAL


@pytest.fixture(autouse=True)
def _matplotlib(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")
    yield
    plots.renderer.cache_clear()


def _box() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of 2 by 1 by 2 hexahedra."""
    grid = np.meshgrid([-0.5, 0.0, 0.5], [0.0, 0.5], [0.0, 0.5, 1.0], indexing="ij")
    nodes = SIDE * np.stack(grid, axis=-1).reshape(-1, 3)
    n = np.arange(18).reshape(3, 2, 3)
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    corner += [(i, j, 1) for i, j, _ in corner]
    cells = [[n[i + a, b, k + c] for a, b, c in corner] for i in range(2) for k in range(2)]
    return nodes, np.array(cells)


def _folder(
    path: Path,
    way: tuple[float, float] = (0.3, 0.0),
    ground: dict[str, Any] | None = None,
    plot: dict[str, Any] | None = None,
    frames: int = FRAMES,
    status: str = "done",
    duration: float | None = None,
) -> Path:
    """A results folder in which the box is shifted by `way` (x and z, m), evenly."""
    last = (frames - 1) * GAP
    case: dict[str, Any] = {
        "title": "A box on its way",
        "dynamics": {"duration": f"{last if duration is None else duration:g} s",
                     "interval": f"{INTERVAL} s"},
        "plot": {"mirror": ["y"], "view": "side", **(plot or {})},
        "resolved": {"flexapod_version": "0.1.0", "source": str(path / "case.toml")},
    }  # fmt: skip
    if ground is not None:
        case["contact"] = [
            {"type": "ground", "surface": ["outer"], **ground},
            {"type": "self", "surface": ["outer"]},
        ]
    folder = ResultsFolder.open(path, case, resume=False)
    nodes, cells = _box()
    count = (frames - 1) * PER_FRAME
    for k in range(count + 1):
        f = k / max(count, 1)
        shift = np.array([way[0] * f, 0.0, way[1] * f])
        row = {"time_s": k * INTERVAL}
        for name in ("centre", "marker"):
            row |= {f"{name}_{a}_mm": 1e3 * v for a, v in zip("xyz", shift, strict=True)}
        row |= {"speed_m_s": f, "turn_deg": 90.0 * f}
        names = ("kinetic", "strain", "weight", "contact", "pressure_work", "contact_loss",
                 "unaccounted")  # fmt: skip
        row |= {f"{name}_J": 1e-3 * f * (i + 1) for i, name in enumerate(names)}
        for name in ("ground_0", "self_1") if ground is not None else ():
            row |= {f"{name}_force_N": f, f"{name}_area_mm2": f, f"{name}_depth_mm": 0.0}
            row[f"{name}_points"] = 4.0
        if k % PER_FRAME:
            folder.write_row(row)
            continue
        stretch = 1.0 + 0.1 * np.arange(12.0).reshape(4, 3)
        folder.write_state(
            nodes, cells, OutputState(k * INTERVAL, row, np.tile(shift, (18, 1)), {},
                                      {"principal_stretches": stretch})
        )  # fmt: skip
    folder.write_summary({"status": status})
    return path


def _frames(results: plots.Results) -> plots_frames.Frames:
    frames = plots_frames.read_frames(results)
    assert frames is not None
    return frames


def _gif(path: Path) -> tuple[list[np.ndarray], list[int]]:
    from PIL import Image

    images, shown = [], []
    with Image.open(path) as film:
        for k in range(getattr(film, "n_frames", 1)):
            film.seek(k)
            images.append(np.asarray(film.convert("RGB")).astype(int))
            shown.append(int(film.info["duration"]))
    return images, shown


def _coloured(image: np.ndarray) -> np.ndarray:
    """Middle of the body's pixels, column and row; the colour bar's rows are left out."""
    image = image[:-45]
    rows, columns = np.nonzero(np.ptp(image, axis=2) > 40)
    assert rows.size, "no body is drawn"
    return np.array([columns.mean(), rows.mean()])


# --------------------------------------------------------------------------- ground


def _field() -> HeightField:
    heights = np.random.default_rng(1).random((6, 5)) * 0.03
    return HeightField.from_array(heights, 0.02, x0=-0.05, y0=-0.03)


def test_height_of_a_slope_is_its_formula() -> None:
    x = np.linspace(-1.0, 2.0, 7)
    angle, level = math.radians(12.7), 0.15
    z = plots_ground.ground_heights(slope(angle, (0.0, 0.0, level)), x, np.zeros(7))
    # Falls along +x: z = level - x tan(angle); round-off of the normal's length.
    np.testing.assert_allclose(z, level - x * math.tan(angle), rtol=0.0, atol=1e-15)


def test_profile_of_a_step_is_upright() -> None:
    profile = plots_ground.ground_profile([Step(0.3, 0.02)], 0.0, 1.0)
    x, z = profile.T
    assert set(z) == {0.0, 0.02}
    # The last point below and the first above stand over each other.
    rise = int(np.argmax(z > 0.0))
    assert x[rise] == 0.3
    assert x[rise] - x[rise - 1] < 1e-15
    assert x[0] == 0.0 and x[-1] == 1.0


def test_height_of_a_field_is_bilinear_with_a_level_rim() -> None:
    field = _field()
    h = field.heights
    u, w = 0.3, 0.8
    x, y = field.x0 + (2 + u) * 0.02, field.y0 + (1 + w) * 0.02
    wanted = (1 - u) * (1 - w) * h[2, 1] + u * (1 - w) * h[3, 1]
    wanted += (1 - u) * w * h[2, 2] + u * w * h[3, 2]
    z = plots_ground.ground_heights(field, np.array([x, -9.0, 9.0]), np.array([y, -9.0, 9.0]))
    # Round-off of x and y over the spacing, times the steepest slope of the field.
    np.testing.assert_allclose(z, [wanted, h[0, 0], h[-1, -1]], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("ground", [slope(0.2, (0.0, 0.0, 0.1)), Step(0.3, 0.02), _field()])
def test_the_ground_drawn_is_the_ground_touched(ground: Ground) -> None:
    from flexapod.dynamics.ground_contact import gaps

    x, y = np.linspace(-0.2, 0.5, 57), np.linspace(-0.1, 0.1, 57)
    z = plots_ground.ground_heights(ground, x, y)
    # Round-off: no gap anywhere on the surface.
    np.testing.assert_allclose(gaps(ground, np.column_stack([x, y, z])), 0.0, atol=1e-15)


def test_profile_takes_the_highest() -> None:
    grounds = [Step(0.3, 0.02), slope(0.0, (0.0, 0.0, 0.01))]
    x, z = plots_ground.ground_profile(grounds, 0.0, 1.0).T
    np.testing.assert_array_equal(z, np.where(x < 0.3, 0.01, 0.02))
    field = _field()
    wide = plots_ground.ground_profile([field], 0.0, 0.05, half_width=0.02)[:, 1]
    assert (wide >= plots_ground.ground_profile([field], 0.0, 0.05)[:, 1]).all()


def test_grounds_are_read_from_the_resolved_case(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "r", ground={"slope": "12.7 deg", "level": "5 mm"})
    (ground,) = plots_ground.read_grounds(plots.read_results(folder))
    z = plots_ground.ground_heights(ground, np.array([1.0]), np.zeros(1))
    assert z[0] == pytest.approx(0.005 - math.tan(math.radians(12.7)), abs=1e-15)  # round-off


# --------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("renderer", ["matplotlib", "pyvista"])
def test_all_pictures_of_a_motion(
    tmp_path: Path, renderer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if renderer == "pyvista":
        monkeypatch.delenv("FLEXAPOD_RENDERER")
        plots.renderer.cache_clear()
        if plots.renderer()[0] != "pyvista":
            pytest.skip("no off-screen rendering here")
    folder = _folder(tmp_path / "r", ground={"slope": "0 deg"})
    names = ["curve.png", "energy.png", "contact.png", "snapshots.png", "final.png",
             "animation.gif"]  # fmt: skip
    if renderer == "pyvista":
        # Curves are the same with either.
        for name in ("plot_motion_curve", "plot_energy", "plot_contact"):
            monkeypatch.setattr(plots_motion, name, lambda *_: None)
    written, notices = plots.draw_all(folder)
    assert notices == []
    assert [path.name for path in written] == names
    if renderer == "pyvista":
        names, written = names[3:], written[3:]
    from matplotlib.image import imread

    for path in written[:-1]:
        image = imread(path)
        assert min(image.shape[:2]) > 300, path
        assert max(image.shape[:2]) < 3000, path
        assert image.std() > 0.01, path
    # Nothing half written stays behind.
    assert sorted(path.name for path in (folder / "plots").iterdir()) == sorted(names)

    images, shown = _gif(written[-1])
    assert len(images) == FRAMES
    assert shown[:-1] == [30] * (FRAMES - 1)  # true speed
    # One camera: the box goes to the right by even steps, half a pixel of rounding each.
    middles = np.array([_coloured(image) for image in images])
    steps = np.diff(middles, axis=0)
    assert steps[:, 0].min() > 20.0
    assert np.ptp(steps[:, 0]) < 2.0, steps
    assert np.abs(steps[:, 1]).max() < 1.0, steps
    # It stands on the ground: below its last row comes the ground's line, then the ground.
    column = images[0][:-45, round(middles[0][0])]
    foot = int(np.flatnonzero(np.ptp(column, axis=1) > 40)[-1])
    assert np.ptp(column[foot + 4]) <= 12, column[foot : foot + 5]
    assert 215 < column[foot + 4].mean() < 240, column[foot : foot + 5]


def test_up_is_up(tmp_path: Path) -> None:
    results = plots.read_results(_folder(tmp_path / "r", way=(0.0, 0.2), frames=2))
    plots_frames.plot_animation(results, [], _frames(results), tmp_path / "up.gif")
    first, last = (_coloured(image) for image in _gif(tmp_path / "up.gif")[0])
    assert last[1] < first[1] - 50.0  # rows count from the top
    assert abs(last[0] - first[0]) < 1.0


def test_from_above_what_rises_stays_in_its_row(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "r", way=(0.2, 0.1), plot={"view": "top"}, frames=2)
    results = plots.read_results(folder)
    frames = _frames(results)
    # Across is x and up is y: the box, with its mirrored half, stays within half a side of y = 0.
    # The file's displacements are in single precision: 0.2 m to 1e-8.
    np.testing.assert_allclose(frames.boxes[:, 0, 0], [-0.02, 0.18], rtol=0.0, atol=2e-8)
    np.testing.assert_allclose(frames.boxes[:, :, 2], [[-0.02, 0.02]] * 2, rtol=0.0, atol=2e-8)
    step = Step(0.05, 0.01)
    plots_frames.plot_animation(results, [step], frames, tmp_path / "above.gif")
    first, last = (_coloured(image) for image in _gif(tmp_path / "above.gif")[0])
    assert last[0] > first[0] + 50.0
    assert abs(last[1] - first[1]) < 1.0
    plots_frames.plot_motion_snapshots(results, [step], frames, tmp_path / "above.png")
    assert (tmp_path / "above.png").is_file()


def test_the_mirrored_half_is_drawn(tmp_path: Path) -> None:
    results = plots.read_results(_folder(tmp_path / "r", frames=1))
    skin = plots.skin_reader(results).read(results.fields[0])
    assert skin.points[:, 1].min() == -skin.points[:, 1].max() < 0.0


@pytest.mark.parametrize(
    ("view", "ground"),
    [("corner", {"shape": "step", "step_at": "20 mm"}), ("top", {"slope": "10 deg"})],
)
def test_final_in_other_views_and_one_frame(
    tmp_path: Path, view: str, ground: dict[str, Any]
) -> None:
    results = plots.read_results(
        _folder(tmp_path / "r", ground=ground, plot={"view": view}, frames=1)
    )
    grounds, frames = plots_ground.read_grounds(results), _frames(results)
    target = tmp_path / "final.png"
    plots_frames.plot_motion_final(results, grounds, frames, target)
    from matplotlib.image import imread

    # The ground is there, in its colour or a shade of it: grey, but not white.
    image = imread(target)[..., :3]
    grey = (np.ptp(image, axis=2) < 0.08) & (image.min(axis=2) > 0.6) & (image.max(axis=2) < 0.95)
    # Measured 4.2 % and 36 %; 0.2 % without ground, the edges of letters.
    assert grey.mean() > 0.02
    plots_frames.plot_animation(results, grounds, frames, tmp_path / "one.gif")
    assert len(_gif(tmp_path / "one.gif")[0]) == 1


def test_a_field_of_rocks_and_one_that_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "r"
    _folder(folder, frames=2, ground={"shape": "field", "file": "rocks.csv", "spacing": "20 mm"})
    for name in ("plot_energy", "plot_contact", "plot_motion_final", "plot_animation"):
        monkeypatch.setattr(plots_motion, name, lambda *_: None)
    _, notices = plots.draw_all(folder)
    assert len(notices) == 1
    assert "rocks.csv" in notices[0]
    np.savetxt(folder / "rocks.csv", 0.01 * np.eye(9), delimiter=",")
    assert plots.draw_all(folder)[1] == []


def test_a_run_that_ended_early_says_so(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "a", status="inverted_element", duration=2.0)
    heading = plots.heading_of(plots.read_results(folder))
    assert heading == "A box on its way\nrun ended early: inverted element at 0.12 s"
    # Stopped while its pictures were drawn: all is there.
    folder = _folder(tmp_path / "b", status="interrupted")
    assert plots.heading_of(plots.read_results(folder)) == "A box on its way"


def test_contacts_of_a_folder_in_one_call(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "r", ground={"slope": "0 deg"}, frames=2)
    plots_motion.plot_contact(folder, tmp_path / "contact.png")
    assert (tmp_path / "contact.png").is_file()
    with pytest.raises(InputError, match="no contacts"):
        plots_motion.plot_contact(_folder(tmp_path / "s", frames=2), tmp_path / "none.png")


def test_columns_the_case_asks_for(tmp_path: Path) -> None:
    target = tmp_path / "any.png"
    plot = {"x": "turn_deg", "y": ["kinetic_J"], "snapshots": [46.0, 90.0]}
    results = plots.read_results(_folder(tmp_path / "r", plot=plot))
    assert plots_stage.wanted_frames(results, _frames(results)) == [2, 4]
    plots_motion.plot_motion_curve(results, [], target)
    assert target.is_file()
    results = plots.read_results(_folder(tmp_path / "s", plot={"y": ["lift_N"]}))
    with pytest.raises(InputError, match=r'no column "lift_N"; the columns are time_s, '):
        plots_motion.plot_motion_curve(results, [], target)


# --------------------------------------------------------------------------- choices


def _boxes(x: np.ndarray, z: np.ndarray, width: float) -> np.ndarray:
    middle = np.column_stack([x, 0 * x, z])
    return np.stack([middle - 0.5 * width, middle + 0.5 * width], axis=1)


def test_strip_takes_frames_that_stand_clear() -> None:
    # Faster and faster over ten widths: even places, not even times.
    x = np.linspace(0.0, 1.0, 41) ** 2
    chosen = plots_stage.strip_frames(_boxes(x, 0 * x, 0.1))
    assert chosen is not None
    assert len(chosen) == 7 and chosen[0] == 0 and chosen[-1] == 40
    assert np.diff(x[chosen]).min() > 0.1
    # On the spot, or there and back within two widths: no strip.
    assert plots_stage.strip_frames(_boxes(0 * x, x, 0.1)) is None
    assert plots_stage.strip_frames(_boxes(0.19 * x, 0 * x, 0.1)) is None
    assert plots_stage.strip_frames(_boxes(np.zeros(1), np.zeros(1), 0.1)) is None


def test_overlap_is_a_share_of_the_width() -> None:
    x, z = np.array([0.0, 0.05]), np.array([0.0, 0.2])
    assert plots_stage.overlap(_boxes(x, 0 * z, 0.1)) == pytest.approx(0.5)
    # One above the other hides nothing.
    assert plots_stage.overlap(_boxes(x, z, 0.1)) == 0.0


@pytest.mark.parametrize(
    ("gap", "speed", "shown"),
    [
        (0.025, 1.0, 25.0),
        (0.02, 1.0, 20.0),
        (0.2, 1.0, 200.0),
        (0.005, 0.2, 25.0),
        (0.01, 0.5, 20.0),
        (1.0, 5.0, 200.0),
        (3.0, 20.0, 150.0),
    ],
)
def test_playing_speed(gap: float, speed: float, shown: float) -> None:
    times = 0.3 + gap * np.arange(41)
    each, got = plots_film.playing(times)
    assert got == pytest.approx(speed)
    assert len(each) == 41
    assert min(each) >= 20
    # Whole tens of milliseconds, whose sum is that of the true times to one of them.
    assert all(n % 10 == 0 for n in each)
    assert abs(sum(each[:-1]) - 40 * shown) <= 10.0


def test_a_gif_too_large_shrinks(tmp_path: Path) -> None:
    results = plots.read_results(_folder(tmp_path / "r", frames=2))
    frames = _frames(results)
    plots_frames.plot_animation(results, [], frames, tmp_path / "large.gif")
    size = (tmp_path / "large.gif").stat().st_size
    plots_frames.plot_animation(results, [], frames, tmp_path / "small.gif", size=size // 2)
    assert (tmp_path / "small.gif").stat().st_size <= size // 2
    large, small = (_gif(tmp_path / f"{name}.gif")[0] for name in ("large", "small"))
    assert len(large) == len(small) == 2
    assert small[0].shape[1] < large[0].shape[1]
