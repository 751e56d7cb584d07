"""Brings the existing entities to the desired set, with the reason for each that is refused."""

from __future__ import annotations

import functools
import math
from collections.abc import Container, Iterator, Mapping

from mazebot.common.files import png
from mazebot.common.messages.documents import (
    MAX_PATH_SPEED_M_S,
    BodyEntity,
    Entities,
    Entity,
    Geometry,
    MarkerEntity,
    Material,
    Mesh,
    Polyline,
    Refusal,
)
from mazebot.common.world.entity_problems import entity_problems
from mazebot.common.world.geometry import triangles_of
from mazebot.common.world.placement import Placement, panel_of
from mazebot.physics.assets import meshes_of
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.scripted_path import Route
from mazebot.physics.bodies.world_limits import MAX_LENGTH_M, body_problems

_MOST_NAMED = 10
"""Entities in one line of the log"""
MAX_MARKERS = 200
MAX_BODIES = 200
MAX_SHAPES = 100
"""Of one body"""
MAX_CORNERS = 5_000
"""Of the polylines of one body"""
MAX_TRIANGLES = 500_000
"""Of all bodies as drawn: PyBullet takes a second to make solid meshes of so many."""
MAX_TEXTURE_PX = 32 * 1024 * 1024
"""Of all bodies: a renderer holds them unpacked."""
MAX_WAY_M = 200.0
"""Length of a path's cycle, from the start back to the start"""
MAX_PANEL_SIDE_M = 3.0


def establish(
    desired: Entities,
    standing: Entities | None,
    files: Mapping[str, bytes],
    placement: Placement,
    bodies: Bodies,
) -> Entities:
    """Add, move and remove the entities that differ from `standing`; returns those that exist now.

    An unchanged entity is not checked again, so that a robot may drive up to it. A change that is
    refused leaves the entity as it was; of two with the same name the first is taken. If PyBullet
    was rebuilt, the previous entities are restored first.
    `files` are the received assets by their sha256. Panels are placed where `placement` allows.
    """
    before = _restored(standing, files, bodies)
    wanted: dict[str, Entity] = {}
    for entity in desired.entities:
        wanted.setdefault(entity.name, entity)
    for name in bodies.entities:
        if not isinstance(wanted.get(name), BodyEntity):
            bodies.remove(name)
    now = {
        name: one for name, one in before.items() if name in wanted and _alike(one, wanted[name])
    }
    """Existing entities that are kept until their turn."""
    stands: dict[str, Entity] = {}
    refused: list[Refusal] = []
    for entity in desired.entities:
        name = entity.name
        if name in stands:
            reason = f"name: {name!r:.60} already exists"
        elif now.get(name) == entity:
            reason = ""
        else:
            others = {**now, **stands}
            others.pop(name, None)
            if isinstance(entity, MarkerEntity):
                reason = _hang(entity, others, files, placement)
            else:
                reason = _put(entity, others, files, bodies)
        if not reason:
            stands[name] = entity
        else:
            refused.append(Refusal(name=name, reason=reason))
            if name in now:
                stands.setdefault(name, now[name])
    bodies.arrange(stands)
    return desired.model_copy(
        update={"entities": tuple(stands.values()), "refused": tuple(refused)}
    )


def change_text(before: Entities | None, after: Entities) -> str:
    """The changes in words: `spawned: a, b; deleted: c; changed: d`; for a world's first set, only
    the number of entities.
    """
    if before is None:
        return f"{len(after.entities)} entities in the world"
    old = {entity.name: entity for entity in before.entities}
    new = {entity.name: entity for entity in after.entities}
    names = {
        "spawned": [name for name in new if name not in old],
        "deleted": [name for name in old if name not in new],
        "changed": [name for name in new if name in old and new[name] != old[name]],
    }
    return "; ".join(f"{verb}: {_listed(of_it)}" for verb, of_it in names.items() if of_it)


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _restored(
    standing: Entities | None, files: Mapping[str, bytes], bodies: Bodies
) -> dict[str, Entity]:
    """The previous entities by name, without those that cannot be restored after a rebuild."""
    before = {one.name: one for one in standing.entities} if standing is not None else {}
    for name, one in list(before.items()):
        if isinstance(one, BodyEntity) and name not in bodies.entities:
            if bodies.put(one, meshes_of([one], files)):
                del before[name]
    return before


def _alike(one: Entity, other: Entity) -> bool:
    return one.kind == other.kind


def _hang(
    entity: MarkerEntity,
    others: Mapping[str, Entity],
    files: Container[str],
    placement: Placement,
) -> str:
    """Why a marker cannot be placed; empty if it can."""
    hanging = [panel_of(one) for one in others.values() if isinstance(one, MarkerEntity)]
    if len(hanging) >= MAX_MARKERS:
        return f"too many markers: at most {MAX_MARKERS}"
    return _marker_problem(entity, files) or placement.problem(panel_of(entity), hanging)


