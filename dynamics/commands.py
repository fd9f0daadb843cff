"""What the air does over time: tables of pressure, and a pump with a valve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexapod.core.errors import InputError, check_positive
from flexapod.fem.loads import Cavity

ATMOSPHERE = 101325.0  # [Pa]


@dataclass(frozen=True)
class Table:
    """A quantity over time: straight lines between points, held before and after them.

    Attributes
    ----------
    times
        [s], ascending.
    values
        In the quantity's SI unit.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.values):
            raise InputError(
                f"a table needs as many times as values, got {len(self.times)} and "
                f"{len(self.values)}"
            )
        if not np.isfinite([*self.times, *self.values]).all():
            raise InputError("a table's times and values must be finite")
        if any(b < a for a, b in zip(self.times, self.times[1:], strict=False)):
            raise InputError(f"a table's times must ascend, got {list(self.times)}")

    @classmethod
    def constant(cls, value: float) -> Table:
        """The same at all times."""
        return cls((0.0,), (value,))

    @classmethod
    def ramp(cls, value: float, duration: float, start: float = 0.0) -> Table:
        """From zero at `start` to `value` after `duration` [s]."""
        return cls((start, start + duration), (0.0, value))

    def at(self, time: float) -> float:
        """Value at `time` [s]."""
        return float(np.interp(time, self.times, self.values))


class PressureCommand(Protocol):
    """How a chamber's gauge pressure comes about."""

    @property
    def needs_volume(self) -> bool:
        """Whether the pressure follows from the chamber's volume."""
        ...

    def gas(self, volume: float) -> float:
        """Gas in the chamber at the start, as its volume at atmospheric pressure [m3]."""
        ...

    def flow(self, time: float, pressure: float) -> float:
        """Gas that flows in [m3/s at atmospheric pressure]."""
        ...

    def pressure(self, time: float, volume: float, gas: float) -> float:
        """Gauge pressure [Pa]."""
        ...


@dataclass(frozen=True)
class PressureTable:
    """The pressure itself is commanded [Pa gauge]: a regulator of any strength."""

    table: Table
    needs_volume: bool = False

    def gas(self, volume: float) -> float:
        """See `PressureCommand`: not counted."""
        return 0.0

    def flow(self, time: float, pressure: float) -> float:
        """See `PressureCommand`: not counted."""
        return 0.0

    def pressure(self, time: float, volume: float, gas: float) -> float:
        """See `PressureCommand`."""
        return self.table.at(time)


@dataclass(frozen=True)
class Pump:
    """A pump of given flow behind a valve, and an exhaust; the gas is ideal and isothermal.

    ``(p + p0) V = p0 N`` with the gauge pressure p, the chamber's volume V, and the gas N as its
    volume at the atmosphere's p0. Isothermal, since a chamber of a few millilitres between walls of
    silicone takes seconds to fill (assumed).

    Attributes
    ----------
    delivery
        Flow of the pump over time [m3/s at atmospheric pressure].
    exhaust
        Conductance of the open outlet over time [m3/(s Pa) at atmospheric pressure]; zero shut.
    stall
        Gauge pressure [Pa] at which the pump delivers nothing; its flow falls linearly to there.
        Infinite for a pump that does not mind.
    start
        Gauge pressure at the start [Pa].
    atmosphere
        p0 [Pa].
    """

    delivery: Table
    exhaust: Table = Table((0.0,), (0.0,))
    stall: float = float("inf")
    start: float = 0.0
    atmosphere: float = ATMOSPHERE
    needs_volume: bool = True

    def __post_init__(self) -> None:
        check_positive("atmosphere", self.atmosphere, "Pa")
        if not self.stall > 0.0:
            raise InputError(f"stall must be > 0, got {self.stall:g} Pa")
        if min(self.delivery.values) < 0.0 or min(self.exhaust.values) < 0.0:
            raise InputError("delivery and exhaust must be >= 0")

    def gas(self, volume: float) -> float:
        """See `PressureCommand`."""
        return volume * (1.0 + self.start / self.atmosphere)

    def flow(self, time: float, pressure: float) -> float:
        """See `PressureCommand`."""
        share = max(0.0, 1.0 - pressure / self.stall)
        return self.delivery.at(time) * share - self.exhaust.at(time) * pressure

    def pressure(self, time: float, volume: float, gas: float) -> float:
        """See `PressureCommand`."""
        return self.atmosphere * (gas / volume - 1.0)


@dataclass(frozen=True)
class Chamber:
    """Named cavity faces under one pressure."""

    name: str
    faces: np.ndarray  # corner quadruples that look into the air, shape (face_count, 4)
    command: PressureCommand

    def cavity(self) -> Cavity:
        """The volume the faces enclose."""
        return Cavity(self.name, self.faces)


def chamber_names(chambers: Sequence[Chamber]) -> list[str]:
    """Names in order; raises `InputError` if two are the same."""
    names = [chamber.name for chamber in chambers]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InputError(f"two chambers share a name: {double}")
    return names
