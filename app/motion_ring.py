"""A ring robot from its case: model, first state, columns of its rows, lines of its frames."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import contact_law
from flexapod.app.case import LoadedCase
from flexapod.app.motion_model import Motion, Shape, ground_slope, put_on_ground, turned
from flexapod.app.motion_parts import make_ground
from flexapod.app.motion_rigid import no_rigid
from flexapod.app.outputs import OutputLines
from flexapod.app.spec_ring import RingSolidSpec, RingSpec
from flexapod.geometry.ring import LETTERS, lumped_ring, lumped_sphere, solid_ring, solid_section

if TYPE_CHECKING:
    from flexapod.dynamics.actuation import Actuation
    from flexapod.dynamics.contacts import DynamicContact
    from flexapod.dynamics.lines import Coils, Hinges, Lines
    from flexapod.dynamics.model import Model, State
    from flexapod.geometry.tagged import TaggedMesh

# Both ends of a coil: nodes whose middle it ends in.
Ends = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class RingParts:
    """What rows and frames need to know of a ring robot.

    Attributes
    ----------
    hub
        Number of the hub's node.
    coils
        Names of the coils, in the order of their rows.
    pairs
        Nodes that each line of the model joins, for pictures, shape (line_count, 2).
    """

    hub: int
    coils: tuple[str, ...]
    pairs: np.ndarray

    def columns(self, model: Model, state: State) -> dict[str, float]:
        """Columns of curve.csv beside those of every motion.

        The hub's place; what is stored in the shell's stretch and bending and in the coils; and of
        each coil the force in all (tension is positive), the active part of it, and the voltage.
        """
        system = model.lines
        assert system is not None and system.coils is not None
        row: dict[str, float] = {}
        for axis, value in zip("xyz", state.x[self.hub], strict=True):
            row[f"hub_{axis}_mm"] = 1000.0 * float(value)
        parts = system.stored_parts(state.x, state.lines)
        for name, energy in zip(("stretch", "coils", "bend"), parts, strict=True):
            row[f"{name}_J"] = energy
        force = state.lines["force"][system.lines.coil >= 0]
        on = system.coils.actuation.on(state.time)
        for k, name in enumerate(self.coils):
            row[f"coil_{name}_force_mN"] = 1000.0 * float(force[k])
            row[f"coil_{name}_active_mN"] = 1000.0 * float(state.lines["active"][k])
            row[f"coil_{name}_on"] = float(on[k])
        return row

    def output(self, model: Model, state: State, pressure: np.ndarray) -> OutputLines:
        """Shell and coils where they are, with what pulls in them."""
        system = model.lines
        assert system is not None and system.coils is not None
        coil = system.lines.coil
        # The last entry is that of a line without a coil, row -1.
        active = np.append(state.lines["active"], 0.0)
        on = np.append(system.coils.actuation.on(state.time), False)
        return OutputLines(
            model.nodes,
            self.pairs,
            state.u,
            {"contact_pressure": pressure, "velocity": state.v},
            {
                "coil": coil.astype(np.int32),
                "on": on[coil].astype(np.int32),
                "active_force": active[coil],
                "force": state.lines["force"].copy(),
                "elongation": state.lines["length"] - system.lines.length,
            },
        )


# --------------------------------------------------------------------------- bodies


@dataclass(frozen=True)
class _Body:
    """A ring's body before it is put on the ground.

    Attributes
    ----------
    nodes
        All nodes [m], shape (node_count, 3); the hub is the last.
    fixed
        Ways they cannot move, shape (node_count, 3).
    point_mass
        Masses [kg] of the last nodes, which are not a mesh's.
    mesh
        Hexahedra of a solid shell; None without.
    shell, hinges
        Lines and bending of a shell of elements; without any of a solid one.
    ends
        Of every coil there may be, by its name.
    faces, areas, curve
        What touches the ground, as `ground_contact.GroundContact` takes it.
    modulus
        Young's modulus for contact [Pa].
    """

    nodes: np.ndarray
    fixed: np.ndarray
    point_mass: np.ndarray
    mesh: TaggedMesh | None
    shell: Lines
    hinges: Hinges
    ends: dict[str, Ends]
    faces: np.ndarray
    areas: np.ndarray | None
    curve: tuple[np.ndarray, np.ndarray] | None
    modulus: float


def _elements(spec: RingSpec) -> _Body:
    """The paper's shell of masses, springs and bending springs."""
    from flexapod.dynamics.lines import Hinges, Lines

    sizes = spec.sizes
    make = lumped_sphere if spec.shape == "sphere" else lumped_ring
    layout = make(sizes, spec.rest_curvature)
    touching = layout.touching(spec.contact_refine)
    stiffness = sizes.hinge_stiffness
    count = len(layout.rings)
    fixed = np.zeros(layout.nodes.shape, dtype=bool)
    fixed[:, 1] = spec.shape == "circle"
    like = RingSolidSpec()
    return _Body(
        layout.nodes,
        fixed,
        layout.node_mass,
        None,
        Lines.between(
            [(int(a), int(b)) for a, b in layout.segments],
            length=layout.segment_length,
            stiffness=sizes.element_stiffness,
            damping=sizes.element_damping,
        ),
        Hinges(
            layout.rings,
            ((stiffness, sizes.out_of_plane_ratio * stiffness),) * count,
            (float(layout.rest_angle[0]),) * count,
            (sizes.bend_damping,) * count,
        ),
        {
            name: (np.array([a]), np.array([b]))
            for name, (a, b) in {**layout.spokes, **layout.chords}.items()
        },
        touching.faces,
        touching.areas,
        (touching.nodes, touching.weights),
        solid_section(sizes, like.density, like.poisson).youngs_modulus,
    )


