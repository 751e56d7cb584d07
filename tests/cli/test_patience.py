"""What is seen of a command while it loads what it needs, and while it works."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mazebot.cli.__main__ import GROUPS, named
from mazebot.cli.app import app
from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.parsing.patience import patience, say_first, wait_quietly
from mazebot.cli.replay.progress import shown
from tests.cli.stack.running import wait_until
from tests.cli.test_app import mazebot


@pytest.fixture(autouse=True)
def progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a person has it, unlike the other tests."""
    monkeypatch.delenv("MAZEBOT_PROGRESS")


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
    for name in ("_PERIOD_S", "_LINE_PERIOD_S", "_SILENCE_S"):
        monkeypatch.setattr(f"mazebot.cli.parsing.patience.{name}", 0.05)
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


def test_after_a_first_line_a_silence_is_broken_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot replay"):
        say_first("reading a run")
        assert screen(terminal.getvalue()) == ["reading a run", ""]
        wait_until(lambda: "replay: working" in terminal.getvalue())
        sys.stdout.write("all well\n")
    assert screen(terminal.getvalue()) == ["reading a run", "all well", ""]


def test_a_line_that_has_not_ended_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot recordings delete"):
        sys.stdout.write("Delete it? [y/N]: ")
        time.sleep(0.2)
    assert terminal.getvalue() == "Delete it? [y/N]: "


def test_a_command_that_waits_for_others_shows_nothing_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot console"):
        sys.stdout.write("open http://localhost:8080\n")
        wait_quietly()
        time.sleep(0.2)
    assert terminal.getvalue() == "open http://localhost:8080\n"


def test_a_quick_command_shows_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = a_terminal(monkeypatch)
    with patience("mazebot ps"):
        sys.stdout.write("service\n")
    assert terminal.getvalue() == "service\n"


def test_a_pipe_gets_lines_on_standard_error_and_the_output_alone_on_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a_terminal(monkeypatch)
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr("sys.stdout", out)
    monkeypatch.setattr("sys.stderr", err)
    with patience("mazebot goal"):
        wait_until(lambda: err.getvalue().count("\n") >= 2)
        with ProgressLine(wanted=False) as line:
            line.show("0.5 m left")
            wait_until(lambda: "left" in err.getvalue())
        sys.stdout.write("reached\n")
    lines = err.getvalue().splitlines()
    assert lines[0] == "mazebot goal: working"
    assert "mazebot goal: 0.5 m left" in lines
    assert out.getvalue() == "reached\n"


def test_a_reader_that_has_gone_does_not_end_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr("sys.stderr", Gone())
    before = threading.active_count()
    with patience("mazebot plan"):
        wait_until(lambda: threading.active_count() == before)
        sys.stdout.write("length 3 m\n")


def test_nothing_is_shown_below_what_a_shell_completes(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = a_terminal(monkeypatch)
    monkeypatch.setenv("_MAZEBOT_COMPLETE", "complete_bash")
    with patience("mazebot"):
        time.sleep(0.2)
    assert terminal.getvalue() == ""


def test_a_command_is_named_with_its_group() -> None:
    assert {group.name for group in app.registered_groups} == set(GROUPS)
    assert named(["x/mazebot", "map", "build", "--log"]) == "mazebot map build"
    assert named(["mazebot", "demo", "original"]) == "mazebot demo"
    assert named(["mazebot", "--version"]) == "mazebot"


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


def test_a_replay_tells_a_file_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    a_terminal(monkeypatch)
    err = io.StringIO()
    monkeypatch.setattr("sys.stderr", err)
    with patience("mazebot replay"), shown(1_000_000_000, 9_000_000_000) as watch:
        watch(3_000_000_000)
        wait_until(lambda: "mazebot replay: 2.0 of 8.0 s replayed\n" in err.getvalue())


def test_a_command_in_a_pipe_is_seen_before_it_has_loaded_anything() -> None:
    script = (
        "import sys\n"
        "from mazebot.cli.parsing import patience\n"
        "patience._LINE_AFTER_S = 0.0\n"
        "import threading\n"
        "show = patience._Line._show\n"
        "def shown(*given):\n"
        "    print(any('typer' in name for name in sys.modules), file=sys.__stdout__)\n"
        "    return show(*given) and False\n"
        "patience._Line._show = shown\n"
        "from mazebot.cli.__main__ import main\n"
        "sys.argv = ['mazebot', '--version']\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60.0
    )
    assert done.stdout.splitlines()[0] == "False"
    assert done.stderr == "mazebot: working\n"


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
