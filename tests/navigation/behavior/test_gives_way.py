from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.context import FollowRequest
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity
from mazebot.navigation.control.controller import ControllerParams, PathlessController, Robot
from mazebot.navigation.control.safety.progress_checker import ProgressParams
from mazebot.navigation.control.track import Track
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.robot.view import View
from tests.navigation.behavior.simulated_robot import NO_ECHOES, PERIOD_S, SimulatedRobot
from tests.navigation.driving import LOCATIONS, START


class Stands(PathlessController):
    """A controller that waits; in one step of ten it may twitch."""

    twitch = STOP
    steps = 0

    def command(self, around: Surroundings) -> Velocity:
        self.steps += 1
        return STOP if self.steps % 10 else self.twitch


def patience_s(
    moving: tuple[Track, ...],
    turning: tuple[Track, ...] = (),
    unseen: int = 500,
    twitch: Velocity = STOP,
) -> float:
    """How long the robot may stand before that counts as a failure.

    Args:
        moving: obstacles that move.
        turning: obstacles that stand and are expected to turn back.
        unseen: in one step of so many, nothing that moves is seen.
        twitch: commanded in one step of ten.
    """
    robot = SimulatedRobot().inner
    stands = Stands(ControllerParams(), Robot(), np.random.default_rng(0))
    stands.twitch = twitch
    server = robot.controller_server
    server.controllers = {**server.controllers, "stands": stands}
    for i in range(500):
        now_ns = round(i * PERIOD_S * 1e9)
        seen = () if i % unseen == unseen - 1 else moving
        robot.begin(View(now_ns, START, START, STOP, NO_ECHOES, seen, turning=turning))
        if i == 0:
            path = robot.compute_path(None, [LOCATIONS["location1"]], "")
            robot.follow(FollowRequest(path, "stands"))
        try:
            robot.control(now_ns)
        except NavigationError:
            return i * PERIOD_S
    raise AssertionError("it may stand for ever")


def track(distance_m: float) -> Track:
    at = START @ SE2(distance_m, 0.0, 0.0)
    return Track(1, at.x_m, at.y_m, 0.0, 0.3, 0.15)


def test_a_robot_may_stand_longer_where_something_moves_near_it() -> None:
    allowed_s = ProgressParams().movement_time_allowance
    assert patience_s(()) == pytest.approx(allowed_s, abs=0.2)
    assert patience_s((track(3.0),)) == pytest.approx(allowed_s, abs=0.2)
    assert patience_s((track(0.7),)) == pytest.approx(15.0 + allowed_s, abs=0.2)
    assert patience_s((), (track(0.7),)) == pytest.approx(15.0 + allowed_s, abs=0.2)


def test_that_ends_as_well_where_it_is_not_seen_all_the_time_or_the_robot_twitches() -> None:
    most_s = 15.0 + ProgressParams().movement_time_allowance + 0.2
    assert 15.0 < patience_s((track(0.7),), unseen=20) <= most_s
    assert 15.0 < patience_s((track(0.7),), twitch=Velocity(0.15, 0.0)) <= most_s
