"""ENDPOINT MODE KEY: prints the first message that a transient local subscriber gets, as JSON."""

from __future__ import annotations

import json
import queue
import sys

import zenoh
from sessions import opened


def main(endpoint: str, mode: str, key: str) -> None:
    """As a subscription of rmw_zenoh."""
    session = opened(endpoint, mode)
    come: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        come.put,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        subscriber_detection=True,
    )
    sample = come.get(timeout=60.0)
    attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
    content = {"payload": sample.payload.to_bytes().hex(), "attachment": attachment.hex()}
    sys.stdout.write(json.dumps(content))
    # This version hangs at the end of a process that does not.
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    session.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
