"""`mazebot teleop`: its keys, and the command in a terminal of its own."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.cli.drive.teleop_keys import (
    FIRST_PRESS_S,
    HELD,
    LEAVE_KEYS,
    REPEAT_S,
    SCALED,
    STEPPED,
    STOP_KEYS,
    TABLE,
    Teleop,
    split_keys,
)
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.topics import CMD_VEL_TELEOP
from mazebot.common.messages.wire import decode
from mazebot.common.robot.waffle import MAX_LINEAR_M_S

DEADLINE_S = 30.0


def test_no_key_has_two_meanings_and_each_is_in_the_table() -> None:
    keys = [*HELD, *STEPPED, *STOP_KEYS, *SCALED, "q"]
    assert len(keys) == len(set(keys))
    words = TABLE.replace(":", " ").replace(",", " , ").split()
    for key in keys:
        assert {" ": "space"}.get(key, key) in words, key


def test_a_held_key_drives_until_it_is_released() -> None:
    state = Teleop(0.2, 1.0)
    state.press("up", 0.0)
    assert state.command(FIRST_PRESS_S - 0.01) == (0.2, 0.0)
    # The terminal repeats it.
    state.press("up", 0.5)
    assert state.command(0.5 + REPEAT_S - 0.01) == (0.2, 0.0)
    assert state.command(0.5 + REPEAT_S) == (0.0, 0.0)
    state.press("o", 2.0)
    assert state.command(2.1) == (0.2, -1.0)
    state.press("k", 2.2)
    assert state.command(2.2) == (0.0, 0.0)


def test_a_stepped_speed_stays_until_a_stop_or_a_held_key() -> None:
    state = Teleop()
    for _ in range(5):
        state.press("w", 0.0)
    state.press("a", 0.0)
    assert state.command(100.0) == (0.05, 0.1)
    state.press("x", 0.0)
    assert state.command(0.0) == (0.04, 0.1)
    state.press("s", 0.0)
    assert state.command(0.0) == (0.0, 0.0)
    state.press("w", 1.0)
    state.press("left", 1.0)
    assert state.command(1.0) == (0.0, 1.0)
    assert state.command(9.0) == (0.0, 0.0)
    for _ in range(100):
        state.press("w", 0.0)
    assert state.command(0.0)[0] == MAX_LINEAR_M_S


@pytest.mark.parametrize("key", LEAVE_KEYS)
def test_leaving_stops(key: str) -> None:
    state = Teleop()
    state.press("w", 0.0)
    state.press(key, 0.0)
    assert state.leaves
    assert state.command(0.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "keys", "rest"),
    [
        ("\x1b[Aw", ["up", "w"], ""),
        ("\x1bOD\x1b[1;5C", ["left", "right"], ""),
        ("i\x1b[", ["i"], "\x1b["),
        ("\x1b", [], "\x1b"),
        ("\x1b[3~s", ["s"], ""),
        ("\x1bi", ["i"], ""),
    ],
)
def test_keys_are_told_apart(text: str, keys: list[str], rest: str) -> None:
    assert split_keys(text) == (keys, rest)


class Terminal:
    """The command in a pseudo terminal, and what it publishes."""

    def __init__(self, endpoint: str) -> None:
        self.commands: list[tuple[float, float]] = []
        self.session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
        self._kept = [
            self.session.liveliness().declare_token(alive_key("navigation", "a")),
            subscribe(self.session, CMD_VEL_TELEOP, self._take),
        ]
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "mazebot.cli", "teleop", "--connect", endpoint],
            stdin=self.slave, stdout=self.slave, stderr=self.slave, start_new_session=True,
        )  # fmt: skip
        self.said = ""

    def _take(self, payload: bytes, _: object) -> None:
        twist = decode(CMD_VEL_TELEOP, payload).twist
        self.commands.append((twist.linear.x, twist.angular.z))

    def read_until(self, words: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while words not in self.said:
            assert time.monotonic() < end_s, self.said
            if select.select([self.master], [], [], 0.2)[0]:
                self.said += os.read(self.master, 4096).decode()

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def await_command(self, command: tuple[float, float]) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while command not in self.commands:
            assert time.monotonic() < end_s, self.commands
            time.sleep(0.02)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.session.close()  # type: ignore[no-untyped-call]
        for fd in (self.master, self.slave):
            os.close(fd)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as endpoint:
        yield endpoint


@pytest.fixture
def terminal(endpoint: str) -> Iterator[Terminal]:
    with contextlib.closing(Terminal(endpoint)) as terminal:
        yield terminal


@pytest.mark.parametrize("leave", ["q", "TERM"])
def test_keys_drive_and_the_terminal_is_as_before(terminal: Terminal, leave: str) -> None:
    terminal.read_until("quit: q")
    terminal.read_until("linear +0.00")
    assert not termios.tcgetattr(terminal.slave)[3] & termios.ECHO
    terminal.press("\x1b[A")
    terminal.await_command((0.2, 0.0))
    terminal.await_command((0.0, 0.0))
    terminal.press("wa")
    terminal.await_command((0.01, 0.1))
    if leave == "TERM":
        terminal.process.send_signal(signal.SIGTERM)
    else:
        terminal.press(leave)
    code = terminal.process.wait(timeout=DEADLINE_S)
    assert code == {"q": 0, "TERM": 143}[leave]
    terminal.commands[:-1] = []
    terminal.await_command((0.0, 0.0))
    assert termios.tcgetattr(terminal.slave) == terminal.before
