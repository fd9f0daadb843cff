"""The command line: thin commands over the functions of this floor.

Answers go to standard output, everything else (progress, notices, faults) to standard error.
With ``--json`` standard output holds exactly one JSON object. Exit codes: 0 done, 2 bad input,
3 the solver could not go on, 130 stopped by Ctrl-C; in the last two cases what was computed is
kept and named.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup

from flexapod.app.fit import fit_command
from flexapod.app.fit_relaxation import fit_relaxation_command
from flexapod.core.errors import InputError, SolverError, Status


class _Stopped(Exception):
    """Ctrl-C on its way out of a command.

    Typer turns a KeyboardInterrupt into an exit of its own, without the JSON object.
    """


class _Commands(TyperGroup):
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _Stopped from None


app = typer.Typer(
    name="flexapod",
    cls=_Commands,
    help="Finite elements for soft robots: fit a silicone, mesh a pneumatic body, inflate it.",
    epilog="Example: [bold]flexapod run free_curl --out results/free_curl[/bold]",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

EXIT_INPUT = 2
EXIT_SOLVER = 3
EXIT_INTERRUPTED = 130

CaseArgument = Annotated[
    str, typer.Argument(metavar="CASE.toml", help="A case file, or the name of a shipped case.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY.PATH=VALUE",
        help="Override a value of the case, for example --set mesh.size=coarse or "
        '--set "pressure.inflation.value=20 kPa". May be given several times.',
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def _errors() -> Console:
    return Console(stderr=True, highlight=False)


def _answer() -> Console:
    return Console(highlight=False)


def _print_json(value: Any) -> None:
    from flexapod.app.outputs import dump_json

    sys.stdout.write(dump_json(value) + "\n")
    sys.stdout.flush()


def _say(text: str) -> None:
    _errors().print(text, markup=False, soft_wrap=True)


@app.callback(invoke_without_command=True)
def _main_options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)
    ] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"flexapod {installed('flexapod')}")
        raise typer.Exit


app.command(
    "fit", epilog="Example: [bold]flexapod fit tensile.csv --terms 3 --out material.toml[/bold]"
)(fit_command)
app.command(
    "fit-relaxation",
    epilog="Example: [bold]flexapod fit-relaxation relaxation.csv --terms 3 --out DIR[/bold]",
)(fit_relaxation_command)


@app.command(
    "run",
    epilog="Examples: [bold]flexapod run curl[/bold]  |  "
    "[bold]flexapod run my.toml --out results/try --set mesh.size=coarse[/bold]  |  "
    "[bold]flexapod run my.toml --out results/try --resume[/bold]",
)
def run_command(
    case: CaseArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Results folder (default results/<case>). An earlier run's folder is replaced; "
            "a folder with anything else in it is refused.",
        ),
    ] = None,
    settings: SetOption = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the last state kept in the folder.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a case: loads, contacts, curve, fields and pictures."""
    from flexapod.app.case import load_case
    from flexapod.app.run import run_case

    loaded = load_case(case, settings or [])
    folder = out if out is not None else Path("results") / loaded.name
    with _Progress() as bar:
        result = run_case(loaded, folder, resume=resume, progress=bar.update, say=bar.say)
    if as_json:
        _print_json(result.summary)
    else:
        _print_summary(result.summary)
    if result.status is not Status.DONE:
        kept = result.summary["results"]["states"]
        _say(f"{result.message}\nkept: {kept} states in {folder} (curve.csv, *.pvd); go on "
             "with --resume")  # fmt: skip
        interrupted = result.status is Status.INTERRUPTED
        raise typer.Exit(EXIT_INTERRUPTED if interrupted else EXIT_SOLVER)


