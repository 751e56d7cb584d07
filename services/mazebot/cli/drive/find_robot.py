"""`mazebot localize --global` on a running stack: global localization."""

from __future__ import annotations

import math
import sys
import time

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.drive.task import EXIT_FAILED, PATIENCE_S
from mazebot.cli.parsing.options import print_json
from mazebot.cli.sim import PAUSED, stats_now
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import Robot
from mazebot.common.client.service_watch import ServiceWatch, wait_until_alive
from mazebot.common.client.subscription import Subscription
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import Empty
from mazebot.common.messages.documents import LocalizationStatus
from mazebot.common.messages.topics import (
    AMCL_POSE,
    LOCALIZATION_STATUS,
    REINITIALIZE_GLOBAL_LOCALIZATION,
)

_TICK_S = 0.2


def find_robot(endpoint: str, timeout_s: float | None, as_json: bool) -> int:
    """Ask for global localisation and follow it; returns 0 once the pose is trusted, 1 at the end
    of `timeout_s` of wall time. The search continues if the command ends earlier.

    Raises ConfigError where localisation is not running.
    """
    with ZenohRobot(endpoint) as robot, ProgressLine(not as_json) as line:
        if not wait_until_alive(robot, "localization", PATIENCE_S):
            hint = robot.elsewhere("localization")
            raise ConfigError(f"localize: no localization service is running{hint}")
        if stats_now(robot, "localize").paused:
            raise ConfigError(f"localize: {PAUSED}")
        watch = ServiceWatch(robot, "localization")
        with Subscription(robot, LOCALIZATION_STATUS, AMCL_POSE) as messages:
            _ask_for_search(robot)
            # To find the router and the services is no part of the search.
            begin_s = time.monotonic()
            line.say("global localization started: the robot may move")
            end_s = math.inf if timeout_s is None else begin_s + timeout_s
            found = _followed(messages, watch, begin_s, end_s, line)
    if isinstance(found, str):
        sys.stderr.write(f"error: localize: --timeout: {timeout_s:g} s: {found}\n")
        return EXIT_FAILED
    status, pose = found
    if as_json:
        print_json(
            {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_rad": pose.yaw_rad, "quality": status.quality}
        )
    else:
        sys.stdout.write(
            f"localized at ({pose.x_m:.2f}, {pose.y_m:.2f}, {pose.yaw_rad:.2f}) after "
            f"{time.monotonic() - begin_s:.1f} s, quality {status.quality:.2f}\n"
        )
    return 0


def _ask_for_search(robot: Robot) -> None:
    reply = robot.ask(REINITIALIZE_GLOBAL_LOCALIZATION, Empty(), PATIENCE_S)
    if reply.error:
        raise ConfigError(f"localize: {reply.error}")


def _followed(
    messages: Subscription, watch: ServiceWatch, begin_s: float, end_s: float, line: ProgressLine
) -> tuple[LocalizationStatus, SE2] | str:
    """The status and the pose once the pose is trusted; why it is not, at the end."""
    searched, trusted = False, None
    reason = "the search has not started"
    while (left_s := end_s - time.monotonic()) > 0.0:
        _, message = messages.next(min(left_s, _TICK_S)) or (None, None)
        watch.check(message is not None)
        if isinstance(message, LocalizationStatus):
            # The first one may be older than the search.
            searched = searched or message.state != "localized"
            trusted = message if searched and message.state == "localized" else None
            reason = f"{message.state}: {message.reason}" if message.reason else message.state
            line.show(
                f"{time.monotonic() - begin_s:.1f} s, {reason}, quality {message.quality:.2f}"
            )
        elif message is not None and trusted is not None:
            return trusted, msg.se2_from_pose(message.pose.pose)
    return reason
