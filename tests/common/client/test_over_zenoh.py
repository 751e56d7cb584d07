"""What a client over Zenoh says of a router that it has lost, and after its end."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mazebot.cli.topics.topic import echo, measure_rate
from mazebot.common.access.grants import OPERATOR
from mazebot.common.access.key_store import KeyStore
from mazebot.common.bus.config import BusConfig
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import Receive, RobotError, UnreachableError, ignore
from mazebot.common.messages.documents import GetEntities, SimulationControl
from mazebot.common.messages.topics import (
    GET_ENTITIES,
    GOAL_POSE,
    SCAN,
    SIMULATION_CONTROL,
    Topic,
)
from mazebot.router.config import RouterConfig
from mazebot.router.router import Router
from tests.common.samples import SAMPLES


class Gate:
    """A router with nobody behind it, and a key that it lets in."""

    def __init__(self, folder: Path) -> None:
        self.store = KeyStore(folder / "keys")
        self.key_file = folder / "copy.key"
        self.router = Router(RouterConfig(listen="tcp/127.0.0.1:0", keys_dir=self.store.folder))
        self.give_key()

    def give_key(self) -> None:
        shutil.copy(self.store.add("bob", OPERATOR), self.key_file)
        self.router.take_new_keys()

    def revoke(self) -> None:
        self.store.revoke("bob")
        self.router.take_new_keys()

    def robot(self) -> ZenohRobot:
        config = BusConfig(connect=self.router.endpoint, key_file=self.key_file)
        return ZenohRobot(config, start_s=0.0)


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    monkeypatch.setattr("mazebot.common.bus.session.PATIENCE_S", 0.5)
    monkeypatch.setattr("mazebot.common.client.service_watch.PATIENCE_S", 0.0)
    gate = Gate(tmp_path)
    yield gate
    gate.router.close()


def test_a_router_without_services_is_no_lost_one(gate: Gate) -> None:
    with gate.robot() as robot:
        assert robot.alive() == {}
        with pytest.raises(RobotError, match=r"^/get_entities: spawner is not running$") as told:
            robot.ask(GET_ENTITIES, GetEntities(), 1.0)
        assert not isinstance(told.value, UnreachableError)


def test_a_key_that_was_revoked_is_told_of(gate: Gate) -> None:
    with gate.robot() as robot:
        assert robot.alive() == {}
        gate.revoke()
        calls: list[Callable[[], object]] = [
            robot.alive,
            lambda: robot.ask(SIMULATION_CONTROL, SimulationControl(), 1.0),
            lambda: robot.publish(GOAL_POSE, SAMPLES[GOAL_POSE]),
        ]
        for call in calls:
            with pytest.raises(UnreachableError, match=r"or refuses the key \S+copy\.key$"):
                call()
        # With another one in its file it goes on.
        gate.give_key()
        robot.publish(GOAL_POSE, SAMPLES[GOAL_POSE])
        with pytest.raises(RobotError, match="physics is not running"):
            robot.ask(SIMULATION_CONTROL, SimulationControl(), 1.0)


@pytest.mark.parametrize("command", [
    lambda endpoint: echo(endpoint, SCAN.name, once=False, timeout_s=60.0, as_json=False),
    lambda endpoint: measure_rate(endpoint, SCAN.name, window_s=60.0, as_json=False),
])  # fmt: skip
def test_who_waits_for_messages_of_a_lost_router_is_told(
    gate: Gate, monkeypatch: pytest.MonkeyPatch, command: Callable[[str], None]
) -> None:
    class Revoked(ZenohRobot):
        def watch(
            self, topics: Iterable[Topic[Any]], receive: Receive = ignore
        ) -> Callable[[], None]:
            if SCAN in topics:
                gate.revoke()
            return super().watch(topics, receive)

    monkeypatch.setattr("mazebot.cli.topics.topic.ZenohRobot", Revoked)
    monkeypatch.setenv("MAZEBOT_BUS_KEY_FILE", str(gate.key_file))
    with pytest.raises(UnreachableError, match="refuses the key"):
        command(gate.router.endpoint)


def test_a_closed_connection_says_so(gate: Gate) -> None:
    robot = gate.robot()
    robot.close()
    calls: list[Callable[[], object]] = [
        robot.alive,
        lambda: robot.wait(0.1),
        lambda: robot.watch((SCAN,)),
        lambda: robot.ask(SIMULATION_CONTROL, SimulationControl(), 1.0),
        lambda: robot.publish(GOAL_POSE, SAMPLES[GOAL_POSE]),
    ]
    for call in calls:
        with pytest.raises(RobotError, match=r"^the connection is closed$"):
            call()
    assert robot.latest(SCAN) is None
