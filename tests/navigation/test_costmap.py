from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from services.common.frames import SE2
from services.common.world.costmap import straightened
from services.navigation.costmap import (
    InflationParams,
    LayeredCostmap,
    ObstacleParams,
    frame_of,
    inflate,
    scan_points,
)

INFLATION = InflationParams(robot_radius_m=0.22, inflation_radius_m=0.55, cost_scaling_factor=3.0)
OBSTACLE = ObstacleParams(obstacle_max_range_m=2.5, raytrace_max_range_m=3.0, static_margin_m=0.2)
STEP_RAD = math.tau / 360


def room(size: int = 80) -> LayeredCostmap:
    """A room of 4 m with its corner at the origin of the map."""
    cells = np.zeros((size, size), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    return LayeredCostmap(frame, cells, INFLATION, OBSTACLE)


def test_inflation_follows_the_formula_of_nav2() -> None:
    lethal = np.zeros((1, 40), np.bool_)
    lethal[0, 0] = True
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), np.zeros((1, 40), np.int8))
    costs = inflate(frame, lethal, np.zeros_like(lethal), INFLATION).costs[0]
    expected = [254] + [
        253 if d <= 0.22 else int(252 * math.exp(-3.0 * (d - 0.22))) if d <= 0.55 else 0
        for d in 0.05 * np.arange(1, 40)
    ]
    # 11 cells are 0.55 m but for rounding.
    assert [*costs[:11], *costs[12:]] == [*expected[:11], *expected[12:]]


def test_unknown_cells_are_not_free() -> None:
    cells = np.zeros((20, 20), np.int8)
    cells[5, 5] = -1
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(frame, cells, INFLATION, OBSTACLE).master
    assert costmap.costs[5, 5] == 255
    assert costmap.occupancy()[5, 5] == -1
    assert costmap.costs[5, 6] == 0


def test_occupancy_has_the_values_of_nav2() -> None:
    costmap = room().master
    occupancy = costmap.occupancy()
    assert occupancy[0, 40] == 100
    assert occupancy[2, 40] == 99
    assert occupancy[40, 40] == 0
    between = occupancy[(costmap.costs > 0) & (costmap.costs < 253)]
    assert between.min() >= 1
    assert between.max() <= 98


def test_a_point_finds_its_cell_and_none_outside() -> None:
    frame = frame_of(0.05, SE2(-1.0, 2.0, 0.0), np.zeros((10, 20), np.int8))
    assert frame.cell(-0.99, 2.01) == (0, 0)
    assert frame.cell(-0.01, 2.49) == (9, 19)
    assert frame.cell(0.01, 2.2) is None
    assert frame.cell(-1.01, 2.2) is None
    assert frame.cell(1e300, 2.2) is None


def test_a_turned_map_is_refused_by_its_yaw() -> None:
    with pytest.raises(ValueError, match=r"yaw 0\.300 rad: must be 0"):
        frame_of(0.05, SE2(0.0, 0.0, 0.3), np.zeros((2, 2), np.int8))


def test_a_turned_map_is_made_straight_and_loses_nothing_occupied() -> None:
    rng = np.random.default_rng(2)
    cells = np.where(rng.random((60, 90)) < 0.02, 100, 0).astype(np.int8)
    cells[:, :10] = -1
    origin = SE2(-1.0, 2.0, 2.3)
    moved, straight = straightened(0.05, origin, cells)
    assert moved.yaw_rad == 0.0
    frame = frame_of(0.05, moved, straight)
    for row, column in np.ndindex(cells.shape):
        x_m, y_m, _ = origin @ SE2((column + 0.5) * 0.05, (row + 0.5) * 0.05, 0.0)
        cell = frame.cell(x_m, y_m)
        assert cell is not None
        around = straight[cell[0] - 1 : cell[0] + 2, cell[1] - 1 : cell[1] + 2]
        if cells[row, column] == 100:
            assert (around == 100).any()
    # A cell at a slant reaches into two or three.
    assert 1.0 < (straight == 100).sum() / (cells == 100).sum() < 2.6
    assert (straight == 0).sum() == pytest.approx((cells == 0).sum(), rel=0.05)
    assert straight[0, 0] == straight[-1, -1] == -1


