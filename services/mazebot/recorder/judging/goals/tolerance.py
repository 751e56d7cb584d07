"""How near a goal the true pose must be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from mazebot.common.config import value_of

_CHECKER = "controller_server.general_goal_checker"
_LOCALISATION_M, _LOCALISATION_RAD = 0.19, 0.19
"""What the estimate by which navigation checks a goal may be off the true pose."""


class GoalTolerance(NamedTuple):
    """How far the true pose may be from a goal; by default that of navigation's defaults, and what
    its estimate may be off.
    """

    xy_m: float = 0.25
    yaw_rad: float = 0.25
    is_symmetric: bool = False
    """Whether the opposite heading will do."""

    def holds(self, error_m: float, error_rad: float) -> bool:
        """Whether a pose so far from the goal, turned by 0 to pi from it, is at it."""
        if self.is_symmetric:
            error_rad = min(error_rad, math.pi - error_rad)
        return error_m <= self.xy_m and error_rad <= self.yaw_rad


def tolerance_of(navigation: Mapping[str, Any]) -> GoalTolerance:
    """The tolerance by navigation's parameters; what they do not tell is as by default."""

    def number(name: str, allowed: float, default: float) -> float:
        value = value_of(navigation, f"{_CHECKER}.{name}")
        return value + allowed if isinstance(value, int | float) and value > 0.0 else default

    default = GoalTolerance()
    xy_m = number("xy_goal_tolerance", _LOCALISATION_M, default.xy_m)
    yaw_rad = number("yaw_goal_tolerance", _LOCALISATION_RAD, default.yaw_rad)
    if value_of(navigation, f"{_CHECKER}.position_only") is True:
        yaw_rad = math.inf
    is_symmetric = value_of(navigation, f"{_CHECKER}.symmetric_yaw_tolerance") is True
    return GoalTolerance(xy_m, yaw_rad, is_symmetric)
