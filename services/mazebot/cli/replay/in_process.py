"""Runs one service in this process against a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from mazebot.cli.replay.comparison import Comparison
from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.cli.replay.seats import Feed, ReplayRound
from mazebot.common.config import ConfigError
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import DIAGNOSTICS, PARAMETERS, ROSOUT, TOPICS, Topic
from mazebot.common.node.executive import LocalSeat
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox

NOT_COMPARED = (
    PARAMETERS.name, DIAGNOSTICS.name, ROSOUT.name,
    # What others only keep for its owner is not recorded.
    *(topic.name for topic in TOPICS if topic.keepers),
)  # fmt: skip
"""They hold folders and wall times, which differ between two runs that are the same."""
_STALLED_TURNS = 10


def replay_through(
    node: Node,
    messages: Iterator[Replayed],
    start_ns: int,
    from_ns: int = 0,
    with_pictures: bool = True,
    watch: Callable[[int], object] = lambda _: None,
) -> Comparison:
    """Give a node the messages of all other services, in the order of a run in lockstep, and
    compare what it sends with its own messages: those from `from_ns` on, pictures only if they are
    as it has sent them.
    `watch` gets the time after each turn.

    Raises ConfigError where a simulation that is replayed does not begin.
    """
    comparison = Comparison()
    feed = Feed(messages, start_ns)

    def is_compared(topic: Topic[Any]) -> bool:
        return topic.name not in NOT_COMPARED and (with_pictures or topic.type is not msg.Image)

    def capture(topic: Topic[object], message: object, envelope: Envelope) -> None:
        if is_compared(topic) and envelope.sent_ns >= from_ns:
            data = wire.encode(topic, message)
            comparison.take_replayed(topic, envelope.sent_ns, data)

    inbox = Inbox(node)
    own = LocalSeat(node, inbox, Outbox(node, capture))

    def deliver(message: Replayed) -> None:
        if node.name in message.topic.readers:
            inbox.deliver(message.topic, message.data, message.envelope)

    def keep(message: Replayed) -> None:
        begun = message.time_ns >= from_ns and not message.is_repeated
        if begun and is_compared(message.topic):
            comparison.take_recorded(message.topic, message.time_ns, message.data)

    if isinstance(node, ClockNode):
        node.speed = 0.0
    clock = node if isinstance(node, ClockNode) else None
    turns = ReplayRound(feed, {node.name: own}, deliver, keep, clock)
    still = 0
    while not turns.ended:
        still = 0 if turns.turn() else still + 1
        if still > _STALLED_TURNS:
            raise ConfigError(
                f"replay: {node.name} does not start: it is waiting for {node.waiting_for()}"
            )
        watch(turns.now_ns)
    if comparison.missing_at(feed.last_ns):
        # At the end of a run in one process each service takes one more step.
        own.step(feed.last_ns)
    comparison.end()
    comparison.rejected = {
        (topic, reason): count
        for topic, counts in sorted(inbox.counts.items())
        for reason, count in sorted(counts.rejected.items())
    }
    return comparison
