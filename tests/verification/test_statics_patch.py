"""Patch test, equilibrium and rigid rotation of the hexahedra.

Patch test (B. M. Irons & A. Razzaque 1972; R. L. Taylor et al. 1986, doi:10.1002/nme.1620220105):
a linear displacement on the boundary of distorted cells gives the same F everywhere. All
tolerances are round-off: the identities hold exactly, and Newton ends at machine precision.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from statics_helpers import affine, boundary_nodes, deformation, distorted, solid, solve

from flexapod.fem.body import SolidBody
from flexapod.materials.law import HyperelasticLaw, SolidMaterial
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
# A general gradient of displacement: stretch, shear and rotation, J = 1.07.
GRADIENT = np.array([[0.25, 0.20, -0.05], [-0.10, -0.12, 0.15], [0.05, 0.10, -0.05]])


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("poisson", [0.3, 0.499])
def test_linear_displacement_gives_homogeneous_deformation(
    law: HyperelasticLaw, poisson: float
) -> None:
    # u = G x on the boundary => F = I + G in every cell.
    mesh = distorted((3, 3, 3))
    body = solid(mesh, law, poisson)
    u, _ = solve(body, affine("pull", mesh, boundary_nodes(mesh), GRADIENT), first=0.25)
    worst = np.abs(deformation(body, u) - np.eye(3) - GRADIENT).max()
    # Measured 7e-15 (round-off of the solution); the last correction of Newton may leave more.
    assert worst < 1e-12, f"F off by {worst:.2e}, expected 0"


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_homogeneous_state_is_in_equilibrium(law: HyperelasticLaw) -> None:
    # div P = 0 for constant P: no force on inner nodes, and the boundary's forces balance in
    # force and moment.
    mesh = distorted((3, 3, 3), seed=2)
    body = solid(mesh, law)
    u = mesh.nodes @ GRADIENT.T
    force = np.empty_like(u)
    energy = body.internal_force(u, force)
    inner = np.setdiff1d(np.arange(len(u)), boundary_nodes(mesh))
    scale = np.abs(force).max()
    # Round-off: measured 8e-15 of the largest nodal force (sum of 8 cells); margin 10.
    assert np.abs(force[inner]).max() < 1e-13 * scale
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * scale
    assert np.abs(np.cross(mesh.nodes + u, force).sum(axis=0)).max() < 1e-13 * scale
    # Energy of a homogeneous state is that of one cube: the mesh must not matter.
    coarse = solid(distorted((1, 1, 1)), law)
    v = coarse.nodes @ GRADIENT.T
    expected = coarse.internal_force(v, np.empty_like(v))
    assert energy == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_rigid_motion_gives_no_stress(law: HyperelasticLaw) -> None:
    # F = R: W = 0 and no force, for rotations up to half a turn.
    mesh = distorted((2, 2, 2))
    body = solid(mesh, law)
    # A comparable elastic force: one per cent of stretch.
    stretched = np.empty_like(mesh.nodes)
    body.internal_force(0.01 * mesh.nodes * [1.0, 0.0, 0.0], stretched)
    scale = np.abs(stretched).max()
    for vector in ([0.3, -0.2, 0.1], [0.0, 0.0, 3.1], [1.0, 1.5, -2.0]):
        r = Rotation.from_rotvec(vector).as_matrix()
        u = mesh.nodes @ (r - np.eye(3)).T + np.array([3.0, -1.0, 2.0])
        force = np.empty_like(u)
        energy = body.internal_force(u, force)
        # Round-off of F (1e-15) times the bulk modulus (500 G) over 1 % strain: measured 2e-13.
        assert np.abs(force).max() < 1e-11 * scale
        assert abs(energy) < 1e-20 * scale
        assert np.abs(body.fields(u).cauchy_stress).max() < 1e-10 * law.shear_modulus


def test_rotated_state_has_rotated_force() -> None:
    # Objectivity: f(R x) = R f(x) at a large deformation.
    mesh = distorted((2, 2, 2))
    body = solid(mesh, LAWS[0])
    u = mesh.nodes @ GRADIENT.T + 0.02 * np.random.default_rng(0).standard_normal(mesh.nodes.shape)
    r = Rotation.from_rotvec([0.4, 1.2, -0.7]).as_matrix()
    turned = (mesh.nodes + u) @ r.T - mesh.nodes
    force, turned_force = np.empty_like(u), np.empty_like(u)
    body.internal_force(u, force)
    body.internal_force(turned, turned_force)
    np.testing.assert_allclose(turned_force, force @ r.T, atol=1e-11 * np.abs(force).max())


def test_two_materials_have_no_homogeneous_state() -> None:
    # The counter-check: with two stiffnesses in one cube the inner residual is as large as the
    # forces themselves, so the tests above can fail.
    mesh = distorted((3, 3, 3)).with_cell_group("hard", np.arange(9))
    hard, soft = SolidMaterial(NeoHooke(1e6), 1.0), SolidMaterial(NeoHooke(1e5), 1.0)
    body = SolidBody(mesh, {"hard": hard, "*": soft})
    force = np.empty_like(mesh.nodes)
    body.internal_force(mesh.nodes @ GRADIENT.T, force)
    inner = np.setdiff1d(np.arange(len(force)), boundary_nodes(mesh))
    assert np.abs(force[inner]).max() > 0.01 * np.abs(force).max()
