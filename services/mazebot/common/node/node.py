"""The node interface: `step(now_ns, inbox, outbox)`, with typed queues and no I/O."""

from __future__ import annotations

import math
import threading
import time
import zlib
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

import numpy as np

from mazebot.common.config import ServiceConfig, changed_defaults
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Parameters
from mazebot.common.messages.topics import (
    Delivery,
    Query,
    Topic,
    asked_of,
    kept_by,
    owned_by,
    read_by,
)
from mazebot.common.node.held import HeldMessage, HeldMessages

M = TypeVar("M")
Q = TypeVar("Q")
A = TypeVar("A")

MAX_REQUESTS = 1000
"""Queue length of one query of a node; further requests are answered with an error."""
MAX_WAITING = 1000
"""Queue length of one topic of a node; beyond it the oldest messages are dropped."""
STRANGER_NS = 3_000_000_000
"""A publisher is seen alive within this time after its first message."""
LARGE_BYTES = 4 * 1024 * 1024
"""More than a picture or a map has."""
MAX_WAITING_BYTES = 256 * 1024 * 1024
"""Maximum of all topics' queues together, in serialized bytes."""
MAX_SOURCES = 1000
"""Publishers of one topic whose sequence numbers are remembered: the most recent ones."""
QUEUE_FULL = "queue full"


class Envelope(NamedTuple):
    """A message's metadata: its source, its sequence number there, its send time and its world."""

    source: str
    sequence: int
    sent_ns: int
    world_hash: str


class Received(NamedTuple, Generic[M]):
    """A message, its metadata, and its serialized bytes; None if it came as an object."""

    message: M
    envelope: Envelope
    data: bytes | None


@dataclass(frozen=True, eq=False)
class Request(Generic[Q, A]):
    """A pending query. It may be answered once, in this step or a later one."""

    query: Query[Q, A]
    message: Q
    respond: Callable[[A], None]
    """Sends the reply. A reply after the client's timeout is lost."""


class Node(ABC):
    """A service's logic. It reads no clock, no file and no environment: all its input comes through
    its inbox.

    A node steps every `period_ns` of simulation time, and at once when a query or a message on one
    of the `wakes` topics arrives.
    """

    name: ClassVar[str]
    period_ns: ClassVar[int | None] = None
    wakes: ClassVar[tuple[Topic[Any], ...]] = ()
    depth: ClassVar[int] = 0
    """Queue depth for LATEST topics where it is greater than the topic's own depth."""

    live_parameters: ClassVar[tuple[str, ...]] = ()
    """Beginnings of the dotted names of the parameters that a query may change while it runs."""
    parameter_aliases: ClassVar[Mapping[str, str]] = {}
    """Other names of parameters, as Nav2 has them."""

    _config: ServiceConfig
    world_hash: str = ""
    """Hash of the world this node uses; empty before it has one."""
    exit_code: int | None = None
    """Set by a node whose work is done: the process ends with this exit code."""
    hears_from_s: float | None = None
    """Unix time from which on the node accepts EVERY messages that were sent before it started;
    None: it accepts none of them. It may change at any time.
    """

    @abstractmethod
    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process new messages, advance to `now_ns`, publish what is due."""

    @property
    def config(self) -> ServiceConfig:
        """The configuration in force."""
        return self._config

    def prepare(self) -> None:  # noqa: B027 - most nodes have nothing to prepare
        """Load or compile what the node computes with. Called once before the first step where time
        does not wait for a node; elsewhere this happens as the node comes to it.
        """

    def parameters(self) -> Parameters:
        """The configuration of this node."""
        config = self._config
        return Parameters(
            service=self.name,
            values=config.model_dump(mode="json"),
            defaults=changed_defaults(config),
        )

    def waiting_for(self) -> str | None:
        """Description of the required input that this node still lacks; None: it is active."""
        return None

    def warning(self) -> str:
        """What is wrong although the node is active, in one line; empty: nothing."""
        return ""

    def reads(self) -> Collection[Topic[Any]]:
        """The topics that this node makes use of: those of the table, or fewer of them."""
        return read_by(self.name)

    def nominal_rates_hz(self) -> Mapping[str, float | Topic[Any]]:
        """By topic name, the current nominal publishing rate per second of simulation time; or the
        topic whose every message is answered with one. Topics not named here may be slow.
        """
        return {}

    def facts(self) -> Mapping[str, str]:
        """More key-value pairs for /diagnostics: the node's own figures."""
        return {}

    def close(self) -> None:  # noqa: B027 - most nodes hold nothing
        """Release the node's resources. Called once, at the end."""


