"""The contact law: closed values, what it refuses, and its traction form."""

from __future__ import annotations

import math

import pytest

from flexapod.contact.law import ContactLaw, FrictionLaw, effective_modulus, hertz_stiffness
from flexapod.core.errors import InputError


def test_papers_formulas() -> None:
    # Equations 5 to 7 written out with numbers: E_k = 1/(0.84/2e5 + 0.91/3e5).
    e_k = 1.0 / ((1.0 - 0.4**2) / 2e5 + (1.0 - 0.3**2) / 3e5)
    assert effective_modulus(2e5, 0.4, 3e5, 0.3) == pytest.approx(e_k, rel=1e-14)
    radius = 0.01 * 0.03 / (0.01 + 0.03)
    k = math.sqrt(16.0 * radius * e_k**2 / 9.0)
    assert hertz_stiffness(2e5, 0.4, 3e5, 0.3, 0.01, 0.03) == pytest.approx(k, rel=1e-14)


def test_order_of_the_bodies_does_not_matter() -> None:
    one = hertz_stiffness(2e5, 0.4, 3e5, 0.3, 0.01, 0.03)
    assert hertz_stiffness(3e5, 0.3, 2e5, 0.4, 0.03, 0.01) == pytest.approx(one, rel=1e-14)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0])
def test_force_of_a_point(exponent: float) -> None:
    law = ContactLaw(4e3, exponent)
    assert law.normal_force(0.0) == 0.0
    assert law.normal_force(-1e-3) == 0.0
    # At the reference penetration every exponent gives Hertz's force.
    assert law.normal_force(1e-3) == pytest.approx(4e3 * 1e-3**1.5, rel=1e-14)
    # Twice as deep: 2**m1.
    ratio = law.normal_force(2e-3) / law.normal_force(1e-3)
    assert ratio == pytest.approx(2.0**exponent, rel=1e-14)
    # The traction over the reference area is the same force.
    depth = 3e-4
    force = law.traction_coefficient * depth**exponent * law.reference_area
    assert force == pytest.approx(law.normal_force(depth), rel=1e-13)


def test_papers_millimetres() -> None:
    # F_N = k d**2 with k in N/mm**1.5 and d in mm, as the paper computes.
    k_mm = 2.5
    law = ContactLaw(k_mm * 1e3**1.5, 2.0)
    assert law.normal_force(0.4e-3) == pytest.approx(k_mm * 0.4**2, rel=1e-12)


@pytest.mark.parametrize(
    "words",
    [
        {"stiffness": 0.0},
        {"stiffness": math.nan},
        {"stiffness_exponent": 0.5},
        {"friction": -0.1},
        {"reference_area": 0.0},
        {"reference_penetration": -1.0},
        {"stick_stiffness": 0.0},
    ],
)
def test_refused_values(words: dict[str, float]) -> None:
    with pytest.raises(InputError):
        ContactLaw(**{"stiffness": 1e3, **words})


def test_papers_damping_in_millimetres() -> None:
    # F = k d**2 + c d' d**2 with c = k/1e4, k in N/mm**1.5, d in mm and d' in mm/s.
    k_mm, d_mm, rate_mm = 2.5, 0.4, 30.0
    law = ContactLaw(k_mm * 1e3**1.5)
    damping = law.damping_coefficient * (rate_mm * 1e-3) * (d_mm * 1e-3) ** 2
    expected = k_mm / 1e4 * rate_mm * d_mm**2
    # Round-off of a dozen operations.
    assert damping * law.reference_area == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(("m2", "m3"), [(1.0, 2.0), (1.5, 1.0), (2.0, 3.0)])
def test_damping_at_other_exponents(m2: float, m3: float) -> None:
    # The same sum in millimetres: the docstring's 1e-4 (1e3)**m2, and d**m3 over (1 mm)**m3.
    k_mm, d_mm, rate_mm = 2.5, 0.4, 30.0
    law = ContactLaw(
        k_mm * 1e3**1.5,
        damping_ratio=1e-4 * 1e3**m2,
        damping_exponent=m2,
        indentation_exponent=m3,
    )
    damping = law.damping_coefficient * (rate_mm * 1e-3) ** m2 * (d_mm * 1e-3) ** m3
    expected = k_mm / 1e4 * rate_mm**m2 * d_mm**m3
    assert damping * law.reference_area == pytest.approx(expected, rel=1e-13)


def test_friction_falls_from_static_to_dynamic() -> None:
    law = FrictionLaw(0.8, 0.5, 0.01, 0.03)
    assert [law.coefficient(v) for v in (0.0, 0.005, 0.01)] == [0.8, 0.8, 0.8]
    assert [law.coefficient(v) for v in (0.03, 1.0)] == [0.5, 0.5]
    # The cubic step 3 a**2 - 2 a**3: 1/2 at the middle, 5/32 at the first quarter.
    assert law.coefficient(0.02) == pytest.approx(0.65, rel=1e-14)
    assert law.coefficient(0.015) == pytest.approx(0.8 - 0.3 * 5.0 / 32.0, rel=1e-14)
    # Level at both ends: a thousandth inside, the step has moved by 3e-6 of its height.
    assert 0.8 - law.coefficient(0.01 + 0.02e-3) < 3.1e-6 * 0.3
    assert law.coefficient(0.03 - 0.02e-3) - 0.5 < 3.1e-6 * 0.3


def test_constant_friction() -> None:
    law = FrictionLaw.constant(0.4)
    assert {law.coefficient(v) for v in (0.0, 1.2e-3, 1.0)} == {0.4}


@pytest.mark.parametrize(
    "values",
    [
        (0.5, 0.6),
        (0.5, -0.1),
        (10.0, 0.5),
        (math.nan, 0.5),
        (0.5, math.nan),
        (0.5, 0.4, 0.0),
        (0.5, 0.4, 0.02, 0.02),
        (0.5, 0.4, 0.02, 0.01),
        (0.5, 0.4, 0.02, math.inf),
    ],
)
def test_refused_friction(values: tuple[float, ...]) -> None:
    with pytest.raises(InputError):
        FrictionLaw(*values)
