"""Rewrites recordings: repairs those of killed recorders, and merges many small chunks."""

from __future__ import annotations

import fcntl
import json
import logging
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.messages.topics import CLOCK
from mazebot.common.recordings.mcap.mcap_counts import count_messages
from mazebot.common.recordings.mcap.mcap_file import repair
from mazebot.common.recordings.mcap.mcap_messages import read_messages
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.run_folder import (
    LOCK,
    MESSAGES,
    PROGRESS,
    SUMMARY,
    TO_COMPRESS,
    attachments_of,
    parts_of,
    write_atomically,
)
from mazebot.common.recordings.run_settings import read_summary
from mazebot.recorder.keeping.closing import leave_report
from mazebot.recorder.keeping.progress import Progress, read_progress
from mazebot.recorder.stream.rerun_program import rerun_binary
from mazebot.recorder.transcoding.background import end, start, waiting

_LOG = logging.getLogger("recorder")
TIMEOUT_S = 120.0
LOOK_PERIOD_S = 20.0
_COMPRESS_LOOK_S = 0.5
SPARE_S = 60.0
"""Wall time for the other services to come back, if everything was restarted."""


def leftovers(recordings_dir: Path) -> list[Path]:
    """The run folders whose recorder died before the run was complete, oldest first."""
    return [lock.parent for lock in sorted(recordings_dir.glob(f"*/{LOCK}")) if _is_free(lock)]


def interrupted(recordings_dir: Path) -> tuple[Path, Progress] | None:
    """The newest leftover that has a progress file, and its progress."""
    for folder in reversed(leftovers(recordings_dir)):
        progress = read_progress(folder)
        if progress is not None:
            return folder, progress
    return None


