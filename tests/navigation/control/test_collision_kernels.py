from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.collision import Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.safety import braking, collision_kernels
from mazebot.navigation.control.safety.collision_monitor import (
    CollisionMonitor,
    CollisionMonitorParams,
    SourcePoints,
    moved_points,
)
from mazebot.navigation.costmap import footprint, inflation_layer, obstacle_layer, sweep
from mazebot.navigation.costmap.layered_costmap import (
    InflationParams,
    LayeredCostmap,
    LocalCostmap,
    ObstacleParams,
    frame_of,
)
from mazebot.navigation.costmap.obstacle_layer import ScanSourceParams

MODULES = (braking, footprint, inflation_layer, obstacle_layer, sweep)


def compiled() -> Iterator[tuple[str, int]]:
    """Each kernel, and for how many types of arguments it is compiled."""
    for module in MODULES:
        for name, value in vars(module).items():
            if hasattr(value, "signatures"):
                yield f"{module.__name__}.{name}", len(value.signatures)


def test_nothing_is_compiled_once_the_robot_moves() -> None:
    collision_kernels.compile_collision_kernels()
    before = dict(compiled())
    assert len(before) > 10
    cells = np.zeros((50, 50), np.int8)
    inflation, obstacle = (
        InflationParams(custom_inscribed_radius=1, inflation_radius=1, cost_scaling_factor=3),
        ObstacleParams(
            scan=ScanSourceParams(obstacle_max_range=2, raytrace_max_range=3), static_margin=0
        ),
    )
    costmap = LayeredCostmap(frame_of(0.05, SE2(0.0, 0.0, 0.0), cells), cells, inflation, obstacle)
    local = LocalCostmap(0.05, inflation, obstacle)
    ranges_m = np.full(360, 0.5, np.float32)
    ranges_m.setflags(write=False)
    pose = SE2(1, 1, 0)
    for seconds in range(40):
        costmap.update(
            pose,
            Scan(ranges_m, 0, math.tau / 360, 0, 3.5, SE2(0.0, 0.0, 0.0), seconds * 1_000_000_000),
        )
        local.move(pose)
        local.update(
            pose, Scan(ranges_m, 0, math.tau / 360, 0, 3.5, SE2(0.0, 0.0, 0.0)), map_from_base=pose
        )
    costmap.set_keepout(costmap.master.costs)
    costmap.clear()
    points_m = np.ones((2, 5)).T * 0.1
    points_m.setflags(write=False)
    first_contact_s(Surroundings(pose, costmap.master, points_m), Velocity(1, 0), 1)
    monitor = CollisionMonitor(CollisionMonitorParams(), sources=())
    moved = moved_points(points_m, pose, SE2(1.0, 1.1, 0.2))
    for points in (points_m, moved):
        monitor.step(0, Velocity(1, 0), Velocity(0, 0), {"scan": SourcePoints(0, points)})
    assert dict(compiled()) == before
