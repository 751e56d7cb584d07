import math
import time

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import linalg

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.mapping.graph.optimizer import (
    CHI2_99,
    Candidate,
    Covariances,
    chi2,
    close_loop,
    optimize,
    relative_covariance,
)
from mazebot.mapping.graph.pose_graph import CAUCHY, HUBER, LOOP, MARKER, ODOMETRY, Graph
from mazebot.mapping.graph.sparse_cholesky import analyse, factorize
from tests.mapping.synthetic import (
    LOOP_COVARIANCE,
    STEP_COVARIANCE,
    errors_m,
    manhattan,
    meetings,
    noisy,
    odometry_graph,
)


def looped(count: int, seed: int, every: int = 3, side: int = 20) -> tuple[Graph, list[SE2]]:
    """A graph with odometry and right loops, and its true poses."""
    random = np.random.default_rng(seed)
    truth = manhattan(count, seed, side)
    graph = odometry_graph(truth, random)
    for i, j in meetings(truth)[::every]:
        measured = noisy(truth[i].inverse() @ truth[j], LOOP_COVARIANCE, random)
        graph.add_edge(LOOP, i, j, measured, LOOP_COVARIANCE, CAUCHY)
    return graph, truth


def contents(graph: Graph) -> list[bytes]:
    return [graph.poses.tobytes(), graph.landmarks.tobytes(), *(a.tobytes() for a in graph.edges)]


def test_loops_take_the_drift_away() -> None:
    graph, truth = looped(1000, seed=1)
    before = errors_m(graph, truth)
    result = optimize(graph)
    assert result.converged
    assert errors_m(graph, truth).mean() < 0.25 * before.mean()
    assert graph.pose(0) == truth[0]
    # Each loop adds three numbers more than are unknown.
    loops = int((graph.edges.kind == LOOP).sum())
    assert 0.6 * 3 * loops < result.chi2.sum() < 1.6 * 3 * loops


def test_poses_off_by_three_tenths_of_a_metre_come_to_the_same_place() -> None:
    graph, truth = looped(1000, seed=2)
    optimize(graph)
    expected = graph.poses.copy()
    noise = np.random.default_rng(5).normal(size=(999, 3)) * (0.3, 0.3, 0.1)
    graph.poses[1:] = np.array(truth)[1:] + noise
    assert optimize(graph).converged
    off = graph.poses - expected
    assert np.abs(off[:, :2]).max() < 1e-3
    assert np.abs([wrap_angle(turn) for turn in off[:, 2]]).max() < 1e-3


def test_the_same_graph_gives_the_same_bits() -> None:
    one, _ = looped(300, seed=3, side=6)
    other, _ = looped(300, seed=3, side=6)
    optimize(one)
    optimize(other)
    assert one.poses.tobytes() == other.poses.tobytes()


@pytest.mark.parametrize(("count", "side", "most_s"), [(300, 6, 0.1), (3000, 30, 2.0)])
def test_a_house_and_a_large_building_are_fast(count: int, side: int, most_s: float) -> None:
    optimize(looped(30, seed=1, side=2)[0])
    graph, _ = looped(count, seed=1, side=side)
    start = time.process_time()
    optimize(graph)
    assert time.process_time() - start < most_s


def test_the_optimum_is_where_the_gradient_of_the_cost_is_zero() -> None:
    graph, _ = looped(300, seed=4, side=6)
    optimize(graph)

    def cost() -> float:
        robust = graph.edges.robust == CAUCHY
        each = chi2(graph)
        return float(each[~robust].sum() + (7.815 * np.log1p(each[robust] / 7.815)).sum())

    lowest = cost()
    random = np.random.default_rng(0)
    saved = graph.poses.copy()
    for _ in range(20):
        step = random.normal(size=(299, 3)) * 1e-4
        rises = []
        for sign in (1.0, -1.0):
            graph.poses[:] = saved
            graph.poses[1:] += sign * step
            rises.append(cost() - lowest)
        assert min(rises) > 0.0
        assert abs(rises[0] - rises[1]) < 0.02 * sum(rises)


