"""A plan of a world: seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from mazebot.common.maths.frames import SE2, Array, rotation_from_quaternion
from mazebot.common.messages.documents import MarkerEntity, Material, Planar, Wall, World
from mazebot.common.robot.waffle import WAFFLE_RADIUS_M
from mazebot.common.world.costmap import FREE, UNKNOWN
from mazebot.common.world.footprint import Footprint, wall_corners
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import panel_of
from mazebot.worldgen.map.occupancy import Grid, occupied_cells
from mazebot.worldgen.markers.visibility import reachable, seen_from
from mazebot.worldgen.plan_bodies import BodyPlan, body_plans
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

MAX_SIDE_PX = 1800
"""Of the plan alone, without its margins."""
LEFT_PX, TOP_PX, RIGHT_PX, BOTTOM_PX = 72, 90, 24, 92
"""The plan's margins."""

Rgb = tuple[int, int, int]
Picture = NDArray[np.uint8]

_MAX_PX_M = 150.0
_MIN_SIDE_PX = 560
_OVERSAMPLING = 2
_MARGIN_M = 0.35
_UNKNOWN: Rgb = (178, 183, 190)
_INK: Rgb = (32, 36, 42)
_PAPER: Rgb = (255, 255, 255)
_START: Rgb = (16, 122, 58)
_PLACE: Rgb = (20, 74, 160)
_CORE: Rgb = (70, 74, 80)
_TINTS: tuple[Rgb, ...] = (
    (230, 25, 75), (0, 130, 200), (60, 170, 60), (245, 130, 48), (145, 30, 180), (0, 150, 150),
    (220, 40, 210), (140, 120, 0), (95, 75, 235), (160, 70, 30), (0, 100, 60), (190, 0, 95),
)  # fmt: skip
"""Colours of markers, in turn."""
_KEEPOUT: Rgb = (205, 30, 45)
_SLOW: Rgb = (200, 110, 0)
_HATCH_M = 0.1
_SHIFT = 4
"""Fractional bits of a pixel, in OpenCV's drawing functions."""
_MAX_OUTLINED = 40
"""With more markers than this, their areas are only tinted."""


