"""The navigation node: goals, maps, poses and sensors that come and go, over its topics."""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    SCAN_FRAME,
    SE2,
    quaternion_from_rotation,
    wrap_angle,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import BehaviorTreeLog, DockRobot, SendGoal
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    Entities,
    MarkerEntity,
    NavigationResult,
    Planar,
    SimulationStats,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    AMCL_POSE,
    BEHAVIOR_TREE,
    BY_NAME,
    CAMERA_INFO,
    CANCEL_GOAL,
    CMD_VEL,
    CMD_VEL_TELEOP,
    DETECTIONS,
    ENTITIES,
    GLOBAL_COSTMAP,
    GLOBAL_COSTMAP_UPDATES,
    GLOBAL_LOCALIZATION_REQUEST,
    GOAL_POSE,
    INITIAL_POSE,
    INPUT_AT_WAYPOINT,
    LOCALIZATION_STATUS,
    MAP,
    NAVIGATION_STATUS,
    ODOM,
    PARTICLE_CLOUD,
    PAUSE_GOAL,
    PHOTO,
    PHOTO_REQUEST,
    PLAN,
    SEND_GOAL,
    SIMULATION_STATS,
    SMOOTH_PATH,
    TF,
    TF_STATIC,
    TRAJECTORIES,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope
from mazebot.common.world.footprint import wall_corners
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP
from mazebot.navigation.control.safety.collision_monitor import CollisionMonitorParams, moved_points
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import LETHAL_OBSTACLE
from mazebot.navigation.drive import Drive
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.messages import planar_document
from mazebot.navigation.node import NavigationNode
from mazebot.worldgen.map.occupancy import Grid, rasterise
from tests.common.samples import SAMPLES
from tests.navigation.driving import (
    IDENTITY,
    LOCATIONS,
    START,
    TOUR,
    NodeDriver,
    box_segments,
    estimate_error_m,
    fixed_frames,
    odometry,
    wall_distance_m,
)
from tests.navigation.house_tour import house

M = TypeVar("M")
STOPS_PER_TIMEOUT = round(CollisionMonitorParams().stop_pub_timeout * 1e9 / CONTROL_PERIOD_NS)


def ready(**options: object) -> NodeDriver:
    driver = NodeDriver(**options)  # type: ignore[arg-type]
    driver.learn()
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    return driver


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


def reply(driver: NodeDriver, goal: SE2, frame_id: str = "map") -> NavigationResult:
    """The answer within one period."""
    driver.goal(goal, frame_id)
    stamp_ns = driver.now_ns
    driver.step()
    (result,) = driver.results()
    assert result.goal_stamp_ns == stamp_ns
    assert "\n" not in result.error_msg
    return result


@pytest.mark.parametrize(
    ("goal", "code", "says"),
    [
        (SE2(99.0, 0.0, 0.0), 204, "(99.00, 0.00)"),
        (SE2(1e6, 0.0, 0.0), 204, "1e+06"),
        (SE2(0.4, 0.55, 0.0), 206, "(0.40, 0.55) is inside an obstacle"),
        (SE2(0.4, 0.4, 0.0), 206, "0."),
        (SE2(5.0, -2.5, 0.0), 208, "unknown"),
    ],
)
def test_a_bad_goal_is_answered_at_once_and_moves_nothing(goal: SE2, code: int, says: str) -> None:
    driver = ready()
    result = reply(driver, goal)
    assert result.error_code == code
    assert says in result.error_msg
    driver.run(1.0)
    assert driver.robot.map_from_base == START
    assert driver.of(CMD_VEL) == []


def test_a_goal_in_another_frame_is_refused_by_its_name() -> None:
    result = reply(ready(), LOCATIONS["location1"], "odom")
    assert result.error_code == ErrorCode.TF_ERROR
    assert "'odom'" in result.error_msg
    assert "'map'" in result.error_msg


def test_a_goal_without_a_frame_is_in_the_map() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"], "")
    driver.run(0.2)
    assert driver.results() == []
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"


def test_a_goal_that_is_not_finite_is_counted_and_moves_nothing() -> None:
    driver = ready()
    driver.goal(SE2(math.nan, 0.0, 0.0))
    driver.run(0.5)
    assert driver.rejected(GOAL_POSE)["not finite"] == 1
    assert driver.of(CMD_VEL) == []


def test_a_bad_goal_does_not_disturb_the_one_being_driven_to() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.goal(SE2(99.0, 0.0, 0.0))
    driver.run(0.1)
    assert [result.error_code for result in driver.results()] == [204]
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"
    driver.run(6.0)
    assert [result.error_code for result in driver.results()] == [204, 0]


