"""Prints docs/topics.md from the table of topics and queries."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from services.common.bus.wire import key_from_topic, type_name
from services.common.node.topics import QUERIES, TOPICS

_HEAD = """# Topics

Generated from `services/common/node/topics.py` by `make generate`; do not edit.

Keys are the plain ROS names without their slash. `latest`: dropped under pressure, a reader keeps
the newest; `every`: sent again to a reader that has missed it; `latched`: a late reader gets the
last one. A type of our own is a JSON document in `std_msgs/msg/String`, declared in
`services/common/node/documents.py`.

| topic | key | type | rate Hz | written by | read by | delivery | what |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""

_QUERIES_HEAD = """
## Queries

What people's tools ask one service, as a Zenoh query on the name's key; request and answer are JSON
documents of `services/common/node/documents.py`.

| query | key | request | answer | asked of | what |
| --- | --- | --- | --- | --- | --- |
"""


def topics_page() -> str:
    """The page's text."""
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
