"""``flexapod fit-relaxation``: records of known series, bad files, what is written."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexapod.app.cli import main
from flexapod.app.fit_relaxation import fit_relaxation
from flexapod.app.spec import MaterialSpec
from flexapod.core.errors import InputError
from flexapod.materials.prony import Prony
from flexapod.materials.relaxation import RELAXATION_RULES, read_relaxation

SERIES = Prony((0.4, 0.25, 0.15), (0.05, 1.2, 18.0))
LONG_TERM = 84e3  # [Pa]
TIMES = np.geomspace(1e-3, 300.0, 300)


def write(
    path: Path,
    t: np.ndarray = TIMES,
    noise: float = 0.0,
    head: str = "Time (s);Stress (kPa)",
    scale: float = 1e-3,
) -> Path:
    """A laboratory's record of `SERIES` at times `t` [s], with relative noise."""
    y = LONG_TERM * SERIES.relaxation(np.maximum(t, 0.0))
    y = y * (1.0 + noise * np.random.default_rng(5).normal(size=t.size))
    rows = [f"{a!r};{b!r}" for a, b in zip(t.tolist(), (scale * y).tolist(), strict=True)]
    text = "\n".join(["Operator;us", head, *rows])
    path.write_text(text.replace(".", ","), encoding="utf-8")
    return path


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["fit-relaxation", *(str(a) for a in arguments)])
    return int(ended.value.code or 0)


