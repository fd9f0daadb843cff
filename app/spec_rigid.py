"""The table of a rigid body: a cell group of the mesh, or a shape of its own."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from flexapod.app.spec_base import Axis, Names, Table, Triple, one_or_many
from flexapod.core.units import (
    Angle,
    Density,
    Length,
    Mass,
    Modulus,
    PositiveLength,
    Spin,
    Velocity,
)

Hold = Literal["x", "y", "z", "turn_x", "turn_y", "turn_z"]

# What a contact calls the surface of a body with a shape: this and its name.
SURFACE_OF = "rigid:"

# Keys each shape has for its size.
_SIZES = {
    "box": ("size",),
    "wedge": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
}


class RigidSpec(Table):
    """A rigid body: cell groups of the mesh (`group`), or a body of its own (`name`, `shape`)."""

    group: str | None = Field(
        default=None, description="Cell groups that move as rigid bodies, one each; globs allowed."
    )
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")] | None = Field(
        default=None,
        description='Of a body with a shape; contacts call its surface "rigid:<name>".',
    )
    shape: Literal["box", "wedge", "sphere", "cylinder"] | None = None
    size: tuple[PositiveLength, PositiveLength, PositiveLength] | None = Field(
        default=None,
        description="Edges along x, y, z of a box before it is turned, or of that round a wedge.",
    )
    front_angle: Angle | None = Field(
        default=None,
        description="Of a wedge's end at +x with the ground under it (default 90 deg, upright). "
        'Its sides are surfaces of their own: "rigid:<name>/bottom", "/top", "/front", "/back", '
        '"/flanks".',
    )
    back_angle: Angle | None = Field(default=None, description="The same at -x.")
    radius: PositiveLength | None = Field(default=None, description="Of a sphere or a cylinder.")
    length: PositiveLength | None = Field(default=None, description="Of a cylinder.")
    axis: Axis | None = Field(
        default=None, description="Along which a cylinder lies before it is turned (default y)."
    )
    density: Density | None = None
    mass: Mass | None = Field(default=None, description="In place of density.")
    position: tuple[Length, Length, Length] | None = Field(
        default=None,
        description="Centre at the start of the motion, in space: where a [start] shape has been "
        "turned and set down. Of a tied body: in the undeformed body, with which it goes along. "
        "Of a wedge: its centre of mass.",
    )
    turn: Angle | None = Field(
        default=None, description="Turned by this about `turn_axis` (default: not at all)."
    )
    turn_axis: Triple | None = Field(
        default=None, description="A direction of any length (default y)."
    )
    velocity: tuple[Velocity, Velocity, Velocity] | None = Field(
        default=None, description="Of the centre at the start (default: at rest)."
    )
    spin: tuple[Spin, Spin, Spin] | None = Field(
        default=None, description="Angular velocity at the start (default: none)."
    )
    tied: Names | None = Field(
        default=None,
        description="Surface or cell groups whose nodes it carries along as if welded; globs "
        "allowed.",
    )
    hold: tuple[Hold, ...] | None = Field(
        default=None,
        description="Ways it cannot move, as in a plane of symmetry; all six: a fixed obstacle.",
    )
    mesh_size: PositiveLength | None = Field(
        default=None,
        description="Longest edge of a face of its surface (default: from its shape).",
    )
    youngs_modulus: Modulus | None = Field(
        default=None,
        description="For contact (default: rigid; 1 MPa where both partners would be).",
    )

    _many = field_validator("tied", "hold", mode="before")(one_or_many)

    @field_validator("spin", mode="before")
    @classmethod
    def _turns(cls, value: Any) -> Any:
        # To Pint a hertz is one per second, which would be read as a radian per second.
        for text in value if isinstance(value, list | tuple) else ():
            if isinstance(text, str) and text.strip().endswith("Hz"):
                raise ValueError(f'write turns, for example "2 turn/s" or "120 rpm"; got "{text}"')
        return value

    @field_validator("turn_axis")
    @classmethod
    def _with_length(cls, value: Triple | None) -> Triple | None:
        if value is not None and not 0.0 < math.hypot(*value) < math.inf:
            raise ValueError("turn_axis must have a length")
        return value

    @model_validator(mode="after")
    def _group_or_shape(self) -> RigidSpec:
        given = [key for key in type(self).model_fields if getattr(self, key) is not None]
        if self.group is not None:
            if len(given) > 1:
                others = ", ".join(key for key in given if key != "group")
                raise ValueError(
                    f"group stands alone: its cells have shape and mass already; got {others} too"
                )
            return self
        for key, text in (("name", '"payload"'), ("shape", '"box"')):
            if key not in given:
                raise ValueError(f"write group, or a body of its own: {key} = {text} is missing")
        self._check_shape(given)
        if (self.density is None) == (self.mass is None):
            raise ValueError('write exactly one of density and mass, for example mass = "0.2 kg"')
        if self.position is None:
            raise ValueError(
                'position is missing: write its centre, for example ["0 mm", "0 mm", "50 mm"]'
            )
        if self.turn_axis is not None and self.turn is None:
            raise ValueError('turn_axis needs a turn, for example turn = "30 deg"')
        for moved, prefix in ((self.velocity, ""), (self.spin, "turn_")):
            for axis, value in zip("xyz", moved or (), strict=False):
                if value != 0.0 and prefix + axis in (self.hold or ()):
                    what = "spin" if prefix else "velocity"
                    raise ValueError(f'{what} along {axis} is held by "{prefix}{axis}" in hold')
        return self

    def _check_shape(self, given: list[str]) -> None:
        assert self.shape is not None
        wanted = _SIZES[self.shape]
        examples = {"size": '["20 mm", "20 mm", "5 mm"]', "radius": '"8 mm"', "length": '"30 mm"'}
        for key in examples:
            if key in wanted and key not in given:
                raise ValueError(
                    f"a {self.shape} needs {' and '.join(wanted)}: write {key} = {examples[key]}"
                )
            if key in given and key not in wanted:
                raise ValueError(f"a {self.shape} has no {key}; it has {' and '.join(wanted)}")
        for key in ("front_angle", "back_angle"):
            if key in given and self.shape != "wedge":
                raise ValueError(f"{key} belongs to a wedge")
        if self.axis is not None and self.shape != "cylinder":
            raise ValueError("axis belongs to a cylinder; turn a box by turn and turn_axis")


__all__ = ["SURFACE_OF", "RigidSpec"]