class Rewriting:
    """Rewrites the readable part of a recording as one file of few chunks, in another process."""

    def __init__(self, parts: Sequence[Path], binary: Path | None = None) -> None:
        """Several parts are merged into the first one's file."""
        self._parts = parts
        self._whole = parts[0].with_suffix(".whole")
        self._binary = binary or rerun_binary()
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def run(self, timeout_s: float) -> str:
        """Replace the recording by the rewritten one; returns the problem, or an empty string."""
        try:
            problem = self._rewrite(timeout_s)
            if not problem:
                self._whole.replace(self._parts[0])
                for part in self._parts[1:]:
                    part.unlink(missing_ok=True)
        except OSError as error:
            problem = str(error.strerror)
        if problem:
            self._whole.unlink(missing_ok=True)
        return problem

    def stop(self) -> None:
        """Stop at once; the recording stays unchanged."""
        self._stopped = True
        if self._process is not None:
            self._process.kill()

    def _rewrite(self, timeout_s: float) -> str:
        if self._binary is None:
            return "the Rerun program is not installed"
        command = [str(self._binary), "rrd", "optimize", *map(str, self._parts)]
        with subprocess.Popen(
            [*command, "-o", str(self._whole)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        ) as process:
            self._process = process
            if self._stopped:
                process.kill()
            try:
                _, errors = process.communicate(timeout=timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                return f"timed out after {timeout_s:.1f} s"
        if self._stopped:
            return "stopped"
        if process.returncode == 0 and self._whole.is_file() and self._whole.stat().st_size > 0:
            return ""
        lines = errors.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit code {process.returncode}"


class Repair(threading.Thread):
    """Repairs every leftover of a folder, one at a time, in the background, and repeats the search
    regularly: for one that had no room, or whose recorder has just died. While there is no run, it
    has the pictures of ended ones made videos.
    """

    def __init__(
        self,
        recordings_dir: Path,
        only: Path | None = None,
        may_compress: Callable[[], bool] | None = None,
    ) -> None:
        """`only`: the one leftover to repair; `may_compress` returns whether there is no run; None:
        there are to be no videos.
        """
        super().__init__(name="repair", daemon=True)
        self._may_compress = may_compress
        self._spared: Path | None = None
        """A run that may still be resumed, for a minute."""
        self.unreadable: list[Path] = []
        """The files that were given up: what is in them is nothing that can be repaired."""
        self._start_s = time.monotonic()
        self._recordings_dir = recordings_dir
        self._only = only
        self._stopped = threading.Event()
        self._woken = threading.Event()
        self._rewriting: Rewriting | None = None

    def spare(self, folder: Path | None) -> None:
        """Leave a run alone, as it may still be resumed; None: none is, and what was left so is
        repaired at once. It may be the last moment: the new recorder may soon end, too.
        """
        self._spared = folder
        if folder is None:
            self._woken.set()

    def run(self) -> None:
        """Repair leftovers, repeatedly, until `stop()` is called."""
        was_idle = False
        while not self._stopped.is_set():
            self.repair_all()
            # Not while everything starts.
            is_idle = self._may_compress is not None and self._may_compress()
            if was_idle and is_idle:
                self._compress_all()
            was_idle = is_idle
            self._woken.wait(LOOK_PERIOD_S)
            self._woken.clear()

    def repair_all(self) -> None:
        """Repair the current leftovers, except those for which there is no room."""
        for folder in leftovers(self._recordings_dir):
            if self._stopped.is_set():
                return
            if self._is_spared(folder) or self._only not in (None, folder):
                continue
            lock = folder / LOCK
            try:
                # Locked during the repair, so that only one of two recorders does it.
                with lock.open(encoding="utf-8") as held:
                    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if not self._is_spared(folder):
                        self._repair(folder)
            except OSError:
                continue

    def _compress_all(self) -> None:
        """Compress what waits for it, until there is a run."""
        for folder in waiting(self._recordings_dir):
            process = start(folder)
            try:
                while process.poll() is None:
                    self._stopped.wait(_COMPRESS_LOOK_S)
                    if self._stopped.is_set() or not (self._may_compress and self._may_compress()):
                        return
            finally:
                end(process)

    def stop(self) -> None:
        """Stop at once; a half-repaired recording stays unchanged."""
        self._stopped.set()
        self._woken.set()
        if self._rewriting is not None:
            self._rewriting.stop()
        if self.is_alive():
            self.join(1.0)

    def _is_spared(self, folder: Path) -> bool:
        return folder == self._spared and time.monotonic() - self._start_s < SPARE_S

    def _repair(self, folder: Path) -> None:
        # First: the summary is attached to the messages.
        _recount(folder)
        for part in parts_of(folder, MESSAGES):
            try:
                if repair(part, attachments_of(folder)):
                    _LOG.info("repaired %s", part)
            except McapError as error:
                self.unreadable.append(part)
                _LOG.warning("failed to repair %s: %s", part, error)
        parts = parts_of(folder)
        if parts:
            needed_bytes = sum(part.stat().st_size for part in parts)
            if shutil.disk_usage(folder).free < needed_bytes:
                return
            self._rewriting = Rewriting(parts)
            problem = "" if self._stopped.is_set() else self._rewriting.run(TIMEOUT_S)
            if self._stopped.is_set():
                return
            if problem:
                self.unreadable.append(parts[0])
                _LOG.warning("failed to repair %s: %s", parts[0], problem)
            else:
                _LOG.info("repaired %s", parts[0])
        if self._may_compress is not None:
            (folder / TO_COMPRESS).touch()
        (folder / PROGRESS).unlink(missing_ok=True)
        (folder / LOCK).unlink(missing_ok=True)
        leave_report(folder)


def _recount(folder: Path) -> None:
    """Write into a run's summary how many messages its files hold, and up to which time: its
    recorder died, or had no room for the summary, after it had written some more.
    """
    try:
        summary = read_summary(folder)
        if not summary:
            return
        parts = parts_of(folder, MESSAGES)
        counts = count_messages(parts)
        clocks = read_messages(parts[-1:], {CLOCK.name})
        newest_ns = max((message.time_ns for message in clocks), default=0)
        if newest_ns:
            summary["sim_time_s"] = max(summary.get("sim_time_s") or 0.0, newest_ns * 1e-9)
        for topic, row in summary.get("messages", {}).items():
            if row["recorded"] is not None:
                row["recorded"] = counts[topic]
                row["received"] = max(row["received"], counts[topic])
                row["sent"] = max(row["sent"], row["received"] + row["lost"])
        if counts:
            text = json.dumps(summary, indent=2, ensure_ascii=False) + "\n"
            write_atomically(folder / SUMMARY, [text.encode()])
    except (ConfigError, McapError, OSError, AttributeError, KeyError, TypeError) as error:
        _LOG.warning("%s: failed to count the messages of the run: %s", folder, error)


def _is_free(lock: Path) -> bool:
    try:
        with lock.open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
