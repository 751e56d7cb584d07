"""Localisation and navigation that are started again while the robot is on its way."""

from __future__ import annotations

from typing import Any

import pytest

from mazebot.common.config import value_of
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    Planar,
    SetParameters,
    SetParametersReply,
    SimulationStats,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    CANCEL_GOAL,
    CMD_VEL,
    LOCALIZATION_CHECKPOINT,
    LOCALIZATION_STATUS,
    NAVIGATION_CHECKPOINT,
    NAVIGATION_STATUS,
    PARAMETER_EVENTS,
    PARAMETERS,
    SEND_GOAL,
    SET_PARAMETERS,
    SIMULATION_STATS,
    Topic,
)
from mazebot.common.node.node import Envelope
from tests.common.samples import SAMPLES
from tests.navigation.driving import LOCATIONS, NodeDriver, estimate_error_m

CHECKPOINTS: tuple[Topic[Any], ...] = (LOCALIZATION_CHECKPOINT, NAVIGATION_CHECKPOINT)
GOAL = LOCATIONS["location1"]
VEL, TURN = "controller_server.max_linear_vel", "controller_server.max_angular_vel"
STATS: SimulationStats = SAMPLES[SIMULATION_STATS]


def send(driver: NodeDriver, goal: act.ActionGoal, goal_id: str = "mine") -> None:
    replies: list[act.SendGoalReply] = []
    driver.inbox.ask(SEND_GOAL, act.SendGoal(goal_id=goal_id, goal=goal), replies.append)
    driver.step()
    assert replies[-1].accepted, replies


def on_the_way(goal: act.ActionGoal | None = None, seconds: float = 3.0) -> NodeDriver:
    driver = NodeDriver()
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(1.0)
    if goal is None:
        driver.goal(GOAL)
    else:
        send(driver, goal)
    driver.run(seconds)
    return driver


def hand_over(driver: NodeDriver, topic: Topic[Any], kept: Any) -> None:
    inbox = {
        LOCALIZATION_CHECKPOINT.name: driver.localization_inbox,
        NAVIGATION_CHECKPOINT.name: driver.inbox,
    }[topic.name]
    inbox.deliver(topic, kept, Envelope("before", 0, 0, ""))


def again(before: NodeDriver, robot: SE2 | None = None, **changes: Any) -> NodeDriver:
    """Both processes are others, a second later, with what was kept of the ones before."""
    driver = NodeDriver(start=robot or before.robot.map_from_base)
    driver.odom_from_base = before.odom_from_base
    driver.now_ns = before.now_ns + 1_000_000_000
    for topic in CHECKPOINTS:
        kept = before.of(topic)
        if kept:
            hand_over(driver, topic, kept[-1].model_copy(update=changes))
    driver.deliver(SIMULATION_STATS, STATS.model_copy(update={"sim_time_s": driver.now_ns * 1e-9}))
    driver.learn()
    return driver


def test_the_goal_goes_on_and_its_result_bears_its_name() -> None:
    before = on_the_way()
    stamp_ns = before.of(NAVIGATION_CHECKPOINT)[-1].goal_stamp_ns
    assert before.robot.map_from_base.distance_m(SE2(0.0, 0.0, 0.0)) > 0.3
    driver = again(before)
    driver.run(1.0)
    assert estimate_error_m(driver) < 0.05
    # Nobody who watches takes the goal for lost.
    assert all(one.goal is not None for one in driver.of(NAVIGATION_STATUS))
    driver.run(40.0)
    (result,) = driver.results()
    assert (result.error_code, result.goal_stamp_ns) == (0, stamp_ns)
    assert result.start_time_s < before.now_ns * 1e-9
    assert driver.robot.map_from_base.distance_m(GOAL) < 0.1
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].goal is None


