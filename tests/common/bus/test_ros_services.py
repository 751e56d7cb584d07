"""Services of ROS 2 on a real router, called by a client that knows the wire alone."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.topics import (
    GET_ENTITIES,
    GET_MODELS,
    SIMULATION_CONTROL,
    SPAWN_ENTITY,
    asked_of,
)
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros.interfaces import interfaces
from mazebot.worldgen.config import WorldgenConfig
from mazebot.worldgen.node import WorldgenNode
from tests.common.bus.ros_client import GID, RefusedError, ask, call
from tests.common.bus.running import Running

GET, SET = (f"simulation_interfaces/srv/{name}SimulationState" for name in ("Get", "Set"))
PAUSED, PLAYING = 2, 1


class Physics(Node):
    """Pauses and resumes, as the real one."""

    name = "physics"
    _config = ServiceConfig()
    paused = False

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for request in inbox.requests(SIMULATION_CONTROL):
            if request.message.pause is not None:
                self.paused = request.message.pause
            stats = doc.SimulationStats(
                world_hash="", sim_time_s=0.0, iterations=0, step_size_s=0.1, paused=self.paused,
                renderer="none", state_hash="",
            )  # fmt: skip
            request.respond(doc.SimulationControlReply(stats=stats))


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


Start = Callable[..., tuple[Running, zenoh.Session, Keys]]


@pytest.fixture
def started(endpoint: str) -> Iterator[Start]:
    """Starts a node; gives it with a client's session and the keys."""
    with contextlib.ExitStack() as stack:

        def start(node: Node, **settings: Any) -> tuple[Running, zenoh.Session, Keys]:
            config = BusConfig(connect=endpoint, **settings)
            running = Running(node, open_session(config, timeout_s=5.0), config.keys)
            stack.callback(running.stop)
            session = open_session(config, timeout_s=5.0)
            stack.callback(session.close)
            return running, session, config.keys

        yield start


@pytest.mark.parametrize("settings", [{}, {"prefix": "bot1", "domain_id": 3, "distro": "lyrical"}])
def test_a_service_is_answered_by_the_query_of_its_node(
    settings: dict[str, Any], started: Start
) -> None:
    node = Physics()
    _, session, keys = started(node, **settings)
    wanted = {"state": {"state": PAUSED}}
    assert call(session, "/get_simulation_state", GET, keys=keys).state.state == PLAYING
    assert call(session, "/set_simulation_state", SET, wanted, keys).result.result == 1
    assert node.paused
    # What is asked twice is not an error of the wire but an answer.
    assert call(session, "/set_simulation_state", SET, wanted, keys).result.result == 101
    assert call(session, "/get_simulation_state", GET, keys=keys).state.state == PAUSED


class Models(Node):
    """Tells of one model."""

    name = "worldgen"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for request in inbox.requests(GET_MODELS):
            request.respond(act.GetModelsReply(names=("table",)))


@pytest.mark.parametrize("distro", ["jazzy", "lyrical"])
def test_both_versions_of_simulation_interfaces_are_answered(distro: str, started: Start) -> None:
    _, session, keys = started(Models(), distro=distro)
    name, kind = "/get_spawnables", "simulation_interfaces/srv/GetSpawnables"
    (old,) = call(session, name, kind, keys=keys, form="kilted").spawnables
    (new,) = call(session, name, kind, keys=keys, form="lyrical").spawnables
    assert old.uri == new.entity_resource.uri == "model://table"


def test_what_is_no_request_is_refused_and_counted(started: Start) -> None:
    running, session, _ = started(Physics())
    attachment = struct.pack("<qqB16s", 1, 0, 16, GID)
    good = interfaces().encode(f"{SET}_Request", {"state": {"state": PAUSED}})
    for payload, attached, reason in (
        (good, None, "no attachment"),
        (good, attachment[:30], "invalid attachment"),
        (b"", attachment, "malformed"),
        (b"\0\1\0", attachment, "malformed"),
        (good + b"\0\0\0\0\0", attachment, "malformed"),
    ):
        with pytest.raises(RefusedError, match=f"^/set_simulation_state: {reason}"):
            ask(session, "/set_simulation_state", SET, payload, attached)
    rejected = running.inbox.counts["/set_simulation_state"].rejected
    assert rejected == {"no attachment": 1, "invalid attachment": 1, "malformed": 3}
    # It still answers.
    assert call(session, "/get_simulation_state", GET).state.state == PLAYING


def test_a_node_that_hangs_refuses_what_it_cannot_keep(started: Start) -> None:
    class Hanging(Physics):
        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            pass

    running, session, _ = started(Hanging())
    for _ in range(1000):
        assert running.inbox.ask(SIMULATION_CONTROL, doc.SimulationControl(), lambda _: None)
    with pytest.raises(RefusedError, match="too many pending requests"):
        call(session, "/get_simulation_state", GET)


def test_a_fault_of_a_handler_is_an_error_of_its_request_alone(
    started: Start, caplog: pytest.LogCaptureFixture
) -> None:
    class Faulty(Physics):
        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            for request in inbox.requests(SIMULATION_CONTROL):
                wrong: Any = None
                request.respond(wrong)

    _, session, _ = started(Faulty())
    for _ in range(2):
        with pytest.raises(RefusedError, match="/get_simulation_state: internal error"):
            call(session, "/get_simulation_state", GET)
    assert "NoneType" in caplog.text


class Spawner(Node):
    """Spawns whatever is asked for."""

    name = "spawner"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for request in inbox.requests(SPAWN_ENTITY):
            request.respond(doc.EntityReply(name=request.message.entity.name))
        for asked in inbox.requests(GET_ENTITIES):
            asked.respond(doc.Entities(world_hash=""))


def test_what_a_service_needs_of_another_one_is_asked_of_it(started: Start) -> None:
    spawn = "simulation_interfaces/srv/SpawnEntity"
    crate = (
        "<sdf version='1.9'><model name='crate'><link name='l'><collision name='c'><geometry>"
        "<box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"
    )
    _, session, _ = started(Spawner())
    with pytest.raises(RefusedError, match="/spawn_entity: no reply: worldgen is not running"):
        call(session, "/spawn_entity", spawn, {"resource_string": crate})
    started(WorldgenNode(WorldgenConfig()))
    answered = call(session, "/spawn_entity", spawn, {"resource_string": crate})
    assert (answered.result.result, answered.entity_name) == (1, "crate")
    answered = call(session, "/spawn_entity", spawn, {"resource_string": "<sdf"})
    assert answered.result.result == 106


def test_the_plain_wire_has_none(started: Start) -> None:
    _, session, keys = started(Physics(), wire="plain")
    assert not list(session.get("**/get_simulation_state/**", timeout=1.0))
    assert asked_of("physics")
    assert keys.wire == "plain"


def test_the_state_of_a_node_is_whether_it_waits(started: Start) -> None:
    class Waiting(Physics):
        missing: str | None = "a world"

        def waiting_for(self) -> str | None:
            return self.missing

    node = Waiting()
    _, session, _ = started(node)
    state = "lifecycle_msgs/srv/GetState"
    assert call(session, "/physics/get_state", state).current_state.label == "inactive"
    node.missing = None
    assert call(session, "/physics/get_state", state).current_state.id == 3
