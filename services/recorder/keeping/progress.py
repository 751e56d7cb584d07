"""How far a run has come, in a file of its folder: by it a recorder goes on with a run whose own
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

from services.recorder.keeping.run_folder import PROGRESS, write_atomically

_DOCUMENT = "document"


@dataclass(frozen=True)
class Progress:
    """Which simulation a run is of, and what its verdict is made of so far."""

    world_hash: str
    source: str
    """By which the simulation's messages are known: another one with each start of its process."""
    epoch: int
    time_ns: int
    taken: dict[str, dict[str, int]] = field(default_factory=dict)
    """By topic and source, the number of the last message of which every one counts."""
    run: dict[str, Any] = field(default_factory=dict)
    """What the summary holds beside the verdict, as JSON values."""
    verdict: dict[str, Any] = field(default_factory=dict)
    """What `RunEvaluation.state()` has as JSON values,"""
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    """and as arrays."""
    written_s: float = field(default_factory=time.time)
    """Unix time."""

    def is_before(self, world_hash: str, source: str, epoch: int, time_ns: int) -> bool:
        """Whether a simulation that is in this state is the same one, later."""
        same = (self.world_hash, self.source, self.epoch) == (world_hash, source, epoch)
        return same and time_ns >= self.time_ns


def write_progress(folder: Path, progress: Progress) -> None:
    """Keep it in a run's folder. Raises OSError."""
    values = {name: value for name, value in vars(progress).items() if name != "arrays"}
    document = np.frombuffer(json.dumps(values).encode(), np.uint8)
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{_DOCUMENT: document, **progress.arrays})
    # A killed process loses nothing that the kernel has.
    write_atomically(folder / PROGRESS, [file.getvalue()], sync=False)


def read_progress(folder: Path) -> Progress | None:
    """What a run's folder has of it; None where there is none that can be read."""
    try:
        with np.load(folder / PROGRESS, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        values = json.loads(arrays.pop(_DOCUMENT).tobytes())
        return Progress(arrays=arrays, **values)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, zipfile.BadZipFile):
        return None
