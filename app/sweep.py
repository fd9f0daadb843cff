"""A motion run for every combination of the values of some keys, in parallel processes."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flexapod.app.case import LoadedCase, package_version
from flexapod.app.motion_model import Say, start_shape
from flexapod.app.outputs import ResultsFolder, peak_memory
from flexapod.app.pool import (
    BAD_INPUT,
    Job,
    Outcome,
    Task,
    clear_runs,
    drive,
    with_values,
)
from flexapod.app.search import split_quantity
from flexapod.app.spec_sweep import SweepOverSpec, SweepSpec, Value
from flexapod.core.errors import InputError, SolverError, Status

# Keys of the body: a start shape is of that body, so each run makes its own.
_OF_THE_START = ("mesh", "material", "mass", "start")


def combinations(spec: SweepSpec) -> list[dict[str, Value]]:
    """All combinations of the keys' values; the last key changes fastest."""
    keys = [item.key for item in spec.over]
    return [
        dict(zip(keys, values, strict=True))
        for values in itertools.product(*(item.values for item in spec.over))
    ]


def column(item: SweepOverSpec) -> tuple[str, list[float | str]]:
    """Head of a key in curve.csv and its values there.

    Numbers, and quantities of one unit, as numbers (``interval_s``); the rest as texts.
    """
    name = item.key.rpartition(".")[2]
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in item.values):
        return name, [float(v) for v in item.values]
    with_units: list[tuple[float, str]] = []
    for value in item.values:
        try:
            with_units.append(split_quantity(str(value), item.key))
        except InputError:
            break
    units = {unit for _, unit in with_units}
    if len(with_units) == len(item.values) and len(units) == 1:
        unit = re.sub(r"[^A-Za-z0-9]+", "_", units.pop()).strip("_")
        return f"{name}_{unit}" if unit else name, [number for number, _ in with_units]
    return name, [str(value) for value in item.values]


def nested(spec: SweepSpec, found: Mapping[tuple[str, ...], float | None]) -> dict[str, Any]:
    """Results by the first key's values, in these by the second's, and so on."""
    table: dict[str, Any] = {}
    for values in combinations(spec):
        path = tuple(str(value) for value in values.values())
        here = table
        for part in path[:-1]:
            here = here.setdefault(part, {})
        here[path[-1]] = found.get(path)
    return table


class _Sweep:
    """The runs of a sweep and what came out of them."""

    def __init__(self, loaded: LoadedCase, out: Path) -> None:
        spec = loaded.case.sweep
        assert spec is not None
        self.loaded, self.spec = loaded, spec
        own_start = any(item.key.split(".")[0].strip() in _OF_THE_START for item in spec.over)
        shared = loaded.case.start is not None and not own_start
        self.start_at = out if shared else None
        self.values = combinations(spec)
        width = max(4, len(str(len(self.values))))
        self.jobs = [
            Job(
                with_values(loaded, dict(values)),
                loaded.source,
                loaded.folder,
                out / "runs" / f"{k + 1:0{width}d}",
                ", ".join(f"{key} = {value}" for key, value in values.items()),
                keep=spec.keep,
                start_at=self.start_at,
            )
            for k, values in enumerate(self.values)
        ]
        for job in self.jobs:
            _ = job.loaded  # a value that a case may not have is refused before anything runs
        self.outcomes: dict[int, Outcome] = {}
        columns = [column(item) for item in spec.over]
        names = [name for name, _ in columns]
        # Two keys may end alike: contact.0.friction and contact.1.friction.
        heads = [
            name if names.count(name) == 1 else f"{name}_{k + 1}" for k, name in enumerate(names)
        ]
        self.numbers = [
            dict(zip(heads, row, strict=True))
            for row in itertools.product(*(numbers for _, numbers in columns))
        ]

    def task(self, k: int) -> Task:
        """One run."""
        yield self.jobs[k]

    def value(self, k: int) -> float | None:
        """The result swept, of a run that reached its end."""
        outcome = self.outcomes.get(k)
        if outcome is None or not outcome.done:
            return None
        if self.spec.of not in outcome.results:
            known = [n for n, v in outcome.results.items() if isinstance(v, int | float)]
            raise InputError(
                f'a run has no result "{self.spec.of}"; its results are {", ".join(known)}',
                f"{self.loaded.source}: sweep.of",
            )
        value = outcome.results[self.spec.of]
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value)

    def row(self, k: int) -> dict[str, float | str]:
        """A row of curve.csv."""
        value, balance = self.value(k), self.outcomes[k].results.get("energy_balance")
        return {
            "run": float(k + 1),
            **self.numbers[k],
            self.spec.of: math.nan if value is None else value,
            "done": float(self.outcomes[k].done),
            "energy_balance": math.nan if balance is None else float(balance),
        }

    def results(self) -> dict[str, Any]:
        """What summary.json says."""
        found = {
            tuple(str(value) for value in values.values()): self.value(k)
            for k, values in enumerate(self.values)
        }
        ended = sorted(self.outcomes)
        failures = {
            self.jobs[k].label: f"{self.outcomes[k].status}: {self.outcomes[k].message}"
            for k in ended
            if not self.outcomes[k].done
        }
        return {
            self.spec.result: nested(self.spec, found),
            "runs": len(self.jobs),
            "runs_done": len(ended) - len(failures),
            "failures": failures,
            "states": len(ended),
        }


