"""What is done to a stack in which the robot stands: nothing of it ends a service for good."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import time
import urllib.request
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import NavigationResult, SimulationStats, WorldRequest
from mazebot.common.messages.topics import (
    CMD_VEL,
    GOAL_POSE,
    INITIAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD_REQUEST,
    Topic,
)
from mazebot.common.node.node import Envelope
from tests.compose.motion import Witness
from tests.compose.stack import OPEN, SERVICES, Stack, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

START_S = 90.0
BACK_S = 30.0
PAUSE_S = 25.0
"""Longer than a service's watchdog is patient."""


class Person:
    """Somebody at a terminal, who says what they like."""

    def __init__(self, stack: Stack) -> None:
        self.session: zenoh.Session = stack.session(30.0)
        self.stats: list[SimulationStats] = []
        self.results: list[NavigationResult] = []
        self.active = False
        self._heard = [
            subscribe(self.session, SIMULATION_STATS, self._on_stats),
            subscribe(self.session, NAVIGATION_RESULT, self._on_result),
            subscribe(self.session, NAVIGATION_STATUS, self._on_status),
        ]
        said: tuple[Topic[Any], ...] = (
            CMD_VEL, GOAL_POSE, INITIAL_POSE, MAP, TF, TF_STATIC, WORLD_REQUEST,
        )  # fmt: skip
        self._publishers = {topic.name: publish(self.session, topic) for topic in said}
        self._number = 0

    def _on_stats(self, data: bytes, _: Envelope) -> None:
        self.stats.append(wire.decode(SIMULATION_STATS, data))

    def _on_result(self, data: bytes, _: Envelope) -> None:
        self.results.append(wire.decode(NAVIGATION_RESULT, data))

    def _on_status(self, data: bytes, _: Envelope) -> None:
        self.active = wire.decode(NAVIGATION_STATUS, data).navigation_active

    def say(self, topic: Topic[Any], message: Any, source: str = "ab" * 16) -> None:
        """Send a message, whatever it holds."""
        self._number += 1
        attachment = pack_attachment(topic, Envelope(source, self._number, 0, ""))
        self._publishers[topic.name].put(wire.encode(topic, message), attachment=attachment)

    def goal(self, x_m: float, stamp_ns: int) -> None:
        pose = msg.pose_from_se2(SE2(x_m, 0.0, 0.0))
        self.say(GOAL_POSE, msg.PoseStamped(msg.header(stamp_ns, "map"), pose))

    def is_answered(self, stamp_ns: int) -> bool:
        return any(result.goal_stamp_ns == stamp_ns for result in self.results)


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    # Somebody says here what only a service may.
    with stack_of(os.getuid(), OPEN) as stack:
        assert stack.compose("up", "--detach", *SERVICES).returncode == 0
        yield stack


@pytest.fixture(scope="module")
def person(stack: Stack) -> Iterator[Person]:
    person = Person(stack)
    # A tour that has asked for its world, and is over.
    source = uuid.uuid4().hex
    token = person.session.liveliness().declare_token(alive_key("bringup", source))
    person.say(WORLD_REQUEST, WorldRequest(world_name="sim_house_enhanced"), source)
    wait_until(lambda: person.active, START_S, "navigation")
    token.undeclare()  # type: ignore[no-untyped-call]
    person._publishers.pop(WORLD_REQUEST.name).undeclare()
    yield person
    person.session.close()  # type: ignore[no-untyped-call]


def restarts(stack: Stack) -> dict[str, int]:
    return {service: stack.inspect(service)["RestartCount"] for service in SERVICES}


def test_what_nobody_would_send_ends_no_service(stack: Stack, person: Person) -> None:
    before = restarts(stack)
    far = msg.pose_from_se2(SE2(0.0, 0.0, 0.0))
    far.position.x = 1.7e308
    person.say(GOAL_POSE, msg.PoseStamped(msg.header(0, "map"), far))
    pose = msg.PoseWithCovariance(far, np.zeros(36))
    person.say(INITIAL_POSE, msg.PoseWithCovarianceStamped(msg.header(0, "map"), pose))
    back = msg.transform_stamped(0, "base_scan", "base_footprint", np.eye(4))
    many = [msg.transform_stamped(0, "map", f"frame_{i}", np.eye(4)) for i in range(20_000)]
    person.say(TF_STATIC, msg.TFMessage([back]))
    person.say(TF, msg.TFMessage([back]))
    person.say(TF, msg.TFMessage(many))
    cells = np.zeros((5000, 8000), np.int8)
    person.say(MAP, msg.occupancy_grid(0, 0.05, SE2(0.0, 0.0, 0.0), cells))
    person.goal(0.3, 1)
    wait_until(lambda: person.is_answered(1), BACK_S, "the goal after it")
    assert person.results[-1].error_code == 0
    assert restarts(stack) == before


