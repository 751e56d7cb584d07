"""A robot of a few lines: what it sends and answers is set by the test."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from mazebot.common.client.robot import Receive, Robot, UnreachableError, ignore
from mazebot.common.messages.topics import Query, Topic
from mazebot.common.node.node import Envelope


class FakeRobot(Robot):
    def __init__(self) -> None:
        self.running: dict[str, frozenset[str]] = {"navigation": frozenset({"a"})}
        self.reply: Callable[[Any], Any] = lambda _: None
        self.asked: list[Any] = []
        self.newest: dict[str, Any] = {}
        self.watches: list[tuple[tuple[Topic[Any], ...], Receive]] = []
        self.is_closed = False
        self.is_lost = False

    def send(self, topic: Topic[Any], message: Any) -> None:
        """A message of a service."""
        self.newest[topic.name] = message
        for topics, receive in self.watches:
            if topic in topics:
                receive(topic, message, Envelope("a", 0, 0, ""))

    def ask(self, query: Query[Any, Any], message: Any, timeout_s: float) -> Any:
        self.asked.append(message)
        return self.reply(message)

    def publish(self, topic: Topic[Any], message: Any) -> None:
        self.send(topic, message)

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        watch = tuple(topics), receive
        self.watches.append(watch)
        return lambda: self.watches.remove(watch)

    def latest(self, topic: Topic[Any]) -> Any:
        return self.newest.get(topic.name)

    def alive(self) -> dict[str, frozenset[str]]:
        if self.is_lost:
            raise UnreachableError("the router is lost")
        return self.running

    def now_ns(self) -> int:
        return 0

    def close(self) -> None:
        self.is_closed = True
