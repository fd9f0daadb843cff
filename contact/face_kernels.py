"""Geometry of bilinear faces in space: shape functions, tangents, closest points, partners."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.jit import inline_kernel

_G = 1.0 / math.sqrt(3.0)
# 2x2 Gauss points on the face (-1, 1)^2.
POINTS = np.array([[-_G, -_G], [_G, -_G], [_G, _G], [-_G, _G]])


@inline_kernel
def shape(xi: float, eta: float, n: Any) -> None:
    """Bilinear shape functions of a quadrilateral, corners counter-clockwise."""
    n[0] = 0.25 * (1.0 - xi) * (1.0 - eta)
    n[1] = 0.25 * (1.0 + xi) * (1.0 - eta)
    n[2] = 0.25 * (1.0 + xi) * (1.0 + eta)
    n[3] = 0.25 * (1.0 - xi) * (1.0 + eta)


@inline_kernel
def shape_derivatives(xi: float, eta: float, d: Any) -> None:
    """Derivatives d[a, 0] by xi and d[a, 1] by eta."""
    d[0, 0] = -0.25 * (1.0 - eta)
    d[1, 0] = 0.25 * (1.0 - eta)
    d[2, 0] = 0.25 * (1.0 + eta)
    d[3, 0] = -0.25 * (1.0 + eta)
    d[0, 1] = -0.25 * (1.0 - xi)
    d[1, 1] = -0.25 * (1.0 + xi)
    d[2, 1] = 0.25 * (1.0 + xi)
    d[3, 1] = 0.25 * (1.0 - xi)


@inline_kernel
def tangents(x: Any, face: Any, d: Any, t: Any) -> None:
    for i in range(3):
        t[0, i] = 0.0
        t[1, i] = 0.0
        for a in range(4):
            t[0, i] += d[a, 0] * x[face[a], i]
            t[1, i] += d[a, 1] * x[face[a], i]


@inline_kernel
def area_vector(x: Any, face: Any, d: Any, c: Any) -> None:
    """Fill `c` with the cross product of the tangents: normal times area per local area."""
    t00 = 0.0
    t01 = 0.0
    t02 = 0.0
    t10 = 0.0
    t11 = 0.0
    t12 = 0.0
    for a in range(4):
        node = face[a]
        t00 += d[a, 0] * x[node, 0]
        t01 += d[a, 0] * x[node, 1]
        t02 += d[a, 0] * x[node, 2]
        t10 += d[a, 1] * x[node, 0]
        t11 += d[a, 1] * x[node, 1]
        t12 += d[a, 1] * x[node, 2]
    c[0] = t01 * t12 - t02 * t11
    c[1] = t02 * t10 - t00 * t12
    c[2] = t00 * t11 - t01 * t10


@inline_kernel
def project(
    x: Any,
    face: Any,
    p: Any,
    first_xi: float,
    first_eta: float,
    n: Any,
    d: Any,
    t: Any,
    twist: Any,
) -> tuple[float, float]:
    """Closest point of the bilinear face to `p`: local coordinates by Newton's method."""
    for i in range(3):
        twist[i] = 0.25 * (x[face[0], i] - x[face[1], i] + x[face[2], i] - x[face[3], i])
    xi = first_xi
    eta = first_eta
    for _ in range(12):
        shape(xi, eta, n)
        shape_derivatives(xi, eta, d)
        tangents(x, face, d, t)
        g0 = 0.0
        g1 = 0.0
        m00 = 0.0
        m01 = 0.0
        m11 = 0.0
        rb = 0.0
        for i in range(3):
            r = p[i]
            for a in range(4):
                r -= n[a] * x[face[a], i]
            g0 += r * t[0, i]
            g1 += r * t[1, i]
            m00 += t[0, i] * t[0, i]
            m01 += t[0, i] * t[1, i]
            m11 += t[1, i] * t[1, i]
            rb += r * twist[i]
        m01 -= rb
        det = m00 * m11 - m01 * m01
        if not det > 0.0:
            m01 += rb
            det = m00 * m11 - m01 * m01
        dxi = (m11 * g0 - m01 * g1) / det
        deta = (m00 * g1 - m01 * g0) / det
        xi += max(-0.5, min(0.5, dxi))
        eta += max(-0.5, min(0.5, deta))
        if abs(xi) > 3.0 or abs(eta) > 3.0:
            break
        if abs(dxi) + abs(deta) < 1e-13:
            break
    return xi, eta


@inline_kernel
def point(x: Any, face: Any, n: Any, p: Any) -> None:
    for i in range(3):
        p[i] = 0.0
        for a in range(4):
            p[i] += n[a] * x[face[a], i]


@inline_kernel
def unit_normal(t: Any, normal: Any) -> float:
    """Unit normal of a face with tangents `t`; returns the length of their cross product."""
    normal[0] = t[0, 1] * t[1, 2] - t[0, 2] * t[1, 1]
    normal[1] = t[0, 2] * t[1, 0] - t[0, 0] * t[1, 2]
    normal[2] = t[0, 0] * t[1, 1] - t[0, 1] * t[1, 0]
    size = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for i in range(3):
        normal[i] /= size
    return size


