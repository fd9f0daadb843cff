"""Prony series: conventions, relaxation, dynamic moduli and the fit to a relaxation record."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from flexapod.core.errors import InputError
from flexapod.materials.prony import Prony, fit_prony

SERIES = Prony((0.5, 0.2, 1.5), (0.01, 0.3, 20.0))


def test_conventions_convert_both_ways() -> None:
    # By hand: fractions 0.2 and 0.3 of the instant leave half of it for the long term.
    series = Prony.from_normalised((0.2, 0.3), (1.0, 5.0))
    assert series.moduli == pytest.approx((0.4, 0.6), rel=1e-15)
    assert series.instantaneous == pytest.approx(2.0, rel=1e-15)
    fractions, times = series.to_normalised()
    assert fractions == pytest.approx((0.2, 0.3), rel=1e-15)
    assert times == (1.0, 5.0)
    # Abaqus' own formula for the relaxation of the instantaneous modulus.
    t = np.array([0.0, 0.7, 3.0, 40.0])
    normalised = 1.0 - sum(
        k * (1.0 - np.exp(-t / tau)) for k, tau in zip(fractions, times, strict=True)
    )
    assert series.relaxation(t) / series.instantaneous == pytest.approx(normalised, rel=1e-14)


def test_relaxation_from_the_instant_to_the_long_term() -> None:
    assert SERIES.relaxation(0.0) == pytest.approx(SERIES.instantaneous, rel=1e-15)
    assert SERIES.relaxation(1e4) == pytest.approx(1.0, rel=1e-15)
    assert SERIES.relaxation(np.zeros((2, 3))).shape == (2, 3)
    by_hand = 1.0 + 0.5 * math.exp(-30.0) + 0.2 * math.exp(-1.0) + 1.5 * math.exp(-0.015)
    assert SERIES.relaxation(0.3) == pytest.approx(by_hand, rel=1e-15)


@pytest.mark.parametrize("omega", [0.01, 1.0, 50.0])
def test_storage_and_loss_are_transforms_of_the_relaxation(omega: float) -> None:
    """``G' + i G'' = G(inf) + i omega integral (G(t) - G(inf)) exp(-i omega t) dt``."""

    def overstress(t: float) -> float:
        return float(SERIES.relaxation(t)) - 1.0

    loss = storage = 0.0
    # Panels of the fast branches first; quad's tolerance is far below the one asked here.
    edges = [0.0, 0.1, 3.0, 600.0]
    for a, b in itertools.pairwise(edges):
        for weight in ("sin", "cos"):
            part = quad(overstress, a, b, weight=weight, wvar=omega, epsabs=1e-13, epsrel=1e-11)[0]
            if weight == "sin":
                storage += omega * part
            else:
                loss += omega * part
    got = SERIES.storage_loss(omega)
    assert got[0] == pytest.approx(1.0 + storage, abs=1e-8)
    assert got[1] == pytest.approx(loss, abs=1e-8)


