"""Pictures of a motion, drawn from its results folder: see `draw_motion`.

The curves over time are here, the shapes in `plots_frames` and `plots_line_frames`.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.plots import (
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    RED,
    Results,
    heading_of,
    label,
    new_figure,
    read_results,
    save_figure,
    tidy,
)
from flexapod.app.plots_frames import (
    plot_animation,
    plot_motion_final,
    plot_motion_snapshots,
    read_frames,
)
from flexapod.app.plots_ground import EDGE, draw_ground, ground_profile, read_grounds
from flexapod.app.plots_legs import leg_names, plot_legs
from flexapod.app.plots_line_frames import (
    plot_line_animation,
    plot_line_final,
    plot_line_snapshots,
    read_line_frames,
)
from flexapod.app.plots_skin import renderer
from flexapod.app.plots_voltage import plot_case_voltage
from flexapod.contact.ground import Ground
from flexapod.core.errors import InputError

_COLOURS = (BLUE, RED, GREEN, PURPLE, "#d08a1d", GREY, "#3aa6a6", "#7a5230", "#c2609a")


def _line(axes: Any, x: np.ndarray, y: np.ndarray, **options: Any) -> None:
    """A line, or a dot where there is one point only."""
    axes.plot(x, y, marker="o" if len(x) == 1 else None, ms=4, lw=1.5, **options)


# --------------------------------------------------------------------------- curves

_WHOSE = {"speed_m_s": "centre", "marker_speed_m_s": "marker"}


def _tracks(results: Results, up: str) -> dict[str, np.ndarray]:
    """Ways [mm] along x and `up` (y or z) by name, the centre's first; shape (row_count, 2)."""
    columns = results.columns
    names = [n.removesuffix("_x_mm") for n in columns if n.endswith("_x_mm")]
    # Groups of cells made rigid are parts of the body; its own track says where they go.
    shaped = {f"rigid_{t['name']}" for t in results.case.get("rigid", ()) if "name" in t}
    names = [n for n in names if not n.startswith("rigid_") or n in shaped]
    return {
        name: np.column_stack([columns[f"{name}_x_mm"], columns[f"{name}_{up}_mm"]])
        for name in sorted(names, key=lambda n: n != "centre")
        if f"{name}_{up}_mm" in columns
    }


