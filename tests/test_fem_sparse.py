"""`BlockPattern` against dense assembly, and the solver with and without Pardiso."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from statics_helpers import distorted, solid

from flexapod.core.errors import SolverError
from flexapod.fem import kernels
from flexapod.fem.body import SolidBody
from flexapod.fem.sparse import BlockPattern, DirectSolver
from flexapod.materials.neo_hooke import NeoHooke


@pytest.fixture(scope="module")
def body() -> SolidBody:
    return solid(distorted((2, 2, 2)), NeoHooke(1e5))


def _state(body: SolidBody) -> np.ndarray:
    return 0.02 * np.random.default_rng(0).standard_normal(body.nodes.shape)


def _tangents(body: SolidBody) -> np.ndarray:
    u = _state(body)
    return body.element_tangents(u, body.predict_pressure(u, 0.0 * u)).copy()


def _dense(body: SolidBody, tangents: np.ndarray) -> np.ndarray:
    n = body.node_count
    out = np.zeros((n, 3, n, 3))
    for e, cell in enumerate(body.cells):
        for k in range(kernels.PAIR_COUNT):
            a, b = kernels.PAIR_A[k], kernels.PAIR_B[k]
            out[cell[a], :, cell[b], :] += tangents[e, k]
            if a != b:
                out[cell[b], :, cell[a], :] += tangents[e, k].T
    return out.reshape(3 * n, 3 * n)


def _filled(body: SolidBody, extra: tuple[np.ndarray, ...] = ()) -> tuple[BlockPattern, np.ndarray]:
    tangents = _tangents(body)
    pattern = BlockPattern(body.cells, body.node_count, extra)
    pattern.gather(body, tangents)
    return pattern, _dense(body, tangents)


def test_matrix_equals_dense_assembly(body: SolidBody) -> None:
    pattern, dense = _filled(body)
    assert np.abs(dense - dense.T).max() < 1e-12 * np.abs(dense).max()
    matrix = pattern.matrix(np.zeros(3 * body.node_count, dtype=bool))
    assert matrix.has_sorted_indices
    np.testing.assert_allclose(matrix.toarray(), np.triu(dense), atol=1e-13 * np.abs(dense).max())
    v = np.random.default_rng(1).standard_normal(body.nodes.shape)
    np.testing.assert_allclose(
        pattern.product(v).ravel(), dense @ v.ravel(), atol=1e-12 * np.abs(dense).max()
    )


def test_fixed_rows_become_identity(body: SolidBody) -> None:
    pattern, dense = _filled(body)
    fixed = np.zeros(3 * body.node_count, dtype=bool)
    fixed[[0, 4, 17, 30]] = True
    dense[fixed] = 0.0
    dense[:, fixed] = 0.0
    dense[fixed, fixed] = 1.0
    got = pattern.matrix(fixed).toarray()
    np.testing.assert_allclose(got, np.triu(dense), atol=1e-13 * np.abs(dense).max())


def test_added_matrices_and_missing_pairs(body: SolidBody) -> None:
    far = np.array([[0, 13, 26, 13], [26, 0, 5, 7]])
    k = np.random.default_rng(2).standard_normal((2, 12, 12))
    k += k.transpose(0, 2, 1)
    pattern, dense = _filled(body, (far,))
    assert pattern.add(far, k) == 0
    size = body.node_count
    cube = dense.reshape(size, 3, size, 3)
    for nodes, matrix in zip(far, k, strict=True):
        for a in range(4):
            for b in range(4):
                block = matrix[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                cube[nodes[a], :, nodes[b], :] += block
    v = np.random.default_rng(1).standard_normal(body.nodes.shape)
    expected = cube.reshape(3 * size, -1) @ v.ravel()
    np.testing.assert_allclose(
        pattern.product(v).ravel(), expected, atol=1e-12 * np.abs(expected).max()
    )
    # Without the extra coupling, pairs 0-26, 0-5... of the items are counted as missing.
    bare, _ = _filled(body)
    assert bare.add(far, k) > 0


def test_diagonal(body: SolidBody) -> None:
    pattern, dense = _filled(body)
    values = np.arange(1.0, body.node_count + 1.0)
    pattern.add_diagonal(values)
    dense += np.diag(np.repeat(values, 3))
    got = pattern.matrix(np.zeros(3 * body.node_count, dtype=bool)).toarray()
    np.testing.assert_allclose(got, np.triu(dense), atol=1e-13 * np.abs(dense).max())


def _solved(solver: DirectSolver, body: SolidBody) -> np.ndarray:
    pattern, _ = _filled(body)
    fixed = np.zeros((body.node_count, 3), dtype=bool)
    fixed[np.isclose(body.nodes[:, 2], 0.0)] = True
    b = np.where(fixed, 0.0, np.random.default_rng(3).standard_normal(fixed.shape)).ravel()
    solver.factorise(pattern.matrix(fixed.ravel()), pattern)
    x = solver.solve(b)
    full = pattern.matrix(fixed.ravel()).toarray()
    full = full + np.triu(full, 1).T
    # Backward error: round-off times the size of the matrix, measured 1e-15.
    assert np.abs(full @ x - b).max() < 1e-11 * np.abs(full).max() * np.abs(x).max()
    solver.close()
    return x


def test_superlu_fallback_equals_pardiso(body: SolidBody, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pypardiso")
    with_pardiso = _solved(DirectSolver(), body)
    monkeypatch.setitem(sys.modules, "pypardiso", None)
    with pytest.warns(UserWarning, match="falling back to SciPy's SuperLU"):
        solver = DirectSolver()
    # Condition of the matrix (1e4) times round-off.
    np.testing.assert_allclose(_solved(solver, body), with_pardiso, rtol=1e-8, atol=1e-14)


def test_superlu_names_a_singular_matrix(body: SolidBody, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypardiso", None)
    with pytest.warns(UserWarning, match="SuperLU"):
        solver = DirectSolver()
    pattern = BlockPattern(body.cells, body.node_count)
    with pytest.raises(SolverError, match="singular"):
        solver.factorise(pattern.matrix(np.zeros(3 * body.node_count, dtype=bool)), pattern)


# Run in a process of its own: MKL reads its thread count once. Three factorisations each, as two
# threads did not even agree with themselves.
BITS = """
import sys
sys.path[:0] = sys.argv[1:]
import hashlib
import numpy as np
from statics_helpers import distorted, solid
from flexapod.fem.sparse import BlockPattern, DirectSolver
from flexapod.materials.neo_hooke import NeoHooke

