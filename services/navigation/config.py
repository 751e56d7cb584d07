"""Configuration of navigation. Names are those of Nav2 and AMCL; every length is in metres, every
angle in radians.
"""

from __future__ import annotations

from pydantic import Field

from services.common.config import ServiceConfig
from services.common.world.costmap import ROBOT_RADIUS_M, START_TOLERANCE_M
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
    """Localisation, planning, control and recovery."""

    localization: LocalizationParams = Field(
        default_factory=LocalizationParams, description="AMCL's parameters"
    )
    min_scan_match: float = Field(
        0.6, ge=0, le=1, description="below this share of fitting beams the pose is not trusted"
    )
    initial_pose_std_m: float = Field(
        0.05, gt=0, description="standard deviation of the initial pose along x and along y"
    )
    initial_pose_std_rad: float = Field(
        0.05, gt=0, description="standard deviation of the initial pose's yaw"
    )
    odometry_drift_ratio: float = Field(
        0.03,
        ge=0,
        description="standard deviation of odometry's error for each metre driven, in m and in rad",
    )

    robot_radius: float = Field(
        ROBOT_RADIUS_M,
        gt=0,
        description="m; radius of the circle around base_footprint that contains the whole robot",
    )
    inflation_radius: float = Field(
        0.7, gt=0, description="m; cells nearer than this to an obstacle have a cost"
    )
    cost_scaling_factor: float = Field(
        10.0, gt=0, description="1/m; how fast the cost decays with the distance from an obstacle"
    )
    obstacle_max_range: float = Field(
        2.5, gt=0, description="m; returns nearer than this mark obstacles"
    )
    raytrace_max_range: float = Field(
        3.0, gt=0, description="m; rays clear obstacles up to this range"
    )
    obstacle_static_margin: float = Field(
        0.2, ge=0, description="m; a return this near to a wall of the map marks no obstacle"
    )

    cost_travel_multiplier: float = Field(
        1.0,
        ge=0,
        description="extra path length that one metre through the costliest free cells "
        "counts for, in metres",
    )
    max_planning_iterations: int = Field(
        1_000_000, ge=1, description="the planner gives up after expanding this many cells"
    )
    start_tolerance: float = Field(
        START_TOLERANCE_M,
        ge=0,
        description="m; planning from a start inside an obstacle begins at the nearest "
        "free cell within this distance",
    )
    smoothing_iterations: int = Field(100, ge=0, description="most passes of the path smoother")

    desired_linear_vel: float = Field(
        0.46, gt=0, description="m/s; speed on a straight path; the robot's own limit is 0.46"
    )
    max_angular_vel: float = Field(
        1.9, gt=0, description="rad/s; highest turning speed; the robot's own limit is 1.9"
    )
    max_linear_accel: float = Field(
        1.0, gt=0, description="m/s2; highest acceleration; the robot's own limit is 1"
    )
    max_angular_accel: float = Field(
        2.0, gt=0, description="rad/s2; highest angular acceleration; the robot's own limit is 2"
    )
    lookahead_time: float = Field(
        0.8, gt=0, description="s; the lookahead distance is this times the speed"
    )
    min_lookahead_dist: float = Field(0.25, gt=0, description="m; least lookahead distance")
    max_lookahead_dist: float = Field(0.4, gt=0, description="m; greatest lookahead distance")
    regulated_linear_scaling_min_radius: float = Field(
        0.4, gt=0, description="m; slower in bends tighter than this"
    )
    regulated_linear_scaling_min_speed: float = Field(
        0.1, gt=0, description="m/s; bends and walls slow down to no less than this"
    )
    cost_scaling_dist: float = Field(0.3, gt=0, description="m; slower nearer than this to a wall")
    min_approach_linear_velocity: float = Field(
        0.05, gt=0, description="m/s; lowest speed on the approach to the goal"
    )
    approach_decel: float = Field(
        0.5, gt=0, description="m/s2; deceleration on the approach to the goal"
    )
    rotate_to_heading_angular_vel: float = Field(
        1.5, gt=0, description="rad/s; highest speed of a turn on the spot"
    )
    rotate_to_heading_min_angle: float = Field(
        0.785,
        gt=0,
        description="rad; where the path's direction differs by more than this, the robot "
        "turns on the spot first",
    )
    rotate_to_heading_decel: float = Field(
        1.3, gt=0, description="rad/s2; deceleration at the end of a turn on the spot"
    )
    xy_goal_tolerance: float = Field(
        0.06, gt=0, description="m; a goal is reached within this distance; usual is half of it"
    )
    yaw_goal_tolerance: float = Field(
        0.06, gt=0, description="rad; a goal is reached within this angle"
    )
    max_allowed_time_to_collision_up_to_carrot: float = Field(
        1.0, gt=0, description="s; a motion must be free of collisions for this long ahead"
    )
    echo_margin: float = Field(
        0.01,
        ge=0,
        description="m; the circle that no lidar return may enter is smaller than "
        "robot_radius by this, to allow for lidar noise",
    )
    failure_tolerance: float = Field(
        0.3,
        ge=0,
        description="s; how long the controller may find no valid command before a recovery begins",
    )

    required_movement_radius: float = Field(
        0.1, gt=0, description="m; a move of this length counts as progress"
    )
    required_movement_angle: float = Field(
        0.2, gt=0, description="rad; a turn of this angle counts as progress"
    )
    movement_time_allowance: float = Field(
        2.5, gt=0, description="s; without progress for this long a recovery begins"
    )

    replanning_period: float = Field(
        1.0, gt=0, description="s; time between two plans while driving to a goal"
    )
    path_improvement: float = Field(
        0.05,
        ge=0,
        lt=1,
        description="a new path replaces a valid one only if it is shorter by this share",
    )
    number_of_retries: int = Field(6, ge=0, description="recoveries before a goal is aborted")
    localization_tolerance: float = Field(
        1.0,
        ge=0,
        description="s; how long the robot waits, stopped, for a lost localisation before a "
        "recovery begins",
    )
    spin_dist: float = Field(1.57, gt=0, description="rad; angle of the spin recovery")
    max_rotational_vel: float = Field(
        1.0, gt=0, description="rad/s; highest speed of the spin recovery"
    )
    spin_time_allowance: float = Field(
        3.0, gt=0, description="s; the spin recovery fails after this long"
    )
    backup_dist: float = Field(0.3, gt=0, description="m; distance of the back-up recovery")
    backup_speed: float = Field(0.15, gt=0, description="m/s; speed of the back-up recovery")
    backup_time_allowance: float = Field(
        3.0, gt=0, description="s; the back-up recovery fails after this long"
    )
    wait_duration: float = Field(2.0, ge=0, description="s; length of the wait recovery")
    simulate_ahead_time: float = Field(
        1.0, gt=0, description="s; recoveries must be free of collisions for this long ahead"
    )
    sensor_timeout: float = Field(
        0.5, gt=0, description="s; the robot stops if odometry or the scan is older than this"
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
