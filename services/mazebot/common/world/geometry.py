"""Shapes as triangles: one description for visuals, collisions and the map."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Geometry,
    Mesh,
    Plane,
    Point2,
    Polyline,
    Sphere,
)

MAX_TRIANGLES = 2_000_000
MIN_SIDES, MAX_SIDES = 32, 128
"""Number of sides of round shapes."""

MAX_CROSSING_CORNERS = 100
"""Limit for a polygon that crosses itself: its crossings grow with the square of its corners."""

_SAGITTA_M = 0.002
"""Largest distance of a round body's flat sides from its true surface, if MAX_SIDES allow it."""
_QUAD = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
_DTYPES = {"vertices_m": "<f4", "normals": "<f4", "uvs": "<f4", "triangles": "<i4"}
_COLUMNS = {"vertices_m": 3, "normals": 3, "uvs": 2, "triangles": 3}


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles, counter-clockwise from outside; read-only."""

    vertices_m: Array
    """(n, 3)"""
    normals: Array
    """(n, 3), of unit length"""
    uvs: Array
    """(n, 2): (0, 0) is a texture's top left, (1, 1) its bottom right; beyond, it repeats."""
    triangles: NDArray[np.int32]
    """(m, 3)"""

    def __post_init__(self) -> None:
        for array in (self.vertices_m, self.normals, self.uvs, self.triangles):
            array.setflags(write=False)

    def moved(self, a_from_b: Array) -> TriangleMesh:
        """The mesh in another frame, by a rigid (4, 4) transform."""
        rotation = a_from_b[:3, :3]
        return TriangleMesh(
            portable.product(self.vertices_m, rotation.T) + a_from_b[:3, 3],
            portable.product(self.normals, rotation.T),
            self.uvs,
            self.triangles,
        )


def triangles_of(
    geometry: Geometry, meshes: Mapping[str, TriangleMesh], tile_side_m: float = 1.0
) -> TriangleMesh:
    """The surface of a shape in its own frame.

    `meshes` are by sha256, unscaled. `tile_side_m` is Material.texture_side_m. The surface is
    closed for every kind except planes and meshes; only a mesh may have negative uvs. Textures run
    in metres from a face's bottom left, on round shapes around from +x. Raises KeyError where a
    mesh is missing.
    """
    match geometry:
        case Box():
            return _box(geometry.size_m, tile_side_m)
        case Cylinder():
            return _cylinder(geometry.radius_m, geometry.length_m, tile_side_m)
        case Cone():
            return _cone(geometry.radius_m, geometry.length_m, tile_side_m)
        case Capsule():
            return _capsule(geometry.radius_m, geometry.length_m, tile_side_m)
        case Sphere():
            radius = geometry.radius_m
            return _ellipsoid((radius, radius, radius), tile_side_m)
        case Ellipsoid():
            return _ellipsoid(geometry.radii_m, tile_side_m)
        case Plane():
            x, y = geometry.size_m
            return _rectangles(
                np.zeros((1, 3)), np.array([[x / 2.0, 0, 0]]), np.array([[0, y / 2.0, 0]]),
                tile_side_m,
            )  # fmt: skip
        case Polyline():
            return _raised(polygons_of(geometry.polygons_m), geometry.height_m, tile_side_m)
        case Mesh():
            return _scaled(meshes[geometry.sha256], np.array(geometry.scale))


def joined(meshes: Iterable[TriangleMesh]) -> TriangleMesh:
    """Several surfaces in the same frame as one."""
    parts = list(meshes)
    if not parts:
        return TriangleMesh(
            np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3), np.int32)
        )
    firsts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    return TriangleMesh(
        np.concatenate([part.vertices_m for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.uvs for part in parts]),
        np.concatenate(
            [part.triangles + np.int32(first) for part, first in zip(parts, firsts, strict=False)]
        ),
    )