class _Progress:
    """A progress bar on a terminal, one line per output elsewhere; all on standard error."""

    def __init__(self) -> None:
        self.console = _errors()
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> _Progress:
        if self.console.is_terminal:
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            self.bar = Progress(
                TextColumn("{task.percentage:3.0f} %"),
                BarColumn(bar_width=30),
                TimeElapsedColumn(),
                TextColumn("{task.description}", markup=False),
                console=self.console,
                transient=True,
                redirect_stdout=False,
            )
            self.bar.start()
            self.task = self.bar.add_task("meshing", total=1.0)
        return self

    def __exit__(self, *ignored: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    def update(self, progress: Any) -> None:
        """Show an accepted state."""
        from flexapod.app.plots import amount

        heads = [h for h in progress.row if h != "step" and not h.startswith("load_")][:3]
        shown = ", ".join(
            # A head without a unit is named by `amount` itself.
            f"{h.rpartition('_')[0]} {amount(h, progress.row[h])}".strip()
            for h in heads
        )
        text = f"{progress.step}: {shown}"
        if self.bar is not None:
            self.bar.update(self.task, completed=progress.fraction, description=text)
        elif progress.is_output:
            self.say(f"{100 * progress.fraction:3.0f} %  {text}")

    def say(self, text: str) -> None:
        """Show a notice."""
        self.console.print(text, markup=False, soft_wrap=True)


def _paper_table(rows: list[dict[str, Any]]) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="paper beside ours", title_justify="left")
    for head in ("result", "paper", "ours"):
        table.add_column(head)
    for row in rows:
        ours = row["ours"]
        shown = f"{ours:.4g}" if isinstance(ours, float) else "-" if ours is None else str(ours)
        table.add_row(row["result"], escape(row["paper"]), shown)
    return table


def _print_summary(summary: dict[str, Any]) -> None:
    from rich.markup import escape
    from rich.table import Table

    console = _answer()
    minutes, seconds = divmod(summary["wall_time_s"], 60.0)
    size = f"{summary['elements']} hexahedra"
    if summary.get("lines"):
        size = f"{summary['lines']} lines" + (f", {size}" if summary["elements"] else "")
    if "runs" in summary["results"]:
        size = f"{summary['results']['runs_done']} of {summary['results']['runs']} runs"
    console.print(
        f"{summary['case']}: {summary['status']}, {size}, "
        f"{minutes:.0f} min {seconds:.0f} s, "
        f"{summary['peak_memory_bytes'] / 1e9:.2f} GB",
        markup=False,
    )
    reference = summary.get("reference")
    if reference:
        x = reference["x"]
        unit, y_unit = summary_unit(x), summary_unit(reference["y"])
        table = Table(title=escape(reference["name"]), title_justify="left")
        for head in (f"{x.rpartition('_')[0] or x}{unit}", f"measured{y_unit}",
                     f"computed{y_unit}", "relative error"):  # fmt: skip
            table.add_column(escape(head), justify="right")
        for row in reference["table"]:
            cells = [row[x], row["measured"], row["computed"]]
            error = row["relative_error"]
            table.add_row(
                *("-" if cell is None else f"{cell:.4g}" for cell in cells),
                "-" if error is None else f"{100 * error:.1f} %",
            )
        console.print(table)
        error = reference["mean_relative_error"]
        console.print(
            "mean relative error: " + ("none" if error is None else f"{100 * error:.2f} %"),
            markup=False,
        )
        if reference.get("note"):
            console.print(reference["note"], markup=False)
        if reference.get("simulation_error") is not None:
            console.print(
                f"{reference['simulation_name']}: {100 * reference['simulation_error']:.2f} %",
                markup=False,
            )
    else:
        if summary.get("paper"):
            console.print(_paper_table(summary["paper"]))
        for name, value in summary["results"].items():
            if isinstance(value, float) and not name.startswith(("load_", "solve_")):
                console.print(f"  {name:24} {value:.6g}", markup=False)
            elif isinstance(value, dict) and name != "contacts":
                # Collections of a sweep, slopes by pattern.
                for words, inner in _flat(value):
                    shown = f"{inner:.6g}" if isinstance(inner, int | float) else str(inner or "-")
                    console.print(f"  {name}: {words:20} {shown}", markup=False, soft_wrap=True)
    console.print(f"results: {summary['folder']}", markup=False, soft_wrap=True)


