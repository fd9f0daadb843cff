"""``flexapod fit``: laboratory files in, a law with its certificate out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity, write_quantity

if TYPE_CHECKING:
    from flexapod.materials.fit import FitResult


_PICTURES = (".png", ".svg", ".pdf")
_PICTURES_TEXT = ".png, .svg or .pdf"


def fit_command(
    data: Annotated[
        Path | None,
        typer.Argument(
            metavar="DATA.csv",
            help="A uniaxial test as the laboratory wrote it: comma, semicolon or tab, decimal "
            "point or comma, metadata before the header, units in the header.",
            show_default=False,
        ),
    ] = None,
    uniaxial: Annotated[
        list[Path] | None,
        typer.Option("--uniaxial", metavar="F", help="A further uniaxial test (repeatable)."),
    ] = None,
    equibiaxial: Annotated[
        list[Path] | None,
        typer.Option("--equibiaxial", metavar="F", help="An equibiaxial test (repeatable)."),
    ] = None,
    planar: Annotated[
        list[Path] | None,
        typer.Option("--planar", metavar="F", help="A planar (pure shear) test (repeatable)."),
    ] = None,
    model: Annotated[
        str, typer.Option("--model", help="ogden | neo-hooke | mooney-rivlin | yeoh.")
    ] = "ogden",
    terms: Annotated[
        int | None,
        typer.Option(
            "--terms", help="Number of terms of ogden or yeoh (3 if left out).", show_default=False
        ),
    ] = None,
    max_stretch: Annotated[
        float | None,
        typer.Option(
            "--max-stretch",
            help="Leave out points beyond this stretch, for example 3.",
            show_default=False,
        ),
    ] = None,
    weights: Annotated[
        str,
        typer.Option(
            "--weights", help="absolute (misfit in stress) | relative (misfit over stress)."
        ),
    ] = "absolute",
    stable: Annotated[
        bool,
        typer.Option(
            "--stable",
            help="Ask for a law stable in every mode up to the data's largest deformation.",
        ),
    ] = False,
    area: Annotated[
        str | None,
        typer.Option(
            "--area",
            metavar="QUANTITY",
            help="Unloaded section of the specimen, for files of force: '18 mm^2'.",
            show_default=False,
        ),
    ] = None,
    gauge_length: Annotated[
        str | None,
        typer.Option(
            "--gauge-length",
            metavar="QUANTITY",
            help="Unloaded length, for files of displacement: '33 mm'.",
            show_default=False,
        ),
    ] = None,
    density: Annotated[
        str | None,
        typer.Option(
            "--density",
            metavar="QUANTITY",
            help="Written into --out, for simulations: '1080 kg/m^3'.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="material.toml",
            help="Write the law as a material that a case can use.",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot",
            metavar="fit.png",
            help="Draw data, curves, the band of the other modes, and the stable range.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object and nothing else.")
    ] = False,
) -> None:
    """Fit a hyperelastic law to one or several tensile tests at once.

    Examples:

    flexapod fit tensile.csv --terms 3 --plot fit.png

    flexapod fit tensile.csv --stable --density "1080 kg/m^3" --out material.toml

    flexapod fit --uniaxial ut.csv --equibiaxial et.csv --planar ps.csv --weights relative

    flexapod fit instron.csv --area "18 mm^2" --gauge-length "33 mm" --json
    """
    if out is not None and out.suffix.lower() != ".toml":
        raise InputError(f"--out must name a .toml file, got {out.name}", str(out))
    if plot is not None and plot.suffix.lower() not in _PICTURES:
        raise InputError(f"--plot must name a {_PICTURES_TEXT} file, got {plot.name}", str(plot))
    mass_density = read_quantity(density, "kg/m^3", "--density") if density is not None else None
    result = fit_files(
        uniaxial=([data] if data is not None else []) + list(uniaxial or []),
        equibiaxial=list(equibiaxial or []),
        planar=list(planar or []),
        model=model,
        terms=terms,
        max_stretch=max_stretch,
        weights=weights,
        stable=stable,
        area=read_quantity(area, "m^2", "--area") if area is not None else None,
        gauge_length=(
            read_quantity(gauge_length, "m", "--gauge-length") if gauge_length is not None else None
        ),
    )
    if out is not None:
        write_material(result, out, mass_density)
    if plot is not None:
        plot_fit(result, plot)
    if as_json:
        typer.echo(json.dumps(result.as_json(), allow_nan=False, indent=1))
    else:
        _report(result, [p for p in (out, plot) if p is not None])


def fit_files(
    *,
    uniaxial: list[Path],
    equibiaxial: list[Path],
    planar: list[Path],
    model: str = "ogden",
    terms: int | None = None,
    max_stretch: float | None = None,
    weights: str = "absolute",
    stable: bool = False,
    area: float | None = None,
    gauge_length: float | None = None,
) -> FitResult:
    """Read the files (SI options) and fit one law to all of them.

    A data set is named after its file, or its whole path where two files share a name.
    """
    from flexapod.materials.data import read_test
    from flexapod.materials.fit import fit_law

    tests = [("uniaxial", p) for p in uniaxial]
    tests += [("equibiaxial", p) for p in equibiaxial]
    tests += [("planar", p) for p in planar]
    if not tests:
        raise InputError(
            "needs a data file: flexapod fit DATA.csv, or --uniaxial, --equibiaxial, --planar"
        )
    names = [path.name for _, path in tests]
    sets = [
        read_test(
            path,
            mode,
            area=area,
            gauge_length=gauge_length,
            max_stretch=max_stretch,
            name=path.name if names.count(path.name) == 1 else str(path),
        )
        for mode, path in tests
    ]
    return fit_law(sets, model, terms, weights=weights, stable=stable)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    from flexapod.app.outputs import replacing

    try:
        with replacing(path) as partial:
            partial.write_bytes(content)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", str(path)) from None


def material_table(result: FitResult, name: str, density: float | None = None) -> dict[str, Any]:
    """Return the law in the words of a case's material, with where it comes from."""
    law = result.law
    table: dict[str, Any] = {"name": name, "model": law.name}
    for word, values in law.coefficients().items():
        table[word] = [float(v) if word == "alpha" else write_quantity(v, "Pa") for v in values]
    if density is not None:
        table["density"] = write_quantity(density, "kg/m^3")
    table["poisson"] = 0.499
    table["source"] = "flexapod fit of " + ", ".join(f"{d.name} ({d.mode})" for d in result.data)
    table["fit"] = {
        "shear_modulus": write_quantity(law.shear_modulus, "Pa"),
        "r_squared": result.r_squared,
        "rms_relative_error": result.rms_relative_error,
        "weights": result.weights,
        "stable_requested": result.stable_requested,
        "stable_stretch": {mode: r.as_list() for mode, r in result.stable.items()},
        "data_stretch": {
            d.name: [float(d.stretch.min()), float(d.stretch.max())] for d in result.data
        },
    }
    return table


