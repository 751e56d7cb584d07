"""What the robot knows of itself and of its surroundings at one step."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.behavior.context import BatteryCharge
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.control.track import Track


@dataclass(frozen=True, slots=True)
class View:
    """The newest measurements, moved to the time of the step."""

    now_ns: int
    map_from_base: SE2 | None
    """None: it is not localized."""
    odom_from_base: SE2
    velocity: Velocity
    echoes_m: Array
    """(n, 2) float64, the newest scan's echoes in the current base frame, and after them what is
    hidden from the lidar."""
    tracks: tuple[Track, ...] = ()
    teleop: Velocity | None = None
    turning: tuple[Track, ...] = ()
    """Obstacles that stand and are expected to turn back."""
    hidden: int = 0
    """How many of the last echoes are of what the lidar does not show."""
    is_heard: bool = True
    """Whether commands reach the robot in time, as far as is known."""
    battery: BatteryCharge | None = None
    is_suspect: bool = False
    """Whether scans contradict the pose, which may turn out wrong."""
    slows_down: bool = False
    """Whether a sensor that it could do without is silent."""
    pose_std: tuple[float, float] = (math.inf, math.inf)
    """Of the position along each axis, m, and of the heading, rad; infinite: not known."""

    @property
    def scanned_m(self) -> Array:
        """(n, 2) the lidar's echoes alone."""
        return self.echoes_m[: len(self.echoes_m) - self.hidden]

    @property
    def hidden_m(self) -> Array:
        """(n, 2) the others."""
        return self.echoes_m[len(self.echoes_m) - self.hidden :]
