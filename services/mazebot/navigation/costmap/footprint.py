"""The robot's outline on the floor: a convex polygon in base_footprint, and its distance from the
obstacles of a costmap.

Kernels take the polygon as `Footprint.points_m` and `Footprint.circles`, and a pose in cells: the
column and row of base_footprint, from the corner of cell (0, 0), with the cosine and sine of its
yaw. They may be called by other kernels.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import shared_kernel
from mazebot.common.robot.waffle import WAFFLE_FOOTPRINT_M

Distance = NDArray[np.float32]

_CIRCLE_CORNERS = 16
"""As many as Nav2 gives the footprint of a round robot."""
_FINEST = 0.25
"""Spacing of the points examined on the outline where it is closest to an obstacle, in cells."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """A convex polygon in base_footprint."""

    points_m: Array
    """(n, 2) float64, corners, counter-clockwise, with the padding."""
    inscribed_radius_m: float
    """Radius of the largest circle about base_footprint inside it: Nav2's inscribed radius. A
    waffle's axle is near its front, so that this is only 0.07 m; see `half_width_m`. Of a zone
    that does not enclose base_footprint, 0 or less.
    """
    circumscribed_radius_m: float
    """Radius of the circle about base_footprint around it: what a turn on the spot sweeps."""
    half_width_m: float
    """Its largest extent to the side, which it needs on both sides to drive straight ahead."""
    circles: Array
    """(4,) float64: x and y of its centroid in base_footprint, and the radii of the circles about
    it inside and around the polygon, in metres.
    """

    @staticmethod
    def of(points_m: ArrayLike, padding_m: float = 0.0) -> Footprint:
        """The convex hull of some corners.

        Args:
            points_m: (n, 2), in base_footprint.
            padding_m: each corner moves outwards by this in x and in y, as by Nav2's
                footprint_padding.

        Raises ValueError with a phrase if they enclose no area, or not base_footprint.
        """
        footprint = Footprint.zone(points_m, padding_m)
        if footprint.inscribed_radius_m <= 0.0:
            raise ValueError("must enclose base_footprint, the point [0, 0]")
        return footprint

    @staticmethod
    def zone(points_m: ArrayLike, padding_m: float = 0.0) -> Footprint:
        """As `of`, of corners that need not enclose base_footprint: a zone beside or ahead of it.

        Raises ValueError with a phrase if they enclose no area.
        """
        try:
            points = np.array(points_m, np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError("must be a list of at least 3 points [x, y]") from error
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise ValueError("must be a list of at least 3 points [x, y]")
        hull = _hull(points + np.sign(points) * padding_m)
        if len(hull) < 3:
            raise ValueError("must be at least 3 points that enclose an area")
        centre = _centroid(hull)
        circles = (*centre, _edge_distance_m(hull, centre), _corner_distance_m(hull, centre))
        return Footprint(
            hull,
            _edge_distance_m(hull, (0.0, 0.0)),
            _corner_distance_m(hull, (0.0, 0.0)),
            float(np.abs(hull[:, 1]).max()),
            np.array(circles),
        )

    @staticmethod
    def circle(radius_m: float) -> Footprint:
        """A round robot, as Nav2's robot_radius: 16 corners on the circle."""
        angles = np.arange(_CIRCLE_CORNERS) * (math.tau / _CIRCLE_CORNERS)
        return Footprint.of(radius_m * np.stack(portable_kernels.cos_sin_each(angles), axis=1))

    @staticmethod
    def parse(text: str, padding_m: float = 0.0) -> Footprint:
        """A footprint as in Nav2's parameters: "[[x, y], ...]", in metres.

        Raises ValueError with a phrase.
        """
        try:
            points = json.loads(text)
        except ValueError as error:
            raise ValueError("must be a list of at least 3 points [x, y]") from error
        return Footprint.of(points, padding_m)

    def padded(self, padding_m: float) -> Footprint:
        """The same with more padding."""
        return Footprint.of(self.points_m, padding_m)


