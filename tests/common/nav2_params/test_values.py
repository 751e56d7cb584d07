"""Values that Nav2 takes and our settings do not: the nearest one counts, and is told."""

import logging
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.nav2_params.summary import summary
from mazebot.common.robot.waffle import MAX_LINEAR_M_S
from mazebot.common.settings.load import load
from mazebot.localization.config import LocalizationConfig
from mazebot.navigation.config import NavigationConfig
from tests.common.nav2_params.files import config_of, refused, row_of, told

INF = float("inf")
GOAL = {"plugin": "nav2_controller::SimpleGoalChecker"}
DOCK = {"plugin": "opennav_docking::SimpleChargingDock"}
MPPI = {"plugin": "nav2_mppi_controller::MPPIController"}


@pytest.mark.parametrize(
    ("node", "values", "setting", "expected"),
    [
        ("controller_server", {"goal_checker": GOAL | {"xy_goal_tolerance": 0.0}},
         "controller_server.general_goal_checker.xy_goal_tolerance", 0.001),
        ("controller_server", {"goal_checker": GOAL | {"yaw_goal_tolerance": INF}},
         "controller_server.general_goal_checker.yaw_goal_tolerance", 1e6),
        ("controller_server", {"failure_tolerance": INF}, "controller_server.failure_tolerance",
         1e6),
        # Nav2's word for no limit, not a time below 0.
        ("controller_server", {"failure_tolerance": -1.0}, "controller_server.failure_tolerance",
         1e6),
        ("controller_server", {"PathHandler": {"max_robot_pose_search_dist": -1.0}},
         "controller_server.path_handler.max_robot_pose_search_dist", 1e6),
        ("controller_server", {"FollowPath": MPPI | {"batch_size": 30_000}},
         "controller_server.mppi.batch_size", 20_000),
        ("docking_server", {"dock_plugins": ["a"], "a": DOCK | {"staging_x_offset": 0.9}},
         "docking_server.staging_x_offset", -0.9),
        ("docking_server", {"initial_perception_timeout": 0.0},
         "docking_server.initial_perception_timeout", 0.001),
        ("velocity_smoother", {"max_accel": [0.0, 0.0, 3.2]}, "velocity_smoother.max_accel",
         (0.001, 0.0, 2.0)),
        ("local_costmap", {"width": 40}, "local_costmap.width", 20),
    ],
)  # fmt: skip
def test_the_nearest_value_that_is_taken_counts(
    node: str, values: dict[str, Any], setting: str, expected: object
) -> None:
    found = told(node, values)
    inner: Any = config_of(found)
    for part in setting.split("."):
        inner = getattr(inner, part)
    assert inner == expected
    (row,) = [row for row in found.rows if row.setting == f"navigation.{setting}"]
    assert row.status == "mapped"
    assert "converted to" in row.note


@pytest.mark.parametrize(
    ("node", "values", "parameter", "note"),
    [
        ("local_costmap", {"obstacle_layer": {"enabled": False}}, "obstacle_layer.enabled",
         "is always true here"),
        ("docking_server", {"dock_plugins": ["a"], "a": DOCK | {"dock_direction": "backward"}},
         "a.dock_direction", "is always forward here"),
        ("controller_server", {"goal_checker_plugins": ["a"],
                               "a": {"plugin": "nav2_controller::AxisGoalChecker"}},
         "a.plugin", "AxisGoalChecker is not supported"),
        ("behavior_server", {"behavior_plugins": ["a"], "a": {"plugin": "my::Dance"}},
         "a.plugin", "Dance is not supported"),
    ],
)  # fmt: skip
def test_what_is_not_done_is_told_as_another_value(
    node: str, values: dict[str, Any], parameter: str, note: str
) -> None:
    row = row_of(told(node, values), parameter)
    assert (row.status, row.note, row.differs) == ("unsupported", note, True)


def test_the_least_speed_of_a_faster_robot_is_not_above_the_highest_here() -> None:
    turns = config_of(
        told("behavior_server", {"min_rotational_vel": 2.0, "max_rotational_vel": 3.0})
    )
    assert turns.behavior_server.min_rotational_vel == turns.behavior_server.max_rotational_vel
    docks = {"controller": {"v_linear_min": 0.5, "v_linear_max": 0.8}}
    controller = config_of(told("docking_server", docks)).docking_server.controller
    assert controller.v_linear_min == controller.v_linear_max == MAX_LINEAR_M_S


