"""Both controllers drive: to goals in the house, through narrow places, and by what moves."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity
from mazebot.navigation.control.controller import Controller, Robot, RobotLimits
from mazebot.navigation.control.controllers import make_controller
from mazebot.navigation.control.goal_checker import GoalCheckerParams
from mazebot.navigation.control.mppi.clearance_window import ClearanceWindow
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.layered_costmap import Costmap, LayeredCostmap, frame_of
from mazebot.navigation.planning.path import PlannedPath, path_through, resample
from tests.navigation.control.judge import Drive, drive
from tests.navigation.driving import LOCATIONS, NO_ECHOES, START, Unicycle, house_costmap
from tests.navigation.house_tour import wall_segments

NAMES = ["mppi", "regulated_pure_pursuit"]
OPEN_M = 4.0


def made(name: str, seed: int = 1, **params: object) -> Controller:
    return make_controller(name, params, Robot(), np.random.default_rng(seed))


def room(*boxes_m: tuple[float, float, float, float]) -> tuple[Costmap, Array]:
    """A room 4 m square from the origin on with boxes (x0, y0, x1, y1), and all their faces."""
    cells = np.zeros((80, 80), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    faces = []
    for x0, y0, x1, y1 in (*boxes_m, (0.0, 0.0, OPEN_M, OPEN_M)):
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        faces += [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    for x0, y0, x1, y1 in boxes_m:
        cells[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = 100
    params = NavigationConfig().global_costmap
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(frame, cells, params.inflation_layer, params.obstacle_layer).master
    return costmap, np.array(faces)


def line(*points_m: tuple[float, float], yaw_rad: float = 0.0) -> PlannedPath:
    return path_through(resample(np.array(points_m), 0.05), yaw_rad)


@cache
def to_location(name: str, location: str) -> Drive:
    costmap = house_costmap(NavigationConfig()).master
    noise = np.random.default_rng(1)
    return drive(
        made(name), costmap, Unicycle(START), LOCATIONS[location], wall_segments(), noise=noise
    )


@pytest.mark.parametrize("name", NAMES)
def test_goals_in_the_house_are_reached_by_short_ways_and_without_a_touch(name: str) -> None:
    told = to_location(name, "location3")
    goal = LOCATIONS["location3"]
    assert told.reached
    assert told.spl > 0.97
    assert min(told.clearances_m) > 0.08
    assert told.seconds < 17.0
    assert told.reversals() <= 3
    assert told.poses[-1].distance_m(goal) < 0.06
    assert abs(wrap_angle(told.poses[-1].yaw_rad - goal.yaw_rad)) < 0.06


@pytest.mark.parametrize("name", NAMES)
def test_commands_keep_the_limits_and_end_in_a_stop(name: str) -> None:
    commands = np.array(to_location(name, "location3").commands)
    assert np.abs(commands[:, 0]).max() <= 0.46 + 1e-9
    assert np.abs(commands[:, 1]).max() <= 1.9 + 1e-9
    change = np.abs(np.diff(commands, axis=0)) / 0.05
    assert change[:, 0].max() <= 1.0 + 1e-6
    assert change[:, 1].max() <= 2.0 + 1e-6
    assert tuple(commands[-1]) == STOP


def test_each_command_of_mppi_keeps_its_own_limits() -> None:
    """Turns at the start and at the goal, the way between them, and braking before a zone."""
    costmap, faces = room()
    gentle: dict[str, Any] = {
        "vx_max": 0.3, "wz_max": 0.5, "ax_max": 0.5, "ax_min": -0.3, "az_max": 0.8
    }  # fmt: skip
    told = drive(
        made("mppi", **gentle), costmap, Unicycle(SE2(1.0, 1.0, -2.5)), SE2(3.0, 2.0, 2.5), faces,
        path=line((1.0, 1.0), (3.0, 2.0), yaw_rad=2.5), limit_s=40.0,
        speed_limit_m_s=lambda now_s: 0.1 if now_s > 10.0 else math.inf,
    )  # fmt: skip
    commands = np.array(told.commands)
    changes = np.diff(np.concatenate([[STOP], commands]), axis=0) / 0.05
    assert told.reached
    assert commands[:, 0].max() <= 0.3 + 1e-9
    assert np.abs(commands[:, 1]).max() == pytest.approx(0.5)
    assert changes[:, 0].max() <= 0.5 + 1e-6
    assert changes[:, 0].min() == pytest.approx(-0.3)
    assert np.abs(changes[:, 1]).max() <= 0.8 + 1e-6


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("angle_rad", [0.05, 0.15, 0.785])
def test_a_turn_to_the_path_ends_before_the_robot_drives(name: str, angle_rad: float) -> None:
    costmap, faces = room()
    told = drive(
        made(name, rotate_to_heading_min_angle=angle_rad), costmap, Unicycle(SE2(1.0, 1.0, -1.0)),
        SE2(3.0, 1.0, 0.0), faces, path=line((1.0, 1.0), (3.0, 1.0)), limit_s=40.0,
    )  # fmt: skip
    assert told.reached
    speeds = [command.linear_m_s for command in told.commands[:40]]
    begins = next(at for at, speed in enumerate(speeds) if speed > 0.0)
    assert begins > 10
    assert min(speeds[begins:]) > 0.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("decel", [0.1, 0.3, 0.6])
def test_a_robot_that_brakes_gently_does_not_pass_its_goal(name: str, decel: float) -> None:
    costmap, faces = room()
    gentle = Robot(RobotLimits(max_linear_accel=decel, max_angular_accel=0.3))
    controller = make_controller(name, {}, gentle, np.random.default_rng(1))
    path = line((0.5, 1.0), (2.5, 1.0), yaw_rad=1.0)
    robot = Unicycle(SE2(0.5, 1.0, 0.0))
    told = drive(controller, costmap, robot, path.goal, faces, path=path, limit_s=40.0)
    assert told.reached
    assert max(pose.x_m for pose in told.poses) < 2.5 + 0.06


def test_a_robot_that_may_not_drive_back_leaves_a_narrow_place_by_a_turn() -> None:
    costmap, _ = room()
    path = line((2.0, 2.0), (1.7, 2.0), (1.7, 3.0), yaw_rad=math.pi / 2)
    yaws_rad = path.yaws_rad.copy()
    yaws_rad[path.along_m < 0.29] = 0.0
    path = PlannedPath(path.points_m, yaws_rad, path.along_m, way_out_m=0.3)
    for vx_min, speed_m_s in ((0.0, 0.0), (-0.05, -0.05)):
        controller, robot = made("mppi", vx_min=vx_min), Unicycle(SE2(2.0, 2.0, 0.0))
        controller.set_path(path, same_goal=False)
        speeds = []
        for _ in range(20):
            around = Surroundings(robot.map_from_base, costmap, NO_ECHOES)
            command = controller.step(0.05, around).velocity
            robot.drive(command, 0.05)
            speeds.append(command.linear_m_s)
        assert min(speeds) == pytest.approx(speed_m_s)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width_m", [0.5, 0.6])
def test_a_corridor_that_the_robot_fits_is_driven_through_round_a_bend(
    name: str, width_m: float
) -> None:
    low, high = 1.0 - width_m / 2.0, 1.0 + width_m / 2.0
    left, right = 3.0 - width_m / 2.0, 3.0 + width_m / 2.0
    costmap, faces = room((1.0, 0.0, 4.0, low), (1.0, high, left, 3.2), (right, low, 4.0, 3.2))
    path = line((0.5, 1.0), (3.0, 1.0), (3.0, 3.5), yaw_rad=math.pi / 2)
    robot = Unicycle(SE2(0.5, 1.03, 0.1))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=30.0)
    assert told.reached
    assert min(told.clearances_m) > 0.02


@pytest.mark.parametrize("name", NAMES)
def test_a_way_that_is_closed_stops_the_robot_before_it(name: str) -> None:
    costmap, faces = room((2.5, 0.0, 2.7, 4.0))
    path = line((0.5, 1.0), (3.5, 1.0))
    robot = Unicycle(SE2(0.5, 1.0, 0.0))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=8.0)
    assert not told.reached
    assert min(told.clearances_m) > 0.0
    assert abs(robot.velocity.linear_m_s) < 0.05


@pytest.mark.parametrize("name", NAMES)
def test_a_box_on_the_path_that_only_the_scan_sees_is_not_touched(name: str) -> None:
    costmap, _ = room()
    _, faces = room((1.9, 0.9, 2.1, 1.15))
    path = line((0.5, 1.0), (3.5, 1.0))
    robot = Unicycle(SE2(0.5, 1.0, 0.0))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=20.0)
    assert min(told.clearances_m) > 0.0
    if name == "mppi":
        assert told.reached


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_that_touches_a_wall_can_leave_it(name: str) -> None:
    costmap, faces = room()
    # Its front corner is 1 cm inside the first row of cells.
    robot = Unicycle(SE2(0.5, 0.19, 0.0))
    path = line((0.5, 0.19), (1.0, 0.5), (2.5, 1.0))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=20.0)
    assert told.reached


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("back", [True, False])
def test_a_straight_way_out_is_driven_before_a_turn(name: str, back: bool) -> None:
    costmap, _ = room()
    path = line((1.5, 2.0), (1.8, 2.0), (1.8, 3.0), yaw_rad=math.pi / 2)
    yaws_rad = path.yaws_rad.copy()
    yaws_rad[path.along_m < 0.29] = math.pi if back else 0.0
    controller = made(name)
    controller.set_path(
        PlannedPath(path.points_m, yaws_rad, path.along_m, way_out_m=0.3), same_goal=False
    )
    robot = Unicycle(SE2(1.5, 2.0, math.pi if back else 0.0))
    for _ in range(40):
        velocity = controller.step(
            0.05, Surroundings(robot.map_from_base, costmap, NO_ECHOES)
        ).velocity
        robot.drive(velocity, 0.05)
        if robot.map_from_base.x_m > 1.75:
            break
        assert velocity.linear_m_s * (-1.0 if back else 1.0) > 0.0
        assert abs(velocity.angular_rad_s) < 1e-6
    assert robot.map_from_base.x_m > 1.7


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("back_to_m", [0.8, 1.2])
def test_a_goal_on_the_way_to_where_the_path_turns_back_is_reached_after_it(
    name: str, back_to_m: float
) -> None:
    """Also where little of the path is left there, and where the robot stands on it."""
    costmap, faces = room()
    path = line((0.8, 2.0), (1.6, 2.0), (back_to_m, 2.0))
    robot = Unicycle(SE2(0.8, 2.0, 0.0))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=20.0)
    assert told.reached
    assert max(pose.x_m for pose in told.poses) > 1.4
    assert told.poses[-1].distance_m(path.goal) < 0.12


ROUNDS_M = {
    "circle": [(0.25 * math.sin(a), -0.25 * math.cos(a)) for a in np.linspace(0.0, math.tau, 33)],
    "eight": [
        *((0.2 * math.sin(a), 0.2 - 0.2 * math.cos(a)) for a in np.linspace(0.0, math.tau, 26)),
        *((0.2 * math.sin(a), 0.2 * math.cos(a) - 0.2) for a in np.linspace(0.0, math.tau, 26)),
    ],
    "square": [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.0, 0.3), (0.0, 0.0)],
    "hairpin": [(0.0, 0.0), (0.5, 0.0), (0.5, 0.3), (0.0, 0.3)],
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shape", ROUNDS_M)
def test_a_path_that_comes_back_is_driven_all_along(name: str, shape: str) -> None:
    costmap, faces = room()
    points_m = resample(np.array(ROUNDS_M[shape]) + 2.0, 0.05)
    path = path_through(points_m, 0.0)
    x_m, y_m = points_m[0].tolist()
    robot = Unicycle(SE2(x_m, y_m, float(path.yaws_rad[0])))
    told = drive(made(name), costmap, robot, path.goal, faces, path=path, limit_s=25.0)
    assert told.reached
    driven_m = np.array([pose[:2] for pose in told.poses])
    away_m = np.linalg.norm(points_m[:, None] - driven_m, axis=2).min(1)
    assert away_m.max() < 0.2


@pytest.mark.parametrize("name", NAMES)
def test_the_goal_is_reached_only_when_the_robot_stands(name: str) -> None:
    costmap, _ = room()
    controller = made(name)
    path = line((1.0, 1.0), (1.5, 1.0))
    controller.set_path(path, same_goal=False)
    still = Surroundings(path.goal, costmap, NO_ECHOES, velocity=Velocity(0.2, 0.0))
    assert not any(controller.step(0.05, still).reached for _ in range(40))
    stands = Surroundings(path.goal, costmap, NO_ECHOES, velocity=STOP)
    assert controller.step(0.05, stands).reached


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("stateful", [True, False])
def test_a_robot_does_not_turn_to_a_goal_of_which_only_the_position_counts(
    name: str, stateful: bool
) -> None:
    costmap, _ = room()
    checker = GoalCheckerParams(position_only=True, stateful=stateful)
    robot = Robot(RobotLimits(general_goal_checker=checker))
    controller = make_controller(name, {}, robot, np.random.default_rng(1))
    path = line((1.0, 1.0), (1.5, 1.0), yaw_rad=2.0)
    controller.set_path(path, same_goal=False)
    there = Surroundings(SE2(1.5, 1.0, 0.0), costmap, NO_ECHOES, velocity=STOP)
    made = controller.step(0.05, there)
    assert (made.reached, made.velocity) == (True, STOP)


@pytest.mark.parametrize("name", NAMES)
def test_a_new_path_to_the_same_goal_keeps_what_was_reached(name: str) -> None:
    costmap, _ = room()
    controller = made(name)
    path = line((1.0, 1.0), (1.5, 1.0), yaw_rad=1.0)
    controller.set_path(path, same_goal=False)
    controller.step(0.05, Surroundings(SE2(1.5, 1.0, 0.0), costmap, NO_ECHOES))
    assert controller.xy_reached
    controller.set_path(path, same_goal=True)
    assert controller.xy_reached
    controller.set_path(path, same_goal=False)
    assert not controller.xy_reached
    controller.stop()
    assert controller.path is None
    with pytest.raises(ValueError, match="no path"):
        controller.step(0.05, Surroundings(SE2(1.5, 1.0, 0.0), costmap, NO_ECHOES))


@pytest.mark.parametrize("name", NAMES)
def test_the_speed_limit_of_a_place_is_kept(name: str) -> None:
    costmap, faces = room()
    controller = made(name)
    path = line((0.5, 1.0), (3.5, 1.0))
    told = drive(
        controller, costmap, Unicycle(SE2(0.5, 1.0, 0.0)), path.goal, faces, path=path,
        limit_s=30.0, speed_limit_m_s=lambda now_s: 0.15 if now_s > 3.0 else math.inf,
    )  # fmt: skip
    speeds = np.array(told.commands)[:, 0]
    assert told.reached
    assert speeds[:60].max() > 0.35
    assert speeds[70:].max() <= 0.15 + 1e-6


def crossing(controller: Controller, predicted: bool) -> Drive:
    """A post, 0.4 m/s, that meets the robot half way."""
    costmap, faces = room()

    def at(now_s: float) -> tuple[float, float]:
        return 2.0, 3.2 - 0.4 * now_s

    def segments(now_s: float) -> Array:
        angles = np.arange(12) * math.tau / 12
        around = np.stack([np.cos(angles), np.sin(angles)], axis=1) * 0.15 + np.array(at(now_s))
        return np.concatenate([around, np.roll(around, -1, axis=0)], axis=1)

    path = line((0.5, 1.0), (3.5, 1.0))
    return drive(
        controller, costmap, Unicycle(SE2(0.5, 1.0, 0.0)), path.goal, faces, path=path,
        limit_s=20.0, extra=segments,
        tracks=lambda now_s: (Track(1, *at(now_s), 0.0, -0.4, 0.15),) if predicted else (),
    )  # fmt: skip


def test_what_crosses_the_way_is_avoided_because_it_is_predicted() -> None:
    told = crossing(made("mppi"), predicted=True)
    assert told.reached
    assert min(told.clearances_m) > 0.08
    blind = crossing(made("mppi", prediction=False), predicted=True)
    assert min(blind.clearances_m) < min(told.clearances_m)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not() -> None:
    first, second, other = (
        np.array(crossing(made("mppi", seed, batch_size=300), True).commands) for seed in (4, 4, 5)
    )
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != other.tobytes()


def test_a_goal_critic_that_is_not_enabled_has_no_say() -> None:
    costmap, _ = room()
    commands = []
    for weight in (0.0, 100.0):
        critic = {"enabled": False, "cost_weight": weight}
        controller = made("mppi", batch_size=300, GoalCritic=critic)
        controller.set_path(line((1.0, 1.0), (2.0, 1.0)), same_goal=False)
        around = Surroundings(SE2(1.0, 1.0, 0.0), costmap, NO_ECHOES)
        commands.append([controller.step(0.05, around).velocity for _ in range(5)])
    assert commands[0] == commands[1]


def test_a_smaller_batch_is_counted_and_drives_too() -> None:
    controller = made("mppi")
    assert isinstance(controller, MPPIController)
    controller.batch_size = 500
    assert (controller.batch_size, controller.shortfalls) == (500, 1)
    controller.batch_size = 1_000_000
    assert (controller.batch_size, controller.shortfalls) == (2000, 1)
    controller.batch_size = 1
    assert controller.batch_size >= 50
    assert crossing(controller, predicted=True).reached


@pytest.mark.parametrize(
    ("periods", "tracks", "optimised"), [(1, 0, 12), (2, 0, 6), (2, 1, 12), (3, 0, 4)]
)
def test_one_optimisation_is_for_several_periods_where_nothing_moves(
    periods: int, tracks: int, optimised: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    costmap, _ = room()
    controller = made("mppi", periods_per_optimisation=periods, batch_size=200)
    assert isinstance(controller, MPPIController)
    controller.set_path(line((0.5, 1.0), (3.5, 1.0)), same_goal=False)
    robot, updates = Unicycle(SE2(0.5, 1.0, 0.0)), 0
    before = ClearanceWindow.update

    def counted(window: ClearanceWindow, around: Surroundings, without_tracks: bool) -> None:
        nonlocal updates
        updates += 1
        before(window, around, without_tracks)

    monkeypatch.setattr(ClearanceWindow, "update", counted)
    seen = (Track(1, 3.5, 3.5, 0.1, 0.1, 0.15),) * tracks
    for _ in range(12):
        around = Surroundings(robot.map_from_base, costmap, NO_ECHOES, tracks=seen)
        robot.drive(controller.step(0.05, around).velocity, 0.05)
    assert updates == optimised
    assert robot.velocity.linear_m_s > 0.3


def test_the_best_rollouts_can_be_drawn() -> None:
    costmap, _ = room()
    controller = made("mppi")
    assert isinstance(controller, MPPIController)
    assert controller.trajectories() is None
    controller.set_path(line((0.5, 1.0), (3.5, 1.0)), same_goal=False)
    controller.step(0.05, Surroundings(SE2(0.5, 1.0, 0.0), costmap, NO_ECHOES))
    drawn = controller.trajectories(count=12)
    assert drawn is not None
    assert drawn.points_m.shape == (12, 57, 2)
    assert drawn.points_m[:, 0] == pytest.approx(np.tile([0.5, 1.0], (12, 1)))
    assert (np.diff(drawn.costs) >= 0.0).all()
    assert drawn.optimal_m[-1, 0] > 1.0
