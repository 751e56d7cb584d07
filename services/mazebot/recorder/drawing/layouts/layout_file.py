"""A layout for a recording that exists."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rerun.chunk import Chunk, LazyChunkStream

from mazebot.recorder.config import LayoutName
from mazebot.recorder.drawing.layouts.layouts import run_blueprint
from mazebot.recorder.drawing.layouts.views import Scene
from mazebot.recorder.stream.live_feed import APPLICATION
from mazebot.recorder.stream.rrd_reader import read_rrd

_PROPERTIES = "/__properties/run"


def write_layout(recording: Path, name: LayoutName, path: Path) -> None:
    """Write the layout of that name, with the view of the recording's world, as an .rbl file."""
    run_blueprint(_scene(_properties(recording)), name).save(APPLICATION, path)


def shown_in_layout(parts: Sequence[Path], name: LayoutName, folder: Path) -> list[Path]:
    """Files that a viewer shows in a layout if it reads them one after the other: what the
    recording is, the layout, and the recording without its own; written to a folder.

    Of a recording that cannot be copied, as its end is missing, the layout comes last.
    """
    layout, head = folder / "layout.rbl", folder / "head.rrd"
    write_layout(parts[0], name, layout)
    properties = _properties(parts[0])
    files = [head, layout]
    try:
        for number, part in enumerate(parts):
            reader = read_rrd(part)
            entry = reader.recordings()[0]
            ids = {"application_id": entry.application_id, "recording_id": entry.recording_id}
            if not number:
                LazyChunkStream.from_iter(properties).write_rrd(head, **ids)
            files.append(folder / f"part_{number}.rrd")
            reader.stream().write_rrd(files[-1], **ids)
    except (RuntimeError, ValueError, IndexError):
        return [*parts, layout]
    return files


def _properties(recording: Path) -> list[Chunk]:
    try:
        stream = read_rrd(recording).stream()
        return [chunk for chunk in stream if chunk.entity_path == _PROPERTIES]
    except (RuntimeError, ValueError):
        return []


def _scene(properties: Sequence[Chunk]) -> Scene:
    found: dict[str, str] = {}
    for chunk in properties:
        for name, column in chunk.to_record_batch().to_pydict().items():
            found |= {name.rpartition(":")[2]: row[0] for row in column if isinstance(row, list)}
    return Scene.from_properties(found)
