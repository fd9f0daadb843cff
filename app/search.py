"""Bisection for the value of one key at which a body begins to move away."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.case import LoadedCase, apply_setting, package_version, parse_case
from flexapod.app.motion_model import (
    Motion,
    Say,
    Shape,
    assemble_motion,
    centre,
    restored_state,
    scaled_arrays,
    settled_shape,
    start_shape,
)
from flexapod.app.outputs import ResultsFolder, beside_paper, peak_memory
from flexapod.core.errors import InputError, SolverError, Status

if TYPE_CHECKING:
    from flexapod.dynamics.model import Model, State


class _Gone(Exception):
    """The body's centre has passed the distance that counts."""


class _Rests(Exception):
    """The body has come to rest."""


# Durations a calm trial may take until it is decided: near the threshold a damped body is as slow
# as one likes, and one that still creeps does not stay.
PATIENCE = 4

# Time [s] for which the centre must be slow to count as at rest: a body that rocks stands still for
# a moment at each end of its way, and one that lacks little to stay takes its time to get going.
REST_TIME = 0.25


def split_quantity(text: str, where: str) -> tuple[float, str]:
    """Number and unit of a text such as "12.7 deg"."""
    number, _, unit = text.strip().partition(" ")
    try:
        return float(number), unit.strip()
    except ValueError:
        raise InputError(f'must be a number with its unit, got "{text}"', where) from None


def with_value(loaded: LoadedCase, key: str, text: str) -> LoadedCase:
    """The case with one key set, checked anew."""
    table = loaded.case.model_dump(mode="json", by_alias=True, exclude_none=True)
    table.pop("search", None)
    apply_setting(table, f'{key}="{text}"')
    return LoadedCase(parse_case(table, loaded.source), loaded.source, loaded.folder)


@dataclasses.dataclass(frozen=True)
class Range:
    """Where is searched, in `unit`."""

    low: float
    high: float
    tolerance: float
    unit: str

    @classmethod
    def of(cls, loaded: LoadedCase) -> Range:
        spec = loaded.case.search
        assert spec is not None
        where = f"{loaded.source}: search"
        climb = spec.goal == "climb"  # where slopes may be negative: up towards +x
        low, unit = split_quantity(spec.low, f"{where}.low")
        high, other = split_quantity(spec.high, f"{where}.high")
        tolerance, third = split_quantity(spec.tolerance, f"{where}.tolerance")
        if not unit == other == third:
            raise InputError(
                f"low, high and tolerance need one unit, got {unit}, {other}, {third}", where
            )
        if not (low < high or (climb and low > high)) or not tolerance > 0.0:
            raise InputError("needs low < high and tolerance > 0", where)
        if climb and min(low, high) < 0.0 and max(low, high) >= 0.0:
            raise InputError(
                "a slope that rises towards +x is negative: begin with a small one of that sign, "
                f"such as -1 {unit}",
                where,
            )
        for value in (low, high):
            with_value(loaded, spec.key, f"{value:.10g} {unit}")
        return cls(low, high, tolerance, unit)

    def text(self, value: float) -> str:
        return f"{value:.10g} {self.unit}"


