"""Every command of the pages works as it stands there, or with a shorter one in its place where it
would take minutes; none is left out.
"""

import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.query import ask
from mazebot.common.bus.session import open_session
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import SimulationControl
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.common.world.map_files import write_map
from tests.cli.test_localize import Drive
from tests.common.nav2_files import shipped
from tests.docs.pages import Example, blocks, commands
from tests.docs.stack import running_stack
from tests.perception.scene import CAMERA, camera_from_marker, render

COMMANDS = commands()
ON_A_STACK = {
    *("goal", "cancel", "sim", "spawn", "move", "remove", "entities", "topic", "waypoints"),
    *("spin", "backup", "dock", "undock", "teleop", "stop"),
}
DRIVING = {"goal", "waypoints", "spin", "backup", "dock", "undock", "localize", "sim"}
"""Those that take time of the simulation. With any other, fast time only keeps processors busy."""
OF_A_STACK = {"up", "down", "ps", "logs"}
ENDLESS = (
    "logs navigation --follow",
    "topic echo",
    "topic hz",
    "topic pub",
    "recordings view",
    "console",
)
SHORTER = {
    "--count 100": "--count 2",
    "--port 8080": "--port 0",
    "maze.rows=12": "maze.rows=4",
    "demo --slam": "demo --no-camera --slam",
    "demo --world maze": "demo --no-camera --world maze",
    "demo --world slam": "demo --no-camera --world slam",
}
TOUR = re.compile(
    r"mazebot demo(?= (--params \S+|--seed 11 .*|--world (house.sdf.xacro|enhanced .*|original "
    r"--no-camera --controller mppi))$)"
)
"""Tours of the house that others drive, with the camera and to every goal."""
CAMERA_INFO = f"""
image_width: 640
image_height: 480
camera_matrix: {{rows: 3, cols: 3, data: {CAMERA.ravel().tolist()}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}}
"""
MOST_S = 270.0
"""For a command, on a machine that does other things, too."""
PLACEHOLDERS = {"RUN": ("one", "two"), "NAME": ("den",)}


def program(example: Example) -> list[str]:
    """The words after the variables that are set before a command."""
    words = shlex.split(example.text, comments=True)
    while re.match(r"[A-Z_]+=", words[0]):
        words.pop(0)
    return [words[0].removeprefix(".venv/bin/"), *words[1:]]


def kind(example: Example) -> str:
    words = program(example)
    if words[0] == "mazebot":
        if words[1] == "replay" and "--service" not in words:
            return "router"
        if words[1] in OF_A_STACK:
            return "services"
        running = words[1] in ON_A_STACK or words[1:] == ["localize", "--global"]
        return "stack" if running else "alone"
    return words[0]


def some(wanted: str) -> list[Example]:
    return [example for example in COMMANDS if kind(example) == wanted]


PROGRAM_FILES = [one for one in some("python") if program(one)[1].endswith(".py")]


def test_there_is_a_test_for_each_kind_of_command() -> None:
    assert {kind(example) for example in COMMANDS} <= {
        "alone", "stack", "router", "services", "docker", "make", "python", "source"
    }  # fmt: skip
    assert len(some("alone")) > 10
    assert len(some("stack")) > 10


