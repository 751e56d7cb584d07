"""A lidar that shows an earlier turn with a new stamp."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.robot.frozen_scans import FrozenScans

HERE = SE2(0.0, 0.0, 0.0)
SENSOR = SE2(-0.064, 0.0, 0.0)
ROOM, CORRIDOR = (-1.5, 2.0, -1.0, 1.2), (-50.0, 50.0, -0.6, 0.8)
CORRIDORS_END = (-50.0, 2.0, -0.6, 0.8)
"""Least and greatest x, least and greatest y."""


def seen(
    base: SE2,
    walls: tuple[float, float, float, float] = ROOM,
    *,
    beams: int = 360,
    view_rad: float = math.tau,
    resolution_m: float = 0.0,
) -> Scan:
    """What a sensor without noise sees in a rectangle, ahead within an angle of view."""
    x, y, yaw = base @ SENSOR
    step = view_rad / beams
    angles = yaw - view_rad / 2.0 + step * np.arange(beams)
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.maximum((walls[0] - x) / c, (walls[1] - x) / c)
        across = np.maximum((walls[2] - y) / s, (walls[3] - y) / s)
    ranges = np.minimum(along, across)
    if resolution_m:
        ranges = np.round(ranges / resolution_m) * resolution_m
    ranges[ranges >= 3.5] = np.inf
    return Scan(ranges.astype(np.float32), -view_rad / 2.0, step, 0.12, 3.5, SENSOR, 1)


def of(*ranges_m: float) -> Scan:
    return Scan(np.array(ranges_m, np.float32), 0.0, 0.1, 0.12, 3.5, SENSOR, 1)


def measuring() -> FrozenScans:
    """After a first turn."""
    frozen = FrozenScans()
    assert not frozen.is_frozen(of(0.5, 0.5), HERE)
    return frozen


@pytest.mark.parametrize("there", [SE2(0.1, 0.0, 0.0), SE2(0.0, -0.1, 0.0), SE2(0.0, 0.0, 0.2)])
@pytest.mark.parametrize(("beams", "view_rad"), [(360, math.tau), (87, 1.5)])
def test_the_same_echoes_from_two_places_are_frozen_until_others_come(
    there: SE2, beams: int, view_rad: float
) -> None:
    frozen = measuring()
    scan = seen(SE2(0.5, 0.2, 0.3), beams=beams, view_rad=view_rad)
    scan.ranges_m[3] = math.nan
    assert not frozen.is_frozen(scan, HERE)
    for number in range(1, 4):
        assert frozen.is_frozen(replace(scan, stamp_ns=number), there)
        assert frozen.frozen_ns == number
    # It stays so, wherever the robot is by then.
    assert frozen.is_frozen(scan, HERE)
    other = replace(scan, ranges_m=scan.ranges_m + np.float32(0.001))
    assert not frozen.is_frozen(other, there)
    assert frozen.frozen_ns is None
    assert not frozen.is_frozen(other, there)


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_a_corridors_end_shows_is_frozen_within_half_a_second_of_a_way(
    sign: float, clockwise: bool
) -> None:
    frozen, scan = measuring(), seen(HERE, CORRIDORS_END)
    if clockwise:
        last_rad = scan.angle_min_rad + scan.angle_increment_rad * 359
        scan = replace(
            scan, ranges_m=scan.ranges_m[::-1].copy(), angle_min_rad=last_rad,
            angle_increment_rad=-scan.angle_increment_rad,
        )  # fmt: skip
    assert not frozen.is_frozen(scan, HERE)
    assert frozen.is_frozen(scan, SE2(sign * 0.1, 0.0, 0.0))


@pytest.mark.parametrize("resolution_m", [0.0, 0.02, 0.05])
@pytest.mark.parametrize(("beams", "view_rad"), [(360, math.tau), (90, math.tau), (87, 1.5)])
def test_along_straight_walls_a_sensor_without_noise_may_show_the_same(
    beams: int, view_rad: float, resolution_m: float
) -> None:
    frozen, yaw_rad = measuring(), 0.2
    for step in range(150):
        # As odometry drifts.
        odom = SE2(0.04 * step, 0.0005 * step, yaw_rad + 0.0002 * step)
        scan = seen(
            SE2(0.0, 0.1, yaw_rad), CORRIDOR, beams=beams, view_rad=view_rad,
            resolution_m=resolution_m,
        )  # fmt: skip
        assert not frozen.is_frozen(scan, odom), step


def test_a_robot_that_turns_in_a_round_room_sees_the_same() -> None:
    frozen = measuring()
    scan = replace(seen(HERE), base_from_scan=HERE, ranges_m=np.full(360, 1.0, np.float32))
    for step in range(30):
        assert not frozen.is_frozen(scan, SE2(0.0, 0.0, 0.1 * step))


@pytest.mark.parametrize(
    ("scan", "there"),
    [
        (seen(HERE), SE2(0.01, 0.0, 0.0)),
        (seen(HERE), SE2(0.0, 0.0, 0.03)),
        (of(*[math.inf] * 60), SE2(1.0, 0.0, 0.0)),
        (of(*[3.5, math.nan] * 30), SE2(1.0, 0.0, 0.0)),
        (replace(seen(HERE), angle_increment_rad=0.0), SE2(0.1, 0.0, 0.0)),
        (replace(seen(HERE), angle_min_rad=math.nan), SE2(0.1, 0.0, 0.0)),
    ],
)
def test_a_robot_that_stands_or_a_scan_that_tells_nothing_may_be_the_same(
    scan: Scan, there: SE2
) -> None:
    frozen = measuring()
    assert not frozen.is_frozen(scan, HERE)
    assert not frozen.is_frozen(scan, there)


def test_what_never_measured_has_not_frozen() -> None:
    frozen, scan = FrozenScans(), seen(HERE)
    for step in range(5):
        assert not frozen.is_frozen(scan, SE2(0.1 * step, 0.0, 0.0))
