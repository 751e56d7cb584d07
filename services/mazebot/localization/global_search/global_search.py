"""Search of the whole map for the poses from which a scan may have been taken.

Every free position of a raster and every heading is tried, as in correlative scan matching (Olson,
ICRA 2009), in an order that suits the processor: for one heading a beam's end is the same offset
from every position, so that a row of scores grows by a row of a table of whole numbers. The best
peaks are refined by scan matching and judged beam by beam. On the map of a house this takes less
than branch and bound, and it finds all the poses that look alike, not only one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.grids import connected_regions
from mazebot.localization.beam_model import UNMAPPED, RayMap, ScanView, in_wall, judge
from mazebot.localization.global_search.scan_matching import refine
from mazebot.localization.likelihood_field import OCCUPIED

BODY_M = 0.12
"""No robot's origin is nearer to a wall."""
_DOOR_M = 0.3
"""A border to the unknown that is narrower lets no robot through."""
_STEP_M = 0.1
_HEADINGS = 72
_MOST_POSES = 24_000_000
"""Positions times headings; in larger maps the step grows."""
_BLUR_M = 0.12
"""Standard deviation of the table: half a step of position and of heading move a beam's end so."""
_POINTS = 60
_FULL = 200
"""Score of a beam that ends on a wall: with 60 beams the sum is within 16 bits."""
_MOST_POINTS = 65535 // _FULL
_LEAST_SHARE = 0.6
"""Peaks lower than this share of the highest are left out."""
_MOST_PEAKS = 20_000


@dataclass(frozen=True)
class SearchMap:
    """Tables for searching a map, by its own axes."""

    phases: NDArray[np.uint8]
    """(2, 2, rows + 1, columns + 1) scores of a beam's end, in half steps: row 2 i + a and column
    2 j + b of them is at [a, b, i, j].
    """
    free: NDArray[np.bool_]
    """(rows, columns) positions where a robot may stand."""
    step_m: float
    map_from_raster: SE2
    """Pose of the raster's position (0, 0)."""
    leads_out: NDArray[np.bool_]
    """(map rows, map columns) from where a robot can go to what the map does not show."""
    map_from_grid: SE2
    resolution_m: float

    def is_open(self, pose: SE2) -> bool:
        """Whether a robot at a pose could as well be where the map knows nothing."""
        place = self.map_from_grid.inverse() @ pose
        row = math.floor(place.y_m / self.resolution_m)
        column = math.floor(place.x_m / self.resolution_m)
        rows, columns = self.leads_out.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return not inside or bool(self.leads_out[row, column])

    def around(self, pose: SE2, within_m: float) -> tuple[slice, slice]:
        """The rows and columns of positions within a distance of a pose, along both axes."""
        place = self.map_from_raster.inverse() @ pose
        rows, columns = (
            slice(
                math.floor(min(max((at_m - within_m) / self.step_m, 0.0), float(count))),
                math.ceil(min(max((at_m + within_m) / self.step_m + 1.0, 0.0), float(count))),
            )
            for at_m, count in zip((place.y_m, place.x_m), self.free.shape, strict=True)
        )
        return rows, columns


def search_map(cells: NDArray[np.int8], resolution_m: float, rays: RayMap) -> SearchMap:
    """Tables of a map with (rows, columns) cells, as `likelihood_field` takes them."""
    rows_m, columns_m = cells.shape[0] * resolution_m, cells.shape[1] * resolution_m
    step_m = _STEP_M
    while (rows_m / step_m) * (columns_m / step_m) * _HEADINGS > _MOST_POSES:
        step_m *= 2.0
    rows, columns = math.ceil(rows_m / step_m), math.ceil(columns_m / step_m)
    map_from_raster = rays.map_from_grid @ SE2(step_m / 2.0, step_m / 2.0, 0.0)
    scores = np.zeros((2 * rows + 2, 2 * columns + 2), np.uint8)
    distance_m = _distances(rays, map_from_raster, scores.shape, step_m / 2.0)
    blur_m = _BLUR_M * step_m / _STEP_M
    scores[:] = np.floor(
        _FULL * portable_kernels.exp_each(-0.5 * portable.square(distance_m / blur_m)) + 0.5
    )
    phases = np.ascontiguousarray(scores.reshape(rows + 1, 2, columns + 1, 2).transpose(1, 3, 0, 2))
    clear = distance_m[: 2 * rows : 2, : 2 * columns : 2] >= BODY_M
    at_row = np.minimum((np.arange(rows) + 0.5) * step_m / resolution_m, cells.shape[0] - 1)
    at_column = np.minimum((np.arange(columns) + 0.5) * step_m / resolution_m, cells.shape[1] - 1)
    here = cells[np.ix_(at_row.astype(np.int64), at_column.astype(np.int64))]
    return SearchMap(
        phases, clear & (here >= 0) & (here < OCCUPIED), step_m, map_from_raster,
        _leads_out(cells, resolution_m), rays.map_from_grid, resolution_m,
    )  # fmt: skip


