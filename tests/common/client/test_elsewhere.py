"""What tools say where the stack is in another domain or namespace of the same router."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.cli.topics.publishing import publish_messages
from mazebot.cli.topics.topic import list_topics
from mazebot.commander.navigator import Navigator
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import GraphNode, alive_key
from mazebot.common.bus.session import open_session
from mazebot.common.client.elsewhere import elsewhere
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import GetEntities
from mazebot.common.messages.keys import GraphPlace, Keys
from mazebot.common.messages.topics import GET_ENTITIES, SERVICES

THERE = "one runs in domain 30 (ROS_DOMAIN_ID=30)"


@contextmanager
def stack(endpoint: str, keys: Keys) -> Iterator[None]:
    """The tokens of a stack's services."""
    session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
    nodes = [GraphNode(session, name, keys) for name in SERVICES]
    tokens = [session.liveliness().declare_token(alive_key(one, "1", keys)) for one in SERVICES]
    yield
    for node in nodes:
        node.close()
    del tokens
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    for name in ("ROS_DOMAIN_ID", "MAZEBOT_BUS_PREFIX", "MAZEBOT_BUS_DOMAIN_ID"):
        monkeypatch.delenv(name, raising=False)
    with running_router() as address:
        yield address


def ask(endpoint: str) -> None:
    with ZenohRobot(endpoint, start_s=0.0) as robot:
        robot.ask(GET_ENTITIES, GetEntities(), 1.0)


def wait_until_active(endpoint: str) -> None:
    with Navigator.connect(endpoint) as navigator:
        navigator.waitUntilNav2Active(timeout_s=0.0)


@pytest.mark.parametrize(("command", "keys", "hint"), [
    (ask, Keys(domain_id=30), THERE),
    (wait_until_active, Keys(prefix="bot1/"),
     "one runs in namespace /bot1 (MAZEBOT_BUS_PREFIX=bot1)"),
    (lambda endpoint: publish_messages(endpoint, "/cmd_vel", "{}", 1.0, 1),
     Keys(domain_id=3, prefix="bot1/"),
     "one runs in domain 3 and in namespace /bot1 (ROS_DOMAIN_ID=3 MAZEBOT_BUS_PREFIX=bot1)"),
])  # fmt: skip
def test_an_error_tells_where_the_service_runs(
    endpoint: str, command: Callable[[str], None], keys: Keys, hint: str
) -> None:
    with stack(endpoint, keys), pytest.raises((ConfigError, TimeoutError)) as told:
        command(endpoint)
    assert str(told.value).endswith(f"; {hint}")


def test_a_list_without_topics_tells_where_there_are_some(
    endpoint: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with stack(endpoint, Keys(domain_id=30)):
        list_topics(endpoint, verbose=False, as_json=False)
        assert capsys.readouterr() == ("", f"no stack is running; {THERE}\n")
        monkeypatch.setenv("ROS_DOMAIN_ID", "30")
        list_topics(endpoint, verbose=False, as_json=False)
    assert capsys.readouterr().err == ""


def test_a_service_that_is_here_is_sought_nowhere_else() -> None:
    nodes = [GraphPlace("0", "/physics"), GraphPlace("30", "/physics"), GraphPlace("30", "/rviz")]
    assert elsewhere(nodes, ("physics",), Keys()) == ""
    assert elsewhere(nodes, ("spawner",), Keys()) == ""
    assert elsewhere(nodes[1:], ("physics",), Keys()) == f"; {THERE}"
    wire = "; one runs on the wire rmw_zenoh (MAZEBOT_BUS_WIRE=rmw_zenoh)"
    assert elsewhere(nodes[:1], ("physics",), Keys(wire="plain")) == wire
