"""Internal force of total-Lagrangian hexahedra, written for the vector units of the processor.

The element is that of `fem.kernels`: eight-node hexahedra with mean dilatation (Q1/P0; Simo,
Taylor & Pister 1985, doi:10.1016/0045-7825(85)90033-7), 2x2x2 Gauss points, the laws of
`materials.kernels`, and the energy

    sum_q w_q (W(F_q) + U(J_q; kappa_point)) + V U(Jbar; kappa)

Only the way of computing differs, because an explicit run spends nearly all its time here:

- `LANES` elements go through every step together, one entry of a row each, so that LLVM turns
  each line into vector instructions. Rows live in a scratch of a few tens of kilobytes per
  thread, which stays in the first-level cache. Nothing is allocated.
- Shape-function gradients are not stored: a trilinear field has seven modes with a gradient
  (xi, eta, zeta, eta zeta, xi zeta, xi eta, xi eta zeta), from which the Jacobian of any point
  takes nine sums. The 2x2x2 rule integrates the volume exactly, so the mean dilatation is a
  closed form in the modes.
- The law needs no eigenvectors and no library; see `fem.element_kernels`.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.core.errors import InputError
from flexapod.fem.element_kernels import (
    AT_CORNERS,
    AT_ENERGY,
    AT_KAPPA,
    AT_LEAST,
    AT_PRESSURE,
    ELEMENT_SIZE,
    POINT_SIZE,
    ROW_COF,
    ROW_DET0,
    ROW_J,
    ROW_LM,
    ROW_RJ,
    ROW_W,
    R,
    aligned,
    cofactors,
    evaluate_law,
    load_corners,
    load_material,
    load_stress,
    pack_laws,
    scratch_size,
    store_strain,
)
from flexapod.fem.lane_kernels import FLAGS, LANES, log1p, wide_vectors

L = LANES
_G = 0.5773502691896258


@numba.njit(forceinline=True, **FLAGS)
def _load_modes(v: Any, lanes: int, o: Any) -> None:
    """Modes of the corner values `v` (24 rows) into `o` (21 rows)."""
    for c in range(3):
        for i in range(lanes):
            k = c * L + i
            v0 = v[k]
            v1 = v[k + 3 * L]
            v2 = v[k + 6 * L]
            v3 = v[k + 9 * L]
            v4 = v[k + 12 * L]
            v5 = v[k + 15 * L]
            v6 = v[k + 18 * L]
            v7 = v[k + 21 * L]
            d01 = v1 - v0
            d32 = v2 - v3
            d45 = v5 - v4
            d76 = v6 - v7
            s01 = v1 + v0
            s32 = v2 + v3
            s45 = v5 + v4
            s76 = v6 + v7
            o[k] = 0.125 * ((d01 + d32) + (d45 + d76))
            o[k + 3 * L] = 0.125 * ((s32 - s01) + (s76 - s45))
            o[k + 6 * L] = 0.125 * ((s45 + s76) - (s01 + s32))
            o[k + 9 * L] = (0.125 * _G) * ((s76 - s45) - (s32 - s01))
            o[k + 12 * L] = (0.125 * _G) * ((d45 + d76) - (d01 + d32))
            o[k + 15 * L] = (0.125 * _G) * ((d32 - d01) + (d76 - d45))
            o[k + 18 * L] = (0.125 * _G * _G) * ((d76 - d45) - (d32 - d01))


@numba.njit(forceinline=True, **FLAGS)
def _triple(
    a0: float,
    a1: float,
    a2: float,
    b0: float,
    b1: float,
    b2: float,
    c0: float,
    c1: float,
    c2: float,
) -> float:
    return a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)


@numba.njit(forceinline=True, **FLAGS)
def _volume(
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    x2: float,
    y2: float,
    z2: float,
    x3: float,
    y3: float,
    z3: float,
    x4: float,
    y4: float,
    z4: float,
    x5: float,
    y5: float,
    z5: float,
) -> float:
    """Volume from the modes (xi, eta, zeta, eta zeta, xi zeta, xi eta; the last three times g).

    What the 2x2x2 rule gives, since the determinant is at most quadratic in each coordinate.
    """
    return 8.0 * (
        _triple(x0, y0, z0, x1, y1, z1, x2, y2, z2)
        + _triple(x0, y0, z0, x5, y5, z5, x4, y4, z4)
        + _triple(x5, y5, z5, x1, y1, z1, x3, y3, z3)
        + _triple(x4, y4, z4, x3, y3, z3, x2, y2, z2)
    )


@numba.njit(**FLAGS)
def _dilatation(s: Any, x: Any, lanes: int) -> None:
    """Pressure U'(Jbar) and the volumetric energy of each lane's element."""
    wide_vectors()
    for i in range(lanes):
        x0 = x[i]
        y0 = x[L + i]
        z0 = x[2 * L + i]
        x1 = x[3 * L + i]
        y1 = x[4 * L + i]
        z1 = x[5 * L + i]
        x2 = x[6 * L + i]
        y2 = x[7 * L + i]
        z2 = x[8 * L + i]
        x3 = x[9 * L + i]
        y3 = x[10 * L + i]
        z3 = x[11 * L + i]
        x4 = x[12 * L + i]
        y4 = x[13 * L + i]
        z4 = x[14 * L + i]
        x5 = x[15 * L + i]
        y5 = x[16 * L + i]
        z5 = x[17 * L + i]
        reference = _volume(x0, y0, z0, x1, y1, z1, x2, y2, z2, x3, y3, z3, x4, y4, z4, x5, y5, z5)
        x0 += s[i]
        y0 += s[L + i]
        z0 += s[2 * L + i]
        x1 += s[3 * L + i]
        y1 += s[4 * L + i]
        z1 += s[5 * L + i]
        x2 += s[6 * L + i]
        y2 += s[7 * L + i]
        z2 += s[8 * L + i]
        x3 += s[9 * L + i]
        y3 += s[10 * L + i]
        z3 += s[11 * L + i]
        x4 += s[12 * L + i]
        y4 += s[13 * L + i]
        z4 += s[14 * L + i]
        x5 += s[15 * L + i]
        y5 += s[16 * L + i]
        z5 += s[17 * L + i]
        current = _volume(x0, y0, z0, x1, y1, z1, x2, y2, z2, x3, y3, z3, x4, y4, z4, x5, y5, z5)
        d = current / reference - 1.0
        kappa = s[AT_KAPPA + i]
        square = d * (d + 2.0)
        s[AT_PRESSURE + i] = 0.5 * kappa * square / (1.0 + d)
        s[AT_ENERGY + i] = reference * (0.25 * kappa) * (square - 2.0 * log1p(d))


@numba.njit(forceinline=True, **FLAGS)
def _gradient(
    m: Any, i: int, sx: float, sy: float, sz: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Gradient in xi, eta, zeta of the field with modes `m` (21 rows) at a point of these signs."""
    sxy = sx * sy
    sxz = sx * sz
    syz = sy * sz
    x3, y3, z3 = m[9 * L + i], m[10 * L + i], m[11 * L + i]
    x4, y4, z4 = m[12 * L + i], m[13 * L + i], m[14 * L + i]
    x5, y5, z5 = m[15 * L + i], m[16 * L + i], m[17 * L + i]
    x6, y6, z6 = m[18 * L + i], m[19 * L + i], m[20 * L + i]
    return (
        m[i] + sy * x5 + sz * x4 + syz * x6,
        m[3 * L + i] + sx * x5 + sz * x3 + sxz * x6,
        m[6 * L + i] + sx * x4 + sy * x3 + sxy * x6,
        m[L + i] + sy * y5 + sz * y4 + syz * y6,
        m[4 * L + i] + sx * y5 + sz * y3 + sxz * y6,
        m[7 * L + i] + sx * y4 + sy * y3 + sxy * y6,
        m[2 * L + i] + sy * z5 + sz * z4 + syz * z6,
        m[5 * L + i] + sx * z5 + sz * z3 + sxz * z6,
        m[8 * L + i] + sx * z4 + sy * z3 + sxy * z6,
    )


