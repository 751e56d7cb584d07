"""A layout for a recording that exists, as the bytes of an .rbl file."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rerun.chunk import RrdReader

from services.recorder.config import LayoutName
from services.recorder.drawing.layouts.layouts import run_blueprint
from services.recorder.drawing.layouts.views import Scene
from services.recorder.stream.live_feed import APPLICATION

_PROPERTIES = "/__properties/run"


def layout_file(recording: Path, name: LayoutName) -> bytes:
    """The layout of that name, with the view of the recording's world.

    A viewer that reads it after the recording, also as one stream, shows the recording so.
    """
    layout = run_blueprint(_scene(recording), name)
    with tempfile.TemporaryDirectory(prefix="mazebot-layout-") as folder:
        path = Path(folder) / "layout.rbl"
        layout.save(APPLICATION, path)
        return path.read_bytes()


def _scene(recording: Path) -> Scene:
    try:
        chunks = [
            chunk for chunk in RrdReader(recording).stream() if chunk.entity_path == _PROPERTIES
        ]
    except (RuntimeError, ValueError):
        # Its end may be missing: it is shown as far as it goes.
        return Scene(None)
    found: dict[str, str] = {}
    for chunk in chunks:
        for name, column in chunk.to_record_batch().to_pydict().items():
            found |= {name.rpartition(":")[2]: row[0] for row in column if isinstance(row, list)}
    return Scene.from_properties(found)
