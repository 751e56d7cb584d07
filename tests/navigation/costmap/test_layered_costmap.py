from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.world.costmap import straightened
from mazebot.navigation.costmap.layered_costmap import (
    InflationParams,
    LayeredCostmap,
    LocalCostmap,
    ObstacleParams,
    StaticParams,
    frame_of,
    inflate,
    scan_points,
)
from mazebot.navigation.costmap.obstacle_layer import ScanSourceParams, denoised_ranges
from mazebot.navigation.costmap.static_layer import static_costs

INFLATION = InflationParams(
    custom_inscribed_radius=0.22, inflation_radius=0.55, cost_scaling_factor=3.0
)
OBSTACLE = ObstacleParams()
STEP_RAD = math.tau / 360


def turn(ranges_m: NDArray[np.float32], stamp_ns: int = 0) -> Scan:
    return Scan(ranges_m, 0.0, STEP_RAD, 0.12, 3.5, SE2(0.0, 0.0, 0.0), stamp_ns)


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
    assert costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor)))
    assert costmap.master.cost_at(2.41, 2.01) == 254
    assert costmap.static.cost_at(2.41, 2.01) == 0
    gone = ranges_to(99.0, 99.0, 0.1, sensor)
    assert costmap.update(sensor, turn(gone))
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_walls_of_the_map_mark_nothing_even_where_the_pose_is_a_little_wrong() -> None:
    costmap, sensor = room(), SE2(1.5, 2.0, 0.0)
    ranges = ranges_to(99.0, 99.0, 0.1, sensor)
    assert not costmap.update(SE2(1.58, 1.95, 0.03), turn(ranges))


def test_clear_forgets_what_the_scan_marked_and_keeps_the_map() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor)))
    revision = costmap.revision
    costmap.clear()
    assert costmap.revision > revision
    assert np.array_equal(costmap.master.costs, costmap.static.costs)
    assert costmap.master.costs[0, 0] == 254


def test_rays_without_an_echo_clear_but_mark_nothing() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor)))
    assert costmap.update(sensor, turn(np.full(360, np.inf, np.float32)))
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_echoes_come_in_the_frame_of_the_base() -> None:
    ranges = np.array([1.0, np.inf, 0.05, 1.0], np.float32)
    points = scan_points(Scan(ranges, 0.0, math.pi / 2, 0.12, 3.5, SE2(-0.1, 0.0, math.pi / 2)))
    assert points == pytest.approx(np.array([[-0.1, 1.0], [0.9, 0.0]]), abs=1e-6)


def brute_distance_m(lethal: NDArray[np.bool_], limit_m: float) -> NDArray[np.float64]:
    places = np.argwhere(lethal)
    grid = np.argwhere(np.ones_like(lethal))
    if not len(places):
        return np.full(lethal.shape, limit_m)
    squares = ((grid[:, None] - places[None]) ** 2).sum(2).min(1)
    return np.asarray(np.minimum(0.05 * np.sqrt(squares), limit_m).reshape(lethal.shape))


def test_distances_are_exact_up_to_their_limit() -> None:
    random = np.random.default_rng(4)
    for share in (0.0, 0.001, 0.02, 0.4):
        lethal = random.random((50, 70)) < share
        frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), np.zeros((50, 70), np.int8))
        found = inflate(frame, lethal, np.zeros_like(lethal), INFLATION).distance_m
        assert found.max() <= 1.05 + 1e-6
        assert found == pytest.approx(brute_distance_m(lethal, float(found.max())), abs=1e-6)


def test_updating_windows_gives_the_same_as_the_whole() -> None:
    costmap = room(160)
    random = np.random.default_rng(2)
    for i in range(30):
        sensor = SE2(*random.uniform((1.0, 1.0, -3.0), (7.0, 7.0, 3.0)))
        ranges = np.abs(random.normal(1.5, 0.8, 360)).astype(np.float32)
        ranges[random.random(360) < 0.1] = np.inf
        costmap.update(sensor, turn(ranges, i * 100_000_000), map_from_base=sensor)
        if i % 10 == 5:
            costmap.clear_around(sensor, 1.0)
        if i % 10 == 8:
            costmap.clear_except(sensor, 2.0)
    lethal = costmap.master.costs == 254
    assert lethal.sum() > (costmap.static.costs == 254).sum() + 50
    whole = inflate(costmap.frame, lethal, np.zeros_like(lethal), INFLATION)
    assert np.array_equal(costmap.master.costs, whole.costs)
    assert np.array_equal(costmap.master.distance_m, whole.distance_m)


