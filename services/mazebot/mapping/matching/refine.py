"""A pose moved to where a scan fits the local map best: Gauss-Newton on distances to its lines.

Each return is drawn to the line of the surfel nearest to it (point to line: Censi, ICRA 2008), with
weights that fall with the distance (Geman and McClure), so that returns from things that are not in
the map do not pull. The pose that odometry predicts counts with its own covariance. Where the lines
leave a direction open, as along a corridor, odometry alone decides on it: the scatter of the lines'
directions must not pass for knowledge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.mapping.matching.local_map import LocalMap

FIT_M = 0.1
"""A return this near to a line fits the map."""
_WIDE_M, _NARROW_M = 0.2, 0.05
"""Scale of the distances whose returns pull, in the first and the last iterations."""
_WIDE, _NARROW = 15, 10
"""Iterations at most of each."""
_FACING = 0.35
"""A line constrains a direction if the cosine to its normal is more than this: normals scatter."""
_FEW = 4.0
"""So many returns must constrain a direction, else it is open..."""
FEW_SHARE = 1.0 / 30.0
"""...and this share of those that fit."""
_POINT_WEIGHT = 0.1
"""Along its line, of a surfel that is none: corners and posts hold a little in both directions."""
_PARTS = 16
"""Parts of a scan, of neighbouring returns, whose pulls are compared."""


@dataclass(frozen=True)
class Refined:
    """A pose that fits, and how sure that is."""

    map_from_base: SE2
    information: Array
    """(3, 3) of x, y in the map and yaw, by the scan alone; 0 in a direction that is open"""
    fit: float
    """Share of the returns that fit the map, 0 to 1."""
    open_direction: bool
    """Whether the lines leave one direction open."""
    discord: float = 1.0
    """How much more the parts of the scan pull in different directions than returns would that err
    by `return_std_m`, each for itself: a factor of the variance of the pose.
    """


def refine(
    local: LocalMap,
    predicted: SE2,
    prior_information: Array,
    points_m: Array,
    sensor: SE2,
    return_std_m: float,
    start: SE2 | None = None,
    few_share: float = FEW_SHARE,
    views: Array | None = None,
    pull_m: float = _WIDE_M,
) -> Refined:
    """Fit a scan's returns (n, 2), in the base's frame, to a local map.

    Args:
        local: the map.
        predicted: map_from_base by odometry.
        prior_information: (3, 3), the inverse of the prediction's covariance.
        points_m: the returns.
        sensor: base_from_scan.
        return_std_m: scatter of a return about its line; more than the lidar's noise, since
            neighbours share errors.
        start: where to begin, if not at the prediction.
        few_share: this share of the returns that fit must constrain a direction, else it is open.
        views: (n, 2) direction of each return to where it was seen from, if that is not the sensor.
        pull_m: scale of the distances whose returns pull in the first iterations: less where the
            start is sure.
    """
    begin = predicted if start is None else start
    pose = np.array(begin, np.float64)
    prior = np.array(predicted, np.float64)
    prior[2] = begin.yaw_rad + wrap_angle(predicted.yaw_rad - begin.yaw_rad)
    information = np.zeros((3, 3))
    if len(points_m) == 0 or not local.has_surfels:
        return Refined(begin, information, 0.0, True)
    if views is None:
        views = np.array([sensor.x_m, sensor.y_m]) - points_m
    fit, is_open, discord = _refine(
        pose, prior, np.ascontiguousarray(prior_information, np.float64),
        np.ascontiguousarray(points_m), np.ascontiguousarray(views), local.surfels, local.nearest,
        local.x_m, local.y_m, 1.0 / local.cell_m, 1.0 / (return_std_m * return_std_m), few_share,
        pull_m, information,
    )  # fmt: skip
    x_m, y_m, yaw_rad = pose.tolist()
    return Refined(SE2(x_m, y_m, wrap_angle(yaw_rad)), information, fit, bool(is_open), discord)


@kernel(
    "UniTuple(float64, 3)(float64[::1], float64[::1], float64[:, ::1], float64[:, ::1], "
    "float64[:, ::1], float64[:, ::1], int32[:, ::1], float64, float64, float64, float64, float64, "
    "float64, float64[:, ::1])"
)
def _refine(
    pose: Array,
    prior: Array,
    prior_information: Array,
    points: Array,
    views: Array,
    surfels: Array,
    nearest: NDArray[np.int32],
    x0: float,
    y0: float,
    cells_per_m: float,
    each: float,
    few_share: float,
    wide_m: float,
    information: Array,
) -> tuple[float, float, float]:
    rows, columns = nearest.shape
    h = np.zeros((3, 3))
    b = np.zeros(3)
    pulls = np.zeros((_PARTS, 3))
    weak_x = weak_y = weaker = 0.0
    narrow = False
    left = _WIDE
    fit = 0.0
    discord = 1.0
    while True:
        scale = _NARROW_M if narrow else wide_m
        c, s = portable_kernels.cos_sin(pose[2])
        h[:] = 0.0
        b[:] = 0.0
        pulls[:] = 0.0
        fitting = 0
        # The information by lines that clearly face a direction, of each return as 1.
        facing_xx = facing_xy = facing_yy = 0.0
        for j in range(points.shape[0]):
            rx = c * points[j, 0] - s * points[j, 1]
            ry = s * points[j, 0] + c * points[j, 1]
            x, y = pose[0] + rx, pose[1] + ry
            column = math.floor((x - x0) * cells_per_m)
            row = math.floor((y - y0) * cells_per_m)
            if row < 0 or column < 0 or row >= rows or column >= columns:
                continue
            k = nearest[row, column]
            if k < 0:
                continue
            nx, ny = surfels[k, 2], surfels[k, 3]
            dx, dy = x - surfels[k, 0], y - surfels[k, 1]
            vx, vy = views[j, 0], views[j, 1]
            if nx * (c * vx - s * vy) + ny * (s * vx + c * vy) < 0.0:
                # The other face of a wall.
                continue
            off = nx * dx + ny * dy
            along = nx * dy - ny * dx
            # Beyond the surfel's own surroundings its line may have ended.
            if abs(along) > 3.0 * scale:
                continue
            ratio = off / scale
            weight = 1.0 / (1.0 + ratio * ratio)
            weight *= weight * each
            if abs(off) < FIT_M and abs(along) < 2.0 * FIT_M:
                fitting += 1
            gt = ny * rx - nx * ry
            h[0, 0] += weight * nx * nx
            h[0, 1] += weight * nx * ny
            h[0, 2] += weight * nx * gt
            h[1, 1] += weight * ny * ny
            h[1, 2] += weight * ny * gt
            h[2, 2] += weight * gt * gt
            b[0] -= weight * nx * off
            b[1] -= weight * ny * off
            b[2] -= weight * gt * off
            part = pulls[j * _PARTS // points.shape[0]]
            part[0] -= weight * nx * off
            part[1] -= weight * ny * off
            part[2] -= weight * gt * off
            facing_xx += weight * nx * nx
            facing_xy += weight * nx * ny
            facing_yy += weight * ny * ny
            if surfels[k, 4] < 0.5:
                ratio = along / scale
                weight = _POINT_WEIGHT / (1.0 + ratio * ratio)
                weight *= each
                tt = nx * rx + ny * ry
                h[0, 0] += weight * ny * ny
                h[0, 1] -= weight * ny * nx
                h[0, 2] -= weight * ny * tt
                h[1, 1] += weight * nx * nx
                h[1, 2] += weight * nx * tt
                h[2, 2] += weight * tt * tt
                b[0] += weight * ny * along
                b[1] -= weight * nx * along
                b[2] -= weight * tt * along
                part[0] += weight * ny * along
                part[1] -= weight * nx * along
                part[2] -= weight * tt * along
        fit = fitting / points.shape[0]
        if narrow and left == _NARROW:
            # The direction that the lines face least.
            half, differ = 0.5 * (facing_xx + facing_yy), 0.5 * (facing_xx - facing_yy)
            root = math.sqrt(differ * differ + facing_xy * facing_xy)
            ex, ey = facing_xy, -root - differ
            if differ < 0.0:
                ex, ey = differ - root, facing_xy
            length = math.sqrt(ex * ex + ey * ey)
            if length < 1e-12 * (1.0 + half):
                ex, ey, length = 1.0, 0.0, 1.0
            ex, ey = ex / length, ey / length
            constrained = all_weight = 0.0
            for j in range(points.shape[0]):
                x = pose[0] + c * points[j, 0] - s * points[j, 1]
                y = pose[1] + s * points[j, 0] + c * points[j, 1]
                column = math.floor((x - x0) * cells_per_m)
                row = math.floor((y - y0) * cells_per_m)
                if row < 0 or column < 0 or row >= rows or column >= columns:
                    continue
                k = nearest[row, column]
                if k < 0:
                    continue
                nx, ny = surfels[k, 2], surfels[k, 3]
                off = nx * (x - surfels[k, 0]) + ny * (y - surfels[k, 1])
                if abs(off) > FIT_M:
                    continue
                cosine = nx * ex + ny * ey
                squared = cosine * cosine
                if surfels[k, 4] < 0.5:
                    squared = _POINT_WEIGHT
                all_weight += squared
                if surfels[k, 4] < 0.5 or abs(cosine) > _FACING:
                    constrained += squared
            if constrained < max(_FEW, few_share * fitting):
                weaker = 1.0
            elif all_weight > 0.0:
                weaker = 1.0 - math.sqrt(constrained / all_weight)
            weak_x, weak_y = ex, ey
        last = narrow and left <= 0
        if last:
            discord = _discord(h, pulls, weak_x, weak_y, weaker == 1.0)
        if weaker == 1.0 or (last and weaker > 0.0):
            # S h S with S = 1 - weaker e e^T on x and y.
            hx = h[0, 0] * weak_x + h[0, 1] * weak_y
            hy = h[0, 1] * weak_x + h[1, 1] * weak_y
            hh = (hx * weak_x + hy * weak_y) * weaker * weaker
            ht = (h[0, 2] * weak_x + h[1, 2] * weak_y) * weaker
            hx *= weaker
            hy *= weaker
            h[0, 0] += hh * weak_x * weak_x - 2.0 * hx * weak_x
            h[0, 1] += hh * weak_x * weak_y - hx * weak_y - hy * weak_x
            h[1, 1] += hh * weak_y * weak_y - 2.0 * hy * weak_y
            h[0, 2] -= ht * weak_x
            h[1, 2] -= ht * weak_y
            bb = (b[0] * weak_x + b[1] * weak_y) * weaker
            b[0] -= bb * weak_x
            b[1] -= bb * weak_y
        if last:
            break
        px, py, pt = prior[0] - pose[0], prior[1] - pose[1], prior[2] - pose[2]
        q = prior_information
        a00, a01, a02 = h[0, 0] + q[0, 0], h[0, 1] + q[0, 1], h[0, 2] + q[0, 2]
        a11, a12, a22 = h[1, 1] + q[1, 1], h[1, 2] + q[1, 2], h[2, 2] + q[2, 2]
        r0 = b[0] + q[0, 0] * px + q[0, 1] * py + q[0, 2] * pt
        r1 = b[1] + q[0, 1] * px + q[1, 1] * py + q[1, 2] * pt
        r2 = b[2] + q[0, 2] * px + q[1, 2] * py + q[2, 2] * pt
        # Cholesky's factors of the 3 x 3; the prior keeps them positive.
        l00 = math.sqrt(max(a00, 1e-9))
        l10, l20 = a01 / l00, a02 / l00
        l11 = math.sqrt(max(a11 - l10 * l10, 1e-9))
        l21 = (a12 - l10 * l20) / l11
        l22 = math.sqrt(max(a22 - l20 * l20 - l21 * l21, 1e-9))
        z0 = r0 / l00
        z1 = (r1 - l10 * z0) / l11
        z2 = (r2 - l20 * z0 - l21 * z1) / l22
        turn = z2 / l22
        dy = (z1 - l21 * turn) / l11
        dx = (z0 - l10 * dy - l20 * turn) / l00
        # A step beyond the lines' validity would be a guess.
        shrink = 1.0 / max(1.0, max(abs(dx), abs(dy)) / 0.2, abs(turn) / 0.2)
        pose[0] += shrink * dx
        pose[1] += shrink * dy
        pose[2] += shrink * turn
        left -= 1
        small = abs(dx) < 1e-4 and abs(dy) < 1e-4 and abs(turn) < 1e-4
        if narrow and small:
            left = 0
        elif not narrow and (left <= 0 or max(abs(dx), abs(dy), abs(turn)) < 0.002):
            narrow = True
            left = _NARROW
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    information[:] = h
    return fit, 1.0 if weaker == 1.0 else 0.0, discord


@kernel("float64(float64[:, ::1], float64[:, ::1], float64, float64, boolean)")
def _discord(h: Array, pulls: Array, open_x: float, open_y: float, is_open: bool) -> float:
    """The mean of pull^T h^-1 pull over the directions that are not open, of all parts together.

    The pulls of returns that err each for itself, as the information h has it, make it 1.
    """
    a00, a01, a11 = h[0, 0], h[0, 1], h[1, 1]
    if is_open:
        # Nothing moves in the open direction.
        held = 1e3 * (a00 + a11)
        a00 += held * open_x * open_x
        a01 += held * open_x * open_y
        a11 += held * open_y * open_y
    l00 = math.sqrt(max(a00, 1e-9))
    l10, l20 = a01 / l00, h[0, 2] / l00
    l11 = math.sqrt(max(a11 - l10 * l10, 1e-9))
    l21 = (h[1, 2] - l10 * l20) / l11
    l22 = math.sqrt(max(h[2, 2] - l20 * l20 - l21 * l21, 1e-9))
    total = 0.0
    for k in range(pulls.shape[0]):
        x, y = pulls[k, 0], pulls[k, 1]
        if is_open:
            along = x * open_x + y * open_y
            x, y = x - along * open_x, y - along * open_y
        z0 = x / l00
        z1 = (y - l10 * z0) / l11
        z2 = (pulls[k, 2] - l20 * z0 - l21 * z1) / l22
        total += z0 * z0 + z1 * z1 + z2 * z2
    return total / (2.0 if is_open else 3.0)
