from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.common.messages.documents import KeepoutZone
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import (
    FollowPath,
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    SingleAction,
    TaskStatus,
    WaypointWork,
    assisted_teleop,
    back_up,
    dock_robot,
    drive_on_heading,
    spin,
    wait,
)
from mazebot.navigation.behavior.bt_navigator import (
    BtNavigatorParams,
    NavigatorParams,
    WaypointFollowerParams,
)
from mazebot.navigation.behavior.context import Dock, MarkerPose
from mazebot.navigation.behavior.docking.docking import DockingParams, DockState
from mazebot.navigation.behavior.engine.tree import NodeStatus
from mazebot.navigation.behavior.nodes.nodes_goals import WaypointState
from mazebot.navigation.behavior.nodes.path_parts import pose_on
from mazebot.navigation.behavior.waypoints import WaitAtWaypoint
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.costmap.zones import zones_of
from mazebot.navigation.errors import NavigationError
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.simulated_robot import Box, Drive, SimulatedRobot
from tests.navigation.driving import LOCATIONS, START, Unicycle
from tests.navigation.house_tour import house

NEAR, FAR = LOCATIONS["location1"], LOCATIONS["location3"]
INSIDE_A_WALL = SE2(0.4, 0.55, 0.0)
DOOR: Box = (1.33, -0.87, 0.85)
"""Fills the corridor on the only way to FAR."""
AWAY: Box = (-50.0, 0.0, 0.1)


def test_navigate_to_pose_arrives_and_stands_without_a_recovery() -> None:
    drive = Drive()
    result = drive.until_done(NavigateToPose(NEAR))
    assert (result.status, result.error_code) == (TaskStatus.SUCCEEDED, 0)
    assert result.number_of_recoveries == 0
    robot = drive.robot.robot
    assert robot.map_from_base.distance_m(NEAR) < 0.06
    assert abs(wrap_angle(robot.map_from_base.yaw_rad - NEAR.yaw_rad)) < 0.08
    assert drive.commands[-1] == STOP
    assert drive.navigator.request is None


def test_feedback_counts_down() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR))
    seen = []
    while not drive.results:
        drive.step()
        feedback = drive.navigator.feedback(drive.now_ns)
        if feedback is not None:
            seen.append(feedback)
    distances = [one.distance_remaining_m or 0.0 for one in seen]
    assert distances[0] > 2.0
    assert distances[-1] < 0.1
    assert seen[20].navigation_time_s == pytest.approx(1.05)
    assert seen[40].current_pose == drive.poses[41]
    left_s = (drive.results[0].end_ns - 3_000_000_000) * 1e-9
    assert seen[59].estimated_time_remaining_s == pytest.approx(left_s, rel=0.5)


@pytest.mark.parametrize(
    ("goal", "code"),
    [(INSIDE_A_WALL, ErrorCode.GOAL_OCCUPIED), (SE2(90.0, 0.0, 0.0), ErrorCode.GOAL_OUTSIDE_MAP)],
)
def test_a_goal_that_cannot_be_is_refused_at_once_and_nothing_moves(
    goal: SE2, code: ErrorCode
) -> None:
    drive = Drive()
    with pytest.raises(NavigationError) as caught:
        drive.navigator.start(0, NavigateToPose(goal))
    assert caught.value.code is code
    drive.run(1.0)
    assert set(drive.commands) == {STOP}


def test_a_refused_goal_leaves_the_one_before() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR))
    drive.run(1.0)
    with pytest.raises(NavigationError):
        drive.navigator.start(drive.now_ns, NavigateToPose(INSIDE_A_WALL))
    assert drive.finish().error_code == 0


