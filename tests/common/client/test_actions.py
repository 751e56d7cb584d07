"""A goal is followed to its own result, or to the end of the service that has it."""

from __future__ import annotations

import pytest

from mazebot.common.client.actions import ActionClient
from mazebot.common.client.robot import RobotError, UnreachableError
from mazebot.common.client.service_watch import ServiceGoneError
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import CancelGoal
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    NAVIGATION_RESULT,
    PHOTO_REQUEST,
)
from tests.common.client.fake_robot import FakeRobot
from tests.common.samples import SAMPLES

SPIN = act.Spin(target_yaw_rad=1.0)


def result(goal_id: str, status: str = "succeeded") -> act.ActionResult:
    return act.ActionResult.model_validate(
        {"goal_id": goal_id, "action": "spin", "status": status,
         "start_time_s": 1.0, "end_time_s": 2.0}
    )  # fmt: skip


def test_a_goal_gets_its_own_result_also_before_the_reply() -> None:
    robot = FakeRobot()

    def accept(sent: act.SendGoal) -> act.SendGoalReply:
        robot.send(ACTION_RESULT, result("another"))
        robot.send(ACTION_RESULT, result(sent.goal_id))
        return act.SendGoalReply(accepted=True)

    with ActionClient(robot, ACTION_RESULT) as client:
        robot.send(ACTION_RESULT, result("mine", "aborted"))
        robot.reply = accept
        assert client.send("mine", SPIN, 1.0).accepted
        assert client.is_active
        client.update()
        assert client.result == result("mine")
        assert not client.is_active
    assert robot.watches == []


def test_a_preempted_goal_ends_with_the_result_that_navigation_gives_it() -> None:
    robot = FakeRobot()
    robot.reply = lambda _: act.SendGoalReply(accepted=True)
    photo = act.PhotoRequest(waypoint=3, stamp_ns=0)
    with ActionClient(robot, ACTION_RESULT, PHOTO_REQUEST) as client:
        client.send("mine", SPIN, 1.0)
        robot.send(PHOTO_REQUEST, photo)
        robot.send(ACTION_RESULT, b"of another version")
        robot.send(ACTION_RESULT, result("mine", "aborted"))
        assert client.update() == [(PHOTO_REQUEST, photo)]
        assert client.result == result("mine", "aborted")


def test_a_rejected_goal_is_not_followed() -> None:
    robot = FakeRobot()
    robot.reply = lambda _: act.SendGoalReply(accepted=False, error_code=701, error_msg="no")
    with ActionClient(robot, ACTION_RESULT) as client:
        client.send("mine", SPIN, 1.0)
        assert client.goal is None
        assert not client.is_active


def test_feedback_is_that_of_the_goal() -> None:
    robot = FakeRobot()
    robot.reply = lambda _: act.SendGoalReply(accepted=True)
    feedback = act.ActionFeedback(goal_id="another", action="spin", navigation_time_s=1.0)
    with ActionClient(robot, ACTION_RESULT) as client:
        client.send("mine", SPIN, 1.0)
        robot.send(ACTION_FEEDBACK, feedback)
        assert client.feedback is None
        robot.send(ACTION_FEEDBACK, feedback.model_copy(update={"goal_id": "mine"}))
        assert client.feedback is not None


def test_a_goal_on_the_topic_is_known_by_its_stamp() -> None:
    robot = FakeRobot()
    sample = SAMPLES[NAVIGATION_RESULT]
    with ActionClient(robot, NAVIGATION_RESULT) as client:
        client.follow(CancelGoal(goal_stamp_ns=sample.goal_stamp_ns + 1))
        robot.send(NAVIGATION_RESULT, sample)
        client.update()
        assert client.is_active
        client.follow(CancelGoal(goal_stamp_ns=sample.goal_stamp_ns))
        robot.send(NAVIGATION_RESULT, sample)
        client.update()
        assert client.result == sample


@pytest.mark.parametrize(("processes", "text"), [("", "has ended"), ("b", "was restarted")])
def test_a_goal_is_lost_with_its_service(
    monkeypatch: pytest.MonkeyPatch, processes: str, text: str
) -> None:
    monkeypatch.setattr("mazebot.common.client.service_watch.PATIENCE_S", 0.0)
    robot = FakeRobot()
    robot.reply = lambda _: act.SendGoalReply(accepted=True)
    with ActionClient(robot, ACTION_RESULT) as client:
        client.send("mine", SPIN, 1.0)
        client.update()
        robot.running = {"navigation": frozenset(processes)} if processes else {}
        with pytest.raises(ServiceGoneError, match=text):
            client.update()
        assert not client.is_active
        # Another goal is the new process's.
        client.send("next", SPIN, 1.0)
        if processes:
            client.update()


def test_a_goal_is_not_lost_with_the_router(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mazebot.common.client.service_watch.PATIENCE_S", 0.0)
    robot = FakeRobot()
    robot.reply = lambda _: act.SendGoalReply(accepted=True)
    with ActionClient(robot, ACTION_RESULT) as client:
        client.send("mine", SPIN, 1.0)
        robot.is_lost = True
        with pytest.raises(UnreachableError, match="the router is lost"):
            client.update()
        robot.is_lost = False
        robot.send(ACTION_RESULT, result("mine"))
        client.update()
        assert client.result == result("mine")
    # Its messages come no more: whoever waits for them would wait for ever.
    for call in (client.update, lambda: client.send("next", SPIN, 1.0)):
        with pytest.raises(RobotError, match="the action client is closed"):
            call()
