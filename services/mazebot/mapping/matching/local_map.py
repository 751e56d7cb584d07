"""The map near the robot, made of the scans of nearby keyframes: lines in small cells.

Each cell that holds returns has a surfel: the line fitted to the returns in it and in the cells
around it that were seen from the same side. So both faces of a wall are distinguished, and a scan
can be fitted far more precisely than the cells are large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel

PAINT_CELLS = 5
"""Cells around a surfel that know it."""
_MOST_CELLS = 4_000_000
_ENOUGH, _SPREAD_M2 = 5.0, 4e-4
"""A line has at least so many returns, with this variance along it."""
_AGREE = 0.95
"""Length of the mean of normals that agree."""
_FLAT = 0.2
"""A line's returns scatter across it by less than this share of the variance along it."""

# Columns of surfels.
MEAN_X, MEAN_Y, NORMAL_X, NORMAL_Y, FLAT = range(5)


@dataclass(frozen=True)
class LocalMap:
    """Surfels, and for each cell of a dense grid the nearest of them."""

    x_m: float
    """map coordinates of the corner of cell (0, 0); the grid has the map's axes"""
    y_m: float
    cell_m: float
    surfels: Array
    """(s, 5) a point on the line, its normal towards where it was seen from, and 1 where the
    returns form a line, 0 where they do not.
    """
    nearest: NDArray[np.int32]
    """(rows, columns) index of the surfel nearest to a cell's centre, -1 where none is near."""
    distance_m: NDArray[np.float32]
    """(rows, columns) from the cell's centre to it; infinite where none is near."""

    @cached_property
    def has_surfels(self) -> bool:
        """Whether there is anything to match."""
        return len(self.surfels) > 0


def local_map(poses: Sequence[SE2], clouds: Sequence[Array], cell_m: float) -> LocalMap:
    """From keyframes: map_from_base, and what was seen there in the base's frame, as
    `scan_points.surface_cloud` makes it, n times 6.
    """
    counts = np.array([len(one) for one in clouds], np.int64)
    cloud = np.ascontiguousarray(np.concatenate([np.zeros((0, 6)), *clouds]))
    if len(cloud) == 0:
        return _empty(cell_m)
    moved, views = np.empty((len(cloud), 2)), np.empty((len(cloud), 2))
    low, high = np.empty(2), np.empty(2)
    _place(np.array(poses, np.float64).reshape(-1, 3), counts, cloud, moved, views, low, high)
    (columns, rows), (column0, row0) = _extent(low, high, cell_m)
    if rows * columns > _MOST_CELLS:
        # What is farthest from the keyframes is left out.
        middle_m = np.array([pose[:2] for pose in poses]).mean(axis=0)
        half_m = (math.sqrt(_MOST_CELLS) / 2.0 - PAINT_CELLS - 3) * cell_m
        near = (np.abs(moved - middle_m) < half_m).all(axis=1)
        if not near.any():
            return _empty(cell_m)
        cloud, moved, views = cloud[near], moved[near], views[near]
        (columns, rows), (column0, row0) = _extent(moved.min(axis=0), moved.max(axis=0), cell_m)
    x_m, y_m = column0 * cell_m, row0 * cell_m
    nearest = np.full((rows, columns), -1, np.int32)
    distance_m = np.full((rows, columns), np.inf, np.float32)
    surfels = _surfels(moved, views, np.ascontiguousarray(cloud[:, 4:]), x_m, y_m, cell_m, nearest)
    nearest[:] = -1
    _paint(surfels, x_m, y_m, cell_m, nearest, distance_m)
    return LocalMap(x_m, y_m, cell_m, surfels, nearest, distance_m)


