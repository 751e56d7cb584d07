"""Pose graphs whose true poses are known."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.mapping.graph.pose_graph import ODOMETRY, Graph

STEP_M = 0.5
STEP_COVARIANCE = np.diag([0.01**2, 0.01**2, 0.004**2])
LOOP_COVARIANCE = np.diag([0.03**2, 0.03**2, 0.01**2])


def manhattan(count: int, seed: int, side: int = 20) -> list[SE2]:
    """A walk by steps of 0.5 m along a grid of streets 2 m apart, within a square."""
    random = np.random.default_rng(seed)
    x, y, heading = 0, 0, 0
    poses = []
    for i in range(count):
        poses.append(SE2(x * STEP_M, y * STEP_M, heading * math.pi / 2.0))
        if i % 4 == 3:
            choices = [h for h in range(4) if (h + 2) % 4 != heading]
            while True:
                heading = int(random.choice(choices))
                dx, dy = (
                    round(math.cos(heading * math.pi / 2)),
                    round(math.sin(heading * math.pi / 2)),
                )
                if 0 <= x + 4 * dx <= side * 4 and 0 <= y + 4 * dy <= side * 4:
                    break
                choices = list(range(4))
        dx, dy = round(math.cos(heading * math.pi / 2)), round(math.sin(heading * math.pi / 2))
        x, y = x + dx, y + dy
    return poses


def noisy(relative: SE2, covariance: Array, random: np.random.Generator) -> SE2:
    """A measurement of a pose with this (3, 3) covariance."""
    x, y, yaw = np.linalg.cholesky(covariance) @ random.standard_normal(3)
    return SE2(relative.x_m + x, relative.y_m + y, relative.yaw_rad + yaw)


def odometry_graph(truth: list[SE2], random: np.random.Generator) -> Graph:
    """A graph of odometry alone, its poses by dead reckoning."""
    graph = Graph()
    pose = truth[0]
    graph.add_node(pose)
    for i in range(1, len(truth)):
        step = noisy(truth[i - 1].inverse() @ truth[i], STEP_COVARIANCE, random)
        pose = pose @ step
        graph.add_node(pose)
        graph.add_edge(ODOMETRY, i - 1, i, step, STEP_COVARIANCE)
    return graph


def meetings(truth: list[SE2], apart: int = 40) -> list[tuple[int, int]]:
    """Pairs of an earlier node and a later one at the same place."""
    seen: dict[tuple[int, int], int] = {}
    pairs = []
    for i, pose in enumerate(truth):
        place = (round(pose.x_m * 4), round(pose.y_m * 4))
        if place in seen and i - seen[place] > apart:
            pairs.append((seen[place], i))
        seen.setdefault(place, i)
    return pairs


def errors_m(graph: Graph, truth: list[SE2]) -> Array:
    """(n,) distances of the nodes from where they are in truth."""
    places = np.array([pose[:2] for pose in truth])
    return np.asarray(np.linalg.norm(graph.poses[:, :2] - places, axis=1))


HOUSE_M = np.array(
    [
        *([0.0, 0.0, 8.0, 0.0], [8.0, 0.0, 8.0, 6.0], [8.0, 6.0, 0.0, 6.0], [0.0, 6.0, 0.0, 0.0]),
        *([3.0, 0.0, 3.0, 1.8], [3.0, 2.7, 3.0, 6.0], [3.0, 3.2, 4.6, 3.2], [5.5, 3.2, 8.0, 3.2]),
        *([0.0, 3.4, 1.2, 3.4], [2.1, 3.4, 3.0, 3.4], [5.8, 0.0, 5.8, 1.1], [5.8, 2.0, 5.8, 3.2]),
        *([1.0, 1.0, 1.5, 1.0], [1.5, 1.0, 1.5, 1.4], [6.5, 4.5, 7.0, 4.9], [4.0, 5.2, 4.4, 5.2]),
    ]
)
"""(n, 4) walls of a house of five rooms: x, y of one end and of the other."""


def scan(pose: SE2, random: np.random.Generator, walls: Array = HOUSE_M) -> Array:
    """(m, 2) returns of 360 beams of up to 3.5 m with 1 cm of noise, in the frame of the pose."""
    angles = pose.yaw_rad + np.arange(360) * (math.tau / 360)
    towards = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]
    start, along = walls[:, :2] - pose[:2], walls[:, 2:] - walls[:, :2]
    cross = towards[..., 0] * along[:, 1] - towards[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        places = (start[:, 0] * towards[..., 1] - start[:, 1] * towards[..., 0]) / cross
    hit = (ranges > 0.0) & (places >= 0.0) & (places <= 1.0)
    range_m = np.where(hit, ranges, np.inf).min(axis=1)
    seen = range_m < 3.5
    range_m = range_m[seen] + random.normal(size=int(seen.sum())) * 0.01
    angles = angles[seen] - pose.yaw_rad
    return np.stack([range_m * np.cos(angles), range_m * np.sin(angles)], axis=1)


def placed(pose: SE2, points_m: Array) -> Array:
    """Points (m, 2) of the frame of a pose, in the map."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return np.asarray(points_m @ np.array([[c, s], [-s, c]]) + np.array(pose[:2]))
