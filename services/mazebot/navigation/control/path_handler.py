"""The part of the path that is ahead: Nav2's FeasiblePathHandler."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2, Array
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
    """Length of the whole path that is left, beyond these points too."""
    ends: bool
    """Whether the last point is the goal."""


class PathHandler:
    """Keeps a path and how far the robot has come on it."""

    def __init__(self, params: PathHandlerParams) -> None:
        self._params = params
        self.path: PlannedPath | None = None
        self.index = 0
        self._backwards = np.empty(0, np.bool_)
        self._ahead = np.empty(0, np.int64)
        """Points that the path leaves forwards."""

    def set_path(self, path: PlannedPath | None) -> None:
        """Begin at the start of a path; None: there is none."""
        self.path, self.index = path, 0
        if path is not None:
            self._backwards = path.backwards()
            self._ahead = np.flatnonzero(~self._backwards)

    def advance(self, path: PlannedPath, pose: SE2) -> float:
        """Find the point nearest to the robot; returns the length of the path that is left."""
        search_m = self._params.max_robot_pose_search_dist
        straight_m = abs(self.straight_m(path))
        if straight_m > 0.0:
            # What follows may lead along the same way in the other direction.
            search_m = min(search_m, straight_m + 1e-9)
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

    def local(self, path: PlannedPath, pose: SE2, spacing_m: float) -> LocalPath:
        """The path from the robot on, at most `prune_distance` of it."""
        first_m = path.foot(self.index, pose.x_m, pose.y_m).along_m
        remaining_m = max(path.length_m - first_m, 0.0)
        length_m = min(remaining_m, self._params.prune_distance)
        count = max(1, round(length_m / spacing_m))
        points_m = even_points(path.points_m, path.along_m, first_m, length_m, count)
        step_m = max(length_m / count, 1e-6)
        return LocalPath(points_m, step_m, remaining_m, length_m >= remaining_m)
