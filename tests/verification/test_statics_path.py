"""Newton's order of convergence and the path through a limit point.

The snap is that of a shallow clamped arch under a dead load at its crown: beyond the limit load
there is no neighbouring equilibrium, only the far side. The state reached by load there must be
the one that prescribing the crown's displacement reaches, which needs no snap, with a reaction
equal to the load.
"""

from __future__ import annotations

import copy
import functools

import numba
import numpy as np
import pytest
from statics_helpers import TIGHT, error, grid, hold, side_force, solid, solve, sphere_octant

from flexapod.contact.law import ContactLaw
from flexapod.core.errors import Status
from flexapod.fem.body import SolidBody
from flexapod.fem.contacts import PlaneContact
from flexapod.fem.loads import CavityPressure, DeadLoad, Displacement, gravity
from flexapod.fem.newton import NewtonOptions, newton
from flexapod.fem.sparse import DirectSolver
from flexapod.fem.static import (
    Increment,
    LoadStep,
    PathOptions,
    PathState,
    StaticProblem,
    StaticResult,
    solve_path,
)
from flexapod.materials.library import load_material
from flexapod.materials.neo_hooke import NeoHooke

LAW = load_material("dragon-skin-20-sospider").law


@pytest.mark.parametrize(
    ("poisson", "sizes"), [(0.4, (1e-3, 3e-4, 1e-4)), (0.499, (3e-5, 1e-5, 3e-6))]
)
def test_newton_converges_quadratically(poisson: float, sizes: tuple[float, ...]) -> None:
    # Near the solution one step from an error e leaves C e**2: the residual after the step falls
    # with the square of the residual before it (from NewtonReport.residuals).
    mesh = sphere_octant(1.0, 2.0, 3, 2)
    body = solid(mesh, LAW, poisson)
    load = CavityPressure("p", mesh.facet_groups["cavity"], 3e4)
    supports = hold(mesh, sx="x", sy="y", sz="z")
    root, problem = solve(body, supports, [load])
    away = np.random.default_rng(0).standard_normal(root.shape)
    problem.conditions.apply(away, {})
    pairs = []
    for size in sizes:
        problem.pressure = None
        guess = root + size * away
        options = NewtonOptions(1e-9, 1e-9)
        _, report, status = newton(problem, DirectSolver(), guess, {"p": 1.0}, options, 2.0)
        assert status is None
        pairs.append(report.residuals[:2])
        print(f"{size:g}", [f"{r:.1e}" for r in report.residuals])
    before, after = np.log(np.array(pairs)).T
    orders = np.diff(after) / np.diff(before)
    print("orders", orders)
    # Measured 2.03 to 2.23.
    assert np.all(orders > 1.9)


SPAN, RISE, THICK, WIDE = 10.0, 1.0, 0.4, 0.5  # half span [m]


@functools.cache
def _arch() -> tuple[SolidBody, tuple[Displacement, ...], np.ndarray]:
    def bend(t: np.ndarray) -> np.ndarray:
        y = 0.5 * RISE * (1.0 + np.cos(np.pi * t[:, 0]))
        return np.stack([SPAN * t[:, 0], y + THICK * t[:, 1], WIDE * t[:, 2]], axis=1)

    mesh = grid((24, 2, 1), bend)
    supports = (*hold(mesh, x0="x", x1="xy", z0="z", z1="z"),)
    return solid(mesh, NeoHooke(1e5), 0.45), supports, mesh.facet_nodes("x0")


def _crown_load(force: float) -> tuple[StaticProblem, np.ndarray]:
    body, supports, crown = _arch()
    f = np.zeros_like(body.nodes)
    f[crown, 1] = -force / len(crown)
    return StaticProblem(body, supports, [DeadLoad("F", f)]), crown


