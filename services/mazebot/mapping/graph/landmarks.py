"""Markers as landmarks of the pose graph.

A marker hangs upright on a wall, so its pose is planar: x, y, and the heading of its normal. A
square seen from afar has two poses that look almost alike (IPPE), so a sighting has several
candidates, of which at most one is right. A marker becomes a landmark when it has been seen from
three places that agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, quaternion_from_rotation, wrap_angle
from mazebot.common.messages.slam_documents import GraphLandmark
from mazebot.mapping.graph.optimizer import (
    CHI2_99,
    Candidate,
    Covariances,
    LoopVerdict,
    close_loop,
)
from mazebot.mapping.graph.pose_graph import HUBER, MARKER, Graph, information_of

MarkerCandidate = tuple[Array, Array, float]
"""camera_from_marker (4, 4), its (6, 6) covariance of (x, y, z, turns about x, y, z), its score."""

_MOST_TILT_SINE = 0.17364817766693033
"""A normal more than 10 degrees from level is no marker on a wall."""
_LEAST_SIGHTINGS = 3
_APART_M, _APART_RAD = 0.1, 0.17
"""Sightings from places that are nearer to each other than both show the same."""
_MOST_AT_NODE = 4
"""Sightings of one marker that a keyframe keeps: the graph does not grow where the robot stays."""
_AMBIGUOUS_RATIO = 2.0
"""Two candidates with scores closer than this may be distinguished by the landmark only."""
_DISTINCT_CHI2 = 4.0
"""They are, if their chi2 differ by this."""
_UNKNOWN_TURN_RAD = 3.0
"""Standard deviation of a heading that is not known."""
_MOST_PENDING = 8
"""Places at which a marker of one id may be thought to hang without being a landmark."""
_WAY_RATIO, _WAY_SLACK_M = 2.0, 2.0
"""A way through the graph longer than this ratio of the straight one and slack closes a loop."""


@dataclass(frozen=True)
class MarkerNoise:
    """Noise added to a candidate's own covariance: errors of calibration, timing, placement."""

    position_std_m: float = 0.02
    range_ratio_per_m: float = 0.02
    """Standard deviation of the range, as a ratio of it, for each metre of it."""
    bearing_std_rad: float = 0.015
    yaw_std_rad: float = 0.1


@dataclass(frozen=True)
class Sighted:
    """What became of a sighting."""

    outcome: Literal["ignored", "pending", "added", "new", "loop", "loop_rejected"]
    """`ignored`: not usable, or this marker was seen from there already. `pending`: kept until
    there are enough. `added`: an edge more; the poses have not moved. `new`: a landmark more.
    `loop`: the edge closed a loop, and the poses have moved. `loop_rejected`: it would have.
    """
    landmark: int | None = None
    verdict: LoopVerdict | None = None


class FlatCandidate(NamedTuple):
    """One solution for a marker's pose, on the plane."""

    pose: SE2
    """frame_from_marker, its yaw that of the normal."""
    covariance: Array
    """(3, 3) of `pose`."""
    score: float
    height_m: float


@dataclass(frozen=True)
class _Observation:
    node: int
    candidates: tuple[FlatCandidate, ...]
    """By the axes of the node, the likeliest first."""


@dataclass
class _Record:
    """What is known of a landmark beside its pose."""

    dictionary: str
    marker_id: int
    instance: int
    sightings: int
    height_m: float


