"""Time the explicit step: element updates a second, against the processor's peak and by size.

    python benchmarks/explicit.py [--largest 58] [--steps 200]

Cubes of three-term Ogden silicone (SoSpider paper), free, slightly deformed and moving: the whole
step (internal force, pressure on one side, kick, drift, energies), without contact. The peak is
that of a large matrix product in the same run. All times are the least of several runs.
"""

from __future__ import annotations

import argparse
import time

import numba
import numpy as np

from flexapod.dynamics.commands import Chamber, PressureTable, Table
from flexapod.dynamics.integrator import step
from flexapod.dynamics.model import Model
from flexapod.dynamics.stable import highest_frequency, stable_step
from flexapod.dynamics.workspace import Workspace
from flexapod.fem.body import SolidBody
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import SolidMaterial
from flexapod.materials.ogden import Ogden

LAW = Ogden((-0.6830e6, 0.8864e6, -0.1750e6), (5.1017, 5.1673, 5.4285))
# Counted in the machine code of the element's forces, see benchmarks/residual.py.
FLOPS_PER_ELEMENT = 7700.0


def cube(n: int) -> Model:
    """A cube of n x n x n hexahedra of 2 mm under pressure from below."""
    axis = np.arange(n + 1) * 2e-3
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    i = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    corners = ["000", "100", "110", "010", "001", "101", "111", "011"]
    cells = [i[tuple(slice(int(k), n + int(k)) for k in corner)].ravel() for corner in corners]
    side = i[:, :, 0]
    quads = [side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]]
    mesh = TaggedMesh(nodes, np.stack(cells, axis=-1))
    mesh = mesh.with_facet_group("cavity", np.stack(quads, axis=-1).reshape(-1, 4))
    body = SolidBody(mesh, {"*": SolidMaterial(LAW, 1080.0, 0.49)})
    faces = np.ascontiguousarray(mesh.facet_groups["cavity"])
    return Model(body, chambers=[Chamber("air", faces, PressureTable(Table.constant(1e3)))])


def seconds_per_step(n: int, steps: int) -> float:
    """Least mean time of a step over five runs of `steps`."""
    model = cube(n)
    u = 0.02 * np.sin(300.0 * model.nodes[:, [1, 2, 0]]) * 2e-3
    state, work = model.start(u), Workspace(model)
    dt = 0.8 * stable_step(highest_frequency(model, state, work), model)
    best = np.inf
    for run in range(6):
        began = time.perf_counter()
        for _ in range(steps):
            step(model, state, work, dt)
        if run:  # the first compiles
            best = min(best, (time.perf_counter() - began) / steps)
    return best


def peak() -> float:
    """Floating-point operations a second of a large matrix product."""
    n = 2000
    a = np.random.default_rng(0).standard_normal((n, n))
    best = np.inf
    for _ in range(5):
        began = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - began)
    return 2.0 * n**3 / best


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--largest", type=int, default=58, help="cells along the largest cube")
    parser.add_argument("--steps", type=int, default=200)
    options = parser.parse_args()
    sizes = [n for n in (13, 20, 27, 33, 46, 58) if n <= options.largest]
    print(f"{numba.get_num_threads()} threads")
    flops = peak()
    print(f"matrix product: {flops / 1e9:.1f} GFlop/s")
    rates = []
    for n in sizes:
        steps = max(5, int(options.steps * (13 / n) ** 3) + 3)
        each = seconds_per_step(n, steps)
        rates.append(n**3 / each)
        share = rates[-1] * FLOPS_PER_ELEMENT / flops
        print(
            f"{n**3:7d} elements: {1e3 * each:8.3f} ms a step, {rates[-1] / 1e6:6.2f} million "
            f"updates/s, {100 * share:.0f} % of the peak"
        )
    print(f"slowest over fastest: {max(rates) / min(rates):.2f}")


if __name__ == "__main__":
    main()
