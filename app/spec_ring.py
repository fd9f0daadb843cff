"""The tables of a ring robot: its shell, its coils, and which of them are on when."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from flexapod.app.spec_base import Table, default_text
from flexapod.core.errors import InputError
from flexapod.core.units import (
    Angle,
    BendStiffness,
    Density,
    Force,
    ForceRate,
    Length,
    LineDamping,
    Mass,
    PositiveForce,
    PositiveLength,
    PositiveTime,
    SpringStiffness,
    Time,
)
from flexapod.geometry.ring import LETTERS, RingSizes, solid_section

if TYPE_CHECKING:
    from flexapod.dynamics.actuation import Actuation

# Surface of a ring that a contact names.
SHELL = "shell"
# Coils of a ring: its spokes, and the one that joins the ends of B and H.
COILS = LETTERS + "I"


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise ValueError(f"must be >= 0, got {value:g}")
    return value


def _positive(value: float) -> float:
    if not value > 0.0:
        raise ValueError(f"must be > 0, got {value:g}")
    return value


NotNegative = AfterValidator(_not_negative)
Positive = AfterValidator(_positive)


class RingSolidSpec(Table):
    """A shell of hexahedra, which takes the place of the line elements.

    Thickness, width and modulus follow from the ring's mass and stiffnesses.
    """

    around: Annotated[int, Field(ge=8, multiple_of=8)] = Field(
        default=64, description="Elements around, a multiple of 8: coils end at nodes."
    )
    through: Annotated[int, Field(ge=2, multiple_of=2)] = Field(
        default=2, description="Elements through the thickness, even: coils end on the middle line."
    )
    across: Annotated[int, Field(ge=2, multiple_of=2)] = Field(
        default=2, description="Elements across the width, even."
    )
    density: Density = Field(
        default=default_text("1080 kg/m^3"),
        description="Of the shell's rubber (assumed, silicone's: the paper names none); the width "
        "follows from it and the mass.",
    )
    poisson: Annotated[float, Field(gt=0, lt=0.49999)] = Field(
        default=0.45,
        description="Assumed: rubber is nearly incompressible, and a bulk modulus closer to that "
        "only shortens the explicit step.",
    )


class RingSpec(Table):
    """The circular robot of Sugiyama and Hirai (2004), or the sphere of three such rings."""

    shape: Literal["circle", "sphere"] = Field(
        default="circle", description="One ring, or three in planes normal to each other."
    )
    shell: Literal["elements", "solid"] = Field(
        default="elements",
        description="The paper's chain of masses, springs and bending springs, or hexahedra with "
        "a material of the same stiffnesses.",
    )
    nodes: Annotated[int, Field(ge=8, multiple_of=8)] = Field(
        default=32,
        description="Masses of a ring, a multiple of 8: one at each coil. Assumed, since the "
        "paper does not say: with 8 the ring hardly moves.",
    )
    diameter: PositiveLength = Field(
        default=default_text("40 mm"), description="Of the shell's middle line."
    )
    mass: Mass = Field(
        default=default_text("3 g"), description="Of a robot of one ring, its hub included."
    )
    hub_mass: Mass = Field(
        default=default_text("0.3 g"),
        description="Part of the mass that sits where the coils meet. Assumed, a tenth: the paper "
        "does not say what the coils and their joint weigh.",
    )
    width: PositiveLength = Field(
        default=default_text("4 mm"),
        description="Of the band that touches the ground. Assumed: the paper gives none; the "
        "pressure of the contact goes by it, the motion hardly.",
    )
    stretch_stiffness: SpringStiffness = Field(
        default=default_text("500 N/m"),
        description="k_body, of an arc of 45 deg (assumed: the paper's own eighth of the ring).",
    )
    stretch_damping: LineDamping = Field(
        default=default_text("0.1 N s/m"), description="b_body, of an arc of 45 deg."
    )
    bend_stiffness: BendStiffness = Field(
        default=default_text("0.0015 N m/rad"),
        description="k_bend, of an arc of 45 deg. That arc is assumed: the paper gives no length, "
        "and an eighth of the ring gives its prototype's speed.",
    )
    contact_refine: Annotated[int, Field(ge=1, le=64)] = Field(
        default=4,
        description="Straight pieces per element of the smooth curve that touches the ground; 1 "
        "takes the elements themselves, a polygon that has to tip over its corners.",
    )
    out_of_plane_ratio: Annotated[float, Field(gt=0)] = Field(
        default=1.0,
        description="Bending stiffness out of the ring's plane over that in it. Assumed, a round "
        "section: the paper's model is plane. It matters for a sphere.",
    )
    rest_curvature: float = Field(
        default=1.0,
        description="Curvature without load over the circle's: 1 is a band moulded round "
        "(assumed), 0 a flat one bent round.",
    )
    bend_damping: Time = Field(
        default=default_text("0 s"),
        description="Dashpot over spring of the bending; the paper's bending is elastic.",
    )
    first_angle: Angle = Field(
        default=default_text("0 deg"),
        description="Where coil A points, counter-clockwise from straight down (seen with x to "
        "the right and z up). Assumed: the paper's figures show a coil at the ground.",
    )
    letters_direction: Literal["counter-clockwise", "clockwise"] = Field(
        default="counter-clockwise", description="Way round from A to B, seen likewise (assumed)."
    )
    solid: RingSolidSpec | None = Field(default=None, description='Of shell = "solid".')

    @property
    def sizes(self) -> RingSizes:
        """Sizes, mass and stiffness of one ring (SI)."""
        return RingSizes(
            diameter=self.diameter,
            mass=self.mass,
            hub_mass=self.hub_mass,
            node_count=self.nodes,
            stretch_stiffness=self.stretch_stiffness,
            stretch_damping=self.stretch_damping,
            bend_stiffness=self.bend_stiffness,
            bend_damping=self.bend_damping,
            out_of_plane_ratio=self.out_of_plane_ratio,
            width=self.width,
            first_angle=self.first_angle,
            letters_direction=self.letters_direction,
        )

    @model_validator(mode="before")
    @classmethod
    def _solid_has_counts(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("shell") == "solid" and "solid" not in data:
            return {**data, "solid": {}}
        return data

    @model_validator(mode="after")
    def _fits(self) -> RingSpec:
        with without_place("ring"):
            sizes = self.sizes
            if self.solid is not None:
                solid_section(sizes, self.solid.density, self.solid.poisson)
        if self.solid is not None and self.shell != "solid":
            raise ValueError('[ring.solid] belongs to shell = "solid"')
        if self.shell == "solid":
            # What a solid has no word for is not passed over.
            for key, value in (("rest_curvature", 1.0), ("out_of_plane_ratio", 1.0)):
                if getattr(self, key) != value:
                    raise ValueError(f'{key} belongs to shell = "elements"')
        if self.shape == "sphere" and self.shell == "solid":
            raise ValueError('a sphere has shell = "elements": its rings cross each other')
        return self


@contextmanager
def without_place(where: str) -> Iterator[None]:
    """Faults found by lower floors, without the place they name: the case names the key."""
    try:
        yield
    except InputError as error:
        raise ValueError(str(error).removeprefix(f"{where}: ")) from None


class CoilsSpec(Table):
    """The shape-memory coils: the paper's three-element model with slider, and its active force."""

    stiffness: SpringStiffness = Field(default=default_text("50 N/m"), description="k.")
    damping: Annotated[LineDamping, NotNegative] = Field(
        default=default_text("0.1 N s/m"), description="b."
    )
    flow_damping: Annotated[LineDamping, Positive] = Field(
        default=default_text("10 N s/m"), description="c, of the dashpot that yields."
    )
    limit: Annotated[Force, NotNegative] = Field(
        default=default_text("16 mN"), description="B, the force up to which it does not yield."
    )
    flow: Literal["full", "excess"] = Field(
        default="full",
        description="Past the limit the dashpot flows by the whole force (the paper's equation 3) "
        "or by what exceeds the limit, as a Bingham body would; the print leaves it open.",
    )
    rate_on: ForceRate = Field(
        default=default_text("150 mN/s"), description="D_on, while the voltage is on."
    )
    rate_off: ForceRate = Field(default=default_text("150 mN/s"), description="D_off.")
    largest_force: PositiveForce = Field(default=default_text("150 mN"), description="F_max.")
    rest_length_ratio: Annotated[float, Field(gt=0)] = Field(
        default=1.0,
        description="Length without force over the length in the round ring. Assumed: the paper's "
        "robot is round while nothing is switched on.",
    )
    end_width: Annotated[Length, NotNegative] = Field(
        default=default_text("0 mm"),
        description="Length of shell that a coil's end holds: it ends in the middle of the nodes "
        "within half of that on either side. Assumed a point, since the paper does not say.",
    )