def test_a_new_goal_replaces_the_old_one_without_a_stop() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(FAR))
    drive.run(4.0)
    speed = drive.robot.robot.velocity.linear_m_s
    assert speed > 0.3
    other = LOCATIONS["location4"]
    old = drive.navigator.start(drive.now_ns, NavigateToPose(other))
    assert old is not None
    assert (old.error_code, old.status) == (ErrorCode.PREEMPTED, TaskStatus.FAILED)
    drive.step()
    assert drive.commands[-1].linear_m_s > speed - 0.1
    result = drive.finish()
    assert result.error_code == 0
    assert result.start_ns == 4_000_000_000
    assert drive.robot.robot.map_from_base.distance_m(other) < 0.06


def test_another_action_preempts_with_a_stop() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(FAR))
    drive.run(4.0)
    old = drive.navigator.start(drive.now_ns, wait(1.0))
    assert old is not None
    drive.step()
    assert drive.commands[-1] == STOP
    assert drive.finish(2.0).error_code == 0


def test_cancel_stops_the_robot() -> None:
    drive = Drive()
    assert drive.navigator.cancel(0) is None
    drive.navigator.start(0, NavigateToPose(FAR))
    drive.run(3.0)
    result = drive.navigator.cancel(drive.now_ns)
    assert result is not None
    assert (result.error_code, result.status) == (ErrorCode.CANCELED, TaskStatus.CANCELED)
    drive.run(1.0)
    assert drive.robot.robot.velocity == STOP
    assert drive.navigator.feedback(drive.now_ns) is None


def test_a_pause_stands_and_does_not_count() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR))
    drive.run(3.0)
    drive.navigator.pause()
    drive.run(20.0)
    assert set(drive.commands[-390:]) == {STOP}
    assert drive.navigator.hold == "paused"
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    assert feedback.navigation_time_s == pytest.approx(3.0, abs=0.06)
    drive.navigator.resume()
    result = drive.finish()
    # Neither the progress checker nor a recovery has noticed the pause.
    assert (result.error_code, result.number_of_recoveries) == (0, 0)


def test_a_wait_that_is_paused_lasts_longer_by_the_pause() -> None:
    drive = Drive()
    drive.navigator.start(0, wait(2.0))
    drive.run(1.0)
    drive.navigator.pause()
    drive.run(5.0)
    drive.navigator.resume()
    assert drive.finish().end_ns * 1e-9 == pytest.approx(7.0, abs=0.1)


def test_a_lost_robot_stands_until_it_has_found_itself_and_goes_on() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR))
    drive.run(3.0)
    drive.robot.localized = False
    drive.run(10.0)
    assert set(drive.commands[-200:]) == {STOP}
    assert drive.navigator.hold == "lost"
    drive.robot.localized = True
    assert drive.finish().error_code == 0


def test_a_robot_that_stays_lost_gives_up() -> None:
    drive = Drive(params=NavigatorParams(BtNavigatorParams(localization_tolerance=5.0)))
    drive.navigator.start(0, NavigateToPose(NEAR))
    drive.robot.localized = False
    result = drive.finish(6.0)
    assert result.error_code == ErrorCode.TF_ERROR
    assert "lost for 5 s" in result.error_msg


def test_a_door_closed_for_15_s_is_waited_for_and_passed() -> None:
    drive = Drive()

    def open_at_15_s(now_ns: int) -> None:
        drive.robot.boxes = [DOOR if now_ns < 15_000_000_000 else AWAY]

    drive.each_period = open_at_15_s
    result = drive.until_done(NavigateToPose(FAR))
    assert result.error_code == 0
    assert result.number_of_recoveries <= 1
    assert result.end_ns < 30_000_000_000


def test_a_goal_made_unreachable_on_the_way_ends_within_20_s_and_says_where() -> None:
    drive = Drive()
    closed_ns = 2_000_000_000

    def close(now_ns: int) -> None:
        drive.robot.boxes = [DOOR if now_ns >= closed_ns else AWAY]

    drive.each_period = close
    result = drive.until_done(NavigateToPose(FAR))
    assert result.error_code == ErrorCode.NO_VALID_PATH
    assert result.end_ns - closed_ns < 20_000_000_000
    assert "blocked at (0." in result.error_msg
    assert drive.nearest_m(DOOR) > 0.23
    # Nothing is gained by spinning before a closed door.
    assert max(abs(w) for v, w in drive.commands[120:]) < 0.1


