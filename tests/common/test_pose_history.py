"""Where a frame was, by time, and frames that hang together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array, rotation_from_rpy, transform_matrix
from mazebot.common.maths.pose_history import PoseHistory
from mazebot.common.messages import messages as msg

SECOND_NS = 1_000_000_000


def history(depth: int = 10) -> PoseHistory:
    made = PoseHistory(depth)
    made.add(1 * SECOND_NS, SE2(0.0, 0.0, math.pi - 0.1).matrix())
    made.add(2 * SECOND_NS, SE2(4.0, 2.0, -math.pi + 0.1).matrix())
    return made


def test_between_two_stamps_the_pose_is_between_the_two_the_short_way_round() -> None:
    between = history().at(SECOND_NS + SECOND_NS // 4)
    assert between is not None
    assert between == pytest.approx(SE2(1.0, 0.5, math.pi - 0.05).matrix(), abs=1e-4)
    assert between[:3, :3] @ between[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


def test_at_a_stamp_it_is_the_very_pose() -> None:
    pose = transform_matrix(rotation_from_rpy(0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    made = PoseHistory(4)
    made.add(5, pose)
    assert made.at(5) is pose


def test_outside_it_holds_the_nearest_pose_for_as_long_as_is_asked() -> None:
    made = history()
    assert made.at(2 * SECOND_NS + 1) is None
    assert made.at(SECOND_NS - 1) is None
    newest, oldest = made.at(2 * SECOND_NS + 5, hold_ns=5), made.at(SECOND_NS - 5, hold_ns=5)
    assert newest is not None
    assert oldest is not None
    assert (newest[0, 3], oldest[0, 3]) == (4.0, 0.0)
    assert made.at(2 * SECOND_NS + 6, hold_ns=5) is None
    assert PoseHistory(3).at(0, hold_ns=5) is None


def test_what_is_not_newer_is_left_out() -> None:
    made = history()
    assert not made.add(2 * SECOND_NS, np.eye(4))
    assert not made.add(2 * SECOND_NS - 1, np.eye(4))
    assert made.newest_ns == 2 * SECOND_NS


def test_a_clock_that_begins_anew_begins_a_new_history() -> None:
    made = history()
    assert made.add(0, np.eye(4))
    assert made.newest_ns == 0
    assert made.at(2 * SECOND_NS) is None


def test_only_the_newest_are_kept() -> None:
    made = PoseHistory(3)
    for stamp_ns in range(100):
        made.add(stamp_ns, np.eye(4))
    assert made.at(97) is not None
    assert made.at(90) is None


def chain() -> tuple[list[msg.TransformStamped], Array]:
    first = transform_matrix(rotation_from_rpy(0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    second = transform_matrix(rotation_from_rpy(-0.3, 0.0, 1.0), (0.0, -1.0, 0.5))
    entries = [
        msg.transform_stamped(0, "link", "optical", second),
        msg.transform_stamped(0, "base", "link", first),
        msg.transform_stamped(0, "base", "wheel", np.eye(4)),
    ]
    return entries, first @ second


def test_frames_are_chained_from_parent_to_child() -> None:
    entries, base_from_optical = chain()
    assert msg.chain_transforms(entries, "base", "optical") == pytest.approx(base_from_optical)
    assert msg.chain_transforms(entries, "base", "base") == pytest.approx(np.eye(4))


def test_frames_that_do_not_hang_together_have_no_transform() -> None:
    entries, _ = chain()
    assert msg.chain_transforms(entries, "wheel", "optical") is None
    assert msg.chain_transforms(entries, "base", "camera") is None
    loop = [msg.transform_stamped(0, a, b, np.eye(4)) for a, b in (("a", "b"), ("b", "a"))]
    assert msg.chain_transforms(loop, "base", "a") is None
