"""Spawner and physics as services of their own on a real router: what is asked is answered soon,
and outlives either.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TypeVar

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.attachment import pack_attachment as packed
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import ask
from mazebot.common.bus.session import open_session
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import (
    DELETE_ENTITY,
    GET_ENTITIES,
    SET_ENTITY_STATE,
    SIMULATION_CONTROL,
    SPAWN_ENTITY,
    WORLD,
    Query,
)
from mazebot.common.messages.wire import encode
from mazebot.common.node.node import Envelope
from mazebot.common.world.marker_picture import draw
from tests.cli.test_app import mazebot
from tests.common.bus.from_outside import wait_until_alive
from tests.common.house import marker, wall, world
from tests.spawner.stage import box

Q = TypeVar("Q")
A = TypeVar("A")

DEADLINE_S = 60.0
FLAGS = {"physics": ("--camera-enabled", "false"), "spawner": ()}


class Stack:
    """A router, and the services that a test starts and ends."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.session: zenoh.Session = open_session(BusConfig(connect=endpoint))
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.numbers = itertools.count()
        self.world_publisher = publish(self.session, WORLD)

    def start(self, name: str) -> None:
        self.processes[name] = subprocess.Popen(
            [sys.executable, "-m", f"mazebot.{name}", *FLAGS[name]],
            env={**os.environ, "MAZEBOT_BUS_CONNECT": self.endpoint},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def end(self, name: str) -> None:
        process = self.processes.pop(name)
        process.send_signal(signal.SIGKILL)
        process.wait(DEADLINE_S)

    def load(self, house: doc.World) -> None:
        envelope = Envelope("ab" * 16, next(self.numbers), 0, house.hash)
        self.world_publisher.put(encode(WORLD, house), attachment=packed(WORLD, envelope))

    def ask(self, query: Query[Q, A], message: Q) -> A:
        return ask(self.session, query, message, DEADLINE_S, start_s=DEADLINE_S)

    def names(self) -> list[str]:
        found = self.ask(GET_ENTITIES, doc.GetEntities())
        return [one.name for one in found.entities]

    def spawn(self, entity: doc.BodyEntity) -> doc.EntityReply:
        return self.ask(SPAWN_ENTITY, doc.SpawnEntity(entity=entity))

    def close(self) -> None:
        for name in list(self.processes):
            self.end(name)
        self.session.close()  # type: ignore[no-untyped-call]


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s, "it never came to be"


@pytest.fixture(scope="module")
def stack() -> Iterator[Stack]:
    with ExitStack() as exits:
        made = Stack(exits.enter_context(running_router()))
        exits.callback(made.close)
        for name in ("physics", "spawner"):
            made.start(name)
        made.load(world([wall(length_m=4.0)], [marker(id=7)]))
        assert wait_until_alive(made.session, "spawner", DEADLINE_S)
        until(lambda: made.names() == ["aruco_7"])
        yield made


def test_requests_are_answered_soon_running_or_paused(stack: Stack) -> None:
    took_s = []
    for number in range(20):
        if number == 10:
            pause = doc.SimulationControl(pause=True)
            assert stack.ask(SIMULATION_CONTROL, pause).error == ""
        began_s = time.perf_counter()
        reply = stack.spawn(box(f"box_{number}", 0.5 * number - 5.0))
        took_s.append(time.perf_counter() - began_s)
        assert reply == doc.EntityReply(
            name=f"box_{number}", position_m=(0.5 * number - 5.0, 2.0, 0.2)
        )
    go_on = doc.SimulationControl(pause=False)
    assert stack.ask(SIMULATION_CONTROL, go_on).error == ""
    for number in range(20):
        gone = doc.DeleteEntity(name=f"box_{number}")
        assert stack.ask(DELETE_ENTITY, gone).error == ""
    assert stack.names() == ["aruco_7"]
    print(f"median {statistics.median(took_s) * 1e3:.1f} ms")  # noqa: T201 - a figure to look at
    assert statistics.median(took_s) < 1.0


def test_what_physics_refuses_is_told_with_the_reason(stack: Stack) -> None:
    reply = stack.spawn(box("in_wall", 0.0).model_copy(update={"position_m": (0.0, 0.0, 0.2)}))
    assert "wall" in reply.error
    assert stack.spawn(box()).error == ""
    state = doc.SetEntityState(name="box", position_m=(0.0, 0.0, 0.2))
    assert "wall" in stack.ask(SET_ENTITY_STATE, state).error
    found = stack.ask(GET_ENTITIES, doc.GetEntities())
    assert [one.position_m for one in found.bodies] == [(1.0, 2.0, 0.2)]
    gone = doc.DeleteEntity(name="box")
    assert stack.ask(DELETE_ENTITY, gone).error == ""


def test_the_command_reaches_a_running_stack(stack: Stack) -> None:
    lines = ("spawn crate --box 0.2 0.2 0.4 --at 1 1", "spawn m --marker 8 --wall wall --offset 1")
    for line in (*lines, "move crate --at -1 1", "remove crate m"):
        done = mazebot(*line.split(), MAZEBOT_BUS_CONNECT=stack.endpoint)
        assert (done.returncode, done.stderr) == (0, ""), line
    assert stack.names() == ["aruco_7"]


def test_things_outlive_the_spawner_and_the_physics(stack: Stack) -> None:
    picture = draw(marker(id=3), 8)
    sha256 = hashlib.sha256(picture).hexdigest()
    textured = box(materials=(doc.Material(name="red", texture_sha256=sha256),))
    assets = {sha256: base64.b64encode(picture).decode()}
    request = doc.SpawnEntity(entity=textured, assets=assets)
    assert stack.ask(SPAWN_ENTITY, request).error == ""
    gone = doc.DeleteEntity(name="aruco_7")
    assert stack.ask(DELETE_ENTITY, gone).error == ""
    stack.end("spawner")
    stack.start("spawner")
    assert stack.names() == ["box"]
    assert stack.ask(SPAWN_ENTITY, request).error == ""
    stack.end("physics")
    stack.start("physics")
    # Not answered by what the physics said before it ended.
    assert stack.spawn(box("other", 3.0)).error == ""
    assert stack.names() == ["box", "other"]
