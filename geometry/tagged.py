"""The mesh record every floor shares: nodes, hexahedra and their names."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

# Corner quadruples of a hexahedron's six faces in VTK/Gmsh node order, counter-clockwise
# seen from outside.
HEX_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)


@dataclass(frozen=True)
class TaggedMesh:
    """Eight-node hexahedra with named groups; a change makes a copy.

    Attributes
    ----------
    nodes
        Node positions [m], shape (node_count, 3).
    cells
        Hexahedra in VTK/Gmsh corner order, shape (cell_count, 8).
    cell_groups
        Name to cell indices. Groups that carry a material do not overlap.
    facet_groups
        Name to corner quadruples, shape (facet_count, 4), each counter-clockwise seen from
        outside the solid (the normal points out of the material, into a cavity for a cavity).
    cavities
        The names in `facet_groups` that enclose air.
    """

    nodes: np.ndarray
    cells: np.ndarray
    cell_groups: dict[str, np.ndarray] = field(default_factory=dict)
    facet_groups: dict[str, np.ndarray] = field(default_factory=dict)
    cavities: tuple[str, ...] = ()