def test_before_navigation_is_active_a_goal_is_refused_with_what_it_waits_for() -> None:
    driver = NodeDriver()
    result = reply(driver, LOCATIONS["location1"])
    assert result.error_code == ErrorCode.GOAL_REJECTED
    assert "the world" in result.error_msg


def test_a_map_larger_than_can_be_planned_in_is_refused_and_the_robot_drives_on() -> None:
    driver = ready()
    cells = np.zeros((2001, 2000), np.int8)
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, SE2(0.0, 0.0, 0.0), cells))
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0
    assert driver.rejected(MAP) == {"invalid map": 1}


def test_of_thousands_of_goals_at_once_the_newest_is_driven_to_and_each_is_answered() -> None:
    driver = ready()
    for number in range(900):
        driver.goal(LOCATIONS["location1" if number % 2 else "location3"])
    begin_s = time.process_time()
    driver.step()
    # A way to each of them would take seconds.
    assert time.process_time() - begin_s < 0.5
    assert [result.error_code for result in driver.results()] == [ErrorCode.PREEMPTED] * 899
    driver.run(0.2)
    goal = driver.of(NAVIGATION_STATUS)[-1].goal
    assert goal is not None
    assert goal.se2() == LOCATIONS["location1"]


def test_the_newest_goal_that_can_be_reached_is_taken() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.goal(LOCATIONS["location1"])
    driver.goal(SE2(99.0, 0.0, 0.0))
    driver.step()
    assert [result.error_code for result in driver.results()] == [ErrorCode.PREEMPTED, 204]


def test_a_ring_of_fixed_frames_is_refused_and_the_robot_drives_on() -> None:
    driver = ready()
    back = msg.transform_stamped(0, SCAN_FRAME, BASE_FOOTPRINT_FRAME, np.eye(4))
    driver.deliver(TF_STATIC, msg.TFMessage([back]))
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0
    assert driver.rejected(TF_STATIC) == {"loop in the frame tree": 1}


def test_a_new_goal_preempts() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    first_ns = driver.now_ns
    driver.run(2.0)
    driver.goal(LOCATIONS["location3"])
    driver.run(0.1)
    (result,) = driver.results()
    assert (result.goal_stamp_ns, result.error_code) == (first_ns, ErrorCode.PREEMPTED)
    assert driver.of(NAVIGATION_STATUS)[-1].goal is not None


def test_it_says_what_it_waits_for_in_the_order_it_comes() -> None:
    driver = NodeDriver()
    driver.blind = True
    said = [driver.node.waiting_for()]
    driver.deliver(WORLD, house().world)
    driver.node.step(0, driver.inbox, driver.outbox)
    said.append(driver.node.waiting_for())
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, house().map_origin, house().map_cells))
    driver.node.step(0, driver.inbox, driver.outbox)
    said.append(driver.node.waiting_for())
    driver.learn()
    driver.step()
    said.append(driver.node.waiting_for())
    driver.blind = False
    driver.run(0.2)
    said.append(driver.node.waiting_for())
    assert said == ["the world", "the map", "static transforms on /tf_static", "a scan", None]


def test_what_is_no_map_is_refused_and_counted() -> None:
    driver = NodeDriver()
    driver.deliver(WORLD, house().world)
    driver.deliver(MAP, msg.occupancy_grid(0, 0.0, house().map_origin, house().map_cells))
    driver.step()
    assert driver.rejected(MAP)["invalid map"] == 1
    assert driver.node.waiting_for() == "the map"


def test_it_drives_by_a_map_that_is_turned() -> None:
    grid = Grid(240, 260, 0.05, SE2(-1.6, -5.6, 0.5))
    walls = np.array([wall_corners(wall) for wall in house().world.walls])
    cells = np.where(rasterise([walls], grid), 100, 0).astype(np.int8)
    driver = ready()
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, grid.origin, cells))
    driver.run(0.5)
    driver.goal(LOCATIONS["location1"])
    driver.run(20.0)
    (result,) = driver.results()
    assert (result.error_code, result.error_msg) == (0, "")
    assert driver.robot.map_from_base.distance_m(LOCATIONS["location1"]) < 0.3
    assert estimate_error_m(driver) < 0.05
    assert msg.se2_from_pose(driver.of(GLOBAL_COSTMAP)[-1].info.origin).yaw_rad == 0.0


