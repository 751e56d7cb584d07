"""The process that makes videos of the pictures of ended runs: it yields to all others."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

from mazebot.common.recordings.run_folder import LOCK, TO_COMPRESS

_NICEST = 19


def waiting(recordings_dir: Path) -> list[Path]:
    """The folders of ended runs that are still to be compressed, oldest first."""
    marked = (marker.parent for marker in sorted(recordings_dir.glob(f"*/{TO_COMPRESS}")))
    return [folder for folder in marked if not (folder / LOCK).exists()]


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Compress a run in a process that outlives this one, on one core, after everything else."""
    return subprocess.Popen(
        [sys.executable, "-m", "mazebot.recorder.transcoding", str(folder.resolve())],
        env={**os.environ, "OPENCV_FFMPEG_THREADS": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process of `start()` and what it has started, at once."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def yield_to_others() -> None:
    """Let every other process go first."""
    os.nice(_NICEST)
