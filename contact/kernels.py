"""Contact kernels: faces against a rigid plane, and faces against faces.

Contact is integrated over the faces: each face carries `point_count` quadrature points with
fixed reference areas, so the result does not hang on where nodes fall. The traction of a point
penetrating by d is ``B d**m1`` along the normal, the gradient of the potential
``B d**(m1+1)/(m1+1)``; forces and tangents below are its exact first and second derivatives.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.contact.face_kernels import POINTS as POINTS
from flexapod.contact.face_kernels import (
    area_vector,
    choose_partner,
    depth_share,
    face_share,
    point,
    project,
    shape,
    shape_derivatives,
    tangents,
    unit_normal,
)
from flexapod.core.jit import kernel, parallel_kernel


@kernel
def point_areas(x: Any, faces: Any, points: Any, out: Any) -> None:
    """Fill `out` (face_count, point_count) with the areas the points stand for [m2]."""
    d = np.empty((4, 2))
    c = np.empty(3)
    for f in range(faces.shape[0]):
        for q in range(points.shape[0]):
            shape_derivatives(points[q, 0], points[q, 1], d)
            area_vector(x, faces[f], d, c)
            # Gauss weights of the 2x2 rule are one.
            out[f, q] = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])


@parallel_kernel
def face_frames(x: Any, faces: Any, centre: Any, normal: Any) -> None:
    """Fill centroids and unit normals of faces, shapes (face_count, 3)."""
    for f in numba.prange(faces.shape[0]):
        for i in range(3):
            centre[f, i] = 0.25 * (
                x[faces[f, 0], i] + x[faces[f, 1], i] + x[faces[f, 2], i] + x[faces[f, 3], i]
            )
        a0 = x[faces[f, 2], 0] - x[faces[f, 0], 0]
        a1 = x[faces[f, 2], 1] - x[faces[f, 0], 1]
        a2 = x[faces[f, 2], 2] - x[faces[f, 0], 2]
        b0 = x[faces[f, 3], 0] - x[faces[f, 1], 0]
        b1 = x[faces[f, 3], 1] - x[faces[f, 1], 1]
        b2 = x[faces[f, 3], 2] - x[faces[f, 1], 2]
        n0 = a1 * b2 - a2 * b1
        n1 = a2 * b0 - a0 * b2
        n2 = a0 * b1 - a1 * b0
        r = 1.0 / max(math.sqrt(n0 * n0 + n1 * n1 + n2 * n2), 1e-300)
        normal[f, 0] = n0 * r
        normal[f, 1] = n1 * r
        normal[f, 2] = n2 * r


@kernel
def point_positions(x: Any, faces: Any, points: Any, out: Any) -> None:
    """Fill `out` (face_count, point_count, 3) with the positions of the contact points."""
    n = np.empty(4)
    for q in range(points.shape[0]):
        shape(points[q, 0], points[q, 1], n)
        for f in range(faces.shape[0]):
            for i in range(3):
                s = 0.0
                for a in range(4):
                    s += n[a] * x[faces[f, a], i]
                out[f, q, i] = s


@parallel_kernel
def find_partners(
    x: Any,
    slaves: Any,
    points: Any,
    masters: Any,
    candidates: Any,
    depth: float,
    margin: float,
    partner: Any,
    local: Any,
    gap: Any,
    fade: Any,
) -> None:
    """For each contact point find the nearest master face it projects onto.

    `candidates` (face_count, candidate_count) lists master faces per slave face, -1 for none.
    Writes `partner` (face_count, point_count; -1 for none), `local` (.., 2) and `gap` (..) [m],
    negative when penetrating. Points deeper than `depth` are not contacts but passers-by.

    `fade` (..) is 1 on the face and falls smoothly to 0 over the `margin` (in local coordinates)
    beyond its edge, and before `depth`. So a point that slides over a surface's rim changes its
    force smoothly: a sudden change is what no Newton step survives.
    """
    for f in numba.prange(slaves.shape[0]):
        n = np.empty(4)
        p = np.empty(3)
        for q in range(points.shape[0]):
            shape(points[q, 0], points[q, 1], n)
            point(x, slaves[f], n, p)
            choose_partner(
                x,
                p,
                f,
                q,
                masters,
                candidates,
                -depth,
                math.inf,
                margin,
                partner,
                local,
                gap,
            )
            fade[f, q] = 0.0
            if partner[f, q] >= 0:
                rim = face_share(local[f, q, 0], local[f, q, 1], margin)
                fade[f, q] = rim * depth_share(-gap[f, q], depth)


@parallel_kernel
def project_on_partners(
    x: Any, slaves: Any, points: Any, masters: Any, partner: Any, local: Any, gap: Any
) -> None:
    """Refresh `local` and `gap` of points on the partners they have; see `find_partners`.

    A point may slide over its partner's rim, on the face's continuation.
    """
    for f in numba.prange(slaves.shape[0]):
        n = np.empty(4)
        p = np.empty(3)
        for q in range(points.shape[0]):
            m = partner[f, q]
            if m < 0:
                continue
            shape(points[q, 0], points[q, 1], n)
            point(x, slaves[f], n, p)
            xi, eta, gap[f, q], _ = project(x, masters[m], p, 0.0, 0.0)
            local[f, q, 0] = xi
            local[f, q, 1] = eta


@kernel
def pair_contact(
    x: Any,
    slaves: Any,
    points: Any,
    areas: Any,
    masters: Any,
    partner: Any,
    local: Any,
    gap: Any,
    fade: Any,
    coefficient: float,
    exponent: float,
    share: float,
    force: Any,
    pressure: Any,
    nodes: Any,
    stiffness: Any,
    want_stiffness: bool,
) -> tuple[float, int]:
    """Add pair forces [N] to `force` and, per active point, its nodes and symmetric stiffness.

    `share` weighs the points (one half when both surfaces take the slave's part in turn).
    `pressure` (face_count, point_count) receives the contact traction [Pa]. Returns the energy
    [J] and the number of active points; `nodes` (.., 8) and `stiffness` (.., 24, 24) must hold
    every point with a negative gap.

    The tangent is the exact second derivative of the closest-point gap, at a fixed `fade`
    (P. Wriggers, Computational Contact Mechanics, 2006, section 4.2.2, in the form symmetric in
    both bodies).
    """
    ns = np.empty(4)
    nm = np.empty(4)
    d = np.empty((4, 2))
    t = np.empty((2, 3))
    normal = np.empty(3)
    bn = np.empty(24)
    bt = np.empty((2, 24))
    cn = np.empty((2, 24))
    energy = 0.0
    count = 0
    pressure[:] = 0.0
    for f in range(slaves.shape[0]):
        for q in range(points.shape[0]):
            m = partner[f, q]
            if m < 0 or not gap[f, q] < 0.0 or fade[f, q] == 0.0:
                continue
            g = gap[f, q]
            xi = local[f, q, 0]
            eta = local[f, q, 1]
            shape(points[q, 0], points[q, 1], ns)
            shape(xi, eta, nm)
            shape_derivatives(xi, eta, d)
            tangents(x, masters[m], d, t)
            unit_normal(t, normal)
            w = share * areas[f, q]
            depth = -g
            traction = fade[f, q] * coefficient * depth**exponent
            slope = fade[f, q] * coefficient * exponent * depth ** (exponent - 1.0)
            pressure[f, q] = traction
            energy += w * traction * depth / (exponent + 1.0)
            # d(energy)/dx = -w traction dg/dx, and dg/dx = N_s n on slaves, -N_m n on masters.
            for a in range(4):
                for i in range(3):
                    force[slaves[f, a], i] -= w * traction * ns[a] * normal[i]
                    force[masters[m, a], i] += w * traction * nm[a] * normal[i]
            if not want_stiffness:
                continue
            b01 = 0.0
            m00 = 0.0
            m01 = 0.0
            m11 = 0.0
            for i in range(3):
                mixed = 0.25 * (
                    x[masters[m, 0], i]
                    - x[masters[m, 1], i]
                    + x[masters[m, 2], i]
                    - x[masters[m, 3], i]
                )
                b01 += mixed * normal[i]
                m00 += t[0, i] * t[0, i]
                m01 += t[0, i] * t[1, i]
                m11 += t[1, i] * t[1, i]
            for a in range(4):
                for i in range(3):
                    bn[3 * a + i] = ns[a] * normal[i]
                    bn[12 + 3 * a + i] = -nm[a] * normal[i]
                    for k in range(2):
                        bt[k, 3 * a + i] = ns[a] * t[k, i]
                        bt[k, 12 + 3 * a + i] = -nm[a] * t[k, i]
                        cn[k, 3 * a + i] = 0.0
                        cn[k, 12 + 3 * a + i] = -d[a, k] * normal[i]
            # A = m - g b; its inverse; and M = m^-1 b A^-1 (b is purely mixed for this face).
            a01 = m01 - g * b01
            det_a = m00 * m11 - a01 * a01
            i00 = m11 / det_a
            i11 = m00 / det_a
            i01 = -a01 / det_a
            det_m = m00 * m11 - m01 * m01
            j00 = m11 / det_m
            j11 = m00 / det_m
            j01 = -m01 / det_m
            h00 = b01 * (j00 * i01 + j01 * i00)
            h01 = b01 * (j00 * i11 + j01 * i01)
            h11 = b01 * (j01 * i11 + j11 * i01)
            for a in range(8):
                nodes[count, a] = slaves[f, a] if a < 4 else masters[m, a - 4]
            wt = w * traction
            ws = w * slope
            for r in range(24):
                for s in range(r, 24):
                    second = (
                        -(
                            h00 * bt[0, r] * bt[0, s]
                            + h01 * (bt[0, r] * bt[1, s] + bt[1, r] * bt[0, s])
                            + h11 * bt[1, r] * bt[1, s]
                        )
                        + i00 * (bt[0, r] * cn[0, s] + cn[0, r] * bt[0, s])
                        + i01
                        * (
                            bt[0, r] * cn[1, s]
                            + cn[1, r] * bt[0, s]
                            + bt[1, r] * cn[0, s]
                            + cn[0, r] * bt[1, s]
                        )
                        + i11 * (bt[1, r] * cn[1, s] + cn[1, r] * bt[1, s])
                        - g
                        * (
                            i00 * cn[0, r] * cn[0, s]
                            + i01 * (cn[0, r] * cn[1, s] + cn[1, r] * cn[0, s])
                            + i11 * cn[1, r] * cn[1, s]
                        )
                    )
                    value = ws * bn[r] * bn[s] - wt * second
                    stiffness[count, r, s] = value
                    stiffness[count, s, r] = value
            count += 1
    return energy, count


@kernel
def plane_contact(
    x: Any,
    anchor: Any,
    faces: Any,
    points: Any,
    areas: Any,
    origin: Any,
    normal: Any,
    coefficient: float,
    exponent: float,
    friction: float,
    stick: float,
    force: Any,
    pressure: Any,
    trial_anchor: Any,
    nodes: Any,
    stiffness: Any,
    want_stiffness: bool,
) -> tuple[float, int]:
    """Add the forces of faces on a rigid plane; frictionless, or Coulomb with return mapping.

    `anchor` (face_count, point_count, 4) is where each point sticks [m] and the normal traction
    [Pa] of the last accepted state; NaN for a point that was apart. `trial_anchor` receives the
    same of this trial state, for the caller to commit once the increment is accepted. The
    sliding limit is the friction coefficient times the *accepted* traction: within an increment
    friction then has a potential, its tangent is exact and symmetric, and the lag shrinks with
    the increment.
    """
    n = np.empty(4)
    p = np.empty(3)
    slip = np.empty(3)
    k = np.empty((3, 3))
    energy = 0.0
    count = 0
    for f in range(faces.shape[0]):
        for q in range(points.shape[0]):
            shape(points[q, 0], points[q, 1], n)
            g = 0.0
            for i in range(3):
                p[i] = 0.0
                for a in range(4):
                    p[i] += n[a] * x[faces[f, a], i]
                g += (p[i] - origin[i]) * normal[i]
            pressure[f, q] = 0.0
            if not g < 0.0:
                for i in range(4):
                    trial_anchor[f, q, i] = math.nan
                continue
            w = areas[f, q]
            depth = -g
            traction = coefficient * depth**exponent
            slope = coefficient * exponent * depth ** (exponent - 1.0)
            pressure[f, q] = traction
            energy += w * traction * depth / (exponent + 1.0)
            for i in range(3):
                for j in range(3):
                    k[i, j] = w * slope * normal[i] * normal[j]
            for a in range(4):
                for i in range(3):
                    force[faces[f, a], i] -= w * traction * n[a] * normal[i]
            trial_anchor[f, q, 3] = traction
            if friction > 0.0 and anchor[f, q, 3] > 0.0:
                along = 0.0
                for i in range(3):
                    slip[i] = p[i] - anchor[f, q, i]
                    along += slip[i] * normal[i]
                for i in range(3):
                    slip[i] -= along * normal[i]
                size = math.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2)
                limit = friction * anchor[f, q, 3]
                shear = stick * size
                if shear <= limit:
                    for i in range(3):
                        trial_anchor[f, q, i] = p[i] - slip[i]
                        for j in range(3):
                            unit = 1.0 if i == j else 0.0
                            k[i, j] += w * stick * (unit - normal[i] * normal[j])
                    factor = w * stick
                else:
                    back = limit / shear
                    for i in range(3):
                        trial_anchor[f, q, i] = p[i] - back * slip[i]
                        for j in range(3):
                            unit = 1.0 if i == j else 0.0
                            k[i, j] += (
                                w
                                * back
                                * stick
                                * (unit - normal[i] * normal[j] - slip[i] * slip[j] / (size * size))
                            )
                    factor = w * back * stick
                for a in range(4):
                    for i in range(3):
                        force[faces[f, a], i] += factor * n[a] * slip[i]
            else:
                # A point that lands sticks, from the next increment on, where it lands.
                for i in range(3):
                    trial_anchor[f, q, i] = p[i]
            if want_stiffness:
                for a in range(4):
                    nodes[count, a] = faces[f, a]
                    for b in range(4):
                        for i in range(3):
                            for j in range(3):
                                stiffness[count, 3 * a + i, 3 * b + j] = n[a] * n[b] * k[i, j]
                count += 1
    return energy, count


@kernel
def nodal_average(faces: Any, points: Any, areas: Any, values: Any, total: Any, area: Any) -> None:
    """Add area-weighted point values to `total` and their weights to `area`, per node."""
    n = np.empty(4)
    for q in range(points.shape[0]):
        shape(points[q, 0], points[q, 1], n)
        for f in range(faces.shape[0]):
            for a in range(4):
                w = areas[f, q] * n[a]
                total[faces[f, a]] += w * values[f, q]
                area[faces[f, a]] += w
