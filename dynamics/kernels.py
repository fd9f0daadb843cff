"""Kernels of the explicit step: pressure, kick, drift, bonds and the stable step."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.contact.ground_kernels import gap_and_normal
from flexapod.core.jit import inline_kernel, kernel, parallel_kernel

# Sums over nodes run in this many fixed parts, added in order: the same bits for any number of
# threads.
PARTS = 64


@inline_kernel
def _bilinear(x0: float, x1: float, x2: float, x3: float) -> tuple[float, float, float]:
    """Coefficients of xi, eta and xi eta of the field with these corner values."""
    return (
        0.25 * ((x1 - x0) + (x2 - x3)),
        0.25 * ((x3 - x0) + (x2 - x1)),
        0.25 * ((x0 - x1) + (x2 - x3)),
    )


@inline_kernel
def _corner_pressure(
    p: float, out: Any, a0: float, a1: float, b0: float, b1: float, c0: float, c1: float
) -> None:
    """One component of `face_pressure` from the coefficients' two others, in cyclic order."""
    mean = -p * (a0 * b1 - a1 * b0)
    along = -p / 3.0 * (a0 * c1 - a1 * c0)
    across = -p / 3.0 * (c0 * b1 - c1 * b0)
    out[0] = mean - along - across
    out[1] = mean + along - across
    out[2] = mean + along + across
    out[3] = mean - along + across


@parallel_kernel
def face_pressure(x: Any, faces: Any, chamber: Any, pressure: Any, out: Any) -> None:
    """Nodal forces of a follower pressure on faces that look into their chambers.

    `chamber` (face_count,) is the row of `pressure` [Pa]; `out` (face_count, 4, 3) receives
    external forces [N], ``-p * integral(N_a n da)``.

    With ``x = m + xi a + eta b + xi eta c`` the area vector is ``a x b + xi a x c + eta c x b``;
    N_a picks from it a third of each slope with its corner's signs.
    """
    for f in numba.prange(faces.shape[0]):
        p = pressure[chamber[f]]
        n0, n1, n2, n3 = faces[f, 0], faces[f, 1], faces[f, 2], faces[f, 3]
        a0, b0, c0 = _bilinear(x[n0, 0], x[n1, 0], x[n2, 0], x[n3, 0])
        a1, b1, c1 = _bilinear(x[n0, 1], x[n1, 1], x[n2, 1], x[n3, 1])
        a2, b2, c2 = _bilinear(x[n0, 2], x[n1, 2], x[n2, 2], x[n3, 2])
        _corner_pressure(p, out[f, :, 0], a1, a2, b1, b2, c1, c2)
        _corner_pressure(p, out[f, :, 1], a2, a0, b2, b0, c2, c0)
        _corner_pressure(p, out[f, :, 2], a0, a1, b0, b1, c0, c1)


@parallel_kernel
def gather_faces(face_force: Any, nodes: Any, start: Any, entry: Any, out: Any) -> None:
    """Write the sums of `face_force` (face_count, 4, 3) at `nodes` into `out` (node_count, 3).

    Node ``nodes[k]`` owns the entries ``entry[start[k]:start[k + 1]]`` of the flattened corners.
    """
    for k in numba.prange(nodes.shape[0]):
        f0 = 0.0
        f1 = 0.0
        f2 = 0.0
        for e in range(start[k], start[k + 1]):
            f = entry[e] // 4
            a = entry[e] % 4
            f0 += face_force[f, a, 0]
            f1 += face_force[f, a, 1]
            f2 += face_force[f, a, 2]
        out[nodes[k], 0] = f0
        out[nodes[k], 1] = f1
        out[nodes[k], 2] = f2


