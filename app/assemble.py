"""From the words of a case to the objects the solver takes.

Everything a case names is looked up here, so that a wrong name is refused before anything is
computed, with the names that exist.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import math
import typing
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import numpy as np

from flexapod.core.errors import InputError
from flexapod.core.units import Quantity, write_quantity
from flexapod.geometry.builders import BUILDERS
from flexapod.geometry.tagged import TaggedMesh

if TYPE_CHECKING:
    from flexapod.app.case import LoadedCase
    from flexapod.app.spec import ContactPlaneSpec, MaterialSpec, MeshSpec
    from flexapod.contact.law import ContactLaw
    from flexapod.fem.body import SolidBody
    from flexapod.fem.contacts import Contact
    from flexapod.fem.loads import Displacement
    from flexapod.fem.static import LoadStep, PathOptions, StaticProblem
    from flexapod.materials.law import SolidMaterial

_LENGTH = Quantity("length", "m", "3 mm")
_WORDS = {
    "size": ("coarse", "default", "fine"),
    "symmetry": ("whole", "half", "quarter"),
    "assistant_feed": ("ventilation", "row"),
    "servo_place": ("limit_layer", "turning_rows"),
}


# --------------------------------------------------------------------------- builders


def make_builder(spec: MeshSpec, where: str) -> Any:
    """Return the builder a case names with its options; every float of a builder is a length."""
    assert spec.builder is not None
    if spec.builder not in BUILDERS:
        raise InputError(
            f'must be one of {", ".join(BUILDERS)}; got "{spec.builder}"', f"{where}: mesh.builder"
        )
    cls = BUILDERS[spec.builder]
    options = _read_options(cls, None, spec.options, f"{where}: mesh", ("builder", "file"))
    try:
        return cls(**options)
    except InputError as error:
        raise InputError(str(error), where) from None


def _read_options(
    cls: Any, default: Any, table: Mapping[str, Any], where: str, beside: Sequence[str] = ()
) -> dict[str, Any]:
    """Options of a dataclass from a table of a case file."""
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls)}
    options: dict[str, Any] = {}
    for key, value in table.items():
        if key not in fields:
            allowed = [*beside, *fields]
            near = difflib.get_close_matches(key, allowed, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise InputError(
                f"unknown key{hint}; allowed here: {', '.join(allowed)}", f"{where}.{key}"
            )
        inner = default if default is None else getattr(default, key)
        if inner is None and fields[key].default is not dataclasses.MISSING:
            inner = fields[key].default
        options[key] = _read_option(hints[key], inner, value, f"{where}.{key}")
    return options


def _read_option(hint: Any, default: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, Mapping):
            raise InputError(f"must be a table of lengths; got {value!r}", where)
        return _replaced(default, _read_options(hint, default, value, where), where)
    kinds = set(typing.get_args(hint)) or {hint}
    if bool in kinds and isinstance(value, bool):
        return value
    if int in kinds and isinstance(value, int) and not isinstance(value, bool):
        return value
    if str in kinds and isinstance(value, str):
        words = _WORDS.get(where.rpartition(".")[2], ())
        if value in words or float not in kinds:
            if words and value not in words:
                raise InputError(f'must be one of {", ".join(words)}; got "{value}"', where)
            return value
    lists = [kind for kind in kinds | {hint} if typing.get_origin(kind) is tuple]
    try:
        if lists and isinstance(value, list | tuple):
            return tuple(_LENGTH.read(item) for item in value)
        if float in kinds and not isinstance(value, bool | list):
            return _LENGTH.read(value)
    except InputError as error:
        words = _WORDS.get(where.rpartition(".")[2], ()) if str in kinds else ()
        choice = f"write {', '.join(words)} or " if words else ""
        raise InputError(f"{choice}{error}", where) from None
    names = {bool: "true or false", int: "a whole number", str: "a word"}
    wanted = [text for kind, text in names.items() if kind in kinds]
    wanted += ["a list of lengths with units"] if lists else []
    raise InputError(f"must be {' or '.join(wanted)}; got {value!r}", where)


def _replaced(default: Any, changes: dict[str, Any], where: str) -> Any:
    try:
        return dataclasses.replace(default, **changes)
    except InputError as error:
        raise InputError(str(error), where) from None


def check_builder(spec: MeshSpec, where: str) -> None:
    """Refuse a builder's unknown or impossible options as soon as the case is read."""
    if spec.builder is not None:
        make_builder(spec, where)


