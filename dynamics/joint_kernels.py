"""Kernels of revolute joints with servos between rigid bodies.

A joint holds a point and an axis of a child body to those of its parent by stiff springs with
dashpots (what bearing and horn give way by), and lets the child turn about the axis. Its servo is
a motor behind a gear: a rotor of reflected inertia J that turns by phi relative to the parent,
and a gear's spring between the rotor and the child's angle theta,

    J phi'' = tau - T,    T = k_g (phi - theta) + c_g (phi' - theta'),

where tau is what the controller asks for, within what the motor can give. T turns the child and
its reverse the parent. (The rotor's own reaction on the parent is less than J phi'' by the gear's
ratio and is left out.) So reflected inertia needs no acceleration of the bodies, and the motor
works against the gear only: momentum of the bodies is kept to round-off.

All forces are equal and opposite at one point of space, springs pull along the line between both
ends, and torques come in pairs. Velocities are half a step old, as everywhere in the engine.

Arrays, n joints: `bodies` (n, 2) rows of parent and child; `arms` (n, 2, 3) from each body's
centre to the joint [m], `axes` (n, 3) and `references` (n, 3) unit vectors across each other, both
alike in the body axes of parent and child, which agree where the angle is zero; `stiffness` (n,
STIFFNESS) and `servo` (n, SERVO), see the indices.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.jit import inline_kernel, kernel
from flexapod.dynamics.rigid_kernels import _angular_velocity

# Columns of `stiffness`: of the point [N/m, N s/m], of the axis [N m/rad, N m s/rad], of the gear.
POINT_SPRING, POINT_DASHPOT, AXIS_SPRING, AXIS_DASHPOT, GEAR_SPRING, GEAR_DASHPOT = range(6)
STIFFNESS = 6
# Columns of `servo`: gains of the controller, what the motor can give, reflected inertia, and the
# part of the target's rate that the controller knows.
PROPORTIONAL, INTEGRAL, DERIVATIVE, STALL, NO_LOAD, INERTIA, RATE_WEIGHT = range(7)
SERVO = 7
# Columns of a joint's `motion` (n, 7): angle of the child, of the rotor [rad], the rotor's rate,
# the integral of the error [rad s], motor and gear torque [N m], and what the controller asked for
# beyond what the motor gives [N m].
ANGLE, ROTOR, RATE, SUM, MOTOR, GEAR, BEYOND = range(7)
MOTION = 7
# Entries of `spent`: work of the motors, what dashpots took [J], and, of the servos, only the
# positive part of the motors' work: what a battery that takes nothing back has to give.
WORK, LOSS, DRAWN = range(3)
# Entries of `stored`: in springs of points, axes and gears, and the rotors' energy of motion [J].
POINTS, AXES, GEARS, ROTORS = range(4)


@inline_kernel
def _frame(rotation: Any, local: Any, out: Any) -> None:
    for i in range(3):
        out[i] = rotation[i, 0] * local[0] + rotation[i, 1] * local[1] + rotation[i, 2] * local[2]


@inline_kernel
def _cross(a: Any, b: Any, out: Any) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inline_kernel
def _push(load: Any, body: int, x: Any, point: Any, force: Any, sign: float) -> None:
    """Add ``sign force`` at `point` to a body's load (6,) about its centre `x`."""
    r0 = point[0] - x[0]
    r1 = point[1] - x[1]
    r2 = point[2] - x[2]
    load[body, 0] += sign * force[0]
    load[body, 1] += sign * force[1]
    load[body, 2] += sign * force[2]
    load[body, 3] += sign * (r1 * force[2] - r2 * force[1])
    load[body, 4] += sign * (r2 * force[0] - r0 * force[2])
    load[body, 5] += sign * (r0 * force[1] - r1 * force[0])


@kernel
def spins(inertia: Any, free: Any, rigid_q: Any, rigid_l: Any, rotation: Any, omega: Any) -> None:
    """Fill `rotation` (body_count, 3, 3) and `omega` (body_count, 3) [rad/s], world axes."""
    a = np.empty((3, 3))
    for k in range(rigid_q.shape[0]):
        _angular_velocity(inertia[k], free[k], rigid_q[k], rigid_l[k], rotation[k], a, omega[k])


