"""Isochoric hyperelasticity in principal stretches: the one implementation of every law.

All laws here are functions of the isochoric principal stretches
``lb_i = l_i J**(-1/3)`` and share one form,

    W = sum_k mu_k/alpha_k (lb_1**alpha_k + lb_2**alpha_k + lb_3**alpha_k - 3)
      + sum_m c_m (lb_1**2 + lb_2**2 + lb_3**2 - 3)**m,        m = 1, 2, 3

The first sum is Ogden's law in the ``mu/alpha`` convention (SoSpider paper, equation 1; R. W.
Ogden 1972, doi:10.1098/rspa.1972.0026); neo-Hooke is alpha = 2 and Mooney-Rivlin alpha = 2, -2.
The second sum is Yeoh's law (O. H. Yeoh 1993, doi:10.5254/1.3538343). The volumetric part is

    U(J) = kappa/4 (J**2 - 1 - 2 ln J)

(Simo & Taylor 1982, doi:10.1016/0045-7825(82)90092-4), zero with its slope at J = 1.

Arguments of the leaves: ``mu`` [Pa] and ``alpha`` [-], shape (term_count,); ``c`` [Pa], shape
(3,); logarithms ``e1, e2, e3`` of the total principal stretches. Results are Kirchhoff
stresses [Pa]: ``tau_i = dW/d(ln l_i)``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.jit import inline_kernel, kernel


@inline_kernel
def isochoric_energy(mu: Any, alpha: Any, c: Any, e1: float, e2: float, e3: float) -> float:
    """Isochoric energy per reference volume [J/m3]."""
    m = (e1 + e2 + e3) / 3.0
    w = 0.0
    for k in range(mu.shape[0]):
        a = alpha[k]
        # expm1 keeps the small-strain energy exact where the sum of powers would cancel.
        s = math.expm1(a * (e1 - m)) + math.expm1(a * (e2 - m)) + math.expm1(a * (e3 - m))
        w += mu[k] / a * s
    i1 = math.expm1(2.0 * (e1 - m)) + math.expm1(2.0 * (e2 - m)) + math.expm1(2.0 * (e3 - m))
    w += i1 * (c[0] + i1 * (c[1] + i1 * c[2]))
    return w


@inline_kernel
def isochoric_stress(
    mu: Any, alpha: Any, c: Any, e1: float, e2: float, e3: float
) -> tuple[float, float, float]:
    """Principal Kirchhoff stresses of the isochoric part [Pa]; their sum is zero."""
    m = (e1 + e2 + e3) / 3.0
    t1 = 0.0
    t2 = 0.0
    t3 = 0.0
    for k in range(mu.shape[0]):
        a = alpha[k]
        p1 = mu[k] * math.exp(a * (e1 - m))
        p2 = mu[k] * math.exp(a * (e2 - m))
        p3 = mu[k] * math.exp(a * (e3 - m))
        mean = (p1 + p2 + p3) / 3.0
        t1 += p1 - mean
        t2 += p2 - mean
        t3 += p3 - mean
    if c[0] != 0.0 or c[1] != 0.0 or c[2] != 0.0:
        q1 = math.exp(2.0 * (e1 - m))
        q2 = math.exp(2.0 * (e2 - m))
        q3 = math.exp(2.0 * (e3 - m))
        i1 = q1 + q2 + q3
        x = i1 - 3.0
        w1 = 2.0 * (c[0] + x * (2.0 * c[1] + x * 3.0 * c[2]))
        t1 += w1 * (q1 - i1 / 3.0)
        t2 += w1 * (q2 - i1 / 3.0)
        t3 += w1 * (q3 - i1 / 3.0)
    return t1, t2, t3


@inline_kernel
def _ratio(a: float, x: float, grown: float) -> float:
    """``(exp(a x) - 1)/(exp(2 x) - 1)`` with its denominator `grown`, for every x."""
    return 0.5 * a if abs(x) < 1e-12 else math.expm1(a * x) / grown


@inline_kernel
def isochoric_tangent(
    mu: Any, alpha: Any, c: Any, e1: float, e2: float, e3: float, d: Any, s: Any
) -> None:
    """Fill ``d[i, j] = d tau_i / d ln l_j`` and ``s[i, j]`` [Pa], both shape (3, 3).

    ``s[i, j] = l_j**2 (tau_i - tau_j) / (l_i**2 - l_j**2)`` is the shear quotient of the spatial
    tangent. It is formed from ``expm1`` ratios, so it is exact for equal stretches too: no
    stretch is perturbed.
    """
    m = (e1 + e2 + e3) / 3.0
    for i in range(3):
        for j in range(3):
            d[i, j] = 0.0
            s[i, j] = 0.0
    x01, x02, x12 = e1 - e2, e1 - e3, e2 - e3
    grown01, grown02, grown12 = math.expm1(2.0 * x01), math.expm1(2.0 * x02), math.expm1(2.0 * x12)
    for k in range(mu.shape[0]):
        a = alpha[k]
        p = (
            mu[k] * math.exp(a * (e1 - m)),
            mu[k] * math.exp(a * (e2 - m)),
            mu[k] * math.exp(a * (e3 - m)),
        )
        total = p[0] + p[1] + p[2]
        for i in range(3):
            d[i, i] += a * p[i]
            for j in range(3):
                d[i, j] += a * (total / 9.0 - (p[i] + p[j]) / 3.0)
        s[0, 1] += p[1] * _ratio(a, x01, grown01)
        s[0, 2] += p[2] * _ratio(a, x02, grown02)
        s[1, 2] += p[2] * _ratio(a, x12, grown12)
    # Both quotients of a pair have the same numerator.
    s[1, 0] = s[0, 1] * (1.0 + grown01)
    s[2, 0] = s[0, 2] * (1.0 + grown02)
    s[2, 1] = s[1, 2] * (1.0 + grown12)
    if c[0] != 0.0 or c[1] != 0.0 or c[2] != 0.0:
        q = (math.exp(2.0 * (e1 - m)), math.exp(2.0 * (e2 - m)), math.exp(2.0 * (e3 - m)))
        i1 = q[0] + q[1] + q[2]
        x = i1 - 3.0
        w1 = c[0] + x * (2.0 * c[1] + x * 3.0 * c[2])
        w11 = 2.0 * c[1] + 6.0 * x * c[2]
        for i in range(3):
            d[i, i] += 4.0 * w1 * q[i]
            for j in range(3):
                d[i, j] += 4.0 * w11 * (q[i] - i1 / 3.0) * (q[j] - i1 / 3.0)
                d[i, j] += 4.0 * w1 * (i1 / 9.0 - (q[i] + q[j]) / 3.0)
                if i != j:
                    s[i, j] += 2.0 * w1 * q[j]


@inline_kernel
def volumetric_energy(kappa: float, j: float) -> float:
    """U(J) [J/m3]; infinite for J <= 0, which no continuous deformation reaches."""
    if j <= 0.0:
        return math.inf
    return 0.25 * kappa * (j * j - 1.0 - 2.0 * math.log(j))


@inline_kernel
def volumetric_pressure(kappa: float, j: float) -> float:
    """dU/dJ [Pa], positive in tension."""
    return 0.5 * kappa * (j - 1.0 / j)


@inline_kernel
def volumetric_modulus(kappa: float, j: float) -> float:
    """d2U/dJ2 [Pa]."""
    return 0.5 * kappa * (1.0 + 1.0 / (j * j))


@inline_kernel
def symmetric_eigen(a: Any, values: Any, vectors: Any) -> None:
    """Eigenvalues and orthonormal eigenvectors (columns) of a symmetric (3, 3) array.

    Cyclic Jacobi rotations: slower than a closed form, but accurate to round-off also for
    equal eigenvalues, where closed forms lose half the digits. `a` is destroyed.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        off = a[0, 1] * a[0, 1] + a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2]
        diagonal = a[0, 0] * a[0, 0] + a[1, 1] * a[1, 1] + a[2, 2] * a[2, 2]
        if off <= 1e-34 * diagonal:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                apq = a[p, q]
                if apq == 0.0:
                    continue
                theta = 0.5 * (a[q, q] - a[p, p]) / apq
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                co = 1.0 / math.sqrt(t * t + 1.0)
                si = t * co
                a[p, p] -= t * apq
                a[q, q] += t * apq
                a[p, q] = 0.0
                a[q, p] = 0.0
                r = 3 - p - q
                arp = a[r, p]
                arq = a[r, q]
                a[r, p] = co * arp - si * arq
                a[p, r] = a[r, p]
                a[r, q] = si * arp + co * arq
                a[q, r] = a[r, q]
                for i in range(3):
                    vip = vectors[i, p]
                    viq = vectors[i, q]
                    vectors[i, p] = co * vip - si * viq
                    vectors[i, q] = si * vip + co * viq
    for i in range(3):
        values[i] = a[i, i]


