"""Velocity commands of the navigation node: with sensors gone, by a person, at a stop."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    CMD_VEL,
    CMD_VEL_TELEOP,
    GLOBAL_COSTMAP,
    SIMULATION_STATS,
)
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.control.safety.collision_monitor import CollisionMonitorParams
from mazebot.navigation.node import NavigationNode
from tests.navigation.driving import (
    LOCATIONS,
    NodeDriver,
    box_segments,
    cancelled,
    ready,
    stats,
    wall_distance_m,
)

STOPS_PER_TIMEOUT = round(CollisionMonitorParams().stop_pub_timeout * 1e9 / CONTROL_PERIOD_NS)


def test_a_robot_that_obeys_neither_way_has_met_nothing(caplog: pytest.LogCaptureFixture) -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.deaf = True
    driver.run(8.0)
    assert "remembered as an obstacle" not in caplog.text


def test_a_robot_whose_watchdog_stopped_it_has_met_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    driver = ready()

    def tell(stops: int) -> None:
        told = stats(epoch=1, sim_time_s=driver.now_ns * 1e-9)
        driver.deliver(SIMULATION_STATS, told.model_copy(update={"watchdog_stops": stops}))

    tell(0)
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.deaf = True
    tell(1)
    # It hears them again when one that was taken for stuck would drive back.
    driver.run(5.0)
    driver.deaf = False
    driver.run(1.0)
    assert "commands do not reach it in time" in caplog.text
    for _ in range(1200):
        driver.step()
        if driver.results():
            break
    assert [result.error_code for result in driver.results()] == [0]
    assert "remembered as an obstacle" not in caplog.text


def test_a_doorway_closed_on_the_way_ends_in_a_stop_and_a_code() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(2.5)
    driver.extra_segments = box_segments(1.33, -0.87, 0.85)
    driver.run(30.0)
    (result,) = driver.results()
    assert result.error_code == ErrorCode.NO_VALID_PATH
    assert result.number_of_recoveries > 0
    # It was closed 2.5 s after the start.
    assert result.end_time_s - result.start_time_s < 22.5
    from_box = np.maximum(np.abs(driver.log.points_m() - [1.33, -0.87]) - 0.425, 0.0)
    assert np.linalg.norm(from_box, axis=1).min() > 0.2
    assert wall_distance_m(driver.log.points_m()).min() > 0.23
    assert len(driver.of(GLOBAL_COSTMAP)) > 1


def test_without_scans_the_robot_stands_until_they_come_back() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    driver.blind = True
    driver.run(1.5)
    assert driver.robot.velocity.linear_m_s == 0.0
    assert driver.results() == []
    driver.blind = False
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


def test_a_stop_is_repeated_for_a_while_only_so_that_another_source_may_drive() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    driver.blind = True
    driver.run(2.5)
    told = driver.of(CMD_VEL)
    driver.run(2.0)
    assert driver.of(CMD_VEL) == told
    zeros = [one for one in told if one.twist.linear.x == one.twist.angular.z == 0.0]
    assert STOPS_PER_TIMEOUT - 2 <= len(zeros) <= STOPS_PER_TIMEOUT + 2
    driver.blind = False
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


@pytest.mark.parametrize("topic", ["/localization/status", "/odom", "/scan"])
def test_the_robot_stands_at_once_where_the_source_of_a_topic_is_gone(
    topic: str, caplog: pytest.LogCaptureFixture
) -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    assert driver.robot.velocity.linear_m_s > 0.2
    source = driver.node._measured.sources[topic]
    # What is still on the way arrives.
    driver.inbox.leave(source)
    driver.step()
    assert driver._command == STOP
    driver.run(0.5)
    assert driver.robot.velocity == STOP
    assert f"publisher of {topic} is gone" in caplog.text
    driver.inbox.come_back(source)
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


def test_only_a_missed_control_period_makes_the_controller_try_fewer_trajectories() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    assert "trajectories tried" not in driver.node.facts()
    driver.now_ns += CONTROL_PERIOD_NS
    driver.step()
    assert driver.node.facts()["trajectories tried"] == "1400"


def test_the_node_is_made_from_its_defaults_and_waits() -> None:
    assert NavigationNode(NavigationConfig()).waiting_for() == "the world"


def commands_m_s(driver: NodeDriver) -> list[float]:
    return [message.twist.linear.x for message in driver.of(CMD_VEL)]


def test_a_persons_command_is_reached_and_ends_by_ramps_within_the_limits() -> None:
    driver = ready()
    header = msg.header(0, "base_footprint")
    wanted = msg.TwistStamped(header, msg.Twist(msg.Vector3(0.0, 0.0, 0.0),
                                                msg.Vector3(0.0, 0.0, 1.0)))  # fmt: skip
    for _ in range(12):
        driver.deliver(CMD_VEL_TELEOP, wanted)
        driver.step()
    told = [message.twist.angular.z for message in driver.of(CMD_VEL)]
    assert told[:3] == pytest.approx([0.1, 0.2, 0.3])
    assert told[-1] == 1.0
    # Nobody says any more that it should turn.
    driver.run(2.0)
    told = [message.twist.angular.z for message in driver.of(CMD_VEL)]
    assert np.abs(np.diff(told)).max() <= 0.1 + 1e-6
    assert told[-2] == pytest.approx(0.1)
    assert told[-1] == 0.0
    driver.run(0.5)
    assert len(driver.of(CMD_VEL)) == len(told)


def test_a_robot_that_may_not_see_stops_without_a_ramp() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.5)
    # The collision monitor would stop it too.
    assert driver.node._drive is not None
    driver.node._drive.robot.toggle_collision_monitor(False)
    driver.blind = True
    driver.run(1.0)
    told = commands_m_s(driver)
    assert max(told) > 0.2
    assert told[-1] == 0.0
    assert max(abs(a - b) for a, b in itertools.pairwise(told)) > 0.1


def test_after_a_stop_between_two_periods_nothing_moves_any_more() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.5)
    assert commands_m_s(driver)[-1] > 0.1
    assert cancelled(driver).error == ""
    sent = len(driver.of(CMD_VEL))
    driver.run(1.0)
    assert set(commands_m_s(driver)[sent - 1 :]) == {0.0}
