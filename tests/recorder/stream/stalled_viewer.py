"""A viewer that asks for the live recording and then takes nothing of it."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

_READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
_HEADERS, _DATA, _SETTINGS = 1, 0, 4
_END_STREAM, _END_HEADERS = 1, 4


@contextlib.contextmanager
def stalled_viewer(grpc_port: int) -> Iterator[socket.socket]:
    """A gRPC client as a stopped process is one: its buffers fill, and it never reads."""
    with socket.create_connection(("127.0.0.1", grpc_port), 5.0) as connection:
        headers = {
            ":method": "POST",
            ":scheme": "http",
            ":path": _READ,
            ":authority": f"127.0.0.1:{grpc_port}",
            "content-type": "application/grpc",
            "te": "trailers",
        }
        block = b"".join(_literal(name) + _literal(value, b"") for name, value in headers.items())
        connection.sendall(
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
            + _frame(_SETTINGS, 0, 0, b"")
            + _frame(_HEADERS, _END_HEADERS, 1, block)
            + _frame(_DATA, _END_STREAM, 1, bytes(5))
        )
        yield connection


def _literal(text: str, kind: bytes = b"\x00") -> bytes:
    return kind + bytes([len(text)]) + text.encode()


def _frame(kind: int, flags: int, stream: int, payload: bytes) -> bytes:
    length = struct.pack(">I", len(payload))[1:]
    return length + bytes([kind, flags]) + struct.pack(">I", stream) + payload
