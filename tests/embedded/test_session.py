"""A program that leads a simulation: time, reset, seed, goals, and what it is told."""

import json
import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import LoadWorld
from mazebot.common.messages.documents import BodyEntity, Box, NavigationStatus, Shape, StopCause
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CMD_VEL,
    GOAL_POSE,
    INITIAL_POSE,
    LOAD_WORLD,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    SCAN,
)
from mazebot.embedded.session import RefusedError, Session
from tests.worldgen import folder

PREEMPTED, WORLD_RESTARTED = 9010, 9011


@pytest.fixture
def worlds_dir(tmp_path: Path) -> Path:
    return folder.make(tmp_path / "worlds")


@pytest.fixture
def session(worlds_dir: Path) -> Iterator[Session]:
    with Session("room", camera=False, worlds_dir=worlds_dir) as opened:
        yield opened


def drive(session: Session) -> str:
    """Some seconds with commands and with a goal; the hash of all states."""
    session.command(0.2, 0.4, for_s=1.0)
    with pytest.raises(TimeoutError):
        session.goal(0.9, 0.0, 0.5, timeout_s=1.0)
    assert session.ground_truth().x_m > 0.2
    return session.stats.state_hash


def test_it_begins_at_time_zero_and_time_passes_only_when_told(session: Session) -> None:
    assert (session.stats.sim_time_s, session.stats.iterations, session.stats.paused) == (
        0,
        0,
        True,
    )
    assert session.latest(SCAN) is None
    assert session.step().iterations == 1
    assert session.step(9).iterations == 10
    assert session.run_for(0.5).iterations == 130
    assert session.run_until(1.0).sim_time_s == 1.0
    assert session.now_s == 1.0
    assert session.stats.paused
    assert session.latest(SCAN) is not None