def polygons_of(rings_m: Iterable[Sequence[Point2]]) -> shapely.MultiPolygon:
    """The area within an odd number of closed polygons: one within another is a hole.

    Self-crossing polygons are split; those without an area are dropped. Raises ValueError, with a
    phrase, for a polygon that crosses itself with more than MAX_CROSSING_CORNERS.
    """
    areas: list[Any] = []
    for ring in rings_m:
        polygon = shapely.Polygon(ring) if len(ring) >= 3 else shapely.Polygon()
        if not polygon.is_valid:
            if len(ring) > MAX_CROSSING_CORNERS:
                raise ValueError(f"a polygon of {len(ring)} corners crosses itself")
            polygon = shapely.make_valid(polygon)
        areas.append(polygon)
    # In pairs, and pairs of pairs: one after the other would take quadratic time.
    while len(areas) > 1:
        rest = areas[len(areas) // 2 * 2 :]
        pairs = zip(areas[::2], areas[1::2], strict=False)
        areas = [first.symmetric_difference(second) for first, second in pairs] + rest
    parts = [part for area in areas for part in shapely.get_parts(area)]
    return shapely.MultiPolygon(
        [part for part in parts if part.geom_type == "Polygon" and part.area > 0.0]
    )


def flat_triangles(area: shapely.MultiPolygon) -> tuple[Array, NDArray[np.int32]]:
    """An area's triangulation: its corners, (n, 2), and triangles, (m, 3), counter-clockwise."""
    corners: list[Array] = []
    for part in area.geoms:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(part))
        rings = shapely.get_coordinates(shapely.get_exterior_ring(triangles)).reshape(-1, 4, 2)
        corners.append(rings[:, :3])
    if not corners:
        return np.zeros((0, 2)), np.zeros((0, 3), np.int32)
    triples = np.concatenate(corners)
    a, b, c = triples[:, 0], triples[:, 1], triples[:, 2]
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triples[turn < 0.0] = triples[turn < 0.0][:, ::-1]
    points, index = np.unique(triples[turn != 0.0].reshape(-1, 2), axis=0, return_inverse=True)
    return points, index.reshape(-1, 3).astype(np.int32)


def mesh_to_bytes(mesh: TriangleMesh) -> bytes:
    """The mesh as an asset: an uncompressed numpy .npz in single precision; the same bytes for the
    same mesh.
    """
    buffer = io.BytesIO()
    arrays = {name: getattr(mesh, name).astype(dtype) for name, dtype in _DTYPES.items()}
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def mesh_from_bytes(data: bytes) -> TriangleMesh:
    """The mesh in an asset.

    Raises ValueError with a short phrase where the data is invalid: wrong shapes or types, an index
    out of range, non-finite numbers, more than MAX_TRIANGLES.
    """
    try:
        arrays = _read_arrays(data)
    except _MeshFileError:
        raise
    except Exception as error:
        # On damaged files the readers of zip and numpy may raise any exception.
        raise ValueError("is not a mesh file") from error
    triangles = arrays.pop("triangles").astype(np.int32)
    vertices, normals, uvs = (array.astype(np.float64) for array in arrays.values())
    count = len(vertices)
    if len(triangles) > MAX_TRIANGLES:
        raise ValueError(f"has {len(triangles)} triangles: at most {MAX_TRIANGLES}")
    if not len(normals) == len(uvs) == count:
        raise ValueError("has different numbers of vertices, normals and uvs")
    if not all(np.isfinite(array).all() for array in (vertices, normals, uvs)):
        raise ValueError("contains a non-finite number")
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < count:
        raise ValueError("has a triangle with a nonexistent vertex")
    return TriangleMesh(vertices, normals, uvs, triangles)


