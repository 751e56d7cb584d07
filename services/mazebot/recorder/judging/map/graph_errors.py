"""Errors of a pose graph: its markers against the world's, and its loops against the true poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from mazebot.common.maths.frames import SE2, rotation_from_quaternion, wrap_angle
from mazebot.common.messages.documents import (
    ErrorStatistics,
    MarkerEntity,
    MarkersMapped,
    Quaternion,
)
from mazebot.common.messages.slam_documents import GraphLandmark, PoseGraph

SAME_MARKER_M = 1.0
"""A marker on the map farther from every true one of its id is a false one."""
FALSE_LOOP_M, FALSE_LOOP_RAD = 0.3, math.radians(10.0)
"""A loop that is more off is a false one."""


def marker_errors(
    landmarks: Iterable[GraphLandmark], entities: Sequence[MarkerEntity]
) -> MarkersMapped:
    """Match each true marker with the nearest landmark of its dictionary and id, nearest pairs
    first.
    """
    mapped = list(landmarks)
    pairs = sorted(
        (math.dist(one.position_m, entity.position_m), index, number)
        for index, one in enumerate(mapped)
        for number, entity in enumerate(entities)
        if (one.dictionary, one.marker_id) == (entity.dictionary, entity.marker_id)
    )
    taken: dict[int, int] = {}
    errors_m, errors_rad = [], []
    for apart_m, index, number in pairs:
        if apart_m > SAME_MARKER_M or index in taken or number in taken.values():
            continue
        taken[index] = number
        errors_m.append(apart_m)
        headings = (mapped[index].orientation_xyzw, entities[number].orientation_xyzw)
        one, other = map(_heading, headings)
        errors_rad.append(abs(wrap_angle(one - other)))
    return MarkersMapped(
        found=len(taken),
        missing=len(entities) - len(taken),
        false=len(mapped) - len(taken),
        error_m=_statistics(errors_m),
        error_rad=_statistics(errors_rad),
    )


def false_loops(graph: PoseGraph, true_pose: Callable[[int], SE2 | None]) -> int:
    """The loop edges that contradict the true poses, map_from_base, at their nodes' stamps (ns);
    one without a known true pose is not counted.
    """
    stamps = {node.id: node.stamp_ns for node in graph.nodes}
    wrong = 0
    for edge in graph.edges:
        if edge.kind != "loop" or edge.source not in stamps or edge.target not in stamps:
            continue
        source, target = true_pose(stamps[edge.source]), true_pose(stamps[edge.target])
        if source is None or target is None:
            continue
        error = edge.relative.se2().inverse() @ (source.inverse() @ target)
        wrong += (
            math.hypot(error.x_m, error.y_m) > FALSE_LOOP_M or abs(error.yaw_rad) > FALSE_LOOP_RAD
        )
    return wrong


def _heading(orientation_xyzw: Quaternion) -> float:
    """Of a marker's face on the plane, rad."""
    face = rotation_from_quaternion(*orientation_xyzw)[:, 2]
    return math.atan2(float(face[1]), float(face[0]))


def _statistics(errors: list[float]) -> ErrorStatistics:
    if not errors:
        return ErrorStatistics()
    return ErrorStatistics(
        mean=float(np.mean(errors)), p95=float(np.percentile(errors, 95)), max=max(errors)
    )
