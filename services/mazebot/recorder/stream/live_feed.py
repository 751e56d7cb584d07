"""Sends what is drawn to the live view's server, in a thread, so that the recorder never waits."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rerun as rr

if TYPE_CHECKING:
    import rerun.blueprint as rrb

_LOG = logging.getLogger("recorder")

APPLICATION = "mazebot"
TIMELINE = "sim_time"
BATCH_PERIOD_S = 0.1
"""Wall time after which logged data is sent: the default of 8 ms for live views makes fifty times
the chunks, too many for slow viewers.
"""
_MOST_WAITING = 4000
_MOST_WAITING_BYTES = 32 * 1024 * 1024
_FLUSH_TIMEOUT_S = 0.5
_SLOW_S = 5.0
"""Wall time without progress after which a slow viewer is reported."""
_END_TIMEOUT_S = 0.5

Batches = list[rr.DescribedComponentBatch]


@dataclass(frozen=True)
class _Waiting:
    """Data to be logged; while it waits, a newer one of the same key may replace it."""

    key: Hashable
    size_bytes: int
    log: Callable[[rr.RecordingStream], None]


class LiveFeed:
    """Feeds a Rerun server, which makes its writers wait for its slowest viewer.

    A separate thread does the waiting. Meanwhile drawn data is queued here, up to a limit; beyond
    it only the newest of each entity is kept, so that a viewer which catches up, or connects late,
    is shown the current state.
    """

    def __init__(self, url: str) -> None:
        """`url` is the server's; nothing is shown before `begin()`."""
        self._url = url
        self._lock = threading.Lock()
        self._name = ""
        self._begin: Callable[[], rr.RecordingStream] | None = None
        self._waiting: list[_Waiting] = []
        self._waiting_bytes = 0
        self._most, self._most_bytes = _MOST_WAITING, _MOST_WAITING_BYTES
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="live feed", daemon=True)
        self._thread.start()

    def begin(self, name: str, blueprint: rrb.Blueprint, properties: Mapping[str, str]) -> None:
        """Show another recording from now on; the one that is shown already is simply continued."""

        def make() -> rr.RecordingStream:
            stream = rr.RecordingStream(
                APPLICATION,
                recording_id=name,
                batcher_config=rr.ChunkBatcherConfig(flush_tick=BATCH_PERIOD_S),
            )
            stream.set_sinks(rr.GrpcSink(self._url))
            introduce(stream, name, blueprint, properties)
            return stream

        with self._lock:
            if name != self._name:
                self._name, self._begin = name, make
                self._waiting.clear()
                self._waiting_bytes = 0

    def log_static(self, path: str, batches: Batches) -> None:
        """Show components of an entity at every time."""

        def log(stream: rr.RecordingStream) -> None:
            stream.log(path, batches, static=True)

        key = path, "static", *(batch.component_descriptor() for batch in batches)
        size_bytes = sum(batch.as_arrow_array().nbytes for batch in batches)
        self._put(_Waiting(key, size_bytes, log))

    def send_columns(
        self, path: str, times: rr.TimeColumn, columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Show components of an entity, at several times each."""
        columns = list(columns)

        def log(stream: rr.RecordingStream) -> None:
            rr.send_columns(path, [times], columns, recording=stream)

        size_bytes = sum(column.as_arrow_array().nbytes for column in columns)
        key = path, "columns", *(column.component_descriptor() for column in columns)
        self._put(_Waiting(key, size_bytes, log))

    def close(self) -> bool:
        """Send the rest; False if a viewer did not accept it in time."""
        self._ended.set()
        self._thread.join(BATCH_PERIOD_S + _END_TIMEOUT_S)
        return not self._thread.is_alive()

    def _put(self, waiting: _Waiting) -> None:
        with self._lock:
            self._waiting.append(waiting)
            self._waiting_bytes += waiting.size_bytes
            if len(self._waiting) > self._most or self._waiting_bytes > self._most_bytes:
                self._keep_the_newest()

    def _keep_the_newest(self) -> None:
        newest: dict[Hashable, _Waiting] = {}
        for waiting in self._waiting:
            newest.pop(waiting.key, None)
            newest[waiting.key] = waiting
        self._waiting = list(newest.values())
        self._waiting_bytes = sum(waiting.size_bytes for waiting in self._waiting)
        # If the newest data alone is large, do not repeat this with every message.
        self._most = max(_MOST_WAITING, 2 * len(self._waiting))
        self._most_bytes = max(_MOST_WAITING_BYTES, 2 * self._waiting_bytes)

    def _run(self) -> None:
        stream: rr.RecordingStream | None = None
        while True:
            self._ended.wait(BATCH_PERIOD_S)
            is_last = self._ended.is_set()
            with self._lock:
                begin, self._begin = self._begin, None
                taken, self._waiting, self._waiting_bytes = self._waiting, [], 0
            if begin is not None:
                if stream is not None:
                    stream.disconnect()
                stream = begin()
            if stream is not None and (taken or begin is not None):
                for waiting in taken:
                    waiting.log(stream)
                self._wait_for_viewers(stream)
            if is_last:
                if stream is not None:
                    stream.disconnect()
                return

    def _wait_for_viewers(self, stream: rr.RecordingStream) -> None:
        """Wait until the server has accepted everything, without a timeout."""
        waited_s = 0.0
        while True:
            try:
                stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
            except (RuntimeError, TimeoutError, ValueError):
                # The server is waiting for a viewer, or has ended.
                before_s, waited_s = waited_s, waited_s + _FLUSH_TIMEOUT_S
                if before_s < _SLOW_S <= waited_s:
                    _LOG.warning(
                        "live view: a browser does not keep up and will miss some data; "
                        "the recording is not affected"
                    )
                if self._ended.is_set():
                    return
            else:
                return


def introduce(
    stream: rr.RecordingStream, name: str, blueprint: rrb.Blueprint, properties: Mapping[str, str]
) -> None:
    """Log name, properties and layout of a recording."""
    # Active at once: an open viewer has already chosen a layout.
    stream.send_blueprint(blueprint, make_active=True, make_default=True)
    stream.send_recording_name(name)
    stream.send_property("run", rr.AnyValues(drop_untyped_nones=True, **dict[str, Any](properties)))
