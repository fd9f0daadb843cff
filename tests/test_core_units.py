"""Quantities with units at the border."""

from __future__ import annotations

import math

import pytest

from flexapod.core import units
from flexapod.core.errors import InputError
from flexapod.core.units import read_quantity, unit_scale, write_quantity


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("55 kPa", "Pa", 55000.0),
        ("55kPa", "Pa", 55000.0),
        (" -0.683 MPa ", "Pa", -683000.0),
        ("98 mm", "m", 0.098),
        ("1e-3 m", "m", 0.001),
        (".5 inch", "m", 0.0127),
        ("1080 kg/m^3", "kg/m^3", 1080.0),
        ("1.08 g/cm3", "kg/m^3", 1080.0),
        ("-9.8 m/s2", "m/s^2", -9.8),
        ("180 deg", "rad", math.pi),
        ("1 kgf/cm2", "Pa", 98066.5),
        ("97 N/mm^1.5", "N/m^1.5", 97 * 1000**1.5),
        ("2 ml", "m^3", 2e-6),
    ],
)
def test_reads_si(text: str, unit: str, value: float) -> None:
    assert read_quantity(text, unit) == pytest.approx(value, rel=1e-14)


def test_decimal_multiples_are_the_nearest_double() -> None:
    assert read_quantity("98 mm", "m") == 0.098
    assert read_quantity("55 kPa", "Pa") == 55000.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (55, 'write a pressure with its unit, for example "55 kPa"; got 55'),
        ("55", 'got "55", which has no unit'),
        ("55 mm", 'got "55 mm", and "mm" does not measure a pressure'),
        ("55 foo", 'got "55 foo", and "foo" is not a unit known here'),
        ("5,5 kPa", "write the decimal point as '.'"),
        ("kPa", 'got "kPa"'),
        (None, "got None"),
        (True, "got True"),
        ("1e999 Pa", "not finite"),
        ("55 %", '"%" is not a unit known here'),
    ],
)
def test_refuses_and_says_what_to_write(text: object, message: str) -> None:
    with pytest.raises(InputError) as error:
        read_quantity(text, "Pa", "curl.toml: pressure.value")
    assert str(error.value).startswith("curl.toml: pressure.value: write a pressure with its unit")
    assert message in str(error.value)


def test_a_pure_number_is_no_angle() -> None:
    # Pint counts radians as dimensionless; "20 %" must not pass for 0.2 rad.
    for text in ("20", "20 %", "0.2 m/m"):
        with pytest.raises(InputError):
            read_quantity(text, "rad")


@pytest.mark.parametrize("unit", ["Pa", "m", "kg", "rad", "N", "kg/m^3", "m/s^2", "N/m^1.5"])
@pytest.mark.parametrize("value", [0.0, 1.0, -9.8, 55000.0, 0.098, 1 / 3, 1e-12, math.pi / 6, 7e10])
def test_writing_and_reading_gives_the_same_double(value: float, unit: str) -> None:
    assert read_quantity(write_quantity(value, unit), unit) == value


def test_writes_what_people_write() -> None:
    assert write_quantity(55000.0, "Pa") == "55 kPa"
    assert write_quantity(0.003, "m") == "3 mm"
    assert write_quantity(math.radians(30), "rad") == "30 deg"


def test_unit_scale() -> None:
    assert unit_scale("kPa", "Pa") == 1000.0


def test_a_broken_installation_is_not_taken_for_a_wrong_unit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing() -> None:
        raise ModuleNotFoundError("No module named 'platformdirs'")

    monkeypatch.setattr(units, "_registry", missing)
    with pytest.raises(ModuleNotFoundError, match="platformdirs"):
        units.read_quantity("31 daPa", "Pa")
