"""The explicit integrator: one step, and the loop over control intervals.

Central difference with lumped mass (leapfrog): positions at whole steps, velocities at half
steps. Between two control intervals the step is constant and divides the interval evenly, so
time is counted in integers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from flexapod.core.errors import InputError, SolverError, Status, check_positive
from flexapod.dynamics import joint_kernels, kernels, line_kernels, rigid_kernels
from flexapod.dynamics.contacts import DEPTH, ENERGY, STICK, account
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.line_march import LineMarch
from flexapod.dynamics.model import Model, State
from flexapod.dynamics.stable import highest_frequency, stable_step
from flexapod.dynamics.workspace import (
    BONDS,
    BRANCHES,
    CONTACT,
    DRIFT,
    ELEMENTS,
    JOINTS,
    KICK,
    LINES,
    OUTPUT,
    PRESSURES,
    REST,
    SEARCH,
    STABLE,
    Clock,
    Workspace,
)

# Entries of the works of a kick and of a state; a kick's last is its largest squared speed.
INTERNAL, PRESSURE, DISSIPATIVE, MASS_DAMPING, VISCOUS, BROKEN = 1, 2, 3, 4, 5, 6
FASTEST = 6
WORKS = slice(1, 6)
# Steps after which one that is short for contact's sake is chosen anew. A choice costs a third of a
# step of the coarse robot, so this costs a hundredth.
PATIENCE = 32


@dataclass(frozen=True)
class Energies:
    """Where the energy is at one time, and what came and went since the start [J]."""

    kinetic: float
    strain: float
    weight: float
    contact: float
    bond: float
    pressure_work: float
    contact_loss: float
    mass_damping_loss: float
    internal_loss: float
    viscous_loss: float
    bond_loss: float
    start: float
    lines: float = 0.0
    line_loss: float = 0.0
    coil_work: float = 0.0
    joints: float = 0.0
    joint_loss: float = 0.0
    servo_work: float = 0.0

    @property
    def stored(self) -> float:
        """Kinetic and potential energy."""
        potential = self.strain + self.weight + self.contact + self.bond
        return self.kinetic + potential + self.lines + self.joints

    @property
    def unaccounted(self) -> float:
        """What the sum of all entries fails to explain."""
        losses = (
            self.contact_loss
            + self.mass_damping_loss
            + self.internal_loss
            + self.viscous_loss
            + self.bond_loss
            + self.line_loss
            + self.joint_loss
        )
        came_in = self.pressure_work + self.coil_work + self.servo_work
        return self.stored - self.start - came_in + losses


@dataclass(frozen=True)
class Options:
    """How time is walked through.

    Attributes
    ----------
    interval
        Control interval [s]: pressures of pumps, the stable step and outputs go by it.
    safety
        Step over the stable step's bound at the interval's start, for what happens within the
        interval. The bound itself is 10 to 30 % below the true limit on common meshes.
    time_step
        A fixed step [s]; refused where it is not stable. None follows the stable step.
    """

    interval: float = 5e-3
    safety: float = 0.9
    time_step: float | None = None

    def __post_init__(self) -> None:
        check_positive("interval", self.interval, "s")
        if not 0.0 < self.safety <= 1.0:
            raise InputError(f"safety must lie in (0, 1], got {self.safety:g}")
        if self.time_step is not None:
            check_positive("time_step", self.time_step, "s")


def evaluate(model: Model, state: State, work: Workspace) -> None:
    """Forces of everything at the state's positions."""
    count = model.mesh_node_count
    clock = work.clock
    clock.lap(REST)
    if model.internal is not None:
        u = state.u
        if model.damping.stiffness > 0.0 and state.omega > 0.0:
            lag = 2.0 * model.damping.stiffness / state.omega
            kernels.shifted(state.u, state.v, lag, work.shifted)
            u = work.shifted
        work.strain_energy = model.internal(u[:count], work.internal[:count])
        if not math.isfinite(work.strain_energy):
            _name_inverted(model, state)
        clock.lap(ELEMENTS)
        if model.viscous is not None:
            model.viscous.force(state.u[:count], state.dt_before, work.viscous[:count])
            clock.lap(BRANCHES)
    if model.chambers:
        for k, (chamber, cavity) in enumerate(zip(model.chambers, model.cavities, strict=True)):
            if cavity is not None:
                work.chamber_volume[k] = cavity.volume(state.x)
            work.chamber_pressure[k] = chamber.command.pressure(
                state.time, float(work.chamber_volume[k]), float(state.gas[k])
            )
        kernels.face_pressure(
            state.x, model.faces, model.face_chamber, work.chamber_pressure, work.face_force
        )
        kernels.gather_faces(
            work.face_force, model.face_nodes, model.face_start, model.face_entry, work.pressure
        )
        clock.lap(PRESSURES)
    work.elastic[:] = 0.0
    work.dissipative[:] = 0.0
    work.unforeseen = False
    clock.lap(REST)
    for contact, history in zip(model.contacts, state.histories, strict=True):
        try:
            work.unforeseen |= contact.prepare(state.x, history, state.travel)
            clock.lap(SEARCH)
            contact.add_forces(state.x, state.v, history, work.elastic, work.dissipative)
            work.unforeseen |= contact.deeper
            clock.lap(CONTACT)
        except SolverError as error:
            raise SolverError(error.status, f"at {state.time:.6g} s {error.text}") from None
    if model.lines is not None:
        work.line_energy = model.lines.add_forces(
            state.x, state.v, state.time, state.dt_before, state.lines, work.elastic
        )
        clock.lap(LINES)
    if model.joints is not None:
        work.joint_energy = model.joints.add_loads(
            state.time,
            model.rigid,
            state.rigid_x,
            state.rigid_q,
            state.rigid_v,
            state.rigid_l,
            state.joints,
        )
        clock.lap(JOINTS)
    for k, bond in enumerate(model.bonds):
        if not state.whole[k]:
            work.bond_totals[k] = 0.0
            continue
        totals = work.bond_totals[k]
        kernels.bond_forces(
            state.x,
            state.v,
            bond.pairs,
            bond.stiffness,
            bond.length,
            bond.length_left(state.time),
            bond.damping,
            work.elastic,
            work.dissipative,
            totals,
        )
        if math.sqrt(totals[1] ** 2 + totals[2] ** 2 + totals[3] ** 2) > bond.strength:
            # It opens from the next step on; what its springs hold is lost then.
            state.whole[k] = False
            state.works[BROKEN] += totals[0]
            totals[0] = 0.0
    if model.bonds:
        clock.lap(BONDS)


