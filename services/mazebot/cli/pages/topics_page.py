"""Prints docs/topics.md from the tables of topics, queries, and ROS 2's services and actions."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from mazebot.common.messages.topics import QUERIES, TOPICS, Topic
from mazebot.common.messages.wire import type_name
from mazebot.common.ros.actions import ACTIONS
from mazebot.common.ros.table import OF_EACH_NODE, ROS_SERVICES

_HEAD = """# Topics

Generated from `services/mazebot/common/messages/topics.py` by `make generate`; do not edit.

On the wire of rmw_zenoh the key of a topic is `DOMAIN/NAME/TYPE/HASH`, on the plain one the name
without its leading slash ([ros2.md](ros2.md)). `latest`: best effort, a subscriber keeps the newest
message; `every`: reliable, resent to a subscriber that has missed it; `latched`: transient local, a
late subscriber gets the last message. The types of `mazebot_msgs` are in `ros2/mazebot_msgs`, made
from the documents in `services/mazebot/common/messages/`.

| topic | type | rate Hz | publishers | subscribers | delivery | what |
| --- | --- | --- | --- | --- | --- | --- |
"""

_QUERIES_HEAD = """
## Queries

Zenoh queries of user tools to one service, on the key `DOMAIN/NAME`, or on the plain wire `NAME`;
request and reply are JSON documents of `services/mazebot/common/messages/documents/`.

| query | request | reply | answered by | what |
| --- | --- | --- | --- | --- |
"""

_SERVICES_HEAD = """
## ROS services

Services of ROS 2 on the wire of rmw_zenoh ([ros2.md](ros2.md)), from
`services/mazebot/common/ros/table.py`; each is answered by the same query as Mazebot's own tools
use. `NODE`: every node has this one.

| service | type | answered by | what |
| --- | --- | --- | --- |
"""

_ACTIONS_HEAD = """
## ROS actions

Actions of ROS 2 on the same wire, from `services/mazebot/common/ros/actions.py`; each starts its
goal by the query `/navigation/send_goal`, `/compute_path_to_pose` or `/simulation/control`.

| action | type | run by | what |
| --- | --- | --- | --- |
"""


def topics_page() -> str:
    """Return the text of the page."""
    rows: list[tuple[str, ...]] = []
    for topic in sorted(TOPICS, key=lambda topic: topic.name):
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:g}"
        cells = (
            f"`{topic.name}`", f"`{type_name(topic)}`", rate,
            ", ".join(topic.owners), _readers(topic), topic.delivery.value, topic.about,
        )  # fmt: skip
        rows.append(cells)
    queries = [
        (
            f"`{query.name}`", f"`{query.request.__name__}`",
            f"`{query.response.__name__}`", query.owner, query.about,
        )
        for query in sorted(QUERIES, key=lambda query: query.name)
    ]  # fmt: skip
    each = {f"/{one.owner}/{name}" for one in ROS_SERVICES for name, *_ in OF_EACH_NODE}
    services = [
        *(
            (f"`{one.name}`", f"`{one.type}`", one.owner, one.about)
            for one in sorted(ROS_SERVICES, key=lambda one: one.name)
            if one.name not in each
        ),
        *((f"`/NODE/{name}`", f"`{kind}`", "NODE", about) for name, kind, _, about in OF_EACH_NODE),
    ]
    actions = [
        (f"`{action.name}`", f"`{action.type}`", action.owner, action.about)
        for action in sorted(ACTIONS, key=lambda action: action.name)
    ]
    parts = (
        (_HEAD, rows), (_QUERIES_HEAD, queries), (_SERVICES_HEAD, services),
        (_ACTIONS_HEAD, actions),
    )  # fmt: skip
    return "".join(head + _table(table) for head, table in parts)


def _readers(topic: Topic[Any]) -> str:
    kept = f"kept by {', '.join(topic.keepers)}" if topic.keepers else ""
    return "; ".join(filter(None, (", ".join(topic.readers), kept)))


def _table(rows: Iterable[Iterable[str]]) -> str:
    return "".join("| " + " | ".join(cells) + " |\n" for cells in rows)


if __name__ == "__main__":
    sys.stdout.write(topics_page())
