"""Fields of a world recipe (`worlds/*.yaml`), with the constraints that types can express.

Everything is in the frame `map`: metres, radians, x and y on the floor, z up.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from mazebot.common.messages import documents as doc
from mazebot.common.messages.documents import Marker, Quaternion

MAX_COORDINATE_M = 1000.0
MAX_ASSETS = 120
"""Textures and meshes: together with the markers' as many as are replayed to a late subscriber."""

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
    """Appearance of a surface."""

    texture: FileName | None = Field(
        None, description="file name of a PNG in the folder of textures; none: plain colour"
    )
    texture_side_m: float = Field(
        1.0,
        ge=0.0,
        le=MAX_COORDINATE_M,
        description="length on a surface of one tile's side, metres; 0: stretched once over each "
        "face, as Gazebo does. Meshes have their own texture coordinates.",
    )
    ambient: Colour = Field(
        (1.0, 1.0, 1.0, 1.0), description="share of ambient light reflected: r, g, b, a in 0..1"
    )
    diffuse: Colour = Field(
        (1.0, 1.0, 1.0, 1.0), description="colour without a texture: r, g, b, a in 0..1"
    )


class CoveringRecipe(Part):
    """A stretch of a wall's face, from the floor to the top, with a different material."""

    side: Literal["left", "right"] = Field(
        description="the face towards the wall's +y axis (left) or -y axis (right)"
    )
    from_m: Coordinate = Field(description="along the wall's x axis from its centre, metres")
    to_m: Coordinate = Field(description="greater than from_m, metres")
    material: Name = Field(description="name of a material")


class WallRecipe(Part):
    """An upright box on the floor, x along its length, y across its thickness."""

    name: Name = Field(description="unique in the world")
    length_m: Length = Field(description="along the wall's x axis, metres")
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
    coverings: tuple[CoveringRecipe, ...] = Field(
        (),
        max_length=100,
        description="stretches of its faces with other materials; they take precedence over rooms",
    )


class PlacedRecipe(Part):
    """A placed body."""

    name: Name = Field(description="unique among walls and bodies")
    x_m: Coordinate = Field(description="of its origin, metres")
    y_m: Coordinate = Field(description="of its origin, metres")
    z_m: Coordinate | None = Field(None, description="of its origin, metres; none: on the floor")
    roll_rad: Yaw = Field(0.0, description="about x, first")
    pitch_rad: Yaw = Field(0.0, description="about y, second")
    yaw_rad: Yaw = Field(0.0, description="about z, last")
    material: Name | None = Field(None, description="name of a material; none: the first of all")
    mass_kg: float = Field(0.0, ge=0.0, le=10_000.0, description="0: static")


class BoxRecipe(PlacedRecipe):
    """A box, its origin at its centre."""

    size_m: tuple[Length, Length, Length] = Field(description="along x, y, z, metres")


class CylinderRecipe(PlacedRecipe):
    """A cylinder along its z axis, its origin at its centre."""

    radius_m: Length = Field(description="metres")
    height_m: Length = Field(description="along its z axis, metres")


class MeshRecipe(PlacedRecipe):
    """Triangles of a file: DAE, OBJ, STL or GLB.

    Without a `material` the file's are used; each is added to the world's as `file.part`, unless
    the recipe has one of that name.
    """

    file: FileName = Field(description="file name in the folder of meshes")
    submesh: str | None = Field(None, max_length=128, description="the one part of the file to use")
    scale: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (1.0, 1.0, 1.0), description="along x, y, z; none may be zero"
    )


class MeshGeometry(Part):
    """Triangles of a file, as the geometry of a shape."""

    kind: Literal["mesh"] = "mesh"
    file: FileName = Field(description="file name in the folder of meshes")
    submesh: str | None = Field(None, max_length=128, description="the one part of the file to use")
    center: bool = Field(False, description="put the submesh's middle at the origin")
    scale: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (1.0, 1.0, 1.0), description="along x, y, z; none may be zero"
    )


GeometryRecipe = Annotated[
    doc.Box
    | doc.Cylinder
    | doc.Cone
    | doc.Capsule
    | doc.Sphere
    | doc.Ellipsoid
    | doc.Plane
    | doc.Polyline
    | MeshGeometry,
    Field(discriminator="kind"),
]


