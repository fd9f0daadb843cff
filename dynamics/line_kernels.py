"""Kernels of line elements, of the bending of closed curves, and of whole steps of both.

A line robot has some forty nodes: a step of it costs microseconds, less than one call from Python.
`march` therefore walks through a whole control interval, with the very kernels a single step uses.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from flexapod.contact import law_kernels
from flexapod.contact.face_kernels import POINTS
from flexapod.contact.ground_kernels import ground_contact, near_faces
from flexapod.core.jit import inline_kernel, kernel
from flexapod.dynamics.kernels import kick_part
from flexapod.materials.rheology_kernels import active_force, advance

# Entries of a history's "spent": what rheology and bending dissipated, what active forces worked.
LOSS, COIL_WORK = 0, 1

# How `march` ended: all steps done, contact deeper than the step was chosen for, something for
# the single step to name.
DONE, DEEPER, TROUBLE = 0, 1, 2


class LineArrays(NamedTuple):
    """Line elements, see `flexapod.dynamics.lines.Lines`."""

    end_start: Any
    end_nodes: Any
    length: Any
    stiffness: Any
    damping: Any
    flow_damping: Any
    limit: Any
    excess: Any
    coil: Any


class CoilArrays(NamedTuple):
    """Active forces and their switching, see `flexapod.dynamics.lines.Coils`."""

    rate_on: Any
    rate_off: Any
    largest: Any
    times: Any
    states: Any


class HingeArrays(NamedTuple):
    """Bending of closed curves, see `flexapod.dynamics.lines.Hinges`."""

    nodes: Any
    ring: Any
    ring_start: Any
    ring_nodes: Any
    stiffness: Any
    rest_angle: Any
    damping_time: Any


class LineHistory(NamedTuple):
    """What line elements remember; written in place."""

    length: Any
    extension: Any
    active: Any
    force: Any
    angle: Any
    spent: Any


class GroundArrays(NamedTuple):
    """A contact with the ground as `march` needs it."""

    faces: Any
    areas: Any
    kind: int
    params: Any
    heights: Any
    law: Any
    skin: float
    deepest: float
    reach: float
    anchor: Any
    active: Any
    count: Any
    way: Any
    depth: Any
    spent: Any
    pressure: Any
    shear: Any
    totals: Any
    curve_nodes: Any
    curve_weights: Any
    curve_x: Any
    curve_v: Any
    curve_elastic: Any
    curve_dissipative: Any


class NodeArrays(NamedTuple):
    """Nodes and what a kick needs of them."""

    nodes: Any
    mass: Any
    own_mass: Any
    owner: Any
    fixed: Any
    u: Any
    x: Any
    v: Any
    elastic: Any
    dissipative: Any
    nothing: Any
    total: Any
    parts: Any


@kernel
def advance_active(coils: CoilArrays, begin: float, end: float, active: Any, previous: Any) -> None:
    """Move the active forces `active` (coil_count,) [N] from time `begin` to `end` [s].

    Exact, whatever is switched in between; `previous` receives the forces before.
    """
    row = int(np.searchsorted(coils.times, begin, side="right")) - 1
    if row < 0:
        row = 0
    previous[:] = active
    at = begin
    while at < end:
        stop = end
        if row + 1 < coils.times.shape[0] and coils.times[row + 1] < end:
            stop = coils.times[row + 1]
        for c in range(active.shape[0]):
            active[c] = active_force(
                active[c],
                coils.states[row, c],
                coils.rate_on[c],
                coils.rate_off[c],
                coils.largest[c],
                stop - at,
            )
        at = stop
        row += 1


@inline_kernel
def _ends(x: Any, lines: LineArrays, line: int, along: Any) -> float:
    """Fill `along` (3,) with the unit vector from the first end to the second; return the length.

    An end is the middle of its nodes.
    """
    square = 0.0
    for i in range(3):
        along[i] = 0.0
    for side in range(2):
        first = lines.end_start[2 * line + side]
        last = lines.end_start[2 * line + side + 1]
        share = (2.0 * side - 1.0) / (last - first)
        for e in range(first, last):
            for i in range(3):
                along[i] += share * x[lines.end_nodes[e], i]
    for i in range(3):
        square += along[i] * along[i]
    length = math.sqrt(square)
    for i in range(3):
        along[i] /= length
    return length


@kernel
def line_lengths(x: Any, lines: LineArrays, out: Any) -> None:
    """Distances of the ends [m], shape (line_count,)."""
    along = np.empty(3)
    for line in range(lines.length.shape[0]):
        out[line] = _ends(x, lines, line, along)


@kernel
def line_forces(
    x: Any,
    v: Any,
    dt: float,
    lines: LineArrays,
    active_before: Any,
    history: LineHistory,
    out: Any,
) -> float:
    """Add the forces of line elements [N] to `out` (node_count, 3); return the energy stored [J].

    `dt` [s] is the length of the step that led to `x`: over it the rate of elongation is constant,
    and each element's own law is advanced exactly. With ``dt = 0`` nothing is advanced and the
    rate is that of the velocities `v`. ``history.active`` holds the active forces now, and
    `active_before` those before the step.
    """
    along = np.empty(3)
    stored = 0.0
    for line in range(lines.length.shape[0]):
        now = _ends(x, lines, line, along)
        change = now - history.length[line]
        if dt > 0.0:
            rate = change / dt
        else:
            rate = 0.0
            for side in range(2):
                first = lines.end_start[2 * line + side]
                last = lines.end_start[2 * line + side + 1]
                share = (2.0 * side - 1.0) / (last - first)
                for e in range(first, last):
                    for i in range(3):
                        rate += share * along[i] * v[lines.end_nodes[e], i]
        if math.isinf(lines.limit[line]):
            # A Voigt element: its extension is the elongation itself, without a sum's rounding.
            extension = now - lines.length[line]
            force = lines.stiffness[line] * extension + lines.damping[line] * rate
            lost = lines.damping[line] * rate * rate * dt
        else:
            extension, force, _, lost = advance(
                lines.stiffness[line],
                lines.damping[line],
                lines.flow_damping[line],
                lines.limit[line],
                lines.excess[line],
                history.extension[line],
                rate,
                dt,
            )
        history.extension[line] = extension
        history.length[line] = now
        history.spent[LOSS] += lost
        stored += 0.5 * lines.stiffness[line] * extension * extension
        coil = lines.coil[line]
        if coil >= 0:
            mean = 0.5 * (active_before[coil] + history.active[coil])
            history.spent[COIL_WORK] -= mean * change
            force += history.active[coil]
        history.force[line] = force
        for side in range(2):
            first = lines.end_start[2 * line + side]
            last = lines.end_start[2 * line + side + 1]
            share = force * (1.0 - 2.0 * side) / (last - first)
            for e in range(first, last):
                for i in range(3):
                    out[lines.end_nodes[e], i] += share * along[i]
    return stored


@inline_kernel
def _cross(a: Any, b: Any, out: Any) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inline_kernel
def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def ring_normals(x: Any, hinges: HingeArrays, normal: Any, area: Any) -> None:
    """Unit normals (ring_count, 3) and areas [m2] of the closed curves' area vectors.

    ``A = 1/2 sum (x_i - x_0) x (x_i+1 - x_0)``: the plane a curve lies in, or the best one.
    """
    a = np.empty(3)
    b = np.empty(3)
    c = np.empty(3)
    for ring in range(area.shape[0]):
        first = hinges.ring_start[ring]
        last = hinges.ring_start[ring + 1]
        origin = hinges.ring_nodes[first]
        normal[ring, :] = 0.0
        for k in range(first + 1, last - 1):
            for i in range(3):
                a[i] = x[hinges.ring_nodes[k], i] - x[origin, i]
                b[i] = x[hinges.ring_nodes[k + 1], i] - x[origin, i]
            _cross(a, b, c)
            for i in range(3):
                normal[ring, i] += 0.5 * c[i]
        size = math.sqrt(_dot(normal[ring], normal[ring]))
        area[ring] = size
        for i in range(3):
            normal[ring, i] /= size


@kernel
def hinge_forces(
    x: Any,
    dt: float,
    hinges: HingeArrays,
    history: LineHistory,
    out: Any,
) -> float:
    """Add the forces of bending [N] to `out` (node_count, 3); return the energy stored [J].

    At a node of a closed curve with the segments e1 and e2 before and behind it, and the unit
    normal n of the curve's plane (`ring_normals`),

        theta = atan2(n . (e1 x e2), e1 . e2 - (n . e1)(n . e2))     turn within the plane
        phi = asin(n . e2/|e2|) - asin(n . e1/|e1|)                  turn out of it
        U = k_in (theta - theta_0)**2 / 2 + k_out phi**2 / 2

    so that a plane curve is the discrete elastica with its signed angle. n depends on all nodes of
    the curve; its derivative is part of the forces, which therefore keep momentum and angular
    momentum. ``damping_time`` [s] times the stiffness is the dashpot of both turns, as it was over
    the last step of `dt` [s].
    """
    rings = hinges.ring_start.shape[0] - 1
    normal = np.empty((rings, 3))
    area = np.empty(rings)
    by_normal = np.zeros((rings, 3))
    ring_normals(x, hinges, normal, area)
    e = np.empty((2, 3))
    cross = np.empty(3)
    turned = np.empty(3)
    by_edge = np.empty((2, 3))
    stored = 0.0
    for h in range(hinges.ring.shape[0]):
        ring = hinges.ring[h]
        n = normal[ring]
        for k in range(2):
            for i in range(3):
                e[k, i] = x[hinges.nodes[h, k + 1], i] - x[hinges.nodes[h, k], i]
        _cross(e[0], e[1], cross)
        up0 = _dot(n, e[0])
        up1 = _dot(n, e[1])
        sine = _dot(n, cross)
        cosine = _dot(e[0], e[1]) - up0 * up1
        theta = math.atan2(sine, cosine)
        l0 = math.sqrt(_dot(e[0], e[0]))
        l1 = math.sqrt(_dot(e[1], e[1]))
        s0 = up0 / l0
        s1 = up1 / l1
        phi = math.asin(s1) - math.asin(s0)
        bend = theta - hinges.rest_angle[h]
        k_in = hinges.stiffness[h, 0]
        k_out = hinges.stiffness[h, 1]
        stored += 0.5 * (k_in * bend * bend + k_out * phi * phi)
        moment = k_in * bend
        moment_out = k_out * phi
        if dt > 0.0 and hinges.damping_time[h] > 0.0:
            rate = (theta - history.angle[h, 0]) / dt
            rate_out = (phi - history.angle[h, 1]) / dt
            moment += hinges.damping_time[h] * k_in * rate
            moment_out += hinges.damping_time[h] * k_out * rate_out
            power = k_in * rate * rate + k_out * rate_out * rate_out
            history.spent[LOSS] += hinges.damping_time[h] * power * dt
        history.angle[h, 0] = theta
        history.angle[h, 1] = phi
        # d(theta) = (C dS - S dC) / (S**2 + C**2) of the sine S and the cosine C above.
        square = sine * sine + cosine * cosine
        a = moment * cosine / square
        b = moment * sine / square
        _cross(e[1], n, turned)
        for i in range(3):
            by_edge[0, i] = a * turned[i] - b * (e[1, i] - up1 * n[i])
        _cross(n, e[0], turned)
        for i in range(3):
            by_edge[1, i] = a * turned[i] - b * (e[0, i] - up0 * n[i])
            by_normal[ring, i] += a * cross[i] + b * (up1 * e[0, i] + up0 * e[1, i])
        c0 = moment_out / math.sqrt(1.0 - s0 * s0)
        c1 = moment_out / math.sqrt(1.0 - s1 * s1)
        for i in range(3):
            by_edge[0, i] -= c0 * (n[i] / l0 - s0 * e[0, i] / (l0 * l0))
            by_edge[1, i] += c1 * (n[i] / l1 - s1 * e[1, i] / (l1 * l1))
            by_normal[ring, i] += c1 * e[1, i] / l1 - c0 * e[0, i] / l0
        for i in range(3):
            out[hinges.nodes[h, 0], i] += by_edge[0, i]
            out[hinges.nodes[h, 1], i] += by_edge[1, i] - by_edge[0, i]
            out[hinges.nodes[h, 2], i] -= by_edge[1, i]
    for ring in range(rings):
        first = hinges.ring_start[ring]
        last = hinges.ring_start[ring + 1]
        n = normal[ring]
        along = _dot(by_normal[ring], n)
        for i in range(3):
            cross[i] = (by_normal[ring, i] - along * n[i]) / area[ring]
        for k in range(first, last):
            before = hinges.ring_nodes[k - 1 if k > first else last - 1]
            behind = hinges.ring_nodes[k + 1 if k + 1 < last else first]
            for i in range(3):
                e[0, i] = 0.5 * (x[behind, i] - x[before, i])
            _cross(e[0], cross, turned)
            for i in range(3):
                out[hinges.ring_nodes[k], i] -= turned[i]
    return stored


@kernel
def line_rates(
    lines: LineArrays,
    hinges: HingeArrays,
    history: LineHistory,
    edge: Any,
    inverse_mass: Any,
    springs: Any,
    dashpots: Any,
) -> None:
    """Add per node the sums of absolute stiffnesses over mass [1/s2], and of dashpots [1/s].

    Gershgorin's bound: a line adds twice its stiffness to each of its ends, a hinge what its
    gradient of turning ``(1/l1, 1/l1 + 1/l2, 1/l2)`` gives; `edge` (hinge_count, 2) [m].
    """
    for line in range(lines.length.shape[0]):
        # What pulls also stiffens sideways.
        pull = max(history.force[line], 0.0) / history.length[line]
        for side in range(2):
            first = lines.end_start[2 * line + side]
            last = lines.end_start[2 * line + side + 1]
            share = 2.0 / (last - first)
            for e in range(first, last):
                node = lines.end_nodes[e]
                springs[node] += share * (lines.stiffness[line] + pull) * inverse_mass[node]
                dashpots[node] += share * lines.damping[line] * inverse_mass[node]
    gradient = np.empty(3)
    for h in range(hinges.ring.shape[0]):
        gradient[0] = 1.0 / edge[h, 0]
        gradient[2] = 1.0 / edge[h, 1]
        gradient[1] = gradient[0] + gradient[2]
        stiffness = max(hinges.stiffness[h, 0], hinges.stiffness[h, 1])
        for k in range(3):
            node = hinges.nodes[h, k]
            part = stiffness * gradient[k] * 2.0 * gradient[1] * inverse_mass[node]
            springs[node] += part
            dashpots[node] += hinges.damping_time[h] * part


@kernel
def curve_points(values: Any, nodes: Any, weights: Any, out: Any) -> None:
    """Points (point_count, 3) that are sums of `values` at four `nodes` each, by `weights`."""
    for p in range(nodes.shape[0]):
        for i in range(3):
            total = 0.0
            for a in range(4):
                total += weights[p, a] * values[nodes[p, a], i]
            out[p, i] = total


@kernel
def curve_forces(force: Any, nodes: Any, weights: Any, out: Any) -> None:
    """Add forces on the points of `curve_points` to the nodes: the same work for every motion."""
    for p in range(nodes.shape[0]):
        for i in range(3):
            if force[p, i] != 0.0:
                for a in range(4):
                    out[nodes[p, a], i] += weights[p, a] * force[p, i]


@kernel
def march(
    begin: float,
    dt: float,
    count: int,
    dt_before: float,
    travel: float,
    gravity: Any,
    mass_damping: float,
    allowed: float,
    nodes: NodeArrays,
    lines: LineArrays,
    coils: CoilArrays,
    hinges: HingeArrays,
    history: LineHistory,
    active_before: Any,
    ground: GroundArrays,
    works: Any,
    sums: Any,
    out: Any,
) -> int:
    """Up to `count` steps of `dt` [s] from time `begin` [s]; return how it ended.

    The steps of `integrator.step` for a model of line elements with one ground at most (none: no
    faces), without what happens at an interval's first step. `out` (3,) receives the steps done,
    the bound of a node's way in the last one [m] and the deepest point met [m]. It stops after a
    step in which contact was deeper than `allowed` [m] or had looked for faces anew and found or
    lost some, and before one that would fail.
    """
    out[0] = 0.0
    out[1] = travel
    out[2] = 0.0
    for k in range(count):
        time = begin + k * dt
        curved = ground.curve_nodes.shape[0] > 0
        x = nodes.x
        v = nodes.v
        elastic = nodes.elastic
        dissipative = nodes.dissipative
        if curved:
            curve_points(nodes.x, ground.curve_nodes, ground.curve_weights, ground.curve_x)
            curve_points(nodes.v, ground.curve_nodes, ground.curve_weights, ground.curve_v)
            x = ground.curve_x
            v = ground.curve_v
            elastic = ground.curve_elastic
            dissipative = ground.curve_dissipative
            elastic[:] = 0.0
            dissipative[:] = 0.0
        searched = False
        if ground.faces.shape[0] > 0:
            ground.way[0] += ground.reach * out[1]
            if ground.way[0] > ground.skin:
                searched = search_ground(x, ground)
        nodes.elastic[:] = 0.0
        nodes.dissipative[:] = 0.0
        if ground.faces.shape[0] > 0:
            law = ground.law
            ground_contact(
                x,
                v,
                ground.faces,
                ground.active[: ground.count[0]],
                POINTS,
                ground.areas,
                ground.kind,
                ground.params,
                ground.heights,
                law[0],
                law[1],
                law[2],
                law[3],
                law[4],
                law[5],
                law[6],
                law[7],
                law[8],
                law[9],
                ground.anchor,
                elastic,
                dissipative,
                ground.pressure,
                ground.shear,
                ground.totals,
            )
            depth = ground.totals[law_kernels.DEPTH]
            ground.depth[0] = depth
            out[2] = max(out[2], depth)
            if depth > ground.deepest:
                return TROUBLE
            if curved:
                curve_forces(elastic, ground.curve_nodes, ground.curve_weights, nodes.elastic)
                curve_forces(
                    dissipative, ground.curve_nodes, ground.curve_weights, nodes.dissipative
                )
        advance_active(coils, time - dt_before, time, history.active, active_before)
        line_forces(nodes.x, nodes.v, dt_before, lines, active_before, history, nodes.elastic)
        hinge_forces(nodes.x, dt_before, hinges, history, nodes.elastic)
        h = 0.5 * (dt_before + dt)
        kick_part(
            0,
            0,
            nodes.v.shape[0],
            h,
            mass_damping,
            gravity,
            nodes.mass,
            nodes.own_mass,
            nodes.owner,
            nodes.fixed,
            nodes.nothing,
            nodes.nothing,
            nodes.elastic,
            nodes.dissipative,
            nodes.nothing,
            nodes.v,
            nodes.total,
            nodes.parts,
        )
        for j in range(1, 6):
            works[j] += nodes.parts[0, j]
        sums[0] = nodes.parts[0, 0]
        fastest = nodes.parts[0, 6]
        if not math.isfinite(sums[0]):
            return TROUBLE
        if ground.faces.shape[0] > 0:
            totals = ground.totals
            if totals[law_kernels.AREA] > 0.0:
                ground.spent[0] += totals[law_kernels.SLIDING] / totals[law_kernels.AREA]
            ground.spent[1] += totals[law_kernels.FRICTION_LOSS]
            ground.spent[2] += dt * totals[law_kernels.DAMPING_POWER]
        for node in range(nodes.x.shape[0]):
            for i in range(3):
                nodes.u[node, i] += dt * nodes.v[node, i]
                nodes.x[node, i] = nodes.nodes[node, i] + nodes.u[node, i]
        out[0] += 1.0
        out[1] = math.sqrt(fastest) * dt
        dt_before = dt
        deeper = ground.faces.shape[0] > 0 and ground.depth[0] > allowed
        if (deeper or searched) and k < count - 1:
            return DEEPER
    return DONE


@kernel
def search_ground(x: Any, ground: GroundArrays) -> bool:
    """Find the faces near the ground anew; those that left it lose anchors and tractions.

    Returns whether any is or was near: what is high in the air has no share in the step.
    """
    before = ground.count[0]
    count = near_faces(
        x, ground.faces, ground.kind, ground.params, ground.heights, ground.skin, ground.active
    )
    ground.count[0] = count
    ground.way[0] = 0.0
    for f in range(ground.faces.shape[0]):
        ground.shear[f, 0] = -1.0
    for k in range(count):
        ground.shear[ground.active[k], 0] = 0.0
    for f in range(ground.faces.shape[0]):
        if ground.shear[f, 0] < 0.0:
            for q in range(ground.shear.shape[1]):
                ground.shear[f, q] = 0.0
                ground.pressure[f, q] = 0.0
                for i in range(3):
                    ground.anchor[f, q, i] = math.nan
    return before > 0 or count > 0
