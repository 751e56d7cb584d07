"""A mesh as convex parts: what a physics engine needs of a body that moves."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Mesh, Thing
from mazebot.common.world.convex.loose_triangles import (
    SAME_M,
    caps_of,
    connected,
    different,
    first_of_each,
    hull_of,
    in_order,
    normals_of,
    numbered,
    side_of,
)
from mazebot.common.world.geometry import TriangleMesh

MAX_PARTS = 32
"""Of one mesh"""
MAX_PIECES = 200
"""Of a moving body: PyBullet takes a second for the hulls of so many."""
_MAX_COMPONENTS = 200
_MAX_CUT_TRIANGLES = 20_000
"""A component with more keeps its convex hull: cutting it would take more than a few seconds."""
_THIN_M = 0.005
"""Thickness given to a flat part: Bullet's margin is 1 mm and more."""
_EXCESS = 0.1
"""Share of a part's volume that may be outside of the mesh."""
_LEAST_EXCESS = 0.001
"""The same, as a share of the volume of the mesh's convex hull."""
_ROUGH = 0.1
"""The share of all parts together that is told of."""
_PLANES = 2, 6
"""For each direction at least and at most, fewer the more triangles there are."""
_WIDE = 0.05
"""A face with this share of a part's area gives a direction for planes to try."""
_MAX_TRIED = 400
"""Triangles of a part by which planes are compared: half of them the widest."""


class Parts(tuple[Array, ...]):
    """(n, 3) points of each convex part, whose hull it is."""

    excess: float
    """Share of their volume that is outside of the mesh, 0 .. 1"""


@functools.lru_cache(maxsize=128)
def convex_parts(
    mesh: TriangleMesh,
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    most: int = MAX_PARTS,
) -> Parts:
    """The convex parts of a mesh, at most `most`; one, if it is convex. Cached.

    Its connected components first; those that leave much of their convex hulls empty are cut by
    planes, the worst first, until no part does. An opening of a surface counts as closed. Raises
    ValueError, in a phrase, if the mesh is flat, empty or tiny.
    """
    vertices = mesh.vertices_m * np.array(scale)
    whole_m3 = float(hull_of(vertices[np.unique(mesh.triangles)]).volume)
    parts = _components(vertices, mesh.triangles, most)
    if not parts:
        raise ValueError(f"is within {SAME_M:g} m: it must have a volume")
    for part in parts:
        if len(part.corners_m) > _MAX_CUT_TRIANGLES:
            part.excess_m3 = 0.0
    while len(parts) < most:
        worst = max(parts, key=lambda part: part.excess_m3)
        if worst.excess_m3 <= max(_EXCESS * worst.hull_m3, _LEAST_EXCESS * whole_m3):
            break
        halves = _halves(worst)
        if not halves:
            worst.excess_m3 = 0.0
            continue
        index = parts.index(worst)
        parts[index : index + 1] = halves
    total_m3 = sum(part.hull_m3 for part in parts)
    own_m3 = sum(min(part.own_m3, part.hull_m3) for part in parts)
    found = Parts(part.points_m for part in parts)
    found.excess = 1.0 - own_m3 / total_m3
    return found