def test_the_same_world_and_map_latched_again_change_nothing() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    driver.learn()
    driver.run(0.2)
    assert driver.results() == []
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"


def test_a_paused_task_is_told_as_held() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    for pause, states in ((True, {"held"}), (False, {"planning", "controlling"})):
        driver.inbox.ask(PAUSE_GOAL, act.PauseGoal(pause=pause), lambda _: None)
        driver.run(1.0)
        assert driver.of(NAVIGATION_STATUS)[-1].state in states


def test_another_world_aborts_the_goal_and_begins_at_its_start() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    other = house().world.model_copy(update={"hash": "0123456789abcdef"})
    driver.deliver(WORLD, other)
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    assert driver.node.world_hash == other.hash
    last = driver.of(CMD_VEL)[-1].twist
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    # Odometry of the world before counts no longer.
    assert driver.node.waiting_for() == "odometry"
    driver.run(0.2)
    assert driver.rejected(ODOM)["other world"] > 0


def test_time_going_back_begins_anew_at_the_start() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(5.0)
    driver.now_ns = 0
    driver.robot.map_from_base = START
    driver.odom_from_base = IDENTITY
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.05
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0


def test_another_epoch_begins_anew_though_time_goes_on() -> None:
    driver = ready()
    driver.deliver(SIMULATION_STATS, stats(epoch=1))
    driver.goal(LOCATIONS["location1"])
    driver.run(5.0)
    assert driver.results() == []
    # The robot stands at its start again; one message of before is still on its way.
    driver.deliver(ODOM, odometry(driver.now_ns, driver.odom_from_base, STOP))
    driver.robot.map_from_base = START
    driver.odom_from_base = IDENTITY
    driver.deliver(SIMULATION_STATS, stats(epoch=2, sim_time_s=driver.now_ns * 1e-9 + 0.01))
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    driver.run(0.5)
    assert driver.rejected(ODOM)["from an earlier epoch"] == 1
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.05


def test_the_seed_is_the_simulation_s() -> None:
    clouds = []
    for config_seed, told_seed in ((7, 7), (7, 8), (8, 8)):
        driver = NodeDriver(config=NavigationConfig(seed=config_seed))
        driver.deliver(SIMULATION_STATS, stats(epoch=1, seed=told_seed))
        driver.learn()
        driver.run(2.0)
        clouds.append(wire.encode(PARTICLE_CLOUD, driver.of(PARTICLE_CLOUD)[-1]))
    assert clouds[0] != clouds[1]
    assert clouds[1] == clouds[2]


def test_a_robot_that_obeys_neither_way_has_met_nothing(caplog: pytest.LogCaptureFixture) -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.deaf = True
    driver.run(8.0)
    assert "remembered as an obstacle" not in caplog.text


def test_a_robot_whose_watchdog_stopped_it_has_met_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    driver = ready()

    def tell(stops: int) -> None:
        told = stats(epoch=1, sim_time_s=driver.now_ns * 1e-9)
        driver.deliver(SIMULATION_STATS, told.model_copy(update={"watchdog_stops": stops}))

    tell(0)
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    driver.deaf = True
    tell(1)
    # It hears them again when one that was taken for stuck would drive back.
    driver.run(5.0)
    driver.deaf = False
    driver.run(1.0)
    assert "commands do not reach it in time" in caplog.text
    for _ in range(1200):
        driver.step()
        if driver.results():
            break
    assert [result.error_code for result in driver.results()] == [0]
    assert "remembered as an obstacle" not in caplog.text


def stats(epoch: int, seed: int = 7, sim_time_s: float = 0.0) -> SimulationStats:
    return SimulationStats(
        world_hash=house().world.hash, sim_time_s=sim_time_s, iterations=0, step_size_s=1 / 240,
        seed=seed, epoch=epoch, renderer="none", state_hash="",
    )  # fmt: skip


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


def test_a_doorway_closed_on_the_way_ends_in_a_stop_and_a_code() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(2.5)
    driver.extra_segments = box_segments(1.33, -0.87, 0.85)
    driver.run(30.0)
    (result,) = driver.results()
    assert result.error_code == ErrorCode.NO_VALID_PATH
    assert result.number_of_recoveries > 0
    # It was closed 2.5 s after the start.
    assert result.end_time_s - result.start_time_s < 22.5
    from_box = np.maximum(np.abs(driver.log.points_m() - [1.33, -0.87]) - 0.425, 0.0)
    assert np.linalg.norm(from_box, axis=1).min() > 0.2
    assert wall_distance_m(driver.log.points_m()).min() > 0.23
    assert len(driver.of(GLOBAL_COSTMAP)) > 1


