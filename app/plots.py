"""Pictures, drawn from the files of a results folder and nothing else.

Three pictures: `curve.png` (computed beside the reference), `snapshots.png` (shapes along the
path) and `final.png` (the last shape, coloured); those of a motion are in `plots_motion`.
"""

from __future__ import annotations

import csv
import json
import re
import textwrap
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.outputs import (
    CASE_FILE,
    COLLECTION_FILE,
    CURVE_FILE,
    LINES_COLLECTION_FILE,
    SUMMARY_FILE,
    replacing,
)
from flexapod.app.plots_skin import (
    Skin,
    SkinReader,
    boundary_quads,
    colour_limits,
    draw_skins,
    renderer,
)
from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity
from flexapod.geometry.tagged import TaggedMesh

BLUE, RED, GREY = "#1f5fa8", "#c8402a", "#8a8f98"
GREEN, PURPLE = "#2e8b57", "#8e5ea2"
# The longer first: "speed_m_s" is in m/s, not in s.
_UNITS = {
    "m_s2": "m/s²", "m_s": "m/s", "kPa": "kPa", "deg": "°", "mm2": "mm²", "ml": "ml", "mm": "mm",
    "us": "µs", "mN": "mN", "N": "N", "J": "J", "ms": "ms", "s": "s", "m": "m",
}  # fmt: skip

# --------------------------------------------------------------------------- reading


@dataclass(frozen=True)
class Results:
    """A results folder as read back."""

    folder: Path
    case: dict[str, Any]
    summary: dict[str, Any]
    columns: dict[str, np.ndarray]
    fields: tuple[Path, ...]
    times: tuple[float, ...]  # of the fields: steps of a load path, seconds of a motion
    lines: tuple[Path, ...] = ()  # of shells and coils, at the same times
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)  # columns of a sweep

    @property
    def moves(self) -> bool:
        """Whether the case is a motion."""
        search = self.case.get("search")
        many = "sweep" in self.case or (search is not None and search.get("goal") != "climb")
        return "dynamics" in self.case and not many


def read_results(folder: Path) -> Results:
    """Read case, summary and curve of a results folder, and list its field files."""
    if not folder.is_dir():
        raise InputError("no such folder; give the folder of a run", str(folder))
    try:
        case = tomllib.loads((folder / CASE_FILE).read_text(encoding="utf-8"))
        with (folder / CURVE_FILE).open(encoding="utf-8", newline="") as stream:
            rows = list(csv.reader(stream))
        columns, texts = _read_columns(rows, with_texts="sweep" in case)
    except FileNotFoundError as error:
        name = Path(error.filename).name
        raise InputError(f"not a results folder: {name} is missing", str(folder)) from None
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"cannot be read: {error}", str(folder)) from None
    summary_path = folder / SUMMARY_FILE
    summary = json.loads(summary_path.read_text(encoding="utf-8")) if summary_path.is_file() else {}
    fields, lines = (
        _read_collection(folder / name) for name in (COLLECTION_FILE, LINES_COLLECTION_FILE)
    )
    return Results(
        folder,
        case,
        summary,
        columns,
        tuple(folder / name for _, name in fields),
        tuple(float(time) for time, _ in fields or lines),
        tuple(folder / name for _, name in lines),
        texts,
    )


def _read_columns(
    rows: list[list[str]], with_texts: bool
) -> tuple[dict[str, np.ndarray], dict[str, tuple[str, ...]]]:
    """Columns of numbers and, if there may be such, of texts."""
    columns: dict[str, np.ndarray] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for i, head in enumerate(rows[0]):
        values = [row[i] for row in rows[1:]]
        try:
            columns[head] = np.array([float(value) for value in values])
        except ValueError:
            if not with_texts:
                raise
            texts[head] = tuple(values)
    return columns, texts


def _read_collection(path: Path) -> list[tuple[str, str]]:
    """Times and files of a collection; none where there is none."""
    if not path.is_file():
        return []
    text = path.read_text(encoding="utf-8")
    return re.findall(r'timestep="([^"]+)".*file="([^"]+)"', text)


def cut_short(results: Results) -> bool:
    """Whether the run ended before its last load, or before the end of its motion.

    A run that was stopped while its pictures were drawn is "interrupted", but has every state.
    """
    if results.moves:
        # By its time alone: a run that was killed left no summary.
        interval = read_quantity(results.case["dynamics"]["interval"], "s")
        duration = read_quantity(results.case["dynamics"]["duration"], "s")
        return bool(results.columns["time_s"][-1] < duration - 0.5 * interval)
    if results.summary.get("status", "done") == "done":
        return False
    steps = results.columns.get("step", np.zeros(0))
    return not (steps.size and steps[-1] >= len(results.case.get("step", ())))


