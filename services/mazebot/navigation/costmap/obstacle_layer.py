"""The obstacle layer: a scan's echoes mark cells, its rays clear them.

Against what users report of Nav2: rays without an echo clear by default, up to the range of the
sensor; what is marked can always be cleared; marks that no ray meets again are forgotten after a
while; and a cell far away, between whose rays a thin post fits, is not cleared by the first of
them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel, shared_kernel
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
_HALF_DIAGONAL: Final = 0.7072
"""Of a cell, in cells, rounded up"""
_TURN_RAD: Final = 2.0 * math.pi
_DECAY_CHECK_NS: Final = 1_000_000_000
HELD: Final = 1
"""Of a cell: its mark is cleared only by rays that pass it,"""
PINNED: Final = 2
"""or by nothing."""
GAP: Final = 3
"""As PINNED, and no echo: it lies across a gap that is too narrow."""

D = TypeVar("D", bound=np.generic)

Moving = Array
"""(n, 3) circles of things that move: x, y, radius in metres, in the layer's frame."""
NOTHING_MOVES: Final[Moving] = np.empty((0, 3))
ALL_MARK: Final[NDArray[np.bool_]] = np.empty(0, np.bool_)


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
    marking: bool = Field(True, description="whether returns mark obstacles")
    clearing: bool = Field(True, description="whether rays clear obstacles")


class DepthSourceParams(ScanSourceParams):
    """How the depth camera's scan marks and clears. Perception's `depth_scan` has the heights."""

    obstacle_max_range: float = Field(
        3.0, gt=0, description="m; returns nearer than this mark obstacles"
    )


class ObstacleParams(Params):
    """Names as in Nav2's obstacle layer."""

    observation_sources: tuple[Literal["scan", "depth"], ...] = Field(
        ("scan", "depth"), description="sensors that mark and clear, each its own marks"
    )
    scan: ScanSourceParams = ScanSourceParams()
    depth: DepthSourceParams = DepthSourceParams()
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
        30.0,
        ge=0,
        description="s; marks of the scan that are not seen again for this long are forgotten; "
        "0: never",
    )


