"""What a critic of MPPI is, and what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mazebot.navigation.control.mppi.clearance_window import ClearanceWindow
from mazebot.navigation.control.mppi.rollouts import Floats, Rollouts


@dataclass(slots=True)
class Scene:
    """What all critics of one control period see. Positions are from where the robot is now, along
    the axes of the map.
    """

    rollouts: Rollouts
    step_s: float
    costs: Floats
    """(batch,), to which each critic adds."""
    collides: NDArray[np.bool_]
    """(batch,), set by the critics of obstacles."""
    path_x_m: Floats
    path_y_m: Floats
    """(n,) points of the path ahead at even steps; the first is nearest to the robot."""
    path_free: NDArray[np.bool_]
    """(n,), whether the middle of the robot can be there."""
    spacing_m: float
    remaining_m: float
    """Length of the path that is left; infinite where the way to its end is no way straight on."""
    goal_x_m: float
    goal_y_m: float
    goal_turn_rad: float
    """The goal's yaw minus the robot's."""
    window: ClearanceWindow
    discs: Floats
    """(m, 3), see covering_discs."""
    start_clearance_m: float
    """Of the robot now; below 0 it touches."""
    tracks: Floats
    """(k, 6) x, y, velocity in x, in y, radius of the moving obstacles now, and the time until
    each meets a wall.
    """
    travelled_m: Floats
    """(steps + 1, batch), length of each trajectory up to a point."""
    furthest: int = 0
    """Largest index of the path that a trajectory free of collisions ends at."""
    failed: bool = False
    """Every trajectory collides: the critics that follow are left out."""


class Critic(Protocol):
    """Adds its cost to each trajectory of a scene."""

    def __init__(self, params: Any) -> None:
        """Keep the parameters, of which `enabled` was heeded by the caller."""

    def score(self, scene: Scene) -> None:
        """Add to `scene.costs`."""
