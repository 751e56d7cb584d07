"""The pose that the navigation node is told: given, lost, found again, off."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    SE2,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    AMCL_POSE,
    GLOBAL_LOCALIZATION_REQUEST,
    INITIAL_POSE,
    LOCALIZATION_STATUS,
    ODOM,
    SEND_GOAL,
    TF,
)
from mazebot.common.node.node import Envelope
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.safety.collision_monitor import moved_points
from mazebot.navigation.costmap.layered_costmap import LETHAL_OBSTACLE
from mazebot.navigation.drive import Drive
from mazebot.navigation.messages import planar_document
from tests.navigation.driving import (
    LOCATIONS,
    START,
    NodeDriver,
    box_segments,
    estimate_error_m,
    ready,
)
from tests.navigation.house_tour import house


def test_a_process_that_comes_up_on_the_way_finds_itself_by_odometry() -> None:
    """The robot has driven to location 3; wheels slipped by 2 % and the heading by 3 degrees."""
    true_pose = LOCATIONS["location3"]
    odometry = SE2(true_pose.x_m * 1.02, true_pose.y_m + 0.08, true_pose.yaw_rad + 0.05)
    driver = NodeDriver(start=true_pose, odom_from_base=odometry)
    driver.learn()
    driver.run(3.0)
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.05
    assert driver.drive_to(LOCATIONS["location4"]).error_code == 0


def test_a_pose_by_a_persons_word_is_taken() -> None:
    """The robot is not where it should have started."""
    true_pose = LOCATIONS["location3"]
    driver = NodeDriver(start=true_pose)
    driver.learn()
    driver.run(1.0)
    covariance = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07]).reshape(36)
    told = SE2(true_pose.x_m + 0.15, true_pose.y_m - 0.1, true_pose.yaw_rad + 0.1)
    driver.deliver(
        INITIAL_POSE,
        msg.PoseWithCovarianceStamped(
            header=msg.header(driver.now_ns, "map"),
            pose=msg.PoseWithCovariance(pose=msg.pose_from_se2(told), covariance=covariance),
        ),
    )
    driver.run(4.0)
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.1


@pytest.mark.parametrize(
    ("frame_id", "x_m", "reason"),
    [("odom", 0.0, "frame_id is not map"), ("map", 99.0, "outside the map")],
)
def test_a_bad_initial_pose_is_counted_and_changes_nothing(
    frame_id: str, x_m: float, reason: str
) -> None:
    driver = ready()
    driver.deliver(
        INITIAL_POSE,
        msg.PoseWithCovarianceStamped(
            header=msg.header(driver.now_ns, frame_id),
            pose=msg.PoseWithCovariance(
                pose=msg.pose_from_se2(SE2(x_m, 1.0, 0.0)), covariance=np.zeros(36)
            ),
        ),
    )
    driver.run(0.2)
    assert driver.rejected(INITIAL_POSE)[reason] == 1
    assert estimate_error_m(driver) < 0.05


TREE_THAT_SEARCHES = """
<root BTCPP_format="4" main_tree_to_execute="Search">
  <BehaviorTree ID="Search"><ReinitializeGlobalLocalization/></BehaviorTree>
