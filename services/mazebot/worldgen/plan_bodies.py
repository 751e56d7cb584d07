"""The bodies of a world for its plan: cut at the height of the lidar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import Geometry, Mesh, Polyline, World
from mazebot.common.robot.waffle import LIDAR_HEIGHT_M
from mazebot.common.world.footprint import Footprint, footprint, section
from mazebot.common.world.geometry import TriangleMesh, triangles_of

_SNAP_M = 1e-4
"""Ends of cut triangles that are nearer than this are merged."""
_WITHIN = 1e-3
"""Cuts keep this share of a shape's height away from its ends."""


@dataclass(frozen=True, eq=False)
class BodyPlan:
    """A shape of a body from above."""

    corners_m: Array
    """(n, 2), of the convex hull of the whole shape."""
    outline: shapely.Geometry
    """Areas and lines to draw an outline around: the cut, if the lidar hits it; else the hull
    of a convex or a flat shape, and any other's cut at its height nearest to the lidar's.
    """
    cut: shapely.Geometry
    """What the lidar hits: areas, and lines where a surface encloses nothing."""
    floor: Footprint
    """Its footprint on the robot's level."""
    top_m: float
    material: str
    solid: bool
    moves: bool


def body_plans(world: World, meshes: Mapping[str, TriangleMesh]) -> list[BodyPlan]:
    """Of every shape of every body, lower ones first. `meshes` are by sha256."""
    found = []
    for body in world.bodies:
        for shape in body.shapes:
            map_from_shape = pose_matrix(body) @ pose_matrix(shape)
            surface = triangles_of(shape.geometry, meshes).moved(map_from_shape)
            vertices, triangles = surface.vertices_m, surface.triangles
            low_m, top_m = float(vertices[:, 2].min()), float(vertices[:, 2].max())
            corners = _hull(vertices[:, :2])
            cut: shapely.Geometry = shapely.GeometryCollection()
            floor = Footprint()
            if shape.solid:
                floor = footprint(shape.geometry, map_from_shape, meshes)
                if low_m < LIDAR_HEIGHT_M < top_m:
                    cut = areas_and_lines(
                        section(vertices, triangles, LIDAR_HEIGHT_M),
                        # The map treats a closed surface as solid, whichever side it faces.
                        inside_out=floor.outline_m is not None,
                    )
            outline = cut
            if cut.is_empty:
                outline = shapely.Polygon(corners) if len(corners) > 2 else outline
                if not _is_convex(shape.geometry):
                    within = _WITHIN * (top_m - low_m)
                    nearest_m = float(np.clip(LIDAR_HEIGHT_M, low_m + within, top_m - within))
                    outline = areas_and_lines(section(vertices, triangles, nearest_m))
                    if outline.is_empty:
                        outline = _flat_area(vertices[triangles][..., :2])
            plan = BodyPlan(
                corners, outline, cut, floor, top_m, shape.material, shape.solid, body.moves
            )
            found.append(plan)
    return sorted(found, key=lambda plan: plan.top_m)


def areas_and_lines(segments_m: Array, inside_out: bool = False) -> shapely.Geometry:
    """The areas that (n, 2, 2) segments, from and to, enclose, and the segments enclosing nothing.

    The right side of a segment is inside, as with a surface that faces outwards; if it may be
    `inside_out`, so is the left side. A room whose walls are thin sheets is not inside.
    """
    segments = segments_m[(segments_m[:, 0] != segments_m[:, 1]).any(1)]
    if not len(segments):
        return shapely.GeometryCollection()
    # This also cuts them where they cross each other.
    lines = shapely.unary_union(shapely.linestrings(segments), grid_size=_SNAP_M)
    parts = shapely.get_parts(lines)
    faces = shapely.get_parts(shapely.polygonize(parts))
    turns = _turns(shapely.get_coordinates(shapely.point_on_surface(faces)), segments)
    area = shapely.unary_union(faces[(turns != 0) if inside_out else (turns < 0)])
    around = shapely.buffer(area, _SNAP_M)
    shapely.prepare(around)
    open_lines = parts[~shapely.covers(around, parts)]
    return shapely.GeometryCollection([*shapely.get_parts(area), *open_lines])


def _flat_area(triangles_m: Array) -> shapely.Geometry:
    """The area that (n, 3, 2) triangles cover, for shapes too flat to be cut."""
    hulls = shapely.convex_hull(shapely.linestrings(triangles_m))
    return shapely.unary_union(hulls[shapely.area(hulls) > 0.0], grid_size=_SNAP_M)


def _turns(places_m: Array, segments_m: Array) -> NDArray[np.int64]:
    """(n,) winding number of directed segments around each point: those to the right of it that go
    up, minus those that go down.
    """
    far = np.column_stack([np.full(len(places_m), segments_m[..., 0].max() + 1.0), places_m[:, 1]])
    rays = shapely.linestrings(np.stack([places_m, far], axis=1))
    place, met = shapely.STRtree(shapely.linestrings(segments_m)).query(rays)
    (x0, y0), (x1, y1) = segments_m[met, 0].T, segments_m[met, 1].T
    x, y = places_m[place].T
    up, down = (y0 <= y) & (y < y1), (y1 <= y) & (y < y0)
    right = x0 + (y - y0) / np.where(y1 == y0, 1.0, y1 - y0) * (x1 - x0) > x
    turns = np.zeros(len(places_m), np.int64)
    np.add.at(turns, place, (up & right).astype(np.int64) - (down & right))
    return turns


def _is_convex(geometry: Geometry) -> bool:
    return not isinstance(geometry, Mesh | Polyline)


def _hull(points_m: Array) -> Array:
    """(n, 2) corners of the convex hull of points."""
    return np.asarray(cv2.convexHull(points_m.astype(np.float32))[:, 0], np.float64)
