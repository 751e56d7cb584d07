from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.world.costmap import Cells
from mazebot.navigation.build import planner_params
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import (
    InflationParams,
    LayeredCostmap,
    frame_of,
    inflate,
)
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.interface import GridPlannerParams
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.planner import Planner
from mazebot.navigation.robot.planner_server import PlannerServerParams
from tests.navigation.driving import LOCATIONS, START, house_costmap, wall_distance_m

CONFIG = NavigationConfig()
COSTMAP = CONFIG.global_costmap


def limited_to(iterations: int) -> NavigationConfig:
    grid = GridPlannerParams(max_iterations=iterations)
    return NavigationConfig(planner_server=PlannerServerParams(GridBased=grid))


PLANNER = Planner(planner_params(CONFIG, 0.05, WAFFLE.padded(0.01)))
HOUSE = house_costmap(CONFIG).static

SHORTEST_M = {
    ("start", "location1"): 2.07,
    ("start", "location2"): 3.48,
    ("start", "location3"): 3.67,
    ("start", "location4"): 8.55,
    ("location1", "location2"): 4.85,
    ("location1", "location3"): 5.24,
    ("location1", "location4"): 10.12,
    ("location2", "location3"): 7.14,
    ("location2", "location4"): 12.02,
    ("location3", "location4"): 4.96,
}
"""Collision-free geodesics of a circle of radius 0.22 m, on a grid of 2.5 cm."""

Point = tuple[float, float]

POSES = {"start": START, **LOCATIONS}


def grid(*rows: str) -> LayeredCostmap:
    """A map of blocks of 0.5 m: `#` wall, `.` free, `?` unknown; the first row is the highest."""
    values = {"#": 100, ".": 0, "?": -1}
    cells: Cells = np.array([[values[c] for c in row] for row in reversed(rows)], np.int8)
    cells = np.kron(cells, np.ones((10, 10), np.int8))
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    return LayeredCostmap(frame, cells, COSTMAP.inflation_layer, COSTMAP.obstacle_layer)


def plan(
    costmap: LayeredCostmap, start: tuple[float, float], goal: tuple[float, float]
) -> PlannedPath:
    return PLANNER.plan(costmap.static, SE2(*start, 0.0), SE2(*goal, 0.0))


def failure(
    costmap: LayeredCostmap, start: tuple[float, float], goal: tuple[float, float]
) -> NavigationError:
    with pytest.raises(NavigationError) as caught:
        plan(costmap, start, goal)
    assert "\n" not in caught.value.message
    assert re.search(r"\d", caught.value.message)
    return caught.value


@pytest.mark.parametrize(("start", "goal"), sorted(SHORTEST_M))
def test_paths_through_the_house_are_short_and_keep_off_the_walls(start: str, goal: str) -> None:
    path = PLANNER.plan(HOUSE, POSES[start], POSES[goal])
    shortest_m = SHORTEST_M[start, goal]
    # A way that need not follow a grid may be a little shorter than the shortest that must.
    assert 0.98 * shortest_m <= path.length_m <= 1.09 * shortest_m
    assert wall_distance_m(path.points_m).min() > 0.28
    assert np.linalg.norm(np.diff(path.points_m, axis=0), axis=1).max() < 0.06
    assert tuple(path.points_m[0]) == POSES[start][:2]
    assert path.goal == pytest.approx(POSES[goal])


def test_on_average_a_path_is_within_five_percent_of_the_shortest() -> None:
    ratios = [
        PLANNER.plan(HOUSE, POSES[a], POSES[b]).length_m / shortest
        for (a, b), shortest in SHORTEST_M.items()
    ]
    assert np.mean(ratios) < 1.05


def test_paths_have_no_sharp_bends() -> None:
    for a, b in sorted(SHORTEST_M):
        path = PLANNER.plan(HOUSE, POSES[a], POSES[b])
        bends = np.abs(np.angle(np.exp(1j * np.diff(path.yaws_rad[:-1]))))
        # 0.05 m of path: a radius of 0.15 m at the least.
        assert bends.max() < 0.33


def test_a_straight_way_is_straight() -> None:
    room = grid("........", "........", "........", "........")
    path = plan(room, (0.53, 0.51), (3.41, 1.77))
    assert path.length_m == pytest.approx(math.hypot(2.88, 1.26), rel=1e-3)


def test_the_same_question_has_the_same_answer() -> None:
    first = PLANNER.plan(HOUSE, START, LOCATIONS["location4"])
    again = PLANNER.plan(HOUSE, START, LOCATIONS["location4"])
    assert np.array_equal(first.points_m, again.points_m)


