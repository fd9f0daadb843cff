"""Self-contact over time: nothing passes through anything, and momentum is kept.

What lies in what is found here by brute force, over all nodes and all cells, with nothing of the
contact's own search.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
import pytest
from statics_helpers import grid, solid

from flexapod.contact.ground import HeightField
from flexapod.contact.law import ContactLaw, FrictionLaw
from flexapod.dynamics.contacts import COUNT, DEPTH, History
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.integrator import Options, RunStats, energies, march
from flexapod.dynamics.kernels import momentum
from flexapod.dynamics.model import Damping, Model, State
from flexapod.dynamics.surface_contact import SurfaceContact
from flexapod.dynamics.workspace import Workspace
from flexapod.fem.body import SolidBody
from flexapod.fem.loads import Displacement
from flexapod.geometry.tagged import boundary_facets, orient_outward
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.prony import Prony

THICK = 1e-3  # of every strip [m]
REACH = 0.45 * THICK  # depth that still counts as contact: less than half the wall
# A part falls 4 m/s at most: it moves by its thickness from one look to the next.
LOOK = Options(interval=2.5e-4)
SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]]
    + [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=float,
)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """A hundred cells are too few to share; on a busy machine waiting for the second core costs."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


class WatchedContact(SurfaceContact):
    """Keeps the deepest penetration of every single step, not only of those that are recorded."""

    deepest = 0.0
    most = 0.0

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        history: History,
        elastic: np.ndarray,
        dissipative: np.ndarray,
    ) -> None:
        super().add_forces(x, v, history, elastic, dissipative)
        self.deepest = max(self.deepest, float(self.totals[DEPTH]))
        self.most = max(self.most, float(self.totals[COUNT]))


@numba.njit
def _holds(x: Any, cell: Any, p: Any, signs: Any) -> bool:
    """Whether `p` lies in a trilinear cell: its local coordinates by Newton's method."""
    local = np.zeros(3)
    for _ in range(30):
        r = p.copy()
        slope = np.zeros((3, 3))
        for a in range(8):
            f = 1.0 + signs[a] * local
            for i in range(3):
                r[i] -= 0.125 * f[0] * f[1] * f[2] * x[cell[a], i]
                slope[i, 0] += 0.125 * signs[a, 0] * f[1] * f[2] * x[cell[a], i]
                slope[i, 1] += 0.125 * signs[a, 1] * f[0] * f[2] * x[cell[a], i]
                slope[i, 2] += 0.125 * signs[a, 2] * f[0] * f[1] * x[cell[a], i]
        change = np.linalg.solve(slope, r)
        local += change
        if np.abs(local).max() > 3.0:
            return False
        if np.abs(change).max() < 1e-10:
            break
    # In plane strain nodes lie on the sides of the cells, to round-off.
    return np.abs(local).max() < 1.0 + 1e-9


