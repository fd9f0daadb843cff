"""Quantities with units, read at the border and nowhere else.

Inside the package every number is SI. A user writes ``"55 kPa"``; `read_quantity` makes it
55000.0. A bare number is refused: it has no unit, and guessing one is how meshes get scaled by
a thousand. Pint does the reading; it is imported on first use, because it costs a third of a
second that ``flexapod --help`` should not pay.

`Quantity` marks a pydantic field: ``Pressure = Annotated[float, Quantity("pressure", "Pa", ...)]``
is a float for Python and mypy, a string with a unit in a case file and in its JSON schema.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

from flexapod.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

_NUMBER = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$", re.DOTALL)
# "cm2" and "m3" as laboratories write them; "H2O" is left alone.
_POWER = re.compile(r"([A-Za-z])(-?\d)(?![A-Za-z0-9_])")

_ANGLES = {"radian", "milliradian", "degree", "arcminute", "arcsecond", "turn", "grade"}

# What to show in messages, by SI unit: the noun and an example.
_EXAMPLES: dict[str, tuple[str, str]] = {
    "Pa": ("pressure", "55 kPa"),
    "m": ("length", "3 mm"),
    "kg": ("mass", "0.25 kg"),
    "kg/m^3": ("density", "1080 kg/m^3"),
    "m/s^2": ("acceleration", "-9.8 m/s^2"),
    "rad": ("angle", "30 deg"),
    "N": ("force", "1.5 N"),
    "N/m": ("stiffness", "97 N/mm"),
    "N s/m": ("damping coefficient", "0.1 N s/m"),
    "N m/rad": ("bending stiffness", "1.5 N mm/rad"),
    "N/s": ("rate of a force", "150 mN/s"),
    "m/s": ("velocity", "1 mm/s"),
    "m^2": ("area", "24 mm^2"),
    "m^3": ("volume", "2 ml"),
    "s": ("time", "0.5 s"),
}


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry()
    return registry


def _article(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"


def _describe(unit: str, noun: str | None, example: str | None) -> tuple[str, str]:
    known = _EXAMPLES.get(unit, ("quantity", f"1 {unit}"))
    return noun or known[0], example or known[1]


@lru_cache(maxsize=4096)
def _factor(unit_text: str, si_unit: str) -> float:
    """SI units per one `unit_text`; raises pint's own errors."""
    registry = _registry()
    parsed = registry.parse_units(_POWER.sub(r"\1^\2", unit_text))
    if parsed.dimensionless and str(parsed) not in _ANGLES:
        # Pint counts angles among the dimensionless, so "20 %" would pass for 0.2 rad.
        raise ValueError("no unit")
    return float(registry.Quantity(1.0, parsed).to(si_unit).magnitude)


def read_quantity(
    text: object,
    unit: str,
    where: str | None = None,
    *,
    noun: str | None = None,
    example: str | None = None,
) -> float:
    """Return the SI value of a quantity written with its unit.

    Parameters
    ----------
    text
        For example ``"55 kPa"``. Anything else (a bare number above all) is refused.
    unit
        SI unit of the result, for example ``"Pa"``.
    where
        File and key, put in front of the message.
    noun, example
        What the message calls the quantity and shows as a model.

    Examples
    --------
    >>> read_quantity("55 kPa", "Pa")
    55000.0
    >>> read_quantity("98 mm", "m")
    0.098
    """
    noun, example = _describe(unit, noun, example)
    remedy = f'write {_article(noun)} with its unit, for example "{example}"'
    if not isinstance(text, str):
        raise InputError(f"{remedy}; got {text!r}", where)
    match = _NUMBER.match(text)
    if match is None:
        hint = " (write the decimal point as '.')" if re.match(r"\s*[+-]?\d+,\d", text) else ""
        raise InputError(f'{remedy}; got "{text}"{hint}', where)
    number, unit_text = match.groups()
    if not unit_text:
        raise InputError(f'{remedy}; got "{text}", which has no unit', where)
    if unit_text.startswith(","):
        raise InputError(f"{remedy}; got \"{text}\" (write the decimal point as '.')", where)
    try:
        factor = _factor(unit_text, unit)
    except ImportError:
        raise  # a broken installation is not a wrong unit
    except Exception as error:
        kind = type(error).__name__
        if kind == "DimensionalityError":
            fault = f'"{unit_text}" does not measure {_article(noun)}'
        else:
            fault = f'"{unit_text}" is not a unit known here'
        raise InputError(f'{remedy}; got "{text}", and {fault}', where) from None
    value = float(number)
    # Dividing by the inverse keeps "98 mm" the double nearest 0.098, which 98 * 0.001 is not.
    inverse = round(1.0 / factor) if 0.0 < factor < 1.0 else 0
    if inverse and math.isclose(inverse * factor, 1.0, rel_tol=1e-14):
        result = value / inverse
    else:
        result = value * factor
    if not math.isfinite(result):
        raise InputError(f'{remedy}; got "{text}", which is not finite', where)
    return result


def unit_scale(unit: str, si_unit: str) -> float:
    """SI units per one `unit`, for example 1000.0 for kPa and Pa."""
    return _factor(unit, si_unit)


