"""XML without its comments, which are read as Gazebo's own parser reads them.

XML allows no `--` in a comment, and the readers here refuse it; tinyxml2, with which SDFormat is
read, takes everything up to the next `-->`, and so do those who write worlds.
"""

from __future__ import annotations

import re

_OPENS = re.compile(rb"<!--|<!\[CDATA\[|<\?")
_CLOSES = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
_BLANK = bytes(byte if byte in b"\r\n" else 0x20 for byte in range(256))
"""Everything but the ends of lines as a space."""


def without_comments(xml: bytes) -> bytes:
    """The same text, as long, with spaces for comments; every line keeps its number.

    What looks like a comment in CDATA or in a processing instruction is none. Text in an encoding
    that does not hold ASCII as it is, like UTF-16, stays as it is.
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
