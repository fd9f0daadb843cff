"""``flexapod fit-relaxation``: a relaxation record in, a Prony series for a case out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexapod.app.fit import write_whole
from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity, write_quantity

if TYPE_CHECKING:
    from flexapod.materials.prony import PronyFit
    from flexapod.materials.relaxation import RelaxationData

JSON_FILE, TOML_FILE, PICTURE_FILE = "relaxation.json", "prony.toml", "relaxation.png"


@dataclass(frozen=True)
class RelaxationFit:
    """The series asked for, those with fewer terms, and what to keep in mind."""

    data: RelaxationData
    spacing: str
    fits: dict[int, PronyFit]  # by number of terms asked for; the last is the answer
    warnings: tuple[str, ...]

    @property
    def best(self) -> PronyFit:
        """The fit with as many terms as were asked for."""
        return self.fits[max(self.fits)]

    def as_json(self) -> dict[str, Any]:
        """The object ``flexapod fit-relaxation --json`` prints."""
        best, data = self.best, self.data
        shares, _ = best.prony.to_normalised()
        return {
            "prony_moduli": list(best.prony.moduli),
            "prony_times_s": list(best.prony.times),
            "shares_of_instantaneous": list(shares),
            "instantaneous_over_long_term": best.prony.instantaneous,
            "long_term": best.long_term,
            "long_term_unit": data.unit,
            "r_squared": best.r_squared,
            "rms_relative_error": best.rms_relative_error,
            "points_used": best.point_count,
            "spacing": self.spacing,
            "terms": max(self.fits),
            "fits": [
                {
                    "terms": terms,
                    "prony_moduli": list(fit.prony.moduli),
                    "prony_times_s": list(fit.prony.times),
                    "r_squared": fit.r_squared,
                    "rms_relative_error": fit.rms_relative_error,
                }
                for terms, fit in self.fits.items()
            ],
            "data": {
                "name": data.name,
                "kind": data.kind,
                "first_time_s": float(data.time[0]),
                "last_time_s": float(data.time[-1]),
            },
            "warnings": list(self.warnings),
        }

    def as_toml(self) -> str:
        """The lines a case's ``[[material]]`` takes, to six digits."""
        moduli = ", ".join(repr(_six(value)) for value in self.best.prony.moduli)
        times = ", ".join(f'"{write_quantity(_six(t), "s")}"' for t in self.best.prony.times)
        return f"prony_moduli = [{moduli}]\nprony_times = [{times}]\n"


def _six(value: float) -> float:
    return float(f"{value:.6g}")


def fit_relaxation_command(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA.csv",
            help="A relaxation test: time and stress, modulus or force at constant strain, units "
            "in the header; comma, semicolon or tab, decimal point or comma.",
            show_default=False,
        ),
    ],
    terms: Annotated[
        int, typer.Option("--terms", help="Number of branches; fewer are fitted beside it.")
    ] = 3,
    spacing: Annotated[
        str,
        typer.Option(
            "--spacing",
            help="fitted (the time constants are unknowns too) | log-spaced (spread evenly).",
        ),
    ] = "fitted",
    start: Annotated[
        str,
        typer.Option(
            "--start",
            metavar="QUANTITY",
            help="The file's time when the strain was reached: '2.5 s'.",
        ),
    ] = "0 s",
    skip: Annotated[
        str,
        typer.Option(
            "--skip",
            metavar="QUANTITY",
            help="Leave out what comes sooner than this after the start: some ten times the "
            "length of the ramp.",
        ),
    ] = "0 s",
    time_unit: Annotated[
        str | None,
        typer.Option(
            "--time-unit",
            metavar="UNIT",
            help="Unit of the time column, where the header names none: s, ms, min.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help=f"Write {TOML_FILE}, {JSON_FILE} and {PICTURE_FILE} into this folder.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object and nothing else.")
    ] = False,
) -> None:
    """Fit a Prony series (viscous branches) to a stress-relaxation test.

    Examples:

    flexapod fit-relaxation relaxation.csv --terms 3 --out results/relaxation

    flexapod fit-relaxation instron.csv --start "2.5 s" --skip "1 s" --json
    """
    if out is not None and out.exists() and not out.is_dir():
        raise InputError("--out must name a folder, but this is a file", str(out))
    result = fit_relaxation(
        data,
        terms,
        spacing,
        start=read_quantity(start, "s", "--start"),
        skip=read_quantity(skip, "s", "--skip"),
        time_unit=time_unit,
    )
    written = write_relaxation(result, out) if out is not None else []
    if as_json:
        from flexapod.app.outputs import dump_json

        typer.echo(dump_json(result.as_json()))
    else:
        _report(result, written)


