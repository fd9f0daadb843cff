"""Gaits by numbers: angles at given times, and moves that begin by time or by the robot's turn.

Legs, angles and signs are those of `dynamics.gait`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexapod.core.errors import InputError, check_finite
from flexapod.dynamics.gait import LEG_COUNT, TURN, WHERE

# A table's end may miss its beginning by the round-off of angles written in degrees [rad].
SAME_ANGLE = 1e-9


@dataclass(frozen=True)
class GaitTable:
    """Angles at given times, linear between them.

    Attributes
    ----------
    times
        [s] after `start`, ascending from 0, at least two, shape (N,).
    angles
        [rad], shape (N, 6).
    repeat
        Whether it begins anew at its last time; each leg must then end where it began, or whole
        turns on, and goes on from there. Otherwise the legs stay at the end.
    start
        [s]; before, the legs are held at the first angles.
    """

    times: np.ndarray
    angles: np.ndarray
    repeat: bool = False
    start: float = 0.0
    _advance: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=float)
        angles = np.array(self.angles, dtype=float)
        if times.ndim != 1 or times.size < 2 or angles.shape != (times.size, LEG_COUNT):
            raise InputError(
                f"a table must have at least two times and six angles for each, ({times.size}, 6), "
                f"got {angles.shape}",
                WHERE,
            )
        _check_ascending(times, "times")
        if not np.isfinite(angles).all():
            raise InputError("the angles of a table must be finite", WHERE)
        check_finite("start", self.start, "s", WHERE)
        way = angles[-1] - angles[0]
        advance = TURN * np.round(way / TURN)
        off = np.abs(way - advance)
        if self.repeat and not (off < SAME_ANGLE).all():
            leg = int(np.argmax(off))
            raise InputError(
                "a table that repeats must end where it begins, or whole turns on; leg "
                f"{leg + 1} begins at {math.degrees(angles[0, leg]):g} deg and ends at "
                f"{math.degrees(angles[-1, leg]):g} deg",
                WHERE,
            )
        for array in (times, angles, advance):
            array.flags.writeable = False
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "_advance", advance)

    @classmethod
    def of_legs(
        cls,
        points: Mapping[str, Sequence[tuple[float, float]]],
        *,
        repeat: bool = False,
        start: float = 0.0,
    ) -> GaitTable:
        """A table from one list of times and angles per leg, or per group of legs.

        Parameters
        ----------
        points
            By the digits of the legs, for example "145", pairs of time [s] and angle [rad], the
            times ascending from 0. Each leg must be named once. A leg whose list ends early
            stays.
        repeat, start
            See `GaitTable`.
        """
        lists: dict[int, np.ndarray] = {}
        for name, pairs in points.items():
            legs, rows = _legs_and_rows(name, pairs)
            for leg in legs:
                if leg in lists:
                    raise InputError(f"leg {leg} is named twice: give it one list", WHERE)
                lists[leg] = rows
        _check_named(lists, "the table leaves out")
        times = np.unique(np.concatenate([rows[:, 0] for rows in lists.values()]))
        if times.size == 1:
            raise InputError(
                "no leg of the table moves: give a second time, or hold the legs", WHERE
            )
        columns = [
            np.interp(times, lists[leg][:, 0], lists[leg][:, 1]) for leg in range(1, LEG_COUNT + 1)
        ]
        return cls(times, np.column_stack(columns), repeat, start)

    @property
    def period(self) -> float:
        """Length of the table [s]."""
        return float(self.times[-1])

    @property
    def end(self) -> float:
        """When the table ends [s]; infinite if it repeats."""
        return math.inf if self.repeat else self.start + self.period

    def _place(self, time: float) -> tuple[int, int, float]:
        """Rounds done, row before, and time since the round began [s]."""
        since = time - self.start
        rounds = math.floor(since / self.period) if self.repeat else 0
        since -= rounds * self.period
        row = int(np.searchsorted(self.times, since, side="right")) - 1
        return rounds, min(row, self.times.size - 2), since

    def _slopes(self, row: int) -> np.ndarray:
        step = self.times[row + 1] - self.times[row]
        return np.asarray((self.angles[row + 1] - self.angles[row]) / step)

    def targets(self, time: float) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        if time <= self.start:
            return np.array(self.angles[0])
        if time >= self.end:
            return np.array(self.angles[-1])
        rounds, row, since = self._place(time)
        way = (since - self.times[row]) * self._slopes(row)
        return np.asarray(self.angles[row] + way + rounds * self._advance)

    def rates(self, time: float) -> np.ndarray:
        """Derivative of `targets` [rad/s], shape (6,)."""
        if time < self.start or time >= self.end:
            return np.zeros(LEG_COUNT)
        return self._slopes(self._place(time)[1])


def _legs_and_rows(
    name: str, pairs: Sequence[tuple[float, float]]
) -> tuple[tuple[int, ...], np.ndarray]:
    """Numbers of the legs a string of digits names, and their times and angles, shape (N, 2)."""
    if not name or not set(name) <= set("123456"):
        raise InputError(f'legs are named by digits, such as "145", got "{name}"', WHERE)
    rows = np.array(pairs, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 2:
        raise InputError(f"legs {name} need pairs of time and angle, got {pairs}", WHERE)
    _check_ascending(rows[:, 0], f"times of legs {name}")
    return tuple(map(int, name)), rows


def _check_named(legs: Collection[int], lacking: str) -> None:
    """Refuse a gait that says nothing of a leg."""
    missing = [str(leg) for leg in range(1, LEG_COUNT + 1) if leg not in legs]
    if missing:
        raise InputError(
            f"{lacking} legs {', '.join(missing)}: one that shall stay has a single pair, such as "
            "0 s and its angle",
            WHERE,
        )


def _check_ascending(times: np.ndarray, name: str) -> None:
    ascending = np.isfinite(times).all() and (np.diff(times) > 0.0).all()
    if times.size == 0 or times[0] != 0.0 or not ascending:
        raise InputError(
            f"{name} must be finite and ascend from 0, got {times.tolist()} s: no leg can be at "
            "two angles at once",
            WHERE,
        )


@dataclass(frozen=True)
class Move:
    """What some legs do once: angles over the time since it began.

    Attributes
    ----------
    legs
        Numbers 1 to 6.
    times, angles
        [s] ascending from 0 and [rad], shape (N,); linear between, the last angle stays.
    start
        When it begins [s]; None where the robot's turn says so.
    turn
        How far the robot has rolled forward when it begins [rad]; None where the time says so.
    """

    legs: tuple[int, ...]
    times: np.ndarray
    angles: np.ndarray
    start: float | None = None
    turn: float | None = None

    def __post_init__(self) -> None:
        name = "".join(map(str, self.legs))
        times, angles = np.array(self.times, dtype=float), np.array(self.angles, dtype=float)
        if not self.legs or not set(self.legs) <= set(range(1, LEG_COUNT + 1)):
            raise InputError(f"legs of a move are numbers from 1 to 6, got {self.legs}", WHERE)
        _check_ascending(times, f"times of a move of legs {name}")
        if angles.shape != times.shape or not np.isfinite(angles).all():
            raise InputError(f"a move of legs {name} needs an angle for each time", WHERE)
        if (self.start is None) == (self.turn is None):
            raise InputError(
                f"a move of legs {name} begins either at a time or at a turn of the robot", WHERE
            )
        for key, value in (("start", self.start), ("turn", self.turn)):
            if value is not None and not check_finite(f"{key} of legs {name}", value) >= 0.0:
                raise InputError(f"{key} of a move of legs {name} must be >= 0", WHERE)
        if len(set(self.legs)) < len(self.legs):
            raise InputError(f"a move names one of legs {name} twice", WHERE)
        for key, array in (("times", times), ("angles", angles)):
            array.flags.writeable = False
            object.__setattr__(self, key, array)

    @classmethod
    def of_legs(
        cls,
        name: str,
        pairs: Sequence[tuple[float, float]],
        *,
        start: float | None = None,
        turn: float | None = None,
    ) -> Move:
        """A move of the legs of some digits by pairs of time [s] and angle [rad]; see `Move`."""
        legs, rows = _legs_and_rows(name, pairs)
        return cls(legs, rows[:, 0], rows[:, 1], start, turn)


@dataclass(frozen=True)
class GaitSensed:
    """Moves that begin at a time, or when the robot has rolled so far: it feels its own turn.

    What has begun is no function of time, so it is kept outside: `begun` (move_count,), the times
    when moves began [s], infinite where they have not. A move begins once, and not before the moves
    named earlier of the same legs have ended.
    """

    moves: tuple[Move, ...]

    def __post_init__(self) -> None:
        ends: dict[int, float] = {}
        for move in self.moves:
            for leg in move.legs:
                if abs(ends.get(leg, move.angles[0]) - move.angles[0]) > SAME_ANGLE:
                    raise InputError(
                        f"leg {leg} ends a move at {math.degrees(ends[leg]):g} deg and begins the "
                        f"next one at {math.degrees(move.angles[0]):g} deg: no leg can jump",
                        WHERE,
                    )
                ends[leg] = float(move.angles[-1])
        _check_named(ends, "no move names")

    @property
    def period(self) -> float:
        """Infinite."""
        return math.inf

    @property
    def end(self) -> float:
        """Infinite: the robot may go on to turn."""
        return math.inf

    def nothing_begun(self) -> np.ndarray:
        """`begun` before the first moment."""
        return np.full(len(self.moves), math.inf)

    def sense(self, time: float, turn: float, begun: np.ndarray) -> None:
        """Write into `begun` what begins at `time` [s] and `turn` [rad], rolled forward."""
        free = dict.fromkeys(range(1, LEG_COUNT + 1), -math.inf)  # when a leg's moves have ended
        for k, move in enumerate(self.moves):
            ready = max(free[leg] for leg in move.legs)
            if begun[k] == math.inf and time >= ready:
                if move.start is not None and time >= move.start:
                    begun[k] = max(move.start, ready)
                elif move.turn is not None and turn >= move.turn:
                    begun[k] = time
            for leg in move.legs:
                free[leg] = begun[k] + move.times[-1]

    def _legs(self, time: float, begun: np.ndarray | None, rates: bool) -> np.ndarray:
        """Angles or rates of all legs; without `begun` those of before the first moment."""
        result = np.full(LEG_COUNT, math.nan)
        for k, move in enumerate(self.moves):
            since = -1.0 if begun is None else time - float(begun[k])
            first = [leg for leg in move.legs if math.isnan(result[leg - 1])]
            legs = move.legs if since >= 0.0 else first
            row = int(np.searchsorted(move.times, since, side="right")) - 1
            if not rates:
                value = float(np.interp(since, move.times, move.angles))
            elif 0 <= row < move.times.size - 1:
                way = move.angles[row + 1] - move.angles[row]
                value = float(way / (move.times[row + 1] - move.times[row]))
            else:
                value = 0.0
            for leg in legs:
                result[leg - 1] = value
        return result

    def targets(self, time: float, begun: np.ndarray | None = None) -> np.ndarray:
        """Angles [rad], shape (6,)."""
        return self._legs(time, begun, rates=False)

    def rates(self, time: float, begun: np.ndarray | None = None) -> np.ndarray:
        """Derivative of `targets` [rad/s], shape (6,)."""
        return self._legs(time, begun, rates=True)


__all__ = ["GaitSensed", "GaitTable", "Move"]