def _name_inverted(model: Model, state: State) -> None:
    assert model.internal is not None
    bad = int(np.argmin(model.internal.least_j))
    cell = int(model.soft_cells[bad])
    place = state.x[model.cells[bad]].mean(axis=0)
    raise SolverError(
        Status.INVERTED_ELEMENT,
        f"at {state.time:.6g} s element {cell} at ({place[0]:.4g}, {place[1]:.4g}, "
        f"{place[2]:.4g}) m has the volume ratio {model.internal.least_j[bad]:.3g}",
    )


def kick(model: Model, state: State, work: Workspace, h: float) -> None:
    """Advance all velocities by `h` [s]; `work.sums` holds the works of the kick."""
    rigid = model.rigid
    if model.owned.size:
        # Any mode but the default writes to `out` without a copy.
        np.take(state.v, model.owned, axis=0, out=work.owned_before, mode="clip")
    kernels.kick(
        h,
        model.damping.mass,
        model.gravity,
        model.mass,
        model.own_mass,
        model.owner,
        model.fixed,
        work.internal,
        work.pressure,
        work.elastic,
        work.dissipative,
        work.viscous,
        state.v,
        work.total,
        work.parts,
    )
    kernels.add_parts(work.parts, work.sums)
    work.kinetic = float(work.sums[0])
    if rigid.names:
        rigid_kernels.sum_loads(
            state.x, work.total, model.owned, model.owner, state.rigid_x, work.load
        )
        if model.joints is not None:
            work.load += model.joints.load
        rigid_kernels.kick_weighed(
            h,
            model.gravity,
            model.damping.mass,
            work.load,
            rigid.mass,
            rigid.inertia,
            rigid.free,
            state.rigid_q,
            state.rigid_v,
            state.rigid_l,
            work.rigid_before,
            work.rigid_energy,
        )
        work.kinetic += float(work.rigid_energy[0])
        work.sums[MASS_DAMPING] += float(work.rigid_energy[1])
        if model.joints is not None:
            work.rotor_energy = model.joints.kick(
                h,
                rigid,
                state.rigid_q,
                state.rigid_v,
                state.rigid_l,
                work.rigid_before,
                state.joints,
                work.joint_spent,
            )
        place_owned(model, state)
        kernels.owned_work(
            h,
            model.owned,
            work.owned_before,
            state.v,
            work.internal,
            work.pressure,
            work.dissipative,
            work.viscous,
            work.sums,
        )
    if not math.isfinite(work.kinetic):
        raise SolverError(Status.NOT_FINITE, _name_not_finite(model, state))


