"""Sweeps: combinations, order, failures kept, resuming, and what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from flexapod.app import plots, pool
from flexapod.app.case import load_case, parse_case
from flexapod.app.pool import Job, Outcome, drive
from flexapod.app.run import Progress, run_case
from flexapod.app.spec_sweep import SweepOverSpec, SweepSpec
from flexapod.app.sweep import column, combinations, nested
from flexapod.core.errors import InputError, Status

# A soft block that falls freely for 20 ms, and far: nothing but its weight acts.
FALLING = """
[mesh]
builder = "pneunet"
units = 1
symmetry = "quarter"
size = "coarse"
[[material]]
use = "dragon-skin-20-sospider"
poisson = 0.45
[dynamics]
duration = "20 ms"
interval = "2 ms"
frames = 5
[gravity]
acceleration = ["0 m/s^2", "0 m/s^2", "-9.8 m/s^2"]
"""

SWEEP = """
[sweep]
of = "distance_m"
result = "fall"
jobs = {jobs}
[[sweep.over]]
key = "gravity.tilt"
values = ["0 deg", "30 deg"]
[[sweep.over]]
key = "dynamics.duration"
values = ["10 ms", "20 ms"]
"""


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


def _case(folder: Path, text: str) -> Path:
    path = folder / "case.toml"
    path.write_text(text)
    return path


def _rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open() as stream:
        return list(csv.DictReader(stream))


def _spec(*over: tuple[str, list[Any]]) -> SweepSpec:
    table = {"of": "a", "result": "b", "over": [{"key": k, "values": v} for k, v in over]}
    return SweepSpec.model_validate(table)


def test_combinations_in_the_order_written() -> None:
    spec = _spec(("x", ["B", "A"]), ("y", [2, 1]))
    assert [tuple(c.values()) for c in combinations(spec)] == [
        ("B", 2), ("B", 1), ("A", 2), ("A", 1)
    ]  # fmt: skip
    found = {("B", "2"): 1.0, ("B", "1"): 2.0, ("A", "2"): 3.0}
    assert nested(spec, found) == {"B": {"2": 1.0, "1": 2.0}, "A": {"2": 3.0, "1": None}}
    assert nested(_spec(("x", ["B"])), {("B",): 1.0}) == {"B": 1.0}


@pytest.mark.parametrize(
    ("key", "values", "head", "numbers"),
    [
        ("actuation.interval", ["0.2 s", "1 s"], "interval_s", [0.2, 1.0]),
        ("actuation.pattern", ["BF", "ABE"], "pattern", ["BF", "ABE"]),
        ("ring.nodes", [16, 32], "nodes", [16.0, 32.0]),
        ("a.length", ["1 mm", "1 cm"], "length", ["1 mm", "1 cm"]),
        ("a.rate", ["1 N s/m", "2 N s/m"], "rate_N_s_m", [1.0, 2.0]),
        ("a.on", [True, False], "on", ["True", "False"]),
    ],
)
def test_columns_of_keys(key: str, values: list[Any], head: str, numbers: list[Any]) -> None:
    item = SweepOverSpec.model_validate({"key": key, "values": values})
    assert column(item) == (head, numbers)


def test_a_sweep_in_processes_is_the_one_done_here(tmp_path: Path) -> None:
    for jobs in (1, 2):
        path = _case(tmp_path, FALLING + SWEEP.format(jobs=jobs))
        seen: list[Progress] = []
        out = tmp_path / f"{jobs}"
        result = run_case(load_case(str(path)), out, progress=seen.append)
        assert result.status is Status.DONE, result.message
        assert [p.fraction for p in seen] == [0.25, 0.5, 0.75, 1.0]
    text = (tmp_path / "1" / "curve.csv").read_text()
    assert (tmp_path / "2" / "curve.csv").read_text() == text
    rows = _rows(tmp_path / "1")
    assert [(row["tilt_deg"], row["duration_ms"]) for row in rows] == [
        ("0", "10"), ("0", "20"), ("30", "10"), ("30", "20")
    ]  # fmt: skip
    summary = json.loads((tmp_path / "2" / "summary.json").read_text())
    fall = summary["results"]["fall"]
    # s = g t^2 / 2; leapfrog is exact for a constant force from rest, and the CSV has 10 digits.
    for tilt in ("0 deg", "30 deg"):
        assert fall[tilt]["10 ms"] == pytest.approx(0.5 * 9.8 * 0.01**2, rel=1e-9)
        assert fall[tilt]["20 ms"] == pytest.approx(0.5 * 9.8 * 0.02**2, rel=1e-9)
    run = tmp_path / "2" / "runs" / "0003"
    assert sorted(p.name for p in run.iterdir()) == [
        "case.resolved.toml", "curve.csv", "summary.json"
    ]  # fmt: skip
    assert load_case(str(run / "case.resolved.toml")).case.gravity is not None
    assert len(_rows(run)) == 6


def test_a_run_that_fails_is_kept_and_the_others_go_on(tmp_path: Path) -> None:
    text = FALLING + SWEEP.format(jobs=1).split("[[sweep.over]]")[0]
    # The second step is far beyond the stable one; the last mesh cannot be built.
    over = '[[sweep.over]]\nkey = "dynamics.time_step"\nvalues = ["1 us", "1 ms"]\n'
    path = _case(tmp_path, text + over)
    said: list[str] = []
    result = run_case(load_case(str(path)), tmp_path / "r", say=said.append)
    assert result.status is Status.DONE
    results = result.summary["results"]
    assert results["fall"]["1 us"] == pytest.approx(0.5 * 9.8 * 0.02**2, rel=1e-9)
    assert results["fall"]["1 ms"] is None
    assert "is not stable" in results["failures"]["dynamics.time_step = 1 ms"]
    assert any("is not stable" in line for line in said)
    assert [row["done"] for row in _rows(tmp_path / "r")] == ["1", "0"]
    assert (results["runs"], results["runs_done"]) == (2, 1)


def test_where_no_run_can_begin_the_input_is_bad(tmp_path: Path) -> None:
    text = FALLING + SWEEP.format(jobs=1).split("[[sweep.over]]")[0]
    over = '[[sweep.over]]\nkey = "dynamics.time_step"\nvalues = ["1 ms"]\n'
    with pytest.raises(InputError, match="is not stable"):
        run_case(load_case(str(_case(tmp_path, text + over))), tmp_path / "r")


def test_a_sweep_goes_on_and_repeats_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load_case(str(_case(tmp_path, FALLING + SWEEP.format(jobs=1))))
    whole = run_case(loaded, tmp_path / "whole").summary["results"]["fall"]
    run = pool.run_job
    ran: list[str] = []

    def stop(job: Job) -> Outcome:
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(job.label)
        return run(job)

    monkeypatch.setattr(pool, "run_job", stop)
    broken = run_case(loaded, tmp_path / "r")
    assert broken.status is Status.INTERRUPTED
    assert broken.summary["results"]["states"] == 2
    ran.clear()
    rest = run_case(loaded, tmp_path / "r", resume=True)
    assert rest.status is Status.DONE
    assert ran == [
        "gravity.tilt = 30 deg, dynamics.duration = 10 ms",
        "gravity.tilt = 30 deg, dynamics.duration = 20 ms",
    ]
    assert rest.summary["results"]["fall"] == whole
    assert _rows(tmp_path / "r") == _rows(tmp_path / "whole")


def test_keep_keeps_frames(tmp_path: Path) -> None:
    text = FALLING + SWEEP.format(jobs=1).replace("[sweep]", "[sweep]\nkeep = true", 1)
    text = text.replace('["0 deg", "30 deg"]', '["0 deg"]').replace(
        '["10 ms", "20 ms"]', '["4 ms"]'
    )
    result = run_case(load_case(str(_case(tmp_path, text))), tmp_path / "r")
    assert result.status is Status.DONE
    assert len(list((tmp_path / "r" / "runs" / "0001" / "fields").glob("*.vtu"))) > 1


def test_an_earlier_sweeps_runs_are_removed(tmp_path: Path) -> None:
    path = _case(tmp_path, FALLING + SWEEP.format(jobs=1))
    run_case(load_case(str(path)), tmp_path / "r")
    (tmp_path / "r" / "runs" / "mine").mkdir()
    shorter = load_case(str(path), ['sweep.over.0.values=["0 deg"]'])
    run_case(shorter, tmp_path / "r")
    assert sorted(p.name for p in (tmp_path / "r" / "runs").iterdir()) == ["0001", "0002", "mine"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"gravity.tilt"', '"sweep.of"', "sweep.over.0.key: must name a key of the motion"),
        ('"30 deg"', '"30 kg"', "with gravity.tilt = 30 kg, dynamics.duration = 10 ms"),
        ('"gravity.tilt"', '"gravity.tlt"', "gravity.tlt: unknown key (did you mean tilt?)"),
        ('"gravity.tilt"', '"mesh.builder.a"', "mesh.builder is a value, not a table"),
        ('"dynamics.duration"', '"gravity.tilt"', "keys must differ; swept twice: gravity.tilt"),
        ('"distance_m"', '"distanc_m"', 'has no result "distanc_m"; its results are'),
        ("jobs = 1", "jobs = 0", "sweep.jobs: must be greater than or equal to 1; got 0"),
    ],
)
def test_refusals(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = FALLING + SWEEP.format(jobs=1).replace(old, new, 1)
    with pytest.raises(InputError) as error:
        run_case(load_case(str(_case(tmp_path, text))), tmp_path / "r")
    assert message in str(error.value)


def test_only_a_motion_is_swept() -> None:
    table = {
        "mesh": {"builder": "curl"},
        "material": [{"use": "dragon-skin-20-sospider"}],
        "gravity": {},
        "sweep": {"of": "a", "result": "b", "over": [{"key": "gravity.tilt", "values": ["1 deg"]}]},
    }
    with pytest.raises(InputError, match=r"only a case with \[dynamics\] has sweep"):
        parse_case(table, "x.toml")


def test_what_depends_on_earlier_runs_waits_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "run_job", lambda job: Outcome("done", job.label))
    heard: list[str] = []

    def task(name: str) -> pool.Task:
        for k in range(3):
            outcome = yield Job({}, "x", Path(), Path(), f"{name}{k}")
            assert outcome.message == f"{name}{k}"

    drive([task("a"), task("b")], 1, lambda job, outcome: heard.append(job.label), resume=False)
    assert heard == ["a0", "a1", "a2", "b0", "b1", "b2"]
