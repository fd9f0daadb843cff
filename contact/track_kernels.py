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

from flexapod.contact.kernels import (
    _gap,
    _point,
    _project,
    _smooth_step,
    _tangents,
    _unit_normal,
    shape,
    shape_derivatives,
)
from flexapod.core.jit import inline_kernel, kernel, parallel_kernel


@parallel_kernel
def mark_near(
    x: Any,
    slaves: Any,
    points: Any,
    masters: Any,
    candidates: Any,
    depth: float,
    reach: float,
    margin: float,
    near: Any,
) -> None:
    """Set `near` (face_count,) to 1 for faces with a point that may touch within `reach` [m].

    That is: projected on a candidate it lies within the face widened by `margin` (in local
    coordinates), no deeper than `depth` and no higher than `reach`.
    """
    for f in numba.prange(slaves.shape[0]):
        n = np.empty(4)
        d = np.empty((4, 2))
        t = np.empty((2, 3))
        twist = np.empty(3)
        p = np.empty(3)
        normal = np.empty(3)
        near[f] = 0
        for q in range(points.shape[0]):
            if near[f] == 1:
                break
            shape(points[q, 0], points[q, 1], n)
            _point(x, slaves[f], n, p)
            for c in range(candidates.shape[1]):
                m = candidates[f, c]
                if m < 0:
                    break
                xi, eta = _project(x, masters[m], p, n, d, t, twist)
                if abs(xi) > 1.0 + margin or abs(eta) > 1.0 + margin:
                    continue
                g, _ = _gap(x, masters[m], p, xi, eta, n, d, t, normal)
                if -depth < g < reach:
                    near[f] = 1
                    break


@inline_kernel
def _follow(
    x: Any,
    masters: Any,
    p: Any,
    f: int,
    q: int,
    depth: float,
    partner: Any,
    local: Any,
    gap: Any,
    fade: Any,
    n: Any,
    d: Any,
    t: Any,
    twist: Any,
    normal: Any,
) -> bool:
    """Refresh a point on its partner; False where it has none or slid over the rim."""
    m = partner[f, q]
    if m < 0:
        return False
    xi, eta = _project(x, masters[m], p, n, d, t, twist)
    if abs(xi) > 1.0 or abs(eta) > 1.0:
        return False
    g, _ = _gap(x, masters[m], p, xi, eta, n, d, t, normal)
    if g < -depth:
        return False
    gap[f, q] = g
    local[f, q, 0] = xi
    local[f, q, 1] = eta
    fade[f, q] = _smooth_step(min(1.0, (depth + g) / (0.3 * depth)))
    return True


