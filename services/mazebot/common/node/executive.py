"""Runs nodes in lockstep: physics advances one step, then each node that is due steps, in table
order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Protocol, TypeVar

from mazebot.common.messages.topics import DIAGNOSTICS, PARAMETERS, SERVICES, Query, Topic
from mazebot.common.node.diagnostics import SelfReport
from mazebot.common.node.log import RosoutHandler
from mazebot.common.node.node import Beat, ClockNode, Envelope, Inbox, Node, Outbox, Trigger

Q = TypeVar("Q")
A = TypeVar("A")

DIAGNOSTICS_PERIOD_NS = 1_000_000_000
_SWITCH_INTERVAL_S = 2e-5
"""The loop hardly ever rests: threads that draw, look for markers and record must get the
interpreter between two of their long calls, which need none.
"""


class StalledError(RuntimeError):
    """Simulation time does not advance and no node is due."""


class Transport(Protocol):
    """Carries messages from one node's outbox to the others' inboxes."""

    def connect(self, node: Node) -> tuple[Inbox, Outbox]:
        """The inbox and outbox of a node."""

    def settle(self, node: Node, outbox: Outbox) -> None:
        """Return when all messages that the node has sent are in its readers' inboxes."""

    def close(self) -> None:
        """Release the transport's resources."""


class MemoryTransport:
    """Passes each message on as an object, without encoding it."""

    checks_messages: ClassVar[bool] = False
    """Whether what this process's own nodes send is validated: in the tests it is."""

    def __init__(self) -> None:
        self._inboxes: dict[str, Inbox] = {}
        self._used: dict[str, frozenset[str]] = {}
        """The topics that each node makes use of."""
        self._readers: dict[str, list[Inbox]] = {}
        """By topic, as far as it is known."""

    def connect(self, node: Node) -> tuple[Inbox, Outbox]:
        """The inbox and outbox of a node."""
        inbox = self._inboxes[node.name] = Inbox(node)
        self._used[node.name] = frozenset(topic.name for topic in node.reads())
        self._readers.clear()
        return inbox, Outbox(node, self._send, checks=self.checks_messages, is_read=self._is_read)

    def settle(self, node: Node, outbox: Outbox) -> None:
        """Messages are delivered at once."""

    def close(self) -> None:
        """Nothing to release."""

    def ask(self, query: Query[Q, A], message: Q, respond: Callable[[A], None]) -> bool:
        """Query the node that the table names; see Inbox.ask."""
        return self._inboxes[query.owner].ask(query, message, respond)

    def _is_read(self, topic: Topic[Any]) -> bool:
        """Whether a node reads a topic: all are connected before the first one steps."""
        return bool(self._readers_of(topic))

    def _readers_of(self, topic: Topic[Any]) -> list[Inbox]:
        readers = self._readers.get(topic.name)
        if readers is None:
            readers = self._readers[topic.name] = [
                self._inboxes[reader]
                for reader in topic.readers
                if topic.name in self._used.get(reader, ())
            ]
        return readers

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        for inbox in self._readers_of(topic):
            inbox.deliver(topic, message, envelope)


class Seat(Protocol):
    """A node that takes part in a round, in this process or in another one."""

    @property
    def name(self) -> str:
        """The service's name."""

    @property
    def exit_code(self) -> int | None:
        """See Node."""

    def due(self, now_ns: int) -> bool:
        """Whether the node has to step at `now_ns`. Called once a turn."""

    def step(self, now_ns: int) -> None:
        """Step, and return when everything that was sent is accounted for."""


class LocalSeat:
    """The seat of a node in this process. Its diagnostics are published by simulation time."""

    def __init__(
        self, node: Node, inbox: Inbox, outbox: Outbox, rosout: RosoutHandler | None = None
    ) -> None:
        self.node = node
        self.inbox = inbox
        self.outbox = outbox
        self._rosout = rosout
        self._trigger = Trigger(node)
        self._report = SelfReport(node, inbox, outbox)
        self._report_beat = Beat(DIAGNOSTICS_PERIOD_NS)

    @property
    def name(self) -> str:
        """See Seat."""
        return self.node.name

    @property
    def exit_code(self) -> int | None:
        """See Seat."""
        return self.node.exit_code

    def due(self, now_ns: int) -> bool:
        """See Seat."""
        return self._trigger.due(now_ns, self.inbox)

    def step(self, now_ns: int) -> None:
        """See Seat."""
        self.outbox.now_ns = now_ns
        if self._rosout is not None:
            self._rosout.outbox = self.outbox
        self.node.step(now_ns, self.inbox, self.outbox)
        if self._report_beat.due(now_ns):
            self.outbox.put(DIAGNOSTICS, self._report.report(now_ns))
        if self._rosout is not None:
            self._rosout.outbox = None


