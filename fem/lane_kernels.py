"""Arithmetic for kernels that take LANES elements at once, an entry of a row each.

LLVM turns each line of such a kernel into vector instructions if nothing in it calls a library:
exp and log are polynomials here (two ulp), and all functions are inlined where they are used.
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from flexapod.core import jit

assert jit.numba is numba  # importing it sets the folder of numba's on-disk cache

LANES = 8
LOG2_E = 1.4426950408889634

# No "reassoc": the range reductions below round by adding and subtracting a large number.
FLAGS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "arcp"},
}


@intrinsic
def wide_vectors(typingctx: Any) -> Any:
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


@numba.njit(forceinline=True, **FLAGS)
def exp2m1(x: float) -> float:
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


@numba.njit(forceinline=True, **FLAGS)
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


@numba.njit(forceinline=True, **FLAGS)
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


@numba.njit(forceinline=True, **FLAGS)
def log1p(z: float) -> float:
    """log(1 + z) for z > -1, to full precision also for small z."""
    k, f = _reduce(z)
    return _log_series(k, f, f / (2.0 + f))


@numba.njit(forceinline=True, **FLAGS)
def log1p_three(z1: float, z2: float, z3: float) -> tuple[float, float, float]:
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


@numba.njit(forceinline=True, **FLAGS)
def reciprocal_root(x: float) -> float:
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


@numba.njit(forceinline=True, **FLAGS)
def cos_third(r: float) -> float:
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
