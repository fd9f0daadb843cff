"""Kernels of rigid bodies: loads, kick, drift, and the surface nodes they carry.

Each body has six degrees of freedom: its centre with a velocity, and a quaternion with the
angular momentum L about the centre in *world* axes. With half-step momenta one step of length
dt, h the mean of this step and the one before, is

    kick    v += h F / m                 L += h T
    drift   x += dt v                    q <- exp(dt omega) q,
            omega = I(q_mid)^-1 L,       q_mid = exp(dt/2 omega) q

the midpoint rule on the group of rotations (P. Krysl, Explicit momentum-conserving integrator
for dynamics of rigid bodies approximating the midpoint Lie algorithm, Int. J. Numer. Meth. Engng
2005). A free body keeps L to the last bit; its energy oscillates by O(dt^2). The implicit omega
comes from a fixed-point iteration that contracts by about dt |omega| / 2, so it is meant for
steps of a small part of a radian.

Locked axes are world axes: omega solves I_ff omega_f = L_f over the free ones and is zero about
the others, whose part of L is kept at zero (the lock's own torque takes it).

Work: the momentum changes at one attitude, so the nodal forces' work over a kick,
sum h f . (v_before + v_after) / 2 with both velocities from `place`, is the change of `kinetic`
to round-off. The drift then changes it by O(dt^3), the truncation of the rotation.

Arrays: ``mass`` (body_count,) [kg], ``inertia`` (body_count, 3, 3) [kg m2] in body axes, ``free``
(body_count, 6) bool, world x y z and turns about them; ``rigid_x`` [m], ``rigid_v`` [m/s],
``rigid_l`` [kg m2/s], each (body_count, 3), and ``rigid_q`` (body_count, 4), unit quaternions
(w, x, y, z) from body to world axes. ``owner`` (node_count,) is each node's body, ``owned_nodes``
(owned_count,) the nodes that have one, ``local`` (node_count, 3) [m] their positions from the
centre in body axes; rows of other nodes are not read.

``kick`` leaves ``inertia`` and ``rigid_q`` unread, ``drift`` the masses: one list of arrays
serves all.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.jit import inline_kernel, kernel

# Each round adds one order of dt to the midpoint's angular velocity; odd orders left over make the
# energy drift. After three rounds that is dt^5: per step, of the energy, 1e-9 at 0.1 rad and 1e-15
# at 0.01 rad. Two rounds more would gain the factor dt^2.
ROUNDS = 3


@inline_kernel
def _rotation(q: Any, r: Any) -> None:
    """Fill `r` (3, 3) with the rotation of the unit quaternion `q`, body to world."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    r[0, 1] = 2.0 * (x * y - w * z)
    r[0, 2] = 2.0 * (x * z + w * y)
    r[1, 0] = 2.0 * (x * y + w * z)
    r[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    r[1, 2] = 2.0 * (y * z - w * x)
    r[2, 0] = 2.0 * (x * z - w * y)
    r[2, 1] = 2.0 * (y * z + w * x)
    r[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inline_kernel
def _turn(q: Any, omega: Any, dt: float, out: Any) -> None:
    """Fill `out` with exp(dt omega) q, normalised; `out` may be `q`. `omega` in world axes."""
    speed = math.sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2)
    ew = math.cos(0.5 * dt * speed)
    s = math.sin(0.5 * dt * speed) / speed if speed > 0.0 else 0.0
    ex = s * omega[0]
    ey = s * omega[1]
    ez = s * omega[2]
    w = ew * q[0] - ex * q[1] - ey * q[2] - ez * q[3]
    x = ew * q[1] + ex * q[0] + ey * q[3] - ez * q[2]
    y = ew * q[2] + ey * q[0] + ez * q[1] - ex * q[3]
    z = ew * q[3] + ez * q[0] + ex * q[2] - ey * q[1]
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    out[0] = scale * w
    out[1] = scale * x
    out[2] = scale * y
    out[3] = scale * z


@inline_kernel
def _angular_velocity(
    inertia: Any, free: Any, q: Any, momentum: Any, r: Any, a: Any, omega: Any
) -> None:
    """Fill `omega` (3,) [rad/s], world axes, and `r` (3, 3), the rotation, of one body.

    `a` (3, 3) is work space.
    """
    _rotation(q, r)
    for i in range(3):
        for j in range(i + 1):
            s = 0.0
            for m in range(3):
                for n in range(3):
                    s += r[i, m] * inertia[m, n] * r[j, n]
            a[i, j] = s
    for i in range(3):
        omega[i] = momentum[i]
        if not free[3 + i]:
            # An equation of its own, omega_i = 0, that the others do not see.
            for j in range(3):
                a[max(i, j), min(i, j)] = 0.0
            a[i, i] = 1.0
            omega[i] = 0.0
    # L D L^T of the lower half: stable for every positive definite matrix.
    l10 = a[1, 0] / a[0, 0]
    l20 = a[2, 0] / a[0, 0]
    d1 = a[1, 1] - l10 * a[1, 0]
    b21 = a[2, 1] - l20 * a[1, 0]
    l21 = b21 / d1
    d2 = a[2, 2] - l20 * a[2, 0] - l21 * b21
    omega[1] -= l10 * omega[0]
    omega[2] -= l20 * omega[0] + l21 * omega[1]
    omega[2] /= d2
    omega[1] = omega[1] / d1 - l21 * omega[2]
    omega[0] = omega[0] / a[0, 0] - l10 * omega[1] - l20 * omega[2]


@kernel
def sum_loads(x: Any, force: Any, owned_nodes: Any, owner: Any, rigid_x: Any, load: Any) -> None:
    """Fill `load` (body_count, 6): force [N] and torque about the centre [N m], world axes.

    `x` [m] and `force` [N] have shape (node_count, 3). In the order of `owned_nodes`, one after
    the other: the same bits every time.
    """
    load[:] = 0.0
    n = 0
    while n < owned_nodes.shape[0]:
        # Nodes of one body follow each other: their sums stay in registers.
        k = owner[owned_nodes[n]]
        x0, x1, x2 = rigid_x[k, 0], rigid_x[k, 1], rigid_x[k, 2]
        l0, l1, l2 = load[k, 0], load[k, 1], load[k, 2]
        l3, l4, l5 = load[k, 3], load[k, 4], load[k, 5]
        while n < owned_nodes.shape[0] and owner[owned_nodes[n]] == k:
            node = owned_nodes[n]
            r0 = x[node, 0] - x0
            r1 = x[node, 1] - x1
            r2 = x[node, 2] - x2
            f0 = force[node, 0]
            f1 = force[node, 1]
            f2 = force[node, 2]
            l0 += f0
            l1 += f1
            l2 += f2
            l3 += r1 * f2 - r2 * f1
            l4 += r2 * f0 - r0 * f2
            l5 += r0 * f1 - r1 * f0
            n += 1
        load[k, 0], load[k, 1], load[k, 2] = l0, l1, l2
        load[k, 3], load[k, 4], load[k, 5] = l3, l4, l5


@kernel
def kick(
    h: float,
    load: Any,
    mass: Any,
    inertia: Any,
    free: Any,
    rigid_q: Any,
    rigid_v: Any,
    rigid_l: Any,
) -> None:
    """Advance momenta by `h` [s] under `load` (body_count, 6), weight included [N, N m].

    Velocity and angular momentum along locked axes are set to zero.
    """
    for k in range(mass.shape[0]):
        for i in range(3):
            if free[k, i]:
                rigid_v[k, i] += h * load[k, i] / mass[k]
            else:
                rigid_v[k, i] = 0.0
            if free[k, 3 + i]:
                rigid_l[k, i] += h * load[k, 3 + i]
            else:
                rigid_l[k, i] = 0.0


@kernel
def drift(
    dt: float,
    mass: Any,
    inertia: Any,
    free: Any,
    rigid_x: Any,
    rigid_q: Any,
    rigid_v: Any,
    rigid_l: Any,
) -> None:
    """Advance centres and quaternions by `dt` [s] at the momenta in between."""
    r = np.empty((3, 3))
    a = np.empty((3, 3))
    omega = np.empty(3)
    middle = np.empty(4)
    for k in range(rigid_x.shape[0]):
        for i in range(3):
            rigid_x[k, i] += dt * rigid_v[k, i]
        _angular_velocity(inertia[k], free[k], rigid_q[k], rigid_l[k], r, a, omega)
        for _ in range(ROUNDS):
            _turn(rigid_q[k], omega, 0.5 * dt, middle)
            _angular_velocity(inertia[k], free[k], middle, rigid_l[k], r, a, omega)
        _turn(rigid_q[k], omega, dt, rigid_q[k])


@kernel
def place(
    owned_nodes: Any,
    owner: Any,
    local: Any,
    inertia: Any,
    free: Any,
    rigid_x: Any,
    rigid_q: Any,
    rigid_v: Any,
    rigid_l: Any,
    x: Any,
    v: Any,
) -> None:
    """Set positions `x` [m] and velocities `v` [m/s], shape (node_count, 3), of owned nodes.

    x = rigid_x + R(q) local,  v = rigid_v + omega x (x - rigid_x). Other nodes are left alone.
    """
    count = rigid_x.shape[0]
    rotation = np.empty((count, 3, 3))
    omega = np.empty((count, 3))
    a = np.empty((3, 3))
    for k in range(count):
        _angular_velocity(inertia[k], free[k], rigid_q[k], rigid_l[k], rotation[k], a, omega[k])
    n = 0
    while n < owned_nodes.shape[0]:
        k = owner[owned_nodes[n]]
        r = rotation[k]
        r00, r01, r02 = r[0, 0], r[0, 1], r[0, 2]
        r10, r11, r12 = r[1, 0], r[1, 1], r[1, 2]
        r20, r21, r22 = r[2, 0], r[2, 1], r[2, 2]
        x0, x1, x2 = rigid_x[k, 0], rigid_x[k, 1], rigid_x[k, 2]
        v0, v1, v2 = rigid_v[k, 0], rigid_v[k, 1], rigid_v[k, 2]
        w0, w1, w2 = omega[k, 0], omega[k, 1], omega[k, 2]
        while n < owned_nodes.shape[0] and owner[owned_nodes[n]] == k:
            node = owned_nodes[n]
            p0, p1, p2 = local[node, 0], local[node, 1], local[node, 2]
            a0 = r00 * p0 + r01 * p1 + r02 * p2
            a1 = r10 * p0 + r11 * p1 + r12 * p2
            a2 = r20 * p0 + r21 * p1 + r22 * p2
            x[node, 0] = x0 + a0
            x[node, 1] = x1 + a1
            x[node, 2] = x2 + a2
            v[node, 0] = v0 + w1 * a2 - w2 * a1
            v[node, 1] = v1 + w2 * a0 - w0 * a2
            v[node, 2] = v2 + w0 * a1 - w1 * a0
            n += 1


@kernel
def kinetic(mass: Any, inertia: Any, free: Any, rigid_q: Any, rigid_v: Any, rigid_l: Any) -> float:
    """Kinetic energy of all bodies [J]: sum of m v.v / 2 + omega.L / 2."""
    r = np.empty((3, 3))
    a = np.empty((3, 3))
    omega = np.empty(3)
    energy = 0.0
    for k in range(mass.shape[0]):
        _angular_velocity(inertia[k], free[k], rigid_q[k], rigid_l[k], r, a, omega)
        for i in range(3):
            energy += 0.5 * (mass[k] * rigid_v[k, i] ** 2 + omega[i] * rigid_l[k, i])
    return energy


@kernel
def kick_weighed(
    h: float,
    gravity: Any,
    damping: float,
    load: Any,
    mass: Any,
    inertia: Any,
    free: Any,
    rigid_q: Any,
    rigid_v: Any,
    rigid_l: Any,
    before: Any,
    out: Any,
) -> None:
    """`kick` under `load` (body_count, 6) and weight, slowed by a mass `damping` [1/s].

    `load` gains both, `before` (body_count, 3) receives the velocities before. `out` (2,) receives
    the mean of the kinetic energies before and after, and the work of the damping [J].
    """
    first = kinetic(mass, inertia, free, rigid_q, rigid_v, rigid_l)
    moving = 0.0
    for k in range(mass.shape[0]):
        for i in range(3):
            before[k, i] = rigid_v[k, i]
            moving += 0.5 * mass[k] * rigid_v[k, i] ** 2
            load[k, i] += mass[k] * (gravity[i] - damping * rigid_v[k, i])
            load[k, 3 + i] -= damping * rigid_l[k, i]
    kick(h, load, mass, inertia, free, rigid_q, rigid_v, rigid_l)
    power = 0.0
    for k in range(mass.shape[0]):
        for i in range(3):
            power += mass[k] * before[k, i] * 0.5 * (before[k, i] + rigid_v[k, i])
    out[0] = 0.5 * (first + kinetic(mass, inertia, free, rigid_q, rigid_v, rigid_l))
    # L . omega is twice the energy of the spin.
    out[1] = -h * damping * (power + 2.0 * (first - moving))
