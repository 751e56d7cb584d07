"""A planned path: points in the map frame with headings, and the nearest point to the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel

_BACKWARDS_M: Final = 1.0
"""No longer piece of a path that somebody gives is driven backwards."""
_LONGEST_LEG_M: Final = 0.1
_MOST_LEGS: Final = 100_000
_PARALLEL_COS: Final = 0.98
"""Of the angle between two directions that are one."""


class Foot(NamedTuple):
    """The place of a path that is nearest to a position."""

    along_m: float
    """Length of the path up to it."""
    off_m: float
    """From there to the position; positive: to the left of the path's direction."""


@dataclass(frozen=True)
class PlannedPath:
    """A path from the robot to its goal. Its last pose is the goal."""

    points_m: Array
    """(n, 2) float64, n >= 2."""
    yaws_rad: Array
    """(n,) float64, the robot's heading: the direction of travel, or the opposite one where it
    drives backwards; the last one is the goal's heading.
    """
    along_m: Array
    """(n,) float64, length of the path up to each point."""
    cost_m: float = 0.0
    """Its length, each piece times 1 + cost_travel_multiplier * cost / 252."""
    way_out_m: float = 0.0
    """So much of its beginning is to be driven straight, before the robot can turn."""

    @property
    def length_m(self) -> float:
        """Length of the whole path."""
        return float(self.along_m[-1])

    def backwards(self) -> NDArray[np.bool_]:
        """(n,) whether the robot leaves each point backwards."""
        steps = np.diff(self.points_m, axis=0)
        cos, sin = portable_kernels.cos_sin_each(self.yaws_rad[:-1])
        return np.append(steps[:, 0] * cos + steps[:, 1] * sin < -1e-9, False)

    @property
    def goal(self) -> SE2:
        """The last pose."""
        return SE2(
            float(self.points_m[-1, 0]), float(self.points_m[-1, 1]), float(self.yaws_rad[-1])
        )

    def nearest(self, x_m: float, y_m: float, first: int, window_m: float) -> int:
        """Index of the point nearest to a position, from index `first` on and within `window_m` of
        path.
        """
        return int(_nearest(self.points_m, self.along_m, x_m, y_m, first, window_m))

    def foot(self, index: int, x_m: float, y_m: float) -> Foot:
        """On the two pieces of the path about the point nearest to a position."""
        best_m, best_square, side = float(self.along_m[index]), math.inf, 1.0
        for i in (index - 1, index):
            if not 0 <= i < len(self.points_m) - 1:
                continue
            (ax, ay), (bx, by) = self.points_m[i].tolist(), self.points_m[i + 1].tolist()
            dx, dy = bx - ax, by - ay
            square = dx * dx + dy * dy
            ratio = 0.0 if square < 1e-18 else ((x_m - ax) * dx + (y_m - ay) * dy) / square
            ratio = min(max(ratio, 0.0), 1.0)
            off_x, off_y = x_m - ax - ratio * dx, y_m - ay - ratio * dy
            off_square = off_x * off_x + off_y * off_y
            if off_square < best_square:
                along_m = self.along_m[i : i + 2]
                best_m = float(along_m[0]) + ratio * float(along_m[1] - along_m[0])
                best_square = off_square
                side = dx * off_y - dy * off_x
        return Foot(best_m, math.copysign(math.sqrt(best_square), side))

    def point_at(self, along_m: float) -> tuple[float, float]:
        """The point at a length along the path; beyond its ends the end points."""
        return (
            float(np.interp(along_m, self.along_m, self.points_m[:, 0])),
            float(np.interp(along_m, self.along_m, self.points_m[:, 1])),
        )


def resample(points_m: Array, spacing_m: float) -> Array:
    """(m, 2) points of a polyline at even steps of about `spacing_m`, with both its ends."""
    steps_m = portable.hypot_each(*np.diff(points_m, axis=0).T)
    keep = np.concatenate([[True], steps_m > 1e-9])
    points_m = points_m[keep]
    if len(points_m) == 1:
        return np.repeat(points_m, 2, axis=0)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m[keep[1:]])])
    count = max(1, round(float(along_m[-1]) / spacing_m))
    at_m = np.linspace(0.0, along_m[-1], count + 1)
    return np.stack(
        [np.interp(at_m, along_m, points_m[:, 0]), np.interp(at_m, along_m, points_m[:, 1])], axis=1
    )


