from __future__ import annotations

import math

import numpy as np
import pytest

from services.common.error_codes import ErrorCode
from services.common.frames import SE2, wrap_angle
from services.navigation.collision import STOP, Surroundings
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.costmap import LayeredCostmap
from services.navigation.errors import NavigationError
from services.navigation.navigator import Goal, Navigator
from tests.navigation.driving import (
    IDENTITY,
    LOCATIONS,
    MAX_ACCEL_M_S2,
    MAX_ANGULAR_ACCEL_RAD_S2,
    MAX_ANGULAR_VEL_RAD_S,
    MAX_VEL_M_S,
    NO_ECHOES,
    START,
    TOUR,
    Log,
    Unicycle,
    box_segments,
    drive_navigator,
    house_costmap,
    wall_distance_m,
)
from tests.navigation.house_tour import (
    ANGLE_INCREMENT_RAD,
    BASE_FROM_SCAN,
    RANGE_MIN_M,
    as_ranges,
    cast,
    wall_segments,
)

CONFIG = NavigationConfig()


def navigator(config: NavigationConfig = CONFIG) -> tuple[Navigator, LayeredCostmap]:
    costmap = house_costmap(config)
    return Navigator(config.navigator(0.05), costmap), costmap


def see(costmap: LayeredCostmap, pose: SE2, box: tuple[float, float, float]) -> None:
    """Let the costmap see the house with a box in it."""
    segments = np.concatenate([wall_segments(), box_segments(*box)])
    ranges = as_ranges(cast(pose @ BASE_FROM_SCAN, segments), None)
    costmap.update(pose @ BASE_FROM_SCAN, ranges, 0.0, ANGLE_INCREMENT_RAD, RANGE_MIN_M)


@pytest.fixture(scope="module")
def tour() -> tuple[list[float], Log]:
    """The tour of the house with an exact pose: seconds for each goal, and what happened."""
    nav, costmap = navigator()
    robot, log, now_ns, times = Unicycle(START), Log(), 0, []
    for goal in TOUR:
        result, part = drive_navigator(nav, robot, goal, costmap, now_ns)
        assert result.error_code is ErrorCode.NONE
        assert result.number_of_recoveries == 0
        at_rest = Unicycle(robot.map_from_base, robot.velocity)
        at_rest.drive(STOP, 1.0)
        assert at_rest.map_from_base.distance_m(goal) < 0.08
        assert abs(wrap_angle(at_rest.map_from_base.yaw_rad - goal.yaw_rad)) < 0.08
        times.append((result.end_ns - result.start_ns) * 1e-9)
        now_ns = result.end_ns + CONTROL_PERIOD_NS
        log.poses += part.poses
        log.commands += part.commands
    return times, log


def test_the_tour_is_fast(tour: tuple[list[float], Log]) -> None:
    assert sum(tour[0]) < 90.0


def test_the_tour_keeps_off_the_walls(tour: tuple[list[float], Log]) -> None:
    # The robot's farthest corner is 0.237 m from base_footprint.
    assert wall_distance_m(tour[1].points_m()).min() > 0.28


def test_commands_respect_the_limits_of_the_robot(tour: tuple[list[float], Log]) -> None:
    commands = np.array(tour[1].commands)
    assert np.isfinite(commands).all()
    assert commands[:, 0].min() >= 0.0
    assert commands[:, 0].max() == pytest.approx(MAX_VEL_M_S)
    assert np.abs(commands[:, 1]).max() <= MAX_ANGULAR_VEL_RAD_S
    change = np.abs(np.diff(commands, axis=0)) / (CONTROL_PERIOD_NS * 1e-9)
    assert change[:, 0].max() <= MAX_ACCEL_M_S2 + 1e-6
    assert change[:, 1].max() <= MAX_ANGULAR_ACCEL_RAD_S2 + 1e-6


def test_the_robot_turns_before_it_drives_off_to_what_lies_behind() -> None:
    nav, costmap = navigator()
    _, log = drive_navigator(nav, Unicycle(START), LOCATIONS["location1"], costmap)
    first_move = next(i for i, command in enumerate(log.commands) if command.linear_m_s > 0.0)
    to_goal_rad = math.atan2(-1.178, -1.678)
    assert abs(wrap_angle(log.poses[first_move].yaw_rad - to_goal_rad)) < 0.3
    assert log.poses[first_move].distance_m(START) < 0.02


def test_a_goal_already_reached_succeeds_without_driving_away() -> None:
    nav, costmap = navigator()
    result, log = drive_navigator(nav, Unicycle(START), SE2(0.03, 0.0, 0.0), costmap)
    assert result.error_code is ErrorCode.NONE
    assert log.length_m() < 0.05


