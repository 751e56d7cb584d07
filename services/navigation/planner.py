"""The global planner: A* on the costmap, then the cheapest polyline through its cells, smoothed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.common.error_codes import ErrorCode
from services.common.frames import SE2, Array
from services.common.kernels import kernel
from services.common.world.costmap import Clearance
from services.navigation.costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    NO_INFORMATION,
    Costmap,
    Costs,
)
from services.navigation.errors import NavigationError
from services.navigation.path import PlannedPath, path_through, resample

Indices = NDArray[np.int64]

_FOUND, _NO_WAY, _GAVE_UP = 0, 1, 2


@dataclass(frozen=True, slots=True)
class PlannerParams:
    """How the planner weighs length against cost."""

    cost_travel_multiplier: float
    """A metre through the costliest free cell costs 1 + this many metres; the name is Smac 2D's."""
    max_iterations: int
    """Cells to expand before failing with PLANNER_TIMEOUT: time does not advance within a step."""
    start_tolerance_m: float
    """How far a start inside inflated cells may be from the nearest free one."""
    path_spacing_m: float
    smoothing_iterations: int


class _SearchState(NamedTuple):
    """The state of a search for each cell."""

    cost_to_come: Array
    parent: Indices
    done: NDArray[np.bool_]

    @classmethod
    def of(cls, cells: int) -> _SearchState:
        return cls(np.empty(cells), np.empty(cells, np.int64), np.empty(cells, np.bool_))


class Planner:
    """Finds paths for the robot's circle."""

    def __init__(self, params: PlannerParams) -> None:
        self._params = params
        self._state = _SearchState.of(0)
        """Kept, since allocating the arrays for each plan would fragment the heap."""

    def plan(self, costmap: Costmap, start: SE2, goal: SE2) -> PlannedPath:
        """Path from `start` to `goal` that keeps the robot's circle off every obstacle.

        Raises NavigationError with START_OUTSIDE_MAP, START_OCCUPIED, GOAL_OUTSIDE_MAP,
        GOAL_OCCUPIED, NO_VALID_PATH or PLANNER_TIMEOUT.
        """
        check_goal(costmap, goal)
        frame = costmap.frame
        start_cell = self._start_cell(costmap, start)
        goal_cell = frame.cell(goal.x_m, goal.y_m)
        assert goal_cell is not None
        weight = self._params.cost_travel_multiplier
        if len(self._state.done) != costmap.costs.size:
            self._state = _SearchState.of(costmap.costs.size)
        status, cells = _a_star(
            costmap.costs, *start_cell, *goal_cell, weight, self._params.max_iterations,
            self._state.cost_to_come, self._state.parent, self._state.done,
        )  # fmt: skip
        if status == _GAVE_UP:
            raise NavigationError(
                ErrorCode.PLANNER_TIMEOUT,
                f"no path found within {self._params.max_iterations} cells: "
                "raise max_planning_iterations",
            )
        if status == _NO_WAY:
            raise NavigationError(
                ErrorCode.NO_VALID_PATH,
                f"no way from ({start.x_m:.2f}, {start.y_m:.2f}) "
                f"to ({goal.x_m:.2f}, {goal.y_m:.2f}) "
                f"for a robot of radius {costmap.robot_radius_m:.2f} m",
            )
        # In units of cells, with cell centres at whole numbers.
        offset = np.array([frame.origin_x_m, frame.origin_y_m]) + 0.5 * frame.resolution_m
        points = np.ascontiguousarray(cells[:, ::-1], np.float64)
        if frame.cell(start.x_m, start.y_m) == start_cell:
            points[0] = (np.array([start.x_m, start.y_m]) - offset) / frame.resolution_m
        end = (np.array([[goal.x_m, goal.y_m]]) - offset) / frame.resolution_m
        points = (
            np.concatenate([points[:-1], end]) if len(points) > 1 else np.repeat(end, 2, axis=0)
        )
        candidates = _thin(points)
        corners = candidates[_cheapest_polyline(candidates, costmap.costs, weight)]
        dense = resample(corners, self._params.path_spacing_m / frame.resolution_m)
        smooth = _smooth(
            dense,
            costmap.costs,
            costmap.clearance_m,
            costmap.robot_radius_m + frame.resolution_m,
            self._params.smoothing_iterations,
        )
        in_map = smooth * frame.resolution_m + offset
        # The path starts at the robot's position, even inside inflated cells.
        in_map = np.concatenate([[[start.x_m, start.y_m]], in_map])
        in_map[-1] = (goal.x_m, goal.y_m)
        return path_through(resample(in_map, self._params.path_spacing_m), goal.yaw_rad)

    def _start_cell(self, costmap: Costmap, start: SE2) -> tuple[int, int]:
        cell = costmap.frame.cell(start.x_m, start.y_m)
        if cell is None:
            raise NavigationError(
                ErrorCode.START_OUTSIDE_MAP,
                f"start ({start.x_m:.2f}, {start.y_m:.2f}) lies outside the map: "
                f"it covers {costmap.frame.extent()}",
            )
        if costmap.costs[cell] < INSCRIBED_INFLATED_OBSTACLE:
            return cell
        tolerance_m = self._params.start_tolerance_m
        free = _nearest_free(costmap, cell, tolerance_m)
        if costmap.costs[cell] >= LETHAL_OBSTACLE or free is None:
            raise NavigationError(
                ErrorCode.START_OCCUPIED,
                f"start ({start.x_m:.2f}, {start.y_m:.2f}) is {_what_is_there(costmap, start)}: "
                f"must be within {tolerance_m:.2f} m of free space",
            )
        return free


