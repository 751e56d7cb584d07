"""Localisation as a node, in runs in which it has no map, or one that the robot has made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    Array,
    position_and_quaternion,
    quaternion_from_rotation,
    transform_matrix,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Entities, MappedMarker, World
from mazebot.common.messages.topics import (
    DETECTIONS,
    ENTITIES,
    MAP,
    ODOM,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SCAN,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.diagnostics import SelfReport
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.localization.config import LocalizationConfig
from mazebot.localization.node import LocalizationNode
from mazebot.navigation.control.collision import STOP
from tests.common.samples import SAMPLES
from tests.navigation.driving import IDENTITY, START, fixed_frames, odometry, scan
from tests.navigation.house_tour import BASE_FROM_SCAN, as_ranges, cast, house, wall_segments

STEP_NS = 50_000_000


class Bench:
    """A node on a robot that stands at the start."""

    def __init__(self, config: LocalizationConfig | None = None, **world: Any) -> None:
        self.node = LocalizationNode(config or LocalizationConfig())
        self.inbox = Inbox(self.node)
        self.said: list[str] = []
        self.outbox = Outbox(self.node, lambda topic, *_: self.said.append(topic.name))
        self._sequence = 0
        self.world: World = house().world.model_copy(update=world)

    def hear(self, topic: Topic[Any], message: Any) -> None:
        self._sequence += 1
        self.inbox.deliver(topic, message, Envelope("test", self._sequence, 0, ""))

    def run(self, steps: int = 20, camera_from_marker: Array | None = None) -> None:
        """Stand; with a marker 60 there, each second a picture with it."""
        loaded = house()
        self.hear(WORLD, self.world)
        self.hear(MAP, msg.occupancy_grid(0, 0.05, loaded.map_origin, loaded.map_cells))
        self.hear(ENTITIES, Entities(world_hash=loaded.world.hash, entities=MARKERS))
        self.hear(TF_STATIC, fixed_frames())
        rng = np.random.default_rng(1)
        for step in range(1, steps + 1):
            now_ns = step * STEP_NS
            self.hear(ODOM, odometry(now_ns, IDENTITY, STOP))
            exact_m = cast(START @ BASE_FROM_SCAN, wall_segments())
            self.hear(SCAN, scan(now_ns, as_ranges(exact_m, rng)))
            if camera_from_marker is not None and step % 20 == 0:
                self.hear(DETECTIONS, picture(now_ns, camera_from_marker))
            self.outbox.now_ns = now_ns
            self.node.step(now_ns, self.inbox, self.outbox)

    def see(self) -> None:
        """A picture with marker 60."""
        seen = SAMPLES[DETECTIONS].detections
        header = msg.header(20 * STEP_NS, "camera_rgb_optical_frame")
        self.hear(DETECTIONS, msg.Detection3DArray(header, seen))
        self.node.step(21 * STEP_NS, self.inbox, self.outbox)


def picture(now_ns: int, camera_from_marker: Array) -> msg.Detection3DArray:
    """Marker 60, seen sharply."""
    x, y, z = camera_from_marker[:3, 3].tolist()
    turn = msg.Quaternion(*quaternion_from_rotation(camera_from_marker[:3, :3]))
    pose = msg.Pose(msg.Point(x, y, z), turn)
    covariance = (np.diag([0.01, 0.01, 0.02, 0.1, 0.1, 0.1]) ** 2).reshape(36)
    found = msg.ObjectHypothesisWithPose(
        msg.ObjectHypothesis("60", 1.0), msg.PoseWithCovariance(pose, covariance)
    )
    header = msg.header(now_ns, "camera_rgb_optical_frame")
    box = msg.BoundingBox3D(pose, msg.Vector3(0.3, 0.3, 0.0))
    return msg.Detection3DArray(header, [msg.Detection3D(header, [found], box, "60")])


MARKERS = (SAMPLES[ENTITIES].entities[0],)


def test_where_the_robot_maps_localisation_says_nothing() -> None:
    bench = Bench(slam=True)
    bench.run()
    assert not bench.said
    assert bench.node.waiting_for() is None
    assert bench.node.facts() == {"state": "off: mapping localises the robot"}
    replies: list[act.Reply] = []
    bench.inbox.ask(REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty(), replies.append)
    bench.node.step(22 * STEP_NS, bench.inbox, bench.outbox)
    assert replies == [act.Reply(error="slam: mapping localises the robot of this run")]


def test_the_markers_of_a_map_take_the_place_of_those_that_hang() -> None:
    pose = msg.pose_from_se2(SE2(1.0, 0.0, 0.0), 0.3)
    known = MappedMarker(
        dictionary="DICT_4X4_100", marker_id=60,
        position_m=(pose.position.x, pose.position.y, pose.position.z),
        orientation_xyzw=(0.5, 0.5, 0.5, 0.5),
    )  # fmt: skip
    for mapped, unknown in ((None, 0), ((known,), 0), ((), 1)):
        bench = Bench(mapped_markers=mapped)
        bench.run()
        bench.see()
        rejected = bench.inbox.counts[DETECTIONS.name].rejected
        assert rejected["unknown marker"] == unknown, mapped


def test_of_two_markers_of_one_id_neither_is_used_whatever_their_dictionaries(
    caplog: pytest.LogCaptureFixture,
) -> None:
    one = MappedMarker(
        dictionary="DICT_4X4_100", marker_id=60, position_m=(1.0, 0.0, 0.3),
        orientation_xyzw=(0.5, 0.5, 0.5, 0.5),
    )  # fmt: skip
    other = one.model_copy(update={"dictionary": "DICT_APRILTAG_36h11", "position_m": (2, 0, 0)})
    bench = Bench(mapped_markers=(one, other))
    bench.run()
    bench.see()
    assert caplog.messages.count("marker 60 is in two places: ignored") == 1
    assert bench.inbox.counts[DETECTIONS.name].rejected["unknown marker"] == 1


def test_a_marker_that_is_mapped_elsewhere_than_it_hangs_is_one_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    # 1.2 m ahead of the camera, and facing it.
    camera_from_marker = transform_matrix(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 1.2))
    base_from_camera = transform_matrix(np.eye(3), (0.07, 0.0, 0.11)) @ LINK_FROM_OPTICAL
    hung = START.matrix() @ base_from_camera @ camera_from_marker
    (x, y, z), turn = position_and_quaternion(hung)
    mapped = MappedMarker(
        dictionary="DICT_4X4_100", marker_id=60, position_m=(x, y + 0.4, z), orientation_xyzw=turn
    )
    bench = Bench(mapped_markers=(mapped,))
    bench.run(160, camera_from_marker)
    (line,) = [line for line in caplog.messages if "marker" in line]
    assert line.startswith(
        "marker 60 is mapped at (1.27 0.40), facing 180 degrees but seen at (1.2"
    )


def test_settings_that_leave_nothing_of_the_scans_are_a_warning() -> None:
    for config, warning in (
        (LocalizationConfig(), ""),
        # Nearer than the nearest range of the sensor.
        (LocalizationConfig(laser_max_range=0.05), "no scan used for 5 s: 0 of 360 ranges lie"),
    ):
        bench = Bench(config)
        bench.run(steps=105)
        (status,) = SelfReport(bench.node, bench.inbox, bench.outbox).report(0).status
        assert status.message.startswith(warning or "active")
        assert status.level == 1 or not warning
