"""Parameters of the controller server and of its plugins.

Defaults are those of Nav2's code (nav2_controller, nav2_regulated_pure_pursuit_controller,
nav2_graceful_controller, nav2_dwb_controller, nav2_rotation_shim_controller), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace
from mazebot.common.nav2_params.tables.mppi import MPPI

_RPP = namespace(
    "regulated_pure_pursuit",
    """
max_linear_vel double 0.5 >=0 =max_linear_vel,desired_linear_vel:max_speed
min_linear_vel double -0.5 * =min_linear_vel:min_speed
max_angular_vel double 2.5 >=0 =max_angular_vel:max_turn
min_angular_vel double -2.5 *
lookahead_dist double 0.6 >0
min_lookahead_dist double 0.3 >0
max_lookahead_dist double 0.9 >0
lookahead_time double 1.5 >0
use_velocity_scaled_lookahead_dist bool false *
rotate_to_heading_angular_vel double 1.8 >=0 =rotate_to_heading_angular_vel:max_turn
use_rotate_to_heading bool true *
rotate_to_heading_min_angle double 0.785 >=0
max_linear_accel double 2.5 >=0 =max_linear_accel:max_accel
max_linear_decel double -2.5 * =max_linear_decel:min_accel
max_angular_accel double 3.2 >=0 =max_angular_accel:max_turn_accel
max_angular_decel double -3.2 *
min_approach_linear_velocity double 0.05 >=0
approach_velocity_scaling_dist double 0.6 >=0
use_collision_detection bool true *
max_allowed_time_to_collision_up_to_carrot double 1.0 >=0
min_distance_to_obstacle double -1.0 >=-1
use_regulated_linear_velocity_scaling bool true *
regulated_linear_scaling_min_radius double 0.9 >=0
regulated_linear_scaling_min_speed double 0.25 >=0
use_cost_regulated_linear_velocity_scaling bool true *
cost_scaling_dist double 0.6 >=0
cost_scaling_gain double 1.0 >=0
inflation_cost_scaling_factor double 3.0 >0
use_fixed_curvature_lookahead bool false *
curvature_lookahead_dist double 0.6 >0
interpolate_curvature_after_goal bool false *
allow_reversing bool false *
use_cancel_deceleration bool false *
cancel_deceleration double 3.2 >=0
use_dynamic_window bool false *
allow_obstacle_checking_beyond_goal bool false *
""",
)

_GRACEFUL = namespace(
    "graceful",
    """
min_lookahead double 0.25 >=0
max_lookahead double 1.0 >=0
max_robot_pose_search_dist double - *
k_phi double 2.0 >=0
k_delta double 1.0 >=0
beta double 0.4 >=0
lambda double 2.0 >=0
v_linear_min double 0.1 >=0
v_linear_max double 0.5 >=0
v_angular_max double 1.0 >=0
v_angular_min_in_place double 0.25 >=0
slowdown_radius double 1.5 >=0
initial_rotation bool true *
initial_rotation_tolerance double 0.75 >=0
prefer_final_rotation bool true *
rotation_scaling_factor double 0.5 >=0
allow_backward bool false *
in_place_collision_resolution double 0.1 >0
use_collision_detection bool true *
""",
    note="there is no graceful controller",
)

_DWB = namespace(
    "dwb",
    """
