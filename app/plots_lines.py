"""Shells and coils made of lines: read from field files, sorted into parts, drawn in their plane.

A robot whose lines all lie in one plane y = const is drawn from the side with lines that stay
sharp at any size; one in space, as tubes, by `plots_tubes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.plots_skin import Skin
from flexapod.core.errors import InputError

SHELL, HUB, ON, LETTER = "#2f3b4c", "#2f3b4c", "#ffc53d", "#1d2530"
_IDLE, _BUSY = "#a3afbf", "#c8241c"
# Steps of the colour map; the tubes' own colours follow the forces'.
_FORCES, _STEPS = 200, 256
PLACES = {"shell": 0.82, "on": 0.90, "hub": 0.98}  # of the tubes' own colours in the map
FORCE_END = (_FORCES - 1) / (_STEPS - 1)  # where in the map the largest force is


# --------------------------------------------------------------------------- reading


@dataclass(frozen=True)
class LineShape:
    """Lines at one time.

    Attributes
    ----------
    points
        Positions [m], shape (point_count, 3).
    lines
        Node pairs, shape (line_count, 2).
    coil
        -1 for a segment of a shell, else the row of the coil, shape (line_count,).
    on
        Whether there is voltage, shape (line_count,).
    force
        Active force [N], shape (line_count,).
    """

    points: np.ndarray
    lines: np.ndarray
    coil: np.ndarray
    on: np.ndarray
    force: np.ndarray

    @property
    def used(self) -> np.ndarray:
        """Points that a line ends in [m]."""
        return np.asarray(self.points[np.unique(self.lines)])


def read_lines(path: Path) -> LineShape:
    """Lines where they are at the time of a field file."""
    import meshio

    if not path.is_file():
        raise InputError("is in lines.pvd but missing; run the case again", str(path))
    try:
        mesh = meshio.read(path)
    # meshio lets through whatever its parsers raise, and may even end the process.
    except (Exception, SystemExit) as error:
        raise InputError(
            f"cannot be read, perhaps it was cut short; run the case again ({error})", str(path)
        ) from None
    blocks = [i for i, block in enumerate(mesh.cells) if block.type == "line"]
    if not blocks:
        raise InputError("holds no lines", str(path))

    def field(name: str) -> np.ndarray:
        if name not in mesh.cell_data:
            listed = ", ".join(mesh.cell_data) or "none"
            raise InputError(f'has no cell field "{name}"; its fields are: {listed}', str(path))
        return np.concatenate([np.asarray(mesh.cell_data[name][i]) for i in blocks]).reshape(-1)

    if "displacement" not in mesh.point_data:
        raise InputError('has no point field "displacement"', str(path))
    return LineShape(
        mesh.points + np.asarray(mesh.point_data["displacement"], dtype=float),
        np.concatenate([mesh.cells[i].data for i in blocks]),
        field("coil").astype(int),
        field("on") > 0.5,
        field("active_force").astype(float),
    )


# --------------------------------------------------------------------------- parts


@dataclass(frozen=True)
class LineParts:
    """What the lines are parts of; the same at all times.

    Attributes
    ----------
    shells
        Nodes of each shell in their order; the first is the last again in a closed one.
    hubs
        Nodes off the shells where three coils or more meet.
    coils
        Row of each coil to its lines.
    ends
        Row of each coil to its two end nodes, at a hub first.
    """

    shells: tuple[np.ndarray, ...]
    hubs: np.ndarray
    coils: dict[int, np.ndarray]
    ends: dict[int, tuple[int, int]]


def line_parts(shape: LineShape) -> LineParts:
    """Sort lines into shells, coils and hubs."""
    shell = shape.lines[shape.coil < 0]
    rows = np.unique(shape.coil[shape.coil >= 0])
    coils = {int(row): np.flatnonzero(shape.coil == row) for row in rows}
    ends: dict[int, tuple[int, int]] = {}
    meeting: dict[int, int] = {}
    for row, index in coils.items():
        # A coil may be of several lines: its ends are where one line ends alone.
        nodes, count = np.unique(shape.lines[index], return_counts=True)
        tips = nodes[count == 1]
        first, last = (tips[0], tips[-1]) if len(tips) else shape.lines[index[0]]
        ends[row] = (int(first), int(last))
        for node in ends[row]:
            meeting[node] = meeting.get(node, 0) + 1
    on_shell = set(shell.ravel().tolist())
    hubs = sorted(n for n, count in meeting.items() if count >= 3 and n not in on_shell)
    for row, (first, last) in ends.items():
        if last in hubs and first not in hubs:
            ends[row] = (last, first)
    return LineParts(tuple(_trails(shell, shape.points)), np.array(hubs, dtype=int), coils, ends)


def _trails(lines: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Lines joined to curves; where curves cross in a node each goes straight on."""
    at: dict[int, list[int]] = {}
    for k, (a, b) in enumerate(lines.tolist()):
        at.setdefault(a, []).append(k)
        at.setdefault(b, []).append(k)
    follow: dict[tuple[int, int], int] = {}
    for node, own in at.items():
        way = points[lines[own].sum(axis=1) - node] - points[node]
        way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-30)[:, None]
        pairs = [(i, j) for i in range(len(own)) for j in range(i)]
        for i, j in sorted(pairs, key=lambda pair: float(way[pair[0]] @ way[pair[1]])):
            if (own[i], node) not in follow and (own[j], node) not in follow:
                follow[own[i], node], follow[own[j], node] = own[j], own[i]
    loose = [(k, n) for n, own in at.items() for k in own if (k, n) not in follow]
    left = set(range(len(lines)))
    trails: list[np.ndarray] = []
    for line, node in [*loose, *((k, int(lines[k, 0])) for k in range(len(lines)))]:
        trail = [node]
        while line in left:
            left.discard(line)
            node = int(lines[line].sum()) - node
            trail.append(node)
            line = follow.get((line, node), -1)
        if len(trail) > 1:
            trails.append(np.array(trail))
    return trails


