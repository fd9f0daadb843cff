"""Where the time of a rolling run goes: element forces, contact, kick and the rest.

    flexapod run roll_passive && python benchmarks/rolling.py results/roll_passive

Goes on for some intervals from the checkpoint of a motion (nothing is written) and prints what the
run's own clock counted, which for a whole run stands in summary.json as `time_share`.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

import numba

from flexapod.app.case import LoadedCase, parse_case
from flexapod.app.motion_model import assemble_motion, start_shape
from flexapod.app.motion_recorder import Recorder
from flexapod.app.outputs import ResultsFolder
from flexapod.dynamics.integrator import Options, march


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="results folder of a motion")
    parser.add_argument("--intervals", type=int, default=6)
    options = parser.parse_args()
    table = tomllib.loads((options.folder / "case.resolved.toml").read_text())
    table = {k: v for k, v in table.items() if k not in ("flexapod_version", "resolved")}
    loaded = LoadedCase(parse_case(table, str(options.folder)), "roll_passive", options.folder)
    start = start_shape(loaded, options.folder, False, print)
    motion = assemble_motion(loaded, start, print, settle=False)
    recorder = Recorder(loaded, motion, ResultsFolder(options.folder))
    if not recorder.resume():
        parser.error(f"{options.folder} holds no checkpoint")
    model, work, state = motion.model, motion.work, motion.state
    assert loaded.case.dynamics is not None
    spec = loaded.case.dynamics
    pace = Options(spec.interval, spec.safety, spec.time_step)
    march(model, state, work, state.interval + 1, pace)  # compiles
    stats = march(model, state, work, state.interval + options.intervals, pace)
    total, shares = stats.clock.total(), stats.clock.shares()
    print(f"{numba.get_num_threads()} threads, {model.soft_cells.size} elements")
    print(f"{stats.steps} steps, {1e3 * total / stats.steps:.3f} ms a step")
    for part, share in sorted(shares.items(), key=lambda item: -item[1]):
        print(f"{100 * share:5.1f} %  {1e3 * share * total / stats.steps:7.3f} ms  {part}")
    contact = sum(share for part, share in shares.items() if part.startswith("contact"))
    print(f"contact together: {100 * contact:.1f} %")


if __name__ == "__main__":
    main()
