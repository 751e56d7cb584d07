"""What the feed sends to the page: text for small things, bytes for grids, scans and pictures."""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

_LENGTH = struct.Struct("<I")
_ALIGNMENT = 4
"""Typed arrays in the page need an aligned begin."""


class Frame(NamedTuple):
    """One message to the page. Of each kind only the newest is kept for a page that is slow, except
    of events.
    """

    kind: str
    content: str | bytes
    is_event: bool = False


def text_frame(kind: str, content: object, is_event: bool = False) -> Frame:
    """A frame as JSON: `{"kind": kind, "content": content}`; floats have four decimals."""
    text = json.dumps(
        {"kind": kind, "content": rounded(content)}, separators=(",", ":"), allow_nan=False
    )
    return Frame(kind, text, is_event)


def binary_frame(kind: str, header: dict[str, Any], data: bytes) -> Frame:
    """A frame of bytes: the length of the head (4 bytes, little-endian), the head as JSON with
    `kind`, padded with spaces to whole 4 bytes, and the data.
    """
    head = json.dumps({"kind": kind, **rounded(header)}, separators=(",", ":")).encode()
    head += b" " * (-len(head) % _ALIGNMENT)
    return Frame(kind, _LENGTH.pack(len(head)) + head + data)


def rounded(content: Any) -> Any:
    """The same with four decimals in every float."""
    if isinstance(content, float):
        return round(content, 4)
    if isinstance(content, dict):
        return {key: rounded(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [rounded(value) for value in content]
    return content
