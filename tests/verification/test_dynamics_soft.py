"""The explicit engine against closed forms and conservation: soft bodies alone."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from statics_helpers import grid, hold, solid

from flexapod.core.errors import InputError, SolverError, Status
from flexapod.dynamics.commands import ATMOSPHERE, Chamber, PressureTable, Pump, Table
from flexapod.dynamics.integrator import Options, energies, evaluate, kick, march, step
from flexapod.dynamics.model import Bond, Damping, Model, State
from flexapod.dynamics.stable import highest_frequency, scale_mass, stable_step
from flexapod.dynamics.workspace import Workspace
from flexapod.fem.loads import Displacement
from flexapod.fem.static import StaticProblem
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden

DRAGON_SKIN = Ogden((-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285))


def _run(
    model: Model, state: State, dt: float, count: int
) -> tuple[list[float], list[np.ndarray], list[float]]:
    """Times, displacements and unaccounted energies of `count` steps of `dt`."""
    work = Workspace(model)
    times, shapes, rest = [], [], []

    def record() -> None:
        times.append(state.time)
        shapes.append(state.u.copy())
        rest.append(energies(model, state, work).unaccounted)

    for k in range(count):
        state.time = k * dt
        step(model, state, work, dt, record)
    return times, shapes, rest


def _spring(stiffness: float = 4.0, mass: float = 1e-3) -> Model:
    """One cube of vanishing shear stiffness would be no oscillator: confined, it is a spring."""
    mesh = grid((1, 1, 1))
    lame = stiffness  # of a unit cube pulled along x with its sides held: M A / L
    poisson = 0.3
    shear = lame * (1 - 2 * poisson) / (2 * (1 - poisson))
    body = solid(mesh, NeoHooke(shear), poisson, density=mass)
    sides = hold(mesh, x0="x", y0="y", y1="y", z0="z", z1="z")
    return Model(body, displacements=sides)


def _frequency(model: Model) -> float:
    """Of the confined cube's only mode: stiffness M over the half of its mass that moves."""
    body = model.body
    assert body is not None
    shear, poisson = body.materials[0].law.shear_modulus, body.materials[0].poisson
    modulus = 2 * shear * (1 - poisson) / (1 - 2 * poisson)
    return math.sqrt(modulus / (0.5 * body.materials[0].density))


def test_oscillator_is_second_order() -> None:
    """x = a cos(omega t); the leapfrog's phase error is (omega dt)^2 / 24 a cycle's radian."""
    omega = _frequency(_spring())
    errors = []
    counts = [20, 40, 80, 160]
    for per_cycle in counts:
        model = _spring()
        moving = np.flatnonzero(~model.fixed[:, 0])
        u = np.zeros_like(model.nodes)
        u[moving, 0] = 1e-6  # so small that the material is linear
        state = model.start(u)
        dt = 2 * math.pi / omega / per_cycle
        _, shapes, _ = _run(model, state, dt, int(1.75 * per_cycle) + 1)
        errors.append(abs(shapes[-1][moving[0], 0]) / 1e-6)  # zero of the cosine at 7/4
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    # Slope within 0.1 of two, as the style sheet asks; measured -2.00.
    assert slope == pytest.approx(-2.0, abs=0.1)
    # Phase error (omega dt)^2/24 of the angle 7/4 turns, sine one there.
    expected = (2 * math.pi / counts[-1]) ** 2 / 24 * 3.5 * math.pi
    assert errors[-1] == pytest.approx(expected, rel=0.02)  # next term is (omega dt)^4


def test_energy_drift_of_an_undamped_run_goes_with_the_square_of_the_step() -> None:
    """A soft block thrown into large oscillation: stored minus start, without damping."""
    drifts = []
    steps = [1.0, 0.5, 0.25]
    for factor in steps:
        mesh = grid((3, 2, 2), lambda x: x * np.array([0.03, 0.02, 0.02]))
        model = Model(solid(mesh, DRAGON_SKIN, 0.49, 1080.0), displacements=hold(mesh, x0="xyz"))
        u = np.zeros_like(model.nodes)
        u[:, 0] = 0.1 * model.nodes[:, 0]
        state = model.start(u)
        work = Workspace(model)
        base = 0.5 * stable_step(highest_frequency(model, state, work), model)
        _, _, rest = _run(model, state, factor * base, int(400 / factor))
        drifts.append(float(np.abs(rest).max()))
    slope = np.polyfit(np.log(steps), np.log(drifts), 1)[0]
    # Measured 2.0; the order is the scheme's.
    assert slope == pytest.approx(2.0, abs=0.2)


