"""Where a bag has its lidars, its robot and its time, for all that reads a log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from mazebot.cli.logs.log import Log, ScanForm, Topics
from mazebot.cli.logs.read import read_log
from mazebot.cli.map.build_run import run
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import (
    SE2,
    Array,
    inverse_matrix,
    rotation_from_rpy,
    transform_matrix,
    wrap_angles,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Mount, Scan
from mazebot.mapping.params import SlamParams
from mazebot.mapping.slam import NOT_LATER

UPSIDE_DOWN = math.pi
STEP_NS = 500_000_000
BEGUN_NS = 1_700_000_000_000_000_000
RANGES_M = np.linspace(1.0, 2.0, 21)


@dataclass(frozen=True)
class Link:
    """A transform that does not move."""

    parent: str
    child: str
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def matrix(self) -> Array:
        return transform_matrix(rotation_from_rpy(*self.rpy_rad), self.at_m)


MOUNTED = (Link("base_footprint", "base_scan", (-0.03, 0.01, 0.2)),)


def write(
    folder: Path,
    links: Iterable[Link] = MOUNTED,
    *,
    frames: tuple[str, ...] = ("base_scan",),
    space: str = "",
    stamps_ns: Iterable[int] = range(0, 20 * STEP_NS, STEP_NS),
    moving: tuple[str, str] | None = None,
    child: str = "base_footprint",
    base_from_child: Array | None = None,
    increment_rad: float = 0.1,
    limits_m: Sequence[tuple[float, float]] = ((0.1, 9.0),),
    ranges_m: Array = RANGES_M,
    pan: Sequence[Link] = (),
) -> Path:
    """A bag: a pose, 0.1 m further each and turned by 0.2, of what is fixed to the base that drives
    so, as odometry or as a moving transform, and a scan of each lidar at each stamp; each is logged
    1 ms after it, or BEGUN_NS and half a second a step if its stamp is 0. The limits of the scans
    come in turn. Of `pan`, /tf has one at each stamp.
    """
    store = msg.TYPESTORE
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def put(topic: str, kind: str, log_ns: int, message: object) -> None:
            name = f"{space}{topic}"
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=store)
            writer.write(connections[name], log_ns, bytes(store.serialize_cdr(message, kind)))

        connections: dict[str, Connection] = {}
        fixed = [msg.transform_stamped(0, link.parent, link.child, link.matrix()) for link in links]
        if fixed:
            put("/tf_static", "tf2_msgs/msg/TFMessage", 0, msg.TFMessage(fixed))
        for step, stamp_ns in enumerate(stamps_ns):
            log_ns = BEGUN_NS + step * STEP_NS
            pose = driven(step).matrix()
            if base_from_child is not None:
                pose = pose @ base_from_child
            if moving is None:
                still = msg.Twist(msg.Vector3(0.0, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0))
                odometry = msg.Odometry(
                    msg.header(stamp_ns, "odom"), child,
                    msg.PoseWithCovariance(msg.pose_from_matrix(pose), np.zeros(36)),
                    msg.TwistWithCovariance(still, np.zeros(36)),
                )  # fmt: skip
                put("/odom", "nav_msgs/msg/Odometry", log_ns, odometry)
            else:
                moved = msg.transform_stamped(stamp_ns, *moving, pose)
                put("/tf", "tf2_msgs/msg/TFMessage", log_ns, msg.TFMessage([moved]))
            for link in pan[step : step + 1]:
                there = msg.transform_stamped(stamp_ns, link.parent, link.child, link.matrix())
                put("/tf", "tf2_msgs/msg/TFMessage", log_ns, msg.TFMessage([there]))
            for frame in frames:
                sweep = msg.LaserScan(
                    msg.header(stamp_ns, frame), -1.0, 1.0, increment_rad, 0.0, 0.1,
                    *limits_m[step % len(limits_m)],
                    ranges_m.astype(np.float32), np.zeros(0, np.float32),
                )  # fmt: skip
                put("/scan", "sensor_msgs/msg/LaserScan", log_ns + 1_000_000, sweep)
    return folder


def driven(step: int) -> Link:
    return Link("odom", "base", (0.1 * step, 0.0, 0.0), (0.0, 0.0, 0.2 * step))


def read(bag: Path, topics: Topics | None = None) -> Log:
    return read_log(bag, ScanForm(), topics)


def scans_of(log: Log) -> list[Scan]:
    return [one.scan.at(None, one.stamp_ns) for one in log.entries if one.scan]


def hits_m(scan: Scan) -> Array:
    """(n, 2) in base_footprint."""
    place = np.array(scan.base_from_scan[:2])
    return place + scan.ranges_m[:, None].astype(np.float64) * scan.directions()


def by_hand_m(links: Iterable[Link]) -> Array:
    """(n, 2) the same, of the scan that is written, by the chain of all rotations."""
    matrix = np.eye(4)
    for link in links:
        matrix = matrix @ link.matrix()
    angles = -1.0 + 0.1 * np.arange(21)
    ranges = np.linspace(1.0, 2.0, 21)
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
    return np.asarray(points @ matrix[:2, :2].T + matrix[:2, 3])


@pytest.mark.parametrize(
    "links",
    [
        MOUNTED,
        (Link("base_footprint", "base_scan", (0.1, 0.0, 0.2), (UPSIDE_DOWN, 0.0, 0.7)),),
        (
            Link("base_footprint", "pole", (0.1, 0.0, 0.5), (UPSIDE_DOWN, 0.0, 0.0)),
            Link("pole", "base_scan", (0.0, 0.1, 0.1), (UPSIDE_DOWN, 0.0, 0.7)),
        ),
        (
            Link("base_footprint", "base_link", (0.0, 0.0, 0.1)),
            Link("base_link", "mast", (0.2, 0.0, 0.3), (0.0, math.pi / 2, 0.0)),
            Link("mast", "plate", (0.1, 0.05, 0.0), (0.0, -math.pi / 2, 0.0)),
            Link("plate", "base_scan", (0.0, 0.0, 0.1), (0.0, 0.0, -0.4)),
        ),
    ],
)
def test_a_lidar_is_where_all_transforms_together_have_it(
    tmp_path: Path, links: tuple[Link, ...]
) -> None:
    log = read(write(tmp_path / "bag", links))
    np.testing.assert_allclose(hits_m(scans_of(log)[0]), by_hand_m(links), atol=1e-6)
    assert not log.warning_of_place()


CAMERA = Link("base_link", "camera_pose_frame", (0.25, 0.1, 0.2), (UPSIDE_DOWN, 0.0, 0.5))
AHEAD = Link("base_footprint", "base_link", (0.3, 0.0, 0.1), (0.0, 0.0, math.pi / 2))
ON_LINK = Link("base_link", "base_scan", (-0.05, 0.02, 0.2))


def turned_round(link: Link) -> Link:
    """The same transform from the child, in a tree that the child is the root of."""
    matrix = inverse_matrix(link.matrix())
    roll = math.atan2(matrix[2, 1], matrix[2, 2])
    yaw = math.atan2(matrix[1, 0], matrix[0, 0])
    x_m, y_m, z_m = matrix[:3, 3].tolist()
    return Link(link.child, link.parent, (x_m, y_m, z_m), (roll, 0.0, yaw))


@pytest.mark.parametrize("by_transform", [False, True])
@pytest.mark.parametrize(
    ("links", "base_from_child", "child"),
    [
        ((AHEAD, ON_LINK), AHEAD.matrix(), "base_link"),
        ((AHEAD, ON_LINK, CAMERA), AHEAD.matrix() @ CAMERA.matrix(), "camera_pose_frame"),
        ((AHEAD, ON_LINK), AHEAD.matrix() @ ON_LINK.matrix(), "base_scan"),
        ((ON_LINK, turned_round(CAMERA)), CAMERA.matrix(), "camera_pose_frame"),
        ((ON_LINK, turned_round(AHEAD)), np.linalg.inv(AHEAD.matrix()), "base_footprint"),
    ],
)
def test_odometry_of_another_frame_is_that_of_the_base(
    tmp_path: Path,
    links: tuple[Link, ...],
    base_from_child: Array,
    child: str,
    by_transform: bool,
) -> None:
    moving = ("odom", child) if by_transform else None
    bag = write(
        tmp_path / "bag", links, moving=moving, child=child, base_from_child=base_from_child
    )
    log = read(bag)
    assert not log.warning_of_place()
    poses = np.array([one.odom_from_base for one in log.entries if one.odom_from_base])
    by_hand = np.array([(0.1 * i, 0.0, 0.2 * i) for i in range(20)])
    np.testing.assert_allclose(poses[:, :2], by_hand[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angles(poses[:, 2] - by_hand[:, 2]), 0.0, atol=1e-9)
    chain = links[:2] if links[0] is AHEAD else links[:1]
    np.testing.assert_allclose(hits_m(scans_of(log)[0]), by_hand_m(chain), atol=1e-6)


@pytest.mark.parametrize("moving", [None, ("odom", "chassis")])
def test_what_odometry_is_of_is_the_robot_where_there_is_no_base(
    tmp_path: Path, moving: tuple[str, str] | None
) -> None:
    link = Link("chassis", "laser", (0.2, 0.0, 0.2), (0.0, 0.0, math.pi))
    bag = write(tmp_path / "bag", [link], frames=("laser",), moving=moving, child="chassis")
    log = read(bag)
    assert not log.warning_of_place()
    np.testing.assert_allclose(hits_m(scans_of(log)[0]), by_hand_m([link]), atol=1e-6)


def test_odometry_of_a_frame_that_is_nowhere_on_the_robot_is_told(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", child="camera_pose_frame"))
    assert "'camera_pose_frame', the child frame of odometry" in log.warning_of_place()
    assert "--lidar" in log.warning_of_place()


@pytest.mark.parametrize("child", ["", "base_link", "robot1/base_footprint"])
def test_odometry_of_no_frame_or_of_a_base_without_transforms_is_the_robots(
    tmp_path: Path, child: str
) -> None:
    log = read(write(tmp_path / "bag", child=child))
    assert not log.warning_of_place()
    assert drives_on(log)


def test_a_lidar_that_is_tilted_is_refused(tmp_path: Path) -> None:
    tilted = Link("base_footprint", "base_scan", (0.0, 0.0, 0.2), (0.0, math.radians(40.0), 0.0))
    with pytest.raises(ConfigError, match=r"'base_scan' is tilted by 40 degrees") as error:
        read(write(tmp_path / "bag", [tilted]))
    assert str(error.value).startswith(f"--log: {tmp_path / 'bag'}: ")


def test_a_scan_of_the_bus_is_seen_from_above_too() -> None:
    link = Link("base_footprint", "base_scan", (0.1, 0.0, 0.2), (UPSIDE_DOWN, 0.0, 0.7))
    sweep = msg.LaserScan(
        msg.header(0, "base_scan"), -1.0, 1.0, 0.1, 0.0, 0.1, 0.1, 9.0,
        np.linspace(1.0, 2.0, 21, dtype=np.float32), np.zeros(0, np.float32),
    )  # fmt: skip
    scan = Scan.from_message(sweep, Mount.of(link.matrix()))
    np.testing.assert_allclose(hits_m(scan), by_hand_m([link]), atol=1e-6)


@pytest.mark.parametrize(
    ("moving", "base"),
    [
        (None, "base_footprint"),
        (("robot1/odom", "robot1/base_footprint"), "robot1/base_footprint"),
        (("odom_combined", "base_link"), "base_link"),
    ],
)
def test_names_may_have_a_robots_prefix_and_topics_its_namespace(
    tmp_path: Path, moving: tuple[str, str] | None, base: str
) -> None:
    prefix = base.rpartition("base_")[0]
    link = Link(base, f"{prefix}laser", (0.2, 0.0, 0.2), (0.0, 0.0, math.pi / 2))
    bag = write(
        tmp_path / "bag", [link], frames=(f"{prefix}laser",), space="/robot1", moving=moving
    )
    log = read(bag, Topics(scan="/robot1/scan", odom="/robot1/odom"))
    (place,) = {one.scan.base_from_scan for one in log.entries if one.scan}
    assert place == pytest.approx(SE2(0.2, 0.0, math.pi / 2))
    ways = [one.odom_from_base.x_m for one in log.entries if one.odom_from_base]
    assert ways == pytest.approx([0.1 * step for step in range(20)])


def test_each_of_two_lidars_has_a_place_of_its_own(tmp_path: Path) -> None:
    links = (
        Link("base_footprint", "front", (0.2, 0.0, 0.2)),
        Link("base_footprint", "rear", (-0.2, 0.0, 0.2), (0.0, 0.0, math.pi)),
    )
    log = read(write(tmp_path / "bag", links, frames=("rear", "front")))
    assert {one.base_from_scan.x_m for one in scans_of(log)} == {0.2, -0.2}


def test_scans_of_two_lidars_with_one_stamp_are_both_used(tmp_path: Path) -> None:
    links = (Link("base_footprint", "front"), Link("base_footprint", "rear"))
    log = read(write(tmp_path / "bag", links, frames=("rear", "front")))
    built = run(log, SlamParams())
    assert (len(built.times_s), dict(built.slam.left_out)) == (40, {})
    twice = read(write(tmp_path / "twice", links, frames=("rear", "rear")))
    assert run(twice, SlamParams()).slam.left_out == {NOT_LATER: 20}


def test_a_lidar_in_the_robots_own_frame_is_at_its_centre(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", (), frames=("base_link",)))
    assert scans_of(log)[0].base_from_scan == SE2(0.0, 0.0, 0.0)


LATER_NS = range(STEP_NS, 21 * STEP_NS, STEP_NS)


def panned(yaws_rad: Iterable[float], roll_rad: float = 0.0) -> list[Link]:
    return [
        Link("base_footprint", "base_scan", (0.1, 0.0, 0.2), (roll_rad, 0.0, yaw_rad))
        for yaw_rad in yaws_rad
    ]


@pytest.mark.parametrize("yaws_rad", [np.linspace(0.5, -0.5, 20), [0.0] * 3 + [0.25] * 17])
@pytest.mark.parametrize("roll_rad", [0.0, UPSIDE_DOWN])
def test_a_lidar_that_moves_is_where_it_was_at_each_scan(
    tmp_path: Path, yaws_rad: Sequence[float], roll_rad: float
) -> None:
    links = panned(yaws_rad, roll_rad)
    log = read(write(tmp_path / "bag", (), pan=links, stamps_ns=LATER_NS))
    for scan, link in zip(scans_of(log), links, strict=True):
        np.testing.assert_allclose(hits_m(scan), by_hand_m([link]), atol=1e-6)
    (remark,) = log.remarks()
    assert remark.startswith(
        f"the lidar 'base_scan' moves on the robot, from (0.10 m, 0.00 m, {yaws_rad[0]:.2f} rad) "
        f"to (0.10 m, 0.00 m, {yaws_rad[-1]:.2f} rad)"
    )


def test_between_two_of_its_transforms_a_lidar_moves_evenly(tmp_path: Path) -> None:
    pan = write(tmp_path / "pan", (), frames=(), pan=panned([0.0, 0.4]),
                stamps_ns=[STEP_NS, 5 * STEP_NS])  # fmt: skip
    scans = write(tmp_path / "scans", (), stamps_ns=range(STEP_NS, 8 * STEP_NS, STEP_NS))
    log = read(put_together(tmp_path / "both", (pan, scans)))
    yaws_rad = [one.base_from_scan.yaw_rad for one in scans_of(log)]
    assert yaws_rad == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.4], abs=2e-3)


def test_a_lidar_that_trembles_is_fixed(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", (), pan=panned(0.0005 * np.arange(20)), stamps_ns=LATER_NS))
    assert {one.base_from_scan.yaw_rad for one in scans_of(log)} == {0.0}
    assert not log.remarks()


def test_scans_of_when_a_lidar_that_nods_was_tilted_are_left_out(tmp_path: Path) -> None:
    nodding = [*panned([0.0] * 15), *panned([0.0] * 5, 0.6)]
    log = read(write(tmp_path / "bag", (), pan=nodding, stamps_ns=LATER_NS))
    assert (log.scans, log.scans_tilted) == (15, 5)
    with pytest.raises(ConfigError, match="'base_scan' is tilted by 34 degrees"):
        read(write(tmp_path / "tilted", (), pan=[*panned([0.0], 0.6), *panned([0.1] * 19, 0.6)]))


def test_a_place_that_is_not_known_is_told_with_the_one_that_is_taken(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", (), frames=("laser_frame",)))
    told = log.warning_of_place()
    assert "'laser_frame'" in told
    assert "-0.064 0 0" in told
    assert "--lidar" in told
    assert scans_of(log)[0].base_from_scan == SE2(-0.064, 0.0, 0.0)


def test_stamps_of_zero_are_the_times_of_logging(tmp_path: Path) -> None:
    log = read(write(tmp_path / "bag", stamps_ns=[0] * 20))
    assert log.unstamped == 20
    assert any("stamp 0" in remark for remark in log.remarks())
    times_ns = [one.stamp_ns for one in log.entries if one.scan]
    assert np.diff(times_ns) == pytest.approx(STEP_NS)
    assert drives_on(log)


def test_what_follows_a_clock_that_was_set_back_goes_on_from_there(tmp_path: Path) -> None:
    first = list(range(STEP_NS, 15 * STEP_NS, STEP_NS))
    bag = write(tmp_path / "bag", stamps_ns=[*first, *first])
    log = read(bag)
    assert log.clock_set_back == 1
    assert any("set back once" in remark for remark in log.remarks())
    times_ns = [one.stamp_ns for one in log.entries if one.scan]
    assert np.diff(times_ns) == pytest.approx(STEP_NS)
    assert drives_on(log)


def test_a_message_that_comes_late_sets_no_clock_back(tmp_path: Path) -> None:
    stamps_ns = [*range(STEP_NS, 15 * STEP_NS, STEP_NS)]
    stamps_ns.insert(10, 2 * STEP_NS + 1000)
    log = read(write(tmp_path / "bag", stamps_ns=stamps_ns))
    assert log.clock_set_back == 0
    assert max(one.stamp_ns for one in log.entries) == 14 * STEP_NS


def test_a_scan_without_direction_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the increment not 0"):
        read(write(tmp_path / "bag", increment_rad=0.0))


def drives_on(log: Log) -> bool:
    """Whether odometry and scans follow each other as they were logged."""
    ways = [one.odom_from_base.x_m for one in log.entries if one.odom_from_base]
    return ways == sorted(ways) and [one.scan is None for one in log.entries] == [
        one % 2 == 0 for one in range(len(log.entries))
    ]


def put_together(folder: Path, parts: Iterable[Path]) -> Path:
    """The messages of several bags in one."""
    with AnyReader([*parts]) as reader:
        messages = [(one, log_ns, bytes(data)) for one, log_ns, data in reader.messages()]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Connection] = {}
        for one, log_ns, data in messages:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(
                    one.topic, one.msgtype, typestore=msg.TYPESTORE
                )
            writer.write(connections[one.topic], log_ns, data)
    return folder


def test_transforms_of_the_scans_own_namespace_come_before_those_without(tmp_path: Path) -> None:
    moving = ("odom", "base_footprint")
    bare = write(tmp_path / "bare", [Link("base_footprint", "base_scan", (0.3, 0.0, 0.2))],
                 frames=(), moving=moving, stamps_ns=[5 * STEP_NS] * 30)  # fmt: skip
    own = write(tmp_path / "own", space="/robot1", moving=moving)
    log = read(put_together(tmp_path / "both", (bare, own)), Topics(scan="/robot1/scan"))
    assert drives_on(log)
    assert scans_of(log)[0].base_from_scan == pytest.approx(SE2(-0.03, 0.01, 0.0))
    # What is missing there is taken from those without.
    own = write(tmp_path / "scans", (), space="/robot1", moving=moving)
    log = read(put_together(tmp_path / "mounted", (bare, own)), Topics(scan="/robot1/scan"))
    assert drives_on(log)
    assert scans_of(log)[0].base_from_scan == pytest.approx(SE2(0.3, 0.0, 0.0))


def test_what_carries_the_lidar_is_its_robot(tmp_path: Path) -> None:
    """In the order of the bag the other robot is first, and tells its pose more often."""
    other = write(tmp_path / "other", frames=(), moving=("robot2_odom", "robot2_base"),
                  stamps_ns=[5 * STEP_NS] * 30)  # fmt: skip
    link = Link("robot1_base", "robot1_scan", (-0.1, 0.0, 0.2))
    own = write(
        tmp_path / "own", [link], frames=("robot1_scan",), moving=("robot1_odom", "robot1_base")
    )
    log = read(put_together(tmp_path / "both", (other, own)))
    assert drives_on(log)
    assert len(log.entries) == 40


def test_poses_that_become_infinite_at_the_base_are_left_out(tmp_path: Path) -> None:
    far = Link("base_footprint", "camera_pose_frame", (1.5e308, 1.5e308, 0.2))
    log = read(write(tmp_path / "bag", (*MOUNTED, far), child="camera_pose_frame"))
    assert log.odometry_left_out > 0
    poses = [one.odom_from_base for one in log.entries if one.odom_from_base is not None]
    assert len(poses) == 20 - log.odometry_left_out
    assert np.isfinite(poses).all()
