"""Element kernels: tangent, stress and assembly of total-Lagrangian hexahedra.

Eight-node hexahedra with mean dilatation (Q1/P0; Simo, Taylor & Pister 1985,
doi:10.1016/0045-7825(85)90033-7): the isochoric energy is taken at each of the 2x2x2 Gauss
points, the volumetric energy at the element's mean ``Jbar = sum_q w_q J_q / V``, but for a small
part with modulus ``kappa_point`` that acts at each point:

    energy = sum_q w_q (W(F_q) + U(J_q; kappa_point)) + V U(Jbar; kappa - kappa_point)

The mean alone leaves the change of volume *within* an element free, which is too soft in
bending (a third of the plane-strain stiffness) and lets squeezed points turn inside out.
Matching the bending energy of an incompressible strip asks for kappa_point = 8/3 G; see
`flexapod.fem.body`.

Arrays, element-first: ``cells`` (cell_count, 8); ``gradients`` (cell_count, 8, 8, 3), the
reference gradients of the shape functions [1/m] per (element, point, corner, direction);
``weights`` (cell_count, 8) [m3]; ``material`` (cell_count,) row of the law arrays ``mu, alpha``
(material_count, term_count), ``c`` (material_count, 3), ``kappa`` (mean part) and
``kappa_point`` (material_count,) [Pa].
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.core.jit import inline_kernel, kernel, parallel_kernel
from flexapod.fem.lane_kernels import FLAGS, wide_vectors
from flexapod.materials.kernels import (
    isochoric_stress,
    isochoric_tangent,
    symmetric_eigen,
    volumetric_modulus,
    volumetric_pressure,
)

# Pairs of corners (a <= b) whose 3x3 blocks an element stores.
PAIR_A, PAIR_B = np.triu_indices(8)
PAIR_COUNT = 36
PAIR_OF = np.zeros((8, 8), dtype=np.int64)
PAIR_OF[PAIR_A, PAIR_B] = np.arange(PAIR_COUNT)
PAIR_OF[PAIR_B, PAIR_A] = np.arange(PAIR_COUNT)

# Rows of `element_tangents`' scratch: an entry per pair and, so that whole vectors fill them, some
# more that repeat the last pair. First 3 components at corner a, then at b, then 9 of the blocks.
PAIR_LANES = 40
_LANE_A = np.append(PAIR_A, [7] * (PAIR_LANES - PAIR_COUNT)).astype(np.int64)
_LANE_B = np.append(PAIR_B, [7] * (PAIR_LANES - PAIR_COUNT)).astype(np.int64)
ROW_A, ROW_B, ROW_K, ROWS = 0, 3 * PAIR_LANES, 6 * PAIR_LANES, 15 * PAIR_LANES


@inline_kernel
def deformation_gradient(ue: Any, gradients: Any, f: Any) -> float:
    """Fill `f` with I + sum_a u_a (x) dN_a and return its determinant."""
    for i in range(3):
        for j in range(3):
            f[i, j] = 1.0 if i == j else 0.0
    for a in range(8):
        for i in range(3):
            for j in range(3):
                f[i, j] += ue[a, i] * gradients[a, j]
    return (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )


@inline_kernel
def _spatial_gradients(f: Any, gradients: Any, b: Any) -> None:
    """Fill `b` (8, 3) with F^-T dN_a."""
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    c10 = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c11 = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c12 = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c20 = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c21 = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c22 = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    r = 1.0 / (f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02)
    for a in range(8):
        g0 = gradients[a, 0]
        g1 = gradients[a, 1]
        g2 = gradients[a, 2]
        b[a, 0] = r * (c00 * g0 + c01 * g1 + c02 * g2)
        b[a, 1] = r * (c10 * g0 + c11 * g1 + c12 * g2)
        b[a, 2] = r * (c20 * g0 + c21 * g1 + c22 * g2)


@inline_kernel
def _left_cauchy_green(f: Any, b: Any) -> None:
    for i in range(3):
        for j in range(3):
            b[i, j] = f[i, 0] * f[j, 0] + f[i, 1] * f[j, 1] + f[i, 2] * f[j, 2]


@numba.njit(**FLAGS)
def _add_pairs(t: Any, count: int, m: Any, n: Any) -> None:
    """Add to the blocks of all pairs in the scratch `t` what one point gives.

    `m` (15,) are the point's weight times moduli in principal axes: on the diagonal 00, 11, 22,
    then the shear quotients 01, 02, 10, 12, 20, 21, then 01, 02, 12 of the couplings of two
    directions, direct and crossed. `n` (3, 3) has the axes in columns.
    """
    wide_vectors()
    a00, a11, a22 = m[0], m[1], m[2]
    s01, s02, s10, s12, s20, s21 = m[3], m[4], m[5], m[6], m[7], m[8]
    n01, n02, n12, h01, h02, h12 = m[9], m[10], m[11], m[12], m[13], m[14]
    x0, y0, z0 = n[0, 0], n[0, 1], n[0, 2]
    x1, y1, z1 = n[1, 0], n[1, 1], n[1, 2]
    x2, y2, z2 = n[2, 0], n[2, 1], n[2, 2]
    for k in range(count):
        b0, b1, b2 = t[ROW_A + k], t[ROW_A + PAIR_LANES + k], t[ROW_A + 2 * PAIR_LANES + k]
        c0, c1, c2 = t[ROW_B + k], t[ROW_B + PAIR_LANES + k], t[ROW_B + 2 * PAIR_LANES + k]
        m0, m1, m2 = b0 * c0, b1 * c1, b2 * c2
        m01, m10 = b0 * c1, b1 * c0
        m02, m20 = b0 * c2, b2 * c0
        m12, m21 = b1 * c2, b2 * c1
        k00 = a00 * m0 + s01 * m1 + s02 * m2
        k11 = s10 * m0 + a11 * m1 + s12 * m2
        k22 = s20 * m0 + s21 * m1 + a22 * m2
        k01 = n01 * m01 + h01 * m10
        k10 = n01 * m10 + h01 * m01
        k02 = n02 * m02 + h02 * m20
        k20 = n02 * m20 + h02 * m02
        k12 = n12 * m12 + h12 * m21
        k21 = n12 * m21 + h12 * m12
        r0 = k00 * x0 + k01 * y0 + k02 * z0
        r1 = k10 * x0 + k11 * y0 + k12 * z0
        r2 = k20 * x0 + k21 * y0 + k22 * z0
        t[ROW_K + k] += x0 * r0 + y0 * r1 + z0 * r2
        t[ROW_K + 3 * PAIR_LANES + k] += x1 * r0 + y1 * r1 + z1 * r2
        t[ROW_K + 6 * PAIR_LANES + k] += x2 * r0 + y2 * r1 + z2 * r2
        r0 = k00 * x1 + k01 * y1 + k02 * z1
        r1 = k10 * x1 + k11 * y1 + k12 * z1
        r2 = k20 * x1 + k21 * y1 + k22 * z1
        t[ROW_K + PAIR_LANES + k] += x0 * r0 + y0 * r1 + z0 * r2
        t[ROW_K + 4 * PAIR_LANES + k] += x1 * r0 + y1 * r1 + z1 * r2
        t[ROW_K + 7 * PAIR_LANES + k] += x2 * r0 + y2 * r1 + z2 * r2
        r0 = k00 * x2 + k01 * y2 + k02 * z2
        r1 = k10 * x2 + k11 * y2 + k12 * z2
        r2 = k20 * x2 + k21 * y2 + k22 * z2
        t[ROW_K + 2 * PAIR_LANES + k] += x0 * r0 + y0 * r1 + z0 * r2
        t[ROW_K + 5 * PAIR_LANES + k] += x1 * r0 + y1 * r1 + z1 * r2
        t[ROW_K + 8 * PAIR_LANES + k] += x2 * r0 + y2 * r1 + z2 * r2


@parallel_kernel
def element_tangents(
    u: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    material: Any,
    mu: Any,
    alpha: Any,
    c: Any,
    kappa_point: Any,
    kappa: Any,
    pressure: Any,
    out: Any,
) -> None:
    """Fill `out` (cell_count, 36, 3, 3) with the consistent tangent blocks of corner pairs a <= b.

    `pressure` (cell_count,) is dU/dJ [Pa] for the geometric part; see `predict_pressure` for why
    it is not always the one of the displacement.

    Spatial form in principal axes (Simo & Taylor 1991, doi:10.1016/0045-7825(91)90100-K, with
    the shear quotients written so that equal stretches need no perturbation).
    """
    cell_count = cells.shape[0]
    chunk = 64
    for block in numba.prange((cell_count + chunk - 1) // chunk):
        ue = np.empty((8, 3))
        f = np.empty((8, 3, 3))
        jac = np.empty(8)
        left = np.empty((3, 3))
        x = np.empty(3)
        n = np.empty((3, 3))
        b = np.empty((8, 3))
        bp = np.empty((8, 3))
        g = np.empty((8, 3))
        d = np.empty((3, 3))
        s = np.empty((3, 3))
        t = np.empty(ROWS)
        moduli = np.empty(15)
        for e in range(block * chunk, min((block + 1) * chunk, cell_count)):
            m = material[e]
            for a in range(8):
                for i in range(3):
                    ue[a, i] = u[cells[e, a], i]
                    g[a, i] = 0.0
            volume = 0.0
            mean_j = 0.0
            for q in range(8):
                jac[q] = deformation_gradient(ue, gradients[e, q], f[q])
                volume += weights[e, q]
                mean_j += weights[e, q] * jac[q]
            mean_j /= volume
            p = pressure[e]
            t[ROW_K:] = 0.0
            for q in range(8):
                w = weights[e, q]
                _spatial_gradients(f[q], gradients[e, q], b)
                _left_cauchy_green(f[q], left)
                symmetric_eigen(left, x, n)
                e1 = 0.5 * math.log(x[0])
                e2 = 0.5 * math.log(x[1])
                e3 = 0.5 * math.log(x[2])
                tau = isochoric_stress(mu[m], alpha[m], c[m], e1, e2, e3)
                isochoric_tangent(mu[m], alpha[m], c[m], e1, e2, e3, d, s)
                pj = (p + volumetric_pressure(kappa_point[m], jac[q])) * jac[q]
                dj = volumetric_modulus(kappa_point[m], jac[q]) * jac[q] * jac[q]
                for a in range(8):
                    for i in range(3):
                        g[a, i] += w * jac[q] * b[a, i]
                        bp[a, i] = n[0, i] * b[a, 0] + n[1, i] * b[a, 1] + n[2, i] * b[a, 2]
                moduli[0] = w * (d[0, 0] - tau[0] + dj)
                moduli[1] = w * (d[1, 1] - tau[1] + dj)
                moduli[2] = w * (d[2, 2] - tau[2] + dj)
                moduli[3] = w * s[0, 1]
                moduli[4] = w * s[0, 2]
                moduli[5] = w * s[1, 0]
                moduli[6] = w * s[1, 2]
                moduli[7] = w * s[2, 0]
                moduli[8] = w * s[2, 1]
                moduli[9] = w * (d[0, 1] + pj + dj)
                moduli[10] = w * (d[0, 2] + pj + dj)
                moduli[11] = w * (d[1, 2] + pj + dj)
                moduli[12] = w * (s[0, 1] - tau[1] - pj)
                moduli[13] = w * (s[0, 2] - tau[2] - pj)
                moduli[14] = w * (s[1, 2] - tau[2] - pj)
                for i in range(3):
                    for k in range(PAIR_LANES):
                        t[ROW_A + i * PAIR_LANES + k] = bp[_LANE_A[k], i]
                        t[ROW_B + i * PAIR_LANES + k] = bp[_LANE_B[k], i]
                _add_pairs(t, PAIR_LANES, moduli, n)
            factor = volumetric_modulus(kappa[m], mean_j) / volume
            k = 0
            for a in range(8):
                for bb in range(a, 8):
                    for i in range(3):
                        for j in range(3):
                            own = t[ROW_K + (3 * i + j) * PAIR_LANES + k]
                            out[e, k, i, j] = own + factor * g[a, i] * g[bb, j]
                    k += 1


@parallel_kernel
def predict_pressure(
    u: Any,
    du: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    material: Any,
    kappa: Any,
    out: Any,
) -> None:
    """Fill `out` (cell_count,) with dU/dJ [Pa] linearised from `u` along `du`.

    Eliminating the pressure of the mixed (displacement, pressure, dilatation) form element by
    element gives the displacement tangent, but with this linear pressure in its geometric part.
    The pressure of the new displacement itself carries the bulk modulus times the second-order
    volume error of the step, which spoils the next tangent and with it the radius of
    convergence. Both agree at the solution, so the order of convergence stays two.
    """
    for e in numba.prange(cells.shape[0]):
        ue = np.empty((8, 3))
        de = np.empty((8, 3))
        f = np.empty((3, 3))
        b = np.empty((8, 3))
        for a in range(8):
            for i in range(3):
                ue[a, i] = u[cells[e, a], i]
                de[a, i] = du[cells[e, a], i]
        volume = 0.0
        mean_j = 0.0
        change = 0.0
        for q in range(8):
            jac = deformation_gradient(ue, gradients[e, q], f)
            _spatial_gradients(f, gradients[e, q], b)
            w = weights[e, q]
            volume += w
            mean_j += w * jac
            for a in range(8):
                for i in range(3):
                    change += w * jac * b[a, i] * de[a, i]
        mean_j /= volume
        k = kappa[material[e]]
        out[e] = volumetric_pressure(k, mean_j) + volumetric_modulus(k, mean_j) * change / volume


@parallel_kernel
def pressure_error_forces(
    u: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    material: Any,
    kappa: Any,
    pressure: Any,
    out: Any,
) -> None:
    """Fill `out` (cell_count, 8, 3) with the forces [N] of `pressure` minus the body's own dU/dJ.

    Added to the internal force it gives the residual of the mixed form at an independent
    pressure, free of the bulk modulus times the second-order volume error of a step.
    """
    for e in numba.prange(cells.shape[0]):
        ue = np.empty((8, 3))
        f = np.empty((3, 3))
        b = np.empty((8, 3))
        for a in range(8):
            for i in range(3):
                ue[a, i] = u[cells[e, a], i]
                out[e, a, i] = 0.0
        volume = 0.0
        mean_j = 0.0
        for q in range(8):
            jac = deformation_gradient(ue, gradients[e, q], f)
            _spatial_gradients(f, gradients[e, q], b)
            w = weights[e, q]
            volume += w
            mean_j += w * jac
            for a in range(8):
                for i in range(3):
                    out[e, a, i] += w * jac * b[a, i]
        dp = pressure[e] - volumetric_pressure(kappa[material[e]], mean_j / volume)
        for a in range(8):
            for i in range(3):
                out[e, a, i] *= dp


@parallel_kernel
def gather_forces(element_forces: Any, node_start: Any, node_cell: Any, out: Any) -> None:
    """Sum element forces into nodes in a fixed order: the same bits for any thread count."""
    for node in numba.prange(out.shape[0]):
        f0 = 0.0
        f1 = 0.0
        f2 = 0.0
        for k in range(node_start[node], node_start[node + 1]):
            e = node_cell[k] // 8
            a = node_cell[k] % 8
            f0 += element_forces[e, a, 0]
            f1 += element_forces[e, a, 1]
            f2 += element_forces[e, a, 2]
        out[node, 0] = f0
        out[node, 1] = f1
        out[node, 2] = f2


@parallel_kernel
def gather_tangents(
    tangents: Any,
    cells: Any,
    pair_of: Any,
    node_start: Any,
    node_cell: Any,
    row_start: Any,
    block_position: Any,
    blocks: Any,
) -> None:
    """Sum element blocks into the upper node blocks (block_count, 3, 3), row by row."""
    for node in numba.prange(row_start.shape[0] - 1):
        for k in range(row_start[node], row_start[node + 1]):
            for i in range(3):
                for j in range(3):
                    blocks[k, i, j] = 0.0
        for t in range(node_start[node], node_start[node + 1]):
            e = node_cell[t] // 8
            a = node_cell[t] % 8
            for b in range(8):
                k = block_position[e, a, b]
                if k < 0:
                    continue
                p = pair_of[a, b]
                if a <= b:
                    for i in range(3):
                        for j in range(3):
                            blocks[k, i, j] += tangents[e, p, i, j]
                else:
                    for i in range(3):
                        for j in range(3):
                            blocks[k, i, j] += tangents[e, p, j, i]


@kernel
def find_block_positions(cells: Any, row_start: Any, columns: Any, out: Any) -> None:
    """Fill `out` (cell_count, 8, 8) with the block index of (node a, node b >= a), else -1."""
    for e in range(cells.shape[0]):
        for a in range(8):
            for b in range(8):
                row = cells[e, a]
                column = cells[e, b]
                out[e, a, b] = -1
                if column >= row:
                    lo = row_start[row]
                    hi = row_start[row + 1]
                    out[e, a, b] = lo + np.searchsorted(columns[lo:hi], column)


@kernel
def add_blocks(nodes: Any, stiffness: Any, row_start: Any, columns: Any, blocks: Any) -> int:
    """Add dense symmetric (item_count, 3k, 3k) matrices over `nodes` (item_count, k).

    Returns the number of node pairs the pattern lacks (0 when all went in). A node listed twice
    in one item counts with the sum of its entries.
    """
    missing = 0
    k_count = nodes.shape[1]
    for item in range(nodes.shape[0]):
        for a in range(k_count):
            row = nodes[item, a]
            for b in range(k_count):
                column = nodes[item, b]
                if column < row:
                    continue
                lo = row_start[row]
                hi = row_start[row + 1]
                k = lo + np.searchsorted(columns[lo:hi], column)
                if k >= hi or columns[k] != column:
                    missing += 1
                    continue
                for i in range(3):
                    for j in range(3):
                        blocks[k, i, j] += stiffness[item, 3 * a + i, 3 * b + j]
    return missing


@parallel_kernel
def blocks_to_csr(
    blocks: Any, row_start: Any, columns: Any, fixed: Any, indptr: Any, data: Any
) -> None:
    """Write the upper triangle of the condition-reduced matrix into CSR values.

    Rows and columns of fixed degrees of freedom become rows of the identity, so the pattern
    never changes with the conditions.
    """
    for node in numba.prange(row_start.shape[0] - 1):
        for i in range(3):
            at = indptr[3 * node + i]
            for k in range(row_start[node], row_start[node + 1]):
                other = columns[k]
                for j in range(3):
                    if other == node and j < i:
                        continue
                    if fixed[3 * node + i] or fixed[3 * other + j]:
                        data[at] = 1.0 if (other == node and i == j) else 0.0
                    else:
                        data[at] = blocks[k, i, j]
                    at += 1


@kernel
def blocks_product(blocks: Any, row_start: Any, columns: Any, vector: Any, out: Any) -> None:
    """Product of the symmetric block matrix with `vector` (node_count, 3)."""
    out[:] = 0.0
    for node in range(row_start.shape[0] - 1):
        for k in range(row_start[node], row_start[node + 1]):
            other = columns[k]
            for i in range(3):
                for j in range(3):
                    out[node, i] += blocks[k, i, j] * vector[other, j]
                    if other != node:
                        out[other, j] += blocks[k, i, j] * vector[node, i]


@parallel_kernel
def element_fields(
    u: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    material: Any,
    mu: Any,
    alpha: Any,
    c: Any,
    kappa_point: Any,
    kappa: Any,
    cauchy: Any,
    log_stretches: Any,
    pressure: Any,
) -> None:
    """Volume-mean Cauchy stress (cell_count, 3, 3) and pressure [Pa], log stretches per point.

    `log_stretches` has shape (cell_count, 8, 3), sorted descending; `pressure` is minus a third
    of the trace of the Cauchy stress.
    """
    for e in numba.prange(cells.shape[0]):
        ue = np.empty((8, 3))
        f = np.empty((8, 3, 3))
        jac = np.empty(8)
        left = np.empty((3, 3))
        x = np.empty(3)
        n = np.empty((3, 3))
        m = material[e]
        for a in range(8):
            for i in range(3):
                ue[a, i] = u[cells[e, a], i]
        volume = 0.0
        mean_j = 0.0
        for q in range(8):
            jac[q] = deformation_gradient(ue, gradients[e, q], f[q])
            volume += weights[e, q]
            mean_j += weights[e, q] * jac[q]
        current = mean_j
        mean_j /= volume
        p = volumetric_pressure(kappa[m], mean_j)
        cauchy[e] = 0.0
        for q in range(8):
            w = weights[e, q] / current
            _left_cauchy_green(f[q], left)
            symmetric_eigen(left, x, n)
            e1 = 0.5 * math.log(x[0])
            e2 = 0.5 * math.log(x[1])
            e3 = 0.5 * math.log(x[2])
            t = isochoric_stress(mu[m], alpha[m], c[m], e1, e2, e3)
            for i in range(3):
                for j in range(3):
                    cauchy[e, i, j] += w * (
                        n[i, 0] * t[0] * n[j, 0]
                        + n[i, 1] * t[1] * n[j, 1]
                        + n[i, 2] * t[2] * n[j, 2]
                    )
                cauchy[e, i, i] += w * (p + volumetric_pressure(kappa_point[m], jac[q])) * jac[q]
            high = max(e1, e2, e3)
            low = min(e1, e2, e3)
            log_stretches[e, q, 0] = high
            log_stretches[e, q, 1] = e1 + e2 + e3 - high - low
            log_stretches[e, q, 2] = low
        pressure[e] = -(cauchy[e, 0, 0] + cauchy[e, 1, 1] + cauchy[e, 2, 2]) / 3.0