def builder_options(spec: MeshSpec, where: str) -> dict[str, Any]:
    """Every option of a builder, defaults filled in, as a case file writes them."""
    return _written(make_builder(spec, where))


def _written(record: Any) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            table[field.name] = _written(value)
        elif isinstance(value, float):
            table[field.name] = write_quantity(value, "m")
        elif isinstance(value, tuple):
            table[field.name] = [write_quantity(item, "m") for item in value]
        elif value is not None:
            table[field.name] = value
    return table


def builder_schemas() -> dict[str, dict[str, Any]]:
    """JSON schema of every builder's options."""
    return {name: _schema_of(cls) for name, cls in BUILDERS.items()}


def _schema_of(cls: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    length = _LENGTH.__get_pydantic_json_schema__(None, None)
    properties: dict[str, Any] = {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        kinds = set(typing.get_args(hint)) or {hint}
        if dataclasses.is_dataclass(hint):
            properties[field.name] = {
                "type": "object",
                "properties": _schema_of(hint),
                "additionalProperties": False,
            }
        elif any(typing.get_origin(kind) is tuple for kind in kinds | {hint}):
            properties[field.name] = {"type": "array", "items": length}
        elif bool in kinds:
            properties[field.name] = {"type": "boolean"}
        elif int in kinds:
            properties[field.name] = {"type": "integer"}
        elif str in kinds:
            word = {"enum": list(_WORDS[field.name])} if field.name in _WORDS else {}
            text = {"type": "string", **word}
            properties[field.name] = {"anyOf": [text, length]} if float in kinds else text
        else:
            properties[field.name] = length
        if field.default not in (dataclasses.MISSING, None) and not dataclasses.is_dataclass(hint):
            default = field.default
            properties[field.name] = {
                **properties[field.name],
                "default": write_quantity(default, "m") if isinstance(default, float) else default,
            }
    return properties


# --------------------------------------------------------------------------- mesh


def build_mesh(loaded: LoadedCase) -> TaggedMesh:
    """Build or read the mesh of a case."""
    spec = loaded.case.sized_mesh
    if spec is None:
        raise InputError("a ring has no mesh of its own to build", loaded.source)
    if spec.builder is not None:
        try:
            mesh: TaggedMesh = make_builder(spec, loaded.source).build()
        except InputError as error:
            raise InputError(str(error), loaded.source) from None
        return mesh
    from flexapod.geometry.meshfile import read_mesh

    assert spec.file is not None
    path = loaded.path(spec.file)
    if not path.is_file():
        raise InputError(f"no such file: {path}", f"{loaded.source}: mesh.file")
    mesh = read_mesh(path, 1.0 if spec.scale is None else spec.scale)
    if spec.cavities is not None:
        names = match_names(
            spec.cavities, mesh.facet_groups, "surface", f"{loaded.source}: mesh.cavities"
        )
        mesh = dataclasses.replace(mesh, cavities=tuple(names))
    return mesh


def mesh_hash(mesh: TaggedMesh) -> str:
    """Digest of nodes, cells and groups."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(mesh.nodes, dtype=float).tobytes())
    digest.update(np.ascontiguousarray(mesh.cells, dtype=np.int64).tobytes())
    for groups in (mesh.cell_groups, mesh.facet_groups):
        for name in sorted(groups):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(groups[name], dtype=np.int64).tobytes())
    return digest.hexdigest()[:16]


def match_names(patterns: Iterable[str], known: Iterable[str], what: str, where: str) -> list[str]:
    """Names that globs select, each once; a glob that selects nothing is refused."""
    known = list(known)
    found: dict[str, None] = {}
    for pattern in patterns:
        hits = [name for name in known if fnmatchcase(name, pattern)]
        if not hits:
            near = difflib.get_close_matches(pattern, known, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            listed = ", ".join(sorted(known)) or "none"
            raise InputError(f'no {what} group "{pattern}"{hint}; the mesh has: {listed}', where)
        found.update(dict.fromkeys(hits))
    return list(found)


def surface_faces(mesh: TaggedMesh, patterns: Iterable[str], where: str) -> np.ndarray:
    """Faces of the surface groups that globs select, each once, shape (face_count, 4)."""
    names = match_names(patterns, mesh.facet_groups, "surface", where)
    faces = np.concatenate([mesh.facet_groups[name] for name in names])
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.asarray(faces[np.sort(first)])


def group_cells(mesh: TaggedMesh, pattern: str, where: str) -> np.ndarray:
    """Cells of the cell groups a glob selects; "*" is the whole body."""
    if pattern == "*":
        return np.arange(len(mesh.cells))
    names = match_names([pattern], mesh.cell_groups, "cell", where)
    return np.unique(np.concatenate([mesh.cell_groups[name] for name in names]))


def modelled_fraction(spec: MeshSpec | None) -> float:
    """Part of the whole body the mesh holds; 1 for a mesh file, or without a mesh."""
    if spec is None:
        return 1.0
    return {"half": 0.5, "quarter": 0.25}.get(_symmetry(spec), 1.0)


def _symmetry(spec: MeshSpec) -> str:
    return str(make_builder(spec, "mesh").symmetry) if spec.builder is not None else "whole"


# --------------------------------------------------------------------------- problem


@dataclasses.dataclass(frozen=True)
class Assembly:
    """What a run needs: the problem, its steps and how the path walks."""

    mesh: TaggedMesh
    body: SolidBody
    problem: StaticProblem
    steps: list[LoadStep]
    options: PathOptions
    node_mass: np.ndarray  # solid and carried mass [kg], shape (node_count,)


def assemble(loaded: LoadedCase, mesh: TaggedMesh) -> Assembly:
    """Look up everything a case names in its mesh and make the static problem."""
    from flexapod.fem import loads as fem_loads
    from flexapod.fem.body import SolidBody
    from flexapod.fem.static import StaticProblem

    case, source = loaded.case, loaded.source
    body = SolidBody(mesh, make_materials(loaded, mesh))
    node_mass = body.node_mass + carried_mass(loaded, mesh, body)
    loads: list[Any] = []
    if case.gravity is not None:
        loads.append(fem_loads.gravity("gravity", node_mass, case.gravity.tilted()))
    for force in case.force:
        faces = surface_faces(mesh, force.surface, f"{source}: force.{force.name}.surface")
        loads.append(fem_loads.surface_force(force.name, mesh.nodes, faces, force.total))
    for traction in case.traction:
        faces = surface_faces(mesh, traction.surface, f"{source}: traction.{traction.name}.surface")
        loads.append(fem_loads.traction(traction.name, mesh.nodes, faces, traction.value))
    for pressure in case.pressure:
        faces = surface_faces(mesh, pressure.surface, f"{source}: pressure.{pressure.name}.surface")
        faces = np.ascontiguousarray(faces, dtype=np.int64)
        loads.append(fem_loads.CavityPressure(pressure.name, faces, pressure.value))
    displacements, contacts = _displacements(loaded, mesh), _contacts(loaded, mesh, body, node_mass)
    try:
        problem = StaticProblem(body, displacements, loads, contacts)
    except InputError as error:
        raise InputError(str(error), source) from None
    return Assembly(mesh, body, problem, _steps(loaded), _options(loaded), node_mass)


def make_materials(loaded: LoadedCase, mesh: TaggedMesh) -> dict[str, SolidMaterial]:
    """Material of every cell group a case names."""
    materials: dict[str, SolidMaterial] = {}
    for index, spec in enumerate(loaded.case.material):
        where = f"{loaded.source}: material.{index}"
        material = make_material(loaded, spec, where)
        names = (
            ["*"]
            if spec.group == "*"
            else match_names([spec.group], mesh.cell_groups, "cell", f"{where}.group")
        )
        for name in names:
            if name in materials:
                raise InputError(f'the cell group "{name}" already has a material', where)
            materials[name] = material
    return materials


def make_material(loaded: LoadedCase, spec: MaterialSpec, where: str) -> SolidMaterial:
    """Return the material a table of a case describes."""
    material = _elastic(loaded, spec, where)
    if not spec.prony_moduli:
        return material
    from flexapod.materials.prony import Prony

    return dataclasses.replace(material, prony=Prony(spec.prony_moduli, spec.prony_times))


def _elastic(loaded: LoadedCase, spec: MaterialSpec, where: str) -> SolidMaterial:
    from flexapod.materials.law import SolidMaterial
    from flexapod.materials.library import DEFAULT_POISSON, load_material
    from flexapod.materials.neo_hooke import NeoHooke
    from flexapod.materials.registry import make_law

    if spec.use is not None:
        name = str(loaded.path(spec.use)) if spec.use.endswith(".toml") else spec.use
        try:
            return load_material(name, density=spec.density, poisson=spec.poisson)
        except InputError as error:
            raise InputError(str(error), where) from None
    assert spec.model is not None and spec.density is not None
    poisson = DEFAULT_POISSON if spec.poisson is None else spec.poisson
    if spec.model == "linear":
        assert spec.youngs_modulus is not None
        law: Any = NeoHooke.from_youngs_modulus(spec.youngs_modulus, poisson)
    else:
        law = make_law(spec.model, spec.coefficients, where)
    return SolidMaterial(law, spec.density, poisson, spec.model)


def carried_mass(loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody) -> np.ndarray:
    """Mass a case puts on the body [kg], shape (node_count,)."""
    density = np.zeros(len(mesh.cells))
    for index, spec in enumerate(loaded.case.mass):
        cells = group_cells(mesh, spec.group, f"{loaded.source}: mass.{index}.group")
        share = modelled_fraction(loaded.case.mesh) if spec.of == "body" else 1.0
        density[cells] += share * spec.total / body.cell_volume[cells].sum()
    return body.lump(density)


def make_supports(loaded: LoadedCase, mesh: TaggedMesh) -> list[Displacement]:
    """Displacements held at zero."""
    from flexapod.fem.loads import Displacement

    conditions = []
    for index, support in enumerate(loaded.case.support):
        where = f"{loaded.source}: support.{index}.surface"
        nodes = np.unique(surface_faces(mesh, support.surface, where))
        name = f"support of {', '.join(support.surface)}"
        for direction in support.directions:
            conditions.append(Displacement(name, nodes, "xyz".index(direction)))
    return conditions


def _displacements(loaded: LoadedCase, mesh: TaggedMesh) -> list[Displacement]:
    from flexapod.fem.loads import Displacement

    conditions = make_supports(loaded, mesh)
    for moved in loaded.case.displacement:
        where = f"{loaded.source}: displacement.{moved.name}.surface"
        nodes = np.unique(surface_faces(mesh, moved.surface, where))
        for axis, value in enumerate((moved.x, moved.y, moved.z)):
            if value is not None:
                conditions.append(Displacement(moved.name, nodes, axis, value))
    return conditions


def face_owners(mesh: TaggedMesh, faces: np.ndarray) -> np.ndarray:
    """Cell each boundary face belongs to, shape (face_count,)."""
    from flexapod.geometry.tagged import HEX_FACES

    every = np.sort(mesh.cells[:, HEX_FACES].reshape(-1, 4), axis=1)
    both = np.concatenate([every, np.sort(faces, axis=1)])
    _, label = np.unique(both, axis=0, return_inverse=True)
    label = label.ravel()
    owner = np.full(int(label.max()) + 1, -1)
    owner[label[: len(every)]] = np.repeat(np.arange(len(mesh.cells)), 6)
    return np.asarray(owner[label[len(every) :]])


def surface_modulus(mesh: TaggedMesh, body: SolidBody, faces: np.ndarray) -> float:
    """Young's modulus of the softest material on a surface [Pa].

    ``E = 3 G``: the paper's law takes silicone as incompressible, and the bulk modulus of the
    model is a numerical choice that contact must not feel.
    """
    owner = face_owners(mesh, faces)
    used = np.unique(body.material[owner[owner >= 0]])
    return min(3.0 * body.materials[i].law.shear_modulus for i in used)


INCOMPRESSIBLE = 0.5


def _contacts(
    loaded: LoadedCase, mesh: TaggedMesh, body: SolidBody, node_mass: np.ndarray
) -> list[Contact]:
    from flexapod.fem.contacts import FaceContact, PlaneContact, SlidingWeight

    contacts: list[Contact] = []
    for index, spec in enumerate(loaded.case.contact):
        where = f"{loaded.source}: contact.{index}"
        name = f"{spec.type}_{index}"
        if spec.type == "weight":
            weight = spec.acceleration * node_mass
            contacts.append(
                SlidingWeight(name, mesh.nodes, weight, spec.normal, spec.friction, spec.slip)
            )
            continue
        assert spec.type != "ground"  # belongs to motions; the case was checked
        faces = surface_faces(mesh, spec.surface, f"{where}.surface")
        modulus = surface_modulus(mesh, body, faces)
        if spec.type == "plane":
            law = _plane_law(spec, modulus)
            contacts.append(PlaneContact(name, mesh.nodes, faces, spec.point, spec.normal, law))
            continue
        partner, other = faces, modulus
        if spec.type == "pair":
            partner = surface_faces(mesh, spec.against, f"{where}.with")
            other = surface_modulus(mesh, body, partner)
        law = contact_law(spec, modulus, other)
        contacts.append(FaceContact(name, mesh.nodes, faces, partner, law, depth=spec.depth))
    return contacts


def contact_law(
    spec: Any,
    modulus: float,
    other: float,
    other_poisson: float = INCOMPRESSIBLE,
    friction: float = 0.0,
) -> ContactLaw:
    """Law of a surface against another, from Young's moduli of both [Pa].

    Damping and the stiffness of sticking are those of a motion where `spec` has them.
    """
    from flexapod.app.spec_contact import MovingContact
    from flexapod.contact.law import ContactLaw, hertz_stiffness

    moving = {}
    if isinstance(spec, MovingContact):
        moving = {
            "stick_stiffness": spec.stick_stiffness,
            "damping_ratio": spec.damping,
            "damping_exponent": spec.damping_exponent,
            "indentation_exponent": spec.indentation_exponent,
        }
    stiffness = spec.stiffness
    if stiffness is None:
        stiffness = hertz_stiffness(
            modulus, INCOMPRESSIBLE, other, other_poisson, spec.radius, spec.radius
        )
    return ContactLaw(
        stiffness,
        stiffness_exponent=spec.exponent,
        reference_area=spec.reference_area,
        friction=friction,
        **moving,
    )


def _plane_law(spec: ContactPlaneSpec, modulus: float) -> ContactLaw:
    if not spec.mirror:
        other = math.inf if spec.youngs_modulus is None else spec.youngs_modulus
        return contact_law(spec, modulus, other, spec.poisson, spec.friction)
    law = contact_law(spec, modulus, modulus)
    # The image comes as far as the body: penetration counts twice, F = k (2 d)**m.
    return dataclasses.replace(law, stiffness=law.stiffness * 2.0**spec.exponent)


def _steps(loaded: LoadedCase) -> list[LoadStep]:
    from flexapod.fem.static import LoadStep

    steps = []
    for spec in loaded.case.steps:
        limits = {
            key: value
            for key in ("first", "smallest", "largest")
            if (value := getattr(spec, key)) is not None
        }
        try:
            steps.append(LoadStep(spec.name, dict(spec.loads), spec.outputs, **limits))
        except InputError as error:
            raise InputError(str(error), loaded.source) from None
    return steps


def _options(loaded: LoadedCase) -> PathOptions:
    from flexapod.fem.newton import NewtonOptions
    from flexapod.fem.static import PathOptions

    spec = loaded.case.solver
    newton = {"residual_tolerance": spec.tolerance, "max_iterations": spec.iterations}
    path = {"max_increments": spec.increments, "damped": spec.damped}
    return PathOptions(
        newton=NewtonOptions(**{k: v for k, v in newton.items() if v is not None}),  # type: ignore[arg-type]
        **{k: v for k, v in path.items() if v is not None},  # type: ignore[arg-type]
    )
