"""Converts a recipe to a world: sets all defaults and materials, and computes its hash."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    Array,
    quaternion_from_rotation,
    quaternion_from_yaw,
    rotation_from_rpy,
)
from mazebot.common.messages import documents as doc
from mazebot.common.world.geometry import TriangleMesh
from mazebot.worldgen.recipe.mistakes import Placed, placed
from mazebot.worldgen.recipe.room_faces import with_room_faces
from mazebot.worldgen.recipe_model import (
    BodyRecipe,
    BoxRecipe,
    CylinderRecipe,
    MeshGeometry,
    MeshRecipe,
    PoseRecipe,
    Recipe,
    ShapeRecipe,
)

if TYPE_CHECKING:
    from mazebot.worldgen.maze.maze import Maze

MeshKey = tuple[str, str | None, bool]
"""File, submesh, and whether the submesh's middle is moved to the origin."""


@dataclass(frozen=True, eq=False)
class MeshAsset:
    """The triangles of one material of a file, and that material."""

    name: str
    """Of the material: `file.part`."""
    sha256: str
    mesh: TriangleMesh
    diffuse: doc.Rgba | None
    texture_sha256: str
    texture_name: str


Meshes = Mapping[MeshKey, Sequence[MeshAsset]]


def mesh_key(part: MeshRecipe | MeshGeometry) -> MeshKey:
    """Identifies the triangles that a part of a recipe uses."""
    return part.file, part.submesh, isinstance(part, MeshGeometry) and part.center


def mesh_keys(recipe: Recipe) -> Iterator[tuple[tuple[str | int, ...], MeshKey]]:
    """Every use of a mesh, with its location in the recipe."""
    for location, thing in placed(recipe):
        if isinstance(thing, MeshRecipe):
            yield (*location, "file"), mesh_key(thing)
        elif isinstance(thing, BodyRecipe):
            for index, shape in enumerate(thing.shapes):
                if isinstance(shape.geometry, MeshGeometry):
                    at = (*location, "shapes", index, "geometry", "file")
                    yield at, mesh_key(shape.geometry)


def resolve(
    recipe: Recipe,
    file_name: str,
    maze: Maze | None,
    meshes: Meshes,
    use_aruco: bool,
) -> doc.World:
    """The world of a recipe, without textures, generated markers, ready map and hash.

    Missing meshes and materials are left out.
    """
    start: PoseRecipe | doc.Planar = PoseRecipe(x_m=0.0, y_m=0.0)
    locations: dict[str, PoseRecipe | doc.Planar] = dict(recipe.locations)
    if maze is not None:
        start = maze.start
        locations.setdefault("goal", maze.goal)
    start = recipe.start or start
    # Rooms set the looks, except for walls with their own material.
    own = {wall.name for wall in recipe.walls if wall.material}
    resolved = resolve_walls(recipe, maze)
    in_rooms = with_room_faces(resolved, recipe.rooms)
    walls = tuple(
        wall if wall.name in own else in_room
        for wall, in_room in zip(resolved, in_rooms, strict=True)
    )
    first = next(iter(recipe.materials), "")
    bodies = tuple(
        body for _, thing in placed(recipe) if (body := _body(thing, meshes, first)) is not None
    )
    rooms = tuple(
        doc.Room(name=name, polygon_m=room.polygon_m, floor_material=room.floor_material or "")
        for name, room in recipe.rooms.items()
    )
    ceiling = recipe.ceiling and doc.Ceiling(
        height_m=recipe.ceiling.height_m or recipe.wall_height_m, material=recipe.ceiling.material
    )
    used = [wall.material for wall in walls]
    used += [covering.material for wall in walls for covering in wall.coverings]
    used.append(recipe.floor_material or "")
    used += [room.floor_material for room in rooms]
    used += [shape.material for body in bodies for shape in body.shapes]
    used += [ceiling.material] if ceiling else []
    return doc.World(
        name=recipe.name,
        recipe=file_name,
        hash="",
        walls=walls,
        materials=_materials(recipe, list(dict.fromkeys(used)), meshes),
        markers=recipe.markers if use_aruco else (),
        bodies=bodies,
        rooms=rooms,
        locations=tuple(
            doc.Location(name=name, x_m=place.x_m, y_m=place.y_m, yaw_rad=place.yaw_rad)
            for name, place in locations.items()
        ),
        keepout_zones=tuple(
            doc.KeepoutZone(name=zone.name, polygon_m=zone.polygon_m)
            for zone in recipe.keepout_zones
        ),
        speed_limits=tuple(doc.SpeedZone(**zone.model_dump()) for zone in recipe.speed_limits),
        start=doc.Planar(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad),
        map_resolution_m=recipe.map_resolution_m,
        floor_material=recipe.floor_material or "",
        ceiling=ceiling,
        lights=tuple(doc.PointLight(**light.model_dump()) for light in recipe.lights),
        sky=recipe.sky,
        light_direction=recipe.light.direction,
        light_ambient=recipe.light.ambient,
        light_diffuse=recipe.light.diffuse,
    )


