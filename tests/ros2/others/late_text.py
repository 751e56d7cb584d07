"""HOST PORT TOPIC HASH: prints the text that a late subscriber of zenoh-ros2-sdk gets."""

from __future__ import annotations

import os
import queue
import sys

from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile


def main(host: str, port: str, topic: str, type_hash: str) -> None:
    """One message of std_msgs/msg/String."""
    come: queue.SimpleQueue[str] = queue.SimpleQueue()
    ROS2Subscriber(
        topic,
        "std_msgs/msg/String",
        lambda message: come.put(message.data),
        msg_definition="string data\n",
        type_hash=type_hash,
        router_ip=host,
        router_port=int(port),
        domain_id=0,
        qos=QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1),
    )
    sys.stdout.write(come.get(timeout=60.0))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
