"""Everything at once: what holds for each part alone must hold for all of them in one model."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numba
import numpy as np
import pytest
from statics_helpers import grid

from flexapod.contact.ground import slope
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.dynamics.commands import Chamber, PressureTable, Pump, Table
from flexapod.dynamics.contacts import COUNT
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.integrator import Energies, Options, energies, march
from flexapod.dynamics.model import Bond, Damping, Model, State
from flexapod.dynamics.rigid import RigidBodies, box
from flexapod.dynamics.surface_contact import SurfaceContact
from flexapod.dynamics.workspace import Workspace
from flexapod.fem.body import SolidBody
from flexapod.geometry.tagged import TaggedMesh, boundary_facets, orient_outward
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.prony import Prony

INTERVALS = 60  # until it has nearly come to rest
END = 24  # where bits are compared: past the blow, on the way back down
OPTIONS = Options(interval=5e-3, safety=0.5)
LOWER, UPPER = np.array([0.08, 0.02, 0.02]), np.array([0.03, 0.02, 0.02])
FOOT = 0.02  # side of the rigid cube at the lower block's end [m]


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    """One thread, for a hundred cells, but where a test asks for more."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


def _model() -> Model:
    """A bar with a rigid foot on a slope, and a block that drops onto it, glued in two places.

    The bar is under pressure on top, the block is a tank that is pumped up; the weaker bond breaks
    as the block lands. Both are viscous.
    """
    one = grid((8, 2, 2), lambda x: x * LOWER)
    two = grid((4, 3, 3), lambda x: x * UPPER + [0.018, 0.0, LOWER[2] + 1e-3])
    count = len(one.nodes)
    mesh = TaggedMesh(
        np.concatenate([one.nodes, two.nodes]), np.concatenate([one.cells, two.cells + count])
    )
    law = NeoHooke.from_youngs_modulus(1.5e5, 0.45)
    material = SolidMaterial(law, 1000.0, 0.45, prony=Prony((0.3, 0.2), (2e-3, 3e-2)))
    body = SolidBody(mesh, {"*": material})

    # The last layer of the bar's cells is the foot's, a cube with faces of its own underneath.
    tied = np.flatnonzero(mesh.nodes[:, 0] > LOWER[0] - 1.01e-2)
    sole = grid((2, 2, 1), lambda x: x * FOOT + [LOWER[0], 0.0, 0.0])
    start = len(mesh.nodes)
    nodes = np.concatenate([mesh.nodes, sole.nodes])
    mass, inertia = box((FOOT, FOOT, FOOT), 1500.0)
    rigid = RigidBodies(("foot",), np.array([mass]), inertia[None], np.ones((1, 6), bool))

    under = np.concatenate([one.facet_groups["z0"][: 7 * 2], sole.facet_groups["z0"] + start])
    contact_law = ContactLaw(3e5, damping_ratio=0.1, stick_stiffness=1e7)
    ground = GroundContact(
        "ground", nodes, under, slope(0.1, friction=FrictionLaw(0.6, 0.4)), contact_law
    )
    skin = orient_outward(mesh.cells, boundary_facets(mesh.cells))
    surface = SurfaceContact("self", nodes, skin, skin, contact_law, joint_gap=2e-4)

    def bond(name: str, x: float, strength: float) -> Bond:
        """From the block's lower rim at `x` to the bar's nodes below."""
        upper = two.facet_nodes("z0")
        upper = upper[np.abs(two.nodes[upper, 0] - x) < 1e-6]
        top = one.facet_nodes("z1")
        near = [
            top[np.argmin(np.linalg.norm(one.nodes[top] - two.nodes[k], axis=1))] for k in upper
        ]
        pairs = np.stack([upper + count, np.array(near)], axis=1)
        length = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
        return Bond(name, pairs, np.full(len(pairs), 100.0), length, strength, 1e-4)

    outside = [two.facet_groups[f"{a}{k}"] for a in "xyz" for k in (0, 1)]
    walls = np.concatenate(outside)[:, ::-1] + count
    return Model(
        body,
        rigid=rigid,
        rigid_centres=np.array([[LOWER[0] + 0.5 * FOOT, 0.5 * FOOT, 0.5 * FOOT]]),
        rigid_nodes=(sole.nodes, np.zeros(len(sole.nodes), dtype=np.int32)),
        tied={"foot": tied},
        gravity=(0.0, 0.0, -9.81),
        chambers=[
            Chamber("top", one.facet_groups["z1"][:8], PressureTable(Table.ramp(800.0, 0.05))),
            Chamber("tank", walls, Pump(Table.constant(2e-7))),
        ],
        contacts=[ground, surface],
        bonds=[bond("strong", 0.018, 1e3), bond("weak", 0.048, 0.2)],
        damping=Damping(mass=1.0, stiffness=0.02),
    )


