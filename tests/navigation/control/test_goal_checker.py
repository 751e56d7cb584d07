from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.goal_checker import GoalChecker, GoalCheckerParams
from mazebot.navigation.control.path_handler import PathHandler, PathHandlerParams
from mazebot.navigation.planning.path import path_through

GOAL = SE2(1.0, 0.0, 0.0)
SLOW, FAST = Velocity(0.005, 0.02), Velocity(0.05, 0.0)


def checker(**params: object) -> GoalChecker:
    return GoalChecker(GoalCheckerParams.model_validate(params))


def test_success_needs_position_heading_and_standstill() -> None:
    goal = checker()
    near, turned, far = SE2(0.97, 0.0, 0.0), SE2(0.97, 0.0, 0.2), SE2(0.9, 0.0, 0.0)
    assert not goal.check_position(far, GOAL, 0.1)
    assert not goal.is_goal_reached(far, GOAL, STOP)
    assert goal.check_position(near, GOAL, 0.03)
    assert not goal.is_goal_reached(turned, GOAL, STOP)
    assert not goal.is_goal_reached(near, GOAL, FAST)
    assert goal.is_goal_reached(near, GOAL, SLOW)


def test_a_goal_that_the_path_passes_before_its_end_is_not_reached() -> None:
    assert not checker().check_position(GOAL, GOAL, 3.0)
    assert checker(path_length_tolerance=5.0).check_position(GOAL, GOAL, 3.0)


def test_a_position_once_reached_stays_reached_within_the_buffer() -> None:
    stateful, stateless = checker(), checker(stateful=False)
    out = SE2(0.91, 0.0, 0.0)
    for goal in (stateful, stateless):
        assert goal.check_position(GOAL, GOAL, 0.0)
    assert stateful.check_position(out, GOAL, 0.1)
    assert not stateless.check_position(out, GOAL, 0.1)
    assert not stateful.check_position(SE2(0.8, 0.0, 0.0), GOAL, 0.2)
    stateful.check_position(GOAL, GOAL, 0.0)
    stateful.reset()
    assert not stateful.xy_reached


def test_the_opposite_heading_counts_where_that_is_asked_for() -> None:
    back = SE2(1.0, 0.0, math.pi - 0.01)
    assert abs(checker().yaw_error_rad(back, GOAL)) > 3.0
    assert checker(symmetric_yaw_tolerance=True).yaw_error_rad(back, GOAL) == pytest.approx(0.01)


def bent_path() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array([(0.1 * i, 0.0) for i in range(11)] + [(1.0, 0.1 * i) for i in range(1, 21)])


def test_the_local_path_begins_at_the_foot_of_the_robot_and_is_cut() -> None:
    path = path_through(bent_path(), 0.0)
    handler = PathHandler(PathHandlerParams(prune_distance=1.5))
    handler.set_path(path)
    pose = SE2(0.53, 0.2, 0.0)
    assert handler.advance(path, pose) == pytest.approx(2.5, abs=0.06)
    local = handler.local(path, pose, 0.05)
    assert local.points_m[0] == pytest.approx((0.53, 0.0))
    assert local.points_m[-1] == pytest.approx((1.0, 1.03))
    assert local.remaining_m == pytest.approx(2.47)
    assert not local.ends
    steps = np.linalg.norm(np.diff(local.points_m, axis=0), axis=1)
    assert steps.max() <= local.spacing_m + 1e-9


def test_the_robot_is_looked_for_ahead_only_and_not_across_a_loop() -> None:
    path = path_through(bent_path(), 0.0)
    handler = PathHandler(PathHandlerParams(max_robot_pose_search_dist=0.5))
    handler.set_path(path)
    handler.advance(path, SE2(0.4, 0.0, 0.0))
    assert handler.index == 4
    # The far leg comes nearer to this place, but is more than half a metre of path away.
    handler.advance(path, SE2(0.99, 1.5, 0.0))
    assert handler.index == 9
    handler.advance(path, SE2(0.2, 0.0, 0.0))
    assert handler.index == 9