def test_a_flood_of_goals_keeps_nobody_waiting(stack: Stack, person: Person) -> None:
    for number in range(7584):
        person.goal(0.3 if number % 2 else 0.0, 1000 + number)
    wait_until(lambda: person.is_answered(1000 + 7583), 15.0, "the newest goal")
    assert person.active


def test_the_first_of_two_who_command_holds_the_robot(stack: Stack, person: Person) -> None:
    witness = Witness(stack.session())

    def command(linear_m_s: float, turn_rad_s: float, source: str) -> None:
        twist = msg.Twist(msg.Vector3(linear_m_s, 0.0, 0.0), msg.Vector3(0.0, 0.0, turn_rad_s))
        person.say(CMD_VEL, msg.TwistStamped(msg.header(0, ""), twist), source)

    speeds_m_s: list[float] = []
    for number in range(30):
        command(0.0, 0.3, "aa" * 16)
        if number > 2:
            command(0.4, 0.0, "bb" * 16)
        time.sleep(0.05)
        speeds_m_s += [motion.speed_m_s for motion in witness.seen[-1:]]
    witness.close()
    assert max(speeds_m_s) < 0.05


def page_status(stack: Stack) -> int | None:
    """What the server of the live view answers, if it does."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{stack.viewer_port}/", timeout=5.0) as page:
            return int(page.status)
    except OSError:
        return None


def test_unfinished_requests_keep_nobody_from_the_page(stack: Stack) -> None:
    # The recorder may still be starting.
    wait_until(lambda: page_status(stack) == 200, START_S, "the page")
    with contextlib.ExitStack() as stuck:
        for _ in range(200):
            one = stuck.enter_context(socket.create_connection(("127.0.0.1", stack.viewer_port)))
            one.sendall(b"GET / HTTP/1.1\r\n")
        assert page_status(stack) == 200


def all_paused(stack: Stack) -> bool:
    """Whether every service is paused, after one more try."""
    return (
        not stack.compose("pause").returncode
        or not stack.compose("ps", "--status", "running", "--quiet").stdout.strip()
    )


@pytest.mark.timeout(180)
def test_services_that_were_paused_go_on(stack: Stack, person: Person) -> None:
    before = restarts(stack)
    # A busy kernel may refuse to freeze one of them at first.
    wait_until(lambda: all_paused(stack), BACK_S, "a stack that is paused")
    begin_s = time.monotonic()
    wait_until(lambda: time.monotonic() - begin_s > PAUSE_S, PAUSE_S + 5.0, "the pause")
    assert stack.compose("unpause").returncode == 0
    count = len(person.stats)
    wait_until(lambda: len(person.stats) > count + 10, BACK_S, "the simulation")
    person.active = False
    wait_until(lambda: person.active, BACK_S, "navigation")
    assert restarts(stack) == before


@pytest.mark.timeout(180)
def test_a_router_that_hangs_is_started_anew(stack: Stack, person: Person) -> None:
    before = restarts(stack)["router"]
    guard = int(stack.status_of_process("router")["Pid"])
    (router,) = Path(f"/proc/{guard}/task/{guard}/children").read_text().split()
    os.kill(int(router), signal.SIGSTOP)
    wait_until(lambda: restarts(stack)["router"] == before + 1, BACK_S, "another router")
    count = len(person.stats)
    wait_until(lambda: len(person.stats) > count + 5, BACK_S, "the simulation, heard again")


@pytest.mark.timeout(180)
def test_a_world_outlives_who_made_it_and_who_simulated_it(stack: Stack, person: Person) -> None:
    epoch = person.stats[-1].epoch
    stack.kill("worldgen")
    witness = Witness(stack.session())
    killed_s = stack.kill("physics")
    wait_until(lambda: witness.appeared_after("physics", killed_s) is not None, BACK_S, "physics")
    wait_until(lambda: person.stats[-1].epoch > epoch, BACK_S, "another epoch")
    count = len(witness.seen)
    wait_until(lambda: len(witness.seen) > count + 10, BACK_S, "the simulation")
    wait_until(lambda: person.active, BACK_S, "navigation")
    witness.close()
