"""Nodes of ROS 2 with rclpy and Fast DDS, in containers of their own, beside `ros2-bridge`."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from mazebot.common.bus.attachment import unpack_ros_attachment
from mazebot.common.bus.subscriber import subscribe_samples
from mazebot.common.files.root import ROOT
from mazebot.common.messages import wire
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.topics import (
    CAMERA_IMAGE,
    CMD_VEL,
    JOINT_STATES,
    MAP,
    ODOM,
    ROBOT_DESCRIPTION,
    SCAN,
    SERVICES,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Delivery,
    Topic,
)
from mazebot.common.world.map_files import read_map
from tests.compose.motion import Witness
from tests.compose.stack import Stack, docker, stack_of, wait_until

pytestmark = pytest.mark.compose

Measured = Callable[[str, float], None]

SCRIPTS = Path(__file__).with_name("scripts")
EXAMPLES = ROOT / "examples" / "ros2"
IMAGE = "mazebot-ros2"
DOMAIN = 71
KEYS = Keys(domain_id=DOMAIN)
HEARD = (
    SCAN, ODOM, TF, JOINT_STATES, CAMERA_IMAGE, MAP, TF_STATIC, ROBOT_DESCRIPTION, WORLD,
    SIMULATION_STATS,
)  # fmt: skip


@pytest.fixture(scope="module")
def stack(person: int, image: str, bridge_image: str) -> Iterator[Stack]:
    """A simulator with our navigation, which drives no tour."""
    with stack_of(person, {"ROS_DOMAIN_ID": str(DOMAIN)}) as stack:
        names = ("simulator-enhanced", "localization", "navigation", "ros2-bridge")
        started = stack.compose("up", "--detach", *names)
        assert started.returncode == 0, started.stdout
        active = "[localization]: active", "[navigation]: active"
        for line in active:
            service = line[1:].partition("]")[0]
            wait_until(lambda: line in stack.logs(service), 60.0, line)  # noqa: B023
        yield stack


@contextlib.contextmanager
def subscribed_to(
    stack: Stack, topic: Topic[Any], on_sample: Callable[[zenoh.Sample], None]
) -> Iterator[None]:
    """Listens to a topic on the bus."""
    session = stack.session()
    key = KEYS.of_topic(topic)
    subscriber = subscribe_samples(session, key, topic.delivery, topic.depth, on_sample)
    try:
        yield
    finally:
        subscriber.undeclare()
        session.close()  # type: ignore[no-untyped-call]


def container_of(script: str) -> str:
    """The container in which a script runs."""
    return f"mazebot-test-{os.getpid()}-{script}"


def started(script: Path, *arguments: str) -> subprocess.Popen[str]:
    """A node in a container that sees the machine's network, as ROS 2's own images are used."""
    return subprocess.Popen(
        [
            "docker", "run", "--rm", "--network", "host", "--name", container_of(script.stem),
            "--env", f"ROS_DOMAIN_ID={DOMAIN}", "--volume", f"{script.parent}:/scripts:ro",
            IMAGE, "python", f"/scripts/{script.name}", *arguments,
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


def said(process: subprocess.Popen[str], timeout_s: float = 120.0) -> str:
    """What it has printed when it has ended well."""
    output, errors = process.communicate(timeout=timeout_s)
    assert process.returncode == 0, errors
    return output


def test_the_example_drives_to_a_place(stack: Stack) -> None:
    goal_m = (0.4, -0.8)
    places: list[Any] = []

    def on_sample(sample: zenoh.Sample) -> None:
        places.append(wire.decode(ODOM, sample.payload.to_bytes()).pose.pose.position)

    with subscribed_to(stack, ODOM, on_sample):
        assert said(started(EXAMPLES / "drive_rclpy.py", *map(str, goal_m))) == "there\n"
        count = len(places)
        wait_until(lambda: len(places) > count, 10.0, "odometry")
    assert math.dist(goal_m, (places[-1].x, places[-1].y)) < 0.06


@pytest.fixture(scope="module")
def commanded(stack: Stack) -> dict[str, Any]:
    """What a node has found that has asked for everything."""
    try:
        found: dict[str, Any] = json.loads(said(started(SCRIPTS / "commands.py"), 180.0))
    finally:
        # Shown where a test fails.
        for service in ("navigation", "localization", "physics"):
            sys.stdout.write(stack.logs(service))
    return found


def test_services_answer(stack: Stack, commanded: dict[str, Any]) -> None:
    # Nothing makes a pose graph here.
    assert commanded["saved"] == [True, 0, 255]
    files = {file.stem: file for file in stack.recordings.glob("*/saved_maps/*.yaml")}
    assert files.keys() == {"kitchen", "office"}
    assert read_map(files["kitchen"]).cells.size > 1000
    assert "ClearEntireCostmap_Response" in commanded["cleared"]
    crate, post, (refused, reason) = commanded["spawned"]
    assert crate == post == [1, ""]
    assert refused not in (0, 1)
    assert "must contain a body" in reason
    assert {"crate", "post"} <= set(commanded["entities"])
    assert "arm" not in commanded["entities"]
    assert commanded["states"] == [1, 1]
    *stats, world_hash = commanded["stats"]
    assert stats == [1, False, 1.0]
    assert len(world_hash) == 16


def test_a_parameter_is_set_and_refused_with_its_range(commanded: dict[str, Any]) -> None:
    (refused, reason), taken = commanded["set"]
    assert not refused
    assert "must be greater than 0" in reason
    assert taken == [True, ""]
    assert commanded["got"] == [0.3]


def test_a_goal_is_canceled_reached_and_refused_with_its_code(commanded: dict[str, Any]) -> None:
    canceled, reached, outside = (commanded[name] for name in ("canceled", "reached", "outside"))
    assert (canceled["canceling"], canceled["status"], canceled["code"]) == (0, 5, 9012)
    assert (reached["status"], reached["code"]) == (4, 0)
    assert len(reached["distances"]) > 5
    assert reached["distances"][-1] < reached["distances"][0]
    assert (outside["accepted"], outside["status"], outside["code"]) == (True, 6, 204)
    assert "outside the map" in outside["message"]


def test_each_service_is_a_node(commanded: dict[str, Any]) -> None:
    absent = {"mapping", "explorer", "bringup"}
    assert {*commanded["nodes"]} >= {*SERVICES, "ros2_bridge"} - absent


def test_what_a_node_hears_is_what_was_sent_byte_for_byte(stack: Stack) -> None:
    sent: dict[str, list[str]] = {topic.name: [] for topic in HEARD}

    def keeper(name: str) -> Callable[[zenoh.Sample], None]:
        def keep(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            # DDS fills up to a whole number of words.
            padded = data + bytes(-len(data) % 4)
            sent[name].append(padded[:16].hex() + hashlib.sha256(padded).hexdigest())

        return keep

    with contextlib.ExitStack() as kept:
        for topic in HEARD:
            kept.enter_context(subscribed_to(stack, topic, keeper(topic.name)))
        listener = started(SCRIPTS / "listen.py", "6", *sent)
        assert listener.stdout is not None
        assert listener.stdout.readline() == "all\n", listener.communicate()[1]
        first = {name: len(all_) for name, all_ in sent.items()}
        assert listener.stdout.readline() == "end\n", listener.communicate()[1]
        last = {name: len(all_) for name, all_ in sent.items()}
        heard: dict[str, list[str]] = json.loads(said(listener))
    for topic in HEARD:
        name = topic.name
        # The one that listens on the bus may miss some as well, where old ones are dropped.
        unseen = {*heard[name]} - {*sent[name]}
        most = 0.0 if topic.delivery is Delivery.LATCHED else 0.05 * len(heard[name])
        assert len(unseen) <= most, name
        # The first bytes have the stamp: what was seen with it must be the same.
        stamps = {one[:32] for one in sent[name]}
        assert not any(one[:32] in stamps for one in unseen), name
        # What was sent after all had come once; the node goes on to listen after that time.
        window = sent[name][first[name] : last[name]]
        missed = {*window} - {*heard[name]}
        assert topic.delivery is Delivery.LATCHED or len(window) > 30, name
        assert len(missed) <= 0.05 * len(window), name


@pytest.mark.parametrize("kind", ["TwistStamped", "Twist"])
def test_the_robot_stops_when_the_node_that_drives_it_is_killed(
    stack: Stack, kind: str, measured: Measured
) -> None:
    witness = Witness(stack.session(), KEYS)
    process = started(SCRIPTS / "teleop.py", kind, "-0.1")
    try:
        wait_until(
            lambda: bool(witness.seen) and witness.seen[-1].speed_m_s > 0.08, 60.0, "it drives"
        )
        pid = docker("inspect", "--format", "{{.State.Pid}}", container_of("teleop"))
        os.kill(int(pid.stdout), signal.SIGKILL)
        killed_s = time.monotonic()
        wait_until(lambda: witness.rest_after(killed_s) is not None, 5.0, "it stands")
        rest_s = witness.rest_after(killed_s)
        assert rest_s is not None
        measured(f"at rest after a node with {kind} was killed", rest_s - killed_s)
        # 0.2 s after its last velocity; other tests may run beside it.
        assert rest_s - killed_s < 1.0
    finally:
        process.communicate(timeout=30)
        witness.close()


def test_a_velocity_comes_to_the_bus_once(stack: Stack) -> None:
    numbers: list[tuple[bytes, int]] = []

    def on_sample(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        attachment = sample.attachment.to_bytes()
        # Those of Mazebot's own services are longer.
        if len(attachment) == 33:
            number, gid = unpack_ros_attachment(attachment)
            numbers.append((gid, number))

    with subscribed_to(stack, CMD_VEL, on_sample):
        process = started(SCRIPTS / "teleop.py", "TwistStamped", "0.0")
        wait_until(lambda: len(numbers) > 60, 60.0, "velocities")
        docker("kill", container_of("teleop"))
        process.communicate(timeout=30)
    assert len({gid for gid, _ in numbers}) == 1, numbers
    # Of a velocity only the latest counts: a busy machine may drop one, and nobody sends any twice.
    found = [number for _, number in numbers]
    assert found == sorted(set(found))
    assert len(found) > 0.9 * (found[-1] - found[0])