def test_commands_of_any_length_end(session: Session) -> None:
    # Times such as 0.2 + 0.1 are no whole steps in binary.
    session.run_for(0.2)
    for count in range(1, 30):
        before = session.stats.iterations
        session.command(0.0, 0.1, for_s=count / 100.0)
        assert session.stats.iterations - before == -(-count * 24 // 10)


def test_a_reset_is_a_fresh_start_to_the_last_bit(session: Session, worlds_dir: Path) -> None:
    first = drive(session)
    with session.watching(ODOM) as seen:
        stats = session.reset()
    assert (stats.sim_time_s, stats.iterations, stats.seed, stats.epoch) == (0.0, 0, 7, 2)
    assert seen == []
    assert session.ground_truth() == (0.0, 0.0, 0.0)
    assert drive(session) == first
    assert session.reset(seed=8).seed == 8
    other = drive(session)
    assert other != first
    assert session.reset(seed=7).epoch == 4
    with Session("room", seed=8, camera=False, worlds_dir=worlds_dir) as fresh:
        assert drive(fresh) == other


def test_a_reset_of_time_moves_nothing(session: Session) -> None:
    session.command(0.3, 0.0, for_s=1.02)
    odom, here = session.latest(ODOM), session.ground_truth()
    assert odom is not None
    assert here.x_m > 0.1
    with session.watching(NAVIGATION_STATUS) as told:
        stats = session.reset(scope="time")
    assert (stats.sim_time_s, stats.iterations, stats.epoch) == (0.0, 0, 2)
    assert not told[-1].localization_active
    with session.watching(ODOM) as odometry:
        session.command(0.3, 0.0, for_s=0.5)
    assert msg.ns_from_time(odometry[0].header.stamp) == 33_333_333
    speeds = [one.twist.twist.linear.x for one in odometry]
    assert speeds == pytest.approx([0.3] * len(speeds), abs=0.03)
    assert odometry[-1].pose.pose.position.x == pytest.approx(
        odom.pose.pose.position.x + 0.155, abs=0.02
    )
    assert session.ground_truth().x_m == pytest.approx(here.x_m + 0.155, abs=0.02)
    session.run_for(1.0)
    estimate = session.latest(AMCL_POSE)
    assert estimate is not None
    assert estimate.pose.pose.position.x == pytest.approx(session.ground_truth().x_m, abs=0.05)


def test_the_watchdog_counts_on_through_a_reset_of_time(session: Session) -> None:
    session.run_for(0.5)
    session.command(0.3, 0.0)
    session.run_for(0.1)
    session.reset(scope="time")
    session.run_for(0.09)
    assert session.stats.watchdog_stops == 0
    session.run_for(0.02)
    assert session.stats.watchdog_stops == 1


def test_a_goal_is_driven_to_and_a_bad_one_is_answered(session: Session) -> None:
    result = session.goal(0.6, 0.0, 0.5)
    assert result.error_code == 0
    x_m, y_m, yaw_rad = session.ground_truth()
    assert math.hypot(x_m - 0.6, y_m) < 0.25
    assert yaw_rad == pytest.approx(0.5, abs=0.3)
    assert session.stats.paused
    assert session.goal(50.0, 0.0).error_code == 204
    with pytest.raises(TimeoutError, match=r"not ended within 0\.5 s"):
        session.goal(-0.6, 0.0, timeout_s=0.5)
    assert session.stats.paused


def test_of_two_goals_at_one_time_each_gets_its_own_result(session: Session) -> None:
    session.run_for(1.0)
    other = msg.PoseStamped(
        header=msg.header(session.now_ns(), "map"), pose=msg.pose_from_se2(SE2(-0.6, 0.0, 0.0))
    )
    with session.watching(NAVIGATION_RESULT) as results:
        session.publish(GOAL_POSE, other)
        result = session.goal(0.6, 0.0)
    assert (result.goal.x_m, result.error_code) == (0.6, 0)
    assert [one.error_code for one in results] == [PREEMPTED, 0]


def test_a_closed_session_says_so(worlds_dir: Path) -> None:
    with Session("room", camera=False, worlds_dir=worlds_dir) as session:
        session.run_for(0.5)
        here = session.ground_truth()
    session.close()
    assert session.now_s == 0.5
    # What was said last is known still.
    assert session.ground_truth() == here
    assert session.latest(SCAN) is not None
    assert not session.alive()
    calls: list[Callable[[], object]] = [
        session.step,
        session.turn,
        lambda: session.run_for(1.0),
        lambda: session.goal(0.6, 0.0),
        lambda: session.command(0.1, 0.0),
        session.reset,
        session.entities,
        lambda: session.watch((SCAN,)),
    ]
    for call in calls:
        with pytest.raises(RefusedError, match=r"^the session is closed$"):
            call()


def test_a_reset_ends_the_goal(session: Session) -> None:
    with pytest.raises(TimeoutError):
        session.goal(0.9, 0.0, timeout_s=1.0)
    with session.watching(NAVIGATION_RESULT) as results:
        session.reset()
    assert [result.error_code for result in results] == [WORLD_RESTARTED]
    status = session.latest(NAVIGATION_STATUS)
    waits = StopCause(level="stop", cause="waiting for odometry", cleared_by="odometry")
    assert status == NavigationStatus(
        localization_active=False, navigation_active=False, stop_level="stop", stop_causes=(waits,)
    )
    session.run_for(2.0)
    assert math.hypot(*session.ground_truth()[:2]) < 0.001


def test_a_pause_in_mid_drive_jumps_in_no_command(session: Session) -> None:
    with session.watching(CMD_VEL) as commands:
        with pytest.raises(TimeoutError):
            session.goal(0.9, 0.0, timeout_s=1.0)
        moving = session.ground_truth()
        for _ in range(500):
            session.turn()
        assert session.ground_truth() == moving
        session.run_for(2.0)
    assert session.stats.watchdog_stops == 0
    speeds = [command.twist.linear.x for command in commands]
    stamps_s = [msg.ns_from_time(command.header.stamp) * 1e-9 for command in commands]
    assert max(speeds) > 0.1
    for i in range(1, len(speeds)):
        assert stamps_s[i] - stamps_s[i - 1] == pytest.approx(0.05, abs=0.01)
        assert abs(speeds[i] - speeds[i - 1]) <= 1.0 * 0.05 + 1e-9


def test_what_cannot_be_done_is_refused_in_one_line(session: Session) -> None:
    session.run_for(0.25)
    before = session.stats
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: session.run_until(-1.0), "time_s: must be greater than or equal to 0 (got -1.0)"),
        (lambda: session.run_until(math.inf), "time_s: must be a finite number (got inf)"),
        (lambda: session.run_until(1e300), "time_s: must be less than or equal to"),
        (lambda: session.run_until(0.1), "time_s: must not be before now, 0.25 s (got 0.1)"),
        (lambda: session.run_for(-5), "duration_s: must be greater than or equal to 0 (got -5)"),
        (lambda: session.step(0), "steps"),
        (lambda: session.step(10**12), "steps"),
        (lambda: session.reset(seed=-1), "seed"),
        (lambda: session.reset(seed=3, scope="time"), "seed: 3: requires reset: all"),
        (lambda: session.reset(scope="space"), "scope: must be one"),  # type: ignore[arg-type]
        (lambda: session.command(math.nan, 0.0), "linear_m_s: must be a finite number (got nan)"),
        (lambda: session.command(0.2, 0.0, for_s=-1.0), "for_s: must be greater than 0 (got -1.0)"),
        (lambda: session.command(0.2, 0.0, for_s=0.0), "for_s: must be greater than 0 (got 0.0)"),
        (lambda: session.command(0.2, 0.0, for_s=math.nan), "for_s: must be a finite number"),
        (lambda: session.command(0.2, 0.0, for_s=math.inf), "for_s: must be a finite number"),
        (lambda: session.goal(0.6, 0.0, timeout_s=0.0), "timeout_s: must be greater than 0"),
        (lambda: session.goal(0.6, 0.0, timeout_s=-5.0), "(got -5.0)"),
        (lambda: session.goal(0.6, 0.0, timeout_s=math.nan), "timeout_s"),
        (lambda: session.goal(0.6, 0.0, timeout_s=math.inf), "timeout_s"),
        (lambda: session.remove("nothing"), "nothing"),
        (lambda: session.remove(None), "name: must be a string (got None)"),  # type: ignore[arg-type]
        (lambda: session.spawn({}), "entity: "),  # type: ignore[arg-type]
        (lambda: session.latest("/scan"), "topic: must be a Topic"),  # type: ignore[arg-type]
        (lambda: session.ask(LOAD_WORLD, {}), "/world/load: must be a LoadWorld (got {})"),  # type: ignore[misc]
    ]
    for call, words in calls:
        with pytest.raises(RefusedError) as refused:
            call()
        assert words in str(refused.value)
        assert "\n" not in str(refused.value)
        assert session.stats == before


