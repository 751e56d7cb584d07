"""The global costmap: a static layer from the map, an obstacle layer from the scan, others from
what the scan does not show, inflation and keepout zones, as in Nav2; and the rolling local one, of
the same layers without the map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.common.world.costmap import Cells, Clearance, Mask
from mazebot.navigation.costmap.costmap import (
    FREE_SPACE,
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    NO_INFORMATION,
    Costmap,
    Costs,
    GridFrame,
    frame_of,
)
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.costmap.inflation_layer import (
    Inflation,
    InflationParams,
    Squares,
    Window,
    compose,
    inflate,
)
from mazebot.navigation.costmap.obstacle_layer import (
    NOTHING_MOVES,
    Moving,
    ObstacleLayer,
    ObstacleParams,
    scan_points,
)
from mazebot.navigation.costmap.static_layer import NAV2_STATIC, StaticParams, static_costs

__all__ = [
    "FREE_SPACE",
    "INSCRIBED_INFLATED_OBSTACLE",
    "LETHAL_OBSTACLE",
    "NO_INFORMATION",
    "Costmap",
    "Costs",
    "GridFrame",
    "InflationParams",
    "LayeredCostmap",
    "LocalCostmap",
    "ObstacleParams",
    "StaticParams",
    "frame_of",
    "inflate",
    "scan_points",
]

_NO_ZONES: Costs = np.empty((0, 0), np.uint8)


class LayeredCostmap:
    """The layers and the combined costmap."""

    def __init__(
        self,
        frame: GridFrame,
        cells: Cells,
        inflation: InflationParams,
        obstacle: ObstacleParams,
        static: StaticParams = NAV2_STATIC,
        footprint: Footprint = WAFFLE,
    ) -> None:
        """Build the costmap of a map.

        Args:
            frame: position of the cells.
            cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
            inflation: how cost falls with distance.
            obstacle: how the scan marks and clears.
            static: how the map's values become costs.
            footprint: the robot's, whose own place is cleared.
        """
        self._inflation_params = inflation
        self._static_params = static
        self._footprint = footprint
        self._obstacle_params = obstacle
        self._obstacles = ObstacleLayer(frame.rows, frame.columns, obstacle)
        # A ray of the lidar passes above or below what these have, and clears none of it.
        self._seen_low = ObstacleLayer(frame.rows, frame.columns, obstacle, obstacle.depth)
        self._touched = ObstacleLayer(frame.rows, frame.columns, obstacle, obstacle.depth)
        self._layers = self._obstacles, self._seen_low, self._touched
        self._all_marked: Mask | None = None
        """(rows, columns) marks of all layers; None: the lidar's are all."""
        self._zones = _NO_ZONES
        self.revision = 0
        """Increases with every change of the master costmap."""
        self._changed: Window | None = None
        self._place(frame, cells)
        self._combine(None)

    def take_map(self, frame: GridFrame, cells: Cells, static_margin_m: float) -> None:
        """Replace the static layer by that of a map which has grown or changed: the obstacles stay
        where they are, except those that are now explained by the map. Keepout zones are gone.

        Args:
            frame: position of the cells; of another resolution, all obstacles are forgotten.
            cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
            static_margin_m: an obstacle this near to a wall of the map is the wall's.
        """
        before, resolution_m = self.frame, frame.resolution_m
        if before.resolution_m == resolution_m:
            row = round((before.origin_y_m - frame.origin_y_m) / resolution_m)
            column = round((before.origin_x_m - frame.origin_x_m) / resolution_m)
        else:
            row, column = frame.rows, frame.columns
        for layer in self._layers:
            layer.resize(frame.rows, frame.columns, row, column)
        self._zones = _NO_ZONES
        self._place(frame, cells)
        for layer in self._layers:
            layer.marked[self.static.distance_m <= static_margin_m] = False
        self._combine(None)

    def _place(self, frame: GridFrame, cells: Cells) -> None:
        """Compute everything that depends on the static layer."""
        self.frame = frame
        self._inflation = Inflation(self._inflation_params, frame.resolution_m)
        self._base: Costs = static_costs(cells, self._static_params)
        lethal: Mask = self._base == LETHAL_OBSTACLE
        self._squares: Squares = self._inflation.squares(lethal)
        self.static = self._blank()
        """The costmap of the static map, with its keepout zones."""
        self.master = self._blank()
        """The costmap of all layers."""
        self._combine_static()

    def update(
        self,
        map_from_scan: SE2,
        scan: Scan,
        *,
        map_from_base: SE2 | None = None,
        moving_m: Moving = NOTHING_MOVES,
        static_margin_m: float | None = None,
    ) -> bool:
        """Mark cells with echoes and clear those that rays pass. Returns True if the costmap
        changed.

        Args:
            map_from_scan: the lidar's pose at the scan.
            scan: its ranges, and its time, by which marks are forgotten.
            map_from_base: the robot's pose, whose own place is cleared; None: it is not.
            moving_m: (n, 3) circles of things that move, x, y, radius: what a prediction has
                does not stay on the costmap, neither they nor their trail.
            static_margin_m: instead of the parameter, where the error of the pose is known: the
                better it is, the nearer to walls things are marked.
        """
        changed = self._observe(map_from_scan, scan, map_from_base, moving_m, static_margin_m)
        if changed is not None:
            self._combine(changed)
        return changed is not None

    def _observe(
        self,
        map_from_scan: SE2,
        scan: Scan,
        map_from_base: SE2 | None,
        moving_m: Moving = NOTHING_MOVES,
        static_margin_m: float | None = None,
    ) -> Window | None:
        """Mark and clear; the window of cells of which a layer changed, if any. See `update`."""
        resolution_m = self.frame.resolution_m
        moving = np.array(moving_m, np.float64).reshape(-1, 3)
        moving[:, 0] -= self.frame.origin_x_m
        moving[:, 1] -= self.frame.origin_y_m
        column, row = self.frame.place(map_from_scan.x_m, map_from_scan.y_m)
        changed = self._obstacles.update(
            scan, (column, row, map_from_scan.yaw_rad), resolution_m,
            self._walls_m(), moving / resolution_m, static_margin_m,
        )  # fmt: skip
        if map_from_base is not None:
            column, row = self.frame.place(map_from_base.x_m, map_from_base.y_m)
            for layer in self._layers:
                if layer is self._obstacles or not layer.is_empty:
                    under = layer.clear_footprint(
                        self._footprint, column, row, map_from_base.yaw_rad, resolution_m
                    )
                    changed = _union(changed, under)
        return changed

    def update_seen_low(
        self,
        map_from_camera: SE2,
        scan: Scan,
        marks: NDArray[np.bool_],
        behind_m: Array,
        static_margin_m: float | None = None,
    ) -> bool:
        """Mark and clear by the scan of a depth image. True if the costmap changed.

        Args:
            map_from_camera: the camera's pose at the image.
            scan: the nearest things between floor and the robot's top.
            marks: (n,) which of its beams show something that the lidar does not; what it shows, it
                marks, and clears when that moves away behind the camera's back.
            behind_m: (m, 2) places on those things behind the ends of the beams.
            static_margin_m: as for `update`.
        """
        if self._seen_low.is_empty and not marks.any():
            return False
        column, row = self.frame.place(map_from_camera.x_m, map_from_camera.y_m)
        changed = self._seen_low.update(
            scan, (column, row, map_from_camera.yaw_rad), self.frame.resolution_m,
            self._walls_m(), NOTHING_MOVES, static_margin_m, marks,
        )  # fmt: skip
        if changed is not None:
            self._combine(changed)
        params = self._obstacle_params
        if len(behind_m) and params.depth.marking:
            margin_m = params.static_margin if static_margin_m is None else static_margin_m
            self._mark(self._seen_low, self._away_from_walls(behind_m, margin_m))
        return changed is not None

    def _away_from_walls(self, points_m: Array, margin_m: float) -> Array:
        """Those of (n, 2) places that are farther than this from the walls of the map."""
        walls_m = self._walls_m()
        if walls_m is None:
            return points_m
        rows, columns = self._cells(points_m).T
        inside = (rows >= 0) & (columns >= 0)
        inside &= (rows < walls_m.shape[0]) & (columns < walls_m.shape[1])
        inside[inside] = walls_m[rows[inside], columns[inside]] > margin_m
        kept_m: Array = points_m[inside]
        return kept_m

    def mark_low(self, points_m: Array) -> None:
        """Mark (n, 2) places where the camera has seen something."""
        self._mark(self._seen_low, points_m)

    def mark_touched(self, points_m: Array) -> None:
        """Mark (n, 2) places where something is that no sensor shows: no ray clears them."""
        self._mark(self._touched, points_m)

    def _mark(self, layer: ObstacleLayer, points_m: Array) -> None:
        changed = layer.mark(self._cells(points_m))
        if changed is not None:
            self._combine(changed)

    def _cells(self, points_m: Array) -> NDArray[np.int64]:
        """(n, 2) row and column of (n, 2) places, also outside the grid."""
        origin_m = np.array([self.frame.origin_x_m, self.frame.origin_y_m])
        cells = np.floor((points_m - origin_m) / self.frame.resolution_m).astype(np.int64)
        return np.ascontiguousarray(cells[:, ::-1])

    def shows_low(self, points_m: Array) -> NDArray[np.bool_]:
        """(n,) whether (n, 2) places are in cells where the camera sees something."""
        rows, columns = self._cells(points_m).T
        marked = self._seen_low.marked
        inside = (rows >= 0) & (columns >= 0) & (rows < marked.shape[0])
        inside &= columns < marked.shape[1]
        found = np.zeros(len(points_m), np.bool_)
        found[inside] = marked[rows[inside], columns[inside]]
        return found

    def clear(self) -> None:
        """Clear every obstacle that is not on the map, as Nav2's clear_entirely service does."""
        self._clear(*self._layers)

    def clear_scanned(self) -> None:
        """Clear what the lidar has marked: it is marked again if it is there. What only the camera
        has seen may be too near to be seen again.
        """
        self._clear(self._obstacles)

    def clear_hidden(self) -> None:
        """Clear what the lidar does not show."""
        self._clear(self._seen_low, self._touched)

    def clear_touched(self) -> None:
        """Clear where the robot could not go on."""
        self._clear(self._touched)

    def _clear(self, *layers: ObstacleLayer) -> None:
        for layer in layers:
            changed = layer.clear()
            if changed is not None:
                self._combine(changed)

    def hold(self, x_m: float, y_m: float, radius_m: float, pinned: bool) -> None:
        """Keep the obstacles in a circle until rays pass where they are: neither time nor a request
        to clear the costmap makes them forgotten. Pinned ones are not even cleared by rays.
        """
        side_m = self.frame.resolution_m
        self._obstacles.hold(*self.frame.place(x_m, y_m), radius_m / side_m, pinned)

    def release(self) -> None:
        """Hold nothing any more."""
        self._obstacles.release()

    def close_gap(self, a_m: tuple[float, float], b_m: tuple[float, float]) -> None:
        """Mark the line between two points, until `open_gap`."""
        changed = self._obstacles.pin(self._line(a_m, b_m))
        if changed is not None:
            self._combine(changed)

    def open_gap(self, a_m: tuple[float, float], b_m: tuple[float, float]) -> None:
        """Clear the line between two points. What stands there is marked again when it is seen."""
        changed = self._obstacles.release(self._line(a_m, b_m))
        if changed is not None:
            self._combine(changed)

    def _line(self, a_m: tuple[float, float], b_m: tuple[float, float]) -> NDArray[np.int64]:
        """(n, 2) cells, row and column, between two points."""
        a, b = (np.array(self.frame.place(*end)[::-1]) for end in (a_m, b_m))
        count = int(4.0 * np.abs(b - a).max()) + 1
        steps = np.arange(count + 1) / count
        return np.unique(np.floor(a + steps[:, None] * (b - a)).astype(np.int64), axis=0)

    def clear_around(self, pose: SE2, reset_distance_m: float) -> None:
        """Clear the obstacles in a square around a pose, as Nav2's clear_around service does.

        Args:
            pose: the middle of the square, whose sides are along the axes of the costmap.
            reset_distance_m: length of its sides.
        """
        self._clear_square(pose, reset_distance_m, inside=True)

    def clear_except(self, pose: SE2, reset_distance_m: float) -> None:
        """Clear the obstacles outside of a square around a pose, as Nav2's clear_except service
        does.
        """
        self._clear_square(pose, reset_distance_m, inside=False)

    def set_keepout(self, zone_costs: Costs | None) -> None:
        """Set the costs of keepout zones, (rows, columns) as `keepout_costs` makes them; None: no
        zones.

        Raises ValueError with a phrase if they have another shape.
        """
        zones = _NO_ZONES if zone_costs is None else np.array(zone_costs, np.uint8)
        if zones.size and zones.shape != self.master.costs.shape:
            raise ValueError(f"zones of {zones.shape} cells: must be {self.master.costs.shape}")
        self._zones = zones
        self._combine_static()
        self._combine(None)

    def with_keepout(self, zone_costs: Costs) -> tuple[Costmap, Costmap]:
        """The static and the combined costmap as they would be with other keepout zones, (rows,
        columns) as for `set_keepout`.
        """
        whole = 0, self.frame.rows, 0, self.frame.columns
        static, master = self._blank(), self._blank()
        nothing = np.zeros(self._base.shape, np.bool_)
        for costmap, marked in ((static, nothing), (master, self._marked())):
            self._compose(costmap, marked, whole, zone_costs)
        return static, master

    def _walls_m(self) -> Clearance | None:
        return self.static.distance_m

    def take_changed(self) -> Window | None:
        """The smallest window with all changes of the master costmap since it was last taken; None:
        there was none.
        """
        changed, self._changed = self._changed, None
        return changed

    def _clear_square(self, pose: SE2, side_m: float, inside: bool) -> None:
        column, row = self.frame.place(pose.x_m, pose.y_m)
        half = side_m / 2.0 / self.frame.resolution_m
        square = (
            round(row - half), round(row + half), round(column - half), round(column + half)
        )  # fmt: skip
        changed = self._obstacles.clear_square(square, inside)
        if changed is not None:
            self._combine(changed)

    def _marked(self) -> Mask:
        return self._obstacles.marked if self._all_marked is None else self._all_marked

    def _join(self, window: Window) -> None:
        """Bring the marks of all layers up to date in a window."""
        others = [layer.marked for layer in self._layers[1:] if not layer.is_empty]
        if not others:
            self._all_marked = None
            return
        if self._all_marked is None:
            self._all_marked = np.zeros_like(self._obstacles.marked)
            window = 0, self.frame.rows, 0, self.frame.columns
        at = np.s_[window[0] : window[1], window[2] : window[3]]
        self._all_marked[at] = self._obstacles.marked[at]
        for marked in others:
            self._all_marked[at] |= marked[at]

    def _blank(self) -> Costmap:
        shape = self.frame.rows, self.frame.columns
        return Costmap(
            self.frame, self._inflation.inscribed_radius_m,
            np.zeros(shape, np.uint8), np.zeros(shape, np.float32),
        )  # fmt: skip

    def _combine_static(self) -> None:
        nothing = np.zeros(self._base.shape, np.bool_)
        self._compose(self.static, nothing, (0, self.frame.rows, 0, self.frame.columns))

    def _combine(self, changed: Window | None) -> None:
        """Recompute the master costmap within reach of what changed; None: all of it."""
        if changed is None:
            self._all_marked = None
        rows, columns = self.frame.rows, self.frame.columns
        row0, row1, column0, column1 = changed or (0, rows, 0, columns)
        reach = self._inflation.reach
        window = (
            max(row0 - reach, 0), min(row1 + reach, rows),
            max(column0 - reach, 0), min(column1 + reach, columns),
        )  # fmt: skip
        self._join(window)
        self._compose(self.master, self._marked(), window)
        self.revision += 1
        known = self._changed or window
        self._changed = (
            min(known[0], window[0]), max(known[1], window[1]),
            min(known[2], window[2]), max(known[3], window[3]),
        )  # fmt: skip

    def _compose(
        self, costmap: Costmap, marked: Mask, window: Window, zones: Costs | None = None
    ) -> None:
        inflation = self._inflation
        compose(
            costmap.costs, costmap.distance_m, self._squares, self._base,
            self._zones if zones is None else zones, marked,
            inflation.cost, inflation.distance_m, inflation.reach, inflation.inflate_unknown,
            *window,
        )  # fmt: skip