def test_what_changed_is_within_the_window_that_is_taken() -> None:
    costmap = room(160)
    costmap.take_changed()
    assert costmap.take_changed() is None
    random = np.random.default_rng(3)
    shown = costmap.master.occupancy().copy()
    smaller = 0
    for i in range(30):
        for _ in range(random.integers(1, 4)):
            sensor = SE2(*random.uniform((1.0, 1.0, -3.0), (7.0, 7.0, 3.0)))
            ranges = np.full(360, np.inf, np.float32)
            ranges[: random.integers(1, 40)] = random.uniform(0.3, 1.5)
            costmap.update(sensor, turn(ranges, i * 100_000_000), map_from_base=sensor)
        window = costmap.take_changed()
        if window is not None:
            at = np.s_[window[0] : window[1], window[2] : window[3]]
            shown[at] = costmap.master.occupancy(at)
            smaller += shown[at].size < shown.size
        assert np.array_equal(shown, costmap.master.occupancy())
    assert smaller > 20


def test_a_window_counts_what_stands_just_outside_it() -> None:
    sensor = SE2(4.0, 4.0, 0.0)
    for dx, dy in ((1.5, 0.0), (0.0, 1.5), (-1.5, 0.0), (0.0, -1.5)):
        costmap = room(160)
        for x_m, y_m in ((4.0 + dx, 4.0 + dy), (4.0 - 0.2 * dx, 4.0 - 0.2 * dy)):
            angle = math.atan2(y_m - 4.0, x_m - 4.0)
            ranges = np.full(360, -np.inf, np.float32)
            ranges[round(angle / STEP_RAD) % 360] = math.hypot(x_m - 4.0, y_m - 4.0)
            costmap.update(sensor, turn(ranges))
        lethal = costmap.master.costs == 254
        whole = inflate(costmap.frame, lethal, np.zeros_like(lethal), INFLATION)
        assert np.array_equal(costmap.master.distance_m, whole.distance_m)


def test_only_the_square_is_cleared_or_all_but_it() -> None:
    sensor = SE2(1.0, 2.0, 0.0)
    posts = np.minimum(ranges_to(2.5, 2.0, 0.1, sensor), ranges_to(1.0, 3.0, 0.1, sensor))
    for around, kept, gone in (
        (True, (1.0, 2.91), (2.41, 2.01)),
        (False, (2.41, 2.01), (1.0, 2.91)),
    ):
        costmap = room()
        costmap.update(sensor, turn(posts))
        assert costmap.master.cost_at(*kept) == costmap.master.cost_at(*gone) == 254
        (costmap.clear_around if around else costmap.clear_except)(SE2(2.5, 2.0, 0.0), 0.5)
        assert costmap.master.cost_at(*kept) == 254
        assert costmap.master.cost_at(*gone) != 254
        assert costmap.master.costs[0, 0] == 254


def test_what_moves_leaves_no_trail() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    for i in range(20):
        post_y_m = 1.0 + 0.05 * i
        ranges = ranges_to(2.2, post_y_m, 0.12, sensor)
        costmap.update(sensor, turn(ranges, i * 100_000_000))
        marked = np.argwhere((costmap.master.costs == 254) & (costmap.static.costs != 254))
        centres_m = (marked[:, ::-1] + 0.5) * 0.05
        assert len(centres_m)
        assert np.hypot(*(centres_m - [2.2, post_y_m]).T).max() < 0.12 + 0.06


def test_a_box_taken_away_is_gone_within_a_second_however_long_it_stood() -> None:
    costmap, sensor = room(), SE2(0.6, 2.0, 0.0)
    for i in range(100):
        there = ranges_to(2.9, 2.0, 0.15, sensor)
        costmap.update(sensor, turn(there, i * 100_000_000))
    assert costmap.master.clearance_at(2.75, 2.0) < 0.05
    for i in range(100, 110):
        gone = ranges_to(99.0, 99.0, 0.1, sensor)
        costmap.update(sensor, turn(gone, i * 100_000_000))
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_a_thin_post_far_away_does_not_flicker() -> None:
    costmap = room()
    random = np.random.default_rng(1)
    lost = 0
    for i in range(100):
        # The rays meet it in two scans of three.
        sensor = SE2(1.0 + 0.002 * i, 2.0, 0.0001 * i * i)
        ranges = ranges_to(3.0, 2.2, 0.012, sensor)
        ranges += random.normal(0.0, 0.01, 360).astype(np.float32)
        costmap.update(sensor, turn(ranges, i * 100_000_000))
        lost += costmap.master.clearance_at(3.0, 2.2) > 0.1
    assert lost <= 3


