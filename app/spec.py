"""The tables of a case file as frozen pydantic models, in SI."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticKnownError

from flexapod.app.spec_base import Axis, Names, Table, Triple, default_text, one_or_many
from flexapod.app.spec_contact import ContactBase, MovingContact
from flexapod.app.spec_dynamics import (
    BondSpec,
    ContactGroundSpec,
    DynamicsSpec,
    ProbeTrackSpec,
    PumpSpec,
    SearchSpec,
    StartSpec,
)
from flexapod.app.spec_gait import GaitSpec
from flexapod.app.spec_rigid import RigidSpec
from flexapod.app.spec_ring import SHELL, ActuationSpec, CoilsSpec, RingSpec
from flexapod.app.spec_robot import BODIES, RobotSpec
from flexapod.app.spec_sweep import SweepSpec
from flexapod.core.units import (
    Acceleration,
    Angle,
    AnyModulus,
    Density,
    Force,
    Length,
    Mass,
    Modulus,
    PositiveLength,
    PositiveTime,
    Pressure,
    Time,
)
from flexapod.materials.registry import make_law


class MeshSpec(Table):
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


class MaterialSpec(Table):
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

    prony_moduli: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        default=(),
        description="Viscous branches, felt in motion only: moduli over the long-term modulus, "
        "which is the law's.",
    )
    prony_times: tuple[PositiveTime, ...] = Field(
        default=(), description="Their time constants, as many."
    )

    @field_validator("mu", "c", mode="before")
    @classmethod
    def _single(cls, value: Any) -> Any:
        return one_or_many(value)

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
        if len(self.prony_moduli) != len(self.prony_times):
            raise ValueError("prony_moduli and prony_times must be as many")
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


class GravitySpec(Table):
    """Weight of the body and of the added masses; the load's name is `gravity`."""

    acceleration: tuple[Acceleration, Acceleration, Acceleration] = Field(
        default=default_text("0 m/s^2", "0 m/s^2", "-9.8 m/s^2")
    )
    tilt: Angle = Field(
        default=default_text("0 deg"),
        description="Turned about the y axis by this: level ground as a slope that goes down "
        "towards +x.",
    )

    def tilted(self) -> tuple[float, float, float]:
        """The acceleration turned by `tilt` [m/s2]."""
        x, y, z = self.acceleration
        c, s = math.cos(self.tilt), math.sin(self.tilt)
        return (c * x - s * z, y, s * x + c * z)


class MassSpec(Table):
    """Mass carried by the body, spread evenly over the volume of a cell group."""

    group: str = Field(default="*", description="Cell groups; '*' is the whole body.")
    total: Mass
    of: Literal["model", "body"] = Field(
        default="model",
        description="Whether `total` is the mass on the modelled part, or on the whole body of "
        "which a builder's symmetry keeps a half or a quarter.",
    )


class SupportSpec(Table):
    """Displacements held at zero on a surface."""

    surface: Names = Field(description="Surface groups; globs allowed.")
    directions: tuple[Axis, ...] = ("x", "y", "z")

    _surface = field_validator("surface", mode="before")(one_or_many)
    _directions = field_validator("directions", mode="before")(one_or_many)


class _NamedLoad(Table):
    name: str = Field(min_length=1, description="Name the steps use.")
    surface: Names = Field(description="Surface groups; globs allowed.")

    _surface = field_validator("surface", mode="before")(one_or_many)


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
    between: tuple[Length, Length] | None = Field(
        default=None,
        description="Only faces whose middle lies between these two x, in the undeformed body: "
        "the chambers of its front half, for example.",
    )
    over_time: tuple[tuple[Time, float], ...] | None = Field(
        default=None,
        description="Motion only: pairs of time and factor of the value, straight lines between; "
        "with a pump, how far the valve is open (below zero: the outlet).",
    )
    pump: PumpSpec | None = None

    @model_validator(mode="after")
    def _pumped_whole(self) -> PressureSpec:
        if self.between is not None and self.pump is not None:
            raise ValueError("between and pump: a pump fills all chambers of a surface")
        return self


def _with_length(value: Triple) -> Triple:
    if not 0.0 < math.hypot(*value) < math.inf:
        raise ValueError("the normal must have a length")
    return value


class _FaceContactBase(MovingContact, ContactBase):
    depth: PositiveLength = Field(
        default=default_text("1 mm"),
        description="Deepest penetration still seen; less than half the thinnest wall.",
    )


class ContactSelfSpec(_FaceContactBase):
    """Faces of the body against each other, found by search; friction in motion only."""

    type: Literal["self"]


