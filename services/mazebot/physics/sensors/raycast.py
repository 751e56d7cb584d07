"""Exact ray casting of a planar scan against solids; only rays that can hit a solid are tested.

All rays start in one point and lie in one plane. So a solid with flat faces is cut by the plane
into line segments, which are intersected in 2D, and a round one is intersected in 3D by the rays
within the angle that its bounding sphere covers. The hits do not depend on the order of the
solids. A convex solid is hit from outside only, a surface of triangles from both sides.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.physics.bodies.collision import Solid, hull_triangles

_Vector = tuple[float, float, float]
_Row = tuple[float, float, float, float]

_CONVEX, _SURFACE, _SPHERE, _CYLINDER, _CAPSULE, _ELLIPSOID = range(6)
_ROUND = {"sphere": _SPHERE, "cylinder": _CYLINDER, "capsule": _CAPSULE, "ellipsoid": _ELLIPSOID}
_FACES_A_BLOCK = 16
"""Neighbouring triangles of a surface that are tested together or not at all."""
_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_BOX_FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], np.int32
)


@dataclass(frozen=True, eq=False)
class RayTargets:
    """Solids prepared for ray casting: blocks, each with a bounding box and a bounding sphere.

    A block is a run of faces, or one round solid. All coordinates are in the frame of its group.
    """

    kinds: NDArray[np.int32]
    """(b,)"""
    groups: NDArray[np.int32]
    """(b,), the index of the frame that a block moves with"""
    bounds_m: Array
    """(b, 7), of a block's bounding box, along the axes of its group, and bounding sphere: centre,
    half extents, radius
    """
    rounds_m: Array
    """(b, 9), of a round solid: its axis, of unit length, its radius and half its length; of an
    ellipsoid the rows of the (3, 3) matrix that makes it a ball of radius 1
    """
    faces: NDArray[np.int32]
    """(b, 2), of the others: the first face, and the one after the last"""
    corners: NDArray[np.int32]
    """(f, 4) convex faces by their corners, counter-clockwise as seen from outside; a triangle
    repeats the last one
    """
    vertices_m: Array
    """(v, 3)"""


def targets_of(solids: Sequence[Solid]) -> RayTargets:
    """Ray targets of the solids of one group."""
    boxes = [solid for solid in solids if solid.kind == "box"]
    rounds = [solid for solid in solids if solid.kind in _ROUND]
    parts = [_boxes(boxes), _rounds(rounds)]
    for solid in solids:
        if solid.kind in ("hull", "triangles"):
            parts.append(_triangles(solid))
    return joined((part, 0) for part in parts)


def joined(parts: Iterable[tuple[RayTargets, int]]) -> RayTargets:
    """Several ray targets joined into one, each with the index of its group."""
    each = list(parts) or [(_blocks(0), 0)]
    vertices = np.cumsum([0] + [len(part.vertices_m) for part, _ in each])
    faces = np.cumsum([0] + [len(part.corners) for part, _ in each])
    return RayTargets(
        np.concatenate([part.kinds for part, _ in each]),
        np.concatenate([part.groups + np.int32(group) for part, group in each]),
        np.concatenate([part.bounds_m for part, _ in each]),
        np.concatenate([part.rounds_m for part, _ in each]),
        np.concatenate([p.faces + np.int32(n) for (p, _), n in zip(each, faces, strict=False)]),
        np.concatenate(
            [p.corners + np.int32(n) for (p, _), n in zip(each, vertices, strict=False)]
        ),
        np.concatenate([part.vertices_m for part, _ in each]),
    )


def cast_scan(
    targets: RayTargets,
    scan_from_groups: Array,
    directions: Array,
    range_max_m: float,
) -> Array:
    """Distance of the first hit of each ray of a turn, (n,) m; inf beyond `range_max_m`.

    `directions` holds (n, 2) cosine and sine of the angles k * 2 pi / n in the plane z = 0 of the
    scan's frame, and `scan_from_groups` the (g, 4, 4) poses of the groups in it.
    """
    ranges = np.full(len(directions), np.inf)
    _cast(
        targets.kinds,
        targets.groups,
        targets.bounds_m,
        targets.rounds_m,
        targets.faces,
        targets.corners,
        targets.vertices_m,
        np.ascontiguousarray(scan_from_groups),
        directions,
        range_max_m,
        ranges,
    )
    return ranges


def compile_kernels() -> None:
    """Compile the kernels before the first scan."""
    cast_scan(joined(()), np.eye(4)[None], ray_directions(1), 1.0)


def ray_directions(samples: int) -> Array:
    """(n, 2) cosines and sines of a turn's angles, from straight ahead to the left."""
    angles = np.arange(samples) * (2.0 * math.pi / samples)
    return np.ascontiguousarray(np.stack(portable_kernels.cos_sin_each(angles), axis=1))


