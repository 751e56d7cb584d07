"""A robot with a lidar among straight walls, in memory: true poses, odometry and scans."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan
from mazebot.mapping.slam import Slam

SCAN_NS = 100_000_000
WHEELS_APART_M = 0.287


LDS_PLACE = SE2(-0.064, 0.0, 0.0)


@dataclass(frozen=True)
class Lidar:
    """Beams from `angle_min_rad` on, counter-clockwise."""

    beams: int = 360
    angle_min_rad: float = 0.0
    increment_rad: float = math.tau / 360
    range_min_m: float = 0.12
    range_max_m: float = 3.5
    noise_m: float = 0.01
    base_from_scan: SE2 = LDS_PLACE


LDS = Lidar()
SICK = Lidar(180, -math.pi / 2, math.pi / 180, 0.1, 30.0, 0.015, SE2(0.1, 0.0, 0.0))


@dataclass(frozen=True)
class Step:
    """One scan's time."""

    stamp_ns: int
    true: SE2
    odom: SE2
    ranges_m: NDArray[np.float32]


@kernel("void(float64[:, ::1], float64, float64, float64[::1], float64[::1])")
def _cast(walls: Array, x: float, y: float, angles: Array, ranges: Array) -> None:
    for i in range(angles.size):
        dx, dy = math.cos(angles[i]), math.sin(angles[i])
        for k in range(walls.shape[0]):
            ax, ay = walls[k, 0] - x, walls[k, 1] - y
            ex, ey = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
            cross = dx * ey - dy * ex
            if abs(cross) < 1e-12:
                continue
            along = (ax * ey - ay * ex) / cross
            across = (ax * dy - ay * dx) / cross
            if along > 0.0 and 0.0 <= across <= 1.0 and along < ranges[i]:
                ranges[i] = along


def box(x0: float, y0: float, x1: float, y1: float) -> Array:
    """(4, 4) sides of a rectangle."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


def wall(x0: float, y0: float, x1: float, y1: float, thick_m: float = 0.15) -> Array:
    """(4, 4) faces of a wall along an axis, with its ends."""
    half = thick_m / 2.0
    if abs(x1 - x0) > abs(y1 - y0):
        return box(min(x0, x1), y0 - half, max(x0, x1), y0 + half)
    return box(x0 - half, min(y0, y1), x0 + half, max(y0, y1))


def scan(walls: Array, pose: SE2, lidar: Lidar, random: np.random.Generator) -> NDArray[np.float32]:
    """The ranges from a pose of the base; inf where nothing is in range."""
    sensor = pose @ lidar.base_from_scan
    beams = np.arange(lidar.beams, dtype=np.float64)
    angles: Array = sensor.yaw_rad + lidar.angle_min_rad + lidar.increment_rad * beams
    ranges: Array = np.full(lidar.beams, np.inf)
    _cast(np.ascontiguousarray(walls), sensor.x_m, sensor.y_m, angles, ranges)
    ranges += lidar.noise_m * random.standard_normal(lidar.beams)
    ranges[~(ranges < lidar.range_max_m)] = np.inf
    return ranges.astype(np.float32)


def way(
    points: list[tuple[float, float]], speed_m_s: float = 0.22, turn_rad_s: float = 1.0
) -> list[SE2]:
    """Poses at each scan along straight lines, with turns on the spot between them."""
    step_s = SCAN_NS * 1e-9
    x, y = points[0]
    yaw = math.atan2(points[1][1] - y, points[1][0] - x)
    poses = [SE2(x, y, yaw)]
    for to_x, to_y in points[1:]:
        heading = math.atan2(to_y - y, to_x - x)
        turn = wrap_angle(heading - yaw)
        for i in range(1, math.ceil(abs(turn) / (turn_rad_s * step_s)) + 1):
            share = i / math.ceil(abs(turn) / (turn_rad_s * step_s))
            poses.append(SE2(x, y, wrap_angle(yaw + share * turn)))
        yaw = heading
        length = math.hypot(to_x - x, to_y - y)
        count = max(1, math.ceil(length / (speed_m_s * step_s)))
        poses += [
            SE2(x + (to_x - x) * i / count, y + (to_y - y) * i / count, yaw)
            for i in range(1, count + 1)
        ]
        x, y = to_x, to_y
    return poses


def log(
    walls: Array,
    poses: list[SE2],
    lidar: Lidar = LDS,
    *,
    slip: float = 0.0,
    noise_m_per_sqrt_m: float = 0.0,
    seed: int = 1,
) -> list[Step]:
    """What the robot measures on its way; odometry begins at the origin.

    `slip`: share of the travel that odometry counts too much; the noise is each wheel's.
    """
    random = np.random.default_rng(seed)
    odom = SE2(0.0, 0.0, 0.0)
    steps = []
    for i, pose in enumerate(poses):
        if i:
            moved = poses[i - 1].inverse() @ pose
            travel = math.copysign(math.hypot(moved.x_m, moved.y_m), moved.x_m)
            wheels = np.array([-0.5, 0.5]) * WHEELS_APART_M * moved.yaw_rad + travel
            wheels *= 1.0 + slip
            wheels += noise_m_per_sqrt_m * np.sqrt(np.abs(wheels)) * random.standard_normal(2)
            ahead, turn = wheels.mean(), (wheels[1] - wheels[0]) / WHEELS_APART_M
            odom = odom @ SE2(
                float(ahead * math.cos(turn / 2)), float(ahead * math.sin(turn / 2)), float(turn)
            )
        steps.append(Step((i + 1) * SCAN_NS, pose, odom, scan(walls, pose, lidar, random)))
    return steps


def feed(slam: Slam, steps: list[Step], lidar: Lidar = LDS) -> Iterator[Step]:
    """Give a robot's measurements to a Slam, and yield each step after its scan."""
    for step in steps:
        slam.odometry(step.stamp_ns, step.odom)
        slam.scan(
            Scan(
                step.ranges_m,
                lidar.angle_min_rad,
                lidar.increment_rad,
                lidar.range_min_m,
                lidar.range_max_m,
                lidar.base_from_scan,
                step.stamp_ns,
            )
        )
        yield step