body = solid(distorted((6, 6, 6)), NeoHooke(1e5))
pattern = BlockPattern(body.cells, body.node_count)
u = np.zeros_like(body.nodes)
pattern.gather(body, body.element_tangents(u, body.predict_pressure(u, u)))
fixed = np.repeat(np.isclose(body.nodes[:, 2], 0.0), 3)
b = np.where(fixed, 0.0, np.random.default_rng(3).standard_normal(fixed.size))
matrix = pattern.matrix(fixed)
print(hashlib.sha256(matrix.data.tobytes()).hexdigest())
for _ in range(3):
    solver = DirectSolver()
    solver.factorise(matrix, pattern)
    print(hashlib.sha256(solver.solve(b).tobytes()).hexdigest())
    solver.close()
"""


def test_pardiso_gives_the_same_bits_for_any_thread_count() -> None:
    pytest.importorskip("pypardiso")
    helpers = str(Path(__file__).parent / "verification" / "helpers")
    matrices, solutions = set(), set()
    for threads in ("1", "2"):
        # Two threads even where MKL sees one processor; no wish of the user's to repeat itself.
        environment = {k: v for k, v in os.environ.items() if k != "MKL_CBWR"}
        environment |= {"MKL_NUM_THREADS": threads, "MKL_DYNAMIC": "FALSE"}
        done = subprocess.run(
            [sys.executable, "-c", BITS, helpers],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        matrix, *digests = done.stdout.split()
        assert len(digests) == 3
        matrices.add(matrix)
        solutions.update(digests)
    assert len(matrices) == 1
    assert len(solutions) == 1


def test_negative_pivots_count_unstable_directions(body: SolidBody) -> None:
    pytest.importorskip("pypardiso")
    pattern, dense = _filled(body)
    fixed = np.zeros((body.node_count, 3), dtype=bool)
    fixed[np.isclose(body.nodes[:, 2], 0.0)] = True
    free = ~fixed.ravel()
    values = np.linalg.eigvalsh(dense[np.ix_(free, free)])
    # Shifted between the third and the fourth eigenvalue: exactly three turn negative.
    pattern.add_diagonal(np.full(body.node_count, -0.5 * float(values[2] + values[3])))
    solver = DirectSolver()
    solver.factorise(pattern.matrix(fixed.ravel()), pattern)
    assert solver.negative_pivots == 3
    solver.close()
