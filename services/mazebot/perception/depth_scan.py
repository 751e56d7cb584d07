"""A depth image as a scan of what stands between the floor and the robot's top, as
`depthimage_to_laserscan` makes one of a single height: what a lidar's plane misses.

A beam is the nearest thing in its part of the image, or infinite where that shows only floor. Where
the camera measured neither, it is minus infinity: no measurement, by REP 117. Of what is lower than
the camera it sees the top, of a table the board from below: a beam also tells how far that reaches,
since the robot may come round to where the camera does not look.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.robot.waffle import FOOT_M, TOP_M

Depths = NDArray[np.float32]

_SLOT_M: Final = 0.05
"""Points of one thing are this near to one another, along a beam."""
_MOST_EMPTY: Final = 1
"""Slots without a point within a thing: what is seen at a flat angle has a row in each second."""
_COLUMN_STEP: Final = 2
"""Columns of the image from one that is used to the next."""
_LEAST_AHEAD_M: Final = 0.4
"""What comes into view nearer to the axle than this is met before the robot has stopped: it drives
0.46 m/s, slows down by 1 m/s in a second, and its front is 0.07 m ahead.
"""
_VERTICAL: Final = 1e-3
"""The level part of an axis that has no heading."""


class DepthScanParams(Params):
    """What counts as an obstacle; heights by Nav2's names for an observation source."""

    enabled: bool = Field(True, description="whether depth images are made into scans")
    min_obstacle_height: float = Field(
        FOOT_M, ge=0.0, le=1.0, description="m above the floor; what is lower is floor"
    )
    max_obstacle_height: float = Field(
        TOP_M, gt=0.0, le=3.0, description="m above the floor; what is higher, the robot passes"
    )
    floor_slope: float = Field(
        0.006,
        ge=0.0,
        le=0.2,
        description="how much higher things must be for each metre of distance: the floor looks "
        "tilted where the robot or its camera is, by 0.34 degrees here",
    )
    min_points: int = Field(4, ge=1, le=1000, description="pixels of a thing; fewer are noise")
    range_max_m: float = Field(
        3.5, gt=0.1, le=20.0, description="farther depths are too coarse to tell things from floor"
    )
    beams: int = Field(160, ge=2, le=4096, description="beams over the image's width")

    @property
    def tilt_tolerance_rad(self) -> float:
        """Of a robot that is tilted more, the floor at `range_max_m` would be an obstacle."""
        return self.floor_slope + self.min_obstacle_height / self.range_max_m


@dataclass(frozen=True, eq=False)
class DepthScan:
    """Beams at equal angles from the right to the left, seen from above."""

    ranges_m: NDArray[np.float32]
    """(n,): `inf` where the camera sees only floor, `-inf` where it measured nothing."""
    reaches_m: NDArray[np.float32]
    """(n,): how far the thing at a beam's range reaches behind it, as far as it is seen."""
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    """The floor is seen from here on. What is nearer may be below the image, or between the camera
    and its shortest depth: it is not known to be free.
    """
    range_max_m: float
    """No floor is seen from here on: of a camera that looks down, less than the parameter."""


def unseen_ahead(
    size_px: tuple[int, int],
    intrinsics: Array,
    base_from_optical: Array,
    yaw_rad: float,
    params: DepthScanParams,
) -> str:
    """Where a camera looks that does not see the floor ahead of the robot; empty: it sees it.

    Args:
        size_px: width and height of its pictures.
        intrinsics: (3, 3) of a pinhole without distortion, pixels.
        base_from_optical: rigid (4, 4).
        yaw_rad: heading of the camera in base_footprint.
        params: see there.
    """
    floor = _floor(
        *_rays(intrinsics, *size_px),
        _level_rotation(base_from_optical, yaw_rad), float(base_from_optical[2, 3]),
    )  # fmt: skip
    sees = "no floor"
    if floor is not None and floor.near_m < params.range_max_m:
        far_m = min(floor.far_m, params.range_max_m)
        right_rad, left_rad = portable.atan2(floor.right, 1.0), portable.atan2(floor.left, 1.0)
        ahead = right_rad < -yaw_rad < left_rad
        if ahead and float(base_from_optical[0, 3]) + far_m >= _LEAST_AHEAD_M:
            return ""
        sees = f"the floor there from {floor.near_m:.2f} to {far_m:.2f} m"
    x, y, z = base_from_optical[:3, 2].tolist()
    level = math.sqrt(x * x + y * y)
    down_rad = portable.atan2(-z, level)
    left_rad = portable.atan2(y, x) if level > _VERTICAL else 0.0
    return (
        f"it looks {round(math.degrees(down_rad))} degrees down and "
        f"{round(math.degrees(left_rad))} degrees to the left, and sees {sees}; "
        f"must see the floor at least up to {_LEAST_AHEAD_M:g} m ahead of the axle"
    )


