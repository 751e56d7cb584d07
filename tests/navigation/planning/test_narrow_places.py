"""The waffle's outline in corridors that just fit it: passable if it can be driven through."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
import shapely.affinity

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.footprint.footprint_check import hits
from mazebot.navigation.planning.grid.search_grid import SOLID, search_grid
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.planning.planner import Planner
from tests.navigation.planning.grids import PARAMS, RESOLUTION_M, costmap_of

NARROW = replace(PARAMS, footprint=WAFFLE)
AHEAD, UP = 0.0, math.pi / 2
START_M = 0.5
BEND_M = 1.0
END_M = 3.4


def bend(width_m: float) -> tuple[Costmap, shapely.Polygon]:
    """An L-shaped corridor and its floor: faces are in the middle of occupied cells."""
    free = round(width_m / RESOLUTION_M) - 1
    solid = np.ones((80, 80), bool)
    solid[20 : 20 + free, 5 : 20 + free] = False
    solid[20:75, 20 : 20 + free] = False
    low, high = 19.5 * RESOLUTION_M, (20.5 + free) * RESOLUTION_M
    floor = shapely.box(4.5 * RESOLUTION_M, low, high, high)
    return costmap_of(solid, WAFFLE.half_width_m), floor.union(
        shapely.box(low, low, high, 75.5 * RESOLUTION_M)
    )


def middle_m(width_m: float) -> float:
    return 19.5 * RESOLUTION_M + width_m / 2.0


def outline(x_m: float, y_m: float, yaw_rad: float) -> shapely.Polygon:
    turned = shapely.affinity.rotate(
        shapely.Polygon(WAFFLE.points_m), yaw_rad, origin=(0, 0), use_radians=True
    )
    return shapely.affinity.translate(turned, x_m, y_m)


def worst_m(path: PlannedPath, start: SE2, floor: shapely.Polygon) -> float:
    """How far the outline leaves the floor at most while it drives and turns along a path."""
    worst = 0.0
    yaw = start.yaw_rad
    headings = [*path.yaws_rad, path.goal.yaw_rad]
    for (x, y), to in zip(path.points_m, headings, strict=False):
        by = (to - yaw + math.pi) % math.tau - math.pi
        ways = []
        for turn in (by, by - math.copysign(math.tau, by)):
            poses = [outline(x, y, yaw + turn * k / 24) for k in range(25)]
            ways.append(max(one.difference(floor.buffer(1e-9)).area for one in poses))
        worst = max(worst, min(ways))
        yaw = to
    return worst


@pytest.mark.parametrize("width_m", [0.7, 0.6, 0.5, 0.45])
@pytest.mark.parametrize("aside_m", [0.0, 0.02])
def test_bends_that_fit_are_driven_through(width_m: float, aside_m: float) -> None:
    costmap, floor = bend(width_m)
    middle = middle_m(width_m)
    start = SE2(START_M, middle + aside_m, AHEAD)
    path = Planner(NARROW).plan(costmap, start, SE2(middle, END_M, UP))
    assert path.length_m == pytest.approx(middle - START_M + END_M - middle, rel=0.15)
    # A square centimetre: the faces are known to half a cell where the outline is at an angle.
    assert worst_m(path, start, floor) < 1e-4


def nose_to_the_wall(width_m: float) -> SE2:
    """At the corridor's end, where there is no room to drive on."""
    return SE2(4.5 * RESOLUTION_M + 0.0685 + 0.01, middle_m(width_m), math.pi)


def test_turning_round_at_a_dead_end_needs_the_width_of_the_corners() -> None:
    for width_m in (0.5, 0.45):
        costmap, floor = bend(width_m)
        goal = SE2(middle_m(width_m), END_M, UP)
        if width_m > 2.0 * WAFFLE.circumscribed_radius_m:
            start = SE2(START_M, middle_m(width_m), math.pi)
            assert worst_m(Planner(NARROW).plan(costmap, start, goal), start, floor) < 1e-4
            continue
        # A little way back it is wide enough.
        start = nose_to_the_wall(width_m)
        path = Planner(NARROW).plan(costmap, start, goal)
        assert worst_m(path, start, floor) < 1e-4
        assert driven_back_m(path) == pytest.approx(0.5)


