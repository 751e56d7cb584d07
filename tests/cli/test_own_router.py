"""A run in this process, on the bus of a router of its own: what the user's tools find there."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from mazebot.cli.own_router import OwnRouter, how_to_find, router_port, taken
from mazebot.commander.navigator import Navigator, TaskResult
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.subscription import Subscription
from mazebot.common.config import ConfigError
from mazebot.common.messages.action_documents import LoadWorld, LoadWorldReply
from mazebot.common.messages.documents import SimulationControl, SimulationStats
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import (
    DIAGNOSTICS,
    GOAL_POSE,
    LOAD_WORLD,
    ODOM,
    PARAMETERS,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
)
from mazebot.common.node.executive import Executive
from mazebot.common.node.node import Envelope
from mazebot.console.config import ConsoleConfig
from mazebot.embedded import demo
from mazebot.embedded.demo import DemoOptions, build_nodes
from mazebot.embedded.watched_transport import WatchedTransport
from tests.cli.test_app import assert_one_line, mazebot
from tests.common.samples import SAMPLES
from tests.console.live.running import Page, Run, running, wait_until

pytestmark = pytest.mark.timeout(180)


def options(folder: Path, **more: Any) -> DemoOptions:
    fields: dict[str, Any] = {
        "world_name": "original", "camera": False, "renderer": "none", "record": False,
        "tour": False, "out_dir": folder / "run",
    }  # fmt: skip
    return DemoOptions(**{**fields, **more})


@pytest.fixture(scope="module")
def bus() -> OwnRouter:
    return OwnRouter(0)


@pytest.fixture(scope="module")
def run(bus: OwnRouter, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with running(options(tmp_path_factory.mktemp("own")), lambda: bus) as started:
        with started.page() as page:
            page.wait_for(lambda: page.newest.get("navigation", {}).get("navigation_active"))
        yield started


@pytest.fixture
def robot(bus: OwnRouter, run: Run) -> Iterator[ZenohRobot]:
    with ZenohRobot(bus.endpoint) as connected:
        yield connected


@pytest.fixture
def page(run: Run) -> Iterator[Page]:
    with run.page() as opened:
        yield opened


def test_the_nodes_of_a_run_are_the_services_of_a_stack(robot: ZenohRobot) -> None:
    alive = robot.alive()
    assert {"physics", "navigation", "localization", "recorder", "bringup"} <= set(alive)
    # Without --slam nobody maps.
    assert "mapping" not in alive
    assert all(len(sources) == 1 for sources in alive.values())


def test_a_late_reader_gets_what_is_latched_of_each_node(robot: ZenohRobot) -> None:
    services = set()
    with Subscription(robot, WORLD, PARAMETERS) as messages:
        world = None
        end_s = time.monotonic() + 10.0
        while (world is None or len(services) < 8) and time.monotonic() < end_s:
            received = messages.next(1.0)
            if received is not None and received[0] is WORLD:
                world = received[1]
            elif received is not None:
                services.add(received[1].service)
    assert world is not None
    assert world.name == "sim_house"
    assert {"physics", "navigation", "worldgen"} <= services


def test_messages_pass_out_and_are_counted_like_those_of_a_stack(run: Run, bus: OwnRouter) -> None:
    envelopes: list[Envelope] = []
    with ZenohRobot(bus.endpoint) as robot:
        end = robot.watch((ODOM,), lambda topic, message, envelope: envelopes.append(envelope))
        wait_until(lambda: len(envelopes) >= 20)
        end()
    (source,) = {envelope.source for envelope in envelopes}
    assert source in robot_sources(bus)["physics"]
    numbers = [envelope.sequence for envelope in envelopes]
    assert numbers == sorted(set(numbers))


def robot_sources(bus: OwnRouter) -> dict[str, frozenset[str]]:
    with ZenohRobot(bus.endpoint) as robot:
        return dict(robot.alive())


def test_a_goal_of_the_command_is_driven_to_and_shown_on_the_console(
    run: Run, bus: OwnRouter, page: Page
) -> None:
    done = mazebot("goal", "0.4", "0", "0", "--timeout", "60", MAZEBOT_BUS_CONNECT=bus.endpoint)
    assert done.returncode == 0, done.stderr
    assert "reached" in done.stdout
    page.wait_for(lambda: "navigation_result" in page.newest)


def test_navigator_finds_the_router_that_the_environment_names(
    run: Run, bus: OwnRouter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_BUS_CONNECT", bus.endpoint)
    with Navigator.connect() as navigator:
        navigator.waitUntilNav2Active()
        assert navigator.goToPose((0.0, 0.0, 0.0))
        while not navigator.isTaskComplete():
            pass
        assert navigator.getResult() is TaskResult.SUCCEEDED
    monkeypatch.setenv("MAZEBOT_BUS_CONNECT", "tcp/127.0.0.1:1")
    with pytest.raises(ConfigError, match="no Zenoh router at tcp/127"):
        Navigator.connect()
    with Navigator.connect(bus.endpoint):
        pass


def test_a_topic_of_the_console_is_on_the_bus_once_and_does_not_go_round(
    run: Run, bus: OwnRouter, robot: ZenohRobot
) -> None:
    goals: list[Envelope] = []
    end = robot.watch((GOAL_POSE,), lambda topic, message, envelope: goals.append(envelope))
    pose = SAMPLES[GOAL_POSE]
    before = run.robot.latest(DIAGNOSTICS)
    run.robot.publish(GOAL_POSE, pose)
    wait_until(lambda: goals)
    wait_until(lambda: run.robot.latest(DIAGNOSTICS) is not before)
    wait_for_more()
    assert len(goals) == 1
    # From a reader's own tool: it comes to the run, and to the tool itself, once as well.
    robot.publish(GOAL_POSE, pose)
    wait_until(lambda: len(goals) == 2)
    wait_for_more()
    assert len(goals) == 2
    end()
    mazebot("cancel", "--connect", bus.endpoint)


def wait_for_more() -> None:
    """A message that went round would have come by then."""
    begin_s = time.monotonic()
    wait_until(lambda: time.monotonic() > begin_s + 0.3)


def test_what_a_tool_sends_is_checked_and_counted(bus: OwnRouter, run: Run) -> None:
    session = open_session(BusConfig(connect=bus.endpoint), timeout_s=5.0)
    navigation = run.beside.transport.inboxes["navigation"]

    def rejected() -> dict[str, int]:
        return dict(navigation.counts[GOAL_POSE.name].rejected)

    try:
        key = DEFAULT_KEYS.of_topic(GOAL_POSE)
        session.put(
            key, b"no pose", attachment=pack_attachment(GOAL_POSE, Envelope("0" * 32, 0, 0, ""))
        )
        session.put(key, b"no pose", attachment=b"no attachment")
        wait_until(lambda: sum(rejected().values()) == 2)
        assert "invalid attachment" in rejected()
    finally:
        session.close()  # type: ignore[no-untyped-call]


def test_time_is_controlled_from_outside(run: Run, robot: ZenohRobot) -> None:
    def control(**fields: object) -> Any:
        request = SimulationControl.model_validate(fields)
        return robot.ask(SIMULATION_CONTROL, request, 10.0)

    assert control(pause=True).stats.paused
    at_s = run.executive.now_ns * 1e-9
    assert control(step=24).stats.sim_time_s == pytest.approx(at_s + 0.1, abs=0.01)
    assert not control(pause=False).stats.paused


def test_a_demo_loads_other_worlds_in_the_place_of_its_own_and_refuses_unknown_ones(
    tmp_path: Path,
) -> None:
    bus = OwnRouter(0)
    higher = ("wall_height_m=2.0",)

    def load_all() -> list[LoadWorldReply]:
        wanted = [("maze", ()), ("nosuch", ()), ("original", ()), ("original", higher)]
        with ZenohRobot(bus.endpoint) as robot:
            wait_until(robot.alive)
            try:
                return [
                    robot.ask(LOAD_WORLD, LoadWorld(world_name=name, overrides=overrides), 60.0)
                    for name, overrides in wanted
                ]
            finally:
                signal.raise_signal(signal.SIGINT)

    with ThreadPoolExecutor(1) as pool:
        loading = pool.submit(load_all)
        demo.run(options(tmp_path, console=ConsoleConfig(port=0), open_bus=lambda: bus))
    maze, unknown, own, other = loading.result()
    assert (maze.world_name, maze.is_new, maze.error) == ("maze", True, "")
    assert "must be one of maze" in unknown.error
    assert unknown.world_hash == maze.world_hash
    assert (own.world_name, own.is_new, own.error) == ("sim_house", True, "")
    assert (other.world_name, other.is_new, other.error) == ("sim_house", True, "")
    assert other.world_hash != own.world_hash


def hash_at(seconds: float, folder: Path, on_bus: bool) -> str:
    """The hash of the state of a drive at a time."""
    transport = WatchedTransport()
    executive = Executive(build_nodes(options(folder, goal=(1.0, 0.0, 0.0), tour=True)), transport)
    with contextlib.ExitStack() as closing_:
        closing_.callback(executive.close)
        if on_bus:
            bus = closing_.enter_context(closing(OwnRouter(0)))
            bus.carry(executive.nodes, transport)
            reader = closing_.enter_context(ZenohRobot(bus.endpoint))
            reader.watch((ODOM, WORLD))
        executive.run(lambda: executive.now_ns >= seconds * 1e9)
        stats: SimulationStats = transport.latest[SIMULATION_STATS.name]
        return f"{stats.sim_time_s} {stats.state_hash}"


def test_a_run_is_the_same_on_the_bus_when_nobody_sends_anything(tmp_path: Path) -> None:
    alone = hash_at(6.0, tmp_path / "alone", on_bus=False)
    assert alone
    assert hash_at(6.0, tmp_path / "on_bus", on_bus=True) == alone


def test_a_port_that_is_taken_is_named_with_what_to_do(tmp_path: Path) -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = str(listener.getsockname()[1])
        done = mazebot(
            "demo", "--console", "--console-port", "0", "--router-port", port,
            "--no-camera", "--no-record", "--out", str(tmp_path / "run"),
        )  # fmt: skip
    assert_one_line(done, f"tcp/127.0.0.1:{port}", "in use", "--router-port", "mazebot down")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("environment", "given", "port"),
    [
        ({}, None, 7447),
        ({}, 0, 0),
        ({"MAZEBOT_BUS_CONNECT": "tcp/127.0.0.1:7448"}, None, 7448),
        ({"MAZEBOT_BUS_CONNECT": "tcp/localhost:7448"}, None, 7448),
        ({"MAZEBOT_BUS_CONNECT": "tcp/127.0.0.1:7448"}, 7449, 7449),
        ({"MAZEBOT_ROUTER_PORT": "7450", "MAZEBOT_BUS_CONNECT": "tcp/10.0.0.1:1"}, None, 7450),
    ],
)
def test_the_router_is_where_the_tools_look_for_it(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], given: int | None, port: int
) -> None:
    set_environment(monkeypatch, environment)
    assert router_port(given) == port


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("MAZEBOT_BUS_CONNECT", "tcp/10.0.0.1:7447"),
        ("MAZEBOT_BUS_CONNECT", "tcp/127.0.0.1:99999"),
        ("MAZEBOT_ROUTER_PORT", "many"),
    ],
)
def test_an_address_elsewhere_is_no_place_for_a_router(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    set_environment(monkeypatch, {name: value})
    with pytest.raises(ConfigError, match=f"{name}: {value!r}.*--router-port"):
        router_port(None)


def set_environment(monkeypatch: pytest.MonkeyPatch, environment: dict[str, str]) -> None:
    for name in ("MAZEBOT_BUS_CONNECT", "MAZEBOT_ROUTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)


def test_the_default_address_needs_no_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    set_environment(monkeypatch, {})
    assert how_to_find("tcp/127.0.0.1:7447") == ""
    there = "tcp/127.0.0.1:7448"
    assert how_to_find(there) == f": export MAZEBOT_BUS_CONNECT={there}"
    assert "tcp/127.0.0.1:7447" in str(taken("tcp/127.0.0.1:7447"))


def test_without_a_console_the_demo_loads_no_bus() -> None:
    code = "import mazebot.embedded.demo, sys; sys.exit('zenoh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
