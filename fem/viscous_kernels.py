"""Viscous overstress of hexahedra by a Prony series at finite strain, for the vector units.

Simo's model (J. C. Simo 1987, doi:10.1016/0045-7825(87)90107-1) in displacement-driven form.
With ``Fb = J**(-1/3) F`` and the deviatoric Kirchhoff stress ``tau`` of the long-term law,

    S   = Fb^-1 tau Fb^-T                              pulled back to the reference
    Q_i <- e_i Q_i + g_i k_i (S_new - S_old),          e_i = exp(-x_i), k_i = (1 - e_i)/x_i,
                                                       x_i = dt/tau_i
    tau_v = dev(Fb (sum_i Q_i) Fb^T),                  P = tau_v F^-T

The recurrence (R. L. Taylor, K. S. Pister, G. L. Goudreau 1970, doi:10.1002/nme.1620020106) is
exact for a stress S that is linear in time over a step, so of second order, and bounded for any
step. S and Q_i live in the reference frame: a superposed rotation changes neither. The last
``dev`` is Simo's: the stress remembered from another shape is no longer without trace in the
present one, and the model leaves the pressure elastic.

The layout and the stages of the law are those of `fem.element_kernels`: batches of LANES
elements, point rows of 8 LANES numbers with stride R.
"""

from __future__ import annotations

import math
from typing import Any

import numba

from flexapod.core.jit import kernel
from flexapod.fem.element_kernels import (
    AT_CORNERS,
    ELEMENT_SIZE,
    POINT_SIZE,
    ROW_COF,
    ROW_J,
    ROW_OGDEN,
    ROW_P,
    ROW_T2,
    ROW_Z,
    R,
    cofactors,
    evaluate_law,
    load_corners,
    load_material,
    load_stress,
    store_strain,
)
from flexapod.fem.lane_kernels import FLAGS, LANES, LOG2_E, exp2m1, log1p, wide_vectors

L = LANES
# Rows of the point scratch that the law has done with by then.
_SUM = ROW_P  # 6, over ROW_LM and the logarithms: the branches' sum as 00, 11, 22, 01, 02, 12
_SHRINK = ROW_T2


@kernel
def branch_factors(moduli: Any, times: Any, dt: float, out: Any) -> None:
    """Fill `out` (material_count, branch_count, 2) with e_i and g_i k_i for a step `dt` [s].

    `moduli` and `times` have shape (material_count, branch_count); a branch without modulus is
    padding. An infinite step forgets everything.
    """
    for m in range(moduli.shape[0]):
        for k in range(moduli.shape[1]):
            x = dt / times[m, k]
            out[m, k, 0] = math.exp(-x)
            share = 1.0
            if x > 0.0:
                share = -math.expm1(-x) / x
            out[m, k, 1] = moduli[m, k] * share


@numba.njit(**FLAGS)
def _load_branches(first: int, last: int, material: Any, factors: Any, rows: Any) -> None:
    for k in range(factors.shape[1]):
        for i in range(L):
            m = material[min(first + i, last)]
            for q in range(8):
                rows[2 * k * R + q * L + i] = factors[m, k, 0]
                rows[(2 * k + 1) * R + q * L + i] = factors[m, k, 1]


@numba.njit(**FLAGS)
def _displacement_gradients(g: Any, v: Any, p: Any, lanes: int) -> None:
    """du/dX at the points into nine rows from ROW_COF, of corner values `v`; `g` as below."""
    wide_vectors()
    for q in range(8):
        h = p[ROW_COF + q * L :]
        for i in range(lanes):
            h00 = 0.0
            h01 = 0.0
            h02 = 0.0
            h10 = 0.0
            h11 = 0.0
            h12 = 0.0
            h20 = 0.0
            h21 = 0.0
            h22 = 0.0
            for a in range(8):
                at = 3 * a * L + i
                u0 = v[at]
                u1 = v[at + L]
                u2 = v[at + 2 * L]
                at += 24 * q * L
                g0 = g[at]
                g1 = g[at + L]
                g2 = g[at + 2 * L]
                h00 += u0 * g0
                h01 += u0 * g1
                h02 += u0 * g2
                h10 += u1 * g0
                h11 += u1 * g1
                h12 += u1 * g2
                h20 += u2 * g0
                h21 += u2 * g1
                h22 += u2 * g2
            h[i] = h00
            h[R + i] = h01
            h[2 * R + i] = h02
            h[3 * R + i] = h10
            h[4 * R + i] = h11
            h[5 * R + i] = h12
            h[6 * R + i] = h20
            h[7 * R + i] = h21
            h[8 * R + i] = h22


