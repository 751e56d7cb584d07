"""How far the lidars of a log see, by what returned, and which of their beams drop out."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.logs.log import Entry, Log, LoggedScan, Reach

_FAR_BEYOND = 2.0
"""A range_max of more than so many times the longest return is not what the lidar sees."""
_CODE_SHARE, _CODE_BEAMS, _CODE_READINGS = 0.01, 10, 300
"""The longest range is a code, and nothing measured, if such a share of all readings, in so many of
the beams, and so many of all, are the very same: what is measured differs.
"""
_HOLE_M = 0.3
"""Returns nearer to each other have no opening between them through which a lidar sees the room
behind: beams without a return there dropped out.
"""
_MANY_HOLES = 0.1
"""Of all beams: more than drop out beside edges. In logs of SICK's lidars it is 0.01 to 0.02, with
a fifth of their range 0.06.
"""
_CODE_TURNS = 2.0
"""It comes in so many times as many beams as in one scan: a robot that stands measures the same."""


@dataclass
class _Seen:
    """The scans of one lidar."""

    longest_m: float = 0.0
    """The longest return; 0: there is none."""
    stated_m: float = 0.0
    """The largest range_max."""
    has_misses: bool = False
    readings: int = 0
    longest: int = 0
    """Readings that are the longest return."""
    scans: int = 0
    """Scans that have it."""
    beams: set[int] = field(default_factory=set)
    """Which have it."""

    def add(self, scan: LoggedScan) -> None:
        ranges_m = scan.ranges_m
        returned = (ranges_m >= scan.range_min_m) & (ranges_m > 0.0) & (ranges_m < scan.range_max_m)
        longest_m = float(ranges_m.max(initial=0.0, where=returned))
        if longest_m > self.longest_m:
            self.longest_m, self.longest, self.scans, self.beams = longest_m, 0, 0, set()
        if longest_m == self.longest_m > 0.0:
            these = np.flatnonzero(returned & (ranges_m == longest_m))
            self.longest += len(these)
            self.scans += 1
            self.beams.update(these.tolist())
        self.readings += len(ranges_m)
        self.stated_m = max(self.stated_m, scan.range_max_m)
        self.has_misses |= bool((ranges_m >= scan.range_max_m).any())

    @property
    def has_code(self) -> bool:
        """Whether the longest return is a code of no return."""
        least = max(_CODE_SHARE * self.readings, _CODE_READINGS)
        beams = max(_CODE_BEAMS, _CODE_TURNS * self.longest / max(self.scans, 1))
        return self.longest >= least and len(self.beams) >= beams

    @property
    def is_short(self) -> bool:
        """Whether beams without a return tell less than range_max says."""
        return self.has_misses and self.stated_m > _FAR_BEYOND * self.longest_m > 0.0


def with_reach(log: Log) -> Log:
    """The log, with NaN in place of a code of no return below range_max, and with the longest
    return as range_max of lidars that state far more and have beams without a return: how far those
    were free is not known, and walls would stand in free space.
    """
    lidars = _lidars(log)
    coded = {frame: seen.longest_m for frame, seen in lidars.items() if seen.has_code}
    if coded:
        entries = [_without_code(entry, coded) for entry in log.entries]
        log = replace(log, entries=entries, codes_m=tuple(coded.values()))
        lidars = _lidars(log)
    short = {frame: seen for frame, seen in lidars.items() if seen.is_short}
    return replace(
        log,
        entries=[_limited(entry, short) for entry in log.entries],
        reaches=tuple(Reach(seen.longest_m, f"{seen.stated_m:g}") for seen in short.values()),
        no_returns=_no_returns(log, lidars.values()),
    )


def without_dropouts(log: Log) -> Log:
    """The log, with NaN in place of beams that dropped out, of lidars of which many do: there is a
    wall where they would show free space.
    """
    shares = {
        frame: sum(int(dropouts(scan).sum()) for _, scan in scans)
        / max(1, sum(len(scan.ranges_m) for _, scan in scans))
        for frame, scans in log.scans_by_lidar().items()
    }
    many = {frame: share for frame, share in shares.items() if share >= _MANY_HOLES}
    if not many:
        return log
    entries = [_without_dropouts(entry, many) for entry in log.entries]
    return replace(log, entries=entries, dropouts=tuple(many.values()))


def _without_dropouts(entry: Entry, lidars: Container[str]) -> Entry:
    scan = entry.scan
    if scan is None or scan.frame_id not in lidars:
        return entry
    measured = np.where(dropouts(scan), np.float32(np.nan), scan.ranges_m)
    return replace(entry, scan=replace(scan, ranges_m=measured))


def dropouts(scan: LoggedScan) -> NDArray[np.bool_]:
    """(n,) whether a beam has no return and lies in a gap, between two that have one, that is one
    beam wide or too narrow to be an opening.
    """
    ranges_m = scan.ranges_m
    returned = (ranges_m >= scan.range_min_m) & (ranges_m > 0.0) & (ranges_m < scan.range_max_m)
    at = np.flatnonzero(returned)
    beams = np.diff(at)
    nearer_m = np.minimum(ranges_m[at[:-1]], ranges_m[at[1:]])
    narrow = (beams * abs(scan.angle_increment_rad) * nearer_m <= _HOLE_M) | (beams == 2)
    inside = np.zeros(len(ranges_m), np.bool_)
    if len(at) > 1:
        inside[at[0] : at[-1]] = np.repeat(narrow, beams)
    return inside & (ranges_m >= scan.range_max_m)


def _lidars(log: Log) -> dict[str, _Seen]:
    """What was seen, by the frame of each lidar."""
    lidars = {}
    for frame, scans in log.scans_by_lidar().items():
        seen = lidars[frame] = _Seen()
        for _, scan in scans:
            seen.add(scan)
    return lidars


def _without_code(entry: Entry, coded: Mapping[str, float]) -> Entry:
    if entry.scan is None or entry.scan.frame_id not in coded:
        return entry
    ranges_m = entry.scan.ranges_m
    measured = np.where(ranges_m == coded[entry.scan.frame_id], np.float32(np.nan), ranges_m)
    return replace(entry, scan=replace(entry.scan, ranges_m=measured))


def _no_returns(log: Log, lidars: Iterable[_Seen]) -> str:
    """What to say of scans without any return; empty: there are returns, or no scans."""
    if not log.scans or any(seen.longest_m for seen in lidars):
        return ""
    scan = next(entry.scan for entry in log.entries if entry.scan is not None)
    return (
        f"none of {log.scans} scans has a return: no range is >= range_min, "
        f"{scan.range_min_m:g} m, and < range_max, {scan.range_max_m:g} m"
    )


def _limited(entry: Entry, short: dict[str, _Seen]) -> Entry:
    if entry.scan is None or entry.scan.frame_id not in short:
        return entry
    # Ranges of range_max and more are no returns.
    beyond_m = float(np.nextafter(np.float32(short[entry.scan.frame_id].longest_m), np.inf))
    return replace(
        entry, scan=replace(entry.scan, range_max_m=min(entry.scan.range_max_m, beyond_m))
    )
