"""The action SimulateSteps of the real simulator, on a real router."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive
from mazebot.common.bus.session import open_session
from mazebot.common.messages.documents import SimulationControl, SimulationControlReply
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.common.ros.interfaces import interfaces
from tests.common.bus.ros_client import call
from tests.physics.driver import Driver, world

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
OK, OPERATION_FAILED = 1, 4
NAME, KIND = "/simulate_steps", "simulation_interfaces/action/SimulateSteps"
DEADLINE_S = 20.0


class Stack:
    """A simulator that goes on by itself, as fast as it can, and a client of its action."""

    def __init__(self, endpoint: str) -> None:
        config = BusConfig(connect=endpoint)
        self.keys, self.driver = config.keys, Driver()
        session = open_session(config, timeout_s=5.0)
        self.bus = Bus(session, self.driver.node, self.driver.inbox, self.keys)
        alive(session, self.keys, timeout_s=DEADLINE_S)
        self.driver.outbox = self.bus.outbox(self.driver.node)
        self.driver.load(world())
        self.session = open_session(config, timeout_s=5.0)
        types, kind = interfaces(self.keys.distro), f"{KIND}_FeedbackMessage"
        self.told: list[tuple[int, int]] = []

        def take(sample: Any) -> None:
            feedback = types.read(kind, sample.payload.to_bytes()).feedback
            self.told.append((feedback.completed_steps, feedback.remaining_steps))

        key = self.keys.typed(f"{NAME}/_action/feedback", kind, types.hash_of(kind))
        self.subscriber = self.session.declare_subscriber(key, take)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ends.wait(0.0005):
            self.driver.turn()

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self.session.close()  # type: ignore[no-untyped-call]
        self.bus.close()
        self.driver.node.close()

    def control(self, **fields: Any) -> SimulationControlReply:
        replies: list[SimulationControlReply] = []
        self.driver.inbox.ask(SIMULATION_CONTROL, SimulationControl(**fields), replies.append)
        wait_until(lambda: bool(replies), "a reply")
        return replies[0]

    @property
    def steps_done(self) -> int:
        stats = self.control().stats
        assert stats is not None
        return stats.iterations

    def send(self, steps: int) -> bytes:
        goal_id = uuid.uuid4().bytes
        values = {"goal_id": ident(goal_id), "goal": {"steps": steps}}
        assert self.call("send_goal", f"{KIND}_SendGoal", values).accepted
        return goal_id

    def result(self, goal_id: bytes) -> Any:
        return self.call("get_result", f"{KIND}_GetResult", {"goal_id": ident(goal_id)})

    def cancel(self, goal_id: bytes) -> Any:
        values = {"goal_info": {"goal_id": ident(goal_id)}}
        return self.call("cancel_goal", "action_msgs/srv/CancelGoal", values)

    def call(self, part: str, kind: str, values: dict[str, Any]) -> Any:
        return call(self.session, f"{NAME}/_action/{part}", kind, values, self.keys)


def ident(goal_id: bytes) -> dict[str, Any]:
    return {"uuid": np.frombuffer(goal_id, np.uint8)}


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"never: {what}"
        time.sleep(0.005)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@pytest.fixture
def stack(endpoint: str) -> Iterator[Stack]:
    made = Stack(endpoint)
    yield made
    made.close()


def test_the_paused_simulation_does_just_so_many_steps(stack: Stack) -> None:
    stack.control(pause=True)
    before = stack.steps_done
    ended = stack.result(stack.send(25))
    assert (ended.status, ended.result.result.result) == (SUCCEEDED, OK)
    assert stack.steps_done == before + 25
    wait_until(lambda: bool(stack.told) and stack.told[-1] == (25, 0), "the last feedback")
    completed = [one for one, _ in stack.told]
    assert len(completed) > 5
    assert completed == sorted(set(completed))
    assert all(one + left == 25 for one, left in stack.told)


def test_a_simulation_that_is_playing_does_none(stack: Stack) -> None:
    ended = stack.result(stack.send(25))
    assert (ended.status, ended.result.result.result) == (ABORTED, OPERATION_FAILED)
    assert ended.result.result.error_message == "the simulation must be PAUSED"
    stack.control(pause=True)
    none = stack.result(stack.send(0))
    assert (none.status, none.result.result.result) == (ABORTED, OPERATION_FAILED)
    assert none.result.result.error_message.startswith("steps: 0: must be 1 ..")


def test_a_goal_that_is_canceled_leaves_it_paused(stack: Stack) -> None:
    stack.control(pause=True)
    before = stack.steps_done
    goal_id = stack.send(1_000_000)
    wait_until(lambda: bool(stack.told), "feedback")
    other = stack.result(stack.send(5))
    assert (other.status, other.result.result.result) == (ABORTED, OPERATION_FAILED)
    assert stack.cancel(goal_id).return_code == 0
    assert stack.result(goal_id).status == CANCELED
    done = stack.steps_done
    assert before < done < before + 1_000_000
    reply = stack.control()
    assert reply.stats is not None
    assert (reply.stats.paused, reply.stats.iterations) == (True, done)


def test_a_run_that_another_request_ends_is_aborted_with_its_reason(stack: Stack) -> None:
    stack.control(pause=True)
    goal_id = stack.send(1_000_000)
    wait_until(lambda: bool(stack.told), "feedback")
    stack.control(pause=False)
    ended = stack.result(goal_id)
    assert (ended.status, ended.result.result.result) == (ABORTED, OPERATION_FAILED)
    assert "interrupted at" in ended.result.result.error_message
    assert stack.control().stats.paused is False  # type: ignore[union-attr]