def test_a_goal_that_something_stands_on_is_waited_for_without_a_spin() -> None:
    drive = Drive()

    def someone(now_ns: int) -> None:
        drive.robot.boxes = [(NEAR.x_m, NEAR.y_m, 0.2) if now_ns < 12_000_000_000 else AWAY]

    drive.each_period = someone
    result = drive.until_done(NavigateToPose(NEAR))
    assert result.error_code == 0
    drive = Drive(each_period=lambda _: None)
    drive.robot.boxes = [(NEAR.x_m, NEAR.y_m, 0.2)]
    result = drive.until_done(NavigateToPose(NEAR))
    assert result.error_code == ErrorCode.GOAL_OCCUPIED
    assert result.end_ns < 25_000_000_000


def test_a_stuck_robot_tries_every_recovery_then_gives_up_with_the_cause() -> None:
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=True)))
    result = drive.until_done(NavigateToPose(FAR))
    assert result.error_code == ErrorCode.FAILED_TO_MAKE_PROGRESS
    assert "at (0.00, 0.00)" in result.error_msg
    assert result.number_of_recoveries == 6
    assert result.end_ns < 45_000_000_000
    areas = [(request.costmap, request.area) for request in drive.robot.cleared]
    assert ("local", "entirely") in areas
    assert ("global", "entirely") in areas
    assert max(abs(w) for _, w in drive.commands) > 0.9
    assert min(v for v, _ in drive.commands) == pytest.approx(-0.15)


def test_a_robot_that_gets_loose_goes_on() -> None:
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=True)))

    def loosen(now_ns: int) -> None:
        drive.robot.robot.stuck = now_ns < 6_000_000_000

    drive.each_period = loosen
    result = drive.until_done(NavigateToPose(NEAR))
    assert result.error_code == 0
    assert 1 <= result.number_of_recoveries <= 3


def test_through_poses_passes_each_in_its_order() -> None:
    poses = (NEAR, LOCATIONS["location2"])
    drive = Drive()
    drive.navigator.start(0, NavigateThroughPoses(poses))
    remaining = []
    while not drive.results:
        drive.step()
        feedback = drive.navigator.feedback(drive.now_ns)
        if feedback is not None:
            remaining.append(feedback.number_of_poses_remaining)
    result = drive.results[0]
    assert result.error_code == 0
    assert min(pose.distance_m(NEAR) for pose in drive.poses) <= 0.5
    assert sorted(set(remaining)) == [1, 2]
    assert remaining == sorted(remaining, reverse=True)
    assert [one.waypoint_status for one in result.waypoint_statuses] == [
        WaypointState.COMPLETED,
        WaypointState.COMPLETED,
    ]
    # No stop at the first one.
    passed = min(range(len(drive.poses)), key=lambda i: drive.poses[i].distance_m(NEAR))
    assert drive.commands[passed] != STOP


def test_of_poses_in_dead_ends_each_is_driven_to_before_the_way_back() -> None:
    drive = Drive()
    poses = tuple(LOCATIONS[name] for name in ("location2", "location4", "location3", "location1"))
    drive.navigator.start(0, NavigateThroughPoses(poses))
    result = drive.finish(120.0)
    assert result.error_code == 0
    assert result.number_of_recoveries == 0
    assert all(min(at.distance_m(pose) for at in drive.poses) < 0.7 for pose in poses)


