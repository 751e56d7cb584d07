from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import MarkerPose, planar_marker
from mazebot.navigation.behavior.docking.dock_estimate import DockEstimate, SightingParams
from mazebot.navigation.behavior.docking.docking import (
    DockingParams,
    DockState,
    Undocker,
)
from mazebot.navigation.behavior.docking.graceful_controller import (
    GracefulParams,
    graceful_velocity,
)
from mazebot.navigation.config import CONTROL_PERIOD_NS
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.errors import NavigationError
from tests.navigation.behavior.docking_robot import PERIOD_S, DockingRobot
from tests.navigation.driving import Unicycle


@pytest.mark.parametrize(
    ("starts", "spread", "noise"),
    [(20, (0.1, 0.1, 0.15), 1.0), (60, (0.3, 0.3, 0.5), 1.0), (20, (0.1, 0.1, 0.15), 2.0)],
)
def test_it_docks_from_60_starts_within_2_cm_aside_and_a_degree_and_a_half(
    starts: int, spread: tuple[float, float, float], noise: float
) -> None:
    errors = np.array([DockingRobot(seed, spread, noise).dock_it() for seed in range(starts)])
    assert np.abs(errors[:, 1]).max() < 0.02
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.03
    assert np.degrees(np.abs(errors[:, 2])).max() < 1.5


def test_it_is_at_rest_within_its_speeds_and_says_its_states() -> None:
    robot = DockingRobot(1)
    robot.dock_it()
    states = [step.state for step in robot.states]
    assert states[0] is DockState.INITIAL_PERCEPTION
    assert states[-1] is DockState.CONTROLLING
    commands = np.array([step.velocity for step in robot.states])
    p = robot.params
    change = np.abs(np.diff(commands, axis=0)).max(0) / PERIOD_S
    assert change[0] <= p.acceleration + 1e-9
    assert change[1] <= p.angular_acceleration + 1e-9
    assert commands[:, 0].max() <= p.controller.v_linear_max
    # The last centimetres are slow: there is no bumper.
    assert robot.states[-1].velocity == STOP


def test_a_marker_that_is_never_seen_ends_the_docking_with_its_code() -> None:
    robot = DockingRobot(1)
    robot.blind = True
    with pytest.raises(NavigationError, match="was detected 0 times in 8") as caught:
        robot.dock_it()
    assert caught.value.code is ErrorCode.FAILED_TO_DETECT_DOCK
    # It looked to both sides, four times 8 s.
    turns = [step.velocity.angular_rad_s for step in robot.states]
    assert min(turns) < -0.4 < 0.4 < max(turns)
    assert robot.now_ns * 1e-9 == pytest.approx(4 * 8.0, abs=0.5)


def test_a_marker_out_of_sight_at_the_start_is_looked_for() -> None:
    robot = DockingRobot(3)
    robot.robot.map_from_base = robot.robot.map_from_base @ SE2(0.0, 0.0, 0.8)
    error = robot.dock_it()
    assert math.hypot(error.x_m, error.y_m) < 0.02


def test_a_start_too_near_goes_back_to_the_staging_pose_first() -> None:
    robot = DockingRobot(4)
    robot.robot.map_from_base = robot.dock @ SE2(-0.2, 0.06, 0.1)
    error = robot.dock_it()
    assert DockState.RETRY in [step.state for step in robot.states]
    assert abs(error.y_m) < 0.02


def test_a_marker_lost_on_the_way_is_waited_for_and_found_again() -> None:
    robot = DockingRobot(5)
    while robot.error().x_m < -0.5:
        robot.step()
    robot.blind = True
    while robot.states[-1].num_retries == 0:
        robot.step()
    assert robot.error().x_m < -0.2
    robot.blind = False
    error = robot.dock_it()
    assert abs(error.y_m) < 0.02
    assert robot.states[-1].num_retries == 1


def test_a_dock_nearer_than_the_camera_sees_is_reached_by_odometry() -> None:
    errors = []
    for seed in range(8):
        robot = DockingRobot(seed, whole_view_m=0.72)
        errors.append(robot.dock_it())
        assert robot.states[-1].num_retries == 0
    # Odometry slips by 1 % over the last 0.32 m.
    assert max(abs(error.y_m) for error in errors) < 0.02
    assert max(math.hypot(error.x_m, error.y_m) for error in errors) < 0.03