def test_storage_and_loss_at_the_ends() -> None:
    storage, loss = SERIES.storage_loss(np.array([0.0, 1e18]))
    assert storage == pytest.approx([1.0, SERIES.instantaneous], rel=1e-15)
    assert loss == pytest.approx([0.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("terms", [1, 2, 3])
def test_fit_recovers_a_series(terms: int, sign: float) -> None:
    series = Prony(SERIES.moduli[:terms], SERIES.times[:terms])
    t = np.geomspace(1e-3, 200.0, 150)
    result = fit_prony(t, sign * 7e4 * series.relaxation(t), terms)
    # Least squares stops at relative changes of 1e-14 of a problem conditioned below 1e3, by
    # differences good to 1e-10; measured below 1e-9.
    assert result.prony.moduli == pytest.approx(series.moduli, rel=1e-6)
    assert result.prony.times == pytest.approx(series.times, rel=1e-6)
    assert result.long_term == pytest.approx(sign * 7e4, rel=1e-6)
    assert result.r_squared > 1.0 - 1e-12
    assert result.rms_relative_error < 1e-7
    assert result.point_count == 150


def test_fit_finds_five_branches_a_decade_apart() -> None:
    series = Prony((0.3, 0.2, 0.1, 0.05, 0.4), (0.02, 0.2, 2.0, 12.0, 60.0))
    t = np.geomspace(0.005, 300.0, 300)
    result = fit_prony(t, series.relaxation(t), 5)
    # The closest pair is a factor of five apart: condition below 1e4.
    assert result.prony.times == pytest.approx(series.times, rel=1e-5)
    assert result.prony.moduli == pytest.approx(series.moduli, rel=1e-5)


def test_fit_of_noisy_data_follows_the_curve_and_repeats_itself() -> None:
    t = np.geomspace(1e-3, 200.0, 300)
    clean = SERIES.relaxation(t)
    noisy = clean * (1.0 + 0.01 * np.random.default_rng(4).normal(size=t.size))
    result = fit_prony(t, noisy, 3)
    assert fit_prony(t, noisy, 3) == result
    # Seven parameters of 300 points: noise of 1 % leaves about 0.01 sqrt(7/300) = 0.15 %.
    fitted = result.long_term * result.prony.relaxation(t)
    assert np.sqrt(np.mean((fitted / clean - 1.0) ** 2)) < 0.004
    assert result.rms_relative_error == pytest.approx(0.01, rel=0.2)
    residual = noisy - fitted
    r_squared = 1.0 - np.sum(residual**2) / np.sum((noisy - noisy.mean()) ** 2)
    assert result.r_squared == pytest.approx(r_squared, rel=1e-12)


def test_log_spaced_times_fit_a_power_law_better_with_more_terms() -> None:
    t = np.geomspace(0.1, 1000.0, 200)
    values = 1.0 + t**-0.3
    errors = []
    for terms in (1, 2, 4, 8):
        result = fit_prony(t, values, terms, "log-spaced")
        steps = np.diff(np.log(result.prony.times))
        # Spread evenly, whichever of them were needed: multiples of the spacing.
        spacing = math.log(1e4) / terms
        assert np.abs(steps / spacing - np.round(steps / spacing)).max(initial=0.0) < 1e-9
        errors.append(result.rms_relative_error)
    assert errors == sorted(errors, reverse=True)
    # Two branches a decade follow a smooth spectrum to about a per cent (measured 0.3 %).
    assert errors[-1] < 0.01


def test_superfluous_terms_do_no_harm() -> None:
    series = Prony((0.8,), (2.0,))
    t = np.linspace(0.05, 30.0, 100)
    result = fit_prony(t, series.relaxation(t), 3)
    assert result.r_squared > 1.0 - 1e-10
    assert result.prony.relaxation(t) * result.long_term == pytest.approx(
        series.relaxation(t), rel=1e-6
    )


def test_refused_input() -> None:
    for moduli, times in (((), ()), ((1.0,), (1.0, 2.0))):
        with pytest.raises(InputError, match="as many moduli as times"):
            Prony(moduli, times)
    with pytest.raises(InputError, match=r"moduli\[2\] must be finite and > 0"):
        Prony((1.0, -0.1), (1.0, 2.0))
    with pytest.raises(InputError, match=r"times\[1\] must be finite and > 0"):
        Prony((1.0,), (math.inf,))
    with pytest.raises(InputError, match="less than 1"):
        Prony.from_normalised((0.6, 0.4), (1.0, 2.0))
    with pytest.raises(InputError, match=">= 0"):
        SERIES.relaxation([-1.0])
    with pytest.raises(InputError, match=">= 0"):
        SERIES.storage_loss(-1.0)


def test_records_that_cannot_be_fitted_are_refused() -> None:
    t = np.linspace(0.0, 10.0, 50)
    good = 1.0 + np.exp(-t)
    with pytest.raises(InputError, match="spacing"):
        fit_prony(t, good, 1, "even")
    with pytest.raises(InputError, match="terms must be"):
        fit_prony(t, good, 0)
    with pytest.raises(InputError, match="more than 5 points"):
        fit_prony(t[:5], good[:5], 2)
    with pytest.raises(InputError, match="have one length"):
        fit_prony(t, good[1:], 1)
    with pytest.raises(InputError, match="ascending"):
        fit_prony(t[::-1], good, 1)
    with pytest.raises(InputError, match="one sign"):
        fit_prony(t, good - 1.5, 1)
    with pytest.raises(InputError, match="no long-term modulus"):
        fit_prony(t, np.exp(-t), 1)
    with pytest.raises(InputError, match="does not relax"):
        fit_prony(t, 2.0 - np.exp(-t), 1)
