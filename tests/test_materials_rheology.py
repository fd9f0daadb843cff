"""Rheological elements: switching, limits, what is refused; and the coil's active force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexapod.core.errors import InputError
from flexapod.materials.coil import BMX100, ShapeMemoryCoil
from flexapod.materials.rheology import (
    Maxwell,
    Packed,
    ThreeElement,
    ThreeElementSlider,
    Voigt,
)
from flexapod.materials.rheology_kernels import advance

INF = math.inf


def _law(packed: Packed, rate: float) -> Callable[[float], tuple[float, float]]:
    """The obvious twin: force and speed of the Voigt part by the table of regimes; b > 0."""
    k, b, c, limit, excess = packed

    def law(e_v: float) -> tuple[float, float]:
        stuck = k * e_v + b * rate
        side = math.copysign(1.0, stuck)
        if abs(stuck) <= limit or c == INF:
            force = stuck
        elif excess:
            force = side * limit + (stuck - side * limit) / (1.0 + b / c)
        else:
            flowing = stuck / (1.0 + b / c)
            force = flowing if abs(flowing) >= limit else side * limit
        return force, (force - k * e_v) / b

    return law


def _elements(count: int) -> list[tuple[Packed, float, float, float]]:
    """Random elements with a state, a rate and a step; small integers make borders be met."""
    rng = np.random.default_rng(2004)
    drawn = []
    for _ in range(count):
        packed = (
            float(rng.choice([0.0, 0.5, 2.0, 10.0])),
            float(rng.choice([0.05, 0.3, 2.0])),
            float(rng.choice([0.1, 1.0, 5.0, 1e8, INF])),
            float(rng.choice([0.0, 0.1, 1.0, 3.0, INF])),
            int(rng.integers(2)),
        )
        e_v = float(rng.choice([rng.normal() * 2.0, rng.integers(-3, 4)]))
        rate = float(rng.choice([rng.normal() * 3.0, rng.integers(-2, 3), 0.01]))
        drawn.append((packed, e_v, rate, float(rng.choice([0.01, 0.3, 1.0, 3.0, 40.0]))))
    return drawn


def test_steps_agree_with_an_ode_solver() -> None:
    """SciPy's LSODA on the twin, at rtol 1e-10: 2e-10 are measured, 1e-7 allowed."""
    met = set()
    for packed, e_v, rate, dt in _elements(150):
        law = _law(packed, rate)
        k, b, _, limit, _ = packed

        def slope(_: float, y: Any, law: Any = law, b: float = b, e: float = rate) -> list[float]:
            force, speed = law(y[0])
            return [speed, force, b * speed * speed + force * (e - speed)]

        # In pieces, so that no kink is stepped over.
        y = np.array([e_v, 0.0, 0.0])
        pieces = np.linspace(0.0, dt, 9)
        for begin, end in itertools.pairwise(pieces):
            y = solve_ivp(
                slope, (begin, end), y, method="LSODA", rtol=1e-10, atol=1e-12, max_step=dt / 40
            ).y[:, -1]
        e_new, force, mean, dissipated = advance(*packed, e_v, rate, dt)
        scale = 1.0 + abs(k * e_v) + abs(b * rate) + k * abs(rate) * dt
        assert e_new == pytest.approx(y[0], abs=1e-7 * (1.0 + abs(e_v) + abs(rate) * dt))
        assert mean * dt == pytest.approx(y[1], abs=1e-7 * scale * dt)
        assert dissipated == pytest.approx(y[2], abs=1e-7 * (1.0 + scale * scale / b * dt))
        assert force == pytest.approx(law(e_new)[0], abs=1e-13 * scale)
        met.add((abs(force) == limit, abs(force) > limit))
    assert len(met) == 3  # stuck, at the limit, beyond it