def write_material(result: FitResult, path: Path, density: float | None = None) -> None:
    """Write the law as a material file that `flexapod.materials.library` reads."""
    import tomli_w

    text = tomli_w.dumps(material_table(result, path.stem, density))
    write_whole(path, text.encode())


def _report(result: FitResult, written: list[Path]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    law = result.law
    names = ", ".join(f"{d.name} ({d.mode}, {int(d.fitted.sum())} points)" for d in result.data)
    console.print(f"[bold]{law.name}[/bold] fitted to {names}", highlight=False)

    errors = result.certificate.standard_errors
    table = Table(box=None, pad_edge=False)
    table.add_column("coefficient")
    table.add_column("value", justify="right")
    table.add_column("standard error", justify="right")
    for word, values in law.coefficients().items():
        unit = "" if word == "alpha" else " Pa"
        for k, value in enumerate(values):
            known = errors.get(word, [])
            error = f"{known[k]:.3g}{unit}" if k < len(known) else ""
            table.add_row(f"{word}[{k + 1}]", f"{value:.6g}{unit}", error)
    console.print(table)
    console.print(
        f"G = {law.shear_modulus / 1e3:.4g} kPa   E = {result.youngs_modulus / 1e3:.4g} kPa   "
        f"R2 = {result.r_squared:.6f}   RMS relative error = {result.rms_relative_error:.2%}   "
        f"condition = {result.certificate.condition_number:.1e}",
        highlight=False,
    )
    table = Table(box=None, pad_edge=False)
    for head in ("mode", "stable from", "to", "near-equal fits differ by"):
        table.add_column(head, justify="left" if head == "mode" else "right")
    for mode, stable in result.stable.items():
        ends = [
            f"{value:.4g}" + ("" if limit == "instability" else " (search range)")
            for value, limit in ((stable.low, stable.low_limit), (stable.high, stable.high_limit))
        ]
        width = result.certificate.bands[mode].relative_width
        shown = f"{width:.1%}" if width < 10.0 else "more than ten times"
        table.add_row(mode, ends[0], ends[1], shown)
    console.print(table)
    for warning in result.warnings:
        console.print(f"[yellow]note[/yellow] {warning}", highlight=False)
    for path in written:
        console.print(f"wrote {path}", highlight=False)


def plot_fit(result: FitResult, path: Path) -> None:
    """Draw the fit: one panel per mode, data, curve, band of near-equal fits, stable range."""
    import io

    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from flexapod.materials.modes import nominal_stress

    figure = Figure(figsize=(12.6, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    law = result.law
    largest = max(float(np.abs(d.stress).max()) for d in result.data)
    unit, scale = ("MPa", 1e6) if largest >= 1e6 else ("kPa", 1e3)
    titles = {"uniaxial": "Uniaxial", "equibiaxial": "Equibiaxial", "planar": "Planar"}
    markers = ("o", "s", "^", "D", "v")
    for axis, (mode, band) in zip(axes, result.certificate.bands.items(), strict=True):
        low, high = float(band.stretch[0]), float(band.stretch[-1])
        margin = 0.05 * (high - low)
        stable = result.stable[mode]
        left, right = low - margin, high + margin
        axis.axvspan(
            max(stable.low, left),
            min(stable.high, right),
            color="#2a9d5c",
            alpha=0.09,
            lw=0,
            label="stable range (Drucker)",
        )
        for end in (stable.low, stable.high):
            if left < end < right:
                axis.axvline(end, color="#2a9d5c", lw=1.0, ls=":")
        axis.fill_between(
            band.stretch,
            band.low / scale,
            band.high / scale,
            color="#3465a4",
            alpha=0.22,
            lw=0,
            label="near-equally good fits",
        )
        stretch = np.linspace(low, high, 400)
        axis.plot(
            stretch,
            nominal_stress(law, mode, stretch) / scale,
            color="#1b3a6b",
            lw=1.8,
            label=f"{law.name} fit",
        )
        here = [d for d in result.data if d.mode == mode]
        tops = [float(np.abs(nominal_stress(law, mode, stretch)).max()) / scale] if here else []
        for d, marker in zip(here, markers * (1 + len(here) // 5), strict=False):
            every = max(1, d.stretch.size // 45)
            axis.plot(
                d.stretch[::every],
                d.stress[::every] / scale,
                marker,
                ms=4.2,
                mfc="white",
                mec="#c8501e",
                mew=1.1,
                ls="none",
                label=d.name + (f" (1 of {every} points)" if every > 1 else ""),
                zorder=4,
            )
            tops.append(float(np.abs(d.stress).max()) / scale)
        if not tops:
            # Not measured: the band may run away; show twice what the data reached.
            curve = float(np.abs(nominal_stress(law, mode, stretch)).max()) / scale
            tops = [min(max(float(np.abs(band.high).max()) / scale, curve), 2.0 * largest / scale)]
        top = 1.08 * max(tops)
        bottom = -top if low < 0.95 else -0.04 * top
        axis.set_xlim(left, right)
        axis.set_ylim(bottom, top)
        axis.set_title(titles[mode] + ("" if band.measured else " (not measured)"), fontsize=11)
        axis.set_xlabel("stretch [-]")
        axis.set_ylabel(f"nominal stress [{unit}]")
        axis.grid(alpha=0.25, lw=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(fontsize=8, loc="upper left", framealpha=0.85)
    figure.suptitle(
        f"{law.name}: G = {law.shear_modulus / 1e3:.4g} kPa, R² = {result.r_squared:.5f}, "
        f"{result.points_used} points" + (", stable fit" if result.stable_requested else ""),
        fontsize=12,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format=path.suffix.lower().lstrip("."), dpi=150)
    write_whole(path, buffer.getvalue())
