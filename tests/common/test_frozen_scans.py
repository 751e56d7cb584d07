"""A lidar that shows an earlier turn with a new stamp."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.common.robot.frozen_scans import FrozenScans

HERE = SE2(0.0, 0.0, 0.0)
SENSOR = SE2(-0.064, 0.0, 0.0)


def shown(*ranges_m: float) -> Scan:
    return Scan(np.array(ranges_m, np.float32), 0.0, 0.1, 0.12, 3.5, SENSOR)


@pytest.mark.parametrize("there", [SE2(0.1, 0.0, 0.0), SE2(0.0, 0.0, 0.2)])
def test_the_same_echoes_from_two_places_are_frozen_until_others_come(there: SE2) -> None:
    frozen = FrozenScans()
    assert not frozen.is_frozen(shown(1.0, 2.0, 3.0), HERE)
    assert not frozen.is_frozen(shown(1.0, 2.0, math.nan), HERE)
    assert frozen.is_frozen(shown(1.0, 2.0, math.nan), there)
    assert frozen.is_frozen(shown(1.0, 2.0, math.nan), there)
    assert not frozen.is_frozen(shown(1.0, 2.001, math.nan), there)
    assert not frozen.is_frozen(shown(1.0, 2.001, math.nan), there)


@pytest.mark.parametrize(
    ("ranges_m", "there"),
    [
        ((1.0, 2.0), SE2(0.01, 0.0, 0.0)),
        ((math.inf, math.inf), SE2(1.0, 0.0, 0.0)),
        ((3.5, math.nan), SE2(1.0, 0.0, 0.0)),
    ],
)
def test_a_robot_that_stands_or_a_lidar_that_sees_nothing_may_show_the_same(
    ranges_m: tuple[float, ...], there: SE2
) -> None:
    frozen = FrozenScans()
    assert not frozen.is_frozen(shown(0.5, 0.5), HERE)
    assert not frozen.is_frozen(shown(*ranges_m), HERE)
    assert not frozen.is_frozen(shown(*ranges_m), there)


def test_what_never_measured_has_not_frozen() -> None:
    frozen = FrozenScans()
    for step in range(5):
        assert not frozen.is_frozen(shown(1.0, 2.0), SE2(0.1 * step, 0.0, 0.0))
