"""How much room a drive with the camera needs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.recorder.transcoding.job import compress_run
from tests.recorder.test_node import verify

MOST_MB_PER_MINUTE = 15.0
WORLD_MB = 5.0
"""Its textures, once in each file, however long the drive is."""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_compressed_drive_needs_at_most_fifteen_megabytes_a_minute(tmp_path: Path) -> None:
    run = tmp_path / "run"
    goal = ("2.07", "1.82", "-1.57")
    command = [sys.executable, "-m", "mazebot.cli", "demo", "--goal", *goal, "--out", str(run)]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    # Not a terminal: the file is not compressed behind the back of a script.
    assert f"recordings compress {run}" in " ".join(told.stdout.split())
    done = compress_run(run)
    assert done.files == 2
    verify(run / "run.rrd")
    minutes = json.loads((run / "summary.json").read_text())["sim_time_s"] / 60.0
    size_mb = done.after_bytes / 1e6 - WORLD_MB
    assert size_mb <= MOST_MB_PER_MINUTE * minutes, (done, minutes)
