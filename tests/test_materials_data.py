"""The reader of laboratory files: formats, units, named rules and errors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.materials.data import RULES, TensileData, read_test

STRETCH = np.linspace(1.05, 2.0, 20)
STRESS = 1e5 * (STRETCH - STRETCH**-2)  # neo-Hooke, 100 kPa


def write(path: Path, head: str, columns: list[np.ndarray], mark: str, decimal: str = ".") -> Path:
    rows = [mark.join(f"{v:.9g}".replace(".", decimal) for v in row) for row in zip(*columns)]  # noqa: B905
    path.write_text(head + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def check(data: TensileData, stretch: np.ndarray = STRETCH, stress: np.ndarray = STRESS) -> None:
    # Nine digits are written.
    np.testing.assert_allclose(data.stretch, stretch, rtol=1e-8)
    np.testing.assert_allclose(data.stress, stress, rtol=1e-7)


STRAIN = STRETCH - 1.0
CASES = {
    "comma": ("Strain (-),Stress (kPa)", [STRAIN, STRESS / 1e3], ",", "."),
    "semicolon": ("Strain;Stress (MPa)", [STRAIN, STRESS / 1e6], ";", "."),
    "tab": ("Strain\tStress [Pa]", [STRAIN, STRESS], "\t", "."),
    "decimal comma": ("Dehnung (%);Spannung (N/mm²)", [100 * STRAIN, STRESS / 1e6], ";", ","),
    "decimal comma and tab": ("Strain\tStress (kPa)", [STRAIN, STRESS / 1e3], "\t", ","),
    "percent": ("Engineering strain [%],Stress_kPa", [100 * STRAIN, STRESS / 1e3], ",", "."),
    "psi": ("Stretch,Nominal stress (psi)", [STRETCH, STRESS / 6894.757293168], ",", "."),
    "kgf/cm2": ("lambda;Stress (kgf/cm2)", [STRETCH, STRESS / 98066.5], ";", "."),
    "kg/cm^2": ("lambda;Stress (kg/cm^2)", [STRETCH, STRESS / 98066.5], ";", "."),
    "true both": (
        "True strain,True stress (MPa)",
        [np.log(STRETCH), STRESS * STRETCH / 1e6],
        ",",
        ".",
    ),
    "true stress on engineering strain": (
        "Elongation (%),Cauchy stress (kPa)",
        [100 * STRAIN, STRESS * STRETCH / 1e3],
        ",",
        ".",
    ),
    "stress first, time beside": (
        "Time (s),Stress (kPa),Strain (mm/mm)",
        [np.arange(20), STRESS / 1e3, STRAIN],
        ",",
        ".",
    ),
    "units on their own line": (
        "Strain;Stress\n(%);(MPa)",
        [100 * STRAIN, STRESS / 1e6],
        ";",
        ".",
    ),
    "machine export, quoted": (
        '"Results","1"\n\n"Time","Extension","Standardkraft","Dehnung","Zugspannung"\n'
        '"(s)","(mm)","(N)","(%)","(MPa)"',
        [np.arange(20), STRAIN, STRESS, 100 * STRAIN, STRESS / 1e6],
        ",",
        ".",
    ),
    "several brackets": (
        "Tensile stress (MPa),Tensile strain (Displacement) (%)",
        [STRESS / 1e6, 100 * STRAIN],
        ",",
        ".",
    ),
    "metadata before": (
        "Operator;A. B.\nStandard;ASTM D412\n;;\nStrain measurement;Global\n\nStrain;Stress (MPa)",
        [STRAIN, STRESS / 1e6],
        ";",
        ".",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_formats_and_units(tmp_path: Path, case: str) -> None:
    head, columns, mark, decimal = CASES[case]
    check(read_test(write(tmp_path / "a.csv", head, columns, mark, decimal)))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path / "a.csv", "Strain;Stress (N/mm²)", [STRAIN, STRESS / 1e6], ";")
    path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
    check(read_test(path))


def test_force_and_displacement_with_options(tmp_path: Path) -> None:
    area, length = 18e-6, 33e-3
    path = write(
        tmp_path / "a.csv",
        "Extension (mm),Load (N)",
        [STRAIN * length * 1e3, STRESS * area],
        ",",
    )
    check(read_test(path, area=area, gauge_length=length))
    with pytest.raises(InputError, match="--gauge-length"):
        read_test(path, area=area)
    with pytest.raises(InputError, match="--area"):
        read_test(path, gauge_length=length)


def test_force_and_displacement_with_metadata(tmp_path: Path) -> None:
    head = (
        "Specimen Thickness (mm);3\nSpecimen Width (mm);6\nSpecimen Length (mm);33\n"
        "Displacement (mm);Force (N)"
    )
    columns = [STRAIN * 33.0, STRESS * 18e-6]
    data = read_test(write(tmp_path / "a.csv", head, columns, ";"))
    check(data)
    assert sum("specimen: " in note for note in data.notes) == 2
    head = head.replace("Specimen Width (mm);6", "Specimen Cross-section (cm^2);0.18")
    check(read_test(write(tmp_path / "b.csv", head, columns, ";")))


def test_engineering_columns_come_first_and_are_reported(tmp_path: Path) -> None:
    head = "True Strain;True Stress (MPa);Engineering Strain;Engineering Stress (MPa)"
    # The true columns are wrong on purpose.
    columns = [0 * STRAIN + 9.0, 0 * STRAIN, STRAIN, STRESS / 1e6]
    data = read_test(write(tmp_path / "a.csv", head, columns, ";"))
    check(data)
    assert [note.split(":")[0] for note in data.notes] == ["engineering-first"] * 2


def test_several_columns_of_one_kind(tmp_path: Path) -> None:
    head = "Strain,Stress A (MPa),Stress B (MPa),Force (N)"
    columns = [STRAIN, STRESS / 1e6, STRESS, STRESS]
    data = read_test(write(tmp_path / "a.csv", head, columns, ","))
    check(data)
    said = " ".join(data.notes)
    assert "first-column" in said and "stress-first" in said and "unnamed-is-engineering" in said


def rule_counts(data: TensileData) -> set[str]:
    return {rule for rule in RULES if any(f"{rule}: " in note for note in data.notes)}


def test_unloading_is_dropped(tmp_path: Path) -> None:
    strain = np.concatenate([STRAIN, STRAIN[::-1][1:]])
    stress = np.concatenate([STRESS, 0.7 * STRESS[::-1][1:]])
    data = read_test(write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [strain, stress], ","))
    check(data)
    assert rule_counts(data) == {"loading-only"}
    assert "dropped 19 of 39 points" in data.notes[0]


def test_noisy_start_is_not_fitted_but_kept(tmp_path: Path) -> None:
    strain = np.concatenate([[0.0, 0.01, 0.02], STRAIN])
    stress = np.concatenate([[-50.0, -40.0, -3.0], STRESS])
    data = read_test(write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [strain, stress], ","))
    assert data.stretch.size == 23
    assert data.fitted.tolist() == [False] * 3 + [True] * 20
    assert {"noisy-start", "rest-point"} <= rule_counts(data)
    assert any("2 leading points" in note for note in data.notes)


def test_failure_tail_is_dropped_but_noise_at_the_top_is_not(tmp_path: Path) -> None:
    strain = np.concatenate([STRAIN, [1.01, 1.02]])
    for factors, left in (((0.7, 0.05), 20), ((0.99, 0.97), 22)):
        stress = np.concatenate([STRESS, STRESS[-1] * np.array(factors)])
        data = read_test(
            write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [strain, stress], ",")
        )
        assert data.stretch.size == left
        assert ("failure-tail" in rule_counts(data)) == (left == 20)


def test_offset_is_reported(tmp_path: Path) -> None:
    columns = [STRAIN, STRESS + 0.1 * STRESS.max()]
    data = read_test(write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", columns, ","))
    assert rule_counts(data) == {"start-offset"}


def test_max_stretch(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [STRAIN, STRESS], ",")
    data = read_test(path, max_stretch=1.5)
    check(data, STRETCH[:10], STRESS[:10])
    assert "dropped 10 points" in data.notes[0]


def test_compression_is_read(tmp_path: Path) -> None:
    stretch = np.linspace(0.95, 0.5, 10)
    stress = 1e5 * (stretch - stretch**-2)
    path = write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [stretch - 1, stress], ",")
    data = read_test(path)
    check(data, stretch, stress)
    assert data.fitted.all()


def test_compressive_columns_are_turned_to_negative(tmp_path: Path) -> None:
    stretch = np.linspace(0.95, 0.5, 10)
    stress = 1e5 * (stretch - stretch**-2)
    head = "Compressive strain (%),Compressive stress (kPa)"
    path = write(tmp_path / "a.csv", head, [100 * (1 - stretch), -stress / 1e3], ",")
    data = read_test(path)
    check(data, stretch, stress)
    assert sum("compression-sign: " in note for note in data.notes) == 2


@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ("", "is empty", None),
        ("1,2\n3,4\n", "no header line", None),
        ("Strain,Stress (MPa)\n", "not followed by numbers|no header", None),
        ("Strain,Stress\n0.1,2\n0.2,3\n", 'column "Stress" has no unit', 1),
        ("Strain,Stress (mm)\n0.1,2\n0.2,3\n", "not a unit of stress", 1),
        ("Strain (kPa),Stress (kPa)\n0.1,2\n0.2,3\n", "not a unit of strain", 1),
        ("a,b\nStrain,Stress (kPa)\n0.1,2\n0.2,x\n", '"x" in column "Stress', 4),
        ("Strain,Stress (kPa)\n0.1,2\n0.2\n", '"" in column', 3),
        ("Strain,Stress (kPa)\n0.1,2\n-1.5,3\n", "stretches must be > 0", 3),
        ("Strain,Stress (kPa)\n0.1,2\n", "needs at least 2", None),
    ],
)
def test_errors_name_file_and_line(
    tmp_path: Path, text: str, message: str, line: int | None
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_test(path)
    assert "bad.csv" in str(caught.value)
    if line is not None:
        assert f"line {line}" in str(caught.value)


def test_missing_file_and_unknown_mode(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_test(tmp_path / "none.csv")
    path = write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [STRAIN, STRESS], ",")
    with pytest.raises(InputError, match="mode must be one of"):
        read_test(path, "biaxial")


def test_arrays_are_read_only(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "Eng strain,Eng stress (Pa)", [STRAIN, STRESS], ",")
    data = read_test(path)
    with pytest.raises(ValueError, match="read-only"):
        data.stress[0] = math.pi
