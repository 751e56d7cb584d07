"""Times of costmaps, footprint and collision monitor, one thread: `python -m
mazebot.bench.parts.costmap_bench`.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S
from mazebot.navigation.control.collision import Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.safety.collision_kernels import compile_collision_kernels
from mazebot.navigation.control.safety.collision_monitor import (
    CollisionMonitor,
    CollisionMonitorParams,
    SourcePoints,
)
from mazebot.navigation.costmap.layered_costmap import (
    InflationParams,
    LayeredCostmap,
    LocalCostmap,
    ObstacleParams,
    frame_of,
)
from mazebot.navigation.costmap.obstacle_layer import ScanSourceParams

_INFLATION = InflationParams(cost_scaling_factor=3.0)
_OBSTACLE = ObstacleParams(scan=ScanSourceParams(raytrace_max_range=3.5), static_margin=0.1)
_STEP_RAD = math.tau / 360
_RUNS = 1000


def _times(what: str, run: Callable[[int], object]) -> None:
    """Print median and 99th percentile of many runs, in microseconds."""
    taken_us = []
    for i in range(_RUNS + 20):
        begin = time.perf_counter()
        run(i)
        taken_us.append((time.perf_counter() - begin) * 1e6)
    taken_us = sorted(taken_us[20:])
    p99 = taken_us[int(0.99 * _RUNS)]
    print(f"{what:58s} median {statistics.median(taken_us):7.1f}  p99 {p99:7.1f} us")  # noqa: T201


def _scans() -> list[NDArray[np.float32]]:
    """Scans of something that changes all around, a tenth of them without echo."""
    random = np.random.default_rng(0)
    scans = []
    for i in range(50):
        ranges = 1.5 + 0.5 * np.sin(0.1 * np.arange(360) + 0.5 * i) + random.normal(0, 0.01, 360)
        ranges[100:136] = np.inf
        scans.append(ranges.astype(np.float32))
    return scans


def _around(radius_m: float) -> Array:
    """Echoes of a wall all around the lidar."""
    random = np.random.default_rng(1)
    ranges, angles = radius_m + random.normal(0.0, 0.01, 360), _STEP_RAD * np.arange(360)
    return np.stack([ranges * np.cos(angles) - 0.064, ranges * np.sin(angles)], axis=1)


def _costmaps(side: int) -> None:
    scans = _scans()
    cells = np.zeros((side, side), np.int8)
    cells[:: side // 8] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(frame, cells, _INFLATION, _OBSTACLE)
    local = LocalCostmap(0.05, _INFLATION, _OBSTACLE)
    middle_m = side * 0.025

    def both(i: int) -> None:
        pose = SE2(middle_m + 0.02 * (i % 50), middle_m, 0.01 * i)
        here = SE2(0.0, 0.0, 0.0)
        scan = Scan(scans[i % 50], 0.0, _STEP_RAD, 0.12, 3.5, here, i * 100_000_000)
        costmap.update(pose, scan, map_from_base=pose)
        local.move(pose)
        local.update(pose, scan, map_from_base=pose)

    _times(f"global {side} x {side} and local 3 x 3 m, one scan", both)


def _monitor(radius_m: float, velocity: Velocity) -> None:
    monitor = CollisionMonitor(CollisionMonitorParams())
    scan = {"scan": SourcePoints(0, _around(radius_m))}
    v, w = velocity
    _times(
        f"monitor, 360 points {radius_m} m away, {v} m/s, {w} rad/s",
        lambda i: monitor.step(0, velocity, velocity, scan),
    )


def _contact(x_m: float) -> None:
    cells = np.zeros((80, 80), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    room = LayeredCostmap(frame, cells, _INFLATION, _OBSTACLE).master
    around = Surroundings(SE2(x_m, 2.0, 0.3), room, _around(1.0))
    _times(
        f"first_contact_s over 2 s, {3.975 - x_m:.2f} m from a wall, 360 echoes",
        lambda i: first_contact_s(around, Velocity(0.3, 0.5), 2.0),
    )


def main() -> None:
    """Print the table."""
    compile_collision_kernels()
    for side in (200, 400, 2000):
        _costmaps(side)
    for radius_m in (1.0, 0.5, 0.35, 0.3):
        for velocity in (
            Velocity(MAX_LINEAR_M_S, 0.0),
            Velocity(0.3, 1.5),
            Velocity(0.0, MAX_ANGULAR_RAD_S),
        ):
            _monitor(radius_m, velocity)
    for x_m in (2.0, 3.6):
        _contact(x_m)


if __name__ == "__main__":
    main()