@inline_kernel
def kick_part(
    part: int,
    first: int,
    last: int,
    h: float,
    damping: float,
    gravity: Any,
    mass: Any,
    heavy: Any,
    owner: Any,
    fixed: Any,
    internal: Any,
    pressure: Any,
    elastic: Any,
    dissipative: Any,
    viscous: Any,
    v: Any,
    total: Any,
    parts: Any,
) -> None:
    """`kick` of the nodes from `first` up to `last`, with its sums in row `part`."""
    kinetic = 0.0
    work_internal = 0.0
    work_pressure = 0.0
    work_dissipative = 0.0
    work_damping = 0.0
    work_viscous = 0.0
    fastest = 0.0
    taken = 1.0 / (1.0 + 0.5 * damping * h)
    kept = taken * (1.0 - 0.5 * damping * h)
    for node in range(first, last):
        if owner[node] >= 0:
            for i in range(3):
                total[node, i] = (
                    pressure[node, i]
                    + elastic[node, i]
                    + dissipative[node, i]
                    - internal[node, i]
                    - viscous[node, i]
                )
            continue
        m = mass[node]
        r = taken * h / m
        speed = 0.0
        for i in range(3):
            if fixed[node, i]:
                v[node, i] = 0.0
                continue
            f = (
                pressure[node, i]
                + elastic[node, i]
                + dissipative[node, i]
                - internal[node, i]
                - viscous[node, i]
                + heavy[node] * gravity[i]
            )
            before = v[node, i]
            after = kept * before + r * f
            v[node, i] = after
            mean = 0.5 * (before + after)
            way = h * mean
            kinetic += 0.5 * m * mean * mean
            work_internal -= internal[node, i] * way
            work_pressure += pressure[node, i] * way
            work_dissipative += dissipative[node, i] * way
            work_damping -= damping * m * mean * way
            work_viscous -= viscous[node, i] * way
            speed += after * after
        fastest = max(fastest, speed)
    parts[part, 0] = kinetic
    parts[part, 1] = work_internal
    parts[part, 2] = work_pressure
    parts[part, 3] = work_dissipative
    parts[part, 4] = work_damping
    parts[part, 5] = work_viscous
    parts[part, 6] = fastest


@parallel_kernel
def kick(
    h: float,
    damping: float,
    gravity: Any,
    mass: Any,
    heavy: Any,
    owner: Any,
    fixed: Any,
    internal: Any,
    pressure: Any,
    elastic: Any,
    dissipative: Any,
    viscous: Any,
    v: Any,
    total: Any,
    parts: Any,
) -> None:
    """Advance the velocities of free nodes by `h` [s] and sum the work of the forces.

    `mass` (node_count,) resists, `heavy` has weight [kg]. `damping` [1/s] acts on the mass, at the
    middle of the kick. `total` (node_count, 3) receives
    the force without gravity at nodes a rigid body owns. `internal` and `viscous` are forces the
    body resists with. `parts` (PARTS, 7) receives, per part of the nodes: kinetic energy of the
    mean velocity [J], the work [J] of the internal forces (as forces on the nodes), of pressure,
    of `dissipative`, of the mass damping and of `viscous`, and the largest squared speed [m2/s2].
    """
    count = v.shape[0]
    for part in numba.prange(PARTS):
        kick_part(
            part,
            part * count // PARTS,
            (part + 1) * count // PARTS,
            h,
            damping,
            gravity,
            mass,
            heavy,
            owner,
            fixed,
            internal,
            pressure,
            elastic,
            dissipative,
            viscous,
            v,
            total,
            parts,
        )


@kernel
def add_parts(parts: Any, out: Any) -> None:
    """Add the parts of `kick` in order into `out` (7,); the last entry is the largest."""
    for k in range(6):
        s = 0.0
        for p in range(parts.shape[0]):
            s += parts[p, k]
        out[k] = s
    largest = 0.0
    for p in range(parts.shape[0]):
        largest = max(largest, parts[p, 6])
    out[6] = largest


@kernel
def owned_work(
    h: float,
    owned: Any,
    before: Any,
    v: Any,
    internal: Any,
    pressure: Any,
    dissipative: Any,
    viscous: Any,
    out: Any,
) -> None:
    """Add the work of forces on nodes of rigid bodies to `out` (7,), entries as of `kick`."""
    by_internal, by_pressure, by_dissipative, by_viscous = out[1], out[2], out[3], out[5]
    fastest = out[6]
    for k in range(owned.shape[0]):
        node = owned[k]
        speed = 0.0
        for i in range(3):
            way = 0.5 * h * (before[k, i] + v[node, i])
            by_internal -= internal[node, i] * way
            by_pressure += pressure[node, i] * way
            by_dissipative += dissipative[node, i] * way
            by_viscous -= viscous[node, i] * way
            speed += v[node, i] * v[node, i]
        fastest = max(fastest, speed)
    out[1], out[2], out[3], out[5] = by_internal, by_pressure, by_dissipative, by_viscous
    out[6] = fastest


