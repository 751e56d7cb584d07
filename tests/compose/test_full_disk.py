"""A tour whose recordings' disk is full for a while, as the recorder's container meets it."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.compose.checks import check_recordings, check_table
from tests.compose.stack import DEMOS, Stack, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["original"]
DISK_MIB = 256
_MIB = 1024 * 1024


@pytest.fixture
def stack(person: int) -> Iterator[Stack]:
    """A stack that keeps its recordings on a disk of their own."""
    if os.getuid() != 0:
        pytest.skip("only root can mount a disk")
    with stack_of(person) as stack:
        options = f"size={DISK_MIB}m,uid={person},gid={person},mode=755"
        mount = ["mount", "-t", "tmpfs", "-o", options, "mazebot-test", str(stack.recordings)]
        subprocess.run(mount, check=True)
        try:
            yield stack
            stack.compose("down", "--timeout", "0")
        finally:
            subprocess.run(["umount", "--lazy", str(stack.recordings)], check=True)


def fill(path: Path) -> None:
    """Write until the disk takes no more byte."""
    with path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(_MIB))
    assert shutil.disk_usage(path).free == 0


def goals_reached(stack: Stack) -> int:
    return stack.logs(DEMO).count("reached after")


def test_a_full_disk_costs_the_tour_nothing_and_the_recording_only_that_time(stack: Stack) -> None:
    filler = stack.recordings / "filler"
    assert stack.compose("up", "--detach", DEMO).returncode == 0
    wait_until(lambda: goals_reached(stack) >= 1, 120.0, "a goal is reached")
    (run,) = [path for path in stack.recordings.iterdir() if path.is_dir()]
    fill(filler)
    wait_until(lambda: "recording stopped" in stack.logs("recorder"), 15.0, "it is told")
    written = (run / "run.rrd").stat().st_size
    before = goals_reached(stack)
    wait_until(lambda: goals_reached(stack) > before, 120.0, "the robot drives on")
    assert (run / "run.rrd").stat().st_size == written
    assert stack.inspect("recorder")["State"]["Health"]["Status"] == "healthy"
    filler.unlink()
    wait_until(lambda: "recording resumed" in stack.logs("recorder"), 15.0, "it goes on")
    wait_until(lambda: "tour finished" in stack.logs(DEMO), 300.0, "the tour ends")
    check_table(stack.logs(DEMO))
    recorder = stack.logs("recorder")
    assert stack.down() <= 10.0
    assert "Traceback" not in recorder
    assert recorder.count("recording stopped") == 1, recorder
    (summary,) = check_recordings(stack)
    assert [goal["reached"] for goal in summary["goals"]] == [True] * 5
