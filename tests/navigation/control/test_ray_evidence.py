from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.navigation.control.ray_evidence import Rays, edges_in_sight
from mazebot.navigation.control.tracking import ObstacleTracker, TrackerParams
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate
from tests.navigation.control.test_tracking import WALLS, post
from tests.navigation.house_tour import ANGLE_INCREMENT_RAD, RANGE_MIN_M, as_ranges, cast

SPEED_M_S = 0.4
CORNER_M = 0.4
"""Where a wall along x, 1 m north of the robot's way, ends."""
INNER = np.array(
    [(-3.87, 1.0, CORNER_M, 1.0), (CORNER_M, 1.0, CORNER_M, 1.1), (CORNER_M, 1.1, -3.87, 1.1)]
)


def hall_with_a_wall() -> Costmap:
    """Eight metres square about the origin, with the wall of `INNER`."""
    cells = np.zeros((160, 160), np.int8)
    cells[:3] = cells[-3:] = cells[:, :3] = cells[:, -3:] = 100
    cells[100:102, : round((CORNER_M + 4.0) / 0.05)] = 100
    frame = frame_of(0.05, SE2(-4.0, -4.0, 0.0), cells)
    return inflate(
        frame, cells >= 100, cells < 0,
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=10.0
        ),
    )  # fmt: skip


GRID = hall_with_a_wall()


def drive_past(
    tracker: ObstacleTracker,
    things: Callable[[float], Array],
    seconds: float = 5.0,
    by_rays: bool = True,
) -> list[int]:
    """Drive along the wall with ten scans a second; how many things move after each of them."""
    random = np.random.default_rng(1)
    counts = []
    for i in range(round(seconds * 10) + 1):
        t = i * 0.1
        pose = SE2(-1.0 + SPEED_M_S * t, 0.0, 0.0)
        segments = np.concatenate([WALLS, INNER, things(t)])
        ranges = as_ranges(cast(pose, segments), random)
        scan = Scan(ranges, 0.0, ANGLE_INCREMENT_RAD, RANGE_MIN_M, 3.5, SE2(0.0, 0.0, 0.0))
        keep = np.isfinite(ranges)
        points = np.array(pose[:2]) + ranges[keep, None] * scan.directions()[keep]
        rays = Rays(t, pose, scan) if by_rays else None
        tracker.update(t, points, GRID.distance_m, GRID.frame, rays=rays)
        counts.append(len(tracker.moving(t)))
    return counts


def board(_: float) -> Array:
    """A door that stands behind the corner."""
    return np.array([(-0.6, 2.0, 0.5, 2.0)])


def test_a_door_that_comes_in_sight_behind_a_corner_does_not_move() -> None:
    assert max(drive_past(ObstacleTracker(TrackerParams()), board, by_rays=False)) > 0
    tracker = ObstacleTracker(TrackerParams())
    assert max(drive_past(tracker, board)) == 0
    assert tracker.tracks(5.0)


@pytest.mark.parametrize("way", [(0.0, -0.4), (0.4, 0.0), (-0.4, 0.0), (0.0, 0.4)])
def test_a_post_that_moves_is_known_to_as_early_as_without_rays(way: tuple[float, float]) -> None:
    def crossing(t: float) -> Array:
        return post(1.5 + way[0] * t, -1.2 + way[1] * (t - 2.5), 0.12)

    first = [
        next(i for i, count in enumerate(drive_past(
            ObstacleTracker(TrackerParams()), crossing, 2.5, by_rays
        )) if count)
        for by_rays in (False, True)
    ]  # fmt: skip
    assert first[1] <= first[0] + 1


def test_a_post_that_comes_from_behind_the_corner_moves() -> None:
    def comes(t: float) -> Array:
        return post(0.1 + 0.3 * max(t - 1.0, 0.0), 1.5, 0.15)

    assert max(drive_past(ObstacleTracker(TrackerParams()), comes)) == 1


def test_an_edge_is_in_sight_where_what_is_beside_it_is_farther() -> None:
    angles = np.arange(-3, 4) * 0.02
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    labels = np.array([-1, -1, 0, 0, 0, -1, -1])
    for ranges, seen in (
        ([3.0, 3.0, 1.0, 1.0, 1.0, 3.0, 3.0], True),
        ([3.0, 3.0, 1.0, 1.0, 1.0, 0.5, 3.0], False),
        ([3.0, 1.0, 1.0, 1.0, 1.0, 3.0, 3.0], False),
    ):
        points = np.array(ranges)[:, None] * ways
        assert edges_in_sight(points, labels, 0, 0.0, 0.0) == seen
    # What is far beside it, with nothing between, hides nothing.
    turned = np.array([[0.5 * math.cos(1.0), 0.5 * math.sin(1.0)]])
    points = np.concatenate([ways[2:5], turned])
    assert edges_in_sight(points, np.array([0, 0, 0, -1]), 0, 0.0, 0.0)
