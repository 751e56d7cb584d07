"""Regulated pure pursuit behind a rotation shim, as in Nav2, with more than one curvature tried."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.controller import ControllerParams, Robot
from mazebot.navigation.control.path_follower import BRAKES, PathFollower
from mazebot.navigation.planning.path import PlannedPath

_ALIGNED_RAD = 0.2
"""A turn on the spot that has started continues until the heading error is this small."""
_SPEEDS = (1.0, 0.7, 0.4, 0.2)
"""Fractions of the wanted speed that are tried, fastest first."""
_BENDS_PER_M = (0.0, 0.8, -0.8, 1.6, -1.6, 3.0, -3.0)
"""Added to the curvature to the carrot, nearest first, where that collides at every speed."""


class RegulatedPurePursuitParams(ControllerParams):
    """Names as in Nav2's RegulatedPurePursuitController."""

    use_velocity_scaled_lookahead_dist: bool = Field(
        True, description="scale the lookahead distance with the speed; else lookahead_dist"
    )
    lookahead_dist: float = Field(0.35, gt=0, description="m; lookahead distance, if not scaled")
    lookahead_time: float = Field(
        0.8, gt=0, description="s; the lookahead distance is this times the speed"
    )
    min_lookahead_dist: float = Field(0.25, gt=0, description="m; least lookahead distance")
    max_lookahead_dist: float = Field(0.4, gt=0, description="m; greatest lookahead distance")
    use_regulated_linear_velocity_scaling: bool = Field(True, description="slower in bends")
    regulated_linear_scaling_min_radius: float = Field(
        0.4, gt=0, description="m; slower in bends tighter than this"
    )
    regulated_linear_scaling_min_speed: float = Field(
        0.1, gt=0, description="m/s; bends and walls slow down to no less than this"
    )
    use_cost_regulated_linear_velocity_scaling: bool = Field(True, description="slower near walls")
    cost_scaling_dist: float = Field(
        0.3, gt=0, description="m; slower where base_footprint is nearer than this to a wall"
    )
    cost_scaling_gain: float = Field(
        1.0, gt=0, le=1, description="factor of the speed at cost_scaling_dist"
    )
    approach_velocity_scaling_dist: float = Field(
        0.6, gt=0, description="m; the robot brakes at most over this distance before the goal"
    )
    min_approach_linear_velocity: float = Field(
        0.05, gt=0, description="m/s; lowest speed on the approach to the goal"
    )
    approach_decel: float = Field(
        0.5, gt=0, description="m/s2; deceleration on the approach to the goal"
    )
    use_rotate_to_heading: bool = Field(True, description="turn on the spot towards the path")
    rotate_to_heading_min_angle: float = Field(
        0.785,
        gt=0,
        description="rad; where the path's direction differs by more than this, the robot turns "
        "on the spot first",
    )
    rotate_to_heading_angular_vel: float = Field(
        1.5, gt=0, description="rad/s; highest speed of a turn on the spot"
    )
    rotate_to_heading_decel: float = Field(
        1.3, gt=0, description="rad/s2; deceleration at the end of a turn on the spot"
    )
    use_collision_detection: bool = Field(True, description="stop before what is in the way")
    max_allowed_time_to_collision_up_to_carrot: float = Field(
        1.0, gt=0, description="s; a motion must be free of collisions for this long ahead"
    )