@pytest.mark.parametrize("ends", ["canceled", "stuck"])
def test_poses_that_were_not_passed_have_failed(ends: str) -> None:
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=ends == "stuck")))
    drive.navigator.start(0, NavigateThroughPoses((NEAR, FAR)))
    drive.run(2.0)
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    states = {one.waypoint_status for one in feedback.waypoint_statuses}
    assert states == {WaypointState.PENDING}
    result = drive.navigator.cancel(drive.now_ns) if ends == "canceled" else drive.finish()
    assert result is not None
    assert [one.waypoint_status for one in result.waypoint_statuses] == [WaypointState.FAILED] * 2


def test_the_robot_is_told_how_far_it_is_off_its_path_and_on_which_side() -> None:
    drive = Drive()
    path = drive.robot.compute_path(START, [NEAR], "")
    index = len(path.points_m) // 3
    beside = pose_on(path, index) @ SE2(0.0, -0.05, 0.2)
    drive.robot.robot.map_from_base = beside
    drive.navigator.start(0, FollowPath(path))
    drive.step()
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    assert feedback.position_tracking_error_m == pytest.approx(-0.05, abs=0.005)
    assert feedback.heading_tracking_error_rad == pytest.approx(-0.2, abs=0.05)
    assert feedback.current_path_index == pytest.approx(index, abs=1)
    drive.run(3.0)
    later = drive.navigator.feedback(drive.now_ns)
    assert later is not None
    assert later.current_path_index > index + 5
    at = pose_on(path, later.current_path_index)
    assert drive.robot.robot.map_from_base.distance_m(at) < 0.1
    assert drive.finish().error_code == 0


BOUNDED = """
<ReactiveSequence>
  <IsWithinPathTrackingBounds max_error_left="0.2" max_error_right="0.1"
    tracking_feedback="{tracking_feedback}"/>
  <FollowPath path="{path}" tracking_feedback="{tracking_feedback}"/>
</ReactiveSequence>
"""


@pytest.mark.parametrize(("y_m", "code"), [(0.15, 0), (-0.15, ErrorCode.NAVIGATOR_UNKNOWN)])
def test_a_robot_that_is_pushed_off_its_path_leaves_its_bounds(
    tmp_path: Path, y_m: float, code: int
) -> None:
    tree = tmp_path / "bounded.xml"
    tree.write_text(
        document(
            f'<Sequence><ComputePathToPose goal="{{goal}}" path="{{path}}"/>{BOUNDED}</Sequence>'
        )
    )
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR, str(tree)))
    drive.run(2.0)
    assert not drive.results
    aside = SE2(0.0, y_m, 0.0)
    drive.robot.robot.map_from_base = drive.robot.robot.map_from_base @ aside
    assert drive.finish().error_code == code


def test_through_no_poses_is_refused() -> None:
    with pytest.raises(NavigationError) as caught:
        Drive().navigator.start(0, NavigateThroughPoses(()))
    assert caught.value.code is ErrorCode.NO_VIAPOINTS_GIVEN


BESIDE = (SE2(0.0, 0.0, 1.0), SE2(0.0, 0.0, -1.0))
"""Two poses that the robot reaches by turning."""


def test_waypoints_are_visited_in_rounds_with_a_photo_at_each() -> None:
    drive = Drive()
    photos = []

    def photographer() -> None:
        exchange = drive.navigator.exchange
        if exchange.photo_wanted_at is not None:
            photos.append(exchange.photo_wanted_at)
            exchange.photo_wanted_at = None
            exchange.photos += 1

    request = FollowWaypoints(BESIDE, 1, 1, works=(WaypointWork(photo=True),) * 2)
    result = drive.until_done(request, each=photographer)
    assert result.error_code == 0
    assert result.waypoint_statuses == ()
    assert photos == [1, 0, 1]


def test_the_robot_stands_at_a_waypoint_for_its_pause() -> None:
    times = {}
    for pause_s in (0.0, 3.0):
        drive = Drive(waypoint_task=WaitAtWaypoint(pause_s))
        times[pause_s] = drive.until_done(FollowWaypoints(BESIDE)).end_ns * 1e-9
    assert times[3.0] - times[0.0] == pytest.approx(6.0, abs=0.2)


