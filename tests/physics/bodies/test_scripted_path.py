"""The way of a body that follows a path: where it is, how fast, and whether it has room."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.messages.documents import ScriptedPath
from mazebot.physics.bodies.scripted_path import TURN_RADIUS_M, Floorplan, PathPose, Route, meets

HALF_TURN_M = math.pi * TURN_RADIUS_M


def route(*waypoints_m: tuple[float, float], loop: bool = False) -> Route:
    return Route((1.0, 2.0), ScriptedPath(waypoints_m=waypoints_m, speed_m_s=0.5, loop=loop))


def test_it_goes_there_turns_and_comes_back() -> None:
    there = route((4.0, 2.0))
    assert there.length_m == pytest.approx(6.0 + 2.0 * HALF_TURN_M)
    assert there.at(0.0) == PathPose(1.0, 2.0, 0.0)
    assert there.at(2.5) == pytest.approx((3.5, 2.0, 0.0))
    assert there.at(3.0 + HALF_TURN_M / 2.0)[:2] == pytest.approx((4.0, 2.0))
    assert abs(there.at(3.0 + HALF_TURN_M / 2.0).heading_rad) == pytest.approx(math.pi / 2.0)
    back = there.at(3.0 + HALF_TURN_M + 1.0)
    assert back[:2] == pytest.approx((3.0, 2.0))
    assert math.cos(back.heading_rad) == pytest.approx(-1.0)
    assert there.at(5.0 * there.length_m + 2.5) == pytest.approx((3.5, 2.0, 0.0))


def test_a_loop_closes_and_another_path_goes_the_same_way_back() -> None:
    places = (3.0, 2.0), (3.0, 4.0)
    round_m = 4.0 + math.hypot(2.0, 2.0) + 2.0 * math.pi * TURN_RADIUS_M
    assert route(*places, loop=True).length_m == pytest.approx(round_m)
    there_and_back_m = 8.0 + (math.pi / 2.0 * 2.0 + math.pi * 2.0) * TURN_RADIUS_M
    assert route(*places).length_m == pytest.approx(there_and_back_m)
    # A loop that names its start again goes there once.
    assert route(*places, (1.0, 2.0), loop=True).length_m == pytest.approx(round_m)
    assert route((3.0, 2.0), loop=True).length_m == route((3.0, 2.0)).length_m


@pytest.mark.parametrize("loop", [False, True])
def test_its_pose_never_jumps_and_its_velocity_is_that_of_its_poses(loop: bool) -> None:
    random = np.random.default_rng(5)
    places = [(float(x), float(y)) for x, y in random.uniform(-3.0, 3.0, (12, 2))]
    bent = route(*places, loop=loop)
    step_m, speed_m_s = 4e-3, 0.5
    ways = np.arange(0.0, 1.1 * bent.length_m, step_m)
    poses = np.array([bent.at(float(way)) for way in ways])
    moves = np.diff(poses, axis=0)
    turns = (moves[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    assert np.hypot(moves[:, 0], moves[:, 1]).max() < step_m * 1.001
    assert np.abs(turns).max() < step_m / TURN_RADIUS_M * 1.001
    inside = 0
    for way, move, turn in zip(ways[::9], moves[::9], turns[::9], strict=False):
        velocity = bent.velocity(float(way), speed_m_s)
        if velocity == bent.velocity(float(way) + step_m, speed_m_s):
            inside += 1
            expected = np.array([*move[:2], turn]) / step_m * speed_m_s
            assert velocity == pytest.approx(expected.tolist(), abs=1e-6)
    assert inside > 100


@pytest.mark.parametrize("places", [[(1.0, 2.0)], [(1.0, 2.0), (1.0, 2.0 + 1e-9)]])
def test_a_path_that_leads_nowhere_is_refused(places: list[tuple[float, float]]) -> None:
    with pytest.raises(ValueError, match="waypoints_m: must contain a waypoint"):
        route(*places)


def test_boxes_meet_where_they_share_floor() -> None:
    plan = Floorplan(-0.5, -0.1, 0.0, 0.5, 0.1, 1.0)
    random = np.random.default_rng(6)
    met = 0
    for x, y, heading in random.uniform(-1.2, 1.2, (300, 3)):
        a, b = PathPose(0.1, -0.1, 0.4), PathPose(float(x), float(y), float(heading))
        inside = random.uniform((-0.5, -0.1), (0.5, 0.1), (2000, 2))
        c, s = math.cos(b.heading_rad - 0.4), math.sin(b.heading_rad - 0.4)
        dx, dy = b.x_m - 0.1, b.y_m + 0.1
        ox = math.cos(0.4) * dx + math.sin(0.4) * dy + c * inside[:, 0] - s * inside[:, 1]
        oy = -math.sin(0.4) * dx + math.cos(0.4) * dy + s * inside[:, 0] + c * inside[:, 1]
        sampled = bool(((np.abs(ox) < 0.5) & (np.abs(oy) < 0.1)).any())
        met += sampled
        assert meets(a, plan, b, plan) or not sampled
        assert meets(a, plan, b, plan) == meets(b, plan, a, plan)
    assert 50 < met < 250
    aside = PathPose(0.0, 0.21, 0.0)
    assert not meets(PathPose(0.0, 0.0, 0.0), plan, aside, plan)