def driven_back_m(path: PlannedPath) -> float:
    return float(np.diff(path.along_m)[path.backwards()[:-1]].sum())


def test_a_dead_end_too_long_to_back_out_of_is_refused() -> None:
    free = round(0.45 / RESOLUTION_M) - 1
    solid = np.ones((40, 80), bool)
    solid[20 : 20 + free, 5:75] = False
    costmap = costmap_of(solid, WAFFLE.half_width_m)
    start = nose_to_the_wall(0.45)
    with pytest.raises(NavigationError) as caught:
        Planner(NARROW).plan(costmap, start, SE2(2.0, start.y_m, math.pi))
    assert caught.value.code is ErrorCode.NO_VALID_PATH
    assert f"cannot turn at ({start.x_m:.2f}, {start.y_m:.2f})" in caught.value.message
    assert caught.value.place_m == pytest.approx(start[:2])


def room() -> Costmap:
    """Free from 0.225 m to 3.775 m in x and y: faces are in the middle of occupied cells."""
    solid = np.ones((80, 80), bool)
    solid[5:75, 5:75] = False
    return costmap_of(solid, WAFFLE.half_width_m)


ROOM_FLOOR = shapely.box(0.225, 0.225, 3.775, 3.775)


@pytest.mark.parametrize("askew_rad", [0.0, 0.3, -0.3])
def test_with_its_nose_at_a_wall_it_leaves_straight_back(askew_rad: float) -> None:
    away_m = outline(0.0, 0.0, math.pi + askew_rad).bounds[0]
    start = SE2(0.225 - away_m + 0.01, 1.5, math.pi + askew_rad)
    path = Planner(NARROW).plan(room(), start, SE2(2.5, 1.5, 0.0))
    assert path.backwards()[0]
    assert 0.0 < driven_back_m(path) <= path.way_out_m + 1e-9 <= 0.5 + 1e-9
    assert worst_m(path, start, ROOM_FLOOR) < 1e-4


def test_beside_a_wall_it_gets_off_it() -> None:
    beside_m = WAFFLE.half_width_m + 0.006
    start = SE2(0.225 + beside_m, 1.5, math.pi / 2 + 0.005)
    path = Planner(NARROW).plan(room(), start, SE2(2.5, 1.0, 0.0))
    assert worst_m(path, start, ROOM_FLOOR) < 1e-4


@pytest.mark.parametrize("deep_m", [0.0, 0.015])
def test_a_robot_that_touches_cells_drives_straight_out_of_them_first(deep_m: float) -> None:
    start = SE2(0.225 + 0.0685 - deep_m, 1.5, math.pi)
    path = Planner(NARROW).plan(room(), start, SE2(2.5, 1.5, 0.0))
    deepest = outline(*start).difference(ROOM_FLOOR).area
    for (x, y), yaw in zip(path.points_m, path.yaws_rad, strict=True):
        assert outline(x, y, yaw).difference(ROOM_FLOOR).area <= deepest + 1e-9
    assert path.backwards()[0]
    rest = replace(
        path,
        points_m=path.points_m[path.along_m >= path.way_out_m - 1e-9],
        yaws_rad=path.yaws_rad[path.along_m >= path.way_out_m - 1e-9],
    )
    x_m, y_m = rest.points_m[0].tolist()
    turning = SE2(x_m, y_m, start.yaw_rad)
    assert worst_m(rest, turning, ROOM_FLOOR) < 1e-4


def test_where_it_cannot_turn_round_it_drives_backwards_if_it_may() -> None:
    costmap, floor = bend(0.45)
    start, goal = nose_to_the_wall(0.45), SE2(middle_m(0.45), END_M, UP)
    path = Planner(replace(NARROW, allow_reverse=True)).plan(costmap, start, goal)
    steps = np.diff(path.points_m, axis=0)
    yaws = path.yaws_rad[:-1]
    ahead = steps[:, 0] * np.cos(yaws) + steps[:, 1] * np.sin(yaws)
    assert ahead[0] < 0.0
    assert worst_m(path, start, floor) < 1e-4


