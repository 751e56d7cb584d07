"""A program drives the robot with Nav2's method names: in one process, and over Zenoh."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mazebot.commander.navigator import Navigator, TaskResult
from mazebot.common.client.robot import RobotError
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import CMD_VEL_TELEOP, CONTACTS, MAP
from mazebot.common.world.map_files import write_map
from mazebot.embedded.session import Session
from tests.docs.stack import running_stack


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session("original", camera=False) as session:
        yield session


@pytest.fixture
def navigator(session: Session) -> Iterator[Navigator]:
    with Navigator.in_process(session) as navigator:
        navigator.waitUntilNav2Active()
        yield navigator
        navigator.cancelTask()


def test_a_wait_of_no_length_is_refused(navigator: Navigator) -> None:
    with pytest.raises(ConfigError, match=r"timeout_s: must be a finite number \(got nan\)"):
        navigator.waitUntilNav2Active(timeout_s=math.nan)


def test_after_its_end_it_says_so_and_what_came_last_is_known(session: Session) -> None:
    with Navigator.in_process(session) as navigator:
        navigator.waitUntilNav2Active()
        assert navigator.wait(0.1)
        assert finished(navigator) is TaskResult.SUCCEEDED
    navigator.destroyNode()
    calls: list[Callable[[], object]] = [
        lambda: navigator.goToPose((0.5, -0.6)),
        navigator.isTaskComplete,
        navigator.cancelTask,
        navigator.pauseTask,
        navigator.waitUntilNav2Active,
        navigator.clearAllCostmaps,
        navigator.__enter__,
        lambda: navigator.setInitialPose((0.0, 0.0)),
        lambda: navigator.getPath(None, (0.5, -0.6)),
        lambda: navigator.changeMap("nowhere.yaml"),
    ]
    for call in calls:
        with pytest.raises(RobotError, match=r"^the navigator is closed$"):
            call()
    assert navigator.getPose() is not None
    assert navigator.getResult() is TaskResult.SUCCEEDED


@pytest.mark.parametrize(("call", "line"), [
    (lambda on: on.spin(spin_dist="1"), "spin_dist: must be a number (got '1')"),
    (lambda on: on.wait(-1.0), "duration: must be greater than or equal to 0 (got -1.0)"),
    (lambda on: on.dockRobotByID(3), "dock_id: must be a string (got 3)"),
    (lambda on: on.pauseTask("False"), "pause: must be True or False (got 'False')"),
    (lambda on: on.clearCostmapAroundRobot(-1),
     "reset_distance: must be greater than or equal to 0 (got -1)"),
    (lambda on: on.setInitialPose((0.0, 0.0), std_m=-1),
     "std_m: must be greater than or equal to 0 (got -1)"),
    (lambda on: on.followWaypoints((0.5, -0.9, 0.0)),
     "poses: must be a PoseStamped, or x and y (m), and yaw (rad): finite numbers (got 0.5)"),
    (lambda on: on.getPath(None, (0.5, -0.6), use_start=True),
     "start: must be a PoseStamped, or x and y (m), and yaw (rad): finite numbers (got None)"),
    (lambda on: on.in_process(None), "session: must be a Session (got None)"),
])  # fmt: skip
def test_an_argument_that_is_none_is_named_with_its_value(
    navigator: Navigator, call: Callable[[Navigator], object], line: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        call(navigator)
    assert str(refused.value) == line


def finished(navigator: Navigator) -> TaskResult:
    """The result of the task."""
    while not navigator.isTaskComplete():
        pass
    return navigator.getResult()


def test_a_pose_is_driven_to_with_feedback_on_the_way(
    navigator: Navigator, session: Session
) -> None:
    assert navigator.goToPose((0.5, -0.6, 0.0))
    assert navigator.getResult() is TaskResult.UNKNOWN
    remaining_m = []
    while not navigator.isTaskComplete():
        feedback = navigator.getFeedback()
        if feedback is not None:
            assert feedback.action == "navigate_to_pose"
            remaining_m.append(feedback.distance_remaining_m or 0.0)
    assert navigator.getResult() is TaskResult.SUCCEEDED
    assert navigator.getTaskError() == (0, "")
    assert remaining_m[0] > remaining_m[-1]
    truth = session.ground_truth()
    assert abs(truth.x_m - 0.5) + abs(truth.y_m + 0.6) < 0.2


def test_a_spin_turns_and_a_wait_waits(navigator: Navigator, session: Session) -> None:
    before = session.ground_truth().yaw_rad
    assert navigator.spin(1.0)
    assert finished(navigator) is TaskResult.SUCCEEDED
    assert wrap_angle(session.ground_truth().yaw_rad - before) == pytest.approx(1.0, abs=0.15)
    start_s = session.now_s
    assert navigator.wait(1.0)
    assert finished(navigator) is TaskResult.SUCCEEDED
    assert session.now_s - start_s >= 1.0


def test_waypoints_are_visited_and_a_missed_one_is_told(navigator: Navigator) -> None:
    assert navigator.followWaypoints([(0.3, -0.6), (99.0, 0.0), (0.6, -0.6)])
    assert finished(navigator) is TaskResult.SUCCEEDED
    result = navigator.getActionResult()
    assert result is not None
    assert [(one.index, one.error_code) for one in result.waypoints] == [
        (1, ErrorCode.GOAL_OUTSIDE_MAP)
    ]


def test_a_task_is_cancelled_and_the_robot_stands(navigator: Navigator, session: Session) -> None:
    assert navigator.goToPose(navigator.locations()["location3"])
    for _ in range(15):
        assert not navigator.isTaskComplete()
    navigator.cancelTask()
    assert finished(navigator) is TaskResult.CANCELED
    session.run_for(1.0)
    before = session.ground_truth()
    session.run_for(0.5)
    assert session.ground_truth().distance_m(before) < 0.005


def test_a_paused_task_stands_and_goes_on(navigator: Navigator, session: Session) -> None:
    assert navigator.goToPose(navigator.locations()["location1"])
    for _ in range(10):
        navigator.isTaskComplete()
    navigator.pauseTask()
    session.run_for(1.5)
    before = session.ground_truth()
    session.run_for(1.0)
    assert session.ground_truth().distance_m(before) < 0.005
    navigator.pauseTask(pause=False)
    assert finished(navigator) is TaskResult.SUCCEEDED


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 1.0)])
def test_an_orientation_that_is_none_is_refused(
    navigator: Navigator, q: tuple[float, float, float, float]
) -> None:
    pose = msg.Pose(msg.Point(0.3, 0.0, 0.0), msg.Quaternion(*q))
    with pytest.raises(ConfigError, match=r"^pose: orientation \(0, 0, .*\): must have length 1$"):
        navigator.goToPose(msg.PoseStamped(msg.header(0, "map"), pose))


def test_an_occupied_goal_is_refused_with_the_nearest_free_pose(navigator: Navigator) -> None:
    assert not navigator.goToPose((0.4, 0.5, 0.0))
    code, text = navigator.getTaskError()
    assert code == ErrorCode.GOAL_OCCUPIED
    assert "\n" not in text
    assert navigator.getResult() is TaskResult.FAILED


def test_a_path_is_planned_without_driving(navigator: Navigator, session: Session) -> None:
    before = session.ground_truth()
    path = navigator.getPath((0.0, 0.0, 0.0), navigator.locations()["location1"], use_start=True)
    assert path is not None
    assert (path[0].x_m, path[0].y_m) == pytest.approx((0.0, 0.0))
    assert navigator.getPath(None, (99.0, 0.0)) is None
    assert navigator.getTaskError()[0] == ErrorCode.GOAL_OUTSIDE_MAP
    assert session.ground_truth().distance_m(before) < 0.001


def test_the_error_is_that_of_what_was_asked_for_last(navigator: Navigator) -> None:
    assert navigator.wait(0.1)
    assert finished(navigator) is TaskResult.SUCCEEDED
    assert navigator.getPath(None, (99.0, 0.0)) is None
    assert navigator.getTaskError()[0] == ErrorCode.GOAL_OUTSIDE_MAP
    assert navigator.getResult() is TaskResult.SUCCEEDED
    assert navigator.getPath(None, (0.5, -0.9)) is not None
    assert navigator.getTaskError() == (0, "")
    navigator.setTaskError(9, "of my own")
    assert navigator.getTaskError() == (9, "of my own")
    assert navigator.wait(0.1)
    assert navigator.getTaskError() == (0, "")
    assert finished(navigator) is TaskResult.SUCCEEDED


def test_costmaps_can_be_cleared_and_read(navigator: Navigator, session: Session) -> None:
    navigator.clearAllCostmaps()
    navigator.clearCostmapAroundRobot(1.0)
    session.run_for(1.0)
    local, whole = navigator.getLocalCostmap(), navigator.getGlobalCostmap()
    assert local is not None
    assert whole is not None
    assert (local.header.frame_id, whole.header.frame_id) == ("odom", "map")
    assert local.info.width == 60


@pytest.mark.parametrize("pose", [(float("nan"), 0.0), (1.0,), "ab"])
def test_a_pose_that_is_none_is_one_line(navigator: Navigator, pose: object) -> None:
    with pytest.raises((ConfigError, ValueError)) as caught:
        navigator.goToPose(pose)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_a_person_at_the_keyboard_drives_and_is_stopped_before_a_wall(
    navigator: Navigator, session: Session
) -> None:
    before = session.ground_truth()

    def drive(linear_m_s: float, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            header = msg.header(round(session.now_s * 1e9), "base_footprint")
            linear, angular = msg.Vector3(linear_m_s, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0)
            session.publish(CMD_VEL_TELEOP, msg.TwistStamped(header, msg.Twist(linear, angular)))
            session.run_for(0.1)

    drive(0.2, 1.0)
    assert session.ground_truth().distance_m(before) > 0.1
    with session.watching(CONTACTS) as contacts:
        drive(0.4, 8.0)
        stood = session.ground_truth()
        drive(0.4, 1.0)
    assert contacts == []
    assert session.ground_truth().distance_m(stood) < 0.02


def test_a_path_is_smoothed(navigator: Navigator) -> None:
    corner = [(0.0, 0.0), (0.3, 0.0), (0.3, -0.3)]
    path = navigator.smoothPath(corner)
    assert path is not None
    assert len(path) > len(corner)
    assert navigator.smoothPath(corner, "nope") is None
    assert navigator.getTaskError()[0] == ErrorCode.INVALID_SMOOTHER


def test_a_map_takes_the_place_of_the_worlds(
    navigator: Navigator, session: Session, tmp_path: Path
) -> None:
    before = session.latest(MAP)
    assert before is not None
    cells = np.array(msg.cells_from_grid(before), np.int8)
    # Where a wall was drawn in, no path leads.
    cells[:, :] = np.where(cells == 100, 100, 0)
    origin = msg.se2_from_pose(before.info.origin)
    resolution_m = before.info.resolution
    column = int((0.45 - origin.x_m) / resolution_m)
    cells[:, column] = 100
    file = write_map(tmp_path, "closed", cells, resolution_m, origin)
    assert navigator.changeMap(file), navigator.getTaskError()
    navigator.waitUntilNav2Active()
    after = session.latest(MAP)
    assert after is not None
    assert not msg.same_grid(after, before)
    assert navigator.getPath((0.0, 0.0), (1.2, -0.6), use_start=True) is None
    assert navigator.getTaskError()[0] == ErrorCode.NO_VALID_PATH
    own = write_map(tmp_path, "own", np.array(msg.cells_from_grid(before)), resolution_m, origin)
    assert navigator.changeMap(own)
    navigator.waitUntilNav2Active()
    for name, text, result in (
        ("nowhere.yaml", None, 1),
        ("bad.yaml", own.read_text().replace("own.pgm", "nope.pgm"), 2),
        ("worse.yaml", own.read_text().replace("resolution:", "resolution: x"), 3),
    ):
        if text is not None:
            (tmp_path / name).write_text(text)
        assert not navigator.changeMap(tmp_path / name)
        code, said = navigator.getTaskError()
        assert (code, "\n" in said) == (result, False)
        assert name in said


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
def test_the_same_program_drives_a_running_stack() -> None:
    with running_stack() as endpoint, Navigator.connect(endpoint) as navigator:
        navigator.waitUntilNav2Active()
        assert navigator.goToPose((0.3, -0.5, 0.0))
        assert finished(navigator) is TaskResult.SUCCEEDED
        assert navigator.spin(-1.0)
        assert finished(navigator) is TaskResult.SUCCEEDED
        assert not navigator.goToPose((99.0, 0.0))
        assert navigator.getTaskError()[0] == ErrorCode.GOAL_OUTSIDE_MAP
