"""Gaits drawn over time: the angle of each leg, those that move alike as one line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.plots import BLUE, GREEN, GREY, PURPLE, RED, new_figure, save_figure
from flexapod.dynamics.gait import LEG_COUNT, Gait, GaitPronk, GaitWalk

_COLOURS = (BLUE, RED, GREEN, PURPLE, "#d98e04", "#4a5568")
_SHADE = "#e4ebf3"
_SAMPLES = 4000
# Wrapped angles lie above this [deg]: there, a leg points forward and is off the ground.
_SEAM = -90.0


def _span(gait: Gait, periods: float) -> tuple[float, float]:
    """First and last time worth drawing [s]: some periods, no more than a little after the end."""
    start = float(getattr(gait, "start", 0.0))
    period = gait.period if math.isfinite(gait.period) else 1.0
    last = start + periods * period
    if start < gait.end < last:
        last = min(last, gait.end + 0.1 * (gait.end - start))
    return min(0.0, start), last


def wrapped(times: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles [deg] brought to -90..270, cut where they wrap, with points on either edge.

    Parameters
    ----------
    times, angles
        Dense samples of a continuous angle [deg], shapes (N,).

    Returns
    -------
    Times and angles with NaN between the pieces, shapes (M,).
    """
    turn = np.floor((angles - _SEAM) / 360.0)
    inside = angles - 360.0 * turn
    out_t, out_a = [times[:1]], [inside[:1]]
    first = 0
    for at in np.flatnonzero(np.diff(turn)):
        rises = turn[at + 1] > turn[at]
        edge = _SEAM + 360.0 * max(turn[at], turn[at + 1])
        share = (edge - angles[at]) / (angles[at + 1] - angles[at])
        time = times[at] + share * (times[at + 1] - times[at])
        before, after = (_SEAM + 360.0, _SEAM) if rises else (_SEAM, _SEAM + 360.0)
        out_t += [times[first + 1 : at + 1], np.full(3, time)]
        out_a += [inside[first + 1 : at + 1], np.array([before, np.nan, after])]
        first = int(at)
    return np.concatenate([*out_t, times[first + 1 :]]), np.concatenate(
        [*out_a, inside[first + 1 :]]
    )


def _groups(angles: np.ndarray) -> list[list[int]]:
    """Legs (from 0) that move alike, by samples of shape (N, 6)."""
    groups: list[list[int]] = []
    for leg in range(LEG_COUNT):
        for group in groups:
            if np.allclose(angles[:, leg], angles[:, group[0]], rtol=0.0, atol=1e-6):
                group.append(leg)
                break
        else:
            groups.append([leg])
    return groups


def _shade_slow(axes: Any, gait: Gait, last: float) -> str | None:
    """Shade the slow phase: of a walk the angles, of a pronk the times. Returns its name."""
    if isinstance(gait, GaitWalk):
        bands: set[tuple[float, float]] = set()
        for clock, way in zip((gait.left, gait.right), gait.directions, strict=True):
            centre = math.degrees(clock.centre)
            if way < 0 and gait.reversal == "mirrored":
                centre = -centre
            half = 0.5 * math.degrees(clock.extent)
            # A band over the seam shows on both sides.
            low = (centre - half - _SEAM) % 360.0 + _SEAM
            bands |= {(low, low + 2.0 * half), (low - 360.0, low - 360.0 + 2.0 * half)}
        for low, high in sorted(bands):
            axes.axhspan(low, high, color=_SHADE, lw=0, zorder=0.4)
        return "slow phase"
    if isinstance(gait, GaitPronk):
        in_air = gait.stroke == "rest"
        lasting = gait.slow_time
        # The stroke of slow_time comes first if the legs begin where it begins.
        first = in_air == (gait.begins == "back")
        begin = gait.start + (0.0 if first else gait.period - lasting)
        while begin < last:
            axes.axvspan(begin, min(begin + lasting, last), color=_SHADE, lw=0, zorder=0.4)
            begin += gait.period
        return "slow time: " + ("through the air" if in_air else "the push")
    return None