def test_one_step_equals_a_thousand() -> None:
    """Times of passage do not depend on the step; only round-off of the sums is left."""
    for packed, e_v, rate, dt in _elements(400):
        once = advance(*packed, e_v, rate, dt)
        v, impulse, dissipated, force = e_v, 0.0, 0.0, 0.0
        for _ in range(1000):
            v, force, mean, loss = advance(*packed, v, rate, dt / 1000)
            impulse += mean / 1000
            dissipated += loss
        # A thousand sums round by 1e-16 of the largest term each.
        k, b, _, _, _ = packed
        way = abs(e_v) + abs(rate) * dt
        scale = k * way + b * abs(rate)
        assert v == pytest.approx(once[0], abs=2e-13 * way + 1e-300)
        assert force == pytest.approx(once[1], abs=2e-13 * scale + 1e-300)
        assert impulse == pytest.approx(once[2], abs=2e-13 * scale + 1e-300)
        assert dissipated == pytest.approx(once[3], abs=2e-13 * scale * way + 1e-300)


def test_work_is_stored_or_dissipated() -> None:
    """``mean rate dt = (k e_v'**2 - k e_v**2)/2 + dissipated``: 6e-16 of the terms measured."""
    for packed, e_v, rate, dt in _elements(4000):
        k = packed[0]
        e_new, _, mean, dissipated = advance(*packed, e_v, rate, dt)
        work = mean * rate * dt
        size = abs(work) + k * (e_v**2 + e_new**2) + dissipated
        assert abs(work - 0.5 * k * (e_new**2 - e_v**2) - dissipated) <= 4e-15 * size
        assert dissipated >= 0.0


def test_a_step_of_no_length_gives_the_force_at_the_present_rate() -> None:
    for packed, e_v, rate, _ in _elements(400):
        e_new, force, mean, dissipated = advance(*packed, e_v, rate, 0.0)
        assert (e_new, mean, dissipated) == (e_v, force, 0.0)
        scale = abs(packed[0] * e_v) + abs(packed[1] * rate)
        assert force == pytest.approx(_law(packed, rate)(e_v)[0], abs=4e-16 * scale)


def test_tension_and_compression_are_mirror_images() -> None:
    for packed, e_v, rate, dt in _elements(400):
        up = advance(*packed, e_v, rate, dt)
        down = advance(*packed, -e_v, -rate, dt)
        assert down == (-up[0], -up[1], -up[2], up[3])


def test_little_damping_tends_to_none() -> None:
    """b -> 0 shrinks the sliding regime to a point; the difference falls in proportion to b."""
    for packed, e_v, rate, dt in _elements(400):
        k, _, c, limit, excess = packed
        if k == 0.0 or c < 1.0:
            continue
        none = advance(k, 0.0, c, limit, excess, e_v, rate, dt)
        little = advance(k, 1e-9, c, limit, excess, e_v, rate, dt)
        size = abs(e_v) + abs(rate) * dt
        assert little[0] == pytest.approx(none[0], abs=1e-8 * (size + abs(rate)))
        assert little[3] == pytest.approx(none[3], abs=1e-7 * (1 + k) * (size + abs(rate)) ** 2)


@pytest.mark.parametrize(
    ("rate", "force"),
    [(1e-3, 0.016), (1.6e-3, 0.016), (2e-3, 0.02), (0.5, 5.0)],
)
def test_without_damping_the_flow_is_at_the_limit_or_viscous(rate: float, force: float) -> None:
    """c e' below B: held at the limit for ever. Above: c e' after many times c/k = 0.2 s."""
    end = advance(50.0, 0.0, 10.0, 0.016, 0, 0.0, rate, 20.0)
    assert end[:2] == pytest.approx((force / 50.0, force), rel=1e-15)
    # Held there, turned round, it springs back at once.
    back = advance(50.0, 0.0, 10.0, 0.016, 0, 0.016 / 50.0, -rate, 1e-3)
    assert back[0] == pytest.approx(0.016 / 50.0 - 1e-3 * rate, rel=1e-15)


