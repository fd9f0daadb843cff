"""Candidate faces: those that face each other nearby, never neighbours nor joined sides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from statics_helpers import grid

from flexapod.contact.search import CANDIDATE_COUNT, FACING_COSINE, Rest, candidate_faces
from flexapod.geometry.tagged import boundary_facets


def _slot(gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A U of cells with a slot of width `gap` at x = 0.5: nodes, all faces, the slot's faces."""
    mesh = grid((5, 2, 4))
    x = mesh.nodes.copy()
    middle = mesh.nodes[mesh.cells].mean(axis=1)
    out = (np.abs(middle[:, 0] - 0.5) < 0.05) & (middle[:, 2] > 0.25)
    x[:, 0] = np.interp(
        x[:, 0], [0.0, 0.2, 0.4, 0.6, 0.8, 1.0], [0, 0.2, 0.5 - gap / 2, 0.5 + gap / 2, 0.8, 1.0]
    )
    cells = mesh.cells[~out]
    faces = boundary_facets(cells)
    centre = x[faces].mean(axis=1)
    flat = np.ptp(x[faces][:, :, 0], axis=1) < 1e-12
    walls = flat & (np.abs(np.abs(centre[:, 0] - 0.5) - gap / 2) < 1e-9)
    return x, faces, np.flatnonzero(walls)


def test_facing_walls_find_each_other_and_nothing_else() -> None:
    x, faces, walls = _slot(0.02)
    found = candidate_faces(x, faces, faces, 0.3)
    assert found.shape == (len(faces), CANDIDATE_COUNT)
    centre = x[faces].mean(axis=1)
    for w in walls:
        picked = found[w][found[w] >= 0]
        assert len(picked)
        # The nearest candidate is the face straight across the slot.
        across = centre[w] * [-1.0, 1.0, 1.0] + [1.0, 0.0, 0.0]
        np.testing.assert_allclose(centre[picked[0]], across, atol=1e-12)
        # Nothing that shares a node or looks the same way.
        for f in picked:
            assert not set(faces[f]) & set(faces[w])
        # Nearest first.
        assert np.all(np.diff(np.linalg.norm(centre[picked] - centre[w], axis=1)) >= -1e-12)


@pytest.mark.parametrize("reach", [0.05, 0.3, 2.0, np.inf])
def test_the_nearest_of_all_that_may_touch_are_found(reach: float) -> None:
    # Squares strewn about, turned at random, some far off: every pair is looked at here.
    rng = np.random.default_rng(3)
    count = 300
    corners = 0.02 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    places = rng.random((count, 3)) * [1.0, 0.4, 0.1]
    places[:5] *= 40.0  # beyond the others: cells are wider than the reach then
    turns = Rotation.random(count, random_state=rng).as_matrix()
    x = (places[:, None] + np.einsum("fij,aj->fai", turns, corners)).reshape(-1, 3)
    faces = np.arange(4 * count).reshape(-1, 4)
    first, second = faces[: count // 3], faces[count // 3 :]
    for slaves, masters in ((first, second), (faces, faces)):
        found = candidate_faces(x, slaves, masters, reach)
        here, there = x[slaves].mean(axis=1), x[masters].mean(axis=1)
        turned = turns[slaves[:, 0] // 4, :, 2] @ turns[masters[:, 0] // 4, :, 2].T
        distance = np.linalg.norm(here[:, None] - there, axis=2)
        may = (turned < FACING_COSINE) & (distance < reach)
        for f in range(len(slaves)):
            nearest = np.argsort(np.where(may[f], distance[f], np.inf), kind="stable")
            wanted = nearest[: min(may[f].sum(), CANDIDATE_COUNT)]
            assert found[f][found[f] >= 0].tolist() == wanted.tolist()


def test_places_that_are_no_numbers_end_the_search_all_the_same() -> None:
    x, faces, walls = _slot(0.02)
    x = x.copy()
    x[faces[walls[0]][0]] = np.nan
    assert candidate_faces(x, faces, faces, 0.3).shape == (len(faces), CANDIDATE_COUNT)


def test_neighbours_on_a_flat_side_are_no_candidates() -> None:
    mesh = grid((4, 4, 1))
    top = mesh.facet_groups["z1"]
    assert (candidate_faces(mesh.nodes, top, top, 1.0) == -1).all()


def test_reach_limits_the_search() -> None:
    x, faces, walls = _slot(0.02)
    assert (candidate_faces(x, faces[walls], faces[walls], 0.01) == -1).all()
    assert (candidate_faces(x, faces[walls], faces[walls], 0.021)[:, 0] >= 0).all()


def test_sides_joined_at_rest_are_left_out() -> None:
    # Back to back faces of one plane: 20 micrometres apart at rest counts as joined.
    x, faces, walls = _slot(2e-5)
    wall = faces[walls]
    assert (candidate_faces(x, wall, wall, 0.3)[:, 0] >= 0).all()
    assert (candidate_faces(x, wall, wall, 0.3, Rest.of(x, wall, wall), 5e-4) == -1).all()
    assert (candidate_faces(x, wall, wall, 0.3, Rest.of(x, wall, wall), 1e-5)[:, 0] >= 0).all()


def test_empty_surfaces() -> None:
    x, faces, _ = _slot(0.02)
    none = np.empty((0, 4), dtype=np.int64)
    assert candidate_faces(x, none, faces, 1.0).shape == (0, CANDIDATE_COUNT)
    assert (candidate_faces(x, faces, none, 1.0) == -1).all()


def test_two_sides_of_a_sharp_notch_share_an_edge_and_are_no_candidates() -> None:
    # They look at each other (30 degrees apart), but neighbours are never partners.
    c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [c, 1, s], [c, 0, s]], dtype=float)
    faces = np.array([[0, 1, 2, 3], [0, 3, 4, 5]])
    assert (candidate_faces(x, faces, faces, 2.0) == -1).all()
    # The same two with an edge each do find one another.
    apart = np.vstack([x, x[[0, 3]] + [0.0, 0.0, 0.01]])
    split = np.array([[0, 1, 2, 3], [6, 7, 4, 5]])
    assert candidate_faces(apart, split, split, 2.0)[:, 0].tolist() == [1, 0]


