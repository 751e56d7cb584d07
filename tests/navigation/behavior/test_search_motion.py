"""How a robot moves that does not know where it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
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


CORRIDOR = np.array(
    [
        *((x, y) for x in np.arange(-2.0, 0.5, 0.02) for y in (-0.275, 0.275)),
        *((0.2, y) for y in np.arange(-0.27, 0.27, 0.02)),
    ]
)
"""0.55 m wide, shut ahead."""


def seen_from(pose: SE2) -> Array:
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return np.ascontiguousarray((CORRIDOR - pose[:2]) @ np.array([[c, -s], [s, c]]))


def touches(pose: SE2) -> bool:
    x, y = seen_from(pose).T
    return bool(((x > -0.205) & (x < 0.077) & (np.abs(y) < 0.155)).any())


@pytest.mark.parametrize("askew_rad", [-0.35, -0.2, 0.1, 0.3])
@pytest.mark.parametrize("aside_m", [-0.02, 0.03])
def test_out_of_a_dead_end_that_is_too_narrow_to_turn_it_backs(
    askew_rad: float, aside_m: float
) -> None:
    pose = SE2(0.0, aside_m, askew_rad)
    assert not touches(pose)
    params = SearchMotionParams(circumscribed_radius_m=0.257)
    search = SearchMotion(params, look_around=False)

    def moved(velocity: Velocity, seconds: float) -> SE2:
        turned = SE2(0.0, 0.0, velocity.angular_rad_s * seconds / 2.0)
        return pose @ turned @ SE2(velocity.linear_m_s * seconds, 0.0, 0.0) @ turned

    def time_to_collision(velocity: Velocity) -> float:
        for step in range(1, 41):
            if touches(moved(velocity, 0.05 * step)):
                return 0.05 * step
        return math.inf

    for _ in range(1200):
        velocity = search.step(pose, seen_from(pose), time_to_collision)
        pose = moved(velocity, 0.05)
        assert not touches(pose)
        if pose.x_m < -1.0:
            return
    pytest.fail(f"still at {pose}")
