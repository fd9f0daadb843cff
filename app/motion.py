"""From a case that moves to its results folder: start shape, model, march, rows and frames."""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import (
    build_mesh,
    carried_mass,
    contact_law,
    group_cells,
    make_materials,
    make_supports,
    match_names,
    modelled_fraction,
    surface_faces,
    surface_modulus,
)
from flexapod.app.case import LoadedCase, load_case, package_version, start_case
from flexapod.app.outputs import CHECKPOINT_FILE, OutputState, ResultsFolder, peak_memory
from flexapod.app.probes import Probe, make_probes
from flexapod.core.errors import InputError, SolverError, Status

if TYPE_CHECKING:
    from flexapod.dynamics.commands import Chamber
    from flexapod.dynamics.contacts import DynamicContact, History
    from flexapod.dynamics.integrator import Energies, RunStats, Workspace
    from flexapod.dynamics.model import Bond, Model, State
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.tagged import TaggedMesh

Say = Callable[[str], None]

# Of sticking on the ground [Pa/m]. Statics takes a hundredth, for the sake of Newton's method. In
# motion that is too soft: each point of a rolling body has to be sheared anew, and the body creeps
# (a rigid cylinder by 2 %, tests/verification/test_dynamics_contact.py).
STICK_STIFFNESS = 1e9


@dataclasses.dataclass
class Motion:
    """All a run needs."""

    mesh: TaggedMesh
    body: SolidBody
    model: Model
    state: State
    work: Workspace
    ground: Any  # the first ground; None without
    mass: float  # of everything [kg], of the modelled part
    shape: Shape  # before it was turned and set down


@dataclasses.dataclass(frozen=True)
class Shape:
    """A start shape at rest.

    Attributes
    ----------
    u
        Displacements of the unfolded mesh [m], shape (node_count, 3).
    histories
        Of the contacts of faces with faces, by their name: who touches whom goes on from there.
    """

    u: np.ndarray
    histories: dict[str, History]


# --------------------------------------------------------------------------- start


def start_shape(
    loaded: LoadedCase, out: Path, resume: bool, say: Say
) -> tuple[LoadedCase, np.ndarray] | None:
    """Run the static case a motion starts from (once) and return it with its displacements.

    It lies in ``<out>/start`` as a results folder of its own, and is taken over where the same
    case was run to its end before.
    """
    spec = loaded.case.start
    if spec is None:
        return None
    from flexapod.app.outputs import same_case
    from flexapod.app.run import resolve, run_case

    name = start_case({"start": {"case": spec.case}}, Path(loaded.source))
    assert name is not None
    static = load_case(name)
    if static.case.dynamics is not None:
        raise InputError("start.case must be a static case", loaded.source)
    table = static.case.model_dump(mode="json", by_alias=True, exclude_none=True)
    own = loaded.case.model_dump(mode="json", by_alias=True, exclude_none=True)
    for key in ("mesh", "material", "mass"):
        # The body that moves is the body that was inflated: one mesh, one material.
        if key in own:
            table[key] = own[key]
    from flexapod.app.case import parse_case

    static = LoadedCase(parse_case(table, name), static.source, static.folder)
    folder = out / "start"
    kept = ResultsFolder.finished(folder)
    wanted = resolve(static, None)
    old = kept is not None and kept["resolved"]["flexapod_version"] != package_version()
    if kept is None or old or same_case(wanted, kept):
        half_done = folder.is_dir() and kept is None and (folder / "checkpoint.h5").is_file()
        say(f"start shape: case {static.name}")
        result = run_case(static, folder, resume=resume and half_done, say=say)
        if result.status is not Status.DONE:
            raise SolverError(result.status, f"the start shape was not reached: {result.message}")
    else:
        say(f"start shape: taken from {folder}")
    kept_state = ResultsFolder(folder).read_checkpoint()
    if kept_state is None:
        raise InputError("holds no checkpoint", str(folder))
    return static, kept_state[0]["u"]


# --------------------------------------------------------------------------- model


