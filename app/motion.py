"""A motion from its case to its results folder: march, and what came of it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.case import LoadedCase, package_version
from flexapod.app.motion_flight import cycle_results, flight_results, marker_results
from flexapod.app.motion_model import Motion, Say, assemble_motion, start_shape, uphill
from flexapod.app.motion_recorder import MotionFolder, Recorder
from flexapod.app.motion_robot import robot_results, step_results
from flexapod.app.outputs import CHECKPOINT_FILE, beside_paper, peak_memory
from flexapod.core.errors import SolverError, Status

if TYPE_CHECKING:
    from flexapod.dynamics.model import State


def run_motion(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
    lean: bool = False,
    start_at: Path | None = None,
) -> tuple[Status, str, dict[str, Any]]:
    """Run a case with [dynamics]; returns status, message and summary, all files written.

    A `lean` run keeps its case, curve and summary only, as one of many. `start_at` is the folder
    whose ``start`` holds the start shape (default: `out`).
    """
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted
    from flexapod.dynamics.integrator import Options, march

    began = time.perf_counter()
    spec = loaded.case.dynamics
    assert spec is not None
    folder = MotionFolder.open(out, resolve(loaded, None), resume=resume)
    going_on = resume and (out / CHECKPOINT_FILE).is_file()
    with terminated_like_interrupted():
        try:
            # Names and laws are looked up before minutes are spent on the start shape.
            assemble_motion(loaded, None, lambda text: None, settle=False)
            start = start_shape(loaded, start_at or out, resume, say)
            motion = assemble_motion(loaded, start, say, settle=not going_on)
        except (KeyboardInterrupt, SolverError) as error:
            status = error.status if isinstance(error, SolverError) else Status.INTERRUPTED
            message = str(error) or "stopped by the user before the motion began"
            summary = _short_summary(loaded, out, began, status, message)
            folder.write_summary(summary)
            return status, message, summary
    for notice in motion.notices:
        say(notice)
        notices.append(notice)
    recorder = Recorder(motion.loaded or loaded, motion, folder, lean)
    cells, nodes, lines = motion.size
    parts = [f"{count} {name}" for count, name in ((cells, "hexahedra"), (lines, "lines")) if count]
    say(f"{', '.join(parts)}, {nodes} nodes")
    if resume and recorder.resume():
        say(f"going on from {motion.state.interval * spec.interval:.4g} s")
    elif resume:
        folder.clear()
    options = Options(spec.interval, spec.safety, spec.time_step)
    status, message = Status.DONE, "reached the end of the motion"

    def done(state: State) -> None:
        row = folder.rows[-1]
        progress(
            Progress(state.interval / recorder.intervals, "motion", row, state.interval % 20 == 0)
        )
        if state.interval % spec.checkpoint == 0 or state.interval == recorder.intervals:
            recorder.checkpoint(state)

    with terminated_like_interrupted():
        try:
            march(
                motion.model,
                motion.state,
                motion.work,
                recorder.intervals,
                options,
                recorder.record,
                done,
                recorder.stats,
            )
            _last_row(recorder)
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status, message = Status.INTERRUPTED, f"stopped at {motion.state.time:.4g} s"
    results = _results(recorder, motion)
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": status.name.lower(),
        "message": message,
        "version": package_version(),
        "elements": cells,
        "nodes": nodes,
        **({"lines": lines} if lines else {}),
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
    if lean:
        with contextlib.suppress(OSError):
            (out / "fields").rmdir()
    return status, message, summary


def _last_row(recorder: Recorder) -> None:
    """Forces and energies at the very end, without going on."""
    from flexapod.dynamics.integrator import last_record

    motion = recorder.motion
    last_record(motion.model, motion.state, motion.work, lambda: recorder.record(motion.state))


def _short_summary(
    loaded: LoadedCase, out: Path, began: float, status: Status, text: str
) -> dict[str, Any]:
    """Summary of a motion that never began."""
    return {
        "case": loaded.name,
        "status": status.name.lower(),
        "message": text,
        "version": package_version(),
        "elements": 0,
        "nodes": 0,
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "results": {"states": 0},
        "reference": None,
        "warnings": [],
        "folder": str(out),
    }


def _results(recorder: Recorder, motion: Motion) -> dict[str, Any]:
    rows, stats = recorder.folder.rows, recorder.stats
    last = rows[-1] if rows else {}
    results: dict[str, Any] = {**last, "states": len(recorder.folder.times)}
    if rows and recorder.centre_start is not None:
        now = np.array([last[f"centre_{axis}_mm"] for axis in "xyz"])
        results["distance_m"] = 1e-3 * float(np.linalg.norm(now - recorder.centre_start))
        results["peak_speed_m_s"] = max(row["speed_m_s"] for row in rows)
        results["turns"] = last["turn_deg"] / 360.0
        results["uphill_m"] = 1e-3 * float((now - recorder.centre_start) @ uphill(recorder.loaded))
        results["peak_acceleration_m_s2"] = max(row["centre_acceleration_m_s2"] for row in rows)
        worst = max(abs(row["unaccounted_J"]) for row in rows)
        results["energy_balance"] = worst / max(recorder.largest_energy, 1e-300)
        results["largest_energy_J"] = recorder.largest_energy
        # What is stored at rest flatters: the share of what changed says more.
        changes = [
            abs(row[head] - rows[0][head])
            for row in rows
            for head in (
                "kinetic_J",
                "strain_J",
                "weight_J",
                "pressure_work_J",
                "lines_J",
                "servo_work_J",
            )
            if head in row
        ]
        results["energy_balance_of_changes"] = worst / max(*changes, 1e-300)
        cycle = recorder.loaded.case.dynamics.cycle if recorder.loaded.case.dynamics else None
        if cycle is not None:
            results.update(cycle_results(rows, cycle))
        results.update(marker_results(rows))
        if motion.ring is not None:
            results.update(flight_results(rows, motion.mass))
        if motion.robot is not None:
            gait = recorder.loaded.case.gait
            assert gait is not None
            gravity = float(np.linalg.norm(motion.model.gravity))
            period = getattr(gait.gait(), "period", None)
            results.update(robot_results(rows, motion.mass, gravity, period))
            results.update(step_results(rows, recorder.loaded))
    results["mass_kg"] = motion.mass
    results["scaled_mass_kg"] = motion.model.scaled_mass
    results["steps"] = motion.state.step_count
    results["smallest_step_us"] = 1e6 * stats.smallest_step if stats.steps else None
    results["largest_step_us"] = 1e6 * stats.largest_step if stats.steps else None
    results["deepest_penetration_mm"] = 1e3 * stats.deepest
    # Of all sittings, where the run was resumed.
    marched = stats.clock.total()
    results["motion_time_s"] = marched
    if stats.steps and motion.model.soft_cells.size:
        results["element_updates_per_s"] = stats.steps * motion.model.soft_cells.size / marched
    if stats.steps:
        results["time_share"] = stats.clock.shares()
    return results