def _leads_out(cells: NDArray[np.int8], resolution_m: float) -> NDArray[np.bool_]:
    """(rows, columns) what is unknown, and the floor whose border to it, or to the end of the map,
    is somewhere wide enough for a robot.
    """
    floor = (cells >= 0) & (cells < OCCUPIED)
    unknown = np.pad(cells < 0, 1, constant_values=True)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    borders = connected_regions(floor & beside)
    lengths_m = np.bincount(borders.ravel()) * resolution_m
    lengths_m[0] = 0.0
    regions = connected_regions(floor)
    leaves = np.zeros(int(regions.max()) + 1, np.bool_)
    leaves[regions[lengths_m[borders] >= _DOOR_M]] = True
    leaves[0] = False
    return np.asarray(leaves[regions] | (cells < 0))


def _distances(rays: RayMap, map_from_raster: SE2, shape: tuple[int, int], pitch_m: float) -> Array:
    """Signed distances to walls at the points of a raster."""
    field = rays.field
    field_from_raster = field.map_from_field.inverse() @ map_from_raster
    x = field_from_raster.x_m + np.arange(shape[1]) * pitch_m
    y = field_from_raster.y_m + np.arange(shape[0]) * pitch_m
    columns = np.floor(x / field.cell_m).astype(np.int64)
    rows = np.floor(y / field.cell_m).astype(np.int64)
    height, width = field.distance_m.shape
    inside_x, inside_y = (columns >= 0) & (columns < width), (rows >= 0) & (rows < height)
    distance_m = np.full(shape, float(field.distance_m.max()))
    found = field.distance_m[np.ix_(rows[inside_y], columns[inside_x])]
    distance_m[np.ix_(np.flatnonzero(inside_y), np.flatnonzero(inside_x))] = found
    return distance_m


def global_search(
    table: SearchMap,
    rays: RayMap,
    view: ScanView,
    count: int,
    where: tuple[slice, slice] = (slice(None), slice(None)),
) -> tuple[Array, Array, Array]:
    """The poses from which a scan may have been taken, the likeliest first; `where`: at these rows
    and columns of the table alone.

    Returns (k, 3) poses in the map, k up to `count`, their (k, 7) counts of beams and their (k,)
    log-likelihoods, as `judge` gives them. A scan without returns gives none: every pose in the
    open would do.
    """
    empty = np.empty((0, 3))
    free = table.free[where]
    if view.returns == 0 or not free.any():
        return empty, np.empty((0, UNMAPPED + 1)), np.empty(0)
    points_m = _spread(view.points_m, min(_POINTS, _MOST_POINTS))
    turn = 2.0 * math.pi / _HEADINGS
    cos, sin = portable_kernels.cos_sin_each(np.arange(_HEADINGS) * turn)
    first_row, first_column = (along.start or 0 for along in where)
    scores = np.zeros((_HEADINGS, *free.shape), np.uint16)
    _correlate(
        table.phases, points_m, cos, sin, 2.0 / table.step_m, first_row, first_column, scores
    )
    scores *= free
    least = max(1, int(_LEAST_SHARE * int(scores.max())))
    peaks = np.empty((_MOST_PEAKS, 4), np.int64)
    found = _peaks(scores, least, peaks)
    best = np.argsort(-peaks[:found, 0], kind="stable")[:count]
    chosen = peaks[best].astype(np.float64)
    poses = np.empty((len(chosen), 3))
    frame = table.map_from_raster
    c, s = portable_kernels.cos_sin(frame.yaw_rad)
    x = (first_column + chosen[:, 3]) * table.step_m
    y = (first_row + chosen[:, 2]) * table.step_m
    poses[:, 0] = frame.x_m + c * x - s * y
    poses[:, 1] = frame.y_m + s * x + c * y
    poses[:, 2] = (frame.yaw_rad + chosen[:, 1] * turn + math.pi) % (2.0 * math.pi) - math.pi
    poses, _ = refine(
        rays.field, poses, points_m, prior_std_m=0.5, prior_std_rad=0.5, return_std_m=0.1,
        wide=8, narrow=6,
    )  # fmt: skip
    poses = poses[~in_wall(rays, poses, BODY_M / 2.0)]
    counts, likelihoods = judge(rays, poses, view)
    order = np.argsort(-likelihoods, kind="stable")
    order = order[distinct(poses[order], 0.08, 0.1)]
    return poses[order], counts[order], likelihoods[order]


