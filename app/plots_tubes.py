"""Shells and coils in space: tubes and helices as a skin, and the ground beneath in oblique view.

Any renderer of `plots_skin` draws the skin; its values pick colours of `plots_lines.tube_colours`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexapod.app.plots_ground import EDGE, ground_heights
from flexapod.app.plots_lines import (
    FORCE_END,
    PLACES,
    LineParts,
    LineShape,
    smooth_curve,
)
from flexapod.app.plots_skin import GROUND, Skin, screen_axes
from flexapod.contact.ground import Ground

# Of the robot's size: radius of shells, hub, wire of coils, their helix, and the core that
# lights up; turns of a coil.
_SHELL, _HUB, _WIRE, _HELIX, _CORE, _TURNS = 0.017, 0.045, 0.0045, 0.02, 0.013, 8


def tube(path: np.ndarray, radius: float, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and quads of a tube along a path [m], closed where the last point is the first.

    Quads face outwards, corners as in `plots_skin.Skin`; shapes (point_count, 3), (quad_count, 4).
    """
    closed = bool(np.allclose(path[0], path[-1], rtol=0.0, atol=1e-9 * radius + 1e-15))
    if closed:
        path = path[:-1]
    count = len(path)
    if closed:
        way = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        way = np.gradient(path, axis=0)
    way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-30)[:, None]
    # The first normal is any, the others follow it without twist.
    across = np.empty_like(path)
    start = np.eye(3)[int(np.argmin(np.abs(way[0])))]
    for k in range(count):
        start = start - (start @ way[k]) * way[k]
        start = start / max(float(np.linalg.norm(start)), 1e-30)
        across[k] = start
    other = np.cross(way, across)
    angle = 2.0 * math.pi * np.arange(sides) / sides
    points = (
        path[:, None, :]
        + radius * np.cos(angle)[:, None] * across[:, None, :]
        + radius * np.sin(angle)[:, None] * other[:, None, :]
    )
    index = np.arange(count * sides).reshape(count, sides)
    here, there = (index, np.roll(index, -1, axis=0)) if closed else (index[:-1], index[1:])
    # What twist has gathered on the way round is taken up by the last piece.
    if closed:
        turn = math.atan2(float(across[0] @ other[-1]), float(across[0] @ across[-1]))
        shift = round(turn / (2.0 * math.pi) * sides)
        there[-1] = np.roll(there[-1], shift)
    quads = np.stack([here, np.roll(here, -1, axis=1), np.roll(there, -1, axis=1), there], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


def helix(first: np.ndarray, last: np.ndarray, radius: float, turns: int) -> np.ndarray:
    """A coil's wire with straight leads [m], shape (point_count, 3)."""
    way = last - first
    length = max(float(np.linalg.norm(way)), 1e-30)
    way = way / length
    across = np.eye(3)[int(np.argmin(np.abs(way)))]
    across = across - (across @ way) * way
    across = across / np.linalg.norm(across)
    at = np.linspace(0.0, 1.0, 8 * turns + 1)
    # Full width only inside, so that the wire leaves the axis and comes back.
    wide = radius * np.clip(np.minimum(at, 1.0 - at) * turns, 0.0, 1.0)
    angle = 2.0 * math.pi * turns * at
    inside = first + np.outer(0.12 * length + 0.76 * length * at, way)
    inside += np.outer(wide * np.cos(angle), across)
    inside += np.outer(wide * np.sin(angle), np.cross(way, across))
    return np.concatenate([first[None], inside, last[None]])


def _ball(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A small sphere of quads, its poles pointed."""
    theta = np.linspace(0.0, math.pi, 9)
    ring = 2.0 * math.pi * np.arange(12) / 12
    points = centre + radius * np.stack(
        [
            np.sin(theta)[:, None] * np.cos(ring),
            np.sin(theta)[:, None] * np.sin(ring),
            np.cos(theta)[:, None] * np.ones(12),
        ],
        axis=-1,
    )
    index = np.arange(9 * 12).reshape(9, 12)
    here, there = index[:-1], index[1:]
    quads = np.stack([here, there, np.roll(there, -1, axis=1), np.roll(here, -1, axis=1)], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


def tube_skin(shape: LineShape, parts: LineParts, size: float, limits: tuple[float, float]) -> Skin:
    """Shells, coils and hubs as one skin; `size` of the robot [m], `limits` of the force [N]."""
    made: list[tuple[np.ndarray, np.ndarray]] = []
    values: list[float] = []

    def add(piece: tuple[np.ndarray, np.ndarray], value: float) -> None:
        made.append(piece)
        values.append(value)

    for trail in parts.shells:
        add(tube(smooth_curve(shape.points[trail], 3), _SHELL * size, 8), PLACES["shell"])
    reach = max(limits[1] - limits[0], 1e-30)
    for row, index in parts.coils.items():
        first, last = shape.points[list(parts.ends[row])]
        strength = (float(shape.force[index].mean()) - limits[0]) / reach
        wire = helix(first, last, _HELIX * size, _TURNS)
        add(tube(wire, _WIRE * size, 5), FORCE_END * min(max(strength, 0.0), 1.0))
        if shape.on[index].any():
            core = first + np.outer(np.linspace(0.1, 0.9, 6), last - first)
            add(tube(core, _CORE * size, 8), PLACES["on"])
    for hub in parts.hubs:
        add(_ball(shape.points[hub], _HUB * size), PLACES["hub"])
    before = np.cumsum([0, *(len(points) for points, _ in made[:-1])])
    return Skin(
        np.concatenate([points for points, _ in made]),
        np.concatenate([quads + start for (_, quads), start in zip(made, before, strict=True)]),
        np.concatenate(
            [np.full(len(points), v) for (points, _), v in zip(made, values, strict=True)]
        ),
    )


# --------------------------------------------------------------------------- ground


def tick_step(span: float, count: int) -> float:
    """A round distance, 1, 2 or 5 times a power of ten, of which `span` holds about `count`."""
    rough = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(max(rough, 1e-30)))
    return float(min((power * m for m in (1.0, 2.0, 5.0, 10.0)), key=lambda s: abs(s - rough)))


def _height(grounds: Sequence[Ground], x: Any, y: Any) -> np.ndarray:
    return np.asarray(np.max([ground_heights(ground, x, y) for ground in grounds], axis=0))


def _flat(points: np.ndarray, view: str) -> np.ndarray:
    """Places on the screen [mm] of points [m], shape (point_count, 2)."""
    return np.asarray(1000.0 * points @ screen_axes(view)[:2].T)


def ground_corners(
    grounds: Sequence[Ground], low: np.ndarray, high: np.ndarray, view: str
) -> np.ndarray:
    """Outline on the screen [m] of the grounds' part below a box [m], shape (count, 2)."""
    s = np.linspace(0.0, 1.0, 60)
    x = np.concatenate([low[0] + s * (high[0] - low[0])] * 2)
    y = np.repeat([low[1], high[1]], 60)
    points = np.column_stack([x, y, _height(grounds, x, y)])
    return 0.001 * _flat(points, view)


def draw_ground_strip(
    axes: Any, grounds: Sequence[Ground], low: np.ndarray, high: np.ndarray, step: float, view: str
) -> None:
    """A strip of ground below a box [m] with a grid of `step` [m], and x [mm] at its front."""
    edge = 1000.0 * ground_corners(grounds, low, high, view)
    front, back = edge[: len(edge) // 2], edge[len(edge) // 2 :]
    axes.fill(*np.concatenate([front, back[::-1]]).T, color=GROUND, lw=0, zorder=0.6)
    axes.plot(*front.T, color=EDGE, lw=1.1, zorder=1.2)
    s = np.linspace(0.0, 1.0, 40)
    for y in step * np.arange(math.ceil(low[1] / step), math.floor(high[1] / step) + 1):
        x = low[0] + s * (high[0] - low[0])
        points = np.column_stack([x, np.full(40, y), _height(grounds, x, y)])
        axes.plot(*_flat(points, view).T, color="white", lw=0.8, zorder=0.8)
    for x in step * np.arange(math.ceil(low[0] / step), math.floor(high[0] / step) + 1):
        y = low[1] + s * (high[1] - low[1])
        line = _flat(np.column_stack([np.full(40, x), y, _height(grounds, x, y)]), view)
        axes.plot(*line.T, color="white", lw=0.8, zorder=0.8)
        axes.annotate(
            f"{1000.0 * x:g}", line[0], xytext=(0, -3), textcoords="offset points", ha="center",
            va="top", fontsize=8, color="#4b5563", zorder=5, annotation_clip=True,
        )  # fmt: skip


def draw_shadow(
    axes: Any,
    grounds: Sequence[Ground],
    shape: LineShape,
    parts: LineParts,
    width: float,
    view: str,
) -> list[Any]:
    """Shells laid down on the ground, which shows where the robot stands; `width` in points."""
    from matplotlib.collections import LineCollection

    laid = []
    for trail in parts.shells:
        curve = smooth_curve(shape.points[trail], 3)
        curve[:, 2] = _height(grounds, curve[:, 0], curve[:, 1])
        laid.append(_flat(curve, view))
    lines = LineCollection(laid, colors="#b9c0ca", lw=width, zorder=2.0, capstyle="round")
    return [axes.add_collection(lines, autolim=False)]
