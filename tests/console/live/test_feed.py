"""What waits for a page, and what is drawn of messages, wrong ones too."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from mazebot.common.client.robot import Robot
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as tp
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Entities, MarkerEntity, SimulationStats
from mazebot.common.node.node import Envelope
from mazebot.console.live.feed import MAX_EVENTS, RESTARTED, Feed, Outgoing
from mazebot.console.live.frame import Frame, binary_frame, text_frame
from mazebot.console.live.history import (
    MOST_LINES,
    MOST_POINTS,
    MOST_ROWS,
    ROW_S,
    STEP_M,
    History,
    Plots,
    Trail,
)
from mazebot.console.live.view import WATCHED, View
from tests.common.samples import CAMERA_INFO, SAMPLES


def taken(outgoing: Outgoing) -> list[Frame]:
    return asyncio.run(outgoing.taken())


def content(frames: list[Frame], kind: str) -> dict[str, Any]:
    """The newest content of a kind."""
    (*_, found) = [frame.content for frame in frames if frame.kind == kind]
    if isinstance(found, bytes):
        (length,) = struct.unpack_from("<I", found)
        return dict(json.loads(found[4 : 4 + length])) | {"data": found[4 + length :]}
    return dict(json.loads(found)["content"])


def test_a_page_that_takes_nothing_gets_the_newest_of_each_kind_and_the_last_events() -> None:
    outgoing = Outgoing()
    for number in range(1000):
        outgoing.offer(text_frame("pose", {"number": number}))
        outgoing.offer(binary_frame("scan", {"number": number}, bytes(1000)))
        outgoing.offer(text_frame("log", {"number": number}, is_event=True))
    frames = taken(outgoing)
    assert len(frames) == 2 + MAX_EVENTS
    assert content(frames, "pose") == {"number": 999}
    assert content(frames, "scan")["number"] == 999
    (first, *_) = [frame for frame in frames if frame.is_event]
    assert content([first], "log") == {"number": 1000 - MAX_EVENTS}
    assert outgoing.dropped == 999 + 999 + 1000 - MAX_EVENTS


def test_a_restart_comes_before_what_is_known_since_and_ends_what_was_known_before() -> None:
    outgoing = Outgoing()
    outgoing.offer(text_frame("plan", {"run": 1}))
    outgoing.offer(text_frame("pose", {"run": 1}))
    outgoing.offer(text_frame("world", {"run": 1}))
    outgoing.offer(text_frame("log", {"run": 1}, is_event=True))
    outgoing.offer(text_frame(RESTARTED, {}, is_event=True))
    outgoing.offer(text_frame("pose", {"run": 2}))
    outgoing.offer(text_frame("log", {"run": 2}, is_event=True))
    outgoing.offer(text_frame("stats", {"run": 2}))
    kinds = [frame.kind for frame in taken(outgoing)]
    assert kinds == ["world", "log", RESTARTED, "pose", "log", "stats"]


def test_what_cannot_be_read_or_drawn_is_left_out() -> None:
    stats = SimulationStats(
        world_hash="0" * 16, sim_time_s=1.0, iterations=240, step_size_s=1 / 240, renderer="none",
        state_hash="",
    )  # fmt: skip
    wrong: list[tuple[tp.Topic[Any], object]] = [
        (topic, data) for topic in WATCHED for data in (b"", b"\x00\x01\x00\x00", bytes(64))
    ]
    grid = msg.occupancy_grid(0, 0.05, SE2(0, 0, 0), np.zeros((2, 3), np.int8))
    grid.info.width = 100
    wrong.append((tp.MAP, wire.encode(tp.MAP, grid)))
    frames = View().frames([*wrong, (tp.SIMULATION_STATS, wire.encode(tp.SIMULATION_STATS, stats))])
    assert content(frames, "stats")["iterations"] == 240
    assert "map" not in {frame.kind for frame in frames}


def odom(stamp_ns: int, map_from_base: SE2) -> msg.Odometry:
    still = msg.Twist(linear=msg.Vector3(0.0, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.0))
    return msg.Odometry(
        header=msg.header(stamp_ns, "map"), child_frame_id="base_footprint",
        pose=msg.PoseWithCovariance(pose=msg.pose_from_se2(map_from_base), covariance=np.zeros(36)),
        twist=msg.TwistWithCovariance(twist=still, covariance=np.zeros(36)),
    )  # fmt: skip


def scan(stamp_ns: int) -> msg.LaserScan:
    ranges = np.array([1.0, 2.0, np.inf, 0.05], np.float32)
    return msg.LaserScan(
        header=msg.header(stamp_ns, "base_scan"), angle_min=0.0, angle_max=4.71,
        angle_increment=msg.float32(np.pi / 2), time_increment=0.0, scan_time=0.1,
        range_min=msg.float32(0.12), range_max=3.5, ranges=ranges,
        intensities=np.zeros(4, np.float32),
    )  # fmt: skip


def frame(parent: str, child: str, pose: SE2) -> msg.TFMessage:
    return msg.TFMessage(transforms=[msg.planar_transform_stamped(0, parent, child, pose)])


def test_the_scan_lies_where_the_robot_believes_to_be_and_else_where_it_is() -> None:
    view = View()
    truth = SE2(2.0, 1.0, 0.0)
    frames = view.frames(
        [
            (tp.TF_STATIC, frame("base_footprint", "base_scan", SE2(-0.1, 0.0, 0.0))),
            (tp.GROUND_TRUTH_ODOM, odom(0, truth)),
            (tp.SCAN, scan(0)),
        ]
    )
    drawn = content(frames, "scan")
    assert drawn["pose"] == pytest.approx([1.9, 1.0, 0.0])
    assert np.frombuffer(drawn["data"], "<u2").tolist() == [1000, 2000, 65535, 65535]
    frames = view.frames(
        [
            (tp.TF, frame("map", "odom", SE2(1.0, 0.0, np.pi / 2))),
            (tp.TF, frame("odom", "base_footprint", SE2(0.5, 0.0, 0.0))),
            (tp.SCAN, scan(100_000_000)),
        ]
    )
    assert content(frames, "scan")["pose"] == pytest.approx([1.0, 0.4, np.pi / 2], abs=1e-3)
    pose = content(frames, "pose")
    assert pose["truth"] == pytest.approx(truth)


def test_a_costmap_in_odom_lies_in_the_map() -> None:
    view = View()
    grid = msg.occupancy_grid(
        0, 0.05, SE2(0.2, 0.0, 0.0), np.array([[0, 99], [100, -1]], np.int8), "odom"
    )
    assert view.frames([(tp.LOCAL_COSTMAP, grid)]) == []
    placed = (tp.TF, frame("map", "odom", SE2(1.0, 1.0, np.pi / 2)))
    drawn = content(view.frames([placed, (tp.LOCAL_COSTMAP, grid)]), "local_costmap")
    assert drawn["origin"] == pytest.approx([1.0, 1.2, np.pi / 2], abs=1e-3)
    assert np.frombuffer(drawn["data"], np.int8).tolist() == [0, 99, 100, -1]
    assert (drawn["rows"], drawn["columns"]) == (2, 2)


def test_a_marker_faces_where_its_panel_does() -> None:
    # Its face, +z, along the map's +x.
    marker = MarkerEntity(
        name="aruco_5", position_m=(1.0, 2.0, 0.4), orientation_xyzw=(0.5, 0.5, 0.5, 0.5),
        panel_side_m=0.4, texture_sha256="", marker_id=5, marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )  # fmt: skip
    entities = Entities(world_hash="0" * 16, entities=(marker,))
    (drawn,) = content(View().frames([(tp.ENTITIES, entities)]), "entities")["markers"]
    assert (drawn["id"], drawn["x_m"], drawn["y_m"]) == (5, 1.0, 2.0)
    assert drawn["heading_rad"] == pytest.approx(0.0)


def test_docks_are_the_markers_that_the_robot_knows() -> None:
    entities, world = SAMPLES[tp.ENTITIES], SAMPLES[tp.WORLD]
    assert entities.world_hash == world.hash
    names = [marker.name for marker in entities.markers]
    view = View()
    assert content(view.frames([(tp.ENTITIES, entities)]), "entities")["docks"] == []
    for update, docks in (({}, names), ({"mapped_markers": ()}, []), ({"slam": True}, [])):
        drawn = content(view.frames([(tp.WORLD, world.model_copy(update=update))]), "entities")
        assert drawn["docks"] == docks
        assert len(drawn["markers"]) == len(names)


def stats(epoch: int, time_s: float) -> SimulationStats:
    return SimulationStats(
        world_hash="0" * 16, sim_time_s=time_s, iterations=240, step_size_s=1 / 240,
        renderer="none", state_hash="", epoch=epoch,
    )  # fmt: skip


def test_a_trail_is_whole_however_long_it_is() -> None:
    trail = Trail()
    for number in range(20 * MOST_POINTS):
        trail.add(number * STEP_M, 0.0)
        trail.add(number * STEP_M + 1e-3, 0.0)
        assert len(trail.points) < MOST_POINTS
    assert trail.points[0] == (0.0, 0.0)
    assert trail.points[-1][0] > (20 * MOST_POINTS - 100) * STEP_M


def test_plots_are_whole_however_long_they_are() -> None:
    plots = Plots()
    for number in range(20 * MOST_ROWS):
        plots.add(number * ROW_S, 0.1, None)
        assert len(plots.rows) < MOST_ROWS
    assert plots.rows[0] == (0.0, 0.1, None)
    assert plots.rows[-1][0] > (20 * MOST_ROWS - 100) * ROW_S  # type: ignore[operator]


@pytest.mark.parametrize(("epoch", "time_s"), [(1, 0.0), (0, 5.0)])
def test_what_is_kept_is_bounded_and_belongs_to_one_run(epoch: int, time_s: float) -> None:
    history = History()
    view = View(history)
    view.frames(
        [(tp.SIMULATION_STATS, stats(0, 10.0)), (tp.GROUND_TRUTH_ODOM, odom(1, SE2(1, 2, 0)))]
    )
    for number in range(1000):
        history.add_event(text_frame("log", {"number": number}, is_event=True))
        history.add_event(text_frame("contact", {"number": number}, is_event=True))
    kept = history.frames()
    assert content(kept, "trails")["truth"] == [[1, 2]]
    assert content(kept, "plots")["rows"] == [[0.0, 0.0, 0.0, None, None]]
    assert len(kept) == 2 + 2 * MOST_LINES
    assert content(kept, "contact") == {"number": 999}
    view.frames([(tp.SIMULATION_STATS, stats(0, 11.0))])
    assert not view.restarted
    view.frames([(tp.SIMULATION_STATS, stats(epoch, time_s))])
    assert view.restarted
    assert [frame.kind for frame in history.frames()] == ["trails", "plots"]
    assert content(history.frames(), "plots") == {"rows": []}
    assert content(history.frames(), "trails") == {"truth": [], "estimate": []}


def test_the_outline_of_a_marker_lies_where_the_camera_sees_it() -> None:
    half_m, ahead_m = 0.1, 2.0
    pose = msg.pose_from_matrix(
        np.array(
            [[1.0, 0, 0, 0.5], [0, -1.0, 0, 0], [0, 0, -1.0, ahead_m], [0, 0, 0, 1.0]], np.float64
        )
    )
    covariance = msg.PoseWithCovariance(pose=pose, covariance=np.zeros(36))
    hypothesis = msg.ObjectHypothesis(class_id="60", score=1.0)
    detection = msg.Detection3D(
        header=msg.header(10**9, "camera_rgb_optical_frame"),
        results=[msg.ObjectHypothesisWithPose(hypothesis=hypothesis, pose=covariance)],
        bbox=msg.BoundingBox3D(center=pose, size=msg.Vector3(2 * half_m, 2 * half_m, 0.0)),
        id="4x4:60",
    )
    array = msg.Detection3DArray(detection.header, [detection])
    view = View()
    (without,) = view.frames([(tp.DETECTIONS, array)])
    assert content([without], "detections") == {"time_s": 1.0, "ids": ["60"], "outlines": []}
    info = replace(
        CAMERA_INFO, width=400, height=200, k=np.array([100.0, 0, 200, 0, 100, 100, 0, 0, 1])
    )
    (seen,) = view.frames([(tp.CAMERA_INFO, info), (tp.DETECTIONS, array)])
    (outline,) = content([seen], "detections")["outlines"]
    left, right = (0.5 + (0.5 + side * half_m) / ahead_m * 100 / 400 for side in (-1, 1))
    upper, lower = (0.5 + side * half_m / ahead_m * 100 / 200 for side in (-1, 1))
    wanted = [[left, upper], [right, upper], [right, lower], [left, lower]]
    assert np.array(outline["corners"]) == pytest.approx(np.array(wanted), abs=1e-4)
    # What would be behind the camera has no outline.
    pose.position.z = -ahead_m
    (behind,) = view.frames([(tp.DETECTIONS, array)])
    assert content([behind], "detections")["outlines"] == []


class SomeRobot:
    """A robot that says what a test says."""

    def __init__(self) -> None:
        self.watchers: list[Callable[[tp.Topic[Any], Any, Envelope], None]] = []
        self.services = {"physics": "physics"}

    def watch(self, topics: Any, on_message: Any = None) -> Any:
        self.watchers.append(on_message)
        return lambda: self.watchers.remove(on_message)

    def alive(self) -> dict[str, str]:
        return self.services

    def say(self, topic: tp.Topic[Any], message: Any) -> None:
        self.watchers[0](topic, message, Envelope("physics", 0, 0, ""))


async def seen(page: Outgoing, kind: str) -> list[Frame]:
    """What a page gets until a kind is among it."""
    frames: list[Frame] = []
    async with asyncio.timeout(30.0):
        while kind not in {frame.kind for frame in frames}:
            frames += await page.taken()
    return frames


@pytest.mark.parametrize("epoch", [0, 1])
def test_services_that_are_out_of_sight_for_a_moment_do_not_begin_a_run(epoch: int) -> None:
    robot = SomeRobot()
    feed = Feed(cast("Robot", robot), "")

    async def told() -> tuple[list[Frame], list[Frame]]:
        async with feed.page() as page:
            await seen(page, "stack")
            robot.say(tp.SIMULATION_STATS, stats(0, 10.0))
            robot.say(tp.GROUND_TRUTH_ODOM, odom(1, SE2(1, 2, 0)))
            robot.say(tp.ENTITIES, SAMPLES[tp.ENTITIES])
            await seen(page, "entities")
            robot.services = {}
            frames = await seen(page, "stack")
            robot.services = {"physics": "physics"}
            frames += await seen(page, "stack")
            robot.say(tp.SIMULATION_STATS, stats(epoch, 12.0))
            frames += await seen(page, "stats")
            # Another stack tells the same again.
            robot.say(tp.ENTITIES, SAMPLES[tp.ENTITIES])
            await seen(page, "entities")
        async with feed.page() as late:
            return frames, await seen(late, "trails")

    frames, kept = asyncio.run(told())
    assert (RESTARTED in {frame.kind for frame in frames}) == (epoch == 1)
    assert content(kept, "trails")["truth"] == ([[1, 2]] if epoch == 0 else [])


@pytest.mark.parametrize(("later_s", "kinds"), [(10.5, {"camera"}), (12.0, set())])
def test_a_page_that_comes_while_the_simulation_is_paused_gets_the_last_picture_of_the_camera(
    later_s: float, kinds: set[str]
) -> None:
    robot = SomeRobot()
    feed = Feed(cast("Robot", robot), "")

    async def last_kinds() -> set[str]:
        async with feed.page() as first:
            first.wants_camera = True
            await seen(first, "stack")
            robot.say(tp.SIMULATION_STATS, stats(0, 10.0))
            robot.say(tp.CAMERA_IMAGE, SAMPLES[tp.CAMERA_IMAGE])
            await seen(first, "camera")
            robot.say(tp.SIMULATION_STATS, stats(0, later_s))
            await seen(first, "stats")
        async with feed.page() as late:
            await seen(late, "stack")
            late.wants_camera = True
            # What is said after a picture that the page gets comes after it.
            robot.say(tp.GROUND_TRUTH_ODOM, odom(1, SE2(1, 2, 0)))
            frames = await seen(late, "pose")
        return {frame.kind for frame in frames} & {"camera"}

    assert asyncio.run(last_kinds()) == kinds