def test_wave_speed_in_a_bar() -> None:
    """A confined bar is a wave guide: c = sqrt((K + 4/3 G)/rho), its lowest mode c/(4 L)."""
    length, cells = 0.2, 100
    mesh = grid((cells, 1, 1), lambda x: x * np.array([length, 0.01, 0.01]))
    shear, poisson, density = 1e5, 0.3, 1000.0
    sides = hold(mesh, x0="x", y0="y", y1="y", z0="z", z1="z")
    model = Model(solid(mesh, NeoHooke(shear), poisson, density), displacements=sides)
    speed = math.sqrt(2 * shear * (1 - poisson) / (1 - 2 * poisson) / density)
    u = np.zeros_like(model.nodes)
    u[:, 0] = 1e-7 * np.sin(0.5 * math.pi * model.nodes[:, 0] / length)
    state = model.start(u)
    tip = int(np.argmax(model.nodes[:, 0]))
    dt = 0.9 * stable_step(highest_frequency(model, state, Workspace(model)), model)
    cycle = 4 * length / speed
    times, shapes, _ = _run(model, state, dt, int(1.1 * cycle / dt))
    tips = np.array([s[tip, 0] for s in shapes])
    falls = np.flatnonzero((tips[:-1] > 0) & (tips[1:] <= 0))[0]
    quarter = np.interp(0.0, -tips[falls : falls + 2], times[falls : falls + 2])
    # Dispersion of linear elements with lumped mass is (k h)^2/24, 1e-5 here; the rest is the
    # interpolation of the crossing. Measured 2e-6.
    assert quarter == pytest.approx(0.25 * cycle, rel=1e-4)


def test_frequency_of_a_cantilever() -> None:
    """The beam swings with the frequency of its own static tangent, and near Euler's formula."""
    from scipy.linalg import eigh

    size = np.array([0.06, 0.006, 0.004])
    mesh = grid((40, 2, 4), lambda x: x * size)
    youngs, poisson, density = 3e5, 0.45, 1000.0
    body = solid(mesh, NeoHooke.from_youngs_modulus(youngs, poisson), poisson, density)
    support = hold(mesh, x0="xyz")
    model = Model(body, displacements=support)
    problem = StaticProblem(body, support, [])
    pattern = problem.tangent(np.zeros_like(model.nodes), {})
    n = 3 * model.node_count
    unit = np.eye(n)
    matrix = np.stack([pattern.product(unit[i].reshape(-1, 3)).ravel() for i in range(n)])
    free = ~model.fixed.ravel()
    mass = np.repeat(model.mass, 3)[free]
    scaled = matrix[np.ix_(free, free)] / np.sqrt(np.outer(mass, mass))
    values, vectors = eigh(scaled, subset_by_index=[0, 0])
    omega = math.sqrt(values[0])
    shape = np.zeros(n)
    shape[free] = vectors[:, 0] / np.sqrt(mass)
    state = model.start(1e-7 * (shape / np.abs(shape).max()).reshape(-1, 3))
    dt = 0.9 * stable_step(highest_frequency(model, state, Workspace(model)), model)
    tip = int(np.argmax(np.abs(shape).reshape(-1, 3)[:, 2]))
    times, shapes, _ = _run(model, state, dt, int(0.5 * 2 * math.pi / omega / dt))
    tips = np.array([s[tip, 2] for s in shapes]) * np.sign(shape.reshape(-1, 3)[tip, 2])
    fall = np.flatnonzero((tips[:-1] > 0) & (tips[1:] <= 0))[0]
    quarter = np.interp(0.0, -tips[fall : fall + 2], times[fall : fall + 2])
    # The leapfrog's (omega dt)^2/24 is below 1e-7 here; geometric nonlinearity of an amplitude of
    # 1e-6 is nothing. Measured 1e-6.
    assert quarter == pytest.approx(0.5 * math.pi / omega, rel=1e-4)
    # Euler-Bernoulli: 1.8751^2 sqrt(EI/(rho A L^4)). Shear and rotary inertia lower it by half a
    # per cent at L/h = 15 (Timoshenko); the held end and the parasitic shear of cells longer than
    # thick (docs/verification.md) raise it. Measured 5.3 %: this only guards against a wrong unit
    # or mass, the comparison above is the test.
    euler = 1.8751041**2 * math.sqrt(youngs * size[2] ** 2 / 12 / density) / size[0] ** 2
    assert omega == pytest.approx(euler, rel=0.08)


