"""The hexapod's soft body: the curling part with its full cross-section, and the turning part.

Cross-section [m, symmetric in y], from the SoSpider paper's table 1 as reconstructed in the
project's notes; with the table's numbers in mm:

- main row, ``|y| < 18``: chamber ``|y| < 15, 4 < z < 29``, limit layer ``29 < z < 44``;
- assistant rows out to ``|y| = 52`` sharing the main row's wall: chamber
  ``19 < |y| < 48, 4 < z < 25``;
- turning rows, ``18 < |y| < 52, 25 < z < 48``: chamber ``18 < |y| < 48, 29 < z < 44``,
  growing sideways from the spine.

Air paths (k x k) are not located by the paper. Here those of the main and the turning rows run
against the limit layer's side of their chambers where that leaves most silicone round them: main
``|y| < k/2`` under the limit layer, turning against the spine at mid height. They join the
chambers of a row and are closed at the body's ends.

The assistant chambers have no path of their own: the paper's section 2.3 says that the separate
chambers under the turning module are joined to those of the main curl module by ventilation
holes. So each opens sideways into the main chamber of its unit, k x k through the shared wall,
right under its ceiling: of the whole wall this place is nearest to the limit layer, which hardly
stretches, and at least 4 mm of silicone lie round the hole. Main and assistant chambers are then
one cavity. A path along x (``assistant_feed = "row"``) is kept for comparison: it has only 1 mm
of silicone to the main row's gap, which balloons at about 25 kPa.

The paper does not draw where the six servos sit, two to a station. Its section 2.3 places them
"in the slots position", "connected by long double-headed bolts through the limitation layer", and
section 4.1 speaks of "a servo motor in the middle of the turning part". A servo of their size
(standard, 45.2 x 24.7 x 35 mm) does not fit into the limit layer (36 x 15 mm for two), but 24.7 x
35 mm is about the section of a turning row (23 x 34 mm). ``servo_place = "turning_rows"`` builds
that: a block fills the section of both turning rows over the station, the limit layer between them
is clamped by the bolts, and the turning units in the way are left out but for their connections
and, beside the block, for the floor that is the ceiling of the assistant chambers below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from flexapod.core.errors import InputError
from flexapod.geometry.blocks import Box, Sizing, UnitRow, build_row, place_stations
from flexapod.geometry.pneunet import (
    ASSISTANT_CURL,
    MAIN_CURL,
    TURNING,
    PneumaticNetwork,
    check_size,
    check_units,
    symmetry_fraction,
)
from flexapod.geometry.tagged import TaggedMesh

_CLOSE = 1e-9  # [m]
_NO_AIR = 1e-15  # [m3], a hundredth of a millimetre cubed: less is round-off

ASSISTANT_FEEDS = ("ventilation", "row")
SERVO_PLACES = ("limit_layer", "turning_rows")

# Chosen by counting: 14,915 (default) and 40,698 (fine) hexahedra for the quarter model, whose
# counterpart in the paper has 37,078; 31,544 for the fine half of the turning part (31,887).
_CURL_SIZES = {
    "coarse": Sizing(10.0e-3, 1),
    "default": Sizing(6.5e-3, 2),
    "fine": Sizing(4.0e-3, 3),
}
_TURN_SIZES = {
    "coarse": Sizing(10.0e-3, 1),
    "default": Sizing(5.0e-3, 2),
    "fine": Sizing(4.0e-3, 3),
}


def servo_intervals(
    length: float, centres: tuple[float, ...] | None, servo_length: float
) -> tuple[tuple[float, float], ...]:
    """Intervals of x [m] that the servo stations occupy, from left to right.

    Without centres: three stations, one in the middle and two that end at the body's ends.
    """
    reach = (length - servo_length) / 2
    centres = (-reach, 0.0, reach) if centres is None else tuple(sorted(centres))
    if not 0.0 < servo_length < length:
        raise InputError(
            f"servo_length must be > 0 and shorter than the body, got {servo_length * 1e3:g} mm "
            f"for {length * 1e3:g} mm",
            "mesh.servo_length",
        )
    for centre in centres:
        if abs(centre) > length / 2:
            raise InputError(
                f"servo centre {centre * 1e3:g} mm lies outside the body (+-{length * 500:g} mm)",
                "mesh.servo_centres",
            )
    for left, right in pairwise(centres):
        if right - left < servo_length - _CLOSE:
            raise InputError(
                f"servo stations at {left * 1e3:g} and {right * 1e3:g} mm overlap: they are "
                f"{servo_length * 1e3:g} mm long",
                "mesh.servo_centres",
            )
    return tuple((c - servo_length / 2, c + servo_length / 2) for c in centres)


def _stations(builder: CurlBuilder | TurnBuilder) -> tuple[tuple[float, float], ...]:
    """Intervals of x [m] of the builder's stations, not yet snapped."""
    if not builder.servos:
        return ()
    intervals = servo_intervals(builder.length, builder.servo_centres, builder.servo_length)
    if builder.servo_place == "turning_rows" and builder.symmetry != "whole":
        for (left, _), (_, right) in zip(intervals, reversed(intervals), strict=True):
            if abs(left + right) > _CLOSE:
                raise InputError(
                    f"servo stations in the turning rows must lie symmetric about x = 0 for "
                    f'symmetry "{builder.symmetry}": move the centres or model the whole body',
                    "mesh.servo_centres",
                )
    return intervals


