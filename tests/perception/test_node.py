"""Perception as a node: what it says to what it hears."""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.files import png
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    BASE_LINK_FRAME,
    CAMERA_FRAME,
    CAMERA_OPTICAL_FRAME,
    LINK_FROM_OPTICAL,
    MAP_FRAME,
    ODOM_FRAME,
    SE2,
    Array,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import PhotoRequest
from mazebot.common.messages.documents import Entities, MarkerEntity, Planar, World
from mazebot.common.messages.scan import Mount, Scan
from mazebot.common.messages.topics import (
    CAMERA_IMAGE,
    CAMERA_INFO,
    DEPTH_IMAGE,
    DEPTH_INFO,
    DEPTH_SCAN,
    DETECTIONS,
    ENTITIES,
    MAP_DETECTIONS,
    PHOTO,
    PHOTO_REQUEST,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope, Inbox, Outbox, Trigger
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.node import PerceptionNode
from tests.common.samples import SAMPLES
from tests.perception.scene import (
    CAMERA,
    HEIGHT,
    MARKER_ID,
    MARKER_SIDE_M,
    WIDTH,
    camera_from_marker,
    render,
)

PERIOD_NS = 100_000_000
CAMERA_HEIGHT_M = 0.2
BASE_FROM_CAMERA = transform_matrix(np.eye(3), (0.07, 0.0, CAMERA_HEIGHT_M)) @ LINK_FROM_OPTICAL


def world(hash_: str = "first") -> World:
    start = Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    return World(name="hall", recipe="hall.yaml", hash=hash_, walls=(), materials=(), start=start)


def marker(
    marker_id: int = MARKER_ID,
    dictionary: str = "DICT_4X4_100",
    size_m: float = MARKER_SIDE_M,
    height_m: float = CAMERA_HEIGHT_M,
    upright: bool = True,
) -> MarkerEntity:
    return MarkerEntity(
        name=f"aruco_{marker_id}",
        position_m=(0.0, 0.0, height_m),
        # On a wall, its face along x; else on the floor, its face up.
        orientation_xyzw=(0.5, 0.5, 0.5, 0.5) if upright else (0.0, 0.0, 0.0, 1.0),
        panel_side_m=size_m * 8 / 6,
        texture_sha256="",
        marker_id=marker_id,
        marker_size_m=size_m,
        dictionary=dictionary,
    )


@functools.cache
def picture_of(distance_m: float, turn_rad: float, bearing_rad: float) -> NDArray[np.uint8]:
    return render(camera_from_marker(distance_m, turn_rad, 0.0, bearing_rad), "bricks")


NEAR = (2.0, math.radians(30), 0.1)
POSE = camera_from_marker(NEAR[0], NEAR[1], 0.0, NEAR[2])
FAR = (5.0, math.radians(8), 0.0)
NOTHING = None


def image(stamp_ns: int, place: tuple[float, float, float] | None = NEAR) -> msg.Image:
    rgb = np.full((HEIGHT, WIDTH, 3), 128, np.uint8) if place is NOTHING else picture_of(*place)
    data = rgb.reshape(-1)
    # As a message that has come over the wire.
    data.setflags(write=False)
    header = msg.header(stamp_ns, CAMERA_OPTICAL_FRAME)
    return msg.Image(header, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, data)


def camera_info(stamp_ns: int, **changed: Any) -> msg.CameraInfo:
    fields: dict[str, Any] = {
        "header": msg.header(stamp_ns, CAMERA_OPTICAL_FRAME),
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": CAMERA.reshape(9),
        "r": np.eye(3).reshape(9),
        "p": np.zeros(12),
        "binning_x": 0,
        "binning_y": 0,
        "roi": msg.RegionOfInterest(0, 0, 0, 0, False),
    }
    return msg.CameraInfo(**{**fields, **changed})


def tf(stamp_ns: int, parent: str, child: str, parent_from_child: Array) -> msg.TFMessage:
    return msg.TFMessage([msg.transform_stamped(stamp_ns, parent, child, parent_from_child)])


class Bench:
    """A perception node between its boxes."""

    def __init__(self, **config: Any) -> None:
        self.node = PerceptionNode(PerceptionConfig(seed=7, **config))
        self.inbox = Inbox(self.node)
        self.outbox = Outbox(self.node, self._sent)
        self.said: list[tuple[str, Any]] = []
        self._sequence = 0

    def _sent(self, topic: Topic[Any], message: Any, _: Envelope) -> None:
        self.said.append((topic.name, message))

    def hear(self, topic: Topic[Any], message: Any, world_hash: str = "first") -> None:
        envelope = Envelope("test", self._sequence, 0, world_hash)
        self._sequence += 1
        self.inbox.deliver(topic, wire.encode(topic, message), envelope)

    def step(self, now_ns: int = 0) -> list[msg.Detection3DArray]:
        """What is said on DETECTIONS in one step."""
        self.said.clear()
        self.node.step(now_ns, self.inbox, self.outbox)
        return [message for name, message in self.said if name == DETECTIONS.name]

    def in_map(self) -> list[msg.Detection3DArray]:
        return [message for name, message in self.said if name == MAP_DETECTIONS.name]

    def look(self, picture: msg.Image, **changed: Any) -> list[msg.Detection3DArray]:
        stamp_ns = msg.ns_from_time(picture.header.stamp)
        self.hear(CAMERA_INFO, camera_info(stamp_ns, **changed))
        self.hear(CAMERA_IMAGE, picture)
        return self.looked(stamp_ns)

    def looked(self, now_ns: int) -> list[msg.Detection3DArray]:
        """What is said on DETECTIONS of the pictures heard: in the next step."""
        self.step(now_ns)
        self.node.step(now_ns + 1, self.inbox, self.outbox)
        return [message for name, message in self.said if name == DETECTIONS.name]

    def place(
        self,
        stamp_ns: int,
        odom_from_base: SE2,
        map_from_odom: SE2,
        base_from_camera: Array = BASE_FROM_CAMERA,
    ) -> None:
        """The robot's frames, as physics and navigation say them."""
        lift = transform_matrix(np.eye(3), (0.0, 0.0, 0.01))
        camera = np.linalg.inv(lift) @ base_from_camera
        self.hear(TF_STATIC, tf(0, BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME, lift))
        self.hear(TF_STATIC, tf(0, BASE_LINK_FRAME, CAMERA_OPTICAL_FRAME, camera))
        self.hear(TF, tf(stamp_ns, ODOM_FRAME, BASE_FOOTPRINT_FRAME, odom_from_base.matrix()))
        self.hear(TF, tf(stamp_ns, MAP_FRAME, ODOM_FRAME, map_from_odom.matrix()))

    def rejected(self, topic: Topic[Any]) -> dict[str, int]:
        return dict(self.inbox.counts[topic.name].rejected)


def bench(entities: Iterable[MarkerEntity] | None = None, **config: Any) -> Bench:
    made = Bench(**config)
    made.hear(WORLD, world())
    known = (marker(),) if entities is None else tuple(entities)
    made.hear(ENTITIES, Entities(world_hash="first", entities=known))
    return made


def test_a_registered_marker_is_published_in_the_frame_of_its_picture() -> None:
    (array,) = bench().look(image(PERIOD_NS))
    assert array.header == msg.header(PERIOD_NS, CAMERA_OPTICAL_FRAME)
    (detection,) = array.detections
    assert detection.header == array.header
    assert detection.id == "DICT_4X4_100:60"
    size = detection.bbox.size
    assert (size.x, size.y, size.z) == (MARKER_SIDE_M, MARKER_SIDE_M, 0.0)
    best = detection.results[0]
    assert best.hypothesis.class_id == "60"
    assert best.hypothesis.score > 0.9
    assert detection.bbox.center == best.pose.pose
    assert np.abs(msg.matrix_from_pose(best.pose.pose) - POSE).max() < 0.01
    covariance = best.pose.covariance.reshape(6, 6)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_picture_that_is_wanted_is_published_once_and_is_not_older_than_the_request() -> None:
    made = bench()
    made.hear(PHOTO_REQUEST, PhotoRequest(waypoint=2, stamp_ns=PERIOD_NS + 1))
    taken = []
    for count in (1, 2, 3):
        made.look(image(count * PERIOD_NS))
        taken += [message for name, message in made.said if name == PHOTO.name]
    (photo,) = taken
    assert photo.header == msg.header(2 * PERIOD_NS, CAMERA_OPTICAL_FRAME)
    assert (png.decode(photo.data.tobytes()) == picture_of(*NEAR)).all()


def test_both_poses_of_an_ambiguous_marker_are_published_best_first() -> None:
    (array,) = bench(corner_sigma_px=0.5).look(image(0, FAR))
    scores = [result.hypothesis.score for result in array.detections[0].results]
    assert len(scores) == 2
    assert scores[0] >= scores[1] > 0.0
    assert sum(scores) == pytest.approx(1.0)


def test_the_size_is_that_of_the_entity() -> None:
    (array,) = bench([marker(size_m=0.6)]).look(image(0))
    assert array.detections[0].bbox.center.position.z == pytest.approx(2.0 * POSE[2, 3], abs=0.02)


def test_a_picture_of_nothing_is_an_empty_array() -> None:
    (array,) = bench().look(image(PERIOD_NS, NOTHING))
    assert array.detections == []
    assert array.header == msg.header(PERIOD_NS, CAMERA_OPTICAL_FRAME)


def test_a_world_without_markers_has_empty_arrays() -> None:
    empty = bench([])
    (array,) = empty.look(image(0))
    assert array.detections == []
    assert empty.node.waiting_for() is None


def test_a_marker_that_is_not_registered_is_said_once_and_not_published(
    caplog: pytest.LogCaptureFixture,
) -> None:
    other = bench([marker(80)])
    with caplog.at_level(logging.INFO, logger="perception"):
        for tick in range(3):
            (array,) = other.look(image(tick * PERIOD_NS))
            assert array.detections == []
    assert [record.getMessage() for record in caplog.records] == [
        "Ignoring marker DICT_4X4_100:60, which is not registered"
    ]


def test_unknown_markers_are_counted_in_diagnostics() -> None:
    other = bench([marker(80)])
    for tick in range(3):
        other.look(image(tick * PERIOD_NS))
    assert other.node.facts() == {"unknown marker DICT_4X4_100:60": "3"}
    known = bench()
    known.look(image(0))
    assert known.node.facts() == {}


@pytest.mark.parametrize(
    ("entity", "used"),
    [
        (marker(), True),
        (marker(height_m=CAMERA_HEIGHT_M + 0.05), True),
        (marker(height_m=CAMERA_HEIGHT_M + 0.6), False),
        (marker(upright=False), False),
    ],
    ids=["in its place", "a little high", "too high", "on the floor"],
)
def test_a_marker_at_another_height_or_tilt_is_reported_and_not_used(
    entity: MarkerEntity, used: bool
) -> None:
    seeing = bench([entity])
    seeing.place(0, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    (array,) = seeing.look(image(0))
    assert len(array.detections) == used
    counted = {} if used else {"misplaced marker DICT_4X4_100:60": "1"}
    assert seeing.node.facts() == counted


def test_without_the_cameras_frame_heights_are_not_checked() -> None:
    (array,) = bench([marker(height_m=2.0)]).look(image(0))
    assert len(array.detections) == 1


def test_a_new_world_counts_anew() -> None:
    other = bench([marker(80)])
    other.look(image(0))
    other.hear(WORLD, world("second"), "second")
    other.step()
    assert other.node.facts() == {}


def test_each_dictionary_has_its_own_ids() -> None:
    """The pattern of 4X4_100's 60 is none of 5X5's."""
    both = bench([marker(), marker(dictionary="DICT_5X5_100")])
    (array,) = both.look(image(0))
    assert [detection.id for detection in array.detections] == ["DICT_4X4_100:60"]


def test_an_unknown_dictionary_is_rejected_and_the_rest_goes_on() -> None:
    some = bench([marker(7, dictionary="DICT_9X9"), marker()])
    (array,) = some.look(image(0))
    assert len(array.detections) == 1
    assert some.rejected(ENTITIES) == {"unknown dictionary": 1}


def test_entities_of_another_world_are_not_looked_for() -> None:
    stale = Bench()
    stale.hear(WORLD, world())
    stale.hear(ENTITIES, Entities(world_hash="other", entities=(marker(),)))
    (array,) = stale.look(image(0))
    assert array.detections == []
    assert stale.node.waiting_for() == "the entities of the world"


def test_entities_that_came_before_their_world_count_from_then_on() -> None:
    early = Bench()
    early.hear(ENTITIES, Entities(world_hash="first", entities=(marker(),)))
    early.step()
    early.hear(WORLD, world())
    (array,) = early.look(image(0))
    assert len(array.detections) == 1


def test_a_new_world_begins_anew() -> None:
    moved = bench()
    moved.place(0, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    moved.look(image(0))
    assert moved.in_map()
    moved.hear(WORLD, world("second"), "second")
    moved.step()
    assert moved.node.world_hash == "second"
    assert moved.node.waiting_for() == "the entities of the world"
    map_from_odom = tf(PERIOD_NS, MAP_FRAME, ODOM_FRAME, np.eye(4))
    moved.hear(TF, map_from_odom, "second")
    moved.hear(CAMERA_INFO, camera_info(PERIOD_NS), "second")
    moved.hear(CAMERA_IMAGE, image(PERIOD_NS), "second")
    (array,) = moved.looked(PERIOD_NS)
    assert array.detections == []
    # Odometry of the world before says nothing.
    assert moved.in_map() == []


def test_intrinsics_are_those_of_the_pictures_stamp() -> None:
    late = bench()
    late.hear(CAMERA_INFO, camera_info(0))
    late.hear(CAMERA_IMAGE, image(PERIOD_NS))
    assert late.step(PERIOD_NS) == []
    assert late.node.waiting_for() == "the camera's intrinsics"
    half = CAMERA.copy()
    half[0, 0] = half[1, 1] = CAMERA[0, 0] / 2
    late.hear(CAMERA_INFO, camera_info(PERIOD_NS, k=half.reshape(9)))
    (array,) = late.looked(PERIOD_NS)
    assert array.header.stamp == msg.time_from_ns(PERIOD_NS)
    assert array.detections[0].bbox.center.position.z == pytest.approx(POSE[2, 3] / 2, abs=0.05)


def test_a_picture_whose_intrinsics_never_come_is_rejected() -> None:
    blind = bench()
    blind.hear(CAMERA_IMAGE, image(0))
    assert blind.step() == []
    (array,) = blind.look(image(PERIOD_NS))
    assert array.header.stamp == msg.time_from_ns(PERIOD_NS)
    assert blind.rejected(CAMERA_IMAGE) == {"no camera_info with its stamp": 1}


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"encoding": "bgr8"}, "encoding is not rgb8"),
        ({"step": WIDTH}, "step smaller than the width"),
        ({"width": WIDTH // 2}, "size is not that of camera_info"),
        ({"height": HEIGHT // 2}, "size is not that of camera_info"),
    ],
)
def test_a_picture_that_is_none_is_rejected_with_a_reason(
    changed: dict[str, Any], reason: str
) -> None:
    picture = image(0)
    for name, value in changed.items():
        setattr(picture, name, value)
    picture.data = picture.data[: picture.height * picture.step]
    damaged = bench()
    assert damaged.look(picture) == []
    assert damaged.rejected(CAMERA_IMAGE) == {reason: 1}
    # The next one is none the worse for it.
    assert len(damaged.look(image(PERIOD_NS))) == 1


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"k": np.zeros(9)}, "intrinsics not of a pinhole camera"),
        ({"d": np.zeros(3)}, "unknown number of distortion coefficients"),
        ({"k": np.full(9, np.nan)}, "not finite"),
    ],
)
def test_intrinsics_of_no_camera_are_rejected(changed: dict[str, Any], reason: str) -> None:
    odd = bench()
    assert odd.look(image(0), **changed) == []
    assert odd.rejected(CAMERA_INFO) == {reason: 1}


