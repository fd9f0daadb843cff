"""A motion's shapes: a strip of snapshots, the last shape, and the animation.

They look along +y: x to the right, z up, the ground where it was; or from above, if the case's
`plot.view` says "top". Bodies are drawn one by one at the scene's scale and laid over it, so that a
long way costs no more to draw than a short one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexapod.app.plots import (
    Results,
    colour_bar,
    heading_of,
    new_figure,
    save_figure,
    skin_reader,
)
from flexapod.app.plots_film import film_palette, playing, write_film
from flexapod.app.plots_ground import EDGE, ground_sheet
from flexapod.app.plots_rigid import painted, with_rigid
from flexapod.app.plots_skin import Skin, SkinReader, colour_limits, draw_skins, screen_axes
from flexapod.app.plots_stage import (
    DPI,
    Stage,
    overlap,
    scene_bounds,
    strip_frames,
    wanted_frames,
)
from flexapod.contact.ground import Ground

# An animation's largest size [bytes], and its frames at most: Pillow holds them all.
GIF_SIZE = 8_000_000
_MOST_FRAMES = 400


# --------------------------------------------------------------------------- scenes


@dataclass(frozen=True)
class Frames:
    """The states with fields, and what all pictures of them need to know."""

    results: Results
    reader: SkinReader
    index: tuple[int, ...]  # of fields that can be drawn
    view: str  # "side" or "top"
    # Bounds of each [m], low and high: across the screen, towards the eye, up the screen;
    # shape (frame_count, 2, 3).
    boxes: np.ndarray
    limits: tuple[float, float]

    def __len__(self) -> int:
        return len(self.index)

    def skin(self, frame: int) -> Skin:
        return self.reader.read(self.results.fields[self.index[frame]])

    @property
    def text(self) -> str:
        """Of the colour bar; none for a box, whose colours say nothing."""
        rigid = self.results.case.get("robot", {}).get("body") == "rigid"
        return "" if rigid else self.reader.text

    @property
    def times(self) -> np.ndarray:
        """Time of each [s]."""
        return np.array([self.results.times[i] for i in self.index])

    @property
    def half_width(self) -> float:
        """Largest |y| of any [m], seen from the side."""
        return float(np.abs(self.boxes[:, :, 1]).max())

    @property
    def axis(self) -> str:
        """Names the axis that the scenes' ticks are along."""
        return "x [mm], from above" if self.view == "top" else "x [mm]"

    def bounds(
        self, chosen: Sequence[int], grounds: Sequence[Ground]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Window on the screen [m] for some frames and the ground beneath them."""
        return scene_bounds(self.boxes[list(chosen)], grounds if self.view == "side" else ())


def read_frames(results: Results) -> Frames | None:
    """Look through all frames once; None without any."""
    reader = with_rigid(skin_reader(results))
    # A turn is seen from above only. The other views say how the last shape alone is drawn.
    view = "top" if results.case.get("plot", {}).get("view") == "top" else "side"
    turn = screen_axes(view)[[0, 2, 1]]
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
        points = skin.points @ turn.T
        boxes.append(np.array([points.min(axis=0), points.max(axis=0)]))
        if i % every == 0 and np.isfinite(skin.values).all():
            sample.append(skin)
    if not index:
        return None
    limits = colour_limits(sample) if sample else (0.0, 1.0)
    return Frames(results, reader, tuple(index), view, np.array(boxes), limits)


def plot_motion_snapshots(
    results: Results, grounds: Sequence[Ground], frames: Frames, path: Path
) -> None:
    """Shapes at their places along the ground; beside each other where they would overlap."""
    wanted = wanted_frames(results, frames)
    if wanted is not None:
        strip = wanted if overlap(frames.boxes[wanted]) < 0.15 else None
    else:
        strip = strip_frames(frames.boxes)
    even = np.linspace(0, len(frames) - 1, min(6, len(frames))).round().astype(int)
    chosen = strip or wanted or sorted(set(even.tolist()))
    low, high = frames.bounds(chosen, grounds)
    columns = 1
    if strip is None and len(chosen) > 1:
        # As many beside each other as gives a picture a little wider than high.
        ratio = float((high[0] - low[0]) / (high[1] - low[1]))
        columns = min(len(chosen), max(1, round(math.sqrt(1.5 * len(chosen) / ratio))))
    rows = 1 if strip is not None else -(-len(chosen) // columns)
    stage = Stage(
        low, high, heading_of(results), width=12.0, height=8.5, dpi=DPI,
        rows=rows, columns=columns, above=0.26, view=frames.view,
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
    stage.colour_bar(frames.limits, frames.text, axis=frames.axis)
    save_figure(stage.figure, path)


def plot_motion_final(
    results: Results, grounds: Sequence[Ground], frames: Frames, path: Path
) -> None:
    """The last shape, large, on the ground."""
    last = len(frames) - 1
    skin = frames.skin(last)
    limits = colour_limits([skin])
    heading = heading_of(results, f"after {frames.times[last]:.4g} s")
    view = results.case.get("plot", {}).get("view", "corner")
    if view == frames.view:
        low, high = frames.bounds([last], grounds)
        stage = Stage(low, high, heading, width=8.4, height=7.5, dpi=DPI, view=view)
        stage.ground(grounds, frames.half_width)
        stage.place(0, *stage.body(skin, limits))
        stage.colour_bar(limits, frames.text, axis=frames.axis)
        save_figure(stage.figure, path)
        return
    sheet = None
    if grounds:
        low, high = skin.points.min(axis=0), skin.points.max(axis=0)
        room = 0.2 * float((high - low)[:2].max())
        sheet = ground_sheet(grounds, low - room, high + room)
    shown, wide, colours = painted(skin, limits)
    image = draw_skins([shown], view, 1300, wide, colours, sheet)[0]
    height, width = image.shape[:2]
    figure = new_figure(8.0, 7.0 * height / width + 0.3 + 0.2 * (heading.count("\n") + 1))
    axes = figure.add_subplot()
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(heading, fontsize=11)
    if frames.text:
        colour_bar(figure, axes, limits, frames.text)
    save_figure(figure, path)


# --------------------------------------------------------------------------- animation


def _film(
    results: Results,
    grounds: Sequence[Ground],
    frames: Frames,
    chosen: Sequence[int],
    speed: float,
) -> Iterator[np.ndarray]:
    """Images of the chosen frames, shape (height, width, 3), before one still ground."""
    low, high = frames.bounds(range(len(frames)), grounds)
    stage = Stage(
        low, high, heading_of(results), width=12.0, height=6.4, dpi=100, above=0.24,
        view=frames.view,
    )  # fmt: skip
    stage.ground(grounds, frames.half_width)
    stage.colour_bar(frames.limits, frames.text, axis=frames.axis)
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
    chosen = np.arange(len(frames))
    if len(frames) > _MOST_FRAMES:
        chosen = np.unique(np.linspace(0, len(frames) - 1, _MOST_FRAMES).round().astype(int))
    times = frames.times[chosen]
    shown, speed = playing(times)
    order = chosen.tolist()
    some = sorted({order[0], order[len(order) // 2], order[-1]})
    palette = film_palette(list(_film(results, grounds, frames, some, speed)))
    write_film(_film(results, grounds, frames, order, speed), palette, shown, path, size)
