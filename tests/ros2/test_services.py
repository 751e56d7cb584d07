"""Services, parameters and an action, called by others with the Zenoh of ROS 2 Jazzy."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SEND_GOAL,
)
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.parameters import values_of
from mazebot.localization.config import LocalizationConfig
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.node import NavigationNode
from tests.common.bus.running import Running
from tests.ros2.environment import output_of

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(120)]

VEL = "controller_server.max_linear_vel"
DOUBLE = 3


class Localization(Node):
    """Counts what it is asked."""

    name = "localization"
    _config = LocalizationConfig()
    searches = 0

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for request in inbox.requests(REINITIALIZE_GLOBAL_LOCALIZATION):
            self.searches += 1
            request.respond(REINITIALIZE_GLOBAL_LOCALIZATION.response())


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@pytest.fixture
def navigation(endpoint: str) -> Iterator[NavigationNode]:
    node = NavigationNode(NavigationConfig())
    running = Running(node, open_session(BusConfig(connect=endpoint), timeout_s=20.0))
    yield node
    running.stop()


def call(endpoint: str, name: str, service: str, **values: Any) -> Any:
    return json.loads(output_of("call", endpoint, name, service, json.dumps(values)))


def setting(name: str, value: float) -> dict[str, Any]:
    value_message = {"type": DOUBLE, "double_value": value}
    return {"_type": "Parameter", "name": name, "value": value_message}


def test_an_empty_request_is_answered(endpoint: str) -> None:
    node = Localization()
    running = Running(node, open_session(BusConfig(connect=endpoint), timeout_s=20.0))
    try:
        call(endpoint, "/reinitialize_global_localization", "Empty")
    finally:
        running.stop()
    assert node.searches == 1


def test_parameters_are_listed_read_set_and_refused(
    endpoint: str, navigation: NavigationNode
) -> None:
    listed = call(endpoint, "/navigation/list_parameters", "ListParameters")
    assert listed["result"]["names"] == [*values_of(navigation)]
    got = call(endpoint, "/navigation/get_parameters", "GetParameters", names=["max_vel_x", VEL])
    assert [one["double_value"] for one in got["values"]] == [0.46, 0.46]
    described = call(
        endpoint, "/navigation/describe_parameters", "DescribeParameters", names=[VEL, "seed"]
    )
    assert [one["read_only"] for one in described["descriptors"]] == [False, True]
    done = call(
        endpoint, "/navigation/set_parameters", "SetParameters",
        parameters=[setting("max_vel_x", 0.2), setting(VEL, -1.0), setting("nothing", 1.0)],
    )["results"]  # fmt: skip
    assert [one["successful"] for one in done] == [True, False, False]
    assert "must be greater than 0" in done[1]["reason"]
    assert values_of(navigation)[VEL] == 0.2


def test_a_node_tells_whether_it_is_active(endpoint: str, navigation: NavigationNode) -> None:
    assert navigation.waiting_for()
    state = call(endpoint, "/navigation/get_state", "GetState")["current_state"]
    assert (state["id"], state["label"]) == (2, "inactive")
    # Nav2's tools ask for nodes of Nav2.
    assert call(endpoint, "/bt_navigator/get_state", "GetState")["current_state"] == state
    manager = call(endpoint, "/lifecycle_manager_navigation/is_active", "Trigger")
    assert (manager["success"], manager["message"]) == (False, "waiting for the world")


@pytest.fixture
def waiting(endpoint: str) -> Iterator[None]:
    """A robot that waits for as long as it is told."""

    class Robot(Node):
        name = "navigation"
        _config = NavigationConfig()
        goal: act.SendGoal | None = None
        end_s = 0.0

        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            for send in inbox.requests(SEND_GOAL):
                self.goal = send.message
                assert isinstance(self.goal.goal, act.Wait)
                self.end_s = time.monotonic() + self.goal.goal.duration_s
                send.respond(act.SendGoalReply(accepted=True))
            for cancel in inbox.requests(CANCEL_GOAL):
                cancel.respond(doc.CancelGoalReply())
                self._end("canceled", 9012, outbox)
            left_s = self.end_s - time.monotonic()
            if self.goal is not None and left_s <= 0.0:
                self._end("succeeded", 0, outbox)
            elif self.goal is not None:
                told = {"goal_id": self.goal.goal_id, "action": "wait", "time_left_s": left_s}
                outbox.put(ACTION_FEEDBACK, act.ActionFeedback.model_validate(told))

        def _end(self, status: str, code: int, outbox: Outbox) -> None:
            assert self.goal is not None
            ended = {
                "goal_id": self.goal.goal_id, "action": "wait", "status": status,
                "error_code": code, "start_time_s": 0.0, "end_time_s": 1.0,
            }  # fmt: skip
            self.goal = None
            outbox.put(ACTION_RESULT, act.ActionResult.model_validate(ended))

    session = open_session(BusConfig(connect=endpoint), timeout_s=20.0)
    running, ends = Running(Robot(), session), threading.Event()

    def tick() -> None:
        while not ends.wait(0.05):
            running.wake()

    clock = threading.Thread(target=tick)
    clock.start()
    yield
    ends.set()
    clock.join()
    running.stop()


@pytest.mark.usefixtures("waiting")
@pytest.mark.parametrize(("cancels", "status", "code"), [(False, 4, 0), (True, 5, 9012)])
def test_an_action_gives_feedback_and_a_result(
    endpoint: str, cancels: bool, status: int, code: int
) -> None:
    types = interfaces()
    kind = "nav2_msgs/action/Wait"
    keys = {
        part: DEFAULT_KEYS.typed(f"/wait/_action/{part}", name, types.hash_of(name))
        for part, name in {
            "send_goal": f"{kind}_SendGoal", "cancel_goal": "action_msgs/srv/CancelGoal",
            "get_result": f"{kind}_GetResult", "feedback": f"{kind}_FeedbackMessage",
            "status": "action_msgs/msg/GoalStatusArray",
        }.items()
    }  # fmt: skip
    seconds = 60.0 if cancels else 1.5
    output = output_of("wait_action", endpoint, str(seconds), str(int(cancels)), json.dumps(keys))
    found = json.loads(output)
    assert found["accepted"]
    assert 0.0 < found["left_s"] <= seconds
    assert (found["status"], found["error_code"]) == (status, code)
    assert found["statuses"][-1] == status
    if cancels:
        assert (found["cancel"], found["same"]) == ([0, 1], True)
