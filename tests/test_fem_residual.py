"""The vectorised internal force against a slow NumPy twin and against mathematics."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest

from flexapod.core.errors import InputError
from flexapod.fem.lane_kernels import LANES
from flexapod.fem.residual_kernels import InternalForce

CORNERS = np.array(
    [
        [-1, -1, -1],
        [1, -1, -1],
        [1, 1, -1],
        [-1, 1, -1],
        [-1, -1, 1],
        [1, -1, 1],
        [1, 1, 1],
        [-1, 1, 1],
    ],
    dtype=float,
)
# Three-term Ogden (SoSpider), one term, Yeoh, Ogden with a neo-Hooke term and Yeoh; [Pa].
MU = np.array(
    [[-0.6830e6, 0.8864e6, -0.1750e6], [-2e5, 0, 0], [0, 0, 0], [0, 3e5, -1e5]], dtype=float
)
ALPHA = np.array([[5.1017, 5.1673, 5.4285], [-2, 1, 1], [2, 2, 2], [2, 2, -3.3]], dtype=float)
C = np.array([[0, 0, 0], [0, 0, 0], [1e5, 2e4, 1e3], [1e4, -2e3, 5e2]], dtype=float)
KAPPA = np.array([1e8, 3e7, 1e7, 2e7])
KAPPA_POINT = np.array([8e5, 0, 3e5, 0], dtype=float)


def box(n: int = 3, shake: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
    """A cube of side 1 cm of n**3 distorted cells."""
    g = np.linspace(0.0, 1.0, n + 1)
    x = np.stack(np.meshgrid(g, g, g, indexing="ij"), axis=-1).reshape(-1, 3)
    x = x + shake / n * np.random.default_rng(1).uniform(-1, 1, x.shape)
    i = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    steps = ((CORNERS + 1) / 2).astype(int)
    cells = [i[a : n + a, b : n + b, c : n + c].ravel() for a, b, c in steps]
    return 0.01 * x, np.stack(cells, axis=-1)


def twin(
    x: np.ndarray, cells: np.ndarray, material: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force, element energies and least J by singular values, point by point."""
    xe, ue = x[cells], u[cells]
    volume = np.zeros(len(cells))
    current = np.zeros(len(cells))
    states = []
    for point in CORNERS / math.sqrt(3.0):
        t = 1.0 + CORNERS * point
        dn = np.stack([t[:, 1] * t[:, 2], t[:, 0] * t[:, 2], t[:, 0] * t[:, 1]], axis=1)
        dn = CORNERS * dn / 8.0
        j0 = np.einsum("eai,ad->eid", xe, dn)
        gradient = np.einsum("ad,edi->eai", dn, np.linalg.inv(j0))
        w = np.linalg.det(j0)
        f = np.eye(3) + np.einsum("eai,eaj->eij", ue, gradient)
        j = np.linalg.det(f)
        volume += w
        current += w * j
        states.append((gradient, w, f, j))
    mean_j = current / volume
    kappa = KAPPA[material]
    pressure = 0.5 * kappa * (mean_j - 1.0 / mean_j)
    energy = volume * 0.25 * kappa * (mean_j**2 - 1.0 - 2.0 * np.log(mean_j))
    force = np.zeros((len(cells), 8, 3))
    for gradient, w, f, j in states:
        left, stretch, _ = np.linalg.svd(f)
        e = np.log(stretch)
        e -= e.mean(axis=1, keepdims=True)
        powers = np.expm1(ALPHA[material][:, :, None] * e[:, None, :])
        terms = MU[material][:, :, None] * (powers - powers.mean(axis=2, keepdims=True))
        tau = terms.sum(axis=1)
        density = (MU[material] / ALPHA[material] * powers.sum(axis=2)).sum(axis=1)
        squares = np.expm1(2.0 * e)
        i1 = squares.sum(axis=1)
        c = C[material]
        slope = c[:, 0] + i1 * (2.0 * c[:, 1] + 3.0 * i1 * c[:, 2])
        tau = tau + 2.0 * slope[:, None] * (squares - squares.mean(axis=1, keepdims=True))
        density = density + i1 * (c[:, 0] + i1 * (c[:, 1] + i1 * c[:, 2]))
        stress = np.einsum("eij,ej,ekj->eik", left, tau, left)
        kappa = KAPPA_POINT[material]
        density = density + 0.25 * kappa * (j * j - 1.0 - 2.0 * np.log(j))
        spherical = pressure * j + 0.5 * kappa * (j * j - 1.0)
        stress = stress + spherical[:, None, None] * np.eye(3)
        p = np.einsum("eij,ekj->eik", stress, np.linalg.inv(f))
        force += w[:, None, None] * np.einsum("eij,eaj->eai", p, gradient)
        energy += w * density
    out = np.zeros_like(x)
    np.add.at(out, cells.ravel(), force.reshape(-1, 3))
    return out, energy, np.min([s[3] for s in states], axis=0)


