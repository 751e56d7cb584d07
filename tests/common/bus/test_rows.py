"""Many points or poses in one message, held against a list of them."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest

from mazebot.common.messages import cdr
from mazebot.common.messages import messages as msg
from mazebot.common.messages.rows import (
    Rows,
    array_from_points,
    array_from_poses,
    points_from_array,
    poses_from_array,
)
from mazebot.common.messages.topics import PARTICLE_CLOUD
from mazebot.common.messages.wire import WireError, validate

POSES = np.random.default_rng(3).normal(size=(5, 7))
ORDERS: list[Any] = [slice(None), slice(None, None, 2), slice(0)]


@pytest.mark.parametrize("some", ORDERS)
@pytest.mark.parametrize("frame", ["", "m", "map"])
def test_they_are_encoded_as_a_list(some: slice, frame: str) -> None:
    rows = poses_from_array(POSES)[some]
    of_rows, of_list = (
        cdr.encode(msg.PoseArray.__msgtype__, msg.PoseArray(msg.header(7, frame), poses))
        for poses in (rows, list(rows))
    )
    assert of_rows == of_list
    found = msg.TYPESTORE.deserialize_cdr(of_rows, msg.PoseArray.__msgtype__)
    np.testing.assert_array_equal(array_from_poses(found.poses), POSES[some])  # type: ignore[attr-defined]


def test_they_are_looked_at_as_a_list() -> None:
    poses, points = poses_from_array(POSES), points_from_array(POSES[:, :3])
    assert [one.position.z for one in poses] == [one.z for one in points] == POSES[:, 2].tolist()
    assert poses[-1].orientation.w == POSES[-1, 6]
    assert len(points) == 5
    assert points == list(points)
    assert list(points) == points
    assert points != points[:4]
    assert repr(points) == repr(list(points))
    with pytest.raises(IndexError):
        points[5]


def test_they_are_not_those_of_an_array_that_is_filled_again() -> None:
    array = POSES[:, :3].copy()
    points = points_from_array(array)
    array[:] = 0.0
    np.testing.assert_array_equal(array_from_points(points), POSES[:, :3])
    np.testing.assert_array_equal(array_from_points(list(points)), POSES[:, :3])


def made_into_a_message(*_: float) -> msg.Pose:
    raise AssertionError


def test_a_cloud_that_is_right_is_seen_to_be_without_a_message_of_each() -> None:
    poses = np.zeros((2000, 7))
    poses[:, :3], poses[:, 5:] = (-1e6, 0.0, 1e6), math.sqrt(0.5)
    rows = cast("list[msg.Pose]", Rows(poses, made_into_a_message))
    cloud = msg.PoseArray(msg.header(7, "map"), rows)
    validate(PARTICLE_CLOUD, cloud)
    validate(PARTICLE_CLOUD, msg.PoseArray(msg.header(7, "map"), poses_from_array(poses[:0])))


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        (0, 1.1e6, "out of range"),
        (1, math.nan, "not finite"),
        (2, -math.inf, "not finite"),
        (3, math.nan, "not finite"),
        (5, 0.1, "quaternion not normalized"),
        (6, 1e200, "out of range"),
    ],
)
def test_what_is_wrong_in_a_cloud_is_said_as_of_a_list(
    column: int, value: float, problem: str
) -> None:
    poses = np.zeros((2000, 7))
    poses[:, 6] = 1.0
    poses[1234, column] = value
    for each in (poses_from_array(poses), list(poses_from_array(poses))):
        with pytest.raises(WireError, match=problem):
            validate(PARTICLE_CLOUD, msg.PoseArray(msg.header(7, "map"), each))
