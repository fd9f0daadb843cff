"""Gaits of a six-legged robot: the angle each leg shall have, as a function of time alone.

Gaits by numbers, the last of which may also feel how far the robot has rolled, are in
`dynamics.gait_tables`.

Convention. A leg's angle theta [rad] is measured from the vertical: 0 points straight down, pi
straight up. Positive is the sense of walking forward (+x): the foot comes down in front
(theta < 0), passes below (0) and goes to the back (theta > 0); it is a right-handed turn about
+y. Angles are not wrapped: the target of a walking leg grows by 2 pi per period, so that it is
continuous. Legs are numbered 1 to 6, odd on the left, even on the right; {1, 2} is the front
pair, {3, 4} the middle, {5, 6} the back one. Arrays have shape (6,) in this order. That servos
of the two sides are mounted as mirror images is the servos' business.

Every gait answers `targets(time)` [rad] and `rates(time)` [rad/s], its derivative, at a corner
that of the time after it. Before `start` the legs are held where the gait begins; after `end`
(infinite for most) they are held where it ended. No target ever jumps.

Source: the control vector {theta_s, theta_0, t_c, t_s} of the soft hexapod SoSpider, section 2.4,
figures 7 and 8, which follows U. Saranli, M. Buehler, D. E. Koditschek, RHex: a simple and highly
mobile hexapod robot, Int. J. Robotics Research 20 (2001) 616-631, doi:10.1177/02783640122067570.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from flexapod.core.errors import InputError, check_finite, check_positive

LEG_COUNT = 6
TURN = 2.0 * math.pi
PAIRS: dict[str, tuple[int, int]] = {"front": (1, 2), "middle": (3, 4), "back": (5, 6)}
# Phases [periods] of the tripods: {1, 4, 5} has two legs on the left, {2, 3, 6} on the right.
TRIPODS = {
    "left": (0.0, 0.5, 0.5, 0.0, 0.0, 0.5),
    "right": (0.5, 0.0, 0.0, 0.5, 0.5, 0.0),
}
WHERE = "gait"  # what is wrong, in errors

Lead = Literal["left", "right"]
Reversal = Literal["mirrored", "same"]


class Gait(Protocol):
    """What moves the legs: every class of this module but the clock of a single leg."""

    @property
    def period(self) -> float:
        """Time after which the legs are where they were, up to whole turns [s]."""
        ...

    @property
    def end(self) -> float:
        """Time after which no leg moves any more [s], infinite if there is none."""
        ...

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        ...

    def rates(self, time: float) -> np.ndarray:
        """Their derivative, at a corner that of the time after it [rad/s], shape (6,)."""
        ...


def _check_extent(extent: float) -> None:
    if not 0.0 < extent < TURN:
        raise InputError(
            f"extent must lie between 0 and 360 deg, got {math.degrees(extent):g} deg: it is the "
            "part of the turn that takes slow_time",
            WHERE,
        )


def _check_times(period: float, slow_time: float) -> None:
    check_positive("period", period, "s", WHERE)
    if not 0.0 < slow_time < period:
        raise InputError(
            f"slow_time must lie between 0 and the period of {period:g} s, got {slow_time:g} s: "
            "shorten it, or turn_time if the gait turns",
            WHERE,
        )


def _check_choice(name: str, value: object, known: Sequence[object]) -> None:
    if value not in known:
        raise InputError(f"{name} must be one of {', '.join(map(str, known))}, got {value}", WHERE)


@dataclass(frozen=True)
class TwoPhaseClock:
    """Angle of one leg that turns at two speeds: {theta_s, theta_0, t_c, t_s}.

    The slow phase, with the foot on the ground, turns through `extent` about `centre` in
    `slow_time`; the rest of the turn takes the rest of the period. Phase time 0 is the middle of
    the slow phase, where the angle is `centre`: the paper's own zero is not said, and so a
    change of centre or slow time does not move the legs' steps against each other.

    Attributes
    ----------
    extent
        theta_s [rad], in (0, 2 pi).
    centre
        theta_0 [rad].
    period
        t_c [s] > 0.
    slow_time
        t_s [s], in (0, period).
    """

    extent: float
    centre: float
    period: float
    slow_time: float

    def __post_init__(self) -> None:
        _check_extent(self.extent)
        check_finite("centre", self.centre, "rad", WHERE)
        _check_times(self.period, self.slow_time)

    @property
    def slow_rate(self) -> float:
        """Speed in the slow phase [rad/s]."""
        return self.extent / self.slow_time

    @property
    def fast_rate(self) -> float:
        """Speed in the rest of the turn [rad/s]."""
        return (TURN - self.extent) / (self.period - self.slow_time)

    def _place(self, phase_time: float) -> tuple[int, float]:
        """Whole turns done, and time since the slow phase began [s]."""
        since = phase_time + 0.5 * self.slow_time
        turns = math.floor(since / self.period)
        return turns, since - turns * self.period

    def angle(self, phase_time: float) -> float:
        """Angle at a phase time [s], not wrapped [rad]."""
        turns, since = self._place(phase_time)
        if since < self.slow_time:
            way = since * self.slow_rate
        else:
            way = self.extent + (since - self.slow_time) * self.fast_rate
        return self.centre - 0.5 * self.extent + TURN * turns + way

    def rate(self, phase_time: float) -> float:
        """Derivative of `angle`, at a corner that of the time after it [rad/s]."""
        _, since = self._place(phase_time)
        return self.slow_rate if since < self.slow_time else self.fast_rate

    def phase_time(self, angle: float) -> float:
        """Phase time at which the clock shows an angle that is not wrapped [s]."""
        way = angle - (self.centre - 0.5 * self.extent)
        turns = math.floor(way / TURN)
        way -= turns * TURN
        if way < self.extent:
            since = way / self.slow_rate
        else:
            since = self.slow_time + (way - self.extent) / self.fast_rate
        return turns * self.period + since - 0.5 * self.slow_time


@dataclass(frozen=True)
class GaitWalk:
    """Legs that turn round and round, each side by its own clock.

    All legs wait at `start_angle` until their clocks pass it, and then follow them; the first
    does so at `start`. So targets are continuous from the first moment and never faster than a
    clock. The paper's legs begin at 180 deg; how they come into step is not said.

    Attributes
    ----------
    left, right
        Clocks of the sides, of the same period.
    phases
        How much later than that of phase 0 each leg's clock runs [periods], shape (6,).
    directions
        Of the left and the right side: 1 forward, -1 backward.
    reversal
        What a side that turns backward does. "mirrored" (default): its angle is that of the
        clock with the other sign, so that legs which are mirror images, front and back, push
        alike; the slow phase lies about -centre. "same": the slow phase stays where it is and is
        swept the other way. The paper says only that the sides turn in opposite directions.
    start_angle
        [rad], where all legs begin.
    start
        [s], when the first leg begins.
    """

    left: TwoPhaseClock
    right: TwoPhaseClock
    phases: tuple[float, ...] = TRIPODS["left"]
    directions: tuple[int, int] = (1, 1)
    reversal: Reversal = "mirrored"
    start_angle: float = math.pi
    start: float = 0.0
    # Of each leg: when it begins [s], and the phase time its clock then has [s].
    begins: tuple[float, ...] = field(init=False, repr=False, compare=False)
    _passes: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.left.period != self.right.period:
            raise InputError(
                f"the sides must have one period, got {self.left.period:g} s on the left and "
                f"{self.right.period:g} s on the right: they would fall out of step",
                WHERE,
            )
        if len(self.phases) != LEG_COUNT or not all(0.0 <= phase < 1.0 for phase in self.phases):
            raise InputError(
                f"phases must be six numbers >= 0 and < 1, one per leg in periods, got "
                f"{list(self.phases)}",
                WHERE,
            )
        if len(self.directions) != 2 or any(way not in (1, -1) for way in self.directions):
            raise InputError(
                f"directions must be two of 1 and -1, left and right, got {self.directions}", WHERE
            )
        _check_choice("reversal", self.reversal, ("mirrored", "same"))
        check_finite("start_angle", self.start_angle, "rad", WHERE)
        check_finite("start", self.start, "s", WHERE)
        period = self.period
        sides = [self._pass_time(side) for side in range(2)]
        # Sides that pass the start angle at nearly the same time are not a period apart.
        if abs(sides[1] - sides[0]) > 0.5 * period:
            sides[int(sides[1] < sides[0])] += period
        passes = [sides[leg % 2] for leg in range(LEG_COUNT)]
        begins = [phase * period + at for phase, at in zip(self.phases, passes, strict=True)]
        first = min(begins)
        object.__setattr__(self, "_passes", tuple(passes))
        object.__setattr__(self, "begins", tuple(self.start + (at - first) for at in begins))

    def _pass_time(self, side: int) -> float:
        """Phase time in [0, period) at which a side's legs pass the start angle [s]."""
        clock = (self.left, self.right)[side]
        angle = self.start_angle
        if self.directions[side] < 0:
            angle = -angle if self.reversal == "mirrored" else 2.0 * clock.centre - angle
        time = clock.phase_time(angle)
        return time - math.floor(time / clock.period) * clock.period

    @classmethod
    def tripod(
        cls,
        extent: float,
        centre: float,
        period: float,
        slow_time: float,
        *,
        turn_centre: float = 0.0,
        turn_time: float = 0.0,
        direction: int = 1,
        lead: Lead = "left",
        start_angle: float = math.pi,
        start: float = 0.0,
    ) -> GaitWalk:
        """Tripods {1, 4, 5} and {2, 3, 6}, half a period apart.

        Parameters
        ----------
        extent, centre, period, slow_time
            See `TwoPhaseClock` [rad, rad, s, s].
        turn_centre, turn_time
            Added to `centre` [rad] and `slow_time` [s] on the left and taken off on the right.
        direction
            1 walks forward, -1 backward.
        lead
            Which tripod begins: {1, 4, 5}, with two legs on the left (default; not said in the
            paper), or {2, 3, 6}, on the right.
        start_angle, start
            See `GaitWalk` [rad, s].
        """
        _check_choice("lead", lead, tuple(TRIPODS))
        left, right = _turning(extent, centre, period, slow_time, turn_centre, turn_time)
        return cls(
            left,
            right,
            TRIPODS[lead],
            (direction, direction),
            start_angle=start_angle,
            start=start,
        )

    @classmethod
    def together(
        cls,
        extent: float,
        centre: float,
        period: float,
        slow_time: float,
        *,
        turn_centre: float = 0.0,
        turn_time: float = 0.0,
        direction: int = 1,
        start_angle: float = math.pi,
        start: float = 0.0,
    ) -> GaitWalk:
        """All six legs in step, as in the paper's climb; parameters as those of `tripod`."""
        left, right = _turning(extent, centre, period, slow_time, turn_centre, turn_time)
        return cls(
            left,
            right,
            (0.0,) * LEG_COUNT,
            (direction, direction),
            start_angle=start_angle,
            start=start,
        )

    @classmethod
    def spot_turn(
        cls,
        extent: float,
        centre: float,
        period: float,
        slow_time: float,
        *,
        towards: Literal["left", "right"] = "left",
        phases: Sequence[float] = TRIPODS["left"],
        reversal: Reversal = "mirrored",
        start_angle: float = math.pi,
        start: float = 0.0,
    ) -> GaitWalk:
        """The sides turn in opposite directions, in tripods unless `phases` say otherwise.

        `towards` is the way the robot shall turn: to the left, the left legs walk backward.
        The other parameters are those of `GaitWalk`.
        """
        _check_choice("towards", towards, ("left", "right"))
        clock = TwoPhaseClock(extent, centre, period, slow_time)
        directions = (-1, 1) if towards == "left" else (1, -1)
        return cls(clock, clock, tuple(phases), directions, reversal, start_angle, start)

    @property
    def period(self) -> float:
        """t_c [s]."""
        return self.left.period

    @property
    def end(self) -> float:
        """Infinite: it walks on."""
        return math.inf

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        result = np.empty(LEG_COUNT)
        for leg in range(LEG_COUNT):
            side = leg % 2
            angle, since = self.start_angle, time - self.begins[leg]
            if since > 0.0:
                clock, at = (self.left, self.right)[side], self._passes[leg]
                angle += self.directions[side] * (clock.angle(at + since) - clock.angle(at))
            result[leg] = angle
        return result

    def rates(self, time: float) -> np.ndarray:
        """Derivative of `targets` [rad/s], shape (6,)."""
        result = np.zeros(LEG_COUNT)
        for leg in range(LEG_COUNT):
            since = time - self.begins[leg]
            if since >= 0.0:
                clock = (self.left, self.right)[leg % 2]
                result[leg] = self.directions[leg % 2] * clock.rate(self._passes[leg] + since)
        return result


