"""What a node is: `step(now_ns, inbox, outbox)`, with typed boxes and no I/O."""

from __future__ import annotations

import threading
import zlib
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

import numpy as np

from services.common.bus import wire
from services.common.config import ServiceConfig
from services.common.node.documents import Parameters
from services.common.node.held import HeldMessage, HeldMessages
from services.common.node.topics import Delivery, Query, Topic, asked_of, owned_by, read_by

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

MAX_REQUESTS = 1000
"""That wait for one node; those beyond are answered with an error."""
MAX_WAITING = 1000
"""Messages of one topic that wait for one node; of more, the newest."""
MAX_WAITING_BYTES = 256 * 1024 * 1024
"""Of all topics together, as they came from the wire."""
MAX_SOURCES = 1000
"""Of one topic, whose sequence numbers are remembered: those that sent last."""
QUEUE_FULL = "queue full"


class Envelope(NamedTuple):
    """What travels beside a message: its number at its source, when it was sent, and in which
    world.
    """

    source: str
    sequence: int
    sent_ns: int
    world_hash: str


@dataclass(frozen=True, eq=False)
class Request(Generic[Q, A]):
    """A query that waits for its answer. It may be answered in a later step, once."""

    query: Query[Q, A]
    message: Q
    respond: Callable[[A], None]
    """Sends the answer. What was not answered when the asker's patience ends is never answered."""


