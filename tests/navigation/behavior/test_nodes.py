from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import BatteryCharge, ClearRequest, TrackingFeedback
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.nodes.goals import REQUESTED
from mazebot.navigation.behavior.nodes.nodes_goals import WaypointState, WaypointStatus
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.costmap.costmap import NO_INFORMATION
from mazebot.navigation.planning.path import PlannedPath, path_through
from tests.navigation.behavior.scripted_tree import Ticked
from tests.navigation.behavior.simulated_robot import SimulatedRobot

AT_ORIGIN = SE2(0.0, 0.0, 0.0)


def line(length_m: float) -> PlannedPath:
    """A straight path along x with a point each 0.1 m."""
    xs = np.arange(round(length_m * 10) + 1) / 10.0
    return path_through(np.stack([xs, np.zeros(len(xs))], axis=1), 0.0)


def leaf(kind: str, robot: SimulatedRobot | None = None, **ports: str) -> Ticked:
    return Ticked(kind, robot=robot, **ports)


@pytest.mark.parametrize(
    ("kind", "code", "answer"),
    [
        ("WouldAPlannerRecoveryHelp", ErrorCode.NO_VALID_PATH, "S"),
        ("WouldAPlannerRecoveryHelp", ErrorCode.THROUGH_POSES_TIMEOUT, "S"),
        # The goal itself is the cause: no recovery helps.
        ("WouldAPlannerRecoveryHelp", ErrorCode.GOAL_OCCUPIED, "F"),
        ("WouldAPlannerRecoveryHelp", ErrorCode.NONE, "F"),
        ("WouldAControllerRecoveryHelp", ErrorCode.FAILED_TO_MAKE_PROGRESS, "S"),
        ("WouldAControllerRecoveryHelp", ErrorCode.INVALID_PATH, "F"),
        ("WouldASmootherRecoveryHelp", ErrorCode.SMOOTHER_TIMEOUT, "S"),
        ("WouldARouteRecoveryHelp", ErrorCode.NO_VALID_ROUTE, "S"),
    ],
)
def test_which_failures_a_recovery_could_help_against(
    kind: str, code: ErrorCode, answer: str
) -> None:
    tree = leaf(kind, error_code="{code}")
    assert tree.tick() == "F"
    tree.blackboard.set("code", int(code))
    assert tree.tick() == answer
    listed = leaf(kind, error_code="{code}", error_codes_to_check=f"17;{int(code)}")
    listed.blackboard.set("code", int(code))
    assert listed.tick() == "S"


def test_goal_updated_looks_from_when_it_was_first_reached() -> None:
    tree = leaf("GoalUpdated")
    tree.blackboard.set(REQUESTED, (AT_ORIGIN,))
    assert tree.ticks(2) == "FF"
    tree.blackboard.set(REQUESTED, (SE2(1.0, 0.0, 0.0),))
    assert tree.ticks(2) == "SF"
    # A goal that came while other nodes were ticked is not new to a recovery that begins.
    tree.blackboard.set(REQUESTED, (AT_ORIGIN,))
    tree.run.tick_number += 5
    assert tree.tick() == "F"


def test_a_global_updated_goal_is_new_once() -> None:
    tree = leaf("GlobalUpdatedGoal")
    tree.blackboard.set(REQUESTED, (AT_ORIGIN,))
    assert tree.ticks(2) == "SF"
    tree.blackboard.set(REQUESTED, (SE2(1.0, 0.0, 0.0),))
    assert tree.ticks(2) == "SF"


def test_goals_that_are_passed_are_taken_away_in_their_order() -> None:
    robot = SimulatedRobot()
    robot.robot.map_from_base = SE2(1.0, 0.0, 0.0)
    tree = leaf(
        "RemovePassedGoals", robot, radius="0.5", input_goals="{goals}", output_goals="{goals}",
        input_waypoint_statuses="{states}", output_waypoint_statuses="{states}",
    )  # fmt: skip
    # The third is near as well, but the second is not passed yet.
    goals = (SE2(0.8, 0.0, 0.0), SE2(3.0, 0.0, 0.0), SE2(1.2, 0.0, 0.0))
    tree.blackboard.set("goals", goals)
    states = tuple(WaypointStatus(i, goal) for i, goal in enumerate(goals))
    tree.blackboard.set("states", states)
    assert tree.ticks(2) == "SS"
    assert tree.blackboard.get("goals") == goals[1:]
    after = tree.blackboard.get("states")
    assert isinstance(after, tuple)
    assert [one.waypoint_status for one in after] == [
        WaypointState.COMPLETED, WaypointState.PENDING, WaypointState.PENDING,
    ]  # fmt: skip
    # The last one is for the goal checker.
    tree.blackboard.set("goals", goals[2:])
    assert tree.tick() == "S"
    assert tree.blackboard.get("goals") == goals[2:]