def assemble_motion(
    loaded: LoadedCase,
    start: tuple[LoadedCase, np.ndarray] | None,
    say: Say,
    settle: bool = True,
    settled: Shape | None = None,
) -> Motion:
    """Look up everything a case names and make the model and its first state.

    Without `settle` the start shape is left as it is: for a run that goes on from a checkpoint.
    With `settled` (`settled_shape`) it is that one.
    """
    from flexapod.dynamics.integrator import Workspace, scale_mass
    from flexapod.dynamics.model import Damping, Model
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.unfold import unfold, unfold_shares, unfold_vectors

    case, source = loaded.case, loaded.source
    assert case.dynamics is not None
    mesh = build_mesh(loaded)
    part = SolidBody(mesh, make_materials(loaded, mesh))
    carried = carried_mass(loaded, mesh, part)
    u = np.zeros_like(mesh.nodes) if start is None else start[1]
    modelled = modelled_fraction(case.mesh)
    if u.shape != mesh.nodes.shape:
        raise InputError(f"{source}: the start shape is of another mesh")
    for axis in case.start.unfold if case.start is not None else ():
        count, number = len(mesh.nodes), "xyz".index(axis)
        mesh, origin = unfold(mesh, number)
        u = unfold_vectors(u, origin, count, number)
        carried = unfold_shares(carried, origin, count)
        modelled *= 2.0
    body = SolidBody(mesh, make_materials(loaded, mesh))
    # Rows of materials are numbered anew: what counts is which material a row is.
    new, old = (
        np.array([part.materials.index(m) for m in b.materials])[b.material] for b in (body, part)
    )
    if (new != np.resize(old, body.cell_count)).any():
        raise InputError(
            "a material's group reaches a part of the body but not its mirror image, which is "
            'named "..._mirrored": write a glob such as "servo_2*"',
            f"{source}: material",
        )
    spec = case.dynamics
    supports = make_supports(loaded, mesh)
    rigid = _rigid_bodies(loaded, mesh, body, carried, supports)
    ground, contacts = _contacts(loaded, mesh, body)
    gravity = case.gravity.acceleration if case.gravity is not None else (0.0, 0.0, 0.0)
    model = Model(
        body,
        rigid=rigid.bodies,
        rigid_centres=rigid.centres,
        tied=rigid.tied,
        carried_mass=carried,
        displacements=supports,
        gravity=gravity,
        chambers=_chambers(loaded, mesh, modelled),
        contacts=contacts,
        damping=Damping(spec.mass_damping, spec.stiffness_damping),
        bonds=_bonds(loaded, mesh, body, carried, u),
    )
    work = Workspace(model)
    if spec.mass_scaling is not None:
        added = scale_mass(model, model.start(u), work, spec.mass_scaling)
        say(f"mass scaling adds {added * 1e3:.3g} g")
    shape = Shape(u, {})
    if settled is not None:
        shape = settled
    elif settle and case.start is not None and case.start.settle > 0.0:
        shape = _settle(model, u, case.start, [bond.closed for bond in case.bond], say)
    for bond, shut in zip(model.bonds, case.bond, strict=True):
        if shut.closed:
            bond.length[:] = 0.0
    state = model.start(_set_down(loaded, mesh, shape.u, ground))
    for k, contact in enumerate(model.contacts):
        if contact.name in shape.histories:
            # Gaps do not change as the whole is turned and set down.
            kept = shape.histories[contact.name]
            state.histories[k] = {key: value.copy() for key, value in kept.items()}
    free = model.owner < 0
    total = float(model.mass[free].sum() + model.rigid.mass.sum())
    return Motion(mesh, body, model, state, work, ground, total, shape)


