"""Reflection: a symmetric problem solved whole is its own mirror image and equals its half.

Both hold exactly for the discrete equations on a mirrored mesh; what is left is Newton's
tolerance (1e-9) and the round-off of sums taken in another order.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from statics_helpers import grid, hold, solid, solve

from flexapod.contact.law import ContactLaw
from flexapod.fem.contacts import PlaneContact
from flexapod.fem.loads import CavityPressure, Displacement, gravity
from flexapod.geometry.tagged import TaggedMesh, boundary_facets
from flexapod.materials.library import load_material

LAW = load_material("dragon-skin-20-sospider").law
PRESSURE = 2e4  # [Pa]
SIZE = np.array([0.06, 0.02, 0.02])  # [m]


def _box(half: bool) -> TaggedMesh:
    """A closed box (8 x 4 x 4 cells, its middle hollow) on the ground, or its half x <= 0."""
    counts = (4, 4, 4) if half else (8, 4, 4)

    def place(t: np.ndarray) -> np.ndarray:
        x = t - [0.5, 0.5, 0.0]
        if half:
            x[:, 0] = 0.5 * t[:, 0] - 0.5
        # Unequal, mirrored cells: walls thinner towards the middle.
        x[:, 0] = np.sign(x[:, 0]) * np.abs(x[:, 0]) ** 0.9
        return np.asarray(x * SIZE)

    mesh = grid(counts, place)
    index = np.arange(len(mesh.cells)).reshape(counts)
    solid_cells = np.ones(counts, dtype=bool)
    solid_cells[(slice(1, None) if half else slice(1, -1)), 1:3, 1:3] = False
    cells = mesh.cells[index[solid_cells]]
    used = np.unique(cells)
    number = np.full(len(mesh.nodes), -1)
    number[used] = np.arange(len(used))
    out = TaggedMesh(mesh.nodes[used], number[cells])
    quads = boundary_facets(out.cells)
    middle = out.nodes[quads].mean(axis=1)
    plane = np.abs(out.nodes[quads][:, :, 0]).max(axis=1) < 1e-12
    across = np.abs(middle[:, 1:] - [0.0, 0.5 * SIZE[2]])
    inner = (across < 0.26 * SIZE[1:]).all(axis=1)
    ends = np.abs(middle[:, 0]) > 0.5**0.9 * SIZE[0] - 1e-9
    bottom = np.abs(middle[:, 2]) < 1e-9
    out = out.with_facet_group("cavity", quads[inner & ~ends & ~plane])
    out = out.with_facet_group("bottom", quads[bottom])
    return out.with_facet_group("ends", quads[ends])


def _solved(half: bool) -> tuple[np.ndarray, np.ndarray]:
    mesh = _box(half)
    body = solid(mesh, LAW)
    ground = PlaneContact(
        "ground", mesh.nodes, mesh.facet_groups["bottom"], (0, 0, 1e-5), (0, 0, 1), ContactLaw(1e3)
    )
    loads = [
        gravity("gravity", body.node_mass, (0.0, 0.0, -9.81)),
        CavityPressure("p", mesh.facet_groups["cavity"], PRESSURE),
    ]
    supports = hold(mesh, ends="xyz")
    if half:
        nodes = np.flatnonzero(np.abs(mesh.nodes[:, 0]) < 1e-12)
        supports.append(Displacement("symmetry", nodes, 0))
    u, _ = solve(body, supports, loads, contacts=[ground], first=0.25)
    return mesh.nodes, u


def test_whole_is_its_own_mirror_and_equals_the_half() -> None:
    nodes, u = _solved(half=False)
    size = np.abs(u).max()
    print(f"largest displacement {size:.3e} m")
    assert size > 1e-3  # a large deformation: a tenth of the height
    mirror = np.array([-1.0, 1.0, 1.0])
    distance, twin = cKDTree(nodes).query(nodes * mirror)
    assert distance.max() < 1e-12
    skew = np.abs(u[twin] * mirror - u).max() / size
    half_nodes, v = _solved(half=True)
    distance, same = cKDTree(nodes).query(half_nodes)
    assert distance.max() < 1e-12
    off = np.abs(u[same] - v).max() / size
    print(f"mirror {skew:.2e}, half against whole {off:.2e}")
    assert skew < 1e-8
    assert off < 1e-8
