"""Shapes of a rigid ground at rest: plane, slope, step and height field, each with its friction.

Every shape packs itself into ``(kind, params, heights)`` for `contact.ground_kernels`, so that
one compiled kernel serves them all. z points up; friction is zero until it is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from flexapod.contact.ground_kernels import HEIGHT_FIELD, PLANE, STEP
from flexapod.contact.law import FrictionLaw
from flexapod.core.errors import InputError, check_finite, check_positive

Packed: TypeAlias = tuple[int, np.ndarray, np.ndarray]


def _frictionless() -> FrictionLaw:
    return FrictionLaw.constant(0.0)


def _packed(kind: int, params: Sequence[float], heights: np.ndarray | None = None) -> Packed:
    full = np.zeros(8)
    full[: len(params)] = params
    return kind, full, np.zeros((1, 1)) if heights is None else heights


def _vector(name: str, values: Sequence[float]) -> tuple[float, float, float]:
    if len(values) != 3:
        raise InputError(f"{name} needs 3 numbers, got {len(values)}")
    x, y, z = (check_finite(name, float(value)) for value in values)
    return x, y, z


@dataclass(frozen=True)
class Plane:
    """Half space below a plane.

    Attributes
    ----------
    point
        A point of the plane [m].
    normal
        Points out of the ground; any length, kept with length one.
    friction
        Friction between this ground and whatever touches it.
    """

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    friction: FrictionLaw = field(default_factory=_frictionless)

    def __post_init__(self) -> None:
        x, y, z = _vector("normal of the plane", self.normal)
        size = math.sqrt(x * x + y * y + z * z)
        if not (math.isfinite(size) and size > 0.0):
            raise InputError(f"normal of the plane must have a length, got {(x, y, z)}")
        object.__setattr__(self, "point", _vector("point of the plane", self.point))
        object.__setattr__(self, "normal", (x / size, y / size, z / size))

    def packed(self) -> Packed:
        """Kind, params (8,) and heights for the kernels."""
        return _packed(PLANE, [*self.point, *self.normal])


def slope(
    angle: float,
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    friction: FrictionLaw | None = None,
) -> Plane:
    """Return the plane through `point` that falls along +x by `angle` [rad].

    Its normal is (sin a, 0, cos a): under gravity along -z a body slides to +x for a > 0.
    """
    if not abs(angle) < 0.5 * math.pi:
        raise InputError(
            f"angle of the slope must lie within -90 and 90 degrees, got {angle:g} rad"
        )
    normal = (math.sin(angle), 0.0, math.cos(angle))
    return Plane(point, normal, _frictionless() if friction is None else friction)


@dataclass(frozen=True)
class Step:
    """Ground at z = 0 that rises to `height` [m] at the riser `x` [m] and stays there for +x."""

    x: float
    height: float
    friction: FrictionLaw = field(default_factory=_frictionless)

    def __post_init__(self) -> None:
        check_finite("x of the step", self.x, "m")
        check_positive("height of the step", self.height, "m")

    def packed(self) -> Packed:
        """Kind, params (8,) and heights for the kernels."""
        return _packed(STEP, [self.x, self.height])


# Two fields of arrays have no single truth value: they are compared as objects.
@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights on a square grid, bilinear between; beyond the rim its height continues level.

    Attributes
    ----------
    x0, y0
        Position of ``heights[0, 0]`` [m].
    spacing
        Distance of neighbours along x and along y [m].
    heights
        z [m], shape (nx, ny), at least 2 by 2; ``heights[i, j]`` stands at x0 + i spacing and
        y0 + j spacing. Kept as a read-only copy.
    friction
        Friction between this ground and whatever touches it.
    """

    x0: float
    y0: float
    spacing: float
    heights: np.ndarray
    friction: FrictionLaw = field(default_factory=_frictionless)

    def __post_init__(self) -> None:
        check_finite("x0 of the height field", self.x0, "m")
        check_finite("y0 of the height field", self.y0, "m")
        check_positive("spacing of the height field", self.spacing, "m")
        try:
            heights = np.array(self.heights, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise InputError(f"heights must be a table of numbers: {error}") from None
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InputError(f"heights must be at least 2 by 2, got shape {heights.shape}")
        bad = np.argwhere(~np.isfinite(heights))
        if len(bad):
            i, j = (int(k) for k in bad[0])
            raise InputError(f"heights must be finite, got {heights[i, j]} at [{i}, {j}]")
        heights.flags.writeable = False
        object.__setattr__(self, "heights", heights)

    @classmethod
    def from_array(
        cls,
        heights: np.ndarray,
        spacing: float,
        x0: float = 0.0,
        y0: float = 0.0,
        friction: FrictionLaw | None = None,
    ) -> HeightField:
        """Return the field of `heights` (nx, ny) [m]."""
        law = _frictionless() if friction is None else friction
        return cls(x0, y0, spacing, heights, law)

    @classmethod
    def from_image(
        cls,
        pixels: np.ndarray,
        spacing: float,
        height: float,
        x0: float = 0.0,
        y0: float = 0.0,
        friction: FrictionLaw | None = None,
    ) -> HeightField:
        """Return the field of a grey image, black at z = 0 and white at `height` [m].

        Parameters
        ----------
        pixels
            Shape (rows, columns), or (rows, columns, 3 or 4) with equal colours, whose fourth
            value (alpha) is left out. Unsigned integers, white being the type's largest, or
            floats from 0 to 1. The picture is the map seen from above: columns run along +x,
            the *lowest* row lies at `y0`.
        spacing
            Side of a pixel [m].
        """
        check_finite("height of white", height, "m")
        grey = np.asarray(pixels)
        if grey.ndim == 3 and grey.shape[2] in (3, 4):
            if (grey[..., 0] != grey[..., 1]).any() or (grey[..., 0] != grey[..., 2]).any():
                raise InputError("image of the ground must be grey, got one with colours")
            grey = grey[..., 0]
        if grey.ndim != 2:
            raise InputError(f"image of the ground must be one grey layer, got {grey.shape}")
        if grey.dtype.kind == "u":
            scaled = grey / float(np.iinfo(grey.dtype).max)
        elif grey.dtype.kind == "f":
            scaled = grey.astype(np.float64)
            if scaled.size and not (scaled.min() >= 0.0 and scaled.max() <= 1.0):
                raise InputError("image of floats must lie within 0 and 1 and have no NaN")
        else:
            raise InputError(f"image must be unsigned integers or floats, got {grey.dtype}")
        return cls.from_array(height * scaled[::-1].T, spacing, x0, y0, friction)

    @classmethod
    def from_csv(
        cls,
        path: Path | str,
        spacing: float,
        x0: float = 0.0,
        y0: float = 0.0,
        friction: FrictionLaw | None = None,
        delimiter: str = ",",
    ) -> HeightField:
        """Return the field of a text table of heights [m]: line i is x index i, column j is y."""
        try:
            heights = np.loadtxt(path, delimiter=delimiter, ndmin=2)
        except (OSError, ValueError) as error:
            raise InputError(f"no table of heights: {error}", str(path)) from None
        try:
            return cls.from_array(heights, spacing, x0, y0, friction)
        except InputError as error:
            raise InputError(str(error), str(path)) from None

    def packed(self) -> Packed:
        """Kind, params (8,) and heights (nx, ny) for the kernels."""
        # A writable copy: numba would compile the kernels once more for read-only arrays.
        params = [self.x0, self.y0, self.spacing, float(self.heights.max())]
        return _packed(HEIGHT_FIELD, params, self.heights.copy())


Ground: TypeAlias = Plane | Step | HeightField
