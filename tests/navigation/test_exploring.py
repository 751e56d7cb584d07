"""The explorer's goals beside a person's: which comes first, pauses, and an exploration's end."""

from __future__ import annotations

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import CancelGoal, CancelGoalReply
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    CANCEL_GOAL,
    EXPLORATION_STATUS,
    NAVIGATION_STATUS,
    PAUSE_GOAL,
    SIMULATION_STATS,
)
from tests.navigation.driving import LOCATIONS, NodeDriver
from tests.navigation.test_resume import STATS, again

NEAR, FAR = LOCATIONS["location1"], LOCATIONS["location2"]
EXPLORING = ExplorationStatus(state="exploring", epoch=STATS.run_epoch)


@pytest.fixture
def driver() -> NodeDriver:
    driver = NodeDriver()
    driver.learn()
    driver.deliver(SIMULATION_STATS, STATS)
    driver.run(1.0)
    return driver


def explore(driver: NodeDriver, goal: SE2) -> int:
    """The explorer tells of a goal, and sends it; returns the goal's stamp."""
    stamp_ns = driver.now_ns
    driver.deliver(EXPLORATION_STATUS, EXPLORING.model_copy(update={"goal_stamp_ns": stamp_ns}))
    driver.goal(goal)
    driver.step()
    return stamp_ns


def stop_exploring(driver: NodeDriver, stamp_ns: int) -> None:
    changes = {"state": "paused", "goal_stamp_ns": stamp_ns}
    driver.deliver(EXPLORATION_STATUS, EXPLORING.model_copy(update=changes))
    driver.run(2.0)


def pause(driver: NodeDriver, paused: bool = True) -> None:
    replies: list[act.Reply] = []
    driver.inbox.ask(PAUSE_GOAL, act.PauseGoal(pause=paused), replies.append)
    driver.step()
    assert replies == [act.Reply()]


def moved_m(driver: NodeDriver, seconds: float) -> float:
    """How far the robot is from where it stood a second from now."""
    driver.run(1.0)
    before = driver.robot.map_from_base
    driver.run(seconds)
    return before.distance_m(driver.robot.map_from_base)


def test_a_goal_that_the_explorer_sends_during_a_pause_does_not_end_it(driver: NodeDriver) -> None:
    explore(driver, NEAR)
    driver.run(2.0)
    pause(driver)
    explore(driver, FAR)
    assert moved_m(driver, 3.0) < 0.01
    assert driver.of(NAVIGATION_STATUS)[-1].state == "held"
    assert [one.error_code for one in driver.results()] == [ErrorCode.PREEMPTED]
    pause(driver, False)
    assert moved_m(driver, 3.0) > 0.3
    # That of a person does.
    pause(driver)
    driver.goal(NEAR)
    driver.step()
    assert moved_m(driver, 3.0) > 0.3


def test_a_goal_of_the_explorer_replaces_none_but_its_own(driver: NodeDriver) -> None:
    first = explore(driver, FAR)
    driver.run(1.0)
    driver.goal(NEAR)
    driver.run(1.0)
    second = explore(driver, FAR)
    driver.run(1.0)
    ended = {one.goal_stamp_ns: one.error_code for one in driver.results()}
    assert ended == {first: ErrorCode.PREEMPTED, second: ErrorCode.PREEMPTED}
    goal = driver.of(NAVIGATION_STATUS)[-1].goal
    assert goal is not None
    assert goal.se2() == NEAR


def test_where_the_exploration_is_stopped_its_goal_alone_is_canceled(driver: NodeDriver) -> None:
    own = explore(driver, FAR)
    driver.run(2.0)
    stop_exploring(driver, own)
    (result,) = driver.results()
    assert (result.goal_stamp_ns, result.error_code) == (own, ErrorCode.CANCELED)
    assert moved_m(driver, 1.0) < 0.01
    driver.goal(NEAR)
    driver.step()
    stop_exploring(driver, own)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is not None
    assert len(driver.results()) == 1


def cancel(driver: NodeDriver) -> CancelGoalReply:
    replies: list[CancelGoalReply] = []
    driver.inbox.ask(CANCEL_GOAL, CancelGoal(), replies.append)
    driver.step()
    return replies[0]


def test_who_cancels_is_told_what_the_exploration_does(driver: NodeDriver) -> None:
    explore(driver, FAR)
    assert cancel(driver).explores
    assert "/explore/resume" in cancel(driver).error
    driver.goal(NEAR)
    driver.step()
    assert not cancel(driver).explores


def test_the_explorer_s_goal_is_known_as_such_in_another_process(driver: NodeDriver) -> None:
    own = explore(driver, FAR)
    driver.run(2.0)
    after = again(driver)
    after.run(1.0)
    explore(after, NEAR)
    (result,) = after.results()
    assert (result.goal_stamp_ns, result.error_code) == (own, ErrorCode.PREEMPTED)
    goal = after.of(NAVIGATION_STATUS)[-1].goal
    assert goal is not None
    assert goal.se2() == NEAR


def test_a_paused_task_is_paused_in_another_process(driver: NodeDriver) -> None:
    driver.goal(NEAR)
    driver.run(2.0)
    pause(driver)
    driver.run(1.0)
    after = again(driver)
    after.step()
    assert {one.state for one in after.of(NAVIGATION_STATUS)} == {"held"}
    assert moved_m(after, 5.0) < 0.01
    assert {one.state for one in after.of(NAVIGATION_STATUS)} == {"held"}
    # And in one after that, which is told to resume before it is ready.
    third = again(after)
    pause(third, False)
    third.run(40.0)
    (result,) = third.results()
    assert result.error_code == 0
