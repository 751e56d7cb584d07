"""A robot that can do less than navigation's parameters ask for."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import pytest

from mazebot import Navigator
from mazebot.common.messages.documents import BodyEntity, Box, Shape
from mazebot.embedded.session import Session
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.robot_limits import DriveLimits, beyond, limits_of, within

CONFIG = NavigationConfig()
REMEMBERED = "remembered as an obstacle"


def test_a_slow_robot_is_not_stuck_and_one_line_says_which_settings_differ(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with Session("original", camera=False, max_linear_speed_m_s=0.05) as session:
        result = session.goal(0.4, -0.1, timeout_s=60.0)
    assert (result.error_code, result.number_of_recoveries) == (0, 0), result.error_msg
    assert REMEMBERED not in caplog.text
    (told,) = [line for line in caplog.messages if "max_linear_vel" in line]
    assert "controller_server.max_linear_vel is 0.46 m/s" in told
    assert "max_linear_speed_m_s of physics 0.05 m/s" in told


def test_a_slow_robot_that_something_stops_still_notices_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    low = Shape(name="low", geometry=Box(size_m=(0.1, 0.3, 0.05)), position_m=(0.0, 0.0, 0.025))
    with Session("original", camera=False, max_linear_speed_m_s=0.05) as session:
        session.spawn(BodyEntity(name="low", position_m=(0.3, 0.0, 0.0), shapes=(low,)))
        with contextlib.suppress(TimeoutError):
            session.goal(0.5, 0.0, timeout_s=20.0)
    places = [line for line in caplog.messages if REMEMBERED in line]
    assert places
    assert "at (0.2" in places[0]


def test_a_robot_that_can_do_what_is_asked_changes_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    limits = limits_of(
        {"max_linear_speed_m_s": 0.46, "max_angular_speed_rad_s": 5, "wheel_slip": 0.1}
    )
    assert limits == DriveLimits(0.46, 5.0)
    assert beyond(CONFIG, limits) == ""
    assert within(CONFIG, limits) == CONFIG


def test_every_part_keeps_to_the_robots_limits() -> None:
    smoother = CONFIG.velocity_smoother.model_copy(
        update={"max_accel": (2.5, 0.0, 3.2), "max_decel": (-2.5, 0.0, -3.2)}
    )
    config = CONFIG.model_copy(update={"velocity_smoother": smoother})
    driven = within(config, DriveLimits(0.2, 0.5, 0.1, 0.3))
    server, smoother = driven.controller_server, driven.velocity_smoother
    assert (server.max_linear_vel, server.max_angular_vel) == (0.2, 0.5)
    assert (server.max_linear_accel, server.max_angular_accel) == (0.1, 0.3)
    assert smoother.max_velocity == (0.2, 0.0, 0.5)
    assert smoother.min_velocity == (-0.2, 0.0, -0.5)
    assert smoother.max_accel == (0.1, 0.0, 0.3)
    assert smoother.max_decel == (-0.1, 0.0, -0.3)
    braking = driven.collision_monitor.braking
    assert (braking.linear_decel, braking.angular_decel) == (0.1, 0.3)


def test_the_controller_asks_for_no_more_than_the_velocity_smoother_lets_through() -> None:
    smoother = CONFIG.velocity_smoother.model_copy(update={"max_velocity": (0.05, 0.0, 0.0)})
    config = CONFIG.model_copy(update={"velocity_smoother": smoother})
    server = within(config, DriveLimits()).controller_server
    assert server.max_linear_vel == 0.05
    # With no turning at all there is nothing to plan by.
    assert server.max_angular_vel == CONFIG.controller_server.max_angular_vel


def gentle(
    accel: tuple[float, float, float] | None, decel: tuple[float, float, float] | None
) -> NavigationConfig:
    smoother = CONFIG.velocity_smoother.model_copy(
        update={"max_accel": accel, "max_decel": decel, "max_velocity": (0.3, 0.0, 0.8)}
    )
    return CONFIG.model_copy(update={"velocity_smoother": smoother})


@pytest.mark.parametrize(
    ("accel", "decel"),
    [((0.2, 0.0, 0.5), None), ((0.2, 0.0, 2.0), (-1.0, 0.0, -0.5)), (None, (-0.2, 0.0, -0.5))],
)
def test_every_part_counts_on_no_more_acceleration_than_the_velocity_smoother_lets_through(
    accel: tuple[float, float, float] | None, decel: tuple[float, float, float] | None
) -> None:
    driven = within(gentle(accel, decel), DriveLimits())
    server, behaviors, docking = (
        driven.controller_server, driven.behavior_server, driven.docking_server
    )  # fmt: skip
    assert (server.max_linear_accel, server.max_angular_accel) == (0.2, 0.5)
    assert (behaviors.acceleration_limit, behaviors.deceleration_limit) == (0.2, -0.2)
    assert (behaviors.rotational_acc_lim, behaviors.max_rotational_vel) == (0.5, 0.8)
    assert (docking.acceleration, docking.angular_acceleration) == (0.2, 0.5)
    # It brakes as the parameters say, and where one is missing as it does without the other.
    smoother = driven.velocity_smoother
    assert smoother.max_accel == (accel or (1.0, 0.0, 2.0))
    assert smoother.max_decel == (decel or (-0.2, 0.0, -0.5))


def test_behaviours_end_where_they_are_asked_to_behind_a_gentle_velocity_smoother(
    tmp_path: Path,
) -> None:
    settings = tmp_path / "gentle.yaml"
    settings.write_text(
        "navigation:\n  velocity_smoother:\n"
        "    max_accel: [0.3, 0.0, 0.3]\n    max_decel: [-0.3, 0.0, -0.3]\n"
    )
    with Session("original", camera=False, settings=settings) as session:
        navigator = Navigator.in_process(session)
        session.run_for(0.5)
        start = session.ground_truth()
        assert navigator.spin(1.57)
        while not navigator.isTaskComplete():
            pass
        session.run_for(1.0)
        turned = session.ground_truth()
        assert navigator.backup(0.3, 0.2)
        while not navigator.isTaskComplete():
            pass
        session.run_for(1.0)
        end = session.ground_truth()
    assert turned.yaw_rad - start.yaw_rad == pytest.approx(1.57, abs=0.06)
    assert math.dist((turned.x_m, turned.y_m), (end.x_m, end.y_m)) == pytest.approx(0.3, abs=0.03)


def test_a_zone_of_the_collision_monitor_that_slows_down_to_a_tenth_is_driven_through(
    tmp_path: Path,
) -> None:
    settings = tmp_path / "slow.yaml"
    settings.write_text(
        "navigation:\n  collision_monitor:\n    polygons:\n      Around: {type: circle, radius: 3, "
        "min_points: 1, action_type: slowdown, slowdown_ratio: 0.1}\n"
    )
    with Session("original", camera=False, settings=settings) as session:
        result = session.goal(0.3, 0.0, 0.8, timeout_s=90.0)
    assert (result.error_code, result.number_of_recoveries) == (0, 0), result.error_msg
