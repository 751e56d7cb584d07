"""Logs of ROS 2: an MCAP file, or a folder of rosbag2."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import ReaderError

from mazebot.cli.logs.bag_files import opened, plain
from mazebot.cli.logs.log import Entry, Log, LoggedScan, Topics
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg

_MOVING, _STATIC = "/tf", "/tf_static"
_ODOMETRY, _SCAN = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_BASES = ("base_footprint", "base_link")


@dataclass
class _Found:
    """What the messages of a bag say."""

    scans: list[Entry] = field(default_factory=list)
    odometry: list[Entry] = field(default_factory=list)
    transforms: list[Entry] = field(default_factory=list)
    frames: dict[str, tuple[str, SE2]] = field(default_factory=dict)


def read(path: Path, topics: Topics) -> Log:
    """Read scans and odometry, the latter from `/tf` where the bag has none on its own topic.

    Raises ConfigError with one line that names file and topic, and what is wrong.
    """
    found = _Found()
    types = {
        topics.odom: _ODOMETRY, topics.scan: _SCAN, _STATIC: _TRANSFORMS, _MOVING: _TRANSFORMS,
    }  # fmt: skip
    try:
        with opened(path) as readers:
            of = {connection.topic for reader in readers for connection in reader.connections}
            skipped = {_MOVING} if topics.odom in of else set()
            for reader in readers:
                wanted = [
                    c for c in reader.connections if c.topic in types and c.topic not in skipped
                ]
                _check_types(path, wanted, types)
                for connection, _, data in reader.messages(wanted) if wanted else ():
                    message = _decoded(path, connection, plain(bytes(data)))
                    _add(found, connection.topic, message, topics)
    except ConfigError:
        raise
    except (ReaderError, OSError, AssertionError, ValueError, KeyError, RuntimeError) as error:
        raise ConfigError(f"--log: {path}: is not a readable MCAP file: {error}") from error
    odometry = found.odometry or found.transforms
    if not found.scans:
        raise ConfigError(_missing(path, of, topics.scan, _SCAN, "--scan-topic"))
    if not odometry:
        raise ConfigError(_missing(path, of, topics.odom, _ODOMETRY, "--odom-topic"))
    entries = [*odometry, *found.scans]
    entries.sort(key=lambda entry: (entry.stamp_ns, entry.scan is not None))
    frames = {entry.scan.frame_id for entry in entries if entry.scan}
    return Log(entries, _base_from(found.frames, sorted(frames)[0]))


def _missing(path: Path, of: set[str], topic: str, kind: str, option: str) -> str:
    others = ", ".join(sorted(of)) or "none"
    return f"--log: {path}: has no {kind} on {topic}: {option} must be one of its topics: {others}"


def _check_types(path: Path, connections: list[Any], types: dict[str, str]) -> None:
    for connection in connections:
        if connection.msgtype != types[connection.topic]:
            raise ConfigError(
                f"--log: {path}: {connection.topic} is {connection.msgtype}: must be "
                f"{types[connection.topic]}"
            )


def _decoded(path: Path, connection: Any, data: bytes) -> Any:
    try:
        return msg.TYPESTORE.deserialize_cdr(data, connection.msgtype)
    except Exception as error:
        raise ConfigError(
            f"--log: {path}: a message on {connection.topic} is corrupt: {error}"
        ) from error


def _add(found: _Found, topic: str, message: Any, topics: Topics) -> None:
    if topic in (_STATIC, _MOVING):
        for transform in message.transforms:
            parent, child = transform.header.frame_id, transform.child_frame_id
            pose = _planar(msg.matrix_from_transform(transform.transform))
            if topic == _STATIC:
                found.frames[child] = (parent, pose)
            elif parent.lstrip("/") == "odom" and child.lstrip("/") in _BASES:
                stamp_ns = msg.ns_from_time(transform.header.stamp)
                found.transforms.append(Entry(stamp_ns, pose, None))
        return
    stamp_ns = msg.ns_from_time(message.header.stamp)
    if topic == topics.odom:
        found.odometry.append(Entry(stamp_ns, msg.se2_from_pose(message.pose.pose), None))
        return
    scan = LoggedScan(
        np.asarray(message.ranges, np.float32),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        message.header.frame_id,
    )
    found.scans.append(Entry(stamp_ns, None, scan))


def _base_from(frames: dict[str, tuple[str, SE2]], frame: str) -> SE2 | None:
    """base_footprint or base_link from a frame, by the static transforms; None if unknown."""
    pose, found = SE2(0.0, 0.0, 0.0), False
    for _ in range(16):
        if frame == "base_footprint" or (frame == "base_link" and frame not in frames):
            return pose if found else None
        if frame not in frames:
            return None
        frame, parent_from_frame = frames[frame]
        pose, found = parent_from_frame @ pose, True
    return None


def _planar(matrix: NDArray[np.float64]) -> SE2:
    """The planar part of a rigid (4, 4) matrix."""
    yaw_rad = math.atan2(float(matrix[1, 0]), float(matrix[0, 0]))
    return SE2(float(matrix[0, 3]), float(matrix[1, 3]), yaw_rad)