def test_the_global_costmap_with_its_updates_is_the_next_one() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(2.5)
    driver.extra_segments = box_segments(1.33, -0.87, 0.85)
    driver.run(3.0)
    costmaps, updates = driver.of(GLOBAL_COSTMAP), driver.of(GLOBAL_COSTMAP_UPDATES)
    assert len(updates) > len(costmaps) > 1
    stamp_ns = [msg.ns_from_time(one.header.stamp) for one in costmaps]
    changed = late = 0
    for (before, after), times in zip(
        itertools.pairwise(costmaps), itertools.pairwise(stamp_ns), strict=True
    ):
        cells, wanted = msg.cells_from_grid(before).copy(), msg.cells_from_grid(after)
        changed += int(np.count_nonzero(cells != wanted))
        for update in updates:
            if times[0] < msg.ns_from_time(update.header.stamp) < times[1]:
                wire.validate(GLOBAL_COSTMAP_UPDATES, update)
                rows = np.s_[update.y : update.y + update.height]
                columns = np.s_[update.x : update.x + update.width]
                cells[rows, columns] = update.data.reshape(update.height, update.width)
        late += int(np.count_nonzero(cells != wanted))
    # What has changed since the last update is in the costmap alone.
    assert late < changed
    assert min(update.width * update.height for update in updates) < wanted.size


def test_without_scans_the_robot_stands_until_they_come_back() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    driver.blind = True
    driver.run(1.5)
    assert driver.robot.velocity.linear_m_s == 0.0
    assert driver.results() == []
    driver.blind = False
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


def test_a_stop_is_repeated_for_a_while_only_so_that_another_source_may_drive() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    driver.blind = True
    driver.run(2.5)
    told = driver.of(CMD_VEL)
    driver.run(2.0)
    assert driver.of(CMD_VEL) == told
    zeros = [one for one in told if one.twist.linear.x == one.twist.angular.z == 0.0]
    assert STOPS_PER_TIMEOUT - 2 <= len(zeros) <= STOPS_PER_TIMEOUT + 2
    driver.blind = False
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


@pytest.mark.parametrize("topic", ["/localization/status", "/odom", "/scan"])
def test_the_robot_stands_at_once_where_the_source_of_a_topic_is_gone(
    topic: str, caplog: pytest.LogCaptureFixture
) -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(4.0)
    assert driver.robot.velocity.linear_m_s > 0.2
    source = driver.node._measured.sources[topic]
    # What is still on the way arrives.
    driver.inbox.leave(source)
    driver.step()
    assert driver._command == STOP
    driver.run(0.5)
    assert driver.robot.velocity == STOP
    assert f"publisher of {topic} is gone" in caplog.text
    driver.inbox.come_back(source)
    driver.run(8.0)
    assert [r.error_code for r in driver.results()] == [0]


def test_only_a_missed_control_period_makes_the_controller_try_fewer_trajectories() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    assert "trajectories tried" not in driver.node.facts()
    driver.now_ns += CONTROL_PERIOD_NS
    driver.step()
    assert driver.node.facts()["trajectories tried"] == "1400"


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


def test_a_goal_of_a_lost_robot_is_taken_if_moving_finds_its_pose() -> None:
    for wants_motion in (True, False):
        driver = ready()
        said = driver.of(LOCALIZATION_STATUS)[-1]
        lost = said.model_copy(update={"state": "lost", "wants_motion": wants_motion})
        driver.deliver(LOCALIZATION_STATUS, lost)
        driver.goal(LOCATIONS["location1"])
        driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
        codes = [result.error_code for result in driver.results()]
        assert codes == ([] if wants_motion else [ErrorCode.GOAL_REJECTED])
        drive = driver.node._drive
        assert drive is not None
        assert (drive.navigator.request is not None) == wants_motion


def marks(drive: Drive) -> int:
    """Cells of the global costmap that are occupied though the map has nothing there."""
    costmap = drive.robot.costmap
    lethal = costmap.master.costs == LETHAL_OBSTACLE
    return int((lethal & (costmap.static.costs != LETHAL_OBSTACLE)).sum())


def test_a_goal_is_accepted_from_a_pose_in_a_wall_which_may_be_wrong() -> None:
    drive = ready().node._drive
    assert drive is not None
    in_a_wall, free = SE2(0.4, 0.55, 0.0), LOCATIONS["location1"]
    drive.robot.planner_server.check_goals(in_a_wall, [free])
    with pytest.raises(NavigationError, match="inside an obstacle"):
        drive.robot.planner_server.check_goals(START, [in_a_wall])


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


