"""One place that says how numba compiles our kernels.

Numba's on-disk cache looks only at the file a kernel is written in: a cached kernel that calls
a function from another file keeps the old code when that file is edited. The cache folder is
therefore named after a digest of every kernel source of the package, so that any edit or
upgrade starts a fresh one.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def _kernel_digest() -> str:
    root = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(root.glob("*/*kernel*.py")) + [Path(__file__)]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    root = Path(base) / "flexapod" / "kernels"
    try:
        root.mkdir(parents=True, exist_ok=True)
        probe = root / f".write-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        # A read-only home (containers, shared clusters) must not stop the solver.
        root = Path(tempfile.gettempdir()) / "flexapod-kernels"
    return root


# Between parallel loops the other threads spin for some ten microseconds and then sleep. A step of
# an explicit run is ten short loops, and waking a thread costs as much as such a loop. But where
# another program wants a core too, long spinning takes it from the very thread that is waited for:
# on two busy cores, with the usual limit of milliseconds, a loop of 0.1 ms took 13 ms.
if not os.environ.get("OMP_WAIT_POLICY"):
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")

if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(_cache_root() / _kernel_digest())

# "contract" lets a*b + c become one rounding (fused multiply-add); it changes no result between
# runs or thread counts. Full fastmath is left off: it would let NaN checks be optimised away.
_FLAGS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a serial kernel, cached on disk."""
    return numba.njit(**_FLAGS)(function)


def inline_kernel(function: Callable[..., Any]) -> Any:
    """Compile a leaf that LLVM inlines into the kernels that call it."""
    return numba.njit(inline="never", **_FLAGS)(function)


def parallel_kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel with `numba.prange` loops, cached on disk.

    Each iteration of a `prange` here writes its own entries only, so the result is the same
    bits for any number of threads.
    """
    return numba.njit(parallel=True, **_FLAGS)(function)
