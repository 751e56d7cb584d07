"""Reads recordings with the SDK."""

from __future__ import annotations

import warnings
from pathlib import Path

from rerun.chunk import RrdReader


def read_rrd(path: Path) -> RrdReader:
    """A reader of a recording, also of one without its end. Raises RuntimeError for others."""
    with warnings.catch_warnings():
        # Without its end, it is only read slower.
        warnings.simplefilter("ignore")
        return RrdReader(path)
