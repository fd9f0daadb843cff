"""The neo-Hookean law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import check_positive
from flexapod.materials.law import LawParameters


@dataclass(frozen=True)
class NeoHooke:
    """Neo-Hookean law, ``W = G/2 (l1**2 + l2**2 + l3**2 - 3)`` with isochoric stretches.

    Range: rubbers to stretches of about 1.5; also stands in for stiff linear materials at small
    strain (``G = E / (2 (1 + nu))``). Stable at every stretch.

    Source: L. R. G. Treloar, Trans. Faraday Soc. 39 (1943) 36, doi:10.1039/TF9433900036;
    R. S. Rivlin, Phil. Trans. R. Soc. Lond. A 240 (1948) 459, doi:10.1098/rsta.1948.0002.
    """

    shear: float  # shear modulus G [Pa], > 0

    def __post_init__(self) -> None:
        check_positive("shear modulus", self.shear, "Pa", "neo-hooke")

    @property
    def name(self) -> str:
        """Name in case files."""
        return "neo-hooke"

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G [Pa]."""
        return self.shear

    def parameters(self) -> LawParameters:
        """Return the arrays the kernels take: one Ogden term, mu = G, alpha = 2."""
        return LawParameters(np.array([self.shear]), np.array([2.0]), np.zeros(3))

    def coefficients(self) -> dict[str, list[float]]:
        """Coefficients in the words of case files, SI: see `registry.make_law`."""
        return {"mu": [self.shear]}

    @classmethod
    def from_youngs_modulus(cls, youngs_modulus: float, poisson: float) -> NeoHooke:
        """Return the law of a linear material of Young's modulus [Pa] and Poisson's ratio."""
        check_positive("youngs_modulus", youngs_modulus, "Pa", "neo-hooke")
        return cls(youngs_modulus / (2.0 * (1.0 + poisson)))
