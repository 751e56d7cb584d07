"""When the controller server takes the robot for stuck."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import FollowRequest
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity
from mazebot.navigation.control.controller import ControllerParams, PathlessController, Robot
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.robot.view import View
from tests.navigation.behavior.simulated_robot import NO_ECHOES, PERIOD_S, SimulatedRobot
from tests.navigation.driving import LOCATIONS, START

WANTED = Velocity(0.2, 0.0)


class Ahead(PathlessController):
    """Drives straight ahead."""

    def command(self, around: Surroundings) -> Velocity:
        return WANTED


def fails(sent: Velocity, let_through: float, limit_s: float) -> tuple[NavigationError, float]:
    """A robot that stands: how, and after what time, driving fails."""
    robot = SimulatedRobot().inner
    server = robot.controller_server
    ahead = Ahead(ControllerParams(), Robot(), np.random.default_rng(0))
    server.controllers = {**server.controllers, "ahead": ahead}
    for i in range(round(limit_s / PERIOD_S)):
        now_ns = round(i * PERIOD_S * 1e9)
        robot.begin(View(now_ns, START, START, STOP, NO_ECHOES))
        if i == 0:
            path = robot.compute_path(None, [LOCATIONS["location1"]], "")
            robot.follow(FollowRequest(path, "ahead"))
        try:
            robot.control(now_ns)
        except NavigationError as error:
            return error, i * PERIOD_S
        server.take_sent(sent, let_through)
    raise AssertionError("it may stand for ever")


def test_a_robot_that_was_sent_what_it_should_do_and_stands_is_stuck() -> None:
    error, after_s = fails(WANTED, 1.0, 10.0)
    assert "odometry measured 0.00 m" in error.message
    assert after_s < 2.6


@pytest.mark.parametrize("sent", [STOP, Velocity(0.02, 0.0)])
def test_a_robot_that_something_holds_is_not_stuck_it_makes_no_progress(sent: Velocity) -> None:
    error, after_s = fails(sent, 1.0, 10.0)
    assert error.code is ErrorCode.FAILED_TO_MAKE_PROGRESS
    assert error.message.startswith("no progress for 2.5 s")
    assert after_s == pytest.approx(2.5, abs=0.1)


def test_a_robot_that_a_zone_slows_down_has_longer_and_is_stuck_if_it_stands() -> None:
    error, after_s = fails(Velocity(0.046, 0.0), 0.1, 30.0)
    assert "commanded 0.20 m" in error.message
    assert 4.0 < after_s < 6.0