def test_a_world_or_an_option_that_is_none_is_one_line(worlds_dir: Path) -> None:
    with pytest.raises(ConfigError, match="atlantis"):
        Session("atlantis", worlds_dir=worlds_dir, camera=False)
    with pytest.raises(ConfigError, match="scan_nois_m"):
        Session("room", worlds_dir=worlds_dir, camera=False, scan_nois_m=0.0)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"world": None}, "world: must be a string (got None)"),
        ({"seed": None}, "seed: must be an integer (got None)"),
        ({"slam": "False"}, "slam: must be True or False (got 'False')"),
        ({"camera": "False"}, "camera: must be True or False (got 'False')"),
        (
            {"overrides": {"maze.seed": 3}},
            "overrides: must be a valid tuple (got {'maze.seed': 3})",
        ),
    ]
    for argument, line in wrong:
        with pytest.raises(ConfigError) as refused:
            Session(**{"world": "room", "worlds_dir": worlds_dir, **argument})
        assert str(refused.value) == line


def test_fields_of_physics_are_given_by_name(worlds_dir: Path) -> None:
    with Session("room", camera=False, worlds_dir=worlds_dir, scan_noise_m=0.0) as session:
        session.run_for(0.25)
        with session.watching(SCAN) as scans:
            session.run_for(0.2)
        first, second = (scan.ranges.tolist() for scan in scans)
        assert first == pytest.approx(second, abs=1e-5)


def test_fields_of_physics_win_over_what_the_session_says_otherwise(worlds_dir: Path) -> None:
    with Session("room", worlds_dir=worlds_dir, renderer="tiny") as session:
        assert session.stats.renderer == "tiny_renderer"


def test_another_world_is_loaded_and_driven_in(worlds_dir: Path, tmp_path: Path) -> None:
    hall = folder.room()
    hall["name"] = "hall"
    hall["wall_height_m"] = 2.0
    folder.write(worlds_dir, "hall", hall)
    run = tmp_path / "run"
    with Session("room", camera=False, worlds_dir=worlds_dir, out_dir=run) as session:
        first = session.stats.world_hash
        with session.watching(NAVIGATION_RESULT) as results:
            with pytest.raises(TimeoutError):
                session.goal(0.6, 0.0, timeout_s=1.0)
            reply = session.ask(LOAD_WORLD, LoadWorld(world_name="hall"))
            session.run_for(1.0)
        assert (reply.world_name, reply.is_new, reply.error) == ("hall", True, "")
        assert [result.error_code for result in results] == [WORLD_RESTARTED]
        assert session.stats.world_hash == reply.world_hash != first
        assert math.hypot(*session.ground_truth()[:2]) < 0.01
        assert session.goal(0.6, 0.0, 0.5).error_code == 0
    runs = [run, run.with_name("run_2")]
    told = [yaml.safe_load((one / "config.yaml").read_text()) for one in runs]
    assert [one["world_hash"] for one in told] == [first, reply.world_hash]
    assert [one["world_request"]["world_name"] for one in told] == ["room", "hall"]
    summaries = [json.loads((one / "summary.json").read_text()) for one in runs]
    assert [len(summary["goals"]) for summary in summaries] == [0, 1]


