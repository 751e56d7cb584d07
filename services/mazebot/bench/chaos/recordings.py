"""Whether the recordings of a stack that faults were done to are whole."""

from __future__ import annotations

from pathlib import Path

from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, SUMMARY


def faults_of_recordings(folder: Path) -> list[str]:
    """What is wrong with the runs in a folder, each in a line."""
    runs = sorted(path for path in folder.glob("*") if path.is_dir() and path.name[:1] != ".")
    if not runs:
        return [f"{folder}: no run was recorded"]
    return [f"{run.name}: {line}" for run in runs for line in _faults_of(run)]


def _faults_of(run: Path) -> list[str]:
    lines = []
    if (run / LOCK).exists():
        lines.append("its recording was not ended")
    if not (run / SUMMARY).is_file():
        lines.append(f"no {SUMMARY}")
    files = sorted(run.glob(f"{Path(MESSAGES).stem}*.mcap"))
    if not files:
        lines.append(f"no {MESSAGES}")
    for file in files:
        try:
            contents = scan(file)
        except (McapError, OSError) as error:
            lines.append(str(error))
            continue
        if not contents.is_whole:
            lines.append(f"{file.name} is not whole")
        elif not contents.counts:
            lines.append(f"{file.name} holds nothing")
    return lines
