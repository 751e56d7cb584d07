"""Parameters of the behaviour server, the navigator, the waypoint follower and docking.

Defaults are those of Nav2's code (nav2_behaviors, nav2_bt_navigator, nav2_waypoint_follower,
nav2_docking), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

_TURN = """
max_rotational_vel double 1.0 >=0 =/behavior_server.max_rotational_vel:max_turn
min_rotational_vel double 0.4 >=0 =/behavior_server.min_rotational_vel:max_turn
rotational_acc_lim double 3.2 >=0 =/behavior_server.rotational_acc_lim:max_turn_accel
simulate_ahead_time double 2.0 >=0 =/behavior_server.simulate_ahead_time
"""
_DRIVE = """
acceleration_limit double 2.5 >=0 =/behavior_server.acceleration_limit:max_accel
deceleration_limit double -2.5 <=0 =/behavior_server.deceleration_limit:min_accel
minimum_speed double 0.1 >=0 =/behavior_server.minimum_speed:max_speed
simulate_ahead_time double 2.0 >=0 =/behavior_server.simulate_ahead_time
"""
_TELEOP = """
projection_time double 1.0 >0 =/behavior_server.projection_time
- simulation_time_step cmd_vel_teleop
"""

BEHAVIOR_SERVER = namespace(
    "navigation.behavior_server",
    f"""{_TURN}{_TELEOP}
behavior_plugins strings [spin,backup,drive_on_heading,assisted_teleop,wait] * =-
cycle_frequency double 10.0 >0 !20.0 # behaviors run at the controller's 20 Hz
local_frame string odom * !odom
global_frame string map * !map
robot_base_frame string base_link * !base_footprint|base_link
local_costmap_topic string local_costmap/costmap_raw * !default
global_costmap_topic string global_costmap/costmap_raw * !default
local_footprint_topic string local_costmap/published_footprint * !default
global_footprint_topic string global_costmap/published_footprint * !default
- transform_tolerance
""",
    [
        Group(
            "behavior_plugins",
            {
                "Spin": namespace("spin", _TURN),
                "BackUp": namespace("backup", _DRIVE),
                "DriveOnHeading": namespace("drive_on_heading", _DRIVE),
                "AssistedTeleop": namespace("assisted_teleop", _TELEOP),
                "Wait": namespace("wait", ""),
            },
            defaults={
                "spin": "Spin", "backup": "BackUp", "drive_on_heading": "DriveOnHeading",
                "assisted_teleop": "AssistedTeleop", "wait": "Wait",
            },
            always=(("Spin",), ("BackUp",), ("DriveOnHeading",), ("AssistedTeleop",), ("Wait",)),
        )
    ],
)  # fmt: skip

_GROOT = "\n- path_blackboard_id enable_groot_monitoring groot_server_port\n"

BT_NAVIGATOR = namespace(
    "navigation.bt_navigator",
    """
global_frame string map * !map
robot_base_frame string base_link * !base_footprint|base_link
odom_topic string odom * !odom
navigators strings [navigate_to_pose,navigate_through_poses] * =-
- default_nav_to_pose_bt_xml default_nav_through_poses_bt_xml # must be set in our own settings
- transform_tolerance bt_loop_duration filter_duration default_server_timeout
- default_cancel_timeout wait_for_service_timeout bt_search_directories always_reload_bt_xml
- always_reload_bt bt_log_idle_transitions plugin_lib_names error_code_name_prefixes
""",
    [
        Group(
            "navigators",
            {
                "NavigateToPoseNavigator": namespace(
                    "navigate_to_pose", f"- goal_blackboard_id{_GROOT}"
                ),
                "NavigateThroughPosesNavigator": namespace(
                    "navigate_through_poses",
                    f"- goals_blackboard_id waypoint_statuses_blackboard_id{_GROOT}",
                ),
            },
            defaults={
                "navigate_to_pose": "NavigateToPoseNavigator",
                "navigate_through_poses": "NavigateThroughPosesNavigator",
            },
            always=(("NavigateToPoseNavigator",), ("NavigateThroughPosesNavigator",)),
        )
    ],
)

WAYPOINT_FOLLOWER = namespace(
    "navigation.waypoint_follower",
    """
stop_on_failure bool true *
global_frame_id string map * !map
waypoint_task_executor_plugin string wait_at_waypoint * =-
- loop_rate
""",
    [
        Group(
            "waypoint_task_executor_plugin",
            {
                "WaitAtWaypoint": namespace(
                    "wait_at_waypoint", "- enabled waypoint_pause_duration"
                ),
                "PhotoAtWaypoint": namespace(
                    "photo_at_waypoint",
                    "- enabled image_topic save_dir image_format",
                    note="PhotoAtWaypoint is not supported",
                ),
                "InputAtWaypoint": namespace(
                    "input_at_waypoint",
                    "- enabled timeout input_topic",
                    note="InputAtWaypoint is not supported",
                ),
            },
            defaults={"wait_at_waypoint": "WaitAtWaypoint"},
        )
    ],
)

_DOCK = """
staging_x_offset double -0.7 * =/docking_server.staging_x_offset:in_front
external_detection_timeout double 1.0 >=0 =/docking_server.external_detection_timeout:no_limit
dock_direction string forward {forward,backward} =- !forward
use_external_detection_pose bool false * =- !true
- docking_threshold staging_yaw_offset rotate_to_dock
- external_detection_translation_x external_detection_translation_y
- external_detection_rotation_roll external_detection_rotation_pitch
- external_detection_rotation_yaw filter_coef use_stall_detection stall_velocity_threshold
- stall_effort_threshold stall_joint_names detector_service_name detector_service_timeout
- subscribe_toggle
"""

DOCKING_SERVER = namespace(
    "navigation.docking_server",
    """
controller_frequency double 50.0 >0 !20.0 # docking runs at the controller's 20 Hz
initial_perception_timeout double 5.0 >=0 =:no_limit
dock_approach_timeout double 30.0 >=0 =:no_limit
undock_linear_tolerance double 0.05 >=0
undock_angular_tolerance double 0.05 >=0
max_retries int 3 >=0
dock_prestaging_tolerance double 0.5 >=0
base_frame string base_link * !base_footprint|base_link
fixed_frame string odom * !odom
odom_topic string odom * !odom
dock_plugins strings - * =-
docks strings [] * =-
controller.k_phi double 3.0 >=0
controller.k_delta double 2.0 >=0
controller.beta double 0.4 >=0
controller.lambda double 2.0 >=0 =controller.lambda_
controller.v_linear_min double 0.1 >=0 =:max_speed
controller.v_linear_max double 0.25 >=0 =:max_speed
controller.v_angular_max double 0.75 >=0 =:max_turn
controller.slowdown_radius double 0.25 >=0
controller.rotate_to_heading_angular_vel double 1.0 >=0 =:max_turn
- controller.deceleration_max controller.rotate_to_heading_max_angular_accel
- controller.use_collision_detection controller.projection_time controller.simulation_time_step
- controller.dock_collision_threshold controller.transform_tolerance controller.costmap_topic
- controller.footprint_topic wait_charge_timeout rotate_to_dock_timeout odom_duration
- rotation_angular_tolerance navigator_bt_xml dock_database
""",
    [
        Group(
            "dock_plugins",
            {
                "SimpleChargingDock": namespace(
                    "dock_plugin", f"{_DOCK}- use_battery_status charging_threshold"
                ),
                "SimpleNonChargingDock": namespace("dock_plugin", _DOCK),
            },
        ),
        Group("docks", {"": namespace("dock", "- type frame pose id")}, key=""),
    ],
)