def test_what_was_spawned_is_gone_when_its_world_is_loaded_again(worlds_dir: Path) -> None:
    folder.write(worlds_dir, "hall", folder.room() | {"name": "hall", "wall_height_m": 2.0})
    box = Shape(name="box", geometry=Box(size_m=(0.2, 0.2, 0.4)))
    crate = BodyEntity(name="crate", position_m=(0.8, 0.0, 0.2), shapes=(box,))
    with Session("room", camera=False, worlds_dir=worlds_dir) as session:
        at_first = session.entities().entities
        session.spawn(crate)
        for name in ("hall", "room"):
            reply = session.ask(LOAD_WORLD, LoadWorld(world_name=name))
            session.run_for(0.2)
            assert session.stats.world_hash == reply.world_hash
            assert session.entities().entities == at_first
            session.spawn(crate)


def test_a_thing_is_put_moved_and_taken_away(session: Session) -> None:
    session.run_for(0.2)
    box = Shape(name="box", geometry=Box(size_m=(0.2, 0.2, 0.4)))
    crate = BodyEntity(name="crate", position_m=(0.8, 0.0, 0.2), shapes=(box,))
    placed = session.spawn(crate)
    assert (placed.name, placed.position_m) == ("crate", (0.8, 0.0, 0.2))
    assert session.stats.sim_time_s == 0.2
    assert "crate" in [entity.name for entity in session.entities().entities]
    session.run_for(0.2)
    scan = session.latest(SCAN)
    assert scan is not None
    assert float(scan.ranges[0]) == pytest.approx(0.73, abs=0.06)
    moved = session.move("crate", (0.8, 0.5, 0.2))
    assert moved.position_m == (0.8, 0.5, 0.2)
    session.remove("crate")
    assert "crate" not in [entity.name for entity in session.entities().entities]


def test_a_reset_puts_things_back_to_where_they_should_be(session: Session) -> None:
    box = Shape(name="box", geometry=Box(size_m=(0.2, 0.2, 0.2)))
    start_m = (0.8, 0.0, 0.5)
    session.spawn(BodyEntity(name="crate", position_m=start_m, mass_kg=0.5, shapes=(box,)))
    fallen = session.run_until(1.0)
    assert session.entities().entities[-1].position_m[2] < 0.2
    assert session.reset().entities == fallen.entities
    assert session.entities().entities[-1].position_m == start_m
    assert session.run_until(1.0).state_hash == fallen.state_hash


def test_after_a_reset_the_same_moves_are_those_of_a_fresh_start(session: Session) -> None:
    box = Shape(name="box", geometry=Box(size_m=(0.2, 0.2, 0.2)))
    first_m = (0.8, 0.0, 0.1)
    session.spawn(BodyEntity(name="crate", position_m=first_m, mass_kg=0.5, shapes=(box,)))
    (marker,) = session.entities().markers

    def play() -> str:
        session.run_for(0.2)
        assert session.move("crate", (0.8, 0.5, 0.1)).position_m == (0.8, 0.5, 0.1)
        session.remove(marker.name)
        return session.run_for(0.2).state_hash

    hashes = []
    for _ in range(3):
        hashes.append(play())
        session.reset()
        told = session.entities()
        assert {one.name: one.position_m for one in told.entities} == {
            "crate": first_m, marker.name: marker.position_m,
        }  # fmt: skip
    assert len(set(hashes)) == 1


def test_a_goal_that_is_left_can_be_cancelled(session: Session) -> None:
    with pytest.raises(TimeoutError):
        session.goal(0.9, 0.0, timeout_s=1.0)
    with session.watching(NAVIGATION_RESULT) as results:
        assert session.cancel().goal is not None
    assert [result.error_code for result in results] == [9012]
    session.run_for(1.0)
    stopped = session.ground_truth()
    session.run_for(1.0)
    assert session.ground_truth().distance_m(stopped) < 1e-3
    with pytest.raises(RefusedError, match="no active goal"):
        session.cancel()