def plot_motion_curve(results: Results, grounds: Sequence[Ground], path: Path) -> None:
    """Ways of centre and tracks; speed, acceleration and turn over time.

    From the side, over the ground; with ``plot.view = "top"`` from above, with the heading.
    """
    time = results.columns["time_s"]
    from_above = results.case.get("plot", {}).get("view") == "top"
    grounds = [] if from_above else grounds
    tracks = _tracks(results, "y" if from_above else "z")
    points = np.concatenate(list(tracks.values()))
    points = points[np.isfinite(points).all(axis=1)]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros((2, 2))
    reach = max(float((high - low).max()), 1.0)
    low_x, high_x = low[0] - 0.06 * reach, high[0] + 0.06 * reach
    if grounds:
        z = 1000.0 * ground_profile(grounds, 0.001 * low_x, 0.001 * high_x)[:, 1]
        # A ground far below is not worth a small track.
        near = z[z > low[1] - 3.0 * reach]
        low[1] = min(low[1], near.min()) if near.size else low[1]
    low_z, high_z = low[1] - 0.05 * reach, high[1] + 0.08 * reach
    # Neither a ribbon nor a pole: the narrower side gets room.
    spare = 0.5 * max(0.22 * (high_x - low_x) - (high_z - low_z), 0.0)
    low_z, high_z = low_z - spare, high_z + spare
    spare = 0.5 * max(0.5 * (high_z - low_z) - (high_x - low_x), 0.0)
    low_x, high_x = low_x - spare, high_x + spare
    ratio = (high_x - low_x) / (high_z - low_z)

    extra = [name for name in results.case.get("plot", {}).get("y") or () if name != "time_s"]
    for name in extra:
        if name not in results.columns:
            raise InputError(
                f'no column "{name}"; the columns are {", ".join(results.columns)}',
                f"{results.folder}: plot.y",
            )
    jolts = "centre_acceleration_m_s2"
    turn = "yaw_deg" if from_above and "yaw_deg" in results.columns else "turn_deg"
    speeds = ["speed_m_s", *(["marker_speed_m_s"] if "marker_x_mm" in results.columns else [])]
    kinds = {"speed": speeds, "acceleration": [jolts], "turn": [turn], "extra": extra}
    small = [name for name, heads in kinds.items() if any(h in results.columns for h in heads)]
    if ratio > 1.5:
        rows = [["track"] * len(small), small]
        tall = 8.4 / ratio
        figure = new_figure(9.0, tall + 3.6)
        grid = figure.subplot_mosaic(rows, height_ratios=[tall + 0.5, 2.6])
    else:
        rows = [["track", name] for name in small]
        tall = max(4.6, 2.0 * len(small))
        wide = (tall - 0.9) * ratio + 0.9
        figure = new_figure(wide + 4.2, tall)
        grid = figure.subplot_mosaic(rows, width_ratios=[wide, 4.0])

    axes = grid["track"]
    axes.set_xlim(low_x, high_x)
    axes.set_ylim(low_z, high_z)
    axes.set_aspect("equal")
    draw_ground(axes, grounds)
    for (name, way), colour in zip(tracks.items(), _COLOURS * len(tracks), strict=False):
        text = "centre of the body" if name == "centre" else name.replace("_", " ")
        axes.plot(way[:, 0], way[:, 1], color=colour, lw=1.6, label=text, zorder=3)
        axes.plot(*way[0], "o", ms=5, mfc="white", color=colour, zorder=4)
        axes.plot(*way[-1], "o", ms=5, color=colour, zorder=4)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]" if from_above else "z [mm]")
    tidy(axes)
    axes.legend(
        frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.1, ncols=max(1, min(len(tracks), 4 if ratio > 1.5 else 2)),
    )  # fmt: skip

    for name in small:
        axes, heads = grid[name], kinds[name]
        for k, (head, colour) in enumerate(zip(heads, _COLOURS * len(heads), strict=False)):
            if head in results.columns:
                # The first one is on top of the others.
                under = {} if k == 0 else {"alpha": 0.6}
                _line(
                    axes, time, results.columns[head],
                    color=colour, label=_WHOSE.get(head, label(head)), zorder=3 - 0.1 * k, **under,
                )  # fmt: skip
        axes.set_xlabel("time [s]")
        if len(heads) == 1 or name == "speed":
            axes.set_ylabel(label(heads[0]))
        if len(heads) > 1:
            axes.legend(
                frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0),
                borderaxespad=0.1, ncols=2,
            )  # fmt: skip
        tidy(axes)
        axes.margins(x=0.01)
    figure.suptitle(heading_of(results), fontsize=11)
    save_figure(figure, path)


def _scaled(largest: float) -> tuple[float, str]:
    """Factor and unit in which an energy [J] reads well."""
    if largest == 0.0:
        return 1.0, "J"
    for factor, unit in ((1.0, "J"), (1e3, "mJ"), (1e6, "µJ")):
        if largest * factor >= 0.5:
            return factor, unit
    return 1e9, "nJ"


def has_energies(results: Results) -> bool:
    """Whether the folder's rows hold the ledger of energies."""
    return {"kinetic_J", "strain_J", "weight_J", "unaccounted_J"} <= set(results.columns)


