"""Time the internal force (and the tangent) of 35,937 hexahedra, beside FElupe's.

    python benchmarks/residual.py [--cells 33] [--repeats 40] [--no-felupe] [--no-tangent]

A cube of `cells`**3 hexahedra of three-term Ogden silicone (SoSpider paper) under a smooth
deformation of about 30 % plus noise. All times are taken in one run and given as the least and
the median; the least is the one to compare where other programs share the processor.

FElupe (optional, ``pip install felupe tensortrax``) computes the same element with
``SolidBodyNearlyIncompressible``. Two differences: its Ogden law is written with 2 mu/alpha**2
instead of mu/alpha (the coefficients are converted), and its volumetric energy is
K/2 (J - 1)**2 instead of K/4 (J**2 - 1 - 2 ln J). The forces are therefore compared with a bulk
modulus near zero, where the formulations agree, and timed with the real one.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from flexapod.fem.residual_kernels import InternalForce

MU = np.array([[-0.6830e6, 0.8864e6, -0.1750e6]])  # [Pa]
ALPHA = np.array([[5.1017, 5.1673, 5.4285]])
C = np.zeros((1, 3))
SHEAR = float((MU * ALPHA).sum() / 2.0)
KAPPA = np.array([2.0 * SHEAR * 1.499 / (3.0 * 0.002)])  # Poisson's ratio 0.499

# Additions, multiplications, divisions and roots per element with three Ogden terms, a fused
# multiply-add being two: counted in the AVX-512 code LLVM made (the code has 0.7 arithmetic
# instructions per operation, since not every multiplication has an addition to go with).
FLOPS_PER_ELEMENT = 7700.0


def cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] and cells of a cube of side 0.1 m with slightly distorted cells."""
    g = np.linspace(0.0, 1.0, n + 1)
    x = np.stack(np.meshgrid(g, g, g, indexing="ij"), axis=-1).reshape(-1, 3)
    x += 0.05 / n * np.random.default_rng(1).uniform(-1, 1, x.shape)
    i = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    corners = ["000", "100", "110", "010", "001", "101", "111", "011"]
    cells = [i[tuple(slice(int(k), n + int(k)) for k in corner)].ravel() for corner in corners]
    return 0.1 * x, np.stack(cells, axis=-1)


def deformation(x: np.ndarray, n: int) -> np.ndarray:
    """Displacement [m]: smooth, about 30 % strain, with noise of 5 % of a cell."""
    noise = np.random.default_rng(0).uniform(-1, 1, x.shape)
    return 0.01 * np.sin(30.0 * x[:, [1, 2, 0]]) + 0.05 * 0.1 / n * noise