def test_a_straight_map_is_left_as_it_is() -> None:
    cells = np.zeros((3, 4), np.int8)
    origin = SE2(1.0, 2.0, 0.0)
    moved, same = straightened(0.05, origin, cells)
    assert moved == origin
    assert same is cells
    # By a quarter turn it only changes places.
    cells[0, 3] = 100
    moved, turned = straightened(0.5, SE2(1.0, 2.0, math.pi / 2), cells)
    assert moved[:2] == pytest.approx((-0.5, 2.0))
    assert np.argwhere(turned == 100).tolist() == [[3, 2]]
    assert turned.shape == (4, 3)


def ranges_to(x_m: float, y_m: float, radius_m: float, sensor: SE2) -> NDArray[np.float32]:
    """Scan of the room's walls with a round post in it."""
    angles = sensor.yaw_rad + STEP_RAD * np.arange(360)
    dx, dy = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        walls = np.minimum(
            np.where(dx > 0, 3.95 - sensor.x_m, 0.05 - sensor.x_m) / dx,
            np.where(dy > 0, 3.95 - sensor.y_m, 0.05 - sensor.y_m) / dy,
        )
    along = (x_m - sensor.x_m) * dx + (y_m - sensor.y_m) * dy
    beside = np.abs((x_m - sensor.x_m) * dy - (y_m - sensor.y_m) * dx)
    hit = (beside < radius_m) & (along > 0)
    post = along - np.sqrt(np.maximum(radius_m**2 - beside**2, 0.0))
    ranges = np.where(hit, np.minimum(post, walls), walls)
    return np.asarray(ranges, np.float32)


def test_a_scan_marks_a_post_and_clears_it_when_it_is_gone() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    assert costmap.update(sensor, ranges_to(2.5, 2.0, 0.1, sensor), 0.0, STEP_RAD, 0.12)
    assert costmap.master.cost_at(2.41, 2.01) == 254
    assert costmap.static.cost_at(2.41, 2.01) == 0
    gone = ranges_to(99.0, 99.0, 0.1, sensor)
    assert costmap.update(sensor, gone, 0.0, STEP_RAD, 0.12)
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_walls_of_the_map_mark_nothing_even_where_the_pose_is_a_little_wrong() -> None:
    costmap, sensor = room(), SE2(1.5, 2.0, 0.0)
    ranges = ranges_to(99.0, 99.0, 0.1, sensor)
    assert not costmap.update(SE2(1.58, 1.95, 0.03), ranges, 0.0, STEP_RAD, 0.12)


def test_clear_forgets_what_the_scan_marked_and_keeps_the_map() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, ranges_to(2.5, 2.0, 0.1, sensor), 0.0, STEP_RAD, 0.12)
    revision = costmap.revision
    costmap.clear()
    assert costmap.revision > revision
    assert np.array_equal(costmap.master.costs, costmap.static.costs)
    assert costmap.master.costs[0, 0] == 254


def test_rays_without_an_echo_clear_but_mark_nothing() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, ranges_to(2.5, 2.0, 0.1, sensor), 0.0, STEP_RAD, 0.12)
    assert costmap.update(sensor, np.full(360, np.inf, np.float32), 0.0, STEP_RAD, 0.12)
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_echoes_come_in_the_frame_of_the_base() -> None:
    ranges = np.array([1.0, np.inf, 0.05, 1.0], np.float32)
    points = scan_points(SE2(-0.1, 0.0, math.pi / 2), ranges, 0.0, math.pi / 2, 0.12, 3.5)
    assert points == pytest.approx(np.array([[-0.1, 1.0], [0.9, 0.0]]), abs=1e-6)
