"""ENDPOINT TYPE: pyzeros publishes a velocity on /cmd_vel 20 times a second, until it is killed."""

from __future__ import annotations

import asyncio
import sys

import pyzeros
from ros2_pyterfaces.cyclone import all_msgs
from sessions import opened


async def publish(type_name: str) -> None:
    """0.1 m/s ahead."""
    kind = getattr(all_msgs, type_name)
    publisher = pyzeros.Pub(kind, "cmd_vel")
    message = kind()
    twist = message.twist if type_name == "TwistStamped" else message
    twist.linear.x = 0.1
    sys.stdout.write(f"{publisher.gid.tobytes().hex()}\n")
    sys.stdout.flush()
    while True:
        publisher.publish(message)
        await asyncio.sleep(0.05)


if __name__ == "__main__":
    with pyzeros.auto_context(node="teleop", zenoh_session=opened(sys.argv[1], "peer")):
        asyncio.run(publish(sys.argv[2]))