def check_goal(costmap: Costmap, goal: SE2) -> None:
    """Raise NavigationError if the robot cannot be at a goal: GOAL_OUTSIDE_MAP, GOAL_OCCUPIED, or
    NO_VALID_PATH in unknown space, where no path leads.
    """
    if costmap.frame.cell(goal.x_m, goal.y_m) is None:
        raise NavigationError(
            ErrorCode.GOAL_OUTSIDE_MAP,
            f"goal ({goal.x_m:.4g}, {goal.y_m:.4g}) lies outside the map: "
            f"it covers {costmap.frame.extent()}",
        )
    unknown = costmap.cost_at(goal.x_m, goal.y_m) == NO_INFORMATION
    if unknown and costmap.clearance_at(goal.x_m, goal.y_m) > costmap.robot_radius_m:
        raise NavigationError(
            ErrorCode.NO_VALID_PATH,
            f"goal ({goal.x_m:.2f}, {goal.y_m:.2f}) is in unknown space: "
            "must be on floor the map shows as free",
        )
    if costmap.cost_at(goal.x_m, goal.y_m) >= INSCRIBED_INFLATED_OBSTACLE:
        raise NavigationError(
            ErrorCode.GOAL_OCCUPIED,
            f"goal ({goal.x_m:.2f}, {goal.y_m:.2f}) is {_what_is_there(costmap, goal)}: "
            f"must be more than {costmap.robot_radius_m:.2f} m from every obstacle",
        )


def _what_is_there(costmap: Costmap, pose: SE2) -> str:
    cost = costmap.cost_at(pose.x_m, pose.y_m)
    if cost == LETHAL_OBSTACLE:
        return "inside an obstacle"
    if cost == NO_INFORMATION:
        return "in unknown space"
    return f"{costmap.clearance_at(pose.x_m, pose.y_m):.2f} m from an obstacle"


def _nearest_free(
    costmap: Costmap, cell: tuple[int, int], tolerance_m: float
) -> tuple[int, int] | None:
    """The free cell nearest to a cell; of several the first by row and column."""
    reach = int(tolerance_m / costmap.frame.resolution_m)
    top, left = max(0, cell[0] - reach), max(0, cell[1] - reach)
    window = costmap.costs[top : cell[0] + reach + 1, left : cell[1] + reach + 1]
    rows, columns = np.nonzero(window < INSCRIBED_INFLATED_OBSTACLE)
    if rows.size == 0:
        return None
    up, along = rows + top - cell[0], columns + left - cell[1]
    squares = up * up + along * along
    best = int(np.argmin(squares))
    if squares[best] > reach * reach:
        return None
    return int(rows[best]) + top, int(columns[best]) + left