def _settle(model: Model, u: np.ndarray, spec: Any, closed: list[bool], say: Say) -> Shape:
    """The shape after it has come to rest without weight and ground."""
    from flexapod.dynamics.contacts import GroundContact
    from flexapod.dynamics.integrator import Options, Workspace, march
    from flexapod.dynamics.model import Damping

    still = copy.copy(model)
    still.gravity = np.zeros(3)
    still.contacts = [c for c in model.contacts if not isinstance(c, GroundContact)]
    still.damping = Damping(mass=spec.settle_damping)
    # Drawn together by whatever it takes; what holds it then is asked below.
    still.bonds = [dataclasses.replace(bond, strength=math.inf) for bond in model.bonds]
    still.chambers = [_held(chamber) for chamber in model.chambers]
    still.cavities = [None for _ in model.chambers]
    state, work = still.start(u), Workspace(still)
    intervals = max(1, math.ceil(spec.settle / 1e-3))
    closing = [bond for bond, shut in zip(model.bonds, closed, strict=True) if shut]
    apart = [bond.length.copy() for bond in closing]

    def draw_together(state: State) -> None:
        """Rods shorten to nothing in the first half of the time."""
        left = max(0.0, 1.0 - 2.0 * state.interval / intervals)
        for bond, length in zip(closing, apart, strict=True):
            bond.length[:] = left * length

    say(f"settling for {spec.settle * 1e3:.3g} ms")
    options = Options(interval=spec.settle / intervals)
    march(still, state, work, intervals, options, interval_done=draw_together)
    for bond in closing:
        bond.length[:] = 0.0
    settled = state.u[: model.mesh_node_count]
    moved = float(np.abs(settled - u).max())
    say(f"settled: moved by up to {moved * 1e3:.3g} mm, {work.kinetic * 1e3:.3g} mJ left")
    for bond, totals in zip(model.bonds, work.bond_totals, strict=True):
        force = float(np.linalg.norm(totals[1:4]))
        say(f"bond {bond.name} holds {force:.3g} N")
        if force > bond.strength:
            raise InputError(
                f"the bond {bond.name!r} would open at once: it has to hold {force:.3g} N and its "
                f"strength is {bond.strength:.3g} N"
            )
    touching = {c.name: h for c, h in zip(still.contacts, state.histories, strict=True)}
    return Shape(settled.copy(), touching)


def _held(chamber: Chamber) -> Chamber:
    """The chamber with the pressure it starts with, whatever feeds it later."""
    from flexapod.dynamics.commands import PressureTable, Pump, Table

    command = chamber.command
    start = command.start if isinstance(command, Pump) else command.pressure(0.0, 1.0, 0.0)
    return dataclasses.replace(chamber, command=PressureTable(Table.constant(start)))


def settled_shape(
    loaded: LoadedCase, start: tuple[LoadedCase, np.ndarray] | None, say: Say
) -> Shape:
    """The unfolded start shape at rest, without weight and ground."""
    return assemble_motion(loaded, start, say).shape


def centre(model: Model, state: State) -> np.ndarray:
    """Centre of all masses [m]."""
    from flexapod.dynamics import kernels

    sums = np.zeros(10)
    kernels.momentum(model.mass, model.owner, state.x, state.v, sums)
    rigid = model.rigid.mass
    first = sums[1:4] + (rigid[:, None] * state.rigid_x).sum(axis=0)
    return np.asarray(first / (sums[0] + rigid.sum()))


@dataclasses.dataclass
class _Rigid:
    bodies: Any
    centres: np.ndarray
    tied: dict[str, np.ndarray]


