"""What is done when a run has ended: its report, and the deletion of old runs."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import list_recordings
from mazebot.common.recordings.retention import Kept, delete_rest, delete_run, to_delete
from mazebot.recorder.config import RecorderConfig

_LOG = logging.getLogger("recorder")


class Closings:
    """Finishes ended runs in a thread, one after the other, while the next one is recorded."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="closing")
        self._started: list[Future[None]] = []

    def start(self, finish: Callable[[], None]) -> None:
        """Finish a run as soon as the runs before it are finished."""
        self._started.append(self._worker.submit(finish))

    def wait(self) -> None:
        """Return when all runs are finished. Raises what one of them has raised."""
        self._worker.shutdown()
        for one in self._started:
            one.result()


def leave_report(folder: Path) -> None:
    """Write report.html and thumbnail.png of a run; a problem is logged."""
    # Loaded here: no run waits for the templates at its start.
    from mazebot.common.recordings.report.report import write_report  # noqa: PLC0415

    try:
        write_report(folder)
    except ConfigError as error:
        _LOG.error("failed to write the report: %s", error)


def delete_old_runs(config: RecorderConfig, now: datetime) -> None:
    """Delete the runs beyond `keep_days` and `keep_gib`, never the newest; a problem is logged."""
    kept = Kept(days=config.keep_days, gib=config.keep_gib)
    if kept.is_all or config.out_dir is not None:
        return
    delete_rest(config.recordings_dir)
    for run in to_delete(list_recordings(config.recordings_dir), kept._replace(last=1), now):
        try:
            delete_run(run.path)
        except ConfigError as error:
            _LOG.warning("%s", error)
        else:
            _LOG.info("deleted %s: beyond keep_days or keep_gib", run.path)
