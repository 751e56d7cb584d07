"""Error codes of planning, control and goals, as in Nav2."""

from __future__ import annotations

from enum import IntEnum


class ErrorCode(IntEnum):
    """Nav2's error codes (nav2_msgs: FollowPath 100, ComputePathToPose 200, NavigateToPose 9000).

    Codes from 9010 on are Mazebot's: Nav2 has no number for them. A goal that ended with
    WORLD_RESTARTED cannot be evaluated: its world no longer exists.
    """

    NONE = 0
    GOAL_REJECTED = 1
    CONTROLLER_TF_ERROR = 102
    FAILED_TO_MAKE_PROGRESS = 105
    NO_VALID_CONTROL = 106
    START_OUTSIDE_MAP = 203
    GOAL_OUTSIDE_MAP = 204
    START_OCCUPIED = 205
    GOAL_OCCUPIED = 206
    PLANNER_TIMEOUT = 207
    NO_VALID_PATH = 208
    TF_ERROR = 9002
    PREEMPTED = 9010
    WORLD_RESTARTED = 9011
    CANCELED = 9012