def clock(function: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Least and median wall time [s] after one call to warm up."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times), float(np.median(times))


def peak(size: int = 1200) -> float:
    """Floating-point rate [1/s] of a large matrix product with NumPy's threads.

    Many short products rather than few long ones, so that the least time finds a moment in
    which no other program has one of the processors, as it does for the kernel.
    """
    a = np.random.default_rng(2).random((size, size))
    b = a.copy()
    return 2.0 * size**3 / clock(lambda: a @ b, 60)[0]


def line(name: str, times: tuple[float, float], note: str = "") -> None:
    print(f"{name:<44}{1e3 * times[0]:10.2f}{1e3 * times[1]:10.2f}  {note}")


def bench_force(
    x: np.ndarray, cells: np.ndarray, u: np.ndarray, repeats: int
) -> tuple[InternalForce, float]:
    """Time the kernel at each thread count; return it and its best time [s]."""
    work = InternalForce(x, cells, np.zeros(len(cells)), MU, ALPHA, C, KAPPA)
    out = np.empty_like(x)
    most = numba.get_num_threads()
    best = np.inf
    for threads in sorted({1, most}):
        numba.set_num_threads(threads)
        times = clock(lambda: work(u, out), repeats)
        rate = len(cells) / times[0]
        flops = FLOPS_PER_ELEMENT * rate
        note = f"{rate / 1e6:.2f} million elements/s, {flops / 1e9:.0f} Gflop/s"
        line(f"flexapod force, {threads} thread(s)", times, note)
        best = min(best, times[0])
    numba.set_num_threads(most)
    return work, best


def bench_felupe(
    x: np.ndarray, cells: np.ndarray, u: np.ndarray, tangent: bool
) -> tuple[float, float]:
    """Time FElupe's vector and matrix [s] and compare the forces; nan where it is missing."""
    try:
        import felupe  # type: ignore[import-untyped]
        import felupe.constitution.tensortrax as law  # type: ignore[import-untyped]
    except ImportError as error:
        print(f"FElupe is not here ({error}); install it with: pip install felupe tensortrax")
        return np.nan, np.nan
    mesh = felupe.Mesh(x, cells, "hexahedron")
    field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
    field[0].values[:] = u
    material = law.Hyperelastic(
        law.models.hyperelastic.ogden, mu=list(MU[0] * ALPHA[0] / 2.0), alpha=list(ALPHA[0])
    )
    soft = 1e-3
    body = felupe.SolidBodyNearlyIncompressible(material, field, bulk=soft)
    theirs = body.assemble.vector(field).toarray().reshape(-1, 3)
    ours = np.empty_like(x)
    InternalForce(x, cells, np.zeros(len(cells)), MU, ALPHA, C, np.array([soft]))(u, ours)
    difference = np.abs(ours - theirs).max() / np.abs(theirs).max()
    body = felupe.SolidBodyNearlyIncompressible(material, field, bulk=float(KAPPA[0]))
    vector = clock(lambda: body.assemble.vector(field), 3)
    line(f"FElupe {felupe.__version__} vector", vector, f"forces differ by {difference:.1e}")
    if not tangent:
        return vector[0], np.nan
    matrix = clock(lambda: body.assemble.matrix(field), 1)
    line(f"FElupe {felupe.__version__} matrix", matrix)
    return vector[0], matrix[0]


def bench_tangent(x: np.ndarray, cells: np.ndarray, u: np.ndarray, repeats: int) -> float:
    """Time `SolidBody`'s tangent with assembly [s], checked against differences of the force."""
    from flexapod.fem.body import SolidBody
    from flexapod.fem.sparse import BlockPattern
    from flexapod.geometry.tagged import TaggedMesh
    from flexapod.materials.law import SolidMaterial
    from flexapod.materials.ogden import Ogden

    material = SolidMaterial(Ogden(tuple(MU[0]), tuple(ALPHA[0])), density=1080.0, poisson=0.499)
    body = SolidBody(TaggedMesh(x, cells), {"*": material})
    pattern = BlockPattern(body.cells, body.node_count)
    fixed = np.zeros(3 * body.node_count, dtype=bool)
    pressure = body.predict_pressure(u, np.zeros_like(u))

    def assemble() -> None:
        pattern.gather(body, body.element_tangents(u, pressure))
        pattern.matrix(fixed)

    times = clock(assemble, max(3, repeats // 10))
    v = np.random.default_rng(4).normal(size=x.shape)
    h = 1e-7 * np.abs(x).max()
    ahead, behind = np.empty_like(x), np.empty_like(x)
    work = InternalForce(
        x,
        cells,
        body.material,
        body.mu,
        body.alpha,
        body.c,
        body.kappa,
        getattr(body, "kappa_point", None),
    )
    work(u + h * v, ahead)
    work(u - h * v, behind)
    slope = (ahead - behind) / (2.0 * h)
    error = np.abs(pattern.product(v) - slope).max() / np.abs(slope).max()
    line("flexapod tangent and assembly", times, f"against differences {error:.1e}")
    ours, theirs = np.empty_like(x), np.empty_like(x)
    same = clock(lambda: work(u, ours), repeats)
    line("flexapod force of the body", same, "with its point-wise bulk modulus")
    scalar = clock(lambda: body.internal_force(u, theirs), max(3, repeats // 10))
    error = np.abs(ours - theirs).max() / np.abs(theirs).max()
    line("SolidBody.internal_force", scalar, f"differs by {error:.1e}")
    return times[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=int, default=33, help="cells along an edge")
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--no-felupe", action="store_true")
    parser.add_argument("--no-tangent", action="store_true")
    options = parser.parse_args()
    x, cells = cube(options.cells)
    u = deformation(x, options.cells)
    start = time.perf_counter()
    InternalForce(x[cells[0]], np.arange(8)[None], np.zeros(1), MU, ALPHA, C, KAPPA)(
        np.zeros((8, 3)), np.empty((8, 3))
    )
    print(f"first call (compiled or from the cache): {time.perf_counter() - start:.1f} s")
    print(f"{len(cells)} hexahedra, {len(x)} nodes, {os.cpu_count()} processors")
    print(f"{'':<44}{'least ms':>10}{'median ms':>10}")
    before = peak()
    work, force = bench_force(x, cells, u, options.repeats)
    vector = matrix = tangent = np.nan
    if not options.no_felupe:
        vector, matrix = bench_felupe(x, cells, u, not options.no_tangent)
    # Once more: what else ran on the machine may have changed meanwhile.
    force = min(force, bench_force(x, cells, u, options.repeats)[1])
    if not options.no_tangent:
        tangent = bench_tangent(x, cells, u, options.repeats)
    top = max(before, peak())
    print(f"least J of the deformation: {work.least_j.min():.3f}")
    rate = len(cells) / force
    flops = FLOPS_PER_ELEMENT * rate
    print(
        f"force: {rate / 1e6:.2f} million element updates/s, {flops / 1e9:.0f} Gflop/s, "
        f"{100.0 * flops / top:.0f} % of the matrix product's {top / 1e9:.0f}"
    )
    if np.isfinite(vector):
        print(f"force: {vector / force:.0f} times faster than FElupe (aim 80)")
    if np.isfinite(matrix) and np.isfinite(tangent):
        print(f"tangent: {matrix / tangent:.1f} times faster than FElupe (aim 5)")


if __name__ == "__main__":
    main()