@inline_kernel
def gap_over(
    x: Any, face: Any, p: Any, xi: float, eta: float, n: Any, d: Any, t: Any, normal: Any
) -> tuple[float, float]:
    """Distance of `p` from the face along its normal at (xi, eta), and the normal's size."""
    shape(xi, eta, n)
    shape_derivatives(xi, eta, d)
    tangents(x, face, d, t)
    size = unit_normal(t, normal)
    g = 0.0
    for i in range(3):
        r = p[i]
        for a in range(4):
            r -= n[a] * x[face[a], i]
        g += r * normal[i]
    return g, size


@inline_kernel
def smooth_step(a: float) -> float:
    return a * a * (3.0 - 2.0 * a)


@inline_kernel
def out_of_reach(x: Any, face: Any, p: Any, margin: float, limit: float) -> bool:
    """Whether `p` is surely farther than `limit` [m] from the face widened by `margin`.

    The face is c + xi a + eta b + xi eta h; a slab across each of a, b and a x b holds all of it.
    """
    f0, f1, f2, f3 = face[0], face[1], face[2], face[3]
    ax = 0.25 * (x[f1, 0] - x[f0, 0] + x[f2, 0] - x[f3, 0])
    ay = 0.25 * (x[f1, 1] - x[f0, 1] + x[f2, 1] - x[f3, 1])
    az = 0.25 * (x[f1, 2] - x[f0, 2] + x[f2, 2] - x[f3, 2])
    bx = 0.25 * (x[f3, 0] - x[f0, 0] + x[f2, 0] - x[f1, 0])
    by = 0.25 * (x[f3, 1] - x[f0, 1] + x[f2, 1] - x[f1, 1])
    bz = 0.25 * (x[f3, 2] - x[f0, 2] + x[f2, 2] - x[f1, 2])
    hx = 0.25 * (x[f0, 0] - x[f1, 0] + x[f2, 0] - x[f3, 0])
    hy = 0.25 * (x[f0, 1] - x[f1, 1] + x[f2, 1] - x[f3, 1])
    hz = 0.25 * (x[f0, 2] - x[f1, 2] + x[f2, 2] - x[f3, 2])
    rx = p[0] - 0.25 * (x[f0, 0] + x[f1, 0] + x[f2, 0] + x[f3, 0])
    ry = p[1] - 0.25 * (x[f0, 1] + x[f1, 1] + x[f2, 1] + x[f3, 1])
    rz = p[2] - 0.25 * (x[f0, 2] + x[f1, 2] + x[f2, 2] + x[f3, 2])
    e = 1.0 + margin
    # Components times the length of the direction, to spare the square roots of those that pass.
    nx = ay * bz - az * by
    ny = az * bx - ax * bz
    nz = ax * by - ay * bx
    over = abs(rx * nx + ry * ny + rz * nz) - e * e * abs(hx * nx + hy * ny + hz * nz)
    if over > 0.0 and over * over > limit * limit * (nx * nx + ny * ny + nz * nz):
        return True
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    ab = abs(ax * bx + ay * by + az * bz)
    over = abs(rx * ax + ry * ay + rz * az) - e * (aa + ab)
    over -= e * e * abs(hx * ax + hy * ay + hz * az)
    if over > 0.0 and over * over > limit * limit * aa:
        return True
    over = abs(rx * bx + ry * by + rz * bz) - e * (bb + ab)
    over -= e * e * abs(hx * bx + hy * by + hz * bz)
    return over > 0.0 and over * over > limit * limit * bb


@inline_kernel
def choose_partner(
    x: Any,
    p: Any,
    f: int,
    q: int,
    masters: Any,
    candidates: Any,
    deepest: float,
    farthest: float,
    depth: float,
    margin: float,
    partner: Any,
    local: Any,
    gap: Any,
    fade: Any,
    n: Any,
    d: Any,
    t: Any,
    twist: Any,
    normal: Any,
) -> None:
    """Give point `q` of slave face `f`, at `p`, the nearest candidate it projects onto, or none.

    Writes entry (f, q) of `partner`, `local`, `gap` and `fade`, see
    `contact.kernels.find_partners`. Faces with a gap below `deepest` or above `farthest` [m] are
    passed over.
    """
    partner[f, q] = -1
    gap[f, q] = math.inf
    fade[f, q] = 0.0
    nearest = math.inf
    for c in range(candidates.shape[1]):
        m = candidates[f, c]
        if m < 0:
            break
        if out_of_reach(x, masters[m], p, margin, min(nearest, farthest)):
            continue
        xi, eta = project(x, masters[m], p, 0.0, 0.0, n, d, t, twist)
        if abs(xi) > 1.0 + margin or abs(eta) > 1.0 + margin:
            continue
        g, size = gap_over(x, masters[m], p, xi, eta, n, d, t, normal)
        if g < deepest or g > farthest:
            continue
        excess_xi = max(0.0, abs(xi) - 1.0)
        excess_eta = max(0.0, abs(eta) - 1.0)
        # Prefer a face the point lies squarely on over one whose rim it only grazes.
        here = abs(g) + (excess_xi + excess_eta) * math.sqrt(size)
        if not here < nearest:
            continue
        nearest = here
        partner[f, q] = m
        gap[f, q] = g
        local[f, q, 0] = xi
        local[f, q, 1] = eta
        fade[f, q] = (
            smooth_step(1.0 - excess_xi / margin)
            * smooth_step(1.0 - excess_eta / margin)
            * smooth_step(min(1.0, (depth + g) / (0.3 * depth)))
        )
