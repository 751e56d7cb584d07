"""Which poses of a path collide in a costmap that do not in another one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.costmap import (
    INSCRIBED_INFLATED_OBSTACLE,
    NO_INFORMATION,
    Costmap,
    Costs,
)
from mazebot.navigation.costmap.footprint import Footprint, footprint_in_collision


def new_collisions(
    costmap: Costmap,
    before: Costmap,
    footprint: Footprint,
    points_m: Array,
    yaws_rad: Array,
    max_cost: int,
    first_only: bool,
) -> NDArray[np.int64]:
    """Indices of the poses that collide in a costmap and not in one before it, of the same frame.

    Args:
        costmap: what is where.
        before: what counts as no collision.
        footprint: the robot's, which counts where `max_cost` is at least 253.
        points_m: (n, 2) places in the costmap's frame.
        yaws_rad: (n,) or more headings.
        max_cost: a pose with this cost or more collides.
        first_only: whether to end with the first one.
    """
    frame = costmap.frame
    return _new_collisions(
        costmap.costs, costmap.distance_m, before.costs, before.distance_m, frame.resolution_m,
        frame.origin_x_m, frame.origin_y_m, footprint.points_m, footprint.circles,
        np.ascontiguousarray(points_m), np.ascontiguousarray(yaws_rad), max_cost, first_only,
    )  # fmt: skip


@kernel()
def _new_collisions(
    costs: Costs,
    distance_m: Clearance,
    costs_before: Costs,
    distance_before_m: Clearance,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    outline_m: Array,
    circles: Array,
    points_m: Array,
    yaws_rad: Array,
    max_cost: int,
    first_only: bool,
) -> NDArray[np.int64]:
    found = np.empty(len(points_m), np.int64)
    count = 0
    for i in range(len(points_m)):
        column = (points_m[i, 0] - origin_x_m) / resolution_m
        row = (points_m[i, 1] - origin_y_m) / resolution_m
        c, s = portable_kernels.cos_sin(yaws_rad[i])
        if not _collides(
            costs, distance_m, resolution_m, outline_m, circles, column, row, c, s, max_cost
        ):
            continue
        if _collides(
            costs_before, distance_before_m, resolution_m, outline_m, circles, column, row, c, s,
            max_cost,
        ):  # fmt: skip
            continue
        found[count] = i
        count += 1
        if first_only:
            break
    return found[:count].copy()


@kernel()
def _collides(
    costs: Costs,
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
    max_cost: int,
) -> bool:
    rows, columns = costs.shape
    cost = NO_INFORMATION
    if 0.0 <= row < rows and 0.0 <= column < columns:
        cost = costs[int(row), int(column)]
    if max_cost < INSCRIBED_INFLATED_OBSTACLE:
        return cost >= max_cost
    if cost >= INSCRIBED_INFLATED_OBSTACLE:
        return True
    return footprint_in_collision(
        distance_m, resolution_m, outline_m, circles, column, row, cos_yaw, sin_yaw, 0.0
    )