def _name_not_finite(model: Model, state: State) -> str:
    bad = np.flatnonzero(~np.isfinite(state.v).all(axis=1))
    node = int(bad[0]) if bad.size else -1
    where = ""
    if node >= 0:
        x = state.x[node]
        where = f" of node {node} at ({x[0]:.4g}, {x[1]:.4g}, {x[2]:.4g}) m"
        if model.soft_cells.size:
            around = np.flatnonzero((model.cells == node).any(axis=1))
            if around.size:
                where += f", a corner of element {int(model.soft_cells[around[0]])},"
    return (
        f"at {state.time:.6g} s the velocity{where} became NaN or infinite; the step was "
        f"{state.dt_before:.3g} s"
    )


def place_owned(model: Model, state: State) -> None:
    """Put the nodes of rigid bodies where their bodies are."""
    rigid_kernels.place(
        model.owned,
        model.owner,
        model.local,
        model.rigid.inertia,
        model.rigid.free,
        state.rigid_x,
        state.rigid_q,
        state.rigid_v,
        state.rigid_l,
        state.x,
        state.v,
    )


def drift(model: Model, state: State, work: Workspace, dt: float) -> None:
    """Advance all positions by `dt` [s]."""
    rigid = model.rigid
    kernels.drift(dt, model.nodes, state.v, state.u, state.x)
    if rigid.names:
        rigid_kernels.drift(
            dt,
            rigid.mass,
            rigid.inertia,
            rigid.free,
            state.rigid_x,
            state.rigid_q,
            state.rigid_v,
            state.rigid_l,
        )
        if model.joints is not None:
            joint_kernels.drift_rotors(dt, state.joints["motion"])
        place_owned(model, state)
        kernels.owned_displacement(model.owned, model.nodes, state.x, state.u)
    state.travel = math.sqrt(work.sums[FASTEST]) * dt
    state.step_count += 1
    state.dt_before = dt


def last_record(model: Model, state: State, work: Workspace, record: Callable[[], None]) -> None:
    """Call `record` with forces and energies at the state's own time; the state stays as it is."""
    held = [{key: value.copy() for key, value in h.items()} for h in state.histories]
    lines = {key: value.copy() for key, value in state.lines.items()}
    joints = {key: value.copy() for key, value in state.joints.items()}
    viscous = None if model.viscous is None else model.viscous.history()
    kept = {n: getattr(state, n).copy() for n in ("v", "rigid_v", "rigid_l", "works", "whole")}
    evaluate(model, state, work)
    kick(model, state, work, 0.5 * state.dt_before)
    # The velocity at a whole step is half a kick away: no mean is to be taken of it.
    kinetic = kinetic_energy(model, state)
    work.kinetic = kinetic
    state.works[WORKS] += work.sums[WORKS]
    if state.joints:
        work.rotor_energy = rotor_energy(model, state)
        state.joints["spent"] += work.joint_spent
    record()
    for name, value in kept.items():
        setattr(state, name, value)
    place_owned(model, state)
    state.histories = held
    state.lines = lines
    state.joints = joints
    if model.viscous is not None and viscous is not None:
        model.viscous.restore(viscous)


def kinetic_energy(model: Model, state: State) -> float:
    """Kinetic energy [J] of the velocities as they are."""
    rigid = model.rigid
    free = model.owner < 0
    energy = 0.5 * float((model.mass[free, None] * state.v[free] ** 2).sum())
    if rigid.names:
        energy += rigid_kernels.kinetic(
            rigid.mass, rigid.inertia, rigid.free, state.rigid_q, state.rigid_v, state.rigid_l
        )
    return energy


def rotor_energy(model: Model, state: State) -> float:
    """Kinetic energy of the servos' rotors relative to what they sit in [J]."""
    if model.joints is None:
        return 0.0
    rate = state.joints["motion"][:, joint_kernels.RATE]
    return 0.5 * float((model.joints.servo[:, joint_kernels.INERTIA] * rate * rate).sum())


