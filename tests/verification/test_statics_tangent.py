"""Tangents against central differences, energies against forces, and the work of pressure.

Central differences along random directions: K d = (R(u + h d) - R(u - h d)) / 2h + O(h**2). The
best h balances h**2 against round-off/h and leaves about 1e-9 for smooth parts; the tolerance
1e-6 is the brief's, the measured error stands beside each.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from statics_helpers import distorted, grid, merged, solid, sphere_octant

from flexapod.contact.law import ContactLaw
from flexapod.fem.contacts import Contact, FaceContact, PlaneContact
from flexapod.fem.loads import Cavity, CavityPressure, Load
from flexapod.fem.static import StaticProblem
from flexapod.geometry.tagged import TaggedMesh, boundary_facets
from flexapod.materials.library import load_material
from flexapod.materials.neo_hooke import NeoHooke

LAW = load_material("dragon-skin-20-sospider").law


def wavy(x: np.ndarray, size: float, seed: int = 0) -> np.ndarray:
    """A smooth random displacement plus a little noise."""
    r = np.random.default_rng(seed)
    g = r.uniform(-0.5, 0.5, (3, 3))
    return np.asarray(size * (x @ g + 0.3 * np.sin(x @ g.T) + 0.05 * r.standard_normal(x.shape)))


def difference_error(
    problem: StaticProblem, u: np.ndarray, factors: dict[str, float], h: float, seeds: int = 3
) -> float:
    """Largest relative error of K d over random directions d."""
    worst = 0.0
    pattern = problem.tangent(u, factors)
    for seed in range(seeds):
        d = np.random.default_rng(seed).standard_normal(u.shape)
        plus, _ = problem.residual(u + h * d, factors)
        minus, _ = problem.residual(u - h * d, factors)
        expected = (plus - minus) / (2.0 * h)
        got = pattern.product(d)
        worst = max(worst, float(np.linalg.norm(got - expected) / np.linalg.norm(expected)))
    print(f"tangent against differences: {worst:.2e}")
    return worst


def hollow_cube(half: bool = False) -> TaggedMesh:
    """A cube of 4x4x4 cells without its 2x2x2 middle: a closed cavity; or its half x < 0.5."""
    mesh = grid((4, 4, 4))
    centre = mesh.nodes[mesh.cells].mean(axis=1)
    inside = (np.abs(centre - 0.5) < 0.25).all(axis=1)
    inside |= half & (centre[:, 0] > 0.5)
    used = np.unique(mesh.cells[~inside])
    number = np.full(len(mesh.nodes), -1)
    number[used] = np.arange(len(used))
    out = TaggedMesh(mesh.nodes[used], number[mesh.cells[~inside]])
    quads = boundary_facets(out.cells)
    middle = out.nodes[quads].mean(axis=1)
    wall = (np.abs(middle - 0.5) < 0.26).all(axis=1) & ~(half & (middle[:, 0] > 0.49))
    return out.with_facet_group("cavity", quads[wall])


@pytest.mark.parametrize("poisson", [0.3, 0.499, 0.4999])
def test_body(poisson: float) -> None:
    mesh = distorted((3, 3, 2))
    problem = StaticProblem(solid(mesh, LAW, poisson), [], [])
    # Measured 4e-11 to 1e-10 (round-off of kappa over h).
    assert difference_error(problem, wavy(mesh.nodes, 0.3), {}, 1e-6) < 1e-7


def test_body_energy_gives_its_force() -> None:
    mesh = distorted((3, 3, 2))
    body = solid(mesh, LAW)
    u = wavy(mesh.nodes, 0.3)
    d = np.random.default_rng(1).standard_normal(u.shape)
    force, scratch = np.empty_like(u), np.empty_like(u)
    body.internal_force(u, force)
    h = 1e-5
    slope = (body.internal_force(u + h * d, scratch) - body.internal_force(u - h * d, scratch)) / (
        2.0 * h
    )
    # Measured 1e-9.
    assert slope == pytest.approx(float((force * d).sum()), rel=1e-7)


def test_follower_pressure_of_a_closed_cavity() -> None:
    mesh = hollow_cube()
    cavity = Cavity("c", mesh.facet_groups["cavity"])
    assert cavity.closed
    assert cavity.volume(mesh.nodes) == pytest.approx(0.125, rel=1e-14)
    load = CavityPressure("p", mesh.facet_groups["cavity"], 2e4)
    u = wavy(mesh.nodes, 0.3)
    x = mesh.nodes + u
    _check_work(load, cavity.volume, x, np.ones_like(x))
    # The whole tangent, body and load.
    problem = StaticProblem(solid(mesh, LAW), [], [load])
    assert difference_error(problem, u, {"p": 1.0}, 1e-6) < 1e-7
    # And the load alone, where the body cannot hide it: the symmetric part is all there is.
    assert _load_error(load, x, np.ones_like(x)) < 1e-8


def test_follower_pressure_of_a_cavity_cut_by_one_plane() -> None:
    # Nodes on a plane of symmetry move within it: only then does the dropped skew part cancel.
    mesh = hollow_cube(half=True)
    cavity = Cavity("c", mesh.facet_groups["cavity"])
    assert not cavity.closed
    assert cavity.volume(mesh.nodes) == pytest.approx(0.0625, rel=1e-14)
    load = CavityPressure("p", mesh.facet_groups["cavity"], 2e4)
    free = np.ones_like(mesh.nodes)
    free[np.abs(mesh.nodes[:, 0] - 0.5) < 1e-9, 0] = 0.0
    x = mesh.nodes + wavy(mesh.nodes, 0.3) * free
    _check_work(load, cavity.volume, x, free)
    assert _load_error(load, x, free) < 1e-10


def octant() -> tuple[TaggedMesh, np.ndarray]:
    """An eighth of a hollow ball, and 0 where a node may not leave its plane of symmetry."""
    mesh = sphere_octant(1.0, 1.6, 3, 2)
    free = np.ones_like(mesh.nodes)
    for axis, name in enumerate(("sx", "sy", "sz")):
        free[mesh.facet_nodes(name), axis] = 0.0
    return mesh, free


def test_follower_pressure_of_a_cavity_cut_by_three_planes() -> None:
    # Volume by the divergence theorem; planes through the origin add nothing to it.
    mesh, free = octant()
    load = CavityPressure("p", mesh.facet_groups["cavity"], 2e4)
    x = mesh.nodes + wavy(mesh.nodes, 0.3) * free
    _check_work(load, lambda y: mesh.with_nodes(y).cavity_volume("cavity"), x, free)
    assert _load_error(load, x, free) < 1e-10


def test_volume_of_a_cavity_cut_by_three_planes() -> None:
    mesh, _ = octant()
    volume = Cavity("c", mesh.facet_groups["cavity"]).volume(mesh.nodes)
    assert volume == pytest.approx(mesh.cavity_volume("cavity"), rel=1e-12)


def _check_work(
    load: CavityPressure, volume: Callable[[np.ndarray], float], x: np.ndarray, free: np.ndarray
) -> None:
    """R . d = d(-p V)/dh along random directions: the volume is cubic, differences are exact."""
    force = np.zeros_like(x)
    load.add_residual(x, 1.0, force)
    for seed in range(3):
        d = np.random.default_rng(seed).standard_normal(x.shape) * free
        h = 1e-4
        slope = (volume(x + h * d) - volume(x - h * d)) / (2.0 * h)
        # Differences of a cubic leave h**2 V''' = 1e-8: measured 5e-9 at most.
        assert float((force * d).sum()) == pytest.approx(-load.pressure * slope, rel=1e-6)


def _load_error(load: Load, x: np.ndarray, free: np.ndarray) -> float:
    item = load.stiffness(x, 1.0)
    assert item is not None
    nodes, matrices = item
    np.testing.assert_array_equal(matrices, matrices.transpose(0, 2, 1))
    worst = 0.0
    for seed in range(3):
        d = np.random.default_rng(seed).standard_normal(x.shape) * free
        h = 1e-4
        ends = []
        for sign in (1.0, -1.0):
            force = np.zeros_like(x)
            load.add_residual(x + sign * h * d, 1.0, force)
            ends.append(force)
        # The force is quadratic in x: central differences are exact to round-off.
        expected = free * (ends[0] - ends[1]) / (2.0 * h)
        got = np.zeros_like(x)
        local = np.einsum("fij,fj->fi", matrices, d[nodes].reshape(len(nodes), -1))
        np.add.at(got, nodes.ravel(), local.reshape(-1, 3))
        worst = max(worst, float(np.abs(free * got - expected).max() / np.abs(expected).max()))
    print(f"load stiffness against differences: {worst:.2e}")
    return worst


def test_open_surface_has_no_potential() -> None:
    # The counter-check: on one free square the skew part does not cancel, so the tests above
    # can fail.
    mesh = grid((2, 2, 1))
    load = CavityPressure("p", mesh.facet_groups["z1"], 2e4)
    assert _load_error(load, mesh.nodes, np.ones_like(mesh.nodes)) > 0.1


def _contact_energy_slope(contact: Contact, x: np.ndarray, d: np.ndarray, h: float) -> float:
    scratch = np.zeros_like(x)
    ends = [contact.add_residual(x + s * h * d, scratch) for s in (1.0, -1.0)]
    return (ends[0] - ends[1]) / (2.0 * h)


def plane_state(friction: float, exponent: float) -> tuple[StaticProblem, PlaneContact, np.ndarray]:
    mesh = distorted((3, 3, 2))
    law = ContactLaw(1e3, exponent, friction=friction, stick_stiffness=1e7)
    normal = (0.1, -0.2, 1.0)
    contact = PlaneContact("ground", mesh.nodes, mesh.facet_groups["z0"], (0, 0, 0.02), normal, law)
    problem = StaticProblem(solid(mesh, LAW), [], [], [contact])
    return problem, contact, wavy(mesh.nodes, 0.05)


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_plane_contact_without_friction(exponent: float) -> None:
    problem, contact, u = plane_state(0.0, exponent)
    x = problem.positions(u)
    report = contact.report(x)
    assert 0.2 < report.area < 1.0  # some points touch, some do not
    assert difference_error(problem, u, {}, 1e-7) < 1e-6
    force = np.zeros_like(x)
    contact.add_residual(x, force)
    d = np.random.default_rng(5).standard_normal(x.shape)
    # Energy: measured 1e-9.
    assert _contact_energy_slope(contact, x, d, 1e-6) == pytest.approx(
        float((force * d).sum()), rel=1e-6
    )
    # No tangential force: the resultant is along the normal to round-off.
    total = force.sum(axis=0)
    assert np.linalg.norm(np.cross(total, contact.normal)) < 1e-12 * np.linalg.norm(total)


def test_plane_contact_sticking() -> None:
    problem, contact, u = plane_state(5.0, 2.0)
    problem.residual(u, {})
    problem.commit()
    # A small slip under a large limit: every point sticks.
    v = u + 1e-6 * wavy(problem.body.nodes, 1.0, seed=3)
    force = np.zeros_like(u)
    contact.add_residual(problem.positions(v), force)
    tangential = force - np.outer(force @ contact.normal, contact.normal)
    assert np.abs(tangential).max() > 0.0
    assert difference_error(problem, v, {}, 1e-9) < 1e-6


def test_plane_contact_sliding() -> None:
    # Every point beyond its limit: within an increment friction has a potential (the limit is
    # that of the accepted pressure), so this tangent is exact and symmetric too.
    problem, contact, u = plane_state(0.3, 2.0)
    problem.residual(u, {})
    problem.commit()
    v = u + [2e-3, 1e-3, 0.0]
    force = np.zeros_like(u)
    contact.add_residual(problem.positions(v), force)
    total = force.sum(axis=0)
    along = total - (total @ contact.normal) * contact.normal
    # It drags, against the slip.
    assert along @ [2e-3, 1e-3, 0.0] > 0.0
    assert difference_error(problem, v, {}, 1e-8) < 1e-6


def _faces_facing(gap: float) -> TaggedMesh:
    """Two blocks, one above the other at a small distance, their meshes not matching.

    The upper is so placed that none of the lower's contact points falls into the fading rim of
    its faces (half a local unit beyond the edge), where forces have no potential.
    """
    low = grid((3, 3, 1), lambda t: t * [1.0, 1.0, 0.5])
    high = grid((2, 2, 1), lambda t: t * [0.32, 0.32, 0.5] + [0.34, 0.34, 0.5 + gap])
    low = TaggedMesh(low.nodes, low.cells, {}, {"low": low.facet_groups["z1"]})
    high = TaggedMesh(high.nodes, high.cells, {}, {"high": high.facet_groups["z0"]})
    return merged([low, high])


CONTACTS: dict[str, Callable[[TaggedMesh, ContactLaw], FaceContact]] = {
    "pair": lambda m, law: FaceContact(
        "pair", m.nodes, m.facet_groups["low"], m.facet_groups["high"], law, depth=0.2
    ),
    "self": lambda m, law: FaceContact(
        "self",
        m.nodes,
        np.concatenate([m.facet_groups["low"], m.facet_groups["high"]]),
        np.concatenate([m.facet_groups["low"], m.facet_groups["high"]]),
        law,
        depth=0.2,
    ),
}


@pytest.mark.parametrize("kind", list(CONTACTS))
@pytest.mark.parametrize("exponent", [1.5, 2.0])
def test_face_contact(kind: str, exponent: float) -> None:
    mesh = _faces_facing(0.01)
    contact = CONTACTS[kind](mesh, ContactLaw(1e3, exponent))
    problem = StaticProblem(solid(mesh, LAW), [], [], [contact])
    u = wavy(mesh.nodes, 0.04, seed=2)
    u[mesh.nodes[:, 2] > 0.505, 2] -= 0.05
    problem.search(u)
    x = problem.positions(u)
    report = contact.report(x)
    assert report.area > 0.05 and report.largest_penetration > 0.01
    for side in contact._passes:
        active = side.gap < 0.0
        assert active.any() and (side.fade[active] == 1.0).all()
    assert difference_error(problem, u, {}, 1e-8) < 1e-6
    force = np.zeros_like(x)
    energy = contact.add_residual(x, force)
    assert energy > 0.0
    d = np.random.default_rng(5).standard_normal(x.shape)
    assert _contact_energy_slope(contact, x, d, 1e-7) == pytest.approx(
        float((force * d).sum()), rel=1e-6
    )
    # Action and reaction: no resultant force nor moment, to round-off.
    size = np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-11 * size
    # Contact alone, where the body's stiffness cannot hide it.
    assert _contact_tangent_error(contact, x) < 1e-6


def _contact_tangent_error(contact: Contact, x: np.ndarray) -> float:
    worst = 0.0
    items = [(n.copy(), k.copy()) for n, k in contact.stiffness(x)]
    for seed in range(3):
        d = np.random.default_rng(seed).standard_normal(x.shape)
        h = 1e-8
        ends = []
        for sign in (1.0, -1.0):
            force = np.zeros_like(x)
            contact.add_residual(x + sign * h * d, force)
            ends.append(force)
        expected = (ends[0] - ends[1]) / (2.0 * h)
        got = np.zeros_like(x)
        for nodes, k in items:
            local = np.einsum("fij,fj->fi", k, d[nodes].reshape(len(nodes), -1))
            np.add.at(got, nodes.ravel(), local.reshape(-1, 3))
        worst = max(worst, float(np.linalg.norm(got - expected) / np.linalg.norm(expected)))
    print(f"contact tangent against differences: {worst:.2e}")
    return worst


def test_everything_together() -> None:
    # Body, pressure in a closed cavity, ground and self-contact in one tangent.
    mesh = hollow_cube()
    # The cavity flattened to a slit of a tenth.
    z = np.interp(mesh.nodes[:, 2], [0.0, 0.25, 0.5, 0.75, 1.0], [0.0, 0.45, 0.5, 0.55, 1.0])
    mesh = mesh.with_nodes(np.column_stack([mesh.nodes[:, :2], z]))
    faces = mesh.facet_groups["cavity"]
    quads = boundary_facets(mesh.cells)
    bottom = quads[mesh.nodes[quads][:, :, 2].max(axis=1) < 1e-9]
    plane = PlaneContact("ground", mesh.nodes, bottom, (0, 0, 0.05), (0, 0, 1), ContactLaw(1e3))
    inside = FaceContact("self", mesh.nodes, faces, faces, ContactLaw(1e3), depth=0.3)
    load = CavityPressure("p", faces, -2e4)
    problem = StaticProblem(solid(mesh, NeoHooke(1e5), 0.4), [], [load], [plane, inside])
    # Press the middle of the roof through the floor and the body into the ground.
    u = wavy(mesh.nodes, 0.02)
    inner = (np.abs(mesh.nodes[:, :2] - 0.5) < 0.2).all(axis=1)
    u[inner & (np.abs(z - 0.55) < 1e-9), 2] -= 0.22
    problem.search(u)
    assert inside.report(problem.positions(u)).area > 0.0
    assert plane.report(problem.positions(u)).area > 0.0
    assert difference_error(problem, u, {"p": 1.0}, 1e-8) < 1e-6
