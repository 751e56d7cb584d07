"""How a robot moves that does not know where it is."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.motions.search_motion import SearchMotion, SearchMotionParams
from mazebot.navigation.control.collision import Velocity


@pytest.mark.parametrize("free", [1.0, -1.0])
def test_where_neither_turn_is_free_the_robot_drives_off(free: float) -> None:
    def time_to_collision(velocity: Velocity) -> float:
        return 9.0 if velocity.angular_rad_s == 0.0 and velocity.linear_m_s * free >= 0.0 else 0.0

    search = SearchMotion(SearchMotionParams(), look_around=True)
    echoes_m = np.array([[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, -2.0]])
    for _ in range(20):
        velocity = search.step(SE2(0.0, 0.0, 0.0), echoes_m, time_to_collision)
    assert velocity.linear_m_s == pytest.approx(0.1 * free)
    assert velocity.angular_rad_s == 0.0


@pytest.mark.parametrize("ahead", [1.0, -1.0])
@pytest.mark.parametrize("left", [1.0, -1.0])
def test_where_only_an_arc_is_free_the_robot_drives_along_it(ahead: float, left: float) -> None:
    """Between two walls, or beside the legs of a table: each other way touches something."""

    def time_to_collision(velocity: Velocity) -> float:
        speed_m_s, rate_rad_s = velocity.linear_m_s * ahead, velocity.angular_rad_s * left
        stands = speed_m_s == 0.0 == rate_rad_s
        is_free = speed_m_s > 0.0 and 0.15 < speed_m_s / max(rate_rad_s, 1e-9) < 0.25
        return 9.0 if is_free or stands else 0.0

    search = SearchMotion(SearchMotionParams(), look_around=False)
    echoes_m = np.array([[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, -2.0]])
    driven_m = 0.0
    for _ in range(40):
        velocity = search.step(SE2(0.0, 0.0, 0.0), echoes_m, time_to_collision)
        assert time_to_collision(velocity) > 0.0
        driven_m += velocity.linear_m_s * ahead * 0.05
    assert driven_m > 0.05
