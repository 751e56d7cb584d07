"""Configuration of navigation. Names are those of Nav2; every length is in metres, every
angle in radians.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mazebot.common.config import ServiceConfig
from mazebot.common.robot import waffle
from mazebot.common.world.costmap import START_TOLERANCE_M
from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.goal_checker import GoalCheckerParams
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.control.regulated_pure_pursuit import RegulatedPurePursuitParams
from mazebot.navigation.control.safety.progress_checker import ProgressParams
from mazebot.navigation.control.safety.velocity_smoother import (
    VelocitySmootherConfig,
    VelocitySmootherParams,
)
from mazebot.navigation.control.tracking import TrackerParams
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.costmap.layered_costmap import InflationParams, ObstacleParams
from mazebot.navigation.planning.interface import PlannerParams, iterations_of
from mazebot.navigation.robot.controller_server import ControllerServerParams
from mazebot.navigation.robot.planner_server import PlannerServerParams

CONTROL_PERIOD_NS = 50_000_000
"""20 Hz, Nav2's controller_frequency: the node's period."""


class NavigationConfig(ServiceConfig):
    """Costmap, planning, control and recovery."""

    footprint_padding: float = Field(
        0.01, ge=0, description="m; the footprint is larger than the robot by this on every side"
    )
    inflation_radius: float = Field(
        0.7, gt=0, description="m; cells nearer than this to an obstacle have a cost"
    )
    cost_scaling_factor: float = Field(
        7.0, gt=0, description="1/m; how fast the cost decays with the distance from an obstacle"
    )
    obstacle_max_range: float = Field(
        2.5, gt=0, description="m; returns nearer than this mark obstacles"
    )
    raytrace_max_range: float = Field(
        3.0, gt=0, description="m; rays clear obstacles up to this range"
    )
    obstacle_static_margin: float = Field(
        0.2,
        ge=0,
        description="m; a return this near to a wall of the map marks no obstacle; where the pose "
        "is known well, it has to be nearer",
    )

    planner: str = Field(
        "any_angle",
        description="any_angle, a_star, my_package.my_module:MyPlanner or FILE.py:MyPlanner",
    )
    cost_travel_multiplier: float = Field(
        1.5,
        ge=0,
        description="extra path length that one metre through the costliest free cells "
        "counts for, in metres",
    )
    max_planning_iterations: int = Field(
        -1,
        ge=-1,
        description="the planner gives up after expanding this many cells; 0 or -1: never, so that "
        "a map of any size is searched to its end (Nav2: 1000000)",
    )
    start_tolerance: float = Field(
        START_TOLERANCE_M,
        ge=0,
        description="m; planning from a start inside an obstacle begins at the nearest "
        "free cell within this distance",
    )
    smoothing_iterations: int = Field(100, ge=0, description="most passes of the path smoother")

    controller: str = Field(
        "mppi",
        description="mppi, regulated_pure_pursuit, my_package.my_module:MyController or "
        "FILE.py:MyController",
    )
    mppi: MPPIParams = Field(default_factory=MPPIParams, description="parameters of mppi")
    controller_params: dict[str, object] = Field(
        default_factory=dict, description="parameters of a controller of your own"
    )
    desired_linear_vel: float = Field(
        waffle.MAX_LINEAR_M_S,
        gt=0,
        description="m/s; speed on a straight path; the robot's own limit is 0.46",
    )
    max_angular_vel: float = Field(
        waffle.MAX_ANGULAR_RAD_S,
        gt=0,
        description="rad/s; highest turning speed; the robot's own limit is 1.9",
    )
    max_linear_accel: float = Field(
        waffle.MAX_LINEAR_ACCELERATION_M_S2,
        gt=0,
        description="m/s2; highest acceleration; the robot's own limit is 1",
    )
    max_angular_accel: float = Field(
        waffle.MAX_ANGULAR_ACCELERATION_RAD_S2,
        gt=0,
        description="rad/s2; highest angular acceleration; the robot's own limit is 2",
    )
    velocity_smoother: VelocitySmootherConfig = Field(
        default_factory=VelocitySmootherConfig,
        description="limits of every command, also of a person's, before the collision monitor",
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

    path_improvement: float = Field(
        0.05,
        ge=0,
        lt=1,
        description="a new path replaces a valid one only if it is shorter by this share",
    )
    tolerance: float = Field(
        0.0,
        ge=0,
        description="m; a goal that is occupied is replaced by the nearest free pose within this",
    )
    localization_tolerance: float = Field(
        90.0,
        ge=0,
        description="s; how long a goal is held, and the robot searches itself, while it is lost",
    )
    local_costmap_size: float = Field(3.0, gt=0, le=20, description="m; side of the local costmap")
    keepout_mask: str = Field(
        "",
        description="map_server YAML file of a keepout mask: 100 is forbidden, less costs in "
        "proportion; empty: none but the world's zones",
    )
    speed_mask: str = Field(
        "",
        description="map_server YAML file of a speed mask; empty: no limits but the world's",
    )
    speed_mask_type: Literal[1, 2] = Field(
        1, description="what the speed mask gives: 1 percent of the highest speed, 2 m/s"
    )
    speed_mask_base: float = Field(
        100.0, description="limit = speed_mask_base + speed_mask_multiplier * value of the mask"
    )
    speed_mask_multiplier: float = Field(-1.0, description="see speed_mask_base")
    tracker: TrackerParams = Field(
        default_factory=TrackerParams, description="tracking of obstacles that move"
    )
    sensor_timeout: float = Field(
        0.5, gt=0, description="s; the robot stops if odometry or the scan is older than this"
    )

    def inflation(self) -> InflationParams:
        """Parameters of the inflation layers."""
        return InflationParams(WAFFLE.half_width_m, self.inflation_radius, self.cost_scaling_factor)

    def obstacle(self) -> ObstacleParams:
        """Parameters of the obstacle layers."""
        return ObstacleParams(
            self.obstacle_max_range, self.raytrace_max_range, self.obstacle_static_margin
        )

    def planner_params(self, map_resolution_m: float, footprint: Footprint) -> PlannerParams:
        """Parameters of the planners on a map; paths are as fine as its cells."""
        return PlannerParams(
            cost_travel_multiplier=self.cost_travel_multiplier,
            max_iterations=iterations_of(self.max_planning_iterations),
            start_tolerance_m=self.start_tolerance,
            path_spacing_m=map_resolution_m,
            smoothing_iterations=self.smoothing_iterations,
            footprint=footprint,
        )

    def robot(self) -> Robot:
        """What controllers must know of the robot."""
        return Robot(
            max_linear_vel_m_s=self.desired_linear_vel,
            max_angular_vel_rad_s=self.max_angular_vel,
            max_linear_accel_m_s2=self.max_linear_accel,
            max_angular_accel_rad_s2=self.max_angular_accel,
            control_period_s=CONTROL_PERIOD_NS * 1e-9,
            goal_checker=GoalCheckerParams(
                xy_goal_tolerance=self.xy_goal_tolerance,
                xy_goal_tolerance_buffer=self.xy_goal_tolerance,
                yaw_goal_tolerance=self.yaw_goal_tolerance,
            ),
        )

    def smoother_params(self) -> VelocitySmootherParams:
        """Parameters of the velocity smoother."""
        return self.velocity_smoother.params(self.max_linear_accel, self.max_angular_accel)

    def planner_server_params(self, footprint: Footprint) -> PlannerServerParams:
        """Which planner, and which of its paths are kept."""
        return PlannerServerParams(
            path_improvement=self.path_improvement,
            tolerance_m=self.tolerance,
            footprint=footprint,
            default_planner=self.planner,
            smoothing_iterations=self.smoothing_iterations,
        )

    def controller_server_params(self) -> ControllerServerParams:
        """Which controller, and when it has failed."""
        return ControllerServerParams(
            control_period_s=CONTROL_PERIOD_NS * 1e-9,
            failure_tolerance_s=self.failure_tolerance,
            max_speed_m_s=self.desired_linear_vel,
            default_controller=self.controller,
            progress=ProgressParams(
                required_movement_radius_m=self.required_movement_radius,
                required_movement_angle_rad=self.required_movement_angle,
                movement_time_allowance_s=self.movement_time_allowance,
            ),
        )

    def controller_params_of(
        self, name: str
    ) -> MPPIParams | RegulatedPurePursuitParams | dict[str, object]:
        """Parameters of the controller of a name."""
        if name == "mppi":
            return self.mppi
        if name != "regulated_pure_pursuit":
            return dict(self.controller_params)
        return RegulatedPurePursuitParams(
            max_linear_vel=self.desired_linear_vel,
            max_angular_vel=self.max_angular_vel,
            lookahead_time=self.lookahead_time,
            min_lookahead_dist=self.min_lookahead_dist,
            max_lookahead_dist=self.max_lookahead_dist,
            regulated_linear_scaling_min_radius=self.regulated_linear_scaling_min_radius,
            regulated_linear_scaling_min_speed=self.regulated_linear_scaling_min_speed,
            cost_scaling_dist=self.cost_scaling_dist,
            min_approach_linear_velocity=self.min_approach_linear_velocity,
            max_linear_decel=-self.approach_decel,
            rotate_to_heading_angular_vel=self.rotate_to_heading_angular_vel,
            rotate_to_heading_min_angle=self.rotate_to_heading_min_angle,
            rotate_to_heading_decel=self.rotate_to_heading_decel,
            max_allowed_time_to_collision_up_to_carrot=(
                self.max_allowed_time_to_collision_up_to_carrot
            ),
        )
