"""Optimises a pose graph: the poses that fit all edges best, in the least-squares sense.

The error of an edge is the measured `source_from_target` subtracted from the one of the poses: x
and y by the axes of the source, yaw wrapped. Its squared Mahalanobis distance is its chi2. Node 0
is held. The method is Levenberg's and Marquardt's, with iteratively reweighted robust kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.maths.kernels import kernel
from mazebot.common.maths.portable_kernels import cos_sin, log
from mazebot.mapping.graph.pose_graph import (
    CAUCHY,
    HUBER,
    LOOP,
    MARKER,
    Graph,
    Ints,
    information_of,
)
from mazebot.mapping.graph.sparse_cholesky import Factor, Structure, analyse, factorize

CHI2_99 = 11.345
"""99 % of the squared Mahalanobis distances of three numbers are below it."""
_WIDTH2 = 7.815
"""Squared width of the robust kernels: 95 % of the right edges are within it."""
_UNKNOWN = 1e-6
"""Information added to each number, so that one which no edge determines stays where it is."""
_STEP = 1e-6
"""Metres and radians: an optimisation has converged when no pose moves farther."""
_GAIN = 1e-9
"""Share of the cost: or when a step gains less."""


@dataclass(frozen=True)
class Optimized:
    """How an optimisation ended."""

    iterations: int
    converged: bool
    cost: float
    """Sum of the robust kernels of all chi2."""
    chi2: Array
    """(m,) of the edges, without robust kernels."""


@dataclass(frozen=True)
class Candidate:
    """A loop that may be one: a pose of a node measured in the frame of another."""

    source: int
    target: int
    """Of a MARKER, a landmark."""
    source_from_target: SE2
    covariance: Array
    """(3, 3) of the three numbers of `source_from_target`."""
    kind: int = LOOP
    robust: int = CAUCHY


@dataclass(frozen=True)
class LoopVerdict:
    """What became of a candidate."""

    accepted: bool
    reason: str
    """One line, for logs; empty where accepted."""
    innovation: float
    """Its chi2 by the poses before, with their relative covariance; of several the largest."""
    residual: float
    """Its chi2 after optimising, of several the largest; NaN where it was not tried."""
    edges: tuple[int, ...] = ()
    """Indices of the edges added."""


def optimize(graph: Graph, most_iterations: int = 30) -> Optimized:
    """Move the nodes (all but node 0) and landmarks of a graph to where they fit its edges best.

    What no edge joins to node 0 keeps its place as a whole.
    """
    system = _system(graph)
    poses, landmarks = graph.poses.copy(), graph.landmarks.copy()
    cost, diagonal, above, gradient, distances = _linearized(graph, system, poses, landmarks)
    damping, iterations, converged = 1e-6, 0, len(gradient) == 0
    while not converged and iterations < most_iterations:
        iterations += 1
        factor = factorize(system.structure, _damped(diagonal, damping), above)
        if factor is None:
            damping *= 10.0
            continue
        steps = factor.solve(-gradient)
        moved, moved_landmarks = _moved(poses, landmarks, steps)
        there = _linearized(graph, system, moved, moved_landmarks)
        if there[0] <= cost:
            gain = cost - there[0]
            converged = gain <= _GAIN * cost or float(np.abs(steps).max()) <= _STEP
            poses, landmarks = moved, moved_landmarks
            cost, diagonal, above, gradient, distances = there
            damping = max(damping * 0.1, 1e-9)
        else:
            converged = float(np.abs(steps).max()) <= _STEP
            damping *= 10.0
    graph.poses[:] = poses
    graph.landmarks[:] = landmarks
    return Optimized(iterations, converged, cost, distances)


def chi2(graph: Graph) -> Array:
    """(m,) squared Mahalanobis distance of each edge's error by the poses as they are."""
    edges = graph.edges
    distances = np.empty(len(edges.kind))
    _chi2(
        graph.poses, graph.landmarks, edges.kind, edges.source, edges.target, edges.relative,
        edges.information, distances,
    )  # fmt: skip
    return distances


