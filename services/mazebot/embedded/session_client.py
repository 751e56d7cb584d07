"""A connection to the robot of a `Session`, in this process."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

from mazebot.common.messages.topics import Query, Topic
from mazebot.embedded.session import Session

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")


class SessionConnection:
    """See Connection. The simulation advances in `let_pass` only."""

    def __init__(self, session: Session, keep: tuple[Topic[Any], ...] = ()) -> None:
        """`keep`: topics of which `taken` returns every message."""
        self._session = session
        self._stack = ExitStack()
        self._kept = {
            topic.name: self._stack.enter_context(session.watching(topic)) for topic in keep
        }

    def ask(self, query: Query[Q, A], message: Q, timeout_s: float) -> A:
        """See Connection."""
        return self._session.ask(query, message)

    def put(self, topic: Topic[M], message: M) -> None:
        """See Connection."""
        self._session.put(topic, message)

    def latest(self, topic: Topic[M]) -> M | None:
        """See Connection."""
        return self._session.latest(topic)

    def taken(self, topic: Topic[M]) -> list[M]:
        """See Connection."""
        seen: list[M] = list(self._kept[topic.name])
        self._kept[topic.name].clear()
        return seen

    def let_pass(self, seconds: float) -> None:
        """See Connection."""
        self._session.run_for(seconds)

    def now_ns(self) -> int:
        """See Connection."""
        return round(self._session.now_s * 1e9)

    def close(self) -> None:
        """See Connection. The session stays open: it is the caller's."""
        self._stack.close()