def _blocks(
    count: int,
    kinds: NDArray[np.int32] | None = None,
    bounds_m: Array | None = None,
    rounds_m: Array | None = None,
    faces: NDArray[np.int32] | None = None,
    corners: NDArray[np.int32] | None = None,
    vertices_m: Array | None = None,
) -> RayTargets:
    return RayTargets(
        np.zeros(count, np.int32) if kinds is None else kinds,
        np.zeros(count, np.int32),
        np.zeros((count, 7)) if bounds_m is None else bounds_m,
        np.zeros((count, 9)) if rounds_m is None else rounds_m,
        np.zeros((count, 2), np.int32) if faces is None else faces,
        np.zeros((0, 4), np.int32) if corners is None else corners,
        np.zeros((0, 3)) if vertices_m is None else vertices_m,
    )


def _boxes(boxes: Sequence[Solid]) -> RayTargets:
    count = len(boxes)
    poses = np.array([box.body_from_solid for box in boxes]).reshape(count, 4, 4)
    halves = np.array([box.half_extents_m for box in boxes]).reshape(count, 3)
    local = _BOX_CORNERS * halves[:, None]
    vertices = portable.product(local, poses[:, :3, :3].transpose(0, 2, 1)) + poses[:, None, :3, 3]
    numbers = np.arange(count, dtype=np.int32)
    return _blocks(
        count,
        bounds_m=np.column_stack(
            (
                poses[:, :3, 3],
                np.einsum("bij,bj->bi", np.abs(poses[:, :3, :3]), halves),
                portable.lengths(halves),
            )
        ),
        faces=np.stack((6 * numbers, 6 * numbers + 6), axis=1).astype(np.int32),
        corners=(_BOX_FACES + 8 * numbers[:, None, None]).reshape(-1, 4).astype(np.int32),
        vertices_m=vertices.reshape(-1, 3),
    )


def _rounds(solids: Sequence[Solid]) -> RayTargets:
    count = len(solids)
    kinds = np.array([_ROUND[solid.kind] for solid in solids], np.int32)
    poses = np.array([solid.body_from_solid for solid in solids]).reshape(count, 4, 4)
    radii = np.array([solid.radius_m for solid in solids])
    halves = np.array([solid.length_m / 2.0 for solid in solids])
    sides = np.array([solid.half_extents_m for solid in solids]).reshape(count, 3)
    ends = (radii, portable.hypot_each(radii, halves), radii + halves, sides.max(axis=1, initial=0))
    reach = np.choose(kinds - _SPHERE, ends)
    balls = poses[:, :3, :3].transpose(0, 2, 1) / sides[:, :, None]
    sizes = np.column_stack((poses[:, :3, 2], radii, halves, np.zeros((count, 4))))
    return _blocks(
        count,
        kinds,
        bounds_m=np.column_stack((poses[:, :3, 3], reach, reach, reach, reach)),
        rounds_m=np.where((kinds == _ELLIPSOID)[:, None], balls.reshape(count, 9), sizes),
    )


