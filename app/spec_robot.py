"""The tables of a robot on legs: how its body is resolved, its legs and its servos."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from flexapod.app.spec_base import Names, Table, default_text, one_or_many
from flexapod.core.units import (
    Angle,
    Inertia,
    IntegralGain,
    Length,
    Mass,
    Modulus,
    PositiveLength,
    Spin,
    SpringStiffness,
    Torque,
    TorsionDamping,
    TorsionStiffness,
)

Share = Annotated[float, Field(ge=0, le=1)]

# Name of a leg as a rigid body, by its number.
LEG_NAME = "leg_{}"
# Legs by station, back to front, left and right: odd numbers left, pair {1, 2} in front.
LEGS = ((5, 6), (3, 4), (1, 2))
# Name of the one rigid body of a robot whose body does not bend.
TORSO = "torso"


class LegsSpec(Table):
    """Six C-shaped legs, a pair to a station. The robot looks towards +x; left is y > 0.

    The chambers' names are those of the body's builder, where "right" is y > 0.
    """

    stations: Names = Field(
        default=("servo_*",),
        description="Cell groups the servos sit in, three along the body; each is made rigid.",
    )
    height: PositiveLength = Field(
        default=default_text("50 mm"), description="Diameter of the arc's outer circle."
    )
    extent: Angle = Field(default=default_text("180 deg"), description="Of the arc.")
    width: PositiveLength = default_text("12 mm")
    thickness: PositiveLength = Field(
        default=default_text("4 mm"), description="Inwards; not published."
    )
    mass: Mass = Field(
        default=default_text("15 g"),
        description="Of a leg with its horn and screws (a printed arc alone is 5 g); spread over "
        "the arc.",
    )
    hip_forward: Length = Field(
        default=default_text("0 mm"), description="From the middle of its station."
    )
    hip_out: tuple[PositiveLength, PositiveLength, PositiveLength] = Field(
        default=default_text("61 mm", "61 mm", "61 mm"),
        description="From the middle plane to the middle of the leg's width: back, middle and "
        "front pair. The body's half is 52 mm; longer legs stand at different places so as not "
        "to meet.",
    )
    hip_height: Length = Field(
        default=default_text("36.5 mm"),
        description="Of the axis over the body's underside: the middle of the limit layer, which "
        "holds the servos.",
    )
    youngs_modulus: Modulus = Field(
        default=default_text("1 MPa"),
        description="Of the sole for contact: sandpaper glued on (paper), which gives way by 0.1 "
        "mm under a robot's weight.",
    )

    _stations = field_validator("stations", mode="before")(one_or_many)


class ServoSpec(Table):
    """A servo: PID position controller, motor, gear. See `flexapod.dynamics.joints.Servo`."""

    proportional: TorsionStiffness = Field(
        default=default_text("28.1 N m/rad"),
        description="Gain: the stall torque at 5 degrees (assumed).",
    )
    integral: IntegralGain = Field(
        default=default_text("0 N m/rad/s"), description="Gain of the error's integral."
    )
    derivative: TorsionDamping | None = Field(
        default=None, description="Gain of the rate (default: critical for the rotor)."
    )
    rate_weight: Share = Field(
        default=0.0,
        description="Part of the target's rate that the rate's gain compares with: 0, a servo that "
        "is told angles and brakes by its own rate (assumed); 1, the error's rate, which kicks at "
        "a gait's corners.",
    )
    stall_torque: Torque = Field(
        default=default_text("25 kgf cm"), description="The paper's servo."
    )
    no_load_speed: Spin = Field(
        default=default_text("375 deg/s"),
        description="Where the torque has fallen to nothing: 60 degrees in 0.16 s (assumed; its "
        "relatives of 30 and 50 kg cm are listed with 0.222 and 0.133 s).",
    )
    inertia: Inertia = Field(
        default=default_text("3.1e-3 kg m^2"),
        description="Of the rotor through the gear (assumed: 0.5 g cm2 at 1:250).",
    )
    gear_stiffness: TorsionStiffness = Field(
        default=default_text("200 N m/rad"), description="Assumed: 0.7 degrees at stall."
    )
    gear_damping: Share = Field(default=0.05, description="Share of critical of the leg on it.")
    point_stiffness: SpringStiffness = Field(
        default=default_text("500 N/mm"), description="Of bearing and horn (assumed)."
    )
    axis_stiffness: TorsionStiffness = Field(
        default=default_text("200 N m/rad"), description="Of the axis against tilting (assumed)."
    )

    @field_validator("integral", "derivative")
    @classmethod
    def _not_negative(cls, value: float | None) -> float | None:
        if value is not None and value < 0.0:
            raise ValueError(f"a gain must be >= 0, got {value:g}")
        return value

    @field_validator("no_load_speed")
    @classmethod
    def _turning(cls, value: float) -> float:
        if not value > 0.0:
            raise ValueError(f"no_load_speed must be > 0, got {math.degrees(value):g} deg/s")
        return value


class RobotSpec(Table):
    """A body on six legs with servos; what they do is [gait]."""

    body: Literal["full", "medium", "coarse", "rigid"] = Field(
        default="coarse",
        description="full: two elements through each wall. medium: one element. coarse: one "
        "element, and the rows' walls in common planes (mesh.aligned_rows). rigid: a box with "
        "the body's mass and inertia, for the design of gaits; it takes no pressure. Where [mesh] "
        "has a size, it decides alone, aligned_rows too.",
    )
    marker: tuple[Length, Length, Length] = Field(
        default=default_text("0 mm", "0 mm", "36.5 mm"),
        description="Point whose track is kept, fixed to the station next to it: the middle "
        "servo's axis.",
    )
    legs: LegsSpec = LegsSpec()
    servo: ServoSpec = ServoSpec()


# Options of the curling part behind `RobotSpec.body`; a rigid one is weighed on the medium mesh.
BODIES: dict[str, dict[str, Any]] = {
    "full": {"size": "default"},
    "medium": {"size": "20 mm"},
    "coarse": {"size": "20 mm", "aligned_rows": True},
    "rigid": {"size": "20 mm"},
}

__all__ = ["BODIES", "LEGS", "LEG_NAME", "TORSO", "LegsSpec", "RobotSpec", "ServoSpec"]
