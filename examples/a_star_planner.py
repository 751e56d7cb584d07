"""A global planner of your own: A* over the 8 neighbours of each cell of the global costmap.

    mazebot demo --world original --no-camera --config examples/a_star_planner.yaml

docs/planning.md explains the interface. Mazebot's own `a_star` is compiled, rounds corners and
sweeps the robot's outline along the path; this one shows the algorithm in plain Python.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from mazebot.plugins import (
    SE2,
    Costmap,
    ErrorCode,
    NavigationError,
    PlannedPath,
    PlannerParams,
    path_through,
    resample,
)

Cell = tuple[int, int]
"""Row and column."""

INSCRIBED = 253
"""From this cost on the robot would touch an obstacle wherever it faces, or is in unknown space."""
TURNING_RADIUS_M = 0.24
"""The robot's corners: nearer to a wall it cannot turn on the spot."""
TIGHT = 3.0
"""A step through a cell where the robot cannot turn counts as this many."""
NEIGHBOURS = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)]


class AStarPlanner:
    """Finds the cheapest path in the 8 directions of the grid."""

    def __init__(self, params: PlannerParams) -> None:
        self.spacing_m = params.path_spacing_m
        self.cost_weight = params.settings.cost_travel_multiplier

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        """The path from start to goal, in the map; the tolerance is not used."""
        first = costmap.frame.cell(start.x_m, start.y_m)
        last = costmap.frame.cell(goal.x_m, goal.y_m)
        if first is None:
            raise NavigationError(ErrorCode.START_OUTSIDE_MAP, "the start is outside of the map")
        if last is None:
            raise NavigationError(ErrorCode.GOAL_OUTSIDE_MAP, "the goal is outside of the map")
        if costmap.costs[last] >= INSCRIBED:
            raise NavigationError(
                ErrorCode.GOAL_OCCUPIED, "the goal is too near to an obstacle", goal[:2]
            )
        cells = self._search(self._weights(costmap), first, last)
        if cells is None:
            raise NavigationError(ErrorCode.NO_VALID_PATH, "no path leads to the goal", goal[:2])
        inner_m = [costmap.frame.center(*cell) for cell in cells[1:-1]]
        points_m = np.array([start[:2], *inner_m, goal[:2]])
        return path_through(_smooth(resample(points_m, self.spacing_m)), goal.yaw_rad)

    def _weights(self, costmap: Costmap) -> list[list[float]]:
        """What a step of one cell through each cell counts for; inf where the robot cannot be."""
        costs = costmap.costs
        weights = 1.0 + self.cost_weight * costs / 252.0
        weights[costmap.distance_m < TURNING_RADIUS_M] *= TIGHT
        weights[costs >= INSCRIBED] = math.inf
        # Lists are faster than arrays where single cells are read.
        return [list(map(float, row)) for row in weights]

    @staticmethod
    def _search(weights: list[list[float]], first: Cell, last: Cell) -> list[Cell] | None:
        """The cells from first to last, or None where no path leads there."""
        rows, columns = len(weights), len(weights[0])
        cost_of = {first: 0.0}
        came_from: dict[Cell, Cell] = {}
        open_cells = [(math.dist(first, last), first)]
        done: set[Cell] = set()
        while open_cells:
            _, cell = heapq.heappop(open_cells)
            if cell == last:
                path = [last]
                while path[-1] != first:
                    path.append(came_from[path[-1]])
                return path[::-1]
            if cell in done:
                continue
            done.add(cell)
            row, column = cell
            for down, right in NEIGHBOURS:
                r, c = row + down, column + right
                if not (0 <= r < rows and 0 <= c < columns):
                    continue
                weight = weights[r][c]
                if down and right:
                    # A diagonal step must not cut an obstacle's corner.
                    weight = max(weight, weights[row][c], weights[r][column])
                cost = cost_of[cell] + math.hypot(down, right) * weight
                if cost < cost_of.get((r, c), math.inf):
                    cost_of[r, c], came_from[r, c] = cost, cell
                    # No cell weighs less than 1, so the straight line is never too long.
                    heapq.heappush(open_cells, (cost + math.dist((r, c), last), (r, c)))
        return None


def _smooth(points_m: np.ndarray) -> np.ndarray:
    """The points, each moved to the mean of its neighbours a few times; the ends stay."""
    smooth_m = points_m.copy()
    for _ in range(5):
        smooth_m[1:-1] = (smooth_m[:-2] + smooth_m[1:-1] + smooth_m[2:]) / 3.0
    return smooth_m
