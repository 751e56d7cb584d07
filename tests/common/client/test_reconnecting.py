"""A client outlives the stack, and finds the next one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from mazebot.common.client.reconnecting import ReconnectingRobot
from mazebot.common.client.robot import NO_STACK, Receive, Robot, RobotError, ignore
from mazebot.common.messages.topics import GET_ENTITIES, WORLD, Topic
from tests.common.client.fake_robot import FakeRobot


def wait_until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def test_a_watch_lasts_over_restarts_of_the_stack(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mazebot.common.client.reconnecting._PERIOD_S", 0.01)
    stacks: list[FakeRobot] = []

    def connect() -> Robot:
        if not stacks or stacks[-1].is_closed:
            raise RobotError("no Zenoh router")
        return stacks[-1]

    received: list[object] = []
    with ReconnectingRobot(connect) as robot:
        end = robot.watch((WORLD,), lambda _, message, __: received.append(message))
        with pytest.raises(RobotError, match=NO_STACK):
            robot.ask(GET_ENTITIES, GET_ENTITIES.request(), 1.0)
        for number in range(2):
            stacks.append(FakeRobot())
            wait_until(lambda: bool(robot.alive()))
            stacks[-1].send(WORLD, number)
            assert robot.latest(WORLD) is received[-1]
            robot.ask(GET_ENTITIES, GET_ENTITIES.request(), 1.0)
            # Without its services, or without its router.
            stacks[-1].running, stacks[-1].is_lost = {}, number == 1
            wait_until(lambda: stacks[-1].is_closed)
            assert not robot.alive()
            assert stacks[-1].watches == []
        assert received == [0, 1]
        stacks.append(FakeRobot())
        wait_until(lambda: bool(robot.alive()))
        end()
        # Nobody watches: the connection is closed.
        wait_until(lambda: stacks[-1].is_closed)
    assert stacks[-1].watches == []


def test_who_hears_something_may_ask_for_something() -> None:
    class Latched(FakeRobot):
        """What it has comes with the subscription."""

        def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Any:
            end = super().watch(topics, receive)
            self.send(WORLD, 1)
            return end

    asked: list[object] = []
    stack = Latched()
    with ReconnectingRobot(lambda: stack) as robot:

        def receive(*_: object) -> None:
            robot.ask(GET_ENTITIES, GET_ENTITIES.request(), 1.0)
            asked.append(1)

        robot.watch((WORLD,), receive)
        wait_until(lambda: bool(asked))
