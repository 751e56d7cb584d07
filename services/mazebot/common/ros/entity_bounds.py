"""simulation_interfaces: bounds, and whether an entity overlaps them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from mazebot.common.maths.frames import Array, inverse_matrix, pose_matrix
from mazebot.common.maths.portable import product, square
from mazebot.common.messages import documents as doc

EMPTY, BOX, CONVEX_HULL, SPHERE = range(4)
"""Of Bounds.type."""
_MOST_POINTS: Final = 256
_CORNERS: Final = np.array(list(itertools.product((False, True), repeat=3)))


def box(low_m: Sequence[float], high_m: Sequence[float]) -> Mapping[str, Any]:
    """Bounds of TYPE_BOX: the upper right corner, then the lower left one."""
    return {
        "type": BOX,
        "points": [dict(zip("xyz", map(float, corner), strict=True)) for corner in (high_m, low_m)],
    }


def problem_of_bounds(bounds: Any) -> str:
    """Why bounds are none, in one line; empty: they are some, or empty."""
    count = len(bounds.points)
    wanted = {EMPTY: (0, 0), BOX: (2, 2), CONVEX_HULL: (3, _MOST_POINTS), SPHERE: (2, 2)}
    least, most = wanted.get(bounds.type, (0, -1))
    if most < 0:
        return f"type: {bounds.type}: must be one of {', '.join(map(str, wanted))}"
    if not least <= count <= most:
        number = f"{least}" if least == most else f"{least} .. {most}"
        return f"points: {count}: must be {number} of type {bounds.type}"
    if bounds.type == SPHERE and bounds.points[1].x < 0.0:
        return f"points[1].x: {bounds.points[1].x:g}: must be a radius"
    return ""


def overlaps(
    entity: doc.Entity, low_m: Sequence[float], high_m: Sequence[float], bounds: Any
) -> bool:
    """Whether an entity's box, in its own frame, touches bounds in `map`: some, and no problem."""
    map_from_entity = pose_matrix(entity)
    points = np.array([(point.x, point.y, point.z) for point in bounds.points])
    if bounds.type == SPHERE:
        centre = _moved(inverse_matrix(map_from_entity), points[:1])[0]
        gap = centre - np.clip(centre, low_m, high_m)
        return bool(square(gap).sum() <= square(points[1, 0]))
    if bounds.type == BOX:
        points = _corners(points.min(axis=0), points.max(axis=0))
    return _meet(_moved(map_from_entity, _corners(low_m, high_m)), points)


def _corners(low_m: Sequence[float] | Array, high_m: Sequence[float] | Array) -> Array:
    return np.where(_CORNERS, high_m, low_m)


def _moved(transform: Array, points: Array) -> Array:
    return product(points, transform[:3, :3].T) + transform[:3, 3]


def _meet(hull: Array, other: Array) -> bool:
    """Whether the convex hulls of points (N, 3) and (M, 3) have a point in common: whether weights
    of both exist that give the same point, a linear program.
    """
    # Takes 0.2 s to import, and hardly anybody asks for it.
    from scipy.optimize import linprog  # noqa: PLC0415

    # The solver's tolerance is absolute: about the middle, what is near is small.
    middle = hull.mean(axis=0)
    equal = np.vstack(
        [
            np.hstack([(hull - middle).T, -(other - middle).T]),
            np.repeat([[1.0, 0.0], [0.0, 1.0]], [len(hull), len(other)], axis=1),
        ]
    )
    found = linprog(np.zeros(equal.shape[1]), A_eq=equal, b_eq=[0.0, 0.0, 0.0, 1.0, 1.0])
    return bool(found.status == 0)
