"""The obstacle layer: a scan's echoes mark cells, its rays clear them.

Against what users report of Nav2: rays without an echo clear by default, up to the range of the
sensor; what is marked can always be cleared; marks that no ray meets again are forgotten after a
while; and a cell far away, between whose rays a thin post fits, is not cleared by the first of
them.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan
from mazebot.common.world.costmap import Clearance, Mask
from mazebot.navigation.costmap.footprint import Footprint, distance_at, signed_distance_m
from mazebot.navigation.costmap.inflation_layer import Window

_FILL_M: Final = 0.25
"""Between two neighbouring echoes nearer to one another than this the surface is marked too: no
robot passes there, and grazing rays must not open it.
"""
_LOST_RAYS: Final = 2
"""Across so many rays without echo two echoes still count as neighbours."""
_AGAIN: Final = 3
_MOST_SCORE: Final = 8
"""A near cell is cleared by one ray with an echo from behind it. All others need one ray, and so
many more for each scan that marked them again: what moves leaves no trail, and a thin post, which
most rays miss, does not flicker.
"""
_DECAY_CHECK_NS: Final = 1_000_000_000

D = TypeVar("D", bound=np.generic)

Moving = Array
"""(n, 3) circles of things that move: x, y, radius in metres, in the layer's frame."""
NOTHING_MOVES: Final[Moving] = np.empty((0, 3))


class ScanSourceParams(Params):
    """How the scan marks and clears; names as in Nav2's observation sources."""

    obstacle_max_range: float = Field(
        2.5, gt=0, description="m; returns nearer than this mark obstacles"
    )
    obstacle_min_range: float = Field(0.0, ge=0, description="m; nearer returns mark nothing")
    raytrace_max_range: float = Field(
        3.0,
        gt=0,
        description="m; rays clear obstacles up to this range, and at least up to "
        "obstacle_max_range",
    )
    raytrace_min_range: float = Field(0.0, ge=0, description="m; rays clear nothing nearer")
    inf_is_valid: bool = Field(True, description="whether a ray without a return clears")


class ObstacleParams(Params):
    """Names as in Nav2's obstacle layer."""

    scan: ScanSourceParams = ScanSourceParams()
    footprint_clearing_enabled: bool = Field(
        True, description="whether the robot's own place is free"
    )
    static_margin: float = Field(
        0.2,
        ge=0,
        description="m; in the global costmap, a return this near to a wall of the map marks no "
        "obstacle, as a small pose error must not narrow a doorway; where the pose is known well, "
        "it has to be nearer",
    )
    decay_time: float = Field(
        30.0, ge=0, description="s; marks not seen again for this long are forgotten; 0: never"
    )


