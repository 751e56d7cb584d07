"""A recorder that is killed leaves what it had, and the next one makes it whole."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from services.common.root import ROOT
from services.recorder.config import RecorderConfig
from services.recorder.node import RecorderNode
from services.recorder.repair import Repair, leftovers
from services.recorder.run_folder import LOCK, RunFolder
from tests.recorder.test_node import entities_of, recorder, verify

KILLED = """
import os, signal, sys, time
from pathlib import Path
from services.recorder.config import RecorderConfig
from services.recorder.node import RecorderNode
from tests.recorder.synthetic import Bench, driving, opening, room
node = RecorderNode(RecorderConfig(recordings_dir=Path(sys.argv[1])))
bench, world = Bench(node), room()
bench.say(opening(world))
bench.say(driving(world, 2.0))
time.sleep(0.1)
bench.node._run._flush()
print("driving", flush=True)
signal.pause()
"""


def until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_a_killed_recording_is_made_whole_by_the_next_recorder(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        assert leftovers(tmp_path) == []  # its recorder lives
        process.send_signal(signal.SIGKILL)
    (run,) = tmp_path.iterdir()
    with pytest.raises(AssertionError, match="footer"):
        verify(run / "run.rrd")
    assert leftovers(tmp_path) == [run]
    (run / "summary.json").touch()
    node = recorder(tmp_path)
    until(lambda: not (run / LOCK).exists())
    node.close()
    verify(run / "run.rrd")
    drawn = entities_of(run / "run.rrd")
    assert "/camera/color/image_raw: " in drawn
    assert "/ground_truth/odom: " in drawn
    assert {path.name for path in run.iterdir()} == {
            "run.rrd", "config.yaml", "summary.json", "digests.bin",
        }  # fmt: skip


def test_sigterm_ends_a_recording_whole(tmp_path: Path) -> None:
    script = KILLED.replace(
        "signal.pause()",
        # A signal that comes before it is waited for must count as well.
        "import threading; told = threading.Event()\n"
        "signal.signal(signal.SIGTERM, lambda *_: told.set()); print('ready', flush=True)\n"
        "while not told.wait(0.05): pass\n"
        "node.close()",
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        assert process.stdout.readline() == b"ready\n"
        process.terminate()
        start_s = time.monotonic()
        assert process.wait(10.0) == 0
    assert time.monotonic() - start_s < 5.0
    (run,) = tmp_path.iterdir()
    verify(run / "run.rrd")
    assert not (run / LOCK).exists()


def test_what_cannot_be_read_is_left_as_it_is(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / LOCK).touch()
    (folder / "run.rrd").write_bytes(b"nothing of Rerun's" * 100)
    Repair(tmp_path).run()
    assert (folder / "run.rrd").read_bytes().startswith(b"nothing of Rerun's")
    assert "cannot be repaired" in caplog.text
    assert leftovers(tmp_path) == []  # nobody tries again


def test_a_folder_is_locked_until_its_run_is_whole(tmp_path: Path) -> None:
    folder = RunFolder.exactly(tmp_path / "run")
    assert leftovers(tmp_path) == []
    other = RunFolder.exactly(tmp_path / "run")
    assert other.path.name == "run_2"
    folder.release()
    other.release()
    assert list(tmp_path.glob(f"*/{LOCK}")) == []


def test_repair_can_be_told_to_leave_the_folder_alone(tmp_path: Path) -> None:
    folder = tmp_path / "left"
    folder.mkdir()
    (folder / LOCK).touch()
    node = RecorderNode(RecorderConfig(recordings_dir=tmp_path, repair=False))
    node.close()
    assert leftovers(tmp_path) == [folder]