class Covariances:
    """Covariances of poses by the edges, with node 0 held; of the graph as it is when made."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._system = _system(graph)
        _, diagonal, above, _, _ = _linearized(graph, self._system, graph.poses, graph.landmarks)
        factor = factorize(self._system.structure, diagonal, above)
        if factor is None:
            factor = factorize(self._system.structure, _damped(diagonal, 1e-6), above)
        self._factor: Factor | None = factor

    def joint(self, one: int, other: int) -> Array:
        """(6, 6) of two variables: of nodes by their index, of landmarks by the number of nodes
        plus theirs.
        """
        result = np.zeros((6, 6))
        if self._factor is None:
            return np.eye(6) / _UNKNOWN
        places = (one - 1, other - 1)
        for i, place in enumerate(places):
            if place < 0:
                continue
            if i == 1 and one == other:
                result[:, 3:] = result[:, :3]
                continue
            for axis in range(3):
                given = np.zeros((len(self._system.structure.position), 3))
                given[place, axis] = 1.0
                column = self._factor.solve(given)
                for j, row in enumerate(places):
                    if row >= 0:
                        result[3 * j : 3 * j + 3, 3 * i + axis] = column[row]
        return 0.5 * (result + result.T)

    def relative(self, source: int, target: int, target_is_landmark: bool = False) -> Array:
        """(3, 3) of source_from_target, x and y by the axes of the source node."""
        count = len(self._graph.poses)
        joint = self.joint(source, target + count if target_is_landmark else target)
        here = self._graph.pose(source)
        there = self._graph.landmark(target) if target_is_landmark else self._graph.pose(target)
        relative = here.inverse() @ there
        c, s = portable.cos_sin(here.yaw_rad)
        turned = np.array(
            [
                [-c, -s, relative.y_m, c, s, 0.0],
                [s, -c, -relative.x_m, -s, c, 0.0],
                [0.0, 0.0, -1.0, 0.0, 0.0, 1.0],
            ]
        )
        return portable.product(turned, joint, turned.T)

    def node(self, node: int) -> Array:
        """(3, 3) of map_from_base of a node; zeros of node 0."""
        return self.joint(node, node)[:3, :3]

    def landmark(self, landmark: int) -> Array:
        """(3, 3) of map_from_landmark."""
        index = landmark + len(self._graph.poses)
        return self.joint(index, index)[:3, :3]


def relative_covariance(
    graph: Graph, source: int, target: int, target_is_landmark: bool = False
) -> Array:
    """(3, 3) covariance of source_from_target by the poses as they are, x and y by the axes of the
    source. For several of one graph `Covariances` is faster.
    """
    return Covariances(graph).relative(source, target, target_is_landmark)


def innovation(graph: Graph, candidate: Candidate, covariances: Covariances) -> float:
    """Squared Mahalanobis distance of a measured pose from the one that the graph expects, by the
    covariance of both; the graph does not hold the measurement yet.
    """
    landmark = candidate.kind == MARKER
    here = graph.pose(candidate.source)
    there = graph.landmark(candidate.target) if landmark else graph.pose(candidate.target)
    expected = here.inverse() @ there
    measured = candidate.source_from_target
    error = np.array(
        [
            expected.x_m - measured.x_m,
            expected.y_m - measured.y_m,
            wrap_angle(expected.yaw_rad - measured.yaw_rad),
        ]
    )
    spread = covariances.relative(candidate.source, candidate.target, landmark)
    information = information_of(spread + np.asarray(candidate.covariance))
    return float(portable.product(error, information, error))


def close_loop(
    graph: Graph,
    candidates: Candidate | Sequence[Candidate],
    limit: float = CHI2_99,
    gate: float | None = None,
) -> LoopVerdict:
    """Try a loop, or several that stand and fall together: gate by the relative covariance, add
    with a robust kernel, optimise, test again. Where rejected the graph is as before, bit by bit.

    `limit`: the largest chi2 of each in the gate and after optimising. Of the other edges none may
    go beyond the limit by it, and their chi2 together may grow by it for each candidate.
    `gate`: the largest chi2 in the gate, if that is another.
    """
    gate = limit if gate is None else gate
    tried = [candidates] if isinstance(candidates, Candidate) else list(candidates)
    covariances = Covariances(graph)
    worst = max((innovation(graph, each, covariances) for each in tried), default=math.inf)
    if not worst <= gate:
        reason = f"{worst:.1f} from where it is expected, more than {gate:g}"
        return LoopVerdict(False, reason, worst, math.nan)
    before = chi2(graph)
    saved = graph.snapshot()
    added = tuple(
        graph.add_edge(
            each.kind,
            each.source,
            each.target,
            each.source_from_target,
            each.covariance,
            each.robust,
        )
        for each in tried
    )
    optimized = optimize(graph)
    residual = float(optimized.chi2[list(added)].max())
    others = optimized.chi2[: len(before)]
    broken = (others > limit) & (others > before + 0.5 * limit)
    reason = ""
    if not residual <= limit:
        reason = f"{residual:.1f} from where it is after optimising, more than {limit:g}"
    elif broken.any():
        edge = int(np.flatnonzero(broken)[0])
        reason = f"edge {edge} would be off by {others[edge]:.1f} instead of {before[edge]:.1f}"
    elif not float(others.sum() - before.sum()) <= limit * len(tried):
        reason = f"the other edges would be off by {others.sum():.1f}, not {before.sum():.1f}"
    elif not optimized.converged:
        reason = "does not converge"
    if reason:
        graph.restore(saved)
        return LoopVerdict(False, reason, worst, residual)
    return LoopVerdict(True, "", worst, residual, added)


class _System(NamedTuple):
    """The equations of a graph."""

    structure: Structure
    slot: Ints
    """(m,) block above the diagonal of each edge; -1: one of its ends is held."""
    transposed: NDArray[np.bool_]
    """(m,) whether its source is eliminated after its target."""


def _system(graph: Graph) -> _System:
    edges, nodes = graph.edges, len(graph.poses)
    source = edges.source - 1
    target = np.where(edges.kind == MARKER, edges.target + nodes, edges.target) - 1
    count = max(nodes - 1, 0) + len(graph.landmarks)
    free = np.flatnonzero((source >= 0) & (target >= 0) & (source != target))
    structure = analyse(count, np.stack([source[free], target[free]], axis=1))
    slot = np.full(len(source), -1, np.int64)
    slot[free] = structure.slot
    transposed = np.zeros(len(source), np.bool_)
    transposed[free] = structure.position[source[free]] > structure.position[target[free]]
    return _System(structure, slot, transposed)


def _linearized(
    graph: Graph, system: _System, poses: Array, landmarks: Array
) -> tuple[float, Array, Array, Array, Array]:
    """Cost, blocks of the diagonal and above it, gradient, and (m,) chi2."""
    edges, structure = graph.edges, system.structure
    count = len(structure.position)
    diagonal, above = np.zeros((count, 3, 3)), np.zeros((len(structure.row), 3, 3))
    gradient, distances = np.zeros((count, 3)), np.empty(len(edges.kind))
    cost = _linearize(
        poses, landmarks, edges.kind, edges.source, edges.target, edges.relative,
        edges.information, edges.robust, structure.position, system.slot, system.transposed,
        diagonal, above, gradient, distances,
    )  # fmt: skip
    return float(cost), diagonal, above, gradient, distances


def _damped(diagonal: Array, damping: float) -> Array:
    damped = diagonal.copy()
    for axis in range(3):
        damped[:, axis, axis] *= 1.0 + damping
    return damped


def _moved(poses: Array, landmarks: Array, steps: Array) -> tuple[Array, Array]:
    free = max(len(poses) - 1, 0)
    moved, moved_landmarks = poses.copy(), landmarks + steps[free:]
    moved[1:] += steps[:free]
    for rows in (moved, moved_landmarks):
        rows[:, 2] = (rows[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return moved, moved_landmarks


@kernel(
    "float64(float64[::1], float64[::1], float64[::1], float64[:, ::1], float64[::1], float64[::1])"
)
def _error(
    source: Array, target: Array, relative: Array, information: Array, error: Array, axes: Array
) -> float:
    """Chi2 of an edge; writes its error, and (cos, sin, x, y): of the source's heading, and the
    target by the axes of the source.
    """
    c, s = cos_sin(source[2])
    dx, dy = target[0] - source[0], target[1] - source[1]
    axes[0], axes[1], axes[2], axes[3] = c, s, c * dx + s * dy, c * dy - s * dx
    error[0], error[1] = axes[2] - relative[0], axes[3] - relative[1]
    turn = target[2] - source[2] - relative[2]
    error[2] = (turn + math.pi) % (2.0 * math.pi) - math.pi
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += error[a] * information[a, b] * error[b]
    return total


@kernel(
    "void(float64[:, ::1], float64[:, ::1], int8[::1], int64[::1], int64[::1], float64[:, ::1], "
    "float64[:, :, ::1], float64[::1])"
)
def _chi2(
    poses: Array,
    landmarks: Array,
    kind: NDArray[np.int8],
    source: Ints,
    target: Ints,
    relative: Array,
    information: Array,
    distances: Array,
) -> None:
    error, axes = np.empty(3), np.empty(4)
    for m in range(kind.size):
        there = landmarks[target[m]] if kind[m] == MARKER else poses[target[m]]
        distances[m] = _error(poses[source[m]], there, relative[m], information[m], error, axes)


@kernel(
    "float64(float64[:, ::1], float64[:, ::1], int8[::1], int64[::1], int64[::1], "
    "float64[:, ::1], float64[:, :, ::1], int8[::1], int64[::1], int64[::1], boolean[::1], "
    "float64[:, :, ::1], float64[:, :, ::1], float64[:, ::1], float64[::1])"
)
def _linearize(
    poses: Array,
    landmarks: Array,
    kind: NDArray[np.int8],
    source: Ints,
    target: Ints,
    relative: Array,
    information: Array,
    robust: NDArray[np.int8],
    position: Ints,
    slot: Ints,
    transposed: NDArray[np.bool_],
    diagonal: Array,
    above: Array,
    gradient: Array,
    distances: Array,
) -> float:
    nodes = poses.shape[0]
    error, axes = np.empty(3), np.empty(4)
    # Derivatives of the error by the two poses, and the information times each.
    by = np.zeros((2, 3, 3))
    weighed = np.empty((2, 3, 3))
    cost = 0.0
    for i in range(diagonal.shape[0]):
        for a in range(3):
            diagonal[i, a, a] = _UNKNOWN
    for m in range(kind.size):
        marker = kind[m] == MARKER
        there = landmarks[target[m]] if marker else poses[target[m]]
        distance = _error(poses[source[m]], there, relative[m], information[m], error, axes)
        distances[m] = distance
        weight = 1.0
        if robust[m] == HUBER and distance > _WIDTH2:
            root = math.sqrt(_WIDTH2 * distance)
            cost += 2.0 * root - _WIDTH2
            weight = root / distance
        elif robust[m] == CAUCHY:
            cost += _WIDTH2 * log(1.0 + distance / _WIDTH2)
            weight = 1.0 / (1.0 + distance / _WIDTH2)
        else:
            cost += distance
        c, s = axes[0], axes[1]
        by[0, 0, 0], by[0, 0, 1], by[0, 0, 2] = -c, -s, axes[3]
        by[0, 1, 0], by[0, 1, 1], by[0, 1, 2] = s, -c, -axes[2]
        by[0, 2, 2] = -1.0
        by[1, 0, 0], by[1, 0, 1] = c, s
        by[1, 1, 0], by[1, 1, 1] = -s, c
        by[1, 2, 2] = 1.0
        for end in range(2):
            for a in range(3):
                for b in range(3):
                    weighed[end, a, b] = weight * (
                        information[m, a, 0] * by[end, 0, b]
                        + information[m, a, 1] * by[end, 1, b]
                        + information[m, a, 2] * by[end, 2, b]
                    )
        for end in range(2):
            if end == 0:
                place = source[m] - 1
            else:
                place = target[m] + nodes - 1 if marker else target[m] - 1
            if place < 0:
                continue
            into = diagonal[position[place]]
            for a in range(3):
                gradient[place, a] += (
                    weighed[end, 0, a] * error[0]
                    + weighed[end, 1, a] * error[1]
                    + weighed[end, 2, a] * error[2]
                )
                for b in range(3):
                    into[a, b] += (
                        by[end, 0, a] * weighed[end, 0, b]
                        + by[end, 1, a] * weighed[end, 1, b]
                        + by[end, 2, a] * weighed[end, 2, b]
                    )
        if slot[m] >= 0:
            into = above[slot[m]]
            one, other = (1, 0) if transposed[m] else (0, 1)
            for a in range(3):
                for b in range(3):
                    into[a, b] += (
                        by[one, 0, a] * weighed[other, 0, b]
                        + by[one, 1, a] * weighed[other, 1, b]
                        + by[one, 2, a] * weighed[other, 2, b]
                    )
    return cost