def test_a_wall_seen_at_a_grazing_angle_has_no_gaps() -> None:
    costmap, sensor = room(120), SE2(0.6, 3.0, 0.0)
    # The face of a long box that is not on the map, 0.3 m beside the line of sight.
    angles = STEP_RAD * np.arange(360)
    with np.errstate(divide="ignore", invalid="ignore"):
        face = np.where((angles > 0.0) & (angles < 1.5), 0.3 / np.sin(angles), np.inf)
    face = np.where((face * np.cos(angles) > 0.5) & (face < 2.4), face, np.inf).astype(np.float32)
    costmap.update(sensor, turn(face))
    along_m = np.arange(1.2, 2.3, 0.05)
    assert all(costmap.master.clearance_at(x_m, 3.3) < 0.08 for x_m in along_m)
    for i in range(10):
        assert not costmap.update(sensor, turn(face, i * 100_000_000))


def test_marks_that_no_ray_meets_again_are_forgotten_after_their_time() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor), 0))
    blind = np.full(360, -np.inf, np.float32)
    for seconds in range(1, 40):
        costmap.update(sensor, turn(blind, seconds * 1_000_000_000))
        there = costmap.master.cost_at(2.41, 2.01) == 254
        assert there == (seconds <= 30), seconds


def test_rays_without_an_echo_clear_only_where_that_is_wanted() -> None:
    obstacle = ObstacleParams(scan=ScanSourceParams(inf_is_valid=False))
    cells = np.zeros((80, 80), np.int8)
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap, sensor = LayeredCostmap(frame, cells, INFLATION, obstacle), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor)))
    assert not costmap.update(sensor, turn(np.full(360, np.inf, np.float32)))


def test_what_a_prediction_has_is_not_marked_and_what_it_was_is_cleared() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    ranges = ranges_to(2.5, 2.0, 0.1, sensor)
    costmap.update(sensor, turn(ranges))
    circle = np.array([[2.5, 2.0, 0.2]])
    assert costmap.update(sensor, turn(ranges), moving_m=circle)
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_the_robots_own_place_is_free() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    costmap.update(sensor, turn(ranges_to(2.5, 2.0, 0.1, sensor)))
    assert costmap.master.cost_at(2.41, 2.01) == 254
    blind = np.full(360, -np.inf, np.float32)
    here = SE2(2.45, 2.0, 0.0)
    assert costmap.update(here, turn(blind), map_from_base=here)
    assert costmap.master.cost_at(2.41, 2.01) != 254


def test_the_local_costmap_moves_with_the_robot_and_keeps_what_it_saw() -> None:
    local = LocalCostmap(0.05, INFLATION, OBSTACLE, (3.0, 2.0))
    assert local.master.costs.shape == (40, 60)
    robot = SE2(0.0, 0.0, 0.0)
    local.update(robot, turn(ranges_to(1.0, 0.3, 0.1, robot)))
    assert local.master.clearance_at(0.92, 0.27) < 0.06
    blind = np.full(360, -np.inf, np.float32)
    for i in range(1, 30):
        robot = SE2(0.02 * i, 0.01 * i, 0.1 * i)
        local.move(robot)
        local.update(robot, turn(blind))
        assert local.master.clearance_at(0.92, 0.27) < 0.06
        row, column = local.frame.cell(robot.x_m, robot.y_m) or (0, 0)
        assert abs(row - 20) <= 1
        assert abs(column - 30) <= 1
    local.move(SE2(9.0, 0.0, 0.0))
    assert not local.master.costs.any()


def test_following_the_robot_is_to_move_and_to_update() -> None:
    follows, moves = (LocalCostmap(0.05, INFLATION, OBSTACLE, (3.0, 2.0)) for _ in range(2))
    for i in range(12):
        # In the last steps it stands.
        robot = SE2(0.03 * min(i, 9), -0.02 * min(i, 9), 0.2 * i)
        scan = turn(ranges_to(1.0, 0.3, 0.1, robot))
        follows.follow(robot, scan)
        moves.move(robot)
        moves.update(robot, scan, map_from_base=robot)
        assert follows.frame == moves.frame
        assert follows.static.frame == moves.frame
        assert np.array_equal(follows.master.costs, moves.master.costs)
        assert np.array_equal(follows.master.distance_m, moves.master.distance_m)
    assert follows.master.costs.any()


def test_the_values_of_a_map_become_costs_by_nav2s_rules() -> None:
    cells = np.array([[0, 50, 99, 100, -1]], np.int8)
    assert static_costs(cells, StaticParams()).tolist() == [[0, 0, 0, 254, 255]]
    scaled = StaticParams(trinary_costmap=False, track_unknown_space=False)
    assert static_costs(cells, scaled).tolist() == [[0, 127, 251, 254, 0]]
    lower = StaticParams(lethal_cost_threshold=65)
    assert static_costs(cells, lower).tolist() == [[0, 0, 254, 254, 255]]


