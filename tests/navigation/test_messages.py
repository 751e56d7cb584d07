"""Where a request should end, as the recorder is told it."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior import actions
from mazebot.navigation.behavior.actions import Request, TaskResult, TaskStatus
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.tree import BehaviorTree, Node, NodePlace, NodeStatus
from mazebot.navigation.behavior.engine.tree_log import TreeLog
from mazebot.navigation.messages import planned_path, result_action
from mazebot.navigation.planning.path import path_through
from tests.navigation.behavior.scripted_tree import Scripted

POSE, DOCKED = SE2(1.0, 2.0, 0.5), SE2(3.0, 1.0, -1.0)
PATH = path_through(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.3)


@pytest.mark.parametrize(
    ("request_", "goal", "displacement"),
    [
        (actions.NavigateToPose(POSE), POSE, None),
        (actions.NavigateThroughPoses((DOCKED, POSE)), POSE, None),
        (actions.FollowWaypoints((DOCKED, POSE)), POSE, None),
        (actions.FollowPath(PATH), PATH.goal, None),
        (actions.dock_robot(dock_pose=POSE), POSE, None),
        (actions.dock_robot(dock_id="marker_60"), DOCKED, None),
        (actions.dock_robot(dock_id="unknown"), None, None),
        (actions.undock_robot(), None, None),
        (actions.assisted_teleop(), None, None),
        (actions.wait(1.0), None, SE2(0.0, 0.0, 0.0)),
        (actions.spin(-1.5), None, SE2(0.0, 0.0, -1.5)),
        (actions.spin(7.0), None, SE2(0.0, 0.0, 7.0 - 2.0 * np.pi)),
        (actions.back_up(0.3), None, SE2(-0.3, 0.0, 0.0)),
        (actions.drive_on_heading(-0.2, -0.1), None, SE2(-0.2, 0.0, 0.0)),
    ],
)
def test_a_result_says_where_the_robot_should_be(
    request_: Request, goal: SE2 | None, displacement: SE2 | None
) -> None:
    result = TaskResult(request_, TaskStatus.SUCCEEDED, 0, "", 0, 10**9)
    told = result_action("a-1", result, {"marker_60": DOCKED})
    assert (told.goal and told.goal.se2()) == goal
    if displacement is None:
        assert told.displacement is None
    else:
        assert told.displacement is not None
        assert told.displacement.se2() == pytest.approx(displacement)


class Root(Node):
    """Ticks its child where the script has no dash."""

    def __init__(self, script: str) -> None:
        child = Scripted("SFSS")
        super().__init__(NodePlace(1, "Root", "root", {}, Blackboard(), child.place.run), [child])
        self.script = script

    def _tick(self, now_ns: int) -> NodeStatus:
        if self.script[now_ns] != "-":
            self.children[0].tick(now_ns)
        return NodeStatus.RUNNING


def test_a_node_that_answers_at_once_is_seen_by_who_looks_seldom() -> None:
    def tree_of(script: str) -> BehaviorTree:
        root = Root(script)
        return BehaviorTree("tree", root, Blackboard(), root.place.run)

    def taken() -> list[NodeStatus]:
        return [one.status for one in log.take()]

    log, tree = TreeLog(), tree_of("x-xx--x")
    answers = []
    for now in range(6):
        tree.tick(now)
        log.add(tree)
        if now in (0, 4, 5):
            answers.append(taken())
    running = NodeStatus.RUNNING
    assert answers == [
        [running, NodeStatus.SUCCESS],
        # The newest of two.
        [running, NodeStatus.SUCCESS],
        [running, NodeStatus.IDLE],
    ]
    # While the robot is held, the last tick goes on being shown.
    tree.tick(6)
    for _ in range(2):
        log.add(tree)
        assert taken() == [running, NodeStatus.SUCCESS]
    # A tree in place of another has its answers, until it gives its own.
    log.add(tree)
    other = tree_of("-")
    other.tick(0)
    log.add(other)
    assert taken() == [running, NodeStatus.SUCCESS]
    # A tree that has ended leaves nothing behind.
    log.add(other)
    log.add(None)
    assert taken() == []


def out_and_on(back: int, yaw_rad: float) -> tuple[Planar, ...]:
    """So many steps of 0.1 m back, with a heading, and from there 1 m to the left."""
    ends_at = -0.1 * back
    away = [Planar(x_m=-0.1 * i, y_m=0.0, yaw_rad=yaw_rad) for i in range(back)]
    left = [Planar(x_m=ends_at, y_m=0.1 * i, yaw_rad=np.pi / 2) for i in range(11)]
    return (*away, *left)


@pytest.mark.parametrize(
    ("poses", "backwards"),
    [
        (out_and_on(3, 0.0), 3),
        (out_and_on(3, 0.1), 3),
        (out_and_on(3, np.pi), 0),
        (out_and_on(3, 1.0), 0),
        # Longer than a robot should drive without looking.
        (out_and_on(15, 0.0), 0),
        # As from a planner that gives no headings.
        (tuple(pose.model_copy(update={"yaw_rad": 0.0}) for pose in out_and_on(3, 0.0)), 0),
    ],
)
def test_a_path_is_driven_backwards_where_its_headings_ask_for_it(
    poses: tuple[Planar, ...], backwards: int
) -> None:
    path = planned_path(poses, ErrorCode.INVALID_PATH)
    assert np.flatnonzero(path.backwards()).tolist() == list(range(backwards))
    assert path.goal == poses[-1].se2()
