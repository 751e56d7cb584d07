"""Measures encoding and decoding of messages, and their way through a router on the loopback, with
and without the rules of keys, and encrypted.
`python -m mazebot.bench.parts.wire_speed [REPEATS]` prints JSON.
"""

from __future__ import annotations

import json
import queue
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from mazebot.bench.bench_figures import timed_ms
from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.own_keys import PLAIN, RMW_ZENOH
from mazebot.common.messages.topics import CAMERA_IMAGE, CMD_VEL, SCAN, Topic

_DEADLINE_S = 20.0


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
                    endpoint, topic, message, repeats, RMW_ZENOH
                ),
                "the same on the plain wire": _round_trips_ms(
                    endpoint, topic, message, repeats, PLAIN
                ),
            }
    with tempfile.TemporaryDirectory() as folder, ExitStack() as cleanup:
        ways = {}
        for name, keys_dir, encrypts in (
            ("without keys", None, False),
            ("with keys", Path(folder) / "keys", False),
            ("with keys and TLS", Path(folder) / "keys_and_certificates", True),
        ):
            router = running_router(keys_dir=keys_dir, encrypts=encrypts)
            ways[f"one way, {name}"] = cleanup.enter_context(router), keys_dir
        for name, topic, owner, reader, data in _orders_and_pictures():
            measured[name] = _one_way_ms(ways, topic, owner, reader, data, repeats)
    return measured


def _orders_and_pictures() -> Iterator[tuple[str, Topic[Any], str, str, bytes]]:
    none = msg.Vector3(0.0, 0.0, 0.0)
    command = msg.TwistStamped(msg.header(0, "base_link"), msg.Twist(none, none))
    yield "a command", CMD_VEL, "navigation", "physics", wire.encode(CMD_VEL, command)
    name, (topic, picture) = list(samples().items())[-1]
    yield name.split(",")[0], topic, "physics", "perception", wire.encode(topic, picture)


def _one_way_ms(
    ways: Mapping[str, tuple[str, Path | None]],
    topic: Topic[Any],
    owner: str,
    reader: str,
    data: bytes,
    repeats: int,
) -> dict[str, list[float]]:
    """Times from putting a message to its arrival, by turns each way."""
    with ExitStack() as cleanup:

        def end_of(endpoint: str, keys_dir: Path | None, name: str) -> zenoh.Session:
            key_file = None if keys_dir is None else keys_dir / f"{name}.key"
            session = open_session(BusConfig(connect=endpoint, key_file=key_file))
            cleanup.callback(session.close)
            return session

        def sender(endpoint: str, keys_dir: Path | None) -> Callable[[], None]:
            come: queue.SimpleQueue[None] = queue.SimpleQueue()
            # The subscription lives as long as its session.
            kept.append(
                subscribe(
                    end_of(endpoint, keys_dir, reader), topic, lambda *_: come.put(None), Keys()
                )
            )
            publisher = publish(end_of(endpoint, keys_dir, owner), topic, Keys(), lossless=True)
            deadline_s = time.monotonic() + _DEADLINE_S
            while not publisher.matching_status.matching:
                if time.monotonic() > deadline_s:
                    raise TimeoutError("the router does not connect its clients")
                time.sleep(0.01)

            def send() -> None:
                publisher.put(data)
                come.get(timeout=_DEADLINE_S)

            return send

        kept: list[Any] = []
        senders = {name: sender(*way) for name, way in ways.items()}
        times_ms: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(repeats):
            for name, send in senders.items():
                times_ms[name] += timed_ms(send, 1)
        kept.clear()
    return times_ms


def _round_trips_ms(
    endpoint: str, topic: Topic[Any], message: Any, repeats: int, wire_: str
) -> list[float]:
    """Times from before encoding to after decoding of the echo."""
    out, home = Keys(wire_, prefix="wire_speed/"), Keys(wire_, prefix="wire_speed/back/")
    near, far = (open_session(BusConfig(connect=endpoint)) for _ in range(2))
    there = publish(near, topic, out, lossless=True)
    back = publish(far, topic, home, lossless=True)
    come: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    kept = [
        subscribe(far, topic, lambda payload, _: back.put(payload), out),
        subscribe(near, topic, lambda payload, _: come.put(payload), home),
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
