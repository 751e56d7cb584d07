"""Queries sent to a running stack."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

import zenoh

from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.topics import Query

A = TypeVar("A")
Q = TypeVar("Q")


class QueryError(ConnectionError):
    """A query without a reply, or a rejected one; the text is one line."""


class NoReplyError(QueryError):
    """Nobody has replied to a query."""


def _nothing() -> None:
    pass


def ask(
    session: zenoh.Session,
    query: Query[Q, A],
    message: Q,
    timeout_s: float,
    keys: Keys = DEFAULT_KEYS,
    start_s: float = 5.0,
    check: Callable[[], None] = _nothing,
) -> A:
    """Send a query to a running stack, and wait for the reply.

    A service that is starting is waited for, up to `start_s`: Zenoh gives an empty reply if no
    queryable exists, or if it has gone, or does not let the session ask. `check` is called once
    where that happens, and raises QueryError where it is no use to wait. Raises NoReplyError on
    timeout, QueryError where the query was rejected.
    """
    key = keys.of_query(query)
    payload = wire.encode_json(cast("Document", message))
    begin_s = time.monotonic()
    end_s = begin_s + timeout_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        for reply in session.get(key, payload=payload, timeout=left_s):
            if reply.ok is not None:
                data = reply.ok.payload.to_bytes()
                return cast("A", wire.decode_json(cast("Any", query.response), data))
            error_text = reply.err.payload.to_string() if reply.err is not None else ""
            if error_text != "Timeout":
                raise QueryError(error_text)
        check()
        check = _nothing
        if start_s < time.monotonic() - begin_s < timeout_s:
            raise NoReplyError(f"{query.name}: {query.owner} is not running")
        time.sleep(0.02)
    raise NoReplyError(f"{query.name}: no reply from {query.owner} within {timeout_s:g} s")
