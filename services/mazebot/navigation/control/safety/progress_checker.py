"""Whether the robot makes progress: Nav2's PoseProgressChecker."""

from __future__ import annotations

from dataclasses import dataclass

from mazebot.common.maths.frames import SE2, wrap_angle


@dataclass(frozen=True, slots=True)
class ProgressParams:
    """Names as in Nav2's PoseProgressChecker."""

    required_movement_radius_m: float
    required_movement_angle_rad: float
    movement_time_allowance_s: float


class ProgressChecker:
    """Detects that the robot has neither moved nor turned enough for too long."""

    def __init__(self, params: ProgressParams) -> None:
        self._params = params
        self._baseline: SE2 | None = None
        self._baseline_ns = 0

    def reset(self) -> None:
        """Restart from the next pose."""
        self._baseline = None

    def makes_progress(self, now_ns: int, pose: SE2) -> bool:
        """False once the allowance has passed without enough movement from the baseline pose."""
        p, baseline = self._params, self._baseline
        if (
            baseline is None
            or pose.distance_m(baseline) >= p.required_movement_radius_m
            or abs(wrap_angle(pose.yaw_rad - baseline.yaw_rad)) >= p.required_movement_angle_rad
        ):
            self._baseline = pose
            self._baseline_ns = now_ns
            return True
        return (now_ns - self._baseline_ns) * 1e-9 <= p.movement_time_allowance_s
