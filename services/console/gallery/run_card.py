"""What the gallery knows of one run, read from the files in its folder."""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from services.common.recordings.run_folder import (
    LABELS,
    LOCK,
    MESSAGES,
    RECORDING,
    REPORT,
    SERIES,
    SUMMARY,
    THUMBNAIL,
)

State = Literal["running", "complete", "killed"]
Result = Literal["reached", "failed", "none"]

_NAME = re.compile(r"^(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)_(.+?)(?:_(\d+))?$")
_MOST_SUMMARY_BYTES = 32 * 1024 * 1024


@dataclass(frozen=True)
class RunCard:
    """One run, as its card shows it; a figure that was not measured is None."""

    name: str
    """Of its folder."""
    world: str
    seed: int | None
    slam: bool
    started: datetime | None
    """Local time."""
    state: State
    goals_reached: int
    goals_sent: int
    sim_time_s: float | None
    wall_time_s: float | None
    real_time_factor: float | None
    distance_m: float | None
    error_mean_m: float | None
    error_max_m: float | None
    """Of the localisation."""
    contacts: int | None
    size_bytes: int
    """Of all its files."""
    thumbnail: int
    """Time of its change, ns; 0: there is none."""
    has: frozenset[str]
    """Names of the files of a run that exist."""
    changed: tuple[tuple[str, str], ...]
    """Name and value of each setting that is not the default."""
    tags: tuple[str, ...]
    note: str
    problem: str
    """Why its summary cannot be read; empty: it can."""

    @property
    def result(self) -> Result:
        """Whether all goals were reached."""
        if self.goals_sent == 0:
            return "none"
        return "reached" if self.goals_reached == self.goals_sent else "failed"

    @property
    def error_mm(self) -> str:
        """The mean localisation error for people."""
        return "-" if self.error_mean_m is None else f"{1000.0 * self.error_mean_m:.0f} mm"


KNOWN_FILES = (RECORDING, MESSAGES, REPORT, SERIES, SUMMARY, THUMBNAIL)


def is_run(folder: Path) -> bool:
    """Whether a folder holds a run's files."""
    return any((folder / name).exists() for name in (SUMMARY, RECORDING, LOCK, MESSAGES))


def read_card(folder: Path) -> RunCard:
    """The card of a run. What cannot be read is left out, and told in `problem`."""
    summary, problem = _read_json(folder / SUMMARY)
    labels, _ = _read_json(folder / LABELS)
    match = _NAME.match(folder.name)
    sizes, changed_ns = _files(folder)
    goals = summary.get("goals")
    reports = [goal for goal in goals if isinstance(goal, dict)] if isinstance(goals, list) else []
    reached = sum(goal.get("reached") is True for goal in reports)
    sent = _whole(summary.get("goals_sent"))
    error = _mapping(summary.get("localisation_error_m"))
    tags = labels.get("tags")
    return RunCard(
        name=folder.name,
        world=str(summary.get("world") or (match[2] if match else folder.name)),
        seed=_whole(summary.get("seed")),
        slam=isinstance(summary.get("mapping"), dict),
        started=_started(match[1] if match else "", changed_ns),
        state=state_of(folder),
        goals_reached=reached,
        goals_sent=len(reports) if sent is None else max(sent, len(reports)),
        sim_time_s=_number(summary.get("sim_time_s")),
        wall_time_s=_number(summary.get("wall_time_s")),
        real_time_factor=_number(summary.get("real_time_factor")),
        distance_m=_number(summary.get("distance_m")),
        error_mean_m=_number(error.get("mean")),
        error_max_m=_number(error.get("max")),
        contacts=_whole(_mapping(summary.get("contacts")).get("count")),
        size_bytes=sum(sizes.values()),
        thumbnail=changed_ns.get(THUMBNAIL, 0),
        has=frozenset(name for name in KNOWN_FILES if name in sizes),
        changed=_changed(_mapping(summary.get("changed_settings"))),
        tags=tuple(map(str, tags)) if isinstance(tags, list) else (),
        note=str(labels.get("note") or ""),
        problem=problem,
    )


def state_of(folder: Path) -> State:
    """Whether a run is being recorded, has ended, or its recorder was killed."""
    try:
        lock = os.open(folder / LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return "complete"
    except OSError:
        return "running"
    try:
        # Its recorder keeps it locked. Shared, so that two who look do not see each other.
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return "running"
    else:
        return "killed"
    finally:
        os.close(lock)


def _files(folder: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Size, and time of change in ns, of each file below a folder; names are relative to it."""
    sizes: dict[str, int] = {}
    changed_ns: dict[str, int] = {}
    waiting = [("", str(folder))]
    while waiting:
        prefix, path = waiting.pop()
        try:
            with os.scandir(path) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append((f"{prefix}{entry.name}/", entry.path))
                    elif entry.is_file(follow_symlinks=False):
                        state = entry.stat(follow_symlinks=False)
                        sizes[prefix + entry.name] = state.st_size
                        changed_ns[prefix + entry.name] = state.st_mtime_ns
        except OSError:
            # Removed meanwhile, or not readable.
            continue
    return sizes, changed_ns


def visible_files(folder: Path) -> dict[str, int]:
    """The size of each file that can be downloaded, by its path in the folder, in order."""
    sizes, _ = _files(folder)
    shown = {
        name: size
        for name, size in sizes.items()
        if not any(part.startswith(".") for part in name.split("/"))
    }
    return dict(sorted(shown.items(), key=lambda one: ("/" in one[0], one[0])))


def read_summary(folder: Path) -> dict[str, Any]:
    """The summary of a run; empty if it cannot be read."""
    return _read_json(folder / SUMMARY)[0]


def _read_json(path: Path) -> tuple[dict[str, Any], str]:
    """The object in a file and an empty text, or an empty one and the reason."""
    try:
        if path.stat().st_size > _MOST_SUMMARY_BYTES:
            return {}, f"{path.name} is too large"
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        return {}, f"{path.name} is missing"
    except OSError as error:
        return {}, f"{path.name}: {error.strerror}"
    except (ValueError, RecursionError):
        return {}, f"{path.name} is not JSON"
    return (content, "") if isinstance(content, dict) else ({}, f"{path.name} is no JSON object")


def _changed(settings: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (name, in_words(_mapping(setting).get("value"))) for name, setting in settings.items()
    )


def in_words(value: object) -> str:
    """A setting's value for people."""
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value)


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _started(text: str, changed_ns: Mapping[str, int]) -> datetime | None:
    """The time in the folder's name, or else that of its oldest file."""
    try:
        return datetime.strptime(text, "%Y-%m-%d_%H-%M-%S")  # noqa: DTZ007 - local, as written
    except ValueError:
        oldest = min(changed_ns.values(), default=None)
        return None if oldest is None else datetime.fromtimestamp(oldest / 1e9)  # noqa: DTZ006