class ClockNode(Node):
    """The node that advances simulation time."""

    speed: float = 1.0
    """Target speed in simulated seconds a second; 0: as fast as possible."""
    paused: bool = False
    """Whether the user has paused the simulation (it is not waiting for input)."""
    interventions: int = 0
    """How often the user has paused, resumed, reset or changed the speed of the simulation."""
    now_ns: int = 0
    """Current simulation time; it goes backwards in a step that resets the simulation."""

    @property
    def resting(self) -> bool:
        """Whether nothing moves, so that several steps may be run in one batch."""
        return False

    @abstractmethod
    def next_step_ns(self) -> int | None:
        """The time to which the next step advances; None: time does not advance."""


@dataclass
class TopicCounts:
    """Message counts of one topic in an inbox. Any thread may read them while others count."""

    received: int = 0
    sent: int = 0
    """Messages sent so far by the publishers seen here."""
    lost: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    """By reason. Replaced on each change, never modified, so that it can be read without a lock."""
    last_sequence: dict[str, int] = field(default_factory=dict)

    def take_in(self, source: str, sequence: int) -> None:
        """Count a message of a source by its sequence number."""
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
        """Count rejected messages."""
        self.rejected = self.rejected + Counter({reason: count})


class Inbox:
    """The messages received for one node since its last step. Any thread may deliver."""

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
        self.counts |= {topic.name: TopicCounts() for topic in kept_by(node.name)}
        self._requests: dict[str, deque[Request[Any, Any]]] = {
            query.name: deque() for query in asked_of(node.name)
        }
        self._gone: set[str] = set()
        self._present: set[str] = set()
        # Steps are delayed while nothing moves; see ClockNode.resting.
        self._calls_always = isinstance(node, ClockNode)
        self._waking = [self._queues[topic.name] for topic in node.wakes]
        self._waking_names = frozenset(topic.name for topic in node.wakes)
        self.may_wake = False
        """Whether something has arrived that may wake the node: `wakes()` tells."""
        self.has_news = False
        """Whether anything has arrived since this was last set to False."""
        self.took_large = False
        """Whether a message has come of a size that leaves gaps in memory."""
        self._calls_once = False
        self.is_handed_over = True
        """Whether what others keep for this node has been delivered, if anything is kept."""

    def ask(self, query: Query[Q, A], message: Q, respond: Callable[[A], None]) -> bool:
        """Queue a query, to be answered by `respond`; False: the queue is full.

        Raises KeyError where the table does not name this node as the query's owner.
        """
        with self._lock:
            waiting = self._requests[query.name]
            if len(waiting) >= MAX_REQUESTS:
                return False
            waiting.append(Request(query, message, respond))
            self.may_wake = self.has_news = True
        self._on_delivery()
        return True

    def asked(self) -> bool:
        """Whether a query is pending."""
        return any(self._requests.values())

    def wakes(self) -> bool:
        """Whether a query or a message on one of the node's `wakes` topics is queued.

        Called on every step of every node, so a negative answer is cached until something arrives.
        """
        if not self.may_wake:
            return False
        with self._lock:
            called, self._calls_once = self._calls_once, False
            self.may_wake = any(self._waking) or self.asked()
            return self.may_wake or called

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
        """Queue a message, as an object or as serialized bytes, which are decoded when it is read.

        If the queue is full, the oldest messages of the topic are dropped and counted.
        """
        name = topic.name
        calls = name in self._waking_names
        with self._lock:
            queue = self._queues.get(name)
            if queue is None:
                # It is kept for its owner alone.
                if isinstance(message, bytes):
                    self._kept.keep(name, message, envelope)
                return
            if isinstance(message, bytes) and len(message) > LARGE_BYTES:
                self.took_large = True
            queue.append((message, envelope))
            if isinstance(message, bytes):
                self._kept.keep(name, message, envelope)
                self._waiting_bytes += len(message)
            if len(queue) > self._depths[name] or self._waiting_bytes > MAX_WAITING_BYTES:
                self._drop_oldest(topic)
            if calls:
                self.may_wake = True
            self.has_news = True
            # Last, so that who has seen it counted, without the lock, finds it in the queue.
            self.counts[name].take_in(envelope.source, envelope.sequence)
        if calls or self._calls_always:
            self._on_delivery()

    def _drop_oldest(self, topic: Topic[M]) -> None:
        """Make room in the queue of a topic."""
        queue, most, dropped = self._queues[topic.name], self._depths[topic.name], 0
        if not self._waiting_bytes and topic.delivery is Delivery.LATEST:
            # One came, which is all that is too much.
            queue.popleft()
            return
        while len(queue) > most or (self._waiting_bytes > MAX_WAITING_BYTES and queue):
            self._waiting_bytes -= _size(queue.popleft()[0])
            dropped += 1
        if dropped and topic.delivery is not Delivery.LATEST:
            self.counts[topic.name].reject(QUEUE_FULL, dropped)

    def hand_over(self) -> None:
        """What others keep for this node has been delivered."""
        with self._lock:
            # Who asks twice is told twice, perhaps before the node has come to the first.
            self._calls_once |= not self.is_handed_over
            self.may_wake |= self._calls_once
            self.is_handed_over = self.has_news = True
        self._on_delivery()

    def leave(self, source: str) -> None:
        """Mark a message source as gone. Its last messages may still arrive after that."""
        with self._lock:
            self._gone.add(source)
            self._present.discard(source)

    def come_back(self, source: str) -> None:
        """Mark a message source as present, whether or not it was gone."""
        with self._lock:
            self._gone.discard(source)
            self._present.add(source)

    def is_gone(self, source: str) -> bool:
        """Whether a source has ended or cannot be reached."""
        return source in self._gone

    def forget_strangers(self) -> bool:
        """Keep no messages of publishers that were never seen alive; whether there were any."""
        with self._lock:
            known = self._present, self._gone
            return self._kept.forget(
                lambda source: any(source in some for some in known),
                time.time_ns() - STRANGER_NS,
            )

    def held(
        self, names: Collection[str], of_the_living: bool = False
    ) -> list[HeldMessage[Envelope]]:
        """The last messages on these latched topics, of publishers that are gone, or of all."""
        with self._lock:
            gone = self._gone
            return self._kept.kept_from(names, lambda source: of_the_living or source in gone)

    def pending(self, topic: Topic[M]) -> bool:
        """Whether a message is queued."""
        return bool(self._queues[topic.name])

    def new(self, topic: Topic[M]) -> list[M]:
        """The messages since the last call, oldest first; of a LATEST topic the newest `depth`.

        Raises KeyError where the table does not name this node as a reader.
        """
        if not self._queues[topic.name]:
            return []
        return [message for message, _ in self.arrivals(topic)]

    def arrivals(self, topic: Topic[M]) -> list[tuple[M, Envelope]]:
        """As `new()`, each message with its envelope."""
        return [(message, envelope) for message, envelope, _ in self.received(topic)]

    def received(self, topic: Topic[M]) -> list[Received[M]]:
        """As `new()`, each message with its envelope and its bytes."""
        queue = self._queues[topic.name]
        if not queue:
            return []
        with self._lock:
            waiting = list(queue)
            queue.clear()
            if self._waiting_bytes:
                self._waiting_bytes -= sum(_size(raw) for raw, _ in waiting)
        arrivals: list[Received[M]] = []
        for raw, envelope in waiting:
            data: bytes | None = None
            if isinstance(raw, bytes):
                data = raw
                try:
                    message = wire.decode(topic, raw)
                    wire.validate(topic, message)
                except wire.WireError as error:
                    self.reject(topic, error.reason)
                    continue
            else:
                # The sender's outbox has validated it.
                message = cast("M", raw)
            ours, theirs = self._node.world_hash, envelope.world_hash
            if theirs != ours and theirs and ours and topic.delivery is not Delivery.LATCHED:
                self.reject(topic, "other world")
                continue
            arrivals.append(Received(message, envelope, data))
        return arrivals

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message since the last call, or None."""
        messages = self.new(topic)
        return messages[-1] if messages else None

    def refuse(self, service: str, reason: str) -> None:
        """Count a request to a ROS service that was not answered; the reason as in `reject`."""
        with self._lock:
            if service not in self.counts:
                # Replaced, so that it can be read without the lock.
                self.counts = {**self.counts, service: TopicCounts()}
            self.counts[service].reject(reason)

    def reject(self, topic: Topic[M], reason: str) -> None:
        """Count a rejected message. The reason is a short phrase, from a small set."""
        with self._lock:
            self.counts[topic.name].reject(reason)


def _size(message: object) -> int:
    """Bytes of a message that has not been decoded yet."""
    return len(message) if isinstance(message, bytes) else 0


class Outbox:
    """Publishes a node's messages."""

    def __init__(
        self,
        node: Node,
        send: Callable[[Topic[object], object, Envelope], None],
        source: str = "",
        *,
        checks: bool = True,
        is_read: Callable[[Topic[Any]], bool] = lambda _: True,
    ) -> None:
        """`checks`: messages are validated here; `is_read`: whether anybody reads a topic."""
        self._node = node
        self._send = send
        self._source = source or node.name
        self._checks = checks
        self.is_read = is_read
        self._sequence: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.now_ns = 0

    def put(self, topic: Topic[M], message: M) -> None:
        """Send a message.

        An invalid message (such as one with non-finite values) is dropped and counted.
        Raises PermissionError where the table does not name this node as an owner.
        """
        node, name = self._node, topic.name
        if node.name not in topic.owners:
            raise PermissionError(f"{node.name} is not allowed to publish {name}")
        if self._checks:
            try:
                wire.validate(topic, message)
            except wire.WireError as error:
                self.rejected[name, error.reason] += 1
                return
        sequence = self._sequence[name]
        self._sequence[name] = sequence + 1
        envelope = Envelope(self._source, sequence, self.now_ns, node.world_hash)
        self._send(cast("Topic[object]", topic), message, envelope)

    def offer(self, topic: Topic[M], make: Callable[[], M]) -> None:
        """As `put`, of a message that is made and sent only if anybody reads the topic."""
        if self.is_read(topic):
            self.put(topic, make())

    def sent(self, topic: Topic[M]) -> int:
        """Messages sent on a topic so far."""
        return self._sequence[topic.name]