@numba.njit(**FLAGS)
def _strain(s: Any, x: Any, points: Any, lanes: int) -> None:
    """Kinematics at the eight Gauss points from the modes `x` and `s` (21 rows each)."""
    wide_vectors()
    for q in range(8):
        p = points[q * L :]
        sx = 1.0 if q & 1 else -1.0
        sy = 1.0 if q & 2 else -1.0
        sz = 1.0 if q & 4 else -1.0
        for i in range(lanes):
            # Reference Jacobian j = dX/dxi, and displacement gradient h = du/dxi.
            j00, j01, j02, j10, j11, j12, j20, j21, j22 = _gradient(x, i, sx, sy, sz)
            h00, h01, h02, h10, h11, h12, h20, h21, h22 = _gradient(s, i, sx, sy, sz)
            c00, c01, c02, c10, c11, c12, c20, c21, c22 = cofactors(
                j00, j01, j02, j10, j11, j12, j20, j21, j22
            )
            det0 = j00 * c00 + j01 * c01 + j02 * c02
            # G = det0 (F - I) = h cof(j)^T; small strains keep their digits.
            g00 = h00 * c00 + h01 * c01 + h02 * c02
            g01 = h00 * c10 + h01 * c11 + h02 * c12
            g02 = h00 * c20 + h01 * c21 + h02 * c22
            g10 = h10 * c00 + h11 * c01 + h12 * c02
            g11 = h10 * c10 + h11 * c11 + h12 * c12
            g12 = h10 * c20 + h11 * c21 + h12 * c22
            g20 = h20 * c00 + h21 * c01 + h22 * c02
            g21 = h20 * c10 + h21 * c11 + h22 * c12
            g22 = h20 * c20 + h21 * c21 + h22 * c22
            # det0**2 (b - I) = det0 (G + G^T) + G G^T
            twice = 2.0 * det0
            b00 = twice * g00 + g00 * g00 + g01 * g01 + g02 * g02
            b11 = twice * g11 + g10 * g10 + g11 * g11 + g12 * g12
            b22 = twice * g22 + g20 * g20 + g21 * g21 + g22 * g22
            b01 = det0 * (g01 + g10) + g00 * g10 + g01 * g11 + g02 * g12
            b02 = det0 * (g02 + g20) + g00 * g20 + g01 * g21 + g02 * g22
            b12 = det0 * (g12 + g21) + g10 * g20 + g11 * g21 + g12 * g22
            store_strain(p, i, det0 * det0, b00, b11, b22, b01, b02, b12)
            # Current Jacobian, its cofactor (the stress acts on the area it maps), J.
            j00 += h00
            j01 += h01
            j02 += h02
            j10 += h10
            j11 += h11
            j12 += h12
            j20 += h20
            j21 += h21
            j22 += h22
            c00, c01, c02, c10, c11, c12, c20, c21, c22 = cofactors(
                j00, j01, j02, j10, j11, j12, j20, j21, j22
            )
            p[ROW_COF + i] = c00
            p[ROW_COF + R + i] = c01
            p[ROW_COF + 2 * R + i] = c02
            p[ROW_COF + 3 * R + i] = c10
            p[ROW_COF + 4 * R + i] = c11
            p[ROW_COF + 5 * R + i] = c12
            p[ROW_COF + 6 * R + i] = c20
            p[ROW_COF + 7 * R + i] = c21
            p[ROW_COF + 8 * R + i] = c22
            det = j00 * c00 + j01 * c01 + j02 * c02
            p[ROW_J + i] = det / det0
            p[ROW_RJ + i] = det0 / det
            p[ROW_DET0 + i] = det0


