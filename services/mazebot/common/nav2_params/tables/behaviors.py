"""Parameters of the behaviour server, the navigator, the waypoint follower and docking.

Defaults are those of Nav2's code (nav2_behaviors, nav2_bt_navigator, nav2_waypoint_follower,
nav2_docking), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

_SPIN = namespace(
    "spin",
    """
max_rotational_vel double 1.0 >=0 =max_rotational_vel:max_turn
min_rotational_vel double 0.4 >=0
rotational_acc_lim double 3.2 >=0 =rotational_acc_lim:max_turn_accel
simulate_ahead_time double 2.0 >=0
""",
)
_DRIVE = """
acceleration_limit double 2.5 >=0 =acceleration_limit:max_accel
deceleration_limit double -2.5 <=0 =deceleration_limit:min_accel
minimum_speed double 0.1 >=0
simulate_ahead_time double 2.0 >=0
"""
_TELEOP = namespace(
    "assisted_teleop",
    """
projection_time double 1.0 >0
simulation_time_step double 0.1 >0
cmd_vel_teleop string cmd_vel_teleop *
""",
)

BEHAVIOR_SERVER = namespace(
    "behavior_server",
    """
behavior_plugins strings [spin,backup,drive_on_heading,assisted_teleop,wait] * =-
cycle_frequency double 10.0 >0 !20.0 # behaviours run at the controller's 20 Hz
local_frame string odom * !odom
global_frame string map * !map
robot_base_frame string base_link * !base_footprint|base_link
local_costmap_topic string local_costmap/costmap_raw * !default
global_costmap_topic string global_costmap/costmap_raw * !default
local_footprint_topic string local_costmap/published_footprint * !default
global_footprint_topic string global_costmap/published_footprint * !default
transform_tolerance double 0.1 >=0
simulate_ahead_time double 2.0 >=0
max_rotational_vel double 1.0 >=0 =max_rotational_vel:max_turn
min_rotational_vel double 0.4 >=0
rotational_acc_lim double 3.2 >=0 =rotational_acc_lim:max_turn_accel
projection_time double 1.0 >0
simulation_time_step double 0.1 >0
cmd_vel_teleop string cmd_vel_teleop *
""",
    [
        Group(
            "behavior_plugins",
            {
                "Spin": _SPIN,
                "BackUp": namespace("backup", _DRIVE),
                "DriveOnHeading": namespace("drive_on_heading", _DRIVE),
                "AssistedTeleop": _TELEOP,
                "Wait": namespace("wait", ""),
            },
            defaults={
                "spin": "Spin", "backup": "BackUp", "drive_on_heading": "DriveOnHeading",
                "assisted_teleop": "AssistedTeleop", "wait": "Wait",
            },
        )
    ],
)  # fmt: skip

_GROOT = "\nenable_groot_monitoring bool false *\ngroot_server_port int 1667 1..65535\n"

BT_NAVIGATOR = namespace(
    "bt_navigator",
    """
global_frame string map * !map
robot_base_frame string base_link * !base_footprint|base_link
odom_topic string odom * !odom
transform_tolerance double 0.1 >=0
bt_loop_duration int 10 >=1
filter_duration double 0.3 >=0
default_server_timeout int 20 >=0
default_cancel_timeout int 50 >=0
wait_for_service_timeout int 1000 >=0
bt_search_directories strings - *
default_nav_to_pose_bt_xml string - *
default_nav_through_poses_bt_xml string - *
always_reload_bt_xml bool false *
always_reload_bt bool false *
bt_log_idle_transitions bool true *
plugin_lib_names strings [] *
error_code_name_prefixes strings - *
navigators strings [navigate_to_pose,navigate_through_poses] * =-
""",
    [
        Group(
            "navigators",
            {
                "NavigateToPoseNavigator": namespace(
                    "navigate_to_pose",
                    f"goal_blackboard_id string goal *\npath_blackboard_id string path *{_GROOT}",
                ),
                "NavigateThroughPosesNavigator": namespace(
                    "navigate_through_poses",
                    "goals_blackboard_id string goals *\npath_blackboard_id string path *\n"
                    f"waypoint_statuses_blackboard_id string waypoint_statuses *{_GROOT}",
                ),
            },
            defaults={
                "navigate_to_pose": "NavigateToPoseNavigator",
                "navigate_through_poses": "NavigateThroughPosesNavigator",
            },
        )
    ],
)

WAYPOINT_FOLLOWER = namespace(
    "waypoint_follower",
    """
