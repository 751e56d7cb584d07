"""Gives a reader one file, and says what must not have come of it."""

from __future__ import annotations

import hashlib
import shutil
import time
import traceback
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.problems import words
from tests.fuzz.readers import Reader, told

MAX_S = 5.0
"""Of processor time, for a file of some kB."""


class Trial:
    """Files for one reader, in a folder of its own, and what was found, each fault once."""

    def __init__(self, reader: Reader, folder: Path, found: Path) -> None:
        self.reader = reader
        self._folder = folder
        self._found = found
        self._known: set[str] = set()
        self.refused = False
        """Whether the last file was."""

    def read(self, data: bytes) -> str:
        """Read a file with this content; what is wrong in one line, empty: nothing. Of each fault
        that was not there before, the file is kept.
        """
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()
        path = self._folder / self.reader.file
        path.write_bytes(data)
        begin_s = time.process_time()
        self.refused = False
        try:
            self.reader.read(path)
        except ConfigError as error:
            self.refused = True
            try:
                # As the command prints it.
                told(words(error))
            except AssertionError as wrong:
                return self._keep(data, wrong)
        except Exception as error:
            return self._keep(data, error)
        if time.process_time() - begin_s > MAX_S:
            return self._keep(data, TimeoutError(f"took more than {MAX_S:g} s"))
        return ""

    def _keep(self, data: bytes, error: Exception) -> str:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [one for one in frames if "/mazebot/" in one.filename] or frames[-1:]
        where = f" ({Path(ours[-1].filename).name}:{ours[-1].lineno})" if ours else ""
        fault = f"{type(error).__name__}{where}"
        if fault not in self._known:
            self._known.add(fault)
            self._found.mkdir(parents=True, exist_ok=True)
            name = f"{self.reader.name}-{hashlib.sha256(data).hexdigest()[:12]}"
            (self._found / f"{name}.bin").write_bytes(data)
            text = f"{self.reader.name}: {fault}: {str(error)[:200]!r}"
            (self._found / f"{name}.txt").write_text(f"{text}\n", encoding="utf-8")
        return fault
