"""Compiles mapping's kernels before the robot moves."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Scan
from mazebot.common.robot import frozen_scans, wheel_slip
from mazebot.mapping.graph.sparse_cholesky import analyse, factorize
from mazebot.mapping.loops.loop_search import loop_search, search_map
from mazebot.mapping.matching.local_map import compacted
from mazebot.mapping.matching.occupancy import Structures
from mazebot.mapping.matching.scan_points import scan_points
from mazebot.mapping.params import SlamParams
from mazebot.mapping.slam import Slam

_ROOM_M = 3.0
_BEAMS = 180
_AT_ONCE_M = 0.12


@functools.cache
def compile_kernels(params: SlamParams) -> None:
    """Run all parts once in a small room, so that nothing is compiled while the robot moves: once
    a process, since what is compiled stays so.
    """
    wheel_slip.compile_kernels()
    frozen_scans.compile_kernels()
    slam = Slam(params, SE2(0.0, 0.0, 0.0))
    map_from_marker = msg.matrix_from_pose(
        msg.pose_from_se2(SE2(_ROOM_M / 2.0, 0.0, math.pi / 2.0), 0.3)
    )
    for step in range(12):
        # There and back, and once where odometry is missing.
        away = min(step, 11 - step)
        pose = SE2(_AT_ONCE_M * away, 0.05 * away, 0.1 * away)
        stamp_ns = (step + 1) * 100_000_000
        slam.odometry(stamp_ns, pose if step != 6 else pose @ SE2(0.4, 0.0, 0.5))
        slam.scan(_scan(pose, stamp_ns))
        camera_from_marker = portable.product(portable.inverse(pose.matrix(0.2)), map_from_marker)
        slam.marker(
            stamp_ns, "DICT_4X4_100", 0, [(camera_from_marker, np.eye(6) * 1e-4, 1.0)], np.eye(4)
        )
    seen = scan_points(_scan(SE2(0.0, 0.0, 0.0), 0), params.max_laser_range)
    Structures.of(slam.grid()).gone(SE2(0.0, 0.0, 0.0), seen)
    Slam.restored(params, slam.document(0))
    # No loop is closed in so small a room.
    factor = factorize(
        analyse(1, np.empty((0, 2), np.int64)), np.eye(3)[np.newaxis], np.empty((0, 3, 3))
    )
    if factor is not None:
        factor.solve(np.ones((1, 3)))
    points_m = np.ascontiguousarray(compacted(np.ones((3, 6)), 0.05)[:, :2])
    loop_search(search_map(points_m), points_m, SE2(0.1, 0.0, 0.1), 0.2, 0.2)


def _scan(pose: SE2, stamp_ns: int) -> Scan:
    sensor = SE2(0.0, 0.0, 0.0)
    return Scan(_room(pose), 0.0, math.tau / _BEAMS, 0.1, 3.5, sensor, stamp_ns)


def _room(pose: SE2) -> NDArray[np.float32]:
    """Ranges to the walls of a square room about the origin."""
    ranges = []
    for beam in range(_BEAMS):
        c, s = portable.cos_sin(pose.yaw_rad + beam * math.tau / _BEAMS)
        half_m = _ROOM_M / 2.0
        along = [
            ((half_m if way > 0.0 else -half_m) - at) / way
            for at, way in ((pose.x_m, c), (pose.y_m, s))
            if abs(way) > 1e-9
        ]
        ranges.append(min(along))
    return np.array(ranges, np.float32)
