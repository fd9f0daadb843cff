"""The two-term Mooney-Rivlin law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import check_finite
from flexapod.materials.law import LawParameters


@dataclass(frozen=True)
class MooneyRivlin:
    """Mooney-Rivlin law, ``W = c10 (I1 - 3) + c01 (I2 - 3)`` with isochoric invariants.

    ``G = 2 (c10 + c01)``. Range: rubbers to stretches of about 2 in tension. A negative c01
    (common in fits to tension alone) makes biaxial modes unstable: see
    `flexapod.materials.stability`.

    Source: M. Mooney, J. Appl. Phys. 11 (1940) 582, doi:10.1063/1.1712836; R. S. Rivlin, Phil.
    Trans. R. Soc. Lond. A 241 (1948) 379, doi:10.1098/rsta.1948.0024.
    """

    c10: float  # [Pa]
    c01: float  # [Pa]

    def __post_init__(self) -> None:
        check_finite("c10", self.c10, "Pa", "mooney-rivlin")
        check_finite("c01", self.c01, "Pa", "mooney-rivlin")

    @property
    def name(self) -> str:
        """Name in case files."""
        return "mooney-rivlin"

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus ``2 (c10 + c01)`` [Pa]."""
        return 2.0 * (self.c10 + self.c01)

    def parameters(self) -> LawParameters:
        """Return the arrays the kernels take.

        ``I2 = l1**-2 + l2**-2 + l3**-2`` for isochoric stretches, so the law is Ogden's with
        alpha = (2, -2) and mu/alpha = (c10, c01).
        """
        mu = np.array([2.0 * self.c10, -2.0 * self.c01])
        return LawParameters(mu, np.array([2.0, -2.0]), np.zeros(3))

    def coefficients(self) -> dict[str, list[float]]:
        """Coefficients in the words of case files, SI: see `registry.make_law`."""
        return {"c": [self.c10, self.c01]}