def _turning(
    extent: float,
    centre: float,
    period: float,
    slow_time: float,
    turn_centre: float,
    turn_time: float,
) -> tuple[TwoPhaseClock, TwoPhaseClock]:
    """Clocks of the left and the right side, the offsets added on the left."""
    check_finite("turn_centre", turn_centre, "rad", WHERE)
    check_finite("turn_time", turn_time, "s", WHERE)
    return (
        TwoPhaseClock(extent, centre + turn_centre, period, slow_time + turn_time),
        TwoPhaseClock(extent, centre - turn_centre, period, slow_time - turn_time),
    )


@dataclass(frozen=True)
class GaitPronk:
    """All six legs swing together, between centre - extent/2 (front) and centre + extent/2 (back).

    Attributes
    ----------
    extent
        theta_s [rad], in (0, 2 pi).
    centre
        theta_0 [rad].
    period
        t_c [s] > 0.
    slow_time
        t_s [s], in (0, period).
    stroke
        What takes `slow_time`. "rest" (default): the way through the air from the back to the
        front, the push takes the rest of the period, as the paper calls t_s the time from aerial
        to touchdown. "slow_time": the push from the front to the back, as t_s is while walking.
    profile
        "linear" (default, as the paper draws it), or "smooth": half a cosine per stroke, at rest
        at both ends, whose largest speed is pi/2 times the mean.
    begins
        Where the legs wait and begin: at the "back" (default), which with the paper's 60 and
        -30 deg is straight down, so that the robot stands before it jumps; or at the "front".
    start
        [s], when they begin.
    """

    extent: float
    centre: float
    period: float
    slow_time: float
    stroke: Literal["rest", "slow_time"] = "rest"
    profile: Literal["linear", "smooth"] = "linear"
    begins: Literal["back", "front"] = "back"
    start: float = 0.0

    def __post_init__(self) -> None:
        _check_extent(self.extent)
        check_finite("centre", self.centre, "rad", WHERE)
        _check_times(self.period, self.slow_time)
        _check_choice("stroke", self.stroke, ("rest", "slow_time"))
        _check_choice("profile", self.profile, ("linear", "smooth"))
        _check_choice("begins", self.begins, ("back", "front"))
        check_finite("start", self.start, "s", WHERE)

    @property
    def end(self) -> float:
        """Infinite: it goes on."""
        return math.inf

    @property
    def push_time(self) -> float:
        """Time from the front to the back [s]."""
        return self.slow_time if self.stroke == "slow_time" else self.period - self.slow_time

    @property
    def return_time(self) -> float:
        """Time through the air, from the back to the front [s]."""
        return self.slow_time if self.stroke == "rest" else self.period - self.slow_time

    def _stroke(self, time: float) -> tuple[float, float, float]:
        """Share of the present stroke that is over, its time [s], its way with sign [rad]."""
        since = time - self.start
        since -= math.floor(since / self.period) * self.period
        pushes = self.begins == "front"
        first = self.push_time if pushes else self.return_time
        if since >= first:
            since -= first
            pushes = not pushes
        whole = self.push_time if pushes else self.return_time
        return since / whole, whole, self.extent if pushes else -self.extent

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        share, _, way = self._stroke(max(time, self.start))
        if self.profile == "smooth":
            share = 0.5 * (1.0 - math.cos(math.pi * share))
        return np.full(LEG_COUNT, self.centre + (share - 0.5) * way)

    def rates(self, time: float) -> np.ndarray:
        """Derivative of `targets` [rad/s], shape (6,)."""
        if time < self.start:
            return np.zeros(LEG_COUNT)
        share, whole, way = self._stroke(time)
        rate = way / whole
        if self.profile == "smooth":
            rate *= 0.5 * math.pi * math.sin(math.pi * share)
        return np.full(LEG_COUNT, rate)