def test_unknown_cells_stay_unknown_unless_the_robot_would_collide_there() -> None:
    cells = np.zeros((20, 20), np.int8)
    cells[:, 10:] = -1
    cells[10, 9] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costs = LayeredCostmap(frame, cells, INFLATION, OBSTACLE).master.costs
    assert costs[10, 10] == 253
    assert costs[10, 15] == 255
    assert 0 < costs[10, 4] < 253


def test_noise_is_averaged_on_a_surface_and_no_edge_is_moved() -> None:
    random = np.random.default_rng(6)
    wall = np.full(360, 1.0, np.float32)
    wall[100:200] = 2.0
    wall[300] = np.inf
    wall[310] = -np.inf
    wall[320] = np.nan
    noisy = wall + random.normal(0.0, 0.01, 360).astype(np.float32)
    less = denoised_ranges(noisy)
    middle = np.r_[5:95, 105:195, 205:295]
    assert (less[middle] - wall[middle]).std() == pytest.approx(0.01 / math.sqrt(3.0), rel=0.15)
    for at in (99, 100, 199, 200, 299, 300, 301, 310, 320):
        assert less[at] == noisy[at] or np.isnan(noisy[at])
    assert np.isnan(less[320])
    assert np.isinf(less[[300, 310]]).all()


def test_rays_that_are_lost_open_no_gap() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    random = np.random.default_rng(9)
    whole = ranges_to(2.2, 2.0, 0.2, sensor)
    costmap.update(sensor, turn(whole))
    for i in range(100):
        lossy = np.where(random.random(360) < 0.5, np.float32(np.inf), whole).astype(np.float32)
        costmap.update(sensor, turn(lossy, i * 100_000_000))
        front_m = [costmap.master.clearance_at(2.02, y_m) for y_m in (1.93, 1.96, 2.0, 2.04, 2.07)]
        assert max(front_m) < 0.06, i


def test_one_ray_without_an_echo_is_lost_and_three_are_open_space() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    one = np.full(360, -np.inf, np.float32)
    one[10] = 1.2
    costmap.update(sensor, turn(one))
    one[10] = np.inf
    assert not costmap.update(sensor, turn(one))
    one[9:12] = np.inf
    assert costmap.update(sensor, turn(one))


def test_a_box_taken_away_before_open_space_is_gone_within_a_second() -> None:
    costmap, sensor = room(), SE2(1.0, 2.0, 0.0)
    for i in range(50):
        costmap.update(sensor, turn(ranges_to(2.2, 2.0, 0.2, sensor), i * 100_000_000))
    nothing = np.full(360, np.inf, np.float32)
    for i in range(50, 60):
        costmap.update(sensor, turn(nothing, i * 100_000_000))
    assert np.array_equal(costmap.master.costs, costmap.static.costs)


def test_the_better_the_pose_is_known_the_nearer_to_walls_things_are_marked() -> None:
    sensor = SE2(2.0, 2.0, 0.0)
    # The wall's face in the map is at y = 3.975; a flat box before it stands out by 0.15 m.
    box = ranges_to(99.0, 99.0, 0.1, sensor)
    ahead = np.arange(85, 96)
    box[ahead] = (3.825 - 2.0) / np.sin(STEP_RAD * ahead)
    assert not room().update(sensor, turn(box))
    costmap = room()
    assert costmap.update(sensor, turn(box), static_margin_m=0.1)
    assert costmap.master.clearance_at(2.0, 3.83) < 0.05


def test_obstacles_stay_where_they_are_while_the_map_grows() -> None:
    costmap = room()
    see_post(costmap)
    marked = {costmap.frame.center(*cell) for cell in np.argwhere(obstacles(costmap)).tolist()}
    assert marked
    cells = np.full((100, 120), -1, np.int8)
    cells[12:92, 22:102] = room_cells()
    frame = frame_of(0.05, SE2(-22 * 0.05, -12 * 0.05, 0.0), cells)
    before = costmap.revision
    costmap.take_map(frame, cells, 0.1)
    assert costmap.revision > before
    assert costmap.master.costs.shape == costmap.static.costs.shape == (100, 120)
    again = {frame.center(*cell) for cell in np.argwhere(obstacles(costmap)).tolist()}
    assert np.allclose(sorted(again), sorted(marked))
    fresh = LayeredCostmap(frame, cells, INFLATION, OBSTACLE)
    assert np.array_equal(costmap.static.costs, fresh.static.costs)
    costmap.clear()
    assert np.array_equal(costmap.master.costs, fresh.master.costs)


