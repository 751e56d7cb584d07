"""One Rerun recording: the only file that opens, flushes and closes one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    import rerun.blueprint as rrb

APPLICATION = "mazebot"
TIMELINE = "sim_time"
BATCH_PERIOD_S = 0.25
"""Wall time after which what was logged goes to the file and to the live view."""
_CLOSE_TIMEOUT_S = 1.5
_FLUSH_TIMEOUT_S = 1.0
_MOST_WAITING = 8
_UNSEEN = 1e-6
"""Scale of what is not there: Rerun warns of 0, and of a frame that is nowhere."""


Vector = tuple[float, float, float]
Xyzw = tuple[float, float, float, float]


class RecordingError(Exception):
    """A recording that cannot be written any further; its text is one line."""


class Recording:
    """A stream of drawn messages into a file, to the live view, or both.

    Numbers and transforms are many and small: they are kept until all of an entity's are sent
    at once, which costs a hundredth of logging each.
    """

    def __init__(
        self,
        name: str,
        *,
        path: Path | None,
        live_url: str | None,
        blueprint: rrb.Blueprint,
        properties: Mapping[str, str],
    ) -> None:
        """Raises RecordingError where the file cannot be made."""
        # A live view's default of 8 ms makes fifty times the chunks, which slow viewers choke on.
        batches = rr.ChunkBatcherConfig(flush_tick=BATCH_PERIOD_S)
        self._stream = rr.RecordingStream(APPLICATION, recording_id=name, batcher_config=batches)
        self._stamp_ns = -1
        self._logged_stamp_ns: int | None = None
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._making: deque[Future[None]] = deque()
        self._scalars: dict[str, tuple[list[int], list[float]]] = {}
        self._transforms: dict[tuple[str, str, str, bool], _Transforms] = {}
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if path is not None:
            sinks.append(rr.FileSink(str(path)))
        if live_url is not None:
            sinks.append(rr.GrpcSink(live_url))
        try:
            self._stream.set_sinks(*sinks)
        except (RuntimeError, OSError) as error:
            raise RecordingError(_one_line(error)) from error
        # Active at once: a viewer that is open already has made up a layout of its own.
        self._stream.send_blueprint(blueprint, make_active=True, make_default=True)
        self._stream.send_recording_name(name)
        self._stream.send_property(
            "run", rr.AnyValues(drop_untyped_nones=True, **dict[str, Any](properties))
        )

    def at(self, stamp_ns: int) -> None:
        """Set the simulation time of what is logged next."""
        self._stamp_ns = stamp_ns

    def log(self, path: str, *archetypes: rr.AsComponents, static: bool = False) -> None:
        """Log archetypes to an entity; static ones hold at every time."""
        if self._logged_stamp_ns != self._stamp_ns:
            self._logged_stamp_ns = self._stamp_ns
            self._stream.set_time(TIMELINE, duration=np.timedelta64(self._stamp_ns, "ns"))
        self._stream.log(path, *archetypes, static=static)

    def log_later(self, path: str, make: Callable[[], rr.AsComponents]) -> None:
        """Log to an entity what takes long to make, beside the caller's work."""
        while len(self._making) >= _MOST_WAITING:
            self._making.popleft().result()
        self._making.append(self._maker.submit(self._make, self._stamp_ns, path, make))

    def scalar(self, path: str, value: float) -> None:
        """Log a number to an entity."""
        stamps_ns, values = self._scalars.setdefault(path, ([], []))
        stamps_ns.append(self._stamp_ns)
        values.append(float(value))

    def transform(
        self,
        path: str,
        translation_m: Vector,
        xyzw: Xyzw,
        parent_frame: str,
        child_frame: str,
        shown: bool = True,
    ) -> None:
        """Log where a frame is in another, or that what is in it is not there."""
        key = path, parent_frame, child_frame, shown
        rows = self._transforms.setdefault(key, _Transforms())
        rows.stamps_ns.append(self._stamp_ns)
        rows.translations_m.append(translation_m)
        rows.xyzws.append(xyzw)

    def send_numbers(self) -> None:
        """Log the numbers that wait."""
        for path, (stamps_ns, values) in self._scalars.items():
            self._send_columns(path, stamps_ns, rr.Scalars.columns(scalars=values))
        self._scalars.clear()

    def send_transforms(self) -> None:
        """Log the transforms that wait."""
        for (path, parent_frame, child_frame, shown), rows in self._transforms.items():
            columns = rr.Transform3D.columns(
                translation=np.array(rows.translations_m),
                quaternion=np.array(rows.xyzws),
                parent_frame=[parent_frame] * len(rows.stamps_ns),
                child_frame=[child_frame] * len(rows.stamps_ns),
                scale=None if shown else [(_UNSEEN, _UNSEEN, _UNSEEN)] * len(rows.stamps_ns),
            )
            self._send_columns(path, rows.stamps_ns, columns)
        self._transforms.clear()

    def flush(self) -> None:
        """Bring everything logged so far to the disk.

        Raises RecordingError where the disk does not take it.
        """
        self._send_all()
        try:
            self._stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
        except (RuntimeError, TimeoutError, ValueError) as error:
            raise RecordingError(_one_line(error)) from error

    def close(self) -> None:
        """Write the file's end and let go of it; nothing may be logged after."""
        self._send_all()
        self._maker.shutdown()
        try:
            self._stream.flush(timeout_sec=_CLOSE_TIMEOUT_S)
        except (RuntimeError, TimeoutError, ValueError) as error:
            raise RecordingError(_one_line(error)) from error
        finally:
            self._stream.disconnect()

    def _send_all(self) -> None:
        while self._making:
            self._making.popleft().result()
        self.send_transforms()
        self.send_numbers()

    def _make(self, stamp_ns: int, path: str, make: Callable[[], rr.AsComponents]) -> None:
        # Rerun keeps the time by thread: this one's is its own.
        self._stream.set_time(TIMELINE, duration=np.timedelta64(stamp_ns, "ns"))
        self._stream.log(path, make())

    def _send_columns(
        self, path: str, stamps_ns: list[int], columns: rr.ComponentColumnList
    ) -> None:
        times = rr.TimeColumn(TIMELINE, duration=np.array(stamps_ns, "timedelta64[ns]"))
        rr.send_columns(path, [times], columns, recording=self._stream)


class _Transforms:
    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.translations_m: list[Vector] = []
        self.xyzws: list[Xyzw] = []


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
