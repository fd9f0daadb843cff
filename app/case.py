"""The case file: what to compute, in words, with units, and nothing else.

A case is TOML read into frozen pydantic models. Every quantity carries its unit, every unknown
key is refused with the keys that are allowed, and every message names the file and the key the
way ``--set`` would write it (``step.inflate.outputs``). The models hold SI floats.
"""

from __future__ import annotations

import difflib
import tomllib
import types
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version as _distribution_version
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from flexapod.app.spec import Case
from flexapod.core.errors import InputError
from flexapod.core.units import Quantity


def package_version() -> str:
    """Version of the installed distribution."""
    return _distribution_version("flexapod")


class LoadedCase:
    """A case with the file it came from, which relative paths start at."""

    def __init__(self, case: Case, source: str, folder: Path) -> None:
        self.case = case
        self.source = source
        self.folder = folder

    @property
    def name(self) -> str:
        """The case's name, by default its file's."""
        return self.case.name or Path(self.source).stem

    def path(self, text: str) -> Path:
        """A path of the case file, relative to that file."""
        path = Path(text).expanduser()
        return path if path.is_absolute() else self.folder / path

    def resolved(self, **info: Any) -> dict[str, Any]:
        """The whole case as TOML-ready tables: defaults filled in, paths absolute."""
        table = self.case.model_dump(mode="json", by_alias=True, exclude_none=True)
        table["name"] = self.name
        if self.case.dynamics is None:
            table["step"] = [
                step.model_dump(mode="json", exclude_none=True) for step in self.case.steps
            ]
        if self.case.mesh is not None and self.case.mesh.file is not None:
            table["mesh"]["file"] = str(self.path(self.case.mesh.file).resolve())
        for material in table["material"]:
            if "use" in material and material["use"].endswith(".toml"):
                material["use"] = str(self.path(material["use"]).resolve())
        for contact in table.get("contact", []):
            if contact.get("file"):
                contact["file"] = str(self.path(contact["file"]).resolve())
        if self.case.start is not None and self.case.start.case is not None:
            name = start_case({"start": table["start"]}, Path(self.source))
            table["start"]["case"] = name
        if self.case.reference is not None and self.case.reference.file is not None:
            table["reference"]["file"] = str(self.path(self.case.reference.file).resolve())
        table["resolved"] = {
            "flexapod_version": package_version(),
            "source": self.source,
            **{key: value for key, value in info.items() if value is not None},
        }
        return _drop_empty(table)


def _drop_empty(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: value
        for key, value in table.items()
        if value not in ([], {}, (), "") or key == "loads"
    }


# --------------------------------------------------------------------------- reading


def shipped_cases() -> dict[str, str]:
    """Name to title of every case that comes with the package."""
    found = {}
    for entry in sorted(files("flexapod.cases").iterdir(), key=lambda item: item.name):
        if entry.name.endswith(".toml"):
            table = tomllib.loads(entry.read_text(encoding="utf-8"))
            found[entry.name.removesuffix(".toml")] = str(table.get("title", ""))
    return found


def find_case(name: str) -> Path:
    """Path of a case file given as a path, or by the name of a shipped case."""
    path = Path(name).expanduser()
    if path.is_file():
        return path
    if path.is_dir() and (path / "case.resolved.toml").is_file():
        return path / "case.resolved.toml"
    if path.parent == Path("."):
        entry = files("flexapod.cases") / f"{path.name.removesuffix('.toml')}.toml"
        if entry.is_file():
            with as_file(entry) as shipped:
                return shipped
    raise InputError(
        f"no such case file; shipped cases, by name: {', '.join(shipped_cases())}", str(name)
    )


def load_case(name: str, settings: Sequence[str] = ()) -> LoadedCase:
    """Read, override (``key.path=value``) and check a case."""
    path = find_case(name)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}", str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", str(path)) from None
    table = _extended(table, path)
    _inherit(table, path)
    for setting in settings:
        apply_setting(table, setting)
    case = parse_case(table, str(path))
    return LoadedCase(case, str(path), path.resolve().parent)


