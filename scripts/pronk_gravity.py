"""Pronks under different gravity side by side, from their results folders.

    python scripts/pronk_gravity.py results/pronk_{earth,mars,moon} OUT.png

Draws way and height of the centre over time, and how fast, how high and how long in the air over
gravity (the SoSpider paper's section 4.2 compares the three worlds so), and prints the table.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from flexapod.app.plots import (
    BLUE,
    GREEN,
    RED,
    Results,
    new_figure,
    read_results,
    save_figure,
    tidy,
)
from flexapod.core.units import read_quantities

NAMES = ("steady_speed_m_s", "airborne_fraction", "jump_height_m", "cost_of_transport")


def gravity_of(results: Results) -> float:
    """Strength of gravity [m/s2]."""
    vector = results.case["gravity"]["acceleration"]
    return float(np.linalg.norm(read_quantities(vector, "m/s^2", None)))


def main() -> None:
    """Read the folders, print a table, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    runs = sorted((read_results(folder) for folder in args.folders), key=lambda r: -gravity_of(r))
    figure = new_figure(9.0, 6.4)
    grid = figure.subplot_mosaic(
        [["x", "x", "x"], ["z", "z", "z"], list(NAMES[:3])], height_ratios=[1.0, 1.0, 1.1]
    )
    strengths = [gravity_of(run) for run in runs]
    print(f"{'gravity':>8}  {'x mm':>7}  {'z mm':>13}  " + "  ".join(NAMES))
    for run, strength, colour in zip(runs, strengths, (BLUE, RED, GREEN) * len(runs), strict=False):
        columns, found = run.columns, run.summary["results"]
        time, x, z = (columns[k] for k in ("time_s", "centre_x_mm", "centre_z_mm"))
        words = f"{strength:g} m/s²"
        grid["x"].plot(time, x - x[0], color=colour, lw=1.4, label=words)
        grid["z"].plot(time, z, color=colour, lw=1.0, label=words)
        for name in NAMES[:3]:
            grid[name].plot(
                strength, found.get(name, np.nan), "o", ms=7, color=colour, clip_on=False
            )
        print(
            f"{strength:8.3g}  {x[-1] - x[0]:7.0f}  {z.min():5.1f} to {z.max():4.1f}  "
            + "  ".join(f"{found.get(name, np.nan):{len(name)}.3g}" for name in NAMES)
        )
    for axes, text in ((grid["x"], "way of the centre [mm]"), (grid["z"], "its height [mm]")):
        axes.set_ylabel(text)
        axes.set_xlabel("time [s]")
        axes.margins(x=0.01)
        tidy(axes)
    grid["x"].legend(frameon=False, fontsize=9, loc="upper left")
    for name, text in zip(
        NAMES, ("speed [m/s]", "share of time in the air", "height of jumps [m]"), strict=False
    ):
        grid[name].set_xlabel("gravity [m/s²]")
        grid[name].set_ylabel(text)
        grid[name].set_ylim(bottom=0.0)
        grid[name].margins(y=0.15)
        tidy(grid[name])
    save_figure(figure, args.out)
    print(f"picture: {args.out}")


if __name__ == "__main__":
    main()
