"""Homogeneous tests of each law with distorted cells against the incompressible curves.

Expected: nominal stress of `flexapod.materials.modes` (themselves checked against closed forms
in test_laws.py). The body is nearly incompressible: with bulk modulus kappa the volume ratio is
J = 1 + O(P/kappa), so the stress is off by O(G/kappa) = O(1 - 2 nu) and falls tenfold from
nu = 0.499 to 0.4999.
"""

from __future__ import annotations

import numpy as np
import pytest
from statics_helpers import (
    affine,
    boundary_nodes,
    deformation,
    distorted,
    error,
    hold,
    side_force,
    solid,
    solve,
)

from flexapod.fem.loads import Displacement
from flexapod.materials import modes
from flexapod.materials.law import HyperelasticLaw
from flexapod.materials.mooney_rivlin import MooneyRivlin
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.yeoh import Yeoh

LAWS: list[HyperelasticLaw] = [
    Ogden((-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285)),
    NeoHooke(4e5),
    MooneyRivlin(1.5e5, 0.3e5),
    Yeoh(1.1e5, 0.2e5, 0.4e3),
]
STRETCH = {"uniaxial": 2.0, "equibiaxial": 1.6, "planar": 1.8}


def _nominal(law: HyperelasticLaw, mode: str, poisson: float) -> float:
    mesh = distorted((2, 2, 2))
    body = solid(mesh, law, poisson)
    pull = STRETCH[mode] - 1.0
    parts = hold(mesh, x0="x", y0="y", z0="z")
    parts.append(Displacement("pull", mesh.facet_nodes("x1"), 0, pull))
    if mode == "equibiaxial":
        parts.append(Displacement("pull", mesh.facet_nodes("y1"), 1, pull))
    if mode == "planar":
        parts += hold(mesh, y1="y")
    u, problem = solve(body, parts, first=0.25)
    # The free sides stay flat: the deformation is homogeneous to round-off.
    f = deformation(body, u)
    assert np.abs(f - f[0, 0]).max() < 1e-8
    return float(side_force(problem, u, {"pull": 1.0}, mesh.facet_nodes("x1"))[0])


@pytest.mark.parametrize("mode", list(STRETCH))
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_nominal_stress_of_each_mode(law: HyperelasticLaw, mode: str) -> None:
    expected = float(modes.nominal_stress(law, mode, np.array([STRETCH[mode]]))[0])
    errors = [
        error(_nominal(law, mode, nu), expected, "Pa", f"{law.name} {mode} nu {nu}")
        for nu in (0.499, 0.4999)
    ]
    # Measured at 0.4999: 1.7e-4 to 1.2e-3 (docs/verification.md); bound 10 (1 - 2 nu) = 2e-3.
    assert errors[1] < 2e-3
    # First order in 1 - 2 nu: a tenth, measured 0.1005 to 0.1025.
    assert errors[1] / errors[0] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("gamma", [-0.6, 0.2, 1.5])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_simple_shear(law: HyperelasticLaw, gamma: float) -> None:
    # x = X + gamma Y keeps the volume, so the near-incompressible stress is the incompressible
    # one to round-off, and sigma_xx - sigma_yy = gamma sigma_xy for any isotropic law (Rivlin's
    # universal relation).
    mesh = distorted((2, 2, 2))
    body = solid(mesh, law)
    g = np.zeros((3, 3))
    g[0, 1] = gamma
    u, problem = solve(body, affine("shear", mesh, boundary_nodes(mesh), g), first=0.25)
    expected = float(modes.shear_stress(law, np.array([gamma]))[0])
    stress = body.fields(u).cauchy_stress
    scale = abs(expected)
    # Round-off of J times kappa: measured 2e-11 of the stress; margin 50.
    np.testing.assert_allclose(stress[:, 0, 1], expected, atol=1e-9 * scale)
    np.testing.assert_allclose(
        stress[:, 0, 0] - stress[:, 1, 1], gamma * expected, atol=1e-9 * scale
    )
    # The force on the sheared face is the nominal stress P_xy = sigma_xy (J = 1).
    top = np.setdiff1d(mesh.facet_nodes("y1"), [])
    force = problem.reactions(u, {"shear": 1.0})[top]
    inside = (mesh.nodes[top][:, [0, 2]] > 1e-9).all(axis=1) & (
        mesh.nodes[top][:, [0, 2]] < 1 - 1e-9
    ).all(axis=1)
    # An inner node of the 2x2 face carries a quarter of it.
    assert force[inside][0, 0] == pytest.approx(0.25 * expected, rel=1e-9)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_volume_change_under_hydrostatic_pull(law: HyperelasticLaw) -> None:
    # F = s I: sigma = dU/dJ = kappa/2 (J - 1/J), no isochoric stress.
    mesh = distorted((2, 2, 2))
    body = solid(mesh, law)
    s = 1.01
    fields = body.fields((s - 1.0) * mesh.nodes)
    kappa = body.materials[0].bulk_modulus
    expected = 0.5 * kappa * (s**3 - s**-3)
    # Round-off: measured 1e-13.
    np.testing.assert_allclose(
        fields.cauchy_stress,
        np.broadcast_to(expected * np.eye(3), (8, 3, 3)),
        atol=1e-11 * expected,
    )
    np.testing.assert_allclose(fields.pressure, -expected, rtol=1e-11)
    np.testing.assert_allclose(fields.principal_stretches, s, rtol=1e-12)
