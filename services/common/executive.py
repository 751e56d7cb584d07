"""Runs nodes in lockstep: physics advances one step, then each node that is due steps, in table
order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from services.common.diagnostics import diagnostics
from services.common.log import RosoutHandler
from services.common.node import ClockNode, Envelope, Inbox, Node, Outbox, Trigger
from services.common.topics import DIAGNOSTICS, PARAMETERS, SERVICES, Query, Topic

Q = TypeVar("Q")
A = TypeVar("A")

DIAGNOSTICS_PERIOD_NS = 1_000_000_000


class StalledError(RuntimeError):
    """Time stands still and no node has anything to do."""


class Transport(Protocol):
    """How messages get from one node's outbox to the others' inboxes."""

    def connect(self, node: Node) -> tuple[Inbox, Outbox]:
        """The boxes of a node."""

    def settle(self, node: Node, outbox: Outbox) -> None:
        """Return when everything that the node has sent is in its readers' inboxes."""

    def close(self) -> None:
        """Let go of what the transport holds."""


class MemoryTransport:
    """Hands each message over as the object it is."""

    def __init__(self) -> None:
        self._inboxes: dict[str, Inbox] = {}

    def connect(self, node: Node) -> tuple[Inbox, Outbox]:
        """The boxes of a node."""
        self._inboxes[node.name] = Inbox(node)
        return self._inboxes[node.name], Outbox(node, self._send)

    def settle(self, node: Node, outbox: Outbox) -> None:
        """Nothing is ever on its way."""

    def close(self) -> None:
        """Nothing to let go of."""

    def ask(self, query: Query[Q, A], message: Q, respond: Callable[[A], None]) -> bool:
        """Ask the node that the table names; see Inbox.ask."""
        return self._inboxes[query.owner].ask(query, message, respond)

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        for reader in topic.readers:
            if reader in self._inboxes:
                self._inboxes[reader].deliver(topic, message, envelope)


@dataclass
class _Seat:
    node: Node
    inbox: Inbox
    outbox: Outbox
    trigger: Trigger
    diagnostics_ns: int = 0


class Executive:
    """Nodes in lockstep. A run is a function of the nodes' configurations: the same ones give the
    same bytes.
    """

    def __init__(
        self, nodes: Iterable[Node], transport: Transport, rosout: RosoutHandler | None = None
    ) -> None:
        self._transport = transport
        self._rosout = rosout
        self.now_ns = 0
        ordered = sorted(nodes, key=lambda node: SERVICES.index(node.name))
        self._seats = [_Seat(node, *transport.connect(node), Trigger(node)) for node in ordered]
        for seat in self._seats:
            seat.outbox.put(PARAMETERS, seat.node.parameters())
            transport.settle(seat.node, seat.outbox)
        (self._clock,) = (node for node in ordered if isinstance(node, ClockNode))

    @property
    def nodes(self) -> Sequence[Node]:
        """The nodes in the order in which they step."""
        return [seat.node for seat in self._seats]

    def run(self, until: Callable[[], bool] = lambda: False) -> int | None:
        """Step until a node is done (its exit code is returned) or `until()` holds after a step
        (None).

        Raises StalledError, with what each node waits for, where nothing will ever happen again.
        """
        while True:
            moved = self.turn()
            for seat in self._seats:
                if seat.node.exit_code is not None:
                    self._flush()
                    return seat.node.exit_code
            if until():
                return None
            if not moved:
                waits = "; ".join(
                    f"{seat.node.name} waits for {seat.node.waiting_for()}"
                    for seat in self._seats
                    if seat.node.waiting_for()
                )
                raise StalledError(f"the simulation stands still: {waits or 'no node is due'}")

    def turn(self) -> bool:
        """Advance physics one step, then step each node that is due; whether any stepped."""
        next_ns = self._clock.next_step_ns()
        if next_ns is not None:
            self.now_ns = next_ns
        moved = False
        for seat in self._seats:
            ticks = seat.node is self._clock and next_ns is not None
            if ticks or seat.trigger.due(self.now_ns, seat.inbox):
                self._step(seat)
                moved = True
        return moved

    def _step(self, seat: _Seat) -> None:
        seat.outbox.now_ns = self.now_ns
        if self._rosout is not None:
            self._rosout.outbox = seat.outbox
        seat.node.step(self.now_ns, seat.inbox, seat.outbox)
        if self.now_ns >= seat.diagnostics_ns:
            seat.diagnostics_ns = self.now_ns + DIAGNOSTICS_PERIOD_NS
            said = diagnostics(self.now_ns, seat.node, seat.inbox, seat.outbox)
            seat.outbox.put(DIAGNOSTICS, said)
        if self._rosout is not None:
            self._rosout.outbox = None
        self._transport.settle(seat.node, seat.outbox)

    def _flush(self) -> None:
        """Let those that are due take in what the last one had to say."""
        for seat in self._seats:
            if seat.node.exit_code is None and seat.node is not self._clock:
                self._step(seat)

    def close(self) -> None:
        """Close every node, the last in the order first, and the transport."""
        for seat in reversed(self._seats):
            seat.node.close()
        self._transport.close()
