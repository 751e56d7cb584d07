"""Triangles as (m, 3, 3) corners, without numbers for them: cut, closed and counted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.world.geometry import part_above

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

SAME_M = 1e-5
"""Corners nearer than this are one."""


def hull_of(points_m: Array) -> ConvexHull:
    """The convex hull of (n, 3) points. Raises ValueError, in a phrase, if it has no volume."""
    # SciPy takes a second to import, and most worlds have no hulls.
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

    try:
        return ConvexHull(points_m)
    except (QhullError, ValueError) as error:
        raise ValueError("is flat or empty: it must have a volume") from error


def side_of(corners: Array, heights: Array, up: Array) -> Array:
    """The triangles, (m, 3, k), on the upper side of a plane; those in it, if they face down."""
    heights = np.where(np.abs(heights) < SAME_M, 0.0, heights)
    flat = (heights == 0.0).all(axis=1)
    if flat.any():
        down = portable.product(normals_of(corners[:, :, :3]), up) < 0.0
        kept = ~flat | down
        corners, heights = corners[kept], heights[kept]
    # What only touches the plane from below is not above it.
    kept = (heights > 0.0).any(axis=1) | (heights == 0.0).all(axis=1)
    return part_above(corners[kept], heights[kept])


def normals_of(corners: Array) -> Array:
    """(m, 3) outward normals of triangles, as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def caps_of(corners: Array) -> Array:
    """(c, 3, 3) triangles that close a surface: fans over each of its openings.

    They may overlap; their signed volumes do not.
    """
    points = corners.reshape(-1, 3)
    numbers = numbered(points).reshape(-1, 3)
    edges = numbers[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    cell, first = first_of_each(np.sort(edges, axis=1))
    surplus = np.bincount(cell, np.where(edges[:, 0] < edges[:, 1], 1, -1)).astype(np.int64)
    is_open = (surplus != 0) & (edges[first, 0] != edges[first, 1])
    rim = np.sort(edges[first[is_open]], axis=1)
    if not len(rim):
        return np.zeros((0, 3, 3))
    surplus = surplus[is_open]
    rim = np.repeat(np.where(surplus[:, None] > 0, rim[:, ::-1], rim), np.abs(surplus), axis=0)
    place = np.zeros((int(numbers.max()) + 1, 3))
    place[numbers.ravel()] = points
    _, loop = np.unique(connected(len(place), rim)[rim[:, 0]], return_inverse=True)
    ends = place[rim]
    size = np.bincount(loop)
    middle = np.stack([np.bincount(loop, ends[:, 0, axis]) / size for axis in range(3)], axis=1)
    return np.concatenate((middle[loop][:, None], ends), axis=1)


def different(corners: Array) -> Array:
    """(n, 3) the corners of triangles, each once."""
    points = corners.reshape(-1, 3)
    cells = np.round(points / SAME_M).astype(np.int64)
    return points[np.sort(first_of_each(cells)[1])]


def numbered(points: Array) -> NDArray[np.int64]:
    """(n,) the same number for the same point."""
    cells = np.round(points / SAME_M).astype(np.int64)
    return first_of_each(cells)[0]


def first_of_each(rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of (n, k) rows: (n,) the number of each different one, and (m,) where it comes first."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    starts = np.ones(len(rows), bool)
    starts[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(starts) - 1
    return number, order[starts]


def connected(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int32]:
    """(count,) the same label for what pairs connect."""
    from scipy.sparse import coo_array  # noqa: PLC0415
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def in_order(labels: NDArray[np.int32]) -> list[int]:
    """The different labels, by where they come first."""
    _, first = np.unique(labels, return_index=True)
    ordered: list[int] = labels[np.sort(first)].tolist()
    return ordered
