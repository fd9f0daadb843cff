"""Results folder, comparison with a reference, pictures from files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest

from flexapod.app import plots
from flexapod.app.outputs import (
    OutputState,
    ResultsFolder,
    clean_json,
    compare,
    dump_json,
    interpolate_path,
    read_reference_csv,
    replacing,
)
from flexapod.app.probes import angle_about, best_rotation, unwrap
from flexapod.core.errors import InputError

RESOLVED = {"name": "a", "mesh": {"builder": "curl"}, "resolved": {"flexapod_version": "0"}}


def _reference(**changes: Any) -> SimpleNamespace:
    values = {
        "name": "measured",
        "x": "pressure_kPa",
        "y": "angle_deg",
        "points": (10.0, 20.0, 30.0),
        "simulation_error": 0.1459,
        "simulation_name": "theirs",
    }
    return SimpleNamespace(**{**values, **changes})


def test_mean_relative_error_by_hand() -> None:
    rows = [{"pressure_kPa": p, "angle_deg": 2 * p} for p in (0.0, 0.0, 15.0, 30.0)]
    result = compare(rows, _reference(), [10.0, 40.0, 80.0])
    # |20-10|/10 = 1, |40-40|/40 = 0, |60-80|/80 = 0.25
    assert result["mean_relative_error"] == pytest.approx(1.25 / 3, rel=1e-12)
    assert result["points_reached"] == 3
    assert "note" not in result
    assert result["simulation_error"] == 0.1459


def test_only_reached_points_count_and_it_says_so() -> None:
    rows = [{"pressure_kPa": p, "angle_deg": p} for p in (0.0, 22.0)]
    result = compare(rows, _reference(), [10.0, 10.0, 10.0])
    assert result["mean_relative_error"] == pytest.approx(0.5)
    assert result["points_reached"] == 2
    assert result["note"].startswith("the mean is over 2 of 3 points")
    assert result["table"][2]["computed"] is None


def test_interpolation_follows_the_path() -> None:
    x, y = np.array([0.0, 10.0, 5.0, 12.0]), np.array([0.0, 1.0, 2.0, 3.0])
    assert interpolate_path(x, y, 5.0) == 0.5
    assert interpolate_path(x, y, 11.0) == pytest.approx(2 + 6 / 7)
    assert interpolate_path(x, y, 13.0) is None
    # 55 kPa reached to round-off counts as reached.
    assert interpolate_path(np.array([0.0, 55.0 - 1e-13]), np.array([0.0, 1.0]), 55.0) is not None


def test_reference_csv_names_its_heads(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("# measured\npressure_kPa, angle_deg\n0,1\n10,2\n")
    x, y = read_reference_csv(path, "pressure_kPa", "angle_deg")
    assert x.tolist() == [0.0, 10.0]
    assert y.tolist() == [1.0, 2.0]
    with pytest.raises(InputError, match="has no column force_N; its heads are pressure_kPa"):
        read_reference_csv(path, "force_N", "angle_deg")


def test_json_has_no_nan() -> None:
    value = {"a": math.nan, "b": np.float64(1.5), "c": np.arange(2), "d": (True, None)}
    assert clean_json(value) == {"a": None, "b": 1.5, "c": [0, 1], "d": [True, None]}
    json.loads(dump_json(value))


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as partial:
        partial.write_text("new")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_other_peoples_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="nothing is overwritten unasked"):
        ResultsFolder.open(tmp_path, RESOLVED, resume=False)
    with pytest.raises(InputError, match="is a file"):
        ResultsFolder.open(tmp_path / "thesis.tex", RESOLVED, resume=False)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_an_earlier_run_is_replaced_but_nothing_beside_it(tmp_path: Path) -> None:
    folder = ResultsFolder.open(tmp_path / "r", RESOLVED, resume=False)
    _write_states(folder, 3)
    (folder.path / "notes.txt").write_text("mine")
    again = ResultsFolder.open(tmp_path / "r", RESOLVED, resume=False)
    assert not list((again.path / "fields").iterdir())
    assert not (again.path / "curve.csv").exists()
    assert (again.path / "notes.txt").read_text() == "mine"


def test_resume_needs_the_same_case(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to resume there"):
        ResultsFolder.open(tmp_path / "r", RESOLVED, resume=True)
    ResultsFolder.open(tmp_path / "r", RESOLVED, resume=False)
    other = {**RESOLVED, "mesh": {"builder": "turn"}}
    with pytest.raises(InputError, match="the run there was of another case: mesh differ"):
        ResultsFolder.open(tmp_path / "r", other, resume=True)
    ResultsFolder.open(tmp_path / "r", {**RESOLVED, "title": "new"}, resume=True)


CUBE = np.array(
    [[x, y, z] for z in (0.0, 1.0) for x, y in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))]
)


def _write_states(folder: ResultsFolder, count: int) -> None:
    for i in range(count):
        u = 0.1 * i * CUBE
        row = {"pressure_kPa": 10.0 * i, "angle_deg": 3.0 * i}
        stress = np.arange(9.0).reshape(1, 9)
        state = OutputState(
            float(i),
            row,
            u,
            {"contact_pressure": np.zeros(8)},
            {"principal_stretches": np.array([[1.0 + i, 1.0, 0.5]]), "cauchy_stress": stress},
        )
        folder.write_state(CUBE, np.arange(8).reshape(1, 8), state)


def test_fields_and_collection_read_back(tmp_path: Path) -> None:
    folder = ResultsFolder.open(tmp_path / "r", RESOLVED, resume=False)
    _write_states(folder, 2)
    mesh = meshio.read(folder.path / "fields" / "state_0001.vtu")
    np.testing.assert_allclose(mesh.point_data["displacement"], 0.1 * CUBE, atol=1e-7)
    assert mesh.cell_data["cauchy_stress"][0].shape == (1, 9)
    text = (folder.path / "fields.pvd").read_text()
    assert 'timestep="1" part="0" file="fields/state_0001.vtu"' in text
    assert (folder.path / "curve.csv").read_text() == "pressure_kPa,angle_deg\n0,0\n10,3\n"


def test_checkpoint_goes_back_to_its_rows(tmp_path: Path) -> None:
    folder = ResultsFolder.open(tmp_path / "r", RESOLVED, resume=False)
    _write_states(folder, 2)
    u = np.random.default_rng(0).normal(size=(8, 3))
    folder.write_checkpoint({"u": u}, {"step": 1, "increment": None})
    _write_states(folder, 1)
    assert len(folder.rows) == 3
    again = ResultsFolder.open(tmp_path / "r", RESOLVED, resume=True)
    kept = again.read_checkpoint()
    assert kept is not None
    arrays, about = kept
    assert np.array_equal(arrays["u"], u)
    assert about == {"step": 1, "increment": None}
    assert again.rows == folder.rows[:2]
    assert len(list((again.path / "fields").iterdir())) == 2


@pytest.mark.parametrize("renderer", ["pyvista", "matplotlib"])
def test_pictures_from_files_alone(
    tmp_path: Path, renderer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if renderer == "pyvista":
        plots.renderer.cache_clear()
        monkeypatch.delenv("FLEXAPOD_RENDERER", raising=False)
        if plots.renderer()[0] != "pyvista":
            pytest.skip("no off-screen rendering here")
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", renderer)
    folder = ResultsFolder.open(
        tmp_path / "r", {**RESOLVED, "plot": {"mirror": ["x"], "view": "side"}}, resume=False
    )
    _write_states(folder, 3)
    written, _ = plots.draw_all(folder.path)
    plots.renderer.cache_clear()
    from matplotlib.image import imread

    assert [path.name for path in written] == ["curve.png", "snapshots.png", "final.png"]
    for path in written:
        image = imread(path)
        assert min(image.shape[:2]) > 300
        assert image.std() > 0.01  # something is drawn


def test_boundary_of_two_cubes() -> None:
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]])
    quads, owner = plots.boundary_quads(cells)
    assert len(quads) == 10
    assert sorted(owner.tolist()) == [0] * 5 + [1] * 5


def test_plot_of_no_results(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not a results folder: case\.resolved\.toml is missing"):
        plots.draw_all(tmp_path)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("degrees", [0.0, 30.0, -75.0, 179.0])
def test_rotation_of_a_plane_patch(axis: str, degrees: float) -> None:
    # A patch in one plane, turned about an axis and moved: the rotation is exact.
    patch = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 2.0], [0.0, 0.0, 2.0]])
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    turn = np.eye(3)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn[j, j], turn[j, k], turn[k, j], turn[k, k] = c, -s, s, c
    rotation = best_rotation(patch, patch @ turn.T + [3.0, -1.0, 2.0])
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
    assert angle_about(rotation, axis) == pytest.approx(degrees, abs=1e-9)
    assert angle_about(rotation, f"-{axis}") == pytest.approx(-degrees, abs=1e-9)


def test_turns_are_counted() -> None:
    assert unwrap(-170.0, 175.0) == 190.0
    assert unwrap(10.0, 365.0) == 370.0
    assert unwrap(10.0, 0.0) == 10.0