def clipped(mesh: TriangleMesh, low_z_m: float, high_z_m: float) -> TriangleMesh:
    """The part of a surface between two heights; cut triangles keep normals and texture."""
    lowest, highest = _z_range(mesh)
    if low_z_m <= lowest and highest <= high_z_m:
        return mesh
    corners = np.concatenate((mesh.vertices_m, mesh.normals, mesh.uvs), axis=1)[mesh.triangles]
    corners = part_above(corners, corners[:, :, 2] - low_z_m)
    corners = part_above(corners, high_z_m - corners[:, :, 2])
    flat = corners.reshape(-1, 8)
    normals = flat[:, 3:6]
    lengths = portable.lengths(normals)[:, None]
    return TriangleMesh(
        flat[:, :3].copy(),
        normals / np.where(lengths > 0.0, lengths, 1.0),
        flat[:, 6:].copy(),
        np.arange(len(flat), dtype=np.int32).reshape(-1, 3),
    )


def _z_range(mesh: TriangleMesh) -> tuple[float, float]:
    z = mesh.vertices_m[:, 2]
    return (float(z.min()), float(z.max())) if len(z) else (0.0, 0.0)


def part_above(corners: Array, height: Array) -> Array:
    """(m, 3, k) triangles clipped to where a linear `height`, (m, 3), is not negative."""
    inside = height >= 0.0
    count = inside.sum(1)
    # Triangles that only touch the cut from below have no part above it.
    touches = (height > 0.0).any(1)
    one, two = (count == 1) & touches, (count == 2) & touches
    # Rotate the corners so that the one alone on its side comes first.
    lone = np.where(one, inside.argmax(1), (~inside).argmax(1))
    turn = (lone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[:, :, None], axis=1)
    height = np.take_along_axis(height, turn, axis=1)
    tips = corners[one | two]
    gap = height[one | two]
    a, b, c = tips[:, 0], tips[:, 1], tips[:, 2]
    ab = a + (b - a) * (gap[:, 0] / (gap[:, 0] - gap[:, 1]))[:, None]
    ac = a + (c - a) * (gap[:, 0] / (gap[:, 0] - gap[:, 2]))[:, None]
    is_tip = one[one | two]
    rest = ~is_tip
    pieces = [
        corners[count == 3],
        np.stack((a, ab, ac), axis=1)[is_tip],
        np.stack((ab, b, c), axis=1)[rest],
        np.stack((ab, c, ac), axis=1)[rest],
    ]
    return np.concatenate(pieces)


class _MeshFileError(ValueError):
    """A readable file that is not a mesh."""


def _read_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for name, dtype in _DTYPES.items():
            info = archive.getinfo(f"{name}.npy")
            # An uncompressed entry cannot be larger than the file that contains it.
            if info.compress_type != zipfile.ZIP_STORED or info.file_size > len(data):
                raise _MeshFileError("is compressed")
            with archive.open(info) as member:
                if np.lib.format.read_magic(member) != (1, 0):
                    raise _MeshFileError("has an unsupported numpy format")
                shape, by_columns, kind = np.lib.format.read_array_header_1_0(member)
                content = member.read()
            if kind != np.dtype(dtype) or by_columns or shape[1:] != (_COLUMNS[name],):
                raise _MeshFileError(f"{name}: is not (n, {_COLUMNS[name]}) of {dtype}")
            if len(content) != shape[0] * _COLUMNS[name] * kind.itemsize:
                raise _MeshFileError(f"{name}: is truncated")
            arrays[name] = np.frombuffer(content, kind).reshape(shape)
    return arrays


def _sides(radius_m: float) -> int:
    """Sides of a round body: a multiple of four, so that its width along x and y is exact."""
    ratio = min(_SAGITTA_M / radius_m, 1.0)
    return 4 * round(max(MIN_SIDES, min(MAX_SIDES, math.pi / portable.acos(1.0 - ratio))) / 4.0)