@dataclass(frozen=True)
class View:
    """Conversion from metres in the plan to pixels."""

    low_m: Array
    """(2,): the plan's lower left corner."""
    high_m: Array
    """(2,): its upper right corner."""
    px_m: float
    """Pixels per metre."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height, without the margins."""
        width, height = (self.high_m - self.low_m) * self.px_m
        return math.ceil(width), math.ceil(height)

    def at(self, points_m: Array) -> list[tuple[float, float]]:
        """Pixels of (n, 2) points, y downwards."""
        x = (points_m[:, 0] - self.low_m[0]) * self.px_m
        y = (self.high_m[1] - points_m[:, 1]) * self.px_m
        return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]

    def one(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Pixel of one point."""
        return self.at(np.array([[x_m, y_m]]))[0]


def view_of(loaded: LoadedWorld) -> View:
    """The view of a plan; `LEFT_PX` and `TOP_PX` must be added to its pixels."""
    return _view(loaded.world, body_plans(loaded.world, loaded.meshes))


def draw_plan(loaded: LoadedWorld, seen: NDArray[np.bool_] | None = None) -> Picture:
    """The plan of a world, (height, width, 3) RGB, about 2000 pixels per side at most.

    `seen` is (markers, rows, columns): the cells of the map from which each placed marker can be
    read, in the order of `marker_entities`. None: it is computed; an empty array omits these areas.
    """
    world = loaded.world
    meshes = loaded.meshes
    entities = marker_entities(world, meshes=meshes)[0].markers
    if seen is None:
        panels = [panel_of(entity) for entity in entities]
        seen = seen_from(world, panels, loaded.map_cells, loaded.map_origin, meshes)
    bodies = body_plans(world, meshes)
    view = _view(world, bodies)
    colours = material_colours(world, loaded.assets)
    scale = _OVERSAMPLING
    fine = View(view.low_m, view.high_m, view.px_m * scale)
    picture = _on_the_level(_floor(loaded, fine, colours), view, bodies, colours)
    if len(seen):
        picture = _tinted(picture, loaded, fine, seen)
    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    _grid(draw, fine)
    for room in world.rooms:
        ring = fine.at(np.array([*room.polygon_m, room.polygon_m[0]]))
        _dashed(draw, ring, (120, 124, 130), scale)
    for polygon_m, _, colour, slope in _zones(world):
        _hatched(draw, fine, polygon_m, colour, slope)
    for wall in world.walls:
        _wall(draw, fine, wall, colours)
    canvas = Image.fromarray(_bodies(np.asarray(canvas).copy(), fine, bodies, colours))
    draw = ImageDraw.Draw(canvas)
    for index, entity in enumerate(entities):
        _marker(draw, fine, entity, _TINTS[index % len(_TINTS)])
    _robot(draw, fine, world.start)
    for place in world.locations:
        _place(draw, fine, place)
    plan = canvas.resize(view.size_px, Image.Resampling.BOX)
    _labels(plan, view, world, entities)
    return np.asarray(_framed(plan, view, _figures(loaded, entities, seen), world))


def _zones(world: World) -> Iterator[tuple[Array, str, Rgb, float]]:
    """Corners, name, colour and slope of the hatching of keepout zones and speed limits."""
    for zone in world.keepout_zones:
        yield np.array(zone.polygon_m), f"keepout: {zone.name}", _KEEPOUT, 1.0
    for slow in world.speed_limits:
        limit = f"{slow.percent or 0.0:g} %"
        if slow.speed_limit_m_s is not None:
            limit = f"{slow.speed_limit_m_s:g} m/s"
        yield np.array(slow.polygon_m), f"{limit}: {slow.name}", _SLOW, -1.0


def _hatched(
    draw: ImageDraw.ImageDraw, view: View, polygon_m: Array, colour: Rgb, slope: float
) -> None:
    """A polygon's outline, and lines across it at 45 degrees."""
    area = shapely.make_valid(shapely.Polygon(polygon_m))
    left, low, right, high = area.bounds
    reach_m = right - left + high - low
    for across_m in np.arange(0.0, reach_m, _HATCH_M):
        x_m = right - across_m if slope > 0.0 else left + across_m
        line = shapely.LineString([(x_m, low), (x_m + slope * reach_m, low + reach_m)])
        for part in shapely.get_parts(shapely.intersection(area, line)):
            ends = shapely.get_coordinates(part)
            if len(ends) > 1:
                draw.line(view.at(ends), colour, _OVERSAMPLING)
    ring = view.at(np.vstack([polygon_m, polygon_m[:1]]))
    draw.line(ring, colour, 2 * _OVERSAMPLING)


def plan_png(loaded: LoadedWorld, seen: NDArray[np.bool_] | None = None) -> bytes:
    """The same as PNG, with identical bytes each time."""
    options = [cv2.IMWRITE_PNG_COMPRESSION, 9]
    plan = cv2.cvtColor(draw_plan(loaded, seen), cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", plan, options)
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return bytes(data.tobytes())


def material_colours(world: World, assets: Mapping[str, bytes]) -> dict[str, Rgb]:
    """The colour of each material by name: its texture's mean, or its diffuse colour."""
    return {m.name: _mean_colour(m, assets) for m in world.materials}


def _mean_colour(material: Material, assets: Mapping[str, bytes]) -> Rgb:
    data = assets.get(material.texture_sha256)
    if data is None:
        r, g, b = (round(255 * value) for value in material.diffuse[:3])
        return r, g, b
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    b, g, r = (round(float(value)) for value in np.asarray(bgr).mean((0, 1)))
    return r, g, b


def _view(world: World, bodies: Sequence[BodyPlan]) -> View:
    points = [np.array([[world.start.x_m, world.start.y_m]])]
    points += [np.array(wall_corners(wall)) for wall in world.walls]
    # Wide planes are below the world rather than in it.
    points += [body.corners_m for body in bodies if body.solid or not world.walls]
    points += [np.array([[place.x_m, place.y_m]]) for place in world.locations]
    every = np.concatenate(points)
    low, high = every.min(0) - _MARGIN_M, every.max(0) + _MARGIN_M
    longest = float((high - low).max())
    return View(low, high, min(MAX_SIDE_PX / longest, max(_MAX_PX_M, _MIN_SIDE_PX / longest)))


def _floor(loaded: LoadedWorld, view: View, colours: Mapping[str, Rgb]) -> Picture:
    """Free floor in the rooms' colours, unknown cells in grey."""
    world = loaded.world
    width, height = view.size_px
    floor = Image.new("RGB", (width, height), _light(colours.get(world.floor_material, _CORE)))
    draw = ImageDraw.Draw(floor)
    for room in world.rooms:
        if room.floor_material:
            draw.polygon(
                view.at(np.array(room.polygon_m)), fill=_light(colours[room.floor_material])
            )
    # The floor extends by a cell under walls and bodies, which are drawn over it.
    free = ndimage.binary_dilation(loaded.map_cells == FREE, np.ones((3, 3)))
    free &= loaded.map_cells != UNKNOWN
    picture = np.asarray(floor).copy()
    picture[_warped(free.astype(np.uint8), loaded, view) == 0] = _UNKNOWN
    return picture


def _light(colour: Rgb) -> Rgb:
    """Paler, so that lines and text are visible on it."""
    r, g, b = (round(0.45 * value + 0.55 * 255) for value in colour)
    return r, g, b


def _warped(cells: NDArray[np.uint8], loaded: LoadedWorld, view: View) -> NDArray[np.uint8]:
    """A map's cells as the plan's pixels, 0 beyond the map."""
    resolution = loaded.world.map_resolution_m
    origin = loaded.map_origin
    width, height = view.size_px
    # Plan pixel -> metres -> the map's own metres -> cells, whose centres have whole coordinates.
    map_from_plan = np.array(
        [
            [1.0 / view.px_m, 0.0, view.low_m[0] + 0.5 / view.px_m],
            [0.0, -1.0 / view.px_m, view.high_m[1] - 0.5 / view.px_m],
            [0.0, 0.0, 1.0],
        ]
    )
    inverse = SE2(*origin).inverse()
    c, s = math.cos(inverse.yaw_rad), math.sin(inverse.yaw_rad)
    grid_from_map = np.array([[c, -s, inverse.x_m], [s, c, inverse.y_m], [0.0, 0.0, 1.0]])
    cells_from_grid = np.array(
        [[1.0 / resolution, 0.0, -0.5], [0.0, 1.0 / resolution, -0.5], [0.0, 0.0, 1.0]]
    )
    matrix = (cells_from_grid @ grid_from_map @ map_from_plan)[:2]
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(cells, matrix, (width, height), flags=flags), np.uint8)


def _tinted(picture: Picture, loaded: LoadedWorld, view: View, seen: NDArray[np.bool_]) -> Picture:
    """Each marker's area outlined in its colour, and tinted, with the mean of overlapping ones."""
    tints = np.array([_TINTS[index % len(_TINTS)] for index in range(len(seen))], np.float32)
    count = seen.sum(0, dtype=np.float32)
    mixed = np.tensordot(seen.astype(np.float32), tints, axes=(0, 0))
    mixed /= np.maximum(count, 1.0)[..., None]
    colours = np.dstack(
        [_warped(np.rint(mixed[..., k]).astype(np.uint8), loaded, view) for k in range(3)]
    )
    strength = np.where(count > 0, 70 + 12 * np.minimum(count, 4), 0).astype(np.uint8)
    share = _warped(strength, loaded, view).astype(np.float32)[..., None] / 255.0
    tinted = np.asarray(np.rint(picture * (1.0 - share) + colours * share), np.uint8)
    for index, area in enumerate(seen if len(seen) <= _MAX_OUTLINED else ()):
        mask = _warped(area.astype(np.uint8), loaded, view)
        edges, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(tinted, edges, -1, _TINTS[index % len(_TINTS)], _OVERSAMPLING)
    return tinted


def _grid(draw: ImageDraw.ImageDraw, view: View) -> None:
    width, height = view.size_px
    step = _step_m(view.px_m / _OVERSAMPLING)
    for x in _ticks(view.low_m[0], view.high_m[0], step):
        at = view.one(x, 0.0)[0]
        draw.line([(at, 0), (at, height)], fill=(188, 192, 198), width=1)
    for y in _ticks(view.low_m[1], view.high_m[1], step):
        at = view.one(0.0, y)[1]
        draw.line([(0, at), (width, at)], fill=(188, 192, 198), width=1)


def _step_m(px_m: float) -> float:
    """Metres between two lines of the grid: 1, 2 or 5 times a power of ten, 60 pixels or more."""
    for step in (m * 10.0**e for e in range(-1, 5) for m in (1.0, 2.0, 5.0)):
        if step * px_m >= 60.0:
            return step
    return 1e5


def _ticks(low: float, high: float, step: float) -> list[float]:
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _dashed(
    draw: ImageDraw.ImageDraw, points: Sequence[tuple[float, float]], fill: Rgb, width: int
) -> None:
    dash = 7.0 * _OVERSAMPLING
    for (x0, y0), (x1, y1) in pairwise(points):
        length = math.hypot(x1 - x0, y1 - y0)
        for k in range(0, math.ceil(length / dash), 2):
            a, b = k * dash / length, min((k + 1) * dash / length, 1.0)
            draw.line(
                [
                    (x0 + a * (x1 - x0), y0 + a * (y1 - y0)),
                    (x0 + b * (x1 - x0), y0 + b * (y1 - y0)),
                ],
                fill=fill,
                width=width,
            )


def _wall(draw: ImageDraw.ImageDraw, view: View, wall: Wall, colours: Mapping[str, Rgb]) -> None:
    """A dark core between its two faces, each in its materials' colours."""
    length, thickness = wall.length_m / 2.0, wall.thickness_m / 2.0
    whole = _strip(wall, -length, length, -thickness, thickness)
    if wall.thickness_m * view.px_m < 6 * _OVERSAMPLING:
        # Too thin for bands: dark, so that a maze's lines are visible.
        draw.polygon(view.at(whole), fill=_dark(colours[wall.material]))
        return
    draw.polygon(view.at(whole), fill=_CORE)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        inner, outer = sign * thickness * 0.3, sign * thickness
        face = _strip(wall, -length, length, inner, outer)
        draw.polygon(view.at(face), fill=colours[wall.material])
        for cover in wall.coverings:
            if cover.side == side:
                start, end = max(cover.from_m, -length), min(cover.to_m, length)
                piece = _strip(wall, start, end, inner, outer)
                draw.polygon(view.at(piece), fill=colours[cover.material])
    draw.polygon(view.at(whole), outline=_INK, width=1)


def _strip(wall: Wall, from_m: float, to_m: float, low_m: float, high_m: float) -> Array:
    corners = ((from_m, low_m), (to_m, low_m), (to_m, high_m), (from_m, high_m))
    places = [wall.map_from_wall() @ SE2(x, y, 0.0) for x, y in corners]
    return np.array([(place.x_m, place.y_m) for place in places])


def _dark(colour: Rgb) -> Rgb:
    r, g, b = (round(0.45 * value) for value in colour)
    return r, g, b


def _on_the_level(
    picture: Picture, view: View, bodies: Sequence[BodyPlan], colours: Mapping[str, Rgb]
) -> Picture:
    """The bodies' obstacles on the robot's level, at any height, in pale colours.

    `view` is the plan's; each of its pixels is `_OVERSAMPLING` picture pixels per side.
    """
    width, height = view.size_px
    low_y_m = float(view.high_m[1]) - height / view.px_m
    grid = Grid(height, width, 1.0 / view.px_m, SE2(float(view.low_m[0]), low_y_m, 0.0))
    by_colour: dict[Rgb, list[Footprint]] = {}
    for body in bodies:
        if body.floor.polygons_m:
            by_colour.setdefault(colours.get(body.material, _CORE), []).append(body.floor)
    rows, columns = picture.shape[:2]
    for colour, taken in by_colour.items():
        cells = occupied_cells(taken, grid)[::-1]
        for axis in (0, 1):
            cells = np.repeat(cells, _OVERSAMPLING, axis)
        picture[: height * _OVERSAMPLING, : width * _OVERSAMPLING][cells[:rows, :columns]] = _pale(
            colour
        )
    return picture


def _pale(colour: Rgb) -> Rgb:
    """Of bodies above or below the lidar's plane."""
    r, g, b = (round(0.6 * value + 0.4 * 255) for value in colour)
    return r, g, b


def _bodies(
    picture: Picture, view: View, bodies: Sequence[BodyPlan], colours: Mapping[str, Rgb]
) -> Picture:
    """Filled where the lidar hits them, and an outline: a thick one if they move."""
    for body in bodies:
        fill = colours.get(body.material, _CORE)
        for part in shapely.get_parts(body.cut):
            if part.geom_type == "Polygon":
                cv2.fillPoly(picture, _rings(part, view), fill, shift=_SHIFT)
            else:
                line = _pixels(shapely.get_coordinates(part), view)
                cv2.polylines(picture, [line], False, fill, 2 * _OVERSAMPLING, shift=_SHIFT)
        width = (3 if body.moves else 1) * _OVERSAMPLING
        for part in shapely.get_parts(body.outline):
            if part.geom_type == "Polygon":
                rings = _rings(part, view)
                cv2.polylines(picture, rings, True, _INK, width, cv2.LINE_AA, _SHIFT)
            elif body.cut.is_empty:
                line = _pixels(shapely.get_coordinates(part), view)
                cv2.polylines(picture, [line], False, _INK, width, cv2.LINE_AA, _SHIFT)
    return picture


def _rings(polygon: shapely.Geometry, view: View) -> list[NDArray[np.int32]]:
    """Border and holes of a polygon."""
    rings = shapely.get_rings(polygon)
    return [_pixels(shapely.get_coordinates(ring)[:-1], view) for ring in rings]


def _pixels(points_m: Array, view: View) -> NDArray[np.int32]:
    """(n, 2) points for OpenCV: in 2**-_SHIFT of a pixel, from the first one's centre."""
    pixels = np.array(view.at(points_m)) - 0.5
    return np.asarray(np.rint(pixels * 2**_SHIFT), np.int32)


def _marker(draw: ImageDraw.ImageDraw, view: View, entity: MarkerEntity, colour: Rgb) -> None:
    """A bar along the face, and a tick along its normal."""
    x, y, right, normal = _panel(entity)
    half = max(entity.panel_side_m / 2.0, 4.0 * _OVERSAMPLING / view.px_m)
    depth = max(0.05, 4.0 * _OVERSAMPLING / view.px_m)
    centre = np.array([x, y])
    bar = [
        centre - half * right, centre + half * right,
        centre + half * right + depth * normal, centre - half * right + depth * normal,
    ]  # fmt: skip
    draw.polygon(view.at(np.array(bar)), fill=colour, outline=_INK, width=_OVERSAMPLING // 2)
    tip = [centre + 0.5 * half * right, centre - 0.5 * half * right, centre + 2.2 * depth * normal]
    draw.polygon(view.at(np.array(tip) + depth * normal), fill=colour)


def _panel(entity: MarkerEntity) -> tuple[float, float, Array, Array]:
    """Centre, right and normal of a marker on the floor."""
    rotation = rotation_from_quaternion(*entity.orientation_xyzw)
    return entity.position_m[0], entity.position_m[1], rotation[:2, 0], rotation[:2, 2]


def _robot(draw: ImageDraw.ImageDraw, view: View, start: Planar) -> None:
    """To scale, its heading a line from its centre to beyond its edge."""
    x, y = view.one(start.x_m, start.y_m)
    radius = WAFFLE_RADIUS_M * view.px_m
    reach = max(1.6 * radius, 24.0 * _OVERSAMPLING)
    box = [x - radius, y - radius, x + radius, y + radius]
    width = max(2 * _OVERSAMPLING, round(0.02 * view.px_m))
    draw.ellipse(box, fill=(205, 240, 215), outline=_START, width=width)
    _arrow(draw, (x, y), start.yaw_rad, reach, _START)


def _place(draw: ImageDraw.ImageDraw, view: View, place: Planar) -> None:
    x, y = view.one(place.x_m, place.y_m)
    radius = max(0.07 * view.px_m, 6.0 * _OVERSAMPLING)
    _arrow(draw, (x, y), place.yaw_rad, max(0.32 * view.px_m, 24.0 * _OVERSAMPLING), _PLACE)
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=_PLACE)


def _arrow(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], yaw_rad: float, length: float, colour: Rgb
) -> None:
    along = np.array([math.cos(yaw_rad), -math.sin(yaw_rad)])
    across = np.array([-along[1], along[0]])
    head = 0.38 * length
    tip, neck = np.array(at) + length * along, np.array(at) + (length - head) * along
    width = max(2, round(0.11 * length))
    draw.line([at, (float(neck[0]), float(neck[1]))], fill=colour, width=width)
    corners = (tip, neck + 0.55 * head * across, neck - 0.55 * head * across)
    draw.polygon([(float(p[0]), float(p[1])) for p in corners], fill=colour)