def test_the_pose_is_that_of_the_process_before_and_not_odometry_s() -> None:
    """Odometry is off by more than the scans would show at once."""
    off = SE2(0.9, 0.5, 0.6)
    before = on_the_way()
    before.odom_from_base = off @ before.odom_from_base
    kept = before.of(LOCALIZATION_CHECKPOINT)[-1]
    driver = again(before)
    odom = Planar.of(off @ kept.odom_from_base.se2())
    kept = kept.model_copy(update={"odom_from_base": odom})
    hand_over(driver, LOCALIZATION_CHECKPOINT, kept)
    driver.run(0.5)
    assert estimate_error_m(driver) < 0.05
    assert driver.of(LOCALIZATION_STATUS)[-1].state == "localized"


@pytest.mark.slow
def test_a_robot_that_was_carried_away_meanwhile_is_not_taken_for_localized() -> None:
    before = on_the_way()
    elsewhere = LOCATIONS["location3"]
    driver = again(before, robot=elsewhere)
    driver.run(3.0)
    last = driver.of(LOCALIZATION_STATUS)[-1]
    assert last.state != "localized" or estimate_error_m(driver) < 0.1
    driver.run(60.0)
    assert estimate_error_m(driver) < 0.1
    assert driver.of(LOCALIZATION_STATUS)[-1].state == "localized"


@pytest.mark.slow
def test_of_poses_and_waypoints_what_is_left_goes_on() -> None:
    here, there = LOCATIONS["location1"], LOCATIONS["location2"]
    near = Planar(x_m=-0.9, y_m=-0.68, yaw_rad=-2.5)
    through = act.NavigateThroughPoses(poses=(near, Planar.of(here), Planar.of(there)))
    before = on_the_way(through, 6.0)
    kept = before.of(NAVIGATION_CHECKPOINT)[-1]
    assert isinstance(kept.goal, act.NavigateThroughPoses)
    assert kept.goal.poses in (through.poses[1:], through.poses[2:])
    waypoints = act.FollowWaypoints(poses=(near, Planar.of(here)), number_of_loops=1)
    before = on_the_way(waypoints, 8.0)
    kept = before.of(NAVIGATION_CHECKPOINT)[-1]
    assert isinstance(kept.goal, act.FollowWaypoints)
    assert (kept.goal.goal_index, kept.goal.number_of_loops) == (1, 1)
    driver = again(before)
    driver.run(60.0)
    (result,) = driver.of(ACTION_RESULT)
    assert (result.goal_id, result.status) == ("mine", "succeeded")


def test_waypoints_that_were_missed_are_told_at_the_end() -> None:
    outside, near = (
        Planar(x_m=50.0, y_m=50.0, yaw_rad=0.0),
        Planar(x_m=-0.9, y_m=-0.68, yaw_rad=-2.5),
    )
    before = on_the_way(act.FollowWaypoints(poses=(outside, near)), 1.0)
    (missed,) = before.of(NAVIGATION_CHECKPOINT)[-1].missed
    assert (missed.index, missed.status) == (0, "failed")
    driver = again(before)
    driver.run(15.0)
    (result,) = driver.of(ACTION_RESULT)
    assert (result.status, result.waypoints) == ("succeeded", (missed,))


def test_a_motion_that_cannot_go_on_ends_with_the_reason() -> None:
    driver = again(on_the_way(act.Spin(target_yaw_rad=3.0), 1.0))
    driver.run(1.0)
    (result,) = driver.of(ACTION_RESULT)
    assert (result.goal_id, result.status) == ("mine", "aborted")
    assert result.error_code == ErrorCode.NAVIGATION_RESTARTED
    assert "restarted" in result.error_msg
    # Its action server learns of it before it has ended.
    first, last = driver.of(NAVIGATION_CHECKPOINT)
    assert (first.goal_id, first.resumed, last.goal) == ("mine", 0, None)