class ShapeRecipe(Part):
    """A part of a body: visual, collision, or both."""

    name: str = Field(min_length=1, max_length=256, description="unique in the body")
    geometry: GeometryRecipe
    position_m: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (0.0, 0.0, 0.0), description="in the body's frame, metres"
    )
    orientation_xyzw: Quaternion = Field((0.0, 0.0, 0.0, 1.0), description="of unit length")
    material: Name | None = Field(
        None,
        description="name of a material; the file name of its mesh: the mesh's own; none: "
        "invisible",
    )
    solid: bool = Field(True, description="collides with the robot, and is in scans and the map")


class BodyRecipe(Part):
    """A rigid body of any shapes, as created by imports."""

    name: str = Field(min_length=1, max_length=256, description="unique among walls and bodies")
    position_m: tuple[Coordinate, Coordinate, Coordinate] = Field(description="metres")
    orientation_xyzw: Quaternion = Field((0.0, 0.0, 0.0, 1.0), description="of unit length")
    mass_kg: float = Field(0.0, ge=0.0, le=1e6, description="0: static")
    shapes: tuple[ShapeRecipe, ...] = Field(min_length=1, max_length=1000)


class RoomRecipe(Part):
    """A named part of the floor, and its materials."""

    polygon_m: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        min_length=3, max_length=1000, description="its corners in order, metres"
    )
    wall_material: Name | None = Field(
        None,
        description="of the faces of walls that face into it, except for walls with their own "
        "material; none: as in wall_materials",
    )
    floor_material: Name | None = Field(None, description="none: the world's")


class KeepoutZoneRecipe(Part):
    """A part of the floor where the robot must not drive; it is no obstacle for the lidar."""

    name: Name = Field(description="unique among zones")
    polygon_m: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        min_length=3, max_length=1000, description="its corners in order, metres"
    )


class SpeedLimitRecipe(Part):
    """A part of the floor where the robot must be slow: by `speed_limit_m_s` or by `percent`."""

    name: Name = Field(description="unique among zones")
    polygon_m: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        min_length=3, max_length=1000, description="its corners in order, metres"
    )
    speed_limit_m_s: float | None = Field(
        None, gt=0.0, le=100.0, description="highest speed in it, m/s"
    )
    percent: float | None = Field(
        None, gt=0.0, le=100.0, description="highest speed in it, percent of the controller's"
    )


class CeilingRecipe(Part):
    """A flat ceiling over all walls."""

    material: Name = Field(description="name of a material")
    height_m: Length | None = Field(None, description="metres; none: wall_height_m")


class MarkerCoverRecipe(Part):
    """Markers placed automatically: as few as cover a share of the free floor."""

    share: float = Field(
        0.9, gt=0.0, le=1.0, description="of the free floor from which a marker must be readable"
    )
    first_id: int = Field(0, ge=0, le=100_000, description="ids count up from it")
    dictionary: str = Field(
        "DICT_4X4_100", description="OpenCV's name, or a file in the folder dictionaries/"
    )
    size_m: Length = Field(0.3, description="side of the black square, metres")
    height_m: Length = Field(0.25, description="of the markers' centres above the floor, metres")
    max_markers: int = Field(100, ge=1, le=1000, description="needing more is an error")


class MazeRecipe(Part):
    """Walls, start and the location `goal`, generated. The start is at (0, 0)."""

    algorithm: Literal["wilson", "recursive_backtracker", "rooms"] = Field(
        "wilson",
        description="wilson: all perfect mazes are equally likely; recursive_backtracker: long "
        "winding corridors; rooms: rooms joined by corridors",
    )
    rows: int = Field(8, ge=2, le=200, description="cells along y")
    columns: int = Field(8, ge=2, le=200, description="cells along x")
    cell_m: float = Field(
        1.0, ge=0.6, le=10.0, description="from the middle of a cell to the next one's, metres"
    )
    braiding: Component = Field(
        0.0, description="share of the dead ends that are opened: 0 has no loop, 1 no dead end"
    )
    seed: int = Field(0, ge=0, description="same seed, same maze")


