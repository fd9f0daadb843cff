"""Rheological line elements inside kernels: exact steps in time; see `materials.rheology`.

A Voigt element (stiffness k, damping b, elongation e_v) in series with a dashpot (c, elongation
e_d) that flows only while the force in it exceeds the limit B. Tension is positive. With the rate
e' of the whole elongation constant over a step, let

    f_s = k e_v + b e'          the force if the dashpot stood still
    f_y = f_s / (1 + b/c)       the force if it flowed by f = c e_d'

Where f_s is beyond the limit but f_y is not, the dashpot neither stands nor flows freely: it slides
at the limit (the solution of the switching law in Filippov's sense). So, for tension,

    stuck      f_s <= B                e_d' = 0
    sliding    B < f_s < B (1 + b/c)   f = B,        b e_v' = B - k e_v
    flowing    f_s >= B (1 + b/c)      f = c e_d',   (b + c) e_v' = c e' - k e_v

and likewise for compression. The other reading, Bingham's f = B + c e_d', flows from f_s = B on
and never slides. In each regime e_v' is linear in e_v, and over all five it is a continuous
function of e_v that never rises. So e_v moves one way during a step and passes each regime at most
once: its times of passage have closed forms, and the order in which regimes follow is known before
any number is compared. Nothing can chatter, and the result depends on the length of a step by
round-off only.

With b = 0 the sliding regime shrinks to the single point k e_v = B, where the element stays as
long as 0 < c e' < B.
"""

from __future__ import annotations

import math
from typing import Any

from flexapod.core.jit import inline_kernel, kernel

# Below this many decay times a power series in them takes over, since there the closed forms
# cancel: at 0.5 they lose a factor of ten of precision at most, and the series needs some twenty
# terms.
_SERIES = 0.5


@inline_kernel
def _settling(
    rate: float, flow: float, speed: float, x: float
) -> tuple[float, float, float, float, float]:
    """A flow that starts at `flow` and nears ``rate = flow + speed`` as ``exp(-x)``, x >= 0.

    Returns its end, its mean, the mean of its square, and the means of ``exp`` and ``exp**2``.
    """
    whole = -math.expm1(-x)
    if x > _SERIES:
        kept = whole / x
        square = (whole - 0.5 * whole * whole) / x
        end = rate - speed * math.exp(-x)
        mean = rate - speed * kept
        mean_square = rate * rate - 2.0 * rate * speed * kept + speed * speed * square
        return end, mean, mean_square, kept, square
    # Means of 1 - exp and of (1 - exp)**2.
    term = 0.5 * x  # x**n / (n+1)! with alternating sign
    power = 2.0  # 2**n
    first = term
    second = 0.0
    for n in range(2, 24):
        term *= -x / (n + 1)
        power *= 2.0
        first += term
        second -= (power - 2.0) * term
        if power * abs(term) <= 1e-18 * x * x:
            break
    end = flow + speed * whole
    mean = flow + speed * first
    mean_square = flow * flow + 2.0 * flow * speed * first + speed * speed * second
    return end, mean, mean_square, 1.0 - first, 1.0 - 2.0 * first + second


