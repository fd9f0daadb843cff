"""The viscous overstress against a slow NumPy twin and against linear viscoelasticity."""

from __future__ import annotations

import itertools
import math
import tracemalloc
from collections.abc import Sequence

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from scipy.spatial.transform import Rotation
from statics_helpers import distorted, grid

from flexapod.core.errors import InputError
from flexapod.fem.body import SolidBody
from flexapod.fem.lane_kernels import LANES
from flexapod.fem.residual_kernels import InternalForce
from flexapod.fem.viscous import ViscousForce
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke
from flexapod.materials.ogden import Ogden
from flexapod.materials.prony import Prony
from flexapod.materials.yeoh import Yeoh

LAWS = (
    Ogden((-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285)),
    Ogden((1e5, -2e4), (1.3, -2.0)),
    Yeoh(1e5, 2e4, 1e3),
    NeoHooke(2e5),
)
SERIES: tuple[Prony | None, ...] = (
    Prony((0.4, 0.25), (0.02, 0.5)),
    Prony((1.5,), (0.1,)),
    None,
    Prony((0.2, 0.1, 0.6), (0.003, 0.05, 2.0)),
)


def solid(mesh: TaggedMesh, laws: Sequence[int]) -> SolidBody:
    """A body whose cells take the laws in turn."""
    cells = np.arange(len(mesh.cells))
    for k in range(len(laws)):
        mesh = mesh.with_cell_group(f"m{k}", cells[k :: len(laws)])
    return SolidBody(mesh, {f"m{k}": SolidMaterial(LAWS[i], 1000.0) for k, i in enumerate(laws)})


def viscous(
    body: SolidBody, series: Sequence[Prony | None], cells: slice | np.ndarray = slice(None)
) -> ViscousForce:
    return ViscousForce(
        body.node_count,
        body.cells[cells],
        body.gradients[cells],
        body.weights[cells],
        body.material[cells],
        body.mu,
        body.alpha,
        body.c,
        series,
    )


def isochoric(body: SolidBody) -> InternalForce:
    """The deviatoric force of the long-term law alone."""
    return InternalForce(
        body.nodes, body.cells, body.material, body.mu, body.alpha, body.c, 0.0 * body.kappa
    )


def mixed() -> tuple[SolidBody, ViscousForce]:
    body = solid(distorted((3, 3, 3)), range(4))
    return body, viscous(body, SERIES)


def bend(x: np.ndarray, t: float) -> np.ndarray:
    """A large motion from rest that turns, bends and swells."""
    s = math.sin(3.0 * t)
    turn = Rotation.from_rotvec([0.4 * t, -2.0 * t, t]).as_matrix()
    y = x * [1.0 + 0.5 * s, 1.0 - 0.3 * s, 1.0 + 0.1 * t]
    y = y + 0.15 * math.sin(5.0 * t) * np.sin(3.0 * x[:, [1, 2, 0]])
    return np.asarray(y @ turn.T - x)


