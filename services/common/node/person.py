"""The user's side of the bus: publishes what the topic table allows the user's tools."""

from __future__ import annotations

from typing import ClassVar

from services.common.config import ServiceConfig
from services.common.node.node import Inbox, Node, Outbox
from services.common.node.topics import EDGE


class Person(Node):
    """The user: may publish the topics of the user's tools."""

    name: ClassVar[str] = EDGE
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Does nothing: the user does not step."""
