"""The highest speed that is asked for on Nav2's /speed_limit."""

from __future__ import annotations

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CMD_VEL, SIMULATION_STATS, SPEED_LIMIT
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.robot.controller_server import ControllerServerParams
from tests.navigation.driving import LOCATIONS, NodeDriver
from tests.navigation.test_resume import STATS, again, set_value

FAR = LOCATIONS["location3"]


def limit(driver: NodeDriver, speed_limit: float, *, percentage: bool = False) -> None:
    message = msg.SpeedLimit(msg.header(0, ""), percentage, speed_limit)
    driver.deliver(SPEED_LIMIT, wire.encode(SPEED_LIMIT, message))


def fastest_m_s(driver: NodeDriver) -> float:
    """The highest speed that is commanded, after a second for braking."""
    driver.run(1.0)
    before = len(driver.of(CMD_VEL))
    driver.run(2.0)
    return max(one.twist.linear.x for one in driver.of(CMD_VEL)[before:])


def on_the_way(controller: str = "mppi") -> NodeDriver:
    server = ControllerServerParams(controller=controller)
    driver = NodeDriver(NavigationConfig(controller_server=server))
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(0.5)
    driver.goal(FAR)
    driver.run(1.0)
    return driver


@pytest.mark.parametrize("controller", ["mppi", "regulated_pure_pursuit"])
def test_the_newest_limit_counts_until_there_is_none(controller: str) -> None:
    driver = on_the_way(controller)
    limit(driver, 0.08)
    assert 0.05 < fastest_m_s(driver) < 0.09
    # Of the speed that the robot may drive now.
    set_value(driver, "controller_server.max_linear_vel", 0.3)
    limit(driver, 50.0, percentage=True)
    assert 0.1 < fastest_m_s(driver) < 0.16
    limit(driver, 0.0, percentage=True)
    assert 0.16 < fastest_m_s(driver) < 0.31
    assert driver.results() == []


def test_a_limit_that_is_none_changes_nothing(caplog: pytest.LogCaptureFixture) -> None:
    driver = on_the_way()
    limit(driver, 0.1)
    driver.run(0.1)
    for wrong, percentage in ((-0.1, False), (101.0, True), (float("nan"), False)):
        limit(driver, wrong, percentage=percentage)
    assert 0.05 < fastest_m_s(driver) < 0.11
    assert driver.rejected(SPEED_LIMIT) == {"out of range": 2, "not finite": 1}
    said = [one.message for one in caplog.records if one.levelname == "ERROR"]
    assert "/speed_limit: speed_limit -0.1: must be 0 m/s or more" in said
    assert "/speed_limit: speed_limit 101: must be 0 to 100 percent" in said


def test_a_navigation_that_is_started_again_keeps_to_it() -> None:
    before = on_the_way()
    limit(before, 20.0, percentage=True)
    before.run(0.5)
    driver = again(before)
    assert 0.05 < fastest_m_s(driver) < 0.1
    # What is sent to the process after counts more than what was kept.
    third = again(driver)
    limit(third, 0.2)
    third.run(0.1)
    assert third.node._told.speed_limit == act.SpeedLimit(speed_limit=0.2)