def test_covariances_are_those_of_the_dense_equations() -> None:
    graph, _ = looped(60, seed=2, every=2, side=2)
    landmark = graph.add_landmark(graph.pose(20) @ SE2(1.0, 0.5, 3.0))
    for node in (19, 20, 21):
        relative = graph.pose(node).inverse() @ graph.landmark(landmark)
        graph.add_edge(MARKER, node, landmark, relative, LOOP_COVARIANCE, HUBER)
    optimize(graph)
    # Derivatives by differences, robust weights included.
    unknowns = 3 * (len(graph.poses) - 1 + 1)

    def whitened() -> np.ndarray:
        rows = []
        e = graph.edges
        for m in range(len(e.kind)):
            there = graph.landmark if e.kind[m] == MARKER else graph.pose
            rel = graph.pose(int(e.source[m])).inverse() @ there(int(e.target[m]))
            error = np.array(rel) - e.relative[m]
            error[2] = wrap_angle(error[2])
            rows.append(np.linalg.cholesky(e.information[m]).T @ error)
        return np.array(rows)

    distances = chi2(graph)
    assert (whitened() ** 2).sum(axis=1) == pytest.approx(distances, abs=1e-6)
    weight = np.ones(len(distances))
    robust = graph.edges.robust == CAUCHY
    weight[robust] = 1.0 / (1.0 + distances[robust] / 7.815)
    jacobian = np.empty((distances.size * 3, unknowns))
    for k in range(unknowns):
        row, axis = divmod(k, 3)
        array, row = (graph.poses, row + 1) if row < 59 else (graph.landmarks, 0)
        kept = array[row, axis]
        array[row, axis] = kept + 1e-6
        up = whitened()
        array[row, axis] = kept - 1e-6
        down = whitened()
        array[row, axis] = kept
        jacobian[:, k] = ((up - down) / 2e-6 * np.sqrt(weight)[:, None]).ravel()
    dense = np.linalg.inv(jacobian.T @ jacobian + 1e-6 * np.eye(unknowns))
    covariances = Covariances(graph)
    assert covariances.node(30) == pytest.approx(dense[87:90, 87:90], rel=1e-4)
    assert covariances.landmark(0) == pytest.approx(dense[177:180, 177:180], rel=1e-4)
    assert covariances.joint(30, 50)[:3, 3:] == pytest.approx(dense[87:90, 147:150], rel=1e-3)
    assert (covariances.node(0) == 0.0).all()


