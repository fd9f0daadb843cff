"""The mesh builders a case can name.

Each builder is a frozen dataclass of options in SI with `build()`, `expected_volume()` and
`expected_cavity_volumes()`; its fields are the keys of a case's ``[mesh]`` table.

Groups every builder writes
---------------------------
Cells: "silicone" and "servo_0", "servo_1", ... carry a material and together are the whole
mesh; "limit_layer", "main", "assistant" and "turn" overlap them and only help to name places,
as does "housing", the servos' blocks with ``servo_place = "turning_rows"``.

Facets: "cavity_*"; "symmetry_x", "symmetry_y"; "end" (x = xmax) and "end_left"; "underside",
"top"; "side_left", "side_right"; "chamber_faces" (every facet at a gap, its floor included) and
the same per row, "chamber_faces_main" ... (the room beside a servo in the turning rows is a gap
too, so the sides of the servo that look along x are among them); "chamber_faces_symmetry_x", those
at the half gap whose other half is the mirror image; "end_spine", the part of "end" that belongs
to the limit layer (the probe of the bending angle); "servo_faces", the exterior facets of the
servo stations if there are any; "outer", every exterior facet that is neither in a cavity nor on a
symmetry plane.

Cavities: "cavity_main" of "pneunet"; "cavity_turn_left" and "cavity_turn_right" of "turn". "curl"
has these two beside "cavity_curl", the air of main and assistant chambers together; with
``assistant_feed = "row"`` that is "cavity_main", "cavity_assistant_left" and
"cavity_assistant_right" instead. A quarter has no left ones.

"ring" has none of these but "silicone"; `flexapod.geometry.ring` names its four surfaces.
"""

from __future__ import annotations

from typing import Protocol

from flexapod.geometry.hexapod import CurlBuilder, TurnBuilder
from flexapod.geometry.pneunet import PneunetBuilder
from flexapod.geometry.ring import RingBuilder
from flexapod.geometry.tagged import TaggedMesh


class Builder(Protocol):
    """What a mesh builder offers; its own options are dataclass fields."""

    def build(self) -> TaggedMesh:
        """Mesh the body with Gmsh."""
        ...

    def expected_volume(self) -> float:
        """Closed-form volume of the modelled solid [m3]."""
        ...

    def expected_cavity_volumes(self) -> dict[str, float]:
        """Closed-form air volume of each modelled cavity [m3]."""
        ...


BUILDERS: dict[
    str, type[PneunetBuilder] | type[CurlBuilder] | type[TurnBuilder] | type[RingBuilder]
] = {
    "pneunet": PneunetBuilder,
    "curl": CurlBuilder,
    "turn": TurnBuilder,
    "ring": RingBuilder,
}
