"""What a world recipe (`worlds/*.yaml`) may say, and the mistakes that types cannot see.

Everything is in the frame `map`: metres, radians, x and y on the floor, z up.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from services.common.documents import Marker

MAX_COORDINATE_M = 1000.0
MAX_TEXTURES = 64
"""As many as a late reader of the assets is given again."""

_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"

Name = Annotated[str, Field(pattern=_NAME, max_length=64)]
FileName = Annotated[str, Field(pattern=_NAME, max_length=128)]
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Length = Annotated[float, Field(gt=0.0, le=MAX_COORDINATE_M)]
Yaw = Annotated[float, Field(ge=-6.2832, le=6.2832)]
Component = Annotated[float, Field(ge=0.0, le=1.0)]
Colour = tuple[Component, Component, Component, Component]


class Part(BaseModel):
    """A mapping in a recipe: nothing is converted, unknown keys and NaN are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class PoseRecipe(Part):
    """A planar pose."""

    x_m: Coordinate = Field(description="along the map's x axis, metres")
    y_m: Coordinate = Field(description="along the map's y axis, metres")
    yaw_rad: Yaw = Field(0.0, description="heading, counter-clockwise from the x axis, radians")


class MaterialRecipe(Part):
    """How a surface looks."""

    texture: FileName | None = Field(
        None, description="file name of a PNG in the folder of textures; none: plain colour"
    )
    texture_side_m: Length = Field(1.0, description="length on the wall of one tile's side, metres")
    ambient: Colour = Field(
        (1.0, 1.0, 1.0, 1.0), description="share of ambient light sent back: r, g, b, a in 0..1"
    )
    diffuse: Colour = Field(
        (1.0, 1.0, 1.0, 1.0), description="colour where there is no texture: r, g, b, a in 0..1"
    )


class WallRecipe(Part):
    """An upright box on the floor, x along its length, y across its thickness."""

    name: Name = Field(description="unique in the world")
    length_m: Length = Field(description="along the wall's own x axis, metres")
    x_m: Coordinate = Field(description="of its centre, metres")
    y_m: Coordinate = Field(description="of its centre, metres")
    yaw_rad: Yaw = Field(description="of its x axis, counter-clockwise, radians")
    thickness_m: Length | None = Field(
        None, description="metres; none: the recipe's wall_thickness_m"
    )
    height_m: Length | None = Field(None, description="metres; none: the recipe's wall_height_m")
    material: Name | None = Field(
        None, description="name of a material; none: the next of wall_materials"
    )


class LightRecipe(Part):
    """The one sun, and the light from everywhere."""

    direction: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (-0.5, 0.1, -0.9), description="in which the sun's light travels: x, y, z of any length"
    )
    ambient: Component = Field(0.8, description="strength of the light from everywhere, 0..1")
    diffuse: Component = Field(0.8, description="strength of the sun, 0..1")


class Recipe(Part):
    """A whole recipe, after what it extends has been put under it."""

    name: Name = Field(description="the world's name: the file's name without `.yaml`")
    about: str = Field("", max_length=200, description="one line for people")
    extends: FileName | None = Field(
        None,
        description="file name of another recipe in the same folder; mappings are merged key by "
        "key, everything else given here replaces what is given there",
    )
    wall_height_m: Length = Field(description="of every wall that has none of its own, metres")
    wall_thickness_m: Length = Field(
        0.15, description="of every wall that has none of its own, metres"
    )
    walls: tuple[WallRecipe, ...] = Field(min_length=1, max_length=5000)
    materials: dict[Name, MaterialRecipe] = Field(description="by name")
    wall_materials: tuple[Name, ...] = Field(
        min_length=1, description="materials given in turn to the walls, in the order of `walls`"
    )
    markers: tuple[Marker, ...] = Field(
        (), max_length=1000, description="ArUco markers, by the wall they hang on"
    )
    locations: dict[Name, PoseRecipe] = Field(
        default_factory=dict, description="named places to drive to"
    )
    start: PoseRecipe = Field(
        PoseRecipe(x_m=0.0, y_m=0.0), description="where the robot stands at the start"
    )
    map_resolution_m: float = Field(
        0.05, ge=0.01, le=1.0, description="side of a cell of the map, metres"
    )
    floor_diffuse: Colour = Field((0.5, 0.5, 0.5, 1.0), description="colour of the floor")
    sky: Colour = Field((0.7, 0.7, 0.7, 1.0), description="colour where there is nothing")
    light: LightRecipe = Field(LightRecipe(), description="what the camera sees by")


class MistakeError(Exception):
    """Something wrong in a recipe: where, what stands there, and what would be right."""

    def __init__(self, location: tuple[str | int, ...], value: object, must: str) -> None:
        super().__init__(must)
        self.location = location
        self.value = value
        self.must = must


def mistakes(recipe: Recipe) -> Iterator[MistakeError]:
    """What is wrong between the fields of a recipe, in the order of the file."""
    materials = ", ".join(recipe.materials)
    for index, name in enumerate(recipe.wall_materials):
        if name not in recipe.materials:
            yield MistakeError(("wall_materials", index), name, f"must be one of {materials}")
    names: dict[str, int] = {}
    for index, wall in enumerate(recipe.walls):
        if wall.name in names:
            yield MistakeError(
                ("walls", index, "name"),
                wall.name,
                f"must be unique: walls[{names[wall.name]}] has it",
            )
        names.setdefault(wall.name, index)
        if wall.material is not None and wall.material not in recipe.materials:
            yield MistakeError(
                ("walls", index, "material"), wall.material, f"must be one of {materials}"
            )
    for index, marker in enumerate(recipe.markers):
        if marker.wall not in names:
            yield MistakeError(
                ("markers", index, "wall"), marker.wall, "must be the name of one of the walls"
            )
    if not any(recipe.light.direction):
        yield MistakeError(("light", "direction"), recipe.light.direction, "must not be zero")
    textures = {m.texture for m in recipe.materials.values() if m.texture}
    if len(textures) > MAX_TEXTURES:
        yield MistakeError(
            ("materials",), f"{len(textures)} textures", f"must be at most {MAX_TEXTURES}"
        )
