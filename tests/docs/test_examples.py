"""What the pages show works as it stands there."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from mazebot import Session
from mazebot.common.files.root import ROOT
from tests.docs.pages import Example, blocks
from tests.docs.stack import running_stack

PYTHON = blocks("python")
LONG = {"controllers.md", "navigator.md", "own-controller.md"}
"""Pages whose programs drive for a minute."""
AHEAD_IS_FREE = (0.5, 0.0, -1.57)
"""A pose with 1.27 m of free floor before it."""
IN_PROCESS = [
    pytest.param(one, marks=[pytest.mark.slow] if one.page.name in LONG else [], id=str(one))
    for one in PYTHON
    if "zenoh.open" not in one.text
]


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_stack(pace="1", goal=AHEAD_IS_FREE) as running:
        yield running


def run(code: str, folder: Path) -> str:
    (folder / "examples").symlink_to(ROOT / "examples")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT / "services")},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_calls_in_the_table_of_a_session_are_there() -> None:
    page = (ROOT / "docs" / "own-controller.md").read_text()
    table = page.split("| call |")[1].split("\n\n")[0]
    rows = [row.split("|")[1] for row in table.splitlines()[2:]]
    calls = re.findall(r"`(\w+)[(`]", "".join(rows))
    assert len(calls) >= len(rows)
    assert [call for call in calls if not hasattr(Session, call)] == []


@pytest.mark.slow
@pytest.mark.parametrize("example", IN_PROCESS)
def test_a_program_in_the_pages_runs(example: Example, tmp_path: Path) -> None:
    said = run(example.text, tmp_path)
    if "wall_follower" in example.text:
        assert said.startswith("0 contacts"), said


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.parametrize("example", [one for one in PYTHON if "zenoh.open" in one.text], ids=str)
def test_a_program_in_the_pages_drives_a_running_stack(
    example: Example, endpoint: str, tmp_path: Path
) -> None:
    said = run(example.text.replace("tcp/127.0.0.1:7447", endpoint), tmp_path)
    ahead_m = float(said.split()[1])
    # It has driven up to something and stopped there.
    assert 0.3 < ahead_m < 0.55, said
