"""Compiles MPPI's kernels before the robot moves."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.control.mppi.critic_table import critics_in_order
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.planning.path import path_through, resample

_ALWAYS_M = 1e-6


def compile_mppi_kernels(costmap: Costmap, pose: SE2, robot: Robot) -> None:
    """Run every critic once, whatever the configuration: at a pose with free space around it."""
    values: dict[str, object] = {
        name: {"enabled": True, "cost_power": 2} for name, _ in critics_in_order()
    }
    values["PathAlignCritic"] = {"offset_from_furthest": 0}
    values["PathAngleCritic"] = {"max_angle_to_furthest": _ALWAYS_M}
    params = MPPIParams.model_validate({**values, "batch_size": 100, "open_loop": False})
    controller = MPPIController(params, robot, np.random.default_rng(0))
    echoes = np.array([(0.9, 0.3), (0.9, 0.35)])
    track = Track(1, pose.x_m + 0.8, pose.y_m + 0.8, 0.0, -0.3, 0.2)
    for length_m in (3.0, 0.7, 0.3, 0.01):
        for turn_rad in (0.1, 2.0):
            # Both with a turn on the spot and without.
            end = pose @ SE2(0.0, 0.0, turn_rad) @ SE2(length_m, 0.0, 0.5)
            points = resample(np.array([pose[:2], end[:2]]), 0.05)
            controller.set_path(path_through(points, end.yaw_rad), same_goal=False)
            around = Surroundings(
                pose, costmap, echoes, tracks=(track,), velocity=Velocity(0.1, 0.0), min_echoes=1
            )
            controller.step(0.05, around)
            controller.trajectories(1)
