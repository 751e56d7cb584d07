"""The robot of a run in this process, for other threads than that of the run."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

from mazebot.common.client.robot import (
    Receive,
    Robot,
    RobotError,
    check_request,
    encoded,
    ignore,
)
from mazebot.common.messages.topics import Query, Topic
from mazebot.common.node.edge_client import EdgeClient
from mazebot.common.node.executive import Executive
from mazebot.common.node.node import Outbox
from mazebot.embedded.watched_transport import WatchedTransport

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

MAX_WAITING = 1000
"""Messages and requests that wait for the run's next turn."""
_MAX_TASKS = 100
"""How many of them are passed on at once: more must not hold up the robot."""


class MemoryRobot(Robot):
    """See Robot. The thread of the run calls `serve` between its turns."""

    def __init__(self, transport: WatchedTransport) -> None:
        self._transport = transport
        self._executive: Executive | None = None
        self._outbox = Outbox(EdgeClient(), transport.send)
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(MAX_WAITING)

    def begin(self, executive: Executive) -> None:
        """The run begins; until then there is no stack."""
        self._executive = executive

    def alive(self) -> Mapping[str, frozenset[str]]:
        """See Robot."""
        executive = self._executive
        nodes = () if executive is None else executive.nodes
        return {node.name: frozenset((node.name,)) for node in nodes}

    def now_ns(self) -> int:
        """See Robot."""
        return 0 if self._executive is None else self._executive.now_ns

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        """See Robot."""
        return self._transport.watch(topics, receive)

    def latest(self, topic: Topic[M]) -> M | None:
        """See Robot."""
        return cast("M | None", self._transport.latest.get(topic.name))

    def publish(self, topic: Topic[M], message: M) -> None:
        """See Robot."""
        # What has no bytes would be taken here, and end whoever records or sends it.
        encoded(topic, message)

        def put() -> None:
            self._outbox.now_ns = self.now_ns()
            self._outbox.put(topic, message)

        self._put(put)

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Robot."""
        check_request(query, message)
        answers: queue.SimpleQueue[A | None] = queue.SimpleQueue()

        def ask() -> None:
            if query.owner not in self.alive() or not self._transport.ask(
                query, message, answers.put
            ):
                answers.put(None)

        self._put(ask)
        try:
            answer = answers.get(timeout=timeout_s)
        except queue.Empty:
            raise RobotError(
                f"{query.name}: no answer from {query.owner} within {timeout_s:g} s"
            ) from None
        if answer is None:
            raise RobotError(f"{query.name}: {query.owner} is not running")
        return answer

    def serve(self, timeout_s: float = 0.0) -> None:
        """Pass on what other threads have sent; wait for it up to `timeout_s`."""
        try:
            task = self._waiting.get(block=timeout_s > 0.0, timeout=timeout_s or None)
            for _ in range(_MAX_TASKS):
                task()
                task = self._waiting.get_nowait()
        except queue.Empty:
            return

    def close(self) -> None:
        """The run has ended."""
        self._executive = None

    def _put(self, task: Callable[[], None]) -> None:
        if self._executive is None:
            raise RobotError("the run has ended")
        try:
            self._waiting.put_nowait(task)
        except queue.Full:
            raise RobotError("the run is busy: too many requests are waiting") from None
