"""The console as a process, as `mazebot console` and a container start it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT
from mazebot.console.config import ConsoleConfig
from mazebot.console.health import is_healthy
from mazebot.embedded.demo import beside_run
from mazebot.recorder.config import RecorderConfig
from tests.console.conftest import FIRST
from tests.console.runs import make_run
from tests.console.served import Served


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(
            ("mazebot.cli", "console", "--dir", "runs", "--port", "0", "--no-live"),
            marks=pytest.mark.slow,
        ),
        ("mazebot.console", "--recordings-dir", "runs", "--port", "0", "--live", "false"),
    ],
)
def test_the_console_says_its_address_and_ends_by_a_signal(
    tmp_path: Path, command: tuple[str, ...]
) -> None:
    make_run(tmp_path / "runs", FIRST)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "services"), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            match = re.fullmatch(
                r"\[INFO\] \[console\]: http://localhost:(\d+)/ shows runs\n", line
            )
            assert match, line
            served = Served(int(match[1]), tmp_path)
            assert FIRST in served.ask("/runs").text
            assert is_healthy(served.port)
            process.send_signal(signal.SIGTERM)
            assert process.stdout.read() == ""
            assert process.wait(10.0) in (0, -signal.SIGTERM)
        finally:
            process.kill()
    assert not is_healthy(served.port)


def test_the_console_beside_a_run_shows_that_run(tmp_path: Path) -> None:
    run = RecorderConfig(recordings_dir=tmp_path / "runs", grpc_port=9000)
    shown = beside_run(ConsoleConfig(port=0), run)
    assert (shown.port, shown.recordings_dir, shown.live_data_port) == (0, tmp_path / "runs", 0)
    elsewhere = run.model_copy(update={"out_dir": tmp_path / "other" / "run", "live": True})
    shown = beside_run(ConsoleConfig(), elsewhere)
    assert (shown.recordings_dir, shown.live_data_port) == (tmp_path / "other", 9000)
    told = ConsoleConfig(recordings_dir=tmp_path, live_data_port=9001)
    assert beside_run(told, elsewhere) == told
