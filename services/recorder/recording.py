"""One Rerun recording: the only file that opens, flushes and closes one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    import rerun.blueprint as rrb

APPLICATION = "mazebot"
TIMELINE = "sim_time"
_CLOSE_TIMEOUT_S = 1.5
_FLUSH_TIMEOUT_S = 1.0


class RecordingError(Exception):
    """A recording that cannot be written any further; its text is one line."""


class Recording:
    """A stream of drawn messages into a file, to the live view, or both."""

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
        self._stream = rr.RecordingStream(APPLICATION, recording_id=name)
        self._stamp_ns: int | None = None
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if path is not None:
            sinks.append(rr.FileSink(str(path)))
        if live_url is not None:
            sinks.append(rr.GrpcSink(live_url))
        try:
            self._stream.set_sinks(*sinks, default_blueprint=blueprint)
        except (RuntimeError, OSError) as error:
            raise RecordingError(_one_line(error)) from error
        self._stream.send_recording_name(name)
        self._stream.send_property(
            "run", rr.AnyValues(drop_untyped_nones=True, **dict[str, Any](properties))
        )

    def at(self, stamp_ns: int) -> None:
        """Set the simulation time of what is logged next."""
        if stamp_ns != self._stamp_ns:
            self._stamp_ns = stamp_ns
            self._stream.set_time(TIMELINE, duration=np.timedelta64(stamp_ns, "ns"))

    def log(self, path: str, *archetypes: rr.AsComponents, static: bool = False) -> None:
        """Log archetypes to an entity; static ones hold at every time."""
        self._stream.log(path, *archetypes, static=static)

    def flush(self) -> None:
        """Bring everything logged so far to the disk.

        Raises RecordingError where the disk does not take it.
        """
        try:
            self._stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
        except (RuntimeError, TimeoutError, ValueError) as error:
            raise RecordingError(_one_line(error)) from error

    def close(self) -> None:
        """Write the file's end and let go of it; nothing may be logged after."""
        try:
            self._stream.flush(timeout_sec=_CLOSE_TIMEOUT_S)
        except (RuntimeError, TimeoutError, ValueError) as error:
            raise RecordingError(_one_line(error)) from error
        finally:
            self._stream.disconnect()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
