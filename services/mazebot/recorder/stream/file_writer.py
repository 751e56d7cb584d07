"""Writes a file for Rerun: if the disk refuses data, Rerun's own writer hangs without an error,
and so does every flush or close.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import threading
import time
from pathlib import Path

_PIPE_BYTES = 1024 * 1024
_LOOK_S = 0.001


class RecordingError(Exception):
    """A recording that cannot be written any further; one line of text."""


class FileWriter:
    """Writes data from a pipe to a new file, until the pipe's other end is closed.

    Once the disk refuses anything, all further data is dropped, so that nothing waits for it.
    """

    def __init__(self, path: Path) -> None:
        """Raises OSError if the file cannot be created."""
        self.problem: str | None = None
        """Why the file is incomplete, in one line."""
        self._file = path.open("wb", buffering=0)
        self._lock = threading.Lock()
        self._is_reading = True
        """Whether all data read from the pipe has been written."""
        self._read_end, self._write_end = os.pipe()
        with contextlib.suppress(OSError):
            # If that exceeds the user's limit, the default size is enough.
            fcntl.fcntl(self._write_end, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._thread = threading.Thread(target=self._run, name="file writer", daemon=True)

    @property
    def path(self) -> str:
        """The path to open, once, and write to."""
        return f"/proc/self/fd/{self._write_end}"

    def start(self) -> None:
        """Start, after the path has been opened or if it will not be."""
        os.close(self._write_end)
        self._thread.start()

    def wait(self, timeout_s: float) -> bool:
        """Whether, within a timeout, the file contains all data written to the path so far."""
        end_s = time.monotonic() + timeout_s
        while self._thread.is_alive() and self._waits():
            if time.monotonic() >= end_s:
                return False
            time.sleep(_LOOK_S)
        return True

    def join(self, timeout_s: float) -> bool:
        """Whether, within a timeout, the path was closed and the file is complete."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _waits(self) -> bool:
        with self._lock:
            if not self._is_reading:
                return True
            answer = fcntl.ioctl(self._read_end, termios.FIONREAD, struct.pack("i", 0))
        return bool(struct.unpack("i", answer)[0])

    def _run(self) -> None:
        with self._file:
            while select.select([self._read_end], [], [])[0]:
                with self._lock:
                    self._is_reading = False
                data = os.read(self._read_end, _PIPE_BYTES)
                if not data:
                    break
                self._write(data)
                with self._lock:
                    self._is_reading = True
        os.close(self._read_end)

    def _write(self, data: bytes) -> None:
        if self.problem is not None:
            return
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.problem = error.strerror or str(error)