def test_a_waypoint_waits_for_an_input_of_its_own() -> None:
    drive = Drive()
    # One that comes on the way there does not count.
    given_s = [0.3, 8.0]

    def person() -> None:
        if given_s and drive.now_s > given_s[0]:
            given_s.pop(0)
            drive.navigator.exchange.inputs += 1

    request = FollowWaypoints(BESIDE[:1], works=(WaypointWork(0.0, input_timeout_s=10.0),))
    assert drive.until_done(request, each=person).end_ns > 8_000_000_000


@pytest.mark.parametrize("stop", [False, True])
def test_a_missed_waypoint_is_told_and_the_next_one_driven_to(stop: bool) -> None:
    drive = Drive(
        params=NavigatorParams(waypoint_follower=WaypointFollowerParams(stop_on_failure=stop))
    )
    result = drive.until_done(FollowWaypoints((INSIDE_A_WALL, BESIDE[0])))
    (missed,) = result.waypoint_statuses
    assert (missed.waypoint_index, missed.waypoint_status) == (0, WaypointState.FAILED)
    assert missed.error_code == ErrorCode.GOAL_OCCUPIED
    if stop:
        assert result.error_code == ErrorCode.STOP_ON_MISSED_WAYPOINT
        assert "waypoint 0 was missed: error 206" in result.error_msg
    else:
        assert result.error_code == 0
        assert drive.robot.robot.map_from_base.yaw_rad == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(
    ("work", "text"),
    [
        (WaypointWork(photo=True), "photo at waypoint 0: no camera image received within 5.0 s"),
        (WaypointWork(input_timeout_s=0.5), "input at waypoint 0: none received within 0.5 s"),
    ],
)
def test_work_that_fails_at_a_waypoint_is_told(work: WaypointWork, text: str) -> None:
    drive = Drive(
        params=NavigatorParams(waypoint_follower=WaypointFollowerParams(stop_on_failure=True))
    )
    result = drive.until_done(FollowWaypoints(BESIDE, works=(work, work)))
    assert result.error_code == ErrorCode.TASK_EXECUTOR_FAILED
    assert result.error_msg == text


def test_work_for_fewer_waypoints_than_there_are_is_refused() -> None:
    with pytest.raises(NavigationError, match="1 tasks for 2 waypoints"):
        Drive().navigator.start(0, FollowWaypoints(BESIDE, works=(WaypointWork(),)))


@pytest.mark.parametrize(
    ("count", "index", "loops"), [(0, 0, 0), (2, 2, 0), (2, -1, 0), (2, 0, -1)]
)
def test_waypoints_that_make_no_sense_are_refused(count: int, index: int, loops: int) -> None:
    with pytest.raises(NavigationError) as caught:
        Drive().navigator.start(0, FollowWaypoints(BESIDE[:count], loops, index))
    assert caught.value.code is ErrorCode.NO_VALID_WAYPOINTS


@pytest.mark.parametrize(
    ("request_", "moved"),
    [
        (spin(0.5), (0.0, 0.5)),
        (back_up(0.2, 0.1), (-0.2, 0.0)),
        (drive_on_heading(0.2, 0.1), (0.2, 0.0)),
        (wait(0.5), (0.0, 0.0)),
    ],
)
def test_a_behaviour_is_a_task_of_its_own(
    request_: SingleAction, moved: tuple[float, float]
) -> None:
    drive = Drive()
    # It needs no map.
    drive.robot.localized = False
    result = drive.until_done(request_, 10.0)
    assert (result.error_code, result.number_of_recoveries) == (0, 0)
    drive.run(0.5)
    pose = drive.robot.robot.map_from_base
    assert (pose.x_m, pose.yaw_rad) == pytest.approx(moved, abs=0.03)


