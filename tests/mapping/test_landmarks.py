import itertools
import math

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    Array,
    inverse_matrix,
    rotation_from_quaternion,
    rotation_from_vector,
    transform_matrix,
    wrap_angle,
)
from mazebot.mapping.graph.landmarks import (
    MarkerCandidate,
    MarkerLandmarks,
    Sighted,
    flatten,
    upright,
)
from mazebot.mapping.graph.landmarks import MarkerNoise as Noise
from mazebot.mapping.graph.pose_graph import MARKER, ODOMETRY, Graph
from tests.mapping.synthetic import STEP_COVARIANCE, noisy

CAMERA = transform_matrix(np.eye(3), (0.07, 0.0, 0.1)) @ LINK_FROM_OPTICAL
MARKER_POSE = SE2(3.0, 1.5, -1.2)
HEIGHT_M = 0.25
OWN = np.diag([0.002, 0.002, 0.004, 0.02, 0.05, 0.02]) ** 2
EXACT = np.diag([1e-8, 1e-8, 1e-8])
DICTIONARY = "DICT_4X4_100"


def marker_matrix(pose: SE2, tilt_rad: float = 0.0) -> Array:
    """map_from_marker, its face tilted up."""
    turn = rotation_from_quaternion(*upright(pose.yaw_rad)) @ rotation_from_vector(
        -tilt_rad, 0.0, 0.0
    )
    return transform_matrix(turn, (pose.x_m, pose.y_m, HEIGHT_M))


def seen_from(
    base: SE2,
    marker: SE2 = MARKER_POSE,
    score: float = 1.0,
    turn_rad: float = 0.0,
    tilt_rad: float = 0.0,
) -> MarkerCandidate:
    """What perception sees of a marker: exact but for a turn about the vertical."""
    turned = SE2(marker.x_m, marker.y_m, marker.yaw_rad + turn_rad)
    camera_from_map = inverse_matrix(base.matrix() @ CAMERA)
    return camera_from_map @ marker_matrix(turned, tilt_rad), OWN, score


def twin_turn_rad(base: SE2, marker: SE2 = MARKER_POSE) -> float:
    """By how much the other solution of a square is turned: its slant the other way."""
    to_camera = math.atan2(base.y_m - marker.y_m, base.x_m - marker.x_m)
    return wrap_angle(2.0 * (to_camera - marker.yaw_rad))


def walk(count: int = 12, step_m: float = 0.3) -> Graph:
    """Nodes along a line past the marker, where they are in truth."""
    graph = Graph()
    for i in range(count):
        graph.add_node(SE2(1.5 + step_m * i, 0.0, 0.6 + 0.06 * i))
        if i:
            relative = graph.pose(i - 1).inverse() @ graph.pose(i)
            graph.add_edge(ODOMETRY, i - 1, i, relative, STEP_COVARIANCE)
    return graph


def sight(
    markers: MarkerLandmarks, graph: Graph, node: int, *candidates: MarkerCandidate, name: int = 5
) -> Sighted:
    given = candidates or (seen_from(graph.pose(node)),)
    return markers.sight(node, SE2(0.0, 0.0, 0.0), EXACT, DICTIONARY, name, given, CAMERA)


def test_three_sightings_make_a_landmark_where_the_marker_hangs() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    outcomes = [sight(markers, graph, node).outcome for node in range(5)]
    assert outcomes == ["pending", "pending", "new", "added", "added"]
    (document,) = markers.documents()
    assert (document.dictionary, document.marker_id, document.instance) == (DICTIONARY, 5, 0)
    assert document.position_m == pytest.approx((3.0, 1.5, HEIGHT_M), abs=1e-3)
    assert document.sightings == 5
    assert 0.005 < document.std_m < 0.05
    normal = rotation_from_quaternion(*document.orientation_xyzw)[:, 2]
    assert normal == pytest.approx([math.cos(-1.2), math.sin(-1.2), 0.0], abs=1e-3)
    up = rotation_from_quaternion(*document.orientation_xyzw)[:, 1]
    assert up == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def test_sightings_on_the_way_past_one_keyframe_make_a_landmark_and_no_more_than_four() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    outcomes = []
    for step in range(30):
        off = SE2(0.02 * step, 0.0, 0.0)
        given = [seen_from(graph.pose(0) @ off)]
        outcomes.append(markers.sight(0, off, EXACT, DICTIONARY, 5, given, CAMERA).outcome)
    assert [one for one in outcomes if one != "ignored"] == ["pending", "pending", "new", "added"]
    assert graph.landmark(0).distance_m(MARKER_POSE) < 1e-3