@numba.njit(**FLAGS)
def _strain(p: Any, count: int) -> None:
    """Z = dev(b)/q, its invariants as the law stages want them, and J."""
    wide_vectors()
    for i in range(count):
        h00 = p[ROW_COF + i]
        h01 = p[ROW_COF + R + i]
        h02 = p[ROW_COF + 2 * R + i]
        h10 = p[ROW_COF + 3 * R + i]
        h11 = p[ROW_COF + 4 * R + i]
        h12 = p[ROW_COF + 5 * R + i]
        h20 = p[ROW_COF + 6 * R + i]
        h21 = p[ROW_COF + 7 * R + i]
        h22 = p[ROW_COF + 8 * R + i]
        # b - I, so that small strains keep their digits.
        b00 = 2.0 * h00 + h00 * h00 + h01 * h01 + h02 * h02
        b11 = 2.0 * h11 + h10 * h10 + h11 * h11 + h12 * h12
        b22 = 2.0 * h22 + h20 * h20 + h21 * h21 + h22 * h22
        b01 = h01 + h10 + h00 * h10 + h01 * h11 + h02 * h12
        b02 = h02 + h20 + h00 * h20 + h01 * h21 + h02 * h22
        b12 = h12 + h21 + h10 * h20 + h11 * h21 + h12 * h22
        store_strain(p, i, 1.0, b00, b11, b22, b01, b02, b12)
        h00 += 1.0
        h11 += 1.0
        h22 += 1.0
        p[ROW_J + i] = (
            h00 * (h11 * h22 - h12 * h21)
            + h01 * (h12 * h20 - h10 * h22)
            + h02 * (h10 * h21 - h11 * h20)
        )


@numba.njit(**FLAGS)
def _pull_back(p: Any, s: Any, count: int) -> None:
    """Replace Z by S - S_old and S_old `s` (6 rows) by S; J**(-2/3) into `_SHRINK`.

    Points without a positive J keep their old stress: the caller is about to stop.
    """
    wide_vectors()
    for i in range(count):
        j = p[ROW_J + i]
        good = j > 0.0 and j < 1e300
        j = j if good else 1.0
        shrink = 1.0 + exp2m1((-2.0 / 3.0) * LOG2_E * log1p(j - 1.0))
        # S = F^-1 tau F^-T J**(2/3), with the inverse as the cofactors over J.
        scale = 1.0 / (j * j * shrink)
        t00, t11, t22, t01, t02, t12 = load_stress(p, i, scale, 0.0)
        p[_SHRINK + i] = shrink
        f00 = 1.0 + p[ROW_COF + i]
        f01 = p[ROW_COF + R + i]
        f02 = p[ROW_COF + 2 * R + i]
        f10 = p[ROW_COF + 3 * R + i]
        f11 = 1.0 + p[ROW_COF + 4 * R + i]
        f12 = p[ROW_COF + 5 * R + i]
        f20 = p[ROW_COF + 6 * R + i]
        f21 = p[ROW_COF + 7 * R + i]
        f22 = 1.0 + p[ROW_COF + 8 * R + i]
        c00, c01, c02, c10, c11, c12, c20, c21, c22 = cofactors(
            f00, f01, f02, f10, f11, f12, f20, f21, f22
        )
        # tau cof, then cof^T of it.
        m00 = t00 * c00 + t01 * c10 + t02 * c20
        m01 = t00 * c01 + t01 * c11 + t02 * c21
        m02 = t00 * c02 + t01 * c12 + t02 * c22
        m10 = t01 * c00 + t11 * c10 + t12 * c20
        m11 = t01 * c01 + t11 * c11 + t12 * c21
        m12 = t01 * c02 + t11 * c12 + t12 * c22
        m20 = t02 * c00 + t12 * c10 + t22 * c20
        m21 = t02 * c01 + t12 * c11 + t22 * c21
        m22 = t02 * c02 + t12 * c12 + t22 * c22
        s00 = c00 * m00 + c10 * m10 + c20 * m20
        s11 = c01 * m01 + c11 * m11 + c21 * m21
        s22 = c02 * m02 + c12 * m12 + c22 * m22
        s01 = c00 * m01 + c10 * m11 + c20 * m21
        s02 = c00 * m02 + c10 * m12 + c20 * m22
        s12 = c01 * m02 + c11 * m12 + c21 * m22
        old = s[i]
        s00 = s00 if good else old
        p[ROW_Z + i] = s00 - old
        s[i] = s00
        old = s[R + i]
        s11 = s11 if good else old
        p[ROW_Z + R + i] = s11 - old
        s[R + i] = s11
        old = s[2 * R + i]
        s22 = s22 if good else old
        p[ROW_Z + 2 * R + i] = s22 - old
        s[2 * R + i] = s22
        old = s[3 * R + i]
        s01 = s01 if good else old
        p[ROW_Z + 3 * R + i] = s01 - old
        s[3 * R + i] = s01
        old = s[4 * R + i]
        s02 = s02 if good else old
        p[ROW_Z + 4 * R + i] = s02 - old
        s[4 * R + i] = s02
        old = s[5 * R + i]
        s12 = s12 if good else old
        p[ROW_Z + 5 * R + i] = s12 - old
        s[5 * R + i] = s12


