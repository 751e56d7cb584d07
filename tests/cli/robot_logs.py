"""Logs of robots with a SICK scanner, made up: floors of walls, drives, scans, odometry, files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mazebot.common.maths.frames import Array

NO_RETURN_M = 81.83
Point = tuple[float, float]


@dataclass
class Floor:
    """Walls and things as segments, and the way through them."""

    segments: list[tuple[float, float, float, float]] = field(default_factory=list)
    way: list[Point] = field(default_factory=list)

    def wall(self, a: Point, b: Point, *doors: float, door_m: float = 1.0) -> None:
        """A wall from a to b with gaps centred so many metres from a."""
        length = math.dist(a, b)
        at = 0.0
        ends = []
        for door in sorted(doors):
            ends.append((at, door - door_m / 2.0))
            at = door + door_m / 2.0
        ends.append((at, length))
        u, v = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        for begin, end in ends:
            if end - begin > 1e-6:
                self.segments.append(
                    (a[0] + u * begin, a[1] + v * begin, a[0] + u * end, a[1] + v * end)
                )

    def box(self, x: float, y: float, width: float, depth: float, yaw: float = 0.0) -> None:
        """A closed rectangle around its centre."""
        c, s = math.cos(yaw), math.sin(yaw)
        corners = [
            (x + c * u * width / 2 - s * v * depth / 2, y + s * u * width / 2 + c * v * depth / 2)
            for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
            self.wall(p, q)

    def clutter(self, rng: np.random.Generator, count: int, clear_m: float = 0.55) -> None:
        """Boxes of 4 to 80 cm where they leave the way clear."""
        ends = np.array(self.segments)
        low, high = ends.min(axis=0)[:2] + 0.3, ends.max(axis=0)[:2] - 0.3
        way = np.array(self.way)
        for _ in range(count):
            x, y = rng.uniform(low, high)
            width, depth = rng.uniform(0.04, 0.8, 2)
            if _distance_to_way(way, x, y) > clear_m + math.hypot(width, depth) / 2.0:
                self.box(x, y, width, depth, rng.uniform(0.0, math.pi))


def _distance_to_way(way: Array, x: float, y: float) -> float:
    a, b = way[:-1], way[1:]
    along = b - a
    square = np.maximum((along**2).sum(axis=1), 1e-9)
    t = np.clip(((np.array([x, y]) - a) * along).sum(axis=1) / square, 0.0, 1.0)
    return float(np.hypot(*(a + along * t[:, None] - (x, y)).T).min())


def office(rng: np.random.Generator, same: bool = False, laps: int = 2, boxes: int = 250) -> Floor:
    """28 x 28 m: a ring of a corridor with rooms outside and inside of it.

    `same`: all rooms of a side are of one size, with the door at the same place.
    """
    floor = Floor()
    floor.box(14, 14, 28, 28)
    cuts = [6.0, 10.0, 14.0, 18.0, 22.0]
    visits: list[list[list[Point]]] = []
    for side in range(4):
        turn = _turned(side)
        edges = list(cuts)
        if not same:
            edges = [6.0, *(c + float(rng.uniform(-0.9, 0.9)) for c in cuts[1:-1]), 22.0]
        doors = []
        rooms = []
        for begin, end in itertools.pairwise(edges):
            door = begin + (1.0 if same else float(rng.uniform(0.8, end - begin - 0.8)))
            doors.append(door)
            middle = (begin + end) / 2.0
            rooms.append(
                [turn(door, 7.0), turn(door, 5.2), turn(middle, 3.4), turn(middle, 1.6),
                 turn(middle, 3.4), turn(door, 5.2), turn(door, 7.0)]
            )  # fmt: skip
        floor.wall(turn(0.0, 6.0), turn(28.0, 6.0), *doors)
        for edge in edges:
            floor.wall(turn(edge, 0.0), turn(edge, 6.0))
        inner = 14.0 if same else float(rng.uniform(9.5, 12.5))
        floor.wall(turn(8.0, 8.0), turn(20.0, 8.0), inner - 8.0, door_m=1.2)
        rooms.append(
            [turn(inner, 7.0), turn(inner, 8.8), turn(inner, 10.4), turn(inner, 8.8),
             turn(inner, 7.0)]
        )  # fmt: skip
        rooms.sort(key=lambda room: {0: 1, 1: 1, 2: -1, 3: -1}[0] * _along(side, room[0]))
        visits.append(rooms)
    floor.wall((14.0, 8.0), (14.0, 12.0))
    floor.wall((8.0, 14.0), (20.0, 14.0))
    way: list[Point] = [_turned(0)(7.0, 7.0)]
    for lap in range(laps):
        for side in range(4):
            for room in visits[side]:
                if lap == 0 or rng.random() < 0.4:
                    way += room
            way.append(_turned(side)(21.0, 7.0))
    floor.way = _without_repeats(way)
    floor.clutter(rng, boxes)
    return floor


def _turned(side: int):  # type: ignore[no-untyped-def]
    def turn(along: float, out: float) -> Point:
        return [
            (along, out), (28.0 - out, along), (28.0 - along, 28.0 - out), (out, 28.0 - along),
        ][side]  # fmt: skip

    return turn


def _along(side: int, point: Point) -> float:
    x, y = point
    return [x, y, 28.0 - x, 28.0 - y][side]


def corridors(rng: np.random.Generator, length_m: float = 60.0, width_m: float = 2.4) -> Floor:
    """A loop of four long corridors with alcoves of doors every few metres, driven twice."""
    floor = Floor()
    high = length_m * 0.6
    w = width_m
    outer = [(0.0, 0.0), (length_m, 0.0), (length_m, high), (0.0, high)]
    inner = [(w, w), (length_m - w, w), (length_m - w, high - w), (w, high - w)]
    for corners in (outer, inner):
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            span = math.dist(a, b)
            u, v = (b[0] - a[0]) / span, (b[1] - a[1]) / span
            inside = 1.0 if corners is inner else -1.0
            at, last = 2.0 + float(rng.uniform(0, 3)), a
            while at < span - 4.0:
                # A door set back by 15 cm.
                p = (a[0] + u * at, a[1] + v * at)
                q = (a[0] + u * (at + 0.9), a[1] + v * (at + 0.9))
                back = (v * -0.15 * -inside, u * 0.15 * -inside)
                back = (-v * 0.15 * inside, u * 0.15 * inside)
                p_in, q_in = (p[0] + back[0], p[1] + back[1]), (q[0] + back[0], q[1] + back[1])
                floor.wall(last, p)
                floor.wall(p, p_in)
                floor.wall(p_in, q_in)
                floor.wall(q_in, q)
                last = q
                at += float(rng.uniform(3.0, 7.0))
            floor.wall(last, b)
    m = w / 2.0
    ring = [(m, m), (length_m - m, m), (length_m - m, high - m), (m, high - m)]
    floor.way = [*ring, *ring, ring[0], (length_m * 0.4, m)]
    return floor


def hall(rng: np.random.Generator, boxes: int = 40, rounds: int = 2) -> Floor:
    """12 x 9 m of one room with things in it, driven in rounds: a small log."""
    floor = Floor()
    floor.box(6, 4.5, 12, 9)
    floor.wall((6, 0), (6, 3.2))
    floor.wall((6, 5.6), (6, 9))
    ring = [(1.5, 1.5), (4.4, 1.5), (4.4, 4.4), (7.6, 4.4), (10.4, 1.5), (10.4, 7.4), (7.6, 7.4),
            (7.6, 4.4), (4.4, 4.4), (1.5, 7.4)]  # fmt: skip
    floor.way = [*ring * rounds, ring[0]]
    floor.clutter(rng, boxes)
    return floor


def _without_repeats(way: Sequence[Point]) -> list[Point]:
    kept = [way[0]]
    for point in way[1:]:
        if math.dist(point, kept[-1]) > 1e-6:
            kept.append(point)
    return kept


def drive(
    way: Sequence[Point], speed_m_s: float = 0.4, turn_rad_s: float = 0.8, step_s: float = 0.05
) -> Array:
    """(n, 3) true poses, one each step: straight from point to point, turning on the spot."""
    poses = []
    yaw = math.atan2(way[1][1] - way[0][1], way[1][0] - way[0][0])
    for a, b in itertools.pairwise(way):
        wanted = math.atan2(b[1] - a[1], b[0] - a[0])
        turn = (wanted - yaw + math.pi) % math.tau - math.pi
        steps = max(1, math.ceil(abs(turn) / (turn_rad_s * step_s)))
        if abs(turn) > 1e-6:
            poses += [(*a, yaw + turn * (i + 1) / steps) for i in range(steps)]
        yaw = wanted
        steps = max(1, math.ceil(math.dist(a, b) / (speed_m_s * step_s)))
        for i in range(steps):
            t = (i + 1) / steps
            poses.append((a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, yaw))
    return np.array(poses)


def weaving(poses: Array, rng: np.random.Generator, most_m: float = 0.12) -> Array:
    """The same drive by somebody who does not keep quite straight."""
    phase = np.cumsum(rng.normal(0.0, 0.05, len(poses))) + np.arange(len(poses)) * 0.03
    out = poses.copy()
    aside = most_m * np.sin(phase)
    out[:, 0] -= np.sin(poses[:, 2]) * aside
    out[:, 1] += np.cos(poses[:, 2]) * aside
    out[:, 2] += 0.08 * np.cos(phase)
    return out


def odometry(
    poses: Array,
    rng: np.random.Generator,
    turn_scale: float = 1.02,
    drift_rad_m: float = 0.01,
    way_scale: float = 1.01,
    slip: float = 0.05,
) -> Array:
    """(n, 3) poses by wheels: turns and ways scaled, a pull to one side, and noise of each step."""
    steps = np.diff(poses, axis=0, prepend=poses[:1])
    turns = (steps[:, 2] + math.pi) % math.tau - math.pi
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead = c * steps[:, 0] + s * steps[:, 1]
    aside = -s * steps[:, 0] + c * steps[:, 1]
    size = np.abs(ahead) + 0.1 * np.abs(turns)
    ahead = ahead * way_scale + rng.normal(0.0, slip, len(poses)) * size
    turned = turns * turn_scale + drift_rad_m * np.abs(ahead)
    turned = turned + rng.normal(0.0, slip, len(poses)) * (np.abs(turns) + 0.2 * np.abs(ahead))
    yaw = np.cumsum(turned)
    out = np.empty_like(poses)
    out[:, 0] = np.cumsum(np.cos(yaw) * ahead - np.sin(yaw) * aside)
    out[:, 1] = np.cumsum(np.sin(yaw) * ahead + np.cos(yaw) * aside)
    out[:, 2] = yaw
    return out


def sweep(
    segments: Array, pose: Array, angles: Array, rng: np.random.Generator, noise_m: float
) -> Array:
    """(n,) ranges of a scan in whole centimetres: noise, and 1.5 % without a return."""
    directions = angles + pose[2]
    u, v = np.cos(directions)[:, None], np.sin(directions)[:, None]
    x1, y1 = segments[:, 0] - pose[0], segments[:, 1] - pose[1]
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    across = u * ey - v * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (x1 * ey - y1 * ex) / across
        along = (x1 * v - y1 * u) / across
    hit = (t > 0.0) & (along >= 0.0) & (along <= 1.0)
    ranges = np.where(hit, t, np.inf).min(axis=1)
    ranges = np.round(ranges + rng.normal(0.0, noise_m, len(ranges)), 2)
    lost = rng.random(len(ranges)) < 0.015
    return np.where(lost | (ranges > 79.0), NO_RETURN_M, np.maximum(ranges, 0.05))


@dataclass
class RobotLog:
    """A drive as a log holds it, and the truth."""

    times_s: Array
    truth: Array
    odom: Array
    ranges_m: Array

    def write_carmen(self, path: Path) -> Path:
        """FLASER lines, as the public logs have them."""
        lines = ["# CARMEN Logfile", "PARAM robot_frontlaser_offset 0.0"]
        begin = self.times_s[0]
        for time_s, odom, ranges in zip(self.times_s, self.odom, self.ranges_m, strict=True):
            pose = " ".join(f"{value:.6f}" for value in odom)
            beams = " ".join(f"{value:.2f}" for value in ranges)
            lines.append(
                f"FLASER {len(ranges)} {beams} {pose} {pose} {time_s:.6f} nohost "
                f"{time_s - begin:.6f}"
            )
        path.write_text("\n".join(lines) + "\n")
        return path

    def write_relations(self, path: Path, rng: np.random.Generator, count: int = 2000) -> Path:
        """Relations of scans close in time, and of scans at the same place at other times."""
        n = len(self.truth)
        lines: list[str] = []
        for _ in range(count * 20):
            if len(lines) == count:
                break
            i = int(rng.integers(0, n))
            j = (
                min(i + int(rng.integers(1, 40)), n - 1)
                if rng.random() < 0.5
                else int(rng.integers(0, n))
            )
            if i == j or math.dist(self.truth[i, :2], self.truth[j, :2]) > 2.0:
                continue
            x, y, yaw = relative(self.truth[i], self.truth[j])
            times = f"{self.times_s[i]:.6f} {self.times_s[j]:.6f}"
            lines.append(f"{times} {x:.6f} {y:.6f} 0.000000 0.000000 0.000000 {yaw:.6f}")
        path.write_text("\n".join(lines) + "\n")
        return path


def relative(a: Array, b: Array) -> tuple[float, float, float]:
    """Pose b in the frame of pose a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, -s * dx + c * dy, (b[2] - a[2] + math.pi) % math.tau - math.pi


def make(
    floor: Floor,
    rng: np.random.Generator,
    every: int = 4,
    beams: int = 180,
    noise_m: float = 0.012,
    begin_s: float = 976_052_857.0,
    odom: Array | None = None,
    truth: Array | None = None,
) -> RobotLog:
    """Drive and scan; a scan each `every` steps of 50 ms."""
    poses = weaving(drive(floor.way), rng) if truth is None else truth
    wheels = odometry(poses, rng) if odom is None else odom
    kept = np.arange(0, len(poses), every)
    angles: Array = np.radians(np.arange(beams, dtype=np.float64) - 90.0)
    segments = np.array(floor.segments)
    ranges = [sweep(segments, poses[i], angles, rng, noise_m) for i in kept]
    return RobotLog(
        np.asarray(begin_s + kept * 0.05, np.float64), poses[kept], wheels[kept], np.array(ranges)
    )