@numba.njit
def _to_triangle(p: Any, a: Any, b: Any, c: Any) -> float:
    """Distance of a point from a triangle (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab, ac = b - a, c - a
    d1, d2 = (ab * (p - a)).sum(), (ac * (p - a)).sum()
    d3, d4 = (ab * (p - b)).sum(), (ac * (p - b)).sum()
    d5, d6 = (ab * (p - c)).sum(), (ac * (p - c)).sum()
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        q = a
    elif d3 >= 0.0 and d4 <= d3:
        q = b
    elif d6 >= 0.0 and d5 <= d6:
        q = c
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        q = a + d1 / (d1 - d3) * ab
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        q = a + d2 / (d2 - d6) * ac
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        q = b + (d4 - d3) / (d4 - d3 + d5 - d6) * (c - b)
    else:
        q = a + (ab * vb + ac * vc) / (va + vb + vc)
    return math.sqrt(((p - q) ** 2).sum())


@numba.njit
def deepest_node(x: Any, nodes: Any, cells: Any, faces: Any, signs: Any) -> float:
    """How deep any of `nodes` lies in a cell it is no corner of [m].

    Depth is the distance from the nearest of `faces` that the node is no corner of.
    """
    deepest = 0.0
    low, high = np.empty(3), np.empty(3)
    for e in range(len(cells)):
        for i in range(3):
            low[i] = x[cells[e, 0], i]
            high[i] = low[i]
            for a in range(1, 8):
                low[i] = min(low[i], x[cells[e, a], i])
                high[i] = max(high[i], x[cells[e, a], i])
        for k in nodes:
            # By hand, not by arrays: nearly every pair ends here.
            if x[k, 0] < low[0] or x[k, 1] < low[1] or x[k, 2] < low[2]:
                continue
            if x[k, 0] > high[0] or x[k, 1] > high[1] or x[k, 2] > high[2]:
                continue
            p = x[k]
            if (cells[e] == k).any() or not _holds(x, cells[e], p, signs):
                continue
            depth = np.inf
            for f in range(len(faces)):
                away = 0.0
                for i in range(3):
                    away += (x[faces[f, 0], i] - p[i]) ** 2
                # Cells are a wall's thickness long: the nearest face has all corners near.
                if away > (3.0 * THICK) ** 2 or (faces[f] == k).any():
                    continue
                a, b, c, d = x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]], x[faces[f, 3]]
                depth = min(depth, _to_triangle(p, a, b, c), _to_triangle(p, a, c, d))
            deepest = max(deepest, depth)
    return deepest


@numba.njit
def pierced(x: Any, edges: Any, triangles: Any) -> int:
    """Number of edges that go through triangles they share no corner with."""
    count = 0
    for s in range(len(edges)):
        i, j = edges[s, 0], edges[s, 1]
        p, q = x[i], x[j]
        low, high = np.minimum(p, q), np.maximum(p, q)
        for t in range(len(triangles)):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            far = False
            for k in range(3):
                if min(x[a, k], x[b, k], x[c, k]) > high[k]:
                    far = True
                    break
                if max(x[a, k], x[b, k], x[c, k]) < low[k]:
                    far = True
                    break
            if far or a in (i, j) or b in (i, j) or c in (i, j):
                continue
            # p + m (q - p) = x_a + f u + g v (Moeller and Trumbore).
            u, v, r = x[b] - x[a], x[c] - x[a], p - x[a]
            h = np.cross(q - p, v)
            det = (u * h).sum()
            size = math.sqrt((u * u).sum() * (v * v).sum() * ((q - p) ** 2).sum())
            if abs(det) <= 1e-9 * size:  # parallel: parts of one flat sheet
                continue
            f = (r * h).sum() / det
            w = np.cross(r, u)
            g = ((q - p) * w).sum() / det
            m = (v * w).sum() / det
            if f >= 0.0 and g >= 0.0 and f + g <= 1.0 and 0.0 <= m <= 1.0:
                count += 1
    return count


class Strip:
    """A strip one cell thick that stands on end along z, its upper and lower side along x."""

    def __init__(
        self,
        length: float,
        width: float,
        counts: tuple[int, int],
        bow: float,
        twist: float = 0.0,
        plane: bool = False,
    ) -> None:
        def place(x: np.ndarray) -> np.ndarray:
            s = x[:, 0]
            across = (1.0 - x[:, 2]) * THICK + bow * np.sin(3.0 * np.pi * s)
            beside = (x[:, 1] - 0.5) * width + twist * np.sin(2.0 * np.pi * s)
            return np.stack([across, beside, s * length + 4.0 * THICK], axis=1)

        self.mesh = grid((*counts, 1), place)
        self.faces = orient_outward(self.mesh.cells, boundary_facets(self.mesh.cells))
        self.plane = plane
        if plane:  # what lies beside a cell is then its mirror image: no surface
            extent = np.ptp(self.mesh.nodes[self.faces][:, :, 1], axis=1)
            self.faces = self.faces[extent > 0.0]
        number = np.arange(len(self.mesh.nodes)).reshape(counts[0] + 1, counts[1] + 1, 2)
        self._one, self._two = number[:, :, 0].ravel(), number[:, :, 1].ravel()
        middle = np.arange(self._one.size).reshape(counts[0] + 1, counts[1] + 1)
        a, b = middle[:-1, :-1].ravel(), middle[1:, :-1].ravel()
        c, d = middle[1:, 1:].ravel(), middle[:-1, 1:].ravel()
        self._triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        sides = np.concatenate([self._triangles[:, [0, 1]], self._triangles[:, [1, 2]]])
        sides = np.concatenate([sides, self._triangles[:, [2, 0]]])
        self._edges = np.unique(np.sort(sides, axis=1), axis=0)

    def deepest(self, x: np.ndarray) -> float:
        """Depth of the deepest node in a cell of another part [m]."""
        nodes = np.unique(self.faces)
        return float(deepest_node(x, nodes, self.mesh.cells, self.faces, SIGNS))

    def pierced(self, x: np.ndarray) -> int:
        """How often the middle surface goes through itself."""
        middle = 0.5 * (x[self._one] + x[self._two])
        return int(pierced(middle, self._edges, self._triangles))


def _law(coefficient: float = 3e12) -> ContactLaw:
    """Of traction `coefficient` d^2: 30 kPa, a third of the strip's modulus, at 0.1 mm."""
    one = ContactLaw(1.0).traction_coefficient
    return ContactLaw(coefficient / one)