def test_two_sides_of_one_wall_are_no_candidates() -> None:
    # A plate a tenth thick: its sides look away from each other, however near they are.
    mesh = grid((4, 4, 1), lambda x: x * [1.0, 1.0, 0.1])
    faces = np.concatenate([mesh.facet_groups["z0"], mesh.facet_groups["z1"]])
    x = mesh.nodes
    normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 3]] - x[faces[:, 0]])
    outward = np.where(x[faces[:, 0], 2] > 0.05, 1.0, -1.0)
    faces = np.where((normal[:, 2] * outward > 0.0)[:, None], faces, faces[:, ::-1])
    assert (candidate_faces(x, faces, faces, 0.3)[:, 0] >= 0).all()
    assert (candidate_faces(x, faces, faces, 0.3, Rest.of(x, faces, faces), 5e-4) == -1).all()


def test_the_sides_of_a_crease_are_candidates_only_away_from_it() -> None:
    # Two leaves of eight faces meet at a right angle along y and are folded to 20 degrees.
    def leaves(angle: float) -> tuple[np.ndarray, np.ndarray]:
        mesh = grid((8, 1, 1))
        floor = mesh.facet_groups["z0"]
        nodes = np.unique(floor)
        x = mesh.nodes[nodes]
        faces = np.searchsorted(nodes, floor)
        c, s = np.cos(angle), np.sin(angle)
        wall = np.stack([c * x[:, 0], x[:, 1], s * x[:, 0]], axis=1)
        up = np.cross(x[faces[0, 1]] - x[faces[0, 0]], x[faces[0, 3]] - x[faces[0, 0]])[2] > 0.0
        low = faces if up else faces[:, ::-1]
        return np.vstack([x, wall]), np.concatenate([low, low[:, ::-1] + len(x)])

    rest, faces = leaves(np.pi / 2)
    folded, _ = leaves(np.radians(20.0))
    assert (candidate_faces(folded, faces, faces, 1.0)[:, 0] >= 0).all()
    found = candidate_faces(folded, faces, faces, 1.0, Rest.of(rest, faces, faces), 1e-4)
    # A face is 1/8 x 1, its diagonal 1.0078; 2.5 of them are further than the leaves reach.
    assert (found == -1).all()
    small = rest * [4.0, 0.25, 4.0]  # leaves 4 long of faces 1/2 x 1/4: a diagonal of 0.559
    here = folded * [4.0, 0.25, 4.0]
    found = candidate_faces(here, faces, faces, 2.0, Rest.of(small, faces, faces), 1e-4)
    centre = small[faces].mean(axis=1)
    assert (found >= 0).any()
    for f, row in enumerate(found):
        for m in row[row >= 0]:
            assert np.linalg.norm(centre[f] - centre[m]) > 2.5 * 0.559
