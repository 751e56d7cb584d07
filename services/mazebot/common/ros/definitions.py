"""Definitions of ROS 2's services and actions, and of the messages in them that the message library
does not ship: their fields alone, as on the wire.

They differ by distribution, and a type whose hash differs is another type to every node of ROS 2.
"""

from __future__ import annotations

from typing import Final

_TASK_FEEDBACK = (
    "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
    "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
    "float32 distance_remaining\n"
)
_REMAINING = "int16 number_of_poses_remaining\n"
_STATUSES = "WaypointStatus[] waypoint_statuses\n"
_ERROR = "uint16 error_code\nstring error_msg\n"
_BEHAVIOR_RESULT = f"builtin_interfaces/Duration total_elapsed_time\n{_ERROR}"
_STRAIGHT_GOAL = (
    "geometry_msgs/Point target\nfloat32 speed\nbuiltin_interfaces/Duration time_allowance\n"
)
_UNCHECKED = "bool disable_collision_checks\n"
_STRAIGHT_END = f"---\n{_BEHAVIOR_RESULT}---\nfloat32 distance_traveled\n"
_SPIN_GOAL = "float32 target_yaw\nbuiltin_interfaces/Duration time_allowance\n"
_SPIN_END = f"---\n{_BEHAVIOR_RESULT}---\nfloat32 angular_distance_traveled\n"
_WAYPOINTS_GOAL = (
    "uint32 number_of_loops\nuint32 goal_index\ngeometry_msgs/PoseStamped[] poses\n---\n"
)
_WAYPOINTS_FEEDBACK = "---\nuint32 current_waypoint\n"
_TO_POSE = "geometry_msgs/PoseStamped goal\ngeometry_msgs/PoseStamped start\n"
_PLANNED = (
    "string planner_id\nbool use_start\n---\nnav_msgs/Path path\n"
    f"builtin_interfaces/Duration planning_time\n{_ERROR}---\n"
)
_ALONG = (
    "nav_msgs/Path path\nstring controller_id\nstring goal_checker_id\nstring progress_checker_id\n"
)
_THROUGH = (
    f"nav_msgs/Goals poses\nstring behavior_tree\n---\n{_ERROR}{_STATUSES}---\n{_TASK_FEEDBACK}"
)
_RESULT = "Result result\n"
_SPAWNABLE = "string description\nBounds spawn_bounds\n"
_UNSUPPORTED = "bool fail_on_unsupported_element\nbool ignore_missing_or_unsupported_assets\n"

