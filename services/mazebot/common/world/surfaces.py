"""A world as textured triangles: the list that camera, viewer and preview draw."""

from __future__ import annotations

import bisect
import functools
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import Material, Plane, Shape, Thing, Wall, World
from mazebot.common.world.geometry import (
    TriangleMesh,
    flat_triangles,
    joined,
    polygons_of,
    quad_triangles,
    tiles,
    triangles_of,
)

FLOOR_SIDE_M = 100.0
"""Side of the floor, around the map's origin; it is larger if there are walls farther out."""

PLAIN = Material(name="", ambient=(0.5, 0.5, 0.5, 1.0), diffuse=(0.5, 0.5, 0.5, 1.0))
"""The floor material of a world that names none."""

_MARGIN_M = 20.0
_SAME_DIRECTION_RAD = 1.4e-4
"""Over 5 m, 0.7 mm."""
_SAME_PLANE_M = 1e-3
"""Faces closer than this count as one: from some 15 m on, a depth buffer cannot separate them."""
_SLIVER_M = 1e-6

_Stretch = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one material."""

    kind: Literal["wall", "floor", "ceiling", "body"]
    name: str
    """Name of its wall, room or body; empty for the world's floor and ceiling."""
    material: str
    """Name of a material of the world; empty: PLAIN."""
    moves: bool
    """Whether it belongs to a moving body: then the triangles are in its frame, else in the map's.
    """
    textured: bool
    """False for the tops of walls, which have their material's plain colour."""
    mesh: TriangleMesh


def surfaces(world: World, meshes: Mapping[str, TriangleMesh]) -> tuple[Surface, ...]:
    """Everything visible in a world, except markers and robot.

    Of coinciding faces of walls the higher one is drawn, and the first of equals. Coverings replace
    their section of a face, rooms' floors their part of the world's floor. Raises KeyError where a
    mesh is missing.
    """
    tile_of = {material.name: material.texture_side_m for material in world.materials}
    return (
        *_walls(world.walls, tile_of),
        *(
            surface
            for body in world.bodies
            for surface in body_surfaces(body, meshes, tile_of, moves=body.moves)
        ),
        *_floors(world, tile_of),
        *_ceiling(world, tile_of),
    )


def is_floor(body: Thing, shape: Shape) -> bool:
    """Whether a shape is a plane that lies on the floor, as SDF's ground planes do."""
    if body.moves or not isinstance(shape.geometry, Plane):
        return False
    map_from_shape = portable.product(pose_matrix(body), pose_matrix(shape))
    level = map_from_shape[2, 2] > 1.0 - 1e-6
    return bool(level and abs(map_from_shape[2, 3]) < _SAME_PLANE_M)


def body_surfaces(
    body: Thing, meshes: Mapping[str, TriangleMesh], tile_of: Mapping[str, float], moves: bool
) -> Iterator[Surface]:
    """The visible surfaces of a body, one a material; in its own frame if it moves."""
    seen: dict[str, list[TriangleMesh]] = {}
    map_from_body = np.eye(4) if moves else pose_matrix(body)
    for shape in body.shapes:
        if shape.material:
            tile_side_m = tile_of.get(shape.material, 1.0)
            mesh = triangles_of(shape.geometry, meshes, tile_side_m)
            seen.setdefault(shape.material, []).append(
                mesh.moved(portable.product(map_from_body, pose_matrix(shape)))
            )
    for material, parts in seen.items():
        yield Surface("body", body.name, material, moves, True, joined(parts))


def wall_corners(walls: Sequence[Wall]) -> Array:
    """(n, 4, 2) corners of the walls' footprints, counter-clockwise, in the map frame."""
    figures = _figures(walls)
    along = figures[:, 3:4] / 2.0 * _directions(figures)
    across = figures[:, 4:5] / 2.0 * (_directions(figures)[:, ::-1] * (-1.0, 1.0))
    centres = figures[:, :2]
    return np.stack(
        [
            centres + along + across,
            centres - along + across,
            centres - along - across,
            centres + along - across,
        ],
        axis=1,
    )