def with_textures(world: doc.World, sha256_of: Mapping[str, str]) -> doc.World:
    """The world with the textures of its materials, by file name."""
    materials = tuple(
        material
        if material.texture_sha256
        else material.model_copy(
            update={"texture_sha256": sha256_of.get(material.texture_name, "")}
        )
        for material in world.materials
    )
    return world.model_copy(update={"materials": materials})


def finished(world: doc.World) -> doc.World:
    """The world with the hash of its content."""
    return world.model_copy(update={"hash": world.content_hash()})


def resolve_walls(recipe: Recipe, maze: Maze | None) -> tuple[doc.Wall, ...]:
    """The recipe's walls, then the maze's, with default height, thickness and material where these
    are not set.
    """
    turn = recipe.wall_materials
    walls = [
        doc.Wall(
            name=wall.name,
            length_m=wall.length_m,
            thickness_m=wall.thickness_m or recipe.wall_thickness_m,
            height_m=wall.height_m or recipe.wall_height_m,
            x_m=wall.x_m,
            y_m=wall.y_m,
            yaw_rad=wall.yaw_rad,
            material=wall.material or turn[index % len(turn)],
            coverings=tuple(doc.Covering(**part.model_dump()) for part in wall.coverings),
        )
        for index, wall in enumerate(recipe.walls)
    ]
    walls += [
        doc.Wall(
            name=name,
            length_m=segment.length_m,
            thickness_m=recipe.wall_thickness_m,
            height_m=recipe.wall_height_m,
            x_m=segment.x_m,
            y_m=segment.y_m,
            yaw_rad=segment.yaw_rad,
            material=turn[index % len(turn)],
        )
        for index, (name, segment) in enumerate(
            zip(maze_wall_names(maze), maze.walls if maze else (), strict=True), len(walls)
        )
    ]
    return tuple(walls)


def maze_wall_names(maze: Maze | None) -> list[str]:
    """`maze_0`, `maze_1`, ..."""
    return [f"maze_{index}" for index in range(len(maze.walls) if maze else 0)]


def _body(thing: Placed, meshes: Meshes, first_material: str) -> doc.Body | None:
    """None if all of its shapes are missing."""
    if isinstance(thing, BodyRecipe):
        shapes = tuple(part for shape in thing.shapes for part in _shapes(shape, meshes))
        return doc.Body(
            name=thing.name,
            position_m=thing.position_m,
            orientation_xyzw=_unit(thing.orientation_xyzw),
            mass_kg=thing.mass_kg,
            shapes=shapes,
        ) if shapes else None  # fmt: skip
    parts: tuple[doc.Shape, ...]
    if isinstance(thing, BoxRecipe):
        geometry: doc.Geometry = doc.Box(size_m=thing.size_m)
    elif isinstance(thing, CylinderRecipe):
        geometry = doc.Cylinder(radius_m=thing.radius_m, length_m=thing.height_m)
    if isinstance(thing, MeshRecipe):
        parts = tuple(
            doc.Shape(
                name=asset.name,
                geometry=doc.Mesh(sha256=asset.sha256, name=asset.name, scale=thing.scale),
                material=thing.material or _own_material(asset, first_material),
            )
            for asset in meshes.get(mesh_key(thing), ())
        )
        if not parts:
            return None
    else:
        material = thing.material or first_material
        parts = (doc.Shape(name=geometry.kind, geometry=geometry, material=material),)
    rotation = rotation_from_rpy(thing.roll_rad, thing.pitch_rad, thing.yaw_rad)
    # Walls and most bodies only rotate about z: then half an angle is enough.
    upright = thing.roll_rad == thing.pitch_rad == 0.0
    return doc.Body(
        name=thing.name,
        position_m=(
            thing.x_m,
            thing.y_m,
            _height_over_lowest_m(thing, rotation, meshes) if thing.z_m is None else thing.z_m,
        ),
        orientation_xyzw=quaternion_from_yaw(thing.yaw_rad)
        if upright
        else quaternion_from_rotation(rotation),
        mass_kg=thing.mass_kg,
        shapes=parts,
    )


