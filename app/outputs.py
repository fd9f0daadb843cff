"""The results folder: what a run leaves on disk, each file whole at any moment.

::

    case.resolved.toml   the case as it was run: defaults filled in, version, mesh hash
    curve.csv            one row per output state; the heads carry units
    summary.json         status, sizes, time, memory, results, comparison with the reference
    fields.pvd           collection ParaView opens; fields/state_0000.vtu and on
    rigid.pvd            the same of the surfaces of rigid bodies; fields/rigid_0000.vtu and on
    lines.pvd            the same of shells and coils made of lines; fields/lines_0000.vtu and on
    plots/*.png          drawn from the files above
    checkpoint.h5        the last accepted state, for --resume

A body without hexahedra has no fields.pvd; its states are numbered all the same. A file is written
beside its place and renamed, so a run that is killed leaves the previous version and not half of
the next.
"""

from __future__ import annotations

import csv
import json
import math
import os
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.core.errors import InputError

CASE_FILE = "case.resolved.toml"
CURVE_FILE = "curve.csv"
SUMMARY_FILE = "summary.json"
CHECKPOINT_FILE = "checkpoint.h5"
COLLECTION_FILE = "fields.pvd"
RIGID_COLLECTION_FILE = "rigid.pvd"
LINES_COLLECTION_FILE = "lines.pvd"
# What the files of a state in fields/ begin with, and the collection that lists them.
_COLLECTIONS = {
    "state": COLLECTION_FILE,
    "rigid": RIGID_COLLECTION_FILE,
    "lines": LINES_COLLECTION_FILE,
}
PLOT_FILES = (
    "curve.png",
    "snapshots.png",
    "final.png",
    "energy.png",
    "contact.png",
    "animation.gif",
    "voltage.png",
    "sweep.png",
)