# --------------------------------------------------------------------------- labels


def _split(head: str) -> tuple[str, str]:
    """Name and unit of a column head; the unit is empty where there is none."""
    for unit in _UNITS:
        name = head.removesuffix(f"_{unit}")
        if name and name != head:
            return name, unit
    return head, ""


def label(head: str) -> str:
    """Axis label of a column head: ``pressure_kPa`` becomes ``pressure [kPa]``."""
    name, unit = _split(head)
    return f"{name.replace('_', ' ')} [{_UNITS[unit]}]" if unit else head.replace("_", " ")


def amount(head: str, value: float) -> str:
    """A value with its unit for a title: ``55 kPa``, ``183°``."""
    unit = _split(head)[1]
    digits = f"{0.0 if abs(value) < 1e-9 else value:.3g}"
    if not unit:
        return f"{head.replace('_', ' ')} {digits}"
    return f"{digits}°" if unit == "deg" else f"{digits} {_UNITS[unit]}"


def _axes_names(results: Results) -> tuple[str, list[str]]:
    """Columns to draw: the plot table's, else the reference's, else the natural ones."""
    plot = results.case.get("plot", {})
    reference = results.summary.get("reference") or {}
    heads = list(results.columns)
    # What was done to the body goes along the axis: pressure, else a load that is not gravity.
    causes = [name for name in heads if name.startswith("pressure")]
    causes += [name for name in heads if name.startswith("load_") and name != "load_gravity"]
    if "search" in results.case:
        causes = ["value", "gone"]
    x = plot.get("x") or reference.get("x") or [*causes, "step"][0]
    if plot.get("y"):
        y = list(plot["y"])
    elif reference.get("y"):
        y = [reference["y"]]
    else:
        y = [name for name in heads if name not in (x, *causes)][:1]
    for name in [x, *y]:
        if name not in results.columns:
            raise InputError(
                f'no column "{name}"; the columns are {", ".join(results.columns)}',
                f"{results.folder}: plot",
            )
    return x, y


# --------------------------------------------------------------------------- pictures


def new_figure(width: float, height: float) -> Any:
    """An empty figure [in] that keeps its parts apart."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Any, ticks: float | None = 8.5) -> None:
    """A light grid behind the curves, no frame above and right of them, ticks of this size [pt]."""
    axes.grid(True, color="#e4e7eb", lw=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if ticks is not None:
        axes.tick_params(labelsize=ticks)


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure as PNG, whole."""
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=160)


def title_of(results: Results) -> str:
    """The case's title, else its name."""
    return str(results.case.get("title") or results.case.get("name") or results.folder.name)


def heading_of(results: Results, more: str = "", width: int = 90) -> str:
    """The title, with `more` behind it; how the run ended, if early, on a line of its own."""
    title = title_of(results) + (f": {more}" if more else "")
    lines = textwrap.wrap(title, width) or [title]
    if cut_short(results):
        status = str(results.summary.get("status", "unfinished")).replace("_", " ")
        lines.append(f"run ended early: {status} at {results.columns['time_s'][-1]:.3g} s")
    return "\n".join(lines)