class Node(ABC):
    """A service's logic. It reads no clock, no file and no environment: all it knows comes through
    its boxes.

    A node steps every `period_ns` of simulation time, and at once where a message on one of `wakes`
    has come, or a query.
    """

    name: ClassVar[str]
    period_ns: ClassVar[int | None] = None
    wakes: ClassVar[tuple[Topic[Any], ...]] = ()
    depth: ClassVar[int] = 0
    """Messages of a LATEST topic to keep where that is more than the topic's own depth."""

    _config: ServiceConfig
    world_hash: str = ""
    """The world this node works in; empty before it has one."""
    exit_code: int | None = None
    """Set by a node whose work is done: its process ends with it."""
    hears_from_s: float | None = None
    """Unix time from which on it hears what was sent, before it was there, on topics of which it
    gets every message; None: nothing. It may change at any time.
    """

    @abstractmethod
    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Take in what is new, advance to `now_ns`, put out what is due."""

    def parameters(self) -> Parameters:
        """The configuration with which this node runs."""
        return Parameters(service=self.name, values=self._config.model_dump(mode="json"))

    def waiting_for(self) -> str | None:
        """The one thing this node cannot work without and does not have yet, in words; None: it is
        active.
        """
        return None

    def nominal_rates_hz(self) -> Mapping[str, float | Topic[Any]]:
        """By topic name, the rate at which this node means to put out now, per second of
        simulation; or the topic of which it answers every message. A topic that is not named here
        may be slow.
        """
        return {}

    def close(self) -> None:  # noqa: B027 - most nodes hold nothing
        """Let go of what the node holds. Called once, at the end."""


class ClockNode(Node):
    """The node that makes simulation time pass."""

    speed: float = 1.0
    """Simulated seconds a second to keep to; 0: as fast as possible."""
    paused: bool = False
    """Whether the user has paused the simulation, rather than it waiting for something."""
    interventions: int = 0
    """How often the user has paused, resumed, reset or changed the speed of the simulation."""
    now_ns: int = 0
    """The time it has come to; after a step in which the simulation began anew, earlier than
    before.
    """

    @property
    def resting(self) -> bool:
        """Whether nothing moves, so that nobody misses steps that come several at once."""
        return False

    @abstractmethod
    def next_step_ns(self) -> int | None:
        """The time to which the next step advances; None: time stands still."""


@dataclass
class TopicCounts:
    """What an inbox has seen of one topic. Any thread may read it while others count."""

    received: int = 0
    sent: int = 0
    """Messages that the publishers seen here have sent so far."""
    lost: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    """By reason. Replaced where it changes: who reads it may take their time."""
    last_sequence: dict[str, int] = field(default_factory=dict)

    def take_in(self, source: str, sequence: int) -> None:
        """Count a message of a source by its number there."""
        self.received += 1
        last = self.last_sequence.get(source)
        if last is None:
            self.sent += sequence + 1
            while len(self.last_sequence) >= MAX_SOURCES:
                del self.last_sequence[next(iter(self.last_sequence))]
        elif sequence > last:
            self.sent += sequence - last
            self.lost += sequence - last - 1
        else:
            return
        self.last_sequence[source] = sequence

    def reject(self, reason: str, count: int = 1) -> None:
        """Count messages that were not acted on."""
        self.rejected = self.rejected + Counter({reason: count})


class Inbox:
    """The messages that came for one node since its last step. Any thread may deliver."""

    def __init__(self, node: Node, on_delivery: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._on_delivery = on_delivery
        self._lock = threading.Lock()
        self._queues: dict[str, deque[tuple[object, Envelope]]] = {}
        self.counts: dict[str, TopicCounts] = {}
        self._depths: dict[str, int] = {}
        self._waiting_bytes = 0
        self._kept: HeldMessages[Envelope] = HeldMessages(node.name)
        returned = [topic for topic in owned_by(node.name) if topic.returned]
        for topic in (*read_by(node.name), *returned):
            latest = topic.delivery is Delivery.LATEST
            self._depths[topic.name] = max(topic.depth, node.depth) if latest else MAX_WAITING
            self._queues[topic.name] = deque()
            self.counts[topic.name] = TopicCounts()
        self._requests: dict[str, deque[Request[Any, Any]]] = {
            query.name: deque() for query in asked_of(node.name)
        }
        self._gone: set[str] = set()
        # Time does not pass of itself while nothing moves; see ClockNode.resting.
        self._calls_always = isinstance(node, ClockNode)
        self._waking = [self._queues[topic.name] for topic in node.wakes]
        self._waking_names = frozenset(topic.name for topic in node.wakes)
        self._may_wake = False

    def ask(self, query: Query[Q, A], message: Q, respond: Callable[[A], None]) -> bool:
        """Take in a query, to be answered by `respond`; False: too many wait already.

        Raises KeyError where the table does not name this node as the one to answer it.
        """
        with self._lock:
            waiting = self._requests[query.name]
            if len(waiting) >= MAX_REQUESTS:
                return False
            waiting.append(Request(query, message, respond))
            self._may_wake = True
        self._on_delivery()
        return True

    def asked(self) -> bool:
        """Whether a query waits."""
        return any(self._requests.values())

    def wakes(self) -> bool:
        """Whether a message on one of the node's `wakes` waits, or a query.

        Asked on every step of every node: where nothing has come since it was last answered with
        no, that is known without looking.
        """
        if not self._may_wake:
            return False
        with self._lock:
            self._may_wake = any(self._waking) or self.asked()
            return self._may_wake

    def requests(self, query: Query[Q, A]) -> list[Request[Q, A]]:
        """The queries since the last call, oldest first."""
        queue = self._requests[query.name]
        if not queue:
            return []
        with self._lock:
            waiting = list(queue)
            queue.clear()
        return waiting

    def deliver(self, topic: Topic[M], message: M | bytes, envelope: Envelope) -> None:
        """Take in a message, as an object or as bytes of the wire, decoded when it is read.

        Where too many wait, the oldest of the topic go, and are counted.
        """
        name, source = topic.name, envelope.source
        with self._lock:
            counts, queue = self.counts[name], self._queues[name]
            counts.take_in(source, envelope.sequence)
            queue.append((message, envelope))
            if isinstance(message, bytes):
                self._kept.keep(name, message, envelope)
            self._waiting_bytes += _size(message)
            most, dropped = self._depths[name], 0
            while len(queue) > most or (self._waiting_bytes > MAX_WAITING_BYTES and queue):
                self._waiting_bytes -= _size(queue.popleft()[0])
                dropped += 1
            if dropped and topic.delivery is not Delivery.LATEST:
                counts.reject(QUEUE_FULL, dropped)
            calls = name in self._waking_names
            self._may_wake = self._may_wake or calls
        if calls or self._calls_always:
            self._on_delivery()

    def leave(self, source: str) -> None:
        """Take in that a source of messages has ended. Its last messages may come after that."""
        with self._lock:
            self._gone.add(source)

    def come_back(self, source: str) -> None:
        """Take in that a source of messages is there, as far as it has ever been missed."""
        with self._lock:
            self._gone.discard(source)

    def is_gone(self, source: str) -> bool:
        """Whether a source of messages has ended, or is out of reach."""
        return source in self._gone

    def held(
        self, names: Collection[str], of_the_living: bool = False
    ) -> list[HeldMessage[Envelope]]:
        """The last messages on latched topics of those who have ended, or of everybody."""
        with self._lock:
            gone = self._gone
            return self._kept.said_by(names, lambda source: of_the_living or source in gone)

    def pending(self, topic: Topic[M]) -> bool:
        """Whether a message waits."""
        return bool(self._queues[topic.name])

    def new(self, topic: Topic[M]) -> list[M]:
        """The messages since the last call, oldest first; of a LATEST topic the newest `depth`.

        Raises KeyError where the table does not name this node as a reader.
        """
        return [message for message, _ in self.arrivals(topic)]

    def arrivals(self, topic: Topic[M]) -> list[tuple[M, Envelope]]:
        """As `new()`, each message with its envelope."""
        queue = self._queues[topic.name]
        if not queue:
            return []
        with self._lock:
            waiting = list(queue)
            queue.clear()
            self._waiting_bytes -= sum(_size(raw) for raw, _ in waiting)
        arrivals: list[tuple[M, Envelope]] = []
        for raw, envelope in waiting:
            if isinstance(raw, bytes):
                try:
                    message = wire.decode(topic, raw)
                    wire.validate(topic, message)
                except wire.WireError as error:
                    self.reject(topic, error.reason)
                    continue
            else:
                # The outbox that it comes from has looked through it.
                message = cast("M", raw)
            ours = self._node.world_hash
            if ours and envelope.world_hash and envelope.world_hash != ours:
                if topic.delivery is not Delivery.LATCHED:
                    self.reject(topic, "other world")
                    continue
            arrivals.append((message, envelope))
        return arrivals

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message since the last call, or None."""
        messages = self.new(topic)
        return messages[-1] if messages else None

    def reject(self, topic: Topic[M], reason: str) -> None:
        """Count a message that was not acted on. The reason is a short phrase, one of few."""
        with self._lock:
            self.counts[topic.name].reject(reason)


