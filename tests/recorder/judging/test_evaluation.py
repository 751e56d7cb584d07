"""A run judged by the ground truth, from messages made by hand."""

from __future__ import annotations

import math
import pickle
import tracemalloc
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from mazebot.common.figures.goal_table import error_lines, failure_lines, goal_rows
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    LINK_FROM_OPTICAL,
    MAP_FRAME,
    ODOM_FRAME,
    SE2,
    inverse_matrix,
    transform_matrix,
    wrap_angle,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import ActionFeedback, ActionResult
from mazebot.common.messages.documents import (
    BodyEntity,
    Box,
    Contact,
    Entities,
    ErrorStatistics,
    Location,
    MarkerEntity,
    NavigationResult,
    Parameters,
    Planar,
    Shape,
    Wall,
    World,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.recorder.judging import error_summary
from mazebot.recorder.judging.error_summary import ErrorSummary
from mazebot.recorder.judging.evaluation import RunEvaluation
from mazebot.recorder.judging.poses import driven_way, pose_errors, true_poses
from mazebot.recorder.judging.poses.driven_way import DrivenWay

PERIOD_NS = 33_333_333
SPEED_M_S = 0.3
START = SE2(1.0, 2.0, 0.0)
BASE_FROM_CAMERA = transform_matrix(np.eye(3), (0.07, 0.0, 0.2)) @ LINK_FROM_OPTICAL


def make_world(*, with_wall: bool = False) -> World:
    wall = Wall(
        name="wall",
        length_m=2.0,
        thickness_m=0.15,
        height_m=1.0,
        x_m=START.x_m + 1.5,
        y_m=START.y_m,
        yaw_rad=math.pi / 2,
        material="plain",
    )
    return World(
        name="hall",
        recipe="hall.yaml",
        hash="abc",
        walls=(wall,) if with_wall else (),
        materials=(),
        locations=(Location(name="door", x_m=START.x_m + 3.0, y_m=START.y_m, yaw_rad=0.0),),
        start=Planar(x_m=START.x_m, y_m=START.y_m, yaw_rad=START.yaw_rad),
    )


def true_pose(stamp_ns: int) -> SE2:
    """Straight on for 10 s, then at rest."""
    return SE2(START.x_m + SPEED_M_S * min(stamp_ns, 10_000_000_000) / 1e9, START.y_m, 0.0)


def odometry(stamp_ns: int, pose: SE2, frame: str, z_m: float = 0.0) -> msg.Odometry:
    zero = msg.Twist(linear=msg.Vector3(0.0, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    return msg.Odometry(
        header=msg.header(stamp_ns, frame),
        child_frame_id=BASE_FOOTPRINT_FRAME,
        pose=msg.PoseWithCovariance(msg.pose_from_se2(pose, z_m), np.zeros(36)),
        twist=msg.TwistWithCovariance(zero, np.zeros(36)),
    )


def estimate(stamp_ns: int, pose: SE2) -> msg.PoseWithCovarianceStamped:
    return msg.PoseWithCovarianceStamped(
        header=msg.header(stamp_ns, MAP_FRAME),
        pose=msg.PoseWithCovariance(msg.pose_from_se2(pose), np.zeros(36)),
    )


def result(
    goal: SE2, start_s: float = 0.0, end_s: float = 10.0, error_code: int = 0
) -> NavigationResult:
    return NavigationResult(
        goal=Planar(x_m=goal.x_m, y_m=goal.y_m, yaw_rad=goal.yaw_rad),
        goal_stamp_ns=round(start_s * 1e9),
        error_code=error_code,
        start_time_s=start_s,
        end_time_s=end_s,
        number_of_recoveries=2,
    )


def drive(evaluation: RunEvaluation, until_s: float = 12.0, noise_m: float = 0.0) -> None:
    for tick in range(round(until_s * 1e9 / PERIOD_NS) + 1):
        pose = true_pose(tick * PERIOD_NS)
        pose = pose._replace(y_m=pose.y_m + noise_m * (-1) ** tick)
        evaluation.add_ground_truth(odometry(tick * PERIOD_NS, pose, MAP_FRAME))


def marker() -> MarkerEntity:
    return MarkerEntity(
        name="aruco_60",
        position_m=(START.x_m + 3.0, START.y_m + 0.5, 0.3),
        orientation_xyzw=(-0.5, -0.5, 0.5, 0.5),
        panel_side_m=0.4,
        texture_sha256="",
        marker_id=60,
        marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )


def detection(stamp_ns: int, off_m: float = 0.0, marker_id: int = 60) -> msg.Detection3DArray:
    """The marker as the camera sees it, too far by `off_m`; the second solution is nonsense."""
    map_from_camera = true_pose(stamp_ns).matrix() @ BASE_FROM_CAMERA
    at = (inverse_matrix(map_from_camera) @ np.array([*marker().position_m, 1.0]))[:3]
    poses = [
        msg.Pose(position=msg.Point(*where), orientation=msg.Quaternion(0.0, 0.0, 0.0, 1.0))
        for where in ((at[0], at[1], at[2] + off_m), (9.0, 9.0, 9.0))
    ]
    header = msg.header(stamp_ns, CAMERA_OPTICAL_FRAME)
    return msg.Detection3DArray(
        header=header,
        detections=[
            msg.Detection3D(
                header=header,
                results=[
                    msg.ObjectHypothesisWithPose(
                        hypothesis=msg.ObjectHypothesis(class_id=str(marker_id), score=score),
                        pose=msg.PoseWithCovariance(pose, np.zeros(36)),
                    )
                    for pose, score in zip(poses, (0.8, 0.2), strict=True)
                ],
                bbox=msg.BoundingBox3D(center=poses[0], size=msg.Vector3(0.3, 0.3, 0.0)),
                id=f"DICT_4X4_100:{marker_id}",
            )
        ],
    )


def with_camera(evaluation: RunEvaluation) -> None:
    """The camera's frame in two pieces, as a robot has it."""
    link = transform_matrix(np.eye(3), (0.07, 0.0, 0.2))
    for parent, child, matrix in (
        ("camera_link", CAMERA_OPTICAL_FRAME, LINK_FROM_OPTICAL),
        (BASE_FOOTPRINT_FRAME, "camera_link", link),
    ):
        evaluation.add_static_transforms(
            msg.TFMessage(transforms=[msg.transform_stamped(0, parent, child, matrix)])
        )


def test_a_perfect_run_has_no_errors() -> None:
    evaluation = RunEvaluation(make_world())
    for tick in range(100):
        evaluation.add_estimate(estimate(tick * 100_000_000, true_pose(tick * 100_000_000)))
    drive(evaluation)
    document = evaluation.evaluation()
    assert document.localisation_error_m.max == pytest.approx(0.0, abs=1e-7)
    assert document.localisation_error_rad.max == pytest.approx(0.0, abs=1e-7)


def test_an_estimate_is_held_against_the_truth_at_its_own_stamp() -> None:
    """Between two true poses, 1 cm apart, and against neither."""
    evaluation = RunEvaluation(make_world())
    stamp_ns = 3 * PERIOD_NS + PERIOD_NS // 2
    evaluation.add_estimate(estimate(stamp_ns, true_pose(stamp_ns)))
    drive(evaluation)
    assert evaluation.evaluation().localisation_error_m.max == pytest.approx(0.0, abs=1e-7)


def test_localisation_error_has_mean_p95_and_maximum() -> None:
    evaluation = RunEvaluation(make_world())
    for tick in range(101):
        pose = true_pose(tick * 10_000_000)
        off = SE2(pose.x_m, pose.y_m + tick / 1000.0, -tick / 100.0)
        evaluation.add_estimate(estimate(tick * 10_000_000, off))
    drive(evaluation)
    error_m = evaluation.evaluation().localisation_error_m
    error_rad = evaluation.evaluation().localisation_error_rad
    assert (error_m.mean, error_m.p95, error_m.max) == pytest.approx((0.05, 0.095, 0.1))
    assert (error_rad.mean, error_rad.p95, error_rad.max) == pytest.approx((0.5, 0.95, 1.0))


def test_a_turn_is_measured_the_short_way_round() -> None:
    evaluation = RunEvaluation(make_world())
    for tick in range(3):
        pose = SE2(0.0, 0.0, math.pi - 0.01)
        evaluation.add_ground_truth(odometry(tick * PERIOD_NS, pose, MAP_FRAME))
    evaluation.add_estimate(estimate(PERIOD_NS, SE2(0.0, 0.0, -math.pi + 0.01)))
    assert evaluation.evaluation().localisation_error_rad.max == pytest.approx(0.02)


def test_estimates_outside_the_truth_are_left_out() -> None:
    evaluation = RunEvaluation(make_world())
    pose = true_pose(0)._replace(y_m=9.0)
    for tick in range(2):
        stamp_ns = 5_000_000_000 + tick * PERIOD_NS
        evaluation.add_ground_truth(odometry(stamp_ns, true_pose(stamp_ns), MAP_FRAME))
    evaluation.add_estimate(estimate(0, pose))
    evaluation.add_estimate(estimate(9_000_000_000, pose))
    assert evaluation.evaluation().localisation_error_m == ErrorStatistics()


def test_one_estimate_of_the_future_holds_up_no_other() -> None:
    evaluation = RunEvaluation(make_world())
    evaluation.add_estimate(estimate(10**15, START))
    evaluation.add_estimate(estimate(0, START._replace(y_m=START.y_m + 0.5)))
    drive(evaluation)
    assert evaluation.evaluation().localisation_error_m.max == pytest.approx(0.5)


def test_the_order_of_arrival_changes_nothing() -> None:
    steps: list[Callable[[RunEvaluation], None]] = [
        drive,
        lambda e: e.add_estimate(estimate(1_000_000_000, SE2(1.0, 2.0, 0.3))),
        lambda e: e.add_odometry(odometry(2_000_000_000, SE2(0.1, 0.0, 0.0), ODOM_FRAME)),
        lambda e: e.add_detections(detection(1_500_000_000, 0.04)),
        lambda e: e.add_result(result(SE2(START.x_m + 3.0, START.y_m, 0.0))),
        with_camera,
    ]
    documents = []
    for order in ((0, 1, 2, 3, 4, 5), (5, 4, 3, 2, 1, 0), (5, 2, 0, 4, 3, 1)):
        evaluation = RunEvaluation(make_world())
        evaluation.set_entities(Entities(world_hash="abc", entities=(marker(),)))
        for index in order:
            steps[index](evaluation)
        documents.append(evaluation.evaluation())
    assert documents[0].marker_error_m.max == pytest.approx(0.04, abs=1e-6)
    assert documents[0].goals
    assert documents[1:] == documents[:-1]


def test_drift_is_where_odometry_alone_leads_from_the_start() -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    for stamp_ns, slip in ((1_000_000_000, 0.5), (10_000_000_000, 1.1)):
        pose = SE2(slip * SPEED_M_S * stamp_ns / 1e9, 0.0, 0.0)
        evaluation.add_odometry(odometry(stamp_ns, pose, ODOM_FRAME))
    assert evaluation.evaluation().odometry_drift_m == pytest.approx(0.3, abs=1e-6)


def test_a_marker_is_held_against_its_true_place_by_the_true_camera() -> None:
    evaluation = RunEvaluation(make_world())
    evaluation.set_entities(Entities(world_hash="abc", entities=(marker(),)))
    with_camera(evaluation)
    for tick, off_m in enumerate((0.0, 0.02, -0.04)):
        evaluation.add_detections(detection(1_000_000_000 + 110_000_000 * tick, off_m))
    drive(evaluation)
    error_m = evaluation.evaluation().marker_error_m
    assert error_m.mean == pytest.approx(0.02, abs=1e-6)
    assert error_m.max == pytest.approx(0.04, abs=1e-6)


def test_a_detection_of_nothing_known_is_no_error() -> None:
    evaluation = RunEvaluation(make_world())
    evaluation.set_entities(Entities(world_hash="abc", entities=(marker(),)))
    with_camera(evaluation)
    evaluation.add_detections(detection(1_000_000_000, 5.0, marker_id=61))
    drive(evaluation)
    assert evaluation.evaluation().marker_error_m == ErrorStatistics()
    assert evaluation.evaluation().markers_seen == {"60": 0}


def test_markers_are_counted_by_the_pictures_they_are_seen_in() -> None:
    evaluation = RunEvaluation(make_world())
    other = marker().model_copy(update={"name": "aruco_80", "marker_id": 80})
    evaluation.set_entities(Entities(world_hash="abc", entities=(marker(), other)))
    once = detection(0)
    twice = msg.Detection3DArray(once.header, [*once.detections, *once.detections])
    for array in (once, twice, msg.Detection3DArray(once.header, [])):
        evaluation.add_detections(array)
    assert evaluation.evaluation().markers_seen == {"60": 2, "80": 0}


def test_a_reached_goal_is_reported_by_the_truth() -> None:
    evaluation = RunEvaluation(make_world(with_wall=True))
    drive(evaluation)
    evaluation.add_result(result(SE2(START.x_m + 3.0, START.y_m + 0.1, 0.2)))
    (goal,) = evaluation.evaluation().goals
    assert goal.name == "goal"
    assert goal.reached
    assert goal.time_s == 10.0
    assert goal.path_length_m == pytest.approx(3.0, abs=0.01)
    assert goal.goal_error_m == pytest.approx(0.1)
    assert goal.goal_error_rad == pytest.approx(0.2)
    assert goal.recoveries == 2
    # Round the wall's end, where the robot of this test went through it.
    assert goal.shortest_path_m is not None
    assert 3.8 < goal.shortest_path_m < 4.2


@pytest.mark.parametrize(
    ("off", "error_code", "reached"),
    [
        (SE2(0.24, 0.0, 0.0), 0, True),
        (SE2(0.0, 0.26, 0.0), 0, False),
        (SE2(0.0, 0.0, 0.24), 0, True),
        (SE2(0.0, 0.0, -0.26), 0, False),
        (SE2(0.0, 0.0, 0.0), 105, False),
    ],
)
def test_navigations_word_is_not_enough(off: SE2, error_code: int, reached: bool) -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    goal = SE2(START.x_m + 3.0 + off.x_m, START.y_m + off.y_m, off.yaw_rad)
    evaluation.add_result(result(goal, error_code=error_code))
    (report,) = evaluation.evaluation().goals
    assert report.reached is reached
    assert report.error_code == error_code


@pytest.mark.parametrize(
    ("checker", "off", "reached"),
    [
        ({"position_only": True}, SE2(0.1, 0.0, 2.0), True),
        ({"position_only": True}, SE2(0.26, 0.0, 0.0), False),
        ({"xy_goal_tolerance": 0.5}, SE2(0.6, 0.0, 0.0), True),
        ({"xy_goal_tolerance": 0.5}, SE2(0.7, 0.0, 0.0), False),
        ({"yaw_goal_tolerance": 0.5}, SE2(0.0, 0.0, -0.6), True),
        ({"symmetric_yaw_tolerance": True}, SE2(0.0, 0.0, 3.0), True),
        ({"symmetric_yaw_tolerance": True}, SE2(0.0, 0.0, 1.5), False),
        ({"xy_goal_tolerance": "far", "yaw_goal_tolerance": None}, SE2(0.24, 0.0, 0.0), True),
    ],
)
def test_a_goal_is_judged_by_the_goal_checker_in_force(
    checker: dict[str, Any], off: SE2, reached: bool
) -> None:
    evaluation = RunEvaluation(make_world())
    values = {"controller_server": {"general_goal_checker": checker}}
    evaluation.add_parameters(Parameters(service="physics", values={}))
    evaluation.add_parameters(Parameters(service="navigation", values=values))
    drive(evaluation)
    goal = SE2(START.x_m + 3.0 + off.x_m, START.y_m, off.yaw_rad)
    evaluation.add_result(result(goal))
    at = Planar(x_m=goal.x_m, y_m=goal.y_m, yaw_rad=goal.yaw_rad)
    evaluation.add_result(task("navigate_to_pose", goal=at))
    # The goal checker has no say in a motion.
    evaluation.add_result(task("drive_on_heading", goal_id="a-2", displacement=planar(3.3, 0.0)))
    *judged, motion = evaluation.evaluation().goals
    assert [one.reached for one in judged] == [reached, reached]
    assert not motion.reached


def test_a_goal_that_its_world_took_away_is_not_judged() -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    evaluation.add_result(result(START, error_code=9011))
    assert evaluation.evaluation().goals == ()
    assert evaluation.totals()["goals_sent"] == 0


@pytest.mark.parametrize(
    ("goal", "name"),
    [
        (SE2(START.x_m + 3.0005, START.y_m, 1.0), "door"),
        (SE2(START.x_m + 3.002, START.y_m, 0.0), "goal"),
        (SE2(START.x_m, START.y_m, 0.0), "home"),
    ],
)
def test_a_goal_has_the_name_of_its_place(goal: SE2, name: str) -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    evaluation.add_result(result(goal))
    assert evaluation.evaluation().goals[0].name == name


def test_trembling_at_rest_is_no_path() -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation, 60.0, noise_m=0.0004)
    evaluation.add_result(result(SE2(START.x_m + 3.0, START.y_m, 0.0), 0.0, 60.0))
    assert evaluation.evaluation().goals[0].path_length_m == pytest.approx(3.0, abs=0.03)


def test_a_goal_is_judged_on_its_own_way() -> None:
    """Path, localisation and contacts between its start and its end, and no others."""
    evaluation = RunEvaluation(make_world())
    for stamp_ns, off_m in ((1_000_000_000, 0.9), (5_000_000_000, 0.1), (6_000_000_000, 0.3)):
        pose = true_pose(stamp_ns)
        evaluation.add_estimate(estimate(stamp_ns, pose._replace(y_m=pose.y_m + off_m)))
    for time_s in (1.0, 5.0, 11.0):
        evaluation.add_contact(
            Contact(
                time_s=time_s,
                robot_link="base",
                body="wall",
                position_m=(0.0, 0.0, 0.0),
                impulse_n_s=0.1,
            )
        )
    drive(evaluation)
    evaluation.add_result(result(SE2(START.x_m + 3.0, START.y_m, 0.0), 4.0, 10.0))
    (goal,) = evaluation.evaluation().goals
    assert goal.path_length_m == pytest.approx(1.8, abs=0.02)
    assert goal.shortest_path_m == pytest.approx(1.8, abs=1e-6)
    assert goal.localisation_error_m == pytest.approx(0.2)
    assert goal.contacts == 1
    assert len(evaluation.evaluation().contacts) == 3


def test_a_goal_that_ends_after_the_newest_truth_is_judged_by_it_for_the_time_being() -> None:
    evaluation = RunEvaluation(make_world())
    evaluation.add_result(result(SE2(START.x_m + 3.0, START.y_m, 0.0)))
    assert evaluation.evaluation().goals == ()
    drive(evaluation, 5.0)
    (early,) = evaluation.evaluation().goals
    assert not early.reached
    assert early.goal_error_m == pytest.approx(1.5, abs=0.01)
    drive(evaluation, 12.0)
    (late,) = evaluation.evaluation().goals
    assert late.reached


@pytest.mark.parametrize("after_s", [8.3, 11.0, 20.0])
def test_where_the_true_pose_at_the_end_is_not_known_navigation_s_word_alone_counts(
    after_s: float,
) -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation, 8.0)
    evaluation.add_result(result(SE2(START.x_m + 2.0, START.y_m, 0.0), end_s=8.2))
    evaluation.add_result(result(SE2(START.x_m + 2.0, START.y_m, 0.0), 1.0, 8.2, error_code=105))
    # As of a recorder that was restarted in the meantime.
    stamp_ns = round(after_s * 1e9)
    evaluation.add_ground_truth(odometry(stamp_ns, true_pose(stamp_ns), MAP_FRAME))
    reached, failed = evaluation.evaluation().goals
    assert not failed.reached
    if after_s < 9.0:
        assert reached.goal_error_m == pytest.approx(0.46, abs=0.01)
        assert not reached.reached
    else:
        assert (reached.goal_error_m, reached.goal_error_rad) == (None, None)
        assert reached.reached
        assert goal_rows([reached])[0][6:8] == ("-", "-")


def test_a_goal_without_an_estimate_on_the_way_has_no_localisation_error() -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    evaluation.add_result(result(SE2(START.x_m + 3.0, START.y_m, 0.0)))
    (goal,) = evaluation.evaluation().goals
    assert goal.localisation_error_m is None


def task(action: str, **fields: Any) -> ActionResult:
    usual = {"goal_id": "a-1", "status": "succeeded", "start_time_s": 0.0, "end_time_s": 10.0}
    return ActionResult.model_validate({"action": action} | usual | fields)


def planar(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Planar:
    return Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


def test_a_task_sent_as_an_action_is_judged_by_the_truth() -> None:
    evaluation = RunEvaluation(make_world(with_wall=True))
    drive(evaluation)
    there, away = planar(START.x_m + 3.0, START.y_m + 0.1), planar(9.0, 9.0)
    evaluation.add_feedback(ActionFeedback(goal_id="a-1", action="navigate_to_pose"))
    evaluation.add_result(task("navigate_to_pose", goal=there))
    evaluation.add_result(task("dock_robot", goal_id="a-2", goal=away))
    failed = {"error_code": 701, "error_msg": "a wall", "number_of_recoveries": 1}
    evaluation.add_result(task("spin", goal_id="a-3", status="aborted", **failed))
    evaluation.add_feedback(ActionFeedback(goal_id="a-4", action="wait"))
    reached, missed, spun = evaluation.evaluation().goals
    assert (reached.action, reached.goal_id, reached.reached) == ("navigate_to_pose", "a-1", True)
    assert reached.goal_error_m == pytest.approx(0.1, abs=0.01)
    assert reached.shortest_path_m is not None
    # Navigation says it has docked; the truth is metres away.
    assert not missed.reached
    assert missed.goal_error_m is not None
    assert missed.goal_error_m > 5.0
    assert missed.shortest_path_m is None
    assert (spun.reached, spun.goal_error_m, spun.recoveries) == (False, None, 1)
    rows = goal_rows(evaluation.evaluation().goals)
    assert [row[:2] for row in rows] == [
        ("goal", "yes"), ("dock robot: goal", "no (0)"), ("spin", "no (701)"),
    ]  # fmt: skip
    assert failure_lines(evaluation.evaluation().goals) == ["spin: error 701: a wall"]
    totals = evaluation.totals()
    assert (totals["goals_sent"], totals["goals_reached"]) == (4, 1)
    # Of the one drive: the other tasks have no shortest path.
    assert totals["spl"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("off_m", "reached"), [(0.0, True), (0.3, False)])
def test_a_motion_is_judged_from_the_true_pose_at_its_start(off_m: float, reached: bool) -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    moved = planar(1.2 + off_m, 0.0)
    times = {"start_time_s": 2.0, "end_time_s": 6.0}
    evaluation.add_result(task("drive_on_heading", displacement=moved, **times))
    (report,) = evaluation.evaluation().goals
    assert report.name == "drive_on_heading"
    assert report.goal_error_m == pytest.approx(off_m, abs=1e-6)
    assert report.reached == reached
    assert report.path_length_m == pytest.approx(1.2, abs=0.01)


def test_a_task_aborted_by_a_restart_is_not_counted() -> None:
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    evaluation.add_result(task("spin", status="aborted", error_code=ErrorCode.WORLD_RESTARTED))
    assert evaluation.evaluation().goals == ()


@pytest.mark.parametrize(
    ("off", "share"),
    [((0.027, 0.0, 0.0), 1.0), ((0.029, 0.0, 0.0), 0.5), ((0.0, 0.0, 0.029), 0.5)],
)
def test_consistency_is_the_share_of_estimates_whose_ellipsoid_holds_the_truth(
    off: tuple[float, float, float], share: float
) -> None:
    # Along one axis the ellipsoid ends at sqrt(7.815) = 2.80 standard deviations.
    covariance = msg.planar_covariance(np.diag([1e-4, 1e-4, 1e-4]))
    evaluation = RunEvaluation(make_world())
    assert evaluation.evaluation().localization.inside_95_percent is None
    for stamp_ns, error in ((0, (0.0, 0.0, 0.0)), (1_000_000_000, off)):
        pose = true_pose(stamp_ns)
        claimed = estimate(stamp_ns, SE2(*(a + b for a, b in zip(pose, error, strict=True))))
        claimed.pose.covariance = covariance
        evaluation.add_estimate(claimed)
    drive(evaluation)
    localization = evaluation.evaluation().localization
    assert (localization.inside_95_percent, localization.estimates) == (share, 2)
    (line, *_) = error_lines(evaluation.evaluation())
    assert f"{share:.0%} inside" in line


def test_an_evaluation_that_is_gone_on_with_keeps_tasks_and_consistency() -> None:
    evaluation, again = RunEvaluation(make_world()), RunEvaluation(make_world())
    evaluation.add_estimate(estimate(0, START))
    drive(evaluation)
    evaluation.add_feedback(ActionFeedback(goal_id="a-0", action="wait"))
    evaluation.add_result(task("spin"))
    waits = task("backup", goal_id="a-2", start_time_s=11.0, end_time_s=13.0)
    evaluation.add_result(waits)
    again.restore(*evaluation.state())
    assert again.evaluation() == evaluation.evaluation()
    totals = ("goals_sent", "goals_reached", "spl")
    assert [again.totals()[one] for one in totals] == [evaluation.totals()[one] for one in totals]
    assert again.evaluation().localization.estimates == 1
    assert [goal.action for goal in again.evaluation().goals] == ["spin", "backup"]


def test_a_goal_that_the_explorer_gives_up_is_neither_reached_nor_missed() -> None:
    evaluation, again = RunEvaluation(make_world()), RunEvaluation(make_world())
    drive(evaluation)
    aim, better = SE2(9.0, 9.0, 0.0), SE2(START.x_m + 3.0, START.y_m, 0.0)
    for stamp_ns in (1, 2, 3):
        evaluation.add_goal(
            msg.PoseStamped(msg.header(stamp_ns, MAP_FRAME), msg.pose_from_se2(aim))
        )
        evaluation.add_exploration(ExplorationStatus(state="exploring"))
    first = result(aim, 1e-9, 1.0, ErrorCode.PREEMPTED)
    evaluation.add_result(first)
    evaluation.add_result(result(aim, 1.0, 2.0, ErrorCode.NO_VALID_PATH))
    # Stopped by the user: the state changes before navigation reports the end of the goal.
    evaluation.add_exploration(ExplorationStatus(state="paused", goal_stamp_ns=3))
    evaluation.add_result(first.model_copy(update={"goal_stamp_ns": 2}))
    canceled = {"goal_stamp_ns": 3, "error_code": ErrorCode.CANCELED}
    evaluation.add_result(first.model_copy(update=canceled))
    evaluation.add_result(result(aim, 3.0, 4.0, ErrorCode.PREEMPTED))
    evaluation.add_result(result(better, 5.0, 10.0))
    goals = evaluation.evaluation().goals
    assert [goal.given_up for goal in goals] == [True, False, True, True, False, False]
    assert [row[1] for row in goal_rows(goals)] == [
        "given up", "no (208)", "given up", "given up", "no (9010)", "yes",
    ]  # fmt: skip
    assert len(failure_lines(goals)) == 0
    totals = evaluation.totals()
    assert (totals["goals_sent"], totals["goals_reached"], totals["goals_given_up"]) == (3, 1, 3)
    assert totals["spl"] == pytest.approx(1 / 3, abs=0.01)
    again.restore(*evaluation.state())
    assert again.totals() == {**totals, "distance_m": None}
    assert again.evaluation() == evaluation.evaluation()


def test_totals_weigh_success_by_path_length() -> None:
    evaluation = RunEvaluation(make_world(with_wall=True))
    assert evaluation.totals()["spl"] is None
    assert evaluation.totals()["distance_m"] is None
    drive(evaluation)
    end = SE2(START.x_m + 3.0, START.y_m, 0.0)
    evaluation.add_result(result(end))
    evaluation.add_result(result(SE2(9.0, 9.0, 0.0), error_code=208))
    evaluation.add_goal(msg.PoseStamped(msg.header(77, MAP_FRAME), msg.pose_from_se2(end)))
    totals = evaluation.totals()
    assert totals["goals_sent"] == 2
    assert totals["goals_reached"] == 1
    # The one driven way, through the wall, is no longer than the shortest; the other goal failed.
    assert totals["spl"] == pytest.approx(0.5)
    assert totals["distance_m"] == pytest.approx(3.0, abs=0.01)


def test_nothing_heard_is_an_empty_evaluation() -> None:
    document = RunEvaluation(make_world()).evaluation("runs/1")
    assert document.goals == ()
    assert document.markers_seen == {}
    assert document.recording == "runs/1"


def crate(name: str, x_m: float, mass_kg: float = 0.0) -> BodyEntity:
    """A box of 0.4 m x 2 m across the way."""
    shape = Shape(name="box", geometry=Box(size_m=(0.4, 2.0, 0.4)), material="")
    return BodyEntity(
        name=name, position_m=(x_m, START.y_m, 0.2), mass_kg=mass_kg, shapes=(shape,)
    )  # fmt: skip


def test_the_shortest_way_leads_past_what_stood_still_when_the_goal_was_sent() -> None:
    goal = true_pose(10_000_000_000)
    evaluation = RunEvaluation(make_world())
    drive(evaluation)
    standing = crate("wall", START.x_m + 1.5), crate("ball", START.x_m + 2.5, mass_kg=1.0)
    stamped = msg.PoseStamped(msg.header(1_000_000_000, MAP_FRAME), msg.pose_from_se2(goal))
    evaluation.set_entities(Entities(world_hash="abc", entities=standing))
    evaluation.add_goal(stamped)
    evaluation.set_entities(Entities(world_hash="abc"))
    evaluation.add_result(result(goal, start_s=1.0))
    evaluation.add_result(result(goal, start_s=2.0, end_s=11.0))
    around, straight = (report.shortest_path_m for report in evaluation.evaluation().goals)
    assert straight == pytest.approx(true_pose(2_000_000_000).distance_m(goal))
    # Past the corners of the box, grown by the robot's 0.22 m.
    corner = math.hypot(1.0, 1.0)
    assert around is not None
    assert straight is not None
    assert straight + 0.3 < around < straight + 0.3 + 2.0 * corner


def test_the_percentile_of_many_errors_is_nearly_exact() -> None:
    summary, errors = ErrorSummary(), np.random.default_rng(1).gamma(2.0, 0.01, 23_456)
    for error in errors.tolist():
        summary.add(error)
    statistics = summary.statistics()
    assert statistics.mean == pytest.approx(errors.mean())
    assert statistics.p95 == pytest.approx(np.percentile(errors, 95), rel=2e-3)
    assert statistics.max == errors.max()


def test_where_the_robot_was_is_known_of_hours_ago() -> None:
    way = DrivenWay()
    for tick in range(30 * 3600):
        angle = tick / 30 * 0.2
        way.add(tick * PERIOD_NS, SE2(math.cos(angle), math.sin(angle), wrap_angle(angle)))
    for stamp_s in (0.0, 10.0, 59.9, 1234.56, 2800.0, 3500.0, 3599.0):
        angle = stamp_s * 0.2
        known = way.at(round(stamp_s * 1e9))
        assert known is not None
        pose, length_m = known
        assert pose.distance_m(SE2(math.cos(angle), math.sin(angle), 0.0)) < 2e-3
        assert abs(wrap_angle(pose.yaw_rad - angle)) < 0.01
        assert length_m == pytest.approx(stamp_s * 0.2, abs=0.01)


def test_where_the_robot_was_takes_little_memory_for_days() -> None:
    way = DrivenWay()
    sizes_bytes = []
    for minute in range(24 * 60):
        for tick in range(120):
            stamp_ns = minute * 60_000_000_000 + tick * 500_000_000
            way.add(stamp_ns, SE2(math.cos(stamp_ns * 1e-9), 0.0, 0.0))
        if minute in (59, 12 * 60, 24 * 60 - 1):
            sizes_bytes.append(len(pickle.dumps(way)))
    assert sizes_bytes[0] < 300_000
    # With each doubling of the time, 900 poses of 40 bytes.
    assert sizes_bytes[2] - sizes_bytes[1] < 2 * 900 * 40


def taken_for_a_moment_bytes(call: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_looking_up_takes_no_arrays_of_all_that_is_kept() -> None:
    way, summary = DrivenWay(), ErrorSummary()
    for tick in range(30 * 600):
        way.add(tick * PERIOD_NS, SE2(tick / 100, 0.0, 0.0))
        summary.add(tick / 1e5)
    for stamp_s in (1, 500, 555, 599):
        assert taken_for_a_moment_bytes(partial(way.at, stamp_s * 10**9)) < 8_000
    assert taken_for_a_moment_bytes(summary.statistics) < 8_000


def test_judging_a_long_run_takes_little_more_memory_than_a_short_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module, name in (
        (true_poses, "_DEPTH"),
        (pose_errors, "_RECENT"),
        (driven_way, "_RECENT"),
        (error_summary, "_MOST_KEPT"),
    ):
        monkeypatch.setattr(module, name, 100)
    evaluation = RunEvaluation(make_world())
    sizes_bytes = []
    for tick in range(8000):
        stamp_ns = tick * 100_000_000
        pose = true_pose(stamp_ns)
        evaluation.add_ground_truth(odometry(stamp_ns, pose, MAP_FRAME))
        evaluation.add_estimate(estimate(stamp_ns, pose))
        if tick in (1999, 7999):
            sizes_bytes.append(len(pickle.dumps(evaluation)))
    # A pose of 40 bytes twice a second, for ten minutes.
    assert sizes_bytes[1] - sizes_bytes[0] < 60_000