# Units `write_quantity` tries before the SI unit itself, as (name, SI per unit as a fraction).
_DISPLAY: dict[str, tuple[tuple[str, float, float], ...]] = {
    "Pa": (("kPa", 1000.0, 1.0),),
    "m": (("mm", 1.0, 1000.0),),
    "rad": (("deg", math.pi, 180.0),),
}


def write_quantity(value: float, unit: str) -> str:
    """Write an SI value so that `read_quantity` gives back the same double.

    Examples
    --------
    >>> write_quantity(55000.0, "Pa")
    '55 kPa'
    """
    for name, numerator, denominator in _DISPLAY.get(unit, ()):
        shown = value * denominator / numerator
        for text in (f"{shown:.12g} {name}", f"{shown!r} {name}"):
            if 1e-4 < abs(shown) < 1e7 and read_quantity(text, unit) == value:
                return text
    short = f"{value:.12g}"
    return f"{short if float(short) == value else repr(float(value))} {unit}"


@dataclass(frozen=True)
class Quantity:
    """Pydantic marker: a string with a unit outside, an SI float inside.

    Parameters
    ----------
    noun
        What messages and the schema call it.
    unit
        SI unit of the float.
    example
        Shown in messages and in the schema.
    positive
        Refuse values <= 0.
    """

    noun: str
    unit: str
    example: str
    positive: bool = False

    def read(self, text: object) -> float:
        """Return the SI value of a text with its unit."""
        value = read_quantity(text, self.unit, noun=self.noun, example=self.example)
        if self.positive and not value > 0.0:
            raise InputError(f'{self.noun} must be > 0, got "{text}"')
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Validate with `read`, write back with `write_quantity`."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            self.read,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value: write_quantity(value, self.unit), return_schema=None
            ),
        )

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """A string with an example, for editors."""
        return {
            "type": "string",
            "description": f"{_article(self.noun).capitalize()} with its unit.",
            "examples": [self.example],
            "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[A-Za-zµ°].*$",
        }


Pressure = Annotated[float, Quantity("pressure", "Pa", "55 kPa")]
Modulus = Annotated[float, Quantity("modulus", "Pa", "218 kPa", positive=True)]
AnyModulus = Annotated[float, Quantity("modulus", "Pa", "-0.683 MPa")]
Length = Annotated[float, Quantity("length", "m", "3 mm")]
PositiveLength = Annotated[float, Quantity("length", "m", "3 mm", positive=True)]
Mass = Annotated[float, Quantity("mass", "kg", "0.25 kg", positive=True)]
Density = Annotated[float, Quantity("density", "kg/m^3", "1080 kg/m^3", positive=True)]
Acceleration = Annotated[float, Quantity("acceleration", "m/s^2", "-9.8 m/s^2")]
Angle = Annotated[float, Quantity("angle", "rad", "30 deg")]
Force = Annotated[float, Quantity("force", "N", "1.5 N")]
Area = Annotated[float, Quantity("area", "m^2", "24 mm^2", positive=True)]
Time = Annotated[float, Quantity("time", "s", "5 ms")]
PositiveTime = Annotated[float, Quantity("time", "s", "5 ms", positive=True)]
Rate = Annotated[float, Quantity("rate", "1/s", "2 1/s")]
Speed = Annotated[float, Quantity("speed", "m/s", "1 mm/s", positive=True)]
Slowness = Annotated[float, Quantity("damping ratio", "s/m", "0.1 s/m")]
Velocity = Annotated[float, Quantity("velocity", "m/s", "-0.5 m/s")]
Spin = Annotated[float, Quantity("spin", "rad/s", "90 deg/s")]
Flow = Annotated[float, Quantity("flow", "m^3/s", "2 l/min")]
Conductance = Annotated[float, Quantity("conductance", "m^3/s/Pa", "1 ml/s/kPa")]
BondStiffness = Annotated[float, Quantity("stiffness per area", "Pa/m", "0.2 GPa/m", positive=True)]
ContactStiffness = Annotated[
    float, Quantity("contact stiffness", "N/m^1.5", "97 N/mm^1.5", positive=True)
]
SpringStiffness = Annotated[float, Quantity("stiffness", "N/m", "500 N/m", positive=True)]
LineDamping = Annotated[float, Quantity("damping coefficient", "N s/m", "0.1 N s/m")]
BendStiffness = Annotated[
    float, Quantity("bending stiffness", "N m/rad", "0.0015 N m/rad", positive=True)
]
PositiveForce = Annotated[float, Quantity("force", "N", "150 mN", positive=True)]
Torque = Annotated[float, Quantity("torque", "N m", "25 kgf cm", positive=True)]
TorsionStiffness = Annotated[
    float, Quantity("torsional stiffness", "N m/rad", "200 N m/rad", positive=True)
]
TorsionDamping = Annotated[float, Quantity("torsional damping", "N m s/rad", "0.5 N m s/rad")]
IntegralGain = Annotated[float, Quantity("integral gain", "N m/rad/s", "50 N m/rad/s")]
Inertia = Annotated[float, Quantity("moment of inertia", "kg m^2", "0.003 kg m^2", positive=True)]
ForceRate = Annotated[float, Quantity("rate of a force", "N/s", "150 mN/s", positive=True)]


def read_quantities(texts: Any, unit: str, where: str | None = None) -> np.ndarray:
    """Return SI values of a list of quantities, shape (len(texts),)."""
    import numpy as np

    return np.array([read_quantity(text, unit, where) for text in texts])
