"""A world's markers to the entities that should stand in it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from services.common.frames import position_and_quaternion
from services.common.node.documents import Entities, Marker, MarkerEntity, Refusal, World
from services.common.world import marker_picture
from services.common.world.geometry import TriangleMesh
from services.common.world.placement import Panel, Placement, hang

MAX_MARKERS = 128


@dataclass(frozen=True)
class PanelStyle:
    """How markers are drawn, and how they hang."""

    gap_m: float = 0.002
    """From a wall's face to the marker's, against z-fighting."""
    module_px: int = 64
    """Side of one module of a marker in its picture."""


def furnish(
    world: World,
    style: PanelStyle = PanelStyle(),
    max_markers: int = MAX_MARKERS,
    meshes: Mapping[str, TriangleMesh] | None = None,
    placement: Placement | None = None,
) -> tuple[Entities, dict[str, bytes]]:
    """The entities that a world's markers make, and their textures as PNG by sha256.

    A marker that cannot hang is refused, and the others hang all the same; of two with one id, or
    in one place, the first hangs. `meshes` are by sha256; those that are not there are in no
    marker's way. `placement` is the judge of places in this world where there is one already.
    """
    if placement is None:
        placement = Placement(world, meshes)
    walls = {wall.name: wall for wall in world.walls}
    entities: list[MarkerEntity] = []
    refused: list[Refusal] = []
    hanging: list[Panel] = []
    textures: dict[str, bytes] = {}
    on_wall: dict[int, str] = {}
    for marker in world.markers:
        name = marker.name
        reason = marker_picture.identity_problem(marker)
        if not reason and marker.id in on_wall:
            # The small dictionaries are the beginnings of the large ones: an id is one marker.
            reason = f"id: {marker.id}: must be unique: it hangs on {on_wall[marker.id]}"
        if not reason and marker.wall not in walls:
            reason = f"wall: {marker.wall!r:.60}: there is none of this name"
        if not reason and len(entities) >= max_markers:
            reason = f"there are {max_markers} markers already: no more fit"
        if not reason:
            side_m = marker_picture.panel_side_m(marker)
            panel = hang(name, marker, walls[marker.wall], side_m, style.gap_m)
            reason = placement.problem(panel, hanging, marker.wall)
        if reason:
            refused.append(Refusal(name=name, reason=reason))
            continue
        data = marker_picture.draw(marker, style.module_px)
        sha256 = hashlib.sha256(data).hexdigest()
        textures[sha256] = data
        on_wall[marker.id] = marker.wall
        hanging.append(panel)
        entities.append(marker_entity(marker, panel, sha256))
    return (
        Entities(world_hash=world.hash, entities=tuple(entities), refused=tuple(refused)),
        textures,
    )


def marker_entity(marker: Marker, panel: Panel, sha256: str) -> MarkerEntity:
    """A marker on its panel, of the panel's name, with the texture of this sha256."""
    position_m, orientation_xyzw = position_and_quaternion(panel.map_from_panel)
    return MarkerEntity(
        name=panel.name,
        position_m=position_m,
        orientation_xyzw=orientation_xyzw,
        panel_side_m=panel.side_m,
        texture_sha256=sha256,
        marker_id=marker.id,
        marker_size_m=marker.size_m,
        dictionary=marker.dictionary,
    )
