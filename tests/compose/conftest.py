"""The images, built once, before any test of containers."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable

import pytest

from mazebot.common.files.root import ROOT

STANZAS = {"image": "demo-world-enhanced", "bridge_image": "ros2-bridge"}
"""By the fixtures of the images. One name for all services, so that their image has the same
identity each time.
"""
BUILD = ("docker", "compose", "build", "--quiet")
BUILD_S = 1200.0


@pytest.fixture(scope="session")
def images(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> None:
    """All images that any test of this session needs, built from this working tree before the first
    one: side by side, for one waits for the network while the other one compiles. Fast where
    nothing has changed.
    """
    needed = {name for item in request.session.items for name in getattr(item, "fixturenames", ())}
    locks = tmp_path_factory.getbasetemp().parent
    builds = [
        # Two workers that build at the same time make two images, and the second takes the name of
        # the first away from the containers that run by then.
        subprocess.Popen(
            [*("flock", "--no-fork", locks / stanza), *BUILD, stanza],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name, stanza in STANZAS.items()
        if name in needed
    ]
    try:
        for build in builds:
            _, said = build.communicate(timeout=BUILD_S)
            assert build.returncode == 0, f"no image was built (is Docker running?)\n{said}"
    finally:
        for build in builds:
            build.terminate()


@pytest.fixture(scope="session")
def image(images: None) -> str:
    """The image of all services."""
    return "mazebot"


@pytest.fixture(scope="session")
def bridge_image(images: None) -> str:
    """The image of the bridge to DDS."""
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
