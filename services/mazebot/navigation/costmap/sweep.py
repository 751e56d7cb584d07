"""When the footprint, moving at a constant velocity, first touches something: on a costmap, and
among points such as a scan's echoes.

Both follow the whole arc, also of a turn on the spot. What touches the robot already is no contact
as long as it comes no deeper, so that the robot can get away.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import shared_kernel
from mazebot.navigation.costmap.footprint import (
    Distance,
    footprint_clearance_m,
    signed_distance_m,
)

_STRAIGHT_RAD_S: Final = 1e-6
"""A slower turn counts as none."""
_FINEST: Final = 0.125
"""Least movement of the outline between two poses examined, in cells."""
_TOUCHING_M: Final = 1e-6
_STEP_S: Final = 0.05
"""Between the poses examined for points that touch already."""


@shared_kernel()
def first_contact_costmap_s(
    distance_m: Distance,
    resolution_m: float,
    points_m: Array,
    circles: Array,
    column: float,
    row: float,
    yaw_rad: float,
    linear_m_s: float,
    angular_rad_s: float,
    horizon_s: float,
    slack_m: float,
) -> float:
    """Time until the polygon at a pose in cells touches an obstacle; inf if not within the horizon.

    Each step is as long as the clearance allows, and at least an eighth of a cell, by which the
    contact may be reported late.

    Args:
        distance_m: (rows, columns), distance of cell centres from obstacles.
        resolution_m: side of a cell.
        points_m: `Footprint.points_m`.
        circles: `Footprint.circles`.
        column: of base_footprint, from the corner of cell (0, 0).
        row: likewise.
        yaw_rad: of base_footprint.
        linear_m_s: forward speed.
        angular_rad_s: turning speed, counter-clockwise.
        horizon_s: time to look ahead.
        slack_m: an obstacle inside the polygon may come deeper by this.
    """
    farthest_m = math.sqrt(circles[0] * circles[0] + circles[1] * circles[1]) + circles[3]
    speed_m_s = abs(linear_m_s) + abs(angular_rad_s) * farthest_m
    cos_yaw, sin_yaw = portable_kernels.cos_sin(yaw_rad)
    here_m = footprint_clearance_m(
        distance_m, resolution_m, points_m, circles, column, row, cos_yaw, sin_yaw
    )
    if speed_m_s <= 0.0:
        return np.inf
    least_m = here_m - slack_m if here_m <= 0.0 else 0.0
    t = 0.0
    while True:
        t += float(max(here_m, _FINEST * resolution_m) / speed_m_s)
        if t > horizon_s:
            return np.inf
        x, y, cos_turn, sin_turn = moved(linear_m_s, angular_rad_s, t)
        here_m = footprint_clearance_m(
            distance_m,
            resolution_m,
            points_m,
            circles,
            column + (cos_yaw * x - sin_yaw * y) / resolution_m,
            row + (sin_yaw * x + cos_yaw * y) / resolution_m,
            cos_yaw * cos_turn - sin_yaw * sin_turn,
            sin_yaw * cos_turn + cos_yaw * sin_turn,
        )
        if here_m > 0.0:
            least_m = 0.0
        elif here_m <= least_m:
            return t


@shared_kernel()
def first_contact_points_s(
    obstacles_m: Array,
    points_m: Array,
    linear_m_s: float,
    angular_rad_s: float,
    horizon_s: float,
    slack_m: float,
    contacts_s: Array,
) -> int:
    """Times until points enter the polygon, exact; number of those that do within the horizon.

    Args:
        obstacles_m: (n, 2), in base_footprint.
        points_m: `Footprint.points_m`.
        linear_m_s: forward speed.
        angular_rad_s: turning speed, counter-clockwise.
        horizon_s: time to look ahead.
        slack_m: a point inside the polygon may come deeper by this.
        contacts_s: (n,), is given the time of each point, inf for none.
    """
    turns = abs(angular_rad_s) > _STRAIGHT_RAD_S
    centre_y = linear_m_s / angular_rad_s if turns else 0.0
    near_m, far_m, low_m, high_m = _swept(points_m, centre_y, turns)
    found = 0
    for i in range(len(obstacles_m)):
        x, y = obstacles_m[i, 0], obstacles_m[i, 1]
        contacts_s[i] = np.inf
        if turns:
            radius2 = x * x + (y - centre_y) * (y - centre_y)
            if radius2 > far_m * far_m or radius2 < near_m * near_m:
                continue
        elif y < low_m or y > high_m:
            continue
        outside_m = signed_distance_m(points_m, x, y)
        if outside_m <= _TOUCHING_M:
            t = _deeper_s(points_m, x, y, outside_m - slack_m, linear_m_s, angular_rad_s, horizon_s)
        elif turns:
            t = _arc_contact_s(points_m, x, y, centre_y, angular_rad_s)
        else:
            t = _straight_contact_s(points_m, x, y, linear_m_s)
        if t <= horizon_s:
            contacts_s[i] = t
            found += 1
    return found


@shared_kernel(inline=True)
def moved(linear_m_s: float, angular_rad_s: float, t: float) -> tuple[float, float, float, float]:
    """x, y, cosine and sine of the pose after a time, seen from the first."""
    if abs(angular_rad_s) <= _STRAIGHT_RAD_S:
        return linear_m_s * t, 0.0, 1.0, 0.0
    c, s = portable_kernels.cos_sin(angular_rad_s * t)
    radius_m = linear_m_s / angular_rad_s
    return radius_m * s, radius_m * (1.0 - c), c, s


@shared_kernel()
def _swept(points_m: Array, centre_y: float, turns: bool) -> tuple[float, float, float, float]:
    """Least and greatest distance of the polygon from the centre of the turn; its range in y."""
    near_m = max(signed_distance_m(points_m, 0.0, centre_y), 0.0) if turns else 0.0
    far2, low_m, high_m = 0.0, np.inf, -np.inf
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        far2 = max(far2, x * x + (y - centre_y) * (y - centre_y))
        low_m, high_m = min(low_m, y), max(high_m, y)
    return near_m, math.sqrt(far2), low_m, high_m


@shared_kernel()
def _straight_contact_s(points_m: Array, x: float, y: float, linear_m_s: float) -> float:
    """Until a point outside, which moves along the x axis of the robot, crosses an edge."""
    first = np.inf
    for i in range(len(points_m)):
        j = i + 1 if i + 1 < len(points_m) else 0
        ay, by = points_m[i, 1], points_m[j, 1]
        if ay == by or y < min(ay, by) or y > max(ay, by):
            continue
        crossing = points_m[i, 0] + (points_m[j, 0] - points_m[i, 0]) * ((y - ay) / (by - ay))
        t = (x - crossing) / linear_m_s
        if t >= 0.0:
            first = min(first, t)
    return first


@shared_kernel()
def _arc_contact_s(
    points_m: Array, x: float, y: float, centre_y: float, angular_rad_s: float
) -> float:
    """Until a point outside, which turns the other way about the centre, crosses an edge."""
    radius2 = x * x + (y - centre_y) * (y - centre_y)
    start_rad = portable_kernels.atan2(y - centre_y, x)
    least_rad = np.inf
    for i in range(len(points_m)):
        j = i + 1 if i + 1 < len(points_m) else 0
        ax, ay = points_m[i, 0], points_m[i, 1] - centre_y
        ex, ey = points_m[j, 0] - points_m[i, 0], points_m[j, 1] - points_m[i, 1]
        # |a + s e| = radius.
        square, half = ex * ex + ey * ey, ax * ex + ay * ey
        root = half * half - square * (ax * ax + ay * ay - radius2)
        if root < 0.0:
            continue
        root = math.sqrt(root)
        for sign in (-1.0, 1.0):
            s = (sign * root - half) / square
            if not 0.0 <= s <= 1.0:
                continue
            turn_rad = start_rad - portable_kernels.atan2(ay + s * ey, ax + s * ex)
            if angular_rad_s < 0.0:
                turn_rad = -turn_rad
            if turn_rad < 0.0:
                turn_rad += math.tau
            least_rad = min(least_rad, turn_rad)
    return least_rad / abs(angular_rad_s)


@shared_kernel()
def _deeper_s(
    points_m: Array,
    x: float,
    y: float,
    least_m: float,
    linear_m_s: float,
    angular_rad_s: float,
    horizon_s: float,
) -> float:
    """Until a point that touches the polygon is deeper inside than a distance below 0."""
    inside = True
    for step in range(1, int(horizon_s / _STEP_S + 0.5) + 1):
        t = step * _STEP_S
        px, py, c, s = moved(linear_m_s, angular_rad_s, t)
        outside_m = signed_distance_m(
            points_m, c * (x - px) + s * (y - py), c * (y - py) - s * (x - px)
        )
        if outside_m > _TOUCHING_M:
            inside = False
        elif not inside or outside_m < least_m:
            return t
    return np.inf
