"""Mazes: cells, passages between them, the walls around them, and the longest path through."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.messages.documents import Planar
from mazebot.common.robot.waffle import WAFFLE_RADIUS_M
from mazebot.worldgen.maze import spanning_tree
from mazebot.worldgen.maze.spanning_tree import Bits
from mazebot.worldgen.recipe_model import MazeRecipe

PASSABLE_M = 2.0 * WAFFLE_RADIUS_M
EXACT_CELLS = 2500
"""Up to this many cells the longest path is found exactly if there are loops."""

_MAX_ROOM_CELLS = 5
"""Along a room's side."""


@dataclass(frozen=True)
class Segment:
    """A straight piece of wall in the map: its x axis runs along its length."""

    x_m: float
    """Centre."""
    y_m: float
    """Centre."""
    length_m: float
    yaw_rad: float
    """0 or pi / 2."""


@dataclass(frozen=True, eq=False)
class Maze:
    """Cells in rows along y and columns along x; the middle of the start cell is (0, 0)."""

    right_open: Bits
    """(rows, columns): joined to the next cell along x"""
    up_open: Bits
    """(rows, columns): joined to the next cell along y"""
    inside: Bits
    """(rows, columns): a cell of the maze; the others are walled off. All are connected."""
    way: NDArray[np.int32]
    """(n, 2): row and column of each cell of the shortest path from start to goal"""
    walls: tuple[Segment, ...]
    """Maximal straight ones, those along x first; together they have no gap at any corner, and no
    two coplanar faces of the same direction overlap."""
    start: Planar
    """Heads along the path's first step."""
    goal: Planar
    """Heads along the path's last step."""

    @property
    def dead_ends(self) -> int:
        """Cells with one passage."""
        return int((_passages(self.right_open, self.up_open)[self.inside] == 1).sum())

    @property
    def turns(self) -> int:
        """Cells in which the path from start to goal turns."""
        steps = np.diff(self.way, axis=0)
        return int((steps[1:] != steps[:-1]).any(1).sum())


def generate(recipe: MazeRecipe, wall_thickness_m: float) -> Maze:
    """The maze of a recipe: same recipe, same maze.

    Start and goal are the ends of the longest of all shortest paths; with loops and more than
    EXACT_CELLS cells, of the longest that two sweeps find.

    Raises ValueError with a short phrase about `cell_m` if the robot cannot pass.
    """
    if recipe.cell_m - wall_thickness_m < PASSABLE_M - 1e-9:
        raise ValueError(
            f"must be at least {wall_thickness_m + PASSABLE_M:g}, for the robot to pass between "
            f"walls of {wall_thickness_m:g} m"
        )
    inside = np.ones((recipe.rows, recipe.columns), np.bool_)
    rng = np.random.Generator(np.random.PCG64([recipe.seed, 1]))
    if recipe.algorithm == "rooms":
        right_open, up_open, inside = _rooms(recipe.rows, recipe.columns, rng)
    elif recipe.algorithm == "wilson":
        right_open, up_open = spanning_tree.wilson(recipe.rows, recipe.columns, recipe.seed)
    else:
        right_open, up_open = spanning_tree.recursive_backtracker(
            recipe.rows, recipe.columns, recipe.seed
        )
    _braid(right_open, up_open, inside, recipe.braiding, rng)
    has_loops = int(right_open.sum() + up_open.sum()) >= int(inside.sum())
    start, goal = spanning_tree.farthest_pair(
        right_open, up_open, inside, has_loops and inside.size <= EXACT_CELLS
    )
    way = np.stack(
        np.divmod(spanning_tree.way(right_open, up_open, start, goal), np.int32(recipe.columns)), 1
    )
    steps = np.diff(way, axis=0)
    return Maze(
        right_open=right_open,
        up_open=up_open,
        inside=inside,
        way=way,
        walls=_walls(right_open, up_open, inside, way[0], recipe.cell_m, wall_thickness_m),
        start=_planar(way[0] - way[0], steps[0], recipe.cell_m),
        goal=_planar(way[-1] - way[0], steps[-1], recipe.cell_m),
    )


