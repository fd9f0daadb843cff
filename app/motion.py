"""A motion from its case to its results folder: march, rows, frames and checkpoints."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.case import LoadedCase, package_version
from flexapod.app.motion_model import (
    Motion,
    Say,
    assemble_motion,
    restore_scaled,
    scaled_arrays,
    start_shape,
)
from flexapod.app.motion_rigid import RigidTracks
from flexapod.app.outputs import CHECKPOINT_FILE, OutputState, ResultsFolder, peak_memory
from flexapod.app.probes import Probe, make_probes
from flexapod.core.errors import InputError, SolverError, Status

if TYPE_CHECKING:
    from flexapod.dynamics.integrator import Energies
    from flexapod.dynamics.model import State


class _Recorder:
    def __init__(self, loaded: LoadedCase, motion: Motion, folder: ResultsFolder) -> None:
        from flexapod.dynamics.integrator import RunStats

        self.loaded = loaded
        self.motion = motion
        self.folder = folder
        self.probes: list[Probe] = make_probes(loaded, motion.mesh)
        self.previous = {probe.head: 0.0 for probe in self.probes}
        self.tracks = RigidTracks(motion.model, motion.rigid)
        spec = loaded.case.dynamics
        assert spec is not None
        self.intervals = round(spec.duration / spec.interval)
        self.every = max(1, round(self.intervals / spec.frames))
        self.largest_energy = 0.0
        self.turn = 0.0
        self.centre_start: np.ndarray | None = None
        self.weight_start: float | None = None
        # Every so many nodes: two hundred tell the turn of the whole.
        count = motion.model.mesh_node_count
        self.sample = np.arange(0, count, max(1, count // 200))
        self.sample_start: np.ndarray | None = None
        self.stats = RunStats()

    def row(self, energies: Energies) -> dict[str, float]:
        """Columns at the state of the last forces."""
        from flexapod.dynamics import kernels
        from flexapod.dynamics.contacts import AREA, BY_DAMPING, BY_FRICTION, COUNT, DEPTH, SLID

        model, state, work = self.motion.model, self.motion.state, self.motion.work
        sums = np.zeros(10)
        kernels.momentum(model.own_mass, model.owner, state.x, state.v, sums)
        rigid = model.rigid.mass
        mass = sums[0] + rigid.sum()
        centre = (sums[1:4] + (rigid[:, None] * state.rigid_x).sum(axis=0)) / mass
        velocity = (sums[4:7] + (rigid[:, None] * state.rigid_v).sum(axis=0)) / mass
        row: dict[str, float] = {"time_s": state.time}
        for k, chamber in enumerate(model.chambers):
            head = "pressure_kPa" if len(model.chambers) == 1 else f"pressure_{chamber.name}_kPa"
            row[head] = float(work.chamber_pressure[k]) / 1000.0
        for axis, value in zip("xyz", centre, strict=True):
            row[f"centre_{axis}_mm"] = 1000.0 * float(value)
        row["speed_m_s"] = float(np.linalg.norm(velocity))
        reactions = np.zeros_like(state.x)
        for probe in self.probes:
            value = probe.sample(state.x, reactions, self.previous[probe.head])
            self.previous[probe.head] = value
            row[probe.head] = value
        names = [p.name for p in self.loaded.case.probe if p.type == "track"]
        for name in ("centre", *names):
            speed, acceleration = _differences(self.folder.rows, row, name)
            if name != "centre":
                row[f"{name}_speed_m_s"] = speed
            row[f"{name}_acceleration_m_s2"] = acceleration
        row["turn_deg"] = self._turned()
        row.update(self.tracks.columns(state))
        for name in (
            "kinetic", "strain", "weight", "contact", "bond", "pressure_work", "contact_loss",
            "mass_damping_loss", "internal_loss", "viscous_loss", "bond_loss", "unaccounted",
        ):  # fmt: skip
            row[f"{name}_J"] = float(getattr(energies, name))
        for contact, history in zip(model.contacts, state.histories, strict=True):
            totals, spent = contact.totals, history["spent"]
            row[f"{contact.name}_force_N"] = contact.pressing()
            row[f"{contact.name}_friction_N"] = contact.rubbing()
            row[f"{contact.name}_area_mm2"] = 1e6 * float(totals[AREA])
            row[f"{contact.name}_depth_mm"] = 1e3 * float(totals[DEPTH])
            row[f"{contact.name}_points"] = float(totals[COUNT])
            row[f"{contact.name}_slid_mm"] = 1e3 * float(spent[SLID])
            row[f"{contact.name}_friction_loss_J"] = float(spent[BY_FRICTION])
            row[f"{contact.name}_damping_loss_J"] = float(spent[BY_DAMPING])
        for bond, totals in zip(model.bonds, work.bond_totals, strict=True):
            row[f"bond_{bond.name}_force_N"] = float(np.linalg.norm(totals[1:4]))
        row["time_step_us"] = 1e6 * state.dt_before
        return row

    def _turned(self) -> float:
        """Turn of the body as a whole about y since the start [deg], whole turns counted."""
        from flexapod.app.probes import angle_about, best_rotation, unwrap

        x = self.motion.state.x[self.sample]
        if self.sample_start is None:
            self.sample_start = x.copy()
        angle = angle_about(best_rotation(self.sample_start, x), "y")
        self.turn = unwrap(angle, self.turn)
        return self.turn

    def record(self, state: State) -> None:
        """Write a row, and a frame with its fields where one is due."""
        from flexapod.dynamics.integrator import energies as ledger

        energies = ledger(self.motion.model, state, self.motion.work)
        if self.weight_start is None:
            self.weight_start = energies.weight
        self.largest_energy = max(
            self.largest_energy,
            energies.kinetic,
            energies.strain,
            abs(energies.weight - self.weight_start),
            abs(energies.pressure_work),
        )
        row = self.row(energies)
        if self.centre_start is None:
            self.centre_start = np.array([row[f"centre_{axis}_mm"] for axis in "xyz"])
        if state.interval % self.every == 0 or state.interval >= self.intervals:
            self.folder.write_state(
                self.motion.mesh.nodes, self.motion.mesh.cells, self._frame(state, row)
            )
        else:
            self.folder.write_row(row)

    def _frame(self, state: State, row: dict[str, float]) -> OutputState:
        model, body = self.motion.model, self.motion.body
        count = model.mesh_node_count
        fields = body.fields(state.u[:count])
        pressures = {c.name: c.nodal_pressure(model.node_count) for c in model.contacts}
        pressure = np.max([np.zeros(model.node_count), *pressures.values()], axis=0)
        # Each contact's own map too, where there is more than one.
        own = {
            f"contact_pressure_{name}": values[:count]
            for name, values in pressures.items()
            if len(pressures) > 1
        }
        return OutputState(
            state.time,
            row,
            state.u[:count],
            {"contact_pressure": pressure[:count], **own, "velocity": state.v[:count]},
            {
                "pressure": fields.pressure,
                "principal_stretches": fields.principal_stretches,
                "cauchy_stress": fields.cauchy_stress.reshape(-1, 9),
                "material": body.material.astype(np.int32),
            },
            self.motion.rigid.output(
                state.u[count:], {"contact_pressure": pressure[count:], "velocity": state.v[count:]}
            ),
        )

    def checkpoint(self, state: State) -> None:
        """Keep all that moves."""
        arrays, about = state.to_arrays()
        extra = {
            "previous": self.previous,
            "turn": self.turn,
            "largest_energy": self.largest_energy,
            "weight_start": self.weight_start,
            "stats": asdict(self.stats),
        }
        if self.motion.model.viscous is not None:
            history = self.motion.model.viscous.history()
            arrays = {**arrays, **{f"viscous.{key}": value for key, value in history.items()}}
        arrays = {**arrays, **scaled_arrays(self.motion.model)}
        if self.sample_start is not None:
            arrays = {**arrays, "sample_start": self.sample_start}
        if self.centre_start is not None:
            arrays = {**arrays, "centre_start": self.centre_start}
        arrays = {**arrays, **self.tracks.to_arrays()}
        self.folder.write_checkpoint(
            arrays, {"state": about, "recorder": extra, "flexapod_version": package_version()}
        )

    def resume(self) -> bool:
        """Take the last checkpoint's state; False where there is none."""
        from flexapod.dynamics.integrator import Clock, RunStats
        from flexapod.dynamics.model import State

        kept = self.folder.read_checkpoint()
        if kept is None:
            return False
        arrays, about = kept
        extra = about["recorder"]
        viscous = {k: arrays.pop(k) for k in list(arrays) if k.startswith("viscous.")}
        if self.motion.model.viscous is not None and viscous:
            self.motion.model.viscous.restore(
                {key.removeprefix("viscous."): value for key, value in viscous.items()}
            )
        restore_scaled(self.motion.model, self.motion.work, arrays)
        self.sample_start = arrays.pop("sample_start", None)
        self.centre_start = arrays.pop("centre_start", None)
        self.tracks.restore(arrays)
        self.previous.update(extra["previous"])
        self.turn = extra["turn"]
        self.largest_energy = extra["largest_energy"]
        self.weight_start = extra["weight_start"]
        kept_stats = extra["stats"]
        self.stats = RunStats(**{**kept_stats, "clock": Clock(**kept_stats["clock"])})
        numbers = {k: (math.nan if v is None else v) for k, v in about["state"].items()}
        state = State.from_arrays(arrays, numbers)
        if state.u.shape != self.motion.state.u.shape:
            raise InputError(
                "the checkpoint is of another mesh; run without --resume", str(self.folder.path)
            )
        self.motion.state = state
        return True


