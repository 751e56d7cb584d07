"""Converts a world's markers to entities."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from mazebot.common.maths.frames import Array, position_and_quaternion
from mazebot.common.messages.documents import Entities, Marker, MarkerEntity, Refusal, World
from mazebot.common.world import marker_picture
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.placement import Panel, Placement, hang

MAX_MARKERS = 128


@dataclass(frozen=True)
class PanelStyle:
    """How markers are drawn and mounted."""

    gap_m: float = 0.002
    """Distance from a wall's face to the marker's, against z-fighting."""
    module_px: int = 64
    """Side of one module of a marker in its texture."""


def marker_entities(
    world: World,
    style: PanelStyle = PanelStyle(),
    max_markers: int = MAX_MARKERS,
    meshes: Mapping[str, TriangleMesh] | None = None,
    placement: Placement | None = None,
) -> tuple[Entities, dict[str, bytes]]:
    """The entities of a world's markers, and their textures as PNG by sha256.

    A marker with an invalid placement is refused, without effect on the others; of two with the
    same id, or at the same place, the first is kept. `meshes` are by sha256; missing ones are
    ignored. `placement` is this world's Placement, if one exists already.
    """
    if placement is None:
        placement = Placement(world, meshes)
    walls = {wall.name: wall for wall in world.walls}
    entities: list[MarkerEntity] = []
    refused: list[Refusal] = []
    hanging: list[Panel] = []
    textures: dict[str, bytes] = {}
    on_wall: dict[int, str] = {}
    own = marker_picture.own_dictionaries(world.dictionaries)
    for marker in world.markers:
        name = marker.name
        dictionary = own.get(marker.dictionary)
        reason = marker_picture.identity_problem(marker, dictionary)
        if not reason and marker.id in on_wall:
            # The small dictionaries are prefixes of the large ones: an id is one marker in all.
            reason = f"id: {marker.id}: must be unique: already on {on_wall[marker.id]}"
        if not reason and marker.wall not in walls:
            reason = f"wall: {marker.wall!r:.60}: no such wall"
        if not reason and len(entities) >= max_markers:
            reason = f"too many markers: at most {max_markers}"
        if not reason:
            side_m = marker_picture.panel_side_m(marker, dictionary)
            panel = hang(name, marker, walls[marker.wall], side_m, style.gap_m)
            reason = placement.problem(panel, hanging, marker.wall)
        if reason:
            refused.append(Refusal(name=name, reason=reason))
            continue
        data = marker_picture.draw(marker, style.module_px, dictionary)
        sha256 = hashlib.sha256(data).hexdigest()
        textures[sha256] = data
        on_wall[marker.id] = marker.wall
        hanging.append(panel)
        entities.append(marker_entity(marker, panel, sha256))
    return (
        Entities(world_hash=world.hash, entities=tuple(entities), refused=tuple(refused)),
        textures,
    )


def drawn_marker(
    name: str, marker: Marker, map_from_panel: Array
) -> tuple[MarkerEntity, dict[str, bytes]]:
    """The entity of a marker of OpenCV's dictionaries at a pose, (4, 4), and its texture as PNG by
    sha256.
    """
    texture = marker_picture.draw(marker, PanelStyle().module_px)
    sha256 = hashlib.sha256(texture).hexdigest()
    panel = Panel(name, map_from_panel, marker_picture.panel_side_m(marker))
    return marker_entity(marker, panel, sha256), {sha256: texture}


def marker_entity(marker: Marker, panel: Panel, sha256: str) -> MarkerEntity:
    """The entity of a marker on its panel, with the panel's name and the texture of this sha256."""
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