def test_what_the_map_comes_to_show_is_no_obstacle_any_more() -> None:
    costmap = room()
    see_post(costmap)
    cells = room_cells()
    cells[obstacles(costmap)] = 100
    costmap.take_map(costmap.frame, cells, 0.1)
    costmap.take_map(costmap.frame, room_cells(), 0.0)
    assert not obstacles(costmap).any()


def test_a_map_that_shrinks_or_moves_away_loses_only_what_lies_outside() -> None:
    costmap = room()
    see_post(costmap)
    cells = np.zeros((10, 10), np.int8)
    costmap.take_map(frame_of(0.05, SE2(50.0, 50.0, 0.0), cells), cells, 0.1)
    assert not obstacles(costmap).any()
    coarse = np.zeros((40, 40), np.int8)
    costmap.take_map(frame_of(0.1, SE2(0.0, 0.0, 0.0), coarse), coarse, 0.1)
    assert costmap.master.costs.shape == (40, 40)


def room_cells() -> NDArray[np.int8]:
    cells = np.zeros((80, 80), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    return cells


def see_post(costmap: LayeredCostmap) -> None:
    """A post 1 m ahead of a robot in the middle of the room."""
    ranges_m = np.full(360, np.inf, np.float32)
    ranges_m[-4:] = ranges_m[:5] = 1.0
    costmap.update(SE2(2.0, 2.0, 0.0), Scan(ranges_m, 0.0, STEP_RAD, 0.1, 3.5, SE2(0.0, 0.0, 0.0)))


def obstacles(costmap: LayeredCostmap) -> NDArray[np.bool_]:
    return np.asarray((costmap.master.costs == 254) & (costmap.static.costs != 254))


def marked_post(costmap: LayeredCostmap, first_s: float, scans: int) -> tuple[int, int]:
    """Mark a post 1 m ahead of the middle of the room with some scans; the cell of its face."""
    ranges = np.full(360, 1.8, np.float32)
    ranges[-3:] = ranges[:4] = 1.0
    for i in range(scans):
        costmap.update(SE2(2.0, 2.0, 0.0), turn(ranges, round((first_s + 0.1 * i) * 1e9)))
    cell = costmap.frame.cell(3.0, 2.0)
    assert cell is not None
    return cell


def see_nothing(costmap: LayeredCostmap, at_s: float, moving: bool = False) -> None:
    """A scan without any measurement, with or without something that moves at the post."""
    circles = np.array([[3.0, 2.0, 0.3]] if moving else []).reshape(-1, 3)
    costmap.update(
        SE2(2.0, 2.0, 0.0), turn(np.full(360, np.nan, np.float32), round(at_s * 1e9)),
        moving_m=circles,
    )  # fmt: skip


def test_what_is_held_is_cleared_by_rays_alone() -> None:
    costmap = room()
    cell = marked_post(costmap, 0.0, 3)
    costmap.hold(3.0, 2.0, 0.5, pinned=False)
    costmap.clear()
    for at_s in range(1, 40):
        see_nothing(costmap, float(at_s), moving=True)
    assert costmap.master.costs[cell] == 254
    for i in range(8):
        costmap.update(
            SE2(2.0, 2.0, 0.0), turn(np.full(360, 1.8, np.float32), round((41 + i) * 1e9))
        )
    assert costmap.master.costs[cell] != 254


def test_what_is_pinned_stays_until_it_is_released() -> None:
    costmap = room()
    cell = marked_post(costmap, 0.0, 3)
    costmap.hold(3.0, 2.0, 0.5, pinned=True)
    for i in range(9):
        if i == 8:
            costmap.release()
        costmap.update(
            SE2(2.0, 2.0, 0.0), turn(np.full(360, 1.8, np.float32), round((1 + i) * 1e9))
        )
        assert (costmap.master.costs[cell] == 254) == (i < 8)


def test_a_closed_gap_is_no_way_until_it_is_opened() -> None:
    costmap = room()
    cell = costmap.frame.cell(3.0, 2.0)
    assert cell is not None
    costmap.close_gap((3.0, 1.8), (3.0, 2.2))
    costmap.release()
    costmap.clear()
    costmap.update(SE2(2.0, 2.0, 0.0), turn(np.full(360, 1.8, np.float32)))
    assert costmap.master.costs[cell] == 254
    costmap.open_gap((3.0, 1.8), (3.0, 2.2))
    assert costmap.master.costs[cell] != 254
