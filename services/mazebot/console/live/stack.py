"""What the live page needs of a stack, be it on a bus or in the same process."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol, TypeVar

from mazebot.common.messages.topics import Query, Topic
from mazebot.common.node.node import Envelope

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

Receive = Callable[[Topic[Any], Any, Envelope], None]
"""Takes a topic, a message (or its CDR bytes) and its envelope. It must only store: it is called on
a thread of the stack.
"""


class StackError(Exception):
    """There is no stack, it did not answer, or it refused; the text is one line."""


class Stack(Protocol):
    """A robot's stack, as one of the user's tools sees it. Any thread may call."""

    how_to_start: str
    """What to do where no stack is running, in one line."""

    def services(self) -> frozenset[str]:
        """The services that are running; empty: no stack is."""

    def now_ns(self) -> int:
        """Simulation time as last heard; 0 before that."""

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        """Pass on each message of some topics, beginning with the latched ones; call the returned
        function to end it. It lasts over restarts of the stack.
        """

    def publish(self, topic: Topic[M], message: M) -> None:
        """Publish on a topic of the user's tools. Raises StackError where it cannot be sent."""

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """The reply to a query. Raises StackError where there is none within `timeout_s`."""

    def close(self) -> None:
        """Give up the connection; the stack goes on."""
