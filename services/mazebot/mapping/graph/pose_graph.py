"""A pose graph: keyframes and markers, and measured poses of the ones in the frames of the others.

Flat arrays, which grow as needed. What is measured is an *edge*: the pose of its target in the
frame of its source, `source_from_target`, with the (3, 3) covariance of these three numbers
(x and y by the axes of the source). The source is a node; the target is a node, or of a `MARKER` a
landmark.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel

Ints = NDArray[np.int64]

ODOMETRY, SCAN_MATCH, LOOP, MARKER = range(4)
KINDS = ("odometry", "scan_match", "loop", "marker")
"""Names of the kinds of edges, by their numbers."""

PLAIN, HUBER, CAUCHY = range(3)
"""Robust kernels of edges: none; linear beyond its width; logarithmic beyond it."""

_SURE_M, _UNSURE = 0.3, 10.0
"""An edge whose standard deviation is more than the first counts as longer by so many times what is
beyond: where scans are missing, the robot does not see what it saw, and odometry has gone far.
"""
_FARTHER = 1.25
"""A lidar that sees less than so much farther than the least radius gains nothing by more of it."""


class Edges(NamedTuple):
    """Edges, as views of a graph's arrays: not to be written to."""

    kind: NDArray[np.int8]
    """(m,) ODOMETRY, SCAN_MATCH, LOOP or MARKER."""
    source: Ints
    """(m,) index of a node."""
    target: Ints
    """(m,) index of a node; of a MARKER, of a landmark."""
    relative: Array
    """(m, 3) source_from_target: x, y in metres, yaw in radians."""
    covariance: Array
    """(m, 3, 3) of the three numbers of `relative`."""
    information: Array
    """(m, 3, 3) its inverse."""
    robust: NDArray[np.int8]
    """(m,) PLAIN, HUBER or CAUCHY."""


@dataclass(frozen=True)
class Snapshot:
    """A state of a graph, to go back to: see `Graph.restore`."""

    poses: Array
    landmarks: Array
    edges: Edges


