"""Collision checks of the robot's circle along a motion: on the costmap, and with scan echoes.

The costmap has the walls but depends on the estimated pose; the echoes need no pose. A motion must
pass both checks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from services.common import portable_kernels
from services.common.frames import SE2, Array
from services.common.kernels import kernel
from services.common.world.costmap import Clearance
from services.navigation.costmap import Costmap


class Velocity(NamedTuple):
    """Velocity of base_footprint in its own frame."""

    linear_m_s: float
    angular_rad_s: float


STOP = Velocity(0.0, 0.0)

_SLACK_M = 0.01
"""Standard deviation of the lidar's noise: an echo this much nearer than before is no approach."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The robot's pose, and the obstacles around it."""

    map_from_base: SE2
    costmap: Costmap
    echoes_m: Array
    """(n, 2) float64, the newest scan's echoes in the robot's current base frame."""


def first_contact_s(
    around: Surroundings, velocity: Velocity, horizon_s: float, step_s: float, echo_radius_m: float
) -> float:
    """Time until the robot's circle collides at a constant velocity; inf if it does not within the
    horizon.

    A robot that is already too near to an obstacle may move as long as it does not come nearer, so
    that it can get away.

    Args:
        around: the robot's pose, and the obstacles around it.
        velocity: held for the whole horizon.
        horizon_s: time to simulate ahead.
        step_s: time between the poses checked.
        echo_radius_m: radius of the circle that no echo may enter.
    """
    frame = around.costmap.frame
    return float(
        _first_contact_s(
            around.costmap.clearance_m,
            (around.map_from_base.x_m - frame.origin_x_m) / frame.resolution_m,
            (around.map_from_base.y_m - frame.origin_y_m) / frame.resolution_m,
            around.map_from_base.yaw_rad,
            frame.resolution_m,
            around.costmap.robot_radius_m,
            around.echoes_m,
            echo_radius_m,
            velocity.linear_m_s,
            velocity.angular_rad_s,
            horizon_s,
            step_s,
        )
    )


@kernel()
def _nearest_echo_m(echoes_m: Array, x_m: float, y_m: float) -> float:
    best = np.inf
    for i in range(len(echoes_m)):
        ahead, aside = echoes_m[i, 0] - x_m, echoes_m[i, 1] - y_m
        square = ahead * ahead + aside * aside
        best = min(best, square)
    return math.sqrt(best)


@kernel()
def _first_contact_s(
    clearance_m: Clearance,
    column: float,
    row: float,
    yaw_rad: float,
    resolution_m: float,
    robot_radius_m: float,
    echoes_m: Array,
    echo_radius_m: float,
    linear_m_s: float,
    angular_rad_s: float,
    horizon_s: float,
    step_s: float,
) -> float:
    rows, columns = clearance_m.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return 0.0
    here_map_m = clearance_m[int(row), int(column)]
    here_echo_m = _nearest_echo_m(echoes_m, 0.0, 0.0)
    cos_yaw, sin_yaw = portable_kernels.cos_sin(yaw_rad)
    for i in range(1, int(horizon_s / step_s + 0.5) + 1):
        t = i * step_s
        turn = angular_rad_s * t
        if abs(angular_rad_s) < 1e-6:
            x, y = linear_m_s * t, 0.0
        else:
            c, s = portable_kernels.cos_sin(turn)
            x = linear_m_s / angular_rad_s * s
            y = linear_m_s / angular_rad_s * (1.0 - c)
        at_column = column + (cos_yaw * x - sin_yaw * y) / resolution_m
        at_row = row + (sin_yaw * x + cos_yaw * y) / resolution_m
        if not (0 <= at_row < rows and 0 <= at_column < columns):
            return t
        map_m = clearance_m[int(at_row), int(at_column)]
        if map_m <= robot_radius_m and map_m < here_map_m:
            return t
        echo_m = _nearest_echo_m(echoes_m, x, y)
        if echo_m < echo_radius_m and echo_m < here_echo_m - _SLACK_M:
            return t
    return np.inf
