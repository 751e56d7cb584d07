"""What travels between sessions on a real router, whoever of them stalls."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.attachment import pack_attachment, unpack_attachment
from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.connections import stop_lingering
from mazebot.common.bus.liveliness import alive, alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import documents as doc
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import (
    GOAL_POSE,
    NAVIGATION_RESULT,
    PARAMETERS,
    ROSOUT,
    WORLD_REQUEST,
    WORLD_STATUS,
    Topic,
)
from mazebot.common.messages.wire import encode
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from tests.common.samples import SAMPLES

DEADLINE_S = 30.0
SOURCE = "ab" * 16
MAX_GAP_S = 1.0

STRANGER = """
import signal, sys, zenoh
config = zenoh.Config.from_json5(
    '{mode: "client", scouting: {multicast: {enabled: false}}, connect: {timeout_ms: 5000},'
    ' transport: {link: {tx: {lease: 1000}}, shared_memory: {enabled: false}}}'
)
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
subscriber = session.declare_subscriber("**", lambda sample: None)
print("listening", flush=True)
signal.pause()
"""
"""A hand-written script that listens to everything; its lease is short, to see it end soon."""


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@pytest.fixture
def opened(endpoint: str) -> Iterator[Callable[[], zenoh.Session]]:
    """Opens sessions, which end with the test."""
    with contextlib.ExitStack() as stack:

        def open_one() -> zenoh.Session:
            session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
            stack.callback(session.close)
            return session

        yield open_one


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"never: {what}"
        time.sleep(0.01)


class Quiet(Node):
    """Has nothing to do."""

    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Worldgen(Quiet):
    name = "worldgen"


class Recorder(Quiet):
    name = "recorder"


def matched(publisher: Any) -> Callable[[], bool]:
    return lambda: bool(publisher.matching_status.matching)


def test_an_attachment_says_of_which_topic_its_message_is() -> None:
    envelope = Envelope(SOURCE, 3, 5, "0123456789abcdef")
    data = pack_attachment(WORLD_STATUS, envelope)
    assert unpack_attachment(WORLD_STATUS, data) == envelope
    with pytest.raises(ValueError, match="message of another topic"):
        unpack_attachment(WORLD_REQUEST, data)
    for broken in (b"", data[:30], data[: -len(WORLD_STATUS.name)]):
        with pytest.raises(ValueError, match="invalid attachment"):
            unpack_attachment(WORLD_STATUS, broken)


def test_a_message_of_another_topic_is_rejected_and_counted(
    opened: Callable[[], zenoh.Session],
) -> None:
    node, sender = Worldgen(), opened()
    inbox = Inbox(node)
    bus = Bus(opened(), node, inbox)
    request = encode(WORLD_REQUEST, doc.WorldRequest(world_name="maze"))
    publisher = sender.declare_publisher(DEFAULT_KEYS.of_topic(WORLD_REQUEST))
    wait_until(matched(publisher), "a reader")
    envelope = Envelope(SOURCE, 0, 0, "")
    # Both topics carry a document, and some are of one type: nothing else tells them apart.
    publisher.put(request, attachment=pack_attachment(WORLD_STATUS, envelope))
    publisher.put(request, attachment=b"of some other system")
    # A hand-written script sends the bare message.
    publisher.put(request)
    publisher.put(request, attachment=pack_attachment(WORLD_REQUEST, envelope))
    counts = inbox.counts[WORLD_REQUEST.name]
    wait_until(lambda: counts.received == 2, "both good ones")
    assert counts.rejected == {"message of another topic": 1, "invalid attachment": 1}
    assert [request.world_name for request in inbox.new(WORLD_REQUEST)] == ["maze"] * 2
    bus.close()


def test_five_readers_that_freeze_hold_up_nobody(
    endpoint: str, opened: Callable[[], zenoh.Session]
) -> None:
    heard_s: list[float] = []
    last: list[int] = []

    def receive(_: bytes, envelope: Envelope) -> None:
        heard_s.append(time.monotonic())
        last[:] = [envelope.sequence]

    subscription = subscribe(opened(), ROSOUT, receive)
    publisher = publish(opened(), ROSOUT)
    strangers = [
        subprocess.Popen(
            [sys.executable, "-c", STRANGER, endpoint], stdout=subprocess.PIPE, text=True
        )
        for _ in range(5)
    ]
    try:
        for stranger in strangers:
            assert stranger.stdout is not None
            assert stranger.stdout.readline() == "listening\n"
        for stranger in strangers:
            stranger.send_signal(signal.SIGSTOP)
        begin_s, sent, longest_s = time.monotonic(), 0, 0.0
        while time.monotonic() - begin_s < 2.0:
            put_s = time.monotonic()
            # A second of this fills every buffer on the way.
            attachment = pack_attachment(ROSOUT, Envelope(SOURCE, sent, 0, ""))
            publisher.put(bytes(60_000), attachment=attachment)
            sent += 1
            longest_s = max(longest_s, time.monotonic() - put_s)
            time.sleep(0.005)
        assert longest_s < MAX_GAP_S
        wait_until(lambda: last == [sent - 1], f"the last of {sent}")
        gaps_s = [b - a for a, b in itertools.pairwise(heard_s)]
        assert max(gaps_s) < MAX_GAP_S
    finally:
        for stranger in strangers:
            stranger.kill()
            stranger.communicate()
    del subscription


@pytest.mark.parametrize("lossless", [False, True])
def test_what_a_reader_could_not_take_in_comes_later(
    opened: Callable[[], zenoh.Session], lossless: bool
) -> None:
    """Without `lossless` it is sent again; with it, the sender waits."""
    here, there = opened(), opened()
    go_on, got = threading.Event(), list[int]()

    def receive(_: bytes, envelope: Envelope) -> None:
        go_on.wait(DEADLINE_S)
        got.append(envelope.sequence)

    subscription = subscribe(there, NAVIGATION_RESULT, receive)
    ignore: Any = zenoh.handlers.Callback(lambda _: None, indirect=False)
    filling = there.declare_subscriber("filling", ignore)
    publisher, filler = (
        publish(here, NAVIGATION_RESULT, lossless=lossless),
        here.declare_publisher("filling", congestion_control=zenoh.CongestionControl.BLOCK),
    )
    wait_until(matched(filler), "a reader")
    timer = threading.Timer(0.4, go_on.set)
    timer.start()
    for number in range(60):
        attachment = pack_attachment(NAVIGATION_RESULT, Envelope(SOURCE, number, 0, ""))
        publisher.put(bytes(2900 if lossless else 100), attachment=attachment)
        for _ in range(100):
            # Below the size from which Zenoh would pass it on in shared memory.
            filler.put(bytes(2900))
    wait_until(lambda: len(got) >= 60, f"all, beyond {len(got)}")
    assert got == list(range(60))
    del subscription, filling


def test_a_reader_that_starts_gets_nothing_that_was_sent_before(
    opened: Callable[[], zenoh.Session],
) -> None:
    publisher, got = publish(opened(), NAVIGATION_RESULT), list[int]()

    def say(number: int) -> None:
        attachment = pack_attachment(NAVIGATION_RESULT, Envelope(SOURCE, number, 0, ""))
        publisher.put(b"", attachment=attachment)

    for number in range(5):
        say(number)
    began = opened()
    subscription = subscribe(began, NAVIGATION_RESULT, lambda _, said: got.append(said.sequence))
    # Two heartbeats come before it, by which a reader learns what it has missed.
    end_s = time.monotonic() + 2.5
    while time.monotonic() < end_s and not got:
        time.sleep(0.05)
    say(5)
    wait_until(lambda: got[-1:] == [5], "the last")
    assert got == [5]
    del subscription


def test_a_node_hears_what_was_sent_from_the_time_that_it_names(
    opened: Callable[[], zenoh.Session],
) -> None:
    publisher = publish(opened(), NAVIGATION_RESULT)
    place = doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    result = doc.NavigationResult(
        goal=place, goal_stamp_ns=0, error_code=0, start_time_s=0.0, end_time_s=1.0
    )

    def say(number: int) -> None:
        attachment = pack_attachment(NAVIGATION_RESULT, Envelope(SOURCE, number, 0, ""))
        publisher.put(encode(NAVIGATION_RESULT, result), attachment=attachment)

    for number in range(3):
        say(number)
    time.sleep(0.01)
    between_s = time.time()
    for number in range(3, 5):
        say(number)
    reader = Recorder()
    reader.hears_from_s = between_s
    inbox = Inbox(reader)
    bus = Bus(opened(), reader, inbox)
    wait_until(lambda: inbox.counts[NAVIGATION_RESULT.name].received >= 2, "what was sent")
    reader.hears_from_s = None
    say(5)
    wait_until(lambda: inbox.counts[NAVIGATION_RESULT.name].received >= 3, "the last")
    arrivals = inbox.arrivals(NAVIGATION_RESULT)
    assert [envelope.sequence for _, envelope in arrivals] == [3, 4, 5]
    bus.close()


def test_a_bus_goes_on_with_another_session(opened: Callable[[], zenoh.Session]) -> None:
    node, reader = Worldgen(), Recorder()
    inbox, heard = Inbox(node), Inbox(reader)
    bus, hearing = Bus(opened(), node, inbox), Bus(opened(), reader, heard)
    outbox = bus.outbox(node)
    bus.announce()
    outbox.put(PARAMETERS, doc.Parameters(service="worldgen", values={}))
    wait_until(lambda: heard.pending(PARAMETERS), "the first")
    bus.move_to(opened())
    # What came after says that the repeated one has come, and was known.
    outbox.put(PARAMETERS, doc.Parameters(service="worldgen", values={"seed": 1}))
    wait_until(lambda: heard.counts[PARAMETERS.name].received == 2, "the second")
    assert [message.values for message in heard.new(PARAMETERS)] == [{}, {"seed": 1}]
    assert heard.counts[PARAMETERS.name].lost == 0
    # The reader moves as well: it has what is latched, and is not given it again.
    hearing.move_to(opened())
    late = Inbox(reader)
    latecomer = Bus(opened(), reader, late)
    wait_until(lambda: late.pending(PARAMETERS), "what is latched")
    assert [message.values for message in late.new(PARAMETERS)] == [{"seed": 1}]
    assert not heard.pending(PARAMETERS)
    sender = opened()
    request = publish(sender, WORLD_REQUEST)
    request.put(encode(WORLD_REQUEST, doc.WorldRequest(world_name="maze")))
    wait_until(lambda: inbox.counts[WORLD_REQUEST.name].received == 1, "a request")
    del request
    for one in (bus, hearing, latecomer):
        one.close()


def test_what_a_node_has_taken_is_not_given_it_again_by_a_new_session(
    opened: Callable[[], zenoh.Session],
) -> None:
    """What was lost between the two sessions is, and a publisher that is started again is new."""
    sender, reader = opened(), Recorder()
    publisher = publish(sender, GOAL_POSE)
    goal = encode(GOAL_POSE, SAMPLES[GOAL_POSE])

    def say(number: int, source: str = SOURCE) -> None:
        envelope = Envelope(source, number, 0, "")
        publisher.put(goal, attachment=pack_attachment(GOAL_POSE, envelope))

    inbox, session = Inbox(reader), opened()
    bus, counts = Bus(session, reader, inbox), inbox.counts[GOAL_POSE.name]
    alive(session, timeout_s=20.0)
    for number in range(3):
        say(number)
    wait_until(lambda: counts.received == 3, "the first three")
    session.close()  # type: ignore[no-untyped-call]
    say(3)
    bus.move_to(opened())
    # It is asked for with all that is cached, and comes last.
    wait_until(lambda: counts.last_sequence[SOURCE] == 3, "what was lost")
    say(0, "cd" * 16)
    wait_until(lambda: len(counts.last_sequence) == 2, "another source")
    heard = [(said.source, said.sequence) for _, said in inbox.arrivals(GOAL_POSE)]
    assert heard == [*((SOURCE, number) for number in range(4)), ("cd" * 16, 0)]
    bus.close()


def test_a_service_that_nobody_hears_opens_its_session_anew(
    endpoint: str, opened: Callable[[], zenoh.Session]
) -> None:
    session = opened()
    # A recorder is there, and yet no publisher has a reader: so it looks after some reconnects.
    token = session.liveliness().declare_token(alive_key("recorder", SOURCE))
    process = subprocess.Popen(
        [sys.executable, "-m", "mazebot.worldgen"],
        env={**os.environ, "MAZEBOT_BUS_CONNECT": endpoint},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    told: list[Topic[Any]] = []
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if "session reopened" in line:
                break
        else:
            pytest.fail("it never did")
        subscription = subscribe(session, PARAMETERS, lambda *_: told.append(PARAMETERS))
        wait_until(lambda: bool(told), "what it had latched before")
        del subscription
    finally:
        process.kill()
        process.communicate()
    token.undeclare()  # type: ignore[no-untyped-call]


def test_a_session_without_a_router_is_mute_whatever_it_believes() -> None:
    with running_router() as endpoint:
        session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
        node = Worldgen()
        bus = Bus(session, node, Inbox(node))
        bus.announce()
        assert not bus.is_mute()
    wait_until(bus.is_mute, "the loss of the router is noticed")
    bus.close()
    assert not bus.is_mute()


def test_a_connection_whose_reader_takes_nothing_closes_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        reader = socket.create_connection(server.getsockname())
        writer, _ = server.accept()
        writer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        writer.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                writer.send(bytes(65536))
        writer.setblocking(True)
        stop_lingering()
        begin_s = time.monotonic()
        writer.close()
        assert time.monotonic() - begin_s < MAX_GAP_S
        reader.close()