@kernel
def motor_torque(wanted: float, rate: float, stall: float, no_load: float) -> float:
    """What a motor gives of a `wanted` torque [N m] at a rate [rad/s].

    In the sense of its turning at most ``stall (1 - |rate| / no_load)``, and never below nothing;
    against it, when it brakes, at most the stall torque.
    """
    most = stall * min(max(1.0 - rate / no_load, 0.0), 1.0)
    least = -stall * min(max(1.0 + rate / no_load, 0.0), 1.0)
    return min(max(wanted, least), most)


@kernel
def joint_loads(
    bodies: Any,
    arms: Any,
    axes: Any,
    references: Any,
    stiffness: Any,
    servo: Any,
    target: Any,
    target_rate: Any,
    rigid_x: Any,
    rigid_v: Any,
    rotation: Any,
    omega: Any,
    motion: Any,
    load: Any,
    damping: Any,
    gear_dashpot: Any,
    stored: Any,
    axis: Any,
) -> None:
    """Forces and torques of all joints at the present positions.

    Parameters
    ----------
    target, target_rate
        What the controllers aim at [rad, rad/s], shape (n,).
    rigid_x, rigid_v, rotation, omega
        Of the bodies, as in `rigid_kernels` and `spins`.
    motion
        Shape (n, MOTION): ANGLE, MOTOR, GEAR and BEYOND are written.
    load
        Overwritten: force and torque about the centre of each body, shape (body_count, 6).
    damping
        Overwritten: the part of it that dashpots make, the gears' too, shape (n, 2, 6), of parent
        and child; what the ledger counts as loss.
    gear_dashpot
        Overwritten: the gears' part of it [N m], shape (n,).
    stored
        Overwritten, shape (4,), see the indices.
    axis
        Overwritten: the joints' axes in space, shape (n, 3).
    """
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    e, f = np.empty(3), np.empty(3)
    one, two, middle = np.empty(3), np.empty(3), np.empty(3)
    force, turn = np.empty(3), np.empty(3)
    load[:] = 0.0
    damping[:] = 0.0
    stored[:] = 0.0
    for j in range(bodies.shape[0]):
        p, q = bodies[j, 0], bodies[j, 1]
        _frame(rotation[p], arms[j, 0], one)
        _frame(rotation[q], arms[j, 1], two)
        square = 0.0
        for i in range(3):
            one[i] += rigid_x[p, i]
            two[i] += rigid_x[q, i]
            middle[i] = 0.5 * (one[i] + two[i])
            force[i] = stiffness[j, POINT_SPRING] * (two[i] - one[i])
            square += (two[i] - one[i]) ** 2
        stored[POINTS] += 0.5 * stiffness[j, POINT_SPRING] * square
        _push(load, p, rigid_x[p], one, force, 1.0)
        _push(load, q, rigid_x[q], two, force, -1.0)
        # Velocities of both bodies at one point of space, so that no torque is left over.
        for i in range(3):
            c[i] = omega[q, i]
            turn[i] = omega[p, i]
        for i in range(3):
            e[i] = middle[i] - rigid_x[q, i]
            f[i] = middle[i] - rigid_x[p, i]
        _cross(c, e, a)
        _cross(turn, f, b)
        for i in range(3):
            approach = rigid_v[q, i] + a[i] - rigid_v[p, i] - b[i]
            force[i] = stiffness[j, POINT_DASHPOT] * approach
        _push(damping[j], 0, rigid_x[p], middle, force, 1.0)
        _push(damping[j], 1, rigid_x[q], middle, force, -1.0)

        _frame(rotation[p], axes[j], a)
        _frame(rotation[q], axes[j], b)
        _frame(rotation[p], references[j], e)
        _frame(rotation[q], references[j], f)
        _cross(a, b, turn)
        cosine = 0.0
        length = 0.0
        for i in range(3):
            cosine += a[i] * b[i]
            axis[j, i] = a[i] + b[i]
            length += axis[j, i] ** 2
        length = math.sqrt(length)
        stored[AXES] += stiffness[j, AXIS_SPRING] * (1.0 - cosine)
        rate = 0.0
        for i in range(3):
            axis[j, i] /= length
            load[p, 3 + i] += stiffness[j, AXIS_SPRING] * turn[i]
            load[q, 3 + i] -= stiffness[j, AXIS_SPRING] * turn[i]
            rate += axis[j, i] * (omega[q, i] - omega[p, i])
        _cross(e, f, c)
        sine = 0.0
        cosine = 0.0
        for i in range(3):
            across = omega[q, i] - omega[p, i] - rate * axis[j, i]
            damping[j, 0, 3 + i] += stiffness[j, AXIS_DASHPOT] * across
            damping[j, 1, 3 + i] -= stiffness[j, AXIS_DASHPOT] * across
            sine += axis[j, i] * c[i]
            cosine += e[i] * f[i]
        angle = math.atan2(sine, cosine)
        turns = math.floor((motion[j, ANGLE] - angle) / (2.0 * math.pi) + 0.5)
        angle += 2.0 * math.pi * turns
        motion[j, ANGLE] = angle

        rotor, rotor_rate = motion[j, ROTOR], motion[j, RATE]
        twist = rotor - angle
        spring = stiffness[j, GEAR_SPRING] * twist
        dashpot = stiffness[j, GEAR_DASHPOT] * (rotor_rate - rate)
        stored[GEARS] += 0.5 * spring * twist
        for i in range(3):
            load[q, 3 + i] += spring * axis[j, i]
            load[p, 3 + i] -= spring * axis[j, i]
            damping[j, 1, 3 + i] += dashpot * axis[j, i]
            damping[j, 0, 3 + i] -= dashpot * axis[j, i]
        wanted = (
            servo[j, PROPORTIONAL] * (target[j] - rotor)
            + servo[j, INTEGRAL] * motion[j, SUM]
            + servo[j, DERIVATIVE] * (servo[j, RATE_WEIGHT] * target_rate[j] - rotor_rate)
        )
        motion[j, MOTOR] = motor_torque(wanted, rotor_rate, servo[j, STALL], servo[j, NO_LOAD])
        motion[j, BEYOND] = wanted - motion[j, MOTOR]
        motion[j, GEAR] = spring + dashpot
        gear_dashpot[j] = dashpot
        for i in range(6):
            load[p, i] += damping[j, 0, i]
            load[q, i] += damping[j, 1, i]


