"""Where a marker hangs, and why it may not hang there.

A panel is judged by its pose alone against the walls, so that a marker placed by hand is judged by
the same rules as one of a recipe.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from services.common.documents import Marker, Planar, Wall
from services.common.frames import SE2, Array, transform_matrix

CONTACT_M = 0.01
"""A panel farther than this from its wall's face floats."""
MAX_DISTANCE_M = 10_000.0
_TOUCH_M = 1e-6
_ALIGNED = 1e-3
"""Sine of the angle by which a panel may lean or turn away from its wall."""


@dataclass(frozen=True)
class Panel:
    """A flat square whose face looks along its +z, with +x to the right and +y up as one looks."""

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
    normal = np.array([math.cos(map_from_face.yaw_rad), math.sin(map_from_face.yaw_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([np.cross(up, normal), up, normal], axis=1)
    return Panel(
        name,
        transform_matrix(rotation, (map_from_face.x_m, map_from_face.y_m, marker.height_m)),
        side_m,
    )


class Placement:
    """The walls and the start of one world, against which panels are judged."""

    def __init__(self, walls: Sequence[Wall], start: Planar, clear_view_m: float) -> None:
        self._walls = tuple(walls)
        self._start = start
        self._clear_view_m = clear_view_m

    def problem(self, panel: Panel, hanging: Sequence[Panel], wall: str | None = None) -> str:
        """Why a panel may not hang where it is; empty where it may.

        `hanging` are the panels that hang already. `wall` names the wall it should be on; without
        one, the wall that it touches is found.
        """
        if not max(np.abs(panel.map_from_panel).max(), panel.side_m) < MAX_DISTANCE_M:
            return f"must lie within {MAX_DISTANCE_M:g} m"
        if abs(panel.normal[2]) > _ALIGNED or abs(panel.right[2]) > _ALIGNED:
            return "does not hang upright"
        host = self._host(panel, wall)
        if host is None:
            return self._floating(panel, wall)
        return (
            _beyond(panel, host)
            or self._buried(panel)
            or _overlapping(panel, hanging)
            or self._hidden(panel)
            or self._out_of_reach(panel)
        )

    def _host(self, panel: Panel, name: str | None) -> Wall | None:
        """The wall on whose face the panel is, wherever along it; the nearest of several."""
        hosts = []
        for wall in self._walls:
            if name is not None and wall.name != name:
                continue
            along, out, facing = _in_wall(panel, wall)
            gap = abs(out) - wall.thickness_m / 2.0
            away = facing * math.copysign(1.0, out) >= math.sqrt(1.0 - _ALIGNED**2)
            past_end = abs(along) - (wall.length_m + panel.side_m) / 2.0
            if away and -_TOUCH_M <= gap <= CONTACT_M and (name is not None or past_end < 0.0):
                hosts.append((max(past_end, 0.0), wall))
        return min(hosts, key=lambda host: host[0])[1] if hosts else None

    def _floating(self, panel: Panel, name: str | None) -> str:
        buried = self._buried(panel)
        if buried:
            return buried
        if not self._walls:
            return "floats: there is no wall"
        centre = shapely.Point(panel.centre_m[:2])
        walls = [wall for wall in self._walls if name is None or wall.name == name]
        wall = min(walls, key=lambda wall: float(centre.distance(_footprint(wall))), default=None)
        if wall is None:
            return f"wall: {name!r:.60}: there is none of this name"
        distance_m = float(centre.distance(_footprint(wall)))
        if distance_m <= CONTACT_M:
            return f"does not lie flat on a face of {wall.name}"
        return f"floats {distance_m:.3f} m off {wall.name}"

    def _buried(self, panel: Panel) -> str:
        half = panel.side_m / 2.0 * panel.right[:2]
        centre = panel.centre_m[:2]
        edge = shapely.LineString([centre - half, centre + half])
        for wall in self._walls:
            if _same_height(panel, wall):
                inside_m = float(edge.intersection(_footprint(wall)).length)
                if inside_m > _TOUCH_M:
                    return f"is buried in {wall.name} over {inside_m:.3f} m"
        return ""

    def _hidden(self, panel: Panel) -> str:
        view = self._view(panel)
        for wall in self._walls:
            if _same_height(panel, wall):
                part = view.intersection(_footprint(wall))
                if part.area > _TOUCH_M:
                    points = shapely.get_coordinates(part) - panel.centre_m[:2]
                    ahead_m = max(float((points @ panel.normal[:2]).min()), 0.0)
                    return f"is hidden by {wall.name}, {ahead_m:.3f} m in front of it"
        return ""

    def _out_of_reach(self, panel: Panel) -> str:
        """A robot that cannot come before the face will never see it."""
        ahead = panel.centre_m[:2] + self._clear_view_m * panel.normal[:2]
        if self._floor.intersects(shapely.Point(ahead)):
            return ""
        return "faces a floor that cannot be reached from the start"

    def _view(self, panel: Panel) -> shapely.Polygon:
        """What lies before the face, up to the depth that must be clear."""
        half = panel.side_m / 2.0 * panel.right[:2]
        near, ahead = panel.centre_m[:2], self._clear_view_m * panel.normal[:2]
        return shapely.Polygon([near - half, near + half, near + half + ahead, near - half + ahead])

    @functools.cached_property
    def _floor(self) -> shapely.Polygon:
        """The floor that is connected to the start; empty where the start lies in a wall."""
        walls = shapely.union_all([_footprint(wall) for wall in self._walls])
        start = shapely.Point(self._start.x_m, self._start.y_m)
        around = shapely.union(walls, start).envelope.buffer(2.0 * self._clear_view_m + 1.0)
        for part in shapely.get_parts(around.difference(walls)):
            if part.contains(start):
                return part
        return shapely.Polygon()


def _in_wall(panel: Panel, wall: Wall) -> tuple[float, float, float]:
    """The centre along and across a wall, in metres, and the normal's part across it."""
    c, s = math.cos(wall.yaw_rad), math.sin(wall.yaw_rad)
    dx, dy = panel.centre_m[0] - wall.x_m, panel.centre_m[1] - wall.y_m
    facing = -s * panel.normal[0] + c * panel.normal[1]
    return float(c * dx + s * dy), float(-s * dx + c * dy), float(facing)


def _beyond(panel: Panel, wall: Wall) -> str:
    along, _, _ = _in_wall(panel, wall)
    half, height = panel.side_m / 2.0, float(panel.centre_m[2])
    past_end = abs(along) + half - wall.length_m / 2.0
    if past_end > _TOUCH_M:
        return f"reaches {past_end:.3f} m beyond the end of {wall.name}"
    if height + half > wall.height_m + _TOUCH_M:
        return f"reaches {height + half - wall.height_m:.3f} m above the top of {wall.name}"
    if height - half < -_TOUCH_M:
        return f"reaches {half - height:.3f} m under the floor"
    return ""


def _overlapping(panel: Panel, hanging: Sequence[Panel]) -> str:
    for other in hanging:
        apart = other.centre_m - panel.centre_m
        reach = (panel.side_m + other.side_m) / 2.0 - _TOUCH_M
        same_plane = (
            abs(float(apart @ panel.normal)) < CONTACT_M
            and float(other.normal @ panel.normal) > 1.0 - _ALIGNED
        )
        if same_plane and abs(float(apart @ panel.right)) < reach and abs(apart[2]) < reach:
            return f"overlaps {other.name}"
    return ""


def _same_height(panel: Panel, wall: Wall) -> bool:
    return bool(
        panel.centre_m[2] - panel.side_m / 2.0 < wall.height_m
        and panel.centre_m[2] + panel.side_m / 2.0 > 0.0
    )


@functools.lru_cache(maxsize=8192)
def _footprint(wall: Wall) -> shapely.Polygon:
    x, y = wall.length_m / 2.0, wall.thickness_m / 2.0
    corners = (
        wall.map_from_wall() @ SE2(a, b, 0.0) for a, b in ((x, y), (-x, y), (-x, -y), (x, -y))
    )
    return shapely.Polygon([(corner.x_m, corner.y_m) for corner in corners])
