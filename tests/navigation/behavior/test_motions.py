from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import TaskStatus
from mazebot.navigation.behavior.motions.assisted_teleop import AssistedTeleop
from mazebot.navigation.behavior.motions.back_up import BackUp, freer_drive
from mazebot.navigation.behavior.motions.drive_on_heading import DriveGoal, DriveOnHeading
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams, Motion
from mazebot.navigation.behavior.motions.spin import Spin, SpinGoal, freer_turn_rad
from mazebot.navigation.behavior.motions.wait import Wait
from mazebot.navigation.config import CONTROL_PERIOD_NS
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.messages import request_of
from tests.navigation.behavior.simulated_robot import Drive
from tests.navigation.driving import Unicycle

PARAMS = BehaviorServerParams()
PERIOD_S = CONTROL_PERIOD_NS * 1e-9
START = SE2(1.0, 2.0, 0.7)


def free(_: Velocity) -> float:
    return math.inf


def run(
    motion: Motion,
    robot: Unicycle,
    time_to_collision: Callable[[Velocity], float] = free,
    limit_s: float = 20.0,
) -> list[Velocity]:
    """Step a motion to its end; the commands."""
    commands: list[Velocity] = []
    for i in range(int(limit_s / PERIOD_S)):
        step = motion.step(
            i * CONTROL_PERIOD_NS, PERIOD_S, robot.map_from_base, robot.velocity, time_to_collision
        )
        if step.done:
            assert step.velocity == STOP
            robot.drive(STOP, 1.0)
            return commands
        commands.append(step.velocity)
        robot.drive(step.velocity, PERIOD_S)
    raise AssertionError(f"never ended: {motion.feedback}")


@pytest.mark.parametrize("angle_rad", [1.57, -1.57, 0.2, 7.0])
def test_spin_turns_by_its_angle_and_stands(angle_rad: float) -> None:
    robot = Unicycle(START)
    spin = Spin(PARAMS, SpinGoal(angle_rad))
    commands = run(spin, robot)
    assert spin.feedback == pytest.approx(angle_rad, abs=0.03)
    turned = robot.map_from_base.yaw_rad - START.yaw_rad - angle_rad
    assert math.sin(turned) == pytest.approx(0.0, abs=0.03)
    assert robot.map_from_base.distance_m(START) < 1e-9
    rates = [0.0, *(w for _, w in commands), 0.0]
    changes = [abs(b - a) for a, b in pairwise(rates)]
    assert max(changes) <= PARAMS.rotational_acc_lim * PERIOD_S + 1e-9
    assert max(abs(rate) for rate in rates) <= PARAMS.max_rotational_vel


@pytest.mark.parametrize(("distance_m", "speed_m_s"), [(0.3, 0.15), (-0.3, -0.15), (0.15, 0.025)])
def test_a_drive_ends_at_its_distance_and_stands(distance_m: float, speed_m_s: float) -> None:
    robot = Unicycle(START)
    drive = DriveOnHeading(PARAMS, DriveGoal(distance_m, speed_m_s))
    commands = run(drive, robot)
    along = START.inverse() @ robot.map_from_base
    assert along.x_m == pytest.approx(distance_m, abs=0.01)
    assert along.y_m == pytest.approx(0.0, abs=1e-9)
    # Nav2 drives 0.10 m/s where 0.025 are asked for.
    assert max(abs(v) for v, _ in commands) <= abs(speed_m_s) + 1e-9
    speeds = [0.0, *(v for v, _ in commands), 0.0]
    changes = [abs(b - a) for a, b in pairwise(speeds)]
    assert max(changes) <= PARAMS.acceleration_limit * PERIOD_S + 1e-9