class Twin:
    """Singular values, one convolution state per point, plain einsum."""

    def __init__(self, body: SolidBody, series: Sequence[Prony | None]) -> None:
        self.body, self.series = body, series
        self.old = np.zeros((body.cell_count, 8, 3, 3))
        self.branches = np.zeros((3, body.cell_count, 8, 3, 3))

    def stress(self, f: np.ndarray) -> np.ndarray:
        left, stretch, _ = np.linalg.svd(f)
        e = np.log(stretch)
        e -= e.mean(axis=-1, keepdims=True)
        m = self.body.material
        mu, alpha = self.body.mu[m][:, None, :, None], self.body.alpha[m][:, None, :, None]
        principal = (mu * np.expm1(alpha * e[:, :, None, :])).sum(axis=2)
        squares = np.expm1(2.0 * e)
        i1 = squares.sum(axis=-1, keepdims=True)
        c = self.body.c[m][:, None, :, None]
        slope = c[:, :, 0] + i1 * (2.0 * c[:, :, 1] + 3.0 * i1 * c[:, :, 2])
        principal = principal + 2.0 * slope * squares
        principal -= principal.mean(axis=-1, keepdims=True)
        return np.asarray(np.einsum("...ij,...j,...kj->...ik", left, principal, left))

    def force(self, u: np.ndarray, dt: float) -> np.ndarray:
        body = self.body
        f = np.eye(3) + np.einsum("eai,eqaj->eqij", u[body.cells], body.gradients)
        unit = f / np.cbrt(np.linalg.det(f))[..., None, None]
        back = np.linalg.inv(unit)
        new = back @ self.stress(f) @ back.swapaxes(-1, -2)
        for m, series in enumerate(self.series):
            if series is None:
                continue
            here = body.material == m
            for k, (g, tau) in enumerate(zip(series.moduli, series.times, strict=True)):
                share = g * (1.0 - math.exp(-dt / tau)) / (dt / tau)
                q = self.branches[k, here]
                self.branches[k, here] = math.exp(-dt / tau) * q + share * (
                    new[here] - self.old[here]
                )
        self.old = new
        tau_v = unit @ self.branches.sum(axis=0) @ unit.swapaxes(-1, -2)
        tau_v -= np.trace(tau_v, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
        p = tau_v @ np.linalg.inv(f).swapaxes(-1, -2)
        element = np.einsum("eq,eqij,eqaj->eai", body.weights, p, body.gradients)
        out = np.zeros_like(u)
        np.add.at(out, body.cells.ravel(), element.reshape(-1, 3))
        return out


STEPS = (0.01, 1e-4, 0.03, 0.2, 0.05, 1e-7, 0.02)


@pytest.mark.parametrize("laws", [(0,), (1,), (3,), (0, 1, 2, 3)], ids=str)
def test_agrees_with_twin_along_a_large_motion(laws: tuple[int, ...]) -> None:
    body = solid(distorted((3, 3, 3)), laws)
    series = [SERIES[i] for i in laws]
    work, twin = viscous(body, series), Twin(body, series)
    assert work.active.size == (body.material != 2).sum()
    out = np.full_like(body.nodes, np.nan)
    t = 0.0
    for dt in STEPS:
        t += dt
        u = bend(body.nodes, t)
        work.force(u, dt, out)
        expected = twin.force(u, dt)
        # Round-off of both, on strains of size 1; measured below 3e-14.
        assert np.abs(out - expected).max() < 1e-12 * np.abs(expected).max()


def test_a_subset_of_cells_adds_up() -> None:
    body, whole = mixed()
    parts = [viscous(body, SERIES, np.arange(k, body.cell_count, 3)) for k in range(3)]
    out, part = np.empty_like(body.nodes), np.empty_like(body.nodes)
    for t in (0.1, 0.2):
        u = bend(body.nodes, t)
        whole.force(u, 0.1, out)
        total = np.zeros_like(out)
        for work in parts:
            work.force(u, 0.1, part)
            total += part
        assert np.abs(total - out).max() < 1e-13 * np.abs(out).max()


@pytest.mark.parametrize("count", [1, LANES - 1, LANES, LANES + 1])
def test_any_number_of_cells(count: int) -> None:
    body = solid(distorted((3, 3, 3)), (0,))
    few = viscous(body, SERIES[:1], slice(count))
    every = viscous(body, SERIES[:1])
    out = np.empty_like(body.nodes)
    for t in (0.1, 0.2):
        few.force(bend(body.nodes, t), 0.1, out)
        every.force(bend(body.nodes, t), 0.1, out)
    kept, all_kept = few.history(), every.history()
    for name in kept:
        assert kept[name].shape[0] == count
        assert np.array_equal(kept[name], all_kept[name][:count])


def test_rest_and_rigid_motion_give_no_force() -> None:
    body, work = mixed()
    out = np.empty_like(body.nodes)
    work.force(np.zeros_like(out), 0.01, out)
    assert np.array_equal(out, np.zeros_like(out))
    for k in range(1, 20):
        turn = Rotation.from_rotvec([0.3 * k, -0.2 * k, 0.1]).as_matrix()
        work.force(body.nodes @ (turn - np.eye(3)).T + [0.1, k, 0.3], 0.01, out)
        # Round-off of positions up to 20 sides of the body, 60 of a cell, makes strains of 1e-14;
        # against the moduli on a cell's face. Measured a quarter.
        assert np.abs(out).max() < 1e-14 * 5e5 / 9.0


def test_a_superposed_rotation_turns_the_forces() -> None:
    body, still = mixed()
    turning = viscous(body, SERIES)
    a, b = np.empty_like(body.nodes), np.empty_like(body.nodes)
    t = 0.0
    for dt in STEPS:
        t += dt
        u = bend(body.nodes, t)
        turn = Rotation.from_rotvec([7.0 * t, 1.0 - 3.0 * t, 2.0]).as_matrix()
        still.force(u, dt, a)
        turning.force((body.nodes + u) @ turn.T - body.nodes, dt, b)
        # Round-off of positions of size 1 in strains of size 1; measured below 4e-14.
        assert np.abs(b - a @ turn.T).max() < 1e-12 * np.abs(a).max()


def test_overstress_is_in_balance_and_has_no_pressure() -> None:
    """No resultant, no moment, and ``sum f.x = integral tr(tau) dV = 0``."""
    body, work = mixed()
    out = np.empty_like(body.nodes)
    t = 0.0
    for dt in STEPS:
        t += dt
        u = bend(body.nodes, t)
        work.force(u, dt, out)
        x = body.nodes + u
        size = np.abs(out).sum()
        # Round-off of a sum of forces times positions of size 1.
        assert np.abs(out.sum(axis=0)).max() < 1e-13 * size
        assert np.abs(np.cross(x, out).sum(axis=0)).max() < 1e-13 * size
        assert abs((out * x).sum()) < 1e-13 * size


def test_swelling_at_once_leaves_the_kirchhoff_overstress() -> None:
    """Volume is not relaxed: P = tau F^-T falls as 1/s when the body is blown up by s."""
    body, work = mixed()
    before, after = np.empty_like(body.nodes), np.empty_like(body.nodes)
    work.force(bend(body.nodes, 0.3), 0.05, before)
    work.force(bend(body.nodes, 0.4), 0.05, before)
    x = body.nodes + bend(body.nodes, 0.4)
    work.force(1.2 * x - body.nodes, 0.0, after)
    # Round-off alone: S does not see the volume.
    assert np.abs(1.2 * after - before).max() < 1e-13 * np.abs(before).max()


SHEAR = np.array([[0.0, 0.6, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
UNIAXIAL = np.diag([0.8, 1.8**-0.5 - 1.0, 1.8**-0.5 - 1.0])


@pytest.mark.parametrize("law", [0, 1, 3])
@pytest.mark.parametrize("h", [SHEAR, UNIAXIAL], ids=["shear", "uniaxial"])
def test_a_step_relaxes_as_the_series_says(h: np.ndarray, law: int) -> None:
    """The isochoric force is the long-term one times ``1 + sum g_i exp(-t/tau_i)``."""
    body = solid(distorted((2, 2, 2)), (law,))
    series = SERIES[law]
    assert series is not None
    work = viscous(body, [series])
    u = body.nodes @ h.T
    elastic, out = np.empty_like(u), np.empty_like(u)
    isochoric(body)(u, elastic)
    work.force(u, 0.0, out)
    t = 0.0
    for dt in (0.0, 1e-4, 0.01, 0.02, 0.3, 1.0, 5.0):
        t += dt
        work.force(u, dt, out)
        expected = float(series.relaxation(t)) * elastic
        # Held strain: the recurrence is exact. Round-off; measured below 2e-15.
        assert np.abs(elastic + out - expected).max() < 1e-13 * np.abs(elastic).max()


def test_quick_and_slow_limits() -> None:
    """Within t << tau the whole motion adds ``sum g`` times the law; t >> tau adds nothing."""
    body = solid(distorted((3, 3, 3)), (0, 1, 3))
    series = [SERIES[0], SERIES[1], SERIES[3]]
    elastic, out = np.empty_like(body.nodes), np.empty_like(body.nodes)
    stiff = InternalForce(
        body.nodes,
        body.cells,
        body.material,
        body.mu * np.array([[s.instantaneous - 1.0] for s in series if s]),
        body.alpha,
        body.c,
        0.0 * body.kappa,
    )
    quick, slow = viscous(body, series), viscous(body, series)
    assert quick.stiffening == pytest.approx([1.65, 2.5, 1.9])
    for k in range(1, 21):
        quick.force(bend(body.nodes, 0.02 * k), 1e-12, out)
    stiff(bend(body.nodes, 0.4), elastic)
    # 2e-11 s over the shortest time constant of 3e-3 s is about 1e-8; measured 1e-9.
    assert np.abs(out - elastic).max() < 2e-8 * np.abs(elastic).max()
    for k in range(1, 21):
        slow.force(bend(body.nodes, 0.02 * k), 1e9, out)
    # The slowest branch keeps tau/dt = 2e-9 of the last change of stress.
    assert np.abs(out).max() < 1e-8 * np.abs(elastic).max()
    quick.force(bend(body.nodes, 0.4), math.inf, out)
    assert np.array_equal(out, np.zeros_like(out))
    quick.force(bend(body.nodes, 0.4), 1e-3, out)
    assert np.array_equal(out, np.zeros_like(out))


@pytest.mark.parametrize("omega", [0.7, 400.0])
def test_small_sinusoidal_shear(omega: float) -> None:
    """Stress ``gamma0 ((G' - G) sin wt + G'' cos wt)``, loss per cycle ``pi G'' gamma0**2``."""
    body = solid(grid((1, 1, 1)), (3,))
    series = Prony((0.2, 0.3, 0.6), (0.1 / omega, 0.8 / omega, 3.0 / omega))
    work = viscous(body, [series])
    amplitude, per_cycle = 1e-4, 200
    out = np.empty_like(body.nodes)
    shape = body.nodes[:, [2]] * [1.0, 0.0, 0.0]
    # The transient fades as exp(-t/tau): ten cycles are 20 of the longest time constant.
    first = 10 * per_cycle
    angles = 2.0 * math.pi * np.arange(first + per_cycle + 1) / per_cycle
    strain = amplitude * np.sin(angles)
    stress = np.empty_like(strain)
    for n, gamma in enumerate(strain):
        work.force(gamma * shape, 2.0 * math.pi / omega / per_cycle, out)
        stress[n] = out[body.nodes[:, 2] == 1.0, 0].sum()
    cycle = slice(first, first + per_cycle)
    sine = 2.0 / per_cycle * float(stress[cycle] @ np.sin(angles[cycle]))
    cosine = 2.0 / per_cycle * float(stress[cycle] @ np.cos(angles[cycle]))
    lost = float(np.trapezoid(stress[first:], strain[first:]))
    storage, loss = series.storage_loss(omega)
    scale = LAWS[3].shear_modulus * amplitude
    # The recurrence takes the stress as linear in a step: relative (omega dt)**2/12 = 8e-5, and
    # the sum for the loss adds (omega dt)**2/6 = 16e-5; finite strain has a part in 1e-8.
    assert sine / scale == pytest.approx(float(storage) - 1.0, rel=1e-4)
    assert cosine / scale == pytest.approx(float(loss), rel=1e-4)
    assert lost == pytest.approx(math.pi * float(loss) * scale * amplitude, rel=3e-4)


def test_second_order_in_the_step() -> None:
    body = solid(distorted((2, 2, 2)), (0, 1))
    results = []
    for count in (16, 32, 64, 512):
        work = viscous(body, SERIES[:2])
        out = np.empty_like(body.nodes)
        for k in range(1, count + 1):
            work.force(bend(body.nodes, 0.4 * k / count), 0.4 / count, out)
        results.append(out)
    errors = [np.abs(r - results[-1]).max() for r in results[:-1]]
    # The reference's own error is (64/512)**2 = 1.6 % of the last: slopes 0.02 above 2.
    for coarse, fine in itertools.pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(2.0, abs=0.05)


def test_stored_energy_of_a_small_step() -> None:
    """Springs hold ``sum g_i G gamma**2/2 exp(-2t/tau_i)``; the work of the step went there."""
    body = solid(grid((2, 1, 1)), (3, 0))
    series = [Prony((0.2, 0.6), (0.05, 2.0)), Prony((0.5,), (0.3,))]
    work = viscous(body, series)
    gamma = 1e-5
    u = gamma * body.nodes[:, [2]] * [1.0, 0.0, 0.0]
    out = np.empty_like(u)
    work.force(u, 0.0, out)
    # Finite strain adds a part in gamma**2 (measured 2e-10), the law's round-off 1e-11.
    assert work.stored_energy() == pytest.approx(0.5 * float((out * u).sum()), rel=1e-8)
    work.force(u, 0.4, out)
    g3, g0 = LAWS[3].shear_modulus, LAWS[0].shear_modulus
    expected = 0.5 * g3 * (0.2 * math.exp(-16.0) + 0.6 * math.exp(-0.4))
    expected += 0.5 * g0 * 0.5 * math.exp(-0.8 / 0.3)
    assert work.stored_energy() == pytest.approx(0.5 * expected * gamma**2, rel=1e-8)


def test_same_bits_for_any_thread_count() -> None:
    # Enough cells to keep two threads at work at once.
    body = solid(distorted((14, 14, 14)), range(4))
    before = numba.get_num_threads()
    results = []
    try:
        for threads in sorted({1, 2, before} & set(range(1, before + 1))):
            numba.set_num_threads(threads)
            work = viscous(body, SERIES)
            out = np.empty_like(body.nodes)
            for t in (0.1, 0.2, 0.3):
                work.force(bend(body.nodes, t), 0.1, out)
            results.append([out, *work.history().values()])
    finally:
        numba.set_num_threads(before)
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert np.array_equal(a, b)


def test_a_call_allocates_no_arrays() -> None:
    """Headers of arguments only, as many and as small for 216 cells as for one."""
    counts, sizes = [], []
    for n in (1, 6):
        body = solid(distorted((n, n, n)), (0,))
        work = viscous(body, SERIES[:1])
        out = np.empty_like(body.nodes)
        u = bend(body.nodes, 0.1)
        work.force(u, 0.1, out)
        _nrt_python.memsys_enable_stats()
        before = rtsys.get_allocation_stats().alloc
        tracemalloc.start()
        try:
            work.force(u, 0.1, out)
            sizes.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
            counts.append(rtsys.get_allocation_stats().alloc - before)
            _nrt_python.memsys_disable_stats()
    assert counts[0] == counts[1]
    # Measured under 2 kB; the forces of 216 cells alone are 41 kB.
    assert max(sizes) < 10_000


@pytest.mark.parametrize("n", [1, 3])
def test_restored_history_goes_on_with_the_same_bits(n: int) -> None:
    body = solid(distorted((n, n, 2 * n)), range(2))
    work = viscous(body, SERIES[:2])
    out, again = np.empty_like(body.nodes), np.empty_like(body.nodes)
    work.force(bend(body.nodes, 0.1), 0.1, out)
    kept = work.history()
    work.force(bend(body.nodes, 0.2), 0.1, out)
    assert not np.array_equal(kept["overstress"], work.history()["overstress"])
    other = viscous(body, SERIES[:2])
    other.restore(kept)
    for name, values in other.history().items():
        assert np.array_equal(values, kept[name])
    other.force(bend(body.nodes, 0.2), 0.1, again)
    assert np.array_equal(out, again)
    with pytest.raises(InputError, match="overstress must have shape"):
        other.restore({**kept, "overstress": kept["overstress"][:, :, :1]})
    with pytest.raises(InputError, match="got nothing"):
        other.restore({"overstress": kept["overstress"]})


def test_inverted_cells_harm_no_other() -> None:
    body, work = mixed()
    sound = viscous(body, SERIES)
    out, expected = np.empty_like(body.nodes), np.empty_like(body.nodes)
    u = bend(body.nodes, 0.1)
    for w in (work, sound):
        w.force(u, 0.1, out)
    # A corner pushed through its cell; the corner belongs to cell 0 only.
    corner = body.cells[0, 0]
    for bad in (1.5 * (body.nodes[body.cells[0, 6]] - body.nodes[corner]), np.full(3, np.nan)):
        hurt = u.copy()
        hurt[corner] += bad
        work.force(hurt, 0.1, out)
        sound.force(u, 0.1, expected)
        assert np.isfinite(out).all()
        for name, values in work.history().items():
            assert np.isfinite(values).all()
            assert np.array_equal(values[1:], sound.history()[name][1:])
    # The other cells' forces too.
    away = np.setdiff1d(np.arange(body.node_count), body.cells[0])
    assert np.array_equal(out[away], expected[away])
    # All eight points are bad with a NaN: the cell adds nothing.
    assert np.array_equal(out[corner], np.zeros(3))


def test_refused_input() -> None:
    body, work = mixed()
    out = np.empty_like(body.nodes)
    for dt in (-1e-3, math.nan):
        with pytest.raises(InputError, match="step must be >= 0"):
            work.force(out, dt, out)
    with pytest.raises(InputError, match="no cell's material"):
        viscous(body, [None] * 4)
    with pytest.raises(InputError, match="material row"):
        viscous(body, SERIES[:3])
    arrays = [body.cells, body.gradients, body.weights, body.material, body.mu, body.alpha, body.c]
    with pytest.raises(InputError, match="outside 0 to 62"):
        ViscousForce(63, *arrays, SERIES)
    with pytest.raises(InputError, match="gradients of shape"):
        ViscousForce(64, arrays[0][:5], *arrays[1:], SERIES)
    with pytest.raises(InputError, match="rows of mu"):
        ViscousForce(64, *arrays[:4], body.mu[:3], body.alpha, body.c, SERIES)