@pytest.mark.parametrize("stretch", [1.0, 0.5, 2.0])
def test_the_stable_step_is_a_bound_and_a_close_one(stretch: float) -> None:
    """The largest eigenvalue of the assembled, deformed mesh against the element bound."""
    from scipy.linalg import eigh

    mesh = grid((3, 2, 2), lambda x: x * np.array([0.006, 0.004, 0.003]))
    body = solid(mesh, DRAGON_SKIN, 0.49, 1080.0)
    model = Model(body)
    u = np.zeros_like(model.nodes)
    u[:, 0] = (stretch - 1.0) * model.nodes[:, 0]
    u[:, 1:] = (stretch**-0.5 - 1.0) * model.nodes[:, 1:]
    state = model.start(u)
    bound = highest_frequency(model, state, Workspace(model))
    pattern = StaticProblem(body, [], []).tangent(u, {})
    n = 3 * model.node_count
    matrix = np.stack([pattern.product(e.reshape(-1, 3)).ravel() for e in np.eye(n)])
    mass = np.repeat(model.mass, 3)
    exact = math.sqrt(eigh(matrix / np.sqrt(np.outer(mass, mass)), eigvals_only=True)[-1])
    assert bound >= exact
    # trace(A^8)^(1/8) is up to 24^(1/16) = 1.22 too high in frequency for one element, and the
    # elements round a node do not all have their fastest mode there. Measured 1.30, 1.2 and 1.2.
    assert bound < 1.4 * exact


def test_below_the_stable_step_a_run_stays_and_beyond_it_explodes() -> None:
    mesh = grid((3, 3, 3), lambda x: x * 0.01)
    rng = np.random.default_rng(1)
    noise = 1e-7 * rng.standard_normal((64, 3))

    def largest(factor: float) -> float:
        model = Model(solid(mesh, NeoHooke(1e5), 0.45, 1000.0))
        state = model.start(noise)
        dt = factor * stable_step(highest_frequency(model, state, Workspace(model)), model)
        _, shapes, _ = _run(model, state, dt, 300)
        return float(np.abs(shapes[-1]).max() / np.abs(noise).max())

    assert largest(0.98) < 10.0  # free motion drifts, it does not explode
    # The bound is at most 40 % too careful (above): half as much again is beyond the true limit.
    with pytest.raises(SolverError) as caught:
        largest(1.5)
    assert caught.value.status in (Status.INVERTED_ELEMENT, Status.NOT_FINITE)


def test_mass_scaling_reaches_the_step_asked_for() -> None:
    mesh = grid((4, 2, 2), lambda x: x**1.5 * 0.02)
    model = Model(solid(mesh, DRAGON_SKIN, 0.49, 1080.0))
    state, work = model.start(), None
    work = Workspace(model)
    before = stable_step(highest_frequency(model, state, work), model)
    total = float(model.mass.sum())
    added = scale_mass(model, state, work, 2.0 * before)
    after = stable_step(highest_frequency(model, state, work), model)
    assert after == pytest.approx(2.0 * before, rel=1e-9)  # the worst element sits at the bound
    assert model.mass.sum() == pytest.approx(total + added, rel=1e-12)
    assert added > 0.0


def test_momentum_is_kept_without_supports() -> None:
    """No force from outside: momentum and angular momentum stay, to round-off of their sum."""
    from flexapod.dynamics.kernels import momentum

    mesh = grid((3, 3, 3), lambda x: x * 0.02)
    model = Model(solid(mesh, DRAGON_SKIN, 0.49, 1080.0))
    rng = np.random.default_rng(3)
    velocity = 0.3 * rng.standard_normal(model.nodes.shape)
    state = model.start(velocity=velocity)
    work = Workspace(model)
    dt = 0.5 * stable_step(highest_frequency(model, state, work), model)
    first, last = np.zeros(10), np.zeros(10)
    momentum(model.mass, model.owner, state.x, state.v, first)
    size = float((model.mass[:, None] * np.abs(velocity)).sum())
    for k in range(500):
        state.time = k * dt
        step(model, state, work, dt)
    momentum(model.mass, model.owner, state.x, state.v, last)
    # Round-off of 1000 sums of 27 forces that are larger than the momentum: 1e-12 of it.
    assert np.abs(last[4:7] - first[4:7]).max() < 1e-11 * size
    # Positions and velocities are half a step apart: L is kept exactly for x at t_n and v at
    # t_n -+ 1/2 alike, since x changes along v.
    assert np.abs(last[7:10] - first[7:10]).max() < 1e-11 * size * 0.02


