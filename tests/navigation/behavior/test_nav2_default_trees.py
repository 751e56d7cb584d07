"""Nav2's default trees run, and end as Nav2's would."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import NavigateThroughPoses, NavigateToPose
from mazebot.navigation.behavior.engine.tree import NodeStatus
from tests.navigation.behavior.nav2_default_trees import NAV_THROUGH_POSES, NAV_TO_POSE
from tests.navigation.behavior.simulated_robot import Box, Drive, SimulatedRobot
from tests.navigation.driving import LOCATIONS, START, Unicycle

NEAR, FAR = LOCATIONS["location1"], LOCATIONS["location3"]
DOOR: Box = (1.33, -0.87, 0.85)


@pytest.fixture
def to_pose(tmp_path: Path) -> str:
    path = tmp_path / "to_pose.xml"
    path.write_text(NAV_TO_POSE)
    return str(path)


def test_it_drives_to_a_pose(to_pose: str) -> None:
    drive = Drive()
    result = drive.until_done(NavigateToPose(NEAR, to_pose))
    assert (result.error_code, result.number_of_recoveries) == (0, 0)
    assert drive.robot.robot.map_from_base.distance_m(NEAR) < 0.06
    # Nearer than 4 m a path that is free is kept.
    assert drive.robot.plans == 1


def test_farther_than_4_m_it_plans_each_second(to_pose: str) -> None:
    drive = Drive(SimulatedRobot(Unicycle(NEAR)))
    drive.navigator.start(0, NavigateToPose(FAR, to_pose))
    drive.run(4.0)
    assert drive.robot.plans == 4


def test_a_box_on_the_way_is_driven_round(to_pose: str) -> None:
    drive = Drive(SimulatedRobot(Unicycle(NEAR)))
    box = (-0.9, 0.9, 0.2)
    drive.robot.boxes = [box]
    result = drive.until_done(NavigateToPose(LOCATIONS["location2"], to_pose))
    assert result.error_code == 0
    assert drive.nearest_m(box) > 0.23


def test_every_retry_is_used_where_the_way_is_closed(to_pose: str) -> None:
    drive = Drive()
    drive.robot.boxes = [DOOR]
    result = drive.until_done(NavigateToPose(FAR, to_pose))
    assert result.error_code == ErrorCode.NO_VALID_PATH
    # In Nav2 the fourth recovery, BackUp, ends the navigation by accident: the fifth and the sixth
    # are the first two again.
    assert result.number_of_recoveries >= 6
    backed_up = next(i for i, (v, _) in enumerate(drive.commands) if v < -0.1)
    turned = [i for i, (_, w) in enumerate(drive.commands) if abs(w) > 0.9]
    assert turned[0] < backed_up < turned[-1]


def test_a_goal_occupied_ends_at_once_without_a_spin(to_pose: str) -> None:
    drive = Drive()
    drive.navigator.start(0, NavigateToPose(NEAR, to_pose))
    drive.run(3.0)
    # Seen by the costmap only now.
    drive.robot.boxes = [(NEAR.x_m, NEAR.y_m, 0.2)]
    begun = len(drive.commands)
    result = drive.finish()
    assert result.error_code == ErrorCode.GOAL_OCCUPIED
    assert result.end_ns < 6_000_000_000
    assert all(abs(w) < 0.9 for _, w in drive.commands[begun:])


def test_a_failure_that_was_overcome_causes_no_recovery_later(to_pose: str) -> None:
    in_view = SE2(-0.8, -0.59, 0.0)
    drive = Drive(SimulatedRobot(Unicycle(START, stuck=True)))
    drive.navigator.start(0, NavigateToPose(in_view, to_pose))

    def spins() -> bool:
        nodes = {one.kind: one.status for one in drive.navigator.snapshot()}
        return nodes.get("Spin") is NodeStatus.RUNNING

    while not spins():
        drive.step()
    # It spins, since the controller has failed. Meanwhile something comes to stand on the goal.
    drive.robot.robot.stuck = False
    drive.robot.boxes = [(in_view.x_m, in_view.y_m, 0.2)]
    result = drive.finish()
    assert result.error_code == ErrorCode.GOAL_OCCUPIED
    # Neither the wait nor the drive back that would come next.
    spun = [i for i, (_, w) in enumerate(drive.commands) if abs(w) > 0.1]
    assert len(drive.commands) - spun[-1] < 10
    assert min(v for v, _ in drive.commands) >= 0.0


def test_it_drives_through_poses(tmp_path: Path) -> None:
    path = tmp_path / "through_poses.xml"
    path.write_text(NAV_THROUGH_POSES)
    drive = Drive()
    result = drive.until_done(NavigateThroughPoses((NEAR, LOCATIONS["location2"]), str(path)))
    assert result.error_code == 0
    assert min(pose.distance_m(NEAR) for pose in drive.poses) <= 0.7