def _solid(spec: RingSpec) -> _Body:
    """A shell of hexahedra that stretches, bends and weighs as the other does."""
    from flexapod.dynamics.lines import Hinges, Lines

    solid = spec.solid
    assert solid is not None
    section = solid_section(spec.sizes, solid.density, solid.poisson)
    made = solid_ring(spec.sizes, section, solid.around, solid.through, solid.across)
    nodes = np.concatenate([made.mesh.nodes, made.centre[None]])
    fixed = np.zeros(nodes.shape, dtype=bool)
    # It stays upright, as the paper's plane model does, and is free to bulge to both sides.
    fixed[:, 1] = np.abs(nodes[:, 1]) < 1e-6 * section.width
    hub = np.array([len(made.mesh.nodes)])
    return _Body(
        nodes,
        fixed,
        np.array([spec.hub_mass]),
        made.mesh,
        Lines.between([], length=1.0, stiffness=0.0),
        Hinges(),
        {
            **{name: (hub, made.anchors[name]) for name in LETTERS},
            "I": (made.anchors["B"], made.anchors["H"]),
        },
        made.mesh.facet_groups["outer"],
        None,
        None,
        section.youngs_modulus,
    )


# --------------------------------------------------------------------------- coils


def _spread(end: np.ndarray, loops: Sequence[np.ndarray], reach: int) -> np.ndarray:
    """An end's own node between those up to `reach` elements before and behind it in its loops."""
    steps = np.arange(1, reach + 1)
    before, behind = [], []
    for loop in loops:
        for place in np.flatnonzero(np.isin(loop, end)):
            before.append(loop[(place - steps) % len(loop)])
            behind.append(loop[(place + steps) % len(loop)])
    return np.concatenate([*before, end, *behind])


def _used_coils(loaded: LoadedCase, body: _Body) -> dict[str, list[str]]:
    """Coils of the robot, by the first of their names, with all of them.

    Where rings of a sphere cross, one coil has a name in both. The one that joins shell nodes is
    there only where a table switches it.
    """
    actuation = loaded.case.actuation
    letters = LETTERS if actuation is None else actuation.letters
    names: dict[tuple[tuple[int, ...], ...], list[str]] = {}
    for name, (one, two) in body.ends.items():
        if name[0] in letters:
            names.setdefault((tuple(one.tolist()), tuple(two.tolist())), []).append(name)
    return {alike[0]: alike for alike in names.values()}


