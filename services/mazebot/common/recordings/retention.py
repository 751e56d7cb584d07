"""Deletes runs: a single one, or all beyond what is to be kept."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo
from mazebot.common.recordings.labels import KEEP
from mazebot.common.recordings.run_folder import LOCK, is_recording

GIB = 1024**3
_DELETED = ".deleted-"


class Kept(NamedTuple):
    """What is to be kept; None: no limit."""

    days: float | None = None
    """Runs that started longer ago are deleted."""
    gib: float | None = None
    """The oldest are deleted until all together take no more than this."""
    last: int | None = None
    """The newest so many stay whatever the other limits say; alone: all others are deleted."""

    @property
    def is_all(self) -> bool:
        """Whether nothing is to be deleted."""
        return self == Kept()


def to_delete(runs: Sequence[RecordingInfo], kept: Kept, now: datetime) -> list[RecordingInfo]:
    """The runs beyond what is to be kept, oldest first. Never one that is being recorded or is yet
    to be repaired, nor one with the tag `keep`, nor one whose labels cannot be read; `runs` are in
    any order.
    """
    if kept.is_all:
        return []
    oldest_first = sorted(runs, key=lambda run: (run.started or now, run.name))
    spared = {run.name for run in oldest_first[max(len(runs) - (kept.last or 0), 0) :]}
    only_last = kept.days is None and kept.gib is None
    size_bytes = sum(run.size_bytes for run in runs)
    doomed = []
    for run in oldest_first:
        if run.name in spared or not run.closed or KEEP in run.tags or run.labels_unreadable:
            continue
        is_old = (
            kept.days is not None
            and run.started is not None
            and now - run.started > timedelta(days=kept.days)
        )
        is_too_much = kept.gib is not None and size_bytes > kept.gib * GIB
        if only_last or is_old or is_too_much:
            doomed.append(run)
            size_bytes -= run.size_bytes
    return doomed


def delete_run(folder: Path) -> None:
    """Delete a run: it is either there in full, or gone.

    Raises ConfigError with one line if it is being recorded, or cannot be deleted.
    """
    if (folder / LOCK).exists() and is_recording(folder):
        raise ConfigError(f"{folder}: is being recorded; stop the run first")
    gone = folder.with_name(f"{_DELETED}{folder.name}")
    try:
        if folder.is_symlink():
            folder.unlink()
            return
        folder.rename(gone)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be deleted: {error.strerror}") from error
    shutil.rmtree(gone, ignore_errors=True)


def delete_rest(directory: Path) -> None:
    """Remove what a killed process has left of runs that it was deleting."""
    with contextlib.suppress(OSError):
        for rest in directory.glob(f"{_DELETED}*"):
            shutil.rmtree(rest, ignore_errors=True)
