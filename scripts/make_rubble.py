"""Write cases/rubble.png: stones on flat ground as a grey image, black at the ground.

Run from the repository root: ``python scripts/make_rubble.py``. A pixel is 10 mm; the middle,
where a robot starts, is left free. Stones are half ellipsoids strewn by a fixed seed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

SHAPE = (201, 81)  # pixels along x and y
PIXEL = 10.0  # [mm]
STONES = 260
FREE = (190.0, 110.0)  # [mm] from the middle that no stone reaches


def rubble(seed: int = 4) -> np.ndarray:
    """Heights over the highest stone's, shape SHAPE."""
    random = np.random.default_rng(seed)
    x = PIXEL * (np.arange(SHAPE[0]) - SHAPE[0] // 2)[:, None]
    y = PIXEL * (np.arange(SHAPE[1]) - SHAPE[1] // 2)[None, :]
    heights = np.zeros(SHAPE)
    for _ in range(STONES):
        place = random.uniform(-1.0, 1.0, 2) * [x.max(), y.max()]
        size = random.uniform(15.0, 55.0, 2)
        height = random.uniform(0.2, 1.0)
        angle = random.uniform(0.0, np.pi)
        if (np.abs(place) < np.array(FREE) + size.max()).all():
            continue
        c, s = np.cos(angle), np.sin(angle)
        along = (c * (x - place[0]) + s * (y - place[1])) / size[0]
        across = (c * (y - place[1]) - s * (x - place[0])) / size[1]
        stone = height * np.sqrt(np.maximum(1.0 - along**2 - across**2, 0.0))
        heights = np.maximum(heights, stone)
    return heights / heights.max()


def main() -> None:
    """Write the image, lowest row at the smallest y as maps are drawn."""
    from PIL import Image

    pixels = np.round(255.0 * rubble().T[::-1]).astype(np.uint8)
    Image.fromarray(pixels).save(Path("cases") / "rubble.png", optimize=True)


if __name__ == "__main__":
    main()