def smooth_curve(points: np.ndarray, pieces: int = 6) -> np.ndarray:
    """Points on a smooth curve through `points`, closed where the last is the first.

    Cubic pieces whose slope at a point is that between its neighbours (E. Catmull, R. Rom, A class
    of local interpolating splines, Computer Aided Geometric Design, 1974).
    """
    if len(points) < 4:
        return points
    slope = np.gradient(points, axis=0)
    if np.array_equal(points[0], points[-1]):
        slope[[0, -1]] = 0.5 * (points[1] - points[-2])
    t = (np.arange(pieces) / pieces)[:, None]
    # Hermite's polynomials, for the two ends and the two slopes.
    curve = (
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * points[:-1, None]
        + t * (1.0 - t) ** 2 * slope[:-1, None]
        + t**2 * (3.0 - 2.0 * t) * points[1:, None]
        + t**2 * (t - 1.0) * slope[1:, None]
    )
    return np.concatenate([curve.reshape(-1, points.shape[1]), points[-1:]])


def zigzag(first: np.ndarray, last: np.ndarray, teeth: int, half_width: float) -> np.ndarray:
    """A coil as drawn: leads at both ends, teeth between, shape (2 * teeth + 3, 2)."""
    way = last - first
    length = max(float(np.linalg.norm(way)), 1e-30)
    across = np.array([-way[1], way[0]]) / length
    along = np.concatenate(
        [[0.0, 0.12], 0.12 + 0.76 * (np.arange(2 * teeth - 1) + 1) / (2 * teeth)]
    )
    along = np.concatenate([along, [0.88, 1.0]])
    side = np.zeros(len(along))
    side[2:-2] = half_width * np.where(np.arange(2 * teeth - 1) % 2, -1.0, 1.0)
    return np.asarray(first + along[:, None] * way + side[:, None] * across)


def coil_letter(row: int) -> str:
    """Letter of a coil by its row."""
    return chr(ord("A") + row) if row < 26 else str(row)


# --------------------------------------------------------------------------- colours


@lru_cache(maxsize=1)
def force_colours() -> str:
    """Register, once, the colours of active forces; the map's name."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    name = "flexapod_force"
    ways = LinearSegmentedColormap.from_list(name, [_IDLE, "#d98b62", _BUSY])
    colormaps.register(ways, force=True)
    return name


@lru_cache(maxsize=1)
def tube_colours() -> str:
    """Register, once, the forces' colours followed by those of `PLACES`; the map's name."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, to_rgba

    name = "flexapod_tubes"
    colours = list(colormaps[force_colours()](np.linspace(0.0, 1.0, _FORCES)))
    own = {"shell": to_rgba("#46566b"), "on": to_rgba(ON), "hub": to_rgba(HUB)}
    for step in range(_FORCES, _STEPS):
        place = step / (_STEPS - 1)
        colours.append(own[min(PLACES, key=lambda part: abs(PLACES[part] - place))])
    colormaps.register(ListedColormap(colours, name), force=True)
    return name


# --------------------------------------------------------------------------- drawing


@dataclass(frozen=True)
class LineLook:
    """How lines are drawn.

    Attributes
    ----------
    size
        Of the robot at the start [m].
    dots
        Points (1/72 in) per metre of the picture.
    limits
        Range of the active force [N].
    """

    size: float
    dots: float
    limits: tuple[float, float]


