"""BackUp: drives straight back by a distance, as Nav2's behaviour of this name."""

from __future__ import annotations

from dataclasses import replace

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.motions.drive_on_heading import DriveGoal, DriveOnHeading
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams, TimeToCollision
from mazebot.navigation.control.collision import Velocity


class BackUp(DriveOnHeading):
    """A drive back: the signs of the goal's target and speed do not matter."""

    name = "BackUp"
    timeout = ErrorCode.BACKUP_TIMEOUT
    collision_ahead = ErrorCode.BACKUP_COLLISION_AHEAD
    invalid_input = ErrorCode.BACKUP_INVALID_INPUT

    def __init__(self, params: BehaviorServerParams, goal: DriveGoal) -> None:
        back = replace(goal, target_x_m=-abs(goal.target_x_m), speed_m_s=-abs(goal.speed_m_s))
        super().__init__(params, back)


def freer_drive(
    goal: DriveGoal, params: BehaviorServerParams, time_to_collision: TimeToCollision
) -> DriveOnHeading:
    """The recovery by a straight drive: back, or ahead where that way alone is free further.

    Where both ways are shorter than the goal's distance, it drives the freer one, as far as the
    look-ahead shows it free, less a tenth.
    """
    distance_m, speed_m_s = abs(goal.target_x_m), abs(goal.speed_m_s)
    needed_s = distance_m / speed_m_s if speed_m_s > 0.0 else 0.0
    back_s = time_to_collision(Velocity(-speed_m_s, 0.0))
    ahead_s = time_to_collision(Velocity(speed_m_s, 0.0))
    ahead = back_s <= min(needed_s, params.simulate_ahead_time) and ahead_s > back_s
    free_m = 0.9 * (ahead_s if ahead else back_s) * speed_m_s
    if free_m < distance_m and free_m >= _LEAST_M:
        distance_m = free_m
    shorter = replace(goal, target_x_m=distance_m, speed_m_s=speed_m_s)
    return (DriveOnHeading if ahead else BackUp)(params, shorter)


_LEAST_M = 0.05
"""A recovery that moves by less than this changes nothing."""
