"""Standard output that is closed, full, or for the letters of ASCII alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def mazebot(arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command in a shell."""
    quiet = {"MAZEBOT_PROGRESS": "false", **environment}
    return subprocess.run(
        ["sh", "-c", f"{sys.executable} -m mazebot.cli {arguments}"],
        capture_output=True, text=True, check=False, env={**os.environ, **quiet},
    )  # fmt: skip


@pytest.mark.parametrize(("arguments", "progress", "reason"), [
    ("--version >&-", "false", "Bad file descriptor"),
    ("--version >&-", "true", "Bad file descriptor"),
    ("--version >/dev/full", "true", "No space left on device"),
    ("--help >/dev/full", "false", "No space left on device"),
])  # fmt: skip
def test_output_that_cannot_be_written_is_one_line(
    arguments: str, progress: str, reason: str
) -> None:
    done = mazebot(arguments, MAZEBOT_PROGRESS=progress)
    lines = [line for line in done.stderr.splitlines() if "working" not in line]
    assert lines == [f"error: standard output: cannot be written: {reason}"]
    assert done.returncode == 2


def test_a_mistake_is_told_where_the_output_is_closed() -> None:
    done = mazebot("goal nowhere --json >&-")
    mistake, output = done.stderr.splitlines()
    assert "nowhere" in mistake
    assert output.startswith("error: standard output: cannot be written: ")
    assert done.returncode == 2


def test_without_standard_error_a_command_works() -> None:
    done = mazebot("--version 2>&-", MAZEBOT_PROGRESS="true")
    assert done.stdout.startswith("mazebot ")
    assert done.returncode == 0


def test_a_letter_that_the_output_does_not_have_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "küche").mkdir()
    asked = f"recordings list --dir {tmp_path}/küche"
    done = mazebot(asked, PYTHONUTF8="0", PYTHONIOENCODING="ascii")
    assert done.stderr == ""
    assert done.stdout.startswith("no recordings in ")
    assert "k?che" in done.stdout
    assert done.returncode == 0
