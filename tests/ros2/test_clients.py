"""Clients that others wrote, with the Zenoh of ROS 2 Jazzy, beside nodes of ours on our router."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import struct
import subprocess
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import document_types, wire
from mazebot.common.messages import messages as msg
from mazebot.common.messages.keys import DEFAULT_KEYS, types_of
from mazebot.common.messages.topics import (
    CMD_VEL,
    MAP,
    SCAN,
    SERVICES,
    TOPICS,
    WORLD,
    Delivery,
    Topic,
)
from mazebot.common.messages.type_hash import hash_of
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.table import ROS_SERVICES
from tests.common.samples import SAMPLES
from tests.ros2.environment import command, output_of

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(120)]

DEADLINE_S = 60.0


class Quiet(Node):
    """Has the publishers and subscribers of a service, and nothing to do."""

    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Service:
    """A node on the bus."""

    def __init__(self, endpoint: str, name: str) -> None:
        node = type(name.title(), (Quiet,), {"name": name})()
        self.inbox = Inbox(node)
        self.bus = Bus(open_session(BusConfig(connect=endpoint), timeout_s=20.0), node, self.inbox)
        self.bus.watch_sources()
        self.bus.announce()
        self._sent = 0

    def send(self, topic: Topic[Any], message: Any) -> None:
        self.bus.send(topic, message, Envelope(self.bus.source, self._sent, 5, "ab" * 8))
        self._sent += 1


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@pytest.fixture
def service(endpoint: str) -> Iterator[Callable[[str], Service]]:
    """Starts services, which end with the test."""
    with contextlib.ExitStack() as stack:

        def start(name: str) -> Service:
            made = Service(endpoint, name)
            stack.callback(made.bus.close)
            return made

        yield start


@contextlib.contextmanager
def running(script: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A script of others, until the context ends."""
    process = subprocess.Popen(command(script, *arguments), stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"never: {what}"
        time.sleep(0.005)


def host_and_port(endpoint: str) -> tuple[str, str]:
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    return host, port


def quality(topic: Topic[Any]) -> str:
    return {
        Delivery.LATEST: f"2::,{topic.depth}:,:,:,,",
        Delivery.EVERY: "::,100:,:,:,,",
        Delivery.LATCHED: f":1:,{topic.depth}:,:,:,,",
    }[topic.delivery]


def test_the_graph_is_the_table_of_topics(endpoint: str, service: Callable[[str], Service]) -> None:
    for name in SERVICES:
        service(name)
    graph = json.loads(output_of("graph", *host_and_port(endpoint), "0"))
    of_actions = {
        f"{action.name}/_action/{part}": [kind]
        for action in ACTIONS
        for part, kind in (
            ("feedback", f"{action.type}_FeedbackMessage"),
            ("status", "action_msgs/msg/GoalStatusArray"),
        )
    }
    found = {name: types for name, (types, *_) in graph.items() if "/_action/" in name}
    assert found == of_actions
    assert {*graph} - {*found} == {topic.name for topic in TOPICS}
    for topic in TOPICS:
        types, publishers, subscribers = graph[topic.name]
        readers = [name for name in (*topic.readers, *topic.keepers) if name in SERVICES]
        taken = [
            ("/", name, kind, hash_of(kind), quality(topic))
            for name in readers
            for kind in types_of(topic)
        ]
        sent = [
            ("/", name, types_of(topic)[0], hash_of(types_of(topic)[0]), quality(topic))
            for name in topic.owners
            if name in SERVICES
        ]
        assert types == sorted({kind for _, _, kind, *_ in (*taken, *sent)})
        for found, wanted in ((publishers, sent), (subscribers, taken)):
            ends = [(namespace, node, *rest) for node, namespace, *rest in found]
            assert sorted(ends) == sorted(wanted), topic.name


def test_the_services_are_the_tables_of_services_and_actions(
    endpoint: str, service: Callable[[str], Service]
) -> None:
    for name in SERVICES:
        service(name)
    found = json.loads(output_of("graph", *host_and_port(endpoint), "0", "services"))
    wanted = {one.name: [one.type] for one in ROS_SERVICES}
    for action in ACTIONS:
        base = f"{action.name}/_action"
        wanted |= {
            f"{base}/send_goal": [f"{action.type}_SendGoal"],
            f"{base}/get_result": [f"{action.type}_GetResult"],
            f"{base}/cancel_goal": ["action_msgs/srv/CancelGoal"],
        }
    assert found == wanted


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_what_is_latched_reaches_late_subscribers(
    mode: str, endpoint: str, service: Callable[[str], Service]
) -> None:
    worldgen = service("worldgen")
    worldgen.send(MAP, SAMPLES[MAP])
    got = json.loads(output_of("late", endpoint, mode, DEFAULT_KEYS.of_topic(MAP)))
    assert bytes.fromhex(got["payload"]) == wire.encode(MAP, SAMPLES[MAP])
    attachment = bytes.fromhex(got["attachment"])
    # What rmw_zenoh reads is in front.
    assert struct.unpack_from("<qqB16s", attachment) == (
        0, 5, 16, bytes.fromhex(worldgen.bus.source),
    )  # fmt: skip
    assert len(attachment) == 49 + len(MAP.name) == 53


def test_a_document_reaches_a_late_subscriber_of_the_sdk_field_by_field(
    endpoint: str, service: Callable[[str], Service]
) -> None:
    world = SAMPLES[WORLD]
    service("worldgen").send(WORLD, world)
    kind = wire.type_name(WORLD)
    place = (*host_and_port(endpoint), WORLD.name, kind, hash_of(kind), definition_of(kind))
    sent = dataclasses.asdict(document_types.pack(world))
    assert json.loads(output_of("late_document", *place)) == json.loads(
        json.dumps(sent, default=lambda array: array.tolist())
    )


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_what_others_latch_reaches_a_late_service(
    mode: str, endpoint: str, service: Callable[[str], Service]
) -> None:
    gid, data = uuid.uuid4().hex, bytes(wire.encode(MAP, SAMPLES[MAP]))
    with running("latched", endpoint, mode, DEFAULT_KEYS.of_topic(MAP), data.hex(), gid) as other:
        assert line_of(other) == "published"
        localization = service("localization")
        wait_until(lambda: localization.inbox.pending(MAP), "a map")
        ((_, envelope, taken),) = localization.inbox.received(MAP)
        assert taken == data
        # Its wall time is no time of the simulation.
        assert envelope == Envelope(gid, 1, 0, "")


def test_two_peers_of_others_meet_over_our_router(endpoint: str) -> None:
    key = "0/between_peers/std_msgs::msg::dds_::String_/RIHS01_0"
    with running("latched", endpoint, "peer", key, "c0ffee", "ab" * 16) as other:
        assert line_of(other) == "published"
        got = json.loads(output_of("late", endpoint, "peer", key))
    assert got["payload"] == "c0ffee"
    assert len(got["attachment"]) == 2 * 33


def test_pyzeros_gets_every_scan(endpoint: str, service: Callable[[str], Service]) -> None:
    physics, count = service("physics"), 40
    scan = SAMPLES[SCAN]
    with running("scans", endpoint, str(count)) as viewer:
        assert line_of(viewer) == "listening"
        publisher = physics.bus.has_reader
        wait_until(lambda: publisher(SCAN), "a reader")
        for _ in range(count):
            physics.send(SCAN, scan)
            time.sleep(0.01)
        assert isinstance(scan, msg.LaserScan)
        assert [line_of(viewer) for _ in range(count)] == [str(len(scan.ranges))] * count


@pytest.mark.parametrize("kind", ["TwistStamped", "Twist"])
def test_a_velocity_of_pyzeros_arrives_and_its_end_is_seen(
    kind: str, endpoint: str, service: Callable[[str], Service]
) -> None:
    physics = service("physics")
    with running("teleop", endpoint, kind) as teleop:
        gid = line_of(teleop)
        wait_until(lambda: physics.inbox.pending(CMD_VEL), "a velocity")
        command_, envelope = physics.inbox.arrivals(CMD_VEL)[-1]
        assert command_.twist.linear.x == 0.1
        assert envelope.source == gid
        assert not physics.inbox.is_gone(gid)
        teleop.kill()
        wait_until(lambda: physics.inbox.is_gone(gid), "the end of its publisher")


def test_a_publisher_of_another_type_is_told_once(
    endpoint: str, service: Callable[[str], Service], caplog: pytest.LogCaptureFixture
) -> None:
    service("physics")
    session = open_session(BusConfig(connect=endpoint), timeout_s=20.0)
    token = DEFAULT_KEYS.endpoint_token(
        str(session.zid()), 0, 1, "rival", "MP", CMD_VEL, SCAN.type.__msgtype__
    )
    for _ in range(2):
        kept: zenoh.LivelinessToken = session.liveliness().declare_token(token)
        wait_until(lambda: "/rival" in caplog.text, "a warning")
        kept.undeclare()  # type: ignore[no-untyped-call]
    session.close()  # type: ignore[no-untyped-call]
    (told,) = [each.getMessage() for each in caplog.records if "/rival" in each.getMessage()]
    assert told == (
        "/cmd_vel of /rival is not received: sensor_msgs/msg/LaserScan: "
        "must be geometry_msgs/msg/TwistStamped or geometry_msgs/msg/Twist"
    )
