"""`mazebot goal` and `mazebot cancel`: one goal, from the request to its result."""

from __future__ import annotations

import sys

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.drive.task import (
    EXIT_FAILED,
    PATIENCE_S,
    await_navigation,
    canceled_on_error,
    failure,
    followed,
    ready,
    timed_out,
)
from mazebot.cli.parsing.options import print_json
from mazebot.common.client import actions
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import CancelGoal
from mazebot.common.messages.topics import GOAL_POSE, NAVIGATION_RESULT


def send_goal(
    endpoint: str, goal: tuple[float, float, float], timeout_s: float | None, as_json: bool
) -> int:
    """Send a goal (x and y in metres, yaw in radians) and wait for its result; return 0 if it was
    reached, else 1. Ctrl-C, and a timeout after `timeout_s` of wall time, cancel it.

    Raises ConfigError where navigation is not running.
    """
    x_m, y_m, yaw_rad = goal
    with ZenohRobot(endpoint) as robot, ProgressLine(not as_json) as line:
        stamp_ns = ready(robot, "goal")
        pose = msg.PoseStamped(
            header=msg.header(stamp_ns, MAP_FRAME), pose=msg.pose_from_se2(SE2(x_m, y_m, yaw_rad))
        )
        goal_request = CancelGoal(goal_stamp_ns=stamp_ns)
        with (
            actions.ActionClient(robot, NAVIGATION_RESULT) as client,
            canceled_on_error(robot, goal_request, line),
        ):
            client.follow(goal_request)
            robot.publish(GOAL_POSE, pose)
            line.say(f"driving to ({x_m:g}, {y_m:g}, {yaw_rad:g})")
            result = followed(client, line, timeout_s)
            holds = client.holds
        if result is None:
            return timed_out(robot, goal_request, "goal", timeout_s, holds)
    if as_json:
        print_json(result.model_dump(mode="json"))
        return EXIT_FAILED if result.error_code else 0
    if result.error_code:
        who = f"goal: ({x_m:g}, {y_m:g}, {yaw_rad:g})"
        return failure(who, "navigate_to_pose", result.error_code, result.error_msg)
    recoveries = result.number_of_recoveries
    also = f", {recoveries} recoveries" if recoveries else ""
    sys.stdout.write(f"reached after {result.end_time_s - result.start_time_s:.1f} s{also}\n")
    return 0


def cancel_goal(endpoint: str, as_json: bool) -> None:
    """Cancel the active goal, whichever client sent it.

    Raises ConfigError where there is none, or navigation is not running.
    """
    with ZenohRobot(endpoint) as robot:
        await_navigation(robot, "cancel")
        reply = actions.cancel_goal(robot, CancelGoal(), PATIENCE_S)
    if reply.error:
        raise ConfigError(f"cancel: {reply.error}")
    if as_json:
        print_json(reply.model_dump(mode="json"))
        return
    at = reply.goal
    where = "the task" if at is None else f"({at.x_m:g}, {at.y_m:g}, {at.yaw_rad:g})"
    also = "the exploration is paused: " * reply.explores
    sys.stdout.write(f"canceled: {where}; {also}the robot stops\n")
