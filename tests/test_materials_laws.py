"""Laws against a slow NumPy twin, derivatives, invariances and their known moduli."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.materials import modes, response
from flexapod.materials.kernels import principal_states
from flexapod.materials.law import HyperelasticLaw, SolidMaterial
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.registry import LAWS, make_law
from flexapod.materials.yeoh import Yeoh

DRAGON = Ogden((-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285))
ALL: dict[str, HyperelasticLaw] = {
    "ogden-dragon-skin": DRAGON,
    "ogden-mixed-signs": Ogden((-1.0e4, 6.3e5, 1.2e3), (-2.0, 1.3, 5.0)),
    "ogden-one-term": Ogden((3.0e5,), (1.7,)),
    "neo-hooke": NeoHooke(4.0e5),
    "mooney-rivlin": MooneyRivlin(1.5e5, 0.3e5),
    "yeoh": Yeoh(1.1e5, 0.2e5, -0.5e3),
}
every_law = pytest.mark.parametrize("law", ALL.values(), ids=ALL.keys())

EQUAL = {
    "distinct": (1.4, 0.9, 0.7),
    "two equal": (1.3, 1.3, 0.65),
    "nearly equal": (1.3, 1.3 * (1.0 + 1e-9), 0.65),
    "three equal": (1.02, 1.02, 1.02),
    "rest": (1.0, 1.0, 1.0),
}


def twin_energy(law: HyperelasticLaw, l: np.ndarray) -> float:  # noqa: E741
    """Isochoric energy by its textbook formula, in the words of each law."""
    lb = l / np.prod(l) ** (1.0 / 3.0)
    i1, i2 = np.sum(lb**2), np.sum(lb**-2)
    if isinstance(law, Ogden):
        return sum(m / a * (np.sum(lb**a) - 3.0) for m, a in zip(law.mu, law.alpha, strict=True))
    if isinstance(law, NeoHooke):
        return 0.5 * law.shear * (i1 - 3.0)
    if isinstance(law, MooneyRivlin):
        return law.c10 * (i1 - 3.0) + law.c01 * (i2 - 3.0)
    assert isinstance(law, Yeoh)
    return law.c1 * (i1 - 3.0) + law.c2 * (i1 - 3.0) ** 2 + law.c3 * (i1 - 3.0) ** 3


def material(law: HyperelasticLaw) -> SolidMaterial:
    return SolidMaterial(law, 1000.0, 0.49)


def rotations(count: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    out = []
    for _ in range(count):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        out.append(q * np.sign(np.linalg.det(q)))
    return np.stack(out, axis=-1)


def gradients() -> np.ndarray:
    """F with the stretches of EQUAL in skew axes, shape (3, 3, n)."""
    r = rotations(2 * len(EQUAL))
    n = len(EQUAL)
    f = [r[:, :, i] @ np.diag(row) @ r[:, :, i + n].T for i, row in enumerate(EQUAL.values())]
    return np.stack(f, axis=-1)


@every_law
def test_energy_is_the_textbook_formula(law: HyperelasticLaw) -> None:
    rng = np.random.default_rng(1)
    stretches = np.exp(rng.normal(scale=0.4, size=(20, 3)))
    w, _, _ = principal_states(*law.parameters(), np.log(stretches))
    expected = [twin_energy(law, row) for row in stretches]
    # Round-off of the sums of powers, which cancel for the Dragon Skin coefficients.
    np.testing.assert_allclose(w, expected, rtol=1e-9, atol=1e-8 * law.shear_modulus)


@every_law
def test_principal_stress_is_the_derivative_of_the_twin_energy(law: HyperelasticLaw) -> None:
    stretches = np.array([(1.5, 0.8, 0.9), (2.0, 1.1, 0.5), (0.7, 0.7, 1.9)])
    _, tau, tangent = principal_states(*law.parameters(), np.log(stretches))
    h = 1e-5  # central difference: h**2 truncation 1e-10, round-off 1e-16 / 1e-5
    for s, l in enumerate(stretches):  # noqa: E741
        for i in range(3):
            step = np.zeros(3)
            step[i] = h
            up, down = np.exp(np.log(l) + step), np.exp(np.log(l) - step)
            slope = (twin_energy(law, up) - twin_energy(law, down)) / (2.0 * h)
            scale = np.abs(tangent[s]).max()
            assert abs(tau[s, i] - slope) < 1e-7 * scale, (i, tau[s, i], slope, "Pa")


@every_law
def test_stress_and_tangent_are_derivatives_also_at_equal_stretches(law: HyperelasticLaw) -> None:
    m = material(law)
    f = gradients()
    p, a = response.stress(m, f), response.tangent(m, f)
    scale = np.abs(a).max()
    h = 1e-6  # central difference: measured error 1e-9 of the largest modulus
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3, 1))
            step[i, j] = h
            slope = (response.energy(m, f + step) - response.energy(m, f - step)) / (2.0 * h)
            np.testing.assert_allclose(p[i, j], slope, atol=1e-8 * scale, rtol=0)
            slope = (response.stress(m, f + step) - response.stress(m, f - step)) / (2.0 * h)
            np.testing.assert_allclose(a[:, :, i, j], slope, atol=1e-8 * scale, rtol=0)


@every_law
def test_tangent_has_major_symmetry(law: HyperelasticLaw) -> None:
    a = response.tangent(material(law), gradients())
    np.testing.assert_allclose(a, np.moveaxis(a, (0, 1, 2, 3), (2, 3, 0, 1)), rtol=1e-9, atol=1.0)


@every_law
def test_nearly_equal_stretches_are_as_equal_ones(law: HyperelasticLaw) -> None:
    """No jump where a closed form would switch: 1e-9 apart differs by 1e-9, not by more."""
    m = material(law)
    near = np.diag([1.3, 1.3 * (1.0 + 1e-9), 0.65])
    a, b = response.tangent(m, np.diag([1.3, 1.3, 0.65])), response.tangent(m, near)
    assert np.abs(a - b).max() < 1e-7 * np.abs(a).max()


@every_law
def test_rotation_leaves_energy_alone_and_turns_stress(law: HyperelasticLaw) -> None:
    m = material(law)
    f = np.diag([1.4, 0.9, 0.7])[:, :, None] + 0.1 * np.eye(3)[::-1][:, :, None]
    q = rotations(4)
    qf = np.einsum("ijn,jkn->ikn", q, np.repeat(f, 4, axis=2))
    fq = np.einsum("ijn,jkn->ikn", np.repeat(f, 4, axis=2), q)
    w = response.energy(m, f)[0]
    np.testing.assert_allclose(response.energy(m, qf), w, rtol=1e-10)
    np.testing.assert_allclose(response.energy(m, fq), w, rtol=1e-10)
    turned = np.einsum("ijn,jk->ikn", q, response.stress(m, f)[:, :, 0])
    np.testing.assert_allclose(response.stress(m, qf), turned, atol=1e-8 * m.bulk_modulus)


@every_law
def test_no_stress_at_rest_nor_after_a_rotation(law: HyperelasticLaw) -> None:
    m = material(law)
    assert np.abs(response.stress(m, rotations(5))).max() < 1e-12 * m.bulk_modulus
    assert np.abs(response.energy(m, rotations(5))).max() < 1e-12 * m.bulk_modulus


@every_law
def test_small_strain_moduli(law: HyperelasticLaw) -> None:
    m = material(law)
    a = response.tangent(m, np.eye(3))
    g, kappa = law.shear_modulus, m.bulk_modulus
    d = np.eye(3)
    expected = (kappa - 2.0 / 3.0 * g) * np.einsum("ij,kl->ijkl", d, d) + g * (
        np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    )
    np.testing.assert_allclose(a, expected, atol=1e-9 * kappa)
    # Uniaxial slope at rest is E = 3 G of the incompressible law.
    assert modes.nominal_stress_slope(law, "uniaxial", np.array([1.0]))[0] == pytest.approx(3 * g)


@every_law
@pytest.mark.parametrize("mode", modes.MODES)
def test_mode_slopes_and_energy(law: HyperelasticLaw, mode: str) -> None:
    l = np.array([0.6, 0.95, 1.2, 2.5])  # noqa: E741
    h = 1e-6
    scale = np.abs(modes.true_stress_slope(law, mode, l)).max()
    for value, slope in (
        (modes.true_stress, modes.true_stress_slope),
        (modes.nominal_stress, modes.nominal_stress_slope),
    ):
        difference = (value(law, mode, l + h) - value(law, mode, l - h)) / (2 * h)
        np.testing.assert_allclose(slope(law, mode, l), difference, atol=1e-7 * scale)
    # Work of the pulled directions: nominal stress times stretch rate, twice in equibiaxial.
    work = (modes.energy(law, mode, l + h) - modes.energy(law, mode, l - h)) / (2 * h)
    pulled = 2.0 if mode == "equibiaxial" else 1.0
    np.testing.assert_allclose(work, pulled * modes.nominal_stress(law, mode, l), atol=1e-7 * scale)


@every_law
def test_shear_slope(law: HyperelasticLaw) -> None:
    gamma, h = np.array([-0.7, 0.0, 0.3, 2.0]), 1e-6
    difference = (modes.shear_stress(law, gamma + h) - modes.shear_stress(law, gamma - h)) / (2 * h)
    slope = modes.shear_stress_slope(law, gamma)
    np.testing.assert_allclose(slope, difference, atol=1e-7 * np.abs(slope).max())
    assert slope[1] == pytest.approx(law.shear_modulus)


def test_dragon_skin_uniaxial_numbers_of_the_papers_coefficients() -> None:
    """physics.md section 1, nominal stress in kPa; past a stretch of 5 the curve turns over."""
    stretch = np.array([1.1, 1.5, 2.0, 3.0, 5.0])
    got = modes.nominal_stress(DRAGON, "uniaxial", stretch) / 1e3
    # Half a unit of the last digit given there.
    np.testing.assert_allclose(got[:3], [21.82, 138.46, 429.39], atol=0.005)
    np.testing.assert_allclose(got[3], 1725.1, atol=0.05)
    np.testing.assert_allclose(got[4], 4408, atol=0.5)
    assert modes.nominal_stress(DRAGON, "uniaxial", np.array([6.0]))[0] < 0.0
    assert DRAGON.shear_modulus == pytest.approx(72.9e3, abs=50.0)


def test_convention_conversion_there_and_back() -> None:
    mu, alpha = DRAGON.to_two_mu_over_alpha_squared()
    assert sum(mu) == pytest.approx(DRAGON.shear_modulus)
    back = Ogden.from_two_mu_over_alpha_squared(mu, alpha)
    np.testing.assert_allclose(back.mu, DRAGON.mu, rtol=1e-15)
    # The other convention's formula gives the same energy.
    l = np.array([1.3, 0.8, 1.0 / (1.3 * 0.8)])  # noqa: E741
    other = sum(2 * m / a**2 * (np.sum(l**a) - 3) for m, a in zip(mu, alpha, strict=True))
    w, _, _ = principal_states(*DRAGON.parameters(), np.log(l)[None, :])
    assert w[0] == pytest.approx(other, rel=1e-9)


def test_inverted_gradient_gives_nan_not_a_number_that_looks_right() -> None:
    f = np.stack([np.diag([1.0, 1.0, -1.0]), np.eye(3)], axis=-1)
    assert np.isnan(response.energy(material(DRAGON), f)).tolist() == [True, False]


@pytest.mark.parametrize(
    ("model", "coefficients", "message"),
    [
        ("gent", {}, "model must be one of ogden"),
        ("ogden", {"mu": [1.0, 2.0], "alpha": [2.0]}, "as many mu as alpha"),
        ("ogden", {"mu": [1.0], "alpha": [0.0]}, "must not be 0"),
        ("ogden", {"mu": [math.nan], "alpha": [2.0]}, "finite"),
        ("ogden", {"mu": [1.0]}, "missing: alpha"),
        ("neo-hooke", {"mu": [-1.0]}, "> 0"),
        ("neo-hooke", {"c": [1.0]}, "unknown: c"),
        ("mooney-rivlin", {"c": [1.0]}, "takes 2 values of c"),
        ("yeoh", {"c": [1.0, 2.0, 3.0, 4.0]}, "1 to 3"),
    ],
)
def test_bad_coefficients_are_named(
    model: str, coefficients: dict[str, list[float]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_law(model, coefficients, "case.toml: material")


def test_every_law_is_rebuilt_from_its_coefficients() -> None:
    assert {law.name for law in ALL.values()} == set(LAWS)
    for law in ALL.values():
        assert isinstance(law, HyperelasticLaw)
        assert make_law(law.name, law.coefficients()) == law
