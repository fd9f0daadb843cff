"""Which faces may touch: candidates by nearness and facing, never by knowing the mesh."""

from __future__ import annotations

import numpy as np
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
    reference: np.ndarray | None = None,
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
    reference, joint_gap
        Undeformed positions [m], and the normal distance [m] below which two faces of one body
        count as joined: the two sides of a corner lie in one plane back to back, and would be
        found "in contact" as soon as the corner shears. None (separate bodies) keeps them all.

    Returns
    -------
    Indices into `masters`, shape (slave_count, CANDIDATE_COUNT), -1 where there are fewer.
    Faces that share a node or do not face each other are left out. The cost grows like
    n log n of the number of faces.
    """
    out = np.full((slaves.shape[0], CANDIDATE_COUNT), -1, dtype=np.int32)
    if not slaves.shape[0] or not masters.shape[0]:
        return out
    slave_centre, slave_normal = _frames(x, slaves)
    master_centre, master_normal = _frames(x, masters)
    # Neighbours on the same surface are many and never partners: ask for several times more.
    count = min(5 * CANDIDATE_COUNT, masters.shape[0])
    distance, found = cKDTree(master_centre).query(
        slave_centre, k=count, distance_upper_bound=reach
    )
    distance = distance.reshape(slaves.shape[0], count)
    found = found.reshape(slaves.shape[0], count)
    valid = np.isfinite(distance)
    index = np.where(valid, found, 0)
    valid &= np.einsum("ski,si->sk", master_normal[index], slave_normal) < FACING_COSINE
    shared = (masters[index][:, :, :, None] == slaves[:, None, None, :]).any(axis=(2, 3))
    valid &= ~shared
    if reference is not None:
        slave_rest, slave_rest_normal = _frames(reference, slaves)
        master_rest, master_rest_normal = _frames(reference, masters)
        apart = np.einsum(
            "ski,ski->sk", slave_rest[:, None] - master_rest[index], master_rest_normal[index]
        )
        valid &= np.abs(apart) > joint_gap
        facing = np.einsum("ski,si->sk", master_rest_normal[index], slave_rest_normal)
        opposite = (facing < FACING_COSINE) & (apart > 0.0)  # and not back to back on one wall
        slave_size, master_size = diagonals(reference, slaves), diagonals(reference, masters)
        size = np.maximum(slave_size[:, None], master_size[index])
        far = np.linalg.norm(slave_rest[:, None] - master_rest[index], axis=2) > CREASE * size
        valid &= opposite | far
    # Stable partition: valid ones first, in order of distance.
    order = np.argsort(~valid, axis=1, kind="stable")[:, :CANDIDATE_COUNT]
    picked = np.take_along_axis(np.where(valid, found, -1), order, axis=1)
    out[:, : picked.shape[1]] = picked
    return out


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