@pytest.mark.parametrize("example", some("make"), ids=str)
def test_a_target_of_make_exists(example: Example) -> None:
    done = subprocess.run(
        ["make", "--dry-run", *program(example)[1:]],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def environment(**more: str) -> dict[str, str]:
    # `source .venv/bin/activate` does no more than this.
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    # Two tests at once may each start a console.
    return {**os.environ, "PATH": path, "COLUMNS": "200", "MAZEBOT_CONSOLE_PORT": "0", **more}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that the commands name: worlds, a dictionary, a photo, two runs, ..."""
    folder = tmp_path_factory.mktemp("person")
    shutil.copytree(ROOT / "worlds", folder / "worlds")
    shutil.copytree(ROOT / "examples", folder / "examples")
    for block in blocks("python", "yaml"):
        named = re.match(r"# (\w+\.(?:py|yaml))\n", block.text)
        if named is not None:
            (folder / named[1]).write_text(block.text)
    run("mazebot world export original --out house", folder)
    (model,) = (folder / "house").glob("*.sdf")
    shutil.copy(model, folder / "house.sdf.xacro")
    dictionary = cv2.aruco.extendDictionary(8, 4)
    storage = cv2.FileStorage(str(folder / "mine.yml"), cv2.FILE_STORAGE_WRITE)
    dictionary.writeDictionary(storage)
    storage.release()
    cv2.imwrite(str(folder / "photo.jpg"), render(camera_from_marker(1.5)))
    (folder / "camera.yaml").write_text(CAMERA_INFO)
    (folder / "nav2_params.yaml").write_text(shipped("lyrical"))
    drive = Drive(folder)
    shutil.copy(drive.map, folder / "map.yaml")
    drive.csv(folder / "log.csv")
    for name, value in (("keepout", 100), ("speed", 50)):
        cells = np.zeros((100, 100), np.int8)
        cells[40:60, 75:90] = value
        write_map(folder, name, cells, 0.1, SE2(-5.0, -5.0, 0.0), mode="scale", image_format="png")
    shutil.copy(drive.mcap(folder / "bag"), folder / "run.mcap")
    for name in PLACEHOLDERS["RUN"]:
        goal = "--goal 0.5 0 0 --no-camera --world original"
        run(f"mazebot demo {goal} --out recordings/{name}", folder)
    return folder


def run(command: str, folder: Path, **more: str) -> str:
    for long, short in SHORTER.items():
        command = command.replace(long, short)
    command = TOUR.sub("mazebot demo --no-camera --goal 0.5 -0.9 0", command)
    endless = any(words in command for words in ENDLESS)
    with keyboard("q") if "teleop" in command else nullcontext() as terminal:
        return _ended(command, endless, folder, terminal, **more)


@contextmanager
def keyboard(key: str) -> Iterator[int]:
    """A terminal at which a key is pressed again and again."""
    master, slave = pty.openpty()
    done = threading.Event()

    def press() -> None:
        while not done.wait(0.1):
            os.write(master, key.encode())

    person = threading.Thread(target=press)
    person.start()
    try:
        yield slave
    finally:
        done.set()
        person.join()
        os.close(master)
        os.close(slave)


def _ended(command: str, endless: bool, folder: Path, terminal: int | None, **more: str) -> str:
    process = subprocess.Popen(
        ["bash", "-c", f"exec {command}"],
        cwd=folder, env=environment(**more), stdin=terminal,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    end_s = time.monotonic() + 60.0
    try:
        said = _said(process, 3.0, end_s) if endless else process.communicate(timeout=MOST_S)[0]
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=30.0)
        assert endless, f"{command}: {said}"
        assert said.strip(), f"{command}: says nothing"
        assert "Traceback" not in said
        return said
    # A replay that finds a difference says so by its exit code.
    differs = "replay" in command and ("--set" in command or "--compare" in command)
    assert process.returncode in ((0, 1) if differs else (0,)), f"{command}: {said}"
    assert "Traceback" not in said
    return said


def _said(process: subprocess.Popen[str], going_on_s: float, end_s: float) -> str:
    """What a program says that ends. Raises TimeoutExpired if it goes on for so long, and has said
    something by then or by a time.
    """
    while True:
        try:
            return process.communicate(timeout=going_on_s)[0]
        except subprocess.TimeoutExpired as going_on:
            if going_on.output or time.monotonic() >= end_s:
                raise


def filled(example: Example) -> str:
    text = " ".join(shlex.quote(word) for word in program(example))
    for placeholder, values in PLACEHOLDERS.items():
        for value in values:
            text = re.sub(rf"\b{placeholder}\b", value, text, count=1)
    return text


def makers(example: Example) -> list[str]:
    """The commands of its page that make the folders which it names, by `--out`."""
    found = []
    for other in some("alone"):
        words = program(other)
        made = words[words.index("--out") + 1] if "--out" in words else None
        if made and other.page == example.page and f"{made}/" in example.text:
            found.append(filled(other))
    return found


@pytest.fixture(scope="module")
def worked() -> set[str]:
    """The commands that have been run: one that stands on two pages is run once."""
    return set()


# In one folder, one after the other: some need what another one has made.
@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.xdist_group("commands")
@pytest.mark.parametrize("example", some("alone"), ids=str)
def test_a_command_that_needs_nothing_else_works(
    example: Example, folder: Path, worked: set[str]
) -> None:
    for one in (*makers(example), filled(example)):
        if one not in worked:
            run(one, folder)
            worked.add(one)


@pytest.mark.slow
@pytest.mark.xdist_group("commands")
@pytest.mark.parametrize("example", PROGRAM_FILES, ids=str)
def test_a_program_is_started_as_the_page_says(example: Example, folder: Path) -> None:
    run(filled(example), folder)


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(600)
def test_a_running_stack_does_what_each_command_says(
    tmp_path: Path, subtests: pytest.Subtests
) -> None:
    (tour,) = (block.text for block in blocks("yaml") if block.text.startswith("waypoints:"))
    (tmp_path / "tour.yaml").write_text(tour)
    page = None
    worked: set[str] = set()
    # No longer than it is needed: it takes a processor from all other tests.
    with running_stack(camera=True) as endpoint:
        for example in some("stack"):
            controls_time = "sim" in program(example)
            if filled(example) in worked and not controls_time:
                continue
            worked.add(filled(example))
            with subtests.test(str(example)):
                if example.page != page or controls_time:
                    page = example.page
                    # Nothing passes before a command that counts time has begun.
                    control(endpoint, reset="all", pause=controls_time, speed=4.0)
                if not DRIVING.intersection(program(example)):
                    control(endpoint, speed=1.0)
                with a_goal(endpoint) if "cancel" in program(example) else nullcontext():
                    run(filled(example), tmp_path, MAZEBOT_BUS_CONNECT=endpoint)
                # Where a command has stopped time, the next one needs it.
                control(endpoint, pause=False, speed=4.0)


@pytest.mark.slow
@pytest.mark.xdist_group("commands")
@pytest.mark.timeout(120)
def test_a_run_is_replayed_on_a_router_as_each_command_says(
    folder: Path, subtests: pytest.Subtests
) -> None:
    with running_router() as endpoint:
        for example in some("router"):
            words = program(example)
            more = {"MAZEBOT_BUS_CONNECT": endpoint}
            more |= {"MAZEBOT_BUS_PACE": "lockstep"} if "--lockstep" in words else {}
            named = words[words.index("--without") + 1] if "--without" in words else ""
            taking_part = a_service(named, **more) if named else nullcontext()
            with subtests.test(str(example)), taking_part:
                run(filled(example), folder, **more)


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(900)
def test_services_are_started_and_ended_as_each_command_says(
    tmp_path: Path, subtests: pytest.Subtests
) -> None:
    more = {
        "XDG_RUNTIME_DIR": str(tmp_path),
        **{
            f"MAZEBOT_{name}_PORT": str(free_port()) for name in ("ROUTER", "VIEWER", "VIEWER_DATA")
        },
    }
    another = str(free_port())
    ports = {"7447": more["MAZEBOT_ROUTER_PORT"], "7448": another}
    try:
        for example in some("services"):
            command = re.sub("744[78]", lambda port: ports[port[0]], filled(example))
            if program(example)[1] == "up":
                # A half that joins the other one needs it.
                if "--connect" not in command:
                    run("mazebot down", tmp_path, **more)
                # To follow a tour takes a minute.
                command += "" if "--detach" in command else " --detach"
            with subtests.test(str(example)):
                run(command, tmp_path, **more)
    finally:
        for port in (another, more["MAZEBOT_ROUTER_PORT"]):
            run(f"mazebot down --router-port {port}", tmp_path, **more)
        said = run("mazebot down", tmp_path, **more)
    assert said.startswith("no stack runs")


@contextmanager
def a_service(name: str, **more: str) -> Iterator[None]:
    """A service in a process of its own."""
    command = [sys.executable, "-m", f"mazebot.{name}"]
    process = subprocess.Popen(command, env=environment(**more), stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait(20.0)


@contextmanager
def a_goal(endpoint: str) -> Iterator[None]:
    """The robot is on its way, as somebody else's goal has it, and will be for a while."""
    control(endpoint, speed=0.5)
    process = subprocess.Popen(
        ["bash", "-c", "exec mazebot goal 3.322 -0.178 1.571"],
        env=environment(MAZEBOT_BUS_CONNECT=endpoint),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    with process.stdout as said:
        try:
            assert said.readline().startswith("driving to")
            yield
            assert process.wait(20.0) != 0
        finally:
            process.kill()
            process.wait()
            control(endpoint, speed=4.0)


def control(endpoint: str, **fields: object) -> None:
    session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
    try:
        reply = ask(session, SIMULATION_CONTROL, SimulationControl.model_validate(fields), 20.0)
        assert reply.error == ""
    finally:
        session.close()  # type: ignore[no-untyped-call]
