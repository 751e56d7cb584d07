"""The node kinds of the 15 trees that Nav2 ships, with the ports that they give.

Facts read from ros-navigation/navigation2, nav2_bt_navigator/behavior_trees, Humble to Lyrical; the
files themselves are not copied.
"""

from __future__ import annotations

_CODES = {"error_code_id": "{code}", "error_msg": "{message}"}
_PLUGIN = ("planner", "controller", "goal_checker", "progress_checker", "path_handler", "smoother")

CONTROLS: dict[str, dict[str, str]] = {
    "Sequence": {},
    "SequenceWithMemory": {},
    "Fallback": {},
    "ReactiveSequence": {},
    "ReactiveFallback": {},
    "PipelineSequence": {},
    "RecoveryNode": {"number_of_retries": "6"},
    "RoundRobin": {},
}
DECORATORS: dict[str, dict[str, str]] = {
    "RateController": {"hz": "0.333"},
    "DistanceController": {"distance": "1.0"},
    "SpeedController": {
        "min_rate": "0.1",
        "max_rate": "1.0",
        "min_speed": "0.0",
        "max_speed": "0.26",
    },
    "GoalUpdater": {"input_goal": "{goal}", "output_goal": "{updated_goal}"},
    "GoalUpdatedController": {},
    "PathLongerOnApproach": {"path": "{path}", "prox_len": "3.0", "length_factor": "2.0"},
    "Inverter": {},
    "KeepRunningUntilFailure": {},
    "RetryUntilSuccessful": {"num_attempts": "1"},
    "Repeat": {"num_cycles": "3"},
}
LEAVES: dict[str, dict[str, str]] = {
    "ComputePathToPose": {
        "start": "{start}",
        "goal": "{goal}",
        "path": "{path}",
        "planner_id": "{id}",
        **_CODES,
    },
    "ComputePathThroughPoses": {
        "goals": "{goals}",
        "path": "{path}",
        "planner_id": "GridBased",
        **_CODES,
    },
    "FollowPath": {
        "path": "{path}",
        "controller_id": "FollowPath",
        "goal_checker_id": "{id}",
        "progress_checker_id": "{id}",
        "path_handler_id": "{id}",
        "tracking_feedback": "{tracking_feedback}",
        **_CODES,
    },
    "ClearEntireCostmap": {"service_name": "local_costmap/clear_entirely_local_costmap"},
    "Spin": {"spin_dist": "1.57", "is_recovery": "false", **_CODES},
    "Wait": {"wait_duration": "5", **_CODES},
    "BackUp": {"backup_dist": "0.30", "backup_speed": "0.15", **_CODES},
    "DriveOnHeading": {"dist_to_travel": "2.0", "speed": "0.2", "time_allowance": "12"},
    "GoalUpdated": {},
    "GlobalUpdatedGoal": {},
    "IsGoalNearby": {
        "path": "{path}",
        "proximity_threshold": "4.0",
        "max_robot_pose_search_dist": "1.5",
    },
    "TruncatePath": {"distance": "1.0", "input_path": "{path}", "output_path": "{cut}"},
    "TruncatePathLocal": {
        "input_path": "{path}",
        "output_path": "{remaining_path}",
        "distance_forward": "-1",
        "distance_backward": "0.0",
    },
    "ValidatePath": {"path": "{remaining_path}"},
    "IsPathValid": {"path": "{remaining_path}"},
    "WouldAPlannerRecoveryHelp": {"error_code": "{code}"},
    "WouldAControllerRecoveryHelp": {"error_code": "{code}"},
    "WouldARouteRecoveryHelp": {"error_code": "{code}"},
    **{
        "".join(part.title() for part in what.split("_")) + "Selector": {
            "topic_name": f"{what}_selector",
            f"default_{what}": "name",
            f"selected_{what}": f"{{selected_{what}}}",
        }
        for what in _PLUGIN
    },
    "RemovePassedGoals": {
        "input_goals": "{goals}",
        "output_goals": "{goals}",
        "radius": "0.7",
        "input_waypoint_statuses": "{waypoint_statuses}",
        "output_waypoint_statuses": "{waypoint_statuses}",
    },
    "CancelControl": {"name": "ControlCancel"},
    "PathExpiringTimer": {"seconds": "10", "path": "{path}"},
    "IsWithinPathTrackingBounds": {
        "max_position_error_left": "0.2",
        "max_position_error_right": "0.2",
        "max_heading_error": "3.14",
        "tracking_feedback": "{tracking_feedback}",
    },
    "GetCurrentPose": {"current_pose": "{current_pose}"},
    "GetPoseFromPath": {"path": "{path}", "index": "-1", "pose": "{end}"},
    "ArePosesNear": {"ref_pose": "{goal}", "target_pose": "{end}", "tolerance": "0.1"},
    "ConcatenatePaths": {
        "input_path1": "{path}",
        "input_path2": "{cut}",
        "output_path": "{joined}",
    },
    "SmoothPath": {
        "unsmoothed_path": "{path}",
        "smoothed_path": "{path}",
        "smoother_id": "route_smoother",
        **_CODES,
    },
    "AppendGoalPoseToGoals": {
        "input_goals": "{goals}",
        "output_goals": "{goals}",
        "goal_pose": "{goal}",
    },
    "GetNextFewGoals": {"input_goals": "{goals}", "num_goals": "2", "output_goals": "{next}"},
}
NOT_RUNNING: dict[str, dict[str, str]] = {
    "ComputeRoute": {
        "goal": "{goal}",
        "path": "{path}",
        "route": "{route}",
        "use_poses": "true",
        **_CODES,
    },
    "ExtractRouteNodesAsGoals": {"route": "{route}", "goals": "{route_goals}"},
}


def element(kind: str, ports: dict[str, str], inside: str = "") -> str:
    given = "".join(f' {name}="{text}"' for name, text in ports.items())
    return f"<{kind}{given}>{inside}</{kind}>" if inside else f"<{kind}{given}/>"


def document(inside: str, attributes: str = 'BTCPP_format="4" main_tree_to_execute="Main"') -> str:
    return f'<root {attributes}><BehaviorTree ID="Main">{inside}</BehaviorTree></root>'