@numba.njit(**FLAGS)
def _point_volume(p: Any, kappa: Any, count: int) -> None:
    """Add U(J) of each point and write its slope."""
    wide_vectors()
    for i in range(count):
        d = p[ROW_J + i] - 1.0
        square = d * (d + 2.0)
        k = kappa[i]
        p[ROW_W + i] += 0.25 * k * (square - 2.0 * log1p(d))
        p[ROW_LM + i] = 0.5 * k * square * p[ROW_RJ + i]


@numba.njit(**FLAGS)
def _stress(s: Any, points: Any, lanes: int) -> None:
    """Turn the cofactors into Cauchy stress times cofactor; sum the energy."""
    wide_vectors()
    for i in range(lanes):
        s[AT_LEAST + i] = math.inf
    for q in range(8):
        p = points[q * L :]
        for i in range(lanes):
            pressure = s[AT_PRESSURE + i] + p[ROW_LM + i]
            t00, t11, t22, t01, t02, t12 = load_stress(p, i, p[ROW_RJ + i], pressure)
            c0 = p[ROW_COF + i]
            c1 = p[ROW_COF + 3 * R + i]
            c2 = p[ROW_COF + 6 * R + i]
            p[ROW_COF + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[ROW_COF + 3 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[ROW_COF + 6 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            c0 = p[ROW_COF + R + i]
            c1 = p[ROW_COF + 4 * R + i]
            c2 = p[ROW_COF + 7 * R + i]
            p[ROW_COF + R + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[ROW_COF + 4 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[ROW_COF + 7 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            c0 = p[ROW_COF + 2 * R + i]
            c1 = p[ROW_COF + 5 * R + i]
            c2 = p[ROW_COF + 8 * R + i]
            p[ROW_COF + 2 * R + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[ROW_COF + 5 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[ROW_COF + 8 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            s[AT_ENERGY + i] += p[ROW_DET0 + i] * p[ROW_W + i]
            j = p[ROW_J + i]
            least = s[AT_LEAST + i]
            s[AT_LEAST + i] = j if j < least else least


@numba.njit(**FLAGS)
def _corner_forces(s: Any, t: Any, lanes: int) -> None:
    """Sum the points into corner forces, the transpose of `_load_modes`, to AT_CORNERS."""
    wide_vectors()
    for c in range(3):
        r = ROW_COF + 3 * c * R
        v = AT_CORNERS + c * L
        for i in range(lanes):
            # Direction xi: pairs of points along xi, then signs (eta, zeta).
            a = t[r + i] + t[r + L + i]
            b = t[r + 2 * L + i] + t[r + 3 * L + i]
            d = t[r + 4 * L + i] + t[r + 5 * L + i]
            e = t[r + 6 * L + i] + t[r + 7 * L + i]
            m0 = (a + b) + (d + e)
            m5 = (b - a) + (e - d)
            m4 = (d + e) - (a + b)
            m6 = (e - d) - (b - a)
            # Direction eta: pairs along eta, signs (xi, zeta).
            a = t[r + R + i] + t[r + R + 2 * L + i]
            b = t[r + R + L + i] + t[r + R + 3 * L + i]
            d = t[r + R + 4 * L + i] + t[r + R + 6 * L + i]
            e = t[r + R + 5 * L + i] + t[r + R + 7 * L + i]
            m1 = (a + b) + (d + e)
            m5 += (b - a) + (e - d)
            m3 = (d + e) - (a + b)
            m6 += (e - d) - (b - a)
            # Direction zeta: pairs along zeta, signs (xi, eta).
            a = t[r + 2 * R + i] + t[r + 2 * R + 4 * L + i]
            b = t[r + 2 * R + L + i] + t[r + 2 * R + 5 * L + i]
            d = t[r + 2 * R + 2 * L + i] + t[r + 2 * R + 6 * L + i]
            e = t[r + 2 * R + 3 * L + i] + t[r + 2 * R + 7 * L + i]
            m2 = (a + b) + (d + e)
            m4 += (b - a) + (e - d)
            m3 += (d + e) - (a + b)
            m6 += (e - d) - (b - a)
            m0 *= 0.125
            m1 *= 0.125
            m2 *= 0.125
            m3 *= 0.125 * _G
            m4 *= 0.125 * _G
            m5 *= 0.125 * _G
            m6 *= 0.125 * _G * _G
            # Corner (x, y, z): x m0 + y m1 + z m2 + yz m3 + xz m4 + xy m5 + xyz m6.
            p = m1 + m5
            q = m1 - m5
            f = m3 + m6
            g = m3 - m6
            xp = m0 + m4
            xm = m0 - m4
            s[v + i] = -(m0 - m4) - (m1 - m5) - m2 + (m3 - m6)
            s[v + 3 * L + i] = xm - p - m2 + f
            s[v + 6 * L + i] = xm + p - m2 - f
            s[v + 9 * L + i] = -xm + q - m2 - g
            s[v + 12 * L + i] = -xp - q + m2 - g
            s[v + 15 * L + i] = xp - p + m2 - f
            s[v + 18 * L + i] = xp + p + m2 + f
            s[v + 21 * L + i] = -xp + q + m2 + g


@numba.njit(parallel=True, **FLAGS)
def reference_modes(x: Any, cells: Any, lanes: int, modes: Any) -> None:
    """Fill `modes` (batch_count, 21 LANES) from reference coordinates `x`, flat [m]."""
    last = cells.shape[0] - 1
    for b in numba.prange(modes.shape[0]):
        v = np.empty(24 * L)
        load_corners(b * L, last, x, cells, v)
        _load_modes(v, lanes, modes[b])


@numba.njit(**FLAGS)
def _store(first: int, last: int, s: Any, forces: Any, energy: Any, least: Any) -> None:
    """Lanes into element arrays; no force and energy inf where J <= 0 or NaN."""
    for i in range(min(L, last + 1 - first)):
        e = np.uint64(first + i)
        j = s[AT_LEAST + i]
        w = s[AT_ENERGY + i]
        good = j > 0.0 and w == w
        least[e] = j if good or not j > 0.0 else math.nan
        energy[e] = w if good else math.inf
        if good:
            for a in range(24):
                forces[e, a] = s[AT_CORNERS + a * L + i]
        else:
            for a in range(24):
                forces[e, a] = 0.0


@numba.njit(**FLAGS)
def _batch(
    first: int,
    last: int,
    lanes: int,
    modes: Any,
    u: Any,
    cells: Any,
    laws: Any,
    plan: Any,
    scratch: Any,
    forces: Any,
    energy: Any,
    least: Any,
) -> None:
    """Elements `first` to `first + LANES - 1`; lanes beyond `last` repeat it and are dropped.

    `lanes` is LANES, but passed where LLVM cannot see it: it would unroll the loops over lanes
    before it looks for vectors.
    """
    wide_vectors()
    s = scratch[8 : 8 + ELEMENT_SIZE]
    p = scratch[8 + ELEMENT_SIZE : 8 + ELEMENT_SIZE + POINT_SIZE]
    coefficient = scratch[8 + ELEMENT_SIZE + POINT_SIZE :]
    count = 8 * lanes
    if plan[0] < 0 or scratch[0] != plan[0]:
        load_material(first, last, laws, s, coefficient)
        scratch[0] = plan[0]
    load_corners(first, last, u, cells, s[AT_CORNERS:])
    _load_modes(s[AT_CORNERS:], lanes, s)
    _dilatation(s, modes, lanes)
    _strain(s, modes, p, lanes)
    evaluate_law(p, coefficient, plan, count)
    if plan[3]:
        _point_volume(p, coefficient[3 * R :], count)
    else:
        for i in range(count):
            p[ROW_LM + i] = 0.0
    _stress(s, p, lanes)
    _corner_forces(s, p, lanes)
    _store(first, last, s, forces, energy, least)


@numba.njit(parallel=True, **FLAGS)
def _element_forces(
    lanes: int,
    modes: Any,
    u: Any,
    cells: Any,
    laws: Any,
    scratch: Any,
    forces: Any,
    energy: Any,
    least: Any,
) -> None:
    last = cells.shape[0] - 1
    plan = laws.plan
    for k in range(scratch.shape[0]):
        scratch[k, 0] = -1.0
    for b in numba.prange((last + L) // L):
        mine = scratch[numba.get_thread_id()]
        _batch(b * L, last, lanes, modes[b], u, cells, laws, plan[b], mine, forces, energy, least)


@numba.njit(parallel=True, **FLAGS)
def _gather(forces: Any, node_start: Any, node_cell: Any, out: Any) -> None:
    for node in numba.prange(out.shape[0]):
        f0 = 0.0
        f1 = 0.0
        f2 = 0.0
        for k in range(node_start[node], node_start[node + 1]):
            at = np.uint64(3) * np.uint64(node_cell[k])
            f0 += forces[at]
            f1 += forces[at + np.uint64(1)]
            f2 += forces[at + np.uint64(2)]
        out[node, 0] = f0
        out[node, 1] = f1
        out[node, 2] = f2


class InternalForce:
    """Internal force of a mesh of eight-node hexahedra, prepared once and evaluated often.

    Parameters
    ----------
    nodes
        Reference coordinates [m], shape (node_count, 3).
    cells
        Corners in VTK order, shape (cell_count, 8).
    material
        Row of the law arrays per cell, shape (cell_count,). Cells of one material next to each
        other are fastest.
    mu, alpha
        Ogden terms [Pa] and [-] in the ``mu/alpha`` convention, shape (material_count,
        term_count); terms with mu = 0 are padding.
    c
        Yeoh's coefficients [Pa], shape (material_count, 3).
    kappa
        Bulk moduli of the mean dilatation [Pa], shape (material_count,).
    kappa_point
        Bulk moduli that act point by point [Pa], shape (material_count,); zero if left out.

    Attributes
    ----------
    element_force
        [N], shape (cell_count, 8, 3).
    element_energy
        [J], shape (cell_count,); infinite where `least_j` is not above zero.
    least_j
        Least determinant of the deformation gradient at the points, shape (cell_count,).
    """

    def __init__(
        self,
        nodes: np.ndarray,
        cells: np.ndarray,
        material: np.ndarray,
        mu: np.ndarray,
        alpha: np.ndarray,
        c: np.ndarray,
        kappa: np.ndarray,
        kappa_point: np.ndarray | None = None,
    ) -> None:
        self.cells = np.ascontiguousarray(cells, dtype=np.int32)
        self.material = np.ascontiguousarray(material, dtype=np.int32)
        cell_count = self.cells.shape[0]
        node_count = nodes.shape[0]
        if cell_count == 0:
            raise InputError("a mesh needs at least one cell")
        if self.cells.min() < 0 or self.cells.max() >= node_count:
            raise InputError(f"cells name nodes outside 0 to {node_count - 1}")
        flat = self.cells.ravel()
        self.node_cell = np.argsort(flat, kind="stable").astype(np.int32)
        counts = np.bincount(flat, minlength=node_count)
        self.node_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._modes = aligned((cell_count + LANES - 1) // LANES, 21 * LANES)
        x = np.ascontiguousarray(nodes, dtype=float).ravel()
        reference_modes(x, self.cells, LANES, self._modes)
        self._force = aligned(cell_count, 24)
        self.element_force = self._force.reshape(-1, 8, 3)
        self.element_energy = np.zeros(cell_count)
        self.least_j = np.ones(cell_count)
        self.set_laws(mu, alpha, c, kappa, kappa_point)

    def set_laws(
        self,
        mu: np.ndarray,
        alpha: np.ndarray,
        c: np.ndarray,
        kappa: np.ndarray,
        kappa_point: np.ndarray | None = None,
    ) -> None:
        """Take new coefficients for the same materials."""
        self._laws = pack_laws(
            self.material, mu, alpha, c, kappa, 0.0 if kappa_point is None else kappa_point
        )
        threads = int(numba.config.NUMBA_NUM_THREADS)
        self._scratch = aligned(threads, scratch_size(self._laws.mu.shape[1]))

    def __call__(self, u: np.ndarray, out: np.ndarray) -> float:
        """Write the internal force [N] at displacement `u` [m] into `out`; return the energy [J].

        Both have shape (node_count, 3), contiguous. The result has the same bits for any number
        of threads. Where an element is turned inside out (`least_j` not above zero) the energy
        is infinite and the element adds no force.
        """
        _element_forces(
            LANES,
            self._modes,
            u.reshape(-1),
            self.cells,
            self._laws,
            self._scratch,
            self._force,
            self.element_energy,
            self.least_j,
        )
        _gather(self._force.reshape(-1), self.node_start, self.node_cell, out)
        return float(self.element_energy.sum())
