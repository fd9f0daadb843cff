"""What one explicit step may not do: allocate, or lose what it names when it fails."""

from __future__ import annotations

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest
from statics_helpers import grid, solid

from flexapod.contact.ground import Plane, Step
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.core.errors import SolverError, Status
from flexapod.dynamics import kernels, workspace
from flexapod.dynamics.commands import Chamber, PressureTable, Pump, Table
from flexapod.dynamics.contacts import rate_margin
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.integrator import Options, RunStats, march, step
from flexapod.dynamics.model import Bond, Damping, Model
from flexapod.dynamics.rigid import RigidBodies
from flexapod.dynamics.stable import highest_frequency
from flexapod.dynamics.surface_contact import SurfaceContact
from flexapod.dynamics.workspace import Workspace
from flexapod.fem import kernels as fem_kernels
from flexapod.materials.neo_hooke import NeoHooke

LAW = ContactLaw(97e3 * 1000**0.5)


def _model(n: int, low: float = 0.0, busy: bool = False) -> Model:
    """A cube on the ground, under air pressure, its sides watched for each other.

    `busy` adds all else that acts in a step: gas pumped in through the skin, a rigid part glued to
    a third of the cube, rods through it and damping.
    """
    mesh = grid((n, n, n), lambda x: 0.02 * x + [0.0, 0.0, low])
    sides = np.concatenate([mesh.facet_groups[name] for name in ("x0", "x1")])
    ground = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), FrictionLaw.constant(0.5))
    chambers = [Chamber("top", mesh.facet_groups["z1"], PressureTable(Table.constant(1e3)))]
    more: dict[str, Any] = {}
    if busy:
        skin = np.concatenate([mesh.facet_groups[f"{axis}{k}"] for axis in "xyz" for k in (0, 1)])
        chambers.append(Chamber("around", skin[:, ::-1], Pump(Table.constant(1e-9))))
        pairs = np.stack([mesh.facet_nodes("z0"), mesh.facet_nodes("z1")], axis=1)
        ones = np.ones(len(pairs))
        more = {
            "rigid": RigidBodies(
                ("part",), np.array([0.01]), 1e-6 * np.eye(3)[None], np.ones((1, 6), bool)
            ),
            "rigid_centres": np.array([[0.01, 0.02, 0.01]]),
            "tied": {"part": np.flatnonzero(mesh.nodes[:, 1] > 0.0133)},
            "bonds": [Bond("rods", pairs, ones, 0.02 * ones)],
            "damping": Damping(mass=1.0, stiffness=0.01),
        }
    return Model(
        solid(mesh, NeoHooke(73e3), 0.45, 1080.0),
        gravity=(0.0, 0.0, -9.8),
        chambers=chambers,
        contacts=[
            GroundContact("ground", mesh.nodes, mesh.facet_groups["z0"], ground, LAW),
            SurfaceContact("sides", mesh.nodes, sides, sides, LAW),
        ],
        **more,
    )


def test_a_step_allocates_nothing_that_grows_with_the_mesh() -> None:
    most = []
    for n in (4, 12):
        model = _model(n, low=-1e-4, busy=True)
        state, work = model.start(), Workspace(model)
        dt = 0.5 / highest_frequency(model, state, work)
        for _ in range(30):
            step(model, state, work, dt)  # compiles, and looks at motion every tenth time
        tracemalloc.start()
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(30):
            step(model, state, work, dt)
        most.append(tracemalloc.get_traced_memory()[1] - before)
        tracemalloc.stop()
    # Small objects of Python and three-by-three matrices; one vector of nodal forces of the larger
    # cube is 53 kB, one number per node 18 kB, a vector at the nodes of the rigid part 16 kB.
    assert max(most) < 16000


def test_the_parts_of_a_runs_time_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    # A second passes at every look at the clock, and a hundred while a row is written.
    seconds = itertools.count()
    monkeypatch.setattr(workspace, "perf_counter", lambda: float(next(seconds)))
    model = _model(3, low=-1e-4, busy=True)
    state, work, stats = model.start(), Workspace(model), RunStats()

    def write(state: object) -> None:
        for _ in range(100):
            next(seconds)

    began = next(seconds)
    march(model, state, work, 3, Options(interval=1e-4), write, stats=stats)
    spent = stats.clock.seconds
    # Beside the looks at the clock counted here: the first look, and the one of the clock that
    # times nothing from the end on.
    assert sum(spent.values()) == next(seconds) - began - 3
    assert spent["output"] == 3 * 101
    assert spent["stable_step"] == stats.estimates
    for part, laps in (("element_forces", 1), ("pressure", 1), ("bonds", 1), ("kick", 1),
                       ("drift", 1), ("contact_search", 2), ("contact_forces", 2)):  # fmt: skip
        assert spent[part] == laps * stats.steps, part
    assert spent["viscous_forces"] == 0.0
    shares = stats.clock.shares()
    assert "viscous_forces" not in shares
    assert sum(shares.values()) == pytest.approx(1.0, rel=1e-12)  # round-off
    # What is evaluated later is no part of the run.
    step(model, state, work, state.dt_before)
    assert stats.clock.seconds == spent


def test_a_velocity_that_is_no_number_names_node_and_element() -> None:
    model = _model(3)
    state = model.start()
    state.v[7, 1] = np.nan
    with pytest.raises(
        SolverError, match=r"at 0 s the velocity of node 7 .* element \d+"
    ) as failed:
        march(model, state, Workspace(model), 1, Options(interval=1e-4))
    assert failed.value.status is Status.NOT_FINITE


