"""Ground contact: shapes against geometry, forces by hand, motion against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexapod.contact import ground_kernels
from flexapod.contact.ground import Ground, HeightField, Plane, Step, slope
from flexapod.contact.kernels import POINTS, plane_contact, point_areas, point_positions
from flexapod.contact.law import FrictionLaw
from flexapod.contact.law_kernels import TOTALS, friction_coefficient
from flexapod.core.errors import InputError

GRAVITY = 9.81
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
FACE = np.array([[0, 1, 2, 3]])


@dataclass
class _Faces:
    """One set of faces, a ground, and what the kernel keeps and writes for them."""

    ground: Ground
    x: np.ndarray
    faces: np.ndarray = field(default_factory=lambda: FACE)
    coefficient: float = 1e9
    exponent: float = 2.0
    damping: float = 0.0
    damping_exponent: float = 1.0
    indentation_exponent: float = 2.0
    stick: float = 1e7

    def __post_init__(self) -> None:
        count = len(self.faces)
        self.packed = self.ground.packed()
        self.v = np.zeros_like(self.x)
        self.active = np.arange(count)
        self.areas = np.empty((count, 4))
        point_areas(self.x, self.faces, POINTS, self.areas)
        self.anchor = np.full((count, 4, 3), math.nan)
        self.pressure = np.full((count, 4), math.nan)
        self.shear = np.full((count, 4), math.nan)
        self.totals = np.full(TOTALS, math.nan)

    def evaluate(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the elastic and the dissipative external force (N, 3)."""
        force = np.zeros_like(self.x)
        dissipative = np.zeros_like(self.x)
        law = self.ground.friction
        ground_kernels.ground_contact(
            self.x, self.v, self.faces, self.active, POINTS, self.areas, *self.packed,
            self.coefficient, self.exponent, self.damping, self.damping_exponent,
            self.indentation_exponent, law.static, law.dynamic, law.static_speed,
            law.dynamic_speed, self.stick, self.anchor, force, dissipative, self.pressure,
            self.shear, self.totals,
        )  # fmt: skip
        return force, dissipative

    def march(
        self,
        mass: float,
        gravity: Callable[[float], np.ndarray],
        dt: float,
        count: int,
        watch: Callable[[float], None],
    ) -> None:
        """Leapfrog with the mass [kg] in equal parts on the nodes; the first kick is a half."""
        for step in range(count):
            force, dissipative = self.evaluate()
            h = 0.5 * dt if step == 0 else dt
            self.v += h * ((force + dissipative) / (mass / len(self.x)) + gravity(step * dt))
            self.x += dt * self.v
            watch((step + 1) * dt)


def _gap(ground: Ground, p: Any) -> tuple[float, np.ndarray]:
    normal = np.full(3, math.nan)
    gap = ground_kernels.gap_and_normal(*ground.packed(), np.asarray(p, dtype=float), normal)
    return gap, normal


# ---- shapes -----------------------------------------------------------------------------------


def test_friction_coefficient_is_the_laws() -> None:
    law = FrictionLaw(0.8, 0.5, 0.01, 0.03)
    for speed in (0.0, 0.01, 0.0100001, 0.013, 0.02, 0.0299, 0.03, 5.0):
        inlined = friction_coefficient(speed, 0.8, 0.5, 0.01, 0.03)
        # Round-off of fused multiply-adds.
        assert inlined == pytest.approx(law.coefficient(speed), rel=1e-15)


def test_plane_distance() -> None:
    plane = Plane((1.0, 2.0, 3.0), (0.0, 3.0, 4.0))
    gap, normal = _gap(plane, [7.0, 2.0 + 3.0, 3.0 + 4.0])
    assert gap == pytest.approx(5.0, rel=1e-15)
    np.testing.assert_allclose(normal, [0.0, 0.6, 0.8], rtol=1e-15)
    assert _gap(plane, [0.0, 2.0 - 3.0, 3.0 - 4.0])[0] == pytest.approx(-5.0, rel=1e-15)


def test_slope_falls_along_x() -> None:
    angle = 0.3
    plane = slope(angle, (1.0, 0.0, 2.0))
    # A point further along +x on the slope lies lower, by tan(angle).
    assert _gap(plane, [3.0, 5.0, 2.0 - 2.0 * math.tan(angle)])[0] == pytest.approx(0.0, abs=1e-15)
    # Gravity along the plane points to +x.
    normal = np.array(plane.normal)
    weight = np.array([0.0, 0.0, -1.0])
    assert (weight - (weight @ normal) * normal)[0] > 0.0


R2 = math.sqrt(0.5)
STEP = Step(2.0, 0.5)