def test_a_second_sighting_from_one_place_is_no_news() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    assert [sight(markers, graph, 0).outcome for _ in range(4)] == ["pending", *["ignored"] * 3]


def test_a_sighting_between_keyframes_is_attached_where_the_robot_was() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    off = SE2(0.1, -0.05, 0.2)
    for node in range(3):
        base = graph.pose(node) @ off
        given = [seen_from(base)]
        markers.sight(node, off, EXACT, DICTIONARY, 5, given, CAMERA)
    assert graph.landmark(0).distance_m(MARKER_POSE) < 1e-3


def test_flattened_is_the_pose_by_the_base() -> None:
    base = SE2(1.0, 0.2, 0.4)
    (one,) = flatten([seen_from(base)], CAMERA, Noise())
    expected = base.inverse() @ MARKER_POSE
    assert one.pose == pytest.approx(expected, abs=1e-9)
    assert one.height_m == pytest.approx(HEIGHT_M)
    # A range is known less well than a bearing.
    towards = np.array(expected[:2]) / math.hypot(*expected[:2])
    across = np.array([-towards[1], towards[0]])
    place = one.covariance[:2, :2]
    assert towards @ place @ towards > 1.5 * across @ place @ across


@pytest.mark.parametrize("tilt_deg", [-60.0, -12.0, 12.0, 90.0])
def test_what_does_not_hang_upright_is_left_out(tilt_deg: float) -> None:
    seen = seen_from(SE2(1.5, 0.0, 0.6), tilt_rad=math.radians(tilt_deg))
    assert flatten([seen], CAMERA, Noise()) == []


@pytest.mark.parametrize("tilt_deg", [-8.0, 8.0])
def test_what_hangs_almost_upright_is_used(tilt_deg: float) -> None:
    seen = seen_from(SE2(1.5, 0.0, 0.6), tilt_rad=math.radians(tilt_deg))
    assert len(flatten([seen], CAMERA, Noise())) == 1


@pytest.mark.parametrize("what", [0, 1, 2])
def test_what_is_not_finite_is_left_out(what: int) -> None:
    pose, covariance, score = seen_from(SE2(1.5, 0.0, 0.6))
    given = [pose, covariance, score]
    given[what] = given[what] * np.nan  # type: ignore[operator]
    assert flatten([tuple(given)], CAMERA, Noise()) == []  # type: ignore[list-item]


def test_of_two_solutions_those_that_agree_are_the_marker() -> None:
    """The wrong solution is a little likelier each time, but it turns with the robot."""
    graph = walk()
    markers = MarkerLandmarks(graph)
    for node in range(8):
        base = graph.pose(node)
        wrong = seen_from(base, score=0.55, turn_rad=twin_turn_rad(base))
        sight(markers, graph, node, wrong, seen_from(base, score=0.45))
    assert len(graph.landmarks) == 1
    off_rad = abs(wrap_angle(graph.landmark(0).yaw_rad - MARKER_POSE.yaw_rad))
    assert off_rad < 0.05
    assert graph.landmark(0).distance_m(MARKER_POSE) < 0.02


def test_two_solutions_that_nothing_tells_apart_give_range_and_bearing() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    for node in range(3):
        sight(markers, graph, node)
    base = graph.pose(6)
    one, other = (seen_from(base, score=0.5, turn_rad=turn) for turn in (0.06, -0.06))
    assert sight(markers, graph, 6, one, other).outcome == "added"
    assert graph.edges.covariance[-1][2, 2] > 1.0
    assert graph.edges.covariance[-1][0, 0] < 0.1