class MarkerLandmarks:
    """The markers of a graph."""

    def __init__(self, graph: Graph, noise: MarkerNoise = MarkerNoise()) -> None:
        """`graph`: changed by sightings; it has no landmarks of others."""
        self._graph = graph
        self._noise = noise
        self._records: list[_Record] = []
        self._pending: dict[tuple[str, int], list[list[_Observation]]] = {}
        self._seen_from: dict[tuple[str, int, int], list[SE2]] = {}
        """Of a marker and a node, where in the frame of the node the sightings were made."""

    @classmethod
    def restored(
        cls, graph: Graph, documents: Sequence[GraphLandmark], noise: MarkerNoise = MarkerNoise()
    ) -> MarkerLandmarks:
        """Go on with a graph whose landmarks are these, in this order."""
        markers = cls(graph, noise)
        for one in documents:
            markers._records.append(
                _Record(
                    one.dictionary, one.marker_id, one.instance, one.sightings, one.position_m[2]
                )
            )
        edges = graph.edges
        for edge in np.flatnonzero(edges.kind == MARKER).tolist():
            record = markers._records[int(edges.target[edge])]
            key = (record.dictionary, record.marker_id, int(edges.source[edge]))
            markers._seen_from.setdefault(key, []).append(SE2(0.0, 0.0, 0.0))
        return markers

    def sight(
        self,
        node: int,
        node_from_base: SE2,
        base_covariance: Array,
        dictionary: str,
        marker_id: int,
        candidates: Sequence[MarkerCandidate],
        base_from_camera: Array,
    ) -> Sighted:
        """Take one sighting of a marker into account.

        `node`: the keyframe to attach it to, the nearest one; of each marker it takes sightings
            from up to four places.
        `node_from_base`: where the robot was at the sighting, with its (3, 3) covariance.
        `base_from_camera`: rigid (4, 4), the camera's frame optical.
        """
        places = self._seen_from.setdefault((dictionary, marker_id, node), [])
        if len(places) >= _MOST_AT_NODE or any(_near(one, node_from_base) for one in places):
            return Sighted("ignored")
        flat = flatten(candidates, base_from_camera, self._noise)
        if not flat:
            return Sighted("ignored")
        places.append(node_from_base)
        seen = _Observation(
            node, tuple(_carried(one, node_from_base, base_covariance) for one in flat)
        )
        covariances = Covariances(self._graph)
        known = self._best_landmark(dictionary, marker_id, seen, covariances)
        if known is not None:
            return self._attach(*known, seen)
        return self._keep((dictionary, marker_id), seen, covariances)

    def documents(self) -> list[GraphLandmark]:
        """The landmarks in the order of the graph's, for its document."""
        covariances = Covariances(self._graph) if self._records else None
        made = []
        for index, record in enumerate(self._records):
            assert covariances is not None
            pose = self._graph.landmark(index)
            spread = covariances.landmark(index)
            made.append(
                GraphLandmark(
                    dictionary=record.dictionary,
                    marker_id=record.marker_id,
                    instance=record.instance,
                    position_m=(pose.x_m, pose.y_m, record.height_m),
                    orientation_xyzw=upright(pose.yaw_rad),
                    heading_rad=pose.yaw_rad,
                    std_m=math.sqrt(max(0.5 * float(spread[0, 0] + spread[1, 1]), 0.0)),
                    sightings=record.sightings,
                )
            )
        return made

    def _best_landmark(
        self, dictionary: str, marker_id: int, seen: _Observation, covariances: Covariances
    ) -> tuple[int, FlatCandidate] | None:
        """The landmark of this id that the sighting fits best, and the candidate that does; None
        if it fits none.
        """
        best: tuple[float, int, FlatCandidate] | None = None
        here = self._graph.pose(seen.node)
        for index, record in enumerate(self._records):
            if (record.dictionary, record.marker_id) != (dictionary, marker_id):
                continue
            expected = here.inverse() @ self._graph.landmark(index)
            spread = covariances.relative(seen.node, index, target_is_landmark=True)
            distances = [_distance(one, expected, spread) for one in seen.candidates]
            ranks = [
                distance + _lost(one.score, seen.candidates[0].score)
                if distance <= CHI2_99
                else math.inf
                for one, distance in zip(seen.candidates, distances, strict=True)
            ]
            rank = min(ranks)
            if rank == math.inf or (best is not None and rank >= best[0]):
                continue
            chosen = seen.candidates[ranks.index(rank)]
            if _ambiguous(seen.candidates) and abs(distances[0] - distances[1]) < _DISTINCT_CHI2:
                chosen = _without_turn(chosen)
            best = rank, index, chosen
        return None if best is None else best[1:]

    def _attach(self, landmark: int, chosen: FlatCandidate, seen: _Observation) -> Sighted:
        graph, record = self._graph, self._records[landmark]
        edge = Candidate(seen.node, landmark, chosen.pose, chosen.covariance, MARKER, HUBER)
        if self._closes_a_loop(seen.node, landmark):
            verdict = close_loop(graph, edge)
            if not verdict.accepted:
                return Sighted("loop_rejected", landmark, verdict)
            outcome: Literal["loop", "added"] = "loop"
        else:
            verdict = None
            outcome = "added"
            graph.add_edge(MARKER, seen.node, landmark, chosen.pose, chosen.covariance, HUBER)
        record.sightings += 1
        record.height_m += (chosen.height_m - record.height_m) / record.sightings
        return Sighted(outcome, landmark, verdict)

    def _closes_a_loop(self, node: int, landmark: int) -> bool:
        """Whether the way to all keyframes that saw the landmark is much longer than it looks."""
        edges = self._graph.edges
        before = edges.source[(edges.kind == MARKER) & (edges.target == landmark)]
        poses = self._graph.poses
        ways_m = self._graph.path_lengths_m(node)[before]
        straight_m = portable.hypot_each(
            poses[before, 0] - poses[node, 0], poses[before, 1] - poses[node, 1]
        )
        return bool((ways_m > _WAY_RATIO * straight_m + _WAY_SLACK_M).all())

    def _keep(self, key: tuple[str, int], seen: _Observation, covariances: Covariances) -> Sighted:
        """Keep a sighting with those that it agrees with; three make a landmark."""
        groups = self._pending.setdefault(key, [])
        for group in groups:
            if self._agree(group[0], seen, covariances):
                group.append(seen)
                if len(group) < _LEAST_SIGHTINGS:
                    return Sighted("pending")
                groups.remove(group)
                return Sighted("new", self._make(key, group))
        groups.append([seen])
        del groups[:-_MOST_PENDING]
        return Sighted("pending")

    def _agree(self, one: _Observation, other: _Observation, covariances: Covariances) -> bool:
        """Whether two sightings may be of a marker at one place."""
        there_from_here = self._graph.pose(other.node).inverse() @ self._graph.pose(one.node)
        spread = covariances.relative(other.node, one.node)
        return any(
            _distance(candidate, moved.pose, moved.covariance) <= CHI2_99
            for candidate in other.candidates
            for moved in (_carried(first, there_from_here, spread) for first in one.candidates)
        )

    def _make(self, key: tuple[str, int], group: list[_Observation]) -> int:
        """A landmark of sightings that agree, with the candidates whose headings agree best."""
        graph = self._graph
        placed = [
            [(graph.pose(seen.node) @ one.pose, one) for one in seen.candidates] for seen in group
        ]

        def misfit(yaw_rad: float, place: tuple[SE2, FlatCandidate], first: float) -> float:
            turn_rad = wrap_angle(place[0].yaw_rad - yaw_rad)
            squared = turn_rad * turn_rad / float(place[1].covariance[2, 2])
            return squared + _lost(place[1].score, first)

        headings = [place[0].yaw_rad for places in placed for place in places]
        misfits = [
            sum(
                min(misfit(heading, place, places[0][1].score) for place in places)
                for places in placed
            )
            for heading in headings
        ]
        heading = headings[misfits.index(min(misfits))]
        chosen = [min(places, key=lambda place: misfit(heading, place, 1.0)) for places in placed]
        # The nearest sighting is the most exact one.
        x_m, y_m, _ = min(
            chosen, key=lambda place: float(place[1].covariance[0, 0] + place[1].covariance[1, 1])
        )[0]
        landmark = graph.add_landmark(SE2(x_m, y_m, heading))
        for seen, (place, one) in zip(group, chosen, strict=True):
            off_rad = wrap_angle(place.yaw_rad - heading)
            doubtful = off_rad * off_rad > 9.0 * float(one.covariance[2, 2])
            used = _without_turn(one) if doubtful else one
            graph.add_edge(MARKER, seen.node, landmark, used.pose, used.covariance, HUBER)
        instances = [
            record.instance
            for record in self._records
            if (record.dictionary, record.marker_id) == key
        ]
        height_m = sum(one.height_m for _, one in chosen) / len(chosen)
        self._records.append(_Record(*key, max(instances, default=-1) + 1, len(group), height_m))
        return landmark