@parallel_kernel
def track_partners(
    x: Any,
    slaves: Any,
    near: Any,
    near_count: int,
    points: Any,
    masters: Any,
    candidates: Any,
    depth: float,
    margin: float,
    anew: bool,
    close: float,
    slack: float,
    partner: Any,
    local: Any,
    gap: Any,
    fade: Any,
) -> None:
    """Refresh partner, local coordinates, gap and fade of the points of the `near` faces.

    The first `near_count` entries of `near` list faces. Points that lie squarely on their partner
    stay there. The others choose among the candidates as `contact.kernels.find_partners` does,
    if they were closer than `close` [m] to touching, or in any case where `anew` is set; else they
    stay apart until the next time it is.

    A contact begins outside and deepens steadily: a point takes a new partner only where it is no
    more than `slack` [m] deeper than it was, or than the surface if it touched nothing. What is
    suddenly deep behind a face came round a crease or through a fold, and to push it out would
    make energy from nothing.
    """
    for k in numba.prange(near_count):
        f = near[k]
        n = np.empty(4)
        d = np.empty((4, 2))
        t = np.empty((2, 3))
        twist = np.empty(3)
        p = np.empty(3)
        normal = np.empty(3)
        for q in range(points.shape[0]):
            if not anew and not gap[f, q] < close:
                continue
            shape(points[q, 0], points[q, 1], n)
            _point(x, slaves[f], n, p)
            if _follow(
                x, masters, p, f, q, depth, partner, local, gap, fade, n, d, t, twist, normal
            ):
                continue
            deepest = -slack
            if partner[f, q] >= 0 and gap[f, q] < 0.0:
                deepest = gap[f, q] - slack
            deepest = max(deepest, -depth)
            partner[f, q] = -1
            gap[f, q] = math.inf
            fade[f, q] = 0.0
            nearest = math.inf
            for c in range(candidates.shape[1]):
                m = candidates[f, c]
                if m < 0:
                    break
                xi, eta = _project(x, masters[m], p, n, d, t, twist)
                if abs(xi) > 1.0 + margin or abs(eta) > 1.0 + margin:
                    continue
                g, size = _gap(x, masters[m], p, xi, eta, n, d, t, normal)
                if g < deepest:
                    continue
                excess_xi = max(0.0, abs(xi) - 1.0)
                excess_eta = max(0.0, abs(eta) - 1.0)
                here = abs(g) + (excess_xi + excess_eta) * math.sqrt(size)
                if not here < nearest:
                    continue
                nearest = here
                partner[f, q] = m
                gap[f, q] = g
                local[f, q, 0] = xi
                local[f, q, 1] = eta
                fade[f, q] = (
                    _smooth_step(1.0 - excess_xi / margin)
                    * _smooth_step(1.0 - excess_eta / margin)
                    * _smooth_step(min(1.0, (depth + g) / (0.3 * depth)))
                )


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
    fade: Any,
    coefficient: float,
    exponent: float,
    damping: float,
    damping_exponent: float,
    indentation_exponent: float,
    share: float,
    force: Any,
    dissipative: Any,
    pressure: Any,
    totals: Any,
) -> None:
    """Add the forces [N] of touching points on both faces; equal and opposite to the last bit.

    The traction is that of `contact.kernels.pair_contact`, ``B d**m1``, plus the paper's damping
    ``D sign(d') |d'|**m2 d**m3`` (equation 4), and never below zero: a contact does not pull.
    The elastic part goes to `force`, the rest to `dissipative`, both (node_count, 3) external
    forces. `pressure` (face_count, point_count) receives the traction [Pa] of the near faces.
    `totals` (8,) gains elastic energy [J], area in touch [m2], the deepest penetration [m] (the
    larger of both), the force on the slave side [N] (3), the number of points and the power of
    damping [W], which is not above zero.
    """
    ns = np.empty(4)
    nm = np.empty(4)
    d = np.empty((4, 2))
    t = np.empty((2, 3))
    normal = np.empty(3)
    for k in range(near_count):
        f = near[k]
        for q in range(points.shape[0]):
            pressure[f, q] = 0.0
            m = partner[f, q]
            if m < 0 or not gap[f, q] < 0.0 or fade[f, q] == 0.0:
                continue
            shape(points[q, 0], points[q, 1], ns)
            shape(local[f, q, 0], local[f, q, 1], nm)
            shape_derivatives(local[f, q, 0], local[f, q, 1], d)
            _tangents(x, masters[m], d, t)
            _unit_normal(t, normal)
            depth = -gap[f, q]
            elastic = fade[f, q] * coefficient * depth**exponent
            rate = 0.0
            for a in range(4):
                for i in range(3):
                    rate -= (ns[a] * v[slaves[f, a], i] - nm[a] * v[masters[m, a], i]) * normal[i]
            rest = (
                fade[f, q]
                * damping
                * math.copysign(abs(rate) ** damping_exponent, rate)
                * depth**indentation_exponent
            )
            if elastic + rest < 0.0:
                rest = -elastic
            w = share * areas[f, q]
            pressure[f, q] = elastic + rest
            totals[0] += w * elastic * depth / (exponent + 1.0)
            totals[1] += w
            totals[2] = max(totals[2], depth)
            totals[6] += 1.0
            totals[7] -= w * rest * rate
            for i in range(3):
                e = w * elastic * normal[i]
                r = w * rest * normal[i]
                totals[3 + i] += e + r
                for a in range(4):
                    force[slaves[f, a], i] += ns[a] * e
                    force[masters[m, a], i] -= nm[a] * e
                    dissipative[slaves[f, a], i] += ns[a] * r
                    dissipative[masters[m, a], i] -= nm[a] * r


@kernel
def contact_rates(
    faces: Any,
    near: Any,
    near_count: int,
    points: Any,
    areas: Any,
    gap: Any,
    margin: float,
    coefficient: float,
    exponent: float,
    factor: float,
    inverse_mass: Any,
    out: Any,
) -> None:
    """Add to `out` (node_count,) what contact may add to the square of the highest frequency.

    Gershgorin's bound row by row: a point of stiffness k adds ``factor k N_a / m_a`` to its
    node a, where `factor` counts the faces it ties together (1 or 2). The stiffness is taken
    `margin` [m] deeper than the point is, and so deep too where it does not touch yet, since it
    may before the next estimate.
    """
    n = np.empty(4)
    for k in range(near_count):
        f = near[k]
        for q in range(points.shape[0]):
            depth = margin - min(gap[f, q], 0.0)
            stiffness = areas[f, q] * coefficient * exponent * depth ** (exponent - 1.0)
            shape(points[q, 0], points[q, 1], n)
            for a in range(4):
                node = faces[f, a]
                out[node] += factor * stiffness * n[a] * inverse_mass[node]