def _check_servo_place(place: str) -> None:
    if place not in SERVO_PLACES:
        raise InputError(
            f"servo_place must be one of {', '.join(SERVO_PLACES)}, got {place!r}",
            "mesh.servo_place",
        )


def _with_slots(row: UnitRow, builder: CurlBuilder | TurnBuilder, base: float) -> UnitRow:
    """The row with its turning rows, lowest at z = base, ready to make room for servos."""
    if not (builder.servos and builder.servo_place == "turning_rows"):
        return row
    n = builder.turning_row()
    p, length, spine = n.pitch / 2, n.outer_length / 2, n.limit_layer / 2
    joint, far = spine + n.connection_thickness, spine + n.chamber_height + n.top_wall
    z, z_floor = (base, base + n.network_width), (base, base + _slot_floor(builder))
    return replace(
        row,
        slot_boxes=(
            Box((0, p), (spine, joint), z, "turn"),
            Box((0, p), (joint, far), z, air="gap_turn"),
            Box((0, length), (joint, far), z_floor, "turn"),
        ),
        servo_boxes=(Box((0, p), (spine, far), z, "housing"),),
        slot_length=n.outer_length,
    )


def _slot_floor(builder: CurlBuilder | TurnBuilder) -> float:
    """Height [m] of what stays of a unit beside a servo: the assistant chambers need a ceiling."""
    return builder.turning_row().outer_wall if isinstance(builder, CurlBuilder) else 0.0


def _slot_volumes(builder: CurlBuilder | TurnBuilder, sizing: Sizing) -> tuple[float, float]:
    """What stations add to the bulk (solid and air) and to the air of one turning row [m3].

    Closed form in the stations' snapped ends; the whole body's, whatever part is modelled.
    """
    row, n = builder.row(), _built(builder.turning_row(), builder.air_paths)
    if not row.servo_boxes:
        return 0.0, 0.0
    stations = place_stations(row, sizing, _stations(builder))
    slots, shut = int(stations.slots.sum()), int(stations.shut[1:-1].sum())
    air = slots * n.chamber_volume + shut * n.air_path**2 * (n.gap + 2 * n.inner_wall)
    start, stop = np.array(stations.intervals).T[:, :, None]
    middles = (np.arange(row.unit_count) + 0.5 - row.unit_count / 2) * row.pitch
    left, right = middles - n.outer_length / 2, middles + n.outer_length / 2
    inside = np.maximum(np.minimum(stop, right) - np.maximum(start, left), 0.0).sum()
    length, blocks = (stop - start).sum(), slots * n.outer_length
    section = n.network_width * (length - blocks) + _slot_floor(builder) * (blocks - inside)
    beyond = n.chamber_height + n.top_wall - n.connection_thickness
    return float(beyond * section), -air