class LocalCostmap(LayeredCostmap):
    """A window of the obstacle layer that moves with the robot, in the odometry's frame: it depends
    on no map and on no localisation. Its poses are in `odom`.
    """

    def __init__(
        self,
        resolution_m: float,
        inflation: InflationParams,
        obstacle: ObstacleParams,
        size_m: tuple[float, float] = (3.0, 3.0),
        footprint: Footprint = WAFFLE,
    ) -> None:
        """An empty window about the origin.

        Args:
            resolution_m: side of a cell.
            inflation: how cost falls with distance.
            obstacle: how the scan marks and clears.
            size_m: Nav2's width and height.
            footprint: the robot's, whose own place is cleared.
        """
        columns, rows = (max(1, round(side / resolution_m)) for side in size_m)
        frame = GridFrame(
            resolution_m, -(columns // 2) * resolution_m, -(rows // 2) * resolution_m, rows, columns
        )
        self._column, self._row = -(columns // 2), -(rows // 2)
        super().__init__(
            frame, np.zeros((rows, columns), np.int8), inflation, obstacle, footprint=footprint
        )

    def move(self, odom_from_base: SE2) -> None:
        """Move the window so that the robot is in its middle, by whole cells."""
        if self._shift(odom_from_base):
            self._combine(None)

    def follow(self, odom_from_base: SE2, scan: Scan) -> None:
        """Move the window as the robot has moved, and update it by the scan taken there."""
        moved = self._shift(odom_from_base)
        changed = self._observe(odom_from_base @ scan.base_from_scan, scan, odom_from_base)
        if moved:
            self._combine(None)
        elif changed is not None:
            self._combine(changed)

    def _shift(self, odom_from_base: SE2) -> bool:
        """Move the layers; whether they had to be, so that all of the costmap is to be computed."""
        frame = self.frame
        column = round(odom_from_base.x_m / frame.resolution_m) - frame.columns // 2
        row = round(odom_from_base.y_m / frame.resolution_m) - frame.rows // 2
        if (column, row) == (self._column, self._row):
            return False
        for layer in self._layers:
            layer.roll(row - self._row, column - self._column)
        self._column, self._row = column, row
        self.frame = GridFrame(
            frame.resolution_m, column * frame.resolution_m, row * frame.resolution_m,
            frame.rows, frame.columns,
        )  # fmt: skip
        # There is no map: what is static is the same everywhere.
        self.static, self.master = replace(self.static, frame=self.frame), self._blank()
        return True

    def _walls_m(self) -> Clearance | None:
        return None


def _union(one: Window | None, other: Window | None) -> Window | None:
    if one is None or other is None:
        return one or other
    return (
        min(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), max(one[3], other[3])
    )  # fmt: skip
