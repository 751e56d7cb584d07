"""Poses that a tree's file writes as Nav2 reads them: `stamp;frame;x;y;z;qx;qy;qz;qw`."""

from __future__ import annotations

import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.engine.tree import TreeError
from mazebot.navigation.behavior.nodes.xml_loader import read_tree
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.scripted_tree import run_over

POSE = "0;map;1.5;-2.0;0;0;0;0.7071068;0.7071068"
READ = SE2(1.5, -2.0, 1.5707963)
APPEND = '<AppendGoalPoseToGoals goal_pose="{}" input_goals="{}" output_goals="{{goals}}"/>'


@pytest.mark.parametrize(
    "inside",
    [
        APPEND.format(POSE, "{none}"),
        f'<Sequence><SetBlackboard output_key="p" value="{POSE}"/>'
        f"{APPEND.format('{p}', '{none}')}</Sequence>",
        f"<Sequence><Script code=\"p := '{POSE}'\"/>{APPEND.format('{p}', '{none}')}</Sequence>",
        # A frame may be empty.
        APPEND.format(POSE.replace("map", ""), "{none}"),
    ],
)
def test_a_pose_is_read_from_a_port_or_a_text_on_the_blackboard(inside: str) -> None:
    tree = read_tree(document(inside), "t.xml").build(run_over())
    assert tree.tick(0).value == "SUCCESS"
    assert tree.blackboard.get("goals") == (pytest.approx(READ),)


def test_poses_follow_each_other() -> None:
    text = APPEND.format("{p}", f"{POSE};{POSE}")
    tree = read_tree(document(text), "t.xml").build(run_over())
    tree.blackboard.set("p", SE2(0.0, 0.0, 0.0))
    assert tree.tick(0).value == "SUCCESS"
    assert tree.blackboard.get("goals") == (
        pytest.approx(READ), pytest.approx(READ), SE2(0.0, 0.0, 0.0),
    )  # fmt: skip


def test_a_subtree_is_given_a_pose() -> None:
    tree = read_tree(
        f"""<root BTCPP_format="4" main_tree_to_execute="Main">
        <BehaviorTree ID="Main"><SubTree ID="Below" p="{POSE}" goals="{{goals}}"/></BehaviorTree>
        <BehaviorTree ID="Below">{APPEND.format("{p}", "{none}")}</BehaviorTree></root>""",
        "t.xml",
    ).build(run_over())
    assert tree.tick(0).value == "SUCCESS"
    assert tree.blackboard.get("goals") == (pytest.approx(READ),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1;2;0", "must be a blackboard entry {...} or stamp;map;x;y;z;qx;qy;qz;qw (got '1;2;0')"),
        (
            POSE.replace("map", "odom"),
            "frame 'odom': must be map or empty (got '0;odom;1.5;-2.0;0;0;0;0.7071068;0.7071068')",
        ),
        (
            "0;map;1;2;0;0;0;0;0",
            "qx;qy;qz;qw must be a unit quaternion (got '0;map;1;2;0;0;0;0;0')",
        ),
        ("0;map;1;inf;0;0;0;0;1", "x, y and z must be finite (got '0;map;1;inf;0;0;0;0;1')"),
        ("0;map;a;2;0;0;0;0;1", "must be a number (got 'a')"),
    ],
)
def test_what_is_no_pose_in_the_map_is_told(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_tree(document(APPEND.format(text, "{none}")), "t.xml")
    assert str(caught.value) == f"t.xml:1: AppendGoalPoseToGoals, port 'goal_pose': {message}"
    tree = read_tree(document(APPEND.format("{p}", "{none}")), "t.xml").build(run_over())
    tree.blackboard.set("p", text)
    with pytest.raises(TreeError) as late:
        tree.tick(0)
    assert str(late.value).endswith(f"port 'goal_pose': {message}")


def test_half_a_pose_more_is_told() -> None:
    with pytest.raises(ConfigError, match=r"port 'input_goals': must be .* for each pose"):
        read_tree(document(APPEND.format("{p}", f"{POSE};0;map;1")), "t.xml")
