"""The steepest slope a body climbs, by bisection, for several patterns of its coils at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexapod.app.case import LoadedCase
from flexapod.app.motion import run_motion
from flexapod.app.motion_model import Say
from flexapod.app.outputs import ResultsFolder, beside_paper
from flexapod.app.pool import Job, Outcome, Task, clear_runs, drive, with_values
from flexapod.app.search import Range
from flexapod.core.errors import Status

# Name of the case's own motion where it has no pattern.
OWN = "own"


class _Climbs:
    """Bisections of one key, one for each pattern; a trial is a whole motion."""

    def __init__(self, loaded: LoadedCase, out: Path) -> None:
        spec, actuation = loaded.case.search, loaded.case.actuation
        assert spec is not None
        self.loaded, self.spec, self.out = loaded, spec, out
        self.range = Range.of(loaded)
        self.own = OWN if actuation is None or actuation.pattern is None else actuation.pattern
        self.patterns = list(dict.fromkeys([self.own, *spec.patterns]))
        self.start_at = out if loaded.case.start is not None else None
        self.steepest: dict[str, float | None] = dict.fromkeys(self.patterns)
        self.notes: dict[str, str] = {}
        self.trials: dict[str, dict[float, dict[str, Any]]] = {p: {} for p in self.patterns}
        for pattern in self.patterns:
            _ = self.job(pattern, self.range.low).loaded  # refused before anything runs

    @property
    def count(self) -> int:
        """Trials at most."""
        width = abs(self.range.high - self.range.low) / self.range.tolerance
        return len(self.patterns) * (2 + max(0, math.ceil(math.log2(width))))

    @property
    def done(self) -> int:
        """Trials so far."""
        return sum(len(trials) for trials in self.trials.values())

    def job(self, pattern: str, value: float) -> Job:
        """The motion with a pattern at a value of the key."""
        text = self.range.text(value)
        values: dict[str, Any] = {self.spec.key: text}
        if pattern != OWN:
            values["actuation.pattern"] = pattern
        return Job(
            with_values(self.loaded, values),
            self.loaded.source,
            self.loaded.folder,
            self.out / "trials" / f"{pattern}_{value:.10g}",
            f"{pattern} at {text}",
            start_at=self.start_at,
        )

    def bisect(self, pattern: str) -> Task:
        """Trials of one pattern: both ends, then the middle of what is left."""
        low, high = self.range.low, self.range.high
        for end, wanted in ((low, True), (high, False)):
            outcome = yield self.job(pattern, end)
            climbs = self.note(pattern, end, outcome)
            if climbs is None:
                return
            if climbs is not wanted:
                word = "climbs" if climbs else "does not climb"
                self.notes[pattern] = f"{word} at {self.range.text(end)}"
                return
        while abs(high - low) > self.range.tolerance * (1.0 + 1e-9):
            middle = 0.5 * (low + high)
            outcome = yield self.job(pattern, middle)
            climbs = self.note(pattern, middle, outcome)
            if climbs is None:
                return
            low, high = (middle, high) if climbs else (low, middle)
        self.steepest[pattern] = abs(low)

    def note(self, pattern: str, value: float, outcome: Outcome) -> bool | None:
        """Keep a trial; whether it climbed, or None where it did not reach its end.

        What has slid down as far as it should have climbed did not climb, whatever stopped it then.
        """
        way = float(outcome.results.get("uphill_m", math.nan))
        if not outcome.done and not way <= -self.spec.distance:
            self.notes[pattern] = f"{outcome.status} at {self.range.text(value)}: {outcome.message}"
            return None
        climbs = way >= self.spec.distance
        self.trials[pattern][value] = {"uphill_m": way, "climbs": climbs}
        return climbs

    def results(self) -> dict[str, Any]:
        """What summary.json says beside the motion's own results."""
        return {
            self.spec.result: self.steepest[self.own],
            "steepest_slope_by_pattern": dict(self.steepest),
            "search_unit": self.range.unit,
            "search_tolerance": self.range.tolerance,
            "search_notes": dict(self.notes),
            "trials": [
                {"pattern": pattern, "value": value, **trial}
                for pattern, trials in self.trials.items()
                for value, trial in sorted(trials.items())
            ],
        }


def run_climb(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Run the motion as it is, then seek the highest value at which it still climbs.

    A trial climbs if its centre has come `search.distance` uphill by the end of the duration. The
    value found is one that was climbed; the next one tried, within the tolerance, was not. That a
    body that fails on a slope fails on all steeper ones is taken for granted.
    """
    import dataclasses

    from flexapod.app.run import Progress, terminated_like_interrupted

    climbs = _Climbs(loaded, out)
    share = 1.0 / (1 + climbs.count)

    def of_motion(step: Progress) -> None:
        progress(dataclasses.replace(step, fraction=share * step.fraction))

    status, message, summary = run_motion(loaded, out, resume, of_motion, say, notices)
    if status is not Status.DONE:
        return status, message, summary
    if not resume:
        clear_runs(out / "trials")

    def finished(job: Job, outcome: Outcome) -> None:
        way = float(outcome.results.get("uphill_m", math.nan))
        row = {"uphill_m": way}
        fraction = min(1.0, share * (1 + climbs.done + 1))
        ended = f"{1e3 * way:.3g} mm uphill" if outcome.done else outcome.status
        say(f"{job.label}: {ended}")
        progress(Progress(fraction, job.label, row, True))

    with terminated_like_interrupted():
        try:
            tasks = [climbs.bisect(pattern) for pattern in climbs.patterns]
            drive(tasks, climbs.spec.jobs, finished, resume)
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
            message = f"stopped by the user after {climbs.done} trials"
    if status is Status.DONE and climbs.steepest[climbs.own] is None:
        status, message = Status.NOT_CONVERGED, f"{climbs.own} {climbs.notes[climbs.own]}"
    summary["status"], summary["message"] = status.name.lower(), message
    summary["results"].update(climbs.results())
    summary["paper"] = beside_paper(loaded.case.paper, summary["results"])
    ResultsFolder(out).write_summary(summary)
    return status, message, summary


__all__ = ["OWN", "run_climb"]