class ObstacleLayer:
    """The marks on a grid of (rows, columns)."""

    def __init__(self, rows: int, columns: int, params: ObstacleParams) -> None:
        self._params = params
        self.marked: Mask = np.zeros((rows, columns), np.bool_)
        self._score = np.zeros((rows, columns), np.uint8)
        """Rays that have to pass a marked cell before it is cleared."""
        self._seen = np.zeros((rows, columns), np.int32)
        """Number of the scan in which a marked cell had its last echo."""
        self._scans = 0
        self._times: deque[tuple[int, int]] = deque()
        """Time and number of a scan, each second."""
        self._extent: Window = (rows, 0, columns, 0)
        """No cell outside it is marked."""

    def update(
        self,
        scan: Scan,
        sensor: tuple[float, float, float],
        resolution_m: float,
        static_distance_m: Clearance | None,
        moving_cells: Moving,
        static_margin_m: float | None = None,
    ) -> Window | None:
        """Mark and clear; the window of cells that changed, if any.

        Args:
            scan: its ranges and its time.
            sensor: column, row and yaw of the lidar.
            resolution_m: side of a cell.
            static_distance_m: (rows, columns), distance from the walls of the map, where echoes of
                those are not to be marked.
            moving_cells: (n, 3) circles, column, row and radius in cells, that are not to be
                marked.
            static_margin_m: instead of the parameter.
        """
        rows, columns = self.marked.shape
        changed = np.array([rows, 0, columns, 0])
        params = self._params
        self._scans += 1
        no_map = np.empty((0, 0), np.float32)
        _mark_and_clear(
            self.marked, self._score, self._seen, changed,
            no_map if static_distance_m is None else static_distance_m,
            float(params.static_margin if static_margin_m is None else static_margin_m),
            # A copy: a kernel is compiled again for a read-only array.
            np.array(scan.ranges_m, np.float32),
            float(scan.angle_min_rad + sensor[2]), float(scan.angle_increment_rad),
            float(max(scan.range_min_m, params.scan.obstacle_min_range)),
            float(params.scan.obstacle_max_range),
            float(max(scan.range_min_m, params.scan.raytrace_min_range)),
            float(max(params.scan.raytrace_max_range, params.scan.obstacle_max_range)),
            bool(params.scan.inf_is_valid),
            float(sensor[0]), float(sensor[1]), float(resolution_m), self._scans,
            np.array(moving_cells, np.float64).reshape(-1, 3),
        )  # fmt: skip
        self._note(changed)
        self._decay(scan.stamp_ns, changed)
        return _window(changed)

    def clear_footprint(
        self, footprint: Footprint, column: float, row: float, yaw_rad: float, resolution_m: float
    ) -> Window | None:
        """Clear the cells whose centres the robot covers."""
        if not self._params.footprint_clearing_enabled:
            return None
        changed = np.array([self.marked.shape[0], 0, self.marked.shape[1], 0])
        cos_yaw, sin_yaw = portable_kernels.cos_sin(float(yaw_rad))
        _clear_polygon(
            self.marked, changed, footprint.points_m, footprint.circumscribed_radius_m,
            column, row, cos_yaw, sin_yaw, resolution_m,
        )  # fmt: skip
        return _window(changed)

    def clear(self) -> Window | None:
        """Clear every mark."""
        window = _window(np.array(self._extent))
        if window is not None:
            self.marked[window[0] : window[1], window[2] : window[3]] = False
        self._extent = (self.marked.shape[0], 0, self.marked.shape[1], 0)
        return window

    def clear_square(self, square: Window, inside: bool) -> Window | None:
        """Clear the marks in a window of cells, or all the others."""
        extent = _window(np.array(self._extent))
        if extent is None:
            return None
        row0, row1, column0, column1 = (max(0, end) for end in square)
        if inside:
            self.marked[row0:row1, column0:column1] = False
            return _window(np.array([row0, min(row1, len(self.marked)), column0, column1]))
        kept = self.marked[row0:row1, column0:column1].copy()
        self.marked[:] = False
        self.marked[row0:row1, column0:column1] = kept
        return extent

    def resize(self, rows: int, columns: int, row: int, column: int) -> None:
        """Copy the marks into a grid of another size, in which the old cell (0, 0) is at this row
        and column; what lies outside it is forgotten.
        """
        old_rows, old_columns = self.marked.shape
        to = np.s_[
            max(row, 0) : max(min(row + old_rows, rows), 0),
            max(column, 0) : max(min(column + old_columns, columns), 0),
        ]

        def resized(array: NDArray[D]) -> NDArray[D]:
            moved = np.zeros((rows, columns), array.dtype)
            height, width = moved[to].shape
            top, left = max(-row, 0), max(-column, 0)
            moved[to] = array[top : top + height, left : left + width]
            return moved

        self.marked = resized(self.marked)
        self._score = resized(self._score)
        self._seen = resized(self._seen)
        self._extent = (0, rows, 0, columns)

    def roll(self, down: int, right: int) -> None:
        """Move the grid's origin by whole rows and columns; what leaves it is forgotten."""
        for array in (self.marked, self._score, self._seen):
            moved = np.zeros_like(array)
            rows, columns = array.shape
            if abs(down) < rows and abs(right) < columns:
                to_row, from_row = max(-down, 0), max(down, 0)
                to_column, from_column = max(-right, 0), max(right, 0)
                height, width = rows - abs(down), columns - abs(right)
                moved[to_row : to_row + height, to_column : to_column + width] = array[
                    from_row : from_row + height, from_column : from_column + width
                ]
            array[:] = moved
        self._extent = (0, self.marked.shape[0], 0, self.marked.shape[1])

    def _note(self, changed: NDArray[np.int64]) -> None:
        a, b, c, d = self._extent
        e, f, g, h = (int(end) for end in changed)
        self._extent = (min(a, e), max(b, f), min(c, g), max(d, h))

    def _decay(self, now_ns: int, changed: NDArray[np.int64]) -> None:
        times = self._times
        if times and now_ns < times[-1][0]:
            times.clear()
        if times and now_ns - times[-1][0] < _DECAY_CHECK_NS:
            return
        times.append((now_ns, self._scans))
        decay_ns = self._params.decay_time * 1e9
        if decay_ns <= 0.0 or now_ns - times[0][0] < decay_ns:
            return
        extent = np.array(self._extent)
        _forget(self.marked, self._seen, times.popleft()[1], extent, changed)
        self._extent = _ends(extent)


