"""How the world, its entities, and their textures are drawn."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mazebot.common.files import png
from mazebot.common.maths.frames import MAP_FRAME, Array
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.world.assets import assets_of
from mazebot.common.world.surfaces import PLAIN
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas, entity_part
from mazebot.recorder.drawing.marker_drawing import draw_marker_states
from mazebot.recorder.drawing.mesh import mesh_drawing, panel
from mazebot.recorder.drawing.room_names import name_places_m
from mazebot.recorder.drawing.scenery import Part, entity_parts, parts, plain_rgba, seen_meshes
from mazebot.recorder.judging.obstacles import read_meshes

_TEXTURE_SIDE_PX = 256
_MOST_GONE = 1000
"""Removed entities that are remembered, so that they need not be drawn again if they return."""


def draw_asset(canvas: Canvas, asset: msg.CompressedImage) -> None:
    """Draw the entities that were waiting for a texture or a mesh."""
    sha256 = asset.header.frame_id
    if not canvas.changed(f"world/assets/{sha256}", True):
        return
    wanted = {mesh for body in canvas.world.bodies for mesh in seen_meshes(body)}
    if sha256 in wanted:
        # Draw the bodies once, when the last of their meshes has arrived.
        if wanted <= canvas.assets.keys():
            draw_world(canvas, canvas.world)
        return
    materials = [m.name for m in canvas.world.materials if m.texture_sha256 == sha256]
    for part in canvas.parts:
        if part.material in materials:
            _draw_world_part(canvas, part)
    for entity in canvas.entities.entities if canvas.entities else ():
        if sha256 in assets_of(entity):
            _draw_looks(canvas, entity)


def draw_world(canvas: Canvas, world: doc.World) -> None:
    """Walls, floors, ceiling and bodies by material, rooms, named locations and lamps.

    The upper part of walls and bodies, and the ceiling, are separate entities.
    """
    canvas.parts = parts(world, read_meshes(world.bodies, canvas.assets))
    for part in canvas.parts:
        _draw_world_part(canvas, part)
    log = canvas.recording.log
    canvas.recording.at(canvas.now_ns)
    for body in world.bodies:
        if body.mass_kg > 0.0:
            # Initial pose, until the simulation publishes one.
            path = f"tf/{entity_part(body.name)}"
            pose = body.position_m, body.orientation_xyzw
            canvas.recording.transform(path, *pose, MAP_FRAME, body.name)
    outlines = [np.array([*room.polygon_m, room.polygon_m[0]]) for room in world.rooms]
    log(
        "world/rooms",
        rr.CoordinateFrame(MAP_FRAME),
        rr.LineStrips3D(
            [_on_the_floor(line) for line in outlines], colors=palette.SECOND, radii=0.01
        ),
        static=True,
    )
    locations_m = np.array([(place.x_m, place.y_m) for place in world.locations]).reshape(-1, 2)
    log(
        "world/rooms/names",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(
            _on_the_floor(name_places_m(outlines, locations_m)),
            labels=[room.name for room in world.rooms],
            colors=palette.ROOM,
            radii=0.01,
        ),
        static=True,
    )
    if world.keepout_zones or world.speed_limits:
        _draw_zones(canvas, world)
    log(
        "world/locations",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(
            _on_the_floor(locations_m),
            labels=[place.name for place in world.locations],
            colors=palette.LOCATION,
            radii=0.05,
        ),
        static=True,
    )
    log(
        "world/lights",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(
            [lamp.position_m for lamp in world.lights],
            labels=[lamp.name for lamp in world.lights],
            colors=[lamp.diffuse for lamp in world.lights],
            radii=0.06,
        ),
        static=True,
    )


def _draw_zones(canvas: Canvas, world: doc.World) -> None:
    """Outlines of keepout zones and of speed limits, each with its label."""
    zones = [(zone.polygon_m, f"keepout: {zone.name}", palette.BAD) for zone in world.keepout_zones]
    for zone in world.speed_limits:
        limit = f"{zone.percent or 0.0:g} %"
        if zone.speed_limit_m_s is not None:
            limit = f"{zone.speed_limit_m_s:g} m/s"
        zones.append((zone.polygon_m, f"{limit}: {zone.name}", palette.ESTIMATE))
    outlines = [np.array([*polygon, polygon[0]]) for polygon, _, _ in zones]
    colors = [color for _, _, color in zones]
    canvas.recording.log(
        "world/zones",
        rr.CoordinateFrame(MAP_FRAME),
        rr.LineStrips3D([_on_the_floor(line) for line in outlines], colors=colors, radii=0.02),
        static=True,
    )
    canvas.recording.log(
        "world/zones/names",
        rr.CoordinateFrame(MAP_FRAME),
        rr.Points3D(
            _on_the_floor(name_places_m(outlines, np.empty((0, 2)))),
            labels=[name for _, name, _ in zones],
            colors=colors,
            radii=0.01,
        ),
        static=True,
    )


def _on_the_floor(points_m: Array) -> Array:
    """(n, 3) from points (n, 2): just high enough above the floor to be visible."""
    return np.column_stack([points_m, np.full(len(points_m), 0.02)])


def draw_desired_entities(canvas: Canvas, entities: doc.Entities) -> None:
    """Number of desired entities, and how many of them were refused."""
    if entities.world_hash != canvas.world.hash:
        return
    counts = len(entities.entities), len(entities.refused)
    if canvas.changed("entities/desired", counts):
        canvas.recording.at(canvas.now_ns)
        values = rr.AnyValues(entities=counts[0], refused=counts[1])
        canvas.recording.log("entities/desired", values)


def draw_entities(canvas: Canvas, entities: doc.Entities) -> None:
    """The markers' panels and the bodies, at their poses while they exist.

    Each has its own frame, which carries its pose over time; its meshes are static.
    """
    if entities.world_hash != canvas.world.hash:
        return
    before = {entity.name: entity for entity in canvas.entities.entities} if canvas.entities else {}
    after = {entity.name: entity for entity in entities.entities}
    canvas.entities = entities
    for name, entity in before.items():
        if name not in after or _frame_of(after[name]) != _frame_of(entity):
            canvas.recording.at(canvas.now_ns)
            _place(canvas, entity, shown=False)
    for name, entity in after.items():
        known = before.get(name)
        if known == entity:
            continue
        if canvas.changed(f"entities/{name}#looks", _looks(entity)):
            _draw_looks(canvas, entity)
        if (
            known is None
            and canvas.now_ns > canvas.start_ns
            and canvas.changed(_path_of(entity), 0)
        ):
            # It did not exist until now.
            canvas.recording.at(canvas.start_ns)
            _place(canvas, entity, shown=False)
        canvas.recording.at(canvas.now_ns)
        _place(canvas, entity)
    canvas.recording.at(canvas.now_ns)
    draw_marker_states(canvas)
    gone = [name for name in canvas.drawn if name not in after]
    for name in gone[: max(0, len(gone) - _MOST_GONE)]:
        del canvas.drawn[name]
        part = entity_part(name)
        for path in (f"entities/{name}#looks", f"entities/{part}", f"tf/{part}"):
            canvas.last.pop(path, None)


def place_what_stands(canvas: Canvas) -> None:
    """Log the poses of the entities that are not in /tf again."""
    canvas.recording.at(canvas.now_ns)
    for entity in canvas.entities.entities if canvas.entities is not None else ():
        if not _moves(entity):
            _place(canvas, entity)


def _draw_world_part(canvas: Canvas, part: Part) -> None:
    material = next((m for m in canvas.world.materials if m.name == part.material), PLAIN)
    _draw_part(canvas, "world", part, material)


def _draw_part(canvas: Canvas, above: str, part: Part, material: doc.Material) -> None:
    texture = _texture(canvas, material.texture_sha256) if part.textured else None
    mesh = part.mesh
    drawn = rr.Mesh3D(
        vertex_positions=mesh.vertices_m.astype(np.float32),
        vertex_normals=mesh.normals.astype(np.float32),
        vertex_texcoords=None if texture is None else mesh.uvs.astype(np.float32),
        triangle_indices=mesh.triangles.astype(np.uint32),
        albedo_texture=texture,
        albedo_factor=plain_rgba(material, part) if texture is None else None,
    )
    path = "/".join([above, *map(entity_part, part.path)])
    canvas.recording.log(path, rr.CoordinateFrame(part.frame), drawn, static=True)


def _frame_of(entity: doc.Entity) -> str:
    """The frame of an entity: that in /tf if it moves, or a separate one."""
    return entity.name if _moves(entity) else f"entities/{entity.name}"


def _path_of(entity: doc.Entity) -> str:
    """The entity path on which an entity's transform is logged."""
    name = entity_part(entity.name)
    return f"tf/{name}" if _moves(entity) else f"entities/{name}"


