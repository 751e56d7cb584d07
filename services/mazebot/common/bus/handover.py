"""Passes latched messages on to late subscribers when their publisher is gone."""

from __future__ import annotations

import contextlib
import json
import struct
import threading
from typing import Any, cast

import zenoh

from mazebot.common.bus.attachment import pack_attachment, unpack_attachment
from mazebot.common.bus.bus import Bus
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.topics import BY_NAME, Topic
from mazebot.common.node.held import HeldMessage, is_alone, newest, wanted_by
from mazebot.common.node.node import Envelope, Inbox

HELD_PREFIX = "mazebot/held/"
TIMEOUT_S = 5.0
GRACE_S = 0.5
"""For those who have not replied yet, once somebody has replied with all that is the service's own:
one that hangs must not keep it from going on.
"""

# Receive time, and the length of the topic's name, which follows.
_HEAD = struct.Struct("<qH")


class Handover:
    """One service's part: it gives kept messages to others, and requests those that it lacks."""

    def __init__(self, bus: Bus, inbox: Inbox, keys: Keys = DEFAULT_KEYS) -> None:
        self._inbox = inbox
        self._wanted = wanted_by(bus.node_name)
        self._own = {topic.name for topic in self._wanted if bus.node_name in topic.owners}
        self._everyone = keys.own(f"{HELD_PREFIX}*/*")
        self._key = keys.own(f"{HELD_PREFIX}{bus.node_name}/{bus.source}")
        self._session: zenoh.Session | None = None
        bus.keep(self._declare)

    def _declare(self, session: zenoh.Session) -> Any:
        self._session = session
        return session.declare_queryable(self._key, self._give)

    def ask(self, of_the_living: bool = False) -> None:
        """Request missing latched messages from the others. Replies are delivered to the inbox.

        Living publishers serve their own cache. Only a service that is still waiting, because a
        message was lost, requests their messages (`of_the_living`) as well.
        """
        names = [topic.name for topic in self._wanted if not self._is_complete(topic)]
        if not names or self._session is None:
            self._inbox.hand_over()
            return
        held: list[HeldMessage[Envelope]] = []
        done = threading.Lock()

        def finish() -> None:
            if done.acquire(blocking=False):
                for message in newest(list(held)):
                    self._take(message, of_the_living)
                self._inbox.hand_over()

        grace = threading.Timer(GRACE_S, finish)
        grace.daemon = True

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.attachment is not None:
                with contextlib.suppress(ValueError):
                    data = reply.ok.payload.to_bytes()
                    held.append(_unpack(data, reply.ok.attachment.to_bytes()))
                    if self._own and self._own <= {message.topic.name for message in held}:
                        with contextlib.suppress(RuntimeError):
                            # It runs once.
                            grace.start()

        def on_end() -> None:
            grace.cancel()
            finish()

        with contextlib.suppress(zenoh.ZError):
            self._session.get(
                self._everyone,
                cast("Any", zenoh.handlers.Callback(on_reply, on_end, indirect=False)),
                payload=json.dumps({"names": names, "of_the_living": of_the_living}).encode(),
                timeout=TIMEOUT_S,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )

    def _is_received(self, topic: Topic[Any]) -> bool:
        return self._inbox.counts[topic.name].received > 0

    def _is_complete(self, topic: Topic[Any]) -> bool:
        return topic.depth == 1 and self._is_received(topic)

    def _take(self, held: HeldMessage[Envelope], of_the_living: bool) -> None:
        topic = held.topic
        # A message received meanwhile from a living publisher is newer. Where several publish at
        # the same time, each has its own messages.
        if topic in self._wanted and not (is_alone(topic) and self._is_received(topic)):
            self._inbox.deliver(topic, held.data, held.envelope)
            if not of_the_living:
                self._inbox.leave(held.envelope.source)

    def _give(self, asked: zenoh.Query) -> None:
        with asked:
            try:
                wish = json.loads(asked.payload.to_bytes() if asked.payload else b"{}")
                names = [name for name in wish["names"] if isinstance(name, str)]
                held = self._inbox.held(names, wish["of_the_living"] is True)
            except (ValueError, TypeError, KeyError):
                return
            for message in held:
                with contextlib.suppress(zenoh.ZError):
                    asked.reply(self._key, message.data, attachment=_pack(message))


def _pack(message: HeldMessage[Envelope]) -> bytes:
    """The attachment of a message that is handed over."""
    name = message.topic.name.encode()
    head = _HEAD.pack(message.received_ns, len(name))
    return head + name + pack_attachment(message.topic, message.envelope)


def _unpack(data: bytes, attachment: bytes) -> HeldMessage[Envelope]:
    """Raises ValueError where the attachment is invalid."""
    try:
        received_ns, length = _HEAD.unpack_from(attachment)
        topic = BY_NAME[attachment[_HEAD.size : _HEAD.size + length].decode()]
    except (struct.error, UnicodeDecodeError, KeyError) as error:
        raise ValueError("invalid attachment") from error
    envelope = unpack_attachment(topic, attachment[_HEAD.size + length :])
    return HeldMessage(topic, data, envelope, received_ns)
