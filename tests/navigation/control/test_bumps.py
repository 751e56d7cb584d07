"""What bumps into the robot, or stands before it, is nothing hidden."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import Array
from mazebot.navigation.control.safety.bumps import Bumps
from mazebot.navigation.costmap.footprint import WAFFLE

FRONT_M = float(WAFFLE.points_m[:, 0].max())
SIDE_M = WAFFLE.half_width_m
NOTHING: Array = np.empty((0, 5))
SECOND_NS = 1_000_000_000


def post(x_m: float, y_m: float) -> Array:
    """(5, 2) echoes of a thin post."""
    return np.array([[x_m, y_m + 0.01 * i] for i in range(-2, 3)])


def moving(x_m: float, y_m: float) -> Array:
    return np.array([[x_m, y_m, 0.1, 0.2, 0.0]])


@pytest.mark.parametrize(
    ("x_m", "y_m", "sign", "seen"),
    [
        (FRONT_M + 0.03, 0.0, 1.0, True),
        (FRONT_M + 0.03, 0.0, -1.0, False),
        # Far ahead behind glass, or beside the robot in a narrow door.
        (FRONT_M + 0.2, 0.0, 1.0, False),
        (0.0, SIDE_M + 0.04, 1.0, False),
        (FRONT_M, SIDE_M + 0.04, 1.0, False),
    ],
)
def test_what_stands_before_the_side_that_touches_is_seen(
    x_m: float, y_m: float, sign: float, seen: bool
) -> None:
    bumps = Bumps(WAFFLE)
    bumps.take(0, post(x_m, y_m), NOTHING)
    assert bumps.explain(0, sign) == seen


def test_what_came_from_the_side_and_is_gone_again_was_seen_for_a_while() -> None:
    bumps = Bumps(WAFFLE)
    bumps.take(0, post(0.0, SIDE_M + 0.2), moving(0.0, SIDE_M + 0.3))
    assert not bumps.explain(0, 1.0)
    bumps.take(SECOND_NS, post(0.0, SIDE_M + 0.02), moving(0.0, SIDE_M + 0.12))
    bumps.take(2 * SECOND_NS, post(0.0, 2.0), moving(0.0, 2.1))
    assert bumps.explain(2 * SECOND_NS, 1.0)
    bumps.take(4 * SECOND_NS, post(0.0, 2.0), NOTHING)
    assert not bumps.explain(4 * SECOND_NS, 1.0)
