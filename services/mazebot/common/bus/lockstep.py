"""Lockstep between processes: physics gives each service its turn, so that a run over the bus is
the same as in one process, to the last bit.

A service steps only in its turn. The turn lists the messages that the service must receive first,
in the order in which they were sent; the end of the turn lists what the service sent. So a run does
not depend on the bus's latency or order.
"""

from __future__ import annotations

import functools
import threading
import time
from collections import deque
from collections.abc import Callable, Container, Iterable
from typing import Any, TypeVar

from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import (
    BY_NAME,
    SERVICES,
    TOPICS,
    Delivery,
    Query,
    Topic,
    owned_by,
    read_by,
)
from mazebot.common.node.executive import LocalSeat, Round
from mazebot.common.node.log import RosoutHandler
from mazebot.common.node.node import Beat, ClockNode, Envelope, Inbox, Node, Outbox

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

MAY_LEAVE = ("bringup",)
"""Services that may exit; the others continue without them."""
LOCALIZER, MAPPERS = "localization", ("mapping", "explorer")
"""A run needs the one or the others."""
MAX_UNANNOUNCED = 1000
"""Messages pending for a service that is not due; beyond this it receives them without a step."""
MAX_OUTSIDE = 1000
"""Queue length of a topic for messages from outside the services; the oldest are dropped first."""

_LOOK_UP_S = 0.05
"""Period at which `still_wanted` is checked while waiting for a message."""

_LATCHED = {topic.name for topic in TOPICS if topic.delivery is Delivery.LATCHED}


class LockstepError(RuntimeError):
    """A service broke the lockstep; the text is one line."""


class Turn(Document):
    """Makes a service receive messages and, with `step`, step."""

    executive: str
    """Source of the executive that gives the turn; a new executive starts a new run."""
    now_ns: int
    step: bool
    sources: dict[str, str]
    """The bus source of each service that has a seat."""
    sent: tuple[tuple[str, str, int], ...]
    """Topic, source and last sequence number of each run of messages, in the order in which they
    were sent on their topic.
    """
    timeout_s: float


class TurnEnd(Document):
    """The state of a service at the end of its turn."""

    error: str = ""
    sent: dict[str, int]
    """Messages sent so far, by topic."""
    woken: bool
    """Whether a message or query is pending for which it steps at once."""
    wakes: tuple[str, ...]
    period_ns: int | None
    exit_code: int | None
    matched: bool
    """Whether its publishers match the readers that have a seat."""


_GONE = TurnEnd(sent={}, woken=False, wakes=(), period_ns=None, exit_code=0, matched=False)

Ask = Callable[[str, str, Turn], TurnEnd | None]
"""Gives the service with this name and bus source a turn; None where it does not end in time."""


class Ledger:
    """The messages sent, and those not yet announced to each service."""

    def __init__(self) -> None:
        self.sources: dict[str, str] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._unannounced: dict[str, dict[str, list[tuple[str, int]]]] = {}
        self._waiting: dict[str, int] = {}

    def join(self, service: str, source: str, sent: dict[str, int]) -> None:
        """Add a service, with the number of messages it has sent so far. Of all messages sent
        before, it still receives only the latched ones.
        """
        self.sources[service] = source
        self._unannounced[service] = {}
        self._waiting[service] = 0
        for topic in read_by(service):
            for (name, other), count in self._counts.items():
                if name == topic.name and name in _LATCHED:
                    self._announce(service, name, other, count - 1, 1)
        for name, count in sent.items():
            if name not in _LATCHED:
                self._counts[name, source] = count
        self.add(service, {name: count for name, count in sent.items() if name in _LATCHED})

    def leave(self, service: str) -> None:
        """Remove a service."""
        source = self.sources.pop(service)
        del self._unannounced[service], self._waiting[service]
        self._counts = {key: count for key, count in self._counts.items() if key[1] != source}

    def add(self, service: str, sent: dict[str, int]) -> None:
        """Update how many messages a service has sent so far, by topic."""
        source = self.sources[service]
        for name, count in sent.items():
            new = count - self._counts.get((name, source), 0)
            if new <= 0:
                continue
            self._counts[name, source] = count
            for reader in BY_NAME[name].readers:
                if reader in self._unannounced:
                    self._announce(reader, name, source, count - 1, new)

    def _announce(self, reader: str, topic: str, source: str, last: int, new: int) -> None:
        runs = self._unannounced[reader].setdefault(topic, [])
        if runs and runs[-1][0] == source:
            runs.pop()
        runs.append((source, last))
        self._waiting[reader] += new

    def take(self, reader: str) -> tuple[tuple[str, str, int], ...]:
        """The messages not yet announced to a service, now marked as announced; see Turn.sent."""
        unannounced, self._unannounced[reader] = self._unannounced[reader], {}
        self._waiting[reader] = 0
        return tuple(
            (topic, source, last) for topic, runs in unannounced.items() for source, last in runs
        )

    def wakes(self, reader: str, topics: Iterable[str]) -> bool:
        """Whether a message on one of these topics is not yet announced to a service."""
        unannounced = self._unannounced[reader]
        return any(topic in unannounced for topic in topics)

    def waiting(self, reader: str) -> int:
        """Number of messages not yet announced to a service."""
        return self._waiting[reader]


