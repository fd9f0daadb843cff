"""A robot of shells and coils on its way: a strip of snapshots, the last shape, and the animation.

One whose lines lie in a plane is drawn from the side, with letters at its coils; a sphere of rings
in oblique view on a strip of ground. Where the way is long the animation's window goes along.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.plots import Results, heading_of, save_figure, skin_reader
from flexapod.app.plots_film import film_palette, playing, write_film
from flexapod.app.plots_ground import EDGE, draw_ground
from flexapod.app.plots_lines import (
    ON,
    LineLook,
    LineParts,
    LineShape,
    draw_plane,
    force_colours,
    is_plane,
    line_parts,
    read_lines,
    tube_colours,
)
from flexapod.app.plots_skin import Skin, screen_axes
from flexapod.app.plots_stage import (
    DPI,
    Stage,
    overlap,
    scene_bounds,
    strip_frames,
    wanted_frames,
)
from flexapod.app.plots_tubes import (
    draw_ground_strip,
    draw_shadow,
    ground_corners,
    tick_step,
    tube_skin,
)
from flexapod.contact.ground import Ground
from flexapod.core.errors import InputError

# An animation's largest size [bytes] and its frames at most.
GIF_SIZE = 3_000_000
_MOST_FRAMES, _MOST_IN_SPACE = 250, 125
_DOTS = 100  # of an animation, per inch
_BAR_TEXT = "active force [mN]"


@dataclass(frozen=True)
class LineFrames:
    """The states with lines, and what all pictures of them need to know."""

    results: Results
    index: tuple[int, ...]  # of files that can be drawn
    shapes: tuple[LineShape, ...]
    parts: LineParts
    view: str
    size: float  # of the robot at the start [m]
    boxes: np.ndarray  # of each on the screen [m]: across, deep, up; (frame_count, 2, 3)
    limits: tuple[float, float]  # of the active force [N]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def times(self) -> np.ndarray:
        """Time of each [s]."""
        return np.array([self.results.times[i] for i in self.index])

    @property
    def plane(self) -> bool:
        """Whether the robot is drawn as lines from the side."""
        return self.view == "side"

    def solid(self, frame: int) -> Skin | None:
        """Skin of a shell of hexahedra; None where the shell is of lines."""
        fields = self.results.fields
        if not fields:
            return None
        return skin_reader(self.results).read(fields[self.index[frame]])


def read_line_frames(results: Results) -> LineFrames | None:
    """Read all frames; None without any."""
    if not results.lines:
        return None
    if len(results.lines) != len(results.times):
        raise InputError(
            f"lines.pvd lists {len(results.lines)} states and fields.pvd {len(results.times)}; "
            "run the case again",
            str(results.folder),
        )
    shapes = [read_lines(path) for path in results.lines]
    # A run that went wrong may leave a last state that is none.
    index = [i for i, shape in enumerate(shapes) if np.isfinite(shape.used).all()]
    if not index:
        return None
    kept = tuple(shapes[i] for i in index)
    view = "side" if is_plane(kept) else results.case.get("plot", {}).get("view", "corner")
    if view == "side" and not is_plane(kept):
        view = "corner"
    turn = screen_axes(view)[[0, 2, 1]]
    boxes = np.array([[(s.used @ turn.T).min(axis=0), (s.used @ turn.T).max(axis=0)] for s in kept])
    size = float(np.ptp(kept[0].used, axis=0).max())
    # Shells are drawn with a thickness.
    boxes += 0.02 * size * np.array([[-1.0], [1.0]])
    strongest = max(float(s.force.max(initial=0.0)) for s in kept)
    limits = (0.0, strongest if strongest > 0.0 else 1.0)
    return LineFrames(results, tuple(index), kept, line_parts(kept[0]), view, size, boxes, limits)


# --------------------------------------------------------------------------- scenes


class _Scene:
    """Draws the ground and the robot into a stage, in either view."""

    def __init__(self, frames: LineFrames, grounds: Sequence[Ground]) -> None:
        self.frames, self.grounds = frames, grounds
        low = np.min([s.used.min(axis=0) for s in frames.shapes], axis=0)
        high = np.max([s.used.max(axis=0) for s in frames.shapes], axis=0)
        # Further along than any window looks, which shows two robots to each side at most.
        room = frames.size * np.array([3.0, 0.45, 3.0])
        self.room = low - room, high + room

    def bounds(self, chosen: Sequence[int], letters: bool) -> tuple[np.ndarray, np.ndarray]:
        """Window on the screen [m] for some frames and the ground beneath them."""
        boxes = self.frames.boxes[list(chosen)].copy()
        if letters:
            boxes[0] += 0.08 * self.frames.size * np.array([[-1.0], [1.0]])
        if self.frames.plane:
            return scene_bounds(boxes, self.grounds)
        low, high = boxes[:, 0, ::2].min(axis=0), boxes[:, 1, ::2].max(axis=0)
        if self.grounds:
            some = [self.frames.shapes[k].used for k in chosen]
            first = np.min([p.min(axis=0) for p in some], axis=0) - 0.45 * self.frames.size
            last = np.max([p.max(axis=0) for p in some], axis=0) + 0.45 * self.frames.size
            edge = ground_corners(self.grounds, first, last, self.frames.view)
            low, high = np.minimum(low, edge.min(axis=0)), np.maximum(high, edge.max(axis=0))
        margin = 0.08 * self.frames.size
        return low - margin, high + 0.5 * margin

    def ground(self, stage: Stage, count: int) -> None:
        """Draw the ground in all scenes, whatever part of it their windows show."""
        for axes in stage.axes:
            x, z = axes.get_xlim(), axes.get_ylim()
            if self.frames.plane:
                near, far = (1000.0 * end[::2] for end in self.room)
                axes.set_xlim(min(x[0], near[0]), max(x[1], far[0]))
                axes.set_ylim(min(z[0], near[1]), max(z[1], far[1]))
                draw_ground(axes, self.grounds)
            else:
                axes.set_xticks([])
                axes.spines["bottom"].set_visible(False)
                if self.grounds:
                    step = tick_step((x[1] - x[0]) / 1000.0, count)
                    draw_ground_strip(axes, self.grounds, *self.room, step, self.frames.view)
            axes.set_xlim(x)
            axes.set_ylim(z)

    def robot(self, stage: Stage, scene: int, frame: int, letters: bool = False) -> list[Any]:
        """Draw the robot; all that was added."""
        frames, axes = self.frames, stage.axes[scene]
        shape = frames.shapes[frame]
        dots = 72.0 * stage.scale / stage.figure.dpi
        if frames.plane:
            look = LineLook(frames.size, dots, frames.limits)
            return draw_plane(axes, shape, frames.parts, look, letters, frames.solid(frame))
        added = []
        if self.grounds:
            width = 0.03 * frames.size * dots
            added += draw_shadow(axes, self.grounds, shape, frames.parts, width, frames.view)
        skin = tube_skin(shape, frames.parts, frames.size, frames.limits)
        image = stage.body(skin, (0.0, 1.0), tube_colours(), lines=False)
        return [*added, stage.place(scene, *image)]

    def legend(self, stage: Stage) -> None:
        """Name the axis, the sign of voltage and the colours of forces."""
        from matplotlib.lines import Line2D

        low, high = self.frames.limits
        stage.colour_bar((1000.0 * low, 1000.0 * high), _BAR_TEXT, force_colours())
        wide, tall = stage.figure.get_size_inches()
        x, z = np.array([0.95, 1.2]) / wide, np.full(2, 0.24 / tall)
        stage.figure.add_artist(Line2D(x, z, color=ON, lw=6, alpha=0.8, solid_capstyle="round"))
        stage.figure.add_artist(Line2D(x, z, color="#7c8899", lw=1.2))
        stage.figure.text(1.3 / wide, z[0], "voltage on", fontsize=9, va="center")


def _columns(count: int, ratio: float) -> int:
    """Scenes beside each other for a picture about twice as wide as high with few gaps."""

    def cost(columns: int) -> float:
        rows = -(-count // columns)
        shape = abs(math.log(0.5 * ratio * columns / rows))
        return shape + (rows * columns - count) / count

    return min(range(1, count + 1), key=cost)


def plot_line_snapshots(
    results: Results, grounds: Sequence[Ground], frames: LineFrames, path: Path
) -> None:
    """Shapes at their places along the ground; beside each other where they would overlap."""
    wanted = wanted_frames(results, frames)
    if wanted is not None:
        strip = wanted if overlap(frames.boxes[wanted]) < 0.15 else None
    else:
        strip = strip_frames(frames.boxes)
    even = np.linspace(0, len(frames) - 1, min(6, len(frames))).round().astype(int)
    chosen = strip or wanted or sorted(set(even.tolist()))
    scene = _Scene(frames, grounds)
    letters = frames.plane
    low, high = scene.bounds(chosen, letters)
    columns = 1
    if strip is None and len(chosen) > 1:
        columns = _columns(len(chosen), float((high[0] - low[0]) / (high[1] - low[1])))
    rows = 1 if strip is not None else -(-len(chosen) // columns)
    stage = Stage(
        low, high, heading_of(results), width=12.0, height=8.5, dpi=DPI,
        rows=rows, columns=columns, above=0.3, view=frames.view,
    )  # fmt: skip
    scene.ground(stage, 10 if strip else 4)
    for place, frame in enumerate(chosen):
        time = f"{frames.times[frame]:.4g} s"
        lettered = letters and place == 0
        scene.robot(stage, 0 if strip else place, frame, lettered)
        if strip:
            box = 1000.0 * frames.boxes[frame]
            up = box[1, 2] + (80.0 * frames.size if lettered else 0.0)
            stage.axes[0].annotate(
                time, (box[:, 0].mean(), up), xytext=(0, 3), textcoords="offset points",
                ha="center", va="bottom", fontsize=9.5, zorder=7, annotation_clip=False,
            )  # fmt: skip
        else:
            stage.axes[place].set_title(time, fontsize=10, pad=3)
    for axes in stage.axes[len(chosen) :]:
        axes.set_visible(False)
    scene.legend(stage)
    save_figure(stage.figure, path)


def plot_line_final(
    results: Results, grounds: Sequence[Ground], frames: LineFrames, path: Path
) -> None:
    """The last shape, large, on the ground."""
    last = len(frames) - 1
    scene = _Scene(frames, grounds)
    heading = heading_of(results, f"after {frames.times[last]:.4g} s")
    low, high = scene.bounds([last], frames.plane)
    stage = Stage(low, high, heading, width=8.4, height=7.0, dpi=DPI, above=0.1, view=frames.view)
    scene.ground(stage, 8)
    scene.robot(stage, 0, last, frames.plane)
    scene.legend(stage)
    save_figure(stage.figure, path)


# --------------------------------------------------------------------------- animation


def camera(
    middle: np.ndarray, times: np.ndarray, span: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Window that goes along: its width and height [m] and its middle at each frame.

    `middle` is where the robot is on the screen [m], shape (frame_count, 2), `span` what all
    frames need. The window stands still unless the way is longer than about four robots.
    """
    still = np.tile(0.5 * (middle.min(axis=0) + middle.max(axis=0)), (len(middle), 1))
    if span[0] <= 5.2 * size:
        return span, still
    window = np.array([min(4.2 * size, span[0]), span[1]])
    # Steps of a gait are smoothed away, or the ground would jerk: over a twelfth of the time.
    spread = (times[-1] - times[0]) / 12.0 + 1e-12
    weight = np.exp(-0.5 * ((times[:, None] - times[None, :]) / spread) ** 2)
    # Mirrored at both ends in value, so that a steady way stays steady there.
    early = np.exp(-0.5 * ((times[:, None] + times[None, :] - 2 * times[0]) / spread) ** 2)
    late = np.exp(-0.5 * ((times[:, None] + times[None, :] - 2 * times[-1]) / spread) ** 2)
    total = (weight + early + late).sum(axis=1, keepdims=True)
    along = weight @ middle + early @ (2 * middle[0] - middle) + late @ (2 * middle[-1] - middle)
    along = along / total
    if span[1] > 1.8 * size:
        window[1] = 2.0 * size
    else:
        along[:, 1] = still[:, 1]
    return window, along