def fit_relaxation(
    path: Path,
    terms: int = 3,
    spacing: str = "fitted",
    *,
    start: float = 0.0,
    skip: float = 0.0,
    time_unit: str | None = None,
) -> RelaxationFit:
    """Read a record (times in s) and fit series of 1 to `terms` branches to it."""
    from flexapod.materials.prony import fit_prony
    from flexapod.materials.relaxation import read_relaxation

    data = read_relaxation(path, start=start, skip=skip, time_unit=time_unit)
    warnings = list(data.notes)

    def fit(count: int) -> PronyFit:
        try:
            return fit_prony(data.time, data.value, count, spacing)
        except InputError as error:
            raise InputError(str(error).removeprefix("prony: "), str(path)) from None

    # The answer first: what is wrong with it is what the user must hear.
    best = fit(terms)
    fits: dict[int, PronyFit] = {}
    for count in range(1, terms):
        try:
            fits[count] = fit(count)
        except InputError as error:
            warnings.append(f"no fit with {count} terms: {error}")
    fits[terms] = best
    found = best.prony.times
    if len(found) < terms:
        warnings.append(f"the record shows {len(found)} branches, not {terms}")
    if spacing == "fitted":
        ends = (float(data.time[data.time > 0.0][0]), float(data.time[-1]))
        for end, name in zip(ends, ("first", "last"), strict=True):
            if any(math.isclose(t, end, rel_tol=1e-6) for t in found):
                warnings.append(
                    f"a time constant lies at the record's {name} time, {end:.4g} s: the record "
                    "does not tell it, only that something relaxes there or beyond"
                )
    return RelaxationFit(data, spacing, fits, tuple(warnings))


def write_relaxation(result: RelaxationFit, folder: Path) -> list[Path]:
    """Write the lines for a case, the JSON object and the picture; their paths."""
    from flexapod.app.outputs import dump_json

    head = (
        "# For a [[material]] of a case: viscous branches over the long-term law, from\n"
        f"# flexapod fit-relaxation of {result.data.name}.\n"
    )
    write_whole(folder / TOML_FILE, (head + result.as_toml()).encode())
    write_whole(folder / JSON_FILE, (dump_json(result.as_json()) + "\n").encode())
    plot_relaxation(result, folder / PICTURE_FILE)
    return [folder / name for name in (TOML_FILE, JSON_FILE, PICTURE_FILE)]


def _shown(value: float, unit: str) -> str:
    if unit == "Pa":
        return f"{value / 1e6:.4g} MPa" if abs(value) >= 1e6 else f"{value / 1e3:.4g} kPa"
    return f"{value:.4g} {unit}".rstrip()