class Graph:
    """Nodes, landmarks and edges. Node 0 stays where it is: it holds the map in the world."""

    def __init__(self) -> None:
        self._poses = np.zeros((64, 3))
        self._nodes = 0
        self._landmarks = np.zeros((16, 3))
        self._landmark_count = 0
        self._edge_rows = Edges(
            np.zeros(128, np.int8),
            np.zeros(128, np.int64),
            np.zeros(128, np.int64),
            np.zeros((128, 3)),
            np.zeros((128, 3, 3)),
            np.zeros((128, 3, 3)),
            np.zeros(128, np.int8),
        )
        self._edge_count = 0
        self._roads: _Roads | None = None

    @property
    def poses(self) -> Array:
        """(n, 3) map_from_base of the nodes: x, y, yaw. A view: optimising writes to it."""
        return self._poses[: self._nodes]

    @property
    def landmarks(self) -> Array:
        """(k, 3) map_from_landmark: x, y, and the yaw of its normal. A view, as `poses`."""
        return self._landmarks[: self._landmark_count]

    @property
    def edges(self) -> Edges:
        """The edges, in the order in which they were added."""
        return Edges(*[rows[: self._edge_count] for rows in _arrays(self._edge_rows)])

    def pose(self, node: int) -> SE2:
        """map_from_base of a node."""
        return SE2(*self._poses[: self._nodes][node].tolist())

    def landmark(self, index: int) -> SE2:
        """map_from_landmark, its yaw that of its normal."""
        return SE2(*self.landmarks[index].tolist())

    def add_node(self, map_from_base: SE2) -> int:
        """Add a node; returns its index. Indices count up from 0 and stay."""
        self._poses = _room(self._poses, self._nodes)
        self._poses[self._nodes] = map_from_base
        self._nodes += 1
        self._roads = None
        return self._nodes - 1

    def add_landmark(self, map_from_landmark: SE2) -> int:
        """Add a landmark; returns its index. Indices count up from 0 and stay."""
        self._landmarks = _room(self._landmarks, self._landmark_count)
        self._landmarks[self._landmark_count] = map_from_landmark
        self._landmark_count += 1
        return self._landmark_count - 1

    def add_edge(
        self,
        kind: int,
        source: int,
        target: int,
        source_from_target: SE2,
        covariance: Array,
        robust: int = PLAIN,
    ) -> int:
        """Add an edge; returns its index, which falls by one for each earlier edge removed.

        `covariance`: (3, 3) of the three numbers of `source_from_target`; its upper triangle is
        used. Raises ValueError where it is not positive definite, where a number is not finite, or
        where a node is unknown.
        """
        targets = self._landmark_count if kind == MARKER else self._nodes
        if not (0 <= source < self._nodes and 0 <= target < targets):
            raise ValueError(f"edge {source} -> {target}: no such node")
        if not all(math.isfinite(value) for value in source_from_target):
            raise ValueError(f"edge {source} -> {target}: its pose is not finite")
        information = information_of(covariance)
        upper = np.triu(covariance)
        covariance = upper + np.triu(upper, 1).T
        m = self._edge_count
        self._edge_rows = Edges(*[_room(rows, m) for rows in _arrays(self._edge_rows)])
        added = (kind, source, target, source_from_target, covariance, information, robust)
        for rows, value in zip(_arrays(self._edge_rows), added, strict=True):
            rows[m] = value
        self._edge_count += 1
        self._roads = None
        return m

    def remove_edge(self, edge: int) -> None:
        """Remove an edge; later ones move down by one."""
        if not 0 <= edge < self._edge_count:
            raise IndexError(f"no edge {edge}")
        for rows in _arrays(self.edges):
            rows[edge:-1] = rows[edge + 1 :].copy()
        self._edge_count -= 1
        self._roads = None

    def snapshot(self) -> Snapshot:
        """The state now, to go back to."""
        edges = Edges(*[rows.copy() for rows in _arrays(self.edges)])
        return Snapshot(self.poses.copy(), self.landmarks.copy(), edges)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to an earlier state, bit by bit: nodes, landmarks and edges added since are
        gone, and those removed since are back.
        """
        self._nodes, self._landmark_count = len(snapshot.poses), len(snapshot.landmarks)
        self._edge_count = len(snapshot.edges.kind)
        self._poses[: self._nodes] = snapshot.poses
        self._landmarks[: self._landmark_count] = snapshot.landmarks
        for rows, saved in zip(_arrays(self.edges), snapshot.edges, strict=True):
            rows[:] = saved
        self._roads = None

    def nodes_near(self, x_m: float, y_m: float, radius_m: float) -> Ints:
        """Nodes within a radius of a point of the map, the nearest first."""
        x, y = self.poses[:, 0] - x_m, self.poses[:, 1] - y_m
        squared = x * x + y * y
        near = np.flatnonzero(squared <= radius_m * radius_m)
        return near[np.argsort(squared[near], kind="stable")]

    def path_lengths_m(self, node: int, most_m: float = math.inf) -> Array:
        """(n,) length of the shortest way from a node to each one along edges between nodes (all
        but markers), infinite beyond `most_m`. An edge is as long as the way it measured.
        """
        if self._roads is None:
            self._roads = self._make_roads()
        roads = self._roads
        lengths_m: Array = _dijkstra(roads.first, roads.other, roads.length_m, node, most_m)
        return lengths_m

    def trusted_and_candidates(
        self,
        node: int,
        radius_m: float,
        ratio: float = 2.0,
        slack_m: float = 2.0,
        detour_m: float = 6.0,
    ) -> tuple[Ints, Ints]:
        """The nodes within a radius of a node, the nearest first, in two parts: trusted neighbours,
        to which the way through the graph is at most `ratio` times the straight one plus
        `slack_m`, and longer than it by `detour_m` at most, so that little error has gathered on it
        (the node itself is one); and candidates for a loop, which are near by estimate only.
        """
        here = self._poses[node]
        near = self.nodes_near(float(here[0]), float(here[1]), radius_m)
        ways_m = self.path_lengths_m(node, ratio * radius_m + slack_m)[near]
        straight_m = portable.hypot_each(
            self._poses[near, 0] - here[0], self._poses[near, 1] - here[1]
        )
        trusted = ways_m <= np.minimum(ratio * straight_m + slack_m, straight_m + detour_m)
        return near[trusted], near[~trusted]

    def radius_m(self, node: int, least_m: float, reach_m: float, most: int) -> float:
        """How far from a node to look for what is seen from there: as far as its `most` nearest
        trusted neighbours stand within `reach_m`, at least `least_m`. So few keyframes far apart
        give as much of a map as many near ones.
        """
        if reach_m <= _FARTHER * least_m:
            return least_m
        near, _ = self.trusted_and_candidates(node, reach_m)
        if len(near) < most:
            return reach_m
        x, y = (self._poses[near[most - 1], :2] - self._poses[node, :2]).tolist()
        return max(least_m, math.hypot(x, y))

    def _make_roads(self) -> _Roads:
        edges = self.edges
        used = np.flatnonzero(edges.kind != MARKER)
        ends = np.concatenate([edges.source[used], edges.target[used]])
        others = np.concatenate([edges.target[used], edges.source[used]])
        length_m = portable.hypot_each(edges.relative[used, 0], edges.relative[used, 1])
        variance_m2 = edges.covariance[used, 0, 0] + edges.covariance[used, 1, 1]
        length_m += _UNSURE * np.maximum(np.sqrt(variance_m2) - _SURE_M, 0.0)
        order = np.argsort(ends, kind="stable")
        first = np.zeros(self._nodes + 1, np.int64)
        np.cumsum(np.bincount(ends, minlength=self._nodes), out=first[1:])
        return _Roads(first, others[order], np.concatenate([length_m, length_m])[order])


class _Roads(NamedTuple):
    """Edges by the nodes they start from: those of node i are first[i] to first[i + 1]."""

    first: Ints
    other: Ints
    length_m: Array


def _arrays(edges: Edges) -> list[NDArray[Any]]:
    return list(edges)


def information_of(covariance: Array) -> Array:
    """(3, 3) inverse of a covariance, exactly symmetric. Raises ValueError where it is not positive
    definite or not finite.
    """
    (a, b, c), (_, d, e), (_, _, f) = np.asarray(covariance, np.float64).tolist()
    u, v, w = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * u + b * v + c * w
    if not (a > 0.0 and a * d - b * b > 0.0 and 0.0 < determinant < math.inf):
        raise ValueError("covariance: must be positive definite")
    x, y, z = a * f - c * c, b * c - a * e, a * d - b * b
    inverse: Array = np.array([[u, v, w], [v, x, y], [w, y, z]]) / determinant
    if not np.isfinite(inverse).all():
        raise ValueError("covariance: must be positive definite")
    return inverse


def _room(array: NDArray[Any], count: int) -> NDArray[Any]:
    """The array, or one twice as long with its rows, if `count` of them are taken and no more
    are left.
    """
    if count < len(array):
        return array
    return np.concatenate([array, np.zeros_like(array)])


@kernel("float64[::1](int64[::1], int64[::1], float64[::1], int64, float64)")
def _dijkstra(first: Ints, other: Ints, length_m: Array, node: int, most_m: float) -> Array:
    lengths = np.full(first.size - 1, np.inf)
    done = np.zeros(first.size - 1, np.bool_)
    lengths[node] = 0.0
    heap = [(0.0, node)]
    while len(heap) > 0:
        length, here = heapq.heappop(heap)
        if done[here]:
            continue
        done[here] = True
        for i in range(first[here], first[here + 1]):
            there = other[i]
            total = length + length_m[i]
            if total <= most_m and total < lengths[there]:
                lengths[there] = total
                heapq.heappush(heap, (total, there))
    return lengths
