"""What contact adds to the highest frequency, and how deep points may go at a chosen step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.contact.face_kernels import shape
from flexapod.core.jit import inline_kernel, kernel


@kernel
def contact_rates(
    faces: Any,
    near: Any,
    near_count: int,
    points: Any,
    areas: Any,
    gap: Any,
    margin: float,
    coefficient: float,
    exponent: float,
    damping: float,
    indentation_exponent: float,
    stick: float,
    factor: float,
    inverse_mass: Any,
    springs: Any,
    dashpots: Any,
) -> None:
    """Add what contact may add to the highest frequency: to its square and to its decay.

    Gershgorin's bound row by row: a point of stiffness k adds ``factor k N_a / m_a`` to its
    node a of `springs` (node_count,) [1/s2], and a dashpot likewise to `dashpots` [1/s]; `factor`
    counts the faces it ties together. Both are taken `margin` [m] deeper than the point
    is, and so deep too where it does not touch yet, since it may before the next estimate; the
    dashpot at 1 m/s where it is not linear. Sticking acts across the normal, so that only the
    larger of `stick` [Pa/m] and the normal stiffness counts.
    """
    n = np.empty(4)
    for k in range(near_count):
        f = near[k]
        for q in range(points.shape[0]):
            depth = margin - min(gap[f, q], 0.0)
            spring = max(stick, coefficient * exponent * depth ** (exponent - 1.0))
            dashpot = damping * depth**indentation_exponent
            shape(points[q, 0], points[q, 1], n)
            for a in range(4):
                node = faces[f, a]
                part = factor * areas[f, q] * n[a] * inverse_mass[node]
                springs[node] += spring * part
                dashpots[node] += dashpot * part


@inline_kernel
def _beyond(local: Any, f: int, q: int) -> bool:
    """Whether a point lies beyond its partner's edge."""
    return bool(abs(local[f, q, 0]) > 1.0 or abs(local[f, q, 1]) > 1.0)


@kernel
def pair_rates(
    faces: Any,
    near: Any,
    near_count: int,
    points: Any,
    areas: Any,
    masters: Any,
    halves: Any,
    partner: Any,
    local: Any,
    gap: Any,
    offset: Any,
    margin: float,
    rim_margin: float,
    coefficient: float,
    exponent: float,
    damping: float,
    indentation_exponent: float,
    stick: float,
    share: float,
    inverse_mass: Any,
    springs: Any,
    dashpots: Any,
) -> None:
    """As `contact_rates`, of points that press on faces: their stiffness counts on both sides.

    A point of stiffness k, weighed by `share`, adds ``2 share k N_a / m_a``, the row sum of
    Gershgorin's bound, to its own nodes and to those of its partner: either may be deep by points
    of its own or by the other's. At its own it counts twice, for what presses there once partners
    have changed. It presses by its depth less its `offset`. Beyond a rim the force along the face
    stiffens with the square of depth over margin, `rim_margin` times `halves` (master_count,) [m],
    half the partner's edge.
    """
    n = np.empty(4)
    for k in range(near_count):
        f = near[k]
        for q in range(points.shape[0]):
            press = max(0.0, -gap[f, q] - offset[f, q])
            depth = margin + press
            spring = max(stick, coefficient * exponent * depth ** (exponent - 1.0))
            dashpot = damping * depth**indentation_exponent
            m = partner[f, q]
            weight = 2.0 * share * areas[f, q]
            if m >= 0 and press > 0.0 and _beyond(local, f, q):
                ratio = depth / (rim_margin * halves[m])
                spring *= max(1.0, ratio * ratio)
            shape(points[q, 0], points[q, 1], n)
            for a in range(4):
                node = faces[f, a]
                part = 2.0 * weight * n[a] * inverse_mass[node]
                springs[node] += spring * part
                dashpots[node] += dashpot * part
            if m < 0:
                continue
            shape(local[f, q, 0], local[f, q, 1], n)
            for a in range(4):
                node = masters[m, a]
                part = weight * abs(n[a]) * inverse_mass[node]
                springs[node] += spring * part
                dashpots[node] += dashpot * part


@inline_kernel
def _room(node: int, springs: Any, dashpots: Any, elements: Any, omega: float) -> float:
    """How often the rates of contact at a node fit into what `omega` leaves of it."""
    more = springs[node] + omega * dashpots[node]
    if not more > 0.0:
        return math.inf
    return float((omega * omega - elements[node]) / more)


@kernel
def allowed_depths(
    faces: Any,
    counted: Any,
    masters: Any,
    partner: Any,
    local: Any,
    gap: Any,
    offset: Any,
    margin: float,
    growth: float,
    springs: Any,
    dashpots: Any,
    elements: Any,
    omega: float,
    allowed: Any,
) -> None:
    """Fill `allowed` (face_count, point_count): how far points may press in [m] at a frequency.

    The points of the faces `counted` have their share in `springs` [1/s2] and `dashpots` [1/s]
    (node_count,), see `pair_rates`, at `margin` [m] beyond their depth less their `offset`. Beside
    what `elements` (node_count,) [1/s2] ask for, those may grow until ``elements + springs + omega
    dashpots`` of a node is ``omega**2`` [1/s2]: the row sums of ``K + omega C`` bound the
    frequency. They grow with the depth to the power `growth`, beyond a rim to that of two more. A
    point without a partner may go no deeper than `margin` into whatever it meets. Points of other
    faces have no share: they may not touch.
    """
    allowed[:] = 0.0
    for k in range(counted.shape[0]):
        f = counted[k]
        own = math.inf
        for a in range(4):
            own = min(own, _room(faces[f, a], springs, dashpots, elements, omega))
        for q in range(gap.shape[1]):
            room = own if partner[f, q] >= 0 else 1.0
            power = growth
            if partner[f, q] >= 0:
                for a in range(4):
                    node = masters[partner[f, q], a]
                    room = min(room, _room(node, springs, dashpots, elements, omega))
                if _beyond(local, f, q):
                    power += 2.0
            scale = max(room, 1.0) ** (1.0 / power)
            allowed[f, q] = scale * (margin + max(0.0, -gap[f, q] - offset[f, q]))
