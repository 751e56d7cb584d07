"""The length of the shortest path of a disc among obstacles, to compare the driven path with."""

from __future__ import annotations

import heapq
import itertools
import math
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Point

from mazebot.common.robot.waffle import WAFFLE_RADIUS_M

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


_QUARTER_SEGMENTS = 8
# A path may touch the obstacles: they are shrunk by this much before segments are tested.
_TOUCH_M = 1e-6
_MANY = 3_000
"""Beyond this many obstacles, outlines are coarser, to take seconds instead of a minute."""
_SPACING_M = 0.2
"""Spacing of the outline's points: less than a narrow passage, so that triangle sides follow it."""
_DIGITS = 6
"""Decimals of the outline's metres: corners that coincide after rounding are merged."""
_ROUNDS = 2
"""How often outline segments that are no triangle sides are halved."""
_MARGIN_M = 20.0
"""Free floor around all obstacles. Paths that lead farther out are not found."""
_SIDES = [1, 2, 2, 0, 0, 1]
"""Ends of the sides opposite a triangle's corners."""
_SHARES = np.array([0.1, 0.5, 0.9])
"""Fractions of a triangle's side at which the search may cross it."""


class ShortestPath:
    """Shortest paths of a disc among obstacles inflated by its radius.

    The free floor is triangulated. A search over points on the triangles' sides finds the sequence
    of triangles, and the funnel algorithm (Lee and Preparata 1984,
    https://doi.org/10.1002/net.3230140304) the shortest path within it: exact, unless another path
    round an obstacle is nearly as short. The effort grows with the obstacles' outline, not with
    their number squared. A round corner is drawn with 32 segments to the full turn (with 8 where
    there are thousands of obstacles): a path is too short by less than 0.2 % (2.6 %) of its length
    along round corners.
    """

    def __init__(self, obstacles: NDArray[np.object_], radius_m: float = WAFFLE_RADIUS_M) -> None:
        """`obstacles` are shapely polygons and lines, in the map."""
        self._radius_m = radius_m
        coarse = len(obstacles) > _MANY
        grown = shapely.union_all(
            shapely.buffer(
                obstacles,
                radius_m,
                quad_segs=_QUARTER_SEGMENTS // 4 if coarse else _QUARTER_SEGMENTS,
            )
        )
        self._boundary = shapely.boundary(grown)
        self._obstacles = shapely.buffer(grown, -_TOUCH_M, join_style="mitre")
        shapely.prepare(self._obstacles)
        self._floor = (
            None if grown.is_empty else _Floor(grown, 2.0 * _SPACING_M if coarse else _SPACING_M)
        )

    def length_m(self, start_xy: tuple[float, float], goal_xy: tuple[float, float]) -> float | None:
        """Length of the shortest path between two points of the map; None if there is none.

        A point nearer to a wall than the radius is first moved to the nearest position where the
        disc fits, and that distance counts; a point farther than the radius from any such position
        has no path.
        """
        start, start_extra_m = self._fit(start_xy)
        goal, goal_extra_m = self._fit(goal_xy)
        if max(start_extra_m, goal_extra_m) > self._radius_m:
            return None
        way = self._way(start, goal)
        if way is None:
            return None
        return float(np.hypot(*np.diff(way, axis=0).T).sum()) + start_extra_m + goal_extra_m

    def path(self, start_xy: tuple[float, float], goal_xy: tuple[float, float]) -> Array | None:
        """(n, 2) corners of that path, both points included; None if there is none."""
        if self.length_m(start_xy, goal_xy) is None:
            return None
        way = self._way(self._fit(start_xy)[0], self._fit(goal_xy)[0])
        return None if way is None else np.vstack([start_xy, way, goal_xy])

    def _way(self, start: Array, goal: Array) -> Array | None:
        """(n, 2) corners of the shortest path between two positions where the disc fits."""
        if self._floor is None or self._is_free(start, goal):
            return np.stack([start, goal])
        return self._floor.way(start, goal)

    def _fit(self, xy: tuple[float, float]) -> tuple[Array, float]:
        """The nearest position where the disc fits, and its distance."""
        point = Point(xy)
        if not shapely.intersects(self._obstacles, point):
            return np.array(xy, np.float64), 0.0
        line = shapely.shortest_line(point, self._boundary)
        return shapely.get_coordinates(line)[1], float(shapely.length(line))

    def _is_free(self, start: Array, end: Array) -> bool:
        """Whether no obstacle crosses a segment."""
        return not shapely.intersects(self._obstacles, shapely.linestrings([start, end]))


