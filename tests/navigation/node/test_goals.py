"""Goals that the navigation node is sent: refused, preempted, sent twice, cancelled."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    SE2,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    NavigationResult,
    Planar,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    CMD_VEL,
    GOAL_POSE,
    INPUT_AT_WAYPOINT,
    LOCALIZATION_STATUS,
    NAVIGATION_STATUS,
    PAUSE_GOAL,
    PHOTO,
    PHOTO_REQUEST,
    SEND_GOAL,
    SMOOTH_PATH,
)
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.messages import planar_document
from tests.navigation.driving import (
    LOCATIONS,
    START,
    NodeDriver,
    asked,
    cancelled,
    ready,
)


def reply(driver: NodeDriver, goal: SE2, frame_id: str = "map") -> NavigationResult:
    """The answer within one period."""
    driver.goal(goal, frame_id)
    stamp_ns = driver.now_ns
    driver.step()
    (result,) = driver.results()
    assert result.goal_stamp_ns == stamp_ns
    assert "\n" not in result.error_msg
    return result


@pytest.mark.parametrize(
    ("goal", "code", "says"),
    [
        (SE2(99.0, 0.0, 0.0), 204, "(99.00, 0.00)"),
        (SE2(1e6, 0.0, 0.0), 204, "1e+06"),
        (SE2(0.4, 0.55, 0.0), 206, "(0.40, 0.55) is inside an obstacle"),
        (SE2(0.4, 0.4, 0.0), 206, "0."),
        (SE2(5.0, -2.5, 0.0), 208, "unknown"),
    ],
)
def test_a_bad_goal_is_answered_at_once_and_moves_nothing(goal: SE2, code: int, says: str) -> None:
    driver = ready()
    result = reply(driver, goal)
    assert result.error_code == code
    assert says in result.error_msg
    driver.run(1.0)
    assert driver.robot.map_from_base == START
    assert driver.of(CMD_VEL) == []


def test_a_goal_in_another_frame_is_refused_by_its_name() -> None:
    result = reply(ready(), LOCATIONS["location1"], "odom")
    assert result.error_code == ErrorCode.TF_ERROR
    assert "'odom'" in result.error_msg
    assert "'map'" in result.error_msg


def test_a_goal_without_a_frame_is_in_the_map() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"], "")
    driver.run(0.2)
    assert driver.results() == []
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"


def test_a_goal_that_is_not_finite_is_counted_and_moves_nothing() -> None:
    driver = ready()
    driver.goal(SE2(math.nan, 0.0, 0.0))
    driver.run(0.5)
    assert driver.rejected(GOAL_POSE)["not finite"] == 1
    assert driver.of(CMD_VEL) == []


def test_a_bad_goal_does_not_disturb_the_one_being_driven_to() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.goal(SE2(99.0, 0.0, 0.0))
    driver.run(0.1)
    assert [result.error_code for result in driver.results()] == [204]
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"
    driver.run(6.0)
    assert [result.error_code for result in driver.results()] == [204, 0]


def test_before_navigation_is_active_a_goal_is_refused_with_what_it_waits_for() -> None:
    driver = NodeDriver()
    result = reply(driver, LOCATIONS["location1"])
    assert result.error_code == ErrorCode.GOAL_REJECTED
    assert "the world" in result.error_msg


def test_of_thousands_of_goals_at_once_the_newest_is_driven_to_and_each_is_answered() -> None:
    driver = ready()
    for number in range(900):
        driver.goal(LOCATIONS["location1" if number % 2 else "location3"])
    begin_s = time.process_time()
    driver.step()
    # A way to each of them would take seconds.
    assert time.process_time() - begin_s < 0.5
    assert [result.error_code for result in driver.results()] == [ErrorCode.PREEMPTED] * 899
    driver.run(0.2)
    goal = driver.of(NAVIGATION_STATUS)[-1].goal
    assert goal is not None
    assert goal.se2() == LOCATIONS["location1"]


def test_the_newest_goal_that_can_be_reached_is_taken() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.goal(LOCATIONS["location1"])
    driver.goal(SE2(99.0, 0.0, 0.0))
    driver.step()
    assert [result.error_code for result in driver.results()] == [ErrorCode.PREEMPTED, 204]


def test_a_new_goal_preempts() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    first_ns = driver.now_ns
    driver.run(2.0)
    driver.goal(LOCATIONS["location3"])
    driver.run(0.1)
    (result,) = driver.results()
    assert (result.goal_stamp_ns, result.error_code) == (first_ns, ErrorCode.PREEMPTED)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is not None


def test_a_paused_task_is_told_as_held() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    for pause, states in ((True, {"held"}), (False, {"planning", "controlling"})):
        driver.inbox.ask(PAUSE_GOAL, act.PauseGoal(pause=pause), lambda _: None)
        driver.run(1.0)
        assert driver.of(NAVIGATION_STATUS)[-1].state in states


def test_a_goal_of_a_lost_robot_is_taken_if_moving_finds_its_pose() -> None:
    for wants_motion in (True, False):
        driver = ready()
        said = driver.of(LOCALIZATION_STATUS)[-1]
        lost = said.model_copy(update={"state": "lost", "wants_motion": wants_motion})
        driver.deliver(LOCALIZATION_STATUS, lost)
        driver.goal(LOCATIONS["location1"])
        driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
        codes = [result.error_code for result in driver.results()]
        assert codes == ([] if wants_motion else [ErrorCode.GOAL_REJECTED])
        drive = driver.node._drive
        assert drive is not None
        assert (drive.navigator.request is not None) == wants_motion


def test_a_goal_is_accepted_from_a_pose_in_a_wall_which_may_be_wrong() -> None:
    drive = ready().node._drive
    assert drive is not None
    in_a_wall, free = SE2(0.4, 0.55, 0.0), LOCATIONS["location1"]
    drive.robot.planner_server.check_goals(in_a_wall, [free])
    with pytest.raises(NavigationError, match="inside an obstacle"):
        drive.robot.planner_server.check_goals(START, [in_a_wall])


def test_a_goal_that_is_sent_twice_is_driven_once() -> None:
    driver = ready()
    goal = act.NavigateToPose(pose=planar_document(LOCATIONS["location1"]))
    send = act.SendGoal(goal_id="a", goal=goal)
    assert asked(driver, SEND_GOAL, send).accepted
    driver.run(1.0)
    assert asked(driver, SEND_GOAL, send).accepted
    other = asked(driver, SEND_GOAL, act.SendGoal(goal_id="a", goal=act.Spin(target_yaw_rad=1.0)))
    assert other.error_msg == "goal_id: 'a': must be unique: in use"
    driver.run(0.2)
    assert driver.of(ACTION_RESULT) == []
    assert asked(driver, SEND_GOAL, act.SendGoal(goal_id="b", goal=goal)).accepted
    driver.run(0.2)
    (result,) = driver.of(ACTION_RESULT)
    # As in Nav2: who sent it asked for no cancellation.
    preempted = ("a", "aborted", ErrorCode.PREEMPTED)
    assert (result.goal_id, result.status, result.error_code) == preempted
    late = asked(driver, SEND_GOAL, send)
    assert late.error_msg == "goal_id: 'a': must be unique: this goal has ended"
    driver.run(0.2)
    assert len(driver.of(ACTION_RESULT)) == 1


def test_at_a_waypoint_a_picture_and_an_input_are_waited_for() -> None:
    driver = ready()
    at = driver.robot.map_from_base
    task = act.WaypointTask(wait_s=0.0, photo=True, input_timeout_s=30.0)
    here = Planar(x_m=at.x_m, y_m=at.y_m, yaw_rad=at.yaw_rad)
    goal = act.FollowWaypoints(poses=(here,), tasks=(task,))
    assert asked(driver, INPUT_AT_WAYPOINT, act.Empty()).error
    assert asked(driver, SEND_GOAL, act.SendGoal(goal_id="a", goal=goal)).accepted
    driver.run(1.0)
    (request,) = driver.of(PHOTO_REQUEST)
    assert request.waypoint == 0
    picture = np.zeros(9, np.uint8)

    def photo(stamp_ns: int) -> msg.CompressedImage:
        return msg.CompressedImage(msg.header(stamp_ns, "camera"), "png", picture)

    # One of before the request is another's.
    driver.deliver(PHOTO, photo(request.stamp_ns - 1))
    driver.run(0.2)
    assert asked(driver, INPUT_AT_WAYPOINT, act.Empty()).error == ""
    driver.run(0.2)
    assert driver.of(ACTION_RESULT) == []
    driver.deliver(PHOTO, photo(request.stamp_ns))
    driver.run(0.2)
    (result,) = driver.of(ACTION_RESULT)
    assert (result.status, result.waypoints) == ("succeeded", ())


def test_a_path_with_a_corner_is_smoothed_or_refused() -> None:
    driver = ready()
    corner = ((0.0, 0.0), (0.3, 0.0), (0.3, -0.3))
    path = tuple(Planar(x_m=x, y_m=y, yaw_rad=0.0) for x, y in corner)
    reply = asked(driver, SMOOTH_PATH, act.SmoothPath(path=path, check_for_collisions=True))
    assert (reply.error_code, reply.error_msg) == (0, "")
    points = np.array([(pose.x_m, pose.y_m) for pose in reply.path])
    assert points[0] == pytest.approx(corner[0], abs=0.01)
    assert points[-1] == pytest.approx(corner[-1], abs=0.01)
    turns = np.diff(np.unwrap([pose.yaw_rad for pose in reply.path[:-1]]))
    assert np.abs(turns).max() < 0.6
    for path_, words, code in (
        (path[:1], {}, ErrorCode.SMOOTHER_INVALID_PATH),
        (path, {"smoother_id": "nope"}, ErrorCode.INVALID_SMOOTHER),
        ((path[0], Planar(x_m=0.0, y_m=99.0, yaw_rad=0.0)), {}, ErrorCode.FAILED_TO_SMOOTH_PATH),
        (
            (path[0], Planar(x_m=0.0, y_m=2.0, yaw_rad=0.0)),
            {"check_for_collisions": True},
            ErrorCode.SMOOTHED_PATH_IN_COLLISION,
        ),
    ):
        reply = asked(driver, SMOOTH_PATH, act.SmoothPath(path=path_, **words))
        assert (reply.error_code, reply.path) == (code, ())
        assert "\n" not in reply.error_msg


def test_a_cancelled_goal_ends_and_the_robot_stops() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    sent_ns = driver.now_ns
    driver.run(2.0)
    commands = len(driver.of(CMD_VEL))
    other = cancelled(driver, sent_ns + 1)
    assert (other.return_code, other.goal) == (2, None)
    assert str(sent_ns + 1) in other.error
    # It was no control period, and the robot drives on.
    assert len(driver.of(CMD_VEL)) == commands
    twist = driver.of(CMD_VEL)[-1].twist
    assert abs(twist.linear.x) + abs(twist.angular.z) > 0.1
    answer = cancelled(driver, sent_ns)
    assert (answer.error, answer.return_code, answer.goal_stamp_ns) == ("", 0, sent_ns)
    twist = driver.of(CMD_VEL)[-1].twist
    assert (twist.linear.x, twist.angular.z) == (0.0, 0.0)
    (result,) = driver.results()
    assert (result.error_code, result.goal_stamp_ns) == (ErrorCode.CANCELED, sent_ns)
    assert driver.of(NAVIGATION_STATUS)[-1].state == "idle"
    driver.run(1.0)
    assert driver.robot.velocity.linear_m_s == 0.0
    assert "no active goal" in cancelled(driver).error


def test_after_a_cancelled_goal_another_is_driven_to() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(1.0)
    assert cancelled(driver).error == ""
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0
