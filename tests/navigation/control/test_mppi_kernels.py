from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.navigation import control
from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.controllers import make_controller
from mazebot.navigation.control.mppi.critic_table import critics_in_order
from mazebot.navigation.control.mppi.mppi_kernels import compile_mppi_kernels
from tests.navigation.control.judge import drive
from tests.navigation.control.test_controllers import line, room
from tests.navigation.driving import Unicycle

ENTRIES = (
    *("roll_out", "softmax", "weighted_mean", "smooth", "add_control_cost", "add_powered"),
    *("_near_obstacles", "_meetings", "sequence_clearance_m", "furthest_reached"),
    *("travel", "_mean_distance", "_mean_angle", "_mean_offset", "_distance", "_bearing"),
    *("_excess", "_inside", "_absolute", "_look_up", "_mark_echoes", "_time_to_wall_s"),
)


def compiled() -> dict[str, list[Any]]:
    """The signatures of every kernel of the room."""
    found = {}
    for info in pkgutil.walk_packages(control.__path__, f"{control.__name__}."):
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if hasattr(value, "signatures"):
                found[f"{info.name}.{name}"] = list(value.signatures)
    return found


def test_nothing_is_compiled_while_the_robot_moves() -> None:
    costmap, faces = room()
    compile_mppi_kernels(costmap, SE2(1.0, 1.0, 0.0), Robot())
    before = compiled()
    everything = {name: {"enabled": True} for name, _ in critics_in_order()}
    controller = make_controller(
        "mppi", {**everything, "batch_size": 100}, Robot(), np.random.default_rng(1)
    )
    path = line((0.5, 1.0), (3.0, 1.0), (3.0, 3.0))
    robot = Unicycle(SE2(0.5, 1.0, 3.0))
    drive(controller, costmap, robot, path.goal, faces, path=path, limit_s=20.0)
    assert compiled() == before
    # Those that Python calls; what they call may come compiled with them.
    for name in ENTRIES:
        assert any(before[key] for key in before if key.endswith(f".{name}")), name
