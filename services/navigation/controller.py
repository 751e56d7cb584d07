"""The controller: regulated pure pursuit behind a rotation shim, and a stateful goal checker, as in
Nav2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from services.common import portable_kernels
from services.common.frames import SE2, wrap_angle
from services.navigation.collision import STOP, Surroundings, Velocity, first_contact_s
from services.navigation.path import PlannedPath


@dataclass(frozen=True, slots=True)
class ControllerParams:
    """Names as in Nav2's RegulatedPurePursuit, RotationShim and SimpleGoalChecker."""

    control_period_s: float
    desired_linear_vel_m_s: float
    max_angular_vel_rad_s: float
    max_linear_accel_m_s2: float
    max_angular_accel_rad_s2: float
    lookahead_time_s: float
    min_lookahead_dist_m: float
    max_lookahead_dist_m: float
    regulated_linear_scaling_min_radius_m: float
    regulated_linear_scaling_min_speed_m_s: float
    cost_scaling_dist_m: float
    min_approach_linear_velocity_m_s: float
    approach_decel_m_s2: float
    rotate_to_heading_angular_vel_rad_s: float
    rotate_to_heading_min_angle_rad: float
    rotate_to_heading_decel_rad_s2: float
    xy_goal_tolerance_m: float
    yaw_goal_tolerance_rad: float
    max_allowed_time_to_collision_up_to_carrot_s: float
    echo_radius_m: float


@dataclass(frozen=True, slots=True)
class Control:
    """The controller's output for one control period."""

    velocity: Velocity
    reached: bool
    """The robot is stopped at the goal, within both tolerances."""
    blocked: bool
    """No velocity along the path is collision-free."""
    distance_remaining_m: float


_ALIGNED_RAD = 0.2
"""A turn on the spot that has begun goes on until the heading error is this small."""
_TURNED_RAD_S = 0.1
"""The final turn is over once it is slower than this."""
_SPEEDS = (1.0, 0.7, 0.4, 0.2)
"""Fractions of the wanted speed that are tried, fastest first."""
_SEARCH_WINDOW_M = 1.0
_STEP_S = 0.05


