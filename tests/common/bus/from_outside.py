"""What a test does on the bus from outside of the services."""

from __future__ import annotations

import time

import zenoh

from mazebot.common.bus.liveliness import alive


def wait_until_alive(session: zenoh.Session, service: str, deadline_s: float) -> bool:
    """Wait until a service is alive; False at the deadline, in seconds from now."""
    end = time.monotonic() + deadline_s
    while time.monotonic() < end:
        if service in alive(session):
            return True
        time.sleep(0.05)
    return False
