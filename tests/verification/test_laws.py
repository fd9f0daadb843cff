"""Homogeneous deformations of each law against closed forms.

Two routes are checked against the textbook formula of each mode (R. W. Ogden, Non-Linear Elastic
Deformations, 1984, chapter 7; Abaqus Theory Guide, "Hyperelastic material behavior"):

- the incompressible curves of `flexapod.materials.modes`, to round-off (1e-12 of the largest
  stress; the Dragon Skin coefficients cancel to one part in 1e2, which costs two digits);
- the response with a bulk modulus, its free faces in equilibrium, whose error is of the order of
  the change of volume and so falls with 1 - 2 nu.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from flexapod.materials import modes, response
from flexapod.materials.law import HyperelasticLaw, SolidMaterial
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.yeoh import Yeoh

STRETCH = np.array([0.5, 0.8, 1.0, 1.1, 1.7, 3.0, 5.0])
SHEAR = np.array([-1.5, -0.2, 0.0, 0.3, 1.0, 3.0])

MU, ALPHA = (-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285)
G, C10, C01 = 4.0e5, 1.5e5, 0.3e5
YEOH = (1.1e5, 0.2e5, 0.4e3)

LAWS: dict[str, HyperelasticLaw] = {
    "ogden": Ogden(MU, ALPHA),
    "neo-hooke": NeoHooke(G),
    "mooney-rivlin": MooneyRivlin(C10, C01),
    "yeoh": Yeoh(*YEOH),
}


def _ogden(other: float) -> Callable[[np.ndarray], np.ndarray]:
    # P = sum mu (l**(a - 1) - l**(other a - 1)), `other` the free direction's ln over ln(l).
    return lambda s: sum(
        m * (s ** (a - 1.0) - s ** (other * a - 1.0)) for m, a in zip(MU, ALPHA, strict=True)
    )


def _yeoh_slope(i1: np.ndarray) -> np.ndarray:
    x = i1 - 3.0
    return YEOH[0] + 2.0 * YEOH[1] * x + 3.0 * YEOH[2] * x**2


# Nominal stress of each law and mode, written out by hand.
NOMINAL: dict[tuple[str, str], Callable[[np.ndarray], np.ndarray]] = {
    ("ogden", "uniaxial"): _ogden(-0.5),
    ("ogden", "equibiaxial"): _ogden(-2.0),
    ("ogden", "planar"): _ogden(-1.0),
    ("neo-hooke", "uniaxial"): lambda s: G * (s - s**-2),
    ("neo-hooke", "equibiaxial"): lambda s: G * (s - s**-5),
    ("neo-hooke", "planar"): lambda s: G * (s - s**-3),
    ("mooney-rivlin", "uniaxial"): lambda s: 2 * (s - s**-2) * (C10 + C01 / s),
    ("mooney-rivlin", "equibiaxial"): lambda s: 2 * (s - s**-5) * (C10 + C01 * s**2),
    ("mooney-rivlin", "planar"): lambda s: 2 * (s - s**-3) * (C10 + C01),
    ("yeoh", "uniaxial"): lambda s: 2 * (s - s**-2) * _yeoh_slope(s**2 + 2 / s),
    ("yeoh", "equibiaxial"): lambda s: 2 * (s - s**-5) * _yeoh_slope(2 * s**2 + s**-4),
    ("yeoh", "planar"): lambda s: 2 * (s - s**-3) * _yeoh_slope(s**2 + 1 + s**-2),
}

# Shear stress in simple shear: 2 (dW/dI1 + dW/dI2) gamma for laws of the invariants; for Ogden
# sum mu (l**a - l**-a) / (l + 1/l) with l - 1/l = gamma.


def _shear_ogden(gamma: np.ndarray) -> np.ndarray:
    l = 0.5 * gamma + np.sqrt(1.0 + 0.25 * gamma**2)  # noqa: E741
    return sum(m * (l**a - l**-a) for m, a in zip(MU, ALPHA, strict=True)) / (l + 1.0 / l)


SHEAR_STRESS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "ogden": _shear_ogden,
    "neo-hooke": lambda g: G * g,
    "mooney-rivlin": lambda g: 2 * (C10 + C01) * g,
    "yeoh": lambda g: 2 * _yeoh_slope(3.0 + g**2) * g,
}


@pytest.mark.parametrize(("name", "mode"), NOMINAL)
def test_nominal_and_true_stress(name: str, mode: str) -> None:
    expected = NOMINAL[name, mode](STRETCH)
    tolerance = 1e-12 * np.abs(expected).max()
    got = modes.nominal_stress(LAWS[name], mode, STRETCH)
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=tolerance)
    got = modes.true_stress(LAWS[name], mode, STRETCH)
    np.testing.assert_allclose(got, STRETCH * expected, rtol=1e-11, atol=5 * tolerance)


@pytest.mark.parametrize("name", LAWS)
def test_simple_shear(name: str) -> None:
    expected = SHEAR_STRESS[name](SHEAR)
    got = modes.shear_stress(LAWS[name], SHEAR)
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", LAWS)
def test_simple_shear_of_the_three_dimensional_response(name: str) -> None:
    """F = I + gamma e1 e2 keeps the volume: the shear stress is exact for any bulk modulus."""
    material = SolidMaterial(LAWS[name], 1000.0, 0.499)
    f = np.repeat(np.eye(3)[:, :, None], SHEAR.size, axis=2)
    f[0, 1] = SHEAR
    expected = SHEAR_STRESS[name](SHEAR)
    tolerance = 1e-11 * max(np.abs(expected).max(), material.bulk_modulus)
    np.testing.assert_allclose(response.stress(material, f)[0, 1], expected, atol=tolerance)
    sigma = response.cauchy_stress(material, f)
    np.testing.assert_allclose(sigma[0, 1], expected, atol=tolerance)
    # Poynting: sigma_11 - sigma_22 = gamma sigma_12 (universal relation of isotropic solids).
    np.testing.assert_allclose(sigma[0, 0] - sigma[1, 1], SHEAR * expected, atol=20 * tolerance)


@pytest.mark.parametrize(("name", "mode"), NOMINAL)
def test_three_dimensional_response_tends_to_the_incompressible_curve(name: str, mode: str) -> None:
    """Free faces in equilibrium; the error is of the order of the volume change, p / kappa."""
    free = {"uniaxial": (1, 2), "equibiaxial": (2,), "planar": (2,)}[mode]
    held = {"uniaxial": (0,), "equibiaxial": (0, 1), "planar": (0,)}[mode]
    law = LAWS[name]
    for stretch in (0.8, 1.3, 2.0):
        expected = NOMINAL[name, mode](np.array([stretch]))[0]
        errors = []
        for nu in (0.499, 0.4999):
            material = SolidMaterial(law, 1000.0, nu)

            def gradient(lateral: float, stretch: float = stretch) -> np.ndarray:
                f = np.eye(3)
                for i in held:
                    f[i, i] = stretch
                for i in free:
                    f[i, i] = lateral
                return f

            start = stretch ** (-len(held) / len(free))
            lateral = brentq(
                lambda x, m=material, g=gradient: response.stress(m, g(x))[2, 2],
                0.97 * start,
                1.03 * start,
                xtol=1e-15,
            )
            got = response.stress(material, gradient(lateral))[0, 0]
            errors.append(abs(got / expected - 1.0))
            volume = abs(np.linalg.det(gradient(lateral)) - 1.0)
            # A power law of exponent a (here up to 6) turns a change of volume into at most a
            # times that change of stress.
            assert errors[-1] < 6.0 * volume, (stretch, nu, got, expected, "Pa")
        # First order in G/kappa: ten times less at a tenth of 1 - 2 nu.
        assert errors[1] < 0.15 * errors[0] + 1e-9
