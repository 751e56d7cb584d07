"""Whether the files of a run are whole, and of one run: a copy may be cut, or mixed up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mazebot.common.config import ConfigError
from mazebot.common.recordings.comparing.digests import DigestError, read_digests
from mazebot.common.recordings.mcap.mcap_counts import counts_of
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import (
    DIGESTS,
    LOCK,
    MESSAGES,
    RECORDING,
    SUMMARY,
    part_path,
    parts_of,
)
from mazebot.common.recordings.run_settings import read_summary

ABOUT = "mazebot"
"""Name of a metadata record in the MCAP files of a run: its name, world and seed."""
IS_CUT = "is cut"
_TAIL_S = 1.0
"""At the end of a run so much may not have come to its recorder."""
_RRD_BEGIN, _RRD_END = b"RRF", b"FOOT"
"""Rerun's files begin with the first, and the last bytes of those that were closed hold the second
(re_log_encoding's StreamHeader and StreamFooter of Rerun 0.28 and later).
"""
_RRD_END_BYTES = 12


def faults(folder: Path) -> tuple[str, ...]:
    """What the files of a run lack, or have of another run, a line each; empty: nothing that is
    known of, or it goes on, or is yet to be repaired.
    """
    return (*message_faults(folder), *_digest_faults(folder))


def message_faults(folder: Path) -> tuple[str, ...]:
    """As `faults`, of its run.mcap and the parts that follow."""
    parts = parts_of(folder, MESSAGES)
    if (folder / LOCK).exists() or not parts:
        return ()
    summary = _summary(folder)
    found = list(_missing(folder, parts))
    counts: Counter[str] = Counter()
    for part in parts:
        found += _faults_of_part(part, summary, counts)
    recorded = _recorded(summary)
    if counts.total() < recorded:
        found.append(f"{counts.total()} of {recorded} recorded messages are there")
    return tuple(found)


def recording_faults(folder: Path) -> tuple[str, ...]:
    """As `faults`, of its run.rrd and the parts that follow, which the viewer shows."""
    if (folder / LOCK).exists():
        return ()
    found = ((part, recording_fault(part)) for part in parts_of(folder, RECORDING))
    return tuple(f"{part.name} {fault}" for part, fault in found if fault)


def recording_fault(file: Path) -> str:
    """What is wrong with a recording of Rerun, in a phrase; empty: it was written to its end."""
    try:
        with file.open("rb") as content:
            begin = content.read(len(_RRD_BEGIN))
            content.seek(max(0, file.stat().st_size - _RRD_END_BYTES))
            end = content.read()
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if not begin:
        return "is empty"
    if begin != _RRD_BEGIN:
        return "is no recording of Rerun"
    return "" if _RRD_END in end else IS_CUT


def faults_of_file(path: Path) -> tuple[str, ...]:
    """As `message_faults`, of one file, which may be by itself."""
    folder = path.parent
    is_of_run = path in parts_of(folder, MESSAGES)
    if is_of_run and (folder / LOCK).exists():
        return ()
    return tuple(_faults_of_part(path, _summary(folder) if is_of_run else {}, Counter()))


def _missing(folder: Path, parts: Sequence[Path]) -> Iterator[str]:
    """The parts before the last one that are not there."""
    left, number = set(parts), 1
    while left:
        part = part_path(folder, MESSAGES, number)
        if part not in left:
            yield f"{part.name} is missing"
        left.discard(part)
        number += 1


def _faults_of_part(part: Path, summary: Mapping[str, Any], counts: Counter[str]) -> Iterator[str]:
    """What one file lacks, or has of another run; its messages are added to `counts`."""
    try:
        contents = scan(part)
    except McapError:
        yield f"{part.name} is no MCAP file"
        return
    except OSError as error:
        yield f"{part.name}: {error.strerror}"
        return
    counts += counts_of(contents)
    about = contents.texts.get(ABOUT, {})
    said = {
        "run": Path(str(summary.get("recording") or "")).name,
        "world": str(summary.get("world") or ""),
        "seed": str(summary.get("seed", "")),
    }
    for what, value in said.items():
        if value and about.get(what, value) != value:
            was = f"{what} {about[what]!r:.80}"
            yield f"{part.name} is of another run: {was}, by {SUMMARY} {value!r:.80}"
            break
    if not contents.is_whole:
        yield f"{part.name} {IS_CUT}"


def _digest_faults(folder: Path) -> Iterator[str]:
    end_s = _summary(folder).get("sim_time_s")
    if (folder / LOCK).exists() or not isinstance(end_s, int | float):
        return
    try:
        times_ns = read_digests(folder / DIGESTS).rows["time_ns"]
    except (DigestError, OSError):
        # Said by who reads them.
        return
    last_s = int(times_ns.max(initial=0)) * 1e-9
    if abs(last_s - end_s) > _TAIL_S:
        yield f"{DIGESTS} ends at {last_s:.3f} s, the run by {SUMMARY} at {end_s:.3f} s"


def _summary(folder: Path) -> dict[str, Any]:
    """Empty where there is none that can be read: who lists the run says so."""
    try:
        return read_summary(folder)
    except ConfigError:
        return {}


def _recorded(summary: Mapping[str, Any]) -> int:
    """How many messages the recorder has written; 0: not known."""
    messages = summary.get("messages")
    rows = messages.values() if isinstance(messages, dict) else ()
    counts = [row.get("recorded") for row in rows if isinstance(row, dict)]
    return sum(count for count in counts if isinstance(count, int))
