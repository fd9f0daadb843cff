"""The tables of a case that moves: time, start, ground, rigid parts, bonds and a search."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from flexapod.app.spec_base import Axis, Names, Table, default_text, one_or_many
from flexapod.app.spec_contact import Coefficient, ContactBase, MovingContact
from flexapod.core.units import (
    Angle,
    BondStiffness,
    Conductance,
    Flow,
    Force,
    Length,
    Modulus,
    PositiveLength,
    PositiveTime,
    Pressure,
    Rate,
    Speed,
    Time,
)

Fraction = Annotated[float, Field(ge=0, le=1)]


class DynamicsSpec(Table):
    """How long the body moves, and how time is walked through."""

    duration: PositiveTime
    interval: PositiveTime = Field(
        default=default_text("5 ms"),
        description="Rows of curve.csv, the stable step and checkpoints go by it.",
    )
    frames: Annotated[int, Field(ge=1, le=10000)] = Field(
        default=40, description="States written with their fields, for pictures and ParaView."
    )
    checkpoint: Annotated[int, Field(ge=1)] = Field(
        default=20, description="Intervals between checkpoints."
    )
    safety: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.9, description="Step over the stable step at the interval's start."
    )
    cycle: PositiveTime | None = Field(
        default=None,
        description="What repeats in the motion takes this long: the way per cycle is reported.",
    )
    time_step: PositiveTime | None = Field(
        default=None, description="A fixed step, refused where it is not stable."
    )
    mass_scaling: PositiveTime | None = Field(
        default=None,
        description="Make elements heavier whose own stable step is below this; the mass added "
        "is reported.",
    )
    mass_damping: Rate = Field(
        default=default_text("0 1/s"), description="Slows all motion, rigid motion too."
    )
    stiffness_damping: Fraction = Field(
        default=0.0, description="Fraction of critical damping at the highest frequency."
    )

    @field_validator("mass_damping")
    @classmethod
    def _not_negative(cls, value: float) -> float:
        if value < 0.0:
            raise ValueError("mass_damping must be >= 0")
        return value

    @model_validator(mode="after")
    def _whole_intervals(self) -> DynamicsSpec:
        ratio = self.duration / self.interval
        if abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise ValueError(
                f"duration {self.duration:g} s is not a whole multiple of interval "
                f"{self.interval:g} s ({ratio:.3f})"
            )
        return self


class StartSpec(Table):
    """The shape a motion begins with: the last state of a static case, run first.

    Mesh, materials and masses are that case's, unless this one has its own tables of them.
    """

    case: str | None = Field(
        default=None,
        description="A shipped case or a file, relative to this one (default: none, the "
        "undeformed body).",
    )
    unfold: tuple[Axis, ...] = Field(
        default=(),
        description="Symmetry planes through the origin, by their normal, at which the modelled "
        "part is mirrored: what moves need not stay symmetric.",
    )
    turn: Angle = Field(
        default=default_text("0 deg"), description="Turned first, about the y axis."
    )
    rest: bool = Field(
        default=True,
        description="Turned with the ground's slope and set down on it; else left in place.",
    )
    settle: Time = Field(
        default=default_text("100 ms"),
        description="Time in which the shape comes to rest before it is set down: without weight "
        "and ground, damped. A shape computed in part and unfolded, with servos made rigid and "
        "ends joined, is a little out of balance.",
    )
    set_down: Time = Field(
        default=default_text("100 ms"),
        description="Time in which its weight is then eased on, on the ground and without its part "
        "along the slope, so that the motion begins with the body flattened as it lies.",
    )
    settle_damping: Rate = Field(
        default=default_text("80 1/s"),
        description="Mass damping in both: about critical for a soft body that bends in 10 Hz.",
    )


class BondSpec(Table):
    """Two surfaces of the curled body that hold each other: magnets, bolts or glue."""

    name: str
    surfaces: tuple[str, str]
    closed: bool = Field(
        default=True,
        description="Drawn together face on face while the start shape settles; else held with the "
        "gap they have.",
    )
    strength: Force | None = Field(
        default=None, description="Resultant at which it opens for good (default: never)."
    )
    stiffness: BondStiffness = Field(
        default=default_text("0.2 GPa/m"), description="Traction per change of the gap."
    )
    damping: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.05, description="Fraction of critical damping of the bond's own nodes."
    )


class ContactGroundSpec(MovingContact, ContactBase):
    """Fixed ground of a moving body: plane, slope, step or height field, with friction."""

    type: Literal["ground"]
    shape: Literal["plane", "step", "field"] = "plane"
    slope: Angle = Field(
        default=default_text("0 deg"),
        description="Of a plane through the origin; the body goes downhill towards +x, and uphill "
        "for a negative one.",
    )
    level: Length = Field(default=default_text("0 m"), description="Height of a plane.")
    step_at: Length = Field(
        default=default_text("0.3 m"), description="x from which a step is higher."
    )
    step_height: Length = Field(default=default_text("20 mm"), description="Of a step.")
    file: str | None = Field(
        default=None, description="Heights of a field: CSV in metres, or an image of grey levels."
    )
    spacing: PositiveLength = Field(
        default=default_text("10 mm"), description="Between the heights of a field."
    )
    relief: PositiveLength = Field(
        default=default_text("30 mm"), description="Height of an image's white over its black."
    )
    friction: Coefficient = Field(
        default=0.8, description="Static coefficient; 0.8 is silicone on a dry table (assumed)."
    )
    youngs_modulus: Modulus | None = Field(
        default=None, description="Of the ground (default: rigid)."
    )
    poisson: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.3, description="Of the ground."
    )
    skin: PositiveLength = Field(
        default=default_text("5 mm"), description="Height up to which faces are watched."
    )

    @model_validator(mode="after")
    def _fits(self) -> ContactGroundSpec:
        if (self.shape == "field") != (self.file is not None):
            raise ValueError('file belongs to shape = "field", and it needs one')
        if self.slope != 0.0 and self.shape != "plane":
            raise ValueError('slope belongs to shape = "plane"')
        return self


class PumpSpec(Table):
    """A chamber filled by a pump through a valve; it stalls at the pressure's `value`."""

    flow: Flow = Field(description="Of free air, at no pressure; falls linearly to the stall.")
    exhaust: Conductance = Field(
        default=default_text("2 ml/s/kPa"), description="Of the open outlet."
    )
    start: Pressure | None = Field(
        default=None,
        description="Pressure at the start (default: the value with a [start] shape, else none).",
    )


