"""What localization and mapping share: the estimated pose as messages, and markers as they are
measured.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mazebot.common.maths.frames import MAP_FRAME, ODOM_FRAME, SE2, Array
from mazebot.common.messages import messages as msg

MarkerCandidate = tuple[Array, Array, float]
"""camera_from_marker (4, 4), covariance (6, 6) and score of one of a marker's possible poses."""


def pose_message(
    stamp_ns: int, map_from_base: SE2, covariance: Array
) -> msg.PoseWithCovarianceStamped:
    """The estimated pose with its (3, 3) covariance of (x, y, yaw)."""
    return msg.PoseWithCovarianceStamped(
        header=msg.header(stamp_ns, MAP_FRAME),
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(map_from_base), covariance=msg.planar_covariance(covariance)
        ),
    )


def transform_message(now_ns: int, map_from_odom: SE2) -> msg.TFMessage:
    """The correction of odometry."""
    transform = msg.planar_transform_stamped(now_ns, MAP_FRAME, ODOM_FRAME, map_from_odom)
    return msg.TFMessage(transforms=[transform])


def by_stamp(
    scans: Iterable[msg.LaserScan], detections: Iterable[msg.Detection3DArray]
) -> list[tuple[int, msg.LaserScan | msg.Detection3DArray]]:
    """Measurements with their stamps in ns, the oldest first; of one stamp the scan first."""
    measured: list[msg.LaserScan | msg.Detection3DArray] = [*scans, *detections]
    stamped = [(msg.ns_from_time(one.header.stamp), one) for one in measured]
    return sorted(stamped, key=lambda one: one[0])


def marker_candidates(detection: msg.Detection3D) -> list[MarkerCandidate]:
    """The poses that a marker may have in the camera's frame."""
    return [
        (
            msg.matrix_from_pose(result.pose.pose),
            np.array(result.pose.covariance, np.float64).reshape(6, 6),
            float(result.hypothesis.score),
        )
        for result in detection.results
    ]
