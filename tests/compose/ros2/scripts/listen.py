"""SECONDS TOPIC...: a node of ROS 2 with rclpy prints, as JSON, the first 16 bytes and the SHA-256
of each message that it gets in that time, by topic. Before, it prints a line when all have come
once, and one at the end of that time; then it still takes what is under way.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import os
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_LATE_S = 2.0


def class_of(type_name: str) -> type:
    """The class of a message."""
    package, kind, name = type_name.split("/")
    found: type = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return found


def main() -> None:
    """Listen."""
    seconds, *names = sys.argv[1:]
    rclpy.init()
    node = Node("listener")
    # One that stays: rclpy.spin_once makes room for the node each time, and falls behind.
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end_s = time.monotonic() + 60.0
    kinds: dict[str, list[str]] = {}
    while not kinds.keys() >= set(names):
        assert time.monotonic() < end_s, f"missing: {set(names) - kinds.keys()}"
        executor.spin_once(timeout_sec=0.1)
        kinds = dict(node.get_topic_names_and_types())
    heard: dict[str, list[str]] = {name: [] for name in names}

    def receive(name: str, data: bytes) -> None:
        heard[name].append(data[:16].hex() + hashlib.sha256(data).hexdigest())

    for name in names:
        latched = any(
            each.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
            for each in node.get_publishers_info_by_topic(name)
        )
        node.create_subscription(
            class_of(kinds[name][0]), name, functools.partial(receive, name),
            QoSProfile(
                depth=1000, reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                else DurabilityPolicy.VOLATILE,
            ),
            raw=True,
        )  # fmt: skip
    while not all(heard.values()):
        assert time.monotonic() < end_s, {name: len(all_) for name, all_ in heard.items()}
        executor.spin_once(timeout_sec=0.1)
    sys.stdout.write("all\n")
    sys.stdout.flush()
    for more_s, word in ((float(seconds), "end\n"), (_LATE_S, "")):
        end_s = time.monotonic() + more_s
        while time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        sys.stdout.write(word)
        sys.stdout.flush()
    sys.stdout.write(json.dumps(heard))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
