"""Contact of faces with a rigid ground at rest, for explicit steps: one point, one law.

The ground is a kind, eight parameters and a grid of heights, packed by `contact.ground`; the
faces carry the quadrature points of `contact.kernels`. Every evaluation counts as accepted, so
the anchors of friction move in place.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.contact.face_kernels import shape
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
from flexapod.core.jit import inline_kernel, kernel

# params = point (3), unit normal (3)
PLANE = 0
# params = x of the riser, height
STEP = 1
# params = x0, y0, spacing, greatest height
HEIGHT_FIELD = 2


@inline_kernel
def _plane(params: Any, p: Any, normal: Any) -> float:
    gap = 0.0
    for i in range(3):
        normal[i] = params[3 + i]
        gap += (p[i] - params[i]) * normal[i]
    return gap


@inline_kernel
def _step(params: Any, p: Any, normal: Any) -> float:
    """Ground below z = 0, and below z = height from x on.

    Its surface is three pieces: floor, riser and top. The nearest point of the three gives the
    distance; the normal points from it to `p` outside and back to it inside, so it is the
    gradient of the distance on both sides.
    """
    x = p[0] - params[0]
    z = p[2]
    height = params[1]
    inside = z < 0.0 or (x > 0.0 and z < height)
    normal[1] = 0.0
    # Nearest points (a, b): on the floor (x <= 0, z = 0), the riser and the top (x >= 0).
    a = min(x, 0.0)
    b = 0.0
    nearest = math.hypot(x - a, z - b)
    normal[0] = 0.0
    normal[2] = 1.0
    riser = min(max(z, 0.0), height)
    distance = math.hypot(x, z - riser)
    if distance < nearest:
        nearest = distance
        a = 0.0
        b = riser
        normal[0] = -1.0
        normal[2] = 0.0
    distance = math.hypot(x - max(x, 0.0), z - height)
    if distance < nearest:
        nearest = distance
        a = max(x, 0.0)
        b = height
        normal[0] = 0.0
        normal[2] = 1.0
    sign = -1.0 if inside else 1.0
    # On the surface itself the direction is the piece's own, set above.
    if nearest > 0.0:
        normal[0] = sign * (x - a) / nearest
        normal[2] = sign * (z - b) / nearest
    return sign * nearest


@inline_kernel
def _height_field(params: Any, heights: Any, p: Any, normal: Any) -> float:
    """Vertical distance times n_z: the distance to the tangent plane above or below `p`."""
    spacing = params[2]
    s = (p[0] - params[0]) / spacing
    t = (p[1] - params[1]) / spacing
    last_s = heights.shape[0] - 1.0
    last_t = heights.shape[1] - 1.0
    beside_s = not (s >= 0.0 and s <= last_s)
    beside_t = not (t >= 0.0 and t <= last_t)
    # Written so that a NaN, too, ends inside the array.
    if not s > 0.0:
        s = 0.0
    if not t > 0.0:
        t = 0.0
    s = min(s, last_s)
    t = min(t, last_t)
    i = min(int(s), heights.shape[0] - 2)
    j = min(int(t), heights.shape[1] - 2)
    u = s - i
    w = t - j
    h00 = heights[i, j]
    h10 = heights[i + 1, j]
    h01 = heights[i, j + 1]
    h11 = heights[i + 1, j + 1]
    low = h00 + u * (h10 - h00)
    high = h01 + u * (h11 - h01)
    # Beside the field the rim's height continues level.
    slope_x = 0.0 if beside_s else ((h10 - h00) * (1.0 - w) + (h11 - h01) * w) / spacing
    slope_y = 0.0 if beside_t else (high - low) / spacing
    nz = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    normal[0] = -slope_x * nz
    normal[1] = -slope_y * nz
    normal[2] = nz
    return (p[2] - (low + w * (high - low))) * nz


@inline_kernel
def gap_and_normal(kind: int, params: Any, heights: Any, p: Any, normal: Any) -> float:
    """Signed distance of `p` from the ground [m], negative inside; fills the unit `normal` (3,).

    Exact for a plane and for a step with its corners; of first order for a height field.
    """
    if kind == PLANE:
        return _plane(params, p, normal)
    if kind == STEP:
        return _step(params, p, normal)
    return _height_field(params, heights, p, normal)


@inline_kernel
def _held(s: float, last: int) -> float:
    return min(max(s, 0.0), float(last))


@inline_kernel
def _beside_heights(params: Any, heights: Any, p: Any, distance: float) -> bool:
    """Whether a height field may be nearer to `p` than `distance` [m] on any side.

    If not, all of it within `distance` from above is lower than `p` by at least as much.
    """
    s = (p[0] - params[0]) / params[2]
    t = (p[1] - params[1]) / params[2]
    if not (p[2] - params[3] < distance and s == s and t == t):
        return False
    around = distance / params[2]
    last_s = heights.shape[0] - 1
    last_t = heights.shape[1] - 1
    # Of the cells that are touched, both ends; beside the field the rim's height continues.
    first_i, end_i = int(_held(s - around, last_s)), math.ceil(_held(s + around, last_s)) + 1
    first_j, end_j = int(_held(t - around, last_t)), math.ceil(_held(t + around, last_t)) + 1
    for i in range(first_i, end_i):
        for j in range(first_j, end_j):
            if p[2] - heights[i, j] < distance:
                return True
    return False


@kernel
def near_faces(
    x: Any, faces: Any, kind: int, params: Any, heights: Any, distance: float, out: Any
) -> int:
    """Write the faces with a corner nearer to the ground than `distance` [m]; return how many.

    `out` (face_count,) int. Only corners are looked at: `distance` must cover the half diagonal
    of a face for an edge of the ground that lies under a face's middle. Beside a steep wall of a
    height field the tangent plane below says nothing of the wall: there all heights around count.
    """
    p = np.empty(3)
    normal = np.empty(3)
    count = 0
    for f in range(faces.shape[0]):
        for a in range(4):
            for i in range(3):
                p[i] = x[faces[f, a], i]
            near = gap_and_normal(kind, params, heights, p, normal) < distance
            if not near and kind == HEIGHT_FIELD:
                near = _beside_heights(params, heights, p, distance)
            if near:
                out[count] = f
                count += 1
                break
    return count


@kernel
def ground_contact(
    x: Any,
    v: Any,
    faces: Any,
    active: Any,
    points: Any,
    areas: Any,
    kind: int,
    params: Any,
    heights: Any,
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
    anchor: Any,
    force: Any,
    dissipative: Any,
    pressure: Any,
    shear: Any,
    totals: Any,
) -> None:
    """Add the ground's forces on `active` faces [N]; of all others nothing is read or written.

    With penetration d, its rate d' and the tangential velocity v_t of a point, the tractions are

        normal  t_n = max(0, B d**m1 + D sign(d') |d'|**m2 d**m3)   (SoSpider paper, equation 4)
        shear   t_t = min(stick |slip|, mu(|v_t|) t_n)              (SoSpider paper, equation 8)

    where slip is the tangential part of the way from the point's anchor. Where the limit holds,
    the anchor is dragged along so that the spring carries just the limit: the return mapping of
    `contact.kernels.plane_contact`, with the present normal traction. A point that lands is
    anchored where it lands. The slip is taken in the present tangent plane, so an anchor follows
    a normal that turns.

    Parameters
    ----------
    x, v
        Positions [m] and velocities [m/s], shape (N, 3).
    faces, active
        Corners (face_count, 4); indices of the faces to look at, each at most once.
    points, areas
        Local coordinates (4, 2) and reference areas (face_count, 4) [m2] of the points.
    kind, params, heights
        The ground, as `contact.ground` packs it.
    coefficient, exponent, damping, damping_exponent, indentation_exponent
        B [Pa/m**m1], m1, D [Pa (s/m)**m2 / m**m3], m2, m3.
    static, dynamic, static_speed, dynamic_speed
        As in `contact.law.FrictionLaw`.
    stick
        Shear traction per slip [Pa/m].
    anchor
        Where each point sticks [m], NaN while apart, shape (face_count, 4, 3); moved in place.
    force, dissipative
        Shape (N, 3) [N], added to: contributions to the *external* force on the nodes. `force`
        gets the elastic traction B d**m1; `dissipative` gets t_n less that (it may pull as much,
        never more), and the shear. What contact dissipates is minus the work of `dissipative`,
        less the growth of what sticks.
    pressure, shear
        t_n and t_t [Pa], shape (face_count, 4), overwritten; zero for points apart.
        The caller sets a face that is no longer active apart: no anchors, no tractions.
    totals
        Overwritten, shape (TOTALS,): see `contact.law_kernels`; forces are the ground's on the
        body.
    """
    n = np.empty(4)
    p = np.empty(3)
    velocity = np.empty(3)
    slip = np.empty(3)
    traction_force = np.empty(3)
    normal = np.empty(3)
    totals[:] = 0.0
    for k in range(active.shape[0]):
        f = active[k]
        for q in range(points.shape[0]):
            pressure[f, q] = 0.0
            shear[f, q] = 0.0
            shape(points[q, 0], points[q, 1], n)
            for i in range(3):
                p[i] = 0.0
                for a in range(4):
                    p[i] += n[a] * x[faces[f, a], i]
            gap = gap_and_normal(kind, params, heights, p, normal)
            if not gap < 0.0:
                for i in range(3):
                    anchor[f, q, i] = math.nan
                continue
            for i in range(3):
                velocity[i] = 0.0
                for a in range(4):
                    velocity[i] += n[a] * v[faces[f, a], i]
            w = areas[f, q]
            depth = -gap
            along = velocity[0] * normal[0] + velocity[1] * normal[1] + velocity[2] * normal[2]
            elastic = coefficient * depth**exponent
            # The depth grows with -along: damping pushes while the point sinks in.
            rest = normal_damping(
                depth, -along, elastic, damping, damping_exponent, indentation_exponent
            )
            traction = elastic + rest
            totals[ENERGY] += w * elastic * depth / (exponent + 1.0)
            totals[AREA] += w
            totals[DEPTH] = max(totals[DEPTH], depth)
            totals[COUNT] += 1.0
            totals[DAMPING_POWER] -= w * rest * along
            pressure[f, q] = traction

            if not math.isnan(anchor[f, q, 0]):
                off = 0.0
                for i in range(3):
                    slip[i] = p[i] - anchor[f, q, i]
                    off += slip[i] * normal[i]
                slip_squared = 0.0
                speed_squared = 0.0
                for i in range(3):
                    slip[i] -= off * normal[i]
                    slip_squared += slip[i] * slip[i]
                    speed_squared += (velocity[i] - along * normal[i]) ** 2
                mu = friction_coefficient(
                    math.sqrt(speed_squared), static, dynamic, static_speed, dynamic_speed
                )
                back, trial, slid = slide(math.sqrt(slip_squared), stick, mu * traction)
                shear[f, q] = trial
                totals[STICK] += 0.5 * w * trial * trial / stick
                totals[SLIDING] += w * slid
                totals[FRICTION_LOSS] += w * trial * slid
            else:
                back = 0.0
                slip[:] = 0.0
            for i in range(3):
                anchor[f, q, i] = p[i] - back * slip[i]
                sideways = -w * stick * back * slip[i]
                traction_force[i] = w * rest * normal[i] + sideways
                totals[FORCE + i] += w * elastic * normal[i] + traction_force[i]
                totals[FRICTION + i] += sideways
            for a in range(4):
                for i in range(3):
                    force[faces[f, a], i] += n[a] * w * elastic * normal[i]
                    dissipative[faces[f, a], i] += n[a] * traction_force[i]
