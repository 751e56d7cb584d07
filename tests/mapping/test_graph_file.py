import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.slam_documents import GraphLandmark, PoseGraph
from mazebot.mapping.graph.graph_file import (
    NodeScan,
    graph_document,
    graph_of,
    load_graph,
    metres,
    millimetres,
)
from mazebot.mapping.graph.landmarks import MarkerLandmarks, upright
from mazebot.mapping.graph.optimizer import Candidate, close_loop, optimize
from mazebot.mapping.graph.pose_graph import HUBER, MARKER, Graph
from tests.mapping.synthetic import (
    LOOP_COVARIANCE,
    manhattan,
    meetings,
    noisy,
    odometry_graph,
    scan,
)


def landmark(x_m: float, y_m: float, heading_rad: float, marker_id: int = 7) -> GraphLandmark:
    return GraphLandmark(
        dictionary="DICT_4X4_100",
        marker_id=marker_id,
        position_m=(x_m, y_m, 0.25),
        orientation_xyzw=upright(heading_rad),
        heading_rad=heading_rad,
        std_m=0.01,
        sightings=4,
    )


def state() -> tuple[Graph, list[NodeScan], list[GraphLandmark]]:
    random = np.random.default_rng(3)
    truth = manhattan(120, 3, 4)
    graph = odometry_graph(truth, random)
    for i, j in meetings(truth)[::5]:
        measured = noisy(truth[i].inverse() @ truth[j], LOOP_COVARIANCE, random)
        close_loop(graph, Candidate(i, j, measured, LOOP_COVARIANCE))
    graph.add_landmark(SE2(1.0, 2.0, 1.1))
    tilted = LOOP_COVARIANCE + 1e-5 * np.array([[0, 1, 2], [1, 0, 3], [2, 3, 0]])
    for node in (3, 4, 5):
        relative = graph.pose(node).inverse() @ graph.landmark(0)
        graph.add_edge(MARKER, node, 0, relative, tilted, HUBER)
    optimize(graph)
    scans = []
    for i in range(len(graph.poses)):
        points = millimetres(scan(SE2(1.5, 1.5, 0.1 * i), random))
        scans.append(NodeScan(i * 10**9 + 1, points, points[:3] * 2, SE2(-0.03, 0.0, 0.001)))
    heading_rad = graph.landmark(0).yaw_rad
    place = graph.landmarks[0, :2].tolist()
    return graph, scans, [landmark(place[0], place[1], heading_rad)]


@functools.cache
def document() -> PoseGraph:
    graph, scans, landmarks = state()
    return graph_document(
        graph, scans, landmarks, stamp_ns=5, map_from_odom=SE2(0.1, 0.2, 0.3), resolution_m=0.05,
        world_hash="abc", epoch=2, loops=3, loops_rejected=1,
    )  # fmt: skip


def test_a_graph_comes_back_from_its_file_bit_by_bit(tmp_path: Path) -> None:
    graph, scans, _ = state()
    saved = document()
    (tmp_path / "graph.json").write_text(saved.model_dump_json())
    loaded = load_graph(tmp_path / "graph.json")
    assert loaded == saved
    again = graph_of(loaded)
    assert again.graph.poses.tobytes() == graph.poses.tobytes()
    assert again.graph.landmarks.tobytes() == graph.landmarks.tobytes()
    for name in graph.edges._fields:
        now, was = getattr(again.graph.edges, name), getattr(graph.edges, name)
        assert now.tobytes() == was.tobytes(), name
    for before, after in zip(scans, again.scans, strict=True):
        assert (before.stamp_ns, before.sensor) == (after.stamp_ns, after.sensor)
        assert (before.points_mm == after.points_mm).all()
        assert (before.misses_mm == after.misses_mm).all()
    optimize(graph)
    optimize(again.graph)
    assert again.graph.poses.tobytes() == graph.poses.tobytes()


