"""Mistakes between the fields of a recipe, each of which is valid by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import shapely

from mazebot.common.maths import frames
from mazebot.common.messages import documents as doc
from mazebot.common.problems import Location, Mistake
from mazebot.worldgen.recipe_model import (
    MAX_ASSETS,
    MAX_COORDINATE_M,
    BodyRecipe,
    BoxRecipe,
    CylinderRecipe,
    KeepoutZoneRecipe,
    MeshGeometry,
    MeshRecipe,
    PointLightRecipe,
    Recipe,
    ShapeRecipe,
    SpeedLimitRecipe,
    WallRecipe,
)

MIN_SIZE_M = 1e-4
"""Of solid shapes: physics loses thinner ones."""
ROBOT_HEIGHT_M = 0.25
MAX_SHAPES = 5000
MAX_LENGTH_M = 200_000.0
"""Of all walls: the time to process their cells on the map grows with it."""
MAX_POLYGONS, MAX_CORNERS = 100, 2000
"""Of one polyline."""
MAX_TURN = 1e-3
"""Allowed deviation of a quaternion's length from 1: three decimals, typed by hand."""

_FRAMES = (
    frames.MAP_FRAME, frames.ODOM_FRAME, frames.BASE_FOOTPRINT_FRAME, frames.BASE_LINK_FRAME,
    frames.SCAN_FRAME, frames.IMU_FRAME, frames.CAMERA_FRAME, frames.CAMERA_OPTICAL_FRAME,
)  # fmt: skip
_TOUCH_M = 1e-6
_PLACED = ("boxes", "cylinders", "meshes", "bodies")

Placed = BoxRecipe | CylinderRecipe | MeshRecipe | BodyRecipe


def mistakes(recipe: Recipe, maze_wall_names: Sequence[str]) -> Iterator[Mistake]:
    """All mistakes, in the order of the fields. `maze_wall_names` are those of the maze's walls."""
    yield from _names(recipe, maze_wall_names)
    yield from _materials(recipe)
    for index, wall in enumerate(recipe.walls):
        yield from _coverings(("walls", index, "coverings"), wall)
    for index, mesh in enumerate(recipe.meshes):
        yield from _scale(("meshes", index, "scale"), mesh.scale)
    for index, body in enumerate(recipe.bodies):
        yield from _body(("bodies", index), body)
    yield from _ceiling(recipe)
    yield from _rooms(recipe)
    yield from _zones(recipe)
    walls = {wall.name for wall in recipe.walls} | set(maze_wall_names)
    for index, marker in enumerate(recipe.markers):
        if marker.wall not in walls:
            yield Mistake(
                ("markers", index, "wall"), marker.wall, "must be the name of one of the walls"
            )
    if not any(recipe.light.direction):
        yield Mistake(("light", "direction"), recipe.light.direction, "must not be zero")
    yield from _lights(recipe.lights)


def placed(recipe: Recipe) -> Iterator[tuple[Location, Placed]]:
    """Everything that becomes a body, with its location in the recipe."""
    for field in _PLACED:
        for index, part in enumerate(getattr(recipe, field)):
            yield (field, index), part


def _names(recipe: Recipe, maze_wall_names: Sequence[str]) -> Iterator[Mistake]:
    first: dict[str, Location] = dict.fromkeys(maze_wall_names, ("maze",))
    things: list[tuple[Location, WallRecipe | Placed]] = [
        (("walls", index), wall) for index, wall in enumerate(recipe.walls)
    ]
    things += placed(recipe)
    shapes = sum(len(body.shapes) for body in recipe.bodies)
    if shapes > MAX_SHAPES:
        yield Mistake(("bodies",), f"{shapes} shapes", f"must have at most {MAX_SHAPES}")
    length_m = sum(wall.length_m for wall in recipe.walls)
    if length_m > MAX_LENGTH_M:
        must = f"must be at most {MAX_LENGTH_M:g} m long in total"
        yield Mistake(("walls",), f"{length_m:g} m", must)
    for location, thing in things:
        if thing.name in first:
            must = "must be unique: already used by {other}"
            yield Mistake((*location, "name"), thing.name, must, other=first[thing.name])
        first.setdefault(thing.name, location)
        if not isinstance(thing, WallRecipe) and thing.mass_kg > 0.0 and thing.name in _FRAMES:
            must = "must not be the name of a frame of the robot, because the body moves"
            yield Mistake((*location, "name"), thing.name, must)


