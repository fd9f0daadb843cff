"""Scenes of a motion: figures true to scale in side view or another, and which states go in.

All sizes are whole pixels, so that what is drawn at a scene's scale fits without being sampled
anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from flexapod.app.plots import Results
from flexapod.app.plots_ground import draw_ground, draw_ground_map, ground_profile
from flexapod.app.plots_rigid import painted
from flexapod.app.plots_skin import Skin, draw_clear, screen_axes
from flexapod.contact.ground import Ground
from flexapod.core.errors import InputError

# Of pictures; films have fewer dots.
DPI = 160


class Timed(Protocol):
    """States of a motion with their times [s]."""

    def __len__(self) -> int: ...

    @property
    def times(self) -> np.ndarray: ...


class Stage:
    """A figure of one or several equal scenes, with a colour bar below.

    All sizes are whole pixels, so that a body drawn at `scale` fits its place without being
    sampled anew.
    """

    def __init__(
        self,
        low: np.ndarray,
        high: np.ndarray,
        heading: str,
        *,
        width: float,
        height: float,
        dpi: int,
        rows: int = 1,
        columns: int = 1,
        above: float = 0.08,
        view: str = "side",
    ) -> None:
        """Make room from `low` to `high` [m] in at most width by height [in].

        Both are across and up the screen, which is x and z in side view.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        left, gap, ticks, bar = 0.25, 0.25, 0.3, 0.42
        top = 0.2 + 0.2 * (heading.count("\n") + 1) + above
        room_x = (width - 2 * left - (columns - 1) * gap) / columns
        room_z = (height - top - bar - rows * ticks - (rows - 1) * above) / rows
        span = high - low
        self.scale = float(min(room_x / span[0], room_z / span[1])) * dpi
        # Not narrower than title and bar need.
        least = (6.2 - 2 * left - (columns - 1) * gap) / columns * dpi
        self.width = math.ceil(max(span[0] * self.scale, least))
        self.height = math.ceil(span[1] * self.scale)
        spare = 0.5 * (self.width / self.scale - span[0])
        self.low = low - [spare, 0.0]
        size = np.array([self.width, self.height]) / self.scale

        def whole(inches: float) -> int:
            return round(inches * dpi)

        self.view = view
        self.columns = columns
        steps = (self.width + whole(gap), self.height + whole(ticks + above))
        total = (
            2 * whole(left) + self.width + (columns - 1) * steps[0],
            whole(bar) + whole(ticks) + self.height + (rows - 1) * steps[1] + whole(top),
        )
        # Video players and some viewers want even sizes.
        total = (total[0] + total[0] % 2, total[1] + total[1] % 2)
        self.figure = Figure(figsize=(total[0] / dpi, total[1] / dpi), dpi=dpi)
        self.canvas = FigureCanvasAgg(self.figure)
        self.pixels = total
        self.axes: list[Any] = []
        self.corners: list[tuple[int, int]] = []  # of each scene, from the lower left
        for row in range(rows):
            for column in range(columns):
                x = whole(left) + column * steps[0]
                z = whole(bar) + whole(ticks) + (rows - 1 - row) * steps[1]
                axes = self.figure.add_axes(
                    (x / total[0], z / total[1], self.width / total[0], self.height / total[1])
                )
                axes.set_xlim(1000 * self.low[0], 1000 * (self.low[0] + size[0]))
                axes.set_ylim(1000 * self.low[1], 1000 * (self.low[1] + size[1]))
                for side in ("top", "right", "left"):
                    axes.spines[side].set_visible(False)
                axes.spines["bottom"].set_color("#b8bdc5")
                axes.set_yticks([])
                axes.tick_params(axis="x", labelsize=8, color="#b8bdc5")
                axes.locator_params(axis="x", nbins=max(3, int(self.width / dpi / 0.9)))
                self.axes.append(axes)
                self.corners.append((x, z))
        self.figure.text(
            0.5, 1.0 - 0.1 * dpi / total[1], heading, ha="center", va="top", fontsize=11
        )

    def colour_bar(
        self, limits: tuple[float, float], text: str, colours: str = "viridis", axis: str = "x [mm]"
    ) -> None:
        """Name the axis to the left and the colours (unless they say nothing) to the right."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        wide, tall = self.figure.get_size_inches()
        self.figure.text(0.25 / wide, 0.24 / tall, axis, fontsize=9, va="center")
        if not text:
            return
        axes = self.figure.add_axes(((wide - 2.45) / wide, 0.24 / tall, 2.2 / wide, 0.09 / tall))
        bar = self.figure.colorbar(
            ScalarMappable(Normalize(*limits), colours), cax=axes, orientation="horizontal"
        )
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=8, length=2, pad=1)
        bar.ax.locator_params(nbins=5)
        self.figure.text(
            (wide - 2.7) / wide, 0.24 / tall, text, fontsize=9, ha="right", va="center"
        )

    def ground(self, grounds: Sequence[Ground], half_width: float) -> None:
        """Draw the ground in all scenes, in side view or from above."""
        for axes in self.axes:
            if self.view == "top":
                draw_ground_map(axes, grounds)
            else:
                draw_ground(axes, grounds, half_width)

    def body(
        self, skin: Skin, limits: tuple[float, float], colours: str = "", lines: bool = True
    ) -> tuple[np.ndarray, int, int]:
        """Image of a body, RGBA, and where its lower left pixel lies in a scene.

        With mesh lines where it is large enough for them, unless `lines` is false; in `colours`,
        by default viridis with rigid bodies grey.
        """
        frame = screen_axes(self.view)
        screen = skin.points @ frame.T
        low, high = screen.min(axis=0), screen.max(axis=0)
        first = np.floor((low[:2] - self.low) * self.scale).astype(int) - 1
        last = np.ceil((high[:2] - self.low) * self.scale).astype(int) + 1
        pixels = (int(last[0] - first[0]), int(last[1] - first[1]))
        low[:2] = self.low + first / self.scale
        high[:2] = self.low + last / self.scale
        # Mesh lines only where they leave the faces between them to be seen; about a fifth of the
        # faces is in sight.
        lines = lines and pixels[0] * pixels[1] > 60 * 0.2 * len(skin.quads)
        shown, wide, named = (skin, limits, colours) if colours else painted(skin, limits)
        image = draw_clear(shown, (frame, low, high, low), pixels, wide, named, lines)
        return image, int(first[0]), int(first[1])

    def place(self, scene: int, image: np.ndarray, column: int, row: int) -> Any:
        """Show a body's image in a scene; what was added to it."""
        axes = self.axes[scene]
        height, width = image.shape[:2]
        edges = np.array([column, column + width]), np.array([row, row + height])
        x, z = (1000.0 * (low + e / self.scale) for low, e in zip(self.low, edges, strict=True))
        window = axes.get_xlim(), axes.get_ylim()
        shown = axes.imshow(image, extent=(*x, *z), zorder=3, aspect="auto", interpolation="none")
        axes.set_xlim(window[0])
        axes.set_ylim(window[1])
        return shown