def _cup(inner: float, plane: bool) -> HeightField:
    """A level floor of radius (or half width) `inner` [m] with steep walls."""
    spacing, half = 5e-4, 60
    x = spacing * (np.arange(2 * half + 1) - half)
    r = np.hypot(x[:, None], 0.0 * x if plane else x)
    heights = np.minimum(6.0 * np.maximum(r - inner, 0.0), 0.12)
    return HeightField(x[0], x[0], spacing, heights, FrictionLaw.constant(0.1))


def _crumpled(
    strip: Strip, strength: float, lean: float, steps: int
) -> tuple[WatchedContact, list[tuple[float, int]], RunStats, list[float]]:
    """Drop a strip on end into a cup and sway gravity of `strength` [m/s2] by `lean` [rad].

    Returns the contact, what the brute force saw after each interval, the run's statistics and
    the extent along z at those times.
    """
    mesh, faces = strip.mesh, strip.faces
    hold = [Displacement("plane strain", np.arange(len(mesh.nodes)), 1)] if strip.plane else []
    contact = WatchedContact(
        "self", mesh.nodes, faces, faces, _law(), depth=REACH, joint_gap=0.0, skin=2e-3
    )
    ground = GroundContact("cup", mesh.nodes, faces, _cup(7e-3, strip.plane), _law(), skin=2e-3)
    model = Model(
        solid(mesh, NeoHooke.from_youngs_modulus(1e5, 0.4), 0.4, 1000.0),
        displacements=hold,
        contacts=[ground, contact],
        damping=Damping(stiffness=0.05),
    )
    state, work, stats = model.start(), Workspace(model), RunStats()
    seen, heights = [], []

    def sway(s: State) -> None:
        angle = lean * math.sin(8.0 * math.pi * s.time)
        model.gravity[:] = strength * np.array([math.sin(angle), 0.0, -math.cos(angle)])

    while stats.steps < steps:
        march(model, state, work, state.interval + 1, LOOK, sway, stats=stats)
        seen.append((strip.deepest(state.x), strip.pierced(state.x)))
        heights.append(float(np.ptp(state.x[:, 2])))
    return contact, seen, stats, heights


