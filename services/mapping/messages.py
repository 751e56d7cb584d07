"""Mapping's results as messages, and messages as its input."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.common.frames import MAP_FRAME, ODOM_FRAME, SE2, Array
from services.common.node import messages as msg
from services.common.node.documents import Planar

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


def map_message(
    now_ns: int, cells: NDArray[np.int8], resolution_m: float, origin: SE2
) -> msg.OccupancyGrid:
    """(rows, columns) cells of -1, 0 or 100 with their origin, map_from_grid."""
    return msg.occupancy_grid(now_ns, resolution_m, origin, cells)


def marker_name(detection: msg.Detection3D) -> tuple[str, int] | None:
    """Dictionary and id of a detection; None where it names none."""
    dictionary, separator, number = detection.id.rpartition(":")
    if not separator or not dictionary or not number.isascii() or not number.isdigit():
        return None
    return dictionary, int(number)


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


def planar(pose: SE2) -> Planar:
    """A pose as a document."""
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)
