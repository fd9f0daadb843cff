"""Rigid bodies in the pictures of a motion: their surfaces laid into the body's skin, in grey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from flexapod.app.plots_skin import Skin, SkinReader, mirrored

# Between the ground's grey and that of lines.
RIGID = "#8f96a1"
# Colours of the map `painted` names; the last is the rigid bodies'.
_COUNT = 256


@dataclass(frozen=True)
class MixedSkin(Skin):
    """A skin of which some points belong to rigid bodies, which have no values of their own.

    Their values lie within the others', so that they leave the colours' range alone.

    Attributes
    ----------
    rigid
        Whether a point is one of theirs, shape (point_count,).
    """

    rigid: np.ndarray


class RigidReader(SkinReader):
    """Reads the skins of states, with the rigid bodies that were written beside them."""

    def read(self, path: Path) -> Skin:
        """Deformed skin of a state, and the rigid bodies at that time."""
        soft = super().read(path)
        beside = rigid_file(path)
        return laid_in(soft, read_rigid(beside, self.axes)) if beside.is_file() else soft


def with_rigid(reader: SkinReader) -> SkinReader:
    """The reader, but for skins with rigid bodies."""
    return RigidReader(reader.colour, reader.axes)


def rigid_file(state: Path) -> Path:
    """Where the rigid bodies of a state are written, if it has any."""
    return state.with_name("rigid_" + state.name.removeprefix("state_"))


def read_rigid(path: Path, axes: Sequence[str] = ()) -> Skin:
    """Surfaces of rigid bodies where they are, mirrored at the planes of `axes`."""
    import meshio

    mesh = meshio.read(path)
    faces = np.concatenate([block.data for block in mesh.cells if block.type == "quad"])
    points = mesh.points + np.asarray(mesh.point_data["displacement"], dtype=float)
    return mirrored(Skin(points, faces, np.zeros(len(points))), axes)


def laid_in(soft: Skin, rigid: Skin) -> MixedSkin:
    """Both in one, so that the nearer hides the farther."""
    count = len(soft.points)
    values = soft.values
    if not soft.smooth:
        raise ValueError("a skin with rigid bodies needs a value per point")
    middle = float(np.median(values)) if len(values) else 0.0
    return MixedSkin(
        np.concatenate([soft.points, rigid.points]),
        np.concatenate([soft.quads, rigid.quads + count]),
        np.concatenate([values, np.full(len(rigid.points), middle)]),
        np.arange(count + len(rigid.points)) >= count,
    )


@lru_cache(maxsize=1)
def _colour_map() -> str:
    """Register, once, viridis with one more colour at its end; its name."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, to_rgba

    name = "flexapod_rigid"
    colours = colormaps["viridis"](np.linspace(0.0, 1.0, _COUNT - 1))
    colormaps.register(ListedColormap([*colours, to_rgba(RIGID)], name), force=True)
    return name


def painted(skin: Skin, limits: tuple[float, float]) -> tuple[Skin, tuple[float, float], str]:
    """Skin, limits and colour map with which rigid bodies come out grey, whatever draws them.

    Without rigid bodies all is left as it is.
    """
    if not isinstance(skin, MixedSkin):
        return skin, limits, "viridis"
    low, high = limits
    # The range gets one colour more, so that the others stay where they were.
    last = low + (high - low) * _COUNT / (_COUNT - 1)
    values = np.where(skin.rigid, last, np.minimum(skin.values, high))
    # What lies at the upper limit itself must not fall into the last colour.
    values[~skin.rigid] = np.minimum(values[~skin.rigid], low + 0.999 * (high - low))
    return Skin(skin.points, skin.quads, values), (low, last), _colour_map()


__all__ = [
    "RIGID",
    "MixedSkin",
    "RigidReader",
    "laid_in",
    "painted",
    "read_rigid",
    "rigid_file",
    "with_rigid",
]
