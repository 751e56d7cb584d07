"""Compiles the kernels of costmaps, footprint and collision monitor before the robot moves."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.collision import Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.safety.collision_monitor import (
    CollisionMonitor,
    CollisionMonitorParams,
    PolygonParams,
    SourcePoints,
)
from mazebot.navigation.costmap.layered_costmap import (
    InflationParams,
    LayeredCostmap,
    LocalCostmap,
    ObstacleParams,
    frame_of,
)


def compile_collision_kernels() -> None:
    """Run every kernel once in a small room, with the types of arguments that it has in use."""
    cells = np.zeros((40, 40), np.int8)
    cells[0] = 100
    inflation = InflationParams(inflation_radius=0.7, cost_scaling_factor=3.0)
    obstacle = ObstacleParams(static_margin=0.1, decay_time=1.0)
    costmap = LayeredCostmap(frame_of(0.05, SE2(0.0, 0.0, 0.0), cells), cells, inflation, obstacle)
    local = LocalCostmap(0.05, inflation, obstacle)
    pose = SE2(1.0, 1.0, 0.0)
    ranges_m = np.full(360, 0.5, np.float32)
    for seconds in range(3):
        stamp_ns = seconds * 1_000_000_000
        scan = Scan(ranges_m, 0.0, math.tau / 360, 0.12, 3.5, SE2(0.0, 0.0, 0.0), stamp_ns)
        local.move(SE2(0.1 * seconds, 0.0, 0.0))
        for layers in (costmap, local):
            layers.update(pose, scan, map_from_base=pose, moving_m=np.array([[1.0, 1.5, 0.1]]))
    costmap.clear_around(pose, 0.5)
    costmap.clear_except(pose, 0.5)
    costmap.master.clearance_at(1.0, 1.0)
    ahead = np.stack([np.full(9, 0.1), np.linspace(-0.1, 0.1, 9)], axis=1)
    for velocity in (Velocity(0.4, 0.0), Velocity(0.2, 1.0)):
        first_contact_s(Surroundings(pose, costmap.master, ahead), velocity, 1.0)
    polygons = {
        "stop": PolygonParams(type="circle", radius=0.4, action_type="stop"),
        "approach": PolygonParams(action_type="approach"),
        "brake": PolygonParams(action_type="approach", time_before_collision=0.0),
    }
    params = CollisionMonitorParams(polygons=polygons)
    sources = {"scan": SourcePoints(0, ahead)}
    CollisionMonitor(params).step(0, Velocity(0.4, 0.1), Velocity(0.4, 0.0), sources)