def depth_scan(
    depth_m: Depths,
    intrinsics: Array,
    base_from_optical: Array,
    yaw_rad: float,
    params: DepthScanParams,
) -> DepthScan | None:
    """The scan of a depth image; None where the camera does not see the floor.

    Args:
        depth_m: (h, w), along the optical axis; NaN and 0: nothing measured.
        intrinsics: (3, 3) of a pinhole without distortion, pixels.
        base_from_optical: rigid (4, 4).
        yaw_rad: heading, in base_footprint, of the frame that angles are to be in.
        params: see there.
    """
    height, width = depth_m.shape
    across, down = _rays(intrinsics, width, height)
    rotation = _level_rotation(base_from_optical, yaw_rad)
    camera_m = float(base_from_optical[2, 3])
    floor = _floor(across, down, rotation, camera_m)
    if floor is None or floor.near_m >= params.range_max_m:
        return None
    left, right = floor.left, floor.right
    beams = params.beams
    slots = math.ceil(params.range_max_m / _SLOT_M) + 1
    by_tangent, reaches = np.empty(beams, np.float32), np.zeros(beams, np.float32)
    _nearest(
        depth_m, across, down, rotation, camera_m,
        right, beams / (left - right), params.min_obstacle_height, params.max_obstacle_height,
        params.floor_slope, params.range_max_m, params.min_points,
        np.zeros((beams, slots), np.int32), np.zeros((beams, slots), np.float64), by_tangent,
        reaches,
    )  # fmt: skip
    first, step, borders = _borders(right, left, beams)
    return DepthScan(
        *_by_angle(by_tangent, reaches, borders),
        first + step / 2.0, step, floor.near_m, min(floor.far_m, params.range_max_m),
    )  # fmt: skip