def in_and_out(half_gap_m: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """2 m ahead, and back beside the way that it came."""
    ahead = [(0.1 * i, -half_gap_m) for i in range(21)]
    return np.array([*ahead, *((x, half_gap_m) for x, _ in reversed(ahead[:-1]))])


def test_a_path_that_turns_back_is_followed_to_there_first() -> None:
    path = path_through(in_and_out(0.0), 0.0)
    handler = PathHandler(PathHandlerParams(max_robot_pose_search_dist=5.0))
    handler.set_path(path)
    for x_m in (0.5, 1.4, 1.75):
        pose = SE2(x_m, 0.02, 0.0)
        assert handler.advance(path, pose) == pytest.approx(4.0 - x_m, abs=0.06)
        local = handler.local(path, pose, 0.05)
        assert local.points_m[0] == pytest.approx((x_m, 0.0))
        assert local.points_m[-1] == pytest.approx((2.0, 0.0))
        assert local.ends
        assert local.remaining_m == pytest.approx(2.0 - x_m)
        assert local.goal == pytest.approx((2.0, 0.0, 0.0))
        assert handler.turns_back()
    # From here on the way back is what is ahead.
    assert handler.advance(path, SE2(1.85, 0.0, 0.0)) == pytest.approx(1.9, abs=0.11)
    local = handler.local(path, SE2(1.85, 0.0, 0.0), 0.05)
    assert local.points_m[-1, 0] < 0.4
    assert local.goal == path.goal
    assert not handler.turns_back()
    assert handler.end_m(path) == path.length_m


@pytest.mark.parametrize(
    ("points_m", "turns_back"),
    [
        (in_and_out(0.0), True),
        (in_and_out(0.02), True),
        (in_and_out(0.3), False),
        (bent_path(), False),
        (bent_path()[:2], False),
    ],
)
def test_a_bend_is_no_turning_back(points_m: Array, turns_back: bool) -> None:
    path = path_through(points_m, 0.0)
    handler = PathHandler(PathHandlerParams())
    handler.set_path(path)
    assert handler.end_m(path) == pytest.approx(2.0 if turns_back else path.length_m, abs=0.06)


@pytest.mark.parametrize(
    ("angle_rad", "left_m"), [(0.0, 1.88), (math.pi / 2, 1.41), (math.pi * 1.2, None)]
)
def test_the_local_path_ends_where_a_round_comes_back(
    angle_rad: float, left_m: float | None
) -> None:
    """Half a round is left of it, or what leads straight enough to its end."""
    angles = np.linspace(0.0, math.tau, 61)
    path = path_through(0.3 * np.stack([np.sin(angles), -np.cos(angles)], axis=1), 0.0)
    handler = PathHandler(PathHandlerParams(max_robot_pose_search_dist=0.3))
    handler.set_path(path)
    handler.index = round(angle_rad / math.tau * 60)
    pose = SE2(0.3 * math.sin(angle_rad), -0.3 * math.cos(angle_rad), angle_rad)
    local = handler.local(path, pose, 0.05)
    assert local.leads_away == local.ends == (left_m is None)
    if left_m is None:
        assert local.points_m[-1] == pytest.approx((0.0, -0.3))
    else:
        assert local.remaining_m == pytest.approx(left_m, abs=0.02)
        assert local.points_m[-1] == pytest.approx((-pose.x_m, -pose.y_m), abs=0.06)


def test_the_end_of_the_path_is_a_path_still() -> None:
    path = path_through(bent_path(), 0.0)
    handler = PathHandler(PathHandlerParams(max_robot_pose_search_dist=5.0))
    handler.set_path(path)
    handler.advance(path, SE2(1.0, 2.1, 0.0))
    local = handler.local(path, SE2(1.0, 2.1, 0.0), 0.05)
    assert local.ends
    assert local.remaining_m == 0.0
    assert len(local.points_m) >= 2
