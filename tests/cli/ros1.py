"""Writes bags as ROS 1 records them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage")
)
_T = STORE.types
BEAMS = 61
Message = tuple[str, int, Any]
"""Topic, time in ns, message."""


def header(time_ns: int, frame: str, seq: int = 0) -> Any:
    time = _T["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
    return _T["std_msgs/msg/Header"](seq=seq, stamp=time, frame_id=frame)


def pose(x_m: float) -> Any:
    turn = _T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return _T["geometry_msgs/msg/Pose"](_T["geometry_msgs/msg/Point"](x_m, 0.0, 0.0), turn)


def odometry(time_ns: int, x_m: float) -> Message:
    zero = _T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    still = _T["geometry_msgs/msg/Twist"](zero, zero)
    message = _T["nav_msgs/msg/Odometry"](
        header(time_ns, "odom", 7), "base_footprint",
        _T["geometry_msgs/msg/PoseWithCovariance"](pose(x_m), np.zeros(36)),
        _T["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36)),
    )  # fmt: skip
    return "/odom", time_ns, message


def scan(time_ns: int, ranges_m: Iterable[float], frame: str = "/laser") -> Message:
    message = _T["sensor_msgs/msg/LaserScan"](
        header(time_ns, frame, 9), 0.0, 0.0, 0.1, 0.0, 0.1, 0.1, 9.0,
        np.array([*ranges_m], np.float32), np.zeros(0, np.float32),
    )  # fmt: skip
    return "/scan", time_ns, message


def transform(time_ns: int, parent: str, child: str, x_m: float) -> Message:
    at = pose(x_m)
    offset = _T["geometry_msgs/msg/Vector3"](x_m, 0.0, 0.0)
    one = _T["geometry_msgs/msg/TransformStamped"](
        header(time_ns, parent), child,
        _T["geometry_msgs/msg/Transform"](offset, at.orientation),
    )  # fmt: skip
    return "/tf", time_ns, _T["tf/msg/tfMessage"]([one])


def drive(steps: Iterable[int]) -> list[Message]:
    """A scan and a pose of odometry for each step, 0.5 m further each."""
    messages = []
    for step in steps:
        time_ns = 10**9 * (step + 1)
        messages += [odometry(time_ns, 0.5 * step), scan(time_ns + 10, [float(step)] * BEAMS)]
    return messages


def write(path: Path, messages: Iterable[Message], packed: str = "", chunk: int = 0) -> Path:
    """A bag, packed by bz2 or lz4, with chunks of about so many bytes."""
    writer = Writer(path)
    if packed:
        writer.set_compression(Writer.CompressionFormat[packed.upper()])
    with writer:
        writer.chunk_threshold = chunk or writer.chunk_threshold
        connections: dict[str, Any] = {}
        for topic, time_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time_ns, STORE.serialize_ros1(message, kind))
    return path


def write_mcap(path: Path, messages: Iterable[Message], has_definitions: bool = True) -> Path:
    """An MCAP file as `mcap convert` makes it of a bag."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros1")
        channels: dict[str, int] = {}
        for topic, time_ns, message in messages:
            kind = message.__msgtype__
            if topic not in channels:
                text = STORE.generate_msgdef(kind, ros_version=1)[0] if has_definitions else ""
                schema = writer.register_schema(
                    kind.replace("/msg/", "/"), "ros1msg", text.encode()
                )
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            data = bytes(STORE.serialize_ros1(message, kind))
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
