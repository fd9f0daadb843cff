"""Skins of bodies: their outer faces, read from field files and drawn in three dimensions.

They are drawn with pyvista where its off-screen rendering works, tried once in a process of its
own because a missing OpenGL library can kill the process that asks; elsewhere by a painter's
algorithm in matplotlib, and the run says so. Set FLEXAPOD_RENDERER to ``pyvista`` or
``matplotlib`` to choose.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from flexapod.geometry.tagged import HEX_FACES

# Direction from which each view looks at the body, and the direction that is up.
_VIEWS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "side": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "corner": ((0.45, -1.0, 0.42), (0.0, 0.0, 1.0)),
}
GROUND = "#dfe3e8"

# Screen axes, bounds of the picture on them, low and high, and the middle of what is in it [m].
Window = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


# --------------------------------------------------------------------------- shapes


@dataclass(frozen=True)
class Skin:
    """Outer faces of a body ready to draw.

    Attributes
    ----------
    points
        Positions [m], shape (point_count, 3).
    quads
        Corner indices, outward by the right hand, shape (quad_count, 4).
    values
        What the colours show: a value per point, smooth, or per quad, flat; shape
        (point_count,) or (quad_count,).
    """

    points: np.ndarray
    quads: np.ndarray
    values: np.ndarray

    @property
    def smooth(self) -> bool:
        """Whether the values are given per point."""
        return len(self.values) == len(self.points)

    @property
    def quad_values(self) -> np.ndarray:
        """A value per quad."""
        return self.values[self.quads].mean(axis=1) if self.smooth else self.values


def boundary_quads(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces that belong to one cell only, outward, and the cell each belongs to."""
    faces = cells[:, HEX_FACES].reshape(-1, 4)
    key = np.sort(faces, axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    index = np.sort(first[count == 1])
    return faces[index], index // 6


def mirrored(skin: Skin, axes: Sequence[str]) -> Skin:
    """The skin with its images at planes through the origin."""
    for axis in axes:
        points = skin.points.copy()
        points[:, "xyz".index(axis)] *= -1.0
        skin = Skin(
            np.concatenate([skin.points, points]),
            np.concatenate([skin.quads, skin.quads[:, ::-1] + len(skin.points)]),
            np.concatenate([skin.values, skin.values]),
        )
    return skin


def screen_axes(view: str) -> np.ndarray:
    """Right, up and towards the eye, shape (3, 3)."""
    towards = np.array(_VIEWS[view][0])
    towards = towards / np.linalg.norm(towards)
    up = np.array(_VIEWS[view][1])
    right = np.cross(up, towards)
    right = right / np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def _window(skins: Sequence[Skin], view: str) -> Window:
    """Screen axes and the bounds all skins need."""
    frame = screen_axes(view)
    screen = np.concatenate([skin.points[np.unique(skin.quads)] @ frame.T for skin in skins])
    return frame, screen.min(axis=0), screen.max(axis=0), np.mean(screen, axis=0)


# --------------------------------------------------------------------------- drawing


@lru_cache(maxsize=1)
def renderer() -> tuple[str, str | None]:
    """Which renderer to use, and a notice when it is not pyvista."""
    chosen = os.environ.get("FLEXAPOD_RENDERER", "")
    if chosen in ("pyvista", "matplotlib"):
        return chosen, None
    trial = (
        "import pyvista as pv; p = pv.Plotter(off_screen=True, window_size=(32, 32)); "
        "p.add_mesh(pv.Cube()); assert p.screenshot(None, return_img=True).std() > 0"
    )
    try:
        done = subprocess.run(
            [sys.executable, "-c", trial], capture_output=True, timeout=120, check=False
        )
        if done.returncode == 0:
            return "pyvista", None
        words = done.stderr.decode(errors="replace").strip().splitlines()
        reason = words[-1] if words else f"exit {done.returncode}"
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = str(error)
    return "matplotlib", (
        f"off-screen 3-D rendering does not work here ({reason[:120]}); drawn with matplotlib"
    )


def _draw_pyvista(
    skin: Skin,
    window: Window,
    pixels: tuple[int, int],
    limits: tuple[float, float],
    colours: str,
    ground: Skin | None = None,
    lines: bool = True,
    clear: bool = False,
) -> np.ndarray:
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    # Without a display VTK warns about X before it takes EGL or OSMesa.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    frame, low, high, _ = window
    surface = pyvista.PolyData(
        skin.points, np.column_stack([np.full(len(skin.quads), 4), skin.quads]).ravel()
    )
    (surface.point_data if skin.smooth else surface.cell_data)["value"] = skin.values
    plotter = pyvista.Plotter(off_screen=True, window_size=pixels)
    plotter.set_background("white")
    if ground is not None:
        sheet = pyvista.PolyData(
            ground.points, np.column_stack([np.full(len(ground.quads), 4), ground.quads]).ravel()
        )
        plotter.add_mesh(sheet, color=GROUND, ambient=0.6, diffuse=0.4, specular=0.0)
    edges = len(skin.quads) < 30000 and lines
    plotter.add_mesh(
        surface,
        scalars="value",
        cmap=colours,
        clim=limits,
        show_scalar_bar=False,
        show_edges=edges,
        edge_color="#3a3f47",
        line_width=0.5,
        edge_opacity=0.35,
        ambient=0.5,
        diffuse=0.6,
        specular=0.05,
        interpolate_before_map=False,
    )
    plotter.enable_parallel_projection()
    middle = frame.T @ (0.5 * (low + high))
    reach = float(np.linalg.norm(high - low)) + 1e-9
    plotter.camera.focal_point = middle
    plotter.camera.position = middle + 3.0 * reach * frame[2]
    plotter.camera.up = frame[1]
    plotter.camera.parallel_scale = 0.5 * max(
        high[1] - low[1], (high[0] - low[0]) * pixels[1] / pixels[0]
    )
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(None, return_img=True, transparent_background=clear)
    plotter.close()
    return np.asarray(image)


def _lit(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals of quads on the screen, of any length, and how light each is, 0.55 to 1."""
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    light = np.array([-0.35, 0.6, 0.72])
    return normal, 0.55 + 0.45 * np.clip((normal @ light) / length, 0.0, 1.0)


def _draw_matplotlib(
    skin: Skin,
    window: Window,
    pixels: tuple[int, int],
    limits: tuple[float, float],
    colours: str,
    ground: Skin | None = None,
    lines: bool = True,
    clear: bool = False,
) -> np.ndarray:
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb
    from matplotlib.figure import Figure

    frame, low, high, _ = window
    corners = skin.points[skin.quads] @ frame.T
    normal, shade = _lit(corners)
    front = normal[:, 2] > 0.0
    scaled = (skin.quad_values - limits[0]) / max(limits[1] - limits[0], 1e-30)
    rgba = colormaps[colours](np.clip(scaled, 0.0, 1.0))
    rgba[:, :3] *= shade[:, None]
    order = np.flatnonzero(front)
    order = order[np.argsort(corners[order][:, :, 2].mean(axis=1))]
    figure = Figure(figsize=(pixels[0] / 100, pixels[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    if clear:
        figure.patch.set_alpha(0.0)
    axes = figure.add_axes((0, 0, 1, 1))
    if ground is not None:
        # First, so beneath: every view that shows its face looks from above.
        sheet = ground.points[ground.quads] @ frame.T
        sheet = sheet[np.argsort(sheet[:, :, 2].mean(axis=1))]
        plain = np.clip(1.2 * _lit(sheet)[1], 0.0, 1.0)[:, None] * np.array(to_rgb(GROUND))
        axes.add_collection(
            PolyCollection(sheet[:, :, :2], facecolors=plain, edgecolors="face", lw=0.2)
        )
    axes.add_collection(
        PolyCollection(
            corners[order][:, :, :2],
            facecolors=rgba[order],
            # Without lines a gap would show between neighbours: they get the face's own colour.
            edgecolors=(0.15, 0.17, 0.2, 0.45) if lines else "face",
            linewidths=0.2,
        )
    )
    half = 0.5 * max(high[1] - low[1], (high[0] - low[0]) * pixels[1] / pixels[0])
    centre = 0.5 * (low + high)
    axes.set_xlim(
        centre[0] - half * pixels[0] / pixels[1], centre[0] + half * pixels[0] / pixels[1]
    )
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, : 4 if clear else 3].copy()


def draw_clear(
    skin: Skin,
    window: Window,
    pixels: tuple[int, int],
    limits: tuple[float, float],
    colours: str,
    lines: bool,
) -> np.ndarray:
    """Draw a skin on nothing, to be laid over a scene; shape (height, width, 4), 0 to 255.

    The window's ratio must be that of `pixels`; mesh lines are drawn where `lines` asks for them.
    """
    draw = _draw_pyvista if renderer()[0] == "pyvista" else _draw_matplotlib
    return draw(skin, window, pixels, limits, colours, None, lines, True)


def draw_skins(
    skins: Sequence[Skin],
    view: str,
    width: int,
    limits: tuple[float, float],
    colours: str,
    ground: Skin | None = None,
) -> list[np.ndarray]:
    """Draw skins in one common window, with a ground; images of shape (height, width, 3)."""
    shown = skins if ground is None else [*skins, ground]
    frame, low, high, middle = _window(shown, view)
    margin = 0.04 * float(np.max(high - low)) + 1e-9
    low, high = low - margin, high + margin
    ratio = float((high[1] - low[1]) / (high[0] - low[0]))
    pixels = (width, int(width * min(max(ratio, 0.25), 1.6)))
    draw = _draw_pyvista if renderer()[0] == "pyvista" else _draw_matplotlib
    window = (frame, low, high, middle)
    return [draw(skin, window, pixels, limits, colours, ground) for skin in skins]


# --------------------------------------------------------------------------- reading


class SkinReader:
    """Reads deformed skins of field files; what all files share is worked out once."""

    def __init__(self, colour: str, axes: Sequence[str]) -> None:
        self.colour = colour
        self.axes = axes
        self.text = ""  # of the colour bar
        self._cells = np.zeros((0, 8), dtype=int)
        self._used = np.zeros(0, dtype=int)
        self._quads = np.zeros((0, 4), dtype=int)

    def read(self, path: Path) -> Skin:
        """Deformed skin of a field file."""
        import meshio

        mesh = meshio.read(path)
        cells = np.concatenate([block.data for block in mesh.cells if block.type == "hexahedron"])
        if not np.array_equal(cells, self._cells):
            # Only the skin's own points: those inside would widen the colours' range.
            used, corners = np.unique(boundary_quads(cells)[0], return_inverse=True)
            self._cells, self._used, self._quads = cells, used, corners.reshape(-1, 4)
        shift = np.asarray(mesh.point_data["displacement"], dtype=float)
        name = {"stretch": "principal_stretches", "pressure": "pressure"}.get(self.colour, "")
        if name in mesh.cell_data:
            data = np.concatenate(mesh.cell_data[name])
            if self.colour == "stretch":
                per_cell, self.text = data.max(axis=1), "largest principal stretch"
            else:
                per_cell, self.text = data / 1000.0, "pressure in the material [kPa]"
            values = _smooth(per_cell, cells, len(mesh.points))
        else:
            values, self.text = 1000.0 * np.linalg.norm(shift, axis=1), "displacement [mm]"
        used = self._used
        return mirrored(Skin((mesh.points + shift)[used], self._quads, values[used]), self.axes)


def _smooth(per_cell: np.ndarray, cells: np.ndarray, node_count: int) -> np.ndarray:
    """Cell values averaged onto the nodes."""
    total = np.zeros(node_count)
    count = np.zeros(node_count)
    np.add.at(total, cells.ravel(), np.repeat(per_cell, cells.shape[1]))
    np.add.at(count, cells.ravel(), 1.0)
    return np.asarray(total / np.maximum(count, 1.0))


def colour_limits(skins: Sequence[Skin]) -> tuple[float, float]:
    """Range of the colours, without the few extreme values."""
    values = np.concatenate([skin.values for skin in skins])
    low, high = np.percentile(values, [0.5, 99.5])
    return float(low), float(high if high > low else low + 1.0)
