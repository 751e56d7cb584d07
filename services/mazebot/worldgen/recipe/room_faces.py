"""Assigns rooms' materials to the stretches of walls that face into them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import shapely

from mazebot.common.maths import portable
from mazebot.common.messages.documents import Covering, Wall
from mazebot.worldgen.recipe_model import RoomRecipe

OFF_FACE_M = 0.01
"""Distance before a face at which a room must be for the face to be in it."""
_MIN_SPAN_M = 1e-3

_Span = tuple[float, float]


def with_room_faces(walls: Sequence[Wall], rooms: Mapping[str, RoomRecipe]) -> tuple[Wall, ...]:
    """The walls, their faces covered with the `wall_material` of the rooms they face into.

    A face is in a room where the line `OFF_FACE_M` before it lies in the room's polygon.
    A wall's existing coverings take precedence. Self-intersecting polygons are skipped.
    """
    dressed = [
        (shapely.Polygon(room.polygon_m), room.wall_material)
        for room in rooms.values()
        if room.wall_material
    ]
    dressed = [(polygon, material) for polygon, material in dressed if polygon.is_valid]
    if not walls or not dressed:
        return tuple(walls)
    materials = [material for _, material in dressed]
    pose = np.array(
        [(w.x_m, w.y_m, w.yaw_rad, w.length_m / 2.0, w.thickness_m / 2.0) for w in walls]
    )
    x, y, yaw, half_length, half_thickness = pose.T
    along = np.stack(portable.cos_sin_each(yaw), 1)
    across = np.stack([-along[:, 1], along[:, 0]], 1)
    covered: list[list[Covering]] = [list(wall.coverings) for wall in walls]
    tree = shapely.STRtree([polygon for polygon, _ in dressed])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        off = sign * (half_thickness + OFF_FACE_M)
        middle = np.stack([x, y], 1) + off[:, None] * across
        ends = (
            middle[:, None]
            + np.array([-1.0, 1.0])[:, None] * (half_length[:, None] * along)[:, None]
        )
        lines = shapely.linestrings(ends)
        for index, number in sorted(tree.query(lines, predicate="intersects").T.tolist()):
            inside = shapely.intersection(lines[index], dressed[number][0])
            taken = [(c.from_m, c.to_m) for c in covered[index] if c.side == side]
            for span in _without(
                _spans(inside, middle[index], along[index], float(half_length[index])), taken
            ):
                covered[index].append(
                    Covering(
                        side=side, from_m=span[0], to_m=span[1], material=str(materials[number])
                    )
                )
    return tuple(
        wall.model_copy(update={"coverings": tuple(coverings)}) if coverings else wall
        for wall, coverings in zip(walls, covered, strict=True)
    )


def _spans(
    inside: shapely.Geometry,
    middle: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    along: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    half_length_m: float,
) -> list[_Span]:
    """The pieces of a line along the wall, from its middle; its ends are exactly the wall's."""
    spans = []
    for part in shapely.get_parts(inside):
        if part.geom_type != "LineString" or part.is_empty:
            continue
        at = sorted(
            float(portable.product(point - middle, along))
            for point in shapely.get_coordinates(part)
        )
        low = -half_length_m if at[0] < 1e-9 - half_length_m else at[0]
        high = half_length_m if at[-1] > half_length_m - 1e-9 else at[-1]
        spans.append((low, high))
    return sorted(spans)


def _without(spans: Iterable[_Span], taken: Iterable[_Span]) -> list[_Span]:
    """The remaining parts of spans."""
    left = list(spans)
    for low, high in taken:
        left = [
            piece
            for start, end in left
            for piece in ((start, min(end, low)), (max(start, high), end))
            if piece[0] < piece[1]
        ]
    return [(start, end) for start, end in left if end - start >= _MIN_SPAN_M]