def test_a_refused_goal_leaves_the_one_before_as_it_was() -> None:
    nav, _ = navigator()
    nav.accept(0, Goal(LOCATIONS["location1"], 1), START)
    with pytest.raises(NavigationError) as caught:
        nav.accept(0, Goal(SE2(0.4, 0.55, 0.0), 2), START)
    assert caught.value.code is ErrorCode.GOAL_OCCUPIED
    assert nav.goal == Goal(LOCATIONS["location1"], 1)


def test_a_new_goal_preempts_the_old_one_without_a_stop() -> None:
    nav, costmap = navigator()
    robot = Unicycle(START)
    nav.accept(0, Goal(LOCATIONS["location3"], 1), START)
    now_ns = 0
    for _ in range(80):
        command = nav.step(
            now_ns, Surroundings(robot.map_from_base, costmap.master, NO_ECHOES), True
        ).command
        assert command is not None
        robot.drive(command, 0.05)
        now_ns += CONTROL_PERIOD_NS
    speed = robot.velocity.linear_m_s
    assert speed > 0.3
    old = nav.accept(now_ns, Goal(LOCATIONS["location4"], 2), robot.map_from_base)
    assert old is not None
    assert (old.goal.stamp_ns, old.error_code) == (1, ErrorCode.PREEMPTED)
    assert (old.start_ns, old.end_ns) == (0, now_ns)
    around = Surroundings(robot.map_from_base, costmap.master, NO_ECHOES)
    after = nav.step(now_ns, around, True)
    assert after.command is not None
    assert after.command.linear_m_s > speed - 0.1
    assert after.new_path is not None
    assert after.new_path.goal == pytest.approx(LOCATIONS["location4"])


@pytest.mark.parametrize("goal", LOCATIONS.values(), ids=LOCATIONS)
def test_speeds_keep_their_limits_also_where_steps_come_late(goal: SE2) -> None:
    nav, costmap = navigator()
    robot = Unicycle(START)
    nav.accept(0, Goal(goal, 1), START)
    limits, random = CONFIG.navigator(0.05).controller, np.random.default_rng(1)
    now_ns, before, fastest = 0, STOP, 0.0
    while nav.goal is not None:
        # As after a step that came late: the next one comes at its own time.
        elapsed_ns = int(random.choice([17, 33, 50, 67])) * 1_000_000
        now_ns += elapsed_ns
        assert now_ns < 60_000_000_000
        around = Surroundings(robot.map_from_base, costmap.master, NO_ECHOES)
        command = nav.step(now_ns, around, True).command
        assert command is not None
        most_s = min(elapsed_ns * 1e-9, 0.05) + 1e-9
        turn_rad_s = abs(command.angular_rad_s - before.angular_rad_s)
        assert abs(command.linear_m_s - before.linear_m_s) <= limits.max_linear_accel_m_s2 * most_s
        assert turn_rad_s <= limits.max_angular_accel_rad_s2 * most_s
        robot.drive(command, elapsed_ns * 1e-9)
        before, fastest = command, max(fastest, command.linear_m_s)
    assert fastest > 0.3


def test_recoveries_speed_up_within_their_limits_also_where_steps_come_late() -> None:
    nav, costmap = navigator()
    nav.accept(0, Goal(LOCATIONS["location3"], 1), START)
    random = np.random.default_rng(2)
    now_ns, before, commands = 0, STOP, []
    while nav.goal is not None:
        elapsed_ns = int(random.choice([17, 33, 50, 67])) * 1_000_000
        now_ns += elapsed_ns
        assert now_ns < 60_000_000_000
        # It stands, whatever it is told to do.
        outcome = nav.step(now_ns, Surroundings(START, costmap.master, NO_ECHOES), True)
        command = outcome.command
        assert command is not None
        most_s = min(elapsed_ns * 1e-9, 0.05) + 1e-9
        if nav.state == "recovering":
            # Where a recovery ends, the robot is stopped at once.
            assert abs(command.linear_m_s) - abs(before.linear_m_s) <= 1.0 * most_s
            faster_rad_s = abs(command.angular_rad_s) - abs(before.angular_rad_s)
            assert faster_rad_s <= MAX_ANGULAR_ACCEL_RAD_S2 * most_s
            commands.append(command)
        before = command
    assert min(command.linear_m_s for command in commands) == pytest.approx(-0.15)
    assert max(command.angular_rad_s for command in commands) > 0.5


def test_a_box_that_appears_on_the_path_is_driven_round() -> None:
    nav, costmap = navigator()
    robot = Unicycle(LOCATIONS["location1"])
    box = (-0.9, 0.9, 0.2)

    def look(now_ns: int) -> None:
        if now_ns > 3e9:
            see(costmap, robot.map_from_base, box)

    result, log = drive_navigator(nav, robot, LOCATIONS["location2"], costmap, each_period=look)
    assert result.error_code is ErrorCode.NONE
    from_box = np.maximum(np.abs(log.points_m() - box[:2]) - box[2] / 2, 0.0)
    assert np.linalg.norm(from_box, axis=1).min() > 0.23


