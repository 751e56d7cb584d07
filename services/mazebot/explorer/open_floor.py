"""Open floor: where the exploration of a place without walls around it ends."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import OCCUPIED, Cells, Mask, reachable_from
from mazebot.explorer.floor import Floor
from mazebot.explorer.params import ExplorerParams
from mazebot.explorer.view_points import Part

_RAYS: Final = 32
_KNOWN_SHARE: Final = 0.7
_OUTDOORS_FREE_SHARE, _OUTDOORS_HIT_SHARE = 0.15, 0.5
"""A place is outdoors if in at least the first share of all directions no wall is known as far as
the lidar sees, and the floor is known to be free for most of that, which along a corridor and
through a door it is in narrow ones; and if less than the second share ends at a wall.
"""


@kernel("void(int8[:, ::1], float64, float64, float64, float64[:, ::1], int64[::1])")
def _look_around(
    cells: Cells, row: float, column: float, range_cells: float, rays: NDArray[np.float64],
    counts: NDArray[np.int64],
) -> None:  # fmt: skip
    """Count the rays that end at an obstacle, and those of the others that begin in known floor."""
    rows, columns = cells.shape
    counts[:] = 0
    for i in range(rays.shape[0]):
        free, hit = True, False
        for step in range(1, int(range_cells) + 1):
            r = math.floor(row + rays[i, 1] * step + 0.5)
            c = math.floor(column + rays[i, 0] * step + 0.5)
            inside = 0 <= r < rows and 0 <= c < columns
            if inside and cells[r, c] > 0:
                hit = True
                break
            if step <= _KNOWN_SHARE * range_cells and (not inside or cells[r, c] < 0):
                free = False
        if hit:
            counts[0] += 1
        elif free:
            counts[1] += 1


@cache
def _rays() -> NDArray[np.float64]:
    """(n, 2) directions all around."""
    return np.array([portable.cos_sin(2.0 * math.pi * i / _RAYS) for i in range(_RAYS)])


def is_outdoors(floor: Floor, part: Part, range_m: float) -> bool:
    """Whether a part of a frontier has few walls around it, as far as is known.

    Args:
        floor: the map from where the robot is.
        part: the part.
        range_m: how far the lidar sees.
    """
    row, column = part.middle()
    counts = np.empty(2, np.int64)
    _look_around(
        floor.cells, float(row), float(column), range_m / floor.resolution_m, _rays(), counts
    )
    hits, free = counts.tolist()
    return free >= _OUTDOORS_FREE_SHARE * _RAYS and hits < _OUTDOORS_HIT_SHARE * _RAYS


class Limits:
    """Which parts of frontiers are worth driving to, on one map."""

    def __init__(self, params: ExplorerParams, floor: Floor, home: SE2) -> None:
        self._params, self._floor, self._home = params, floor, home
        self._has_structure = bool((floor.cells >= OCCUPIED).any())
        self._outside: Mask | None = None

    def is_open(self, part: Part) -> bool:
        """Whether it is open floor: farther from everything seen than `open_distance`, and not
        surrounded by what is known. Before anything is seen, twice as far from the start.
        """
        limit_m = self._params.open_distance
        if limit_m == 0.0:
            return False
        if not self._has_structure:
            return self._from_home_m(part) > 2.0 * limit_m
        targets = part.targets()
        nearest_m = float(self._floor.clearance_m[targets[:, 0], targets[:, 1]].min())
        return nearest_m > limit_m and self._is_outside(part)

    def is_far(self, part: Part) -> bool:
        """Whether it is farther from the start than `max_distance`."""
        limit_m = self._params.max_distance
        return limit_m > 0.0 and self._from_home_m(part) > limit_m

    def _from_home_m(self, part: Part) -> float:
        return math.dist(self._floor.center(*part.middle()), self._home[:2])

    def _is_outside(self, part: Part) -> bool:
        """Whether what is unknown there goes on to the edge of the map."""
        if self._outside is None:
            # A map is padded by unknown cells.
            self._outside = reachable_from(np.asarray(self._floor.cells < 0), 0, 0)
        # Between the rays at the border, single cells are unknown too.
        return bool(self._outside[part.cells[:, 0], part.cells[:, 1]].any())