def test_goals_in_collision_are_taken_away() -> None:
    inside_a_wall, free = SE2(0.4, 0.55, 0.0), AT_ORIGIN
    tree = leaf(
        "RemoveInCollisionGoals", SimulatedRobot(), input_goals="{goals}", output_goals="{left}"
    )
    tree.blackboard.set("goals", (inside_a_wall, free))
    assert tree.tick() == "S"
    assert tree.blackboard.get("left") == (free,)
    tree.blackboard.set("goals", (inside_a_wall,))
    assert tree.tick() == "F"


@pytest.mark.parametrize(
    ("ports", "first_m", "last_m"),
    [
        ({"distance_forward": "-1", "distance_backward": "0"}, 1.0, 3.0),
        ({"distance_forward": "0.5", "distance_backward": "0.5"}, 0.5, 1.5),
        ({}, 0.0, 3.0),
    ],
)
def test_a_path_is_cut_around_the_robot(
    ports: dict[str, str], first_m: float, last_m: float
) -> None:
    robot = SimulatedRobot()
    robot.robot.map_from_base = SE2(1.02, 0.3, 0.0)
    tree = leaf("TruncatePathLocal", robot, input_path="{path}", output_path="{cut}", **ports)
    assert tree.tick() == "F"
    tree.blackboard.set("path", line(3.0))
    assert tree.tick() == "S"
    cut = tree.blackboard.get("cut")
    assert isinstance(cut, PlannedPath)
    assert cut.points_m[[0, -1], 0] == pytest.approx([first_m, last_m])
    assert cut.length_m == pytest.approx(last_m - first_m)


def test_the_end_of_a_path_is_cut_off() -> None:
    tree = leaf("TruncatePath", input_path="{path}", output_path="{cut}", distance="1.0")
    tree.blackboard.set("path", line(3.0))
    assert tree.tick() == "S"
    cut = tree.blackboard.get("cut")
    assert isinstance(cut, PlannedPath)
    assert cut.length_m == pytest.approx(2.0)
    # Of a short path its beginning is left: the robot is near enough.
    tree.blackboard.set("path", line(0.5))
    assert tree.tick() == "S"
    cut = tree.blackboard.get("cut")
    assert isinstance(cut, PlannedPath)
    assert cut.length_m == pytest.approx(0.0)


def test_paths_are_joined_and_their_poses_read() -> None:
    board = Blackboard()
    tree = leaf("ConcatenatePaths", input_path1="{a}", input_path2="{b}", output_path="{c}")
    assert tree.tick() == "F"
    tree.blackboard.set("a", line(1.0))
    assert tree.tick() == "S"
    tree.blackboard.set("b", line(2.0))
    assert tree.tick() == "S"
    joined = tree.blackboard.get("c")
    assert isinstance(joined, PlannedPath)
    # The gap between them is filled.
    for part, given in ((joined.points_m[:11], 1.0), (joined.points_m[-21:], 2.0)):
        assert part.tolist() == line(given).points_m.tolist()
    last = leaf("GetPoseFromPath", path="{c}", index="-1", pose="{pose}")
    last.blackboard.set("c", joined)
    assert last.tick() == "S"
    assert last.blackboard.get("pose") == pytest.approx(SE2(2.0, 0.0, 0.0))
    assert board.get("pose") is None


def test_goals_are_listed_and_shortened() -> None:
    tree = leaf("AppendGoalPoseToGoals", input_goals="{g}", goal_pose="{p}", output_goals="{g}")
    tree.blackboard.set("p", AT_ORIGIN)
    assert tree.ticks(3) == "SSS"
    assert tree.blackboard.get("g") == (AT_ORIGIN,) * 3
    few = leaf("GetNextFewGoals", input_goals="{g}", num_goals="2", output_goals="{n}")
    few.blackboard.set("g", (AT_ORIGIN,) * 3)
    assert few.tick() == "S"
    assert few.blackboard.get("n") == (AT_ORIGIN,) * 2