def _planar(cell: NDArray[np.int32], step: NDArray[np.int32], cell_m: float) -> Planar:
    """The middle of a cell, (row, column) from the start's, heading along a step."""
    row, column = cell.tolist()
    return Planar(
        x_m=column * cell_m, y_m=row * cell_m, yaw_rad=portable.atan2(int(step[0]), int(step[1]))
    )


def _passages(right_open: Bits, up_open: Bits) -> NDArray[np.int8]:
    """(rows, columns): how many passages each cell has."""
    count = right_open.astype(np.int8) + up_open
    count[:, 1:] += right_open[:, :-1]
    count[1:] += up_open[:-1]
    return count


def _braid(
    right_open: Bits, up_open: Bits, inside: Bits, share: float, rng: np.random.Generator
) -> None:
    """Open a wall of some dead ends, so that round(share * n) of all n are removed.

    Opening a wall between two dead ends removes both; the last one is opened towards another
    cell, unless only pairs of dead ends are left.
    """
    passages = _passages(right_open, up_open)
    dead_ends = np.argwhere((passages == 1) & inside)
    rng.shuffle(dead_ends)
    left = round(share * len(dead_ends))
    for last_resort in (False, True):
        for row, column in dead_ends.tolist():
            if left <= 0 or passages[row, column] != 1:
                continue
            choices = _closed_off(right_open, up_open, inside, row, column)
            if left == 1 and not last_resort:
                choices = [cell for cell in choices if passages[cell] != 1]
            if not choices:
                continue
            cell = choices[int(rng.integers(len(choices)))]
            left -= 1 + int(passages[cell] == 1)
            _join(right_open, up_open, (row, column), cell)
            passages[row, column] += 1
            passages[cell] += 1


def _closed_off(
    right_open: Bits, up_open: Bits, inside: Bits, row: int, column: int
) -> list[tuple[int, int]]:
    """The adjacent cells of the maze to which there is no passage."""
    rows, columns = inside.shape
    cells = []
    if column + 1 < columns and not right_open[row, column]:
        cells.append((row, column + 1))
    if row + 1 < rows and not up_open[row, column]:
        cells.append((row + 1, column))
    if column > 0 and not right_open[row, column - 1]:
        cells.append((row, column - 1))
    if row > 0 and not up_open[row - 1, column]:
        cells.append((row - 1, column))
    return [cell for cell in cells if inside[cell]]


def _join(right_open: Bits, up_open: Bits, a: tuple[int, int], b: tuple[int, int]) -> None:
    """Open the wall between two adjacent cells."""
    (right_open if a[0] == b[0] else up_open)[min(a, b)] = True


