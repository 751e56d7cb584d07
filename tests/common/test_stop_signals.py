"""What stops a command, and what it can still write then."""

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.stop_signals import interrupt_held_back, stop_signals, stopped_by
from mazebot.embedded.demo import _stop_on_signal

COMMAND = """
import signal, sys
from mazebot.common.stop_signals import on_stop
stopped = []
on_stop(lambda number, _: stopped.append(number))
print("runs", flush=True)
while not stopped:
    signal.pause()
print("closing", flush=True)
sys.stderr.write("closed")
sys.stderr.flush()
open(sys.argv[1], "w").write(signal.Signals(stopped[0]).name)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_run_in_one_process_stops_by_any_of_them(number: signal.Signals) -> None:
    with stopped_by(lambda *_: None), _stop_on_signal() as stopped:
        signal.raise_signal(number)
    assert stopped == [number]


def test_the_end_of_the_terminal_is_ignored_where_nohup_has_it_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert stop_signals() == (signal.SIGINT, signal.SIGTERM)
        with stopped_by(lambda *_: None):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_command_closes_all_when_its_terminal_ends(tmp_path: Path) -> None:
    written = tmp_path / "written"
    process, terminal = pty.fork()
    if process == 0:
        os.execv(sys.executable, [sys.executable, "-c", COMMAND, str(written)])
    assert os.read(terminal, 100).startswith(b"runs")
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
    assert written.read_text() == "SIGHUP"


def test_what_is_no_terminal_is_written_on(tmp_path: Path) -> None:
    written = tmp_path / "written"
    command = [sys.executable, "-c", COMMAND, str(written)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "runs\n"
        process.send_signal(signal.SIGHUP)
        assert process.stdout.read() == "closing\n"
    assert process.returncode == 0


def test_what_is_to_be_whole_is_interrupted_at_its_end_and_the_second_time_at_once() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    done: list[int] = []

    def press(times: int) -> None:
        with interrupt_held_back():
            for number in range(times):
                signal.raise_signal(signal.SIGINT)
                done.append(number)

    try:
        for times in (1, 2):
            with pytest.raises(KeyboardInterrupt):
                press(times)
        assert done == [0, 0]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