def _film(
    results: Results,
    grounds: Sequence[Ground],
    frames: LineFrames,
    chosen: Sequence[int],
    speed: float,
) -> Iterator[np.ndarray]:
    """Images of the chosen frames, shape (height, width, 3)."""
    from matplotlib.ticker import MultipleLocator

    scene = _Scene(frames, grounds)
    low, high = scene.bounds(range(len(frames)), False)
    middle = frames.boxes.mean(axis=1)[:, ::2]
    window, along = camera(middle, frames.times, high - low, frames.size)
    moving = bool(window[0] < high[0] - low[0])
    if moving:
        # Where the window keeps its height it stays where the whole scene is.
        fixed = window[1] >= high[1] - low[1]
        along[:, 1] += (0.5 * (low + high))[1] - along[0, 1] if fixed else 0.0
        low = along[0] - 0.5 * window
        high = low + window
    stage = Stage(
        low, high, heading_of(results), width=8.4 if moving else 10.0, height=5.6, dpi=_DOTS,
        above=0.26, view=frames.view,
    )  # fmt: skip
    scene.ground(stage, 6)
    scene.legend(stage)
    axes = stage.axes[0]
    step = 1000.0 * tick_step(stage.width / stage.scale, max(3, stage.width // 110))
    if frames.plane:
        axes.xaxis.set_major_locator(MultipleLocator(step))
        if moving:
            axes.axvline(1000.0 * middle[0, 0], color=EDGE, lw=0.8, ls=(0, (4, 4)), zorder=0.4)
    axes.yaxis.set_visible(False)
    (trace,) = axes.plot([], [], color="#8fa7c4", lw=1.0, zorder=1.5)
    above = 1.0 + 6.0 / stage.height
    if speed != 1.0:
        words = f"played {speed:g} times faster" if speed > 1.0 else f"slowed {1 / speed:g} times"
        stage.figure.text(
            (stage.corners[0][0] + stage.width) / stage.pixels[0],
            (stage.corners[0][1] + above * stage.height) / stage.pixels[1],
            words, ha="right", va="bottom", fontsize=9, color=EDGE,
        )  # fmt: skip
    clock = axes.text(0.0, above, "", transform=axes.transAxes, va="bottom", fontsize=10)
    axes.set_visible(False)
    stage.canvas.draw()
    still = stage.canvas.copy_from_bbox(stage.figure.bbox)
    axes.set_visible(True)
    digits = max(0, min(6, 2 - math.floor(math.log10(max(float(np.ptp(frames.times)), 1e-9)))))
    centre = np.array([_centre(shape, frames.parts) for shape in frames.shapes])
    axis, word = (2, "height") if np.ptp(centre[:, 2]) > np.ptp(centre[:, 0]) else (0, "way")
    path = 1000.0 * centre @ screen_axes(frames.view)[:2].T
    corner = np.array([axes.get_xlim(), axes.get_ylim()])
    for frame in chosen:
        # Whole pixels, so that the ground looks the same wherever it is.
        move = np.round((along[frame] - along[0]) * stage.scale) / stage.scale * 1000.0
        if moving:
            axes.set_xlim(corner[0] + move[0])
            axes.set_ylim(corner[1] + move[1])
        trace.set_data(*path[: frame + 1].T)
        # Without "-0".
        way = round(1000.0 * float(centre[frame, axis] - centre[0, axis])) + 0
        clock.set_text(f"t = {frames.times[frame]:.{digits}f} s     {word} {way} mm")
        added = scene.robot(stage, 0, frame)
        stage.canvas.restore_region(still)
        stage.figure.draw_artist(axes)
        image = np.asarray(stage.canvas.buffer_rgba())[:, :, :3].copy()
        for artist in added:
            artist.remove()
        yield image


def _centre(shape: LineShape, parts: LineParts) -> np.ndarray:
    """Hub, or the middle of all points without one [m]."""
    return np.asarray(shape.points[parts.hubs[0]] if len(parts.hubs) else shape.used.mean(axis=0))


def plot_line_animation(
    results: Results,
    grounds: Sequence[Ground],
    frames: LineFrames,
    path: Path,
    size: int = GIF_SIZE,
) -> None:
    """Frames, evenly, as a GIF of at most `size` bytes, smaller in pixels if it must be."""
    most = _MOST_FRAMES if frames.plane else _MOST_IN_SPACE
    chosen = list(range(0, len(frames), -(-len(frames) // most)))
    shown, speed = playing(frames.times[chosen])
    some = sorted({chosen[0], chosen[len(chosen) // 2], chosen[-1]})
    palette = film_palette(list(_film(results, grounds, frames, some, speed)), force_colours())
    write_film(_film(results, grounds, frames, chosen, speed), palette, shown, path, size)
