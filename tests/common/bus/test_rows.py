"""Many points or poses in one message, held against a list of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mazebot.common.messages import cdr
from mazebot.common.messages import messages as msg
from mazebot.common.messages.rows import (
    array_from_points,
    array_from_poses,
    points_from_array,
    poses_from_array,
)

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