@numba.njit(**FLAGS)
def _relax(q: Any, change: Any, decay: Any, gain: Any, total: Any, count: int) -> None:
    """Advance one branch, component by component, and add it to the sum."""
    wide_vectors()
    for k in range(6):
        for i in range(count):
            now = decay[i] * q[k * R + i] + gain[i] * change[k * R + i]
            q[k * R + i] = now
            total[k * R + i] += now


@numba.njit(**FLAGS)
def _push_forward(p: Any, weights: Any, count: int) -> None:
    """Replace du/dX by the weight times the overstress P; zero where J is not positive."""
    wide_vectors()
    for i in range(count):
        f00 = 1.0 + p[ROW_COF + i]
        f01 = p[ROW_COF + R + i]
        f02 = p[ROW_COF + 2 * R + i]
        f10 = p[ROW_COF + 3 * R + i]
        f11 = 1.0 + p[ROW_COF + 4 * R + i]
        f12 = p[ROW_COF + 5 * R + i]
        f20 = p[ROW_COF + 6 * R + i]
        f21 = p[ROW_COF + 7 * R + i]
        f22 = 1.0 + p[ROW_COF + 8 * R + i]
        j = p[ROW_J + i]
        good = j > 0.0 and j < 1e300
        shrink = weights[i] * p[_SHRINK + i]
        q00 = shrink * p[_SUM + i]
        q11 = shrink * p[_SUM + R + i]
        q22 = shrink * p[_SUM + 2 * R + i]
        q01 = shrink * p[_SUM + 3 * R + i]
        q02 = shrink * p[_SUM + 4 * R + i]
        q12 = shrink * p[_SUM + 5 * R + i]
        # F Q, whose product with F^T has the trace to take off.
        t00 = f00 * q00 + f01 * q01 + f02 * q02
        t01 = f00 * q01 + f01 * q11 + f02 * q12
        t02 = f00 * q02 + f01 * q12 + f02 * q22
        t10 = f10 * q00 + f11 * q01 + f12 * q02
        t11 = f10 * q01 + f11 * q11 + f12 * q12
        t12 = f10 * q02 + f11 * q12 + f12 * q22
        t20 = f20 * q00 + f21 * q01 + f22 * q02
        t21 = f20 * q01 + f21 * q11 + f22 * q12
        t22 = f20 * q02 + f21 * q12 + f22 * q22
        trace = (
            (t00 * f00 + t01 * f01 + t02 * f02)
            + (t10 * f10 + t11 * f11 + t12 * f12)
            + (t20 * f20 + t21 * f21 + t22 * f22)
        )
        # F^-T is the cofactor over J.
        r = trace / (3.0 * j)
        c00, c01, c02, c10, c11, c12, c20, c21, c22 = cofactors(
            f00, f01, f02, f10, f11, f12, f20, f21, f22
        )
        t00 -= r * c00
        t01 -= r * c01
        t02 -= r * c02
        t10 -= r * c10
        t11 -= r * c11
        t12 -= r * c12
        t20 -= r * c20
        t21 -= r * c21
        t22 -= r * c22
        p[ROW_COF + i] = t00 if good else 0.0
        p[ROW_COF + R + i] = t01 if good else 0.0
        p[ROW_COF + 2 * R + i] = t02 if good else 0.0
        p[ROW_COF + 3 * R + i] = t10 if good else 0.0
        p[ROW_COF + 4 * R + i] = t11 if good else 0.0
        p[ROW_COF + 5 * R + i] = t12 if good else 0.0
        p[ROW_COF + 6 * R + i] = t20 if good else 0.0
        p[ROW_COF + 7 * R + i] = t21 if good else 0.0
        p[ROW_COF + 8 * R + i] = t22 if good else 0.0


