"""The stop level: what the robot may do, by what is still to be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

from mazebot.common.messages.documents import StopCause
from mazebot.common.messages.topics import SCAN
from mazebot.navigation.robot.measurements import Measurements

StopLevel = Literal["none", "slowdown", "stop", "hold"]
_SEVEREST_FIRST: Final[tuple[StopLevel, ...]] = ("hold", "stop", "slowdown")


def stop_causes(
    measured: Measurements, now_ns: int, sensor_timeout_s: float, waiting_for: str | None
) -> tuple[StopCause, ...]:
    """Why the robot does not drive as it could, the most severe first.

    Args:
        measured: what has been received.
        now_ns: simulation time.
        sensor_timeout_s: how old odometry, pose and scan may be.
        waiting_for: the first thing that is missing for the robot to drive; None: nothing is.
    """
    causes = []
    if measured.emergency_stop:
        causes.append(
            StopCause(
                level="hold", cause=f"emergency stop: {measured.emergency_stop}",
                cleared_by="a person: `mazebot stop --clear`, or Clear stop in the console",
            )
        )  # fmt: skip
    for topic in measured.lost:
        causes.append(
            StopCause(
                level="stop", cause=f"the publisher of {topic} is gone",
                cleared_by=f"a message on {topic}",
            )
        )  # fmt: skip
    if waiting_for is not None:
        causes.append(
            StopCause(level="stop", cause=f"waiting for {waiting_for}", cleared_by=waiting_for)
        )
    elif not measured.lost:
        for topic in measured.too_old(now_ns, sensor_timeout_s):
            if topic == SCAN.name and measured.does_scan_repeat(now_ns, sensor_timeout_s):
                cause, cleared_by = f"{topic} repeats an earlier turn", "a turn that differs"
            else:
                cause = f"{topic} is older than {sensor_timeout_s:g} s"
                cleared_by = f"a message on {topic}"
            causes.append(StopCause(level="stop", cause=cause, cleared_by=cleared_by))
    if measured.is_depth_silent(now_ns):
        if measured.does_depth_repeat(now_ns):
            cause = "the depth camera repeats a picture: low things are not seen"
            cleared_by = "a picture that differs"
        else:
            cause = "the depth camera is silent: low things are not seen"
            cleared_by = "its next picture"
        causes.append(StopCause(level="slowdown", cause=cause, cleared_by=cleared_by))
    return tuple(causes)


def severest(causes: Sequence[StopCause]) -> StopLevel:
    """The level that counts where there are several causes."""
    levels = {cause.level for cause in causes}
    return next((level for level in _SEVEREST_FIRST if level in levels), "none")