def _font(size_px: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size_px)


def _labels(plan: Image.Image, view: View, world: World, entities: Sequence[MarkerEntity]) -> None:
    """Names over the plan, each where it hides as little as possible."""
    draw = ImageDraw.Draw(plan)
    size = min(max(0.13 * view.px_m, max(view.size_px) / 100.0), 20.0)
    small = _font(size)
    # Areas that names must not overlap: each other, locations and the robot.
    taken: list[tuple[float, float, float, float]] = []
    for spot in (world.start, *world.locations):
        x, y = view.one(spot.x_m, spot.y_m)
        reach = max(WAFFLE_RADIUS_M * view.px_m if spot is world.start else 0.0, 8.0)
        taken.append((x - reach, y - reach, x + reach, y + reach))
        head = view.one(
            spot.x_m + 0.3 * math.cos(spot.yaw_rad), spot.y_m + 0.3 * math.sin(spot.yaw_rad)
        )
        taken.append((head[0] - 8.0, head[1] - 8.0, head[0] + 8.0, head[1] + 8.0))
    if len(entities) <= 200:
        for index, entity in enumerate(entities):
            x_m, y_m, right, normal = _panel(entity)
            tip = np.array([x_m, y_m]) + (0.16 + 0.75 * size / view.px_m) * normal
            near = [tip, tip + 0.25 * right, tip - 0.25 * right, tip + 0.2 * normal]
            colour = _dark(_TINTS[index % len(_TINTS)])
            spots = view.at(np.array(near))
            _write(draw, spots, str(entity.marker_id), small, colour, taken, view.size_px)
    for place in world.locations:
        x, y = view.one(place.x_m, place.y_m)
        spots = _around((x, y), 1.4 * size, place.yaw_rad)
        _write(draw, spots, place.name, small, _PLACE, taken, view.size_px)
    x, y = view.one(world.start.x_m, world.start.y_m)
    reach = max(1.2 * WAFFLE_RADIUS_M * view.px_m, 10.0) + size
    spots = _around((x, y), reach, world.start.yaw_rad)
    _write(draw, spots, "start", small, _START, taken, view.size_px)
    for polygon_m, name, colour, _ in _zones(world):
        _write(draw, view.at(_within(polygon_m)), name, small, _dark(colour), taken, view.size_px)
    large = _font(1.15 * size)
    for room in world.rooms:
        spots = view.at(_within(np.array(room.polygon_m)))
        name = room.name.replace("_", " ")
        _write(draw, spots, name, large, (96, 100, 108), taken, view.size_px)


