"""A pose graph against the truth."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.common.messages.slam_documents import (
    GraphEdge,
    GraphLandmark,
    GraphNode,
    GraphScan,
    PoseGraph,
)
from mazebot.recorder.judging.map.graph_errors import false_loops, marker_errors
from tests.recorder.synthetic import marker_on_the_east_wall

ENTITY = marker_on_the_east_wall()


def landmark(**changes: Any) -> GraphLandmark:
    return GraphLandmark(
        **{
            "dictionary": ENTITY.dictionary,
            "marker_id": ENTITY.marker_id,
            "position_m": ENTITY.position_m,
            "orientation_xyzw": ENTITY.orientation_xyzw,
            "std_m": 0.01,
            "sightings": 4,
        }
        | changes
    )


def turned_about_z(angle_rad: float) -> doc.Quaternion:
    """The marker's orientation after a turn on the plane."""
    s, c = math.sin(angle_rad / 2), math.cos(angle_rad / 2)
    x, y, z, w = ENTITY.orientation_xyzw
    return (c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z)


def test_a_marker_is_compared_with_that_of_its_id() -> None:
    x, y, z = ENTITY.position_m
    seen = landmark(position_m=(x + 0.03, y - 0.04, z), orientation_xyzw=turned_about_z(-0.1))
    errors = marker_errors([seen], [ENTITY])
    assert (errors.found, errors.missing, errors.false) == (1, 0, 0)
    assert errors.error_m.max == pytest.approx(0.05)
    assert errors.error_rad.max == pytest.approx(0.1)


def test_markers_of_another_id_or_far_away_are_false_and_unmapped_ones_missing() -> None:
    x, y, z = ENTITY.position_m
    others = [
        landmark(marker_id=61),
        landmark(dictionary="DICT_5X5_100"),
        landmark(position_m=(x - 2.0, y, z)),
    ]
    errors = marker_errors(others, [ENTITY])
    assert (errors.found, errors.missing, errors.false) == (0, 1, 3)
    assert errors.error_m.mean is None


def test_two_markers_of_one_id_take_one_landmark_each() -> None:
    x, y, z = ENTITY.position_m
    second = ENTITY.model_copy(update={"name": "second", "position_m": (x, y + 0.5, z)})
    near, far = landmark(), landmark(position_m=(x, y + 0.4, z), instance=1)
    errors = marker_errors([far, near], [ENTITY, second])
    assert (errors.found, errors.missing, errors.false) == (2, 0, 0)
    assert errors.error_m.max == pytest.approx(0.1)


def graph_of(*relatives: tuple[str, SE2]) -> PoseGraph:
    """Edges from node 0 to node 1, whose true poses are 1 m apart along x."""
    scan = GraphScan(points_mm="", sensor=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0))
    return PoseGraph(
        nodes=tuple(
            GraphNode(id=n, stamp_ns=n, pose=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0), scan=scan)
            for n in range(2)
        ),
        edges=tuple(
            GraphEdge(
                kind=kind, source=0, target=1,
                relative=doc.Planar(x_m=one.x_m, y_m=one.y_m, yaw_rad=one.yaw_rad),
                covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0), residual=0.0,
            )
            for kind, one in relatives
        ),
    )  # fmt: skip


def true_pose(stamp_ns: int) -> SE2 | None:
    return SE2(3.0, 4.0 + stamp_ns, math.pi / 2) if stamp_ns < 10 else None


def test_a_loop_that_contradicts_the_truth_is_false() -> None:
    right = ("loop", SE2(1.05, -0.1, 0.05))
    shifted, turned = ("loop", SE2(1.4, 0.0, 0.0)), ("loop", SE2(1.0, 0.0, 0.2))
    odometry = ("odometry", SE2(5.0, 0.0, 0.0))
    assert false_loops(graph_of(right, odometry), true_pose) == 0
    assert false_loops(graph_of(right, shifted, turned, odometry), true_pose) == 2


def test_a_loop_without_a_known_truth_is_not_judged() -> None:
    assert false_loops(graph_of(("loop", SE2(9.0, 0.0, 0.0))), lambda _: None) == 0
