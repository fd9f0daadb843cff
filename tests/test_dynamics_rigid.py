"""Rigid bodies: their mass properties, checks and kernels against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from statics_helpers import grid

from flexapod.core.errors import InputError
from flexapod.dynamics import rigid_kernels
from flexapod.dynamics.rigid import RigidBodies, box, cylinder, mass_properties, sphere

ROUND_OFF = 1e-13  # measured 2e-15 relative, after sums of a few hundred terms
DENSITY = 2700.0
ALL = np.ones(6, dtype=bool)
# What a symmetry plane y = const leaves: x, z and turns about y.
PLANAR = np.array([True, False, True, False, True, False])


def _rotation(q: np.ndarray) -> np.ndarray:
    """R(q) by v + 2 w (u x v) + 2 u x (u x v) on the unit vectors, q = (w, u)."""
    cross = np.cross(q[1:], np.eye(3)).T
    return np.asarray(np.eye(3) + 2.0 * q[0] * cross + 2.0 * cross @ cross)


def _skew_inertia(seed: int = 3) -> np.ndarray:
    """Inertia of a random cloud of points, no axis of it along the world's."""
    r = np.random.default_rng(seed).normal(size=(20, 3)) * [0.01, 0.02, 0.04]
    return np.asarray(np.sum(r**2) * np.eye(3) - r.T @ r)


def _bodies(*free: np.ndarray) -> RigidBodies:
    count = len(free)
    return RigidBodies(
        tuple(f"body {k}" for k in range(count)),
        np.linspace(0.5, 1.5, count),
        np.stack([_skew_inertia(k) for k in range(count)]),
        np.stack(free),
    )


def _random_state(bodies: RigidBodies, seed: int = 5) -> tuple[np.ndarray, ...]:
    """Turned bodies; velocities respect the locks, momenta about locked axes must not matter."""
    random = np.random.default_rng(seed)
    x, q, v, momentum = bodies.initial_state(random.normal(size=(bodies.count, 3)))
    q[:] = random.normal(size=q.shape)
    q /= np.linalg.norm(q, axis=1)[:, None]
    v[:] = random.normal(size=v.shape) * bodies.free[:, :3]
    momentum[:] = 0.1 * random.normal(size=v.shape)
    return x, q, v, momentum


def _omega(inertia: np.ndarray, free: np.ndarray, q: np.ndarray, l_: np.ndarray) -> np.ndarray:
    """The twin of the kernel: numpy's solver on the free block of R I R^T."""
    f = np.flatnonzero(free[3:])
    r = _rotation(q)
    omega = np.zeros(3)
    omega[f] = np.linalg.solve((r @ inertia @ r.T)[np.ix_(f, f)], l_[f])
    return omega


# --- mass properties


def test_mass_properties_of_a_box_off_centre() -> None:
    size, corner = np.array([0.045, 0.025, 0.035]), np.array([1.3, -0.4, 0.2])
    mesh = grid((3, 2, 4), lambda t: corner + size * t**1.5)  # bricks of many sizes
    mass, centre, inertia = mass_properties(mesh.nodes, mesh.cells, DENSITY)
    expected_mass, expected = box((0.045, 0.025, 0.035), DENSITY)
    # Bricks are exact under the rule; round-off of coordinates 40 times the body's size.
    assert mass == pytest.approx(expected_mass, rel=1e-12)
    np.testing.assert_allclose(centre, corner + 0.5 * size, rtol=1e-14)
    np.testing.assert_allclose(inertia, expected, atol=1e-12 * expected.max())
    # And the closed form itself: m (b^2 + c^2) / 12 about x.
    assert expected[0, 0] == pytest.approx(expected_mass * (0.025**2 + 0.035**2) / 12.0)


def test_mass_properties_of_sheared_and_turned_bricks() -> None:
    # With x = A t the second moments of mass are A (m/12) A^T: exact for parallel faces.
    a = np.random.default_rng(2).normal(size=(3, 3))
    a[0] *= np.sign(np.linalg.det(a))
    mesh = grid((2, 2, 2), lambda t: t @ a.T)
    mass, centre, inertia = mass_properties(mesh.nodes, mesh.cells, DENSITY)
    second = mass / 12.0 * a @ a.T
    assert mass == pytest.approx(DENSITY * np.linalg.det(a), rel=ROUND_OFF)
    np.testing.assert_allclose(centre, 0.5 * a.sum(axis=1), rtol=ROUND_OFF)
    expected = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(inertia, expected, atol=ROUND_OFF * np.abs(expected).max())


