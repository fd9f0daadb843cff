"""A motion's shapes: a strip of snapshots, the last shape, and the animation.

They look along +y: x to the right, z up, the ground where it was. Bodies are drawn one by one at
the scene's scale and laid over it, so that a long way costs no more to draw than a short one.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.outputs import replacing
from flexapod.app.plots import (
    Results,
    colour_bar,
    heading_of,
    new_figure,
    save_figure,
    skin_reader,
)
from flexapod.app.plots_ground import EDGE, PALE, draw_ground, ground_profile, ground_sheet
from flexapod.app.plots_rigid import painted, with_rigid
from flexapod.app.plots_skin import (
    GROUND,
    Skin,
    SkinReader,
    colour_limits,
    draw_clear,
    draw_skins,
    screen_axes,
)
from flexapod.contact.ground import Ground
from flexapod.core.errors import InputError

_DPI = 160

# An animation's largest size [bytes], shortest and longest time between frames [s], and frames
# at most: Pillow holds them all.
GIF_SIZE = 8_000_000
_SHORTEST, _LONGEST, _LAST = 0.02, 0.2, 1.5
_MOST_FRAMES = 400


# --------------------------------------------------------------------------- scenes


@dataclass(frozen=True)
class Frames:
    """The states with fields, and what all pictures of them need to know."""

    results: Results
    reader: SkinReader
    index: tuple[int, ...]  # of fields that can be drawn
    boxes: np.ndarray  # bounds of each [m], low and high, shape (frame_count, 2, 3)
    limits: tuple[float, float]

    def __len__(self) -> int:
        return len(self.index)

    def skin(self, frame: int) -> Skin:
        return self.reader.read(self.results.fields[self.index[frame]])

    @property
    def times(self) -> np.ndarray:
        """Time of each [s]."""
        return np.array([self.results.times[i] for i in self.index])

    @property
    def half_width(self) -> float:
        """Largest |y| of any [m]."""
        return float(np.abs(self.boxes[:, :, 1]).max())


def read_frames(results: Results) -> Frames | None:
    """Look through all frames once; None without any."""
    reader = with_rigid(skin_reader(results))
    index: list[int] = []
    boxes: list[np.ndarray] = []
    sample: list[Skin] = []
    every = max(1, len(results.fields) // 8)
    for i, path in enumerate(results.fields):
        skin = reader.read(path)
        # A run that went wrong may leave a last state that is none.
        if not np.isfinite(skin.points).all():
            continue
        index.append(i)
        boxes.append(np.array([skin.points.min(axis=0), skin.points.max(axis=0)]))
        if i % every == 0 and np.isfinite(skin.values).all():
            sample.append(skin)
    if not index:
        return None
    limits = colour_limits(sample) if sample else (0.0, 1.0)
    return Frames(results, reader, tuple(index), np.array(boxes), limits)


class _Stage:
    """A figure of one or several equal scenes in side view, with a colour bar below.

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
    ) -> None:
        """Make room for x and z from `low` to `high` [m] in at most width by height [in]."""
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

    def colour_bar(self, limits: tuple[float, float], text: str) -> None:
        """Name the axis to the left and the colours to the right, in one row."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        wide, tall = self.figure.get_size_inches()
        self.figure.text(0.25 / wide, 0.24 / tall, "x [mm]", fontsize=9, va="center")
        axes = self.figure.add_axes(((wide - 2.45) / wide, 0.24 / tall, 2.2 / wide, 0.09 / tall))
        bar = self.figure.colorbar(
            ScalarMappable(Normalize(*limits), "viridis"), cax=axes, orientation="horizontal"
        )
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=8, length=2, pad=1)
        bar.ax.locator_params(nbins=5)
        self.figure.text(
            (wide - 2.7) / wide, 0.24 / tall, text, fontsize=9, ha="right", va="center"
        )

    def ground(self, grounds: Sequence[Ground], half_width: float) -> None:
        """Draw the ground in all scenes."""
        for axes in self.axes:
            draw_ground(axes, grounds, half_width)

    def body(self, skin: Skin, limits: tuple[float, float]) -> tuple[np.ndarray, int, int]:
        """Image of a body, RGBA, and where its lower left pixel lies in a scene."""
        frame = screen_axes("side")
        screen = skin.points @ frame.T
        low, high = screen.min(axis=0), screen.max(axis=0)
        first = np.floor((low[:2] - self.low) * self.scale).astype(int) - 1
        last = np.ceil((high[:2] - self.low) * self.scale).astype(int) + 1
        pixels = (int(last[0] - first[0]), int(last[1] - first[1]))
        low[:2] = self.low + first / self.scale
        high[:2] = self.low + last / self.scale
        # Mesh lines only where they leave the faces between them to be seen; about a fifth of the
        # faces is in sight.
        lines = pixels[0] * pixels[1] > 60 * 0.2 * len(skin.quads)
        shown, wide, colours = painted(skin, limits)
        image = draw_clear(shown, (frame, low, high, low), pixels, wide, colours, lines)
        return image, int(first[0]), int(first[1])

    def place(self, scene: int, image: np.ndarray, column: int, row: int) -> None:
        """Show a body's image in a scene."""
        axes = self.axes[scene]
        height, width = image.shape[:2]
        edges = np.array([column, column + width]), np.array([row, row + height])
        x, z = (1000.0 * (low + e / self.scale) for low, e in zip(self.low, edges, strict=True))
        window = axes.get_xlim(), axes.get_ylim()
        axes.imshow(image, extent=(*x, *z), zorder=3, aspect="auto", interpolation="none")
        axes.set_xlim(window[0])
        axes.set_ylim(window[1])


