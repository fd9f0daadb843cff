"""The case file: what to compute, in words, with units, and nothing else.

A case is TOML read into frozen pydantic models. Every quantity carries its unit, every unknown
key is refused with the keys that are allowed, and every message names the file and the key the
way ``--set`` would write it (``step.inflate.outputs``). The models hold SI floats.
"""

from __future__ import annotations

import difflib
import math
import tomllib
import types
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version as _distribution_version
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from flexapod.core.errors import InputError
from flexapod.core.units import (
    Acceleration,
    AnyModulus,
    Area,
    ContactStiffness,
    Density,
    Force,
    Length,
    Mass,
    Modulus,
    PositiveLength,
    Pressure,
    Quantity,
)
from flexapod.materials.registry import make_law

Axis = Literal["x", "y", "z"]
Triple = tuple[float, float, float]
Names = tuple[str, ...]


def package_version() -> str:
    """Version of the installed distribution."""
    return _distribution_version("flexapod")


class _Table(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", populate_by_name=True, validate_default=True
    )


def _one_or_many(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


def _text(*texts: str) -> Any:
    """A default as a case file writes it; validated like the rest, so the schema can show it."""
    return texts[0] if len(texts) == 1 else texts


class MeshSpec(_Table):
    """Where the hexahedra come from: exactly one of `builder` and `file`.

    A builder's own options (`symmetry`, `units`, ... and its `dimensions` table) stand beside
    `builder`; ``flexapod schema`` lists them.
    """

    model_config = ConfigDict(
        frozen=True, extra="allow", populate_by_name=True, validate_default=True
    )

    builder: str | None = Field(default=None, description="Name of a built-in body.")
    file: str | None = Field(
        default=None, description="Eight-node hexahedra with groups, in any format meshio reads."
    )
    scale: Annotated[float, Field(gt=0)] | None = Field(
        default=None,
        description="Metres per length unit of the file: 0.001 for a mesh in mm (default 1).",
    )
    cavities: Names | None = Field(
        default=None, description="Surface groups of a mesh file that enclose air; globs allowed."
    )

    @property
    def options(self) -> dict[str, Any]:
        """The builder's options as written."""
        return dict(self.model_extra or {})

    @model_validator(mode="after")
    def _one_source(self) -> MeshSpec:
        if (self.builder is None) == (self.file is None):
            raise ValueError("write exactly one of builder and file")
        if self.builder is not None and (self.scale is not None or self.cavities is not None):
            raise ValueError("scale and cavities belong to a mesh file, not to a builder")
        if self.file is not None and self.options:
            raise ValueError(
                f"unknown key {', '.join(sorted(self.options))}; "
                "allowed beside file: scale, cavities"
            )
        return self


class MaterialSpec(_Table):
    """A material for one cell group, by name or by its coefficients."""

    group: str = Field(
        default="*", description="Cell group; '*' is every cell not named otherwise."
    )
    use: str | None = Field(
        default=None,
        description="Library name, or a material.toml written by 'flexapod fit --out'.",
    )
    model: Literal["ogden", "neo-hooke", "mooney-rivlin", "yeoh", "linear"] | None = None
    mu: tuple[AnyModulus, ...] | None = Field(
        default=None,
        description="ogden: moduli in the papers' mu/alpha convention; neo-hooke: shear modulus.",
    )
    alpha: tuple[float, ...] | None = Field(default=None, description="ogden: exponents.")
    c: tuple[AnyModulus, ...] | None = Field(
        default=None,
        description="mooney-rivlin: C10, C01; yeoh: C10, C20, C30 (the last may be left out).",
    )
    youngs_modulus: Modulus | None = Field(default=None, description="linear.")
    density: Density | None = Field(default=None, description="Overrides the library's.")
    poisson: Annotated[float, Field(gt=0, lt=0.49999)] | None = Field(
        default=None, description="Near-incompressibility (default 0.499, or the library's)."
    )

    @field_validator("mu", "c", mode="before")
    @classmethod
    def _single(cls, value: Any) -> Any:
        return _one_or_many(value)

    @property
    def coefficients(self) -> dict[str, Any]:
        """Coefficients as written, SI, by the names `make_law` takes."""
        names = ("mu", "alpha", "c", "youngs_modulus")
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    @model_validator(mode="after")
    def _complete(self) -> MaterialSpec:
        if (self.use is None) == (self.model is None):
            raise ValueError("write exactly one of use and model")
        if self.use is not None:
            if self.coefficients:
                raise ValueError(f"{', '.join(self.coefficients)} go with model, not with use")
            return self
        if self.model == "linear":
            if set(self.coefficients) != {"youngs_modulus"}:
                raise ValueError("linear takes youngs_modulus and poisson")
        else:
            assert self.model is not None
            make_law(self.model, self.coefficients)
        if self.density is None:
            raise ValueError('density is missing: write for example density = "1080 kg/m^3"')
        return self


class GravitySpec(_Table):
    """Weight of the body and of the added masses; the load's name is `gravity`."""

    acceleration: tuple[Acceleration, Acceleration, Acceleration] = Field(
        default=_text("0 m/s^2", "0 m/s^2", "-9.8 m/s^2")
    )


class MassSpec(_Table):
    """Mass carried by the body, spread evenly over the volume of a cell group."""

    group: str = Field(default="*", description="Cell groups; '*' is the whole body.")
    total: Mass
    of: Literal["model", "body"] = Field(
        default="model",
        description="Whether `total` is the mass on the modelled part, or on the whole body of "
        "which a builder's symmetry keeps a half or a quarter.",
    )


class SupportSpec(_Table):
    """Displacements held at zero on a surface."""

    surface: Names = Field(description="Surface groups; globs allowed.")
    directions: tuple[Axis, ...] = ("x", "y", "z")

    _surface = field_validator("surface", mode="before")(_one_or_many)
    _directions = field_validator("directions", mode="before")(_one_or_many)


class _NamedLoad(_Table):
    name: str = Field(min_length=1, description="Name the steps use.")
    surface: Names = Field(description="Surface groups; globs allowed.")

    _surface = field_validator("surface", mode="before")(_one_or_many)


class DisplacementSpec(_NamedLoad):
    """Prescribed displacements of a surface, scaled by the load's factor."""

    x: Length | None = None
    y: Length | None = None
    z: Length | None = None

    @model_validator(mode="after")
    def _some(self) -> DisplacementSpec:
        if self.x is None and self.y is None and self.z is None:
            raise ValueError('write at least one of x, y and z, for example x = "2 mm"')
        return self


class ForceSpec(_NamedLoad):
    """A dead force, spread over a surface by its area."""

    total: tuple[Force, Force, Force]


class TractionSpec(_NamedLoad):
    """A dead traction: force per reference area, of fixed direction."""

    value: tuple[Pressure, Pressure, Pressure]


class PressureSpec(_NamedLoad):
    """Air pressure that follows the surface it pushes on."""

    value: Pressure


def _with_length(value: Triple) -> Triple:
    if not 0.0 < math.hypot(*value) < math.inf:
        raise ValueError("the normal must have a length")
    return value


class _ContactBase(_Table):
    surface: Names = Field(description="Surface groups of the body; globs allowed.")
    stiffness: ContactStiffness | None = Field(
        default=None, description="Overrides the paper's k = sqrt(16 R E^2 / 9)."
    )
    radius: PositiveLength = Field(
        default=_text("500 m"), description="Radius of each side in the paper's law."
    )
    exponent: Annotated[float, Field(ge=1, le=4)] = Field(
        default=2.0, description="Exponent of the penetration: 2 in the paper, 1.5 for Hertz."
    )
    reference_area: Area = Field(
        default=_text("9 mm^2"), description="Area one contact point of the paper's law stands for."
    )

    _surface = field_validator("surface", mode="before")(_one_or_many)


class _FaceContactBase(_ContactBase):
    depth: PositiveLength = Field(
        default=_text("1 mm"),
        description="Deepest penetration still seen; less than half the thinnest wall.",
    )


class ContactSelfSpec(_FaceContactBase):
    """Faces of the body against each other, found by search; no friction."""

    type: Literal["self"]


class ContactPlaneSpec(_ContactBase):
    """The body against a fixed plane: the ground, a wall, a rigid block's face."""

    type: Literal["plane"]
    point: tuple[Length, Length, Length] = Field(default=_text("0 m", "0 m", "0 m"))
    normal: Triple = Field(default=(0.0, 0.0, 1.0), description="Towards the body; any length.")
    mirror: bool = Field(
        default=False,
        description="The plane is a symmetry plane: the body meets its own image, so the gap "
        "and the flexibility count twice.",
    )
    youngs_modulus: Modulus | None = Field(
        default=None, description="Of the plane (default: rigid)."
    )
    poisson: Annotated[float, Field(ge=0, le=0.5)] = Field(default=0.3, description="Of the plane.")
    friction: Annotated[float, Field(ge=0, lt=10)] = Field(
        default=0.0, description="Coulomb coefficient."
    )

    _direction = field_validator("normal")(_with_length)


class ContactPairSpec(_FaceContactBase):
    """Named surfaces against other named surfaces; no friction."""

    type: Literal["pair"]
    against: Names = Field(alias="with", description="The other surface groups; globs allowed.")

    _against = field_validator("against", mode="before")(_one_or_many)


class ContactWeightSpec(_Table):
    """A body on a table outside the model, sliding along it under its own weight."""

    type: Literal["weight"]
    normal: Triple = Field(description="Of the table; the body moves along it. Any length.")
    friction: Annotated[float, Field(gt=0, lt=10)] = Field(description="Coulomb coefficient.")
    acceleration: Acceleration = Field(
        default=_text("9.8 m/s^2"), description="Of gravity, onto the table."
    )
    slip: PositiveLength = Field(
        default=_text("0.1 mm"),
        description="Slip within an increment at which friction has 0.7 of its full force.",
    )

    _direction = field_validator("normal")(_with_length)


ContactSpec = Annotated[
    ContactSelfSpec | ContactPlaneSpec | ContactPairSpec | ContactWeightSpec,
    Field(discriminator="type"),
]


class StepSpec(_Table):
    """One stretch of the load path; loads it does not name keep their factor."""

    name: str = Field(min_length=1)
    loads: dict[str, float] = Field(
        description="Factor each named load reaches at the end of the step; linear in between."
    )
    outputs: Annotated[int, Field(ge=1, le=10000)] = Field(
        default=10, description="States written, evenly spaced over the step."
    )
    first: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None, description="First increment, as a fraction of the step."
    )
    smallest: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None, description="Smallest increment before the run gives up."
    )
    largest: Annotated[float, Field(gt=0, le=1)] | None = None