@kernel
def drift(dt: float, nodes: Any, v: Any, u: Any, x: Any) -> None:
    """Move nodes: ``u += dt v`` and ``x = nodes + u``, all (node_count, 3).

    Those of rigid bodies too, in vain: they are put in their places afterwards. To share out so
    little work among threads takes longer than to do it.
    """
    rest, way, at, place = nodes.reshape(-1), v.reshape(-1), u.reshape(-1), x.reshape(-1)
    for k in range(at.shape[0]):
        moved = at[k] + dt * way[k]
        at[k] = moved
        place[k] = rest[k] + moved


@kernel
def owned_displacement(owned: Any, nodes: Any, x: Any, u: Any) -> None:
    """Write ``u = x - nodes`` at nodes of rigid bodies."""
    for k in range(owned.shape[0]):
        node = owned[k]
        for i in range(3):
            u[node, i] = x[node, i] - nodes[node, i]


@kernel
def shifted(u: Any, v: Any, time: float, out: Any) -> None:
    """``out = u + time v``: where the internal force carries stiffness damping."""
    at, way, to = u.reshape(-1), v.reshape(-1), out.reshape(-1)
    for k in range(at.shape[0]):
        to[k] = at[k] + time * way[k]


@kernel
def bond_forces(
    x: Any,
    v: Any,
    pairs: Any,
    stiffness: Any,
    length: Any,
    left: float,
    damping: float,
    force: Any,
    dissipative: Any,
    totals: Any,
) -> None:
    """Add rods between pairs of nodes, (pair_count,), of `stiffness` [N/m].

    Their rest length is the share `left` of `length` [m]. `damping` [s] is the ratio of dashpot to
    spring. `totals` (5,) receives the energy [J], the resultant of the stretched rods on the first
    nodes [N] (3) and the largest change of length [m].
    """
    for k in range(5):
        totals[k] = 0.0
    along = np.empty(3)
    for k in range(pairs.shape[0]):
        a = pairs[k, 0]
        b = pairs[k, 1]
        square = 0.0
        for i in range(3):
            along[i] = x[b, i] - x[a, i]
            square += along[i] * along[i]
        now = math.sqrt(square)
        change = now - left * length[k]
        totals[0] += 0.5 * stiffness[k] * change * change
        totals[4] = max(totals[4], abs(change))
        if now < 1e-12:
            continue
        rate = 0.0
        for i in range(3):
            along[i] /= now
            rate += (v[b, i] - v[a, i]) * along[i]
        s = stiffness[k] * change
        r = damping * stiffness[k] * rate
        for i in range(3):
            force[a, i] += s * along[i]
            force[b, i] -= s * along[i]
            dissipative[a, i] += r * along[i]
            dissipative[b, i] -= r * along[i]
            # What only props the ends apart does not open a bond.
            if s > 0.0:
                totals[1 + i] += (s + r) * along[i]


@inline_kernel
def _product_block(a: Any, i: int, j: int) -> Any:
    """Rows i to i + 2, columns j to j + 2 of the square of a symmetric matrix of order 24.

    Nine sums at once keep in registers what one after the other would read again.
    """
    s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
    for k in range(24):
        x, y, z = a[k, i], a[k, i + 1], a[k, i + 2]
        p, q, r = a[k, j], a[k, j + 1], a[k, j + 2]
        s00 += x * p
        s01 += x * q
        s02 += x * r
        s10 += y * p
        s11 += y * q
        s12 += y * r
        s20 += z * p
        s21 += z * q
        s22 += z * r
    return s00, s01, s02, s10, s11, s12, s20, s21, s22