def _triangles(solid: Solid) -> RayTargets:
    """A hull or a surface, in blocks of neighbours."""
    points = solid.vertices_m if solid.vertices_m is not None else np.zeros((0, 3))
    triangles = solid.triangles
    if triangles is None:
        triangles = hull_triangles(points)
        inwards = portable.determinants(points[triangles] - points.mean(axis=0)) < 0.0
        triangles[inwards] = triangles[inwards][:, ::-1]
    pose = solid.body_from_solid
    vertices = portable.product(points, pose[:3, :3].T) + pose[:3, 3]
    triangles = triangles[_along_a_curve(vertices[triangles].mean(axis=1))]
    first = np.arange(0, len(triangles), _FACES_A_BLOCK)
    corners = vertices[triangles]
    low = np.minimum.reduceat(corners.min(axis=1), first)
    high = np.maximum.reduceat(corners.max(axis=1), first)
    halves = (high - low) / 2.0
    kind = _CONVEX if solid.kind == "hull" else _SURFACE
    return _blocks(
        len(first),
        np.full(len(first), kind, np.int32),
        bounds_m=np.column_stack((low + halves, halves, portable.lengths(halves))),
        faces=np.stack((first, np.append(first[1:], len(triangles))), axis=1).astype(np.int32),
        corners=triangles[:, [0, 1, 2, 2]].astype(np.int32),
        vertices_m=vertices,
    )


def _along_a_curve(points: Array) -> NDArray[np.int64]:
    """(n,) order in which successive points are near each other: Morton's (1966)."""
    extent = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cells = ((points - points.min(axis=0)) / extent * 1023.0).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


@kernel()
def _cast(
    kinds: NDArray[np.int32],
    groups: NDArray[np.int32],
    bounds_m: Array,
    rounds_m: Array,
    faces: NDArray[np.int32],
    corners: NDArray[np.int32],
    vertices_m: Array,
    scan_from_groups: Array,
    directions: Array,
    range_max_m: float,
    ranges: Array,
) -> None:
    for block in range(kinds.size):
        group = groups[block]
        rows = (
            _row(scan_from_groups, group, 0),
            _row(scan_from_groups, group, 1),
            _row(scan_from_groups, group, 2),
        )
        centre = bounds_m[block, 0], bounds_m[block, 1], bounds_m[block, 2]
        z = _coordinate(rows[2], centre)
        thick = (
            abs(rows[2][0]) * bounds_m[block, 3]
            + abs(rows[2][1]) * bounds_m[block, 4]
            + abs(rows[2][2]) * bounds_m[block, 5]
        )
        # With a tolerance, for a block that just touches the plane.
        if abs(z) > thick + 1e-9:
            continue
        # The plane cuts the sphere around the block in a circle of this radius.
        reach = math.sqrt(max(bounds_m[block, 6] * bounds_m[block, 6] - z * z, 0.0))
        x, y = _coordinate(rows[0], centre), _coordinate(rows[1], centre)
        away = math.sqrt(x * x + y * y)
        if away - reach > range_max_m:
            continue
        if kinds[block] <= _SURFACE:
            convex = kinds[block] == _CONVEX
            for face in range(faces[block, 0], faces[block, 1]):
                _meet_face(
                    *(rows, vertices_m, corners, face, convex),
                    *(directions, range_max_m, ranges),
                )
        elif kinds[block] == _ELLIPSOID:
            _meet_ellipsoid(
                *(rows, rounds_m, block, (x, y, z), (away, reach)),
                *(directions, range_max_m, ranges),
            )
        else:
            along = rounds_m[block, 0], rounds_m[block, 1], rounds_m[block, 2]
            axis = (
                _coordinate(rows[0], along) - rows[0][3],
                _coordinate(rows[1], along) - rows[1][3],
                _coordinate(rows[2], along) - rows[2][3],
            )
            size = rounds_m[block, 3], rounds_m[block, 4]
            _meet_round(
                *(kinds[block], (x, y, z), axis, size, (away, reach)),
                *(directions, range_max_m, ranges),
            )


@kernel(inline="always")
def _row(poses: Array, group: int, row: int) -> _Row:
    return poses[group, row, 0], poses[group, row, 1], poses[group, row, 2], poses[group, row, 3]


