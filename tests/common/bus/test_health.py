"""Health by the liveliness token, as Docker asks for it."""

import socket
import subprocess
import sys
import time

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.health import ALIVE_KEY, is_alive
from mazebot.common.bus.liveliness import ALIVE_PREFIX, alive_key
from mazebot.common.bus.session import open_session
from tests.common.bus.from_outside import wait_until_alive


def probe(endpoint: str, *services: str) -> int:
    """The exit code of the probe as a process of its own."""
    command = [sys.executable, "-m", "mazebot.common.bus.health", *services]
    return subprocess.run(
        command,
        env={"MAZEBOT_BUS_CONNECT": endpoint},
        timeout=20,
        check=False,
        stderr=subprocess.DEVNULL,
    ).returncode


def test_both_sides_have_the_same_key() -> None:
    assert ALIVE_KEY == ALIVE_PREFIX


def test_a_service_is_alive_as_long_as_its_token_stands() -> None:
    with running_router() as endpoint:
        session = open_session(BusConfig(connect=endpoint))
        assert wait_until_alive(session, "router", 10.0)
        assert is_alive(endpoint, "router")
        assert not is_alive(endpoint, "physics")
        token = session.liveliness().declare_token(alive_key("physics", "a"))
        assert probe(endpoint, "physics") == 0
        token.undeclare()  # type: ignore[no-untyped-call]
        assert probe(endpoint, "physics") == 1
        session.close()  # type: ignore[no-untyped-call]


def test_nobody_is_alive_without_a_router() -> None:
    assert probe(f"tcp/127.0.0.1:{free_port()}", "router") == 1


def test_a_router_that_hangs_is_not_alive() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        start_s = time.monotonic()
        assert probe(f"tcp/127.0.0.1:{port}", "router") == 1
        assert time.monotonic() - start_s < 10.0


def test_somebody_must_be_named() -> None:
    assert probe("tcp/127.0.0.1:1") == 2
