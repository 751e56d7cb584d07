"""Makes videos of the pictures of ended runs, in a process that yields to all others."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from mazebot.common.messages.topics import CAMERA_IMAGE
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, TO_COMPRESS, parts_of
from mazebot.recorder.transcoding.mcap_video import read_video, transcode_mcap
from mazebot.recorder.transcoding.vp9 import VideoError

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
            raise VideoError(f"{folder}: another process is compressing it") from error
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
    from mazebot.recorder.transcoding.rrd_video import transcode_rrd  # noqa: PLC0415 - Rerun

    parts, message_parts = parts_of(folder), parts_of(folder, MESSAGES)
    before = _size(folder)
    replaced = sum([transcode_mcap(path) for path in message_parts])
    # The video is made once, for both.
    video_by_ns = dict(read_video(message_parts, CAMERA_IMAGE.name))
    replaced += sum([transcode_rrd(path, video_by_ns) for path in parts])
    return Compression(before, _size(folder), replaced)


def _size(folder: Path) -> int:
    paths = (*parts_of(folder), *parts_of(folder, MESSAGES))
    return sum(path.stat().st_size for path in paths)


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