def test_below_the_limit_nothing_ever_flows() -> None:
    """1e5 cycles with 0.99 of the limit; numbers round in binary, so that sums are exact."""
    k, b, limit = 64.0, 0.125, 1.0
    rate, dt = 2.0**-3, 2.0**-4  # 64 * 2^-7 + 0.125 * 2^-3 = 0.516 N
    way = 2.0 * rate * dt * 0.96875
    v, dissipated = -0.5 * way, 0.0
    for _ in range(100_000):
        v, force, _, loss = advance(k, b, 4.0, limit, 0, v, rate, way / rate)
        assert abs(force) < limit
        v, _, _, back = advance(k, b, 4.0, limit, 0, v, -rate, way / rate)
        dissipated += loss + back
    assert v == -0.5 * way
    # What is lost is the damper's part and no more: b rate**2 over the whole time, 2e5 sums.
    assert dissipated == pytest.approx(b * rate * way * 200_000, rel=1e-12)


def test_a_rest_on_a_border_stays_there() -> None:
    """At c e' = B both regimes end at k e_v = B, where round-off gives e_v' any sign."""
    rng = np.random.default_rng(5)
    for _ in range(3000):
        k, b, c, limit = rng.uniform(0.1, 10.0, 4)
        rate = limit / c * float(rng.choice([1.0, 1.0 - 1e-16, 1.0 + 2e-16]))
        border = (limit + limit * (b / c) - b * rate) / k
        e_v = float(rng.choice([0.0, border, 3.0 * border, border * (1.0 - 4e-16)]))
        for dt in (1e-6, 1e4):  # the slowest decays by exp(-50)
            e_new, force, _, _ = advance(k, b, c, limit, 0, e_v, rate, dt)
            expected_force, _ = _law((k, b, c, limit, 0), rate)(e_new)
            assert force == pytest.approx(expected_force, abs=1e-14 * (k * e_v + limit))
        assert e_new == pytest.approx(limit / k, rel=1e-14)
        assert force == pytest.approx(limit, rel=1e-14)


def test_limits_of_the_numbers() -> None:
    voigt = advance(50.0, 0.1, INF, INF, 0, 0.01, 0.2, 0.5)
    for c, limit in ((10.0, INF), (INF, 0.0), (INF, 0.016)):
        assert advance(50.0, 0.1, c, limit, 0, 0.01, 0.2, 0.5) == voigt
    # A dashpot that hardly flows comes as near as 1/c: its precision must not be lost.
    for c in (1e9, 1e12, 1e15):
        nearly = advance(50.0, 0.1, c, 0.0, 0, 0.01, 0.2, 0.5)
        assert nearly[:3] == pytest.approx(voigt[:3], rel=30.0 / c + 1e-15)
        assert nearly[3] == pytest.approx(voigt[3], rel=1e4 / c + 1e-14)
    # k = 0: two dampers in series, 1/(1/b + 1/c).
    dampers = advance(0.0, 2.0, 3.0, 0.0, 0, 0.01, 0.2, 0.5)
    assert dampers[1:] == pytest.approx((0.24, 0.24, 0.24 * 0.1), rel=1e-15)


