"""What is written of a motion as it goes: rows, frames and checkpoints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.case import LoadedCase, package_version
from flexapod.app.motion_model import Motion, restored_state, scaled_arrays
from flexapod.app.motion_rigid import RigidTracks
from flexapod.app.outputs import OutputState, ResultsFolder
from flexapod.app.probes import Probe, make_probes

if TYPE_CHECKING:
    from flexapod.dynamics.integrator import Energies
    from flexapod.dynamics.model import State
    from flexapod.fem.body import SolidBody


class MotionFolder(ResultsFolder):
    """Writes curve.csv with the checkpoints and at the end: a motion has thousands of rows, and
    a run that goes on goes on from a checkpoint.
    """

    def write_row(self, row: Mapping[str, float | str]) -> None:
        """Take a row."""
        self.rows.append(dict(row))

    def write_checkpoint(self, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> None:
        """Keep the state beside the rows it belongs to."""
        super().write_checkpoint(arrays, about)
        self._write_curve()

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write curve.csv and summary.json."""
        self._write_curve()
        super().write_summary(summary)


class Recorder:
    """Writes a row per interval, a frame where one is due, and checkpoints."""

    def __init__(
        self, loaded: LoadedCase, motion: Motion, folder: ResultsFolder, lean: bool = False
    ) -> None:
        from flexapod.dynamics.integrator import RunStats

        self.loaded = loaded
        self.lean = lean
        self.motion = motion
        self.folder = folder
        self.probes: list[Probe] = [] if motion.mesh is None else make_probes(loaded, motion.mesh)
        self.previous = {probe.head: 0.0 for probe in self.probes}
        self.tracks = RigidTracks(motion.model, motion.rigid)
        spec = loaded.case.dynamics
        assert spec is not None
        self.intervals = round(spec.duration / spec.interval)
        self.every = max(1, round(self.intervals / spec.frames))
        self.largest_energy = 0.0
        self.turn = 0.0
        self.yaw = 0.0
        self.centre_start: np.ndarray | None = None
        self.weight_start: float | None = None
        # Every so many nodes: two hundred tell the turn of the whole.
        count = motion.model.rigid_start
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
        if self.motion.ring is not None:
            row.update(self.motion.ring.columns(model, state))
            names.append("hub")
        if self.motion.robot is not None:
            row.update(self.motion.robot.columns(model, state))
            names.append("marker")
        for name in ("centre", *names):
            speed, acceleration = _differences(self.folder.rows, row, name)
            if name != "centre":
                row[f"{name}_speed_m_s"] = speed
            row[f"{name}_acceleration_m_s2"] = acceleration
        row["turn_deg"] = self._turned()
        if self.motion.robot is not None:
            row["yaw_deg"] = self.yaw
        row.update(self.tracks.columns(state))
        for name in (
            "kinetic", "strain", "weight", "contact", "bond", "pressure_work", "contact_loss",
            "mass_damping_loss", "internal_loss", "viscous_loss", "bond_loss", "unaccounted",
        ):  # fmt: skip
            row[f"{name}_J"] = float(getattr(energies, name))
        if model.lines is not None:
            row["lines_J"] = energies.lines
            row["coil_work_J"] = energies.coil_work
            row["rheology_loss_J"] = energies.line_loss
        if model.joints is not None:
            row["joints_J"] = energies.joints
            row["servo_work_J"] = energies.servo_work
            row["joint_loss_J"] = energies.joint_loss
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
        rotation = best_rotation(self.sample_start, x)
        self.turn = unwrap(angle_about(rotation, "y"), self.turn)
        # By the body's axis across, which stays level as it rolls over; positive to the left.
        self.yaw = unwrap(math.degrees(math.atan2(-rotation[0, 1], rotation[1, 1])), self.yaw)
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
            energies.lines,
            abs(energies.coil_work),
            abs(energies.servo_work),
        )
        row = self.row(energies)
        if self.centre_start is None:
            self.centre_start = np.array([row[f"centre_{axis}_mm"] for axis in "xyz"])
        due = state.interval % self.every == 0 or state.interval >= self.intervals
        if due and not self.lean:
            mesh = self.motion.mesh
            nodes = np.zeros((0, 3)) if mesh is None else mesh.nodes
            cells = np.zeros((0, 8), dtype=np.int64) if mesh is None else mesh.cells
            self.folder.write_state(nodes, cells, self._frame(state, row))
        else:
            self.folder.write_row(row)

    def _frame(self, state: State, row: dict[str, float]) -> OutputState:
        model, body, ring = self.motion.model, self.motion.body, self.motion.ring
        count, rigid = model.mesh_node_count, slice(model.rigid_start, None)
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
            {} if body is None else _cell_fields(body, state.u[:count]),
            self.motion.rigid.output(
                state.u[rigid], {"contact_pressure": pressure[rigid], "velocity": state.v[rigid]}
            ),
            None if ring is None else ring.output(model, state, pressure),
        )

    def checkpoint(self, state: State) -> None:
        """Keep all that moves."""
        if self.lean:
            return
        arrays, about = state.to_arrays()
        extra = {
            "previous": self.previous,
            "turn": self.turn,
            "yaw": self.yaw,
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
        from flexapod.dynamics.integrator import RunStats
        from flexapod.dynamics.workspace import Clock

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
        self.sample_start = arrays.pop("sample_start", None)
        self.centre_start = arrays.pop("centre_start", None)
        self.tracks.restore(arrays)
        self.previous.update(extra["previous"])
        self.turn = extra["turn"]
        self.yaw = extra["yaw"]
        self.largest_energy = extra["largest_energy"]
        self.weight_start = extra["weight_start"]
        kept_stats = extra["stats"]
        self.stats = RunStats(**{**kept_stats, "clock": Clock(**kept_stats["clock"])})
        self.motion.state = restored_state(
            self.motion, arrays, about["state"], str(self.folder.path)
        )
        return True


def _cell_fields(body: SolidBody, u: np.ndarray) -> dict[str, np.ndarray]:
    """Fields of the hexahedra at displacements `u` [m]."""
    fields = body.fields(u)
    return {
        "pressure": fields.pressure,
        "principal_stretches": fields.principal_stretches,
        "cauchy_stress": fields.cauchy_stress.reshape(-1, 9),
        "material": body.material.astype(np.int32),
    }


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


__all__ = ["MotionFolder", "Recorder"]
