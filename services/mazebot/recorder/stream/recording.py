"""One Rerun recording, into a file, to the live view, or both."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import rerun as rr

from mazebot.recorder.stream.file_writer import FileWriter, RecordingError
from mazebot.recorder.stream.live_feed import (
    APPLICATION,
    BATCH_PERIOD_S,
    TIMELINE,
    Batches,
    LiveFeed,
    introduce,
)

if TYPE_CHECKING:
    import rerun.blueprint as rrb


_LOG = logging.getLogger("recorder")

AGAIN_NS = 10_000_000_000
"""Unchanged values are logged again this often, for viewers that have only the newest data."""
LEVEL_NS = 2_000_000_000
"""How much too early a plot's line may end while the number stays the same."""
_NOTHING = 1e-9
"""Smaller changes (m, rad, and the like) count as none: a body at rest jitters by 1e-17."""
_MOST_SHOWN = 20_000
"""Entities come and go: beyond this, the state is forgotten, and values are logged once more."""
_EVENT = "rerun.archetypes.TextLog"
"""Events are always logged, even if equal."""
_CLOSE_TIMEOUT_S = 1.5
_FLUSH_TIMEOUT_S = 1.0
_MOST_WAITING = 8
_MOST_UNMADE = 8
"""Waking the other thread for each takes the interpreter from this one."""
_SCALARS = rr.Scalars.descriptor_scalars()
_UNSEEN = 1e-6
"""Scale of hidden entities: Rerun warns about 0, and about a frame without a transform."""


Vector = tuple[float, float, float]
Xyzw = tuple[float, float, float, float]
_Unmade = tuple[int, str, Callable[[], rr.AsComponents]]
"""Time, entity, and what makes the value."""


