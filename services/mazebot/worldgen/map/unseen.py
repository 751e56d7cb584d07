"""What is on a world's map though the lidar does not see it.

The map has everything that the robot could hit, the lidar sees one plane: a step is below it, a
shelf above, and of a ramp it sees one line.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import UnseenArea, World
from mazebot.common.robot.waffle import LIDAR_HEIGHT_M
from mazebot.common.world.costmap import OCCUPIED
from mazebot.common.world.footprint import footprints
from mazebot.common.world.geometry import TriangleMesh
from mazebot.worldgen.map.occupancy import Grid, occupied_cells


def unseen_areas(
    world: World, meshes: Mapping[str, TriangleMesh], cells: NDArray[np.int8], origin: SE2
) -> tuple[UnseenArea, ...]:
    """The occupied cells of a world's own map in which nothing crosses the lidar's plane.

    `cells` are (rows, columns) of -1, 0 or 100, `origin` is map_from_grid, without a turn, and
    `meshes` are by sha256. Raises KeyError if one is missing.
    """
    rows, columns = cells.shape
    grid = Grid(rows, columns, world.map_resolution_m, origin)
    walls = tuple(wall for wall in world.walls if wall.height_m > LIDAR_HEIGHT_M)
    plane_m = (LIDAR_HEIGHT_M, LIDAR_HEIGHT_M)
    seen = footprints(world.model_copy(update={"walls": walls}), meshes, plane_m)
    return _rectangles((cells == OCCUPIED) & ~occupied_cells(seen, grid), grid)


def _rectangles(where: NDArray[np.bool_], grid: Grid) -> tuple[UnseenArea, ...]:
    """Rectangles of the cells of a grid without a turn: one of each run of cells that is the same
    in several rows.
    """
    # An empty row at the end ends all runs.
    sides = np.diff(np.pad(where, ((0, 1), (1, 1))).astype(np.int8), axis=1)
    found: list[tuple[int, int, int, int]] = []
    open_runs: dict[tuple[int, int], int] = {}
    for row, line in enumerate(sides):
        starts, ends = np.flatnonzero(line > 0).tolist(), np.flatnonzero(line < 0).tolist()
        runs = {run: open_runs.get(run, row) for run in zip(starts, ends, strict=True)}
        for (left, right), first in open_runs.items() - runs.items():
            found.append((left, first, right, row))
        open_runs = runs
    x_m, y_m, _ = grid.origin
    size_m = grid.resolution_m
    return tuple(
        UnseenArea(
            low_m=(x_m + left * size_m, y_m + low * size_m),
            high_m=(x_m + right * size_m, y_m + top * size_m),
        )
        for left, low, right, top in sorted(found)
    )
