"""Which view point is next: the first of the shortest tour through all of them and home."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.explorer.floor import Floor
from mazebot.explorer.params import Policy
from mazebot.explorer.paths import FAR, search
from mazebot.explorer.view_points import ViewPoint

Costs = NDArray[np.int64]

MOST_TOURED: Final = 20
"""The tour leads through the nearest ones; the others come later anyway."""
_NO_WAY: Final = FAR // 256


@kernel("int64(int64[:, ::1], int64[::1])")
def _length(costs: Costs, tour: Costs) -> int:
    total = 0
    for i in range(tour.size - 1):
        total += costs[tour[i], tour[i + 1]]
    return total


@kernel("void(int64[::1], int64[::1])")
def _copy(tour: Costs, to: Costs) -> None:
    """Numba takes a second to compile `to[:] = tour`."""
    for k in range(tour.size):
        to[k] = tour[k]


@kernel("int64(int64[:, ::1], int64[::1], int64)")
def _improve(costs: Costs, tour: Costs, fixed: int) -> int:
    """Shorten an open tour by 2-opt and Or-opt moves until none helps, and return its length.

    Args:
        costs: (n, n) between any two places.
        tour: (m,) indices of places; changed in place.
        fixed: so many at its beginning stay; so does the last.
    """
    count = tour.size
    best = _length(costs, tour)
    trial = tour.copy()
    better = True
    while better:
        better = False
        for i in range(fixed, count - 2):
            for j in range(i + 1, count - 1):
                for k in range(count):
                    trial[k] = tour[j + i - k] if i <= k <= j else tour[k]
                length = _length(costs, trial)
                if length < best:
                    best, better = length, True
                    _copy(trial, tour)
        for size in range(1, 4):
            for i in range(fixed, count - size):
                for to in range(fixed, count - size):
                    if to == i:
                        continue
                    # The segment from i on is taken out and put before what is then at `to`.
                    place, taken = 0, 0
                    while place < count:
                        if place == to:
                            for s in range(size):
                                trial[place + s] = tour[i + s]
                            place += size
                            continue
                        if taken == i:
                            taken += size
                        trial[place] = tour[taken]
                        place, taken = place + 1, taken + 1
                    length = _length(costs, trial)
                    if length < best:
                        best, better = length, True
                        _copy(trial, tour)
    return best


@kernel("int64(int64[:, ::1], int64, int64[::1])")
def _tour(costs: Costs, first: int, tour: Costs) -> int:
    """Fill a short open tour from place 0 through all others to the last one, and return its
    length. `first` comes after place 0, or any if it is 0.
    """
    count = tour.size
    last = count - 1
    far = np.iinfo(np.int64).max
    used = np.zeros(count, np.bool_)
    used[0] = used[last] = True
    tour[0], tour[1] = 0, last
    size, fixed = 2, 1
    if 0 < first < last:
        tour[1], tour[2] = first, last
        used[first] = True
        size, fixed = 3, 2
    while size < count:
        nearest, least = -1, far
        for place in range(1, last):
            if not used[place]:
                for k in range(size):
                    if costs[place, tour[k]] < least:
                        nearest, least = place, costs[place, tour[k]]
        best, extra = -1, far
        for k in range(fixed - 1, size - 1):
            here, there = tour[k], tour[k + 1]
            more = costs[here, nearest] + costs[nearest, there] - costs[here, there]
            if more < extra:
                best, extra = k + 1, more
        for k in range(size, best, -1):
            tour[k] = tour[k - 1]
        tour[best] = nearest
        used[nearest] = True
        size += 1
    return _improve(costs, tour, fixed)


def tour_through(costs: Costs, first: int = 0) -> tuple[list[int], int]:
    """A short open tour from place 0 through all others to the last one: their indices, and its
    length. Nearest insertion, then 2-opt and Or-opt moves.

    Args:
        costs: (n, n) between any two of at least two places.
        first: the place that comes after place 0; 0: any.
    """
    tour = np.empty(len(costs), np.int64)
    length = _tour(np.ascontiguousarray(costs, np.int64), first, tour)
    return [int(one) for one in tour], int(length)


def costs_between(floor: Floor, places: list[int]) -> Costs:
    """(n, n) costs of the ways between coarse cells."""
    count = len(places)
    costs = np.zeros((count, count), np.int64)
    for i, place in enumerate(places[:-1]):
        distances, _ = search(floor.prices, place)
        row = distances.reshape(-1)[places]
        costs[i, i + 1 :] = costs[i + 1 :, i] = row[i + 1 :]
    return np.minimum(costs, _NO_WAY)


class Chooser:
    """The choice among view points, as seen from where the robot is."""

    def __init__(
        self, floor: Floor, robot: int, home: int | None, points: list[ViewPoint], policy: Policy,
        gain_scale: float, potential_scale: float,
    ) -> None:  # fmt: skip
        """Take what there is to choose from.

        Args:
            floor: the map from where the robot is.
            robot: index of the robot's coarse cell.
            home: that of the place where the tour ends; None: anywhere.
            points: in the order of their costs from the robot.
            policy: "tour", or "gain" for the cost of explore_lite.
            gain_scale: weight of a frontier's size, of policy "gain".
            potential_scale: weight of the way to it.
        """
        self._floor = floor
        self._points = points
        self._policy = policy
        self._gain_scale, self._potential_scale = gain_scale, potential_scale
        self._costs: Costs | None = None
        self._robot, self._home = robot, home

    def price(self, first: int) -> float:
        """What it costs to begin with a view point, in metres: the smallest is best."""
        point = self._points[first]
        way_m = self._floor.metres(point.cost)
        if self._policy == "gain":
            size_m = sum(len(part.cells) for part in point.parts) * self._floor.resolution_m
            return self._potential_scale * way_m - self._gain_scale * size_m
        if first >= MOST_TOURED:
            return way_m + self._floor.metres(_NO_WAY)
        return self._floor.metres(self._tour_length(first + 1))

    def _tour_length(self, first: int) -> int:
        if self._costs is None:
            toured = self._points[:MOST_TOURED]
            places = [self._robot, *(point.index for point in toured)]
            self._costs = np.zeros((len(toured) + 2, len(toured) + 2), np.int64)
            if self._home is None:
                self._costs[:-1, :-1] = costs_between(self._floor, places)
            else:
                self._costs[:] = costs_between(self._floor, [*places, self._home])
        return tour_through(self._costs, first)[1]
