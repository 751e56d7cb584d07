"""Real services in real processes on a real router."""

import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.common.bus import serve
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive, watch_sources
from mazebot.common.bus.lockstep import HeldInbox, Turn
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.seats import give_turn, watch_seats
from mazebot.common.bus.serve import LOG_AGAIN_S, _Service
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError, ServiceConfig
from mazebot.common.messages import documents as doc
from mazebot.common.messages.documents import SimulationControl, SimulationControlReply
from mazebot.common.messages.topics import (
    CLOCK,
    DIAGNOSTICS,
    SIMULATION_CONTROL,
    WORLD_REQUEST,
    WORLD_STATUS,
)
from mazebot.common.messages.wire import decode, encode
from mazebot.common.node.log import RosoutHandler
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox
from mazebot.common.settings.load import load
from tests.common.bus.from_outside import wait_until_alive

DEADLINE_S = 30.0


def test_a_watchdog_counts_its_own_ticks_and_not_the_time_in_which_nobody_ran() -> None:
    watchdog = serve.Watchdog(patience_ticks=3)
    for _ in range(10):
        watchdog.feed()
        assert not watchdog.tick()
    assert [watchdog.tick() for _ in range(3)] == [False, False, True]


@contextmanager
def service(name: str, endpoint: str, *flags: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", f"mazebot.{name}", *flags],
        env={**os.environ, "MAZEBOT_BUS_CONNECT": endpoint},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


def read_until(process: subprocess.Popen[str], words: str) -> str:
    """The first line with these words. A process that ends without them fails the test."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if words in line:
            return line
    raise AssertionError(f"never said {words!r}: {lines}")


def test_a_service_waits_for_the_router_and_says_so_and_comes_up_when_it_does() -> None:
    port = free_port()
    address = f"tcp/127.0.0.1:{port}"
    with service("worldgen", address) as process:
        assert address in read_until(process, "waiting for the bus")
        with running_router(port):
            read_until(process, "connected")
            assert "a world" in read_until(process, "waiting for")


def test_a_service_that_waits_for_its_key_leaves_the_processor_to_who_makes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_BUS_KEY_FILE", str(tmp_path / "own.key"))
    with service("spawner", f"tcp/127.0.0.1:{free_port()}") as process:
        read_until(process, "waiting for the bus: ")
        before_s = processor_s(process.pid)
        read_until(process, "waiting for the bus: ")
        used_s = processor_s(process.pid) - before_s
    # Of the two seconds between two such lines.
    assert used_s < 0.5 * LOG_AGAIN_S


def processor_s(process: int) -> float:
    """What a process has used of a processor."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_a_service_announces_itself_answers_and_leaves_on_sigterm(endpoint: str) -> None:
    session = open_session(BusConfig(connect=endpoint))
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    subscription = subscribe(session, WORLD_STATUS, lambda payload, _: answers.put(payload))
    with service("worldgen", endpoint) as process:
        assert wait_until_alive(session, "worldgen", DEADLINE_S)
        request = doc.WorldRequest(world_name="atlantis")
        publisher = publish(session, WORLD_REQUEST)
        publisher.put(encode(WORLD_REQUEST, request))
        status = decode(WORLD_STATUS, answers.get(timeout=DEADLINE_S))
        assert status.request == request
        assert "atlantis" in status.error
        process.send_signal(signal.SIGTERM)
        assert process.wait(5.0) == 0
    assert "worldgen" not in alive(session)
    del subscription
    session.close()  # type: ignore[no-untyped-call]


def test_a_service_that_is_killed_is_missed_by_its_source(endpoint: str) -> None:
    session = open_session(BusConfig(connect=endpoint))
    sources: queue.SimpleQueue[str] = queue.SimpleQueue()
    changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
    subscription = subscribe(session, DIAGNOSTICS, lambda _, envelope: sources.put(envelope.source))
    watching = watch_sources(session, lambda source, is_there: changes.put((source, is_there)))
    with service("worldgen", endpoint) as process:
        source = sources.get(timeout=DEADLINE_S)
        while changes.get(timeout=DEADLINE_S) != (source, True):
            pass
        process.kill()
        while changes.get(timeout=DEADLINE_S) != (source, False):
            pass
    del subscription, watching
    session.close()  # type: ignore[no-untyped-call]


def test_garbage_is_counted_and_shown_and_the_service_goes_on(endpoint: str) -> None:
    session = open_session(BusConfig(connect=endpoint))
    told: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    subscription = subscribe(session, DIAGNOSTICS, lambda payload, _: told.put(payload))
    publisher = publish(session, WORLD_REQUEST)
    with service("worldgen", endpoint) as process:
        assert wait_until_alive(session, "worldgen", DEADLINE_S)
        for number in range(5):
            envelope = Envelope("ab" * 16, number, 0, "")
            publisher.put(b"garbage", attachment=pack_attachment(WORLD_REQUEST, envelope))
        counted = ""
        while not counted.startswith("5"):
            (status,) = decode(DIAGNOSTICS, told.get(timeout=DEADLINE_S)).status
            values = {value.key: value.value for value in status.values}
            counted = values.get("rejected /world/request: malformed", "")
        assert float(values["step_time_p99_ms"]) >= 0.0
        assert values["missed_periods"] == "0"
        assert process.poll() is None
    del subscription, publisher
    session.close()  # type: ignore[no-untyped-call]


def test_a_flag_that_is_none_is_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.worldgen", "--nope", "1"],
        capture_output=True, text=True, timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "--nope" in done.stderr


class SlowPhysics(ClockNode):
    """A step of a second at a hundredth of real time: due in 100 s."""

    name = "physics"
    _config = ServiceConfig()
    speed = 0.01

    def next_step_ns(self) -> int | None:
        return None if self.paused else self.now_ns + 1_000_000_000

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if now_ns == self.next_step_ns():
            self.now_ns = now_ns
        for request in inbox.requests(SIMULATION_CONTROL):
            self.paused = bool(request.message.pause)
            request.respond(SimulationControlReply())


def test_a_slow_or_paused_simulation_answers_at_once_and_can_be_stopped() -> None:
    node, stop, answers = SlowPhysics(), threading.Event(), queue.SimpleQueue[object]()
    service_ = _Service(node, BusConfig(), RosoutHandler(), stop)
    inbox = Inbox(node)
    outbox = Outbox(node, lambda *_: None)
    loop = threading.Thread(target=service_._make_time_pass, args=(node, inbox, outbox))
    loop.start()
    for pause in (None, True, True, False):
        inbox.ask(SIMULATION_CONTROL, SimulationControl(pause=pause), answers.put)
        answers.get(timeout=5.0)
    assert node.now_ns <= 2_000_000_000
    stop.set()
    loop.join(5.0)
    assert not loop.is_alive()


class Listener(Node):
    """Has nothing to do."""

    name = "recorder"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


def test_a_service_that_waits_in_its_turn_ends_as_soon_as_it_is_told(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, stop = threading.Event(), threading.Event()
    seats, ends = queue.SimpleQueue[str](), queue.SimpleQueue[bytes | None]()

    class Inbox(HeldInbox):
        def take_in(self, *turn: Any) -> str:
            waits.set()
            return super().take_in(*turn)

    monkeypatch.setattr(serve, "HeldInbox", Inbox)
    config = BusConfig(connect=endpoint, pace="lockstep")
    executive = open_session(config)
    service_ = _Service(Listener(), config, RosoutHandler(), stop)
    loop = threading.Thread(target=service_._run_in_lockstep, args=(open_session(config),))
    loop.start()
    watch = watch_seats(executive, lambda _, source, there: seats.put(source), lambda *_: None)
    source, never_sent = seats.get(timeout=DEADLINE_S), (CLOCK.name, "ab" * 16, 0)
    turn = Turn(
        executive="ab" * 16, now_ns=0, step=True, sources={"physics": "ab" * 16},
        sent=(never_sent,), timeout_s=DEADLINE_S,
    )  # fmt: skip
    data = turn.model_dump_json().encode()

    def give() -> None:
        ends.put(give_turn(executive, "recorder", source, data, DEADLINE_S))

    asker = threading.Thread(target=give)
    asker.start()
    assert waits.wait(DEADLINE_S)
    stop.set()
    loop.join(2.0)
    assert not loop.is_alive()
    # Its executive learns that it has left, and need not wait either.
    assert ends.get(timeout=2.0) is None
    asker.join()
    watch.clear()
    executive.close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(
    ("pace", "speed"), [("real_time", 1.0), ("fast", 0.0), ("lockstep", 0.0), ("2.5", 2.5)]
)
def test_a_pace_is_a_word_or_a_factor(pace: str, speed: float) -> None:
    config = BusConfig(pace=pace)
    assert config.speed == speed
    assert config.lockstep == (pace == "lockstep")


@pytest.mark.parametrize("pace", ["quick", "0", "-1", "nan", "inf", "1e9", ""])
def test_another_pace_is_refused_in_one_line(pace: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_BUS_PACE", pace)
    with pytest.raises(ConfigError, match=r"pace: .*must be real_time, fast, lockstep, or a f"):
        load(BusConfig, "bus", [])
