"""Bisection for the value of one key at which a body begins to move away."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.case import LoadedCase, apply_setting, package_version, parse_case
from flexapod.app.outputs import ResultsFolder, peak_memory
from flexapod.core.errors import InputError, SolverError, Status


class _Gone(Exception):
    """The body's centre has passed the distance that counts."""


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


def run_search(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Callable[[str], None],
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Bisect `search.key` between its bounds; one row of curve.csv per trial.

    The start shape is computed and settled once, for all trials. A run that goes on takes over
    the trials that are done.
    """
    from flexapod.app.motion_model import assemble_motion, settled_shape, start_shape
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted

    began = time.perf_counter()
    spec, moving = loaded.case.search, loaded.case.dynamics
    assert spec is not None and moving is not None
    where = f"{loaded.source}: search"
    low, unit = split_quantity(spec.low, f"{where}.low")
    high, other = split_quantity(spec.high, f"{where}.high")
    tolerance, third = split_quantity(spec.tolerance, f"{where}.tolerance")
    if not unit == other == third:
        raise InputError(
            f"low, high and tolerance need one unit, got {unit}, {other}, {third}", where
        )
    if not (low < high and tolerance > 0.0):
        raise InputError("needs low < high and tolerance > 0", where)
    for value in (low, high):
        with_value(loaded, spec.key, f"{value:.10g} {unit}")
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    done: dict[float, dict[str, float]] = {}
    if resume and (kept := folder.read_checkpoint()) is not None:
        done = {row["value"]: row for row in folder.rows}
        del kept
    status, message = Status.DONE, "the search ended"
    trials = 2 + int(np.ceil(np.log2((high - low) / tolerance)))

    def goes(value: float) -> bool:
        text = f"{value:.10g} {unit}"
        row = done.get(value)
        if row is None:
            case = with_value(loaded, spec.key, text)
            row = _trial(case, start, shape, value, spec.distance, say)
            folder.write_row(row)
            folder.write_checkpoint({}, {"trials": len(folder.rows)})
        say(f"{spec.key} = {text}: {'goes' if row['gone'] else 'stays'}")
        progress(Progress(min(1.0, len(folder.rows) / trials), f"{spec.key} = {text}", row, True))
        return bool(row["gone"])

    def _trial(
        case: LoadedCase, start: Any, shape: Any, value: float, distance: float, say: Any
    ) -> dict[str, float]:
        from flexapod.dynamics.integrator import Options, march

        assert case.case.dynamics is not None
        run = case.case.dynamics
        motion = assemble_motion(case, start, lambda text: None, settled=shape)
        model = motion.model
        begin: list[np.ndarray] = []
        way = [0.0, 0.0]

        def watch(state: Any) -> None:
            from flexapod.app.motion_model import centre

            now = centre(model, state)
            if not begin:
                begin.append(now)
            # Along the map: a body that is set down also sinks in a little.
            way[:] = [float(np.linalg.norm((now - begin[0])[:2])), state.time]
            if way[0] > distance:
                raise _Gone

        try:
            march(
                model,
                motion.state,
                motion.work,
                round(run.duration / run.interval),
                Options(run.interval, run.safety, run.time_step),
                interval_done=watch,
            )
            gone = 0.0
        except _Gone:
            gone = 1.0
        return {"value": value, "gone": gone, "distance_mm": 1e3 * way[0], "time_s": way[1]}

    bracket = [low, high]
    with terminated_like_interrupted():
        try:
            start = start_shape(loaded, out, resume, say)
            shape = settled_shape(loaded, start, say)
            if goes(low):
                status, message = (
                    Status.NOT_CONVERGED,
                    f"it goes at the low end, {spec.low}, already",
                )
            elif not goes(high):
                status = Status.NOT_CONVERGED
                message = f"it stays at the high end, {spec.high}"
            else:
                while bracket[1] - bracket[0] > tolerance * (1.0 + 1e-9):
                    middle = 0.5 * (bracket[0] + bracket[1])
                    bracket[1 if goes(middle) else 0] = middle
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status, message = Status.INTERRUPTED, "stopped by the user"
    found = status is Status.DONE
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
        "results": {
            spec.result: 0.5 * sum(bracket) if found else None,
            "bracket_low": bracket[0],
            "bracket_high": bracket[1],
            "unit": unit,
            "states": len(folder.rows),
        },
        "reference": None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return status, message, summary