def step(
    model: Model,
    state: State,
    work: Workspace,
    dt: float,
    record: Callable[[], None] | None = None,
) -> None:
    """One step of `dt` [s]; `record` is called when forces and energies at `state.time` are known.

    The caller advances `state.time`.
    """
    anew = math.isnan(state.energy_start)
    first = (kinetic_energy(model, state), rotor_energy(model, state)) if anew else (0.0, 0.0)
    evaluate(model, state, work)
    work.clock.lap(REST)
    kick(model, state, work, 0.5 * (state.dt_before + dt))
    work.clock.lap(KICK)
    # Energies belong to whole steps and works to half steps: a part of this kick is before.
    before = state.dt_before / (state.dt_before + dt)
    half = (1.0 - before) * work.sums[WORKS]
    state.works[WORKS] += before * work.sums[WORKS]
    if anew:
        # A first kick starts from the velocity of the state's own time: nothing came before.
        before = 0.0
        work.kinetic, work.rotor_energy = first
        for contact, history in zip(model.contacts, state.histories, strict=True):
            contact.begin_anew(history)
        state.energy_start = energies(model, state, work).stored
        state.works[WORKS] = 0.0
        half = work.sums[WORKS].copy()
    if state.joints:
        state.joints["spent"] += before * work.joint_spent
    for contact, history in zip(model.contacts, state.histories, strict=True):
        account(contact, history, dt)
    if record is not None:
        work.clock.lap(REST)
        record()
        work.clock.lap(OUTPUT)
    state.works[WORKS] += half
    if state.joints:
        state.joints["spent"] += (1.0 - before) * work.joint_spent
    _feed(model, state, work, dt)
    work.clock.lap(REST)
    drift(model, state, work, dt)
    work.clock.lap(DRIFT)


def energies(model: Model, state: State, work: Workspace) -> Energies:
    """The ledger at the state of the last `evaluate` and `kick`."""
    strain = work.strain_energy
    internal_loss = 0.0
    if model.internal is not None and model.damping.stiffness > 0.0:
        count = model.mesh_node_count
        strain = model.internal(state.u[:count], work.shifted[:count])
        # Work on the nodes is minus the strain stored and the loss.
        internal_loss = -state.works[INTERNAL] - (strain - _start_strain(state, strain))
    weight = kernels.potential_of_weight(model.own_mass, model.owner, model.gravity, state.x)
    weight -= float((model.rigid.mass[:, None] * state.rigid_x * model.gravity).sum())
    # What sticking points hold elastically comes back: it is stored, not lost.
    stuck = sum(float(c.totals[STICK]) for c in model.contacts)
    contact = stuck + sum(float(c.totals[ENERGY]) for c in model.contacts)
    pairs = zip(model.contacts, state.histories, strict=True)
    dropped = sum(c.dropped(history) for c, history in pairs)
    return Energies(
        kinetic=work.kinetic,
        strain=strain,
        weight=weight,
        contact=contact,
        bond=float(work.bond_totals[:, 0].sum()),
        pressure_work=float(state.works[PRESSURE]),
        contact_loss=dropped - float(state.works[DISSIPATIVE]) - stuck,
        mass_damping_loss=-float(state.works[MASS_DAMPING]),
        internal_loss=internal_loss,
        # Of what the branches took some is stored and comes back.
        viscous_loss=-float(state.works[VISCOUS]),
        bond_loss=float(state.works[BROKEN]),
        start=state.energy_start,
        lines=work.line_energy,
        line_loss=float(state.lines["spent"][line_kernels.LOSS]) if state.lines else 0.0,
        coil_work=float(state.lines["spent"][line_kernels.COIL_WORK]) if state.lines else 0.0,
        joints=work.joint_energy + work.rotor_energy,
        joint_loss=float(state.joints["spent"][joint_kernels.LOSS]) if state.joints else 0.0,
        servo_work=float(state.joints["spent"][joint_kernels.WORK]) if state.joints else 0.0,
    )


def _start_strain(state: State, now: float) -> float:
    if math.isnan(state.strain_start):
        state.strain_start = now
    return state.strain_start


@dataclass
class RunStats:
    """What a run cost."""

    steps: int = 0
    smallest_step: float = math.inf
    largest_step: float = 0.0
    estimates: int = 0
    deepest: float = 0.0  # largest penetration of any contact [m]
    clock: Clock = field(default_factory=Clock)


