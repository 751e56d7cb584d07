"""Lists the runs in a folder of recordings."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from services.common.recordings.run_folder import LOCK, RECORDING, SUMMARY

_NAME = re.compile(r"^(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)_(.+?)(?:_(\d+))?$")


@dataclass(frozen=True)
class RecordingInfo:
    """One run."""

    name: str
    """Name of its folder."""
    path: Path
    world: str
    started: datetime | None
    """Local time, from the folder's name, or else from its oldest file."""
    goals_reached: int
    goals_total: int
    sim_time_s: float | None
    """None if its summary does not contain it."""
    size_bytes: int
    """Of everything in the folder."""
    recording: Path | None
    """The run.rrd, if there is one."""
    closed: bool
    """Whether the run was ended; else it is being recorded, or its recorder was killed."""


def list_recordings(folder: Path) -> list[RecordingInfo]:
    """The runs in a folder, newest first; folders without a run's files are skipped."""
    if not folder.is_dir():
        return []
    runs = [
        _read(path)
        for path in folder.iterdir()
        if path.is_dir() and any((path / name).exists() for name in (SUMMARY, RECORDING, LOCK))
    ]
    return sorted(runs, key=lambda run: (run.started or datetime.min, run.name), reverse=True)  # noqa: DTZ901


def _read(path: Path) -> RecordingInfo:
    summary = _read_summary(path / SUMMARY)
    match = _NAME.match(path.name)
    goals = summary.get("goals")
    reports = [goal for goal in goals if isinstance(goal, dict)] if isinstance(goals, list) else []
    sim_time_s = summary.get("sim_time_s")
    files = [file for file in path.rglob("*") if file.is_file()]
    recording = path / RECORDING
    return RecordingInfo(
        name=path.name,
        path=path,
        world=str(summary.get("world") or (match[2] if match else "")),
        started=_started(match[1] if match else "", files),
        goals_reached=sum(goal.get("reached") is True for goal in reports),
        goals_total=len(reports),
        sim_time_s=float(sim_time_s) if isinstance(sim_time_s, int | float) else None,
        size_bytes=sum(file.stat().st_size for file in files),
        recording=recording if recording.is_file() else None,
        closed=not (path / LOCK).exists(),
    )


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return summary if isinstance(summary, dict) else {}


def _started(text: str, files: list[Path]) -> datetime | None:
    try:
        return datetime.strptime(text, "%Y-%m-%d_%H-%M-%S")  # noqa: DTZ007 - local, as written
    except ValueError:
        times = [file.stat().st_mtime for file in files]
        return datetime.fromtimestamp(min(times)) if times else None  # noqa: DTZ006
