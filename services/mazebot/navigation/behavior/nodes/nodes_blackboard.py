"""Nodes of BehaviorTree.CPP that write, remove, watch and use up entries of the blackboard."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

from mazebot.navigation.behavior.engine.ports import READERS, Port, PortType, as_status, out
from mazebot.navigation.behavior.engine.tree import Node, NodePlace, NodeStatus, TreeError
from mazebot.navigation.behavior.nodes.decorators import Decorator

RUNNING, SUCCESS, FAILURE = NodeStatus.RUNNING, NodeStatus.SUCCESS, NodeStatus.FAILURE


def _entry(node: Node, port: str) -> str:
    """The key that a port names, with braces or without."""
    return node.key(port) or node.place.attributes[port]


class SetBlackboard(Node):
    """Writes a value to the blackboard."""

    ports = (Port("value", "any", required=True), Port("output_key", "any", required=True))

    def _tick(self, now_ns: int) -> NodeStatus:
        self.place.blackboard.set(_entry(self, "output_key"), self.get("value"))
        return SUCCESS


class UnsetBlackboard(Node):
    """Removes an entry."""

    ports = (Port("key", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        self.place.blackboard.unset(self.text("key"))
        return SUCCESS


class WasEntryUpdated(Node):
    """Succeeds where an entry was set since this node was last ticked, else fails."""

    ports = (Port("entry", "any", required=True),)
    _times_set = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        last, self._times_set = self._times_set, _times_set(self)
        return SUCCESS if self._times_set not in (0, last) else FAILURE


def _times_set(node: Node) -> int:
    return node.place.blackboard.times_set(_entry(node, "entry"))


class SkipUnlessUpdated(Decorator):
    """Ticks its child where an entry was set since the last time; else it is skipped."""

    ports = (Port("entry", "any", required=True),)
    otherwise: ClassVar[NodeStatus] = NodeStatus.SKIPPED

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._times_set = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        if self.child.status is not RUNNING:
            last, self._times_set = self._times_set, _times_set(self)
            if self._times_set in (0, last):
                return self.otherwise
        return self._ended(self.child.tick(now_ns))


class WaitValueUpdate(SkipUnlessUpdated):
    """Ticks its child where an entry was set since the last time; until then it is running."""

    otherwise = RUNNING


class Loop(Decorator):
    """Ticks its child for each value of a queue, which it takes from the front: one a tick.

    A queue in the XML, `1;2;3`, is the same again at each start; one on the blackboard, a text of
    that form or a list, is used up.
    """

    element: ClassVar[PortType]

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._queue: deque[Any] = deque()

    def _tick(self, now_ns: int) -> NodeStatus:
        if self.status is not RUNNING:
            self._queue = self._taken()
        if self.child.status is not RUNNING:
            if not self._queue:
                return NodeStatus[as_status(self.get("if_empty"))]
            self.put("value", self._queue.popleft())
        status = self._ended(self.child.tick(now_ns))
        return FAILURE if status is FAILURE else RUNNING

    def _taken(self) -> deque[Any]:
        value, key = self.get("queue"), self.key("queue")
        if value is None:
            return deque()
        if isinstance(value, deque):
            return value
        values = value.split(";") if isinstance(value, str) else value
        if not isinstance(values, Sequence):
            raise TreeError(f"{self}, port 'queue': must be values, v;v;v, or a list of them")
        try:
            queue = deque(READERS[self.element](one) for one in values)
        except ValueError as error:
            raise TreeError(f"{self}, port 'queue': {error}") from None
        if key is not None:
            self.place.blackboard.set(key, queue)
        return queue


def loop(kind: str, element: PortType) -> type[Loop]:
    """The loop node for one type of values."""
    ports = (
        Port("queue", "any", required=True),
        Port("if_empty", "status", "SUCCESS"),
        out("value"),
    )
    doc = f"Ticks its child for each {element} of a queue."
    return type(kind, (Loop,), {"element": element, "ports": ports, "__doc__": doc})
