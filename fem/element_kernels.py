"""What the elastic and the viscous force of hexahedra share: scratch rows and the stages of a law.

LANES elements go through every step together (see `fem.lane_kernels`). The laws are those of
`materials.kernels`; a motion spends nearly all its time here, so they are computed without
eigenvectors. With ``Z = dev(b)/q``, ``q = tr(b)/3``, the deviatoric Kirchhoff stress of an
isotropic law is ``tau = a1 Z + a2 (Z**2 - tr(Z**2)/3 I)``; a1 and a2 follow from Newton's
interpolation of the law through the eigenvalues (N. J. Higham, Functions of Matrices, 2008,
section 1.2.3). The first node is the eigenvalue farthest from the other two and the nodes are
held a relative 1e-8 apart. The interpolation error is the product of the three node errors, so
coinciding eigenvalues, which a closed form gives to half the digits only, still give the stress
to round-off.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from flexapod.core.errors import InputError
from flexapod.fem.lane_kernels import (
    FLAGS,
    LANES,
    LOG2_E,
    cos_third,
    exp2m1,
    log1p,
    log1p_three,
    reciprocal_root,
    wide_vectors,
)

L = LANES

# The scratch of a thread: element rows of LANES numbers ...
# First 21: modes of the displacement, (mode, component).
AT_PRESSURE = 21 * L  # U'(Jbar)
AT_ENERGY = 22 * L
AT_LEAST = 23 * L
AT_KAPPA = 24 * L
AT_CORNERS = 25 * L  # 24: corner values on the way in and out
ELEMENT_SIZE = 49 * L

# ... and point rows of 8 LANES numbers, point-major. The stride keeps rows from meeting in the
# low bits of the address, which would stall loads behind stores.
R = 8 * L + 8
ROW_Z = 0 * R  # 6: dev(b)/q as 00, 11, 22, 01, 02, 12
# 9: cofactors of dx/dxi, then stress times them; for the viscous force du/dX, then stress.
ROW_COF = 6 * R
ROW_J = 15 * R
ROW_RJ = 16 * R  # 1/J
ROW_DET0 = 17 * R  # weight of the point
ROW_P = 18 * R  # tr(Z**2)/6, then eigenvalues of Z: 2 P, -P - Q, -P + Q
ROW_Q = 19 * R  # det Z first
ROW_LM = 20 * R  # mean of ln(1 + z_i), then the point's own U'(J)
ROW_L1 = 21 * R  # ln(1 + z_i) less the mean
ROW_L2 = 22 * R
ROW_L3 = 23 * R
ROW_F1 = 24 * R  # the law at the three nodes, then a1 and a2
ROW_F2 = 25 * R
ROW_F3 = 26 * R
ROW_W = 27 * R  # energy density
ROW_T2 = 28 * R  # tr(Z**2)/3
POINT_SIZE = 29 * R
# Material rows: 3 of Yeoh, kappa_point, then mu, alpha/2 log2(e), mu/alpha of each Ogden term.
ROW_OGDEN = 4 * R
_ROOT3 = 1.7320508075688772


def aligned(*shape: int) -> np.ndarray:
    """Zeros that start on a cache line."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8)
    skip = (-room.ctypes.data // 8) % 8
    return room[skip : skip + size].reshape(shape)


def scratch_size(term_count: int, branch_count: int = 0) -> int:
    """Doubles one thread needs: a flag, element, point, material and branch rows."""
    rows = 3 * max(1, term_count) + 2 * branch_count
    return 8 + ELEMENT_SIZE + POINT_SIZE + ROW_OGDEN + rows * R


# --------------------------------------------------------------------------- laws


class Laws(NamedTuple):
    """Coefficients of the materials and what each batch of LANES cells needs of them.

    Attributes
    ----------
    material
        Row of the arrays below per cell, shape (cell_count,).
    plan
        Per batch: its material or -1 for several, Ogden terms, any Yeoh terms, any kappa_point;
        shape (batch_count, 4).
    mu, alpha
        Ogden terms [Pa] and [-] other than alpha = 2, shape (material_count, term_count).
    c
        Yeoh's coefficients [Pa] and the terms with alpha = 2, shape (material_count, 3).
    kappa, kappa_point
        Bulk moduli of the mean dilatation and of the points [Pa], shape (material_count,).
    """

    material: np.ndarray
    plan: np.ndarray
    mu: np.ndarray
    alpha: np.ndarray
    c: np.ndarray
    kappa: np.ndarray
    kappa_point: np.ndarray


def pack_laws(
    material: np.ndarray,
    mu: np.ndarray,
    alpha: np.ndarray,
    c: np.ndarray,
    kappa: np.ndarray | float = 0.0,
    kappa_point: np.ndarray | float = 0.0,
) -> Laws:
    """Sort the coefficients of `fem.residual_kernels.InternalForce` into what the kernels read."""
    mu = np.atleast_2d(np.asarray(mu, dtype=float))
    alpha = np.atleast_2d(np.asarray(alpha, dtype=float))
    c = np.array(np.atleast_2d(c), dtype=float)
    count = mu.shape[0]
    if material.min() < 0 or material.max() >= count:
        raise InputError(f"material rows lie outside 0 to {count - 1}")
    used = mu != 0.0
    # The bound keeps 2**(alpha ln(stretch)) a finite number; see `fem.lane_kernels`.
    if (used & ~((alpha != 0.0) & (np.abs(alpha) <= 80.0))).any():
        raise InputError("Ogden's alpha must lie within +-80 and differ from 0")
    # alpha = 2 is mu/2 (I1 - 3), which needs no eigenvalues.
    neo_hooke = used & (alpha == 2.0)
    c[:, 0] += 0.5 * np.where(neo_hooke, mu, 0.0).sum(axis=1)
    used &= ~neo_hooke
    terms = used.sum(axis=1)
    kept_mu = np.zeros((count, max(1, int(terms.max()))))
    kept_alpha = np.ones_like(kept_mu)
    for m, term_count in enumerate(terms):
        kept_mu[m, :term_count] = mu[m, used[m]]
        kept_alpha[m, :term_count] = alpha[m, used[m]]
    bulk = np.zeros((2, count))
    bulk[0] = kappa
    bulk[1] = kappa_point
    starts = np.arange(0, material.size, LANES)
    least = np.minimum.reduceat(material, starts)
    most = np.maximum.reduceat(material, starts)
    plan = np.empty((starts.size, 4), dtype=np.int32)
    plan[:, 0] = np.where(least == most, least, -1)
    needs = (terms, np.any(c != 0.0, axis=1), bulk[1] != 0.0)
    for column, need in enumerate(needs, start=1):
        plan[:, column] = np.maximum.reduceat(need.astype(np.int32)[material], starts)
    return Laws(material, plan, kept_mu, kept_alpha, c, bulk[0], bulk[1])


@numba.njit(forceinline=True, **FLAGS)
def load_corners(first: int, last: int, values: Any, cells: Any, v: Any) -> None:
    """Nodal `values`, flat, at the lanes' corners into `v` (24 rows)."""
    for i in range(L):
        e = np.uint64(min(first + i, last))
        for a in range(8):
            n = np.uint64(3) * np.uint64(cells[e, a])
            v[3 * a * L + i] = values[n]
            v[(3 * a + 1) * L + i] = values[n + np.uint64(1)]
            v[(3 * a + 2) * L + i] = values[n + np.uint64(2)]


@numba.njit(**FLAGS)
def load_material(first: int, last: int, laws: Any, s: Any, coefficient: Any) -> None:
    """Coefficients of the lanes' materials, the same for the eight points of a lane."""
    mu, alpha, c = laws.mu, laws.alpha, laws.c
    for i in range(L):
        m = laws.material[min(first + i, last)]
        s[AT_KAPPA + i] = laws.kappa[m]
        for q in range(8):
            at = q * L + i
            coefficient[at] = c[m, 0]
            coefficient[R + at] = c[m, 1]
            coefficient[2 * R + at] = c[m, 2]
            coefficient[3 * R + at] = laws.kappa_point[m]
            for k in range(mu.shape[1]):
                coefficient[ROW_OGDEN + 3 * k * R + at] = mu[m, k]
                # The nodes are natural logarithms of squared stretches, the powers base 2.
                coefficient[ROW_OGDEN + (3 * k + 1) * R + at] = (0.5 * LOG2_E) * alpha[m, k]
                coefficient[ROW_OGDEN + (3 * k + 2) * R + at] = mu[m, k] / alpha[m, k]


# --------------------------------------------------------------------------- points


@numba.njit(forceinline=True, **FLAGS)
def cofactors(
    a00: float, a01: float, a02: float,
    a10: float, a11: float, a12: float,
    a20: float, a21: float, a22: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Cofactors of a matrix, row by row."""
    return (
        a11 * a22 - a12 * a21, a12 * a20 - a10 * a22, a10 * a21 - a11 * a20,
        a02 * a21 - a01 * a22, a00 * a22 - a02 * a20, a01 * a20 - a00 * a21,
        a01 * a12 - a02 * a11, a02 * a10 - a00 * a12, a00 * a11 - a01 * a10,
    )  # fmt: skip


@numba.njit(forceinline=True, **FLAGS)
def store_strain(
    p: Any, i: int, scale: float,
    b00: float, b11: float, b22: float, b01: float, b02: float, b12: float,
) -> None:  # fmt: skip
    """Z and its invariants from ``scale (b - I)``, as the stages of the law want them."""
    third = (b00 + b11 + b22) * (1.0 / 3.0)
    iq = 1.0 / (scale + third)
    b00 = (b00 - third) * iq
    b11 = (b11 - third) * iq
    b22 = (b22 - third) * iq
    b01 *= iq
    b02 *= iq
    b12 *= iq
    p[ROW_Z + i] = b00
    p[ROW_Z + R + i] = b11
    p[ROW_Z + 2 * R + i] = b22
    p[ROW_Z + 3 * R + i] = b01
    p[ROW_Z + 4 * R + i] = b02
    p[ROW_Z + 5 * R + i] = b12
    o01 = b01 * b01
    o02 = b02 * b02
    o12 = b12 * b12
    square = b00 * b00 + b11 * b11 + b22 * b22 + 2.0 * (o01 + o02 + o12)
    p[ROW_T2 + i] = square * (1.0 / 3.0)
    p2 = square * (1.0 / 6.0)
    detz = b00 * (b11 * b22 - o12) + 2.0 * b01 * b02 * b12 - b11 * o02 - b22 * o01
    p[ROW_LM + i] = detz - 3.0 * p2
    p[ROW_P + i] = p2
    p[ROW_Q + i] = detz


@numba.njit(forceinline=True, **FLAGS)
def load_stress(
    p: Any, i: int, scale: float, pressure: float
) -> tuple[float, float, float, float, float, float]:
    """``scale tau + pressure I`` as 00, 11, 22, 01, 02, 12, after the stages of the law."""
    a1 = p[ROW_F1 + i] * scale
    a2 = p[ROW_F2 + i] * scale
    z00 = p[ROW_Z + i]
    z11 = p[ROW_Z + R + i]
    z22 = p[ROW_Z + 2 * R + i]
    z01 = p[ROW_Z + 3 * R + i]
    z02 = p[ROW_Z + 4 * R + i]
    z12 = p[ROW_Z + 5 * R + i]
    base = pressure - a2 * p[ROW_T2 + i]
    o01 = z01 * z01
    o02 = z02 * z02
    o12 = z12 * z12
    return (
        base + a1 * z00 + a2 * (z00 * z00 + o01 + o02),
        base + a1 * z11 + a2 * (z11 * z11 + o01 + o12),
        base + a1 * z22 + a2 * (z22 * z22 + o02 + o12),
        a1 * z01 + a2 * (z01 * (z00 + z11) + z02 * z12),
        a1 * z02 + a2 * (z02 * (z00 + z22) + z01 * z12),
        a1 * z12 + a2 * (z12 * (z11 + z22) + z01 * z02),
    )


@numba.njit(**FLAGS)
def _logarithms(p: Any, count: int) -> None:
    """Eigenvalues z_i of Z by the trigonometric formula and ln(1 + z_i) less their mean."""
    wide_vectors()
    for i in range(count):
        p2 = p[ROW_P + i]
        detz = p[ROW_Q + i]
        p2 = p2 if p2 > 1e-60 else 1e-60
        y = reciprocal_root(p2)
        r = abs(detz) * (0.5 * y * y * y)
        r = r if r < 1.0 else 1.0
        c = cos_third(r)
        root = math.copysign(p2 * y, detz)
        p[ROW_P + i] = root * c
        sine2 = 1.0 - c * c
        sine2 = sine2 if sine2 > 1e-16 else 1e-16
        # The one square root of the hardware: it runs beside the products above.
        p[ROW_Q + i] = root * (_ROOT3 * math.sqrt(sine2))
    for i in range(count):
        a = p[ROW_P + i]
        b = p[ROW_Q + i]
        l1, l2, l3 = log1p_three(2.0 * a, -a - b, b - a)
        mean = (l1 + l2 + l3) * (1.0 / 3.0)
        p[ROW_L1 + i] = l1 - mean
        p[ROW_L2 + i] = l2 - mean
        p[ROW_L3 + i] = l3 - mean
        p[ROW_LM + i] = mean
        p[ROW_F1 + i] = 0.0
        p[ROW_F2 + i] = 0.0
        p[ROW_F3 + i] = 0.0
        p[ROW_W + i] = 0.0


@numba.njit(**FLAGS)
def _ogden(p: Any, coefficient: Any, count: int) -> None:
    """Add one term of Ogden's sum at the three nodes."""
    wide_vectors()
    for i in range(count):
        mu = coefficient[i]
        a = coefficient[R + i]
        p1 = exp2m1(a * p[ROW_L1 + i])
        p2 = exp2m1(a * p[ROW_L2 + i])
        p3 = exp2m1(a * p[ROW_L3 + i])
        p[ROW_F1 + i] += mu * p1
        p[ROW_F2 + i] += mu * p2
        p[ROW_F3 + i] += mu * p3
        p[ROW_W + i] += coefficient[2 * R + i] * (p1 + p2 + p3)


@numba.njit(**FLAGS)
def _interpolate(p: Any, count: int) -> None:
    """a1 and a2 from the law at the nodes by divided differences."""
    wide_vectors()
    for i in range(count):
        a = p[ROW_P + i]
        b = p[ROW_Q + i]
        g12 = 3.0 * a + b
        g13 = 3.0 * a - b
        g23 = -2.0 * b
        d12 = p[ROW_F1 + i] - p[ROW_F2 + i]
        d13 = p[ROW_F1 + i] - p[ROW_F3 + i]
        inverse = 1.0 / (g12 * g13 * g23)
        a2 = (d12 * g13 - d13 * g12) * inverse
        p[ROW_F1 + i] = d12 * (g13 * g23 * inverse) + a2 * (b - a)
        p[ROW_F2 + i] = a2


@numba.njit(**FLAGS)
def _first_invariant(p: Any, count: int) -> None:
    """Without Ogden terms: no eigenvalues, only ln det(1 + Z)."""
    wide_vectors()
    for i in range(count):
        p[ROW_LM + i] = log1p(p[ROW_LM + i]) * (1.0 / 3.0)
        p[ROW_F1 + i] = 0.0
        p[ROW_F2 + i] = 0.0
        p[ROW_W + i] = 0.0


@numba.njit(**FLAGS)
def _yeoh(p: Any, c: Any, count: int) -> None:
    """Add energy and a1 of Yeoh's terms, which depend on the first invariant only."""
    wide_vectors()
    for i in range(count):
        e = exp2m1(-LOG2_E * p[ROW_LM + i])
        x = 3.0 * e
        c0 = c[i]
        c1 = c[R + i]
        c2 = c[2 * R + i]
        p[ROW_W + i] += x * (c0 + x * (c1 + x * c2))
        p[ROW_F1 + i] += 2.0 * (c0 + x * (2.0 * c1 + x * (3.0 * c2))) * (1.0 + e)


@numba.njit(forceinline=True, **FLAGS)
def evaluate_law(p: Any, coefficient: Any, plan: Any, count: int) -> None:
    """a1, a2 and the energy density of `count` points from their invariants."""
    term_count = plan[1]
    if term_count > 0:
        _logarithms(p, count)
        for k in range(term_count):
            _ogden(p, coefficient[ROW_OGDEN + 3 * k * R :], count)
        _interpolate(p, count)
    else:
        _first_invariant(p, count)
    if plan[2]:
        _yeoh(p, coefficient, count)