def test_half_a_body_has_half_the_mass_and_its_own_centre() -> None:
    size = np.array([0.04, 0.03, 0.02])
    mesh = grid((2, 4, 2), lambda t: size * (t - 0.5))
    half = mesh.cells[(mesh.nodes[mesh.cells].mean(axis=1) > 0.0)[:, 1]]
    mass, centre, inertia = mass_properties(mesh.nodes, half, DENSITY)
    whole, whole_inertia = box((0.04, 0.03, 0.02), DENSITY)
    assert mass == pytest.approx(0.5 * whole, rel=ROUND_OFF)
    np.testing.assert_allclose(centre, [0.0, 0.0075, 0.0], atol=1e-15)
    _, expected = box((0.04, 0.015, 0.02), DENSITY)
    np.testing.assert_allclose(inertia, expected, atol=ROUND_OFF * expected.max())
    # Steiner: two halves, 7.5 mm to each side, make the whole again.
    shift = mass * 0.0075**2 * np.diag([1.0, 0.0, 1.0])
    np.testing.assert_allclose(
        2.0 * (inertia + shift), whole_inertia, atol=ROUND_OFF * whole_inertia.max()
    )


def test_round_bodies_against_fine_meshes() -> None:
    def round_off_the_square(t: np.ndarray) -> np.ndarray:
        # The square (-1, 1)^2 onto the unit disc, area for area (P. Shirley & K. Chiu 1997).
        u, w = 2.0 * t[:, 0] - 1.0, 2.0 * t[:, 1] - 1.0
        r = np.where(np.abs(u) > np.abs(w), u, w)
        other = np.where(np.abs(u) > np.abs(w), w, u)
        angle = 0.25 * np.pi * other / np.where(r == 0.0, 1.0, r)
        near, far = r * np.cos(angle), r * np.sin(angle)
        first = np.abs(u) > np.abs(w)
        return np.stack([np.where(first, near, far), np.where(first, far, near), t[:, 2]], axis=1)

    n = 24
    mesh = grid((n, n, 1), round_off_the_square)
    for axis, order in enumerate(([2, 0, 1], [1, 2, 0], [0, 1, 2])):
        nodes = (mesh.nodes * [0.03, 0.03, 0.1])[:, order]
        mass, _, inertia = mass_properties(nodes, mesh.cells, DENSITY)
        expected_mass, expected = cylinder(0.03, 0.1, DENSITY, axis)
        # A rim of 4 n chords encloses (pi/(2n))^2 / 6 too little area and, its radius squared
        # going with the area, twice that too little second moment: 0.07 % and 0.14 %.
        deficit = (0.5 * np.pi / n) ** 2 / 6.0
        assert mass == pytest.approx(expected_mass * (1.0 - deficit), rel=0.1 * deficit)
        spin = expected[axis, axis] * (1.0 - 2.0 * deficit)
        assert inertia[axis, axis] == pytest.approx(spin, rel=0.2 * deficit)
        np.testing.assert_allclose(inertia, expected, atol=2.2 * deficit * expected.max())
    # Archimedes: a sphere's slices weigh what a cone's miss of the cylinder: by quadrature.
    x, w = np.polynomial.legendre.leggauss(4)
    slices = DENSITY * np.pi * 0.03**3 * (1.0 - x**2) * w
    mass, inertia = sphere(0.03, DENSITY)
    assert mass == pytest.approx(slices.sum(), rel=ROUND_OFF)
    spin = 0.5 * (slices * 0.03**2 * (1.0 - x**2)).sum()  # each slice a disc, m r^2 / 2
    np.testing.assert_allclose(inertia, spin * np.eye(3), atol=ROUND_OFF * spin)


