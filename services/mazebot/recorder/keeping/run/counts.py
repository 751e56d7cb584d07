"""How many messages of a run were taken, and which."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import MAX_SOURCES, Envelope, TopicCounts

if TYPE_CHECKING:
    pass


class MessageCounts:
    """Counts the messages of a run over all its recorders, and recognises those taken before."""

    def __init__(self, before: Mapping[str, TopicCounts] | None = None) -> None:
        """`before`: what this recorder had counted when the run began."""
        self._before = {
            topic: TopicCounts(counts.received, counts.sent, counts.lost, counts.rejected)
            for topic, counts in (before or {}).items()
        }
        self.taken: dict[str, dict[str, int]] = {}
        """By topic and source, the last sequence number, of topics with delivery EVERY."""
        self.ours: Mapping[str, TopicCounts] = {}
        """Message counts of this recorder."""
        self._previous: Mapping[str, Any] = {}
        """Message counts of the previous recorder of this run."""

    def is_new(self, topic: Topic[Any], envelope: Envelope) -> bool:
        """Whether a message was not taken yet, by this recorder or the previous one."""
        if topic.delivery is not Delivery.EVERY or not envelope.source:
            return True
        taken = self.taken.setdefault(topic.name, {})
        is_new = envelope.sequence > taken.get(envelope.source, -1)
        if is_new:
            taken[envelope.source] = envelope.sequence
            while len(taken) > MAX_SOURCES:
                del taken[next(iter(taken))]
        return is_new

    def totals(self) -> dict[str, TopicCounts]:
        """Message counts by topic, including those of the previous recorder."""
        counts = {
            topic: _since(self._before.get(topic, TopicCounts()), counts)
            for topic, counts in self.ours.items()
        }
        for topic, (received, sent, lost, rejected) in self._previous.items():
            ours = counts.get(topic, TopicCounts())
            counts[topic] = TopicCounts(
                ours.received + received,
                # A publisher's sequence numbers include those sent before.
                max(ours.sent, sent),
                ours.lost + lost,
                ours.rejected + Counter(rejected),
                ours.last_sequence,
            )
        return counts

    def values(self) -> dict[str, Any]:
        """The totals as JSON values, for `restore()`."""
        return {
            topic: [counts.received, counts.sent, counts.lost, dict(counts.rejected)]
            for topic, counts in self.totals().items()
        }

    def restore(self, values: Mapping[str, Any], taken: Mapping[str, Mapping[str, int]]) -> None:
        """Continue from the previous recorder's `values()` and `taken`."""
        self._previous = values
        self.taken = {topic: dict(numbers) for topic, numbers in taken.items()}


def _since(before: TopicCounts, now: TopicCounts) -> TopicCounts:
    return TopicCounts(
        now.received - before.received,
        now.sent - before.sent,
        now.lost - before.lost,
        now.rejected - before.rejected,
        now.last_sequence,
    )
