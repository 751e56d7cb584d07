"""The Rerun program that comes with the SDK."""

from __future__ import annotations

import importlib.util
from pathlib import Path


def rerun_binary() -> Path | None:
    """The Rerun program itself; `bin/rerun` is a wrapper that leaves it running when killed."""
    spec = importlib.util.find_spec("rerun_cli")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    candidates = [Path(folder) / "rerun" for folder in folders]
    return next((path for path in candidates if path.is_file()), None)
