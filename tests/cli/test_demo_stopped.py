"""A run in one process that is stopped: its exit code, its recording, and how to view that."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.embedded.demo import FIRST_STEP


def stopped_demo(folder: Path, number: signal.Signals, *options: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a run that a signal ends."""
    out = [] if "--out" in options else ["--out", "my run"]
    words = ["demo", "--world", "original", "--no-camera", *out, *options]
    # Without a router of its own it needs no port.
    with subprocess.Popen(
        [sys.executable, "-m", "mazebot.cli", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as run:  # fmt: skip
        assert run.stdout is not None
        assert run.stderr is not None
        log = run.stderr if "--json" in options else run.stdout
        for line in log:
            if FIRST_STEP in line:
                break
        run.send_signal(number)
        said, err = run.communicate(timeout=60.0)
    return run.returncode, said, err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_with_the_signals_exit_code_and_says_how_to_view_it(
    tmp_path: Path, number: signal.Signals
) -> None:
    code, out, _ = stopped_demo(tmp_path, number)
    assert code == 128 + number
    assert out.endswith("interrupted; recording closed\n")
    (command,) = (line for line in out.splitlines() if line.startswith("view it:"))
    program, *words = shlex.split(command.removeprefix("view it:"))
    assert words == ["recordings", "view", "my run"]
    shown = subprocess.run([program, "--version"], cwd=tmp_path, capture_output=True, check=True)
    assert shown.stdout


def test_in_json_it_is_the_same_exit_code(tmp_path: Path) -> None:
    code, out, _ = stopped_demo(tmp_path, signal.SIGTERM, "--json")
    assert (code, json.loads(out)["exit_code"]) == (143, 143)


def test_a_run_that_found_no_room_on_the_disk_says_that_it_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_MIN_FREE_MIB", str(2**30))
    why = f"none: less than {2**30} MiB are free"
    _, out, _ = stopped_demo(tmp_path, signal.SIGTERM, "--json")
    assert json.loads(out)["unrecorded"] == why
    _, out, _ = stopped_demo(tmp_path, signal.SIGTERM, "--out", "another run")
    assert f"recording: {why}\n" in out