def _rigid_bodies(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody, carried: np.ndarray, supports: Any
) -> _Rigid:
    """One rigid body per cell group, with the mass its nodes carry."""
    from flexapod.dynamics.rigid import RigidBodies

    tied: dict[str, np.ndarray] = {}
    for index, spec in enumerate(loaded.case.rigid):
        where = f"{loaded.source}: rigid.{index}.group"
        for name in match_names([spec.group], mesh.cell_groups, "cell", where):
            tied[name] = np.unique(mesh.cells[group_cells(mesh, name, where)])
    if not tied:
        return _Rigid(RigidBodies.empty(), np.zeros((0, 3)), {})
    nodal = body.node_mass + carried
    mass, centre, inertia, free = [], [], [], []
    for nodes in tied.values():
        # Point masses at the nodes: what the lumped mesh itself has, carried mass included, and
        # so also what surrounding silicone lumps onto the surface.
        m, x = nodal[nodes], mesh.nodes[nodes]
        c = (m[:, None] * x).sum(axis=0) / m.sum()
        r = x - c
        square = (r * r).sum(axis=1)
        mass.append(m.sum())
        centre.append(c)
        inertia.append(
            (m[:, None, None] * (square[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]))
            .sum(axis=0)
        )  # fmt: skip
        lock = np.ones(6, dtype=bool)
        for part in supports:
            if np.intersect1d(part.node_index, nodes).size:
                # A node in a plane of symmetry keeps its body from leaving or turning out of it.
                lock[part.axis] = False
                lock[[3 + i for i in range(3) if i != part.axis]] = False
        free.append(lock)
    bodies = RigidBodies(tuple(tied), np.array(mass), np.array(inertia), np.array(free))
    return _Rigid(bodies, np.array(centre), tied)


def _contacts(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody
) -> tuple[Any, list[DynamicContact]]:
    from flexapod.dynamics.contacts import GroundContact, SurfaceContact

    first: Any = None
    contacts: list[DynamicContact] = []
    for index, spec in enumerate(loaded.case.contact):
        where = f"{loaded.source}: contact.{index}"
        name = f"{spec.type}_{index}"
        faces = surface_faces(mesh, spec.surface, f"{where}.surface")  # type: ignore[union-attr]
        modulus = surface_modulus(mesh, body, faces)
        if spec.type == "ground":
            ground = make_ground(loaded, spec, where)
            law = _ground_law(modulus, spec.exponent)
            contacts.append(GroundContact(name, mesh.nodes, faces, ground, law, skin=spec.skin))
            first = first or ground
            continue
        partner, other = faces, modulus
        if spec.type == "pair":
            partner = surface_faces(mesh, spec.against, f"{where}.with")
            other = surface_modulus(mesh, body, partner)
        law = contact_law(spec, modulus, other)
        contacts.append(
            SurfaceContact(name, mesh.nodes, faces, partner, law, depth=spec.depth)  # type: ignore[union-attr]
        )
    return first, contacts


def _ground_law(modulus: float, exponent: float) -> Any:
    from flexapod.contact.law import ContactLaw, hertz_stiffness

    radius = 500.0  # [m], of either side in the paper's law
    stiffness = hertz_stiffness(modulus, 0.5, math.inf, 0.3, radius, radius)
    return ContactLaw(stiffness, stiffness_exponent=exponent, stick_stiffness=STICK_STIFFNESS)


def make_ground(loaded: LoadedCase, spec: Any, where: str) -> Any:
    """The ground a contact table describes."""
    from flexapod.contact.ground import HeightField, Step, slope
    from flexapod.contact.law import FrictionLaw

    dynamic = spec.friction if spec.friction_dynamic is None else spec.friction_dynamic
    friction = FrictionLaw(spec.friction, dynamic, spec.static_speed, spec.dynamic_speed)
    if spec.shape == "step":
        return Step(spec.step_at, spec.step_height, friction)
    if spec.shape == "plane":
        return slope(spec.slope, (0.0, 0.0, spec.level), friction)
    path = loaded.path(spec.file)
    try:
        if path.suffix.lower() == ".csv":
            field = HeightField.from_csv(path, spec.spacing, friction=friction)
        else:
            from matplotlib.image import imread

            field = HeightField.from_image(
                imread(path), spec.spacing, spec.relief, friction=friction
            )
    except (InputError, OSError) as error:
        raise InputError(str(error), f"{where}.file") from None
    # The body starts over the field's middle.
    middle = [0.5 * (n - 1) * spec.spacing for n in field.heights.shape]
    return dataclasses.replace(field, x0=-middle[0], y0=-middle[1])


