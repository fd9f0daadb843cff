"""Rigid bodies: what they weigh, how they resist turning, and which ways they may move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexapod.core.errors import InputError, check_positive

# Inertia counts as symmetric when its halves agree to this part of its largest entry: round-off
# of a quadrature over some thousand elements, far below any slip of the hand.
SYMMETRY = 1e-9
# Least principal moment over the largest entry: at 1e-12 a double precision matrix still holds
# the least moment to three digits, and a needle a hundred thousand times longer than thick passes.
LEAST_MOMENT = 1e-12

# Corners of the hexahedron (-1, 1)^3 in the cells' order; over sqrt(3) they are its Gauss points.
_SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]]
    + [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=np.float64,
)


@dataclass(frozen=True)
class RigidBodies:
    """What does not change about the rigid bodies of a run; the kernels take its arrays.

    Attributes
    ----------
    names
        One name per body, no two alike.
    mass
        Masses [kg], shape (body_count,).
    inertia
        Inertia about the centre of mass in body axes, which are the world axes at the start
        [kg m2], shape (body_count, 3, 3).
    free
        Whether a body may move along world x, y, z and turn about world x, y, z, shape
        (body_count, 6). Symmetry planes lock some; a locked axis takes any force or torque.
    """

    names: tuple[str, ...]
    mass: np.ndarray
    inertia: np.ndarray
    free: np.ndarray

    def __post_init__(self) -> None:
        names = tuple(self.names)
        count = len(names)
        if len(set(names)) != count:
            raise InputError(f"names of rigid bodies must differ, got {', '.join(names)}")
        mass = _array("mass", self.mass, (count,))
        inertia = _array("inertia", self.inertia, (count, 3, 3))
        free = np.array(self.free)
        if free.shape != (count, 6) or free.dtype != np.bool_:
            raise InputError(
                f"free must be True or False in shape {(count, 6)}, "
                f"got {free.dtype} in shape {free.shape}",
                "rigid bodies",
            )
        for k, name in enumerate(names):
            where = f"rigid body {name}"
            check_positive("mass", float(mass[k]), "kg", where)
            _check_inertia(inertia[k], where)
        # Copies: the caller's arrays may change later, a model may not.
        for field, value in (("names", names), ("mass", mass), ("inertia", inertia)):
            object.__setattr__(self, field, value)
        object.__setattr__(self, "free", np.ascontiguousarray(free))

    @classmethod
    def empty(cls) -> RigidBodies:
        """No bodies, for a run that has none."""
        return cls((), np.empty(0), np.empty((0, 3, 3)), np.empty((0, 6), dtype=np.bool_))

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.names)

    def initial_state(
        self, centres: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the state of bodies at rest with their centres of mass at `centres`.

        Parameters
        ----------
        centres
            Centres of mass [m], shape (body_count, 3).

        Returns
        -------
        rigid_x
            Centres [m], shape (body_count, 3).
        rigid_q
            Unit quaternions (w, x, y, z) from body to world axes, shape (body_count, 4).
        rigid_v
            Velocities of the centres [m/s], shape (body_count, 3).
        rigid_l
            Angular momenta about the centres, world axes [kg m2/s], shape (body_count, 3).
        """
        rigid_x = _array("centres", centres, (self.count, 3))
        for name, centre in zip(self.names, rigid_x, strict=True):
            if not np.isfinite(centre).all():
                raise InputError(f"centre must be finite, got {centre} m", f"rigid body {name}")
        rigid_q = np.zeros((self.count, 4))
        rigid_q[:, 0] = 1.0
        return rigid_x, rigid_q, np.zeros((self.count, 3)), np.zeros((self.count, 3))