max_vel_x double 0.0 >=0 =vx_max:max_speed # DWB is not supported: MPPI keeps to its limits
min_vel_x double 0.0 * =- # DWB is not supported
max_vel_theta double 0.0 >=0 =wz_max:max_turn # DWB is not supported: MPPI keeps to its limits
acc_lim_x double 0.0 >=0 =ax_max:max_accel # DWB is not supported: MPPI keeps to its limits
decel_lim_x double 0.0 <=0 =ax_min:min_accel # DWB is not supported: MPPI keeps to its limits
acc_lim_theta double 0.0 >=0 =az_max:max_turn_accel # DWB is not supported: MPPI keeps to its limits
decel_lim_theta double 0.0 <=0 =-
min_vel_y double 0.0 * =-
max_vel_y double 0.0 * =-
acc_lim_y double 0.0 * =-
decel_lim_y double 0.0 * =-
min_speed_xy double 0.0 >=0 =-
max_speed_xy double 0.0 * =-
min_speed_theta double 0.0 >=0 =-
debug_trajectory_details bool false * =-
vx_samples int 20 >=1 =-
vy_samples int 5 >=1 =-
vtheta_samples int 20 >=1 =-
sim_time double 1.7 >0 =-
sim_granularity double 0.5 >0 =-
time_granularity double 0.5 >0 =-
discretize_by_time bool false * =-
linear_granularity double 0.5 >0 =-
angular_granularity double 0.025 >0 =-
include_last_point bool true * =-
limit_vel_cmd_in_traj bool false * =-
trajectory_generator_name string dwb_plugins::StandardTrajectoryGenerator * =-
goal_checker_name string - * =-
default_critic_namespaces strings - * =-
transform_tolerance double 0.1 >=0 =-
xy_goal_tolerance double 0.25 >=0 =-
yaw_goal_tolerance double 0.25 >=0 =-
trans_stopped_velocity double 0.25 >=0 =-
rot_stopped_velocity double 0.25 >=0 =-
short_circuit_trajectory_evaluation bool true * =-
stateful bool true * =-
use_dwb bool true * =-
critics strings - * =-
BaseObstacle.scale double 1.0 * =-
BaseObstacle.sum_scores bool false * =-
ObstacleFootprint.scale double 1.0 * =-
ObstacleFootprint.sum_scores bool false * =-
PathAlign.scale double 1.0 * =-
PathAlign.forward_point_distance double 0.325 * =-
PathAlign.aggregation_type string last * =-
GoalAlign.scale double 1.0 * =-
GoalAlign.forward_point_distance double 0.325 * =-
GoalAlign.aggregation_type string last * =-
PathDist.scale double 1.0 * =-
PathDist.aggregation_type string last * =-
GoalDist.scale double 1.0 * =-
GoalDist.aggregation_type string last * =-
RotateToGoal.scale double 1.0 * =-
RotateToGoal.slowing_factor double 5.0 * =-
RotateToGoal.lookahead_time double -1.0 * =-
Oscillation.scale double 1.0 * =-
Oscillation.oscillation_reset_dist double 0.05 * =-
Oscillation.oscillation_reset_angle double 0.2 * =-
Oscillation.oscillation_reset_time double -1.0 * =-
Oscillation.x_only_threshold double 0.05 * =-
PreferForward.scale double 1.0 * =-
PreferForward.penalty double 1.0 * =-
PreferForward.strafe_x double 0.1 * =-
PreferForward.strafe_theta double 0.2 * =-
PreferForward.theta_scale double 10.0 * =-
Twirling.scale double 0.0 * =-
""",
    note="DWB is not supported",
)

_SHIM = namespace(
    "rotation_shim",
    """
