"""The contact laws inside kernels, shared by ground and faces; see `contact.law`."""

from __future__ import annotations

import math

from flexapod.core.jit import inline_kernel

# Entries of the totals a contact reports, of one evaluation:
ENERGY = 0  # of the elastic traction [J]
STICK = 1  # of sticking points [J]
AREA = 2  # in touch [m2]
DEPTH = 3  # of the deepest point [m]
FORCE = 4  # on the body, or on the first surface (3) [N]
COUNT = 7  # points in touch
FRICTION = 8  # friction's part of the force (3) [N]
SLIDING = 11  # way slid since the last evaluation, times area [m3]
FRICTION_LOSS = 12  # what sliding took since the last evaluation [J]
DAMPING_POWER = 13  # that of the normal damping [W]
TOTALS = 14


@inline_kernel
def friction_coefficient(
    speed: float, static: float, dynamic: float, static_speed: float, dynamic_speed: float
) -> float:
    """mu [-] at `speed` [m/s]; the kernels' copy of `contact.law.FrictionLaw.coefficient`."""
    if speed <= static_speed:
        return static
    if speed >= dynamic_speed:
        return dynamic
    a = (speed - static_speed) / (dynamic_speed - static_speed)
    return static + (dynamic - static) * a * a * (3.0 - 2.0 * a)


@inline_kernel
def normal_damping(
    depth: float,
    rate: float,
    elastic: float,
    damping: float,
    damping_exponent: float,
    indentation_exponent: float,
) -> float:
    """Traction [Pa] besides the elastic one, so that both together never pull (equation 4).

    `rate` [m/s] is that of the depth.
    """
    size = damping * abs(rate) ** damping_exponent * depth**indentation_exponent
    return max(-elastic, math.copysign(size, rate))


@inline_kernel
def slide(slip: float, stick: float, limit: float) -> tuple[float, float, float]:
    """Return mapping of Coulomb friction: (share of `slip` kept, shear traction [Pa], slid [m])."""
    trial = stick * slip
    if trial > limit:
        back = limit / trial
        return back, limit, (1.0 - back) * slip
    return 1.0, trial, 0.0
