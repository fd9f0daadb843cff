"""Contact between faces that moves a little at a time: partners are followed, not found anew.

An explicit step moves a point by micrometres. So each point keeps its partner while it lies
squarely on it, only points that slide over a rim look at their candidates again, and only faces
that were near something at the last search take part at all.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.contact.face_kernels import (
    FADING,
    choose_partner,
    depth_share,
    face_share,
    out_of_reach,
    point,
    project,
    rim_share,
    rim_slope,
    shape,
    shape_derivatives,
    tangents,
    unit_normal,
)
from flexapod.contact.law_kernels import (
    AREA,
    COUNT,
    DAMPING_POWER,
    DEPTH,
    ENERGY,
    FORCE,
    FRICTION,
    FRICTION_LOSS,
    SLIDING,
    STICK,
    friction_coefficient,
    normal_damping,
    slide,
)
from flexapod.core.jit import inline_kernel, kernel, parallel_kernel

# A gap closes by at most so many times the way of the fastest node: the point goes no farther than
# its nodes, but beside its partner's rim, up to a margin of 0.3 in local coordinates (the default),
# the partner's shape functions add up to 1.3 squared.
CLOSING = 2.7
# Steps towards the best rotation, at most: as two positions lie close to each other three suffice.
TURN_STEPS = 30


@parallel_kernel
def mark_near(
    x: Any,
    slaves: Any,
    points: Any,
    masters: Any,
    candidates: Any,
    reach: float,
    margin: float,
    near: Any,
) -> None:
    """Set `near` (face_count,) to 1 for faces with a point nearer than `reach` [m] to a candidate.

    A candidate is widened by `margin` (in local coordinates), over which it takes points. Those
    farther from all points of a face are struck from its row of `candidates`, so that who looks for
    partners later looks at few.
    """
    for f in numba.prange(slaves.shape[0]):
        n = np.empty(4)
        p = np.empty((points.shape[0], 3))
        for q in range(points.shape[0]):
            shape(points[q, 0], points[q, 1], n)
            point(x, slaves[f], n, p[q])
        kept = 0
        for c in range(candidates.shape[1]):
            m = candidates[f, c]
            if m < 0:
                break
            for q in range(points.shape[0]):
                if not out_of_reach(x, masters[m], p[q], margin, reach):
                    candidates[f, kept] = m
                    kept += 1
                    break
        near[f] = min(kept, 1)
        for c in range(kept, candidates.shape[1]):
            candidates[f, c] = -1


@inline_kernel
def _potential(
    press: float, depth: float, deepest: float, coefficient: float, exponent: float
) -> float:
    """Energy per area [J/m2] of a point `depth` [m] deep whose traction grew over `press` [m].

    The traction is ``coefficient press**exponent`` times the `depth_share`.
    """
    if not press > 0.0:
        return 0.0
    fading = max(0.0, min(press, press - depth + (1.0 - FADING) * deepest))
    energy = coefficient * fading ** (exponent + 1.0) / (exponent + 1.0)
    end = min(press, press - depth + deepest)
    if end > fading:
        # Three Gauss points are exact up to the fifth power: for the paper's exponent of two.
        middle = 0.5 * (fading + end)
        half = 0.5 * (end - fading)
        for k in range(3):
            at = middle + half * (k - 1) * math.sqrt(0.6)
            weight = 8.0 / 9.0 if k == 1 else 5.0 / 9.0
            share = depth_share(at + depth - press, deepest)
            energy += half * weight * share * coefficient * at**exponent
    return energy


@parallel_kernel
def track_partners(
    x: Any,
    slaves: Any,
    near: Any,
    near_count: int,
    points: Any,
    areas: Any,
    masters: Any,
    candidates: Any,
    depth: float,
    margin: float,
    way: Any,
    limit: float,
    close: float,
    slack: float,
    gone: float,
    ready: Any,
    soon: float,
    allowed: Any,
    coefficient: float,
    exponent: float,
    share: float,
    partner: Any,
    local: Any,
    gap: Any,
    offset: Any,
    dropped: Any,
) -> int:
    """Refresh partner, local coordinates and gap of the points of the `near` faces.

    The first `near_count` entries of `near` list faces. Points that lie squarely on their partner
    stay there. The others choose among the candidates as `contact.kernels.find_partners` does,
    if they were closer than `close` [m] to touching, or in any case where their face and what is
    near it have gone a `way` (face_count,) beyond `limit` [m], which begins anew then; else they
    stay apart. A face farther than `close` is no partner.

    A contact begins outside and deepens steadily: a point takes a new partner only where it is no
    more than `slack` [m] deeper than it was, or than the surface if it touched nothing. What is
    suddenly deep behind a face came round a crease or through a fold.

    Nor does a new partner give a point energy: it presses by its depth less an `offset`
    (face_count, point_count) [m], chosen so that what it stores, see `_potential`, is no more than
    on the old one. The offset goes as the point comes out. What is less is lost, and added to
    `dropped` (face_count,) [J]; `share` weighs the points, see `pair_forces`.

    `gone` [m] is how far any node went until now, in all. A face whose points are apart needs no
    look before it is `ready` (face_count,) [m]: when both sides may have closed its gap, see
    `CLOSING`.

    Returns how many faces without a share in the stable step (`allowed`, see
    `rate_kernels.allowed_depths`) have come nearer than `soon` [m].
    """
    late = 0
    for k in numba.prange(near_count):
        f = near[k]
        due = way[f] > limit
        if due:
            way[f] = 0.0
        elif gone < ready[f]:
            continue
        nearest = math.inf
        n = np.empty(4)
        p = np.empty(3)
        for q in range(points.shape[0]):
            if not due and not gap[f, q] < close:
                continue
            shape(points[q, 0], points[q, 1], n)
            point(x, slaves[f], n, p)
            held = partner[f, q]
            stored = 0.0
            if held >= 0:
                xi, eta, g, _ = project(x, masters[held], p, local[f, q, 0], local[f, q, 1])
                if abs(xi) <= 1.0 and abs(eta) <= 1.0 and g >= -depth:
                    gap[f, q] = g
                    local[f, q, 0] = xi
                    local[f, q, 1] = eta
                    offset[f, q] = min(offset[f, q], max(0.0, -g))
                    nearest = min(nearest, g)
                    continue
                if -g > offset[f, q]:
                    stored = _potential(-g - offset[f, q], -g, depth, coefficient, exponent)
                    stored *= face_share(xi, eta, margin)
            deepest = -slack
            if held >= 0 and gap[f, q] < 0.0:
                deepest = gap[f, q] - slack
            choose_partner(
                x,
                p,
                f,
                q,
                masters,
                candidates,
                max(deepest, -depth),
                close,
                margin,
                partner,
                local,
                gap,
            )
            nearest = min(nearest, gap[f, q])
            if partner[f, q] < 0 or not gap[f, q] < 0.0:
                offset[f, q] = 0.0
            elif partner[f, q] == held:
                offset[f, q] = min(offset[f, q], -gap[f, q])
                continue
            else:
                here = face_share(local[f, q, 0], local[f, q, 1], margin)
                press = 0.0
                if stored > 0.0 and here > 0.0:
                    press = (stored * (exponent + 1.0) / (here * coefficient)) ** (
                        1.0 / (exponent + 1.0)
                    )
                press = min(press, -gap[f, q])
                offset[f, q] = -gap[f, q] - press
                stored -= here * _potential(press, -gap[f, q], depth, coefficient, exponent)
            dropped[f] += share * areas[f, q] * stored
        ready[f] = gone + max(nearest, 0.0) / CLOSING
        if allowed[f, 0] == 0.0 and nearest < soon:
            late += 1
    return late


@kernel
def add_ways(
    slaves: Any,
    masters: Any,
    candidates: Any,
    near: Any,
    near_count: int,
    moved: Any,
    way: Any,
) -> None:
    """Add to `way` (face_count,) of near faces how far they and a candidate may have closed [m].

    `moved` (node_count,) is how far each node went since the last time.
    """
    for k in range(near_count):
        f = near[k]
        own = 0.0
        for a in range(4):
            own = max(own, moved[slaves[f, a]])
        other = 0.0
        for c in range(candidates.shape[1]):
            m = candidates[f, c]
            if m < 0:
                break
            for a in range(4):
                other = max(other, moved[masters[m, a]])
        way[f] += own + other


@inline_kernel
def _add_rim_force(
    x: Any,
    slave: Any,
    master: Any,
    ns: Any,
    nm: Any,
    d: Any,
    t: Any,
    normal: Any,
    gap: float,
    slope_xi: float,
    slope_eta: float,
    force: Any,
    totals: Any,
) -> None:
    """Add the force [N] of an energy that depends on where a point projects to.

    `slope_xi` and `slope_eta` [J] are its derivatives by the local coordinates. These are the
    derivatives of the closest point by the nodes' positions (P. Wriggers, Computational Contact
    Mechanics, 2006, section 4.2.2): ``(m - gap b) dxi = t . (dp - dc) + gap n . dt``.
    """
    b01 = 0.0
    m00 = 0.0
    m01 = 0.0
    m11 = 0.0
    for i in range(3):
        mixed = 0.25 * (x[master[0], i] - x[master[1], i] + x[master[2], i] - x[master[3], i])
        b01 += mixed * normal[i]
        m00 += t[0, i] * t[0, i]
        m01 += t[0, i] * t[1, i]
        m11 += t[1, i] * t[1, i]
    a01 = m01 - gap * b01
    det = m00 * m11 - a01 * a01
    if not det > 0.0:
        return  # deeper than the face's warp is curved: no one place is the closest
    h0 = (m11 * slope_xi - a01 * slope_eta) / det
    h1 = (m00 * slope_eta - a01 * slope_xi) / det
    for i in range(3):
        along = h0 * t[0, i] + h1 * t[1, i]
        totals[FORCE + i] -= along
        for a in range(4):
            force[slave[a], i] -= ns[a] * along
            force[master[a], i] += nm[a] * along - gap * (d[a, 0] * h0 + d[a, 1] * h1) * normal[i]


@kernel
def pair_forces(
    x: Any,
    v: Any,
    slaves: Any,
    near: Any,
    near_count: int,
    points: Any,
    areas: Any,
    masters: Any,
    partner: Any,
    local: Any,
    gap: Any,
    offset: Any,
    deepest: float,
    margin: float,
    allowed: Any,
    coefficient: float,
    exponent: float,
    damping: float,
    damping_exponent: float,
    indentation_exponent: float,
    static: float,
    dynamic: float,
    static_speed: float,
    dynamic_speed: float,
    stick: float,
    share: float,
    anchor_face: Any,
    anchor_local: Any,
    force: Any,
    dissipative: Any,
    pressure: Any,
    shear: Any,
    totals: Any,
) -> int:
    """Add the forces [N] of touching points on both faces; equal and opposite to round-off.

    The normal traction is that of `contact.kernels.pair_contact`, ``B d**m1``, plus the paper's
    damping ``D sign(d') |d'|**m2 d**m3`` (equation 4), and never below zero: a contact does not
    pull. Here d is the depth less the point's `offset`, see `track_partners`. The traction fades
    over the `margin` beyond the partner's edge and before the depth `deepest` [m], and the elastic
    force is all of the gradient of what the point then stores: one that slides off over a rim is
    pushed off, and one that comes back has to be pushed in. (A point that comes in deep from beyond
    the margin is new there: it presses by what it sinks in further.)

    Friction is that of `ground_kernels.ground_contact`, mu of the relative tangential speed
    (equation 8); what a point sticks to is a point of the partner's material: a face,
    `anchor_face` (face_count, point_count; -1 while apart), at `anchor_local` (.., 2). Without
    friction (`static` zero) these stay as they are.

    The elastic part goes to `force`, the rest to `dissipative`, both (node_count, 3) external
    forces. `pressure` and `shear` (face_count, point_count) receive the tractions [Pa] of the near
    faces. `totals` (TOTALS,) gains the sums of `contact.law_kernels`; forces are on the slave side.
    `share` weighs the points, one half where both surfaces take the slave's part in turn.

    Returns how many points press deeper than `allowed` (face_count, point_count) [m].
    """
    deeper = 0
    ns = np.empty(4)
    nm = np.empty(4)
    na = np.empty(4)
    d = np.empty((4, 2))
    t = np.empty((2, 3))
    normal = np.empty(3)
    moving = np.empty(3)
    slip = np.empty(3)
    rest_force = np.empty(3)
    for k in range(near_count):
        f = near[k]
        for q in range(points.shape[0]):
            pressure[f, q] = 0.0
            shear[f, q] = 0.0
            m = partner[f, q]
            depth = -gap[f, q] - offset[f, q]
            if m < 0 or not depth > 0.0:
                anchor_face[f, q] = -1
                continue
            xi = local[f, q, 0]
            eta = local[f, q, 1]
            rim = face_share(xi, eta, margin)
            fade = rim * depth_share(-gap[f, q], deepest)
            if fade == 0.0:
                anchor_face[f, q] = -1
                continue
            shape(points[q, 0], points[q, 1], ns)
            shape(xi, eta, nm)
            shape_derivatives(xi, eta, d)
            tangents(x, masters[m], d, t)
            unit_normal(t, normal)
            if depth > allowed[f, q]:
                deeper += 1
            elastic = fade * coefficient * depth**exponent
            rate = 0.0
            for i in range(3):
                moving[i] = 0.0
                for a in range(4):
                    moving[i] += ns[a] * v[slaves[f, a], i] - nm[a] * v[masters[m, a], i]
                rate -= moving[i] * normal[i]
            rest = normal_damping(
                depth, rate, elastic, fade * damping, damping_exponent, indentation_exponent
            )
            w = share * areas[f, q]
            pressure[f, q] = elastic + rest
            stored = _potential(depth, -gap[f, q], deepest, coefficient, exponent)
            totals[ENERGY] += w * rim * stored
            totals[AREA] += w
            totals[DEPTH] = max(totals[DEPTH], -gap[f, q])
            totals[COUNT] += 1.0
            totals[DAMPING_POWER] += w * rest * rate
            for i in range(3):
                slip[i] = 0.0
            if static > 0.0:
                held = anchor_face[f, q]
                back = 0.0
                if held >= 0:
                    shape(anchor_local[f, q, 0], anchor_local[f, q, 1], na)
                    off = 0.0
                    for i in range(3):
                        for a in range(4):
                            slip[i] += ns[a] * x[slaves[f, a], i] - na[a] * x[masters[held, a], i]
                        off += slip[i] * normal[i]
                    slip_squared = 0.0
                    speed_squared = 0.0
                    for i in range(3):
                        slip[i] -= off * normal[i]
                        slip_squared += slip[i] * slip[i]
                        speed_squared += (moving[i] + rate * normal[i]) ** 2
                    mu = friction_coefficient(
                        math.sqrt(speed_squared), static, dynamic, static_speed, dynamic_speed
                    )
                    back, trial, slid = slide(math.sqrt(slip_squared), stick, mu * (elastic + rest))
                    shear[f, q] = trial
                    totals[STICK] += 0.5 * w * trial * trial / stick
                    totals[SLIDING] += w * slid
                    totals[FRICTION_LOSS] += w * trial * slid
                if back < 1.0:
                    # The anchor follows: it lies the slip that is kept behind the point.
                    g00 = 0.0
                    g01 = 0.0
                    g11 = 0.0
                    s0 = 0.0
                    s1 = 0.0
                    for i in range(3):
                        slip[i] *= back
                        g00 += t[0, i] * t[0, i]
                        g01 += t[0, i] * t[1, i]
                        g11 += t[1, i] * t[1, i]
                        s0 += t[0, i] * slip[i]
                        s1 += t[1, i] * slip[i]
                    det = g00 * g11 - g01 * g01
                    anchor_face[f, q] = m
                    anchor_local[f, q, 0] = xi - (g11 * s0 - g01 * s1) / det
                    anchor_local[f, q, 1] = eta - (g00 * s1 - g01 * s0) / det
            if rim < 1.0:
                _add_rim_force(
                    x,
                    slaves[f],
                    masters[m],
                    ns,
                    nm,
                    d,
                    t,
                    normal,
                    gap[f, q],
                    w * stored * rim_slope(xi, margin) * rim_share(eta, margin),
                    w * stored * rim_slope(eta, margin) * rim_share(xi, margin),
                    force,
                    totals,
                )
            for i in range(3):
                sideways = -w * stick * slip[i]
                push = w * elastic * normal[i]
                rest_force[i] = w * rest * normal[i] + sideways
                totals[FORCE + i] += push + rest_force[i]
                totals[FRICTION + i] += sideways
                for a in range(4):
                    force[slaves[f, a], i] += ns[a] * push
                    force[masters[m, a], i] -= nm[a] * push
                    dissipative[slaves[f, a], i] += ns[a] * rest_force[i]
                    dissipative[masters[m, a], i] -= nm[a] * rest_force[i]
    return deeper


@inline_kernel
def _best_turn(moments: Any, turn: Any) -> None:
    """Fill `turn` (3, 3) with the rotation R of the largest sum of ``R * moments``.

    Newton's method on the group of rotations, a radian a step at most, and where it would lead
    away from the maximum the step of M. Mueller, J. Bender, N. Chentanez & M. Macklin, A robust
    method to extract the rotational part of deformations, 2016, doi:10.1145/2994258.2994269. Turns
    of more than some 1.5 rad of slender sets may not be found within `TURN_STEPS`.
    """
    scale = 0.0
    for i in range(3):
        for j in range(3):
            scale = max(scale, abs(moments[i, j]))
    b = np.empty((3, 3))
    e = np.empty((3, 3))
    way = np.empty(3)
    for i in range(3):
        for j in range(3):
            turn[i, j] = 1.0 if i == j else 0.0
    if not scale > 0.0:
        return
    for _ in range(TURN_STEPS):
        for i in range(3):
            for j in range(3):
                b[i, j] = 0.0
                for k in range(3):
                    b[i, j] += moments[i, k] * turn[j, k]
        trace = b[0, 0] + b[1, 1] + b[2, 2]
        g0 = b[2, 1] - b[1, 2]
        g1 = b[0, 2] - b[2, 0]
        g2 = b[1, 0] - b[0, 1]
        # Minus the second derivative, as L D L^T.
        a00 = trace - b[0, 0]
        a11 = trace - b[1, 1]
        a22 = trace - b[2, 2]
        a10 = -0.5 * (b[1, 0] + b[0, 1])
        a20 = -0.5 * (b[2, 0] + b[0, 2])
        a21 = -0.5 * (b[2, 1] + b[1, 2])
        size = abs(a00) + abs(a11) + abs(a22)
        l10 = a10 / a00
        l20 = a20 / a00
        d1 = a11 - l10 * a10
        c21 = a21 - l20 * a10
        l21 = c21 / d1
        d2 = a22 - l20 * a20 - l21 * c21
        least = 1e-9 * size
        newton = a00 > least and d1 > least and d2 > least
        if newton:
            way[0] = g0
            way[1] = g1 - l10 * way[0]
            way[2] = (g2 - l20 * way[0] - l21 * way[1]) / d2
            way[1] = way[1] / d1 - l21 * way[2]
            way[0] = way[0] / a00 - l10 * way[1] - l20 * way[2]
        else:
            share = 1.0 / (abs(trace) + 1e-9 * scale)
            way[0] = share * g0
            way[1] = share * g1
            way[2] = share * g2
        angle = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        if not angle > 1e-12:
            return
        if angle > 1.0:
            for i in range(3):
                way[i] /= angle
            angle = 1.0
        s = math.sin(angle) / angle
        c = (1.0 - math.cos(angle)) / angle**2
        for i in range(3):
            for j in range(3):
                e[i, j] = c * way[i] * way[j]
            e[i, i] += math.cos(angle)
        e[0, 1] -= s * way[2]
        e[1, 0] += s * way[2]
        e[0, 2] += s * way[1]
        e[2, 0] -= s * way[1]
        e[1, 2] -= s * way[0]
        e[2, 1] += s * way[0]
        for i in range(3):
            for j in range(3):
                b[i, j] = 0.0
                for k in range(3):
                    b[i, j] += e[i, k] * turn[k, j]
        for i in range(3):
            for j in range(3):
                turn[i, j] = b[i, j]
        if newton and angle < 1e-6:
            return  # what is left is of the order of its square


@kernel
def relative_motion(before: Any, now: Any, nodes: Any, moved: Any) -> float:
    """Largest way of a node [m] beyond the rigid motion that fits all of them best.

    `before` (count, 3) are positions of `nodes` then, `now` (node_count, 3) those of all; `moved`
    (node_count,) receives the ways of `nodes`. Any rigid motion would do for a bound, so it does
    not matter how well the best one is met.
    """
    count = nodes.shape[0]
    first = np.zeros(3)
    second = np.zeros(3)
    for k in range(count):
        for i in range(3):
            first[i] += before[k, i]
            second[i] += now[nodes[k], i]
    for i in range(3):
        first[i] /= count
        second[i] /= count
    m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0
    for k in range(count):
        node = nodes[k]
        b0 = before[k, 0] - first[0]
        b1 = before[k, 1] - first[1]
        b2 = before[k, 2] - first[2]
        n0 = now[node, 0] - second[0]
        n1 = now[node, 1] - second[1]
        n2 = now[node, 2] - second[2]
        m00 += n0 * b0
        m01 += n0 * b1
        m02 += n0 * b2
        m10 += n1 * b0
        m11 += n1 * b1
        m12 += n1 * b2
        m20 += n2 * b0
        m21 += n2 * b1
        m22 += n2 * b2
    moments = np.array([[m00, m01, m02], [m10, m11, m12], [m20, m21, m22]])
    turn = np.empty((3, 3))
    _best_turn(moments, turn)
    largest = 0.0
    for k in range(count):
        node = nodes[k]
        square = 0.0
        for i in range(3):
            r = now[node, i] - second[i]
            for j in range(3):
                r -= turn[i, j] * (before[k, j] - first[j])
            square += r * r
        moved[node] = math.sqrt(square)
        if not square <= largest:  # a NaN, too, is far
            largest = square
    return math.sqrt(largest)