def draw_plane(
    axes: Any,
    shape: LineShape,
    parts: LineParts,
    look: LineLook,
    letters: bool = False,
    solid: Skin | None = None,
) -> list[Any]:
    """Draw lines over x and z [mm], and the side of a solid shell; all that was added."""
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection, PolyCollection

    flat = 1000.0 * shape.points[:, ::2]
    wide = look.size * look.dots  # of the robot [pt]
    added: list[Any] = []
    if solid is not None:
        side = list(1000.0 * _facing(solid)[:, :, ::2])
        added.append(
            axes.add_collection(
                PolyCollection(
                    side, facecolors="#5d6f87", edgecolors=SHELL,
                    lw=min(0.5, 0.003 * wide), zorder=4,
                ),
                autolim=False,
            )
        )  # fmt: skip
    curves = [smooth_curve(flat[trail]) for trail in parts.shells]
    added.append(
        axes.add_collection(
            LineCollection(
                curves, colors=SHELL, lw=float(np.clip(0.035 * wide, 1.2, 6.0)), zorder=4,
                capstyle="round", joinstyle="round",
            ),
            autolim=False,
        )
    )  # fmt: skip
    ways, glows, colours = [], [], []
    reach = max(look.limits[1] - look.limits[0], 1e-30)
    colour = colormaps[force_colours()]
    # Teeth that could not be told apart would be a smear.
    teeth = 9 if wide > 70.0 else 0
    for row, index in parts.coils.items():
        ends = flat[list(parts.ends[row])]
        ways.append(zigzag(ends[0], ends[1], teeth, 20.0 * look.size) if teeth else ends)
        strength = (float(shape.force[index].mean()) - look.limits[0]) / reach
        colours.append(colour(min(max(strength, 0.0), 1.0)))
        if shape.on[index].any():
            glows.append(ends)
    added.append(
        axes.add_collection(
            LineCollection(
                glows, colors=ON, lw=float(np.clip(0.06 * wide, 2.0, 12.0)), zorder=2.8,
                capstyle="round", alpha=0.8,
            ),
            autolim=False,
        )
    )  # fmt: skip
    added.append(
        axes.add_collection(
            LineCollection(
                ways, colors=colours, lw=float(np.clip(0.009 * wide, 0.8, 1.8)), zorder=3.0,
                joinstyle="round",
            ),
            autolim=False,
        )
    )  # fmt: skip
    if len(parts.hubs):
        added += axes.plot(
            *flat[parts.hubs].T, "o", color=HUB, ms=float(np.clip(0.07 * wide, 2.5, 11.0)),
            mec="white", mew=0.6, zorder=5,
        )  # fmt: skip
    return added + (_letters(axes, flat, parts, look) if letters else [])


def _facing(solid: Skin) -> np.ndarray:
    """Corners of the faces towards -y, from where one looks, shape (face_count, 4, 3)."""
    corners = solid.points[solid.quads]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    return np.asarray(corners[normal[:, 1] < -0.7 * length])


def _letters(axes: Any, flat: np.ndarray, parts: LineParts, look: LineLook) -> list[Any]:
    """Letters of the coils where they end in the shell, of others beside their middle."""
    added = []
    size = float(np.clip(0.075 * look.size * look.dots, 6.0, 11.0))
    for row, (first, last) in parts.ends.items():
        inner, outer = flat[first], flat[last]
        way = outer - inner
        way = way / max(float(np.linalg.norm(way)), 1e-30)
        if first in parts.hubs:
            place = outer + 68.0 * look.size * way
        else:
            # A chord: beside it, away from the hub, and off the spoke that crosses its middle.
            side = np.array([-way[1], way[0]])
            middle = flat[parts.hubs].mean(axis=0) if len(parts.hubs) else flat.mean(axis=0)
            side = side if side @ (inner - middle) > 0.0 else -side
            place = inner + 0.28 * (outer - inner) + 50.0 * look.size * side
        added.append(
            axes.text(
                *place, coil_letter(row), fontsize=size, color=LETTER, ha="center",
                va="center_baseline", zorder=6, fontweight="bold",
            )
        )  # fmt: skip
    return added


def is_plane(shapes: Sequence[LineShape]) -> bool:
    """Whether all lines stay in one plane y = const, to a ten-thousandth of their size."""
    size = float(np.ptp(shapes[0].used, axis=0).max())
    y = [(shape.used[:, 1].min(), shape.used[:, 1].max()) for shape in (shapes[0], shapes[-1])]
    return max(high for _, high in y) - min(low for low, _ in y) <= 1e-4 * max(size, 1e-30)
