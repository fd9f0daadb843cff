"""The slope a curled body needs, place by place: it is led over its corners at a slow, even pace.

    python scripts/roll_tilt.py roll_threshold OUT [--pace 50] [--way 50] [--set KEY=VALUE ...]

A search by bisection finds one threshold in hours. Here the ground stays level, gravity is tilted
by a controller so that the body's centre keeps a pace, and the work of gravity along the ground,
less the kinetic energy and what mass damping took, is the energy the body asks for on its way. Its
slope over weight is the tilt that would just hold it there: the largest one is the threshold.
Writes OUT/tilt.csv, OUT/tilt.png and the answer.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import math
from pathlib import Path

import numpy as np

from flexapod.app.case import load_case
from flexapod.app.motion_model import assemble_motion, centre, start_shape
from flexapod.dynamics.integrator import Options, energies, march
from flexapod.dynamics.model import State

# Of the controller, on the pace [rad per m/s, rad per m]: some 20 and 8 per second in closed loop.
PROPORTIONAL, INTEGRAL = 4.0, 32.0
EASE = 0.15  # [s], in which the pace is taken up
WINDOW = 6.0  # [mm], over which the slope of the energy is taken


def main() -> None:
    """Lead the body of a case over the ground and print the tilt it needed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case")
    parser.add_argument("out", type=Path)
    parser.add_argument("--pace", type=float, default=50.0, help="of the centre [mm/s]")
    parser.add_argument("--way", type=float, default=50.0, help="of the centre [mm]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    loaded = load_case(args.case, args.set)
    run = loaded.case.dynamics
    if run is None:
        parser.error(f"{args.case} is no case that moves")
    if args.way < 2.0 * WINDOW:
        parser.error(f"--way must be at least {2.0 * WINDOW:g} mm")
    args.out.mkdir(parents=True, exist_ok=True)
    start = start_shape(loaded, args.out, False, print)
    motion = assemble_motion(loaded, start, print)
    model, state, work = motion.model, motion.state, motion.work
    strength = float(np.linalg.norm(model.gravity))
    begin = centre(model, state)[0]
    model.gravity = np.array([0.0, 0.0, -strength])
    rows: list[dict[str, float]] = []
    tilt, share, pace = 0.0, 0.0, 1e-3 * args.pace

    def record(state: State) -> None:
        books = energies(model, state, work)
        rows.append(
            {
                "time_s": state.time,
                "way_mm": 1e3 * (centre(model, state)[0] - begin),
                "tilt_deg": math.degrees(tilt),
                "kinetic_J": books.kinetic,
                "mass_damping_loss_J": books.mass_damping_loss,
                "contact_loss_J": books.contact_loss,
            }
        )

    def steer(state: State) -> None:
        nonlocal tilt, share
        way = 1e-3 * rows[-1]["way_mm"]
        last = 1e-3 * rows[-2]["way_mm"] if len(rows) > 1 else 0.0
        wanted = pace * min(1.0, state.time / EASE)
        lacking = wanted - (way - last) / run.interval
        share += INTEGRAL * lacking * run.interval
        tilt = share + PROPORTIONAL * lacking
        model.gravity = strength * np.array([math.sin(tilt), 0.0, -math.cos(tilt)])
        if state.interval % 10 == 0:
            print(f"{state.time:.3f} s, {1e3 * way:.2f} mm, {math.degrees(tilt):.2f} deg")
            write(rows, args.out / "tilt.csv")
        if 1e3 * way > args.way:
            raise StopIteration

    count = round((args.way / args.pace * 2.0 + EASE) / run.interval)
    with contextlib.suppress(StopIteration):
        march(model, state, work, count, Options(run.interval, run.safety), record, steer)
    write(rows, args.out / "tilt.csv")
    way, needed = needed_tilt(rows, motion.mass * strength)
    at = int(np.argmax(needed))
    print(f"needs at most {needed[at]:.2f} deg, {way[at]:.1f} mm from where it lay")
    draw(way, needed, rows, loaded.case.title, args.out / "tilt.png")


def write(rows: list[dict[str, float]], path: Path) -> None:
    """Write the rows as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(rows)


def needed_tilt(rows: list[dict[str, float]], weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Way [mm] and the tilt [deg] that the body needs there."""
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    x = 1e-3 * columns["way_mm"]
    # The tilt of a row acts until the next one.
    push = weight * np.sin(np.radians(columns["tilt_deg"]))
    work = np.concatenate([[0.0], np.cumsum(push[:-1] * np.diff(x))])
    asked = work - columns["kinetic_J"] - columns["mass_damping_loss_J"]
    places = np.arange(0.5 * WINDOW, 1e3 * x.max() - 0.5 * WINDOW, 0.5)
    slopes = []
    for place in places:
        near = np.abs(columns["way_mm"] - place) <= 0.5 * WINDOW
        slopes.append(np.polyfit(x[near], asked[near], 1)[0])
    return places, np.degrees(np.arcsin(np.clip(np.array(slopes) / weight, -1.0, 1.0)))


def draw(
    way: np.ndarray, needed: np.ndarray, rows: list[dict[str, float]], title: str, path: Path
) -> None:
    """Plot the tilt set and the tilt needed over the way."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([r["way_mm"] for r in rows], [r["tilt_deg"] for r in rows], lw=0.8, label="set")
    axes.plot(way, needed, lw=1.8, label="needed")
    axes.set_xlabel("way of the centre [mm]")
    axes.set_ylabel("tilt [deg]")
    axes.grid(True, color="#e4e7eb")
    axes.legend(frameon=False)
    axes.set_title(title, fontsize=10)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