def test_a_behaviour_reports_its_progress_and_its_error() -> None:
    drive = Drive()
    drive.navigator.start(0, spin(1.0))
    drive.run(1.0)
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    assert 0.3 < feedback.motion < 1.0
    result = drive.until_done(drive_on_heading(0.3, -0.1))
    assert result.error_code == ErrorCode.DRIVE_ON_HEADING_INVALID_INPUT
    # Before the wall; the robot's place is told.
    drive.robot.robot.map_from_base = SE2(5.0, 1.5, 0.0)
    result = drive.until_done(drive_on_heading(0.5, 0.2))
    assert result.error_code == ErrorCode.DRIVE_ON_HEADING_COLLISION_AHEAD
    assert "at (5.00, 1.50)" in result.error_msg


def test_assisted_teleop_drives_as_the_user_asks_until_its_time_is_over() -> None:
    drive = Drive()
    drive.robot.wanted = Velocity(0.2, 0.0)
    result = drive.until_done(assisted_teleop(2.0))
    assert result.error_code == ErrorCode.ASSISTED_TELEOP_TIMEOUT
    assert max(v for v, _ in drive.commands) == pytest.approx(0.2)


def test_a_given_path_is_followed() -> None:
    drive = Drive()
    path = drive.robot.compute_path(None, (NEAR,), "")
    result = drive.until_done(FollowPath(path))
    assert result.error_code == 0
    assert drive.robot.robot.map_from_base.distance_m(NEAR) < 0.06
    assert drive.robot.plans == 1


def dock_at(pose: SE2) -> Dock:
    """The dock of a marker 0.8 m before this pose."""
    marker_from_dock = SE2(0.8, 0.0, math.pi)
    return Dock("7", pose @ marker_from_dock.inverse(), marker_from_dock)


def test_docking_at_an_unknown_dock_or_out_of_reach_says_so() -> None:
    drive = Drive()
    assert drive.until_done(dock_robot(dock_id="home")).error_code == ErrorCode.DOCK_NOT_IN_DB
    drive.robot.docks.known["7"] = dock_at(INSIDE_A_WALL)
    inside = drive.until_done(dock_robot(dock_id="7"))
    assert inside.error_code == ErrorCode.DOCK_NOT_VALID
    assert "cannot stand in the dock of marker 7: goal (0.40, 0.55)" in inside.error_msg
    away = drive.until_done(dock_robot(dock_pose=NEAR))
    assert away.error_code == ErrorCode.DOCK_NOT_VALID
    assert "must face a marker" in away.error_msg
    # The nearest of the staging poses is inside the wall as well.
    drive.robot.docks.known["7"] = dock_at(SE2(0.4, 0.0, -math.pi / 2.0))
    before = drive.until_done(dock_robot(dock_id="7"))
    assert before.error_code == ErrorCode.FAILED_TO_STAGE
    assert "no room before the dock of marker 7: goal" in before.error_msg
    assert drive.robot.robot.map_from_base == START


def test_docking_drives_to_the_staging_pose_and_looks_for_the_marker() -> None:
    drive = Drive()
    drive.robot.docks.known["home"] = dock_at(NEAR @ SE2(0.7, 0.0, 0.0))
    result = drive.until_done(dock_robot(dock_id="home"))
    # There is no marker there.
    assert result.error_code == ErrorCode.FAILED_TO_DETECT_DOCK
    assert result.num_retries == DockingParams().max_retries
    assert drive.robot.robot.map_from_base.distance_m(NEAR) < 0.1


def test_a_tree_that_cannot_be_used_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "broken.xml"
    path.write_text(document("<FollowObject/>"))
    drive = Drive()
    with pytest.raises(NavigationError, match=r"broken.xml:1: FollowObject is not") as caught:
        drive.navigator.start(0, NavigateToPose(NEAR, str(path)))
    assert caught.value.code is ErrorCode.FAILED_TO_LOAD_BEHAVIOR_TREE
    with pytest.raises(ConfigError, match="FollowObject"):
        Drive(params=NavigatorParams(BtNavigatorParams(default_nav_to_pose_bt_xml=str(path))))


