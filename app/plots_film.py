"""Films as GIF: how long each frame shows, one palette for all, and a size that is kept."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexapod.app.outputs import replacing
from flexapod.app.plots_ground import EDGE, PALE
from flexapod.app.plots_skin import GROUND

# Shortest and longest time between frames, and how long the last one stays [s].
_SHORTEST, _LONGEST, _LAST = 0.02, 0.2, 1.5


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


def write_film(
    film: Iterable[np.ndarray], palette: Any, shown: Sequence[int], path: Path, size: int
) -> None:
    """Write images, shape (height, width, 3), as a GIF of at most `size` bytes.

    `shown` is how long each frame stays [ms]; it gets smaller in pixels if it must.
    """
    from PIL import Image

    images = [_indexed(Image.fromarray(image), palette) for image in film]
    data = b""
    for factor in (1.0, 0.8, 0.64, 0.5, 0.4, 0.3):
        data = _gif(images, palette, shown, factor)
        if len(data) <= size:
            break
    with replacing(path) as partial:
        partial.write_bytes(data)


def film_palette(images: Sequence[np.ndarray], colours: str = "viridis") -> Any:
    """Colours for all frames: one palette, or the still ground would flicker.

    `colours` names the map of the colour bar.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb
    from PIL import Image

    # Paper, ground, lines and the colour bar exactly, then what the bodies need, each of their
    # colours once: many as they are in the bodies, they are few beside the wide white.
    greys = np.linspace(0.0, 0.95, 12)[:, None] * np.ones(3)
    bar = colormaps[colours](np.linspace(0.0, 1.0, 48))[:, :3]
    named = np.array([to_rgb(name) for name in ("white", GROUND, PALE, EDGE)])
    fixed = np.round(255.0 * np.concatenate([named, greys, bar])).astype(np.uint8)
    found = np.unique(np.concatenate([image.reshape(-1, 3) for image in images]), axis=0)
    found = found[np.ptp(found.astype(int), axis=1) > 24]
    if not len(found):
        found = fixed
    # One place is left free: Pillow marks with it what does not change.
    room = 255 - len(fixed)
    median = Image.fromarray(found[None]).quantize(room, method=Image.Quantize.MEDIANCUT)
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