def distinct(poses: Array, apart_m: float, apart_rad: float) -> NDArray[np.int64]:
    """Indices of (n, 3) poses of which no earlier one is nearer than both limits."""
    kept = np.empty(len(poses), np.int64)
    return kept[: _distinct(np.ascontiguousarray(poses), apart_m, apart_rad, kept)]


def _spread(points_m: Array, most: int) -> Array:
    stride = -(-len(points_m) // most)
    return np.ascontiguousarray(points_m[::stride])


@kernel(
    "void(uint8[:, :, :, ::1], float64[:, ::1], float64[::1], float64[::1], float64, int64, "
    "int64, uint16[:, :, ::1])"
)
def _correlate(
    phases: NDArray[np.uint8],
    points: Array,
    cos: Array,
    sin: Array,
    half_steps_per_m: float,
    first_row: int,
    first_column: int,
    scores: NDArray[np.uint16],
) -> None:
    rows, columns = scores.shape[1], scores.shape[2]
    height, width = phases.shape[2], phases.shape[3]
    for a in range(scores.shape[0]):
        for j in range(points.shape[0]):
            x = cos[a] * points[j, 0] - sin[a] * points[j, 1]
            y = sin[a] * points[j, 0] + cos[a] * points[j, 1]
            along_x = math.floor(x * half_steps_per_m + 0.5)
            along_y = math.floor(y * half_steps_per_m + 0.5)
            table = phases[along_y & 1, along_x & 1]
            off_x, off_y = first_column + (along_x >> 1), first_row + (along_y >> 1)
            first, last = max(0, -off_x), min(columns, width - off_x)
            if last <= first:
                continue
            for i in range(max(0, -off_y), min(rows, height - off_y)):
                row = table[i + off_y, first + off_x : last + off_x]
                into = scores[a, i, first:last]
                for k in range(into.shape[0]):
                    into[k] = np.uint16(into[k] + np.uint16(row[k]))


@kernel("int64(uint16[:, :, ::1], int64, int64[:, ::1])")
def _peaks(scores: NDArray[np.uint16], least: int, peaks: NDArray[np.int64]) -> int:
    headings, rows, columns = scores.shape
    found = 0
    for a in range(headings):
        for i in range(rows):
            for k in range(columns):
                score = scores[a, i, k]
                if score < least:
                    continue
                highest = True
                for da in (-1, 0, 1):
                    other = (a + da) % headings
                    for ni in range(max(0, i - 1), min(rows, i + 2)):
                        for nk in range(max(0, k - 1), min(columns, k + 2)):
                            if scores[other, ni, nk] > score:
                                highest = False
                if highest and found < peaks.shape[0]:
                    peaks[found, 0], peaks[found, 1] = score, a
                    peaks[found, 2], peaks[found, 3] = i, k
                    found += 1
    return found


@kernel("int64(float64[:, ::1], float64, float64, int64[::1])")
def _distinct(poses: Array, apart_m: float, apart_rad: float, kept: NDArray[np.int64]) -> int:
    count = 0
    for i in range(poses.shape[0]):
        alone = True
        for j in range(count):
            x = poses[i, 0] - poses[kept[j], 0]
            y = poses[i, 1] - poses[kept[j], 1]
            turn = (poses[i, 2] - poses[kept[j], 2] + math.pi) % (2.0 * math.pi) - math.pi
            if x * x + y * y < apart_m * apart_m and abs(turn) < apart_rad:
                alone = False
                break
        if alone:
            kept[count] = i
            count += 1
    return count
