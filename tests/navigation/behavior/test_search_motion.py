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