def _materials(recipe: Recipe) -> Iterator[Mistake]:
    uses: list[tuple[Location, str | None, str]] = [
        (("wall_materials", index), name, "") for index, name in enumerate(recipe.wall_materials)
    ]
    uses.append((("floor_material",), recipe.floor_material, ""))
    for index, wall in enumerate(recipe.walls):
        uses.append((("walls", index, "material"), wall.material, ""))
        for number, covering in enumerate(wall.coverings):
            at = ("walls", index, "coverings", number, "material")
            uses.append((at, covering.material, ""))
    for location, thing in placed(recipe):
        if isinstance(thing, BodyRecipe):
            for number, shape in enumerate(thing.shapes):
                own = shape.geometry.file if isinstance(shape.geometry, MeshGeometry) else ""
                uses.append(((*location, "shapes", number, "material"), shape.material, own))
        else:
            uses.append(((*location, "material"), thing.material, ""))
    if recipe.ceiling is not None:
        uses.append((("ceiling", "material"), recipe.ceiling.material, ""))
    for name, room in recipe.rooms.items():
        uses.append((("rooms", name, "wall_material"), room.wall_material, ""))
        uses.append((("rooms", name, "floor_material"), room.floor_material, ""))
    known = ", ".join(recipe.materials)
    must = f"must be one of {known}" if known else "must be left out: there are no materials"
    for location, material, own in uses:
        if material is not None and material not in recipe.materials and material != own:
            yield Mistake(location, material, must)
    textures = {m.texture for m in recipe.materials.values() if m.texture}
    if len(textures) > MAX_ASSETS:
        yield Mistake(("materials",), f"{len(textures)} textures", f"must be at most {MAX_ASSETS}")


def _coverings(location: Location, wall: WallRecipe) -> Iterator[Mistake]:
    half_m = wall.length_m / 2.0
    for index, covering in enumerate(wall.coverings):
        at = (*location, index)
        if covering.from_m >= covering.to_m:
            must = f"must be greater than from_m, {covering.from_m:g}"
            yield Mistake((*at, "to_m"), covering.to_m, must)
            continue
        if covering.from_m < -half_m - _TOUCH_M:
            must = f"must lie on the wall: at least {-half_m:g}"
            yield Mistake((*at, "from_m"), covering.from_m, must)
        if covering.to_m > half_m + _TOUCH_M:
            must = f"must lie on the wall: at most {half_m:g}"
            yield Mistake((*at, "to_m"), covering.to_m, must)
        for number, other in enumerate(wall.coverings[:index]):
            overlap_m = min(covering.to_m, other.to_m) - max(covering.from_m, other.from_m)
            if other.side == covering.side and overlap_m > _TOUCH_M:
                span = (covering.from_m, covering.to_m)
                yield Mistake(at, span, f"must not overlap coverings[{number}]")
                break


def _scale(location: Location, scale: tuple[float, float, float]) -> Iterator[Mistake]:
    if min(abs(value) for value in scale) < 1e-9:
        yield Mistake(location, scale, "must not be zero along any axis")


def _turn(location: Location, orientation_xyzw: doc.Quaternion) -> Iterator[Mistake]:
    if not abs(math.hypot(*orientation_xyzw) - 1.0) <= MAX_TURN:
        must = f"must have length 1, not {math.hypot(*orientation_xyzw):.6g}"
        yield Mistake((*location, "orientation_xyzw"), orientation_xyzw, must)


def _body(location: Location, body: BodyRecipe) -> Iterator[Mistake]:
    yield from _printable((*location, "name"), body.name)
    yield from _turn(location, body.orientation_xyzw)
    names: dict[str, int] = {}
    for index, shape in enumerate(body.shapes):
        at = (*location, "shapes", index)
        if shape.name in names:
            must = f"must be unique: already used by shapes[{names[shape.name]}]"
            yield Mistake((*at, "name"), shape.name, must)
        names.setdefault(shape.name, index)
        yield from _printable((*at, "name"), shape.name)
        yield from _turn(at, shape.orientation_xyzw)
        yield from _geometry((*at, "geometry"), shape)
        if body.mass_kg > 0.0 and shape.solid and isinstance(shape.geometry, doc.Plane):
            must = "must not be solid: a plane cannot move, and mass_kg is not 0"
            yield Mistake((*at, "solid"), shape.solid, must)
    if body.mass_kg > 0.0 and not any(shape.solid for shape in body.shapes):
        must = "must be 0, or at least one shape must be solid"
        yield Mistake((*location, "mass_kg"), body.mass_kg, must)


def _printable(location: Location, name: str) -> Iterator[Mistake]:
    if not name.isprintable() or not name.strip():
        yield Mistake(location, name, "must be printable")


def _geometry(location: Location, shape: ShapeRecipe) -> Iterator[Mistake]:
    geometry = shape.geometry
    if isinstance(geometry, MeshGeometry):
        yield from _scale((*location, "scale"), geometry.scale)
        return
    for field, value in geometry:
        if isinstance(value, float):
            yield from _size((*location, field), value, shape.solid)
        elif isinstance(value, tuple) and field != "polygons_m":
            for index, side_m in enumerate(value):
                yield from _size((*location, field, index), side_m, shape.solid)
    if isinstance(geometry, doc.Polyline):
        corners = sum(len(polygon) for polygon in geometry.polygons_m)
        if not 0 < len(geometry.polygons_m) <= MAX_POLYGONS or corners > MAX_CORNERS:
            value = f"{len(geometry.polygons_m)} polygons of {corners} corners"
            must = f"must be 1 to {MAX_POLYGONS} of at most {MAX_CORNERS}"
            yield Mistake((*location, "polygons_m"), value, must)
            return
        for index, polygon in enumerate(geometry.polygons_m):
            yield from _polygon((*location, "polygons_m", index), polygon)


