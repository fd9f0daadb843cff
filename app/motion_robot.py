"""A robot on legs: its stations, legs and joints, its torso where it is rigid, and its columns."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import (
    build_mesh,
    carried_mass,
    make_materials,
    match_names,
)
from flexapod.app.case import LoadedCase
from flexapod.app.motion_flight import airborne, flights
from flexapod.app.motion_rigid import RigidBody, RigidParts, places, together
from flexapod.app.spec_rigid import RigidSpec
from flexapod.app.spec_robot import LEG_NAME, LEGS, TORSO, ServoSpec
from flexapod.core.errors import InputError
from flexapod.geometry.tagged import TaggedMesh, box_mesh

if TYPE_CHECKING:
    from flexapod.dynamics.joints import Joint, JointSystem, Servo
    from flexapod.dynamics.model import Model, State
    from flexapod.geometry.legs import LegMesh


# Deepest that a sole's flats may lie inside its circle [m].
FLATNESS = 1e-5

# --------------------------------------------------------------------------- parts


def station_names(loaded: LoadedCase, mesh: TaggedMesh) -> list[str]:
    """Cell groups of the three servo stations, back to front."""
    spec = loaded.case.robot
    assert spec is not None
    where = f"{loaded.source}: robot.legs.stations"
    names = match_names(list(spec.legs.stations), mesh.cell_groups, "cell", where)
    if len(names) != len(LEGS):
        raise InputError(
            f"a robot has {len(LEGS)} stations, and this names {', '.join(names)}", where
        )
    return sorted(names, key=lambda name: _middle_x(mesh, name))


def _middle_x(mesh: TaggedMesh, name: str) -> float:
    x = mesh.nodes[mesh.cells[mesh.cell_groups[name]], 0]
    return 0.5 * float(x.min() + x.max())


def with_rigid_stations(loaded: LoadedCase, mesh: TaggedMesh) -> LoadedCase:
    """The case with its stations among its rigid bodies."""
    case = loaded.case
    names = station_names(loaded, mesh)
    own = set(names)
    # A table of theirs is one too many; one that also names others stays, and is refused.
    rigid = []
    for spec in case.rigid:
        named = set() if spec.group is None else set(_matching(mesh, spec.group))
        if not named or not own.issuperset(named):
            rigid.append(spec)
    stations = [RigidSpec(group=name) for name in names]
    changed = case.model_copy(update={"rigid": (*rigid, *stations)})
    return LoadedCase(changed, loaded.source, loaded.folder)


def _matching(mesh: TaggedMesh, pattern: str) -> list[str]:
    from fnmatch import fnmatchcase

    return [name for name in mesh.cell_groups if fnmatchcase(name, pattern)]


def leg_mesh(loaded: LoadedCase) -> LegMesh:
    """One leg, about its hip."""
    from flexapod.geometry.legs import CLeg

    spec = loaded.case.robot
    assert spec is not None
    legs = spec.legs
    try:
        # As many as soles need that sink in by five times that.
        leg = CLeg(legs.height, legs.extent, legs.width, legs.thickness, width_elements=1)
        flats = math.ceil(leg.arc_elements * math.sqrt(leg.sagitta() / FLATNESS))
        return dataclasses.replace(leg, arc_elements=max(flats, 24)).build()
    except InputError as error:
        raise InputError(str(error), f"{loaded.source}: robot.legs") from None


def make_servo(spec: ServoSpec) -> Servo:
    """The servo a table describes."""
    from flexapod.dynamics.joints import Servo

    return Servo(**{part.name: getattr(spec, part.name) for part in dataclasses.fields(Servo)})


@dataclass(frozen=True)
class Legs:
    """Legs as rigid bodies by name, and the joints they hang on, in the order of `numbers`."""

    bodies: dict[str, RigidBody]
    joints: list[Joint]
    numbers: list[int]


def make_legs(loaded: LoadedCase, mesh: TaggedMesh, torso: str | None = None) -> Legs:
    """Legs on the sides that the mesh has: of half a robot, those of its half.

    `mesh` is that of the body whose stations hold the legs; `torso` is their parent where no
    station moves by itself.
    """
    from flexapod.dynamics.joints import Joint
    from flexapod.dynamics.rigid import mass_properties
    from flexapod.geometry.rigid_shapes import RigidSurface

    spec = loaded.case.robot
    assert spec is not None
    legs, made = spec.legs, leg_mesh(loaded)
    volume, centre, inertia = mass_properties(made.mesh.nodes, made.mesh.cells, 1.0)
    surface = RigidSurface(made.surface.nodes - centre, made.surface.faces)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    sides = [side for side, there in ((1.0, high[1] > 0.0), (-1.0, low[1] < 0.0)) if there]
    bodies, joints, numbers = {}, [], []
    for row, station in enumerate(station_names(loaded, mesh)):
        for side in sides:
            number = LEGS[row][0 if side > 0.0 else 1]
            hip = (
                _middle_x(mesh, station) + legs.hip_forward,
                side * legs.hip_out[row],
                float(low[2]) + legs.hip_height,
            )
            name = LEG_NAME.format(number)
            bodies[name] = RigidBody(
                legs.mass,
                np.array(hip) + centre,
                legs.mass / volume * inertia,
                np.zeros(3),
                surface,
                made.touching,
                modulus=legs.youngs_modulus,
                jointed=True,
            )
            joints.append(
                Joint(
                    name,
                    torso or station,
                    name,
                    hip,
                    servo=make_servo(spec.servo),
                    point_stiffness=spec.servo.point_stiffness,
                    axis_stiffness=spec.servo.axis_stiffness,
                )
            )
            numbers.append(number)
    return Legs(bodies, joints, numbers)


@dataclass(frozen=True)
class LegTargets:
    """What the servos of some legs aim at: their part of a gait."""

    gait: Any
    rows: np.ndarray  # of the gait's six, shape (joint_count,)

    def targets(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """Angles [rad], shape (joint_count,)."""
        return np.asarray(self.gait.targets(time, *begun))[self.rows]

    def rates(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """Their rates [rad/s], shape (joint_count,)."""
        return np.asarray(self.gait.rates(time, *begun))[self.rows]


class SensedTargets(LegTargets):
    """The same of a gait that feels the robot's turn."""

    def nothing_begun(self) -> np.ndarray:
        """See `joints.Sensing`."""
        return np.asarray(self.gait.nothing_begun())

    def sense(self, time: float, turn: float, begun: np.ndarray) -> None:
        """See `joints.Sensing`."""
        self.gait.sense(time, turn, begun)