def _built(row: PneumaticNetwork, air_paths: bool) -> PneumaticNetwork:
    """The row with or without its air path."""
    return row if air_paths else replace(row, air_path=0.0)


def align_rows(
    main: PneumaticNetwork, assistant: PneumaticNetwork, turning: PneumaticNetwork
) -> tuple[PneumaticNetwork, PneumaticNetwork, PneumaticNetwork]:
    """The rows of a curling part with their walls in common planes.

    A plane needed by one row cuts all of them (see `flexapod.geometry.blocks`): with the paper's
    dimensions there are elements of 1 mm across and 1.5 mm along, which no wall asks for. So:

    - along the body assistant and turning chambers are as long, as thick-walled and as far apart
      as the main row's (a, f, d, l);
    - the main row's wall towards the assistants is as thick as theirs (g), inwards; their common
      wall then lies in the same planes, and what it takes from the main row their width b gets;
    - the main row's connection (e) begins at the assistants' ceiling.
    """
    along = {
        "chamber_length": main.chamber_length,
        "inner_wall": main.inner_wall,
        "gap": main.gap,
        "outer_length": main.outer_length,
    }
    thicker = assistant.outer_wall - main.outer_wall
    above = main.top_wall + main.chamber_height - assistant.top_wall - assistant.chamber_height
    return (
        replace(main, outer_wall=assistant.outer_wall, connection_thickness=above),
        replace(assistant, network_width=assistant.network_width + thicker, **along),
        replace(turning, **along),
    )


def _turn_boxes(n: PneumaticNetwork, spine: float, base: float) -> list[Box]:
    """Half a unit of one turning row from the spine's side, lowest at z = base."""
    a, length, p = n.chamber_length / 2, n.outer_length / 2, n.pitch / 2
    y0, y1 = spine, spine + n.chamber_height
    y2, joint = y1 + n.top_wall, spine + n.connection_thickness
    z0, z3 = base, base + n.network_width
    z1, z2 = z0 + n.outer_wall, z3 - n.outer_wall
    middle, k = (z0 + z3) / 2, n.air_path
    boxes = [
        Box((0, p), (y0, y2), (z0, z3), "turn"),
        Box((length, p), (joint, y2), (z0, z3), air="gap_turn"),
        Box((0, a), (y0, y1), (z1, z2), air="cavity_turn", sided=True),
    ]
    if k > 0.0:
        box_z = (middle - k / 2, middle + k / 2)
        boxes.append(Box((a, p), (y0, y0 + k), box_z, "turn", "cavity_turn", sided=True))
    return boxes