def plot_curve(results: Results, path: Path) -> None:
    """Computed curve beside the reference, with the error as a number."""
    x_name, y_names = _axes_names(results)
    figure = new_figure(6.4, 4.4)
    axes = figure.add_subplot()
    x = results.columns[x_name]
    reference = results.summary.get("reference") or {}
    if reference and reference.get("x") == x_name and reference.get("y") in y_names:
        table = [row for row in reference["table"] if row["measured"] is not None]
        points = np.array([row[x_name] for row in table])
        polynomial = results.case.get("reference", {}).get("polynomial")
        name = reference["name"]
        if polynomial and len(points):
            fine = np.linspace(points.min(), points.max(), 200)
            axes.plot(fine, np.polyval(polynomial, fine), "-", color=RED, lw=1.4, label=name)
            name = None
        axes.plot(
            points, [row["measured"] for row in table], "s", ms=4.5, mfc="white", color=RED,
            label=name,
        )  # fmt: skip
    colours = [BLUE, GREEN, PURPLE, GREY]
    for y_name, colour in zip(y_names, colours, strict=False):
        text = "computed" if len(y_names) == 1 else label(y_name)
        order = np.argsort(x, kind="stable") if "search" in results.case else slice(None)
        y = results.columns[y_name]
        axes.plot(x[order], y[order], "o-", ms=3.2, lw=1.6, color=colour, label=text)
    error = reference.get("mean_relative_error")
    lines = []
    if error is not None:
        lines.append(f"mean relative error {100 * error:.1f} %")
        if reference.get("note"):
            reached = f"{reference['points_reached']} of {reference['points']}"
            lines.append(f"over {reached} points")
    if reference.get("simulation_error") is not None:
        lines.append(f"{reference['simulation_name']}: {100 * reference['simulation_error']:.1f} %")
    if cut_short(results):
        lines.append(f"run ended: {results.summary['status'].replace('_', ' ')}")
    if lines:
        axes.text(
            0.98, 0.03, "\n".join(lines), transform=axes.transAxes, ha="right", va="bottom",
            fontsize=9, bbox={"boxstyle": "round", "fc": "white", "ec": "#cfd3d9"},
        )  # fmt: skip
    axes.set_xlabel(label(x_name))
    search = results.case.get("search")
    if search is not None and x_name == "value":
        _name_search(axes, search, results.summary["results"])
    axes.set_ylabel(label(y_names[0]) if len(y_names) == 1 else "")
    axes.set_title(title_of(results), fontsize=11)
    tidy(axes, ticks=None)
    axes.legend(frameon=False, fontsize=9, loc="upper left")
    save_figure(figure, path)


def _name_search(axes: Any, search: dict[str, Any], found: dict[str, Any]) -> None:
    """Say what was searched along x, and between which trials the answer lies."""
    axes.set_xlabel(f"{search['key']} [{found['unit']}]" if "unit" in found else search["key"])
    answer = found.get(search["result"])
    if answer is not None and {"bracket_low", "bracket_high"} <= found.keys():
        band = sorted((found["bracket_low"], found["bracket_high"]))
        text = f"{_split(search['result'])[0].replace('_', ' ')} {amount(search['result'], answer)}"
        axes.axvspan(*band, color="#e4e7eb", label=text)


def skin_reader(results: Results) -> SkinReader:
    """Reader of a folder's skins, with the colour and mirrors its case asks for."""
    plot = results.case.get("plot", {})
    return SkinReader(plot.get("colour", "stretch"), plot.get("mirror", []))


