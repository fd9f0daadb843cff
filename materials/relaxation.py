"""Reads stress-relaxation records as laboratories write them.

The same text files as in `materials.data`: comma, semicolon or tab, decimal point or comma, any
lines before one header line that names a time and a load. Only the ratios of the loads matter
for a Prony series, so stress, modulus and force are all welcome, and so are values without a
unit (divided by the first, for instance). Every choice made is one of the named rules of
`RELAXATION_RULES` and is written into `RelaxationData.notes`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexapod.core.errors import InputError, check_finite
from flexapod.core.units import unit_scale
from flexapod.materials.tables import UNIT_IN_BRACKETS, parse_number, read_lines, split_cells

RELAXATION_RULES: dict[str, str] = {
    "stress-first": "of several kinds of load, stress is read, then modulus, then force",
    "first-column": "with several columns of one kind, the first is read",
    "no-unit": "a load without a unit is a plain ratio",
    "start": "times count from --start, when the strain was reached; what lies before is dropped",
    "skip": "points sooner than --skip after the start are dropped",
    "ascending-time": "points that are not later than every earlier one are dropped",
    "ramp": "a load that still rises at first is reported, not corrected",
}

# SI unit and example by kind of load, the first wanted first.
_LOADS = {"stress": ("Pa", "kPa"), "modulus": ("Pa", "kPa"), "force": ("N", "N"), "ratio": ("", "")}
# A load that rises by more than this part of the first one is a ramp and not noise.
_RAMP_FRACTION = 0.05
# What may trail a name without brackets: "time_s", "Force / N".
_BARE_UNIT = re.compile(
    r"[\s_/,:]+(ms|us|µs|s|sec|seconds?|min|minutes?|h|hours?|[kMG]?Pa|psi|ksi|N/mm\^?2|bar|[km]?N"
    r"|kgf?/(?:cm|mm)\^?2|gf|kgf|lbf)\s*$"
)


@dataclass(frozen=True)
class RelaxationData:
    """A load that relaxes at constant strain, with what was done to get it.

    Attributes
    ----------
    kind
        "stress", "modulus", "force" or "ratio".
    unit
        SI unit of `value`: "Pa", "N" or "".
    time
        Since the strain was reached [s], ascending, shape (n,), read-only.
    value
        In `unit`, all of one sign, shape (n,), read-only.
    """

    name: str
    kind: str
    unit: str
    time: np.ndarray
    value: np.ndarray
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field in ("time", "value"):
            array = np.array(getattr(self, field), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, field, array)


@dataclass(frozen=True)
class _Column:
    """What a header cell says."""

    index: int
    text: str
    kind: str  # time | stress | modulus | force | ratio
    unit: str


def read_relaxation(
    path: str | Path,
    *,
    start: float = 0.0,
    skip: float = 0.0,
    time_unit: str | None = None,
) -> RelaxationData:
    """Read a relaxation record.

    Parameters
    ----------
    path
        The file.
    start
        The file's time when the strain was reached [s].
    skip
        Drop points sooner than this after `start` [s]: some ten times the length of the ramp.
    time_unit
        Unit of the time column; the header's if left out.
    """
    path = Path(path)
    check_finite("start", start, "s", str(path))
    if not (math.isfinite(skip) and skip >= 0.0):
        raise InputError(f"skip must be finite and >= 0, got {skip:g} s", str(path))
    lines = read_lines(path)
    delimiter, head, columns, first = _find_header(lines, str(path))
    where = f"{path}, line {head + 1}"
    notes: list[str] = []
    clock, load = _choose(columns, path.name, notes)
    per_time = _time_scale(clock, time_unit, where)
    kind, unit, per_load = _load_scale(load, path.name, notes, where)

    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines[first:], start=first + 1):
        cells = split_cells(line, delimiter)
        if not any(cells):
            continue
        pair = []
        for column in (clock, load):
            cell = cells[column.index] if column.index < len(cells) else ""
            value = parse_number(cell)
            if value is None or not math.isfinite(value):
                raise InputError(
                    f'"{cell}" in column "{column.text}" is not a number', f"{path}, line {number}"
                )
            pair.append(value)
        rows.append((pair[0] * per_time - start, pair[1] * per_load))
    table = np.array(rows).reshape(-1, 2)
    t, y = _apply_rules(path.name, table, start, skip, notes)
    if t.size and not ((y > 0.0).all() or (y < 0.0).all()):
        wrong = int(np.argmax(y <= 0.0 if np.median(y) > 0.0 else y >= 0.0))
        raise InputError(
            f"the {kind} must keep its sign, but is {y[wrong]:g} {unit}".rstrip()
            + f" at {t[wrong]:g} s; leave points out with --skip, or take off the sensor's offset",
            str(path),
        )
    return RelaxationData(path.name, kind, unit, t, y, tuple(notes))


def _apply_rules(
    name: str, table: np.ndarray, start: float, skip: float, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and loads of the rows (row_count, 2) that stay."""

    def dropped(rule: str, keep: np.ndarray, text: str) -> np.ndarray:
        if not keep.all():
            notes.append(f"{name}: {rule}: dropped {int((~keep).sum())} points {text}")
        return np.asarray(table[keep])

    table = dropped("start", table[:, 0] >= 0.0, f"before {start:g} s")
    table = dropped("skip", table[:, 0] >= skip, f"sooner than {skip:g} s after the start")
    reached = np.maximum.accumulate(np.concatenate([[-1.0], table[:-1, 0]]))[: len(table)]
    table = dropped(
        "ascending-time", table[:, 0] > reached, "that are not later than every earlier one"
    )
    t, y = table.T
    if t.size:
        peak = int(np.argmax(np.abs(y)))
        rise = abs(y[peak]) - abs(y[0])
        if rise > _RAMP_FRACTION * abs(y[0]):
            notes.append(
                f"{name}: ramp: the load rises until {start + t[peak]:.4g} s of the file; give the "
                "end of the ramp with --start, and leave out ten times its length with --skip"
            )
    return t, y