def _ends(window: NDArray[np.int64]) -> Window:
    row0, row1, column0, column1 = (int(end) for end in window)
    return row0, row1, column0, column1


def _window(changed: NDArray[np.int64]) -> Window | None:
    row0, row1, column0, column1 = _ends(changed)
    return (row0, row1, column0, column1) if row0 < row1 and column0 < column1 else None


@kernel()
def _include(window: NDArray[np.int64], row: int, column: int) -> None:
    window[0], window[1] = min(window[0], row), max(window[1], row + 1)
    window[2], window[3] = min(window[2], column), max(window[3], column + 1)


@kernel()
def _mark(
    marked: Mask,
    score: NDArray[np.uint8],
    seen: NDArray[np.int32],
    changed: NDArray[np.int64],
    static_distance_m: Clearance,
    static_margin_m: float,
    moving: Moving,
    column: float,
    row: float,
    number: int,
) -> None:
    """Mark the cell of an echo, unless a wall of the map or a moving thing explains it."""
    rows, columns = marked.shape
    if not (0.0 <= row < rows and 0.0 <= column < columns):
        return
    if static_distance_m.size > 0:
        if distance_at(static_distance_m, column, row) <= static_margin_m:
            return
    for i in range(len(moving)):
        dx, dy = column - moving[i, 0], row - moving[i, 1]
        if dx * dx + dy * dy <= moving[i, 2] * moving[i, 2]:
            return
    r, c = int(row), int(column)
    if not marked[r, c]:
        marked[r, c] = True
        score[r, c] = 1
        _include(changed, r, c)
    elif seen[r, c] != number:
        score[r, c] = min(score[r, c] + _AGAIN, _MOST_SCORE)
    seen[r, c] = number


@kernel()
def _mark_and_clear(
    marked: Mask,
    score: NDArray[np.uint8],
    seen: NDArray[np.int32],
    changed: NDArray[np.int64],
    static_distance_m: Clearance,
    static_margin_m: float,
    ranges_m: NDArray[np.float32],
    first_angle_rad: float,
    increment_rad: float,
    obstacle_min_m: float,
    obstacle_max_m: float,
    raytrace_min_m: float,
    raytrace_max_m: float,
    inf_is_valid: bool,
    sensor_column: float,
    sensor_row: float,
    resolution_m: float,
    number: int,
    moving: Moving,
) -> None:
    """Mark the surfaces seen, then clear along every ray what this scan has not marked."""
    rows, columns = marked.shape
    count = ranges_m.size
    ray = np.empty((count, 2))
    for i in range(count):
        ray[i, 0], ray[i, 1] = portable_kernels.cos_sin(first_angle_rad + increment_rad * i)
    fill = _FILL_M / resolution_m
    for i in range(count):
        reach_m = ranges_m[i]
        if not (np.isfinite(reach_m) and obstacle_min_m <= reach_m <= obstacle_max_m):
            continue
        reach = reach_m / resolution_m
        column, row = sensor_column + ray[i, 0] * reach, sensor_row + ray[i, 1] * reach
        _mark(
            marked, score, seen, changed, static_distance_m, static_margin_m, moving,
            column, row, number,
        )  # fmt: skip
        # The echo before, also where rays between the two were lost.
        j = i - 1
        while j >= i - _LOST_RAYS and not np.isfinite(ranges_m[j % count]):
            j -= 1
        before_m = ranges_m[j % count]
        if not (np.isfinite(before_m) and obstacle_min_m <= before_m <= obstacle_max_m):
            continue
        before = before_m / resolution_m
        dx = sensor_column + ray[j % count, 0] * before - column
        dy = sensor_row + ray[j % count, 1] * before - row
        gap = math.sqrt(dx * dx + dy * dy)
        if gap > fill:
            continue
        steps = int(2.0 * gap) + 1
        for step in range(1, steps):
            _mark(
                marked, score, seen, changed, static_distance_m, static_margin_m, moving,
                column + dx * (step / steps), row + dy * (step / steps), number,
            )  # fmt: skip
    for i in range(count):
        reach_m = ranges_m[i]
        if np.isnan(reach_m) or reach_m < raytrace_min_m:
            continue
        if np.isinf(reach_m):
            # Between two echoes it is a ray that was lost.
            open_space = ranges_m[(i + 1) % count] == np.inf and ranges_m[i - 1] == np.inf
            if not (inf_is_valid and open_space):
                continue
        # One cell short of the echo: the cell that it hit is not free.
        length = min(reach_m - resolution_m, raytrace_max_m) / resolution_m
        for step in range(int(length) + 1):
            c = math.floor(sensor_column + ray[i, 0] * step)
            r = math.floor(sensor_row + ray[i, 1] * step)
            if not (0 <= r < rows and 0 <= c < columns):
                continue
            if marked[r, c] and seen[r, c] != number:
                # Where a cell has fewer than two rays, a thin post can stand between them; and a
                # ray without echo may have been lost.
                near = np.isfinite(reach_m) and 2.0 * step * increment_rad <= 1.0
                score[r, c] -= 1
                if near or score[r, c] == 0:
                    marked[r, c] = False
                    _include(changed, r, c)
    for i in range(len(moving)):
        _clear_circle(marked, changed, moving[i, 0], moving[i, 1], moving[i, 2])


