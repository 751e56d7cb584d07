"""What a service of ROS 2 is: its type, its node, and how it is answered."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any

from mazebot.common.messages.topics import Query
from mazebot.common.node.node import Node

Response = Mapping[str, Any]
"""Plain values, see Interfaces."""
Steps = Generator[tuple[Query[Any, Any], Any], Any, Response]
"""Asks queries of the node, one after another, and returns the response."""
Handle = Callable[[Any, Node], Steps]
"""Answers a request of a node's service."""


@dataclass(frozen=True, eq=False)
class Service:
    """One row: a service, its type, and the node that answers it, by the same queries as the user's
    own tools.
    """

    name: str
    type: str
    owner: str
    handle: Handle
    about: str


def answered(answer: Callable[[Any, Node], Response]) -> Handle:
    """A handler that asks no query."""

    def handle(request: Any, node: Node) -> Steps:
        yield from ()
        return answer(request, node)

    return handle
