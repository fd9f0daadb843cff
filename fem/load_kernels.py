"""Follower pressure on quadrilateral faces, with its load stiffness."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexapod.contact.face_kernels import POINTS, area_vector, shape, shape_derivatives
from flexapod.core.jit import kernel

_POINTS = POINTS


@kernel
def pressure_force(x: Any, faces: Any, pressure: float, force: Any) -> None:
    """Add ``p * integral(N_a n da)`` [N] to `force` (node_count, 3).

    `n` is the faces' own normal; on faces that look into a cavity the pressure pushes against
    it, so this is the term of the residual (internal minus external force).
    """
    n = np.empty(4)
    d = np.empty((4, 2))
    c = np.empty(3)
    for f in range(faces.shape[0]):
        for q in range(4):
            shape(_POINTS[q, 0], _POINTS[q, 1], n)
            shape_derivatives(_POINTS[q, 0], _POINTS[q, 1], d)
            area_vector(x, faces[f], d, c)
            for a in range(4):
                for i in range(3):
                    force[faces[f, a], i] += pressure * n[a] * c[i]


@kernel
def pressure_stiffness(x: Any, faces: Any, pressure: float, out: Any) -> None:
    """Fill `out` (face_count, 12, 12) with the symmetric load stiffness [N/m].

    On a closed cavity (or one cut by symmetry planes) the skew parts of neighbouring faces
    cancel, because the load has the potential ``-p V``; only the symmetric part is kept.
    (M. Mok, D. Roehl, W. Wall, M. Bischoff, E. Ramm 1999, "Algorithmic aspects of deformation
    dependent loads".)
    """
    n = np.empty(4)
    d = np.empty((4, 2))
    t = np.empty((2, 3))
    k = np.empty((12, 12))
    for f in range(faces.shape[0]):
        k[:] = 0.0
        for q in range(4):
            shape(_POINTS[q, 0], _POINTS[q, 1], n)
            shape_derivatives(_POINTS[q, 0], _POINTS[q, 1], d)
            for i in range(3):
                t[0, i] = 0.0
                t[1, i] = 0.0
                for a in range(4):
                    t[0, i] += d[a, 0] * x[faces[f, a], i]
                    t[1, i] += d[a, 1] * x[faces[f, a], i]
            for a in range(4):
                for b in range(4):
                    v0 = pressure * n[a] * (d[b, 1] * t[0, 0] - d[b, 0] * t[1, 0])
                    v1 = pressure * n[a] * (d[b, 1] * t[0, 1] - d[b, 0] * t[1, 1])
                    v2 = pressure * n[a] * (d[b, 1] * t[0, 2] - d[b, 0] * t[1, 2])
                    # The cross-product matrix [v]x.
                    k[3 * a, 3 * b + 1] -= v2
                    k[3 * a, 3 * b + 2] += v1
                    k[3 * a + 1, 3 * b] += v2
                    k[3 * a + 1, 3 * b + 2] -= v0
                    k[3 * a + 2, 3 * b] -= v1
                    k[3 * a + 2, 3 * b + 1] += v0
        for r in range(12):
            for s in range(12):
                out[f, r, s] = 0.5 * (k[r, s] + k[s, r])


@kernel
def enclosed_volume(x: Any, faces: Any) -> float:
    """Minus a third of ``integral(x . n da)`` over the faces [m3]: a cavity's volume."""
    d = np.empty((4, 2))
    n = np.empty(4)
    total = 0.0
    for f in range(faces.shape[0]):
        for q in range(4):
            shape(_POINTS[q, 0], _POINTS[q, 1], n)
            shape_derivatives(_POINTS[q, 0], _POINTS[q, 1], d)
            t00 = 0.0
            t01 = 0.0
            t02 = 0.0
            t10 = 0.0
            t11 = 0.0
            t12 = 0.0
            p0 = 0.0
            p1 = 0.0
            p2 = 0.0
            for a in range(4):
                node = faces[f, a]
                t00 += d[a, 0] * x[node, 0]
                t01 += d[a, 0] * x[node, 1]
                t02 += d[a, 0] * x[node, 2]
                t10 += d[a, 1] * x[node, 0]
                t11 += d[a, 1] * x[node, 1]
                t12 += d[a, 1] * x[node, 2]
                p0 += n[a] * x[node, 0]
                p1 += n[a] * x[node, 1]
                p2 += n[a] * x[node, 2]
            total += (
                p0 * (t01 * t12 - t02 * t11)
                + p1 * (t02 * t10 - t00 * t12)
                + p2 * (t00 * t11 - t01 * t10)
            )
    return -total / 3.0