@kernel()
def _clear_circle(
    marked: Mask, changed: NDArray[np.int64], column: float, row: float, radius: float
) -> None:
    rows, columns = marked.shape
    for r in range(max(math.floor(row - radius), 0), min(math.ceil(row + radius), rows)):
        for c in range(
            max(math.floor(column - radius), 0), min(math.ceil(column + radius), columns)
        ):
            dx, dy = c + 0.5 - column, r + 0.5 - row
            if marked[r, c] and dx * dx + dy * dy <= radius * radius:
                marked[r, c] = False
                _include(changed, r, c)


@kernel()
def _clear_polygon(
    marked: Mask,
    changed: NDArray[np.int64],
    points_m: Array,
    radius_m: float,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
    resolution_m: float,
) -> None:
    rows, columns = marked.shape
    radius = radius_m / resolution_m
    for r in range(max(math.floor(row - radius), 0), min(math.ceil(row + radius), rows)):
        for c in range(
            max(math.floor(column - radius), 0), min(math.ceil(column + radius), columns)
        ):
            if not marked[r, c]:
                continue
            x, y = (c + 0.5 - column) * resolution_m, (r + 0.5 - row) * resolution_m
            if (
                signed_distance_m(points_m, cos_yaw * x + sin_yaw * y, cos_yaw * y - sin_yaw * x)
                <= 0.0
            ):
                marked[r, c] = False
                _include(changed, r, c)


@kernel()
def _forget(
    marked: Mask,
    seen: NDArray[np.int32],
    before: int,
    extent: NDArray[np.int64],
    changed: NDArray[np.int64],
) -> None:
    """Clear the marks last seen before a scan; `extent` shrinks to those that are left."""
    row0, row1, column0, column1 = extent[0], extent[1], extent[2], extent[3]
    extent[0], extent[1], extent[2], extent[3] = marked.shape[0], 0, marked.shape[1], 0
    for r in range(row0, row1):
        for c in range(column0, column1):
            if not marked[r, c]:
                continue
            if seen[r, c] < before:
                marked[r, c] = False
                _include(changed, r, c)
            else:
                _include(extent, r, c)


def scan_points(scan: Scan) -> Array:
    """(n, 2) float64 echoes of a scan, in the robot's base frame."""
    base_from_scan = scan.base_from_scan
    ranges = np.asarray(scan.ranges_m, np.float64)
    keep = np.isfinite(ranges) & (ranges >= scan.range_min_m) & (ranges <= scan.range_max_m)
    lidar_m = np.array([base_from_scan.x_m, base_from_scan.y_m])
    return lidar_m + ranges[keep, None] * scan.directions()[keep]


def denoised_ranges(
    ranges_m: NDArray[np.float32], same_surface_m: float = 0.05
) -> NDArray[np.float32]:
    """(n,) ranges of a full turn, each the mean of itself and its two neighbours where all three
    are on one surface: their noise is smaller by the square root of 3. Others stay as they are.

    Args:
        ranges_m: (n,), in order; `inf`, `-inf` and NaN are kept.
        same_surface_m: neighbours that differ by more are not on one surface.
    """
    ranges = np.array(ranges_m, np.float32)
    out = np.empty_like(ranges)
    _denoise(ranges, np.float32(same_surface_m), out)
    return out


@kernel(error_model="numpy")
def _denoise(
    ranges: NDArray[np.float32], same_surface_m: np.float32, out: NDArray[np.float32]
) -> None:
    count = ranges.size
    for i in range(count):
        before, here, after = ranges[i - 1], ranges[i], ranges[i + 1 if i + 1 < count else 0]
        # Neither holds for what is infinite or no number.
        same = abs(before - here) < same_surface_m and abs(after - here) < same_surface_m
        out[i] = (before + here + after) / np.float32(3.0) if same else here
