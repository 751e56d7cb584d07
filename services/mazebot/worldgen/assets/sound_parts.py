"""A recipe without its invalid parts, so that the rest can be checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from mazebot.common.problems import Location
from mazebot.worldgen.recipe_model import Recipe


@dataclass(frozen=True)
class SoundParts:
    """A recipe's content with invalid parts left out, and the list of these."""

    content: dict[str, Any]
    dropped: frozenset[str]
    """Fields left out as a whole; required ones get a harmless value."""
    kept: Mapping[str, tuple[int, ...]]
    """For each list that lost parts, the former indices of the others."""
    lost_names: frozenset[str]
    """Names of the parts left out."""

    def explains(self, location: Location, value: object) -> bool:
        """Whether a problem at a location is only caused by what was left out."""
        about_material = "material" in str(location[-1]) or location[0] == "wall_materials"
        return (
            location[0] in self.dropped
            or (isinstance(value, str) and value in self.lost_names)
            or (about_material and "materials" in self.dropped)
        )

    @property
    def lost_something_solid(self) -> bool:
        """If so, the floor may end elsewhere, but no obstacle was added."""
        solid = {"walls", "maze", "boxes", "cylinders", "meshes", "bodies", "wall_thickness_m"}
        return not solid.isdisjoint((*self.dropped, *self.kept))

    def before(self, location: Location) -> Location:
        """A location, with its index before parts were left out."""
        if len(location) > 1 and location[0] in self.kept and isinstance(location[1], int):
            return (location[0], self.kept[str(location[0])][location[1]], *location[2:])
        return location


def sound_parts(content: Mapping[Any, Any], wrong: Iterable[Location], name: str) -> SoundParts:
    """Leave out the part of a list or of a mapping by name that contains a wrong location, else the
    whole field. `name` is the recipe's expected name.
    """
    left: dict[str, Any] = {
        field: value for field, value in content.items() if field in Recipe.model_fields
    }
    dropped: set[str] = set()
    indexes: dict[str, set[int]] = {}
    lost: set[str] = set()
    for place in wrong:
        field, inner = str(place[0]) if place else "", place[1] if len(place) > 1 else None
        value = left.get(field)
        if isinstance(value, tuple) and isinstance(inner, int) and field != "sky":
            indexes.setdefault(field, set()).add(inner)
        elif isinstance(value, Mapping) and inner in value and _by_name(field):
            lost.add(str(inner))
            rest = {key: part for key, part in value.items() if key != inner}
            # A material that exists, with default looks.
            left[field] = {**rest, inner: {}} if field == "materials" and len(place) > 2 else rest
        elif field in Recipe.model_fields:
            dropped.add(field)
    kept = {}
    for field, gone in indexes.items():
        if field in dropped:
            continue
        parts = left[field]
        kept[field] = tuple(index for index in range(len(parts)) if index not in gone)
        left[field] = tuple(parts[index] for index in kept[field])
        for index in sorted(gone):
            part = parts[index]
            if isinstance(part, Mapping) and isinstance(part.get("name"), str):
                lost.add(part["name"])
    for field in dropped:
        left.pop(field, None)
    materials = left.get("materials") or {"": {}}
    harmless = {
        "name": name,
        "wall_height_m": 1.0,
        "materials": {},
        "wall_materials": (next(iter(materials)) or "none",),
    }
    for field, value in harmless.items():
        if not left.get(field):
            left[field] = value
            dropped.add(field)
    return SoundParts(left, frozenset(dropped), kept, frozenset(lost))


def _by_name(field: str) -> bool:
    return field in ("materials", "rooms", "locations")
