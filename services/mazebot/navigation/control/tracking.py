"""Obstacles that move: clusters of scan points that the map does not explain, followed by Kalman
filters of constant velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.ray_evidence import RayMemory, Rays, edges_in_sight
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import Distance, distance_at
from mazebot.navigation.costmap.layered_costmap import GridFrame

_GATE = 9.2
"""99 % of the squared, normalised distances of two dimensions are less (chi square)."""
_MOST_CLUSTERS = 64
_RESTART_S = 0.6
"""What has moved before and comes far enough within this time moves again."""
_REMEMBERED_S = 2.0
_STOPPING = 0.7
_BEFORE_WALL_M = 0.2
_FAR_S = 1.0
"""Scans farther apart than this reset the tracks: nothing can be associated."""


class TrackerParams(Params):
    """How obstacles are found and followed."""

    static_margin: float = Field(
        0.15, ge=0, description="m; points this near to a wall of the map belong to it"
    )
    cluster_gap: float = Field(
        0.15, gt=0, description="m; points of one obstacle are at most this far apart"
    )
    min_points: int = Field(2, ge=1, description="points of an obstacle, at least")
    max_radius: float = Field(
        0.6, gt=0, description="m; a larger cluster is not an obstacle that moves, but a wall"
    )
    position_std: float = Field(
        0.03, gt=0, description="m; standard deviation of a cluster's position"
    )
    acceleration_std: float = Field(
        1.5, gt=0, description="m/s2; standard deviation of an obstacle's acceleration"
    )
    hits_to_confirm: int = Field(3, ge=1, description="scans until a track counts")
    misses_to_drop: int = Field(5, ge=1, description="scans without it until a track ends")
    moving_speed: float = Field(0.1, gt=0, description="m/s; slower tracks count as stationary")
    moving_displacement: float = Field(
        0.2,
        ge=0,
        description="m; a track that has not moved farther counts as stationary",
    )
    standing_time: float = Field(
        1.0,
        ge=0,
        description="s; a track counts as stationary only after it was slow for this long, so "
        "that one that turns back still counts as moving",
    )
    restart_displacement: float = Field(
        0.05, ge=0, description="m; one that has moved before moves again after this distance"
    )
    turning_time: float = Field(
        5.0,
        ge=0,
        description="s; one that has stopped before a wall is expected to turn back for this long",
    )


class _Place(NamedTuple):
    """Where a track was at a time, and its echoes."""

    stamp_s: float
    x: float
    y: float
    points_m: Array


@dataclass(slots=True)
class _Filter:
    """One obstacle. Both axes have the same noise, so that they share one covariance."""

    number: int
    x: float
    y: float
    radius: float
    stamp_s: float
    vx: float = 0.0
    vy: float = 0.0
    p_xx: float = 0.0
    p_xv: float = 0.0
    p_vv: float = 0.25
    hits: int = 1
    misses: int = 0
    places: list[_Place] = field(default_factory=list)
    """Where it was in the last two seconds."""
    came_far: bool = False
    fast_s: float = -math.inf
    """When it last was fast."""
    fast_vx: float = 0.0
    fast_vy: float = 0.0
    """Its velocity then."""
    at_wall: bool = False
    """Whether its way then ended before a wall."""

    def predict(self, stamp_s: float, acceleration_std: float) -> None:
        """White acceleration, held for the whole step."""
        dt = stamp_s - self.stamp_s
        self.stamp_s = stamp_s
        q = acceleration_std * acceleration_std
        self.x += self.vx * dt
        self.y += self.vy * dt
        self.p_xx += dt * (2.0 * self.p_xv + dt * self.p_vv) + q * dt * dt * dt * dt / 4.0
        self.p_xv += dt * self.p_vv + q * dt * dt * dt / 2.0
        self.p_vv += q * dt * dt

    def distance2(self, x: float, y: float, variance: float) -> float:
        """Squared Mahalanobis distance of a measurement."""
        dx, dy = x - self.x, y - self.y
        return (dx * dx + dy * dy) / (self.p_xx + variance)

    def correct(self, x: float, y: float, radius: float, variance: float) -> None:
        """Take a measurement."""
        s = self.p_xx + variance
        gain_x, gain_v = self.p_xx / s, self.p_xv / s
        dx, dy = x - self.x, y - self.y
        self.x += gain_x * dx
        self.y += gain_x * dy
        self.vx += gain_v * dx
        self.vy += gain_v * dy
        self.p_vv -= gain_v * self.p_xv
        self.p_xv *= 1.0 - gain_x
        self.p_xx *= 1.0 - gain_x
        # A part may be hidden now that was seen before.
        self.radius += (0.5 if radius > self.radius else 0.1) * (radius - self.radius)
        self.hits += 1
        self.misses = 0

    @property
    def speed(self) -> float:
        """Speed over the floor."""
        return math.sqrt(self.vx * self.vx + self.vy * self.vy)


class ObstacleTracker:
    """Follows what the map does not explain. Time and points are arguments; it keeps no frame but
    that of the points, which should be that of the map.
    """

    def __init__(self, params: TrackerParams) -> None:
        self._params = params
        self._filters: list[_Filter] = []
        self._count = 0
        self._stamp_s: float | None = None
        self._rays = RayMemory(_REMEMBERED_S)

    def clear(self) -> None:
        """Forget all tracks, e.g. after a jump of the pose."""
        self._filters, self._stamp_s = [], None
        self._rays.clear()

    def update(
        self,
        stamp_s: float,
        points_m: Array,
        static_distance_m: Distance,
        frame: GridFrame,
        static_margin_m: float = math.inf,
        rays: Rays | None = None,
    ) -> NDArray[np.bool_]:
        """Take a scan.

        Args:
            stamp_s: of the scan; one that is not later than the last is not taken.
            points_m: (n, 2) float64 its points in the map frame, in the order of the beams.
            static_distance_m: (rows, columns) distance from the static map's obstacles.
            frame: of that map.
            static_margin_m: instead of the parameter where it is less: the better the pose is
                known, the nearer to walls obstacles are seen.
            rays: the scan that the points are of; None: what seems to move does.

        Returns (n,): points that belong to an obstacle that moves, which should not be marked in a
        costmap.
        """
        p = self._params
        nothing = np.zeros(len(points_m), np.bool_)
        if self._stamp_s is not None and not stamp_s - self._stamp_s > 0.0:
            return nothing
        if self._stamp_s is None or stamp_s - self._stamp_s > _FAR_S:
            self._filters = []
            self._rays.clear()
        self._stamp_s = stamp_s
        if rays is not None:
            self._rays.take(rays)
        labels = np.empty(len(points_m), np.int64)
        discs = np.zeros((_MOST_CLUSTERS, 4))
        count = _clusters(
            np.ascontiguousarray(points_m, np.float64), static_distance_m, frame.resolution_m,
            frame.origin_x_m, frame.origin_y_m, min(p.static_margin, static_margin_m),
            p.cluster_gap, labels, discs,
        )  # fmt: skip
        found = [
            (i, x, y, radius)
            for i, (x, y, radius, points) in enumerate(discs[:count].tolist())
            if points >= p.min_points and radius <= p.max_radius
        ]
        for each in self._filters:
            each.predict(stamp_s, p.acceleration_std)
        cluster_of = self._associate(found, stamp_s)
        self._filters = [each for each in self._filters if each.misses < p.misses_to_drop]
        for number, cluster in cluster_of.items():
            track = next((each for each in self._filters if each.number == number), None)
            if track is not None:
                track.at_wall = self._is_at_wall(track, static_distance_m, frame)
                of_it = labels == cluster
                track.places = [*(t for t in track.places if t.stamp_s > stamp_s - _REMEMBERED_S)]
                track.places.append(_Place(stamp_s, track.x, track.y, points_m[of_it]))
                in_sight = rays is None or bool(
                    edges_in_sight(points_m, labels, cluster, *map(float, rays.map_from_scan[:2]))
                )
                if self._note_motion(track, stamp_s, in_sight, rays is not None):
                    nothing |= of_it
        return nothing

    def _associate(
        self, found: list[tuple[int, float, float, float]], stamp_s: float
    ) -> dict[int, int]:
        """Nearest pairs first; a new track for each cluster that is left. Cluster of each track."""
        p = self._params
        variance = p.position_std * p.position_std
        pairs = [
            (each.distance2(x, y, variance), a, b)
            for a, each in enumerate(self._filters)
            for b, (_, x, y, _) in enumerate(found)
        ]
        cluster_of: dict[int, int] = {}
        taken: set[int] = set()
        for distance2, a, b in sorted(pairs):
            track = self._filters[a]
            if distance2 > _GATE or track.number in cluster_of or b in taken:
                continue
            cluster, x, y, radius = found[b]
            track.correct(x, y, radius, variance)
            cluster_of[track.number] = cluster
            taken.add(b)
        for track in self._filters:
            if track.number not in cluster_of:
                track.misses += 1
        for b, (cluster, x, y, radius) in enumerate(found):
            if b not in taken:
                self._count += 1
                made = _Filter(self._count, x, y, radius, stamp_s, p_xx=variance)
                self._filters.append(made)
                cluster_of[made.number] = cluster
        return cluster_of

    def _note_motion(self, track: _Filter, stamp_s: float, in_sight: bool, by_rays: bool) -> bool:
        """Note whether it moved; whether it moves."""
        p = self._params
        since_s = stamp_s - _RESTART_S if track.came_far else -math.inf
        recent = (place for place in track.places if place.stamp_s > since_s)
        far_m = max(math.hypot(track.x - one.x, track.y - one.y) for one in recent)
        needed_m = p.restart_displacement if track.came_far else p.moving_displacement
        comes_far = track.speed > p.moving_speed and far_m > needed_m
        # What has moved before and is seen whole needs no more proof.
        if comes_far and by_rays and not (track.came_far and in_sight):
            comes_far = self._has_moved(track)
        if comes_far:
            track.came_far, track.fast_s = True, stamp_s
            onward = track.vx * track.fast_vx + track.vy * track.fast_vy
            before = track.fast_vx * track.fast_vx + track.fast_vy * track.fast_vy
            # While it stops, its last full speed is kept.
            if not 0.0 < onward < _STOPPING * before:
                track.fast_vx, track.fast_vy = track.vx, track.vy
        return self._moves(track)

    def _has_moved(self, track: _Filter) -> bool:
        """Whether the rays say that it is elsewhere than where it was farthest away."""
        now = track.places[-1]
        before = max(track.places, key=lambda one: math.hypot(track.x - one.x, track.y - one.y))
        return self._rays.has_moved(before.stamp_s, before.points_m, now.points_m)

    def _is_at_wall(self, track: _Filter, distance_m: Distance, frame: GridFrame) -> bool:
        """Whether the way that it came ends just before it."""
        speed = math.hypot(track.fast_vx, track.fast_vy)
        if speed == 0.0:
            return False
        rows, columns = distance_m.shape
        for step in range(1, round(_BEFORE_WALL_M / frame.resolution_m) + 1):
            ahead_m = (track.radius + step * frame.resolution_m) / speed
            column, row = frame.place(
                track.x + track.fast_vx * ahead_m, track.y + track.fast_vy * ahead_m
            )
            if not (0.0 <= column < columns and 0.0 <= row < rows):
                return True
            if distance_m[int(row), int(column)] <= 0.5 * frame.resolution_m:
                return True
        return False

    def _moves(self, track: _Filter) -> bool:
        p = self._params
        return (
            track.hits >= p.hits_to_confirm
            and track.came_far
            and track.stamp_s - track.fast_s <= p.standing_time
        )

    def moving(self, now_s: float) -> tuple[Track, ...]:
        """The obstacles that move, where they are at a time."""
        return tuple(_track_at(each, now_s) for each in self._filters if self._moves(each))

    def turning(self) -> tuple[Track, ...]:
        """The obstacles that have moved and now stand before a wall, with the velocity with which
        they will turn back.
        """
        p = self._params
        found = []
        for each in self._filters:
            stood_s = each.stamp_s - each.fast_s
            stopped = each.came_far and each.at_wall and not self._moves(each)
            if stopped and each.hits >= p.hits_to_confirm and stood_s <= p.turning_time:
                back = -each.fast_vx, -each.fast_vy
                found.append(Track(each.number, each.x, each.y, *back, each.radius))
        return tuple(found)

    def tracks(self, now_s: float) -> tuple[Track, ...]:
        """All confirmed obstacles, moving or not."""
        least = self._params.hits_to_confirm
        return tuple(_track_at(each, now_s) for each in self._filters if each.hits >= least)


def _track_at(each: _Filter, now_s: float) -> Track:
    # No farther than until the next two scans: what is not seen any more may have stopped.
    dt = min(max(now_s - each.stamp_s, 0.0), 0.3)
    x, y = each.x + each.vx * dt, each.y + each.vy * dt
    return Track(each.number, x, y, each.vx, each.vy, each.radius)


@kernel()
def _clusters(
    points_m: Array,
    distance_m: Distance,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    margin_m: float,
    gap_m: float,
    labels: NDArray[np.int64],
    discs: Array,
) -> int:
    """Label the points that are farther than a margin from the map's obstacles by cluster, others
    -1, and give the (x, y, radius, points) of each cluster; their number.

    Points are in the order of a turn, of which the first follows the last. The disc is Ritter's
    (1990), at most a few per cent larger than the smallest around the points.
    """
    count, last = 0, -1
    rows, columns = distance_m.shape
    for i in range(len(points_m)):
        labels[i] = -1
        column = (points_m[i, 0] - origin_x_m) / resolution_m
        row = (points_m[i, 1] - origin_y_m) / resolution_m
        # Beyond the map nothing is known.
        inside = 0.0 <= column < columns and 0.0 <= row < rows
        if not inside or distance_at(distance_m, column, row) <= margin_m:
            continue
        if last >= 0:
            dx = points_m[i, 0] - points_m[last, 0]
            dy = points_m[i, 1] - points_m[last, 1]
            if dx * dx + dy * dy <= gap_m * gap_m:
                labels[i] = labels[last]
        if labels[i] < 0:
            if count == len(discs):
                break
            labels[i] = count
            count += 1
        last = i
    first = -1
    for i in range(len(points_m)):
        if labels[i] >= 0:
            first = i
            break
    if first >= 0 and last > first and labels[last] != labels[first]:
        dx = points_m[first, 0] - points_m[last, 0]
        dy = points_m[first, 1] - points_m[last, 1]
        if dx * dx + dy * dy <= gap_m * gap_m:
            joined = labels[last]
            for i in range(len(points_m)):
                if labels[i] == joined:
                    labels[i] = labels[first]
    for label in range(count):
        _disc_around(points_m, labels, label, discs[label])
    return count


@kernel()
def _disc_around(points_m: Array, labels: NDArray[np.int64], label: int, disc: Array) -> None:
    number, start = 0, -1
    for i in range(len(points_m)):
        if labels[i] == label:
            number += 1
            start = i if start < 0 else start
    disc[3] = number
    if number == 0:
        return
    a = _farthest(points_m, labels, label, points_m[start, 0], points_m[start, 1])
    b = _farthest(points_m, labels, label, points_m[a, 0], points_m[a, 1])
    x, y = (points_m[a, 0] + points_m[b, 0]) / 2.0, (points_m[a, 1] + points_m[b, 1]) / 2.0
    dx, dy = points_m[a, 0] - x, points_m[a, 1] - y
    radius = math.sqrt(dx * dx + dy * dy)
    for i in range(len(points_m)):
        if labels[i] != label:
            continue
        dx, dy = points_m[i, 0] - x, points_m[i, 1] - y
        away = math.sqrt(dx * dx + dy * dy)
        if away > radius:
            grown = (radius + away) / 2.0
            x += dx * (away - grown) / away
            y += dy * (away - grown) / away
            radius = grown
    disc[0], disc[1], disc[2] = x, y, radius


@kernel()
def _farthest(points_m: Array, labels: NDArray[np.int64], label: int, x: float, y: float) -> int:
    best, best_square = -1, -1.0
    for i in range(len(points_m)):
        if labels[i] == label:
            dx, dy = points_m[i, 0] - x, points_m[i, 1] - y
            if dx * dx + dy * dy > best_square:
                best, best_square = i, dx * dx + dy * dy
    return best