@pytest.mark.parametrize(("frame", "covariance"), [
    ("map", np.zeros(1)), ("map", np.eye(6)), ("map", [0.25] * 36), ("map", None),
    ("map", np.zeros(36, np.float32)), (5, np.zeros(36)), ("\ud800", np.zeros(36)),
])  # fmt: skip
def test_a_message_that_could_not_travel_is_refused(
    session: Session, frame: Any, covariance: Any
) -> None:
    session.run_for(0.5)
    pose = msg.PoseWithCovariance(msg.pose_from_se2(SE2(0.0, 0.0, 0.0)), covariance)
    with pytest.raises(RefusedError, match=r"^/initialpose: wrong (length|type).*$"):
        session.publish(
            INITIAL_POSE, msg.PoseWithCovarianceStamped(msg.Header(msg.Time(0, 0), frame), pose)
        )
    assert session.run_for(0.1).sim_time_s > 0.59


def test_another_thread_is_refused_while_one_advances(session: Session) -> None:
    advancing, answered = threading.Event(), threading.Event()

    def look(*_: Any) -> None:
        advancing.set()
        answered.wait(60.0)

    def drive_on() -> None:
        with pytest.raises(RefusedError, match=r"^the session is closed$"):
            session.goal(0.9, 0.0)

    end = session.watch((ODOM,), look)
    thread = threading.Thread(target=drive_on, daemon=True)
    thread.start()
    assert advancing.wait(60.0)
    calls: list[Callable[[], object]] = [
        session.step, session.pause, session.resume, session.turn, session.cancel, session.entities,
        lambda: session.run_for(0.1), lambda: session.goal(0.6, 0.0), lambda: session.stats,
        lambda: session.command(0.1, 0.0, for_s=0.1),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(RefusedError, match=r"^another thread advances this session$"):
            call()
    answered.set()
    end()
    # Ends what the other thread waits for.
    session.close()
    thread.join(60.0)
    assert not thread.is_alive()


def test_who_receives_a_message_may_publish_but_not_advance(session: Session) -> None:
    refused: list[str] = []

    def receive(*_: Any) -> None:
        end()
        session.command(0.2, 0.0)
        for call in (session.step, session.close, lambda: session.goal(0.6, 0.0)):
            with pytest.raises(RefusedError) as error:
                call()
            refused.append(str(error.value))

    end = session.watch((SCAN,), receive)
    session.run_for(0.5)
    assert refused == ["a step of this session is under way: call this after it"] * 3
    assert session.ground_truth().x_m > 0.001


def test_a_robot_that_is_carried_away_stands_there_and_is_not_told(session: Session) -> None:
    session.command(0.2, 0.0, for_s=0.5)
    session.run_for(1.0)
    counted = session.latest(ODOM)
    assert counted is not None
    session.move_robot(0.6, 0.3, 2.0)
    session.run_for(0.5)
    assert session.ground_truth() == pytest.approx((0.6, 0.3, 2.0), abs=0.03)
    odometry = session.latest(ODOM)
    assert odometry is not None
    at, before = odometry.pose.pose.position, counted.pose.pose.position
    assert (at.x, at.y) == pytest.approx((before.x, before.y), abs=0.03)
    session.command(0.2, 0.0, for_s=1.0)
    assert session.ground_truth().x_m < 0.58
    assert session.ground_truth().y_m > 0.4


def test_a_robot_is_not_put_down_inside_things(session: Session) -> None:
    wall = session.spawn(
        BodyEntity(
            name="crate",
            position_m=(0.8, 0.0, 0.2),
            shapes=(Shape(name="box", geometry=Box(size_m=(0.3, 0.3, 0.4))),),
        )
    )
    assert wall.name == "crate"
    before = session.stats.state_hash
    with pytest.raises(
        RefusedError, match=r"^robot_pose: \(0\.8, 0, 0\): penetrates crate by .* m$"
    ):
        session.move_robot(0.8, 0.0)
    with pytest.raises(RefusedError, match="must be within 1000 m"):
        session.move_robot(2e3, 0.0)
    with pytest.raises(RefusedError, match="x_m: must be a finite number"):
        session.move_robot(math.inf, 0.0)
    assert session.stats.state_hash == before
    session.step()
    assert session.ground_truth() == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)


def test_a_settings_file_configures_the_services(worlds_dir: Path, tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("physics: {scan_samples: 36}\n")
    with Session("room", camera=False, worlds_dir=worlds_dir, settings=path) as opened:
        opened.run_for(0.2)
        scan = opened.latest(SCAN)
        assert scan is not None
        assert len(scan.ranges) == 36
    path.write_text("physics: {scan_sample: 36}\n")
    with pytest.raises(ConfigError, match=r"settings\.yaml: physics\.scan_sample: .*scan_samples"):
        Session("room", camera=False, worlds_dir=worlds_dir, settings=path)
