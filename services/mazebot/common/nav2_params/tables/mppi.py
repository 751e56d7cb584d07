"""Parameters of the MPPI controller and of its critics.

Defaults are those of Nav2's code (nav2_mppi_controller), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import OWN_NAME, Group, namespace

_CRITICS = {
    "ConstraintCritic": "cost_weight double 4.0 >=0",
    "CostCritic": """cost_weight double 3.81 >=0
- consider_footprint
critical_cost double 300.0 >=0
- near_collision_cost
collision_cost double 1000000.0 >=0
near_goal_distance double 0.5 >=0
trajectory_point_step int 2 >=1
- inflation_layer_name # the local costmap has one inflation layer""",
    "GoalCritic": "cost_weight double 5.0 >=0\nthreshold_to_consider double 1.4 >=0",
    "GoalAngleCritic": """cost_weight double 3.0 >=0
threshold_to_consider double 0.5 >=0
symmetric_yaw_tolerance bool false *""",
    "PathAlignCritic": """cost_weight double 10.0 >=0
max_path_occupancy_ratio double 0.07 0..1
trajectory_point_step int 4 >=1
threshold_to_consider double 0.5 >=0
offset_from_furthest int 20 >=0
- use_path_orientations""",
    "PathFollowCritic": """cost_weight double 5.0 >=0
offset_from_furthest int 6 >=0
threshold_to_consider double 1.4 >=0""",
    "PathAngleCritic": """cost_weight double 2.2 >=0
offset_from_furthest int 4 >=0
threshold_to_consider double 0.5 >=0
max_angle_to_furthest double 0.785398 >=0
mode int 0 {0,1,2} =:angle_mode""",
    "PreferForwardCritic": "cost_weight double 5.0 >=0\nthreshold_to_consider double 0.5 >=0",
    "ObstaclesCritic": """repulsion_weight double 1.5 >=0
critical_weight double 20.0 >=0
- consider_footprint
collision_cost double 100000.0 >=0
collision_margin_distance double 0.1 >=0
near_goal_distance double 0.5 >=0
- cost_scaling_factor
inflation_radius double 0.55 >=0
- inflation_layer_name # the local costmap has one inflation layer""",
    "TwirlingCritic": "cost_weight double 10.0 >=0\n- threshold_to_consider",
    "VelocityDeadbandCritic": """cost_weight double 35.0 >=0
deadband_velocities doubles:3 [0.0,0.0,0.0] >=0""",
}  # fmt: skip

_OWN = """
batch_size int 1000 >=1
time_steps int 56 >=1
model_dt double 0.05 >0
iteration_count int 1 >=1
temperature double 0.3 >0
gamma double 0.015 >=0
vx_max double 0.5 >=0 =:max_speed
vx_min double -0.35 * =:min_speed
wz_max double 1.9 >=0 =:max_turn
ax_max double 3.0 >=0 =:max_accel
ax_min double -3.0 <=0 =:min_accel
az_max double 3.5 >=0 =:max_turn_accel
vx_std double 0.2 >=0
wz_std double 0.4 >=0
retry_attempt_limit int 1 >=0
open_loop bool false *
sgf_order int 2 {1,2} =:smoothing
motion_model string diff_drive * =- !diff_drive
diff_drive.plugin string mppi::DiffDriveMotionModel * =- !mppi::DiffDriveMotionModel
TrajectoryValidator.plugin string mppi::DefaultOptimalTrajectoryValidator * =- !default
TrajectoryValidator.collision_lookahead_time double 2.0 >=0 =collision_lookahead_time
- vy_max ay_max ay_min vy_std model_delay_vy omni.plugin # the robot cannot move sideways
- ackermann.plugin ackermann.min_turning_r # the robot rotates in place
- AckermannConstraints.min_turning_r # the robot rotates in place
- regenerate_noises # takes 20 ms in each period: must be set in our own settings
- visualize # thirty rollouts are drawn into every recording
- reset_period clamp_raw_controls model_delay_vx model_delay_wz critic_index_to_visualize
- publish_optimal_trajectory publish_optimal_path publish_optimal_footprints
- publish_transformed_path publish_trajectories_with_total_cost
- publish_trajectories_with_individual_cost TrajectoryVisualizer.trajectory_step
- TrajectoryVisualizer.time_step TrajectoryVisualizer.footprint_downsample_factor
- TrajectoryVisualizer.publish_optimal_footprints TrajectoryVisualizer.publish_optimal_path
- TrajectoryVisualizer.publish_transformed_path
- TrajectoryVisualizer.publish_trajectories_with_total_cost
- TrajectoryVisualizer.publish_trajectories_with_individual_cost
- Visualization.publish_critics_stats Visualization.publish_optimal_trajectory_msg
- Visualization.publish_optimal_footprints Visualization.publish_optimal_path
- Visualization.publish_transformed_path Visualization.publish_trajectories_with_total_cost
- Visualization.publish_trajectories_with_individual_cost Visualization.trajectory_step
- Visualization.time_step Visualization.footprint_downsample_factor
- TrajectoryValidator.consider_footprint speed_limit_topic
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
            {
                **{name: namespace(name, f"{_EVERY}{rows}") for name, rows in _CRITICS.items()},
                "PathHugCritic": namespace("PathHugCritic", "- enabled cost_power cost_weight"),
            },
            key=OWN_NAME,
            defaults={name: name for name in _DEFAULT},
        )
    ],
)