def _height_over_lowest_m(
    thing: BoxRecipe | CylinderRecipe | MeshRecipe, rotation: Array, meshes: Meshes
) -> float:
    """Height of the origin above the lowest point, in the body's orientation."""
    up = rotation[2]
    if isinstance(thing, BoxRecipe):
        return float(portable.product(np.abs(up), thing.size_m)) / 2.0
    if isinstance(thing, CylinderRecipe):
        radius_m = thing.radius_m * math.hypot(up[0], up[1])
        return abs(float(up[2])) * thing.height_m / 2.0 + radius_m
    return -min(
        float((portable.product(asset.mesh.vertices_m * thing.scale, up)).min())
        for asset in meshes[mesh_key(thing)]
    )


def _shapes(shape: ShapeRecipe, meshes: Meshes) -> Iterator[doc.Shape]:
    """A shape, or one for every material of its mesh."""
    geometries: list[tuple[str, doc.Geometry, str]] = []
    geometry = shape.geometry
    if isinstance(geometry, MeshGeometry):
        assets = meshes.get(mesh_key(geometry), ())
        for index, asset in enumerate(assets):
            own = shape.material == geometry.file
            geometries.append(
                (
                    shape.name if len(assets) == 1 else f"{shape.name}.{index}",
                    doc.Mesh(sha256=asset.sha256, name=asset.name, scale=geometry.scale),
                    asset.name if own else shape.material or "",
                )
            )
    else:
        geometries.append((shape.name, geometry, shape.material or ""))
    for name, inner, material in geometries:
        yield doc.Shape(
            name=name,
            geometry=inner,
            position_m=shape.position_m,
            orientation_xyzw=_unit(shape.orientation_xyzw),
            material=material,
            solid=shape.solid,
        )


def _own_material(asset: MeshAsset, first_material: str) -> str:
    return asset.name if asset.diffuse or asset.texture_sha256 else first_material


def _unit(orientation_xyzw: doc.Quaternion) -> doc.Quaternion:
    """Normalised; bit-identical if it has unit length already."""
    length = math.hypot(*orientation_xyzw)
    if abs(length - 1.0) < 1e-12:
        return orientation_xyzw
    x, y, z, w = (value / length for value in orientation_xyzw)
    return x, y, z, w


def _materials(recipe: Recipe, names: Sequence[str], meshes: Meshes) -> tuple[doc.Material, ...]:
    own = {asset.name: asset for assets in meshes.values() for asset in assets}
    found = []
    for name in names:
        if name in recipe.materials:
            material = recipe.materials[name]
            found.append(
                doc.Material(
                    name=name,
                    texture_name=material.texture or "",
                    texture_side_m=material.texture_side_m,
                    ambient=material.ambient,
                    diffuse=material.diffuse,
                )
            )
        elif name in own:
            diffuse = own[name].diffuse or (1.0, 1.0, 1.0, 1.0)
            found.append(
                doc.Material(
                    name=name,
                    texture_sha256=own[name].texture_sha256,
                    texture_name=own[name].texture_name,
                    ambient=diffuse,
                    diffuse=diffuse,
                )
            )
    return tuple(found)
