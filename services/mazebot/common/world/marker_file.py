"""Markers beside a map: where each one was found, or on which wall of the world it hangs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field, ValidationError

from mazebot.common.files.folder_writing import write_file
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.maths.frames import position_and_quaternion
from mazebot.common.messages.documents import MappedMarker, Marker, Wall
from mazebot.common.messages.slam_documents import GraphLandmark
from mazebot.common.problems import Problem, WorldError, field_name, shown_value
from mazebot.common.world.placement import hang


class _Found(MappedMarker):
    """An entry with a pose; what else is known of it is for people."""

    model_config = ConfigDict(extra="ignore", populate_by_name=True)

    marker_id: int = Field(alias="id", ge=0)


def marker_file_of(map_file: Path) -> Path | None:
    """`NAME.markers.yaml` beside a map `NAME.yaml`, else `markers.yaml`; None: there is neither."""
    beside = map_file.with_name(f"{map_file.stem}.markers.yaml"), map_file.with_name("markers.yaml")
    return next((path for path in beside if path.is_file()), None)


def read_markers(path: Path, walls: Iterable[Wall]) -> tuple[MappedMarker, ...]:
    """The markers of a file, `markers:` with entries of either kind: `position_m` and
    `orientation_xyzw` in the map's frame, or as in a recipe, by one of these walls. Of an entry
    with a pose, `instance` 1 and up is left out: another marker of the same id.

    Raises WorldError with one line that names file, field and value.
    """
    source = read_source(path, str(path))
    entries = source.content.get("markers")
    if not isinstance(entries, tuple):
        raise _wrong(source, ("markers",), entries, "must be a list of markers")
    by_name = {wall.name: wall for wall in walls}
    found = []
    for index, entry in enumerate(entries):
        at = ("markers", index)
        if not isinstance(entry, dict):
            raise _wrong(source, at, entry, "must be a mapping of fields to values")
        if entry.get("instance"):
            continue
        try:
            if "wall" not in entry:
                one = _Found.model_validate(entry)
                found.append(MappedMarker(**one.model_dump(by_alias=False)))
                continue
            marker = Marker.model_validate(entry)
        except ValidationError as error:
            first = error.errors()[0]
            field = (*at, *first["loc"])
            raise _wrong(source, field, first["input"], first["msg"]) from error
        if marker.wall not in by_name:
            raise _wrong(source, (*at, "wall"), marker.wall, "must be a wall of the world")
        found.append(_hung(marker, by_name[marker.wall]))
    return tuple(found)


def write_markers(path: Path, landmarks: Iterable[GraphLandmark]) -> None:
    """Write the markers of a pose graph by their poses. Raises OSError."""
    lines = ["# poses in the map's frame: metres, quaternion; std_m: standard deviation"]
    entries = [
        f"- {{id: {one.marker_id}, dictionary: {one.dictionary}, instance: {one.instance}, "
        f"position_m: {_numbers(one.position_m)}, "
        f"orientation_xyzw: {_numbers(one.orientation_xyzw)}, "
        f"std_m: {one.std_m:.4f}, sightings: {one.sightings}}}"
        for one in landmarks
    ]
    lines += ["markers:", *entries] if entries else ["markers: []"]
    write_file(path, ("\n".join(lines) + "\n").encode())


def _numbers(values: Iterable[float]) -> str:
    return f"[{', '.join(repr(round(float(value), 6)) for value in values)}]"


def _hung(marker: Marker, wall: Wall) -> MappedMarker:
    panel = hang(marker.name, marker, wall, marker.size_m, 0.0)
    position_m, orientation_xyzw = position_and_quaternion(panel.map_from_panel)
    return MappedMarker(
        dictionary=marker.dictionary,
        marker_id=marker.id,
        position_m=position_m,
        orientation_xyzw=orientation_xyzw,
    )


def _wrong(source: Source, at: tuple[str | int, ...], value: Any, must: str) -> WorldError:
    line = source.line_of(at)
    return WorldError(
        [
            Problem(
                file=source.file, line=line, field=field_name(at), value=shown_value(value),
                must=must,
            )
        ]
    )  # fmt: skip