def test_packed_numbers() -> None:
    assert Voigt(1, 2).packed() == (1.0, 2.0, INF, INF, 0)
    assert Maxwell(1, 3).packed() == (1.0, 0.0, 3.0, 0.0, 0)
    assert ThreeElement(1, 2, 3).packed() == (1.0, 2.0, 3.0, 0.0, 0)
    assert ThreeElementSlider(1, 2, 3, 4).packed() == (1.0, 2.0, 3.0, 4.0, 0)
    assert ThreeElementSlider(1, 2, 3, 4, flow="excess").packed() == (1.0, 2.0, 3.0, 4.0, 1)
    assert BMX100.packed() == (50.0, 0.1, 10.0, 0.016, 0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Voigt(-1.0, 0.1), "voigt: stiffness must be finite and >= 0, got -1 N/m"),
        (lambda: Voigt(1.0, -0.1), "voigt: damping must be finite and >= 0, got -0.1 N s/m"),
        (lambda: Voigt(INF, 0.1), "voigt: stiffness must be finite"),
        (lambda: Voigt(0.0, 0.0), "voigt: stiffness and damping are both 0"),
        (lambda: Maxwell(-5.0, 1.0), "maxwell: stiffness must be finite and > 0, got -5 N/m"),
        (lambda: Maxwell(5.0, 0.0), "maxwell: flow_damping must be finite and > 0"),
        (lambda: ThreeElement(-5.0, 1.0, 1.0), "three-element: stiffness must be finite and >= 0"),
        (lambda: ThreeElement(5.0, 1.0, math.nan), "three-element: flow_damping must be > 0"),
        (lambda: ThreeElementSlider(-5.0, 1, 1, 1), "three-element slider: stiffness must be"),
        (lambda: ThreeElementSlider(5, 1, 1, -1.0), "three-element slider: limit must be >= 0"),
        (lambda: ThreeElementSlider(5, 1, -1.0, 1), "flow_damping must be > 0 .*got -1 N s/m"),
        (lambda: ThreeElementSlider(5, 1, 1, 1, flow="half"), "one of full, excess; got .half"),
        (lambda: Voigt(1, 1).drive([0.0], [0.0]), "times must be a list of two or more"),
        (lambda: Voigt(1, 1).drive([0.0, 0.0], [0.0, 1.0]), "times must be finite and ascending"),
        (lambda: Voigt(1, 1).drive([0.0, 1.0], [0.0]), "elongations .* must have one length"),
        (lambda: Voigt(1, 1).drive([0.0, 1.0], [0.0, INF]), "elongations must be finite"),
        (lambda: Voigt(1, 1).creep(math.nan, [0.0, 1.0]), "force must be finite"),
        (lambda: Voigt(1, 1).relaxation(math.nan, [0.0, 1.0]), "elongation must be finite"),
        (lambda: ShapeMemoryCoil(rate_on=0.0), "coil: rate_on must be finite and > 0"),
        (lambda: ShapeMemoryCoil(rate_off=-1.0), "coil: rate_off must be finite and > 0"),
        (lambda: ShapeMemoryCoil(largest=-0.1), "coil: largest must be finite and >= 0, got -0.1"),
        (lambda: ShapeMemoryCoil(passive=Voigt(1, 1)), "coil: passive must be .*got Voigt"),  # type: ignore[arg-type]
        (lambda: ShapeMemoryCoil().active([0.0, 1.0], [True, True], 0.2), "between 0 and largest"),
        (lambda: ShapeMemoryCoil().active([0.0, 1.0], [True]), "must have one length"),
    ],
)
def test_what_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_a_response_is_read_only_and_leaves_its_input_alone() -> None:
    times, way = np.array([0.0, 1.0]), np.array([0.0, 1e-3])
    response = BMX100.drive(times, way)
    with pytest.raises(ValueError, match="read-only"):
        response.force[0] = 1.0
    times[1] = way[1] = 2.0
    assert (response.times[1], response.elongation[1]) == (1.0, 1e-3)


def test_the_active_force_is_a_clipped_ramp() -> None:
    """Equation 5 by hand: up in 1 s, held, down; a late step and a short one meet the same."""
    coil = ShapeMemoryCoil()
    times = np.array([0.0, 0.4, 1.5, 2.0, 2.4, 2.5, 9.0])
    on = [True, True, True, False, True, False, False]
    force = coil.active(times, on)
    assert force == pytest.approx([0.0, 0.06, 0.15, 0.15, 0.09, 0.105, 0.0], abs=1e-16)
    fine = np.unique(np.concatenate([np.linspace(0.0, 9.0, 901), times]))
    held = np.array(on)[np.searchsorted(times, fine, side="right") - 1]
    # 900 sums of about 0.1 round by 1e-17 each.
    assert coil.active(fine, held)[np.isin(fine, times)] == pytest.approx(force, abs=1e-14)
