"""Where the label of a room is placed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from mazebot.common.maths.frames import Array

_PLACES_A_SIDE = 25
"""Candidate positions along each side of the room's bounding box."""
_LABEL_TO_WALL = 0.5
"""Weight of the distance to another label against that to a wall: the label is as long as this."""


def name_places_m(polygons_m: Sequence[Array], named_m: Array) -> Array:
    """(r, 2) label positions for r rooms, (n, 2) each, far from the room's border, from named
    locations (k, 2), and from the labels of earlier rooms.
    """
    places = np.empty((len(polygons_m), 2))
    for number, polygon_m in enumerate(polygons_m):
        polygon = shapely.make_valid(shapely.Polygon(polygon_m))
        low, high = polygon_m.min(0), polygon_m.max(0)
        sides = (np.linspace(a, b, _PLACES_A_SIDE) for a, b in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        inside = grid[shapely.contains_xy(polygon, grid)]
        if not len(inside):
            places[number] = shapely.get_coordinates(shapely.point_on_surface(polygon))[0]
            continue
        room_m = shapely.distance(shapely.boundary(polygon), shapely.points(inside))
        others_m = np.concatenate([named_m, places[:number]])
        if len(others_m):
            apart_m = np.linalg.norm(inside[:, None] - others_m, axis=2).min(1)
            room_m = np.minimum(room_m, _LABEL_TO_WALL * apart_m)
        places[number] = inside[np.argmax(room_m)]
    return places
