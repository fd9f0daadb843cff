"""Rigid bodies of a moving case: what they weigh, what they carry, and their columns."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import group_cells, match_names, surface_faces, surface_modulus
from flexapod.app.case import LoadedCase
from flexapod.app.outputs import OutputSurface
from flexapod.app.spec_rigid import SURFACE_OF, RigidSpec
from flexapod.core.errors import InputError

if TYPE_CHECKING:
    from flexapod.dynamics.model import Model, State
    from flexapod.dynamics.rigid import RigidBodies
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.rigid_shapes import RigidSurface
    from flexapod.geometry.tagged import TaggedMesh


@dataclasses.dataclass(frozen=True)
class RigidParts:
    """The rigid bodies of a case, as the model and the contacts take them.

    Attributes
    ----------
    bodies
        Mass and inertia; of a tied body with the mass of the nodes it carries.
    centres
        Centres of mass [m], shape (body_count, 3).
    tied
        Mesh nodes each body carries, by its name.
    nodes, owner
        Nodes of the surfaces [m], shape (node_count, 3), which come after the mesh's, and the row
        of the body of each, shape (node_count,).
    surfaces
        Faces of the bodies with a shape, by name, in the numbers of all nodes, shape
        (face_count, 4).
    touching
        Those of them that meet others, where it is not all.
    sides
        Faces of a body's sides with names, as "<body>/<side>".
    moduli
        Young's modulus of each [Pa] for contact, infinite if rigid.
    middle
        From the centre of mass to the shape's centre [m], shape (body_count, 3).
    velocity, spin
        At the start [m/s, rad/s], shape (body_count, 3).
    first
        Number of the surfaces' first node among all: how many the mesh has.
    jointed
        Bodies that hang on others by joints.
    """

    bodies: RigidBodies
    centres: np.ndarray
    tied: dict[str, np.ndarray]
    nodes: np.ndarray
    owner: np.ndarray
    surfaces: dict[str, np.ndarray]
    touching: dict[str, np.ndarray]
    sides: dict[str, np.ndarray]
    moduli: dict[str, float]
    middle: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    first: int
    jointed: tuple[str, ...] = ()

    @property
    def loose(self) -> np.ndarray:
        """Which bodies go their own way: no mesh's and no joint's, shape (body_count,)."""
        kept = (*self.tied, *self.jointed)
        return np.array([name not in kept for name in self.bodies.names], dtype=bool)

    def all_nodes(self, mesh: TaggedMesh) -> np.ndarray:
        """Reference positions of the mesh's and the surfaces' nodes [m]."""
        return np.ascontiguousarray(np.concatenate([mesh.nodes, self.nodes]))

    def among(self, nodes: np.ndarray, owner: np.ndarray) -> bool:
        """Whether a loose body owns one of `nodes`; `owner` as in `Model`."""
        rows = owner[nodes]
        return bool(self.loose[rows[rows >= 0]].any())

    def output(
        self, displacement: np.ndarray, point_data: dict[str, np.ndarray]
    ) -> OutputSurface | None:
        """The surfaces with the fields of their nodes, as they are written; None without any."""
        if not self.surfaces:
            return None
        faces = np.concatenate(list(self.surfaces.values())) - self.first
        body = {"body": self.owner[faces[:, 0]].astype(np.int32)}
        return OutputSurface(self.nodes, faces, displacement, point_data, body)

    def held(self) -> RigidBodies:
        """The bodies, the loose ones of them fixed in space."""
        free = self.bodies.free.copy()
        free[self.loose] = False
        return dataclasses.replace(self.bodies, free=free)


# --------------------------------------------------------------------------- making them


@dataclasses.dataclass
class RigidBody:
    """One body on its way into `RigidParts`.

    `surface` is about `middle` from the centre of mass; `touching` are faces in its numbers;
    `tied` are mesh nodes it carries whose mass is in its own already.
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    middle: np.ndarray
    surface: RigidSurface | None = None
    touching: np.ndarray | None = None
    modulus: float | None = None
    velocity: Sequence[float] = (0.0, 0.0, 0.0)
    spin: Sequence[float] = (0.0, 0.0, 0.0)
    hold: Sequence[str] = ()
    jointed: bool = False
    tied: np.ndarray | None = None