@pytest.mark.parametrize(("left_m", "answer"), [(0.9, "S"), (1.1, "F")])
def test_a_goal_is_near_by_the_length_of_the_path_left(left_m: float, answer: str) -> None:
    robot = SimulatedRobot()
    robot.robot.map_from_base = SE2(3.0 - left_m, 0.0, 0.0)
    tree = leaf("IsGoalNearby", robot, path="{path}", proximity_threshold="1.0")
    assert tree.tick() == "F"
    tree.blackboard.set("path", line(3.0))
    assert tree.tick() == answer


def test_a_path_expires_by_its_age() -> None:
    tree = leaf("PathExpiringTimer", seconds="0.2", path="{path}")
    tree.blackboard.set("path", line(1.0))
    assert tree.ticks(6) == "FFFFSF"
    tree.blackboard.set("path", line(2.0))
    assert tree.ticks(5) == "FFFFS"


def test_timers_and_distances_hold_again_and_again() -> None:
    assert leaf("TimeExpired", seconds="0.1").ticks(6) == "FFSFSF"
    robot = SimulatedRobot()
    tree, answers = leaf("DistanceTraveled", robot, distance="0.3"), ""
    for step in range(8):
        robot.robot.map_from_base = SE2(0.11 * step, 0.0, 0.0)
        answers += tree.tick()
    assert answers == "FFFSFFSF"


def test_a_robot_that_does_not_move_is_stuck_after_3_s() -> None:
    assert leaf("IsStuck", SimulatedRobot()).ticks(61) == "F" * 60 + "S"


def test_a_robot_has_stopped_once_it_has_stood_for_a_while() -> None:
    robot = SimulatedRobot()
    tree = leaf("IsStopped", robot, duration_stopped="100")
    robot.robot.velocity = Velocity(0.1, 0.0)
    assert tree.tick() == "F"
    robot.robot.velocity = Velocity(0.0, 0.0)
    assert tree.ticks(3) == "RRS"


@pytest.mark.parametrize(
    ("error_m", "heading_rad", "answer"),
    [(0.19, 0.0, "S"), (0.21, 0.0, "F"), (-0.31, 0.0, "F"), (-0.29, 0.4, "S"), (0.0, 0.6, "F")],
)
def test_tracking_bounds_differ_by_side(error_m: float, heading_rad: float, answer: str) -> None:
    tree = leaf(
        "IsWithinPathTrackingBounds", tracking_feedback="{feedback}", max_error_left="0.2",
        max_error_right="0.3", max_error_heading="0.5",
    )  # fmt: skip
    assert tree.tick() == "S"
    tree.blackboard.set("feedback", TrackingFeedback(False, 1.0, error_m, heading_rad))
    assert tree.tick() == answer


def test_conditions_about_poses() -> None:
    robot = SimulatedRobot()
    near = leaf("ArePosesNear", ref_pose="{a}", target_pose="{b}", tolerance="0.5")
    assert near.tick() == "F"
    near.blackboard.set("a", AT_ORIGIN)
    near.blackboard.set("b", SE2(0.4, 0.0, 2.0))
    assert near.tick() == "S"
    reached = leaf("GoalReached", robot, goal="{goal}")
    reached.blackboard.set("goal", SE2(0.1, 0.1, 0.1))
    assert reached.tick() == "S"
    reached.blackboard.set("goal", SE2(0.1, 0.1, 1.0))
    assert reached.tick() == "F"
    occupied = leaf("IsPoseOccupied", robot, pose="{pose}")
    occupied.blackboard.set("pose", SE2(0.4, 0.55, 0.0))
    assert occupied.tick() == "S"
    occupied.blackboard.set("pose", AT_ORIGIN)
    assert occupied.tick() == "F"


