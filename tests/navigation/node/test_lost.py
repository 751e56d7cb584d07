"""What a robot does that does not know where it is: with a task that needs a pose, with one that
does not, and without any.
"""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    CLEAR_COSTMAP,
    CMD_VEL,
    CMD_VEL_TELEOP,
    LOCALIZATION_STATUS,
    SEND_GOAL,
)
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.messages import planar_document
from tests.navigation.driving import LOCATIONS, NodeDriver, asked, ready

CARRIED_TO = SE2(-1.678, -1.178, 1.0)


@pytest.fixture
def lost() -> NodeDriver:
    """A robot that was carried elsewhere, and searches for its pose."""
    driver = ready()
    driver.robot.map_from_base = CARRIED_TO
    while not driver.of(LOCALIZATION_STATUS)[-1].wants_motion:
        driver.step()
        assert driver.now_ns < 10_000_000_000
    driver.sent.clear()
    return driver


def commands(driver: NodeDriver) -> list[Velocity]:
    told = [message.twist for message in driver.of(CMD_VEL)]
    return [Velocity(twist.linear.x, twist.angular.z) for twist in told]


def drive_by_hand(driver: NodeDriver, linear_m_s: float, steps: int) -> None:
    """A person holds a velocity for some control periods."""
    for _ in range(steps):
        twist = msg.Twist(
            linear=msg.Vector3(linear_m_s, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.0)
        )
        header = msg.header(driver.now_ns, "base_footprint")
        driver.deliver(CMD_VEL_TELEOP, msg.TwistStamped(header=header, twist=twist))
        driver.step()


def start(driver: NodeDriver, goal: act.ActionGoal) -> None:
    assert asked(driver, SEND_GOAL, act.SendGoal(goal_id="a", goal=goal)).accepted


@pytest.mark.parametrize(
    ("goal", "most"),
    [
        (act.Wait(duration_s=3.0), Velocity(0.0, 0.0)),
        (act.Spin(target_yaw_rad=0.5), Velocity(0.0, 1.0)),
        (act.DriveOnHeading(distance_m=0.1, speed_m_s=0.05), Velocity(0.05, 0.0)),
        (act.BackUp(distance_m=0.1, speed_m_s=0.05), Velocity(0.05, 0.0)),
    ],
)
def test_a_motion_that_needs_no_pose_is_driven_as_it_is_asked_for(
    lost: NodeDriver, goal: act.ActionGoal, most: Velocity
) -> None:
    start(lost, goal)
    while not lost.of(ACTION_RESULT):
        lost.step()
    assert [one.status for one in lost.of(ACTION_RESULT)] == ["succeeded"]
    for command in commands(lost):
        assert abs(command.linear_m_s) <= most.linear_m_s + 1e-9
        assert abs(command.angular_rad_s) <= most.angular_rad_s + 1e-9


def test_a_task_that_needs_a_pose_is_held_and_the_robot_searches(lost: NodeDriver) -> None:
    start(lost, act.NavigateToPose(pose=planar_document(LOCATIONS["location1"])))
    lost.run(1.0)
    assert any(map(any, commands(lost)))


@pytest.mark.parametrize("assisted", [True, False])
def test_a_person_who_drives_is_obeyed(lost: NodeDriver, assisted: bool) -> None:
    if assisted:
        start(lost, act.AssistedTeleop(time_allowance_s=30.0))
    drive_by_hand(lost, 0.0, 40)
    assert not any(map(any, commands(lost)[20:]))
    drive_by_hand(lost, 0.05, 20)
    assert commands(lost)[-1] == pytest.approx(Velocity(0.05, 0.0))


def test_a_search_that_finds_no_motion_forgets_where_the_robot_could_not_go_on(
    lost: NodeDriver,
) -> None:
    drive = lost.node._drive
    assert drive is not None
    turns_rad = np.linspace(0.0, 2.0 * np.pi, 80)
    around_m = 0.26 * np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
    ring_m = moved_points(around_m, lost.odom_from_base, SE2(0.0, 0.0, 0.0))
    drive.hidden.touch(ring_m)
    drive.robot.local_costmap.mark_touched(ring_m)
    start(lost, act.NavigateToPose(pose=planar_document(LOCATIONS["location1"])))
    lost.run(8.0)
    assert any(map(any, commands(lost)[-40:]))
    assert not len(drive.hidden.touched_m)


def test_a_lost_robot_clears_what_needs_no_pose_and_nothing_by_halves(lost: NodeDriver) -> None:
    drive = lost.node._drive
    assert drive is not None
    touched_m = np.array([[lost.odom_from_base.x_m + 0.6, lost.odom_from_base.y_m]])
    drive.hidden.touch(touched_m)
    drive.robot.local_costmap.mark_touched(touched_m)
    before = drive.robot.local_costmap.revision
    near = asked(lost, CLEAR_COSTMAP, act.ClearCostmap(area="around_robot"))
    assert "not localized" in near.error
    assert drive.robot.local_costmap.revision == before
    assert asked(lost, CLEAR_COSTMAP, act.ClearCostmap()).error == ""
    assert not len(drive.hidden.touched_m)
