"""Case files: what they say, and how they are refused."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from flexapod.app.assemble import make_builder, match_names
from flexapod.app.case import (
    apply_setting,
    case_schema,
    load_case,
    parse_case,
    parse_value,
    shipped_cases,
)
from flexapod.app.run import resolve
from flexapod.core.errors import InputError

BASE: dict[str, Any] = {
    "mesh": {"builder": "curl", "size": "coarse"},
    "material": [{"use": "dragon-skin-20-sospider"}],
    "gravity": {},
    "pressure": [{"name": "inflation", "surface": "cavity_*", "value": "55 kPa"}],
    "contact": [{"type": "self", "surface": "chamber_faces"}],
    "step": [{"name": "inflate", "loads": {"gravity": 1.0, "inflation": 1.0}}],
    "probe": [{"type": "rotation", "surface": "end", "axis": "-y"}],
}


def _changed(path: str, value: Any) -> dict[str, Any]:
    table = copy.deepcopy(BASE)
    here: Any = table
    *parts, last = path.split(".")
    for part in parts:
        here = here[int(part)] if part.isdigit() else here[part]
    here[last] = value
    return table


def test_si_inside() -> None:
    case = parse_case(BASE, "x.toml")
    assert case.pressure[0].value == 55000.0
    assert case.gravity is not None
    assert case.gravity.acceleration == (0.0, 0.0, -9.8)
    assert case.contact[0].radius == 500.0
    assert case.contact[0].reference_area == 9e-6


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (
            "pressure.0.value",
            55,
            'pressure.inflation.value: write a pressure with its unit, for example "55 kPa"; '
            "got 55",
        ),
        ("pressure.0.value", "5 mm", 'got "5 mm", and "mm" does not measure a pressure'),
        ("prssure", [], "prssure: unknown key (did you mean pressure?); allowed here: name,"),
        ("mesh.siz", "coarse", "mesh.siz: unknown key (did you mean size?); allowed here: builder"),
        ("mesh.size", "huge", "mesh.size: write coarse, default, fine or write a length"),
        ("mesh.size", 3, "mesh.size: write coarse, default, fine or write a length"),
        ("mesh.units", 2.5, "mesh.units: must be a whole number; got 2.5"),
        ("mesh.units", 0, "units must be a whole number from 1 to 1000, got 0"),
        ("mesh.servos", "yes", "mesh.servos: must be true or false; got 'yes'"),
        ("mesh.symmetry", "third", "must be one of whole, half, quarter"),
        ("mesh.main", {"gapp": "3 mm"}, "mesh.main.gapp: unknown key (did you mean gap?)"),
        ("mesh.main", {"gap": "4 mm"}, "l + d of main = l + d of assistant: 18 mm != 17 mm"),
        (
            "mesh.builder",
            "crul",
            'mesh.builder: must be one of pneunet, curl, turn, ring; got "crul"',
        ),
        ("mesh", {}, "mesh: write exactly one of builder and file"),
        ("mesh", {"file": "a.vtu", "builder": "curl"}, "write exactly one of builder and file"),
        ("mesh", {"file": "a.vtu", "size": "fine"}, "unknown key size"),
        ("material", [], "material: needs at least one item"),
        ("material.0.model", "ogden", "material.0: write exactly one of use and model"),
        ("material", [{"model": "yeoh", "mu": "3 kPa", "density": "1 g/cm3"}], "yeoh takes c"),
        ("material", [{"model": "neo-hooke", "mu": "3 kPa"}], "density is missing"),
        ("material.0.use", 3, "material.0.use: must be a valid string; got 3"),
        ("gravity", 9.8, "gravity: must be a table; got 9.8"),
        ("gravity", {"acceleration": ["0 m/s^2"]}, "gravity.acceleration.1: required, but missing"),
        ("step.0.loads", {"gravity": 1.0, "inflaton": 1.0}, 'names the load "inflaton"; the loads'),
        ("step.0.loads", {"gravity": 1.0}, "no step applies inflation"),
        ("step.0.outputs", 0, "step.inflate.outputs: must be greater than or equal to 1; got 0"),
        ("contact.0.type", "glue", "contact.0.type: must be one of 'self', 'plane', 'pair'"),
        ("contact", [{"surface": "a"}], "contact.0.type: required, one of self, plane, pair"),
        ("contact.0.normal", [0, 0, 1], "contact.0.normal: unknown key; allowed here: surface,"),
        (
            "contact",
            [{"type": "plane", "surface": "a", "normal": [0, 0, 0]}],
            "contact.0.normal: the normal must have a length",
        ),
        ("probe.0.axis", "w", "probe.0.axis: must be 'x', 'y', 'z', '-x', '-y' or '-z'; got 'w'"),
        ("pressure.0.name", "gravity", "load names must differ; used twice: gravity"),
        ("probe", [{"type": "displacement", "name": "a"}], "exactly one of surface and point"),
        ("reference", {"name": "a", "points": [1]}, "exactly one of polynomial and file"),
    ],
)
def test_refusals_name_file_key_and_remedy(path: str, value: Any, message: str) -> None:
    with pytest.raises(InputError) as error:
        parse_case(_changed(path, value), "x.toml")
    assert str(error.value).startswith("x.toml: ")
    assert message in str(error.value)


def test_several_faults_are_one_line_each() -> None:
    table = _changed("contact", [{"type": "plane", "surfac": "underside"}])
    with pytest.raises(InputError) as error:
        parse_case(table, "x.toml")
    lines = str(error.value).splitlines()
    assert lines[0] == "x.toml: 2 faults"
    assert lines[1] == "contact.0.surface: required, but missing"
    assert lines[2].startswith("contact.0.surfac: unknown key (did you mean surface?)")


def test_a_case_without_loads_or_steps() -> None:
    with pytest.raises(InputError, match="nothing loads the body"):
        parse_case({k: v for k, v in BASE.items() if k not in ("gravity", "pressure", "step")}, "x")
    case = parse_case({k: v for k, v in BASE.items() if k != "step"}, "x")
    assert [dict(step.loads) for step in case.steps] == [{"gravity": 1.0, "inflation": 1.0}]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("5", 5),
        ("0.5", 0.5),
        ("true", True),
        ('["x", "y"]', ["x", "y"]),
        ("3 mm", "3 mm"),
        ("coarse", "coarse"),
        ('"3 mm"', "3 mm"),
        ("{ a = 1 }", {"a": 1}),
    ],
)
def test_set_values(text: str, value: object) -> None:
    assert parse_value(text) == value


def test_set_reaches_into_lists_by_name_and_index() -> None:
    table = copy.deepcopy(BASE)
    apply_setting(table, "step.inflate.outputs=5")
    apply_setting(table, "pressure.0.value=20 kPa")
    apply_setting(table, "mesh.main.outer_wall=4 mm")
    apply_setting(table, "contact=[]")
    assert table["step"][0]["outputs"] == 5
    assert table["pressure"][0]["value"] == "20 kPa"
    assert table["mesh"]["main"] == {"outer_wall": "4 mm"}
    assert table["contact"] == []


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("mesh.size", "--set: write key.path=value"),
        ("=3", "--set: write key.path=value"),
        ("step.deflate.outputs=5", "step has no item deflate; it has 0 to 0, or by name: inflate"),
        ("contact.3.type=self", "contact has no item 3; it has 0 to 0"),
        ("mesh.size.x=1", "mesh.size is a value, not a table"),
    ],
)
def test_set_refusals(setting: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        apply_setting(copy.deepcopy(BASE), setting)
    assert message in str(error.value)


def test_set_typo_is_an_unknown_key() -> None:
    with pytest.raises(InputError, match=r"mesh\.siz: unknown key"):
        load_case("curl", ["mesh.siz=coarse"])


def test_builder_options_are_lengths_in_metres() -> None:
    table = _changed("mesh", {"builder": "pneunet", "size": "4 mm"})
    table["mesh"]["dimensions"] = {"limit_layer": "10 mm"}
    builder = make_builder(parse_case(table, "x").mesh, "x")
    assert builder.size == 0.004
    assert builder.dimensions.limit_layer == 0.01
    assert builder.dimensions.chamber_length == 0.008


@pytest.mark.parametrize("name", sorted(shipped_cases()))
def test_resolved_case_is_the_same_case(name: str, tmp_path: Path) -> None:
    loaded = load_case(name)
    resolved = resolve(loaded, None)
    path = tmp_path / "case.resolved.toml"
    path.write_text(tomli_w.dumps(json.loads(json.dumps(resolved))))
    again = resolve(load_case(str(path)), None)
    assert {k: v for k, v in again.items() if k != "resolved"} == {
        k: v for k, v in resolved.items() if k != "resolved"
    }
    assert resolved["resolved"]["flexapod_version"]


def test_not_toml(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("mesh = = 3\n")
    with pytest.raises(InputError, match=r"bad\.toml: not valid TOML: .*line"):
        load_case(str(path))


def test_missing_case_lists_the_shipped_ones() -> None:
    with pytest.raises(InputError, match=r"no such case file; shipped cases, by name: .*curl"):
        load_case("nonsense")


def test_group_globs() -> None:
    known = ["cavity_left", "cavity_right", "end"]
    assert match_names(["cavity_*", "end"], known, "surface", "x") == known
    with pytest.raises(InputError, match=r'x: no surface group "ends" \(did you mean end\?\)'):
        match_names(["ends"], known, "surface", "x")


def test_schema_describes_quantities_and_builders() -> None:
    schema = case_schema()
    json.dumps(schema)
    value = schema["$defs"]["PressureSpec"]["properties"]["value"]
    assert value["type"] == "string"
    assert value["examples"] == ["55 kPa"]
    options = {
        choice["properties"]["builder"]["const"]: choice["properties"]
        for choice in schema["$defs"]["MeshSpec"]["oneOf"]
        if isinstance(choice["properties"]["builder"], dict)
    }
    assert set(options) == {"pneunet", "curl", "turn", "ring"}
    assert options["curl"]["servo_length"]["default"] == "45 mm"
    assert options["pneunet"]["dimensions"]["properties"]["gap"]["type"] == "string"


def test_shipped_cases_have_a_title_of_one_line() -> None:
    assert {"curl", "turn", "free_curl", "own_mesh"} <= set(shipped_cases())
    for title in shipped_cases().values():
        assert title
        assert "\n" not in title
