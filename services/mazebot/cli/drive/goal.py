"""`mazebot goal` and `mazebot cancel`: one goal, from the request to its result."""

from __future__ import annotations

import math
import sys
import time

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.drive.task import (
    EXIT_FAILED,
    Inlet,
    await_navigation,
    cancel,
    failure,
    progress,
    ready,
)
from mazebot.cli.parsing.options import print_json
from mazebot.cli.session import connected
from mazebot.common.bus.publisher import put_once
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import NavigationResult
from mazebot.common.messages.topics import ACTION_FEEDBACK, GOAL_POSE, NAVIGATION_RESULT


def send_goal(
    endpoint: str, goal: tuple[float, float, float], timeout_s: float | None, as_json: bool
) -> int:
    """Send a goal (x and y in metres, yaw in radians) and wait for its result; return 0 if it was
    reached, else 1. Ctrl-C, and a timeout after `timeout_s` of wall time, cancel it.

    Raises ConfigError where a number is not finite or navigation is not running.
    """
    for name, value in zip(("X", "Y", "YAW"), goal, strict=True):
        if not math.isfinite(value):
            raise ConfigError(f"goal: {name}: {value}: must be a finite number")
        if abs(value) > wire.MAX_COORDINATE:
            most = f"{wire.MAX_COORDINATE:g}"
            raise ConfigError(f"goal: {name}: {value:g}: must be within -{most} and {most}")
    x_m, y_m, yaw_rad = goal
    with (
        connected(endpoint) as session,
        ProgressLine(not as_json) as line,
        Inlet(session, ACTION_FEEDBACK, NAVIGATION_RESULT) as inlet,
    ):
        stamp_ns = ready(session, "goal")
        pose = msg.PoseStamped(
            header=msg.header(stamp_ns, MAP_FRAME), pose=msg.pose_from_se2(SE2(x_m, y_m, yaw_rad))
        )
        try:
            put_once(session, GOAL_POSE, pose, stamp_ns)
            line.say(f"driving to ({x_m:g}, {y_m:g}, {yaw_rad:g})")
            result = _await_result(inlet, stamp_ns, timeout_s, line)
        except KeyboardInterrupt:
            cancel(session, goal_stamp_ns=stamp_ns)
            line.show("")
            sys.stderr.write("canceled: the robot stops\n")
            raise
        if result is None:
            cancel(session, goal_stamp_ns=stamp_ns)
            raise ConfigError(f"goal: --timeout: {timeout_s:g} s: not reached by then: canceled")
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
    """Cancel the current goal, whoever sent it.

    Raises ConfigError where there is none, or navigation is not running.
    """
    with connected(endpoint) as session:
        await_navigation(session, "cancel")
        reply = cancel(session)
    if reply.error:
        raise ConfigError(f"cancel: {reply.error}")
    if as_json:
        print_json(reply.model_dump(mode="json"))
        return
    at = reply.goal
    where = "the task" if at is None else f"({at.x_m:g}, {at.y_m:g}, {at.yaw_rad:g})"
    sys.stdout.write(f"canceled: {where}; the robot stops\n")


def _await_result(
    inlet: Inlet, stamp_ns: int, timeout_s: float | None, line: ProgressLine
) -> NavigationResult | None:
    """The result of the goal with this stamp; None on timeout."""
    end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        come = inlet.next(min(left_s, 0.2))
        if come is None:
            continue
        topic, message = come
        # The feedback of a goal on /goal_pose has no id.
        if topic is ACTION_FEEDBACK and not message.goal_id:
            line.show(progress(message))
        if topic is NAVIGATION_RESULT and message.goal_stamp_ns == stamp_ns:
            assert isinstance(message, NavigationResult)
            return message
    return None
