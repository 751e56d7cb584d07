"""Worlds of walls without physics: a robot that wanders, its odometry, its lidar, its markers.

The truth is what the recipe says, not the map: scans are cast against the walls' own faces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    Array,
    inverse_matrix,
    pose_matrix,
    rotation_from_rpy,
    transform_matrix,
    wrap_angle,
)
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.scan import Scan
from mazebot.common.world.footprint import wall_corners
from mazebot.common.world.marker_entities import marker_entities
from mazebot.localization.monte_carlo import Localization, LocalizationParams, MarkerCandidate
from mazebot.worldgen.recipe.loader import load_world

BEAMS = 360
RANGE_MIN_M, RANGE_MAX_M = 0.12, 3.5
RANGE_STD_M = 0.01
BASE_FROM_SCAN = SE2(-0.064, 0.0, 0.0)
BASE_FROM_CAMERA = transform_matrix(np.eye(3), (0.07, 0.0, 0.2)) @ LINK_FROM_OPTICAL
MARKER_COVARIANCE = np.diag([0.01, 0.01, 0.02, 0.1, 0.1, 0.1]) ** 2
STEP_NS = 50_000_000
CLEAR_M = 0.25
ODOM_START = SE2(0.3, -0.2, 0.7)


@kernel("void(float64[:, ::1], float64, float64, float64, float64[::1])")
def _cast(segments: Array, x: float, y: float, yaw: float, ranges: Array) -> None:
    for j in range(ranges.size):
        angle = yaw + j * (2.0 * math.pi / ranges.size)
        dx, dy = math.cos(angle), math.sin(angle)
        nearest = np.inf
        for i in range(segments.shape[0]):
            ax, ay = segments[i, 0] - x, segments[i, 1] - y
            ex, ey = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
            across = dx * ey - dy * ex
            if abs(across) < 1e-12:
                continue
            along = (ax * ey - ay * ex) / across
            face = (ax * dy - ay * dx) / across
            if along > 0.0 and 0.0 <= face <= 1.0 and along < nearest:
                nearest = along
        ranges[j] = nearest


@dataclass(frozen=True)
class Place:
    """A world's walls, its map, and its markers."""

    segments: Array
    """(n, 4) faces x0, y0, x1, y1"""
    cells: NDArray[np.int8]
    resolution_m: float
    origin: SE2
    markers: tuple[Array, ...] = ()
    """(4, 4) map_from_marker"""

    def ranges(self, map_from_base: SE2, more: Array | None = None, beams: int = BEAMS) -> Array:
        """(beams,) exact distances from the lidar; `more` (n, 4) are faces that no map has."""
        pose = map_from_base @ BASE_FROM_SCAN
        made = np.empty(beams)
        segments = self.segments if more is None else np.concatenate([self.segments, more])
        _cast(np.ascontiguousarray(segments), *pose, made)
        return made

    def free_pose(self, rng: np.random.Generator) -> SE2:
        """A pose on the largest connected floor, 0.25 m and more from everything."""
        rows, columns = self._floor
        i = int(rng.integers(len(rows)))
        here = SE2((columns[i] + 0.5) * self.resolution_m, (rows[i] + 0.5) * self.resolution_m, 0.0)
        pose = self.origin @ here
        return SE2(pose.x_m, pose.y_m, float(rng.uniform(-math.pi, math.pi)))

    @cached_property
    def _floor(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return _floor(self)

    def localization(self, seed: int, **params: float) -> Localization:
        """A filter for this map."""
        return Localization(
            LocalizationParams.model_validate(params), self.cells, self.resolution_m, self.origin,
            np.random.default_rng(seed),
        )  # fmt: skip


def _floor(place: Place) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    import cv2

    free = ((place.cells >= 0) & (place.cells < 50)).astype(np.uint8)
    far = cv2.distanceTransform(free, cv2.DIST_L2, 5) * place.resolution_m >= CLEAR_M
    count, labels = cv2.connectedComponents(far.astype(np.uint8))
    sizes = [int((labels == k).sum()) for k in range(1, count)]
    # The floor around a house is larger, but no robot starts there.
    inside = [k for k in range(count - 1) if not _at_border(labels == k + 1)]
    best = max(inside or range(count - 1), key=lambda k: sizes[k]) + 1
    rows, columns = np.nonzero(labels == best)
    return rows, columns


def _at_border(mask: NDArray[np.bool_]) -> bool:
    near = 6
    return bool(
        mask[:near].any() or mask[-near:].any() or mask[:, :near].any() or mask[:, -near:].any()
    )


@cache
def shipped(name: str, *overrides: str) -> Place:
    """A world of the repository, as its recipe has it."""
    loaded = load_world(name, overrides=overrides)
    faces = []
    for wall in loaded.world.walls:
        corners = wall_corners(wall)
        faces += [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    for box in getattr(loaded.world, "boxes", []):
        faces += box_faces(box.x_m, box.y_m, box.yaw_rad, box.size_m[0], box.size_m[1]).tolist()
    return Place(
        np.array(faces, np.float64),
        np.array(loaded.map_cells, np.int8),
        loaded.world.map_resolution_m,
        loaded.map_origin,
        tuple(pose_matrix(entity) for entity in marker_entities(loaded.world)[0].markers),
    )


def box_faces(x_m: float, y_m: float, yaw_rad: float, long_m: float, wide_m: float) -> Array:
    """(4, 4) faces of a box."""
    pose = SE2(x_m, y_m, yaw_rad)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = [pose @ SE2(a * long_m / 2, b * wide_m / 2, 0.0) for a, b in signs]
    return np.array(
        [
            (a.x_m, a.y_m, b.x_m, b.y_m)
            for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
        ]
    )


def rectangle(long_m: float, wide_m: float, pillars: tuple[tuple[float, float], ...] = ()) -> Place:
    """A room with walls of 0.15 m, its middle at the origin, with square pillars of 0.3 m."""
    half_x, half_y, thick = long_m / 2, wide_m / 2, 0.15
    boxes = [
        (half_x + thick / 2, 0.0, thick, wide_m + 2 * thick),
        (-half_x - thick / 2, 0.0, thick, wide_m + 2 * thick),
        (0.0, half_y + thick / 2, long_m + 2 * thick, thick),
        (0.0, -half_y - thick / 2, long_m + 2 * thick, thick),
        *((x, y, 0.3, 0.3) for x, y in pillars),
    ]
    res = 0.05
    corner = SE2(-half_x - 0.5, -half_y - 0.5, 0.0)
    shape = (round((wide_m + 1.0) / res), round((long_m + 1.0) / res))
    cells = np.zeros(shape, np.int8)
    for x, y, sx, sy in boxes:
        i0, i1 = (y - sy / 2 - corner.y_m) / res, (y + sy / 2 - corner.y_m) / res
        k0, k1 = (x - sx / 2 - corner.x_m) / res, (x + sx / 2 - corner.x_m) / res
        cells[
            math.floor(i0 + 1e-6) : math.ceil(i1 - 1e-6),
            math.floor(k0 + 1e-6) : math.ceil(k1 - 1e-6),
        ] = 100
    faces = np.concatenate([box_faces(x, y, 0.0, sx, sy) for x, y, sx, sy in boxes])
    return Place(faces, cells, res, corner)


@dataclass
class Robot:
    """A robot in a place, driven by velocities; what its sensors say goes to a filter."""

    place: Place
    pose: SE2
    loc: Localization
    rng: np.random.Generator
    slip: float = 0.02
    """Largest error of odometry's scale."""
    noise: float = 0.05
    obstacles: Array = field(default_factory=lambda: np.empty((0, 4)))
    lost_rays: float = 0.0
    camera: bool = False
    lidar: bool = True
    now_ns: int = 0
    odom: SE2 = ODOM_START
    ranges: Array = field(default_factory=lambda: np.full(BEAMS, np.inf))

    def __post_init__(self) -> None:
        signs = self.rng.choice([-1.0, 1.0], 2)
        self.scale = 1.0 + signs * self.rng.uniform(self.slip / 2, self.slip, 2)
        self.turning = 0.0
        self.sense()

    def kidnap(self, pose: SE2) -> None:
        """Put it elsewhere; the wheels do not turn."""
        self.pose = pose
        self.sense()

    def sense(self) -> None:
        """Odometry, and every second time a scan and the markers in view."""
        self.loc.odometry(self.now_ns, self.odom)
        if self.now_ns % (2 * STEP_NS):
            return
        exact = self.place.ranges(self.pose, self.obstacles)
        noisy = exact + RANGE_STD_M * self.rng.standard_normal(len(exact))
        noisy[(noisy > RANGE_MAX_M) | (self.rng.random(len(noisy)) < self.lost_rays)] = np.inf
        noisy[exact < RANGE_MIN_M] = -np.inf
        self.ranges = noisy
        if self.lidar:
            self.loc.scan(
                Scan(
                    noisy.astype(np.float32),
                    0.0,
                    2 * math.pi / BEAMS,
                    RANGE_MIN_M,
                    RANGE_MAX_M,
                    BASE_FROM_SCAN,
                    self.now_ns,
                )
            )
        if self.camera:
            for marker in self.place.markers:
                candidates = marker_seen(self.place, self.pose, marker, self.rng)
                if candidates:
                    self.loc.marker(self.now_ns, marker, candidates, BASE_FROM_CAMERA)

    def drive(self, speed_m_s: float, turn_rad_s: float) -> None:
        """One step of 50 ms."""
        dt = STEP_NS * 1e-9
        step = SE2(speed_m_s * dt, 0.0, turn_rad_s * dt)
        self.pose = self.pose @ step
        noise = self.rng.standard_normal(2) * (
            self.noise * abs(step.x_m),
            self.noise * abs(step.yaw_rad) + 0.01 * abs(step.x_m),
        )
        self.odom = self.odom @ SE2(
            step.x_m * self.scale[0] + noise[0], 0.0, step.yaw_rad * self.scale[1] + noise[1]
        )
        self.now_ns += STEP_NS
        self.sense()

    def wander(self, speed_m_s: float = 0.3) -> None:
        """One step of driving ahead where there is room, else of turning to where there is more."""
        beams = np.nan_to_num(self.ranges, posinf=RANGE_MAX_M, neginf=0.0)
        degrees = np.arange(BEAMS)
        degrees = np.where(degrees > 180, degrees - 360, degrees)
        angles = np.radians(degrees)
        ahead, aside = beams * np.cos(angles), np.abs(beams * np.sin(angles))
        way = ahead[(np.abs(degrees) < 80) & (aside < 0.24)]
        room = float(way.min()) if len(way) else RANGE_MAX_M
        if self.turning == 0.0 and room < 0.4:
            left = np.minimum(beams, 2.0)[(degrees > 10) & (degrees < 120)].mean()
            right = np.minimum(beams, 2.0)[(degrees < -10) & (degrees > -120)].mean()
            self.turning = 1.0 if left + self.rng.uniform(-0.3, 0.3) > right else -1.0
        elif self.turning != 0.0 and room > 0.8:
            self.turning = 0.0
        if self.turning != 0.0:
            self.drive(0.0, self.turning)
            return
        left = float(beams[(degrees > 30) & (degrees < 90)].min())
        right = float(beams[(degrees < -30) & (degrees > -90)].min())
        push = 0.0
        if min(left, right) < 0.5:
            push = max(-0.8, min(0.8, 2.0 * (min(left, 0.5) - min(right, 0.5))))
        self.drive(speed_m_s, push)

    def error(self) -> tuple[float, float]:
        """Distance in m and turn in rad of the estimate from the truth; inf without one."""
        if not self.loc.initialized:
            return math.inf, math.inf
        pose = self.loc.map_from_base()
        return pose.distance_m(self.pose), abs(wrap_angle(pose.yaw_rad - self.pose.yaw_rad))

    def squared_mahalanobis(self) -> float:
        """Of the truth, in the claimed covariance."""
        pose, covariance = self.loc.pose()
        off = np.array(
            [
                self.pose.x_m - pose.x_m,
                self.pose.y_m - pose.y_m,
                wrap_angle(self.pose.yaw_rad - pose.yaw_rad),
            ]
        )
        return float(off @ np.linalg.solve(covariance, off))


def wall_marker(x_m: float, y_m: float, yaw_rad: float) -> Array:
    """(4, 4) map_from_marker of a marker on a wall, whose normal has this yaw."""
    upright = rotation_from_rpy(math.pi / 2, 0.0, yaw_rad + math.pi / 2)
    return transform_matrix(upright, (x_m, y_m, 0.25))


def marker_seen(
    place: Place, pose: SE2, marker: Array, rng: np.random.Generator
) -> list[MarkerCandidate]:
    """The two solutions of a square seen within 3.5 m, 30 degrees of the axis and 60 of the normal;
    empty where it is not in view, or behind a wall.
    """
    map_from_camera = pose.matrix() @ BASE_FROM_CAMERA
    right = inverse_matrix(map_from_camera) @ marker
    x, z = float(right[0, 3]), float(right[2, 3])
    range_m = math.hypot(x, z)
    facing = float(-(right[:3, 2] @ right[:3, 3]) / np.linalg.norm(right[:3, 3]))
    if z < 0.3 or range_m > 3.5 or abs(math.atan2(x, z)) > 0.5 or facing < 0.5:
        return []
    camera = SE2(float(map_from_camera[0, 3]), float(map_from_camera[1, 3]), 0.0)
    bearing = math.atan2(marker[1, 3] - camera.y_m, marker[0, 3] - camera.x_m)
    first = np.empty(1)
    _cast(place.segments, camera.x_m, camera.y_m, bearing, first)
    if first[0] < math.hypot(marker[0, 3] - camera.x_m, marker[1, 3] - camera.y_m) - 0.05:
        return []
    right[:3, 3] *= 1.0 + 0.005 * rng.standard_normal()
    right[:3, 3] += rng.standard_normal(3) * 0.003
    ray = right[:3, 3] / np.linalg.norm(right[:3, 3])
    flipped = right.copy()
    flipped[:3, :3] = (
        (2.0 * np.outer(ray, ray) - np.eye(3)) @ right[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    )
    share = float(rng.uniform(0.5, 0.95))
    return [(right, MARKER_COVARIANCE, share), (flipped, MARKER_COVARIANCE, 1.0 - share)]
