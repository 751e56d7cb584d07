"""A run live in Foxglove, by a client of its websocket protocol."""

from __future__ import annotations

import functools
import itertools
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, cast

import pytest
from mcap.reader import make_reader

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import (
    BY_NAME,
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CMD_VEL,
    CMD_VEL_TELEOP,
    GOAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    ODOM,
    QUERIES,
    SCAN,
    TF_STATIC,
    Topic,
    read_by,
)
from mazebot.common.node.executive import Executive
from mazebot.embedded.beside import Beside
from mazebot.embedded.demo import DemoOptions, build_nodes
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.foxglove.layout import layout_text
from mazebot.recorder.foxglove.server import LAYOUT
from mazebot.recorder.node import RecorderNode
from tests.recorder.foxglove_client import FoxgloveClient


class Live:
    """A run that is served."""

    def __init__(self, executive: Executive, beside: Beside, folder: Path) -> None:
        self.executive = executive
        self.robot = beside.robot
        self.folder = folder
        (recorder,) = (node for node in executive.nodes if isinstance(node, RecorderNode))
        assert recorder.foxglove_port is not None
        self.port = recorder.foxglove_port

    def wait(self, holds: Callable[[], Any], timeout_s: float = 60.0) -> None:
        end_s = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < end_s, "it never came to pass"
            time.sleep(0.01)


@contextmanager
def running(folder: Path, **options: Any) -> Iterator[Live]:
    """A run on a thread of its own, that waits for goals."""
    given: dict[str, Any] = {"camera": False, "renderer": "none", "tour": False, **options}
    beside = Beside()
    nodes = build_nodes(DemoOptions(foxglove=True, out_dir=folder, **given), robot=beside.robot)
    executive = Executive(nodes, beside.transport)
    stopped = threading.Event()
    thread = threading.Thread(target=lambda: beside.play(executive, stopped.is_set))
    thread.start()
    try:
        yield Live(executive, beside, folder)
    finally:
        stopped.set()
        thread.join()
        beside.close()
        executive.close()


