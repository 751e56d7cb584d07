"""Mapping as a node: what it says to what it hears."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import SimulationStats
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.messages.topics import (
    AMCL_POSE,
    DETECTIONS,
    LOCALIZATION_STATUS,
    MAP,
    ODOM,
    POSE_GRAPH,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.mapping.config import STEP_PERIOD_NS, MappingConfig
from mazebot.mapping.node import MappingNode
from mazebot.navigation.control.collision import STOP
from tests.common.samples import SAMPLES
from tests.navigation.driving import IDENTITY, START, fixed_frames, odometry, scan
from tests.navigation.house_tour import BASE_FROM_SCAN, as_ranges, cast, house, wall_segments

M = TypeVar("M")
SAID: tuple[Topic[Any], ...] = (TF, AMCL_POSE, LOCALIZATION_STATUS, MAP, POSE_GRAPH)
HASH = house().world.hash
SLAM_WORLD = house().world.model_copy(update={"slam": True, "explore": True})


class Bench:
    """A mapping node on a robot that drives through the house, by exact walls."""

    def __init__(self, begin_ns: int = 0, **config: Any) -> None:
        self.node = MappingNode(MappingConfig(**config))
        self.inbox = Inbox(self.node)
        self.outbox = Outbox(self.node, self._sent)
        self.said: list[tuple[str, Any]] = []
        self.now_ns = begin_ns
        self.map_from_base = START
        self.epoch = 0
        self.slip = 1.02
        self.odom_from_base = IDENTITY
        self._rng = np.random.default_rng(1)
        self._sequence = 0

    def _sent(self, topic: Topic[Any], message: Any, _: Envelope) -> None:
        self.said.append((topic.name, message))

    def hear(self, topic: Topic[M], message: M) -> None:
        envelope = Envelope("test", self._sequence, 0, HASH)
        self._sequence += 1
        self.inbox.deliver(topic, wire.encode(topic, message), envelope)

    def of(self, topic: Topic[M]) -> list[M]:
        return [message for name, message in self.said if name == topic.name]

    def learn(self, slam: bool = True) -> None:
        self.hear(WORLD, SLAM_WORLD if slam else house().world)
        self.hear(TF_STATIC, fixed_frames())
        self.tell_stats()

    def tell_stats(self) -> None:
        stats = SimulationStats(
            world_hash=HASH, sim_time_s=self.now_ns * 1e-9, iterations=0, step_size_s=1 / 240,
            renderer="none", state_hash="", epoch=self.epoch, seed=0,
        )  # fmt: skip
        self.hear(SIMULATION_STATS, stats)

    def step(self) -> None:
        self.outbox.now_ns = self.now_ns
        self.node.step(self.now_ns, self.inbox, self.outbox)

    def drive(self, seconds: float, speed_m_s: float = 0.4, turn_rad_s: float = 0.0) -> None:
        for _ in range(round(seconds * 1e9 / STEP_PERIOD_NS)):
            step_s = STEP_PERIOD_NS * 1e-9
            self.now_ns += STEP_PERIOD_NS
            way = SE2(speed_m_s * step_s, 0.0, turn_rad_s * step_s)
            self.map_from_base = self.map_from_base @ way
            self.odom_from_base = self.odom_from_base @ SE2(
                way.x_m * self.slip, 0.0, way.yaw_rad * self.slip
            )
            self.hear(ODOM, odometry(self.now_ns, self.odom_from_base, STOP))
            if self.now_ns % 100_000_000 == 0:
                exact_m = cast(self.map_from_base @ BASE_FROM_SCAN, wall_segments())
                self.hear(SCAN, scan(self.now_ns, as_ranges(exact_m, self._rng)))
            self.step()

    def error_m(self) -> float:
        pose = msg.se2_from_pose(self.of(AMCL_POSE)[-1].pose.pose)
        return pose.distance_m(self.map_from_base)

    def rejected(self, topic: Topic[Any]) -> Counter[str]:
        return self.inbox.counts[topic.name].rejected


def mapped(**config: Any) -> Bench:
    """After twelve seconds around in the first room."""
    bench = Bench(**config)
    bench.learn()
    bench.drive(1.0, 0.0)
    bench.drive(3.0, 0.0, -0.8)
    bench.drive(4.0, 0.35)
    bench.drive(4.0, 0.0, 0.8)
    return bench


@pytest.fixture(scope="module")
def made() -> Bench:
    return mapped()


def test_the_map_grows_and_the_pose_follows_the_truth_where_odometry_slips(made: Bench) -> None:
    maps = made.of(MAP)
    assert len(maps) >= 3
    known = [int((msg.cells_from_grid(one) >= 0).sum()) for one in maps]
    assert known[-1] > 1.05 * known[0]
    assert made.error_m() < 0.03
    drift_m = (START @ made.odom_from_base).distance_m(made.map_from_base)
    assert drift_m > 0.03
    assert all(one.header.frame_id == "map" for one in maps)


def test_each_topic_has_its_rate(made: Bench) -> None:
    assert len(made.of(TF)) == pytest.approx(240, abs=2)
    assert len(made.of(AMCL_POSE)) == pytest.approx(120, abs=2)
    assert len(made.of(LOCALIZATION_STATUS)) == pytest.approx(24, abs=3)
    stamps_ns = [msg.ns_from_time(one.header.stamp) for one in made.of(MAP)]
    assert min(np.diff(stamps_ns)) >= 900_000_000
    graphs = made.of(POSE_GRAPH)
    assert 2 <= len(graphs) <= 4
    assert graphs[0].stamp_ns < 500_000_000


def test_map_from_odom_and_odometry_make_the_estimate(made: Bench) -> None:
    transform = made.of(TF)[-1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "odom")
    matrix = msg.matrix_from_transform(transform.transform) @ made.odom_from_base.matrix()
    pose = msg.matrix_from_pose(made.of(AMCL_POSE)[-1].pose.pose)
    assert np.abs(matrix - pose).max() < 0.06


def test_everything_said_survives_the_wire(made: Bench) -> None:
    for topic in SAID:
        message = made.of(topic)[-1]
        data = wire.encode(topic, message)
        wire.validate(topic, wire.decode(topic, data))
        assert wire.encode(topic, wire.decode(topic, data)) == data


def test_the_status_is_localized_from_the_first_scan_on(made: Bench) -> None:
    states = [one.state for one in made.of(LOCALIZATION_STATUS)]
    assert states[0] == "uninitialized"
    assert set(states[2:]) == {"localized"}
    facts = made.node.facts()
    assert facts["state"] == "localized"
    assert int(facts["keyframes"]) >= 1
    assert {"quality", "loops", "loops rejected", "markers"} <= set(facts)
    assert made.node.waiting_for() is None


def test_the_same_input_makes_the_same_bytes(made: Bench) -> None:
    again = mapped()
    for topic in SAID:
        ours, theirs = made.of(topic), again.of(topic)
        assert [wire.encode(topic, one) for one in ours] == [
            wire.encode(topic, one) for one in theirs
        ]


def test_where_the_robot_has_a_map_nothing_is_said() -> None:
    bench = Bench()
    bench.learn(slam=False)
    bench.drive(1.0)
    assert not bench.said
    assert bench.node.waiting_for() is None
    assert bench.node.facts() == {"state": "off: the robot has a map"}


def test_it_says_what_it_waits_for_in_the_order_it_comes() -> None:
    bench = Bench()
    said = [bench.node.waiting_for()]
    bench.hear(WORLD, SLAM_WORLD)
    bench.step()
    said.append(bench.node.waiting_for())
    bench.learn()
    bench.step()
    said.append(bench.node.waiting_for())
    bench.drive(0.05)
    said.append(bench.node.waiting_for())
    bench.drive(0.2)
    said.append(bench.node.waiting_for())
    assert said == ["the world", "static transforms on /tf_static", "odometry", "a scan", None]


def killed(made: Bench, graph: PoseGraph | None, **changed: Any) -> Bench:
    """A new process, while the robot drives on; what comes back of the old one is the graph."""
    bench = Bench(begin_ns=made.now_ns)
    bench.map_from_base, bench.odom_from_base = made.map_from_base, made.odom_from_base
    bench.epoch = changed.get("epoch", 0)
    bench.learn()
    if graph is not None:
        bench.hear(POSE_GRAPH, graph)
    return bench


def test_a_process_that_was_killed_goes_on_with_its_last_graph(made: Bench) -> None:
    graph = made.of(POSE_GRAPH)[-1]
    bench = killed(made, graph)
    bench.drive(0.3, 0.0)
    assert bench.error_m() < 0.05
    before, after = made.of(MAP)[-1], bench.of(MAP)[-1]
    assert len(after.data) > 0.9 * len(before.data)
    assert len(bench.of(POSE_GRAPH)[0].nodes) >= len(graph.nodes)
    bench.drive(2.0, 0.2)
    assert bench.error_m() < 0.05


def test_it_waits_for_that_graph_for_a_while_and_then_begins_where_odometry_says(
    made: Bench,
) -> None:
    bench = killed(made, None)
    bench.drive(1.0, 0.0)
    assert bench.node.waiting_for() == "its previous pose graph on /pose_graph"
    assert not bench.of(TF)
    bench.drive(2.5, 0.0)
    assert bench.of(TF)
    assert len(bench.of(POSE_GRAPH)[-1].nodes) == 1


def test_a_graph_of_an_earlier_run_is_not_gone_on_with(made: Bench) -> None:
    graph = made.of(POSE_GRAPH)[-1]
    bench = killed(made, graph, epoch=3)
    bench.drive(4.0, 0.0)
    assert len(bench.of(POSE_GRAPH)[-1].nodes) == 1
    assert bench.of(POSE_GRAPH)[-1].epoch == 3


def test_a_returned_graph_that_contradicts_itself_is_left(made: Bench) -> None:
    graph = made.of(POSE_GRAPH)[-1]
    edge = graph.edges[0].model_copy(update={"target": 99_999})
    bench = killed(made, graph.model_copy(update={"edges": (edge,)}))
    bench.drive(4.0, 0.0)
    assert len(bench.of(POSE_GRAPH)[-1].nodes) == 1


def test_a_reset_begins_the_map_anew() -> None:
    bench = Bench()
    bench.learn()
    bench.drive(3.0, 0.15)
    bench.now_ns, bench.epoch = 0, 1
    bench.map_from_base, bench.odom_from_base = START, IDENTITY
    bench.tell_stats()
    bench.said.clear()
    bench.drive(1.0, 0.0)
    assert bench.of(POSE_GRAPH)[-1].epoch == 1
    assert len(bench.of(POSE_GRAPH)[-1].nodes) == 1
    assert bench.error_m() < 0.01
    assert len(bench.of(MAP)) == 1


def test_a_saved_graph_is_gone_on_with_or_only_localised_in(made: Bench, tmp_path: Path) -> None:
    path = tmp_path / "house.pose_graph.json"
    graph = made.of(POSE_GRAPH)[-1]
    path.write_text(graph.model_dump_json())
    nodes = {}
    for mode in ("mapping", "localization"):
        bench = Bench(map_file_name=path, mode=mode)
        bench.learn()
        bench.drive(1.0, 0.0)
        assert len(bench.of(MAP)[0].data) > 0.9 * len(made.of(MAP)[-1].data)
        bench.drive(2.0, 0.0, -1.2)
        for _ in range(3):
            bench.drive(2.0, 0.35)
            bench.drive(1.0, 0.0, -1.2)
        assert bench.error_m() < 0.06
        nodes[mode] = len(bench.of(POSE_GRAPH)[-1].nodes)
    assert nodes["localization"] == len(graph.nodes) < nodes["mapping"]


def test_the_robot_may_begin_elsewhere_in_a_saved_map(made: Bench, tmp_path: Path) -> None:
    path = tmp_path / "house.pose_graph.json"
    path.write_text(made.of(POSE_GRAPH)[-1].model_dump_json())
    start = made.map_from_base
    bench = Bench(map_file_name=path, map_start_pose=tuple(start))
    bench.map_from_base = start
    bench.learn()
    bench.drive(1.0, 0.0)
    assert bench.error_m() < 0.05


def test_what_cannot_be_loaded_ends_the_service_with_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="map_file_name"):
        MappingNode(MappingConfig(mode="localization"))
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    for path in (tmp_path / "none.json", broken, tmp_path):
        with pytest.raises(ConfigError, match=path.name) as raised:
            MappingNode(MappingConfig(map_file_name=path))
        assert "\n" not in str(raised.value)


def test_bad_measurements_are_counted_and_the_map_goes_on() -> None:
    bench = Bench()
    bench.learn()
    bench.drive(0.5)
    later = scan(99_000_000_000, np.ones(360, np.float32))
    bench.hear(SCAN, later)
    detections = SAMPLES[DETECTIONS]
    nameless = msg.Detection3D(detections.header, detections.detections[0].results,
                               detections.detections[0].bbox, "60")  # fmt: skip
    bench.hear(
        DETECTIONS,
        msg.Detection3DArray(msg.header(bench.now_ns, "camera_rgb_optical_frame"), [nameless]),
    )
    bench.drive(0.5)
    assert bench.rejected(SCAN) == {"stamp in the future": 1}
    assert bench.rejected(DETECTIONS) == {"unknown marker": 1}
    assert bench.error_m() < 0.03


def test_where_only_time_begins_anew_the_new_map_is_made_from_where_the_robot_is() -> None:
    bench = Bench()
    bench.slip = 1.3
    bench.learn()
    bench.drive(3.0, 0.15)
    drifted_m = (START @ bench.odom_from_base).distance_m(bench.map_from_base)
    assert drifted_m > 0.08
    bench.now_ns, bench.epoch = 0, 1
    bench.tell_stats()
    bench.said.clear()
    bench.drive(1.0, 0.0)
    assert bench.of(POSE_GRAPH)[-1].epoch == 1
    assert len(bench.of(POSE_GRAPH)[-1].nodes) == 1
    assert bench.error_m() < 0.02