class Controller:
    """Follows paths. Keeps the last command, since commands must not jump."""

    def __init__(self, params: ControllerParams) -> None:
        self._params = params
        self._path: PlannedPath | None = None
        self._index = 0
        self._turning = False
        self._xy_reached = False
        self.velocity = STOP
        """The last command."""

    def follow(self, path: PlannedPath, same_goal: bool) -> None:
        """Follow a path. With the same goal as before, a position once reached stays reached."""
        self._path = path
        self._index = 0
        if not same_goal:
            self._xy_reached = False
            self._turning = False

    @property
    def path(self) -> PlannedPath | None:
        """The path being followed."""
        return self._path

    @property
    def index(self) -> int:
        """Index of the path's point that the robot has reached."""
        return self._index

    @property
    def xy_reached(self) -> bool:
        """Whether only the final turn is left."""
        return self._xy_reached

    def stop(self) -> None:
        """Drop the path and the last command: the robot was commanded to stop."""
        self._path = None
        self.velocity = STOP

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """Velocity for the next control period.

        `elapsed_s` is the time since the last command, within which the speeds may change.
        Raises ValueError if there is no path to follow.
        """
        path, p, pose = self._path, self._params, around.map_from_base
        if path is None:
            raise ValueError("no path to follow")
        self._index = path.nearest(pose.x_m, pose.y_m, self._index, _SEARCH_WINDOW_M)
        goal = path.goal
        to_goal_m = pose.distance_m(goal)
        remaining_m = path.length_m - float(path.along_m[self._index])
        near_end = remaining_m <= 2.0 * p.max_lookahead_dist_m
        if to_goal_m <= p.xy_goal_tolerance_m and near_end:
            self._xy_reached = True
        elif to_goal_m > 2.0 * p.xy_goal_tolerance_m:
            # Localisation has found that the robot had not arrived.
            self._xy_reached = False
        if self._xy_reached:
            return self._turn_to_goal(elapsed_s, around, goal, to_goal_m)

        lookahead_m = min(
            max(abs(self.velocity.linear_m_s) * p.lookahead_time_s, p.min_lookahead_dist_m),
            p.max_lookahead_dist_m,
        )
        carrot_m = path.point_at(float(path.along_m[self._index]) + lookahead_m)
        base_from_carrot = pose.inverse() @ SE2(*carrot_m, 0.0)
        bearing_rad = portable_kernels.atan2(base_from_carrot.y_m, base_from_carrot.x_m)
        away = abs(bearing_rad)
        self._turning = away > (
            _ALIGNED_RAD if self._turning else p.rotate_to_heading_min_angle_rad
        )
        distance_remaining_m = max(remaining_m, to_goal_m)
        if self._turning:
            velocity = self._limited(elapsed_s, 0.0, self._rate_to_turn(bearing_rad))
            free = self._time_to_contact_s(around, velocity) > p.control_period_s * 2.0
            return self._put(velocity if free else STOP, not free, distance_remaining_m)

        ahead_m, aside_m, _ = base_from_carrot
        square_m2 = ahead_m * ahead_m + aside_m * aside_m
        curvature = 2.0 * base_from_carrot.y_m / max(square_m2, 1e-6)
        wanted_m_s = self._regulated_speed(around, curvature, to_goal_m, remaining_m)
        for fraction in _SPEEDS:
            speed_m_s = self._limited(elapsed_s, wanted_m_s * fraction, 0.0).linear_m_s
            # The speed may be limited by braking; the curvature is kept at any speed.
            velocity = self._limited(elapsed_s, wanted_m_s * fraction, curvature * speed_m_s)
            if self._time_to_contact_s(around, velocity) == math.inf:
                return self._put(velocity, False, distance_remaining_m)
        return self._put(self._limited(elapsed_s, 0.0, 0.0), True, distance_remaining_m)

    def _turn_to_goal(
        self, elapsed_s: float, around: Surroundings, goal: SE2, to_goal_m: float
    ) -> Control:
        p = self._params
        error_rad = wrap_angle(goal.yaw_rad - around.map_from_base.yaw_rad)
        slow = (
            abs(self.velocity.linear_m_s) <= p.max_linear_accel_m_s2 * p.control_period_s
            and abs(self.velocity.angular_rad_s) <= _TURNED_RAD_S + 1e-9
        )
        if abs(error_rad) <= p.yaw_goal_tolerance_rad and slow:
            # Soon after the last step, not even this low speed can be stopped at once.
            slowed = self._limited(elapsed_s, 0.0, 0.0)
            if max(map(abs, slowed)) > 1e-9:
                return self._put(slowed, False, to_goal_m)
            self.velocity = STOP
            return Control(STOP, True, False, to_goal_m)
        velocity = self._limited(elapsed_s, 0.0, self._rate_to_turn(error_rad))
        free = self._time_to_contact_s(around, velocity) > p.control_period_s * 2.0
        return self._put(velocity if free else STOP, not free, to_goal_m)

    def _put(self, velocity: Velocity, blocked: bool, distance_remaining_m: float) -> Control:
        self.velocity = velocity
        return Control(velocity, False, blocked, distance_remaining_m)

    def _regulated_speed(
        self, around: Surroundings, curvature: float, to_goal_m: float, remaining_m: float
    ) -> float:
        p = self._params
        speed_m_s = p.desired_linear_vel_m_s
        bend = abs(curvature)
        if bend > 1e-6:
            radius_m = 1.0 / bend
            if radius_m < p.regulated_linear_scaling_min_radius_m:
                speed_m_s *= radius_m / p.regulated_linear_scaling_min_radius_m
            speed_m_s = min(speed_m_s, p.max_angular_vel_rad_s / bend)
        pose = around.map_from_base
        clearance_m = around.costmap.clearance_at(pose.x_m, pose.y_m)
        if clearance_m < p.cost_scaling_dist_m:
            speed_m_s *= clearance_m / p.cost_scaling_dist_m
        speed_m_s = max(speed_m_s, p.regulated_linear_scaling_min_speed_m_s)
        left_m = max(remaining_m, to_goal_m)
        approach_m_s = math.sqrt(2.0 * p.approach_decel_m_s2 * left_m)
        return min(speed_m_s, max(approach_m_s, p.min_approach_linear_velocity_m_s))

    def _rate_to_turn(self, error_rad: float) -> float:
        """Turning rate towards an angle from which the robot can still stop at that angle."""
        p = self._params
        # The command acts for a whole period before the next one.
        ahead_rad = abs(self.velocity.angular_rad_s) * p.control_period_s
        left_rad = max(abs(error_rad) - ahead_rad, 0.0)
        rate = math.sqrt(2.0 * p.rotate_to_heading_decel_rad_s2 * left_rad)
        rate = min(max(rate, 0.1), p.rotate_to_heading_angular_vel_rad_s)
        return math.copysign(rate, error_rad)

    def _limited(self, elapsed_s: float, linear_m_s: float, angular_rad_s: float) -> Velocity:
        """The velocity nearest to a wanted one within the limits of speed and acceleration."""
        p, last = self._params, self.velocity
        dv = p.max_linear_accel_m_s2 * elapsed_s
        dw = p.max_angular_accel_rad_s2 * elapsed_s
        w_max = p.max_angular_vel_rad_s
        return Velocity(
            min(max(linear_m_s, last.linear_m_s - dv), last.linear_m_s + dv),
            min(
                max(angular_rad_s, last.angular_rad_s - dw, -w_max),
                last.angular_rad_s + dw,
                w_max,
            ),
        )

    def _time_to_contact_s(self, around: Surroundings, velocity: Velocity) -> float:
        p = self._params
        # Long enough to stop in, and no longer than the time to the carrot: beyond it the path
        # bends.
        stop_s = abs(velocity.linear_m_s) / p.max_linear_accel_m_s2 + 2.0 * p.control_period_s
        horizon_s = max(stop_s, 2.0 * _STEP_S)
        if velocity.linear_m_s > 0.0:
            to_carrot_s = p.min_lookahead_dist_m / velocity.linear_m_s
            horizon_s = max(
                horizon_s, min(to_carrot_s, p.max_allowed_time_to_collision_up_to_carrot_s)
            )
        return first_contact_s(around, velocity, horizon_s, _STEP_S, p.echo_radius_m)
