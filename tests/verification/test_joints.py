"""Joints and servos against closed forms and conservation laws."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.dynamics import joint_kernels as jk
from flexapod.dynamics.integrator import Options, energies, march, step
from flexapod.dynamics.joints import Joint, JointSystem, Servo
from flexapod.dynamics.model import Model, State
from flexapod.dynamics.rigid import RigidBodies, box
from flexapod.dynamics.workspace import Workspace


class Still:
    """The same angles at all times."""

    def __init__(self, *angles: float) -> None:
        self.angles = np.array(angles)

    def targets(self, time: float) -> np.ndarray:
        return self.angles

    def rates(self, time: float) -> np.ndarray:
        return np.zeros_like(self.angles)


class Jump(Still):
    """Zero at the start, the angles from then on."""

    def targets(self, time: float) -> np.ndarray:
        return self.angles if time > 0.0 else 0.0 * self.angles


class Swing(Still):
    """A slow swing about the angles."""

    def targets(self, time: float) -> np.ndarray:
        return self.angles + 0.6 * np.sin(9.0 * time + np.arange(len(self.angles)))

    def rates(self, time: float) -> np.ndarray:
        return 0.6 * 9.0 * np.cos(9.0 * time + np.arange(len(self.angles)))


LEG = (0.012, 0.012, 0.05)
HIP = 0.02  # half of the leg's length less what sticks out above the hip


def two_legged(
    command: Still | Feeling,
    servo: Servo | None = None,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    torso_free: bool = True,
) -> tuple[Model, State, Workspace]:
    """A box with a leg on each side that turns about y."""
    torso, leg = box((0.1, 0.08, 0.04), 1000.0), box(LEG, 1200.0)
    free = np.ones((3, 6), dtype=bool)
    free[0] = torso_free
    bodies = RigidBodies(
        ("torso", "left", "right"),
        np.array([torso[0], leg[0], leg[0]]),
        np.array([torso[1], leg[1], leg[1]]),
        free,
    )
    centres = np.array([[0.0, 0.0, 0.0], [0.01, 0.05, -HIP], [0.01, -0.05, -HIP]])
    joints = [
        Joint("left", "torso", "left", (0.01, 0.05, 0.0), servo=servo or Servo()),
        Joint("right", "torso", "right", (0.01, -0.05, 0.0), servo=servo or Servo()),
    ]
    model = Model(
        None,
        rigid=bodies,
        rigid_centres=centres,
        joints=JointSystem(joints, bodies, centres, command),
        gravity=gravity,
    )
    return model, model.start(), Workspace(model)


class Feeling:
    """A quarter turn of the first leg once the torso has turned by five radians."""

    def __init__(self, at: float) -> None:
        self.at = at

    def nothing_begun(self) -> np.ndarray:
        return np.full(1, math.inf)

    def sense(self, time: float, turn: float, begun: np.ndarray) -> None:
        if begun[0] == math.inf and turn >= self.at:
            begun[0] = time

    def targets(self, time: float, begun: np.ndarray | None = None) -> np.ndarray:
        on = begun is not None and time >= begun[0]
        return np.array([0.5 * math.pi if on else 0.0, 0.0])

    def rates(self, time: float, begun: np.ndarray | None = None) -> np.ndarray:
        return np.zeros(2)


@pytest.mark.parametrize(("spin", "begins"), [(50.0, 0.1), (-50.0, math.inf)])
def test_servos_feel_how_far_their_robot_has_turned(spin: float, begins: float) -> None:
    """Whole turns are counted on, from wherever it lay at first; turned back nothing begins."""
    dt = 2e-5
    model, state, work = two_legged(Feeling(5.0), torso_free=False)
    first = 0.5 * 2.0  # half of two radians: it lies turned by these
    state.rigid_q[0] = [math.cos(first), 0.0, math.sin(first), 0.0]
    for k in range(round(0.12 / dt)):
        state.time = k * dt
        angle = first + 0.5 * spin * state.time
        state.rigid_q[0] = [math.cos(angle), 0.0, math.sin(angle), 0.0]
        step(model, state, work, dt)
    assert state.joints["begun"][0] == pytest.approx(begins, abs=1.01 * dt)
    assert state.joints["turn"][0] == pytest.approx(2.0 + spin * (0.12 - dt), abs=1e-9)
    kept = State.from_arrays(*state.to_arrays())
    np.testing.assert_array_equal(kept.joints["turn"], state.joints["turn"])
    np.testing.assert_array_equal(kept.joints["begun"], state.joints["begun"])
    state.begin_anew()
    assert not {"begun", "turn"} & set(state.joints)


def momenta(model: Model, state: State) -> np.ndarray:
    """Momentum, and angular momentum about the origin."""
    p = model.rigid.mass[:, None] * state.rigid_v
    turn = state.rigid_l + np.cross(state.rigid_x, p)
    return np.concatenate([p.sum(axis=0), turn.sum(axis=0)])


def swung(dt: float) -> tuple[Model, State, np.ndarray, float]:
    """Legs swinging in space for 0.4 s: the momenta at the start, and the worst of the books.

    Told their targets' rates, they start with a kick; without, round-off hides the order.
    """
    model, state, work = two_legged(Swing(0.4, -0.2), Servo(rate_weight=1.0))
    state.rigid_v[:] = [0.1, 0.0, 0.2]
    begun = momenta(model, state)
    seen: list[float] = []
    for k in range(round(0.4 / dt)):
        state.time = k * dt
        step(model, state, work, dt, lambda: seen.append(energies(model, state, work).unaccounted))
    return model, state, begun, float(np.abs(seen).max())


def test_free_robot_keeps_its_momentum_and_its_books() -> None:
    """Swinging legs in space: forces are inner ones, and the servos' work is all that comes in.

    Momentum: kicks and drifts of a step change it by nothing but round-off of 20,000 of them; the
    centres move by dt v between kicks, which changes no r x p. Energy: the leapfrog's error, of
    the second order: measured 5e-9 and 1.3e-9 of the work at 20 and 10 us.
    """
    worst = []
    for dt in (2e-5, 1e-5):
        model, state, begun, unaccounted = swung(dt)
        size = np.abs(model.rigid.mass[:, None] * state.rigid_v).sum()
        np.testing.assert_allclose(momenta(model, state)[:3], begun[:3], atol=1e-12 * size)
        spin = np.abs(state.rigid_l).max()
        np.testing.assert_allclose(momenta(model, state)[3:], begun[3:], atol=2e-10 * spin)
        drawn = state.joints["spent"][jk.DRAWN]
        assert drawn > 0.1
        worst.append(unaccounted / drawn)
    assert worst[0] < 1e-7
    assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.1)


def test_joint_holds_point_and_axis() -> None:
    """Both ends part by force over stiffness.

    A leg of 8.6 g under its weight and the swing's centripetal 9^2 x 0.6^2 x 20 mm (0.6 m/s2):
    under 0.1 N, or 0.2 um; what its start rings adds as much again. Sideways it leans by weight
    times half its width over 200 N m/rad, 3e-6 rad.
    """
    model, state, work = two_legged(Swing(0.0, 3.0), gravity=(0.0, 0.0, -9.8))
    options = Options(interval=1e-3)
    march(model, state, work, 300, options)
    system = model.joints
    assert system is not None
    system.add_loads(
        0.0, model.rigid, state.rigid_x, state.rigid_q, state.rigid_v, state.rigid_l, state.joints
    )
    apart = math.sqrt(2.0 * system.stored[jk.POINTS] / system.stiffness[0, jk.POINT_SPRING])
    assert apart < 1e-6
    tilt = math.sqrt(2.0 * system.stored[jk.AXES] / system.stiffness[0, jk.AXIS_SPRING])
    assert tilt < 1e-4


def test_step_response_is_that_of_the_linear_oscillator() -> None:
    """A held torso, a jump small enough to stay linear: J phi'' = k (r - phi) - d phi'.

    J is the rotor with the leg about the hip; the gear is made so stiff (1e5 N m/rad against a
    controller of 20) that both turn as one: what is left is the ratio of the two, 2e-4, and the
    leapfrog's error, below it.
    """
    servo = Servo(
        proportional=20.0, derivative=0.15, stall_torque=1e6, no_load_speed=1e9, gear_stiffness=1e5
    )
    model, state, work = two_legged(Jump(0.02, -0.02), servo, torso_free=False)
    leg_mass, leg_inertia = model.rigid.mass[1], model.rigid.inertia[1, 1, 1]
    inertia = servo.inertia + leg_inertia + leg_mass * HIP**2
    decay, square = 0.15 / (2.0 * inertia), 20.0 / inertia
    swing = math.sqrt(square - decay**2)
    interval = 1e-3
    for k in range(1, 81):
        march(model, state, work, k, Options(interval=interval))
        t = state.time
        exact = 1.0 - math.exp(-decay * t) * (
            math.cos(swing * t) + decay / swing * math.sin(swing * t)
        )
        got = state.joints["motion"][:, jk.ROTOR]
        np.testing.assert_allclose(got, [0.02 * exact, -0.02 * exact], atol=0.02 * 2e-3)


def test_torque_keeps_to_the_motors_line() -> None:
    """At rest the stall torque, falling to nothing at the no-load speed; braking up to stall."""
    assert jk.motor_torque(9.0, 0.0, 2.0, 6.0) == 2.0
    assert jk.motor_torque(9.0, 3.0, 2.0, 6.0) == 1.0
    assert jk.motor_torque(9.0, 7.0, 2.0, 6.0) == 0.0
    assert jk.motor_torque(9.0, -3.0, 2.0, 6.0) == 2.0
    assert jk.motor_torque(-9.0, 3.0, 2.0, 6.0) == -2.0
    assert jk.motor_torque(-9.0, -3.0, 2.0, 6.0) == -1.0
    assert jk.motor_torque(0.5, 3.0, 2.0, 6.0) == 0.5


def test_far_target_is_approached_at_the_no_load_speed() -> None:
    """A motor with the line tau = s (1 - w/w0) and inertia J: w = w0 (1 - exp(-s t / (J w0)))."""
    servo = Servo(inertia=0.02)
    model, state, work = two_legged(Jump(60.0, 60.0), servo, torso_free=False)
    leg = model.rigid.inertia[1, 1, 1] + model.rigid.mass[1] * HIP**2
    total = servo.inertia + leg
    rate = servo.stall_torque / (total * servo.no_load_speed)
    for k in range(1, 200):
        march(model, state, work, k, Options(interval=1e-3))
        # Rates are half a step old.
        t = state.time - 0.5 * state.dt_before
        exact = servo.no_load_speed * (1.0 - math.exp(-rate * t))
        motion = state.joints["motion"]
        # The leg swings on its gear by its share of the torque, leg / total, over omega.
        np.testing.assert_allclose(
            motion[:, jk.RATE], exact, atol=2e-3 * servo.no_load_speed, rtol=2e-3
        )
        assert (np.abs(motion[:, jk.MOTOR]) <= servo.stall_torque).all()
    assert motion[0, jk.RATE] > 0.9 * servo.no_load_speed


def test_held_leg_sags_by_the_controllers_stiffness() -> None:
    """A horizontal leg without integral: m g r = k (target - rotor), and the gear's twist."""
    servo = Servo()
    model, state, work = two_legged(
        Still(math.pi / 2, math.pi / 2), servo, gravity=(0.0, 0.0, -9.8), torso_free=False
    )
    march(model, state, work, 1200, Options(interval=1e-3))
    weight = model.rigid.mass[1] * 9.8 * HIP
    motion = state.joints["motion"][0]
    # The leg points to the back: its weight turns it down, against the positive angle.
    torque = weight * math.sin(motion[jk.ANGLE])
    assert motion[jk.ROTOR] - math.pi / 2 == pytest.approx(-torque / servo.proportional, rel=1e-3)
    assert motion[jk.ANGLE] - motion[jk.ROTOR] == pytest.approx(
        -torque / servo.gear_stiffness, rel=1e-2
    )
    integral = dataclasses.replace(servo, integral=300.0)
    model, state, work = two_legged(
        Still(math.pi / 2, math.pi / 2), integral, gravity=(0.0, 0.0, -9.8), torso_free=False
    )
    march(model, state, work, 1500, Options(interval=1e-3))
    sag = abs(state.joints["motion"][0, jk.ROTOR] - math.pi / 2)
    assert sag < 0.01 * torque / servo.proportional


