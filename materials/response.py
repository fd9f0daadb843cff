"""Energy, stress and tangent of a material for any deformation gradient.

These are drivers of `flexapod.materials.kernels.response_states`: one point or arrays of points,
in the order of scikit-fem, ``(3, 3, ...)`` with the points last. The element kernel of
`flexapod.fem` uses the same leaves.
"""

from __future__ import annotations

import numpy as np

from flexapod.core.errors import InputError
from flexapod.materials.kernels import response_states
from flexapod.materials.law import SolidMaterial


def energy(material: SolidMaterial, gradient: np.ndarray) -> np.ndarray:
    """Strain energy per reference volume [J/m3], shape (...), of F, shape (3, 3, ...)."""
    return _evaluate(material, gradient)[0]


def stress(material: SolidMaterial, gradient: np.ndarray) -> np.ndarray:
    """First Piola-Kirchhoff stress P = dW/dF [Pa], shape (3, 3, ...)."""
    return _evaluate(material, gradient)[1]


def tangent(material: SolidMaterial, gradient: np.ndarray) -> np.ndarray:
    """Consistent tangent dP_iJ/dF_kL [Pa], shape (3, 3, 3, 3, ...).

    Exact at two and three equal stretches: nothing is perturbed.
    """
    return _evaluate(material, gradient)[2]


def cauchy_stress(material: SolidMaterial, gradient: np.ndarray) -> np.ndarray:
    """Cauchy stress P F^T / det F [Pa], shape (3, 3, ...)."""
    f = np.asarray(gradient, dtype=float)
    p = stress(material, f)
    determinant = np.linalg.det(np.moveaxis(f, (0, 1), (-2, -1)))
    result: np.ndarray = np.einsum("iJ...,jJ...->ij...", p, f) / determinant
    return result


def _evaluate(
    material: SolidMaterial, gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    f = np.asarray(gradient, dtype=float)
    if f.shape[:2] != (3, 3):
        raise InputError(f"gradient must have shape (3, 3, ...), got {f.shape}", "response")
    points = f.shape[2:]
    flat = np.ascontiguousarray(np.moveaxis(f.reshape(3, 3, -1), -1, 0))
    w, p, a = response_states(*material.law.parameters(), material.bulk_modulus, flat)
    return (
        w.reshape(points),
        np.moveaxis(p, 0, -1).reshape((3, 3) + points),
        np.moveaxis(a, 0, -1).reshape((3, 3, 3, 3) + points),
    )