def test_a_dock_with_no_room_for_a_better_start_is_approached_from_where_the_robot_is() -> None:
    # Aside of the axis, and with a wall right behind.
    robot = DockingRobot(2, time_to_collision=lambda v: 0.1 if v.linear_m_s < 0.0 else math.inf)
    robot.robot.map_from_base = robot.dock @ SE2(-0.45, 0.1, 0.0)
    error = robot.dock_it()
    assert DockState.RETRY in [step.state for step in robot.states]
    assert math.hypot(error.x_m, error.y_m) < 0.03


@pytest.mark.parametrize("aside_m", [-0.36, 0.36])
def test_a_dock_far_aside_is_reached_by_a_curve_on_which_it_is_out_of_the_picture(
    aside_m: float,
) -> None:
    for seed in range(4):
        robot = DockingRobot(seed, away_m=0.88)

        def wall_behind(velocity: Velocity, robot: DockingRobot = robot) -> float:
            return 0.1 if velocity.linear_m_s < 0.0 and robot.error().x_m < -0.45 else math.inf

        robot.time_to_collision = wall_behind
        robot.robot.map_from_base = robot.dock @ SE2(-0.5, aside_m, 0.0)
        error = robot.dock_it()
        # The marker is not given up on the way; at most the end is a little aside.
        assert robot.states[-1].num_retries <= 1
        assert abs(error.y_m) < 0.02
        assert math.hypot(error.x_m, error.y_m) < 0.03


def test_a_marker_that_should_be_in_the_picture_and_is_not_counts_as_lost() -> None:
    robot = DockingRobot(5)
    robot.robot.map_from_base = robot.dock @ SE2(-0.7, 0.0, 0.0)
    while robot.error().x_m < -0.5:
        robot.step()
    robot.blind = True
    while robot.states[-1].num_retries == 0:
        robot.step()
    assert robot.error().x_m < -0.25


def test_a_dock_pushed_aside_meanwhile_is_docked_where_it_is_now() -> None:
    robot = DockingRobot(6)
    while robot.error().x_m < -0.25:
        robot.step()
    # The robot is shoved, which odometry does not see.
    robot.robot.map_from_base = robot.robot.map_from_base @ SE2(0.0, 0.06, 0.0)
    error = robot.dock_it()
    assert abs(error.y_m) < 0.02
    assert math.hypot(error.x_m, error.y_m) < 0.03


def test_a_dock_that_was_missed_sideways_is_tried_again() -> None:
    robot = DockingRobot(8)
    while robot.error().x_m < -0.005:
        robot.step()
    robot.robot.map_from_base = robot.robot.map_from_base @ SE2(0.0, 0.04, 0.0)
    error = robot.dock_it()
    assert robot.states[-1].num_retries == 1
    assert abs(error.y_m) < 0.02


def remove(robot: DockingRobot) -> None:
    robot.blind = True


def move_marker(robot: DockingRobot) -> None:
    robot.map_from_marker = robot.map_from_marker @ SE2(0.0, 3.0, 1.0)


def turn_round(robot: DockingRobot) -> None:
    robot.robot.map_from_base = robot.robot.map_from_base @ SE2(0.0, 0.0, math.pi)


def carry_away(robot: DockingRobot) -> None:
    robot.robot.map_from_base = SE2(3.5, -3.0, 0.0)


@pytest.mark.parametrize("before_m", [0.2, 0.012])
@pytest.mark.parametrize("event", [remove, move_marker, turn_round, carry_away])
def test_it_is_not_docked_at_a_marker_that_it_does_not_see_there(
    before_m: float, event: Callable[[DockingRobot], None]
) -> None:
    robot = DockingRobot(5)
    while robot.error().x_m < -before_m:
        robot.step()
    event(robot)
    with pytest.raises(NavigationError, match="marker was detected 0 times in 8") as caught:
        robot.dock_it()
    assert caught.value.code is ErrorCode.FAILED_TO_DETECT_DOCK
    assert robot.states[-1].num_retries == 3


