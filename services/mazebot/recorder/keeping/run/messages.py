"""The messages of one run, in its `run.mcap`."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from mazebot.common.messages.documents import World
from mazebot.common.messages.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    TF_STATIC,
    Delivery,
    Topic,
)
from mazebot.common.recordings.run_folder import MESSAGES, RunFolder
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.stream.file_writer import RecordingError
from mazebot.recorder.stream.latched import Kept, Latched
from mazebot.recorder.stream.message_log import CLOSE_TIMEOUT_S, Compressed, MessageLog, Taken
from mazebot.recorder.stream.pictures import Pictures, is_drawable

if TYPE_CHECKING:
    from mazebot.recorder.foxglove.server import FoxgloveServer

_LOG = logging.getLogger("recorder")
_MIB = 1024 * 1024


class RunMessages:
    """Decides what is written to `run.mcap`, and how; while it cannot be written, it keeps the
    latched messages that are missing there.
    """

    def __init__(
        self,
        config: RecorderConfig,
        world: World,
        latched: Latched,
        pictures: Pictures,
        foxglove: FoxgloveServer | None = None,
    ) -> None:
        self._config = config
        self._world = world
        self._latched = latched
        self._pictures = pictures
        self._foxglove = foxglove
        self._missed = Latched()
        self._log: MessageLog | None = None
        self._is_logged = False
        """Whether it is known already why the file cannot be written."""
        self._recorded: Mapping[str, int] = {}
        self.wanted = Counter(topic.name for topic, _ in self._head())
        """Messages of the run so far, by topic, whether there was room for them or not."""

    @property
    def is_kept(self) -> bool:
        """Whether there is to be a file."""
        return self._config.record and self._config.messages

    @property
    def recorded(self) -> Mapping[str, int] | None:
        """Messages in the files so far, by topic; None: there are to be no files."""
        if not self.is_kept:
            return None
        return self._log.recorded() if self._log is not None else self._recorded

    def restore(self, wanted: Mapping[str, int]) -> None:
        """Go on with the run of a recorder that has died, which had so many messages."""
        self.wanted = Counter(wanted)

    def begin(self, folder: RunFolder, properties: Mapping[str, str], now_ns: int) -> None:
        """Begin the file with the latched messages, or go on with it with those that it lacks.

        Raises RecordingError if it cannot be written.
        """
        config, name = self._config, folder.path.name
        if self._log is not None or not self.is_kept:
            return
        about = {
            "mazebot": {"run": name, **properties},
            # By these Foxglove files its recordings.
            "foxglove": {"deviceName": f"mazebot-{self._world.name}", "sessionKey": name},
        }
        part = max(1, folder.last_part(MESSAGES))
        try:
            log = MessageLog(folder.message_part, part, about, config.segment_mib * _MIB)
        except RecordingError as error:
            raise RecordingError(f"{folder.message_part(part)}: {error}") from error
        self._log = log
        # What a recorder that died has written after it last kept its progress.
        self.wanted |= Counter(log.recorded())
        for topic, taken in list(self._head() if log.is_new else self._missed):
            log.add_latched(topic, taken, now_ns)
        self._missed.clear()

    def add(self, topic: Topic[Any], taken: Taken, now_ns: int) -> None:
        """Record a message, and show it in Foxglove."""
        self.wanted[topic.name] += 1
        log, foxglove = self._log, self._foxglove
        compressed = None
        if topic is CAMERA_IMAGE and self._config.pictures == "jpeg":
            is_wanted = foxglove is not None and foxglove.wants(CAMERA_COMPRESSED.name)
            if (log is not None or is_wanted) and is_drawable(taken.message):
                make = self._pictures.jpeg_message(taken.message)
                compressed = Compressed(CAMERA_COMPRESSED.name, make)
        if foxglove is not None and topic.delivery is not Delivery.LATCHED:
            foxglove.add(topic, taken, now_ns, compressed)
        if log is None:
            self._missed.keep(topic, taken)
        else:
            log.add(topic, taken, now_ns, compressed)

    def tick(self) -> None:
        """Have a large chunk written. Only between steps: within one, messages of different topics
        do not come in the order of their times.
        """
        if self._log is not None and self._log.is_large:
            self._log.hand_over()

    def flush(self, now_ns: int) -> None:
        """Have everything written. Raises RecordingError if something could not be."""
        log = self._log
        if log is None:
            return
        try:
            log.flush(self._head, now_ns)
        except RecordingError as error:
            self._is_logged = True
            raise RecordingError(f"{log.path}: {error}") from error

    def wait(self) -> None:
        """Wait, if the disk is not too slow, until everything is written."""
        if self._log is not None:
            self._log.hand_over()
            self._log.wait(CLOSE_TIMEOUT_S)

    def end(self) -> bool:
        """End the file; it can be resumed. Returns whether it is whole."""
        log, self._log = self._log, None
        if log is None:
            return True
        was_logged, self._is_logged = self._is_logged, False
        try:
            log.close()
        except RecordingError as error:
            if not was_logged:
                _LOG.error("%s: %s", log.path, error)
            return False
        finally:
            self._recorded = log.recorded()
        return True

    def _head(self) -> Iterator[Kept]:
        """What a late subscriber would get in this world."""
        for topic, taken in self._latched:
            if topic is TF_STATIC or taken.envelope.world_hash in ("", self._world.hash):
                yield topic, taken