@dataclass(frozen=True)
class CurlBuilder:
    """The curling part: main row, two assistant rows and the turning rows that ride along.

    Attributes
    ----------
    units
        Units of the whole body (the robot has 18).
    size
        "coarse", "default", "fine" or the longest element edge [m].
    symmetry
        "whole", "half" (x >= 0) or "quarter" (x >= 0, y >= 0).
    servos
        Whether servo stations become the cell groups "servo_0", "servo_1", ...
    servo_centres
        Middles of the stations [m], or None for one in the middle and one at each end.
    servo_length
        Length of a station along the body [m]. Its ends snap to the nearest lattice plane.
    servo_place
        "limit_layer": a station is a stretch of the limit layer and takes no room. This is the
        simple picture, and the default until the other is tried against the measurement.
        "turning_rows": where six standard servos fit (see the module). A station is the whole
        section of both turning rows and the limit layer between them, one solid that is bonded
        to the rows below and is the ceiling of the assistant chambers there. A turning unit whose
        chamber block it would cut or touch goes, chamber and all, but for its connection along
        the spine and its floor (g high) over an assistant chamber, and the row's air path ends
        beside it; the chambers left keep one cavity's name. A half or quarter needs stations
        that lie symmetric in x.
    air_paths
        Whether chambers are joined; without, their air is one cavity by name only and the mesh
        is smaller (the planes of paths and holes cross the whole section).
    assistant_feed
        "ventilation": a hole joins each assistant chamber to its unit's main chamber, and the
        air of both is "cavity_curl". "row": an air path along x joins the assistant chambers of
        a side; cavities "cavity_main", "cavity_assistant_left" and "..._right".
    aligned_rows
        Whether walls of neighbouring rows are brought into common planes, for a small mesh of
        thick elements with large stable steps: see `align_rows`. Not the robot's own section.
    main, assistant, turning
        Dimensions of the rows. The assistant's k is the side of hole or path.
    """

    units: int = 18
    size: str | float = "default"
    symmetry: str = "quarter"
    servos: bool = False
    servo_centres: tuple[float, ...] | None = None
    servo_length: float = 0.045
    servo_place: str = "limit_layer"
    air_paths: bool = True
    assistant_feed: str = "ventilation"
    aligned_rows: bool = False
    main: PneumaticNetwork = MAIN_CURL
    assistant: PneumaticNetwork = ASSISTANT_CURL
    turning: PneumaticNetwork = TURNING

    def __post_init__(self) -> None:
        check_units(self.units)
        _check_servo_place(self.servo_place)
        if self.assistant_feed not in ASSISTANT_FEEDS:
            raise InputError(
                f"assistant_feed must be one of {', '.join(ASSISTANT_FEEDS)}, "
                f"got {self.assistant_feed!r}",
                "mesh.assistant_feed",
            )
        # Of the rows as given: those brought into common planes keep what holds for these.
        m, s, r = self.main, self.assistant, self.turning
        for name, row in (("assistant", s), ("turning", r)):
            _same("l + d of main", m.pitch, f"l + d of {name}", row.pitch)
        _same("b of main", m.network_width, "t of turning", r.limit_layer)
        _same(
            "b/2 - g of main + b of assistant",
            m.network_width / 2 - m.outer_wall + s.network_width,
            "t/2 + h + c of turning",
            r.limit_layer / 2 + r.chamber_height + r.top_wall,
        )
        _less("t of main", 0.0, m.limit_layer, "> 0")
        _less(
            "c + h of assistant < c + h of main",
            s.top_wall + s.chamber_height,
            m.top_wall + m.chamber_height,
        )
        _less("g of main < g of assistant", m.outer_wall, s.outer_wall)
        if self._ventilated:
            _less("k of assistant < a of assistant", s.air_path, s.chamber_length)
            _less("k of assistant < a of main", s.air_path, m.chamber_length)
            room = s.top_wall + s.chamber_height - m.top_wall
            _less("k of assistant < c + h of assistant - c of main", s.air_path, room)
        elif s.air_path > 0.0:
            room = r.connection_thickness - (s.outer_wall - m.outer_wall)
            _less("k of assistant < e of turning - (g of assistant - g of main)", s.air_path, room)

    @property
    def _ventilated(self) -> bool:
        return self.assistant_feed == "ventilation"

    @property
    def length(self) -> float:
        """Length of the whole body [m]."""
        return self.units * self.main.pitch

    def _sections(self) -> tuple[PneumaticNetwork, PneumaticNetwork, PneumaticNetwork]:
        """Main, assistant and turning dimensions, brought into common planes where asked for."""
        rows = self.main, self.assistant, self.turning
        return align_rows(*rows) if self.aligned_rows else rows

    def turning_row(self) -> PneumaticNetwork:
        """The turning rows' dimensions."""
        return self._sections()[2]

    def _rows(self) -> tuple[PneumaticNetwork, PneumaticNetwork, PneumaticNetwork]:
        """Main, assistant and turning dimensions as built."""
        m, s, r = self._sections()
        return (
            _built(m, self.air_paths),
            _built(s, self.air_paths),
            _built(r, self.air_paths),
        )

    def row(self) -> UnitRow:
        """Half a unit as painted boxes."""
        m, s, r = self._rows()
        p = m.pitch / 2
        width = m.network_width / 2
        main_in = width - m.outer_wall
        c, ceiling = m.top_wall, m.top_wall + m.chamber_height
        floor, top = ceiling - m.connection_thickness, ceiling + m.limit_layer
        a, length, k = m.chamber_length / 2, m.outer_length / 2, m.air_path
        far = main_in + s.network_width
        s_in, s_out = main_in + s.outer_wall, far - s.outer_wall
        s_c, s_ceiling = s.top_wall, s.top_wall + s.chamber_height
        s_floor = s_ceiling - s.connection_thickness
        s_a, s_length = s.chamber_length / 2, s.outer_length / 2
        k_s = s.air_path
        vent, path = (k_s, 0.0) if self._ventilated else (0.0, k_s)
        if self._ventilated:
            main_air = side_air = "cavity_curl"
        else:
            main_air, side_air = "cavity_main", "cavity_assistant"
        sided = not self._ventilated
        r_joint = width + r.connection_thickness
        r_top = s_ceiling + r.network_width
        # Painted assistants first: the shared wall belongs to the main row.
        boxes = [
            Box((0, p), (width, far), (0, s_ceiling), "assistant"),
            Box((s_length, p), (width, far), (0, s_floor), air="gap_assistant"),
            Box((0, s_a), (s_in, s_out), (s_c, s_ceiling), air=side_air, sided=sided),
            *_turn_boxes(r, width, s_ceiling),
            Box((0, p), (0, width), (ceiling, top), "limit_layer"),
            Box((0, p), (0, width), (0, ceiling), "main"),
            Box((length, p), (0, width), (0, floor), air="gap_main"),
            Box((0, a), (0, main_in), (c, ceiling), air=main_air),
        ]
        if k > 0.0:
            boxes.append(Box((a, p), (0, k / 2), (ceiling - k, ceiling), "main", main_air))
        if vent > 0.0:
            z = (s_ceiling - vent, s_ceiling)
            boxes.append(Box((0, vent / 2), (main_in, s_in), z, air=main_air))
        if path > 0.0:
            y, z = (s_in, s_in + path), (s_ceiling - path, s_ceiling)
            boxes.append(Box((s_a, p), y, z, "assistant", side_air, sided=True))
        k_r = r.air_path
        walls_x = (
            (a, length),
            (s_a, s_length),
            (r.chamber_length / 2, r.outer_length / 2),
        )
        walls_y = (
            (main_in, s_in),
            (width + k_r, r_joint),
            (s_out, far),
            (width + r.chamber_height, far),
        )
        walls_z = (
            (0.0, c),
            (0.0, s_c),
            (s_floor, s_ceiling - path),
            (floor, ceiling - k),
            (s_ceiling, s_ceiling + r.outer_wall),
            (r_top - r.outer_wall, r_top),
            (ceiling, top),
        )
        row = UnitRow(tuple(boxes), (walls_x, walls_y, walls_z), int(self.units))
        return _with_slots(row, self, s_ceiling)

    def build(self) -> TaggedMesh:
        """Mesh the part with Gmsh."""
        sizing, servos = check_size(self.size, _CURL_SIZES), _stations(self)
        return build_row(self.row(), self.symmetry, sizing, ("limit_layer",), servos).mesh

    def expected_volume(self) -> float:
        """Closed-form volume of the modelled solid, servo stations included [m3]."""
        m, s, r = self._rows()
        beside = s.network_width - m.outer_wall  # assistant row without the shared wall
        out = r.chamber_height + r.top_wall
        main = m.network_width * (
            m.outer_length * (m.top_wall + m.chamber_height)
            + m.gap * m.connection_thickness
            + m.pitch * m.limit_layer
        )
        assistant = beside * (
            s.outer_length * (s.top_wall + s.chamber_height) + s.gap * s.connection_thickness
        )
        turn = r.network_width * (r.outer_length * out + r.gap * r.connection_thickness)
        air = sum(self._whole_cavities().values())
        servos = 2 * _slot_volumes(self, check_size(self.size, _CURL_SIZES))[0]
        whole = self.units * (main + 2 * assistant + 2 * turn) + servos - air
        return whole * symmetry_fraction(self.symmetry)

    def _whole_cavities(self) -> dict[str, float]:
        m, s, r = self._rows()
        main = m.cavity_volume(self.units)
        turn = (
            r.cavity_volume(self.units) + _slot_volumes(self, check_size(self.size, _CURL_SIZES))[1]
        )
        if self._ventilated:
            # The shared wall is as thick as the assistant's outer wall.
            beside = self.units * (s.chamber_volume + s.air_path**2 * s.outer_wall)
            rows = {"cavity_curl": main + 2 * beside}
        else:
            beside = s.cavity_volume(self.units)
            rows = {
                "cavity_main": main,
                "cavity_assistant_left": beside,
                "cavity_assistant_right": beside,
            }
        return {**rows, **_turn_cavities(turn)}

    def expected_cavity_volumes(self) -> dict[str, float]:
        """Closed-form air volume of each modelled cavity [m3]."""
        return _modelled(self._whole_cavities(), self.symmetry)


