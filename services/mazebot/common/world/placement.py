"""The pose of a marker's panel, and the check whether it is valid.

A panel is checked by its pose alone against the whole world, so that a marker placed by hand
follows the same rules as one of a recipe. Bodies count at their initial poses.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, rotation_from_quaternion, transform_matrix
from mazebot.common.messages.documents import Marker, MarkerEntity, Wall, World
from mazebot.common.robot.waffle import FOOT_M, TOP_M
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.obstruction import obstructions, wall_polygons

CONTACT_M = 0.01
"""A panel farther than this from its wall's face floats."""
CLEAR_VIEW_M = 0.5
"""Depth in front of a panel that must be clear."""
MAX_DISTANCE_M = 10_000.0

_TOUCH_M = 1e-6
_ALIGNED = 1e-3
"""Sine of the angle by which a panel may tilt or turn away from its wall."""
_MAX_BANDS = 256
"""Number of height bands cached; a world's markers hang at a few heights."""


@dataclass(frozen=True)
class Panel:
    """A flat square whose face points along +z; +x is right and +y up, seen from the front."""

    name: str
    map_from_panel: Array
    side_m: float

    @property
    def centre_m(self) -> Array:
        """(3,) in the map frame."""
        return self.map_from_panel[:3, 3]

    @property
    def right(self) -> Array:
        """(3,) unit vector in the map frame."""
        return self.map_from_panel[:3, 0]

    @property
    def normal(self) -> Array:
        """(3,) unit vector in the map frame, out of the face."""
        return self.map_from_panel[:3, 2]


def hang(name: str, marker: Marker, wall: Wall, side_m: float, gap_m: float) -> Panel:
    """The panel of a marker on its wall, `gap_m` in front of the wall's face."""
    sign = 1.0 if marker.side == "left" else -1.0
    on_face = SE2(marker.offset_m, sign * (wall.thickness_m / 2.0 + gap_m), sign * math.pi / 2.0)
    map_from_face = wall.map_from_wall() @ on_face
    place_m = map_from_face.x_m, map_from_face.y_m, marker.height_m
    return Panel(name, transform_matrix(upright(map_from_face.yaw_rad), place_m), side_m)


