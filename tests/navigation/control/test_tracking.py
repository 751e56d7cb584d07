from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.tracking import ObstacleTracker, TrackerParams
from mazebot.navigation.costmap.layered_costmap import (
    Costmap,
    InflationParams,
    frame_of,
    inflate,
    scan_points,
)
from tests.navigation.house_tour import ANGLE_INCREMENT_RAD, RANGE_MIN_M, as_ranges, cast

SENSOR = SE2(0.0, 0.0, 0.0)


def hall() -> Costmap:
    """Eight metres square about the origin, walled."""
    cells = np.zeros((160, 160), np.int8)
    cells[:3] = cells[-3:] = cells[:, :3] = cells[:, -3:] = 100
    frame = frame_of(0.05, SE2(-4.0, -4.0, 0.0), cells)
    return inflate(
        frame,
        cells >= 100,
        cells < 0,
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=10.0
        ),
    )


GRID = hall()
WALLS = np.array(
    [(-3.87, -3.87, 3.87, -3.87), (3.87, -3.87, 3.87, 3.87), (3.87, 3.87, -3.87, 3.87),
     (-3.87, 3.87, -3.87, -3.87)]
)  # fmt: skip


def post(x_m: float, y_m: float, radius_m: float = 0.15) -> Array:
    """(12, 4) faces of a post."""
    angles = np.arange(12) * math.tau / 12
    corners = np.stack([x_m + radius_m * np.cos(angles), y_m + radius_m * np.sin(angles)], axis=1)
    return np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)


