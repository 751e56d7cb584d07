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
from mazebot.bringup.tour import tour_goals
from mazebot.cli.stack.plan import DEMO, StackOptions, plan_of
from mazebot.cli.stack.state import StackFolder
from mazebot.common.files.root import ROOT
from mazebot.worldgen.recipe.loader import load_world
from tests.cli.stack.running import runtime, wait_until
from tests.cli.test_app import assert_one_line, mazebot

__all__ = ["runtime"]

COMPOSE = yaml.safe_load((ROOT / "docker-compose.yaml").read_text())["services"]


@pytest.fixture
def port(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A free port; no stack is left, on it or another one."""
    number = str(free_port())
    for variable in ("MAZEBOT_VIEWER_PORT", "MAZEBOT_VIEWER_DATA_PORT"):
        monkeypatch.setenv(variable, str(free_port()))
    monkeypatch.chdir(runtime)
    yield number
    for folder in (runtime / "mazebot").glob("*"):
        mazebot("down", "--router-port", folder.name)


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
def test_halves_are_those_of_the_containers() -> None:
    for half, profile in (("simulator", "simulator"), ("navigation-only", "navigation-only")):
        contained = {
            service["command"][2].removeprefix("mazebot.")
            for service in COMPOSE.values()
            if profile in service["profiles"] and service["command"][0] == "python"
        } - {"bringup.one_world"}
        found = plan(only=(half,))
        assert set(found) == contained
        drives = found.get(DEMO, {}).get("MAZEBOT_BRINGUP_DRIVE")
        assert drives == ("False" if half == "simulator" else None)
    assert set(plan(only=("navigation-only",), slam=True)) == {
        "router", "mapping", "explorer", "navigation", "recorder",
    }  # fmt: skip
    both = plan(only=("simulator", "navigation-only"))
    assert set(both) == set(plan())
    assert "MAZEBOT_BRINGUP_DRIVE" not in both[DEMO]


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
        (["--only", "simulatr"], ["--only", "simulatr", "did you mean simulator?"]),
        (["--connect", "tcp/127.0.0.1:1"], ["--connect", "tcp/127.0.0.1:1", "router"]),
        (["--connect", "nowhere"], ["--connect", "nowhere"]),
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
        assert done.stdout.startswith(f"no stack runs on port {port}: mazebot up starts one")
    assert mazebot("ps", "--json", "--router-port", port).stdout == "[]\n"
    assert_one_line(mazebot("logs", "--router-port", port), "no stack runs", port)


def test_a_router_that_is_none_of_the_users_stacks_is_told_of(port: str) -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", int(port)))
        listener.listen()
        told = f"something listens on port {port} that is no stack this shell knows of"
        assert mazebot("ps", "--router-port", port).stdout.startswith(told)
        done = mazebot("down", "--router-port", port)
        assert_one_line(done, f"error: down: {told}")
        assert done.returncode == 1


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


@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_stops_the_command_ends_all(port: str, number: signal.Signals) -> None:
    command = ["-m", "mazebot.cli", "up", "--only", "worldgen", "--router-port", port]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("starting")
        for line in process.stdout:
            if "waiting for a world request" in line:
                break
        process.send_signal(number)
        rest = process.stdout.read()
        assert process.wait(20.0) == 128 + number
    assert rest.endswith("ending the services\n2 services ended\n")
    wait_until(lambda: StackFolder(int(port)).running() is None)


@pytest.mark.slow
def test_kernels_are_compiled_before_any_service_runs(port: str, tmp_path: Path) -> None:
    command = ["-m", "mazebot.cli", "up", "--only", "worldgen", "--router-port", port]
    with subprocess.Popen(
        [sys.executable, *command],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        for line in process.stdout:
            assert "services run" not in line
            if line.startswith("compiling kernels, once: 0 of "):
                break
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(20.0) == 130
    assert "Traceback" not in rest
    assert "services run" not in rest
    assert StackFolder(int(port)).running() is None


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(400)
def test_a_tour_is_followed_to_its_end_and_the_services_go_on(port: str) -> None:
    words = ("--world", "original", "--no-camera", "--pace", "2", "--router-port", port)
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
    wait_until(lambda: listed_on(port)[DEMO]["state"] == "ended (exit code 0)")
    assert listed_on(port)["navigation"]["state"] == "active"
    assert mazebot("down", "--router-port", port).stdout.endswith("8 services ended\n")
    (run,) = Path("recordings").iterdir()
    assert (run / "run.mcap").is_file()


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(900)
def test_navigation_alone_drives_the_simulator_of_another_stack(port: str) -> None:
    loaded = load_world("original", True, ROOT / "worlds", None, ())
    goals = tour_goals(loaded.world, (), loaded.map_cells, loaded.map_origin, 7)
    other, endpoint = str(free_port()), f"tcp/127.0.0.1:{port}"
    words = ("--world", "original", "--no-camera", "--pace", "2", "--detach")
    done = mazebot("up", "--only", "simulator", *words, "--router-port", port)
    assert done.returncode == 0, done.stderr
    wait_until(lambda: listed_on(port)[DEMO]["state"] == "ended (exit code 0)")
    assert not {"localization", "navigation"} & listed_on(port).keys()
    joined = ("--connect", endpoint, "--router-port", other)
    done = mazebot("up", "--only", "navigation-only", *joined, "--detach")
    assert done.returncode == 0, done.stderr
    assert f"left out, as they run on {endpoint} already: recorder" in done.stdout
    assert "\nactive\n" in done.stdout
    assert listed_on(other).keys() == {"localization", "navigation"}
    assert_one_line(
        mazebot("up", "--only", "worldgen", "--connect", endpoint, "--router-port",
                str(free_port())), "--connect", endpoint, "already",
    )  # fmt: skip
    for name, goal in goals:
        where = (str(goal.x_m), str(goal.y_m), str(goal.yaw_rad))
        reached = mazebot("goal", *where, MAZEBOT_BUS_CONNECT=endpoint)
        assert reached.returncode == 0, (name, reached.stdout, reached.stderr)
    assert mazebot("down", "--router-port", other).stdout.endswith("2 services ended\n")
    wait_until(lambda: listed_on(port)["physics"]["state"] == "active")
    assert mazebot("down", "--router-port", port).stdout.endswith("6 services ended\n")


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(400)
def test_with_keys_the_owner_does_all_as_before_and_others_what_their_keys_let_them(
    port: str, tmp_path: Path
) -> None:
    words = ("--world", "original", "--no-camera", "--pace", "2", "--detach")
    done = mazebot("up", *words, "--keys", "mine", "--router-port", port)
    assert done.returncode == 0, done.stderr
    owner = {"MAZEBOT_BUS_CONNECT": f"tcp/127.0.0.1:{port}"}
    wait_until(lambda: listed_on(port)[DEMO]["state"].startswith("ended"), 200.0)
    assert mazebot("goal", "0.5", "0", "0", **owner).returncode == 0
    assert mazebot("keys", "add", "anna", "--keys", "mine").returncode == 0
    anna = owner | {"MAZEBOT_BUS_KEY_FILE": "mine/anna.key"}
    wait_until(lambda: mazebot("entities", **anna).returncode == 0, 60.0)
    refused = "anna may not {} it, as viewer: see mazebot security explain viewer"
    assert_one_line(mazebot("goal", "0", "0", "0", **anna), refused.format("query"))
    twist = "{twist: {linear: {x: 0.1}}}"
    assert_one_line(
        mazebot("topic", "pub", "/cmd_vel", twist, "--once", **anna),
        refused.format("query"),
    )  # fmt: skip
    seen = mazebot("topic", "echo", "/odom", "--once", **anna)
    assert seen.returncode == 0, seen.stderr
    # Another user of the machine: the stack's folder is not found.
    stranger = owner | {"XDG_RUNTIME_DIR": str(tmp_path / "nowhere")}
    assert_one_line(mazebot("goal", "0", "0", "0", **stranger), "asks for a key")
    # Everyone's key is replaced while all runs: the services take the new ones.
    Path("old.key").write_bytes(Path("mine/operator.key").read_bytes())
    words = ("-m", "mazebot.cli", "goal", "3.5", "-0.5", "0")
    with subprocess.Popen(
        [sys.executable, *words], stderr=subprocess.PIPE, text=True, env={**os.environ, **owner}
    ) as driving:
        assert driving.stderr is not None
        for line in driving.stderr:
            if "left" in line:
                break
        assert mazebot("keys", "rotate", "--keys", "mine").returncode == 0
        rest = driving.stderr.read()
        assert driving.wait(120.0) == 0, rest
    old = owner | {"MAZEBOT_BUS_KEY_FILE": "old.key"}
    wait_until(lambda: "refuses the key" in mazebot("entities", **old).stderr, 60.0)
    wait_until(lambda: mazebot("goal", "0", "0", "0", **owner).returncode == 0, 120.0)
    assert all(one["restarts"] == 0 for one in listed_on(port).values())
    assert mazebot("down", "--router-port", port).returncode == 0
    assert not (StackFolder(int(port)).path / "keys").exists()