class LightRecipe(Part):
    """The sun, and ambient light."""

    direction: tuple[Coordinate, Coordinate, Coordinate] = Field(
        (-0.5, 0.1, -0.9), description="in which the sun's light travels: x, y, z of any length"
    )
    ambient: Component = Field(0.8, description="strength of the ambient light, 0..1")
    diffuse: Component = Field(0.8, description="strength of the sun, 0..1")


class PointLightRecipe(Part):
    """A lamp, with the attenuation of SDF."""

    name: Name = Field(description="unique among lights")
    position_m: tuple[Coordinate, Coordinate, Coordinate] = Field(description="metres")
    diffuse: Colour = Field((1.0, 1.0, 1.0, 1.0), description="colour and strength")
    range_m: Length = Field(10.0, description="beyond it the light is cut off, metres")
    constant: float = Field(1.0, ge=0.0, le=1e6, description="of diffuse / (c + l d + q d^2)")
    linear: float = Field(0.0, ge=0.0, le=1e6, description="per metre")
    quadratic: float = Field(0.0, ge=0.0, le=1e6, description="per square metre")


class Recipe(Part):
    """A whole recipe, after the recipe that it extends has been merged."""

    name: Name = Field(description="the world's name: the file's name without `.yaml`")
    about: str = Field("", max_length=200, description="one line of description")
    extends: FileName | None = Field(
        None,
        description="file name of another recipe in the same folder; mappings are merged key by "
        "key, everything else given here replaces the value given there",
    )
    wall_height_m: Length = Field(description="default height of walls, metres")
    wall_thickness_m: Length = Field(0.15, description="default thickness of walls, metres")
    walls: tuple[WallRecipe, ...] = Field(
        (), max_length=5000, description="upright boxes on the floor"
    )
    maze: MazeRecipe | None = Field(None, description="more walls, generated")
    boxes: tuple[BoxRecipe, ...] = Field((), max_length=5000, description="solid and visible")
    cylinders: tuple[CylinderRecipe, ...] = Field(
        (), max_length=5000, description="solid and visible"
    )
    meshes: tuple[MeshRecipe, ...] = Field(
        (), max_length=1000, description="of files, solid and visible"
    )
    bodies: tuple[BodyRecipe, ...] = Field((), max_length=5000, description="of any shapes")
    materials: dict[Name, MaterialRecipe] = Field(description="by name")
    wall_materials: tuple[Name, ...] = Field(
        min_length=1,
        description="materials assigned in turn to the walls, in the order of `walls`, then the "
        "maze's",
    )
    floor_material: Name | None = Field(
        None, description="name of a material; none: a plain grey one"
    )
    ceiling: CeilingRecipe | None = Field(None, description="none: the sky is visible")
    rooms: dict[Name, RoomRecipe] = Field(
        default_factory=dict, max_length=500, description="by name; they must not overlap"
    )
    markers: tuple[Marker, ...] = Field(
        (), max_length=1000, description="ArUco markers, by the wall they hang on"
    )
    marker_cover: MarkerCoverRecipe | None = Field(None, description="more markers, generated")
    locations: dict[Name, PoseRecipe] = Field(
        default_factory=dict, max_length=1000, description="named goal poses"
    )
    keepout_zones: tuple[KeepoutZoneRecipe, ...] = Field(
        (), max_length=500, description="where the robot must not drive; they may overlap"
    )
    speed_limits: tuple[SpeedLimitRecipe, ...] = Field(
        (), max_length=500, description="where the robot must be slow; the lowest limit counts"
    )
    start: PoseRecipe | None = Field(
        None,
        description="the robot's initial pose; none: the maze's, or the position nearest to (0, 0) "
        "with clearance, on the largest connected piece of the floor",
    )
    map: FileName | None = Field(
        None,
        description="a ready map: file name of a map_server YAML in the folder of maps; none: "
        "generated from everything solid",
    )
    map_resolution_m: float = Field(
        0.05, ge=0.01, le=1.0, description="side of a cell of the map, metres"
    )
    sky: Colour = Field((0.7, 0.7, 0.7, 1.0), description="background colour")
    light: LightRecipe = Field(LightRecipe(), description="sun and ambient light")
    lights: tuple[PointLightRecipe, ...] = Field((), max_length=8, description="lamps")
