"""The robot's true poses in a run."""

from __future__ import annotations

from mazebot.common.maths.frames import SE2, Array, se2_from_matrix
from mazebot.common.maths.pose_history import PoseHistory
from mazebot.common.messages import messages as msg
from mazebot.common.messages.messages import matrix_from_pose, ns_from_time
from mazebot.recorder.judging.poses.driven_way import DrivenWay

_DEPTH = 30 * 60


class TruePoses:
    """The newest true poses, to judge estimates by, and the whole driven path."""

    def __init__(self) -> None:
        self.way = DrivenWay()
        self._history = PoseHistory(_DEPTH)

    def add(self, odometry: msg.Odometry) -> tuple[int, SE2] | None:
        """Add a true pose, map from base_footprint; returns its stamp and planar part. One that is
        not newer than the newest is dropped: None.
        """
        stamp_ns = ns_from_time(odometry.header.stamp)
        if self.newest_ns is not None and stamp_ns <= self.newest_ns:
            return None
        map_from_base = matrix_from_pose(odometry.pose.pose)
        self._history.add(stamp_ns, map_from_base)
        pose = se2_from_matrix(map_from_base)
        self.way.add(stamp_ns, pose)
        return stamp_ns, pose

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest true pose."""
        return self._history.newest_ns

    @property
    def now_s(self) -> float:
        """Simulation time of the newest true pose."""
        return (self.newest_ns or 0) * 1e-9

    @property
    def driven_m(self) -> float | None:
        """Length of the driven path; None before the first true pose."""
        return None if self.newest_ns is None else self.way.total_m

    def map_from_base(self, stamp_ns: int) -> Array | None:
        """The interpolated true pose as a (4, 4) matrix; None where it is not known."""
        return self._history.at(stamp_ns)

    def at(self, stamp_ns: int) -> SE2 | None:
        """Its planar part."""
        map_from_base = self.map_from_base(stamp_ns)
        return None if map_from_base is None else se2_from_matrix(map_from_base)

    def on_the_way(self, stamp_ns: int) -> SE2 | None:
        """The true pose at any time of the run."""
        at = self.way.at(stamp_ns) if self.way.is_known(stamp_ns) else None
        return None if at is None else at[0]