class SearchSpec(Table):
    """The value of one key at which the body begins to move away, or no longer climbs."""

    goal: Literal["threshold", "climb"] = Field(
        default="threshold",
        description="threshold: the value at which a body at rest begins to move away. climb: the "
        "case is run as it is, and then the highest value is sought at which it still climbs.",
    )
    key: str = Field(
        description="As --set writes it, for example contact.0.slope, or contact.ground.slope "
        "for all grounds: of contact, gravity or dynamics, since the start shape is computed once."
    )

    @field_validator("key")
    @classmethod
    def _after_the_start(cls, value: str) -> str:
        if value.split(".")[0] not in ("contact", "gravity", "dynamics"):
            raise ValueError(
                f'search.key must begin with contact, gravity or dynamics, got "{value}"'
            )
        return value

    low: str = Field(description="A value, with its unit, at which it stays; or climbs.")
    high: str = Field(description="A value at which it goes; or does not climb.")
    tolerance: str = Field(description="Width at which the search ends.")
    distance: PositiveLength = Field(
        description="Horizontal way of the body's centre after which it counts as gone; of a "
        "climb, its way uphill by the end of the duration."
    )
    patterns: tuple[str, ...] = Field(
        default=(),
        description="Of a climb: patterns of the coils that are searched too, beside the case's "
        "own; results as steepest_slope_by_pattern.",
    )
    jobs: Annotated[int, Field(ge=1, le=1024)] | None = Field(
        default=None,
        description="Of a climb: trials at a time (default: as many as the machine has cores).",
    )
    rest_speed: Speed = Field(
        default=default_text("1 mm/s"),
        description="A centre slower than this for ten intervals stays, the rest of the duration "
        "is not waited for.",
    )
    ease: Time = Field(
        default=default_text("0.2 s"),
        description="Of a key of gravity: time in which a trial's value is eased on, from the "
        "value at which the body rested last.",
    )
    result: str = Field(
        default="threshold_deg",
        description="Name in summary.json; of a climb, steepest_slope_deg by default.",
    )

    @model_validator(mode="before")
    @classmethod
    def _climbs_have_their_name(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("goal") == "climb" and "result" not in data:
            return {**data, "result": "steepest_slope_deg"}
        return data

    @model_validator(mode="after")
    def _of_a_climb(self) -> SearchSpec:
        if self.goal != "climb" and (self.patterns or self.jobs is not None):
            raise ValueError('patterns and jobs belong to goal = "climb"')
        return self


class ProbeTrackSpec(Table):
    """Way of a surface's middle, or of the node nearest a point, through space."""

    type: Literal["track"]
    name: str
    surface: Names | None = None
    point: tuple[Length, Length, Length] | None = Field(
        default=None, description="In the undeformed body."
    )

    _surface = field_validator("surface", mode="before")(one_or_many)

    @model_validator(mode="after")
    def _where(self) -> ProbeTrackSpec:
        if (self.surface is None) == (self.point is None):
            raise ValueError("write exactly one of surface and point")
        return self