def upright(yaw_rad: float) -> Array:
    """(3, 3) map_from_panel of an upright panel whose face points along a heading."""
    normal = np.array([*portable.cos_sin(yaw_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([np.cross(up, normal), up, normal], axis=1)


def panel_of(entity: MarkerEntity) -> Panel:
    """The panel of a marker entity."""
    rotation = rotation_from_quaternion(*entity.orientation_xyzw)
    return Panel(entity.name, transform_matrix(rotation, entity.position_m), entity.panel_side_m)


@dataclass(frozen=True, eq=False)
class _Band:
    """The area that bodies occupy between two heights."""

    names: tuple[str, ...]
    seen: NDArray[np.bool_]
    polygons: NDArray[np.object_]
    tree: shapely.STRtree


class Placement:
    """Checks panels against one world.

    `meshes` are by sha256; a shape whose mesh is missing is ignored.
    """

    def __init__(self, world: World, meshes: Mapping[str, TriangleMesh] | None = None) -> None:
        self._walls = world.walls
        self._start = shapely.Point(world.start.x_m, world.start.y_m)
        self._ceiling_m = world.ceiling.height_m if world.ceiling else math.inf
        self._footprints = wall_polygons(world.walls)
        self._tree = shapely.STRtree(self._footprints)
        self._numbers: dict[str, list[int]] = {}
        for number, wall in enumerate(world.walls):
            self._numbers.setdefault(wall.name, []).append(number)
        self._obstructions = obstructions(world, meshes)
        self._bands: dict[tuple[float, float], _Band] = {}

    def problem(
        self,
        panel: Panel,
        hanging: Sequence[Panel],
        wall: str | None = None,
        seen: NDArray[np.bool_] | None = None,
    ) -> str:
        """Why a panel's pose is invalid; empty where it is valid.

        `hanging` are the existing panels. `wall` names the wall it should be on; without one, the
        wall that it touches is found. `seen` states for points on the floor whether the robot can
        go there and read the panel; without it this is not checked.
        """
        if not max(np.abs(panel.map_from_panel).max(), panel.side_m) < MAX_DISTANCE_M:
            return f"must lie within {MAX_DISTANCE_M:g} m"
        if abs(panel.normal[2]) > _ALIGNED or abs(panel.right[2]) > _ALIGNED:
            return "is not upright"
        host = self._host(panel, wall)
        if host is None:
            return self._floating(panel, wall)
        return (
            _beyond(panel, host)
            or self._through_ceiling(panel)
            or self._buried(panel)
            or _overlapping(panel, hanging)
            or self._hidden(panel)
            or self._out_of_reach(panel)
            or _unseen(seen)
        )

    def _host(self, panel: Panel, name: str | None) -> Wall | None:
        """The wall on whose face the panel is, even beyond its end; the nearest of several."""
        if name is None:
            centre = shapely.Point(panel.centre_m[:2])
            reach_m = panel.side_m / 2.0 + 2.0 * CONTACT_M
            numbers = sorted(self._tree.query(centre, "dwithin", reach_m).tolist())
        else:
            numbers = self._numbers.get(name, [])
        hosts = []
        for wall in (self._walls[number] for number in numbers):
            along, out, facing = _in_wall(panel, wall)
            gap = abs(out) - wall.thickness_m / 2.0
            away = facing * math.copysign(1.0, out) >= math.sqrt(1.0 - portable.square(_ALIGNED))
            past_end = abs(along) - (wall.length_m + panel.side_m) / 2.0
            if away and -_TOUCH_M <= gap <= CONTACT_M and (name is not None or past_end < 0.0):
                hosts.append((max(past_end, 0.0), wall))
        return min(hosts, key=lambda host: host[0])[1] if hosts else None

    def _floating(self, panel: Panel, name: str | None) -> str:
        buried = self._buried(panel)
        if buried:
            return buried
        if not self._walls:
            return "floats: there are no walls"
        centre = shapely.Point(panel.centre_m[:2])
        if name is None:
            numbers = self._tree.query_nearest(centre).tolist()
        else:
            numbers = self._numbers.get(name, [])
        if not numbers:
            return f"wall: {name!r:.60}: no such wall"
        distances_m = shapely.distance(centre, self._footprints[sorted(numbers)])
        nearest, distance_m = int(np.argmin(distances_m)), float(distances_m.min())
        wall = self._walls[sorted(numbers)[nearest]]
        if distance_m <= CONTACT_M:
            return f"does not lie flat on a face of {wall.name}"
        return f"floats {distance_m:.3f} m off {wall.name}"

    def _through_ceiling(self, panel: Panel) -> str:
        past_m = float(panel.centre_m[2]) + panel.side_m / 2.0 - self._ceiling_m
        return f"extends {past_m:.3f} m through the ceiling" if past_m > _TOUCH_M else ""

    def _buried(self, panel: Panel) -> str:
        half = panel.side_m / 2.0 * panel.right[:2]
        centre = panel.centre_m[:2]
        edge = shapely.LineString([centre - half, centre + half])
        for name, footprint in self._at_height_of(panel, edge, seen_only=False):
            inside_m = float(edge.intersection(footprint).length)
            if inside_m > _TOUCH_M:
                return f"is buried in {name} over {inside_m:.3f} m"
        return ""

    def _hidden(self, panel: Panel) -> str:
        view = self._view(panel)
        for name, footprint in self._at_height_of(panel, view, seen_only=True):
            part = view.intersection(footprint)
            if part.area > _TOUCH_M:
                points = shapely.get_coordinates(part) - panel.centre_m[:2]
                ahead_m = max(float((portable.product(points, panel.normal[:2])).min()), 0.0)
                return f"is hidden by {name}, {ahead_m:.3f} m in front of it"
        return ""

    def _out_of_reach(self, panel: Panel) -> str:
        """A marker is refused if the robot cannot reach the floor in front of its face."""
        if self._floor.intersects(self._view(panel)):
            return ""
        return "faces a part of the floor that is unreachable from the start"

    def _view(self, panel: Panel) -> shapely.Polygon:
        """The area in front of the face, up to the depth that must be clear."""
        half = panel.side_m / 2.0 * panel.right[:2]
        near, ahead = panel.centre_m[:2], CLEAR_VIEW_M * panel.normal[:2]
        return shapely.Polygon([near - half, near + half, near + half + ahead, near - half + ahead])

    def _at_height_of(
        self, panel: Panel, area: shapely.Geometry, seen_only: bool
    ) -> Iterable[tuple[str, shapely.Polygon]]:
        """Names and footprints of objects that intersect an area at the panel's height."""
        low_m = float(panel.centre_m[2]) - panel.side_m / 2.0
        high_m = low_m + panel.side_m
        if high_m > 0.0:
            for number in sorted(self._tree.query(area, "intersects").tolist()):
                if low_m < self._walls[number].height_m:
                    yield self._walls[number].name, self._footprints[number]
        band = self._band(low_m, high_m)
        for number in sorted(band.tree.query(area, "intersects").tolist()):
            if band.seen[number] or not seen_only:
                yield band.names[number], band.polygons[number]

    def _band(self, low_m: float, high_m: float) -> _Band:
        key = (round(low_m, 6), round(high_m, 6))
        if key not in self._bands:
            if len(self._bands) >= _MAX_BANDS:
                del self._bands[next(iter(self._bands))]
            found = [(one, one.between(*key).polygons) for one in self._obstructions]
            polygons = np.array(
                [polygon for _, some in found for polygon in some] or [None], np.object_
            )
            self._bands[key] = _Band(
                tuple(one.name for one, some in found for _ in some),
                np.array([one.seen for one, some in found for _ in some], np.bool_),
                polygons,
                shapely.STRtree(polygons),
            )
        return self._bands[key]

    @functools.cached_property
    def _floor(self) -> shapely.Polygon:
        """The free floor connected to the start; empty where the start lies in an obstacle."""
        solid = [
            polygon
            for one in self._obstructions
            if one.solid
            for polygon in one.between(FOOT_M, TOP_M).polygons
        ]
        taken = shapely.union_all([*self._footprints, *solid])
        around = shapely.union(taken, self._start).envelope.buffer(2.0 * CLEAR_VIEW_M + 1.0)
        parts = shapely.get_parts(around.difference(taken))
        found = parts[shapely.contains(parts, self._start)]
        floor = found[0] if len(found) else shapely.Polygon()
        shapely.prepare(floor)
        return floor


def _unseen(seen: NDArray[np.bool_] | None) -> str:
    if seen is None or seen.any():
        return ""
    return "is not visible from any position that the robot can reach"


def _in_wall(panel: Panel, wall: Wall) -> tuple[float, float, float]:
    """The centre along and across a wall, in metres, and the normal's part across it."""
    c, s = portable.cos_sin(wall.yaw_rad)
    dx, dy = panel.centre_m[0] - wall.x_m, panel.centre_m[1] - wall.y_m
    facing = -s * panel.normal[0] + c * panel.normal[1]
    return float(c * dx + s * dy), float(-s * dx + c * dy), float(facing)


def _beyond(panel: Panel, wall: Wall) -> str:
    along, _, _ = _in_wall(panel, wall)
    half, height = panel.side_m / 2.0, float(panel.centre_m[2])
    past_end = abs(along) + half - wall.length_m / 2.0
    if past_end > _TOUCH_M:
        return f"extends {past_end:.3f} m beyond the end of {wall.name}"
    if height + half > wall.height_m + _TOUCH_M:
        return f"extends {height + half - wall.height_m:.3f} m above the top of {wall.name}"
    if height - half < -_TOUCH_M:
        return f"extends {half - height:.3f} m below the floor"
    return ""


def _overlapping(panel: Panel, hanging: Sequence[Panel]) -> str:
    for other in hanging:
        apart = other.centre_m - panel.centre_m
        reach = (panel.side_m + other.side_m) / 2.0 - _TOUCH_M
        same_plane = (
            abs(float(portable.product(apart, panel.normal))) < CONTACT_M
            and float(portable.product(other.normal, panel.normal)) > 1.0 - _ALIGNED
        )
        if (
            same_plane
            and abs(float(portable.product(apart, panel.right))) < reach
            and abs(apart[2]) < reach
        ):
            return f"overlaps {other.name}"
    return ""
