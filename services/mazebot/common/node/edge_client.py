"""The user's side of the bus: publishes what the topic table allows the user's tools."""

from __future__ import annotations

from typing import ClassVar

from mazebot.common.config import ServiceConfig
from mazebot.common.messages.topics import EDGE
from mazebot.common.node.node import Inbox, Node, Outbox


class EdgeClient(Node):
    """The user: may publish the topics of the user's tools."""

    name: ClassVar[str] = EDGE
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Does nothing: the user does not step."""