def _draw_gait(axes: Any, gait: Gait, periods: float) -> None:
    begin, last = _span(gait, periods)
    times = np.linspace(begin, last, _SAMPLES)
    angles = np.degrees([gait.targets(float(time)) for time in times])
    turns = isinstance(gait, GaitWalk) or float(np.ptp(angles)) > 359.0
    groups = _groups(angles)
    for place, group in enumerate(groups):
        x, y = times, angles[:, group[0]]
        if turns:
            x, y = wrapped(times, y)
        names = ", ".join(str(leg + 1) for leg in group)
        label = "all legs" if len(group) == LEG_COUNT else f"leg{'s' * (len(group) > 1)} {names}"
        # Later lines are thinner, so that one beneath still shows where they run together.
        axes.plot(
            x, y, "-", color=_COLOURS[place], lw=2.6 - 1.1 * place / max(1, len(groups) - 1),
            label=label, zorder=3 + 0.01 * place, solid_joinstyle="round",
        )  # fmt: skip
    if turns:
        low, high = _SEAM, _SEAM + 360.0
        axes.set_yticks(np.arange(low, high + 1.0, 90.0))
    else:
        low, high = float(angles.min()), float(angles.max())
        step = next(s for s in (15.0, 30.0, 45.0, 90.0) if high - low <= 6.0 * s or s == 90.0)
        axes.set_yticks(np.arange(step * math.floor(low / step), high + step, step))
    margin = 0.04 * max(high - low, 30.0)
    axes.set_ylim(low - margin, high + margin)
    axes.set_xlim(begin, last)
    name = _shade_slow(axes, gait, last)
    if name is not None:
        axes.fill_between([], [], color=_SHADE, lw=0, label=name)
    axes.grid(True, color="#dfe3e8", lw=0.6, zorder=0.5)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("bottom", "left"):
        axes.spines[side].set_color(GREY)
    axes.tick_params(labelsize=8.5, color=GREY)
    axes.set_ylabel("leg angle [°]")
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.005, 1.0), frameon=False, fontsize=8.5, borderpad=0.2
    )


def plot_gaits(gaits: Sequence[tuple[str, Gait]], path: Path, periods: float = 2.0) -> None:
    """A panel per gait with its title: angles [deg] over so many periods.

    0 is straight down, positive to the back. Angles of legs that turn round are shown from -90 to
    270 deg. The slow phase is shaded: of a walk as a band of angles, of a pronk as the times of
    the stroke that takes `slow_time`.
    """
    figure = new_figure(8.4, 2.7 * len(gaits) + 0.2)
    panels = figure.subplots(len(gaits), 1, squeeze=False)[:, 0]
    for axes, (title, gait) in zip(panels, gaits, strict=True):
        _draw_gait(axes, gait, periods)
        axes.set_title(title, fontsize=11, loc="left")
    panels[-1].set_xlabel("time [s]")
    save_figure(figure, path)


def plot_gait(gait: Gait, path: Path, periods: float = 2.0, title: str = "Gait") -> None:
    """One gait; see `plot_gaits`."""
    plot_gaits([(title, gait)], path, periods)


def plot_figure8(path: Path) -> None:
    """Figure 8 of the hexapod's paper as targets: its tripod and its pronk on the bench."""
    degree = math.pi / 180.0
    tripod = GaitWalk.tripod(60.0 * degree, 30.0 * degree, 3.0, 1.2)
    pronk = GaitPronk(60.0 * degree, -30.0 * degree, 3.0, 1.2)
    plot_gaits(
        [
            ("(a) Tripod {60°, 30°, 3 s, 1.2 s}, all legs at 180° at first", tripod),
            ("(b) Pronk {60°, −30°, 3 s, 1.2 s}", pronk),
        ],
        path,
        periods=3.0,
    )


__all__ = ["plot_figure8", "plot_gait", "plot_gaits"]