def most_parts(body: Thing) -> int:
    """How many parts each mesh of a body may have."""
    meshes = sum(isinstance(shape.geometry, Mesh) and shape.solid for shape in body.shapes)
    others = len(body.shapes) - meshes
    return max(1, min(MAX_PARTS, (MAX_PIECES - others) // max(meshes, 1)))


def rough_text(bodies: Iterable[Thing], meshes: Mapping[str, TriangleMesh]) -> str:
    """The first moving body with convex parts that fill much more than its mesh does, and how many
    more there are, in one line; empty, if there are none.
    """
    found = [text for body in bodies if body.moves for text in _rough_shapes(body, meshes)]
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return found[0] + more if found else ""


def _rough_shapes(body: Thing, meshes: Mapping[str, TriangleMesh]) -> Iterator[str]:
    for shape in body.shapes:
        geometry = shape.geometry
        if not (shape.solid and isinstance(geometry, Mesh) and geometry.sha256 in meshes):
            continue
        try:
            parts = convex_parts(meshes[geometry.sha256], geometry.scale, most_parts(body))
        except ValueError:
            # It is refused for that elsewhere.
            continue
        if parts.excess > _ROUGH:
            count = f"{len(parts)} convex part{'s' if len(parts) > 1 else ''}"
            yield (
                f"body {body.name!r:.60}: shape {shape.name!r:.60} collides as {count}, "
                f"{100.0 * parts.excess:.0f} % of which are outside of its mesh, as lidar and "
                "camera see it: without a mass, or as simpler meshes, it would collide exactly"
            )


@dataclass(eq=False)
class _Part:
    corners_m: Array
    """(m, 3, 3) of triangles around it"""
    is_cap: NDArray[np.bool_]
    """(m,), whether a triangle only closes the surface"""
    points_m: Array
    hull_m3: float
    own_m3: float
    excess_m3: float
    """Of the hull's volume; 0, if it is not to be cut"""


def _part(corners: Array, is_cap: NDArray[np.bool_], points: Array | None = None) -> _Part | None:
    """A part with the openings of its surface closed; None if it has no area."""
    caps = caps_of(corners)
    corners = np.concatenate((corners, caps))
    is_cap = np.concatenate((is_cap, np.ones(len(caps), bool)))
    if points is None:
        points = different(corners[~is_cap])
    try:
        hull_m3 = float(hull_of(points).volume)
    except ValueError:
        thick = _thickened(corners[~is_cap])
        if thick is None:
            return None
        hull_m3 = float(hull_of(thick).volume)
        return _Part(corners, is_cap, thick, hull_m3, hull_m3, 0.0)
    own_m3 = float(portable.determinants(corners - points.mean(0)).sum()) / 6.0
    if own_m3 < 0.0:
        # Inside out, or mirrored.
        corners, own_m3 = corners[:, ::-1], -own_m3
    if own_m3 > hull_m3 * (1.0 + 1e-6):
        # Three cuts meet within the mesh: a corner that no triangle of its surface has.
        points = different(corners)
        hull_m3 = float(hull_of(points).volume)
    return _Part(corners, is_cap, points, hull_m3, own_m3, hull_m3 - own_m3)


def _thickened(corners: Array) -> Array | None:
    """(n, 3) corners of a slab around flat triangles; None if they have no area."""
    normals = normals_of(corners)
    areas = portable.lengths(normals)
    if not len(areas) or areas.max() <= 1e-12:
        return None
    widest = int(areas.argmax())
    out = normals[widest] / areas[widest] * (_THIN_M / 2.0)
    points = corners.reshape(-1, 3)
    return np.concatenate((points + out, points - out))


def _components(vertices: Array, triangles: NDArray[np.int32], most: int) -> list[_Part]:
    """A part for each connected component; one for all, if there are too many."""
    numbers = numbered(vertices)
    corners = numbers[triangles]
    # A surface that is drawn from both sides encloses nothing: one side of it does.
    _, first = first_of_each(np.sort(corners, axis=1))
    a, b, c = corners[first].T
    kept = first[(a != b) & (b != c) & (c != a)]
    label = connected(int(numbers.max()) + 1, corners[kept][:, [0, 1, 1, 2]].reshape(-1, 2))
    of_triangle = label[corners[kept][:, 0]]
    groups = [kept[of_triangle == one] for one in in_order(of_triangle)]
    if len(groups) > _MAX_COMPONENTS:
        groups = [kept]
    parts = _outer(_parts_of(vertices, triangles, groups))
    return parts if len(parts) <= most else _parts_of(vertices, triangles, [kept])


def _parts_of(
    vertices: Array, triangles: NDArray[np.int32], groups: Sequence[NDArray[np.int64]]
) -> list[_Part]:
    parts = []
    for group in groups:
        own = triangles[group]
        real = np.zeros(len(own), bool)
        part = _part(vertices[own], real, vertices[np.unique(own)])
        if part is not None:
            parts.append(part)
    return parts


def _outer(parts: list[_Part]) -> list[_Part]:
    """The parts without those that lie within a convex one."""
    hulls = [
        hull_of(part.points_m).equations if part.excess_m3 <= _EXCESS * part.hull_m3 else None
        for part in parts
    ]
    left = []
    for index, part in enumerate(parts):
        for other, planes in enumerate(hulls):
            # Of two within each other the first is kept.
            bigger = (parts[other].hull_m3, -other) > (part.hull_m3, -index)
            if planes is not None and other != index and bigger:
                out = portable.product(part.points_m, planes[:, :3].T) + planes[:, 3]
                if out.max() <= _THIN_M:
                    break
        else:
            left.append(part)
    return left


def _halves(part: _Part) -> list[_Part]:
    """A part cut by the plane that leaves the least volume, or in the middle if none leaves less;
    empty, if it cannot be cut.
    """
    real = _sample(part.corners_m[~part.is_cap])
    best, best_m3 = None, 0.99 * _hull_m3(real)
    for direction in _directions(real):
        heights = portable.product(real, direction)
        for level in _levels(heights):
            volume_m3 = 0.0
            for sign in (1.0, -1.0):
                side = side_of(real, sign * (heights - level), sign * direction)
                volume_m3 += _hull_m3(side)
            # With a margin, so that the last bits do not decide between two of the same volume.
            if volume_m3 < best_m3 * (1.0 - 1e-6):
                best, best_m3 = (direction, level), volume_m3
    if best is None:
        low, high = real.reshape(-1, 3).min(0), real.reshape(-1, 3).max(0)
        axis = int((high - low).argmax())
        best = np.eye(3)[axis], float(low[axis] + high[axis]) / 2.0
    direction, level = best
    heights = portable.product(part.corners_m, direction) - level
    marked: Array = np.concatenate(
        (part.corners_m, np.repeat(part.is_cap[:, None, None], 3, axis=1)), axis=2
    )
    halves = []
    for sign in (1.0, -1.0):
        side = side_of(marked, sign * heights, sign * direction)
        half = _part(side[..., :3], side[:, 0, 3] > 0.5)
        if half is not None:
            halves.append(half)
    return halves if len(halves) == 2 else []


def _sample(corners: Array) -> Array:
    if len(corners) <= _MAX_TRIED:
        return corners
    by_area = np.argsort(-portable.lengths(normals_of(corners)), kind="stable")
    half = _MAX_TRIED // 2
    rest = np.sort(by_area[half:])
    return corners[np.concatenate((by_area[:half], rest[:: -(-len(rest) // half)]))]


def _directions(corners: Array) -> list[Array]:
    """Normals of the planes to try: the axes, and those of the widest faces."""
    normals = normals_of(corners)
    areas = portable.lengths(normals)
    wide = areas > 1e-12
    normals, areas = normals[wide] / areas[wide, None], areas[wide]
    total = float(areas.sum())
    found = list(np.eye(3))
    for _ in range(3):
        fresh = np.abs(portable.product(normals, np.array(found).T)).max(axis=1) < 0.9998
        normals, areas = normals[fresh], areas[fresh]
        if not len(areas):
            break
        cells = np.round(normals * np.where(normals[:, :1] < 0.0, -1.0, 1.0) * 50.0)
        cell, first = first_of_each(cells.astype(np.int64))
        shares = np.round(np.bincount(cell, areas) / total, 6)
        if shares.max() < _WIDE:
            break
        found.append(normals[first[int(shares.argmax())]])
    return found


def _levels(heights: Array) -> list[float]:
    """Heights at which to try a cut: at corners, and in the middle."""
    low, high = float(heights.min()), float(heights.max())
    levels = np.unique(np.round(heights / SAME_M)) * SAME_M
    levels = levels[(levels > low + SAME_M) & (levels < high - SAME_M)]
    most = min(max(2 * _MAX_TRIED // len(heights), _PLANES[0]), _PLANES[1])
    if len(levels) > most:
        at = np.linspace(0, len(levels) - 1, most + 2)[1:-1]
        levels = levels[np.round(at).astype(np.int64)]
    return [*levels.tolist(), (low + high) / 2.0] if high - low > _THIN_M else []


def _hull_m3(corners: Array) -> float:
    try:
        return float(hull_of(different(corners)).volume)
    except ValueError:
        return 0.0
