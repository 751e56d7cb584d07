"""Blanks the comments of XML, delimited as by Gazebo's own parser.

XML forbids `--` in a comment, and the readers used here reject it; tinyxml2, which SDFormat uses,
accepts everything up to the next `-->`, and so do authors of worlds.
"""

from __future__ import annotations

import re

_OPENS = re.compile(rb"<!--|<!\[CDATA\[|<\?")
_CLOSES = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
_BLANK = bytes(byte if byte in b"\r\n" else 0x20 for byte in range(256))
"""Everything except line breaks as a space."""


def without_comments(xml: bytes) -> bytes:
    """The text, of the same length, with spaces for comments; line numbers are kept.

    Comment marks in CDATA or in a processing instruction are ignored. Text in an encoding that does
    not include ASCII, like UTF-16, is left unchanged.
    """
    pieces, copied, at = [], 0, 0
    while (opens := _OPENS.search(xml, at)) is not None:
        closes = _CLOSES[opens.group()]
        end = xml.find(closes, opens.end())
        if end < 0:
            break
        at = end + len(closes)
        if closes == b"-->":
            pieces += [xml[copied : opens.start()], xml[opens.start() : at].translate(_BLANK)]
            copied = at
    return b"".join((*pieces, xml[copied:]))