def test_bad_bodies_are_named() -> None:
    good = {"names": ("servo",), "mass": np.ones(1), "inertia": np.eye(3)[None], "free": ALL[None]}
    RigidBodies(**good)
    skew = np.eye(3)
    skew[0, 1] = 1e-3
    for change, text in (
        ({"mass": np.array([0.0])}, "rigid body servo: mass must be finite and > 0"),
        ({"mass": np.array([np.nan])}, "rigid body servo: mass"),
        ({"inertia": skew[None]}, "rigid body servo: inertia must be symmetric"),
        ({"inertia": np.diag([1.0, 2.0, -1.0])[None]}, "rigid body servo: .*positive definite"),
        ({"inertia": np.diag([1.0, 2.0, 0.0])[None]}, "rigid body servo: .*positive definite"),
        ({"inertia": np.full((1, 3, 3), np.inf)}, "rigid body servo: inertia must be finite"),
        ({"inertia": np.eye(3)}, "inertia must have shape"),
        ({"mass": np.ones(2)}, "mass must have shape"),
        ({"free": np.ones((1, 6))}, "free must be True or False"),
        ({"free": ALL[None, :3]}, "free must be True or False"),
    ):
        with pytest.raises(InputError, match=text):
            RigidBodies(**{**good, **change})
    with pytest.raises(InputError, match="names of rigid bodies must differ"):
        RigidBodies(("a", "a"), np.ones(2), np.stack([np.eye(3)] * 2), np.stack([ALL] * 2))
    with pytest.raises(InputError, match="centres must have shape"):
        RigidBodies(**good).initial_state(np.zeros(3))
    with pytest.raises(InputError, match="rigid body servo: centre must be finite"):
        RigidBodies(**good).initial_state(np.full((1, 3), np.nan))
    mesh = grid((2, 1, 1))
    with pytest.raises(InputError, match="hexahedron 1 is folded or inside out"):
        mass_properties(mesh.nodes, np.stack([mesh.cells[0], np.roll(mesh.cells[1], 4)]), 1.0)
    with pytest.raises(InputError, match="at least one hexahedron"):
        mass_properties(mesh.nodes, mesh.cells[:0], 1.0)
    with pytest.raises(InputError, match="axis must be 0, 1 or 2"):
        cylinder(1.0, 1.0, 1.0, 3)


def test_a_model_keeps_its_own_arrays() -> None:
    mass = np.ones(1)
    bodies = RigidBodies(("a",), mass, np.eye(3)[None], ALL[None])
    mass[0] = -1.0
    assert bodies.mass[0] == 1.0


def test_no_bodies_at_all() -> None:
    bodies = RigidBodies.empty()
    state = bodies.initial_state(np.empty((0, 3)))
    x, v = np.ones((4, 3)), np.ones((4, 3))
    owner, owned = np.full(4, -1), np.empty(0, dtype=np.int64)
    rigid_kernels.sum_loads(x, v, owned, owner, state[0], np.empty((0, 6)))
    data = bodies.mass, bodies.inertia, bodies.free
    rigid_kernels.kick(1.0, np.empty((0, 6)), *data, *state[1:])
    rigid_kernels.drift(1.0, *data, *state)
    rigid_kernels.place(owned, owner, x, *data[1:], *state, x, v)
    assert rigid_kernels.kinetic(*data, *state[1:]) == 0.0
    assert (x == 1.0).all() and (v == 1.0).all()


# --- kernels


