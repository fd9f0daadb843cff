"""Rheological elements against closed forms: creep, relaxation, ramps, sliding and cycles.

Every step is exact, so the tolerances are round-off: 1e-12 of the quantity where some hundred
steps are summed, unless a line says otherwise.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexapod.materials.rheology import (
    Element,
    Maxwell,
    Response,
    ThreeElement,
    ThreeElementSlider,
    Voigt,
)

K, B_V, C, LIMIT = 50.0, 0.1, 10.0, 0.016  # the source's coil [N/m, N s/m, N s/m, N]
TIMES = np.concatenate([[0.0], np.geomspace(1e-5, 3.0, 200)])
ELEMENTS: list[Element] = [
    Voigt(K, B_V),
    Maxwell(K, C),
    ThreeElement(K, B_V, C),
    ThreeElementSlider(K, B_V, C, LIMIT),
    ThreeElementSlider(K, B_V, C, LIMIT, flow="excess"),
    ThreeElementSlider(K, 0.0, C, LIMIT),
]
NAMES = ["voigt", "maxwell", "three", "slider", "bingham", "undamped slider"]


def _stored(response: Response) -> np.ndarray:
    return np.asarray(0.5 * K * (response.voigt**2 - response.voigt[0] ** 2))


@pytest.mark.parametrize("force", [0.1, 0.01, -0.1])
@pytest.mark.parametrize("element", ELEMENTS, ids=NAMES)
def test_creep(element: Element, force: float) -> None:
    """``e = f/k (1 - exp(-t k/b)) + (f - x B)/c t``, the last only beyond the limit."""
    k, b, c, limit, excess = element.packed()
    response = element.creep(force, TIMES)
    spring = force / k * (1.0 - np.exp(-TIMES * k / b)) if b > 0.0 else np.full(201, force / k)
    flow = 0.0
    if abs(force) > limit:
        flow = (force - excess * math.copysign(limit, force)) / c
    assert response.elongation == pytest.approx(spring + flow * TIMES, rel=1e-12)
    assert response.voigt == pytest.approx(spring, rel=1e-12)
    # Work f e; all of it that is not stored is lost.
    assert response.work == pytest.approx(force * response.elongation, rel=1e-12)
    lost = response.work - 0.5 * k * response.voigt**2
    assert response.dissipated == pytest.approx(lost, rel=1e-11, abs=1e-16)


def test_creep_recovers_its_elastic_part_only() -> None:
    """Loaded for 2 s, then free: what flowed, f/c 2 s, remains; the spring's part decays."""
    times = np.linspace(0.0, 4.0, 401)
    force = np.where(times < 2.0, 0.1, 0.0)
    response = ThreeElementSlider(K, B_V, C, LIMIT).creep(force, times)
    assert response.flowed[-1] == pytest.approx(0.1 / C * 2.0, rel=1e-12)
    after = response.elongation[times > 2.0] - 0.02
    assert after == pytest.approx(
        0.1 / K * np.exp(-(times[times > 2.0] - 2.0) * K / B_V), abs=1e-15
    )


def test_relaxation_of_a_voigt_element() -> None:
    response = Voigt(K, B_V).relaxation(2e-3, TIMES)
    assert response.force == pytest.approx(np.full(201, K * 2e-3), rel=1e-15)
    assert response.dissipated == pytest.approx(np.zeros(201), abs=0.0)


@pytest.mark.parametrize("damping", [0.0, B_V])
def test_relaxation_with_a_dashpot(damping: float) -> None:
    """``f = k e w**2 exp(-t k/(b + c))`` with ``w = c/(b + c)``: one w of the step, one of f_y."""
    element = ThreeElement(K, damping, C) if damping > 0.0 else Maxwell(K, C)
    response = element.relaxation(2e-3, TIMES)
    share = C / (damping + C)
    expected = K * 2e-3 * share**2 * np.exp(-TIMES * K / (damping + C))
    assert response.force == pytest.approx(expected, rel=1e-12)
    assert response.dissipated == pytest.approx(-_stored(response), rel=1e-12, abs=1e-18)


def test_relaxation_to_the_limit_flows_then_slides() -> None:
    """Flow at ``k e_v = f_s`` down to ``B (1 + b/c)``, then ``b e_v' = B - k e_v``.

    With b = c/2 the regimes are far apart: flowing ends at ``k e_v = 3/2 B``.
    """
    b = 0.5 * C
    response = ThreeElementSlider(K, b, C, LIMIT).relaxation(3.0 * LIMIT / K * 1.5, TIMES)
    pull = 3.0 * LIMIT  # two thirds of 4.5 B remain to the spring after the step
    turn = (b + C) / K * math.log(pull / (1.5 * LIMIT))
    flowing = turn > TIMES
    assert 10 < flowing.sum() < 190
    spring = np.where(
        flowing,
        pull * np.exp(-TIMES * K / (b + C)),
        LIMIT + 0.5 * LIMIT * np.exp(-(TIMES - turn) * K / b),
    )
    assert K * response.voigt == pytest.approx(spring, rel=1e-12)
    assert response.force == pytest.approx(np.where(flowing, spring / 1.5, LIMIT), rel=1e-12)
    assert (response.force[~flowing] == LIMIT).all()