@pytest.mark.parametrize(
    ("values", "own", "other"),
    [
        ({"max_rotational_vel": 0.05}, "max_rotational_vel", "min_rotational_vel"),
        ({"min_rotational_vel": 1.5}, "min_rotational_vel", "max_rotational_vel"),
    ],
)
def test_a_limit_beyond_the_default_of_its_counterpart_takes_that_along(
    values: dict[str, float], own: str, other: str
) -> None:
    found = told("behavior_server", values)
    ours = config_of(found).behavior_server
    assert getattr(ours, own) == getattr(ours, other) == values[own]
    row = row_of(found, own)
    assert row.status == "used"
    assert row.note == f"navigation.behavior_server.{other} is {values[own]:g}, too"


def test_fewer_beams_than_the_returns_that_are_needed_here_need_fewer_returns() -> None:
    found = told("amcl", {"max_beams": 6})
    ours = LocalizationConfig.model_validate(found.settings["localization"])
    assert (ours.max_beams, ours.min_returns) == (6, 6)


def test_limits_of_several_sections_take_their_counterparts_along() -> None:
    pursuit = {"plugin": "nav2_rpp/RegulatedPurePursuitController", "min_lookahead_dist": 0.5}
    values = {"controller_plugins": ["F"], "F": pursuit}
    ours = config_of(told("controller_server", values)).controller_server.regulated_pure_pursuit
    assert (ours.min_lookahead_dist, ours.max_lookahead_dist) == (0.5, 0.5)
    docks = config_of(told("docking_server", {"controller": {"v_linear_max": 0.02}}))
    assert docks.docking_server.controller.v_linear_min == 0.02


def test_velocities_in_space_are_those_in_the_plane() -> None:
    found = told("velocity_smoother", {"max_velocity": [0.3, 0.0, 0.0, 0.0, 0.0, 1.0]})
    assert config_of(found).velocity_smoother.max_velocity == (0.3, 0.0, 1.0)


def test_a_controller_that_is_not_listed_contradicts_nothing() -> None:
    values = {"controller_frequency": 10.0, "controller_plugins": ["A"],
              "A": {"plugin": "nav2_rpp/RegulatedPurePursuitController"}}  # fmt: skip
    found = told(
        "controller_server",
        values | {"B": MPPI},
    )
    assert "B is not in controller_plugins" in row_of(found, "B.plugin").note


def test_a_value_without_a_like_is_refused_with_its_line() -> None:
    said = refused("local_costmap", {"inflation_layer": {"inflation_radius": INF}})
    assert said == (
        "my.yaml:4: local_costmap.inflation_layer.inflation_radius: inf: must be a finite number"
    )
    said = refused("speed_costmap_filter_info_server", {"type": 0})
    assert said == "my.yaml:3: speed_costmap_filter_info_server.type: 0: must be 1 or 2"


def test_ours_counts_where_nothing_is_like_the_value() -> None:
    found = told("controller_server", {"FollowPath": MPPI | {"PathAngleCritic": {"mode": 2}}})
    row = row_of(found, "FollowPath.PathAngleCritic.mode")
    assert (row.status, row.differs) == ("unsupported", True)
    assert config_of(found).controller_server.mppi.PathAngleCritic.mode == 0


def test_a_service_says_once_what_counts_otherwise(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "my params.yaml"
    file.write_text(
        "controller_server: {ros__parameters: {failure_tolerance: 0.5, controller_frequency: 5.0,"
        " odom_duration: 0.3}}\namlc: {ros__parameters: {alpha1: 0.1}}\n"
        "amcl: {ros__parameters: {recovery_alpha_slow: 0.0, alpha1: 0.1}}\n"
    )
    load(NavigationConfig, "navigation", ["--params", str(file)])
    load(LocalizationConfig, "localization", ["--params", str(file)])
    first, second = caplog.records
    assert (first.levelno, first.name) == (logging.WARNING, "navigation")
    assert first.getMessage() == (
        f"{file}: 4 parameters for navigation, 1 with another value here "
        "(controller_server.controller_frequency), 1 unknown to Nav2 as well (amlc.alpha1), "
        f"1 without effect: see `mazebot params '{file}'`"
    )
    assert "2 parameters for localization, 1 with another value here" in second.getMessage()


def test_what_only_changes_nothing_is_no_warning() -> None:
    values = {"odom_duration": 0.3, "use_sim_time": False}
    said = summary(told("controller_server", values), "navigation")
    assert said is not None
    assert said[0] == logging.INFO
    assert summary(told("controller_server", {"failure_tolerance": 0.5}), "navigation") is None
    # AMCL takes the smaller of this and the lidar's own range, as here.
    assert summary(told("amcl", {"laser_max_range": 100.0}), "navigation") is None
