"""The symmetric system matrix: a node-block pattern built once, and its direct solver."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp

from flexapod.core.errors import SolverError, Status
from flexapod.fem import kernels
from flexapod.fem.body import SolidBody


class BlockPattern:
    """Upper triangle of a symmetric matrix of 3x3 node blocks.

    Parameters
    ----------
    cells
        Hexahedra, shape (cell_count, 8): every pair of corners is coupled.
    node_count
        Number of nodes.
    extra
        Further coupled node sets (contact, loads), each of shape (item_count, k).
    """

    def __init__(
        self, cells: np.ndarray, node_count: int, extra: tuple[np.ndarray, ...] = ()
    ) -> None:
        keys = []
        for nodes in (cells, *extra):
            a, b = np.triu_indices(nodes.shape[1])
            first = nodes[:, a].ravel().astype(np.int64)
            second = nodes[:, b].ravel().astype(np.int64)
            low, high = np.minimum(first, second), np.maximum(first, second)
            keys.append(np.unique(low * node_count + high))
        key = np.unique(np.concatenate(keys))
        rows = key // node_count
        self.columns = (key % node_count).astype(np.int32)
        self.row_start = np.searchsorted(rows, np.arange(node_count + 1)).astype(np.int64)
        self.node_count = node_count
        self.blocks = np.zeros((key.size, 3, 3))
        self.block_position = np.empty((cells.shape[0], 8, 8), dtype=np.int32)
        kernels.find_block_positions(cells, self.row_start, self.columns, self.block_position)
        self._csr()

    def _csr(self) -> None:
        n = 3 * self.node_count
        counts = np.repeat(3 * np.diff(self.row_start), 3).reshape(-1, 3)
        # The diagonal block keeps its upper triangle only: row i drops i entries.
        counts = counts - np.arange(3)
        self.indptr = np.concatenate([[0], np.cumsum(counts.ravel())]).astype(np.int64)
        indices = np.empty(int(self.indptr[-1]), dtype=np.int32)
        for i in range(3):
            start = self.indptr[i:-1:3]
            length = counts[:, i]
            # Columns of row i: the node's own i..2, then the three of each later neighbour.
            first = np.repeat(3 * self.columns[self.row_start[:-1]], 1) + i
            offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
            node = np.repeat(np.arange(self.node_count), length)
            own = offset < 3 - i
            block = self.row_start[node] + (offset + i) // 3
            column = 3 * self.columns[block] + (offset + i) % 3
            column[own] = first[node[own]] + offset[own]
            indices[start[node] + offset] = column
        self.indices = indices
        self.data = np.empty(indices.size)
        self.shape = (n, n)

    def gather(self, body: SolidBody, tangents: np.ndarray) -> None:
        """Fill the blocks with the sum of element tangents (cell_count, 36, 3, 3)."""
        kernels.gather_tangents(
            tangents,
            body.cells,
            kernels.PAIR_OF,
            body.node_start,
            body.node_cell,
            self.row_start,
            self.block_position,
            self.blocks,
        )

    def add(self, nodes: np.ndarray, stiffness: np.ndarray) -> int:
        """Add symmetric matrices over node sets; return how many node pairs the pattern lacks."""
        return int(kernels.add_blocks(nodes, stiffness, self.row_start, self.columns, self.blocks))

    def add_diagonal(self, values: np.ndarray) -> None:
        """Add a scalar stiffness [N/m] to each node, shape (node_count,)."""
        first = self.row_start[:-1]
        for i in range(3):
            self.blocks[first, i, i] += values

    def matrix(self, fixed: np.ndarray) -> sp.csr_matrix:
        """Return the upper triangle with identity rows at `fixed` (bool, (3 node_count,))."""
        kernels.blocks_to_csr(
            self.blocks, self.row_start, self.columns, fixed, self.indptr, self.data
        )
        return sp.csr_matrix((self.data, self.indices, self.indptr), shape=self.shape, copy=False)

    def product(self, vector: np.ndarray) -> np.ndarray:
        """Product of the whole symmetric matrix with `vector` (node_count, 3)."""
        out = np.zeros((self.node_count, 3))
        kernels.blocks_product(self.blocks, self.row_start, self.columns, vector, out)
        return out


class DirectSolver:
    """Factorise a symmetric indefinite matrix given by its upper triangle.

    MKL Pardiso (mtype -2) where pypardiso can be had, with the symbolic phase kept while the
    pattern stays; else SuperLU, said once in a warning. Pardiso gives the same bits for any number
    of threads (on one kind of processor: MKL picks its code by the instructions it finds).
    """

    def __init__(self) -> None:
        self._pardiso: Any = None
        self._pattern: tuple[int, int] | None = None
        self._lu: Any = None
        self.negative_pivots = 0
        try:
            import pypardiso
        except (ImportError, OSError, RuntimeError):
            warnings.warn(
                "pypardiso is not available: falling back to SciPy's SuperLU, which is several "
                "times slower on meshes over 10,000 nodes",
                stacklevel=2,
            )
        else:
            self._pardiso = pypardiso.PyPardisoSolver(mtype=-2)
            self._pardiso.set_iparm(1, 1)
            self._pardiso.set_iparm(2, 2)  # METIS ordering: deterministic
            self._pardiso.set_iparm(8, 2)  # at most two steps of iterative refinement
            self._pardiso.set_iparm(10, 8)  # pivot perturbation 1e-8, for indefinite matrices
            self._pardiso.set_iparm(11, 0)  # no scaling and
            self._pardiso.set_iparm(13, 0)  # no matching: both need values in the symbolic phase
            # Without this two threads disagree with one, and on small matrices with themselves
            # from run to run; any value > 0 does (1, 2 and MKL_CBWR=AUTO give the same bits). The
            # factorisation stays parallel, the solve does not: benchmarks/solver_bits.py.
            self._pardiso.set_iparm(34, 1)

    def factorise(self, matrix: sp.csr_matrix, pattern: object) -> None:
        """Factorise; `pattern` is the object whose identity says the sparsity is unchanged."""
        if self._pardiso is None:
            from scipy.sparse.linalg import splu

            full = matrix + sp.triu(matrix, 1).T
            try:
                self._lu = splu(full.tocsc())
            except RuntimeError as error:
                raise SolverError(Status.SINGULAR, str(error)) from error
            return
        solver = self._pardiso
        dummy = np.zeros((matrix.shape[0], 1), order="F")
        key = (id(pattern), matrix.nnz)
        try:
            if key != self._pattern:
                solver.set_phase(11)
                solver._call_pardiso(matrix, dummy)
                self._pattern = key
            solver.set_phase(22)
            solver._call_pardiso(matrix, dummy)
        except Exception as error:
            self._pattern = None
            raise SolverError(Status.SINGULAR, f"factorisation failed: {error}") from error
        self._matrix = matrix
        self.negative_pivots = int(solver.get_iparm(23))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solve for `b` of shape (n,) with the last factorisation."""
        if self._pardiso is None:
            return np.asarray(self._lu.solve(b))
        self._pardiso.set_phase(33)
        rhs = np.asfortranarray(b.reshape(-1, 1))
        return np.asarray(self._pardiso._call_pardiso(self._matrix, rhs)).ravel()

    def close(self) -> None:
        """Free the factors."""
        if self._pardiso is not None:
            self._pardiso.free_memory(everything=True)
            self._pattern = None
