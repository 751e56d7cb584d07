"""What `docker compose` does with other words, and with wrong ones."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from importlib.metadata import version as version_of
from pathlib import Path

import pytest

from mazebot.common.bus.subscriber import subscribe
from mazebot.common.files.root import ROOT
from mazebot.common.messages.documents import World
from mazebot.common.messages.topics import WORLD
from mazebot.common.messages.wire import decode
from tests.compose.checks import ACTIVE, check_recordings, is_active
from tests.compose.stack import DEMOS, PROFILES, SERVICES, Stack, stack_of, wait_until
from tests.compose.test_file import gate_of

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]


@pytest.fixture
def stack(person: int) -> Iterator[Stack]:
    with stack_of(person) as stack:
        yield stack


def running_world(stack: Stack) -> World:
    """The world that a stack has loaded."""
    session = stack.session(10.0)
    worlds: list[World] = []
    subscription = subscribe(session, WORLD, lambda data, _: worlds.append(decode(WORLD, data)))
    wait_until(lambda: bool(worlds), 20.0, "a world")
    del subscription
    session.close()  # type: ignore[no-untyped-call]
    return worlds[0]


def test_a_bare_up_starts_nothing_and_says_what_to_do(stack: Stack) -> None:
    refused = stack.compose("up")
    assert refused.returncode != 0
    (line,) = refused.stdout.strip().splitlines()
    assert "NAME A DEMO: demo-world, demo-world-enhanced, slam-world or slam-world-enhanced" in line
    assert stack.containers() == []


@pytest.mark.parametrize("name", ["console", *DEMOS.values(), "slam-world", "slam-world-enhanced"])
def test_the_name_of_what_one_starts_builds_the_image(name: str, tmp_path: Path) -> None:
    # Under another name: the image has the service's as a label, so that a stack that runs by then
    # would find another image at its next `up`, and start all containers anew.
    other = tmp_path / "other.yaml"
    other.write_text(json.dumps({"services": {name: {"image": BY_NAME}}}))
    built = subprocess.run(
        ["docker", "compose", "-f", "docker-compose.yaml", "-f", str(other), "build", name],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=1200,
        check=False,
    )
    assert built.returncode == 0, built.stdout
    assert f"naming to docker.io/library/{BY_NAME}" in built.stdout
    # Another service's build before this one has left nothing to do.
    steps = dict(re.findall(r"^#(\d+) \[.*\] (?:RUN|COPY) (.*)$", built.stdout, re.MULTILINE))
    assert steps
    cached = set(re.findall(r"^#(\d+) CACHED$", built.stdout, re.MULTILINE))
    assert {step: steps[step] for step in steps.keys() - cached} == {}


BY_NAME = "mazebot-by-name"
IN_IMAGE = """
import json, os, shutil, stat
programs = ("sh", "bash", "perl", "apt-get", "dpkg", "pip", "pip3", "su", "mount", "curl", "wget")
risen = []
for top in ("/bin", "/etc", "/home", "/lib", "/opt", "/sbin", "/srv", "/usr", "/var"):
    for folder, _, names in os.walk(top):
        for path in (os.path.join(folder, name) for name in names):
            mode = os.lstat(path).st_mode
            if stat.S_ISREG(mode) and mode & (stat.S_ISUID | stat.S_ISGID):
                risen.append(path)
print(json.dumps([[one for one in programs if shutil.which(one)], risen, os.listdir("/usr/bin")]))
"""


def run_in_image(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["docker", "run", "--rm", "--read-only", "--tmpfs", "/tmp", "mazebot", *command],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


def test_there_is_no_shell_in_the_image_and_nothing_that_makes_a_program_another_user_s() -> None:
    programs, risen, kept = json.loads(run_in_image("python", "-c", IN_IMAGE).stdout)
    assert (programs, risen) == ([], [])
    assert {name for name in kept if not name.startswith("python3")} <= {"tini"}
    unknown = run_in_image("sh")
    assert unknown.returncode == 127
    assert unknown.stderr == "error: sh: No such file or directory\n"


def test_the_image_says_what_it_is_made_of() -> None:
    bill = json.loads(run_in_image("sbom").stdout)
    of_debian = {one["name"] for one in bill["components"] if one["purl"].startswith("pkg:deb/")}
    parts = {
        one["name"].lower().replace("_", "-"): one
        for one in bill["components"]
        if one["purl"].startswith("pkg:pypi/")
    }
    locked = re.findall(
        r"^([\w.-]+)==(\S+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE
    )
    for name, version in locked:
        part = parts.get(name)
        # Some are for other systems.
        assert part is None or part["version"] == version, name
    assert {"eclipse-zenoh", "numpy", "pybullet", "rerun-sdk"} <= parts.keys()
    assert {"libc6", "tini"} <= of_debian
    assert bill["metadata"]["component"]["name"] == "mazebot"
    assert not [
        reference
        for one in bill["components"]
        for reference in one.get("externalReferences", ())
        if reference["type"] == "distribution"
    ]
    inspected = subprocess.run(
        ["docker", "image", "inspect", "--format", "{{json .Config.Labels}}", "mazebot"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    labels = json.loads(inspected.stdout)
    assert labels["org.opencontainers.image.version"] == version_of("mazebot")
    assert labels["org.opencontainers.image.version"] == bill["metadata"]["component"]["version"]


def test_the_tutorial_s_commands_word_for_word(stack: Stack) -> None:
    with (stack.folder / "output").open("wb") as output:
        stack.in_foreground(output, "up", "demo-world-enhanced")
    command = 'docker compose logs demo-world-enhanced | grep "Managed nodes are active"'
    wait_until(lambda: stack.shell(command).stdout.count(ACTIVE) == 2, 90.0, command)
    containers = {name: stack.inspect(name)["Id"] for name in SERVICES}
    # Nothing is started anew by what starts the same demo a second time.
    again = stack.compose("up", "--detach", "demo-world-enhanced")
    assert again.returncode == 0, again.stdout
    assert {name: stack.inspect(name)["Id"] for name in SERVICES} == containers


def test_one_service_comes_up_alone_and_says_what_it_waits_for(stack: Stack) -> None:
    assert stack.compose("up", "--detach", "physics").returncode == 0
    assert stack.containers() == ["physics", "router"]
    wait_until(lambda: "waiting for a world" in stack.logs("physics"), 20.0, "its word")
    assert stack.down() <= 5.0
    assert stack.containers() == []


def test_each_demo_s_profile_starts_what_it_needs(stack: Stack) -> None:
    for profile, demo in DEMOS.items():
        enabled = stack.compose("--profile", profile, "config", "--services").stdout.split()
        assert sorted(enabled) == sorted([*SERVICES, demo, gate_of(demo)])
    both = stack.compose(*PROFILES, "config", "--services").stdout.split()
    assert "nothing-named" not in both


def on_walls(world: World) -> set[str]:
    """The sha256 of the textures of a world's walls."""
    names = {wall.material for wall in world.walls}
    return {one.texture_sha256 for one in world.materials if one.name in names}