def _report(result: RelaxationFit, written: list[Path]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    best, data = result.best, result.data
    console.print(
        f"Prony series fitted to {data.name} ({data.kind}, {best.point_count} points from "
        f"{data.time[0]:.4g} to {data.time[-1]:.4g} s)",
        markup=False,
        soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    for head in ("terms", "branches", "R2", "RMS relative error"):
        table.add_column(head, justify="right")
    for terms, fit in result.fits.items():
        counts = str(terms), str(len(fit.prony.times))
        table.add_row(*counts, f"{fit.r_squared:.6f}", f"{fit.rms_relative_error:.3%}")
    console.print(table)
    table = Table(box=None, pad_edge=False)
    for head in ("branch", "over long-term", "of instantaneous", "time constant"):
        table.add_column(head, justify="right")
    shares, times = best.prony.to_normalised()
    for k, (modulus, share, time) in enumerate(
        zip(best.prony.moduli, shares, times, strict=True), start=1
    ):
        table.add_row(str(k), f"{modulus:.5g}", f"{share:.2%}", f"{time:.5g} s")
    console.print(table)
    console.print(
        f"long-term {data.kind} = {_shown(best.long_term, data.unit)}   instantaneous over "
        f"long-term = {best.prony.instantaneous:.5g}   R2 = {best.r_squared:.6f}",
        markup=False,
        soft_wrap=True,
    )
    console.print("\nfor a [[material]] of a case:", markup=False)
    console.print(result.as_toml(), markup=False, soft_wrap=True, end="")
    for warning in result.warnings:
        console.print("[yellow]note[/yellow] ", end="")
        console.print(warning, markup=False, soft_wrap=True)
    for path in written:
        console.print(f"wrote {path}", markup=False, soft_wrap=True)


def plot_relaxation(result: RelaxationFit, path: Path) -> None:
    """Draw data and fits over the time since the start, and what is left between them."""
    import io

    import numpy as np

    from flexapod.app.plots import BLUE, GREY, RED, new_figure

    best, data = result.best, result.data
    largest = float(np.abs(data.value).max())
    scale, unit = {"Pa": (1e3, "kPa"), "N": (1.0, "N")}.get(data.unit, (1.0, "-"))
    if data.unit == "Pa" and largest >= 1e6:
        scale, unit = 1e6, "MPa"
    t, y = data.time, data.value
    later = t > 0.0  # on a logarithmic axis
    fine = np.geomspace(t[later][0], t[-1], 400)

    figure = new_figure(7.4, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.6, 1.0])
    for terms, fit in result.fits.items():
        last = fit is best
        upper.plot(
            fine,
            fit.long_term * fit.prony.relaxation(fine) / scale,
            color=BLUE if last else GREY,
            lw=1.9 if last else 1.0,
            ls="-" if last else ("--", "-.", ":")[terms % 3],
            label=f"{terms} term{'s' if terms > 1 else ''}, R² = {fit.r_squared:.5f}",
            zorder=4 if last else 2,
        )
    # The readings are drawn evenly along the axis: there are far more of them at long times.
    places = np.searchsorted(t[later], np.geomspace(t[later][0], t[-1], 120))
    some = np.flatnonzero(later)[np.unique(np.minimum(places, int(later.sum()) - 1))]
    shown = f" (1 of {math.ceil(t.size / some.size)} points)" if some.size < later.sum() else ""
    upper.plot(
        t[some], y[some] / scale, "o", ms=3.8, mfc="white", mec=RED, mew=0.9, ls="none",
        label=data.name + shown, zorder=3,
    )  # fmt: skip
    upper.axhline(best.long_term / scale, color=BLUE, lw=0.9, ls=":")
    upper.annotate(
        "long-term", (0.0, best.long_term / scale), xycoords=("axes fraction", "data"),
        xytext=(4, 2), textcoords="offset points", ha="left", va="bottom", fontsize=8, color=BLUE,
    )  # fmt: skip
    low, high = upper.get_ylim()
    for k, tau in enumerate(best.prony.times, start=1):
        for axes in (upper, lower):
            axes.axvline(tau, color=BLUE, lw=0.8, alpha=0.35)
        upper.text(tau, high, f" τ{k}", fontsize=8.5, color=BLUE, va="top")
    upper.set_ylim(low, high)
    upper.set_ylabel(f"{data.kind} [{unit}]")
    upper.legend(frameon=False, fontsize=8.5)

    left = 100.0 * (y - best.long_term * best.prony.relaxation(t)) / y
    lower.plot(t[later], left[later], ".", ms=2.5, mew=0, alpha=0.5, color=RED)
    lower.axhline(0.0, color=BLUE, lw=1.0)
    lower.set_ylabel("residual [%]")
    lower.set_xlabel("time since the strain was reached [s]")
    lower.set_xscale("log")
    for axes in (upper, lower):
        axes.grid(True, color="#e4e7eb", lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(
        f"Relaxation: {len(best.prony.times)} branches, instantaneous over long-term "
        f"{best.prony.instantaneous:.3g}, RMS relative error {100 * best.rms_relative_error:.2f} %",
        fontsize=11,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=160)
    write_whole(path, buffer.getvalue())