def run_sweep(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Run all combinations of `[sweep]` into ``runs/0001`` and so on, and collect one result.

    A run that fails is kept with its status and the others go on. A sweep that goes on repeats
    no run that reached its end.

    Raises
    ------
    InputError
        A combination is no valid case, no run could begin, or the result swept does not exist.
    """
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted

    began = time.perf_counter()
    sweep = _Sweep(loaded, out)
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    if not resume:
        clear_runs(out / "runs")
    status, message = Status.DONE, ""
    count = len(sweep.jobs)

    def finished(job: Job, outcome: Outcome) -> None:
        k = sweep.jobs.index(job)
        sweep.outcomes[k] = outcome
        write_rows(folder, [sweep.row(i) for i in sorted(sweep.outcomes)])
        if not outcome.done:
            say(f"{job.label}: {outcome.status}: {outcome.message}")
        for text in outcome.warnings:
            if text not in notices:
                notices.append(text)
                say(f"{job.label}: {text}")
        value = sweep.value(k)
        shown = {sweep.spec.of: math.nan if value is None else value}
        progress(Progress(len(sweep.outcomes) / count, job.label, shown, True))

    with terminated_like_interrupted():
        try:
            if sweep.start_at is not None:
                start_shape(loaded, out, resume, say)
            say(f"{count} runs")
            drive([sweep.task(k) for k in range(count)], sweep.spec.jobs, finished, resume)
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
            message = f"stopped by the user after {len(sweep.outcomes)} of {count} runs"
    failed = [outcome for outcome in sweep.outcomes.values() if not outcome.done]
    if status is Status.DONE:
        if len(failed) == count:
            if failed[0].status == BAD_INPUT:
                raise InputError(failed[0].message)
            status = Status[failed[0].status.upper()]
        fine = f"{count} runs" if count > 1 else "the run"
        message = f"{fine} reached the end of the motion"
        if failed:
            message = f"{len(failed)} of {count} runs failed; the first: {failed[0].message}"
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": status.name.lower(),
        "message": message,
        "version": package_version(),
        "elements": 0,
        "nodes": 0,
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "resumed": resume,
        "results": sweep.results(),
        "reference": None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return status, message, summary


def write_rows(folder: ResultsFolder, rows: Sequence[Mapping[str, float | str]]) -> None:
    """Make these the rows of curve.csv, in their order and not in that in which runs ended."""
    folder.rows = [dict(row) for row in rows[:-1]]
    folder.write_row(rows[-1])


__all__ = ["column", "combinations", "nested", "run_sweep", "write_rows"]
