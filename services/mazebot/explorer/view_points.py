"""View points: places from where the robot sees what lies behind the frontiers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Cells, Mask
from mazebot.explorer.floor import Floor
from mazebot.explorer.frontiers import Frontier
from mazebot.explorer.paths import FAR, Distances

Indices = NDArray[np.int64]
Seen = NDArray[np.bool_]

_PART_M: Final = 1.5
"""A frontier is looked at in parts of about this extent."""
_MOST_TARGETS: Final = 24
"""Of a part's cells, so many are looked at, spread evenly."""
_SIGHT_SHARE: Final = 0.6
"""A part is seen from where this share of its targets is."""
_GUESSED_M: Final = 0.3
"""So much of what is unknown before a target is taken for free."""
_NEARER: Final = 0.7
"""What is not seen from one place though it should be is looked at from this share of the distance.
"""
_SAME_M: Final = 0.5
"""A target that has moved by less is the same one."""
_BESIDE_CELLS: Final = 1.8
"""A line of sight keeps so far from occupied cells: beams that graze a wall are not counted on."""
_STRIDE: Final = 2
"""Every so many coarse cells, one is tried as a view point."""
_TIGHT_COST: Final = 100
"""A view point with less clearance than wanted is taken if it is nearer by as many cells."""


@dataclass(frozen=True)
class Vain:
    """A target that was not seen from where it should have been."""

    target_m: tuple[float, float]
    """(x, y) in the map."""
    reach_m: float
    """From how near it is to be looked at."""