def _figures(walls: Sequence[Wall]) -> Array:
    """(n, 6): x, y, yaw, length, thickness, height."""
    return np.array(
        [(w.x_m, w.y_m, w.yaw_rad, w.length_m, w.thickness_m, w.height_m) for w in walls]
    ).reshape(-1, 6)


def _directions(figures: Array) -> Array:
    """(n, 2) unit vectors along the walls."""
    return np.stack(portable.cos_sin_each(figures[:, 2]), axis=1)


@dataclass(frozen=True, eq=False)
class _Sides:
    """The upright faces of walls, four each: front, back, left, right."""

    bottom_centres_m: Array
    """(n, 2)"""
    normals: Array
    """(n, 2)"""
    rights: Array
    """(n, 2): to the right, seen from the front of the face"""
    widths_m: Array
    heights_m: Array

    @classmethod
    def of(cls, figures: Array) -> _Sides:
        along = _directions(figures)
        left = np.stack((-along[:, 1], along[:, 0]), axis=1)
        normals = np.stack((along, -along, left, -left), axis=1)
        length, thickness = figures[:, 3], figures[:, 4]
        depths = np.stack((length, length, thickness, thickness), axis=1)
        widths = np.stack((thickness, thickness, length, length), axis=1)
        centres = figures[:, None, :2] + depths[:, :, None] / 2.0 * normals
        flat = normals.reshape(-1, 2)
        return cls(
            centres.reshape(-1, 2),
            flat,
            np.stack((-flat[:, 1], flat[:, 0]), axis=1),
            widths.ravel(),
            np.repeat(figures[:, 5], 4),
        )


def _walls(walls: Sequence[Wall], tile_of: Mapping[str, float]) -> Iterator[Surface]:
    if not walls:
        return
    figures = _figures(walls)
    sides = _Sides.of(figures)
    pieces = _uncovered(sides)
    looks: list[tuple[int, str]] = []
    """Wall and material of each surface."""
    counts: list[int] = []
    rows: list[tuple[int, float, float, float, float, float]] = []
    """Side, left and right end of the piece, left end and width of the texture, its tile."""
    for index, wall in enumerate(walls):
        own: list[tuple[int, float, float]] = []
        covered: dict[str, list[tuple[int, float, float, float, float]]] = {}
        for side in range(4 * index, 4 * index + 4):
            stretches = pieces[side]
            if wall.coverings and side % 4 >= 2:
                stretches = _without_coverings(wall, side, stretches, covered)
            own += [(side, left, right) for left, right in stretches]
        tile = tile_of.get(wall.material, 1.0)
        if own:
            looks.append((index, wall.material))
            counts.append(len(own))
            for side, left, right in own:
                width = float(sides.widths_m[side])
                rows.append((side, left, right, -width / 2.0, width, tile))
        for material, parts in covered.items():
            tile = tile_of.get(material, 1.0)
            looks.append((index, material))
            counts.append(len(parts))
            for side, left, right, low, width in parts:
                start = low if tile <= 0.0 else -float(sides.widths_m[side]) / 2.0
                rows.append((side, left, right, start, width, tile))
    upright = _upright(sides, np.array(rows).reshape(-1, 6))
    firsts = np.cumsum([0, *counts]).tolist()
    for (index, material), first, count in zip(looks, firsts, counts, strict=False):
        mesh = _quads(upright, first, count)
        yield Surface("wall", walls[index].name, material, False, True, mesh)
    tops = _tops(wall_corners(walls), figures[:, 5])
    for index, wall in enumerate(walls):
        mesh = _quads(tops, index, 1)
        yield Surface("wall", wall.name, wall.material, False, False, mesh)


def _without_coverings(
    wall: Wall,
    side: int,
    stretches: list[_Stretch],
    covered: dict[str, list[tuple[int, float, float, float, float]]],
) -> list[_Stretch]:
    """The uncovered parts of a face; the covered ones are added to `covered`, by material."""
    name, sign = ("left", -1.0) if side % 4 == 2 else ("right", 1.0)
    for covering in wall.coverings:
        if covering.side != name:
            continue
        ends = sorted((sign * covering.from_m, sign * covering.to_m))
        low, high = max(ends[0], -wall.length_m / 2.0), min(ends[1], wall.length_m / 2.0)
        if high - low <= _SLIVER_M:
            continue
        for left, right in stretches:
            start, end = max(left, low), min(right, high)
            if end - start > _SLIVER_M:
                row = (side, start, end, low, high - low)
                covered.setdefault(covering.material, []).append(row)
        stretches = _less(stretches, [(low, high)])
    return stretches