def plot_energy(results: Results, path: Path) -> None:
    """The ledger over time, and below it what it leaves unexplained."""
    if not has_energies(results):
        raise InputError("there are no energies to draw", str(results.folder))
    columns, time = results.columns, results.columns["time_s"]

    def since_start(*heads: str) -> np.ndarray:
        kept = [columns[f"{head}_J"] for head in heads if f"{head}_J" in columns]
        return np.sum([values - values[0] for values in kept], axis=0) + np.zeros(len(time))

    # Each contact has its own count beside the ledger's.
    own = tuple(f"{name}_" for name in contact_names(results))
    losses = [
        n.removesuffix("_J") for n in columns if n.endswith("_loss_J") and not n.startswith(own)
    ]
    lossy = [n for n in losses if np.abs(columns[f"{n}_J"]).max() > 0.0]
    lost = ", ".join(n.removesuffix("_loss").replace("_", " ") for n in lossy)
    curves = {
        "kinetic": columns["kinetic_J"],
        "weight, since start": since_start("weight"),
        "strain, since start": since_start("strain"),
        "contact, since start": since_start("contact"),
        "bonds, since start": since_start("bond"),
        "pressure's work": since_start("pressure_work"),
        (f"losses ({lost})" if lost else "losses"): since_start(*losses),
        "shell and coils, since start": since_start("lines"),
        "coils' work": since_start("coil_work"),
        "rotors and joints": since_start("joints"),
        "servos' work": since_start("servo_work"),
    }
    unaccounted = columns["unaccounted_J"]
    change = max(float(np.nanmax(np.abs(values))) for values in curves.values())
    factor, unit = _scaled(change)

    figure = new_figure(8.4, 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3.2, 1.0])
    there = [n for n, v in curves.items() if n == "kinetic" or np.nanmax(np.abs(v)) > 0.0]
    for name, colour in zip(there, _COLOURS * 2, strict=False):
        _line(upper, time, factor * curves[name], color=colour, label=name)
    upper.axhline(0.0, color=EDGE, lw=0.7)
    upper.set_ylabel(f"energy [{unit}]")
    tidy(upper)
    upper.legend(frameon=False, fontsize=8.5, loc="center left", bbox_to_anchor=(1.0, 0.5))

    worst = float(np.nanmax(np.abs(unaccounted)))
    # As in summary.json: the largest energy that was stored, fallen or put in.
    largest = max(
        float(np.nanmax(columns["strain_J"])),
        float(np.nanmax(columns.get("lines_J", np.zeros(1)))),
        *(
            float(np.nanmax(np.abs(curves[n])))
            for n in (
                "kinetic",
                "weight, since start",
                "pressure's work",
                "coils' work",
                "servos' work",
            )
        ),
    )
    factor, unit = _scaled(worst)
    _line(lower, time, factor * unaccounted, color=RED)
    lower.axhline(0.0, color=EDGE, lw=0.7)
    lower.set_ylabel(f"[{unit}]")
    lower.set_xlabel("time [s]")
    tidy(lower)
    lower.margins(x=0.01)
    share = f"unaccounted: at most {factor * worst:.3g} {unit}"
    if largest > 0.0 and change > 0.0:
        share += (
            f", {100 * worst / largest:.2g} % of the largest energy,"
            f" {100 * worst / change:.2g} % of the largest change above"
        )
    lower.set_title(share, fontsize=9, loc="left")
    figure.suptitle(heading_of(results), fontsize=11)
    save_figure(figure, path)


def contact_names(results: Results) -> list[str]:
    """Names of the contacts the rows tell of."""
    heads = results.columns
    return [h.removesuffix("_force_N") for h in heads if re.fullmatch(r".+_\d+_force_N", h)]


def _contact_title(results: Results, name: str) -> str:
    """What touches what: ``outer on the ground``."""
    try:
        table = results.case["contact"][int(name.rpartition("_")[2])]
        surfaces = ", ".join(table["surface"])
    except (KeyError, IndexError, ValueError):
        return name.replace("_", " ")
    itself = "on itself" if len(table["surface"]) == 1 else "on themselves"
    kind = {"ground": "on the ground", "self": itself}.get(table.get("type"), "")
    if table.get("type") == "pair":
        kind = f"on {', '.join(table.get('with', ()))}"
    return "\n".join(textwrap.wrap(f"{surfaces} {kind}", 48)[:2])


