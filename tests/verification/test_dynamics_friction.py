"""Friction between faces: one block on another, by the laws of Coulomb and of Newton."""

from __future__ import annotations

import math

import numpy as np
import pytest
from statics_helpers import grid

from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.dynamics.contacts import BY_FRICTION, FRICTION, SLID
from flexapod.dynamics.integrator import Options, energies, march
from flexapod.dynamics.model import Model, State
from flexapod.dynamics.rigid import RigidBodies, box
from flexapod.dynamics.surface_contact import SurfaceContact
from flexapod.dynamics.workspace import Workspace

G = 9.81
LAW = ContactLaw(194e3 * math.sqrt(1000.0), stick_stiffness=1e9)
SIZE, HEIGHT = 0.04, 0.004  # [m], a flat block: it slides and hardly rocks
MU = 0.4


def _on_a_plate(
    tilt: float, plate_free: bool = False, friction: float = MU
) -> tuple[Model, State, SurfaceContact, float]:
    """A rigid block on a rigid plate three times as long, sunk in to bear its weight.

    Gravity is tilted about y by `tilt`; the plate is fixed unless `plate_free`.
    """
    shape = np.array([SIZE, SIZE, HEIGHT])
    block = grid((4, 4, 1), lambda x: (x - [0.5, 0.5, 0.0]) * shape)
    # Its faces do not match the block's.
    plate = grid((9, 5, 1), lambda x: (x - [0.5, 0.5, 1.0]) * shape * [3.0, 1.5, 1.0])
    nodes = np.concatenate([block.nodes, plate.nodes])
    owner = np.repeat([0, 1], [len(block.nodes), len(plate.nodes)]).astype(np.int32)
    under = block.facet_groups["z0"]
    top = plate.facet_groups["z1"] + len(block.nodes)
    parts = [box(tuple(s), 1000.0) for s in (shape, shape * [3.0, 1.5, 1.0])]
    free = np.ones((2, 6), dtype=bool)
    free[1] = plate_free
    bodies = RigidBodies(
        ("block", "plate"),
        np.array([m for m, _ in parts]),
        np.array([i for _, i in parts]),
        free,
    )
    law = FrictionLaw.constant(friction)
    contact = SurfaceContact("rub", nodes, under, top, LAW, friction=law)
    weight = parts[0][0] * G * math.cos(tilt)
    # Both passes count half: B d**2 over the block's own area bears the weight.
    depth = math.sqrt(weight / (SIZE * SIZE * LAW.traction_coefficient))
    model = Model(
        None,
        rigid=bodies,
        rigid_centres=np.array([[0.0, 0.0, 0.5 * HEIGHT], [0.0, 0.0, -0.5 * HEIGHT]]),
        rigid_nodes=(nodes, owner),
        gravity=(G * math.sin(tilt), 0.0, -G * math.cos(tilt)),
        contacts=[contact],
    )
    state = model.start()
    state.rigid_x[0, 2] -= depth
    state.x[owner == 0, 2] -= depth
    state.histories = [contact.start(state.x)]
    return model, state, contact, depth


def _go(model: Model, state: State, time: float) -> Workspace:
    work = Workspace(model)
    march(model, state, work, 1, Options(interval=time))
    return work


def test_a_block_on_a_plate_stops_after_v2_over_2_mu_g() -> None:
    model, state, _, _ = _on_a_plate(0.0)
    distance = 0.5 * SIZE
    speed = math.sqrt(2.0 * MU * G * distance)
    state.rigid_v[0, 0] = speed
    _go(model, state, 1.3 * speed / (MU * G))
    # The plate's points under the block come and go by whole points, which rocks it a little: load
    # wanders, its sum does not. Measured 2e-4.
    assert state.rigid_x[0, 0] == pytest.approx(distance, rel=2e-3)
    spent = state.histories[0]["spent"]
    # All the energy went by sliding, all along the way.
    assert spent[SLID] == pytest.approx(distance, rel=5e-3)
    energy = 0.5 * float(model.rigid.mass[0]) * speed**2
    assert spent[BY_FRICTION] == pytest.approx(energy, rel=5e-3)


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_block_on_a_plate_slides_just_above_its_friction_angle(share: float) -> None:
    tilt = share * math.atan(MU)
    model, state, _, _ = _on_a_plate(tilt)
    time = 0.05
    _go(model, state, time)
    moved = state.rigid_x[0, 0]
    if share < 1.0:
        # It strains its springs (14 nm) and creeps a little while it rocks on them to rest: 0.3 um
        # measured, less than a thousandth of the way without friction.
        assert 0.0 < moved < 1e-3 * 0.5 * G * math.sin(tilt) * time**2
    else:
        free = 0.5 * G * (math.sin(tilt) - MU * math.cos(tilt)) * time**2
        # It starts unstrained and speeds up until the springs hold their share: less than 5 %.
        assert moved == pytest.approx(free, rel=0.05)


def test_friction_between_free_bodies_keeps_momentum_and_the_books() -> None:
    model, state, contact, _ = _on_a_plate(0.0, plate_free=True)
    model.gravity = np.zeros(3)
    state.rigid_v[0] = [0.3, 0.0, -0.05]  # pushed down obliquely: it rubs and bounces off
    mass = model.rigid.mass
    before = (mass[:, None] * state.rigid_v).sum(axis=0)
    work = Workspace(model)
    balance, rubbed = [], []

    def record(s: State) -> None:
        e = energies(model, s, work)
        balance.append(e.unaccounted / e.start)
        rubbed.append(float(np.abs(contact.totals[FRICTION]).max()))

    march(model, state, work, 40, Options(interval=1e-4, safety=0.3), record)
    after = (mass[:, None] * state.rigid_v).sum(axis=0)
    assert max(rubbed) > 0.05 and contact.totals[7] == 0.0  # they rubbed and parted
    assert state.rigid_v[1, 0] > 0.0  # the plate was dragged along
    # Equal and opposite to the last bit, summed over bodies: round-off.
    assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()
    # Second order in the step; 1e-3 measured.
    assert max(abs(b) for b in balance) < 5e-3
    # What contact reports for itself is what the ledger lost to it; its power of damping is taken
    # constant over each step.
    e = energies(model, state, work)
    spent = state.histories[0]["spent"]
    assert spent[1:].sum() == pytest.approx(e.contact_loss, rel=0.02)


def test_without_friction_nothing_is_dragged() -> None:
    model, state, contact, _ = _on_a_plate(0.0, friction=0.0)
    state.rigid_v[0, 0] = 0.1
    _go(model, state, 0.02)
    # The plate's points push along the block's own normal, which rocks by some 1e-6.
    assert state.rigid_v[0, 0] == pytest.approx(0.1, rel=1e-5)
    assert not contact.totals[FRICTION].any() and contact.rubbing() == 0.0