class ProbeRotationSpec(_Table):
    """Rotation of a surface about an axis as a rigid plate that fits it best, in degrees.

    Turns are counted, so a body that rolls up shows 400 degrees and not 40.
    """

    type: Literal["rotation"]
    name: str = "angle"
    surface: Names
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] = Field(
        default="y", description="Positive by the right hand."
    )
    times: float = Field(
        default=1.0, description="Factor, for example 2 for both halves of a body."
    )

    _surface = field_validator("surface", mode="before")(_one_or_many)


class ProbeDisplacementSpec(_Table):
    """Mean displacement of a surface, or of the node nearest a point, in mm."""

    type: Literal["displacement"]
    name: str
    surface: Names | None = None
    point: tuple[Length, Length, Length] | None = None
    direction: Axis | Literal["magnitude"] = "magnitude"

    _surface = field_validator("surface", mode="before")(_one_or_many)

    @model_validator(mode="after")
    def _where(self) -> ProbeDisplacementSpec:
        if (self.surface is None) == (self.point is None):
            raise ValueError("write exactly one of surface and point")
        return self


class ProbeReactionSpec(_Table):
    """Force the supports of a surface put on the body, in N."""

    type: Literal["reaction"]
    name: str
    surface: Names
    direction: Axis

    _surface = field_validator("surface", mode="before")(_one_or_many)


