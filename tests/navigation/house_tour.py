"""A drive through the house without physics: true poses, slipping odometry, exact lidar scans."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.world.footprint import wall_corners
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world

ODOMETRY_NS = 33_333_333
SCAN_NS = 100_000_000
SCAN_OFFSET_NS = 12_000_000
"""Scans fall between the samples of odometry."""
BEAMS = 360
ANGLE_INCREMENT_RAD = 2.0 * math.pi / BEAMS
RANGE_MIN_M, RANGE_MAX_M = 0.12, 3.5
RANGE_STD_M = 0.01
BASE_FROM_SCAN = SE2(-0.064, 0.0, 0.0)

# From the start to locations 1, 2, 3 and 4 and back, 0.3 m and more from every wall.
STATIONS: tuple[tuple[tuple[float, float], ...], ...] = (
    ((0.0, 0.0), (-1.17, -1.07), (-1.678, -1.178)),
    ((-1.47, -1.18), (-0.92, -0.62), (-0.92, 1.82), (-0.32, 2.43), (-0.17, 2.83), (-0.178, 3.322)),
    ((-0.27, 2.52), (-0.92, 1.82), (-0.88, 0.12), (-0.27, -0.48), (0.43, -0.82), (1.33, -0.88),
     (1.73, -1.07), (2.58, -1.07), (3.33, -0.33), (3.322, -0.178)),
    ((4.12, -0.12), (4.78, 0.48), (4.88, 0.68), (4.83, 1.88), (4.28, 2.43), (2.68, 2.43),
     (2.072, 1.822)),
    ((2.68, 2.43), (4.28, 2.43), (4.88, 1.73), (4.88, 0.68), (4.23, -0.07), (3.73, -0.27),
     (3.23, -0.77), (2.58, -1.07), (1.73, -1.07), (1.33, -0.88), (0.43, -0.82), (0.03, -0.42),
     (0.0, 0.0)),
)  # fmt: skip


@cache
def house() -> LoadedWorld:
    """The house maze with its map."""
    return load_world("sim_house", use_aruco=False)


@cache
def wall_segments() -> Array:
    """(n, 4) faces of the house's walls as x0, y0, x1, y1."""
    faces = []
    for wall in house().world.walls:
        corners = wall_corners(wall)
        faces += [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return np.array(faces)


def cast(map_from_scan: SE2, segments: Array, beams: int = BEAMS) -> Array:
    """(beams,) exact distances to the nearest face, not to be modified; inf where there is none."""
    return _cast(map_from_scan, np.asarray(segments, np.float64).tobytes(), beams)


# Most tests begin at the same place, and robots stand still.
@lru_cache(maxsize=2000)
def _cast(map_from_scan: SE2, faces: bytes, beams: int) -> Array:
    segments = np.frombuffer(faces).reshape(-1, 4)
    angles = map_from_scan.yaw_rad + np.arange(beams) * (2.0 * math.pi / beams)
    dx, dy = np.cos(angles)[:, None], np.sin(angles)[:, None]
    ax, ay = segments[:, 0] - map_from_scan.x_m, segments[:, 1] - map_from_scan.y_m
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = dx * ey - dy * ex
        along_ray = (ax * ey - ay * ex) / across
        along_face = (ax * dy - ay * dx) / across
        hit = (along_ray > 0.0) & (along_face >= 0.0) & (along_face <= 1.0)
    exact_m = np.asarray(np.where(hit, along_ray, np.inf).min(axis=1))
    exact_m.setflags(write=False)
    return exact_m


def scan_at(map_from_base: SE2, rng: np.random.Generator | None = None) -> NDArray[np.float32]:
    """A scan as the lidar gives it: noisy, -inf what is too near, inf what is too far."""
    exact = cast(map_from_base @ BASE_FROM_SCAN, wall_segments())
    return as_ranges(exact, rng)


def as_ranges(exact_m: Array, rng: np.random.Generator | None) -> NDArray[np.float32]:
    """Exact distances with noise and the limits of the lidar."""
    noisy = exact_m.copy()
    if rng is not None:
        noisy += RANGE_STD_M * rng.standard_normal(len(noisy))
    noisy[noisy > RANGE_MAX_M] = np.inf
    noisy[noisy < RANGE_MIN_M] = -np.inf
    return noisy.astype(np.float32)


@dataclass(frozen=True)
class Drive:
    """True poses at each sample of odometry; stamp and exact distances of each scan."""

    poses: list[SE2]
    scan_stamps_ns: list[int]
    scan_exact_m: list[Array]


def interpolated(poses: list[SE2], stamp_ns: int) -> SE2:
    """The true pose between two samples."""
    i = min(stamp_ns // ODOMETRY_NS, len(poses) - 2)
    a, b = poses[i], poses[i + 1]
    t = (stamp_ns - i * ODOMETRY_NS) / ODOMETRY_NS
    return SE2(
        a.x_m + t * (b.x_m - a.x_m),
        a.y_m + t * (b.y_m - a.y_m),
        wrap_angle(a.yaw_rad + t * wrap_angle(b.yaw_rad - a.yaw_rad)),
    )


@cache
def tour(speed_m_s: float = 0.4, stations: int = len(STATIONS)) -> Drive:
    """A drive by pure pursuit from station to station, turning in place at each, resting 1.5 s."""
    dt = ODOMETRY_NS * 1e-9
    poses = [SE2(0.0, 0.0, 0.0)]
    for station in STATIONS[:stations]:
        line = _dense([poses[-1][:2], *station])
        nearest = 0
        turning = True
        while poses[-1].distance_m(SE2(*line[-1], 0.0)) > 0.05:
            pose = poses[-1]
            while nearest < len(line) - 1 and _apart(line[nearest], pose) < 0.35:
                nearest += 1
            target = line[nearest]
            error = wrap_angle(
                math.atan2(target[1] - pose.y_m, target[0] - pose.x_m) - pose.yaw_rad
            )
            turning = abs(error) > (0.1 if turning else 1.0)
            speed = 0.0 if turning else speed_m_s * max(0.2, math.cos(error) ** 2)
            turn = max(-1.2, min(1.2, 2.5 * error))
            poses.append(pose @ SE2(speed * dt, 0.0, turn * dt))
        poses += [poses[-1]] * 45
    stamps = list(range(SCAN_OFFSET_NS, (len(poses) - 1) * ODOMETRY_NS, SCAN_NS))
    exact = [cast(interpolated(poses, stamp) @ BASE_FROM_SCAN, wall_segments()) for stamp in stamps]
    return Drive(poses, stamps, exact)


def slipping_odometry(poses: list[SE2], rng: np.random.Generator) -> list[SE2]:
    """Odometry of wheels that slip by 1 to 2 %, in moves and in turns, and with noise."""
    signs = rng.choice([-1.0, 1.0], 2)
    move_scale, turn_scale = 1.0 + signs * rng.uniform(0.01, 0.02, 2)
    odometry = [SE2(1.0, -2.0, 0.5)]
    for before, after in pairwise(poses):
        step = before.inverse() @ after
        noise = rng.standard_normal(2) * (
            0.05 * abs(step.x_m),
            0.05 * abs(step.yaw_rad) + 0.01 * abs(step.x_m),
        )
        moved = SE2(
            step.x_m * move_scale + noise[0],
            step.y_m * move_scale,
            step.yaw_rad * turn_scale + noise[1],
        )
        odometry.append(odometry[-1] @ moved)
    return odometry


def _dense(points: list[tuple[float, ...]]) -> list[tuple[float, float]]:
    line: list[tuple[float, float]] = []
    for (x0, y0), (x1, y1) in pairwise(points):
        count = max(1, round(math.hypot(x1 - x0, y1 - y0) / 0.05))
        line += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count)]
    return [*line, (points[-1][0], points[-1][1])]


def _apart(point: tuple[float, float], pose: SE2) -> float:
    return math.hypot(point[0] - pose.x_m, point[1] - pose.y_m)
