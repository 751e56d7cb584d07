"""`mazebot up`, `down`, `ps` and `logs`, as a person meets them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from mazebot.bench.parts.loopback_router import free_port
from mazebot.cli.stack.plan import DEMO, StackOptions, plan_of
from mazebot.cli.stack.state import StackFolder
from mazebot.common.files.root import ROOT
from tests.cli.stack.running import runtime, wait_until
from tests.cli.test_app import assert_one_line, mazebot

__all__ = ["runtime"]

COMPOSE = yaml.safe_load((ROOT / "docker-compose.yaml").read_text())["services"]


@pytest.fixture
def port(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A free port, and no stack left on it."""
    number = str(free_port())
    for variable in ("MAZEBOT_VIEWER_PORT", "MAZEBOT_VIEWER_DATA_PORT"):
        monkeypatch.setenv(variable, str(free_port()))
    monkeypatch.chdir(runtime)
    yield number
    mazebot("down", "--router-port", number)


def listed_on(port: str) -> dict[str, dict[str, Any]]:
    """The services that are listed, by their names."""
    listed = json.loads(mazebot("ps", "--json", "--router-port", port).stdout)
    return {one["service"]: one for one in listed}


def plan(**fields: object) -> dict[str, dict[str, str]]:
    """The environment of each service of a stack."""
    options = StackOptions.model_validate({"world": "original", "port": free_port(), **fields})
    return {service.name: service.environment for service in plan_of(options).services}


@pytest.fixture
def no_viewer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_LIVE", "false")


@pytest.mark.usefixtures("runtime", "no_viewer")
@pytest.mark.parametrize(("slam", "profile"), [(False, "original"), (True, "slam")])
def test_the_services_are_those_of_the_containers(slam: bool, profile: str) -> None:
    contained = {
        service["command"][2].removeprefix("mazebot.")
        for service in COMPOSE.values()
        if profile in service["profiles"] and service["command"][2] != "mazebot.bringup.one_world"
    }
    assert set(plan(slam=slam)) == contained