@pytest.mark.parametrize(
    ("p", "gap", "normal"),
    [
        ((0.0, 9.0, 0.3), 0.3, (0.0, 0.0, 1.0)),  # above the floor
        ((0.0, 9.0, -0.3), -0.3, (0.0, 0.0, 1.0)),  # below the floor
        ((1.9, 9.0, 0.3), 0.1, (-1.0, 0.0, 0.0)),  # before the riser
        ((2.1, 9.0, 0.3), -0.1, (-1.0, 0.0, 0.0)),  # behind it
        ((3.0, 9.0, 0.9), 0.4, (0.0, 0.0, 1.0)),  # above the top
        ((3.0, 9.0, 0.2), -0.3, (0.0, 0.0, 1.0)),  # below it
        ((1.7, 9.0, 0.9), 0.5, (-0.6, 0.0, 0.8)),  # beyond the edge: 3, 4, 5
        ((2.3, 9.0, -0.4), -0.5, (-0.6, 0.0, 0.8)),  # in the ground under the inner corner
        ((2.0, 9.0, 0.0), 0.0, (0.0, 0.0, 1.0)),  # the inner corner itself
        ((2.0, 9.0, 0.2), 0.0, (-1.0, 0.0, 0.0)),  # on the riser
    ],
)
def test_step_distance(
    p: tuple[float, ...], gap: float, normal: tuple[float, float, float]
) -> None:
    found, direction = _gap(STEP, p)
    # Round-off of coordinates of size one.
    assert found == pytest.approx(gap, abs=1e-15)
    np.testing.assert_allclose(direction, normal, atol=1e-14)


def test_step_distance_is_the_nearest_point_of_its_surface() -> None:
    s = np.linspace(0.0, 1.0, 4001)[:, None]
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.5], [4.0, 0.5]])
    outline = np.vstack([a + s * (b - a) for a, b in pairwise(corners)])
    rng = np.random.default_rng(5)
    for x, z in rng.uniform([1.0, -0.5], [3.0, 1.0], (300, 2)):
        gap, normal = _gap(STEP, [x, 0.0, z])
        # Samples are 5e-4 apart: at most 2.5e-4 beside the nearest point.
        assert abs(gap) == pytest.approx(np.hypot(*(outline - [x, z]).T).min(), abs=2.5e-4)
        assert (gap < 0.0) == (z < 0.0 or (x > 2.0 and z < 0.5))
        assert normal @ normal == pytest.approx(1.0, rel=1e-14)
        # The way back along the normal ends on the surface.
        foot = np.array([x, 0.0, z]) - gap * normal
        assert _gap(STEP, foot)[0] == pytest.approx(0.0, abs=1e-15)


def test_height_field_of_a_plane_is_the_plane() -> None:
    a, b, c = 0.3, -0.2, 0.1
    x, y = np.meshgrid(1.0 + 0.25 * np.arange(9), -1.0 + 0.25 * np.arange(7), indexing="ij")
    hills = HeightField(1.0, -1.0, 0.25, a * x + b * y + c)
    plane = Plane((0.0, 0.0, c), (-a, -b, 1.0))
    rng = np.random.default_rng(3)
    for p in rng.uniform([1.0, -1.0, -1.0], [3.0, 0.5, 1.0], (100, 3)):
        gap, normal = _gap(plane, p)
        found, direction = _gap(hills, p)
        # Round-off, divided by the spacing in the slopes.
        assert found == pytest.approx(gap, abs=1e-14)
        np.testing.assert_allclose(direction, normal, atol=1e-14)


def test_height_field_is_bilinear_and_continues_level() -> None:
    heights = np.array([[0.0, 1.0, 4.0], [2.0, 5.0, 3.0]])
    hills = HeightField(10.0, 20.0, 2.0, heights)

    def height(x: float, y: float) -> float:
        gap, normal = _gap(hills, [x, y, 0.0])
        return -gap / normal[2]

    # Corners, the last ones too; the middle of a cell is the mean of four.
    for i in range(2):
        for j in range(3):
            assert height(10.0 + 2.0 * i, 20.0 + 2.0 * j) == pytest.approx(heights[i, j], abs=1e-14)
    assert height(11.0, 21.0) == pytest.approx(2.0, rel=1e-14)
    # At (u, w) = (1/4, 1/2) of the second cell: (1 + 4)/2 * 3/4 + (5 + 3)/2 / 4.
    assert height(10.5, 23.0) == pytest.approx(2.875, rel=1e-14)
    # Slopes there: along x ((5 - 1) + (3 - 4))/2/2, along y ((4 - 1) 3/4 + (3 - 5)/4)/2.
    normal = _gap(hills, [10.5, 23.0, 0.0])[1]
    np.testing.assert_allclose(normal[:2] / normal[2], [-0.75, -0.875], rtol=1e-13)
    # The far corner still belongs to the last cell: ((3 - 4)/2, (3 - 5)/2).
    normal = _gap(hills, [12.0, 24.0, 0.0])[1]
    np.testing.assert_allclose(normal[:2] / normal[2], [0.5, 1.0], rtol=1e-13)
    # Beside the field: the rim's height, level across the rim and still sloping along it.
    assert height(3.0, 21.0) == pytest.approx(0.5, rel=1e-14)
    assert height(99.0, 99.0) == pytest.approx(3.0, rel=1e-14)
    np.testing.assert_allclose(_gap(hills, [99.0, 99.0, 0.0])[1], [0.0, 0.0, 1.0], atol=1e-15)
    normal = _gap(hills, [3.0, 21.0, 0.0])[1]
    np.testing.assert_allclose(normal[:2] / normal[2], [0.0, -0.5], atol=1e-14)