def test_the_integral_does_not_wind_up_while_the_motor_is_at_its_limit() -> None:
    """On the way to a far target the limit is the motor's line, below the stall torque."""
    servo = Servo(integral=50.0)
    model, state, work = two_legged(Jump(3.0, 3.0), servo, torso_free=False)
    for k in range(1, 400):
        march(model, state, work, k, Options(interval=1e-3))
        motion = state.joints["motion"]
        if motion[0, jk.ROTOR] < 2.5:
            assert motion[0, jk.SUM] == 0.0
    assert motion[0, jk.ROTOR] > 2.5


class Turning(Still):
    """Targets at an even rate."""

    def targets(self, time: float) -> np.ndarray:
        return self.angles * time

    def rates(self, time: float) -> np.ndarray:
        return self.angles


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_a_turning_rotor_lags_by_the_part_of_the_rate_it_is_not_told(weight: float) -> None:
    """At an even rate w nothing accelerates: k lag = (1 - weight) d w, after the start is gone.

    The start decays with d/(2 J) of rotor and leg together, 60 per second at least: by exp(-18). A
    rate is half a step old: 2 rad/s in half of a step of at most 0.1 ms is 1e-4 rad.
    """
    servo = Servo(rate_weight=weight, no_load_speed=1e6)
    model, state, work = two_legged(Turning(2.0, -2.0), servo, torso_free=False)
    march(model, state, work, 300, Options(interval=1e-3))
    motion = state.joints["motion"]
    lag = (1.0 - weight) * servo.rate_gain * 2.0 / servo.proportional
    behind = np.array([2.0, -2.0]) * state.time - motion[:, jk.ROTOR]
    np.testing.assert_allclose(behind, [lag, -lag], atol=1e-4)


