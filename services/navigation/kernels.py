"""Compiles navigation's kernels before the robot moves."""

from __future__ import annotations

import logging
import math

import numpy as np

from services.common import portable
from services.common.frames import SE2
from services.common.node import messages as msg
from services.common.node.node import random_generator
from services.navigation.collision import Surroundings
from services.navigation.config import NavigationConfig
from services.navigation.costmap import LayeredCostmap, frame_of, scan_points
from services.navigation.errors import NavigationError
from services.navigation.localization import Localization
from services.navigation.navigator import Goal, Navigator

_LOG = logging.getLogger("navigation")


def compile_kernels(config: NavigationConfig) -> None:
    """Run all parts once in a small room, so that nothing is compiled while the robot moves."""
    cells = np.zeros((60, 60), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(frame, cells, config.inflation(), config.obstacle())
    localization = Localization(
        config.localization, cells, 0.05, SE2(0.0, 0.0, 0.0), random_generator(0, "navigation/warm")
    )
    start = SE2(1.0, 1.5, 0.0)
    ranges = np.full(360, 1.0, np.float32)
    step = math.tau / 360
    localization.odometry(0, start)
    localization.initialize(start, np.eye(3) * 0.01)
    marker = msg.matrix_from_pose(msg.pose_from_se2(SE2(2.0, 1.5, math.pi), 0.3))
    for i in range(4):
        stamp_ns = (i + 1) * 100_000_000
        localization.odometry(stamp_ns, SE2(1.0 + 0.1 * i, 1.5, 0.0))
        localization.scan(stamp_ns, ranges, 0.0, step, 0.1, 3.5, SE2(0.0, 0.0, 0.0))
        camera_from_marker = portable.product(portable.inverse(start.matrix(0.2)), marker)
        localization.marker(stamp_ns, marker, [(camera_from_marker, np.eye(6), 1.0)], np.eye(4))
        costmap.update(start, ranges, 0.0, step, 0.1)
    costmap.clear()
    planner_and_controller = Navigator(config.navigator(0.05), costmap)
    points_m = scan_points(SE2(0.0, 0.0, 0.0), ranges, 0.0, step, 0.1, 3.5)
    level = _LOG.level
    _LOG.setLevel(logging.CRITICAL)
    try:
        planner_and_controller.accept(0, Goal(SE2(2.0, 1.5, 0.0), 0), start)
        planner_and_controller.step(0, Surroundings(start, costmap.master, points_m), True)
    except NavigationError:
        # The robot is too large for the room; everything else is compiled.
        pass
    finally:
        _LOG.setLevel(level)
