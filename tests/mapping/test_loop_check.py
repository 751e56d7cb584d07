import math
import time

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.mapping.loops.loop_check import MOST_CONTRADICTION, contradiction
from tests.mapping.synthetic import HOUSE_M, placed, scan

ROOM = [SE2(1.0, 2.3, 0.4), SE2(1.5, 1.8, 2.0), SE2(2.3, 2.3, -1.0), SE2(0.6, 0.6, 1.0)]
AGAIN = [SE2(1.8, 1.2, 1.5), SE2(2.0, 2.0, 0.5), SE2(1.2, 2.5, -2.0)]


def beams(
    poses: list[SE2], seed: int, walls: Array = HOUSE_M, std_m: float = 0.0, std_rad: float = 0.0
) -> Array:
    """(n, 4) beams' ends and their lidars' places, of keyframes that are somewhat off."""
    random = np.random.default_rng(seed)
    parts = []
    for pose in poses:
        x_m, y_m, turn_rad = (random.standard_normal(3) * (std_m, std_m, std_rad)).tolist()
        there = pose @ SE2(x_m, y_m, turn_rad)
        ends = placed(there, scan(pose, random, walls))
        parts.append(np.hstack([ends, np.tile(there[:2], (len(ends), 1))]))
    return np.concatenate(parts)


def test_a_place_seen_again_contradicts_nothing() -> None:
    for seed in range(5):
        old, new = beams(ROOM, seed, HOUSE_M, 0.03, 0.017), beams(AGAIN, 50 + seed)
        assert contradiction(old, new) < MOST_CONTRADICTION


def test_a_room_that_has_a_wall_more_contradicts() -> None:
    other = np.vstack([HOUSE_M, [1.6, 0.7, 2.6, 0.7]])
    old, new = beams(ROOM, 1), beams(AGAIN, 2, other)
    assert contradiction(old, new) > 2.0 * MOST_CONTRADICTION
    assert contradiction(new, old) == contradiction(old, new)


def test_a_room_laid_over_another_one_contradicts() -> None:
    there = [SE2(4.5, 1.5, 0.4), SE2(4.0, 2.3, 2.0), SE2(5.0, 0.8, -1.0)]
    new = beams(there, 3)
    new += np.array([-3.0, 0.0, -3.0, 0.0])
    assert contradiction(beams(ROOM, 1), new) > 2.0 * MOST_CONTRADICTION


def test_a_shift_by_less_than_a_hand_is_not_told() -> None:
    old, new = beams(ROOM, 1), beams(AGAIN, 2)
    new += np.array([0.08, -0.06, 0.08, -0.06])
    assert contradiction(old, new) < MOST_CONTRADICTION


def test_parts_with_nothing_in_common_do_not_contradict() -> None:
    assert contradiction(beams(ROOM, 1), beams(AGAIN, 2) + 100.0) == 0.0
    assert contradiction(beams(ROOM, 1), np.empty((0, 4))) == 0.0
    # From two sides of one wall.
    wall = np.array([[-5.0, 0.0, 5.0, 0.0]])
    above, below = (beams([SE2(0.0, side, 0.0)], 1, wall) for side in (1.0, -1.0))
    assert contradiction(above, below) == 0.0


def test_the_check_is_fast() -> None:
    poses = [SE2(1.5 + 0.01 * i, 1.5, 0.1 * i) for i in range(40)]
    old, new = beams(poses, 1), beams(AGAIN, 2)
    contradiction(old, new)
    start = time.process_time()
    assert math.isfinite(contradiction(old, new))
    assert time.process_time() - start < 0.05
