import contextlib
import copy
import dataclasses
import math
import random

import numpy as np
import pytest

from mazebot.common.messages import cdr, document_types, wire
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Document, SimulationControl
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CMD_VEL,
    GOAL_POSE,
    LOCALIZATION_STATUS,
    MAP,
    NAVIGATION_RESULT,
    ODOM,
    SCAN,
    TF,
    TF_STATIC,
    TOPICS,
    WORLD,
    Topic,
)
from tests.common.samples import PLANAR, SAMPLES


def test_there_is_a_sample_of_every_topic() -> None:
    assert {topic.name for topic in SAMPLES} == {topic.name for topic in TOPICS}


@pytest.mark.parametrize("topic", SAMPLES, ids=lambda topic: topic.name)
def test_a_message_survives_the_wire(topic: Topic[object]) -> None:
    sample = SAMPLES[topic]
    wire.validate(topic, sample)
    data = wire.encode(topic, sample)
    assert data[:4] == b"\x00\x01\x00\x00"
    decoded = wire.decode(topic, data)
    assert type(decoded) is topic.type
    assert wire.encode(topic, decoded) == data


@pytest.mark.parametrize("topic", SAMPLES, ids=lambda topic: topic.name)
def test_damaged_bytes_are_refused_and_nothing_else_happens(topic: Topic[object]) -> None:
    data = wire.encode(topic, SAMPLES[topic])
    shuffle = random.Random(0)
    for _ in range(60):
        damaged = bytearray(data[: shuffle.randrange(len(data) + 1)])
        for _ in range(shuffle.randrange(4)):
            if damaged:
                damaged[shuffle.randrange(len(damaged))] = shuffle.randrange(256)
        with contextlib.suppress(wire.WireError):
            wire.validate(topic, wire.decode(topic, bytes(damaged)))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_are_not_finite_are_refused(value: float) -> None:
    command = copy.deepcopy(SAMPLES[CMD_VEL])
    assert isinstance(command, msg.TwistStamped)
    command.twist.angular.z = value
    with pytest.raises(wire.WireError, match="not finite"):
        wire.validate(CMD_VEL, command)


@pytest.mark.parametrize("value", [1.7e308, -1e300, 1e7])
def test_a_place_farther_away_than_anything_is_refused(value: float) -> None:
    goal = copy.deepcopy(SAMPLES[GOAL_POSE])
    assert isinstance(goal, msg.PoseStamped)
    goal.pose.position.x = value
    with pytest.raises(wire.WireError, match="out of range"):
        wire.validate(GOAL_POSE, goal)


def test_a_number_of_a_document_that_nothing_can_reckon_with_is_refused() -> None:
    for fields in ({"start_time_s": 1.7e308}, {"goal_stamp_ns": 10**30}):
        result = SAMPLES[NAVIGATION_RESULT].model_copy(update=fields)
        with pytest.raises(wire.WireError, match="out of range"):
            wire.validate(NAVIGATION_RESULT, result)
    goal = PLANAR.model_copy(update={"x_m": 1e300})
    result = SAMPLES[NAVIGATION_RESULT].model_copy(update={"goal": goal})
    with pytest.raises(wire.WireError, match="out of range"):
        wire.validate(NAVIGATION_RESULT, result)


def tree(*edges: tuple[str, str]) -> msg.TFMessage:
    return msg.TFMessage(
        [msg.transform_stamped(0, parent, child, np.eye(4)) for parent, child in edges]
    )


@pytest.mark.parametrize("topic", [TF, TF_STATIC], ids=lambda topic: topic.name)
def test_frames_in_a_ring_are_refused(topic: Topic[msg.TFMessage]) -> None:
    wire.validate(topic, tree(("a", "b"), ("b", "c"), ("a", "d")))
    for edges in ((("a", "a"),), (("a", "b"), ("b", "a")), (("x", "a"), ("c", "b"), ("b", "c"))):
        with pytest.raises(wire.WireError, match="loop in the frame tree"):
            wire.validate(topic, tree(*edges))


def test_more_frames_than_anything_has_are_refused() -> None:
    with pytest.raises(wire.WireError, match="too many items"):
        wire.validate(TF, tree(*(("map", f"frame_{i}") for i in range(2000))))
    many = tree(*(("map", f"frame_{i}") for i in range(20_000)))
    with pytest.raises(wire.WireError, match="too large"):
        wire.decode(TF, wire.encode(TF, many))


def test_a_map_of_more_cells_than_any_map_has_is_refused() -> None:
    grid = copy.deepcopy(SAMPLES[MAP])
    assert isinstance(grid, msg.OccupancyGrid)
    grid.info.width, grid.info.height = 8000, 5000
    grid.data = np.zeros(40_000_000, np.int8)
    with pytest.raises(wire.WireError, match="too many cells"):
        wire.validate(MAP, grid)


