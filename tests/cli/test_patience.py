"""What is seen of a command while it loads what it needs, and while it works."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mazebot.cli.parsing.patience import patience, say_first
from mazebot.cli.replay.progress import shown
from tests.cli.stack.running import wait_until
from tests.cli.test_app import mazebot


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def a_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A terminal on which a second passes at once, for both streams. Not a fixture: after those,
    pytest sets the streams.
    """
    stream = Terminal()
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr("mazebot.cli.parsing.patience._PERIOD_S", 0.01)
    return stream


def screen(text: str) -> list[str]:
    """The lines that are left of what a terminal got."""
    return [re.split(r"\r\x1b\[K", line)[-1] for line in text.split("\n")]


def test_a_command_that_says_nothing_is_seen_to_work_until_it_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot plan"):
        wait_until(terminal.getvalue)
        assert "mazebot plan: working" in screen(terminal.getvalue())
        sys.stdout.write("length 3 m\n")
        time.sleep(0.1)
        sys.stdout.write("5 poses\n")
    assert screen(terminal.getvalue()) == ["length 3 m", "5 poses", ""]
    assert sys.stdout is terminal


def test_the_time_that_it_has_worked_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = a_terminal(monkeypatch)
    begin_s = time.monotonic()
    with patience("mazebot plan"):
        monkeypatch.setattr("time.monotonic", lambda: begin_s + 3.2)
        wait_until(lambda: "working, 3 s" in terminal.getvalue())
        assert "mazebot plan: working, 3 s" in screen(terminal.getvalue())
    assert screen(terminal.getvalue()) == [""]


def test_a_quick_command_shows_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot ps"):
        sys.stdout.write("service\n")
    assert terminal.getvalue() == "service\n"


def test_a_file_gets_the_output_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setattr("sys.stderr", stream)
    with patience("mazebot plan"):
        time.sleep(0.2)
        assert sys.stdout is stream
    assert stream.getvalue() == ""


def test_the_first_line_is_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    say_first("reading a run")
    say_first("reading a run", as_json=True)
    assert capsys.readouterr().out == "reading a run\n"


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (("demo", "--world", "atlantis"), "starting the services for world atlantis"),
        (("up", "--world", "atlantis"), "starting the services for world atlantis"),
        (("replay", "nothing", "--service", "navigation"), "reading nothing"),
        (("map", "build", "--log", "nothing.csv", "--out", "made"), "reading nothing.csv"),
    ],
)
def test_a_long_command_says_at_once_what_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], first: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert mazebot(*words).stdout == f"{first}\n"


def test_a_replay_tells_a_file_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mazebot.cli.replay.progress._LINE_PERIOD_S", 0.0)
    for lines, said in ((True, "replay: 2.0 of 8.0 s\n"), (False, "")):
        with shown(1_000_000_000, 9_000_000_000, lines) as watch:
            watch(3_000_000_000)
        assert capsys.readouterr().err == said


def test_a_command_on_a_terminal_is_seen_before_its_result(tmp_path: Path) -> None:
    main_end, person = pty.openpty()
    command = [sys.executable, "-m", "mazebot.cli", "world", "check", "original"]
    with subprocess.Popen(command, stdout=person, stderr=person, stdin=person) as process:
        os.close(person)
        said = b""
        # Reading fails when the program has closed the terminal.
        try:
            while data := os.read(main_end, 65536):
                said += data
        except OSError:
            pass
        assert process.wait(60.0) == 0
    os.close(main_end)
    begin, end = said.decode().replace("\r\n", "\n").split("\r\x1b[K", 1)[1].rsplit("\x1b[K", 1)
    assert begin.startswith("mazebot world check: working")
    assert end.startswith("original: ")
