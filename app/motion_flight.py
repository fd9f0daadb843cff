"""Jumps in the rows of a motion: how high, how far, and what became of the energy; and cycles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any


def airborne(rows: Sequence[Mapping[str, float]]) -> list[bool]:
    """Of each row whether nothing touches the ground; never, where there is none."""
    heads = [h for h in rows[0] if h.startswith("ground_") and h.endswith("_points")]
    return [bool(heads) and all(row[head] == 0.0 for head in heads) for row in rows]


def flights(rows: Sequence[Mapping[str, float]]) -> list[tuple[int, int]]:
    """First and last row of each flight: the rows without contact with the ground, and one more
    on either side, where it takes off and lands.

    A motion that begins or ends in the air has no take-off or landing there: its flight begins
    with the first row or ends with the last.
    """
    found: list[tuple[int, int]] = []
    begin: int | None = None
    for k, off in enumerate(airborne(rows)):
        if off and begin is None:
            begin = max(k - 1, 0)
        if not off and begin is not None:
            found.append((begin, k))
            begin = None
    if begin is not None:
        found.append((begin, len(rows) - 1))
    return found


def flight_results(rows: Sequence[Mapping[str, float]], mass: float) -> dict[str, Any]:
    """The highest of the jumps; nothing is nought where the body never leaves the ground.

    ``jump_height_m`` is how far the centre of mass rises above its place at take-off,
    ``jump_distance_m`` its way over the ground until it lands, to the row. Stored is what shell
    and coils hold: ``release_energy_J`` is the most of it since the last landing, at
    ``release_time_s``, and ``flight_share`` the part that became ``flight_energy_J``: the kinetic
    energy of the centre of mass, the most of it in a row of the flight, and what the weight gained
    from the release to that row.
    """
    results: dict[str, Any] = {"jump_height_m": 0.0, "jump_distance_m": 0.0, "flight_time_s": 0.0}
    best: tuple[float, int, int] | None = None
    ground = 0
    for begin, end in flights(rows):
        rise = max(row["centre_z_mm"] for row in rows[begin : end + 1])
        height = rise - rows[begin]["centre_z_mm"]
        if best is None or height > best[0]:
            best = (height, begin, end)
            landed = ground
        ground = end
    if best is None or best[0] <= 0.0:
        return results
    height, begin, end = best
    off, down = rows[begin], rows[end]
    way = [down[f"centre_{axis}_mm"] - off[f"centre_{axis}_mm"] for axis in "xy"]
    results["jump_height_m"] = 1e-3 * height
    results["jump_distance_m"] = 1e-3 * (way[0] ** 2 + way[1] ** 2) ** 0.5
    results["flight_time_s"] = down["time_s"] - off["time_s"]
    results["take_off_s"] = off["time_s"]
    stored = max(rows[landed : begin + 1], key=lambda row: row["lines_J"])
    fastest = max(rows[begin : end + 1], key=lambda row: row["speed_m_s"])
    flight = 0.5 * mass * fastest["speed_m_s"] ** 2 + fastest["weight_J"] - stored["weight_J"]
    results["release_energy_J"] = stored["lines_J"]
    results["release_time_s"] = stored["time_s"]
    results["flight_energy_J"] = flight
    if stored["lines_J"] > 0.0:
        results["flight_share"] = flight / stored["lines_J"]
    return results


def cycle_results(rows: Sequence[Mapping[str, float]], cycle: float) -> dict[str, Any]:
    """Way of the centre towards +x in each whole cycle [m], its mean, and the largest.

    Backward it is negative. ``mean_speed_m_s`` is that of the whole cycles.
    """
    count = int((rows[-1]["time_s"] - rows[0]["time_s"]) / cycle + 1e-6)
    ends = [
        min(rows, key=lambda row: abs(row["time_s"] - rows[0]["time_s"] - k * cycle))
        for k in range(count + 1)
    ]
    ways = [1e-3 * (b["centre_x_mm"] - a["centre_x_mm"]) for a, b in pairwise(ends)]
    if not ways:
        return {}
    return {
        "displacement_per_cycle_m": sum(ways) / len(ways),
        "displacement_of_cycles_m": ways,
        "largest_displacement_of_a_cycle_m": max(ways),
        "mean_speed_m_s": sum(ways) / (cycle * len(ways)),
    }


def marker_results(rows: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Fastest speed and way over the ground of the marked point, where rows have one."""
    first, last = rows[0], rows[-1]
    if "marker_speed_m_s" not in last:
        return {}
    way = math.hypot(*(last[f"marker_{a}_mm"] - first[f"marker_{a}_mm"] for a in "xy"))
    return {
        "marker_peak_speed_m_s": max(row["marker_speed_m_s"] for row in rows),
        "marker_distance_m": 1e-3 * way,
    }


__all__ = ["airborne", "cycle_results", "flight_results", "flights", "marker_results"]
