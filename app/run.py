"""From a case to its results folder."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import Assembly, assemble, build_mesh, builder_options, mesh_hash
from flexapod.app.case import LoadedCase, package_version
from flexapod.app.outputs import (
    OutputState,
    ResultsFolder,
    compare,
    peak_memory,
    reference_values,
)
from flexapod.app.probes import Probe, make_probes
from flexapod.core.errors import InputError, Status

if TYPE_CHECKING:
    from flexapod.fem.static import Increment, PathState
    from flexapod.geometry.tagged import TaggedMesh


@dataclass(frozen=True)
class Progress:
    """Where a run stands, for the person who waits."""

    fraction: float  # of the whole path, 0 to 1
    step: str
    row: dict[str, float]
    is_output: bool


@dataclass(frozen=True)
class RunResult:
    """How a run ended; `summary` is what summary.json holds."""

    status: Status
    message: str
    folder: Path
    summary: dict[str, Any]


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Send whatever C libraries print to standard error: standard output is for the answer."""
    sys.stdout.flush()
    try:
        saved = os.dup(1)
    except OSError:  # no standard output at all
        yield
        return
    try:
        os.dup2(2, 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


@contextmanager
def _notices(say: Callable[[str], None]) -> Iterator[list[str]]:
    """Turn Python warnings into notices as they come, each once; yields those heard so far."""
    heard: list[str] = []
    show_others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if not issubclass(category, UserWarning):
            show_others(message, category, *where, **more)
        elif (text := str(message)) not in heard:
            heard.append(text)
            say(text)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield heard


@contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """Let SIGTERM (timeout, a cluster's queue) end a run as Ctrl-C does: with its files whole.

    Entered after the mesh is built, because Gmsh puts the signal's default action back.
    """

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    try:
        previous = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not the main thread: somebody else owns the signals
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


class _Recorder:
    """Writes states as the path accepts them."""

    def __init__(
        self,
        loaded: LoadedCase,
        parts: Assembly,
        folder: ResultsFolder,
        progress: Callable[[Progress], None],
    ) -> None:
        self.loaded = loaded
        self.parts = parts
        self.folder = folder
        self.progress = progress
        self.probes: list[Probe] = make_probes(loaded, parts.mesh)
        self.previous = {probe.head: 0.0 for probe in self.probes}
        pressures = loaded.case.pressure
        self.pressure_heads = {
            load.name: "pressure_kPa" if len(pressures) == 1 else f"pressure_{load.name}_kPa"
            for load in pressures
        }
        self.pressure_values = {load.name: load.value for load in pressures}
        self.unwritten: tuple[float, dict[str, float], dict[str, float]] | None = None
        self._unstable = False

    def row(self, time_: float, u: np.ndarray, factors: dict[str, float]) -> dict[str, float]:
        """Columns of a state; moves the rotation probes' turn count on."""
        problem = self.parts.problem
        row: dict[str, float] = {
            head: factors.get(name, 0.0) * self.pressure_values[name] / 1000.0
            for name, head in self.pressure_heads.items()
        }
        reactions = problem.reactions(u, factors)
        x = problem.positions(u)
        for probe in self.probes:
            value = probe.sample(x, reactions, self.previous[probe.head])
            self.previous[probe.head] = value
            row[probe.head] = value
        for name in problem.load_names:
            if name not in self.pressure_heads:
                row[f"load_{name}"] = factors.get(name, 0.0)
        row["step"] = time_
        return row

    def write(self, time_: float, u: np.ndarray, row: dict[str, float]) -> None:
        """Write a state with its fields."""
        problem, body = self.parts.problem, self.parts.body
        fields = body.fields(u)
        row = {
            **row,
            "largest_stretch": float(fields.principal_stretches.max()),
            "least_stretch": float(fields.principal_stretches.min()),
        }
        self._warn_unstable(row, fields.log_stretches)
        pressure = np.zeros(body.node_count)
        x = problem.positions(u)
        for contact in problem.contacts:
            pressure = np.maximum(pressure, contact.nodal_pressure(x))
        state = OutputState(
            time_,
            row,
            u,
            {"contact_pressure": pressure},
            {
                "pressure": fields.pressure,
                "principal_stretches": fields.principal_stretches,
                "cauchy_stress": fields.cauchy_stress.reshape(-1, 9),
                "material": body.material.astype(np.int32),
            },
        )
        self.folder.write_state(self.parts.mesh.nodes, self.parts.mesh.cells, state)

    def _warn_unstable(self, row: dict[str, float], log_stretches: np.ndarray) -> None:
        """Say once when points of the body leave their law's stable (Drucker) range."""
        if self._unstable:
            return
        from flexapod.materials.stability import unstable_states

        body = self.parts.body
        for index, material in enumerate(body.materials):
            cells = np.flatnonzero(body.material == index)
            bad = unstable_states(material.law, log_stretches[cells].reshape(-1, 3)).reshape(-1, 8)
            if bad.any():
                self._unstable = True
                loads = ", ".join(
                    f"{row[head]:.4g} kPa" for head in self.pressure_heads.values() if head in row
                )
                first = cells[np.flatnonzero(bad.any(axis=1))[0]]
                warnings.warn(
                    f"at {loads or 'this load'}, {int(bad.any(axis=1).sum())} elements (first "
                    f"{first}) left the stable range of {material.name!r}: the law softens there",
                    UserWarning,
                    stacklevel=2,
                )

    def start(self) -> None:
        """Write the undeformed state."""
        u = np.zeros((self.parts.body.node_count, 3))
        self.write(0.0, u, self.row(0.0, u, {}))

    def accept(self, increment: Increment) -> None:
        """Take an accepted equilibrium: write it if it is an output, and tell how far it is."""
        state = increment.state
        time_ = state.step + state.time
        row = self.row(time_, state.u, state.factors)
        if increment.is_output:
            self.write(time_, state.u, row)
            self.checkpoint(state)
            self.unwritten = None
        else:
            self.unwritten = (time_, row, dict(state.factors))
        self.progress(
            Progress(time_ / len(self.parts.steps), increment.step_name, row, increment.is_output)
        )

    def keep_last(self, state: PathState) -> None:
        """After a path that stopped between outputs: write the last equilibrium too."""
        if self.unwritten is not None:
            time_, row, _ = self.unwritten
            self.write(time_, state.u, row)
            self.unwritten = None

    def checkpoint(self, state: PathState) -> None:
        """Keep everything the path needs to go on."""
        arrays = {"u": state.u}
        if state.velocity is not None:
            arrays["velocity"] = state.velocity
        if state.bend is not None:
            arrays["bend"] = state.bend
        for index, history in enumerate(state.history):
            arrays[f"history_{index}"] = history
        about = {
            "step": state.step,
            "time": state.time,
            "factors": state.factors,
            "increment": state.increment,
            "last_size": state.last_size,
            "history_count": len(state.history),
            "damped_work": state.damped_work,
            "previous": self.previous,
            "flexapod_version": package_version(),
        }
        self.folder.write_checkpoint(arrays, about)

    def resume(self) -> PathState | None:
        """State to go on from, or None where the earlier run left none."""
        from flexapod.fem.static import PathState

        kept = self.folder.read_checkpoint()
        if kept is None:
            return None
        arrays, about = kept
        if arrays["u"].shape != (self.parts.body.node_count, 3):
            raise InputError(
                "the checkpoint is of another mesh; run without --resume", str(self.folder.path)
            )
        self.previous.update({k: v for k, v in about["previous"].items() if k in self.previous})
        return PathState(
            u=arrays["u"],
            step=about["step"],
            time=about["time"],
            factors=dict(about["factors"]),
            increment=about["increment"],
            velocity=arrays.get("velocity"),
            bend=arrays.get("bend"),
            last_size=about.get("last_size", 0.0),
            history=[arrays[f"history_{i}"] for i in range(about["history_count"])],
            damped_work=about["damped_work"],
        )


def resolve(loaded: LoadedCase, mesh: TaggedMesh | None) -> dict[str, Any]:
    """The case as it is run: all defaults, version and, with a mesh, its digest."""
    info: dict[str, Any] = {}
    if mesh is not None:
        info = {
            "mesh_hash": mesh_hash(mesh),
            "elements": len(mesh.cells),
            "nodes": len(mesh.nodes),
        }
    resolved = loaded.resolved(**info)
    sized = loaded.case.sized_mesh  # as fine as it was built, said in full
    if sized is not None and sized.builder is not None:
        resolved["mesh"] = {"builder": sized.builder, **builder_options(sized, loaded.source)}
    return resolved


def run_case(
    loaded: LoadedCase,
    out: Path,
    *,
    resume: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
    say: Callable[[str], None] = lambda _: None,
    lean: bool = False,
    start_at: Path | None = None,
) -> RunResult:
    """Run a case into a folder; a path that stops early is a status, not an exception.

    Parameters
    ----------
    loaded
        The case.
    out
        Results folder; see `ResultsFolder.open` for what may be there already.
    resume
        Go on from the folder's last checkpoint.
    progress, say
        Called with each accepted state, and with each notice.
    lean
        Of a motion: keep case, curve and summary only, without fields and pictures.
    start_at
        Of a motion: folder whose ``start`` holds the start shape (default: `out`).
    """
    with stdout_to_stderr(), _notices(say) as notices:
        if lean:
            from flexapod.app.motion import run_motion

            status, message, summary = run_motion(
                loaded, out, resume, progress, say, notices, lean, start_at
            )
            return RunResult(status, message, out, summary)
        return _run(loaded, out, resume, progress, say, notices, start_at)


def _check_files(loaded: LoadedCase) -> None:
    """Files of mesh and ground are there: asked before a results folder is made."""
    case = loaded.case
    named = [(f"contact.{k}", getattr(spec, "file", None)) for k, spec in enumerate(case.contact)]
    named.append(("mesh", None if case.mesh is None else case.mesh.file))
    for key, file in named:
        if file is not None and not loaded.path(file).is_file():
            raise InputError(f"no such file: {loaded.path(file)}", f"{loaded.source}: {key}.file")


def _run(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Progress], None],
    say: Callable[[str], None],
    notices: list[str],
    start_at: Path | None,
) -> RunResult:
    _check_files(loaded)
    if loaded.case.dynamics is not None:
        began = time.perf_counter()
        run = _moving_run(loaded, start_at)
        status, message, summary = run(loaded, out, resume, progress, say, notices)
        return _finish(ResultsFolder(out), status, message, summary, notices, say, began)
    from flexapod.fem.static import solve_path

    began = time.perf_counter()
    # The folder and the reference are checked before the mesh is built: a wrong --out or a
    # missing file should not cost a minute.
    reference, measured = loaded.case.reference, []
    if reference is not None:
        file = loaded.path(reference.file) if reference.file is not None else None
        measured = reference_values(reference, file)
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    mesh = build_mesh(loaded)
    parts = assemble(loaded, mesh)
    recorder = _Recorder(loaded, parts, folder, progress)
    if reference is not None:
        _check_columns(loaded, recorder)
    folder.write_case(resolve(loaded, mesh))
    say(f"{len(mesh.cells)} hexahedra, {len(mesh.nodes)} nodes")

    start = recorder.resume() if resume else None
    if resume and start is None:
        say("the earlier run left no checkpoint: starting from the beginning")
        folder.clear()
    if start is None:
        recorder.start()
    else:
        say(f"going on from step {start.step + start.time:.3f} of {len(parts.steps)}")
    with terminated_like_interrupted():
        result = solve_path(
            parts.problem, parts.steps, parts.options, recorder.accept, start, on_message=say
        )
    recorder.keep_last(result.state)
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": result.status.name.lower(),
        "message": result.message,
        "version": package_version(),
        "elements": len(mesh.cells),
        "nodes": len(mesh.nodes),
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "resumed": start is not None,
        "results": _results(folder, parts, result),
        "reference": compare(folder.rows, reference, measured) if reference is not None else None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return _finish(folder, result.status, result.message, summary, notices, say, began)


