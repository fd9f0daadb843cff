"""From a moving case to its model and first state: start shape, settling, setting down."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import (
    build_mesh,
    carried_mass,
    make_materials,
    make_supports,
    modelled_fraction,
)
from flexapod.app.case import LoadedCase, load_case, package_version, start_case
from flexapod.app.motion_parts import make_bonds, make_chambers, make_contacts
from flexapod.app.motion_rigid import RigidParts, make_rigid, set_in_motion
from flexapod.app.outputs import ResultsFolder
from flexapod.app.spec_dynamics import StartSpec
from flexapod.core.errors import InputError, SolverError, Status

if TYPE_CHECKING:
    from flexapod.app.motion_ring import RingParts
    from flexapod.app.motion_robot import RobotParts, Torso
    from flexapod.dynamics.commands import Chamber
    from flexapod.dynamics.contacts import History
    from flexapod.dynamics.model import Model, State
    from flexapod.dynamics.workspace import Workspace
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.tagged import TaggedMesh

Say = Callable[[str], None]


@dataclasses.dataclass
class Motion:
    """All a run needs."""

    mesh: TaggedMesh | None  # None for a body of lines alone
    body: SolidBody | None
    model: Model
    state: State
    work: Workspace
    ground: Any  # the first ground; None without
    mass: float  # of everything [kg], of the modelled part
    shape: Shape  # before it was turned and set down
    rigid: RigidParts
    ring: RingParts | None = None
    robot: RobotParts | None = None
    loaded: LoadedCase | None = None  # where it is not the case as written: of a rigid body
    notices: list[str] = dataclasses.field(default_factory=list)

    @property
    def size(self) -> tuple[int, int, int]:
        """Hexahedra, nodes and line elements."""
        cells = 0 if self.mesh is None else len(self.mesh.cells)
        lines = self.model.lines
        return cells, self.model.rigid_start, 0 if lines is None else len(lines.lines)


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
    if spec is None or spec.case is None or loaded.case.rigid_bodied:
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
    if "mesh" in own and loaded.case.sized_mesh is not None:
        table["mesh"] = loaded.case.sized_mesh.model_dump(
            mode="json", by_alias=True, exclude_none=True
        )
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
    sink: bool = True,
) -> Motion:
    """Look up everything a case names and make the model and its first state.

    Without `settle` the start shape is left as it is: for a run that goes on from a checkpoint.
    With `settled` (`settled_shape`) it is that one. Without `sink` it is not made to bear its
    weight.
    """
    from flexapod.dynamics.model import Damping, Model
    from flexapod.dynamics.stable import scale_mass
    from flexapod.dynamics.workspace import Workspace
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.unfold import unfold, unfold_shares, unfold_vectors

    case, source = loaded.case, loaded.source
    assert case.dynamics is not None
    if case.ring is not None:
        from flexapod.app.motion_ring import ring_motion

        return ring_motion(loaded)
    torso: Torso | None = None
    notices: list[str] = []
    if loaded.case.rigid_bodied:
        from flexapod.app.motion_robot import rigid_torso

        torso = rigid_torso(loaded)
        if torso.left_out:
            notices.append(f"a rigid body has no use for {', '.join(torso.left_out)}: left out")
        loaded, mesh, start = torso.loaded, torso.mesh, None
        case = loaded.case
    else:
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
    spec, spec_start = case.dynamics, case.start
    assert spec is not None
    supports = make_supports(loaded, mesh)
    legs = None
    if case.robot is not None:
        from flexapod.app import motion_robot

        if torso is None:
            loaded = motion_robot.with_rigid_stations(loaded, mesh)
            legs = motion_robot.make_legs(loaded, mesh)
            more = legs.bodies
        else:
            legs = motion_robot.make_legs(loaded, torso.stations, motion_robot.TORSO)
            more = motion_robot.torso_rigid(torso, legs)
        rigid = make_rigid(loaded, mesh, body, carried, supports, more)
    else:
        rigid = make_rigid(loaded, mesh, body, carried, supports)
    ground, contacts = make_contacts(loaded, mesh, body, rigid)
    gravity = case.gravity.tilted() if case.gravity is not None else (0.0, 0.0, 0.0)
    model = Model(
        body,
        rigid=rigid.bodies,
        rigid_centres=rigid.centres,
        rigid_nodes=(rigid.nodes, rigid.owner),
        joints=None if legs is None else motion_robot.make_joints(loaded, legs, rigid),
        tied=rigid.tied,
        carried_mass=carried,
        displacements=supports,
        gravity=gravity,
        chambers=make_chambers(loaded, mesh, modelled),
        contacts=contacts,
        damping=Damping(spec.mass_damping, spec.stiffness_damping),
        bonds=make_bonds(loaded, mesh, body, carried, u),
    )
    work = Workspace(model)

    def make_heavier(state: State) -> None:
        """Scale masses for elements as they are now, and for what they touch."""
        if spec is not None and spec.mass_scaling is not None:
            added = scale_mass(model, state, work, spec.mass_scaling)
            say(f"mass scaling adds {added * 1e3:.3g} g")

    make_heavier(model.start(u))
    shape = Shape(u, {})
    if settled is not None:
        shape = settled
    elif settle and start is not None and spec_start is not None and spec_start.settle > 0.0:
        shape = _settle(model, u, spec_start, rigid, [bond.closed for bond in case.bond], say)
    for bond, shut in zip(model.bonds, case.bond, strict=True):
        if shut.closed:
            bond.length[:] = 0.0
    along = _carried_along(model, rigid, shape.u)
    state = model.start(_set_down(loaded, mesh, shape.u, ground, along))
    for k, contact in enumerate(model.contacts):
        if contact.name in shape.histories:
            # Gaps do not change as the whole is turned and set down.
            kept = shape.histories[contact.name]
            state.histories[k] = {key: value.copy() for key, value in kept.items()}
    if settle and sink and _is_set_down(spec_start, model, ground):
        assert spec_start is not None
        make_heavier(state)
        _sink_in(model, state, spec_start, rigid, ground_slope(loaded), say)
        make_heavier(state)
    set_in_motion(model, state, rigid)
    free = model.owner < 0
    total = float(model.own_mass[free].sum() + model.rigid.mass.sum())
    robot = None
    if case.robot is not None:
        robot = motion_robot.RobotParts(model, rigid, case.robot.marker)
    return Motion(
        mesh,
        body,
        model,
        state,
        work,
        ground,
        total,
        shape,
        rigid,
        robot=robot,
        loaded=None if torso is None else loaded,
        notices=notices,
    )


def _settle(
    model: Model,
    u: np.ndarray,
    spec: StartSpec,
    rigid: RigidParts,
    closed: list[bool],
    say: Say,
) -> Shape:
    """The shape after it has come to rest without weight and ground, its ends drawn together.

    Nor does it meet loose bodies: those have their place in space, which it has not yet.
    """
    from flexapod.dynamics.surface_contact import SurfaceContact
    from flexapod.dynamics.workspace import Workspace

    still = _at_rest(model, spec)
    still.gravity = np.zeros(3)
    still.contacts = [
        c
        for c in model.contacts
        if isinstance(c, SurfaceContact) and not rigid.among(c.watched, model.owner)
    ]
    # Drawn together by whatever it takes; what holds it then is asked below.
    still.bonds = [
        dataclasses.replace(
            bond, strength=math.inf, draw_time=DRAW_SHARE * spec.settle if shut else 0.0
        )
        for bond, shut in zip(model.bonds, closed, strict=True)
    ]
    state, work = still.start(u), Workspace(still)
    say(f"settling for {spec.settle * 1e3:.3g} ms")
    _come_to_rest(still, state, work, spec.settle)
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


def _sink_in(
    model: Model, state: State, spec: StartSpec, rigid: RigidParts, slope: float, say: Say
) -> None:
    """Let the body bear its weight on the ground, held back from going downhill, until it rests.

    Loose bodies are held where they are. Weight without its part along the slope is eased on. So a
    motion begins with the body flattened as it lies, not with a fall into its own flattening.
    """
    from flexapod.dynamics.workspace import Workspace

    still = _at_rest(model, spec)
    still.rigid = rigid.held()
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    weight = (model.gravity @ normal) * normal
    still.gravity = np.zeros(3)
    begun, work = _centre_height(model, state, normal), Workspace(still)

    def ease_on(state: State) -> None:
        share = min(1.0, state.time / (DRAW_SHARE * spec.set_down))
        still.gravity[:] = share * share * (3.0 - 2.0 * share) * weight

    _come_to_rest(still, state, work, spec.set_down, ease_on)
    sunk = begun - _centre_height(model, state, normal)
    say(f"set down: sank in by {sunk * 1e3:.3g} mm, {work.kinetic * 1e3:.3g} mJ left")
    state.begin_anew()


# Share of a settling time in which what disturbs the body is eased on.
DRAW_SHARE = 0.6


def _at_rest(model: Model, spec: StartSpec) -> Model:
    """The model with its pressures held and its motion damped."""
    from flexapod.dynamics.model import Damping

    still = copy.copy(model)
    still.damping = Damping(mass=spec.settle_damping)
    still.chambers = [_held(chamber) for chamber in model.chambers]
    still.cavities = [None for _ in model.chambers]
    if model.joints is not None:
        from flexapod.app.motion_robot import held_joints

        still.joints = held_joints(model.joints)
    return still


def _come_to_rest(
    still: Model,
    state: State,
    work: Workspace,
    duration: float,
    change: Callable[[State], None] | None = None,
) -> None:
    from flexapod.dynamics.integrator import Options, march

    intervals = max(1, math.ceil(duration / 1e-3))
    options = Options(interval=duration / intervals)
    march(still, state, work, intervals, options, interval_done=change)


def _centre_height(model: Model, state: State, up: np.ndarray) -> float:
    return float(centre(model, state) @ up)


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
    return assemble_motion(loaded, start, say, sink=False).shape


def scaled_arrays(model: Model) -> dict[str, np.ndarray]:
    """What a checkpoint keeps of mass scaling: it was made for a shape that is gone."""
    if model.scaled_mass == 0.0:
        return {}
    return {
        "scaled.mass": model.mass,
        "scaled.element_mass": model.element_mass,
        "scaled.added": np.array([model.scaled_mass]),
    }


def restore_scaled(model: Model, work: Workspace, arrays: dict[str, np.ndarray]) -> None:
    """Take `scaled_arrays` out of the arrays of a checkpoint."""
    if "scaled.mass" in arrays:
        model.mass = arrays.pop("scaled.mass")
        model.element_mass = arrays.pop("scaled.element_mass")
        model.scaled_mass = float(arrays.pop("scaled.added")[0])
        work.inverse_mass = model.inverse_mass()


def restored_state(
    motion: Motion, arrays: dict[str, np.ndarray], numbers: dict[str, Any], where: str
) -> State:
    """The state of a checkpoint of this motion, its scaled masses put back.

    Raises
    ------
    InputError
        It is of another mesh, or of a version whose contacts remember other things.
    """
    from flexapod.dynamics.model import State

    restore_scaled(motion.model, motion.work, arrays)
    numbers = {k: (math.nan if v is None else v) for k, v in numbers.items()}
    state = State.from_arrays(arrays, numbers)
    if state.u.shape != motion.state.u.shape:
        raise InputError("the checkpoint is of another mesh; run without --resume", where)
    for old, new in zip(state.histories, motion.state.histories, strict=True):
        if old.keys() != new.keys():
            raise InputError(
                "the checkpoint is of another version of flexapod; run without --resume", where
            )
    return state


def centre(model: Model, state: State) -> np.ndarray:
    """Centre of all masses [m]."""
    from flexapod.dynamics import kernels

    sums = np.zeros(10)
    kernels.momentum(model.own_mass, model.owner, state.x, state.v, sums)
    rigid = model.rigid.mass
    first = sums[1:4] + (rigid[:, None] * state.rigid_x).sum(axis=0)
    return np.asarray(first / (sums[0] + rigid.sum()))


def _is_set_down(spec: StartSpec | None, model: Model, ground: Any) -> bool:
    if spec is None or ground is None or not model.gravity.any():
        return False
    return spec.rest and spec.set_down > 0.0


def ground_slope(loaded: LoadedCase) -> float:
    """Slope of the ground [rad]."""
    return max((c.slope for c in loaded.case.contact if c.type == "ground"), default=0.0, key=abs)


def uphill(loaded: LoadedCase) -> np.ndarray:
    """Direction along the ground that goes up its slope: -x where that is positive, or nought."""
    slope = ground_slope(loaded)
    up = np.array([-math.cos(slope), 0.0, math.sin(slope)])
    return -up if slope < 0.0 else up


def _carried_along(model: Model, rigid: RigidParts, u: np.ndarray) -> np.ndarray:
    """Places of the surface nodes of tied bodies [m] at the mesh's displacements `u` [m]."""
    own = np.flatnonzero(~rigid.loose[rigid.owner])
    if not own.size:
        return np.zeros((0, 3))
    return np.asarray(model.start(u).x[model.mesh_node_count + own])


