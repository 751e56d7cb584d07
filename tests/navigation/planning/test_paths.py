"""Whole paths: they stay in free space, and cost no more than the optimum of the grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mazebot.bench.parts.planning_maps import KINDS
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.planner import Planner, PlannerName
from tests.navigation.planning.grids import PARAMS, costmap_of, pose, touched_cells, weighing


def questions(costmap: Costmap, count: int, seed: int) -> list[tuple[SE2, SE2]]:
    """Free cells."""
    rows, columns = np.nonzero(costmap.costs < 253)
    chosen = np.random.default_rng(seed).integers(0, len(rows), (count, 2))
    return [
        (pose(costmap, rows[a], columns[a]), pose(costmap, rows[b], columns[b])) for a, b in chosen
    ]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("algorithm", ["any_angle", "a_star"])
@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_paths_stay_in_free_space_and_cost_no_more_than_the_optimum(
    kind: str, algorithm: PlannerName, weight: float
) -> None:
    params = weighing(cost_travel_multiplier=weight)
    planner = Planner(replace(params, algorithm=algorithm))
    optimal = Planner(replace(params, algorithm="a_star", smoothing_iterations=0))
    found = 0
    for seed in range(3):
        costmap = costmap_of(KINDS[kind](64, np.random.default_rng(seed)))
        for start, goal in questions(costmap, 8, seed):
            try:
                best = optimal.plan(costmap, start, goal)
            except NavigationError:
                continue
            path = planner.plan(costmap, start, goal)
            assert all(costmap.costs[cell] < 253 for cell in touched_cells(path.points_m))
            assert path.cost_m <= 1.01 * best.cost_m + 1e-6
            assert tuple(path.points_m[0]) == start[:2]
            assert path.goal == goal
            found += 1
    assert found > 8


def test_any_angle_is_shorter_where_the_way_is_no_multiple_of_45_degrees() -> None:
    costmap = costmap_of(np.zeros((60, 60), bool))
    start, goal = pose(costmap, 5, 5), pose(costmap, 25, 50)
    params = replace(PARAMS, smoothing_iterations=0)
    any_angle = Planner(params).plan(costmap, start, goal).length_m
    a_star = Planner(replace(params, algorithm="a_star")).plan(costmap, start, goal).length_m
    assert any_angle == pytest.approx(np.hypot(20, 45) * 0.05)
    assert a_star == pytest.approx((25 + 20 * np.sqrt(2.0)) * 0.05)


def test_cost_keeps_the_path_away_from_walls() -> None:
    solid = np.zeros((40, 60), bool)
    solid[:18, 28:32] = True
    costmap = costmap_of(solid, 0.1)
    start, goal = pose(costmap, 10, 10), pose(costmap, 10, 50)
    nearest_m = []
    for weight in (0.0, 10.0):
        planner = Planner(weighing(cost_travel_multiplier=weight))
        points = planner.plan(costmap, start, goal).points_m
        nearest_m.append(min(costmap.clearance_at(*point) for point in points))
    assert nearest_m[0] < 0.2
    assert nearest_m[1] > 0.3


def test_the_same_question_has_the_same_bytes_whatever_was_planned_before() -> None:
    costmap = costmap_of(KINDS["streets"](64, np.random.default_rng(1)))
    first, other = questions(costmap, 2, 0)
    planner = Planner(PARAMS)
    one = planner.plan(costmap, *first).points_m.tobytes()
    planner.plan(costmap, *other)
    assert planner.plan(costmap, *first).points_m.tobytes() == one
    assert Planner(PARAMS).plan(costmap, *first).points_m.tobytes() == one


def test_corners_are_rounded() -> None:
    solid = np.zeros((60, 60), bool)
    solid[:40, 28:32] = True
    costmap = costmap_of(solid, 0.1)
    start, goal = pose(costmap, 10, 10), pose(costmap, 10, 50)
    sharpest = []
    for iterations in (0, 100):
        planner = Planner(replace(PARAMS, smoothing_iterations=iterations))
        yaws = planner.plan(costmap, start, goal).yaws_rad[:-1]
        sharpest.append(float(np.abs(np.diff(np.unwrap(yaws))).max()))
    # At 0.05 m of path a radius of 0.125 m.
    assert sharpest[1] < 0.4 < sharpest[0]


def test_unknown_space_is_crossed_only_where_that_is_allowed() -> None:
    unknown = np.zeros((20, 60), bool)
    unknown[:, 28:32] = True
    costmap = costmap_of(np.zeros((20, 60), bool), unknown=unknown)
    start, goal = pose(costmap, 10, 10), pose(costmap, 10, 50)
    with pytest.raises(NavigationError) as caught:
        Planner(PARAMS).plan(costmap, start, goal)
    assert caught.value.code is ErrorCode.NO_VALID_PATH
    assert "unknown space" in caught.value.message
    path = Planner(replace(PARAMS, allow_unknown=True)).plan(costmap, start, goal)
    assert path.length_m == pytest.approx(2.0, rel=1e-3)
