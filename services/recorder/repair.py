"""Makes whole the recordings that a killed recorder left: readable, but without an end."""

from __future__ import annotations

import fcntl
import importlib.util
import logging
import subprocess
import threading
from pathlib import Path

from services.recorder.run_folder import LOCK

_LOG = logging.getLogger("recorder")
TIMEOUT_S = 120.0


def rerun_binary() -> Path | None:
    """The Rerun program itself; `bin/rerun` is a wrapper that leaves it running when killed."""
    spec = importlib.util.find_spec("rerun_cli")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    candidates = [Path(folder) / "rerun" for folder in folders]
    return next((path for path in candidates if path.is_file()), None)


def leftovers(recordings_dir: Path) -> list[Path]:
    """The run folders whose recorder is dead but never said that the run is whole, oldest first."""
    return [lock.parent for lock in sorted(recordings_dir.glob(f"*/{LOCK}")) if _is_free(lock)]


class Repair(threading.Thread):
    """Repairs every leftover of a folder, one at a time, beside whatever else happens."""

    def __init__(self, recordings_dir: Path, binary: Path | None = None) -> None:
        super().__init__(name="repair", daemon=True)
        self._recordings_dir = recordings_dir
        self._binary = binary or rerun_binary()
        self._stopped = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None

    def run(self) -> None:
        """Repair until there is nothing left or `stop()` is called."""
        for folder in leftovers(self._recordings_dir):
            if self._stopped.is_set():
                return
            lock = folder / LOCK
            try:
                # Held while at work, so that of two recorders one repairs.
                with lock.open(encoding="utf-8") as held:
                    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    self._repair(folder)
            except OSError:
                continue

    def stop(self) -> None:
        """End at once; what is half repaired stays as it was."""
        self._stopped.set()
        process = self._process
        if process is not None and process.poll() is None:
            process.kill()
        self.join(1.0)

    def _repair(self, folder: Path) -> None:
        for recording in sorted(folder.glob("run*.rrd")):
            whole = recording.with_suffix(".whole")
            problem = self._rewrite(recording, whole)
            if self._stopped.is_set():
                whole.unlink(missing_ok=True)
                return
            if problem:
                whole.unlink(missing_ok=True)
                _LOG.warning("%s cannot be repaired: %s", recording, problem)
            else:
                whole.replace(recording)
                _LOG.info("repaired %s", recording)
        (folder / LOCK).unlink(missing_ok=True)

    def _rewrite(self, recording: Path, whole: Path) -> str:
        """Write what can be read of a recording as a whole one; what is wrong, or nothing."""
        if self._binary is None:
            return "the Rerun program is not installed"
        command = [str(self._binary), "rrd", "optimize", str(recording), "-o", str(whole)]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as process:
            self._process = process
            try:
                _, errors = process.communicate(timeout=TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                return f"not done within {TIMEOUT_S:.0f} s"
        if process.returncode == 0 and whole.is_file() and whole.stat().st_size > 0:
            return ""
        lines = errors.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit code {process.returncode}"


def _is_free(lock: Path) -> bool:
    try:
        with lock.open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
