"""Recognises messages that have been received before."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from mazebot.common.bus.publisher import RESENT
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.common.node.node import Envelope

MAX_SOURCES = 4096
"""Publishers, each of one topic, that are remembered, the most recent ones."""
_REMEMBERED = 2 * RESENT
"""Of the last RESENT messages, those that have come are among so many received last: fewer than
RESENT were sent after them, and no more than RESENT before them can have come later.
"""


class Repeats:
    """What has been received from each publisher, on whatever session: a publisher sends again what
    it caches when it opens a new session, or when a reader does. Any thread may call.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received: dict[tuple[str, str], deque[int]] = {}
        """By topic and source, the sequence numbers received last."""

    def is_repeated(self, topic: Topic[Any], envelope: Envelope) -> bool:
        """Whether a message has come before, or is latched and older than one that has; else it is
        remembered. One that was lost on the way and comes late is not repeated.
        """
        if topic.delivery is Delivery.LATEST or not envelope.source:
            return False
        key, sequence = (topic.name, envelope.source), envelope.sequence
        with self._lock:
            received = self._received.get(key, deque(maxlen=_REMEMBERED))
            latched = topic.delivery is Delivery.LATCHED
            if received and (sequence <= received[-1] if latched else sequence in received):
                return True
            received.append(sequence)
            # The most recent publisher comes last.
            self._received.pop(key, None)
            self._received[key] = received
            while len(self._received) > MAX_SOURCES:
                del self._received[next(iter(self._received))]
        return False