class _Floor:
    """The free floor in triangles, and the points on their sides where paths may cross."""

    def __init__(self, obstacles: Any, spacing_m: float) -> None:
        self._points, triangles, neighbours = _triangles(obstacles, spacing_m)
        centres = self._points[triangles].mean(axis=1)
        shapely.prepare(obstacles)
        free = ~shapely.contains_xy(obstacles, *centres.T)
        number = np.where(free, np.cumsum(free) - 1, -1)
        self._triangles = triangles[free]
        beside = np.where(neighbours[free] < 0, -1, number[neighbours[free]])
        # Side k of a triangle is opposite its corner k, and so is its neighbour k.
        rows, sides = np.nonzero(beside >= 0)
        others = beside[rows, sides]
        first = rows < others
        self._between = np.stack([rows[first], others[first]], axis=1)
        """(s, 2) triangles on both sides of each side that a path may cross."""
        self._sides = np.stack(
            [triangles_at[np.arange(len(rows)), (sides + k) % 3][first]
             for triangles_at in (self._triangles[rows],) for k in (1, 2)], axis=1,
        )  # fmt: skip
        self._tree = shapely.STRtree(shapely.polygons(self._points[self._triangles]))
        ends = self._points[self._sides]
        shares = _SHARES[None, :, None]
        self._gates = (1.0 - shares) * ends[:, None, 0] + shares * ends[:, None, 1]
        """(s, g, 2) points of each side."""
        self._ways = self._connected()
        """The points reachable from each point across one triangle, and their distances."""

    def way(self, start: Array, goal: Array) -> Array | None:
        """(n, 2) corners of the shortest path; None if there is none."""
        triangles = self._triangles_between(start, goal)
        if triangles is None:
            return None
        # A start or goal on a gate would make the funnel degenerate.
        while len(triangles) > 1 and self._touches(start, triangles[1]):
            del triangles[0]
        while len(triangles) > 1 and self._touches(goal, triangles[-2]):
            del triangles[-1]
        lefts, rights = [start], [start]
        for here, there in itertools.pairwise(triangles):
            corners = self._triangles[here]
            apart = int(np.flatnonzero(~np.isin(corners, self._triangles[there]))[0])
            # Counter-clockwise from the corner that is not shared: right, then left.
            rights.append(self._points[corners[(apart + 1) % 3]])
            lefts.append(self._points[corners[(apart + 2) % 3]])
        return _funnel(np.array([*lefts, goal]), np.array([*rights, goal]))

    def _touches(self, point: Array, triangle: int) -> bool:
        shape = self._tree.geometries[triangle]
        return bool(shapely.dwithin(shape, Point(point), _TOUCH_M))

    def _connected(self) -> list[list[tuple[int, float]]]:
        """Connections between the points on different sides of each triangle."""
        side_of = np.full((len(self._triangles), 3), -1)
        for column in (0, 1):
            rows = self._between[:, column]
            corner = (self._triangles[rows][:, :, None] != self._sides[:, None]).all(axis=2)
            side_of[rows, corner.argmax(axis=1)] = np.arange(len(rows))
        gates = len(_SHARES)
        starts, ends = [], []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            both = side_of[(side_of[:, a] >= 0) & (side_of[:, b] >= 0)]
            one, other = np.meshgrid(np.arange(gates), np.arange(gates))
            starts.append((both[:, a, None] * gates + one.ravel()).ravel())
            ends.append((both[:, b, None] * gates + other.ravel()).ravel())
        start, end = np.concatenate(starts), np.concatenate(ends)
        points = self._gates.reshape(-1, 2)
        lengths_m = np.hypot(*(points[start] - points[end]).T)
        ways: list[list[tuple[int, float]]] = [[] for _ in points]
        for one, other, length_m in zip(
            start.tolist(), end.tolist(), lengths_m.tolist(), strict=True
        ):
            ways[one].append((other, length_m))
            ways[other].append((one, length_m))
        return ways

    def _triangles_between(self, start: Array, goal: Array) -> list[int] | None:
        """The triangles to go through, each adjacent to the next; None if there is no path."""
        first, last = (int(self._tree.nearest(Point(point))) for point in (start, goal))
        if first == last:
            return [first]
        gates = len(_SHARES)
        points = self._search(start, first, goal, last)
        if points is None:
            return None
        triangles = [last]
        for point in reversed(points):
            beside = self._between[point // gates].tolist()
            # Two sides of one triangle in a row: the one behind the first was not entered.
            while triangles[-1] not in beside:
                triangles.pop()
            triangles.append(beside[0] if beside[1] == triangles[-1] else beside[1])
        return triangles[::-1]

    def _search(self, start: Array, first: int, goal: Array, last: int) -> list[int] | None:
        """The points on sides along the shortest path, by A*; None if there is none."""
        points = self._gates.reshape(-1, 2)
        left_m = np.hypot(*(points - goal).T).tolist()
        """Straight-line distance to the goal."""
        own = self._points_around(first)
        lengths_m = np.hypot(*(points[own] - start).T)
        at_goal = set(self._points_around(last).tolist())
        reached_m = [math.inf] * len(points)
        before = [-1] * len(points)
        heap: list[tuple[float, int]] = []
        for point, length_m in zip(own.tolist(), lengths_m.tolist(), strict=True):
            reached_m[point] = length_m
            heap.append((length_m + left_m[point], point))
        heapq.heapify(heap)
        done = [False] * len(points)
        while heap:
            _, point = heapq.heappop(heap)
            if done[point]:
                continue
            done[point] = True
            if point in at_goal:
                way = [point]
                while before[way[-1]] >= 0:
                    way.append(before[way[-1]])
                return way[::-1]
            for other, length_m in self._ways[point]:
                whole_m = reached_m[point] + length_m
                if whole_m < reached_m[other]:
                    reached_m[other] = whole_m
                    before[other] = point
                    heapq.heappush(heap, (whole_m + left_m[other], other))
        return None

    def _points_around(self, triangle: int) -> Indices:
        """The points on a triangle's sides."""
        sides = np.flatnonzero((self._between == triangle).any(axis=1))
        return np.asarray((sides[:, None] * len(_SHARES) + np.arange(len(_SHARES))).ravel())


def _triangles(obstacles: Any, spacing_m: float) -> tuple[Array, Indices, Indices]:
    """Points (n, 2), triangles (m, 3) counter-clockwise, and neighbours (m, 3), -1 for none; no
    triangle crosses the outline of the obstacles.
    """
    low, high = np.array(shapely.bounds(obstacles)).reshape(2, 2)
    frame = shapely.box(*(low - _MARGIN_M), *(high + _MARGIN_M))
    outline = shapely.segmentize(shapely.boundary(obstacles), spacing_m)
    starts, ends = [], []
    for ring in (*shapely.get_parts(outline), shapely.get_exterior_ring(frame)):
        corners = shapely.get_coordinates(ring)
        starts.append(corners[:-1])
        ends.append(corners[1:])
    both = np.round([np.concatenate(starts), np.concatenate(ends)], _DIGITS)
    points, index = np.unique(both.reshape(-1, 2), axis=0, return_inverse=True)
    segments = index.reshape(2, -1).T
    triangles = _delaunay(points)
    for _ in range(_ROUNDS):
        lacking = ~np.isin(_pairs(segments), _pairs(triangles[:, _SIDES]))
        if not lacking.any():
            break
        halved = segments[lacking]
        middles = np.arange(len(halved)) + len(points)
        points = np.concatenate([points, points[halved].mean(axis=1)])
        segments = np.concatenate(
            [segments[~lacking], np.stack([halved[:, 0], middles], 1),
             np.stack([middles, halved[:, 1]], 1)]
        )  # fmt: skip
        triangles = _delaunay(points)
    return points, triangles, _neighbours(triangles)


def _delaunay(points: Array) -> Indices:
    """(m, 3) Delaunay triangles of points (n, 2), counter-clockwise."""
    shapes = shapely.get_parts(shapely.delaunay_triangles(shapely.multipoints(points)))
    corners = shapely.get_coordinates(shapes).reshape(-1, 4, 2)[:, :3]
    number = {xy: index for index, xy in enumerate(map(tuple, points.tolist()))}
    indices = [number[xy] for xy in map(tuple, corners.reshape(-1, 2).tolist())]
    triangles = np.array(indices, np.int64).reshape(-1, 3)
    (ax, ay), (bx, by) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
    clockwise = ax * by < ay * bx
    triangles[clockwise] = triangles[clockwise, ::-1]
    return triangles


def _neighbours(triangles: Indices) -> Indices:
    """(m, 3) the triangle across the side opposite each corner; -1: none."""
    sides = _pairs(triangles[:, _SIDES])
    order = np.argsort(sides, kind="stable")
    same = np.flatnonzero(np.diff(sides[order]) == 0)
    one, other = order[same], order[same + 1]
    neighbours = np.full(sides.shape, -1)
    neighbours[one], neighbours[other] = other // 3, one // 3
    return neighbours.reshape(-1, 3)


def _pairs(indices: NDArray[Any]) -> Indices:
    """One number for each pair of points, in either order."""
    pairs = np.sort(indices.reshape(-1, 2).astype(np.int64), axis=1)
    return np.asarray((pairs[:, 0] << 32) + pairs[:, 1], np.int64)


def _funnel(lefts: Array, rights: Array) -> Array:
    """(n, 2) corners of the shortest path through gates, of which the first and last are points."""
    left, right = lefts.tolist(), rights.tolist()
    apex = left[0]
    way = [apex]
    at_left = at_right = at = 0
    tip_left, tip_right = left[0], right[0]
    gate = 1
    while gate < len(left):
        narrower = _turn(apex, tip_right, right[gate]) >= 0.0
        if narrower:
            if tip_right == apex or _turn(apex, tip_left, right[gate]) < 0.0:
                tip_right, at_right = right[gate], gate
            else:
                apex, at = tip_left, at_left
                way.append(apex)
                tip_left = tip_right = apex
                at_left = at_right = at
                gate = at + 1
                continue
        narrower = _turn(apex, tip_left, left[gate]) <= 0.0
        if narrower:
            if tip_left == apex or _turn(apex, tip_right, left[gate]) > 0.0:
                tip_left, at_left = left[gate], gate
            else:
                apex, at = tip_right, at_right
                way.append(apex)
                tip_left = tip_right = apex
                at_left = at_right = at
                gate = at + 1
                continue
        gate += 1
    way.append(left[-1])
    return np.array(way)


def _turn(origin: list[float], a: list[float], b: list[float]) -> float:
    """Twice the area of a triangle: positive where b lies to the left of a, as seen from origin."""
    return (a[0] - origin[0]) * (b[1] - origin[1]) - (a[1] - origin[1]) * (b[0] - origin[0])