def marker_entity(name: str, marker_id: int, x_m: float, y_m: float) -> MarkerEntity:
    """A marker that faces +x."""
    # Its columns are right, up and out of the wall, as one looks at it.
    rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return MarkerEntity(
        name=name,
        position_m=(x_m, y_m, 0.3),
        orientation_xyzw=quaternion_from_rotation(rotation),
        panel_side_m=0.4,
        texture_sha256="",
        marker_id=marker_id,
        marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )


def sighting(stamp_ns: int, marker_id: int, camera_from_marker: np.ndarray) -> msg.Detection3DArray:
    header = msg.header(stamp_ns, "camera_rgb_optical_frame")
    pose = msg.pose_from_matrix(camera_from_marker)
    covariance = np.diag([1e-4] * 3 + [1e-3] * 3).reshape(36)
    result = msg.ObjectHypothesisWithPose(
        hypothesis=msg.ObjectHypothesis(class_id=str(marker_id), score=1.0),
        pose=msg.PoseWithCovariance(pose=pose, covariance=covariance),
    )
    box = msg.BoundingBox3D(center=pose, size=msg.Vector3(0.3, 0.3, 0.0))
    detection = msg.Detection3D(header=header, results=[result], bbox=box, id=str(marker_id))
    return msg.Detection3DArray(header=header, detections=[detection])


def test_a_marker_of_the_world_is_used_and_others_are_counted() -> None:
    entities = Entities(
        world_hash=house().world.hash,
        entities=(marker_entity("marker_80", 80, -1.8, 0.427),),
    )
    driver = NodeDriver(start=SE2(-0.8, 0.427, math.pi))
    driver.learn(entities=entities)
    driver.blind = True
    driver.run(0.2)
    driver.blind = False
    frames = fixed_frames().transforms
    base_from_camera = msg.chain_transforms(frames, "base_footprint", "camera_rgb_optical_frame")
    assert base_from_camera is not None
    rotation = msg.matrix_from_pose(
        msg.Pose(
            position=msg.Point(-1.8, 0.427, 0.3),
            orientation=msg.Quaternion(*entities.entities[0].orientation_xyzw),
        )
    )
    camera_from_map = np.linalg.inv(driver.robot.map_from_base.matrix() @ base_from_camera)
    for _ in range(40):
        seen = camera_from_map @ rotation
        driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, seen))
        driver.deliver(DETECTIONS, sighting(driver.now_ns, 81, seen))
        driver.step()
    rejected = driver.rejected(DETECTIONS)
    assert rejected["unknown marker"] == 40
    assert estimate_error_m(driver) < 0.1