@pytest.mark.usefixtures("runtime", "no_viewer")
def test_options_are_the_settings_of_the_services(tmp_path: Path) -> None:
    found = plan(
        world="maze", overrides=("maze.seed=3", "maze.rows=12"), slam=True, seed=5, camera=False,
        pace="lockstep", use_aruco=False,
    )  # fmt: skip
    assert all(one["MAZEBOT_SEED"] == "5" for one in found.values())
    assert all(one["MAZEBOT_BUS_PACE"] == "lockstep" for one in found.values())
    assert found["physics"]["MAZEBOT_PHYSICS_CAMERA_ENABLED"] == "False"
    assert found[DEMO]["MAZEBOT_BRINGUP_WORLD_NAME"] == "maze"
    assert json.loads(found[DEMO]["MAZEBOT_BRINGUP_WORLD_OVERRIDES"]) == [
        "maze.seed=3", "maze.rows=12"
    ]  # fmt: skip
    assert found[DEMO]["MAZEBOT_BRINGUP_SLAM"] == "True"
    assert found[DEMO]["MAZEBOT_BRINGUP_USE_ARUCO"] == "False"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--world", "orignal"], ["--world", "'orignal'", "did you mean original?"]),
        (["--world", "house.sdf"], ["--world", "house.sdf", "mazebot demo"]),
        (["--only", "router,navigatin"], ["--only", "navigatin", "did you mean navigation?"]),
        (["--world", "maze", "--set", "maze.rowz=3"], ["rowz"]),
        (["--pace", "quick"], ["pace", "quick", "lockstep"]),
        (["--map", "nowhere.yaml", "--slam"], ["--map", "nowhere.yaml", "--slam"]),
        (["--seed", "-1"], ["--seed", "-1"]),
        (["--use_aruco", "maybe"], ["--use_aruco", "maybe"]),
        (["--router-port", "0"], ["--router-port", "0"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_starts(
    port: str, words: list[str], told: list[str]
) -> None:
    given = words if "--router-port" in words else [*words, "--router-port", port]
    assert_one_line(mazebot("up", *given), *told)
    assert StackFolder(int(port)).running() is None
    assert "no stack runs" in mazebot("ps", "--router-port", port).stdout


@pytest.mark.parametrize("what", ["router", "viewer"])
def test_a_port_that_is_taken_is_named(port: str, what: str) -> None:
    taken = port if what == "router" else os.environ["MAZEBOT_VIEWER_PORT"]
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", int(taken)))
        listener.listen()
        done = mazebot("up", "--world", "original", "--router-port", port)
    option = "--router-port" if what == "router" else "MAZEBOT_VIEWER_PORT"
    assert_one_line(done, taken, "in use", option)


def test_nothing_to_end_is_no_mistake(port: str) -> None:
    for command in ("down", "ps"):
        done = mazebot(command, "--router-port", port)
        assert done.returncode == 0
        assert done.stdout == f"no stack runs on port {port}: mazebot up starts one\n"
    assert mazebot("ps", "--json", "--router-port", port).stdout == "[]\n"
    assert_one_line(mazebot("logs", "--router-port", port), "no stack runs", port)


def test_an_unknown_service_has_no_log(port: str) -> None:
    done = mazebot("logs", "navigatoin", "--router-port", port)
    assert_one_line(done, "navigatoin", "did you mean navigation?")


@pytest.mark.timeout(180)
def test_some_services_are_started_listed_and_ended(port: str) -> None:
    done = mazebot("up", "--only", "worldgen,spawner", "--detach", "--router-port", port)
    assert done.returncode == 0, done.stderr
    assert f"export MAZEBOT_BUS_CONNECT=tcp/127.0.0.1:{port}" in done.stdout
    (header, *rows) = mazebot("ps", "--router-port", port).stdout.splitlines()
    assert header.split() == ["service", "pid", "uptime", "restarts", "state"]
    assert [row.split()[0] for row in rows] == ["router", "worldgen", "spawner"]
    waiting = "waiting for a world request"
    wait_until(lambda: listed_on(port)["worldgen"]["state"] == waiting)
    pid = listed_on(port)["worldgen"]["pid"]
    assert Path(f"/proc/{pid}").exists()
    again = mazebot("up", "--router-port", port)
    assert_one_line(again, "runs already", "mazebot down", "--router-port")
    other = mazebot("ps", "--router-port", str(free_port()))
    assert f"another one does: --router-port {port}" in other.stdout
    alive = mazebot("topic", "info", "/world", MAZEBOT_BUS_CONNECT=f"tcp/127.0.0.1:{port}")
    assert "publishers: worldgen\n" in alive.stdout
    every = mazebot("logs", "--router-port", port).stdout
    assert "worldgen     | [INFO] [worldgen]: waiting for a world request" in every
    one = mazebot("logs", "worldgen", "--router-port", port).stdout
    assert one.startswith("[INFO] [worldgen]: ")
    ended = mazebot("down", "--router-port", port)
    assert ended.stdout == "ending the services\n3 services ended\n"
    assert not Path(f"/proc/{pid}").exists()
    assert mazebot("logs", "worldgen", "--router-port", port).stdout.startswith(one)


@pytest.mark.timeout(180)
def test_ctrl_c_ends_all(port: str) -> None:
    command = ["-m", "mazebot.cli", "up", "--only", "worldgen", "--router-port", port]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("starting")
        for line in process.stdout:
            if "waiting for a world request" in line:
                break
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(20.0) == 130
    assert rest.endswith("ending the services\n2 services ended\n")
    wait_until(lambda: StackFolder(int(port)).running() is None)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_tour_is_followed_to_its_end_and_the_services_go_on(port: str) -> None:
    words = ("--world", "original", "--no-camera", "--pace", "8", "--router-port", port)
    begin_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.cli", "up", *words],
        capture_output=True, text=True, timeout=300.0, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "home: reached" in done.stdout
    assert "the other services go on" in done.stdout
    assert time.monotonic() - begin_s < 300.0
    endpoint = f"tcp/127.0.0.1:{port}"
    goal = mazebot("goal", "0.5", "0", "0", MAZEBOT_BUS_CONNECT=endpoint)
    assert goal.returncode == 0, goal.stderr
    services = listed_on(port)
    assert services[DEMO]["state"] == "ended (exit code 0)"
    assert services["navigation"]["state"] == "active"
    assert mazebot("down", "--router-port", port).stdout.endswith("8 services ended\n")
    (run,) = Path("recordings").iterdir()
    assert (run / "run.mcap").is_file()