class Round:
    """Seats around one clock, in table order."""

    def __init__(self, clock: ClockNode) -> None:
        self._clock = clock
        self._clock_seat: Seat | None = None
        self.seats: list[Seat] = []
        self.stepped: list[Seat] = []
        """Those that stepped in the last turn."""
        self.now_ns = 0

    def join(self, seat: Seat) -> None:
        """Add a seat at its position in the order."""
        if seat.name == self._clock.name:
            self._clock_seat = seat
        self.seats.append(seat)
        self.seats.sort(key=lambda one: SERVICES.index(one.name))

    def turn(self, advance: bool = True) -> bool:
        """Advance physics by one step if `advance` is set, then step each node that is due; return
        whether any stepped.
        """
        next_ns = self._clock.next_step_ns() if advance else None
        if next_ns is not None:
            self.now_ns = next_ns
        self.stepped = stepped = []
        for seat in self.seats:
            due = seat.due(self.now_ns)
            ticks = seat is self._clock_seat
            if due or (ticks and next_ns is not None):
                seat.step(self.now_ns)
                stepped.append(seat)
                if ticks:
                    # Earlier than before after a reset.
                    self.now_ns = self._clock.now_ns
        return bool(stepped)


class _SettledSeat(LocalSeat):
    """A seat whose step ends when the transport has delivered what it sent."""

    def __init__(self, node: Node, transport: Transport, rosout: RosoutHandler | None) -> None:
        super().__init__(node, *transport.connect(node), rosout)
        self._transport = transport

    def step(self, now_ns: int) -> None:
        super().step(now_ns)
        self._transport.settle(self.node, self.outbox)


class Executive:
    """Nodes in lockstep in one process. A run depends only on the nodes' configurations: the same
    ones give the same bytes.
    """

    def __init__(
        self, nodes: Iterable[Node], transport: Transport, rosout: RosoutHandler | None = None
    ) -> None:
        self._transport = transport
        ordered = sorted(nodes, key=lambda node: SERVICES.index(node.name))
        (self._clock,) = (node for node in ordered if isinstance(node, ClockNode))
        # As fast as possible.
        self._clock.speed = 0.0
        self._seats = [_SettledSeat(node, transport, rosout) for node in ordered]
        self._round = Round(self._clock)
        for seat in self._seats:
            self._round.join(seat)
            seat.outbox.put(PARAMETERS, seat.node.parameters())
            transport.settle(seat.node, seat.outbox)

    @property
    def now_ns(self) -> int:
        """Simulation time."""
        return self._round.now_ns

    @property
    def nodes(self) -> Sequence[Node]:
        """The nodes in the order in which they step."""
        return [seat.node for seat in self._seats]

    def run(self, until: Callable[[], bool] = lambda: False) -> int | None:
        """Step until a node is done (its exit code is returned) or `until()` holds after a step
        (None).

        Raises StalledError, with what each node waits for, where no further step is possible.
        """
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        try:
            return self._run(until)
        finally:
            sys.setswitchinterval(before_s)

    def _run(self, until: Callable[[], bool]) -> int | None:
        while True:
            moved = self.turn()
            for seat in self._round.stepped:
                if seat.exit_code is not None:
                    self._flush()
                    return seat.exit_code
            if until():
                return None
            if not moved:
                raise StalledError(f"the simulation is stalled: {self._why()}")

    def turn(self) -> bool:
        """Advance physics by one step, then step each node that is due; whether any stepped."""
        return self._round.turn()

    def _why(self) -> str:
        if self._clock.paused:
            return f"{self._clock.name} is paused and no other node can resume it"
        waits = [
            f"{node.name} is waiting for {node.waiting_for()}"
            for node in self.nodes
            if node.waiting_for()
        ]
        return "; ".join(waits) or "no node is due"

    def _flush(self) -> None:
        """Step the other nodes once more, so that they process the last messages."""
        for seat in self._seats:
            if seat.exit_code is None and seat.node is not self._clock:
                seat.step(self.now_ns)

    def close(self) -> None:
        """Close every node, in reverse order, and the transport."""
        for seat in reversed(self._seats):
            seat.node.close()
        self._transport.close()
