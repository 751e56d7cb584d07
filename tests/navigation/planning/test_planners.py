"""Planners by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.navigation.planners import make_planner
from mazebot.navigation.planning.warm_up import run_planning_kernels
from tests.navigation.planning.grids import PARAMS, costmap_of

FREE = costmap_of(np.zeros((60, 60), bool))
START, GOAL = SE2(0.5, 0.5, 0.0), SE2(2.5, 1.2, 1.0)

STRAIGHT = '''
"""A planner that sees no obstacles."""

import numpy as np

from mazebot.navigation.planning.path import path_through


class Straight:
    def __init__(self, params):
        self.spacing_m = params.path_spacing_m

    def plan(self, costmap, start, goal, tolerance_m=0.0):
        return path_through(np.array([start[:2], goal[:2]]), goal.yaw_rad)


class Nothing:
    pass


class Demanding(Straight):
    def __init__(self, params, more):
        pass
'''


@pytest.mark.parametrize("name", ["any_angle", "a_star"])
def test_own_planners_have_names(name: str) -> None:
    path = make_planner(name, PARAMS).plan(FREE, START, GOAL)
    assert path.goal == GOAL


def test_a_users_planner_is_a_class_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "straight.py"
    file.write_text(STRAIGHT)
    path = make_planner(f"{file}:Straight", PARAMS).plan(FREE, START, GOAL)
    assert path.points_m[[0, -1]].tolist() == [list(START[:2]), list(GOAL[:2])]
    assert path.length_m == pytest.approx(np.hypot(2.0, 0.7))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("dijkstra", "any_angle, a_star"),
        ("{file}:Straigt", "Straight"),
        ("{file}:Nothing", "plan"),
        ("{file}:Demanding", "PlannerParams"),
        ("missing.py:Straight", "no such file"),
    ],
)
def test_a_planner_that_cannot_be_had_is_told_in_one_line(
    tmp_path: Path, name: str, said: str
) -> None:
    file = tmp_path / "straight.py"
    file.write_text(STRAIGHT)
    with pytest.raises(ConfigError) as caught:
        make_planner(name.format(file=file), PARAMS)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_kernels_of_planning_run_before_the_robot_moves() -> None:
    run_planning_kernels()