class ActuationSpec(Table):
    """When which coil is on: a pattern that goes round, or a table of times."""

    pattern: str | None = Field(
        default=None,
        description="Coils that are on during the first step, of A to H, for example BF; with "
        "each step all move on by one coil.",
    )
    interval: PositiveTime | None = Field(
        default=None, description="Length of a step of the pattern (default 0.6 s)."
    )
    direction: Literal[1, -1] = Field(
        default=1, description="Whether the pattern moves on from A to B, or to H."
    )
    duty: Annotated[float, Field(gt=0, le=1)] = Field(
        default=1.0, description="Share of each PWM period for which the voltage is on."
    )
    pwm_period: PositiveTime = Field(
        default=default_text("10 ms"),
        description="Of the voltage at a duty below 1. Assumed: much shorter than the second in "
        "which a coil comes to its full force.",
    )
    table: dict[str, tuple[tuple[Time, Time], ...]] | None = Field(
        default=None,
        description="Instead of a pattern: for each coil, A to I, pairs of times on and off, for "
        'example { A = [["0 s", "2 s"]] }. Coil I, for jumping, is there where it is named.',
    )
    held: Annotated[Time, NotNegative] = Field(
        default=default_text("0 s"),
        description="Before the motion begins: time for which the coils of its first step are on "
        "already while the robot is held, damped and without the part of its weight along the "
        "ground. A round ring would roll down a slope before a coil pulls; how the paper's robot "
        "was put there is not said.",
    )
    rings: tuple[Literal[1, 2, 3], ...] = Field(
        default=(1,),
        min_length=1,
        description="Of a sphere: which rings are switched, 1 in the x-z plane, 2 in x-y, 3 in "
        "y-z. Assumed, the upright one along x: the paper does not say.",
    )

    @model_validator(mode="before")
    @classmethod
    def _pattern_has_interval(cls, data: object) -> object:
        if isinstance(data, dict) and "pattern" in data and "interval" not in data:
            return {**data, "interval": "0.6 s"}
        return data

    @model_validator(mode="after")
    def _one_way(self) -> ActuationSpec:
        if (self.pattern is None) == (self.table is None):
            raise ValueError('write exactly one of pattern and table, for example pattern = "BF"')
        if self.pattern is None and self.interval is not None:
            raise ValueError("interval belongs to a pattern, not to a table")
        return self

    @property
    def letters(self) -> str:
        """Coils of a ring: its spokes, and I where the table names it."""
        return COILS if self.table is not None and COILS[-1] in self.table else LETTERS

    def commands(self, duration: float) -> Actuation:
        """Which coils of a ring are on when, in a motion of a duration [s].

        Raises
        ------
        InputError
            What is wrong, with the key of the case.
        """
        from flexapod.dynamics.actuation import Actuation

        try:
            if self.table is not None:
                return Actuation.table(COILS, self.table, duration)
            assert self.pattern is not None and self.interval is not None
            return Actuation.pattern(
                COILS,
                self.pattern,
                interval=self.interval,
                duration=duration,
                direction=self.direction,
                duty=self.duty,
                pwm_period=self.pwm_period if self.duty < 1.0 else None,
            )
        except InputError as error:
            place, text = error.where or "", str(error).removeprefix(f"{error.where}: ")
            key = place.removeprefix("pattern.").replace("first", "pattern")
            raise InputError(text, f"actuation.{key}".removesuffix(".actuation")) from None


__all__ = ["COILS", "SHELL", "ActuationSpec", "CoilsSpec", "RingSolidSpec", "RingSpec"]
