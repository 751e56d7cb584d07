"""Logs in CSV: a row for each time, with odometry and perhaps a scan."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.logs.headings import IN_DEGREES, first_in_degrees
from mazebot.cli.logs.log import Entry, Log, LoggedScan, ScanForm, Where, growing
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2

COLUMNS = ("time_s", "odom_x_m", "odom_y_m", "odom_yaw_rad")
_RANGE = "range_"
"""Columns range_0, range_1, ... follow, counter-clockwise."""
_MOST_BEAMS = 20_000
_RANGES_M = (0.12, 3.5)


def read(path: Path, lines: Iterable[str], form: ScanForm) -> Log:
    """Read a log in CSV; without a word in `form`, a scan is a full turn that starts ahead.

    Raises ConfigError with one line that names file, line and column, and what is wrong.
    """
    rows = csv.reader(lines)
    try:
        header = next(rows, [])
        beams = _beams_of(path, [name.strip() for name in header])
        entries = list(_entries(path, rows, beams, form))
    except csv.Error as error:
        raise ConfigError(f"--log: {path}: must be CSV in UTF-8") from error
    if not entries:
        raise ConfigError(f"--log: {path}: has no rows after its header")
    poses = np.array([pose for _, pose, _ in entries])
    wrong = first_in_degrees(poses)
    if wrong is not None:
        raise ConfigError(
            f"--log: {path}: {COLUMNS[3]}: {poses[wrong, 2]:g} at {COLUMNS[0]} "
            f"{entries[wrong][0]:g}: {IN_DEGREES}"
        )
    times_s, made_up = growing([time_s for time_s, _, _ in entries])
    return Log(
        [
            Entry(round(time_s * 1e9), odom_from_base, scan)
            for time_s, (_, odom_from_base, scan) in zip(times_s, entries, strict=True)
        ],
        retimed=min(made_up, sum(scan is not None for _, _, scan in entries)),
    )


def _beams_of(path: Path, header: list[str]) -> int:
    wanted = ",".join(COLUMNS)
    where = Where(path)
    if tuple(header[: len(COLUMNS)]) != COLUMNS:
        raise where.wrong(
            f"header {','.join(header[:4])!r:.80}: must be '{wanted},range_0,range_1,...', "
            "or lines of CARMEN: FLASER or ROBOTLASER1"
        )
    names = header[len(COLUMNS) :]
    if not 1 <= len(names) <= _MOST_BEAMS:
        raise where.wrong(
            f"{len(names)} columns of ranges: must be 1 to {_MOST_BEAMS}, range_0 and so on"
        )
    for i, name in enumerate(names):
        if name != f"{_RANGE}{i}":
            raise where.wrong(f"column {name!r:.40}: must be {_RANGE}{i}")
    return len(names)


def _entries(
    path: Path, rows: Any, beams: int, form: ScanForm
) -> Iterator[tuple[float, SE2, LoggedScan | None]]:
    increment = form.angle_increment_rad
    if increment is None:
        increment = math.tau / beams
    angle_min = form.angle_min_rad or 0.0
    range_min, range_max = form.ranges_m(*_RANGES_M)
    where = Where(path)
    for row in rows:
        if not row:
            continue
        where.line = rows.line_num
        if len(row) != len(COLUMNS) + beams:
            raise where.wrong(f"{len(row)} values: must be {len(COLUMNS) + beams}")
        time_s, x_m, y_m, yaw_rad = (
            _number(where, name, text) for name, text in zip(COLUMNS, row, strict=False)
        )
        scan = None
        cells = row[len(COLUMNS) :]
        if any(cell.strip() for cell in cells):
            ranges_m = _ranges(where, cells)
            scan = LoggedScan(ranges_m, angle_min, increment, range_min, range_max)
        yield time_s, SE2(x_m, y_m, yaw_rad), scan


def _number(where: Where, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= 1e10:
        raise where.wrong(f"{name}: {text!r:.40}: must be a finite number")
    return value


def _ranges(where: Where, cells: list[str]) -> NDArray[np.float32]:
    try:
        return np.array([float(cell) if cell.strip() else math.inf for cell in cells], np.float32)
    except ValueError:
        wrong = next(i for i, cell in enumerate(cells) if not _is_range(cell))
        raise where.wrong(
            f"{_RANGE}{wrong}: {cells[wrong]!r:.40}: must be metres, inf or empty"
        ) from None


def _is_range(cell: str) -> bool:
    try:
        float(cell.strip() or "inf")
    except ValueError:
        return False
    return True