def _moving_run(loaded: LoadedCase, start_at: Path | None) -> Callable[..., Any]:
    """What runs a case that moves: alone, many times, or until a value is found."""
    from flexapod.app.motion import run_motion
    from flexapod.app.search import run_search
    from flexapod.app.search_climb import run_climb
    from flexapod.app.sweep import run_sweep

    if loaded.case.sweep is not None:
        return run_sweep
    if loaded.case.search is None:
        return partial(run_motion, start_at=start_at)
    return run_climb if loaded.case.search.goal == "climb" else run_search


def _finish(
    folder: ResultsFolder,
    status: Status,
    message: str,
    summary: dict[str, Any],
    notices: list[str],
    say: Callable[[str], None],
    began: float,
) -> RunResult:
    """Draw the pictures of a run whose numbers are written, and say how it ended."""
    out = folder.path
    plot_notices: list[str] = []
    try:
        from flexapod.app.plots import draw_all

        with terminated_like_interrupted():
            _, plot_notices = draw_all(out)
    except Exception as error:
        # The numbers are safe on disk; a picture that fails must not turn success into failure.
        plot_notices = [f"pictures could not be drawn: {type(error).__name__}: {error}"]
    except KeyboardInterrupt:
        reason = "" if status is Status.DONE else f"{message}; then "
        status = Status.INTERRUPTED
        message = (
            f"{reason}stopped by the user while the pictures were drawn; every number is kept, "
            f"and 'flexapod plot {out}' draws them"
        )
    for text in plot_notices:
        say(text)
    summary["status"], summary["message"] = status.name.lower(), message
    summary["warnings"] = [*notices, *plot_notices]
    summary["wall_time_s"] = time.perf_counter() - began
    summary["peak_memory_bytes"] = peak_memory()
    folder.write_summary(summary)
    return RunResult(status, message, out, summary)


