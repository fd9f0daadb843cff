"""Motions from case files: start shape, unfolding, rows, checkpoints, the search, refusals."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from flexapod.app import motion as motion_module
from flexapod.app import plots
from flexapod.app import search as search_module
from flexapod.app.case import load_case, parse_case
from flexapod.app.run import run_case
from flexapod.app.search import split_quantity, with_value
from flexapod.core.errors import InputError, Status
from flexapod.geometry.tagged import TaggedMesh, boundary_facets
from flexapod.geometry.unfold import unfold, unfold_shares, unfold_vectors

STATIC = """
[mesh]
builder = "pneunet"
units = 2
symmetry = "quarter"
size = "coarse"
[[material]]
use = "dragon-skin-20-sospider"
poisson = 0.45
[[support]]
surface = "symmetry_x"
directions = ["x", "z"]
[[support]]
surface = "symmetry_y"
directions = ["y"]
[[pressure]]
name = "inflation"
surface = "cavity_*"
value = "5 kPa"
[[step]]
name = "inflate"
loads = { inflation = 1.0 }
outputs = 1
"""

MOVING = """
[start]
case = "shape.toml"
unfold = ["x"]
settle = "1 ms"
[dynamics]
duration = "20 ms"
interval = "2 ms"
frames = 5
checkpoint = 2
[gravity]
[[support]]
surface = "symmetry_y"
directions = ["y"]
[[pressure]]
name = "inflation"
surface = "cavity_*"
value = "5 kPa"
[[contact]]
type = "ground"
surface = "outer"
slope = "10 deg"
[[contact]]
type = "self"
surface = "chamber_faces"
[[probe]]
type = "track"
name = "tip"
surface = "end"
"""


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


@pytest.fixture
def case(tmp_path: Path) -> Path:
    (tmp_path / "shape.toml").write_text(STATIC)
    (tmp_path / "move.toml").write_text(MOVING)
    return tmp_path / "move.toml"


def _rows(folder: Path) -> list[dict[str, float]]:
    with (folder / "curve.csv").open() as stream:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]


def test_a_motion_writes_what_it_promises(case: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run_case(load_case(str(case)), out)
    assert result.status is Status.DONE
    rows = _rows(out)
    assert len(rows) == 11  # every interval's start, and the end
    assert [row["time_s"] for row in rows] == pytest.approx(np.linspace(0.0, 0.02, 11))
    assert len(list((out / "fields").glob("*.vtu"))) == 6
    summary = json.loads((out / "summary.json").read_text())
    assert {"distance_m", "peak_speed_m_s", "turns", "energy_balance"} <= summary["results"].keys()
    assert summary["results"]["energy_balance"] < 1e-3
    for name in ("curve.png", "energy.png", "contact.png", "snapshots.png", "animation.gif"):
        assert (out / "plots" / name).stat().st_size > 1000, name
    # It is set down on its lowest node: within a few milliseconds faces bear weight.
    assert rows[5]["ground_0_force_N"] > 0.0
    # The resolved case can be run again, from where it lies.
    again = load_case(str(out / "case.resolved.toml"))
    assert again.case.dynamics == load_case(str(case)).case.dynamics


def test_a_killed_motion_goes_on_to_the_same_bits(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load_case(str(case))
    run_case(loaded, tmp_path / "whole")
    record = motion_module.Recorder.record

    def stop(self: object, state: object) -> None:
        record(self, state)  # type: ignore[arg-type]
        if state.interval == 7:  # type: ignore[attr-defined]
            raise KeyboardInterrupt

    monkeypatch.setattr(motion_module.Recorder, "record", stop)
    broken = run_case(loaded, tmp_path / "broken")
    assert broken.status is Status.INTERRUPTED
    with h5py.File(tmp_path / "broken" / "checkpoint.h5") as file:
        kept = json.loads(file.attrs["about"])["recorder"]["stats"]
    assert kept["steps"] > 0
    monkeypatch.setattr(motion_module.Recorder, "record", record)
    # One of a version whose contacts remember less.
    shutil.copytree(tmp_path / "broken", tmp_path / "old")
    with h5py.File(tmp_path / "old" / "checkpoint.h5", "r+") as file:
        del file["state/history0.depth"]
    with pytest.raises(InputError, match="of another version of flexapod"):
        run_case(loaded, tmp_path / "old", resume=True)
    assert run_case(loaded, tmp_path / "broken", resume=True).status is Status.DONE
    states = []
    for name in ("whole", "broken"):
        with h5py.File(tmp_path / name / "checkpoint.h5") as file:
            states.append({key: np.asarray(value) for key, value in file["state"].items()})
    assert states[0].keys() == states[1].keys()
    for key, value in states[0].items():
        assert np.array_equal(value, states[1][key], equal_nan=True), key
    assert _rows(tmp_path / "whole") == _rows(tmp_path / "broken")
    # What the run cost is that of both sittings.
    whole, resumed = (
        json.loads((tmp_path / name / "summary.json").read_text())["results"]
        for name in ("whole", "broken")
    )
    for key in ("steps", "smallest_step_us", "largest_step_us", "deepest_penetration_mm"):
        assert whole[key] == resumed[key], key
    assert resumed["motion_time_s"] > sum(kept["clock"]["seconds"].values())
    assert sum(resumed["time_share"].values()) == pytest.approx(1.0, rel=1e-12)  # round-off
    assert resumed["time_share"].keys() >= {"element_forces", "contact_search", "contact_forces"}


SEARCH = """
[search]
key = "contact.0.slope"
low = "1 deg"
high = "41 deg"
tolerance = "20 deg"
distance = "0.4 mm"
"""


def test_a_search_brackets_the_slope_at_which_the_body_slides(case: Path, tmp_path: Path) -> None:
    case.write_text(case.read_text().replace("slope", "friction = 0.3\nslope") + SEARCH)
    result = run_case(load_case(str(case)), tmp_path / "out")
    assert result.status is Status.DONE
    rows = _rows(tmp_path / "out")
    assert [row["value"] for row in rows] == [1.0, 41.0, 21.0]
    assert [row["gone"] for row in rows[:2]] == [0.0, 1.0]
    results = result.summary["results"]
    assert results["bracket_high"] - results["bracket_low"] == 20.0
    assert results["threshold_deg"] == 0.5 * (results["bracket_low"] + results["bracket_high"])
    assert (tmp_path / "out" / "plots" / "curve.png").is_file()
    # A search that goes on takes over what is done.
    again = run_case(load_case(str(case)), tmp_path / "out", resume=True)
    assert again.summary["results"]["threshold_deg"] == results["threshold_deg"]
    assert len(_rows(tmp_path / "out")) == 3


def test_a_search_that_tilts_gravity_goes_on_from_where_the_body_rested(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = case.read_text().replace('slope = "10 deg"', "friction = 0.3")
    search = SEARCH.replace("contact.0.slope", "gravity.tilt").replace('"20 deg"', '"5 deg"')
    case.write_text(text.replace("[gravity]", "[gravity]\n") + search + 'ease = "4 ms"\n')
    # It is not damped, so that it never rests; given time it swings by the distance.
    monkeypatch.setattr(search_module, "PATIENCE", 1)
    whole = run_case(load_case(str(case)), tmp_path / "whole")
    assert whole.status is Status.DONE, whole.message
    results = whole.summary["results"]
    # It slides above atan 0.3 = 16.7 degrees; soft as it is, it leans by the distance a little
    # before: within the search's tolerance.
    assert results["bracket_high"] == results["bracket_low"] + 5.0
    assert results["threshold_deg"] == pytest.approx(16.7, abs=5.0)
    rows = _rows(tmp_path / "whole")
    assert [row["value"] for row in rows][:3] == [1.0, 41.0, 21.0]

    run, calls = search_module._Trials.run, [0]

    def stop(self: object, *args: object) -> object:
        calls[0] += 1
        if calls[0] == 3:
            raise KeyboardInterrupt
        return run(self, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(search_module._Trials, "run", stop)
    assert run_case(load_case(str(case)), tmp_path / "cut").status is Status.INTERRUPTED
    monkeypatch.setattr(search_module._Trials, "run", run)
    again = run_case(load_case(str(case)), tmp_path / "cut", resume=True)
    assert again.status is Status.DONE
    assert _rows(tmp_path / "cut") == rows
    assert "neither rested nor was gone" in whole.summary["warnings"][0]


def test_a_search_between_ends_that_agree_says_so(case: Path, tmp_path: Path) -> None:
    text = SEARCH.replace("41 deg", "2 deg")
    case.write_text(case.read_text() + text)
    result = run_case(load_case(str(case)), tmp_path / "out")
    assert result.status is Status.NOT_CONVERGED
    assert "stays at the high end" in result.message


def test_quantities_of_a_search() -> None:
    assert split_quantity("12.7 deg", "here") == (12.7, "deg")
    with pytest.raises(InputError, match="number with its unit"):
        split_quantity("steep", "here")


def test_with_value_sets_one_key(case: Path) -> None:
    other = with_value(load_case(str(case)), "contact.0.slope", "3 deg")
    assert other.case.contact[0].slope == pytest.approx(np.radians(3.0))  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("frames = 5", 'time_step = "1 ms"'), "not stable"),
        (('duration = "20 ms"', 'duration = "21 ms"'), "whole multiple"),
        (("[gravity]", '[[step]]\nname = "a"\nloads = { inflation = 1.0 }\n[gravity]'), "step"),
        (('type = "ground"', 'type = "plane"'), "ground"),
        (('case = "shape.toml"', 'case = "none.toml"'), "no such case"),
        (("[gravity]", "[solver]\ntolerance = 1e-4\n[gravity]"), "solver"),
        (
            ("[gravity]", '[[bond]]\nname = "a"\nsurfaces = ["x0", "x1"]\n' * 2 + "[gravity]"),
            "twice",
        ),
        (
            ('settle = "1 ms"', 'settle = "0 s"\n[[bond]]\nname = "a"\nsurfaces = ["x0", "x1"]'),
            "drawn together",
        ),
    ],
)
def test_refusals(case: Path, tmp_path: Path, change: tuple[str, str], words: str) -> None:
    case.write_text(case.read_text().replace(*change))
    with pytest.raises(InputError, match=words):
        run_case(load_case(str(case)), tmp_path / "out")


def test_what_moves_stands_only_in_a_motion() -> None:
    table = {
        "mesh": {"builder": "pneunet"},
        "material": [{"use": "dragon-skin-20-sospider"}],
        "gravity": {},
        "contact": [{"type": "ground", "surface": "outer"}],
    }
    with pytest.raises(InputError, match=r"only a case with \[dynamics\]"):
        parse_case(table, "here")


def _quarter() -> TaggedMesh:
    from statics_helpers import grid

    mesh = grid((3, 2, 2))
    groups = {**mesh.facet_groups, "end": mesh.facet_groups["x1"]}
    return TaggedMesh(
        mesh.nodes,
        mesh.cells,
        {"silicone": np.arange(12), "servo_0": np.array([11])},
        groups,
    )


def test_unfolding_gives_the_mirrored_whole() -> None:
    mesh = _quarter()
    whole, source = unfold(mesh, 0)
    assert len(whole.cells) == 24
    assert whole.nodes[:, 0].min() == -1.0
    # Volumes are positive and the boundary is closed: the mirrored cells are the right way round.
    a, b, d, e = (whole.nodes[whole.cells[:, k]] for k in (0, 1, 3, 4))
    assert (np.einsum("ij,ij->i", np.cross(b - a, d - a), e - a) > 0.0).all()
    assert len(boundary_facets(whole.cells)) == 2 * len(boundary_facets(mesh.cells)) - 2 * 4
    assert set(whole.facet_groups) >= {"end", "end_mirrored", "y0", "z1"}
    assert "x0" not in whole.facet_groups
    assert whole.nodes[whole.facet_groups["end_mirrored"]][..., 0].max() == -1.0
    assert len(whole.facet_groups["z1"]) == 2 * len(mesh.facet_groups["z1"])
    assert set(whole.cell_groups) == {"silicone", "servo_0", "servo_0_mirrored"}
    # Quads look outward: their normals point away from the whole's middle.
    for name in ("end", "end_mirrored", "z1", "y0"):
        quads = whole.facet_groups[name]
        p, q, s = (whole.nodes[quads[:, k]] for k in (0, 1, 3))
        outward = np.einsum("ij,ij->i", np.cross(q - p, s - p), p - [0.0, 0.5, 0.5])
        assert (outward > 0.0).all(), name
    u = unfold_vectors(mesh.nodes, source, len(mesh.nodes), 0)
    assert np.allclose(u, whole.nodes)
    shares = unfold_shares(np.ones(len(mesh.nodes)), source, len(mesh.nodes))
    assert shares.sum() == 2 * len(mesh.nodes)
    assert set(shares[whole.nodes[:, 0] == 0.0]) == {2.0}


def test_unfolding_needs_the_plane() -> None:
    mesh = _quarter()
    with pytest.raises(InputError, match="ends at the plane x = 0"):
        unfold(mesh.with_nodes(mesh.nodes + [0.5, 0.0, 0.0]), 0)


@pytest.mark.parametrize(("acceleration", "rests"), [(0.0, True), (0.002, True), (0.018, False)])
def test_a_body_that_begins_to_move_does_not_count_as_at_rest(
    acceleration: float, rests: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth of a degree too steep lets a wheel go at 0.018 m/s2: 1 mm/s after 0.06 s.

    At rest is what stays below 1 mm/s for 0.25 s, so what begins with less than 0.004 m/s2.
    """
    time = 0.0
    monkeypatch.setattr(
        search_module,
        "centre",
        lambda model, state: np.array([0.5 * acceleration * time**2, 0.0, 0.0]),
    )
    watch = search_module._Watch(None, np.zeros(3), 0.05, 1e-3, 0.005)  # type: ignore[arg-type]
    try:
        for k in range(100):
            time = 0.005 * k
            watch.look(None, eased=True)  # type: ignore[arg-type]
    except search_module._Rests:
        assert rests
        assert time == pytest.approx(0.25, abs=1e-9)
    else:
        assert not rests
