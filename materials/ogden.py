"""Ogden's law in the ``mu/alpha`` convention of the papers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import InputError, check_finite
from flexapod.materials.law import LawParameters


@dataclass(frozen=True)
class Ogden:
    """Ogden's law with any number of terms.

    Convention (SoSpider paper, equation 1)::

        W = sum_i mu_i/alpha_i (l1**alpha_i + l2**alpha_i + l3**alpha_i - 3)     [J/m3]
        G = 1/2 sum_i mu_i alpha_i,    E = 3 G

    with isochoric principal stretches ``l``. Abaqus, CalculiX and FElupe write
    ``2 mu_i/alpha_i**2`` instead, where ``G = sum_i mu_i``: convert with
    `from_two_mu_over_alpha_squared`.

    Range: rubber-like solids up to the stretches the coefficients were fitted on, and no further
    than `flexapod.materials.stability.stable_range` says. Leaves out rate, damage (Mullins) and
    temperature.

    Source: R. W. Ogden, Proc. R. Soc. Lond. A 326 (1972) 565, doi:10.1098/rspa.1972.0026.
    """

    mu: tuple[float, ...]  # moduli [Pa], may be negative
    alpha: tuple[float, ...]  # exponents [-], not 0, may be negative or broken

    def __post_init__(self) -> None:
        object.__setattr__(self, "mu", tuple(float(v) for v in self.mu))
        object.__setattr__(self, "alpha", tuple(float(v) for v in self.alpha))
        if len(self.mu) != len(self.alpha) or not self.mu:
            raise InputError(
                "ogden needs as many mu as alpha and at least one of each, got "
                f"{len(self.mu)} mu and {len(self.alpha)} alpha",
                "ogden",
            )
        for i, (mu, alpha) in enumerate(zip(self.mu, self.alpha, strict=True), start=1):
            check_finite(f"mu[{i}]", mu, "Pa", "ogden")
            check_finite(f"alpha[{i}]", alpha, "", "ogden")
            if alpha == 0.0:
                raise InputError(f"alpha[{i}] must not be 0 (mu/alpha): drop the term", "ogden")

    @property
    def name(self) -> str:
        """Name in case files."""
        return "ogden"

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus ``1/2 sum mu_i alpha_i`` [Pa]."""
        return 0.5 * float(np.dot(self.mu, self.alpha))

    def parameters(self) -> LawParameters:
        """Return the arrays the kernels take."""
        return LawParameters(np.array(self.mu), np.array(self.alpha), np.zeros(3))

    def coefficients(self) -> dict[str, list[float]]:
        """Coefficients in the words of case files, SI: see `registry.make_law`."""
        return {"mu": list(self.mu), "alpha": list(self.alpha)}

    @classmethod
    def from_two_mu_over_alpha_squared(cls, mu: Sequence[float], alpha: Sequence[float]) -> Ogden:
        """Take coefficients of ``W = sum 2 mu_i/alpha_i**2 (...)`` (Abaqus, CalculiX, FElupe).

        ``mu_here/alpha = 2 mu_there/alpha**2``, so ``mu_here = 2 mu_there/alpha``.
        """
        if len(mu) != len(alpha) or any(a == 0.0 for a in alpha):
            raise InputError("needs as many mu as alpha, and no alpha of 0", "ogden")
        return cls(tuple(2.0 * m / a for m, a in zip(mu, alpha, strict=True)), tuple(alpha))

    def to_two_mu_over_alpha_squared(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return ``(mu, alpha)`` for codes that write ``2 mu_i/alpha_i**2``; sum(mu) is G."""
        mu = tuple(0.5 * m * a for m, a in zip(self.mu, self.alpha, strict=True))
        return mu, self.alpha