def test_sources_of_height_fields(tmp_path: Path) -> None:
    heights = np.array([[0.0, 1.0, 4.0], [2.0, 5.0, 3.0]])
    law = FrictionLaw.constant(0.4)
    table = tmp_path / "hills.csv"
    np.savetxt(table, heights, delimiter=",")
    for hills in (
        HeightField.from_array(heights, 0.1, 1.0, 2.0, law),
        HeightField.from_csv(table, 0.1, 1.0, 2.0, law),
    ):
        np.testing.assert_array_equal(hills.heights, heights)
        assert (hills.x0, hills.y0, hills.spacing, hills.friction) == (1.0, 2.0, 0.1, law)
    # An image of 2 rows and 3 columns: x along the columns, y from the lowest row up.
    grey = np.array([[0, 51, 102], [153, 204, 255]], dtype=np.uint8)
    expected = 0.5 * np.array([[0.6, 0.0], [0.8, 0.2], [1.0, 0.4]])
    colours = np.stack([grey, grey, grey, np.zeros_like(grey)], axis=2)
    for pixels in (grey, colours, grey / 255.0, grey.astype(np.uint16) * 257):
        found = HeightField.from_image(pixels, 0.1, 0.5).heights
        np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_height_field_keeps_its_own_heights() -> None:
    heights = np.zeros((3, 3))
    hills = HeightField(0.0, 0.0, 1.0, heights)
    heights[:] = 7.0
    assert not hills.heights.any()
    with pytest.raises(ValueError, match="read-only"):
        hills.heights[0, 0] = 1.0


FLAT = np.zeros((3, 3))


