"""A node on the bus that steps whenever something arrives."""

from __future__ import annotations

import threading

import zenoh

from mazebot.common.bus.bus import Bus
from mazebot.common.bus.liveliness import alive
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.node.node import Inbox, Node


class Running:
    """A node that steps whenever something arrives, on a thread of its own."""

    def __init__(self, node: Node, session: zenoh.Session, keys: Keys = DEFAULT_KEYS) -> None:
        self._woken = threading.Event()
        self._ends = False
        self.inbox = Inbox(node, self._woken.set)
        self.bus = Bus(session, node, self.inbox, keys)
        # Declarations reach the router later; what the session asks next is answered after them.
        alive(session, keys, timeout_s=20.0)
        outbox = self.bus.outbox(node)
        outbox.now_ns = 12_000_000_000

        def run() -> None:
            while not self._ends:
                self._woken.wait()
                self._woken.clear()
                node.step(0, self.inbox, outbox)

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def wake(self) -> None:
        """Let it step once more."""
        self._woken.set()

    def stop(self) -> None:
        self._ends = True
        self._woken.set()
        self._thread.join()
        self.bus.close()