@pytest.mark.parametrize("meant", [{"goal_id": "mine"}, {"action": "navigate_to_pose"}, {}])
def test_a_goal_is_cancelled_before_it_goes_on(meant: dict[str, Any]) -> None:
    driver = again(on_the_way(act.NavigateToPose(pose=Planar.of(GOAL))))
    driver.inbox.is_handed_over = False
    replies: list[CancelGoalReply] = []
    for asked in (CancelGoal(action="spin"), CancelGoal(**meant)):
        driver.inbox.ask(CANCEL_GOAL, asked, replies.append)
    driver.step()
    # Others may have kept it.
    assert not replies
    driver.inbox.hand_over()
    driver.run(2.0)
    assert [reply.return_code for reply in replies] == [2, 0]
    assert replies[1].goal_id == "mine"
    (result,) = driver.of(ACTION_RESULT)
    assert (result.goal_id, result.status, result.error_code) == ("mine", "canceled", 9012)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is None
    assert driver.of(NAVIGATION_CHECKPOINT)[-1].goal is None


def test_that_nothing_goes_on_is_said_once() -> None:
    driver = NodeDriver()
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(1.0)
    (said,) = driver.of(NAVIGATION_CHECKPOINT)
    assert said.goal is None


@pytest.mark.parametrize("changes", [{"epoch": 4}, {"world_hash": "another"}])
def test_what_belongs_to_another_run_is_left(changes: dict[str, Any]) -> None:
    before = on_the_way()
    set_value(before, VEL, 0.1)
    driver = again(before, **changes)
    driver.run(2.0)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is None
    assert not driver.results()
    assert value_of(driver.node.parameters().values, VEL) == 0.46


def set_value(driver: NodeDriver, name: str, value: Any) -> None:
    replies: list[SetParametersReply] = []
    asked = SetParameters(values={name: value})
    driver.inbox.ask(SET_PARAMETERS, asked, replies.append)
    driver.step()
    assert replies == [SetParametersReply()]


def test_what_was_set_on_the_way_stays_set() -> None:
    before = on_the_way(seconds=1.0)
    set_value(before, VEL, 0.1)
    driver = again(before)
    driver.run(5.0)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is not None
    assert 0.05 < max(one.twist.linear.x for one in driver.of(CMD_VEL)) < 0.11
    assert value_of(driver.node.parameters().values, VEL) == 0.1
    assert value_of(driver.of(PARAMETERS)[-1].values, VEL) == 0.1
    (event,) = driver.of(PARAMETER_EVENTS)
    assert [one.value.double_value for one in event.changed_parameters] == [0.1]
    # It goes on to a process after that one, and what is set last counts.
    set_value(driver, VEL, 0.2)
    third = again(driver)
    set_value(third, TURN, 0.5)
    third.run(2.0)
    values = third.node.parameters().values
    assert (value_of(values, VEL), value_of(values, TURN)) == (0.2, 0.5)
    assert third.of(NAVIGATION_CHECKPOINT)[-1].parameters == {VEL: 0.2, TURN: 0.5}


def test_what_is_set_stays_without_a_goal_and_in_a_run_that_was_reset() -> None:
    driver = NodeDriver()
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(0.5)
    set_value(driver, VEL, 0.1)
    reset = STATS.model_copy(update={"epoch": STATS.epoch + 1, "resumed_from": None})
    driver.deliver(SIMULATION_STATS, reset)
    driver.run(0.5)
    first, *_, last = (one for one in driver.of(NAVIGATION_CHECKPOINT) if one.parameters)
    assert (first.epoch, first.parameters) == (STATS.run_epoch, {VEL: 0.1})
    assert (last.epoch, last.parameters) == (reset.epoch, {VEL: 0.1})
    following = again(driver, epoch=STATS.run_epoch)
    following.run(0.5)
    assert value_of(following.node.parameters().values, VEL) == 0.1


def test_what_others_keep_of_itself_is_not_taken_up() -> None:
    driver = on_the_way()
    for topic in CHECKPOINTS:
        hand_over(driver, topic, driver.of(topic)[-1])
    driver.run(40.0)
    (result,) = driver.results()
    assert result.error_code == 0