def test_a_doorway_that_is_closed_ends_in_no_valid_path() -> None:
    nav, costmap = navigator()
    robot = Unicycle(START)
    # Fills the corridor south of Wall_22.
    box = (1.33, -0.87, 0.85)

    def look(_: int) -> None:
        see(costmap, robot.map_from_base, box)

    result, log = drive_navigator(
        nav, robot, LOCATIONS["location3"], costmap, each_period=look, limit_s=120.0
    )
    assert result.error_code is ErrorCode.NO_VALID_PATH
    assert result.number_of_recoveries == CONFIG.number_of_retries
    from_box = np.maximum(np.abs(log.points_m() - box[:2]) - box[2] / 2, 0.0)
    assert np.linalg.norm(from_box, axis=1).min() > 0.23
    assert nav.state == "idle"


def test_what_the_scan_saw_and_is_gone_is_cleared_by_the_first_recovery() -> None:
    nav, costmap = navigator()
    robot = Unicycle(START)
    see(costmap, SE2(0.6, -0.8, 0.0), (1.33, -0.87, 0.85))
    result, _ = drive_navigator(nav, robot, LOCATIONS["location3"], costmap)
    assert result.error_code is ErrorCode.NONE
    assert result.number_of_recoveries == 1


def test_a_stuck_robot_is_noticed_and_given_up_in_half_a_minute() -> None:
    nav, costmap = navigator()
    result, log = drive_navigator(nav, Unicycle(START, stuck=True), LOCATIONS["location3"], costmap)
    assert result.error_code is ErrorCode.FAILED_TO_MAKE_PROGRESS
    assert result.number_of_recoveries == 6
    assert result.end_ns <= 31_000_000_000
    # The recoveries were tried: the spin, and driving back.
    assert min(command.linear_m_s for command in log.commands) == pytest.approx(-0.15)


def test_a_robot_that_gets_loose_recovers() -> None:
    nav, costmap = navigator()
    robot = Unicycle(START, stuck=True)

    def loosen(now_ns: int) -> None:
        robot.stuck = now_ns < 6e9

    result, _ = drive_navigator(nav, robot, LOCATIONS["location3"], costmap, each_period=loosen)
    assert result.error_code is ErrorCode.NONE
    assert 1 <= result.number_of_recoveries <= 3


def test_a_lost_localisation_stops_the_robot_at_once_and_recovers_by_spinning() -> None:
    nav, costmap = navigator()
    nav.accept(0, Goal(LOCATIONS["location3"], 0), START)
    states, commands = [], []
    for i in range(200):
        around = Surroundings(START, costmap.master, NO_ECHOES)
        outcome = nav.step(i * CONTROL_PERIOD_NS, around, localized=i < 10)
        states.append(nav.state)
        commands.append(outcome.command)
    assert all(command == STOP for command in commands[10:30])
    assert "recovering" in states[30:35]
    assert any(command and command.angular_rad_s > 0.5 for command in commands[35:])
    assert all(command and command.linear_m_s == 0.0 for command in commands[10:])


def test_echoes_ahead_that_no_map_shows_stop_the_robot() -> None:
    nav, costmap = navigator()
    robot = Unicycle(SE2(-0.92, -0.5, math.pi / 2))
    wall_y_m = 0.6
    nav.accept(0, Goal(LOCATIONS["location2"], 0), robot.map_from_base)
    codes = []
    for i in range(300):
        xs = np.linspace(-1.6, -0.2, 100)
        ahead = np.stack([xs, np.full(100, wall_y_m)], axis=1)
        c, s = math.cos(robot.map_from_base.yaw_rad), math.sin(robot.map_from_base.yaw_rad)
        offset = ahead - np.array(robot.map_from_base[:2])
        echoes = np.ascontiguousarray(offset @ np.array([[c, -s], [s, c]]))
        around = Surroundings(robot.map_from_base, costmap.master, echoes)
        outcome = nav.step(i * CONTROL_PERIOD_NS, around, localized=True)
        robot.drive(outcome.command or STOP, 0.05)
        assert wall_y_m - robot.map_from_base.y_m > 0.22
        codes.append(nav.number_of_recoveries)
    assert max(codes) > 0


def test_no_goal_no_command() -> None:
    nav, costmap = navigator()
    outcome = nav.step(0, Surroundings(IDENTITY, costmap.master, NO_ECHOES), True)
    assert (outcome.command, outcome.new_path, outcome.result) == (None, None, None)
