"""Runs the kernels of giving way once, so that none is compiled while something comes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.control.track import Track
from mazebot.navigation.control.tracking import TrackerParams
from mazebot.navigation.control.yielding.giving_way import GivingWay, GivingWayParams, Scene
from mazebot.navigation.control.yielding.newcomers import Newcomers
from mazebot.navigation.costmap.costmap import Costmap
from mazebot.navigation.costmap.footprint import Footprint

_NOWHERE = SE2(0.0, 0.0, 0.0)


def compile_yielding_kernels(costmap: Costmap, pose: SE2, footprint: Footprint) -> None:
    """Get out of the way of something that comes towards a pose with room around it."""
    giving_way = GivingWay(GivingWayParams(enabled=True), footprint)
    for i in range(20):
        x_m = pose.x_m + 1.0 - 0.02 * i
        track = Track(0, x_m, pose.y_m, -0.4, 0.0, 0.2)
        giving_way.step(50_000_000 * i, Scene(pose, STOP, costmap, (track,)), in_map=True)
    newcomers = Newcomers(TrackerParams())
    ranges = np.full(360, 1.2, np.float32)
    scan = Scan(ranges, 0.0, math.tau / 360, 0.1, 3.5, _NOWHERE)
    for i in range(8):
        seen = ranges.copy()
        seen[: 4 * i] = 1.0
        newcomers.take_scan(replace(scan, ranges_m=seen, stamp_ns=100_000_000 * i), _NOWHERE)
