"""A client of ROS services, written against the wire alone."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import zenoh

from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.ros.interfaces import interfaces

GID = bytes(range(16))


class RefusedError(Exception):
    """The service answered with an error."""


def ask(
    session: zenoh.Session,
    name: str,
    type_name: str,
    payload: bytes,
    attachment: bytes | None,
    keys: Keys = DEFAULT_KEYS,
    form: str = "",
) -> zenoh.Sample:
    """The one reply to a request, in the form of a distribution. Raises RefusedError."""
    key = keys.typed(name, type_name, interfaces(form or keys.distro).hash_of(type_name))
    (reply,) = session.get(
        key, payload=payload, attachment=attachment, timeout=20.0,
        target=zenoh.QueryTarget.ALL_COMPLETE,
    )  # fmt: skip
    if reply.ok is None:
        assert reply.err is not None
        raise RefusedError(reply.err.payload.to_string())
    return reply.ok


def call(
    session: zenoh.Session,
    name: str,
    type_name: str,
    values: Mapping[str, Any] | None = None,
    keys: Keys = DEFAULT_KEYS,
    sequence: int = 7,
    form: str = "",
) -> Any:
    """The response to a request, in the form of a distribution. Raises RefusedError."""
    types = interfaces(form or keys.distro)
    payload = types.encode(f"{type_name}_Request", values or {})
    attachment = struct.pack("<qqB16s", sequence, 0, 16, GID)
    sample = ask(session, name, type_name, payload, attachment, keys, form)
    assert sample.attachment is not None
    got, _, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    assert (got, length, gid) == (sequence, 16, GID)
    return types.read(f"{type_name}_Response", sample.payload.to_bytes())
