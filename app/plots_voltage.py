"""The voltage diagram: which coil is on when, drawn from a case's table of actuation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.plots import GREY, Results, heading_of, new_figure, save_figure
from flexapod.app.plots_lines import LETTER, ON
from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity

if TYPE_CHECKING:
    from flexapod.dynamics.actuation import Actuation

_CYCLE = 8  # steps after which a pattern is where it began


def read_actuation(results: Results) -> tuple[Actuation, float, str]:
    """What switches the coils, the time to draw it for [s], and what it is in words.

    Of a pattern the first two rounds, of a table all of it.
    """
    from flexapod.dynamics.actuation import LETTERS, Actuation

    table = results.case.get("actuation")
    if table is None:
        raise InputError("the case has no table of actuation", str(results.folder))
    try:
        duration = read_quantity(results.case["dynamics"]["duration"], "s")
        if table.get("table") is not None:
            pairs = {
                name: [(read_quantity(a, "s"), read_quantity(b, "s")) for a, b in times]
                for name, times in table["table"].items()
            }
            last = max((off for times in pairs.values() for _, off in times), default=duration)
            events = Actuation.table(LETTERS, pairs, duration)
            return events, min(1.1 * last, duration), "voltage by a table of times"
        interval = read_quantity(table["interval"], "s")
        end = min(2 * _CYCLE * interval, duration)
        duty = float(table.get("duty", 1.0))
        events = Actuation.pattern(
            first=table["pattern"],
            interval=interval,
            # Longer than is drawn: at its own end it switches off.
            duration=max(end + interval, 1.5 * interval) if end < duration else duration,
            direction=int(table.get("direction", 1)),
            duty=duty,
            pwm_period=read_quantity(table["pwm_period"], "s") if duty < 1.0 else None,
        )
    except InputError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", f"{results.folder}: actuation") from None
    words = f"pattern {table['pattern']}, interval {table['interval']}"
    if table.get("direction", 1) == -1:
        words += ", from A to H"
    if duty < 1.0:
        words += f", {100.0 * duty:.3g} % of {table['pwm_period']}"
    return events, end, words


def plot_voltage(
    letters: Sequence[str],
    times: np.ndarray,
    states: np.ndarray,
    end: float,
    heading: str,
    path: Path,
    marks: float | None = None,
) -> None:
    """A row per coil, high while it is on, from 0 to `end` [s].

    `times` are the starts of the rows of `states` [s], shapes (event_count,) and (event_count,
    coil_count), the last holds on. `marks` is the time between the thin upright lines [s].
    """
    shown = times < end
    edges = np.append(times[shown], end)
    level = states[shown]
    rows = len(letters)
    figure = new_figure(8.4, 0.95 + 0.34 * rows + 0.2 * heading.count("\n"))
    axes = figure.add_subplot()
    for place, name in enumerate(letters):
        low = float(rows - 1 - place)
        high = np.where(level[:, place], 0.62, 0.0)
        steps = np.append(high, high[-1])
        axes.fill_between(edges, low, low + steps, step="post", color=ON, lw=0, alpha=0.55)
        # More switches than can be told apart, as of a PWM, stay a plain band.
        if np.count_nonzero(np.diff(high)) < 150:
            axes.step(edges, low + steps, where="post", color=LETTER, lw=1.2, zorder=3)
        else:
            axes.plot([0.0, end], [low, low], color=LETTER, lw=1.2, zorder=3)
        axes.text(
            -0.008, low + 0.3, name, transform=axes.get_yaxis_transform(), ha="right",
            va="center_baseline", fontsize=10, fontweight="bold", color=LETTER,
        )  # fmt: skip
    if marks is not None and end / marks < 60.0:
        for mark in marks * np.arange(1, int(end / marks * (1.0 + 1e-9)) + 1):
            axes.axvline(mark, color="#dfe3e8", lw=0.7, zorder=0.5)
    axes.set_xlim(0.0, end)
    axes.set_ylim(-0.15, rows - 0.15)
    axes.set_yticks([])
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(GREY)
    axes.tick_params(labelsize=8.5, color=GREY)
    axes.set_xlabel("time [s]")
    axes.set_title(heading, fontsize=11)
    save_figure(figure, path)


def plot_case_voltage(results: Results, path: Path) -> None:
    """The voltage diagram of a case; coils that are never on are left out."""
    events, end, words = read_actuation(results)
    used: np.ndarray = np.any(events.states, axis=0)
    table: dict[str, Any] = results.case["actuation"]
    marks = read_quantity(table["interval"], "s") if table.get("table") is None else None
    names = [name for name, is_on in zip(events.letters, used.tolist(), strict=True) if is_on]
    plot_voltage(
        names or list(events.letters),
        events.times,
        events.states[:, used] if names else events.states,
        end,
        heading_of(results, words),
        path,
        marks,
    )