def _size(location: Location, value_m: float, solid: bool) -> Iterator[Mistake]:
    if value_m > MAX_COORDINATE_M:
        yield Mistake(location, value_m, f"must be <= {MAX_COORDINATE_M:g}")
    elif solid and value_m < MIN_SIZE_M:
        yield Mistake(location, value_m, f"must be >= {MIN_SIZE_M:g} where it is solid")


def _polygon(location: Location, corners_m: Sequence[doc.Point2]) -> Iterator[Mistake]:
    if len(corners_m) < 3:
        yield Mistake(location, corners_m, "must have at least 3 corners")
        return
    if max(abs(value) for corner in corners_m for value in corner) > MAX_COORDINATE_M:
        must = f"must lie within {MAX_COORDINATE_M:g} m"
        yield Mistake(location, corners_m, must)
        return
    polygon = shapely.Polygon(corners_m)
    if not polygon.is_valid:
        why = shapely.is_valid_reason(polygon)
        yield Mistake(location, corners_m, f"must not cross or touch itself ({why})")
    elif polygon.area < 1e-9:
        yield Mistake(location, corners_m, "must have an area")


def _ceiling(recipe: Recipe) -> Iterator[Mistake]:
    if recipe.ceiling is None:
        return
    height_m = recipe.ceiling.height_m or recipe.wall_height_m
    heights_m = [wall.height_m or recipe.wall_height_m for wall in recipe.walls]
    if recipe.maze is not None:
        heights_m.append(recipe.wall_height_m)
    highest_m = max(heights_m, default=0.0)
    if height_m < highest_m - _TOUCH_M:
        must = f"must be at least the highest wall's, {highest_m:g}"
        yield Mistake(("ceiling", "height_m"), height_m, must)
    elif height_m < ROBOT_HEIGHT_M:
        must = f"must be above the robot, at least {ROBOT_HEIGHT_M:g}"
        yield Mistake(("ceiling", "height_m"), height_m, must)


def _rooms(recipe: Recipe) -> Iterator[Mistake]:
    polygons: list[shapely.Polygon] = []
    names: list[str] = []
    for name, room in recipe.rooms.items():
        location = ("rooms", name, "polygon_m")
        wrong = list(_polygon(location, room.polygon_m))
        yield from wrong
        if wrong:
            continue
        polygon = shapely.Polygon(room.polygon_m)
        for other, before in zip(names, polygons, strict=True):
            overlap_m2 = polygon.intersection(before).area if polygon.intersects(before) else 0.0
            if overlap_m2 > 1e-6:
                must = f"must not overlap room {other}: {overlap_m2:.3g} m2 lie in both"
                yield Mistake(location, room.polygon_m, must)
                break
        names.append(name)
        polygons.append(polygon)


def _zones(recipe: Recipe) -> Iterator[Mistake]:
    first: dict[str, Location] = {}
    zones: list[tuple[Location, KeepoutZoneRecipe | SpeedLimitRecipe]] = [
        (("keepout_zones", index), zone) for index, zone in enumerate(recipe.keepout_zones)
    ]
    zones += [(("speed_limits", index), zone) for index, zone in enumerate(recipe.speed_limits)]
    for location, zone in zones:
        if zone.name in first:
            must = "must be unique: already used by {other}"
            yield Mistake((*location, "name"), zone.name, must, other=first[zone.name])
        first.setdefault(zone.name, location)
        at = (*location, "polygon_m")
        wrong = list(_polygon(at, zone.polygon_m))
        yield from wrong
        if isinstance(zone, SpeedLimitRecipe):
            if (zone.speed_limit_m_s is None) == (zone.percent is None):
                given = "neither" if zone.percent is None else "both"
                must = f"must have one of speed_limit_m_s and percent, not {given}"
                yield Mistake(location, zone.name, must)
        elif not wrong:
            yield from _locations_in(recipe, zone)


def _locations_in(recipe: Recipe, zone: KeepoutZoneRecipe) -> Iterator[Mistake]:
    area = shapely.Polygon(zone.polygon_m)
    for name, place in recipe.locations.items():
        if area.intersects(shapely.Point(place.x_m, place.y_m)):
            must = f"cannot be driven to: it lies in keepout zone {zone.name}"
            yield Mistake(("locations", name), (place.x_m, place.y_m), must, fatal=False)


def _lights(lights: Sequence[PointLightRecipe]) -> Iterator[Mistake]:
    names: dict[str, int] = {}
    for index, light in enumerate(lights):
        if light.name in names:
            must, other = "must be unique: already used by {other}", ("lights", names[light.name])
            yield Mistake(("lights", index, "name"), light.name, must, other=other)
        names.setdefault(light.name, index)
        if light.constant == light.linear == light.quadratic == 0.0:
            must = "must be > 0, or linear or quadratic must be"
            yield Mistake(("lights", index, "constant"), light.constant, must)