primary_controller string - * =-
angular_dist_threshold double 0.785 >=0
angular_disengage_threshold double 0.3925 >=0
forward_sampling_distance double 0.5 >=0
rotate_to_heading_angular_vel double 1.8 >=0
max_angular_accel double 3.2 >=0
simulate_ahead_time double 1.0 >=0
rotate_to_goal_heading bool false *
rotate_to_heading_once bool false *
closed_loop bool true *
use_path_orientations bool false *
""",
    note="the controllers rotate in place themselves",
)

_SIMPLE_GOAL = """
xy_goal_tolerance double 0.25 >=0
xy_goal_tolerance_buffer double 0.0 >=0
yaw_goal_tolerance double 0.25 >=0
path_length_tolerance double 1.0 >=0
stateful bool true *
symmetric_yaw_tolerance bool false *
"""
_STOPPED_GOAL = f"""{_SIMPLE_GOAL}
rot_stopped_velocity double 0.25 >=0
trans_stopped_velocity double 0.25 >=0
"""
_AXIS_GOAL = """
along_path_tolerance double 0.25 >=0
cross_track_tolerance double 0.25 >=0
path_length_tolerance double 1.0 >=0
direction_estimation double 0.15 >=0
is_overshoot_valid bool false *
"""
_ADAPTIVE_GOAL = """
fine_xy_goal_tolerance double 0.1 >=0
coarse_xy_goal_tolerance double 0.25 >=0
yaw_goal_tolerance double 0.25 >=0
trans_stopped_velocity double 0.1 >=0
rot_stopped_velocity double 0.1 >=0
required_stagnation_cycles int 15 >=1
path_length_tolerance double 1.0 >=0
stateful bool true *
symmetric_yaw_tolerance bool false *
"""
_PROGRESS = """
required_movement_radius double 0.5 >=0
movement_time_allowance double 10.0 >=0
"""
_PATH_HANDLER = """
prune_distance double 2.0 >0
transform_tolerance double 0.1 >=0
max_robot_pose_search_dist double - *
enforce_path_inversion bool false *
enforce_path_rotation bool false *
inversion_xy_tolerance double 0.2 >=0
inversion_yaw_tolerance double 0.4 >=0
minimum_rotation_angle double 0.785 >=0
reject_unit_path bool false *
"""

_GROUPS = (
    Group(
        "controller_plugins",
        {
            "MPPIController": MPPI, "RegulatedPurePursuitController": _RPP,
            "GracefulController": _GRACEFUL, "DWBLocalPlanner": _DWB,
            "RotationShimController": _SHIM,
        },
        defaults={"FollowPath": "DWBLocalPlanner"},
        setting="controller",
        values={
            "MPPIController": "mppi",
            "RegulatedPurePursuitController": "regulated_pure_pursuit",
        },
    ),
    Group(
        "goal_checker_plugins",
        {
            "SimpleGoalChecker": namespace("goal_checker", _SIMPLE_GOAL),
            "StoppedGoalChecker": namespace("goal_checker", _STOPPED_GOAL),
            "PositionGoalChecker": namespace("goal_checker", _SIMPLE_GOAL),
            "AxisGoalChecker": namespace("axis_goal_checker", _AXIS_GOAL),
            "AdaptiveToleranceGoalChecker": namespace("adaptive_goal_checker", _ADAPTIVE_GOAL),
        },
        defaults={"goal_checker": "SimpleGoalChecker"},
    ),
    Group(
        "progress_checker_plugins",
        {
            "SimpleProgressChecker": namespace("progress_checker", _PROGRESS),
            "PoseProgressChecker": namespace(
                "progress_checker", f"{_PROGRESS}required_movement_angle double 0.5 >=0\n"
            ),
        },
        defaults={"progress_checker": "SimpleProgressChecker"},
    ),
    Group(
        "path_handler_plugins",
        {"FeasiblePathHandler": namespace("path_handler", _PATH_HANDLER)},
        defaults={"PathHandler": "FeasiblePathHandler"},
    ),
)  # fmt: skip

CONTROLLER_SERVER = namespace(
    "controller_server",
    """
controller_frequency double 20.0 >0 =controller_frequency !20.0
controller_plugins strings [FollowPath] * =-
goal_checker_plugins strings [goal_checker] * =-
progress_checker_plugins strings [progress_checker] * =-
path_handler_plugins strings [PathHandler] * =-
min_x_velocity_threshold double 0.0001 >=0
min_y_velocity_threshold double 0.0001 >=0 =- # the robot cannot move sideways
min_theta_velocity_threshold double 0.0001 >=0
failure_tolerance double 0.0 >=-1
costmap_update_timeout double 0.3 >=0
publish_zero_velocity bool true *
odom_topic string odom * !odom
odom_duration double 0.3 >=0
search_window double 2.0 >0
speed_limit_topic string speed_limit *
use_realtime_priority bool false *
""",
    _GROUPS,
)