@dataclass(frozen=True)
class HeldTargets:
    """Angles at rest [rad]."""

    angles: np.ndarray

    def targets(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """See `joints.Targets`."""
        return self.angles

    def rates(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """See `joints.Targets`."""
        return np.zeros_like(self.angles)


def make_joints(loaded: LoadedCase, legs: Legs, rigid: RigidParts) -> JointSystem:
    """The joints with the case's gait."""
    from flexapod.dynamics.gait import PAIRS
    from flexapod.dynamics.gait_tables import GaitSensed
    from flexapod.dynamics.joints import JointSystem

    spec = loaded.case.gait
    assert spec is not None
    try:
        gait = spec.gait()
    except InputError as error:
        raise InputError(str(error), f"{loaded.source}: gait") from None
    rows = np.array(legs.numbers, dtype=np.int64) - 1
    if len(set(rows % 2)) == 1:
        _check_alike(gait, f"{loaded.source}: gait")
    command = (SensedTargets if isinstance(gait, GaitSensed) else LegTargets)(gait, rows)
    middle = next(k for k, number in enumerate(legs.numbers) if number in PAIRS["middle"])
    return JointSystem(legs.joints, rigid.bodies, rigid.centres, command, sensor=middle)


def _check_alike(gait: Any, where: str) -> None:
    """Of half a robot left and right legs must do the same."""
    from flexapod.dynamics.gait import PAIRS
    from flexapod.dynamics.gait_tables import GaitSensed

    if isinstance(gait, GaitSensed):
        for move in gait.moves:
            if any(len({*pair} & {*move.legs}) == 1 for pair in PAIRS.values()):
                raise InputError(
                    "half of a robot is modelled, and a move of it names legs "
                    f"{''.join(map(str, move.legs))} without those on the other side",
                    where,
                )
        return
    period = gait.period if math.isfinite(gait.period) else 1.0
    end = gait.end if math.isfinite(gait.end) else 3.0 * period
    for time in np.linspace(0.0, end, 301):
        angles = np.asarray(gait.targets(float(time)))
        if np.abs(angles[::2] - angles[1::2]).max() > 1e-9:
            raise InputError(
                "half of a robot is modelled, and this gait moves left and right legs differently: "
                "model the whole, without support and mirror at y = 0",
                where,
            )


# --------------------------------------------------------------------------- a rigid torso

# Hexahedra of a rigid torso along x, y and z: for pictures, and for its underside on the ground.
_TORSO_CELLS = (18, 6, 2)


@dataclass(frozen=True)
class Torso:
    """A robot's body as one rigid box: the case as it is then, the box, and what it weighs."""

    loaded: LoadedCase
    mesh: TaggedMesh
    body: RigidBody
    stations: TaggedMesh  # the mesh that knows the stations
    left_out: list[str]  # tables that a rigid body has no use for


def rigid_torso(loaded: LoadedCase) -> Torso:
    """Weigh the body on its mesh, and put a box of its size in its place.

    It is always whole, and takes no pressure, supports or bonds: those tables are left out.
    """
    from flexapod.fem.body import SolidBody

    case = loaded.case
    assert case.mesh is not None
    if case.mesh.builder is None:
        raise InputError(
            "a rigid body needs a [mesh] with a builder, whose stations are known by name",
            f"{loaded.source}: robot.body",
        )
    sized = case.sized_mesh
    assert sized is not None
    whole = sized.model_copy(update={"symmetry": "whole"})
    plain = LoadedCase(case.model_copy(update={"mesh": whole}), loaded.source, loaded.folder)
    fine = build_mesh(plain)
    soft = SolidBody(fine, make_materials(plain, fine))
    nodal = soft.node_mass + carried_mass(plain, fine, soft)
    mass, centre, inertia, middle = together(nodal, fine.nodes)
    mesh = box_mesh(fine.nodes.min(axis=0), fine.nodes.max(axis=0), _TORSO_CELLS)
    everywhere = [spec for spec in case.material if spec.group == "*"] or list(case.material)
    changes: dict[str, Any] = {
        "mesh": whole,
        "material": (everywhere[0].model_copy(update={"group": "*"}),),
        "rigid": (),
        "pressure": (),
        "support": (),
        "mass": (),
        "bond": (),
        "probe": (),
    }
    left_out = [
        key
        for key, value in changes.items()
        if key not in ("mesh", "material", "mass") and len(value) < len(getattr(case, key))
    ]
    # A box has no chambers that could meet, which needs no word.
    if any(c.type == "pair" for c in case.contact):
        left_out.append("contact between faces")
    if case.dynamics is not None:  # nothing of it has a stiffness to damp
        changes["dynamics"] = case.dynamics.model_copy(update={"stiffness_damping": 0.0})
    if case.start is not None:
        changes["start"] = case.start.model_copy(update={"case": None, "unfold": ()})
    changed = LoadedCase(case.model_copy(update=changes), loaded.source, loaded.folder)
    body = RigidBody(mass, centre, inertia, middle, tied=np.arange(len(mesh.nodes)))
    return Torso(changed, mesh, body, fine, left_out)


# --------------------------------------------------------------------------- rows


class RobotParts:
    """Columns of a robot's rows, beside those of every motion."""

    def __init__(self, model: Model, rigid: RigidParts, marker: Sequence[float]) -> None:
        assert model.joints is not None
        self.names = [joint.name for joint in model.joints.joints]
        parents = sorted({int(row) for row in model.joints.bodies[:, 0]})
        point = np.asarray(marker, dtype=float)
        # Fixed to the station next to it.
        self.body = min(parents, key=lambda k: float(np.linalg.norm(rigid.centres[k] - point)))
        self.local = np.zeros_like(rigid.centres)
        self.local[self.body] = point - rigid.centres[self.body]

    def columns(self, model: Model, state: State) -> dict[str, float]:
        """Place of the marked point; angles, torques and powers of the legs; books of the servos.

        Torque is the motor's, power that times the rotor's rate, half a step ahead.
        """
        from flexapod.dynamics import joint_kernels as jk

        system = model.joints
        assert system is not None
        row: dict[str, float] = {}
        (where, _), _ = places(model, state, self.local)
        for axis, value in zip("xyz", where[self.body], strict=True):
            row[f"marker_{axis}_mm"] = 1000.0 * float(value)
        motion = state.joints["motion"]
        power = motion[:, jk.MOTOR] * motion[:, jk.RATE]
        for k, name in enumerate(self.names):
            row[f"{name}_angle_deg"] = math.degrees(motion[k, jk.ANGLE])
            row[f"{name}_target_deg"] = math.degrees(system.target[k])
            row[f"{name}_torque_N_m"] = float(motion[k, jk.MOTOR])
            row[f"{name}_power_W"] = float(power[k])
        row["servo_power_W"] = float(power.sum())
        row["servo_drawn_J"] = float(state.joints["spent"][jk.DRAWN])
        return row


def robot_results(
    rows: Sequence[Mapping[str, float]], mass: float, gravity: float, period: float | None
) -> dict[str, Any]:
    """What a robot's rows come to.

    ``mean_speed_m_s`` is the way of the centre over the ground by the time; ``steady_speed_m_s``
    the same over the last whole periods of the gait, the first one left out. Cost of transport is
    the work the motors gave (what they took back not counted) over weight times way: mechanical,
    without the heat in the motors.
    """
    first, last = rows[0], rows[-1]
    way = math.hypot(*(last[f"centre_{a}_mm"] - first[f"centre_{a}_mm"] for a in "xy")) / 1e3
    time = last["time_s"] - first["time_s"]
    results: dict[str, Any] = {
        "distance_over_ground_m": way,
        "forward_m": 1e-3 * (last["centre_x_mm"] - first["centre_x_mm"]),
        "sideways_m": 1e-3 * (last["centre_y_mm"] - first["centre_y_mm"]),
        "mean_speed_m_s": way / time if time > 0.0 else 0.0,
        "servo_drawn_J": last["servo_drawn_J"],
        "peak_torque_N_m": max(
            abs(value)
            for row in rows
            for head, value in row.items()
            if head.endswith("_torque_N_m")
        ),
    }
    if "yaw_deg" in last:
        results["yaw_deg"] = last["yaw_deg"] - first["yaw_deg"]
    if period is not None and time > 2.0 * period:
        count = int((time - period) / period + 1e-9)
        begin = min(rows, key=lambda row: abs(row["time_s"] - (last["time_s"] - count * period)))
        steady = [last[f"centre_{a}_mm"] - begin[f"centre_{a}_mm"] for a in "xy"]
        results["steady_speed_m_s"] = 1e-3 * math.hypot(*steady) / (count * period)
    if way > 0.0 and gravity > 0.0:
        results["cost_of_transport"] = last["servo_drawn_J"] / (mass * gravity * way)
    in_the_air = airborne(rows)
    results["airborne_fraction"] = sum(in_the_air) / len(in_the_air)
    results["jump_height_m"] = 1e-3 * max(
        (
            max(row["centre_z_mm"] for row in rows[begin : end + 1]) - rows[begin]["centre_z_mm"]
            for begin, end in flights(rows)
        ),
        default=0.0,
    )
    return results


def step_results(rows: Sequence[Mapping[str, float]], loaded: LoadedCase) -> dict[str, Any]:
    """Whether a step in the ground was cleared: centre and marked point are past it, and higher.

    Higher than they began by more than half of it: what hangs on the edge is not over it.
    """
    steps = [c for c in loaded.case.contact if c.type == "ground" and c.shape == "step"]
    if not steps:
        return {}
    edge, height = 1e3 * steps[0].step_at, 1e3 * steps[0].step_height
    last, first = rows[-1], rows[0]
    over = all(
        last[f"{name}_x_mm"] > edge and last[f"{name}_z_mm"] - first[f"{name}_z_mm"] > 0.5 * height
        for name in ("centre", "marker")
    )
    return {"cleared": over, "past_the_step_m": 1e-3 * (last["centre_x_mm"] - edge)}


def held_joints(system: JointSystem) -> JointSystem:
    """The joints with their servos holding the angles of the gait's begin."""
    held = copy.copy(system)
    held.command = HeldTargets(np.array(system.command.targets(0.0)))
    return held


def torso_rigid(torso: Torso, legs: Legs) -> dict[str, RigidBody]:
    """Torso and legs by name."""
    return {TORSO: torso.body, **legs.bodies}


__all__ = [
    "Legs",
    "RobotParts",
    "Torso",
    "held_joints",
    "leg_mesh",
    "make_joints",
    "make_legs",
    "rigid_torso",
    "robot_results",
    "station_names",
    "step_results",
    "torso_rigid",
    "with_rigid_stations",
]