@dataclass(frozen=True)
class OutputSurface:
    """Surfaces of rigid bodies as they are written beside a state.

    Attributes
    ----------
    nodes
        Positions at the start [m], shape (node_count, 3).
    faces
        Corner quadruples, outward, shape (face_count, 4).
    displacement
        Of the nodes [m], shape (node_count, 3).
    point_data, cell_data
        Further fields by name, first axis nodes or faces.
    """

    nodes: np.ndarray
    faces: np.ndarray
    displacement: np.ndarray
    point_data: dict[str, np.ndarray] = field(default_factory=dict)
    cell_data: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputLines:
    """Shells and coils made of lines as they are written beside a state.

    Pictures read the cell fields ``coil`` (-1 for a segment of a shell, else the coil's row),
    ``on`` (1 while there is voltage), ``active_force`` and ``force`` (in all, as tension) [N] and
    ``elongation`` [m].

    Attributes
    ----------
    nodes
        Positions at the start [m], shape (node_count, 3).
    lines
        Node pairs, shape (line_count, 2).
    displacement
        Of the nodes [m], shape (node_count, 3).
    point_data, cell_data
        Further fields by name, first axis nodes or lines.
    """

    nodes: np.ndarray
    lines: np.ndarray
    displacement: np.ndarray
    point_data: dict[str, np.ndarray] = field(default_factory=dict)
    cell_data: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputState:
    """One state of the load path as it is written.

    Attributes
    ----------
    time
        Step index plus the fraction of the step, 0 at the start; ParaView's time.
    row
        Column head of curve.csv to value.
    displacement
        Nodal displacements [m], shape (node_count, 3).
    point_data, cell_data
        Further fields by name, first axis nodes or cells.
    rigid
        Surfaces of rigid bodies; None without.
    lines
        Shells and coils made of lines; None without.
    """

    time: float
    row: Mapping[str, float | str]
    displacement: np.ndarray
    point_data: dict[str, np.ndarray] = field(default_factory=dict)
    cell_data: dict[str, np.ndarray] = field(default_factory=dict)
    rigid: OutputSurface | None = None
    lines: OutputLines | None = None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path to write to that takes the place of `path` when the block ends well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The suffix is kept: writers choose the format by it.
    partial = path.with_name(f".{path.stem}.partial-{os.getpid()}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def clean_json(value: Any) -> Any:
    """Plain JSON types; a NaN or infinity, which JSON has no word for, becomes null."""
    if isinstance(value, Mapping):
        return {str(key): clean_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return clean_json(value.tolist())
    if isinstance(value, list | tuple):
        return [clean_json(item) for item in value]
    if isinstance(value, bool | str) or value is None:
        return value
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return str(value)


def dump_json(value: Any) -> str:
    """JSON text of `clean_json`."""
    return json.dumps(clean_json(value), indent=2, allow_nan=False)


def peak_memory() -> int:
    """Largest resident memory of this process so far [bytes]."""
    try:
        import resource
    except ImportError:  # Windows
        import psutil

        info = psutil.Process().memory_info()
        return int(getattr(info, "peak_wset", info.rss))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def same_case(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """Keys of two resolved cases that differ, run information and pictures left out."""
    ignored = {"resolved", "plot", "reference", "paper", "title", "name"}
    return sorted(
        key for key in (a.keys() | b.keys()) - ignored if clean_json(a.get(key)) != b.get(key)
    )


class ResultsFolder:
    """A folder of one run; `open` decides what may be replaced."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self.times: list[float] = []

    # ------------------------------------------------------------------ opening

    @staticmethod
    def is_results(path: Path) -> bool:
        """Whether a run of this package made the folder."""
        try:
            table = tomllib.loads((path / CASE_FILE).read_text(encoding="utf-8"))
        except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError):
            return False
        return "flexapod_version" in table.get("resolved", {})

    @staticmethod
    def finished(path: Path) -> dict[str, Any] | None:
        """The resolved case of a run that reached its end in the folder; None without."""
        try:
            summary = json.loads((path / SUMMARY_FILE).read_text(encoding="utf-8"))
            table = tomllib.loads((path / CASE_FILE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        done = summary.get("status") == "done" and (path / CHECKPOINT_FILE).is_file()
        return table if done else None

    @classmethod
    def open(cls, path: Path, resolved: dict[str, Any], *, resume: bool) -> ResultsFolder:
        """Take a folder for a run, or say why not (`InputError`).

        A folder that does not exist or is empty is made; one an earlier run made is replaced,
        file by file, and nothing else in it is touched; any other folder is refused.
        With `resume` the earlier run is kept, if it was of the same case.
        """
        folder = cls(path)
        if path.exists() and not path.is_dir():
            raise InputError("is a file; give a folder", f"--out {path}")
        if path.is_dir() and any(path.iterdir()):
            if not cls.is_results(path):
                raise InputError(
                    "holds files but no flexapod results, and nothing is overwritten unasked; "
                    "give a new or empty folder, or the results folder of an earlier run",
                    f"--out {path}",
                )
            if resume:
                old = tomllib.loads((path / CASE_FILE).read_text(encoding="utf-8"))
                differing = same_case(resolved, old)
                if differing:
                    raise InputError(
                        f"the run there was of another case: {', '.join(differing)} differ; "
                        "run without --resume, or into another folder",
                        f"--out {path}",
                    )
            else:
                folder.clear()
        elif resume:
            raise InputError("nothing to resume there", f"--out {path}")
        try:
            (path / "fields").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}", f"--out {path}") from None
        folder.write_case(resolved)
        return folder

    def clear(self) -> None:
        """Remove the files of an earlier run, and only those."""
        for name in (CURVE_FILE, SUMMARY_FILE, CHECKPOINT_FILE, *_COLLECTIONS.values()):
            (self.path / name).unlink(missing_ok=True)
        for kind in _COLLECTIONS:
            for file in (self.path / "fields").glob(f"{kind}_*.vtu"):
                file.unlink()
        for name in PLOT_FILES:
            (self.path / "plots" / name).unlink(missing_ok=True)

    # ------------------------------------------------------------------ writing

    def write_case(self, resolved: dict[str, Any]) -> None:
        """Write case.resolved.toml."""
        import tomli_w

        head = "# Written by flexapod: the case as it was run. It can be run again.\n"
        write_text(self.path / CASE_FILE, head + tomli_w.dumps(clean_json(resolved)))

    def write_state(self, nodes: np.ndarray, cells: np.ndarray, state: OutputState) -> None:
        """Append a state: its fields, the collections, the row of curve.csv.

        Without cells, shape (0, 8), there is no file of them. What the first state has, surfaces
        and lines too, all must have: the collections list one file per state.
        """
        index = len(self.times)
        fields = self.path / "fields"
        if len(cells):
            write_vtu(fields / f"state_{index:04d}.vtu", nodes, cells, state)
        if (rigid := state.rigid) is not None:
            write_vtu(fields / f"rigid_{index:04d}.vtu", rigid.nodes, rigid.faces, rigid)
        if (lines := state.lines) is not None:
            write_vtu(fields / f"lines_{index:04d}.vtu", lines.nodes, lines.lines, lines)
        self.times.append(state.time)
        self._write_collection()
        self.write_row(state.row)

    def write_row(self, row: Mapping[str, float | str]) -> None:
        """Append a row to curve.csv, without fields; texts are written as they are."""
        self.rows.append(dict(row))
        self._write_curve()

    def keep(self, rows: Sequence[Mapping[str, float | str]], times: Sequence[float]) -> None:
        """Go back to the states of a checkpoint; later ones are dropped."""
        self.rows = [dict(row) for row in rows]
        self.times = [float(time) for time in times]
        for kind in _COLLECTIONS:
            for file in (self.path / "fields").glob(f"{kind}_*.vtu"):
                if int(file.stem.removeprefix(f"{kind}_")) >= len(self.times):
                    file.unlink()
        self._write_collection()
        self._write_curve()

    def _write_collection(self) -> None:
        for kind, name in _COLLECTIONS.items():
            if (self.path / "fields" / f"{kind}_0000.vtu").is_file():
                self._write_one_collection(name, kind)
            else:
                (self.path / name).unlink(missing_ok=True)

    def _write_one_collection(self, name: str, kind: str) -> None:
        entries = "\n".join(
            f'    <DataSet timestep="{time:.9g}" part="0" file="fields/{kind}_{index:04d}.vtu"/>'
            for index, time in enumerate(self.times)
        )
        write_text(
            self.path / name,
            '<?xml version="1.0"?>\n'
            '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            f"  <Collection>\n{entries}\n  </Collection>\n</VTKFile>\n",
        )

    def _write_curve(self) -> None:
        if not self.rows:
            (self.path / CURVE_FILE).unlink(missing_ok=True)
            return
        heads = list(self.rows[0])
        with (
            replacing(self.path / CURVE_FILE) as partial,
            partial.open("w", encoding="utf-8", newline="") as stream,
        ):
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(heads)
            for row in self.rows:
                values = [row[head] for head in heads]
                writer.writerow([v if isinstance(v, str) else f"{v:.10g}" for v in values])

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write summary.json."""
        write_text(self.path / SUMMARY_FILE, dump_json(summary) + "\n")

    # ------------------------------------------------------------------ checkpoint

    def write_checkpoint(self, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> None:
        """Keep the solver's state beside the rows it belongs to."""
        import h5py

        with replacing(self.path / CHECKPOINT_FILE) as partial, h5py.File(partial, "w") as file:
            file.attrs["about"] = json.dumps(clean_json(about))
            # Rows as text of full precision: curve.csv rounds, a resumed run must not.
            file.attrs["rows"] = json.dumps([clean_json(row) for row in self.rows])
            file.attrs["times"] = np.array(self.times)
            group = file.create_group("state")
            for name, array in arrays.items():
                group.create_dataset(name, data=np.asarray(array))

    def read_checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """State and remarks of the last checkpoint, the folder set back to it; None without."""
        import h5py

        path = self.path / CHECKPOINT_FILE
        if not path.is_file():
            return None
        try:
            with h5py.File(path, "r") as file:
                about = json.loads(file.attrs["about"])
                rows = json.loads(file.attrs["rows"])
                times = file.attrs["times"]
                arrays = {name: np.asarray(data) for name, data in file["state"].items()}
        except (OSError, KeyError, ValueError) as error:
            raise InputError(f"cannot be resumed from: {error}", str(path)) from None
        rows = [{k: math.nan if v is None else v for k, v in row.items()} for row in rows]
        self.keep(rows, times)
        return arrays, about


def write_vtu(
    path: Path,
    nodes: np.ndarray,
    cells: np.ndarray,
    state: OutputState | OutputSurface | OutputLines,
) -> None:
    """Write hexahedra, quadrilaterals or lines for ParaView: compressed binary, fields in single.

    Which of them the number of nodes per cell says.
    """
    import meshio

    def single(array: np.ndarray) -> np.ndarray:
        array = np.asarray(array)
        return array.astype(np.float32) if array.dtype.kind == "f" else array

    mesh = meshio.Mesh(
        nodes,
        [({8: "hexahedron", 4: "quad", 2: "line"}[cells.shape[1]], cells)],
        point_data={
            "displacement": single(state.displacement),
            **{name: single(data) for name, data in state.point_data.items()},
        },
        cell_data={name: [single(data)] for name, data in state.cell_data.items()},
    )
    with replacing(path) as partial:
        meshio.write(partial, mesh, file_format="vtu", binary=True, compression="zlib")


# --------------------------------------------------------------------------- comparison


def interpolate_path(x: np.ndarray, y: np.ndarray, at: float) -> float | None:
    """Value of `y` where the path first passes ``x = at``; None where it never does.

    Along the path, not over sorted x: a pressure may fall and rise again past a limit point.
    """
    if len(x) and math.isclose(x[0], at, rel_tol=1e-9, abs_tol=1e-12):
        return float(y[0])
    for i in range(len(x) - 1):
        lo, hi = sorted((x[i], x[i + 1]))
        slack = 1e-9 * max(abs(lo), abs(hi))
        if lo - slack <= at <= hi + slack and hi > lo:
            return float(y[i] + (y[i + 1] - y[i]) * (at - x[i]) / (x[i + 1] - x[i]))
    return None


def beside_paper(said: Mapping[str, str], results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What a case's source says beside what came out, for summary.json."""
    return [
        {"result": name, "paper": words, "ours": results.get(name)} for name, words in said.items()
    ]


def read_reference_csv(path: Path, x: str, y: str) -> tuple[np.ndarray, np.ndarray]:
    """Columns `x` and `y` of a CSV file whose heads are their names."""
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(line for line in stream if not line.startswith("#"))
            heads = [head.strip() for head in reader.fieldnames or []]
            reader.fieldnames = heads
            missing = [name for name in (x, y) if name not in heads]
            if missing:
                raise InputError(
                    f"has no column {', '.join(missing)}; its heads are {', '.join(heads)}",
                    str(path),
                )
            pairs = [(float(row[x]), float(row[y])) for row in reader]
    except (OSError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot be read as a reference: {error}", str(path)) from None
    array = np.array(pairs).reshape(-1, 2)
    return array[:, 0], array[:, 1]


def compare(
    rows: Sequence[Mapping[str, float]],
    reference: Any,
    measured: Sequence[float | None],
) -> dict[str, Any]:
    """Compare a curve with its reference at the reference's points.

    The mean of ``|computed - measured| / |measured|`` over the points the run reached; `reached`
    says how many. `reference` is a `flexapod.app.case.ReferenceSpec`.
    """
    heads = list(rows[0]) if rows else []
    for head in (reference.x, reference.y):
        if rows and head not in heads:
            raise InputError(
                f'no column "{head}"; the columns of this case are {", ".join(heads)}', "reference"
            )
    x = np.array([row[reference.x] for row in rows])
    y = np.array([row[reference.y] for row in rows])
    table: list[dict[str, float | None]] = []
    errors: list[float] = []
    for point, value in zip(reference.points, measured, strict=True):
        computed = interpolate_path(x, y, point)
        error = None
        if computed is not None and value:
            error = abs(computed - value) / abs(value)
            errors.append(error)
        table.append(
            {reference.x: point, "measured": value, "computed": computed, "relative_error": error}
        )
    result: dict[str, Any] = {
        "name": reference.name,
        "x": reference.x,
        "y": reference.y,
        "mean_relative_error": float(np.mean(errors)) if errors else None,
        "points": len(table),
        "points_reached": len(errors),
        "table": table,
    }
    if len(errors) < len(table):
        result["note"] = (
            f"the mean is over {len(errors)} of {len(table)} points: the run did not reach the rest"
        )
    if reference.simulation_error is not None:
        result["simulation_name"] = reference.simulation_name or "simulation of the source"
        result["simulation_error"] = reference.simulation_error
    return result


def reference_values(reference: Any, file: Path | None) -> list[float | None]:
    """Reference value at each comparison point; None outside a CSV file's range."""
    if reference.polynomial is not None:
        return [float(np.polyval(reference.polynomial, point)) for point in reference.points]
    assert file is not None
    x, y = read_reference_csv(file, reference.x, reference.y)
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    return [
        float(np.interp(point, x, y)) if len(x) and x[0] <= point <= x[-1] else None
        for point in reference.points
    ]
