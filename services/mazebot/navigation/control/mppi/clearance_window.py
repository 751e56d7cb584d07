"""The distance to obstacles around the robot, on a fine grid in which MPPI looks up footprints.

One lookup per point is several times as fast as interpolation, at 2 cm cells within 14 mm of it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.collision import Surroundings
from mazebot.navigation.control.mppi.rollouts import Floats
from mazebot.navigation.costmap.footprint import Footprint, signed_distance_m

CELL_M: Final = 0.02
_FAR_M: Final = 0.5
"""Distances beyond it do not matter to the robot."""
_EXPLAINED_M: Final = 0.1
"""An echo this near to an obstacle of the costmap is that obstacle's."""
_BESIDE_M: Final = 0.15
"""An echo this near to a track's disc is the track's: its position is from the last scan."""
_CORNER_SHARE: Final = 0.4
"""Radius of the discs in the corners, as a share of that of the disc in the middle."""
_UNCOVERED_M: Final = 0.01
"""A corner this near to a disc is covered by it."""
_LETHAL: Final = 254


class ClearanceWindow:
    """A square around the robot, along the axes of the map."""

    def __init__(self, reach_m: float) -> None:
        """A square that reaches `reach_m` to each side."""
        self.size = 2 * math.ceil(reach_m / CELL_M) + 1
        self.low_m = np.float32(-CELL_M * self.size / 2.0)
        """x and y of its first corner, from the robot."""
        self.distance_m: Floats = np.zeros(self.size * self.size, np.float32)
        """(size * size,), row by row."""

    def update(self, around: Surroundings, without_tracks: bool) -> None:
        """Look up the costmap, and mark the echoes that it does not explain; `without_tracks` not
        those of the moving obstacles, which are judged by where they will be.
        """
        costmap, pose = around.costmap, around.map_from_base
        frame = costmap.frame
        _look_up(
            costmap.distance_m,
            costmap.costs,
            (pose.x_m - frame.origin_x_m) / frame.resolution_m,
            (pose.y_m - frame.origin_y_m) / frame.resolution_m,
            CELL_M / frame.resolution_m,
            self.size,
            self.distance_m,
        )
        if len(around.echoes_m):
            tracks = around.tracks if without_tracks else ()
            discs = [(t.x_m - pose.x_m, t.y_m - pose.y_m, t.radius_m + _BESIDE_M) for t in tracks]
            _mark_echoes(
                self.distance_m, self.size, around.echoes_m, *portable.cos_sin(pose.yaw_rad),
                np.array(discs, np.float64).reshape(-1, 3),
            )  # fmt: skip

    def time_to_wall_s(
        self,
        x_m: float,
        y_m: float,
        vx_m_s: float,
        vy_m_s: float,
        radius_m: float,
        horizon_s: float,
    ) -> float:
        """Time until a disc that moves at a constant velocity meets something; inf where it does
        not within the horizon, or is in contact from the start.
        """
        return float(
            _time_to_wall_s(
                self.distance_m, self.size, float(self.low_m), x_m, y_m, vx_m_s, vy_m_s, radius_m,
                horizon_s,
            )
        )  # fmt: skip


def covering_discs(footprint: Footprint) -> Floats:
    """(n, 3) x, y and radius of discs in base_footprint that nearly cover the footprint: one in the
    middle, and in each corner that the others do not cover one that touches both of its edges.

    What they leave out, at most 3 cm at a waffle's corners, the collision margin covers.
    """
    points = footprint.points_m
    middle_x, middle_y, inside_m, _ = footprint.circles.tolist()
    radius_m = _CORNER_SHARE * inside_m
    discs = [(middle_x, middle_y, inside_m)]
    for i in range(len(points)):
        corner = points[i].tolist()
        if min(math.hypot(corner[0] - x, corner[1] - y) - r for x, y, r in discs) < _UNCOVERED_M:
            continue
        x, y = _corner_disc(points[i - 1], points[i], points[(i + 1) % len(points)], radius_m)
        # A disc that does not fit between its edges is smaller.
        discs.append((x, y, max(min(radius_m, -float(signed_distance_m(points, x, y))), 0.0)))
    return np.array(discs, np.float32)