def _uncovered(sides: _Sides) -> list[list[_Stretch]]:
    """The sections of each face, from left to right, that no other face covers.

    Walls overlap where they meet, and two faces in one plane would cause z-fighting there. The
    higher face wins, and the earlier among equals.
    """
    halves = (sides.widths_m / 2.0).tolist()
    whole: list[list[_Stretch]] = [[(-half, half)] for half in halves]
    plane, along = _planes(sides)
    ranked = np.lexsort((np.arange(len(plane)), -sides.heights_m, plane))
    for members in np.split(ranked, np.flatnonzero(np.diff(plane[ranked])) + 1):
        # Sorted and disjoint.
        taken: list[_Stretch] = []
        for side in members.tolist() if len(members) > 1 else ():
            middle, half = along[side], halves[side]
            low, high = middle - half, middle + half
            first = bisect.bisect_left(taken, low, key=operator.itemgetter(1))
            end = bisect.bisect_right(taken, high, key=operator.itemgetter(0))
            near = taken[first:end]
            whole[side] = [
                (max(left - middle, -half), min(right - middle, half))
                for left, right in _less([(low, high)], near)
            ]
            taken[first:end] = [
                (min([low, *(n[0] for n in near)]), max([high, *(n[1] for n in near)]))
            ]
    return whole


def _planes(sides: _Sides) -> tuple[NDArray[np.int64], list[float]]:
    """The plane number of each face, (n,), and the position of its middle along that plane."""
    angles = portable.atan2_each(sides.normals[:, 1], sides.normals[:, 0])
    # Most faces point along an axis: the angles wrap where few faces point.
    angles = (angles + 0.1) % (2.0 * np.pi)
    by_angle = np.argsort(angles, kind="stable")
    steps = np.diff(angles[by_angle], prepend=-1.0) > _SAME_DIRECTION_RAD
    direction = np.empty(len(angles), np.int64)
    direction[by_angle] = np.cumsum(steps)
    normals = np.vstack((np.zeros((1, 2)), sides.normals[by_angle[steps]]))[direction]
    offsets = np.einsum("ij,ij->i", normals, sides.bottom_centres_m)
    ordered = np.lexsort((offsets, direction))
    parted = (np.diff(offsets[ordered], prepend=-np.inf) > _SAME_PLANE_M) | (
        np.diff(direction[ordered], prepend=0) > 0
    )
    plane = np.empty(len(angles), np.int64)
    plane[ordered] = np.cumsum(parted)
    rights = np.stack((-normals[:, 1], normals[:, 0]), axis=1)
    return plane, np.einsum("ij,ij->i", rights, sides.bottom_centres_m).tolist()


def _less(pieces: list[_Stretch], taken: list[_Stretch]) -> list[_Stretch]:
    """Pieces without the taken sections; slivers are dropped."""
    for low, high in taken:
        pieces = [
            part
            for left, right in pieces
            for part in ((left, min(right, low)), (max(left, high), right))
            if part[1] - part[0] > _SLIVER_M
        ]
        if not pieces:
            break
    return pieces


_Corners = tuple[Array, Array, Array]
"""Vertices, normals and uvs of rectangles, four rows each."""


def _upright(sides: _Sides, rows: Array) -> _Corners:
    side = rows[:, 0].astype(np.int64)
    left, right, start, width, tile = rows[:, 1:].T
    heights = sides.heights_m[side]
    low = [
        sides.bottom_centres_m[side] + end[:, None] * sides.rights[side] for end in (left, right)
    ]
    ground = np.zeros(len(rows))
    corners = [
        np.column_stack(corner)
        for corner in ((low[0], ground), (low[1], ground), (low[1], heights), (low[0], heights))
    ]
    ends = (np.maximum(left - start, 0.0), np.maximum(right - start, 0.0))
    uvs = tiles(ends[0], ends[1], heights, tile, width)
    normals = np.repeat(np.column_stack((sides.normals[side], ground)), 4, axis=0)
    return np.stack(corners, axis=1).reshape(-1, 3), normals, uvs.reshape(-1, 2)


