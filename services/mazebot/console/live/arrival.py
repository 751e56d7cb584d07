"""Headings for places to which the robot is sent without one: as it arrives on its way there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mazebot.common.client.robot import Robot
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import topics as tp
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.console.live.page_messages import Destination

_ARRIVAL_M = 0.2
"""The end of a path, by which the robot arrives."""
_TURNS_RAD = tuple(math.pi / 4.0 * eighths for eighths in (0, 1, -1, 2, -2, 3, -3, 4))
"""From a guess, the nearest first."""


def poses_with_headings(
    robot: Robot, destinations: Iterable[Destination], timeout_s: float
) -> list[Planar]:
    """The poses to drive to one after the other. Where the robot cannot stand as it arrives, or
    no path is found, another heading is taken: whoever is sent there says what is wrong with it.

    Raises RobotError where navigation does not answer within `timeout_s` of wall time.
    """
    poses: list[Planar] = []
    for to in destinations:
        start = poses[-1] if poses else None
        yaw_rad = _arrival_rad(robot, start, to, timeout_s) if to.yaw_rad is None else to.yaw_rad
        poses.append(Planar(x_m=to.x_m, y_m=to.y_m, yaw_rad=yaw_rad))
    return poses


def _arriving_rad(path: Sequence[Planar]) -> float:
    """The direction of a path's end; of one that leads nowhere, the heading at its begin."""
    end = path[-1]
    for pose in reversed(path):
        away_m = math.hypot(end.x_m - pose.x_m, end.y_m - pose.y_m)
        if away_m >= _ARRIVAL_M:
            return math.atan2(end.y_m - pose.y_m, end.x_m - pose.x_m)
    return path[0].yaw_rad


def _arrival_rad(robot: Robot, start: Planar | None, to: Destination, timeout_s: float) -> float:
    def path(yaw_rad: float) -> act.ComputePathReply:
        goal = Planar(x_m=to.x_m, y_m=to.y_m, yaw_rad=yaw_rad)
        return robot.ask(tp.COMPUTE_PATH, act.ComputePath(goals=(goal,), start=start), timeout_s)

    guess_rad = 0.0 if start is None else math.atan2(to.y_m - start.y_m, to.x_m - start.x_m)
    for turn_rad in _TURNS_RAD:
        fits_rad = guess_rad + turn_rad
        reply = path(fits_rad)
        if reply.path:
            arrives_rad = _arriving_rad([start or reply.path[0], *reply.path])
            fits = bool(path(arrives_rad).path)
            return arrives_rad if fits else fits_rad
        if reply.error_code != ErrorCode.GOAL_OCCUPIED:
            break
    return guess_rad
