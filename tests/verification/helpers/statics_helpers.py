"""Small structured meshes, supports and one-call solutions for the tests of statics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from flexapod.core.errors import Status
from flexapod.fem.body import SolidBody
from flexapod.fem.contacts import Contact
from flexapod.fem.loads import Displacement, Load
from flexapod.fem.newton import NewtonOptions
from flexapod.fem.static import LoadStep, PathOptions, StaticProblem, solve_path
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import HyperelasticLaw, SolidMaterial

Map = Callable[[np.ndarray], np.ndarray]

# Newton to round-off, so that only the discretisation is left to compare with mathematics.
TIGHT = NewtonOptions(residual_tolerance=1e-9, increment_tolerance=1e-9, max_iterations=40)

_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def grid(counts: tuple[int, int, int], mapping: Map | None = None) -> TaggedMesh:
    """The unit cube in nx x ny x nz hexahedra, its nodes sent through `mapping`.

    The six sides are named x0, x1, y0, y1, z0, z1 after the unit cube.
    """
    nx, ny, nz = counts
    axes = [np.linspace(0.0, 1.0, n + 1) for n in counts]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(x)).reshape(nx + 1, ny + 1, nz + 1)
    cells = np.stack(
        [number[a : nx + a, b : ny + b, c : nz + c].ravel() for a, b, c in _CORNERS], axis=1
    )
    mesh = TaggedMesh(x if mapping is None else mapping(x), cells)
    for axis, name in enumerate("xyz"):
        for end in (0, 1):
            side = np.take(number, -end, axis=axis)
            quads = np.stack(
                [side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]], axis=-1
            ).reshape(-1, 4)
            mesh = mesh.with_facet_group(f"{name}{end}", quads)
    return mesh


def distorted(counts: tuple[int, int, int], shake: float = 0.2, seed: int = 1) -> TaggedMesh:
    """The unit cube with its inner nodes moved by up to `shake` of a cell."""

    def move(x: np.ndarray) -> np.ndarray:
        inner = ((x > 1e-9) & (x < 1.0 - 1e-9)).all(axis=1)
        out = x.copy()
        random = np.random.default_rng(seed).uniform(-shake, shake, x.shape) / np.array(counts)
        out[inner] += random[inner]
        return out

    return grid(counts, move)


def merged(meshes: Sequence[TaggedMesh], decimals: int = 9) -> TaggedMesh:
    """Several meshes as one, nodes at the same place joined; groups of one name united."""
    nodes = np.concatenate([m.nodes for m in meshes])
    _, first, number = np.unique(
        np.round(nodes, decimals), axis=0, return_index=True, return_inverse=True
    )
    number = number.ravel()
    start = np.cumsum([0] + [len(m.nodes) for m in meshes])
    cells = np.concatenate([number[m.cells + s] for m, s in zip(meshes, start, strict=False)])
    out = TaggedMesh(nodes[first], cells)
    for name in sorted({n for m in meshes for n in m.facet_groups}):
        quads = [
            number[m.facet_groups[name] + s]
            for m, s in zip(meshes, start, strict=False)
            if name in m.facet_groups
        ]
        out = out.with_facet_group(name, np.concatenate(quads))
    return out


def sphere_octant(inner: float, outer: float, around: int, through: int) -> TaggedMesh:
    """An eighth of a thick sphere from the three quarter faces of a cube.

    Groups: "cavity" (inside), "outside", and the planes of symmetry "sx", "sy", "sz".
    """
    parts = []
    for axis in range(3):

        def ball(t: np.ndarray, axis: int = axis) -> np.ndarray:
            a = np.tan(0.25 * np.pi * t[:, :2])
            d = np.stack([a[:, 0], a[:, 1], np.ones(len(t))], axis=1)
            d /= np.linalg.norm(d, axis=1)[:, None]
            r = inner + (outer - inner) * t[:, 2]
            return np.asarray(np.roll(d, axis + 1, axis=1) * r[:, None])

        part = grid((around, around, through), ball)
        one, two = "xyz"[(axis + 1) % 3], "xyz"[(axis + 2) % 3]
        old = part.facet_groups
        new = {
            "cavity": old["z0"],
            "outside": old["z1"],
            f"s{one}": old["x0"],
            f"s{two}": old["y0"],
        }
        parts.append(TaggedMesh(part.nodes, part.cells, {}, new))
    return merged(parts)


def solid(
    mesh: TaggedMesh, law: HyperelasticLaw, poisson: float = 0.499, density: float = 1000.0
) -> SolidBody:
    """A body of one material."""
    return SolidBody(mesh, {"*": SolidMaterial(law, density, poisson)})


def hold(mesh: TaggedMesh, **sides: str) -> list[Displacement]:
    """Supports: ``hold(mesh, x0="x", z0="xyz")`` fixes those axes on those sides."""
    return [
        Displacement(f"hold {side}", mesh.facet_nodes(side), "xyz".index(axis))
        for side, axes in sides.items()
        for axis in axes
    ]


def affine(name: str, mesh: TaggedMesh, nodes: Iterable[int], g: np.ndarray) -> list[Displacement]:
    """Prescribe ``u = g x`` on `nodes`."""
    return [
        Displacement(name, np.array([node]), axis, float(g[axis] @ mesh.nodes[node]))
        for node in nodes
        for axis in range(3)
    ]


def boundary_nodes(mesh: TaggedMesh) -> np.ndarray:
    """Nodes on any of the six sides of a `grid`."""
    return np.unique(np.concatenate([mesh.facet_nodes(s) for s in mesh.facet_groups]))


def deformation(body: SolidBody, u: np.ndarray) -> np.ndarray:
    """F at every Gauss point, shape (cell_count, 8, 3, 3)."""
    return np.asarray(np.eye(3) + np.einsum("eai,eqaj->eqij", u[body.cells], body.gradients))


def solve(
    body: SolidBody,
    displacements: Sequence[Displacement],
    loads: Sequence[Load] = (),
    factors: Mapping[str, float] | None = None,
    contacts: Sequence[Contact] = (),
    first: float = 0.5,
    newton: NewtonOptions = TIGHT,
) -> tuple[np.ndarray, StaticProblem]:
    """Load everything to `factors` (all to 1 by default) and return the displacements."""
    problem = StaticProblem(body, displacements, loads, contacts)
    goal = dict(factors or dict.fromkeys(problem.load_names, 1.0))
    result = solve_path(problem, [LoadStep("load", goal, first=first)], PathOptions(newton=newton))
    assert result.status is Status.DONE, result.message
    return result.state.u, problem


def side_force(
    problem: StaticProblem, u: np.ndarray, factors: Mapping[str, float], nodes: np.ndarray
) -> np.ndarray:
    """What the supports exert on `nodes` [N], shape (3,)."""
    return np.asarray(problem.reactions(u, factors)[nodes].sum(axis=0))


def error(got: float, expected: float, unit: str = "", what: str = "") -> float:
    """Relative error, printed with both numbers so that a failure shows them."""
    value = abs(got - expected) / abs(expected)
    print(f"{what}: got {got:.8g} {unit}, expected {expected:.8g} {unit}, error {value:.2e}")
    return value
