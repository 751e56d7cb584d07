import math
import time

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.mapping.loops.loop_search import LoopMatch, loop_search, search_map
from tests.mapping.synthetic import HOUSE_M, placed, scan

OLD_M = [SE2(1.0, 2.3, 0.4), SE2(1.5, 1.8, 2.0), SE2(2.3, 2.3, -1.0), SE2(0.6, 0.6, 1.0)]
OFFICE_M = [SE2(6.8, 1.5, 0.4), SE2(7.2, 0.8, 2.0), SE2(6.4, 2.3, -1.0)]


def cloud(poses: list[SE2], seed: int, walls: Array = HOUSE_M) -> Array:
    """Returns of scans from these poses, in the map."""
    random = np.random.default_rng(seed)
    return np.concatenate([placed(pose, scan(pose, random, walls)) for pose in poses])


def thinned(points_m: Array, most: int = 500) -> Array:
    _, first = np.unique(np.floor(points_m / 0.05).astype(int), axis=0, return_index=True)
    kept = points_m[np.sort(first)]
    return kept[:: -(-len(kept) // most)]


def found(
    guess: SE2, window_m: float = 2.0, window_rad: float = math.radians(30.0)
) -> tuple[LoopMatch, SE2]:
    """What a search in the old part finds for a robot that is there again, and where it is."""
    truth = SE2(1.8, 1.2, 1.5)
    seen = placed(truth.inverse(), thinned(cloud([truth, truth @ SE2(0.3, 0.0, 0.5)], 9)))
    match = loop_search(
        search_map(thinned(cloud(OLD_M, 1), 5000)), seen, guess, window_m, window_rad
    )
    assert match is not None
    return match, truth


@pytest.mark.parametrize(
    ("x_m", "y_m", "turn_rad"), [(0.0, 0.0, 0.0), (1.9, -1.8, 0.5), (-1.7, 1.9, -0.5)]
)
def test_a_place_seen_again_is_found_from_two_metres_off(
    x_m: float, y_m: float, turn_rad: float
) -> None:
    match, truth = found(SE2(1.8 + x_m, 1.2 + y_m, 1.5 + turn_rad))
    assert match.pose.distance_m(truth) < 0.02
    assert abs(wrap_angle(match.pose.yaw_rad - truth.yaw_rad)) < 0.01
    assert match.score > 0.8
    assert match.elsewhere <= match.score - 0.1


def test_a_wide_window_finds_it_too() -> None:
    match, truth = found(SE2(5.2, 4.5, 2.2), 4.0, math.radians(45.0))
    assert match.pose.distance_m(truth) < 0.02


def test_outside_of_its_window_nothing_is_found() -> None:
    match, _ = found(SE2(1.8 + 1.0, 1.2, 1.5), 0.5)
    assert abs(match.pose.x_m - 2.8) <= 0.55
    assert match.score < 0.6


def test_another_room_scores_low() -> None:
    table = search_map(thinned(cloud(OLD_M, 1), 5000))
    there = OFFICE_M[0]
    seen = placed(there.inverse(), thinned(cloud(OFFICE_M, 9)))
    match = loop_search(table, seen, OLD_M[0], 2.0, math.radians(30.0))
    assert match is not None
    assert match.score < 0.6
    assert loop_search(table, seen, OLD_M[0], 2.0, math.radians(30.0), least_score=0.6) is None


def test_along_a_corridor_another_pose_is_as_good() -> None:
    walls = np.array([[-10.0, 0.0, 10.0, 0.0], [-10.0, 1.2, 10.0, 1.2]])
    here = SE2(0.0, 0.6, 0.2)
    old = thinned(cloud([SE2(x, 0.6, 0.0) for x in (-2.0, -1.0, 0.0, 1.0, 2.0)], 1, walls), 5000)
    seen = placed(here.inverse(), thinned(cloud([here], 2, walls)))
    match = loop_search(search_map(old), seen, here, 1.0, math.radians(20.0))
    assert match is not None
    assert abs(match.pose.y_m - 0.6) < 0.02
    assert match.elsewhere > match.score - 0.05
    assert match.covariance[0, 0] > 8.0 * match.covariance[1, 1]


def test_the_best_of_all_poses_of_the_raster_is_found() -> None:
    """Against all poses, one by one."""
    random = np.random.default_rng(4)
    old, seen = random.uniform(0.0, 2.0, (60, 2)), random.uniform(-1.0, 1.0, (25, 2))
    table = search_map(old)
    guess = SE2(1.0, 1.0, 0.3)
    match = loop_search(table, seen, guess, 0.6, 0.2)
    assert match is not None
    farthest_m = np.hypot(seen[:, 0], seen[:, 1]).max()
    step_rad = math.acos(1.0 - 0.05**2 / (2.0 * farthest_m**2))
    turns, half = math.ceil(0.2 / step_rad), 12
    sums = np.zeros((2 * turns + 1, 2 * half + 1, 2 * half + 1))
    for a in range(-turns, turns + 1):
        points = placed(SE2(1.0, 1.0, 0.3 + a * step_rad), seen) - (table.x_m, table.y_m)
        columns, rows = np.floor(points / 0.05).astype(int).T
        for c in range(-half, half + 1):
            for r in range(-half, half + 1):
                values = table.tables[0][rows + r, columns + c]
                sums[a + turns, c + half, r + half] = values.sum(dtype=int)
    assert match.score == pytest.approx(sums.max() / (255 * 25), abs=1e-9)
    best = np.array(np.unravel_index(sums.argmax(), sums.shape))
    limits = np.array([math.floor(math.radians(15.0) / step_rad), 10, 10])
    steps = np.moveaxis(np.indices(sums.shape), 0, -1)
    far = (np.abs(steps - best) > limits).any(axis=-1)
    assert match.elsewhere == pytest.approx(
        max(sums[far].max() / (255 * 25), match.score - 0.2), abs=1e-9
    )


def test_the_error_is_as_large_as_its_covariance_says() -> None:
    distances = []
    table = search_map(thinned(cloud(OLD_M, 1), 5000))
    random = np.random.default_rng(7)
    for i in range(15):
        truth = SE2(*random.uniform((0.8, 1.5, -3.0), (2.4, 2.8, 3.0)).tolist())
        seen = placed(truth.inverse(), thinned(cloud([truth], 100 + i)))
        match = loop_search(table, seen, truth @ SE2(0.5, -0.5, 0.2), 1.0, 0.4)
        assert match is not None
        error = np.array(match.pose) - truth
        error[2] = wrap_angle(error[2])
        distances.append(error @ np.linalg.solve(match.covariance, error))
    assert 0.1 < np.mean(distances) < 5.0


def test_a_search_is_fast() -> None:
    found(SE2(1.0, 2.0, 1.2))
    truth = SE2(1.8, 1.2, 1.5)
    seen = placed(truth.inverse(), thinned(cloud([truth], 9)))
    table = search_map(thinned(cloud(OLD_M, 1), 5000))
    start = time.process_time()
    for _ in range(5):
        loop_search(table, seen, SE2(1.0, 2.0, 1.2), 2.0, math.radians(30.0), 0.5)
    assert time.process_time() - start < 5 * 0.05


def test_the_same_search_gives_the_same_bits() -> None:
    one, _ = found(SE2(1.0, 2.0, 1.2))
    other, _ = found(SE2(1.0, 2.0, 1.2))
    assert one.pose == other.pose
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_without_points_there_is_nothing_to_find() -> None:
    with pytest.raises(ValueError, match="no points"):
        search_map(np.empty((0, 2)))
    table = search_map(np.zeros((1, 2)))
    assert loop_search(table, np.empty((0, 2)), SE2(0.0, 0.0, 0.0), 1.0, 1.0) is None