@kernel(inline="always")
def _coordinate(row: _Row, point: _Vector) -> float:
    """One coordinate of a point of a group in the frame of the scan."""
    return row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]


@kernel(inline="always")
def _vertex(vertices_m: Array, corners: NDArray[np.int32], face: int, corner: int) -> _Vector:
    index = corners[face, corner]
    return vertices_m[index, 0], vertices_m[index, 1], vertices_m[index, 2]


@kernel()
def _meet_face(
    rows: tuple[_Row, _Row, _Row],
    vertices_m: Array,
    corners: NDArray[np.int32],
    face: int,
    convex: bool,
    directions: Array,
    range_max_m: float,
    ranges: Array,
) -> None:
    """Cut a convex face with the plane, and intersect the rays with the resulting segment."""
    x0 = y0 = x1 = y1 = 0.0
    cuts = 0
    before = _vertex(vertices_m, corners, face, 3)
    z_before = _coordinate(rows[2], before)
    for corner in range(4):
        after = _vertex(vertices_m, corners, face, corner)
        z_after = _coordinate(rows[2], after)
        # An end in the plane counts as above it, so that a face is cut twice or not at all.
        if (z_before < 0.0) != (z_after < 0.0):
            # From the lower end, so that two faces cut their common edge in the very same point.
            low, high, z_low, z_high = before, after, z_before, z_after
            if z_after < 0.0:
                low, high, z_low, z_high = after, before, z_after, z_before
            share = z_low / (z_low - z_high)
            point = (
                low[0] + share * (high[0] - low[0]),
                low[1] + share * (high[1] - low[1]),
                low[2] + share * (high[2] - low[2]),
            )
            x = _coordinate(rows[0], point)
            y = _coordinate(rows[1], point)
            if z_after < 0.0:
                x1, y1 = x, y
            else:
                x0, y0 = x, y
            cuts += 1
        before, z_before = after, z_after
    # Seen from outside, the upward edge of a face is to the right of the downward one.
    if cuts == 2 and not (convex and x0 * y1 <= x1 * y0):
        _meet_segment(x0, y0, x1, y1, directions, range_max_m, ranges)


@kernel()
def _meet_segment(
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    directions: Array,
    range_max_m: float,
    ranges: Array,
) -> None:
    cross = x0 * y1 - x1 * y0
    if cross < 0.0:
        x0, y0, x1, y1, cross = x1, y1, x0, y0, -cross
    along_x, along_y = x1 - x0, y1 - y0
    length_squared = along_x * along_x + along_y * along_y
    # Seen edge-on; or its whole line is out of range.
    if cross <= 1e-15 or cross * cross > range_max_m * range_max_m * length_squared:
        return
    rays = len(directions)
    per_rad = rays / (2.0 * math.pi)
    start = portable_kernels.atan2(y0, x0)
    spread = portable_kernels.atan2(cross, x0 * x1 + y0 * y1)
    # A ray through the end of two segments must not slip through between them.
    first = math.ceil(start * per_rad - 1e-9)
    last = math.floor((start + spread) * per_rad + 1e-9)
    if last < first:
        return
    # With a tolerance, so that the nearest hit does not depend on the order.
    nearly = cross * (1.0 - 1e-12)
    farthest = math.sqrt(max(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1))
    ray = first if first >= 0 else first + rays
    for _ in range(last - first + 1):
        if ray >= rays:
            ray -= rays
        across = directions[ray, 0] * along_y - directions[ray, 1] * along_x
        # Divide only if the ray has no nearer hit so far.
        if nearly < across * ranges[ray]:
            distance = min(cross / across, farthest)
            if distance < ranges[ray] and distance <= range_max_m:
                ranges[ray] = distance
        ray += 1


