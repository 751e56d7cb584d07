from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.controller import Robot
from mazebot.navigation.control.controllers import make_controller
from tests.navigation.control.judge import drive
from tests.navigation.control.test_controllers import line, room
from tests.navigation.driving import Unicycle

SPEC = f"{ROOT / 'examples' / 'wall_follower.py'}:WallFollower"


def test_it_follows_the_wall_on_its_right_all_around_a_room() -> None:
    costmap, faces = room()
    follower = make_controller(SPEC, {}, Robot(), np.random.default_rng(0))
    robot = Unicycle(SE2(1.0, 0.5, 0.0))
    # The goal of the path is never reached: the middle of the room.
    told = drive(
        follower, costmap, robot, SE2(2.0, 2.0, 0.0), faces, path=line((1.0, 0.5), (2.0, 2.0)),
        limit_s=75.0,
    )  # fmt: skip
    places = np.array([pose[:2] for pose in told.poses])
    assert min(told.clearances_m) > 0.1
    assert told.length_m > 9.0
    for corner in ((3.4, 0.6), (3.4, 3.4), (0.6, 3.4)):
        assert np.linalg.norm(places - np.array(corner), axis=1).min() < 0.3
    # The wall is 0.45 m away, but in the corners.
    assert np.median(told.clearances_m) == pytest.approx(0.45 - 0.153, abs=0.06)


def test_it_ends_where_it_comes_by_the_goal() -> None:
    costmap, faces = room()
    follower = make_controller(SPEC, {}, Robot(), np.random.default_rng(0))
    told = drive(
        follower, costmap, Unicycle(SE2(1.0, 0.5, 0.0)), SE2(2.0, 0.45, 0.0), faces,
        path=line((1.0, 0.5), (2.0, 0.45)), limit_s=20.0,
    )  # fmt: skip
    assert told.reached


def test_its_parameters_are_checked() -> None:
    with pytest.raises(ConfigError, match=r"distance: must be greater than 0\.25"):
        make_controller(SPEC, {"distance": 0.1}, Robot(), np.random.default_rng(0))
