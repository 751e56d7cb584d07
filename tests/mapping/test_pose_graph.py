import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.mapping.graph.pose_graph import (
    CAUCHY,
    LOOP,
    MARKER,
    ODOMETRY,
    Graph,
    information_of,
)

COVARIANCE = np.diag([0.01, 0.02, 0.03])


def corridor_and_back(count: int = 40) -> Graph:
    """Nodes 0.5 m apart, to the end and back along a line 0.2 m beside."""
    graph = Graph()
    for i in range(count):
        back = i >= count // 2
        x_m = 0.5 * (count - 1 - i if back else i)
        graph.add_node(SE2(x_m, 0.2 if back else 0.0, math.pi if back else 0.0))
        if i:
            relative = graph.pose(i - 1).inverse() @ graph.pose(i)
            graph.add_edge(ODOMETRY, i - 1, i, relative, COVARIANCE)
    return graph


def contents(graph: Graph) -> list[bytes]:
    return [graph.poses.tobytes(), graph.landmarks.tobytes(), *(a.tobytes() for a in graph.edges)]


def test_nodes_on_the_way_back_are_candidates_and_those_on_the_way_are_trusted() -> None:
    graph = corridor_and_back()
    trusted, candidates = graph.trusted_and_candidates(38, 1.6)
    assert trusted[0] == 38
    assert set(trusted.tolist()) == {35, 36, 37, 38, 39}
    assert set(candidates.tolist()) == {0, 1, 2, 3, 4}


def test_a_loop_makes_candidates_trusted() -> None:
    graph = corridor_and_back()
    relative = graph.pose(1).inverse() @ graph.pose(38)
    graph.add_edge(LOOP, 1, 38, relative, COVARIANCE, CAUCHY)
    _, candidates = graph.trusted_and_candidates(38, 1.6)
    assert len(candidates) == 0


def test_near_nodes_of_the_end_of_the_corridor_are_trusted_though_it_turned() -> None:
    _, candidates = corridor_and_back().trusted_and_candidates(20, 1.6)
    assert len(candidates) == 0


def test_far_nodes_are_trusted_along_a_straight_way_only() -> None:
    graph = corridor_and_back(80)
    trusted, candidates = graph.trusted_and_candidates(60, 9.0)
    # The same place on the way there is 20 m away by the graph; the turn is 10 m away.
    assert {19, 20}.issubset(candidates.tolist())
    assert {42, 78}.issubset(trusted.tolist())
    # 2 m beyond the turn and 6 m back would do for a near node.
    assert {32, 33}.issubset(candidates.tolist())


def test_few_nodes_far_apart_are_looked_for_farther_away_than_many() -> None:
    graph = Graph()
    for i in range(20):
        graph.add_node(SE2(1.0 * i, 0.0, 0.0))
        if i:
            relative = graph.pose(i - 1).inverse() @ graph.pose(i)
            graph.add_edge(ODOMETRY, i - 1, i, relative, COVARIANCE)
    # As far as the seventh, at least 3 m, and no farther than the lidar sees.
    assert graph.radius_m(0, 3.0, 12.0, 7) == pytest.approx(6.0)
    assert graph.radius_m(0, 3.0, 12.0, 2) == 3.0
    assert graph.radius_m(0, 3.0, 4.5, 7) == 4.5
    assert graph.radius_m(0, 3.0, 2.0, 7) == 3.0


def test_ways_do_not_lead_over_markers() -> None:
    graph = Graph()
    for x_m in (0.0, 1.0):
        graph.add_node(SE2(x_m, 0.0, 0.0))
    landmark = graph.add_landmark(SE2(0.5, 1.0, -1.5))
    graph.add_edge(MARKER, 0, landmark, SE2(0.5, 1.0, -1.5), COVARIANCE)
    graph.add_edge(MARKER, 1, landmark, SE2(-0.5, 1.0, -1.5), COVARIANCE)
    assert graph.path_lengths_m(0).tolist() == [0.0, math.inf]


def test_ways_end_at_their_limit() -> None:
    lengths_m = corridor_and_back().path_lengths_m(0, 2.0)
    assert lengths_m[:6].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, math.inf]


def test_a_removed_edge_is_no_way_any_more() -> None:
    graph = corridor_and_back()
    assert math.isfinite(graph.path_lengths_m(0)[10])
    graph.remove_edge(4)
    assert math.isfinite(graph.path_lengths_m(0)[4])
    assert math.isinf(graph.path_lengths_m(0)[5])
    assert graph.edges.target.tolist() == [1, 2, 3, 4, *range(6, 40)]


def test_a_graph_goes_back_to_a_snapshot_bit_by_bit() -> None:
    graph = corridor_and_back()
    graph.add_landmark(SE2(1.0, 2.0, 3.0))
    before, saved = contents(graph), graph.snapshot()
    for i in range(200):
        graph.add_landmark(SE2(0.0, 0.0, 0.0))
        graph.add_edge(MARKER, i % 40, 1, SE2(1.0, 1.0, 1.0), COVARIANCE)
        graph.add_node(SE2(0.0, 0.0, 0.0))
    graph.poses[:] += 1.0
    graph.remove_edge(0)
    assert contents(graph) != before
    graph.restore(saved)
    assert contents(graph) == before
    assert math.isfinite(graph.path_lengths_m(0)[39])


def test_nodes_near_a_point_come_in_order_of_distance() -> None:
    graph = corridor_and_back()
    assert graph.nodes_near(0.6, 0.0, 0.42).tolist() == [1, 38, 2]


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((3, 3)),
        -COVARIANCE,
        np.full((3, 3), np.nan),
        np.ones((3, 3)),
        np.diag([np.inf] * 3),
    ],
)
def test_a_covariance_that_is_none_is_refused(covariance: np.ndarray) -> None:
    graph = corridor_and_back()
    before = contents(graph)
    with pytest.raises(ValueError, match="positive definite"):
        graph.add_edge(LOOP, 0, 1, SE2(0.0, 0.0, 0.0), covariance)
    assert contents(graph) == before


@pytest.mark.parametrize(("source", "target"), [(0, 40), (-1, 0), (40, 0), (0, -1)])
def test_an_edge_to_nowhere_is_refused(source: int, target: int) -> None:
    with pytest.raises(ValueError, match="no such node"):
        corridor_and_back().add_edge(LOOP, source, target, SE2(0.0, 0.0, 0.0), COVARIANCE)


def test_information_is_the_inverse_of_covariance() -> None:
    random = np.random.default_rng(3)
    root = random.normal(size=(3, 3))
    covariance = root @ root.T
    information = information_of(covariance)
    assert information @ covariance == pytest.approx(np.eye(3), abs=1e-9)
    assert (information == information.T).all()


def test_poses_come_back_as_given() -> None:
    graph = Graph()
    pose = SE2(0.1, 0.2, wrap_angle(7.0))
    assert graph.pose(graph.add_node(pose)) == pose
    assert graph.landmark(graph.add_landmark(pose)) == pose


def test_what_a_way_without_scans_leads_to_is_not_trusted() -> None:
    graph = corridor_and_back(20)
    end = graph.pose(19)
    graph.add_node(end @ SE2(8.0, 0.0, 0.0))
    relative = end.inverse() @ graph.pose(20)
    graph.add_edge(ODOMETRY, 19, 20, relative, np.diag([0.64, 0.64, 0.01]))
    assert graph.path_lengths_m(20)[19] > 14.0
    trusted, _ = graph.trusted_and_candidates(20, 9.0)
    assert trusted.tolist() == [20]
