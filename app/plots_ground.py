"""The ground in pictures: read from a results folder, its height and outline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from flexapod.app.plots import Results
from flexapod.app.plots_skin import GROUND, Skin
from flexapod.contact.ground import Ground, HeightField, Plane, Step
from flexapod.core.errors import InputError

EDGE, PALE = "#6b7280", "#eef0f3"


def read_grounds(results: Results) -> list[Ground]:
    """The grounds of a motion, made as for the run itself."""
    from pydantic import ValidationError

    from flexapod.app.case import LoadedCase
    from flexapod.app.motion_parts import make_ground
    from flexapod.app.spec_dynamics import ContactGroundSpec

    source = str(results.case.get("resolved", {}).get("source", ""))
    # Only its paths are asked for.
    loaded = LoadedCase(cast(Any, None), source, Path(source).parent)
    grounds: list[Ground] = []
    for index, table in enumerate(results.case.get("contact", ())):
        if table.get("type") != "ground":
            continue
        where = f"{results.folder}: contact.{index}"
        try:
            spec = ContactGroundSpec.model_validate(table)
        except ValidationError as error:
            raise InputError(str(error.errors()[0]["msg"]), where) from None
        grounds.append(make_ground(loaded, spec, where))
    return grounds


def ground_heights(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of a ground [m] at x and y [m], which broadcast.

    A height field is bilinear, with its rim's height beyond, as in `contact.ground_kernels`.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if isinstance(ground, Plane):
        (px, py, pz), (nx, ny, nz) = ground.point, ground.normal
        return np.asarray(pz - (nx * (x - px) + ny * (y - py)) / nz)
    if isinstance(ground, Step):
        return np.where(x < ground.x, 0.0, ground.height)
    heights = ground.heights
    s = np.clip((x - ground.x0) / ground.spacing, 0.0, heights.shape[0] - 1.0)
    t = np.clip((y - ground.y0) / ground.spacing, 0.0, heights.shape[1] - 1.0)
    i = np.minimum(s.astype(int), heights.shape[0] - 2)
    j = np.minimum(t.astype(int), heights.shape[1] - 2)
    u, w = s - i, t - j
    low = heights[i, j] * (1.0 - u) + heights[i + 1, j] * u
    high = heights[i, j + 1] * (1.0 - u) + heights[i + 1, j + 1] * u
    return np.asarray(low * (1.0 - w) + high * w)


def ground_profile(
    grounds: Sequence[Ground], low: float, high: float, half_width: float = 0.0
) -> np.ndarray:
    """Outline of the grounds from x = low to high [m]: x and z, shape (point_count, 2).

    The highest of all grounds, and over |y| <= `half_width`; risers stay upright.
    """
    x = _ground_x(grounds, low, high)
    y = np.linspace(-half_width, half_width, 41) if half_width > 0.0 else np.zeros(1)
    z = [ground_heights(ground, x[:, None], y[None, :]).max(axis=1) for ground in grounds]
    return np.column_stack([x, np.max(z, axis=0)])


def _ground_x(grounds: Sequence[Ground], low: float, high: float, count: int = 400) -> np.ndarray:
    x: list[np.ndarray] = [np.linspace(low, high, count)]
    for ground in grounds:
        if isinstance(ground, Step):
            x.append(np.array([np.nextafter(ground.x, -math.inf), ground.x]))
        elif isinstance(ground, HeightField):
            x.append(ground.x0 + ground.spacing * np.arange(ground.heights.shape[0]))
    points = np.unique(np.concatenate(x))
    return points[(points >= low) & (points <= high)]


def ground_sheet(grounds: Sequence[Ground], low: np.ndarray, high: np.ndarray) -> Skin:
    """The grounds beneath a box [m] as a sheet."""
    x = _ground_x(grounds, low[0], high[0], 60)
    y = np.linspace(low[1], high[1], 40)
    z = np.max([ground_heights(g, x[:, None], y[None, :]) for g in grounds], axis=0)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1).reshape(-1, 3)
    corner = np.arange(len(points)).reshape(z.shape)
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    return Skin(points, quads.reshape(-1, 4), np.zeros(len(points)))


def draw_ground(axes: Any, grounds: Sequence[Ground], half_width: float = 0.0) -> None:
    """Fill the ground [mm] over the axes' width; what rises beside y = 0 is paler."""
    if not grounds:
        return
    low, high = (0.001 * value for value in axes.get_xlim())
    bottom = axes.get_ylim()[0]
    if half_width > 0.0 and any(isinstance(ground, HeightField) for ground in grounds):
        x, z = 1000.0 * ground_profile(grounds, low, high, half_width).T
        axes.fill_between(x, np.minimum(z, bottom), z, color=PALE, lw=0, zorder=0.5)
    x, z = 1000.0 * ground_profile(grounds, low, high).T
    axes.fill_between(x, np.minimum(z, bottom), z, color=GROUND, lw=0, zorder=0.6)
    axes.plot(x, z, color=EDGE, lw=1.1, zorder=1.2)


def draw_ground_map(axes: Any, grounds: Sequence[Ground]) -> None:
    """Fill the axes [mm] with the ground seen from above, darker where it is higher."""
    if not grounds:
        return
    x, y = axes.get_xlim(), axes.get_ylim()
    across = 0.001 * np.linspace(x[0], x[1], 300)
    up = 0.001 * np.linspace(y[0], y[1], 200)
    z = np.max([ground_heights(g, across[None, :], up[:, None]) for g in grounds], axis=0)
    rise = float(np.ptp(z))
    axes.set_facecolor(PALE)
    if rise > 1e-9:
        axes.contourf(
            1000.0 * across, 1000.0 * up, z, levels=12, cmap="Greys", alpha=0.35, zorder=0.5
        )
    axes.set_xlim(x)
    axes.set_ylim(y)