def _describe(index: int, cell: str, unit: str | None = None) -> _Column | None:
    """Read a header cell, or None if it names no quantity this module knows."""
    # "G(t)" is a name, not a unit.
    text = re.sub(r"\(\s*t\s*\)", " ", cell.strip())
    found = UNIT_IN_BRACKETS.findall(text)
    bare = _BARE_UNIT.search(text)
    said = unit or (found[-1] if found else (bare.group(1) if bare else ""))
    said = said.replace("²", "^2").strip("- ")
    words = re.sub(r"[\W_]+", " ", text.lower())
    tokens = set(words.split())
    if re.search("stress|spannung|contrainte", words) or tokens & {"sigma", "σ"}:
        kind = "stress"
    elif re.search("modul", words) or tokens & {"g", "e"}:
        kind = "modulus"
    elif re.search("force|kraft", words) or "load" in tokens:
        kind = "force"
    elif re.search("relaxation function|normali[sz]ed|ratio", words):
        kind = "ratio"
    elif tokens & {"time", "zeit", "temps", "t"}:
        kind = "time"
    else:
        return None
    return _Column(index, cell.strip(), kind, said)


def _find_header(lines: list[str], where: str) -> tuple[str, int, list[_Column], int]:
    """Delimiter, header line, its columns, and the first line of numbers."""
    seen: int | None = None
    for number, line in enumerate(lines):
        for delimiter in ("\t", ";", ","):
            if delimiter not in line:
                continue
            cells = split_cells(line, delimiter)
            columns = [c for c in (_describe(i, text) for i, text in enumerate(cells)) if c]
            kinds = {c.kind for c in columns}
            if "time" not in kinds or len(kinds) < 2:
                continue
            seen = number if seen is None else seen
            for below in (number + 1, number + 2):
                row = split_cells(lines[below], delimiter) if below < len(lines) else []
                values = [parse_number(row[c.index]) for c in columns if c.index < len(row)]
                if len([v for v in values if v is not None]) < 2:
                    continue
                if below == number + 2:  # a line of units under the names
                    units = split_cells(lines[number + 1], delimiter)
                    units += [""] * (len(cells) - len(units))
                    again = (_describe(c.index, c.text, units[c.index].strip("()[] "))
                             for c in columns)  # fmt: skip
                    columns = [c for c in again if c]
                return delimiter, number, columns, below
    if seen is not None:
        raise InputError(
            "the header is not followed by numbers in its time and load columns",
            f"{where}, line {seen + 1}",
        )
    raise InputError(
        "no header line found that names a time and a load (stress, modulus or force), for "
        'example "Time (s);Stress (kPa)"; cells are separated by comma, semicolon or tab',
        where,
    )


def _choose(columns: list[_Column], name: str, notes: list[str]) -> tuple[_Column, _Column]:
    """The column of time and that of the load."""
    loads = [kind for kind in _LOADS if any(c.kind == kind for c in columns)]
    if len(loads) > 1:
        notes.append(
            f"{name}: stress-first: read the {loads[0]}, not the {' or the '.join(loads[1:])}"
        )
    chosen = []
    for kind in ("time", loads[0]):
        same = [c for c in columns if c.kind == kind]
        if len(same) > 1:
            others = ", ".join(f'"{c.text}"' for c in same[1:])
            notes.append(f'{name}: first-column: read "{same[0].text}", not {others}')
        chosen.append(same[0])
    return chosen[0], chosen[1]


def _time_scale(column: _Column, unit: str | None, where: str) -> float:
    said = unit or column.unit
    if not said:
        raise InputError(
            f'column "{column.text}" has no unit: write it in the header, for example "Time (s)", '
            "or give --time-unit s",
            where,
        )
    try:
        return unit_scale(said, "s")
    except Exception:
        raise InputError(
            f'"{said}" is not a unit of time; for example s, ms or min', where
        ) from None


def _load_scale(column: _Column, name: str, notes: list[str], where: str) -> tuple[str, str, float]:
    """Kind of load, its SI unit and what turns the file's numbers into it."""
    si_unit, example = _LOADS[column.kind]
    if not column.unit or not si_unit:
        if si_unit:
            notes.append(f'{name}: no-unit: "{column.text}" is read as a plain ratio')
        return "ratio", "", 1.0
    unit = re.sub(r"(?i)\bkg\s*/\s*(cm|mm)", r"kgf/\1", column.unit)
    unit = {"gf": "gram_force"}.get(unit, unit)
    try:
        return column.kind, si_unit, unit_scale(unit, si_unit)
    except Exception:
        raise InputError(
            f'"{column.unit}" of column "{column.text}" is not a unit of {column.kind}; for '
            f"example {example}",
            where,
        ) from None