KILTED: Final[dict[str, str]] = {
    "service_msgs/msg/ServiceEventInfo": (
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\n"
        "int64 sequence_number\n"
    ),
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message\n",
    "action_msgs/srv/CancelGoal": "GoalInfo goal_info\n---\nint8 return_code\n"
    "GoalInfo[] goals_canceling\n",
    "lifecycle_msgs/srv/GetState": "---\nState current_state\n",
    "rcl_interfaces/srv/ListParameters": "string[] prefixes\nuint64 depth\n---\n"
    "ListParametersResult result\n",
    "rcl_interfaces/srv/GetParameters": "string[] names\n---\nParameterValue[] values\n",
    "rcl_interfaces/srv/GetParameterTypes": "string[] names\n---\nuint8[] types\n",
    "rcl_interfaces/srv/DescribeParameters": "string[] names\n---\n"
    "ParameterDescriptor[] descriptors\n",
    "rcl_interfaces/srv/SetParameters": "Parameter[] parameters\n---\n"
    "SetParametersResult[] results\n",
    "rcl_interfaces/srv/SetParametersAtomically": "Parameter[] parameters\n---\n"
    "SetParametersResult result\n",
    "nav2_msgs/srv/LoadMap": "string map_url\n---\nnav_msgs/OccupancyGrid map\nuint8 result\n",
    "nav2_msgs/srv/SaveMap": "string map_topic\nstring map_url\nstring image_format\n"
    "string map_mode\nfloat32 free_thresh\nfloat32 occupied_thresh\n---\nbool result\n",
    "slam_toolbox/srv/SaveMap": "std_msgs/String name\n---\nuint8 result\n",
    "slam_toolbox/srv/SerializePoseGraph": "string filename\n---\nuint8 result\n",
    "nav2_msgs/srv/ClearEntireCostmap": "std_msgs/Empty request\n---\nstd_msgs/Empty response\n",
    "nav2_msgs/msg/WaypointStatus": "uint8 waypoint_status\nuint32 waypoint_index\n"
    f"geometry_msgs/PoseStamped waypoint_pose\n{_ERROR}",
    "nav2_msgs/action/NavigateToPose": "geometry_msgs/PoseStamped pose\nstring behavior_tree\n"
    f"---\n{_ERROR}---\n{_TASK_FEEDBACK}",
    "nav2_msgs/action/NavigateThroughPoses": f"{_THROUGH}{_REMAINING}{_STATUSES}",
    "nav_msgs/msg/Goals": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] goals\n",
    "nav2_msgs/action/FollowWaypoints": f"{_WAYPOINTS_GOAL}WaypointStatus[] missed_waypoints\n"
    f"{_ERROR}{_WAYPOINTS_FEEDBACK}",
    "nav2_msgs/action/ComputePathToPose": f"{_TO_POSE}{_PLANNED}",
    "nav2_msgs/action/FollowPath": f"{_ALONG}---\nstd_msgs/Empty result\n{_ERROR}---\n"
    "float32 distance_to_goal\nfloat32 speed\n",
    "nav2_msgs/action/Spin": f"{_SPIN_GOAL}{_UNCHECKED}{_SPIN_END}",
    "nav2_msgs/action/BackUp": f"{_STRAIGHT_GOAL}{_UNCHECKED}{_STRAIGHT_END}",
    "nav2_msgs/action/DriveOnHeading": f"{_STRAIGHT_GOAL}{_UNCHECKED}{_STRAIGHT_END}",
    "nav2_msgs/action/Wait": f"builtin_interfaces/Duration time\n---\n{_BEHAVIOR_RESULT}---\n"
    "builtin_interfaces/Duration time_left\n",
    "nav2_msgs/action/AssistedTeleop": "builtin_interfaces/Duration time_allowance\n---\n"
    f"{_BEHAVIOR_RESULT}---\nbuiltin_interfaces/Duration current_teleop_duration\n",
    "nav2_msgs/action/DockRobot": "bool use_dock_id\nstring dock_id\n"
    "geometry_msgs/PoseStamped dock_pose\nstring dock_type\nfloat32 max_staging_time\n"
    "bool navigate_to_staging_pose\n---\nbool success\nuint16 error_code\nuint16 num_retries\n"
    "string error_msg\n---\nuint16 state\nbuiltin_interfaces/Duration docking_time\n"
    "uint16 num_retries\n",
    "nav2_msgs/action/UndockRobot": "string dock_type\nfloat32 max_undocking_time\n---\n"
    f"bool success\n{_ERROR}---\n",
    "simulation_interfaces/msg/Result": "uint8 result\nstring error_message\n",
    "simulation_interfaces/msg/SimulationState": "uint8 state\n",
    "simulation_interfaces/msg/SimulatorFeatures": "uint16[] features\nstring[] spawn_formats\n"
    "string custom_info\n",
    "simulation_interfaces/msg/EntityCategory": "uint8 category\n",
    "simulation_interfaces/msg/TagsFilter": "string[] tags\nuint8 filter_mode\n",
    "simulation_interfaces/msg/Bounds": "uint8 type\ngeometry_msgs/Vector3[] points\n",
    "simulation_interfaces/msg/EntityFilters": "string filter\nEntityCategory[] categories\n"
    "TagsFilter tags\nBounds bounds\n",
    "simulation_interfaces/msg/EntityState": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Twist twist\ngeometry_msgs/Accel acceleration\n",
    "simulation_interfaces/srv/GetSimulatorFeatures": "---\nSimulatorFeatures features\n",
    "simulation_interfaces/srv/SpawnEntity": "string name\nbool allow_renaming\nstring uri\n"
    "string resource_string\nstring entity_namespace\ngeometry_msgs/PoseStamped initial_pose\n"
    f"---\n{_RESULT}string entity_name\n",
    "simulation_interfaces/srv/DeleteEntity": f"string entity\n---\n{_RESULT}",
    "simulation_interfaces/srv/GetEntities": f"EntityFilters filters\n---\n{_RESULT}"
    "string[] entities\n",
    "simulation_interfaces/srv/GetEntitiesStates": f"EntityFilters filters\n---\n{_RESULT}"
    "string[] entities\nEntityState[] states\n",
    "simulation_interfaces/srv/GetEntityState": f"string entity\n---\n{_RESULT}"
    "EntityState state\n",
    "simulation_interfaces/srv/SetEntityState": f"string entity\nEntityState state\n---\n{_RESULT}",
    "simulation_interfaces/msg/EntityInfo": "EntityCategory category\nstring description\n"
    "string[] tags\n",
    "simulation_interfaces/srv/GetEntityInfo": f"string entity\n---\n{_RESULT}EntityInfo info\n",
    "simulation_interfaces/srv/GetEntityBounds": f"string entity\n---\n{_RESULT}Bounds bounds\n",
    "simulation_interfaces/msg/Spawnable": f"string uri\n{_SPAWNABLE}",
    "simulation_interfaces/srv/GetSpawnables": f"string[] sources\n---\n{_RESULT}"
    "Spawnable[] spawnables\n",
    "simulation_interfaces/msg/NamedPose": "string name\nstring description\nstring[] tags\n"
    "geometry_msgs/Pose pose\n",
    "simulation_interfaces/srv/GetNamedPoses": f"TagsFilter tags\n---\n{_RESULT}"
    "NamedPose[] poses\n",
    "simulation_interfaces/srv/GetSimulationState": f"---\nSimulationState state\n{_RESULT}",
    "simulation_interfaces/srv/SetSimulationState": f"SimulationState state\n---\n{_RESULT}",
    "simulation_interfaces/srv/ResetSimulation": f"uint8 scope\n---\n{_RESULT}",
    "simulation_interfaces/srv/StepSimulation": f"uint64 steps\n---\n{_RESULT}",
    "simulation_interfaces/action/SimulateSteps": f"uint64 steps\n---\n{_RESULT}---\n"
    "uint64 completed_steps\nuint64 remaining_steps\n",
    "simulation_interfaces/msg/Resource": "string uri\nstring resource_string\n",
    "simulation_interfaces/msg/WorldResource": "string name\nResource world_resource\n"
    "string description\nstring[] tags\n",
    "simulation_interfaces/srv/LoadWorld": f"string uri\nstring resource_string\n{_UNSUPPORTED}"
    f"---\n{_RESULT}WorldResource world\n",
    "simulation_interfaces/srv/GetCurrentWorld": f"---\n{_RESULT}WorldResource world\n",
    "simulation_interfaces/srv/GetAvailableWorlds": "string[] additional_sources\n"
    "TagsFilter filter\nbool offline_only\nbool continue_on_error\n---\n"
    f"{_RESULT}WorldResource[] worlds\n",
}  # fmt: skip

