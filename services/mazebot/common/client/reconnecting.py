"""A robot whose stack may start later than its client, end, and start again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, TypeVar

from mazebot.common.client.robot import (
    CLOSED,
    NO_STACK,
    Receive,
    Robot,
    RobotError,
    UnreachableError,
    ignore,
)
from mazebot.common.messages.topics import Query, Topic

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

_PERIOD_S = 0.5
"""How often it is checked whether the stack has started or ended, while a topic is watched."""


@dataclass(eq=False)
class _Watch:
    topics: tuple[Topic[Any], ...]
    receive: Receive
    ends: ExitStack = field(default_factory=ExitStack)


class ReconnectingRobot(Robot):
    """See Robot. Connected only while a topic is watched; a watch lasts over restarts."""

    def __init__(self, connect: Callable[[], Robot]) -> None:
        """`connect` is called on a thread of its own; it raises RobotError where no stack runs."""
        self._connect = connect
        self._lock = threading.RLock()
        self._watches: list[_Watch] = []
        self._robot: Robot | None = None
        self._alive: Mapping[str, frozenset[str]] = {}
        self._changed = threading.Event()
        self._closed = False
        self._keeper = threading.Thread(target=self._keep, name="reconnecting", daemon=True)
        self._keeper.start()

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Robot."""
        return self._connected().ask(query, message, timeout_s)

    def publish(self, topic: Topic[M], message: M) -> None:
        """See Robot."""
        self._connected().publish(topic, message)

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        """See Robot."""
        watch = _Watch(tuple(topics), receive)
        with self._lock:
            self._watches.append(watch)
            if self._robot is not None:
                watch.ends.callback(self._robot.watch(watch.topics, receive))
        self._changed.set()

        def end() -> None:
            with self._lock:
                if watch in self._watches:
                    self._watches.remove(watch)
                watch.ends.close()
            self._changed.set()

        return end

    def latest(self, topic: Topic[M]) -> M | None:
        """See Robot."""
        robot = self._robot
        return None if robot is None else robot.latest(topic)

    def alive(self) -> Mapping[str, frozenset[str]]:
        """See Robot: as last checked, up to 0.5 s ago."""
        with self._lock:
            return self._alive

    def now_ns(self) -> int:
        """See Robot."""
        robot = self._robot
        return 0 if robot is None else robot.now_ns()

    def close(self) -> None:
        """See Robot."""
        self._closed = True
        self._changed.set()
        self._keeper.join()

    def _connected(self) -> Robot:
        if self._closed:
            raise RobotError(CLOSED)
        robot = self._robot
        if robot is None or not self._alive:
            raise RobotError(NO_STACK)
        return robot

    def _keep(self) -> None:
        """Connect, look after the connection, and end it."""
        while not self._closed:
            if not self._watches:
                self._disconnect()
                self._changed.wait()
            self._changed.clear()
            if self._closed:
                break
            if self._watches:
                self._check()
                self._changed.wait(_PERIOD_S)
        self._disconnect()

    def _check(self) -> None:
        robot, is_new = self._robot, False
        if robot is None:
            try:
                robot, is_new = self._connect(), True
            except RobotError:
                return
        try:
            alive, is_lost = robot.alive(), False
        except UnreachableError:
            alive, is_lost = {}, True
        with self._lock:
            has_ended = is_lost or (bool(self._alive) and not alive)
            # First: who hears something of a stack may ask it for something.
            self._robot, self._alive = robot, alive
            for watch in self._watches if is_new else ():
                watch.ends.callback(robot.watch(watch.topics, watch.receive))
        if has_ended:
            # What a stack that starts later has latched comes with new subscriptions.
            self._disconnect()

    def _disconnect(self) -> None:
        with self._lock:
            robot, self._robot = self._robot, None
            self._alive = {}
            for watch in self._watches:
                watch.ends.close()
        if robot is not None:
            # Closing may hang where the router is lost.
            threading.Thread(target=robot.close, name="closing", daemon=True).start()
