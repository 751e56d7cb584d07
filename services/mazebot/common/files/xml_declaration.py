"""XML declarations as TinyXML takes them: it reads SDFormat, URDF and BehaviorTree.CPP's trees."""

from __future__ import annotations

import re

_LATE = re.compile(rb"\A(\s+)(<\?xml\s[^>]*\?>)")
_VERSION = re.compile(rb"\A(<\?xml\s+version\s*=\s*)(\"[^\"<>]{0,20}\"|'[^'<>]{0,20}')")


def with_sound_declaration(data: bytes) -> bytes:
    """XML whose declaration other parsers take as well: there is nothing before it, and its version
    is 1.0. Space before it is moved behind it, so that line numbers are kept.
    """
    return _VERSION.sub(rb'\1"1.0"', _LATE.sub(rb"\2\1", data, count=1), count=1)
