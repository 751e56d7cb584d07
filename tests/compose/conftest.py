"""The images, built once, before any test of containers."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT


class Build:
    """The image of a stanza, being built from this working tree; fast where nothing has changed."""

    def __init__(self, stanza: str, lock: Path) -> None:
        # Two workers that build at the same time make two images, and the second takes the name of
        # the first away from the containers that run by then.
        self._process = subprocess.Popen(
            ["flock", "--no-fork", lock, "docker", "compose", "build", "--quiet", stanza],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def await_end(self) -> None:
        """Return once it is built. Raises AssertionError if it cannot be."""
        _, said = self._process.communicate(timeout=1200)
        code = self._process.returncode
        assert code == 0, f"the image cannot be built (is Docker running?)\n{said}"

    def stop(self) -> None:
        """End it if nobody has waited for it."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.communicate()


@pytest.fixture(scope="session")
def builds(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Build]]:
    """The builds of all images that any test of this session needs, by the fixtures that wait for
    them. They run side by side: one waits for the network while the other one compiles. That of the
    bridge may go on beside the first tests, which judge no time.
    """
    # One name for all services, so that their image has the same identity each time.
    stanzas = {"image": "demo-world-enhanced", "bridge_image": "ros2-bridge"}
    needed = {name for item in request.session.items for name in getattr(item, "fixturenames", ())}
    locks = tmp_path_factory.getbasetemp().parent
    begun = {
        name: Build(stanza, locks / f"{stanza}.lock")
        for name, stanza in stanzas.items()
        if name in needed
    }
    yield begun
    for build in begun.values():
        build.stop()


@pytest.fixture(scope="session")
def image(builds: dict[str, Build]) -> str:
    """The image of all services."""
    builds["image"].await_end()
    return "mazebot"


@pytest.fixture(scope="session")
def bridge_image(builds: dict[str, Build]) -> str:
    """The image of the bridge to DDS."""
    builds["bridge_image"].await_end()
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
