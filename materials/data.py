"""Reads tensile data as laboratories write them.

A file is text: comma, semicolon or tab between cells, decimal point or comma, any number of
metadata lines ("name; value") before one header line that names a deformation and a load with
their units. `read_test` returns stretch and nominal stress; every choice it makes is one of
the named rules of `RULES` and is written into `TensileData.notes`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexapod.core.errors import InputError, check_positive
from flexapod.core.units import unit_scale
from flexapod.materials.modes import direction
from flexapod.materials.tables import UNIT_IN_BRACKETS, parse_number, read_lines, split_cells

RULES: dict[str, str] = {
    "engineering-first": "with both engineering and true columns, the engineering ones are read",
    "stress-first": "with both stress-strain and force-displacement columns, the former are read",
    "first-column": "with several columns of one kind, the first is read",
    "unnamed-is-engineering": "columns named neither true nor engineering are engineering",
    "compression-sign": "positive values of columns named compressive are read as negative",
    "specimen": "area and gauge length come from the options, else from the metadata",
    "rest-point": "points at stretch 1 carry no information and are not fitted",
    "loading-only": "points that do not go beyond every earlier strain are dropped",
    "noisy-start": "leading points whose stress has the wrong sign are not fitted but count in R2",
    "start-offset": "an offset of the stress at zero strain is reported, not corrected",
    "failure-tail": "points after the largest stress go if it later falls under 80 % of it",
    "max-stretch": "points beyond --max-stretch are dropped",
}

_TAIL_FRACTION = 0.8
_OFFSET_FRACTION = 0.02

_RATIO_UNITS = {"", "-", "1", "mm/mm", "m/m", "in/in", "strain", "abs"}
_PERCENT_UNITS = {"%", "percent", "pct"}
# What may trail a name without brackets: "stress_MPa", "Force / N", "Strain %".
_BARE_UNIT = re.compile(
    r"(?:[\s_/,:]+)(%|mm/mm|m/m|[kMG]?Pa|psi|ksi|kgf?/(?:cm|mm)\^?2|N/mm\^?2|bar|[kM]?N|mN|gf|kgf|lbf"
    r"|[mcuµ]?m|in|inch)\s*$"
)


@dataclass(frozen=True)
class TensileData:
    """One test: stretch and nominal stress, with what was done to get them.

    `fitted` marks the points a fit uses; the others are kept for R2 on the whole data.
    """

    name: str
    mode: str  # "uniaxial" | "equibiaxial" | "planar"
    stretch: np.ndarray  # [-], shape (n,), read-only
    stress: np.ndarray  # nominal [Pa], shape (n,), read-only
    fitted: np.ndarray  # bool, shape (n,), read-only
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        direction(self.mode)
        for field in ("stretch", "stress", "fitted"):
            kind = bool if field == "fitted" else float
            array = np.array(getattr(self, field), dtype=kind)
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if not (self.stretch.shape == self.stress.shape == self.fitted.shape):
            raise InputError("stretch, stress and fitted must have one shape", self.name)
        if not (np.all(np.isfinite(self.stretch)) and np.all(self.stretch > 0.0)):
            raise InputError("stretches must be finite and > 0", self.name)
        if not np.all(np.isfinite(self.stress)):
            raise InputError("stresses must be finite", self.name)
        if int(self.fitted.sum()) < 2:
            raise InputError(
                f"has {int(self.fitted.sum())} usable points after the reading rules, needs at "
                "least 2",
                self.name,
            )


def tensile_data(name: str, mode: str, stretch: np.ndarray, stress: np.ndarray) -> TensileData:
    """Return data made in code: stretches [-] and nominal stresses [Pa], all points fitted."""
    stretch = np.asarray(stretch, dtype=float)
    return TensileData(name, mode, stretch, np.asarray(stress), np.abs(stretch - 1.0) > 1e-9)


@dataclass(frozen=True)
class _Column:
    """What a header cell says."""

    index: int
    text: str
    kind: str  # strain | stretch | stress | force | displacement
    measure: str  # true | engineering | "" (not said)
    unit: str


def read_test(
    path: str | Path,
    mode: str = "uniaxial",
    *,
    area: float | None = None,
    gauge_length: float | None = None,
    max_stretch: float | None = None,
    name: str | None = None,
) -> TensileData:
    """Read a laboratory file.

    Parameters
    ----------
    path
        The file.
    mode
        "uniaxial", "equibiaxial" or "planar".
    area, gauge_length
        Unloaded cross-section [m2] and length [m] of the specimen, for files of force and
        displacement; the metadata are searched for them otherwise.
    max_stretch
        Drop points beyond this stretch (or, for a value below 1, beyond it in compression).
    name
        Name of the data set; the file's name without it.
    """
    path = Path(path)
    label = name or path.name
    direction(mode)
    lines = read_lines(path)
    delimiter, head, columns, units_line = _find_header(lines, str(path))
    notes: list[str] = []
    deformation, load = _choose(columns, notes, f"{path}, line {head + 1}")
    if area is not None:
        check_positive("area", area, "m2", str(path))
    if gauge_length is not None:
        check_positive("gauge_length", gauge_length, "m", str(path))
    where = f"{path}, line {head + 1}"
    to_stretch = _stretch_reader(deformation, gauge_length, lines[:head], delimiter, notes, where)
    to_stress = _stress_reader(load, area, lines[:head], delimiter, notes, where)

    raw: list[tuple[int, float, float]] = []  # line number, deformation, load
    first = head + (2 if units_line else 1)
    for number, line in enumerate(lines[first:], start=first + 1):
        cells = split_cells(line, delimiter)
        if not any(cells):
            continue
        pair: list[float] = []
        for column in (deformation, load):
            cell = cells[column.index] if column.index < len(cells) else ""
            value = parse_number(cell)
            if value is None:
                raise InputError(
                    f'"{cell}" in column "{column.text}" is not a number',
                    f"{path}, line {number}",
                )
            pair.append(value)
        raw.append((number, pair[0], pair[1]))
    if not raw:
        raise InputError("no numbers under the header", where)
    signs = [1.0, 1.0]
    for k, column in enumerate((deformation, load)):
        if "compress" in column.text.lower() and np.median([row[k + 1] for row in raw]) > 0.0:
            signs[k] = -1.0
            notes.append(f'compression-sign: "{column.text}" is read as negative')
    rows: list[tuple[float, float]] = []
    for number, x, y in raw:
        l = to_stretch(signs[0] * x)  # noqa: E741
        if not (math.isfinite(l) and l > 0.0):
            raise InputError(
                f'{x:g} in column "{deformation.text}" gives the stretch {l:g}; stretches '
                "must be > 0 (is the unit right?)",
                f"{path}, line {number}",
            )
        rows.append((l, to_stress(signs[1] * y, l)))
    table = np.array(rows)
    return apply_rules(label, mode, table[:, 0], table[:, 1], max_stretch, notes)


def apply_rules(
    name: str,
    mode: str,
    stretch: np.ndarray,
    stress: np.ndarray,
    max_stretch: float | None = None,
    notes: list[str] | None = None,
) -> TensileData:
    """Apply the rules about points (see `RULES`) and note how many each one dropped."""
    said = list(notes or [])

    def note(rule: str, text: str) -> None:
        said.append(f"{name}: {rule}: {text}")

    stretch = np.asarray(stretch, dtype=float)
    stress = np.asarray(stress, dtype=float)
    keep = _loading_only(stretch)
    if not keep.all():
        note(
            "loading-only",
            f"dropped {int((~keep).sum())} of {keep.size} points that do not go beyond every "
            "earlier strain",
        )
        stretch, stress = stretch[keep], stress[keep]
    if max_stretch is not None:
        check_positive("max_stretch", max_stretch, "", name)
        keep = stretch <= max_stretch if max_stretch > 1.0 else stretch >= max_stretch
        if not keep.all():
            note("max-stretch", f"dropped {int((~keep).sum())} points beyond {max_stretch:g}")
            stretch, stress = stretch[keep], stress[keep]
    # The tail is looked for in the sense of the load: tension and compression alike.
    peak = int(np.argmax(np.abs(stress))) if stress.size else 0
    after = np.abs(stress[peak + 1 :])
    if after.size and after.min() < _TAIL_FRACTION * abs(stress[peak]):
        note(
            "failure-tail",
            f"dropped {after.size} points after the largest stress "
            f"({abs(stress[peak]) / 1e3:.4g} kPa at stretch {stretch[peak]:.4g}), where it falls "
            f"under {100 * _TAIL_FRACTION:.0f} % of it",
        )
        stretch, stress = stretch[: peak + 1], stress[: peak + 1]
    fitted = np.abs(stretch - 1.0) > 1e-9
    if not fitted.all():
        note("rest-point", f"{int((~fitted).sum())} points at stretch 1 are not fitted")
    order = np.argsort(np.abs(np.log(stretch)), kind="stable")
    wrong = 0
    for index in order:
        if not fitted[index]:
            continue
        if stress[index] * (stretch[index] - 1.0) > 0.0:
            break
        fitted[index] = False
        wrong += 1
    if wrong:
        note(
            "noisy-start",
            f"{wrong} leading points whose stress has the wrong sign are not fitted (they count "
            "in R2)",
        )
    _note_offset(stretch, stress, note)
    return TensileData(name, mode, stretch, stress, fitted, tuple(said))


def _loading_only(stretch: np.ndarray) -> np.ndarray:
    steps = np.diff(stretch)
    if np.all(steps > 0.0) or np.all(steps < 0.0):
        return np.ones(stretch.shape, dtype=bool)
    keep = np.zeros(stretch.shape, dtype=bool)
    reached = {1: -1.0, -1: -1.0}  # furthest |ln l| so far in tension and in compression
    for i, h in enumerate(np.log(stretch)):
        side = 1 if h >= 0.0 else -1
        if abs(h) > reached[side]:
            keep[i] = True
            reached[side] = abs(h)
    return keep


def _note_offset(stretch: np.ndarray, stress: np.ndarray, note: Callable[[str, str], None]) -> None:
    """Report the stress that a parabola through the first eight points has at stretch 1."""
    near = np.argsort(np.abs(stretch - 1.0), kind="stable")[:8]
    if near.size < 8 or np.abs(stretch[near] - 1.0).max() > 0.5:
        return
    _, slope, level = np.polyfit(stretch[near] - 1.0, stress[near], 2)
    largest = float(np.abs(stress).max())
    if slope > 0.0 and abs(level) > _OFFSET_FRACTION * largest:
        note(
            "start-offset",
            f"the first points point to {level / 1e3:.3g} kPa at zero strain "
            f"({100 * abs(level) / largest:.1f} % of the largest stress); not corrected",
        )


def _describe(index: int, cell: str, unit: str | None = None) -> _Column | None:
    """Read a header cell, or None if it names no quantity this module knows."""
    text = cell.strip()
    found = UNIT_IN_BRACKETS.findall(text)
    bare = _BARE_UNIT.search(text)
    said = found[-1] if found else (bare.group(1) if bare else "")
    # Brackets may also hold a remark: "Strain (true) (%)".
    words = re.sub(r"[\W_]+", " ", text.lower())
    tokens = set(words.split())
    if said.lower() in {"true", "eng", "engineering", "nominal"}:
        said = found[-2] if len(found) > 1 and said == found[-1] else ""
    said = unit if unit else said
    said = said.replace("²", "^2").replace("·", "*").strip()
    percent = said.lower() in _PERCENT_UNITS
    if "extension ratio" in words or tokens & {"stretch", "lambda", "λ", "streckung"}:
        kind = "stretch"
    elif re.search("stress|spannung|contrainte", words) or tokens & {"sigma", "σ"}:
        kind = "stress"
    elif (
        re.search("strain|dehnung", words)
        or tokens & {"deformation", "epsilon", "ε"}
        or (percent and tokens & {"extension", "elongation"})
    ):
        kind = "strain"
    elif re.search("force|kraft", words) or "load" in tokens:
        kind = "force"
    elif tokens & {"displacement", "extension", "elongation", "crosshead", "weg", "stroke"}:
        kind = "displacement"
    else:
        return None
    if tokens & {"true", "cauchy", "log", "logarithmic", "hencky"}:
        measure = "true"
    elif tokens & {"engineering", "eng", "nominal", "piola", "technical"}:
        measure = "engineering"
    else:
        measure = ""
    return _Column(index, text, kind, measure, said)


def _find_header(lines: list[str], where: str) -> tuple[str, int, list[_Column], bool]:
    """Find the delimiter and the header line: it names a deformation and a load, numbers follow."""
    seen_pair: int | None = None
    for number, line in enumerate(lines):
        for delimiter in ("\t", ";", ","):
            if delimiter not in line:
                continue
            cells = split_cells(line, delimiter)
            columns = [c for c in (_describe(i, t) for i, t in enumerate(cells)) if c]
            kinds = {c.kind for c in columns}
            if not (kinds & {"strain", "stretch", "displacement"} and kinds & {"stress", "force"}):
                continue
            needed = [c.index for c in columns]
            following = [
                x for x in lines[number + 1 : number + 8] if any(split_cells(x, delimiter))
            ]
            for skip in (0, 1):
                if len(following) <= skip:
                    break
                row = split_cells(following[skip], delimiter)
                numeric = [i < len(row) and parse_number(row[i]) is not None for i in needed]
                if sum(numeric) >= 2:
                    if skip:  # a line of units under the names
                        units = split_cells(following[0], delimiter)
                        described = (
                            _describe(
                                c.index,
                                c.text,
                                units[c.index].strip("()[] ") if c.index < len(units) else None,
                            )
                            for c in columns
                        )
                        columns = [c for c in described if c]
                    return delimiter, number, columns, bool(skip)
            seen_pair = number
    if seen_pair is not None:
        raise InputError(
            "the header is not followed by numbers in its strain and stress columns",
            f"{where}, line {seen_pair + 1}",
        )
    raise InputError(
        "no header line found that names a deformation (strain, stretch or displacement) and a "
        'load (stress or force), for example "Engineering Strain (%);Engineering Stress (MPa)"; '
        "cells are separated by comma, semicolon or tab",
        where,
    )


def _choose(columns: list[_Column], notes: list[str], where: str) -> tuple[_Column, _Column]:
    def pick(kinds: tuple[str, ...]) -> _Column | None:
        found = [c for c in columns if c.kind in kinds]
        for measure in ("engineering", "", "true"):
            same = [c for c in found if c.measure == measure]
            if not same:
                continue
            others = [c for c in found if c.measure != measure]
            if others:
                notes.append(
                    f'engineering-first: read "{same[0].text}", not '
                    + ", ".join(f'"{c.text}"' for c in others)
                )
            if len(same) > 1:
                notes.append(
                    f'first-column: read "{same[0].text}" of '
                    + ", ".join(f'"{c.text}"' for c in same)
                )
            if measure == "" and same[0].kind in ("strain", "stress"):
                notes.append(f'unnamed-is-engineering: "{same[0].text}"')
            return same[0]
        return None

    kinds = {c.kind for c in columns}
    if "stress" in kinds and kinds & {"force"}:
        notes.append("stress-first: the stress column is read, not the force")
    if kinds & {"strain", "stretch"} and "displacement" in kinds:
        notes.append("stress-first: the strain column is read, not the displacement")
    deformation = pick(("strain", "stretch")) or pick(("displacement",))
    load = pick(("stress",)) or pick(("force",))
    if deformation is None or load is None:  # _find_header has seen both
        raise InputError("needs a deformation and a load column", where)
    return deformation, load


def _scale(column: _Column, si_unit: str, example: str, where: str) -> float:
    if not column.unit:
        raise InputError(
            f'column "{column.text}" has no unit: write it in the header, for example '
            f'"{column.text} ({example})"',
            where,
        )
    unit = re.sub(r"(?i)\bkg\s*/\s*(cm|mm)", r"kgf/\1", column.unit)
    unit = {"in": "inch", "gf": "gram_force"}.get(unit, unit)
    try:
        return unit_scale(unit, si_unit)
    except Exception:
        raise InputError(
            f'"{column.unit}" of column "{column.text}" is not a unit of {column.kind}; for '
            f"example {example}",
            where,
        ) from None


def _metadata(
    lines: list[str], delimiter: str, names: tuple[str, ...], si_unit: str
) -> tuple[float, str] | None:
    """First metadata line "name (unit); value" whose name holds one of `names`."""
    for line in lines:
        cells = split_cells(line, delimiter)
        if len(cells) < 2:
            continue
        label = re.sub(r"[\W_]+", " ", cells[0].lower())
        if not any(name in label for name in names):
            continue
        unit = (UNIT_IN_BRACKETS.findall(cells[0]) or [""])[-1].replace("²", "^2")
        value_text = cells[1]
        value = parse_number(value_text)
        if value is None:
            match = re.match(r"^(\S+)\s+(\S+)$", value_text)
            value = parse_number(match.group(1)) if match else None
            unit = match.group(2).replace("²", "^2") if match else unit
        if value is None or value <= 0.0 or not unit:
            continue
        try:
            return value * unit_scale(unit, si_unit), f"{cells[0]} {cells[1]}"
        except Exception:
            continue
    return None


def _stretch_reader(
    column: _Column,
    gauge_length: float | None,
    metadata: list[str],
    delimiter: str,
    notes: list[str],
    where: str,
) -> Callable[[float], float]:
    if column.kind == "displacement":
        scale = _scale(column, "m", "mm", where)
        length = gauge_length
        if length is None:
            names = ("gauge length", "gage length", "initial length", "specimen length")
            found = _metadata(metadata, delimiter, names, "m")
            if found is None:
                raise InputError(
                    f'"{column.text}" is a displacement: give the gauge length, for example '
                    '--gauge-length "33 mm"',
                    where,
                )
            length = found[0]
            notes.append(f'specimen: gauge length {1e3 * length:g} mm from "{found[1]}"')
        gauge = length
        return lambda value: 1.0 + value * scale / gauge
    unit = column.unit.lower()
    if unit in _PERCENT_UNITS:
        factor = 0.01
    elif unit in _RATIO_UNITS:
        factor = 1.0
    else:
        raise InputError(
            f'"{column.unit}" of column "{column.text}" is not a unit of {column.kind}: use %, '
            "mm/mm or none",
            where,
        )
    if column.kind == "stretch":
        return lambda value: value * factor
    if column.measure == "true":
        return lambda value: math.exp(min(value * factor, 700.0))
    return lambda value: 1.0 + value * factor


def _stress_reader(
    column: _Column,
    area: float | None,
    metadata: list[str],
    delimiter: str,
    notes: list[str],
    where: str,
) -> Callable[[float, float], float]:
    if column.kind == "stress":
        scale = _scale(column, "Pa", "MPa", where)
        if column.measure == "true":
            # Incompressible: the area shrinks by the stretch in all three modes.
            return lambda value, stretch: value * scale / stretch
        return lambda value, _: value * scale
    scale = _scale(column, "N", "N", where)
    section = area
    if section is None:
        found = _metadata(metadata, delimiter, ("cross section", "area"), "m^2")
        if found is not None:
            section = found[0]
            notes.append(f'specimen: area {1e6 * section:g} mm2 from "{found[1]}"')
        else:
            width = _metadata(metadata, delimiter, ("width",), "m")
            thickness = _metadata(metadata, delimiter, ("thickness",), "m")
            if width is None or thickness is None:
                raise InputError(
                    f'"{column.text}" is a force: give the specimen\'s unloaded area, for '
                    'example --area "18 mm^2"',
                    where,
                )
            section = width[0] * thickness[0]
            notes.append(f'specimen: area {1e6 * section:g} mm2 = "{width[1]}" x "{thickness[1]}"')
    unloaded = section
    return lambda value, _: value * scale / unloaded
