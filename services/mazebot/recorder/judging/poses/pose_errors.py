"""Errors of estimated poses and of wheel odometry over a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import LocalizationConsistency
from mazebot.common.messages.messages import ns_from_time, se2_from_pose
from mazebot.recorder.judging.error_summary import ErrorSummary
from mazebot.recorder.judging.pending import Pending
from mazebot.recorder.judging.poses.consistency import inside_95_percent
from mazebot.recorder.judging.poses.true_poses import TruePoses
from mazebot.recorder.judging.recent_rows import RecentRows

_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""Of a pose's covariance: x, y and yaw."""
_RECENT = 10 * 60 * 15
"""A quarter of an hour's estimates: the mean error of a goal that took longer may cover only its
last part.
"""


class JudgedPose(NamedTuple):
    """An estimated pose, the true one at its stamp, and what lies between them."""

    stamp_ns: int
    estimate: SE2
    truth: SE2
    error_m: float
    error_rad: float


class PoseErrors:
    """Judges each estimate by the true pose at its own stamp."""

    def __init__(self, map_from_start: SE2) -> None:
        self.error_m, self.error_rad = ErrorSummary(), ErrorSummary()
        self.recent_m = RecentRows(1, _RECENT, _RECENT * 11 // 10)
        """Position errors of the newest estimates, by stamp."""
        self._drift_m: float | None = None
        self._map_from_start = map_from_start
        self._estimates = Pending[tuple[SE2, Array]]()
        self._odometry = Pending[msg.Pose]()
        self._count, self._inside_count = 0, 0

    def add_odometry(self, odometry: msg.Odometry) -> None:
        """Add wheel odometry, odom from base_footprint."""
        self._odometry.add(ns_from_time(odometry.header.stamp), odometry.pose.pose)

    def drift_m(self, truth: TruePoses) -> float | None:
        """Position error of the newest odometry; None before the first."""
        newest_ns = truth.newest_ns
        ready = [] if newest_ns is None else self._odometry.take_until(newest_ns)
        for stamp_ns, pose in reversed(ready):
            true_pose = truth.at(stamp_ns)
            if true_pose is not None:
                map_from_base = self._map_from_start @ se2_from_pose(pose)
                self._drift_m = map_from_base.distance_m(true_pose)
                break
        return self._drift_m

    def add_estimate(self, estimate: msg.PoseWithCovarianceStamped) -> None:
        """Add an estimated pose, map from base_footprint, with its covariance."""
        covariance = np.asarray(estimate.pose.covariance).reshape(6, 6)[_PLANAR]
        entry = se2_from_pose(estimate.pose.pose), covariance
        self._estimates.add(ns_from_time(estimate.header.stamp), entry)

    def settle(self, truth: TruePoses, newest_ns: int) -> list[JudgedPose]:
        """Judge what waits, up to the newest true pose; returns the estimates that were judged."""
        found = []
        for stamp_ns, (estimate, covariance) in self._estimates.take_until(newest_ns):
            true_pose = truth.at(stamp_ns)
            if true_pose is None:
                continue
            error_m = estimate.distance_m(true_pose)
            turn_rad = wrap_angle(estimate.yaw_rad - true_pose.yaw_rad)
            self.error_m.add(error_m)
            self.error_rad.add(abs(turn_rad))
            apart = (estimate.x_m - true_pose.x_m, estimate.y_m - true_pose.y_m, turn_rad)
            self._count += 1
            self._inside_count += inside_95_percent(np.array(apart), covariance)
            self.recent_m.add(stamp_ns, (error_m,))
            found.append(JudgedPose(stamp_ns, estimate, true_pose, error_m, abs(turn_rad)))
        return found

    def consistency(self) -> LocalizationConsistency:
        """Whether the estimates are as certain as their covariances say."""
        inside = self._inside_count / self._count if self._count else None
        return LocalizationConsistency(inside_95_percent=inside, estimates=self._count)

    def values(self, truth: TruePoses) -> dict[str, Any]:
        """The JSON values of the state, for `restore()`."""
        estimates = [self._count, self._inside_count]
        return {"estimates": estimates, "drift_m": self.drift_m(truth)}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Its arrays, without those of the error summaries."""
        return {
            "recent_error/stamps_ns": self.recent_m.stamps_ns,
            "recent_error/rows": self.recent_m.rows,
        }

    def restore(self, values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved state."""
        stamps_ns, rows = arrays["recent_error/stamps_ns"], arrays["recent_error/rows"]
        for stamp_ns, row in zip(stamps_ns.tolist(), rows.tolist(), strict=True):
            self.recent_m.add(stamp_ns, row)
        self._count, self._inside_count = map(int, values["estimates"])
        self._drift_m = values["drift_m"]
