"""`mazebot recordings compress`."""

from __future__ import annotations

import sys
from pathlib import Path

from mazebot.cli.parsing.options import print_json
from mazebot.common.recordings.catalog import find_run
from mazebot.recorder.transcoding.background import waiting, yield_to_others
from mazebot.recorder.transcoding.job import compress_run
from mazebot.recorder.transcoding.vp9 import VideoError


def compress_runs(directory: Path, names: list[str], as_json: bool) -> int:
    """Compress the named runs of a folder, or all that wait for it; returns the exit code.

    Raises ConfigError where there is no such run.
    """
    named = [find_run("recordings compress", directory, name).path for name in names]
    folders = named or waiting(directory)
    yield_to_others()
    rows: list[dict[str, object]] = []
    for folder in folders:
        row: dict[str, object] = {"name": folder.name, "error": ""}
        try:
            done = compress_run(folder)
        except (VideoError, OSError) as error:
            row["error"] = str(error)
            if not as_json:
                sys.stderr.write(f"error: {error}\n")
        else:
            row |= done._asdict()
            if not as_json:
                sizes = f"{done.before_bytes / 1e6:.1f} MB -> {done.after_bytes / 1e6:.1f} MB"
                sys.stdout.write(f"{folder.name}: {sizes if done.files else 'no images'}\n")
        rows.append(row)
    if as_json:
        print_json(rows)
    elif not rows:
        sys.stdout.write("nothing to compress\n")
    return int(any(row["error"] for row in rows))
