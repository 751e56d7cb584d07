"""Checkers of goals and of progress do what their class in Nav2 does."""

from typing import Any

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.control.goal_checker import GoalChecker
from mazebot.navigation.control.safety.progress_checker import ProgressChecker
from mazebot.navigation.robot.controller_server import ControllerServerParams
from tests.common.nav2_params.files import config_of, row_of, told

GOAL = SE2(1.0, 0.0, 0.0)
TURNED = SE2(1.0, 0.0, 2.0)


def server(kind: str, plugin: str, **values: Any) -> dict[str, Any]:
    one = {"plugin": f"nav2_controller::{plugin}", **values}
    return {f"{kind}_checker_plugins": ["mine"], "mine": one}


def params(values: dict[str, Any]) -> ControllerServerParams:
    return config_of(told("controller_server", values)).controller_server


@pytest.mark.parametrize("stateful", [True, False])
@pytest.mark.parametrize(
    ("plugin", "reached"),
    [("PositionGoalChecker", True), ("SimpleGoalChecker", False), ("StoppedGoalChecker", False)],
)
def test_only_of_a_position_goal_checker_any_heading_counts(
    plugin: str, reached: bool, stateful: bool
) -> None:
    values = server("goal", plugin, xy_goal_tolerance=0.25, stateful=stateful)
    checker = GoalChecker(params(values).general_goal_checker)
    assert checker.check_position(TURNED, GOAL, 0.0)
    assert checker.is_goal_reached(TURNED, GOAL, STOP) is reached


def test_a_position_goal_checker_has_no_tolerance_of_the_heading() -> None:
    found = told(
        "controller_server",
        server("goal", "PositionGoalChecker", xy_goal_tolerance=0.25, yaw_goal_tolerance=0.1),
    )
    assert row_of(found, "mine.yaw_goal_tolerance").status == "unknown"
    row = row_of(found, "mine.plugin")
    assert (row.status, row.note) == ("mapped", "any heading counts as reached")
    assert row.setting == "navigation.controller_server.general_goal_checker.position_only"


@pytest.mark.parametrize(
    ("plugin", "progresses"), [("SimpleProgressChecker", False), ("PoseProgressChecker", True)]
)
def test_turning_is_progress_only_for_a_pose_progress_checker(
    plugin: str, progresses: bool
) -> None:
    values = server("progress", plugin, required_movement_radius=0.5, movement_time_allowance=10.0)
    checker = ProgressChecker(params(values).progress_checker)
    assert checker.makes_progress(0, SE2(0.0, 0.0, 0.0))
    assert checker.makes_progress(9 * 10**9, SE2(0.0, 0.0, 1.0))
    assert checker.makes_progress(11 * 10**9, SE2(0.0, 0.0, 1.0)) is progresses
    assert checker.makes_progress(12 * 10**9, SE2(0.5, 0.0, 1.0))


def test_a_file_that_names_no_checker_leaves_ours() -> None:
    ours = params({"controller_frequency": 20.0})
    assert not ours.general_goal_checker.position_only
    assert not ours.progress_checker.position_only


def test_behaviors_that_a_file_does_not_list_are_there_all_the_same() -> None:
    values = {"behavior_plugins": ["spin"], "spin": {"plugin": "nav2_behaviors::Spin"}}
    note = row_of(told("behavior_server", values), "behavior_plugins").note
    assert "lists no BackUp: there is always one here" in note
    assert "lists no Spin" not in note