def no_rigid(first: int) -> RigidParts:
    """The parts of a robot without rigid bodies, of so many nodes."""
    from flexapod.dynamics.rigid import RigidBodies

    none = np.zeros((0, 3))
    owner = np.zeros(0, dtype=np.int32)
    return RigidParts(
        RigidBodies.empty(), none, {}, none, owner, {}, {}, {}, {}, none, none, none, first
    )


def make_rigid(
    loaded: LoadedCase,
    mesh: TaggedMesh,
    body: SolidBody,
    carried: np.ndarray,
    supports: Any,
    more: Mapping[str, RigidBody] | None = None,
) -> RigidParts:
    """One rigid body per cell group, with the mass its nodes carry, per shape, and `more`."""
    from flexapod.dynamics.rigid import RigidBodies

    nodal = body.node_mass + carried
    made: dict[str, RigidBody] = {}
    tied: dict[str, np.ndarray] = {}
    for index, spec in enumerate(loaded.case.rigid):
        where = f"{loaded.source}: rigid.{spec.name or index}"
        if spec.group is not None:
            for name in match_names([spec.group], mesh.cell_groups, "cell", f"{where}.group"):
                nodes = np.unique(mesh.cells[group_cells(mesh, name, f"{where}.group")])
                # Point masses at the nodes: what the lumped mesh itself has, carried mass
                # included, and so also what surrounding silicone lumps onto the surface.
                _add(made, name, RigidBody(*together(nodal[nodes], mesh.nodes[nodes])), where)
                tied[name] = nodes
            continue
        assert spec.name is not None
        _add(made, spec.name, _shaped(spec, where), where)
        if spec.tied is not None:
            nodes = _tied_nodes(mesh, spec.tied, f"{where}.tied")
            tied[spec.name] = nodes
            _carry(made[spec.name], nodal[nodes], mesh.nodes[nodes])
    for name, one in (more or {}).items():
        _add(made, name, one, loaded.source)
        if one.tied is not None:
            tied[name] = one.tied
    count = len(made)
    free = np.ones((count, 6), dtype=bool)
    for row, (name, one) in enumerate(made.items()):
        for way in one.hold:
            free[row, "xyz".index(way[-1]) + (3 if way.startswith("turn") else 0)] = False
        for part in supports:
            if name in tied and np.intersect1d(part.node_index, tied[name]).size:
                # A node in a plane of symmetry keeps its body from leaving or turning out of it.
                free[row, part.axis] = False
                free[row, [3 + i for i in range(3) if i != part.axis]] = False
    bodies = RigidBodies(
        tuple(made),
        np.array([one.mass for one in made.values()]),
        np.array([one.inertia for one in made.values()]).reshape(count, 3, 3),
        free,
    )
    return _collect(bodies, made, tied, len(mesh.nodes))


def _add(made: dict[str, RigidBody], name: str, one: RigidBody, where: str) -> None:
    if name in made:
        raise InputError(f'there is a rigid body "{name}" already; names must differ', where)
    made[name] = one