def prepared(x: np.ndarray, cells: np.ndarray, material: np.ndarray) -> InternalForce:
    return InternalForce(x, cells, material, MU, ALPHA, C, KAPPA, KAPPA_POINT)


def materials(choice: int | str, count: int) -> np.ndarray:
    if choice == "mixed":
        return np.arange(count) % len(KAPPA)
    if choice == "blocks":
        return (np.arange(count) > count // 2).astype(int)
    return np.full(count, int(choice))


def bend(x: np.ndarray, seed: int = 0) -> np.ndarray:
    u = 0.1 * np.sin(300.0 * x[:, [1, 2, 0]]) * 0.01
    return u + 4e-4 * np.random.default_rng(seed).uniform(-1, 1, x.shape)


@pytest.mark.parametrize("choice", [0, 1, 2, 3, "blocks", "mixed"])
def test_agrees_with_twin_at_random_deformation(choice: int | str) -> None:
    x, cells = box(3)
    material = materials(choice, len(cells))
    work = prepared(x, cells, material)
    out = np.empty_like(x)
    for u in (bend(x), bend(x, 1), x * [1.5, -0.6, 0.1] + bend(x)):
        energy = work(u, out)
        force, energies, least = twin(x, cells, material, u)
        assert np.abs(out - force).max() < 1e-12 * np.abs(force).max()
        assert np.abs(work.element_energy - energies).max() < 1e-12 * energies.max()
        assert np.abs(work.least_j - least).max() < 1e-13
        assert energy == pytest.approx(energies.sum(), rel=1e-12)


@pytest.mark.parametrize("choice", [0, 1, 2, 3, "mixed"])
@pytest.mark.parametrize(
    "stretch",
    [
        (1.1, 1.1, 1.1),
        (1.3, 1.3, 0.6),
        (0.8, 0.8, 1.6),
        (1.2, 1.2, 1.0 - 1e-9),
        (1.5, 1.0, 1.0 + 1e-8),
        (1.0 + 1e-5, 1.0, 1.0 - 1e-5),
        (0.9, 0.9 + 1e-13, 0.9),
    ],
)
def test_equal_principal_stretches(choice: int | str, stretch: tuple[float, ...]) -> None:
    """Two and three equal or nearly equal stretches, along turned axes, lose no digits."""
    x, cells = box(2)
    material = materials(choice, len(cells))
    axes, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    for q in (np.eye(3), axes):
        u = x @ (q @ np.diag(np.array(stretch) - 1.0) @ q.T)
        out = np.empty_like(x)
        work = prepared(x, cells, material)
        work(u, out)
        force, energies, _ = twin(x, cells, material, u)
        # The twin's own rounding is relative to the moduli, not to a small stress.
        scale = max(np.abs(force).max(), 1e5 * 0.01**2 * 1e-2)
        assert np.abs(out - force).max() < 1e-11 * scale
        assert np.abs(work.element_energy - energies).max() < 1e-11 * max(energies.max(), 1e-5)


@pytest.mark.parametrize("choice", [0, 1, 2, "mixed"])
def test_rest_and_rigid_motion_give_no_force(choice: int | str) -> None:
    x, cells = box(3)
    work = prepared(x, cells, materials(choice, len(cells)))
    out = np.empty_like(x)
    energy = work(np.zeros_like(x), out)
    assert abs(energy) < 1e-30
    assert np.abs(out).max() < 1e-14 * KAPPA.max() * 0.003**2
    rotation, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    energy = work(x @ (rotation - np.eye(3)).T + [0.1, -0.2, 0.3], out)
    # Against the bulk modulus on a cell's face.
    assert np.abs(out).max() < 1e-13 * KAPPA.max() * 0.003**2
    assert abs(energy) < 1e-13 * KAPPA.max() * 0.01**3


def test_small_strains_keep_their_digits() -> None:
    """At strains of 1e-7 the force is linear to 1e-6 of itself, far under the round-off of F."""
    x, cells = box(2)
    work = prepared(x, cells, materials(0, len(cells)))
    u = bend(x)
    one, half = np.empty_like(x), np.empty_like(x)
    energy = work(1e-7 * u, one)
    quarter = work(0.5e-7 * u, half)
    assert np.abs(one - 2.0 * half).max() < 1e-6 * np.abs(one).max()
    assert energy == pytest.approx(4.0 * quarter, rel=1e-6)


@pytest.mark.parametrize("choice", [0, 1, 2, 3, "mixed"])
def test_force_is_slope_of_energy(choice: int | str) -> None:
    x, cells = box(3)
    work = prepared(x, cells, materials(choice, len(cells)))
    u = bend(x)
    v = 1e-3 * np.random.default_rng(7).normal(size=x.shape)
    out = np.empty_like(x)
    work(u, out)
    slope = float((out * v).sum())
    scratch = np.empty_like(x)
    h = 1e-3
    # Central differences, extrapolated once.
    d = [(work(u + k * v, scratch) - work(u - k * v, scratch)) / (2.0 * k) for k in (h, 2 * h)]
    assert (4.0 * d[0] - d[1]) / 3.0 == pytest.approx(slope, rel=1e-8)


def test_same_bits_for_any_thread_count() -> None:
    x, cells = box(6)
    work = prepared(x, cells, materials("mixed", len(cells)))
    u = 0.3 * bend(x)
    before = numba.get_num_threads()
    results = []
    try:
        for threads in sorted({1, 2, before} & set(range(1, before + 1))):
            numba.set_num_threads(threads)
            out = np.empty_like(x)
            energy = work(u, out)
            results.append([out, np.array(energy), work.element_energy.copy(), work.least_j.copy()])
    finally:
        numba.set_num_threads(before)
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert np.array_equal(a, b)


def test_a_lane_does_not_depend_on_its_neighbours() -> None:
    """A cell alone gives what it gives within a batch of several materials."""
    x, cells = box(2)
    material = materials("mixed", len(cells))
    u = bend(x)
    together = prepared(x, cells, material)
    together(u, np.empty_like(x))
    for e in range(len(cells)):
        alone = prepared(x, cells[e : e + 1], material[e : e + 1])
        alone(u, np.empty_like(x))
        force = together.element_force[e]
        assert np.abs(alone.element_force[0] - force).max() < 1e-13 * np.abs(force).max()
        assert alone.element_energy[0] == pytest.approx(together.element_energy[e], rel=1e-13)


@pytest.mark.parametrize("choice", [0, 2, "mixed"])
def test_inverted_cells_are_named_and_harm_no_other(choice: int | str) -> None:
    x, cells = box(3)
    material = materials(choice, len(cells))
    work = prepared(x, cells, material)
    u = bend(x)
    work(u, np.empty_like(x))
    sound_energy = work.element_energy.copy()
    sound_force = work.element_force.copy()
    # A corner pushed through its cell; the corner belongs to cell 0 only.
    hurt = u.copy()
    hurt[cells[0, 0]] += 1.5 * (x[cells[0, 6]] - x[cells[0, 0]])
    out = np.empty_like(x)
    assert work(hurt, out) == math.inf
    assert work.least_j[0] < 0.0
    assert work.element_energy[0] == math.inf
    assert np.isfinite(out).all()
    assert np.array_equal(work.element_energy[1:], sound_energy[1:])
    assert np.array_equal(work.element_force[1:], sound_force[1:])
    hurt[cells[0, 0]] = np.nan
    assert work(hurt, out) == math.inf
    assert math.isnan(work.least_j[0])
    assert (work.least_j[1:] > 0.0).all()
    # Every cell shrunk to a point.
    assert work(-x, out) == math.inf
    assert not (work.least_j > 0.0).any()


def test_extreme_stretch_stays_finite() -> None:
    x, cells = box(2, shake=0.0)
    work = prepared(x, cells, materials(0, len(cells)))
    out = np.empty_like(x)
    for stretch in ((100.0, 0.1, 0.1), (1e-3, 1e-3, 1e-3), (1e4, 1e-4, 1.0)):
        assert math.isfinite(work(x * (np.array(stretch) - 1.0), out))
        assert np.isfinite(out).all()


@pytest.mark.parametrize("count", [1, LANES - 1, LANES, LANES + 1])
def test_any_number_of_cells(count: int) -> None:
    x, cells = box(3)
    cells = cells[:count]
    material = materials("mixed", count)
    work = prepared(x, cells, material)
    out = np.full_like(x, np.nan)
    u = bend(x)
    work(u, out)
    force, energies, _ = twin(x, cells, material, u)
    assert np.abs(out - force).max() < 1e-12 * np.abs(force).max()
    assert work.element_energy.shape == (count,)
    assert np.allclose(work.element_energy, energies, rtol=1e-12)


def test_refused_input() -> None:
    x, cells = box(1)
    with pytest.raises(InputError, match="alpha"):
        InternalForce(x, cells, np.zeros(1), MU[:1], 0.0 * ALPHA[:1], C[:1], KAPPA[:1])
    with pytest.raises(InputError, match="nodes"):
        prepared(x[:7], cells, np.zeros(1))
    with pytest.raises(InputError, match="material"):
        prepared(x, cells, np.full(1, 9))