def test_a_profile_a_seed_and_no_markers(person: int) -> None:
    settings = {"USE_ARUCO": "False", "SEED": "8"}
    with stack_of(person, settings) as stack:
        started = stack.compose("--profile", "enhanced", "up", "--detach")
        assert started.returncode == 0, started.stdout
        wait_until(lambda: is_active(stack, DEMOS["enhanced"]), 60.0, "both lines")
        world = running_world(stack)
        assert not world.markers
        assert {wall.height_m for wall in world.walls} == {3.0}
        assert all(on_walls(world))
        assert "recording to" in (log := stack.logs("recorder")), log
        # In the middle of the drive.
        assert stack.down() <= 5.0
        assert stack.containers() == []
        (summary,) = check_recordings(stack)
        assert summary["seed"] == 8


def test_two_stacks_run_side_by_side(person: int) -> None:
    with stack_of(person) as one, stack_of(person) as other:
        for stack in (one, other):
            started = stack.compose("up", "--detach", "physics", "recorder")
            assert started.returncode == 0, started.stdout
        wait_until(lambda: "waiting" in one.logs("physics"), 30.0, "one up")
        wait_until(lambda: "waiting" in other.logs("physics"), 30.0, "the other up")
        one.down()
        assert other.inspect("physics")["State"]["Running"]


MISTAKES = (
    ({"WORLD_NAME": "no_such_house"}, "no_such_house"),
    ({"USE_ARUCO": "perhaps"}, "use_aruco"),
)
"""Settings, and what the line that is printed has in it."""


def test_a_mistake_in_a_setting_is_told_in_one_line_and_textures_of_one_s_own_are_taken(
    person: int,
) -> None:
    """Of the stack in which a demo ended, the next one uses all that runs."""
    demo = DEMOS["enhanced"]
    with stack_of(person, {"TEXTURE_BASE": "./mine"}) as stack:
        mine = stack.folder / "mine"
        shutil.copytree(ROOT / "worlds" / "textures", mine)
        # Concrete in place of bricks: one texture less in the world.
        shutil.copy(mine / "concrete.png", mine / "bricks.png")
        for path in (mine, *mine.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)

        def ended() -> bool:
            return bool(stack.inspect(demo)["State"]["Status"] == "exited")

        for settings, reason in MISTAKES:
            stack.compose("up", "--detach", demo, settings=settings)
            wait_until(ended, 60.0, "the demo to end")
            assert stack.inspect(demo)["State"]["ExitCode"] == 2
            errors = [
                line
                for line in stack.logs(demo).splitlines()
                if line.lower().startswith(("error", "[error]"))
            ]
            assert len(errors) == 1
            assert reason in errors[0]
        stack.compose("up", "--detach", demo)
        assert len(on_walls(running_world(stack))) == 2


def test_a_folder_of_textures_that_is_not_there_is_not_made(person: int) -> None:
    with stack_of(person, {"TEXTURE_BASE": "./no-such-folder"}) as stack:
        refused = stack.compose("up", "--detach", "worldgen")
        assert refused.returncode != 0
        assert "no-such-folder" in refused.stdout.strip().splitlines()[-1]
        assert not (stack.folder / "no-such-folder").exists()


def test_a_port_that_is_taken_is_named(person: int) -> None:
    with stack_of(person) as one, stack_of(person) as other:
        assert one.compose("up", "--detach", "router").returncode == 0
        other.router_port = one.router_port
        refused = other.compose("up", "--detach", "router")
        assert refused.returncode != 0
        assert str(one.router_port) in refused.stdout.strip().splitlines()[-1]


@pytest.mark.skipif(os.getuid() != 0, reason="only root may take a folder away from its owner")
def test_a_recordings_folder_of_someone_else_is_told_in_one_line(person: int) -> None:
    with stack_of(person) as stack:
        os.chown(stack.recordings, 4242, 4242)
        stack.recordings.chmod(0o755)
        stack.compose("up", "--detach", "recorder")
        wait_until(lambda: "not writable" in stack.logs("recorder"), 30.0, "the reason")
        first = stack.logs("recorder").strip().splitlines()[0]
        assert "/recordings" in first
        assert "Traceback" not in stack.logs("recorder")
