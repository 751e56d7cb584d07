"""The part of the path that is ahead: Nav2's FeasiblePathHandler."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.planning.path import PlannedPath, even_points


class PathHandlerParams(Params):
    """Names as in Nav2's FeasiblePathHandler."""

    prune_distance: float = Field(
        1.7, gt=0, description="m; the controller is given this much of the path ahead of the robot"
    )
    max_robot_pose_search_dist: float = Field(
        1.0,
        gt=0,
        description="m; the point of the path nearest to the robot is looked for within this "
        "length of path from the last one",
    )


class LocalPath(NamedTuple):
    """The path ahead of the robot at even steps; it begins at the point nearest to the robot."""

    points_m: Array
    """(n, 2) float64 in the map frame, n >= 2."""
    spacing_m: float
    remaining_m: float
    """Length of the path that is left up to where it turns back, or ends, beyond these points too.
    """
    ends: bool
    """Whether the last point is that place."""
    leads_away: bool
    """Whether it leads away from the robot all along. One that comes back, as a round does, is cut
    before: what is nearest to a place, or straight ahead, is then no measure of progress on it.
    """
    goal: SE2
    """That place, with the heading to arrive with."""


_SPAN_M: Final = 0.1
"""The path's direction at a point is that over this length before it, and after it."""
_BACK_COS: Final = -0.5
"""Of the angle between the two, where the path turns back."""
_AT_TURN_M: Final = 0.2
"""So near to where the path turns back the robot need not come nearer: Nav2's default of
`inversion_xy_tolerance`.
"""

_DETOUR: Final = 1.5
_DETOUR_M: Final = 0.1
"""A path comes back where its length is more than so many times the straight distance and this: a
bend by 90 degrees is no more than 1.42 times as long.
"""
_SHORTEST_M: Final = 0.6
"""So much of it is kept where it is cut: by less the robot is not drawn along."""