def watch(
    tracker: ObstacleTracker,
    places: Callable[[float], list[tuple[float, float]]],
    seconds: float,
    seed: int = 1,
    start_s: float = 0.0,
    grid: Costmap = GRID,
) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Ten scans a second of posts; the points and the mask of the last one."""
    random = np.random.default_rng(seed)
    for i in range(round(seconds * 10) + 1):
        t = start_s + i * 0.1
        segments = np.concatenate([WALLS, *(post(*place) for place in places(t))])
        ranges = as_ranges(cast(SENSOR, segments), random)
        points = scan_points(Scan(ranges, 0.0, ANGLE_INCREMENT_RAD, RANGE_MIN_M, 3.5, SENSOR))
        mask = tracker.update(t, points, grid.distance_m, grid.frame)
    return points, mask


def crossing(t: float) -> list[tuple[float, float]]:
    return [(1.5, -1.0 + 0.4 * t)]


def test_a_post_that_crosses_is_tracked_with_its_velocity() -> None:
    tracker = ObstacleTracker(TrackerParams())
    points, mask = watch(tracker, crossing, 3.0)
    (track,) = tracker.moving(3.0)
    assert track.x_m == pytest.approx(1.5, abs=0.08)
    assert track.y_m == pytest.approx(0.2, abs=0.08)
    assert track.velocity_y_m_s == pytest.approx(0.4, abs=0.08)
    assert abs(track.velocity_x_m_s) < 0.1
    assert track.radius_m == pytest.approx(0.15, abs=0.05)
    assert mask.any()
    assert np.hypot(*(points[mask] - np.array([1.5, 0.2])).T).max() < 0.25
    later = tracker.moving(3.2)[0]
    assert later.y_m == pytest.approx(track.y_m + 0.2 * track.velocity_y_m_s)


def test_a_post_that_stands_and_a_wall_do_not_move() -> None:
    tracker = ObstacleTracker(TrackerParams())
    _, mask = watch(tracker, lambda _: [(1.5, 0.3)], 5.0)
    assert not tracker.moving(5.0)
    assert len(tracker.tracks(5.0)) == 1
    assert not mask.any()


def test_a_post_is_known_to_move_within_a_second_and_a_half() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, crossing, 1.5)
    assert len(tracker.moving(1.5)) == 1


def test_a_post_that_turns_back_goes_on_moving() -> None:
    tracker = ObstacleTracker(TrackerParams())

    def patrol(t: float) -> list[tuple[float, float]]:
        return [(1.5, -1.0 + 0.4 * t if t < 3.0 else 0.2 - 0.4 * (t - 3.0))]

    watch(tracker, patrol, 3.0)
    for i in range(1, 11):
        watch(tracker, patrol, 0.0, start_s=3.0 + 0.1 * i)
        assert len(tracker.moving(3.0 + 0.1 * i)) == 1
    assert tracker.moving(4.0)[0].velocity_y_m_s < -0.2


def test_a_post_that_waits_for_a_moment_counts_as_moving_all_the_time() -> None:
    tracker = ObstacleTracker(TrackerParams())

    def waits(t: float) -> list[tuple[float, float]]:
        return [(1.5, -1.0 + 0.4 * (min(t, 3.0) + max(t - 3.7, 0.0)))]

    watch(tracker, waits, 3.0)
    speeds = []
    for i in range(1, 15):
        watch(tracker, waits, 0.0, start_s=3.0 + 0.1 * i)
        (track,) = tracker.moving(3.0 + 0.1 * i)
        speeds.append(track.speed_m_s)
    assert min(speeds) < 0.1


def test_a_post_that_has_stopped_becomes_an_obstacle_that_stands() -> None:
    tracker = ObstacleTracker(TrackerParams())
    _, mask = watch(tracker, lambda t: [(1.5, -1.0 + 0.4 * min(t, 3.0))], 6.0)
    assert not tracker.moving(6.0)
    assert not mask.any()


def test_two_posts_that_meet_keep_their_numbers() -> None:
    tracker = ObstacleTracker(TrackerParams())

    def two(t: float) -> list[tuple[float, float]]:
        return [(1.2, -1.0 + 0.4 * t), (2.2, 1.0 - 0.4 * t)]

    watch(tracker, two, 1.5)
    before = {track.number: track.velocity_y_m_s > 0.0 for track in tracker.moving(1.5)}
    watch(tracker, two, 0.3, start_s=1.6)
    after = {track.number: track.velocity_y_m_s > 0.0 for track in tracker.moving(1.9)}
    assert len(before) == 2
    assert before == after


def test_what_is_gone_is_dropped_and_all_is_forgotten_on_request() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, crossing, 2.0)
    watch(tracker, lambda _: [], 0.5, start_s=2.1)
    assert not tracker.tracks(2.6)
    watch(tracker, crossing, 2.0, start_s=3.0)
    tracker.clear()
    assert not tracker.tracks(5.0)


def test_a_scan_of_the_past_and_one_after_a_long_time_are_no_motion() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, crossing, 2.0)
    tracks = tracker.moving(2.0)
    watch(tracker, crossing, 0.0, start_s=1.0)
    assert tracker.moving(2.0) == tracks
    watch(tracker, crossing, 0.0, start_s=4.0)
    assert not tracker.tracks(4.0)


def test_an_empty_scan_is_taken() -> None:
    tracker = ObstacleTracker(TrackerParams())
    assert tracker.update(0.0, np.empty((0, 2)), GRID.distance_m, GRID.frame).size == 0


def test_points_around_the_first_beam_are_one_obstacle() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, lambda _: [(1.0, 0.0)], 0.5)
    (track,) = tracker.tracks(0.5)
    assert track.x_m == pytest.approx(1.0, abs=0.1)
    assert track.y_m == pytest.approx(0.0, abs=0.03)


def to_the_wall_and_back(t: float) -> list[tuple[float, float]]:
    """A post that comes to the wall of `corridor` within 3 s, stands for 3 s and turns back."""
    return [(1.5, -0.93 + 0.4 * min(t, 3.0) - 0.4 * max(t - 6.0, 0.0))]


def corridor() -> Costmap:
    """The hall with a wall at y from 0.5 to 0.65."""
    cells = np.zeros((160, 160), np.int8)
    cells[90:93] = 100
    frame = frame_of(0.05, SE2(-4.0, -4.0, 0.0), cells)
    return inflate(
        frame,
        cells >= 100,
        cells < 0,
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=10.0
        ),
    )


def test_what_has_stopped_before_a_wall_is_expected_to_turn_back_for_a_while() -> None:
    tracker = ObstacleTracker(TrackerParams(turning_time=2.0))
    grid = corridor()
    watch(tracker, to_the_wall_and_back, 3.0, grid=grid)
    assert not tracker.turning()
    watch(tracker, to_the_wall_and_back, 1.5, start_s=3.1, grid=grid)
    (track,) = tracker.turning()
    assert track.velocity_y_m_s == pytest.approx(-0.4, abs=0.1)
    assert abs(track.velocity_x_m_s) < 0.1
    assert track.y_m == pytest.approx(0.27, abs=0.08)
    watch(tracker, to_the_wall_and_back, 1.0, start_s=4.7, grid=grid)
    assert not tracker.turning()


def test_what_has_stopped_in_the_open_is_not_expected_to_turn_back() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, to_the_wall_and_back, 4.5)
    assert not tracker.moving(4.5)
    assert not tracker.turning()


def test_what_has_moved_before_is_known_to_move_again_at_once() -> None:
    tracker = ObstacleTracker(TrackerParams())
    watch(tracker, to_the_wall_and_back, 6.0)
    assert not tracker.moving(6.0)
    watch(tracker, to_the_wall_and_back, 0.3, start_s=6.1)
    (track,) = tracker.moving(6.4)
    assert track.velocity_y_m_s < -0.1


def test_beside_a_wall_things_are_seen_where_the_pose_is_known_well() -> None:
    points = np.stack([np.full(8, 1.5), np.linspace(0.38, 0.41, 8)], axis=1)
    grid = corridor()
    for margin_m, seen in ((math.inf, 0), (0.08, 1)):
        tracker = ObstacleTracker(TrackerParams())
        for i in range(4):
            tracker.update(0.1 * i, points, grid.distance_m, grid.frame, margin_m)
        assert len(tracker.tracks(0.3)) == seen