def flatten(
    candidates: Sequence[MarkerCandidate], base_from_camera: Array, noise: MarkerNoise
) -> list[FlatCandidate]:
    """The candidates that may be a marker on a wall, in the base's frame, the likeliest first.

    Left out are those that are not finite, and those whose normals are not level.
    """
    found = []
    for camera_from_marker, covariance, score in candidates:
        one = _flat(camera_from_marker, covariance, score, base_from_camera, noise)
        if one is not None:
            found.append(one)
    return sorted(found, key=lambda one: -one.score)


def upright(yaw_rad: float) -> tuple[float, float, float, float]:
    """Orientation (x, y, z, w) of a marker on a wall by the heading of its normal: its x axis to
    its right, y up, z out of its face.
    """
    c, s = portable.cos_sin(yaw_rad)
    return quaternion_from_rotation(np.array([[-s, 0.0, c], [c, 0.0, s], [0.0, 1.0, 0.0]]))


def _flat(
    camera_from_marker: Array,
    covariance: Array,
    score: float,
    base_from_camera: Array,
    noise: MarkerNoise,
) -> FlatCandidate | None:
    if not (np.isfinite(camera_from_marker).all() and np.isfinite(covariance).all()):
        return None
    if not (math.isfinite(score) and score >= 0.0):
        return None
    base_from_marker = portable.product(base_from_camera, camera_from_marker)
    if abs(float(base_from_marker[2, 2])) > _MOST_TILT_SINE:
        return None
    x_m, y_m, height_m = base_from_marker[:3, 3].tolist()
    range_m = max(math.sqrt(x_m * x_m + y_m * y_m), 1e-3)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = base_from_camera[:3, :3]
    own = portable.product(turn, covariance, turn.T)
    planar = own[np.ix_((0, 1, 5), (0, 1, 5))]
    towards = np.array([x_m, y_m]) / range_m
    across = np.array([-towards[1], towards[0]])
    range_std_m = noise.range_ratio_per_m * range_m * range_m
    planar[:2, :2] += portable.square(noise.position_std_m) * np.eye(2)
    planar[:2, :2] += portable.square(range_std_m) * np.outer(towards, towards)
    planar[:2, :2] += portable.square(noise.bearing_std_rad * range_m) * np.outer(across, across)
    planar[2, 2] += portable.square(noise.yaw_std_rad)
    try:
        information_of(planar)
    except ValueError:
        return None
    heading = portable.atan2(float(base_from_marker[1, 2]), float(base_from_marker[0, 2]))
    return FlatCandidate(SE2(x_m, y_m, heading), planar, score, height_m)


