"""What a hyperelastic law offers, and a solid material built on one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from flexapod.core.errors import InputError, check_positive
from flexapod.materials.prony import Prony


class LawParameters(NamedTuple):
    """A law as the kernels of `flexapod.materials.kernels` take it."""

    mu: np.ndarray  # Ogden moduli, mu/alpha convention [Pa], shape (term_count,)
    alpha: np.ndarray  # Ogden exponents [-], shape (term_count,)
    c: np.ndarray  # Yeoh moduli c_1..c_3 [Pa], shape (3,)


@runtime_checkable
class HyperelasticLaw(Protocol):
    """An incompressible hyperelastic law given by its isochoric energy."""

    @property
    def name(self) -> str:
        """The model's name in case files: ogden, neo-hooke, mooney-rivlin or yeoh."""
        ...

    def parameters(self) -> LawParameters:
        """Return the arrays the kernels take."""
        ...

    def coefficients(self) -> dict[str, list[float]]:
        """Return the coefficients in the words of case files (mu, alpha, c), SI."""
        ...

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus G [Pa]."""
        ...


@dataclass(frozen=True)
class SolidMaterial:
    """A law made nearly incompressible, with a density.

    The bulk modulus follows from the small-strain relation
    ``kappa = 2 G (1 + nu) / (3 (1 - 2 nu))``.
    """

    law: HyperelasticLaw
    density: float  # [kg/m3]
    poisson: float = 0.499  # [-]; at 0.5 the volumetric term would be infinite
    name: str = "material"
    prony: Prony | None = None  # viscous branches, felt in motion only; None: purely elastic

    def __post_init__(self) -> None:
        check_positive("density", self.density, "kg/m3", self.name)
        if not 0.0 < self.poisson < 0.49999:
            raise InputError(
                f"poisson must lie in (0, 0.49999), got {self.poisson:g}: the volumetric term "
                "stands for near-incompressibility, 0.499 is the default",
                self.name,
            )
        check_positive("shear modulus of the law", self.law.shear_modulus, "Pa", self.name)

    @property
    def bulk_modulus(self) -> float:
        """Small-strain bulk modulus kappa [Pa]."""
        nu = self.poisson
        return 2.0 * self.law.shear_modulus * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu))
