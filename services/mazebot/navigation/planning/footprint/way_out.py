"""How a robot leaves a place where it cannot turn: straight ahead or straight back."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.layered_costmap import Costs
from mazebot.navigation.planning.footprint.footprint_check import (
    goes_deeper,
    hits,
    start_margin_m,
    turn_hits,
)
from mazebot.navigation.planning.grid.search_grid import SOLID

LONGEST_M: Final = 0.5
"""It may not see where it drives back to, so no further."""
_STEP: Final = 0.5
"""Between two places, in cells."""


@kernel()
def ways_out(
    cells: Costs,
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    start: Array,
    longest_m: float,
) -> Array:
    """(k, 4) x, y and yaw of the start, and of places straight ahead of it and straight behind it
    where the polygon touches nothing, and the way there, below 0 where it is back; lengths in
    cells. On its way it comes no deeper into obstacles than it is at the start.

    None where it can turn at the start.

    Args:
        cells: the search grid; the middle of the axle stays out of SOLID cells.
        distance_m: of the costmap.
        resolution_m: of the costmap.
        outline_m: the footprint's points.
        circles: the footprint's circles.
        start: (x, y, yaw), in cells.
        longest_m: how far it may go.
    """
    steps = int(longest_m / (_STEP * resolution_m) + 1e-6)
    found = np.empty((1 + 2 * steps, 4))
    count, yaw = 1, start[2]
    found[0] = start[0], start[1], yaw, 0.0
    if not turn_hits(
        distance_m, resolution_m, outline_m, circles, start[0], start[1], yaw, math.tau
    ):
        return found[:0]
    c, s = portable_kernels.cos_sin(yaw)
    for sign in (1.0, -1.0):
        margin_m = start_margin_m(distance_m, resolution_m, outline_m, circles, start)
        for k in range(1, steps + 1):
            way = sign * _STEP * k
            x, y = start[0] + way * c, start[1] + way * s
            if cells[math.floor(y + 0.5), math.floor(x + 0.5)] >= SOLID:
                break
            if goes_deeper(distance_m, resolution_m, outline_m, circles, x, y, yaw, margin_m):
                break
            if hits(distance_m, resolution_m, outline_m, circles, x, y, yaw):
                continue
            margin_m = 0.0
            found[count] = x, y, yaw, way
            count += 1
    return found[:count].copy()
