"""Parameters of the MPPI controller and of its critics.

Defaults are those of Nav2's code (nav2_mppi_controller), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import OWN_NAME, Group, namespace

_CRITICS = {
    "ConstraintCritic": "cost_weight double 4.0 >=0",
    "CostCritic": """cost_weight double 3.81 >=0
consider_footprint bool false *
critical_cost double 300.0 >=0
near_collision_cost int 253 0..255
collision_cost double 1000000.0 >=0
near_goal_distance double 0.5 >=0
trajectory_point_step int 2 >=1
inflation_layer_name string "" * =- # the local costmap has one inflation layer""",
    "GoalCritic": "cost_weight double 5.0 >=0\nthreshold_to_consider double 1.4 >=0",
    "GoalAngleCritic": """cost_weight double 3.0 >=0
threshold_to_consider double 0.5 >=0
symmetric_yaw_tolerance bool false *""",
    "PathAlignCritic": """cost_weight double 10.0 >=0
max_path_occupancy_ratio double 0.07 0..1
trajectory_point_step int 4 >=1
threshold_to_consider double 0.5 >=0
offset_from_furthest int 20 >=0
use_path_orientations bool false *""",
    "PathFollowCritic": """cost_weight double 5.0 >=0
offset_from_furthest int 6 >=0
threshold_to_consider double 1.4 >=0""",
    "PathAngleCritic": """cost_weight double 2.2 >=0
offset_from_furthest int 4 >=0
threshold_to_consider double 0.5 >=0
max_angle_to_furthest double 0.785398 >=0
mode int 0 {0,1,2}""",
    "PreferForwardCritic": "cost_weight double 5.0 >=0\nthreshold_to_consider double 0.5 >=0",
    "ObstaclesCritic": """repulsion_weight double 1.5 >=0
critical_weight double 20.0 >=0
consider_footprint bool false *
collision_cost double 100000.0 >=0
collision_margin_distance double 0.1 >=0
near_goal_distance double 0.5 >=0
cost_scaling_factor double 10.0 >=0
inflation_radius double 0.55 >=0
inflation_layer_name string "" * =- # the local costmap has one inflation layer""",
    "TwirlingCritic": "cost_weight double 10.0 >=0\nthreshold_to_consider double 0.5 >=0",
    "VelocityDeadbandCritic": """cost_weight double 35.0 >=0
deadband_velocities doubles:3 [0.0,0.0,0.0] >=0""",
    "PathHugCritic": "cost_weight double 0.0 >=0",
}  # fmt: skip

_OWN = """
batch_size int 1000 >=1
time_steps int 56 >=1
model_dt double 0.05 >0
iteration_count int 1 >=1
temperature double 0.3 >0
gamma double 0.015 >=0
vx_max double 0.5 >=0 =vx_max:max_speed
vx_min double -0.35 * =vx_min:min_speed
vy_max double 0.5 >=0 =- # the robot cannot move sideways
wz_max double 1.9 >=0 =wz_max:max_turn
ax_max double 3.0 >=0 =ax_max:max_accel
ax_min double -3.0 <=0 =ax_min:min_accel
ay_max double 3.0 >=0 =- # the robot cannot move sideways
ay_min double -3.0 <=0 =- # the robot cannot move sideways
az_max double 3.5 >=0 =az_max:max_turn_accel
vx_std double 0.2 >=0
vy_std double 0.2 >=0 =- # the robot cannot move sideways
wz_std double 0.4 >=0
retry_attempt_limit int 1 >=0
reset_period double 1.0 >=0
open_loop bool false *
regenerate_noises bool false * =- # takes 20 ms in each period: must be set in our own settings
clamp_raw_controls bool false *
sgf_order int 2 {1,2}
model_delay_vx double 0.0 >=0
model_delay_vy double 0.0 >=0 =- # the robot cannot move sideways
model_delay_wz double 0.0 >=0
motion_model string diff_drive * =- !diff_drive
diff_drive.plugin string mppi::DiffDriveMotionModel * =- !mppi::DiffDriveMotionModel
omni.plugin string - * =- # the robot cannot move sideways
ackermann.plugin string - * =- # the robot rotates in place
ackermann.min_turning_r double - >=0 =- # the robot rotates in place
visualize bool false * =- # thirty rollouts are drawn into every recording
critic_index_to_visualize int 0 *
publish_optimal_trajectory bool false *
publish_optimal_path bool false *
publish_optimal_footprints bool false *
publish_transformed_path bool false *
publish_trajectories_with_total_cost bool false *
publish_trajectories_with_individual_cost bool false *
TrajectoryVisualizer.trajectory_step int 5 >=1
TrajectoryVisualizer.time_step int 3 >=1
TrajectoryVisualizer.footprint_downsample_factor int 3 >=1
TrajectoryVisualizer.publish_optimal_footprints bool false *
TrajectoryVisualizer.publish_optimal_path bool false *
TrajectoryVisualizer.publish_transformed_path bool false *
TrajectoryVisualizer.publish_trajectories_with_total_cost bool false *
TrajectoryVisualizer.publish_trajectories_with_individual_cost bool false *
Visualization.publish_critics_stats bool false *
Visualization.publish_optimal_trajectory_msg bool false *
Visualization.publish_optimal_footprints bool false *
Visualization.publish_optimal_path bool false *
Visualization.publish_transformed_path bool false *
Visualization.publish_trajectories_with_total_cost bool false *
Visualization.publish_trajectories_with_individual_cost bool false *
Visualization.trajectory_step int 5 >=1
Visualization.time_step int 3 >=1
Visualization.footprint_downsample_factor int 3 >=1
TrajectoryValidator.plugin string mppi::DefaultOptimalTrajectoryValidator * =- !default
TrajectoryValidator.collision_lookahead_time double 2.0 >=0 =collision_lookahead_time
TrajectoryValidator.consider_footprint bool false *
AckermannConstraints.min_turning_r double 0.2 >=0 =- # the robot rotates in place
speed_limit_topic string speed_limit *
"""


_EVERY = "enabled bool true *\ncost_power int 1 >=1\n"
_DEFAULT = (
    "ConstraintCritic", "CostCritic", "GoalCritic", "GoalAngleCritic", "PathAlignCritic",
    "PathFollowCritic", "PathAngleCritic", "PreferForwardCritic",
)  # fmt: skip

MPPI = namespace(
    "mppi",
    f"{_OWN}critics strings [{','.join(_DEFAULT)}] * =-\n",
    [
        Group(
            "critics",
            {name: namespace(name, f"{_EVERY}{rows}") for name, rows in _CRITICS.items()},
            key=OWN_NAME,
            defaults={name: name for name in _DEFAULT},
        )
    ],
)
