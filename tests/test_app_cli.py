"""The command line: exit codes, pure JSON, what is kept."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexapod.app import plots
from flexapod.app import run as run_module
from flexapod.app.case import load_case
from flexapod.app.cli import main
from flexapod.app.outputs import SUMMARY_FILE
from flexapod.app.run import Progress, run_case
from flexapod.core.errors import InputError, Status

# A case small enough to be run several times: the shipped mesh without its block.
SETTLE = [
    "step=[{name='settle', loads={gravity=1.0}, outputs=1}]",
    *("pressure=[]", "force=[]", "traction=[]", "displacement=[]"),
    "support.1.directions=['x', 'y', 'z']",
]
QUICK = ["step.settle.outputs=1", "step.inflate.outputs=4", "step.push.outputs=2"]


@pytest.fixture(autouse=True)
def _matplotlib_only(monkeypatch: pytest.MonkeyPatch) -> None:
    plots.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")


def _call(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


def _sets(settings: list[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def test_version(capfd: pytest.CaptureFixture[str]) -> None:
    assert _call(["--version"]) == 0
    assert capfd.readouterr().out.startswith("flexapod 0.")


@pytest.mark.parametrize(
    "command", ["run", "mesh", "fit", "fit-relaxation", "cases", "plot", "schema"]
)
def test_help_has_an_example(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert _call([command, "--help"]) == 0
    assert "flexapod" in capfd.readouterr().out.split("Example", 1)[1]


def test_cases_are_a_line_each(capfd: pytest.CaptureFixture[str]) -> None:
    assert _call(["cases"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert {"curl", "turn", "free_curl", "own_mesh"} <= {line.split()[0] for line in lines}
    assert _call(["cases", "--json"]) == 0
    assert "curl" in json.loads(capfd.readouterr().out)


def test_schema_is_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert _call(["schema"]) == 0
    assert json.loads(capfd.readouterr().out)["title"] == "flexapod case"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nonsense"], "no such case file"),
        (["run", "curl", "--set", "mesh.siz=fine"], "mesh.siz: unknown key (did you mean size?)"),
        (["run", "curl", "--set", "pressure.inflation.value=55"], 'for example "55 kPa"; got 55'),
        (["run", "own_mesh", "--set", "support.0.surface=rot"], "did you mean root?"),
        (["run", "own_mesh", "--set", "material.1.group=plates"], "did you mean plate?"),
        (["run", "own_mesh", "--set", "material.0.use=jelly"], "jelly"),
        (
            ["run", "own_mesh", "--set", "support.1.directions=['x', 'z']"],
            "own_mesh.toml: node 400 is held along axis z by 'support of block_foot' and moved "
            "by 'push'",
        ),
        (["run", "own_mesh", "--set", "mesh.file=gone.vtu"], "mesh.file: no such file"),
        (["mesh", "curl", "--out", "a.stl"], "write a name ending in .msh or .vtu"),
        (["plot", "nowhere"], "no such folder"),
        (["run"], "CASE.toml"),
        (["run", "curl", "--sett", "a=1"], "--sett"),
        (["frobnicate"], "frobnicate"),
    ],
)
def test_bad_input_is_exit_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _call(arguments) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert message in " ".join(captured.err.split())


def test_bad_input_as_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert _call(["run", "nonsense", "--json"]) == 2
    answer = json.loads(capfd.readouterr().out)
    assert answer["status"] == "bad_input"
    assert "no such case file" in answer["message"]


def test_mesh_json_is_pure_and_the_file_can_be_run(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sub" / "row.vtu"
    arguments = ["mesh", "free_curl", "--out", str(out), "--plot", str(tmp_path / "row.png")]
    assert _call([*arguments, "--json", *_sets(["mesh.size=coarse", "mesh.units=2"])]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["cell_count"] > 10
    assert answer["volume_error"] == pytest.approx(0.0, abs=1e-9)
    assert "cavity_main" in answer["cavities"]
    assert (tmp_path / "row.png").stat().st_size > 5000
    # The written mesh can stand in for the builder.
    table = tomllib.loads((load_case("free_curl").folder / "free_curl.toml").read_text())
    table["mesh"] = {"file": "row.vtu"}
    import tomli_w

    (out.parent / "own.toml").write_text(tomli_w.dumps(table))
    from flexapod.app.assemble import build_mesh

    assert len(build_mesh(load_case(str(out.parent / "own.toml"))).cells) == answer["cell_count"]


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An unbroken run of the quick case."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXAPOD_RENDERER", "matplotlib")
        result = run_case(load_case("own_mesh", QUICK), folder)
    assert result.status is Status.DONE
    return folder


def _curve(folder: Path) -> dict[str, np.ndarray]:
    with (folder / "curve.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    return {head: np.array([float(r[i]) for r in rows[1:]]) for i, head in enumerate(rows[0])}


def test_a_run_leaves_the_promised_files(whole_run: Path) -> None:
    names = {str(p.relative_to(whole_run)) for p in whole_run.rglob("*") if p.is_file()}
    assert {
        "case.resolved.toml",
        "summary.json",
        "curve.csv",
        "fields.pvd",
        "fields/state_0007.vtu",
        "plots/curve.png",
        "plots/snapshots.png",
        "plots/final.png",
        "checkpoint.h5",
    } <= names
    summary = json.loads((whole_run / SUMMARY_FILE).read_text())
    assert {
        "case",
        "status",
        "version",
        "elements",
        "nodes",
        "wall_time_s",
        "peak_memory_bytes",
        "results",
        "reference",
    } <= set(summary)
    assert summary["status"] == "done"
    assert summary["elements"] == 232
    assert summary["peak_memory_bytes"] > 1e7
    resolved = tomllib.loads((whole_run / "case.resolved.toml").read_text())
    assert resolved["resolved"]["flexapod_version"] == summary["version"]
    assert len(resolved["resolved"]["mesh_hash"]) == 16
    assert len(_curve(whole_run)["pressure_kPa"]) == 1 + 1 + 4 + 2


def test_fields_hold_what_paraview_needs(whole_run: Path) -> None:
    import meshio

    mesh = meshio.read(whole_run / "fields" / "state_0007.vtu")
    assert {"displacement", "contact_pressure"} <= set(mesh.point_data)
    assert mesh.cell_data["principal_stretches"][0].shape == (232, 3)
    assert mesh.cell_data["cauchy_stress"][0].shape == (232, 9)
    assert mesh.cell_data["pressure"][0].shape == (232,)
    # The block touches the finger at the end.
    assert mesh.point_data["contact_pressure"].max() > 0.0


def test_json_of_a_run_is_pure(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r"
    assert _call(["run", "own_mesh", "--out", str(out), "--json", *_sets(SETTLE)]) == 0
    captured = capfd.readouterr()
    answer = json.loads(captured.out)
    assert answer == json.loads((out / SUMMARY_FILE).read_text())
    assert answer["results"]["tip_z_mm"] < 0.0
    assert "232 hexahedra" in captured.err


class _Stop:
    """Press Ctrl-C at the n-th output."""

    def __init__(self, count: int) -> None:
        self.left = count

    def __call__(self, progress: Progress) -> None:
        self.left -= progress.is_output
        if self.left <= 0:
            raise KeyboardInterrupt


def test_an_interrupted_run_resumes_to_the_same_end(whole_run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    loaded = load_case("own_mesh", QUICK)
    first = run_case(loaded, folder, progress=_Stop(4))
    assert first.status is Status.INTERRUPTED
    summary = json.loads((folder / SUMMARY_FILE).read_text())
    assert summary["status"] == "interrupted"
    assert len(_curve(folder)["pressure_kPa"]) == 1 + 4
    second = run_case(loaded, folder, resume=True)
    assert second.status is Status.DONE
    assert second.summary["resumed"]
    unbroken, resumed = _curve(whole_run), _curve(folder)
    assert list(unbroken) == list(resumed)
    for head, values in unbroken.items():
        # Round-off only: the path starts again from the very same state and increment.
        np.testing.assert_allclose(resumed[head], values, rtol=1e-6, atol=1e-9, err_msg=head)


def _interrupt(*ignored: object) -> None:
    raise KeyboardInterrupt


def test_interrupted_before_the_path_there_is_still_one_json_object(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_module, "build_mesh", _interrupt)
    assert _call(["run", "own_mesh", "--out", str(tmp_path / "r"), "--json"]) == 130
    assert json.loads(capfd.readouterr().out)["status"] == "interrupted"


def test_interrupted_while_drawing_the_numbers_are_kept(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "r"
    command = ["run", "own_mesh", "--out", str(out), "--json", *_sets(SETTLE)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots, "plot_snapshots", _interrupt)
        assert _call(command) == 130
    captured = capfd.readouterr()
    answer = json.loads(captured.out)
    assert answer == json.loads((out / SUMMARY_FILE).read_text())
    assert answer["status"] == "interrupted"
    assert "while the pictures were drawn" in answer["message"]
    assert f"flexapod plot {out}" in captured.err
    assert answer["results"]["tip_z_mm"] < 0.0
    assert answer["results"]["states"] == len(_curve(out)["step"]) == 2
    # All the loads were reached: a curve drawn from the files does not call the run cut short.
    assert not plots.cut_short(plots.read_results(out))
    # Going on draws what is missing and computes nothing anew.
    assert _call([*command, "--resume"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["status"] == "done"
    assert answer["results"]["increments"] == 0
    assert (out / "plots" / "final.png").exists()


def test_a_failure_interrupted_while_drawing_keeps_its_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plots, "draw_all", _interrupt)
    settings = [*QUICK, "solver.increments=3", "solver.damped=false"]
    out = tmp_path / "r"
    assert _call(["run", "own_mesh", "--out", str(out), "--json", *_sets(settings)]) == 130
    answer = json.loads(capfd.readouterr().out)
    assert answer["status"] == "interrupted"
    assert "increments" in answer["message"]
    assert "while the pictures were drawn" in answer["message"]
    assert plots.cut_short(plots.read_results(out))


def test_resume_of_another_case_is_refused(whole_run: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pressure differ"):
        run_case(
            load_case("own_mesh", [*QUICK, "pressure.inflation.value=9 kPa"]),
            whole_run,
            resume=True,
        )


def test_resume_of_a_finished_run_changes_nothing(whole_run: Path) -> None:
    before = _curve(whole_run)
    result = run_case(load_case("own_mesh", QUICK), whole_run, resume=True)
    assert result.status is Status.DONE
    for head, values in before.items():
        assert np.array_equal(_curve(whole_run)[head], values)


def test_a_path_that_cannot_go_on_is_exit_3_and_keeps_its_states(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "r"
    settings = [*QUICK, "solver.increments=3", "solver.damped=false"]
    assert _call(["run", "own_mesh", "--out", str(out), "--json", *_sets(settings)]) == 3
    captured = capfd.readouterr()
    answer = json.loads(captured.out)
    assert answer["status"] == "too_many_increments"
    assert "with --resume" in captured.err
    curve = _curve(out)
    assert 1 < len(curve["step"]) < 8
    assert len(list((out / "fields").iterdir())) == len(curve["step"])
    assert (out / "plots" / "curve.png").exists()


def test_sigterm_keeps_the_run(tmp_path: Path) -> None:
    out = tmp_path / "r"
    command = [sys.executable, "-m", "flexapod.app.cli", "run", "free_curl", "--out", str(out)]
    settings = ["mesh.size=coarse", "mesh.units=2", "step.inflate.outputs=1000"]
    process = subprocess.Popen(
        [*command, *_sets(settings)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        deadline = time.monotonic() + 120.0
        while not (out / "checkpoint.h5").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        process.terminate()
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert json.loads((out / SUMMARY_FILE).read_text())["status"] == "interrupted"
    assert "go on with --resume" in " ".join(err.split())


def test_module_runs_as_a_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "flexapod.app.cli", "cases", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    assert "curl" in answer
    assert done.stderr == ""