def test_relaxation_of_a_bingham_slider() -> None:
    """``k e_v - B`` decays with ``(b + c)/k``, and f - B is c/(b + c) of it."""
    response = ThreeElementSlider(K, B_V, C, LIMIT, flow="excess").relaxation(2e-3, TIMES)
    share = C / (B_V + C)
    beyond = (K * 2e-3 * share - LIMIT) * np.exp(-TIMES * K / (B_V + C))
    assert K * response.voigt == pytest.approx(LIMIT + beyond, rel=1e-12)
    assert response.force == pytest.approx(LIMIT + share * beyond, rel=1e-12)


def test_a_step_below_the_limit_never_relaxes() -> None:
    response = ThreeElementSlider(K, B_V, C, LIMIT).relaxation(0.99 * LIMIT / K, TIMES)
    assert (response.force == response.force[0]).all()
    assert response.dissipated[-1] == 0.0


def test_a_ramp_passes_all_regimes_at_their_times() -> None:
    """From rest at the rate e' with b = c/2 and c e' = 1.6 B, so b e' = 0.8 B.

    Stuck until ``k e_v = B - b e' = 0.2 B``. Sliding towards ``k e_v = B`` with b/k, until
    ``k e_v = B (1 + b/c) - b e' = 0.7 B``. Then flowing towards ``k e_v = c e'`` with (b + c)/k.
    """
    b = 0.5 * C
    rate = 1.6 * LIMIT / C
    stuck = 0.2 * LIMIT / (K * rate)
    slid = stuck + b / K * math.log(0.8 / 0.3)
    response = ThreeElementSlider(K, b, C, LIMIT).drive(TIMES, rate * TIMES)
    spring = np.select(
        [stuck > TIMES, slid > TIMES],
        [K * rate * TIMES, LIMIT * (1.0 - 0.8 * np.exp(-(TIMES - stuck) * K / b))],
        LIMIT * (1.6 - 0.9 * np.exp(-(TIMES - slid) * K / (b + C))),
    )
    force = np.select(
        [stuck > TIMES, slid > TIMES],
        [spring + b * rate, np.full(201, LIMIT)],
        (spring + b * rate) / 1.5,
    )
    assert K * response.voigt == pytest.approx(spring, rel=1e-12)
    assert response.force == pytest.approx(force, rel=1e-12)
    # In a single step, too.
    once = ThreeElementSlider(K, b, C, LIMIT).drive([0.0, 3.0], [0.0, 3.0 * rate])
    assert once.voigt[-1] == pytest.approx(response.voigt[-1], rel=1e-12)
    assert once.dissipated[-1] == pytest.approx(response.dissipated[-1], rel=1e-12)


def test_slow_pulling_is_dry_friction() -> None:
    """c e' below B: the force ends at the very limit, whatever the rate, and all work is lost."""
    for rate in (1e-6, 1e-4, 1.5e-3):
        response = ThreeElementSlider(K, B_V, C, LIMIT).drive([0.0, 1e3], [0.0, rate * 1e3])
        assert response.force[-1] == LIMIT
        later = ThreeElementSlider(K, B_V, C, LIMIT).drive(
            [0.0, 1.0], [0.0, rate], voigt=response.voigt[-1]
        )
        assert later.dissipated[-1] == pytest.approx(LIMIT * rate, rel=1e-9)  # e_v settled


@pytest.mark.parametrize("flow", ["full", "excess"])
def test_a_cycle_far_beyond_the_limit_loses_its_loop(flow: str) -> None:
    """After the first cycles the loop repeats: work over one is the dissipation and is positive."""
    times = np.linspace(0.0, 10.0, 2001)
    way = 3e-3 * np.sin(2.0 * np.pi * times)
    response = ThreeElementSlider(K, B_V, C, LIMIT, flow=flow).drive(times, way)
    last, before = slice(1800, 2001), slice(1600, 1801)
    assert response.force[last] == pytest.approx(response.force[before], abs=1e-9)
    work = response.work[2000] - response.work[1800]
    assert work > 0.0
    assert work == pytest.approx(response.dissipated[2000] - response.dissipated[1800], rel=1e-9)


@pytest.mark.parametrize("element", ELEMENTS, ids=NAMES)
def test_random_ways_keep_the_energy(element: Element) -> None:
    rng = np.random.default_rng(7)
    times = np.cumsum(rng.exponential(0.05, 500))
    response = element.drive(times, 2e-3 * rng.normal(size=500))
    balance = response.work - _stored(response) - response.dissipated
    # 500 sums of the largest work, some 1e-16 each.
    assert np.abs(balance).max() <= 1e-13 * np.abs(response.work).max()
    assert (np.diff(response.dissipated) >= 0.0).all()
