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
