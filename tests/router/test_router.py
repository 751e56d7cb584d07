"""What the router passes on, and that it may take its time."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive, alive_key
from mazebot.common.bus.session import open_session
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import CAMERA_IMAGE, CMD_VEL
from mazebot.common.messages.wire import MAX_SMALL_MESSAGE_BYTES
from mazebot.router.guard import PERIOD_S
from mazebot.router.process import KEYS_PERIOD_S
from tests.cli.stack.running import wait_until


def processes_of(endpoint: str) -> tuple[int, int]:
    """The guard of a router, and the process that it guards."""
    (guard,) = (
        int(child)
        for children in Path("/proc/self/task").glob("*/children")
        for child in children.read_text().split()
        if endpoint in Path(f"/proc/{child}/cmdline").read_text()
    )
    return guard, int(Path(f"/proc/{guard}/task/{guard}/children").read_text())


@contextmanager
def frozen(process: int, seconds: float) -> Iterator[None]:
    """Beside what is done, a process stands still for some time."""
    os.kill(process, signal.SIGSTOP)
    going_on = threading.Timer(seconds, os.kill, (process, signal.SIGCONT))
    going_on.start()
    try:
        yield
    finally:
        going_on.join()


def test_a_message_that_every_reader_would_refuse_for_its_size_is_not_passed_on() -> None:
    small, large = DEFAULT_KEYS.of_topic(CMD_VEL), DEFAULT_KEYS.of_topic(CAMERA_IMAGE)
    heard: dict[str, list[int]] = {small: [], large: []}
    with running_router() as endpoint:
        config = BusConfig(connect=endpoint)
        with open_session(config) as reader, open_session(config) as writer:

            def hear(sample: zenoh.Sample) -> None:
                heard[str(sample.key_expr)].append(len(sample.payload))

            reader.declare_subscriber(small, hear)
            reader.declare_subscriber(large, hear)
            put = partial(writer.put, congestion_control=zenoh.CongestionControl.BLOCK)
            for size in (MAX_SMALL_MESSAGE_BYTES, 2 * MAX_SMALL_MESSAGE_BYTES, 1):
                for key in (small, large):
                    put(key, bytes(size))
            wait_until(lambda: all(sizes[-1:] == [1] for sizes in heard.values()))
    most = MAX_SMALL_MESSAGE_BYTES
    # Messages of one key keep their order.
    assert heard == {small: [most, 1], large: [most, 2 * most, 1]}


def test_who_is_alive_is_known_also_where_the_router_is_slow() -> None:
    with ExitStack() as closing:
        endpoint = closing.enter_context(running_router())
        config = BusConfig(connect=endpoint)
        session, other = (closing.enter_context(open_session(config)) for _ in range(2))
        token = other.liveliness().declare_token(alive_key("recorder", "one"))
        wait_until(lambda: alive(session).keys() == {"router", "recorder"})
        there = alive(session)
        _, router = processes_of(endpoint)
        with frozen(router, 1.5):
            assert alive(session) == there
        del token


@pytest.mark.parametrize("which", [0, 1], ids=["guard", "router"])
def test_a_router_that_was_frozen_for_a_moment_goes_on(which: int) -> None:
    with running_router() as endpoint:
        processes = processes_of(endpoint)
        # Longer than they wait for signals.
        with frozen(processes[which], 2.0 * max(KEYS_PERIOD_S, PERIOD_S)):
            pass
        with open_session(BusConfig(connect=endpoint)) as session:
            assert alive(session).keys() == {"router"}
        assert processes_of(endpoint) == processes