def _set_down(loaded: LoadedCase, mesh: TaggedMesh, u: np.ndarray, ground: Any) -> np.ndarray:
    """Turn the start shape with the slope and lower it until its lowest node touches."""
    from flexapod.dynamics.contacts import gaps

    spec = loaded.case.start
    if spec is None:
        return u
    slope = max((c.slope for c in loaded.case.contact if c.type == "ground"), default=0.0, key=abs)
    angle = spec.turn + (slope if spec.rest else 0.0)
    x = mesh.nodes + u
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    if angle != 0.0:
        x = x @ turn.T
    if spec.rest and ground is not None:
        for _ in range(20):
            lowest = float(gaps(ground, x).min())
            if abs(lowest) < 1e-9:
                break
            x = x - lowest * np.array([math.sin(slope), 0.0, math.cos(slope)])
    return np.asarray(x - mesh.nodes)


def _chambers(loaded: LoadedCase, mesh: TaggedMesh, part: float) -> list[Chamber]:
    """Chambers and what feeds them; a pump gives `part`, the modelled one, of its flow."""
    from flexapod.dynamics.commands import Chamber, PressureTable, Pump, Table

    chambers = []
    begun = 0.0 if loaded.case.start is None else 1.0
    for spec in loaded.case.pressure:
        where = f"{loaded.source}: pressure.{spec.name}.surface"
        faces = np.ascontiguousarray(surface_faces(mesh, spec.surface, where), dtype=np.int64)
        points = spec.over_time or ((0.0, 1.0),)
        times = tuple(float(t) for t, _ in points)
        factors = [float(f) for _, f in points]
        command: Any
        if spec.pump is None:
            command = PressureTable(Table(times, tuple(spec.value * f for f in factors)))
        else:
            command = Pump(
                Table(times, tuple(part * spec.pump.flow * max(f, 0.0) for f in factors)),
                Table(times, tuple(part * spec.pump.exhaust * max(-f, 0.0) for f in factors)),
                stall=spec.value,
                start=spec.pump.start if spec.pump.start is not None else begun * spec.value,
            )
        chambers.append(Chamber(spec.name, faces, command))
    return chambers


def _bonds(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody, carried: np.ndarray, u: np.ndarray
) -> list[Bond]:
    from flexapod.dynamics.model import Bond, bond_pairs
    from flexapod.fem.loads import face_node_areas

    bonds = []
    mass = body.node_mass + carried
    for spec in loaded.case.bond:
        where = f"{loaded.source}: bond.{spec.name}.surfaces"
        one = surface_faces(mesh, [spec.surfaces[0]], where)
        two = surface_faces(mesh, [spec.surfaces[1]], where)
        first, second = np.unique(one), np.unique(two)
        x = mesh.nodes + u
        pairs, count = bond_pairs(x, first, second, spec.closed)
        length = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
        areas = face_node_areas(mesh.nodes, one)[first]
        stiffness = np.repeat(spec.stiffness * areas / count, count)
        lightest = np.minimum(mass[pairs[:, 0]], mass[pairs[:, 1]])
        omega = float(np.sqrt(2.0 * count * stiffness / lightest).max())
        bonds.append(
            Bond(
                spec.name,
                pairs,
                stiffness,
                length,
                math.inf if spec.strength is None else spec.strength,
                2.0 * spec.damping / omega,
            )
        )
    return bonds


# --------------------------------------------------------------------------- recording


