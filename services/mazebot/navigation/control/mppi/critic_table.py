"""The critics of MPPI by name."""

from __future__ import annotations

from mazebot.navigation.control.mppi import (
    critics_of_motion,
    critics_of_obstacles,
    critics_of_path,
)
from mazebot.navigation.control.mppi.critics import Critic


def critics_in_order() -> tuple[tuple[str, type[Critic]], ...]:
    """The critics by the name of their parameters, obstacles first: they decide which trajectories
    collide.
    """
    return (
        ("ConstraintCritic", critics_of_motion.ConstraintCritic),
        ("CostCritic", critics_of_obstacles.CostCritic),
        ("ObstaclesCritic", critics_of_obstacles.ObstaclesCritic),
        ("MovingObstaclesCritic", critics_of_obstacles.MovingObstaclesCritic),
        ("GoalCritic", critics_of_path.GoalCritic),
        ("GoalAngleCritic", critics_of_path.GoalAngleCritic),
        ("PathAlignCritic", critics_of_path.PathAlignCritic),
        ("PathFollowCritic", critics_of_path.PathFollowCritic),
        ("PathAngleCritic", critics_of_path.PathAngleCritic),
        ("PreferForwardCritic", critics_of_motion.PreferForwardCritic),
        ("TwirlingCritic", critics_of_motion.TwirlingCritic),
        ("VelocityDeadbandCritic", critics_of_motion.VelocityDeadbandCritic),
    )
