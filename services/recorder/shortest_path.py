"""The length of the shortest way a disc can take among the walls, to judge the driven one by."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Point, Polygon

from services.common.documents import Wall

Array = NDArray[np.float64]

ROBOT_RADIUS_M = 0.22
"""Radius of the disc that stands for the robot, Nav2's `robot_radius` for a TurtleBot3 waffle."""

_QUARTER_SEGMENTS = 12
# A way may touch the obstacles: they are shrunk by this much before a segment is held against them.
_TOUCH_M = 1e-6


class ShortestPath:
    """Shortest ways of a disc, by the visibility graph of the walls grown by its radius.

    Such a way bends only at convex corners of the grown walls and passes each of them tangentially:
    the graph holds these corners, and the tangential segments between them that no obstacle
    crosses. A round corner is drawn with 48 segments to the full turn: a way is too short by less
    than 0.1 % of what it runs along round corners.
    """

    def __init__(self, walls: Sequence[Wall], radius_m: float = ROBOT_RADIUS_M) -> None:
        self._radius_m = radius_m
        footprints = [_footprint(wall) for wall in walls]
        grown = shapely.union_all(
            shapely.buffer(footprints, radius_m, quad_segs=_QUARTER_SEGMENTS)
            if footprints
            else np.array([Polygon()])
        )
        self._boundary = shapely.boundary(grown)
        self._obstacles = shapely.buffer(grown, -_TOUCH_M, join_style="mitre")
        shapely.prepare(self._obstacles)
        corners, before, after = _convex_corners(grown)
        self._corners, self._before, self._after = corners, before, after
        first, second = np.triu_indices(len(corners), 1)
        self._edges: list[list[tuple[int, float]]] = [[] for _ in corners]
        tangent = self._tangent(first, corners[second]) & self._tangent(second, corners[first])
        first, second = first[tangent], second[tangent]
        free = self._free(corners[first], corners[second])
        for i, j in zip(first[free].tolist(), second[free].tolist(), strict=True):
            length_m = float(np.hypot(*(corners[i] - corners[j])))
            self._edges[i].append((j, length_m))
            self._edges[j].append((i, length_m))

    def length_m(self, start_xy: tuple[float, float], goal_xy: tuple[float, float]) -> float | None:
        """Length of the shortest way between two points of the map; None where there is no way.

        A point nearer to a wall than the radius is first moved to the nearest place where the disc
        fits, and the way there counts; one farther than the radius from any such place has no way.
        """
        start, start_extra_m = self._fit(start_xy)
        goal, goal_extra_m = self._fit(goal_xy)
        if max(start_extra_m, goal_extra_m) > self._radius_m:
            return None
        extra_m = start_extra_m + goal_extra_m
        if bool(self._free(start[None], goal[None])[0]):
            return float(np.hypot(*(goal - start))) + extra_m
        from_start = self._visible(start)
        to_goal = dict(self._visible(goal))
        queue = [(length_m, corner) for corner, length_m in from_start]
        heapq.heapify(queue)
        done = np.zeros(len(self._corners), bool)
        best_m = np.inf
        while queue:
            length_m, corner = heapq.heappop(queue)
            if length_m >= best_m:
                break
            if done[corner]:
                continue
            done[corner] = True
            best_m = min(best_m, length_m + to_goal.get(corner, np.inf))
            for other, edge_m in self._edges[corner]:
                if not done[other]:
                    heapq.heappush(queue, (length_m + edge_m, other))
        return best_m + extra_m if np.isfinite(best_m) else None

    def _fit(self, xy: tuple[float, float]) -> tuple[Array, float]:
        """The nearest place where the disc fits, and how far off it is."""
        point = Point(xy)
        if not shapely.intersects(self._obstacles, point):
            return np.array(xy, np.float64), 0.0
        line = shapely.shortest_line(point, self._boundary)
        return shapely.get_coordinates(line)[1], float(shapely.length(line))

    def _visible(self, point: Array) -> list[tuple[int, float]]:
        """The corners a straight tangential way leads to from a point, with its length."""
        everywhere = np.arange(len(self._corners))
        candidates = everywhere[
            self._tangent(everywhere, np.broadcast_to(point, (len(everywhere), 2)))
        ]
        ends = self._corners[candidates]
        seen = self._free(np.broadcast_to(point, ends.shape), ends)
        lengths_m = np.hypot(*(ends - point).T)
        return list(zip(candidates[seen].tolist(), lengths_m[seen].tolist(), strict=True))

    def _tangent(self, corners: NDArray[np.int64], towards: Array) -> NDArray[np.bool_]:
        """Whether the line from each corner through a point has both its neighbours on one side."""
        here = self._corners[corners]
        way = towards - here
        before = _cross(way, self._before[corners] - here)
        after = _cross(way, self._after[corners] - here)
        return before * after >= -1e-12

    def _free(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Whether no obstacle crosses each of the segments; starts and ends are (N, 2)."""
        segments = shapely.linestrings(np.stack([starts, ends], axis=1))
        return ~np.asarray(shapely.intersects(self._obstacles, segments), bool)


def _footprint(wall: Wall) -> Any:
    half_length_m, half_thickness_m = wall.length_m / 2, wall.thickness_m / 2
    map_from_wall = wall.map_from_wall().matrix()
    corners = np.array(
        [
            (sx * half_length_m, sy * half_thickness_m, 0.0, 1.0)
            for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
    )
    return Polygon((corners @ map_from_wall.T)[:, :2])


def _convex_corners(obstacles: Any) -> tuple[Array, Array, Array]:
    """(N, 2) convex corners of polygons, and the vertices before and after each of them."""
    here, before, after = [np.empty((0, 2))], [np.empty((0, 2))], [np.empty((0, 2))]
    for polygon in shapely.get_parts(obstacles):
        if polygon.is_empty:
            continue
        oriented = shapely.orient_polygons(polygon)
        for ring in (oriented.exterior, *oriented.interiors):
            # Exteriors turn left and interiors right, so that the obstacle is always to the left.
            points = shapely.get_coordinates(ring)[:-1]
            previous, following = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
            convex = _cross(points - previous, following - points) > 1e-12
            here.append(points[convex])
            before.append(previous[convex])
            after.append(following[convex])
    return np.concatenate(here), np.concatenate(before), np.concatenate(after)


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