def _collect(
    bodies: RigidBodies, made: dict[str, RigidBody], tied: dict[str, np.ndarray], mesh_nodes: int
) -> RigidParts:
    first = mesh_nodes
    nodes, owner = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int32)]
    surfaces, touching, sides, moduli = {}, {}, {}, {}
    for row, (name, one) in enumerate(made.items()):
        if one.surface is None:
            continue
        surfaces[name] = one.surface.faces + first
        if one.touching is not None:
            touching[name] = one.touching + first
        for side, faces in one.surface.sides.items():
            sides[f"{name}/{side}"] = faces + first
        first += len(one.surface.nodes)
        nodes.append(one.surface.nodes + one.centre + one.middle)
        owner.append(np.full(len(one.surface.nodes), row, dtype=np.int32))
        moduli[name] = math.inf if one.modulus is None else one.modulus
    rows = list(made.values())
    return RigidParts(
        bodies,
        np.array([one.centre for one in rows]).reshape(-1, 3),
        tied,
        np.concatenate(nodes),
        np.concatenate(owner),
        surfaces,
        touching,
        sides,
        moduli,
        np.array([one.middle for one in rows]).reshape(-1, 3),
        np.array([one.velocity for one in rows]).reshape(-1, 3),
        np.array([one.spin for one in rows]).reshape(-1, 3),
        mesh_nodes,
        tuple(name for name, one in made.items() if one.jointed),
    )