class ProbeVolumeSpec(_Table):
    """Volume enclosed by cavity surfaces, in ml; symmetry is not multiplied out."""

    type: Literal["volume"]
    name: str = "volume"
    surface: Names

    _surface = field_validator("surface", mode="before")(_one_or_many)


ProbeSpec = Annotated[
    ProbeRotationSpec | ProbeDisplacementSpec | ProbeReactionSpec | ProbeVolumeSpec,
    Field(discriminator="type"),
]


class ReferenceSpec(_Table):
    """A curve to compare with: a polynomial or a CSV file, in the units of the column heads."""

    name: str
    x: str = Field(default="pressure_kPa", description="Column of curve.csv along the axis.")
    y: str = Field(default="angle_deg", description="Column compared.")
    polynomial: tuple[float, ...] | None = Field(
        default=None, description="Coefficients, highest power first, in the units of x and y."
    )
    file: str | None = Field(default=None, description="CSV whose heads are the names in x and y.")
    points: tuple[float, ...] = Field(
        min_length=1, description="Values of x where the mean relative error is taken."
    )
    simulation_name: str | None = None
    simulation_error: Annotated[float, Field(ge=0)] | None = Field(
        default=None,
        description="Mean relative error of somebody else's simulation, to print beside.",
    )

    @model_validator(mode="after")
    def _source(self) -> ReferenceSpec:
        if (self.polynomial is None) == (self.file is None):
            raise ValueError("write exactly one of polynomial and file")
        return self