def _check_columns(loaded: LoadedCase, recorder: _Recorder) -> None:
    reference = loaded.case.reference
    assert reference is not None
    heads = [*recorder.pressure_heads.values(), *(probe.head for probe in recorder.probes)]
    heads += [f"load_{n}" for n in loaded.case.load_names if n not in recorder.pressure_heads]
    heads += ["step"]
    for key in ("x", "y"):
        head = getattr(reference, key)
        if head not in heads:
            raise InputError(
                f'no column "{head}"; the columns of this case are {", ".join(heads)}',
                f"{loaded.source}: reference.{key}",
            )


def _results(folder: ResultsFolder, parts: Assembly, result: Any) -> dict[str, Any]:
    stats = result.stats
    last = folder.rows[-1] if folder.rows else {}
    results: dict[str, Any] = {
        **last,
        "states": len(folder.rows),
        "solid_mass_kg": float(parts.body.node_mass.sum()),
        "carried_mass_kg": float(parts.node_mass.sum() - parts.body.node_mass.sum()),
        "increments": stats.increments,
        "newton_iterations": stats.iterations,
        "cutbacks": stats.cutbacks,
        "damped_increments": stats.damped_increments,
        "damped_work_J": result.state.damped_work,
        "solve_time_s": stats.wall_time,
    }
    x = parts.problem.positions(result.state.u)
    contacts = {}
    for contact in parts.problem.contacts:
        report = contact.report(x)
        contacts[contact.name] = {
            "force_N": report.force,
            "area_mm2": 1e6 * report.area,
            "largest_penetration_mm": 1e3 * report.largest_penetration,
            "largest_pressure_kPa": 1e-3 * report.largest_pressure,
        }
    if contacts:
        results["contacts"] = contacts
    return results
