"""Scans and odometry of a bag."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.bags.bag import Bag, opened, problem_of
from mazebot.cli.logs.log import Entry, Log, LoggedScan, Topics
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.problems import words

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
    """Of each frame that is fixed in another one: the other, and its pose there."""

    @property
    def lidars(self) -> set[str]:
        """The frames of the scans."""
        return {entry.scan.frame_id for entry in self.scans if entry.scan}


def read(path: Path, topics: Topics) -> Log:
    """Read scans and odometry, the latter from `/tf` where the bag has none on its own topic.

    Raises ConfigError with one line that names file and topic, and what is wrong.
    """
    found = _Found()
    types = {topics.odom: _ODOMETRY, topics.scan: _SCAN, _STATIC: _TRANSFORMS}
    with opened(path, "--log") as bag:
        _take(found, bag, path, types, topics)
        is_mounted = all(_base_from(found.frames, one) is not None for one in found.lidars)
        if not found.odometry or (not is_mounted and _MOVING in bag.topics_of(_TRANSFORMS)):
            _take(found, bag, path, {_MOVING: _TRANSFORMS}, topics)
        # First, for it may be why a topic has no messages.
        for file, what in bag.damaged.items():
            sys.stderr.write(f"warning: --log: {words(path)}: left out: {words(file)}: {what}\n")
        if not found.scans:
            raise ConfigError(_missing(path, bag, topics.scan, _SCAN, "--scan-topic"))
        if not found.odometry and not found.transforms:
            raise ConfigError(_missing(path, bag, topics.odom, _ODOMETRY, "--odom-topic"))
    entries = [*(found.odometry or found.transforms), *found.scans]
    entries.sort(key=lambda entry: (entry.stamp_ns, entry.scan is not None))
    return Log(entries, _base_from(found.frames, min(found.lidars)))


def _missing(path: Path, bag: Bag, topic: str, kind: str, option: str) -> str:
    what = f"has no {kind} on {topic}"
    if any(one.topic == topic for one in bag.connections):
        what = f"{topic} is empty"
    others = {one.topic for one in bag.connections}
    fit = bag.topics_of(kind) - {topic}
    if fit:
        return f"--log: {path}: {what}: {option} must be one of its {_names(fit)}"
    if topic in others:
        return f"--log: {path}: {what}: must hold {kind}, and there is no other topic of that type"
    return f"--log: {path}: {what}, nor on another topic: it has {_names(others) or 'none'}"


def _names(topics: Iterable[str]) -> str:
    return ", ".join(sorted(topics))


def _take(found: _Found, bag: Bag, path: Path, types: dict[str, str], topics: Topics) -> None:
    """Read some topics, given with their types."""
    wanted = [connection for connection in bag.connections if connection.topic in types]
    for connection in wanted:
        if connection.msgtype != types[connection.topic]:
            raise ConfigError(
                f"--log: {path}: {connection.topic} is {connection.msgtype}: must be "
                f"{types[connection.topic]}"
            )
        if problem := problem_of(connection):
            raise ConfigError(f"--log: {path}: {connection.topic} {problem}")
    for connection, _, data in bag.messages(wanted):
        _add(found, connection.topic, _decoded(path, connection, data), topics)


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
            # ROS 1 begins them with a slash.
            parent = transform.header.frame_id.lstrip("/")
            child = transform.child_frame_id.lstrip("/")
            pose = _planar(msg.matrix_from_transform(transform.transform))
            if topic == _STATIC:
                found.frames[child] = (parent, pose)
            elif parent == "odom" and child in _BASES:
                stamp_ns = msg.ns_from_time(transform.header.stamp)
                found.transforms.append(Entry(stamp_ns, pose, None))
            else:
                # Where nothing latches, fixed transforms come again and again.
                found.frames.setdefault(child, (parent, pose))
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
        message.header.frame_id.lstrip("/"),
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