@pytest.fixture(autouse=True)
def any_port(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_FOXGLOVE_PORT", "0")


def pose(x_m: float, y_m: float) -> bytes:
    """A PoseStamped with a stamp of another clock."""
    message = msg.PoseStamped(
        msg.header(1_700_000_000_000_000_000, "map"), msg.pose_from_se2(SE2(x_m, y_m, 0.0))
    )
    return wire.encode(GOAL_POSE, message)


def test_a_client_sees_what_is_recorded_and_drives_the_robot(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with running(folder, camera=True, renderer="cpu") as live:
        live.wait(lambda: live.robot.latest(MAP) is not None and live.robot.now_ns() > 10**9)
        # It comes late: the latched ones have been sent.
        with FoxgloveClient(live.port) as client:
            wanted: tuple[Topic[Any], ...] = (
                SCAN,
                ODOM,
                MAP,
                TF_STATIC,
                CAMERA_COMPRESSED,
                NAVIGATION_RESULT,
                CMD_VEL,
            )
            client.subscribe(*(topic.name for topic in wanted))
            for topic in wanted[:5]:
                client.wait_for(functools.partial(client.of, topic.name))
            channels = dict(client.channels)
            assert channels.keys() == {topic.name for topic in read_by("recorder")}
            for topic in wanted[:5]:
                for seen in client.of(topic.name):
                    wire.validate(topic, wire.decode(topic, seen.data))
            client.wait_for(lambda: len(client.of(SCAN.name)) > 5)
            ages_ns = [
                one.log_ns - msg.ns_from_time(wire.decode(SCAN, one.data).header.stamp)
                for one in client.of(SCAN.name)
            ]
            assert max(map(abs, ages_ns)) < 200_000_000
            assert client.times_ns == sorted(client.times_ns)
            assert 0 < client.times_ns[-1] <= live.robot.now_ns()
            client.publish(1, GOAL_POSE.name, "geometry_msgs/msg/PoseStamped", pose(0.5, 0.0))
            (result,) = client.wait_for(lambda: client.of(NAVIGATION_RESULT.name))
            assert wire.decode(NAVIGATION_RESULT, result.data).error_code == 0
            assert len(client.of(CMD_VEL.name)) > 20
    with (folder / "run.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            ours = channels[channel.topic]
            assert ours["encoding"] == channel.message_encoding
            assert ours["schemaName"] == schema.name
            assert ours["schemaEncoding"] == schema.encoding
            assert ours["schema"].encode() == schema.data
        assert CAMERA_IMAGE.name not in {one.topic for one in summary.channels.values()}


def test_parameters_and_services(tmp_path: Path) -> None:
    with running(tmp_path / "run") as live, FoxgloveClient(live.port) as client:
        live.wait(lambda: live.robot.now_ns() > 10**9)
        known = client.parameters("all", op="getParameters", parameterNames=[])
        assert known["navigation.controller_server.max_linear_vel"] == 0.46
        assert known["simulation.paused"] is False
        answer = client.parameters(
            "set", op="setParameters", parameters=[{"name": "simulation.paused", "value": True}]
        )
        assert answer == {"simulation.paused": True}
        at_ns = live.robot.now_ns()
        stats = client.call("/simulation/control", step=24)["stats"]
        assert stats["paused"]
        assert live.robot.now_ns() == at_ns + 100_000_000
        client.parameters(
            "no2", op="setParameters", parameters=[{"name": "physics.seed", "value": 12345}]
        )
        client.wait_for(client.complaints)
        assert "physics.seed: is read at start: only simulation.paused" in client.complaints()[-1]
        client.parameters(
            "no3", op="setParameters", parameters=[{"name": "simulation.speed", "value": -1.0}]
        )
        client.wait_for(lambda: len(client.complaints()) > 1)
        assert "simulation.speed" in client.complaints()[-1]
        client.parameters("no4", op="setParameters", parameters=[{"name": "simulation.speed"}])
        client.wait_for(lambda: len(client.complaints()) > 2)
        assert "simulation.speed: None: must be a number" in client.complaints()[-1]
        assert set(client.services) == {query.name for query in QUERIES}
        assert isinstance(client.call("/get_entities")["entities"], list)
        assert "/simulation/control: " in client.call("/simulation/control", step="many")


def test_velocities_of_its_panels_and_what_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running(tmp_path / "run") as live, FoxgloveClient(live.port) as client:
        live.wait(lambda: live.robot.now_ns() > 10**9)
        heard: list[Any] = []
        live.robot.watch((CMD_VEL, CMD_VEL_TELEOP), lambda *one: heard.append(one))
        twist = {"linear": {"x": 0.2}, "angular": {"z": -0.5}}
        for number, (topic, kind, data, encoding) in enumerate(
            (
                (CMD_VEL, "geometry_msgs/Twist", json.dumps(twist).encode(), "json"),
                (CMD_VEL_TELEOP, "geometry_msgs/msg/Twist",
                 bytes(msg.TYPESTORE.serialize_cdr(
                     msg.Twist(msg.Vector3(0.2, 0.0, 0.0), msg.Vector3(0.0, 0.0, -0.5)),
                     "geometry_msgs/msg/Twist")), "cdr"),
            )
        ):  # fmt: skip
            client.publish(number, topic.name, kind, data, encoding)

            def sent(topic: Any = topic) -> list[Any]:
                return [one for one in heard if one[0] is topic and one[2].source == "cli"]

            client.wait_for(sent)
            message = cast("msg.TwistStamped", sent()[0][1])
            assert (message.twist.linear.x, message.twist.angular.z) == (0.2, -0.5)
            assert 0 < msg.ns_from_time(message.header.stamp) <= live.robot.now_ns()
        refused = (
            ("/scan", "sensor_msgs/msg/LaserScan", "cdr", b"", "clients may publish"),
            ("/goal_pose", "geometry_msgs/msg/Pose", "cdr", b"", "must be geometry_msgs/msg/Pose"),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "protobuf", b"", "must be cdr or json"),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "cdr", b"\0\1\0\0x", "is not a valid"),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "json", b'{"a": 1}', "/goal_pose.a: "),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "json", b"{", "is not a valid"),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "json",
             b'{"header": {"frame_id": "\\ud800"}}', "frame_id: '\\ud800': must be"),
            ("/explore/resume", "std_msgs/msg/Bool", "json", b'{"data": "false"}',
             "/explore/resume.data: 'false': must be true or false"),
            ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "json",
             b'{"header": {"stamp": {"sec": 1.5}}}', "stamp.sec: 1.5: must be an integer"),
            ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "json",
             b'{"pose": {"pose": {"position": {"x": true}}}}', "x: True: must be a number"),
            ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "json",
             b'{"pose": {"pose": {"orientation": {"w": 1}}, "covariance": [0.25]}}',
             "/initialpose.pose.covariance: [0.25]: must be a list of 36"),
            # As JavaScript writes a number that is none.
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "json",
             b'{"pose": {"position": {"x": null, "y": -0.9}, "orientation": {"w": 1}}}',
             "/goal_pose.pose.position.x: None: must be a number"),
            ("/goal_pose", "geometry_msgs/msg/PoseStamped", "cdr", pose(float("nan"), 0.0),
             "/goal_pose: "),
        )  # fmt: skip
        for number, (name, kind, encoding, data, said) in enumerate(refused, 10):
            before = len(client.complaints())
            client.publish(number, name, kind, data, encoding)
            client.wait_for(functools.partial(_more_than, client, before))
            assert said in client.complaints()[before]
            assert client.complaints()[before] in caplog.text
        # What navigation refuses is told, too.
        before = len(client.complaints())
        goal = {"header": {"frame_id": "base_link"}, "pose": {"orientation": {"w": 1.0}}}
        client.publish(99, GOAL_POSE.name, "geometry_msgs/msg/PoseStamped",
                       json.dumps(goal).encode(), "json")  # fmt: skip
        client.wait_for(functools.partial(_more_than, client, before))
        assert client.complaints()[before] == (
            "/goal_pose: error 9002: frame_id 'base_link': must be 'map' or empty"
        )
        at_ns = live.robot.now_ns()
        live.wait(lambda: live.robot.now_ns() > at_ns)