@functools.cache
def _limit() -> tuple[float, float]:
    """Limit load [N] and the crown's depth [m] there, by moving the whole crown down."""
    body, supports, crown = _arch()
    down = Displacement("down", crown, 1, -2.5 * RISE)
    problem = StaticProblem(body, [*supports, down], [])
    curve: list[tuple[float, float]] = []

    def watch(increment: Increment) -> None:
        state = increment.state
        force = -side_force(problem, state.u, state.factors, crown)[1]
        curve.append((2.5 * RISE * state.factors["down"], force))

    step = LoadStep("down", {"down": 1.0}, first=0.02, largest=0.02)
    result = solve_path(problem, [step], on_increment=watch)
    assert result.status is Status.DONE, result.message
    depth, force = np.array(curve).T
    k = int(np.argmax(np.diff(force) < 0.0))
    assert 0 < k < len(force) - 2 and force[k + 1] < force[k], "no limit point"
    return float(force[k]), float(depth[k])


@pytest.mark.parametrize(("iterations", "creeps"), [(20, False), (5, True)])
def test_snap_is_passed_and_ends_where_displacement_control_does(
    iterations: int, creeps: bool
) -> None:
    # With 20 iterations Newton jumps across by itself (measured: five plain increments); with 5
    # it cannot, and the last increment has to creep.
    limit, depth = _limit()
    force = 1.15 * limit
    problem, crown = _crown_load(force)
    messages: list[str] = []
    damped: list[bool] = []
    result = solve_path(
        problem,
        [LoadStep("F", {"F": 1.0}, first=0.2, smallest=0.01)],
        PathOptions(newton=NewtonOptions(max_iterations=iterations)),
        lambda i: damped.append(i.damped),
        on_message=messages.append,
    )
    assert result.status is Status.DONE, result.message
    u = result.state.u
    sunk = -float(u[crown, 1].mean())
    print(f"limit {limit:.3f} N at {depth:.3f} m; at {force:.3f} N sunk {sunk:.3f} m, {damped}")
    assert damped[-1] == creeps and not any(damped[:-1])
    assert (result.state.damped_work > 0.0) == any(damped)
    # The arch has turned over, far beyond the limit point.
    assert sunk > 2.0 * depth
    # The same state by displacement: each crown node moved to where the snap left it.
    body, supports, _ = _arch()
    moved = [Displacement("to", np.array([n]), 1, float(u[n, 1])) for n in crown]
    v, other = solve(body, [*supports, *moved], first=0.05)
    reaction = -side_force(other, v, {"to": 1.0}, crown)[1]
    # Without contact Newton's last step is far below its tolerance; measured 9e-10.
    assert error(reaction, force, "N", "reaction") < 1e-4
    assert np.abs(u - v).max() < 1e-4 * sunk


def test_load_beyond_the_limit_without_damping_has_a_name() -> None:
    limit, _ = _limit()
    problem, _ = _crown_load(1.15 * limit)
    step = LoadStep("crown", {"F": 1.0}, first=0.2, smallest=0.01)
    options = PathOptions(damped=False, newton=NewtonOptions(max_iterations=5))
    result = solve_path(problem, [step], options)
    assert result.status is Status.STEP_TOO_SMALL
    assert "crown" in result.message and "F " in result.message
    # It stopped below the limit, with the state kept, within an increment of it.
    reached = result.state.factors["F"] * 1.15
    print(f"stopped at {reached:.4f} of the limit")
    assert 0.8 < reached <= 1.01
    assert np.abs(result.state.u).max() > 0.0
    assert result.stats.cutbacks > 0


def test_other_failures_have_names() -> None:
    limit, _ = _limit()
    problem, _ = _crown_load(0.5 * limit)
    step = LoadStep("crown", {"F": 1.0}, first=0.05, largest=0.05)
    few = solve_path(problem, [step], PathOptions(max_increments=3))
    assert few.status is Status.TOO_MANY_INCREMENTS
    assert few.stats.increments == 3

    def stop(increment: Increment) -> None:
        if increment.state.time > 0.2:
            raise KeyboardInterrupt

    problem, _ = _crown_load(0.5 * limit)
    broken = solve_path(problem, [step], on_increment=stop)
    assert broken.status is Status.INTERRUPTED
    assert "crown" in broken.message


