"""Measures encoding and decoding of messages, and round trips through a router on the loopback.
`python -m mazebot.bench.parts.wire_speed [REPEATS]` prints JSON.
"""

from __future__ import annotations

import json
import queue
import sys
import time
from functools import partial
from typing import Any

import numpy as np

from mazebot.bench.bench_figures import timed_ms
from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import CAMERA_IMAGE, SCAN, Topic

_DEADLINE_S = 20.0
_PREFIX = "wire_speed/"
_BACK = "wire_speed/back/"


def samples() -> dict[str, tuple[Topic[Any], Any]]:
    """A scan of 360 rays and an image of 640 x 480, which is 0.92 MB."""
    random = np.random.default_rng(1)
    ranges = random.uniform(0.2, 3.4, 360).astype(np.float32)
    scan = msg.LaserScan(
        header=msg.header(0, "base_scan"), angle_min=0.0, angle_max=6.27, angle_increment=0.0175,
        time_increment=0.0, scan_time=0.1, range_min=0.12, range_max=3.5, ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )  # fmt: skip
    picture = msg.Image(
        header=msg.header(0, "camera"), height=480, width=640, encoding="rgb8", is_bigendian=0,
        step=1920, data=random.integers(0, 256, 480 * 1920, np.uint8),
    )  # fmt: skip
    return {"scan, 360 rays": (SCAN, scan), "picture, 640x480": (CAMERA_IMAGE, picture)}


def measure(repeats: int) -> dict[str, dict[str, list[float]]]:
    """Milliseconds of each measurement of each sample, by name."""
    measured = {}
    with running_router() as endpoint:
        for name, (topic, message) in samples().items():
            data = wire.encode(topic, message)
            measured[name] = {
                "check": timed_ms(partial(wire.validate, topic, message), repeats),
                "encode": timed_ms(partial(wire.encode, topic, message), repeats),
                "decode": timed_ms(partial(wire.decode, topic, data), repeats),
                "there and back through a router": _round_trips_ms(
                    endpoint, topic, message, repeats
                ),
            }
    return measured


def _round_trips_ms(endpoint: str, topic: Topic[Any], message: Any, repeats: int) -> list[float]:
    """Times from before encoding to after decoding of the echo."""
    near, far = (open_session(BusConfig(connect=endpoint)) for _ in range(2))
    there = publish(near, topic, _PREFIX, lossless=True)
    back = publish(far, topic, _BACK, lossless=True)
    come: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    kept = [
        subscribe(far, topic, lambda payload, _: back.put(payload), _PREFIX),
        subscribe(near, topic, lambda payload, _: come.put(payload), _BACK),
    ]

    def round_trip() -> None:
        there.put(wire.encode(topic, message))
        wire.decode(topic, come.get(timeout=_DEADLINE_S))

    try:
        deadline_s = time.monotonic() + _DEADLINE_S
        while not (there.matching_status.matching and back.matching_status.matching):
            if time.monotonic() > deadline_s:
                raise TimeoutError("the router does not connect its clients")
            time.sleep(0.01)
        return timed_ms(round_trip, repeats)
    finally:
        kept.clear()
        near.close()  # type: ignore[no-untyped-call]
        far.close()  # type: ignore[no-untyped-call]


def main() -> None:
    """Print the measurements."""
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    sys.stdout.write(json.dumps(measure(repeats)) + "\n")


if __name__ == "__main__":
    main()