class Beat:
    """A timer at whole multiples of a period of simulation time."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._next_ns = 0

    def is_due(self, now_ns: int) -> bool:
        """Whether the next multiple has been reached, or the simulation was reset."""
        return not self._next_ns - self._period_ns <= now_ns < self._next_ns

    @property
    def rest_ns(self) -> tuple[int, int]:
        """Times from the one to before the other are not due."""
        return self._next_ns - self._period_ns, self._next_ns

    def due(self, now_ns: int) -> bool:
        """As `is_due()`, and move on to the next multiple."""
        next_ns = self._next_ns
        if next_ns - self._period_ns <= now_ns < next_ns:
            return False
        self._next_ns = (now_ns // self._period_ns + 1) * self._period_ns
        return True


class Trigger:
    """Decides when a node has to step."""

    def __init__(self, node: Node) -> None:
        self._beat = Beat(node.period_ns) if node.period_ns is not None else None
        self._rest_ns: tuple[float, float] = (0, 0)
        """The timer is not due from the one to before the other."""
        if self._beat is None:
            self._rest_ns = -math.inf, math.inf

    def due(self, now_ns: int, inbox: Inbox) -> bool:
        """Whether the node has to step at `now_ns`; the call advances a periodic node's timer."""
        start_ns, end_ns = self._rest_ns
        # Asked at every step of physics: most answers are this one.
        if start_ns <= now_ns < end_ns and not inbox.may_wake:
            return False
        beat = self._beat
        if beat is not None and beat.due(now_ns):
            self._rest_ns = beat.rest_ns
            return True
        return inbox.wakes()

    def is_time(self, now_ns: int) -> bool:
        """Whether the node's timer is due at `now_ns`."""
        return self._beat is not None and self._beat.is_due(now_ns)


def random_generator(seed: int, stream: str) -> np.random.Generator:
    """The random generator of a named stream of the run's seed, independent of other streams."""
    return np.random.default_rng([seed, zlib.crc32(stream.encode())])