def _commands(loaded: LoadedCase, used: Mapping[str, list[str]]) -> Actuation:
    """When each coil of the robot is on: when one of its names in a ring that is switched is."""
    from flexapod.dynamics.actuation import Actuation

    case = loaded.case
    assert case.dynamics is not None and case.ring is not None
    if case.actuation is None:
        return Actuation(tuple(used), np.zeros(1), np.zeros((1, len(used)), dtype=bool))
    ring = case.actuation.commands(case.dynamics.duration)
    suffixes = [""] if case.ring.shape == "circle" else [str(k) for k in case.actuation.rings]
    column = {f"{letter}{s}": k for k, letter in enumerate(ring.letters) for s in suffixes}
    states = np.zeros((len(ring.times), len(used)), dtype=bool)
    for row, names in enumerate(used.values()):
        for name in names:
            if name in column:
                states[:, row] |= ring.states[:, column[name]]
    return Actuation(tuple(used), ring.times, states)


def _make_coils(loaded: LoadedCase, body: _Body) -> tuple[Lines, Coils]:
    from flexapod.dynamics.lines import Coils, Lines

    spec = loaded.case.coils
    assert spec is not None
    assert loaded.case.ring is not None
    used = _used_coils(loaded, body)
    element = math.pi * loaded.case.ring.diameter / loaded.case.ring.nodes
    reach = int(0.5 * spec.end_width / element + 1e-9)
    loops = body.hinges.rings
    ends = [
        (_spread(one, loops, reach), _spread(two, loops, reach))
        for one, two in (body.ends[name] for name in used)
    ]
    length = [
        np.linalg.norm(body.nodes[two].mean(axis=0) - body.nodes[one].mean(axis=0))
        for one, two in ends
    ]
    lines = Lines.between(
        ends,
        length=spec.rest_length_ratio * np.array(length, dtype=float),
        stiffness=spec.stiffness,
        damping=spec.damping,
        flow_damping=spec.flow_damping,
        limit=spec.limit,
        excess=int(spec.flow == "excess"),
        coil=np.arange(len(ends)),
    )
    every = np.ones(len(ends))
    return lines, Coils(
        spec.rate_on * every,
        spec.rate_off * every,
        spec.largest_force * every,
        _commands(loaded, used),
    )


# --------------------------------------------------------------------------- model


def _make_contacts(loaded: LoadedCase, body: _Body) -> tuple[Any, list[DynamicContact]]:
    """The ground, or None, and the contact with it."""
    from flexapod.dynamics.ground_contact import GroundContact

    first: Any = None
    contacts: list[DynamicContact] = []
    for index, spec in enumerate(loaded.case.contact):
        assert spec.type == "ground"
        ground = make_ground(loaded, spec, f"{loaded.source}: contact.{index}")
        other = np.inf if spec.youngs_modulus is None else spec.youngs_modulus
        law = contact_law(spec, body.modulus, other, spec.poisson)
        contacts.append(
            GroundContact(
                f"ground_{index}",
                body.nodes,
                body.faces,
                ground,
                law,
                skin=spec.skin,
                areas=body.areas,
                curve=body.curve,
            )
        )
        first = first or ground
    return first, contacts