def error(pose: SE2, true: SE2) -> tuple[float, float]:
    """Distance in metres and angle in radians between two poses."""
    return (
        math.hypot(pose.x_m - true.x_m, pose.y_m - true.y_m),
        abs(wrap_angle(pose.yaw_rad - true.yaw_rad)),
    )


def errors(slam: Slam, steps: list[Step], lidar: Lidar = LDS) -> Array:
    """(n, 2) errors of the pose after each scan, in metres and radians."""
    return np.array([error(slam.pose()[0], step.true) for step in feed(slam, steps, lidar)])


def ring(side_m: float = 9.0, lane_m: float = 1.6) -> Array:
    """A square way round a block, with niches so that it is not the same everywhere."""
    parts = [box(0.0, 0.0, side_m, side_m), box(lane_m, lane_m, side_m - lane_m, side_m - lane_m)]
    for i, at in enumerate((1.1, 2.9, 4.2, 6.3, 7.7)):
        deep = 0.25 + 0.1 * i
        parts += [
            wall(at, 0.0, at, deep),
            wall(side_m - deep, at, side_m, at),
            wall(side_m - at, side_m - deep, side_m - at, side_m),
            wall(0.0, side_m - at + 0.2, deep, side_m - at + 0.2),
        ]
    return np.concatenate(parts)


def ring_way(side_m: float = 9.0, lane_m: float = 1.6, rounds: int = 1) -> list[SE2]:
    """Along the middle of `ring`, counter-clockwise, and on to the second corner."""
    a, b = lane_m / 2.0 + 0.1, side_m - lane_m / 2.0 - 0.1
    corners = [(a, a), (b, a), (b, b), (a, b)]
    return way([*(corners * rounds), (a, a), (b, a)])


def office() -> Array:
    """An office of 40 x 25 m: corridors round two blocks, and rooms along the outer sides."""
    random = np.random.default_rng(3)
    parts = [box(4.0, 4.0, 19.0, 21.0), box(21.0, 4.0, 36.0, 21.0)]
    # The outer side of the corridors, with a door to each room; rooms are 2 m deep or more.
    sides = [((2.0, 2.0), (38.0, 2.0)), ((38.0, 2.0), (38.0, 23.0)),
             ((38.0, 23.0), (2.0, 23.0)), ((2.0, 23.0), (2.0, 2.0))]  # fmt: skip
    for (x0, y0), (x1, y1) in sides:
        length = math.hypot(x1 - x0, y1 - y0)
        tx, ty = (x1 - x0) / length, (y1 - y0) / length
        out_x, out_y = ty, -tx
        at = 0.0
        while at < length - 0.5:
            width = min(float(random.uniform(2.5, 4.5)), length - at)
            door = at + float(random.uniform(0.4, max(0.5, width - 1.4)))
            deep = float(random.uniform(2.0, 5.0))
            spans = [(at, min(door, at + width)), (min(door + 0.9, at + width), at + width)]
            for begin, end in spans:
                p, q = (x0 + tx * begin, y0 + ty * begin), (x0 + tx * end, y0 + ty * end)
                parts.append(np.array([[*p, *q]]))
            p = (x0 + tx * at, y0 + ty * at)
            q = (p[0] + out_x * deep, p[1] + out_y * deep)
            r = (q[0] + tx * width, q[1] + ty * width)
            s = (p[0] + tx * width, p[1] + ty * width)
            parts.append(np.array([[*p, *q], [*q, *r], [*r, *s]]))
            at += width
    return np.concatenate(parts)


def office_way(rounds: int = 1) -> list[SE2]:
    """Round both blocks, and through the corridor between them, at the speed of a robot of 1 m."""
    points = [(3.0, 3.0)]
    for _ in range(rounds):
        points += [(20.0, 3.0), (20.0, 22.0), (3.0, 22.0), (3.0, 3.0), (37.0, 3.0), (37.0, 22.0),
                   (3.0, 22.0), (3.0, 3.0)]  # fmt: skip
    return way(points, speed_m_s=0.6, turn_rad_s=0.8)


def drifted(steps: list[Step], true: SE2) -> float:
    """How far odometry alone is off at the end."""
    return error(true @ steps[-1].odom, steps[-1].true)[0]
