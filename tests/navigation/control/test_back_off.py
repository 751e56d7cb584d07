"""A robot that cannot go on stops, says where something is, and drives back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.safety.back_off import BackOff, BackOffParams
from mazebot.navigation.costmap.footprint import WAFFLE

PARAMS = BackOffParams(distance=0.2, speed=0.1, assumed_width=1.0)
PERIOD_NS = 50_000_000


def never(_: Velocity) -> float:
    return math.inf


AHEAD = Velocity(0.3, 0.0)


def made(wanted: Velocity = AHEAD) -> BackOff:
    back_off = BackOff(PARAMS, WAFFLE)
    assert back_off.begin(0, wanted)
    return back_off


def test_a_turn_is_not_backed_off_from() -> None:
    back_off = BackOff(PARAMS, WAFFLE)
    assert not back_off.begin(0, Velocity(0.0, 1.0))
    assert not back_off.is_active


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_it_stops_first_and_then_drives_the_other_way(sign: float) -> None:
    back_off, start = made(Velocity(sign * 0.3, 0.1)), SE2(1.0, 2.0, 0.0)
    pose, touched = start, []
    measured = Velocity(sign * 0.3, 0.0)
    assert back_off.step(0, pose, measured, never) == (STOP, None)
    assert back_off.step(PERIOD_NS, pose, STOP, never) == (STOP, None)
    for period in range(2, 100):
        command, touched_at = back_off.step(period * PERIOD_NS, pose, STOP, never)
        if touched_at is not None:
            touched.append(touched_at)
            assert abs(pose.x_m - start.x_m) == pytest.approx(0.03, abs=0.006)
        if not back_off.is_active:
            break
        assert command == Velocity(-sign * 0.1, 0.0)
        pose = pose @ SE2(command.linear_m_s * 0.05, 0.0, 0.0)
    # Where it stood, not where it is by then.
    assert touched == [start]
    assert pose.x_m - start.x_m == pytest.approx(-sign * 0.2, abs=0.006)


def test_it_ends_where_something_is_behind() -> None:
    back_off = made()
    here = SE2(0.0, 0.0, 0.0)
    back_off.step(0, here, STOP, never)
    assert back_off.step(PERIOD_NS, here, STOP, lambda _: 0.2) == (STOP, here)
    assert not back_off.is_active
    assert back_off.touched_m(lambda _: True)[0, 0] > 0.05


def test_a_robot_that_does_not_come_back_has_touched_nothing() -> None:
    back_off = made()
    for period in range(200):
        _, touched_at = back_off.step(period * PERIOD_NS, SE2(0.0, 0.0, 0.0), STOP, never)
        assert touched_at is None
    assert not back_off.is_active


def test_what_it_touches_is_taken_for_as_wide_as_it_may_be_up_to_what_is_seen() -> None:
    back_off = made()
    wide = back_off.touched_m(lambda _: False)
    assert wide[:, 0] == pytest.approx(0.0985)
    assert wide[:, 1].min() == pytest.approx(-0.5)
    assert wide[:, 1].max() == pytest.approx(0.5)
    beside = back_off.touched_m(lambda place: bool(place[1] > 0.3))
    assert beside[:, 1].max() == pytest.approx(0.3)
    # What it touches is at least as wide as the robot.
    narrow = back_off.touched_m(lambda _: True)
    assert np.abs(narrow[:, 1]).max() >= 0.14


def test_after_a_slip_what_is_behind_may_have_stopped_it() -> None:
    back_off, here = BackOff(PARAMS, WAFFLE), SE2(0.0, 0.0, 0.0)
    assert back_off.begin(0, AHEAD, slips=True)
    back_off.step(0, here, STOP, never)
    assert back_off.step(PERIOD_NS, here, STOP, lambda _: 0.2) == (STOP, None)
    assert not back_off.is_active
