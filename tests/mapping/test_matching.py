import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.mapping.matching.correlative import correlate
from mazebot.mapping.matching.local_map import LocalMap, compacted, local_map
from mazebot.mapping.matching.refine import refine
from mazebot.mapping.matching.scan_points import moved_cloud, scan_points, surface_cloud, thinned
from tests.mapping.simulated import LDS, box, error, scan, wall

ROOM = np.concatenate([box(0.0, 0.0, 4.0, 3.0), wall(2.0, 0.0, 2.0, 1.2)])
HERE = SE2(1.0, 1.6, 0.3)
LOOSE = np.diag([1.0, 1.0, 1.0])


def returns(walls: Array, pose: SE2, seed: int = 1) -> Array:
    ranges = scan(walls, pose, LDS, np.random.default_rng(seed))
    return scan_points(
        Scan(
            ranges,
            LDS.angle_min_rad,
            LDS.increment_rad,
            LDS.range_min_m,
            LDS.range_max_m,
            LDS.base_from_scan,
        ),
        20.0,
    ).points_m


def room(walls: Array = ROOM) -> LocalMap:
    poses = [HERE, SE2(1.4, 2.0, 1.0), SE2(2.6, 1.9, -2.0)]
    clouds = [
        surface_cloud(returns(walls, pose, seed), LDS.base_from_scan)
        for seed, pose in enumerate(poses)
    ]
    return local_map(poses, clouds, 0.05)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.1, -0.08, 0.1), (-0.12, 0.1, -0.15)])
def test_refining_finds_the_pose_from_near_it(off: tuple[float, float, float]) -> None:
    true = SE2(1.2, 1.7, 0.5)
    start = SE2(true.x_m + off[0], true.y_m + off[1], true.yaw_rad + off[2])
    found = refine(room(), start, LOOSE, returns(ROOM, true, 9), LDS.base_from_scan, 0.02)
    far_m, turned_rad = error(found.map_from_base, true)
    assert far_m < 0.006
    assert turned_rad < math.radians(0.3)
    assert found.fit > 0.9
    assert not found.open_direction
    assert np.linalg.eigvalsh(found.information).min() > 1e4