def _around(at: tuple[float, float], reach: float, yaw_rad: float) -> list[tuple[float, float]]:
    """Candidate positions for a name around a pose, those farthest from its arrow first."""
    x, y = at
    spots = [
        (x, y - reach), (x, y + reach), (x + 2.4 * reach, y), (x - 2.4 * reach, y),
        (x, y - 2.0 * reach), (x, y + 2.0 * reach),
    ]  # fmt: skip
    c, s = math.cos(yaw_rad), -math.sin(yaw_rad)
    return sorted(spots, key=lambda spot: round((spot[0] - x) * c + (spot[1] - y) * s, 3) > 0.0)


def _within(polygon_m: Array) -> Array:
    """(n, 2) points in a polygon, the one farthest from its border first, then those around it."""
    polygon = shapely.make_valid(shapely.Polygon(polygon_m))
    middle = shapely.get_coordinates(shapely.maximum_inscribed_circle(polygon, 0.05))[0]
    low, high = polygon_m.min(0), polygon_m.max(0)
    x, y = np.meshgrid(np.linspace(low[0], high[0], 13), np.linspace(low[1], high[1], 13))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    points = points[shapely.contains_xy(shapely.buffer(polygon, -0.15), points)]
    near = np.argsort(np.linalg.norm(points - middle, axis=1), kind="stable")
    return np.vstack([middle, points[near]])