def _rays(intrinsics: Array, width: int, height: int) -> tuple[Array, Array]:
    """(w,) x and (h,) y of the pixels' rays in the optical frame, at depth 1."""
    fx, fy, cx, cy = (float(intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    across: Array = ((np.arange(width) - cx) / fx).astype(np.float64)
    down: Array = ((np.arange(height) - cy) / fy).astype(np.float64)
    return across, down


def _level_rotation(base_from_optical: Array, yaw_rad: float) -> Array:
    """(3, 3) from the optical frame to a level one of this heading in base_footprint."""
    c, s = portable.cos_sin(yaw_rad)
    turned = portable.product(
        np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), base_from_optical[:3, :3]
    )
    return np.ascontiguousarray(turned)


class _Floor(NamedTuple):
    """What a picture shows of the floor, seen from above."""

    near_m: float
    far_m: float
    """`inf`: up to the horizon."""
    right: float
    """Tangent of the bearing of its right border"""
    left: float


def _floor(across: Array, down: Array, rotation: Array, camera_m: float) -> _Floor | None:
    """The floor before a camera, None where it sees none; arguments as for `_nearest`.

    The camera may be mounted on its head or on its side. The picture's lowest side sees the floor
    nearest, the one across from it farthest; their middles stand for them.
    """
    ends = (
        (1, down[-1], down[0]), (1, down[0], down[-1]),
        (0, across[-1], across[0]), (0, across[0], across[-1]),
    )  # fmt: skip
    axis, lowest, highest = min(
        ends, key=lambda one: float(rotation[2, one[0]]) * math.copysign(1.0, one[1])
    )
    other, along = (0, across) if axis == 1 else (1, down)
    middle = rotation[:, other] * float(along[len(along) // 2])
    low, high = (middle + rotation[:, axis] * end + rotation[:, 2] for end in (lowest, highest))
    is_level = bool(high[2] >= 0.0)
    if not (low[2] < 0.0 and (is_level or high[0] > 0.0)):
        return None
    # At the height of the camera where it sees that far, else at the farthest floor.
    border = rotation[:, 2] if is_level else rotation[:, axis] * highest + rotation[:, 2]
    tangents = [
        float(rotation[1, other] * end + border[1])
        / max(float(rotation[0, other] * end + border[0]), 1e-3)
        for end in (along[0], along[-1])
    ]
    if not min(tangents) < max(tangents):
        return None
    near_m = _reach_m(low, camera_m) if low[0] > 0.0 else 0.0
    far_m = math.inf if is_level else _reach_m(high, camera_m)
    return _Floor(near_m, far_m, min(tangents), max(tangents))


def _reach_m(ray: Array, camera_m: float) -> float:
    """Where a ray that goes down meets the floor, seen from above."""
    return camera_m / -float(ray[2]) * math.sqrt(float(ray[0] * ray[0] + ray[1] * ray[1]))


def compile_kernels() -> None:
    """Compile the kernels before the first image."""
    looking_down = np.array(
        [[0.0, -0.6, 0.8, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -0.8, -0.6, 0.1], [0.0, 0.0, 0.0, 1.0]]
    )
    intrinsics = np.array([[8.0, 0.0, 4.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]])
    depth_scan(np.zeros((8, 8), np.float32), intrinsics, looking_down, 0.0, DepthScanParams())


# All images of a camera have the same beams.
@functools.lru_cache(maxsize=8)
def _borders(right: float, left: float, beams: int) -> tuple[float, float, NDArray[np.int64]]:
    """The first angle between two tangents, the step to the next, and the (beams + 1,) places of
    all of them among as many steps of the tangent.
    """
    first, last = portable.atan2(right, 1.0), portable.atan2(left, 1.0)
    step = (last - first) / beams
    tangents = np.array([portable.tan(first + step * i) for i in range(beams + 1)])
    at = np.clip(np.floor((tangents - right) * (beams / (left - right)) + 1e-9), 0, beams - 1)
    return first, step, at.astype(np.int64)


@kernel(nogil=True, error_model="numpy")
def _nearest(
    depth_m: Depths,
    across: Array,
    down: Array,
    rotation: Array,
    camera_m: float,
    first_tangent: float,
    beams_per_tangent: float,
    low_m: float,
    high_m: float,
    slope: float,
    range_max_m: float,
    min_points: int,
    counts: NDArray[np.int32],
    sums_m: Array,
    ranges_m: NDArray[np.float32],
    reaches_m: NDArray[np.float32],
) -> None:
    """The range of the nearest thing of enough points in each of equal steps of the bearing's
    tangent, and how far it reaches behind that.

    Args:
        depth_m: (h, w).
        across: (w,) x of the pixels' rays in the optical frame, at depth 1.
        down: (h,) y likewise.
        rotation: (3, 3) from the optical frame to a level one.
        camera_m: height of the camera.
        first_tangent: of the first beam's right border.
        beams_per_tangent: beams in a step of 1 of the tangent.
        low_m: what is lower is floor.
        high_m: what is higher is passed below.
        slope: added to `low_m` for each metre.
        range_max_m: of things and of floor.
        min_points: of a thing, and of floor.
        counts: (beams, slots) zeros.
        sums_m: (beams, slots) zeros.
        ranges_m: (beams,), is given the ranges.
        reaches_m: (beams,) zeros, is given how far the things reach behind them.
    """
    height, width = depth_m.shape
    beams, slots = counts.shape
    floor = np.zeros(beams, np.int32)
    for v in range(height):
        fx, fy, fz = (
            rotation[0, 1] * down[v] + rotation[0, 2],
            rotation[1, 1] * down[v] + rotation[1, 2],
            rotation[2, 1] * down[v] + rotation[2, 2],
        )
        for u in range(0, width, _COLUMN_STEP):
            depth = depth_m[v, u]
            # Neither holds for what is no number.
            if not (depth > 0.0):
                continue
            up_m = camera_m + depth * (fz + rotation[2, 0] * across[u])
            if not (up_m < high_m):
                continue
            x_m, y_m = (
                depth * (fx + rotation[0, 0] * across[u]),
                depth * (fy + rotation[1, 0] * across[u]),
            )
            if x_m <= 0.0:
                continue
            squared_m2 = x_m * x_m + y_m * y_m
            if squared_m2 >= range_max_m * range_max_m:
                continue
            beam = int((y_m / x_m - first_tangent) * beams_per_tangent)
            if beam < 0 or beam >= beams:
                continue
            if up_m <= low_m:
                # Most pixels: they need no range.
                floor[beam] += 1
                continue
            range_m = math.sqrt(squared_m2)
            if up_m <= low_m + slope * range_m:
                floor[beam] += 1
            else:
                slot = int(range_m / _SLOT_M)
                counts[beam, slot] += 1
                sums_m[beam, slot] += range_m
    for beam in range(beams):
        ranges_m[beam] = np.inf if floor[beam] >= min_points else -np.inf
        for slot in range(slots - 1):
            here, behind = counts[beam, slot], counts[beam, slot + 1]
            if here >= min_points:
                ranges_m[beam] = sums_m[beam, slot] / here
            elif here > 0 and here + behind >= min_points:
                ranges_m[beam] = (sums_m[beam, slot] + sums_m[beam, slot + 1]) / (here + behind)
            else:
                continue
            last = slot
            for other in range(slot + 1, slots):
                if counts[beam, other] > 0:
                    last = other
                elif other - last > _MOST_EMPTY:
                    break
            reach_m = sums_m[beam, last] / counts[beam, last] - ranges_m[beam]
            reaches_m[beam] = max(reach_m, 0.0)
            break


@kernel()
def _by_angle(
    by_tangent: NDArray[np.float32], reaches: NDArray[np.float32], borders: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Ranges at equal steps of the angle, the nearest of all beams that a step covers, and how far
    these reach.
    """
    ranges_m, reaches_m = np.empty_like(by_tangent), np.zeros_like(reaches)
    for i in range(ranges_m.size):
        nearest, measured = np.float32(np.inf), True
        for j in range(borders[i], borders[i + 1] + 1):
            measured &= by_tangent[j] > 0.0
            if 0.0 < by_tangent[j] < nearest:
                nearest = by_tangent[j]
                reaches_m[i] = reaches[j]
        # What is not measured is not free.
        ranges_m[i] = nearest if measured or np.isfinite(nearest) else -np.inf
    return ranges_m, reaches_m