def _turn_cavities(volume: float) -> dict[str, float]:
    """Both turning rows' cavities by name, none if servos have taken every chamber."""
    if volume < _NO_AIR:
        return {}
    return {"cavity_turn_left": volume, "cavity_turn_right": volume}


def _modelled(whole: dict[str, float], symmetry: str) -> dict[str, float]:
    """Cavity volumes inside the modelled part of the body."""
    along = 1.0 if symmetry == "whole" else 0.5
    across = 0.5 if symmetry == "quarter" else 1.0
    volumes = {}
    for name, volume in whole.items():
        sided = name.endswith(("_left", "_right"))
        if symmetry == "quarter" and name.endswith("_left"):
            continue
        volumes[name] = volume * along * (1.0 if sided else across)
    return volumes


def _same(left: str, left_value: float, right: str, right_value: float) -> None:
    if abs(left_value - right_value) > _CLOSE:
        raise InputError(
            f"{left} = {right}: {left_value * 1e3:.6g} mm != {right_value * 1e3:.6g} mm",
            "mesh.dimensions",
        )


def _less(relation: str, small: float, large: float, words: str = "") -> None:
    if not small < large - _CLOSE:
        numbers = f"{small * 1e3:.6g} mm >= {large * 1e3:.6g} mm"
        raise InputError(f"{relation} {words}".strip() + f": {numbers}", "mesh.dimensions")