def _hull(points: Array) -> Array:
    """Convex hull, counter-clockwise, by Andrew's monotone chain (1979)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    halves = []
    for line in (ordered, ordered[::-1]):
        half: list[tuple[float, float]] = []
        for point in line:
            while len(half) > 1 and _turn(half[-2], half[-1], point) <= 0.0:
                half.pop()
            half.append(point)
        halves.append(half[:-1])
    return np.array(halves[0] + halves[1]).reshape(-1, 2)


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _centroid(hull: Array) -> tuple[float, float]:
    twice, x, y = 0.0, 0.0, 0.0
    for a, b in zip(hull.tolist(), np.roll(hull, -1, axis=0).tolist(), strict=True):
        cross = a[0] * b[1] - a[1] * b[0]
        twice += cross
        x += (a[0] + b[0]) * cross
        y += (a[1] + b[1]) * cross
    return x / (3.0 * twice), y / (3.0 * twice)


def _edge_distance_m(hull: Array, at: tuple[float, float]) -> float:
    """Distance from a point inside to the nearest edge; below 0 outside."""
    a, b = hull, np.roll(hull, -1, axis=0)
    edges = b - a
    left = edges[:, 0] * (at[1] - a[:, 1]) - edges[:, 1] * (at[0] - a[:, 0])
    return float((left / portable.hypot_each(edges[:, 0], edges[:, 1])).min())


def _corner_distance_m(hull: Array, at: tuple[float, float]) -> float:
    return float(portable.hypot_each(hull[:, 0] - at[0], hull[:, 1] - at[1]).max())


WAFFLE: Final = Footprint.of(WAFFLE_FOOTPRINT_M)
"""A TurtleBot3 waffle, without padding."""


@shared_kernel(inline=True)
def distance_at(distance_m: Distance, column: float, row: float) -> float:
    """Distance to the nearest obstacle, interpolated bilinearly between the centres of cells; 0
    outside the grid. Column and row from the corner of cell (0, 0): its centre is at (0.5, 0.5).
    """
    rows, columns = distance_m.shape
    if not (0.0 <= column < columns and 0.0 <= row < rows):
        return 0.0
    across = min(max(column - 0.5, 0.0), columns - 1.0)
    up = min(max(row - 0.5, 0.0), rows - 1.0)
    c, r = int(across), int(up)
    c1, r1 = min(c + 1, columns - 1), min(r + 1, rows - 1)
    a, b = across - c, up - r
    low = distance_m[r, c] * (1.0 - a) + distance_m[r, c1] * a
    high = distance_m[r1, c] * (1.0 - a) + distance_m[r1, c1] * a
    return float(low * (1.0 - b) + high * b)


@shared_kernel(inline=True)
def _distance_within(distance_m: Distance, resolution_m: float, column: float, row: float) -> float:
    """As `distance_at`, or to the edge of the grid where that is nearer."""
    rows, columns = distance_m.shape
    edge = min(column, columns - column, row, rows - row)
    return float(min(distance_at(distance_m, column, row), edge * resolution_m))


@shared_kernel()
def footprint_clearance_m(
    distance_m: Distance,
    resolution_m: float,
    points_m: Array,
    circles: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
) -> float:
    """Distance of the polygon from the obstacles and the edge of the grid; below 0 how deep an
    obstacle is inside it.

    Where it is more than 5 cm, a lower bound. Else it is that of the interpolated distance on the
    outline, examined at the corners and between them at most a quarter of a cell from its least.
    """
    away_m = _away_m(distance_m, resolution_m, circles, column, row, cos_yaw, sin_yaw)
    if away_m - circles[3] > 0.05:
        return float(away_m - circles[3])
    best_m = _outline_m(distance_m, resolution_m, points_m, column, row, cos_yaw, sin_yaw)
    if away_m < circles[3] + resolution_m:
        best_m = min(
            best_m,
            _inside_m(distance_m, resolution_m, points_m, circles, column, row, cos_yaw, sin_yaw),
        )
    return best_m


@shared_kernel()
def footprint_in_collision(
    distance_m: Distance,
    resolution_m: float,
    points_m: Array,
    circles: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
    margin_m: float,
) -> bool:
    """Whether the polygon is within a margin of an obstacle, or of the edge of the grid: as
    `footprint_clearance_m` <= margin, and faster.
    """
    away_m = _away_m(distance_m, resolution_m, circles, column, row, cos_yaw, sin_yaw)
    if away_m > circles[3] + margin_m:
        return False
    if away_m <= circles[2] + margin_m:
        return True
    count = len(points_m)
    ax, ay = points_m[count - 1, 0], points_m[count - 1, 1]
    a_column = column + (cos_yaw * ax - sin_yaw * ay) / resolution_m
    a_row = row + (sin_yaw * ax + cos_yaw * ay) / resolution_m
    a_m = _distance_within(distance_m, resolution_m, a_column, a_row)
    finest_m = _FINEST * resolution_m
    for i in range(count):
        bx, by = points_m[i, 0], points_m[i, 1]
        b_column = column + (cos_yaw * bx - sin_yaw * by) / resolution_m
        b_row = row + (sin_yaw * bx + cos_yaw * by) / resolution_m
        b_m = _distance_within(distance_m, resolution_m, b_column, b_row)
        if b_m <= margin_m:
            return True
        length_m = math.sqrt((bx - ax) * (bx - ax) + (by - ay) * (by - ay))
        at_m, here_m = 0.0, a_m
        # The distance changes by no more than the way: the rest of an edge may be far enough.
        while here_m + b_m - (length_m - at_m) <= 2.0 * margin_m:
            at_m += max(here_m - margin_m, finest_m)
            if at_m >= length_m:
                break
            t = at_m / length_m
            here_m = _distance_within(
                distance_m,
                resolution_m,
                a_column + t * (b_column - a_column),
                a_row + t * (b_row - a_row),
            )
            if here_m <= margin_m:
                return True
        ax, ay, a_column, a_row, a_m = bx, by, b_column, b_row, b_m
    return (
        _inside_m(distance_m, resolution_m, points_m, circles, column, row, cos_yaw, sin_yaw)
        <= margin_m
    )


@shared_kernel(inline=True)
def _away_m(
    distance_m: Distance,
    resolution_m: float,
    circles: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
) -> float:
    """Distance at the centroid."""
    return _distance_within(
        distance_m,
        resolution_m,
        column + (cos_yaw * circles[0] - sin_yaw * circles[1]) / resolution_m,
        row + (sin_yaw * circles[0] + cos_yaw * circles[1]) / resolution_m,
    )


@shared_kernel()
def _outline_m(
    distance_m: Distance,
    resolution_m: float,
    points_m: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
) -> float:
    """Least interpolated distance on the outline."""
    count = len(points_m)
    finest_m = _FINEST * resolution_m
    best_m = np.inf
    for i in range(count):
        ax, ay = points_m[i, 0], points_m[i, 1]
        j = i + 1 if i + 1 < count else 0
        dx, dy = points_m[j, 0] - ax, points_m[j, 1] - ay
        length_m = math.sqrt(dx * dx + dy * dy)
        # The edge of the grid is nearest at a corner.
        corner_m = _distance_within(
            distance_m,
            resolution_m,
            column + (cos_yaw * ax - sin_yaw * ay) / resolution_m,
            row + (sin_yaw * ax + cos_yaw * ay) / resolution_m,
        )
        best_m = min(best_m, corner_m)
        at_m = max(corner_m - best_m, finest_m)
        while at_m < length_m:
            x, y = ax + dx * (at_m / length_m), ay + dy * (at_m / length_m)
            here_m = distance_at(
                distance_m,
                column + (cos_yaw * x - sin_yaw * y) / resolution_m,
                row + (sin_yaw * x + cos_yaw * y) / resolution_m,
            )
            best_m = min(best_m, here_m)
            # Within the difference nothing can be nearer than the best.
            at_m += max(here_m - best_m, finest_m)
    return best_m


@shared_kernel()
def _inside_m(
    distance_m: Distance,
    resolution_m: float,
    points_m: Array,
    circles: Array,
    column: float,
    row: float,
    cos_yaw: float,
    sin_yaw: float,
) -> float:
    """Below 0: how deep the innermost centre of a lethal cell is inside; inf where none is."""
    rows, columns = distance_m.shape
    c = column + (cos_yaw * circles[0] - sin_yaw * circles[1]) / resolution_m
    r = row + (sin_yaw * circles[0] + cos_yaw * circles[1]) / resolution_m
    reach = circles[3] / resolution_m
    deepest_m = np.inf
    for i in range(max(math.ceil(r - reach - 0.5), 0), min(int(r + reach - 0.5) + 1, rows)):
        for j in range(max(math.ceil(c - reach - 0.5), 0), min(int(c + reach - 0.5) + 1, columns)):
            if distance_m[i, j] > 0.0:
                continue
            along, up = (j + 0.5 - column) * resolution_m, (i + 0.5 - row) * resolution_m
            outside_m = signed_distance_m(
                points_m, cos_yaw * along + sin_yaw * up, cos_yaw * up - sin_yaw * along
            )
            if outside_m < 0.0:
                deepest_m = min(deepest_m, outside_m)
    return deepest_m


@shared_kernel()
def signed_distance_m(points_m: Array, x_m: float, y_m: float) -> float:
    """Distance of a point in base_footprint from the polygon, below 0 inside."""
    count = len(points_m)
    inside_m = -np.inf
    square_m2 = np.inf
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        ax, ay = points_m[i, 0], points_m[i, 1]
        ex, ey = points_m[j, 0] - ax, points_m[j, 1] - ay
        px, py = x_m - ax, y_m - ay
        length2 = ex * ex + ey * ey
        inside_m = max(inside_m, (ey * px - ex * py) / math.sqrt(length2))
        t = min(max((px * ex + py * ey) / length2, 0.0), 1.0)
        fx, fy = px - t * ex, py - t * ey
        square_m2 = min(square_m2, fx * fx + fy * fy)
    return inside_m if inside_m <= 0.0 else math.sqrt(square_m2)