def test_a_slow_camera_has_time_for_all_sightings_of_the_verdict() -> None:
    robot = DockingRobot(2, camera_periods=8)
    stood_ns = 0
    while not robot.step().done:
        stood_ns = stood_ns if robot.command == STOP else robot.now_ns
    assert robot.now_ns - stood_ns >= 14 * robot.camera_periods * CONTROL_PERIOD_NS
    assert robot.states[-1].num_retries == 0


@pytest.mark.parametrize("camera_periods", [13, 20, 24])
def test_a_camera_of_less_than_2_pictures_a_second_docks_as_exactly(camera_periods: int) -> None:
    for seed in range(4):
        robot = DockingRobot(seed, camera_periods=camera_periods)
        error = robot.dock_it()
        # Two pictures in a row without the marker may take too long.
        assert robot.states[-1].num_retries <= 1
        assert abs(error.y_m) < 0.02
        assert math.hypot(error.x_m, error.y_m) < 0.03
        moves = [step for step in robot.states if step.velocity.linear_m_s > 0.0]
        assert moves[0].state is DockState.CONTROLLING


def test_the_robot_stands_on_its_way_while_the_last_sighting_is_old() -> None:
    robot = DockingRobot(2, camera_periods=30, noise=0.0)
    age_ns = []
    while robot.error().x_m < -0.2:
        step = robot.step()
        if step.velocity.linear_m_s > 0.0 and robot.sightings:
            age_ns.append(robot.now_ns - robot.sightings[0].stamp_ns)
    # It brakes within another 0.7 s.
    assert max(age_ns) < 1.8e9


def test_a_pose_from_which_the_marker_is_not_in_the_picture_is_judged_by_odometry() -> None:
    robot = DockingRobot(0, away_m=0.88, aside_rad=0.35, side_m=0.4)
    error = robot.dock_it()
    assert robot.states[-1].num_retries == 0
    assert math.hypot(error.x_m, error.y_m) < 0.03


def test_a_wrong_sighting_is_left_out_until_there_are_many() -> None:
    estimate = DockEstimate(SightingParams())
    at = SE2(0.0, 0.0, 0.0)
    for i in range(20):
        estimate.add(MarkerPose(i, SE2(0.5, 0.0, 3.0), at))
    estimate.add(MarkerPose(20, SE2(0.5, 0.0, 2.5), at))
    assert estimate.odom_from_marker == pytest.approx(SE2(0.5, 0.0, 3.0))
    for i in range(21, 40):
        estimate.add(MarkerPose(i, SE2(0.6, 0.0, 2.5), at))
    # The marker has moved, or the robot was pushed.
    assert estimate.odom_from_marker == pytest.approx(SE2(0.6, 0.0, 2.5))


@pytest.mark.parametrize("aside_m", [-0.35, -0.22, 0.22, 0.35])
def test_of_two_markers_with_the_docks_id_the_one_at_its_place_is_docked_at(aside_m: float) -> None:
    for seed in range(4):
        robot = DockingRobot(
            seed, double=SE2(0.0, aside_m, 0.0), pose_error=SE2(0.02, -0.02, 0.015)
        )
        error = robot.dock_it()
        assert robot.states[-1].num_retries == 0
        assert abs(error.y_m) < 0.02
        assert math.hypot(error.x_m, error.y_m) < 0.03


@pytest.mark.parametrize("aside_m", [-0.35, 0.25])
def test_a_marker_that_is_not_at_the_docks_place_is_not_docked_at(aside_m: float) -> None:
    robot = DockingRobot(3, pose_error=SE2(0.02, -0.02, 0.015))
    robot.map_from_marker = robot.map_from_marker @ SE2(0.0, aside_m, 0.0)
    seen = r"detected 0 times .* one with its id was seen at \(.*, expected at \(2.00, -1.00\)"
    with pytest.raises(NavigationError, match=seen) as caught:
        robot.dock_it()
    assert caught.value.code is ErrorCode.FAILED_TO_DETECT_DOCK
    assert "\n" not in caught.value.message


@pytest.mark.parametrize("moved", [SE2(0.0, 0.08, 0.0), SE2(0.06, -0.05, 0.1)])
def test_a_dock_that_was_moved_by_some_centimetres_is_docked_at(moved: SE2) -> None:
    robot = DockingRobot(3, pose_error=SE2(0.02, -0.02, 0.015))
    robot.map_from_marker = robot.map_from_marker @ moved
    robot.dock = robot.map_from_marker @ SE2(robot.away_m, 0.0, math.pi)
    error = robot.dock_it()
    assert abs(error.y_m) < 0.02
    assert math.hypot(error.x_m, error.y_m) < 0.03


