"""A controller of your own: pure pursuit, which drives arcs to a point ahead on the path.

    mazebot demo --world original --no-camera --controller examples/pure_pursuit.py:PurePursuit

docs/controllers.md explains the interface. `PathFollower` keeps the path and turns at the goal;
this class only says how to drive along it.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from mazebot.plugins import (
    SE2,
    ControllerParams,
    PathFollower,
    PlannedPath,
    Robot,
    Surroundings,
    Velocity,
)

HALF_WIDTH_M = 0.17
"""Half of the robot's width, and a little more."""
FRONT_M = 0.15
"""From the middle between the wheels to the robot's front."""


class PurePursuitParams(ControllerParams):
    """Its parameters, with their limits; they may be set in a settings file."""

    speed: float = Field(0.25, gt=0, le=0.46, description="m/s; on a straight path")
    turn_speed: float = Field(1.0, gt=0, le=1.9, description="rad/s; on the spot")
    lookahead: float = Field(0.35, gt=0.1, lt=1.0, description="m; along the path")
    turn_first: float = Field(0.8, gt=0, lt=3.2, description="rad; more than this: turn first")
    stop_distance: float = Field(0.12, ge=0, description="m; stop before an obstacle ahead")


class PurePursuit(PathFollower):
    """Drives on the circle that touches its heading and meets the point ahead."""

    Params = PurePursuitParams

    def __init__(
        self, params: PurePursuitParams, robot: Robot, random: np.random.Generator
    ) -> None:
        super().__init__(robot, params.turn_speed, robot.limits.max_angular_accel)
        self.params = params
        self.robot = robot

    def _begin(self) -> None:
        """Nothing is kept from one path to the next."""

    def _drive(
        self, elapsed_s: float, around: Surroundings, path: PlannedPath
    ) -> tuple[Velocity, bool]:
        """The velocity, and whether the way is blocked."""
        along_m = path.along_m[self.index] + self.params.lookahead
        x_m, y_m = path.point_at(along_m)
        # The point in the robot's frame: x ahead, y to the left.
        ahead = around.map_from_base.inverse() @ SE2(x_m, y_m, 0.0)
        angle_rad = math.atan2(ahead.y_m, ahead.x_m)
        blocked = False
        if abs(angle_rad) > self.params.turn_first:
            wanted = Velocity(0.0, math.copysign(self.params.turn_speed, angle_rad))
        elif self._obstacle_ahead(around):
            wanted, blocked = Velocity(0.0, 0.0), True
        else:
            # A circle through the robot and the point has this curvature.
            curvature_per_m = 2.0 * ahead.y_m / (ahead.x_m**2 + ahead.y_m**2)
            left_m = path.length_m - path.along_m[self.index]
            speed_m_s = min(self.params.speed, around.speed_limit_m_s, 0.05 + 0.5 * left_m)
            # Slower in bends, so that the turn stays below the robot's limit.
            speed_m_s /= 1.0 + 0.3 * abs(curvature_per_m)
            wanted = Velocity(speed_m_s, speed_m_s * curvature_per_m)
        return self.robot.limited(wanted, self.velocity, elapsed_s), blocked

    def _obstacle_ahead(self, around: Surroundings) -> bool:
        """Whether a point of the scan lies in the strip before the robot."""
        x_m, y_m = around.echoes_m.T
        reach_m = FRONT_M + self.params.stop_distance
        return bool(((x_m > 0.0) & (x_m < reach_m) & (np.abs(y_m) < HALF_WIDTH_M)).any())
