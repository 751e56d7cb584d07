"""`mazebot goal` and `mazebot cancel`: one goal, from the request to its result."""

from __future__ import annotations

import math
import queue
import sys
import time
from typing import TYPE_CHECKING

from services.cli.options import print_json
from services.cli.session import ask, connected
from services.cli.sim import PAUSED, stats_now
from services.common.bus import wire
from services.common.bus.bus import put_once, subscribe, wait_until_alive
from services.common.config import ConfigError
from services.common.frames import MAP_FRAME, SE2
from services.common.node import messages as msg
from services.common.node.documents import CancelGoal, CancelGoalReply, NavigationResult
from services.common.node.topics import CANCEL_GOAL, GOAL_POSE, NAVIGATION_RESULT

if TYPE_CHECKING:
    import zenoh

PATIENCE_S = 5.0
"""Time to wait for a navigation service, and for its reply."""
EXIT_NOT_REACHED = 1


def send_goal(
    endpoint: str, goal: tuple[float, float, float], timeout_s: float | None, as_json: bool
) -> int:
    """Send a goal (x and y in metres, yaw in radians) and wait for its result; return 0 if it was
    reached. Ctrl-C, and a timeout after `timeout_s` of wall time, cancel it.

    Raises ConfigError where a number is not finite, navigation is not running, or the goal was not
    reached; as JSON, the last of these is exit code 1.
    """
    for name, value in zip(("X", "Y", "YAW"), goal, strict=True):
        if not math.isfinite(value):
            raise ConfigError(f"goal: {name}: {value}: must be a finite number")
        if abs(value) > wire.MAX_COORDINATE:
            most = f"{wire.MAX_COORDINATE:g}"
            raise ConfigError(f"goal: {name}: {value:g}: must be within -{most} and {most}")
    x_m, y_m, yaw_rad = goal
    results: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with connected(endpoint) as session:
        _await_navigation(session, "goal")
        subscription = subscribe(
            session, NAVIGATION_RESULT, lambda payload, _: results.put(payload)
        )
        now = stats_now(session, "goal")
        if now.paused:
            raise ConfigError(f"goal: {PAUSED}")
        stamp_ns = round(now.sim_time_s * 1e9)
        pose = msg.PoseStamped(
            header=msg.header(stamp_ns, MAP_FRAME), pose=msg.pose_from_se2(SE2(x_m, y_m, yaw_rad))
        )
        try:
            put_once(session, GOAL_POSE, pose, stamp_ns)
            if not as_json:
                sys.stdout.write(f"driving to ({x_m:g}, {y_m:g}, {yaw_rad:g})\n")
                sys.stdout.flush()
            result = _await_result(results, stamp_ns, timeout_s)
        except KeyboardInterrupt:
            _cancel(session, stamp_ns)
            sys.stderr.write("canceled: the robot stops\n")
            raise
        if result is None:
            _cancel(session, stamp_ns)
            raise ConfigError(f"goal: --timeout: {timeout_s:g} s: not reached by then: canceled")
        del subscription
    if as_json:
        print_json(result.model_dump(mode="json"))
        return EXIT_NOT_REACHED if result.error_code else 0
    if result.error_code:
        raise ConfigError(
            f"goal: ({x_m:g}, {y_m:g}, {yaw_rad:g}): {result.error_msg} "
            f"(error code {result.error_code})"
        )
    sys.stdout.write(f"reached after {result.end_time_s - result.start_time_s:.1f} s\n")
    return 0


def cancel_goal(endpoint: str, as_json: bool) -> None:
    """Cancel the current goal, whoever sent it.

    Raises ConfigError where there is none, or navigation is not running.
    """
    with connected(endpoint) as session:
        _await_navigation(session, "cancel")
        reply = _cancel(session, None)
    if reply.error:
        raise ConfigError(f"cancel: {reply.error}")
    if as_json:
        print_json(reply.model_dump(mode="json"))
    elif reply.goal is not None:
        at = reply.goal
        sys.stdout.write(f"canceled: ({at.x_m:g}, {at.y_m:g}, {at.yaw_rad:g}); the robot stops\n")


def _await_navigation(session: zenoh.Session, who: str) -> None:
    if not wait_until_alive(session, "navigation", PATIENCE_S):
        raise ConfigError(f"{who}: no navigation service is running")


def _cancel(session: zenoh.Session, stamp_ns: int | None) -> CancelGoalReply:
    return ask(session, CANCEL_GOAL, CancelGoal(goal_stamp_ns=stamp_ns), PATIENCE_S)


def _await_result(
    results: queue.SimpleQueue[bytes], stamp_ns: int, timeout_s: float | None
) -> NavigationResult | None:
    """The result of the goal with this stamp; None on timeout."""
    end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        try:
            # Waiting in short intervals lets Ctrl-C through.
            result = wire.decode(NAVIGATION_RESULT, results.get(timeout=min(left_s, 0.5)))
        except (queue.Empty, wire.WireError):
            continue
        if result.goal_stamp_ns == stamp_ns:
            return result
    return None