def _resting_problem() -> StaticProblem:
    """A pressed-on block with friction: history, a follower load and two steps."""
    mesh = grid((3, 2, 2), lambda t: t * [0.03, 0.02, 0.02])
    body = solid(mesh, NeoHooke(1e6), 0.3)
    law = ContactLaw(1e3, friction=0.5, stick_stiffness=1e7)
    ground = PlaneContact(
        "ground", mesh.nodes, mesh.facet_groups["z0"], (0, 0, 1e-5), (0, 0, 1), law
    )
    loads = [
        gravity("gravity", body.node_mass, (0.0, 0.0, -98.1)),
        CavityPressure("press", mesh.facet_groups["z1"], 1e3),
    ]
    push = Displacement("push", mesh.facet_nodes("x0"), 0, 3e-4)
    return StaticProblem(body, [push], loads, [ground])


STEPS = [
    LoadStep("rest", {"gravity": 1.0}, first=0.5),
    LoadStep("push", {"push": 1.0, "press": 1.0}, outputs=4, first=0.125),
]


def test_resumed_run_equals_the_unbroken_one() -> None:
    kept: list[PathState] = []
    options = PathOptions(newton=TIGHT)
    whole = solve_path(
        _resting_problem(), STEPS, options, lambda i: kept.append(copy.deepcopy(i.state))
    )
    assert whole.status is Status.DONE, whole.message
    for state in (kept[0], kept[len(kept) // 2], kept[-2]):
        resumed = solve_path(_resting_problem(), STEPS, options, start=copy.deepcopy(state))
        assert resumed.status is Status.DONE, resumed.message
        size = np.abs(whole.state.u).max()
        off = np.abs(resumed.state.u - whole.state.u).max() / size
        print(f"resumed from step {state.step} at {state.time:.3f}: off by {off:.1e}")
        # The same increments; Newton's own tolerance (1e-9) is all that may differ.
        assert off < 1e-7
        assert resumed.state.factors == whole.state.factors
        np.testing.assert_allclose(
            resumed.state.history[0], whole.state.history[0], atol=1e-7 * size
        )


def test_soft_block_settles_on_a_rough_plane() -> None:
    # A silicone block under ten times its weight on rough ground. Points that have just landed
    # must not add a stick stiffness to the tangent while they have no stick force: Newton then
    # crept (ratio 0.2 at 1e6 Pa/m) or failed (from 1e7; the law's default is 1e8).
    mesh = grid((3, 2, 2), lambda t: t * [0.03, 0.02, 0.02])
    body = solid(mesh, LAW)
    law = ContactLaw(1e3, friction=0.5)
    bottom = mesh.facet_groups["z0"]
    ground = PlaneContact("ground", mesh.nodes, bottom, (0, 0, 1e-5), (0, 0, 1), law)
    load = gravity("gravity", body.node_mass, (0.0, 0.0, -98.1))
    solve(body, hold(mesh, x0="x", y0="y"), [load], contacts=[ground], newton=NewtonOptions())


def test_same_bits_for_one_and_two_threads() -> None:
    most = numba.config.NUMBA_NUM_THREADS
    if most < 2:
        pytest.skip("NUMBA_NUM_THREADS is 1")
    problem = _resting_problem()
    u = 1e-3 * np.random.default_rng(0).standard_normal(problem.body.nodes.shape)
    factors = {"gravity": 1.0, "push": 1.0, "press": 1.0}
    results = []
    for count in (1, 2):
        numba.set_num_threads(count)
        residual, energy = problem.residual(u, factors)
        results.append((residual, energy, problem.tangent(u, factors).blocks.copy()))
    numba.set_num_threads(most)
    np.testing.assert_array_equal(results[0][0], results[1][0])
    assert results[0][1] == results[1][1]
    np.testing.assert_array_equal(results[0][2], results[1][2])


def test_factors_are_linear_within_a_step_and_kept_after_it() -> None:
    problem = _resting_problem()
    seen: list[tuple[str, float, dict[str, float], bool]] = []
    result: StaticResult = solve_path(
        problem,
        STEPS,
        on_increment=lambda i: seen.append(
            (i.step_name, i.state.time, dict(i.state.factors), i.is_output)
        ),
    )
    assert result.status is Status.DONE, result.message
    for name, time, factors, _ in seen:
        part = time if time > 0.0 else 1.0
        if name == "push":
            assert factors["gravity"] == 1.0
            assert factors["push"] == pytest.approx(part, rel=1e-12)
            assert factors["press"] == pytest.approx(part, rel=1e-12)
    assert sum(s[3] for s in seen if s[0] == "push") == 4