def _tops(footprints: Array, heights_m: Array) -> _Corners:
    count = len(footprints)
    z = np.repeat(heights_m, 4)
    up = np.tile((0.0, 0.0, 1.0), (4 * count, 1))
    uvs = np.tile([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0]], (count, 1))
    return np.column_stack((footprints.reshape(-1, 2), z)), up, uvs


def _quads(corners: _Corners, first: int, count: int) -> TriangleMesh:
    rows = slice(4 * first, 4 * (first + count))
    vertices, normals, uvs = (array[rows] for array in corners)
    return TriangleMesh(vertices, normals, uvs, _triangles(count))


_triangles = functools.lru_cache(maxsize=64)(quad_triangles)


def _floors(world: World, tile_of: Mapping[str, float]) -> Iterator[Surface]:
    half = FLOOR_SIDE_M / 2.0
    corners = wall_corners(world.walls).reshape(-1, 2)
    low = np.min([*(corners - _MARGIN_M), (-half, -half)], axis=0).tolist()
    high = np.max([*(corners + _MARGIN_M), (half, half)], axis=0).tolist()
    rest = shapely.MultiPolygon([shapely.box(*low, *high)])
    # Ground planes are drawn as bodies.
    for body in world.bodies:
        for shape in body.shapes:
            if shape.material and is_floor(body, shape):
                mesh = triangles_of(shape.geometry, {})
                corners = mesh.moved(
                    portable.product(pose_matrix(body), pose_matrix(shape))
                ).vertices_m
                rest = rest - shapely.Polygon(corners[:, :2])
    for room in world.rooms:
        if room.floor_material:
            area = polygons_of([room.polygon_m])
            mesh = _level(rest & area, 0.0, True, tile_of.get(room.floor_material, 1.0))
            yield Surface("floor", room.name, room.floor_material, False, True, mesh)
            rest = rest - area
    if not rest.is_empty:
        mesh = _level(rest, 0.0, True, tile_of.get(world.floor_material, 1.0))
        yield Surface("floor", "", world.floor_material, False, True, mesh)


def _ceiling(world: World, tile_of: Mapping[str, float]) -> Iterator[Surface]:
    if world.ceiling is None or not world.walls:
        return
    corners = wall_corners(world.walls).reshape(-1, 2)
    area = shapely.box(*corners.min(0).tolist(), *corners.max(0).tolist())
    material = world.ceiling.material
    mesh = _level(area, world.ceiling.height_m, False, tile_of.get(material, 1.0))
    yield Surface("ceiling", "", material, False, True, mesh)


def _level(
    area: shapely.Geometry, height_m: float, seen_from_above: bool, tile_side_m: float
) -> TriangleMesh:
    """A level area; its tiles are laid from the map's origin, so that they continue next door."""
    polygons = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    if len(polygons) == 1 and shapely.equals(polygons[0], polygons[0].envelope):
        x, y, right, top = polygons[0].bounds
        points = np.array([[x, y], [right, y], [right, top], [x, top]])
        triangles = quad_triangles(1)
    else:
        points, triangles = flat_triangles(shapely.MultiPolygon(polygons))
    seen = points if seen_from_above else points * (1.0, -1.0)
    low, high = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(2), np.ones(2))
    if tile_side_m > 0.0:
        # Subtract whole tiles, since large coordinates are inexact.
        across = seen / tile_side_m
        across -= np.floor(low / tile_side_m)
        rows = np.ceil(high[1] / tile_side_m) - np.floor(low[1] / tile_side_m)
    else:
        across, rows = (seen - low) / (high - low), 1.0
    normals = np.zeros((len(points), 3))
    normals[:, 2] = 1.0 if seen_from_above else -1.0
    return TriangleMesh(
        np.column_stack((points, np.full(len(points), height_m))),
        normals,
        np.stack((across[:, 0], rows - across[:, 1]), axis=1),
        triangles if seen_from_above else triangles[:, ::-1],
    )
