"""ENDPOINT MODE KEY PAYLOAD GID: publishes one transient local message, until it is killed."""

from __future__ import annotations

import struct
import sys
import threading
import time

import zenoh
from sessions import opened


def main(endpoint: str, mode: str, key: str, payload: str, gid: str) -> None:
    """As a publisher of rmw_zenoh."""
    session = opened(endpoint, mode)
    publisher = zenoh.ext.declare_advanced_publisher(
        session,
        key,
        cache=zenoh.ext.CacheConfig(max_samples=1),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
        publisher_detection=True,
    )
    attachment = struct.pack("<qqB16s", 1, time.time_ns(), 16, bytes.fromhex(gid))
    publisher.put(bytes.fromhex(payload), attachment=attachment)
    sys.stdout.write("published\n")
    sys.stdout.flush()
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
