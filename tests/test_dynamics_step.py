"""What one explicit step may not do: allocate, or lose what it names when it fails."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from statics_helpers import grid, solid

from flexapod.contact.ground import Plane
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.core.errors import SolverError, Status
from flexapod.dynamics.commands import Chamber, PressureTable, Table
from flexapod.dynamics.contacts import GroundContact, SurfaceContact
from flexapod.dynamics.integrator import Options, Workspace, highest_frequency, march, step
from flexapod.dynamics.model import Model
from flexapod.materials.neo_hooke import NeoHooke

LAW = ContactLaw(97e3 * 1000**0.5)


def _model(n: int, low: float = 0.0) -> Model:
    """A cube on the ground, under air pressure, its sides watched for each other."""
    mesh = grid((n, n, n), lambda x: 0.02 * x + [0.0, 0.0, low])
    sides = np.concatenate([mesh.facet_groups[name] for name in ("x0", "x1")])
    ground = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), FrictionLaw.constant(0.5))
    return Model(
        solid(mesh, NeoHooke(73e3), 0.45, 1080.0),
        gravity=(0.0, 0.0, -9.8),
        chambers=[Chamber("top", mesh.facet_groups["z1"], PressureTable(Table.constant(1e3)))],
        contacts=[
            GroundContact("ground", mesh.nodes, mesh.facet_groups["z0"], ground, LAW),
            SurfaceContact("sides", mesh.nodes, sides, sides, LAW),
        ],
    )


def test_a_step_allocates_nothing_that_grows_with_the_mesh() -> None:
    most = []
    for n in (4, 12):
        model = _model(n, low=-1e-4)
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
    # cube is 53 kB, one number per node 18 kB.
    assert max(most) < 16000


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