def test_no_distortion_may_be_said_with_no_coefficients() -> None:
    (array,) = bench().look(image(0), d=np.zeros(0))
    assert len(array.detections) == 1


def test_the_same_markers_are_published_in_the_map_by_the_estimated_pose() -> None:
    placed = bench()
    odom_from_base, map_from_odom = SE2(1.0, 0.5, 0.7), SE2(-2.0, 3.0, -1.2)
    placed.place(PERIOD_NS, odom_from_base, map_from_odom)
    (array,) = placed.look(image(PERIOD_NS))
    (in_map,) = placed.in_map()
    assert in_map.header == msg.header(PERIOD_NS, MAP_FRAME)
    map_from_camera = (map_from_odom @ odom_from_base).matrix() @ BASE_FROM_CAMERA
    here, there = (a.detections[0].results[0].pose for a in (array, in_map))
    expected = map_from_camera @ msg.matrix_from_pose(here.pose)
    assert np.abs(msg.matrix_from_pose(there.pose) - expected).max() < 1e-9
    rotation = np.kron(np.eye(2), map_from_camera[:3, :3])
    turned = rotation @ here.covariance.reshape(6, 6) @ rotation.T
    assert np.abs(there.covariance.reshape(6, 6) - turned).max() < 1e-12


def test_the_map_pose_is_that_of_the_pictures_stamp() -> None:
    """Halfway between two odometry messages, and not at the newer one."""
    driving = bench()
    for tick, x_m in enumerate((0.0, 1.0)):
        driving.place(tick * PERIOD_NS, SE2(x_m, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    (array,) = driving.look(image(PERIOD_NS // 2))
    (in_map,) = driving.in_map()
    forward_m = array.detections[0].bbox.center.position.z
    x_m = in_map.detections[0].bbox.center.position.x
    assert x_m == pytest.approx(0.5 + 0.07 + forward_m, abs=1e-6)


def test_time_going_back_forgets_where_the_robot_was() -> None:
    driven = bench()
    driven.place(5 * PERIOD_NS, SE2(1.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    assert len(driven.look(image(5 * PERIOD_NS))) == 1
    # On its way when the simulation began anew.
    late = tf(6 * PERIOD_NS, ODOM_FRAME, BASE_FOOTPRINT_FRAME, SE2(1.1, 0.0, 0.0).matrix())
    driven.hear(TF, late)
    driven.place(PERIOD_NS, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    (array,) = driven.look(image(PERIOD_NS))
    (in_map,) = driven.in_map()
    forward_m = array.detections[0].bbox.center.position.z
    x_m = in_map.detections[0].bbox.center.position.x
    assert x_m == pytest.approx(0.07 + forward_m, abs=1e-6)
    assert driven.rejected(TF) == {"stamp in the future": 1}
    assert driven.node.waiting_for() is None


def test_no_map_detections_without_odometry_of_that_time() -> None:
    lost = bench(transform_tolerance_s=0.1)
    assert len(lost.look(image(0))) == 1
    assert lost.in_map() == []
    lost.place(0, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    assert len(lost.look(image(PERIOD_NS))) == 1
    assert len(lost.in_map()) == 1
    assert len(lost.look(image(2 * PERIOD_NS))) == 1
    assert lost.in_map() == []


def test_it_says_what_it_waits_for() -> None:
    starting = Bench()
    starting.step()
    assert starting.node.waiting_for() == "the world"
    starting.hear(WORLD, world())
    starting.step()
    assert starting.node.waiting_for() == "the entities of the world"
    starting.hear(ENTITIES, Entities(world_hash="first"))
    starting.step()
    assert starting.node.waiting_for() == "an image"
    for renderer, waits_for in (("none", None), ("cpu", "an image")):
        stats = SAMPLES[SIMULATION_STATS].model_copy(update={"renderer": renderer})
        starting.hear(SIMULATION_STATS, stats)
        starting.step()
        assert starting.node.waiting_for() == waits_for
    starting.look(image(0, NOTHING))
    assert starting.node.waiting_for() is None


def test_a_picture_wakes_it_and_what_it_shows_is_said_within_a_period() -> None:
    asleep = bench()
    trigger = Trigger(asleep.node)
    assert trigger.due(0, asleep.inbox)
    assert not trigger.due(1, asleep.inbox)
    asleep.hear(CAMERA_INFO, camera_info(1))
    asleep.hear(CAMERA_IMAGE, image(1, NOTHING))
    assert trigger.due(1, asleep.inbox)
    assert asleep.step(1) == []
    assert not trigger.due(2, asleep.inbox)
    assert trigger.due(PERIOD_NS, asleep.inbox)
    (array,) = asleep.step(PERIOD_NS)
    assert array.header.stamp == msg.time_from_ns(1)


def test_pictures_that_wait_are_all_searched() -> None:
    late = bench()
    for number in range(3):
        late.hear(CAMERA_INFO, camera_info(number))
        late.hear(CAMERA_IMAGE, image(number))
    arrays = late.looked(3)
    assert [array.header.stamp.nanosec for array in arrays] == [0, 1, 2]
    assert [len(array.detections) for array in arrays] == [1, 1, 1]


def test_markers_that_change_while_a_picture_is_searched_are_those_of_the_next() -> None:
    changed = bench()
    changed.hear(CAMERA_INFO, camera_info(0))
    changed.hear(CAMERA_IMAGE, image(0))
    assert changed.step(0) == []
    changed.hear(ENTITIES, Entities(world_hash="first", entities=()))
    (before,) = changed.step(1)
    (after,) = changed.look(image(2))
    assert (len(before.detections), len(after.detections)) == (1, 0)


def test_over_the_wire_and_in_one_process_are_the_same_bytes() -> None:
    direct, wired = bench(), bench()
    (said,) = direct.look(image(0))
    picture = wire.decode(CAMERA_IMAGE, wire.encode(CAMERA_IMAGE, image(0)))
    (heard,) = wired.look(picture)
    assert wire.encode(DETECTIONS, said) == wire.encode(DETECTIONS, heard)


def test_what_a_person_may_configure_wrongly_is_named() -> None:
    with pytest.raises(ValueError, match=r"threshold_window_px\n.*must be odd"):
        PerceptionConfig(seed=7, threshold_window_px=12)
    with pytest.raises(ValueError, match="max_range_m"):
        PerceptionConfig(seed=7, max_range_m=0.0)


def test_where_a_map_is_made_every_id_of_the_dictionary_counts_at_any_height() -> None:
    other = marker(3, size_m=MARKER_SIDE_M, height_m=1.5)
    made = Bench()
    made.hear(WORLD, world().model_copy(update={"slam": True}))
    made.hear(ENTITIES, Entities(world_hash="first", entities=(other, marker(4, size_m=0.1))))
    made.hear(
        ENTITIES, Entities(world_hash="first", entities=(other, marker(4, size_m=0.1), other))
    )
    made.place(0, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0))
    (array,) = made.look(image(PERIOD_NS))
    (detection,) = array.detections
    assert detection.id == f"DICT_4X4_100:{MARKER_ID}"
    assert detection.bbox.size.x == MARKER_SIDE_M
    assert not made.node.facts()
    known = bench([other])
    assert not known.look(image(PERIOD_NS))[0].detections


def depth_image(stamp_ns: int, encoding: str = "32FC1") -> msg.Image:
    """A wall across the view, 1 m ahead."""
    kind, unit_m = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 0.001)}.get(
        encoding, (np.uint8, 1.0)
    )
    data = np.full(HEIGHT * WIDTH, round(1.0 / unit_m), kind).view(np.uint8)
    step = len(data) // HEIGHT
    header = msg.header(stamp_ns, CAMERA_OPTICAL_FRAME)
    return msg.Image(header, HEIGHT, WIDTH, encoding, 0, step, data)


def depth_bench(base_from_camera: Array = BASE_FROM_CAMERA) -> Bench:
    made = bench()
    made.place(0, SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 0.0), base_from_camera)
    link = base_from_camera @ np.linalg.inv(LINK_FROM_OPTICAL)
    made.hear(TF_STATIC, tf(0, BASE_FOOTPRINT_FRAME, CAMERA_FRAME, link))
    made.hear(DEPTH_INFO, camera_info(0))
    return made


@pytest.mark.parametrize("encoding", ["32FC1", "16UC1"])
def test_a_depth_image_becomes_a_scan_in_the_next_step(encoding: str) -> None:
    made = depth_bench()
    made.hear(DEPTH_IMAGE, depth_image(PERIOD_NS, encoding))
    made.step(PERIOD_NS)
    assert DEPTH_SCAN.name not in [name for name, _ in made.said]
    made.step(2 * PERIOD_NS)
    (scan,) = [message for name, message in made.said if name == DEPTH_SCAN.name]
    assert scan.header == msg.header(PERIOD_NS, CAMERA_FRAME)
    assert scan.ranges[len(scan.ranges) // 2] == pytest.approx(1.0, abs=0.02)
    made.step(3 * PERIOD_NS)
    assert DEPTH_SCAN.name not in [name for name, _ in made.said]


def test_the_scan_of_a_camera_on_its_head_has_the_angles_of_its_frame() -> None:
    on_head = transform_matrix(rotation_from_rpy(math.pi, 0.0, 0.0), (0.07, 0.0, CAMERA_HEIGHT_M))
    made = depth_bench(on_head @ LINK_FROM_OPTICAL)
    # The picture's right half is on the robot's left.
    picture = depth_image(0)
    depths = np.array(picture.data).view(np.float32).reshape(HEIGHT, WIDTH)
    depths[:, WIDTH // 2 :] = 2.0
    made.hear(DEPTH_IMAGE, replace(picture, data=depths.reshape(-1).view(np.uint8)))
    made.step(0)
    made.step(PERIOD_NS)
    (message,) = [message for name, message in made.said if name == DEPTH_SCAN.name]
    scan = Scan.from_message(message, Mount.of(on_head))
    y_m = scan.ranges_m * scan.directions()[:, 1]
    assert scan.ranges_m[y_m > 0.05] == pytest.approx(2.0, abs=0.5)
    assert scan.ranges_m[y_m < -0.05] == pytest.approx(1.0, abs=0.2)


def test_a_camera_that_looks_elsewhere_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    back = transform_matrix(rotation_from_rpy(0.0, 0.0, math.pi), (-0.2, 0.0, CAMERA_HEIGHT_M))
    made = depth_bench(back @ LINK_FROM_OPTICAL)
    with caplog.at_level(logging.WARNING):
        for stamp_ns in range(3):
            made.hear(DEPTH_IMAGE, depth_image(stamp_ns))
            made.step(stamp_ns)
    (told,) = caplog.messages
    assert "does not see the floor ahead of the robot: low things are not avoided" in told
    assert "180 degrees to the left" in told


def test_depths_that_cannot_be_read_are_rejected() -> None:
    made = depth_bench()
    made.hear(DEPTH_IMAGE, depth_image(0, "mono8"))
    made.step()
    assert sum(made.rejected(DEPTH_IMAGE).values()) == 1
    made.hear(DEPTH_INFO, camera_info(0, width=WIDTH // 2))
    made.hear(DEPTH_IMAGE, depth_image(0))
    made.step()
    assert sum(made.rejected(DEPTH_IMAGE).values()) == 2
    made.step(PERIOD_NS)
    assert DEPTH_SCAN.name not in [name for name, _ in made.said]