class PlotSpec(_Table):
    """What the pictures show."""

    x: str | None = Field(
        default=None, description="Column along the axis (default: the reference's)."
    )
    y: Names | None = Field(default=None, description="Columns drawn (default: the reference's).")
    mirror: tuple[Axis, ...] = Field(
        default=(),
        description="Symmetry planes through the origin, by their normal, drawn mirrored.",
    )
    view: Literal["side", "front", "top", "corner"] = "corner"
    snapshots: tuple[float, ...] | None = Field(
        default=None,
        description="Values of x shown in the strip of shapes (default: four, evenly).",
    )
    colour: Literal["displacement", "stretch", "pressure"] = "stretch"

    _y = field_validator("y", mode="before")(_one_or_many)


class SolverSpec(_Table):
    """Limits of the load path; the defaults suit the shipped cases."""

    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="Largest nodal residual over the largest nodal load or reaction."
    )
    iterations: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="Newton iterations before the increment is cut."
    )
    increments: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="Increments allowed for the whole path."
    )
    damped: bool | None = Field(
        default=None,
        description="Creep past limit points in a thinning viscous bath (default true).",
    )


class ResolvedSpec(_Table):
    """Written into case.resolved.toml; ignored when that file is run again."""

    flexapod_version: str
    source: str
    mesh_hash: str | None = None
    elements: int | None = None
    nodes: int | None = None