stop_on_failure bool true *
loop_rate int 20 >=1
global_frame_id string map * !map
waypoint_task_executor_plugin string wait_at_waypoint * =-
""",
    [
        Group(
            "waypoint_task_executor_plugin",
            {
                "WaitAtWaypoint": namespace(
                    "wait_at_waypoint",
                    "enabled bool true *\nwaypoint_pause_duration int 0 >=0",
                ),
                "PhotoAtWaypoint": namespace(
                    "photo_at_waypoint",
                    """
enabled bool true *
image_topic string /camera/color/image_raw *
save_dir string /tmp/waypoint_images *
image_format string png *
""",
                ),
                "InputAtWaypoint": namespace(
                    "input_at_waypoint",
                    """
enabled bool true *
timeout double 10.0 >=0
input_topic string input_at_waypoint/input *
""",
                ),
            },
            defaults={"wait_at_waypoint": "WaitAtWaypoint"},
        )
    ],
)

_DOCK = """
docking_threshold double 0.05 >0
staging_x_offset double -0.7 *
staging_yaw_offset double 0.0 *
dock_direction string forward {forward,backward}
rotate_to_dock bool false *
use_external_detection_pose bool false *
external_detection_timeout double 1.0 >=0
external_detection_translation_x double -0.2 *
external_detection_translation_y double 0.0 *
external_detection_rotation_roll double -1.57 *
external_detection_rotation_pitch double 1.57 *
external_detection_rotation_yaw double 0.0 *
filter_coef double 0.1 0..1
use_stall_detection bool false *
stall_velocity_threshold double 1.0 >=0
stall_effort_threshold double 1.0 >=0
stall_joint_names strings [] *
detector_service_name string "" *
detector_service_timeout double 5.0 >=0
subscribe_toggle bool false *
"""
_BATTERY = "use_battery_status bool true *\ncharging_threshold double 0.5 *\n"
_DOCK_INSTANCE = namespace(
    "dock",
    """
type string - *
frame string map *
pose doubles:3 - *
id string "" *
""",
)

_DOCK_CONTROLLER = """
k_phi double 3.0 >=0
k_delta double 2.0 >=0
beta double 0.4 >=0
lambda double 2.0 >=0
v_linear_min double 0.1 >=0
v_linear_max double 0.25 >=0
v_angular_max double 0.75 >=0
slowdown_radius double 0.25 >=0
deceleration_max double 2.5 >=0
rotate_to_heading_angular_vel double 1.0 >=0
rotate_to_heading_max_angular_accel double 3.2 >=0
use_collision_detection bool true *
projection_time double 5.0 >0
simulation_time_step double 0.1 >0
dock_collision_threshold double 0.3 >=0
transform_tolerance double 0.1 >=0
costmap_topic string local_costmap/costmap_raw *
footprint_topic string local_costmap/published_footprint *
"""

DOCKING_SERVER = namespace(
    "docking_server",
    """
controller_frequency double 50.0 >0 !20.0 # docking runs at the controller's 20 Hz
initial_perception_timeout double 5.0 >=0
wait_charge_timeout double 5.0 >=0
dock_approach_timeout double 30.0 >=0
rotate_to_dock_timeout double 10.0 >=0
undock_linear_tolerance double 0.05 >=0
undock_angular_tolerance double 0.05 >=0
max_retries int 3 >=0
base_frame string base_link * !base_footprint|base_link
fixed_frame string odom * !odom
odom_topic string odom * !odom
odom_duration double 0.3 >=0
dock_prestaging_tolerance double 0.5 >=0
rotation_angular_tolerance double 0.05 >=0
navigator_bt_xml string "" *
dock_database string "" *
dock_plugins strings - * =-
docks strings [] * =-
"""
    + "\n".join(f"controller.{row}" for row in _DOCK_CONTROLLER.strip().splitlines()),
    [
        Group(
            "dock_plugins",
            {
                "SimpleChargingDock": namespace("dock_plugin", f"{_DOCK}{_BATTERY}"),
                "SimpleNonChargingDock": namespace("dock_plugin", _DOCK),
            },
        ),
        Group("docks", {"": _DOCK_INSTANCE}, key=""),
    ],
)
