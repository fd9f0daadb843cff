"""Which faces may touch: candidates by nearness and facing, never by knowing the mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexapod.contact import kernels, search_kernels

CANDIDATE_COUNT = 12
# Faces whose normals open wider than this (cosine) do not face each other.
FACING_COSINE = -0.7
# Self-contact: faces nearer at rest than this many diagonals, and not face to face there, are the
# two sides of a crease or of one wall. How a crease closes within an element or two no mesh
# resolves, and a point that slips round its corner finds the other side deep behind it.
CREASE = 2.5
# Cells of the search's grid along each axis, at most: its memory stays small however far parts fly.
MOST_CELLS = 32
# Cells the reach is divided into: more fit the sphere that is looked through more closely.
SPAN = 3


def candidate_faces(
    x: np.ndarray,
    slaves: np.ndarray,
    masters: np.ndarray,
    reach: float,
    rest: Rest | None = None,
    joint_gap: float = 0.0,
    sizes: tuple[np.ndarray, np.ndarray] | None = None,
    count: int = CANDIDATE_COUNT,
) -> np.ndarray:
    """Return master faces that each slave face may touch, nearest first.

    Parameters
    ----------
    x
        Current node positions [m], shape (node_count, 3).
    slaves, masters
        Corner quadruples, shapes (slave_count, 4) and (master_count, 4); may be the same array.
    reach
        Largest distance [m] between face centres that can matter.
    rest, joint_gap
        Both surfaces undeformed, and the normal distance [m] below which two faces of one body
        count as joined where they are near each other (`CREASE`): the two sides of a corner lie in
        one plane back to back, and would be found "in contact" as soon as the corner shears. None
        (separate bodies) keeps them all.
    sizes
        Radii of both surfaces' faces around their centres [m], shapes (slave_count,) and
        (master_count,); `reach` then counts from where both end.
    count
        Length of the lists.

    Returns
    -------
    Indices into `masters`, shape (slave_count, count), -1 where there are fewer.
    Faces that share a node or do not face each other are left out. The cost grows with the number
    of faces, as long as few of them are within reach of one.
    """
    out = np.full((slaves.shape[0], count), -1, dtype=np.int32)
    if not slaves.shape[0] or not masters.shape[0] or not reach > 0.0:
        return out
    slave_frames = _frames(x, slaves)
    master_frames = slave_frames if masters is slaves else _frames(x, masters)
    if sizes is None:
        sizes = np.zeros(slaves.shape[0]), np.zeros(masters.shape[0])
    farthest = reach + sizes[0].max() + sizes[1].max()
    low, width, cells = _grid(master_frames[0], farthest)
    start = np.empty(int(cells.prod()) + 1, dtype=np.int64)
    order = np.empty(masters.shape[0], dtype=np.int64)
    search_kernels.sort_into_cells(master_frames[0], low, width, cells, start, order)
    joined = rest is not None
    if rest is None:
        rest = Rest(*slave_frames, np.empty(0), *master_frames, np.empty(0))  # not looked at
    search_kernels.pick_candidates(
        low,
        width,
        cells,
        start,
        order,
        master_frames[0][order],
        SPAN,
        reach,
        sizes[0],
        sizes[1][order],
        slaves,
        masters,
        *slave_frames,
        master_frames[1],
        FACING_COSINE,
        joined,
        joint_gap,
        CREASE,
        *rest,
        out,
    )
    return out


def _grid(points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest corner [m], widths of a cell [m] and numbers of cells of a grid around `points`.

    No cell is narrower than `reach` over `SPAN` [m]: nothing within it lies more cells away.
    """
    low = points.min(axis=0)
    extent = points.max(axis=0) - low
    least = reach / SPAN
    cells = np.clip(np.nan_to_num(extent / least), 1, MOST_CELLS).astype(np.int64)
    return low, np.maximum(extent / cells, least), cells


class Rest(NamedTuple):
    """Centres, normals and diagonals of both surfaces at rest."""

    slave_centre: np.ndarray
    slave_normal: np.ndarray
    slave_size: np.ndarray
    master_centre: np.ndarray
    master_normal: np.ndarray
    master_size: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, slaves: np.ndarray, masters: np.ndarray) -> Rest:
        """From undeformed positions `x` [m] and the corners of both."""
        return cls(
            *_frames(x, slaves), diagonals(x, slaves), *_frames(x, masters), diagonals(x, masters)
        )


def diagonals(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Longer diagonal of each face [m]."""
    first = np.linalg.norm(x[faces[:, 2]] - x[faces[:, 0]], axis=1)
    second = np.linalg.norm(x[faces[:, 3]] - x[faces[:, 1]], axis=1)
    return np.asarray(np.maximum(first, second))


def radii(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Largest distance of a corner from each face's centre [m]."""
    out = np.empty(faces.shape[0])
    search_kernels.face_radii(x, faces, out)
    return out


def _frames(x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centre = np.empty((faces.shape[0], 3))
    normal = np.empty((faces.shape[0], 3))
    kernels.face_frames(x, faces, centre, normal)
    return centre, normal
