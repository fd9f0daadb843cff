"""Parts of a moving case's model: rigid bodies, contacts, ground, chambers and bonds."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import (
    contact_law,
    group_cells,
    match_names,
    surface_faces,
    surface_modulus,
)
from flexapod.app.case import LoadedCase
from flexapod.core.errors import InputError

if TYPE_CHECKING:
    from flexapod.dynamics.commands import Chamber
    from flexapod.dynamics.contacts import DynamicContact
    from flexapod.dynamics.model import Bond
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.tagged import TaggedMesh

# Of sticking on the ground [Pa/m]. Statics takes a hundredth, for the sake of Newton's method. In
# motion that is too soft: each point of a rolling body has to be sheared anew, and the body creeps
# (a rigid cylinder by 2 %, tests/verification/test_dynamics_contact.py).
STICK_STIFFNESS = 1e9


@dataclasses.dataclass
class RigidParts:
    bodies: Any
    centres: np.ndarray
    tied: dict[str, np.ndarray]


def make_rigid(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody, carried: np.ndarray, supports: Any
) -> RigidParts:
    """One rigid body per cell group, with the mass its nodes carry."""
    from flexapod.dynamics.rigid import RigidBodies

    tied: dict[str, np.ndarray] = {}
    for index, spec in enumerate(loaded.case.rigid):
        where = f"{loaded.source}: rigid.{index}.group"
        for name in match_names([spec.group], mesh.cell_groups, "cell", where):
            tied[name] = np.unique(mesh.cells[group_cells(mesh, name, where)])
    if not tied:
        return RigidParts(RigidBodies.empty(), np.zeros((0, 3)), {})
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
    return RigidParts(bodies, np.array(centre), tied)


def make_contacts(
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


def make_chambers(loaded: LoadedCase, mesh: TaggedMesh, part: float) -> list[Chamber]:
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


def make_bonds(
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
