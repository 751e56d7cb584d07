"""A recorded run on the bus: what is sent, as whom and when, and services that take part in it."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.cli.replay.sender import Sender
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CLOCK,
    CMD_VEL,
    ODOM,
    SCAN,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope
from tests.cli.replay import runs
from tests.cli.test_app import mazebot

DEADLINE_S = 60.0
_HEARD: tuple[Topic[Any], ...] = (CLOCK, SCAN, ODOM, CMD_VEL, AMCL_POSE, WORLD, TF_STATIC)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@contextlib.contextmanager
def heard(endpoint: str) -> Iterator[list[tuple[str, bytes, Envelope]]]:
    """The messages on the bus while the context lasts, in order of arrival."""
    session = open_session(BusConfig(connect=endpoint))
    got: list[tuple[str, bytes, Envelope]] = []

    def receiver(name: str) -> Callable[[bytes, Envelope], None]:
        return lambda data, envelope: got.append((name, data, envelope))

    kept = [subscribe(session, topic, receiver(topic.name)) for topic in _HEARD]
    try:
        yield got
    finally:
        for one in kept:
            one.undeclare()
        session.close()  # type: ignore[no-untyped-call]


def wait_for(is_so: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def process_of(*arguments: str, endpoint: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", *arguments],
        env={**os.environ, "MAZEBOT_BUS_CONNECT": endpoint, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@contextlib.contextmanager
def service(name: str, endpoint: str, pace: str) -> Iterator[None]:
    process = process_of(f"mazebot.{name}", endpoint=endpoint, MAZEBOT_BUS_PACE=pace)
    try:
        yield
    finally:
        process.terminate()
        process.communicate(timeout=DEADLINE_S)


def test_a_run_is_sent_byte_by_byte_as_its_services_did(run_folder: Path, endpoint: str) -> None:
    recorded = [one for one in runs.messages_of(run_folder) if one.topic in _HEARD]
    with heard(endpoint) as got:
        done = mazebot("replay", str(run_folder), "--connect", endpoint, "--speed", "4")
        assert (done.returncode, done.stderr) == (0, "")
        wait_for(lambda: len(got) >= len(recorded))
    assert f"replaying {run_folder.name} on {endpoint}" in done.stdout
    was = sorted((one.topic.name, one.time_ns, one.data) for one in recorded)
    assert sorted((name, envelope.sent_ns, data) for name, data, envelope in got) == was
    sources = {name: {envelope.source for n, _, envelope in got if n == name} for name, _, _ in got}
    assert all(len(each) == 1 for each in sources.values())
    assert sources["/odom"] == sources["/scan"] != sources["/cmd_vel"]
    numbers = [envelope.sequence for name, _, envelope in got if name == "/odom"]
    assert numbers == list(range(len(numbers)))
    # What is latched is there before the first instant is over, and the clock ends each instant.
    first_clock = next(index for index, (name, _, _) in enumerate(got) if name == "/clock")
    assert {"/world", "/tf_static"} <= {name for name, _, _ in got[:first_clock]}
    now_ns = 0
    for name, _, envelope in got:
        assert envelope.sent_ns >= now_ns
        now_ns = envelope.sent_ns if name == "/clock" else now_ns
    worlds = {envelope.world_hash for name, _, envelope in got if name == "/odom"}
    assert worlds == {json.loads((run_folder / "summary.json").read_text())["world_hash"]}


def test_services_and_topics_are_left_out_but_never_the_clock(
    run_folder: Path, endpoint: str
) -> None:
    fast = ("--speed", "0", "--connect", endpoint)
    with heard(endpoint) as got:
        mazebot("replay", str(run_folder), "--only", "/cmd_vel,/world", *fast)
        wait_for(lambda: any(name == "/cmd_vel" for name, _, _ in got))
    assert {name for name, _, _ in got} <= {"/clock", "/cmd_vel", "/world"}
    with heard(endpoint) as got:
        mazebot("replay", str(run_folder), "--without", "cli", "--start", "1", *fast)
        wait_for(lambda: any(name == "/world" for name, _, _ in got))
    assert min(envelope.sent_ns for _, _, envelope in got) == 1_000_000_000


def test_time_passes_as_recorded_at_the_speed_that_is_wanted(
    run_folder: Path, endpoint: str
) -> None:
    start_s = time.monotonic()
    part = ("--duration", "1", "--speed", "2", "--connect", endpoint)
    assert mazebot("replay", str(run_folder), *part).returncode == 0
    assert time.monotonic() - start_s >= 0.5


def test_a_router_with_a_simulation_or_a_service_of_the_run_is_refused(
    run_folder: Path, endpoint: str
) -> None:
    session = open_session(BusConfig(connect=endpoint))
    for name, said in (("physics", "a simulation"), ("localization", "--without localization")):
        sender = Sender(session, [name], lossless=False)
        try:
            wait_for(lambda name=name: name in alive(session))  # type: ignore[misc]
            done = mazebot("replay", str(run_folder), "--connect", endpoint)
        finally:
            sender.close()
        assert done.returncode == 2
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    session.close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_stops_it_ends_it_with_one_line(
    run_folder: Path, endpoint: str, number: signal.Signals
) -> None:
    with heard(endpoint) as got:
        process = process_of("mazebot.cli", "replay", str(run_folder), "--loop", endpoint=endpoint)
        wait_for(lambda: Counter(name for name, _, _ in got)["/clock"] > 3)
        process.send_signal(number)
        out, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 128 + number
    assert "Traceback" not in out
    assert "interrupted\npublished" in out


def test_a_source_that_counts_again_from_zero_goes_on_counting(endpoint: str) -> None:
    session = open_session(BusConfig(connect=endpoint))
    sender = Sender(session, ["physics"], lossless=False)
    numbers: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in (0, 1, 5, 0, 1):
        message = Replayed(SCAN, b"", "physics", Envelope("physics", number, 0, ""), 0)
        numbers.put(sender.send(message))
    sender.close()
    session.close()  # type: ignore[no-untyped-call]
    assert [numbers.get() for _ in range(5)] == [0, 1, 5, 6, 7]


def compared(folder: Path, endpoint: str, name: str, *options: str) -> dict[str, Any]:
    done = mazebot(
        "replay", str(folder), "--without", name, "--compare", "--json", "--connect", endpoint,
        *options,
    )  # fmt: skip
    told: dict[str, Any] = json.loads(done.stdout)
    assert done.returncode == (0 if told["same"] else 1)
    return told


@pytest.mark.slow
@pytest.mark.parametrize("name", ["navigation", "localization"])
def test_in_lockstep_a_service_on_the_bus_does_what_was_recorded_to_the_last_bit(
    run_folder: Path, endpoint: str, name: str
) -> None:
    with service(name, endpoint, "lockstep"):
        told = compared(run_folder, endpoint, name, "--lockstep", "--speed", "0")
    assert told["same"]
    assert told["messages"] > 70


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
def test_by_the_wall_clock_a_service_stays_within_bounds(run_folder: Path, endpoint: str) -> None:
    with service("navigation", endpoint, "real_time"):
        told = compared(run_folder, endpoint, "navigation")
    topics = {row["topic"]: row for row in told["topics"]}
    commands, results = topics["/cmd_vel"], topics["/navigation/result"]
    assert results["replayed"] == 1
    assert abs(commands["replayed"] - commands["recorded"]) <= 8
    assert commands["largest_differences"].get("twist.linear.x", 0.0) <= 0.3