def dense(path: PlannedPath) -> PlannedPath:
    """The path with points between those that are more than 0.1 m apart: where the robot is on it,
    and whether it is free, is found out at its points.
    """
    longest_m = max(_LONGEST_LEG_M, path.length_m / _MOST_LEGS)
    parts = np.maximum(np.ceil(np.diff(path.along_m) / longest_m - 1e-9), 1.0).astype(np.int64)
    if parts.max() == 1:
        return path
    leg = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(leg)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[leg]
    along_m = path.along_m
    at_m = np.append(along_m[leg] + share * np.diff(along_m)[leg], along_m[-1])
    return replace(
        path,
        points_m=np.stack([np.interp(at_m, along_m, axis) for axis in path.points_m.T], axis=1),
        yaws_rad=np.append(path.yaws_rad[leg], path.yaws_rad[-1]),
        along_m=at_m,
    )


@kernel()
def _nearest(
    points_m: Array, along_m: Array, x_m: float, y_m: float, first: int, window_m: float
) -> int:
    most_m = along_m[first] + window_m
    best, least = first, np.inf
    for i in range(first, len(points_m)):
        if along_m[i] > most_m:
            break
        dx, dy = points_m[i, 0] - x_m, points_m[i, 1] - y_m
        square = dx * dx + dy * dy
        if square < least:
            best, least = i, square
    return best


@kernel(error_model="numpy")
def even_points(
    points_m: Array, along_m: Array, first_m: float, length_m: float, count: int
) -> Array:
    """(count + 1, 2) points of a path at even steps over a length of it; beyond its ends the end
    points.
    """
    made = np.empty((count + 1, 2))
    last = len(along_m) - 1
    i = 0
    for k in range(count + 1):
        at_m = first_m + (length_m if k == count else k * (length_m / count))
        while i < last and along_m[i + 1] <= at_m:
            i += 1
        for axis in range(2):
            here = points_m[i, axis]
            if i < last and at_m > along_m[i]:
                slope = (points_m[i + 1, axis] - here) / (along_m[i + 1] - along_m[i])
                here += slope * (at_m - along_m[i])
            made[k, axis] = here
    return made


@kernel()
def _headings_rad(steps: Array) -> Array:
    yaws_rad = np.empty(len(steps))
    for i in range(len(steps)):
        yaws_rad[i] = portable_kernels.atan2(steps[i, 1], steps[i, 0])
    return yaws_rad


def path_through(points_m: Array, goal_yaw_rad: float) -> PlannedPath:
    """Path of (n, 2) points that ends with the goal's heading."""
    points_m = np.ascontiguousarray(points_m, np.float64)
    steps = np.diff(points_m, axis=0)
    lengths_m = portable.hypot_each(steps[:, 0], steps[:, 1])
    yaws_rad = np.append(_headings_rad(steps), goal_yaw_rad)
    return PlannedPath(points_m, yaws_rad, np.concatenate([[0.0], np.cumsum(lengths_m)]))


def with_pieces_backwards(path: PlannedPath, yaws_rad: Array) -> PlannedPath:
    """The path with those pieces backwards that the headings (n,) of its poses ask for: straight
    ones of at most 1 m, as where a robot has no room to turn. Longer ones are driven forwards, and
    headings that are all 0 are none: many planners give none.
    """
    if not yaws_rad[:-1].any():
        return path
    headings = path.yaws_rad.copy()
    cos, _ = portable_kernels.cos_sin_each(yaws_rad[:-1] - path.yaws_rad[:-1])
    against = np.concatenate([[0], np.asarray(cos < -_PARALLEL_COS, np.int8), [0]])
    first, end = (np.flatnonzero(np.diff(against) == step) for step in (1, -1))
    for i, j in zip(first.tolist(), end.tolist(), strict=True):
        if j == i + 1 and _turns_about(float(yaws_rad[i]), float(yaws_rad[j])):
            # The robot comes there like that, and turns on the spot.
            continue
        cos, _ = portable_kernels.cos_sin_each(yaws_rad[i:j] - yaws_rad[i])
        if path.along_m[j] - path.along_m[i] <= _BACKWARDS_M and cos.min() > _PARALLEL_COS:
            headings[i:j] = yaws_rad[i:j]
    return replace(path, yaws_rad=headings)


def _turns_about(before_rad: float, after_rad: float) -> bool:
    cos, _ = portable.cos_sin(after_rad - before_rad)
    return cos < -_PARALLEL_COS