def march(
    model: Model,
    state: State,
    work: Workspace,
    intervals: int,
    options: Options,
    record: Callable[[State], None] | None = None,
    interval_done: Callable[[State], None] | None = None,
    stats: RunStats | None = None,
) -> RunStats:
    """Go on until `state.interval` is `intervals`; the state moves in place.

    Parameters
    ----------
    record
        Called at the first step of every interval, when all forces and energies there are known.
    interval_done
        Called after every interval: the place for checkpoints.
    stats
        Filled as the run goes, so that a run that fails has them too.

    Raises
    ------
    InputError
        A fixed step is not stable.
    SolverError
        An element turned inside out, the body fell through the ground, or a velocity is no number;
        the state is left as it was found.
    """
    stats = RunStats() if stats is None else stats
    fast = LineMarch(model, state, work) if LineMarch.serves(model) else None
    work.clock = stats.clock
    work.clock.start()
    while state.interval < intervals:
        begin = state.interval * options.interval
        left, first = options.interval, record
        while left > 0.0:
            # Again where contact is not what the step was chosen for: deeper, of other faces, or
            # perhaps over.
            state.time = begin
            whole = left == options.interval
            work.clock.lap(REST)
            count, allowed = _choose_step(model, state, work, options, left, whole)
            work.clock.lap(STABLE)
            dt = left / count
            stats.estimates += 1
            stats.smallest_step = min(stats.smallest_step, dt)
            stats.largest_step = max(stats.largest_step, dt)
            done = 0
            # A march of lines goes on to the end in one kernel.
            may_recover = work.touched and options.time_step is None and model.lines is None
            while done < count:
                state.time = begin + done * dt
                step(model, state, work, dt, _bound(first, state))
                first = None
                done += 1
                depths = [float(c.totals[DEPTH]) for c in model.contacts]
                stats.deepest = max([stats.deepest, *depths])
                deeper = any(d > a for d, a in zip(depths, allowed, strict=True))
                # Faces found since then have no share in the step chosen before; and where contact
                # makes it short it may be over soon.
                again = deeper or work.unforeseen or (may_recover and done >= PATIENCE)
                if again and done < count:
                    break
                if fast is not None and done < count:
                    walked, deepest, end = fast.march(begin + done * dt, dt, count - done, allowed)
                    work.clock.lap(LINES)  # with its ground, kicks and drifts: it is one call
                    done += walked
                    stats.deepest = max(stats.deepest, deepest)
                    if end == line_kernels.TROUBLE:
                        _name_trouble(model, state, begin + done * dt)
                    if end == line_kernels.DEEPER:
                        break
            stats.steps += done
            begin += done * dt
            left = left - done * dt if done < count else 0.0
        state.interval += 1
        state.time = state.interval * options.interval
        work.clock.lap(REST)
        if interval_done is not None:
            interval_done(state)
            work.clock.lap(OUTPUT)
    work.clock = Clock()  # what is evaluated later is no part of this run
    return stats


def _name_trouble(model: Model, state: State, time: float) -> None:
    """Say what a step of line elements failed of; the kernel only knows that it did."""
    state.time = time
    for contact in model.contacts:
        if isinstance(contact, GroundContact):
            contact.look_for_fall(state.x, time)
    raise SolverError(Status.NOT_FINITE, _name_not_finite(model, state))


def _bound(record: Callable[[State], None] | None, state: State) -> Callable[[], None] | None:
    return None if record is None else lambda: record(state)


def _choose_step(
    model: Model, state: State, work: Workspace, options: Options, left: float, whole: bool
) -> tuple[int, list[float]]:
    """Number of equal steps for the time `left` [s], and how deep each contact may go with them.

    Elements are looked at where it is a `whole` interval.
    """
    state.omega = highest_frequency(model, state, work, anew=whole)
    limit = stable_step(state.omega, model)
    allowed = [
        contact.allow(history, margin, work.springs, work.dashpots, work.node_elements, state.omega)
        for contact, history, margin in zip(
            model.contacts, state.histories, work.margins, strict=True
        )
    ]
    if options.time_step is None:
        return max(1, math.ceil(left / (options.safety * limit) - 1e-9)), allowed
    if options.time_step > limit and state.step_count:
        raise SolverError(
            Status.UNSTABLE_STEP,
            f"at {state.time:.6g} s the fixed step {options.time_step:.4g} s is no longer stable: "
            f"the largest stable one is {limit:.4g} s; leave time_step out to follow it",
        )
    if options.time_step > limit:
        raise InputError(
            f"the step {options.time_step:.4g} s is not stable at {state.time:.4g} s: the "
            f"largest stable one is {limit:.4g} s; leave time_step out to follow it"
        )
    return max(1, math.ceil(left / options.time_step - 1e-9)), allowed


def _feed(model: Model, state: State, work: Workspace, dt: float) -> None:
    """Let gas flow for a step into the chambers whose pressure comes from their gas."""
    for k, (chamber, cavity) in enumerate(zip(model.chambers, model.cavities, strict=True)):
        if cavity is not None:
            pressure = float(work.chamber_pressure[k])
            state.gas[k] += dt * chamber.command.flow(state.time, pressure)


__all__ = [
    "BROKEN",
    "STICK",
    "Energies",
    "Options",
    "RunStats",
    "drift",
    "energies",
    "evaluate",
    "kick",
    "march",
    "step",
]
