"""A soft body: mesh and materials to internal force and tangent.

scikit-fem supplies the mesh, the element and the gradients at the quadrature points; the hot
path runs in the kernels of this floor on flat arrays taken from that basis once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from skfem import Basis, ElementHex1, MeshHex

from flexapod.core.errors import InputError
from flexapod.fem import kernels
from flexapod.fem.residual_kernels import InternalForce
from flexapod.geometry.tagged import TaggedMesh
from flexapod.materials.law import SolidMaterial

# Reference corners (xi, eta, zeta) in {0, 1} of the VTK/Gmsh hexahedron.
_VTK_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)


def skfem_corner_order() -> np.ndarray:
    """Return `p` with ``skfem_cells = cells[:, p]`` for cells in VTK/Gmsh corner order."""
    corners = ElementHex1.doflocs.astype(int)
    return np.array([int(np.flatnonzero((x == _VTK_CORNERS).all(axis=1))[0]) for x in corners])


# Bulk modulus that acts point by point, over the shear modulus (see `flexapod.fem.kernels`).
# In bending, the strain energy within an element is G e:e = 2/3 G eps**2 where an incompressible
# strip has 2 G eps**2; the point part adds kappa_point/2 eps**2, so 8/3 G makes them equal.
POINT_BULK = 8.0 / 3.0


@dataclass(frozen=True)
class ElementFields:
    """Element results for pictures and files; see `SolidBody.fields`."""

    cauchy_stress: np.ndarray  # volume mean [Pa], shape (cell_count, 3, 3)
    pressure: np.ndarray  # minus a third of its trace [Pa], shape (cell_count,)
    principal_stretches: np.ndarray  # point mean, descending [-], shape (cell_count, 3)
    log_stretches: np.ndarray  # at every point, descending [-], shape (cell_count, 8, 3)


class SolidBody:
    """Eight-node hexahedra (Q1/P0) with one material per named cell group.

    Parameters
    ----------
    mesh
        The mesh; `mesh.cell_groups` names the groups.
    materials
        Group name to material; ``"*"`` takes every cell no other entry names.

    Raises
    ------
    InputError
        A group is unknown, a cell has no material or two, or a cell is flipped.
    """

    def __init__(self, mesh: TaggedMesh, materials: Mapping[str, SolidMaterial]) -> None:
        self.mesh = mesh
        self.nodes = np.ascontiguousarray(mesh.nodes, dtype=float)
        self.cells = np.ascontiguousarray(mesh.cells, dtype=np.int32)
        self.materials = list(materials.values())
        self.material = self._assign(mesh, materials)
        self._set_laws()
        self._set_quadrature()
        self._set_adjacency()
        self._forces = np.empty((self.cell_count, 8, 3))
        self._internal_force = InternalForce(
            self.nodes,
            self.cells,
            self.material,
            self.mu,
            self.alpha,
            self.c,
            self.kappa,
            self.kappa_point,
        )
        self._tangents: np.ndarray | None = None

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return int(self.nodes.shape[0])

    @property
    def cell_count(self) -> int:
        """Number of hexahedra."""
        return int(self.cells.shape[0])

    def _assign(self, mesh: TaggedMesh, materials: Mapping[str, SolidMaterial]) -> np.ndarray:
        row = np.full(self.cell_count, -1, dtype=np.int32)
        for index, group in enumerate(materials):
            if group == "*":
                continue
            if group not in mesh.cell_groups:
                known = ", ".join(sorted(mesh.cell_groups)) or "none"
                raise InputError(f"unknown cell group {group!r}; the mesh has: {known}")
            cells = mesh.cell_groups[group]
            taken = row[cells] >= 0
            if taken.any():
                raise InputError(f"cell {cells[taken][0]} is given two materials by {group!r}")
            row[cells] = index
        if "*" in materials:
            row[row < 0] = list(materials).index("*")
        if (row < 0).any():
            raise InputError(
                f"{int((row < 0).sum())} cells have no material; name their group or use '*'"
            )
        return row

    def _set_laws(self) -> None:
        laws = [m.law.parameters() for m in self.materials]
        terms = max(max((p.mu.size for p in laws), default=1), 1)
        # A padded term has mu = 0 and alpha = 2: it adds exactly nothing.
        self.mu = np.zeros((len(laws), terms))
        self.alpha = np.full((len(laws), terms), 2.0)
        self.c = np.zeros((len(laws), 3))
        for i, p in enumerate(laws):
            self.mu[i, : p.mu.size] = p.mu
            self.alpha[i, : p.alpha.size] = p.alpha
            self.c[i] = p.c
        shear = np.array([m.law.shear_modulus for m in self.materials])
        bulk = np.array([m.bulk_modulus for m in self.materials])
        self.kappa_point = np.minimum(POINT_BULK * shear, 0.5 * bulk)
        self.kappa = bulk - self.kappa_point
        self.density = np.array([m.density for m in self.materials])

    @cached_property
    def skfem_mesh(self) -> MeshHex:
        """The same mesh in scikit-fem (its own corner order, the same node numbers)."""
        return MeshHex(
            np.ascontiguousarray(self.nodes.T),
            np.ascontiguousarray(self.cells[:, skfem_corner_order()].T.astype(np.int64)),
            sort_t=False,
            validate=False,
        )

    def _set_quadrature(self) -> None:
        order = skfem_corner_order()
        points, weights = _gauss_points()
        self._check_shapes(points)
        basis = Basis(self.skfem_mesh, ElementHex1(), quadrature=(points, weights))
        self.weights = np.ascontiguousarray(basis.dx)
        gradients = np.empty((self.cell_count, 8, 8, 3))
        for k, corner in enumerate(order):
            gradients[:, :, corner, :] = basis.basis[k][0].grad.transpose(1, 2, 0)
        self.gradients = gradients

    def _check_shapes(self, points: np.ndarray) -> None:
        """Refuse cells without a positive volume, before scikit-fem stops at them unnamed."""
        jacobian = self.skfem_mesh.mapping().DF(points).transpose(2, 3, 0, 1)
        # Flat is judged against the cell's own edges: round-off leaves 1e-16 of their product.
        box = np.linalg.norm(jacobian, axis=-2).prod(axis=-1)
        bad = ~(np.linalg.det(jacobian) > 1e-12 * box)
        if bad.any():
            cell = int(np.flatnonzero(bad.any(axis=1))[0])
            raise InputError(f"cell {cell} is flipped or flat (its Jacobian is not positive)")

    def _set_adjacency(self) -> None:
        flat = self.cells.ravel()
        order = np.argsort(flat, kind="stable")
        self.node_cell = order.astype(np.int32)
        counts = np.bincount(flat, minlength=self.node_count)
        if (counts == 0).any():
            raise InputError(f"node {int(np.flatnonzero(counts == 0)[0])} belongs to no cell")
        self.node_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    @cached_property
    def cell_volume(self) -> np.ndarray:
        """Reference volumes [m3], shape (cell_count,)."""
        return np.asarray(self.weights.sum(axis=1))

    @cached_property
    def node_volume(self) -> np.ndarray:
        """Lumped reference volume per node [m3], shape (node_count,)."""
        return self.lump(np.ones(self.cell_count))

    @cached_property
    def node_mass(self) -> np.ndarray:
        """Lumped mass of the solid per node [kg], shape (node_count,)."""
        return self.lump(self.density[self.material])

    def lump(self, density: np.ndarray) -> np.ndarray:
        """Spread a per-cell density over the nodes, shape (node_count,)."""
        share = np.repeat(density * self.cell_volume / 8.0, 8)
        return np.bincount(self.cells.ravel(), weights=share, minlength=self.node_count)

    def internal_force(self, u: np.ndarray, out: np.ndarray) -> float:
        """Write the internal force [N] into `out` (node_count, 3); return the energy [J].

        The energy is infinite where an element is turned inside out; `least_j` says which.
        """
        return self._internal_force(u, out)

    @property
    def least_j(self) -> np.ndarray:
        """Least volume ratio of each element at the last `internal_force`, (cell_count,)."""
        return self._internal_force.least_j

    def predict_pressure(self, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Mean dU/dJ [Pa] linearised from `u` along `du`, shape (cell_count,)."""
        out = np.empty(self.cell_count)
        kernels.predict_pressure(
            u, du, self.cells, self.gradients, self.weights, self.material, self.kappa, out
        )
        return out

    def pressure_error_force(self, u: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Forces [N] of an independent `pressure` (cell_count,) minus the body's own dU/dJ."""
        kernels.pressure_error_forces(
            u,
            self.cells,
            self.gradients,
            self.weights,
            self.material,
            self.kappa,
            pressure,
            self._forces,
        )
        out = np.empty((self.node_count, 3))
        kernels.gather_forces(self._forces, self.node_start, self.node_cell, out)
        return out

    def element_tangents(self, u: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Return the tangent blocks [N/m], shape (cell_count, 36, 3, 3); overwritten next time.

        `pressure` [Pa] (cell_count,) enters the geometric part; see `predict_pressure`.
        """
        if self._tangents is None:
            self._tangents = np.empty((self.cell_count, kernels.PAIR_COUNT, 3, 3))
        kernels.element_tangents(
            u,
            self.cells,
            self.gradients,
            self.weights,
            self.material,
            self.mu,
            self.alpha,
            self.c,
            self.kappa_point,
            self.kappa,
            pressure,
            self._tangents,
        )
        return self._tangents

    def fields(self, u: np.ndarray) -> ElementFields:
        """Stress, pressure and stretches of every element at displacement `u` [m]."""
        cauchy = np.empty((self.cell_count, 3, 3))
        logs = np.empty((self.cell_count, 8, 3))
        pressure = np.empty(self.cell_count)
        kernels.element_fields(
            u,
            self.cells,
            self.gradients,
            self.weights,
            self.material,
            self.mu,
            self.alpha,
            self.c,
            self.kappa_point,
            self.kappa,
            cauchy,
            logs,
            pressure,
        )
        return ElementFields(cauchy, pressure, np.exp(logs).mean(axis=1), logs)


def _gauss_points() -> tuple[np.ndarray, np.ndarray]:
    """The 2x2x2 Gauss rule on the unit cube, points (3, 8)."""
    lo = 0.5 - 0.5 / np.sqrt(3.0)
    grid = np.array([lo, 1.0 - lo])
    points = np.stack(np.meshgrid(grid, grid, grid, indexing="ij")).reshape(3, 8)
    return points, np.full(8, 0.125)