class _Recorder:
    def __init__(self, loaded: LoadedCase, motion: Motion, folder: ResultsFolder) -> None:
        self.loaded = loaded
        self.motion = motion
        self.folder = folder
        self.probes: list[Probe] = make_probes(loaded, motion.mesh)
        self.previous = {probe.head: 0.0 for probe in self.probes}
        spec = loaded.case.dynamics
        assert spec is not None
        self.intervals = round(spec.duration / spec.interval)
        self.every = max(1, round(self.intervals / spec.frames))
        self.largest_energy = 0.0
        self.turn = 0.0
        self.centre_start: np.ndarray | None = None
        self.weight_start: float | None = None
        # Every so many nodes: two hundred tell the turn of the whole.
        count = motion.model.mesh_node_count
        self.sample = np.arange(0, count, max(1, count // 200))
        self.sample_start: np.ndarray | None = None

    def row(self, energies: Energies) -> dict[str, float]:
        """Columns at the state of the last forces."""
        from flexapod.dynamics import kernels

        model, state, work = self.motion.model, self.motion.state, self.motion.work
        sums = np.zeros(10)
        kernels.momentum(model.mass, model.owner, state.x, state.v, sums)
        rigid = model.rigid.mass
        mass = sums[0] + rigid.sum()
        centre = (sums[1:4] + (rigid[:, None] * state.rigid_x).sum(axis=0)) / mass
        velocity = (sums[4:7] + (rigid[:, None] * state.rigid_v).sum(axis=0)) / mass
        row: dict[str, float] = {"time_s": state.time}
        for k, chamber in enumerate(model.chambers):
            head = "pressure_kPa" if len(model.chambers) == 1 else f"pressure_{chamber.name}_kPa"
            row[head] = float(work.chamber_pressure[k]) / 1000.0
        for axis, value in zip("xyz", centre, strict=True):
            row[f"centre_{axis}_mm"] = 1000.0 * float(value)
        row["speed_m_s"] = float(np.linalg.norm(velocity))
        reactions = np.zeros_like(state.x)
        for probe in self.probes:
            value = probe.sample(state.x, reactions, self.previous[probe.head])
            self.previous[probe.head] = value
            row[probe.head] = value
        row["turn_deg"] = self._turned()
        for name in (
            "kinetic", "strain", "weight", "contact", "bond", "pressure_work", "contact_loss",
            "mass_damping_loss", "internal_loss", "viscous_loss", "bond_loss", "unaccounted",
        ):  # fmt: skip
            row[f"{name}_J"] = float(getattr(energies, name))
        for contact in model.contacts:
            totals = contact.totals
            row[f"{contact.name}_force_N"] = contact.pressing()
            row[f"{contact.name}_area_mm2"] = 1e6 * float(totals[2])
            row[f"{contact.name}_depth_mm"] = 1e3 * float(totals[3])
            row[f"{contact.name}_points"] = float(totals[7])
        for bond, totals in zip(model.bonds, work.bond_totals, strict=True):
            row[f"bond_{bond.name}_force_N"] = float(np.linalg.norm(totals[1:4]))
        row["time_step_us"] = 1e6 * state.dt_before
        return row

    def _turned(self) -> float:
        """Turn of the body as a whole about y since the start [deg], whole turns counted."""
        from flexapod.app.probes import angle_about, best_rotation, unwrap

        x = self.motion.state.x[self.sample]
        if self.sample_start is None:
            self.sample_start = x.copy()
        angle = angle_about(best_rotation(self.sample_start, x), "y")
        self.turn = unwrap(angle, self.turn)
        return self.turn

    def record(self, state: State) -> None:
        """Write a row, and a frame with its fields where one is due."""
        from flexapod.dynamics.integrator import energies as ledger

        energies = ledger(self.motion.model, state, self.motion.work)
        if self.weight_start is None:
            self.weight_start = energies.weight
        self.largest_energy = max(
            self.largest_energy,
            energies.kinetic,
            energies.strain,
            abs(energies.weight - self.weight_start),
            abs(energies.pressure_work),
        )
        row = self.row(energies)
        if self.centre_start is None:
            self.centre_start = np.array([row[f"centre_{axis}_mm"] for axis in "xyz"])
        if state.interval % self.every == 0 or state.interval >= self.intervals:
            self.folder.write_state(
                self.motion.mesh.nodes, self.motion.mesh.cells, self._frame(state, row)
            )
        else:
            self.folder.write_row(row)

    def _frame(self, state: State, row: dict[str, float]) -> OutputState:
        model, body = self.motion.model, self.motion.body
        count = model.mesh_node_count
        fields = body.fields(state.u[:count])
        pressure = np.zeros(model.node_count)
        for contact in model.contacts:
            pressure = np.maximum(pressure, contact.nodal_pressure(model.node_count))
        return OutputState(
            state.time,
            row,
            state.u[:count],
            {"contact_pressure": pressure[:count], "velocity": state.v[:count]},
            {
                "pressure": fields.pressure,
                "principal_stretches": fields.principal_stretches,
                "cauchy_stress": fields.cauchy_stress.reshape(-1, 9),
                "material": body.material.astype(np.int32),
            },
        )

    def checkpoint(self, state: State) -> None:
        """Keep all that moves."""
        arrays, about = state.to_arrays()
        extra = {
            "previous": self.previous,
            "turn": self.turn,
            "largest_energy": self.largest_energy,
            "weight_start": self.weight_start,
        }
        if self.motion.model.viscous is not None:
            history = self.motion.model.viscous.history()
            arrays = {**arrays, **{f"viscous.{key}": value for key, value in history.items()}}
        if self.sample_start is not None:
            arrays = {**arrays, "sample_start": self.sample_start}
        if self.centre_start is not None:
            arrays = {**arrays, "centre_start": self.centre_start}
        self.folder.write_checkpoint(
            arrays, {"state": about, "recorder": extra, "flexapod_version": package_version()}
        )

    def resume(self) -> bool:
        """Take the last checkpoint's state; False where there is none."""
        from flexapod.dynamics.model import State

        kept = self.folder.read_checkpoint()
        if kept is None:
            return False
        arrays, about = kept
        extra = about["recorder"]
        viscous = {k: arrays.pop(k) for k in list(arrays) if k.startswith("viscous.")}
        if self.motion.model.viscous is not None and viscous:
            self.motion.model.viscous.restore(
                {key.removeprefix("viscous."): value for key, value in viscous.items()}
            )
        self.sample_start = arrays.pop("sample_start", None)
        self.centre_start = arrays.pop("centre_start", None)
        self.previous.update(extra["previous"])
        self.turn = extra["turn"]
        self.largest_energy = extra["largest_energy"]
        self.weight_start = extra["weight_start"]
        numbers = {k: (math.nan if v is None else v) for k, v in about["state"].items()}
        state = State.from_arrays(arrays, numbers)
        if state.u.shape != self.motion.state.u.shape:
            raise InputError(
                "the checkpoint is of another mesh; run without --resume", str(self.folder.path)
            )
        self.motion.state = state
        return True


def run_motion(
    loaded: LoadedCase,
    out: Path,
    resume: bool,
    progress: Callable[[Any], None],
    say: Say,
    notices: list[str],
) -> tuple[Status, str, dict[str, Any]]:
    """Run a case with [dynamics]; returns status, message and summary, all files written."""
    from flexapod.app.run import Progress, resolve, terminated_like_interrupted
    from flexapod.dynamics.integrator import Options, RunStats, march

    began = time.perf_counter()
    spec = loaded.case.dynamics
    assert spec is not None
    folder = ResultsFolder.open(out, resolve(loaded, None), resume=resume)
    going_on = resume and (out / CHECKPOINT_FILE).is_file()
    with terminated_like_interrupted():
        try:
            # Names and laws are looked up before minutes are spent on the start shape.
            assemble_motion(loaded, None, lambda text: None, settle=False)
            start = start_shape(loaded, out, resume, say)
            motion = assemble_motion(loaded, start, say, settle=not going_on)
        except (KeyboardInterrupt, SolverError) as error:
            status = error.status if isinstance(error, SolverError) else Status.INTERRUPTED
            message = str(error) or "stopped by the user before the motion began"
            summary = _short_summary(loaded, out, began, status, message)
            folder.write_summary(summary)
            return status, message, summary
    recorder = _Recorder(loaded, motion, folder)
    say(f"{len(motion.mesh.cells)} hexahedra, {len(motion.mesh.nodes)} nodes")
    if resume and recorder.resume():
        say(f"going on from {motion.state.interval * spec.interval:.4g} s")
    elif resume:
        folder.clear()
    options = Options(spec.interval, spec.safety, spec.time_step)
    status, message = Status.DONE, "reached the end of the motion"
    stats = RunStats()
    marched = time.perf_counter()

    def done(state: State) -> None:
        row = folder.rows[-1]
        progress(
            Progress(state.interval / recorder.intervals, "motion", row, state.interval % 20 == 0)
        )
        if state.interval % spec.checkpoint == 0 or state.interval == recorder.intervals:
            recorder.checkpoint(state)

    with terminated_like_interrupted():
        try:
            march(
                motion.model,
                motion.state,
                motion.work,
                recorder.intervals,
                options,
                recorder.record,
                done,
                stats,
            )
            _last_row(recorder)
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status, message = Status.INTERRUPTED, f"stopped at {motion.state.time:.4g} s"
    marched = time.perf_counter() - marched
    summary = {
        "case": loaded.name,
        "title": loaded.case.title,
        "status": status.name.lower(),
        "message": message,
        "version": package_version(),
        "elements": len(motion.mesh.cells),
        "nodes": len(motion.mesh.nodes),
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "resumed": resume,
        "results": _results(recorder, motion, stats, marched),
        "reference": None,
        "warnings": notices,
        "folder": str(out),
    }
    folder.write_summary(summary)
    return status, message, summary


def _last_row(recorder: _Recorder) -> None:
    """Forces and energies at the very end, without going on."""
    from flexapod.dynamics.integrator import last_record

    motion = recorder.motion
    last_record(motion.model, motion.state, motion.work, lambda: recorder.record(motion.state))


def _short_summary(
    loaded: LoadedCase, out: Path, began: float, status: Status, text: str
) -> dict[str, Any]:
    """Summary of a motion that never began."""
    return {
        "case": loaded.name,
        "status": status.name.lower(),
        "message": text,
        "version": package_version(),
        "elements": 0,
        "nodes": 0,
        "wall_time_s": time.perf_counter() - began,
        "peak_memory_bytes": peak_memory(),
        "results": {"states": 0},
        "reference": None,
        "warnings": [],
        "folder": str(out),
    }


def _results(
    recorder: _Recorder, motion: Motion, stats: RunStats, marched: float
) -> dict[str, Any]:
    rows = recorder.folder.rows
    last = rows[-1] if rows else {}
    results: dict[str, Any] = {**last, "states": len(recorder.folder.times)}
    if rows and recorder.centre_start is not None:
        now = np.array([last[f"centre_{axis}_mm"] for axis in "xyz"])
        results["distance_m"] = 1e-3 * float(np.linalg.norm(now - recorder.centre_start))
        results["peak_speed_m_s"] = max(row["speed_m_s"] for row in rows)
        results["turns"] = last["turn_deg"] / 360.0
        times = np.array([row["time_s"] for row in rows])
        speeds = np.array([row["speed_m_s"] for row in rows])
        if len(rows) > 2:
            results["peak_acceleration_m_s2"] = float(np.abs(np.gradient(speeds, times)).max())
        worst = max(abs(row["unaccounted_J"]) for row in rows)
        results["energy_balance"] = worst / max(recorder.largest_energy, 1e-300)
        results["largest_energy_J"] = recorder.largest_energy
        # What is stored at rest flatters: the share of what changed says more.
        changes = [
            abs(row[head] - rows[0][head])
            for row in rows
            for head in ("kinetic_J", "strain_J", "weight_J", "pressure_work_J")
        ]
        results["energy_balance_of_changes"] = worst / max(*changes, 1e-300)
    results["mass_kg"] = motion.mass
    results["scaled_mass_kg"] = motion.model.scaled_mass
    results["steps"] = motion.state.step_count
    results["smallest_step_us"] = 1e6 * stats.smallest_step if stats.steps else None
    results["largest_step_us"] = 1e6 * stats.largest_step if stats.steps else None
    results["deepest_penetration_mm"] = 1e3 * stats.deepest
    results["motion_time_s"] = marched
    if stats.steps:
        results["element_updates_per_s"] = stats.steps * motion.model.soft_cells.size / marched
    return results