def test_conditions_about_the_battery() -> None:
    robot = SimulatedRobot()
    low = leaf("IsBatteryLow", robot, min_battery="0.25", battery_topic="/battery_state")
    low_v = leaf("IsBatteryLow", robot, min_battery="10.5", is_voltage="true")
    charging = leaf("IsBatteryCharging", robot)
    # Of a battery that has said nothing, nothing is known.
    assert low.tick() + low_v.tick() + charging.tick() == "FFF"
    robot.charge = BatteryCharge(0.26, 10.5, is_charging=False)
    assert low.tick() + low_v.tick() + charging.tick() == "FSF"
    robot.charge = BatteryCharge(0.25, 10.6, is_charging=True)
    assert low.tick() + low_v.tick() + charging.tick() == "SFS"
    robot.charge = BatteryCharge(math.nan, 10.6, is_charging=False)
    assert low.tick() == "F"


def test_conditions_about_localisation() -> None:
    robot = SimulatedRobot()
    transform = leaf("TransformAvailable", robot, child="odom", parent="map")
    pose = leaf("InitialPoseReceived", robot)
    assert transform.tick() + pose.tick() == "SS"
    robot.localized = False
    assert transform.tick() + pose.tick() == "FF"
    assert leaf("GetCurrentPose", robot, current_pose="{pose}").tick() == "F"
    assert leaf("TransformAvailable", robot, child="base_link", parent="odom").tick() == "S"


@pytest.mark.parametrize(
    ("kind", "ports", "request_"),
    [
        (
            "ClearEntireCostmap",
            {"service_name": "local_costmap/clear_entirely_local_costmap"},
            ClearRequest("local"),
        ),
        (
            "ClearEntireCostmap",
            {"service_name": "/a/global_costmap/clear", "plugins": "obstacle_layer;voxel_layer"},
            ClearRequest("global"),
        ),
        (
            "ClearCostmapExceptRegion",
            {"service_name": "local_costmap/clear", "reset_distance": "2"},
            ClearRequest("local", "except_region", 2.0),
        ),
        (
            "ClearCostmapAroundRobot",
            {"service_name": "global_costmap/clear"},
            ClearRequest("global", "around_robot", 1.0),
        ),
        (
            "ClearCostmapAroundPose",
            {"service_name": "global_costmap/clear", "pose": "{pose}"},
            ClearRequest("global", "around_pose", 1.0, SE2(1.0, 2.0, 0.0)),
        ),
    ],
)
def test_costmaps_are_cleared_as_asked(
    kind: str, ports: dict[str, str], request_: ClearRequest
) -> None:
    robot = SimulatedRobot()
    tree = leaf(kind, robot, **ports)
    tree.blackboard.set("pose", SE2(1.0, 2.0, 0.0))
    assert tree.tick() == "S"
    assert robot.cleared == [request_]


def test_selectors_take_the_name_from_their_topic() -> None:
    robot = SimulatedRobot()
    tree = leaf(
        "ControllerSelector", robot, topic_name="controller_selector",
        default_controller="FollowPath", selected_controller="{selected}",
    )  # fmt: skip
    assert tree.tick() == "S"
    assert tree.blackboard.get("selected") == "FollowPath"
    robot.chosen["controller_selector"] = "Precise"
    assert tree.tick() == "S"
    assert tree.blackboard.get("selected") == "Precise"


def test_switches() -> None:
    robot = SimulatedRobot()
    assert leaf("ToggleCollisionMonitor", robot, enable="false").tick() == "S"
    assert not robot.monitor
    assert leaf("ReinitializeGlobalLocalization", robot).tick() == "S"
    assert robot.searches == 1
    assert leaf("CancelControl", robot).tick() == "S"


def test_a_failed_plan_empties_the_path_and_tells_its_code() -> None:
    robot = SimulatedRobot()
    tree = leaf(
        "ComputePathThroughPoses", robot, goals="{goals}", path="{path}",
        error_code_id="{code}", error_msg="{message}",
    )  # fmt: skip
    tree.blackboard.set("path", line(1.0))
    tree.blackboard.set("goals", ())
    assert tree.tick() == "F"
    assert tree.blackboard.get("code") == ErrorCode.NO_VIAPOINTS_GIVEN
    assert tree.blackboard.get("path") is None
    tree.blackboard.set("goals", (SE2(0.4, 0.55, 0.0),))
    assert tree.tick() == "F"
    assert tree.blackboard.get("code") == ErrorCode.THROUGH_POSES_GOAL_OCCUPIED
    assert "(0.40, 0.55)" in str(tree.blackboard.get("message"))
    tree.blackboard.set("goals", (SE2(0.2, 0.0, 0.0), SE2(0.0, -0.2, 0.0)))
    assert tree.tick() == "S"
    assert tree.blackboard.get("code") == 0
    path = tree.blackboard.get("path")
    assert isinstance(path, PlannedPath)
    assert math.isclose(path.goal.y_m, -0.2)


