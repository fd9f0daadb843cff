"""Arrays and times of one run, which its state does not hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from flexapod.dynamics import kernels
from flexapod.dynamics.model import Model
from flexapod.fem import kernels as fem_kernels

# Parts of a run's time, see `Clock`. Contact's share of the stable step counts with that.
ELEMENTS, BRANCHES, PRESSURES = "element_forces", "viscous_forces", "pressure"
SEARCH, CONTACT, BONDS, LINES = "contact_search", "contact_forces", "bonds", "lines"
JOINTS = "joints"
KICK, DRIFT, STABLE, OUTPUT, REST = "kick", "drift", "stable_step", "output", "rest"
PARTS = (
    ELEMENTS,
    BRANCHES,
    PRESSURES,
    SEARCH,
    CONTACT,
    BONDS,
    LINES,
    JOINTS,
    KICK,
    DRIFT,
    STABLE,
    OUTPUT,
    REST,
)


@dataclass
class Clock:
    """Seconds spent per part of a run: each lap counts for the part that ends with it.

    So the parts add up to the whole. A lap costs a tenth of a microsecond, a step about ten laps.
    """

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PARTS, 0.0))

    def __post_init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Begin a lap; what went by since the last one counts for nothing."""
        self._last = perf_counter()

    def lap(self, part: str) -> None:
        """Count the time since the last lap for `part`."""
        now = perf_counter()
        self.seconds[part] += now - self._last
        self._last = now

    def total(self) -> float:
        """Of all parts [s]."""
        return sum(self.seconds.values())

    def shares(self) -> dict[str, float]:
        """Fractions of the total of the parts that took any time."""
        total = self.total()
        return {part: spent / total for part, spent in self.seconds.items() if spent > 0.0}


class Workspace:
    """Arrays of one run, written anew in every step: none of their size is allocated in it."""

    def __init__(self, model: Model) -> None:
        shape = model.nodes.shape
        self.internal = np.zeros(shape)
        self.pressure = np.zeros(shape)
        self.elastic = np.zeros(shape)
        self.dissipative = np.zeros(shape)
        self.total = np.zeros(shape)
        self.shifted = np.zeros(shape)
        self.face_force = np.zeros((model.faces.shape[0], 4, 3))
        self.viscous = np.zeros(shape)
        self.parts = np.zeros((kernels.PARTS, 7))
        self.sums = np.zeros(7)
        self.load = np.zeros((len(model.rigid.names), 6))
        self.rigid_energy = np.zeros(2)
        self.rigid_before = np.zeros((len(model.rigid.names), 3))
        self.owned_before = np.zeros((model.owned.size, 3))
        self.chamber_pressure = np.zeros(len(model.chambers))
        self.chamber_volume = np.zeros(len(model.chambers))
        self.bond_totals = np.zeros((len(model.bonds), 5))
        self.strain_energy = 0.0
        self.line_energy = 0.0
        self.joint_energy = 0.0  # of springs
        self.rotor_energy = 0.0  # of motion
        self.joint_spent = np.zeros(3)
        self.kinetic = 0.0
        self.unforeseen = False  # whether the last forces met contact the step does not allow for
        self.touched = False  # whether contact makes the step shorter, see `stable.TOUCHED`
        self.margins: list[float] = []  # depth the step allows for beyond each contact's own [m]
        self.rates = np.zeros(model.soft_cells.size)
        self.elements = np.zeros(model.soft_cells.size)
        self.node_elements = np.zeros(shape[0])
        self.springs = np.zeros(shape[0])
        self.dashpots = np.zeros(shape[0])
        # Reciprocals are fixed until mass is scaled; rigid nodes have their share.
        self.inverse_mass = model.inverse_mass()
        # Neither the stiffness of a joint nor the inertia of what it holds changes on the way.
        self.joint_rates = None
        if model.joints is not None:
            self.joint_rates = model.joints.rates(len(model.rigid.names))
        self.tangents = np.empty((0, fem_kernels.PAIR_COUNT, 3, 3))
        self.cell_pressure = np.zeros(model.soft_cells.size)
        self.clock = Clock()
