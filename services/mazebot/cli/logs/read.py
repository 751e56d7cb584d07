"""Reads a recorded log; its content determines the format."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from mazebot.cli.logs import carmen, csv_file
from mazebot.cli.logs.log import Log, ScanForm, Topics
from mazebot.common.config import ConfigError

_MCAP, _GZIP, _SQLITE, _ROSBAG_1 = b"\x89MCAP", b"\x1f\x8b", b"SQLite format 3\0", b"#ROSBAG V"
_BEGIN_BYTES = 65_536
FORMATS = (
    "a CSV file with the header time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,..., a log "
    "of CARMEN with FLASER or ROBOTLASER1 lines, an MCAP file or a folder of rosbag2"
)


def read_log(path: Path, form: ScanForm, topics: Topics | None = None) -> Log:
    """Read a log: a folder is rosbag2's; an MCAP file, CARMEN's lines or CSV, the two also gzipped.

    Raises ConfigError with one line that names file, line or topic, and what is wrong.
    """
    if not path.exists():
        raise ConfigError(f"--log: {path}: no such file")
    if path.is_dir():
        return _read_bag(path, topics)
    begin = _begin(path)
    if begin.startswith(_MCAP) or path.suffix == ".mcap":
        return _read_bag(path, topics)
    if begin.startswith(_SQLITE):
        raise ConfigError(
            f"--log: {path}: is one file of rosbag2: must be the folder that contains it"
        )
    if begin.startswith(_ROSBAG_1):
        raise ConfigError(
            f"--log: {path}: is a bag of ROS 1: must be converted to rosbag2, for example "
            "by rosbags-convert"
        )
    if begin.startswith(_GZIP):
        begin, packed = _unpacked(path, begin), True
    else:
        packed = False
    if b"\0" in begin:
        raise ConfigError(f"--log: {path}: must be {FORMATS}")
    reader = carmen.read if carmen.is_carmen(begin.decode("utf-8", "replace")) else csv_file.read
    with path.open("rb") as file:
        lines = _lines(path, cast(IO[bytes], gzip.GzipFile(fileobj=file)) if packed else file)
        return reader(path, lines, form)


def _read_bag(path: Path, topics: Topics | None) -> Log:
    from mazebot.cli.logs import bag  # noqa: PLC0415 - loads rosbags, for bags alone

    return bag.read(path, topics or Topics())


def _begin(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_BEGIN_BYTES)
    except OSError as error:
        raise ConfigError(f"--log: {path}: {error.strerror}") from error


def _unpacked(path: Path, begin: bytes) -> bytes:
    try:
        return zlib.decompressobj(wbits=31).decompress(begin, _BEGIN_BYTES)
    except zlib.error as error:
        raise ConfigError(f"--log: {path}: is a corrupt gzip file") from error


def _lines(path: Path, file: IO[bytes]) -> Iterator[str]:
    try:
        for line in file:
            yield line.decode("utf-8", "replace")
    except EOFError as error:
        raise ConfigError(f"--log: {path}: is a truncated gzip file") from error
    except (OSError, zlib.error) as error:
        raise ConfigError(f"--log: {path}: cannot be read completely: {error}") from error