class ContactPlaneSpec(ContactBase):
    """The body against a fixed plane: the ground, a wall, a rigid block's face."""

    type: Literal["plane"]
    point: tuple[Length, Length, Length] = Field(default=default_text("0 m", "0 m", "0 m"))
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
    """Named surfaces against other named surfaces; friction in motion only."""

    type: Literal["pair"]
    against: Names = Field(alias="with", description="The other surface groups; globs allowed.")

    _against = field_validator("against", mode="before")(one_or_many)


class ContactWeightSpec(Table):
    """A body on a table outside the model, sliding along it under its own weight."""

    type: Literal["weight"]
    normal: Triple = Field(description="Of the table; the body moves along it. Any length.")
    friction: Annotated[float, Field(gt=0, lt=10)] = Field(description="Coulomb coefficient.")
    acceleration: Acceleration = Field(
        default=default_text("9.8 m/s^2"), description="Of gravity, onto the table."
    )
    slip: PositiveLength = Field(
        default=default_text("0.1 mm"),
        description="Slip within an increment at which friction has 0.7 of its full force.",
    )

    _direction = field_validator("normal")(_with_length)


ContactSpec = Annotated[
    ContactSelfSpec | ContactPlaneSpec | ContactPairSpec | ContactWeightSpec | ContactGroundSpec,
    Field(discriminator="type"),
]


class StepSpec(Table):
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


class ProbeRotationSpec(Table):
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

    _surface = field_validator("surface", mode="before")(one_or_many)


class ProbeDisplacementSpec(Table):
    """Mean displacement of a surface, or of the node nearest a point, in mm."""

    type: Literal["displacement"]
    name: str
    surface: Names | None = None
    point: tuple[Length, Length, Length] | None = None
    direction: Axis | Literal["magnitude"] = "magnitude"

    _surface = field_validator("surface", mode="before")(one_or_many)

    @model_validator(mode="after")
    def _where(self) -> ProbeDisplacementSpec:
        if (self.surface is None) == (self.point is None):
            raise ValueError("write exactly one of surface and point")
        return self


class ProbeReactionSpec(Table):
    """Force the supports of a surface put on the body, in N."""

    type: Literal["reaction"]
    name: str
    surface: Names
    direction: Axis

    _surface = field_validator("surface", mode="before")(one_or_many)


class ProbeVolumeSpec(Table):
    """Volume enclosed by cavity surfaces, in ml; symmetry is not multiplied out."""

    type: Literal["volume"]
    name: str = "volume"
    surface: Names

    _surface = field_validator("surface", mode="before")(one_or_many)


ProbeSpec = Annotated[
    ProbeRotationSpec
    | ProbeDisplacementSpec
    | ProbeReactionSpec
    | ProbeVolumeSpec
    | ProbeTrackSpec,
    Field(discriminator="type"),
]


class ReferenceSpec(Table):
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


class PlotSpec(Table):
    """What the pictures show."""

    x: str | None = Field(
        default=None, description="Column along the axis (default: the reference's)."
    )
    y: Names | None = Field(default=None, description="Columns drawn (default: the reference's).")
    mirror: tuple[Axis, ...] = Field(
        default=(),
        description="Symmetry planes through the origin, by their normal, drawn mirrored.",
    )
    view: Literal["side", "front", "top", "corner"] = Field(
        default="corner",
        description="Of the shapes. Strip and film of a motion are seen from above with top "
        "and else from the side.",
    )
    snapshots: tuple[float, ...] | None = Field(
        default=None,
        description="Values of x shown in the strip of shapes (default: four, evenly).",
    )
    colour: Literal["displacement", "stretch", "pressure"] = "stretch"

    _y = field_validator("y", mode="before")(one_or_many)


class SolverSpec(Table):
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


class ResolvedSpec(Table):
    """Written into case.resolved.toml; ignored when that file is run again."""

    flexapod_version: str
    source: str
    mesh_hash: str | None = None
    elements: int | None = None
    nodes: int | None = None


def _no_ring(info: ValidationInfo) -> bool:
    """Whether a case has no [ring]; of a faulty one its own fault is said, and no other."""
    return "ring" in info.data and info.data["ring"] is None