def _rooms(rows: int, columns: int, rng: np.random.Generator) -> tuple[Bits, Bits, Bits]:
    """(right_open, up_open, inside) of rooms with at least a cell between any two, joined by
    corridors along a shortest spanning tree. All other cells are walled off.
    """
    right_open = np.zeros((rows, columns), np.bool_)
    up_open = np.zeros((rows, columns), np.bool_)
    inside = np.zeros((rows, columns), np.bool_)
    shape = np.array((rows, columns))
    largest = np.clip(shape // 2, 2, _MAX_ROOM_CELLS)
    tried_sizes = rng.integers(2, largest + 1, (rows * columns, 2))
    tried_corners = rng.integers(0, shape - tried_sizes + 1)
    rooms: list[tuple[int, int, int, int]] = []
    for (row, column), (height, width) in zip(
        tried_corners.tolist(), tried_sizes.tolist(), strict=True
    ):
        if inside[
            max(row - 1, 0) : row + height + 1, max(column - 1, 0) : column + width + 1
        ].any():
            continue
        inside[row : row + height, column : column + width] = True
        right_open[row : row + height, column : column + width - 1] = True
        up_open[row : row + height - 1, column : column + width] = True
        rooms.append((row, column, height, width))
    corners, sizes = np.array(rooms)[:, :2], np.array(rooms)[:, 2:]
    for pair in _shortest_tree(2 * corners + sizes):
        (row, column), end = ((corners[room] + rng.integers(sizes[room])).tolist() for room in pair)
        along_rows_first = bool(rng.integers(2))
        for axis in (0, 1) if along_rows_first else (1, 0):
            while (row, column)[axis] != end[axis]:
                step = 1 if end[axis] > (row, column)[axis] else -1
                following = (row + step, column) if axis == 0 else (row, column + step)
                _join(right_open, up_open, (row, column), following)
                row, column = following
                inside[row, column] = True
    return right_open, up_open, inside


def _shortest_tree(places: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Pairs of points, (n, 2), that join all with the least sum of distances, by Prim."""
    pairs = []
    distance = np.abs(places - places[0]).sum(1)
    nearest = np.zeros(len(places), np.int64)
    joined = np.arange(len(places)) == 0
    for _ in range(len(places) - 1):
        place = int(np.where(joined, np.iinfo(np.int64).max, distance).argmin())
        pairs.append((int(nearest[place]), place))
        joined[place] = True
        farther = np.abs(places - places[place]).sum(1)
        nearest[farther < distance] = place
        distance = np.minimum(distance, farther)
    return pairs


def _walls(
    right_open: Bits,
    up_open: Bits,
    inside: Bits,
    start: NDArray[np.int32],
    cell_m: float,
    thickness_m: float,
) -> tuple[Segment, ...]:
    """The longest straight walls around all passages.

    Where walls meet at a corner, the one along x fills it, and one along y starts at its face; a
    wall that ends at another's side starts at that side. A free end extends by half a thickness.
    """
    padded = np.pad(inside, 1)
    # Along x: (rows + 1, columns), below row i; along y: (rows, columns + 1), left of column j.
    along_x = padded[:-1, 1:-1] | padded[1:, 1:-1]
    along_x[1:-1] &= ~up_open[:-1]
    along_y = padded[1:-1, :-1] | padded[1:-1, 1:]
    along_y[:, 1:-1] &= ~right_open[:, :-1]
    # For each corner, (rows + 1, columns + 1): the number of walls along each axis that end there.
    x_at, y_at = np.pad(along_x, ((0, 0), (1, 1))), np.pad(along_y, ((1, 1), (0, 0)))
    x_walls = x_at[:, :-1].astype(np.int8) + x_at[:, 1:]
    y_walls = y_at[:-1].astype(np.int8) + y_at[1:]
    x0_m, y0_m = -(int(start[1]) + 0.5) * cell_m, -(int(start[0]) + 0.5) * cell_m
    half_m = thickness_m / 2.0
    walls = []
    for line, first, last in _runs(along_x):
        low_m = x0_m + first * cell_m + (half_m if y_walls[line, first] == 2 else -half_m)
        high_m = x0_m + last * cell_m + (-half_m if y_walls[line, last] == 2 else half_m)
        walls.append(Segment((low_m + high_m) / 2.0, y0_m + line * cell_m, high_m - low_m, 0.0))
    for line, first, last in _runs(along_y.T):
        low_m = y0_m + first * cell_m + (half_m if x_walls[first, line] else -half_m)
        high_m = y0_m + last * cell_m + (-half_m if x_walls[last, line] else half_m)
        walls.append(
            Segment(x0_m + line * cell_m, (low_m + high_m) / 2.0, high_m - low_m, math.pi / 2.0)
        )
    return tuple(walls)


def _runs(lines: Bits) -> list[tuple[int, int, int]]:
    """(line, first, last + 1) of each unbroken run of True along the lines, in their order."""
    edges = np.diff(np.pad(lines, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    line, first = np.nonzero(edges == 1)
    _, last = np.nonzero(edges == -1)
    return list(zip(line.tolist(), first.tolist(), last.tolist(), strict=True))
