"""Gaits of six legs: the paper's numbers by hand, continuity, symmetry, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.dynamics.gait import (
    Gait,
    GaitHold,
    GaitPairs,
    GaitPronk,
    GaitWalk,
    TwoPhaseClock,
)
from flexapod.dynamics.gait_tables import GaitSensed, GaitTable, Move

DEG = math.pi / 180.0
PAPER = (60 * DEG, 30 * DEG, 3.0, 1.2)  # {theta_s, theta_0, t_c, t_s} of figure 8a
PRONK = (60 * DEG, -30 * DEG, 3.0, 1.2)  # of figure 8b
# A few operations on numbers of some tens of radians, at most 8 periods on.
ROUND = 1e-12
LEFT, RIGHT = [0, 2, 4], [1, 3, 5]

GAITS: dict[str, Callable[[], Gait]] = {
    "tripod": lambda: GaitWalk.tripod(*PAPER),
    "turning": lambda: GaitWalk.tripod(*PAPER, turn_centre=7 * DEG, turn_time=0.3, start=0.4),
    "backward": lambda: GaitWalk.tripod(*PAPER, direction=-1, start_angle=0.0),
    "together": lambda: GaitWalk.together(*PAPER, turn_time=-0.3, start_angle=-1.0),
    "spot turn": lambda: GaitWalk.spot_turn(*PAPER),
    "spot turn, same": lambda: GaitWalk.spot_turn(*PAPER, reversal="same", towards="right"),
    "pronk": lambda: GaitPronk(*PRONK),
    "pronk, smooth": lambda: GaitPronk(*PRONK, "slow_time", "smooth", "front", 0.3),
    "pairs": lambda: GaitPairs(rounds=3, start=0.2),
    "pairs, onward": lambda: GaitPairs(rounds=3, push_angle=300 * DEG, returns="onward"),
    "table": lambda: _table(repeat=True),
    "hold": lambda: GaitHold(0.5),
}
# Largest speed by hand [rad/s]: 300 deg in 1.8 s and so on.
FASTEST = {
    "tripod": 300 * DEG / 1.8,
    "turning": 300 * DEG / 1.5,
    "backward": 300 * DEG / 1.8,
    "together": 300 * DEG / 1.5,
    "spot turn": 300 * DEG / 1.8,
    "spot turn, same": 300 * DEG / 1.8,
    "pronk": 60 * DEG / 1.2,
    "pronk, smooth": 0.5 * math.pi * 60 * DEG / 1.2,
    "pairs": math.pi / 0.5,
    "pairs, onward": 240 * DEG / 0.5,
    "table": 360 * DEG / 0.5,
    "hold": 0.0,
}


def _table(repeat: bool = False, start: float = 0.0) -> GaitTable:
    return GaitTable.of_legs(
        {
            "14": [(0.0, 0.0), (0.5, 360 * DEG), (2.0, 360 * DEG)],
            "5": [(0.0, 0.0), (1.0, 90 * DEG), (1.6, 0.0)],
            "236": [(0.0, 10 * DEG)],
        },
        repeat=repeat,
        start=start,
    )


def _sampled(gait: Gait, times: np.ndarray) -> np.ndarray:
    return np.array([gait.targets(float(time)) for time in times])


# --------------------------------------------------------------------------- the clock


def test_the_clock_of_the_paper_by_hand() -> None:
    clock = TwoPhaseClock(*PAPER)
    # The slow phase is 0 to 60 deg in 1.2 s about phase time 0; 300 deg in 1.8 s follow.
    corners = {-0.6: 0.0, 0.0: 30.0, 0.6: 60.0, 1.5: 210.0, 2.4: 360.0, 3.0: 390.0, -3.6: -360.0}
    for time, angle in corners.items():
        assert clock.angle(time) == pytest.approx(angle * DEG, abs=ROUND), time
        assert clock.phase_time(angle * DEG) == pytest.approx(time, abs=ROUND), angle
    assert clock.rate(0.1) == pytest.approx(50 * DEG, rel=1e-14)
    assert clock.rate(1.1) == pytest.approx(300 / 1.8 * DEG, rel=1e-14)


def test_the_rate_at_a_corner_is_that_after_it() -> None:
    clock = TwoPhaseClock(1.0, 0.0, 4.0, 2.0)  # corners at -1 and 1, exact in floating point
    assert clock.rate(-1.0) == 0.5
    assert clock.rate(1.0) == (2.0 * math.pi - 1.0) / 2.0


# --------------------------------------------------------------------------- walking


def test_figure_8a_by_hand() -> None:
    # From 180 deg the first tripod has 180 deg of the fast phase before it, 1.08 s. The second
    # waits for half a period.
    gait = GaitWalk.tripod(*PAPER)
    first = {0.0: 180.0, 1.08: 360.0, 1.68: 390.0, 2.28: 420.0, 3.0: 540.0, 4.08: 720.0}
    for time, angle in first.items():
        legs = gait.targets(time)
        assert legs[[0, 3, 4]] == pytest.approx(angle * DEG, abs=ROUND), time
        legs = gait.targets(time + 1.5)
        assert legs[[1, 2, 5]] == pytest.approx(angle * DEG, abs=ROUND), time
    for time in (-1.0, 0.0, 0.7, 1.5):
        assert gait.targets(time)[[1, 2, 5]] == pytest.approx(math.pi, abs=0.0)
    assert gait.rates(1.2) / DEG == pytest.approx([50, 0, 0, 50, 50, 0], rel=1e-13)
    assert gait.rates(0.0) / DEG == pytest.approx([500 / 3, 0, 0, 500 / 3, 500 / 3, 0], rel=1e-13)


def test_tripods_are_half_a_period_apart() -> None:
    gait = GaitWalk.tripod(*PAPER)
    times = np.linspace(2.0, 8.0, 601)
    late = _sampled(gait, times + 1.5)
    assert late[:, [1, 2, 5]] == pytest.approx(_sampled(gait, times)[:, [0, 3, 4]], abs=ROUND)


def test_the_other_tripod_leads_if_told() -> None:
    left, right = (GaitWalk.tripod(*PAPER, lead=lead) for lead in ("left", "right"))
    times = np.linspace(0.0, 6.0, 301)
    swapped = [1, 0, 3, 2, 5, 4]
    assert (_sampled(left, times) == _sampled(right, times)[:, swapped]).all()


@pytest.mark.parametrize("start_angle", [math.pi, 0.0, 30 * DEG, -2.0])
def test_the_mirrored_turn_swaps_left_and_right(start_angle: float) -> None:
    times = np.linspace(0.0, 8.0, 801)
    swapped = [1, 0, 3, 2, 5, 4]
    offsets = {"turn_centre": 6 * DEG, "turn_time": 0.25}
    mirrored = {name: -value for name, value in offsets.items()}
    one = GaitWalk.tripod(*PAPER, **offsets, start_angle=start_angle)
    other = GaitWalk.tripod(*PAPER, **mirrored, lead="right", start_angle=start_angle)
    assert (_sampled(one, times) == _sampled(other, times)[:, swapped]).all()
    one = GaitWalk.together(*PAPER, **offsets, start_angle=start_angle)
    other = GaitWalk.together(*PAPER, **mirrored, start_angle=start_angle)
    assert (_sampled(one, times) == _sampled(other, times)[:, swapped]).all()
    assert not np.allclose(_sampled(one, times), _sampled(other, times))


@pytest.mark.parametrize("start_angle", [math.pi, 0.0, 30 * DEG, -2.0])
def test_a_turn_adds_on_the_left_and_keeps_the_sides_in_step(start_angle: float) -> None:
    gait = GaitWalk.together(*PAPER, turn_centre=6 * DEG, turn_time=0.25, start_angle=start_angle)
    assert [gait.left.centre / DEG, gait.left.slow_time] == pytest.approx([36.0, 1.45], rel=1e-14)
    assert [gait.right.centre / DEG, gait.right.slow_time] == pytest.approx([24.0, 0.95], rel=1e-14)
    # No side waits for a whole turn, and the middles of the slow phases fall together.
    assert max(gait.begins) < 0.5
    middles = []
    for clock, leg in ((gait.left, 0), (gait.right, 1)):
        turns = math.ceil((start_angle - clock.centre) / (2.0 * math.pi)) + 1
        low, high = 0.0, 9.0
        for _ in range(60):  # by halving, on the gait itself
            time = 0.5 * (low + high)
            passed = gait.targets(time)[leg] >= clock.centre + 2.0 * math.pi * turns
            low, high = (low, time) if passed else (time, high)
        middles.append(low)
    assert math.remainder(middles[1] - middles[0], 3.0) == pytest.approx(0.0, abs=1e-12)


def test_a_spot_turn_is_opposite() -> None:
    gait = GaitWalk.spot_turn(*PAPER, phases=(0.0,) * 6)
    times = np.linspace(0.0, 7.0, 701)
    way = _sampled(gait, times) - math.pi
    assert way[:, LEFT] == pytest.approx(-way[:, RIGHT], abs=0.0)
    assert (way[1:, RIGHT] > 0.0).all()
    right = GaitWalk.spot_turn(*PAPER, phases=(0.0,) * 6, towards="right")
    assert (_sampled(right, times) - math.pi == -way).all()
    # In tripods too: legs 1 and 4 are mirror images in step.
    tripods = _sampled(GaitWalk.spot_turn(*PAPER), times) - math.pi
    assert tripods[:, 0] == pytest.approx(-tripods[:, 3], abs=0.0)
    assert tripods[:, 2] == pytest.approx(-tripods[:, 1], abs=0.0)


@pytest.mark.parametrize(("reversal", "low"), [("mirrored", -60.0), ("same", 0.0)])
def test_where_a_side_that_goes_backward_is_slow(reversal: Any, low: float) -> None:
    gait = GaitWalk.spot_turn(*PAPER, reversal=reversal)
    for time in np.linspace(3.0, 9.0, 607):
        angle = (gait.targets(time)[0] / DEG - low) % 360.0
        if min(angle, abs(angle - 60.0), 360.0 - angle) > 1e-6:
            rate = 50.0 if angle < 60.0 else 300.0 / 1.8
            assert gait.rates(time)[0] / DEG == pytest.approx(-rate, rel=1e-12), time


# --------------------------------------------------------------------------- all gaits


@pytest.mark.parametrize("name", GAITS)
def test_targets_are_continuous_and_rates_their_derivative(name: str) -> None:
    gait = GAITS[name]()
    step = 1e-3
    times = -0.5 + step * np.arange(9501)
    targets = _sampled(gait, times)
    rates = np.array([gait.rates(float(time)) for time in times])
    assert targets.shape == rates.shape == (9501, 6)
    assert np.abs(np.diff(targets, axis=0)).max() <= FASTEST[name] * step + ROUND
    assert np.abs(rates).max() == pytest.approx(FASTEST[name], rel=1e-4, abs=ROUND)
    slope = np.diff(targets, axis=0) / step
    # Steps without a corner: both ends have nearly one rate. The trapezoidal rule is exact for
    # constant rates and misses step^2/12 times the rate's second derivative for the cosine,
    # 6e-7 rad/s here.
    plain = np.abs(np.diff(rates, axis=0)) < 0.01
    assert plain.mean() > 0.99
    mean = 0.5 * (rates[1:] + rates[:-1])
    assert slope[plain] == pytest.approx(mean[plain], abs=2e-6)


@pytest.mark.parametrize("name", [name for name in GAITS if name != "hold"])
def test_a_period_later_all_is_the_same_but_for_whole_turns(name: str) -> None:
    gait = GAITS[name]()
    begin = 2.0 * gait.period + 0.5  # all legs have begun by then
    times = np.linspace(begin, begin + gait.period, 211)
    if math.isfinite(gait.end):  # pairs: from when all pairs have begun until the last round
        begin = gait.start + 2 * 0.8  # type: ignore[attr-defined]
        times = np.linspace(begin, gait.start + gait.period, 211)  # type: ignore[attr-defined]
    way = _sampled(gait, times + gait.period) - _sampled(gait, times)
    turns = np.round(way / (2.0 * math.pi))
    assert way == pytest.approx(2.0 * math.pi * turns, abs=1e-11)
    expected = {"tripod": 1, "backward": -1, "pronk": 0, "pairs": 0, "pairs, onward": 1}
    if name in expected:
        assert (turns == expected[name]).all()


def test_before_the_start_the_legs_are_held() -> None:
    for gait, angle in (
        (GaitWalk.tripod(*PAPER, start=2.0, start_angle=1.0), 1.0),
        (GaitPronk(*PRONK, start=2.0), 0.0),
        (GaitPronk(*PRONK, begins="front", start=2.0), -60 * DEG),
        (GaitPairs(start=2.0), math.pi),
    ):
        assert gait.targets(1.99) == pytest.approx(angle, abs=ROUND)
        assert (gait.rates(1.99) == 0.0).all()
        assert (gait.rates(2.01) != 0.0).any()
    assert (_table(start=2.0).targets(1.0) == _table().targets(0.0)).all()


# --------------------------------------------------------------------------- pronk


@pytest.mark.parametrize(
    ("options", "corners"),
    [
        ({}, {0.0: 0.0, 1.2: -60.0, 2.1: -30.0, 3.0: 0.0, 3.6: -30.0}),
        ({"stroke": "slow_time"}, {0.0: 0.0, 1.8: -60.0, 2.4: -30.0, 3.0: 0.0}),
        ({"begins": "front"}, {0.0: -60.0, 0.9: -30.0, 1.8: 0.0, 3.0: -60.0}),
        ({"profile": "smooth"}, {0.0: 0.0, 0.4: -15.0, 0.6: -30.0, 1.2: -60.0, 3.0: 0.0}),
    ],
)
def test_figure_8b_by_hand(options: Any, corners: dict[float, float]) -> None:
    gait = GaitPronk(*PRONK, **options)
    for time, angle in corners.items():
        assert gait.targets(time) == pytest.approx(angle * DEG, abs=ROUND), time


@pytest.mark.parametrize("profile", ["linear", "smooth"])
def test_a_pronk_stays_within_its_swing_and_all_legs_agree(profile: Any) -> None:
    angles = _sampled(GaitPronk(*PRONK, profile=profile), np.linspace(0.0, 9.0, 2001))
    assert (angles == angles[:, :1]).all()
    assert angles.min() >= -60 * DEG - ROUND
    assert angles.max() <= ROUND


# --------------------------------------------------------------------------- pairs


def test_pairs_push_one_after_the_other() -> None:
    gait = GaitPairs(start=0.2, rounds=2, down_time=0.4, hold_time=0.2, up_time=0.6)
    for number, pair in enumerate(([0, 1], [2, 3], [4, 5])):
        for turn in range(2):
            begin = 0.2 + 0.8 * number + 2.4 * turn
            for since, angle in {
                0.0: 180, 0.2: 90, 0.4: 0, 0.5: 0, 0.6: 0, 0.9: 90, 1.2: 180, 1.3: 180,
            }.items():  # fmt: skip
                legs = gait.targets(begin + since)[pair]
                assert legs == pytest.approx(angle * DEG, abs=ROUND), (number, turn, since)
    assert gait.end == pytest.approx(0.2 + 2.4 + 1.6 + 1.2, rel=1e-15)
    assert gait.targets(100.0) == pytest.approx(math.pi, abs=ROUND)
    # While the front pair is down the others have not moved.
    assert (gait.targets(0.7)[2:] == math.pi).all()


def test_pairs_in_another_order_and_round_the_other_way() -> None:
    gait = GaitPairs(order=("back", "front"), push_angle=2.0 * math.pi, returns="onward")
    assert gait.targets(0.25) == pytest.approx([math.pi] * 4 + [1.5 * math.pi] * 2, abs=ROUND)
    assert gait.targets(0.55)[4:] == pytest.approx(2.0 * math.pi, abs=ROUND)
    last = [3.0 * math.pi] * 2 + [math.pi] * 2 + [3.0 * math.pi] * 2
    assert gait.targets(gait.end + 1.0) == pytest.approx(last, abs=ROUND)


# --------------------------------------------------------------------------- tables


def test_a_table_of_legs_by_hand() -> None:
    gait = _table()
    assert gait.period == 2.0
    assert gait.targets(0.25) / DEG == pytest.approx([180, 10, 10, 180, 22.5, 10], abs=1e-10)
    assert gait.targets(1.3) / DEG == pytest.approx([360, 10, 10, 360, 45, 10], abs=1e-10)
    assert gait.rates(1.3) / DEG == pytest.approx([0, 0, 0, 0, -150, 0], abs=1e-10)
    assert gait.targets(9.0) / DEG == pytest.approx([360, 10, 10, 360, 0, 10], abs=1e-10)
    again = _table(repeat=True)
    assert again.targets(4.25) / DEG == pytest.approx([900, 10, 10, 900, 22.5, 10], abs=1e-10)


def move(
    legs: str, *points: tuple[float, float], start: float | None = None, turn: float | None = None
) -> Move:
    """A move by digits, degrees and seconds."""
    turned = None if turn is None else turn * DEG
    return Move.of_legs(legs, [(t, a * DEG) for t, a in points], start=start, turn=turned)


def test_moves_begin_by_time_or_by_turn_and_in_their_order() -> None:
    gait = GaitSensed(
        (
            move("34", (0, 180), (1, 0), start=0.5),
            move("34", (0, 0), (2, -200), turn=90),
            move("1256", (0, 180), (1, 90), turn=120),
        )
    )
    begun = gait.nothing_begun()
    assert gait.targets(7.0) / DEG == pytest.approx([180] * 6)
    # Time, turn, and then: angles of legs 3 and 1, their rates.
    for time, turn, third, first, fast, slow in (
        (0.0, 0.0, 180.0, 180.0, 0.0, 0.0),
        (1.0, 130.0, 90.0, 180.0, -180.0, 90.0 * -1.0),  # 1256 begins now; 34 is not free yet
        (1.25, 10.0, 45.0, 157.5, -180.0, -90.0),
        (1.6, 10.0, 0.0, 126.0, 0.0, -90.0),  # not turned far enough any more
        (1.75, 95.0, 0.0, 112.5, -100.0, -90.0),
        (2.25, 0.0, -50.0, 90.0, -100.0, 0.0),
        (9.0, 0.0, -200.0, 90.0, 0.0, 0.0),
    ):
        gait.sense(time, turn * DEG, begun)
        angles, rates = gait.targets(time, begun) / DEG, gait.rates(time, begun) / DEG
        assert angles == pytest.approx([first, first, third, third, first, first], abs=1e-9)
        assert rates == pytest.approx([slow, slow, fast, fast, slow, slow], abs=1e-9)
    assert list(begun) == [0.5, 1.75, 1.0]


def test_arrays_cannot_be_spoiled() -> None:
    gait = _table()
    for time in (0.0, 9.0):
        gait.targets(time)[:] = 7.0
    assert gait.targets(0.0)[1] == pytest.approx(10 * DEG)
    with pytest.raises(ValueError, match="read-only"):
        gait.angles[0, 0] = 1.0


# --------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: TwoPhaseClock(0.0, 0.0, 3.0, 1.0), "extent must lie between 0 and 360 deg"),
        (lambda: TwoPhaseClock(7.0, 0.0, 3.0, 1.0), "got 401.07 deg"),
        (lambda: TwoPhaseClock(math.nan, 0.0, 3.0, 1.0), "extent"),
        (lambda: TwoPhaseClock(1.0, math.inf, 3.0, 1.0), "centre must be finite"),
        (lambda: TwoPhaseClock(1.0, 0.0, 3.0, 3.0), "slow_time must lie between 0 and the period"),
        (lambda: TwoPhaseClock(1.0, 0.0, 3.0, 0.0), "got 0 s"),
        (lambda: TwoPhaseClock(1.0, 0.0, -3.0, 1.0), "period must be finite and > 0"),
        (lambda: GaitWalk.tripod(*PAPER, turn_time=1.2), "slow_time .*got 0 s.*turn_time"),
        (lambda: GaitWalk.tripod(*PAPER, turn_centre=math.nan), "turn_centre must be finite"),
        (lambda: GaitWalk.tripod(*PAPER, lead="top"), "lead must be one of left, right, got top"),
        (lambda: GaitWalk.tripod(*PAPER, direction=0), "directions must be two of 1 and -1"),
        (lambda: GaitWalk.tripod(*PAPER, start=math.inf), "start must be finite"),
        (lambda: GaitWalk.spot_turn(*PAPER, phases=(0.0, 1.0)), "phases must be six numbers"),
        (lambda: GaitWalk.spot_turn(*PAPER, towards="up"), "towards must be one of"),
        (
            lambda: GaitWalk(TwoPhaseClock(*PAPER), TwoPhaseClock(1.0, 0.0, 2.0, 1.0)),
            "one period, got 3 s on the left and 2 s on the right",
        ),
        (lambda: GaitPronk(-1.0, 0.0, 3.0, 1.2), "extent"),
        (lambda: GaitPronk(1.0, 0.0, 3.0, 4.0), "slow_time"),
        (lambda: GaitPronk(*PRONK, stroke="push"), "stroke must be one of rest, slow_time"),
        (lambda: GaitPairs(interval=0.0), "interval must be finite and > 0"),
        (lambda: GaitPairs(hold_time=-1.0), "hold_time must be finite and >= 0, got -1 s"),
        (lambda: GaitPairs(order=("front", "front")), "order must name different ones"),
        (lambda: GaitPairs(order=()), "order"),
        (lambda: GaitPairs(rounds=0), "rounds must be at least 1"),
        (lambda: GaitPairs(push_angle=math.pi), "must differ by less than a turn"),
        (lambda: GaitPairs(rounds=2, hold_time=2.0), "moves for 3 s.*begins after 2.4 s"),
        (lambda: GaitTable(np.zeros(1), np.zeros((1, 6))), "at least two times"),
        (lambda: GaitTable(np.array([0.0, 1.0]), np.zeros((2, 5))), r"got \(2, 5\)"),
        (lambda: GaitTable(np.array([0.0, 0.0]), np.zeros((2, 6))), "ascend from 0"),
        (lambda: GaitTable(np.array([1.0, 2.0]), np.zeros((2, 6))), "ascend from 0"),
        (
            lambda: GaitTable.of_legs(
                {"123456": [(0.0, 0.0), (1.0, 90 * DEG)]}, repeat=True
            ),
            "leg 1 begins at 0 deg and ends at 90 deg",
        ),
        (lambda: GaitTable.of_legs({"12": [(0.0, 0.0)]}), "leaves out legs 3, 4, 5, 6"),
        (lambda: GaitTable.of_legs({"17": [(0.0, 0.0)]}), "named by digits"),
        (lambda: GaitTable.of_legs({"11": [(0.0, 0.0)]}), "leg 1 is named twice"),
        (lambda: GaitTable.of_legs({"1": []}), "need pairs"),
        (lambda: GaitTable.of_legs({"123456": [(0.0, 0.0)]}), "no leg of the table moves"),
        (lambda: GaitHold(math.nan), "angle must be finite"),
        (lambda: GaitSensed((move("12", (0, 0), start=0.0),)), "no move names legs 3, 4, 5, 6"),
        (
            lambda: GaitSensed(
                (
                    move("123456", (0, 180), (1, 90), start=0.0),
                    move("3", (0, 180), (1, 0), turn=90.0),
                )
            ),
            "leg 3 ends a move at 90 deg and begins the next one at 180 deg",
        ),
        (lambda: move("12", (0, 0)), "either at a time or at a turn"),
        (lambda: move("12", (0, 0), start=1.0, turn=1.0), "either at a time or at a turn"),
        (lambda: move("12", (1, 0), start=1.0), "ascend from 0"),
        (lambda: move("78", (0, 0), start=1.0), "named by digits"),
        (lambda: move("33", (0, 0), start=1.0), "names one of legs 33 twice"),
        (lambda: move("34", (0, 0), turn=-1.0), "turn of a move of legs 34 must be >= 0"),
        (lambda: move("34", (0, 0), start=-1.0), "start of a move of legs 34 must be >= 0"),
    ],
)  # fmt: skip
def test_what_is_refused(make: Callable[[], Any], text: str) -> None:
    with pytest.raises(InputError, match=text) as caught:
        make()
    assert caught.value.where == "gait"