def test_a_failed_plan_to_a_pose_empties_the_path_too() -> None:
    tree = leaf("ComputePathToPose", SimulatedRobot(), goal="{goal}", path="{path}")
    tree.blackboard.set("path", line(1.0))
    tree.blackboard.set("goal", SE2(0.4, 0.55, 0.0))
    assert tree.tick() == "F"
    assert tree.blackboard.get("path") is None


def test_a_smoothed_path_is_checked_if_asked() -> None:
    robot = SimulatedRobot()
    tree = leaf(
        "SmoothPath", robot, unsmoothed_path="{a}", smoothed_path="{b}", error_code_id="{code}",
        check_for_collisions="true",
    )  # fmt: skip
    assert tree.tick() == "F"
    assert tree.blackboard.get("code") == ErrorCode.SMOOTHER_INVALID_PATH
    tree.blackboard.set("a", line(1.0))
    assert tree.tick() == "S"
    assert tree.blackboard.get("b") is tree.blackboard.get("a")


def test_a_smoother_that_there_is_none_of_is_refused() -> None:
    robot = SimulatedRobot()
    for name, answer in (("", "S"), ("simple_smoother", "S"), ("nope", "F")):
        tree = leaf(
            "SmoothPath", robot, unsmoothed_path="{a}", error_code_id="{code}",
            error_msg="{message}", smoother_id=name,
        )  # fmt: skip
        tree.blackboard.set("a", line(1.0))
        assert tree.tick() == answer
    assert tree.blackboard.get("code") == ErrorCode.INVALID_SMOOTHER
    assert tree.blackboard.get("message") == (
        "smoother_id: 'nope': must be empty or one of simple_smoother, SmoothPath"
    )


@pytest.mark.parametrize(
    ("port", "good", "what", "known"),
    [
        (
            "goal_checker_id", "general_goal_checker", "goal checker",
            "general_goal_checker, goal_checker",
        ),
        ("progress_checker_id", "progress_checker", "progress checker", "progress_checker"),
        ("path_handler_id", "path_handler", "path handler", "PathHandler, path_handler"),
    ],
)  # fmt: skip
def test_a_plugin_of_following_that_there_is_none_of_is_refused(
    port: str, good: str, what: str, known: str
) -> None:
    robot = SimulatedRobot()
    for name, answer in (("", "R"), (good, "R"), ("nonsense", "F")):
        tree = leaf(
            "FollowPath", robot, path="{a}", error_code_id="{code}", error_msg="{message}",
            **{port: name},
        )  # fmt: skip
        tree.blackboard.set("a", line(1.0))
        assert tree.tick() == answer
    assert tree.blackboard.get("code") == ErrorCode.INVALID_CONTROLLER
    assert tree.blackboard.get("message") == (f"{what} 'nonsense': must be empty or one of {known}")


def test_what_is_unknown_is_an_obstacle_if_asked() -> None:
    robot = SimulatedRobot()
    frame, costs = robot.costmap.master.frame, robot.costmap.master.costs
    row = len(costs) - 2
    unknown = int(np.flatnonzero(costs[row] == NO_INFORMATION)[0])
    x_m = frame.origin_x_m + (unknown + 0.5) * frame.resolution_m
    y_m = frame.origin_y_m + (row + 0.5) * frame.resolution_m
    path = path_through(np.array([[0.0, 0.0], [0.1, 0.0], [x_m, y_m]]), 0.0)
    answers = []
    for asked in ("false", "true"):
        tree = leaf(
            "IsPathValid", robot, path="{a}", consider_unknown_as_obstacle=asked,
            collision_poses="{hit}",
        )  # fmt: skip
        tree.blackboard.set("a", path)
        answers.append((tree.tick(), len(tree.blackboard.get("hit"))))  # type: ignore[arg-type]
    assert answers == [("S", 0), ("F", 1)]