def _inertia(mass: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Inertia of point masses [kg] at `arm` [m] about the origin, shape (3, 3)."""
    square = (arm * arm).sum(axis=1)
    part = square[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None, :]
    return np.asarray((mass[:, None, None] * part).sum(axis=0))


def together(mass: np.ndarray, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre, inertia and no offset of point masses."""
    centre = (mass[:, None] * x).sum(axis=0) / mass.sum()
    return mass.sum(), centre, _inertia(mass, x - centre), np.zeros(3)


def _carry(one: RigidBody, mass: np.ndarray, x: np.ndarray) -> None:
    """Give a body the point masses of the nodes it carries."""
    total = one.mass + mass.sum()
    centre = (one.mass * one.centre + (mass[:, None] * x).sum(axis=0)) / total
    one.middle = one.centre - centre
    own = _inertia(np.array([one.mass]), one.middle[None])
    one.inertia = one.inertia + own + _inertia(mass, x - centre)
    one.mass, one.centre = float(total), centre


def _shaped(spec: RigidSpec, where: str) -> RigidBody:
    """A body with a shape, turned, at its place: closed forms for what it weighs."""
    from flexapod.dynamics.rigid import box, cylinder, sphere
    from flexapod.geometry.rigid_shapes import (
        RigidSurface,
        box_surface,
        cylinder_surface,
        sphere_surface,
        wedge_corners,
        wedge_surface,
    )

    size = spec.mesh_size
    try:
        if spec.shape == "box":
            assert spec.size is not None
            unit, surface = box(spec.size, 1.0), box_surface(spec.size, size)
        elif spec.shape == "wedge":
            assert spec.size is not None
            upright = 0.5 * math.pi
            front = upright if spec.front_angle is None else spec.front_angle
            back = upright if spec.back_angle is None else spec.back_angle
            volume, centre, inertia = _wedge(wedge_corners(spec.size, front, back))
            unit, surface = (volume, inertia), wedge_surface(spec.size, front, back, size)
            surface = dataclasses.replace(surface, nodes=surface.nodes - centre)
        elif spec.shape == "sphere":
            assert spec.radius is not None
            unit, surface = sphere(spec.radius, 1.0), sphere_surface(spec.radius, size)
        else:
            assert spec.radius is not None and spec.length is not None
            axis = "xyz".index(spec.axis or "y")
            unit = cylinder(spec.radius, spec.length, 1.0, axis)
            surface = cylinder_surface(spec.radius, spec.length, size, axis)
    except InputError as error:
        raise InputError(str(error), where) from None
    density = spec.mass / unit[0] if spec.mass is not None else spec.density
    assert density is not None and spec.position is not None
    turn = _rotation(spec.turn or 0.0, spec.turn_axis or (0.0, 1.0, 0.0))
    inertia = density * turn @ unit[1] @ turn.T
    surface = RigidSurface(surface.nodes @ turn.T, surface.faces, surface.sides)
    return RigidBody(
        density * unit[0],
        np.array(spec.position),
        0.5 * (inertia + inertia.T),
        np.zeros(3),
        surface,
        modulus=spec.youngs_modulus,
        velocity=spec.velocity or (0.0, 0.0, 0.0),
        spin=spec.spin or (0.0, 0.0, 0.0),
        hold=spec.hold or (),
    )


# Layers of a wedge in which its ends count as upright planes: errors of its inertia fall with the
# fourth power, 1e-7 here.
_LAYERS = 16


def _wedge(corners: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume [m3], centre [m] and inertia at unit density [m5] of a hexahedron, in layers."""
    from flexapod.dynamics.rigid import mass_properties

    share = np.linspace(0.0, 1.0, _LAYERS + 1)[:, None, None]
    nodes = ((1.0 - share) * corners[:4] + share * corners[4:]).reshape(-1, 3)
    cells = np.arange(8) + 4 * np.arange(_LAYERS)[:, None]
    return mass_properties(nodes, cells, 1.0)


def _rotation(angle: float, axis: Sequence[float]) -> np.ndarray:
    """Rotation matrix of `angle` [rad] about `axis` (Rodrigues)."""
    x, y, z = np.asarray(axis) / math.hypot(*axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def _tied_nodes(mesh: TaggedMesh, patterns: Sequence[str], where: str) -> np.ndarray:
    """Nodes of surface and cell groups; a name that is both means the surface."""
    nodes = []
    for pattern in patterns:
        if any(_matches(pattern, name) for name in mesh.facet_groups):
            nodes.append(surface_faces(mesh, [pattern], where).ravel())
            continue
        known = [*mesh.facet_groups, *mesh.cell_groups]
        for name in match_names([pattern], known, "surface or cell", where):
            nodes.append(mesh.cells[group_cells(mesh, name, where)].ravel())
    return np.unique(np.concatenate(nodes))


def _matches(pattern: str, name: str) -> bool:
    from fnmatch import fnmatchcase

    return fnmatchcase(name, pattern)


# --------------------------------------------------------------------------- contact


def contact_surface(
    mesh: TaggedMesh, body: SolidBody, rigid: RigidParts, patterns: Sequence[str], where: str
) -> tuple[np.ndarray, float]:
    """Faces of surface groups and of rigid bodies, and the least Young's modulus [Pa] of them.

    A body with a shape is named "rigid:<name>"; its modulus is infinite unless it has one.
    """
    soft = [pattern for pattern in patterns if not pattern.startswith(SURFACE_OF)]
    faces, moduli = [], []
    if soft:
        faces.append(surface_faces(mesh, soft, where))
        moduli.append(surface_modulus(mesh, body, faces[0]))
    for pattern in patterns:
        if not pattern.startswith(SURFACE_OF):
            continue
        known = {**rigid.surfaces, **rigid.touching}
        if "/" in pattern:
            known = rigid.sides
        names = [n for n in known if _matches(pattern, SURFACE_OF + n)]
        if not names:
            there = (*rigid.surfaces, *rigid.sides)
            listed = ", ".join(SURFACE_OF + name for name in there) or "none"
            raise InputError(
                f'no rigid body with a shape is called "{pattern}"; there is: {listed}', where
            )
        faces += [known[name] for name in names]
        moduli += [rigid.moduli[name.partition("/")[0]] for name in names]
    together = np.concatenate(faces)
    _, first = np.unique(np.sort(together, axis=1), axis=0, return_index=True)
    return np.asarray(together[np.sort(first)]), min(moduli)


# --------------------------------------------------------------------------- moving them


def set_in_motion(model: Model, state: State, rigid: RigidParts) -> None:
    """Give the bodies the velocity and spin they start with."""
    from flexapod.dynamics.integrator import place_owned

    if not (rigid.velocity.any() or rigid.spin.any()):
        return
    _, frames = places(model, state, rigid.middle)
    for row, (velocity, spin) in enumerate(zip(rigid.velocity, rigid.spin, strict=True)):
        # The velocity is the shape's, the state's is the centre of mass's.
        arm = frames[row] @ rigid.middle[row]
        state.rigid_v[row] = velocity - np.cross(spin, arm)
        state.rigid_l[row] = frames[row] @ rigid.bodies.inertia[row] @ frames[row].T @ spin
    state.rigid_v[~rigid.bodies.free[:, :3]] = 0.0
    place_owned(model, state)


def places(
    model: Model, state: State, middle: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Position [m] and velocity [m/s] of the bodies' `middle`, and their turns since the start.

    All have the first axis body_count; the turns are rotation matrices.
    """
    from flexapod.dynamics import rigid_kernels

    rigid = model.rigid
    count = len(rigid.names)
    # The middle and a step along each body axis from it.
    local = (middle[:, None, :] + np.concatenate([np.zeros((1, 3)), np.eye(3)])).reshape(-1, 3)
    x, v = np.empty((2, 4 * count, 3))
    rigid_kernels.place(
        np.arange(4 * count),
        np.repeat(np.arange(count, dtype=np.int32), 4),
        np.ascontiguousarray(local),
        rigid.inertia,
        rigid.free,
        state.rigid_x,
        state.rigid_q,
        state.rigid_v,
        state.rigid_l,
        x,
        v,
    )
    x, v = x.reshape(count, 4, 3), v.reshape(count, 4, 3)
    return (x[:, 0], v[:, 0]), np.swapaxes(x[:, 1:] - x[:, :1], 1, 2)


class RigidTracks:
    """Columns of the rigid bodies in curve.csv; turns are counted from row to row.

    ``rigid_<name>_x_mm`` and so on are the centre of the shape (of a group: of its mass), and
    ``_turn_x_deg`` how far it has turned about the axes of space, turn upon turn: right while it
    turns by less than half a turn between two rows.
    """

    def __init__(self, model: Model, rigid: RigidParts) -> None:
        self.model = model
        self.middle = rigid.middle
        self.jointed = rigid.jointed  # their angles say it shorter
        self.turn = np.zeros((len(rigid.bodies.names), 3))  # [deg]
        self.frames: np.ndarray | None = None

    def columns(self, state: State) -> dict[str, float]:
        """The columns at a state; to be asked once per row."""
        row: dict[str, float] = {}
        if not self.model.rigid.names:
            return row
        (x, v), frames = places(self.model, state, self.middle)
        if self.frames is not None:
            for k, (now, before) in enumerate(zip(frames, self.frames, strict=True)):
                self.turn[k] += np.degrees(rotation_vector(now @ before.T))
        self.frames = frames
        for k, name in enumerate(self.model.rigid.names):
            if name in self.jointed:
                continue
            for i, axis in enumerate("xyz"):
                row[f"rigid_{name}_{axis}_mm"] = 1000.0 * float(x[k, i])
            row[f"rigid_{name}_speed_m_s"] = float(np.linalg.norm(v[k]))
            for i, axis in enumerate("xyz"):
                row[f"rigid_{name}_turn_{axis}_deg"] = float(self.turn[k, i])
        return row

    def to_arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        if self.frames is None or not self.turn.size:
            return {}
        return {"rigid_turn": self.turn, "rigid_frames": self.frames}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take back, out of a checkpoint's arrays, what `to_arrays` gave."""
        turn, frames = arrays.pop("rigid_turn", None), arrays.pop("rigid_frames", None)
        if turn is not None and frames is not None:
            self.turn, self.frames = np.array(turn), np.array(frames)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle [rad] of a rotation matrix by less than half a turn."""
    twice = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine = 0.5 * float(np.linalg.norm(twice))
    cosine = 0.5 * (float(np.trace(rotation)) - 1.0)
    # The angle over its sine; 1 where both vanish.
    factor = math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0
    return 0.5 * factor * twice


__all__ = [
    "RigidBody",
    "RigidParts",
    "RigidTracks",
    "contact_surface",
    "make_rigid",
    "no_rigid",
    "places",
    "rotation_vector",
    "set_in_motion",
    "together",
]