def test_a_goal_where_the_outline_does_not_fit_is_occupied() -> None:
    costmap, _ = bend(0.5)
    # Its back would be in the wall, its front would not.
    y_m = 19.5 * RESOLUTION_M + 0.17
    goal = SE2(START_M, y_m, UP)
    with pytest.raises(NavigationError) as caught:
        Planner(NARROW).plan(costmap, SE2(1.2, 1.25, AHEAD), goal)
    assert caught.value.code is ErrorCode.GOAL_OCCUPIED
    nearest = caught.value.nearest_free
    assert nearest is not None
    assert outline(*nearest).within(bend(0.5)[1])
    path = Planner(NARROW).plan(costmap, SE2(1.2, 1.22, math.pi), SE2(START_M, y_m, math.pi))
    assert path.goal.yaw_rad == math.pi


def test_a_gap_that_only_a_circle_would_not_fit_is_used() -> None:
    solid = np.zeros((60, 80), bool)
    solid[:, 38:42] = True
    # 0.40 m between the faces of the jambs; the circle around the outline needs 0.48 m.
    solid[26:33, 38:42] = False
    start, goal = SE2(0.8, 1.5, 0.0), SE2(3.2, 1.5, 0.0)
    path = Planner(NARROW).plan(costmap_of(solid, WAFFLE.half_width_m), start, goal)
    assert path.length_m < 2.6
    circle = costmap_of(solid, WAFFLE.circumscribed_radius_m)
    with pytest.raises(NavigationError):
        Planner(PARAMS).plan(circle, start, goal)


def fits(costmap: Costmap, pose: SE2) -> bool:
    grid = search_grid(costmap, WAFFLE.half_width_m, False)
    cell = grid.cell(*pose[:2])
    return cell is not None and grid.cells[cell] < SOLID and not hits(
        costmap.clearance_m, RESOLUTION_M, WAFFLE.points_m, WAFFLE.circles,
        *grid.at(*pose[:2]), pose.yaw_rad,
    )  # fmt: skip


def test_a_goal_that_no_way_leads_to_is_refused_without_a_search_of_the_whole_map() -> None:
    solid = np.ones((900, 900), bool)
    solid[5:895, 5:895] = False
    hall = costmap_of(solid, WAFFLE.half_width_m)
    # Its side at the wall: it could get there by driving sideways alone.
    goal = SE2(0.225 + WAFFLE.half_width_m + 0.0005, 20.01, math.pi / 2 + 0.003)
    assert fits(hall, goal)
    with pytest.raises(NavigationError) as caught:
        Planner(NARROW).plan(hall, SE2(30.0, 20.0, 0.0), goal)
    assert caught.value.code is ErrorCode.NO_VALID_PATH


@pytest.mark.parametrize("seed", [0, 3])
def test_between_any_two_poses_there_is_a_path_or_a_reason_why_not(seed: int) -> None:
    random = np.random.default_rng(seed)
    solid = np.ones((80, 80), bool)
    solid[5:75, 5:75] = random.random((70, 70)) < 0.004
    solid[40, 5:30] = solid[40, 38:75] = True
    costmap = costmap_of(solid, WAFFLE.half_width_m)
    planner = Planner(NARROW)
    codes = []
    for _ in range(80):
        (x, to_x, y, to_y), turns = random.uniform(0.3, 3.7, 4), random.uniform(-1.0, 1.0, 2)
        start, goal = SE2(x, y, math.pi * turns[0]), SE2(to_x, to_y, math.pi * turns[1])
        try:
            assert planner.plan(costmap, start, goal, 0.25).goal.yaw_rad == goal.yaw_rad
            codes.append(ErrorCode.NONE)
        except NavigationError as error:
            codes.append(error.code)
    assert codes.count(ErrorCode.NONE) > 30
    assert ErrorCode.PLANNER_TIMEOUT not in codes
