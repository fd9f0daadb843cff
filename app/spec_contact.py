"""What contacts share: the normal law, and what only matters in motion."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from flexapod.app.spec_base import Names, Table, default_text, one_or_many
from flexapod.core.units import (
    Area,
    BondStiffness,
    ContactStiffness,
    PositiveLength,
    Slowness,
    Speed,
)

Coefficient = Annotated[float, Field(ge=0, lt=10)]


class ContactBase(Table):
    """The paper's normal law on named surfaces."""

    surface: Names = Field(description="Surface groups of the body; globs allowed.")
    stiffness: ContactStiffness | None = Field(
        default=None, description="Overrides the paper's k = sqrt(16 R E^2 / 9)."
    )
    radius: PositiveLength = Field(
        default=default_text("500 m"), description="Radius of each side in the paper's law."
    )
    exponent: Annotated[float, Field(ge=1, le=4)] = Field(
        default=2.0, description="Exponent of the penetration: 2 in the paper, 1.5 for Hertz."
    )
    reference_area: Area = Field(
        default=default_text("9 mm^2"),
        description="Area one contact point of the paper's law stands for.",
    )

    _surface = field_validator("surface", mode="before")(one_or_many)


class MovingContact(Table):
    """Friction and damping of the paper's law (equations 4 and 8); motion only."""

    friction: Coefficient = Field(
        default=0.0, description="Static coefficient; the paper sets 0 between chambers."
    )
    friction_dynamic: Coefficient | None = Field(
        default=None, description="Above dynamic_speed (default: the static one)."
    )
    static_speed: Speed = Field(
        default=default_text("1 mm/s"), description="Up to which the static coefficient holds."
    )
    dynamic_speed: Speed = default_text("1.5 mm/s")
    stick_stiffness: BondStiffness = Field(
        default=default_text("1 GPa/m"),
        description="Shear per slip before a point slides. Statics takes a hundredth, for Newton's "
        "method; in motion that is so soft that a rolling body creeps.",
    )
    damping: Slowness = Field(
        default=default_text("0.1 s/m"), description="c/k, 1e-4 s/mm in the paper; at m2 = 1."
    )
    damping_exponent: Annotated[float, Field(ge=0.5, le=4)] = Field(
        default=1.0, description="m2, of the speed of the penetration."
    )
    indentation_exponent: Annotated[float, Field(ge=0, le=4)] = Field(
        default=2.0, description="m3, of the penetration in the damping."
    )
    skin: PositiveLength | None = Field(
        default=None,
        description="Distance up to which faces are watched (default: 5 mm): a "
        "thinner one is cheaper between searches, which come sooner. Faces that come nearer by "
        "more than a fiftieth of it in one step may be missed.",
    )
