"""The stack of a run in this process, as the console sees it from another thread."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from mazebot.common.messages.topics import DIAGNOSTICS, EDGE, Delivery, Query, Topic
from mazebot.common.node.edge_client import EdgeClient
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.node.node import Envelope, Outbox
from mazebot.console.live.stack import Receive, StackError

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

MAX_WAITING = 1000
"""Messages and requests that wait for the run's next turn."""
_MAX_TASKS = 100
"""How many of them are passed on at once: more must not hold up the robot."""


class WatchedTransport(MemoryTransport):
    """Passes on each message to the nodes, and to who watches; keeps what is latched."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._watches: tuple[tuple[frozenset[str], Receive], ...] = ()
        self._kept: dict[tuple[str, str], deque[tuple[Topic[Any], object, Envelope]]] = {}

    def send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        """Publish a message."""
        self._send(topic, message, envelope)

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        """See Stack."""
        watch = frozenset(topic.name for topic in topics), receive
        with self._lock:
            for (name, _), kept in self._kept.items():
                for arrived in kept if name in watch[0] else ():
                    receive(*arrived)
            self._watches = (*self._watches, watch)

        def end() -> None:
            with self._lock:
                self._watches = tuple(one for one in self._watches if one is not watch)

        return end

    @property
    def is_watched(self) -> bool:
        """Whether anybody watches now."""
        return bool(self._watches)

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        with self._lock:
            # /diagnostics too: a page that opens while the simulation is paused shows the states.
            if topic.delivery is Delivery.LATCHED or topic is DIAGNOSTICS:
                key = topic.name, envelope.source
                if key not in self._kept:
                    depth = topic.depth if topic.delivery is Delivery.LATCHED else 1
                    self._kept[key] = deque(maxlen=depth)
                self._kept[key].append((topic, message, envelope))
            for names, receive in self._watches:
                if topic.name in names:
                    receive(topic, message, envelope)
        super()._send(topic, message, envelope)


class MemoryStack:
    """See Stack. The thread of the run calls `serve` between its turns."""

    how_to_start = ".venv/bin/mazebot demo --console"

    def __init__(self, transport: WatchedTransport) -> None:
        self._transport = transport
        self._executive: Executive | None = None
        self._outbox = Outbox(EdgeClient(), transport.send)
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(MAX_WAITING)

    def begin(self, executive: Executive) -> None:
        """The run begins; until then there is no stack."""
        self._executive = executive

    def services(self) -> frozenset[str]:
        """See Stack."""
        executive = self._executive
        return frozenset(() if executive is None else (node.name for node in executive.nodes))

    def now_ns(self) -> int:
        """See Stack."""
        return 0 if self._executive is None else self._executive.now_ns

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        """See Stack."""
        return self._transport.watch(topics, receive)

    def publish(self, topic: Topic[M], message: M) -> None:
        """See Stack."""
        if EDGE not in topic.owners:
            raise StackError(f"{topic.name}: only {' and '.join(topic.owners)} may write it")

        def put() -> None:
            self._outbox.now_ns = self.now_ns()
            self._outbox.put(topic, message)

        self._put(put)

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Stack."""
        answers: queue.SimpleQueue[A | None] = queue.SimpleQueue()

        def ask() -> None:
            if query.owner not in self.services() or not self._transport.ask(
                query, message, answers.put
            ):
                answers.put(None)

        self._put(ask)
        try:
            answer = answers.get(timeout=timeout_s)
        except queue.Empty:
            raise StackError(
                f"{query.name}: no answer from {query.owner} within {timeout_s:g} s"
            ) from None
        if answer is None:
            raise StackError(f"{query.name}: {query.owner} is not there to answer")
        return answer

    def serve(self, timeout_s: float = 0.0) -> None:
        """Pass on what the console has sent; wait for it up to `timeout_s`."""
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
            raise StackError("the run has ended")
        try:
            self._waiting.put_nowait(task)
        except queue.Full:
            raise StackError("the run does not take anything: too many requests wait") from None
