"""Which markers of a world the robot knows, and where it takes them to be."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from mazebot.common.messages.documents import MappedMarker, MarkerEntity, World


class KnownMarkers(NamedTuple):
    """The markers of a world as the robot's map has them."""

    known: tuple[MarkerEntity, ...]
    """At their poses in the robot's map, which are not always the true ones."""
    unknown: dict[str, str]
    """Why the robot does not know a marker, by its name and by its id."""


def known_markers(world: World, markers: Iterable[MarkerEntity]) -> KnownMarkers:
    """What the robot of a world knows of these markers: all at their true poses; with
    `mapped_markers` these only, at the poses that the map has; with slam none, as it has no map.
    """
    if not world.slam and world.mapped_markers is None:
        return KnownMarkers(tuple(markers), {})
    mapped: dict[tuple[str, int], list[MappedMarker]] = {}
    for one in world.mapped_markers or ():
        mapped.setdefault((one.dictionary, one.marker_id), []).append(one)
    known: list[MarkerEntity] = []
    unknown: dict[str, str] = {}
    hanging = set()
    for marker in markers:
        key = (marker.dictionary, marker.marker_id)
        hanging.add(key)
        places = mapped.get(key, [])
        if len(places) == 1:
            pose = places[0].model_dump(include={"position_m", "orientation_xyzw"})
            known.append(marker.model_copy(update=pose))
            continue
        why = "with slam, the robot does not know where the world's markers are"
        if not world.slam:
            count = f"in {len(places)} places" if places else "not"
            why = f"{_called(*key)} is {count} among the markers of the robot's map"
        unknown |= dict.fromkeys((str(marker.marker_id), marker.name), why)
    for key in mapped.keys() - hanging:
        why = f"{_called(*key)}, which the robot's map has, is not in the world"
        unknown.setdefault(str(key[1]), why)
    return KnownMarkers(tuple(known), unknown)


def _called(dictionary: str, marker_id: int) -> str:
    return f"marker {marker_id} of {dictionary}"
