"""The global costmap: a static layer from the map, an obstacle layer from the scan, and inflation,
as in Nav2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from services.common import portable_kernels
from services.common.frames import SE2, Array
from services.common.kernels import kernel
from services.common.world.costmap import OCCUPIED, Cells, Clearance, Mask, clearance_m, inscribed

Costs = NDArray[np.uint8]

FREE_SPACE: Final = 0
INSCRIBED_INFLATED_OBSTACLE: Final = 253
LETHAL_OBSTACLE: Final = 254
NO_INFORMATION: Final = 255
"""Cell values of nav2_costmap_2d."""

_STRAIGHT_RAD = 1e-6
"""A map rotated by less counts as not rotated."""


@dataclass(frozen=True, slots=True)
class GridFrame:
    """The position of a grid in the map frame: its axes are the map's, cell (row 0, column 0) is at
    the origin corner.
    """

    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    rows: int
    columns: int

    def cell(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """(row, column) of the cell that contains a point; None outside the grid."""
        column = (x_m - self.origin_x_m) / self.resolution_m
        row = (y_m - self.origin_y_m) / self.resolution_m
        if 0.0 <= row < self.rows and 0.0 <= column < self.columns:
            return int(row), int(column)
        return None

    def center(self, row: int, column: int) -> tuple[float, float]:
        """(x, y) of a cell's centre."""
        return (
            self.origin_x_m + (column + 0.5) * self.resolution_m,
            self.origin_y_m + (row + 0.5) * self.resolution_m,
        )

    def extent(self) -> str:
        """The area covered, as text."""
        x_max_m = self.origin_x_m + self.columns * self.resolution_m
        y_max_m = self.origin_y_m + self.rows * self.resolution_m
        return (
            f"x {self.origin_x_m:.2f} to {x_max_m:.2f}, y {self.origin_y_m:.2f} to {y_max_m:.2f} m"
        )


@dataclass(frozen=True, slots=True)
class InflationParams:
    """How the cost falls with the distance from an obstacle; names as in Nav2's inflation layer."""

    robot_radius_m: float
    inflation_radius_m: float
    cost_scaling_factor: float


@dataclass(frozen=True, slots=True)
class Costmap:
    """One state of the costmap; immutable."""

    frame: GridFrame
    robot_radius_m: float
    costs: Costs
    """(rows, columns) uint8, Nav2's cell values."""
    clearance_m: Clearance
    """(rows, columns) float32, distance from a cell's centre to that of the nearest lethal cell."""

    def cost_at(self, x_m: float, y_m: float) -> int:
        """Cost of the cell that contains a point; NO_INFORMATION outside the grid."""
        cell = self.frame.cell(x_m, y_m)
        return NO_INFORMATION if cell is None else int(self.costs[cell])

    def clearance_at(self, x_m: float, y_m: float) -> float:
        """Distance from a point's cell to the nearest obstacle, in metres; 0 outside the grid."""
        cell = self.frame.cell(x_m, y_m)
        return 0.0 if cell is None else float(self.clearance_m[cell])

    def occupancy(self) -> Cells:
        """(rows, columns) int8 as published by nav2's Costmap2DPublisher: 100 lethal, 99 inscribed,
        -1 unknown.
        """
        return _OCCUPANCY_FROM_COST[self.costs]


def _occupancy_from_cost() -> Cells:
    table = np.empty(256, np.int8)
    table[FREE_SPACE] = 0
    between = np.arange(1, INSCRIBED_INFLATED_OBSTACLE)
    table[between] = 1 + (97 * (between - 1)) // 251
    table[INSCRIBED_INFLATED_OBSTACLE] = 99
    table[LETHAL_OBSTACLE] = 100
    table[NO_INFORMATION] = -1
    return table


_OCCUPANCY_FROM_COST = _occupancy_from_cost()


def inflate(frame: GridFrame, lethal: Mask, unknown: Mask, params: InflationParams) -> Costmap:
    """Costmap of (rows, columns) masks of lethal and unknown cells.

    Nav2's inflation: 253 where the robot's circle would touch a lethal cell, then
    252 exp(-cost_scaling_factor (d - robot_radius)) out to the inflation radius.
    """
    clearance = clearance_m(lethal, frame.resolution_m)
    beyond_m = clearance.astype(np.float64) - params.robot_radius_m
    fall = portable_kernels.exp_each(-params.cost_scaling_factor * beyond_m) * (
        INSCRIBED_INFLATED_OBSTACLE - 1
    )
    costs = np.where(clearance <= params.inflation_radius_m, np.minimum(fall, 252.0), 0.0)
    costs = costs.astype(np.uint8)
    costs[inscribed(clearance, params.robot_radius_m)] = INSCRIBED_INFLATED_OBSTACLE
    costs[unknown] = NO_INFORMATION
    costs[lethal] = LETHAL_OBSTACLE
    return Costmap(frame, params.robot_radius_m, costs, clearance)


@dataclass(frozen=True, slots=True)
class ObstacleParams:
    """How the scan marks and clears; names as in Nav2's obstacle layer."""

    obstacle_max_range_m: float
    raytrace_max_range_m: float
    static_margin_m: float
    """An echo this near to a wall of the map is ignored: a small pose error must not narrow a
    doorway.
    """


