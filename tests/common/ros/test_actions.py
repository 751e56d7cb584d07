"""Actions of ROS 2 without a bus: what they tell, in each distribution."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.ros.action import Action, Ended, Feedback, GoalError, Running
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.definitions import DISTROS
from mazebot.common.ros.interfaces import Versioned, interfaces

NOT_TOLD = {"__msgtype__", "structure_needs_at_least_one_member", "result"}
"""No fields on the wire, those of empty messages, and an empty message itself."""
HERE = doc.Planar(x_m=1.0, y_m=2.0, yaw_rad=0.5)
FEEDBACK = act.ActionFeedback(
    goal_id="id", action="any", current_pose=HERE, distance_remaining_m=1.5,
    docking_state="controlling", goal=HERE,
    waypoints=(act.WaypointStatus(status="pending", index=0),),
)  # fmt: skip
RESULT = act.ActionResult(
    goal_id="id", action="any", status="succeeded", start_time_s=1.0, end_time_s=2.0,
    waypoints=(act.WaypointStatus(status="completed", index=0),),
)  # fmt: skip
OF_THE_NAVIGATOR = [
    action for action in ACTIONS if action.owner == "navigation" and action.observes
]


def fields_of(message: Any) -> set[str]:
    return {field.name for field in dataclasses.fields(message)} - NOT_TOLD


def told_by(action: Action, distro: str) -> tuple[Any, Any]:
    """The values of its feedback and of its result."""
    goal = interfaces(distro).make(f"{action.type}_Goal", {})
    course = action.run(goal, "id")
    next(course)
    running = course.send(act.SendGoalReply(accepted=True))
    assert isinstance(running, Running)
    feedback, ended = running.heard(FEEDBACK), running.heard(RESULT)
    assert isinstance(feedback, Feedback)
    assert isinstance(ended, Ended)
    return feedback.values, ended.result


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("action", OF_THE_NAVIGATOR, ids=lambda action: action.name)
def test_no_field_of_feedback_and_result_is_left_out(action: Action, distro: str) -> None:
    types = interfaces(distro)
    for part, values in zip(("Feedback", "Result"), told_by(action, distro), strict=True):
        name = f"{action.type}_{part}"
        assert fields_of(types.make(name, {})) <= values.keys(), name
        types.encode(name, values)


@pytest.mark.parametrize("action", OF_THE_NAVIGATOR, ids=lambda action: action.name)
def test_each_value_is_one_of_a_distribution(action: Action) -> None:
    for part, index in (("Feedback", 0), ("Result", 1)):
        name = f"{action.type}_{part}"
        known = {
            field for distro in DISTROS for field in fields_of(interfaces(distro).make(name, {}))
        }
        assert told_by(action, "jazzy")[index].keys() <= known, name


def test_what_a_version_does_not_have_is_left_out_at_any_depth() -> None:
    name = "nav2_msgs/action/NavigateToPose_FeedbackMessage"
    values = {"feedback": Versioned(distance_remaining=2.0, position_tracking_error=0.5)}
    assert interfaces("jazzy").make(name, values).feedback.distance_remaining == 2.0
    assert interfaces("lyrical").make(name, values).feedback.position_tracking_error == 0.5


@pytest.mark.parametrize("distro", DISTROS)
@pytest.mark.parametrize("name", ["/navigate_to_pose", "/follow_path"])
def test_an_orientation_that_is_none_is_refused(name: str, distro: str) -> None:
    (action,) = [action for action in ACTIONS if action.name == name]
    pose = {"pose": {"orientation": {"z": 1.0, "w": 1.0}}}
    values = {"pose": pose} if name == "/navigate_to_pose" else {"path": {"poses": [pose]}}
    goal = interfaces(distro).make(f"{action.type}_Goal", values)
    with pytest.raises(GoalError, match=r"orientation \(0, 0, 1, 1\): must have length 1$"):
        next(action.run(goal, "id"))
