"""What the robot may do, by what is still to be trusted."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    LocalizationStatus,
    NavigationStatus,
    Planar,
    SimulationStats,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    CMD_VEL,
    CMD_VEL_TELEOP,
    DEPTH_SCAN,
    LOCALIZATION_STATUS,
    NAVIGATION_CHECKPOINT,
    NAVIGATION_STATUS,
    SCAN,
    SEND_GOAL,
    SIMULATION_STATS,
    TF_STATIC,
)
from mazebot.common.robot.frozen_scans import FROZEN
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import STOP
from tests.common.samples import SAMPLES
from tests.navigation.driving import LOCATIONS, NodeDriver, scan
from tests.navigation.test_resume import again, on_the_way

STATS: SimulationStats = SAMPLES[SIMULATION_STATS]
GOAL = LOCATIONS["location1"]
PERIOD_NS = 200_000_000


def stopped(driver: NodeDriver, reason: str) -> None:
    now = {"sim_time_s": driver.now_ns * 1e-9, "emergency_stop": reason}
    driver.deliver(SIMULATION_STATS, STATS.model_copy(update=now))


def status(driver: NodeDriver) -> NavigationStatus:
    return driver.of(NAVIGATION_STATUS)[-1]


def causes(driver: NodeDriver) -> list[tuple[str, str]]:
    return [(one.level, one.cause) for one in status(driver).stop_causes]


def test_a_goal_for_a_held_robot_has_taken_no_time_and_is_as_far_as_nobody_knows() -> None:
    driver = NodeDriver()
    driver.learn()
    driver.run(1.0)
    stopped(driver, "Stop in the console")
    driver.run(1.0)
    driver.goal(LOCATIONS["location2"])
    driver.run(1.0)
    told = driver.of(ACTION_FEEDBACK)[-1]
    assert told.navigation_time_s == 0.0
    assert told.distance_remaining_m is told.estimated_time_remaining_s is None
    stopped(driver, "")
    driver.run(1.0)
    told = driver.of(ACTION_FEEDBACK)[-1]
    assert told.navigation_time_s == pytest.approx(1.0, abs=0.3)
    assert (told.distance_remaining_m or 0.0) > 0.3


def test_a_held_robot_stands_its_task_waits_and_goes_on_when_it_is_cleared() -> None:
    driver = on_the_way()
    assert (status(driver).stop_level, causes(driver)) == ("none", [])
    stopped(driver, "Stop in the console")
    driver.step()
    told = len(driver.of(CMD_VEL))
    assert driver.of(CMD_VEL)[-1].twist.linear.x == 0.0
    assert status(driver).stop_level == "hold"
    assert causes(driver) == [("hold", "emergency stop: Stop in the console")]
    # Longer than a controller may make no progress; nor does a person's command move it.
    twist = msg.Twist(msg.Vector3(0.3, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0))
    for _ in range(400):
        driver.deliver(CMD_VEL_TELEOP, msg.TwistStamped(msg.header(0, "base_footprint"), twist))
        driver.step()
    assert len(driver.of(CMD_VEL)) == told
    assert not driver.results()
    assert status(driver).goal is not None
    stopped(driver, "")
    driver.run(40.0)
    (result,) = driver.results()
    assert (result.error_code, result.number_of_recoveries) == (0, 0)
    assert driver.robot.map_from_base.distance_m(GOAL) < 0.1


def test_a_goal_of_a_held_robot_waits_and_can_be_canceled() -> None:
    driver = NodeDriver()
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(1.0)
    stopped(driver, "look")
    replies: list[act.SendGoalReply] = []
    goal = act.Spin(target_yaw_rad=1.0)
    driver.inbox.ask(SEND_GOAL, act.SendGoal(goal_id="a", goal=goal), replies.append)
    driver.run(30.0)
    assert replies[-1].accepted
    assert not driver.of(CMD_VEL)
    before = driver.robot.map_from_base
    stopped(driver, "")
    driver.run(3.0)
    turned_rad = driver.robot.map_from_base.yaw_rad - before.yaw_rad
    assert turned_rad == pytest.approx(1.0, abs=0.1)


def test_a_robot_that_searches_for_its_pose_is_held_too() -> None:
    driver = on_the_way()
    epoch = STATS.epoch
    lost = LocalizationStatus(state="lost", quality=0.1, wants_motion=True, epoch=epoch)
    stopped(driver, "look")
    driver.step()
    told = len(driver.of(CMD_VEL))
    for _ in range(60):
        driver.deliver(LOCALIZATION_STATUS, lost)
        driver.step()
    assert len(driver.of(CMD_VEL)) == told
    assert status(driver).stop_level == "hold"
    assert ("stop", "waiting for localization to converge") in causes(driver)


def test_what_is_missing_or_too_old_is_told_with_what_clears_it() -> None:
    driver = NodeDriver()
    driver.step()
    assert causes(driver) == [("stop", "waiting for the world")]
    driver = on_the_way()
    driver.blind = True
    driver.run(0.7)
    assert status(driver).stop_level == "stop"
    (cause,) = status(driver).stop_causes
    assert (cause.cause, cause.cleared_by) == ("/scan is older than 0.5 s", "a message on /scan")
    driver.blind = False
    driver.run(0.2)
    assert (status(driver).stop_level, causes(driver)) == ("none", [])


def test_a_lidar_that_shows_the_same_turn_again_stops_the_robot_until_it_shows_another() -> None:
    driver = NodeDriver()
    driver.learn()
    driver.run(1.0)
    driver.goal(GOAL)
    driver.run(3.0)
    begun = driver.robot.map_from_base
    driver.frozen = True
    driver.run(2.0)
    assert driver.robot.map_from_base.distance_m(begun) < 0.5
    assert driver.log.commands[-1] == STOP
    assert driver.rejected(SCAN)[FROZEN] > 5
    assert not driver.of(LOCALIZATION_STATUS)[-1].wheel_slip
    assert causes(driver) == [("stop", "/scan repeats an earlier turn")]
    driver.frozen = False
    driver.run(60.0)
    assert driver.results()[-1].error_code == 0
    assert driver.robot.map_from_base.distance_m(GOAL) < 0.25


def with_depth(config: NavigationConfig | None = None) -> NodeDriver:
    """A robot that has a depth camera, which sees nothing."""
    driver = NodeDriver(config)
    driver.learn()
    camera = msg.transform_stamped(0, "base_link", "camera_link", SE2(0.07, 0.0, 0.0).matrix(0.1))
    driver.deliver(TF_STATIC, msg.TFMessage(transforms=[camera]))
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(1.0)
    return driver


NOTHING: Array = np.full(60, np.inf)


def drives(driver: NodeDriver, seconds: float, *, seeing: bool, ranges_m: Array = NOTHING) -> float:
    """The highest speed on the way, with a depth camera that sees such ranges."""
    begin = len(driver.log.commands)
    for _ in range(round(seconds * 20)):
        if seeing and driver.now_ns % PERIOD_NS == 0:
            image = scan(driver.now_ns, ranges_m.astype(np.float32))
            image.header.frame_id = "camera_link"
            driver.deliver(DEPTH_SCAN, image)
        driver.step()
    return max(command.linear_m_s for command in driver.log.commands[begin:])


def test_without_the_depth_camera_that_was_there_the_robot_drives_slowly() -> None:
    driver = with_depth()
    driver.goal(LOCATIONS["location4"])
    assert drives(driver, 4.0, seeing=True) > 0.4
    assert status(driver).stop_level == "none"
    drives(driver, 2.0, seeing=False)
    assert causes(driver) == [("slowdown", "the depth camera is silent: low things are not seen")]
    assert 0.1 < drives(driver, 2.0, seeing=False) <= 0.23 + 1e-6
    drives(driver, 0.5, seeing=True)
    assert status(driver).stop_level == "none"


def test_a_depth_camera_that_repeats_a_picture_is_told_apart_from_a_silent_one() -> None:
    driver = with_depth()
    driver.goal(LOCATIONS["location4"])
    drives(driver, 1.0, seeing=True)
    drives(driver, 2.5, seeing=True, ranges_m=np.linspace(0.5, 2.0, 60))
    assert causes(driver) == [
        ("slowdown", "the depth camera repeats a picture: low things are not seen")
    ]
    drives(driver, 0.5, seeing=True)
    assert status(driver).stop_level == "none"


def test_a_robot_that_never_had_a_depth_camera_drives_at_full_speed() -> None:
    driver = with_depth()
    driver.goal(LOCATIONS["location4"])
    assert drives(driver, 5.0, seeing=False) > 0.4
    assert status(driver).stop_level == "none"


def test_a_goal_that_ends_navigation_again_and_again_is_given_up() -> None:
    driver = on_the_way()
    for number in (1, 2):
        driver = again(driver)
        driver.run(2.0)
        assert driver.of(NAVIGATION_CHECKPOINT)[-1].resumed == number
    driver = again(driver)
    driver.run(1.0)
    (result,) = driver.results()
    assert result.error_code == ErrorCode.NAVIGATION_RESTARTED
    assert "3 times in a row" in result.error_msg
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].goal is None


def test_ends_of_long_ago_do_not_count() -> None:
    there_and_back = tuple(Planar.of(LOCATIONS[f"location{number}"]) for number in (1, 4, 1))
    driver = again(on_the_way(act.FollowWaypoints(poses=there_and_back)))
    driver.run(2.0)
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].resumed == 1
    driver.run(31.0)
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].goal is not None
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].resumed == 0
