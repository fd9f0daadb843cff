"""What the legs of a robot did: angles beside what they aimed at, torques, power."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from flexapod.app.plots import (
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    RED,
    Results,
    heading_of,
    new_figure,
    save_figure,
    tidy,
)
from flexapod.app.plots_gait import wrapped
from flexapod.core.errors import InputError

_COLOURS = (BLUE, RED, GREEN, PURPLE, "#d08a1d", "#3aa6a6")


def leg_names(results: Results) -> list[str]:
    """Legs the rows tell of, by number."""
    found = (re.fullmatch(r"(leg_\d+)_angle_deg", head) for head in results.columns)
    return sorted(match.group(1) for match in found if match is not None)


def _alike(results: Results, names: list[str]) -> list[list[str]]:
    """Legs together whose targets never differ by a degree."""
    groups: list[list[str]] = []
    for name in names:
        own = results.columns[f"{name}_target_deg"]
        for group in groups:
            apart = results.columns[f"{group[0]}_target_deg"] - own
            if np.nanmax(np.abs(apart)) < 1.0:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def plot_legs(results: Results, path: Path) -> None:
    """Angles (thin: the targets), motors' torques, and the power of all, over time."""
    names = leg_names(results)
    if not names:
        raise InputError("its rows tell of no legs", str(results.folder))
    time = results.columns["time_s"]
    groups = _alike(results, names)
    figure = new_figure(9.0, 8.0)
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.5, 1.2])
    turning = max(np.ptp(results.columns[f"{n}_target_deg"]) for n in names) > 330.0
    for group, colour in zip(groups, _COLOURS * len(groups), strict=False):
        text = f"leg{'s' if len(group) > 1 else ''} " + ", ".join(n[4:] for n in group)
        for k, name in enumerate(group):
            columns = results.columns
            for head, style in (
                ("angle", {"color": colour, "lw": 1.4, "label": text if k == 0 else None}),
                ("target", {"color": GREY, "lw": 0.7, "ls": "--", "zorder": 1}),
            ):
                angles = columns[f"{name}_{head}_deg"]
                shown = wrapped(time, angles) if turning else (time, angles)
                upper.plot(*shown, **style)  # type: ignore[arg-type]
            middle.plot(time, columns[f"{name}_torque_N_m"], color=colour, lw=0.9, alpha=0.85)
    upper.plot([], [], color=GREY, lw=0.7, ls="--", label="target")
    upper.set_ylabel("angle [°]")
    upper.legend(frameon=False, fontsize=8.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
    middle.set_ylabel("motors' torque [N m]")
    lower.plot(time, results.columns["servo_power_W"], color=BLUE, lw=0.9)
    lower.set_ylabel("motors together [W]")
    lower.set_xlabel("time [s]")
    drawn = float(results.columns["servo_drawn_J"][-1])
    span = max(float(time[-1] - time[0]), 1e-9)
    half = " (of the half that is computed)" if results.case.get("plot", {}).get("mirror") else ""
    lower.set_title(
        f"work given {drawn:.3g} J, {drawn / span:.3g} W on average{half}", fontsize=9, loc="left"
    )
    for axes in (upper, middle, lower):
        tidy(axes)
        axes.margins(x=0.01)
    figure.align_ylabels([upper, middle, lower])
    figure.suptitle(heading_of(results), fontsize=11)
    save_figure(figure, path)


__all__ = ["leg_names", "plot_legs"]