def _carried(
    bodies: RigidBodies, each: int = 7, others: int = 5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Owned nodes, owner and local positions; free nodes first, the owned ones shuffled."""
    random = np.random.default_rng(11)
    owner = np.full(others + each * bodies.count, -1)
    owner[others:] = random.permutation(np.repeat(np.arange(bodies.count), each))
    owned = np.flatnonzero(owner >= 0)
    local = 0.02 * random.normal(size=(len(owner), 3))
    local[:others] = np.nan  # no business of the bodies
    return owned, owner, local


def test_weight_and_mass_damping_and_their_energies() -> None:
    """A kick under both, and the works of a first-order step, by hand."""
    bodies = _bodies(ALL, ALL, ALL)
    random = np.random.default_rng(5)
    _, q, v, momentum = bodies.initial_state(random.normal(size=(3, 3)))
    v[:] = random.normal(size=(3, 3))
    momentum[:] = 1e-3 * random.normal(size=(3, 3))
    load = random.normal(size=(3, 6))
    first, turning, push = v.copy(), momentum.copy(), load.copy()
    data = bodies.mass, bodies.inertia, bodies.free
    gravity, damping, h = np.array([0.5, 0.0, -9.8]), 3.0, 1e-3
    energy = rigid_kernels.kinetic(*data, q, v, momentum)
    spin = energy - 0.5 * float((bodies.mass[:, None] * v**2).sum())
    before, out = np.empty((3, 3)), np.empty(2)
    rigid_kernels.kick_weighed(h, gravity, damping, load, *data, q, v, momentum, before, out)
    expected = first + h * (push[:, :3] / bodies.mass[:, None] + gravity - damping * first)
    np.testing.assert_allclose(v, expected, rtol=ROUND_OFF)
    np.testing.assert_allclose(
        momentum, turning + h * (push[:, 3:] - damping * turning), rtol=ROUND_OFF
    )
    np.testing.assert_array_equal(before, first)
    mean = 0.5 * (energy + rigid_kernels.kinetic(*data, q, v, momentum))
    assert out[0] == pytest.approx(mean, rel=ROUND_OFF)
    along = float((bodies.mass[:, None] * first * 0.5 * (first + v)).sum())
    assert out[1] == pytest.approx(-h * damping * (along + 2.0 * spin), rel=ROUND_OFF)


def test_loads_are_the_sums_of_forces_and_cross_products() -> None:
    bodies = _bodies(ALL, ALL, ALL)
    owned, owner, _ = _carried(bodies)
    random = np.random.default_rng(1)
    x, force = random.normal(size=(2, len(owner), 3))
    rigid_x = random.normal(size=(3, 3))
    load = np.full((3, 6), np.nan)  # what was there before must not matter
    rigid_kernels.sum_loads(x, force, owned, owner, rigid_x, load)
    for k in range(3):
        mine = owner == k
        np.testing.assert_allclose(load[k, :3], force[mine].sum(axis=0), atol=1e-14)
        torque = np.cross(x[mine] - rigid_x[k], force[mine]).sum(axis=0)
        np.testing.assert_allclose(load[k, 3:], torque, atol=1e-14)  # sums of size 10


@pytest.mark.parametrize("turns", ["111", "010", "000", "101", "110", "011", "001"])
def test_placed_nodes_move_as_one_body(turns: str) -> None:
    # The digits: may turn about x, y, z.
    free = np.array([True, False, True] + [digit == "1" for digit in turns])
    bodies = _bodies(free, ALL)
    state = _random_state(bodies)
    owned, owner, local = _carried(bodies)
    x, v = np.full((2, len(owner), 3), 7.0)
    rigid_kernels.place(owned, owner, local, bodies.inertia, bodies.free, *state, x, v)
    rigid_x, rigid_q, rigid_v, rigid_l = state
    energy = 0.0
    for k in range(2):
        mine = owner == k
        r = local[mine] @ _rotation(rigid_q[k]).T
        np.testing.assert_allclose(x[mine], rigid_x[k] + r, atol=1e-15)
        omega = _omega(bodies.inertia[k], bodies.free[k], rigid_q[k], rigid_l[k])
        # Condition number of the inertia (about 10) times round-off of a sum.
        np.testing.assert_allclose(v[mine], rigid_v[k] + np.cross(omega, r), atol=1e-14)
        energy += 0.5 * (bodies.mass[k] * rigid_v[k] @ rigid_v[k] + omega @ rigid_l[k])
    assert (x[owner < 0] == 7.0).all() and (v[owner < 0] == 7.0).all()
    data = bodies.mass, bodies.inertia, bodies.free
    assert rigid_kernels.kinetic(*data, *state[1:]) == pytest.approx(energy, rel=ROUND_OFF)


def test_velocities_are_the_difference_of_positions() -> None:
    # Trapezium rule over one drift: (x1 - x0)/dt = (v0 + v1)/2 + O(dt^2), so halving dt
    # quarters the error. 5 % of slack for the next order at these angles (0.02 rad and less).
    bodies = _bodies(ALL, PLANAR)
    owned, owner, local = _carried(bodies)
    data = bodies.mass, bodies.inertia, bodies.free
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        state = _random_state(bodies)
        x, v = np.zeros((2, 2, len(owner), 3))
        rigid_kernels.place(owned, owner, local, *data[1:], *state, x[0], v[0])
        rigid_kernels.drift(dt, *data, *state)
        rigid_kernels.place(owned, owner, local, *data[1:], *state, x[1], v[1])
        gap = (x[1] - x[0]) / dt - v.mean(axis=0)
        errors.append(np.abs(gap[owned]).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all(np.abs(ratios - 4.0) < 0.2), (errors, ratios)


def test_work_of_nodal_forces_is_the_change_of_kinetic_energy() -> None:
    # h f . (v_before + v_after)/2 = T_after - T_before at one attitude, locks or not: T is
    # quadratic in the momenta. Tolerance: round-off of the two energies.
    bodies = _bodies(ALL, PLANAR, np.array([1, 1, 0, 0, 1, 1], bool), ALL & False)
    state = _random_state(bodies)
    owned, owner, local = _carried(bodies)
    data = bodies.mass, bodies.inertia, bodies.free
    force = np.random.default_rng(8).normal(size=(len(owner), 3))
    force[owner < 0] = np.nan  # no business of the bodies
    x, v = np.zeros((2, 2, len(owner), 3))
    rigid_kernels.place(owned, owner, local, *data[1:], *state, x[0], v[0])
    load = np.empty((bodies.count, 6))
    rigid_kernels.sum_loads(x[0], force, owned, owner, state[0], load)
    before = rigid_kernels.kinetic(*data, *state[1:])
    rigid_kernels.kick(0.01, load, *data, *state[1:])
    after = rigid_kernels.kinetic(*data, *state[1:])
    rigid_kernels.place(owned, owner, local, *data[1:], *state, x[1], v[1])
    assert (x[0] == x[1]).all()
    work = 0.01 * (force * v.mean(axis=0))[owned].sum()
    assert after - before == pytest.approx(work, abs=ROUND_OFF * after)


# --- locked axes


def test_a_planar_body_moves_in_its_plane_only() -> None:
    # Under a constant load leapfrog is exact: x = F t^2 / 2m, angle = T_y t^2 / 2 I_yy, though
    # the inertia couples the axes and the load pulls at all of them.
    bodies = _bodies(PLANAR)
    inertia = bodies.inertia[0]
    assert np.abs(inertia[1, [0, 2]]).min() > 0.01 * inertia[1, 1]  # coupled indeed
    data = bodies.mass, bodies.inertia, bodies.free
    state = bodies.initial_state(np.array([[0.1, 0.2, 0.3]]))
    rigid_x, rigid_q, rigid_v, rigid_l = state
    rigid_v[:] = 0.0, 3.0, 0.0  # a lock takes what it meets
    rigid_l[:] = 1.0, 0.0, 1.0
    load = np.array([[0.3, 0.5, -0.2, 0.7, 0.02, -0.9]])
    steps, dt = 200, 1e-3
    for n in range(steps):
        rigid_kernels.kick(dt if n else 0.5 * dt, load, *data, *state[1:])
        rigid_kernels.drift(dt, *data, *state)
    assert (rigid_v[0, 1], rigid_l[0, 0], rigid_l[0, 2]) == (0.0, 0.0, 0.0)
    assert (rigid_x[0, 1], rigid_q[0, 1], rigid_q[0, 3]) == (0.2, 0.0, 0.0)
    t = steps * dt
    path = [0.1 + 0.5 * 0.3 / bodies.mass[0] * t**2, 0.3 - 0.5 * 0.2 / bodies.mass[0] * t**2]
    np.testing.assert_allclose(rigid_x[0, [0, 2]], path, rtol=1e-12)  # 200 additions
    angle = 0.5 * 0.02 / inertia[1, 1] * t**2
    assert 0.01 < angle < 3.0
    np.testing.assert_allclose(
        rigid_q[0, [0, 2]], [np.cos(0.5 * angle), np.sin(0.5 * angle)], atol=1e-12
    )


def test_a_body_that_may_not_turn() -> None:
    bodies = _bodies(np.array([1, 1, 1, 0, 0, 0], bool))
    data = bodies.mass, bodies.inertia, bodies.free
    state = bodies.initial_state(np.zeros((1, 3)))
    load = np.random.default_rng(4).normal(size=(1, 6))
    for _ in range(10):
        rigid_kernels.kick(0.1, load, *data, *state[1:])
        rigid_kernels.drift(0.1, *data, *state)
    # Not by round-off: nothing may be left of the torque.
    assert (state[1] == [1.0, 0.0, 0.0, 0.0]).all()
    assert (state[3] == 0.0).all()
    # v = F t / m, and the moving part alone is energy; round-off of ten sums.
    np.testing.assert_allclose(state[2], load[:, :3] / bodies.mass[:, None], rtol=1e-14)
    energy = 0.5 * bodies.mass[0] * np.sum(state[2] ** 2)
    assert rigid_kernels.kinetic(*data, *state[1:]) == pytest.approx(energy, rel=1e-14)
