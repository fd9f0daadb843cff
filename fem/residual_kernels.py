"""Internal force of total-Lagrangian hexahedra, written for the vector units of the processor.

The element is that of `fem.kernels`: eight-node hexahedra with mean dilatation (Q1/P0; Simo,
Taylor & Pister 1985, doi:10.1016/0045-7825(85)90033-7), 2x2x2 Gauss points, the laws of
`materials.kernels`, and the energy

    sum_q w_q (W(F_q) + U(J_q; kappa_point)) + V U(Jbar; kappa)

 Only the way of computing differs, because an explicit run spends nearly
all its time here:

- `LANES` elements go through every step together, one entry of a row each, so that LLVM turns
  each line into vector instructions. Rows live in a scratch of a few tens of kilobytes per
  thread, which stays in the first-level cache. Nothing is allocated.
- Shape-function gradients are not stored: a trilinear field has seven modes with a gradient
  (xi, eta, zeta, eta zeta, xi zeta, xi eta, xi eta zeta), from which the Jacobian of any point
  takes nine sums. The 2x2x2 rule integrates the volume exactly, so the mean dilatation is a
  closed form in the modes.
- No eigenvectors. With ``Z = dev(b)/q``, ``q = tr(b)/3``, the deviatoric Kirchhoff stress of an
  isotropic law is ``tau = a1 Z + a2 (Z**2 - tr(Z**2)/3 I)``; a1 and a2 follow from Newton's
  interpolation of the law through the eigenvalues (N. J. Higham, Functions of Matrices, 2008,
  section 1.2.3). The first node is the eigenvalue farthest from the other two and the nodes are
  held a relative 1e-8 apart. The interpolation error is the product of the three node errors,
  so coinciding eigenvalues, which a closed form gives to half the digits only, still give the
  stress to round-off.
- exp and log are polynomials here (two ulp), since calls into a library would not vectorise.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from flexapod.core import jit
from flexapod.core.errors import InputError

assert jit.numba is numba  # importing it sets the folder of numba's on-disk cache

LANES = 8
L = LANES

# No "reassoc": the range reductions below round by adding and subtracting a large number.
_FLAGS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "arcp"},
}


@intrinsic
def _wide_vectors(typingctx: Any) -> Any:
    """Let LLVM use 512-bit registers in the calling function (it prefers 256 on many CPUs)."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        attributes = builder.function.attributes
        attributes.alignstack = 64  # else spilled registers lie across cache lines
        # llvmlite knows no such attribute by name, but writes what its set holds. Without it
        # everything works as well, with 256-bit vectors.
        if isinstance(attributes, set):
            set.add(attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.none(), codegen


@intrinsic
def _bits(typingctx: Any, x: Any) -> Any:
    """The 64 bits of a float as an integer."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


@intrinsic
def _from_bits(typingctx: Any, x: Any) -> Any:
    """The float whose 64 bits are given."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), codegen


@numba.njit(forceinline=True, **_FLAGS)
def _exp2m1(x: float) -> float:
    """2**x - 1 for x in +-1000, to full relative precision also for small x."""
    # Adding 1.5 * 2**52 + 1023 rounds x and leaves its exponent, biased, in the last bits.
    t = x + 6755399441056767.0
    r = x - (t - 6755399441056767.0)
    scale = _from_bits(_bits(t) << 52)
    r2 = r * r
    r4 = r2 * r2
    a = 0.6931471805599453 + r * 0.24022650695910097
    b = 0.05550410866482158 + r * 0.009618129107606805
    c = 0.0013333558146418 + r * 0.00015403530441834214
    d = 1.525273383033331e-05 + r * 1.3215442540091196e-06
    e = 1.0178061714650642e-07 + r * 7.07259414670344e-09 + r2 * 4.455135250612908e-10
    p = r * ((a + r2 * b) + r4 * ((c + r2 * d) + r4 * e))
    return scale * p + (scale - 1.0)


@numba.njit(forceinline=True, **_FLAGS)
def _reduce(z: float) -> tuple[float, float]:
    """k and f with 1 + z = 2**k (1 + f) and 1 + f between sqrt(1/2) and sqrt(2).

    1 + z is held to 1e-10 or more, a ratio of stretches of 1e5; below, it is all rounding.
    """
    y = 1.0 + z
    y = y if y > 1e-10 else 1e-10
    biased = (_bits(y) - 0x3FE6A09E667F3BCD + 0x3FF0000000000000) >> 52
    # The exponent as a float by adding it to the last bits of 1.5 * 2**52.
    k = _from_bits(biased + 0x4338000000000000) - 6755399441056767.0
    f = _from_bits(_bits(y) - ((biased - 1023) << 52)) - 1.0
    return k, z if k == 0.0 else f


@numba.njit(forceinline=True, **_FLAGS)
def _log_series(k: float, f: float, s: float) -> float:
    """k ln 2 + ln(1 + f) with s = f/(2 + f)."""
    w = s * s
    w2 = w * w
    p = (0.3333333333333335 + w * 0.19999999999949383) + w2 * (
        (0.1428571431315191 + w * 0.1111110554111818)
        + w2 * (0.09091446445810918 + w * 0.07665799060529291 + w2 * 0.0730897923780877)
    )
    # f - s f = 2 s, written so that the leading term is exact.
    return k * 0.6931471803691238 + ((f - s * (f - 2.0 * (w * p))) + k * 1.9082149292705877e-10)


@numba.njit(forceinline=True, **_FLAGS)
def _log1p(z: float) -> float:
    """log(1 + z) for z > -1, to full precision also for small z."""
    k, f = _reduce(z)
    return _log_series(k, f, f / (2.0 + f))


@numba.njit(forceinline=True, **_FLAGS)
def _log1p_three(z1: float, z2: float, z3: float) -> tuple[float, float, float]:
    """Three logarithms for one division, the slowest of the arithmetic."""
    k1, f1 = _reduce(z1)
    k2, f2 = _reduce(z2)
    k3, f3 = _reduce(z3)
    d1 = 2.0 + f1
    d2 = 2.0 + f2
    d3 = 2.0 + f3
    d12 = d1 * d2
    inverse = 1.0 / (d12 * d3)
    rest = d3 * inverse
    return (
        _log_series(k1, f1, f1 * (d2 * rest)),
        _log_series(k2, f2, f2 * (d1 * rest)),
        _log_series(k3, f3, f3 * (d12 * inverse)),
    )


@numba.njit(forceinline=True, **_FLAGS)
def _reciprocal_root(x: float) -> float:
    """1/sqrt(x) from a guess by shifted bits (4 %) and two cubic and one quadratic iteration.

    Some ten times the throughput of the processor's square root and division.
    """
    y = _from_bits(0x5FE6EB50C7B537A9 - (_bits(x) >> 1))
    e = 1.0 - (x * y) * y
    y += (y * e) * (0.5 + 0.375 * e)
    e = 1.0 - (x * y) * y
    y += (y * e) * (0.5 + 0.375 * e)
    e = 1.0 - (x * y) * y
    return y + (0.5 * y) * e


@numba.njit(forceinline=True, **_FLAGS)
def _cos_third(r: float) -> float:
    """cos(arccos(r)/3) for r in [0, 1] (Chebyshev polynomial, error 1e-16)."""
    r2 = r * r
    r4 = r2 * r2
    r8 = r4 * r4
    a = 0.8660254037844387 + r * 0.16666666666661312
    b = -0.04811252242664837 + r * 0.024691357772685486
    c = -0.015592015372275897 + r * 0.010973855524127276
    d = -0.008257232682290092 + r * 0.006498014771316544
    e = -0.005267735419403359 + r * 0.004325430220073676
    f = -0.003501488604116945 + r * 0.0026793552101196383
    g = -0.0018348029887091696 + r * 0.0010570876246826326
    h = -0.0004788272310381419 + r * 0.00015691424656931
    i = -3.268556126082937e-05 + r * 3.2244651164445613e-06
    low = (a + r2 * b) + r4 * (c + r2 * d)
    high = (e + r2 * f) + r4 * (g + r2 * h)
    return low + r8 * (high + r8 * i)


# The scratch of a thread: element rows of LANES numbers ...
_U = 0  # 21: modes of the displacement, (mode, component)
_PRESSURE = 21 * L  # U'(Jbar)
_ENERGY = 22 * L
_LEAST = 23 * L
_KAPPA = 24 * L
_V = 25 * L  # 24: corner values on the way in and out
_ELEMENT_SIZE = 49 * L

# ... and point rows of 8 LANES numbers, point-major. The stride keeps rows from meeting in the
# low bits of the address, which would stall loads behind stores.
R = 8 * L + 8
_Z = 0 * R  # 6: dev(b)/q as 00, 11, 22, 01, 02, 12
_COF = 6 * R  # 9: cofactor of the current Jacobian dx/dxi, then stress times it
_J = 15 * R
_RJ = 16 * R  # 1/J
_DET0 = 17 * R  # weight of the point
_P = 18 * R  # tr(Z**2)/6, then eigenvalues of Z: 2 P, -P - Q, -P + Q
_Q = 19 * R  # det Z first
_LM = 20 * R  # mean of ln(1 + z_i), then the point's own U'(J)
_L1 = 21 * R  # ln(1 + z_i) less the mean
_L2 = 22 * R
_L3 = 23 * R
_F1 = 24 * R  # the law at the three nodes, then a1 and a2
_F2 = 25 * R
_F3 = 26 * R
_W = 27 * R  # energy density
_T2 = 28 * R  # tr(Z**2)/3
_POINT_SIZE = 29 * R
# Material rows: 3 of Yeoh, kappa_point, then mu, alpha/2 log2(e), mu/alpha of each Ogden term.
_OGDEN = 4 * R
_LOG2_E = 1.4426950408889634
_ROOT3 = 1.7320508075688772
_G = 0.5773502691896258


def scratch_size(term_count: int) -> int:
    """Doubles one thread needs: a flag, element, point and material rows."""
    return 8 + _ELEMENT_SIZE + _POINT_SIZE + _OGDEN + 3 * max(1, term_count) * R


@numba.njit(forceinline=True, **_FLAGS)
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


@numba.njit(forceinline=True, **_FLAGS)
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


@numba.njit(forceinline=True, **_FLAGS)
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


@numba.njit(**_FLAGS)
def _dilatation(s: Any, x: Any, lanes: int) -> None:
    """Pressure U'(Jbar) and the volumetric energy of each lane's element."""
    _wide_vectors()
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
        x0 += s[_U + i]
        y0 += s[_U + L + i]
        z0 += s[_U + 2 * L + i]
        x1 += s[_U + 3 * L + i]
        y1 += s[_U + 4 * L + i]
        z1 += s[_U + 5 * L + i]
        x2 += s[_U + 6 * L + i]
        y2 += s[_U + 7 * L + i]
        z2 += s[_U + 8 * L + i]
        x3 += s[_U + 9 * L + i]
        y3 += s[_U + 10 * L + i]
        z3 += s[_U + 11 * L + i]
        x4 += s[_U + 12 * L + i]
        y4 += s[_U + 13 * L + i]
        z4 += s[_U + 14 * L + i]
        x5 += s[_U + 15 * L + i]
        y5 += s[_U + 16 * L + i]
        z5 += s[_U + 17 * L + i]
        current = _volume(x0, y0, z0, x1, y1, z1, x2, y2, z2, x3, y3, z3, x4, y4, z4, x5, y5, z5)
        d = current / reference - 1.0
        kappa = s[_KAPPA + i]
        square = d * (d + 2.0)
        s[_PRESSURE + i] = 0.5 * kappa * square / (1.0 + d)
        s[_ENERGY + i] = reference * (0.25 * kappa) * (square - 2.0 * _log1p(d))


@numba.njit(**_FLAGS)
def _strain(s: Any, x: Any, points: Any, lanes: int) -> None:
    """Kinematics at the eight Gauss points from the modes `x` and `s[_U:]`."""
    _wide_vectors()
    for q in range(8):
        p = points[q * L :]
        sx = 1.0 if q & 1 else -1.0
        sy = 1.0 if q & 2 else -1.0
        sz = 1.0 if q & 4 else -1.0
        sxy = sx * sy
        sxz = sx * sz
        syz = sy * sz
        for i in range(lanes):
            # Reference Jacobian j = dX/dxi, and displacement gradient h = du/dxi.
            m3 = x[9 * L + i]
            m4 = x[12 * L + i]
            m5 = x[15 * L + i]
            m6 = x[18 * L + i]
            j00 = x[i] + sy * m5 + sz * m4 + syz * m6
            j01 = x[3 * L + i] + sx * m5 + sz * m3 + sxz * m6
            j02 = x[6 * L + i] + sx * m4 + sy * m3 + sxy * m6
            m3 = x[10 * L + i]
            m4 = x[13 * L + i]
            m5 = x[16 * L + i]
            m6 = x[19 * L + i]
            j10 = x[L + i] + sy * m5 + sz * m4 + syz * m6
            j11 = x[4 * L + i] + sx * m5 + sz * m3 + sxz * m6
            j12 = x[7 * L + i] + sx * m4 + sy * m3 + sxy * m6
            m3 = x[11 * L + i]
            m4 = x[14 * L + i]
            m5 = x[17 * L + i]
            m6 = x[20 * L + i]
            j20 = x[2 * L + i] + sy * m5 + sz * m4 + syz * m6
            j21 = x[5 * L + i] + sx * m5 + sz * m3 + sxz * m6
            j22 = x[8 * L + i] + sx * m4 + sy * m3 + sxy * m6
            m3 = s[_U + 9 * L + i]
            m4 = s[_U + 12 * L + i]
            m5 = s[_U + 15 * L + i]
            m6 = s[_U + 18 * L + i]
            h00 = s[_U + i] + sy * m5 + sz * m4 + syz * m6
            h01 = s[_U + 3 * L + i] + sx * m5 + sz * m3 + sxz * m6
            h02 = s[_U + 6 * L + i] + sx * m4 + sy * m3 + sxy * m6
            m3 = s[_U + 10 * L + i]
            m4 = s[_U + 13 * L + i]
            m5 = s[_U + 16 * L + i]
            m6 = s[_U + 19 * L + i]
            h10 = s[_U + L + i] + sy * m5 + sz * m4 + syz * m6
            h11 = s[_U + 4 * L + i] + sx * m5 + sz * m3 + sxz * m6
            h12 = s[_U + 7 * L + i] + sx * m4 + sy * m3 + sxy * m6
            m3 = s[_U + 11 * L + i]
            m4 = s[_U + 14 * L + i]
            m5 = s[_U + 17 * L + i]
            m6 = s[_U + 20 * L + i]
            h20 = s[_U + 2 * L + i] + sy * m5 + sz * m4 + syz * m6
            h21 = s[_U + 5 * L + i] + sx * m5 + sz * m3 + sxz * m6
            h22 = s[_U + 8 * L + i] + sx * m4 + sy * m3 + sxy * m6
            c00 = j11 * j22 - j12 * j21
            c01 = j12 * j20 - j10 * j22
            c02 = j10 * j21 - j11 * j20
            c10 = j02 * j21 - j01 * j22
            c11 = j00 * j22 - j02 * j20
            c12 = j01 * j20 - j00 * j21
            c20 = j01 * j12 - j02 * j11
            c21 = j02 * j10 - j00 * j12
            c22 = j00 * j11 - j01 * j10
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
            third = (b00 + b11 + b22) * (1.0 / 3.0)
            iq = 1.0 / (det0 * det0 + third)
            b00 = (b00 - third) * iq
            b11 = (b11 - third) * iq
            b22 = (b22 - third) * iq
            b01 *= iq
            b02 *= iq
            b12 *= iq
            p[_Z + i] = b00
            p[_Z + R + i] = b11
            p[_Z + 2 * R + i] = b22
            p[_Z + 3 * R + i] = b01
            p[_Z + 4 * R + i] = b02
            p[_Z + 5 * R + i] = b12
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
            c00 = j11 * j22 - j12 * j21
            c01 = j12 * j20 - j10 * j22
            c02 = j10 * j21 - j11 * j20
            p[_COF + i] = c00
            p[_COF + R + i] = c01
            p[_COF + 2 * R + i] = c02
            p[_COF + 3 * R + i] = j02 * j21 - j01 * j22
            p[_COF + 4 * R + i] = j00 * j22 - j02 * j20
            p[_COF + 5 * R + i] = j01 * j20 - j00 * j21
            p[_COF + 6 * R + i] = j01 * j12 - j02 * j11
            p[_COF + 7 * R + i] = j02 * j10 - j00 * j12
            p[_COF + 8 * R + i] = j00 * j11 - j01 * j10
            det = j00 * c00 + j01 * c01 + j02 * c02
            p[_J + i] = det / det0
            p[_RJ + i] = det0 / det
            p[_DET0 + i] = det0
            o01 = b01 * b01
            o02 = b02 * b02
            o12 = b12 * b12
            square = b00 * b00 + b11 * b11 + b22 * b22 + 2.0 * (o01 + o02 + o12)
            p[_T2 + i] = square * (1.0 / 3.0)
            p2 = square * (1.0 / 6.0)
            detz = b00 * (b11 * b22 - o12) + 2.0 * b01 * b02 * b12 - b11 * o02 - b22 * o01
            p[_LM + i] = detz - 3.0 * p2
            p[_P + i] = p2
            p[_Q + i] = detz


@numba.njit(**_FLAGS)
def _logarithms(p: Any, count: int) -> None:
    """Eigenvalues z_i of Z by the trigonometric formula and ln(1 + z_i) less their mean."""
    _wide_vectors()
    for i in range(count):
        p2 = p[_P + i]
        detz = p[_Q + i]
        p2 = p2 if p2 > 1e-60 else 1e-60
        y = _reciprocal_root(p2)
        r = abs(detz) * (0.5 * y * y * y)
        r = r if r < 1.0 else 1.0
        c = _cos_third(r)
        root = math.copysign(p2 * y, detz)
        p[_P + i] = root * c
        sine2 = 1.0 - c * c
        sine2 = sine2 if sine2 > 1e-16 else 1e-16
        # The one square root of the hardware: it runs beside the products above.
        p[_Q + i] = root * (_ROOT3 * math.sqrt(sine2))
    for i in range(count):
        a = p[_P + i]
        b = p[_Q + i]
        l1, l2, l3 = _log1p_three(2.0 * a, -a - b, b - a)
        mean = (l1 + l2 + l3) * (1.0 / 3.0)
        p[_L1 + i] = l1 - mean
        p[_L2 + i] = l2 - mean
        p[_L3 + i] = l3 - mean
        p[_LM + i] = mean
        p[_F1 + i] = 0.0
        p[_F2 + i] = 0.0
        p[_F3 + i] = 0.0
        p[_W + i] = 0.0


@numba.njit(**_FLAGS)
def _ogden(p: Any, coefficient: Any, count: int) -> None:
    """Add one term of Ogden's sum at the three nodes."""
    _wide_vectors()
    for i in range(count):
        mu = coefficient[i]
        a = coefficient[R + i]
        p1 = _exp2m1(a * p[_L1 + i])
        p2 = _exp2m1(a * p[_L2 + i])
        p3 = _exp2m1(a * p[_L3 + i])
        p[_F1 + i] += mu * p1
        p[_F2 + i] += mu * p2
        p[_F3 + i] += mu * p3
        p[_W + i] += coefficient[2 * R + i] * (p1 + p2 + p3)


@numba.njit(**_FLAGS)
def _interpolate(p: Any, count: int) -> None:
    """a1 and a2 from the law at the nodes by divided differences."""
    _wide_vectors()
    for i in range(count):
        a = p[_P + i]
        b = p[_Q + i]
        g12 = 3.0 * a + b
        g13 = 3.0 * a - b
        g23 = -2.0 * b
        d12 = p[_F1 + i] - p[_F2 + i]
        d13 = p[_F1 + i] - p[_F3 + i]
        inverse = 1.0 / (g12 * g13 * g23)
        a2 = (d12 * g13 - d13 * g12) * inverse
        p[_F1 + i] = d12 * (g13 * g23 * inverse) + a2 * (b - a)
        p[_F2 + i] = a2


@numba.njit(**_FLAGS)
def _first_invariant(p: Any, count: int) -> None:
    """Without Ogden terms: no eigenvalues, only ln det(1 + Z)."""
    _wide_vectors()
    for i in range(count):
        p[_LM + i] = _log1p(p[_LM + i]) * (1.0 / 3.0)
        p[_F1 + i] = 0.0
        p[_F2 + i] = 0.0
        p[_W + i] = 0.0


@numba.njit(**_FLAGS)
def _yeoh(p: Any, c: Any, count: int) -> None:
    """Add energy and a1 of Yeoh's terms, which depend on the first invariant only."""
    _wide_vectors()
    for i in range(count):
        e = _exp2m1(-_LOG2_E * p[_LM + i])
        x = 3.0 * e
        c0 = c[i]
        c1 = c[R + i]
        c2 = c[2 * R + i]
        p[_W + i] += x * (c0 + x * (c1 + x * c2))
        p[_F1 + i] += 2.0 * (c0 + x * (2.0 * c1 + x * (3.0 * c2))) * (1.0 + e)


@numba.njit(**_FLAGS)
def _point_volume(p: Any, kappa: Any, count: int) -> None:
    """Add U(J) of each point and write its slope."""
    _wide_vectors()
    for i in range(count):
        d = p[_J + i] - 1.0
        square = d * (d + 2.0)
        k = kappa[i]
        p[_W + i] += 0.25 * k * (square - 2.0 * _log1p(d))
        p[_LM + i] = 0.5 * k * square * p[_RJ + i]


@numba.njit(**_FLAGS)
def _stress(s: Any, points: Any, lanes: int) -> None:
    """Turn the cofactors into Cauchy stress times cofactor; sum the energy."""
    _wide_vectors()
    for i in range(lanes):
        s[_LEAST + i] = math.inf
    for q in range(8):
        p = points[q * L :]
        for i in range(lanes):
            rj = p[_RJ + i]
            a1 = p[_F1 + i] * rj
            a2 = p[_F2 + i] * rj
            z00 = p[_Z + i]
            z11 = p[_Z + R + i]
            z22 = p[_Z + 2 * R + i]
            z01 = p[_Z + 3 * R + i]
            z02 = p[_Z + 4 * R + i]
            z12 = p[_Z + 5 * R + i]
            base = s[_PRESSURE + i] + p[_LM + i] - a2 * p[_T2 + i]
            o01 = z01 * z01
            o02 = z02 * z02
            o12 = z12 * z12
            t00 = base + a1 * z00 + a2 * (z00 * z00 + o01 + o02)
            t11 = base + a1 * z11 + a2 * (z11 * z11 + o01 + o12)
            t22 = base + a1 * z22 + a2 * (z22 * z22 + o02 + o12)
            t01 = a1 * z01 + a2 * (z01 * (z00 + z11) + z02 * z12)
            t02 = a1 * z02 + a2 * (z02 * (z00 + z22) + z01 * z12)
            t12 = a1 * z12 + a2 * (z12 * (z11 + z22) + z01 * z02)
            c0 = p[_COF + i]
            c1 = p[_COF + 3 * R + i]
            c2 = p[_COF + 6 * R + i]
            p[_COF + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[_COF + 3 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[_COF + 6 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            c0 = p[_COF + R + i]
            c1 = p[_COF + 4 * R + i]
            c2 = p[_COF + 7 * R + i]
            p[_COF + R + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[_COF + 4 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[_COF + 7 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            c0 = p[_COF + 2 * R + i]
            c1 = p[_COF + 5 * R + i]
            c2 = p[_COF + 8 * R + i]
            p[_COF + 2 * R + i] = t00 * c0 + t01 * c1 + t02 * c2
            p[_COF + 5 * R + i] = t01 * c0 + t11 * c1 + t12 * c2
            p[_COF + 8 * R + i] = t02 * c0 + t12 * c1 + t22 * c2
            s[_ENERGY + i] += p[_DET0 + i] * p[_W + i]
            j = p[_J + i]
            least = s[_LEAST + i]
            s[_LEAST + i] = j if j < least else least


@numba.njit(**_FLAGS)
def _corner_forces(s: Any, t: Any, lanes: int) -> None:
    """Sum the points into corner forces, the transpose of `_load_modes`, into rows `_V`."""
    _wide_vectors()
    for c in range(3):
        r = _COF + 3 * c * R
        v = _V + c * L
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


@numba.njit(forceinline=True, **_FLAGS)
def _load_corners(first: int, last: int, values: Any, cells: Any, v: Any) -> None:
    for i in range(L):
        e = np.uint64(min(first + i, last))
        for a in range(8):
            n = np.uint64(3) * np.uint64(cells[e, a])
            v[3 * a * L + i] = values[n]
            v[(3 * a + 1) * L + i] = values[n + np.uint64(1)]
            v[(3 * a + 2) * L + i] = values[n + np.uint64(2)]


@numba.njit(parallel=True, **_FLAGS)
def reference_modes(x: Any, cells: Any, lanes: int, modes: Any) -> None:
    """Fill `modes` (batch_count, 21 LANES) from reference coordinates `x`, flat [m]."""
    last = cells.shape[0] - 1
    for b in numba.prange(modes.shape[0]):
        v = np.empty(24 * L)
        _load_corners(b * L, last, x, cells, v)
        _load_modes(v, lanes, modes[b])


@numba.njit(**_FLAGS)
def _load_material(
    first: int,
    last: int,
    material: Any,
    mu: Any,
    alpha: Any,
    c: Any,
    kappa: Any,
    kappa_point: Any,
    s: Any,
    coefficient: Any,
) -> None:
    for i in range(L):
        m = material[min(first + i, last)]
        s[_KAPPA + i] = kappa[m]
        for q in range(8):
            at = q * L + i
            coefficient[at] = c[m, 0]
            coefficient[R + at] = c[m, 1]
            coefficient[2 * R + at] = c[m, 2]
            coefficient[3 * R + at] = kappa_point[m]
            for k in range(mu.shape[1]):
                coefficient[_OGDEN + 3 * k * R + at] = mu[m, k]
                # The nodes are natural logarithms of squared stretches, the powers base 2.
                coefficient[_OGDEN + (3 * k + 1) * R + at] = (0.5 * _LOG2_E) * alpha[m, k]
                coefficient[_OGDEN + (3 * k + 2) * R + at] = mu[m, k] / alpha[m, k]


@numba.njit(**_FLAGS)
def _store(first: int, last: int, s: Any, forces: Any, energy: Any, least: Any) -> None:
    """Lanes into element arrays; no force and energy inf where J <= 0 or NaN."""
    for i in range(min(L, last + 1 - first)):
        e = np.uint64(first + i)
        j = s[_LEAST + i]
        w = s[_ENERGY + i]
        good = j > 0.0 and w == w
        least[e] = j if good or not j > 0.0 else math.nan
        energy[e] = w if good else math.inf
        if good:
            for a in range(24):
                forces[e, a] = s[_V + a * L + i]
        else:
            for a in range(24):
                forces[e, a] = 0.0


@numba.njit(**_FLAGS)
def _batch(
    first: int,
    last: int,
    lanes: int,
    modes: Any,
    u: Any,
    cells: Any,
    material: Any,
    plan: Any,
    mu: Any,
    alpha: Any,
    c: Any,
    kappa: Any,
    kappa_point: Any,
    scratch: Any,
    forces: Any,
    energy: Any,
    least: Any,
) -> None:
    """Elements `first` to `first + LANES - 1`; lanes beyond `last` repeat it and are dropped.

    `lanes` is LANES, but passed where LLVM cannot see it: it would unroll the loops over lanes
    before it looks for vectors.
    """
    _wide_vectors()
    s = scratch[8 : 8 + _ELEMENT_SIZE]
    p = scratch[8 + _ELEMENT_SIZE : 8 + _ELEMENT_SIZE + _POINT_SIZE]
    coefficient = scratch[8 + _ELEMENT_SIZE + _POINT_SIZE :]
    count = 8 * lanes
    if plan[0] < 0 or scratch[0] != plan[0]:
        _load_material(first, last, material, mu, alpha, c, kappa, kappa_point, s, coefficient)
        scratch[0] = plan[0]
    term_count = plan[1]
    _load_corners(first, last, u, cells, s[_V:])
    _load_modes(s[_V:], lanes, s)
    _dilatation(s, modes, lanes)
    _strain(s, modes, p, lanes)
    if term_count > 0:
        _logarithms(p, count)
        for k in range(term_count):
            _ogden(p, coefficient[_OGDEN + 3 * k * R :], count)
        _interpolate(p, count)
    else:
        _first_invariant(p, count)
    if plan[2]:
        _yeoh(p, coefficient, count)
    if plan[3]:
        _point_volume(p, coefficient[3 * R :], count)
    else:
        for i in range(count):
            p[_LM + i] = 0.0
    _stress(s, p, lanes)
    _corner_forces(s, p, lanes)
    _store(first, last, s, forces, energy, least)


@numba.njit(parallel=True, **_FLAGS)
def _element_forces(
    lanes: int,
    modes: Any,
    u: Any,
    cells: Any,
    material: Any,
    plan: Any,
    mu: Any,
    alpha: Any,
    c: Any,
    kappa: Any,
    kappa_point: Any,
    scratch: Any,
    forces: Any,
    energy: Any,
    least: Any,
) -> None:
    last = cells.shape[0] - 1
    for k in range(scratch.shape[0]):
        scratch[k, 0] = -1.0
    for b in numba.prange((last + L) // L):
        _batch(
            b * L,
            last,
            lanes,
            modes[b],
            u,
            cells,
            material,
            plan[b],
            mu,
            alpha,
            c,
            kappa,
            kappa_point,
            scratch[numba.get_thread_id()],
            forces,
            energy,
            least,
        )


@numba.njit(parallel=True, **_FLAGS)
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


def _aligned(*shape: int) -> np.ndarray:
    """Zeros that start on a cache line."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8)
    skip = (-room.ctypes.data // 8) % 8
    return room[skip : skip + size].reshape(shape)


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
        self._modes = _aligned((cell_count + LANES - 1) // LANES, 21 * LANES)
        x = np.ascontiguousarray(nodes, dtype=float).ravel()
        reference_modes(x, self.cells, LANES, self._modes)
        self._force = _aligned(cell_count, 24)
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
        mu = np.atleast_2d(np.asarray(mu, dtype=float))
        alpha = np.atleast_2d(np.asarray(alpha, dtype=float))
        self._c = np.array(np.atleast_2d(c), dtype=float)
        self._kappa = np.array(np.atleast_1d(kappa), dtype=float)
        self._kappa_point = np.zeros_like(self._kappa)
        if kappa_point is not None:
            self._kappa_point[:] = kappa_point
        count = mu.shape[0]
        if self.material.min() < 0 or self.material.max() >= count:
            raise InputError(f"material rows lie outside 0 to {count - 1}")
        used = mu != 0.0
        # The bound keeps 2**(alpha ln(stretch)) a finite number; see `_reduce`.
        if (used & ~((alpha != 0.0) & (np.abs(alpha) <= 80.0))).any():
            raise InputError("Ogden's alpha must lie within +-80 and differ from 0")
        # alpha = 2 is mu/2 (I1 - 3), which needs no eigenvalues.
        neo_hooke = used & (alpha == 2.0)
        self._c[:, 0] += 0.5 * np.where(neo_hooke, mu, 0.0).sum(axis=1)
        used &= ~neo_hooke
        self._mu = np.zeros((count, max(1, int(used.sum(axis=1).max()))))
        self._alpha = np.ones_like(self._mu)
        for m in range(count):
            k = int(used[m].sum())
            self._mu[m, :k] = mu[m, used[m]]
            self._alpha[m, :k] = alpha[m, used[m]]
        # Per batch: its material or -1 for several, Ogden terms, any Yeoh terms, any kappa_point.
        starts = np.arange(0, self.material.size, LANES)
        least = np.minimum.reduceat(self.material, starts)
        most = np.maximum.reduceat(self.material, starts)
        self._plan = np.empty((starts.size, 4), dtype=np.int32)
        self._plan[:, 0] = np.where(least == most, least, -1)
        terms = used.sum(axis=1)
        self._plan[:, 1] = np.maximum.reduceat(terms[self.material], starts)
        yeoh = np.any(self._c != 0.0, axis=1).astype(np.int32)
        self._plan[:, 2] = np.maximum.reduceat(yeoh[self.material], starts)
        point = (self._kappa_point != 0.0).astype(np.int32)
        self._plan[:, 3] = np.maximum.reduceat(point[self.material], starts)
        threads = int(numba.config.NUMBA_NUM_THREADS)
        self._scratch = _aligned(threads, scratch_size(self._mu.shape[1]))

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
            self.material,
            self._plan,
            self._mu,
            self._alpha,
            self._c,
            self._kappa,
            self._kappa_point,
            self._scratch,
            self._force,
            self.element_energy,
            self.least_j,
        )
        _gather(self._force.reshape(-1), self.node_start, self.node_cell, out)
        return float(self.element_energy.sum())