def _rectangles(
    centres: Array, half_rights: Array, half_ups: Array, tile_side_m: float
) -> TriangleMesh:
    """Flat rectangles, (n, 3) each, that face the side where `right` to `up` turns left."""
    corners = np.stack(
        (
            centres - half_rights - half_ups,
            centres + half_rights - half_ups,
            centres + half_rights + half_ups,
            centres - half_rights + half_ups,
        ),
        axis=1,
    )
    normals = np.cross(half_rights, half_ups)
    normals /= portable.lengths(normals)[:, None]
    widths = 2.0 * portable.lengths(half_rights)
    heights = 2.0 * portable.lengths(half_ups)
    zeros = np.zeros_like(widths)
    return TriangleMesh(
        corners.reshape(-1, 3),
        np.repeat(normals, 4, axis=0),
        tiles(zeros, widths, heights, tile_side_m, widths).reshape(-1, 2),
        quad_triangles(len(centres)),
    )


def tiles(
    lefts_m: Array, rights_m: Array, heights_m: Array, tile_side_m: float | Array, widths_m: Array
) -> Array:
    """Texture coordinates, (n, 4, 2), of sections of upright faces.

    Counter-clockwise from the bottom left; `lefts_m` and `rights_m`, (n,), are measured from the
    left end of a face `widths_m` wide. v counts down from a whole number, so that none is negative.
    With a tile side of 0 the texture is stretched over each face.
    """
    metric = np.broadcast_to(np.asarray(tile_side_m) > 0.0, lefts_m.shape)
    across = np.where(metric, tile_side_m, widths_m)
    up = heights_m / np.where(metric, tile_side_m, heights_m)
    left, right, bottom = lefts_m / across, rights_m / across, np.ceil(up)
    u = np.stack((left, right, right, left), axis=1)
    v = np.stack((bottom, bottom, bottom - up, bottom - up), axis=1)
    return np.stack((u, v), axis=2)


def quad_triangles(count: int) -> NDArray[np.int32]:
    """(2 count, 3) triangles of rectangles with four corners each, one after the other."""
    firsts = 4 * np.arange(count, dtype=np.int32)
    return np.asarray((firsts[:, None, None] + _QUAD).reshape(-1, 3), np.int32)


def _box(size_m: tuple[float, float, float], tile_side_m: float) -> TriangleMesh:
    x, y, z = (side / 2.0 for side in size_m)
    centres = np.array([[x, 0, 0], [-x, 0, 0], [0, y, 0], [0, -y, 0], [0, 0, z], [0, 0, -z]])
    rights = np.array([[0, y, 0], [0, -y, 0], [-x, 0, 0], [x, 0, 0], [x, 0, 0], [x, 0, 0]])
    ups = np.array([[0, 0, z], [0, 0, z], [0, 0, z], [0, 0, z], [0, y, 0], [0, -y, 0]])
    return _rectangles(centres, rights, ups, tile_side_m)


def _revolved(
    sides: int, radii_m: Array, heights_m: Array, slopes: Array, along_m: Array,
    around_m: float, tile_side_m: float,
) -> TriangleMesh:  # fmt: skip
    """The surface of revolution of a profile of (n,) points, from the bottom up, about z.

    `slopes`, (n, 2), are its normals outwards and upwards, `along_m` the lengths along it,
    `around_m` the circumference along which the texture is laid.
    """
    angles = 2.0 * math.pi * np.arange(sides) / sides
    # The last column repeats the first one bit for bit, with texture coordinates one turn further.
    columns = np.arange(sides + 1) % sides
    cos, sin = (values[columns] for values in portable.cos_sin_each(angles))
    flat = np.stack((cos, sin), axis=1)
    upright = np.broadcast_to(heights_m[:, None, None], (len(heights_m), sides + 1, 1))
    vertices = np.concatenate((radii_m[:, None, None] * flat, upright), axis=2)
    rising = np.broadcast_to(slopes[:, None, 1:], upright.shape)
    normals = np.concatenate((slopes[:, None, :1] * flat, rising), axis=2)
    share = np.arange(sides + 1) / sides
    length = float(along_m[-1])
    if tile_side_m <= 0.0:
        u, v = share, 1.0 - along_m / length
    else:
        u = share * around_m / tile_side_m
        v = math.ceil(length / tile_side_m) - along_m / tile_side_m
    uvs = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=2)
    row, column = np.divmod(np.arange((len(radii_m) - 1) * sides), sides)
    low = row * (sides + 1) + column
    high = low + sides + 1
    triangles = np.concatenate(
        (
            np.stack((low, low + 1, high + 1), axis=1)[radii_m[row] > 0.0],
            np.stack((low, high + 1, high), axis=1)[radii_m[row + 1] > 0.0],
        )
    )
    return TriangleMesh(
        vertices.reshape(-1, 3),
        normals.reshape(-1, 3),
        uvs.reshape(-1, 2),
        triangles.astype(np.int32),
    )