def test_another_marker_of_the_same_id_is_another_instance() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    for node in range(4):
        sight(markers, graph, node)
    elsewhere = SE2(5.0, 2.0, -1.6)
    outcomes = [
        sight(markers, graph, node, seen_from(graph.pose(node), elsewhere)).outcome
        for node in range(5, 9)
    ]
    assert outcomes == ["pending", "pending", "new", "added"]
    first, second = markers.documents()
    assert (first.instance, second.instance) == (0, 1)
    assert second.position_m[:2] == pytest.approx((5.0, 2.0), abs=0.01)
    assert first.position_m[:2] == pytest.approx((3.0, 1.5), abs=0.01)


def test_one_wrong_sighting_makes_nothing() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    for node in range(4):
        sight(markers, graph, node)
    wrong = seen_from(graph.pose(5), SE2(2.0, 2.5, -1.0))
    assert sight(markers, graph, 5, wrong).outcome == "pending"
    assert sight(markers, graph, 6).outcome == "added"
    assert len(markers.documents()) == 1


def test_an_id_of_another_dictionary_is_another_marker() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    for dictionary in ("DICT_4X4_100", "DICT_5X5_100"):
        for node in range(3):
            given = [seen_from(graph.pose(node))]
            markers.sight(node, SE2(0.0, 0.0, 0.0), EXACT, dictionary, 5, given, CAMERA)
    assert [one.instance for one in markers.documents()] == [0, 0]


def around(wrong_m: float = 0.0) -> tuple[list[Sighted], float, float, Graph]:
    """Once around a square of 8 m by odometry that drifts, past the marker at the start again:
    what became of the sightings there, and how far off the last node is before and after.
    """
    random = np.random.default_rng(2)
    truth = [SE2(1.5, 0.0, 0.6)]
    for i in range(1, 80):
        side = i // 19
        heading = side * math.pi / 2.0 + 0.6
        before = truth[-1]
        truth.append(SE2(
            before.x_m + 0.42 * math.cos(heading), before.y_m + 0.42 * math.sin(heading), heading
        ))  # fmt: skip
    graph = Graph()
    graph.add_node(truth[0])
    for before, after in itertools.pairwise(truth):
        step = noisy(before.inverse() @ after, STEP_COVARIANCE, random)
        graph.add_node(graph.pose(len(graph.poses) - 1) @ step)
        graph.add_edge(ODOMETRY, len(graph.poses) - 2, len(graph.poses) - 1, step, STEP_COVARIANCE)
    markers = MarkerLandmarks(graph)
    for node in range(4):
        sight(markers, graph, node, seen_from(truth[node]))
    off_m = graph.pose(79).distance_m(truth[79])
    moved = SE2(MARKER_POSE.x_m + wrong_m, MARKER_POSE.y_m, MARKER_POSE.yaw_rad)
    again = [sight(markers, graph, node, seen_from(truth[node], moved)) for node in (77, 78, 79)]
    return again, off_m, graph.pose(79).distance_m(truth[79]), graph


def test_a_marker_seen_again_closes_the_loop() -> None:
    again, before_m, after_m, graph = around()
    assert [one.outcome for one in again] == ["loop", "added", "added"]
    assert again[0].verdict is not None
    assert again[0].verdict.accepted
    assert before_m > 0.15
    assert after_m < 0.4 * before_m
    assert int((graph.edges.kind == MARKER).sum()) == 7


def test_a_marker_that_was_moved_closes_no_loop() -> None:
    again, before_m, after_m, _ = around(wrong_m=5.0)
    assert [one.outcome for one in again] == ["pending", "pending", "new"]
    assert after_m == before_m


def test_markers_go_on_after_a_restart() -> None:
    graph = walk()
    markers = MarkerLandmarks(graph)
    for node in range(4):
        sight(markers, graph, node)
    again = MarkerLandmarks.restored(graph, markers.documents())
    assert again.documents() == markers.documents()
    assert sight(again, graph, 3).outcome == "ignored"
    assert sight(again, graph, 4).outcome == "added"
    assert again.documents()[0].sightings == 5