class HeldInbox(Inbox):
    """Holds messages until a turn lists them. Messages from outside the services are received at
    the next step.
    """

    def __init__(
        self,
        node: Node,
        on_outside: Callable[[], None],
        still_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """`still_wanted` is called often while waiting for a message."""
        super().__init__(node)
        self._on_outside = on_outside
        self._still_wanted = still_wanted
        self._arrival = threading.Condition()
        self._held: dict[tuple[str, str], deque[tuple[Any, Envelope]]] = {}
        self._outside: dict[str, deque[tuple[Any, Envelope]]] = {
            topic.name: deque(maxlen=MAX_OUTSIDE) for topic in read_by(node.name)
        }
        self._arrived: dict[tuple[str, str], int] = {}
        self._sources: frozenset[str] = frozenset()

    def deliver(self, topic: Topic[M], message: M | bytes, envelope: Envelope) -> None:
        """Hold a message; call `on_outside` if it is from outside and wakes the node."""
        key = topic.name, envelope.source
        with self._arrival:
            inside = envelope.source in self._sources
            if inside:
                self._held.setdefault(key, deque()).append((message, envelope))
            else:
                self._outside[topic.name].append((message, envelope))
            if inside or topic.delivery is Delivery.LATCHED:
                self._arrived[key] = max(envelope.sequence, self._arrived.get(key, -1))
                self._arrival.notify()
        if not inside and topic.name in self._waking_names:
            self.may_wake = True
            self._on_outside()

    def ask(self, query: Query[Q, A], message: Q, respond: Callable[[A], None]) -> bool:
        """See Inbox."""
        taken = super().ask(query, message, respond)
        if taken:
            self._on_outside()
        return taken

    def wakes(self) -> bool:
        """See Inbox. Held messages from outside count, too."""
        wakes = super().wakes() or any(self._outside[name] for name in self._waking_names)
        self.may_wake |= wakes
        return wakes

    def outside(self) -> bool:
        """Whether a message from outside is held."""
        return any(self._outside.values())

    def forget(self) -> None:
        """Drop the messages held for a previous executive, except latched ones."""
        with self._arrival:
            self._held = {key: held for key, held in self._held.items() if key[0] in _LATCHED}

    def take_in(
        self,
        sources: Iterable[str],
        sent: Iterable[tuple[str, str, int]],
        timeout_s: float,
        and_outside: bool,
    ) -> str:
        """Wait for the messages that a turn lists and receive them in its order; then, with
        `and_outside`, those from outside. Return which message did not arrive within `timeout_s`
        or while it was wanted; empty: all have arrived.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._arrival:
            self._sources = frozenset(sources)
            self._sort_out_newcomers()
            for name, source, last in sent:
                key = name, source
                while self._arrived.get(key, -1) < last:
                    left_s = deadline_s - time.monotonic()
                    if left_s <= 0.0 or not self._still_wanted():
                        return f"{name} #{last} was not received"
                    self._arrival.wait(min(left_s, _LOOK_UP_S))
                held = self._held.get(key, ())
                while held and held[0][1].sequence <= last:
                    super().deliver(BY_NAME[name], *held.popleft())
            if and_outside:
                for name, waiting in self._outside.items():
                    while waiting:
                        super().deliver(BY_NAME[name], *waiting.popleft())
        return ""

    def _sort_out_newcomers(self) -> None:
        """Move messages that a service sent before it was known from outside to held."""
        for name, waiting in self._outside.items():
            for _ in range(len(waiting)):
                message, envelope = waiting.popleft()
                if envelope.source in self._sources:
                    held = self._held.setdefault((name, envelope.source), deque())
                    held.append((message, envelope))
                else:
                    waiting.append((message, envelope))


_owned_by = functools.cache(owned_by)


def sent_so_far(node: Node, outbox: Outbox) -> dict[str, int]:
    """Messages a node has sent, by topic; topics without any are left out."""
    counts = {topic.name: outbox.sent(topic) for topic in _owned_by(node.name)}
    return {name: count for name, count in counts.items() if count}


class Participant:
    """A service that steps in its turns."""

    def __init__(
        self,
        node: Node,
        inbox: HeldInbox,
        outbox: Outbox,
        matched: Callable[[Container[str]], bool],
        rosout: RosoutHandler | None = None,
    ) -> None:
        self._node = node
        self._inbox = inbox
        self._outbox = outbox
        self._matched = matched
        self._rosout = rosout
        self._executive = ""
        self._seat = LocalSeat(node, inbox, outbox, rosout)

    @property
    def seated(self) -> bool:
        """Whether it has ever had a turn."""
        return bool(self._executive)

    def take(self, turn: Turn) -> TurnEnd:
        """Execute a turn."""
        if turn.executive != self._executive:
            self._inbox.forget()
            self._seat = LocalSeat(self._node, self._inbox, self._outbox, self._rosout)
            self._executive = turn.executive
        error = self._inbox.take_in(turn.sources.values(), turn.sent, turn.timeout_s, turn.step)
        if not error and turn.step:
            self._seat.step(turn.now_ns)
        return TurnEnd(
            error=error,
            sent=sent_so_far(self._node, self._outbox),
            woken=self._inbox.wakes(),
            wakes=tuple(topic.name for topic in self._node.wakes),
            period_ns=self._node.period_ns,
            exit_code=self._node.exit_code,
            matched=turn.step or self._matched(turn.sources),
        )


class _OwnSeat(LocalSeat):
    """The seat of physics."""

    def __init__(
        self,
        node: Node,
        inbox: HeldInbox,
        outbox: Outbox,
        rosout: RosoutHandler | None,
        ledger: Ledger,
        timeout_s: float,
    ) -> None:
        super().__init__(node, inbox, outbox, rosout)
        self._held = inbox
        self._ledger = ledger
        self._timeout_s = timeout_s

    def due(self, now_ns: int) -> bool:
        if self._ledger.waiting(self.name) or self._held.outside():
            self.take_in(now_ns, and_outside=True)
        return super().due(now_ns)

    def take_in(self, now_ns: int, and_outside: bool) -> None:
        """Raises LockstepError where a message does not arrive."""
        ledger = self._ledger
        error = self._held.take_in(
            ledger.sources.values(), ledger.take(self.name), self._timeout_s, and_outside
        )
        if error:
            raise LockstepError(f"lockstep: {self.name}: {error} at {_seconds(now_ns)}")

    def step(self, now_ns: int) -> None:
        super().step(now_ns)
        self._ledger.add(self.name, sent_so_far(self.node, self.outbox))


class RemoteSeat:
    """The seat of a service in another process."""

    def __init__(
        self, name: str, source: str, executive: str, ledger: Ledger, ask: Ask, timeout_s: float
    ) -> None:
        self.name = name
        self.source = source
        self.exit_code: int | None = None
        self.woken = False
        self._executive = executive
        self._ledger = ledger
        self._ask = ask
        self._timeout_s = timeout_s
        end = self._turn(0, step=False, sent=()) or _GONE
        self._beat = Beat(end.period_ns) if end.period_ns is not None else None
        self._wakes = end.wakes
        ledger.join(name, source, end.sent)

    def due(self, now_ns: int) -> bool:
        """See Seat."""
        on_beat = self._beat is not None and self._beat.due(now_ns)
        return on_beat or self.woken or self._ledger.wakes(self.name, self._wakes)

    def step(self, now_ns: int) -> None:
        """See Seat. Raises LockstepError where it does not reply."""
        end = self._turn(now_ns, step=True)
        if end is not None:
            self._ledger.add(self.name, end.sent)

    def take_in(self, now_ns: int) -> bool:
        """Make it receive the unannounced messages, without a step; return whether its publishers
        match their readers.
        """
        end = self._turn(now_ns, step=False)
        return end is not None and end.matched

    def _turn(
        self, now_ns: int, step: bool, sent: tuple[tuple[str, str, int], ...] | None = None
    ) -> TurnEnd | None:
        """None where it has left, if it may."""
        start_s = time.monotonic()
        end = self._ask(
            self.name,
            self.source,
            Turn(
                executive=self._executive,
                now_ns=now_ns,
                step=step,
                sources=self._ledger.sources,
                sent=self._ledger.take(self.name) if sent is None else sent,
                # Shorter, so that the service itself reports which message is missing.
                timeout_s=self._timeout_s * 0.8,
            ),
        )
        if end is None:
            if time.monotonic() - start_s < self._timeout_s * 0.9:
                if self.name not in MAY_LEAVE:
                    raise _left(self.name, now_ns)
                self.exit_code = 0
                return None
            raise LockstepError(
                f"lockstep: {self.name} timed out after {self._timeout_s:g} s, at "
                f"{_seconds(now_ns)}"
            )
        if end.error:
            raise LockstepError(f"lockstep: {self.name}: {end.error} at {_seconds(now_ns)}")
        self.woken = end.woken
        self.exit_code = end.exit_code
        return end


class Lockstep:
    """Gives turns: to physics in this process, and to every other service over the bus."""

    def __init__(
        self,
        node: ClockNode,
        inbox: HeldInbox,
        outbox: Outbox,
        source: str,
        ask: Ask,
        matched: Callable[[Container[str]], bool],
        timeout_s: float,
        rosout: RosoutHandler | None = None,
    ) -> None:
        self._executive = source
        self._ask = ask
        self._matched = matched
        self._timeout_s = timeout_s
        self._ledger = Ledger()
        self._own = _OwnSeat(node, inbox, outbox, rosout, self._ledger, timeout_s)
        self._remote: dict[str, RemoteSeat] = {}
        self._round = Round(node)
        self._round.join(self._own)
        self._candidates: dict[str, list[str]] = {name: [] for name in SERVICES}
        self._begun = False
        self.gathered = False
        """Whether all services are matched, so that turns are given."""

    @property
    def now_ns(self) -> int:
        """Simulation time."""
        return self._round.now_ns

    def missing(self) -> list[str]:
        """The services that have no seat, in table order."""
        return [name for name in SERVICES if name not in self._remote and name != self._own.name]

    def awaited(self) -> list[str]:
        """The services without which turns cannot begin, in table order: either localisation or
        mapping, and with that the explorer.
        """
        absent = [name for name in self.missing() if not self._candidates[name]]
        maps = LOCALIZER in absent and not set(MAPPERS) <= set(absent)
        unneeded = (LOCALIZER,) if maps else MAPPERS
        return [name for name in absent if name not in unneeded]

    def note(self, service: str, source: str, there: bool | None) -> None:
        """Note that a service is alive, or gone, or (None) has a message from outside pending.

        Raises LockstepError where a service with a seat is gone and may not leave.
        """
        if there is None:
            self._wake(service, source)
        elif there:
            self._meet(service, source)
        else:
            self._miss(service, source)

    def _meet(self, service: str, source: str) -> None:
        if service in self._candidates and source not in self._candidates[service]:
            self._candidates[service].append(source)

    def _miss(self, service: str, source: str) -> None:
        if source in self._candidates.get(service, ()):
            self._candidates[service].remove(source)
        seat = self._remote.get(service)
        if seat is None or seat.source != source:
            return
        self._leave(service)
        if self._begun and service not in MAY_LEAVE:
            raise _left(service, self.now_ns)

    def _wake(self, service: str, source: str) -> None:
        seat = self._remote.get(service)
        if seat is not None and seat.source == source:
            seat.woken = True

    def turn(self, advance: bool = True) -> bool:
        """Seat new services and give each one that is due its turn; return whether any stepped. No
        service steps before all are present, and time advances only with `advance`.

        Raises LockstepError where a service breaks the lockstep.
        """
        self._seat_newcomers()
        if not self.gathered:
            return False
        for seat in self._remote.values():
            if self._ledger.waiting(seat.name) > MAX_UNANNOUNCED:
                seat.take_in(self.now_ns)
        moved = self._round.turn(advance)
        self._let_go()
        return moved

    def _let_go(self) -> None:
        for name in [seat.name for seat in self._remote.values() if seat.exit_code is not None]:
            self._leave(name)

    def _seat_newcomers(self) -> None:
        newcomers = [name for name in self.missing() if self._candidates[name]]
        if not self._begun and self.awaited():
            return
        for name in SERVICES:
            # In table order, as they start in one process.
            if name == self._own.name and name not in self._ledger.sources:
                sent = sent_so_far(self._own.node, self._own.outbox)
                self._ledger.join(name, self._executive, sent)
            elif name in newcomers:
                self._remote[name] = RemoteSeat(
                    name, self._candidates[name][0], self._executive, self._ledger, self._ask,
                    self._timeout_s,
                )  # fmt: skip
                self.gathered = False
        if self.gathered:
            return
        # All publishers and readers have to match before the first message is sent.
        self._own.take_in(self.now_ns, and_outside=False)
        known = [seat.take_in(self.now_ns) for seat in self._remote.values()]
        self._let_go()
        if all(known) and self._matched(self._ledger.sources):
            self._begun = self.gathered = True
            for seat in self._remote.values():
                if seat not in self._round.seats:
                    self._round.join(seat)

    def _leave(self, service: str) -> None:
        seat = self._remote.pop(service)
        if seat.source in self._candidates[service]:
            self._candidates[service].remove(seat.source)
        if seat in self._round.seats:
            self._round.seats.remove(seat)
        self._ledger.leave(service)


def _left(service: str, now_ns: int) -> LockstepError:
    return LockstepError(f"lockstep: {service} disconnected at {_seconds(now_ns)}")


def _seconds(now_ns: int) -> str:
    return f"{now_ns * 1e-9:.3f} s of simulation time"
