"""Error codes of planning, control, behaviours and goals, as in Nav2."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType


class ErrorCode(IntEnum):
    """Nav2's error codes, each with the action's name where several actions share one.

    The values are those of nav2_msgs/action from Iron to Lyrical: FollowPath 100,
    ComputePathToPose 200, ComputePathThroughPoses 300, routes 400, SmoothPath 500, FollowWaypoints
    600, behaviours 700, docking 900, NavigateToPose 9000, NavigateThroughPoses 9100. Humble has no
    codes.

    Codes from 9010 on are Mazebot's: Nav2 has no number for them. A goal that ended with
    WORLD_RESTARTED cannot be evaluated: its world no longer exists.
    """

    NONE = 0
    GOAL_REJECTED = 1
    SEND_GOAL_FAILURE = 2

    CONTROLLER_UNKNOWN = 100
    INVALID_CONTROLLER = 101
    CONTROLLER_TF_ERROR = 102
    INVALID_PATH = 103
    PATIENCE_EXCEEDED = 104
    FAILED_TO_MAKE_PROGRESS = 105
    NO_VALID_CONTROL = 106
    CONTROLLER_TIMED_OUT = 107
    CONTROLLER_TIMEOUT = 108

    PLANNER_UNKNOWN = 200
    INVALID_PLANNER = 201
    PLANNER_TF_ERROR = 202
    START_OUTSIDE_MAP = 203
    GOAL_OUTSIDE_MAP = 204
    START_OCCUPIED = 205
    GOAL_OCCUPIED = 206
    PLANNER_TIMEOUT = 207
    NO_VALID_PATH = 208

    THROUGH_POSES_UNKNOWN = 300
    THROUGH_POSES_INVALID_PLANNER = 301
    THROUGH_POSES_TF_ERROR = 302
    THROUGH_POSES_START_OUTSIDE_MAP = 303
    THROUGH_POSES_GOAL_OUTSIDE_MAP = 304
    THROUGH_POSES_START_OCCUPIED = 305
    THROUGH_POSES_GOAL_OCCUPIED = 306
    THROUGH_POSES_TIMEOUT = 307
    THROUGH_POSES_NO_VALID_PATH = 308
    NO_VIAPOINTS_GIVEN = 309

    ROUTE_UNKNOWN = 400
    ROUTE_TF_ERROR = 401
    NO_VALID_GRAPH = 402
    INDETERMINANT_NODES_ON_GRAPH = 403
    ROUTE_TIMEOUT = 404
    NO_VALID_ROUTE = 405
    OPERATION_FAILED = 406
    INVALID_EDGE_SCORER_USE = 407

    SMOOTHER_UNKNOWN = 500
    INVALID_SMOOTHER = 501
    SMOOTHER_TIMEOUT = 502
    SMOOTHED_PATH_IN_COLLISION = 503
    FAILED_TO_SMOOTH_PATH = 504
    SMOOTHER_INVALID_PATH = 505

    WAYPOINTS_UNKNOWN = 600
    TASK_EXECUTOR_FAILED = 601
    NO_VALID_WAYPOINTS = 602
    STOP_ON_MISSED_WAYPOINT = 603

    SPIN_UNKNOWN = 700
    SPIN_TIMEOUT = 701
    SPIN_TF_ERROR = 702
    SPIN_COLLISION_AHEAD = 703

    BACKUP_UNKNOWN = 710
    BACKUP_TIMEOUT = 711
    BACKUP_TF_ERROR = 712
    BACKUP_INVALID_INPUT = 713
    BACKUP_COLLISION_AHEAD = 714

    DRIVE_ON_HEADING_UNKNOWN = 720
    DRIVE_ON_HEADING_TIMEOUT = 721
    DRIVE_ON_HEADING_TF_ERROR = 722
    DRIVE_ON_HEADING_COLLISION_AHEAD = 723
    DRIVE_ON_HEADING_INVALID_INPUT = 724

    ASSISTED_TELEOP_UNKNOWN = 730
    ASSISTED_TELEOP_TIMEOUT = 731
    ASSISTED_TELEOP_TF_ERROR = 732

    WAIT_UNKNOWN = 740
    WAIT_TIMEOUT = 741

    DOCK_NOT_IN_DB = 901
    DOCK_NOT_VALID = 902
    FAILED_TO_STAGE = 903
    FAILED_TO_DETECT_DOCK = 904
    FAILED_TO_CONTROL = 905
    FAILED_TO_CHARGE = 906
    DOCKING_TIMEOUT = 907
    DOCKING_UNKNOWN = 999

    NAVIGATOR_UNKNOWN = 9000
    FAILED_TO_LOAD_BEHAVIOR_TREE = 9001
    TF_ERROR = 9002
    NAVIGATOR_TIMEOUT = 9003

    PREEMPTED = 9010
    WORLD_RESTARTED = 9011
    CANCELED = 9012
    NAVIGATION_RESTARTED = 9013

    THROUGH_POSES_NAVIGATOR_UNKNOWN = 9100
    THROUGH_POSES_FAILED_TO_LOAD_BEHAVIOR_TREE = 9101
    THROUGH_POSES_NAVIGATOR_TF_ERROR = 9102
    THROUGH_POSES_NAVIGATOR_TIMEOUT = 9103


def _numbered(first: int, *names: str) -> dict[int, str]:
    return dict(enumerate(names, first))


_PATH = (
    "UNKNOWN", "INVALID_PLANNER", "TF_ERROR", "START_OUTSIDE_MAP", "GOAL_OUTSIDE_MAP",
    "START_OCCUPIED", "GOAL_OCCUPIED", "TIMEOUT", "NO_VALID_PATH",
)  # fmt: skip
_ROUTE = (
    "UNKNOWN", "TF_ERROR", "NO_VALID_GRAPH", "INDETERMINANT_NODES_ON_GRAPH", "TIMEOUT",
    "NO_VALID_ROUTE",
)  # fmt: skip
_DOCK = {902: "DOCK_NOT_VALID", 905: "FAILED_TO_CONTROL", 907: "TIMEOUT", 999: "UNKNOWN"}
_NAVIGATE = ("UNKNOWN", "FAILED_TO_LOAD_BEHAVIOR_TREE", "TF_ERROR", "TIMEOUT")
_OURS = {9010: "PREEMPTED", 9011: "WORLD_RESTARTED", 9012: "CANCELED", 9013: "NAVIGATION_RESTARTED"}

ACTION_CODES: Mapping[str, Mapping[int, str]] = MappingProxyType(
    {
        "FollowPath": _numbered(
            100, "UNKNOWN", "INVALID_CONTROLLER", "TF_ERROR", "INVALID_PATH", "PATIENCE_EXCEEDED",
            "FAILED_TO_MAKE_PROGRESS", "NO_VALID_CONTROL", "CONTROLLER_TIMED_OUT", "TIMEOUT",
        ),
        "ComputePathToPose": _numbered(200, *_PATH),
        "ComputePathThroughPoses": _numbered(300, *_PATH, "NO_VIAPOINTS_GIVEN"),
        "ComputeRoute": {**_numbered(400, *_ROUTE), 407: "INVALID_EDGE_SCORER_USE"},
        "ComputeAndTrackRoute": _numbered(
            400, *_ROUTE, "OPERATION_FAILED", "INVALID_EDGE_SCORER_USE"
        ),
        "SmoothPath": _numbered(
            500, "UNKNOWN", "INVALID_SMOOTHER", "TIMEOUT", "SMOOTHED_PATH_IN_COLLISION",
            "FAILED_TO_SMOOTH_PATH", "INVALID_PATH",
        ),
        "FollowWaypoints": _numbered(
            600, "UNKNOWN", "TASK_EXECUTOR_FAILED", "NO_VALID_WAYPOINTS", "STOP_ON_MISSED_WAYPOINT"
        ),
        "Spin": _numbered(700, "UNKNOWN", "TIMEOUT", "TF_ERROR", "COLLISION_AHEAD"),
        "BackUp": _numbered(
            710, "UNKNOWN", "TIMEOUT", "TF_ERROR", "INVALID_INPUT", "COLLISION_AHEAD"
        ),
        "DriveOnHeading": _numbered(
            720, "UNKNOWN", "TIMEOUT", "TF_ERROR", "COLLISION_AHEAD", "INVALID_INPUT"
        ),
        "AssistedTeleop": _numbered(730, "UNKNOWN", "TIMEOUT", "TF_ERROR"),
        "Wait": _numbered(740, "UNKNOWN", "TIMEOUT"),
        "DockRobot": {
            901: "DOCK_NOT_IN_DB", 903: "FAILED_TO_STAGE", 904: "FAILED_TO_DETECT_DOCK",
            906: "FAILED_TO_CHARGE", **_DOCK,
        },
        "UndockRobot": _DOCK,
        "FollowObject": {
            901: "TF_ERROR", 902: "FAILED_TO_DETECT_OBJECT", 903: "FAILED_TO_CONTROL",
            904: "TIMEOUT", 999: "UNKNOWN",
        },
        "NavigateToPose": {**_numbered(9000, *_NAVIGATE), **_OURS},
        "NavigateThroughPoses": {**_numbered(9100, *_NAVIGATE), **_OURS},
    }
)  # fmt: skip
"""Names of the codes of each action of nav2_msgs. Docking and FollowObject share numbers: a code
means nothing without its action."""

COMMON_CODES: Mapping[int, str] = MappingProxyType(
    {0: "NONE", 1: "GOAL_REJECTED", 2: "SEND_GOAL_FAILURE"}
)
"""Codes that every action has."""


def code_name(action: str, code: int) -> str:
    """Nav2's name of an action's code, or ours, which hold for every action; a code of another
    action with that action's name.

    NavigateToPose ends with the code of what failed in its tree: `code_name("NavigateToPose", 208)`
    is `ComputePathToPose NO_VALID_PATH`.
    """
    if code in COMMON_CODES:
        return COMMON_CODES[code]
    if code in _OURS:
        return _OURS[code]
    if code in ACTION_CODES.get(action, {}):
        return ACTION_CODES[action][code]
    for other, names in ACTION_CODES.items():
        if code in names:
            return f"{other} {names[code]}"
    return f"code {code}"
