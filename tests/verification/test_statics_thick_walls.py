"""Thick sphere and thick tube under internal pressure against quadrature.

Incompressible, so the geometry follows from the inner radius a alone: r**3 = R**3 + a**3 - A**3
(sphere), r**2 = R**2 + a**2 - A**2 (tube in plane strain), and radial equilibrium
d(sigma_r)/dr = k (sigma_t - sigma_r)/r, k = 2 or 1, gives

    p = integral over A..B of k (sigma_t - sigma_r)/r (dr/dR) dR,

with hoop stretch l = r/R and sigma_t - sigma_r = sum mu (l**alpha - l**-(2 alpha)) for the
sphere, sum mu (l**alpha - l**-alpha) for the tube (R. W. Ogden, Non-Linear Elastic Deformations,
1984, sections 5.3.2 and 5.3.3). Three-term Ogden, the paper's Dragon Skin 20.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from statics_helpers import error, grid, hold, solid, solve, sphere_octant

from flexapod.fem.loads import Cavity, CavityPressure
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.library import load_material
from flexapod.materials.ogden import Ogden

INNER, OUTER = 1.0, 2.0  # [m]
POISSON = 0.4999
LAW = load_material("dragon-skin-20-sospider").law
assert isinstance(LAW, Ogden)
MU, ALPHA = np.array(LAW.mu), np.array(LAW.alpha)


def pressure(inner: float, shape: str) -> float:
    """Pressure [Pa] that opens the inner radius to `inner` [m]."""
    power, other, count = (3, -2.0, 2.0) if shape == "sphere" else (2, -1.0, 1.0)

    def slope(big: float) -> float:
        small = (big**power + inner**power - INNER**power) ** (1.0 / power)
        l = small / big  # noqa: E741
        difference = float((MU * (l**ALPHA - l ** (other * ALPHA))).sum())
        return count * difference / small * (big / small) ** (power - 1)

    return float(quad(slope, INNER, OUTER, epsrel=1e-12)[0])


def tube_quarter(around: int, through: int) -> TaggedMesh:
    def bend(t: np.ndarray) -> np.ndarray:
        r = INNER + (OUTER - INNER) * t[:, 0]
        angle = 0.5 * np.pi * t[:, 1]
        return np.stack([r * np.cos(angle), r * np.sin(angle), 0.3 * t[:, 2]], axis=1)

    return grid((through, around, 1), bend)


def _opening(shape: str, size: int, inner: float) -> tuple[float, float]:
    """Growth of the mean inner radius [m] and of the cavity (volume ratio) of the mesh."""
    if shape == "sphere":
        mesh = sphere_octant(INNER, OUTER, size, size)
        supports, inside = hold(mesh, sx="x", sy="y", sz="z"), "cavity"
    else:
        mesh = tube_quarter(2 * size, size)
        supports, inside = hold(mesh, y0="y", y1="x", z0="z", z1="z"), "x0"
    faces = mesh.facet_groups[inside]
    load = CavityPressure("p", faces, pressure(inner, shape))
    u, _ = solve(solid(mesh, LAW, POISSON), supports, [load], first=0.25)
    x = mesh.nodes + u
    across = 3 if shape == "sphere" else 2
    radius = np.linalg.norm(x[np.unique(faces)][:, :across], axis=1)
    cavity = Cavity("c", faces)
    growth = cavity.volume(x) / cavity.volume(mesh.nodes) if shape == "sphere" else np.nan
    return float(radius.mean()) - INNER, growth


# Shape, inner radius to reach, and the errors measured with 2, 4 and 8 cells through the wall.
CASES = [
    ("sphere", 1.25, (1.42e-1, 3.54e-2, 8.6e-3)),
    ("sphere", 1.5, (6.1e-2, 1.20e-2, 2.6e-3)),
    ("tube", 1.25, (4.2e-2, 1.05e-2, 2.6e-3)),
    ("tube", 1.6, (1.07e-2, 2.0e-3, 3.5e-4)),
]


@pytest.mark.parametrize(("shape", "inner", "baseline"), CASES)
def test_opening_against_quadrature_and_its_convergence(
    shape: str, inner: float, baseline: tuple[float, ...]
) -> None:
    expected = inner - INNER
    openings = [_opening(shape, n, inner) for n in (2, 4, 8)]
    errors = [error(o[0], expected, "m", f"{shape} {inner}") for o in openings]
    # Discretisation: the measured baseline with a margin of a tenth.
    assert np.all(np.array(errors) < 1.1 * np.array(baseline))
    order = np.log2(errors[1] / errors[2])
    print(f"order {order:.2f}")
    # Linear elements: second order (the nearly incompressible part, 2e-4, is below it).
    assert order > 1.9
    # Extrapolated with order two to h = 0, what is left is compressibility and the next order.
    limit = (4.0 * openings[2][0] - openings[1][0]) / 3.0
    assert error(limit, expected, "m", "extrapolated") < 2e-3
    if shape == "sphere":
        assert error(openings[2][1], (inner / INNER) ** 3, "", "cavity's growth") < 1e-2


def test_wall_keeps_its_volume() -> None:
    # nu = 0.4999: the wall's change of volume is p/kappa at most (1e-4).
    mesh = tube_quarter(8, 4)
    body = solid(mesh, LAW, POISSON)
    p = pressure(1.6, "tube")
    load = CavityPressure("p", mesh.facet_groups["x0"], p)
    u, _ = solve(body, hold(mesh, y0="y", y1="x", z0="z", z1="z"), [load], first=0.25)
    stretched = body.fields(u).principal_stretches.prod(axis=1)
    assert np.abs(stretched - 1.0).max() < 5e-3
    after = solid(mesh.with_nodes(mesh.nodes + u), LAW).cell_volume.sum()
    change = after / body.cell_volume.sum() - 1.0
    print(f"change of volume {change:.2e}, p/kappa {p / body.materials[0].bulk_modulus:.2e}")
    assert abs(change) < p / body.materials[0].bulk_modulus