class RegulatedPurePursuitController(PathFollower):
    """Follows paths by driving arcs to a point ahead on them."""

    Params: ClassVar[type[ControllerParams]] = RegulatedPurePursuitParams

    def __init__(
        self, params: RegulatedPurePursuitParams, robot: Robot, random: np.random.Generator
    ) -> None:
        super().__init__(
            robot, params.rotate_to_heading_angular_vel, params.rotate_to_heading_decel
        )
        self._params = params
        self._turning = False

    def _begin(self) -> None:
        self._turning = False

    def _drive(
        self, elapsed_s: float, around: Surroundings, path: PlannedPath
    ) -> tuple[Velocity, bool]:
        p, pose = self._params, around.map_from_base
        at_m = float(path.along_m[self.index])
        remaining_m = path.length_m - at_m
        carrot_m = path.point_at(min(at_m + self._lookahead_m(), self._handler.end_m(path)))
        base_from_carrot = pose.inverse() @ SE2(*carrot_m, 0.0)
        ahead_m, aside_m, _ = base_from_carrot
        bearing_rad = portable_kernels.atan2(aside_m, ahead_m)
        limit_rad = p.rotate_to_heading_min_angle
        if self._turning:
            limit_rad = min(limit_rad, _ALIGNED_RAD)
        self._turning = p.use_rotate_to_heading and abs(bearing_rad) > limit_rad
        if self._turning:
            return self._turn(elapsed_s, around, bearing_rad)
        curvature = 2.0 * aside_m / max(ahead_m * ahead_m + aside_m * aside_m, 1e-6)
        left_m = max(remaining_m, pose.distance_m(path.goal))
        for bend_per_m in _BENDS_PER_M:
            tried = curvature + bend_per_m
            wanted_m_s = self._regulated_speed(around, tried, left_m)
            for fraction in _SPEEDS if not bend_per_m else _SPEEDS[2:]:
                velocity = self._on_arc(wanted_m_s * fraction, tried, elapsed_s)
                if not p.use_collision_detection or self._is_clear(around, velocity):
                    return velocity, False
        return self._robot.limited(STOP, self._velocity, elapsed_s), True

    def _lookahead_m(self) -> float:
        p = self._params
        if not p.use_velocity_scaled_lookahead_dist:
            return p.lookahead_dist
        scaled_m = abs(self._velocity.linear_m_s) * p.lookahead_time
        return min(max(scaled_m, p.min_lookahead_dist), p.max_lookahead_dist)

    def _on_arc(self, speed_m_s: float, curvature: float, elapsed_s: float) -> Velocity:
        """The curvature is kept where braking limits the speed."""
        reached = self._robot.limited(Velocity(speed_m_s, 0.0), self._velocity, elapsed_s)
        turn = curvature * reached.linear_m_s
        most_rad_s = self._robot.limits.max_angular_vel
        turn = min(max(turn, -most_rad_s), most_rad_s)
        wanted = Velocity(reached.linear_m_s, turn)
        return self._robot.limited(wanted, self._velocity, elapsed_s)

    def _regulated_speed(self, around: Surroundings, curvature: float, left_m: float) -> float:
        p = self._params
        speed_m_s = self._robot.limits.max_linear_vel
        bend = abs(curvature)
        if bend > 1e-6:
            radius_m = 1.0 / bend
            if (
                p.use_regulated_linear_velocity_scaling
                and radius_m < p.regulated_linear_scaling_min_radius
            ):
                speed_m_s *= radius_m / p.regulated_linear_scaling_min_radius
            speed_m_s = min(speed_m_s, self._robot.limits.max_angular_vel / bend)
        pose = around.map_from_base
        clearance_m = around.costmap.clearance_at(pose.x_m, pose.y_m)
        if p.use_cost_regulated_linear_velocity_scaling and clearance_m < p.cost_scaling_dist:
            speed_m_s *= p.cost_scaling_gain * clearance_m / p.cost_scaling_dist
        speed_m_s = max(speed_m_s, p.regulated_linear_scaling_min_speed)
        speed_m_s = min(speed_m_s, around.speed_limit_m_s)
        most = BRAKES * self._robot.max_linear_decel
        # Over a longer way where the robot cannot brake within that.
        if left_m >= max(p.approach_velocity_scaling_dist, 0.5 * speed_m_s * speed_m_s / most):
            return speed_m_s
        decel = min(p.approach_decel, most)
        approach_m_s = math.sqrt(2.0 * decel * left_m)
        return min(speed_m_s, max(approach_m_s, p.min_approach_linear_velocity))

    def _is_clear(self, around: Surroundings, velocity: Velocity) -> bool:
        p, robot = self._params, self._robot
        # Long enough to stop in, and no longer than the time to the carrot: beyond it the path
        # bends.
        stop_s = abs(velocity.linear_m_s) / robot.max_linear_decel
        horizon_s = stop_s + 2.0 * robot.control_period_s
        if velocity.linear_m_s > 0.0:
            to_carrot_s = p.min_lookahead_dist / velocity.linear_m_s
            up_to_s = min(to_carrot_s, p.max_allowed_time_to_collision_up_to_carrot)
            horizon_s = max(horizon_s, up_to_s)
        return first_contact_s(around, velocity, horizon_s) == math.inf