def test_the_brute_force_sees_what_is_put_in() -> None:
    """A strip bent onto itself by hand: known depth, known crossings."""
    strip = Strip(0.02, 2e-3, (20, 2), 0.0)
    x = strip.mesh.nodes.copy()
    assert strip.deepest(x) == 0.0 and strip.pierced(x) == 0
    # One node sunk by 0.3 mm into the cell five further on, from outside.
    node = int(np.argmin(np.abs(x - [THICK, 0.0, 4.0 * THICK]).sum(axis=1)))
    x[node] = [THICK - 3e-4, 1e-4, 4.0 * THICK + 5.5e-3]
    assert strip.deepest(x) == pytest.approx(3e-4, rel=1e-9)
    # The far half laid across the near one, through its middle.
    x = strip.mesh.nodes.copy()
    far = x[:, 2] > 0.0145
    x[far] = x[far] @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    x[far] += [-0.0195, 0.3e-3, 0.0102]
    assert strip.pierced(x) > 0


def test_nothing_passes_through_anything_in_1e5_steps_of_crumpling() -> None:
    """A strip of 100 cells folds up in a swaying cup, in plane strain, for 10^5 steps.

    Every 10 to 20 steps all nodes are looked for in all cells, and the middle surface for
    crossings: 6,600 times. All 10^5 steps take 46 s on one thread of a busy machine.
    """
    strip = Strip(0.1, 1e-3, (100, 1), 5e-4, plane=True)
    contact, seen, stats, heights = _crumpled(strip, 100.0, math.radians(60.0), 100_000)
    depth = max(d for d, _ in seen)
    print(
        f"{stats.steps} steps, contact {contact.deepest:.3e} m, {contact.most} points, node "
        f"{depth:.3e} m, crossings {max(n for _, n in seen)}, height {min(heights):.3e} m"
    )
    assert stats.steps >= 100_000
    # It did crumple: measured a tenth of its length high, a third of its 808 points in touch.
    assert min(heights) < 0.25 * 0.1 and contact.most > 100.0
    assert max(n for _, n in seen) == 0
    # Contact is felt at points within the faces, 1 - 1/sqrt(3) of half their length from the rim:
    # the node of a corner of 90 degrees, as at the ends, may be deeper by that times sin 45. A
    # corner squeezed sharper may be deeper still, for moments: the motion is chaotic, and of ten
    # runs whose starts differ by nanometres seven had nodes up to 0.49 mm deep, in 0.1 to 1.1 % of
    # the looks. 2 % leaves a factor of two; never through the wall.
    corner = (1.0 - 1.0 / math.sqrt(3.0)) * 0.5 * THICK * math.sqrt(0.5)
    over = sum(d > contact.deepest + corner for d, _ in seen)
    assert over < 0.02 * len(seen), f"{over} of {len(seen)} looks"
    assert depth < THICK
    # Deeper than its reach a contact would let go.
    assert contact.deepest < REACH


# Not strict: the motion is chaotic, and another rounding may miss the crossing.
@pytest.mark.xfail(
    strict=False, reason="contact is felt at points within faces: two rims cut each other"
)
def test_rims_do_not_cut_each_other() -> None:
    """The same in three dimensions, with free rims: they meet rim on rim, at an angle.

    Measured 6 crossings in 3,000 steps, where the contact went no deeper than its reach.
    """
    strip = Strip(0.08, 2e-3, (80, 2), 5e-4, 2e-4)
    _, seen, _, _ = _crumpled(strip, 200.0, math.radians(25.0), 3_000)
    assert max(n for _, n in seen) == 0


def _forked(rest: np.ndarray, gap: float) -> np.ndarray:
    """The strip's nodes bent to a fork of two parallel arms, their inner sides `gap` [m] apart."""
    along = rest[:, 2] - 0.5 * (rest[:, 2].min() + rest[:, 2].max())
    radius = rest[:, 0] + 0.5 * gap
    bend = 0.5 * (gap + THICK)  # of the middle surface, which keeps its length
    angle = np.clip(along / bend, -0.5 * math.pi, 0.5 * math.pi)
    arm = np.abs(along - bend * angle)
    return np.stack([radius * np.cos(angle) - arm, rest[:, 1], radius * np.sin(angle)], axis=1)


