"""`mazebot sim` and `mazebot goal` against a real simulation in a process of its own."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from typer.testing import CliRunner

from mazebot.bench.parts.loopback_router import running_router
from mazebot.cli.app import app
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import QueryError, ask
from mazebot.common.bus.session import open_session
from mazebot.common.messages.action_documents import Empty
from mazebot.common.messages.documents import Entities, SimulationControl
from mazebot.common.messages.topics import (
    DESIRED_ENTITIES,
    GET_WORLDS,
    SIMULATION_CONTROL,
    WORLD,
)
from mazebot.common.messages.wire import encode
from tests.cli.test_app import assert_one_line, mazebot
from tests.common.bus.from_outside import wait_until_alive
from tests.physics.driver import world
from tests.worldgen import folder

DEADLINE_S = 30.0


@contextmanager
def physics(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    with service("physics", endpoint, "--camera-enabled", "false") as process:
        yield process


@contextmanager
def service(name: str, endpoint: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", f"mazebot.{name}", *options],
        env={**os.environ, "MAZEBOT_BUS_CONNECT": endpoint},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def session() -> Iterator[tuple[zenoh.Session, str]]:
    with running_router() as endpoint:
        opened = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
        yield opened, endpoint
        opened.close()  # type: ignore[no-untyped-call]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mazebot.cli.sim.RATES_WINDOW_S", 0.2)
    monkeypatch.setattr("mazebot.cli.sim.RATES_PATIENCE_S", 0.0)


def sim(endpoint: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return mazebot("sim", *arguments, "--connect", endpoint)


def said(endpoint: str, *arguments: str) -> str:
    done = sim(endpoint, *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout.strip()


def paused(endpoint: str) -> dict[str, object]:
    """How a simulation is that stands still."""
    stats: dict[str, object] = json.loads(said(endpoint, "stats", "--json"))
    assert stats["paused"]
    return stats


def test_a_simulation_is_controlled_from_the_command_line(
    session: tuple[zenoh.Session, str],
) -> None:
    opened, endpoint = session
    with physics(endpoint) as process:
        assert wait_until_alive(opened, "physics", DEADLINE_S)
        assert_one_line(sim(endpoint, "stats"), "no world loaded yet")
        assert_one_line(sim(endpoint, "reset"), "reset: all: no world loaded yet")
        assert said(endpoint, "pause") == "paused; no world loaded yet"
        room = world()
        publishers = [publish(opened, WORLD), publish(opened, DESIRED_ENTITIES)]
        publishers[0].put(encode(WORLD, room))
        publishers[1].put(encode(DESIRED_ENTITIES, Entities(world_hash=room.hash)))
        end_s = time.monotonic() + DEADLINE_S
        while sim(endpoint, "stats").returncode and time.monotonic() < end_s:
            pass
        assert paused(endpoint)["sim_time_s"] == 0.0
        _steps(endpoint)
        _refusals(endpoint)
        _pace_and_reset(endpoint)
        _emergency_stop(endpoint)
        _a_goal_while_paused(opened, endpoint)
        _topics_while_paused(endpoint)
        _cut_short(opened, endpoint)
        _ended(opened, endpoint, process)
        del publishers


def _emergency_stop(endpoint: str) -> None:
    def stop(*arguments: str) -> subprocess.CompletedProcess[str]:
        return mazebot("stop", *arguments, "--connect", endpoint)

    def reason() -> str:
        stats: dict[str, str] = json.loads(said(endpoint, "stats", "--json"))
        return stats["emergency_stop"]

    assert_one_line(stop("x" * 201), "stop: reason", "200")
    assert reason() == ""
    assert stop("the wheel is loose").stdout.startswith("stopped: ")
    assert reason() == "the wheel is loose"
    # Nobody has a task.
    assert stop("--clear").stdout == "cleared: the robot may move\n"
    assert reason() == ""
    assert stop("--clear").stdout == "no emergency stop was set: the robot may move\n"


@pytest.mark.slow
def test_another_world_is_loaded_and_stays_when_worldgen_is_killed(
    session: tuple[zenoh.Session, str], tmp_path: Path
) -> None:
    opened, endpoint = session
    folder.make(tmp_path)
    hall = folder.room()
    hall["name"] = "hall"
    hall["wall_height_m"] = 2.0
    folder.write(tmp_path, "hall", hall)
    options = "--worlds-dir", str(tmp_path)
    with physics(endpoint), service("spawner", endpoint):
        with service("worldgen", endpoint, *options):
            assert wait_until_alive(opened, "worldgen", DEADLINE_S)
            assert wait_until_alive(opened, "physics", DEADLINE_S)
            assert wait_until_alive(opened, "spawner", DEADLINE_S)
            room = said(endpoint, "load-world", "room")
            assert re.fullmatch(r"room \([0-9a-f]{16}\) is running", room)
            hall_said = said(endpoint, "load-world", "hall")
            assert said(endpoint, "load-world", "hall") == hall_said.replace("is", "was", 1) + (
                " already"
            )
            assert_one_line(sim(endpoint, "load-world", "cellar"), "'cellar'", "hall, room")
            assert_one_line(
                sim(endpoint, "load-world", "room", "--set", "wall_hight=2"), "wall_hight"
            )
        running = json.loads(said(endpoint, "stats", "--json"))["world_hash"]
        assert running in hall_said
        with service("worldgen", endpoint, *options):
            end_s = time.monotonic() + DEADLINE_S
            while (found := ask(opened, GET_WORLDS, Empty(), DEADLINE_S)).running != "hall":
                assert time.monotonic() < end_s, found
            assert json.loads(said(endpoint, "stats", "--json"))["world_hash"] == running


def _steps(endpoint: str) -> None:
    assert said(endpoint, "step") == "paused at 0.00416667 s, step 1, epoch 1"
    assert said(endpoint, "step", "23") == "paused at 0.1 s, step 24, epoch 1"
    assert said(endpoint, "run-until", "0.5") == "paused at 0.5 s, step 120, epoch 1"


def _refusals(endpoint: str) -> None:
    before = paused(endpoint)
    for arguments, words in (
        (("step", "0"), ["step", "0"]),
        (("step", "x"), ["N", "integer"]),
        (("run-until", "nan"), ["run_until_s", "nan"]),
        (("run-until", "1e300"), ["run_until_s"]),
        (("run-until", "0.1"), ["run_until_s: 0.1", "0.5 s"]),
        (("speed", "0.001"), ["speed", "0.01"]),
        (("speed", "fest"), ["speed", "fest"]),
        (("reset", "--seed", "-3"), ["seed", "-3"]),
        (("reset", "--time-only", "--seed", "3"), ["seed: 3", "reset: all"]),
    ):
        assert_one_line(sim(endpoint, *arguments), *words)
    assert paused(endpoint) == before


def _pace_and_reset(endpoint: str) -> None:
    assert "paused" in said(endpoint, "speed", "fast")
    assert re.fullmatch(
        r"running as fast as possible at .* s, step \d+, epoch 1", said(endpoint, "resume")
    )
    stats = json.loads(said(endpoint, "stats", "--json"))
    assert stats["real_time_factor"] > 1.5
    assert stats["speed"] == 0.0
    said(endpoint, "pause")
    assert said(endpoint, "reset", "--seed", "9") == "paused at 0 s, step 0, epoch 2"
    stats = paused(endpoint)
    assert (stats["seed"], stats["real_time_factor"], stats["iterations"]) == (9, 0.0, 0)
    assert said(endpoint, "reset", "--time-only") == "paused at 0 s, step 0, epoch 3"
    assert said(endpoint, "speed", "real_time") == "paused at 0 s, step 0, epoch 3"
    table = said(endpoint, "stats")
    for row in (r"simulation time +0 s", r"paused +yes", r"seed +9", r"step +0 of 4\.167 ms"):
        assert re.search(row, table), table


@pytest.mark.parametrize(
    ("flags", "scope"),
    [
        ([], "all"), (["--scope", "all"], "all"), (["--scope", "fresh"], "fresh"),
        (["--scope", "time"], "time"), (["--time-only"], "time"),
    ],
)  # fmt: skip
def test_a_reset_has_the_scopes_of_the_service(
    monkeypatch: pytest.MonkeyPatch, flags: list[str], scope: str
) -> None:
    asked: list[dict[str, object]] = []
    monkeypatch.setattr("mazebot.cli.sim._control", lambda *_, **fields: asked.append(fields))
    CliRunner().invoke(app, ["sim", "reset", *flags], catch_exceptions=False)
    assert asked == [{"reset": scope, "seed": None}]


def _a_goal_while_paused(opened: zenoh.Session, endpoint: str) -> None:
    token = opened.liveliness().declare_token(alive_key("navigation", "a"))
    assert_one_line(mazebot("goal", "1", "0", "0", "--connect", endpoint), "is paused", "resume")
    token.undeclare()  # type: ignore[no-untyped-call]


def _topics_while_paused(endpoint: str) -> None:
    words = ["/scan", "the simulation is paused", "mazebot sim resume"]
    for arguments in (("echo", "/scan", "--timeout", "0.2"), ("hz", "/scan", "--window", "0.5")):
        assert_one_line(mazebot("topic", *arguments, "--connect", endpoint), *words)


def _while_running(opened: zenoh.Session, endpoint: str, end: Callable[[], object]) -> str:
    """What becomes of a run of steps that something ends long before its time."""
    request = SimulationControl(run_until_s=1e6)

    def run() -> str:
        try:
            return ask(opened, SIMULATION_CONTROL, request, DEADLINE_S, start_s=0.2).error
        except QueryError as error:
            return str(error)

    with ThreadPoolExecutor() as pool:
        said_at_the_end = pool.submit(run)
        end_s = time.monotonic() + DEADLINE_S
        while json.loads(said(endpoint, "stats", "--json"))["paused"]:
            assert time.monotonic() < end_s
        end()
        return said_at_the_end.result()


def _cut_short(opened: zenoh.Session, endpoint: str) -> None:
    error = _while_running(opened, endpoint, lambda: said(endpoint, "pause"))
    assert re.fullmatch(r"interrupted at [\d.]+ s by a newer request", error)
    assert paused(endpoint)["epoch"] == 3


def _ended(opened: zenoh.Session, endpoint: str, process: subprocess.Popen[bytes]) -> None:
    error = _while_running(opened, endpoint, process.kill)
    assert error == "/simulation/control: physics is not running"


def test_nobody_to_control_is_one_line(session: tuple[zenoh.Session, str]) -> None:
    assert_one_line(sim("tcp/127.0.0.1:1", "pause"), "no Zenoh router")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mazebot.cli.sim.PATIENCE_S", 0.5)
        assert_one_line(sim(session[1], "pause"), "no reply from physics within 0.5 s")
