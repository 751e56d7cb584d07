"""The digests of one run's messages, in its `digests.bin`."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mazebot.common.messages.topics import Topic
from mazebot.common.recordings.comparing.digests import DigestWriter
from mazebot.recorder.stream.message_log import Taken

if TYPE_CHECKING:
    pass

_LOG = logging.getLogger("recorder")


class RunDigests:
    """Writes the digests; those that a full disk does not take are kept for the next time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: DigestWriter | None = None
        try:
            self._writer = DigestWriter(path)
        except OSError as error:
            _LOG.error("%s: %s", path, error.strerror)

    def add(self, topic: Topic[Any], taken: Taken) -> None:
        """Add the digest of a message."""
        if self._writer is not None:
            self._writer.add(topic, taken.pieces, taken.envelope)

    def write(self, close: bool = False) -> None:
        """Write the digests to disk."""
        writer = self._writer
        if writer is None:
            return
        was_full, lost = writer.waits, writer.lost
        try:
            if close:
                writer.close()
            else:
                writer.flush()
        except OSError as error:
            if close or not was_full:
                consequence = "the remaining digests are lost" if close else "retrying"
                _LOG.error("%s: %s; %s", self._path, error.strerror, consequence)
        else:
            if was_full:
                _LOG.info("%s: written again", self._path)
        if writer.lost and not lost:
            _LOG.error("%s: too many unwritten digests; some are dropped", self._path)