@kernel
def principal_states(mu: Any, alpha: Any, c: Any, log_stretches: Any) -> tuple[Any, Any, Any]:
    """Energy [J/m3], stresses [Pa] and tangents [Pa] for many states.

    `log_stretches` has shape (state_count, 3); results have shapes (state_count,),
    (state_count, 3) and (state_count, 3, 3).
    """
    n = log_stretches.shape[0]
    energy = np.empty(n)
    stress = np.empty((n, 3))
    tangent = np.empty((n, 3, 3))
    quotient = np.empty((3, 3))
    for i in range(n):
        e1, e2, e3 = log_stretches[i, 0], log_stretches[i, 1], log_stretches[i, 2]
        energy[i] = isochoric_energy(mu, alpha, c, e1, e2, e3)
        stress[i, 0], stress[i, 1], stress[i, 2] = isochoric_stress(mu, alpha, c, e1, e2, e3)
        isochoric_tangent(mu, alpha, c, e1, e2, e3, tangent[i], quotient)
    return energy, stress, tangent


@kernel
def response_states(
    mu: Any, alpha: Any, c: Any, kappa: float, gradients: Any
) -> tuple[Any, Any, Any]:
    """Energy, first Piola-Kirchhoff stress and its derivative for many deformation gradients.

    `gradients` has shape (state_count, 3, 3). Results: energy [J/m3], shape (state_count,);
    stress P [Pa], shape (state_count, 3, 3); tangent dP/dF [Pa], shape
    (state_count, 3, 3, 3, 3), all with the volumetric term of bulk modulus `kappa` [Pa].

    With ``b = F F^T = sum l_i**2 n_i n_i``, the Kirchhoff stress is ``sum tau_i n_i n_i`` and
    ``P = tau F^-T``. In the axes n_i its Lie derivative has the moduli
    ``c_iijj = d tau_i / d ln l_j - 2 tau_i delta_ij`` and, for i != j,
    ``c_ijij = (tau_i l_j**2 - tau_j l_i**2) / (l_i**2 - l_j**2) = s_ij - tau_j``
    (R. W. Ogden, Non-Linear Elastic Deformations, 1984, section 6.1.4), from which
    ``dP_iJ/dF_kL = F^-1_Jj F^-1_Ll (c_ijkl + delta_ik tau_jl)``.
    States with det F <= 0 give NaN.
    """
    n = gradients.shape[0]
    energy = np.empty(n)
    stress = np.empty((n, 3, 3))
    tangent = np.empty((n, 3, 3, 3, 3))
    b = np.empty((3, 3))
    values = np.empty(3)
    axes = np.empty((3, 3))
    d = np.empty((3, 3))
    s = np.empty((3, 3))
    tau = np.empty(3)
    kirchhoff = np.empty((3, 3))
    inverse = np.empty((3, 3))
    spatial = np.empty((3, 3, 3, 3))
    half = np.empty((3, 3, 3, 3))
    for state in range(n):
        f = gradients[state]
        for i in range(3):
            i1, i2 = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                j1, j2 = (j + 1) % 3, (j + 2) % 3
                inverse[j, i] = f[i1, j1] * f[i2, j2] - f[i1, j2] * f[i2, j1]
        jac = f[0, 0] * inverse[0, 0] + f[0, 1] * inverse[1, 0] + f[0, 2] * inverse[2, 0]
        if not jac > 0.0:
            energy[state] = math.nan
            stress[state] = math.nan
            tangent[state] = math.nan
            continue
        for i in range(3):
            for j in range(3):
                inverse[i, j] /= jac
                b[i, j] = f[i, 0] * f[j, 0] + f[i, 1] * f[j, 1] + f[i, 2] * f[j, 2]
        symmetric_eigen(b, values, axes)
        e1 = 0.5 * math.log(values[0])
        e2 = 0.5 * math.log(values[1])
        e3 = 0.5 * math.log(values[2])
        energy[state] = isochoric_energy(mu, alpha, c, e1, e2, e3) + volumetric_energy(kappa, jac)
        tau[0], tau[1], tau[2] = isochoric_stress(mu, alpha, c, e1, e2, e3)
        isochoric_tangent(mu, alpha, c, e1, e2, e3, d, s)
        p = jac * volumetric_pressure(kappa, jac)
        dp = p + jac * jac * volumetric_modulus(kappa, jac)
        for i in range(3):
            tau[i] += p
            for j in range(3):
                d[i, j] += dp

        for i in range(3):
            for j in range(3):
                kirchhoff[i, j] = 0.0
                for a in range(3):
                    kirchhoff[i, j] += tau[a] * axes[i, a] * axes[j, a]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += kirchhoff[i, k] * inverse[j, k]
                stress[state, i, j] = total

        spatial[:] = 0.0
        for a in range(3):
            for m in range(3):
                normal = d[a, m]
                if a == m:
                    normal -= 2.0 * tau[a]
                shear = s[a, m] - tau[m]
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            for q in range(3):
                                spatial[i, j, k, q] += (
                                    normal * axes[i, a] * axes[j, a] * axes[k, m] * axes[q, m]
                                )
                                if a != m:
                                    # c_amam and c_amma, so that minor symmetry holds.
                                    spatial[i, j, k, q] += (
                                        shear
                                        * axes[i, a]
                                        * axes[j, m]
                                        * (axes[k, a] * axes[q, m] + axes[k, m] * axes[q, a])
                                    )
        for i in range(3):
            for j in range(3):
                for q in range(3):
                    spatial[i, j, i, q] += kirchhoff[j, q]
        for i in range(3):
            for big in range(3):
                for k in range(3):
                    for q in range(3):
                        total = 0.0
                        for j in range(3):
                            total += inverse[big, j] * spatial[i, j, k, q]
                        half[i, big, k, q] = total
        for i in range(3):
            for big in range(3):
                for k in range(3):
                    for big2 in range(3):
                        total = 0.0
                        for q in range(3):
                            total += inverse[big2, q] * half[i, big, k, q]
                        tangent[state, i, big, k, big2] = total
    return energy, stress, tangent