def test_something_in_the_way_stops_the_approach() -> None:
    robot = DockingRobot(7, time_to_collision=lambda v: 0.3 if v.linear_m_s > 0.0 else math.inf)
    with pytest.raises(NavigationError, match="obstacle in the way") as caught:
        robot.dock_it()
    assert caught.value.code is ErrorCode.FAILED_TO_CONTROL
    assert robot.states[-1].num_retries == 3


def undock(
    stuck: bool = False, contact_s: float = math.inf, room_m: float = math.inf
) -> tuple[Unicycle, float]:
    dock = SE2(1.0, 1.0, 0.5)
    robot, undocker = Unicycle(dock, stuck=stuck), Undocker(DockingParams(), 10.0)

    def time_to_collision(_: Velocity) -> float:
        left_m = room_m - dock.distance_m(robot.map_from_base)
        return min(contact_s, left_m / DockingParams().controller.v_linear_max)

    for i in range(300):
        step = undocker.step(
            i * CONTROL_PERIOD_NS, PERIOD_S, robot.map_from_base, time_to_collision
        )
        if step.done:
            return robot, i * PERIOD_S
        robot.drive(step.velocity, PERIOD_S)
    raise AssertionError("never ended")


def test_undocking_drives_straight_back_to_the_staging_pose() -> None:
    robot, _ = undock()
    at = SE2(1.0, 1.0, 0.5).inverse() @ robot.map_from_base
    assert at.x_m == pytest.approx(-0.7, abs=0.05)
    assert at.y_m == pytest.approx(0.0, abs=0.01)


def test_undocking_ends_where_the_room_does() -> None:
    robot, _ = undock(room_m=0.6)
    assert 0.35 < SE2(1.0, 1.0, 0.5).distance_m(robot.map_from_base) < 0.6
    assert robot.velocity == STOP
    with pytest.raises(NavigationError, match="behind the robot"):
        undock(room_m=0.4)


def test_undocking_that_cannot_go_on_ends_with_its_code() -> None:
    with pytest.raises(NavigationError) as late:
        undock(stuck=True)
    # Nav2 says FAILED_TO_CONTROL for it.
    assert late.value.code is ErrorCode.DOCKING_TIMEOUT
    with pytest.raises(NavigationError) as blocked:
        undock(contact_s=0.2)
    assert blocked.value.code is ErrorCode.FAILED_TO_CONTROL


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (0.2, 0.6, -0.4), (0.0, -0.5, 1.0)])
@pytest.mark.parametrize("backward", [False, True])
def test_the_graceful_law_arrives_with_the_targets_heading(
    start: tuple[float, float, float], backward: bool
) -> None:
    target = SE2(-1.5, 0.1, 0.0) if backward else SE2(1.5, 0.1, 0.0)
    robot, params = Unicycle(SE2(*start)), GracefulParams()
    for _ in range(1000):
        to_target = robot.map_from_base.inverse() @ target
        if math.hypot(to_target.x_m, to_target.y_m) < 0.03:
            break
        velocity = graceful_velocity(params, to_target, backward)
        assert (velocity.linear_m_s < 0.0) is backward
        assert abs(velocity.angular_rad_s) <= params.v_angular_max + 1e-9
        robot.drive(velocity, PERIOD_S)
    assert robot.map_from_base.distance_m(target) < 0.03
    assert abs(robot.map_from_base.yaw_rad) < 0.1


@pytest.mark.parametrize("yaw_rad", [0.0, 2.5, -1.0])
def test_the_planar_pose_of_a_marker_faces_along_its_z_axis(yaw_rad: float) -> None:
    out = (math.cos(yaw_rad), math.sin(yaw_rad), 0.0)
    up = (0.0, 0.0, 1.0)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = np.cross(up, out), up, out
    matrix[:3, 3] = (1.0, 2.0, 0.3)
    assert planar_marker(matrix) == pytest.approx(SE2(1.0, 2.0, yaw_rad))
    with pytest.raises(ValueError, match="lies flat"):
        planar_marker(np.eye(4))