class LayeredCostmap:
    """The layers and the combined costmap."""

    def __init__(
        self, frame: GridFrame, cells: Cells, inflation: InflationParams, obstacle: ObstacleParams
    ) -> None:
        """Build the costmap of a map.

        Args:
            frame: position of the cells.
            cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
            inflation: how cost falls with distance.
            obstacle: how the scan marks and clears.
        """
        self.frame = frame
        self._inflation = inflation
        self._obstacle = obstacle
        self._lethal: Mask = cells >= OCCUPIED
        self._unknown: Mask = cells < 0
        self.static = inflate(frame, self._lethal, self._unknown, inflation)
        """The costmap of the static map."""
        self.master = self.static
        """The costmap of all layers."""
        self.revision = 0
        """Increases with every change of the master costmap."""
        self._markable: Mask = self.static.clearance_m > obstacle.static_margin_m
        self._marked: Mask = np.zeros(cells.shape, np.bool_)

    def update(
        self,
        map_from_scan: SE2,
        ranges_m: NDArray[np.float32],
        angle_min_rad: float,
        angle_increment_rad: float,
        range_min_m: float,
    ) -> bool:
        """Mark cells with echoes and clear those that rays pass. Returns True if the costmap
        changed.
        """
        changed = _mark_and_clear(
            self._marked,
            self._markable,
            np.array(ranges_m, np.float32),
            angle_min_rad + map_from_scan.yaw_rad,
            angle_increment_rad,
            range_min_m,
            self._obstacle.obstacle_max_range_m,
            self._obstacle.raytrace_max_range_m,
            (map_from_scan.x_m - self.frame.origin_x_m) / self.frame.resolution_m,
            (map_from_scan.y_m - self.frame.origin_y_m) / self.frame.resolution_m,
            self.frame.resolution_m,
        )
        if changed:
            self._combine()
        return bool(changed)

    def clear(self) -> None:
        """Clear every obstacle that is not on the map, as Nav2's clear_entirely service does."""
        if self._marked.any():
            self._marked[:] = False
            self._combine()

    def _combine(self) -> None:
        if self._marked.any():
            self.master = inflate(
                self.frame, self._lethal | self._marked, self._unknown, self._inflation
            )
        else:
            self.master = self.static
        self.revision += 1


def frame_of(resolution_m: float, origin: SE2, cells: Cells) -> GridFrame:
    """Frame of a map's (rows, columns) cells.

    Raises ValueError if the map is rotated: its rows must run along the map's x axis, as
    `straightened` makes them.
    """
    if abs(origin.yaw_rad) > _STRAIGHT_RAD:
        raise ValueError(f"origin yaw {origin.yaw_rad:.3f} rad: must be 0")
    if cells.size == 0 or resolution_m <= 0.0:
        raise ValueError(f"{cells.shape} cells of {resolution_m} m: must be some, of positive size")
    rows, columns = cells.shape
    return GridFrame(resolution_m, origin.x_m, origin.y_m, rows, columns)


def scan_points(
    base_from_scan: SE2,
    ranges_m: NDArray[np.float32],
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    max_range_m: float,
) -> Array:
    """(n, 2) float64 echoes of a scan within a range, in the robot's base frame."""
    ranges = np.asarray(ranges_m, np.float64)
    angles = base_from_scan.yaw_rad + angle_min_rad + angle_increment_rad * np.arange(ranges.size)
    keep = np.isfinite(ranges) & (ranges >= range_min_m) & (ranges <= max_range_m)
    ranges, angles = ranges[keep], angles[keep]
    cos, sin = portable_kernels.cos_sin_each(angles)
    return np.stack([base_from_scan.x_m + ranges * cos, base_from_scan.y_m + ranges * sin], axis=1)


@kernel()
def _mark_and_clear(
    marked: Mask,
    markable: Mask,
    ranges_m: NDArray[np.float32],
    first_angle_rad: float,
    increment_rad: float,
    range_min_m: float,
    obstacle_max_range_m: float,
    raytrace_max_range_m: float,
    sensor_column: float,
    sensor_row: float,
    resolution_m: float,
) -> bool:
    """Clear along every ray, then mark every echo; so that one ray never clears another's echo."""
    rows, columns = marked.shape
    seen = np.zeros(marked.shape, np.bool_)
    for i in range(ranges_m.size):
        reach_m = ranges_m[i]
        if not np.isfinite(reach_m) or reach_m < range_min_m or reach_m > obstacle_max_range_m:
            continue
        angle = first_angle_rad + increment_rad * i
        column = math.floor(sensor_column + portable_kernels.cos(angle) * reach_m / resolution_m)
        row = math.floor(sensor_row + portable_kernels.sin(angle) * reach_m / resolution_m)
        if 0 <= row < rows and 0 <= column < columns and markable[row, column]:
            seen[row, column] = True
    changed = False
    for i in range(ranges_m.size):
        reach_m = ranges_m[i]
        if np.isnan(reach_m) or reach_m < range_min_m:
            continue
        # One cell short of the echo: the cell that it hit is not free.
        length = min(reach_m - resolution_m, raytrace_max_range_m) / resolution_m
        angle = first_angle_rad + increment_rad * i
        dx, dy = portable_kernels.cos_sin(angle)
        for step in range(int(length) + 1):
            column = math.floor(sensor_column + dx * step)
            row = math.floor(sensor_row + dy * step)
            if not (0 <= row < rows and 0 <= column < columns):
                break
            if marked[row, column] and not seen[row, column]:
                marked[row, column] = False
                changed = True
    for row in range(rows):
        for column in range(columns):
            if seen[row, column] and not marked[row, column]:
                marked[row, column] = True
                changed = True
    return changed
