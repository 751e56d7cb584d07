"""The part of a solid object with which a robot on the floor can collide, seen from above.

That is everything between `FOOT_M` and `TOP_M`: what is lower counts as floor, and the space under
a table's top is free, except for the legs. Between two equal heights it is what a lidar in that
plane sees.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, pose_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.robot.waffle import FOOT_M, TOP_M
from mazebot.common.world.geometry import TriangleMesh, triangles_of

Heights = tuple[float, float]
"""In m above the floor, lower and upper."""

BODY: Heights = (FOOT_M, TOP_M)
"""Of the robot."""
_TURN = 64
"""Sides of the polygon drawn around a circle; it is wider than the circle by up to 0.12 %."""
_ARC = 32
"""The same, from pole to pole of a sphere."""
_SHEET_M = 5e-4
"""Half of the thickness given to the upright triangles of a mesh that is not closed."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """The floor area that an object occupies, in the map frame."""

    polygons_m: tuple[Array, ...] = ()
    """Each (n, k, 2): n convex polygons, the k corners of each in order. Corners may coincide, and
    a polygon may be as thin as a line.
    """
    outline_m: Array | None = None
    """(n, 2, 2): closed loops of segments, from and to. The area that they enclose is occupied."""


@functools.lru_cache(maxsize=20_000)
def wall_corners(wall: doc.Wall) -> tuple[tuple[float, float], ...]:
    """The four corners of a wall's footprint, counter-clockwise."""
    x, y = wall.length_m / 2.0, wall.thickness_m / 2.0
    corners = (
        wall.map_from_wall() @ SE2(a, b, 0.0) for a, b in ((x, y), (-x, y), (-x, -y), (x, -y))
    )
    return tuple((corner.x_m, corner.y_m) for corner in corners)


def footprints(
    world: doc.World, meshes: Mapping[str, TriangleMesh], between_m: Heights = BODY
) -> tuple[Footprint, ...]:
    """The footprints of everything solid in a world, between two heights: walls first, of any
    height, then the bodies' shapes at their initial poses.

    `meshes` are by sha256. Raises KeyError where one is missing.
    """
    walls = [wall_corners(wall) for wall in world.walls]
    return Footprint((np.array(walls),) if walls else ()), *(
        footprint(
            shape.geometry,
            portable.product(pose_matrix(body), pose_matrix(shape)),
            meshes,
            between_m,
        )
        for body in world.bodies
        for shape in body.shapes
        if shape.solid
    )


def footprint(
    geometry: doc.Geometry,
    map_from_shape: Array,
    meshes: Mapping[str, TriangleMesh],
    between_m: Heights = BODY,
) -> Footprint:
    """The footprint of one shape at a pose, (4, 4), between two heights.

    Boxes, polylines and meshes are exact; round shapes are circumscribed.
    """
    match geometry:
        case doc.Mesh():
            mesh = meshes[geometry.sha256]
            vertices_m = mesh.vertices_m * geometry.scale
            return _of_triangles(vertices_m, mesh.triangles, map_from_shape, between_m)
        case doc.Polyline() | doc.Plane():
            mesh = triangles_of(geometry, meshes)
            return _of_triangles(mesh.vertices_m, mesh.triangles, map_from_shape, between_m)
        case doc.Sphere():
            return _of_sphere(geometry.radius_m, map_from_shape[:3, 3], between_m)
        case _:
            return _of_convex(geometry, map_from_shape.tobytes(), between_m)


def section(vertices_m: Array, triangles: NDArray[np.int32], height_m: float) -> Array:
    """(n, 2, 2) segments, from and to, in which a surface of (k, 3) vertices and (m, 3) triangles
    intersects a height. The side behind the triangles lies to the right of the segments.
    """
    return _section(vertices_m, _merged(vertices_m, triangles), height_m)


def _moved(points: Array, a_from_b: Array) -> Array:
    return np.asarray(portable.product(points, a_from_b[:3, :3].T) + a_from_b[:3, 3])


def _of_sphere(radius_m: float, centre_m: Array, between_m: Heights) -> Footprint:
    """The widest horizontal circle of the sphere between the heights."""
    height_m = float(np.clip(centre_m[2], *between_m))
    square_m2 = portable.square(radius_m) - portable.square(height_m - centre_m[2])
    if square_m2 <= 0.0:
        return Footprint()
    return Footprint(((centre_m[:2] + math.sqrt(square_m2) * _around())[None],))


