"""What is looked at, followed and allowed for between two searches of face-to-face contact."""

from __future__ import annotations

import numpy as np
import pytest

from flexapod.contact import kernels, track_kernels
from flexapod.contact.law import ContactLaw
from flexapod.contact.search import candidate_faces, radii
from flexapod.dynamics.contacts import ENERGY, FORCE, RATE_MARGIN
from flexapod.dynamics.surface_contact import WAY_SHARE, SurfaceContact

SIZE = 0.01  # of a face [m]
LAW = ContactLaw(stiffness=3e6, damping_ratio=0.1)


def two_plates(gap: float, shift: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, and 3 x 3 faces looking up under 3 x 3 faces looking down, `gap` [m] apart."""
    line = SIZE * np.arange(4)
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    low = np.column_stack([flat, np.zeros(16)])
    high = np.column_stack([flat + [shift, 0.0], np.full(16, gap)])
    first = np.array([4 * i + j for i in range(3) for j in range(3)])
    up = first[:, None] + [0, 4, 5, 1]
    down = 16 + first[:, None] + [0, 1, 5, 4]
    return np.concatenate([low, high]), up, down


def plates(gap: float, skin: float = 4e-3) -> tuple[SurfaceContact, np.ndarray]:
    nodes, up, down = two_plates(gap)
    return SurfaceContact("pair", nodes, up, down, LAW, skin=skin), nodes


def test_candidates_out_of_reach_are_struck() -> None:
    """What is left holds every face a point can be pressed onto, found here by the distance."""
    rng = np.random.default_rng(3)
    for gap, shift in ((1e-3, 0.0), (3e-3, 0.4 * SIZE), (3e-3, 1.7 * SIZE), (2e-2, 0.0)):
        x, up, down = two_plates(gap, shift)
        x = x + 2e-4 * rng.standard_normal(x.shape)
        candidates = np.tile(np.arange(9, dtype=np.int32), (9, 1))
        near = np.zeros(9, dtype=np.int64)
        track_kernels.mark_near(
            x, up, kernels.POINTS, down, candidates, 4e-3, 0.8, near
        )  # fmt: skip
        points = np.empty((9, 4, 3))
        kernels.point_positions(x, up, kernels.POINTS, points)
        for f in range(9):
            kept = candidates[f][candidates[f] >= 0]
            assert (candidates[f][kept.size :] == -1).all()
            # In the plane a point is on the widened face; warped by 0.2 mm, some of it to spare.
            middle = x[down].mean(axis=1)
            over = np.abs(points[f][:, None, :2] - middle[None, :, :2]).max(axis=2)
            pressed = (over < 0.5 * SIZE).any(axis=0) & (gap < 3.4e-3)
            assert set(np.flatnonzero(pressed)) <= set(kept)
            far = (over > 2.2 * 0.5 * SIZE + 4e-3).all(axis=0)
            assert not set(np.flatnonzero(far)) & set(kept)
            assert gap < 1e-2 or not kept.size
            assert near[f] == min(kept.size, 1)


def test_candidates_by_the_sizes_of_both_faces() -> None:
    """Small faces about a large one, all within reach of it and not of each other; by distance."""
    big = np.array([[0.0, 0.0], [0.06, 0.0], [0.06, 0.06], [0.0, 0.06]])
    line = np.linspace(0.0, 0.06, 16)
    small = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    x = np.concatenate([np.c_[big, np.zeros(4)], np.c_[small, np.full(256, 3e-3)]])
    down = np.array([[16 * i + j for j in range(15)] for i in range(15)]).reshape(-1, 1)
    down = 4 + down + np.array([0, 1, 17, 16])
    one = np.array([[0, 1, 2, 3]])
    room = 4e-3
    for slaves, masters in ((one, down), (down, one), (np.concatenate([one, down]),) * 2):
        sizes = radii(x, slaves), radii(x, masters)
        found = candidate_faces(x, slaves, masters, room, None, 0.0, sizes, 225)
        for f, row in enumerate(found):
            kept = set(row[row >= 0])
            away = np.linalg.norm(x[masters].mean(axis=1) - x[slaves[f]].mean(axis=0), axis=1)
            near = away < sizes[0][f] + sizes[1] + room
            facing = (slaves[f][0] < 4) != (masters[:, 0] < 4)
            assert kept == set(np.flatnonzero(near & facing))
    # Of a face to its corners: half the diagonal of a square.
    assert radii(x, one)[0] == pytest.approx(0.03 * np.sqrt(2.0), rel=1e-12)


def test_a_face_is_followed_again_before_it_can_touch() -> None:
    """The upper plate comes down in steps; nothing is looked at before half of the gap is gone."""
    contact, x = plates(0.3e-3)
    history = contact.start(x)
    contact.prepare(x, history, 0.0)
    assert history["gap0"].max() == pytest.approx(0.3e-3, rel=1e-9)
    seen, gaps = [], []
    for step in range(1, 20):
        x = x + np.where(np.arange(32) < 16, 1.0, -1.0)[:, None] * [0.0, 0.0, 1e-5]
        contact.prepare(x, history, 1e-5)
        gaps.append(0.3e-3 - 2e-5 * step)
        seen.append(float(history["gap0"].min()))
    # Both move by as much as the fastest node, and a little is left for partners beside a rim.
    looked = np.isclose(seen, gaps, rtol=0.0, atol=1e-9)
    assert not looked[:11].any()
    assert looked[14:].all()
    assert np.array(seen)[:14].min() > 0.0


def test_ways_are_counted_by_face() -> None:
    """One corner that swings does not have the faces at the other end looked at."""
    contact, x = plates(3e-3)
    history = contact.start(x)
    contact.prepare(x, history, 0.0)
    assert not history["way0"].any()
    limit = WAY_SHARE * contact.skin
    x[31, 2] -= 2.0 * limit  # the last corner of the upper plate
    contact.prepare(x, history, 2.0 * limit)
    way = history["way0"].reshape(3, 3)
    # A rigid motion fits what moves: some of it is left over for all, most of it for the corner.
    assert way.max() == way[2, 2] > 1.2 * limit
    assert way[2, 2] > 3.0 * way[0].max()
    assert history["since"][0] > 1.2 * limit


def test_points_may_go_as_deep_as_the_step_allows() -> None:
    """At the depth that is noted the bound of the frequency is the one the step was chosen for."""
    contact, x = plates(-1e-4)
    history = contact.start(x)
    contact.prepare(x, history, 0.0)
    inverse_mass = np.full(32, 1.0 / 2e-5)
    inverse_mass[:16] *= 0.2
    elements = np.full(32, 2e8)
    margin = RATE_MARGIN

    def rates() -> tuple[np.ndarray, np.ndarray]:
        springs, dashpots = np.zeros(32), np.zeros(32)
        contact.add_rates(history, inverse_mass, margin, springs, dashpots)
        return springs, dashpots

    springs, dashpots = rates()
    half = 0.5 * dashpots
    omega = 1.6 * float((half + np.sqrt(half**2 + elements + springs)).max())
    contact.allow(history, margin, springs, dashpots, elements, omega)
    tightest = min(history["allowed0"].min(), history["allowed1"].min())
    assert tightest > 1e-4 + margin
    # All of them as deep as the first that may go no deeper: no node is beyond the bound, and since
    # springs grow with the depth and dashpots with its square, one is not far from it.
    for k in range(2):
        history[f"gap{k}"][:] = margin - tightest
    springs, dashpots = rates()
    bound = elements + springs + omega * dashpots
    assert 0.7 * omega**2 < bound.max() <= omega**2 * (1.0 + 1e-9)
    assert (omega * dashpots).max() > 0.01 * omega**2


def test_a_point_deeper_than_allowed_is_noticed() -> None:
    """Also where another point of the same contact is deeper still, and where none was counted."""
    contact, x = plates(2e-4)
    x[28:, 2] = -2e-4  # one edge of the upper plate is deep already
    history = contact.start(x)
    zero = np.zeros((32, 3))

    def deeper(y: np.ndarray) -> bool:
        contact.prepare(y, history, 1e-3)
        contact.add_forces(y, zero, history, zero.copy(), zero.copy())
        return contact.deeper

    assert deeper(x)
    springs, dashpots = np.zeros((2, 32))
    contact.add_rates(history, np.full(32, 5e4), 1.5e-5, springs, dashpots)
    contact.allow(history, 1.5e-5, springs, dashpots, np.zeros(32), float(np.sqrt(springs.max())))
    assert not deeper(x)
    pressed = x.copy()
    pressed[16:28, 2] = -1e-4  # shallower than the edge
    assert history["depth"][0] > 1e-4
    assert deeper(pressed)


def test_what_is_apart_has_no_share_in_the_step() -> None:
    """From the start on, before any step: plates 2 mm apart ask for nothing, touching ones do."""
    for gap, counts in ((2e-3, False), (1e-4, True), (-1e-4, True)):
        contact, x = plates(gap)
        history = contact.start(x)
        springs, dashpots = np.zeros((2, 32))
        contact.add_rates(history, np.full(32, 5e4), 1.5e-5, springs, dashpots)
        assert springs.any() == counts
        assert dashpots.any() == counts


def test_what_comes_near_without_a_share_is_noticed_before_it_touches() -> None:
    """Once: after the step is chosen with it, it is counted."""
    contact, x = plates(1e-3)
    history = contact.start(x)
    inverse_mass, none = np.full(32, 5e4), np.zeros(32)
    springs, dashpots = np.zeros((2, 32))
    contact.add_rates(history, inverse_mass, RATE_MARGIN, springs, dashpots)
    contact.allow(history, RATE_MARGIN, springs, dashpots, none, 1e4)
    assert not springs.any()
    gap = 1e-3
    while not contact.prepare(x, history, 1e-5):
        x = x + np.where(np.arange(32) < 16, 1.0, -1.0)[:, None] * [0.0, 0.0, 1e-5]
        gap -= 2e-5
    # Two steps of both sides before the touch, at the least.
    assert gap > 4e-5
    contact.add_rates(history, inverse_mass, RATE_MARGIN, springs, dashpots)
    assert springs.all()
    contact.allow(history, RATE_MARGIN, springs, dashpots, none, 1e4)
    assert not contact.prepare(x, history, 1e-5)


@pytest.mark.parametrize("angle", [1e-6, 1e-3, 0.3, 1.2])
@pytest.mark.parametrize("across", [(1.0, 1.0), (0.3, 0.1), (0.05, 0.05), (0.3, 0.0), (0.0, 0.0)])
def test_ways_are_counted_from_the_best_rigid_motion(
    angle: float, across: tuple[float, float]
) -> None:
    """Against the singular values' fit (Kabsch), for solid, flat and straight sets of nodes."""
    rng = np.random.default_rng(5)
    before = 0.1 * rng.standard_normal((50, 3)) * [1.0, *across]
    axis = np.array([0.36, 0.48, 0.8])
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    x = np.zeros((60, 3))
    nodes = np.arange(5, 55)
    x[nodes] = before @ turn.T + [1.0, -2.0, 3.0] + 1e-5 * rng.standard_normal((50, 3))
    moved = np.zeros(60)
    largest = track_kernels.relative_motion(before, x, nodes, moved)

    then, now = before - before.mean(axis=0), x[nodes] - x[nodes].mean(axis=0)
    left, _, right = np.linalg.svd(now.T @ then)
    left[:, -1] *= np.sign(np.linalg.det(left @ right))
    away = np.linalg.norm(now - then @ (left @ right).T, axis=1)
    assert largest == moved.max()
    # Positions of some metres are known to 4e-16. Turned about a straight line by an angle t that
    # its noise of 1e-5 m leaves open, ways differ by t times the noise, of which t is 1e-4.
    tolerance = 1e-9 if across[0] == 0.0 else 1e-12
    np.testing.assert_allclose(moved[nodes], away, rtol=0.0, atol=tolerance)
    assert not moved[:5].any() and not moved[55:].any()


def _moved(x: np.ndarray, way: tuple[float, float, float]) -> np.ndarray:
    """The upper plate elsewhere."""
    return x + np.where(np.arange(32) < 16, 0.0, 1.0)[:, None] * np.asarray(way)


def _along(contact: SurfaceContact, path: list[np.ndarray]) -> np.ndarray:
    """Rows of stored energy, work of the elastic forces, dropped energy [J] and force [N] (3)."""
    history = contact.start(path[0])
    none = np.zeros_like(path[0])
    rows, work, before, last = [], 0.0, path[0], None
    for x in path:
        contact.prepare(x, history, float(np.linalg.norm(x - before, axis=1).max()))
        force, rest = np.zeros_like(x), np.zeros_like(x)
        contact.add_forces(x, none, history, force, rest)
        if last is not None:
            work += float((0.5 * (force + last) * (x - before)).sum())
        before, last = x, force
        lost = contact.dropped(history)
        rows.append([contact.totals[ENERGY], work, lost, *contact.totals[FORCE]])
    return np.array(rows)


def test_elastic_forces_are_the_gradient_of_what_points_store() -> None:
    """By differences, in all nodes: warped faces, beyond rims and corners, offsets, fading."""
    rng = np.random.default_rng(7)
    nodes, up, down = two_plates(-3e-4, 0.28 * SIZE)
    nodes[16:, 1] += 0.26 * SIZE
    x = nodes + 1e-4 * rng.standard_normal(nodes.shape)
    contact = SurfaceContact("pair", nodes, up, down, LAW, depth=6e-4, skin=4e-3)
    history = contact.start(x)
    for k in range(2):
        depth = np.maximum(0.0, -history[f"gap{k}"])
        history[f"offset{k}"][:] = depth * rng.uniform(0.0, 0.5, depth.shape)
    beyond = [np.abs(history[f"local{k}"]) > 1.0 for k in range(2)]
    touching = [(history[f"gap{k}"] < 0.0)[..., None] for k in range(2)]
    assert sum((b & t).any(axis=2).sum() for b, t in zip(beyond, touching, strict=True)) > 8
    assert any((b & t).all(axis=2).any() for b, t in zip(beyond, touching, strict=True))
    assert min(history[f"gap{k}"].min() for k in range(2)) < -0.75 * 6e-4

    def energy(y: np.ndarray, force: np.ndarray) -> float:
        for k, p in enumerate(contact.passes):
            kernels.project_on_partners(
                y, p.slaves, kernels.POINTS, p.masters,
                history[f"partner{k}"], history[f"local{k}"], history[f"gap{k}"],
            )  # fmt: skip
        contact.add_forces(y, np.zeros_like(y), history, force, np.zeros_like(y))
        return float(contact.totals[ENERGY])

    force, spare, step = np.zeros_like(x), np.zeros_like(x), 1e-8
    energy(x, force)
    slopes = np.zeros_like(x)
    for place in np.ndindex(*x.shape):
        ends = []
        for sign in (1.0, -1.0):
            y = x.copy()
            y[place] += sign * step
            ends.append(energy(y, spare))
        slopes[place] = (ends[0] - ends[1]) / (2.0 * step)
    # Central differences, cancelled to half the digits: measured 6e-10 of the largest force.
    assert np.abs(force + slopes).max() < 1e-8 * np.abs(force).max()
    assert np.abs(force[:, :2]).max() > 0.02 * np.abs(force).max()


def test_a_point_is_pushed_off_over_a_rim_and_has_to_be_pushed_in() -> None:
    """Sideways by a third of a face at one depth and back: the work that came out goes in again.

    Points lie 0.21 of a face from its edges, so that a row of them slides off the other plate, to a
    coordinate of 1.18 where 1.3 is the end of the margin.
    """
    contact, x = plates(-3e-4)
    x = x + 1e-5 * np.random.default_rng(5).standard_normal(x.shape)
    shift = np.concatenate([np.linspace(0.0, 0.30, 3001), np.linspace(0.30, 0.0, 3001)]) * SIZE
    rows = _along(contact, [_moved(x, (s, 0.0, 0.0)) for s in shift])
    stored, work, lost = rows[:, 0], rows[:, 1], rows[:, 2]
    assert stored[3000] < 0.9 * stored[0]
    # The trapezoidal rule over 6,000 steps: measured 9e-7.
    assert np.abs(stored - stored[0] + work + lost).max() < 1e-5 * stored[0]
    # The lower plate is pushed back from where the upper one goes, by 1.7 % of the force down, and
    # as much on its way back: but for 0.4 %, where points of the warped plates change faces and
    # keep what they stored.
    assert rows[:, 3].min() < 0.01 * rows[0, 5] < 0.0
    assert np.abs(rows[:, 3] - rows[::-1, 3]).max() < 1e-2 * np.abs(rows[:, 3]).max()
    # Of those: measured 4e-6 and 3e-6.
    assert abs(lost[-1]) < 4e-5 * stored[0]
    assert stored[-1] == pytest.approx(stored[0], rel=3e-5)


def test_a_point_that_comes_in_deep_from_afar_presses_by_what_it_sinks_in_further() -> None:
    """From beyond the margin there is no force on the way in, and none where it stays as deep."""
    contact, x = plates(-1.5e-4)
    shift = np.concatenate([np.linspace(0.0, 0.45, 2001), np.linspace(0.45, 0.0, 2001)]) * SIZE
    path = [_moved(x, (s, 0.0, 0.0)) for s in shift]
    rows = _along(contact, path)
    # A row of six is let go of beyond the margin, with what it stored, and offset from then on.
    # Flat plates: measured to 2e-6, the trapezoidal rule's.
    assert rows[-1, 0] == pytest.approx(rows[0, 0] * 5.0 / 6.0, rel=2e-5)
    assert np.abs(rows[:, 0] - rows[0, 0] + rows[:, 1] + rows[:, 2]).max() < 2e-5 * rows[0, 0]
    deeper = _along(contact, [*path, *(_moved(x, (0, 0, -z)) for z in np.linspace(0, 5e-5, 50))])
    fresh = _along(contact, [_moved(x, (0, 0, -5e-5))])
    # Downwards on the lower plate: 178, 320 and 379 N.
    assert 0.0 > rows[-1, 5] > deeper[-1, 5] > fresh[0, 5]


def test_no_way_round_makes_energy() -> None:
    """Deep and shallow, over faces and rims and turned, again and again: the books close.

    And what is dropped only grows: no partner gives a point energy it had not. Measured to 0.6 mJ
    of the 4.3 J pressed in; without the force at rims 60 mJ are missing, and without the points'
    offsets one of them was given 6 mJ.
    """
    rng = np.random.default_rng(11)
    contact, x = plates(2e-4)
    x = x + 3e-4 * rng.standard_normal(x.shape)
    path = []
    phase = rng.uniform(0.0, 2.0 * np.pi, 5)
    for s in np.linspace(0.0, 2.0 * np.pi, 40_001):
        waves = np.sin(np.array([3.0, 5.0, 11.0, 4.0, 7.0]) * s + phase) - np.sin(phase)
        turned = x.copy()
        c, t = np.cos(0.03 * waves[3]), np.sin(0.03 * waves[3])
        turned[16:, [0, 2]] = turned[16:, [0, 2]] @ np.array([[c, t], [-t, c]])
        path.append(_moved(turned, (6e-3 * waves[0], 5e-3 * waves[1], 4e-4 * waves[2] - 4e-4)))
    rows = _along(contact, path)
    stored, work, lost = rows[:, 0], rows[:, 1], rows[:, 2]
    pressed = np.maximum(0.0, -np.diff(work)).sum()
    gap = np.abs(stored - stored[0] + work + lost).max()
    assert gap < 1e-3 * pressed
    assert np.diff(lost).min() > -1e-9 * pressed
    assert lost[-1] > 0.0
