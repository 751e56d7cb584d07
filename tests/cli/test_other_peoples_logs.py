"""Logs of others that hold more than is used, or what is of no use."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.cli.logs.doubts import doubts_of_odometry
from mazebot.cli.logs.log import Entry, Log, LoggedScan, Topics
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from tests.cli.test_bag_shapes import (
    BEGUN_NS,
    HUMBLE,
    MOVED,
    STEPS,
    TRANSFORMS,
    Logged,
    drive,
    logged,
    odom,
    refused,
    scan,
    write_mcap,
)
from tests.cli.test_logs import RANGES, START, flaser, read, robotlaser, scans, written

STEP_NS = 100_000_000
Way = Callable[[int], SE2]


@pytest.mark.parametrize("few", ["ROBOTLASER1", "RAWLASER1"])
def test_the_kind_of_most_scans_is_used_and_the_rest_is_told(tmp_path: Path, few: str) -> None:
    line = robotlaser(7.5, START, START, RANGES, 80.0)
    if few == "RAWLASER1":
        line = "RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 7.5 h 0.5"
    behind = "RLASER 2 1 1 0 0 0 0 0 0 5.5 nohost 0.6"
    lines = [flaser(time_s) for time_s in (5.0, 6.0, 7.0)]
    log = read(written(tmp_path, *lines, line, behind))
    assert [entry.stamp_ns for entry in scans(log)] == [5 * 10**9, 6 * 10**9, 7 * 10**9]
    assert log.remarks() == [f"lines not used: 1 {few}, 1 RLASER: the scans are those of FLASER"]


def curve(step: int) -> SE2:
    return SE2(math.sin(0.05 * step), 1.0 - math.cos(0.05 * step), 0.05 * step)


def moved(way: Way, stamped_ns: int = 0, length: float = 1.0) -> Callable[[int], Logged]:
    """Odometry that tells this, stamped so much later, with quaternions of this length."""

    def at(step: int) -> Logged:
        topic, kind, log_ns, data = odom(step)
        message: Any = HUMBLE.deserialize_cdr(data, MOVED)
        message.header = msg.header(BEGUN_NS + step * STEP_NS + stamped_ns, "odom")
        message.pose.pose = msg.pose_from_se2(way(step))
        q = message.pose.pose.orientation
        q.z, q.w = length * q.z, length * q.w
        return topic, kind, log_ns, bytes(HUMBLE.serialize_cdr(message, MOVED))

    return at


def transforms(way: Way, prefix: str = "") -> Callable[[int], Logged]:
    def at(step: int) -> Logged:
        stamp_ns = BEGUN_NS + step * STEP_NS
        one = msg.planar_transform_stamped(
            stamp_ns, f"{prefix}odom", f"{prefix}base_footprint", way(step)
        )
        data = HUMBLE.serialize_cdr(msg.TFMessage([one]), TRANSFORMS)
        return "/tf", TRANSFORMS, stamp_ns, bytes(data)

    return at


def still(_: int) -> SE2:
    return SE2(0.0, 0.0, 0.0)


def turning(step: int) -> SE2:
    return curve(step)._replace(yaw_rad=0.0)


def poses(log: Log) -> list[SE2]:
    return [one.odom_from_base for one in log.entries if one.odom_from_base is not None]


class TestOdometryOfNoUse:
    @pytest.mark.parametrize(
        ("messages", "why"),
        [
            (drive(scan, moved(still), transforms(curve)), "does not move"),
            (drive(scan, moved(turning), transforms(curve)), "does not turn"),
            ([*drive(scan, transforms(curve)), moved(curve)(STEPS - 1)], "is there for 0 % of "),
            (drive(scan, moved(curve, length=0.0), transforms(curve)), ""),
        ],
    )
    def test_transforms_serve_in_its_place(
        self, tmp_path: Path, messages: list[Logged], why: str
    ) -> None:
        ordered = sorted(messages, key=lambda one: one[2])
        log = logged(write_mcap(tmp_path / "a.mcap", ordered))
        np.testing.assert_allclose(poses(log), [curve(step) for step in range(STEPS)], atol=1e-9)
        assert log.odometry_source.startswith("/tf, ")
        assert any(f"/odom {why}" in one for one in log.remarks()) == bool(why)

    def test_the_topic_that_serves_is_named(self, tmp_path: Path) -> None:
        messages = [
            (f"/robot1{topic}", kind, log_ns, data)
            for topic, kind, log_ns, data in drive(scan, moved(still), transforms(curve))
        ]
        path = write_mcap(tmp_path / "a.mcap", messages)
        log = logged(path, Topics("/robot1/scan", "/robot1/odom"))
        assert log.odometry_source.startswith("/robot1/tf, ")
        assert log.remarks() == ["/robot1/odom does not move: odometry is that of /robot1/tf"]

    @pytest.mark.parametrize(
        "messages",
        [
            drive(scan, moved(still), transforms(curve, "other/")),
            drive(scan, moved(still), transforms(still)),
            drive(scan, moved(still)),
        ],
    )
    def test_transforms_of_another_robot_or_without_a_way_do_not(
        self, tmp_path: Path, messages: list[Logged]
    ) -> None:
        log = logged(write_mcap(tmp_path / "a.mcap", messages))
        assert log.odometry_source.startswith("/odom, ")
        assert poses(log) == [still(0)] * STEPS

    def test_quaternions_that_are_none_are_left_out_and_told(self, tmp_path: Path) -> None:
        def some(step: int) -> Logged:
            return moved(curve, length=0.0 if step % 4 == 0 else 1.004)(step)

        log = logged(write_mcap(tmp_path / "a.mcap", drive(scan, some)))
        assert len(poses(log)) == STEPS - 10
        assert log.remarks() == [
            "10 poses of odometry and transforms are not finite, or their quaternion is not "
            "normalized: left out"
        ]
        path = write_mcap(tmp_path / "b.mcap", drive(scan, moved(curve, length=0.0)))
        assert "has no odometry: 40 poses and transforms are not finite, or" in refused(
            lambda: logged(path)
        )


class TestDoubts:
    @pytest.mark.parametrize(
        ("later_ns", "said"),
        [
            (500_000_000, "0.50 s earlier"),
            (-300_000_000, "0.30 s later"),
            (-(10**18), "11574.1 days later"),
        ],
    )
    def test_stamps_of_two_clocks_are_told(self, tmp_path: Path, later_ns: int, said: str) -> None:
        path = write_mcap(tmp_path / "a.mcap", drive(scan, moved(curve, later_ns)))
        (doubt,) = doubts_of_odometry(logged(path))
        assert doubt.startswith(f"scans are stamped {said} than odometry by when they were logged")

    @pytest.mark.parametrize("pace", [0, 1, 5])
    def test_one_clock_is_none(self, tmp_path: Path, pace: int) -> None:
        """Of messages that are logged when they are stamped, or by another pace."""
        messages = [
            (topic, kind, BEGUN_NS + pace * (log_ns - BEGUN_NS), data)
            if pace
            else (topic, kind, log_ns // 10**7 * 10**7, data)
            for topic, kind, log_ns, data in drive(scan, moved(curve))
        ]
        path = write_mcap(tmp_path / "a.mcap", messages)
        assert doubts_of_odometry(logged(path)) == []

    @pytest.mark.parametrize(
        ("way", "seen", "said"),
        [
            (turning, 1.0, "odometry never turns, but its way does"),
            (still, 1.0, "odometry never moves, but the scans show a way"),
            (still, 0.0, ""),
            (curve, 1.0, ""),
            (lambda step: SE2(0.1 * step, -0.2 * step, 0.0), 1.0, ""),
        ],
    )
    def test_odometry_that_the_scans_or_its_way_contradict(
        self, way: Way, seen: float, said: str
    ) -> None:
        entries = [
            Entry(
                step * STEP_NS,
                way(step),
                LoggedScan(np.full(90, 2.0 + seen * step, np.float32), 0.0, 0.01, 0.1, 99.0),
            )
            for step in range(STEPS)
        ]
        log = Log(entries, odometry_topics=("/wheels",))
        doubts = [f"{said}: --odom-topic may be another, one of /wheels"] if said else []
        assert doubts_of_odometry(log) == doubts
