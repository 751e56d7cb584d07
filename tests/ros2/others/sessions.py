"""Sessions of the Zenoh that ROS 2 Jazzy has, opened as rmw_zenoh opens them."""

from __future__ import annotations

import json

import zenoh


def opened(endpoint: str, mode: str) -> zenoh.Session:
    """A session: `client`, or `peer` as ROS 2's nodes are by default."""
    config = zenoh.Config()
    options = {
        "mode": mode,
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 10_000,
        "connect/exit_on_failure": True,
        "listen/endpoints": ["tcp/localhost:0"] if mode == "peer" else [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "timestamping/enabled": True,
    }
    for key, value in options.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