def _thin(points: Array) -> Array:
    """Every other point and both ends: as good a choice of corners at a quarter of the time."""
    return points if len(points) < 4 else np.concatenate([points[:-1:2], points[-1:]])


@kernel()
def _a_star(
    costs: Costs,
    start_row: int,
    start_column: int,
    goal_row: int,
    goal_column: int,
    weight: float,
    max_iterations: int,
    cost_to_come: Array,
    parent: Indices,
    done: NDArray[np.bool_],
) -> tuple[int, Indices]:
    """Cheapest 8-connected path between two cells that enters no cell of cost 253 or more.

    A step costs its length in cells times (1 + weight * mean cost of its two cells / 252). The
    heuristic is the octile distance, which no path can undercut. Of equal candidates the one with
    the lower cell index is taken.

    The last three arguments, one value per cell, are overwritten. Returns (status, (n, 2) rows and
    columns from start to goal).
    """
    rows, columns = costs.shape
    start, goal = start_row * columns + start_column, goal_row * columns + goal_column
    flat = costs.ravel()
    cost_to_come[:], parent[:], done[:] = np.inf, -1, False
    heap_key = np.empty(1024, np.float64)
    heap_cell = np.empty(1024, np.int64)
    heap_key[0], heap_cell[0], count = 0.0, start, 1
    cost_to_come[start] = 0.0
    diagonal = math.sqrt(2.0)
    status, iterations = _NO_WAY, 0
    while count > 0:
        cell = heap_cell[0]
        count -= 1
        # Sift the last entry down from the root.
        key, moved, hole = heap_key[count], heap_cell[count], 0
        while True:
            child = 2 * hole + 1
            if child >= count:
                break
            other = child + 1
            if other < count and (
                heap_key[other] < heap_key[child]
                or (heap_key[other] == heap_key[child] and heap_cell[other] < heap_cell[child])
            ):
                child = other
            if heap_key[child] < key or (heap_key[child] == key and heap_cell[child] < moved):
                heap_key[hole], heap_cell[hole] = heap_key[child], heap_cell[child]
                hole = child
            else:
                break
        heap_key[hole], heap_cell[hole] = key, moved
        if done[cell]:
            continue
        done[cell] = True
        if cell == goal:
            status = _FOUND
            break
        iterations += 1
        if iterations > max_iterations:
            status = _GAVE_UP
            break
        row, column = cell // columns, cell % columns
        for d_row in range(-1, 2):
            for d_column in range(-1, 2):
                if d_row == 0 and d_column == 0:
                    continue
                to_row, to_column = row + d_row, column + d_column
                if not (0 <= to_row < rows and 0 <= to_column < columns):
                    continue
                to = to_row * columns + to_column
                if done[to] or flat[to] >= 253:
                    continue
                length = 1.0
                if d_row != 0 and d_column != 0:
                    length = diagonal
                    if costs[row, to_column] >= 253 or costs[to_row, column] >= 253:
                        continue
                mean_cost = 0.5 * (float(flat[cell]) + float(flat[to]))
                cost = cost_to_come[cell] + length * (1.0 + weight * mean_cost / 252.0)
                if cost >= cost_to_come[to]:
                    continue
                cost_to_come[to] = cost
                parent[to] = cell
                far, near = abs(to_row - goal_row), abs(to_column - goal_column)
                if far < near:
                    far, near = near, far
                key = cost + far + (diagonal - 1.0) * near
                if count == heap_key.size:
                    heap_key = np.concatenate((heap_key, np.empty(count, np.float64)))
                    heap_cell = np.concatenate((heap_cell, np.empty(count, np.int64)))
                hole = count
                count += 1
                while hole > 0:
                    above = (hole - 1) // 2
                    if key < heap_key[above] or (key == heap_key[above] and to < heap_cell[above]):
                        heap_key[hole], heap_cell[hole] = heap_key[above], heap_cell[above]
                        hole = above
                    else:
                        break
                heap_key[hole], heap_cell[hole] = key, to
    if status != _FOUND:
        return status, np.empty((0, 2), np.int64)
    length_of_path, cell = 1, goal
    while cell != start:
        cell = parent[cell]
        length_of_path += 1
    way = np.empty((length_of_path, 2), np.int64)
    cell = goal
    for i in range(length_of_path - 1, -1, -1):
        way[i, 0], way[i, 1] = cell // columns, cell % columns
        cell = parent[cell]
    return status, way