def _extended(table: dict[str, Any], path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The table laid over the case it names as `extends`; lists of tables are taken whole.

    What a paper says is said of one case: it is not handed on.
    """
    name = table.pop("extends", None)
    if name is None:
        return table
    if not isinstance(name, str):
        raise InputError(f"must be the name of a case, got {name!r}", f"{path}: extends")
    other = _base_case(name, path)
    if other.resolve() == path.resolve():
        raise InputError("a case cannot extend itself", f"{path}: extends")
    try:
        source = tomllib.loads(other.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, OSError, UnicodeDecodeError) as error:
        raise InputError(f"extends: {other} cannot be read: {error}", str(path)) from None
    if len(above) > 8:
        raise InputError("extends cases without end", f"{path}: extends")
    base = _extended(source, other, (*above, path))
    _with_absolute_files(base, other.resolve().parent)
    base.pop("paper", None)
    return _laid_over(base, table)


def _base_case(name: str, path: Path) -> Path:
    """A case beside `path`, or a shipped one; never one that lies where the user happens to be."""
    beside = path.resolve().parent / name
    if beside.is_file():
        return beside
    entry = files("flexapod.cases") / f"{name.removesuffix('.toml')}.toml"
    if Path(name).parent == Path() and entry.is_file():
        with as_file(entry) as shipped:
            return shipped
    raise InputError(
        f'no such case beside it or among the shipped ones: "{name}"; shipped: '
        f"{', '.join(shipped_cases())}",
        f"{path}: extends",
    )


def _with_absolute_files(table: dict[str, Any], folder: Path) -> None:
    """Paths in the tables of a case that lies in `folder`, made absolute in place."""
    places = [
        *((item, "file") for item in _tables(table.get("contact"))),
        *((item, "use") for item in _tables(table.get("material"))),
        *((table[key], "file") for key in ("mesh", "reference") if key in table),
        *((table[key], "case") for key in ("start",) if key in table),
    ]
    for item, key in places:
        text = item.get(key) if isinstance(item, dict) else None
        if isinstance(text, str) and (folder / text).is_file():
            item[key] = str((folder / text).resolve())


def _laid_over(base: dict[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    both = dict(base)
    for key, value in table.items():
        below = both.get(key)
        # A table of another type is another thing, and takes nothing over.
        if (
            isinstance(value, dict)
            and isinstance(below, dict)
            and value.get("type", below.get("type")) == below.get("type")
        ):
            value = _laid_over(below, value)
        both[key] = value
    return both


def start_case(table: Mapping[str, Any], path: Path) -> str | None:
    """Name of the case a motion starts from as `find_case` takes it; None without."""
    start = table.get("start")
    name = start.get("case") if isinstance(start, dict) else None
    if not isinstance(name, str):
        return None
    beside = path.resolve().parent / name
    return str(beside) if beside.is_file() else name


def _inherit(table: dict[str, Any], path: Path) -> None:
    """Take mesh, materials and masses of the case a motion starts from."""
    name = start_case(table, path)
    if name is None:
        return
    other = find_case(name)
    try:
        source = tomllib.loads(other.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, OSError, UnicodeDecodeError) as error:
        raise InputError(f"start.case cannot be read: {error}", str(path)) from None
    source = _extended(source, other)
    for key in ("mesh", "material", "mass"):
        if key not in table and key in source:
            table[key] = source[key]
            # Their files lie beside the case they come from.
            for item, name in ((source[key], "file"), *((i, "use") for i in _tables(source[key]))):
                text = item.get(name) if isinstance(item, dict) else None
                if isinstance(text, str) and (name == "file" or text.endswith(".toml")):
                    item[name] = str((other.resolve().parent / text).resolve())


def _tables(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def parse_case(table: Mapping[str, Any], where: str) -> Case:
    """Check a table; every fault becomes one line of one `InputError`."""
    try:
        case = Case.model_validate(table)
    except ValidationError as error:
        faults = error.errors()
        # A list whose items are refused is also reported as too short: say it once.
        deeper = [fault["loc"] for fault in faults if len(fault["loc"]) > 1]
        lines = [
            _line(fault, table)
            for fault in faults
            if not any(loc[:-1][: len(fault["loc"])] == fault["loc"] for loc in deeper)
        ]
        if len(lines) == 1:
            raise InputError(lines[0], where) from None
        raise InputError("\n".join([f"{len(lines)} faults", *lines]), where) from None
    if case.mesh is not None:
        from flexapod.app.assemble import check_builder

        check_builder(case.mesh, where)
    return case


def apply_setting(table: dict[str, Any], setting: str) -> None:
    """Apply one ``key.path=value``; list items go by index or by their name."""
    key, equals, text = setting.partition("=")
    if not equals or not all(part.strip() for part in key.split(".")):
        raise InputError(
            f'write key.path=value, for example step.inflate.outputs=5; got "{setting}"', "--set"
        )
    put_value(table, key, parse_value(text), f"--set {key.strip()}")


def put_value(table: dict[str, Any] | list[Any], key: str, value: Any, where: str) -> None:
    """Put a value at ``key.path`` of a table.

    List items go by index or by name, all of a type by it, or all by "*".
    """
    parts = [part.strip() for part in key.strip().split(".")]
    target: Any = table
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(target, list) and (chosen := _several(target, part)):
            rest = ".".join(parts[depth + 1 :])
            for k in chosen:
                put_value(target, f"{k}.{rest}" if rest else str(k), value, where)
            return
        if isinstance(target, list):
            index = _index(target, part, ".".join(parts[:depth]), where)
            if last:
                target[index] = value
            else:
                target = target[index]
        elif isinstance(target, dict):
            if last:
                target[part] = value
            else:
                target = target.setdefault(part, {})
        else:
            raise InputError(f"{'.'.join(parts[:depth])} is a value, not a table", where)


def _labels(items: list[Any]) -> list[Any]:
    return [item.get("name", item.get("group")) for item in items if isinstance(item, dict)]


def _several(items: list[Any], part: str) -> list[int]:
    """Indices of the items that ``*`` or a type stands for; none where `part` names one."""
    if part == "*":
        return list(range(len(items)))
    if part in _labels(items):
        return []
    return [k for k, i in enumerate(items) if isinstance(i, dict) and i.get("type") == part]


def _index(items: list[Any], part: str, path: str, where: str) -> int:
    labels = _labels(items)
    if part in labels:
        return labels.index(part)
    if part.lstrip("-").isdigit() and -len(items) <= int(part) < len(items):
        return int(part)
    named = [str(label) for label in labels if label is not None]
    choice = f"0 to {len(items) - 1}" if items else "nothing, the list is empty"
    if named:
        choice += f", or by name: {', '.join(named)}"
    types = sorted({str(i["type"]) for i in items if isinstance(i, dict) and "type" in i})
    if types:
        choice += f", or all of a type: {', '.join(types)}"
    raise InputError(f"{path} has no item {part}; it has {choice}", where)


def parse_value(text: str) -> Any:
    """A TOML value, else the text itself: ``5``, ``true``, ``["x", "y"]``, ``3 mm``."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, KeyError):
        return text.strip()


# --------------------------------------------------------------------------- messages


def _strip(annotation: Any) -> list[Any]:
    """The models an annotation may hold, through Optional, Union, list and Annotated."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _strip(get_args(annotation)[0])
    if origin in (Union, types.UnionType, tuple, list):
        return [model for part in get_args(annotation) for model in _strip(part)]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return []


def _tag(model: type[BaseModel]) -> str | None:
    field = model.model_fields.get("type")
    return get_args(field.annotation)[0] if field is not None else None


def allowed_keys(location: Iterable[int | str]) -> list[str]:
    """Keys of the table at a location of the case, for messages."""
    models: list[type[BaseModel]] = [Case]
    for part in location:
        if isinstance(part, int):
            continue
        tagged = [model for model in models if _tag(model) == part]
        if tagged:
            models = tagged
            continue
        nested: list[type[BaseModel]] = []
        for model in models:
            for name, field in model.model_fields.items():
                if part in (name, field.alias):
                    nested += _strip(field.annotation)
        models = nested
    keys: dict[str, None] = {}
    for model in models:
        for name, field in model.model_fields.items():
            if not (model is Case and name == "resolved"):
                keys[field.alias or name] = None
    return list(keys)


def _key_path(location: Sequence[int | str], table: Mapping[str, Any]) -> str:
    parts: list[str] = []
    here: Any = table
    for part in location:
        if isinstance(part, int):
            item = here[part] if isinstance(here, list) and part < len(here) else None
            label = item.get("name") if isinstance(item, dict) else None
            parts.append(str(label if label is not None else part))
            here = item
        elif isinstance(here, dict) and part not in here and here.get("type") == part:
            continue  # pydantic puts the tag of a tagged union into the location
        else:
            parts.append(part)
            here = here.get(part) if isinstance(here, dict) else None
    return ".".join(parts)


def _line(fault: Any, table: Mapping[str, Any]) -> str:
    location = list(fault["loc"])
    key = _key_path(location, table)
    kind, given = fault["type"], fault["input"]
    if kind == "extra_forbidden":
        allowed = allowed_keys(location[:-1])
        near = difflib.get_close_matches(str(location[-1]), allowed, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        text = f"unknown key{hint}; allowed here: {', '.join(allowed)}"
    elif kind == "missing":
        text = "required, but missing"
    elif kind == "value_error":
        text = str(fault["ctx"]["error"])
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        key = f"{key}.type" if key else "type"
        wanted = fault["ctx"].get("expected_tags") or "a type"
        got = given.get("type") if isinstance(given, dict) else given
        if kind == "union_tag_invalid":
            text = f'must be one of {wanted}; got "{got}"'
        else:
            text = f"required, one of {', '.join(_tags(location))}"
    elif kind == "literal_error":
        text = f"must be {fault['ctx']['expected']}; got {given!r}"
    elif kind == "model_type":
        text = f"must be a table; got {given!r}"
    elif kind == "too_short":
        text = "needs at least one item"
    else:
        words = fault["msg"].replace("Input should be", "must be")
        text = f"{words[0].lower()}{words[1:]}; got {given!r}"
    return f"{key}: {text}" if key else text


def _tags(location: Sequence[int | str]) -> list[str]:
    field = Case.model_fields.get(str(location[0])) if location else None
    models = _strip(field.annotation) if field is not None else []
    return [tag for model in models if (tag := _tag(model)) is not None]


# --------------------------------------------------------------------------- schema


def case_schema() -> dict[str, Any]:
    """JSON schema of a case file, with the options of every builder."""
    from flexapod.app.assemble import builder_schemas

    schema = Case.model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "flexapod case"
    mesh = schema["$defs"]["MeshSpec"]
    builders = builder_schemas()
    mesh["properties"]["builder"] = {
        "type": "string",
        "enum": sorted(builders),
        "description": "Name of a built-in body.",
    }
    mesh["oneOf"] = [
        {"required": ["file"], "properties": {"builder": False}},
        *(
            {
                "required": ["builder"],
                "properties": {"builder": {"const": name}, "file": False, **options},
            }
            for name, options in sorted(builders.items())
        ),
    ]
    mesh.pop("additionalProperties", None)
    mesh["unevaluatedProperties"] = False
    # A motion takes mesh and materials from the case it starts from; a ring has none.
    schema["anyOf"] = [{"required": ["mesh", "material"]}, {"required": ["start"]},
                       {"required": ["ring"]}]  # fmt: skip
    return schema


__all__ = [
    "Case",
    "LoadedCase",
    "Quantity",
    "apply_setting",
    "case_schema",
    "find_case",
    "load_case",
    "package_version",
    "parse_case",
    "put_value",
    "shipped_cases",
]
