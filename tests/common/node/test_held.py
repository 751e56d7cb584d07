"""What is latched, after its publisher has ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.handover import Handover
from mazebot.common.bus.session import open_session
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    ASSETS,
    MAP,
    NAVIGATION_STATUS,
    SIMULATION_CHECKPOINT,
    SIMULATION_STATS,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
)
from mazebot.common.node import node
from mazebot.common.node.held import HeldMessage, HeldMessages, newest, wanted_by
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from tests.common.samples import SAMPLES

DEADLINE_S = 10.0


def envelope(source: str, sequence: int = 0) -> Envelope:
    return Envelope(source, sequence, 0, "")


def test_who_begins_asks_for_what_is_said_but_once_and_for_what_it_goes_on_from() -> None:
    assert {WORLD, ASSETS, SIMULATION_STATS} <= set(wanted_by("physics"))
    assert set(wanted_by("worldgen")) == {WORLD_REQUEST, WORLD_STATUS}
    assert NAVIGATION_STATUS not in wanted_by("bringup")


def test_only_what_the_gone_have_said_is_handed_over_and_of_it_the_newest() -> None:
    held: HeldMessages[Envelope] = HeldMessages("navigation")
    held.keep(WORLD.name, b"old", envelope("a"))
    held.keep(WORLD.name, b"new", envelope("a", 1))
    held.keep(WORLD.name, b"other", envelope("b"))
    held.keep(NAVIGATION_STATUS.name, b"status", envelope("a"))
    gone = held.kept_from([WORLD.name, NAVIGATION_STATUS.name, "/none"], {"a"}.__contains__)
    assert [(message.topic, message.data) for message in gone] == [(WORLD, b"new")]


def test_publishers_without_number_leave_no_more_than_there_is_room_for() -> None:
    held: HeldMessages[Envelope] = HeldMessages("navigation")
    for number in range(100):
        held.keep(WORLD.name, b"x", envelope(f"{number}"))
    kept = held.kept_from([WORLD.name], lambda _: True)
    assert [message.envelope.source for message in kept] == [f"{n}" for n in range(84, 100)]


def test_of_what_several_have_kept_each_is_taken_once_and_the_last_publisher_s() -> None:
    world = [
        HeldMessage(WORLD, data, envelope(source), received_ns)
        for data, source, received_ns in ((b"2", "b", 5), (b"1", "a", 3), (b"2", "b", 4))
    ]
    assets = [
        HeldMessage(ASSETS, data, envelope(source), received_ns)
        for data, source, received_ns in ((b"p", "a", 1), (b"q", "b", 2), (b"p", "a", 7))
    ]
    chosen = newest([*world, *assets])
    assert [m.data for m in chosen if m.topic is WORLD] == [b"2"]
    assert sorted(m.data for m in chosen if m.topic is ASSETS) == [b"p", b"q"]


def named(service: str) -> Node:
    class Named(Node):
        name = service

        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            pass

    return Named()


class Process:
    """A service as others know it."""

    def __init__(self, service: str, endpoint: str) -> None:
        self.session = open_session(BusConfig(connect=endpoint), 5.0)
        node = named(service)
        self.inbox = Inbox(node)
        self.bus = Bus(self.session, node, self.inbox)
        self.outbox = self.bus.outbox(node)
        self.bus.watch_sources()
        self.handover = Handover(self.bus, self.inbox)
        self.bus.announce()


@contextmanager
def process(service: str, endpoint: str) -> Iterator[Process]:
    one = Process(service, endpoint)
    try:
        yield one
    finally:
        one.bus.close()


def wait_for(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as endpoint:
        yield endpoint


def test_a_world_outlives_who_made_it(endpoint: str) -> None:
    with process("navigation", endpoint) as reader:
        with process("worldgen", endpoint) as maker:
            maker.outbox.put(WORLD, SAMPLES[WORLD])
            maker.outbox.put(MAP, SAMPLES[MAP])
            wait_for(lambda: reader.inbox.pending(WORLD) and reader.inbox.pending(MAP))
            with process("perception", endpoint) as early:
                early.handover.ask()
                wait_for(lambda: early.inbox.pending(WORLD))
                assert early.inbox.counts[WORLD.name].received == 1
        wait_for(lambda: reader.inbox.held([WORLD.name]))
        with process("physics", endpoint) as late:
            late.handover.ask()
            wait_for(lambda: late.inbox.pending(WORLD))
            assert late.inbox.new(WORLD) == [SAMPLES[WORLD]]
            # And hands it on, where the first reader is gone too.
            assert late.inbox.held([WORLD.name])


def test_who_comes_back_gets_its_own_last_state(endpoint: str) -> None:
    with process("recorder", endpoint) as reader:
        with process("physics", endpoint) as first:
            first.outbox.put(SIMULATION_STATS, SAMPLES[SIMULATION_STATS])
            wait_for(lambda: reader.inbox.pending(SIMULATION_STATS))
        wait_for(lambda: reader.inbox.held([SIMULATION_STATS.name]))
        with process("physics", endpoint) as second:
            second.handover.ask()
            wait_for(lambda: second.inbox.pending(SIMULATION_STATS))
            assert second.inbox.new(SIMULATION_STATS) == [SAMPLES[SIMULATION_STATS]]


def test_what_others_keep_and_do_not_read_is_handed_back(endpoint: str) -> None:
    kept = SAMPLES[SIMULATION_CHECKPOINT]
    newer = kept.model_copy(update={"iterations": kept.iterations + 24})
    with process("spawner", endpoint) as keeper:
        with process("physics", endpoint) as first:
            for message in (kept, newer):
                first.outbox.put(SIMULATION_CHECKPOINT, message)
            # Nothing of it waits to be read.
            wait_for(lambda: len(keeper.inbox.held([SIMULATION_CHECKPOINT.name], True)) == 1)
        wait_for(lambda: keeper.inbox.held([SIMULATION_CHECKPOINT.name]))
        with process("physics", endpoint) as second:
            second.inbox.is_handed_over = False
            second.handover.ask()
            wait_for(lambda: second.inbox.is_handed_over)
            assert second.inbox.new(SIMULATION_CHECKPOINT) == [newer]


def test_what_a_stranger_has_latched_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "STRANGER_NS", 0)
    inbox = Inbox(named("navigation"))
    for source in ("known", "left", "stranger"):
        inbox.deliver(WORLD, wire.encode(WORLD, SAMPLES[WORLD]), Envelope(source, 0, 0, ""))
    inbox.come_back("known")
    inbox.leave("left")
    wait_for(inbox.forget_strangers)
    held = inbox.held([WORLD.name], of_the_living=True)
    assert {message.envelope.source for message in held} == {"known", "left"}
    assert not inbox.forget_strangers()


def test_who_has_asked_twice_is_woken_though_both_answers_come_at_once() -> None:
    inbox = Inbox(named("physics"))
    inbox.is_handed_over = False
    inbox.hand_over()
    inbox.hand_over()
    assert inbox.is_handed_over
    assert inbox.wakes()
    assert not inbox.wakes()


def test_who_has_nothing_to_get_back_does_not_wait(endpoint: str) -> None:
    with process("physics", endpoint) as first:
        first.inbox.is_handed_over = False
        first.handover.ask()
        wait_for(lambda: first.inbox.is_handed_over)
        assert not first.inbox.pending(SIMULATION_CHECKPOINT)


def test_what_a_living_publisher_has_said_is_not_put_back(endpoint: str) -> None:
    world = SAMPLES[WORLD]
    newer = world.model_copy(update={"name": "newer"})
    with process("navigation", endpoint) as reader:
        with process("worldgen", endpoint) as first:
            first.outbox.put(WORLD, world)
            wait_for(lambda: reader.inbox.pending(WORLD))
        wait_for(lambda: reader.inbox.held([WORLD.name]))
        with process("worldgen", endpoint) as second:
            second.outbox.put(WORLD, newer)
            with process("perception", endpoint) as late:
                wait_for(lambda: late.inbox.pending(WORLD))
                late.handover.ask()
                assert [one.name for one in late.inbox.new(WORLD)] == ["newer"]
                assert late.inbox.counts[WORLD.name].received == 1


def test_what_was_lost_on_the_way_is_had_of_another_reader(endpoint: str) -> None:
    with process("navigation", endpoint) as reader, process("perception", endpoint) as other:
        # As if it had come to one of the two alone.
        sent = Envelope("ab" * 16, 0, 0, "")
        reader.inbox.deliver(WORLD, wire.encode(WORLD, SAMPLES[WORLD]), sent)
        other.handover.ask(of_the_living=True)
        wait_for(lambda: other.inbox.pending(WORLD))
        assert not other.inbox.is_gone(sent.source)


def test_of_a_topic_whose_owners_take_turns_only_the_last_publisher_counts() -> None:
    maps = [
        HeldMessage(MAP, data, envelope(source), received_ns)
        for data, source, received_ns in ((b"after", "b", 5), (b"before", "a", 3))
    ]
    assert [message.data for message in newest(maps)] == [b"after"]