def _marker_problem(entity: MarkerEntity, files: Container[str]) -> str:
    for problem in entity_problems(entity):
        return problem
    if entity.panel_side_m > MAX_PANEL_SIDE_M:
        return f"panel_side_m: {entity.panel_side_m:g} is more than {MAX_PANEL_SIDE_M:g}"
    if entity.texture_sha256 not in files:
        return f"texture_sha256: {entity.texture_sha256[:16]!r}: no such asset"
    return ""


def _put(
    entity: BodyEntity, others: Mapping[str, Entity], files: Mapping[str, bytes], bodies: Bodies
) -> str:
    """Spawn a body at its desired pose; returns empty, or why it cannot be."""
    there = [one for one in others.values() if isinstance(one, BodyEntity)]
    if len(there) >= MAX_BODIES:
        return f"too many bodies: at most {MAX_BODIES}"
    if entity.name in bodies.fixed_names:
        return f"name: {entity.name!r:.60}: is already used in the world"
    for problem in (*entity_problems(entity), *_size_problems(entity)):
        return problem
    try:
        meshes = meshes_of([entity], files)
    except ValueError as error:
        return str(error)
    for problem in (
        *body_problems(entity, meshes, bodies.frames),
        *_path_problems(entity),
        *_material_problems(entity, files),
    ):
        return problem
    triangles = sum(_triangles(one, files) for one in (*there, entity))
    if triangles > MAX_TRIANGLES:
        return f"shapes: {triangles} triangles in all bodies: at most {MAX_TRIANGLES}"
    materials = (material for one in (*there, entity) for material in one.materials)
    textures = {material.texture_sha256 for material in materials} - {""}
    if (pixels := sum(math.prod(png.size_px(files[sha])) for sha in textures)) > MAX_TEXTURE_PX:
        return f"materials: textures of {pixels} pixels in all bodies: at most {MAX_TEXTURE_PX}"
    return bodies.put(entity, meshes)


def _triangles(entity: BodyEntity, files: Mapping[str, bytes]) -> int:
    """Triangles of all shapes, several of which may use the same mesh."""
    meshes = meshes_of([entity], files)
    return sum(
        len(meshes[shape.geometry.sha256].triangles)
        if isinstance(shape.geometry, Mesh)
        else _drawn(shape.geometry)
        for shape in entity.shapes
    )


@functools.lru_cache(maxsize=4096)
def _drawn(geometry: Geometry) -> int:
    return len(triangles_of(geometry, {}).triangles)


def _size_problems(entity: BodyEntity) -> Iterator[str]:
    if not 0 < len(entity.shapes) <= MAX_SHAPES:
        yield f"shapes: {len(entity.shapes)} of them: must be 1 to {MAX_SHAPES}"
    corners = sum(
        len(polygon)
        for shape in entity.shapes
        if isinstance(shape.geometry, Polyline)
        for polygon in shape.geometry.polygons_m
    )
    if corners > MAX_CORNERS:
        yield f"shapes: {corners} corners of polylines: at most {MAX_CORNERS}"


def _path_problems(entity: BodyEntity) -> Iterator[str]:
    path = entity.path
    if path is None:
        return
    if not 0.0 < path.speed_m_s <= MAX_PATH_SPEED_M_S:
        yield f"path: speed_m_s: {path.speed_m_s}: must be above 0, at most {MAX_PATH_SPEED_M_S:g}"
    for place in path.waypoints_m:
        if not all(abs(value) <= MAX_LENGTH_M for value in place):
            yield f"path: waypoints_m: {place}: must be within {MAX_LENGTH_M:g} m"
            return
    try:
        length_m = Route(entity.position_m[:2], path).length_m
    except ValueError as error:
        yield f"path: {error}"
        return
    if length_m > MAX_WAY_M:
        yield f"path: waypoints_m: path length of {length_m:.0f} m: at most {MAX_WAY_M:g} m"


def _material_problems(entity: BodyEntity, files: Container[str]) -> Iterator[str]:
    for material in entity.materials:
        for problem in _look_problems(material, files):
            yield f"material {material.name!r:.60}: {problem}"


def _look_problems(material: Material, files: Container[str]) -> Iterator[str]:
    for field in ("ambient", "diffuse"):
        colour = getattr(material, field)
        if not all(0.0 <= value <= 1.0 for value in colour):
            yield f"{field}: {colour}: must be 0 to 1"
    side_m = material.texture_side_m
    if not (side_m == 0.0 or 1e-3 <= side_m <= MAX_LENGTH_M):
        yield f"texture_side_m: {side_m}: must be 0, or 0.001 to {MAX_LENGTH_M:g} m"
    if material.texture_sha256 and material.texture_sha256 not in files:
        yield f"texture_sha256: {material.texture_sha256[:16]!r}: no such asset"
