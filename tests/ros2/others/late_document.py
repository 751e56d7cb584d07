"""HOST PORT TOPIC TYPE HASH DEFINITION: prints the message that a late subscriber of zenoh-ros2-sdk
gets, as JSON.
"""

from __future__ import annotations

import dataclasses
import json
import os
import queue
import sys
from typing import Any

from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile


def main(host: str, port: str, topic: str, kind: str, type_hash: str, definition: str) -> None:
    """One message."""
    come: queue.SimpleQueue[Any] = queue.SimpleQueue()
    ROS2Subscriber(
        topic,
        kind,
        come.put,
        msg_definition=definition,
        type_hash=type_hash,
        router_ip=host,
        router_port=int(port),
        domain_id=0,
        qos=QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1),
    )
    fields = dataclasses.asdict(come.get(timeout=60.0))
    sys.stdout.write(json.dumps(fields, default=lambda array: array.tolist()))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