@dataclass(frozen=True)
class TurnBuilder:
    """The turning part: rows of chambers on both sides of the spine, bending about z.

    The part lies flat with z = 0 at its underside (the body's z less 25 mm). The spine is t wide
    and, by default, as high as the rows (b): the paper lists t = 36 as the limit layer of the
    turning column and models this part apart from the curling one. With `spine_height` the spine
    is only that high, centred (15 mm is the limit layer that the whole body has there).

    Attributes
    ----------
    units
        Units of the whole part.
    size
        "coarse", "default", "fine" or the longest element edge [m].
    symmetry
        "whole" or "half" (x >= 0).
    servos, servo_centres, servo_length, servo_place
        As in `CurlBuilder`, over the full section of the spine; no floor stays of a unit in the
        way of a servo, for no chambers lie below.
    air_paths
        Whether the chambers of a row are joined.
    spine_height
        Height of the spine [m], or None for the rows' full width b.
    turning
        Dimensions of the rows.
    """

    units: int = 18
    size: str | float = "default"
    symmetry: str = "half"
    servos: bool = False
    servo_centres: tuple[float, ...] | None = None
    servo_length: float = 0.045
    servo_place: str = "limit_layer"
    air_paths: bool = True
    spine_height: float | None = None
    turning: PneumaticNetwork = TURNING

    def __post_init__(self) -> None:
        check_units(self.units)
        _check_servo_place(self.servo_place)
        if self.symmetry == "quarter":
            raise InputError(
                "symmetry must be whole or half: one side is inflated, so the turning part is "
                "not symmetric in y",
                "mesh.symmetry",
            )
        r = self.turning
        _less("t of turning", 0.0, r.limit_layer, "> 0")
        if self.spine_height is not None:
            # The spine must cover the chambers' open side, or their air would leak out.
            inner = r.network_width - 2 * r.outer_wall
            if not inner - _CLOSE <= self.spine_height <= r.network_width + _CLOSE:
                raise InputError(
                    f"b - 2 g <= spine_height <= b: {self.spine_height * 1e3:g} mm is not within "
                    f"{inner * 1e3:g} to {r.network_width * 1e3:g} mm",
                    "mesh.spine_height",
                )

    @property
    def length(self) -> float:
        """Length of the whole part [m]."""
        return self.units * self.turning.pitch

    @property
    def _spine(self) -> float:
        return self.turning.network_width if self.spine_height is None else self.spine_height

    def turning_row(self) -> PneumaticNetwork:
        """The rows' dimensions."""
        return self.turning

    def row(self) -> UnitRow:
        """Half a unit as painted boxes."""
        r = _built(self.turning, self.air_paths)
        p, width = r.pitch / 2, r.limit_layer / 2
        middle, high = r.network_width / 2, self._spine / 2
        boxes = [
            Box((0, p), (0, width), (middle - high, middle + high), "limit_layer"),
            *_turn_boxes(r, width, 0.0),
        ]
        walls_y = (
            (width + r.air_path, width + r.connection_thickness),
            (width, width + r.connection_thickness),
            (width + r.chamber_height, width + r.chamber_height + r.top_wall),
        )
        b, g = r.network_width, r.outer_wall
        walls_x = ((r.chamber_length / 2, r.outer_length / 2),)
        walls = (walls_x, walls_y, ((0.0, g), (b - g, b)))
        return _with_slots(UnitRow(tuple(boxes), walls, int(self.units)), self, 0.0)

    def build(self) -> TaggedMesh:
        """Mesh the part with Gmsh."""
        sizing, servos = check_size(self.size, _TURN_SIZES), _stations(self)
        return build_row(self.row(), self.symmetry, sizing, ("limit_layer",), servos).mesh

    def expected_volume(self) -> float:
        """Closed-form volume of the modelled solid, servo stations included [m3]."""
        r = _built(self.turning, self.air_paths)
        out = r.chamber_height + r.top_wall
        unit = r.pitch * r.limit_layer * self._spine + 2 * r.network_width * (
            r.outer_length * out + r.gap * r.connection_thickness
        )
        servos, less_air = _slot_volumes(self, check_size(self.size, _TURN_SIZES))
        whole = self.units * unit + 2 * (servos - less_air - r.cavity_volume(self.units))
        return whole * symmetry_fraction(self.symmetry)

    def expected_cavity_volumes(self) -> dict[str, float]:
        """Closed-form air volume of each modelled cavity [m3]."""
        less_air = _slot_volumes(self, check_size(self.size, _TURN_SIZES))[1]
        volume = _built(self.turning, self.air_paths).cavity_volume(self.units) + less_air
        return _modelled(_turn_cavities(volume), self.symmetry)
