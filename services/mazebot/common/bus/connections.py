"""TCP connections: whether one is taken, and that they close at once."""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

_LINGER = struct.Struct("ii")
"""`struct linger` of setsockopt(2): whether to linger, and for how many seconds."""


_ANSWER_S = 1.0
"""For so long whoever listens may take to take a connection."""


def listens(host: str, port: int) -> bool:
    """Whether somebody does, by a connection that is closed at once."""
    try:
        socket.create_connection((host, port), _ANSWER_S).close()
    except OSError:
        return False
    return True


def stop_lingering() -> None:
    """Make the TCP connections of this process close in the background.

    Zenoh sets SO_LINGER on each one: closing then blocks, for up to 10 s, until the peer has read
    the remaining data, which a frozen or disconnected peer never does. Zenoh closes on one of the
    few threads that carry all messages, and has no setting for it.
    """
    for path in Path("/dev/fd").iterdir():
        # A descriptor that is no socket, or was closed in the meantime, raises OSError.
        with contextlib.suppress(OSError):
            connection = socket.socket(fileno=int(path.name))
            try:
                if connection.type == socket.SOCK_STREAM and connection.family != socket.AF_UNIX:
                    _close_at_once(connection)
            finally:
                # The descriptor belongs to Zenoh, or another owner.
                connection.detach()


def _close_at_once(connection: socket.socket) -> None:
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size)
    lingers, _ = _LINGER.unpack(data)
    if lingers:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
