"""Homogeneous incompressible curves of a law: uniaxial, equibiaxial, planar, simple shear.

Principal log stretches of a mode at stretch l (h = ln l), the stress-free direction last:

    uniaxial     ( h, -h/2, -h/2)     one pulled direction
    equibiaxial  ( h,   h,  -2h )     two pulled directions
    planar       ( h,   0,   -h )     pulled, width held ("pure shear")

The traction-free face fixes the hydrostatic pressure, so the true stress of the pulled direction
is ``tau_1 - tau_3`` and the nominal stress is that over l. Simple shear by gamma has principal
stretches l, 1, 1/l with ``l - 1/l = gamma``; its shear stress (true and nominal alike) is
``(tau_1 - tau_3) / (l + 1/l)`` (R. W. Ogden, Non-Linear Elastic Deformations, 1984, section 2.2).
"""

from __future__ import annotations

import numpy as np

from flexapod.core.errors import InputError
from flexapod.materials.kernels import principal_states, principal_stresses
from flexapod.materials.law import HyperelasticLaw

# d ln(l_i) / d ln(l) of each mode.
MODES: dict[str, tuple[float, float, float]] = {
    "uniaxial": (1.0, -0.5, -0.5),
    "equibiaxial": (1.0, 1.0, -2.0),
    "planar": (1.0, 0.0, -1.0),
}


def direction(mode: str) -> np.ndarray:
    """Return d ln(l_i) / d ln(l) of a mode, shape (3,)."""
    if mode not in MODES:
        raise InputError(f'mode must be one of {", ".join(MODES)}; got "{mode}"', "mode")
    return np.array(MODES[mode])


def log_stretches(mode: str, stretch: np.ndarray) -> np.ndarray:
    """Return principal log stretches, shape (n, 3), of a mode at stretches > 0, shape (n,)."""
    l = np.atleast_1d(np.asarray(stretch, dtype=float))  # noqa: E741
    if not np.all(np.isfinite(l) & (l > 0.0)):
        raise InputError("stretches must be finite and > 0 (stretch 1 is rest)", mode)
    return np.log(l)[:, None] * direction(mode)[None, :]


def true_stress(law: HyperelasticLaw, mode: str, stretch: np.ndarray) -> np.ndarray:
    """True (Cauchy) stress [Pa] of the pulled direction, shape (n,)."""
    tau = principal_stresses(*law.parameters(), log_stretches(mode, stretch))
    result: np.ndarray = tau[:, 0] - tau[:, 2]
    return result


def nominal_stress(law: HyperelasticLaw, mode: str, stretch: np.ndarray) -> np.ndarray:
    """Nominal (engineering, first Piola-Kirchhoff) stress [Pa], shape (n,)."""
    return true_stress(law, mode, stretch) / np.atleast_1d(np.asarray(stretch, dtype=float))


def true_stress_slope(law: HyperelasticLaw, mode: str, stretch: np.ndarray) -> np.ndarray:
    """d(true stress) / d(stretch) [Pa], shape (n,)."""
    _, _, d = principal_states(*law.parameters(), log_stretches(mode, stretch))
    slope: np.ndarray = (d[:, 0, :] - d[:, 2, :]) @ direction(mode)
    return slope / np.atleast_1d(np.asarray(stretch, dtype=float))


def nominal_stress_slope(law: HyperelasticLaw, mode: str, stretch: np.ndarray) -> np.ndarray:
    """d(nominal stress) / d(stretch) [Pa], shape (n,)."""
    l = np.atleast_1d(np.asarray(stretch, dtype=float))  # noqa: E741
    return (true_stress_slope(law, mode, l) - nominal_stress(law, mode, l)) / l


def energy(law: HyperelasticLaw, mode: str, stretch: np.ndarray) -> np.ndarray:
    """Strain energy per reference volume [J/m3], shape (n,)."""
    w, _, _ = principal_states(*law.parameters(), log_stretches(mode, stretch))
    return np.asarray(w)


def _shear_logs(shear: np.ndarray) -> np.ndarray:
    gamma = np.atleast_1d(np.asarray(shear, dtype=float))
    h = np.arcsinh(0.5 * gamma)
    return np.stack([h, np.zeros_like(h), -h], axis=1)


def shear_stress(law: HyperelasticLaw, shear: np.ndarray) -> np.ndarray:
    """Shear stress [Pa] in simple shear by gamma (true and nominal alike), shape (n,)."""
    e = _shear_logs(shear)
    tau = principal_stresses(*law.parameters(), e)
    result: np.ndarray = (tau[:, 0] - tau[:, 2]) / (2.0 * np.cosh(e[:, 0]))
    return result


def shear_stress_slope(law: HyperelasticLaw, shear: np.ndarray) -> np.ndarray:
    """d(shear stress) / d(gamma) [Pa], shape (n,)."""
    e = _shear_logs(shear)
    _, tau, d = principal_states(*law.parameters(), e)
    h = e[:, 0]
    difference = tau[:, 0] - tau[:, 2]
    slope = (d[:, 0, :] - d[:, 2, :]) @ np.array([1.0, 0.0, -1.0])
    # gamma = 2 sinh h, stress = difference / (2 cosh h).
    result: np.ndarray = (slope - difference * np.tanh(h)) / (2.0 * np.cosh(h)) ** 2
    return result


def equivalent_stretch(mode: str, stretch: float, other: str) -> float:
    """Return the stretch of mode `other` whose first invariant is that of `mode` at `stretch`.

    On the same side of rest. The first invariant ``l1**2 + l2**2 + l3**2`` is a common measure
    of how far a rubber is deformed; it says up to where in another mode a law fitted in one is
    asked for.
    """
    if stretch == 1.0:
        return 1.0
    target = float(np.exp(2.0 * log_stretches(mode, np.array([stretch]))).sum())
    sign = 1.0 if stretch > 1.0 else -1.0
    low, high = 0.0, 50.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        value = float(np.exp(np.minimum(2.0 * sign * middle * direction(other), 600.0)).sum())
        low, high = (middle, high) if value < target else (low, middle)
    return float(np.exp(sign * 0.5 * (low + high)))