@pytest.mark.parametrize(
    "motion", [Spin(PARAMS, SpinGoal(0.5)), DriveOnHeading(PARAMS, DriveGoal(0.1, 0.3))]
)
def test_a_motion_ends_when_the_robot_stands_not_when_it_was_told_to(motion: Motion) -> None:
    robot, slow = Unicycle(START), Unicycle(START)
    for i in range(200):
        step = motion.step(
            i * CONTROL_PERIOD_NS, PERIOD_S, robot.map_from_base, robot.velocity, free
        )
        if step.done:
            break
        # What comes after the behaviour brakes at a tenth of what it counts on.
        v, w = (
            last + min(max(wanted - last, -most * PERIOD_S), most * PERIOD_S)
            for wanted, last, most in zip(step.velocity, slow.velocity, (0.1, 0.2), strict=True)
        )
        slow.velocity = Velocity(v, w)
        robot.drive(slow.velocity, PERIOD_S)
    assert step.done
    assert abs(robot.velocity.linear_m_s) <= 0.05
    assert abs(robot.velocity.angular_rad_s) <= 0.15


def test_back_up_drives_back_whatever_the_signs() -> None:
    for goal in (DriveGoal(0.2, 0.1), DriveGoal(-0.2, -0.1), DriveGoal(0.2, -0.1)):
        robot = Unicycle(START)
        run(BackUp(PARAMS, goal), robot)
        assert (START.inverse() @ robot.map_from_base).x_m == pytest.approx(-0.2, abs=0.01)


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: DriveOnHeading(PARAMS, DriveGoal(0.3, -0.1)), 724),
        (lambda: DriveOnHeading(PARAMS, DriveGoal(0.3, 0.1, target_y_m=0.1)), 724),
        (lambda: BackUp(PARAMS, DriveGoal(0.3, 0.1, target_z_m=0.1)), 713),
        (lambda: BackUp(PARAMS, DriveGoal(0.0, 0.1)), 713),
    ],
)
def test_a_drive_that_makes_no_sense_is_refused(make: Callable[[], Motion], code: int) -> None:
    with pytest.raises(NavigationError) as caught:
        make()
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("motion", "code"),
    [
        (Spin(PARAMS, SpinGoal(1.57, time_allowance_s=2.0)), ErrorCode.SPIN_TIMEOUT),
        (BackUp(PARAMS, DriveGoal(0.3, 0.1, 2.0)), ErrorCode.BACKUP_TIMEOUT),
        (DriveOnHeading(PARAMS, DriveGoal(0.3, 0.1, 2.0)), ErrorCode.DRIVE_ON_HEADING_TIMEOUT),
        (AssistedTeleop(PARAMS, 2.0), ErrorCode.ASSISTED_TELEOP_TIMEOUT),
    ],
)
def test_a_robot_that_does_not_move_runs_out_of_time(motion: Motion, code: ErrorCode) -> None:
    with pytest.raises(NavigationError) as caught:
        run(motion, Unicycle(START, stuck=True), limit_s=2.2)
    assert caught.value.code is code


@pytest.mark.parametrize(
    "goal",
    [
        act.Spin(target_yaw_rad=1.57, time_allowance_s=0.0),
        act.BackUp(distance_m=0.1, speed_m_s=0.05, time_allowance_s=0.0),
        act.DriveOnHeading(distance_m=0.1, speed_m_s=0.05, time_allowance_s=0.0),
    ],
)
def test_a_time_allowance_of_0_is_no_limit(goal: act.ActionGoal) -> None:
    assert Drive().until_done(request_of(goal)).status is TaskStatus.SUCCEEDED


def test_teleoperation_without_a_time_allowance_goes_on() -> None:
    drive = Drive()
    assert drive.navigator.start(0, request_of(act.AssistedTeleop(time_allowance_s=0.0))) is None
    drive.run(2.0)
    assert not drive.results
    assert drive.navigator.running_tree() is not None


@pytest.mark.parametrize(
    ("motion", "code", "words"),
    [
        (Spin(PARAMS, SpinGoal(1.57)), 703, "turning left by 0.40 rad"),
        (BackUp(PARAMS, DriveGoal(0.3, 0.2)), 714, "obstacle 0.08 m behind"),
        (DriveOnHeading(PARAMS, DriveGoal(0.3, 0.2)), 723, "obstacle 0.08 m ahead"),
    ],
)
def test_a_collision_ahead_ends_a_motion_before_it_moves(
    motion: Motion, code: int, words: str
) -> None:
    robot = Unicycle(START)
    with pytest.raises(NavigationError, match=words) as caught:
        run(motion, robot, lambda _: 0.4)
    assert caught.value.code == code
    assert robot.map_from_base == START


