"""Replies to queries for paths, and to requests to clear costmaps."""

from __future__ import annotations

from mazebot.common.messages import action_documents as act
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.engine.ports import as_layers
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.goals import Ready
from mazebot.navigation.messages import clear_requests, path_poses, planar_document, planned_path


def compute_path(ask: act.ComputePath, ready: Ready) -> act.ComputePathReply:
    """A path through goals, from the robot or from another pose."""
    try:
        robot = ready().robot
        start = robot.pose() if ask.start is None else ask.start.se2()
        path = robot.compute_path(start, [goal.se2() for goal in ask.goals], ask.planner_id)
    except NavigationError as error:
        near = error.nearest_free
        return act.ComputePathReply(
            error_code=int(error.code),
            error_msg=error.message,
            nearest_free=None if near is None else planar_document(near),
        )
    return act.ComputePathReply(path=path_poses(path), length_m=path.length_m)


def smooth_path(ask: act.SmoothPath, ready: Ready) -> act.SmoothPathReply:
    """A path, smoothed."""
    try:
        path = ready().robot.planner_server.smooth_path(
            planned_path(ask.path, ErrorCode.SMOOTHER_INVALID_PATH),
            ask.smoother_id,
            ask.check_for_collisions,
        )
    except NavigationError as error:
        return act.SmoothPathReply(error_code=int(error.code), error_msg=error.message)
    return act.SmoothPathReply(path=path_poses(path))


def clear_costmap(ask: act.ClearCostmap, ready: Ready) -> act.Reply:
    """Clear the costmaps that are named; also of what the lidar does not show, where that is asked
    for entirely.
    """
    try:
        as_layers(ask.plugins)
        drive, requests = ready(), clear_requests(ask)
        # Both costmaps are cleared, or none.
        for request in requests:
            drive.robot.middle_of(request)
        # A person knows better than what was seen.
        drive.robot.forget_places()
        for request in requests:
            drive.robot.clear_costmap(request)
            if request.area == "entirely":
                drive.forget_hidden()
    except NavigationError as error:
        return act.Reply(error=error.message)
    except ValueError as error:
        return act.Reply(error=f"plugins: {error}")
    return act.Reply()
