"""Does the direct solver give the same bits for any thread count, and what does that cost?

    python benchmarks/solver_bits.py [--cells 18] [--threads 1 2] [--repeats 7] [--rounds 2]

A cube of `cells`**3 hexahedra (18: 20,577 unknowns) is factorised and solved in a process of its
own for each thread count and each of MKL's ways to repeat itself. Printed are the number of
different solutions seen over all processes and repeats, and the least times; the least is the
one to compare where other programs share the processor. "as shipped" is what `DirectSolver` asks
for; the others take that request back and rely on the environment instead.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time

import numpy as np

from flexapod.fem.body import SolidBody
from flexapod.fem.sparse import BlockPattern, DirectSolver
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import SolidMaterial
from flexapod.materials.neo_hooke import NeoHooke

# Name to MKL_CBWR; "as shipped" and "free" leave it alone.
WAYS = {
    "as shipped": "",
    "free": "",
    "MKL_CBWR=AUTO": "AUTO",
    "MKL_CBWR=AVX2,STRICT": "AVX2,STRICT",
    "MKL_CBWR=COMPATIBLE": "COMPATIBLE",
}


def body_of(n: int) -> SolidBody:
    """A cube of side 1 m, its nodes shaken by a tenth of a cell."""
    number = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    g = np.linspace(0.0, 1.0, n + 1)
    x = np.stack(np.meshgrid(g, g, g, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = (np.abs(x - 0.5) < 0.5 - 1e-9).all(axis=1)
    x[inner] += 0.1 / n * np.random.default_rng(1).uniform(-1.0, 1.0, (int(inner.sum()), 3))
    corners = ("000", "100", "110", "010", "001", "101", "111", "011")
    cells = [number[tuple(slice(int(k), n + int(k)) for k in c)].ravel() for c in corners]
    mesh = TaggedMesh(x, np.stack(cells, axis=1))
    return SolidBody(mesh, {"*": SolidMaterial(NeoHooke(1e5), 1000.0, 0.499)})


def measure(cells: int, way: str, repeats: int) -> dict[str, object]:
    """Digests of the matrix and of the solutions, and the least times [s], in this process."""
    body = body_of(cells)
    u = 5e-4 / cells * np.random.default_rng(0).standard_normal(body.nodes.shape)
    pattern = BlockPattern(body.cells, body.node_count)
    pattern.gather(body, body.element_tangents(u, body.predict_pressure(u, 0.0 * u)))
    fixed = np.repeat(np.isclose(body.nodes[:, 2], 0.0), 3)
    matrix = pattern.matrix(fixed)
    b = np.where(fixed, 0.0, np.random.default_rng(3).standard_normal(fixed.size))
    digests, first, again, solve = set(), [], [], []
    for _ in range(repeats):
        solver = DirectSolver()
        if way != "as shipped":
            solver._pardiso.set_iparm(34, 0)
        start = time.perf_counter()
        solver.factorise(matrix, pattern)
        analysed = time.perf_counter()
        solver.factorise(matrix, pattern)  # the pattern is known: numbers only
        factorised = time.perf_counter()
        digests.add(hashlib.sha256(solver.solve(b).tobytes()).hexdigest())
        solve.append(time.perf_counter() - factorised)
        first.append(analysed - start)
        again.append(factorised - analysed)
        solver.close()
    return {
        "matrix": hashlib.sha256(matrix.data.tobytes()).hexdigest(),
        "solutions": sorted(digests),
        "times": [min(first), min(again), min(solve)],
    }


def main() -> None:
    """Start the processes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=18)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--child", choices=list(WAYS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measure(options.cells, options.child, options.repeats)))
        return
    print(f"{3 * (options.cells + 1) ** 3} unknowns; times in ms: first, refactorise, solve")
    found: dict[tuple[str, int], list[dict[str, list[float]]]] = {}
    # Rounds are interleaved, so that a busy quarter of an hour does not fall on one way alone.
    for _ in range(options.rounds):
        for way, branch in WAYS.items():
            for threads in options.threads:
                environment = {k: v for k, v in os.environ.items() if k != "MKL_CBWR"}
                environment |= {"MKL_NUM_THREADS": str(threads), "MKL_DYNAMIC": "FALSE"}
                environment |= {"MKL_CBWR": branch} if branch else {}
                command = [sys.executable, __file__, "--child", way]
                command += ["--cells", str(options.cells), "--repeats", str(options.repeats)]
                done = subprocess.run(
                    command, env=environment, capture_output=True, text=True, check=True
                )
                found.setdefault((way, threads), []).append(json.loads(done.stdout))
    matrices = {run["matrix"] for runs in found.values() for run in runs}
    print(f"different matrices: {len(matrices)}")
    for way in WAYS:
        solutions = {s for t in options.threads for run in found[way, t] for s in run["solutions"]}
        print(f"{way:22} {len(solutions)} different solution(s)")
        for threads in options.threads:
            times = np.min([run["times"] for run in found[way, threads]], axis=0)
            alone = len({s for run in found[way, threads] for s in run["solutions"]})
            figures = "".join(f"{1e3 * t:10.1f}" for t in times)
            print(f"    {threads} thread(s) {figures}   {alone} solution(s)")


if __name__ == "__main__":
    main()