def plot_contact(folder: Path | Results, path: Path) -> None:
    """Per contact over time: force, area in touch, deepest penetration, and what it took."""
    results = folder if isinstance(folder, Results) else read_results(folder)
    names = contact_names(results)
    if not names:
        raise InputError("its rows tell of no contacts", str(results.folder))
    time = results.columns["time_s"]
    # One line each, or two: the second with its own name.
    kinds = (
        ("force [N]", (("force_N", "normal"), ("friction_N", "friction"))),
        ("area [mm²]", (("area_mm2", ""),)),
        ("penetration [mm]", (("depth_mm", ""),)),
        ("taken [J]", (("friction_loss_J", "by friction"), ("damping_loss_J", "by damping"))),
    )
    figure = new_figure(max(5.4, 0.6 + 3.9 * len(names)), 7.6)
    grid = figure.subplots(len(kinds), len(names), sharex=True, squeeze=False)
    for j, name in enumerate(names):
        for i, (text, heads) in enumerate(kinds):
            axes = grid[i, j]
            largest = 0.0
            for k, (head, part) in enumerate(heads):
                values = results.columns.get(f"{name}_{head}")
                if values is None:
                    continue
                largest = max(largest, float(np.nanmax(values)))
                _line(axes, time, values, color=_COLOURS[i + 3 * k], label=part)
                if len(time) > 1:
                    axes.fill_between(time, values, color=_COLOURS[i + 3 * k], alpha=0.12, lw=0)
            if not largest > 0.0:
                axes.set_yticks([0.0])
                axes.set_ylim(0.0, 1.0)
            elif len(heads) > 1:
                axes.legend(fontsize=8, frameon=False, loc="best")
            axes.set_ylim(bottom=0.0)
            axes.margins(x=0.01)
            tidy(axes)
            if j == 0:
                axes.set_ylabel(text)
        grid[0, j].set_title(_contact_title(results, name), fontsize=9.5)
        grid[-1, j].set_xlabel("time [s]")
    figure.align_ylabels(grid[:, 0])
    figure.suptitle(heading_of(results, width=20 + 45 * len(names)), fontsize=11)
    save_figure(figure, path)


# --------------------------------------------------------------------------- all


def draw_motion(results: Results) -> tuple[list[Path], list[str]]:
    """Draw every picture of a motion; the paths, and notices about what fell short.

    ``curve.png`` (ways over the ground, speed, turn), ``energy.png`` (the ledger), ``contact.png``
    (force, area, penetration and losses of each contact), where coils are switched
    ``voltage.png``, of a robot's legs ``legs.png``, and where fields or lines were written
    ``snapshots.png`` (a strip), ``final.png`` and ``animation.gif``.
    """
    notices: list[str] = []
    written: list[Path] = []
    target = results.folder / "plots"
    try:
        grounds = read_grounds(results)
    except InputError as error:
        grounds = []
        notices.append(f"pictures without the ground: {error}")
    plot_motion_curve(results, grounds, target / "curve.png")
    written.append(target / "curve.png")
    if has_energies(results):
        plot_energy(results, target / "energy.png")
        written.append(target / "energy.png")
    if contact_names(results):
        plot_contact(results, target / "contact.png")
        written.append(target / "contact.png")
    if "actuation" in results.case:
        plot_case_voltage(results, target / "voltage.png")
        written.append(target / "voltage.png")
    if leg_names(results):
        plot_legs(results, target / "legs.png")
        written.append(target / "legs.png")
    lines = read_line_frames(results)
    if lines is not None:
        if not lines.plane and (notice := renderer()[1]):
            notices.append(notice)
        for name, draw_lines in (
            ("snapshots.png", plot_line_snapshots),
            ("final.png", plot_line_final),
            ("animation.gif", plot_line_animation),
        ):
            draw_lines(results, grounds, lines, target / name)
            written.append(target / name)
        return written, notices
    frames = read_frames(results)
    if frames is None:
        return written, notices
    notice = renderer()[1]
    if notice:
        notices.append(notice)
    for name, draw in (
        ("snapshots.png", plot_motion_snapshots),
        ("final.png", plot_motion_final),
        ("animation.gif", plot_animation),
    ):
        draw(results, grounds, frames, target / name)
        written.append(target / name)
    return written, notices