def test_a_corner_of_the_target_kicks_only_where_its_rate_is_told() -> None:
    """The first torque after a start at 2 rad/s: d w at once, or what the error has grown to."""
    for weight in (0.0, 1.0):
        servo = Servo(rate_weight=weight, no_load_speed=1e6)
        model, state, work = two_legged(Turning(2.0, -2.0), servo, torso_free=False)
        march(model, state, work, 1, Options(interval=1e-5))
        kick = abs(state.joints["motion"][0, jk.MOTOR])
        assert kick == pytest.approx(weight * servo.rate_gain * 2.0, rel=2e-2, abs=1e-2)


def test_turns_are_counted_and_a_state_comes_back() -> None:
    """Three turns on, and a state that went through arrays goes on with the same bits."""
    model, state, work = two_legged(Turning(6.0, -6.0), Servo(no_load_speed=60.0))
    march(model, state, work, 1500, Options(interval=1e-3))
    arrays, about = state.to_arrays()
    again = State.from_arrays(arrays, about)
    march(model, state, work, 3200, Options(interval=1e-3))
    assert state.joints["motion"][:, jk.ANGLE] == pytest.approx([19.2, -19.2], abs=0.2)
    fresh, _, anew = two_legged(Turning(6.0, -6.0), Servo(no_load_speed=60.0))
    march(fresh, again, anew, 3200, Options(interval=1e-3))
    for name, value in state.to_arrays()[0].items():
        np.testing.assert_array_equal(again.to_arrays()[0][name], value, err_msg=name)