@inline_kernel
def drucker_margin(
    mu: Any, alpha: Any, c: Any, e1: float, e2: float, e3: float, d: Any, s: Any
) -> float:
    """Least eigenvalue [Pa] of the incompressible tangent at one state; > 0 is stable.

    Drucker's condition ``d tau : d ln(l) > 0`` for every increment that keeps the volume
    (``sum d ln l_i = 0``) is that the (2, 2) restriction of ``d tau_i / d ln l_j`` to an
    orthonormal basis of those increments is positive definite. `d`, `s` are work arrays (3, 3).
    """
    m = (e1 + e2 + e3) / 3.0
    isochoric_tangent(mu, alpha, c, e1 - m, e2 - m, e3 - m, d, s)
    # Basis (1, -1, 0)/sqrt(2) and (1, 1, -2)/sqrt(6).
    a11 = 0.5 * (d[0, 0] - d[0, 1] - d[1, 0] + d[1, 1])
    a12 = (d[0, 0] + d[0, 1] - 2.0 * d[0, 2] - d[1, 0] - d[1, 1] + 2.0 * d[1, 2]) / math.sqrt(12.0)
    a22 = (
        d[0, 0]
        + d[0, 1]
        + d[1, 0]
        + d[1, 1]
        - 2.0 * (d[0, 2] + d[2, 0] + d[1, 2] + d[2, 1])
        + 4.0 * d[2, 2]
    ) / 6.0
    return 0.5 * (a11 + a22) - math.sqrt(0.25 * (a11 - a22) ** 2 + a12 * a12)


@kernel
def drucker_margins(mu: Any, alpha: Any, c: Any, log_stretches: Any) -> Any:
    """`drucker_margin` [Pa] for many states, shape (state_count,), of logs (state_count, 3)."""
    n = log_stretches.shape[0]
    margins = np.empty(n)
    d = np.empty((3, 3))
    s = np.empty((3, 3))
    for i in range(n):
        margins[i] = drucker_margin(
            mu, alpha, c, log_stretches[i, 0], log_stretches[i, 1], log_stretches[i, 2], d, s
        )
    return margins


@kernel
def principal_stresses(mu: Any, alpha: Any, c: Any, log_stretches: Any) -> Any:
    """Stresses of `principal_states` without its tangents [Pa], shape (state_count, 3)."""
    n = log_stretches.shape[0]
    stress = np.empty((n, 3))
    for i in range(n):
        stress[i, 0], stress[i, 1], stress[i, 2] = isochoric_stress(
            mu, alpha, c, log_stretches[i, 0], log_stretches[i, 1], log_stretches[i, 2]
        )
    return stress
