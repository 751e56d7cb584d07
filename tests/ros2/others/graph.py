"""HOST PORT DOMAIN [services]: prints the graph as zenoh-ros2-sdk reads it: {topic: [types,
publishers, subscribers]}, each of these with node, namespace, type, hash and quality of service; or
{service: types}.
"""

from __future__ import annotations

import json
import sys
from dataclasses import astuple

from zenoh_ros2_sdk.discovery import (
    get_service_names_and_types,
    get_topic_info,
    get_topic_names_and_types,
)


def main(host: str, port: str, domain: str, what: str = "topics") -> None:
    """The whole graph of a domain."""
    place = {"router_ip": host, "router_port": int(port), "domain_id": int(domain), "timeout": 10.0}
    if what == "services":
        sys.stdout.write(json.dumps(dict(get_service_names_and_types(**place))))
        return
    found = {}
    for name, types in get_topic_names_and_types(**place):
        info = get_topic_info(name, verbose=True, **place)
        ends = (
            [[*astuple(each)][:-1] for each in many] for many in (info.publishers, info.subscribers)
        )
        found[name] = [types, *ends]
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