def _corner_disc(
    before: Array, corner: Array, after: Array, radius_m: float
) -> tuple[float, float]:
    """Centre of the disc that touches both edges at a corner."""
    ax, ay = (before - corner).tolist()
    bx, by = (after - corner).tolist()
    a_m, b_m = math.hypot(ax, ay), math.hypot(bx, by)
    ax, ay, bx, by = ax / a_m, ay / a_m, bx / b_m, by / b_m
    # The half angle's sine from that of the angle between the edges.
    sine = math.sqrt(max((1.0 - (ax * bx + ay * by)) / 2.0, 1e-6))
    cx, cy = ax + bx, ay + by
    length = max(math.hypot(cx, cy), 1e-6)
    away_m = radius_m / sine
    return float(corner[0]) + cx / length * away_m, float(corner[1]) + cy / length * away_m


@kernel(error_model="numpy")
def _time_to_wall_s(
    distance_m: Floats,
    size: int,
    low_m: float,
    x_m: float,
    y_m: float,
    vx_m_s: float,
    vy_m_s: float,
    radius_m: float,
    horizon_s: float,
) -> float:
    """Every 0.1 s; beyond the window the distance is that at its edge."""
    for k in range(int(horizon_s / 0.1) + 1):
        t = 0.1 * k
        column = min(max(int((x_m + vx_m_s * t - low_m) / CELL_M), 0), size - 1)
        row = min(max(int((y_m + vy_m_s * t - low_m) / CELL_M), 0), size - 1)
        if distance_m[row * size + column] <= radius_m:
            return t if k > 0 else np.inf
    return np.inf


@kernel(error_model="numpy")
def _look_up(
    distance_m: Floats,
    costs: NDArray[np.uint8],
    column: float,
    row: float,
    step: float,
    size: int,
    out: Floats,
) -> None:
    """Interpolate between the centres of cells, 0 in lethal ones; beyond the map its edge."""
    rows, columns = distance_m.shape
    first = np.empty(size, np.int64)
    second = np.empty(size, np.int64)
    share = np.empty(size, np.float32)
    for i in range(size):
        at = min(max(column + (i - (size - 1) / 2) * step - 0.5, 0.0), columns - 1.0)
        first[i] = int(at)
        second[i] = min(first[i] + 1, columns - 1)
        share[i] = np.float32(at - first[i])
    low = np.empty(columns, np.float32)
    one = np.float32(1.0)
    left, right = first[0], second[size - 1]
    for j in range(size):
        at = min(max(row + (j - (size - 1) / 2) * step - 0.5, 0.0), rows - 1.0)
        a = int(at)
        b = min(a + 1, rows - 1)
        up = np.float32(at - a)
        for i in range(left, right + 1):
            below = distance_m[a, i] if costs[a, i] != _LETHAL else np.float32(0.0)
            above = distance_m[b, i] if costs[b, i] != _LETHAL else np.float32(0.0)
            low[i] = below * (one - up) + above * up
        for i in range(size):
            t = share[i]
            out[j * size + i] = low[first[i]] * (one - t) + low[second[i]] * t


@kernel(error_model="numpy")
def _mark_echoes(
    out: Floats, size: int, echoes_m: Array, cos_yaw: float, sin_yaw: float, moving_m: Array
) -> None:
    middle, reach = (size - 1) / 2.0, int(_FAR_M / CELL_M)
    count = 0
    at = np.empty((len(echoes_m), 2))
    for i in range(len(echoes_m)):
        ahead, aside = echoes_m[i, 0], echoes_m[i, 1]
        x = (cos_yaw * ahead - sin_yaw * aside) / CELL_M + middle
        y = (sin_yaw * ahead + cos_yaw * aside) / CELL_M + middle
        if not (0.0 <= x < size - 0.5 and 0.0 <= y < size - 0.5):
            continue
        marks = out[int(y + 0.5) * size + int(x + 0.5)] >= _EXPLAINED_M
        for j in range(len(moving_m)):
            dx, dy = (x - middle) * CELL_M - moving_m[j, 0], (y - middle) * CELL_M - moving_m[j, 1]
            marks = marks and dx * dx + dy * dy > moving_m[j, 2] * moving_m[j, 2]
        if marks:
            at[count, 0], at[count, 1] = x, y
            count += 1
    for i in range(count):
        x, y = at[i, 0], at[i, 1]
        column, row = int(x + 0.5), int(y + 0.5)
        if out[row * size + column] < CELL_M:
            # Another echo has marked this place.
            continue
        for r in range(max(row - reach, 0), min(row + reach + 1, size)):
            for c in range(max(column - reach, 0), min(column + reach + 1, size)):
                square = (c - x) * (c - x) + (r - y) * (r - y)
                here = np.float32(math.sqrt(square) * CELL_M)
                out[r * size + c] = min(out[r * size + c], here)
