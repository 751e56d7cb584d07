"""The goals of a tour in a world."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.documents import Planar, World
from mazebot.common.node.node import random_generator

HOME = "home"

PLACES = 4
"""Maximum number of poses of a default tour, besides home."""
APART_M = 0.5
"""Minimum distance of these poses from each other, and from the start."""
_ROOM_M = 0.1
"""Preferred clearance around the robot at such a pose."""
_BEYOND_M = 2.0
"""On open floor, maximum distance of these poses beyond the world's obstacles and start."""
_CANDIDATES = 60
"""Number of random candidates: fewer would miss corners, more would make all seeds alike."""

Goals = list[tuple[str, Planar]]


class NoLocationsError(ValueError):
    """A world without a reachable goal."""


def tour_goals(
    world: World, names: tuple[str, ...], cells: NDArray[np.int8], origin: SE2, seed: int
) -> Goals:
    """The goals of a tour by name; without names, every location in the world's order, then home;
    in a world without locations its default tour.

    Home is the robot's start, unless the world has a location of that name. `cells`, `origin` and
    `seed` are as in `default_tour`.
    Raises ValueError with one line where the world lacks a named location, NoLocationsError where
    there is no reachable goal.
    """
    if not names and not world.locations:
        return default_tour(world, cells, origin, seed)
    places: dict[str, Planar] = {location.name: location for location in world.locations}
    places.setdefault(HOME, world.start)
    for name in names:
        if name not in places:
            known = ", ".join(places)
            raise ValueError(
                f"tour: {name!r}: no such location in {world.name}: must be one of {known}"
            )
    return [
        (name, Planar(x_m=places[name].x_m, y_m=places[name].y_m, yaw_rad=places[name].yaw_rad))
        for name in names or places
    ]


def default_tour(world: World, cells: NDArray[np.int8], origin: SE2, seed: int) -> Goals:
    """The tour of a world without locations: poses on the reachable floor, each chosen as far as
    possible from the others, then home. The same seed gives the same tour.

    `cells` (rows, columns) are the map's, 0 free to 100 occupied, -1 unknown, with `origin`
    map_from_grid. On open floor the poses are near obstacles or the start. Raises NoLocationsError
    where the robot can reach no such pose.
    """
    points = _drawn(world, cells, origin, seed)
    start = np.array([world.start.x_m, world.start.y_m])
    chosen: list[Array] = []
    apart_m = portable.hypot_each(*(points - start).T)
    while len(chosen) < PLACES and len(points) and apart_m.max() > APART_M:
        chosen.append(points[int(np.argmax(apart_m))])
        apart_m = np.minimum(apart_m, portable.hypot_each(*(points - chosen[-1]).T))
    if not chosen:
        raise NoLocationsError(
            f"tour: {world.recipe} has no locations, and no free floor to drive to: add "
            "`locations:` to "
            "it, or give one goal (--goal x y yaw)"
        )
    goals: Goals = []
    here = start
    while chosen:
        # The nearest first, so that no leg passes a later goal.
        nearest = min(range(len(chosen)), key=lambda i: float(portable.lengths(chosen[i] - here)))
        there = chosen.pop(nearest)
        yaw_rad = round(portable.atan2(there[1] - here[1], there[0] - here[0]), 3)
        place = Planar(
            x_m=round(float(there[0]), 3), y_m=round(float(there[1]), 3), yaw_rad=yaw_rad
        )
        goals.append((f"place{len(goals) + 1}", place))
        here = there
    return [*goals, (HOME, world.start)]


def _drawn(world: World, cells: NDArray[np.int8], origin: SE2, seed: int) -> Array:
    """(n, 2) centres of random reachable cells, with room for the robot where there are any."""
    # Most tours have names, and need not import OpenCV.
    from mazebot.common.world.costmap import (  # noqa: PLC0415
        ROBOT_RADIUS_M,
        START_TOLERANCE_M,
        reachable_from,
        straightened,
        traversable,
    )

    resolution_m = world.map_resolution_m
    origin, cells = straightened(resolution_m, origin, cells)
    free, clearance_m = traversable(cells, resolution_m)
    row = math.floor((world.start.y_m - origin.y_m) / resolution_m)
    column = math.floor((world.start.x_m - origin.x_m) / resolution_m)
    reached = reachable_from(free, row, column, START_TOLERANCE_M / resolution_m)
    rows, columns = np.nonzero(cells >= 100)
    beyond = math.ceil(_BEYOND_M / resolution_m)
    near = np.zeros(cells.shape, np.bool_)
    near[
        max(0, min([row, *rows]) - beyond) : max([row, *rows]) + beyond + 1,
        max(0, min([column, *columns]) - beyond) : max([column, *columns]) + beyond + 1,
    ] = True
    reached &= near
    roomy = reached & (clearance_m >= ROBOT_RADIUS_M + _ROOM_M)
    rows, columns = np.nonzero(roomy if roomy.any() else reached)
    drawn = random_generator(seed, "bringup/tour").permutation(len(rows))[:_CANDIDATES]
    return np.stack(
        [
            origin.x_m + (columns[drawn] + 0.5) * resolution_m,
            origin.y_m + (rows[drawn] + 0.5) * resolution_m,
        ],
        axis=1,
    )