def _start(model: Model) -> State:
    """Laid on the slope's top corner, sliding down it and to the side."""
    velocity = np.zeros((model.mesh_node_count, 3))
    velocity[:] = [0.3, 0.05, 0.0]
    state = model.start(velocity=velocity)
    state.rigid_v[0] = [0.3, 0.05, 0.0]
    return state


def _bytes(model: Model, state: State) -> dict[str, bytes]:
    """Everything that moves, bit by bit."""
    arrays, about = state.to_arrays()
    assert model.viscous is not None
    branches = {f"viscous.{name}": value for name, value in model.viscous.history().items()}
    out = {name: value.tobytes() for name, value in {**arrays, **branches}.items()}
    return {**out, "about": json.dumps(about).encode()}


def _threads_run(threads: int) -> tuple[dict[str, bytes], int]:
    """The bits after a run on `threads` threads, and the number of steps."""
    numba.set_num_threads(threads)
    model = _model()
    state = _start(model)
    march(model, state, Workspace(model), END, OPTIONS)
    return _bytes(model, state), state.step_count


def test_everything_at_once_acts_and_the_books_close() -> None:
    """Kinetic and potential energy, less what came in and plus what was lost, stay as at the start.

    Every entry of the ledger has to be in use, so that none closes it by being nothing.
    """
    model = _model()
    state, work = _start(model), Workspace(model)
    kept: list[Energies] = []
    touching: list[tuple[float, float]] = []

    def record(s: State) -> None:
        kept.append(energies(model, s, work))
        touching.append((model.contacts[0].totals[COUNT], model.contacts[1].totals[COUNT]))

    march(model, state, work, INTERVALS, OPTIONS, record)
    last = kept[-1]
    losses = {
        "contact": last.contact_loss,
        "mass damping": last.mass_damping_loss,
        "stiffness damping": last.internal_loss,
        "branches": last.viscous_loss,
        "bond": last.bond_loss,
    }
    turnover = sum(losses.values()) + abs(last.pressure_work)
    rest = max(abs(e.unaccounted) for e in kept)
    print({k: f"{v:.2e}" for k, v in losses.items()}, f"pressure {last.pressure_work:.2e} J")
    print(f"unaccounted: most {rest / turnover:.1e}, end {last.unaccounted / turnover:.1e}")
    assert min(losses.values()) > 5e-3 * turnover  # above what the books are known to
    assert last.pressure_work > 0.05 * turnover
    assert max(n for n, _ in touching) > 50 and max(n for _, n in touching) > 50
    assert max(e.bond for e in kept) > 1e-2 * turnover
    assert list(state.whole) == [True, False]
    assert work.chamber_pressure[0] == 800.0 and work.chamber_pressure[1] > 100.0
    # In the blow of the foot contact holds a third of the turnover for a few hundred steps; what
    # the scheme fails to resolve of it comes back. Measured 1e-3 at most and 6e-4 at the end; till
    # rims had a potential 9e-4 and 9e-4, and then 1.3e-2 and 4e-3 at 0.9 of the stable step, 7e-4
    # and 4e-4 at a quarter of it. Five and three times that: another rounding, another motion.
    assert rest < 5e-3 * turnover
    assert abs(last.unaccounted) < 2e-3 * turnover


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="numba was given one thread")
def test_everything_at_once_gives_the_same_bits_on_one_and_two_threads() -> None:
    """Every loop that runs in parallel writes its own entries only: no sum depends on threads."""
    one, steps = _threads_run(1)
    two, _ = _threads_run(2)
    assert steps > 1000
    assert [name for name in one if one[name] != two[name]] == []


@pytest.mark.parametrize("stop", [8, 17])
def test_everything_at_once_killed_and_resumed_gives_the_same_bits(stop: int) -> None:
    """A checkpoint taken in the blow (8) and in the rocking after it (17), into a fresh model."""
    model = _model()
    unbroken = _start(model)
    march(model, unbroken, Workspace(model), END, OPTIONS)
    whole = _bytes(model, unbroken)

    model = _model()
    state = _start(model)
    march(model, state, Workspace(model), stop, OPTIONS)
    assert model.viscous is not None
    arrays, about = state.to_arrays()
    arrays = {name: value.copy() for name, value in arrays.items()}
    branches = {name: value.copy() for name, value in model.viscous.history().items()}
    about = json.loads(json.dumps(about))  # numbers pass through text, as in a file
    assert max(float(c.totals[COUNT]) for c in model.contacts) > 0.0

    model = _model()
    state = State.from_arrays(arrays, about)
    assert model.viscous is not None
    model.viscous.restore(branches)
    march(model, state, Workspace(model), END, OPTIONS)
    resumed = _bytes(model, state)
    assert state.step_count > 1000
    assert [name for name in whole if whole[name] != resumed[name]] == []