def test_a_marker_that_hangs_twice_is_not_used() -> None:
    entities = Entities(
        world_hash=house().world.hash,
        entities=(marker_entity("a", 80, -1.8, 0.427), marker_entity("b", 80, 1.5, 2.1)),
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1
    assert estimate_error_m(driver) < 0.05


def test_markers_of_another_world_are_not_used() -> None:
    entities = Entities(
        world_hash="0123456789abcdef", entities=(marker_entity("a", 80, -1.8, 0.427),)
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1
    driver.deliver(ENTITIES, entities.model_copy(update={"world_hash": house().world.hash}))
    driver.step()
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1


def test_docks_are_where_the_newest_camera_sees_the_marker() -> None:
    entities = Entities(
        world_hash=house().world.hash, entities=(marker_entity("a", 80, -1.8, 0.427),)
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    goal = SendGoal(goal_id="dock", goal=DockRobot(dock_id="80"))
    driver.inbox.ask(SEND_GOAL, goal, lambda _: None)
    driver.step()
    driver.step()
    (blind,) = driver.of(ACTION_RESULT)
    assert (blind.error_code, blind.action) == (902, "dock_robot")
    assert "dock '80': docking needs the camera" in blind.error_msg
    asked = []
    for focal_px in (554.4, 277.2):
        matrix = np.array([[focal_px, 0.0, 320.0], [0.0, focal_px, 240.0], [0.0, 0.0, 1.0]])
        info = replace(SAMPLES[CAMERA_INFO], width=640, height=480, k=matrix.reshape(9))
        driver.deliver(CAMERA_INFO, info)
        driver.step()
        drive = driver.node._drive
        assert drive is not None
        asked.append(drive.robot.dock("80").marker_from_dock.x_m)
    # The camera is 0.07 m ahead; the panel reaches 0.39 m, the free picture 230.4 px above it.
    assert asked == pytest.approx([1.01, 0.54])


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


def test_the_node_is_made_from_its_defaults_and_waits() -> None:
    assert NavigationNode(NavigationConfig()).waiting_for() == "the world"


def cancelled(driver: NodeDriver, stamp_ns: int | None = None) -> CancelGoalReply:
    """The answer to a request to cancel, in a step in which no time passes."""
    answers: list[CancelGoalReply] = []
    driver.inbox.ask(CANCEL_GOAL, CancelGoal(goal_stamp_ns=stamp_ns), answers.append)
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    (answer,) = answers
    return answer


def asked(driver: NodeDriver, query: Any, message: Any) -> Any:
    """The answer to a query."""
    answers: list[Any] = []
    driver.inbox.ask(query, message, answers.append)
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    (answer,) = answers
    return answer


def test_a_goal_that_is_sent_twice_is_driven_once() -> None:
    driver = ready()
    goal = act.NavigateToPose(pose=planar_document(LOCATIONS["location1"]))
    send = act.SendGoal(goal_id="a", goal=goal)
    assert asked(driver, SEND_GOAL, send).accepted
    driver.run(1.0)
    assert asked(driver, SEND_GOAL, send).accepted
    other = asked(driver, SEND_GOAL, act.SendGoal(goal_id="a", goal=act.Spin(target_yaw_rad=1.0)))
    assert other.error_msg == "goal_id: 'a': must be unique: in use"
    driver.run(0.2)
    assert driver.of(ACTION_RESULT) == []
    assert asked(driver, SEND_GOAL, act.SendGoal(goal_id="b", goal=goal)).accepted
    driver.run(0.2)
    (result,) = driver.of(ACTION_RESULT)
    # As in Nav2: who sent it asked for no cancellation.
    preempted = ("a", "aborted", ErrorCode.PREEMPTED)
    assert (result.goal_id, result.status, result.error_code) == preempted
    late = asked(driver, SEND_GOAL, send)
    assert late.error_msg == "goal_id: 'a': must be unique: this goal has ended"
    driver.run(0.2)
    assert len(driver.of(ACTION_RESULT)) == 1


def test_at_a_waypoint_a_picture_and_an_input_are_waited_for() -> None:
    driver = ready()
    at = driver.robot.map_from_base
    task = act.WaypointTask(wait_s=0.0, photo=True, input_timeout_s=30.0)
    here = Planar(x_m=at.x_m, y_m=at.y_m, yaw_rad=at.yaw_rad)
    goal = act.FollowWaypoints(poses=(here,), tasks=(task,))
    assert asked(driver, INPUT_AT_WAYPOINT, act.Empty()).error
    assert asked(driver, SEND_GOAL, act.SendGoal(goal_id="a", goal=goal)).accepted
    driver.run(1.0)
    (request,) = driver.of(PHOTO_REQUEST)
    assert request.waypoint == 0
    picture = np.zeros(9, np.uint8)

    def photo(stamp_ns: int) -> msg.CompressedImage:
        return msg.CompressedImage(msg.header(stamp_ns, "camera"), "png", picture)

    # One of before the request is another's.
    driver.deliver(PHOTO, photo(request.stamp_ns - 1))
    driver.run(0.2)
    assert asked(driver, INPUT_AT_WAYPOINT, act.Empty()).error == ""
    driver.run(0.2)
    assert driver.of(ACTION_RESULT) == []
    driver.deliver(PHOTO, photo(request.stamp_ns))
    driver.run(0.2)
    (result,) = driver.of(ACTION_RESULT)
    assert (result.status, result.waypoints) == ("succeeded", ())


def test_a_path_with_a_corner_is_smoothed_or_refused() -> None:
    driver = ready()
    corner = ((0.0, 0.0), (0.3, 0.0), (0.3, -0.3))
    path = tuple(Planar(x_m=x, y_m=y, yaw_rad=0.0) for x, y in corner)
    reply = asked(driver, SMOOTH_PATH, act.SmoothPath(path=path, check_for_collisions=True))
    assert (reply.error_code, reply.error_msg) == (0, "")
    points = np.array([(pose.x_m, pose.y_m) for pose in reply.path])
    assert points[0] == pytest.approx(corner[0], abs=0.01)
    assert points[-1] == pytest.approx(corner[-1], abs=0.01)
    turns = np.diff(np.unwrap([pose.yaw_rad for pose in reply.path[:-1]]))
    assert np.abs(turns).max() < 0.6
    for path_, words, code in (
        (path[:1], {}, ErrorCode.SMOOTHER_INVALID_PATH),
        (path, {"smoother_id": "nope"}, ErrorCode.INVALID_SMOOTHER),
        ((path[0], Planar(x_m=0.0, y_m=99.0, yaw_rad=0.0)), {}, ErrorCode.FAILED_TO_SMOOTH_PATH),
        (
            (path[0], Planar(x_m=0.0, y_m=2.0, yaw_rad=0.0)),
            {"check_for_collisions": True},
            ErrorCode.SMOOTHED_PATH_IN_COLLISION,
        ),
    ):
        reply = asked(driver, SMOOTH_PATH, act.SmoothPath(path=path_, **words))
        assert (reply.error_code, reply.path) == (code, ())
        assert "\n" not in reply.error_msg


def test_a_cancelled_goal_ends_and_the_robot_stops() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    sent_ns = driver.now_ns
    driver.run(2.0)
    commands = len(driver.of(CMD_VEL))
    other = cancelled(driver, sent_ns + 1)
    assert (other.return_code, other.goal) == (2, None)
    assert str(sent_ns + 1) in other.error
    # It was no control period, and the robot drives on.
    assert len(driver.of(CMD_VEL)) == commands
    twist = driver.of(CMD_VEL)[-1].twist
    assert abs(twist.linear.x) + abs(twist.angular.z) > 0.1
    answer = cancelled(driver, sent_ns)
    assert (answer.error, answer.return_code, answer.goal_stamp_ns) == ("", 0, sent_ns)
    twist = driver.of(CMD_VEL)[-1].twist
    assert (twist.linear.x, twist.angular.z) == (0.0, 0.0)
    (result,) = driver.results()
    assert (result.error_code, result.goal_stamp_ns) == (ErrorCode.CANCELED, sent_ns)
    assert driver.of(NAVIGATION_STATUS)[-1].state == "idle"
    driver.run(1.0)
    assert driver.robot.velocity.linear_m_s == 0.0
    assert "no active goal" in cancelled(driver).error


def test_after_a_cancelled_goal_another_is_driven_to() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(1.0)
    assert cancelled(driver).error == ""
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0


def commands_m_s(driver: NodeDriver) -> list[float]:
    return [message.twist.linear.x for message in driver.of(CMD_VEL)]


def test_a_persons_command_is_reached_and_ends_by_ramps_within_the_limits() -> None:
    driver = ready()
    header = msg.header(0, "base_footprint")
    wanted = msg.TwistStamped(header, msg.Twist(msg.Vector3(0.0, 0.0, 0.0),
                                                msg.Vector3(0.0, 0.0, 1.0)))  # fmt: skip
    for _ in range(12):
        driver.deliver(CMD_VEL_TELEOP, wanted)
        driver.step()
    told = [message.twist.angular.z for message in driver.of(CMD_VEL)]
    assert told[:3] == pytest.approx([0.1, 0.2, 0.3])
    assert told[-1] == 1.0
    # Nobody says any more that it should turn.
    driver.run(2.0)
    told = [message.twist.angular.z for message in driver.of(CMD_VEL)]
    assert np.abs(np.diff(told)).max() <= 0.1 + 1e-6
    assert told[-2] == pytest.approx(0.1)
    assert told[-1] == 0.0
    driver.run(0.5)
    assert len(driver.of(CMD_VEL)) == len(told)


def test_a_robot_that_may_not_see_stops_without_a_ramp() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.5)
    # The collision monitor would stop it too.
    assert driver.node._drive is not None
    driver.node._drive.robot.toggle_collision_monitor(False)
    driver.blind = True
    driver.run(1.0)
    told = commands_m_s(driver)
    assert max(told) > 0.2
    assert told[-1] == 0.0
    assert max(abs(a - b) for a, b in itertools.pairwise(told)) > 0.1


def test_after_a_stop_between_two_periods_nothing_moves_any_more() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.5)
    assert commands_m_s(driver)[-1] > 0.1
    assert cancelled(driver).error == ""
    sent = len(driver.of(CMD_VEL))
    driver.run(1.0)
    assert set(commands_m_s(driver)[sent - 1 :]) == {0.0}


class GrowingMapDriver(NodeDriver):
    """Navigation hears of a robot that maps; whoever localises it knows the whole map."""

    def deliver(self, topic: Topic[M], message: M | bytes) -> None:
        if topic.name not in (WORLD.name, MAP.name):
            super().deliver(topic, message)
            return
        number = self._sequence.get(topic.name, 0)
        self._sequence[topic.name] = number + 1
        envelope = Envelope("test", number, self.now_ns, house().world.hash)
        self.localization_inbox.deliver(topic, message, envelope)
        if topic.name == WORLD.name:
            mapped = house().world.model_copy(update={"slam": True})
            self.inbox.deliver(WORLD, mapped, envelope)

    def show(self, limit_x_m: float) -> None:
        """The map as far as a line across the house: the rest is unknown, and left out."""
        columns = round((limit_x_m - house().map_origin.x_m) / 0.05)
        cells = house().map_cells[:, :columns].copy()
        grid = msg.occupancy_grid(self.now_ns, 0.05, house().map_origin, cells)
        self.inbox.deliver(MAP, grid, Envelope("mapping", self.now_ns, self.now_ns, ""))

    def refusals(self) -> Counter[str]:
        return self.inbox.counts[MAP.name].rejected


def test_a_map_grows_while_the_robot_drives_and_the_task_goes_on() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    driver.show(2.0)
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    assert driver.drive_to(LOCATIONS["location3"]).error_code != 0
    driver.show(3.0)
    driver.run(0.2)
    driver.goal(SE2(1.6, -0.9, 0.0))
    results = len(driver.results())
    for step in range(40):
        driver.show(3.0 + 0.05 * step)
        driver.run(0.3)
    assert [one.error_code for one in driver.results()[results:]] == [0]
    assert driver.drive_to(LOCATIONS["location3"]).error_code == 0
    assert driver.of(GLOBAL_COSTMAP)[-1].info.width > driver.of(GLOBAL_COSTMAP)[0].info.width
    assert not driver.refusals()


def test_a_wall_that_the_map_comes_to_show_makes_a_new_way() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    driver.show(9.0)
    driver.run(0.3)
    driver.goal(LOCATIONS["location3"])
    driver.run(1.0)
    before = driver.of(PLAN)[-1]
    cells = house().map_cells.copy()
    x_m = before.poses[len(before.poses) // 2].pose.position.x
    column = round((x_m - house().map_origin.x_m) / 0.05)
    cells[:, column - 2 : column + 2] = 100
    grid = msg.occupancy_grid(driver.now_ns, 0.05, house().map_origin, cells)
    driver.inbox.deliver(MAP, grid, Envelope("mapping", driver.now_ns, driver.now_ns, ""))
    for _ in range(60):
        driver.run(1.0)
        if driver.results():
            break
    assert driver.results()[-1].error_code == ErrorCode.NO_VALID_PATH
    assert driver.robot.map_from_base.x_m < x_m


def test_a_map_of_an_earlier_run_is_not_driven_in() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    late = msg.occupancy_grid(99_000_000_000, 0.05, house().map_origin, house().map_cells)
    driver.inbox.deliver(MAP, late, Envelope("mapping", 0, 0, ""))
    driver.run(1.0)
    assert driver.node.waiting_for() == "the map"
    driver.show(2.0)
    driver.step()
    assert driver.node.waiting_for() != "the map"
    (columns,) = {grid.info.width for grid in driver.of(GLOBAL_COSTMAP)}
    assert columns < house().map_cells.shape[1]


def test_a_map_that_is_sent_once_waits_for_the_clock_and_the_world() -> None:
    driver = GrowingMapDriver()
    ahead_ns = 300_000_000
    grid = msg.occupancy_grid(ahead_ns, 0.05, house().map_origin, house().map_cells)
    driver.inbox.deliver(MAP, grid, Envelope("mapping", 0, ahead_ns, ""))
    driver.run(0.1)
    assert driver.node.waiting_for() == "the world"
    driver.learn()
    driver.run(0.1)
    assert driver.node.waiting_for() == "the map"
    driver.run(0.2)
    assert driver.node.waiting_for() != "the map"
    assert not driver.refusals()


def test_of_a_world_that_is_being_mapped_no_dock_is_known() -> None:
    driver = GrowingMapDriver()
    marker = SAMPLES[ENTITIES].entities[0]
    driver.learn(entities=Entities(world_hash=house().world.hash, entities=(marker,)))
    driver.run(0.2)
    driver.show(9.0)
    driver.run(0.5)
    send = SendGoal(goal_id="d", goal=DockRobot(dock_id="60"))
    asked(driver, SEND_GOAL, send)
    driver.run(1.0)
    (result,) = driver.of(ACTION_RESULT)
    assert result.error_code == ErrorCode.DOCK_NOT_IN_DB
