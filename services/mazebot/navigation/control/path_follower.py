"""What every controller that follows a path does alike: prune it, stop at its end, turn there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.controller import Control, Robot
from mazebot.navigation.control.goal_checker import GoalChecker
from mazebot.navigation.control.path_handler import PathHandler
from mazebot.navigation.planning.path import PlannedPath

_SLOWEST_TURN_RAD_S = 0.1
"""A turn on the spot ends at this speed: the goal's yaw tolerance is above what it turns in one
period.
"""
_STRAIGHT_M_S = 0.12
SLOWEST_M_S = 0.03
BRAKES = 0.9
"""A robot counts on this share of its braking, so that it follows."""
_STRAIGHT_DECEL_M_S2 = 0.3
_STRAIGHT_RAD, _ASKEW_RAD = 0.05, 0.2
"""A straight piece it drives with a heading that differs by less from the path's; by more than the
second it turns first, until it differs by less than the first.
"""
_PER_S = 1.5
"""The rate of turning by the difference of the headings, on a straight piece."""


class PathFollower(ABC):
    """Prunes the path, checks the goal, turns on the spot; a subclass drives along the path.

    Keeps the last command, since commands must not jump.
    """

    def __init__(
        self, robot: Robot, rotate_angular_vel_rad_s: float, rotate_decel_rad_s2: float
    ) -> None:
        self._robot = robot
        self._rotate_rad_s = min(rotate_angular_vel_rad_s, robot.limits.max_angular_vel)
        self._rotate_decel_rad_s2 = min(rotate_decel_rad_s2, robot.limits.max_angular_accel)
        self._handler = PathHandler(robot.limits.path_handler)
        self._goal_checker = GoalChecker(robot.limits.general_goal_checker)
        self._velocity = STOP
        self._aligning = False

    @property
    def path(self) -> PlannedPath | None:
        """See Controller."""
        return self._handler.path

    @property
    def index(self) -> int:
        """See Controller."""
        return self._handler.index

    @property
    def xy_reached(self) -> bool:
        """See Controller."""
        return self._goal_checker.xy_reached

    @property
    def velocity(self) -> Velocity:
        """See Controller."""
        return self._velocity

    def set_path(self, path: PlannedPath, same_goal: bool) -> None:
        """Follow a path. With the same goal as before, a position once reached stays reached."""
        self._handler.set_path(path)
        if not same_goal:
            self._goal_checker.reset()
            self._begin()

    def take_over(self, velocity: Velocity, index: int = 0, xy_reached: bool = False) -> None:
        """See TakesOver."""
        self._velocity = velocity
        self._handler.index = index
        self._goal_checker.reset(xy_reached)

    def stop(self) -> None:
        """Drop the path and the last command: the robot was commanded to stop."""
        self._handler.set_path(None)
        self._velocity = STOP
        self._begin()

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """Velocity for the next control period.

        `elapsed_s` is the time since the last command, within which the speeds may change.
        Raises ValueError if there is no path to follow.
        """
        path, pose = self._handler.path, around.map_from_base
        if path is None:
            raise ValueError("no path to follow")
        remaining_m = self._handler.advance(path, pose)
        goal = path.goal
        to_goal_m = pose.distance_m(goal)
        # On the way to where it turns back, a path may pass the goal.
        left_m = math.inf if self._handler.turns_back() else remaining_m
        if self._goal_checker.check_position(pose, goal, left_m):
            return self._turn_to_goal(elapsed_s, around, goal, to_goal_m)
        straight = self._straight(elapsed_s, around, path)
        if straight is not None:
            return self._put(straight, False, max(remaining_m, to_goal_m))
        velocity, blocked = self._drive(elapsed_s, around, path)
        return self._put(velocity, blocked, max(remaining_m, to_goal_m))

    @abstractmethod
    def _drive(
        self, elapsed_s: float, around: Surroundings, path: PlannedPath
    ) -> tuple[Velocity, bool]:
        """The velocity along the path, within the limits, and whether the way is blocked."""

    @abstractmethod
    def _begin(self) -> None:
        """Forget what was kept of the path before."""

    def _straight(
        self, elapsed_s: float, around: Surroundings, path: PlannedPath
    ) -> Velocity | None:
        """The velocity straight ahead or back, where the path has such a piece, the robot may drive
        so, and that is free.
        """
        left_m = self._handler.straight_m(path)
        if left_m == 0.0:
            self._aligning = False
            return None
        yaw_rad = float(path.yaws_rad[self._handler.index])
        error_rad = wrap_angle(yaw_rad - around.map_from_base.yaw_rad)
        self._aligning = abs(error_rad) > (_STRAIGHT_RAD if self._aligning else _ASKEW_RAD)
        if self._aligning:
            velocity, blocked = self._turn(elapsed_s, around, error_rad)
            if not blocked:
                return velocity
        robot = self._robot
        if left_m < 0.0 and robot.max_backward_vel == 0.0:
            return None
        decel = min(_STRAIGHT_DECEL_M_S2, BRAKES * robot.max_linear_decel)
        speed_m_s = math.sqrt(2.0 * decel * abs(left_m))
        speed_m_s = min(max(speed_m_s, SLOWEST_M_S), _STRAIGHT_M_S, around.speed_limit_m_s)
        rate_rad_s = 0.0 if self._aligning else _PER_S * error_rad
        wanted = Velocity(math.copysign(speed_m_s, left_m), rate_rad_s)
        velocity = robot.limited(wanted, self._velocity, elapsed_s)
        stop_s = abs(velocity.linear_m_s) / robot.max_linear_decel
        horizon_s = stop_s + 2.0 * robot.control_period_s
        return velocity if first_contact_s(around, velocity, horizon_s) == math.inf else None

    def _put(self, velocity: Velocity, blocked: bool, distance_remaining_m: float) -> Control:
        self._velocity = velocity
        return Control(velocity, False, blocked, distance_remaining_m)

    def _turn_to_goal(
        self, elapsed_s: float, around: Surroundings, goal: SE2, to_goal_m: float
    ) -> Control:
        error_rad = self._goal_checker.yaw_error_rad(around.map_from_base, goal)
        if abs(error_rad) <= self._robot.limits.general_goal_checker.yaw_goal_tolerance:
            velocity = self._robot.limited(STOP, self._velocity, elapsed_s)
            measured = around.velocity or self._velocity
            stands = max(map(abs, velocity)) <= 1e-9 and max(map(abs, self._velocity)) <= 1e-9
            pose = around.map_from_base
            if stands and self._goal_checker.is_goal_reached(pose, goal, measured):
                self._velocity = STOP
                return Control(STOP, True, False, to_goal_m)
            return self._put(velocity, False, to_goal_m)
        velocity, blocked = self._turn(elapsed_s, around, error_rad)
        return self._put(velocity, blocked, to_goal_m)

    def _turn(
        self, elapsed_s: float, around: Surroundings, error_rad: float
    ) -> tuple[Velocity, bool]:
        """Turn on the spot by an angle; the other way round where that way is not free."""
        for angle_rad in (error_rad, error_rad - math.copysign(2.0 * math.pi, error_rad)):
            wanted = Velocity(0.0, self._rate_to_turn(angle_rad))
            velocity = self._robot.limited(wanted, self._velocity, elapsed_s)
            if self._is_free(around, velocity, min(abs(angle_rad), 0.5)):
                return velocity, False
        return self._robot.limited(STOP, self._velocity, elapsed_s), True

    def _is_free(self, around: Surroundings, velocity: Velocity, turn_rad: float) -> bool:
        """Whether a turn on the spot stays free until it can be stopped."""
        rate = abs(velocity.angular_rad_s)
        stop_s = rate / self._robot.limits.max_angular_accel + 2.0 * self._robot.control_period_s
        ahead_s = min(turn_rad / max(rate, _SLOWEST_TURN_RAD_S), 1.0)
        horizon_s = max(stop_s, ahead_s)
        return first_contact_s(around, velocity, horizon_s) == math.inf

    def _rate_to_turn(self, error_rad: float) -> float:
        """Turning rate towards an angle from which the robot can still stop at that angle."""
        # The command acts for a whole period before the next one.
        ahead_rad = abs(self._velocity.angular_rad_s) * self._robot.control_period_s
        left_rad = max(abs(error_rad) - ahead_rad, 0.0)
        rate = math.sqrt(2.0 * self._rotate_decel_rad_s2 * left_rad)
        return math.copysign(min(max(rate, _SLOWEST_TURN_RAD_S), self._rotate_rad_s), error_rad)
