"""Which of the desired entities can stand in the world, and why the others cannot."""

from __future__ import annotations

import math
from collections.abc import Container

from services.common.documents import Entities, MarkerEntity, Refusal
from services.common.placement import Panel, Placement, panel_of

MAX_ENTITIES = 200
MAX_PANEL_SIDE_M = 3.0
MAX_COORDINATE_M = 1_000.0


def review(desired: Entities, textures: Container[str], placement: Placement) -> Entities:
    """The entities that exist where `desired` is what should: same input, same set.

    `textures` are the sha256 of the assets at hand. A panel hangs where `placement` lets it, beside
    those before it. Order is kept; of two with one name the first stands.
    """
    accepted: list[MarkerEntity] = []
    refused: list[Refusal] = []
    names: set[str] = set()
    hanging: list[Panel] = []
    for entity in desired.markers:
        reason = _reason(entity, names, textures)
        if not reason and len(accepted) >= MAX_ENTITIES:
            reason = f"there are {MAX_ENTITIES} entities already: no more fit"
        panel = panel_of(entity)
        reason = reason or placement.problem(panel, hanging)
        if reason:
            refused.append(Refusal(name=entity.name, reason=reason))
        else:
            names.add(entity.name)
            hanging.append(panel)
            accepted.append(entity)
    return Entities(world_hash=desired.world_hash, entities=tuple(accepted), refused=tuple(refused))


def _reason(entity: MarkerEntity, names: Container[str], textures: Container[str]) -> str:
    """Why an entity cannot stand; empty where it can."""
    numbers = (
        *entity.position_m,
        *entity.orientation_xyzw,
        entity.panel_side_m,
        entity.marker_size_m,
    )
    if not all(map(math.isfinite, numbers)):
        return "position_m, orientation_xyzw, panel_side_m, marker_size_m: must be finite"
    if entity.name in names:
        return f"name: {entity.name!r} is there already"
    if max(map(abs, entity.position_m)) > MAX_COORDINATE_M:
        return f"position_m: {entity.position_m} is farther than {MAX_COORDINATE_M:g} m"
    norm = math.hypot(*entity.orientation_xyzw)
    if abs(norm - 1.0) > 1e-3:
        return f"orientation_xyzw: {entity.orientation_xyzw} is not of unit length"
    if entity.panel_side_m > MAX_PANEL_SIDE_M:
        return f"panel_side_m: {entity.panel_side_m:g} is more than {MAX_PANEL_SIDE_M:g}"
    if entity.marker_size_m > entity.panel_side_m:
        return (
            f"marker_size_m: {entity.marker_size_m:g} is more than the panel's "
            f"{entity.panel_side_m:g}"
        )
    if entity.texture_sha256 not in textures:
        return f"texture_sha256: there is no asset {entity.texture_sha256[:16]!r}"
    return ""
