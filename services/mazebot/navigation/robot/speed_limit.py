"""The highest speed from which the robot can brake before every lower limit on its path."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.planning.path import PlannedPath

_LIMIT_DECEL_M_S2 = 0.5
"""The robot brakes this strongly before a speed limit (Nav2's max_decel of the speed filter)."""


def speed_limit_m_s(
    zones: Zones | None,
    path: PlannedPath | None,
    first: int,
    pose: SE2,
    late_m: float,
    highest_m_s: float,
) -> float:
    """The speed limit here, by the zones at the robot and along its path from the point nearest to
    it on, `first`.

    It drives `late_m` until a lower speed takes effect, and follows no path where that is None.
    """
    if zones is None:
        return math.inf
    limit_m_s = float(zones.limits_at(np.array([pose[:2]]))[0])
    if path is None:
        return limit_m_s
    # The nearest point of the path may be behind the robot.
    late_m += zones.frame.resolution_m
    ahead_m = np.maximum(path.along_m[first:] - path.along_m[first] - late_m, 0.0)
    near = ahead_m <= 0.5 * highest_m_s * highest_m_s / _LIMIT_DECEL_M_S2
    limits_m_s = zones.limits_at(path.points_m[first:][near])
    squares = limits_m_s * limits_m_s + 2.0 * _LIMIT_DECEL_M_S2 * ahead_m[near]
    return min(limit_m_s, float(np.sqrt(squares.min(initial=math.inf))))
