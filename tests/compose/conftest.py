"""The image, built once, before any test of containers."""

import fcntl
import os
import subprocess
from collections.abc import Callable

import pytest

from mazebot.common.files.root import ROOT


def build(stanza: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Build the image of a stanza from this working tree; fast where nothing has changed."""
    command = ["docker", "compose", "build", "--quiet", stanza]
    # Two workers that build at the same time make two images, and the second takes the name of the
    # first away from the containers that run by then.
    with (tmp_path_factory.getbasetemp().parent / "image.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        built = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, timeout=1200, check=False
        )
    assert built.returncode == 0, f"the image cannot be built (is Docker running?)\n{built.stderr}"


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The image of all services."""
    # One name, so that the image has the same identity each time.
    build("demo-world-enhanced", tmp_path_factory)
    return "mazebot"


@pytest.fixture(scope="session")
def bridge_image(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The image of the bridge to DDS."""
    build("ros2-bridge", tmp_path_factory)
    return "mazebot-ros2"


@pytest.fixture(scope="session")
def person() -> int:
    """A person who is not root, where the tests may act for one: as root they may."""
    return 1000 if os.getuid() == 0 else os.getuid()


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Callable[[str, float], None]:
    """Notes a duration, to be printed below the results."""

    def note(what: str, seconds: float) -> None:
        request.node.user_properties.append(("measured", f"{what}: {seconds:.2f} s"))

    return note


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    lines = [
        line
        for outcome in ("passed", "failed")
        for report in terminalreporter.getreports(outcome)
        if report.when == "call"
        for name, line in report.user_properties
        if name == "measured"
    ]
    if lines:
        terminalreporter.section("measured")
    for line in lines:
        terminalreporter.write_line(line)