@numba.njit(**FLAGS)
def _corner_forces(g: Any, p: Any, v: Any, lanes: int) -> None:
    """Corner forces P dN_a summed over the points into `v` (24 rows)."""
    wide_vectors()
    for k in range(24):
        for i in range(lanes):
            v[k * L + i] = 0.0
    for q in range(8):
        t = p[ROW_COF + q * L :]
        for a in range(8):
            f = v[3 * a * L :]
            d = g[(24 * q + 3 * a) * L :]
            for i in range(lanes):
                g0 = d[i]
                g1 = d[L + i]
                g2 = d[2 * L + i]
                f[i] += t[i] * g0 + t[R + i] * g1 + t[2 * R + i] * g2
                f[L + i] += t[3 * R + i] * g0 + t[4 * R + i] * g1 + t[5 * R + i] * g2
                f[2 * L + i] += t[6 * R + i] * g0 + t[7 * R + i] * g1 + t[8 * R + i] * g2


@numba.njit(**FLAGS)
def _batch(
    first: int,
    last: int,
    lanes: int,
    u: Any,
    cells: Any,
    laws: Any,
    plan: Any,
    factors: Any,
    gradients: Any,
    weights: Any,
    history: Any,
    scratch: Any,
    forces: Any,
) -> None:
    """Elements `first` to `first + LANES - 1`; lanes beyond `last` repeat it and are dropped.

    `lanes` is LANES, passed where LLVM cannot see it; see `fem.residual_kernels`.
    """
    wide_vectors()
    s = scratch[8 : 8 + ELEMENT_SIZE]
    p = scratch[8 + ELEMENT_SIZE : 8 + ELEMENT_SIZE + POINT_SIZE]
    coefficient = scratch[8 + ELEMENT_SIZE + POINT_SIZE :]
    branches = coefficient[ROW_OGDEN + 3 * laws.mu.shape[1] * R :]
    count = 8 * lanes
    if plan[0] < 0 or scratch[0] != plan[0]:
        load_material(first, last, laws, s, coefficient)
        _load_branches(first, last, laws.material, factors, branches)
        scratch[0] = plan[0]
    v = s[AT_CORNERS:]
    load_corners(first, last, u, cells, v)
    _displacement_gradients(gradients, v, p, lanes)
    _strain(p, count)
    evaluate_law(p, coefficient, plan, count)
    _pull_back(p, history, count)
    for k in range(6):
        for i in range(count):
            p[_SUM + k * R + i] = 0.0
    for k in range(factors.shape[1]):
        _relax(
            history[6 * (k + 1) * R :],
            p[ROW_Z:],
            branches[2 * k * R :],
            branches[(2 * k + 1) * R :],
            p[_SUM:],
            count,
        )
    _push_forward(p, weights, count)
    _corner_forces(gradients, p, v, lanes)
    for i in range(min(L, last + 1 - first)):
        for a in range(24):
            forces[first + i, a] = v[a * L + i]


@numba.njit(parallel=True, **FLAGS)
def viscous_forces(
    lanes: int,
    u: Any,
    cells: Any,
    laws: Any,
    factors: Any,
    gradients: Any,
    weights: Any,
    history: Any,
    scratch: Any,
    forces: Any,
) -> None:
    """Advance `history` and fill `forces` (cell_count, 24) with internal forces [N].

    Parameters
    ----------
    lanes
        LANES.
    u
        Displacements [m], flat.
    laws
        Without bulk moduli: the volume has no part in this.
    factors
        See `branch_factors`.
    gradients
        Reference gradients [1/m], shape (batch_count, 8 * 24 LANES): point, corner, direction,
        lane.
    weights
        [m3], shape (batch_count, 8 LANES): point, lane.
    history
        S [Pa] and Q_i [Pa], shape (batch_count, 6 (branch_count + 1) R).
    scratch
        Shape (thread_count, scratch_size).
    """
    last = cells.shape[0] - 1
    plan = laws.plan
    for k in range(scratch.shape[0]):
        scratch[k, 0] = -1.0
    for b in numba.prange((last + L) // L):
        _batch(
            b * L,
            last,
            lanes,
            u,
            cells,
            laws,
            plan[b],
            factors,
            gradients[b],
            weights[b],
            history[b],
            scratch[numba.get_thread_id()],
            forces,
        )
