"""Runs one service in this process against a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from services.cli.replay.comparison import Comparison
from services.cli.replay.replayed import Replayed
from services.cli.replay.seats import (
    CLOCK_SERVICE,
    START_TURNS,
    Feed,
    ReplayedClock,
    ReplayedClockSeat,
    ReplayedSeat,
)
from services.common.bus import wire
from services.common.config import ConfigError
from services.common.node import messages as msg
from services.common.node.executive import LocalSeat, Round
from services.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox
from services.common.node.topics import DIAGNOSTICS, PARAMETERS, ROSOUT, SERVICES, Topic

NOT_COMPARED = (PARAMETERS.name, DIAGNOSTICS.name, ROSOUT.name)
"""They hold folders and wall times, which differ between two runs that are the same."""
_STALLED_TURNS = 10


def replay_through(
    node: Node,
    messages: Iterator[Replayed],
    start_ns: int,
    with_pictures: bool = True,
    watch: Callable[[int], object] = lambda _: None,
) -> Comparison:
    """Give a node the messages of all other services, in the order of a run in lockstep, and
    compare what it sends with its own messages, pictures only if they are as it has sent them.
    `watch` gets the time after each turn.

    Raises ConfigError where a simulation that is replayed does not begin.
    """
    comparison = Comparison()
    feed = Feed(messages, start_ns)

    def is_compared(topic: Topic[Any]) -> bool:
        return topic.name not in NOT_COMPARED and (with_pictures or topic.type is not msg.Image)

    def capture(topic: Topic[object], message: object, envelope: Envelope) -> None:
        if is_compared(topic):
            data = wire.encode(topic, message)
            comparison.take_replayed(topic, envelope.sent_ns, data)

    inbox = Inbox(node)
    own = LocalSeat(node, inbox, Outbox(node, capture))

    def deliver(message: Replayed) -> None:
        if node.name in message.topic.readers:
            inbox.deliver(message.topic, message.data, message.envelope)

    seats = {name: ReplayedSeat(name, feed, deliver) for name in SERVICES if name != node.name}
    clock: ClockNode
    if isinstance(node, ClockNode):
        node.speed = 0.0
        clock = node
    else:
        clock = ReplayedClock(feed)
        seats[CLOCK_SERVICE] = ReplayedClockSeat(clock, feed, deliver)
    outside = ReplayedSeat("", feed, deliver)
    turns = Round(clock)
    turns.now_ns = start_ns
    turns.join(own)
    for seat in seats.values():
        turns.join(seat)

    def hand_out(now_ns: int) -> None:
        for message in feed.until(now_ns):
            if message.service != node.name:
                seats.get(message.service, outside).waiting.append(message)
            elif is_compared(message.topic):
                comparison.take_recorded(message.topic, message.time_ns, message.data)

    still = 0
    while feed.next_ns is not None or feed.turns < START_TURNS:
        feed.turns += 1
        next_ns = clock.next_step_ns()
        hand_out(turns.now_ns if next_ns is None else next_ns)
        moved = turns.turn()
        if outside.due(turns.now_ns):
            outside.step(turns.now_ns)
        still = 0 if moved or feed.turns <= START_TURNS else still + 1
        if still > _STALLED_TURNS:
            raise ConfigError(
                f"replay: {node.name} does not begin: it waits for {node.waiting_for()}"
            )
        watch(turns.now_ns)
    if comparison.missing_at(feed.last_ns):
        # At the end of a run in one process each service takes one more step.
        own.step(feed.last_ns)
    comparison.end()
    return comparison
