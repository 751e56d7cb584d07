"""Makes videos of the pictures of ended runs, in a process that yields to all others."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from services.common.recordings.mcap_records import McapError
from services.common.recordings.run_folder import LOCK, MESSAGES, TO_COMPRESS, parts_of
from services.common.root import ROOT
from services.recorder.transcoding.mcap_video import transcode_mcap
from services.recorder.transcoding.vp9 import VideoError

_NICEST = 19
_LEFT_BY_A_KILLED_ONE = ("*.video", "*.rest", "*.whole", "*.whole_mcap", "*.mp4")


class Compression(NamedTuple):
    """What became of a run's files."""

    before_bytes: int
    after_bytes: int
    files: int
    """How many were replaced."""


def compress_run(folder: Path) -> Compression:
    """Replace the pictures in the files of an ended run by video. If it is killed at any time, each
    file is either the old or the new one, and the next call does the rest.

    Raises VideoError, a line of text, if the run has not ended, is being compressed already, or
    cannot be: its files are as they were. Raises OSError if the disk is full.
    """
    if (folder / LOCK).exists():
        raise VideoError(f"{folder}: this run has not ended")
    if not parts_of(folder) and not parts_of(folder, MESSAGES):
        raise VideoError(f"{folder}: no recording")
    with (folder / TO_COMPRESS).open("a", encoding="utf-8") as marker:
        try:
            fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise VideoError(f"{folder}: another process does it") from error
        for pattern in _LEFT_BY_A_KILLED_ONE:
            for path in folder.glob(pattern):
                path.unlink()
        try:
            done = _compress(folder)
        except (VideoError, McapError) as error:
            # It would fail again.
            (folder / TO_COMPRESS).unlink(missing_ok=True)
            raise VideoError(str(error)) from error
        (folder / TO_COMPRESS).unlink(missing_ok=True)
        return done


def _compress(folder: Path) -> Compression:
    from services.recorder.transcoding.rrd_video import transcode_rrd  # noqa: PLC0415 - Rerun

    jobs: list[tuple[Path, Callable[[Path], bool]]] = [
        *((path, transcode_rrd) for path in parts_of(folder)),
        *((path, transcode_mcap) for path in parts_of(folder, MESSAGES)),
    ]
    before = sum(path.stat().st_size for path, _ in jobs)
    replaced = sum(transcode(path) for path, transcode in jobs)
    return Compression(before, sum(path.stat().st_size for path, _ in jobs), replaced)


def waiting(recordings_dir: Path) -> list[Path]:
    """The folders of ended runs that are still to be compressed, oldest first."""
    marked = (marker.parent for marker in sorted(recordings_dir.glob(f"*/{TO_COMPRESS}")))
    return [folder for folder in marked if not (folder / LOCK).exists()]


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Compress a run in a process that outlives this one, on one core, after everything else."""
    return subprocess.Popen(
        [sys.executable, "-m", "services.recorder.transcoding", str(folder.resolve())],
        cwd=ROOT,
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