def test_a_tree_that_asks_for_nothing_known_ends_with_a_word(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(document("<AlwaysFailure/>"))
    result = Drive().until_done(NavigateToPose(NEAR, str(path)))
    assert result.error_code == ErrorCode.NAVIGATOR_UNKNOWN
    assert result.error_msg == (
        "the tree 'Main' ended with FAILURE: AlwaysFailure 'AlwaysFailure' in line 1 failed"
    )
    path = tmp_path / "nonsense.xml"
    path.write_text(document('<Wait wait_duration="{goal}"/>'))
    result = Drive().until_done(NavigateToPose(NEAR, str(path)))
    assert "Wait 'Wait', port 'wait_duration': must be a number" in result.error_msg


def test_the_tree_can_be_watched() -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR))
    drive.run(0.2)
    nodes = {one.name: one for one in drive.navigator.snapshot()}
    assert nodes["NavigateRecovery"].depth == 0
    assert nodes["NavigateRecovery"].status is NodeStatus.RUNNING
    assert nodes["FollowPath"].status is NodeStatus.RUNNING
    assert nodes["Spin"].status is NodeStatus.IDLE
    drive.navigator.cancel(drive.now_ns)
    assert drive.navigator.snapshot() == ()


def test_the_same_drive_gives_the_same_commands() -> None:
    runs = []
    for _ in range(2):
        drive = Drive()
        drive.until_done(NavigateToPose(NEAR))
        runs.append(np.array(drive.commands).tobytes())
    assert runs[0] == runs[1]


def test_time_remaining_is_never_without_bound() -> None:
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=True)))
    drive.navigator.start(0, NavigateToPose(FAR))
    drive.run(2.0)
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    remaining_s = feedback.estimated_time_remaining_s
    assert remaining_s is not None
    assert 10.0 < remaining_s < math.inf


def test_a_goal_given_in_the_moment_of_arrival_is_not_taken_for_reached(tmp_path: Path) -> None:
    tree = tmp_path / "plans_every_ten_seconds.xml"
    tree.write_text(
        document(
            '<PipelineSequence><RateController hz="0.1">'
            '<ComputePathToPose goal="{goal}" path="{path}"/></RateController>'
            '<FollowPath path="{path}"/></PipelineSequence>'
        )
    )
    near, back = SE2(0.3, 0.0, 0.0), SE2(0.0, 0.0, 0.0)
    arrived_ns = Drive().until_done(NavigateToPose(near, str(tree))).end_ns
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(near, str(tree)))
    drive.run(arrived_ns * 1e-9 - 0.1)
    assert drive.results == []
    drive.navigator.start(drive.now_ns, NavigateToPose(back, str(tree)))
    assert drive.finish().error_code == 0
    assert drive.robot.robot.map_from_base.distance_m(back) < 0.06


def test_a_tree_that_never_plans_runs_once_for_a_new_goal(tmp_path: Path) -> None:
    tree = tmp_path / "tree.xml"
    tree.write_text(document('<Wait wait_duration="1.0"/>'))
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR, str(tree)))
    drive.run(0.5)
    assert drive.until_done(NavigateToPose(FAR, str(tree))).status is TaskStatus.SUCCEEDED
    assert drive.now_s == pytest.approx(1.0, abs=0.1)


def test_a_new_goal_ends_a_recovery() -> None:
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=True)))
    drive.navigator.start(0, NavigateToPose(FAR))

    def spinning() -> bool:
        nodes = {one.kind: one.status for one in drive.navigator.snapshot()}
        return nodes.get("Spin") is NodeStatus.RUNNING

    while not spinning():
        drive.step()
    drive.navigator.start(drive.now_ns, NavigateToPose(NEAR))
    drive.step()
    assert not spinning()
    feedback = drive.navigator.feedback(drive.now_ns)
    assert feedback is not None
    assert feedback.number_of_recoveries <= 1


