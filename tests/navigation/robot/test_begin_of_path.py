"""Where a robot takes up a path that it is given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.nodes.path_parts import begin_index
from mazebot.navigation.planning.path import path_through


def rounds(turns: float) -> np.ndarray:
    """A circle of 1 m from (1, 0) on, by steps of 1 degree."""
    angles = np.radians(np.arange(round(360 * turns) + 1))
    return np.column_stack((np.cos(angles), np.sin(angles)))


@pytest.mark.parametrize("turns", [1.0, 2.0])
@pytest.mark.parametrize(
    ("x_m", "y_m"), [(1.0, -0.05), (1.0, -0.1), (0.98, -0.03), (1.0, 0.0), (1.03, 0.05)]
)
def test_a_round_is_begun_at_its_beginning(turns: float, x_m: float, y_m: float) -> None:
    assert begin_index(path_through(rounds(turns), 0.0), SE2(x_m, y_m, 0.5 * math.pi)) <= 3


def test_a_path_whose_beginning_is_behind_is_taken_up_beside_the_robot() -> None:
    assert begin_index(path_through(rounds(1.0), 0.0), SE2(0.0, 1.1, 0.0)) == 90
    straight = path_through(np.linspace((0.0, 0.0), (5.0, 0.0), 51), 0.0)
    assert begin_index(straight, SE2(3.02, 0.1, 0.0)) == 30
    assert begin_index(straight, SE2(9.0, 0.0, 0.0)) == 50


def test_a_path_there_and_back_is_begun_on_the_way_there() -> None:
    there = np.linspace((0.0, 0.0), (3.0, 0.0), 31)
    back = path_through(np.concatenate((there, there[::-1] + np.array([0.0, 0.02]))), 0.0)
    assert begin_index(back, SE2(1.0, 0.05, 0.0)) == 10