def _disc(sides: int, radius_m: float, z_m: float, up: bool, tile_side_m: float) -> TriangleMesh:
    angles = 2.0 * math.pi * np.arange(sides) / sides
    rim = np.stack(portable.cos_sin_each(angles), axis=1) * radius_m
    points = np.concatenate((np.zeros((1, 2)), rim))
    vertices = np.column_stack((points, np.full(sides + 1, z_m)))
    normals = np.zeros((sides + 1, 3))
    normals[:, 2] = 1.0 if up else -1.0
    first = 1 + np.arange(sides)
    second = 1 + (np.arange(sides) + 1) % sides
    ends = (first, second) if up else (second, first)
    triangles = np.stack((np.zeros(sides, int), *ends), axis=1)
    return TriangleMesh(
        vertices, normals, _flat_uvs(points, up, tile_side_m), triangles.astype(np.int32)
    )


def _flat_uvs(points: Array, up: bool, tile_side_m: float) -> Array:
    """Texture coordinates of level points, (n, 2), from the lower left of their bounding box."""
    seen = points if up else points * (1.0, -1.0)
    low, high = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(2), np.ones(2))
    across = seen - low
    if tile_side_m <= 0.0:
        across = across / (high - low)
        return np.stack((across[:, 0], 1.0 - across[:, 1]), axis=1)
    bottom = math.ceil(float(high[1] - low[1]) / tile_side_m)
    return np.stack((across[:, 0] / tile_side_m, bottom - across[:, 1] / tile_side_m), axis=1)


def _cylinder(radius_m: float, length_m: float, tile_side_m: float) -> TriangleMesh:
    sides, half = _sides(radius_m), length_m / 2.0
    return joined(
        (
            _revolved(
                sides, np.full(2, radius_m), np.array([-half, half]),
                np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([0.0, length_m]),
                2.0 * math.pi * radius_m, tile_side_m,
            ),
            _disc(sides, radius_m, half, True, tile_side_m),
            _disc(sides, radius_m, -half, False, tile_side_m),
        )
    )  # fmt: skip


def _cone(radius_m: float, length_m: float, tile_side_m: float) -> TriangleMesh:
    sides, half, slant = _sides(radius_m), length_m / 2.0, math.hypot(radius_m, length_m)
    slope = [length_m / slant, radius_m / slant]
    return joined(
        (
            _revolved(
                sides, np.array([radius_m, 0.0]), np.array([-half, half]),
                np.array([slope, slope]), np.array([0.0, slant]),
                2.0 * math.pi * radius_m, tile_side_m,
            ),
            _disc(sides, radius_m, -half, False, tile_side_m),
        )
    )  # fmt: skip


