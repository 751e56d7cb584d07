"""Makes videos of the pictures of an ended run."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import NamedTuple

from mazebot.common.messages.topics import CAMERA_IMAGE
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, TO_COMPRESS, parts_of
from mazebot.recorder.transcoding.mcap_video import read_video, transcode_mcap
from mazebot.recorder.transcoding.vp9 import VideoError

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
