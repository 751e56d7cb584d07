"""A controller of your own: follow the wall on the right, by the scan alone.

    mazebot demo --world original --controller examples/wall_follower.py:WallFollower

It drives until it comes by the goal, if ever. docs/controllers.md explains the interface.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from mazebot.plugins import ControllerParams, PathlessController, Surroundings, Velocity


class WallFollowerParams(ControllerParams):
    """Its parameters, with their limits; they may be set in a settings file."""

    distance: float = Field(0.45, gt=0.25, lt=1.0, description="m; from the wall on the right")
    goal_distance: float = Field(0.5, gt=0, description="m; nearer to the goal than this it ends")
    speed: float = Field(0.2, gt=0, le=0.46, description="m/s; along a straight wall")


class WallFollower(PathlessController):
    """Keeps its distance from the nearest thing to its right, and turns left before a wall."""

    Params = WallFollowerParams
    params: WallFollowerParams

    def arrived(self, to_goal_m: float) -> bool:
        """Whether it has come by the goal."""
        return to_goal_m < self.params.goal_distance

    def command(self, around: Surroundings) -> Velocity:
        """`around.echoes_m` are the scan's points now, (n, 2): x ahead and y to the left."""
        x_m, y_m = around.echoes_m.T
        ahead_m = x_m[(np.abs(y_m) < 0.25) & (x_m > 0.0)]
        # To the right and a little ahead, so that it turns before it is too near.
        right_m = np.hypot(x_m, y_m)[(y_m < 0.0) & (x_m > 0.2 * y_m) & (x_m < -1.5 * y_m)]
        if len(ahead_m) and ahead_m.min() < self.params.distance:
            return Velocity(0.0, 1.0)
        # Where the wall has ended, the turn to the right leads round its corner.
        missing_m = self.params.distance - (right_m.min() if len(right_m) else 1.0)
        turn_rad_s = float(np.clip(2.0 * missing_m, -0.7, 0.9))
        return Velocity(self.params.speed if abs(turn_rad_s) < 0.5 else 0.12, turn_rad_s)
