"""Contact over time: who may touch is looked up when motion asks for it, and kept in a history.

The laws are those of the statics (`contact.law`), with the paper's damping added. A history holds
all a contact remembers, so that a run that goes on from a checkpoint goes on with the same bits.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flexapod.contact import law_kernels

History = dict[str, np.ndarray]

# Entries of a contact's totals, see `contact.law_kernels`.
ENERGY, STICK, AREA, DEPTH = (
    law_kernels.ENERGY,
    law_kernels.STICK,
    law_kernels.AREA,
    law_kernels.DEPTH,
)
FORCE = slice(law_kernels.FORCE, law_kernels.FORCE + 3)
FRICTION = slice(law_kernels.FRICTION, law_kernels.FRICTION + 3)
COUNT, TOTALS = law_kernels.COUNT, law_kernels.TOTALS

# Entries of a history's "spent": way slid on average over the area in touch [m], what friction
# and what damping took [J].
SLID, BY_FRICTION, BY_DAMPING = 0, 1, 2


class DynamicContact(Protocol):
    """What the engine asks of a contact.

    Its histories hold "depth" (1,), the deepest point's [m], and "spent" (3,), see `account`.
    """

    name: str
    totals: np.ndarray  # (TOTALS,), see the indices above; of the last `add_forces`
    deeper: bool  # whether it met a point that is deeper than `allow` noted for it

    def start(self, x: np.ndarray) -> History:
        """History of a contact that begins at positions `x` [m]."""
        ...

    def prepare(self, x: np.ndarray, history: History, travel: float) -> bool:
        """Search again if motion asks for it; `travel` [m] bounds a node's way since the last.

        Returns whether the step has to be chosen anew for it: `add_rates` knows of what was near
        before.
        """
        ...

    def add_forces(
        self,
        x: np.ndarray,
        v: np.ndarray,
        history: History,
        elastic: np.ndarray,
        dissipative: np.ndarray,
    ) -> None:
        """Add external forces [N] of shape (node_count, 3); fills `totals`."""
        ...

    def near_travel(self, v: np.ndarray, history: History, dt: float, travel: float) -> float:
        """How far what is near comes nearer in `dt` [s]; `travel` [m] is the fastest node's way."""
        ...

    def add_rates(
        self,
        history: History,
        inverse_mass: np.ndarray,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
    ) -> None:
        """Add per node what may come to the squared highest frequency [1/s2], and damping [1/s].

        Points are taken `margin` [m] deeper than they are.
        """
        ...

    def allow(
        self,
        history: History,
        margin: float,
        springs: np.ndarray,
        dashpots: np.ndarray,
        elements: np.ndarray,
        omega: float,
    ) -> float:
        """Note how deep points may go with a step chosen for `omega` [rad/s].

        `springs` [1/s2] and `dashpots` [1/s] (node_count,) are those of all contacts, with
        `margin`, and `elements` (node_count,) the squared frequencies [1/s2] of the elements
        around. Returns a depth [m] none may exceed.
        """
        ...

    def pressing(self) -> float:
        """Normal traction of the last `add_forces`, summed over the area in touch [N]."""
        ...

    def rubbing(self) -> float:
        """Shear traction of the last `add_forces`, summed over the area in touch [N]."""
        ...

    def nodal_pressure(self, node_count: int) -> np.ndarray:
        """Normal traction of the last `add_forces`, averaged to nodes [Pa]."""
        ...

    def dropped(self, history: History) -> float:
        """What points have lost that let go of what they pressed on, since the start [J]."""
        ...

    def begin_anew(self, history: History) -> None:
        """Count what is dropped from here on."""
        ...


def account(contact: DynamicContact, history: History, dt: float) -> None:
    """Add what the last forces slid and dissipated in a step of `dt` [s] to ``history["spent"]``.

    Sliding is counted by the return mapping itself, so it is exact; the damping's power is taken
    constant over the step. The energy ledger has its own count, by the work of the forces.
    """
    totals, spent = contact.totals, history["spent"]
    if totals[AREA] > 0.0:
        spent[SLID] += totals[law_kernels.SLIDING] / totals[AREA]
    spent[BY_FRICTION] += totals[law_kernels.FRICTION_LOSS]
    spent[BY_DAMPING] += dt * totals[law_kernels.DAMPING_POWER]


# Deeper than now by this much [m], at least and at most, is the contact the stable step allows
# for. The paper's damping grows with the square of the depth: at 0.3 mm its dashpot alone asks for
# steps of 4 us, so more than the body is likely to sink in within a few steps is not allowed for
# but looked at again, which is cheap. A walking robot's steps are longer by a third with 15 um;
# what comes 25 um nearer in one step needs the larger margin. On the ground the deepest point of a
# contact is watched: others may come up to its depth unseen until the next search or interval.
# Between faces each point has a depth of its own (`DynamicContact.allow`).
LEAST_MARGIN, RATE_MARGIN = 1.5e-5, 5e-5


def rate_margin(travel: float) -> float:
    """How much deeper than now [m] to allow for where what is near goes `travel` [m] in a step."""
    return min(max(2.0 * travel, LEAST_MARGIN), RATE_MARGIN)
