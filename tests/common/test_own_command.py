"""Commands that are printed to be pasted."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.own_command import own_command


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed `mazebot` that prints its words, one a line; not on the path."""
    file = tmp_path / "my clone" / "bin" / "mazebot"
    file.parent.mkdir(parents=True)
    file.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    file.chmod(0o755)
    monkeypatch.setattr("sysconfig.get_path", lambda _: str(file.parent))
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.chdir(tmp_path)
    return file


def pasted(command: str) -> list[str]:
    return subprocess.run(
        ["/bin/sh", "-c", command], check=True, capture_output=True, text=True
    ).stdout.splitlines()


@pytest.mark.parametrize("beside", ["my clone", "my clone/bin", "elsewhere"])
def test_it_does_in_a_shell_what_it_says_from_any_folder(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beside: str
) -> None:
    (tmp_path / beside).mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path / beside)
    words = ["recordings", "view", "my run; ü $HOME"]
    assert pasted(own_command(*words)) == words
    assert (own_command("demo") == "bin/mazebot demo") is (beside == "my clone")


def test_it_is_named_alone_where_it_is_on_the_path(
    script: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{script.parent}:/usr/bin:/bin")
    assert own_command("recordings", "view", Path("a")) == "mazebot recordings view a"


def test_without_a_script_it_is_the_module(script: Path) -> None:
    script.unlink()
    assert shlex.split(own_command("demo")) == [sys.executable, "-m", "mazebot.cli", "demo"]
