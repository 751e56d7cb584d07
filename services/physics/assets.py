"""The textures that have come, by the sha256 of their files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

from services.common import messages as msg
from services.physics.scene import decode_png

MAX_ASSETS = 512


class Assets:
    """PNG files that were looked at before they were taken in."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        """The files by their sha256."""

    def add(self, message: msg.CompressedImage) -> str:
        """Take in a file; an empty string, or the reason why not, as a short phrase."""
        sha256 = message.header.frame_id
        if sha256 in self.files:
            return ""
        if len(self.files) >= MAX_ASSETS:
            return "too many assets"
        data = message.data.tobytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            return "not the file its sha256 names"
        try:
            decode_png(data)
        except ValueError:
            return "not a PNG of at most 2048 x 2048"
        self.files[sha256] = data
        return ""

    def missing(self, wanted: Iterable[str]) -> list[str]:
        """Those of some sha256 that have not come, each once; an empty one names no file."""
        return [sha for sha in dict.fromkeys(wanted) if sha and sha not in self.files]
