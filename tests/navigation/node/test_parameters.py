"""Parameters that are set while the robot drives: what they change, and that nothing else does."""

from __future__ import annotations

from typing import Any

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    CMD_VEL,
    CMD_VEL_TELEOP,
    NAVIGATION_STATUS,
    SET_PARAMETERS,
    SIMULATION_STATS,
    TOGGLE_COLLISION_MONITOR,
)
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import STOP
from tests.navigation.driving import LOCATIONS, NodeDriver, asked, ready, stats

ENABLED = "collision_monitor.enabled"
TOLERANCE = "controller_server.failure_tolerance"
CONTROLLERS = ("mppi", "regulated_pure_pursuit")


def config(**sections: dict[str, Any]) -> NavigationConfig:
    return NavigationConfig.model_validate(sections)


def put(driver: NodeDriver, name: str, value: Any) -> None:
    reply = asked(driver, SET_PARAMETERS, doc.SetParameters(values={name: value}))
    assert reply.error == ""


def speeds_m_s(driver: NodeDriver, seconds: float) -> list[float]:
    """The commands of some time."""
    driver.sent.clear()
    driver.run(seconds)
    return [message.twist.linear.x for message in driver.of(CMD_VEL)]


def cruising(controller: str) -> NodeDriver:
    """A robot that drives at its speed."""
    driver = ready(config=config(controller_server={"controller": controller}))
    driver.goal(LOCATIONS["location3"])
    driver.run(4.0)
    while driver.robot.velocity.linear_m_s < 0.4:
        driver.step()
        assert driver.now_ns < 20_000_000_000
    return driver


def is_checked(driver: NodeDriver) -> bool:
    """Whether the collision monitor holds a robot that sees nothing, and that a person drives."""
    driver.blind = True
    driver.run(1.0)
    twist = msg.Twist(linear=msg.Vector3(0.1, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    driver.sent.clear()
    for _ in range(10):
        header = msg.header(driver.now_ns, "base_footprint")
        driver.deliver(CMD_VEL_TELEOP, msg.TwistStamped(header=header, twist=twist))
        driver.step()
    driver.run(1.0)
    return not any(message.twist.linear.x for message in driver.of(CMD_VEL))


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collision_monitor_is_enabled_as_it_is_configured(enabled: bool) -> None:
    driver = ready(config=config(collision_monitor={"enabled": enabled}))
    assert is_checked(driver) == enabled
    put(driver, ENABLED, not enabled)
    assert is_checked(driver) != enabled


def test_a_toggled_collision_monitor_stays_so_until_it_is_set() -> None:
    driver = ready()
    driver.deliver(SIMULATION_STATS, stats(0))
    asked(driver, TOGGLE_COLLISION_MONITOR, act.Toggle(enable=False))
    assert not is_checked(driver)
    put(driver, "collision_monitor.source_timeout", 0.4)
    assert not is_checked(driver)
    driver.deliver(SIMULATION_STATS, stats(1))
    assert not is_checked(driver)
    # It is the value that the parameter has, and still what is asked for.
    put(driver, ENABLED, True)
    assert is_checked(driver)


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize(
    ("name", "value"),
    [
        (TOLERANCE, 0.31),
        ("controller_server.max_angular_accel", 1.9),
        ("controller_server.general_goal_checker.yaw_goal_tolerance", 0.05),
        ("controller_server.mppi.temperature", 0.31),
        ("controller_server.regulated_pure_pursuit.lookahead_time", 0.81),
        ("velocity_smoother.velocity_timeout", 1.1),
        ("collision_monitor.source_timeout", 0.6),
    ],
)
def test_a_robot_that_drives_goes_on_at_its_speed(controller: str, name: str, value: float) -> None:
    driver = cruising(controller)
    before_m_s = driver.robot.velocity.linear_m_s
    put(driver, name, value)
    assert min(speeds_m_s(driver, 0.3)) > before_m_s - 0.1


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_another_controller_goes_on_at_the_speed_of_the_one_before(controller: str) -> None:
    driver = cruising(controller)
    (other,) = {*CONTROLLERS} - {controller}
    put(driver, "controller_server.controller", other)
    for _ in range(60):
        driver.step()
        if driver.node.facts()["controller"] == other:
            break
    assert driver.node.facts()["controller"] == other
    assert driver.of(CMD_VEL)[-1].twist.linear.x > 0.3


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_parameter_that_is_set_again_and_again_holds_nothing_up(controller: str) -> None:
    names = {
        "mppi": "controller_server.mppi.temperature",
        "regulated_pure_pursuit": "controller_server.regulated_pure_pursuit.lookahead_time",
    }
    took_ns = []
    for sets in (False, True):
        driver = ready(config=config(controller_server={"controller": controller}))
        driver.goal(LOCATIONS["location1"])
        while not driver.results():
            driver.run(0.1)
            if sets:
                put(driver, names[controller], 0.3 + 0.5 * (driver.now_ns % 200_000_000 == 0))
            assert driver.now_ns < 60_000_000_000
        assert driver.results()[-1].error_code == 0
        took_ns.append(driver.now_ns)
    assert took_ns[1] < 1.3 * took_ns[0]


def test_a_robot_that_is_stuck_is_noticed_though_parameters_are_set() -> None:
    driver = cruising("mppi")
    driver.robot.stuck = True
    for step in range(60):
        driver.run(0.1)
        put(driver, TOLERANCE, 0.3 + 0.01 * (step % 2))
    assert driver.of(NAVIGATION_STATUS)[-1].number_of_recoveries > 0


def test_a_controller_of_ones_own_keeps_its_state() -> None:
    own = "examples/wall_follower.py:WallFollower"
    driver = ready(config=config(controller_server={"controller": own}))
    driver.goal(LOCATIONS["location1"])
    driver.run(1.0)
    assert driver.node._drive is not None
    server = driver.node._drive.robot.controller_server
    before = server.controller
    put(driver, TOLERANCE, 0.31)
    put(driver, "controller_server.mppi.temperature", 0.31)
    assert server.controller is before
    velocity = before.velocity
    put(driver, "controller_server.max_linear_vel", 0.2)
    assert server.controller is not before
    assert server.controller.velocity == velocity != STOP
