"""Poses moved to where a scan fits the map best: Gauss-Newton on the field of distances.

The ends of the beams are drawn to the nearest faces of walls (Kohlbrecher and others, 2011, on a
distance field), with weights that fall with the distance (Geman and McClure), so that returns from
things that are not in the map do not pull. Where the walls leave a direction open, as along a
corridor, the pose stays where it was.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.localization.likelihood_field import LikelihoodField

_WIDE_M, _NARROW_M = 0.3, 0.08
"""Scale of the distances whose returns pull, in the first and the last iterations."""


def refine(
    field: LikelihoodField,
    poses: Array,
    points_m: Array,
    *,
    prior_std_m: float,
    prior_std_rad: float,
    return_std_m: float,
    wide: int = 5,
    narrow: int = 5,
) -> tuple[Array, Array]:
    """(n, 3) poses that fit a scan best near the given ones, and their (n, 3, 3) information.

    `points_m` (m, 2) are the ends of the beams in the base's frame. The prior holds each pose near
    where it was; `return_std_m` is the scatter of the mean of all returns about the walls, times
    the root of their number. Iterations: `wide` with a wide pull, then `narrow`.
    """
    moved = np.ascontiguousarray(poses, np.float64).copy()
    information = np.zeros((len(moved), 3, 3))
    pose = field.map_from_field
    _refine(
        moved, np.ascontiguousarray(points_m), field.distance_m, 1.0 / field.cell_m, pose.x_m,
        pose.y_m, pose.yaw_rad, 1.0 / (prior_std_m * prior_std_m),
        1.0 / (prior_std_rad * prior_std_rad), 1.0 / (return_std_m * return_std_m),
        wide, narrow, information,
    )  # fmt: skip
    return moved, information


@kernel(
    "void(float64[:, ::1], float64[:, ::1], float32[:, ::1], float64, float64, float64, float64, "
    "float64, float64, float64, int64, int64, float64[:, :, ::1])",
)
def _refine(
    poses: Array,
    points: Array,
    distance: NDArray[np.float32],
    cells_per_m: float,
    field_x: float,
    field_y: float,
    field_yaw: float,
    prior: float,
    prior_yaw: float,
    each: float,
    wide: int,
    narrow: int,
    information: Array,
) -> None:
    rows, columns = distance.shape
    cf, sf = portable_kernels.cos_sin(field_yaw)
    h = np.zeros((3, 3))
    b = np.zeros(3)
    for i in range(poses.shape[0]):
        x0 = cf * (poses[i, 0] - field_x) + sf * (poses[i, 1] - field_y)
        y0 = cf * (poses[i, 1] - field_y) - sf * (poses[i, 0] - field_x)
        yaw0 = poses[i, 2] - field_yaw
        x, y, yaw = x0, y0, yaw0
        for iteration in range(wide + narrow):
            scale = _WIDE_M if iteration < wide else _NARROW_M
            c, s = portable_kernels.cos_sin(yaw)
            h[:] = 0.0
            h[0, 0] = h[1, 1] = prior
            h[2, 2] = prior_yaw
            b[0], b[1], b[2] = prior * (x0 - x), prior * (y0 - y), prior_yaw * (yaw0 - yaw)
            for j in range(points.shape[0]):
                rx = c * points[j, 0] - s * points[j, 1]
                ry = s * points[j, 0] + c * points[j, 1]
                u = (x + rx) * cells_per_m - 0.5
                v = (y + ry) * cells_per_m - 0.5
                if u < 0.0 or v < 0.0 or u >= columns - 1 or v >= rows - 1:
                    continue
                column, row = int(u), int(v)
                fu, fv = u - column, v - row
                d00, d01 = float(distance[row, column]), float(distance[row, column + 1])
                d10, d11 = float(distance[row + 1, column]), float(distance[row + 1, column + 1])
                low, high = d00 + fu * (d01 - d00), d10 + fu * (d11 - d10)
                off = low + fv * (high - low)
                gx = ((1.0 - fv) * (d01 - d00) + fv * (d11 - d10)) * cells_per_m
                gy = (high - low) * cells_per_m
                ratio = off / scale
                weight = 1.0 / (1.0 + ratio * ratio)
                weight *= weight * each
                gt = gy * rx - gx * ry
                h[0, 0] += weight * gx * gx
                h[0, 1] += weight * gx * gy
                h[0, 2] += weight * gx * gt
                h[1, 1] += weight * gy * gy
                h[1, 2] += weight * gy * gt
                h[2, 2] += weight * gt * gt
                b[0] -= weight * gx * off
                b[1] -= weight * gy * off
                b[2] -= weight * gt * off
            # Cholesky's factors of the 3 x 3; the prior keeps them positive.
            l00 = math.sqrt(h[0, 0])
            l10, l20 = h[0, 1] / l00, h[0, 2] / l00
            l11 = math.sqrt(max(h[1, 1] - l10 * l10, 1e-9))
            l21 = (h[1, 2] - l10 * l20) / l11
            l22 = math.sqrt(max(h[2, 2] - l20 * l20 - l21 * l21, 1e-9))
            z0 = b[0] / l00
            z1 = (b[1] - l10 * z0) / l11
            z2 = (b[2] - l20 * z0 - l21 * z1) / l22
            turn = z2 / l22
            dy = (z1 - l21 * turn) / l11
            dx = (z0 - l10 * dy - l20 * turn) / l00
            # A step beyond the field's validity would be a guess.
            longest = max(abs(dx), abs(dy)) / 0.2
            shrink = 1.0 / max(1.0, longest, abs(turn) / 0.2)
            x += shrink * dx
            y += shrink * dy
            yaw += shrink * turn
            if abs(dx) < 1e-4 and abs(dy) < 1e-4 and abs(turn) < 1e-4 and iteration >= wide:
                break
        h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
        poses[i, 0] = field_x + cf * x - sf * y
        poses[i, 1] = field_y + sf * x + cf * y
        poses[i, 2] = (yaw + field_yaw + math.pi) % (2.0 * math.pi) - math.pi
        # Information of x and y in the map's axes.
        xx, xy, yy = h[0, 0], h[0, 1], h[1, 1]
        information[i, 0, 0] = cf * cf * xx - 2.0 * cf * sf * xy + sf * sf * yy
        information[i, 1, 1] = sf * sf * xx + 2.0 * cf * sf * xy + cf * cf * yy
        information[i, 0, 1] = cf * sf * (xx - yy) + (cf * cf - sf * sf) * xy
        information[i, 0, 2] = cf * h[0, 2] - sf * h[1, 2]
        information[i, 1, 2] = sf * h[0, 2] + cf * h[1, 2]
        information[i, 1, 0] = information[i, 0, 1]
        information[i, 2, 0] = information[i, 0, 2]
        information[i, 2, 1] = information[i, 1, 2]
        information[i, 2, 2] = h[2, 2]