def ring_motion(loaded: LoadedCase) -> Motion:
    """The model of a ring robot and its first state: round, at rest, touching the ground."""
    from flexapod.dynamics.lines import Lines, LineSystem, Points
    from flexapod.dynamics.model import Damping, Model
    from flexapod.dynamics.stable import scale_mass
    from flexapod.dynamics.workspace import Workspace
    from flexapod.fem.body import SolidBody
    from flexapod.fem.loads import Displacement
    from flexapod.materials.law import SolidMaterial
    from flexapod.materials.neo_hooke import NeoHooke

    case = loaded.case
    spec, moving = case.ring, case.dynamics
    assert spec is not None and moving is not None
    body = _solid(spec) if spec.shell == "solid" else _elements(spec)
    coil_lines, coils = _make_coils(loaded, body)
    ground, contacts = _make_contacts(loaded, body)
    slope = ground_slope(loaded)
    x = put_on_ground(turned(body.nodes, slope), ground, slope)
    solid, carried, supports = None, None, []
    meshed = 0
    if body.mesh is not None:
        assert spec.solid is not None
        meshed = len(body.mesh.nodes)
        law = NeoHooke.from_youngs_modulus(body.modulus, spec.solid.poisson)
        material = SolidMaterial(law, spec.solid.density, spec.solid.poisson, "shell")
        solid = SolidBody(body.mesh, {"*": material})
        # The polygon of its elements is a little lighter than the ring.
        share = spec.sizes.shell_mass / solid.node_mass.sum() - 1.0
        carried = share * solid.node_mass
        held = np.flatnonzero(body.fixed[:meshed, 1])
        supports = [Displacement("plane", held, 1)]
    model = Model(
        solid,
        points=Points(x[meshed:], body.point_mass, body.fixed[meshed:]),
        lines=LineSystem(Lines.joined(body.shell, coil_lines), coils, body.hinges),
        carried_mass=carried,
        displacements=supports,
        gravity=case.gravity.tilted() if case.gravity is not None else (0.0, 0.0, 0.0),
        contacts=contacts,
        damping=Damping(moving.mass_damping, moving.stiffness_damping),
    )
    work = Workspace(model)
    u = x[:meshed] - body.nodes[:meshed]
    state = model.start(u)
    if moving.mass_scaling is not None:
        scale_mass(model, state, work, moving.mass_scaling)
    if case.actuation is not None and case.actuation.held > 0.0:
        _hold(model, state, case.actuation.held, slope)
    elements = model.lines.lines if model.lines is not None else body.shell
    parts = RingParts(
        len(body.nodes) - 1,
        coils.actuation.letters,
        np.array([[_middle(one), _middle(two)] for one, two in elements.ends]),
    )
    return Motion(
        body.mesh,
        solid,
        model,
        state,
        work,
        ground,
        float(model.own_mass.sum()),
        Shape(u, {}),
        no_rigid(len(body.nodes)),
        parts,
    )


# Mass damping [1/s] while a robot is held: the ring swings at some ten per second.
HOLD_DAMPING = 20.0
HOLD_INTERVAL = 10e-3  # [s], between looks at the stable step


def _hold(model: Model, state: State, duration: float, slope: float) -> None:
    """Let the coils of the first step pull for `duration` [s], and the shape come to rest.

    The ground's normal part of gravity acts, so that nothing rolls; then time begins anew.
    """
    from flexapod.dynamics.actuation import Actuation
    from flexapod.dynamics.integrator import Options, march
    from flexapod.dynamics.lines import LineSystem
    from flexapod.dynamics.model import Damping
    from flexapod.dynamics.workspace import Workspace

    system = model.lines
    assert system is not None and system.coils is not None
    first = system.coils.actuation
    still = copy.copy(model)
    constant = Actuation(first.letters, np.zeros(1), first.states[:1])
    coils = dataclasses.replace(system.coils, actuation=constant)
    still.lines = LineSystem(system.lines, coils, system.hinges)
    still.damping = Damping(mass=HOLD_DAMPING)
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    still.gravity = (model.gravity @ normal) * normal
    intervals = max(1, math.ceil(duration / HOLD_INTERVAL))
    march(still, state, Workspace(still), intervals, Options(interval=duration / intervals))
    state.begin_anew()


def _middle(nodes: np.ndarray) -> int:
    """The node of an end that is drawn."""
    return int(nodes[len(nodes) // 2])


__all__ = ["RingParts", "ring_motion"]
