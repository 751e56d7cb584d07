"""Markers beside a map: where each one was found, or on which wall of the world it hangs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ConfigDict, Field, ValidationError

from mazebot.common.config import must
from mazebot.common.files.folder_writing import write_file
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.maths.frames import SE2, pose_matrix, position_and_quaternion
from mazebot.common.messages.documents import MappedMarker, Marker, MarkerDictionary, Wall
from mazebot.common.messages.documents.document import Document, Quaternion, Vector
from mazebot.common.messages.slam_documents import GraphLandmark
from mazebot.common.problems import Location, Problem, WorldError, field_name, shown_value
from mazebot.common.world.map_files import MapFile
from mazebot.common.world.placement import hang

_FIELDS = "id, dictionary, position_m, orientation_xyzw, instance, std_m, sightings"
_NORM_ERROR = 0.01
"""So far from 1, a quaternion was rounded; farther, it is none."""
_BESIDE_M = 10.0
"""No marker that is farther than this from a map can be read from it."""
_UPRIGHT = 0.7
"""Cosine of 45 degrees, within which a marker hangs upright."""
_UPRIGHT_XYZW = "[0.5, 0.5, 0.5, 0.5]"

Kind = TypeVar("Kind", bound=Document)


class MarkerFile(NamedTuple):
    """What a file of markers says."""

    markers: tuple[MappedMarker, ...]
    warnings: tuple[str, ...]
    """Lines, each of what is hardly meant as it is."""


class _Found(Document):
    """An entry with a pose, as `write_markers` writes it."""

    model_config = ConfigDict(strict=True)

    marker_id: int = Field(alias="id", ge=0)
    dictionary: str
    position_m: Vector
    orientation_xyzw: Quaternion
    instance: int = Field(0, ge=0)
    std_m: float = Field(0.0, ge=0.0)
    sightings: int = Field(0, ge=0)


def marker_file_of(map_file: Path) -> Path | None:
    """`NAME.markers.yaml` beside a map `NAME.yaml`, else `markers.yaml`; None: there is neither."""
    beside = map_file.with_name(f"{map_file.stem}.markers.yaml"), map_file.with_name("markers.yaml")
    return next((path for path in beside if path.is_file()), None)


def read_markers(
    path: Path,
    walls: Iterable[Wall],
    *,
    dictionaries: Iterable[MarkerDictionary] = (),
    chart: MapFile | None = None,
) -> MarkerFile:
    """The markers of a file, `markers:` with entries of either kind: `position_m` and
    `orientation_xyzw` in the map's frame, or as in a recipe, by one of these walls. Of an entry
    with a pose, `instance` 1 and up is left out: another marker of the same id.

    `dictionaries` are those of the world, beside OpenCV's; `chart` is the map that the markers are
    of. Raises WorldError with one line that names file, field and value.
    """
    # Those that only write markers need no OpenCV.
    from mazebot.common.world.marker_picture import own_dictionaries  # noqa: PLC0415

    source = read_source(path, str(path))
    for key in source.content:
        if key != "markers":
            value = source.content[key]
            raise _wrong(source, (key,), value, "unknown field: must be `markers`")
    entries = source.content.get("markers")
    if not isinstance(entries, tuple):
        raise _wrong(source, ("markers",), entries, "must be a list of markers")
    by_name = {wall.name: wall for wall in walls}
    books = own_dictionaries(dictionaries)
    found, warnings = [], []
    for index, entry in enumerate(entries):
        at = ("markers", index)
        if not isinstance(entry, dict):
            raise _wrong(source, at, entry, "must be a mapping of fields to values")
        hung = _checked(source, at, entry, Marker) if "wall" in entry else None
        if hung is not None:
            _check_identity(source, at, hung.dictionary, hung.id, books)
            if hung.wall not in by_name:
                raise _wrong(source, (*at, "wall"), hung.wall, "must be a wall of the world")
            found.append(_hung(hung, by_name[hung.wall]))
            continue
        one = _checked(source, at, entry, _Found)
        _check_identity(source, at, one.dictionary, one.marker_id, books)
        if one.instance:
            continue
        marker = MappedMarker(
            dictionary=one.dictionary,
            marker_id=one.marker_id,
            position_m=one.position_m,
            orientation_xyzw=_unit(source, at, one.orientation_xyzw),
        )
        if chart is not None:
            _check_place(source, at, marker, chart)
        warnings += _doubt(source, at, marker)
        found.append(marker)
    return MarkerFile(tuple(found), tuple(warnings))


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


def _checked(source: Source, at: Location, entry: Any, kind: type[Kind]) -> Kind:
    try:
        return kind.model_validate(entry, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        at = (*at, *first["loc"])
        if first["type"] == "missing":
            raise WorldError([_problem(source, at, "", "is missing")]) from error
        wanted = must(first["msg"])
        if first["type"] == "extra_forbidden":
            fields = _FIELDS if kind is _Found else ", ".join(kind.model_fields)
            wanted = f"unknown field: must be one of {fields}"
        raise _wrong(source, at, first["input"], wanted) from error


def _check_identity(
    source: Source, at: Location, name: str, marker_id: int, books: Mapping[str, Any]
) -> None:
    from mazebot.common.world.marker_picture import identity_mistake  # noqa: PLC0415

    mistake = identity_mistake(name, marker_id, books.get(name))
    if mistake is not None:
        field, value, wanted = mistake
        raise _wrong(source, (*at, field), value, wanted)


def _unit(source: Source, at: Location, xyzw: Quaternion) -> Quaternion:
    """A quaternion of norm 1."""
    norm = math.hypot(*xyzw)
    if abs(norm - 1.0) > _NORM_ERROR:
        wanted = f"must be a unit quaternion x, y, z, w, not one of norm {norm:.3g}"
        raise _wrong(source, (*at, "orientation_xyzw"), list(xyzw), wanted)
    x, y, z, w = xyzw
    return x / norm, y / norm, z / norm, w / norm


def _check_place(source: Source, at: Location, marker: MappedMarker, chart: MapFile) -> None:
    rows, columns = chart.cells.shape
    x_m, y_m, height_m = marker.position_m
    x, y, _ = chart.origin.inverse() @ SE2(x_m, y_m, 0.0)
    outside = (
        max(-x, x - columns * chart.resolution_m),
        max(-y, y - rows * chart.resolution_m),
        abs(height_m),
    )
    if max(outside) > _BESIDE_M:
        wanted = (
            f"must be metres in the map's frame, within {_BESIDE_M:g} m of the map and its floor"
        )
        raise _wrong(source, (*at, "position_m"), list(marker.position_m), wanted)


def _doubt(source: Source, at: Location, marker: MappedMarker) -> list[str]:
    """A line where a marker does not hang upright, else none."""
    _, up, normal = pose_matrix(marker)[:3, :3].T.tolist()
    if up[2] >= _UPRIGHT and abs(normal[2]) <= _UPRIGHT:
        return []
    hangs = "lies flat" if abs(normal[2]) > _UPRIGHT else "hangs turned or upside down"
    shown = shown_value([round(value, 6) for value in marker.orientation_xyzw])
    upright = f"upright, on a wall that faces the map's x axis, it is {_UPRIGHT_XYZW}"
    doubt = f"marker {marker.marker_id} {hangs} by this x, y, z, w: {upright}"
    return [str(_problem(source, (*at, "orientation_xyzw"), shown, doubt))]


def _wrong(source: Source, at: Location, value: Any, wanted: str) -> WorldError:
    return WorldError([_problem(source, at, shown_value(value), wanted)])


def _problem(source: Source, at: Location, shown: str, wanted: str) -> Problem:
    return Problem(
        file=source.file, line=source.line_of(at), field=field_name(at), value=shown, must=wanted
    )