def _more_than(client: FoxgloveClient, count: int) -> bool:
    return len(client.complaints()) > count


@pytest.mark.slow
def test_a_client_that_has_stalled_delays_nobody(tmp_path: Path) -> None:
    with running(tmp_path / "run", camera=True, renderer="cpu") as live, ExitStack() as stack:
        live.wait(lambda: live.robot.now_ns() > 10**9)
        clients = [stack.enter_context(FoxgloveClient(live.port)) for _ in range(4)]
        stalled = stack.enter_context(FoxgloveClient(live.port, reads_on=False))
        # Raw images fill its connection in a second.
        stalled.subscribe(*(topic.name for topic in read_by("recorder")))
        for client in clients:
            client.subscribe(SCAN.name, CMD_VEL.name, NAVIGATION_RESULT.name)
        clients[0].publish(1, GOAL_POSE.name, "geometry_msgs/msg/PoseStamped", pose(0.5, -0.9))
        for client in clients:
            client.wait_for(functools.partial(client.of, NAVIGATION_RESULT.name))
            assert len(client.of(CMD_VEL.name)) > 60
            for topic in (SCAN, CMD_VEL):
                times_ns = [one.log_ns for one in client.of(topic.name)]
                periods_ns = {b - a for a, b in itertools.pairwise(times_ns)}
                period_ns = round(1e9 / (topic.rate_hz or 0.0))
                # Nothing is lost or late: a period is a whole number of physics' steps.
                assert all(abs(one - period_ns) < 5_000_000 for one in periods_ns), topic.name
        # It is connected, and has missed much.
        stalled.wait_for(lambda: stalled.of(CMD_VEL.name))


def test_nobody_else_pays_and_a_port_in_use_is_told(tmp_path: Path) -> None:
    config = RecorderConfig(recordings_dir=tmp_path, foxglove=True, foxglove_port=0)
    node = RecorderNode(config)
    try:
        assert node.foxglove_port
        with FoxgloveClient(node.foxglove_port) as client:
            client.wait_for(lambda: client.channels)
            # Without a robot there is nothing to ask for.
            capabilities = client.said[0]["capabilities"]
            assert {"time", "parameters"} <= set(capabilities)
            assert not {"clientPublish", "services"} & set(capabilities)
        used = config.model_copy(update={"foxglove_port": node.foxglove_port})
        with pytest.raises(ConfigError) as error:
            RecorderNode(used)
        assert f"foxglove_port: port {node.foxglove_port} on 127.0.0.1" in str(error.value)
        assert "\n" not in str(error.value)
    finally:
        node.close()
    assert RecorderConfig().foxglove is False
    assert RecorderConfig().foxglove_bind == "127.0.0.1"


def test_the_layout_is_current_and_names_topics_that_there_are() -> None:
    text = LAYOUT.read_text()
    assert text == layout_text(), "make generate"
    named = {word for word in json.dumps(json.loads(text)).split('"') if word.startswith("/")}
    known = BY_NAME.keys() | {query.name for query in QUERIES}
    assert len(named) > 10
    assert {name.partition(".")[0] for name in named} <= known