def _near(one: SE2, other: SE2) -> bool:
    turn_rad = abs(wrap_angle(one.yaw_rad - other.yaw_rad))
    return one.distance_m(other) < _APART_M and turn_rad < _APART_RAD


def _carried(one: FlatCandidate, frame_from_base: SE2, covariance: Array) -> FlatCandidate:
    """A candidate of the base's frame in another one; (3, 3) covariance of `frame_from_base`."""
    pose = frame_from_base @ one.pose
    c, s = portable.cos_sin(frame_from_base.yaw_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    lever = np.eye(3)
    lever[0, 2] = -(pose.y_m - frame_from_base.y_m)
    lever[1, 2] = pose.x_m - frame_from_base.x_m
    spread = portable.product(turn, one.covariance, turn.T)
    spread += portable.product(lever, covariance, lever.T)
    return one._replace(pose=pose, covariance=0.5 * (spread + spread.T))


def _distance(one: FlatCandidate, expected: SE2, spread: Array) -> float:
    """Squared Mahalanobis distance of a candidate from where it is expected with this (3, 3)
    covariance.
    """
    error = np.array(
        [
            one.pose.x_m - expected.x_m,
            one.pose.y_m - expected.y_m,
            wrap_angle(one.pose.yaw_rad - expected.yaw_rad),
        ]
    )
    return float(portable.product(error, information_of(one.covariance + spread), error))


def _lost(score: float, best: float) -> float:
    """What a candidate's score adds to its chi2, compared with the likeliest one's."""
    return -2.0 * portable.log(max(score, 1e-12) / max(best, 1e-12))


def _ambiguous(candidates: Sequence[FlatCandidate]) -> bool:
    return len(candidates) > 1 and candidates[0].score < _AMBIGUOUS_RATIO * candidates[1].score


def _without_turn(one: FlatCandidate) -> FlatCandidate:
    """The same by range and bearing only."""
    spread = one.covariance.copy()
    spread[:2, 2] = spread[2, :2] = 0.0
    spread[2, 2] = portable.square(_UNKNOWN_TURN_RAD)
    return one._replace(covariance=spread)
