"""Wheels that turn while the robot stands are noticed by the scans, and odometry goes without."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.robot.wheel_slip import WheelSlip

BASE_FROM_SCAN = SE2(-0.064, 0.0, 0.0)
ROOM = (-2.0, 2.5, -1.5, 1.8)
CORRIDOR = (-50.0, 50.0, -0.6, 0.6)
PERIOD_S = 0.1

Walls = tuple[float, float, float, float]
"""Least and greatest x, least and greatest y."""


def scan_at(
    pose: SE2,
    time_s: float,
    walls: Walls,
    random: np.random.Generator,
    person_m: float,
    exact: bool,
) -> Scan:
    """What a lidar with 1 cm of noise, or of whole multiples of 2 cm, and a range of 3.5 m sees in
    a rectangle, with a person of 0.35 m so far ahead.
    """
    x, y, yaw = pose @ BASE_FROM_SCAN
    angles = yaw + np.radians(np.arange(360.0))
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.maximum((walls[0] - x) / c, (walls[1] - x) / c)
        across = np.maximum((walls[2] - y) / s, (walls[3] - y) / s)
    ranges = np.minimum(along, across)
    person = np.abs((np.arange(360.0) + 180.0) % 360.0 - 180.0) <= math.degrees(0.175 / person_m)
    ranges[person] = np.minimum(ranges[person], person_m)
    if exact:
        ranges = np.round(ranges / 0.02) * 0.02
    else:
        ranges += random.normal(0.0, 0.01, 360)
    ranges[ranges > 3.5] = np.inf
    return Scan(
        ranges.astype(np.float32), 0.0, math.radians(1.0), 0.12, 3.5, BASE_FROM_SCAN,
        round(time_s * 1e9),
    )  # fmt: skip


class Run:
    """A robot whose true motion and wheels are told apart."""

    def __init__(
        self, walls: Walls = ROOM, person_m: float = math.inf, *, exact: bool = False
    ) -> None:
        self.slip = WheelSlip()
        self.true = self.odom = self.corrected = SE2(0.0, 0.0, 0.3)
        self.time_s = 0.0
        self._walls, self._random = walls, np.random.default_rng(5)
        self._person_m, self._exact = person_m, exact
        self.odom = SE2(0.0, 0.0, 0.0)

    def drive(self, wheels: SE2, true: SE2, seconds: float) -> Iterator[bool]:
        """Move by `wheels` and by `true` each period; whether they slip, after each."""
        for _ in range(round(seconds / PERIOD_S)):
            self.time_s += PERIOD_S
            self.odom, self.true = self.odom @ wheels, self.true @ true
            stamp_ns = round(self.time_s * 1e9)
            self.corrected = self.slip.odometry(stamp_ns, self.odom)
            scan = scan_at(
                self.true, self.time_s, self._walls, self._random, self._person_m, self._exact
            )
            if self.slip.scan(scan):
                self.corrected = self.slip.corrected
            yield self.slip.slips


STEP = SE2(0.03, 0.0, 0.0)
STILL = SE2(0.0, 0.0, 0.0)


@pytest.mark.parametrize("step", [STEP, SE2(0.04, 0.0, 0.08), SE2(0.0, 0.0, 0.15), STILL])
def test_wheels_that_hold_change_nothing(step: SE2) -> None:
    run = Run()
    assert not any(run.drive(step, step, 3.0))
    assert run.corrected == run.odom
    assert run.slip.steady_from_odom is None


def test_a_tenth_of_slip_is_left_to_the_filter() -> None:
    run = Run()
    assert not any(run.drive(STEP, SE2(0.027, 0.0, 0.0), 3.0))


@pytest.mark.parametrize("wheels", [STEP, SE2(0.012, 0.0, 0.0), SE2(-0.03, 0.0, 0.0)])
def test_a_robot_that_pushes_is_noticed_within_a_second_and_stays(wheels: SE2) -> None:
    run = Run()
    list(run.drive(STEP, STEP, 1.0))
    before = run.corrected
    slips = list(run.drive(wheels, STILL, 4.0))
    assert any(slips[:10])
    assert all(slips[10:])
    assert run.corrected.distance_m(before) < 0.05


@pytest.mark.parametrize("forth", [1.0, -1.0])
def test_a_robot_that_pushes_slowly_is_noticed_too(forth: float) -> None:
    run, creep = Run(), SE2(0.0025 * forth, 0.0, 0.0)
    assert not any(run.drive(creep, creep, 10.0))
    before = run.corrected
    assert any(run.drive(creep, STILL, 4.0))
    assert run.corrected.distance_m(before) < 0.1


def test_a_robot_that_turns_about_what_it_pushes_is_followed() -> None:
    run = Run()
    list(run.drive(STEP, STEP, 1.0))
    before, true = run.corrected, run.true
    list(run.drive(STEP, SE2(0.0, 0.0, 0.02), 1.0))
    turned = before.inverse() @ run.corrected
    assert turned.yaw_rad == pytest.approx((true.inverse() @ run.true).yaw_rad, abs=0.1)
    assert math.hypot(turned.x_m, turned.y_m) < 0.08


@pytest.mark.parametrize("left_m", [0.012, -0.018])
def test_a_robot_that_slides_along_what_it_pushes_is_followed(left_m: float) -> None:
    run = Run()
    list(run.drive(STEP, STEP, 1.0))
    slides = SE2(0.0, left_m, 0.0)
    assert any(run.drive(STEP, slides, 0.6))
    before, true = run.corrected, run.true
    list(run.drive(STEP, slides, 1.5))
    slid, to = before.inverse() @ run.corrected, true.inverse() @ run.true
    assert slid.distance_m(to) < 0.05
    assert abs(slid.yaw_rad) < 0.1


def test_it_ends_when_the_robot_drives_back() -> None:
    run = Run()
    list(run.drive(STEP, STEP, 1.0))
    list(run.drive(STEP, STILL, 2.0))
    list(run.drive(STILL, STILL, 0.5))
    assert not run.slip.slips
    before, true = run.corrected, run.true
    back = SE2(-0.012, 0.0, 0.0)
    assert not any(run.drive(back, back, 2.0))
    assert (before.inverse() @ run.corrected).x_m == pytest.approx(
        (true.inverse() @ run.true).x_m, abs=0.01
    )


def test_it_ends_when_the_wheels_hold_again() -> None:
    run = Run()
    list(run.drive(STEP, STILL, 2.0))
    assert run.slip.slips
    held = list(run.drive(STEP, STEP, 1.5))
    assert not any(held[8:])


def test_along_a_corridor_the_scans_do_not_tell() -> None:
    run = Run(CORRIDOR)
    run.true = STILL
    assert not any(run.drive(STEP, STILL, 3.0))


def test_a_robot_that_is_carried_away_does_not_slip() -> None:
    run = Run()
    list(run.drive(STEP, STEP, 1.0))
    run.true = SE2(1.2, -0.8, 2.5)
    assert not any(run.drive(STEP, STEP, 2.0))


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("step_m", [0.01, 0.02, 0.03, 0.045])
@pytest.mark.parametrize("back_m", [0.03, 0.05, 0.07, 0.1])
def test_a_robot_that_is_pushed_back_once_does_not_slip(
    back_m: float, step_m: float, exact: bool
) -> None:
    run, step = Run(exact=exact), SE2(step_m, 0.0, 0.0)
    list(run.drive(step, step, 1.0))
    run.true = run.true @ SE2(-back_m, 0.0, 0.0)
    assert not any(run.drive(step, step, 3.0))
    assert run.slip.steady_from_odom is None


@pytest.mark.parametrize("yaw_rad", [0.0, 0.3])
def test_without_noise_a_corridor_looks_the_same_and_tells_no_slip(yaw_rad: float) -> None:
    run = Run(CORRIDOR, exact=True)
    run.true = SE2(0.0, 0.1, yaw_rad)
    along = SE2(0.0, 0.0, -yaw_rad) @ SE2(0.03, 0.0, 0.0) @ SE2(0.0, 0.0, yaw_rad)
    assert not any(run.drive(along, along, 4.0))


@pytest.mark.parametrize("wheels", [STEP, SE2(0.012, 0.0, 0.0)])
def test_without_noise_a_robot_that_pushes_is_noticed_as_soon(wheels: SE2) -> None:
    run = Run(exact=True)
    list(run.drive(STEP, STEP, 1.0))
    slips = list(run.drive(wheels, STILL, 2.0))
    assert any(slips[:10])
    assert all(slips[10:])


@pytest.mark.parametrize("ahead_m", [0.6, 1.0])
@pytest.mark.parametrize("wheels", [STEP, SE2(0.045, 0.0, 0.0)])
def test_of_a_corridor_its_end_tells(ahead_m: float, wheels: SE2) -> None:
    """Few beams tell, and what the wheels say until then must not become usual."""
    run = Run((-50.0, ahead_m, -0.6, 0.6))
    run.true = SE2(-0.5, 0.0, 0.0)
    steps = round(0.5 / wheels.x_m)
    assert not any(run.drive(wheels, wheels, steps * PERIOD_S))
    before = run.corrected
    slips = list(run.drive(wheels, STILL, 4.0))
    assert all(slips[20:])
    assert run.corrected.distance_m(before) < 0.4


@pytest.mark.parametrize("person_m", [0.8, 1.0, 2.0])
def test_a_person_who_walks_ahead_along_a_corridor_is_no_slip(person_m: float) -> None:
    run = Run(CORRIDOR, person_m)
    run.true = STILL
    step = SE2(0.045, 0.0, 0.0)
    assert not any(run.drive(step, step, 4.0))
    assert run.slip.steady_from_odom is None