def _inflated(dt_share: float, damping: float = 60.0) -> tuple[float, float]:
    """Volume ratio of a pressurised box after settling, and its statics' (by a long run)."""
    mesh = grid((4, 4, 2), lambda x: x * np.array([0.02, 0.02, 0.004]))
    faces = mesh.facet_groups["z0"]
    chamber = Chamber("under", faces, PressureTable(Table.ramp(400.0, 0.02)))
    model = Model(
        solid(mesh, DRAGON_SKIN, 0.45, 1080.0),
        displacements=hold(mesh, x0="xyz"),
        chambers=[chamber],
        damping=Damping(mass=damping),
    )
    state, work = model.start(), Workspace(model)
    limit = stable_step(highest_frequency(model, state, work), model)
    march(model, state, work, 80, Options(interval=5e-3, time_step=dt_share * 0.5 * limit))
    tip = int(np.argmax(model.nodes[:, 0]))
    return float(state.u[tip, 2]), limit


def test_pressure_means_pressure_whatever_the_step() -> None:
    """A tenth of the step changes the settled shape by less than 0.1 %."""
    whole, _ = _inflated(1.0)
    tenth, _ = _inflated(0.1)
    assert whole == pytest.approx(tenth, rel=1e-3)
    assert abs(whole) > 1e-4  # it did bend


def test_slow_inflation_equals_statics() -> None:
    """The same flap by Newton's method: one kernel, so only the rest of the motion differs."""
    from statics_helpers import TIGHT

    from flexapod.fem.loads import CavityPressure
    from flexapod.fem.static import LoadStep, PathOptions, solve_path

    mesh = grid((4, 4, 2), lambda x: x * np.array([0.02, 0.02, 0.004]))
    load = CavityPressure("p", mesh.facet_groups["z0"].astype(np.int64), 400.0)
    problem = StaticProblem(solid(mesh, DRAGON_SKIN, 0.45, 1080.0), hold(mesh, x0="xyz"), [load])
    result = solve_path(problem, [LoadStep("load", {"p": 1.0})], PathOptions(newton=TIGHT))
    assert result.status is Status.DONE
    tip = int(np.argmax(mesh.nodes[:, 0]))
    settled, _ = _inflated(1.0)
    # After 0.4 s at 60/s of mass damping (12 e-foldings of the amplitude) less than 1e-4 is left.
    assert settled == pytest.approx(float(result.state.u[tip, 2]), rel=1e-3)


def test_the_ledger_counts_pressure_and_damping() -> None:
    mesh = grid((3, 3, 2), lambda x: x * np.array([0.02, 0.02, 0.004]))
    chamber = Chamber("under", mesh.facet_groups["z0"], PressureTable(Table.ramp(300.0, 0.01)))
    for damping in (Damping(mass=20.0), Damping(stiffness=0.1)):
        model = Model(
            solid(mesh, DRAGON_SKIN, 0.45, 1080.0),
            displacements=hold(mesh, x0="xyz"),
            gravity=(0.0, 0.0, -9.8),
            chambers=[chamber],
            damping=damping,
        )
        state, work = model.start(), Workspace(model)
        last = []
        march(
            model,
            state,
            work,
            20,
            Options(interval=2e-3, safety=0.5),
            lambda s, m=model, w=work, out=last: out.append(energies(m, s, w)),
        )
        end = last[-1]
        scale = abs(end.pressure_work)
        assert scale > 1e-6
        # Second order in a step far below any resolved period; measured 1e-5.
        assert abs(end.unaccounted) < 1e-3 * scale
        losses = end.mass_damping_loss if damping.mass else end.internal_loss
        assert losses > 0.0


def test_a_fixed_step_that_is_not_stable_is_refused_with_the_stable_one() -> None:
    mesh = grid((2, 2, 2), lambda x: x * 0.01)
    model = Model(solid(mesh, NeoHooke(1e5), 0.45, 1000.0))
    state, work = model.start(), Workspace(model)
    limit = stable_step(highest_frequency(model, state, work), model)
    with pytest.raises(InputError, match=r"not stable .* largest stable one is") as caught:
        march(model, state, work, 1, Options(interval=1e-2, time_step=2.0 * limit))
    assert f"{limit:.4g}" in str(caught.value)