@kernel()
def _line_cost(
    costs: Costs, x0: float, y0: float, x1: float, y1: float, weight: float, limit: float
) -> float:
    """Cost of a straight line, sampled every half cell; inf if it is blocked or costs `limit` or
    more.
    """
    length = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    samples = int(length * 2.0) + 1
    step = length / samples
    rows, columns = costs.shape
    total = 0.0
    for i in range(samples):
        t = (i + 0.5) / samples
        row = math.floor(y0 + (y1 - y0) * t + 0.5)
        column = math.floor(x0 + (x1 - x0) * t + 0.5)
        if not (0 <= row < rows and 0 <= column < columns):
            return np.inf
        cost = costs[row, column]
        if cost >= 253:
            return np.inf
        total += step * (1.0 + weight * cost / 252.0)
        if total >= limit:
            return np.inf
    return total


@kernel()
def _cheapest_polyline(points: Array, costs: Costs, weight: float) -> Indices:
    """Indices of those of (n, 2) points, in cells, that make the cheapest polyline from the first
    to the last.
    """
    n = len(points)
    best = np.full(n, np.inf)
    came_from = np.full(n, -1, np.int64)
    best[0] = 0.0
    for j in range(1, n):
        # From near to far: the nearest ones give a limit that ends most of the far ones early.
        for i in range(j - 1, -1, -1):
            limit = best[j] - best[i]
            along, across = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            if limit <= 0.0 or math.sqrt(along * along + across * across) >= limit:
                continue
            cost = best[i] + _line_cost(
                costs, points[i, 0], points[i, 1], points[j, 0], points[j, 1], weight, limit
            )
            if cost < best[j]:
                best[j] = cost
                came_from[j] = i
        if came_from[j] < 0:
            # The line between two cells of the A* path cuts the corner of a blocked third one.
            best[j] = best[j - 1] + 10.0
            came_from[j] = j - 1
    count, j = 1, n - 1
    while j > 0:
        j = came_from[j]
        count += 1
    chosen = np.empty(count, np.int64)
    j = n - 1
    for k in range(count - 1, -1, -1):
        chosen[k] = j
        j = came_from[j]
    return chosen


@kernel()
def _smooth(
    points: Array, costs: Costs, clearance_m: Clearance, safe_m: float, passes: int
) -> Array:
    """Round the corners of (n, 2) points, in cells, by Gauss-Seidel relaxation held to the
    original.

    No point is moved nearer to an obstacle than `safe_m`, or than it was if that is nearer.
    """
    pull_to_neighbours, pull_to_original = 0.45, 0.02
    original = points.copy()
    rows, columns = costs.shape
    for _ in range(passes):
        for i in range(1, len(points) - 1):
            x = (
                points[i, 0]
                + pull_to_neighbours * (points[i - 1, 0] + points[i + 1, 0] - 2 * points[i, 0])
                + pull_to_original * (original[i, 0] - points[i, 0])
            )
            y = (
                points[i, 1]
                + pull_to_neighbours * (points[i - 1, 1] + points[i + 1, 1] - 2 * points[i, 1])
                + pull_to_original * (original[i, 1] - points[i, 1])
            )
            row, column = math.floor(y + 0.5), math.floor(x + 0.5)
            if not (0 <= row < rows and 0 <= column < columns) or costs[row, column] >= 253:
                continue
            there_m = clearance_m[row, column]
            here_m = clearance_m[math.floor(points[i, 1] + 0.5), math.floor(points[i, 0] + 0.5)]
            if there_m >= safe_m or there_m >= here_m:
                points[i, 0], points[i, 1] = x, y
    return points
