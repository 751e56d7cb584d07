"""Actions of ROS 2 on a real router, called by a client that knows the wire alone."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.ros.action_server import MAX_ENDED
from mazebot.common.bus.session import open_session
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    COMPUTE_PATH,
    NAVIGATION_CHECKPOINT,
    SEND_GOAL,
)
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros.interfaces import interfaces
from tests.common.bus.ros_client import RefusedError, call
from tests.common.bus.running import Running

UNKNOWN, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 0, 2, 3, 4, 5, 6
TO_POSE = "nav2_msgs/action/NavigateToPose"
OUTSIDE = 204
THROUGH = "navigate_through_poses"
ACCEPTED_NS = 12_000_000_000
NOTHING_KEPT = act.NavigationCheckpoint(world_hash="", epoch=None, goal=None)
PASSED = tuple(
    act.WaypointStatus(status=status, index=index)
    for index, status in enumerate(("completed", "pending"))
)
DEADLINE_S = 20.0


class Navigation(Node):
    """Runs one goal until it is told to end; a goal outside x < 100 m cannot be planned to."""

    name = "navigation"
    _config = ServiceConfig()

    def __init__(self) -> None:
        self.goal: act.SendGoal | None = None
        self.sent: list[act.SendGoal] = []
        self.finishes = False
        self.active = True
        self.checkpoint: act.NavigationCheckpoint | None = NOTHING_KEPT
        """What is told of the goal that runs in the next step, if anything."""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if self.checkpoint is not None:
            outbox.put(NAVIGATION_CHECKPOINT, self.checkpoint)
            self.checkpoint = None
        for request in inbox.requests(SEND_GOAL):
            self._start(request.message, request.respond, outbox)
        for asked in inbox.requests(COMPUTE_PATH):
            far = asked.message.goals[0].x_m > 100.0
            reply = act.ComputePathReply(error_code=OUTSIDE, error_msg="outside")
            asked.respond(reply if far else act.ComputePathReply(path=asked.message.goals))
        for cancel in inbox.requests(CANCEL_GOAL):
            which, goal = cancel.message, self.goal
            if (
                goal is not None
                and which.goal_id in (None, goal.goal_id)
                and which.action in (None, goal.goal.action)
                and (which.accepted_until_ns or ACCEPTED_NS) >= ACCEPTED_NS
            ):
                self._end("canceled", 9012, outbox)
                canceled = doc.CancelGoalReply(goal_id=goal.goal_id, accepted_ns=ACCEPTED_NS)
                cancel.respond(canceled)
            else:
                cancel.respond(doc.CancelGoalReply(return_code=2))
        if self.goal is not None:
            told = act.ActionFeedback(
                goal_id=self.goal.goal_id, action=self.goal.goal.action, distance_remaining_m=1.5,
                number_of_recoveries=2, current_pose=doc.Planar(x_m=3.0, y_m=4.0, yaw_rad=0.0),
                navigation_time_s=2.25, current_waypoint=1, time_left_s=4.5, speed_m_s=0.25,
                estimated_time_remaining_s=1e9, docking_state="controlling", num_retries=1,
                goal=doc.Planar(x_m=3.0, y_m=4.75, yaw_rad=0.0), position_tracking_error_m=-0.125,
                heading_tracking_error_rad=0.5, current_path_index=7, number_of_poses_remaining=1,
                waypoints=PASSED if self.goal.goal.action == THROUGH else (),
            )  # fmt: skip
            outbox.put(ACTION_FEEDBACK, told)
            if self.finishes:
                self._end("succeeded", 0, outbox)

    def _start(self, wanted: act.SendGoal, respond: Any, outbox: Outbox) -> None:
        pose = getattr(wanted.goal, "pose", None)
        if not self.active:
            respond(act.SendGoalReply(accepted=False, error_code=1, error_msg="no map"))
        elif pose is not None and pose.x_m > 100.0:
            message = "goal outside the map"
            respond(act.SendGoalReply(accepted=False, error_code=OUTSIDE, error_msg=message))
        else:
            if self.goal is not None:
                self._end("aborted", 9010, outbox)
            self.goal = wanted
            self.sent.append(wanted)
            respond(act.SendGoalReply(accepted=True))

    def _end(self, status: Any, code: int, outbox: Outbox) -> None:
        assert self.goal is not None
        missed = (act.WaypointStatus(status="failed", index=1, error_code=207, error_msg="late"),)
        waypoints = {"follow_waypoints": missed, THROUGH: PASSED}
        ended = act.ActionResult(
            goal_id=self.goal.goal_id, action=self.goal.goal.action, status=status,
            error_code=code, error_msg="why" if code else "", start_time_s=1.0, end_time_s=3.5,
            num_retries=2,
            waypoints=waypoints.get(self.goal.goal.action, ()),
        )  # fmt: skip
        self.goal = None
        outbox.put(ACTION_RESULT, ended)


class Stack:
    """The node, and a client of its actions."""

    def __init__(
        self, endpoint: str, distro: str, checkpoint: act.NavigationCheckpoint | None = NOTHING_KEPT
    ) -> None:
        config = BusConfig.model_validate({"connect": endpoint, "distro": distro})
        self.keys: Keys = config.keys
        self.node = Navigation()
        self.node.checkpoint = checkpoint
        self.running = Running(self.node, open_session(config, timeout_s=5.0), config.keys)
        self.session = open_session(config, timeout_s=5.0)
        self.types = interfaces(distro)
        self.wake()

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]
        self.running.stop()

    def send(self, goal: dict[str, Any], kind: str = TO_POSE, name: str = "") -> tuple[bytes, Any]:
        goal_id = uuid.uuid4().bytes
        values = {"goal_id": ident(goal_id), "goal": goal}
        reply = self.call(name or "/navigate_to_pose", "send_goal", f"{kind}_SendGoal", values)
        return goal_id, reply

    def result(self, goal_id: bytes, kind: str = TO_POSE, name: str = "") -> Any:
        values = {"goal_id": ident(goal_id)}
        return self.call(name or "/navigate_to_pose", "get_result", f"{kind}_GetResult", values)

    def cancel(self, goal_id: bytes = bytes(16), name: str = "", until_s: int = 0) -> Any:
        values = {"goal_info": {"goal_id": ident(goal_id), "stamp": {"sec": until_s}}}
        kind = "action_msgs/srv/CancelGoal"
        return self.call(name or "/navigate_to_pose", "cancel_goal", kind, values)

    def call(self, name: str, part: str, kind: str, values: dict[str, Any]) -> Any:
        return call(self.session, f"{name}/_action/{part}", kind, values, self.keys)

    def heard(self, part: str, kind: str, name: str = "") -> list[Any]:
        """What arrives on a topic of the action from now on; of a latched one from its last on."""
        found: list[Any] = []
        name = f"{name or '/navigate_to_pose'}/_action/{part}"
        key = self.keys.typed(name, kind, self.types.hash_of(kind))
        self.subscriber = zenoh.ext.declare_advanced_subscriber(
            self.session, key,
            lambda sample: found.append(self.types.read(kind, sample.payload.to_bytes())),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            if part == "status" else None,
        )  # fmt: skip
        return found

    def wake(self) -> None:
        self.running.wake()


def ident(goal_id: bytes) -> dict[str, Any]:
    return {"uuid": np.frombuffer(goal_id, np.uint8)}


def pose(x_m: float, frame: str = "map") -> dict[str, Any]:
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x_m}}}


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s, f"never: {what}"
        time.sleep(0.01)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


@pytest.fixture(params=["jazzy", "kilted", "lyrical"])
def each(endpoint: str, request: pytest.FixtureRequest) -> Iterator[Stack]:
    stack = Stack(endpoint, request.param)
    yield stack
    stack.close()


@pytest.fixture
def stack(endpoint: str) -> Iterator[Stack]:
    made = Stack(endpoint, "jazzy")
    yield made
    made.close()


def test_a_goal_is_accepted_told_of_and_reached(each: Stack) -> None:
    told = each.heard("feedback", f"{TO_POSE}_FeedbackMessage")
    goal_id, reply = each.send({"pose": pose(2.0), "behavior_tree": "mine"})
    assert reply.accepted
    assert reply.stamp.sec == 12
    (sent,) = each.node.sent
    assert isinstance(sent.goal, act.NavigateToPose)
    assert (sent.goal_id, sent.goal.pose.x_m) == (goal_id.hex(), 2.0)
    assert sent.goal.behavior_tree == "mine"
    results: list[Any] = []
    waiting = threading.Thread(target=lambda: results.append(each.result(goal_id)))
    waiting.start()
    each.wake()
    wait_until(lambda: bool(told), "feedback")
    assert told[0].goal_id.uuid.tobytes() == goal_id
    feedback = told[0].feedback
    assert feedback.current_pose.pose.position.y == 4.0
    assert (feedback.navigation_time.sec, feedback.navigation_time.nanosec) == (2, 250_000_000)
    assert feedback.estimated_time_remaining.sec == 10**9
    assert (feedback.number_of_recoveries, feedback.distance_remaining) == (2, 1.5)
    if each.keys.distro == "lyrical":
        assert (feedback.position_tracking_error, feedback.heading_tracking_error) == (-0.125, 0.5)
    assert not results
    each.node.finishes = True
    each.wake()
    waiting.join(DEADLINE_S)
    (result,) = results
    assert (result.status, result.result.error_code) == (SUCCEEDED, 0)
    # It can be asked for again.
    assert each.result(goal_id).status == SUCCEEDED


def test_the_status_of_goals_is_latched(stack: Stack) -> None:
    goal_id, _ = stack.send({"pose": pose(2.0)})
    heard = stack.heard("status", "action_msgs/msg/GoalStatusArray")
    wait_until(lambda: bool(heard), "a status")
    (status,) = heard[-1].status_list
    assert (status.status, status.goal_info.goal_id.uuid.tobytes()) == (EXECUTING, goal_id)
    stack.cancel()
    wait_until(lambda: heard[-1].status_list[0].status == CANCELED, "that it is canceled")
    assert CANCELING in [one.status_list[0].status for one in heard]


@pytest.mark.parametrize("by_id", [True, False])
def test_a_goal_is_cancelled(stack: Stack, by_id: bool) -> None:
    goal_id, _ = stack.send({"pose": pose(2.0)})
    reply = stack.cancel(goal_id if by_id else bytes(16))
    assert reply.return_code == 0
    assert [one.goal_id.uuid.tobytes() for one in reply.goals_canceling] == [goal_id]
    result = stack.result(goal_id)
    assert (result.status, result.result.error_code) == (CANCELED, 9012)
    assert stack.cancel(goal_id).return_code == 3
    assert stack.cancel(uuid.uuid4().bytes).return_code == 2
    assert not stack.cancel().goals_canceling


@pytest.mark.parametrize("goal_id", ["", "cli-1", "ab" * 16])
def test_a_goal_that_came_by_another_way_is_cancelled_with_all(stack: Stack, goal_id: str) -> None:
    """As on /goal_pose, without an id, or by a tool."""
    here = doc.Planar(x_m=1.0, y_m=0.0, yaw_rad=0.0)
    goal = act.NavigateToPose(pose=here)
    stack.node.goal = act.SendGoal.model_construct(goal_id=goal_id, goal=goal)
    for other in (stack.cancel(name="/spin"), stack.cancel(until_s=11)):
        assert (other.return_code, other.goals_canceling) == (0, [])
    assert stack.node.goal is not None
    reply = stack.cancel(until_s=12)
    (info,) = reply.goals_canceling
    is_id = len(goal_id) == 32
    assert info.goal_id.uuid.tobytes() == (bytes.fromhex(goal_id) if is_id else bytes(16))
    assert (reply.return_code, info.stamp.sec) == (0, 12)
    assert stack.node.goal is None


def test_a_goal_goes_on_in_another_process(endpoint: str) -> None:
    """Who asks for its result before that is known waits for it."""
    goal_id, other_id = uuid.uuid4().bytes, uuid.uuid4().bytes
    kind, name = "nav2_msgs/action/NavigateThroughPoses", "/navigate_through_poses"
    poses = tuple(doc.Planar(x_m=x_m, y_m=0.0, yaw_rad=0.0) for x_m in (1.0, 2.0))
    goal = act.NavigateThroughPoses(poses=poses)
    stack = Stack(endpoint, "kilted", checkpoint=None)
    results: dict[bytes, Any] = {}

    def wait(asked: bytes) -> None:
        results[asked] = stack.result(asked, kind, name)

    waiting = [threading.Thread(target=wait, args=(one,)) for one in (goal_id, other_id)]
    for one in waiting:
        one.start()
    stack.node.goal = act.SendGoal(goal_id=goal_id.hex(), goal=goal)
    stack.node.checkpoint = act.NavigationCheckpoint(
        world_hash="", epoch=1, goal=goal, goal_id=goal_id.hex(), start_ns=3_000_000_000
    )
    stack.wake()
    told = stack.heard("status", "action_msgs/msg/GoalStatusArray", name)
    wait_until(lambda: bool(told), "a status")
    (status,) = told[-1].status_list
    assert (status.status, status.goal_info.goal_id.uuid.tobytes()) == (EXECUTING, goal_id)
    assert status.goal_info.stamp.sec == 3
    waiting[1].join(DEADLINE_S)
    unknown = results.pop(other_id)
    assert (unknown.status, unknown.result.error_code) == (UNKNOWN, 2)
    assert not results
    assert len(stack.cancel(goal_id, name).goals_canceling) == 1
    waiting[0].join(DEADLINE_S)
    result = results[goal_id]
    assert (result.status, result.result.error_code) == (CANCELED, 9012)
    reached = [one.waypoint_pose.pose.position.x for one in result.result.waypoint_statuses]
    assert reached == [1.0, 2.0]
    assert stack.cancel(goal_id, name).return_code == 3
    stack.close()


def test_a_goal_that_cannot_be_reached_is_aborted_with_the_code_of_nav2(stack: Stack) -> None:
    goal_id, reply = stack.send({"pose": pose(500.0)})
    assert reply.accepted
    result = stack.result(goal_id)
    assert (result.status, result.result.error_code) == (ABORTED, OUTSIDE)
    assert result.result.error_msg == "goal outside the map"


def test_a_goal_in_another_frame_is_aborted(stack: Stack) -> None:
    goal_id, reply = stack.send({"pose": pose(1.0, "odom")})
    assert reply.accepted
    result = stack.result(goal_id)
    assert (result.status, result.result.error_code) == (ABORTED, 9002)
    assert "must be 'map'" in result.result.error_msg
    assert not stack.node.sent


def test_a_goal_before_navigation_is_active_is_rejected(stack: Stack) -> None:
    stack.node.active = False
    goal_id, reply = stack.send({"pose": pose(1.0)})
    assert not reply.accepted
    assert stack.result(goal_id).status == UNKNOWN


def test_a_newer_goal_preempts_and_an_id_is_taken_once(stack: Stack) -> None:
    first, _ = stack.send({"pose": pose(1.0)})
    second, _ = stack.send({"pose": pose(2.0)})
    assert stack.result(first).status == ABORTED
    values = {"goal_id": ident(second), "goal": {"pose": pose(3.0)}}
    reply = stack.call("/navigate_to_pose", "send_goal", f"{TO_POSE}_SendGoal", values)
    assert not reply.accepted
    assert len(stack.node.sent) == 2


def test_only_the_newest_results_are_kept(stack: Stack) -> None:
    ids = [stack.send({"pose": pose(500.0)})[0] for _ in range(MAX_ENDED + 3)]
    known = [stack.result(goal_id).status for goal_id in ids]
    assert known == [UNKNOWN] * 3 + [ABORTED] * MAX_ENDED


def test_what_is_no_goal_is_refused_and_counted(stack: Stack) -> None:
    with pytest.raises(RefusedError, match="not finite"):
        stack.send({"pose": pose(float("nan"))})
    rejected = stack.running.inbox.counts["/navigate_to_pose"].rejected
    assert rejected == {"not finite": 1}


def test_missed_waypoints_are_those_of_the_distribution(each: Stack) -> None:
    kind, name = "nav2_msgs/action/FollowWaypoints", "/follow_waypoints"
    goal = {"poses": [pose(1.0), pose(2.0)], "number_of_loops": 1}
    goal_id, _ = each.send(goal, kind, name)
    assert isinstance(each.node.sent[0].goal, act.FollowWaypoints)
    assert each.node.sent[0].goal.number_of_loops == 1
    each.node.finishes = True
    each.wake()
    (missed,) = each.result(goal_id, kind, name).result.missed_waypoints
    if each.keys.distro == "jazzy":
        assert (missed.index, missed.goal.pose.position.x) == (1, 2.0)
    else:
        assert (missed.waypoint_index, missed.waypoint_pose.pose.position.x) == (1, 2.0)
        assert (missed.waypoint_status, missed.error_msg) == (3, "late")
    assert missed.error_code == 207


@pytest.mark.parametrize(
    ("name", "kind", "goal", "wanted"),
    [
        ("/spin", "Spin", {"target_yaw": 1.5}, act.Spin(target_yaw_rad=1.5, time_allowance_s=0.0)),
        (
            "/backup", "BackUp",
            {"target": {"x": -0.25}, "speed": 0.125, "time_allowance": {"sec": 4}},
            act.BackUp(distance_m=0.25, speed_m_s=0.125, time_allowance_s=4.0),
        ),
        (
            "/drive_on_heading", "DriveOnHeading", {"target": {"x": 0.25}, "speed": 0.125},
            act.DriveOnHeading(distance_m=0.25, speed_m_s=0.125, time_allowance_s=0.0),
        ),
        (
            "/assisted_teleop", "AssistedTeleop", {"time_allowance": {"sec": 7}},
            act.AssistedTeleop(time_allowance_s=7.0),
        ),
        ("/wait", "Wait", {"time": {"sec": 1, "nanosec": 500_000_000}}, act.Wait(duration_s=1.5)),
    ],
)  # fmt: skip
def test_behaviors_run(stack: Stack, name: str, kind: str, goal: Any, wanted: Any) -> None:
    kind = f"nav2_msgs/action/{kind}"
    goal_id, reply = stack.send(goal, kind, name)
    assert reply.accepted
    assert stack.node.sent[0].goal == wanted
    stack.node.finishes = True
    stack.wake()
    result = stack.result(goal_id, kind, name)
    assert result.status == SUCCEEDED
    elapsed = result.result.total_elapsed_time
    assert (elapsed.sec, elapsed.nanosec) == (2, 500_000_000)


BY_POSE = {"dock_id": "left", "dock_pose": pose(2.0), "max_staging_time": 12.5}


@pytest.mark.parametrize(
    ("goal", "wanted"),
    [
        (
            {**BY_POSE, "use_dock_id": True, "navigate_to_staging_pose": True},
            act.DockRobot(dock_id="left", max_staging_time_s=12.5),
        ),
        (
            BY_POSE,
            act.DockRobot(
                dock_pose=doc.Planar(x_m=2.0, y_m=0.0, yaw_rad=0.0),
                navigate_to_staging_pose=False, max_staging_time_s=12.5,
            ),
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("succeeds", [True, False])
def test_the_robot_docks(stack: Stack, goal: Any, wanted: Any, succeeds: bool) -> None:
    kind, name = "nav2_msgs/action/DockRobot", "/dock_robot"
    told = stack.heard("feedback", f"{kind}_FeedbackMessage", name)
    goal_id, _ = stack.send(goal, kind, name)
    assert stack.node.sent[0].goal == wanted
    stack.wake()
    wait_until(lambda: bool(told), "feedback")
    feedback = told[0].feedback
    assert (feedback.state, feedback.num_retries, feedback.docking_time.sec) == (3, 1, 2)
    stack.node.finishes = succeeds
    if succeeds:
        stack.wake()
    else:
        stack.send({"max_undocking_time": 4.0}, "nav2_msgs/action/UndockRobot", "/undock_robot")
    result = stack.result(goal_id, kind, name)
    assert result.status == (SUCCEEDED if succeeds else ABORTED)
    assert (result.result.success, result.result.num_retries) == (succeeds, 2)


def test_the_robot_undocks(stack: Stack) -> None:
    kind, name = "nav2_msgs/action/UndockRobot", "/undock_robot"
    goal_id, _ = stack.send({"max_undocking_time": 4.0}, kind, name)
    assert stack.node.sent[0].goal == act.UndockRobot(max_undocking_time_s=4.0)
    stack.node.finishes = True
    stack.wake()
    result = stack.result(goal_id, kind, name)
    assert (result.status, result.result.success) == (SUCCEEDED, True)


def test_a_robot_drives_straight_only(stack: Stack) -> None:
    kind = "nav2_msgs/action/BackUp"
    goal_id, _ = stack.send({"target": {"x": 0.1, "y": 0.1}, "speed": 0.1}, kind, "/backup")
    result = stack.result(goal_id, kind, "/backup")
    assert (result.status, result.result.error_code) == (ABORTED, 713)


@pytest.mark.parametrize(("x_m", "status", "code"), [(2.0, SUCCEEDED, 0), (500.0, ABORTED, 204)])
def test_a_path_is_computed(stack: Stack, x_m: float, status: int, code: int) -> None:
    kind, name = "nav2_msgs/action/ComputePathToPose", "/compute_path_to_pose"
    goal_id, reply = stack.send({"goal": pose(x_m)}, kind, name)
    assert reply.accepted
    result = stack.result(goal_id, kind, name)
    assert (result.status, result.result.error_code) == (status, code)
    assert [one.pose.position.x for one in result.result.path.poses] == [2.0] * (not code)
    took = result.result.planning_time
    assert 0 < took.sec * 10**9 + took.nanosec < DEADLINE_S * 1e9


def test_a_path_is_computed_through_the_points_on_its_way(endpoint: str) -> None:
    stack = Stack(endpoint, "lyrical")
    kind, name = "nav2_msgs/action/ComputePathToPose", "/compute_path_to_pose"
    goal = {"goal": pose(3.0), "viapoints": [pose(1.0), pose(2.0)]}
    goal_id, _ = stack.send(goal, kind, name)
    path = stack.result(goal_id, kind, name).result.path
    stack.close()
    assert [one.pose.position.x for one in path.poses] == [1.0, 2.0, 3.0]


def test_poses_to_drive_through_have_the_form_of_the_distribution(each: Stack) -> None:
    poses = [pose(1.0), pose(2.0)]
    goal = {"poses": poses if each.keys.distro == "jazzy" else {"goals": poses}}
    kind, name = "nav2_msgs/action/NavigateThroughPoses", "/navigate_through_poses"
    told = each.heard("feedback", f"{kind}_FeedbackMessage", name)
    goal_id, reply = each.send(goal, kind, name)
    assert reply.accepted
    each.wake()
    wait_until(lambda: bool(told), "feedback")
    each.node.finishes = True
    each.wake()
    result = each.result(goal_id, kind, name).result
    if each.keys.distro != "jazzy":
        for statuses in (told[0].feedback.waypoint_statuses, result.waypoint_statuses):
            assert [one.waypoint_status for one in statuses] == [1, 0]
            assert [one.waypoint_pose.pose.position.x for one in statuses] == [1.0, 2.0]
    sent = each.node.sent[0].goal
    assert isinstance(sent, act.NavigateThroughPoses)
    assert [one.x_m for one in sent.poses] == [1.0, 2.0]


def path_of(frame_id: str = "map", of_poses: str = "") -> dict[str, Any]:
    poses = [pose(x_m) for x_m in (1.0, 2.0)]
    for one in poses:
        one["header"] = {"frame_id": of_poses}
    return {"header": {"frame_id": frame_id}, "poses": poses}


def test_a_path_is_followed(each: Stack) -> None:
    kind, name = "nav2_msgs/action/FollowPath", "/follow_path"
    told = each.heard("feedback", f"{kind}_FeedbackMessage", name)
    by_handler = {"path_handler_id": "PathHandler"} if each.keys.distro == "lyrical" else {}
    goal = {"path": path_of(), "controller_id": "FollowPath", **by_handler}
    goal_id, reply = each.send(goal, kind, name)
    assert reply.accepted
    poses = tuple(doc.Planar(x_m=x_m, y_m=0.0, yaw_rad=0.0) for x_m in (1.0, 2.0))
    wanted = act.FollowPath(path=poses, controller_id="FollowPath", **by_handler)
    assert each.node.sent[0].goal == wanted
    each.wake()
    wait_until(lambda: bool(told), "feedback")
    feedback = told[0].feedback
    if by_handler:
        tracking = feedback.tracking_feedback
        assert (tracking.position_tracking_error, tracking.heading_tracking_error) == (-0.125, 0.5)
        assert (tracking.current_path_index, tracking.speed) == (7, 0.25)
        assert (tracking.distance_to_goal, tracking.remaining_path_length) == (0.75, 1.5)
        assert tracking.robot_pose.pose.position.y == 4.0
        assert tracking.header.frame_id == "map"
    else:
        assert (feedback.distance_to_goal, feedback.speed) == (1.5, 0.25)
    each.node.finishes = True
    each.wake()
    assert each.result(goal_id, kind, name).status == SUCCEEDED


@pytest.mark.parametrize(("frame_id", "of_poses"), [("odom", ""), ("map", "odom")])
def test_a_path_in_another_frame_is_refused(stack: Stack, frame_id: str, of_poses: str) -> None:
    kind, name = "nav2_msgs/action/FollowPath", "/follow_path"
    goal_id, _ = stack.send({"path": path_of(frame_id, of_poses)}, kind, name)
    result = stack.result(goal_id, kind, name)
    assert (result.status, result.result.error_code) == (ABORTED, 102)
    assert "'odom': must be 'map'" in result.result.error_msg
