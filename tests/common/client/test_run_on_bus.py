"""What a run in one process sends to the bus."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from typing import Any, cast

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribed
from mazebot.common.client.run_on_bus import Receive, RunOnBus
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import wire
from mazebot.common.messages.topics import WORLD_STATUS, Topic
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from tests.common.samples import SAMPLES


class Worldgen(Node):
    name = "worldgen"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Run:
    """A run that sends what the test has it send."""

    def __init__(self, node: Node) -> None:
        self.inboxes: Mapping[str, Inbox] = {node.name: Inbox(node)}

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive) -> Callable[[], None]:
        assert WORLD_STATUS in topics
        self.send = receive
        return lambda: None

    def take_in(self, topic: Topic[Any], data: bytes, envelope: Envelope) -> None:
        raise AssertionError(topic)


def test_a_message_that_cannot_be_written_down_is_told_and_the_next_one_is_sent(
    caplog: pytest.LogCaptureFixture,
) -> None:
    node = Worldgen()
    run = Run(node)
    got: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with (
        running_router() as endpoint,
        open_session(BusConfig(connect=endpoint), 5.0) as ours,
        open_session(BusConfig(connect=endpoint), 5.0) as theirs,
        subscribed(theirs, WORLD_STATUS, lambda data, _: got.put(data)),
        closing(RunOnBus(ours, [node], run)),
    ):
        for sequence, message in enumerate((cast("Any", object()), SAMPLES[WORLD_STATUS])):
            run.send(WORLD_STATUS, message, Envelope(node.name, sequence, 0, ""))
        assert got.get(timeout=30.0) == wire.encode(WORLD_STATUS, SAMPLES[WORLD_STATUS])
    (line,) = caplog.messages
    assert line.startswith("/world/status of worldgen is not sent: wrong type")
