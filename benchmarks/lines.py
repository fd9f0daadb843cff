"""Speed of a crawling ring on one core, over the number of nodes.

    NUMBA_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/lines.py

The same second of `ring_crawl` with 16, 32, 64 and 128 nodes, after one interval that compiles. A
large matrix product of the same process says how fast this core is today.
"""

from __future__ import annotations

import time

import numba
import numpy as np

from flexapod.app.case import load_case
from flexapod.app.motion_model import assemble_motion
from flexapod.dynamics.integrator import Options, march


def product_rate(size: int = 1500) -> float:
    """Floating-point operations a second of a matrix product."""
    a = np.random.default_rng(0).standard_normal((size, size))
    a @ a
    began = time.perf_counter()
    a @ a
    return 2.0 * size**3 / (time.perf_counter() - began)


def main() -> None:
    """Print a table."""
    print(f"{numba.get_num_threads()} thread; matrix product {product_rate() / 1e9:.1f} Gflop/s")
    print(f"{'nodes':>6} {'step':>9} {'of motion':>10} {'10 s of crawling':>17}")
    for nodes in (16, 32, 64, 128):
        motion = assemble_motion(
            load_case("ring_crawl", [f"ring.nodes={nodes}"]), None, lambda text: None
        )
        pace = Options(interval=0.02)
        march(motion.model, motion.state, motion.work, 1, pace)
        began = time.perf_counter()
        stats = march(motion.model, motion.state, motion.work, 51, pace)
        spent = time.perf_counter() - began
        step = 1e6 * spent / stats.steps
        print(f"{nodes:6d} {step:6.1f} us {1e6 / stats.steps:7.1f} us {10.0 * spent:15.1f} s")


if __name__ == "__main__":
    main()