def test_residuals_are_those_of_the_poses() -> None:
    edges = document().edges
    assert max(edge.residual for edge in edges) < 15.0
    assert sum(edge.residual for edge in edges) > 1.0


def test_landmarks_go_on_from_a_file() -> None:
    loaded = graph_of(document())
    markers = MarkerLandmarks.restored(loaded.graph, loaded.landmarks)
    (one,) = markers.documents()
    assert one.position_m == loaded.landmarks[0].position_m
    assert one.heading_rad == loaded.landmarks[0].heading_rad


def test_an_empty_graph_comes_back() -> None:
    empty = graph_document(
        Graph(), [], [], stamp_ns=0, map_from_odom=SE2(0.0, 0.0, 0.0), resolution_m=0.05
    )
    assert len(graph_of(empty).graph.poses) == 0


def test_nodes_may_have_any_ids() -> None:
    content = document().model_dump()
    for node in content["nodes"]:
        node["id"] = 1000 - node["id"]
    for edge in content["edges"]:
        edge["source"] = 1000 - edge["source"]
        if edge["kind"] != "marker":
            edge["target"] = 1000 - edge["target"]
    again = graph_of(PoseGraph.model_validate(content)).graph
    assert again.edges.target.tolist() == state()[0].edges.target.tolist()


def test_points_are_whole_millimetres() -> None:
    points = np.array([[1.2344, -0.0016], [3.9999, 0.0]])
    assert millimetres(points).tolist() == [[1234, -2], [4000, 0]]
    assert metres(millimetres(points)) == pytest.approx(points, abs=0.0005)


def broken(path: tuple[str | int, ...], value: object) -> str:
    content: Any = document().model_dump(mode="json")
    inside = content
    for part in path[:-1]:
        inside = inside[part]
    inside[path[-1]] = value
    return json.dumps(content)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("nodes", 3, "pose", "x_m"), "far", "nodes[3].pose.x_m: 'far': must be a valid number"),
        (("nodes", 3, "id"), 2, "nodes[3].id: 2: must be the id of no other node"),
        (("nodes", 3, "id"), -1, "nodes[3].id: -1: must be greater than or equal to 0"),
        (("nodes", 0, "scan", "points_mm"), "?!", "nodes[0].scan.points_mm: '?!': must be base64"),
        (("nodes", 1, "scan", "misses_mm"), "AAAA", "nodes[1].scan.misses_mm: 'AAAA': must be p"),
        (("edges", 5, "source"), 999, "edges[5].source: 999: must be the id of a node"),
        (("edges", 5, "target"), 999, "edges[5].target: 999: must be the id of a node"),
        (("edges", -1, "target"), 1, ".target: 1: must be an index in `landmarks`"),
        (("edges", 5, "covariance"), [0.0] * 6, "edges[5].covariance: (0.0, 0.0, 0.0, 0.0, 0.0, 0"),
        (("edges", 5, "kind"), "guess", "edges[5].kind: 'guess': must be 'odometry',"),
        (("resolution_m",), 0.0, "resolution_m: 0.0: must be greater than 0"),
        (("colour",), 1, "colour: 1: "),
    ],
)
def test_a_damaged_file_is_told_in_one_line(
    tmp_path: Path, path: tuple[str | int, ...], value: object, said: str
) -> None:
    file = tmp_path / "graph.json"
    file.write_text(broken(path, value))
    with pytest.raises(ConfigError) as error:
        load_graph(file)
    assert str(error.value).startswith(f"{file}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("data", [b"", b"{", b'{"nodes": [', b"\xff\xfe", b"[1]", b"[" * 100_000])
def test_what_is_no_graph_is_told_in_one_line(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "graph.json"
    file.write_bytes(data)
    with pytest.raises(ConfigError, match="must be") as error:
        load_graph(file)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_graph(tmp_path / "none.json")
    with pytest.raises(ConfigError, match="must be a file"):
        load_graph(tmp_path)
