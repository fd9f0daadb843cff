"""Kernels of the search for candidate faces: a grid of cells, and the rules of who may touch."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from flexapod.core.jit import inline_kernel, kernel, parallel_kernel

# What lies farther beside the grid than this many cells counts as that far; above any span.
FAR = 8


@inline_kernel
def _cell(place: float, low: float, width: float, count: int) -> int:
    """Row of cells a coordinate lies in; those `FAR` cells beyond either end stand for all."""
    s = (place - low) / width
    # Written so that a NaN, too, ends at a number.
    if not s > -FAR:
        return -FAR
    return math.floor(min(s, count + FAR))


@inline_kernel
def _number(place: Any, low: Any, width: Any, count: Any) -> int:
    """Number of the cell a point lies in, of the nearest one if it lies beside the grid."""
    c = 0
    for i in range(3):
        cell = _cell(place[i], low[i], width[i], count[i])
        c = c * count[i] + min(max(cell, 0), count[i] - 1)
    return c


@kernel
def sort_into_cells(centre: Any, low: Any, width: Any, count: Any, start: Any, order: Any) -> None:
    """Sort points (n, 3) into a grid of ``count`` (3,) cells from `low`, `width` wide [m].

    Cell (i, j, k) holds the points ``order[start[c]:start[c + 1]]``, in ascending order, with
    ``c = (i * count[1] + j) * count[2] + k``. `start` (cell_count + 1,), `order` (n,).
    """
    start[:] = 0
    for f in range(centre.shape[0]):
        start[_number(centre[f], low, width, count)] += 1
    # Each cell's end first; filling it from the back leaves its start.
    for c in range(1, start.shape[0]):
        start[c] += start[c - 1]
    for f in range(centre.shape[0] - 1, -1, -1):
        c = _number(centre[f], low, width, count)
        start[c] -= 1
        order[start[c]] = f


@kernel
def face_radii(x: Any, faces: Any, out: Any) -> None:
    """Fill `out` (face_count,) with the largest distance of a corner from the centre [m]."""
    for f in range(faces.shape[0]):
        largest = 0.0
        for a in range(4):
            square = 0.0
            for i in range(3):
                away = x[faces[f, a], i] - 0.25 * (
                    x[faces[f, 0], i] + x[faces[f, 1], i] + x[faces[f, 2], i] + x[faces[f, 3], i]
                )
                square += away * away
            largest = max(largest, square)
        out[f] = math.sqrt(largest)


@inline_kernel
def _may_touch(
    f: int,
    m: int,
    slaves: Any,
    masters: Any,
    slave_normal: Any,
    master_normal: Any,
    facing: float,
    joined: bool,
    joint_gap: float,
    crease: float,
    slave_rest: Any,
    slave_rest_normal: Any,
    slave_size: Any,
    master_rest: Any,
    master_rest_normal: Any,
    master_size: Any,
) -> bool:
    cosine = 0.0
    for i in range(3):
        cosine += slave_normal[f, i] * master_normal[m, i]
    if not cosine < facing:
        return False
    for a in range(4):
        for b in range(4):
            if slaves[f, a] == masters[m, b]:
                return False
    if not joined:
        return True
    apart = 0.0
    square = 0.0
    cosine = 0.0
    for i in range(3):
        d = slave_rest[f, i] - master_rest[m, i]
        apart += d * master_rest_normal[m, i]
        square += d * d
        cosine += slave_rest_normal[f, i] * master_rest_normal[m, i]
    opposite = cosine < facing and apart > 0.0  # and not back to back on one wall
    across = abs(apart) > joint_gap
    size = max(slave_size[f], master_size[m])
    return (opposite and across) or math.sqrt(square) > crease * size


@parallel_kernel
def pick_candidates(
    low: Any,
    width: Any,
    cells: Any,
    start: Any,
    order: Any,
    place: Any,
    span: int,
    reach: float,
    slave_radius: Any,
    master_radius: Any,
    slaves: Any,
    masters: Any,
    slave_centre: Any,
    slave_normal: Any,
    master_normal: Any,
    facing: float,
    joined: bool,
    joint_gap: float,
    crease: float,
    slave_rest: Any,
    slave_rest_normal: Any,
    slave_size: Any,
    master_rest: Any,
    master_rest_normal: Any,
    master_size: Any,
    out: Any,
) -> None:
    """Write per slave face the master faces in reach that may touch, nearest first.

    Centres are no farther apart than both radii and `reach` [m]: `slave_radius` (slave_count,),
    `master_radius` (master_count,) in the grid's order.

    See `contact.search.candidate_faces`, whose rules these are; the arrays named rest belong to
    the undeformed surfaces and count where `joined` says that both are of one body. The grid is
    that of `sort_into_cells` for the masters' centres, its cells no narrower than the
    farthest of these distances over `span`; `place` (master_count, 3) holds the centres in its
    order. `out` (slave_count, n) gets the n nearest, of equals the one with the lower number, and
    -1 where there are fewer.
    """
    for f in numba.prange(slaves.shape[0]):
        square = np.empty(out.shape[1])
        count = 0
        at = np.empty(3, dtype=np.int64)
        for i in range(3):
            at[i] = _cell(slave_centre[f, i], low[i], width[i], cells[i])
        last = min(at[2] + span + 1, cells[2])
        for i in range(max(at[0] - span, 0), min(at[0] + span + 1, cells[0])):
            for j in range(max(at[1] - span, 0), min(at[1] + span + 1, cells[1])):
                # Cells of a row lie one after the other.
                row = (i * cells[1] + j) * cells[2]
                first = min(max(at[2] - span, 0), max(last, 0))
                for e in range(start[row + first], start[row + max(last, 0)]):
                    s = 0.0
                    for a in range(3):
                        d = slave_centre[f, a] - place[e, a]
                        s += d * d
                    most = slave_radius[f] + master_radius[e] + reach
                    if not s < most * most:
                        continue
                    m = order[e]
                    k = count
                    while k > 0 and (
                        s < square[k - 1] or (s == square[k - 1] and m < out[f, k - 1])
                    ):
                        k -= 1
                    if k == out.shape[1] or not _may_touch(
                        f,
                        m,
                        slaves,
                        masters,
                        slave_normal,
                        master_normal,
                        facing,
                        joined,
                        joint_gap,
                        crease,
                        slave_rest,
                        slave_rest_normal,
                        slave_size,
                        master_rest,
                        master_rest_normal,
                        master_size,
                    ):
                        continue
                    count = min(count + 1, out.shape[1])
                    for b in range(count - 1, k, -1):
                        square[b] = square[b - 1]
                        out[f, b] = out[f, b - 1]
                    square[k] = s
                    out[f, k] = m
        for k in range(count, out.shape[1]):
            out[f, k] = -1