def _set_down(
    loaded: LoadedCase, mesh: TaggedMesh, u: np.ndarray, ground: Any, along: np.ndarray
) -> np.ndarray:
    """Turn the start shape with the slope and lower it until its lowest node touches.

    `along` are further points [m] that go with it, shape (point_count, 3).
    """
    spec = loaded.case.start
    if spec is None:
        return u
    slope = ground_slope(loaded)
    x = turned(np.concatenate([mesh.nodes + u, along]), spec.turn + (slope if spec.rest else 0.0))
    if spec.rest:
        x = put_on_ground(x, ground, slope)
    return np.asarray(x[: len(mesh.nodes)] - mesh.nodes)


def turned(x: np.ndarray, angle: float) -> np.ndarray:
    """Points [m] turned about the y axis by an angle [rad]."""
    if angle == 0.0:
        return x
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.asarray(x @ turn.T)


def put_on_ground(x: np.ndarray, ground: Any, slope: float) -> np.ndarray:
    """Points [m] moved along the normal of the slope [rad] until the lowest touches the ground."""
    from flexapod.dynamics.ground_contact import gaps

    if ground is None:
        return x
    for _ in range(20):
        lowest = float(gaps(ground, x).min())
        if abs(lowest) < 1e-9:
            break
        x = x - lowest * np.array([math.sin(slope), 0.0, math.cos(slope)])
    return x
