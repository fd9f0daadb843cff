"""Parts of a moving case's model: contacts, ground, chambers and bonds."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.app.assemble import contact_law, surface_faces
from flexapod.app.case import LoadedCase
from flexapod.app.motion_rigid import RigidParts, contact_surface
from flexapod.core.errors import InputError

if TYPE_CHECKING:
    from flexapod.app.spec_contact import MovingContact
    from flexapod.contact.law import FrictionLaw
    from flexapod.dynamics.commands import Chamber
    from flexapod.dynamics.contacts import DynamicContact
    from flexapod.dynamics.model import Bond
    from flexapod.fem.body import SolidBody
    from flexapod.geometry.tagged import TaggedMesh

# Of contact where both partners are rigid [Pa], which has to give somewhere: a block of 0.1 m of
# water's density sinks in by 3 um.
RIGID_MODULUS = 1e6


def make_contacts(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody, rigid: RigidParts
) -> tuple[Any, list[DynamicContact]]:
    from flexapod.dynamics.ground_contact import GroundContact
    from flexapod.dynamics.surface_contact import SKIN, SurfaceContact

    first: Any = None
    contacts: list[DynamicContact] = []
    nodes = rigid.all_nodes(mesh)
    for index, spec in enumerate(loaded.case.contact):
        if spec.type != "ground" and loaded.case.rigid_bodied:
            continue  # a box has no chambers to touch each other
        where = f"{loaded.source}: contact.{index}"
        name = f"{spec.type}_{index}"
        patterns: tuple[str, ...] = spec.surface  # type: ignore[union-attr]
        faces, modulus = contact_surface(mesh, body, rigid, patterns, f"{where}.surface")
        if spec.type == "ground":
            ground = make_ground(loaded, spec, where)
            other = math.inf if spec.youngs_modulus is None else spec.youngs_modulus
            if math.isinf(modulus) and math.isinf(other):
                modulus = RIGID_MODULUS
            law = contact_law(spec, modulus, other, spec.poisson)
            contacts.append(GroundContact(name, nodes, faces, ground, law, skin=spec.skin))
            first = first or ground
            continue
        partner, other = faces, modulus
        if spec.type == "pair":
            partner, other = contact_surface(mesh, body, rigid, spec.against, f"{where}.with")
        elif faces.max() >= len(mesh.nodes):
            raise InputError('rigid bodies meet others by type = "pair"', f"{where}.surface")
        if math.isinf(modulus) and math.isinf(other):
            modulus = RIGID_MODULUS
        law = contact_law(spec, modulus, other)
        contacts.append(
            SurfaceContact(
                name,
                nodes,
                faces,
                partner,
                law,
                depth=spec.depth,  # type: ignore[union-attr]
                skin=spec.skin or SKIN,  # type: ignore[union-attr]
                friction=make_friction(spec),  # type: ignore[arg-type]
            )
        )
    return first, contacts


def make_friction(spec: MovingContact) -> FrictionLaw:
    """Friction of a contact's table."""
    from flexapod.contact.law import FrictionLaw

    dynamic = spec.friction if spec.friction_dynamic is None else spec.friction_dynamic
    return FrictionLaw(spec.friction, dynamic, spec.static_speed, spec.dynamic_speed)


def make_ground(loaded: LoadedCase, spec: Any, where: str) -> Any:
    """The ground a contact table describes."""
    from flexapod.contact.ground import HeightField, Step, slope

    friction = make_friction(spec)
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
    start = loaded.case.start
    begun = 0.0 if start is None or start.case is None else 1.0
    for spec in loaded.case.pressure:
        where = f"{loaded.source}: pressure.{spec.name}.surface"
        faces = np.ascontiguousarray(surface_faces(mesh, spec.surface, where), dtype=np.int64)
        if spec.between is not None:
            x = mesh.nodes[faces, 0].mean(axis=1)
            faces = faces[(x > min(spec.between)) & (x < max(spec.between))]
            if not len(faces):
                raise InputError(
                    "no face lies there; the surface's lie between "
                    f"{1e3 * x.min():.4g} and {1e3 * x.max():.4g} mm",
                    f"{loaded.source}: pressure.{spec.name}.between",
                )
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
