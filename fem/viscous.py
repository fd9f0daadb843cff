"""Material viscoelasticity of a soft body: the overstress of a Prony series and its history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numba
import numpy as np

from flexapod.core.errors import InputError
from flexapod.fem.element_kernels import R, aligned, pack_laws, scratch_size
from flexapod.fem.kernels import gather_forces
from flexapod.fem.lane_kernels import LANES
from flexapod.fem.viscous_kernels import branch_factors, viscous_forces
from flexapod.materials.prony import Prony


class ViscousForce:
    """Viscous internal force of eight-node hexahedra, to be added to the elastic one.

    The elastic force stays that of the long-term law; this adds the isochoric stress that has
    not relaxed yet (see `fem.viscous_kernels`). Arrays are those of `SolidBody`, of all its
    cells or of some.

    The overstress makes the body stiffer for quick motion, by up to `stiffening`: an explicit
    step that is stable for the long-term law must be shortened by its square root.

    Parameters
    ----------
    node_count
        Nodes of the body.
    cells
        Corners in VTK order, shape (cell_count, 8).
    gradients
        Reference gradients of the shape functions [1/m], shape (cell_count, 8, 8, 3): element,
        point, corner, direction.
    weights
        Of the points [m3], shape (cell_count, 8).
    material
        Row of the law arrays per cell, shape (cell_count,). Cells of one material next to each
        other are fastest.
    mu, alpha, c
        Laws as in `SolidBody`, [Pa], [-], [Pa], shapes (material_count, term_count), the same
        and (material_count, 3).
    prony
        Series per material row, or None where a material is only elastic.

    Attributes
    ----------
    active
        Rows of `cells` with a series, shape (active_count,). The others cost nothing.
    stiffening
        Instantaneous over long-term modulus [-], shape (material_count,).
    """

    def __init__(
        self,
        node_count: int,
        cells: np.ndarray,
        gradients: np.ndarray,
        weights: np.ndarray,
        material: np.ndarray,
        mu: np.ndarray,
        alpha: np.ndarray,
        c: np.ndarray,
        prony: Sequence[Prony | None],
    ) -> None:
        cells = np.asarray(cells)
        material = np.asarray(material)
        count = cells.shape[0]
        if gradients.shape != (count, 8, 8, 3) or weights.shape != (count, 8):
            raise InputError(
                f"{count} cells need gradients of shape ({count}, 8, 8, 3) and weights of "
                f"({count}, 8), got {gradients.shape} and {weights.shape}"
            )
        if count and not (cells.min() >= 0 and cells.max() < node_count):
            raise InputError(f"cells name nodes outside 0 to {node_count - 1}")
        if material.shape != (count,) or (
            count and not (material.min() >= 0 and material.max() < len(prony))
        ):
            raise InputError(
                f"each cell needs a material row from 0 to {len(prony) - 1}, one series (or None) "
                "each"
            )
        if not len(prony) == np.shape(mu)[0] == np.shape(alpha)[0] == np.shape(c)[0]:
            raise InputError(f"{len(prony)} series need as many rows of mu, alpha and c")
        has_series = np.array([p is not None for p in prony], dtype=bool)
        self.active = np.flatnonzero(has_series[material])
        if not self.active.size:
            raise InputError("no cell's material has a Prony series: leave the viscous force out")
        self.stiffening = np.array([1.0 if p is None else p.instantaneous for p in prony])
        self._cells = np.ascontiguousarray(cells[self.active], dtype=np.int32)
        self._material = np.ascontiguousarray(material[self.active], dtype=np.int32)
        flat = self._cells.ravel()
        self._node_cell = np.argsort(flat, kind="stable").astype(np.int32)
        counts = np.bincount(flat, minlength=node_count)
        self._node_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._shear = (
            0.5 * (np.asarray(mu) * np.asarray(alpha)).sum(axis=1) + 2.0 * np.asarray(c)[:, 0]
        )
        self._laws = pack_laws(self._material, mu, alpha, c)
        self._set_branches(prony)
        self._set_points(gradients, weights)
        self._force = aligned(self.active.size, 24)
        threads = int(numba.config.NUMBA_NUM_THREADS)
        size = scratch_size(self._laws.mu.shape[1], self._moduli.shape[1])
        self._scratch = aligned(threads, -(-size // 8) * 8)

    @property
    def branch_count(self) -> int:
        """Most branches any material has."""
        return int(self._moduli.shape[1])

    def _set_branches(self, prony: Sequence[Prony | None]) -> None:
        most = max(len(p.times) for p in prony if p is not None)
        self._moduli = np.zeros((len(prony), most))
        self._times = np.ones((len(prony), most))
        for m, series in enumerate(prony):
            if series is not None:
                self._moduli[m, : len(series.moduli)] = series.moduli
                self._times[m, : len(series.times)] = series.times
        self._factors = np.zeros((len(prony), most, 2))

    def _set_points(self, gradients: np.ndarray, weights: np.ndarray) -> None:
        count = self.active.size
        batches = self._laws.plan.shape[0]
        # The last batch is filled up with its last cell.
        padded = self.active[np.minimum(np.arange(batches * LANES), count - 1)]
        self._gradients = aligned(batches, 8 * 24 * LANES)
        self._weights = aligned(batches, 8 * LANES)
        lanes_last = gradients[padded].reshape(batches, LANES, 192).transpose(0, 2, 1)
        self._gradients[:] = lanes_last.reshape(batches, -1)
        self._weights[:] = (
            weights[padded].reshape(batches, LANES, 8).transpose(0, 2, 1).reshape(batches, -1)
        )
        self._history = aligned(batches, 6 * (1 + self.branch_count) * R)

    def force(self, u: np.ndarray, dt: float, out: np.ndarray) -> None:
        """Advance the history by `dt` [s] to displacement `u` [m]; write the force [N] into `out`.

        Both arrays have shape (node_count, 3), contiguous. `out` receives an internal force, all
        of it overwritten; it has the same bits for any number of threads. An infinite `dt` lets
        all overstress relax at `u`, for a motion that starts from a deformed body at rest. Points
        turned inside out add no force and keep their stress; the elastic force reports them.
        """
        if not dt >= 0.0:
            raise InputError(f"the step must be >= 0, got {dt:g} s")
        branch_factors(self._moduli, self._times, dt, self._factors)
        viscous_forces(
            LANES,
            u.reshape(-1),
            self._cells,
            self._laws,
            self._factors,
            self._gradients,
            self._weights,
            self._history,
            self._scratch,
            self._force,
        )
        gather_forces(self._force.reshape(-1, 8, 3), self._node_start, self._node_cell, out)

    def stored_energy(self) -> float:
        """Energy [J] in the springs of the branches, exact in the limit of small strains.

        ``sum_q w_q sum_i Q_i : Q_i / (4 g_i G)`` with the long-term law's small-strain modulus
        G; at finite strain an estimate. The rest of the work of `force` has become heat.
        """
        q = self._points(self._history)[:, :, 1:]
        square = (q[..., :3] ** 2).sum(axis=-1) + 2.0 * (q[..., 3:] ** 2).sum(axis=-1)
        modulus = 4.0 * (self._moduli * self._shear[:, None])[self._material]
        # Padding holds no stress.
        density = (square / np.where(modulus == 0.0, 1.0, modulus)[:, None, :]).sum(axis=-1)
        weights = self._weights.reshape(-1, 8, LANES).transpose(0, 2, 1).reshape(-1, 8)
        return float((density * weights[: self.active.size]).sum())

    def history(self) -> dict[str, np.ndarray]:
        """Return what `restore` needs to go on, element by element.

        "stress": S of the long-term law [Pa], shape (active_count, 8, 6), and "overstress": Q_i
        [Pa], shape (active_count, 8, branch_count, 6); components 00, 11, 22, 01, 02, 12.
        """
        rows = self._points(self._history)
        return {"stress": rows[:, :, 0].copy(), "overstress": rows[:, :, 1:].copy()}

    def restore(self, history: Mapping[str, np.ndarray]) -> None:
        """Take a `history` of the same cells and series."""
        shapes = {
            "stress": (self.active.size, 8, 6),
            "overstress": (self.active.size, 8, self.branch_count, 6),
        }
        for name, shape in shapes.items():
            if name not in history or history[name].shape != shape:
                got = history[name].shape if name in history else "nothing"
                raise InputError(
                    f"the kept viscous {name} must have shape {shape}, got {got}: it belongs to "
                    "another body or another series"
                )
        rows = np.concatenate([history["stress"][:, :, None], history["overstress"]], axis=2)
        batches = self._laws.plan.shape[0]
        padded = np.minimum(np.arange(batches * LANES), self.active.size - 1)
        # (batch, lane, point, part, component) to (batch, part, component, point, lane).
        split = rows[padded].reshape(batches, LANES, 8, -1, 6).transpose(0, 3, 4, 2, 1)
        kept = self._history.reshape(batches, -1, R)[:, :, : 8 * LANES]
        kept[:] = split.reshape(batches, -1, 8 * LANES)

    def _points(self, rows: np.ndarray) -> np.ndarray:
        """Rows of the kernel as (active_count, 8, 1 + branch_count, 6)."""
        batches = self._laws.plan.shape[0]
        kept = rows.reshape(batches, -1, 6, R)[..., : 8 * LANES]
        split = kept.reshape(batches, -1, 6, 8, LANES).transpose(0, 4, 3, 1, 2)
        return split.reshape(batches * LANES, 8, -1, 6)[: self.active.size]
