"""Whether the robot makes progress: Nav2's PoseProgressChecker, or its SimpleProgressChecker."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, wrap_angle


class ProgressParams(Params):
    """Names as in Nav2's PoseProgressChecker."""

    required_movement_radius: float = Field(
        0.1, gt=0, description="m; a move of this length counts as progress"
    )
    required_movement_angle: float = Field(
        0.2, gt=0, description="rad; a turn of this angle counts as progress"
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
    `position_only`, that it has not moved enough.
    """

    def __init__(self, params: ProgressParams) -> None:
        self._params = params
        self._baseline: SE2 | None = None
        self._baseline_ns = 0
        self._checked_ns = 0
        self._excused_ns = 0
        """How much of the time since the baseline does not count,"""
        self._slowed_ns = 0
        """and how much more because the robot had to drive slowly."""

    def reset(self) -> None:
        """Restart from the next pose."""
        self._baseline = None

    def excuse(self, now_ns: int, most_ns: int) -> bool:
        """Do not count the time since the last check, in which the robot had a reason to stand.

        False, and it counts, once `most_ns` have been excused since the last progress.
        """
        if self._baseline is None:
            return True
        excused_ns = self._excused_ns + now_ns - self._checked_ns
        if excused_ns > most_ns:
            return False
        self._excused_ns = excused_ns
        self._checked_ns = now_ns
        return True

    def makes_progress(self, now_ns: int, pose: SE2, counts: float = 1.0) -> bool:
        """False once the allowance has passed without enough movement from the baseline pose.
        `counts`: the share of the time since the last check that counts.
        """
        p, baseline = self._params, self._baseline
        if counts < 1.0:
            self._slowed_ns += round((now_ns - self._checked_ns) * (1.0 - counts))
        self._checked_ns = now_ns
        if (
            baseline is None
            or pose.distance_m(baseline) >= p.required_movement_radius
            or self._turned(pose, baseline)
        ):
            self._baseline = pose
            self._baseline_ns = now_ns
            self._excused_ns = self._slowed_ns = 0
            return True
        counted_ns = now_ns - self._baseline_ns - self._excused_ns - self._slowed_ns
        return counted_ns * 1e-9 <= p.movement_time_allowance

    def _turned(self, pose: SE2, baseline: SE2) -> bool:
        turn_rad = abs(wrap_angle(pose.yaw_rad - baseline.yaw_rad))
        return not self._params.position_only and turn_rad >= self._params.required_movement_angle
