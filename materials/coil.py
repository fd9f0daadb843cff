"""A coil of shape-memory alloy: a passive element with history, and an active contracting force.

Source: Y. Sugiyama, S. Hirai, Crawling and jumping of deformable soft robot, Proc. IEEE/RSJ Int.
Conf. Intelligent Robots and Systems (2004). Passive: the three-element model with slider of
equations 1 to 4. Active, equation 5, with the voltage V either on or off:

    F' = D_on    while V is on and F < F_max
    F' = -D_off  while V is off and F > 0,       F' = 0 otherwise

Numbers: the source's for coils BMX100, found by experiment (after equation 5).

Left out: temperature and current (the rates stand for heating and cooling in still air), and that
a hot coil is stiffer than a cold one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from flexapod.core.errors import InputError, check_positive
from flexapod.materials.rheology import ThreeElementSlider
from flexapod.materials.rheology_kernels import active_force

BMX100 = ThreeElementSlider(stiffness=50.0, damping=0.1, flow_damping=10.0, limit=0.016)


@dataclass(frozen=True)
class ShapeMemoryCoil:
    """Passive element and active force of one coil; the whole tension is the sum of both.

    Attributes
    ----------
    passive
        The element that bears what the shell pulls; elongation counts from the unloaded length.
    rate_on
        D_on [N/s], > 0.
    rate_off
        D_off [N/s], > 0.
    largest
        F_max [N], >= 0; zero is a coil that never pulls by itself.
    """

    passive: ThreeElementSlider = BMX100
    rate_on: float = 0.15
    rate_off: float = 0.15
    largest: float = 0.15

    def __post_init__(self) -> None:
        if not isinstance(self.passive, ThreeElementSlider):
            raise InputError(
                f"passive must be a ThreeElementSlider, got {type(self.passive).__name__}; one "
                "with an infinite limit is a Voigt element",
                "coil",
            )
        check_positive("rate_on", self.rate_on, "N/s", "coil")
        check_positive("rate_off", self.rate_off, "N/s", "coil")
        if not (np.isfinite(self.largest) and self.largest >= 0.0):
            raise InputError(f"largest must be finite and >= 0, got {self.largest:g} N", "coil")

    def active(self, times: ArrayLike, on: ArrayLike, force: float = 0.0) -> np.ndarray:
        """Active force [N] at `times` [s] from `force` at the first, shape (n,).

        Each of `on`, shape (n,) bool, holds until the next time; the last is not read.
        """
        t = np.asarray(times, dtype=float)
        switch = np.asarray(on, dtype=bool)
        if t.ndim != 1 or t.shape != switch.shape:
            raise InputError(f"times {t.shape} and on {switch.shape} must have one length", "coil")
        if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all()):
            raise InputError("times must be finite and ascending", "coil")
        if not 0.0 <= force <= self.largest:
            raise InputError(
                f"force must lie between 0 and largest ({self.largest:g} N), got {force:g} N",
                "coil",
            )
        result = np.empty(t.shape)
        for i in range(t.size):
            if i > 0:
                force = active_force(
                    force,
                    bool(switch[i - 1]),
                    self.rate_on,
                    self.rate_off,
                    self.largest,
                    t[i] - t[i - 1],
                )
            result[i] = force
        return result
