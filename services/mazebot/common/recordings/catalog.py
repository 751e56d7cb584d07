"""Lists the runs in a folder of recordings."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic_core import from_json, to_json

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import read_limited
from mazebot.common.recordings.figures import goals_sent
from mazebot.common.recordings.labels import Labels, read_labels
from mazebot.common.recordings.run_folder import (
    LABELS,
    LOCK,
    MESSAGES,
    RECORDING,
    SUMMARY,
    THUMBNAIL,
    is_recording,
    write_atomically,
)

_NAME = re.compile(r"^(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)_(.+?)(?:_(\d+))?$")
INDEX = ".catalog.json"
LATEST = "latest"
"""Names the newest run, wherever a run is named."""
_INDEXED = [
    *("world", "goals_reached", "goals_total", "sim_time_s", "seed", "slam", "error_mean_m"),
    *("goals_sent", "has_end", "messages_received", "messages_recorded"),
    *("error_p95_m", "exploration", "coverage_share", "distance_m", "contacts", "real_time_factor"),
    *("changed_settings", "tags", "note", "problem", "labels_unreadable"),
]
_WORTH_IT = 20
"""Runs read in one listing, for which the index is written again."""
_SETTLED_NS = 2_000_000_000
"""A larger summary is none."""

State = Literal["running", "interrupted", "ended"]


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
    """Those that were sent; while it is being recorded, those that have ended."""
    sim_time_s: float | None
    """None if its summary does not contain it."""
    size_bytes: int
    """Of everything in the folder."""
    recording: Path | None
    """The run.rrd, if there is one."""
    closed: bool
    """Whether its files are; else it is being recorded, or its recorder was killed and the next one
    has yet to repair it or to go on with it.
    """
    state: State = "ended"
    """`interrupted`: its recorder was killed, whether it was repaired or not."""
    seed: int | None = None
    slam: bool = False
    """Whether the robot made the map."""
    error_mean_m: float | None = None
    """Mean localisation error, and"""
    error_p95_m: float | None = None
    """its 95th percentile."""
    exploration: str = ""
    """The explorer's state at the end, such as `complete`; empty: nothing explored."""
    coverage_share: float | None = None
    """Of the floor, mapped by the robot; None if it made no map."""
    distance_m: float | None = None
    contacts: int = 0
    real_time_factor: float | None = None
    changed_settings: Mapping[str, Any] | None = None
    """Settings that are not the defaults, by `service.field`; None: not recorded."""
    tags: tuple[str, ...] = ()
    note: str = ""
    files: tuple[str, ...] = ()
    """Names of the files of the folder itself, sorted; without hidden ones."""
    messages_received: int | None = None
    """What the recorder was to write to run.mcap, and"""
    messages_recorded: int | None = None
    """what it had room for; None: not known yet, or there is to be no such file."""
    problem: str | None = None
    """Why its summary or its labels cannot be read, in one line."""
    labels_unreadable: bool = False

    @property
    def failed(self) -> bool:
        """Whether a goal was not reached, the run was interrupted, or nothing of it can be read;
        where the robot has explored, which gives up goals all the time: whether that was not
        complete.
        """
        if self.state == "interrupted":
            return True
        if self.exploration:
            return self.exploration != "complete"
        return self.goals_reached < self.goals_total or self.problem is not None

    @property
    def gap(self) -> str:
        """What run.mcap lacks, in words; empty: nothing that is known of."""
        received, recorded = self.messages_received, self.messages_recorded
        if received is None or recorded is None or recorded >= received:
            return ""
        return f"{recorded} of {received} messages recorded"

    @property
    def has_thumbnail(self) -> bool:
        """Whether there is a thumbnail.png."""
        return THUMBNAIL in self.files


class _File(NamedTuple):
    """A version of a file: no other one has all of these."""

    size_bytes: int
    modified_ns: int
    inode: int


class _Facts(NamedTuple):
    """What these versions of a run's summary and labels say."""

    versions: tuple[_File | None, _File | None]
    values: Mapping[str, Any]
    """Fields of `RecordingInfo`, as JSON values."""


class Catalog:
    """The runs of one folder. A file is read again only if it is another version: listing thousands
    of runs takes little time, also the first time, since what they say is kept in `INDEX`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._facts: dict[str, _Facts] | None = None

    def runs(self) -> list[RecordingInfo]:
        """The runs, newest first; folders without a run's files are skipped."""
        known = _read_index(self.folder) if self._facts is None else self._facts
        found, facts = [], {}
        read = 0
        for name, files in _run_folders(self.folder):
            path = self.folder / name
            versions = files.get(SUMMARY), files.get(LABELS)
            cached = known.get(name)
            if cached is None or cached.versions != versions:
                cached = _Facts(versions, _read(path, versions))
                read += 1
            facts[name] = cached
            found.append(_info(path, files, cached.values))
        self._facts = facts
        if read >= _WORTH_IT:
            _write_index(self.folder, facts)
        return sorted(found, key=lambda run: (run.started or datetime.min, run.name), reverse=True)  # noqa: DTZ901