def _capsule(radius_m: float, length_m: float, tile_side_m: float) -> TriangleMesh:
    sides, half = _sides(radius_m), length_m / 2.0
    cos, sin = _quarter(sides // 4)
    out, up = np.concatenate((cos[::-1], cos)), np.concatenate((-sin[::-1], sin))
    centres = np.repeat([-half, half], len(cos))
    arc = radius_m * math.pi / 2.0 * np.arange(len(cos)) / (len(cos) - 1)
    along = np.concatenate((arc, arc + arc[-1] + length_m))
    return _revolved(
        sides, radius_m * out, centres + radius_m * up, np.stack((out, up), axis=1), along,
        2.0 * math.pi * radius_m, tile_side_m,
    )  # fmt: skip


def _ellipsoid(radii_m: tuple[float, float, float], tile_side_m: float) -> TriangleMesh:
    a, b, c = radii_m
    sides = _sides(max(radii_m))
    cos, sin = _quarter(sides // 4)
    out, up = np.concatenate((cos[:0:-1], cos)), np.concatenate((-sin[:0:-1], sin))
    # The texture is sized by a spheroid's equator, and by the mean quarter of its meridians.
    girth_m = 2.0 * math.pi * math.sqrt((a * a + b * b) / 2.0)
    meridian_m = math.pi * math.sqrt(((a * a + b * b) / 2.0 + c * c) / 2.0)
    along = meridian_m * np.arange(len(out)) / (len(out) - 1)
    ball = _revolved(sides, out, up, np.stack((out, up), axis=1), along, girth_m, tile_side_m)
    return _scaled(ball, np.array(radii_m))


def _quarter(steps: int) -> tuple[Array, Array]:
    """Cosine and sine from 0 to 90 degrees, exact at both ends."""
    angles = math.pi / 2.0 * np.arange(steps + 1) / steps
    cos, sin = portable.cos_sin_each(angles)
    cos[-1] = 0.0
    return cos, sin


def _scaled(mesh: TriangleMesh, scale: Array) -> TriangleMesh:
    normals = mesh.normals / scale
    lengths = portable.lengths(normals)[:, None]
    mirrored = bool(scale.prod() < 0.0)
    return TriangleMesh(
        mesh.vertices_m * scale,
        normals / np.where(lengths > 0.0, lengths, 1.0),
        mesh.uvs,
        mesh.triangles[:, ::-1] if mirrored else mesh.triangles,
    )


def _raised(area: shapely.MultiPolygon, height_m: float, tile_side_m: float) -> TriangleMesh:
    """An area extruded from z = 0, with its bottom face."""
    points, triangles = flat_triangles(area)
    count = len(points)
    parts = []
    for z_m, up in ((height_m, True), (0.0, False)):
        normals = np.zeros((count, 3))
        normals[:, 2] = 1.0 if up else -1.0
        parts.append(
            TriangleMesh(
                np.column_stack((points, np.full(count, z_m))),
                normals,
                _flat_uvs(points, up, tile_side_m),
                triangles if up else triangles[:, ::-1],
            )
        )
    for part in shapely.orient_polygons(shapely.get_parts(area)):
        parts += [_fence(ring, height_m, tile_side_m) for ring in (part.exterior, *part.interiors)]
    return joined(parts)


def _fence(ring: shapely.LinearRing, height_m: float, tile_side_m: float) -> TriangleMesh:
    """The upright faces along a ring that has the solid on its left."""
    points = shapely.get_coordinates(ring)
    starts, ends = points[:-1], points[1:]
    lengths = portable.lengths(ends - starts)
    starts, ends, lengths = starts[lengths > 0], ends[lengths > 0], lengths[lengths > 0]
    low, high = np.zeros(len(starts)), np.full(len(starts), height_m)
    corners = np.stack(
        [
            np.column_stack(corner)
            for corner in ((starts, low), (ends, low), (ends, high), (starts, high))
        ],
        axis=1,
    )
    normals = np.column_stack(
        ((ends - starts)[:, 1] / lengths, -(ends - starts)[:, 0] / lengths, low)
    )
    far = np.cumsum(lengths)
    near = far - lengths
    uvs = tiles(near, far, high, tile_side_m, lengths)
    if tile_side_m <= 0.0:
        uvs[:, :, 0] -= (near / lengths)[:, None]
    return TriangleMesh(
        corners.reshape(-1, 3),
        np.repeat(normals, 4, axis=0),
        uvs.reshape(-1, 2),
        quad_triangles(len(starts)),
    )