def _size(message: object) -> int:
    """Bytes of a message that has not been decoded yet."""
    return len(message) if isinstance(message, bytes) else 0


class Outbox:
    """Where a node puts what it has to say."""

    def __init__(
        self, node: Node, send: Callable[[Topic[object], object, Envelope], None], source: str = ""
    ) -> None:
        self._node = node
        self._send = send
        self._source = source or node.name
        self._sequence: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.now_ns = 0

    def put(self, topic: Topic[M], message: M) -> None:
        """Send a message.

        A message that is not finite is counted and goes no further.
        Raises PermissionError where the table does not name this node as an owner.
        """
        if self._node.name not in topic.owners:
            raise PermissionError(f"{self._node.name} may not write {topic.name}")
        try:
            wire.validate(topic, message)
        except wire.WireError as error:
            self.rejected[topic.name, error.reason] += 1
            return
        envelope = Envelope(
            self._source, self._sequence[topic.name], self.now_ns, self._node.world_hash
        )
        self._sequence[topic.name] += 1
        self._send(cast("Topic[object]", topic), message, envelope)

    def sent(self, topic: Topic[M]) -> int:
        """Messages sent on a topic so far."""
        return self._sequence[topic.name]


class Beat:
    """Whole multiples of a period of simulation time."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._next_ns = 0

    def is_due(self, now_ns: int) -> bool:
        """Whether a multiple has been reached since the last one, or the simulation began anew."""
        return not self._next_ns - self._period_ns <= now_ns < self._next_ns

    def due(self, now_ns: int) -> bool:
        """As `is_due()`; asking moves on to the next."""
        if now_ns < self._next_ns - self._period_ns:
            # The simulation began anew.
            self._next_ns = now_ns
        if now_ns < self._next_ns:
            return False
        self._next_ns = (now_ns // self._period_ns + 1) * self._period_ns
        return True


class Trigger:
    """Tells when a node has to step."""

    def __init__(self, node: Node) -> None:
        self._beat = Beat(node.period_ns) if node.period_ns is not None else None

    def due(self, now_ns: int, inbox: Inbox) -> bool:
        """Whether the node has to step at `now_ns`; asking moves a periodic node's next time on."""
        return (self._beat is not None and self._beat.due(now_ns)) or inbox.wakes()

    def is_time(self, now_ns: int) -> bool:
        """Whether the time alone makes the node step at `now_ns`."""
        return self._beat is not None and self._beat.is_due(now_ns)


def random_generator(seed: int, stream: str) -> np.random.Generator:
    """The generator of one named stream of a run's seed, independent of every other stream's."""
    return np.random.default_rng([seed, zlib.crc32(stream.encode())])
