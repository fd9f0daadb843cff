"""Where the time of a rolling run goes: forces, contact, kick and the rest, in one run.

    flexapod run roll_passive && python benchmarks/rolling.py results/roll_passive

Goes on for some intervals from the checkpoint of a motion (nothing is written) with a clock at
each part's door. The clocks cost about a microsecond each.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from flexapod.app.case import LoadedCase, parse_case
from flexapod.app.motion import _Recorder
from flexapod.app.motion_model import assemble_motion, start_shape
from flexapod.app.outputs import ResultsFolder
from flexapod.dynamics import contacts, integrator
from flexapod.dynamics import kernels as dynamics_kernels
from flexapod.dynamics.integrator import Options, march

SPENT: dict[str, float] = {}


def clocked(owner: Any, name: str, part: str) -> None:
    """Replace `owner.name` by itself with a clock that adds to `part`."""
    inner: Callable[..., Any] = getattr(owner, name)

    def outer(*args: Any, **kwargs: Any) -> Any:
        began = time.perf_counter()
        try:
            return inner(*args, **kwargs)
        finally:
            SPENT[part] = SPENT.get(part, 0.0) + time.perf_counter() - began

    setattr(owner, name, outer)


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
    recorder = _Recorder(loaded, motion, ResultsFolder(options.folder))
    if not recorder.resume():
        parser.error(f"{options.folder} holds no checkpoint")
    model, work = motion.model, motion.work
    assert loaded.case.dynamics is not None
    spec = loaded.case.dynamics
    pace = Options(spec.interval, spec.safety, spec.time_step)
    state = motion.state
    march(model, state, work, state.interval + 1, pace)  # compiles
    for kind in {type(contact) for contact in model.contacts}:
        label = "ground" if kind is contacts.GroundContact else "faces"
        clocked(kind, "prepare", f"contact with {label}: search and partners")
        clocked(kind, "add_forces", f"contact with {label}: forces")
    clocked(type(model.internal), "__call__", "element forces")
    clocked(dynamics_kernels, "face_pressure", "pressure on faces")
    clocked(dynamics_kernels, "gather_faces", "pressure on faces")
    clocked(integrator, "kick", "kick")
    clocked(integrator, "drift", "drift")
    clocked(integrator, "highest_frequency", "stable step")
    count, began = state.step_count, time.perf_counter()
    march(model, state, work, state.interval + options.intervals, pace)
    total = time.perf_counter() - began
    steps = state.step_count - count
    print(f"{numba.get_num_threads()} threads, {model.soft_cells.size} elements, {steps} steps")
    print(f"{1e3 * total / steps:.3f} ms a step")
    SPENT["the rest"] = total - sum(SPENT.values())
    for part, spent in sorted(SPENT.items(), key=lambda item: -item[1]):
        print(f"{100 * spent / total:5.1f} %  {1e3 * spent / steps:7.3f} ms  {part}")
    contact = sum(spent for part, spent in SPENT.items() if part.startswith("contact"))
    print(f"contact together: {100 * contact / total:.1f} %")


if __name__ == "__main__":
    main()
