"""What a behaviour tree hears while it runs: updates of its goal, and names of plugins."""

from __future__ import annotations

import logging

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import CONTROLLER_SELECTOR, GOAL_UPDATE, PLANNER_SELECTOR
from mazebot.common.node.node import Inbox
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.robot.robot_context import RobotContext

_LOG = logging.getLogger("navigation")


def hear_goal_updates(inbox: Inbox, robot: RobotContext) -> None:
    """Take where the goal of the task has moved to."""
    for message in inbox.new(GOAL_UPDATE):
        frame_id, stamp_ns = message.header.frame_id, msg.ns_from_time(message.header.stamp)
        if frame_id not in ("", MAP_FRAME):
            _reject(
                inbox, f"frame_id {frame_id!r:.40}: must be 'map' or empty", "frame_id is not map"
            )
        elif not robot.hear_goal_update(msg.se2_from_pose(message.pose), stamp_ns):
            _reject(inbox, "its stamp is older than the goal of the task", "older than the goal")


def _reject(inbox: Inbox, problem: str, reason: str) -> None:
    inbox.reject(GOAL_UPDATE, reason)
    _LOG.error("%s: %s", GOAL_UPDATE.name, problem)


def hear_selectors(inbox: Inbox, robot: RobotContext) -> None:
    """Take the names of the plugins that a tree is to use; a name that there is none of changes
    nothing.
    """
    for topic, check in (
        (CONTROLLER_SELECTOR, robot.controller_server.check_name),
        (PLANNER_SELECTOR, robot.planner_server.check_name),
    ):
        for message in inbox.new(topic):
            try:
                check(message.data)
            except NavigationError as error:
                inbox.reject(topic, "unknown name")
                _LOG.error("%s: %s", topic.name, error.message)
            else:
                robot.names_heard[topic.name.lstrip("/")] = message.data
