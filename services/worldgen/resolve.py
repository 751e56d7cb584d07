"""A recipe to a world: each default and material put in its place, and the hash over it all."""

from __future__ import annotations

from collections.abc import Mapping

from services.common.documents import Location, Material, Planar, Wall, World
from services.worldgen.recipe import PoseRecipe, Recipe


def used_materials(recipe: Recipe) -> list[str]:
    """Names of the materials that something has: walls in their order, then the floor."""
    walls = [wall.material for wall in resolve_walls(recipe)]
    return list(dict.fromkeys([*walls, recipe.floor_material]))


def resolve_walls(recipe: Recipe) -> tuple[Wall, ...]:
    """The walls, with height, thickness and material given to those that have none of their own."""
    turn = recipe.wall_materials
    return tuple(
        Wall(
            name=wall.name,
            length_m=wall.length_m,
            thickness_m=wall.thickness_m or recipe.wall_thickness_m,
            height_m=wall.height_m or recipe.wall_height_m,
            x_m=wall.x_m,
            y_m=wall.y_m,
            yaw_rad=wall.yaw_rad,
            material=wall.material or turn[index % len(turn)],
        )
        for index, wall in enumerate(recipe.walls)
    )


def resolve(
    recipe: Recipe, file_name: str, texture_sha256: Mapping[str, str], use_aruco: bool
) -> World:
    """The world of a recipe without mistakes. `texture_sha256` is by file name of the texture."""
    start = recipe.start or PoseRecipe(x_m=0.0, y_m=0.0)
    world = World(
        name=recipe.name,
        recipe=file_name,
        hash="",
        walls=resolve_walls(recipe),
        materials=tuple(
            Material(
                name=name,
                texture_sha256=texture_sha256[material.texture] if material.texture else "",
                texture_name=material.texture or "",
                texture_side_m=material.texture_side_m,
                ambient=material.ambient,
                diffuse=material.diffuse,
            )
            for name in used_materials(recipe)
            for material in (recipe.materials[name],)
        ),
        markers=recipe.markers if use_aruco else (),
        locations=tuple(
            Location(name=name, x_m=place.x_m, y_m=place.y_m, yaw_rad=place.yaw_rad)
            for name, place in recipe.locations.items()
        ),
        start=Planar(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad),
        map_resolution_m=recipe.map_resolution_m,
        floor_material=recipe.floor_material,
        sky=recipe.sky,
        light_direction=recipe.light.direction,
        light_ambient=recipe.light.ambient,
        light_diffuse=recipe.light.diffuse,
    )
    return world.model_copy(update={"hash": world.content_hash()})