def test_what_is_beyond_the_end_of_a_motion_does_not_stop_it() -> None:
    # 0.2 m at 0.2 m/s end after a second.
    run(DriveOnHeading(PARAMS, DriveGoal(0.2, 0.2)), Unicycle(START), lambda _: 1.2)


def test_collisions_are_not_looked_for_where_that_is_switched_off() -> None:
    goal = DriveGoal(0.2, 0.1, disable_collision_checks=True)
    run(BackUp(PARAMS, goal), Unicycle(START), lambda _: 0.0)
    spin = SpinGoal(0.5, disable_collision_checks=True)
    run(Spin(PARAMS, spin), Unicycle(START), lambda _: 0.0)


def test_a_recovery_spins_to_the_freer_side() -> None:
    def left_is_blocked(velocity: Velocity) -> float:
        return 0.3 if velocity.angular_rad_s > 0.0 else 0.9

    assert freer_turn_rad(1.57, PARAMS, left_is_blocked) == -1.57
    assert freer_turn_rad(-1.57, PARAMS, left_is_blocked) == -1.57
    assert freer_turn_rad(1.57, PARAMS, free) == 1.57


@pytest.mark.parametrize(
    ("behind_s", "ahead_s", "driven_m"),
    [
        (math.inf, math.inf, -0.3),
        (math.inf, 0.1, -0.3),
        (0.5, math.inf, 0.3),
        # 1 s at 0.15 m/s are 0.15 m; nine tenths of it are driven.
        (1.0, 0.2, -0.135),
        (0.2, 1.0, 0.135),
    ],
)
def test_a_recovery_drives_the_freer_way(behind_s: float, ahead_s: float, driven_m: float) -> None:
    def seconds(velocity: Velocity) -> float:
        return ahead_s if velocity.linear_m_s > 0.0 else behind_s

    robot = Unicycle(START)
    moved = [0.0]

    def from_here(velocity: Velocity) -> float:
        """What is in the way comes nearer as the robot drives toward it."""
        moved[0] = (START.inverse() @ robot.map_from_base).x_m
        passed_s = moved[0] / 0.15
        return seconds(velocity) - (passed_s if velocity.linear_m_s > 0.0 else -passed_s)

    run(freer_drive(DriveGoal(0.3, 0.15), PARAMS, seconds), robot, from_here)
    assert (START.inverse() @ robot.map_from_base).x_m == pytest.approx(driven_m, abs=0.01)


def test_wait_stands_for_its_time() -> None:
    wait = Wait(2.0)
    assert run(wait, Unicycle(START)) == [STOP] * 40
    assert wait.feedback == 0.0


def teleop(wanted: Velocity | None, contact_s: float) -> list[Velocity]:
    session = AssistedTeleop(PARAMS, 10.0)
    robot, commands = Unicycle(START), []
    for i in range(60):
        session.ask(wanted)
        step = session.step(
            i * CONTROL_PERIOD_NS,
            PERIOD_S,
            robot.map_from_base,
            robot.velocity,
            lambda _: contact_s,
        )
        commands.append(step.velocity)
    session.finish()
    assert session.step(60 * CONTROL_PERIOD_NS, PERIOD_S, START, STOP, free).done
    return commands


def test_teleoperation_drives_as_asked_within_the_limits() -> None:
    commands = teleop(Velocity(2.0, -0.5), math.inf)
    assert commands[-1] == pytest.approx((0.46, -0.5))
    assert commands[0].linear_m_s == pytest.approx(0.04)


def test_teleoperation_slows_down_before_a_collision() -> None:
    assert teleop(Velocity(0.4, 0.0), 0.25)[-1].linear_m_s == pytest.approx(0.1)
    assert teleop(Velocity(0.4, 0.0), 0.0)[-1] == STOP
    assert teleop(None, math.inf)[-1] == STOP
