"""Which coils are on at which time: travelling patterns, open-loop PWM, and tables of times.

Nothing here knows the robot's state: the drive is open-loop, as in Y. Sugiyama, S. Hirai, Crawling
and jumping of deformable soft robot, Proc. IEEE/RSJ Int. Conf. Intelligent Robots and Systems
(2004), figures 3 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import InputError, check_positive

RING = "ABCDEFGH"
LETTERS = RING + "I"  # I joins two points of the shell and takes no part in a pattern

# Times closer than this part of a period are one event: a switch that is due where a period ends.
_SAME = 1e-9
_MOST_EVENTS = 10_000_000  # a typing error in a period should not fill the memory


@dataclass(frozen=True)
class Actuation:
    """On and off over time, as rows of states.

    Attributes
    ----------
    letters
        Names of the coils, shape (C,).
    times
        Start of each row [s], ascending from 0, shape (E,). The last row holds for ever.
    states
        Which coils are on, shape (E, C) bool.
    """

    letters: tuple[str, ...]
    times: np.ndarray
    states: np.ndarray

    def __post_init__(self) -> None:
        letters = _letters("letters", self.letters)
        times = np.array(self.times, dtype=float)
        states = np.array(self.states, dtype=bool)
        if times.ndim != 1 or states.shape != (times.size, len(letters)):
            raise InputError(
                f"states must have a row per time and a column per letter, ({times.size}, "
                f"{len(letters)}), got {states.shape}",
                "actuation",
            )
        if times.size == 0 or times[0] != 0.0:
            raise InputError(
                f"times must begin with 0, got {times[:1].tolist()}: say what is on at the start",
                "actuation",
            )
        if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
            raise InputError("times must be finite and ascending", "actuation")
        times.flags.writeable = False
        states.flags.writeable = False
        object.__setattr__(self, "letters", letters)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "states", states)

    def on(self, time: float) -> np.ndarray:
        """Which coils are on at `time` >= 0 [s], shape (C,) bool; at a switch, those after it."""
        if not time >= 0.0:
            raise InputError(f"time must be >= 0, got {time:g} s", "actuation")
        row = int(np.searchsorted(self.times, time, side="right")) - 1
        return np.asarray(self.states[row])

    def on_time(self, end: float) -> np.ndarray:
        """Time each coil is on until `end` [s], shape (C,) [s]."""
        lengths = np.diff(np.minimum(np.append(self.times, np.inf), end))
        return np.asarray(lengths @ self.states)

    @classmethod
    def pattern(
        cls,
        letters: str | Sequence[str] = RING,
        first: str | Sequence[str] = "BF",
        *,
        interval: float,
        duration: float,
        direction: int = 1,
        duty: float = 1.0,
        pwm_period: float | None = None,
    ) -> Actuation:
        """Let a pattern travel round the ring, one coil per interval; all are off at the end.

        Parameters
        ----------
        letters
            The coils there are: the ring A to H, which a pattern travels in that order, and I,
            which stays off, or not.
        first
            Those on during the first interval, for example "BF".
        interval
            [s] > 0 from one step to the next.
        duration
            [s] > `interval`; the last step may be cut short.
        direction
            1: B is followed by C; -1: by A.
        duty
            Share of each PWM period, from its beginning, that the coils of the step are on, in
            (0, 1]. The source uses PWM but does not say of what share; 1 is the full voltage.
        pwm_period
            [s] > 0; needed if `duty` < 1. Periods count from the start, through the steps, as
            those of one clock for all coils.
        """
        names = _letters("letters", letters, "pattern.letters")
        strange = [name for name in names if name not in LETTERS]
        missing = [name for name in RING if name not in names]
        if strange or missing:
            raise InputError(
                f"letters must be A to H, with or without I; got {', '.join(names)}",
                "pattern.letters",
            )
        start = _letters("first", first, "pattern.first")
        if not start:
            raise InputError(
                "first is empty: name the coils of the first step, such as BF", "pattern.first"
            )
        unknown = [name for name in start if name not in RING]
        if unknown:
            raise InputError(
                f"it names {', '.join(unknown)}, which cannot move on: only A to H do",
                "pattern.first",
            )
        if len(start) == len(RING):
            raise InputError(
                "it names all eight coils, so no step would differ from the last: leave some out",
                "pattern.first",
            )
        check_positive("interval", interval, "s", "pattern.interval")
        check_positive("duration", duration, "s", "pattern.duration")
        if interval >= duration:
            raise InputError(
                f"interval must be shorter than duration, got {interval:g} s and {duration:g} s: "
                "the pattern would never move on",
                "pattern.interval",
            )
        if direction not in (1, -1):
            raise InputError(f"direction must be 1 or -1, got {direction}", "pattern.direction")
        if not 0.0 < duty <= 1.0:
            raise InputError(f"duty must lie in (0, 1], got {duty:g}", "pattern.duty")
        if duty < 1.0 and pwm_period is None:
            raise InputError(
                f"pwm_period must be given with a duty below 1, got duty {duty:g}",
                "pattern.pwm_period",
            )
        if pwm_period is not None:
            check_positive("pwm_period", pwm_period, "s", "pattern.pwm_period")

        step_count = _count(duration, interval, "pattern.interval")
        edges = {n * interval for n in range(step_count)}
        if duty < 1.0 and pwm_period is not None:
            periods = _count(duration, pwm_period, "pattern.pwm_period")
            edges |= {n * pwm_period for n in range(periods)}
            edges |= {(n + duty) * pwm_period for n in range(periods)}
            shortest = min(interval, duty * pwm_period, (1.0 - duty) * pwm_period)
        else:
            pwm_period, shortest = None, interval
        times = _merged((t for t in edges if t < duration), _SAME * shortest)
        times = [t for t in times if t < duration - _SAME * shortest]

        column = {name: names.index(name) for name in RING}
        states = np.zeros((len(times) + 1, len(names)), dtype=bool)
        for row, (begin, end) in enumerate(zip(times, [*times[1:], duration], strict=True)):
            # Read in the middle, where no round-off of an edge matters.
            middle = 0.5 * (begin + end)
            if pwm_period is not None and math.fmod(middle, pwm_period) >= duty * pwm_period:
                continue
            shift = direction * math.floor(middle / interval)
            for name in start:
                states[row, column[RING[(RING.index(name) + shift) % len(RING)]]] = True
        return cls(names, np.array([*times, duration]), states)._joined()

    @classmethod
    def table(
        cls,
        letters: str | Sequence[str],
        on_times: Mapping[str, Sequence[tuple[float, float]]],
        duration: float,
    ) -> Actuation:
        """Switch each coil on and off at times of its own; all are off from `duration` on.

        Parameters
        ----------
        letters
            The coils there are.
        on_times
            Of each letter the pairs (on, off) [s], in order of time; a letter that is not named
            stays off.
        duration
            [s] > 0; nothing may be on for longer.
        """
        names = _letters("letters", letters, "table.letters")
        check_positive("duration", duration, "s", "table.duration")
        edges = {0.0}
        for name, pairs in on_times.items():
            where = f"table.{name}"
            if name not in names:
                raise InputError(f"no coil is called {name}: there are {', '.join(names)}", where)
            before = 0.0
            for pair in pairs:
                if len(pair) != 2:
                    raise InputError(f"on-times are pairs (on, off) in s, got {pair}", where)
                begin, end = pair
                if not (math.isfinite(begin) and math.isfinite(end) and begin >= 0.0):
                    raise InputError(
                        f"on and off must be finite and >= 0, got {begin:g} s and {end:g} s", where
                    )
                if not begin < end:
                    raise InputError(
                        f"off must come after on, got on at {begin:g} s and off at {end:g} s", where
                    )
                if begin < before:
                    raise InputError(
                        f"on-times must follow each other without overlap, got on at {begin:g} s "
                        f"before off at {before:g} s",
                        where,
                    )
                if end > duration:
                    raise InputError(
                        f"off at {end:g} s lies after the duration of {duration:g} s", where
                    )
                before = end
                edges |= {begin, end}
        times = np.array(sorted(edges))
        states = np.zeros((times.size, len(names)), dtype=bool)
        for name, pairs in on_times.items():
            for begin, end in pairs:
                states[(times >= begin) & (times < end), names.index(name)] = True
        return cls(names, times, states)._joined()

    def _joined(self) -> Actuation:
        """Drop rows that repeat the one before."""
        keep = np.ones(self.times.size, dtype=bool)
        keep[1:] = (self.states[1:] != self.states[:-1]).any(axis=1)
        return Actuation(self.letters, self.times[keep], self.states[keep])


def _letters(key: str, letters: Iterable[str], where: str = "actuation") -> tuple[str, ...]:
    names = tuple(letters)
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InputError(f"{key} repeats {', '.join(double)}: name each coil once", where)
    return names


def _count(duration: float, period: float, where: str) -> int:
    """Periods that begin before `duration`."""
    count = math.ceil(duration / period * (1.0 - 1e-12))
    if count > _MOST_EVENTS:
        raise InputError(
            f"{period:g} s is too short for a duration of {duration:g} s: {count} periods, at most "
            f"{_MOST_EVENTS} are allowed",
            where,
        )
    return count


def _merged(times: Iterable[float], apart: float) -> list[float]:
    """Ascending times, one of each group closer than `apart`."""
    merged: list[float] = []
    for time in sorted(times):
        if not merged or time - merged[-1] > apart:
            merged.append(time)
    return merged