class ObstacleLayer:
    """The marks of one source on a grid of (rows, columns)."""

    def __init__(
        self,
        rows: int,
        columns: int,
        params: ObstacleParams,
        source: ScanSourceParams | None = None,
    ) -> None:
        """`source`: None: the lidar's. Of others what no ray has passed is never forgotten, and no
        ray alone clears: they look elsewhere for long, and not at all at what is near.
        """
        self._params = params
        self._source = params.scan if source is None else source
        if source is None and "scan" not in params.observation_sources:
            self._source = params.scan.model_copy(update={"marking": False, "clearing": False})
        self._looks_around = source is None
        self.marked: Mask = np.zeros((rows, columns), np.bool_)
        self._score = np.zeros((rows, columns), np.uint8)
        """Rays that have to pass a marked cell before it is cleared."""
        self._seen = np.zeros((rows, columns), np.int32)
        """Number of the scan in which a marked cell had its last echo."""
        self._held = np.zeros((rows, columns), np.uint8)
        """HELD or PINNED cells."""
        self._scans = 0
        self._times: deque[tuple[int, int]] = deque()
        """Time and number of a scan, each second."""
        self._extent: Window = (rows, 0, columns, 0)
        """No cell outside it is marked."""

    @property
    def is_empty(self) -> bool:
        """Whether surely nothing is marked."""
        return self._extent[0] >= self._extent[1]

    def update(
        self,
        scan: Scan,
        sensor: tuple[float, float, float],
        resolution_m: float,
        static_distance_m: Clearance | None,
        moving_cells: Moving,
        static_margin_m: float | None = None,
        marks: NDArray[np.bool_] = ALL_MARK,
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
            marks: (n,) whether the echo of a ray is to be marked; none: all are.
        """
        rows, columns = self.marked.shape
        changed = np.array([rows, 0, columns, 0])
        params, source = self._params, self._source
        self._scans += 1
        no_map = np.empty((0, 0), np.float32)
        _mark_and_clear(
            self.marked, self._score, self._seen, self._held, changed,
            no_map if static_distance_m is None else static_distance_m,
            float(params.static_margin if static_margin_m is None else static_margin_m),
            # A copy: a kernel is compiled again for a read-only array.
            np.array(scan.ranges_m, np.float32),
            float(scan.angle_min_rad + sensor[2]), float(scan.angle_increment_rad),
            float(max(scan.range_min_m, source.obstacle_min_range)),
            float(source.obstacle_max_range if source.marking else 0.0),
            float(max(scan.range_min_m, source.raytrace_min_range)),
            float(min(max(source.raytrace_max_range, source.obstacle_max_range), scan.range_max_m))
            if source.clearing else -1.0,
            bool(source.inf_is_valid),
            float(sensor[0]), float(sensor[1]), float(resolution_m), self._scans,
            np.array(moving_cells, np.float64).reshape(-1, 3), marks, self._looks_around,
        )  # fmt: skip
        self._note(changed)
        if self._looks_around:
            self._decay(scan.stamp_ns, changed)
        elif changed[0] < changed[1] and not self.marked.any():
            self._extent = (rows, 0, columns, 0)
        return _window(changed)

    def mark(self, cells: NDArray[np.int64]) -> Window | None:
        """Mark (n, 2) cells, row and column, those outside the grid left out."""
        cells = self._inside(cells)
        self.marked[cells[:, 0], cells[:, 1]] = True
        return self._noted(cells)

    def hold(self, column: float, row: float, radius: float, pinned: bool) -> None:
        """Keep the marks in a circle, in cells, until rays pass them, or for good; also those that
        come later, if not for good.
        """
        rows, columns = self._held.shape
        row0, row1 = max(math.floor(row - radius), 0), min(math.ceil(row + radius), rows)
        column0 = max(math.floor(column - radius), 0)
        column1 = min(math.ceil(column + radius), columns)
        if row0 >= row1 or column0 >= column1:
            return
        r, c = np.ogrid[row0:row1, column0:column1]
        down, right = r + 0.5 - row, c + 0.5 - column
        inside = down * down + right * right <= radius * radius
        held = self._held[row0:row1, column0:column1]
        held[inside] = np.maximum(held[inside], HELD)
        if pinned:
            marked = inside & self.marked[row0:row1, column0:column1]
            held[marked] = np.maximum(held[marked], PINNED)

    def pin(self, cells: NDArray[np.int64]) -> Window | None:
        """Mark (n, 2) cells, row and column, until they are released."""
        cells = self._inside(cells)
        rows, columns = cells[:, 0], cells[:, 1]
        self.marked[rows, columns], self._held[rows, columns] = True, GAP
        self._seen[rows, columns] = self._scans
        return self._noted(cells)

    def release(self, cells: NDArray[np.int64] | None = None) -> Window | None:
        """Hold nothing any more but gaps; or clear (n, 2) cells of a gap."""
        if cells is None:
            self._held[self._held < GAP] = 0
            return None
        cells = self._inside(cells)
        rows, columns = cells[:, 0], cells[:, 1]
        self.marked[rows, columns], self._held[rows, columns] = False, 0
        return _window_of(cells)

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
        """Clear every mark that is not held."""
        window = _window(np.array(self._extent))
        if window is None:
            return None
        part = np.s_[window[0] : window[1], window[2] : window[3]]
        self.marked[part] &= self._held[part] > 0
        if not self.marked[part].any():
            self._extent = (self.marked.shape[0], 0, self.marked.shape[1], 0)
        return window

    def clear_square(self, square: Window, inside: bool) -> Window | None:
        """Clear the marks in a window of cells, or all the others."""
        extent = _window(np.array(self._extent))
        if extent is None:
            return None
        row0, row1, column0, column1 = (max(0, end) for end in square)
        if inside:
            self.marked[row0:row1, column0:column1] &= self._held[row0:row1, column0:column1] > 0
            return _window(np.array([row0, min(row1, len(self.marked)), column0, column1]))
        kept = self.marked[row0:row1, column0:column1].copy()
        self.marked &= self._held > 0
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
        self._held = resized(self._held)
        self._extent = (0, rows, 0, columns)

    def roll(self, down: int, right: int) -> None:
        """Move the grid's origin by whole rows and columns; what leaves it is forgotten."""
        if self.is_empty and not self._held.any():
            return
        for array in (self.marked, self._score, self._seen, self._held):
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

    def _inside(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of (n, 2) cells that are in the grid."""
        return cells[((cells >= 0) & (cells < self.marked.shape)).all(axis=1)]

    def _noted(self, cells: NDArray[np.int64]) -> Window | None:
        """The window of cells that have been marked."""
        window = _window_of(cells)
        if window is not None:
            self._note(window)
        return window

    def _note(self, changed: Iterable[int]) -> None:
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
        _forget(self.marked, self._seen, self._held, times.popleft()[1], extent, changed)
        self._extent = _ends(extent)


def _ends(window: NDArray[np.int64]) -> Window:
    row0, row1, column0, column1 = (int(end) for end in window)
    return row0, row1, column0, column1


def _window(changed: NDArray[np.int64]) -> Window | None:
    row0, row1, column0, column1 = _ends(changed)
    return (row0, row1, column0, column1) if row0 < row1 and column0 < column1 else None


def _window_of(cells: NDArray[np.int64]) -> Window | None:
    """The rows and columns of (n, 2) cells."""
    if not len(cells):
        return None
    (row0, column0), (row1, column1) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    return row0, row1 + 1, column0, column1 + 1


@shared_kernel(inline=True)
def _include(window: NDArray[np.int64], row: int, column: int) -> None:
    window[0], window[1] = min(window[0], row), max(window[1], row + 1)
    window[2], window[3] = min(window[2], column), max(window[3], column + 1)


@shared_kernel(inline=True)
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
    r, c = int(row), int(column)
    if marked[r, c] and seen[r, c] == number:
        return
    if static_distance_m.size > 0:
        if distance_at(static_distance_m, column, row) <= static_margin_m:
            return
    for i in range(len(moving)):
        dx, dy = column - moving[i, 0], row - moving[i, 1]
        if dx * dx + dy * dy <= moving[i, 2] * moving[i, 2]:
            return
    if not marked[r, c]:
        marked[r, c] = True
        score[r, c] = 1
        _include(changed, r, c)
    else:
        score[r, c] = min(score[r, c] + _AGAIN, _MOST_SCORE)
    seen[r, c] = number


@shared_kernel()
def _any_marked(row: NDArray[np.uint8]) -> bool:
    """In a form that compiles to vector instructions."""
    found = np.uint8(0)
    for i in range(row.size):
        found |= row[i]
    return bool(found)


@shared_kernel()
def _is_cleared(
    row: int,
    column: int,
    score: NDArray[np.uint8],
    ray: Array,
    last: NDArray[np.int64],
    ranges_m: NDArray[np.float32],
    first: int,
    first_angle_rad: float,
    increment_rad: float,
    sensor_column: float,
    sensor_row: float,
    one_clears: bool,
) -> bool:
    """Whether rays clear a marked cell, of which each that passes it lowers the score.

    A ray passes it where one of its steps, a cell long, ends in it: only those steps and rays are
    looked at that can, by the cell's distance and bearing.
    """
    dx, dy = column + 0.5 - sensor_column, row + 0.5 - sensor_row
    away = math.sqrt(dx * dx + dy * dy)
    begin = max(math.ceil(away - _HALF_DIAGONAL), first)
    end = math.floor(away + _HALF_DIAGONAL) + 1
    bearing, across, turns0, turns1 = 0.0, np.inf, 0, 1
    if away >= 2.0 * _HALF_DIAGONAL and increment_rad != 0.0:
        # asin(x) <= 1.05 x up to x = 1/2.
        bearing, half = portable_kernels.atan2(dy, dx), 1.05 * _HALF_DIAGONAL / away
        across = half / abs(increment_rad)
        final_rad = first_angle_rad + increment_rad * (last.size - 1)
        least_rad, most_rad = min(first_angle_rad, final_rad), max(first_angle_rad, final_rad)
        turns0 = math.ceil((least_rad - bearing - half) / _TURN_RAD)
        turns1 = math.floor((most_rad - bearing + half) / _TURN_RAD) + 1
    ray1 = 0
    for turn in range(turns0, turns1):
        ray0, before = 0, ray1
        ray1 = last.size
        if across < np.inf:
            whole = turn if increment_rad > 0.0 else turns0 + turns1 - 1 - turn
            middle = (bearing + whole * _TURN_RAD - first_angle_rad) / increment_rad
            ray0 = max(math.floor(middle - across), before)
            ray1 = max(min(math.ceil(middle + across) + 1, last.size), before)
        for i in range(ray0, ray1):
            for step in range(begin, min(end, last[i] + 1)):
                c = math.floor(sensor_column + ray[i, 0] * step)
                r = math.floor(sensor_row + ray[i, 1] * step)
                if c != column or r != row:
                    continue
                # Where a cell has fewer than two rays, a thin post can stand between them; and a
                # ray without echo may have been lost.
                spread = 2.0 * step * increment_rad
                near = one_clears and np.isfinite(ranges_m[i]) and spread <= 1.0
                score[row, column] -= 1
                if near or score[row, column] == 0:
                    return True
    return False


@kernel()
def _mark_and_clear(
    marked: Mask,
    score: NDArray[np.uint8],
    seen: NDArray[np.int32],
    held: NDArray[np.uint8],
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
    marks: NDArray[np.bool_],
    one_clears: bool,
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
        if marks.size > 0 and not marks[i]:
            continue
        reach = reach_m / resolution_m
        column, row = sensor_column + ray[i, 0] * reach, sensor_row + ray[i, 1] * reach
        dx, dy, steps = 0.0, 0.0, 1
        # The echo before, also where rays between the two were lost.
        j = i - 1
        before = j if j >= 0 else j % count
        while j >= i - _LOST_RAYS and not np.isfinite(ranges_m[before]):
            j -= 1
            before = j if j >= 0 else j % count
        before_m = ranges_m[before]
        is_echo = np.isfinite(before_m) and obstacle_min_m <= before_m <= obstacle_max_m
        if is_echo and (marks.size == 0 or marks[before]):
            reach = before_m / resolution_m
            dx = sensor_column + ray[before, 0] * reach - column
            dy = sensor_row + ray[before, 1] * reach - row
            gap = math.sqrt(dx * dx + dy * dy)
            steps = int(2.0 * gap) + 1 if gap <= fill else 1
        for step in range(steps):
            _mark(
                marked, score, seen, changed, static_distance_m, static_margin_m, moving,
                column + dx * (step / steps), row + dy * (step / steps), number,
            )  # fmt: skip
    # Each ray walks cell by cell from `first` to its last step.
    last = np.full(count, -1)
    longest = -1
    for i in range(count):
        reach_m = ranges_m[i]
        if np.isnan(reach_m) or reach_m < raytrace_min_m:
            continue
        if np.isinf(reach_m):
            # Between two echoes it is a ray that was lost.
            open_space = (
                ranges_m[i + 1 if i + 1 < count else 0] == np.inf and ranges_m[i - 1] == np.inf
            )
            if not (inf_is_valid and open_space):
                continue
        # One cell short of the echo: the cell that it hit is not free.
        last[i] = int(min(reach_m - resolution_m, raytrace_max_m) / resolution_m)
        longest = max(longest, last[i])
    # What lies before the shortest range was not looked at.
    first = 0 if one_clears else math.ceil(raytrace_min_m / resolution_m)
    row0 = max(math.floor(sensor_row) - longest - 1, 0)
    row1 = min(math.floor(sensor_row) + longest + 2, rows)
    column0 = max(math.floor(sensor_column) - longest - 1, 0)
    column1 = min(math.floor(sensor_column) + longest + 2, columns)
    bits = marked.view(np.uint8)
    for r in range(row0, row1):
        if not _any_marked(bits[r, column0:column1]):
            continue
        for c in range(column0, column1):
            if not marked[r, c] or seen[r, c] == number or held[r, c] >= PINNED:
                continue
            if _is_cleared(
                r, c, score, ray, last, ranges_m, first, first_angle_rad, increment_rad,
                sensor_column, sensor_row, one_clears,
            ):  # fmt: skip
                marked[r, c] = False
                _include(changed, r, c)
    for i in range(len(moving)):
        _clear_circle(
            marked, held, changed, moving[i, 0], moving[i, 1], moving[i, 2]
        )  # fmt: skip


@kernel()
def _clear_circle(
    marked: Mask,
    held: NDArray[np.uint8],
    changed: NDArray[np.int64],
    column: float,
    row: float,
    radius: float,
) -> None:
    """Clear the marks of a thing that moves, but not those that are held."""
    rows, columns = marked.shape
    for r in range(max(math.floor(row - radius), 0), min(math.ceil(row + radius), rows)):
        for c in range(
            max(math.floor(column - radius), 0), min(math.ceil(column + radius), columns)
        ):
            if not marked[r, c] or held[r, c] > 0:
                continue
            dx, dy = c + 0.5 - column, r + 0.5 - row
            if dx * dx + dy * dy <= radius * radius:
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
    held: NDArray[np.uint8],
    before: int,
    extent: NDArray[np.int64],
    changed: NDArray[np.int64],
) -> None:
    """Clear marks last seen before a scan and not held; `extent` shrinks to what is left."""
    row0, row1, column0, column1 = extent[0], extent[1], extent[2], extent[3]
    extent[0], extent[1], extent[2], extent[3] = marked.shape[0], 0, marked.shape[1], 0
    for r in range(row0, row1):
        for c in range(column0, column1):
            if not marked[r, c]:
                continue
            if seen[r, c] < before and held[r, c] == 0:
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
