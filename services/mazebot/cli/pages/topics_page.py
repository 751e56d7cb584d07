"""Prints docs/topics.md from the table of topics and queries."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from mazebot.common.messages.topics import QUERIES, TOPICS
from mazebot.common.messages.wire import key_from_topic, type_name

_HEAD = """# Topics

Generated from `services/mazebot/common/messages/topics.py` by `make generate`; do not edit.

Keys are the ROS names without their leading slash. `latest`: best effort, a subscriber keeps the
newest message; `every`: reliable, resent to a subscriber that has missed it; `latched`: transient
local, a late subscriber gets the last message. Types that are not from ROS are JSON documents in
`std_msgs/msg/String`, declared in `services/mazebot/common/messages/documents/`.

| topic | key | type | rate Hz | publishers | subscribers | delivery | what |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""

_QUERIES_HEAD = """
## Queries

Zenoh queries of user tools to one service, on the key of the name; request and reply are JSON
documents of `services/mazebot/common/messages/documents/`.

| query | key | request | reply | answered by | what |
| --- | --- | --- | --- | --- | --- |
"""


def topics_page() -> str:
    """Return the text of the page."""
    rows: list[tuple[str, ...]] = []
    for topic in sorted(TOPICS, key=lambda topic: topic.name):
        kind = type_name(topic)
        if kind.startswith("std_msgs"):
            kind = topic.type.__name__
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:g}"
        cells = (
            f"`{topic.name}`", f"`{key_from_topic(topic)}`", f"`{kind}`", rate,
            ", ".join(topic.owners), ", ".join(topic.readers), topic.delivery.value, topic.about,
        )  # fmt: skip
        rows.append(cells)
    queries = [
        (
            f"`{query.name}`", f"`{key_from_topic(query)}`", f"`{query.request.__name__}`",
            f"`{query.response.__name__}`", query.owner, query.about,
        )
        for query in sorted(QUERIES, key=lambda query: query.name)
    ]  # fmt: skip
    return _HEAD + _table(rows) + _QUERIES_HEAD + _table(queries)


def _table(rows: Iterable[tuple[str, ...]]) -> str:
    return "".join("| " + " | ".join(cells) + " |\n" for cells in rows)


if __name__ == "__main__":
    sys.stdout.write(topics_page())
