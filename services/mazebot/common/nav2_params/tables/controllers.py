"""Parameters of the controller server and of its plugins.

Defaults are those of Nav2's code (nav2_controller, nav2_regulated_pure_pursuit_controller,
nav2_graceful_controller, nav2_dwb_controller, nav2_rotation_shim_controller), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, Namespace, joined, namespace
from mazebot.common.nav2_params.tables.mppi import MPPI

_RPP = namespace(
    "regulated_pure_pursuit",
    """
max_linear_vel double 0.5 >=0 =/controller_server.max_linear_vel:max_speed
max_angular_vel double 2.5 >=0 =/controller_server.max_angular_vel:max_turn
max_linear_accel double 2.5 >=0 =/controller_server.max_linear_accel:max_accel
max_angular_accel double 3.2 >=0 =/controller_server.max_angular_accel:max_turn_accel
lookahead_dist double 0.6 >0
min_lookahead_dist double 0.3 >0
max_lookahead_dist double 0.9 >0
lookahead_time double 1.5 >0
use_velocity_scaled_lookahead_dist bool false *
rotate_to_heading_angular_vel double 1.8 >=0 =:max_turn
use_rotate_to_heading bool true *
rotate_to_heading_min_angle double 0.785 >=0
min_approach_linear_velocity double 0.05 >=0 =:max_speed
approach_velocity_scaling_dist double 0.6 >=0
use_collision_detection bool true *
max_allowed_time_to_collision_up_to_carrot double 1.0 >=0
use_regulated_linear_velocity_scaling bool true *
regulated_linear_scaling_min_radius double 0.9 >=0
regulated_linear_scaling_min_speed double 0.25 >=0 =:max_speed
use_cost_regulated_linear_velocity_scaling bool true *
cost_scaling_dist double 0.6 >=0
cost_scaling_gain double 1.0 >=0
- min_linear_vel min_angular_vel max_linear_decel max_angular_decel min_distance_to_obstacle
- inflation_cost_scaling_factor use_fixed_curvature_lookahead curvature_lookahead_dist
- interpolate_curvature_after_goal allow_reversing use_cancel_deceleration cancel_deceleration
- use_dynamic_window allow_obstacle_checking_beyond_goal
""",
)

_LIMITED = "the controller is not supported: MPPI keeps to its limits"

_GRACEFUL = namespace(
    "mppi",
    f"""
v_linear_max double 0.5 >=0 =vx_max:max_speed # {_LIMITED}
v_angular_max double 1.0 >=0 =wz_max:max_turn # {_LIMITED}
allow_backward bool false * =vx_min:backward # {_LIMITED}
- min_lookahead max_lookahead max_robot_pose_search_dist k_phi k_delta beta lambda v_linear_min
- v_angular_min_in_place slowdown_radius initial_rotation
- initial_rotation_tolerance prefer_final_rotation rotation_scaling_factor
- in_place_collision_resolution use_collision_detection
""",
    note="GracefulController is not supported",
)

_DWB = namespace(
    "mppi",
    f"""
max_vel_x double 0.0 >=0 =vx_max:max_speed # {_LIMITED}
max_speed_xy double 0.0 * =/controller_server.max_linear_vel:speed_limit # {_LIMITED}
max_vel_theta double 0.0 >=0 =wz_max:max_turn # {_LIMITED}
acc_lim_x double 0.0 >=0 =ax_max:max_accel # {_LIMITED}
decel_lim_x double 0.0 <=0 =ax_min:min_accel # {_LIMITED}
acc_lim_theta double 0.0 >=0 =az_max:turn_accel_limit # {_LIMITED}
decel_lim_theta double 0.0 <=0 =az_max:turn_accel_limit # {_LIMITED}
min_vel_x double 0.0 * =vx_min:least_speed # {_LIMITED}
- min_vel_y max_vel_y acc_lim_y decel_lim_y min_speed_xy
- min_speed_theta debug_trajectory_details vx_samples vy_samples vtheta_samples sim_time
- sim_granularity time_granularity discretize_by_time linear_granularity angular_granularity
- include_last_point limit_vel_cmd_in_traj trajectory_generator_name goal_checker_name
- default_critic_namespaces transform_tolerance xy_goal_tolerance yaw_goal_tolerance
- trans_stopped_velocity rot_stopped_velocity short_circuit_trajectory_evaluation stateful use_dwb
- critics BaseObstacle.scale BaseObstacle.sum_scores ObstacleFootprint.scale
- ObstacleFootprint.sum_scores PathAlign.scale PathAlign.forward_point_distance
- PathAlign.aggregation_type GoalAlign.scale GoalAlign.forward_point_distance
- GoalAlign.aggregation_type PathDist.scale PathDist.aggregation_type GoalDist.scale
- GoalDist.aggregation_type RotateToGoal.scale RotateToGoal.slowing_factor
- RotateToGoal.lookahead_time Oscillation.scale Oscillation.oscillation_reset_dist
- Oscillation.oscillation_reset_angle Oscillation.oscillation_reset_time
- Oscillation.x_only_threshold PreferForward.scale PreferForward.penalty PreferForward.strafe_x
- PreferForward.strafe_theta PreferForward.theta_scale Twirling.scale
""",
    note="DWB is not supported",
)

_OTHERS = namespace(
    "mppi",
    f"""