def _scene_bounds(boxes: np.ndarray, grounds: Sequence[Ground]) -> tuple[np.ndarray, np.ndarray]:
    """Window in x and z [m] for bodies within `boxes` and the ground beneath them."""
    low, high = boxes[:, 0, ::2].min(axis=0), boxes[:, 1, ::2].max(axis=0)
    size = float(np.median(boxes[:, 1, ::2] - boxes[:, 0, ::2])) + 1e-9
    low, high = low - 0.07 * size, high + 0.04 * size
    if grounds:
        z = ground_profile(grounds, low[0], high[0])[:, 1]
        # A ground far below a body in flight is not worth a small body.
        near = z[z > low[1] - 2.0 * size]
        low[1] = min(low[1], near.min() - 0.12 * size) if near.size else low[1]
    return low, high


def _wanted_frames(results: Results, frames: Frames) -> list[int] | None:
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


def _overlap(boxes: np.ndarray) -> float:
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
        if len(chosen) > 2 and _overlap(boxes[chosen]) < 0.15:
            return chosen
    return None


def plot_motion_snapshots(
    results: Results, grounds: Sequence[Ground], frames: Frames, path: Path
) -> None:
    """Shapes at their places along the ground; beside each other where they would overlap."""
    wanted = _wanted_frames(results, frames)
    if wanted is not None:
        strip = wanted if _overlap(frames.boxes[wanted]) < 0.15 else None
    else:
        strip = strip_frames(frames.boxes)
    even = np.linspace(0, len(frames) - 1, min(6, len(frames))).round().astype(int)
    chosen = strip or wanted or sorted(set(even.tolist()))
    low, high = _scene_bounds(frames.boxes[chosen], grounds)
    columns = 1
    if strip is None and len(chosen) > 1:
        # As many beside each other as gives a picture a little wider than high.
        ratio = float((high[0] - low[0]) / (high[1] - low[1]))
        columns = min(len(chosen), max(1, round(math.sqrt(1.5 * len(chosen) / ratio))))
    rows = 1 if strip is not None else -(-len(chosen) // columns)
    stage = _Stage(
        low, high, heading_of(results), width=12.0, height=8.5, dpi=_DPI,
        rows=rows, columns=columns, above=0.26,
    )  # fmt: skip
    stage.ground(grounds, frames.half_width)
    for scene, frame in enumerate(chosen):
        time = f"{frames.times[frame]:.4g} s"
        stage.place(0 if strip else scene, *stage.body(frames.skin(frame), frames.limits))
        if strip:
            box = 1000.0 * frames.boxes[frame]
            stage.axes[0].annotate(
                time, (box[:, 0].mean(), box[1, 2]), xytext=(0, 3), textcoords="offset points",
                ha="center", va="bottom", fontsize=9.5, zorder=5, annotation_clip=False,
            )  # fmt: skip
        else:
            stage.axes[scene].set_title(time, fontsize=10, pad=3)
    for axes in stage.axes[len(chosen) :]:
        axes.set_visible(False)
    stage.colour_bar(frames.limits, frames.reader.text)
    save_figure(stage.figure, path)


def plot_motion_final(
    results: Results, grounds: Sequence[Ground], frames: Frames, path: Path
) -> None:
    """The last shape, large, on the ground."""
    last = len(frames) - 1
    skin, box = frames.skin(last), frames.boxes[last]
    limits = colour_limits([skin])
    heading = heading_of(results, f"after {frames.times[last]:.4g} s")
    view = results.case.get("plot", {}).get("view", "corner")
    low, high = _scene_bounds(frames.boxes[[last]], grounds)
    if view == "side":
        stage = _Stage(low, high, heading, width=8.4, height=7.5, dpi=_DPI)
        stage.ground(grounds, frames.half_width)
        stage.place(0, *stage.body(skin, limits))
        stage.colour_bar(limits, frames.reader.text)
        save_figure(stage.figure, path)
        return
    sheet = None
    if grounds:
        room = 0.2 * float((box[1] - box[0])[:2].max())
        sheet = ground_sheet(grounds, box[0] - room, box[1] + room)
    shown, wide, colours = painted(skin, limits)
    image = draw_skins([shown], view, 1300, wide, colours, sheet)[0]
    height, width = image.shape[:2]
    figure = new_figure(8.0, 7.0 * height / width + 0.3 + 0.2 * (heading.count("\n") + 1))
    axes = figure.add_subplot()
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(heading, fontsize=11)
    colour_bar(figure, axes, limits, frames.reader.text)
    save_figure(figure, path)


# --------------------------------------------------------------------------- animation


def playing(times: np.ndarray) -> tuple[list[int], float]:
    """How long to show each frame [ms], whole tens, and the speed: 1 is true, 0.5 half as fast.

    True where the time between frames lies within what GIF viewers keep to; else slowed or
    hurried by a round number. The last frame stays a while.
    """
    gap = float(np.median(np.diff(times))) if len(times) > 1 else _LONGEST
    speed = 1.0
    steps = [m * 10**k for k in range(7) for m in (1, 2, 5)]
    slack = 1.0 + 1e-6
    if gap < _SHORTEST / slack:
        slower = [n for n in steps if gap * n >= _SHORTEST / slack]
        speed = 1.0 / slower[0] if slower else 1.0 / steps[-1]
    elif gap > _LONGEST * slack:
        faster = [n for n in steps if gap / n <= _LONGEST * slack]
        speed = float(faster[0]) if faster else float(steps[-1])
    ticks = np.round(100.0 * (times - times[0]) / speed + 1e-6).astype(int)
    shown = [10 * max(2, int(n)) for n in np.diff(ticks)]
    return [*shown, round(1000 * _LAST)], speed


def _film(
    results: Results,
    grounds: Sequence[Ground],
    frames: Frames,
    chosen: Sequence[int],
    speed: float,
) -> Iterator[np.ndarray]:
    """Images of the chosen frames, shape (height, width, 3), before one still ground."""
    low, high = _scene_bounds(frames.boxes, grounds)
    stage = _Stage(low, high, heading_of(results), width=12.0, height=6.4, dpi=100, above=0.24)
    stage.ground(grounds, frames.half_width)
    stage.colour_bar(frames.limits, frames.reader.text)
    axes = stage.axes[0]
    above = 1.0 + 6.0 / stage.height
    if speed != 1.0:
        words = f"{speed:g} times faster" if speed > 1.0 else f"slowed {1.0 / speed:g} times"
        axes.text(
            1.0, above, f"played {words}" if speed > 1.0 else words, transform=axes.transAxes,
            ha="right", va="bottom", fontsize=9, color=EDGE,
        )  # fmt: skip
    clock = axes.text(
        0.0, above, "", transform=axes.transAxes, va="bottom", fontsize=10, animated=True
    )
    stage.canvas.draw()
    still = stage.canvas.copy_from_bbox(stage.figure.bbox)
    digits = max(0, min(6, 2 - math.floor(math.log10(max(float(np.ptp(frames.times)), 1e-9)))))
    for frame in chosen:
        stage.canvas.restore_region(still)
        clock.set_text(f"t = {frames.times[frame]:.{digits}f} s")
        stage.figure.draw_artist(clock)
        image = np.asarray(stage.canvas.buffer_rgba())[:, :, :3].copy()
        body, column, row = stage.body(frames.skin(frame), frames.limits)
        height, width = body.shape[:2]
        left = stage.corners[0][0] + column
        bottom = image.shape[0] - stage.corners[0][1] - row
        # The window holds every frame, up to the bodies' own margin of a pixel or two.
        place = image[bottom - height : bottom, left : left + width]
        alpha = body[:, :, 3:].astype(float) / 255.0
        place[:] = np.round(alpha * body[:, :, :3] + (1.0 - alpha) * place).astype(np.uint8)
        yield image


def plot_animation(
    results: Results, grounds: Sequence[Ground], frames: Frames, path: Path, size: int = GIF_SIZE
) -> None:
    """All frames as a GIF of at most `size` bytes, smaller in pixels if it must be."""
    from PIL import Image

    chosen = np.arange(len(frames))
    if len(frames) > _MOST_FRAMES:
        chosen = np.unique(np.linspace(0, len(frames) - 1, _MOST_FRAMES).round().astype(int))
    times = frames.times[chosen]
    shown, speed = playing(times)
    order = chosen.tolist()
    some = sorted({order[0], order[len(order) // 2], order[-1]})
    palette = _palette(list(_film(results, grounds, frames, some, speed)))
    film = _film(results, grounds, frames, order, speed)
    images = [_indexed(Image.fromarray(image), palette) for image in film]
    data = b""
    for factor in (1.0, 0.8, 0.64, 0.5, 0.4, 0.3):
        data = _gif(images, palette, shown, factor)
        if len(data) <= size:
            break
    with replacing(path) as partial:
        partial.write_bytes(data)


def _palette(images: Sequence[np.ndarray]) -> Any:
    """Colours for all frames: one palette, or the still ground would flicker."""
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb
    from PIL import Image

    # Paper, ground, lines and the colour bar exactly, then what the bodies need, each of their
    # colours once: many as they are in the bodies, they are few beside the wide white.
    greys = np.linspace(0.0, 0.95, 12)[:, None] * np.ones(3)
    bar = colormaps["viridis"](np.linspace(0.0, 1.0, 48))[:, :3]
    named = np.array([to_rgb(name) for name in ("white", GROUND, PALE, EDGE)])
    fixed = np.round(255.0 * np.concatenate([named, greys, bar])).astype(np.uint8)
    colours = np.unique(np.concatenate([image.reshape(-1, 3) for image in images]), axis=0)
    colours = colours[np.ptp(colours.astype(int), axis=1) > 24]
    if not len(colours):
        colours = fixed
    # One place is left free: Pillow marks with it what does not change.
    room = 255 - len(fixed)
    median = Image.fromarray(colours[None]).quantize(room, method=Image.Quantize.MEDIANCUT)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*fixed.ravel().tolist(), *(median.getpalette() or [])[: 3 * room]])
    return palette


def _indexed(image: Any, palette: Any) -> Any:
    from PIL import Image

    return image.quantize(palette=palette, dither=Image.Dither.NONE)


def _gif(images: Sequence[Any], palette: Any, shown: Sequence[int], factor: float) -> bytes:
    from PIL import Image

    if factor != 1.0:
        width, height = (2 * max(1, round(0.5 * factor * n)) for n in images[0].size)
        images = [
            _indexed(
                image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS), palette
            )
            for image in images
        ]
    stream = io.BytesIO()
    images[0].save(
        stream, format="GIF", save_all=True, append_images=images[1:], duration=list(shown),
        loop=0, optimize=False,
    )  # fmt: skip
    return stream.getvalue()
