"""Actions of a tree that run at once."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import NavigateToPose, TaskResult, TaskStatus
from mazebot.navigation.behavior.context import Dock
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.planning.path import PlannedPath
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.scripted_tree import Ticked
from tests.navigation.behavior.simulated_robot import Drive, SimulatedRobot
from tests.navigation.driving import LOCATIONS

GOAL = LOCATIONS["location1"]
PLAN = '<ComputePathToPose goal="{goal}" path="{path}"/>'
FOLLOW = '<FollowPath path="{path}"/>'
WAIT = '<Wait wait_duration="1"/>'


def all_of(*children: str) -> str:
    return f'<Parallel success_count="{len(children)}">{"".join(children)}</Parallel>'


def drive_by(inside: str, tmp_path: Path) -> tuple[Drive, TaskResult]:
    file = tmp_path / "tree.xml"
    file.write_text(document(inside), "utf-8")
    drive = Drive()
    return drive, drive.until_done(NavigateToPose(GOAL, str(file)), limit_s=40.0)


@pytest.mark.parametrize(
    "inside",
    [
        f"<Sequence>{PLAN}{all_of(WAIT, FOLLOW)}</Sequence>",
        f"<Sequence>{PLAN}{all_of(FOLLOW, WAIT)}</Sequence>",
        '<PipelineSequence><RateController hz="0.3"><Sequence>'
        f'{PLAN}<Wait wait_duration="1"/></Sequence></RateController>{FOLLOW}</PipelineSequence>',
        f'<PipelineSequence>{PLAN}<ForceSuccess><Timeout msec="500"><Wait wait_duration="5"/>'
        f"</Timeout></ForceSuccess>{FOLLOW}</PipelineSequence>",
        f"<Sequence>{PLAN}{all_of(FOLLOW, '<CancelWait/>', '<CancelSpin/>')}</Sequence>",
    ],
)
def test_what_ends_beside_a_path_leaves_it_followed(inside: str, tmp_path: Path) -> None:
    drive, result = drive_by(inside, tmp_path)
    assert result.status is TaskStatus.SUCCEEDED
    assert drive.robot.robot.map_from_base.distance_m(GOAL) < 0.06


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("beside", ["Wait", "AssistedTeleop"])
def test_what_commands_nothing_leaves_the_robot_to_what_does(
    beside: str, first: bool, tmp_path: Path
) -> None:
    port = "wait_duration" if beside == "Wait" else "time_allowance"
    children = [f'<{beside} {port}="30"/>', '<Spin spin_dist="1.57"/>']
    if not first:
        children.reverse()
    inside = f'<Parallel success_count="1">{"".join(children)}</Parallel>'
    drive, result = drive_by(inside, tmp_path)
    assert result.status is TaskStatus.SUCCEEDED
    assert drive.now_s < 5.0
    assert drive.robot.robot.map_from_base.yaw_rad == pytest.approx(1.57, abs=0.05)


@pytest.mark.parametrize(
    ("kind", "running"),
    [
        ("CancelControl", FOLLOW),
        ("CancelSpin", '<Spin spin_dist="6.28"/>'),
        ("CancelWait", '<Wait wait_duration="30"/>'),
        ("CancelBackUp", '<BackUp backup_dist="0.3" backup_speed="0.05"/>'),
        ("CancelDriveOnHeading", '<DriveOnHeading dist_to_travel="0.3" speed="0.05"/>'),
        ("CancelAssistedTeleop", '<AssistedTeleop time_allowance="30"/>'),
    ],
)
@pytest.mark.parametrize("first", [True, False])
def test_a_canceled_action_succeeds_and_the_robot_stands(
    kind: str, running: str, first: bool, tmp_path: Path
) -> None:
    cancel = f'<Sequence><Sleep msec="1500"/><{kind}/></Sequence>'
    children = (cancel, running) if first else (running, cancel)
    drive, result = drive_by(f"<Sequence>{PLAN}{all_of(*children)}</Sequence>", tmp_path)
    assert (result.status, result.error_code) == (TaskStatus.SUCCEEDED, 0)
    assert drive.now_s < 2.0
    assert drive.commands[-1] == STOP
    assert drive.robot.robot.map_from_base.distance_m(GOAL) > 0.5


def test_another_kind_is_not_canceled(tmp_path: Path) -> None:
    cancels = "".join(f"<Cancel{kind}/>" for kind in ("Control", "Wait", "BackUp"))
    cancel = f'<Sequence><Sleep msec="500"/>{cancels}</Sequence>'
    drive, result = drive_by(all_of('<Spin spin_dist="1.57"/>', cancel), tmp_path)
    assert result.status is TaskStatus.SUCCEEDED
    assert drive.robot.robot.map_from_base.yaw_rad == pytest.approx(1.57, abs=0.05)


@pytest.mark.parametrize("kind", [FOLLOW, '<Spin spin_dist="1.57"/>'])
def test_a_newer_action_of_a_kind_preempts_the_one_that_runs(kind: str, tmp_path: Path) -> None:
    later = f'<Sequence><Sleep msec="500"/>{kind}</Sequence>'
    _, result = drive_by(f"<Sequence>{PLAN}{all_of(kind, later)}</Sequence>", tmp_path)
    assert (result.status, result.error_code) == (TaskStatus.FAILED, ErrorCode.PREEMPTED)
    assert "preempted by another" in result.error_msg
    one = f'<Parallel success_count="1" failure_count="2">{kind}{later}</Parallel>'
    drive, result = drive_by(f"<Sequence>{PLAN}{one}</Sequence>", tmp_path)
    assert result.status is TaskStatus.SUCCEEDED
    if kind == FOLLOW:
        assert drive.robot.robot.map_from_base.distance_m(GOAL) < 0.06


def test_two_that_drive_at_once_are_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spin, back_up = '<Spin spin_dist="1.57"/>', '<BackUp backup_dist="0.1" backup_speed="0.1"/>'
    with caplog.at_level(logging.WARNING, "navigation"):
        drive, _ = drive_by(all_of(spin, back_up), tmp_path)
        assert [one.getMessage() for one in caplog.records if "at once" in one.getMessage()] == [
            "Spin 'Spin' and BackUp 'BackUp' drive the robot at once: "
            "it obeys the one that is ticked last"
        ]
        caplog.clear()
        # One after the other in one tick is no conflict.
        drive, _ = drive_by(f"<Sequence>{spin}{back_up}{PLAN}{FOLLOW}</Sequence>", tmp_path)
    assert not caplog.records
    assert drive.robot.robot.map_from_base.distance_m(GOAL) < 0.06


def test_a_motion_that_is_halted_stops_in_the_same_period(tmp_path: Path) -> None:
    drive = Drive()
    file = tmp_path / "tree.xml"
    halted = (
        '<Parallel success_count="1"><Spin spin_dist="6.28"/><Wait wait_duration="1"/></Parallel>'
    )
    file.write_text(document(f'<Sequence>{halted}<Sleep msec="500"/></Sequence>'), "utf-8")
    drive.until_done(NavigateToPose(GOAL, str(file)))
    ended = round(1.0 / 0.05)
    assert drive.commands[ended - 1].angular_rad_s > 0.5
    assert set(drive.commands[ended:]) == {STOP}


def test_the_way_to_a_dock_preempts_the_path_beside_it(tmp_path: Path) -> None:
    marker_from_dock = SE2(0.8, 0.0, math.pi)
    docked = GOAL @ SE2(0.7, 0.0, 0.0)
    drive = Drive()
    drive.robot.docks.known["home"] = Dock(
        "7", docked @ marker_from_dock.inverse(), marker_from_dock
    )
    file = tmp_path / "tree.xml"
    both = all_of(FOLLOW, '<DockRobot dock_id="home"/>')
    file.write_text(document(f"<Sequence>{PLAN}{both}</Sequence>"), "utf-8")
    result = drive.until_done(NavigateToPose(LOCATIONS["location3"], str(file)))
    assert result.error_code == ErrorCode.PREEMPTED
    assert drive.commands[-1] == STOP


def test_a_path_that_something_has_dropped_ends_following_it() -> None:
    robot = SimulatedRobot()
    tree = Ticked("FollowPath", robot=robot, path="{path}", error_code_id="{code}")
    path = robot.compute_path(None, (GOAL,), "")
    assert isinstance(path, PlannedPath)
    tree.blackboard.set("path", path)
    assert tree.ticks(2) == "RR"
    robot.stop()
    assert tree.tick() == "F"
    assert tree.blackboard.get("code") == ErrorCode.INVALID_PATH


def test_a_wait_for_less_than_nothing_is_as_long(caplog: pytest.LogCaptureFixture) -> None:
    tree = Ticked("Wait", robot=SimulatedRobot(), wait_duration="-0.1")
    assert tree.ticks(3) == "RRS"
    assert "wait_duration is -0.1: waits for 0.1 s" in caplog.text
