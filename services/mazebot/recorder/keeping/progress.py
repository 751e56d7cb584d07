"""The progress of a run, in a file of its folder, from which a new recorder resumes a run whose
recorder died.
"""

from __future__ import annotations

import io
import json
import time
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.recordings.run_folder import PROGRESS, write_atomically

_DOCUMENT = "document"


@dataclass(frozen=True)
class Progress:
    """Which simulation a run belongs to, and the state of its evaluation so far."""

    world_hash: str
    source: str
    """Source id of the simulation's messages: a new one with each start of its process."""
    epoch: int
    time_ns: int
    taken: dict[str, dict[str, int]] = field(default_factory=dict)
    """By topic and source, the last sequence number taken, of topics with delivery EVERY."""
    run: dict[str, Any] = field(default_factory=dict)
    """Values of the summary besides the evaluation, as JSON."""
    verdict: dict[str, Any] = field(default_factory=dict)
    """JSON values of `RunEvaluation.state()`,"""
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    """and its arrays."""
    written_s: float = field(default_factory=time.time)
    """Unix time."""

    def is_before(self, world_hash: str, source: str, epoch: int, time_ns: int) -> bool:
        """Whether a simulation in this state is the same one, at this or a later time."""
        same = (self.world_hash, self.source, self.epoch) == (world_hash, source, epoch)
        return same and time_ns >= self.time_ns


def write_progress(folder: Path, progress: Progress) -> None:
    """Write it to a run's folder. Raises OSError."""
    values = {name: value for name, value in vars(progress).items() if name != "arrays"}
    document = np.frombuffer(json.dumps(values).encode(), np.uint8)
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{_DOCUMENT: document, **progress.arrays})
    # A killed process loses nothing that was passed to the kernel.
    write_atomically(folder / PROGRESS, [file.getvalue()], sync=False)


def read_progress(folder: Path) -> Progress | None:
    """Read it from a run's folder; None if there is none or it is unreadable."""
    try:
        with np.load(folder / PROGRESS, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        values = json.loads(arrays.pop(_DOCUMENT).tobytes())
        return Progress(arrays=arrays, **values)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, zipfile.BadZipFile):
        return None
