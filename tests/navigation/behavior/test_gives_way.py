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
    """A controller that waits."""

    def command(self, around: Surroundings) -> Velocity:
        return STOP


def patience_s(moving: tuple[Track, ...], turning: tuple[Track, ...] = ()) -> float:
    """How long the robot may stand before that counts as a failure."""
    robot = SimulatedRobot().inner
    stands = Stands(ControllerParams(), Robot(), np.random.default_rng(0))
    server = robot.controller_server
    server.controllers = {**server.controllers, "stands": stands}
    for i in range(500):
        now_ns = round(i * PERIOD_S * 1e9)
        robot.begin(View(now_ns, START, START, STOP, NO_ECHOES, moving, turning=turning))
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
