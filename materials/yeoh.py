"""Yeoh's law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import check_finite
from flexapod.materials.law import LawParameters


@dataclass(frozen=True)
class Yeoh:
    """Yeoh's law, ``W = c1 (I1 - 3) + c2 (I1 - 3)**2 + c3 (I1 - 3)**3``, isochoric I1.

    ``G = 2 c1``. Range: filled rubbers at moderate to large stretches. Depends on I1 alone, so a
    uniaxial test settles it in every mode, for better or worse (equibiaxial stress is usually
    too low).

    Source: O. H. Yeoh, Rubber Chem. Technol. 66 (1993) 754, doi:10.5254/1.3538343.
    """

    c1: float  # [Pa]
    c2: float = 0.0  # [Pa]
    c3: float = 0.0  # [Pa]

    def __post_init__(self) -> None:
        for name in ("c1", "c2", "c3"):
            check_finite(name, getattr(self, name), "Pa", "yeoh")

    @property
    def name(self) -> str:
        """Name in case files."""
        return "yeoh"

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus ``2 c1`` [Pa]."""
        return 2.0 * self.c1

    def parameters(self) -> LawParameters:
        """Return the arrays the kernels take: no Ogden terms, three Yeoh moduli."""
        return LawParameters(np.empty(0), np.empty(0), np.array([self.c1, self.c2, self.c3]))

    def coefficients(self) -> dict[str, list[float]]:
        """Coefficients in the words of case files, SI: see `registry.make_law`."""
        return {"c": [self.c1, self.c2, self.c3]}
