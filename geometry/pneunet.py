"""Pneumatic networks: the dimension record of one row and the single-row body.

Source of all dimensions: SoSpider paper, table 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from flexapod.core.errors import InputError
from flexapod.geometry.blocks import Box, Sizing, UnitRow, build_row
from flexapod.geometry.tagged import TaggedMesh

_CLOSE = 1e-9  # [m], lengths nearer than this are equal


@dataclass(frozen=True)
class PneumaticNetwork:
    """Dimensions of one row of chambers [m], with the symbols of the paper's table 1.

    The chamber is ``a x (b - 2 g) x h``; it stands on the limit layer (thickness ``t``) and
    ends in the top wall ``c``. Chambers are ``l = a + 2 f`` long outside and ``d`` apart, so
    that the pitch is ``l + d``. The gap is filled over the thickness ``e`` next to the limit
    layer (the connection); the air path, a ``k x k`` channel, runs through it.

    Attributes
    ----------
    chamber_length
        a: inside length of the chamber along the body.
    network_width
        b: width of the row across.
    top_wall
        c: wall at the chamber's free end.
    gap
        d: distance between neighbouring chambers.
    connection_thickness
        e: filled height of the gap at the limit layer.
    inner_wall
        f: wall between chamber and gap.
    outer_wall
        g: wall between chamber and the row's side.
    chamber_height
        h: from the limit layer to the top wall.
    air_path
        k: side of the square channel that joins the chambers.
    outer_length
        l: outside length of a chamber.
    limit_layer
        t: thickness of the limit layer; 0 where the row has none of its own.
    """

    chamber_length: float
    network_width: float
    top_wall: float
    gap: float
    connection_thickness: float
    inner_wall: float
    outer_wall: float
    chamber_height: float
    air_path: float
    outer_length: float
    limit_layer: float

    def __post_init__(self) -> None:
        a, b, e, f = (
            self.chamber_length,
            self.network_width,
            self.connection_thickness,
            self.inner_wall,
        )
        c, d, g, h = self.top_wall, self.gap, self.outer_wall, self.chamber_height
        k, length = self.air_path, self.outer_length
        for entry in fields(self):
            value = getattr(self, entry.name)
            symbol = SYMBOLS[entry.name]
            least_ok = value >= 0.0 if symbol in ("k", "t") else value > 0.0
            if not (math.isfinite(value) and least_ok):
                sign = ">= 0" if symbol in ("k", "t") else "> 0"
                raise _broken(f"{symbol} {sign}", f"{entry.name} is {_mm(value)}")
        if abs(length - (a + 2 * f)) > _CLOSE:
            raise _broken("l = a + 2 f", f"{_mm(length)} != {_mm(a + 2 * f)}")
        if not b - 2 * g > _CLOSE:
            raise _broken("b > 2 g", f"{_mm(b)} <= {_mm(2 * g)}: no room for the chamber")
        if not e < c + h - _CLOSE:
            raise _broken("e < c + h", f"{_mm(e)} >= {_mm(c + h)}: no gap is left")
        if k > 0.0:
            if not k < e - _CLOSE:
                raise _broken("k < e", f"{_mm(k)} >= {_mm(e)}: the air path opens into the gap")
            if not k < h - _CLOSE:
                raise _broken("k < h", f"{_mm(k)} >= {_mm(h)}")
            if not k < b - 2 * g - _CLOSE:
                raise _broken("k < b - 2 g", f"{_mm(k)} >= {_mm(b - 2 * g)}")
        if not d < 100 * length:
            raise _broken("d < 100 l", f"{_mm(d)}: is the gap in metres?")

    @property
    def pitch(self) -> float:
        """Distance from unit to unit, l + d [m]."""
        return self.outer_length + self.gap

    @property
    def chamber_volume(self) -> float:
        """Air in one chamber without the air path, a (b - 2 g) h [m3]."""
        width = self.network_width - 2 * self.outer_wall
        return self.chamber_length * width * self.chamber_height

    def cavity_volume(self, unit_count: int) -> float:
        """Air of a closed row: n chambers and n - 1 air paths of length d + 2 f [m3]."""
        path = self.air_path**2 * (self.gap + 2 * self.inner_wall)
        return unit_count * self.chamber_volume + (unit_count - 1) * path


SYMBOLS = {
    "chamber_length": "a",
    "network_width": "b",
    "top_wall": "c",
    "gap": "d",
    "connection_thickness": "e",
    "inner_wall": "f",
    "outer_wall": "g",
    "chamber_height": "h",
    "air_path": "k",
    "outer_length": "l",
    "limit_layer": "t",
}


def _mm(value: float) -> str:
    return f"{value * 1e3:.6g} mm"


def _broken(relation: str, numbers: str) -> InputError:
    return InputError(f"{relation}: {numbers}", "mesh.dimensions")


def _network(*millimetres: float) -> PneumaticNetwork:
    return PneumaticNetwork(*(v * 1e-3 for v in millimetres))


def change_network(base: PneumaticNetwork, changes: Mapping[str, float]) -> PneumaticNetwork:
    """Copy of a row with some dimensions [m] changed, checked as a whole.

    Parameters
    ----------
    base
        The row to start from.
    changes
        Spelled-out name to value, for example ``{"gap": 0.004}``.
    """
    unknown = [name for name in changes if name not in SYMBOLS]
    if unknown:
        raise InputError(
            f"unknown dimension {unknown[0]!r}, use one of {', '.join(SYMBOLS)}", "mesh.dimensions"
        )
    return replace(base, **changes)


# Columns of table 1, in the order a b c d e f g h k l t.
MAIN_CURL = _network(8, 36, 4, 3, 5, 3, 3, 25, 3, 14, 15)
ASSISTANT_CURL = _network(5, 37, 4, 6, 5, 3, 4, 21, 3, 11, 0)
# The table gives f = 4 for the turning row, which contradicts l = a + 2 f (11 = 5 + 2 f); along
# the body the wall is 3 mm, as in the assistant row of the same pitch.
TURNING = _network(5, 23, 4, 6, 5, 3, 4, 30, 3, 11, 36)

NETWORKS = {"main_curl": MAIN_CURL, "assistant_curl": ASSISTANT_CURL, "turning": TURNING}

_SIZES = {
    "coarse": Sizing(10.0e-3, 1),
    "default": Sizing(5.0e-3, 2),
    "fine": Sizing(4.0e-3, 3),
}


def check_size(size: str | float, table: dict[str, Sizing]) -> Sizing:
    """Turn a size word or a target length [m] into a subdivision rule.

    A length keeps two elements through every wall where it is not longer than 6 mm and one
    above that, and more where the length itself asks for it.
    """
    if isinstance(size, str):
        if size not in table:
            words = ", ".join(table)
            raise InputError(f"size must be {words} or a length, got {size!r}", "mesh.size")
        return table[size]
    length = float(size)
    if not (math.isfinite(length) and 2e-4 <= length <= 0.1):
        raise InputError(f"size must lie between 0.2 mm and 100 mm, got {_mm(length)}", "mesh.size")
    return Sizing(length, 2 if length <= 6e-3 else 1)


def check_units(units: int) -> None:
    """Raise `InputError` unless the number of units is a whole number from 1 to 1000."""
    if int(units) != units or not 1 <= units <= 1000:
        raise InputError(f"units must be a whole number from 1 to 1000, got {units}", "mesh.units")


def symmetry_fraction(symmetry: str) -> float:
    """Part of the whole body that a symmetric model holds."""
    return {"whole": 1.0, "half": 0.5, "quarter": 0.25}[symmetry]


@dataclass(frozen=True)
class PneunetBuilder:
    """One row of units on its limit layer; inflation lifts the ends.

    Chambers hang from the limit layer towards -z: the underside (top walls) is z = 0, the limit
    layer is uppermost. x runs along the row, centred on x = 0; y across. The air path lies
    against the limit layer in the middle of the width, which leaves e - k below it; it is
    closed at both ends of the row.

    Attributes
    ----------
    units
        Number of units of the whole row.
    size
        "coarse", "default", "fine" or the longest element edge [m].
    symmetry
        "whole", "half" (x >= 0) or "quarter" (x >= 0, y >= 0).
    dimensions
        The row's dimensions; ``air_path = 0`` leaves the chambers unconnected.
    """

    units: int = 9
    size: str | float = "default"
    symmetry: str = "whole"
    dimensions: PneumaticNetwork = MAIN_CURL

    def __post_init__(self) -> None:
        check_units(self.units)
        if not self.dimensions.limit_layer > 0.0:
            raise _broken("t > 0", "limit_layer is 0 mm: a single row needs its limit layer")

    def row(self) -> UnitRow:
        """Half a unit as painted boxes."""
        n = self.dimensions
        a, length, p = n.chamber_length / 2, n.outer_length / 2, n.pitch / 2
        y, y_in = n.network_width / 2, n.network_width / 2 - n.outer_wall
        c, ceiling = n.top_wall, n.top_wall + n.chamber_height
        floor, top = ceiling - n.connection_thickness, ceiling + n.limit_layer
        k = n.air_path
        boxes = [
            Box((0, p), (0, y), (ceiling, top), "limit_layer"),
            Box((0, p), (0, y), (0, ceiling), "main"),
            Box((length, p), (0, y), (0, floor), air="gap_main"),
            Box((0, a), (0, y_in), (c, ceiling), air="cavity_main"),
        ]
        if k > 0.0:
            boxes.append(Box((a, p), (0, k / 2), (ceiling - k, ceiling), "main", "cavity_main"))
        walls_z = ((0.0, c), (floor, ceiling - k), (floor, ceiling), (ceiling, top))
        return UnitRow(
            tuple(boxes), (((a, length),), ((y_in, y),), walls_z), unit_count=int(self.units)
        )

    def build(self) -> TaggedMesh:
        """Mesh the row with Gmsh."""
        return build_row(self.row(), self.symmetry, check_size(self.size, _SIZES)).mesh

    def expected_volume(self) -> float:
        """Closed-form volume of the modelled silicone [m3]."""
        n = self.dimensions
        block = n.outer_length * n.network_width * (n.top_wall + n.chamber_height)
        connection = n.gap * n.network_width * n.connection_thickness
        layer = n.pitch * n.network_width * n.limit_layer
        whole = self.units * (block + connection + layer) - n.cavity_volume(self.units)
        return whole * symmetry_fraction(self.symmetry)

    def expected_cavity_volumes(self) -> dict[str, float]:
        """Closed-form air volume of each modelled cavity [m3]."""
        whole = self.dimensions.cavity_volume(self.units)
        return {"cavity_main": whole * symmetry_fraction(self.symmetry)}