</root>
"""


def test_a_behavior_tree_can_have_the_robot_searched_on_the_whole_map(tmp_path: Path) -> None:
    tree = tmp_path / "search.xml"
    tree.write_text(TREE_THAT_SEARCHES, encoding="utf-8")
    driver = ready()
    goal = act.NavigateToPose(pose=planar_document(LOCATIONS["location1"]), behavior_tree=str(tree))
    answers: list[act.SendGoalReply] = []
    driver.inbox.ask(SEND_GOAL, act.SendGoal(goal_id="a", goal=goal), answers.append)
    driver.run(0.2)
    assert answers[0].error_msg == ""
    assert len(driver.of(GLOBAL_LOCALIZATION_REQUEST)) == 1
    assert driver.of(LOCALIZATION_STATUS)[-1].state != "localized"


def test_what_was_seen_is_forgotten_after_a_jump_of_the_pose() -> None:
    driver = ready()
    drive = driver.node._drive
    assert drive is not None
    driver.extra_segments = box_segments(START.x_m + 0.6, START.y_m, 0.2)
    driver.run(1.0)
    assert drive.tracker.tracks(driver.now_ns * 1e-9)
    assert marks(drive) > 2
    there = START @ SE2(0.0, 0.0, 0.5)
    entry = driver.of(TF)[-1].transforms[0]
    turned = msg.planar_transform_stamped(driver.now_ns, "map", "odom", there)
    assert (entry.header.frame_id, entry.child_frame_id) == ("map", "odom")
    driver.deliver(TF, msg.TFMessage(transforms=[turned]))
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    assert not drive.tracker.tracks(driver.now_ns * 1e-9)
    assert marks(drive) == 0


@pytest.mark.parametrize("slips", [True, False])
def test_what_was_seen_around_moves_along_where_the_wheels_have_slipped(slips: bool) -> None:
    """And stays where it is in odom where localization was wrong, not the wheels."""
    driver = ready()
    drive = driver.node._drive
    assert drive is not None
    driver.extra_segments = box_segments(START.x_m + 0.6, START.y_m, 0.2)
    driver.run(1.0)
    local = drive.robot.local_costmap
    before_m = np.array([[-0.4, 0.1]])
    drive.hidden.touch(before_m)
    local.mark_touched(before_m)
    entry = driver.of(TF)[-1].transforms[0]
    map_from_before = msg.se2_from_transform(entry.transform)
    assert driver.node._measured.odom is not None
    odom_from_base = driver.node._measured.odom[1]
    map_from_base = map_from_before @ odom_from_base
    map_from_odom = map_from_base @ SE2(-0.1, 0.0, -0.4) @ odom_from_base.inverse()
    status = driver.of(LOCALIZATION_STATUS)[-1].model_copy(update={"wheel_slip": slips})
    driver.deliver(LOCALIZATION_STATUS, status)
    moved = msg.planar_transform_stamped(driver.now_ns, "map", "odom", map_from_odom)
    driver.deliver(TF, msg.TFMessage(transforms=[moved]))
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    odom_from_before = map_from_odom.inverse() @ map_from_before
    expected_m = moved_points(before_m, odom_from_before, SE2(0.0, 0.0, 0.0))
    assert drive.hidden.touched_m == pytest.approx(expected_m if slips else before_m)
    for (x_m, y_m), moves in ((expected_m[0], True), (before_m[0], False)):
        marked = local.master.cost_at(x_m, y_m) == LETHAL_OBSTACLE
        assert marked == (moves == slips)


def test_marks_are_forgotten_when_a_pose_is_found_again() -> None:
    driver = ready()
    drive = driver.node._drive
    assert drive is not None
    driver.extra_segments = box_segments(START.x_m + 0.6, START.y_m, 0.2)
    driver.run(1.0)
    said = driver.of(LOCALIZATION_STATUS)[-1]
    for state, wants_motion, left in (("lost", True, True), ("localized", False, False)):
        status = said.model_copy(update={"state": state, "wants_motion": wants_motion})
        driver.deliver(LOCALIZATION_STATUS, status)
        driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
        assert bool(marks(drive)) == left, state


def marks(drive: Drive) -> int:
    """Cells of the global costmap that are occupied though the map has nothing there."""
    costmap = drive.robot.costmap
    lethal = costmap.master.costs == LETHAL_OBSTACLE
    return int((lethal & (costmap.static.costs != LETHAL_OBSTACLE)).sum())


def test_the_better_the_pose_is_known_the_nearer_to_walls_things_are_marked() -> None:
    driver = ready()
    assert driver.node._static_margin_m() < 0.15
    covariance = np.zeros(36)
    covariance[7] = 0.25
    claim = msg.PoseWithCovarianceStamped(
        header=msg.header(driver.now_ns, "map"),
        pose=msg.PoseWithCovariance(pose=msg.pose_from_se2(START), covariance=covariance),
    )
    driver.deliver(AMCL_POSE, claim)
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    layer = NavigationConfig().global_costmap.obstacle_layer
    assert driver.node._static_margin_m() == layer.static_margin


def test_odometry_from_the_future_is_of_a_simulation_that_has_ended() -> None:
    driver = ready()
    late = msg.Odometry(
        header=msg.header(driver.now_ns + 10_000_000_000, "odom"),
        child_frame_id="base_footprint",
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(SE2(5.0, 5.0, 0.0)), covariance=np.zeros(36)
        ),
        twist=msg.TwistWithCovariance(
            twist=msg.Twist(linear=msg.Vector3(0.0, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.0)),
            covariance=np.zeros(36),
        ),
    )
    driver.inbox.deliver(ODOM, late, Envelope("old", 0, 0, house().world.hash))
    driver.run(0.5)
    assert driver.rejected(ODOM)["stamp in the future"] == 1
    assert estimate_error_m(driver) < 0.05


@pytest.mark.parametrize("seen", [True, False])
def test_only_what_the_lidar_does_not_see_is_remembered_where_the_wheels_slip(seen: bool) -> None:
    driver = ready()
    drive = driver.node._drive
    assert drive is not None
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    if seen:
        ahead = driver.robot.map_from_base @ SE2(0.13, 0.0, 0.0)
        driver.extra_segments = box_segments(ahead.x_m, ahead.y_m, 0.06)
    slips = driver.of(LOCALIZATION_STATUS)[-1].model_copy(update={"wheel_slip": True})
    driver.deliver(LOCALIZATION_STATUS, slips)
    driver.step()
    assert drive.back_off.is_active
    driver.run(2.0)
    assert (len(drive.hidden.touched_m) > 0) != seen
    assert (len(drive.stopped_at) > 0) != seen


@pytest.mark.parametrize("wedged", [True, False])
def test_a_task_ends_where_the_wheels_turn_and_the_robot_does_not_move(
    wedged: bool, caplog: pytest.LogCaptureFixture
) -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    place, drive = driver.robot.map_from_base, driver.node._drive
    assert drive is not None
    with caplog.at_level(logging.INFO):
        while not driver.results():
            driver.step()
            if wedged or driver.now_ns < 10_000_000_000:
                driver.robot.map_from_base = place
                # What has stopped it does not keep it from trying again.
                drive.forget_hidden()
            assert driver.now_ns < 90_000_000_000
    (result,) = driver.results()
    assert result.error_code == (ErrorCode.FAILED_TO_MAKE_PROGRESS if wedged else 0)
    if wedged:
        assert result.error_msg == "stuck: the wheels turn, the robot does not move"
    told = [one for one in caplog.messages if one.startswith("the wheels slip")]
    assert len(told) == 1