def _extent(low_m: Array, high_m: Array, cell_m: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """(columns, rows) of the grid of a map from low to high, and its first (column, row)."""
    margin = PAINT_CELLS + 1
    column0, row0 = (math.floor(value / cell_m) - margin for value in low_m.tolist())
    columns, rows = (
        math.floor(value / cell_m) + margin + 1 - first
        for value, first in zip(high_m.tolist(), (column0, row0), strict=True)
    )
    return (columns, rows), (column0, row0)


def compacted(cloud: Array, cell_m: float) -> Array:
    """A cloud (n, 6) with one mean return for each small cell."""
    return _compacted(np.ascontiguousarray(cloud), 1.0 / cell_m)


def _empty(cell_m: float) -> LocalMap:
    return LocalMap(
        0.0, 0.0, cell_m, np.empty((0, 5)), np.full((1, 1), -1, np.int32),
        np.full((1, 1), np.inf, np.float32),
    )  # fmt: skip


@kernel(
    "void(float64[:, ::1], int64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], "
    "float64[::1], float64[::1])"
)
def _place(
    poses: Array, counts: NDArray[np.int64], cloud: Array, moved: Array, views: Array,
    low: Array, high: Array,
) -> None:  # fmt: skip
    """Returns in the map, their normals or directions to the lidar, and the extent."""
    j = 0
    low[:] = np.inf
    high[:] = -np.inf
    for i in range(poses.shape[0]):
        c, s = portable_kernels.cos_sin(poses[i, 2])
        for _ in range(counts[i]):
            dx, dy = cloud[j, 2], cloud[j, 3]
            moved[j, 0] = poses[i, 0] + c * cloud[j, 0] - s * cloud[j, 1]
            moved[j, 1] = poses[i, 1] + s * cloud[j, 0] + c * cloud[j, 1]
            low[0], low[1] = min(low[0], moved[j, 0]), min(low[1], moved[j, 1])
            high[0], high[1] = max(high[0], moved[j, 0]), max(high[1], moved[j, 1])
            views[j, 0], views[j, 1] = c * dx - s * dy, s * dx + c * dy
            j += 1


@kernel(
    "float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, ::1], float64, float64, float64, "
    "int32[:, ::1])"
)
def _surfels(
    points: Array,
    views: Array,
    counts: Array,
    x0: float,
    y0: float,
    cell: float,
    index: NDArray[np.int32],
) -> Array:
    """Surfels of all cells with returns; `index` is used for their numbers."""
    count = 0
    for i in range(points.shape[0]):
        column, row = int((points[i, 0] - x0) / cell), int((points[i, 1] - y0) / cell)
        if index[row, column] < 0:
            index[row, column] = count
            count += 1
    sums = np.zeros((count, 11))
    where = np.empty((count, 2), np.int64)
    for i in range(points.shape[0]):
        column, row = int((points[i, 0] - x0) / cell), int((points[i, 1] - y0) / cell)
        k = index[row, column]
        where[k, 0], where[k, 1] = row, column
        # About the grid's corner, so that sums of neighbours add up.
        x, y = points[i, 0] - x0 - column * cell, points[i, 1] - y0 - row * cell
        m, flat_m = counts[i, 1], counts[i, 0] * counts[i, 1]
        sums[k, 0] += m
        sums[k, 1] += m * x
        sums[k, 2] += m * y
        sums[k, 3] += m * x * x
        sums[k, 4] += m * x * y
        sums[k, 5] += m * y * y
        sums[k, 6] += m * views[i, 0]
        sums[k, 7] += m * views[i, 1]
        sums[k, 8] += flat_m
        sums[k, 9] += flat_m * views[i, 0]
        sums[k, 10] += flat_m * views[i, 1]
    surfels = np.empty((count, 5))
    made = 0
    for k in range(count):
        row, column = where[k, 0], where[k, 1]
        vx, vy = sums[k, 6], sums[k, 7]
        n = mx = my = xx = xy = yy = flats = fx = fy = 0.0
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                j = index[row + dr, column + dc]
                if j < 0 or sums[j, 6] * vx + sums[j, 7] * vy <= 0.0:
                    continue
                m, ox, oy = sums[j, 0], dc * cell, dr * cell
                flats += sums[j, 8]
                fx += sums[j, 9]
                fy += sums[j, 10]
                n += m
                mx += sums[j, 1] + m * ox
                my += sums[j, 2] + m * oy
                xx += sums[j, 3] + 2.0 * ox * sums[j, 1] + m * ox * ox
                xy += sums[j, 4] + oy * sums[j, 1] + ox * sums[j, 2] + m * ox * oy
                yy += sums[j, 5] + 2.0 * oy * sums[j, 2] + m * oy * oy
        if n < 1.0:
            continue
        mx, my = mx / n, my / n
        xx, xy, yy = xx / n - mx * mx, xy / n - mx * my, yy / n - my * my
        half, differ = 0.5 * (xx + yy), 0.5 * (xx - yy)
        root = math.sqrt(differ * differ + xy * xy)
        small, large = max(half - root, 0.0), half + root
        # The direction along the line is the eigenvector of the larger eigenvalue.
        if differ >= 0.0:
            tx, ty = root + differ, xy
        else:
            tx, ty = xy, root - differ
        length = math.sqrt(tx * tx + ty * ty)
        flat = n >= _ENOUGH and length > 1e-9 and small < _FLAT * large and large > _SPREAD_M2
        towards = math.sqrt(fx * fx + fy * fy)
        if not flat and flats > 0.5 * n and towards > _AGREE * flats:
            # Too few returns for a line of their own: the one that their beams' neighbours gave.
            flat = True
            tx, ty, length = fy, -fx, towards
        own_x, own_y = sums[k, 1] / sums[k, 0], sums[k, 2] / sums[k, 0]
        if flat:
            tx, ty = tx / length, ty / length
            nx, ny = -ty, tx
            if nx * vx + ny * vy < 0.0:
                nx, ny = -nx, -ny
            # The point of the line that is nearest to the cell's own returns.
            along = (own_x - mx) * tx + (own_y - my) * ty
            mx, my = mx + along * tx, my + along * ty
        else:
            length = math.sqrt(vx * vx + vy * vy) + 1e-9
            nx, ny = vx / length, vy / length
            mx, my = own_x, own_y
        surfels[made, 0] = x0 + column * cell + mx
        surfels[made, 1] = y0 + row * cell + my
        surfels[made, 2], surfels[made, 3] = nx, ny
        surfels[made, 4] = 1.0 if flat else 0.0
        made += 1
    return surfels[:made].copy()


@kernel("void(float64[:, ::1], float64, float64, float64, int32[:, ::1], float32[:, ::1])")
def _paint(
    surfels: Array, x0: float, y0: float, cell: float, nearest: NDArray[np.int32],
    distance: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write into the cells within PAINT_CELLS of each surfel which one is nearest."""
    rows, columns = nearest.shape
    far = np.float32(PAINT_CELLS * PAINT_CELLS * cell * cell)
    for k in range(surfels.shape[0]):
        x, y = surfels[k, 0] - x0, surfels[k, 1] - y0
        column, row = int(x / cell), int(y / cell)
        first, last = max(0, column - PAINT_CELLS), min(columns, column + PAINT_CELLS + 1)
        for r in range(max(0, row - PAINT_CELLS), min(rows, row + PAINT_CELLS + 1)):
            dy = (r + 0.5) * cell - y
            for c in range(first, last):
                dx = (c + 0.5) * cell - x
                d = np.float32(dx * dx + dy * dy)
                if d < distance[r, c] and d <= far:
                    distance[r, c] = d
                    nearest[r, c] = k
    # Until here the distances are squares.
    for r in range(rows):
        for c in range(columns):
            if nearest[r, c] >= 0:
                distance[r, c] = math.sqrt(distance[r, c])


@kernel("float64[:, ::1](float64[:, ::1], float64)")
def _compacted(cloud: Array, cells_per_m: float) -> Array:
    n = cloud.shape[0]
    keys = np.empty(n, np.int64)
    for i in range(n):
        column = math.floor(cloud[i, 0] * cells_per_m)
        row = math.floor(cloud[i, 1] * cells_per_m)
        keys[i] = row * 16777216 + column
    order = np.argsort(keys, kind="mergesort")
    means = np.zeros((n, 6))
    made = -1
    for o in range(n):
        i = order[o]
        if o == 0 or keys[i] != keys[order[o - 1]]:
            made += 1
        m = cloud[i, 5]
        for k in range(5):
            means[made, k] += m * cloud[i, k]
        means[made, 5] += m
    for j in range(made + 1):
        for k in range(5):
            means[j, k] /= means[j, 5]
    return means[: made + 1].copy()