@kernel
def kick_rotors(
    h: float,
    bodies: Any,
    damping: Any,
    gear_dashpot: Any,
    axis: Any,
    servo: Any,
    target: Any,
    v_before: Any,
    omega_before: Any,
    rigid_v: Any,
    omega: Any,
    motion: Any,
    spent: Any,
) -> float:
    """Advance the rotors by `h` [s], after the bodies; returns their mean energy of motion [J].

    `spent` (3,) gets the works of this kick, from the mean of the velocities before and after,
    so that they are the change of energy to round-off.
    """
    energy = 0.0
    for j in range(bodies.shape[0]):
        before = motion[j, RATE]
        inertia = servo[j, INERTIA]
        after = before + h * (motion[j, MOTOR] - motion[j, GEAR]) / inertia
        motion[j, RATE] = after
        mean = 0.5 * (before + after)
        energy += 0.25 * inertia * (before * before + after * after)
        work = h * motion[j, MOTOR] * mean
        spent[WORK] += work
        spent[DRAWN] += max(work, 0.0)
        lost = 0.0
        for side in range(2):
            k = bodies[j, side]
            for i in range(3):
                lost -= damping[j, side, i] * 0.5 * (v_before[k, i] + rigid_v[k, i])
                lost -= damping[j, side, 3 + i] * 0.5 * (omega_before[k, i] + omega[k, i])
        # The gear's dashpot also pulls at the rotor.
        lost += gear_dashpot[j] * mean
        spent[LOSS] += h * lost
        # No winding up while the motor cannot follow: its torque is not what is asked for.
        wanted = target[j] - motion[j, ROTOR]
        if not wanted * motion[j, BEYOND] > 0.0:
            motion[j, SUM] += h * wanted
    return energy


@kernel
def drift_rotors(dt: float, motion: Any) -> None:
    """Advance the rotors' angles by `dt` [s]."""
    for j in range(motion.shape[0]):
        motion[j, ROTOR] += dt * motion[j, RATE]
