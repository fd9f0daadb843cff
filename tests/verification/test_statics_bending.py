"""Large bending of a slender cantilever under a dead end force against the elastica.

Euler's elastica: theta'' = -(F L**2 / E'I) cos(theta), theta(0) = 0, theta'(1) = 0, with arc
length over L and E' = E/(1 - nu**2) in plane strain (S. P. Timoshenko & J. M. Gere, Theory of
Elastic Stability, 1961, section 2.7). The beam is 20 times longer than thick, so that shear and
stretching (of order (h/L)**2 = 0.25 %) stay below the discretisation.

What limits a fully integrated linear element here is parasitic shear: bending it to a curvature
k leaves a shear strain k x over its length a, whose energy stiffens the beam by about
G a**2 / (E' t**2) (t the beam's thickness, E' = 4 G when incompressible): 6 % with square
elements, two through the thickness, and 100 % at four times longer elements.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp
from statics_helpers import error, grid, hold, solid, solve

from flexapod.fem.loads import Displacement, surface_force
from flexapod.fem.newton import NewtonOptions
from flexapod.materials.neo_hooke import NeoHooke

LENGTH, THICK, WIDE = 20.0, 1.0, 0.5  # [m]
SHEAR = 1e5  # [Pa]


def elastica(load: float) -> tuple[float, float]:
    """Tip (x, y) over the length at load F L**2 / EI."""
    s = np.linspace(0.0, 1.0, 201)
    guess = 0.3 * load * np.array([s - 0.5 * s**2, 1.0 - s])
    result = solve_bvp(
        lambda s, y: np.array([y[1], -load * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        s,
        guess,
        tol=1e-10,
    )
    assert result.success
    x = quad(lambda t: np.cos(result.sol(t)[0]), 0.0, 1.0, epsrel=1e-10)[0]
    y = quad(lambda t: np.sin(result.sol(t)[0]), 0.0, 1.0, epsrel=1e-10)[0]
    return float(x), float(y)


def test_elastica_itself_against_tables() -> None:
    # K. E. Bisshopp & D. C. Drucker 1945: F L**2/EI = 1 gives deflection 0.302 and x 0.944 of L;
    # 2 gives 0.494 and 0.839. Tolerance: their three digits.
    np.testing.assert_allclose(elastica(1.0), (0.9436, 0.3017), atol=5e-4)
    np.testing.assert_allclose(elastica(2.0), (0.8394, 0.4935), atol=5e-4)


def _tip(along: int, through: int, poisson: float, load: float) -> tuple[float, float]:
    mesh = grid((along, through, 1), lambda t: t * [LENGTH, THICK, WIDE])
    body = solid(mesh, NeoHooke(SHEAR), poisson)
    stiffness = 2.0 * SHEAR / (1.0 - poisson) * THICK**3 / 12.0 * WIDE  # E' = 2 G / (1 - nu)
    force = load * stiffness / LENGTH**2
    # The end section stays plane but may grow thicker.
    middle = np.argmin(np.linalg.norm(mesh.nodes - [0.0, 0.5 * THICK, 0.0], axis=1))
    supports = hold(mesh, x0="x", z0="z", z1="z")
    supports.append(Displacement("middle", np.array([middle]), 1))
    end = surface_force("F", mesh.nodes, mesh.facet_groups["x1"], (0.0, force, 0.0))
    # At small loads round-off of the bulk modulus (5000 G) forbids a residual of 1e-9.
    options = NewtonOptions(residual_tolerance=1e-6, increment_tolerance=1e-8)
    u, _ = solve(body, supports, [end], first=0.25, newton=options)
    tip = (mesh.nodes + u)[mesh.facet_nodes("x1")].mean(axis=0)
    return float(tip[0]) / LENGTH, float(tip[1] - 0.5 * THICK) / LENGTH


@pytest.mark.parametrize(
    ("poisson", "baseline"), [(0.4999, (3.1e-2, 4.4e-3, 2.6e-3)), (0.3, (2.5e-2, 3.6e-3, 1.9e-3))]
)
def test_square_elements_follow_the_elastica(
    poisson: float, baseline: tuple[float, float, float]
) -> None:
    x, y = elastica(2.0)
    tips = [_tip(20 * n, n, poisson, 2.0) for n in (2, 4, 8)]
    errors = [error(t[1], y, "L", f"{n} through") for t, n in zip(tips, (2, 4, 8), strict=True)]
    # Discretisation: measured, with a margin of a tenth.
    assert np.all(np.array(errors) < 1.1 * np.array(baseline))
    assert abs(tips[2][0] - x) < 0.01
    # The deflection converges with second order (ratio 4; measured 3.84, 3.87) to the elastica
    # within the beam theory's own (h/L)**2; measured 3.7e-3 and 4.8e-3: shear and the clamp.
    ratio = (tips[1][1] - tips[0][1]) / (tips[2][1] - tips[1][1])
    limit = tips[2][1] + (tips[2][1] - tips[1][1]) / 3.0
    print(f"ratio {ratio:.2f}")
    assert ratio > 3.5
    assert error(limit, y, "L", "extrapolated") < 6e-3


def test_incompressibility_alone_does_not_lock_bending() -> None:
    # Volumetric locking would make nu = 0.4999 far stiffer than nu = 0.3 on the same mesh.
    _, y = elastica(2.0)
    assert _tip(40, 2, 0.4999, 2.0)[1] > 0.93 * y
    assert _tip(40, 2, 0.499, 2.0)[1] > 0.93 * y


def test_parasitic_shear_of_long_elements_is_the_known_one() -> None:
    # Two elements through the thickness, `a` long: stiffness 1 + G a**2/(E' t**2), seen at a
    # small load where the deflection is F L**3 / (3 E'I). An element a whole thickness long is
    # a quarter stiffer, one two thicknesses long (aspect ratio 4) twice as stiff.
    _, y = elastica(0.05)
    for along, long in ((40, 0.5), (20, 1.0), (10, 2.0)):
        expected = y / (1.0 + 0.25 * long**2)
        # Measured 0.3 % off this formula at each; margin 3.
        assert error(_tip(along, 2, 0.4999, 0.05)[1], expected, "L", f"{long} t long") < 0.01


@pytest.mark.xfail(
    reason="parasitic shear: 39 % too little deflection; an assumed shear strain would cure it"
)
def test_long_elements_bend_freely() -> None:
    # What an element free of shear locking does with aspect ratio 4, two through the thickness.
    assert error(_tip(10, 2, 0.4999, 2.0)[1], elastica(2.0)[1], "L", "aspect 4") < 0.05