def list_recordings(folder: Path) -> list[RecordingInfo]:
    """The runs in a folder, newest first; folders without a run's files are skipped."""
    return Catalog(folder).runs()


def run_at(path: Path) -> RecordingInfo | None:
    """The run in one folder; None if it holds none."""
    files = _files(str(path)) if path.is_dir() else {}
    if not _is_run(files):
        return None
    return _info(path, files, _read(path, (files.get(SUMMARY), files.get(LABELS))))


def find_run(field: str, directory: Path, name: str, holding: str = "") -> RecordingInfo:
    """A run, by its folder, by its name in a folder of recordings, or `latest`: the newest one that
    holds the file `holding`, if one is named.

    Raises ConfigError with one line, which begins with `field`, if there is none.
    """
    if name == LATEST:
        runs = list_recordings(directory)
        latest = next((run for run in runs if not holding or holding in run.files), None)
        if latest is None:
            what = f"run with {holding}" if holding else "run"
            raise ConfigError(f"{field}: no {what} in {directory}; `make demo` creates one")
        return latest
    for folder in (Path(name), directory / name):
        try:
            run = run_at(folder)
        except (OSError, ValueError):
            # For example a name longer than the file system's.
            run = None
        if run is not None:
            return run
    known = ", ".join(sorted(_names(directory), reverse=True)[:3]) or "none"
    raise ConfigError(f"{field}: {name!r:.200}: no such run in {directory}; newest runs: {known}")


def _names(directory: Path) -> Iterator[str]:
    return (name for name, _ in _run_folders(directory))


def _run_folders(folder: Path) -> Iterator[tuple[str, dict[str, _File]]]:
    """Names of the folders that hold a run, each with its files."""
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if entry.is_dir()]
    except OSError:
        return
    for name in names:
        if name.startswith("."):
            continue
        files = _files(os.path.join(folder, name))  # noqa: PTH118 - thousands of them
        if _is_run(files):
            yield name, files


def _is_run(files: Mapping[str, _File]) -> bool:
    return SUMMARY in files or RECORDING in files or LOCK in files or MESSAGES in files


def _files(folder: str) -> dict[str, _File]:
    """All files below a folder, by their paths in it; one that vanishes meanwhile is left out."""
    files: dict[str, _File] = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    inside = _files(entry.path)
                    files |= {f"{entry.name}/{name}": file for name, file in inside.items()}
                elif entry.is_file():
                    stat = entry.stat()
                    files[entry.name] = _File(stat.st_size, stat.st_mtime_ns, stat.st_ino)
    except OSError:
        pass
    return files


def _read(path: Path, versions: tuple[_File | None, _File | None]) -> dict[str, Any]:
    """The fields of `RecordingInfo` that the summary and the labels give."""
    problem = None
    summary: Mapping[str, Any] = {}
    if versions[0] is not None:
        try:
            summary = from_json(read_limited(path / SUMMARY, MAX_DOCUMENT_BYTES))
            if not isinstance(summary, dict):
                raise ValueError("must be an object")
        except (OSError, ValueError, RecursionError) as error:
            summary = {}
            reason = getattr(error, "strerror", None) or str(error)
            problem = f"{SUMMARY}: {reason:.200}"
    labels: Labels | None = Labels()
    if versions[1] is not None:
        try:
            labels = read_labels(path)
        except ConfigError as error:
            problem = problem or str(error).removeprefix(f"{path}{os.sep}")
            labels = None
    goals = summary.get("goals")
    reports = [
        goal
        for goal in (goals if isinstance(goals, list) else ())
        if isinstance(goal, dict) and goal.get("given_up") is not True
    ]
    error_m, mapping = _mapping(summary, "localisation_error_m"), _mapping(summary, "mapping")
    changed = summary.get("changed_settings")
    return {
        "world": str(summary.get("world") or ""),
        "goals_reached": sum(goal.get("reached") is True for goal in reports),
        "goals_total": len(reports),
        "goals_sent": goals_sent(summary),
        **_messages(summary),
        "has_end": summary.get("ended") is not False,
        "sim_time_s": _number(summary, "sim_time_s"),
        "seed": _whole(summary, "seed"),
        "slam": bool(mapping),
        "error_mean_m": _number(error_m, "mean"),
        "error_p95_m": _number(error_m, "p95"),
        "exploration": str(mapping.get("exploration") or ""),
        "coverage_share": _number(mapping, "coverage_share"),
        "distance_m": _number(summary, "distance_m"),
        "contacts": _whole(_mapping(summary, "contacts"), "count") or 0,
        "real_time_factor": _number(summary, "real_time_factor"),
        "changed_settings": {
            name: entry.get("value") if isinstance(entry, dict) else entry
            for name, entry in changed.items()
        }
        if isinstance(changed, dict)
        else None,
        "tags": list(labels.tags) if labels is not None else [],
        "note": labels.note if labels is not None else "",
        "labels_unreadable": labels is None,
        "problem": problem,
    }