def test_a_known_series_is_recovered(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(write(tmp_path / "r.csv"), "--json") == 0
    value: dict[str, Any] = json.loads(capfd.readouterr().out)
    # Measured 2e-15: exact data; the optimiser stops at 1e-12.
    assert value["prony_moduli"] == pytest.approx(SERIES.moduli, rel=1e-6)
    assert value["prony_times_s"] == pytest.approx(SERIES.times, rel=1e-6)
    assert value["long_term"] == pytest.approx(LONG_TERM, rel=1e-6)
    assert value["long_term_unit"] == "Pa"
    assert value["instantaneous_over_long_term"] == pytest.approx(1.8, rel=1e-6)
    assert value["shares_of_instantaneous"] == pytest.approx([0.4 / 1.8, 0.25 / 1.8, 0.15 / 1.8])
    assert 1.0 - value["r_squared"] < 1e-12
    assert [fit["terms"] for fit in value["fits"]] == [1, 2, 3]
    errors = [fit["rms_relative_error"] for fit in value["fits"]]
    assert errors[0] > errors[1] > errors[2]
    assert value["warnings"] == []


def test_noise_moves_the_series_little(tmp_path: Path) -> None:
    result = fit_relaxation(write(tmp_path / "r.csv", noise=0.005))
    found = result.best.prony
    # Half a percent in each of 300 points; measured 2.3 % in a modulus and 3.1 % in a time.
    assert found.moduli == pytest.approx(SERIES.moduli, rel=0.07)
    assert found.times == pytest.approx(SERIES.times, rel=0.1)
    # The curve is known far better than its parts: measured 0.13 %.
    fitted = result.best.long_term * found.relaxation(TIMES)
    np.testing.assert_allclose(fitted, LONG_TERM * SERIES.relaxation(TIMES), rtol=0.004)
    assert result.best.rms_relative_error == pytest.approx(0.005, rel=0.15)


def test_the_lines_go_into_a_case(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "made" / "relaxation"
    assert call(write(tmp_path / "r.csv"), "--out", out) == 0
    printed = capfd.readouterr().out
    text = (out / "prony.toml").read_text(encoding="utf-8")
    assert text.endswith(printed[printed.index("prony_moduli") : printed.index("wrote ")])
    spec = MaterialSpec.model_validate({"use": "elastosil-m4601", **tomllib.loads(text)})
    # Six digits are written.
    assert spec.prony_moduli == pytest.approx(SERIES.moduli, rel=1e-6)
    assert spec.prony_times == pytest.approx(SERIES.times, rel=1e-6)
    kept = json.loads((out / "relaxation.json").read_text(encoding="utf-8"))
    assert kept["prony_moduli"] == pytest.approx(spec.prony_moduli, rel=1e-5)
    from matplotlib.image import imread

    image = imread(out / "relaxation.png")
    assert min(image.shape[:2]) > 500 and image.std() > 0.01
    assert sorted(p.name for p in out.iterdir()) == [
        "prony.toml", "relaxation.json", "relaxation.png"
    ]  # fmt: skip


def test_report_for_people(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(write(tmp_path / "r.csv"), "--terms", 2) == 0
    words = capfd.readouterr().out
    for word in ("r.csv (stress, 300 points", "RMS relative error", "of instantaneous", "R2 = 0.99",
                 "time constant", 'prony_times = ["'):  # fmt: skip
        assert word in words


@pytest.mark.parametrize(
    ("head", "scale", "kind", "unit"),
    [
        ("Zeit [s];Spannung [MPa]", 1e-6, "stress", "Pa"),
        ("time_s;G(t) / Pa", 1.0, "modulus", "Pa"),
        ("Time (s);Load (N)", 2e-5, "force", "N"),
        ("t (s);normalised stress", 1e-5, "ratio", ""),
        ("t (s);relaxation function (-)", 1e-5, "ratio", ""),
    ],
)
def test_any_load_will_do(tmp_path: Path, head: str, scale: float, kind: str, unit: str) -> None:
    path = write(tmp_path / "r.csv", head=head, scale=scale)
    data = read_relaxation(path)
    assert (data.kind, data.unit) == (kind, unit)
    # The series holds ratios only, and these stay the same to round-off.
    assert fit_relaxation(path).best.prony.moduli == pytest.approx(SERIES.moduli, rel=1e-6)


def test_time_in_other_units(tmp_path: Path) -> None:
    for head, option, factor in (
        ("Time (min);Stress (kPa)", None, 60.0),
        ("Time;Stress (kPa)", "ms", 1e-3),
        ("Time;Stress\n(s);(kPa)", None, 1.0),
    ):
        data = read_relaxation(write(tmp_path / "r.csv", head=head), time_unit=option)
        np.testing.assert_allclose(data.time, factor * TIMES, rtol=1e-15)
        np.testing.assert_allclose(data.value[-1], LONG_TERM, rtol=1e-6)


def test_ramp_is_named_and_left_out(tmp_path: Path) -> None:
    ramp = np.linspace(0.0, 1.9, 20)
    path = write(tmp_path / "r.csv", np.concatenate([ramp, 2.0 + TIMES]))
    lines = path.read_text(encoding="utf-8").splitlines()
    # The load grows evenly until 2 s, then relaxes; the record repeats one time.
    for k, t in enumerate(ramp):
        lines[2 + k] = f"{t};{75.0 * (t + 0.1)}".replace(".", ",")
    y = 1e-3 * LONG_TERM * SERIES.relaxation(TIMES)
    for k, (at, value) in enumerate(zip((2.0 + TIMES).tolist(), y.tolist(), strict=True)):
        lines[22 + k] = f"{at!r};{value!r}".replace(".", ",")
    path.write_text("\n".join([*lines, lines[-1]]), encoding="utf-8")
    notes = read_relaxation(path).notes
    assert any("ramp: the load rises until 2.001 s" in note for note in notes)
    data = read_relaxation(path, start=2.0, skip=0.01)
    assert [note.split(": ")[1] for note in data.notes] == ["start", "skip", "ascending-time"]
    assert all(note.split(": ")[1] in RELAXATION_RULES for note in (*notes, *data.notes))
    result = fit_relaxation(path, start=2.0, skip=0.01)
    # Times less 2 s lose four digits.
    assert result.best.prony.times == pytest.approx(SERIES.times, rel=1e-6)
    assert result.best.prony.moduli == pytest.approx(SERIES.moduli, rel=1e-6)


def test_what_the_record_does_not_tell_is_said(tmp_path: Path) -> None:
    # 0.05 s, the first branch, is half over before the first point.
    late = fit_relaxation(write(tmp_path / "late.csv", TIMES[TIMES > 0.1]))
    assert "lies at the record's first time, 0.1035 s" in late.warnings[0]
    more = fit_relaxation(write(tmp_path / "r.csv"), terms=5)
    assert more.warnings == ("the record shows 3 branches, not 5",)
    assert more.best.prony.moduli == pytest.approx(SERIES.moduli, rel=1e-6)


BAD = [
    ("", (), "is empty"),
    ("only words\nand more", (), "no header line found"),
    ("Strain (%);Stress (kPa)\n1;2\n2;3", (), "no header line found"),
    ("Time (s);Stress (kPa)\n", (), "not followed by numbers"),
    ("Time;Stress (kPa)\n1;2\n2;1", (), 'column "Time" has no unit'),
    ("Time (kPa);Stress (kPa)\n1;2\n2;1", (), "not a unit of time"),
    ("Time (s);Stress (mm)\n1;2\n2;1", (), "not a unit of stress"),
    ("Time (s);Stress (kPa)\n1;2\n2;abc\n", (), 'line 3: "abc"'),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", (), "3 terms need more than 7 points, got 3"),
    ("Time (s);Stress (kPa)\n1;2\n2;-1\n3;1", (), "must keep its sign, but is -1000 Pa at 2 s"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--start", "9 s"), "got 0"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--start", "9"), "has no unit"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--skip", "-1 s"), "skip must be finite and >= 0"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--time-unit", "kg"), "not a unit of time"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--terms", "0"), "terms must be >= 1"),
    ("Time (s);Stress (kPa)\n1;2\n2;1\n3;1", ("--spacing", "even"), "spacing must be one of"),
    ("Time (s);Stress (kPa)\n1;2\n2;2\n3;2\n4;2", ("--terms", "1"), "does not relax"),
]


@pytest.mark.parametrize(("text", "options", "message"), BAD, ids=[b[2][:28] for b in BAD])
def test_bad_input_is_named(
    tmp_path: Path,
    text: str,
    options: tuple[str, ...],
    message: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    assert call(path, *options, "--json") == 2
    said = capfd.readouterr()
    assert message in said.err
    assert json.loads(said.out)["status"] == "bad_input"


def test_files_that_are_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path / "none.csv") == 2
    assert "cannot be read" in capfd.readouterr().err
    (tmp_path / "picture.png").write_bytes(bytes(range(256)) * 40)
    assert call(tmp_path / "picture.png") == 2
    assert "no header line found" in capfd.readouterr().err
    good = write(tmp_path / "r.csv")
    assert call(good, "--out", good) == 2
    assert "--out must name a folder" in capfd.readouterr().err
    with pytest.raises(InputError, match="still falls towards zero"):
        falling = tmp_path / "f.csv"
        y = np.exp(-TIMES / 50.0)
        rows = [f"{a};{b}" for a, b in zip(TIMES, y, strict=True)]
        falling.write_text("\n".join(["Time (s);Stress (Pa)", *rows]), encoding="utf-8")
        fit_relaxation(falling, 1)


def test_help_has_an_example(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("--help") == 0
    words = capfd.readouterr().out
    assert "flexapod fit-relaxation" in words.split("Example", 1)[1]
    assert all(option in words for option in ("--terms", "--start", "--skip", "--out"))
