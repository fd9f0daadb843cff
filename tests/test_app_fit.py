"""``flexapod fit``: JSON, report, material file and picture."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from flexapod.app.fit import fit_command
from flexapod.core.errors import InputError
from flexapod.materials.library import load_material
from flexapod.materials.modes import nominal_stress
from flexapod.materials.ogden import Ogden

LAW = Ogden((2.0e5, 1.0e3), (1.6, 5.5))
KEYS = {
    "model", "mu_Pa", "alpha", "shear_modulus_Pa", "youngs_modulus_Pa", "r_squared",
    "rms_relative_error", "stable_stretch", "points_used", "warnings",
}  # fmt: skip

app = typer.Typer()
app.command("fit")(fit_command)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return write(tmp_path / "test.csv", "uniaxial")


def write(path: Path, mode: str) -> Path:
    s = np.linspace(1.05, 3.0, 25)
    rows = [
        f"{100 * (x - 1):.6f};{p / 1e6:.9f}"
        for x, p in zip(s, nominal_stress(LAW, mode, s), strict=True)
    ]
    text = "Operator;us\nStrain (%);Stress (MPa)\n" + "\n".join(rows)
    path.write_text(text.replace(".", ","), encoding="utf-8")
    return path


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def strictly(text: str) -> dict[str, Any]:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    value: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return value


def test_json_is_one_object_with_the_promised_keys(data: Path) -> None:
    result = run(data, "--terms", 2, "--json")
    assert result.exit_code == 0, result.output
    value = strictly(result.stdout)
    assert set(value) >= KEYS
    assert value["model"] == "ogden"
    assert len(value["mu_Pa"]) == len(value["alpha"]) == 2
    assert value["shear_modulus_Pa"] == pytest.approx(LAW.shear_modulus, rel=0.02)
    assert value["youngs_modulus_Pa"] == pytest.approx(3 * value["shear_modulus_Pa"])
    assert value["r_squared"] > 0.99999
    assert value["points_used"] == 25
    assert set(value["stable_stretch"]) == {"uniaxial", "equibiaxial", "planar"}
    for low, high in value["stable_stretch"].values():
        assert 0.0 < low <= 1.0 <= high and math.isfinite(high)
    assert all(isinstance(w, str) for w in value["warnings"])
    assert value["data"][0]["name"] == "test.csv"


@pytest.mark.parametrize("model", ["neo-hooke", "mooney-rivlin", "yeoh"])
def test_other_models(data: Path, model: str) -> None:
    value = strictly(run(data, "--model", model, "--json").stdout)
    assert value["model"] == model
    assert ("c_Pa" in value) == (model != "neo-hooke")


def test_sets_by_name_not_by_order(tmp_path: Path) -> None:
    u, e, p = (write(tmp_path / f"{m}.csv", m) for m in ("uniaxial", "equibiaxial", "planar"))
    one = run(u, "--equibiaxial", e, "--planar", p, "--terms", 2, "--json")
    other = run("--planar", p, "--equibiaxial", e, "--uniaxial", u, "--terms", 2, "--json")
    assert one.stdout == other.stdout
    value = strictly(one.stdout)
    np.testing.assert_allclose(value["alpha"], LAW.alpha, rtol=1e-3)
    np.testing.assert_allclose(value["mu_Pa"], LAW.mu, rtol=1e-2)


def test_options_reach_the_fit(data: Path) -> None:
    value = strictly(
        run(
            data, "--terms", 1, "--max-stretch", 2, "--weights", "relative", "--stable", "--json"
        ).stdout
    )
    assert (value["weights"], value["stable_requested"]) == ("relative", True)
    assert value["points_used"] == 12
    assert any("max-stretch" in w for w in value["warnings"])


def test_force_and_displacement(tmp_path: Path) -> None:
    s = np.linspace(1.05, 2.0, 12)
    force = nominal_stress(LAW, "uniaxial", s) * 18e-6
    rows = [f"{33 * (x - 1):.6f},{f:.6f}" for x, f in zip(s, force, strict=True)]
    path = tmp_path / "machine.csv"
    path.write_text("Extension (mm),Load (N)\n" + "\n".join(rows), encoding="utf-8")
    value = strictly(
        run(path, "--area", "18 mm^2", "--gauge-length", "33 mm", "--terms", 1, "--json").stdout
    )
    assert value["shear_modulus_Pa"] == pytest.approx(LAW.shear_modulus, rel=0.05)
    failed = run(path, "--area", "18", "--gauge-length", "33 mm")
    assert isinstance(failed.exception, InputError)
    assert "--area" in str(failed.exception)


def test_material_file_gives_the_law_back(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "sub" / "mine.toml"
    result = run(data, "--terms", 2, "--out", out, "--density", "1080 kg/m^3", "--json")
    value = strictly(result.stdout)
    material = load_material(out)
    assert isinstance(material.law, Ogden)
    np.testing.assert_array_equal(material.law.mu, value["mu_Pa"])
    np.testing.assert_array_equal(material.law.alpha, value["alpha"])
    assert (material.density, material.name) == (1080.0, "mine")
    assert [p.name for p in out.parent.iterdir()] == ["mine.toml"]


def test_material_file_without_density_warns_when_loaded(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    run(data, "--model", "yeoh", "--out", out)
    with pytest.warns(UserWarning, match="density"):
        assert load_material(out).law.name == "yeoh"


def test_plot_is_a_picture(data: Path, tmp_path: Path) -> None:
    plot = tmp_path / "fit.png"
    assert run(data, "--terms", 1, "--plot", plot, "--json").exit_code == 0
    assert plot.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert plot.stat().st_size > 20_000


def test_report_for_people(data: Path) -> None:
    result = run(data, "--terms", 1)
    assert result.exit_code == 0
    for word in ("ogden fitted to test.csv", "mu[1]", "R2 =", "equibiaxial"):
        assert word in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "needs a data file"),
        (("nowhere.csv",), "cannot be read"),
        (("DATA", "--model", "gent"), "model must be one of"),
        (("DATA", "--out", "x.json"), "must name a .toml"),
        (("DATA", "--plot", "x.bmp"), "must name a .png"),
    ],
)
def test_bad_input_is_named(data: Path, arguments: tuple[str, ...], message: str) -> None:
    result = run(*(data if a == "DATA" else a for a in arguments), "--terms", 1)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