@pytest.mark.parametrize(
    "build",
    [
        lambda path: Plane((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        lambda path: Plane((0.0, 0.0, 0.0), (0.0, 1.0)),  # type: ignore[arg-type]
        lambda path: Plane((0.0, math.nan, 0.0)),
        lambda path: Plane((0.0, 0.0, 0.0), (0.0, math.inf, 0.0)),
        lambda path: slope(0.5 * math.pi),
        lambda path: slope(math.nan),
        lambda path: Step(math.nan, 0.1),
        lambda path: Step(0.0, 0.0),
        lambda path: HeightField(0.0, 0.0, 0.0, FLAT),
        lambda path: HeightField(0.0, 0.0, -0.1, FLAT),
        lambda path: HeightField(math.nan, 0.0, 0.1, FLAT),
        lambda path: HeightField(0.0, math.inf, 0.1, FLAT),
        lambda path: HeightField(0.0, 0.0, 0.1, np.zeros(3)),
        lambda path: HeightField(0.0, 0.0, 0.1, np.zeros((1, 3))),
        lambda path: HeightField(0.0, 0.0, 0.1, np.zeros((2, 2, 2))),
        lambda path: HeightField(0.0, 0.0, 0.1, np.array([[0.0, 1.0], [math.nan, 2.0]])),
        lambda path: HeightField(0.0, 0.0, 0.1, np.array([["a", "b"], ["c", "d"]])),
        lambda path: HeightField.from_image(np.zeros((3, 3), dtype=np.int64), 0.1, 1.0),
        lambda path: HeightField.from_image(np.full((3, 3), 2.0), 0.1, 1.0),
        lambda path: HeightField.from_image(np.full((3, 3), math.nan), 0.1, 1.0),
        lambda path: HeightField.from_image(np.zeros((3, 3, 2)), 0.1, 1.0),
        lambda path: HeightField.from_image(np.zeros((3, 3)), 0.1, math.nan),
        lambda path: HeightField.from_image(np.full((3, 3, 3), [0.0, 1.0, 0.0]), 0.1, 1.0),
        lambda path: HeightField.from_image(np.full((3, 3, 3), [0.0, 0.0, 1.0]), 0.1, 1.0),
        lambda path: HeightField.from_csv(path / "none.csv", 0.1),
        lambda path: HeightField.from_csv(path / "words.csv", 0.1),
        lambda path: HeightField.from_csv(path / "line.csv", 0.1),
    ],
)
def test_refused_shapes(build: Callable[[Path], Ground], tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("1,2\n3,here\n")
    (tmp_path / "line.csv").write_text("1,2,3\n")
    with pytest.raises(InputError):
        build(tmp_path)


# ---- forces -----------------------------------------------------------------------------------


def _tilted(seed: int) -> np.ndarray:
    """A warped square whose points lie on both sides of the ground."""
    return SQUARE + np.random.default_rng(seed).uniform(-0.1, 0.1, (4, 3))


@pytest.mark.parametrize("exponent", [1.5, 2.0])
def test_normal_force_is_the_statics_force(exponent: float) -> None:
    plane = Plane((0.1, 0.0, 0.02), (0.2, -0.1, 1.0))
    faces = _Faces(plane, _tilted(1), exponent=exponent)
    force, dissipative = faces.evaluate()
    internal = np.zeros((4, 3))
    pressure = np.zeros((1, 4))
    trial = np.zeros((1, 4, 4))
    energy, _ = plane_contact(
        faces.x, np.full((1, 4, 4), math.nan), FACE, POINTS, faces.areas, np.array(plane.point),
        np.array(plane.normal), 1e9, exponent, 0.0, 1e7, internal, pressure, trial,
        np.zeros((4, 4), dtype=np.int64), np.zeros((4, 12, 12)), False,
    )  # fmt: skip
    assert 0 < (pressure > 0.0).sum() < 4
    # Round-off of penetrations of 1e-2 in coordinates of size one.
    np.testing.assert_allclose(force, -internal, rtol=1e-12)
    np.testing.assert_allclose(faces.pressure, pressure, rtol=1e-12)
    assert not dissipative.any() and not faces.shear.any()
    where = np.empty((1, 4, 3))
    point_positions(faces.x, FACE, POINTS, where)
    gaps = (where[0] - plane.point) @ np.array(plane.normal)
    expected = [
        energy, 0.0, faces.areas[0, gaps < 0.0].sum(), -gaps.min(),
        *force.sum(axis=0), (gaps < 0.0).sum(),
    ]  # fmt: skip
    np.testing.assert_allclose(faces.totals[:8], expected, rtol=1e-12)
    assert not faces.totals[8:].any()  # no friction, nothing slides, nothing moves


@pytest.mark.parametrize("ground", [slope(0.2), Step(0.0, 0.05)])
def test_elastic_force_is_minus_the_energys_gradient(ground: Ground) -> None:
    faces = _Faces(ground, _tilted(2))
    force, _ = faces.evaluate()
    assert faces.totals[7] >= 2.0
    step = 1e-6
    for a in range(4):
        for i in range(3):
            energies = []
            for sign in (1.0, -1.0):
                faces.x[a, i] += sign * step
                faces.evaluate()
                energies.append(faces.totals[0])
                faces.x[a, i] -= sign * step
            slope_of_energy = (energies[0] - energies[1]) / (2.0 * step)
            # Central difference: the cube of d loses (step/d)**2 ~ 1e-8 of the largest force.
            assert slope_of_energy == pytest.approx(-force[a, i], abs=1e-6 * abs(force).max())


def test_damping_pushes_in_and_never_pulls() -> None:
    depth, damping = 0.01, 3e8
    faces = _Faces(Plane(), SQUARE - [0.0, 0.0, depth], damping=damping)
    elastic = 1e9 * depth**2
    for speed in (-2.0, -0.1, 0.0, 0.1, 2.0, 10.0 / 3.0, 5.0, 1e3):
        faces.v[:] = [0.0, 0.0, speed]
        force, dissipative = faces.evaluate()
        # B d**2 + D d' d**2 with d' = -v_z; the unit square makes tractions forces.
        total = max(0.0, elastic - damping * speed * depth**2)
        # Round-off against the elastic force.
        close: dict[str, Any] = {"rel": 1e-12, "abs": 1e-12 * elastic}
        assert force[:, 2].sum() == pytest.approx(elastic, **close)
        assert dissipative[:, 2].sum() == pytest.approx(total - elastic, **close)
        np.testing.assert_allclose(faces.pressure, total, rtol=1e-12, atol=1e-12 * elastic)
        assert (force[:, 2] + dissipative[:, 2] > -1e-12 * elastic).all()
        # The energy stored is the potential of the uncut B d**2.
        assert faces.totals[0] == pytest.approx(elastic * depth / 3.0, rel=1e-12)
        # No damping acts along the plane.
        assert not force[:, :2].any() and not dissipative[:, :2].any()


def test_damping_exponents() -> None:
    faces = _Faces(
        Plane(), SQUARE - [0.0, 0.0, 0.01], damping=7e5, damping_exponent=1.5,
        indentation_exponent=1.0,
    )  # fmt: skip
    faces.v[:, 2] = -0.3
    _, dissipative = faces.evaluate()
    assert dissipative[:, 2].sum() == pytest.approx(7e5 * 0.3**1.5 * 0.01, rel=1e-12)


def test_return_mapping_by_hand() -> None:
    depth, mu, stick = 0.001, 0.5, 1e7
    plane = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), FrictionLaw.constant(mu))
    faces = _Faces(plane, SQUARE - [0.0, 0.0, depth], stick=stick)
    normal_traction = 1e9 * depth**2  # 1 kPa; area 1 m2
    reach = mu * normal_traction / stick  # sliding begins at 50 micrometres
    start = faces.x.copy()
    where = np.empty((1, 4, 3))

    def moved(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        faces.x[:] = start + [x, y, 0.0]
        _, dissipative = faces.evaluate()
        point_positions(faces.x, FACE, POINTS, where)
        # All points move alike: one vector says what the shear is and where the anchors are.
        lag = where - faces.anchor
        np.testing.assert_allclose(lag, np.broadcast_to(lag[0, 0], lag.shape), atol=1e-15)
        return dissipative.sum(axis=0), lag[0, 0]

    # Coordinates of size one hold the slip to 1e-16; times the stick stiffness, 1e-9 N.
    close: dict[str, Any] = {"rtol": 0.0, "atol": 1e-8}

    def check(pair: tuple[np.ndarray, np.ndarray], lag: tuple[float, float]) -> None:
        np.testing.assert_allclose(pair[1], [*lag, 0.0], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(pair[0], [-stick * lag[0], -stick * lag[1], 0.0], **close)
        size = stick * math.hypot(*lag)
        np.testing.assert_allclose(faces.shear, size, **close)
        assert faces.totals[1] == pytest.approx(0.5 * size * math.hypot(*lag), abs=1e-12)

    check(moved(0.0, 0.0), (0.0, 0.0))  # lands: anchored where it is
    check(moved(0.6 * reach, 0.0), (0.6 * reach, 0.0))  # sticks: a spring
    check(moved(4.0 * reach, 0.0), (reach, 0.0))  # slides: the anchor is dragged to 3 reaches
    check(moved(3.5 * reach, 0.0), (0.5 * reach, 0.0))  # comes back: the spring relaxes
    check(moved(0.0, 0.0), (-reach, 0.0))  # slides back: the anchor stops at 1 reach
    # Across: slip (-1, 2) reaches from the anchor, cut to length one in that direction.
    check(moved(0.0, 2.0 * reach), (-reach / math.sqrt(5.0), 2.0 * reach / math.sqrt(5.0)))
    # Lifted, it forgets; set down elsewhere, it starts afresh.
    faces.x[:] = start + [0.0, 0.0, 2.0 * depth]
    force, dissipative = faces.evaluate()
    assert not force.any() and not dissipative.any() and not faces.totals.any()
    assert np.isnan(faces.anchor).all() and not faces.pressure.any() and not faces.shear.any()
    check(moved(7.0 * reach, 0.0), (0.0, 0.0))


def test_sliding_friction_follows_the_speed() -> None:
    law = FrictionLaw(0.8, 0.3, 0.01, 0.03)
    depth = 0.001
    faces = _Faces(Plane(friction=law), SQUARE - [0.0, 0.0, depth], damping=1e8)
    for speed in (0.005, 0.015, 0.02, 0.029, 1.0):
        # Sinking speed is no sliding speed, but its damping adds to the normal traction.
        faces.v[:] = [0.6 * speed, 0.8 * speed, -2.0]
        faces.anchor[:] = math.nan
        faces.evaluate()
        faces.x += [0.6, 0.8, 0.0]
        _, dissipative = faces.evaluate()
        traction = 1e9 * depth**2 + 1e8 * 2.0 * depth**2
        friction = law.coefficient(speed) * traction
        np.testing.assert_allclose(faces.pressure, traction, rtol=1e-11)
        np.testing.assert_allclose(faces.shear, friction, rtol=1e-11)
        np.testing.assert_allclose(
            dissipative.sum(axis=0)[:2], [-0.6 * friction, -0.8 * friction], rtol=1e-11
        )


def _rolling_hills(law: FrictionLaw) -> HeightField:
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21), indexing="ij")
    return HeightField(-1.0, -1.0, 0.1, 0.1 * np.sin(5.0 * x) * np.cos(4.0 * y), law)


def test_friction_stays_in_the_cone_on_any_ground() -> None:
    law = FrictionLaw(0.8, 0.3, 0.01, 0.03)
    rng = np.random.default_rng(11)
    sliding = 0
    sticking = 0
    for ground in (slope(0.3, friction=law), Step(0.0, 0.005, law), _rolling_hills(law)):
        # Soft: the spring's reach, some 10 micrometres, is a step of the random walk.
        faces = _Faces(ground, 0.1 * SQUARE, coefficient=1e7)
        for _ in range(200):
            faces.x += rng.normal(scale=2e-5, size=3)
            faces.v[:] = rng.normal(scale=0.02, size=3)
            force, dissipative = faces.evaluate()
            point = np.empty((1, 4, 3))
            point_positions(faces.x, FACE, POINTS, point)
            pushed = np.zeros(3)
            for q in range(4):
                gap, normal = _gap(ground, point[0, q])
                if gap >= 0.0:
                    assert np.isnan(faces.anchor[0, q]).all() and faces.shear[0, q] == 0.0
                    continue
                v_t = faces.v[0] - (faces.v[0] @ normal) * normal
                limit = law.coefficient(float(np.linalg.norm(v_t))) * faces.pressure[0, q]
                assert faces.shear[0, q] <= limit * (1.0 + 1e-12)
                lag = point[0, q] - faces.anchor[0, q]
                # The anchor lies in the tangent plane; round-off of coordinates of 0.1 m.
                assert abs(lag @ normal) < 1e-15
                size = faces.stick * np.linalg.norm(lag)
                assert faces.shear[0, q] == pytest.approx(size, rel=1e-6, abs=1e-8)
                pushed -= faces.areas[0, q] * faces.stick * lag
                sliding += faces.shear[0, q] >= limit * (1.0 - 1e-12)
                sticking += 0.0 < faces.shear[0, q] < limit * (1.0 - 1e-12)
            # Against the slip, in all points together.
            np.testing.assert_allclose(dissipative.sum(axis=0), pushed, atol=1e-9)
            np.testing.assert_allclose(
                faces.totals[4:7], (force + dissipative).sum(axis=0), atol=1e-9
            )
    # Both regimes were met.
    assert sliding > 100 and sticking > 100


def test_faces_left_out_are_neither_read_nor_written() -> None:
    low = SQUARE - [0.0, 0.0, 0.001]
    x = np.vstack([low, low + [2.0, 0.0, 0.0], low + [4.0, 0.0, 0.0]])
    faces = _Faces(
        Plane(friction=FrictionLaw.constant(0.5)), x, np.arange(12).reshape(3, 4)
    )  # fmt: skip
    faces.evaluate()
    assert (faces.pressure > 0.0).all() and np.isfinite(faces.anchor).all()
    faces.active = np.array([2, 0])
    faces.pressure[1] = faces.shear[1] = faces.anchor[1] = 7.0
    faces.x[4:8] = math.nan
    force, _ = faces.evaluate()
    assert not force[4:8].any() and (force[[0, 8], 2] > 0.0).all()
    assert not faces.shear[[0, 2]].any() and np.isfinite(faces.anchor[[0, 2]]).all()
    assert (faces.pressure[1] == 7.0).all() and (faces.shear[1] == 7.0).all()
    assert (faces.anchor[1] == 7.0).all()
    assert faces.totals[7] == 8.0
    faces.active = np.empty(0, dtype=faces.active.dtype)
    force, dissipative = faces.evaluate()
    assert not force.any() and not dissipative.any() and not faces.totals.any()


def test_forces_are_added() -> None:
    faces = _Faces(Plane(friction=FrictionLaw.constant(0.5)), SQUARE - [0.0, 0.0, 0.001])
    faces.v[:] = [0.0, 0.0, -1.0]
    once = np.array(faces.evaluate())
    both = np.ones((2, 4, 3))
    ground_kernels.ground_contact(
        faces.x, faces.v, FACE, faces.active, POINTS, faces.areas, *faces.packed, 1e9, 2.0, 0.0,
        1.0, 2.0, 0.5, 0.5, 1e-3, 1.5e-3, 1e7, faces.anchor, both[0], both[1], faces.pressure,
        faces.shear, faces.totals,
    )  # fmt: skip
    np.testing.assert_allclose(both, 1.0 + once, rtol=1e-14)


def test_near_faces() -> None:
    tilted = SQUARE + [0.0, 0.0, 0.3]
    tilted[1, 2] = 0.05
    x = np.vstack([SQUARE + [0.0, 0.0, 0.2], tilted, SQUARE - [0.0, 0.0, 3.0], SQUARE])
    faces = np.arange(16).reshape(4, 4)
    out = np.full(4, -1)
    packed = Plane().packed()
    assert ground_kernels.near_faces(x, faces, *packed, 0.1, out) == 3
    # One near corner is enough, deep below counts, and each face comes once, in order.
    np.testing.assert_array_equal(out, [1, 2, 3, -1])
    assert ground_kernels.near_faces(x, faces, *packed, 0.21, out) == 4
    assert ground_kernels.near_faces(x, faces, *packed, -1.0, out) == 1


@pytest.mark.parametrize("axis", [0, 1])
def test_what_is_beside_a_steep_wall_is_near(axis: int) -> None:
    """A floor up to x (or y) = 1, then a wall of slope 20: what is over the floor beside it."""
    rise = 20.0 * np.clip(np.arange(21) * 0.1 - 1.0, 0.0, 0.5)
    heights = np.tile(rise[:, None], (1, 9))
    packed = HeightField(0.0, 0.0, 0.1, heights if axis == 0 else heights.T).packed()
    out = np.full(1, -1)
    faces = np.arange(4).reshape(1, 4)

    def near(x: float, z: float, distance: float) -> bool:
        corners = np.array([[x, 0.3, z], [x - 0.1, 0.3, z], [x - 0.1, 0.4, z], [x, 0.4, z]])
        corners = corners if axis == 0 else corners[:, [1, 0, 2]]
        return bool(ground_kernels.near_faces(corners, faces, *packed, distance, out) == 1)

    # 0.05 from the wall's foot, far above the floor; the wall is 0.05 + z / 20 away.
    place = np.array([0.95, 0.3, 2.0] if axis == 0 else [0.3, 0.95, 2.0])
    assert ground_kernels.gap_and_normal(*packed, place, np.empty(3)) == 2.0
    assert near(0.95, 2.0, 0.2)
    # Over the top of all, or far from the wall, it is not.
    assert not near(0.95, 10.3, 0.2)
    assert not near(0.6, 2.0, 0.2)
    # Beside the field the rim's height continues; what is no number is nowhere.
    assert near(2.5, 10.1, 0.2) and not near(2.5, 10.3, 0.2) and not near(-3.0, 1.0, 0.2)
    assert not near(np.nan, 1.0, 0.2)


# ---- motion -----------------------------------------------------------------------------------

DENSITY = 1000.0
BLOCK_B = 1e10
STICK = 1e7


def _block(size: float, angle: float, law: FrictionLaw) -> tuple[_Faces, float, float]:
    """Bottom face of a cube in balance across a slope; its mass and its pressure [Pa].

    The normal force of the start is exact, so only the motion along the slope is left.
    """
    plane = slope(angle, friction=law)
    normal = np.array(plane.normal)
    along = np.array([math.cos(angle), 0.0, -math.sin(angle)])
    pressure = DENSITY * GRAVITY * size * math.cos(angle)
    flat = size * (SQUARE[:, :1] * along + SQUARE[:, 1:2] * [0.0, 1.0, 0.0])
    x = flat - math.sqrt(pressure / BLOCK_B) * normal
    return _Faces(plane, x, coefficient=BLOCK_B, stick=STICK), DENSITY * size**3, pressure


@pytest.mark.parametrize("size", [1.0, 0.1, 0.01])
def test_a_sliding_block_stops(size: float) -> None:
    mu = 0.5
    faces, mass, pressure = _block(size, 0.0, FrictionLaw.constant(mu))
    speed = math.sqrt(2.0 * mu * GRAVITY * size)  # so that v0**2/(2 mu g) is the block's size
    stop = speed / (mu * GRAVITY)
    dt = 0.004 * math.sqrt(DENSITY * size / STICK)
    faces.v[:, 0] = speed
    start = faces.x[0, 0]
    path: list[float] = []
    faces.march(
        mass,
        lambda t: np.array([0.0, 0.0, -GRAVITY]),
        dt,
        int(1.5 * stop / dt),
        lambda t: path.append(faces.x[0, 0] - start),
    )
    # The spring that carries friction stretches by `reach` first, at half the force on average:
    # the way grows by reach/2. Steps see the kink at the limit to within (v0 dt)**2/(8 reach),
    # here one hundredth of the reach.
    reach = mu * pressure / STICK
    assert max(path) == pytest.approx(size + 0.5 * reach, abs=0.02 * reach)
    # Then it swings on that spring, by one reach to either side.
    late = np.array(path[int(1.1 * stop / dt) :])
    assert late.min() > max(path) - 2.01 * reach
    assert abs(faces.x[:, 2] - faces.x[0, 2]).max() < 1e-12 * size


@pytest.mark.parametrize("size", [1.0, 0.1, 0.01])
@pytest.mark.parametrize("excess", [0.99, 1.01])
def test_a_block_on_a_slope(size: float, excess: float) -> None:
    mu = 0.5
    angle = math.atan(excess * mu)
    faces, mass, pressure = _block(size, angle, FrictionLaw.constant(mu))
    across = np.array(faces.ground.normal)  # type: ignore[union-attr]
    along = np.array([math.cos(angle), 0.0, -math.sin(angle)])
    period = 2.0 * math.pi * math.sqrt(DENSITY * size / STICK)
    dt = period / 60.0
    ramp = 40.0 * period
    start = faces.x[0].copy()
    path: list[float] = []
    speeds: list[float] = []

    def gravity(t: float) -> np.ndarray:
        # The pull along the slope comes slowly: laid on at once, the stick's spring would
        # overshoot to twice the load.
        a = min(t / ramp, 1.0)
        pull = math.sin(angle) * a * a * (3.0 - 2.0 * a)
        return GRAVITY * (pull * along - math.cos(angle) * across)

    def watch(t: float) -> None:
        path.append((faces.x[0] - start) @ along)
        speeds.append(faces.v[0] @ along)

    faces.march(mass, gravity, dt, int(1.5 * ramp / dt), watch)
    reach = mu * pressure / STICK
    if excess < 1.0:
        # Sticks: stretched as far as the load asks, and never at the limit. The swing a cubic
        # ramp leaves is of the order 12/(2 pi 40)**2 = 2e-4 of the stretch.
        assert max(path) < 0.995 * reach
        assert path[-1] == pytest.approx(excess * reach, rel=1e-3)
        assert (faces.shear < mu * faces.pressure).all()
    else:
        # Slides to +x, faster by g (sin a - mu cos a) each second; a constant force leaves
        # leapfrog nothing to err by, and round-off is a hundred times that of 1 - 0.99.
        count = len(speeds) // 6
        gained = (speeds[-1] - speeds[-1 - count]) / (count * dt)
        expected = GRAVITY * (math.sin(angle) - mu * math.cos(angle))
        assert gained == pytest.approx(expected, rel=1e-6)
        assert faces.x[0, 0] > start[0] + 2.0 * reach
        np.testing.assert_allclose(faces.shear, mu * faces.pressure, rtol=1e-12)


@pytest.mark.parametrize(("m1", "m2", "m3"), [(2.0, 1.0, 2.0), (1.5, 1.5, 1.0)])
def test_rebound_of_a_dropped_mass(m1: float, m2: float, m3: float) -> None:
    mass, side, speed, height = 0.01, 0.01, 1.0, 1e-4
    area = side**2
    b = 1e11 if m1 == 2.0 else 3e9
    damping = 0.3 * b * 1e-3 ** (m1 - m3)  # as strong as 0.3 of the elastic part at 1 m/s, 1 mm

    def fall(t: float, state: np.ndarray) -> list[float]:
        z, v = state
        depth = max(0.0, -z)
        resist = damping * abs(v) ** m2 * depth**m3
        traction = max(0.0, b * depth**m1 + (resist if v < 0.0 else -resist))
        return [v, area * traction / mass - GRAVITY]

    def leaves(t: float, state: np.ndarray) -> float:
        return state[0]

    leaves.terminal = True  # type: ignore[attr-defined]
    leaves.direction = 1.0  # type: ignore[attr-defined]
    exact = solve_ivp(
        fall, (0.0, 0.1), [height, -speed], events=leaves, rtol=1e-10, atol=1e-13, max_step=1e-5
    )
    rebound = float(exact.y_events[0][0][1])
    # The damping shows: a tenth of the speed at least is lost.
    assert 0.3 < rebound / speed < 0.9

    errors = []
    for dt in (4e-6, 2e-6):
        faces = _Faces(
            Plane(), side * SQUARE + [0.0, 0.0, height], coefficient=b, exponent=m1,
            damping=damping, damping_exponent=m2, indentation_exponent=m3,
        )  # fmt: skip
        faces.v[:, 2] = -speed
        faces.march(
            mass,
            lambda t: np.array([0.0, 0.0, -GRAVITY]),
            dt,
            int(2.0 * exact.t[-1] / dt),
            lambda t: None,
        )
        z, v = faces.x[0, 2], faces.v[0, 2]
        assert z > 0.0 and v > 0.0
        # Back to the speed at z = 0, where it left: v**2 + 2 g z, half a step behind x.
        errors.append(math.sqrt(v**2 + 2.0 * GRAVITY * (z - 0.5 * dt * v)) - rebound)
        # One face, four equal nodes: no rotation.
        np.testing.assert_allclose(faces.x[:, 2], z, rtol=1e-12)
    # The damping sees the velocity half a step late: an error of first order, halved with dt.
    assert abs(errors[1]) < 1e-3 * rebound
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