@kernel()
def _meet_round(
    kind: int,
    centre: _Vector,
    axis: _Vector,
    size: tuple[float, float],
    seen: tuple[float, float],
    directions: Array,
    range_max_m: float,
    ranges: Array,
) -> None:
    """Intersect a round solid with the rays within the angle of its bounding sphere."""
    rays = len(directions)
    radius, half = size
    first, last = _rays_within(centre, seen, rays)
    # Points on a ray, seen from the solid's centre, are o + t u: o = -centre, u has no z.
    square = centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2]
    start = -(centre[0] * axis[0] + centre[1] * axis[1] + centre[2] * axis[2])
    for index in range(first, last + 1):
        ray = index % rays
        ux, uy = directions[ray, 0], directions[ray, 1]
        slope = ux * axis[0] + uy * axis[1]
        forward = -(ux * centre[0] + uy * centre[1])
        enter = math.inf
        if kind != _CYLINDER:
            ends = half if kind == _CAPSULE else 0.0
            for end in (-ends, ends):
                # From the centre of the ball at this end of the axis.
                b = forward - end * slope
                c = square - 2.0 * end * start + end * end - radius * radius
                under = b * b - c
                if under >= 0.0:
                    enter = min(enter, -b - math.sqrt(under))
        if kind != _SPHERE:
            a = 1.0 - slope * slope
            b = forward - start * slope
            c = square - start * start - radius * radius
            low, high = -math.inf, math.inf
            if a > 1e-12:
                under = b * b - a * c
                if under < 0.0:
                    low, high = math.inf, -math.inf
                else:
                    root = math.sqrt(under)
                    low, high = (-b - root) / a, (-b + root) / a
            elif c > 0.0:
                low, high = math.inf, -math.inf
            if abs(slope) > 1e-12:
                one, other = (-half - start) / slope, (half - start) / slope
                low, high = max(low, min(one, other)), min(high, max(one, other))
            elif abs(start) > half:
                low, high = math.inf, -math.inf
            if low <= high:
                enter = min(enter, low)
        if 0.0 <= enter <= range_max_m and enter < ranges[ray]:
            ranges[ray] = enter


@kernel()
def _meet_ellipsoid(
    rows: tuple[_Row, _Row, _Row],
    rounds_m: Array,
    block: int,
    centre: _Vector,
    seen: tuple[float, float],
    directions: Array,
    range_max_m: float,
    ranges: Array,
) -> None:
    """Intersect an ellipsoid with the rays within the angle of its bounding sphere, as a ball of
    radius 1 in coordinates that make it one.
    """
    rays = len(directions)
    first, last = _rays_within(centre, seen, rays)
    ball = rounds_m[block]
    for index in range(first, last + 1):
        ray = index % rays
        ux, uy = directions[ray, 0], directions[ray, 1]
        # Points on a ray, seen from the centre, are o + t u: o = -centre, u has no z.
        a = b = 0.0
        c = -1.0
        for axis in range(3):
            along = ball[3 * axis], ball[3 * axis + 1], ball[3 * axis + 2]
            # A row of the matrix, along the axes of the scan.
            x = _coordinate(rows[0], along) - rows[0][3]
            y = _coordinate(rows[1], along) - rows[1][3]
            z = _coordinate(rows[2], along) - rows[2][3]
            u = ux * x + uy * y
            o = -(centre[0] * x + centre[1] * y + centre[2] * z)
            a += u * u
            b += o * u
            c += o * o
        under = b * b - a * c
        if under >= 0.0:
            enter = (-b - math.sqrt(under)) / a
            if 0.0 <= enter <= range_max_m and enter < ranges[ray]:
                ranges[ray] = enter


@kernel(inline="always")
def _rays_within(centre: _Vector, seen: tuple[float, float], rays: int) -> tuple[int, int]:
    """First and last ray of those that may meet a ball, `seen` in the plane: its distance and its
    radius.
    """
    per_rad = rays / (2.0 * math.pi)
    away, reach = seen
    if away <= reach:
        return 0, rays - 1
    middle = portable_kernels.atan2(centre[1], centre[0])
    spread = portable_kernels.asin(reach / away)
    first = math.ceil((middle - spread) * per_rad - 1e-9)
    return first, math.floor((middle + spread) * per_rad + 1e-9)