def scene_bounds(boxes: np.ndarray, grounds: Sequence[Ground]) -> tuple[np.ndarray, np.ndarray]:
    """Window across and up the screen [m] for bodies within `boxes` and the ground beneath them."""
    low, high = boxes[:, 0, ::2].min(axis=0), boxes[:, 1, ::2].max(axis=0)
    size = float(np.median(boxes[:, 1, ::2] - boxes[:, 0, ::2])) + 1e-9
    low, high = low - 0.07 * size, high + 0.04 * size
    if grounds:
        z = ground_profile(grounds, low[0], high[0])[:, 1]
        # A ground far below a body in flight is not worth a small body.
        near = z[z > low[1] - 2.0 * size]
        low[1] = min(low[1], near.min() - 0.12 * size) if near.size else low[1]
    return low, high


def wanted_frames(results: Results, frames: Timed) -> list[int] | None:
    """Frames nearest the values plot.snapshots asks for; None where it does not."""
    plot = results.case.get("plot", {})
    wanted = plot.get("snapshots")
    if wanted is None:
        return None
    head = plot.get("x", "time_s")
    if head not in results.columns:
        raise InputError(
            f'no column "{head}"; the columns are {", ".join(results.columns)}',
            f"{results.folder}: plot.x",
        )
    values = np.interp(frames.times, results.columns["time_s"], results.columns[head])
    chosen = {int(np.argmin(np.abs(values - value))) for value in wanted}
    return sorted(chosen) or [len(frames) - 1]


def overlap(boxes: np.ndarray) -> float:
    """Largest share of its width by which a box covers another; at the same height or not."""
    worst = 0.0
    for i in range(len(boxes)):
        for j in range(i):
            shared = np.minimum(boxes[i, 1], boxes[j, 1]) - np.maximum(boxes[i, 0], boxes[j, 0])
            width = min(float(b[1, 0] - b[0, 0]) for b in (boxes[i], boxes[j]))
            if shared[2] > 0.0:
                worst = max(worst, float(shared[0]) / max(width, 1e-12))
    return worst


def strip_frames(boxes: np.ndarray, most: int = 7) -> list[int] | None:
    """Frames evenly along the way that stand clear of each other; None for fewer than three.

    `boxes` holds the bounds of each frame [m], low and high, shape (frame_count, 2, 3).
    """
    middle = boxes[:, :, 0].mean(axis=1)
    width = float(np.median(boxes[:, 1, 0] - boxes[:, 0, 0]))
    count = min(most, 1 + int(np.ptp(middle) / max(width, 1e-12)))
    for n in range(count, 2, -1):
        places = np.linspace(middle.min(), middle.max(), n)
        chosen = sorted({int(np.argmin(np.abs(middle - place))) for place in places})
        if len(chosen) > 2 and overlap(boxes[chosen]) < 0.15:
            return chosen
    return None
