"""How far the lidars of a log see, by what returned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mazebot.cli.logs.log import Entry, Log, LoggedScan, Reach

_FAR_BEYOND = 2.0
"""A range_max of more than so many times the longest return is not what the lidar sees."""


@dataclass
class _Seen:
    """The scans of one lidar."""

    longest_m: float = 0.0
    """The longest return; 0: there is none."""
    stated_m: float = 0.0
    """The largest range_max."""
    has_misses: bool = False

    def add(self, scan: LoggedScan) -> None:
        ranges_m = scan.ranges_m
        returned = (ranges_m >= scan.range_min_m) & (ranges_m > 0.0) & (ranges_m < scan.range_max_m)
        self.longest_m = max(self.longest_m, float(ranges_m.max(initial=0.0, where=returned)))
        self.stated_m = max(self.stated_m, scan.range_max_m)
        self.has_misses |= bool((ranges_m >= scan.range_max_m).any())

    @property
    def is_short(self) -> bool:
        """Whether beams without a return tell less than range_max says."""
        return self.has_misses and self.stated_m > _FAR_BEYOND * self.longest_m > 0.0


def with_reach(log: Log) -> Log:
    """The log, with the longest return as range_max of lidars that state far more and have beams
    without a return: how far those were free is not known, and walls would stand in free space.
    """
    lidars: dict[str, _Seen] = {}
    for entry in log.entries:
        if entry.scan is not None:
            lidars.setdefault(entry.scan.frame_id, _Seen()).add(entry.scan)
    short = {frame: seen for frame, seen in lidars.items() if seen.is_short}
    return replace(
        log,
        entries=[_limited(entry, short) for entry in log.entries],
        reaches=tuple(Reach(seen.longest_m, f"{seen.stated_m:g}") for seen in short.values()),
        no_returns=_no_returns(log, lidars.values()),
    )


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