@dataclass(frozen=True)
class GaitPairs:
    """Pair after pair pushes once, to roll a body curled into a wheel (section 4.3).

    A pair turns from `rest_angle` to `push_angle`, stays there and returns; the next begins
    `interval` after it began. The rest of the time the legs stay at `rest_angle`. Times but the
    interval are assumed, as the paper gives none: servos of this torque take about half a second
    for half a turn.

    Attributes
    ----------
    interval
        From the beginning of one pair to that of the next [s] > 0.
    down_time, hold_time, up_time
        Of the way out [s] > 0, of the stay [s] >= 0, and of the way back [s] > 0.
    order
        One to three different ones of "front", "middle" and "back". Assumed from the front.
    start
        [s], when the first pair begins.
    rounds
        How often all pairs push; a round begins `interval` after the last pair of the one before.
    rest_angle, push_angle
        [rad], less than a turn apart. The way is the straight one, so a `push_angle` of 0 passes
        behind the robot's hip and one of 2 pi in front of it.
    returns
        "back" (default): the way it came; "onward": the rest of the turn, in the same sense.
    """

    interval: float = 0.8
    down_time: float = 0.5
    hold_time: float = 0.1
    up_time: float = 0.5
    order: tuple[str, ...] = ("front", "middle", "back")
    start: float = 0.0
    rounds: int = 1
    rest_angle: float = math.pi
    push_angle: float = 0.0
    returns: Literal["back", "onward"] = "back"

    def __post_init__(self) -> None:
        check_positive("interval", self.interval, "s", WHERE)
        check_positive("down_time", self.down_time, "s", WHERE)
        check_positive("up_time", self.up_time, "s", WHERE)
        if not (math.isfinite(self.hold_time) and self.hold_time >= 0.0):
            raise InputError(f"hold_time must be finite and >= 0, got {self.hold_time:g} s", WHERE)
        unknown = [name for name in self.order if name not in PAIRS]
        if unknown or not self.order or len(set(self.order)) != len(self.order):
            raise InputError(
                f"order must name different ones of {', '.join(PAIRS)}, got {list(self.order)}",
                WHERE,
            )
        check_finite("start", self.start, "s", WHERE)
        if self.rounds < 1:
            raise InputError(
                f"rounds must be at least 1, got {self.rounds}: leave the legs be with a gait that "
                "holds them",
                WHERE,
            )
        check_finite("rest_angle", self.rest_angle, "rad", WHERE)
        check_finite("push_angle", self.push_angle, "rad", WHERE)
        if not 0.0 < abs(self.push_angle - self.rest_angle) < TURN:
            raise InputError(
                "rest_angle and push_angle must differ by less than a turn, got "
                f"{math.degrees(self.rest_angle):g} deg and {math.degrees(self.push_angle):g} deg",
                WHERE,
            )
        _check_choice("returns", self.returns, ("back", "onward"))
        if self.rounds > 1 and self.push_time > self.period:
            raise InputError(
                f"a pair moves for {self.push_time:g} s, but its next round begins after "
                f"{self.period:g} s: shorten down_time, hold_time or up_time, or lengthen interval",
                WHERE,
            )

    @property
    def push_time(self) -> float:
        """Time from a pair's leaving `rest_angle` until it is back [s]."""
        return self.down_time + self.hold_time + self.up_time

    @property
    def period(self) -> float:
        """Length of a round [s]."""
        return len(self.order) * self.interval

    @property
    def end(self) -> float:
        """When the last pair is back [s]."""
        last = (self.rounds - 1) * self.period + (len(self.order) - 1) * self.interval
        return self.start + last + self.push_time

    def _pair(self, since: float) -> tuple[float, float]:
        """Angle [rad] and rate [rad/s] of a pair, by the time since it first begins [s]."""
        way = self.push_angle - self.rest_angle
        if since < 0.0:
            return self.rest_angle, 0.0
        back = -way if self.returns == "back" else math.copysign(TURN, way) - way
        turn = min(math.floor(since / self.period), self.rounds - 1)
        since -= turn * self.period
        rest = self.rest_angle + turn * (way + back)
        if since < self.down_time:
            return rest + way * since / self.down_time, way / self.down_time
        since -= self.down_time
        if since < self.hold_time:
            return rest + way, 0.0
        since -= self.hold_time
        if since < self.up_time:
            return rest + way + back * since / self.up_time, back / self.up_time
        return rest + (way + back), 0.0

    def _legs(self, time: float, what: int, waiting: float) -> np.ndarray:
        result = np.full(LEG_COUNT, waiting)
        for place, name in enumerate(self.order):
            value = self._pair(time - self.start - place * self.interval)[what]
            for leg in PAIRS[name]:
                result[leg - 1] = value
        return result

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        return self._legs(time, 0, self.rest_angle)

    def rates(self, time: float) -> np.ndarray:
        """Derivative of `targets` [rad/s], shape (6,)."""
        return self._legs(time, 1, 0.0)


@dataclass(frozen=True)
class GaitHold:
    """All legs stay at one angle [rad]."""

    angle: float = math.pi

    def __post_init__(self) -> None:
        check_finite("angle", self.angle, "rad", WHERE)

    @property
    def period(self) -> float:
        """Infinite."""
        return math.inf

    @property
    def end(self) -> float:
        """0: nothing moves."""
        return 0.0

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        return np.full(LEG_COUNT, self.angle)

    def rates(self, time: float) -> np.ndarray:
        """Zeros [rad/s], shape (6,)."""
        return np.zeros(LEG_COUNT)


__all__ = [
    "LEG_COUNT",
    "PAIRS",
    "TRIPODS",
    "Gait",
    "GaitHold",
    "GaitPairs",
    "GaitPronk",
    "GaitWalk",
    "TwoPhaseClock",
]
