"""Geometry of bilinear faces in space: shape functions, tangents, closest points, partners."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.jit import inline_kernel

_G = 1.0 / math.sqrt(3.0)
# 2x2 Gauss points on the face (-1, 1)^2.
POINTS = np.array([[-_G, -_G], [_G, -_G], [_G, _G], [-_G, _G]])
# Newton's method doubles its digits: after a step of this size in local coordinates what is left
# is of its square, times the warp of the face over its size, which is less than one.
NEWTON_SMALL = 1e-7
# The last part of the depth up to which a point counts, over which its force fades.
FADING = 0.3


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
    x: Any, face: Any, p: Any, first_xi: float, first_eta: float
) -> tuple[float, float, float, float]:
    """Closest point of the bilinear face to `p`, by Newton's method from the coordinates given.

    Returns its local coordinates, the distance of `p` along the normal there [m] and the normal's
    size [m2]. The face is c + xi a + eta b + xi eta h.
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
    qx = p[0] - 0.25 * (x[f0, 0] + x[f1, 0] + x[f2, 0] + x[f3, 0])
    qy = p[1] - 0.25 * (x[f0, 1] + x[f1, 1] + x[f2, 1] + x[f3, 1])
    qz = p[2] - 0.25 * (x[f0, 2] + x[f1, 2] + x[f2, 2] + x[f3, 2])
    xi = first_xi
    eta = first_eta
    for _ in range(12):
        sx, sy, sz = ax + eta * hx, ay + eta * hy, az + eta * hz
        tx, ty, tz = bx + xi * hx, by + xi * hy, bz + xi * hz
        rx = qx - xi * ax - eta * tx
        ry = qy - xi * ay - eta * ty
        rz = qz - xi * az - eta * tz
        g0 = rx * sx + ry * sy + rz * sz
        g1 = rx * tx + ry * ty + rz * tz
        m00 = sx * sx + sy * sy + sz * sz
        m11 = tx * tx + ty * ty + tz * tz
        first = sx * tx + sy * ty + sz * tz
        m01 = first - (rx * hx + ry * hy + rz * hz)
        det = m00 * m11 - m01 * m01
        small = NEWTON_SMALL
        if not det > 0.0:
            m01 = first
            det = m00 * m11 - m01 * m01
            small = NEWTON_SMALL * NEWTON_SMALL
        dxi = (m11 * g0 - m01 * g1) / det
        deta = (m00 * g1 - m01 * g0) / det
        xi += max(-0.5, min(0.5, dxi))
        eta += max(-0.5, min(0.5, deta))
        if abs(xi) > 3.0 or abs(eta) > 3.0:
            break
        if abs(dxi) + abs(deta) < small:
            break
    sx, sy, sz = ax + eta * hx, ay + eta * hy, az + eta * hz
    tx, ty, tz = bx + xi * hx, by + xi * hy, bz + xi * hz
    nx = sy * tz - sz * ty
    ny = sz * tx - sx * tz
    nz = sx * ty - sy * tx
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    rx = qx - xi * ax - eta * tx
    ry = qy - xi * ay - eta * ty
    rz = qz - xi * az - eta * tz
    return xi, eta, (rx * nx + ry * ny + rz * nz) / size, size


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
def smooth_step(a: float) -> float:
    return a * a * (3.0 - 2.0 * a)


@inline_kernel
def rim_share(local: float, margin: float) -> float:
    """Share of its force a point keeps at a local coordinate: 1 on the face, 0 past `margin`."""
    return smooth_step(max(0.0, 1.0 - max(0.0, abs(local) - 1.0) / margin))


@inline_kernel
def face_share(xi: float, eta: float, margin: float) -> float:
    """Share of its force a point keeps that projects to `xi` and `eta`."""
    return rim_share(xi, margin) * rim_share(eta, margin)


@inline_kernel
def rim_slope(local: float, margin: float) -> float:
    """Derivative of `rim_share` by the local coordinate."""
    a = 1.0 - (abs(local) - 1.0) / margin
    if not 0.0 < a < 1.0:
        return 0.0
    return -math.copysign(6.0 * a * (1.0 - a) / margin, local)


@inline_kernel
def depth_share(depth: float, deepest: float) -> float:
    """Share of its force a point keeps at a `depth` [m]: it falls to 0 before `deepest`."""
    return smooth_step(max(0.0, min(1.0, (deepest - depth) / (FADING * deepest))))


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
    margin: float,
    partner: Any,
    local: Any,
    gap: Any,
) -> None:
    """Give point `q` of slave face `f`, at `p`, the nearest candidate it projects onto, or none.

    Writes entry (f, q) of `partner`, `local` and `gap`, see `contact.kernels.find_partners`. A
    candidate reaches `margin` (in local coordinates) beyond its edge. Faces with a gap below
    `deepest` or above `farthest` [m] are passed over.
    """
    partner[f, q] = -1
    gap[f, q] = math.inf
    nearest = math.inf
    for c in range(candidates.shape[1]):
        m = candidates[f, c]
        if m < 0:
            break
        if out_of_reach(x, masters[m], p, margin, min(nearest, farthest)):
            continue
        xi, eta, g, size = project(x, masters[m], p, 0.0, 0.0)
        if abs(xi) > 1.0 + margin or abs(eta) > 1.0 + margin:
            continue
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
