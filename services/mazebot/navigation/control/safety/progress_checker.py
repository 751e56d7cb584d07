"""Whether the robot makes progress: Nav2's PoseProgressChecker, or its SimpleProgressChecker."""

from __future__ import annotations

import math

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, wrap_angle


class ProgressParams(Params):
    """Names as in Nav2's PoseProgressChecker."""

    required_movement_radius: float = Field(
        0.1, gt=0, description="m; a move of this length counts as progress"
    )
    required_movement_angle: float = Field(
        0.2,
        gt=0,
        description="rad; a turn of this angle counts as progress, to where the robot has not "
        "looked since its last move",
    )
    position_only: bool = Field(
        False,
        description="turning is no progress, as in Nav2's SimpleProgressChecker: also a turn at "
        "the goal has to end within the allowance",
    )
    movement_time_allowance: float = Field(
        2.5,
        gt=0,
        description="s; without progress for this long a recovery begins; longer where a fifth of "
        "the robot's highest speed there takes longer",
    )


class ProgressChecker:
    """Detects that the robot has neither moved nor turned enough for too long; with
    `position_only`, that it has not moved enough. Turns to and fro in one place are no progress.
    """

    def __init__(self, params: ProgressParams) -> None:
        self._params = params
        self._moved_to: SE2 | None = None
        """Where the robot was after its last move."""
        self._yaw_rad = self._least_rad = self._most_rad = 0.0
        """How far it has turned since, and between which angles that counted as progress."""
        self._progress_ns = 0
        self._checked_ns = 0
        self._excused_ns = 0
        """How much of the time since the last progress does not count,"""
        self._slowed_ns = 0
        """and how much more because the robot had to drive slowly."""

    def reset(self) -> None:
        """Restart from the next pose."""
        self._moved_to = None

    def excuse(self, now_ns: int, most_ns: int) -> bool:
        """Do not count the time since the last check, in which the robot had a reason to stand.

        False, and it counts, once `most_ns` have been excused since the last progress.
        """
        if self._moved_to is None:
            return True
        excused_ns = self._excused_ns + now_ns - self._checked_ns
        if excused_ns > most_ns:
            return False
        self._excused_ns = excused_ns
        self._checked_ns = now_ns
        return True

    def makes_progress(self, now_ns: int, pose: SE2, counts: float = 1.0) -> bool:
        """False once the allowance has passed without a move or a turn that is large enough.
        `counts`: the share of the time since the last check that counts.
        """
        p, before = self._params, self._moved_to
        if counts < 1.0:
            self._slowed_ns += round((now_ns - self._checked_ns) * (1.0 - counts))
        self._checked_ns = now_ns
        if before is None or pose.distance_m(before) >= p.required_movement_radius:
            self._moved_to = pose
            self._yaw_rad = self._least_rad = self._most_rad = 0.0
        elif not self._turned(wrap_angle(pose.yaw_rad - before.yaw_rad)):
            counted_ns = now_ns - self._progress_ns - self._excused_ns - self._slowed_ns
            return counted_ns * 1e-9 <= p.movement_time_allowance
        self._progress_ns = now_ns
        self._excused_ns = self._slowed_ns = 0
        return True

    def _turned(self, yaw_rad: float) -> bool:
        """Whether the robot has come to look where it has not since its last move."""
        p = self._params
        self._yaw_rad += wrap_angle(yaw_rad - self._yaw_rad)
        if p.position_only or self._most_rad - self._least_rad >= 2.0 * math.pi:
            return False
        if self._yaw_rad >= self._most_rad + p.required_movement_angle:
            self._most_rad = self._yaw_rad
        elif self._yaw_rad <= self._least_rad - p.required_movement_angle:
            self._least_rad = self._yaw_rad
        else:
            return False
        return True
