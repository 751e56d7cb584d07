"""Errors of single estimates against the ground truth, for the plots."""

from __future__ import annotations

from typing import NamedTuple

from mazebot.common.maths.frames import SE2, se2_from_matrix, wrap_angle
from mazebot.common.maths.pose_history import PoseHistory
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import MarkerEntity
from mazebot.common.messages.messages import matrix_from_pose, ns_from_time, se2_from_pose
from mazebot.common.node.frame_tree import FrameTree
from mazebot.recorder.judging.marker_errors import marker_errors_m

_HOLD_NS = 50_000_000
"""How far the truth may be from an estimate's stamp: it may arrive a little later."""


class PoseError(NamedTuple):
    """Distance and angle between an estimate and the truth."""

    distance_m: float
    angle_rad: float


class TruthComparison:
    """Compares each estimate with the true pose at its own stamp. None if that is not known."""

    def __init__(self, map_from_start: SE2) -> None:
        self._map_from_start = map_from_start
        self._truth = PoseHistory(300)
        self._static = FrameTree()

    def add_truth(self, odometry: msg.Odometry) -> None:
        """Add a true pose, map from base_footprint."""
        self._truth.add(ns_from_time(odometry.header.stamp), matrix_from_pose(odometry.pose.pose))

    def add_static_transforms(self, transforms: msg.TFMessage) -> None:
        """Add fixed frames of the robot."""
        self._static.add(transforms)

    def localisation(self, estimate: msg.PoseWithCovarianceStamped) -> PoseError | None:
        """Error of an estimated pose, map from base_footprint."""
        return self._error(ns_from_time(estimate.header.stamp), se2_from_pose(estimate.pose.pose))

    def odometry(self, odometry: msg.Odometry) -> PoseError | None:
        """Drift of wheel odometry, odom from base_footprint, relative to the world's start pose."""
        pose = self._map_from_start @ se2_from_pose(odometry.pose.pose)
        return self._error(ns_from_time(odometry.header.stamp), pose)

    def markers(
        self, detections: msg.Detection3DArray, entities: tuple[MarkerEntity, ...]
    ) -> list[tuple[str, float]]:
        """Name of each marker detected in the camera's frame, and distance (m) to its true pose."""
        map_from_base = self._truth.at(ns_from_time(detections.header.stamp), _HOLD_NS)
        if map_from_base is None:
            return []
        return marker_errors_m(detections, map_from_base, self._static, entities)

    def _error(self, stamp_ns: int, pose: SE2) -> PoseError | None:
        matrix = self._truth.at(stamp_ns, _HOLD_NS)
        if matrix is None:
            return None
        truth = se2_from_matrix(matrix)
        return PoseError(pose.distance_m(truth), abs(wrap_angle(pose.yaw_rad - truth.yaw_rad)))
