"""Revolute joints with servos: what they are made of, and their state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from flexapod.core.errors import InputError, check_finite, check_positive
from flexapod.dynamics import joint_kernels
from flexapod.dynamics.rigid import RigidBodies

# State of all joints: "motion" (joint_count, MOTION) and "spent" (3,), see `joint_kernels`.
JointState = dict[str, np.ndarray]

KG_CM = 0.0980665  # [N m]


class Targets(Protocol):
    """What the servos aim at: of time alone, but for a `Sensing` one."""

    def targets(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """Angles [rad], shape (joint_count,)."""
        ...

    def rates(self, time: float, *begun: np.ndarray) -> np.ndarray:
        """Their rates [rad/s], shape (joint_count,)."""
        ...


@runtime_checkable
class Sensing(Targets, Protocol):
    """What servos aim at that feel how far the robot has rolled.

    What has begun of it is part of the joints' state: "begun", as `nothing_begun` makes it, and
    given with the time. Without it angles and rates are those of before the first moment.
    """

    def nothing_begun(self) -> np.ndarray:
        """Before the first moment."""
        ...

    def sense(self, time: float, turn: float, begun: np.ndarray) -> None:
        """Write into `begun` what begins at `time` [s] and `turn` [rad]."""
        ...


@dataclass(frozen=True)
class Servo:
    """A position servo: PID controller, motor with a torque limit, gear.

    Attributes
    ----------
    proportional
        [N m/rad]. Default: the stall torque at an error of 5 degrees (assumed; the paper says
        PID without gains).
    integral
        [N m/(rad s)]; off by default. It does not wind up while the motor is at its limit.
    derivative
        [N m s/rad], of the rate. None: critical damping of the rotor alone,
        ``2 sqrt(proportional inertia)``.
    rate_weight
        Part of the target's rate, in [0, 1], that this term takes the rotor's rate from: 1 for the
        error's rate; 0 (default, assumed: a servo is told angles) for the rotor's own, so that
        corners of the target do not kick (setpoint weighting: K. J. Astrom, R. M. Murray,
        Feedback Systems, 2008, section 10.5). The rotor then lags by ``derivative/proportional``.
    stall_torque
        [N m]: 25 kg cm (SoSpider paper, section 2.3).
    no_load_speed
        [rad/s] at which the motor gives nothing in its own sense. Default: 60 degrees in 0.16 s
        (assumed; the maker's servos of 30 and 50 kg cm are listed with 0.222 and 0.133 s).
    inertia
        Of the rotor, reflected through the gear [kg m2]. Default: 0.5 g cm2 through 1:250
        (assumed, a coreless motor of that size).
    gear_stiffness
        [N m/rad] between rotor and leg. Default: 0.7 degrees at stall (assumed).
    gear_damping
        Share of critical damping of the child on its gear.
    """

    proportional: float = 25.0 * KG_CM / math.radians(5.0)
    integral: float = 0.0
    derivative: float | None = None
    rate_weight: float = 0.0
    stall_torque: float = 25.0 * KG_CM
    no_load_speed: float = math.radians(60.0) / 0.16
    inertia: float = 3.1e-3
    gear_stiffness: float = 200.0
    gear_damping: float = 0.05

    def __post_init__(self) -> None:
        for name, unit in (
            ("stall_torque", "N m"),
            ("no_load_speed", "rad/s"),
            ("inertia", "kg m2"),
            ("gear_stiffness", "N m/rad"),
        ):
            check_positive(f"servo {name}", getattr(self, name), unit)
        for name in ("proportional", "integral", "derivative", "gear_damping"):
            value = getattr(self, name)
            if value is not None and not check_finite(f"servo {name}", value) >= 0.0:
                raise InputError(f"servo {name} must be >= 0, got {value:g}")
        if not 0.0 <= self.rate_weight <= 1.0:
            raise InputError(f"servo rate_weight must lie in [0, 1], got {self.rate_weight:g}")

    @property
    def rate_gain(self) -> float:
        """Gain of the rate [N m s/rad]."""
        if self.derivative is not None:
            return self.derivative
        return 2.0 * math.sqrt(self.proportional * self.inertia)


@dataclass(frozen=True)
class Joint:
    """A child body that turns about an axis of its parent, driven by a servo.

    Attributes
    ----------
    name
        For reports and columns.
    parent, child
        Names of rigid bodies.
    point
        Of the axis [m], shape (3,), in the reference configuration, where the angle is zero.
    axis
        Unit vector of positive turning there.
    servo
        What drives it.
    point_stiffness, axis_stiffness
        Of bearing and horn [N/m, N m/rad]. Defaults: a leg's 30 N move its hub by 0.06 mm, and
        its 1 N m sideways tilts it by 0.3 degrees (assumed: printed parts on a metal horn).
    damping
        Share of critical damping of the child on these.
    """

    name: str
    parent: str
    child: str
    point: tuple[float, float, float]
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    servo: Servo = Servo()
    point_stiffness: float = 5e5
    axis_stiffness: float = 200.0
    damping: float = 0.1

    def __post_init__(self) -> None:
        where = f"joint {self.name}"
        check_positive("point_stiffness", self.point_stiffness, "N/m", where)
        check_positive("axis_stiffness", self.axis_stiffness, "N m/rad", where)
        if not 0.0 <= self.damping <= 1.0:
            raise InputError(f"damping must lie in [0, 1], got {self.damping:g}", where)
        if not (np.isfinite(self.point).all() and len(self.point) == 3):
            raise InputError(f"point must be three finite numbers, got {self.point}", where)
        if abs(math.hypot(*self.axis) - 1.0) > 1e-9:
            raise InputError(f"axis must have length 1, got {self.axis}", where)


class JointSystem:
    """All joints of a model, packed for the kernels.

    Parameters
    ----------
    joints
        In the order of the targets.
    bodies, centres
        Rigid bodies and their centres of mass in the reference configuration [m].
    command
        What the servos aim at.
    sensor
        The joint whose parent feels the turn that a sensing command goes by.

    Raises
    ------
    InputError
        A body is not there, or is the child of two joints.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        bodies: RigidBodies,
        centres: np.ndarray,
        command: Targets,
        sensor: int = 0,
    ) -> None:
        self.joints = tuple(joints)
        self.command = command
        self.sensor = sensor
        count = len(self.joints)
        rows = {name: row for row, name in enumerate(bodies.names)}
        for joint in self.joints:
            for body in (joint.parent, joint.child):
                if body not in rows:
                    raise InputError(
                        f"there is no rigid body {body!r}; there is: {', '.join(rows) or 'none'}",
                        f"joint {joint.name}",
                    )
            if joint.parent == joint.child:
                raise InputError(f"{joint.child!r} cannot be its own parent", f"joint {joint.name}")
        children = [joint.child for joint in self.joints]
        for place, joint in enumerate(self.joints):
            if joint.parent in children[place + 1 :]:
                raise InputError(
                    f"its parent {joint.parent!r} hangs on a later joint: put that one first",
                    f"joint {joint.name}",
                )
        double = sorted({name for name in children if children.count(name) > 1})
        if double:
            raise InputError(f"bodies are children of two joints: {', '.join(double)}")
        self.bodies = np.array(
            [(rows[j.parent], rows[j.child]) for j in self.joints], dtype=np.int64
        ).reshape(count, 2)
        points = np.array([j.point for j in self.joints], dtype=float).reshape(count, 3)
        self.arms = points[:, None, :] - centres[self.bodies]
        self.axes = np.array([j.axis for j in self.joints], dtype=float).reshape(count, 3)
        self.references = np.array([_across(axis) for axis in self.axes]).reshape(count, 3)
        self.compliance = self._compliance(bodies)
        self.stiffness = np.array(
            [self._springs(j, row) for row, j in enumerate(self.joints)]
        ).reshape(count, joint_kernels.STIFFNESS)
        self.servo = np.array(
            [
                (
                    j.servo.proportional,
                    j.servo.integral,
                    j.servo.rate_gain,
                    j.servo.stall_torque,
                    j.servo.no_load_speed,
                    j.servo.inertia,
                    j.servo.rate_weight,
                )
                for j in self.joints
            ]
        ).reshape(count, joint_kernels.SERVO)
        self._needs_rates = bool(self.servo[:, joint_kernels.RATE_WEIGHT].any())
        bodies_count = bodies.count
        self.load = np.zeros((bodies_count, 6))
        self.damping = np.zeros((count, 2, 6))
        self.gear_dashpot = np.zeros(count)
        self.stored = np.zeros(4)
        self.axis = np.zeros((count, 3))
        self.rotation = np.zeros((bodies_count, 3, 3))
        self.omega = np.zeros((bodies_count, 3))
        self.omega_before = np.zeros((bodies_count, 3))
        self.target = np.zeros(count)
        self.target_rate = np.zeros(count)

    def _compliance(self, bodies: RigidBodies) -> np.ndarray:
        """Bounds per joint and side of what a unit force [1/kg] and torque move, (count, 2, 2)."""
        out = np.empty((len(self.joints), 2, 2))
        for j, pair in enumerate(self.bodies):
            for side, k in enumerate(pair):
                x, y, z = self.arms[j, side]
                cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
                turn = np.linalg.inv(bodies.inertia[k])
                moved = np.eye(3) / bodies.mass[k] - cross @ turn @ cross
                out[j, side] = np.linalg.eigvalsh(moved)[-1], np.linalg.eigvalsh(turn)[-1]
        return out

    def _springs(self, joint: Joint, row: int) -> tuple[float, ...]:
        point, turn = 1.0 / self.compliance[row].sum(axis=0)
        servo = joint.servo
        return (
            joint.point_stiffness,
            2.0 * joint.damping * math.sqrt(joint.point_stiffness * point),
            joint.axis_stiffness,
            2.0 * joint.damping * math.sqrt(joint.axis_stiffness * turn),
            servo.gear_stiffness,
            2.0 * servo.gear_damping * math.sqrt(servo.gear_stiffness * turn),
        )

    @property
    def command(self) -> Targets:
        """What the servos aim at."""
        return self._command

    @command.setter
    def command(self, command: Targets) -> None:
        self._command = command
        # Asked once: to look for a protocol's methods costs some microseconds.
        self._sensing = command if isinstance(command, Sensing) else None

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def start(self) -> JointState:
        """All joints at their targets of time zero, at rest."""
        motion = np.zeros((self.count, joint_kernels.MOTION))
        angle = np.asarray(self.command.targets(0.0), dtype=float)
        if angle.shape != (self.count,):
            raise InputError(
                f"the command gives {angle.size} angles and there are {self.count} joints"
            )
        motion[:, joint_kernels.ANGLE] = angle
        motion[:, joint_kernels.ROTOR] = angle
        return {"motion": motion, "spent": np.zeros(3)}

    def place_children(
        self, state: JointState, rigid_x: np.ndarray, rigid_q: np.ndarray, centres: np.ndarray
    ) -> None:
        """Put the children where their parents and angles say; centres and turns move in place."""
        from scipy.spatial.transform import Rotation

        for j, (parent, child) in enumerate(self.bodies):
            frame = Rotation.from_quat(np.roll(rigid_q[parent], -1))
            angle = state["motion"][j, joint_kernels.ANGLE]
            turn = frame * Rotation.from_rotvec(angle * self.axes[j])
            hip = rigid_x[parent] + frame.apply(self.arms[j, 0])
            rigid_x[child] = hip - turn.apply(self.arms[j, 1])
            rigid_q[child] = np.roll(turn.as_quat(), 1)

    def add_loads(
        self,
        time: float,
        rigid: RigidBodies,
        rigid_x: np.ndarray,
        rigid_q: np.ndarray,
        rigid_v: np.ndarray,
        rigid_l: np.ndarray,
        state: JointState,
    ) -> float:
        """Fill `load` with what joints do to the bodies; returns what their springs store [J]."""
        sensing = self._sensing
        begun = () if sensing is None else (self._sense(sensing, time, rigid_q, state),)
        self.target[:] = self.command.targets(time, *begun)
        if self._needs_rates:
            self.target_rate[:] = self.command.rates(time, *begun)
        joint_kernels.spins(
            rigid.inertia, rigid.free, rigid_q, rigid_l, self.rotation, self.omega_before
        )
        joint_kernels.joint_loads(
            self.bodies,
            self.arms,
            self.axes,
            self.references,
            self.stiffness,
            self.servo,
            self.target,
            self.target_rate,
            rigid_x,
            rigid_v,
            self.rotation,
            self.omega_before,
            state["motion"],
            self.load,
            self.damping,
            self.gear_dashpot,
            self.stored,
            self.axis,
        )
        return float(self.stored[:3].sum())

    def _sense(
        self, command: Sensing, time: float, rigid_q: np.ndarray, state: JointState
    ) -> np.ndarray:
        """What has begun of a sensing command, now that the robot has turned as it has.

        The turn is that of the `sensor` joint's parent about y, counted on over whole turns: "turn"
        (2,) [rad] of the state, now and at the first moment. A heading does not disturb it, but for
        one of half a turn, where it is undefined.
        """
        w, _, y, _ = rigid_q[self.bodies[self.sensor, 0]]
        turn = 2.0 * math.atan2(y, w)
        if "begun" not in state:
            state["begun"] = command.nothing_begun()
            state["turn"] = np.array([turn, turn])
        before, first = state["turn"]
        state["turn"][0] = turn + 2.0 * math.pi * round((before - turn) / (2.0 * math.pi))
        command.sense(time, float(state["turn"][0] - first), state["begun"])
        return state["begun"]

    def kick(
        self,
        h: float,
        rigid: RigidBodies,
        rigid_q: np.ndarray,
        rigid_v: np.ndarray,
        rigid_l: np.ndarray,
        v_before: np.ndarray,
        state: JointState,
        spent: np.ndarray,
    ) -> float:
        """Advance the rotors by `h` [s] after the bodies; fills `spent`, returns their energy [J].

        The energy of motion is the mean of before and after, as the kick's is.
        """
        joint_kernels.spins(rigid.inertia, rigid.free, rigid_q, rigid_l, self.rotation, self.omega)
        spent[:] = 0.0
        energy = joint_kernels.kick_rotors(
            h,
            self.bodies,
            self.damping,
            self.gear_dashpot,
            self.axis,
            self.servo,
            self.target,
            v_before,
            self.omega_before,
            rigid_v,
            self.omega,
            state["motion"],
            spent,
        )
        self.stored[joint_kernels.ROTORS] = energy
        return float(energy)

    def rates(self, body_count: int) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of what joints add to the squared highest frequency [1/s2], and damping [1/s].

        Both have a row per body, shape (body_count + 1,); the last is that of the stiffest rotor.

        Gershgorin's bound of the matrix scaled by the roots of the inertias: in the row of a body,
        a spring k between compliances c and c' counts ``k (c + sqrt(c c'))``. The rotors have
        their own rows.
        """
        inertia = self.servo[:, joint_kernels.INERTIA]
        gains = self.servo[:, (joint_kernels.PROPORTIONAL, joint_kernels.DERIVATIVE)]
        out = []
        for kind in range(2):  # springs, dashpots
            point, axis, gear = self.stiffness[:, kind : joint_kernels.STIFFNESS : 2].T
            rows = np.zeros(body_count + 1)
            for side in range(2):
                moved, turned = self.compliance[:, side].T
                other_moved, other_turned = self.compliance[:, 1 - side].T
                part = point * (moved + np.sqrt(moved * other_moved))
                part += (axis + gear) * (turned + np.sqrt(turned * other_turned))
                part += gear * np.sqrt(turned / inertia)
                np.add.at(rows, self.bodies[:, side], part)
            turned = self.compliance[:, :, 1]
            rotors = (gear + gains[:, kind]) / inertia
            rotors += gear * np.sqrt(turned / inertia[:, None]).sum(axis=1)
            rows[-1] = rotors.max(initial=0.0)
            out.append(rows)
        return out[0], out[1]


def _across(axis: np.ndarray) -> np.ndarray:
    """A unit vector across `axis`."""
    away = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = away - (away @ axis) * axis
    return np.asarray(across / np.linalg.norm(across))