class PathHandler:
    """Keeps a path and how far the robot has come on it.

    A path through poses may turn back at one of them, and lead along the way that it came. Up to
    there it is all that is ahead, as with Nav2's `enforce_path_inversion`: else the robot would
    take a point on the way back for the one that it has reached.
    """

    def __init__(self, params: PathHandlerParams) -> None:
        self._params = params
        self.path: PlannedPath | None = None
        self.index = 0
        self._backwards = np.empty(0, np.bool_)
        self._ahead = np.empty(0, np.int64)
        """Points that the path leaves forwards."""
        self._turns: list[int] = []
        """Points at which the path turns back."""

    def set_path(self, path: PlannedPath | None) -> None:
        """Begin at the start of a path; None: there is none."""
        self.path, self.index = path, 0
        if path is not None:
            self._backwards = path.backwards()
            self._ahead = np.flatnonzero(~self._backwards)
            # A way out ends where the robot has to stand before it turns.
            drives_back = np.append(False, self._backwards[:-1])
            self._turns = [
                turn
                for turn in _turns_back(path)
                if path.along_m[turn] > path.way_out_m + 1e-9
                and self._backwards[turn] == drives_back[turn]
            ]

    def advance(self, path: PlannedPath, pose: SE2) -> float:
        """Find the point nearest to the robot; returns the length of the path that is left."""
        search_m = self._params.max_robot_pose_search_dist
        straight_m = abs(self.straight_m(path))
        if straight_m > 0.0:
            # What follows may lead along the same way in the other direction.
            search_m = min(search_m, straight_m + 1e-9)
        turn = self._next_turn()
        if turn is not None and straight_m == 0.0:
            to_turn_m = float(path.along_m[turn] - path.along_m[self.index])
            x_m, y_m = path.points_m[turn].tolist()
            away_m = math.hypot(x_m - pose.x_m, y_m - pose.y_m)
            if to_turn_m <= search_m and away_m <= _AT_TURN_M:
                self.index = turn
            else:
                search_m = min(search_m, to_turn_m - 1e-9)
        self.index = path.nearest(pose.x_m, pose.y_m, self.index, search_m)
        return path.length_m - float(path.along_m[self.index])

    def straight_m(self, path: PlannedPath) -> float:
        """Length of the piece that is to be driven straight ahead from the nearest point on, or
        backwards, below 0; 0 where the robot may drive as it likes.
        """
        here_m = float(path.along_m[self.index])
        if self._backwards[self.index]:
            end = self._ahead[np.searchsorted(self._ahead, self.index)]
            return here_m - float(path.along_m[end])
        return max(path.way_out_m - here_m, 0.0)

    def end_m(self, path: PlannedPath) -> float:
        """Length of the path up to where it next turns back, or ends."""
        turn = self._next_turn()
        return path.length_m if turn is None else float(path.along_m[turn])

    def turns_back(self) -> bool:
        """Whether the path turns back before it ends."""
        return self._next_turn() is not None

    def _next_turn(self) -> int | None:
        return next((turn for turn in self._turns if turn > self.index), None)

    def local(self, path: PlannedPath, pose: SE2, spacing_m: float) -> LocalPath:
        """The path ahead of the robot: at most `prune_distance`, and up to where it comes back."""
        first_m = path.foot(self.index, pose.x_m, pose.y_m).along_m
        remaining_m = max(self.end_m(path) - first_m, 0.0)
        length_m = min(remaining_m, self._params.prune_distance)
        count = max(1, round(length_m / spacing_m))
        points_m = even_points(path.points_m, path.along_m, first_m, length_m, count)
        step_m = max(length_m / count, 1e-6)
        end = _comes_back(points_m, step_m)
        leads_away = end == len(points_m)
        return LocalPath(
            points_m[: end + 1], step_m, remaining_m,
            leads_away and length_m >= remaining_m, leads_away, self._goal(path),
        )  # fmt: skip

    def _goal(self, path: PlannedPath) -> SE2:
        turn = self._next_turn()
        if turn is None:
            return path.goal
        x_m, y_m = path.points_m[turn].tolist()
        before_x_m, before_y_m = path.point_at(float(path.along_m[turn]) - _SPAN_M)
        return SE2(x_m, y_m, portable_kernels.atan2(y_m - before_y_m, x_m - before_x_m))


def _turns_back(path: PlannedPath) -> list[int]:
    """Indices of the points at which a path turns by more than 120 degrees at once."""
    along_m = path.along_m
    places = [
        np.stack([np.interp(along_m + by_m, along_m, axis) for axis in path.points_m.T], axis=1)
        for by_m in (-_SPAN_M, _SPAN_M)
    ]
    came, leaves = path.points_m - places[0], places[1] - path.points_m
    product = (came * leaves).sum(axis=1)
    lengths = np.sqrt((came * came).sum(axis=1) * (leaves * leaves).sum(axis=1))
    # Of neighbours, the one at which it turns most.
    found: list[int] = []
    for index in np.flatnonzero(product < _BACK_COS * lengths).tolist():
        if found and along_m[index] - along_m[found[-1]] < _SPAN_M:
            before = found[-1]
            if product[index] * lengths[before] < product[before] * lengths[index]:
                found[-1] = index
        else:
            found.append(index)
    return found


@kernel(error_model="numpy")
def _comes_back(points_m: Array, step_m: float) -> int:
    """Index of the point of a path at even steps from which on it comes back to the first one; the
    number of points where it leads away from there all along.
    """
    farthest, most_m = 0, 0.0
    for i in range(len(points_m)):
        dx, dy = points_m[i, 0] - points_m[0, 0], points_m[i, 1] - points_m[0, 1]
        away_m = math.sqrt(dx * dx + dy * dy)
        if i * step_m > _DETOUR * away_m + _DETOUR_M:
            return min(max(farthest, round(_SHORTEST_M / step_m)), len(points_m) - 1)
        if away_m > most_m:
            farthest, most_m = i, away_m
    return len(points_m)
