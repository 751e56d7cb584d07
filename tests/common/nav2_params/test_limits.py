"""Limits of controllers that are not here: the robot is no faster than they were told."""

from typing import Any

import numpy as np
import pytest

from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.mppi.mppi import MPPIController
from tests.common.nav2_params.files import config_of, row_of, told

DWB = "dwb_core::DWBLocalPlanner"
GRACEFUL = "nav2_graceful_controller::GracefulController"
NEO = "neo_local_planner2::NeoLocalPlanner"
TEB = "teb_local_planner::TebLocalPlannerROS"
VECTOR = "vector_pursuit_controller::VectorPursuitController"


def server(plugin: str, values: dict[str, float]) -> dict[str, Any]:
    return {"controller_plugins": ["FollowPath"], "FollowPath": {"plugin": plugin, **values}}


@pytest.mark.parametrize(
    ("plugin", "values", "expected"),
    [
        (DWB, {"max_vel_x": 0.4, "max_speed_xy": 0.15}, {"forward": 0.15, "backward": 0.15}),
        (DWB, {"max_speed_xy": 0.4, "max_vel_x": 0.15}, {"forward": 0.15, "backward": 0.2}),
        (DWB, {"max_vel_x": 0.4, "max_speed_xy": -1.0}, {"forward": 0.4, "backward": 0.2}),
        (DWB, {"min_vel_x": 0.0}, {"backward": 0.0}),
        (DWB, {"min_vel_x": -0.05}, {"backward": 0.05}),
        (DWB, {"min_vel_x": 0.1}, {"backward": 0.0}),
        (GRACEFUL, {"allow_backward": False}, {"backward": 0.0}),
        (GRACEFUL, {"allow_backward": True}, {"backward": 0.2}),
        (DWB, {"acc_lim_theta": 1.5, "decel_lim_theta": -0.5}, {"turn_accel": 0.5}),
        (DWB, {"decel_lim_theta": -1.5, "acc_lim_theta": 0.5}, {"turn_accel": 0.5}),
        (NEO, {"max_vel_x": 0.4, "max_trans_vel": 0.1, "max_rot_vel": 0.6},
         {"forward": 0.1, "backward": 0.1, "turn": 0.6}),
        (TEB, {"max_vel_x": 0.3, "max_vel_x_backwards": 0.05, "max_vel_theta": 0.7},
         {"forward": 0.3, "backward": 0.05, "turn": 0.7}),
        (VECTOR, {"desired_linear_vel": 0.4, "max_linear_accel": 0.3, "max_angular_accel": 0.4},
         {"forward": 0.4, "accel": 0.3, "turn_accel": 0.4}),
        ("mine::Magic", {"desired_linear_vel": 0.4, "max_linear_vel": 0.2}, {"forward": 0.2}),
    ],
)  # fmt: skip
def test_the_lowest_limit_of_a_controller_that_is_not_here_counts(
    plugin: str, values: dict[str, float], expected: dict[str, float]
) -> None:
    params = config_of(told("controller_server", server(plugin, values))).controller_server
    controller = MPPIController(params.mppi, Robot(params.limits()), np.random.default_rng(1))
    robot = controller._robot
    limits = {
        "forward": robot.limits.max_linear_vel,
        "backward": robot.max_backward_vel,
        "turn": robot.limits.max_angular_vel,
        "accel": robot.limits.max_linear_accel,
        "turn_accel": robot.limits.max_angular_accel,
    }
    assert {name: limits[name] for name in expected} == expected


def test_a_limit_that_is_not_the_lowest_is_told_and_is_no_warning() -> None:
    values = {"max_linear_vel": 0.2, "desired_linear_vel": 0.4}
    found = told("controller_server", server("mine::Magic", values))
    assert row_of(found, "FollowPath.max_linear_vel").status == "mapped"
    row = row_of(found, "FollowPath.desired_linear_vel")
    assert (row.status, row.setting, row.differs) == ("unsupported", "", False)
    assert "controller_server.FollowPath.max_linear_vel is lower" in row.note


def test_a_limit_below_zero_is_none() -> None:
    found = told("controller_server", server(DWB, {"max_vel_x": 0.4, "max_speed_xy": -1.0}))
    row = row_of(found, "FollowPath.max_speed_xy")
    assert "the same as the default here" in row.note
    assert not row.differs
