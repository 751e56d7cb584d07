"""Whether the robot's polygon can be driven along a path: swept along its segments, and turned on
the spot at its corners.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.costmap.footprint import footprint_clearance_m, footprint_in_collision

CLEAR: Final = -1
_TURN_RAD = 0.1
"""Between two examined headings of a turn: the corner of a waffle moves by 2.4 cm."""
_STEP = 0.5
"""Between two examined places, in cells."""
_SLACK_M: Final = 0.005
"""By how much it may come nearer to what it touches at the start: the map's cells are 5 cm."""


@kernel(
    "boolean(float32[:, ::1], float64, float64[:, ::1], float64[::1], float64, float64, float64)"
)
def hits(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    x: float,
    y: float,
    yaw_rad: float,
) -> bool:
    """Whether the polygon touches an obstacle at a pose; x and y in cells of the search grid."""
    c, s = portable_kernels.cos_sin(yaw_rad)
    return footprint_in_collision(
        distance_m, resolution_m, outline_m, circles, x - 0.5, y - 0.5, c, s, 0.0
    )


@kernel()
def start_margin_m(
    distance_m: Clearance, resolution_m: float, outline_m: Array, circles: Array, start: Array
) -> float:
    """The clearance with which the polygon counts as no deeper in an obstacle than at a start,
    (x, y, yaw) in cells; 0 where it touches nothing there.
    """
    c, s = portable_kernels.cos_sin(start[2])
    clearance_m = footprint_clearance_m(
        distance_m, resolution_m, outline_m, circles, start[0] - 0.5, start[1] - 0.5, c, s
    )
    return 0.0 if clearance_m > 0.0 else clearance_m - _SLACK_M


@kernel()
def goes_deeper(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    x: float,
    y: float,
    yaw_rad: float,
    margin_m: float,
) -> bool:
    """As `hits`, where the clearance may be as low as a margin of 0 or less."""
    c, s = portable_kernels.cos_sin(yaw_rad)
    return footprint_in_collision(
        distance_m, resolution_m, outline_m, circles, x - 0.5, y - 0.5, c, s, margin_m
    )


@kernel()
def turn_hits(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    x: float,
    y: float,
    from_rad: float,
    by_rad: float,
) -> bool:
    """Whether the polygon touches an obstacle while it turns on the spot, its end included."""
    parts = max(1, math.ceil(abs(by_rad) / _TURN_RAD))
    for k in range(1, parts + 1):
        if hits(distance_m, resolution_m, outline_m, circles, x, y, from_rad + by_rad * k / parts):
            return True
    return False


@kernel()
def difference_rad(to_rad: float, from_rad: float) -> float:
    """The shorter turn between two headings."""
    by = to_rad - from_rad
    return by - math.floor(by / math.tau + 0.5) * math.tau


@kernel()
def can_turn(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    x: float,
    y: float,
    from_rad: float,
    to_rad: float,
) -> bool:
    """Whether it can turn on the spot, one way or the other."""
    by = difference_rad(to_rad, from_rad)
    if not turn_hits(distance_m, resolution_m, outline_m, circles, x, y, from_rad, by):
        return True
    by -= math.copysign(math.tau, by)
    return not turn_hits(distance_m, resolution_m, outline_m, circles, x, y, from_rad, by)


@kernel()
def first_obstruction(
    distance_m: Clearance,
    resolution_m: float,
    outline_m: Array,
    circles: Array,
    points: Array,
    start_yaw_rad: float,
    goal_yaw_rad: float,
    margin_m: float,
) -> tuple[int, bool]:
    """The first of (n, 2) points at which the polygon cannot go on, driving forwards, and whether
    that is for a turn on the spot; (CLEAR, False) if it gets to the goal's heading.

    Where it touches an obstacle at the start, it may not turn before it is clear, and come as near
    as `start_margin_m`; a margin of -inf lets it out any way.
    """
    n = len(points)
    yaw, free = start_yaw_rad, False
    for i in range(n - 1):
        x, y = points[i, 0], points[i, 1]
        dx, dy = points[i + 1, 0] - x, points[i + 1, 1] - y
        length = math.sqrt(dx * dx + dy * dy)
        if length < 1e-9:
            continue
        ahead = portable_kernels.atan2(dy, dx)
        if not free:
            free = not hits(distance_m, resolution_m, outline_m, circles, x, y, yaw)
        by = difference_rad(ahead, yaw)
        if not free and abs(by) > _TURN_RAD and margin_m > -np.inf:
            return i, True
        # Headings of a rounded path differ by less than is between two examined ones.
        if free and abs(by) > 1e-6:
            if i == 0 or abs(by) > _TURN_RAD:
                if not can_turn(distance_m, resolution_m, outline_m, circles, x, y, yaw, ahead):
                    return i, True
            elif hits(distance_m, resolution_m, outline_m, circles, x, y, ahead):
                return i, False
        yaw = ahead
        parts = max(1, math.ceil(length / _STEP))
        for k in range(1, parts + 1):
            at_x, at_y = x + dx * k / parts, y + dy * k / parts
            if hits(distance_m, resolution_m, outline_m, circles, at_x, at_y, yaw):
                if free or goes_deeper(
                    distance_m, resolution_m, outline_m, circles, at_x, at_y, yaw, margin_m
                ):
                    return i, False
            else:
                free = True
    x, y = points[n - 1, 0], points[n - 1, 1]
    if not can_turn(distance_m, resolution_m, outline_m, circles, x, y, yaw, goal_yaw_rad):
        return n - 1, True
    return CLEAR, False
