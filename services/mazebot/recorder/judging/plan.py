"""The plan of a world: the outlines of what is solid on the robot's level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from mazebot.common.messages.documents import BodyEntity, World
from mazebot.common.recordings.series import Ring
from mazebot.recorder.judging.obstacles import obstacles, read_meshes

_FINE_M = 0.005
"""Corners that change an outline by less than this are left out;"""
_MOST_CORNERS = 20_000
"""of more corners than this, by twice as much, and again."""


class Plan:
    """The outlines of a world, computed again when its static bodies or their meshes change."""

    def __init__(self, world: World, assets: Mapping[str, bytes]) -> None:
        """`assets` by sha256 may be filled later."""
        self._world = world
        self._assets = assets
        self._known: tuple[tuple[BodyEntity, ...], int] | None = None
        self._rings: tuple[Ring, ...] = ()

    def rings(self, standing: tuple[BodyEntity, ...]) -> tuple[Ring, ...]:
        """Closed outlines, x and y in the map (m); an area is solid if it is inside an odd number
        of them. `standing` are the spawned bodies that do not move.
        """
        meshes = read_meshes((*self._world.bodies, *standing), self._assets)
        known = standing, len(meshes)
        if known != self._known:
            self._rings = solid_rings(obstacles(self._world, meshes, standing))
            self._known = known
        return self._rings


def solid_rings(solid: Any) -> tuple[Ring, ...]:
    """The outlines of polygons, and of the areas that lines enclose."""
    kinds = shapely.get_dimensions(solid)
    enclosed = shapely.get_parts(shapely.polygonize(solid[kinds == 1]))
    whole = shapely.union_all(np.concatenate([solid[kinds == 2], enclosed]))
    tolerance_m = _FINE_M
    while True:
        simple = shapely.simplify(whole, tolerance_m)
        if shapely.get_num_coordinates(simple) <= _MOST_CORNERS:
            break
        tolerance_m *= 2.0
    polygons = shapely.get_parts(simple)
    rings = shapely.get_rings(polygons[shapely.get_dimensions(polygons) == 2])
    return tuple(
        tuple((round(x_m, 3), round(y_m, 3)) for x_m, y_m in shapely.get_coordinates(ring).tolist())
        for ring in rings
    )
