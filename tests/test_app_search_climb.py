"""The search for the steepest slope: bisection by pattern, what it keeps, how it goes on."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flexapod.app import plots, pool, search_climb
from flexapod.app.case import LoadedCase, load_case
from flexapod.app.pool import Job, Outcome
from flexapod.app.run import run_case
from flexapod.core.errors import InputError, Status

CLIMB = """
[ring]
nodes = 8
[actuation]
pattern = "ABE"
interval = "10 ms"
[dynamics]
duration = "20 ms"
interval = "5 ms"
frames = 2
[gravity]
[[contact]]
type = "ground"
surface = "shell"
slope = "20 deg"
[search]
goal = "climb"
key = "contact.0.slope"
low = "0 deg"
high = "32 deg"
tolerance = "2 deg"
distance = "20 mm"
patterns = ["BF", "BG"]
jobs = 1
"""

# What the patterns of the tests can climb [deg].
CAN = {"ABE": 21.0, "BF": 10.5, "BG": 3.0}


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


def _loaded(folder: Path, *settings: str, text: str = CLIMB) -> LoadedCase:
    path = folder / "climb.toml"
    path.write_text(text)
    return load_case(str(path), settings)


def _climbers(ran: list[str]) -> Callable[[Job], Outcome]:
    """Trials that climb 50 mm up to the slope their pattern can, and slip back 1 m beyond it."""

    def run(job: Job) -> Outcome:
        ran.append(job.label)
        case = job.loaded.case
        assert case.actuation is not None and case.actuation.pattern is not None
        (ground,) = case.contact
        assert ground.type == "ground"
        climbs = math.degrees(ground.slope) <= CAN[case.actuation.pattern] + 1e-9
        return Outcome("done", "", {"uphill_m": 0.05 if climbs else -1.0})

    return run


def test_each_pattern_has_its_own_slope(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []
    monkeypatch.setattr(pool, "run_job", _climbers(ran))
    result = run_case(_loaded(tmp_path), tmp_path / "r")
    assert result.status is Status.DONE, result.message
    results = json.loads((tmp_path / "r" / "summary.json").read_text())["results"]
    # The largest multiple of the tolerance that is climbed.
    assert results["steepest_slope_by_pattern"] == {"ABE": 20.0, "BF": 10.0, "BG": 2.0}
    assert results["steepest_slope_deg"] == 20.0
    assert results["search_unit"] == "deg"
    # Both ends, and four halvings of 32 degrees.
    assert len(ran) == 3 * 6
    assert len(results["trials"]) == 18
    assert {"pattern": "BF", "value": 12.0, "uphill_m": -1.0, "climbs": False} in results["trials"]
    # The motion itself was run as it is, with its rows, frames and pictures.
    assert results["time_s"] == pytest.approx(0.02)
    assert (tmp_path / "r" / "lines.pvd").is_file()
    assert (tmp_path / "r" / "plots" / "animation.gif").is_file()


def test_a_pattern_that_does_not_climb_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "run_job", _climbers([]))
    loaded = _loaded(tmp_path, "search.low=16 deg", "search.high=20 deg")
    result = run_case(loaded, tmp_path / "r")
    results = result.summary["results"]
    # The case's own pattern climbs everything in the range: there is no steepest slope in it.
    assert result.status is Status.NOT_CONVERGED
    assert "ABE climbs at 20 deg" in result.message
    assert results["steepest_slope_deg"] is None
    assert results["search_notes"]["BF"] == "does not climb at 16 deg"


def test_a_trial_that_fails_ends_its_pattern_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _climbers([])

    def fail(job: Job) -> Outcome:
        return Outcome("not_finite", "no number") if "BG" in job.label else run(job)

    monkeypatch.setattr(pool, "run_job", fail)
    result = run_case(_loaded(tmp_path), tmp_path / "r")
    assert result.status is Status.DONE
    results = result.summary["results"]
    assert results["steepest_slope_by_pattern"] == {"ABE": 20.0, "BF": 10.0, "BG": None}
    assert results["search_notes"] == {"BG": "not_finite at 0 deg: no number"}


def test_what_slides_down_and_fails_then_did_not_climb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A body that falls through the ground metres downhill; nearer than the distance none knows."""
    ran: list[str] = []
    run = _climbers(ran)

    def fall(job: Job) -> Outcome:
        outcome = run(job)
        slid = outcome.results["uphill_m"] < 0.0
        return Outcome("fell_through", "too deep", {"uphill_m": -0.03}) if slid else outcome

    monkeypatch.setattr(pool, "run_job", fall)
    result = run_case(_loaded(tmp_path), tmp_path / "r")
    assert result.status is Status.DONE, result.message
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())["results"]
    assert summary["steepest_slope_by_pattern"]["BF"] == 10.0
    trials = [t for t in summary["trials"] if t["pattern"] == "BF" and t["value"] == 32.0]
    assert trials == [{"pattern": "BF", "value": 32.0, "uphill_m": -0.03, "climbs": False}]


def test_trials_are_motions_that_are_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Real trials: in 20 ms nothing moves 20 mm, but 0.01 mm uphill is less than the ring sags.
    settings = ("search.patterns=[]", "search.distance=0.1 m", "search.low=0 deg")
    loaded = _loaded(tmp_path, *settings)
    ran: list[str] = []
    run = pool.run_job

    def counted(job: Job) -> Outcome:
        ran.append(job.label)
        return run(job)

    monkeypatch.setattr(pool, "run_job", counted)
    first = run_case(loaded, tmp_path / "r")
    assert first.status is Status.NOT_CONVERGED
    assert "ABE does not climb at 0 deg" in first.message
    assert (tmp_path / "r" / "trials" / "ABE_0" / "summary.json").is_file()
    again = run_case(loaded, tmp_path / "r", resume=True)
    assert ran == ["ABE at 0 deg"]
    assert again.summary["results"]["trials"] == first.summary["results"]["trials"]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("search.patterns=['BX']", "with BX at 0 deg: actuation.pattern: it names X"),
        ("search.goal=threshold", 'patterns and jobs belong to goal = "climb"'),
        ("search.high=10 kg", "low, high and tolerance need one unit"),
        ("search.key=ring.mass", "search.key must begin with contact, gravity or dynamics"),
        ("actuation={table={A=[['0 s','9 ms']]}}", "search.patterns: needs [actuation] with a pat"),
        ("sweep={of='a',result='b',over=[{key='ring.nodes',values=[8]}]}", "a case has one of"),
    ],
)
def test_refusals(tmp_path: Path, setting: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        run_case(_loaded(tmp_path, setting), tmp_path / "r")
    assert message in str(error.value)


def test_without_a_pattern_the_case_stands_for_itself(tmp_path: Path) -> None:
    text = CLIMB.replace('patterns = ["BF", "BG"]\n', "").replace(
        'pattern = "ABE"\ninterval = "10 ms"', "table = { A = [['0 s', '9 ms']] }"
    )
    climbs: Any = search_climb._Climbs(_loaded(tmp_path, text=text), tmp_path)
    assert climbs.patterns == [search_climb.OWN]
    assert climbs.job(search_climb.OWN, 4.0).table["contact"][0]["slope"] == "4 deg"
