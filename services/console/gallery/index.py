"""All runs of a folder, kept in memory and brought up to date by the folders' times of change."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from services.console.gallery.run_card import RunCard, is_run, read_card
from services.console.safe_files import is_plain_name

FRESH_S = 0.5
"""Within this wall time the folder is not looked at again."""
_RUNNING_S = 2.0
"""How often a run that is being recorded is read again, even where its folder is unchanged."""


@dataclass(frozen=True)
class Runs:
    """The runs at one time."""

    cards: tuple[RunCard, ...]
    """Newest first."""
    version: int
    """Changes with every change of a card."""
    problem: str
    """Why the folder cannot be read; empty: it can."""

    def find(self, name: str) -> RunCard | None:
        """The run of that name."""
        return next((card for card in self.cards if card.name == name), None)


@dataclass(frozen=True)
class _Known:
    card: RunCard | None
    """None: no run."""
    changed_ns: int
    read_s: float


class RunIndex:
    """The runs of a folder. May be used by several threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._known: dict[str, _Known] = {}
        self._runs = Runs((), 0, "")
        self._looked_s = float("-inf")

    def runs(self, at_once: bool = False) -> Runs:
        """The runs, as they were at most half a second ago; `at_once`: as they are now."""
        with self._lock:
            if at_once or time.monotonic() - self._looked_s >= FRESH_S:
                self._look()
                self._looked_s = time.monotonic()
            return self._runs

    def _look(self) -> None:
        problem = ""
        found: dict[str, _Known] = {}
        try:
            with os.scandir(self.folder) as entries:
                for entry in entries:
                    known = self._read(entry)
                    if known is not None:
                        found[entry.name] = known
        except FileNotFoundError:
            problem = f"the folder of recordings does not exist: {self.folder}"
        except OSError as error:
            problem = f"the folder of recordings cannot be read: {self.folder}: {error.strerror}"
        if problem == self._runs.problem and _same(found, self._known):
            self._known = found
            return
        self._known = found
        cards = [known.card for known in found.values() if known.card is not None]
        cards.sort(key=lambda card: (card.started.isoformat() if card.started else "", card.name))
        self._runs = Runs(tuple(reversed(cards)), self._runs.version + 1, problem)

    def _read(self, entry: os.DirEntry[str]) -> _Known | None:
        """A run's card, read again only where its folder has changed; None: no folder."""
        try:
            if not is_plain_name(entry.name) or not entry.is_dir(follow_symlinks=False):
                return None
            changed_ns = entry.stat(follow_symlinks=False).st_mtime_ns
        except OSError:
            return None
        known = self._known.get(entry.name)
        now_s = time.monotonic()
        if known is not None and known.changed_ns == changed_ns:
            is_final = known.card is None or known.card.state == "complete"
            if is_final or now_s - known.read_s < _RUNNING_S:
                return known
        folder = Path(entry.path)
        return _Known(read_card(folder) if is_run(folder) else None, changed_ns, now_s)


def _same(first: dict[str, _Known], second: dict[str, _Known]) -> bool:
    """Whether both hold equal cards."""
    return first.keys() == second.keys() and all(
        known.card == second[name].card for name, known in first.items()
    )
