from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from mazebot.navigation.costmap.footprint import WAFFLE, signed_distance_m
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate

NO_ECHOES: Array = np.empty((0, 2))


def house() -> Costmap:
    """7 x 4 m with a margin of 1 m; the face of a wall at x = 5.425 m."""
    cells = np.zeros((120, 160), np.int8)
    cells[20:100, 128:132] = 100
    frame = frame_of(0.05, SE2(-1.0, -1.0, 0.0), cells)
    lethal = cells == 100
    return inflate(
        frame,
        lethal,
        np.zeros_like(lethal),
        InflationParams(
            custom_inscribed_radius=0.153, inflation_radius=0.7, cost_scaling_factor=3.0
        ),
    )


HOUSE = house()
FACE_X_M = 5.425
IN_THE_OPEN = SE2(3.0, 2.6, 0.0)


def contact_s(
    pose: SE2, velocity: Velocity, echoes_m: Array = NO_ECHOES, horizon_s: float = 3.0
) -> float:
    return first_contact_s(Surroundings(pose, HOUSE, echoes_m), velocity, horizon_s)


def test_time_to_contact_with_a_wall_of_the_map() -> None:
    ahead = contact_s(SE2(4.6, 1.5, 0.0), Velocity(0.4, 0.0))
    assert ahead == pytest.approx((FACE_X_M - 4.6 - 0.0685) / 0.4, abs=0.02)
    back = contact_s(SE2(4.6, 1.5, math.pi), Velocity(-0.4, 0.0))
    assert back == pytest.approx((FACE_X_M - 4.6 - 0.1965) / 0.4, abs=0.02)
    assert contact_s(SE2(4.6, 1.5, math.pi / 2), Velocity(0.4, 0.0)) == math.inf


@pytest.mark.parametrize(
    "velocity", [Velocity(0.25, 0.5), Velocity(-0.3, 0.4), Velocity(0.0, 1.0), Velocity(0.1, -1.9)]
)
def test_the_first_echo_on_an_arc_is_found_when_the_outline_reaches_it(velocity: Velocity) -> None:
    random = np.random.default_rng(5)
    v, w = velocity
    for x, y in random.uniform(-0.8, 0.8, (60, 2)):
        if signed_distance_m(WAFFLE.points_m, x, y) < 0.02:
            continue
        first = math.inf
        for t in np.arange(0.0, 3.0, 0.002):
            px, py = v / w * math.sin(w * t), v / w * (1.0 - math.cos(w * t))
            c, s = math.cos(w * t), math.sin(w * t)
            ahead, aside = c * (x - px) + s * (y - py), c * (y - py) - s * (x - px)
            if signed_distance_m(WAFFLE.points_m, ahead, aside) <= 0.0:
                first = t
                break
        found = contact_s(IN_THE_OPEN, velocity, np.array([[x, y]]))
        if math.isinf(first):
            # An echo that a corner only grazes lies between two of the times tried.
            assert math.isinf(found) or _grazes(x, y, velocity, found)
        else:
            assert found == pytest.approx(first, abs=0.0021)


def _grazes(x: float, y: float, velocity: Velocity, t: float) -> bool:
    v, w = velocity
    px, py = v / w * math.sin(w * t), v / w * (1.0 - math.cos(w * t))
    c, s = math.cos(w * t), math.sin(w * t)
    ahead, aside = c * (x - px) + s * (y - py), c * (y - py) - s * (x - px)
    return abs(signed_distance_m(WAFFLE.points_m, ahead, aside)) < 1e-6


def test_a_turn_on_the_spot_is_a_motion() -> None:
    # Behind the corner that a turn to the left sweeps; the robot's side is free of it.
    beside = np.array([[-0.12, 0.19]])
    assert contact_s(IN_THE_OPEN, Velocity(0.0, -1.0), beside) < 0.6
    # Beyond the circle of its corners.
    beside = np.array([[-0.12, 0.21]])
    assert contact_s(IN_THE_OPEN, Velocity(0.0, -1.0), beside) == math.inf
    # Parallel to a wall 0.2 m from the axle, on the map.
    beside_wall = SE2(FACE_X_M - 0.2, 1.5, math.pi / 2)
    assert contact_s(beside_wall, Velocity(0.0, 1.0)) < 1.0
    assert contact_s(beside_wall, Velocity(0.3, 0.0)) == math.inf


def test_a_robot_that_touches_may_leave_but_come_no_nearer() -> None:
    echo = np.array([[0.06, 0.0]])
    assert contact_s(IN_THE_OPEN, Velocity(-0.2, 0.0), echo) == math.inf
    assert contact_s(IN_THE_OPEN, Velocity(0.2, 0.0), echo) < 0.2
    assert contact_s(IN_THE_OPEN, STOP, echo) == math.inf
    # On the map: its front 3 cm inside the wall.
    inside = SE2(FACE_X_M - 0.04, 1.5, 0.0)
    assert contact_s(inside, Velocity(-0.2, 0.0)) == math.inf
    assert contact_s(inside, Velocity(0.2, 0.0)) < 0.3


def test_what_was_left_is_an_obstacle_again() -> None:
    # Backwards away from one echo, and into another.
    echoes = np.array([[0.06, 0.0], [-0.4, 0.0]])
    away = contact_s(IN_THE_OPEN, Velocity(-0.2, 0.0), echoes)
    assert away == pytest.approx((0.4 - 0.1965) / 0.2, abs=0.01)


def test_an_echo_that_one_corner_left_is_met_by_the_next() -> None:
    # In the left rear corner; after most of a turn to the left the right one comes by.
    echo = np.array([[-0.19, 0.13]])
    assert contact_s(IN_THE_OPEN, Velocity(0.0, 1.0), echo, 3.0) == math.inf
    assert contact_s(IN_THE_OPEN, Velocity(0.0, 1.0), echo, 6.0) == pytest.approx(5.05, abs=0.1)


def test_leaving_the_map_is_a_contact() -> None:
    edge = SE2(HOUSE.frame.origin_x_m + 0.1, 0.0, math.pi)
    assert contact_s(edge, Velocity(0.4, 0.0)) < 0.35


def test_fewer_echoes_than_asked_for_are_noise() -> None:
    wall = np.array([[0.3, 0.0], [0.32, 0.01], [0.34, 0.02]])
    for least, ahead_m in ((1, 0.3), (2, 0.32), (3, 0.34)):
        around = Surroundings(IN_THE_OPEN, HOUSE, wall, min_echoes=least)
        found = first_contact_s(around, Velocity(0.4, 0.0), 3.0)
        assert found == pytest.approx((ahead_m - 0.0685) / 0.4)
    around = Surroundings(IN_THE_OPEN, HOUSE, wall, min_echoes=4)
    assert first_contact_s(around, Velocity(0.1, 0.0), 3.0) == math.inf