def colour_bar(figure: Any, axes: Any, limits: tuple[float, float], text: str) -> None:
    """Add a colour bar to the right of `axes`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = figure.colorbar(
        ScalarMappable(Normalize(*limits), "viridis"), ax=axes, shrink=0.7, pad=0.02, aspect=30
    )
    bar.set_label(text, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


def _chosen_states(results: Results, x_name: str) -> list[int]:
    """States nearest the wanted values of x; by default four, evenly over the path."""
    x = results.columns[x_name]
    count = min(len(x), len(results.fields))
    if count == 0:
        return []
    x = x[:count]
    wanted = results.case.get("plot", {}).get("snapshots")
    if wanted is None:
        wanted = np.linspace(x.min(), x.max(), 4) if np.ptp(x) > 0 else []
        if len(wanted) == 0:
            return sorted({int(i) for i in np.linspace(0, count - 1, 4).round()})
    chosen: list[int] = []
    for value in wanted:
        if value > x.max() + 0.5 * np.ptp(x) / max(count - 1, 1):
            continue
        # The last of equal values: with gravity settled before the pressure rises.
        index = count - 1 - int(np.argmin(np.abs(x[::-1] - value)))
        if index not in chosen:
            chosen.append(index)
    return chosen or [count - 1]


def plot_snapshots(results: Results, path: Path) -> None:
    """Shapes along the path in one common window."""
    x_name, y_names = _axes_names(results)
    chosen = _chosen_states(results, x_name)
    if not chosen:
        raise InputError("there are no fields to draw", str(results.folder))
    plot = results.case.get("plot", {})
    reader = skin_reader(results)
    skins = [reader.read(results.fields[i]) for i in chosen]
    limits = colour_limits(skins)
    images = draw_skins(skins, plot.get("view", "corner"), 700, limits, "viridis")
    height, width = images[0].shape[:2]
    columns = len(images) if height > 0.8 * width else min(2, len(images))
    rows = -(-len(images) // columns)
    each = 9.0 / max(columns, 2)
    figure = new_figure(each * columns + 1.0, rows * (each * height / width + 0.35) + 0.45)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for axes, image, index in zip(grid.ravel(), images, chosen, strict=False):
        axes.imshow(image)
        texts = [amount(name, results.columns[name][index]) for name in [x_name, y_names[0]]]
        axes.set_title(", ".join(texts), fontsize=10)
    colour_bar(figure, grid.ravel().tolist(), limits, reader.text)
    figure.suptitle(title_of(results), fontsize=11)
    save_figure(figure, path)


def plot_final(results: Results, path: Path) -> None:
    """The last state, large."""
    if not results.fields:
        raise InputError("there are no fields to draw", str(results.folder))
    plot = results.case.get("plot", {})
    reader = skin_reader(results)
    skin = reader.read(results.fields[-1])
    limits = colour_limits([skin])
    image = draw_skins([skin], plot.get("view", "corner"), 1300, limits, "viridis")[0]
    height, width = image.shape[:2]
    figure = new_figure(8.0, 7.0 * height / width + 0.5)
    axes = figure.add_subplot()
    axes.imshow(image)
    axes.set_axis_off()
    x_name, y_names = _axes_names(results)
    texts = [amount(name, results.columns[name][-1]) for name in [x_name, y_names[0]]]
    axes.set_title(f"{title_of(results)}: {', '.join(texts)}", fontsize=11)
    colour_bar(figure, axes, limits, reader.text)
    save_figure(figure, path)


def draw_all(folder: Path) -> tuple[list[Path], list[str]]:
    """Redraw every picture of a results folder; the paths, and notices about what fell short."""
    results = read_results(folder)
    if results.moves:
        from flexapod.app.plots_motion import draw_motion

        return draw_motion(results)
    if "sweep" in results.case:
        from flexapod.app.plots_sweep import plot_sweep

        plot_sweep(results, folder / "plots" / "sweep.png")
        return [folder / "plots" / "sweep.png"], []
    written: list[Path] = []
    notices: list[str] = []
    target = folder / "plots"
    plot_curve(results, target / "curve.png")
    written.append(target / "curve.png")
    if results.fields:
        notice = renderer()[1]
        if notice:
            notices.append(notice)
        for name, draw in (("snapshots", plot_snapshots), ("final", plot_final)):
            draw(results, target / f"{name}.png")
            written.append(target / f"{name}.png")
    return written, notices


def plot_mesh(mesh: TaggedMesh, path: Path, title: str, view: str = "corner") -> str | None:
    """Picture of a mesh with its surface groups coloured; a notice when drawn by matplotlib."""
    from matplotlib import colormaps
    from matplotlib.patches import Patch

    quads, owner = boundary_quads(mesh.cells)
    keys = {tuple(sorted(quad)): i for i, quad in enumerate(quads.tolist())}
    values = np.zeros(len(quads))
    names: list[str] = []
    shared = [name for name in mesh.cell_groups if len(mesh.cell_groups[name]) > 0]
    for name in shared:
        inside = np.isin(owner, mesh.cell_groups[name])
        if 0 < inside.sum() < len(quads):
            names.append(f"{name} (cells)")
            values[inside] = len(names)
    # The largest first, so that what is more particular shows on top.
    for name, group in sorted(mesh.facet_groups.items(), key=lambda item: -len(item[1])):
        index = [keys[key] for quad in group.tolist() if (key := tuple(sorted(quad))) in keys]
        if index and name not in mesh.cavities:
            names.append(name)
            values[index] = len(names)
    palette = colormaps["tab20"]
    count = max(len(names), 1)
    colours = _listed(["#c9ced6", *(palette(i % 20) for i in range(len(names)))])
    skin = Skin(mesh.nodes, quads, values)
    image = draw_skins([skin], view, 1300, (-0.5, count + 0.5), colours)[0]
    height, width = image.shape[:2]
    used = [i + 1 for i in range(len(names)) if np.any(values == i + 1)]
    rows = -(-(len(used) + 1) // 4)
    figure = new_figure(8.0, 8.0 * height / width + 0.5 + 0.22 * rows)
    axes = figure.add_subplot()
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(f"{title}: {len(mesh.cells)} hexahedra, {len(mesh.nodes)} nodes", fontsize=11)
    patches = [Patch(color=palette((i - 1) % 20), label=names[i - 1]) for i in used]
    figure.legend(
        handles=[Patch(color="#c9ced6", label="other faces"), *patches],
        loc="outside lower center",
        ncols=min(4, len(used) + 1),
        frameon=False,
        fontsize=8,
    )
    save_figure(figure, path)
    return renderer()[1]


def _listed(colours: list[Any]) -> str:
    """Register a colour map of given colours; its name, as both renderers take one."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    name = "flexapod-groups"
    colour_map = ListedColormap(colours if len(colours) > 1 else colours * 2, name=name)
    matplotlib.colormaps.register(colour_map, force=True)
    return name