def test_an_inverted_element_is_named_with_its_place() -> None:
    mesh = grid((2, 1, 1), lambda x: x * 0.01)
    model = Model(solid(mesh, NeoHooke(1e5), 0.45, 1000.0))
    u = np.zeros_like(model.nodes)
    u[model.nodes[:, 0] > 0.009, 0] = -0.008
    with pytest.raises(
        SolverError, match=r"element 1 at \(.*\) m has the volume ratio -"
    ) as caught:
        evaluate(model, model.start(u), Workspace(model))
    assert caught.value.status is Status.INVERTED_ELEMENT


def test_a_velocity_that_is_no_number_is_named() -> None:
    mesh = grid((1, 1, 1), lambda x: x * 0.01)
    model = Model(solid(mesh, NeoHooke(1e5), 0.45, 1000.0))
    state, work = model.start(), Workspace(model)
    evaluate(model, state, work)
    state.v[3, 1] = np.nan
    with pytest.raises(SolverError, match="node 3 at") as caught:
        kick(model, state, work, 1e-5)
    assert caught.value.status is Status.NOT_FINITE


def _swinging() -> tuple[Model, Options]:
    mesh = grid((8, 3, 3), lambda x: x * np.array([0.06, 0.02, 0.02]))
    model = Model(
        solid(mesh, DRAGON_SKIN, 0.45, 1080.0),
        displacements=[Displacement("h", mesh.facet_nodes("x0"), k) for k in range(3)],
        gravity=(0.0, 0.0, -9.8),
    )
    return model, Options(interval=2e-3)


def test_going_on_from_a_checkpoint_gives_the_same_bits() -> None:
    model, options = _swinging()
    unbroken = model.start()
    march(model, unbroken, Workspace(model), 6, options)
    first = model.start()
    march(model, first, Workspace(model), 3, options)
    arrays, about = first.to_arrays()
    arrays = {k: v.copy() for k, v in arrays.items()}
    about = json.loads(json.dumps(about))  # numbers pass through text, as in a file
    model, options = _swinging()
    second = State.from_arrays(arrays, about)
    march(model, second, Workspace(model), 6, options)
    assert np.array_equal(second.x, unbroken.x)
    assert np.array_equal(second.v, unbroken.v)


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    here = os.path.dirname(__file__)
    code = (
        "import sys, hashlib; sys.path[:0] = [sys.argv[1], sys.argv[1] + '/helpers']\n"
        "import test_dynamics_soft as t\n"
        "model, options = t._swinging(); state = model.start()\n"
        "t.march(model, state, t.Workspace(model), 3, options)\n"
        "print(hashlib.sha256(state.x.tobytes() + state.v.tobytes()).hexdigest())\n"
    )
    out = []
    for threads in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", code, here],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "NUMBA_NUM_THREADS": threads},
        )
        out.append(done.stdout.strip())
    assert out[0] == out[1]


def test_a_viscous_block_comes_to_rest_and_its_ledger_says_where_the_energy_went() -> None:
    """Branches of a few milliseconds damp a swing of some hertz; what they take is on the books."""
    from flexapod.fem.body import SolidBody
    from flexapod.materials.law import SolidMaterial
    from flexapod.materials.prony import Prony

    mesh = grid((6, 2, 2), lambda x: x * np.array([0.06, 0.02, 0.02]))
    material = SolidMaterial(NeoHooke(73e3), 1080.0, 0.45, prony=Prony((0.5,), (5e-3,)))
    model = Model(SolidBody(mesh, {"*": material}), displacements=hold(mesh, x0="xyz"))
    u = np.zeros_like(model.nodes)
    u[:, 2] = 5e-3 * (model.nodes[:, 0] / 0.06) ** 2
    state, work = model.start(u), Workspace(model)
    kept = []
    march(
        model,
        state,
        work,
        60,
        Options(interval=5e-3, safety=0.3),
        lambda s: kept.append(energies(model, s, work)),
    )
    first, last = kept[0], kept[-1]
    assert last.stored < 0.02 * first.stored
    # Second order in the step; the shape it starts from has parts the mesh hardly resolves.
    # Measured 1.5e-3, nine times that at three times the step.
    assert max(abs(e.unaccounted) for e in kept) < 5e-3 * first.stored
    # All of it went into the branches (what they still store is gone by now). Same origin.
    assert last.viscous_loss == pytest.approx(first.stored - last.stored, rel=5e-3)


