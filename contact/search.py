"""Which faces may touch: candidates by nearness and facing, never by knowing the mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import get_num_threads
from scipy.spatial import cKDTree

from flexapod.contact import kernels

CANDIDATE_COUNT = 12
# Faces whose normals open wider than this (cosine) do not face each other.
FACING_COSINE = -0.7
# Self-contact: faces nearer at rest than this many diagonals, and not face to face there, are the
# two sides of a crease or of one wall. How a crease closes within an element or two no mesh
# resolves, and a point that slips round its corner finds the other side deep behind it.
CREASE = 2.5


def candidate_faces(
    x: np.ndarray,
    slaves: np.ndarray,
    masters: np.ndarray,
    reach: float,
    rest: Rest | None = None,
    joint_gap: float = 0.0,
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

    Returns
    -------
    Indices into `masters`, shape (slave_count, CANDIDATE_COUNT), -1 where there are fewer.
    Faces that share a node or do not face each other are left out. The cost grows like
    n log n of the number of faces.
    """
    out = np.full((slaves.shape[0], CANDIDATE_COUNT), -1, dtype=np.int32)
    if not slaves.shape[0] or not masters.shape[0]:
        return out
    slave_frames, master_frames = _frames(x, slaves), _frames(x, masters)
    # Neighbours on the same surface are many and never partners: ask for several times more.
    count = min(5 * CANDIDATE_COUNT, masters.shape[0])
    _, found = cKDTree(master_frames[0]).query(
        slave_frames[0], k=count, distance_upper_bound=reach, workers=get_num_threads()
    )
    joined = rest is not None
    rest = rest or Rest.of(x, slaves, masters)
    kernels.pick_candidates(
        found.reshape(slaves.shape[0], count),
        slaves,
        masters,
        slave_frames[1],
        master_frames[1],
        FACING_COSINE,
        joined,
        joint_gap,
        CREASE,
        *rest,
        out,
    )
    return out


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


def _frames(x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centre = np.empty((faces.shape[0], 3))
    normal = np.empty((faces.shape[0], 3))
    kernels.face_frames(x, faces, centre, normal)
    return centre, normal