def _flat(table: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Entries of nested tables with the keys that lead to them."""
    for key, value in table.items():
        words = f"{before}, {key}" if before else str(key)
        if isinstance(value, dict):
            yield from _flat(value, words)
        else:
            yield words, value


def summary_unit(head: str) -> str:
    """Unit of a column head in brackets, or nothing."""
    unit = head.rpartition("_")[2]
    return f" [{unit}]" if unit in ("kPa", "deg", "mm", "N", "ml") else ""


@app.command(
    "mesh",
    epilog="Example: [bold]flexapod mesh curl --out curl.vtu --plot curl.png "
    "--set mesh.size=fine[/bold]",
)
def mesh_command(
    case: CaseArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="Mesh file, .msh or .vtu, with groups.")
    ],
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE.png", help="Picture with the groups coloured."),
    ] = None,
    settings: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the mesh of a case with its groups, and report its quality."""
    from flexapod.app.case import load_case
    from flexapod.app.mesh import write_case_mesh

    loaded = load_case(case, settings or [])
    report = write_case_mesh(loaded, out, plot, _say)
    if as_json:
        _print_json(report.table)
    else:
        _answer().print(report.text, markup=False, soft_wrap=True)


@app.command("cases", epilog="Example: [bold]flexapod cases[/bold]")
def cases_command(as_json: JsonOption = False) -> None:
    """List the shipped cases, a line each."""
    from flexapod.app.case import shipped_cases

    cases = shipped_cases()
    if as_json:
        _print_json(cases)
        return
    width = max(map(len, cases), default=0)
    for name, title in cases.items():
        _answer().print(f"{name:{width}}  {title}", markup=False, soft_wrap=True)


@app.command("plot", epilog="Example: [bold]flexapod plot results/curl[/bold]")
def plot_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results folder of a run.")],
    as_json: JsonOption = False,
) -> None:
    """Redraw the pictures of a results folder from its files."""
    from flexapod.app.plots import draw_all
    from flexapod.app.run import stdout_to_stderr

    with stdout_to_stderr():
        written, notices = draw_all(folder)
    for text in notices:
        _say(text)
    if as_json:
        _print_json({"plots": [str(path) for path in written], "warnings": notices})
        return
    for path in written:
        _answer().print(str(path), markup=False, soft_wrap=True)


@app.command("schema", epilog="Example: [bold]flexapod schema > flexapod-case.schema.json[/bold]")
def schema_command() -> None:
    """Print the JSON schema of a case file, for editors."""
    from flexapod.app.case import case_schema

    sys.stdout.write(json.dumps(case_schema(), indent=2) + "\n")


def _guarded(call: Callable[[], Any], as_json: bool) -> int:
    """Run a command; errors become exit codes and plain lines."""

    def fail(status: str, message: str, code: int) -> int:
        _errors().print(f"error: {message}", markup=False, soft_wrap=True)
        if as_json:
            _print_json({"status": status, "message": message})
        return code

    try:
        code = call()
    except InputError as error:
        return fail("bad_input", str(error), EXIT_INPUT)
    except SolverError as error:
        return fail(error.status.name.lower(), str(error), EXIT_SOLVER)
    except KeyboardInterrupt:
        return fail("interrupted", "stopped before anything was kept", EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The reader of a pipe (head, less) has left: not our failure.
        sys.stderr.close()
        return 0
    return code if isinstance(code, int) else 0


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `flexapod` command."""
    command = typer.main.get_command(app)
    words = sys.argv[1:] if arguments is None else arguments
    sys.exit(_guarded(lambda: _call(command, words), "--json" in words))


def _call(command: Any, arguments: list[str]) -> int:
    try:
        # Not standalone: exceptions of ours reach `_guarded`, and exits come back as numbers.
        code = command.main(args=arguments, prog_name="flexapod", standalone_mode=False)
    except _Stopped:
        raise KeyboardInterrupt from None
    except Exception as error:
        # Usage errors of the parser know how to show themselves (typer carries its own copy of
        # click in some versions, so they are told by what they can do and not by their class).
        if hasattr(error, "show") and hasattr(error, "exit_code"):
            error.show()
            return int(error.exit_code)
        if type(error).__name__ == "Abort":
            raise KeyboardInterrupt from None
        raise
    return code if isinstance(code, int) else 0


if __name__ == "__main__":
    main()
