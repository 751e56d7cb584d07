"""Where things that move will be: their mean motion over a while, carried on along the walls."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.costmap import GridFrame
from mazebot.navigation.costmap.footprint import distance_at

STEP_S: Final = 0.1
"""Between two predicted places"""
_MEMORY_S = 1.0
_KNOWN_S = 0.4
"""The displacement is used after this time, until then the filter's velocity."""
_LEAST_RADIUS_M = 0.1
_BODY: Final = 0.8
"""Share of its radius that a thing keeps from walls: its disc is an estimate."""


class Walker(NamedTuple):
    """A thing that moves, now, in the frame of the costmap."""

    x_m: float
    y_m: float
    velocity_x_m_s: float
    velocity_y_m_s: float
    radius_m: float

    @property
    def speed_m_s(self) -> float:
        """Speed over the floor."""
        return math.sqrt(
            self.velocity_x_m_s * self.velocity_x_m_s + self.velocity_y_m_s * self.velocity_y_m_s
        )


class Walkers:
    """Remembers the tracks of the last second: the displacement over it is a better measure of
    where a thing is going than the velocity of a filter that must follow each turn.
    """

    def __init__(self) -> None:
        self._places: dict[int, deque[tuple[float, float, float]]] = {}

    def clear(self) -> None:
        """Forget all."""
        self._places = {}

    def update(self, now_s: float, tracks: Sequence[Track]) -> tuple[Walker, ...]:
        """Take the tracks at a time; how they move."""
        self._places = {each.number: self._places.get(each.number, deque()) for each in tracks}
        found = []
        for each in tracks:
            places = self._places[each.number]
            if not places or now_s > places[-1][0]:
                places.append((now_s, each.x_m, each.y_m))
            while places[-1][0] - places[0][0] > _MEMORY_S:
                places.popleft()
            velocity = each.velocity_x_m_s, each.velocity_y_m_s
            if places[-1][0] - places[0][0] >= _KNOWN_S:
                velocity = _slope(places)
            radius_m = max(each.radius_m, _LEAST_RADIUS_M)
            found.append(Walker(each.x_m, each.y_m, *velocity, radius_m))
        return tuple(found)


def _slope(places: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Least squares velocity of times, x and y; summed in order, alike on every processor."""
    mean_s = sum(t for t, _, _ in places) / len(places)
    square = sum((t - mean_s) * (t - mean_s) for t, _, _ in places)
    return (
        sum((t - mean_s) * x for t, x, _ in places) / square,
        sum((t - mean_s) * y for t, _, y in places) / square,
    )


def ways_of(
    walkers: Sequence[Walker], distance_m: Clearance, frame: GridFrame, horizon_s: float
) -> Array:
    """(walkers, steps, 2) their places every STEP_S from now, in the frame of the costmap.

    A thing goes on at its velocity, and slides along a wall that is in its way: a person who walks
    down a corridor, seen going a little askew, stays in the corridor, and one who crosses it stops
    before the wall.
    """
    steps = round(horizon_s / STEP_S) + 1
    ways = np.empty((len(walkers), steps, 2))
    for way, walker in zip(ways, walkers, strict=True):
        column, row = frame.place(walker.x_m, walker.y_m)
        per_step = STEP_S / frame.resolution_m
        _follow(
            distance_m, frame.resolution_m, float(column), float(row),
            walker.velocity_x_m_s * per_step, walker.velocity_y_m_s * per_step,
            _BODY * walker.radius_m, way,
        )  # fmt: skip
    ways *= frame.resolution_m
    ways += np.array((frame.origin_x_m, frame.origin_y_m))
    return ways


@kernel()
def _follow(
    distance_m: Clearance,
    resolution_m: float,
    column: float,
    row: float,
    step_columns: float,
    step_rows: float,
    keep_m: float,
    way: Array,
) -> None:
    """Fill in (steps, 2) places in cells. Beyond the grid nothing is known: it goes on there."""
    rows, columns = distance_m.shape
    x, y = column, row
    for i in range(len(way)):
        way[i, 0], way[i, 1] = x, y
        x, y = x + step_columns, y + step_rows
        for _ in range(3):
            if not (1.0 <= x < columns - 1.0 and 1.0 <= y < rows - 1.0):
                break
            lacks_m = keep_m - distance_at(distance_m, x, y)
            if lacks_m <= 0.0:
                break
            ahead = distance_at(distance_m, x + 0.5, y) - distance_at(distance_m, x - 0.5, y)
            up = distance_at(distance_m, x, y + 0.5) - distance_at(distance_m, x, y - 0.5)
            slope = math.sqrt(ahead * ahead + up * up)
            if slope < 1e-9:
                # In the middle of a wall, or of a gap too narrow for it.
                x, y = way[i, 0], way[i, 1]
                break
            x += ahead / slope * lacks_m / resolution_m
            y += up / slope * lacks_m / resolution_m