def test_parts_of_a_scan_that_pull_apart_tell_that_it_is_less_sure() -> None:
    true = SE2(1.2, 1.7, 0.5)
    points = returns(ROOM, true, 9)
    away_m = np.hypot(points[:, 0], points[:, 1])
    # Twenty neighbours at a time are 3 cm too near or too far, as by a turn's time.
    signs = np.where(np.arange(len(points)) // 20 % 2, 1.0, -1.0)
    torn = points * (1.0 + 0.03 * signs / away_m)[:, None]
    clean, other = (
        refine(room(), true, LOOSE, one, LDS.base_from_scan, 0.02) for one in (points, torn)
    )
    assert clean.discord < 0.25
    assert other.discord > 4.0 * clean.discord


def test_refining_is_not_drawn_by_what_is_not_in_the_map() -> None:
    true = SE2(1.2, 1.7, 0.5)
    with_box = np.concatenate([ROOM, box(1.5, 2.2, 1.8, 2.5), box(0.3, 0.8, 0.6, 1.1)])
    found = refine(room(), true, LOOSE, returns(with_box, true, 9), LDS.base_from_scan, 0.02)
    assert error(found.map_from_base, true)[0] < 0.01
    assert found.fit < 0.95


def test_a_wall_is_not_matched_to_its_other_face() -> None:
    # Only the face at y = 0.1 is known; the lidar sees the one at y = -0.1.
    thick = wall(0.0, 0.0, 4.0, 0.0, 0.2)
    above, below = SE2(2.0, 1.0, 0.0), SE2(2.0, -0.9, 0.0)
    cloud = surface_cloud(returns(thick, above), LDS.base_from_scan)
    known = local_map([above], [cloud], 0.05)
    found = refine(known, below, LOOSE, returns(thick, below), LDS.base_from_scan, 0.02)
    assert found.fit < 0.05


def test_what_other_places_saw_of_a_wall_is_not_matched_to_its_other_face() -> None:
    thick = wall(0.0, 0.0, 4.0, 0.0, 0.2)
    above, below = SE2(2.0, 1.0, 0.0), SE2(2.0, -0.9, 0.0)
    known = local_map([above], [surface_cloud(returns(thick, above), LDS.base_from_scan)], 0.05)
    # The robot has gone round the end of the wall, and keeps what it saw from below.
    here = SE2(-1.0, 0.3, 0.0)
    cloud = moved_cloud(
        surface_cloud(returns(thick, below), LDS.base_from_scan), here.inverse() @ below
    )
    points, views = cloud[:, :2], cloud[:, 2:4]
    near = SE2(here.x_m, here.y_m + 0.2, here.yaw_rad)
    found = refine(known, near, LOOSE, points, LDS.base_from_scan, 0.02, views=views)
    assert found.fit < 0.05


def test_a_bare_corridor_is_open_along_it() -> None:
    corridor = np.array([[-20.0, 0.0, 20.0, 0.0], [-20.0, 1.5, 20.0, 1.5]])
    here, start = SE2(0.0, 0.75, 0.0), SE2(0.1, 0.8, 0.05)
    cloud = surface_cloud(returns(corridor, here), LDS.base_from_scan)
    known = local_map([here], [cloud], 0.05)
    found = refine(known, start, LOOSE, returns(corridor, here, 4), LDS.base_from_scan, 0.02)
    assert found.open_direction
    assert found.map_from_base.x_m == pytest.approx(0.1, abs=1e-3)
    assert found.map_from_base.y_m == pytest.approx(0.75, abs=5e-3)
    assert found.information[0, 0] < 1e-3 * found.information[1, 1]


def test_nothing_to_match_leaves_the_pose() -> None:
    empty = local_map([], [], 0.05)
    for known, points in ((empty, np.ones((5, 2))), (room(), np.zeros((0, 2)))):
        found = refine(known, HERE, LOOSE, points, LDS.base_from_scan, 0.02)
        assert found.map_from_base == HERE
        assert not found.information.any()
        assert correlate(known, HERE, points, 0.2, 0.2, 0.02, 0.05).score == 0.0


def test_correlating_finds_the_best_of_all_poses_in_the_window() -> None:
    true = SE2(1.2, 1.7, 0.5)
    guess = SE2(true.x_m - 0.3, true.y_m + 0.25, true.yaw_rad + 0.3)
    points = thinned(returns(ROOM, true, 9), 0.05, 120)
    found = correlate(room(), guess, points, 0.5, 0.4, 0.02, 0.05)
    far_m, turned_rad = error(found.map_from_base, true)
    assert far_m < 0.05
    assert turned_rad < 0.03
    assert found.score > 0.8
    # No single pose of the raster has a higher score.
    for shift in np.array([[0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]]):
        pose = found.map_from_base
        beside = SE2(pose.x_m + shift[0], pose.y_m + shift[1], pose.yaw_rad)
        near = correlate(room(), beside, points, 0.01, 0.0, 0.02, 0.05)
        assert near.score <= found.score + 1e-9


def test_of_places_that_look_alike_correlating_finds_the_likelier_one() -> None:
    # Niches 0.6 m apart.
    niches = [wall(0.6 * i, 1.4, 0.6 * i, 1.5) for i in range(-8, 9)]
    corridor = np.concatenate([np.array([[-20.0, 0.0, 20.0, 0.0]]), *niches])
    here = SE2(0.0, 0.75, 0.0)
    poses = [SE2(0.6 * i, 0.75, 0.0) for i in range(-4, 5)]
    clouds = [surface_cloud(returns(corridor, pose), LDS.base_from_scan) for pose in poses]
    known = local_map(poses, clouds, 0.05)
    points = thinned(returns(corridor, here, 4), 0.05, 120)
    for beside_m in (0.25, -0.25):
        guess = SE2(0.6 + beside_m, 0.75, 0.0)
        sure = np.diag([0.2**-2, 0.2**-2, 0.1**-2])
        found = correlate(known, guess, points, 1.0, 0.2, 0.02, 0.05, sure, 0.2)
        assert found.map_from_base.x_m == pytest.approx(0.6, abs=0.06)


def test_the_covariance_of_correlating_is_long_along_a_corridor() -> None:
    corridor = np.array([[-20.0, 0.0, 20.0, 0.0], [-20.0, 1.5, 20.0, 1.5]])
    here = SE2(0.0, 0.75, 0.0)
    known = local_map([here], [surface_cloud(returns(corridor, here), LDS.base_from_scan)], 0.05)
    points = thinned(returns(corridor, here, 4), 0.05, 120)
    found = correlate(known, here, points, 0.5, 0.2, 0.02, 0.05)
    assert found.covariance[0, 0] > 10.0 * found.covariance[1, 1]


def test_lines_are_where_the_walls_are_however_far_the_returns() -> None:
    known = room()
    flat = known.surfels[known.surfels[:, 4] > 0.5]
    assert len(flat) > 100
    across = np.abs(flat[:, 2:4]).max(axis=1)
    assert np.mean(across > math.cos(math.radians(12.0))) > 0.9
    x, y = flat[:, 0], flat[:, 1]
    faces = [x, x - 4.0, y, y - 3.0, x - 1.925, x - 2.075, y - 1.2]
    off = np.abs(np.stack(faces)).min(axis=0)
    assert np.percentile(off, 95) < 0.02


def test_compacting_keeps_what_the_returns_say() -> None:
    cloud = surface_cloud(returns(ROOM, HERE), LDS.base_from_scan)
    many = np.concatenate([cloud, cloud, cloud])
    fewer = compacted(many, 0.025)
    assert len(fewer) <= len(cloud)
    assert fewer[:, 5].sum() == len(many)
    mean = (fewer[:, :2] * fewer[:, 5:]).sum(axis=0) / len(many)
    assert mean == pytest.approx(many[:, :2].mean(axis=0), abs=1e-9)


def test_what_is_new_before_the_walls_does_not_pull_a_scan_from_a_place_that_is_sure() -> None:
    true = SE2(1.2, 1.7, 0.5)
    seen = returns(ROOM, true, 9)
    direction_rad = true.yaw_rad + np.arctan2(seen[:, 1], seen[:, 0])
    away_m = np.hypot(seen[:, 0], seen[:, 1])
    nearer_m = np.where(np.cos(direction_rad) < -0.3, 0.2, 0.0)
    seen *= (1.0 - nearer_m / away_m)[:, None]

    def off_m(pull_m: float) -> float:
        found = refine(room(), true, LOOSE, seen, LDS.base_from_scan, 0.02, pull_m=pull_m)
        return found.map_from_base.distance_m(true)

    assert off_m(0.2) > 0.15
    assert off_m(0.1) < 0.01
