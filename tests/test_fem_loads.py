"""Loads, conditions and cavities."""

from __future__ import annotations

import numpy as np
import pytest
from statics_helpers import distorted, grid, solid

from flexapod.core.errors import InputError
from flexapod.fem.loads import (
    CavityPressure,
    Conditions,
    Displacement,
    face_node_areas,
    gravity,
    surface_force,
    traction,
)
from flexapod.materials.neo_hooke import NeoHooke


def test_conditions_refuse_two_movements_of_one_node() -> None:
    left = Displacement("left", np.array([0, 3]), 1, 1e-3)
    right = Displacement("right", np.array([3, 4]), 1, 2e-3)
    with pytest.raises(
        InputError, match=r"node 3 is moved along axis y by both 'left' and 'right'"
    ):
        Conditions(5, [left, right])
    # Another axis of the same node is free to take.
    Conditions(5, [left, Displacement("right", np.array([3]), 0, 2e-3)])


@pytest.mark.parametrize("first", ["hold", "pull"])
def test_conditions_refuse_a_support_that_is_also_moved(first: str) -> None:
    parts = [
        Displacement("hold", np.array([1, 3]), 1),
        Displacement("pull", np.array([4, 3]), 1, 1e-3),
    ]
    message = r"node 3 is held along axis y by 'hold' and moved by 'pull'; take it out of one"
    with pytest.raises(InputError, match=message):
        Conditions(5, parts if first == "hold" else parts[::-1])
    # Held along x and z, moved along y: the common case.
    Conditions(5, [Displacement("hold", np.array([3]), axis) for axis in (0, 2)] + parts[1:])


@pytest.mark.parametrize("other", [2e-3, -1e-3, 0.0])
def test_conditions_refuse_two_values_under_one_name(other: float) -> None:
    one, two = (Displacement("pull", np.array([3]), 1, v) for v in (1e-3, other))
    message = r"node 3 is given two displacements along axis y by 'pull': .*0\.001 m"
    for parts in ([one, two], [two, one]):
        with pytest.raises(InputError, match=message):
            Conditions(5, parts)


def test_conditions_accept_parts_that_agree() -> None:
    # Planes of symmetry that meet in an edge, a support on a movement of zero, and two surfaces
    # of one movement that share a node: each dof has one value, whatever the order.
    parts = [
        Displacement("symmetry x", np.array([0, 1, 2]), 0),
        Displacement("all round", np.array([2, 3]), 0),
        Displacement("still", np.array([1]), 0, 0.0),
        Displacement("pull", np.array([0, 1]), 1, 1e-3),
        Displacement("pull", np.array([1, 2]), 1, 1e-3),
    ]
    for order in (parts, parts[::-1]):
        conditions = Conditions(5, order)
        assert conditions.names == ["pull"]
        u = np.full((5, 3), 9.0)
        conditions.apply(u, {"pull": 0.5})
        np.testing.assert_array_equal(u[:, 0], [0.0, 0.0, 0.0, 0.0, 9.0])
        np.testing.assert_array_equal(u[:, 1], [5e-4, 5e-4, 5e-4, 9.0, 9.0])


def test_conditions_apply_factors_and_leave_the_rest() -> None:
    conditions = Conditions(
        4, [Displacement("pull", np.array([1]), 0, 2.0), Displacement("hold", np.array([2]), 2)]
    )
    u = np.full((4, 3), 9.0)
    conditions.apply(u, {"pull": 0.25})
    expected = np.full((4, 3), 9.0)
    expected[1, 0], expected[2, 2] = 0.5, 0.0
    np.testing.assert_array_equal(u, expected)
    assert conditions.names == ["pull"]
    assert conditions.fixed.sum() == 2


def test_gravity_is_the_weight() -> None:
    body = solid(distorted((2, 2, 2)), NeoHooke(1e5), density=1080.0)
    load = gravity("g", body.node_mass, (0.0, 0.0, -9.8))
    residual = np.zeros_like(body.nodes)
    load.add_residual(body.nodes, 0.5, residual)
    # The unit cube: 1080 kg; the residual is internal minus external.
    np.testing.assert_allclose(residual.sum(axis=0), [0.0, 0.0, 0.5 * 1080.0 * 9.8], atol=1e-9)


def test_surface_loads_have_the_right_sum_and_moment() -> None:
    mesh = grid((3, 2, 1), lambda t: np.column_stack([t[:, 0] ** 1.5, 2.0 * t[:, 1], t[:, 2]]))
    top = mesh.facet_groups["z1"]
    areas = face_node_areas(mesh.nodes, top)
    assert areas.sum() == pytest.approx(2.0, rel=1e-14)
    pull = traction("t", mesh.nodes, top, (1.0, 0.0, 5.0))
    np.testing.assert_allclose(pull.force.sum(axis=0), [2.0, 0.0, 10.0], rtol=1e-14)
    # The resultant passes through the middle of the rectangle: exact for uneven faces too.
    np.testing.assert_allclose(pull.force[:, 2] @ mesh.nodes[:, :2] / 10.0, [0.5, 1.0], rtol=1e-13)
    total = surface_force("f", mesh.nodes, top, (0.0, 3.0, 0.0))
    np.testing.assert_allclose(total.force.sum(axis=0), [0.0, 3.0, 0.0], atol=1e-14)


def test_pressure_pushes_against_the_outward_normal() -> None:
    mesh = grid((2, 2, 2))
    load = CavityPressure("p", mesh.facet_groups["x1"], 100.0)
    residual = np.zeros_like(mesh.nodes)
    load.add_residual(mesh.nodes, 1.0, residual)
    # External force -p n A = -100 N along x, so +100 N in the residual.
    np.testing.assert_allclose(residual.sum(axis=0), [100.0, 0.0, 0.0], atol=1e-12)
    assert load.scale(mesh.nodes) == pytest.approx(25.0)
    assert load.stiffness(mesh.nodes, 0.0) is None