def _tank(pump: Pump) -> tuple[Model, State, Workspace]:
    """A cube whose outside is taken for a cavity's wall, all of it held: a tank of 1 ml."""
    mesh = grid((2, 2, 2), lambda x: x * 0.01)
    faces = np.concatenate([mesh.facet_groups[f"{a}{k}"] for a in "xyz" for k in (0, 1)])[:, ::-1]
    fixed = [Displacement("h", np.arange(len(mesh.nodes)), k) for k in range(3)]
    body = solid(mesh, NeoHooke(1e5), 0.45, 1000.0)
    model = Model(body, displacements=fixed, chambers=[Chamber("tank", faces, pump)])
    return model, model.start(), Workspace(model)


def test_a_pump_fills_a_tank_in_real_seconds_and_a_valve_empties_it() -> None:
    """Ideal gas at one temperature: dp/dt = p0 Q/V, and p0 (Q - c p)/V with an outlet."""
    flow, volume = 1e-6, 1e-6
    model, state, work = _tank(Pump(Table.constant(flow), start=2e3))
    march(model, state, work, 40, Options(interval=5e-3))
    evaluate(model, state, work)
    # The flow is constant and the volume too: exact to round-off of the sum.
    assert work.chamber_pressure[0] == pytest.approx(2e3 + ATMOSPHERE * flow / volume * 0.2)

    outlet = 1e-10
    model, state, work = _tank(Pump(Table.constant(0.0), Table.constant(outlet), start=20e3))
    march(model, state, work, 40, Options(interval=5e-3))
    evaluate(model, state, work)
    # Forward in time with a step far below the time constant of 0.1 s.
    left = 20e3 * math.exp(-ATMOSPHERE * outlet / volume * 0.2)
    assert work.chamber_pressure[0] == pytest.approx(left, rel=1e-2)


def test_a_pump_stalls_at_its_pressure() -> None:
    model, state, work = _tank(Pump(Table.constant(1e-5), stall=30e3))
    march(model, state, work, 100, Options(interval=5e-3))
    evaluate(model, state, work)
    # 15 time constants of V stall/(p0 Q) = 30 ms: e^-17.
    assert work.chamber_pressure[0] == pytest.approx(30e3, rel=1e-5)


def test_a_bond_holds_until_its_strength_and_then_lets_go_for_good() -> None:
    """Two blocks on a bond, one held and one pulled down by its weight, slowly laid on."""

    def hang(strength: float) -> tuple[Model, State, list[float]]:
        one = grid((2, 2, 2), lambda x: x * 0.02)
        count = len(one.nodes)
        two = grid((2, 2, 2), lambda x: x * 0.02 - [0.0, 0.0, 0.02])
        mesh = type(one)(
            np.concatenate([one.nodes, two.nodes]), np.concatenate([one.cells, two.cells + count])
        )
        first = one.facet_nodes("z0")
        second = two.facet_nodes("z1") + count
        held = [Displacement("h", one.facet_nodes("z1"), k) for k in range(3)]
        bond = Bond(
            "glue",
            np.stack([first, second], axis=1),
            np.full(len(first), 2e3),
            np.zeros(len(first)),
            strength,
            1e-4,
        )
        model = Model(
            solid(mesh, NeoHooke(1e5), 0.45, 1000.0),
            displacements=held,
            gravity=(0.0, 0.0, -9.8),
            bonds=[bond],
            damping=Damping(mass=200.0),
        )
        state, work = model.start(), Workspace(model)
        forces: list[float] = []
        march(
            model,
            state,
            work,
            40,
            Options(interval=5e-3),
            lambda s: forces.append(float(np.linalg.norm(work.bond_totals[0, 1:4]))),
        )
        return model, state, forces

    weight = 1000.0 * 0.02**3 * 9.8
    model, state, forces = hang(2.0 * weight)
    assert state.whole[0]
    # Settled with 200/s of damping for 0.2 s; the block's own lumped mass hangs on it.
    assert forces[-1] == pytest.approx(weight, rel=1e-2)
    model, state, forces = hang(0.5 * weight)
    assert not state.whole[0]
    assert forces[-1] == 0.0
    lower = model.nodes[:, 2] < -1e-9
    assert state.u[lower, 2].mean() < -1e-3  # it falls, as far as the damping lets it