class _Trials:
    """One motion per value, from the settled start shape.

    A value of gravity needs no new model, and the body need not be disturbed: each trial goes on
    from where it rested at the highest value it stayed at, and the new value is eased on.
    """

    def __init__(
        self,
        loaded: LoadedCase,
        start: Any,
        low: float,
        text: Callable[[float], str],
        say: Say,
        kept: tuple[dict[str, np.ndarray], dict[str, Any]] | None,
    ) -> None:
        spec = loaded.case.search
        assert spec is not None
        self.loaded, self.spec, self.start, self.text = loaded, spec, start, text
        self.goes_on = spec.key.split(".")[0] == "gravity"
        self.rested = low  # value at which `state` rests
        self.notices: list[str] = []  # trials that time decided
        self.motion: Motion | None = None
        self.begin: np.ndarray | None = None
        self.shape: Shape | None = None
        if self.goes_on:
            first = with_value(loaded, spec.key, text(low))
            going_on = kept is not None and "state" in kept[1]
            self.motion = assemble_motion(first, start, say, settle=not going_on)
            self.state = self.motion.state
            if kept is not None and going_on:
                self._restore(*kept)
        else:
            self.shape = settled_shape(loaded, start, say)

    def run(
        self, value: float, tell: Callable[[float, dict[str, float]], None]
    ) -> dict[str, float]:
        """Row of the trial at `value`; `tell` hears the time's share and the row so far."""
        from flexapod.dynamics.integrator import Options, march
        from flexapod.dynamics.model import State
        from flexapod.dynamics.workspace import Workspace

        case = with_value(self.loaded, self.spec.key, self.text(value)).case
        assert case.dynamics is not None
        run = case.dynamics
        if self.motion is None:
            loaded = LoadedCase(case, self.loaded.source, self.loaded.folder)
            motion = assemble_motion(loaded, self.start, lambda text: None, settled=self.shape)
            model, state = motion.model, motion.state
            begin, before, ease = centre(model, state), model.gravity, 0.0
        else:
            assert case.gravity is not None
            model, ease = self.motion.model, self.spec.ease
            state = State.from_arrays(*self.state.to_arrays())
            if self.begin is None:
                self.begin = centre(model, state)
            begin, before = self.begin, self._gravity(self.rested)
            model.gravity = before  # and not what the last trial ended with
        after = model.gravity if self.motion is None else self._gravity(value)
        watch = _Watch(model, begin, self.spec.distance, self.spec.rest_speed, run.interval)

        def interval_done(state: State) -> None:
            if ease > 0.0:
                eased = min(1.0, state.time / ease)
                model.gravity = before + eased * eased * (3.0 - 2.0 * eased) * (after - before)
            share = min(1.0, state.time / run.duration)
            tell(share, {"value": value, **watch.row(state.time)})
            watch.look(state, eased=state.time >= ease)

        gone = 0.0
        calm = self.motion is not None
        try:
            march(
                model,
                state,
                Workspace(model),
                (PATIENCE if calm else 1) * round(run.duration / run.interval),
                Options(run.interval, run.safety, run.time_step),
                interval_done=interval_done,
            )
            if calm:
                self.notices.append(
                    f"at {self.text(value)} it neither rested nor was gone after {state.time:.3g} "
                    f"s, {1e3 * watch.way:.3g} mm and at {1e3 * watch.speed:.3g} mm/s: counted as "
                    "staying"
                )
        except _Rests:
            pass
        except _Gone:
            gone = 1.0
        time = state.time
        if self.motion is not None and not gone:
            state.begin_anew()
            self.state, self.rested = state, value
        return {"value": value, "gone": gone, **watch.row(time)}

    def _gravity(self, value: float) -> np.ndarray:
        case = with_value(self.loaded, self.spec.key, self.text(value)).case
        assert case.gravity is not None
        return np.array(case.gravity.tilted())

    def kept(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """What a checkpoint needs: the state at rest."""
        if self.motion is None:
            return {}, {}
        arrays, about = self.state.to_arrays()
        arrays = {**arrays, **scaled_arrays(self.motion.model)}
        if self.begin is not None:
            arrays = {**arrays, "begin": self.begin}
        return arrays, {"state": about, "rested": self.rested}

    def _restore(self, arrays: dict[str, np.ndarray], about: dict[str, Any]) -> None:
        assert self.motion is not None
        self.begin = arrays.pop("begin", None)
        self.state = restored_state(self.motion, arrays, about["state"], self.loaded.source)
        self.rested = about["rested"]


class _Watch:
    """Looks after each interval whether the body is gone or at rest."""

    def __init__(
        self, model: Model, begin: np.ndarray, distance: float, rest: float, interval: float
    ) -> None:
        self.model, self.begin = model, begin
        self.distance, self.rest, self.interval = distance, rest, interval
        self.way = self.speed = 0.0
        self.before: np.ndarray | None = None
        self.slow = 0

    def row(self, time: float) -> dict[str, float]:
        """Columns at `time` [s]."""
        return {"distance_mm": 1e3 * self.way, "time_s": time, "speed_m_s": self.speed}

    def look(self, state: State, eased: bool) -> None:
        """Raise `_Gone` or `_Rests` where the trial is decided; no rest before it has `eased`."""
        now = centre(self.model, state)
        # Along the map: a body that is set down also sinks in a little.
        self.way = float(np.linalg.norm((now - self.begin)[:2]))
        last = now if self.before is None else self.before
        self.speed = float(np.linalg.norm(now - last)) / self.interval
        moved = self.before is not None
        self.before = now
        if self.way > self.distance:
            raise _Gone
        self.slow = self.slow + 1 if eased and moved and self.speed < self.rest else 0
        if self.slow * self.interval >= REST_TIME * (1.0 - 1e-9):
            raise _Rests


def run_search(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Bisect `search.key` between its bounds; one row of curve.csv per trial.

    The start shape is computed and settled once, for all trials. A run that goes on takes over
    the trials that are done.
    """
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted

    began = time.perf_counter()
    spec, moving = loaded.case.search, loaded.case.dynamics
    assert spec is not None and moving is not None
    range_ = Range.of(loaded)
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    done: dict[float, dict[str, float]] = {}
    kept = folder.read_checkpoint() if resume else None
    if kept is not None:
        done = {row["value"]: row for row in folder.rows}
    count = 2 + math.ceil(math.log2((range_.high - range_.low) / range_.tolerance))
    status, message = Status.DONE, "the search ended"
    bracket = [range_.low, range_.high]
    trials: _Trials | None = None

    def tell(share: float, row: dict[str, float]) -> None:
        text = f"{spec.key} = {range_.text(row['value'])}"
        trial = round(share * moving.duration / moving.interval)
        progress(Progress(min(1.0, len(folder.rows) / count), text, row, trial % 20 == 0))

    def keep() -> None:
        assert trials is not None
        arrays, about = trials.kept()
        folder.write_checkpoint(arrays, {**about, "trials": len(folder.rows)})

    def goes(value: float) -> bool:
        row = done.get(value)
        if row is None:
            assert trials is not None
            row = trials.run(value, tell)
            for notice in trials.notices:
                say(notice)
                notices.append(notice)
            trials.notices.clear()
            folder.write_row(row)
            keep()
        text = range_.text(value)
        say(
            f"{spec.key} = {text}: {'goes' if row['gone'] else 'stays'}, {row['distance_mm']:.3g} "
            f"mm in {row['time_s']:.3g} s, {1e3 * row['speed_m_s']:.3g} mm/s at the end"
        )
        progress(Progress(min(1.0, len(folder.rows) / count), f"{spec.key} = {text}", row, True))
        return bool(row["gone"])

    with terminated_like_interrupted():
        try:
            start = start_shape(loaded, out, resume, say)
            trials = _Trials(loaded, start, range_.low, range_.text, say, kept)
            keep()
            if goes(range_.low):
                status, message = (
                    Status.NOT_CONVERGED,
                    f"it goes at the low end, {spec.low}, already",
                )
            elif not goes(range_.high):
                status = Status.NOT_CONVERGED
                message = f"it stays at the high end, {spec.high}"
            else:
                while bracket[1] - bracket[0] > range_.tolerance * (1.0 + 1e-9):
                    middle = 0.5 * (bracket[0] + bracket[1])
                    bracket[1 if goes(middle) else 0] = middle
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status, message = Status.INTERRUPTED, "stopped by the user"
    found = status is Status.DONE
    size = (0, 0)
    if trials is not None and trials.motion is not None:
        size = trials.motion.size[:2]
    results = {
        spec.result: 0.5 * sum(bracket) if found else None,
        "bracket_low": bracket[0],
        "bracket_high": bracket[1],
        "unit": range_.unit,
        "states": len(folder.rows),
    }
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": status.name.lower(),
        "message": message,
        "version": package_version(),
        "elements": size[0],
        "nodes": size[1],
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "resumed": resume,
        "results": results,
        "paper": beside_paper(loaded.case.paper, results),
        "reference": None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return status, message, summary