class Case(Table):
    """A whole case file."""

    name: str | None = Field(default=None, description="Default: the file's name.")
    title: str = ""
    ring: RingSpec | None = None
    coils: CoilsSpec | None = Field(
        default=None, description="Of a ring; without the table, the paper's."
    )
    actuation: ActuationSpec | None = Field(
        default=None, description="Of a ring; without it no coil is ever on."
    )
    mesh: MeshSpec | None = Field(
        default=None, validate_default=True, description="Of every case but a ring's."
    )
    material: tuple[MaterialSpec, ...] = Field(default=(), validate_default=True)
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
    paper: dict[str, str] = Field(
        default={},
        description="Of a motion: what its source says of a result, in words, by the result's name "
        'in summary.json, as in mean_speed_m_s = "over 0.1 m/s"; shown beside ours.',
    )
    plot: PlotSpec = PlotSpec()
    solver: SolverSpec = SolverSpec()
    dynamics: DynamicsSpec | None = None
    start: StartSpec | None = None
    rigid: tuple[RigidSpec, ...] = ()
    bond: tuple[BondSpec, ...] = ()
    search: SearchSpec | None = None
    sweep: SweepSpec | None = None
    robot: RobotSpec | None = Field(
        default=None, description="Legs and servos of the body; it needs [gait] and [dynamics]."
    )
    gait: GaitSpec | None = Field(default=None, description="What a robot's legs do.")
    resolved: ResolvedSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _a_robot_is_set_down(cls, data: Any) -> Any:
        """Without [start] its legs would begin in the ground."""
        if isinstance(data, dict) and "robot" in data and "start" not in data:
            return {**data, "start": {}}
        return data

    @property
    def rigid_bodied(self) -> bool:
        """Whether a robot's body is a rigid box."""
        return self.robot is not None and self.robot.body == "rigid"

    @property
    def sized_mesh(self) -> MeshSpec | None:
        """The mesh, as fine as a robot's body asks for where [mesh] does not say."""
        mesh, robot = self.mesh, self.robot
        if mesh is None or robot is None or mesh.builder is None or "size" in mesh.options:
            return mesh
        wanted = dict(BODIES[robot.body])
        if mesh.builder != "curl":
            wanted.pop("aligned_rows", None)  # the others have no rows to align
        table = mesh.model_dump(mode="json", by_alias=True, exclude_none=True)
        return MeshSpec.model_validate({**wanted, **table})

    @model_validator(mode="before")
    @classmethod
    def _a_ring_has_coils(cls, data: Any) -> Any:
        if isinstance(data, dict) and "ring" in data and "coils" not in data:
            return {**data, "coils": {}}
        return data

    @field_validator("mesh", mode="after")
    @classmethod
    def _meshed(cls, value: MeshSpec | None, info: ValidationInfo) -> MeshSpec | None:
        if value is None and _no_ring(info):
            raise PydanticKnownError("missing")
        return value

    @field_validator("material", mode="before")
    @classmethod
    def _made_of_something(cls, value: Any, info: ValidationInfo) -> Any:
        if value == () and _no_ring(info):
            raise PydanticKnownError("missing")
        if value == [] and _no_ring(info):
            counts = {"field_type": "Tuple", "min_length": 1, "actual_length": 0}
            raise PydanticKnownError("too_short", counts)
        return value

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
        if not names and self.ring is None:
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
        self._ring_agrees()
        self._motion_agrees()
        used = {name for step in self.step for name in step.loads}
        idle = [name for name in names if self.step and name not in used]
        if idle:
            raise ValueError(
                f"no step applies {', '.join(idle)}: name it in a step's loads (0.0 keeps it off)"
            )
        return self

    def _ring_agrees(self) -> None:
        """A ring is a body of its own, without mesh; only it has coils."""
        if self.ring is None:
            stray = [key for key in ("coils", "actuation") if getattr(self, key) is not None]
            if self.search is not None and self.search.patterns:
                stray.append("search.patterns")
            if stray:
                raise ValueError(f"only a case with [ring] has {', '.join(stray)}")
            return
        if self.dynamics is None:
            raise ValueError("a case with [ring] moves: it needs [dynamics] with a duration")
        solid = {
            "mesh": self.mesh,
            "material": self.material,
            "start": self.start,
            "mass": self.mass,
            "support": self.support,
            "pressure": self.pressure,
            "rigid": self.rigid,
            "robot": self.robot,
            "bond": self.bond,
            "probe": self.probe,
            **{
                f'contact of type "{c.type}"': c
                for c in self.contact
                if c.type not in ("ground", "plane", "weight")
            },
        }
        stray = [name for name, value in solid.items() if value]
        if stray:
            raise ValueError(
                f"a case with [ring] cannot have {', '.join(stray)}: a ring has its own body, and "
                "touches the ground only"
            )
        for contact in self.contact:
            if contact.type == "ground" and contact.surface != (SHELL,):
                raise ValueError(
                    f'a ring touches the ground with its surface "{SHELL}", '
                    f"got {', '.join(contact.surface)}"
                )
        if len(self.contact) > 1:
            raise ValueError("a ring touches one ground: write one contact")
        if self.ring.shell == "solid" and self.coils is not None and self.coils.end_width > 0.0:
            raise ValueError('coils.end_width: belongs to a ring of shell = "elements"')
        self._actuation_agrees()

    def _actuation_agrees(self) -> None:
        """The coils can be switched as written, in rows and motion as long as they are."""
        assert self.ring is not None and self.dynamics is not None
        actuation, dynamics = self.actuation, self.dynamics
        patterns = self.search.patterns if self.search is not None else ()
        if patterns and (actuation is None or actuation.pattern is None):
            raise ValueError("search.patterns: needs [actuation] with a pattern to replace")
        if actuation is None:
            return
        actuation.commands(dynamics.duration)
        if actuation.interval is not None and actuation.interval < dynamics.interval:
            raise ValueError(
                f"actuation.interval: must not be shorter than dynamics.interval, "
                f"{dynamics.interval:g} s, or rows miss steps of the pattern; got "
                f"{actuation.interval:g} s"
            )
        if actuation.rings != (1,) and self.ring.shape != "sphere":
            raise ValueError('actuation.rings: belongs to a ring of shape = "sphere"')

    def _motion_agrees(self) -> None:
        """What belongs to a motion stands in a case with [dynamics], and nothing else does."""
        if self.dynamics is None:
            moving = {
                "start": self.start,
                "rigid": self.rigid,
                "bond": self.bond,
                "search": self.search,
                "sweep": self.sweep,
                "paper": self.paper,
                "robot": self.robot,
                "gait": self.gait,
                "between of pressure": [p for p in self.pressure if p.between is not None],
                'contact of type "ground"': [c for c in self.contact if c.type == "ground"],
                **{
                    f"{key} of a contact between faces": [
                        c
                        for c in self.contact
                        if isinstance(c, _FaceContactBase)
                        and getattr(c, key) != getattr(MovingContact(), key)
                    ]
                    for key in MovingContact.model_fields
                },
                'probe of type "track"': [p for p in self.probe if p.type == "track"],
                "over_time or pump of pressure": [
                    p for p in self.pressure if p.over_time is not None or p.pump is not None
                ],
            }
            stray = [name for name, value in moving.items() if value]
            if stray:
                raise ValueError(f"only a case with [dynamics] has {', '.join(stray)}")
            return
        if (self.robot is None) != (self.gait is None):
            raise ValueError("robot and gait: a robot needs a gait, and a gait a robot")
        if self.robot is not None:
            self._robot_agrees()
        if self.search is not None and self.sweep is not None:
            raise ValueError("search and sweep: a case has one of them")
        still = {
            "step": self.step,
            "displacement": self.displacement,
            "force": self.force,
            "traction": self.traction,
            'contact of type "plane" or "weight" (write type = "ground")': [
                c for c in self.contact if c.type in ("plane", "weight")
            ],
            'probe of type "reaction"': [p for p in self.probe if p.type == "reaction"],
            "reference": self.reference,
            "solver": self.solver if self.solver != SolverSpec() else None,
        }
        stray = [name for name, value in still.items() if value]
        if stray:
            raise ValueError(f"a case with [dynamics] cannot have {', '.join(stray)}")
        names = [bond.name for bond in self.bond]
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise ValueError(f"bond names must differ; used twice: {', '.join(double)}")
        closed = [bond.name for bond in self.bond if bond.closed]
        start = self.start
        if closed and (start is None or start.case is None or start.settle == 0.0):
            raise ValueError(
                f"bond {closed[0]} has to be drawn together while a start shape settles: give a "
                "[start] with case and settle, or write closed = false"
            )

    def _robot_agrees(self) -> None:
        """One ground under body and soles, and no name twice."""
        assert self.robot is not None
        if any(probe.name == "marker" for probe in self.probe):
            raise ValueError('probe "marker": the robot\'s marked point has this name already')
        grounds = [c for c in self.contact if c.type == "ground"]
        keys = ("shape", "slope", "level", "step_at", "step_height", "file", "spacing", "relief")
        for other in grounds[1:]:
            for key in keys:
                one, two = getattr(grounds[0], key), getattr(other, key)
                if one != two:
                    raise ValueError(
                        f"contact: the ground under a robot is one, and {key} differs: {one} and "
                        f"{two}; --set contact.ground.{key}=... sets all"
                    )
        if self.rigid_bodied and self.start is not None and self.start.case is not None:
            raise ValueError(
                f'robot.body = "rigid" has no start shape: leave out start.case '
                f"({self.start.case}) or choose another body"
            )
