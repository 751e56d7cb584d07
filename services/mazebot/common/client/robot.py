"""How a user's program reaches the robot of a running stack: one interface, over Zenoh or within
the process.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Self, TypeVar

from mazebot.common.client.arguments import refusal
from mazebot.common.config import ConfigError
from mazebot.common.messages import wire
from mazebot.common.messages.topics import EDGE, Query, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

HOW_TO_START = "docker compose up demo-world-enhanced, mazebot demo --console, or mazebot up"
"""What to do where no stack is running: all ways, in one line."""
NO_STACK = "no stack is running"
CLOSED = "the connection is closed"
"""Of a robot whose `close` was called."""
_POLL_S = 0.01
_MIN_WALL_S = 0.1

Receive = Callable[[Topic[Any], Any, Envelope], None]
"""Gets a topic, a message (or its CDR bytes) and its envelope. It must only store: it is called on
a thread of the robot.
"""


class RobotError(ConfigError):
    """No stack is running, it did not reply, or it rejected; the text is one line."""


class UnreachableError(RobotError):
    """The stack's router does not answer, or does not let this client in any more: nobody knows
    what has become of the services.
    """


def ignore(_: Topic[Any], __: Any, ___: Envelope) -> None:
    """Watches a topic for `latest` only."""


class Robot(ABC):
    """The robot of one stack, with the rights of the user's tools. Any thread may call, except in
    `Session`, whose simulation advances on the caller's thread.
    """

    @abstractmethod
    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """The reply to a query. Raises RobotError where there is none within `timeout_s` of wall
        time.
        """

    @abstractmethod
    def publish(self, topic: Topic[M], message: M) -> None:
        """Publish on a topic of the user's tools. Raises RobotError where the message is invalid,
        or cannot be sent.
        """

    @abstractmethod
    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        """Pass on each message of some topics, beginning with the latched ones; call the returned
        function to end it.
        """

    @abstractmethod
    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message on a topic since it is watched; None: none, or it is invalid."""

    @abstractmethod
    def alive(self) -> Mapping[str, frozenset[str]]:
        """The running services, each with the ids of its processes; empty: no stack is running. It
        may take seconds where the router is slow.

        Raises UnreachableError where the router is lost.
        """

    def elsewhere(self, *services: str) -> str:
        """Where any of some services runs that is not here, to be appended to an error: in another
        domain or namespace of the same router. Empty: nowhere, or that is not known.
        """
        del services
        return ""

    @abstractmethod
    def now_ns(self) -> int:
        """Simulation time as last received; 0 before that."""

    @abstractmethod
    def close(self) -> None:
        """End the connection; the stack continues."""

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Let so much simulation time pass, or less where `until()` becomes true.

        It ends after max(seconds, 0.1) of wall time too: a simulation that is paused or slow does
        not block the caller.
        """
        end_ns, end_s = self.now_ns() + round(seconds * 1e9), time.monotonic()
        end_s += max(seconds, _MIN_WALL_S)
        while not until() and self.now_ns() < end_ns and time.monotonic() < end_s:
            time.sleep(_POLL_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_request(query: Query[Q, Any], message: Q) -> None:
    """Raises RobotError where a message is not what a query takes."""
    if not isinstance(message, query.request):
        what = f"must be a {query.request.__name__}"
        raise RobotError(refusal(query.name, what, message))


def encoded(topic: Topic[M], message: M) -> bytes:
    """The CDR bytes of a message of the user's tools.

    Raises RobotError where they may not publish the topic, or the message is invalid.
    """
    if EDGE not in topic.owners:
        raise RobotError(f"{topic.name}: only {' and '.join(topic.owners)} may publish it")
    try:
        wire.validate(topic, message)
        return wire.encode(topic, message)
    except wire.WireError as error:
        raise RobotError(f"{topic.name}: {error}") from error
