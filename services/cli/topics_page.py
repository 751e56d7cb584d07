"""Prints docs/topics.md from the table of topics."""

from __future__ import annotations

import sys

from services.common.topics import TOPICS
from services.common.wire import key_from_topic, type_name

_HEAD = """# Topics

Generated from `services/common/topics.py` by `make generate`; do not edit.

Keys are the plain ROS names without their slash. `latest`: dropped under pressure, a reader keeps
the newest; `every`: must arrive; `latched`: a late reader gets the last one. A type of our own is
a JSON document in `std_msgs/msg/String`, declared in `services/common/documents.py`.

| topic | key | type | rate Hz | written by | read by | delivery | what |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""


def topics_page() -> str:
    """The page's text."""
    rows = []
    for topic in sorted(TOPICS, key=lambda topic: topic.name):
        kind = type_name(topic)
        if kind.startswith("std_msgs"):
            kind = topic.type.__name__
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:g}"
        cells = (
            f"`{topic.name}`", f"`{key_from_topic(topic)}`", f"`{kind}`", rate,
            ", ".join(topic.owners), ", ".join(topic.readers), topic.delivery.value, topic.about,
        )  # fmt: skip
        rows.append("| " + " | ".join(cells) + " |")
    return _HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(topics_page())
