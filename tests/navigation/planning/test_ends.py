"""Starts and goals that are not free, and ways that are blocked: code, place and what is free."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.planner import Planner
from tests.navigation.planning.grids import PARAMS, Solid, costmap_of, weighing

RADIUS_M = 0.2
PLANNER = Planner(PARAMS)


def house() -> Solid:
    """Two rooms of 2.5 x 3 m with a door of 1 m in the wall at x 2.5 m."""
    solid = np.zeros((60, 100), bool)
    solid[0] = solid[-1] = solid[:, 0] = solid[:, -1] = True
    solid[:, 48:52] = True
    solid[30:50, 48:52] = False
    return solid


HOUSE = costmap_of(house(), RADIUS_M)


def failure(
    costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0, static: Costmap | None = None
) -> NavigationError:
    with pytest.raises(NavigationError) as caught:
        PLANNER.plan(costmap, start, goal, tolerance_m, static)
    assert "\n" not in caught.value.message
    return caught.value


def test_fifty_starts_in_inflation_all_leave() -> None:
    rows, columns = np.nonzero(HOUSE.costs == 253)
    goal = SE2(4.0, 1.5, 0.0)
    for i in np.random.default_rng(1).integers(0, len(rows), 50):
        start = SE2(*HOUSE.frame.center(int(rows[i]), int(columns[i])), 0.0)
        points = PLANNER.plan(HOUSE, start, goal).points_m
        assert tuple(points[0]) == start[:2]
        costs = np.array([HOUSE.cost_at(*point) for point in points])
        left = int(np.argmax(costs < 253))
        assert (costs[left:] < 253).all()
        assert (costs < 254).all()
        # Straight to the nearest free cell: a robot may be 0.2 m from there at most, and a cell.
        assert np.linalg.norm(points[left] - points[0]) < 0.35


def test_a_start_leaves_on_its_own_side_of_a_wall() -> None:
    start = SE2(2.32, 0.8, 0.0)
    points = PLANNER.plan(HOUSE, start, SE2(4.0, 0.8, 0.0)).points_m
    assert points[:20, 0].max() < 2.4


@pytest.mark.parametrize("x_m", [2.5, 2.35, 0.02])
def test_an_occupied_goal_is_refused_with_the_nearest_free_pose(x_m: float) -> None:
    goal = SE2(x_m, 0.8, 0.7)
    error = failure(HOUSE, SE2(1.0, 1.0, 0.0), goal)
    assert error.code is ErrorCode.GOAL_OCCUPIED
    nearest = error.nearest_free
    assert nearest is not None
    assert f"({nearest.x_m:.2f}, {nearest.y_m:.2f})" in error.message
    assert nearest.yaw_rad == goal.yaw_rad
    assert HOUSE.cost_at(*nearest[:2]) < 253
    rows, columns = np.nonzero(HOUSE.costs < 253)
    centres = np.stack([columns + 0.5, rows + 0.5], axis=1) * 0.05
    least_m = np.linalg.norm(centres - np.array(goal[:2]), axis=1).min()
    assert np.hypot(nearest.x_m - x_m, nearest.y_m - 0.8) == pytest.approx(least_m)
    assert PLANNER.plan(HOUSE, SE2(1.0, 1.0, 0.0), nearest).goal == nearest


def test_the_nearest_free_pose_is_one_that_can_be_reached() -> None:
    solid = house()
    solid[30:50, 48:52] = True
    error = failure(costmap_of(solid, RADIUS_M), SE2(1.0, 1.0, 0.0), SE2(2.56, 1.0, 0.0))
    assert error.nearest_free is not None
    assert error.nearest_free.x_m < 2.4


def test_within_the_tolerance_the_nearest_free_place_is_the_goal() -> None:
    start, goal = SE2(1.0, 1.0, 0.0), SE2(2.35, 0.8, 0.7)
    path = PLANNER.plan(HOUSE, start, goal, 0.3)
    assert path.goal.yaw_rad == 0.7
    assert 0.0 < np.hypot(path.goal.x_m - 2.35, path.goal.y_m - 0.8) <= 0.3
    assert failure(HOUSE, start, goal, 0.05).code is ErrorCode.GOAL_OCCUPIED


def test_a_goal_out_of_reach_is_replaced_within_the_tolerance_only() -> None:
    solid = house()
    solid[30:50, 48:52] = True
    closed = costmap_of(solid, RADIUS_M)
    start, goal = SE2(1.0, 1.0, 0.0), SE2(2.9, 1.0, 0.0)
    assert failure(closed, start, goal, 0.3).code is ErrorCode.NO_VALID_PATH
    assert PLANNER.plan(closed, start, goal, 1.0).goal.x_m < 2.4


def test_a_blocked_door_is_named_and_not_the_wall_beside_it() -> None:
    solid = house()
    solid[30:50, 40:50] = True
    blocked = costmap_of(solid, RADIUS_M)
    error = failure(blocked, SE2(1.0, 1.0, 0.0), SE2(4.0, 1.0, 0.0), static=HOUSE)
    assert error.code is ErrorCode.NO_VALID_PATH
    assert error.place_m is not None
    # The door is at y 1.5 to 2.5 m; what fills it begins at x 2.0 m.
    assert 1.5 < error.place_m[1] < 2.5
    assert 1.75 < error.place_m[0] < 2.5
    assert f"({error.place_m[0]:.2f}, {error.place_m[1]:.2f})" in error.message
    # Of one map alone, the thinnest part of the wall.
    alone = failure(blocked, SE2(1.0, 1.0, 0.0), SE2(4.0, 1.0, 0.0))
    assert alone.place_m is not None
    assert alone.place_m[1] < 1.5


def test_a_door_that_is_too_narrow_is_named() -> None:
    solid = house()
    solid[30:36, 48:52] = solid[42:50, 48:52] = True
    error = failure(costmap_of(solid, RADIUS_M), SE2(1.0, 1.0, 0.0), SE2(4.0, 1.0, 0.0))
    assert error.place_m is not None
    assert 1.8 < error.place_m[1] < 2.1
    assert "m wide: must be at least 0.40 m" in error.message


def test_too_few_iterations_are_told() -> None:
    planner = Planner(weighing(max_iterations=100))
    with pytest.raises(NavigationError) as caught:
        planner.plan(HOUSE, SE2(1.0, 1.0, 0.0), SE2(4.0, 1.0, 0.0))
    assert caught.value.code is ErrorCode.PLANNER_TIMEOUT
