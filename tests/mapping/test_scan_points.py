import math

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.mapping.matching.scan_points import ScanPoints, scan_points, surface_cloud, thinned

SENSOR = SE2(-0.064, 0.0, 0.0)


def points(ranges: list[float], max_range_m: float = 20.0) -> ScanPoints:
    increment = math.tau / len(ranges)
    return scan_points(
        Scan(np.array(ranges, np.float32), 0.0, increment, 0.12, 3.5, SENSOR), max_range_m
    )


def test_returns_are_where_beams_ended() -> None:
    found = points([1.0, 2.0, 3.0, 0.5])
    assert np.allclose(found.points_m, [[0.936, 0.0], [-0.064, 2.0], [-3.064, 0.0], [-0.064, -0.5]])
    assert len(found.misses_m) == 0


def test_ranges_that_say_nothing_are_left_out() -> None:
    found = points([math.nan, -math.inf, 0.05, 1.0])
    assert len(found.points_m) == 1
    assert len(found.misses_m) == 0


def test_a_range_of_0_is_no_return_though_the_least_range_is_0() -> None:
    scan = Scan(np.array([0.0, 1.0, 0.0, 2.0], np.float32), 0.0, math.pi / 2, 0.0, 100.0, SENSOR)
    found = scan_points(scan, 20.0)
    assert np.allclose(found.points_m, [[-0.064, 1.0], [-0.064, -2.0]])
    assert len(found.misses_m) == 0


def test_a_single_lost_beam_is_not_open_space_and_many_in_a_row_are() -> None:
    ranges = [1.0] * 360
    ranges[40] = math.inf
    assert len(points(ranges).misses_m) == 0
    # Across the first beam.
    for beam in (356, 357, 358, 359, 0, 1, 2):
        ranges[beam] = 3.5
    found = points(ranges)
    assert len(found.misses_m) == 7
    assert np.allclose(np.hypot(*(found.misses_m - [-0.064, 0.0]).T), 3.5, atol=2e-3)
    assert len(points([math.inf] * 360).misses_m) == 360


def test_beyond_the_longest_range_that_is_used_it_is_free_up_to_there() -> None:
    found = points([3.0] * 360, 2.0)
    assert len(found.points_m) == 0
    assert np.allclose(np.hypot(*(found.misses_m - [-0.064, 0.0]).T), 2.0, atol=2e-3)


def test_thinning_keeps_the_order_and_the_distances() -> None:
    line = np.stack([np.linspace(0.0, 1.0, 1001), np.zeros(1001)], axis=1)
    kept = thinned(line, 0.05, 500)
    steps = np.diff(kept[:, 0])
    assert steps.min() >= 0.05 - 1e-9
    assert steps.max() < 0.052
    assert len(thinned(line, 0.0, 100)) == 100


def test_surfaces_face_the_lidar_and_corners_have_none() -> None:
    x = np.arange(-1.0, 1.0, 0.05)
    corner = np.concatenate([np.stack([x, np.ones(40)], 1), np.stack([np.ones(40), -x], 1)])
    cloud = surface_cloud(corner, SE2(0.0, 0.0, 0.0))
    flat = cloud[:, 4] > 0.5
    assert flat[:36].all()
    assert np.allclose(cloud[:36, 2:4], [0.0, -1.0], atol=1e-6)
    assert np.allclose(cloud[45:, 2:4], [-1.0, 0.0], atol=1e-6)
    assert not flat[39:41].any()