def _write(
    draw: ImageDraw.ImageDraw,
    spots: Iterable[tuple[float, float]],
    text: str,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    colour: Rgb,
    taken: list[tuple[float, float, float, float]],
    size_px: tuple[int, int],
) -> None:
    """Write at the first candidate position that is still free, or else at the first one."""
    width, height = size_px
    boxes = []
    for x, y in spots:
        left, top, right, bottom = draw.textbbox((x, y), text, font=font, anchor="mm")
        dx = max(2.0 - left, 0.0) + min(width - 2.0 - right, 0.0)
        dy = max(2.0 - top, 0.0) + min(height - 2.0 - bottom, 0.0)
        boxes.append(((x + dx, y + dy), (left + dx, top + dy, right + dx, bottom + dy)))
    clear = (
        (spot, box)
        for spot, box in boxes
        if not any(
            box[0] < t[2] and t[0] < box[2] and box[1] < t[3] and t[1] < box[3] for t in taken
        )
    )
    spot, box = next(clear, boxes[0])
    taken.append(box)
    draw.text(spot, text, fill=colour, font=font, anchor="mm", stroke_width=2, stroke_fill=_PAPER)


def _figures(loaded: LoadedWorld, entities: Sequence[MarkerEntity], seen: NDArray[np.bool_]) -> str:
    world = loaded.world
    free = int((loaded.map_cells == FREE).sum())
    parts = [
        _count(len(world.walls), "wall"),
        _count(len(world.bodies), "body", "bodies"),
        _count(len(entities), "marker"),
    ]
    if len(entities) < len(world.markers):
        parts[-1] += f" ({len(world.markers) - len(entities)} refused)"
    parts.append(f"{free * world.map_resolution_m**2:.1f} sq m free")
    if len(seen):
        cells, origin = loaded.map_cells, loaded.map_origin
        floor = reachable(cells, world.map_resolution_m, origin, world.start)
        share = int((seen.any(0) & floor).sum()) / max(int(floor.sum()), 1)
        parts.append(f"a marker in sight from {share:.0%} of what can be reached")
    return "   ".join(parts)


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _framed(plan: Image.Image, view: View, figures: str, world: World) -> Image.Image:
    """Title above, axes beside, a scale bar under the plan."""
    left, top, right, bottom = LEFT_PX, TOP_PX, RIGHT_PX, BOTTOM_PX
    width, height = plan.size
    name_font, text_font, tick_font = _font(38), _font(20), _font(17)
    probe = ImageDraw.Draw(plan)
    title = max(
        probe.textlength(world.name, font=name_font), probe.textlength(figures, font=text_font)
    )
    total = max(left + width + right, math.ceil(title) + 2 * left)
    canvas = Image.new("RGB", (total, top + height + bottom), _PAPER)
    canvas.paste(plan, (left, top))
    draw = ImageDraw.Draw(canvas)
    draw.text((left, 10), world.name, fill=_INK, font=name_font)
    draw.text((left, 58), figures, fill=(90, 94, 100), font=text_font)
    draw.rectangle([left - 1, top - 1, left + width, top + height], outline=_INK, width=1)
    step = _step_m(view.px_m)
    digits = max(0, -math.floor(math.log10(step)))
    for x in _ticks(view.low_m[0], view.high_m[0], step):
        at = left + view.one(x, 0.0)[0]
        draw.line([(at, top + height), (at, top + height + 6)], fill=_INK)
        draw.text((at, top + height + 9), f"{x:.{digits}f}", fill=_INK, font=tick_font, anchor="mt")
    for y in _ticks(view.low_m[1], view.high_m[1], step):
        at = top + view.one(0.0, y)[1]
        draw.line([(left - 7, at), (left - 1, at)], fill=_INK)
        draw.text((left - 10, at), f"{y:.{digits}f}", fill=_INK, font=tick_font, anchor="rm")
    draw.text(
        (left - 10, top + height + 9), "y, x  m", fill=(90, 94, 100), font=tick_font, anchor="rt"
    )
    _scale_bar(draw, (left, top + height + 50), 2.0 * step, view.px_m, text_font)
    return canvas


def _scale_bar(
    draw: ImageDraw.ImageDraw,
    at: tuple[int, int],
    step_m: float,
    px_m: float,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> None:
    x, y = at
    length = step_m * px_m
    draw.rectangle([x, y, x + length, y + 8], fill=_PAPER, outline=_INK)
    draw.rectangle([x, y, x + length / 2.0, y + 8], fill=_INK)
    draw.text((x + length + 10, y + 4), f"{step_m:g} m", fill=_INK, font=font, anchor="lm")
