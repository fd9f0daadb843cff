"""Drucker limits against hand calculations."""

from __future__ import annotations

import numpy as np
import pytest

from flexapod.materials.law import HyperelasticLaw
from flexapod.materials.library import load_material
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.stability import (
    SEARCH_RANGE,
    margins,
    stable_range,
    stable_ranges,
    unstable_states,
)

DRAGON = load_material("dragon-skin-20-sospider").law


def twin_margin(law: Ogden, e: np.ndarray) -> float:
    """Least eigenvalue of the Hessian of sum mu/alpha exp(alpha e), projected on sum(de) = 0."""
    hessian = np.diag(
        [sum(m * a * np.exp(a * x) for m, a in zip(law.mu, law.alpha, strict=True)) for x in e]
    )
    basis, _ = np.linalg.qr(np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]]))
    return float(np.linalg.eigvalsh(basis.T @ hessian @ basis)[0])


def test_margin_is_the_projected_hessian() -> None:
    """For isochoric states the energy is separable, so its Hessian is diagonal by hand."""
    rng = np.random.default_rng(2)
    e = rng.normal(scale=0.5, size=(30, 3))
    e -= e.mean(axis=1, keepdims=True)
    expected = [twin_margin(DRAGON, row) for row in e]
    scale = np.abs(margins(DRAGON, e)).max()
    np.testing.assert_allclose(margins(DRAGON, e), expected, atol=1e-11 * scale)


def test_margin_at_rest_is_twice_the_shear_modulus() -> None:
    """tau = 2 G dev(ln l) at rest: both eigenvalues are 2 G."""
    for law in (DRAGON, NeoHooke(4e5), MooneyRivlin(1e5, 2e4)):
        assert margins(law, np.zeros((1, 3)))[0] == pytest.approx(2.0 * law.shear_modulus)


def test_volume_change_does_not_matter() -> None:
    e = np.array([[0.5, -0.1, -0.4]])
    np.testing.assert_allclose(margins(DRAGON, e), margins(DRAGON, e + 0.3), rtol=1e-12)


def test_neo_hooke_and_positive_terms_are_stable_everywhere() -> None:
    for law in (NeoHooke(1e5), MooneyRivlin(1e5, 1e4), Ogden((1e5, -1e4), (2.0, -3.0))):
        for found in stable_ranges(law).values():
            assert found.as_list() == list(SEARCH_RANGE)
            assert (found.low_limit, found.high_limit) == ("search range", "search range")


def test_dragon_skin_ends_at_the_limits_of_physics_md() -> None:
    """Uniaxial tension just below 5; the same states are equibiaxial compression near 0.45."""
    uniaxial = stable_range(DRAGON, "uniaxial")
    equibiaxial = stable_range(DRAGON, "equibiaxial")
    assert uniaxial.high_limit == equibiaxial.low_limit == "instability"
    assert uniaxial.high == pytest.approx(4.96, abs=0.01)
    assert equibiaxial.low == pytest.approx(0.449, abs=0.001)
    assert equibiaxial.low == pytest.approx(uniaxial.high**-0.5, rel=1e-9)
    # The limit is where the projected Hessian loses its rank.
    e = np.log(uniaxial.high) * np.array([1.0, -0.5, -0.5])
    assert abs(twin_margin(DRAGON, e)) < 1e-6 * DRAGON.shear_modulus


def test_mooney_rivlin_limit_by_hand() -> None:
    """c01 < 0 in uniaxial tension, increments (1, -1/2, -1/2) and (0, 1, -1).

    The Hessian is diagonal with h(l) = 4 (c10 l**2 + c01 l**-2). The second increment gives
    2 h(l**-1/2) = 8 (c10/l + c01 l) = 0, hence l = sqrt(-c10/c01), before the first one fails.
    """
    law = MooneyRivlin(1.0e5, -1.0e4)
    assert stable_range(law, "uniaxial").high == pytest.approx(np.sqrt(10.0), rel=1e-9)


def test_law_unstable_at_rest_has_an_empty_range() -> None:
    found = stable_range(Ogden((-1e5,), (2.0,)), "planar")
    assert found.as_list() == [1.0, 1.0]
    assert not found.contains(1.01)


@pytest.mark.parametrize("law", [DRAGON, DRAGON.parameters()], ids=["law", "parameters"])
def test_states_of_a_simulation_are_told_apart(law: HyperelasticLaw) -> None:
    way = np.array([1.0, -0.5, -0.5])
    stretch = np.array([1.0, 4.9, 5.0, 0.1])
    states = np.log(stretch)[:, None] * way
    assert unstable_states(law, states).tolist() == [False, False, True, False]
    assert unstable_states(law, np.full((1, 3), np.nan)).tolist() == [True]
