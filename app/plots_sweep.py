"""The picture of a sweep: the result over the last key, a line for each value of the rest."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
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
    label,
    new_figure,
    save_figure,
    tidy,
    title_of,
)
from flexapod.core.errors import InputError

_COLOURS = (BLUE, RED, GREEN, PURPLE, "#d08a1d", "#3aa6a6", "#7a5230", GREY)
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "<")


def plot_curves(
    title: str,
    x_label: str,
    y_label: str,
    series: Mapping[str, tuple[np.ndarray, np.ndarray]],
    references: Sequence[Mapping[str, Any]],
    path: Path,
) -> None:
    """Curves by name, and references, each with `name`, `x` and `y`, as open marks."""
    figure = new_figure(6.6, 4.4)
    axes = figure.add_subplot()
    for (name, (x, y)), colour, mark in zip(
        series.items(), itertools.cycle(_COLOURS), itertools.cycle(_MARKS), strict=False
    ):
        order = np.argsort(x, kind="stable")
        # Values of runs that failed are no numbers; the line goes on past them.
        order = order[np.isfinite(np.asarray(y, dtype=float)[order])]
        axes.plot(
            np.asarray(x)[order], np.asarray(y)[order], marker=mark, ms=4.5, lw=1.6, color=colour,
            label=name or None,
        )  # fmt: skip
    # A reference named like a curve has its colour.
    colours = dict(zip(series, itertools.cycle(_COLOURS), strict=False))
    for k, reference in enumerate(references):
        text = str(reference["name"])
        alike = [c for name, c in colours.items() if name and name in text.split()]
        colour = alike[0] if alike else "#1d2530"
        lonely = len(reference["x"]) == 1
        axes.plot(
            reference["x"], reference["y"], ls="" if lonely else "--", lw=1.0,
            marker="*" if lonely else _MARKS[k % len(_MARKS)], ms=13 if lonely else 5.5,
            mfc="white", color=colour, label=text, zorder=4,
        )  # fmt: skip
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_title(title, fontsize=11)
    tidy(axes, ticks=None)
    axes.axhline(0.0, color="#c3c9d1", lw=0.8, zorder=0.9)
    axes.margins(y=0.08)
    if len(axes.get_legend_handles_labels()[0]):
        axes.legend(frameon=False, fontsize=9)
    save_figure(figure, path)


def _heads(results: Results) -> tuple[list[str], str]:
    """Columns of the swept keys, in their order, and of the result."""
    sweep = results.case["sweep"]
    known = [*results.columns, *results.texts]
    names = [str(item["key"]).rpartition(".")[2] for item in sweep["over"]]

    def find(words: str, stem: str) -> str:
        # "actuation.interval" in seconds has the head interval_s, without a unit its own name.
        for head in known:
            if head == stem:
                return head
        for head in known:
            if head.startswith(f"{stem}_") and head != sweep["of"]:
                return head
        raise InputError(
            f'no column of "{words}"; the columns are {", ".join(known)}',
            f"{results.folder}: sweep",
        )

    keys = []
    for k, (item, name) in enumerate(zip(sweep["over"], names, strict=True)):
        # Keys that end alike are told apart by their places.
        double = [head for head in known if head.endswith(f"_{k + 1}") and head.startswith(name)]
        keys.append(double[0] if names.count(name) > 1 and double else find(item["key"], name))
    return keys, find(sweep["of"], sweep["of"])


def plot_sweep(results: Results, path: Path) -> None:
    """The result of a sweep's runs over the last swept key that is a number.

    There is a line for each combination of the other keys' values.
    """
    keys, of = _heads(results)
    where = f"{results.folder}: sweep"
    numbers = [head for head in keys if head in results.columns]
    if not numbers:
        raise InputError("none of the swept keys has numbers to draw over", where)
    if of not in results.columns:
        raise InputError(f'the result "{of}" holds texts, which cannot be drawn', where)
    along = numbers[-1]
    others = [head for head in keys if head != along]
    series: dict[str, tuple[list[float], list[float]]] = {}
    for row, (x, y) in enumerate(zip(results.columns[along], results.columns[of], strict=True)):
        xs, ys = series.setdefault(
            ", ".join(_value(results, head, row, len(others) > 1) for head in others), ([], [])
        )
        xs.append(float(x))
        ys.append(float(y))
    # A robot of a few centimetres goes millimetres.
    y_values = results.columns[of]
    small = of.endswith("_m") and not np.nanmax(np.abs(y_values), initial=0.0) >= 2.0
    factor = 1000.0 if small else 1.0
    plot_curves(
        title_of(results),
        label(along),
        label(f"{of.removesuffix('_m')}_mm" if small else of),
        {name: (np.array(x), factor * np.array(y)) for name, (x, y) in series.items()},
        [
            {**reference, "y": [factor * value for value in reference["y"]]}
            for reference in results.case["sweep"].get("reference", ())
        ],
        path,
    )


def _value(results: Results, head: str, row: int, several: bool) -> str:
    """A swept value as it names a line."""
    if head in results.texts:
        return results.texts[head][row]
    value = results.columns[head][row]
    return f"{label(head)} {value:g}" if several or not head.isalpha() else f"{head} {value:g}"