def _differences(
    rows: Sequence[Mapping[str, float]], row: Mapping[str, float], name: str
) -> tuple[float, float]:
    """Speed [m/s] and acceleration [m/s2] of a point over the last interval, and the last two.

    Differences of the places in the rows: what a camera with that interval would see. Zero in the
    first row, and the acceleration in the second.
    """
    if not rows:
        return 0.0, 0.0
    heads = [f"{name}_{axis}_mm" for axis in "xyz"]
    places = [np.array([r[head] for head in heads]) for r in (*rows[-2:], row)]
    times = [r["time_s"] for r in (*rows[-2:], row)]
    speeds = [
        1e-3 * (b - a) / (end - begin)
        for a, b, begin, end in zip(places, places[1:], times, times[1:], strict=False)
    ]
    speed = float(np.linalg.norm(speeds[-1]))
    if len(speeds) < 2:
        return speed, 0.0
    change = speeds[1] - speeds[0]
    return speed, float(np.linalg.norm(change)) / (0.5 * (times[2] - times[0]))


def run_motion(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Run a case with [dynamics]; returns status, message and summary, all files written."""
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted
    from flexapod.dynamics.integrator import Options, march

    began = time.perf_counter()
    spec = loaded.case.dynamics
    assert spec is not None
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    going_on = resume and (out / CHECKPOINT_FILE).is_file()
    with terminated_like_interrupted():
        try:
            # Names and laws are looked up before minutes are spent on the start shape.
            assemble_motion(loaded, None, lambda text: None, settle=False)
            start = start_shape(loaded, out, resume, say)
            motion = assemble_motion(loaded, start, say, settle=not going_on)
        except (KeyboardInterrupt, SolverError) as error:
            status = error.status if isinstance(error, SolverError) else Status.INTERRUPTED
            message = str(error) or "stopped by the user before the motion began"
            summary = _short_summary(loaded, out, began, status, message)
            folder.write_summary(summary)
            return status, message, summary
    recorder = _Recorder(loaded, motion, folder)
    say(f"{len(motion.mesh.cells)} hexahedra, {len(motion.mesh.nodes)} nodes")
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
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": status.name.lower(),
        "message": message,
        "version": package_version(),
        "elements": len(motion.mesh.cells),
        "nodes": len(motion.mesh.nodes),
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "resumed": resume,
        "results": _results(recorder, motion),
        "reference": None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return status, message, summary


def _last_row(recorder: _Recorder) -> None:
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


def _results(recorder: _Recorder, motion: Motion) -> dict[str, Any]:
    rows, stats = recorder.folder.rows, recorder.stats
    last = rows[-1] if rows else {}
    results: dict[str, Any] = {**last, "states": len(recorder.folder.times)}
    if rows and recorder.centre_start is not None:
        now = np.array([last[f"centre_{axis}_mm"] for axis in "xyz"])
        results["distance_m"] = 1e-3 * float(np.linalg.norm(now - recorder.centre_start))
        results["peak_speed_m_s"] = max(row["speed_m_s"] for row in rows)
        results["turns"] = last["turn_deg"] / 360.0
        results["peak_acceleration_m_s2"] = max(row["centre_acceleration_m_s2"] for row in rows)
        worst = max(abs(row["unaccounted_J"]) for row in rows)
        results["energy_balance"] = worst / max(recorder.largest_energy, 1e-300)
        results["largest_energy_J"] = recorder.largest_energy
        # What is stored at rest flatters: the share of what changed says more.
        changes = [
            abs(row[head] - rows[0][head])
            for row in rows
            for head in ("kinetic_J", "strain_J", "weight_J", "pressure_work_J")
        ]
        results["energy_balance_of_changes"] = worst / max(*changes, 1e-300)
    results["mass_kg"] = motion.mass
    results["scaled_mass_kg"] = motion.model.scaled_mass
    results["steps"] = motion.state.step_count
    results["smallest_step_us"] = 1e6 * stats.smallest_step if stats.steps else None
    results["largest_step_us"] = 1e6 * stats.largest_step if stats.steps else None
    results["deepest_penetration_mm"] = 1e3 * stats.deepest
    # Of all sittings, where the run was resumed.
    marched = stats.clock.total()
    results["motion_time_s"] = marched
    if stats.steps:
        results["element_updates_per_s"] = stats.steps * motion.model.soft_cells.size / marched
        results["time_share"] = stats.clock.shares()
    return results
