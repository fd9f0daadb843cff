"""Patterns of coils over time: figures 3 and 7 of the source, PWM, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.dynamics.actuation import RING, Actuation


def _rows(actuation: Actuation) -> list[str]:
    return [
        "".join(name for name, on in zip(actuation.letters, row, strict=True) if on)
        for row in actuation.states
    ]


def _pattern(**other: Any) -> Actuation:
    return Actuation.pattern(**{"interval": 0.2, "duration": 1.6, **other})


@pytest.mark.parametrize(
    ("first", "rows"),
    [
        ("BF", ["BF", "CG", "DH", "AE", "BF", "CG", "DH", "AE", ""]),
        ("ABE", ["ABE", "BCF", "CDG", "DEH", "AEF", "BFG", "CGH", "ADH", ""]),
    ],
)
def test_patterns_of_figure_3_row_by_row(first: str, rows: list[str]) -> None:
    actuation = _pattern(first=first)
    assert _rows(actuation) == rows
    assert actuation.times == pytest.approx(0.2 * np.arange(9), abs=1e-15)


def test_a_pattern_comes_round_after_eight_steps() -> None:
    actuation = _pattern(first="ABE", duration=6.4)
    assert _rows(actuation)[:24] == 3 * _rows(actuation)[:8]


def test_a_row_holds_from_its_time_until_the_next() -> None:
    actuation = _pattern(letters="ABCDEFGHI")
    assert "".join(np.array(actuation.letters)[actuation.on(0.0)]) == "BF"
    assert "".join(np.array(actuation.letters)[actuation.on(0.1999)]) == "BF"
    assert "".join(np.array(actuation.letters)[actuation.on(0.2)]) == "CG"
    assert not actuation.on(1.6).any()
    assert not actuation.on(1e9).any()
    assert not actuation.states[:, 8].any()  # I takes no part


def test_the_other_direction_is_the_mirror_image() -> None:
    forwards = _pattern(first="ABE", direction=1)
    # The mirror that swaps A with B, C with H, D with G, E with F: place n goes to 1 - n.
    mirror = [(1 - n) % 8 for n in range(8)]
    first = "".join(RING[mirror[RING.index(name)]] for name in "ABE")
    backwards = _pattern(first=first, direction=-1)
    assert (backwards.states[:, mirror] == forwards.states).all()
    assert _rows(_pattern(direction=-1))[:4] == ["BF", "AE", "DH", "CG"]


def test_the_last_step_may_be_cut_short() -> None:
    actuation = _pattern(duration=0.5)
    assert actuation.times.tolist() == [0.0, 0.2, 0.4, 0.5]
    assert _rows(actuation) == ["BF", "CG", "DH", ""]


def test_pwm_within_a_step_by_hand() -> None:
    # Steps end at 0.2, periods at 0.08 and 0.16, so the third period lies in two steps.
    actuation = _pattern(duration=0.4, duty=0.75, pwm_period=0.08)
    expected = [
        (0.0, "BF"),
        (0.06, ""),
        (0.08, "BF"),
        (0.14, ""),
        (0.16, "BF"),
        (0.2, "CG"),
        (0.22, ""),
        (0.24, "CG"),
        (0.30, ""),
        (0.32, "CG"),
        (0.38, ""),
    ]
    assert _rows(actuation) == [row for _, row in expected]
    assert actuation.times == pytest.approx([time for time, _ in expected], abs=1e-15)


@pytest.mark.parametrize("duty", [0.1, 1 / 3, 0.5, 0.999])
@pytest.mark.parametrize("per_step", [1, 3, 7, 10])
def test_pwm_switches_each_coil_on_for_its_share(duty: float, per_step: int) -> None:
    """With whole periods in a step round-off must neither add nor lose an event."""
    interval, steps = 0.6, 40
    actuation = _pattern(
        interval=interval, duration=steps * interval, duty=duty, pwm_period=interval / per_step
    )
    assert actuation.times.size == 2 * steps * per_step
    assert actuation.on_time(steps * interval) == pytest.approx(
        np.full(8, duty * interval * steps / 4), rel=1e-11
    )  # 800 times near 24 s, each rounded by some 2e-15 s


@pytest.mark.parametrize(("interval", "period"), [(0.03, 0.1), (0.06, 0.2), (0.011, 0.11 / 3)])
def test_a_step_that_begins_where_an_on_time_ends_is_one_event(
    interval: float, period: float
) -> None:
    """Some begin a rounding before it: no coil may flash up in between."""
    actuation = _pattern(interval=interval, duration=100 * interval, duty=0.3, pwm_period=period)
    # All edges are whole multiples of interval / 3.
    assert np.diff(actuation.times).min() > 0.33 * interval
    assert actuation.times.size <= 301


def test_the_jump_of_figure_7() -> None:
    four = ((0.0, 2.0),)
    actuation = Actuation.table(
        "ABCDEFGHI", {"A": four, "D": four, "E": four, "F": four, "I": ((1.0, 2.5),)}, 4.0
    )
    assert _rows(actuation) == ["ADEF", "ADEFI", "I", ""]
    assert actuation.times.tolist() == [0.0, 1.0, 2.0, 2.5]


def test_a_table_may_begin_late_switch_twice_and_touch() -> None:
    actuation = Actuation.table("AB", {"B": ((1.0, 2.0), (2.0, 3.0), (4.0, 5.0))}, 5.0)
    assert _rows(actuation) == ["", "B", "", "B", ""]
    assert actuation.times.tolist() == [0.0, 1.0, 3.0, 4.0, 5.0]
    assert actuation.on_time(4.5).tolist() == [0.0, 2.5]
    assert _rows(Actuation.table("AB", {}, 5.0)) == [""]


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"first": "BI"}, "pattern.first: it names I.*only A to H"),
        ({"first": "Bf"}, "pattern.first: it names f.*only A to H"),
        ({"first": "BFB"}, "pattern.first: first repeats B"),
        ({"first": ""}, "pattern.first: first is empty"),
        ({"first": RING}, "pattern.first: it names all eight"),
        ({"letters": "ABCDEFGHH"}, "pattern.letters: letters repeats H"),
        ({"letters": "ABCDEFG"}, "pattern.letters: letters must be A to H"),
        ({"letters": "ABCDEFGHZ"}, "pattern.letters: letters must be A to H"),
        ({"interval": 0.0}, "pattern.interval: interval must be finite and > 0"),
        ({"interval": float("nan")}, "pattern.interval: interval must be finite and > 0"),
        ({"interval": float("inf")}, "pattern.interval: interval must be finite and > 0"),
        ({"duration": float("inf")}, "pattern.duration: duration must be finite and > 0"),
        ({"interval": 1.6}, "pattern.interval: interval must be shorter than duration"),
        ({"interval": 1e-9}, "pattern.interval: .* too short"),
        ({"direction": 0}, "pattern.direction: direction must be 1 or -1"),
        ({"duty": 0.0}, r"pattern.duty: duty must lie in \(0, 1\]"),
        ({"duty": 1.1}, r"pattern.duty: duty must lie in \(0, 1\]"),
        ({"duty": float("nan")}, r"pattern.duty: duty must lie in \(0, 1\]"),
        ({"duty": 0.5}, "pattern.pwm_period: pwm_period must be given"),
        ({"duty": 0.5, "pwm_period": -1.0}, "pattern.pwm_period: pwm_period must be finite"),
    ],
)
def test_what_a_pattern_refuses(other: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _pattern(**other)


@pytest.mark.parametrize(
    ("on_times", "message"),
    [
        ({"K": ((0.0, 1.0),)}, "table.K: no coil is called K: there are A, B, I"),
        ({"A": ((1.0, 1.0),)}, "table.A: off must come after on"),
        ({"A": ((2.0, 1.0),)}, "table.A: off must come after on"),
        ({"A": ((0.0, 2.0), (1.0, 3.0))}, "table.A: .*overlap"),
        ({"A": ((-1.0, 2.0),)}, "table.A: on and off must be finite and >= 0"),
        ({"A": ((0.0, float("nan")),)}, "table.A: on and off must be finite"),
        ({"A": ((0.0, 6.0),)}, "table.A: off at 6 s lies after the duration of 5 s"),
        ({"A": ((0.0, 1.0, 2.0),)}, "table.A: on-times are pairs"),
    ],
)
def test_what_a_table_refuses(on_times: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Actuation.table("ABI", on_times, 5.0)


def test_what_rows_refuse() -> None:
    off = np.zeros((2, 1), dtype=bool)
    with pytest.raises(InputError, match="must begin with 0"):
        Actuation(("A",), np.array([0.5, 1.0]), off)
    with pytest.raises(InputError, match="ascending"):
        Actuation(("A",), np.array([0.0, 0.0]), off)
    with pytest.raises(InputError, match="a row per time and a column per letter"):
        Actuation(("A", "B"), np.array([0.0, 1.0]), off)
    with pytest.raises(InputError, match="repeats A"):
        Actuation(("A", "A"), np.array([0.0, 1.0]), np.zeros((2, 2), dtype=bool))
    with pytest.raises(InputError, match="time must be >= 0"):
        _pattern().on(-0.1)
    with pytest.raises(ValueError, match="read-only"):
        _pattern().states[0, 0] = True
