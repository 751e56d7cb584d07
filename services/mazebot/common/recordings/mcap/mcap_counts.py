"""How many messages of each topic a run's `run.mcap` holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from mazebot.common.recordings.mcap.mcap_messages import MADE_FROM, REPEATED
from mazebot.common.recordings.mcap.mcap_records import Channel
from mazebot.common.recordings.mcap.mcap_scan import Contents, scan


def by_origin(channels: Iterable[Channel], counts: Mapping[int, int]) -> Counter[str]:
    """Messages by topic; compressed pictures count for the topic with the whole ones."""
    by_topic: Counter[str] = Counter()
    for channel in channels:
        by_topic[channel.metadata.get(MADE_FROM) or channel.topic] += counts.get(channel.id, 0)
    return by_topic


def count_messages(parts: Iterable[Path]) -> Counter[str]:
    """Messages of a run's files by topic, without those that a later file repeats.

    Raises McapError if one is no MCAP, OSError if one cannot be read.
    """
    counts: Counter[str] = Counter()
    for path in parts:
        counts += counts_of(scan(path))
    return counts


def counts_of(contents: Contents) -> Counter[str]:
    """Messages of one file by topic, without those that it repeats of an earlier one."""
    repeated = contents.texts.get(REPEATED, {})
    return by_origin(contents.channels, contents.counts) - Counter(
        {name: int(count) for name, count in repeated.items()}
    )
