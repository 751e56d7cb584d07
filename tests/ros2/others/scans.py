"""ENDPOINT COUNT: pyzeros prints the number of rays of each scan that it gets, COUNT of them."""

from __future__ import annotations

import asyncio
import os
import sys

import pyzeros
from ros2_pyterfaces.cyclone.all_msgs import LaserScan
from sessions import opened


async def listen(count: int) -> None:
    """Print a line for each message, after one that says that it listens."""
    subscriber = pyzeros.Sub(LaserScan, "scan")
    sys.stdout.write("listening\n")
    sys.stdout.flush()
    left = count
    async for scan in subscriber.listen_reliable(queue_size=1000):
        sys.stdout.write(f"{len(scan.ranges)}\n")
        sys.stdout.flush()
        left -= 1
        if not left:
            os._exit(0)


if __name__ == "__main__":
    with pyzeros.auto_context(node="viewer", zenoh_session=opened(sys.argv[1], "peer")):
        asyncio.run(listen(int(sys.argv[2])))
