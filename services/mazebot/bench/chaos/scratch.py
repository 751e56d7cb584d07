"""The folder in which a stack runs."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Scratch:
    """A temporary folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_needed = True
        """Whether somebody will want to see what is in it: after a failure, of any kind."""


@contextmanager
def scratch_folder(prefix: str) -> Iterator[Scratch]:
    """A temporary folder that is deleted at the end unless it is still needed; then a line on
    stderr says where it is. After Ctrl-C nobody needs it.
    """
    scratch = Scratch(Path(tempfile.mkdtemp(prefix=prefix)))
    try:
        yield scratch
    except KeyboardInterrupt:
        scratch.is_needed = False
        raise
    finally:
        if scratch.is_needed:
            sys.stderr.write(f"kept, with recordings and logs: {scratch.path}\n")
        else:
            shutil.rmtree(scratch.path, ignore_errors=True)