@parallel_kernel
def element_rates(
    tangents: Any, pair_of: Any, cells: Any, element_mass: Any, stiffening: float, out: Any
) -> None:
    """Bound of the square of each element's highest frequency [1/s2], shape (cell_count,).

    With ``A = M**-1/2 K M**-1/2`` of the element's own mass, ``trace(A**8)**(1/8)`` bounds the
    largest eigenvalue from above, and by at most ``24**(1/8)``. The largest over the elements
    bounds the assembled mesh's (B. M. Irons & G. Treharne, A bound theorem in eigenvalues and
    its practical application, 1971). `tangents` (cell_count, 36, 3, 3) are the blocks of corner
    pairs ``pair_of[a, b]`` with a <= b; `element_mass` (cell_count, 8) [kg] is the corners' part
    of the nodal masses. The bound is multiplied by `stiffening`.
    """
    for e in numba.prange(cells.shape[0]):
        a = np.empty((24, 24))
        b = np.empty((24, 24))
        for p in range(8):
            for q in range(p, 8):
                scale = 1.0 / math.sqrt(element_mass[e, p] * element_mass[e, q])
                pair = pair_of[p, q]
                for i in range(3):
                    for j in range(3):
                        value = scale * tangents[e, pair, i, j]
                        a[3 * p + i, 3 * q + j] = value
                        a[3 * q + j, 3 * p + i] = value
        largest = 0.0
        for i in range(24):
            for j in range(24):
                largest = max(largest, abs(a[i, j]))
        if not largest > 0.0:
            out[e] = largest
            continue
        for i in range(24):
            for j in range(24):
                a[i, j] /= largest
        for i in range(0, 24, 3):
            for j in range(i, 24, 3):
                block = _product_block(a, i, j)
                for k in range(9):
                    b[i + k // 3, j + k % 3] = block[k]
                    b[j + k % 3, i + k // 3] = block[k]
        trace = 0.0
        for i in range(0, 24, 3):
            for j in range(i, 24, 3):
                s = 0.0
                for value in _product_block(b, i, j):
                    s += value * value
                trace += s if i == j else 2.0 * s
        out[e] = stiffening * largest * trace**0.125


@kernel
def combined_rates(elements: Any, cells: Any, springs: Any, dashpots: Any, out: Any) -> None:
    """Add to the `elements`' bounds [1/s2] what acts at their worst corners.

    `springs` (node_count,) [1/s2] and `dashpots` (node_count,) [1/s]; `out` (cell_count,) receives
    the square of the frequency of the undamped system that has the same largest step, see
    `stable.highest_frequency`.
    """
    for e in range(cells.shape[0]):
        spring = 0.0
        half = 0.0
        for p in range(8):
            spring = max(spring, springs[cells[e, p]])
            half = max(half, 0.5 * dashpots[cells[e, p]])
        out[e] = (half + math.sqrt(half * half + elements[e] + spring)) ** 2


@kernel
def worst_at_nodes(elements: Any, cells: Any, out: Any) -> None:
    """Write the largest of the `elements`' bounds around each node into `out` (node_count,)."""
    out[:] = 0.0
    for e in range(cells.shape[0]):
        for p in range(8):
            out[cells[e, p]] = max(out[cells[e, p]], elements[e])


@kernel
def potential_of_weight(mass: Any, owner: Any, gravity: Any, x: Any) -> float:
    """``-sum m g.x`` over free nodes [J]."""
    s = 0.0
    for node in range(x.shape[0]):
        if owner[node] < 0:
            s -= mass[node] * (
                gravity[0] * x[node, 0] + gravity[1] * x[node, 1] + gravity[2] * x[node, 2]
            )
    return s


@kernel
def momentum(mass: Any, owner: Any, x: Any, v: Any, out: Any) -> None:
    """Fill `out` (10,): mass [kg], first moment, momentum and angular momentum about 0 (3 each)."""
    for k in range(10):
        out[k] = 0.0
    for node in range(x.shape[0]):
        if owner[node] >= 0:
            continue
        m = mass[node]
        out[0] += m
        for i in range(3):
            out[1 + i] += m * x[node, i]
            out[4 + i] += m * v[node, i]
        out[7] += m * (x[node, 1] * v[node, 2] - x[node, 2] * v[node, 1])
        out[8] += m * (x[node, 2] * v[node, 0] - x[node, 0] * v[node, 2])
        out[9] += m * (x[node, 0] * v[node, 1] - x[node, 1] * v[node, 0])


@kernel
def ground_gaps(x: Any, kind: int, params: Any, heights: Any, out: Any) -> None:
    """Signed distance of points from the ground [m], shape (count,)."""
    p = np.empty(3)
    normal = np.empty(3)
    for k in range(x.shape[0]):
        for i in range(3):
            p[i] = x[k, i]
        out[k] = gap_and_normal(kind, params, heights, p, normal)
