"""Scans of which no beam measured anything: they confirm no pose, and keep none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.localization.monte_carlo import Localization
from tests.localization.test_monte_carlo import START_COVARIANCE, STEP_NS, feed, localization
from tests.navigation import house_tour as sim

START = SE2(0.0, 0.0, 0.0)


def see(
    loc: Localization,
    stamp_ns: int,
    range_m: float,
    limits_m: tuple[float, float] = (0.12, 3.5),
    increment_rad: float = sim.ANGLE_INCREMENT_RAD,
) -> bool:
    """A scan whose ranges are all the same."""
    ranges_m = np.full(360, range_m, np.float32)
    return loc.scan(Scan(ranges_m, 0.0, increment_rad, *limits_m, sim.BASE_FROM_SCAN, stamp_ns))


@pytest.mark.parametrize(
    ("range_m", "limits_m"),
    [
        (math.nan, (0.12, 3.5)),
        (0.0, (0.12, 3.5)),
        (0.05, (0.12, 3.5)),
        (1.0, (0.12, 0.0)),
        (1.0, (0.12, math.nan)),
        (1.0, (math.nan, 3.5)),
        (math.inf, (math.nan, 3.5)),
    ],
)
def test_no_initial_pose_is_confirmed(range_m: float, limits_m: tuple[float, float]) -> None:
    loc = localization()
    loc.initialize(START, START_COVARIANCE)
    for i in range(30):
        loc.odometry(i * STEP_NS, SE2(0.02 * i, 0.0, 0.0))
        assert not see(loc, i * STEP_NS, range_m, limits_m)
    assert loc.state == "uninitialized"


def test_beams_of_an_increment_in_degrees_are_no_scan() -> None:
    for increment_rad, is_used in ((sim.ANGLE_INCREMENT_RAD, True), (1.0, False)):
        loc = localization()
        loc.initialize(START, START_COVARIANCE)
        loc.odometry(0, START)
        assert see(loc, 0, 1.0, increment_rad=increment_rad) == is_used


@pytest.mark.parametrize("range_m", [math.nan, 0.0])
def test_a_pose_that_nothing_has_narrowed_for_long_is_lost(range_m: float) -> None:
    loc = localization()
    loc.initialize(START, START_COVARIANCE)
    loc.odometry(0, START)
    feed(loc, 0, sim.scan_at(START))
    assert loc.state == "localized"
    way_m = 0.0
    while loc.state == "localized":
        way_m += 0.2
        stamp_ns = round(way_m / 0.2) * STEP_NS
        loc.odometry(stamp_ns, SE2(way_m, 0.0, 0.0))
        see(loc, stamp_ns, range_m)
        assert way_m < 500.0
    assert loc.state == "lost"
    assert "standard deviation is 3." in loc.reasons[0]