JAZZY: Final[dict[str, str]] = {
    **KILTED,
    "nav2_msgs/msg/MissedWaypoint": "uint32 index\ngeometry_msgs/PoseStamped goal\n"
    "uint16 error_code\n",
    "nav2_msgs/action/FollowWaypoints": f"{_WAYPOINTS_GOAL}MissedWaypoint[] missed_waypoints\n"
    f"{_ERROR}{_WAYPOINTS_FEEDBACK}",
    "nav2_msgs/action/NavigateThroughPoses": "geometry_msgs/PoseStamped[] poses\n"
    f"string behavior_tree\n---\n{_ERROR}---\n{_TASK_FEEDBACK}{_REMAINING}",
    "nav2_msgs/action/Spin": f"{_SPIN_GOAL}{_SPIN_END}",
    "nav2_msgs/action/BackUp": f"{_STRAIGHT_GOAL}{_STRAIGHT_END}",
    "nav2_msgs/action/DriveOnHeading": f"{_STRAIGHT_GOAL}{_STRAIGHT_END}",
}  # fmt: skip

_TRACKING = "float32 position_tracking_error\nfloat32 heading_tracking_error\n"
_CLEARED = "---\nbool success\n"

LYRICAL: Final[dict[str, str]] = {
    **KILTED,
    "nav2_msgs/action/NavigateToPose": KILTED["nav2_msgs/action/NavigateToPose"] + _TRACKING,
    "nav2_msgs/action/NavigateThroughPoses": f"{_THROUGH}{_TRACKING}{_REMAINING}{_STATUSES}",
    "nav2_msgs/action/ComputePathToPose": f"{_TO_POSE}geometry_msgs/PoseStamped[] viapoints\n"
    f"{_PLANNED}",
    "nav2_msgs/msg/TrackingFeedback": f"std_msgs/Header header\n{_TRACKING}"
    "uint32 current_path_index\ngeometry_msgs/PoseStamped robot_pose\n"
    "float32 distance_to_goal\nfloat32 speed\nfloat32 remaining_path_length\n",
    "nav2_msgs/action/FollowPath": f"{_ALONG}string path_handler_id\n---\n"
    f"std_msgs/Empty result\n{_ERROR}---\nTrackingFeedback tracking_feedback\n",
    "nav2_msgs/srv/ClearEntireCostmap": f"string[] plugins\n{_CLEARED}",
    "simulation_interfaces/srv/LoadWorld": f"Resource world_resource\n{_UNSUPPORTED}---\n"
    f"{_RESULT}WorldResource world\n",
    "simulation_interfaces/srv/SpawnEntity": "string name\nbool allow_renaming\n"
    "Resource entity_resource\nstring entity_namespace\ngeometry_msgs/PoseStamped initial_pose\n"
    f"---\n{_RESULT}string entity_name\n",
    "simulation_interfaces/msg/Spawnable": f"Resource entity_resource\n{_SPAWNABLE}",
    "simulation_interfaces/srv/SetEntityState": "string entity\nEntityState state\n"
    f"bool set_pose\nbool set_twist\nbool set_acceleration\n---\n{_RESULT}",
}  # fmt: skip

DISTROS: Final = {"jazzy": JAZZY, "kilted": KILTED, "lyrical": LYRICAL}
OTHER_SIMULATION: Final = {"jazzy": "lyrical", "kilted": "lyrical", "lyrical": "kilted"}
"""A distribution with the other version of simulation_interfaces: 2.x for 1.x, and 1.x for 2.x."""