@functools.lru_cache(maxsize=20_000)
def _of_convex(geometry: doc.Geometry, map_from_shape: bytes, between_m: Heights) -> Footprint:
    """The footprint of a convex shape at a pose, a (4, 4) matrix as bytes."""
    points, edges = _edges(geometry)
    points = _moved(points, np.frombuffer(map_from_shape).reshape(4, 4))
    z = points[:, 2]
    low_m, top_m = between_m
    if z.max() <= low_m or z.min() >= top_m:
        return Footprint()
    # The part between the heights has as corners those of the body between them, and the
    # intersections of its edges with the heights.
    corners = [points[(z >= low_m) & (z <= top_m), :2]]
    start, end = points[edges[:, 0]], points[edges[:, 1]]
    for height in between_m:
        across = (start[:, 2] < height) != (end[:, 2] < height)
        corners.append(_at_height(start[across], end[across], height))
    # A line through all points has the same hull, and is made faster than a multipoint.
    hull = shapely.convex_hull(shapely.linestrings(np.concatenate(corners)))
    return Footprint((np.array(shapely.get_coordinates(hull))[None],))


def _at_height(start: Array, end: Array, height_m: float) -> Array:
    """(n, 2) points where segments that cross a height intersect it."""
    share = (height_m - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    return np.asarray(start[:, :2] + share * (end[:, :2] - start[:, :2]))


def _edges(geometry: doc.Geometry) -> tuple[Array, NDArray[np.intp]]:
    """(n, 3) corners and (m, 2) edges of a tight convex body around the shape."""
    match geometry:
        case doc.Box():
            corners = np.array([[(i >> axis & 1) - 0.5 for axis in range(3)] for i in range(8)])
            pairs = [(i, i | 1 << axis) for i in range(8) for axis in range(3) if not i >> axis & 1]
            return corners * geometry.size_m, np.array(pairs)
        case doc.Cylinder():
            half_m = geometry.length_m / 2.0
            return _lathe(((geometry.radius_m, -half_m), (geometry.radius_m, half_m)))
        case doc.Cone():
            half_m = geometry.length_m / 2.0
            return _lathe(((geometry.radius_m, -half_m), (0.0, half_m)))
        case doc.Ellipsoid():
            points, edges = _sphere(0.0)
            return points * geometry.radii_m, edges
        case doc.Capsule():
            points, edges = _sphere(geometry.length_m / geometry.radius_m)
            return points * geometry.radius_m, edges
        case _:
            raise TypeError(f"a {geometry.kind} is not convex")


@functools.cache
def _sphere(stretch: float) -> tuple[Array, NDArray[np.intp]]:
    """A body around a sphere of radius 1 whose halves lie `stretch` apart along z."""
    # The corners of the polygon around a half circle lie between its tangent points.
    step = math.pi / _ARC
    angles = (np.arange(_ARC) + 0.5) * step - math.pi / 2.0
    radii, heights = portable.cos_sin_each(angles)
    heights = (
        heights + np.sign(heights) * stretch * portable.cos(step / 2.0) / 2.0
    ) / portable.cos(step / 2.0)
    return _lathe(
        tuple(zip((radii / portable.cos(step / 2.0)).tolist(), heights.tolist(), strict=True))
    )


@functools.cache
def _around() -> Array:
    """(n, 2) corners of the polygon around a circle of radius 1."""
    angles = np.arange(_TURN) * (2.0 * math.pi / _TURN)
    return np.stack(portable.cos_sin_each(angles), axis=-1) / portable.cos(math.pi / _TURN)


def _lathe(profile: tuple[tuple[float, float], ...]) -> tuple[Array, NDArray[np.intp]]:
    """A body around the solid of revolution of a (radius, z) profile about z."""
    around = _around()
    points = np.concatenate(
        [np.column_stack([radius * around, np.full(_TURN, z)]) for radius, z in profile]
    )
    index = np.arange(len(points)).reshape(len(profile), _TURN)
    rings = np.stack([index, np.roll(index, -1, axis=1)], axis=-1).reshape(-1, 2)
    sides = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
    return points, np.concatenate([rings, sides])


def _of_triangles(
    vertices_m: Array, triangles: NDArray[np.int32], map_from_shape: Array, between_m: Heights
) -> Footprint:
    """The footprint of a surface: its projection, and its interior if it is closed."""
    vertices = _moved(vertices_m, map_from_shape)
    corners = vertices[triangles]
    z = corners[..., 2]
    low_m, top_m = between_m
    corners = corners[(z.max(1) > low_m) & (z.min(1) < top_m)]
    if not len(corners):
        return Footprint()
    polygons = _between_heights(corners, low_m, top_m)
    merged = _merged(vertices_m, triangles)
    if _is_closed(merged):
        # Interior points between the heights that no part of the surface projects onto are inside
        # at every height: one section finds them.
        return Footprint(polygons, _section(vertices, merged, low_m))
    return Footprint(tuple(part for stack in polygons for part in _thickened(stack)))


def _between_heights(corners: Array, low_m: float, top_m: float) -> tuple[Array, ...]:
    """Stacks of polygons: (n, 3, 3) triangles seen from above, cut at the two heights."""
    z = corners[..., 2]
    whole = (z.min(1) >= low_m) & (z.max(1) <= top_m)
    start = corners[~whole]
    end = np.roll(start, -1, axis=1)
    # In order around each triangle: each corner, and where the edge after it crosses the heights.
    inside = (start[..., 2] >= low_m) & (start[..., 2] <= top_m)
    rises = end[..., 2] > start[..., 2]
    points, kept = [start[..., :2]], [inside]
    for heights in (np.where(rises, low_m, top_m), np.where(rises, top_m, low_m)):
        across = (start[..., 2] < heights) != (end[..., 2] < heights)
        rise = np.where(across, end[..., 2] - start[..., 2], 1.0)
        share = ((heights - start[..., 2]) / rise)[..., None]
        points.append(start[..., :2] + share * (end[..., :2] - start[..., :2]))
        kept.append(across)
    ring = np.stack(points, axis=2).reshape(-1, 9, 2)
    valid = np.stack(kept, axis=2).reshape(-1, 9)
    ring, valid = ring[valid.any(1)], valid[valid.any(1)]
    # Invalid points are replaced by the valid one before.
    last = np.maximum.accumulate(np.where(valid, np.arange(9), -1), axis=1)
    last = np.where(last < 0, last[:, -1:], last)
    cut = np.take_along_axis(ring, last[..., None], axis=1)
    return corners[whole][..., :2], cut


def _thickened(polygons: Array) -> tuple[Array, Array]:
    """A stack of polygons without those as thin as a line, and rectangles in place of these."""
    ahead = polygons[:, :, None] - polygons[:, None]
    count = polygons.shape[1]
    farthest = (
        portable.hypot_each(ahead[..., 0], ahead[..., 1]).reshape(-1, count * count).argmax(1)
    )
    along = ahead.reshape(-1, count * count, 2)[np.arange(len(polygons)), farthest]
    length = portable.hypot_each(along[:, 0], along[:, 1])[:, None]
    along = np.where(length > 0.0, along, (1.0, 0.0)) / np.where(length > 0.0, length, 1.0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    u = np.einsum("nkj,nj->nk", polygons, along)
    v = np.einsum("nkj,nj->nk", polygons, across)
    thin = v.max(1) - v.min(1) < 2.0 * _SHEET_M
    sides = (v.min(1) - _SHEET_M, v.max(1) + _SHEET_M)
    corners = [(u.min(1), sides[0]), (u.max(1), sides[0]), (u.max(1), sides[1])]
    rectangles = np.stack(
        [a[:, None] * along + b[:, None] * across for a, b in (*corners, (u.min(1), sides[1]))],
        axis=1,
    )
    return polygons[~thin], rectangles[thin]


def _merged(vertices: Array, triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(m, 3): the triangles, with one index for all corners with identical coordinates."""
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    new = np.concatenate([[False], (ordered[1:] != ordered[:-1]).any(1)])
    first = order[np.flatnonzero(np.concatenate([[True], new[1:]]))]
    index = np.empty(len(vertices), np.int64)
    index[order] = first[np.cumsum(new)]
    return index[triangles]


def _is_closed(triangles: NDArray[np.int64]) -> bool:
    """Whether each edge has as many triangles in one direction as in the other."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = int(triangles.max()) + 1
    return np.array_equal(np.sort(start * count + end), np.sort(end * count + start))


def _section(vertices: Array, triangles: NDArray[np.int64], height_m: float) -> Array:
    """(n, 2, 2) directed segments in which triangles intersect a height."""
    above = vertices[:, 2] >= height_m
    corners = above[triangles]
    triangles = triangles[corners.any(1) & ~corners.all(1)]
    ends = []
    for leaves in (False, True):
        # The edge of each triangle that crosses the height upwards, then the one downwards.
        edge = (above[triangles] == leaves) & (above[np.roll(triangles, -1, axis=1)] != leaves)
        at = edge.argmax(1)[:, None]
        a = np.take_along_axis(triangles, at, axis=1)[:, 0]
        b = np.take_along_axis(triangles, (at + 1) % 3, axis=1)[:, 0]
        # In the same order for both triangles of an edge, so that they get the same bits.
        low, high = np.minimum(a, b), np.maximum(a, b)
        ends.append(_at_height(vertices[low], vertices[high], height_m))
    return np.stack(ends, axis=1)