max_vel_x double - >=0 =vx_max:speed_limit # {_LIMITED}
max_linear_vel double - >=0 =vx_max:speed_limit # {_LIMITED}
desired_linear_vel double - >=0 =vx_max:speed_limit # {_LIMITED}
min_vel_x double - * =vx_min:least_speed # {_LIMITED}
max_vel_x_backwards double - >=0 =vx_min:backward_limit # {_LIMITED}
max_trans_vel double - * =/controller_server.max_linear_vel:speed_limit # {_LIMITED}
max_vel_trans double - * =/controller_server.max_linear_vel:speed_limit # {_LIMITED}
max_speed_xy double - * =/controller_server.max_linear_vel:speed_limit # {_LIMITED}
max_vel_theta double - >=0 =wz_max:turn_limit # {_LIMITED}
max_angular_vel double - >=0 =wz_max:turn_limit # {_LIMITED}
max_rot_vel double - >=0 =wz_max:turn_limit # {_LIMITED}
rotate_to_heading_angular_vel double - >=0 =:turn_limit # {_LIMITED}
acc_lim_x double - >=0 =ax_max:accel_limit # {_LIMITED}
max_linear_accel double - >=0 =ax_max:accel_limit # {_LIMITED}
acc_lim_theta double - >=0 =az_max:turn_accel_limit # {_LIMITED}
max_angular_accel double - >=0 =/controller_server.max_angular_accel:turn_accel_limit # {_LIMITED}
""",
)
"""The limits of controllers that are none of Nav2's own, such as teb_local_planner,
neo_local_planner2 and vector_pursuit_controller: the robot must not be faster than it was told."""

_ITSELF = "the controller turns the robot itself"
_TURNS = "the shim before it turns the robot towards the path"
_TURNED_RPP = joined(
    _RPP,
    namespace(
        "regulated_pure_pursuit",
        f"""
use_rotate_to_heading bool true * =:always # {_TURNS}
rotate_to_heading_angular_vel double 1.8 >=0 =:turn_limit
max_angular_accel double 3.2 >=0 =/controller_server.max_angular_accel:turn_accel_limit
- rotate_to_heading_min_angle # {_TURNS}: its angular_dist_threshold counts
""",
    ),
)
"""Regulated pure pursuit behind a rotation shim: here it turns by itself."""

_CONTROLLERS = {
    "MPPIController": MPPI, "RegulatedPurePursuitController": _RPP,
    "GracefulController": _GRACEFUL, "DWBLocalPlanner": _DWB,
}  # fmt: skip
_SETTING = "/controller_server.controller"
_VALUES = {"MPPIController": "mppi", "RegulatedPurePursuitController": "regulated_pure_pursuit"}


def _shim(driving: str) -> Namespace:
    """A rotation shim before a controller, where this one of ours drives."""
    ours = f"/controller_server.{driving}"
    return namespace(
        "",
        f"""