def test_momentum_is_kept_by_a_body_that_folds_onto_itself() -> None:
    """A fork, tumbling free in space, whose arms clap together; contact and material damp it.

    No force comes from outside, and those between two of its parts share a line of action: the
    momentum P = sum m v and the angular momentum L = sum m x cross v stay what they were.
    """
    strip = Strip(0.06, 4e-3, (50, 3), 0.0)
    mesh = strip.mesh.with_nodes(_forked(strip.mesh.nodes, 6e-3))
    contact = WatchedContact(
        "self", mesh.nodes, strip.faces, strip.faces, _law(), depth=REACH, joint_gap=0.0, skin=2e-3
    )
    law = NeoHooke.from_youngs_modulus(1e5, 0.4)
    material = SolidMaterial(law, 1000.0, 0.4, prony=Prony((0.3,), (5e-3,)))
    model = Model(SolidBody(mesh, {"*": material}), contacts=[contact])
    x = mesh.nodes
    velocity = 0.05 * np.random.default_rng(4).standard_normal(x.shape)
    velocity += np.cross([3.0, 5.0, -4.0], x) + [0.2, 0.1, -0.3]
    clap = 1.5 * (np.minimum(x[:, 0], 0.0) / 0.025) ** 2  # towards each other at their ends
    velocity[:, 2] -= np.sign(x[:, 2]) * clap
    state, work = model.start(velocity=velocity), Workspace(model)
    state.histories[0]["dropped0"][0] = 1.0  # [J] of a time before: not on this ledger
    now, kept, lost = np.zeros(10), [], []

    def record(s: State) -> None:
        momentum(model.mass, model.owner, s.x, s.v, now)
        kept.append(now[4:].copy())
        lost.append(energies(model, s, work).contact_loss / energies(model, s, work).start)

    march(model, state, work, 30, Options(interval=1e-3, safety=0.5), record)
    size = float((model.mass[:, None] * np.abs(velocity)).sum())
    linear = max(np.abs(k[:3] - kept[0][:3]).max() for k in kept) / size
    angular = max(np.abs(k[3:] - kept[0][3:]).max() for k in kept) / (size * 0.025)
    print(f"linear {linear:.1e}, angular {angular:.1e}, points {contact.most}, lost {lost[-1]:.3f}")
    # The arms met, and contact took energy.
    assert contact.most > 20.0 and 0.02 < lost[-1] < 0.1
    assert strip.pierced(state.x) == 0
    # Round-off of some thousand sums of forces larger than the momentum they change; measured
    # 8e-16 and 3e-16.
    assert linear < 1e-13
    assert angular < 1e-13


@pytest.mark.parametrize(
    "bow",
    [
        1e-3,
        0.0,
    ],
    ids=["bowed", "flat"],
)
def test_a_strip_laid_onto_itself_feels_it(bow: float) -> None:
    """Two arms pressed 0.1 mm into each other, where the strip is bent and where it is flat."""
    strip = Strip(0.06, 4e-3, (50, 3), bow)
    rest = strip.mesh.nodes
    flat = Strip(0.06, 4e-3, (50, 3), 0.0).mesh.nodes
    contact = SurfaceContact(
        "self", rest, strip.faces, strip.faces, _law(), depth=REACH, joint_gap=5e-4, skin=2e-3
    )
    body = solid(strip.mesh, NeoHooke.from_youngs_modulus(1e5, 0.4), 0.4, 1000.0)
    model = Model(body, contacts=[contact])
    # The bend is too tight for cells of finite length, but nothing is asked of it here.
    state = model.start(_forked(flat, 2.0e-3) - rest)
    arms = state.x[:, 0] < -2e-3
    state.x[arms, 2] -= np.sign(state.x[arms, 2]) * 1.05e-3
    history = contact.start(state.x)
    contact.prepare(state.x, history, 0.0)
    contact.add_forces(state.x, state.v, history, np.zeros_like(rest), np.zeros_like(rest))
    # 20 cells a side and three across with four points each, twice; half of them at least.
    assert contact.totals[COUNT] > 240
    assert contact.totals[DEPTH] == pytest.approx(1e-4, rel=0.01)
