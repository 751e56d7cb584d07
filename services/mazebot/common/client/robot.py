"""How a program reaches the robot: one interface, in this process or over Zenoh."""

from __future__ import annotations

from typing import Protocol, TypeVar

from mazebot.common.messages.topics import Query, Topic

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")


class Connection(Protocol):
    """A way to a robot. Times are those of the robot's clock, that of the simulation."""

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """The reply to a query. Raises ConfigError where there is none in time."""
        ...

    def put(self, topic: Topic[M], message: M) -> None:
        """Publish a message. Raises ValueError where it is invalid."""
        ...

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message on a topic since the connection was made; None: none."""
        ...

    def taken(self, topic: Topic[M]) -> list[M]:
        """All messages on a topic since the last call, or since the connection was made."""
        ...

    def let_pass(self, seconds: float) -> None:
        """Let this much of the robot's time pass, or less over Zenoh if a message came."""
        ...

    def now_ns(self) -> int:
        """The robot's time."""
        ...

    def close(self) -> None:
        """Give up the connection."""
        ...
