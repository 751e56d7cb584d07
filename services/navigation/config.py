"""Configuration of navigation. Names are those of Nav2 and AMCL; every length is in metres, every
angle in radians.
"""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig
from services.navigation.behaviors import BehaviorParams
from services.navigation.controller import ControllerParams
from services.navigation.costmap import InflationParams, ObstacleParams
from services.navigation.localization import LocalizationParams
from services.navigation.navigator import NavigatorParams
from services.navigation.planner import PlannerParams
from services.navigation.progress_checker import ProgressParams

CONTROL_PERIOD_NS = 50_000_000
"""20 Hz, Nav2's controller_frequency: the node's period."""


class NavigationConfig(ServiceConfig):
    """What localises, plans and drives the robot."""

    localization: LocalizationParams = Field(
        default_factory=LocalizationParams, description="AMCL's parameters"
    )
    min_scan_match: float = Field(
        0.6, ge=0, le=1, description="below this share of fitting beams the pose is not trusted"
    )
    initial_pose_std_m: float = Field(0.05, gt=0, description="of the start pose, along x and y")
    initial_pose_std_rad: float = Field(0.05, gt=0, description="of the start pose's heading")
    odometry_drift_ratio: float = Field(
        0.03,
        ge=0,
        description="of odometry over the distance from its start, in m per m and rad per m",
    )

    robot_radius: float = Field(
        0.24, gt=0, description="m; of the circle round base_footprint that holds the whole robot"
    )
    inflation_radius: float = Field(0.7, gt=0, description="m; cost reaches this far from a wall")
    cost_scaling_factor: float = Field(
        10.0, gt=0, description="1/m; how fast the cost falls with distance"
    )
    obstacle_max_range: float = Field(2.5, gt=0, description="m; echoes nearer than this mark")
    raytrace_max_range: float = Field(3.0, gt=0, description="m; rays clear up to here")
    obstacle_static_margin: float = Field(
        0.2, ge=0, description="m; an echo this near a wall of the map marks nothing"
    )

    cost_travel_multiplier: float = Field(
        1.0, ge=0, description="extra metres for a metre of the dearest free cells"
    )
    max_planning_iterations: int = Field(1_000_000, ge=1, description="cells to expand at most")
    start_tolerance: float = Field(
        0.5, ge=0, description="m; a start inside inflated cells moves to a free one this near"
    )
    smoothing_iterations: int = Field(100, ge=0, description="passes of the path smoother")

    desired_linear_vel: float = Field(0.46, gt=0, description="m/s; the robot's own limit is 0.46")
    max_angular_vel: float = Field(1.9, gt=0, description="rad/s; the robot's own limit is 1.9")
    max_linear_accel: float = Field(1.0, gt=0, description="m/s2; the robot's own limit is 1")
    max_angular_accel: float = Field(2.0, gt=0, description="rad/s2; the robot's own limit is 2")
    lookahead_time: float = Field(0.8, gt=0, description="s; lookahead distance over speed")
    min_lookahead_dist: float = Field(0.25, gt=0, description="m")
    max_lookahead_dist: float = Field(0.4, gt=0, description="m")
    regulated_linear_scaling_min_radius: float = Field(
        0.4, gt=0, description="m; slower in bends tighter than this"
    )
    regulated_linear_scaling_min_speed: float = Field(
        0.1, gt=0, description="m/s; bends and walls slow down to no less than this"
    )
    cost_scaling_dist: float = Field(0.3, gt=0, description="m; slower nearer than this to a wall")
    min_approach_linear_velocity: float = Field(0.05, gt=0, description="m/s; at the goal")
    approach_decel: float = Field(0.5, gt=0, description="m/s2; of the approach to the goal")
    rotate_to_heading_angular_vel: float = Field(1.5, gt=0, description="rad/s; on the spot")
    rotate_to_heading_min_angle: float = Field(
        0.785, gt=0, description="rad; a path that begins further aside is turned to on the spot"
    )
    rotate_to_heading_decel: float = Field(1.3, gt=0, description="rad/s2; at the end of a turn")
    xy_goal_tolerance: float = Field(0.06, gt=0, description="m; half of it is usual at the end")
    yaw_goal_tolerance: float = Field(0.06, gt=0, description="rad")
    max_allowed_time_to_collision_up_to_carrot: float = Field(
        1.0, gt=0, description="s; a motion must be free this far ahead"
    )
    echo_margin: float = Field(
        0.01, ge=0, description="m; the circle no echo may enter is smaller by this: lidar noise"
    )
    failure_tolerance: float = Field(0.3, ge=0, description="s; without a valid command")

    required_movement_radius: float = Field(0.1, gt=0, description="m; that is progress")
    required_movement_angle: float = Field(0.2, gt=0, description="rad; that is progress")
    movement_time_allowance: float = Field(2.5, gt=0, description="s; without progress")

    replanning_period: float = Field(1.0, gt=0, description="s")
    path_improvement: float = Field(
        0.05, ge=0, lt=1, description="a new path must be shorter by this share to be taken up"
    )
    number_of_retries: int = Field(6, ge=0, description="recoveries before a goal is given up")
    localization_tolerance: float = Field(
        1.0, ge=0, description="s; to stand and wait for a localisation that is lost"
    )
    spin_dist: float = Field(1.57, gt=0, description="rad")
    max_rotational_vel: float = Field(1.0, gt=0, description="rad/s; of the spin")
    spin_time_allowance: float = Field(3.0, gt=0, description="s")
    backup_dist: float = Field(0.3, gt=0, description="m")
    backup_speed: float = Field(0.15, gt=0, description="m/s")
    backup_time_allowance: float = Field(3.0, gt=0, description="s")
    wait_duration: float = Field(2.0, ge=0, description="s")
    simulate_ahead_time: float = Field(1.0, gt=0, description="s; behaviours must be free this far")
    sensor_timeout: float = Field(
        0.5, gt=0, description="s; the robot stands where odometry or the scan is older"
    )

    def inflation(self) -> InflationParams:
        """Parameters of the inflation layer."""
        return InflationParams(self.robot_radius, self.inflation_radius, self.cost_scaling_factor)

    def obstacle(self) -> ObstacleParams:
        """Parameters of the obstacle layer."""
        return ObstacleParams(
            self.obstacle_max_range, self.raytrace_max_range, self.obstacle_static_margin
        )

    def navigator(self, map_resolution_m: float) -> NavigatorParams:
        """Parameters of the navigator on a map; paths are as fine as its cells."""
        period_s = CONTROL_PERIOD_NS * 1e-9
        echo_radius_m = self.robot_radius - self.echo_margin
        return NavigatorParams(
            replanning_period_s=self.replanning_period,
            number_of_retries=self.number_of_retries,
            failure_tolerance_s=self.failure_tolerance,
            localization_tolerance_s=self.localization_tolerance,
            path_improvement=self.path_improvement,
            planner=PlannerParams(
                cost_travel_multiplier=self.cost_travel_multiplier,
                max_iterations=self.max_planning_iterations,
                start_tolerance_m=self.start_tolerance,
                path_spacing_m=map_resolution_m,
                smoothing_iterations=self.smoothing_iterations,
            ),
            controller=ControllerParams(
                control_period_s=period_s,
                desired_linear_vel_m_s=self.desired_linear_vel,
                max_angular_vel_rad_s=self.max_angular_vel,
                max_linear_accel_m_s2=self.max_linear_accel,
                max_angular_accel_rad_s2=self.max_angular_accel,
                lookahead_time_s=self.lookahead_time,
                min_lookahead_dist_m=self.min_lookahead_dist,
                max_lookahead_dist_m=self.max_lookahead_dist,
                regulated_linear_scaling_min_radius_m=self.regulated_linear_scaling_min_radius,
                regulated_linear_scaling_min_speed_m_s=self.regulated_linear_scaling_min_speed,
                cost_scaling_dist_m=self.cost_scaling_dist,
                min_approach_linear_velocity_m_s=self.min_approach_linear_velocity,
                approach_decel_m_s2=self.approach_decel,
                rotate_to_heading_angular_vel_rad_s=self.rotate_to_heading_angular_vel,
                rotate_to_heading_min_angle_rad=self.rotate_to_heading_min_angle,
                rotate_to_heading_decel_rad_s2=self.rotate_to_heading_decel,
                xy_goal_tolerance_m=self.xy_goal_tolerance,
                yaw_goal_tolerance_rad=self.yaw_goal_tolerance,
                max_allowed_time_to_collision_up_to_carrot_s=(
                    self.max_allowed_time_to_collision_up_to_carrot
                ),
                echo_radius_m=echo_radius_m,
            ),
            behaviors=BehaviorParams(
                spin_dist_rad=self.spin_dist,
                max_rotational_vel_rad_s=self.max_rotational_vel,
                rotational_acc_lim_rad_s2=self.max_angular_accel,
                spin_time_allowance_s=self.spin_time_allowance,
                backup_dist_m=self.backup_dist,
                backup_speed_m_s=self.backup_speed,
                backup_time_allowance_s=self.backup_time_allowance,
                wait_duration_s=self.wait_duration,
                simulate_ahead_time_s=self.simulate_ahead_time,
                echo_radius_m=echo_radius_m,
            ),
            progress=ProgressParams(
                required_movement_radius_m=self.required_movement_radius,
                required_movement_angle_rad=self.required_movement_angle,
                movement_time_allowance_s=self.movement_time_allowance,
            ),
        )
