"""Parts of planned paths: how much is left, cut pieces, and pieces joined."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.navigation.planning.path import PlannedPath

_BESIDE_M = 0.3
"""A robot this much farther from a place on a path than from another one may be at either."""


def nearest_index(
    path: PlannedPath, pose: SE2, search_m: float = math.inf, angular_distance_weight: float = 0.0
) -> int:
    """Index of the point of a path nearest to a pose, within a length from the path's beginning."""
    count = int(np.searchsorted(path.along_m, search_m, side="right")) if search_m >= 0.0 else None
    points = path.points_m[:count]
    squares = portable.square(points[:, 0] - pose.x_m) + portable.square(points[:, 1] - pose.y_m)
    if angular_distance_weight > 0.0:
        turned = [abs(wrap_angle(float(yaw) - pose.yaw_rad)) for yaw in path.yaws_rad[:count]]
        squares = np.sqrt(squares) + angular_distance_weight * np.array(turned)
    return int(np.argmin(squares))


def begin_index(path: PlannedPath, pose: SE2) -> int:
    """Index of the point at which a robot at a pose takes up a path: where the path comes as near
    to it as anywhere, or hardly less, for the first time. Later it may come by again, as the end of
    a round does.
    """
    squares = portable.square(path.points_m[:, 0] - pose.x_m)
    distances_m = np.sqrt(squares + portable.square(path.points_m[:, 1] - pose.y_m))
    near = distances_m <= distances_m.min() + _BESIDE_M
    first = int(np.argmax(near))
    gone = np.flatnonzero(~near[first:])
    end = first + int(gone[0]) if len(gone) else len(near)
    return first + int(np.argmin(distances_m[first:end]))


def length_left_m(path: PlannedPath, pose: SE2, search_m: float = math.inf) -> float:
    """Length of a path from the point nearest to a pose to its end."""
    return path.length_m - float(path.along_m[nearest_index(path, pose, search_m)])


def pose_on(path: PlannedPath, index: int) -> SE2:
    """Pose of one point of a path; a negative index counts from its end. Raises IndexError."""
    x_m, y_m = path.points_m[index].tolist()
    return SE2(x_m, y_m, float(path.yaws_rad[index]))


def piece(path: PlannedPath, first: int, end: int) -> PlannedPath:
    """The points from one index up to before another; a single point is doubled."""
    end = min(max(end, first + 1), len(path.points_m))
    first = min(first, end - 1)
    at = np.arange(first, end) if end - first > 1 else np.array([first, first])
    way_out_m = max(path.way_out_m - float(path.along_m[at][0]), 0.0)
    return _path(path.points_m[at], path.yaws_rad[at], way_out_m)


def without_end(path: PlannedPath, distance_m: float) -> PlannedPath:
    """The path without its last part, which ends this far along it before the goal."""
    keep = int(np.searchsorted(path.along_m, path.length_m - distance_m, side="right"))
    return piece(path, 0, max(keep, 1))


def around(path: PlannedPath, index: int, back_m: float, ahead_m: float) -> PlannedPath:
    """The part of a path about one point; negative lengths: up to the path's end."""
    along_m = float(path.along_m[index])
    first, end = 0, len(path.points_m)
    if back_m >= 0.0:
        first = int(np.searchsorted(path.along_m, along_m - back_m, side="left"))
    if ahead_m >= 0.0:
        end = int(np.searchsorted(path.along_m, along_m + ahead_m, side="right"))
    return piece(path, first, end)


def joined(first: PlannedPath, second: PlannedPath) -> PlannedPath:
    """One path after another."""
    return _path(
        np.concatenate([first.points_m, second.points_m]),
        np.concatenate([first.yaws_rad, second.yaws_rad]),
        first.way_out_m,
    )


def _path(points_m: Array, yaws_rad: Array, way_out_m: float) -> PlannedPath:
    steps = np.diff(points_m, axis=0)
    lengths_m = portable.hypot_each(steps[:, 0], steps[:, 1])
    along_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    return PlannedPath(points_m, yaws_rad, along_m, way_out_m=way_out_m)