@kernel
def advance(
    stiffness: float,
    damping: float,
    flow_damping: float,
    limit: float,
    excess: int,
    e_v: float,
    rate: float,
    dt: float,
) -> tuple[float, float, float, float]:
    """Advance the element by `dt` >= 0 [s] at the constant `rate` [m/s] of its elongation.

    Returns the Voigt part's new elongation [m], the force at the end [N], the mean force over the
    step [N] and the energy dissipated in it [J], >= 0. Exact, so that mean force times `rate`
    times `dt` is the change of ``k e_v**2 / 2`` plus what was dissipated.

    Parameters
    ----------
    stiffness, damping
        k [N/m] and b [N s/m] of the Voigt part, >= 0.
    flow_damping, limit
        c [N s/m] > 0 of the dashpot in series and B [N] >= 0, beyond which it flows; either
        infinite: it never does. With a limit of zero it always flows.
    excess
        1: the force beyond the limit drives the flow (Bingham); 0: all of it.
    e_v
        Elongation of the Voigt part at the start [m].
    """
    start = stiffness * e_v + damping * rate
    end = start + stiffness * rate * dt
    if math.isinf(flow_damping) or (abs(start) <= limit and abs(end) <= limit):
        mean = 0.5 * (start + end)
        return e_v + rate * dt, end, mean, damping * rate * rate * dt

    # Regimes are numbered -2 .. 2: flowing, sliding, stuck, sliding, flowing.
    flows_from = limit
    if excess == 0:
        flows_from += limit * (damping / flow_damping)
    regime = 2
    if limit > 0.0:  # else no force is too small
        if abs(start) <= limit:
            regime = 0
        elif abs(start) < flows_from:
            regime = 1
    if start < 0.0:
        regime = -regime

    direction = 0
    left = dt
    impulse = 0.0
    dissipated = 0.0
    force = 0.0
    for _ in range(8):
        side = 1.0
        if regime < 0:
            side = -1.0
        size = abs(regime)
        if size == 1 and flows_from <= limit:
            # Without a width, sliding is a point: stay there or pass.
            if excess == 0 and side * rate > 0.0 and flow_damping * abs(rate) < limit:
                force = side * limit
                impulse += force * left
                dissipated += force * rate * left
                break
            regime += direction
            continue

        # f = held + viscous * e_d', and decay is the rate at which e_v settles.
        present = stiffness * e_v + damping * rate
        held = 0.0
        viscous = 0.0
        decay = 0.0
        flow = 0.0
        if size == 1:
            held = side * limit
            flow = (present - held) / damping
            decay = stiffness / damping
        elif size == 2:
            viscous = flow_damping
            if excess != 0:
                held = side * limit
            flow = (present - held) / (damping + flow_damping)
            decay = stiffness / (damping + flow_damping)
        speed = rate - flow  # of the Voigt part

        # When does e_v leave the regime? It only ever moves one way: a sign against that is the
        # round-off of a state of rest.
        heading = 0
        if speed > 0.0:
            heading = 1
        elif speed < 0.0:
            heading = -1
        if direction == 0:
            direction = heading
        span = left
        border = 0.0
        leaves = False
        if heading != 0 and heading == direction and stiffness > 0.0 and limit > 0.0:
            outward = heading * regime >= 0
            if not (outward and size == 2):
                level = limit
                if (outward and size == 1) or (not outward and size == 2):
                    level = flows_from
                if regime == 0:
                    level *= heading
                else:
                    level *= side
                border = (level - damping * rate) / stiffness
                way = max(0.0, (border - e_v) / speed)  # as a time at the present speed
                if decay > 0.0:
                    if decay * way < 1.0:
                        way = -math.log1p(-decay * way) / decay
                    else:
                        way = math.inf
                if way < left:
                    leaves = True
                    span = way

        if size == 0:
            impulse += (present + 0.5 * stiffness * speed * span) * span
            dissipated += damping * speed * speed * span
            e_new = e_v + speed * span
            force = stiffness * e_new + damping * rate
        else:
            end_flow, mean_flow, flow_square, kept, square = _settling(
                rate, flow, speed, decay * span
            )
            force = held + viscous * end_flow
            impulse += (held + viscous * mean_flow) * span
            loss = damping * speed * speed * square + max(0.0, held * mean_flow)
            dissipated += (loss + viscous * max(0.0, flow_square)) * span
            e_new = e_v + speed * kept * span
        if not leaves:
            e_v = e_new
            break
        e_v = border
        left -= span
        regime += direction

    mean = force
    if dt > 0.0:
        mean = impulse / dt
    return e_v, force, mean, dissipated


@kernel
def drive(
    stiffness: float,
    damping: float,
    flow_damping: float,
    limit: float,
    excess: int,
    times: Any,
    elongations: Any,
    voigt: Any,
    force: Any,
    work: Any,
    dissipated: Any,
) -> None:
    """Follow `elongations` [m] at `times` [s], straight in between, from ``voigt[0]`` on.

    Fills `voigt` [m], `force` [N] at the end of each interval, and the sums of `work` and
    `dissipated` [J]; all arrays have the shape (n,), n >= 2.
    """
    for i in range(times.size - 1):
        dt = times[i + 1] - times[i]
        rate = (elongations[i + 1] - elongations[i]) / dt
        if i == 0:
            _, force[0], _, _ = advance(
                stiffness, damping, flow_damping, limit, excess, voigt[0], rate, 0.0
            )
            work[0] = 0.0
            dissipated[0] = 0.0
        voigt[i + 1], force[i + 1], mean, loss = advance(
            stiffness, damping, flow_damping, limit, excess, voigt[i], rate, dt
        )
        work[i + 1] = work[i] + mean * rate * dt
        dissipated[i + 1] = dissipated[i] + loss


@kernel
def active_force(
    force: float, on: bool, rate_on: float, rate_off: float, largest: float, dt: float
) -> float:
    """Active force [N] of a coil after `dt` [s] with its voltage `on` or off, exact.

    dF/dt is `rate_on` [N/s] while on and F < `largest` [N], -`rate_off` while off and F > 0, else
    zero (equation 5 of the source in `materials.coil`).
    """
    if on:
        return max(force, min(force + rate_on * dt, largest))
    return min(force, max(force - rate_off * dt, 0.0))
