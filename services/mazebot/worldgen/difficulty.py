"""Difficulty of the path through a world, by its map."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.documents import Document, Planar
from mazebot.common.world.costmap import FREE
from mazebot.common.world.grids import connected_regions
from mazebot.worldgen.markers.visibility import Bits, reachable
from mazebot.worldgen.maze import maze as mazes
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

_NEIGHBOURS = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
_LOOK_BACK = 400
"""Cells along the path that one straight line may skip."""


class Difficulty(Document):
    """Of the path from the start to the location `goal`, or else to the farthest location."""

    goal: str = Field("", description="name of the location; empty: none is reachable")
    path_length_m: float | None = Field(None, description="of a short path for the robot's centre")
    turns: int | None = Field(
        None,
        description="of a maze: cells in which the path turns; else: its quarter turns",
    )
    dead_ends: int | None = Field(None, description="cells of a maze with one passage")
    narrowest_gap_m: float | None = Field(
        None, description="width of the narrowest gap on the widest path, by the map"
    )
    free_area_m2: float = Field(description="free floor of the map")


def difficulty(loaded: LoadedWorld) -> Difficulty:
    """The figures of a world.

    The path is the shortest over the sides and corners of the cells where the robot fits, then
    straightened: at most some hundredths longer than the shortest. The gap is measured on the map's
    cells, which extend beyond the walls by up to one on either side.
    """
    world, resolution_m = loaded.world, loaded.world.map_resolution_m
    free = loaded.map_cells == FREE
    area_m2 = round(float(free.sum()) * portable.square(resolution_m), 4)
    fits = reachable(loaded.map_cells, resolution_m, loaded.map_origin, world.start)
    recipe = loaded.recipe
    maze = mazes.generate(recipe.maze, recipe.wall_thickness_m) if recipe and recipe.maze else None
    dead_ends = maze.dead_ends if maze else None
    start = _cell(fits, loaded.map_origin, resolution_m, world.start)
    goals = {
        one.name: cell
        for one in world.locations
        if (cell := _cell(fits, loaded.map_origin, resolution_m, one)) is not None
    }
    if start is None or not goals:
        return Difficulty(dead_ends=dead_ends, free_area_m2=area_m2)
    distance, before = _search(fits, start[0] * fits.shape[1] + start[1])
    name = "goal" if "goal" in goals else max(goals, key=lambda one: float(distance[goals[one]]))
    cells = [goals[name][0] * fits.shape[1] + goals[name][1]]
    while before[cells[-1]] >= 0:
        cells.append(int(before[cells[-1]]))
    way = np.stack(np.divmod(np.array(cells[::-1], np.int64), fits.shape[1]), 1)
    steps = np.diff(_pulled(fits, way), axis=0)
    headings = portable.atan2_each(steps[:, 0], steps[:, 1]).tolist()
    bends = sum(abs(wrap_angle(b - a)) for a, b in itertools.pairwise(headings))
    return Difficulty(
        goal=name,
        path_length_m=round(
            float(portable.hypot_each(steps[:, 0], steps[:, 1]).sum()) * resolution_m, 4
        ),
        turns=maze.turns if maze and name == "goal" else round(bends / (math.pi / 2.0)),
        dead_ends=dead_ends,
        narrowest_gap_m=round(_narrowest(free, start, goals[name]) * resolution_m, 4),
        free_area_m2=area_m2,
    )


def _cell(fits: Bits, origin: SE2, resolution_m: float, place: Planar) -> tuple[int, int] | None:
    """Row and column of a pose, or of the nearest cell within half a metre where the robot fits."""
    here = origin.inverse() @ place.se2()
    row, column = math.floor(here.y_m / resolution_m), math.floor(here.x_m / resolution_m)
    reach = math.ceil(0.5 / resolution_m)
    low = max(row - reach, 0), max(column - reach, 0)
    near = np.argwhere(fits[low[0] : max(row + reach + 1, 0), low[1] : max(column + reach + 1, 0)])
    if not len(near):
        return None
    near += low
    best = near[portable.square(near - (row, column)).sum(1).argmin()]
    return int(best[0]), int(best[1])


def _narrowest(free: Bits, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Width in cells of the narrowest gap on the path between two cells where that gap is widest.

    Measured on the corners, the middles of the sides and the middles of the cells, on which the
    distance to occupied cells is exact.
    """
    taken = np.zeros((2 * free.shape[0] + 1, 2 * free.shape[1] + 1), np.bool_)
    for row in (0, 1, 2):
        for column in (0, 1, 2):
            view = taken[row : row + 2 * free.shape[0] : 2, column : column + 2 * free.shape[1] : 2]
            view |= ~free
    if not taken.any():
        return math.inf
    distance = ndimage.distance_transform_edt(~taken)
    square: NDArray[np.int64] = np.rint(portable.square(distance)).astype(np.int64)
    ends = [_middle(square, (2 * row + 1, 2 * column + 1)) for row, column in (start, goal)]
    low, high = 1, int(min(square[end] for end in ends))
    while low < high:
        middle = (low + high + 1) // 2
        regions = connected_regions(square >= middle)
        low, high = (middle, high) if regions[ends[0]] == regions[ends[1]] else (low, middle - 1)
    return math.sqrt(low)