class Recording:
    """A stream of drawn messages into a file, to the live view, or both.

    What changes over time is collected and sent together for each entity, at a fraction of the cost
    of logging each value.
    """

    def __init__(
        self,
        name: str,
        *,
        path: Path | None,
        live: LiveFeed | None,
        blueprint: rrb.Blueprint,
        properties: Mapping[str, str],
    ) -> None:
        """Raises RecordingError if the file cannot be created."""
        self.chunks = 0
        """Sent to the file so far: Rerun keeps an entry of each in memory until the file ends."""
        self._live = live
        self._file: rr.RecordingStream | None = None
        self._writer: FileWriter | None = None
        self._stamp_ns = -1
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._making: deque[Future[None]] = deque()
        self._scalars: dict[str, _Series] = {}
        self._transforms: dict[tuple[str, str, str, bool], _Transforms] = {}
        self._placed: dict[str, tuple[int, tuple[float, ...], tuple[object, ...]]] = {}
        """Of each path with a transform: when the last one was logged, its numbers and frames."""
        self._unmade: list[_Unmade] = []
        self._not_made: set[str] = set()
        self._rows: dict[str, list[_Rows]] = {}
        """By entity, in the order in which they were logged."""
        self._lock = threading.Lock()
        """Held while these are added to or taken."""
        self._shown: dict[tuple[str, bool, rr.ComponentDescriptor], tuple[int, bytes]] = {}
        """Of each component of an entity: when it was last logged, and the digest of its data."""
        if path is not None:
            batches = rr.ChunkBatcherConfig(flush_tick=BATCH_PERIOD_S)
            stream = rr.RecordingStream(APPLICATION, recording_id=name, batcher_config=batches)
            try:
                self._writer = FileWriter(path)
            except OSError as error:
                raise RecordingError(error.strerror or str(error)) from error
            try:
                stream.set_sinks(rr.FileSink(self._writer.path))
            except (RuntimeError, OSError) as error:
                raise RecordingError(_one_line(error)) from error
            finally:
                self._writer.start()
            introduce(stream, name, blueprint, properties)
            self._file = stream
        if live is not None:
            live.begin(name, blueprint, properties)

    def at(self, stamp_ns: int) -> None:
        """Set the simulation time of what is logged next."""
        self._stamp_ns = stamp_ns

    def log(self, path: str, *archetypes: rr.AsComponents, static: bool = False) -> None:
        """Log archetypes to an entity; static ones hold at every time."""
        self._log(path, archetypes, self._stamp_ns, static)

    def log_later(self, path: str, make: Callable[[], rr.AsComponents]) -> None:
        """Log to an entity what takes long to make, in another thread."""
        self._unmade.append((self._stamp_ns, path, make))
        if len(self._unmade) >= _MOST_UNMADE:
            self._make_later()

    def scalar(self, path: str, value: float) -> None:
        """Log a number to an entity; of equal ones in a row only the first and the last."""
        self._scalars.setdefault(path, _Series()).add(self._stamp_ns, float(value))

    def transform(
        self,
        path: str,
        translation_m: Vector,
        xyzw: Xyzw,
        parent_frame: str,
        child_frame: str,
        shown: bool = True,
    ) -> None:
        """Log the transform of a frame in another, or hide what is in it; skipped if nothing has
        changed.
        """
        numbers, frames = (*translation_m, *xyzw), (parent_frame, child_frame, shown)
        before = self._placed.get(path)
        if before is not None and before[2] == frames and self._is_fresh(before[0], self._stamp_ns):
            if all(map(_is_same, before[1], numbers)):
                return
        if len(self._placed) > _MOST_SHOWN:
            self._placed.clear()
        self._placed[path] = self._stamp_ns, numbers, frames
        key = path, parent_frame, child_frame, shown
        rows = self._transforms.setdefault(key, _Transforms())
        rows.stamps_ns.append(self._stamp_ns)
        rows.translations_m.append(translation_m)
        rows.xyzws.append(xyzw)

    def send(self) -> None:
        """Send what is queued, but for numbers, in another thread."""
        self._make_later()
        queued, self._transforms = self._transforms, {}
        self._later(self._send_transforms, queued)
        self._later(self._send_rows)

    def _send_numbers(self, queued: Mapping[str, tuple[list[int], list[float]]]) -> None:
        for path, (stamps_ns, values) in queued.items():
            column = rr.ComponentColumn(_SCALARS, _Arrow(pa.array(values, pa.float64())))
            self._send_columns(path, stamps_ns, [column])

    def _send_rows(self) -> None:
        with self._lock:
            queued, self._rows = self._rows, {}
        for path, each in queued.items():
            for rows in each:
                self._send_columns(path, rows.stamps_ns, rows.columns())

    def _send_transforms(self, queued: Mapping[tuple[str, str, str, bool], _Transforms]) -> None:
        for (path, parent_frame, child_frame, shown), rows in queued.items():
            columns = rr.Transform3D.columns(
                translation=np.array(rows.translations_m),
                quaternion=np.array(rows.xyzws),
                parent_frame=[parent_frame] * len(rows.stamps_ns),
                child_frame=[child_frame] * len(rows.stamps_ns),
                scale=None if shown else [(_UNSEEN, _UNSEEN, _UNSEEN)] * len(rows.stamps_ns),
            )
            self._send_columns(path, rows.stamps_ns, columns)

    def flush(self) -> None:
        """Have everything logged so far written to disk, or as much as possible within a second, in
        another thread.

        Raises RecordingError if the file cannot be written any further, as far as it is known.
        """
        self._send_all()
        self._later(self._flush_file, _FLUSH_TIMEOUT_S)
        writer = self._writer if self._file is not None else None
        if writer is not None and writer.problem is not None:
            raise RecordingError(writer.problem)

    def end_file(self) -> None:
        """Write the file's end, if possible, and close it; further data goes to the live view only.

        Raises RecordingError if the end could not be written.
        """
        for series in self._scalars.values():
            series.end()
        self._send_all()
        self.finish()
        stream, writer = self._file, self._writer
        if stream is None or writer is None:
            return
        self._flush_file(_CLOSE_TIMEOUT_S)
        self._file = None
        # Disconnecting blocks while the disk hangs.
        ending = threading.Thread(target=stream.disconnect, name="end of file", daemon=True)
        ending.start()
        is_whole = writer.join(_CLOSE_TIMEOUT_S)
        if writer.problem is not None:
            raise RecordingError(writer.problem)
        if not is_whole:
            raise RecordingError(f"writing to the disk timed out after {_CLOSE_TIMEOUT_S:g} s")

    def close(self) -> None:
        """End the file; nothing may be logged afterwards.

        Raises RecordingError if the file's end could not be written.
        """
        try:
            self.end_file()
        finally:
            self._maker.shutdown()

    def _flush_file(self, timeout_s: float) -> None:
        if self._file is None or self._writer is None:
            return
        try:
            self._file.flush(timeout_sec=timeout_s)
            self._writer.wait(timeout_s)
        except (RuntimeError, TimeoutError, ValueError) as error:
            # A slow disk catches up later.
            if "timed out" not in _one_line(error):
                raise RecordingError(_one_line(error)) from error

    def _send_all(self) -> None:
        self.send()
        taken = ((path, series.take()) for path, series in self._scalars.items())
        self._later(self._send_numbers, {path: points for path, points in taken if points[0]})

    def _later(self, task: Callable[..., None], *arguments: Any) -> None:
        """Have something done in the other thread, after what was asked for before.

        Raises what one of these has raised.
        """
        while self._making and (self._making[0].done() or len(self._making) >= _MOST_WAITING):
            self._making.popleft().result()
        self._making.append(self._maker.submit(task, *arguments))

    def finish(self) -> None:
        """Return when everything that was asked for is done."""
        self._make_later()
        while self._making:
            self._making.popleft().result()

    def _make_later(self) -> None:
        unmade, self._unmade = self._unmade, []
        if unmade:
            self._later(self._make, unmade)

    def _make(self, unmade: Iterable[_Unmade]) -> None:
        for stamp_ns, path, make in unmade:
            try:
                made = make()
            except Exception:
                # As of a message that is drawn at once: it is recorded all the same.
                if path not in self._not_made:
                    self._not_made.add(path)
                    _LOG.exception("%s cannot be drawn", path)
                continue
            self._log(path, (made,), stamp_ns, static=False)

    def _log(
        self, path: str, archetypes: Iterable[rr.AsComponents], stamp_ns: int, static: bool
    ) -> None:
        batches: Batches = [
            batch for archetype in archetypes for batch in archetype.as_component_batches()
        ]
        if self._is_as_before(path, batches, stamp_ns, static):
            return
        if not static:
            self._queue(path, batches, stamp_ns)
            return
        if self._file is not None:
            self._file.log(path, batches, static=True)
        if self._live is not None:
            self._live.log_static(path, batches)

    def _queue(self, path: str, batches: Batches, stamp_ns: int) -> None:
        descriptors = tuple(batch.component_descriptor() for batch in batches)
        with self._lock:
            each = self._rows.setdefault(path, [])
            # At equal times a viewer shows what was sent last.
            if not each or each[-1].descriptors != descriptors:
                each.append(_Rows(descriptors))
            each[-1].stamps_ns.append(stamp_ns)
            each[-1].values.append([batch.as_arrow_array() for batch in batches])

    def _is_as_before(self, path: str, batches: Batches, stamp_ns: int, static: bool) -> bool:
        """Whether a viewer shows the same already: it shows the newest value of every component."""
        descriptors = [batch.component_descriptor() for batch in batches]
        if any(descriptor.archetype == _EVENT for descriptor in descriptors):
            return False
        now = {
            (path, static, descriptor): _digest(batch)
            for descriptor, batch in zip(descriptors, batches, strict=True)
        }
        before = [(self._shown.get(key), digest) for key, digest in now.items()]
        if all(
            shown is not None
            and shown[1] == digest
            and (static or self._is_fresh(shown[0], stamp_ns))
            for shown, digest in before
        ):
            return True
        if len(self._shown) > _MOST_SHOWN:
            self._shown.clear()
        self._shown |= {key: (stamp_ns, digest) for key, digest in now.items()}
        return False

    @staticmethod
    def _is_fresh(logged_ns: int, stamp_ns: int) -> bool:
        return 0 <= stamp_ns - logged_ns < AGAIN_NS

    def _send_columns(
        self, path: str, stamps_ns: list[int], columns: Iterable[rr.ComponentColumn]
    ) -> None:
        times = rr.TimeColumn(TIMELINE, duration=np.array(stamps_ns, "timedelta64[ns]"))
        if self._file is not None:
            rr.send_columns(path, [times], columns, recording=self._file)
            self.chunks += 1
        if self._live is not None:
            self._live.send_columns(path, times, columns)