def test_a_fall_through_the_ground_names_the_deepest_face() -> None:
    model = _model(3, low=-0.006)
    state = model.start()
    with pytest.raises(SolverError, match="6 mm deep in the ground") as failed:
        march(model, state, Workspace(model), 1, Options(interval=1e-4))
    assert failed.value.status is Status.FELL_THROUGH


def test_the_step_is_chosen_again_when_contact_finds_other_faces() -> None:
    """A cube falls to the ground within one interval, which begins with no face near.

    The step chosen at the start knows of no contact; with a stiff one it would not be stable. Of
    the skin of 0.2 mm each search is a new look, so the steps get smaller before it touches.
    """
    mesh = grid((2, 2, 2), lambda x: 0.02 * x + [0.0, 0.0, 1e-3])
    ground = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), FrictionLaw.constant(0.0))
    contact = GroundContact(
        "ground", mesh.nodes, mesh.facet_groups["z0"], ground, ContactLaw(1e4 * LAW.stiffness),
        skin=2e-4,
    )  # fmt: skip
    model = Model(solid(mesh, NeoHooke(73e3), 0.45, 1080.0), contacts=[contact])
    state, work, stats = model.start(), Workspace(model), RunStats()
    state.v[:, 2] = -0.2
    march(model, state, work, 1, Options(interval=7e-3), stats=stats)
    assert stats.estimates > 3 and stats.deepest > 0.0
    assert stats.smallest_step < 0.5 * stats.largest_step
    # Steps get longer again as it leaves the ground, before the interval ends: measured 1,202; with
    # those that its deepest place asked for to the end they were 5,983.
    assert stats.steps < 2500
    # It came down 1 mm at 0.2 m/s and is on its way up: nothing blew up.
    assert state.v[:, 2].mean() > 0.0 and np.abs(state.v).max() < 1.0


def test_faces_are_pressed_as_by_quadrature() -> None:
    """The closed form against the 2x2 rule, which is exact, on warped faces; to round-off."""
    rng = np.random.default_rng(7)
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) + 0.3 * rng.standard_normal((4, 3))
    out = np.full((1, 4, 3), np.nan)
    kernels.face_pressure(
        x, np.array([[0, 1, 2, 3]]), np.zeros(1, int), np.array([2.5]), out
    )  # fmt: skip
    expected = np.zeros((4, 3))
    g = 1.0 / np.sqrt(3.0)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for xi, eta in g * signs:
        n = 0.25 * (1.0 + xi * signs[:, 0]) * (1.0 + eta * signs[:, 1])
        along = (0.25 * signs[:, 0] * (1.0 + eta * signs[:, 1])) @ x
        across = (0.25 * signs[:, 1] * (1.0 + xi * signs[:, 0])) @ x
        expected -= 2.5 * n[:, None] * np.cross(along, across)
    np.testing.assert_allclose(out[0], expected, rtol=0.0, atol=1e-15)


def test_contact_allows_for_what_comes_nearer() -> None:
    """Only near faces count, and over a plane only their way into it; clamped to 15 and 50 um."""
    mesh = grid((2, 2, 2), lambda x: 0.02 * x + [0.0, 0.0, 1e-4])
    flat = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), FrictionLaw.constant(0.5))
    step_ahead = Step(1.0, 0.01, FrictionLaw.constant(0.5))
    faces = mesh.facet_groups["z0"]
    v = np.zeros_like(mesh.nodes)
    v[faces.ravel()] = [3.0, 0.0, -2.0]
    v[mesh.facet_groups["z1"].ravel()] = [0.0, 0.0, -90.0]  # far from the ground
    for ground, way in ((flat, 2e-5), (step_ahead, 1e-5 * np.sqrt(13.0))):
        contact = GroundContact("ground", mesh.nodes, faces, ground, LAW)
        history = contact.start(mesh.nodes)
        assert contact.near_travel(v, history, 1e-5, 1.0) == pytest.approx(way, rel=1e-12)
        assert contact.near_travel(0.0 * v, history, 1e-5, 1.0) == 0.0
    leaving = GroundContact("ground", mesh.nodes, faces, flat, LAW)
    assert leaving.near_travel(-v, leaving.start(mesh.nodes), 1e-5, 1.0) == 0.0
    away = leaving.start(mesh.nodes + [0.0, 0.0, 1.0])
    assert leaving.near_travel(v, away, 1e-5, 1.0) == 0.0
    assert [rate_margin(w) for w in (0.0, 1e-5, 1.0)] == [1.5e-5, 2e-5, 5e-5]


def test_bound_of_an_element_is_the_eighth_root_of_a_trace() -> None:
    rng = np.random.default_rng(3)
    full = rng.normal(size=(5, 24, 24))
    full += full.transpose(0, 2, 1)
    mass = rng.uniform(0.5, 2.0, (5, 8))
    tangents = np.empty((5, fem_kernels.PAIR_COUNT, 3, 3))
    for a, b in itertools.combinations_with_replacement(range(8), 2):
        block = full[:, 3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        tangents[:, fem_kernels.PAIR_OF[a, b]] = block
    out = np.empty(5)
    cells = np.zeros((5, 8), dtype=np.int64)
    kernels.element_rates(tangents, fem_kernels.PAIR_OF, cells, mass, 1.5, out)
    root = np.repeat(np.sqrt(mass), 3, axis=1)
    scaled = full / root[:, :, None] / root[:, None, :]
    eighth = np.linalg.matrix_power(scaled, 8)
    expected = 1.5 * np.trace(eighth, axis1=1, axis2=2) ** 0.125
    np.testing.assert_allclose(out, expected, rtol=1e-12)  # round-off of a thousand products
