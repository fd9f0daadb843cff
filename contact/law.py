"""The normal and tangential contact laws, shared by statics and dynamics.

Normal force of one contact (SoSpider paper, equation 4):

    F_N = k d**m1 + c sign(d') |d'|**m2 d**m3          (never below zero)

with penetration d, and the Hertz stiffness of equations 5 to 7,

    k = sqrt(16 R E_k**2 / 9),  R = R1 R2 / (R1 + R2),
    E_k = E1 E2 / (E2 (1 - nu1**2) + E1 (1 - nu2**2)).

The paper takes k from Hertz (exponent 3/2, N/mm**1.5) and uses it with m1 = 2 in millimetres.
Written without that hidden unit, F_N = k d0**1.5 (d/d0)**m1 with d0 = 1 mm: the paper's numbers
at any m1, and Hertz's law itself at m1 = 3/2 for every d0.

A contact *point* of the paper's multibody code has no area. So that a result does not depend on
where points fall, the law is applied as a traction F_N / A0 with a reference area A0, the area
one such point stands for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexapod.core.errors import InputError, check_positive


def effective_modulus(young_1: float, poisson_1: float, young_2: float, poisson_2: float) -> float:
    """E_k of equation 7 [Pa]; `young_2` may be infinite (a rigid partner)."""
    flexibility = (1.0 - poisson_1**2) / young_1 + (1.0 - poisson_2**2) / young_2
    return 1.0 / flexibility


def hertz_stiffness(
    young_1: float,
    poisson_1: float,
    young_2: float,
    poisson_2: float,
    radius_1: float,
    radius_2: float = math.inf,
) -> float:
    """k of equation 5 [N/m**1.5]; `radius_2` may be infinite (a plane)."""
    radius = 1.0 / (1.0 / radius_1 + 1.0 / radius_2)
    return math.sqrt(16.0 * radius / 9.0) * effective_modulus(
        young_1, poisson_1, young_2, poisson_2
    )


@dataclass(frozen=True)
class ContactLaw:
    """The paper's contact law as a traction over a reference area.

    Attributes
    ----------
    stiffness
        k [N/m**1.5] of `hertz_stiffness`.
    stiffness_exponent
        m1; the paper's default is 2.
    damping_ratio
        c/k [(s/m)**m2] in ``k d0**1.5 (d/d0)**m3 c/k |d'|**m2``, the damping force of a point.
        The paper's c = k/1e4 counts in millimetres, F = k d**2 + c d' d**2 with d' in mm/s, so
        c/k = 1e-4 s/mm: 0.1 s/m at m2 = 1, and 1e-4 (1e3)**m2 (s/m)**m2 at another m2. d0 takes
        the millimetres out of d**m3 for every m3. Statics leaves damping out.
    damping_exponent, indentation_exponent
        m2 and m3; the paper's defaults are 1 and 2.
    reference_penetration
        d0 [m]: the paper computes in millimetres, so 1 mm.
    reference_area
        A0 [m2], assumed: (3 mm)**2, the middle of the paper's element sizes of 0.75 to 5 mm,
        since each surface node or patch of its code is one contact.
    friction
        Coulomb coefficient [-]; 0 between chambers in the paper.
    stick_stiffness
        Tangential traction per slip before sliding [Pa/m]; a regularisation, chosen so that
        sliding begins after less than a tenth of a millimetre at a contact pressure of 1 kPa.
    """

    stiffness: float
    stiffness_exponent: float = 2.0
    damping_ratio: float = 0.1
    damping_exponent: float = 1.0
    indentation_exponent: float = 2.0
    reference_penetration: float = 1e-3
    reference_area: float = 9e-6
    friction: float = 0.0
    stick_stiffness: float = 1e7

    def __post_init__(self) -> None:
        check_positive("contact stiffness", self.stiffness, "N/m^1.5")
        check_positive("reference_penetration", self.reference_penetration, "m")
        check_positive("reference_area", self.reference_area, "m2")
        check_positive("stick_stiffness", self.stick_stiffness, "Pa/m")
        if not 1.0 <= self.stiffness_exponent <= 4.0:
            raise InputError(
                f"stiffness_exponent (m1) must lie in [1, 4], got {self.stiffness_exponent:g}"
            )
        if not 0.0 <= self.friction < 10.0:
            raise InputError(f"friction must be >= 0, got {self.friction:g}")

    def normal_force(self, penetration: float) -> float:
        """Force of one contact point [N] at `penetration` [m]; zero when apart."""
        if penetration <= 0.0:
            return 0.0
        d0 = self.reference_penetration
        ratio = penetration / d0
        return self.stiffness * d0**1.5 * ratio**self.stiffness_exponent

    @property
    def traction_coefficient(self) -> float:
        """B in ``traction = B d**m1`` [Pa/m**m1]."""
        d0 = self.reference_penetration
        return self.stiffness * d0 ** (1.5 - self.stiffness_exponent) / self.reference_area

    @property
    def damping_coefficient(self) -> float:
        """D in ``traction = D |d'|**m2 d**m3`` [Pa (s/m)**m2 / m**m3]."""
        d0 = self.reference_penetration
        scale = d0 ** (1.5 - self.indentation_exponent) / self.reference_area
        return self.stiffness * self.damping_ratio * scale


@dataclass(frozen=True)
class FrictionLaw:
    """Coulomb friction whose coefficient falls with the speed of sliding (paper, equation 8).

    ``|F_T| = mu(v) |F_N|``: mu is `static` up to `static_speed`, falls as a cubic step to
    `dynamic` at `dynamic_speed` and is constant above.

    Attributes
    ----------
    static, dynamic
        Coefficients at rest and in motion [-].
    static_speed, dynamic_speed
        Tangential speeds between which mu falls [m/s]. The paper names none, so the defaults are
        those of the program it used: RecurDyn's 1 mm/s and 1.5 mm/s (FunctionBay, technical tip
        451, "Threshold Velocity").
    """

    static: float
    dynamic: float
    static_speed: float = 1e-3
    dynamic_speed: float = 1.5e-3

    def __post_init__(self) -> None:
        if not 0.0 <= self.dynamic <= self.static < 10.0:
            raise InputError(
                "friction must satisfy 0 <= dynamic <= static < 10, got "
                f"dynamic {self.dynamic:g} and static {self.static:g}"
            )
        check_positive("static_speed", self.static_speed, "m/s")
        check_positive("dynamic_speed", self.dynamic_speed, "m/s")
        if not self.static_speed < self.dynamic_speed:
            raise InputError(
                f"dynamic_speed must exceed static_speed, got {self.dynamic_speed:g} m/s "
                f"and {self.static_speed:g} m/s"
            )

    @classmethod
    def constant(cls, mu: float) -> FrictionLaw:
        """Friction with one coefficient at all speeds."""
        return cls(mu, mu)

    def coefficient(self, speed: float) -> float:
        """mu [-] at the tangential `speed` >= 0 [m/s]."""
        if speed <= self.static_speed:
            return self.static
        if speed >= self.dynamic_speed:
            return self.dynamic
        a = (speed - self.static_speed) / (self.dynamic_speed - self.static_speed)
        return self.static + (self.dynamic - self.static) * a * a * (3.0 - 2.0 * a)