def _middle(square: NDArray[np.int64], place: tuple[int, int]) -> tuple[int, int]:
    """Uphill from a cell to a local maximum of the distance to occupied cells."""
    while True:
        row, column = place
        beside = [
            (row + a, column + b)
            for a, b in _NEIGHBOURS
            if 0 <= row + a < square.shape[0] and 0 <= column + b < square.shape[1]
        ]
        best = max(beside, key=lambda one: int(square[one]))
        if square[best] <= square[place]:
            return place
        place = best


@kernel()
def _search(fits: Bits, start: int) -> tuple[Array, NDArray[np.int64]]:
    """(rows, columns) of the distances from a cell, in cells, and (cells,) of the cell before each.

    By Dijkstra, over sides and corners; corners of occupied cells are not cut.
    """
    rows, columns = fits.shape
    distance = np.full(rows * columns, np.inf)
    before = np.full(rows * columns, -1, np.int64)
    distance[start] = 0.0
    queue = [(0.0, start)]
    while len(queue) > 0:
        length, cell = heapq.heappop(queue)
        if length > distance[cell]:
            continue
        row, column = cell // columns, cell % columns
        for a in range(-1, 2):
            for b in range(-1, 2):
                r, c = row + a, column + b
                if not (0 <= r < rows and 0 <= c < columns and fits[r, c]):
                    continue
                if a != 0 and b != 0 and not (fits[row, c] and fits[r, column]):
                    continue
                further = length + math.sqrt(a * a + b * b)
                if further < distance[r * columns + c]:
                    distance[r * columns + c] = further
                    before[r * columns + c] = cell
                    heapq.heappush(queue, (further, r * columns + c))
    return distance.reshape(rows, columns), before


@kernel()
def _straight(fits: Bits, a: NDArray[np.int64], b: NDArray[np.int64]) -> bool:
    """Whether the robot fits all along a straight line between two cells."""
    count = 2 * max(abs(b[0] - a[0]), abs(b[1] - a[1]))
    for step in range(1, count):
        row = round(a[0] + (b[0] - a[0]) * step / count)
        column = round(a[1] + (b[1] - a[1]) * step / count)
        if not fits[int(row), int(column)]:
            return False
    return True


@kernel()
def _pulled(fits: Bits, way: NDArray[np.int64]) -> NDArray[np.int64]:
    """The path with straight lines where these are free, (n, 2): the shortest of such."""
    count = len(way)
    length = np.full(count, np.inf)
    before = np.zeros(count, np.int64)
    length[0] = 0.0
    for j in range(1, count):
        for i in range(max(0, j - _LOOK_BACK), j):
            down, along = way[j, 0] - way[i, 0], way[j, 1] - way[i, 1]
            step = math.sqrt(down * down + along * along)
            if length[i] + step < length[j] - 1e-9 and _straight(fits, way[i], way[j]):
                length[j] = length[i] + step
                before[j] = i
    kept = [count - 1]
    while kept[-1] != 0:
        kept.append(before[kept[-1]])
    pulled: NDArray[np.int64] = way[np.array(kept[::-1])]
    return pulled
