"""Steps and problems: what they refuse, and the bookkeeping of increments."""

from __future__ import annotations

import numpy as np
import pytest
from statics_helpers import grid, hold, solid

from flexapod.core.errors import InputError, Status
from flexapod.fem.loads import Displacement, surface_force
from flexapod.fem.newton import CreepOptions, NewtonOptions, creep, newton
from flexapod.fem.sparse import DirectSolver
from flexapod.fem.static import LoadStep, PathOptions, StaticProblem, solve_path
from flexapod.materials.neo_hooke import NeoHooke


def _problem() -> StaticProblem:
    mesh = grid((2, 1, 1))
    pull = surface_force("pull", mesh.nodes, mesh.facet_groups["x1"], (1e4, 0.0, 0.0))
    return StaticProblem(solid(mesh, NeoHooke(1e5)), hold(mesh, x0="x", y0="y", z0="z"), [pull])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"outputs": 0}, "outputs must be >= 1, got 0"),
        ({"first": 0.0}, "increments must obey"),
        ({"first": 1.5}, "increments must obey"),
        ({"smallest": 0.2, "first": 0.1}, "increments must obey"),
        ({"smallest": 0.0}, "increments must obey"),
    ],
)
def test_step_refuses_impossible_increments(words: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        LoadStep("inflate", {}, **words)  # type: ignore[arg-type]
    assert "step inflate" in str(caught.value)


def test_unknown_load_is_named_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"step one: unknown load \['push'\].*\['pull'\]"):
        solve_path(_problem(), [LoadStep("one", {"push": 1.0})])


def test_two_loads_of_one_name_are_refused() -> None:
    problem = _problem()
    with pytest.raises(InputError, match="two loads share a name"):
        StaticProblem(problem.body, [], [*problem.loads, *problem.loads])


def test_outputs_fall_on_equal_parts() -> None:
    times: list[float] = []
    result = solve_path(
        _problem(),
        [LoadStep("one", {"pull": 1.0}, outputs=5, first=0.3)],
        on_increment=lambda i: times.append(i.state.factors["pull"]) if i.is_output else None,
    )
    assert result.status is Status.DONE
    np.testing.assert_allclose(times, [0.2, 0.4, 0.6, 0.8, 1.0], rtol=1e-12)
    assert result.stats.increments >= 5
    assert result.stats.iterations >= result.stats.increments


def test_largest_increment_is_kept() -> None:
    times: list[float] = [0.0]
    step = LoadStep("one", {"pull": 1.0}, first=0.1, largest=0.15)
    solve_path(_problem(), [step], on_increment=lambda i: times.append(i.state.factors["pull"]))
    # An increment may swallow a sliver of a fifth before an output; measured: the last is 0.3.
    assert np.diff(times).max() <= 1.2 * 0.15 + 1e-9


def test_reactions_balance_the_load() -> None:
    problem = _problem()
    result = solve_path(problem, [LoadStep("one", {"pull": 1.0}, first=0.5)])
    reactions = problem.reactions(result.state.u, {"pull": 1.0}).sum(axis=0)
    # Without contact Newton's last step is far below its tolerance (1e-3 of a nodal force).
    np.testing.assert_allclose(reactions, [-1e4, 0.0, 0.0], atol=0.2)


def test_moving_a_support_that_flips_elements_cuts_back_or_fails_with_a_name() -> None:
    # Crushing a block to nothing has no solution: the path stops with a status, never an error.
    mesh = grid((2, 1, 1))
    crush = Displacement("crush", mesh.facet_nodes("x1"), 0, -1.2)
    parts = [*hold(mesh, x0="xyz", x1="yz"), crush]
    problem = StaticProblem(solid(mesh, NeoHooke(1e5)), parts, [])
    step = LoadStep("one", {"crush": 1.0}, first=0.5, smallest=0.02)
    result = solve_path(problem, [step], PathOptions(damped=False))
    assert result.status is Status.STEP_TOO_SMALL
    assert 0.0 < result.state.factors["crush"] < 1.0 / 1.2
    assert "crush" in result.message
    assert np.isfinite(result.state.u).all()


def test_creep_from_rest_ends_where_newton_does() -> None:
    problem = _problem()
    solver, options = DirectSolver(), NewtonOptions()
    rest = np.zeros((problem.body.node_count, 3))
    exact, _, failure = newton(problem, solver, rest, {"pull": 1.0}, options, 1.0)
    assert failure is None
    bath = np.full(problem.body.node_count, 1e5)
    said: list[str] = []
    u, report, work, bad = creep(
        problem, solver, rest, {"pull": 1.0}, options, CreepOptions(), 1.0, bath, said.append
    )
    assert bad is None
    assert work > 0.0 and said
    assert report.iterations > 1
    # Both to Newton's tolerances: 1e-5 of the body.
    np.testing.assert_allclose(u, exact, atol=1e-5)
    solver.close()


def test_creep_that_runs_out_of_steps_says_so() -> None:
    problem = _problem()
    solver = DirectSolver()
    rest = np.zeros((problem.body.node_count, 3))
    few = CreepOptions(first=1e3, max_steps=2)
    bath = np.full(problem.body.node_count, 1e5)
    *_, bad = creep(
        problem, solver, rest, {"pull": 1.0}, NewtonOptions(), few, 1.0, bath, lambda _: None
    )
    assert bad is Status.NOT_CONVERGED
    solver.close()
