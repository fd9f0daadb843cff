"""Free and driven rigid bodies against Euler's equations and their closed solutions.

Angles per step are small, as in an explicit run: |omega| dt of 0.1 rad and less (a soft body's
stable step leaves 1e-4).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from flexapod.dynamics import rigid_kernels
from flexapod.dynamics.rigid import RigidBodies, cylinder

MOMENTS = np.array([1.0, 2.0, 3.5])  # [kg m2]
# Almost about the intermediate axis: the body turns over again and again.
INTERMEDIATE = np.array([0.02, 1.0, 0.01])  # [rad/s], body axes
GENERIC = np.array([0.5, 0.6, 0.4])
SPINS = pytest.mark.parametrize("omega", [GENERIC, INTERMEDIATE], ids=["generic", "intermediate"])

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _rotation(q: np.ndarray) -> np.ndarray:
    """R(q) by v + 2 w (u x v) + 2 u x (u x v) on the unit vectors, q = (w, u)."""
    cross = np.cross(q[1:], np.eye(3)).T
    return np.asarray(np.eye(3) + 2.0 * q[0] * cross + 2.0 * cross @ cross)


def _body(inertia: np.ndarray, mass: float = 1.0) -> RigidBodies:
    return RigidBodies(("b",), np.array([mass]), inertia[None], np.ones((1, 6), dtype=bool))


def _spinning(inertia: np.ndarray, omega: np.ndarray) -> tuple[RigidBodies, State]:
    bodies = _body(inertia)
    state = bodies.initial_state(np.zeros((1, 3)))
    state[3][0] = inertia @ omega
    return bodies, state


def _energies(omega: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """Kinetic energy after each step of a free body, shape (steps + 1,)."""
    bodies, state = _spinning(np.diag(MOMENTS), omega)
    data = bodies.mass, bodies.inertia, bodies.free
    energy = np.empty(steps + 1)
    energy[0] = rigid_kernels.kinetic(*data, *state[1:])
    for n in range(steps):
        rigid_kernels.drift(dt, *data, *state)
        energy[n + 1] = rigid_kernels.kinetic(*data, *state[1:])
    return energy


@SPINS
def test_free_body_keeps_the_momenta_of_its_points(omega: np.ndarray) -> None:
    # d/dt sum m r x v = 0 and d/dt sum m v = 0, with the points' velocities from `place`.
    random = np.random.default_rng(3)
    points, masses = random.normal(size=(9, 3)), random.uniform(0.5, 1.5, 9)
    points -= masses @ points / masses.sum()
    inertia = masses @ np.sum(points**2, axis=1) * np.eye(3) - (points.T * masses) @ points
    bodies = _body(inertia, masses.sum())
    state = bodies.initial_state(np.zeros((1, 3)))
    axes = np.linalg.eigh(inertia)[1]
    state[2][0] = 0.3, -0.2, 0.1
    state[3][0] = inertia @ axes @ omega
    start = state[3][0].copy()
    data = bodies.mass, bodies.inertia, bodies.free
    owner = np.zeros(9, dtype=np.int64)
    x, v = np.empty((2, 9, 3))
    for n in range(2000):
        rigid_kernels.drift(0.02, *data, *state)
        if n % 100:
            continue
        rigid_kernels.place(np.arange(9), owner, points, *data[1:], *state, x, v)
        momentum = masses @ np.cross(x, v)
        # Round-off: measured 2e-15 of |L|, the inertia's condition number below 10.
        np.testing.assert_allclose(
            momentum - np.cross(state[0][0], masses @ v), start, atol=1e-13 * np.abs(start).max()
        )
        np.testing.assert_allclose(masses @ v, masses.sum() * state[2][0], atol=1e-13)
    assert (state[3][0] == start).all()
    assert np.linalg.norm(state[1][0]) == pytest.approx(1.0, abs=1e-15)


@SPINS
def test_energy_of_a_free_body_oscillates_by_dt_squared(omega: np.ndarray) -> None:
    # T = L . I^-1 L / 2 is constant; the midpoint rule leaves an oscillation of order dt^2.
    # Slope within 0.1, over the same 40 s each (the intermediate axis turns over in 13 s).
    steps = np.array([400, 800, 1600])
    swing = [np.ptp(_energies(omega, 40.0 / n, n)) for n in steps]
    slopes = np.log2(np.array(swing[:-1]) / swing[1:])
    print("swing", swing, "slopes", slopes)
    assert np.all(np.abs(slopes - 2.0) < 0.1), (swing, slopes)


@SPINS
def test_energy_of_a_free_body_does_not_drift(omega: np.ndarray) -> None:
    # Over 1e5 steps of 0.01 rad the band in which T oscillates stays where it was.
    energy = _energies(omega, 0.01, 100_000)
    swing = np.ptp(energy[:10_000])
    early, late = energy[:10_000], energy[-10_000:]
    print("swing", swing, "shift", late.max() - early.max(), late.min() - early.min())
    # Three rounds leave a drift of order dt^5: measured 6e-5 of the band, twice that allowed.
    assert abs(late.max() - early.max()) < 1.2e-4 * swing
    assert abs(late.min() - early.min()) < 1.2e-4 * swing


def _jacobi(first: float, last: float) -> tuple[Callable[[float], np.ndarray], float]:
    """Euler's free body with omega = (first, 0, last) at t = 0, and its quarter period.

    L. D. Landau & E. M. Lifshitz, Mechanics, section 37, for I1 < I2 < I3 and L^2 > 2 E I2:
    omega = (a cn, b sn, c dn)(tau), where L^2 - 2 E I1 etc. follow from the start.
    """
    i1, i2, i3 = MOMENTS
    energy2 = i1 * first**2 + i3 * last**2
    momentum2 = (i1 * first) ** 2 + (i3 * last) ** 2
    assert momentum2 > energy2 * i2
    rate = np.sqrt((i3 - i2) * (momentum2 - energy2 * i1) / (i1 * i2 * i3))
    m = (i2 - i1) * (energy2 * i3 - momentum2) / ((i3 - i2) * (momentum2 - energy2 * i1))
    b = np.sqrt((energy2 * i3 - momentum2) / (i2 * (i3 - i2)))

    def omega(t: float) -> np.ndarray:
        sn, cn, dn, _ = ellipj(rate * t, m)
        return np.array([first * cn, b * sn, last * dn])

    return omega, float(ellipk(m) / rate)


@pytest.mark.parametrize(
    ("beyond", "baseline"), [(2.0, 6.8e-5), (1.01, 1.02e-2)], ids=["generic", "near the separatrix"]
)
def test_free_body_follows_jacobis_functions(beyond: float, baseline: float) -> None:
    # On the separatrix L^2 = 2 E I2: i1 (i2 - i1) w1^2 = i3 (i3 - i2) w3^2, where the body
    # dwells at the intermediate axis; the second case passes it by 1 %.
    i1, i2, i3 = MOMENTS
    edge = np.sqrt(i1 * (i2 - i1) / (i3 * (i3 - i2)))
    exact, quarter = _jacobi(1.0, beyond * edge)
    errors = []
    for steps in (200, 400, 800):
        bodies, state = _spinning(np.diag(MOMENTS), exact(0.0))
        data = bodies.mass, bodies.inertia, bodies.free
        dt = 4.0 * quarter / steps
        error = 0.0
        for n in range(steps):
            rigid_kernels.drift(dt, *data, *state)
            omega = (_rotation(state[1][0]).T @ state[3][0]) / MOMENTS
            error = max(error, float(np.abs(omega - exact((n + 1) * dt)).max()))
        errors.append(error)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    print("errors", errors, "slopes", slopes)
    # Second order in the attitude: slope within 0.1. The last error [rad/s] measured, with a
    # margin of a tenth; near the separatrix a late turnover is most of it.
    assert np.all(np.abs(slopes - 2.0) < 0.1), (errors, slopes)
    assert errors[-1] < 1.1 * baseline


def test_free_symmetric_top_precesses_at_its_rate() -> None:
    # The axis of a free symmetric top turns about L at |L| / I_across, and keeps its tilt.
    mass, inertia = cylinder(0.05, 0.02, 2700.0, axis=2)
    tilt, size = 0.4, 0.02
    bodies = _body(inertia, mass)
    data = bodies.mass, bodies.inertia, bodies.free
    rate = size / inertia[0, 0]
    errors = []
    for steps in (100, 200):
        state = bodies.initial_state(np.zeros((1, 3)))
        state[3][0] = 0.0, 0.0, size
        state[1][0] = np.cos(0.5 * tilt), 0.0, np.sin(0.5 * tilt), 0.0  # axis towards x
        dt = 2.0 * np.pi / rate / steps
        error = 0.0
        for n in range(steps):
            rigid_kernels.drift(dt, *data, *state)
            angle = rate * (n + 1) * dt
            axis = np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)
            error = max(error, float(np.abs(_rotation(state[1][0])[:, 2] - axis).max()))
        errors.append(error)
    slope = np.log2(errors[0] / errors[1])
    print("errors", errors, "slope", slope)
    # Second order (slope within 0.1); 200 steps a turn measured 6.0e-5, a tenth of margin.
    assert abs(slope - 2.0) < 0.1
    assert errors[1] < 6.6e-5


def test_spinning_top_under_a_torque_precesses_steadily() -> None:
    # Steady precession of a heavy symmetric top about z, torque k sin(tilt) as of a weight on
    # its axis: k = W (I3 w3 - I1 W cos(tilt)) (Landau & Lifshitz, Mechanics, section 35), with
    # W the rate and w3 the spin about the axis. Kick and drift together, half a step apart.
    across, along, tilt, rate, spin = 1.0, 1.6, 0.7, 0.5, 4.0
    strength = rate * (along * spin - across * rate * np.cos(tilt))
    bodies = _body(np.diag([across, across, along]))
    data = bodies.mass, bodies.inertia, bodies.free
    errors = []
    for steps in (800, 1600, 3200):
        state = bodies.initial_state(np.zeros((1, 3)))
        q, momentum = state[1], state[3]
        q[0] = np.cos(0.5 * tilt), 0.0, np.sin(0.5 * tilt), 0.0
        # omega = W z + (w3 - W cos) axis: across the axis only the precession is left.
        turn = _rotation(q[0])
        momentum[0] = turn @ np.array([-across * rate * np.sin(tilt), 0.0, along * spin])
        dt = 2.0 * np.pi / rate / steps
        load = np.zeros((1, 6))
        error = 0.0
        for n in range(steps):
            load[0, 3:] = strength * np.cross([0.0, 0.0, 1.0], _rotation(q[0])[:, 2])
            rigid_kernels.kick(dt if n else 0.5 * dt, load, *data, *state[1:])
            rigid_kernels.drift(dt, *data, *state)
            angle = rate * (n + 1) * dt
            axis = np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)
            error = max(error, float(np.abs(_rotation(q[0])[:, 2] - axis).max()))
        errors.append(error)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    print("errors", errors, "slopes", slopes)
    # Second order over a whole turn (slope within 0.1); the last measured 9.9e-6, a tenth of
    # margin.
    assert np.all(np.abs(slopes - 2.0) < 0.1), (errors, slopes)
    assert errors[-1] < 1.1e-5


def test_projectile_is_exact_for_any_steps() -> None:
    # x = x0 + v0 t + g t^2 / 2: leapfrog's velocity is the exact one at each middle, for steps
    # of any length. Tolerance: round-off of 300 additions to numbers of size 10.
    random = np.random.default_rng(6)
    bodies = _body(np.diag(MOMENTS), 0.7)
    data = bodies.mass, bodies.inertia, bodies.free
    start, speed, g = np.array([0.1, 0.2, 2.0]), np.array([3.0, -1.0, 5.0]), 9.8
    state = bodies.initial_state(start[None])
    state[2][0] = speed
    load = np.array([[0.0, 0.0, -0.7 * g, 0.0, 0.0, 0.0]])
    t, before = 0.0, 0.0
    for dt in random.uniform(1e-3, 6e-3, 300):
        rigid_kernels.kick(0.5 * (before + dt), load, *data, *state[1:])
        rigid_kernels.drift(dt, *data, *state)
        t, before = t + dt, dt
        expected = start + speed * t - [0.0, 0.0, 0.5 * g * t**2]
        np.testing.assert_allclose(state[0][0], expected, atol=1e-13)
    assert t > 2.0 * speed[2] / g * 0.9  # up and down again
    assert (state[1][0] == [1.0, 0.0, 0.0, 0.0]).all()