def test_a_tree_that_comes_with_navigation_is_found_by_its_name() -> None:
    drive = Drive()
    name = "navigate_to_pose_w_replanning_and_recovery"
    drive.navigator.start(0, NavigateToPose(NEAR, name))
    drive.run(0.5)
    root = drive.navigator.snapshot()[0]
    assert (root.kind, root.name, root.depth) == ("RecoveryNode", "NavigateRecovery", 0)
    assert root.status is NodeStatus.RUNNING
    with pytest.raises(NavigationError, match=r"no_such_tree\.xml: No such file"):
        drive.navigator.start(drive.now_ns, NavigateToPose(NEAR, "no_such_tree"))


def test_a_new_goal_before_a_closed_door_is_waited_for_as_long_as_the_one_before() -> None:
    drive = Drive()

    def open_at_25_s(now_ns: int) -> None:
        drive.robot.boxes = [DOOR if now_ns < 25_000_000_000 else AWAY]

    drive.each_period = open_at_25_s
    drive.navigator.start(0, NavigateToPose(FAR))
    drive.run(14.0)
    assert not drive.results
    drive.navigator.start(drive.now_ns, NavigateToPose(FAR))
    drive.run(1.0)
    # The costmap may show what is gone: each goal has it cleared once.
    assert len(drive.robot.cleared) == 2
    assert drive.finish().error_code == 0


def test_docking_notices_after_a_pause_that_the_marker_is_gone() -> None:
    drive = Drive()
    dock = drive.robot.docks.known["home"] = dock_at(NEAR @ SE2(0.7, 0.0, 0.0))

    def see(now_ns: int) -> None:
        base = drive.robot.robot.map_from_base
        drive.robot.sighting = MarkerPose(
            now_ns, base.inverse() @ dock.map_from_marker, drive.robot.odom_from_base()
        )

    def state() -> DockState:
        feedback = drive.navigator.feedback(drive.now_ns)
        assert feedback is not None
        return feedback.docking_state

    drive.each_period = see
    drive.navigator.start(0, dock_robot(dock_id="home"))
    while not drive.commands or state() is not DockState.CONTROLLING:
        drive.step()
    drive.run(0.5)
    drive.navigator.pause()
    drive.run(30.0)
    drive.navigator.resume()
    drive.run(0.2)
    assert state() is DockState.CONTROLLING
    drive.each_period = lambda _: None
    before = drive.poses[-1]
    while state() is DockState.CONTROLLING:
        drive.step()
    p = DockingParams()
    highest_m_s = p.controller.v_linear_max
    braking_m = 0.5 * highest_m_s * highest_m_s / p.acceleration
    most_m = highest_m_s * p.external_detection_timeout + braking_m
    assert drive.poses[-1].distance_m(before) < most_m + 0.01
    assert drive.finish().num_retries == DockingParams().max_retries


def test_a_drive_into_a_keepout_zone_is_refused_by_its_name() -> None:
    drive = Drive()
    robot, static = drive.robot.inner, drive.robot.costmap.static
    corners = tuple(
        (START @ SE2(x_m, y_m, 0.0))[:2]
        for x_m, y_m in ((0.3, -1.0), (1.0, -1.0), (1.0, 1.0), (0.3, 1.0))
    )
    zone = KeepoutZone(name="carpet", polygon_m=corners)
    robot.take_map(static.frame, house().map_cells, 0.1, zones_of(static.frame, 0.4, [zone]))
    into = drive.until_done(drive_on_heading(0.4, 0.2))
    assert into.error_code == ErrorCode.DRIVE_ON_HEADING_COLLISION_AHEAD
    assert "keepout zone carpet 0." in into.error_msg