def _array(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A float64 copy of `value` in C order, or `InputError` if its shape is another."""
    out = np.array(value, dtype=np.float64, order="C")
    if out.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {out.shape}", "rigid bodies")
    return out


def _check_inertia(inertia: np.ndarray, where: str) -> None:
    largest = np.abs(inertia).max()
    if not np.isfinite(largest):
        raise InputError(f"inertia must be finite, got {inertia.tolist()} kg m2", where)
    if np.abs(inertia - inertia.T).max() > SYMMETRY * largest:
        raise InputError(f"inertia must be symmetric, got {inertia.tolist()} kg m2", where)
    moments = np.linalg.eigvalsh(inertia)
    if not moments[0] > LEAST_MOMENT * largest:
        raise InputError(
            "inertia must be positive definite, got principal moments "
            f"{', '.join(f'{m:g}' for m in moments)} kg m2",
            where,
        )


def mass_properties(
    nodes: np.ndarray, cells: np.ndarray, density: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia of hexahedra of one density, by 2x2x2 Gauss points.

    Mass and centre are exact for trilinear hexahedra, the inertia for those with parallel faces
    (its integrand has degree 4 in each local coordinate, the rule integrates degree 3).

    Parameters
    ----------
    nodes
        Node positions [m], shape (node_count, 3).
    cells
        Corners of the hexahedra, shape (cell_count, 8).
    density
        Density [kg/m3].

    Returns
    -------
    mass
        Mass [kg].
    centre
        Centre of mass [m], shape (3,).
    inertia
        Inertia about `centre` along the axes of `nodes` [kg m2], shape (3, 3).
    """
    check_positive("density", density, "kg/m3")
    if not len(cells):
        raise InputError("mass properties need at least one hexahedron, got none")
    corners = nodes[cells]
    # About a point inside, so that a body far from the origin loses no digits.
    origin = corners.mean(axis=(0, 1))
    corners = corners - origin
    weights = np.empty((len(cells), 8))
    points = np.empty((len(cells), 8, 3))
    for p, point in enumerate(_SIGNS / math.sqrt(3.0)):
        factors = 1.0 + _SIGNS * point
        shape = factors.prod(axis=1) / 8.0
        gradient = np.stack(
            [_SIGNS[:, i] * factors[:, i - 1] * factors[:, i - 2] / 8.0 for i in range(3)]
        )
        weights[:, p] = density * np.linalg.det(np.einsum("ia,caj->cij", gradient, corners))
        points[:, p] = np.einsum("a,caj->cj", shape, corners)
    if not weights.min() > 0.0:
        cell = int(np.argmin(weights.min(axis=1)))
        raise InputError(f"hexahedron {cell} is folded or inside out")
    mass = float(weights.sum())
    centre = np.einsum("cp,cpi->i", weights, points) / mass
    points -= centre
    second = np.einsum("cp,cpi,cpj->ij", weights, points, points)
    return mass, centre + origin, _inertia_of(0.5 * (second + second.T))


def _inertia_of(second: np.ndarray) -> np.ndarray:
    """Inertia [kg m2] from the second moments of mass S = sum m r r^T: tr(S) 1 - S."""
    return np.asarray(np.trace(second) * np.eye(3) - second)


def box(size: tuple[float, float, float], density: float) -> tuple[float, np.ndarray]:
    """Mass [kg] and inertia [kg m2] about the centre of a box with edges `size` [m]."""
    for axis, length in zip("xyz", size, strict=True):
        check_positive(f"box size along {axis}", length, "m")
    mass = check_positive("density", density, "kg/m3") * math.prod(size)
    return mass, _inertia_of(mass / 12.0 * np.diag(np.square(size)))


def sphere(radius: float, density: float) -> tuple[float, np.ndarray]:
    """Mass [kg] and inertia [kg m2] about the centre of a full sphere, `radius` in [m]."""
    check_positive("sphere radius", radius, "m")
    mass = check_positive("density", density, "kg/m3") * 4.0 / 3.0 * math.pi * radius**3
    return mass, 0.4 * mass * radius**2 * np.eye(3)


def cylinder(
    radius: float, length: float, density: float, axis: int = 1
) -> tuple[float, np.ndarray]:
    """Mass and inertia of a full cylinder about its centre.

    Parameters
    ----------
    radius, length
        Radius and length along the axis [m].
    density
        Density [kg/m3].
    axis
        0, 1 or 2: the cylinder lies along x, y or z. The robots roll about y.

    Returns
    -------
    Mass [kg] and inertia [kg m2], shape (3, 3).
    """
    check_positive("cylinder radius", radius, "m")
    check_positive("cylinder length", length, "m")
    if axis not in (0, 1, 2):
        raise InputError(f"cylinder axis must be 0, 1 or 2, got {axis}")
    mass = check_positive("density", density, "kg/m3") * math.pi * radius**2 * length
    second = np.full(3, radius**2 / 4.0)
    second[axis] = length**2 / 12.0
    return mass, _inertia_of(mass * np.diag(second))