def _info(path: Path, files: Mapping[str, _File], values: Mapping[str, Any]) -> RecordingInfo:
    match = _NAME.match(path.name)
    is_locked = LOCK in files
    fields = {
        **values,
        "world": values["world"] or (match[2] if match else ""),
        "tags": tuple(values["tags"]),
    }
    state: State = "ended"
    has_end, sent = fields.pop("has_end"), fields.pop("goals_sent")
    if is_locked or not has_end:
        state = "running" if is_locked and is_recording(path) else "interrupted"
    if state != "running":
        # A goal that was under way at the end was not reached.
        fields["goals_total"] = sent
    if is_locked:
        # What is not written yet is no gap.
        fields |= dict.fromkeys(("messages_received", "messages_recorded"))
    if not is_locked and SUMMARY not in files:
        # One that goes on, or was killed, has none yet.
        fields["problem"] = values["problem"] or f"{SUMMARY}: missing"
    return RecordingInfo(
        name=path.name,
        path=path,
        started=_started(match[1] if match else "", files),
        size_bytes=sum(file.size_bytes for file in files.values()),
        recording=path / RECORDING if RECORDING in files else None,
        closed=not is_locked,
        state=state,
        files=tuple(sorted(name for name in files if "/" not in name and name[0] != ".")),
        **fields,
    )


def _read_index(folder: Path) -> dict[str, _Facts]:
    """What an earlier listing kept; empty if there is nothing of use."""
    try:
        index = from_json(read_limited(folder / INDEX, MAX_DOCUMENT_BYTES))
        if index["fields"] != _INDEXED:
            return {}
        return {
            name: _Facts(
                (
                    None if summary is None else _File(*summary),
                    None if labels is None else _File(*labels),
                ),
                dict(zip(_INDEXED, values, strict=True)),
            )
            for name, (summary, labels, values) in index["runs"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def _write_index(folder: Path, facts: Mapping[str, _Facts]) -> None:
    """Keep what was read, for the next listing. What has just changed may change again within one
    tick of the file system's clock, and is left out.
    """
    newest_ns = time.time_ns() - _SETTLED_NS
    runs = {
        name: (*fact.versions, [fact.values[field] for field in _INDEXED])
        for name, fact in facts.items()
        if all(file is None or file.modified_ns < newest_ns for file in fact.versions)
    }
    # Without it, everything is read the next time.
    with contextlib.suppress(OSError, ValueError):
        text = to_json({"fields": _INDEXED, "runs": runs})
        write_atomically(folder / INDEX, [text], sync=False)


def _mapping(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = values.get(name)
    return value if isinstance(value, dict) else {}


def _messages(summary: Mapping[str, Any]) -> dict[str, int | None]:
    """How many were to be recorded, and were."""
    received, recorded = 0, None
    for row in _mapping(summary, "messages").values():
        written = _whole(row, "recorded") if isinstance(row, dict) else None
        if written is not None:
            recorded = (recorded or 0) + written
            received += max(_whole(row, "received") or 0, written)
    return {
        "messages_received": None if recorded is None else received,
        "messages_recorded": recorded,
    }


def _number(values: Mapping[str, Any], name: str) -> float | None:
    value = values.get(name)
    if not isinstance(value, int | float) or isinstance(value, bool) or abs(value) >= 1e300:
        return None
    return float(value)


def _whole(values: Mapping[str, Any], name: str) -> int | None:
    value = values.get(name)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _started(text: str, files: Mapping[str, _File]) -> datetime | None:
    try:
        # Seven times as fast as strptime.
        date, _, time = text.partition("_")
        return (
            datetime.fromisoformat(f"{date} {time.replace('-', ':')}") if text else _oldest(files)
        )
    except ValueError:
        return _oldest(files)


def _oldest(files: Mapping[str, _File]) -> datetime | None:
    times_ns = [file.modified_ns for file in files.values()]
    return datetime.fromtimestamp(min(times_ns) * 1e-9) if times_ns else None  # noqa: DTZ006
