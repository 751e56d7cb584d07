"""simulation_interfaces: what entities are, and which of them a request means."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any, Final

from mazebot.common.messages import documents as doc
from mazebot.common.ros.entity_bounds import problem_of_bounds

OBJECT, DYNAMIC_OBJECT, STATIC_OBJECT = 0, 4, 5
"""Of EntityCategory."""
_CATEGORIES: Final = range(6)
_ALL: Final = 1
"""TagsFilter.FILTER_MODE_ALL; else one of the tags is enough."""
_PLAIN_FILTER = re.compile(r"[\w .|^$*/-]*")
_MOST_STARS = 2


def category_of(entity: doc.Entity) -> int:
    """Whether it moves by itself, can be pushed, or stays."""
    if isinstance(entity, doc.MarkerEntity) or not entity.moves:
        return STATIC_OBJECT
    return DYNAMIC_OBJECT if entity.path is not None else OBJECT


def tags_of(entity: doc.Entity) -> tuple[str, ...]:
    """Its kind, `marker` or `body`."""
    return (entity.kind,)


def info_of(entity: doc.Entity) -> dict[str, Any]:
    """An EntityInfo."""
    if isinstance(entity, doc.MarkerEntity):
        description = (
            f"ArUco marker {entity.marker_id} of {entity.dictionary}, {entity.marker_size_m:g} m"
        )
    else:
        shapes = ", ".join(dict.fromkeys(shape.geometry.kind for shape in entity.shapes))
        weight = f"{entity.mass_kg:g} kg" if entity.mass_kg else "cannot be pushed"
        description = f"{shapes}; {weight}"
        if entity.path is not None:
            description += f"; on a path at {entity.path.speed_m_s:g} m/s"
    return {
        "category": {"category": category_of(entity)},
        "description": description,
        "tags": list(tags_of(entity)),
    }


def has_tags(tags: Collection[str], wanted: Any) -> bool:
    """Whether a TagsFilter lets something with these tags through."""
    if not wanted.tags:
        return True
    found = [tag in tags for tag in wanted.tags]
    return all(found) if wanted.filter_mode == _ALL else any(found)


def problem_of(filters: Any) -> str:
    """Why filters are not supported; empty: they are. A name's pattern is one that takes no longer
    than its length times the name's: without groups, and with few stars.
    """
    problem = problem_of_bounds(filters.bounds)
    if problem:
        return f"filters.bounds.{problem}"
    for category in filters.categories:
        if category.category not in _CATEGORIES:
            return f"filters.categories: {category.category}: must be one of EntityCategory's"
    pattern = filters.filter
    if not _PLAIN_FILTER.fullmatch(pattern) or pattern.count("*") > _MOST_STARS:
        return (
            f"filters.filter: {pattern!r:.80}: must consist of letters, digits, |, ^, $, . and at "
            f"most {_MOST_STARS} *"
        )
    try:
        re.compile(pattern)
    except re.error as error:
        return f"filters.filter: {pattern!r:.80}: {error}"
    return ""


def filtered(entities: Sequence[doc.Entity], filters: Any) -> list[doc.Entity]:
    """The entities that filters without a problem mean, wherever they are."""
    pattern = re.compile(filters.filter)
    categories = {category.category for category in filters.categories}
    return [
        one
        for one in entities
        if pattern.search(one.name)
        and (not categories or category_of(one) in categories)
        and has_tags(tags_of(one), filters.tags)
    ]