def test_bad_joints_are_named() -> None:
    torso = box((0.1, 0.08, 0.04), 1000.0)
    bodies = RigidBodies(("torso",), np.array([torso[0]]), torso[1][None], np.ones((1, 6), bool))
    with pytest.raises(InputError, match=r"joint leg: there is no rigid body 'foot'.*torso"):
        JointSystem(
            [Joint("leg", "torso", "foot", (0.0, 0.0, 0.0))], bodies, np.zeros((1, 3)), Still(0.0)
        )
    with pytest.raises(InputError, match="cannot be its own parent"):
        JointSystem(
            [Joint("leg", "torso", "torso", (0.0, 0.0, 0.0))], bodies, np.zeros((1, 3)), Still(0.0)
        )
    with pytest.raises(InputError, match="axis must have length 1"):
        Joint("leg", "torso", "foot", (0.0, 0.0, 0.0), axis=(0.0, 2.0, 0.0))
    with pytest.raises(InputError, match="stall_torque must be finite and > 0"):
        Servo(stall_torque=0.0)


def test_body_on_held_legs_sags_as_statics_says() -> None:
    """A soft bar bonded to a station between two legs that are held in space by their servos.

    Statics: the same bar with the station's nodes fixed, under its weight. Bearings and gears give
    way by weight over stiffness, 0.2 N over twice 500 N/mm or 2e-4 of the sag of 1 mm, and nothing
    turns, by symmetry; after 12 e-foldings of the mass damping 1e-5 of the swing is left. Measured
    1.6e-4.
    """
    from statics_helpers import TIGHT, grid, solid

    from flexapod.dynamics.model import Damping
    from flexapod.fem.loads import Displacement
    from flexapod.fem.loads import gravity as weight_of
    from flexapod.fem.static import LoadStep, PathOptions, StaticProblem, solve_path
    from flexapod.materials.neo_hooke import NeoHooke

    mesh = grid((9, 2, 2), lambda x: (x - [0.5, 0.5, 0.5]) * [0.09, 0.016, 0.012])
    body = solid(mesh, NeoHooke(72.8e3), 0.45, 1080.0)
    held = np.flatnonzero(np.abs(mesh.nodes[:, 0]) < 0.0051)
    assert held.size == 18
    gravity = (0.0, 0.0, -9.8)
    fixed = [Displacement("station", held, axis) for axis in range(3)]
    problem = StaticProblem(body, fixed, [weight_of("gravity", body.node_mass, gravity)])
    answer = solve_path(problem, [LoadStep("weight", {"gravity": 1.0})], PathOptions(newton=TIGHT))
    tip = int(np.argmax(mesh.nodes[:, 0] + mesh.nodes[:, 2]))
    exact = float(answer.state.u[tip, 2])
    assert exact < -2e-4

    leg, station = box(LEG, 1200.0), box((0.01, 0.016, 0.012), 1080.0)
    free = np.ones((3, 6), dtype=bool)
    free[1:] = False  # the legs' feet stand
    bodies = RigidBodies(
        ("station", "left", "right"),
        np.array([station[0], leg[0], leg[0]]),
        np.array([station[1], leg[1], leg[1]]),
        free,
    )
    centres = np.array([[0.0, 0.0, 0.0], [0.0, 0.02, -HIP], [0.0, -0.02, -HIP]])
    joints = [
        Joint("left", "station", "left", (0.0, 0.02, 0.0)),
        Joint("right", "station", "right", (0.0, -0.02, 0.0)),
    ]
    model = Model(
        body,
        rigid=bodies,
        rigid_centres=centres,
        tied={"station": held},
        joints=JointSystem(joints, bodies, centres, Still(0.0, 0.0)),
        gravity=gravity,
        damping=Damping(mass=60.0),
    )
    state = model.start()
    march(model, state, Workspace(model), 80, Options(interval=5e-3))
    assert state.u[tip, 2] == pytest.approx(exact, rel=5e-4)
    # What the legs bear is the weight of all that does not stand: half each, by the bearings.
    system = model.joints
    assert system is not None
    weight = 9.8 * (body.node_mass.sum() - body.node_mass[held].sum() + station[0])
    bent = state.x[held].mean(axis=0)[2] - mesh.nodes[held].mean(axis=0)[2]
    assert -bent == pytest.approx(weight / (2.0 * 5e5), rel=0.02)
