"""Expands xacro to XML in a separate process: it evaluates Python, and may loop forever."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from mazebot.worldgen.sdf.files.xml_text import UnreadableError
from mazebot.worldgen.xml_comments import without_comments

MAX_SECONDS = 30.0
"""Timeout for waiting; the process itself is limited to MAX_CPU_SECONDS of CPU time."""
_MARK = re.compile(rb"xmlns:xacro\s*=")


class StoppedError(UnreadableError):
    """Xacro did not finish."""


def needs_expansion(file: Path, data: bytes) -> bool:
    """Whether a file is xacro: by its name, or by the namespace it declares."""
    return file.suffix.lower() == ".xacro" or bool(
        _MARK.search(without_comments(data).replace(b"\0", b""))
    )


def expanded(file: Path, roots: Sequence[Path], first: Path, arguments: Mapping[str, str]) -> bytes:
    """The XML that a xacro file expands to.

    `first` is the requested file: files are included from its folder and from the roots.
    Raises UnreadableError with a phrase.
    """
    import_root = str(Path(__file__).resolve().parents[4])
    start = (
        f"import sys; sys.path.insert(0, {import_root!r}); "
        "from mazebot.worldgen.sdf.files.xacro_process import main; main()"
    )
    work = {
        "file": str(file),
        "first": str(first),
        "roots": [str(root.absolute()) for root in roots],
        "arguments": dict(arguments),
    }
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-B", "-c", start],
            input=json.dumps(work).encode(),
            capture_output=True,
            timeout=MAX_SECONDS,
            check=False,
            env={"LC_ALL": "C.UTF-8"},
        )
    except (OSError, subprocess.TimeoutExpired):
        raise StoppedError("cannot be expanded: xacro was stopped") from None
    try:
        answer = json.loads(done.stdout)
        text, error, line = answer["text"], answer["error"], answer["line"]
    except (ValueError, KeyError, TypeError):
        raise StoppedError(
            "cannot be expanded: xacro exceeded its limit of time or memory"
        ) from None
    if error:
        raise UnreadableError(f"cannot be expanded: {error}", line)
    return str(text).encode()