class _Rows:
    """Values of the same components of an entity at several times."""

    def __init__(self, descriptors: tuple[rr.ComponentDescriptor, ...]) -> None:
        self.descriptors = descriptors
        self.stamps_ns: list[int] = []
        self.values: list[list[pa.Array]] = []
        """At each time, one of each component."""

    def columns(self) -> list[rr.ComponentColumn]:
        """The values by component."""
        return [
            rr.ComponentColumn(
                descriptor, _Arrow(pa.concat_arrays(arrays)), lengths=[len(one) for one in arrays]
            )
            for descriptor, arrays in zip(
                self.descriptors, zip(*self.values, strict=True), strict=True
            )
        ]


class _Arrow:
    """Values of a component, as Rerun takes them."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array


class _Series:
    """A number over time, reduced to the ends of each constant stretch, for a line plot."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._values: list[float] = []
        self._last: tuple[int, float] | None = None
        """The newest point added,"""
        self._level_ns: int | None = None
        """and until when it has stayed the same."""

    def add(self, stamp_ns: int, value: float) -> None:
        last = self._last
        if last is not None and _is_same(last[1], value) and 0 <= stamp_ns - last[0] < LEVEL_NS:
            self._level_ns = stamp_ns
            return
        self.end()
        self._take_up(stamp_ns, value)

    def end(self) -> None:
        """Add the end of a constant stretch."""
        level_ns, self._level_ns = self._level_ns, None
        if self._last is not None and level_ns is not None:
            self._take_up(level_ns, self._last[1])

    def take(self) -> tuple[list[int], list[float]]:
        """The points since the last call."""
        taken = self._stamps_ns, self._values
        self._stamps_ns, self._values = [], []
        return taken

    def _take_up(self, stamp_ns: int, value: float) -> None:
        self._stamps_ns.append(stamp_ns)
        self._values.append(value)
        self._last = stamp_ns, value


def _is_same(before: float, now: float) -> bool:
    return abs(now - before) < _NOTHING


def _digest(batch: rr.DescribedComponentBatch) -> bytes:
    """Of its values: their type is that of the component."""
    array = batch.as_arrow_array()
    digest = hashlib.sha1(b"%d %d" % (array.offset, len(array)), usedforsecurity=False)
    for buffer in array.buffers():
        if buffer is not None:
            digest.update(buffer)
    return digest.digest()


class _Transforms:
    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.translations_m: list[Vector] = []
        self.xyzws: list[Xyzw] = []


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
