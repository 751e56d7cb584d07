"""Compiles localisation's kernels before the robot moves."""

from __future__ import annotations

import functools
import math

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Scan
from mazebot.common.node.node import random_generator
from mazebot.common.robot import frozen_scans, wheel_slip
from mazebot.localization.config import LocalizationConfig
from mazebot.localization.monte_carlo import Localization


@functools.cache
def compile_kernels(config: LocalizationConfig) -> None:
    """Run all parts once in a small room, so that nothing is compiled while the robot moves: once
    a process, since what is compiled stays so.
    """
    wheel_slip.compile_kernels()
    frozen_scans.compile_kernels()
    cells = np.zeros((60, 60), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    # Through a door out of the map: there, what a beam meets may be unknown.
    cells[-1, 20:40] = -1
    localization = Localization(
        config, cells, 0.05, SE2(0.0, 0.0, 0.0), random_generator(0, "localization/warm")
    )
    start = SE2(1.0, 1.5, 0.0)
    ranges = np.full(360, 1.0, np.float32)
    localization.odometry(0, start)
    localization.initialize(start, np.eye(3) * 0.01)
    marker = msg.matrix_from_pose(msg.pose_from_se2(SE2(2.0, 1.5, math.pi), 0.3))
    camera_from_marker = portable.product(portable.inverse(start.matrix(0.2)), marker)
    for i in range(6):
        stamp_ns = (i + 1) * 100_000_000
        localization.odometry(stamp_ns, SE2(1.0 + 0.1 * i, 1.5, 0.0))
        nowhere = SE2(0.0, 0.0, 0.0)
        localization.scan(Scan(ranges, 0.0, math.tau / 360, 0.1, 3.5, nowhere, stamp_ns))
        if i == 2:
            localization.global_localization()
        localization.marker(stamp_ns, marker, [(camera_from_marker, np.eye(6), 1.0)], np.eye(4))
