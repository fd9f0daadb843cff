"""Contact kernels on geometry a person can check."""

from __future__ import annotations

import numpy as np
import pytest
from statics_helpers import grid

from flexapod.contact import kernels
from flexapod.contact.law import ContactLaw
from flexapod.fem.contacts import FaceContact, PlaneContact, SlidingWeight

POINTS = kernels.POINTS
# A unit square at z = 0 looking up, and one of half its size at height h looking down.
LOW = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
HIGH = np.array([[0.2, 0.3, 0.0], [0.2, 0.8, 0.0], [0.7, 0.8, 0.0], [0.7, 0.3, 0.0]])
FACES = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])


def _partners(
    height: float, depth: float = 0.3, margin: float = 0.05, shift: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    x = np.vstack([LOW, HIGH + [shift, 0.0, height]])
    partner = np.full((1, 4), -1, dtype=np.int32)
    local, gap = np.zeros((1, 4, 2)), np.full((1, 4), np.inf)
    fade = np.zeros((1, 4))
    kernels.find_partners(
        x, FACES[1:], POINTS, FACES[:1], np.array([[0, -1]], dtype=np.int32), depth, margin,
        partner, local, gap, fade,
    )  # fmt: skip
    return x, partner, local, gap


@pytest.mark.parametrize("height", [0.2, -0.1])
def test_partners_of_parallel_squares(height: float) -> None:
    x, partner, local, gap = _partners(height)
    assert (partner == 0).all()
    # The distance to the plane, signed along the master's normal; round-off.
    np.testing.assert_allclose(gap, height, atol=1e-14)
    # Local coordinates (-1, 1)**2 of the unit square: 2 x - 1.
    where = np.empty((1, 4, 3))
    kernels.point_positions(x, FACES[1:], POINTS, where)
    np.testing.assert_allclose(local, 2.0 * where[:, :, :2] - 1.0, atol=1e-12)


def test_passers_by_and_points_beside_the_face() -> None:
    # Deeper than `depth` is no contact.
    assert (_partners(-0.4)[1] == -1).all()
    # Moved aside by 0.8: the outer points lie beyond the edge.
    partner = _partners(-0.1, shift=0.8)[1]
    assert (partner == -1).all()
    # By 0.6: half the points project onto the face.
    assert (_partners(-0.1, shift=0.6)[1] == 0).sum() == 2


def test_projection_onto_a_warped_face_is_the_closest_point() -> None:
    x, _, _, _ = _partners(0.3)
    x[2, 2] = 0.25  # one corner lifted: a bilinear face
    partner = np.full((1, 4), -1, dtype=np.int32)
    local, gap = np.zeros((1, 4, 2)), np.full((1, 4), np.inf)
    fade = np.zeros((1, 4))
    kernels.find_partners(
        x, FACES[1:], POINTS, FACES[:1], np.array([[0, -1]], dtype=np.int32), 0.3, 0.05,
        partner, local, gap, fade,
    )  # fmt: skip
    where = np.empty((1, 4, 3))
    kernels.point_positions(x, FACES[1:], POINTS, where)
    # Brute force over the face; the grid of 401 leaves 1e-5 of the distance squared.
    s = np.linspace(-1.0, 1.0, 401)
    xi, eta = np.meshgrid(s, s, indexing="ij")
    n = 0.25 * np.stack(
        [(1 - xi) * (1 - eta), (1 + xi) * (1 - eta), (1 + xi) * (1 + eta), (1 - xi) * (1 + eta)]
    )
    surface = np.einsum("aij,ak->ijk", n, x[:4])
    for q in range(4):
        nearest = np.linalg.norm(surface - where[0, q], axis=2).min()
        assert gap[0, q] == pytest.approx(nearest, rel=1e-4)


def test_areas_and_frames() -> None:
    x = np.vstack([LOW, HIGH])
    areas = np.empty((2, 4))
    kernels.point_areas(x, FACES, POINTS, areas)
    np.testing.assert_allclose(areas.sum(axis=1), [1.0, 0.25], rtol=1e-14)
    centre, normal = np.empty((2, 3)), np.empty((2, 3))
    kernels.face_frames(x, FACES, centre, normal)
    np.testing.assert_allclose(centre, [[0.5, 0.5, 0.0], [0.45, 0.55, 0.0]], atol=1e-15)
    np.testing.assert_allclose(normal, [[0, 0, 1], [0, 0, -1]], atol=1e-15)


def test_uniform_pressure_between_flat_faces() -> None:
    # A small square sunk by d into a large one: B d**m on half its area by its own points, and by
    # those of the large one that lie over it; none here, the large one's are further apart.
    low = (LOW - [0.5, 0.5, 0.0]) * [4.0, 4.0, 1.0]
    x = np.vstack([low, HIGH + [-0.45, -0.55, -0.01]])
    law = ContactLaw(1e3, 2.0)
    contact = FaceContact("pair", x, FACES[1:], FACES[:1], law, depth=0.1)
    force = np.zeros_like(x)
    contact.add_residual(x, force)
    assert not (contact._passes[1].gap < 0.0).any()
    expected = 0.5 * law.traction_coefficient * 0.01**2 * 0.25
    # External minus internal: pushes the upper (small, looking down) face up; round-off.
    assert -force[4:, 2].sum() == pytest.approx(expected, rel=1e-12)
    assert -force[:4, 2].sum() == pytest.approx(-expected, rel=1e-12)
    report = contact.report(x)
    assert report.largest_penetration == pytest.approx(0.01, rel=1e-12)
    assert report.largest_pressure == pytest.approx(law.traction_coefficient * 1e-4, rel=1e-12)


def test_force_fades_steadily_over_the_rim() -> None:
    # A small face slides off a large one: its force falls to zero without a jump and without
    # ever pulling, and what one side feels the other gives.
    law = ContactLaw(1e3, 2.0)
    forces = []
    slides = np.linspace(0.0, 1.6, 161)
    for slide in slides:
        x = np.vstack([LOW, HIGH + [slide, 0.0, -0.01]])
        contact = FaceContact("pair", x, FACES[1:], FACES[:1], law, depth=0.1)
        force = np.zeros_like(x)
        contact.add_residual(x, force)
        assert np.abs(force.sum(axis=0)).max() <= 1e-12 * max(np.abs(force).max(), 1.0)
        forces.append(-float(force[4:, 2].sum()))
    f = np.array(forces)
    assert f[-1] == 0.0 and f.min() >= 0.0
    full = f.max()
    # Steps of a hundredth of the large face: a jump of a whole column of points would be a half
    # or a quarter of the full force. Measured 5 %.
    assert np.abs(np.diff(f)).max() < 0.1 * full


def test_plane_pressure_and_report() -> None:
    mesh = grid((3, 2, 1))
    law = ContactLaw(1e3, 2.0)
    plane = PlaneContact("p", mesh.nodes, mesh.facet_groups["z0"], (0, 0, 0.01), (0, 0, 2.0), law)
    force = np.zeros_like(mesh.nodes)
    energy = plane.add_residual(mesh.nodes, force)
    pressure = law.traction_coefficient * 0.01**2
    # Unit area: force B d**2, energy B d**3 / 3, round-off.
    assert -force[:, 2].sum() == pytest.approx(pressure, rel=1e-12)
    assert energy == pytest.approx(pressure * 0.01 / 3.0, rel=1e-12)
    report = plane.report(mesh.nodes)
    np.testing.assert_allclose(report.force, [0.0, 0.0, pressure], atol=1e-9 * pressure)
    assert report.area == pytest.approx(1.0, rel=1e-12)
    assert report.largest_penetration == pytest.approx(0.01, rel=1e-12)
    nodal = plane.nodal_pressure(mesh.nodes)
    bottom = np.isclose(mesh.nodes[:, 2], 0.0)
    np.testing.assert_allclose(nodal[bottom], pressure, rtol=1e-12)
    np.testing.assert_array_equal(nodal[~bottom], 0.0)
    # Apart: nothing at all.
    away = mesh.nodes + [0.0, 0.0, 0.02]
    force[:] = 0.0
    assert plane.add_residual(away, force) == 0.0
    assert not force.any()
    assert plane.stiffness(away) == []


def test_a_frozen_contact_keeps_its_partner_beyond_the_rim() -> None:
    x = np.vstack([LOW, HIGH + [0.0, 0.0, -0.1]])
    law = ContactLaw(1e3)
    contact = FaceContact("pair", x, FACES[:1], FACES[1:], law, depth=0.5, margin=0.1)
    force = np.zeros_like(x)
    contact.update(x)
    contact.add_residual(x, force)
    assert np.abs(force).max() > 0.0
    aside = x + np.vstack([np.zeros((4, 3)), np.tile([0.7, 0.0, 0.0], (4, 1))])
    free, held = np.zeros_like(x), np.zeros_like(x)
    contact.frozen = True
    contact.update(aside)
    contact.add_residual(aside, held)
    contact.frozen = False
    contact.update(aside)
    contact.add_residual(aside, free)
    # The squares are parallel: on the faces' continuation the pressing force is unchanged, while
    # a free contact has lost part of its points.
    # (8.8 MN; round-off of the projection is below 1 mN.)
    np.testing.assert_allclose(held[4:].sum(axis=0), force[4:].sum(axis=0), atol=1e-3)
    assert abs(free[4:, 2].sum()) < 0.9 * abs(force[4:, 2].sum())


def _sliding() -> tuple[np.ndarray, SlidingWeight]:
    nodes = np.random.default_rng(3).uniform(0.0, 1.0, (5, 3))
    weight = np.array([1.0, 2.0, 0.5, 0.0, 3.0])
    return nodes, SlidingWeight("table", nodes, weight, (0.0, 2.0, 0.0), 0.8, 1e-3)


def test_a_sliding_weight_resists_with_its_friction_along_the_table_only() -> None:
    nodes, table = _sliding()
    force = np.zeros_like(nodes)
    table.add_residual(nodes + [3.0, 7.0, 4.0], force)
    # Slip 5, s0 1e-3: the friction falls short of mu m g by 2e-8.
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), table.limit, rtol=1e-7)
    np.testing.assert_allclose(force, table.limit[:, None] * [0.6, 0.0, 0.8], rtol=1e-7)
    np.testing.assert_allclose(
        table.report(nodes + [3.0, 7.0, 4.0]).force, [-0.6 * 5.2, 0.0, -0.8 * 5.2], rtol=1e-7
    )
    # Accepted, it counts from there: no slip, no friction.
    table.commit()
    force[:] = 0.0
    assert table.add_residual(nodes + [3.0, 9.0, 4.0], force) == 0.0
    assert not force.any()


def test_tangent_of_a_sliding_weight_against_differences() -> None:
    nodes, table = _sliding()
    x = nodes + np.random.default_rng(4).normal(0.0, 1e-3, nodes.shape)
    ((rows, blocks),) = table.stiffness(x)
    assert rows.shape == (5, 1)
    step = 1e-7
    for axis in range(3):
        ahead, behind = np.zeros_like(x), np.zeros_like(x)
        up = table.add_residual(x + step * np.eye(3)[axis], ahead)
        down = table.add_residual(x - step * np.eye(3)[axis], behind)
        # Second order in 1e-7 against a length of 1e-3: 1e-8, and round-off of 1e-16 / 1e-7.
        np.testing.assert_allclose(
            (ahead - behind) / (2.0 * step), blocks[:, :, axis], rtol=1e-6, atol=1e-4
        )
        force = np.zeros_like(x)
        table.add_residual(x, force)
        assert (up - down) / (2.0 * step) == pytest.approx(force[:, axis].sum(), rel=1e-6)
