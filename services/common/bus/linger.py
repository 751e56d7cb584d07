"""TCP connections that end at once."""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

_LINGER = struct.Struct("ii")
"""`struct linger` of setsockopt(2): whether to linger, and for how many seconds."""


def stop_lingering() -> None:
    """Have the TCP connections of this process close in the background.

    Zenoh has each one linger: to close it then waits, for as long as 10 s, until its reader has
    taken in what is left, and a reader that is frozen or cut off never does. Zenoh does so on one
    of the few threads that carry everybody's messages, and has no setting for it.
    """
    for path in Path("/dev/fd").iterdir():
        # What is no socket, and what was closed in the meantime, is an OSError.
        with contextlib.suppress(OSError):
            connection = socket.socket(fileno=int(path.name))
            try:
                if connection.type == socket.SOCK_STREAM and connection.family != socket.AF_UNIX:
                    _close_at_once(connection)
            finally:
                # It is Zenoh's, or another's.
                connection.detach()


def _close_at_once(connection: socket.socket) -> None:
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size)
    lingers, _ = _LINGER.unpack(data)
    if lingers:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