def test_start_outside_the_map() -> None:
    error = failure(grid("....", "...."), (-0.2, 0.5), (1.0, 0.5))
    assert error.code is ErrorCode.START_OUTSIDE_MAP
    assert "-0.20" in error.message
    assert "0.00 to 2.00" in error.message


@pytest.mark.parametrize("x_m", [2.2, -1e308, 1e308])
def test_goal_outside_the_map(x_m: float) -> None:
    error = failure(grid("....", "...."), (0.5, 0.5), (x_m, 0.5))
    assert error.code is ErrorCode.GOAL_OUTSIDE_MAP


def test_start_inside_a_wall() -> None:
    error = failure(grid("#...", "#..."), (0.25, 0.5), (1.5, 0.5))
    assert error.code is ErrorCode.START_OCCUPIED


@pytest.mark.parametrize(
    ("x_m", "what"), [(0.25, "inside an obstacle"), (0.62, "from an obstacle")]
)
def test_goal_in_a_wall_or_too_near_to_one(x_m: float, what: str) -> None:
    error = failure(grid("#...", "#..."), (1.5, 0.5), (x_m, 0.5))
    assert error.code is ErrorCode.GOAL_OCCUPIED
    assert what in error.message


def test_goal_in_a_closed_room_is_unreachable() -> None:
    error = failure(grid("...#...", "...#...", "...#..."), (0.75, 0.75), (2.75, 0.75))
    assert error.code is ErrorCode.NO_VALID_PATH


def test_goal_in_unknown_space_is_unreachable() -> None:
    error = failure(grid("...????", "...????", "...????"), (0.75, 0.75), (2.75, 0.75))
    assert error.code is ErrorCode.NO_VALID_PATH
    assert "unknown" in error.message


def test_a_gap_narrower_than_the_robot_is_no_way() -> None:
    costmap = grid("...#...", "...#...", "...#...")
    cells = np.where(costmap.static.costs == 254, 100, 0).astype(np.int8)
    for half_width, passable in ((2, False), (5, True)):
        opened = cells.copy()
        opened[15 - half_width : 15 + half_width] = 0
        gap = LayeredCostmap(costmap.frame, opened, COSTMAP.inflation_layer, COSTMAP.obstacle_layer)
        if passable:
            assert plan(gap, (0.75, 0.75), (2.75, 0.75)).length_m < 2.2
        else:
            error = failure(gap, (0.75, 0.75), (2.75, 0.75))
            assert error.code is ErrorCode.NO_VALID_PATH


def test_planning_gives_up_after_so_many_cells() -> None:
    config = limited_to(50)
    planner = Planner(planner_params(config, 0.05, WAFFLE))
    with pytest.raises(NavigationError) as caught:
        planner.plan(HOUSE, START, LOCATIONS["location4"])
    assert caught.value.code is ErrorCode.PLANNER_TIMEOUT


def test_a_map_is_searched_to_its_end_unless_a_limit_is_set() -> None:
    # A corridor to and fro, of more cells than Nav2's limit.
    solid = np.zeros((1210, 1200), np.bool_)
    for number, row in enumerate(range(10, 1200, 12)):
        solid[row : row + 2] = True
        solid[row : row + 2, slice(0, 10) if number % 2 else slice(-10, None)] = False
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), solid.astype(np.int8))
    costmap = inflate(
        frame,
        solid,
        np.zeros_like(solid),
        InflationParams(
            custom_inscribed_radius=0.0, inflation_radius=0.1, cost_scaling_factor=10.0
        ),
    )
    start, goal = (SE2(*frame.center(row, 5), 0.0) for row in (5, 1205))

    def plan_within(iterations: int) -> PlannedPath:
        config = limited_to(iterations)
        planner = Planner(replace(planner_params(config, 0.05, WAFFLE), footprint=None))
        return planner.plan(costmap, start, goal)

    assert plan_within(NavigationConfig().planner_server.GridBased.max_iterations).length_m > 5000.0
    with pytest.raises(NavigationError, match="max_iterations"):
        plan_within(1_000_000)
    # As in Nav2, 0 and -1 are no limit.
    limits = {
        planner_params(limited_to(none), 0.05, WAFFLE).settings.most_cells for none in (0, -1)
    }
    assert len(limits) == 1


def test_a_start_too_near_to_a_wall_is_led_out() -> None:
    costmap = grid("#...", "#...", "#...")
    path = plan(costmap, (0.6, 0.75), (1.6, 0.75))
    assert tuple(path.points_m[0]) == pytest.approx((0.6, 0.75))
    costs = [costmap.static.cost_at(*point) for point in path.points_m]
    assert costs[0] == 253
    assert max(costs[5:]) < 253


def test_a_goal_where_the_robot_stands_has_a_path() -> None:
    path = plan(grid("....", "...."), (0.5, 0.5), (0.5, 0.5))
    assert path.length_m == 0.0
