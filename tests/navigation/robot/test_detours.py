"""Ways that are given up, gaps that are too narrow."""

from __future__ import annotations

import logging
import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap
from mazebot.navigation.planning.path import PlannedPath, path_through, resample
from mazebot.navigation.robot.detours import Detours
from mazebot.navigation.robot.narrow_gaps import NarrowGaps
from mazebot.navigation.robot.view import View
from tests.navigation.costmap.test_layered_costmap import marked_post, room, see_nothing

GOAL = SE2(3.5, 3.5, 0.0)


def way(*points: tuple[float, float]) -> PlannedPath:
    """A path along corners."""
    return path_through(resample(np.array(points), 0.05), 0.0)


ROUND = way((1.0, 1.0), (1.0, 3.5), (3.5, 3.5))
BESIDE = way((1.0, 1.0), (3.0, 1.7), (3.5, 3.5))


def is_blocked(costmap: LayeredCostmap) -> bool:
    cell = costmap.frame.cell(3.0, 2.0)
    assert cell is not None
    return bool(costmap.master.costs[cell] == 254)


def test_what_stood_in_a_way_that_was_given_up_is_not_forgotten_on_the_detour() -> None:
    costmap = room()
    detours = Detours(costmap)
    detours.begin(GOAL)
    marked_post(costmap, 0.0, 3)
    detours.note(2.0, SE2(2.8, 2.0, 0.0), ROUND)
    assert detours.count == 1
    for at_s in range(1, 40):
        see_nothing(costmap, float(at_s))
    assert is_blocked(costmap)
    # Another goal: what is there is seen again.
    detours.begin(SE2(1.0, 1.0, 0.0))
    costmap.clear()
    assert not is_blocked(costmap)


def test_a_way_just_round_an_obstacle_is_no_detour() -> None:
    detours = Detours(room())
    detours.note(2.0, SE2(2.8, 2.0, 0.0), BESIDE)
    detours.note(ROUND.length_m - 0.2, SE2(2.8, 2.0, 0.0), ROUND)
    assert detours.count == 0
    assert not detours.forget()


def test_a_place_found_blocked_again_and_again_is_left_alone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    costmap = room()
    detours = Detours(costmap)
    with caplog.at_level(logging.WARNING):
        for number in range(3):
            assert not caplog.records
            marked_post(costmap, float(number), 3)
            detours.note(2.0, SE2(2.8, 2.0 + 0.1 * number, 0.0), ROUND)
    assert "(2.80, 2.00) was found blocked 3 times" in caplog.text
    see_nothing(costmap, 4.0, moving=True)
    costmap.clear()
    assert is_blocked(costmap)
    assert detours.forget()


def jambs(width_m: float, spacing_rad: float = math.tau / 360) -> Array:
    """(n, 2) echoes of a wall 0.6 m ahead of the robot with a gap straight ahead."""
    angles = np.arange(-60, 61) * spacing_rad
    across_m = 0.6 * np.tan(angles)
    keep = np.abs(across_m) >= width_m / 2.0
    return np.stack([np.full(keep.sum(), 0.6), across_m[keep]], axis=1)


def look_ten_times(
    gaps: NarrowGaps, echoes_m: Array, tracks: tuple[Track, ...] = (), first_s: float = 1.0
) -> None:
    pose = SE2(2.0, 2.0, 0.0)
    for i in range(10):
        now_ns = round((first_s + 0.1 * i) * 1e9)
        view = View(now_ns, pose, pose, STOP, echoes_m, tracks)
        gaps.look(view, way((2.0, 2.0), (3.7, 2.0)))


@pytest.mark.parametrize(("width_m", "closed"), [(0.2, True), (0.28, True), (0.4, False)])
def test_a_gap_too_narrow_for_the_robot_is_closed_before_it_gets_there(
    width_m: float, closed: bool
) -> None:
    costmap = room()
    costmap.close_gap((2.6, 2.3), (2.6, 2.5))
    gaps = NarrowGaps(costmap, WAFFLE.padded(0.01))
    look_ten_times(gaps, jambs(width_m))
    gap = gaps.closed_near((2.6, 2.0))
    assert (gap is not None) == closed
    cell = costmap.frame.cell(2.6, 2.0)
    assert cell is not None
    assert (costmap.master.costs[cell] == 254) == closed
    if gap is not None:
        assert gap.width_m == pytest.approx(width_m, abs=0.02)
        assert gap.middle_m == pytest.approx((2.6, 2.0), abs=0.03)
        # One side has gone.
        one_side = jambs(width_m)
        look_ten_times(gaps, one_side[one_side[:, 1] > 0.0], first_s=3.0)
        assert costmap.master.costs[cell] != 254


def test_a_gap_beside_something_that_moves_is_not_measured() -> None:
    costmap = room()
    costmap.close_gap((2.6, 2.3), (2.6, 2.5))
    gaps = NarrowGaps(costmap, WAFFLE.padded(0.01))
    look_ten_times(gaps, jambs(0.28), (Track(1, 2.6, 2.3, 0.2, 0.0, 0.1),))
    assert gaps.closed_near((2.6, 2.0)) is None