class Case(_Table):
    """A whole case file."""

    name: str | None = Field(default=None, description="Default: the file's name.")
    title: str = ""
    mesh: MeshSpec
    material: tuple[MaterialSpec, ...] = Field(min_length=1)
    gravity: GravitySpec | None = None
    mass: tuple[MassSpec, ...] = ()
    support: tuple[SupportSpec, ...] = ()
    displacement: tuple[DisplacementSpec, ...] = ()
    force: tuple[ForceSpec, ...] = ()
    traction: tuple[TractionSpec, ...] = ()
    pressure: tuple[PressureSpec, ...] = ()
    contact: tuple[ContactSpec, ...] = ()
    step: tuple[StepSpec, ...] = ()
    probe: tuple[ProbeSpec, ...] = ()
    reference: ReferenceSpec | None = None
    plot: PlotSpec = PlotSpec()
    solver: SolverSpec = SolverSpec()
    resolved: ResolvedSpec | None = None

    @property
    def load_names(self) -> list[str]:
        """Names the steps may use."""
        names = ["gravity"] if self.gravity is not None else []
        for group in (self.displacement, self.force, self.traction, self.pressure):
            names += [load.name for load in group]  # type: ignore[attr-defined]
        return names

    @property
    def steps(self) -> tuple[StepSpec, ...]:
        """The steps; without any, one that applies every load."""
        if self.step:
            return self.step
        return (StepSpec(name="load", loads={name: 1.0 for name in self.load_names}),)

    @model_validator(mode="after")
    def _names_agree(self) -> Case:
        names = self.load_names
        for what, listed in (
            ("load", names),
            ("step", [step.name for step in self.step]),
            ("probe", [probe.name for probe in self.probe]),
        ):
            double = sorted({name for name in listed if listed.count(name) > 1})
            if double:
                raise ValueError(f"{what} names must differ; used twice: {', '.join(double)}")
        if not names:
            raise ValueError(
                "nothing loads the body: add gravity, pressure, force, traction or displacement"
            )
        for step in self.step:
            for name in step.loads:
                if name not in names:
                    raise ValueError(
                        f'step "{step.name}" names the load "{name}"; '
                        f"the loads here are {', '.join(names)}"
                    )
        used = {name for step in self.step for name in step.loads}
        idle = [name for name in names if self.step and name not in used]
        if idle:
            raise ValueError(
                f"no step applies {', '.join(idle)}: name it in a step's loads (0.0 keeps it off)"
            )
        return self


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
        table["step"] = [
            step.model_dump(mode="json", exclude_none=True) for step in self.case.steps
        ]
        if self.case.mesh.file is not None:
            table["mesh"]["file"] = str(self.path(self.case.mesh.file).resolve())
        for material in table["material"]:
            if "use" in material and material["use"].endswith(".toml"):
                material["use"] = str(self.path(material["use"]).resolve())
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
    for setting in settings:
        apply_setting(table, setting)
    case = parse_case(table, str(path))
    return LoadedCase(case, str(path), path.resolve().parent)


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
    from flexapod.app.assemble import check_builder

    check_builder(case.mesh, where)
    return case


def apply_setting(table: dict[str, Any], setting: str) -> None:
    """Apply one ``key.path=value``; list items go by index or by their name."""
    key, equals, text = setting.partition("=")
    parts = [part.strip() for part in key.strip().split(".")]
    if not equals or not all(parts):
        raise InputError(
            f'write key.path=value, for example step.inflate.outputs=5; got "{setting}"', "--set"
        )
    where = f"--set {key.strip()}"
    target: Any = table
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(target, list):
            index = _index(target, part, ".".join(parts[:depth]), where)
            if last:
                target[index] = parse_value(text)
            else:
                target = target[index]
        elif isinstance(target, dict):
            if last:
                target[part] = parse_value(text)
            else:
                target = target.setdefault(part, {})
        else:
            raise InputError(f"{'.'.join(parts[:depth])} is a value, not a table", where)


def _index(items: list[Any], part: str, path: str, where: str) -> int:
    labels = [item.get("name", item.get("group")) for item in items if isinstance(item, dict)]
    if part in labels:
        return labels.index(part)
    if part.lstrip("-").isdigit() and -len(items) <= int(part) < len(items):
        return int(part)
    named = [str(label) for label in labels if label is not None]
    choice = f"0 to {len(items) - 1}" if items else "nothing, the list is empty"
    if named:
        choice += f", or by name: {', '.join(named)}"
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
    "shipped_cases",
]
