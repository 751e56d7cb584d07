"""Reads a recorded log; its content determines the format."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, cast

from mazebot.cli.logs import carmen, csv_file
from mazebot.cli.logs.jumps import without_jumps
from mazebot.cli.logs.log import Log, ScanForm, Topics
from mazebot.cli.logs.reach import with_reach, without_dropouts
from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_LINE_BYTES
from mazebot.common.files.reading import NotReadableError, most_unpacked, open_regular, reason

_GZIP = b"\x1f\x8b"
_BAGS = (b"\x89MCAP", b"SQLite format 3\0", b"#ROSBAG V")
_BAG_ENDINGS = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
_BEGIN_BYTES = 65_536
FORMATS = (
    "a CSV file with the header time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,..., a log "
    "of CARMEN with FLASER or ROBOTLASER1 lines, an MCAP or .db3 file or a folder of rosbag2, a "
    ".bag of ROS 1"
)


def read_log(
    path: Path, form: ScanForm, topics: Topics | None = None, odom_scale: float = 1.0
) -> Log:
    """Read a log: a bag; CARMEN's lines or CSV, also gzipped. x and y of odometry are multiplied by
    `odom_scale`, to be metres.

    Raises ConfigError with one line that names file, line or topic, and what is wrong.
    """
    log = _within_a_turn(path, _read(path, form, topics or Topics()))
    log = without_dropouts(with_reach(log))
    return without_jumps(path, log if odom_scale == 1.0 else log.with_odometry_scaled(odom_scale))


def _within_a_turn(path: Path, log: Log) -> Log:
    """The log without scans whose beams go round more than once: they are given in degrees.

    Raises ConfigError where all do.
    """
    from mazebot.common.messages.scan import MOST_TURNS, turns_of  # noqa: PLC0415 - loads Numba

    entries, beyond = [], None
    for entry in log.entries:
        scan = entry.scan
        if scan and turns_of(scan.angle_increment_rad, len(scan.ranges_m)) > MOST_TURNS:
            beyond = scan
            entry = replace(entry, scan=None)  # noqa: PLW2901 - its odometry stays
        entries.append(entry)
    if beyond is None:
        return log
    increment_rad, beams = abs(beyond.angle_increment_rad), len(beyond.ranges_m)
    left = replace(
        log,
        entries=entries,
        over_a_turn=log.scans - sum(entry.scan is not None for entry in entries),
    )
    if not left.scans:
        raise ConfigError(
            f"--log: {path}: angle_increment {increment_rad:g} x {beams} beams is "
            f"{turns_of(increment_rad, beams):.3g} turns: must be radians, and at most a turn"
        )
    return left


def _read(path: Path, form: ScanForm, topics: Topics) -> Log:
    if not path.exists():
        raise ConfigError(f"--log: {path}: no such file")
    if path.is_dir():
        return _read_bag(path, form, topics)
    begin = _begin(path)
    if begin.startswith(_BAGS) or path.name.endswith(_BAG_ENDINGS):
        return _read_bag(path, form, topics)
    if begin.startswith(_GZIP):
        begin, packed = _unpacked(path, begin), True
    else:
        packed = False
    if b"\0" in begin:
        raise ConfigError(f"--log: {path}: must be {FORMATS}")
    if topics.are_given:
        raise ConfigError(
            f"--scan-topic and --odom-topic: {path} has no topics: must be given with a bag"
        )
    reader = carmen.read if carmen.is_carmen(begin.decode("utf-8", "replace")) else csv_file.read
    with open_regular(path) as file:
        content = cast(IO[bytes], gzip.GzipFile(fileobj=file)) if packed else file
        lines = _lines(path, content, most_unpacked(file) if packed else None)
        return reader(path, lines, form)


def _read_bag(path: Path, form: ScanForm, topics: Topics) -> Log:
    from mazebot.cli.logs import bag  # noqa: PLC0415 - loads rosbags, for bags alone

    return bag.read(path, form, topics)


def _begin(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read(_BEGIN_BYTES)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"--log: {path}: {reason(error)}") from error


def _unpacked(path: Path, begin: bytes) -> bytes:
    try:
        return zlib.decompressobj(wbits=31).decompress(begin, _BEGIN_BYTES)
    except zlib.error as error:
        raise ConfigError(f"--log: {path}: is a corrupt gzip file") from error


def _lines(path: Path, file: IO[bytes], most: int | None) -> Iterator[str]:
    """The lines of a log, of at most so many bytes."""
    number, size = 0, 0
    try:
        while line := file.readline(MAX_LINE_BYTES + 1):
            number += 1
            size += len(line)
            if len(line) > MAX_LINE_BYTES:
                raise ConfigError(
                    f"--log: {path}:{number}: the line must have at most {MAX_LINE_BYTES} bytes"
                )
            if most is not None and size > most:
                raise ConfigError(f"--log: {path}: must unpack to at most {most} bytes")
            # Also those that end with a carriage return alone.
            for one in line.splitlines(keepends=True):
                yield one.decode("utf-8", "replace")
    except EOFError as error:
        raise ConfigError(f"--log: {path}: is a truncated gzip file") from error
    except (OSError, zlib.error) as error:
        raise ConfigError(f"--log: {path}: cannot be read completely: {error}") from error
