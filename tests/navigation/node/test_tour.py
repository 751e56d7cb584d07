"""A tour of the house through the navigation node, and all that it publishes on the way."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    SE2,
    wrap_angle,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import BehaviorTreeLog
from mazebot.common.messages.topics import (
    AMCL_POSE,
    BEHAVIOR_TREE,
    BY_NAME,
    CMD_VEL,
    GLOBAL_COSTMAP,
    NAVIGATION_STATUS,
    PARTICLE_CLOUD,
    PLAN,
    TF,
    TRAJECTORIES,
)
from mazebot.navigation.costmap.footprint import WAFFLE
from tests.navigation.driving import (
    LOCATIONS,
    TOUR,
    NodeDriver,
    estimate_error_m,
    ready,
    wall_distance_m,
)


def outline_distance_m(driver: NodeDriver) -> float:
    """Least distance of the corners of the robot's outline to the walls, over a drive."""
    corners = [
        [pose @ SE2(x, y, 0.0) for x, y in WAFFLE.points_m.tolist()] for pose in driver.log.poses
    ]
    points_m = np.array([corner[:2] for each in corners for corner in each])
    return float(wall_distance_m(points_m).min())


@pytest.fixture(scope="module")
def tour() -> NodeDriver:
    driver = ready()
    for goal in TOUR:
        result = driver.drive_to(goal)
        assert (result.error_code, result.number_of_recoveries) == (0, 0)
        driver.run(0.5)
        truth = driver.robot.map_from_base
        assert truth.distance_m(goal) < 0.15
        assert abs(wrap_angle(truth.yaw_rad - goal.yaw_rad)) < 0.15
    return driver


@pytest.mark.slow
def test_the_tour_takes_less_than_ninety_seconds_and_touches_nothing(tour: NodeDriver) -> None:
    assert sum(r.end_time_s - r.start_time_s for r in tour.results()) < 90.0
    assert outline_distance_m(tour) > 0.04


def test_the_estimate_follows_the_truth(tour: NodeDriver) -> None:
    assert estimate_error_m(tour) < 0.1


def test_everything_put_out_survives_the_wire(tour: NodeDriver) -> None:
    assert tour.outbox.rejected == Counter()
    seen: Counter[str] = Counter()
    for name, message in tour.sent:
        seen[name] += 1
        if seen[name] > 5:
            continue
        topic = BY_NAME[name]
        data = wire.encode(topic, message)
        again = wire.decode(topic, data)
        wire.validate(topic, again)
        assert wire.encode(topic, again) == data


def test_each_topic_has_its_rate(tour: NodeDriver) -> None:
    seconds = tour.now_ns * 1e-9
    counts = Counter(name for name, _ in tour.sent)
    for topic, rate_hz in ((TF.name, 20.0), (AMCL_POSE.name, 10.0), (PARTICLE_CLOUD.name, 2.0)):
        assert counts[topic] / seconds == pytest.approx(rate_hz, rel=0.05)
    assert 2.0 * seconds <= len(tour.of(NAVIGATION_STATUS)) <= 3.0 * seconds
    assert len(tour.of(GLOBAL_COSTMAP)) == 1
    assert len(tour.of(PLAN)) >= len(TOUR)
    assert all(len(cloud.poses) <= 500 for cloud in tour.of(PARTICLE_CLOUD))


def test_map_from_odom_and_odometry_make_the_estimate(tour: NodeDriver) -> None:
    (entry,) = tour.of(TF)[-1].transforms
    assert (entry.header.frame_id, entry.child_frame_id) == ("map", "odom")
    matrix = msg.matrix_from_transform(entry.transform)
    map_from_odom = SE2(matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0]))
    pose = map_from_odom @ tour.odom_from_base
    assert pose.distance_m(tour.robot.map_from_base) < 0.1


def test_commands_come_while_driving_end_with_a_stop_and_cease(tour: NodeDriver) -> None:
    commands = tour.of(CMD_VEL)
    last = commands[-1].twist
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    ended_s = tour.results()[-1].end_time_s
    assert msg.ns_from_time(commands[-1].header.stamp) * 1e-9 <= ended_s + 0.05
    driving_s = sum(r.end_time_s - r.start_time_s for r in tour.results())
    assert len(commands) == pytest.approx(20.0 * driving_s, rel=0.02)


def test_the_status_tells_of_the_goal(tour: NodeDriver) -> None:
    states = tour.of(NAVIGATION_STATUS)
    driving = [status for status in states if status.goal is not None]
    assert {status.state for status in driving} == {"controlling"}
    assert all(status.localization_active and status.navigation_active for status in driving)
    assert driving[0].distance_remaining_m > 1.5
    assert states[-1].state == "idle"
    assert states[-1].goal is None


def test_the_tree_is_told_when_it_changes_and_no_oftener_than_five_times_a_second(
    tour: NodeDriver,
) -> None:
    logs = tour.of(BEHAVIOR_TREE)
    assert len(logs) <= 5.0 * tour.now_ns * 1e-9
    assert all(one != other for one, other in itertools.pairwise(logs))
    assert (logs[0], logs[-1]) == (BehaviorTreeLog(), BehaviorTreeLog())
    driven = [log for log in logs if log.action == "navigate_to_pose"]
    root = driven[0].nodes[0]
    assert (root.kind, root.status, root.depth) == ("RecoveryNode", "RUNNING", 0)
    statuses = {(node.kind, node.status) for log in driven for node in log.nodes}
    # Planning answers within one tick of twenty, at most once a second.
    assert {("FollowPath", "RUNNING"), ("ComputePathToPose", "SUCCESS")} <= statuses


def test_rollouts_are_told_twice_a_second_from_where_the_robot_is(tour: NodeDriver) -> None:
    told = tour.of(TRAJECTORIES)
    driving_s = sum(r.end_time_s - r.start_time_s for r in tour.results())
    assert 0.5 * driving_s < len(told) <= 2.0 * driving_s + 2 * len(TOUR)
    poses = np.array([pose[:2] for pose in tour.log.poses])
    for array in told:
        *rollouts, optimal = array.markers
        assert [one.ns for one in rollouts] == ["rollouts"] * 30
        assert optimal.ns == "optimal"
        begins = {(one.points[0].x, one.points[0].y) for one in array.markers}
        assert len(begins) == 1
        assert np.hypot(*(poses - np.array([*begins])).T).min() < 0.15
        assert rollouts[0].color.r < rollouts[-1].color.r


def test_diagnostics_hold_what_it_does(tour: NodeDriver) -> None:
    assert tour.node.facts() == {"state": "idle", "controller": "mppi"}
    facts = tour.localization.facts()
    assert facts["state"] == "localized"
    assert float(facts["quality"]) > 0.8
    assert int(facts["particles"]) > 100


def test_the_same_run_gives_the_same_bytes() -> None:
    def run() -> list[bytes]:
        driver = ready()
        driver.goal(LOCATIONS["location1"])
        driver.run(5.0)
        return [wire.encode(BY_NAME[name], message) for name, message in driver.sent]

    assert run() == run()
