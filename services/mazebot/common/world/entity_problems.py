"""Problems of an entity in any world: spawner and physics refuse the same ones."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mazebot.common.maths.frames import Posed
from mazebot.common.messages.documents import BodyEntity, Entity

MAX_NAME = 100
MAX_DISTANCE_M = 1_000.0


def entity_problems(entity: Entity) -> Iterator[str]:
    """Each problem, as a phrase that names the field and the value."""
    yield from name_problems(entity.name)
    yield from pose_problems(entity)
    if isinstance(entity, BodyEntity):
        yield from _body_problems(entity)
    elif not entity.marker_size_m <= entity.panel_side_m:
        yield f"marker_size_m: {entity.marker_size_m:g}: must be at most the panel's side"


def name_problems(name: str) -> Iterator[str]:
    """Problems of a name, which is also a frame name."""
    if not (0 < len(name) <= MAX_NAME and name.isprintable() and name == name.strip()):
        yield (
            f"name: {name!r:.60}: must be 1 to {MAX_NAME} printable characters, without "
            "leading or trailing spaces"
        )
    if name.startswith("/"):
        yield f"name: {name!r:.60}: must not begin with a slash: it names a frame"


def pose_problems(posed: Posed) -> Iterator[str]:
    """Problems of a pose. A position that is not finite counts as too far."""
    if not all(abs(value) <= MAX_DISTANCE_M for value in posed.position_m):
        yield f"position_m: {posed.position_m}: must be within {MAX_DISTANCE_M:g} m"
    if not abs(math.hypot(*posed.orientation_xyzw) - 1.0) <= 1e-3:
        yield f"orientation_xyzw: {posed.orientation_xyzw}: must be of unit length"


def _body_problems(entity: BodyEntity) -> Iterator[str]:
    names = {material.name for material in entity.materials}
    if len(names) < len(entity.materials):
        yield "materials: must have unique names"
    for shape in entity.shapes:
        if shape.material and shape.material not in names:
            yield (
                f"shape {shape.name!r:.60}: material: {shape.material!r:.60}: must be one of its "
                "materials"
            )
    if entity.path is not None and entity.mass_kg > 0.0:
        yield f"mass_kg: {entity.mass_kg:g}: must be 0: it follows a path"
