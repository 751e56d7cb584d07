"""Where there are no walls around the robot, it sees what there is, and ends with a reason."""

import logging

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells
from mazebot.explorer.config import ExplorerConfig
from tests.explorer.worlds import RESOLUTION_M, Stage, plan

YARD = np.zeros((320, 320), np.int8)
MIDDLE = SE2(8.0, 8.0, 0.0)
HOUSE = plan(
    "########..####",
    "#.....#......#",
    "#.....#......#",
    "#.....#......#",
    "#............#",
    "#............#",
    "#.....#......#",
    "##############",
)[::-1]
"""7 by 4 m: two rooms, and a door to the south."""


def with_box(side_m: float = 0.5, x_m: float = 9.5, y_m: float = 8.5) -> Cells:
    cells = YARD.copy()
    row, column, side = (round(one / RESOLUTION_M) for one in (y_m, x_m, side_m))
    cells[row : row + side, column : column + side] = 100
    return cells


def explored(truth: Cells, home: SE2 = MIDDLE, **config: float) -> Stage:
    stage = Stage(truth, home, ExplorerConfig.model_validate(config))
    stage.run(300, "complete", "failed")
    return stage


def test_on_open_floor_it_ends_near_what_it_has_seen() -> None:
    stage = explored(with_box(), open_distance=1.0)
    status = stage.status
    assert status.state == "complete"
    assert status.reason.startswith("the open floor goes on beyond open_distance: 1 m, ")
    assert (status.reachable, status.set_aside, status.left_out) == (0, 0, 1)
    assert status.seen_share == 1.0
    assert stage.robot.distance_m(MIDDLE) < 0.1
    assert (stage.known[with_box() > 0] > 0).sum() >= 36
    assert stage.driven_m < 15.0


@pytest.mark.slow
def test_where_nothing_is_seen_it_looks_for_something() -> None:
    stage = explored(YARD, open_distance=2.0)
    assert stage.status.state == "complete"
    assert "the open floor goes on beyond open_distance: 2 m" in stage.status.reason
    # As far as twice that from the start.
    known_m = np.argwhere(stage.known == 0) * RESOLUTION_M - MIDDLE[:2]
    assert 4.0 < np.linalg.norm(known_m, axis=1).max() < 9.0
    found = explored(with_box(1.0, 11.7, 8.0), open_distance=2.0)
    assert (found.known > 0).any()


def test_a_hall_whose_walls_are_far_from_one_another_is_seen_whole() -> None:
    hall = YARD[:220, :220].copy()
    hall[:4] = hall[-4:] = 100
    hall[:, :4] = hall[:, -4:] = 100
    stage = explored(hall, SE2(5.5, 1.5, 0.0), open_distance=0.5)
    assert stage.status.reason == "no reachable frontiers left"
    assert (stage.known[10:-10, 10:-10] == 0).mean() > 0.999


@pytest.mark.slow
def test_rooms_come_before_the_yard_around_them(caplog: pytest.LogCaptureFixture) -> None:
    yard = YARD.copy()
    yard[120:200, 90:230] = HOUSE
    rooms = np.zeros_like(yard, np.bool_)
    rooms[130:190, 100:220] = yard[130:190, 100:220] == 0
    stage = Stage(yard, SE2(9.0, 5.0, 1.57), ExplorerConfig(open_distance=1.0))
    with caplog.at_level(logging.INFO, "explorer"):
        while not stage.statuses or (stage.known[rooms] == 0).mean() < 0.999:
            assert stage.now_ns < 100e9
            stage.step()
        # What lies behind the house is yet to be seen.
        assert (stage.known[205:250, 90:230] < 0).all()
        stage.run(300, "complete", "failed")
    assert "open_distance" in stage.status.reason
    assert (stage.known[205:220, 90:230] == 0).all()
    told = [line for line in caplog.messages if " m driven; " in line]
    assert told
    assert all(" % seen, " in line and " to see" in line for line in told)


@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        ({"time_allowance": 5.0}, "stopped at time_allowance: 5 s, 1 frontier left"),
        ({"max_area": 50.0}, "stopped at max_area: 50 m2, 2 frontiers left"),
        ({"max_distance": 3.0}, "1 frontier beyond max_distance: 3 m"),
    ],
)
def test_it_ends_at_the_limits_that_are_set(limit: dict[str, float], reason: str) -> None:
    stage = explored(with_box(), MIDDLE, **limit)
    assert stage.status.state == "complete"
    assert stage.status.reason == reason
    assert stage.robot.distance_m(MIDDLE) < 0.1
    assert stage.status.goals < 15
