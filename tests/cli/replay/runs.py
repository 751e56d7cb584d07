"""Runs to replay, made in this process, and bags as other robots' drivers record them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.cli.replay.reading.run_messages import open_run
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import MAP, ODOM, SCAN, TF, TF_STATIC, Topic
from mazebot.embedded.demo import DemoOptions, run

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
BEGUN_NS = 1_700_000_000_250_000_000
"""When the robot that recorded a bag was at 0 of simulation time, by its own clock."""
LAG_NS = 3_000_000
"""The recording machine's clock is ahead by this much, and by what a message took."""


def make(folder: Path, **options: Any) -> Path:
    """Drive to a goal near the start, without a camera, and record it."""
    given = {
        "world_name": "enhanced", "camera": False, "renderer": "none", "goal": (0.5, 0.0, 0.0),
    }  # fmt: skip
    run(DemoOptions(out_dir=folder, **{**given, **options}))
    return folder


def messages_of(folder: Path) -> list[Replayed]:
    """All messages of a run."""
    return list(open_run(folder.name, [folder / "run.mcap"]).read())


def write_bag(
    path: Path,
    messages: Iterable[Replayed],
    storage: StoragePlugin,
    clock: bool = False,
    definitions: dict[str, str] | None = None,
    set_back_ns: int | None = None,
) -> Path:
    """What a TurtleBot's own nodes would have recorded of the same drive: with stamps of Unix time,
    a topic that Mazebot has not, and one of another type. With `clock`, of a simulator, whose clock
    ticks ten times a second. `definitions` are used instead of those of ROS 2 Humble.
    At `set_back_ns` the simulator's time begins anew.
    """
    topics: dict[str, Topic[Any]] = {
        topic.name: topic for topic in (MAP, ODOM, SCAN, TF, TF_STATIC)
    }
    begun_ns = 5_000_000_000 if clock else BEGUN_NS
    with Writer(path, version=9, storage_plugin=storage) as writer:

        def channel(topic: str, kind: str) -> Any:
            text = (definitions or {}).get(kind)
            how = {"typestore": HUMBLE} if text is None else {"msgdef": text, "rihs01": "none"}
            return writer.add_connection(topic, kind, **how)

        channels = {name: channel(name, wire.type_name(topic)) for name, topic in topics.items()}
        battery = channel("/dock/battery_state", "sensor_msgs/msg/BatteryState")
        twist = channel("/cmd_vel", "geometry_msgs/msg/Twist")
        ticks = channel("/clock", "rosgraph_msgs/msg/Clock") if clock else None
        still = HUMBLE.types["geometry_msgs/msg/Twist"](
            linear=HUMBLE.types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
            angular=HUMBLE.types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
        )
        ticked = -1
        first_ns = begun_ns
        for message in messages:
            log_ns = BEGUN_NS + LAG_NS + message.time_ns
            if set_back_ns is not None and message.time_ns >= set_back_ns:
                begun_ns = first_ns - set_back_ns
            if ticks is not None and message.time_ns // 100_000_000 > ticked:
                ticked = message.time_ns // 100_000_000
                now = msg.Clock(clock=msg.time_from_ns(begun_ns + ticked * 100_000_000))
                writer.write(ticks, log_ns, bytes(HUMBLE.serialize_cdr(now, now.__msgtype__)))
            if message.topic.name not in topics:
                continue
            content = wire.decode(message.topic, message.data)
            _stamp(content, begun_ns)
            writer.write(
                channels[message.topic.name],
                log_ns + (message.envelope.sequence % 3) * 1_000_000,
                wire.encode(message.topic, content),
            )
            if message.topic is ODOM:
                writer.write(battery, log_ns, bytes(_battery()))
                data = HUMBLE.serialize_cdr(still, "geometry_msgs/msg/Twist")
                writer.write(twist, log_ns, bytes(data))
    return path


def _stamp(message: Any, begun_ns: int) -> None:
    for one in getattr(message, "transforms", [message]):
        stamp_ns = msg.ns_from_time(one.header.stamp)
        one.header.stamp = msg.time_from_ns(stamp_ns + begun_ns)


def _battery() -> memoryview:
    kind = HUMBLE.types["sensor_msgs/msg/BatteryState"]
    numbers = dict.fromkeys(
        ("voltage", "temperature", "current", "charge", "capacity", "design_capacity",
         "percentage"), 1.0,
    )  # fmt: skip
    return HUMBLE.serialize_cdr(
        kind(
            header=msg.header(0, ""), **numbers, power_supply_status=0, power_supply_health=0,
            power_supply_technology=0, present=True, cell_voltage=np.zeros(0, np.float32),
            cell_temperature=np.zeros(0, np.float32), location="", serial_number="",
        ),
        "sensor_msgs/msg/BatteryState",
    )  # fmt: skip