@dataclass(frozen=True, eq=False)
class ViewPoint:
    """A place to go to, and what it is for."""

    index: int
    """Of the coarse cell from where the frontiers are seen, row by row."""
    cost: int
    """Of the way there from the robot, see `paths.search`."""
    parts: list[Part] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a frontier that is seen as one."""

    frontier: int
    """Index in the list of frontiers."""
    cells: Indices
    """(n, 2) row and column of unknown cells."""

    def targets(self) -> Indices:
        """Up to 24 of its cells, spread evenly."""
        return np.ascontiguousarray(self.cells[:: -(-len(self.cells) // _MOST_TARGETS)])

    def middle(self) -> tuple[int, int]:
        """The one of its cells nearest to their mean."""
        offsets = np.abs(self.cells - self.cells.mean(0)).sum(1)
        row, column = self.cells[int(np.argmin(offsets))]
        return int(row), int(column)


def nearer(
    vain: list[Vain], target_m: tuple[float, float], from_m: tuple[float, float]
) -> list[Vain]:
    """What was looked at in vain, with a target that was not seen from a place."""
    reach_m = math.dist(target_m, from_m)
    for one in vain:
        if math.dist(one.target_m, target_m) < _SAME_M:
            reach_m = min(reach_m, one.reach_m)
    return [*vain, Vain(target_m, max(_NEARER * reach_m, _GUESSED_M))]


@kernel("boolean(int8[:, ::1], boolean[:, ::1], float64, float64, int64, int64, float64)")
def sees(
    cells: Cells, blocks: Mask, from_row: float, from_column: float, row: int, column: int,
    guessed: float,
) -> bool:  # fmt: skip
    """Whether a straight line from a point to a cell meets nothing that blocks it, and nothing
    unknown farther than `guessed` cells before it. Positions in cells, centres at whole numbers.
    """
    down, right = row - from_row, column - from_column
    length = math.sqrt(down * down + right * right)
    steps = int(length * 2.0) + 1
    for i in range(steps):
        share = i / steps
        r = math.floor(from_row + down * share + 0.5)
        c = math.floor(from_column + right * share + 0.5)
        if r < 0 or c < 0 or r >= cells.shape[0] or c >= cells.shape[1]:
            return False
        if blocks[r, c] or (cells[r, c] < 0 and (1.0 - share) * length > guessed):
            return False
    return True


@kernel("int64(int8[:, ::1], boolean[:, ::1], int64[:, ::1], float64, float64, float64, float64)")
def _seen_from(
    cells: Cells, blocks: Mask, targets: Indices, row: float, column: float, range_cells: float,
    guessed: float,
) -> int:  # fmt: skip
    """How many targets are seen from a point."""
    seen = 0
    for t in range(targets.shape[0]):
        down, right = targets[t, 0] - row, targets[t, 1] - column
        if down * down + right * right <= range_cells * range_cells:
            seen += sees(cells, blocks, row, column, targets[t, 0], targets[t, 1], guessed)
    return seen


@kernel(
    "int64(int8[:, ::1], boolean[:, ::1], int64[:, ::1], int64[::1], float64[:, ::1], float64, "
    "float64, int64)"
)
def _nearest_view(
    cells: Cells, blocks: Mask, targets: Indices, order: Indices, places: NDArray[np.float64],
    range_cells: float, guessed: float, needed: int,
) -> int:  # fmt: skip
    """The first candidate in an order of rising costs that sees as many targets as needed; else the
    one that sees most of them, -1 if none sees any.
    """
    best, most = -1, 0
    count = targets.shape[0]
    for k in range(order.size):
        place = order[k]
        row, column = places[place, 0], places[place, 1]
        seen = 0
        for t in range(count):
            if seen + count - t <= most:
                break
            down, right = targets[t, 0] - row, targets[t, 1] - column
            if down * down + right * right > range_cells * range_cells:
                continue
            if sees(cells, blocks, row, column, targets[t, 0], targets[t, 1], guessed):
                seen += 1
        if seen > most:
            best, most = int(place), seen
            if seen >= needed:
                break
    return best


def parts_of(frontiers: list[Frontier], resolution_m: float) -> list[Part]:
    """The frontiers in pieces that one look may show: each begins at the first cell left, and takes
    what is left nearby.
    """
    parts = []
    reach = _PART_M / resolution_m / 2.0
    for number, frontier in enumerate(frontiers):
        left = frontier.cells
        while len(left):
            offsets = left - left[0]
            # From an end of the frontier, so that no scraps are left in the middle.
            end = left[int(np.argmax((offsets * offsets).sum(1)))]
            offsets = left - end
            near = (offsets * offsets).sum(1) <= (2.0 * reach) * (2.0 * reach)
            parts.append(Part(number, np.ascontiguousarray(left[near])))
            left = left[~near]
    return parts


def view_points(
    floor: Floor, robot: tuple[float, float], distances: Distances, frontiers: list[Frontier],
    clearance_m: float, range_m: float, vain: list[Vain],
) -> tuple[list[ViewPoint], list[int], list[Vain]]:  # fmt: skip
    """For each part of the frontiers the cheapest place to go to that sees most of it; those that
    see several parts are for all of them. In the order of their costs.

    Args:
        floor: the map from where the robot is.
        robot: row and column of where it is, in cells, centres at whole numbers.
        distances: costs of the ways from the robot to the coarse cells.
        frontiers: what is to be seen.
        clearance_m: wanted at a view point; less is taken where there is no such place nearby.
        range_m: how far the robot sees.
        vain: what was looked at in vain before.

    Returns the view points, the indices of the frontiers that cannot be seen from anywhere, and
    what has been looked at in vain by now.
    """
    if not frontiers:
        return [], [], []
    columns = int(floor.prices.shape[1])
    near = distances < FAR
    candidates = np.flatnonzero(near)
    row, column = np.divmod(candidates, columns)
    tried = (row % _STRIDE == 0) & (column % _STRIDE == 0)
    tried |= floor.coarse_clearance_m.reshape(-1)[candidates] < clearance_m
    candidates = candidates[tried]
    costs = distances.reshape(-1)[candidates].copy()
    tight = floor.coarse_clearance_m.reshape(-1)[candidates] < clearance_m
    in_gap = floor.coarse_clearance_m.reshape(-1)[candidates] <= floor.radius_m
    ranking = costs.astype(np.int64) + np.where(tight, _TIGHT_COST * 10, 0) + in_gap * FAR
    rows, columns_of = np.divmod(candidates, columns)
    middle = (floor.factor - 1) / 2.0
    places = np.stack([rows * floor.factor + middle, columns_of * floor.factor + middle], 1)
    order = np.argsort(ranking, kind="stable")
    places, costs, candidates = places[order], costs[order], candidates[order]
    blocks = np.ascontiguousarray(floor.clearance_m < _BESIDE_CELLS * floor.resolution_m)
    range_cells, guessed = range_m / floor.resolution_m, _GUESSED_M / floor.resolution_m
    found: list[tuple[int, int, Part, float]] = []
    unseen = set(range(len(frontiers)))
    looked: list[Vain] = []
    for part in parts_of(frontiers, floor.resolution_m):
        targets = part.targets()
        lowest, highest = targets.min(0) - range_cells, targets.max(0) + range_cells
        inside = np.flatnonzero(((places >= lowest) & (places <= highest)).all(1))
        needed = math.ceil(_SIGHT_SHARE * len(targets))
        here = _seen_from(floor.cells, blocks, targets, robot[0], robot[1], range_cells, guessed)
        reach_m, target_m = range_m, floor.center(*part.middle())
        for one in vain:
            if math.dist(one.target_m, target_m) < _SAME_M:
                reach_m = min(reach_m, one.reach_m)
        if here >= needed:
            # It should be known already: it has to be looked at from nearer.
            away_m = math.dist(target_m, floor.center(*robot))
            reach_m = max(min(_NEARER * away_m, reach_m), _GUESSED_M)
        if reach_m < range_m:
            looked.append(Vain(target_m, reach_m))
        reach = reach_m / floor.resolution_m
        best = _nearest_view(floor.cells, blocks, targets, inside, places, reach, guessed, needed)
        if best >= 0:
            found.append((int(costs[best]), int(candidates[best]), part, reach))
            unseen.discard(part.frontier)
    return _merged(floor, blocks, found, guessed), sorted(unseen), looked


def _merged(
    floor: Floor, blocks: Mask, found: list[tuple[int, int, Part, float]], guessed: float
) -> list[ViewPoint]:
    """One view point for the parts that are seen from one."""
    columns = int(floor.prices.shape[1])
    middle = (floor.factor - 1) / 2.0
    points: list[ViewPoint] = []
    for cost, index, part, reach in sorted(found, key=lambda one: one[:2]):
        targets = part.targets()
        for point in points:
            row, column = divmod(point.index, columns)
            r, c = row * floor.factor + middle, column * floor.factor + middle
            seen = _seen_from(floor.cells, blocks, targets, r, c, reach, guessed)
            if seen >= _SIGHT_SHARE * len(targets):
                point.parts.append(part)
                break
        else:
            points.append(ViewPoint(index, cost, [part]))
    return points
