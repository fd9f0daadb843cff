"""`SolidBody`: what it refuses, lumping, and the fields of a homogeneous state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from statics_helpers import distorted, grid, solid

from flexapod.core.errors import InputError
from flexapod.fem.body import SolidBody, skfem_corner_order
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke

SOFT = SolidMaterial(NeoHooke(1e5), 1000.0, 0.49)
HARD = SolidMaterial(NeoHooke(1e7), 2000.0, 0.3)


def two_groups() -> TaggedMesh:
    return grid((2, 1, 1)).with_cell_group("left", np.array([0])).with_cell_group("all", [0, 1])


def test_unknown_group_is_named_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"unknown cell group 'right'.*all, left"):
        SolidBody(two_groups(), {"right": SOFT, "*": HARD})


def test_cell_without_material_and_cell_with_two() -> None:
    with pytest.raises(InputError, match="1 cells have no material"):
        SolidBody(two_groups(), {"left": SOFT})
    with pytest.raises(InputError, match="cell 0 is given two materials"):
        SolidBody(two_groups(), {"left": SOFT, "all": HARD})


def test_flipped_cell_is_refused() -> None:
    mesh = grid((2, 1, 1))
    turned = mesh.cells.copy()
    turned[1] = turned[1][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(InputError, match="cell 1 is flipped"):
        solid(TaggedMesh(mesh.nodes, turned), SOFT.law)


def test_flat_cell_is_refused() -> None:
    mesh = grid((2, 1, 1))
    flat = mesh.nodes * [1.0, 1.0, 0.0]
    with pytest.raises(InputError, match="cell 0 is flipped or flat"):
        solid(TaggedMesh(flat, mesh.cells), SOFT.law)
    # The second cell alone: its far side lies on its near side.
    one = mesh.nodes.copy()
    one[np.isclose(one[:, 0], 1.0), 0] = 0.5
    with pytest.raises(InputError, match="cell 1 is flipped or flat"):
        solid(TaggedMesh(one, mesh.cells), SOFT.law)


def test_loose_node_is_refused() -> None:
    mesh = grid((1, 1, 1))
    nodes = np.vstack([mesh.nodes, [5.0, 5.0, 5.0]])
    with pytest.raises(InputError, match="node 8 belongs to no cell"):
        solid(TaggedMesh(nodes, mesh.cells), SOFT.law)


def test_star_takes_the_rest_and_masses_follow() -> None:
    body = SolidBody(two_groups(), {"*": SOFT, "left": HARD})
    assert body.material.tolist() == [1, 0]
    # Volumes 1/2 each: exact for boxes.
    np.testing.assert_allclose(body.cell_volume, 0.5, rtol=1e-14)
    assert body.node_volume.sum() == pytest.approx(1.0, rel=1e-14)
    assert body.node_mass.sum() == pytest.approx(0.5 * 1000.0 + 0.5 * 2000.0, rel=1e-14)
    # The shared side carries an eighth of both cells.
    shared = body.node_mass[np.isclose(body.nodes[:, 0], 0.5)]
    np.testing.assert_allclose(shared, 0.5 * (1000.0 + 2000.0) / 8.0, rtol=1e-14)


def test_bulk_modulus_is_shared_between_mean_and_points() -> None:
    body = SolidBody(two_groups(), {"*": SOFT, "left": HARD})
    np.testing.assert_allclose(
        body.kappa + body.kappa_point, [SOFT.bulk_modulus, HARD.bulk_modulus], rtol=1e-14
    )
    assert np.all(body.kappa_point <= body.kappa * (1.0 + 1e-12))


def test_gradients_differentiate_linear_functions_exactly() -> None:
    body = solid(distorted((2, 2, 2)), SOFT.law)
    f = body.nodes @ np.array([2.0, -3.0, 0.5]) + 7.0
    slope = np.einsum("ea,eqaj->eqj", f[body.cells], body.gradients)
    np.testing.assert_allclose(slope, np.broadcast_to([2.0, -3.0, 0.5], slope.shape), atol=1e-13)
    assert body.weights.sum() == pytest.approx(1.0, rel=1e-14)


def test_corner_order_is_a_permutation_that_keeps_skfem_volumes() -> None:
    assert sorted(skfem_corner_order()) == list(range(8))
    body = solid(distorted((2, 2, 2)), SOFT.law)
    # The same cells as scikit-fem sees them have positive Jacobians.
    mapping = body.skfem_mesh.mapping()
    assert (mapping.detDF(np.full((3, 1), 0.5)) > 0.0).all()


def test_fields_of_a_homogeneous_state() -> None:
    # Neo-Hooke: sigma = G J**(-5/3) dev(B) + kappa/2 (J - 1/J) I, rotated with the body.
    body = solid(distorted((2, 2, 2)), SOFT.law, 0.49)
    shear, kappa = 1e5, body.materials[0].bulk_modulus
    stretch = np.diag([1.4, 0.9, 0.82])
    r = Rotation.from_rotvec([0.5, -0.3, 0.9]).as_matrix()
    f = r @ stretch
    fields = body.fields(body.nodes @ (f - np.eye(3)).T)
    j = np.linalg.det(f)
    b = f @ f.T
    sigma = shear * j ** (-5.0 / 3.0) * (b - np.trace(b) / 3.0 * np.eye(3))
    sigma += 0.5 * kappa * (j - 1.0 / j) * np.eye(3)
    scale = np.abs(sigma).max()
    # Round-off, measured 2e-14.
    expected = np.broadcast_to(sigma, (8, 3, 3))
    np.testing.assert_allclose(fields.cauchy_stress, expected, atol=1e-12 * scale)
    np.testing.assert_allclose(fields.pressure, -np.trace(sigma) / 3.0, rtol=1e-11)
    principal = np.broadcast_to([1.4, 0.9, 0.82], (8, 3))
    np.testing.assert_allclose(fields.principal_stretches, principal, rtol=1e-12)
    np.testing.assert_allclose(fields.log_stretches[3, 5], np.log([1.4, 0.9, 0.82]), atol=1e-13)


def test_element_inside_out_has_infinite_energy_and_is_named() -> None:
    body = solid(grid((3, 1, 1)), SOFT.law)
    u = np.zeros_like(body.nodes)
    u[np.isclose(body.nodes[:, 0], 1.0), 0] = -0.5
    force = np.empty_like(u)
    assert body.internal_force(u, force) == np.inf
    assert int(np.argmin(body.least_j)) == 2
    assert body.least_j[2] < 0.0
    assert np.isfinite(body.internal_force(0.0 * u, force))