def test_the_relative_covariance_of_an_edge_is_its_own() -> None:
    graph = Graph()
    covariance = np.array([[0.04, 0.01, 0.001], [0.01, 0.02, -0.002], [0.001, -0.002, 0.01]])
    graph.add_node(SE2(0.0, 0.0, 0.5))
    for i in range(4):
        graph.add_node(graph.pose(i) @ SE2(1.0, 0.3, 0.7))
        graph.add_edge(ODOMETRY, i, i + 1, SE2(1.0, 0.3, 0.7), covariance)
    assert relative_covariance(graph, 2, 3) == pytest.approx(covariance, rel=1e-3)
    far = relative_covariance(graph, 0, 4)
    assert far[1, 1] > 3.0 * covariance[1, 1]
    landmark = graph.add_landmark(graph.pose(4) @ SE2(2.0, 0.0, math.pi))
    graph.add_edge(MARKER, 4, landmark, SE2(2.0, 0.0, math.pi), covariance)
    seen = relative_covariance(graph, 4, landmark, target_is_landmark=True)
    assert seen == pytest.approx(covariance, rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_of_loops_of_which_a_third_is_false_the_right_ones_remain(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = manhattan(1000, seed)
    graph = odometry_graph(truth, random)
    pairs = meetings(truth)[::4]
    tried = [(j, True, i, truth[i].inverse() @ truth[j]) for i, j in pairs]
    for _ in range(round(len(pairs) * 3 / 7)):
        i, j = pairs[int(random.integers(len(pairs)))]
        right = truth[i].inverse() @ truth[j]
        off = random.uniform(0.6, 2.0, 2) * random.choice([-1.0, 1.0], 2)
        turn_rad = random.uniform(-0.2, 0.2)
        tried.append((j, False, i, right @ SE2(float(off[0]), float(off[1]), float(turn_rad))))
    accepted = {True: 0, False: 0}
    for j, right_one, i, relative in sorted(tried, key=lambda one: one[:3]):
        measured = noisy(relative, LOOP_COVARIANCE, random)
        verdict = close_loop(graph, Candidate(i, j, measured, LOOP_COVARIANCE))
        accepted[right_one] += verdict.accepted
    assert accepted[False] == 0
    assert accepted[True] >= 0.95 * len(pairs)
    reference = odometry_graph(truth, np.random.default_rng(seed))
    assert errors_m(graph, truth).mean() < 0.4 * errors_m(reference, truth).mean()


def test_a_false_loop_leaves_the_graph_as_it_was() -> None:
    graph, truth = looped(300, seed=1, side=6)
    optimize(graph)
    before = contents(graph)
    i, j = meetings(truth)[1]
    wrong = truth[i].inverse() @ truth[j] @ SE2(1.0, 0.0, 0.0)
    verdict = close_loop(graph, Candidate(i, j, wrong, LOOP_COVARIANCE))
    assert not verdict.accepted
    assert verdict.innovation > CHI2_99
    assert "expected" in verdict.reason
    assert contents(graph) == before


def test_a_loop_within_the_gate_that_nothing_bends_to_is_taken_back() -> None:
    """The gate is linear: where a heading is quite unknown it lets through what cannot be."""
    graph = Graph()
    loose, tight = np.diag([1e-4, 1e-4, 2.0]), np.diag([1e-4, 1e-4, 1e-4])
    for x_m in (0.0, 5.0, 10.0):
        graph.add_node(SE2(x_m, 0.0, 0.0))
    graph.add_edge(ODOMETRY, 0, 1, SE2(5.0, 0.0, 0.0), loose)
    graph.add_edge(ODOMETRY, 1, 2, SE2(5.0, 0.0, 0.0), tight)
    before = contents(graph)
    # Node 2 cannot be more than 10 m from node 0.
    verdict = close_loop(graph, Candidate(0, 2, SE2(10.0, 12.0, 0.5), np.diag([0.01, 0.01, 1.0])))
    assert verdict.innovation < CHI2_99
    assert not verdict.accepted
    assert contents(graph) == before


def test_several_candidates_stand_and_fall_together() -> None:
    random = np.random.default_rng(1)
    truth = manhattan(300, 1, 6)
    graph = odometry_graph(truth, random)
    (a, b), (c, d) = meetings(truth)[0], meetings(truth)[1]
    right = Candidate(a, b, truth[a].inverse() @ truth[b], LOOP_COVARIANCE)
    wrong = Candidate(c, d, truth[c].inverse() @ truth[d] @ SE2(0.0, 3.0, 0.0), LOOP_COVARIANCE)
    edges = len(graph.edges.kind)
    assert not close_loop(graph, [right, wrong]).accepted
    assert len(graph.edges.kind) == edges
    also = Candidate(c, d, truth[c].inverse() @ truth[d], LOOP_COVARIANCE)
    assert close_loop(graph, [right, also]).edges == (edges, edges + 1)


def test_what_no_edge_holds_stays() -> None:
    graph = Graph()
    for x_m in (0.0, 1.0, 5.0, 6.5):
        graph.add_node(SE2(x_m, 0.0, 0.0))
    graph.add_edge(ODOMETRY, 0, 1, SE2(1.2, 0.0, 0.0), STEP_COVARIANCE)
    graph.add_edge(ODOMETRY, 2, 3, SE2(1.0, 0.0, 0.0), STEP_COVARIANCE)
    graph.add_landmark(SE2(7.0, 8.0, 1.0))
    assert optimize(graph).converged
    assert graph.poses[1] == pytest.approx([1.2, 0.0, 0.0], abs=1e-6)
    assert graph.poses[2:, 0] == pytest.approx([5.25, 6.25], abs=1e-2)
    assert graph.landmark(0) == SE2(7.0, 8.0, 1.0)


def test_a_graph_of_one_node_or_none_is_optimal() -> None:
    graph = Graph()
    assert optimize(graph).converged
    graph.add_node(SE2(1.0, 2.0, 3.0))
    assert optimize(graph).converged
    assert graph.pose(0) == SE2(1.0, 2.0, 3.0)
    assert (Covariances(graph).node(0) == 0.0).all()


def test_equations_are_solved_as_scipy_does() -> None:
    random = np.random.default_rng(0)
    count = 60
    pairs = np.array(
        sorted({tuple(sorted(random.choice(count, 2, replace=False).tolist())) for _ in range(150)})
    )
    structure = analyse(count, pairs)
    dense = np.zeros((count * 3, count * 3))
    for i, j in pairs.tolist():
        block = random.normal(size=(3, 3))
        dense[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
        dense[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = block.T
    dense += np.eye(count * 3) * np.abs(dense).sum(axis=0).max()
    diagonal, above = np.empty((count, 3, 3)), np.empty((len(structure.row), 3, 3))
    for i in range(count):
        diagonal[structure.position[i]] = dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
    for (i, j), slot in zip(pairs.tolist(), structure.slot.tolist(), strict=True):
        row, column = sorted((i, j), key=lambda one: structure.position[one])
        above[slot] = dense[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
    factor = factorize(structure, diagonal, above)
    assert factor is not None
    given = random.normal(size=(count, 3))
    expected = linalg.splu(sparse.csc_array(dense)).solve(given.ravel()).reshape(count, 3)
    assert factor.solve(given) == pytest.approx(expected, abs=1e-9)
    diagonal[7, 0, 0] = -1.0
    assert factorize(structure, diagonal, above) is None
