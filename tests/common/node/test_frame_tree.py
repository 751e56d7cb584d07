import numpy as np

from mazebot.common.messages import messages as msg
from mazebot.common.node.frame_tree import MAX_FRAMES, FrameTree


def tree(*edges: tuple[str, str]) -> msg.TFMessage:
    return msg.TFMessage(
        [msg.transform_stamped(0, parent, child, 2.0 * np.eye(4)) for parent, child in edges]
    )


def test_what_would_close_a_ring_with_what_came_before_changes_nothing() -> None:
    frames = FrameTree()
    assert frames.add(tree(("base", "camera"), ("camera", "optical"))) == ""
    assert frames.add(tree(("optical", "base"), ("base", "lidar"))) == "loop in the frame tree"
    assert frames.chain("base", "optical") is not None
    assert frames.chain("base", "lidar") is None
    assert frames.add(tree(("base", "lidar"))) == ""
    assert frames.chain("base", "lidar") is not None


def test_a_frame_may_move_to_another_parent() -> None:
    frames = FrameTree()
    frames.add(tree(("base", "camera"), ("camera", "optical")))
    assert frames.add(tree(("base", "optical"))) == ""
    assert frames.add(tree(("optical", "camera"))) == ""
    assert frames.chain("base", "camera") is not None


def test_there_are_not_more_frames_than_anything_has() -> None:
    frames = FrameTree()
    for first in range(0, MAX_FRAMES, 500):
        assert frames.add(tree(*(("map", f"frame_{first + i}") for i in range(500)))) == ""
    assert frames.add(tree(("map", "one more"))) == "too many frames"
    assert frames.add(tree(("map", "frame_0"))) == ""