@pytest.mark.parametrize("side_m", [0.0, 1e-9, 5e-4, 2000.0])
def test_a_map_of_cells_of_no_use_is_refused(side_m: float) -> None:
    grid = copy.deepcopy(SAMPLES[MAP])
    assert isinstance(grid, msg.OccupancyGrid)
    grid.info.resolution = side_m
    with pytest.raises(wire.WireError, match="out of range"):
        wire.validate(MAP, grid)


@pytest.mark.parametrize(
    ("angle_min", "angle_increment"), [(1e6, 0.01), (0.0, 1e8), (0.0, -1e8), (0.0, 1.0)]
)
def test_a_lidar_turns_once(angle_min: float, angle_increment: float) -> None:
    scan = copy.deepcopy(SAMPLES[SCAN])
    assert isinstance(scan, msg.LaserScan)
    scan.ranges = np.ones(360, np.float32)
    scan.angle_min, scan.angle_increment = 0.0, math.tau / 360
    wire.validate(SCAN, scan)
    scan.angle_min, scan.angle_increment = angle_min, angle_increment
    with pytest.raises(wire.WireError, match="two turns"):
        wire.validate(SCAN, scan)


def test_an_array_may_hold_huge_numbers_but_none_that_is_not_finite() -> None:
    odometry = copy.deepcopy(SAMPLES[ODOM])
    assert isinstance(odometry, msg.Odometry)
    odometry.pose.covariance = np.full(36, 1e11)
    wire.validate(ODOM, odometry)
    odometry.pose.covariance[35] = 1e200
    with pytest.raises(wire.WireError, match="out of range"):
        wire.validate(ODOM, odometry)
    for value in (np.nan, np.inf, -np.inf):
        odometry.pose.covariance = np.zeros(36)
        odometry.pose.covariance[35] = value
        with pytest.raises(wire.WireError, match="not finite"):
            wire.validate(ODOM, odometry)


@pytest.mark.parametrize("size", [0, 1, 35, 37, 66])
def test_an_array_of_fixed_length_has_that_length(size: int) -> None:
    estimate = copy.deepcopy(SAMPLES[AMCL_POSE])
    estimate.pose.covariance = np.zeros(size)
    with pytest.raises(wire.WireError, match=r"^wrong length$"):
        wire.validate(AMCL_POSE, estimate)


def test_a_rotation_must_be_one() -> None:
    goal = copy.deepcopy(SAMPLES[GOAL_POSE])
    assert isinstance(goal, msg.PoseStamped)
    goal.pose.orientation.w = 0.0
    goal.pose.orientation.z = 0.0
    with pytest.raises(wire.WireError, match="quaternion"):
        wire.validate(GOAL_POSE, goal)


def test_a_scan_may_hold_no_return_but_not_a_nan() -> None:
    scan = copy.deepcopy(SAMPLES[SCAN])
    assert isinstance(scan, msg.LaserScan)
    wire.validate(SCAN, scan)
    scan.ranges = np.array([np.nan], np.float32)
    with pytest.raises(wire.WireError, match="not finite"):
        wire.validate(SCAN, scan)


def test_a_request_with_an_unknown_key_is_refused() -> None:
    text = '{"pause": true, "nope": 1}'
    data = bytes(msg.TYPESTORE.serialize_cdr(msg.String(text), "std_msgs/msg/String"))
    with pytest.raises(wire.WireError, match="nope"):
        wire.decode_json(SimulationControl, data)


def test_a_document_with_a_nan_or_a_word_that_is_none_of_its_words_is_refused() -> None:
    message = document_types.pack(SAMPLES[LOCALIZATION_STATUS])
    kind = wire.type_name(LOCALIZATION_STATUS)
    for field, value in (("quality", math.nan), ("state", "sure")):
        changed = dataclasses.replace(message, **{field: value})
        with pytest.raises(wire.WireError, match=f"invalid schema: {field}"):
            wire.decode(LOCALIZATION_STATUS, cdr.encode(kind, changed))


def test_a_message_of_another_topic_is_refused() -> None:
    with pytest.raises(wire.WireError, match="wrong type"):
        wire.validate(CMD_VEL, SAMPLES[GOAL_POSE])
    with pytest.raises(wire.WireError):
        wire.encode(CMD_VEL, SAMPLES[GOAL_POSE])


def test_an_array_of_another_kind_is_refused() -> None:
    scan = copy.deepcopy(SAMPLES[SCAN])
    assert isinstance(scan, msg.LaserScan)
    scan.ranges = scan.ranges.astype(np.float64)
    with pytest.raises(wire.WireError):
        wire.encode(SCAN, scan)


def test_documents_travel_as_messages_of_their_own_package() -> None:
    assert wire.type_name(WORLD) == "mazebot_msgs/msg/World"


def test_documents_are_frozen() -> None:
    for sample in SAMPLES.values():
        if isinstance(sample, Document):
            assert sample.model_config["frozen"]
            assert sample.model_config["extra"] == "forbid"
