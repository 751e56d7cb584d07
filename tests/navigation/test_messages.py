"""Where a request should end, as the recorder is told it."""

from __future__ import annotations

import numpy as np
import pytest

from services.common.frames import SE2
from services.navigation.behavior import actions
from services.navigation.behavior.actions import Request, TaskResult, TaskStatus
from services.navigation.behavior.tree import NodeSnapshot, NodeStatus
from services.navigation.behavior.tree_log import TreeLog
from services.navigation.messages import result_action
from services.navigation.planning.path import path_through

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


def test_a_node_that_answers_at_once_is_seen_by_who_looks_seldom() -> None:
    def tick(status: NodeStatus) -> tuple[NodeSnapshot, ...]:
        return (
            NodeSnapshot(1, "Root", "Sequence", NodeStatus.RUNNING, 0),
            NodeSnapshot(2, "Plan", "ComputePathToPose", status, 1),
        )

    log = TreeLog()
    for status in (NodeStatus.IDLE, NodeStatus.FAILURE, NodeStatus.SUCCESS, NodeStatus.IDLE):
        log.add(tick(status))
    assert log.take() == tick(NodeStatus.SUCCESS)
    log.add(tick(NodeStatus.IDLE))
    assert log.take() == tick(NodeStatus.IDLE)
    # A tree that has ended leaves nothing behind.
    log.add(tick(NodeStatus.SUCCESS))
    log.add(())
    assert log.take() == ()