angular_dist_threshold double 0.785 >=0 ={ours}.rotate_to_heading_min_angle
rotate_to_heading_angular_vel double 1.8 >=0 ={ours}.rotate_to_heading_angular_vel:turn_limit
max_angular_accel double 3.2 >=0 =/controller_server.max_angular_accel:turn_accel_limit
- rotate_to_goal_heading # at the goal the robot turns in any case
- angular_disengage_threshold forward_sampling_distance simulate_ahead_time # {_ITSELF}
- rotate_to_heading_once closed_loop use_path_orientations max_cost_threshold # {_ITSELF}
""",
        [
            Group(
                "",
                {**_CONTROLLERS, "RegulatedPurePursuitController": _TURNED_RPP},
                defaults={"primary_controller": ""},
                setting=_SETTING,
                values=_VALUES,
                others=_OTHERS,
            )
        ],
    )


_SIMPLE_GOAL = """
xy_goal_tolerance double 0.25 >=0 =:no_limit
xy_goal_tolerance_buffer double 0.0 >=0
yaw_goal_tolerance double 0.25 >=0 =:no_limit
path_length_tolerance double 1.0 >=0 =:no_limit
stateful bool true *
symmetric_yaw_tolerance bool false *
"""
_POSITION_GOAL = """
xy_goal_tolerance double 0.25 >=0 =:no_limit
xy_goal_tolerance_buffer double 0.0 >=0
path_length_tolerance double 1.0 >=0 =:no_limit
stateful bool true *
"""
_STOPPED_GOAL = f"""{_SIMPLE_GOAL}
rot_stopped_velocity double 0.25 >=0
trans_stopped_velocity double 0.25 >=0
"""
_AXIS_GOAL = """
- along_path_tolerance cross_track_tolerance path_length_tolerance direction_estimation
- is_overshoot_valid
"""
_ADAPTIVE_GOAL = """
- fine_xy_goal_tolerance coarse_xy_goal_tolerance yaw_goal_tolerance trans_stopped_velocity
- rot_stopped_velocity required_stagnation_cycles path_length_tolerance stateful
- symmetric_yaw_tolerance
"""
_PROGRESS = """
required_movement_radius double 0.5 >=0
movement_time_allowance double 10.0 >=0 =:no_limit
"""
_PATH_HANDLER = """
prune_distance double 2.0 >0
max_robot_pose_search_dist double - * =:whole_path
enforce_path_inversion bool false * =- !true # a path is followed up to where it turns back first
inversion_xy_tolerance double 0.2 >0 =- !0.2
- transform_tolerance enforce_path_rotation inversion_yaw_tolerance minimum_rotation_angle
- reject_unit_path
"""

_GROUPS = (
    Group(
        "controller_plugins",
        {**_CONTROLLERS, "RotationShimController": _shim("mppi")},
        defaults={"FollowPath": "DWBLocalPlanner"},
        setting=_SETTING,
        values=_VALUES,
        wraps={"RotationShimController": "primary_controller"},
        before={"RegulatedPurePursuitController": _shim("regulated_pure_pursuit")},
        others=_OTHERS,
    ),
    Group(
        "goal_checker_plugins",
        {
            "SimpleGoalChecker": namespace("general_goal_checker", _SIMPLE_GOAL),
            "StoppedGoalChecker": namespace("general_goal_checker", _STOPPED_GOAL),
            "PositionGoalChecker": namespace("general_goal_checker", _POSITION_GOAL),
            "AxisGoalChecker": namespace(
                "axis_goal_checker", _AXIS_GOAL, note="AxisGoalChecker is not supported"
            ),
            "AdaptiveToleranceGoalChecker": namespace(
                "adaptive_goal_checker", _ADAPTIVE_GOAL,
                note="AdaptiveToleranceGoalChecker is not supported",
            ),
        },
        defaults={"goal_checker": "SimpleGoalChecker"},
        implied={"PositionGoalChecker": ("position_only", True, "any heading counts as reached")},
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
        implied={"SimpleProgressChecker": ("position_only", True, "turning is no progress")},
    ),
    Group(
        "path_handler_plugins",
        {"FeasiblePathHandler": namespace("path_handler", _PATH_HANDLER)},
        defaults={"PathHandler": "FeasiblePathHandler"},
    ),
)  # fmt: skip

CONTROLLER_SERVER = namespace(
    "navigation.controller_server",
    """
controller_frequency double 20.0 >0 !20.0
failure_tolerance double 0.0 >=-1 =:no_limit
controller_plugins strings [FollowPath] * =-
goal_checker_plugins strings [goal_checker] *
progress_checker_plugins strings [progress_checker] *
path_handler_plugins strings [PathHandler] *
odom_topic string odom * !odom
- min_y_velocity_threshold # the robot cannot move sideways
- min_x_velocity_threshold min_theta_velocity_threshold costmap_update_timeout
- publish_zero_velocity odom_duration search_window speed_limit_topic use_realtime_priority
""",
    _GROUPS,
)