def _moves(entity: doc.Entity) -> bool:
    """Whether the entity's pose is published on /tf."""
    return isinstance(entity, doc.BodyEntity) and entity.moves


def _looks(entity: doc.Entity) -> tuple[object, ...]:
    """Everything that an entity's drawing depends on, except its pose."""
    if isinstance(entity, doc.MarkerEntity):
        return entity.panel_side_m, entity.texture_sha256
    return entity.shapes, entity.materials, entity.moves


def _place(canvas: Canvas, entity: doc.Entity, shown: bool = True) -> None:
    """Log an entity's pose, or hide it. The time must be set."""
    canvas.recording.transform(
        _path_of(entity),
        entity.position_m,
        entity.orientation_xyzw,
        MAP_FRAME,
        _frame_of(entity),
        shown,
    )


def _draw_looks(canvas: Canvas, entity: doc.Entity) -> None:
    """Draw an entity in its frame, replacing an earlier one of its name."""
    above, frame = f"entities/{entity_part(entity.name)}", _frame_of(entity)
    drawn: list[str] = []
    if isinstance(entity, doc.MarkerEntity):
        drawn.append(f"{above}/panel")
        mesh = mesh_drawing(panel(entity.panel_side_m), _texture(canvas, entity.texture_sha256))
        canvas.recording.log(drawn[-1], rr.CoordinateFrame(frame), mesh, static=True)
    else:
        materials = {material.name: material for material in entity.materials}
        for part in entity_parts(entity, frame, canvas.assets):
            drawn.append("/".join([above, *map(entity_part, part.path)]))
            _draw_part(canvas, above, part, materials.get(part.material, PLAIN))
    for path in canvas.drawn.get(entity.name, ()):
        if path not in drawn:
            canvas.recording.log(path, rr.Mesh3D(vertex_positions=[]), static=True)
    canvas.drawn[entity.name] = drawn


def _texture(canvas: Canvas, sha256: str) -> NDArray[np.uint8] | None:
    """A received texture, as (h, w, 3) RGB of at most 256 pixels per side."""
    data = canvas.assets.get(sha256)
    if data is None:
        return None
    canvas.changed(f"world/assets/{sha256}", True)
    try:
        rgb = png.decode(data)
    except ValueError:
        return None
    scale = _TEXTURE_SIDE_PX / max(rgb.shape[:2])
    if scale < 1.0:
        return np.asarray(
            cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
    return rgb
