"""All runs of a folder, kept in memory and updated when a page is requested."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from mazebot.common.recordings.catalog import Catalog, RecordingInfo
from mazebot.console.safe_files import is_plain_name, is_real_folder

FRESH_S = 0.5
"""Within this wall time the folder is not looked at again."""
_SHARE = 0.1
"""Of the time that may go into looking, however many runs there are."""
_PATIENCE_S = 0.1
"""For which a page waits for a look at the folder."""


@dataclass(frozen=True)
class Runs:
    """The runs at one time."""

    all: tuple[RecordingInfo, ...]
    """Newest first."""
    version: int
    """Another one after each change of a run."""
    problem: str
    """Why the folder cannot be read; empty: it can."""


class RunIndex:
    """The runs of a folder. May be used by several threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._catalog = Catalog(folder)
        self._looking = threading.Lock()
        self._runs = Runs((), 0, "")
        self._fresh_until_s = float("-inf")
        self._real: dict[str, bool] = {}

    def runs(self, at_once: bool = False) -> Runs:
        """The runs, as they were a moment ago; `at_once`: as they are now.

        Of thousands it may be what was seen last, while the folder is looked at again.
        """
        if at_once or not self._runs.version:
            self._refresh(float("-inf") if at_once else time.monotonic())
        elif time.monotonic() >= self._fresh_until_s and not self._looking.locked():
            looking = threading.Thread(
                target=self._refresh, args=(time.monotonic(),), name="runs", daemon=True
            )
            looking.start()
            looking.join(_PATIENCE_S)
        return self._runs

    def _refresh(self, asked_s: float) -> None:
        """Look at the folder, unless that was done after `asked_s`; -inf: in any case."""
        with self._looking:
            start_s = time.monotonic()
            if self._runs.version and 0.0 < asked_s < self._fresh_until_s:
                return
            self._look()
            end_s = time.monotonic()
            self._fresh_until_s = end_s + max(FRESH_S, (end_s - start_s) / _SHARE)

    def _look(self) -> None:
        found = tuple(run for run in self._catalog.runs() if self._is_shown(run.name))
        problem = "" if found else _problem(self.folder)
        if (found, problem) != (self._runs.all, self._runs.problem) or not self._runs.version:
            self._runs = Runs(found, self._runs.version + 1, problem)

    def _is_shown(self, name: str) -> bool:
        """Whether a run's files can be opened here: links are not followed."""
        if name not in self._real:
            self._real[name] = is_plain_name(name) and is_real_folder(self.folder / name)
        return self._real[name]


def _problem(folder: Path) -> str:
    """Why a folder cannot be read, in one line; empty: it can."""
    try:
        with os.scandir(folder):
            return ""
    except FileNotFoundError:
        return f"the folder of recordings does not exist: {folder}"
    except OSError as error:
        return f"the folder of recordings cannot be read: {folder}: {error.strerror}"
