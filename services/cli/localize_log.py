"""Recorded logs to localise on: a CSV file, an MCAP file, or a folder of rosbag2."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.common.config import ConfigError
from services.common.frames import SE2
from services.common.node import messages as msg

COLUMNS = ("time_s", "odom_x_m", "odom_y_m", "odom_yaw_rad")
_RANGE = "range_"
"""Columns range_0, range_1, ... follow, counter-clockwise."""
_MOST_BEAMS = 20_000
_ODOM, _SCAN, _STATIC = "/odom", "/scan", "/tf_static"
_TYPES = {
    _ODOM: "nav_msgs/msg/Odometry",
    _SCAN: "sensor_msgs/msg/LaserScan",
    _STATIC: "tf2_msgs/msg/TFMessage",
}


@dataclass(frozen=True)
class LoggedScan:
    """A scan as `Localization.scan` takes it."""

    ranges_m: NDArray[np.float32]
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    frame_id: str = ""


@dataclass(frozen=True)
class Entry:
    """What the log has at one time: odometry, a scan, or both."""

    stamp_ns: int
    odom_from_base: SE2 | None
    scan: LoggedScan | None


@dataclass
class Log:
    """All entries, the earliest first, and the lidar's pose where the log has it."""

    entries: list[Entry]
    base_from_scan: SE2 | None = None
    frames: dict[str, tuple[str, SE2]] = field(default_factory=dict)


@dataclass(frozen=True)
class ScanForm:
    """What a CSV file does not say of its scans; None: a full turn that starts ahead."""

    angle_min_rad: float
    angle_increment_rad: float | None
    range_min_m: float
    range_max_m: float


def read_log(path: Path, form: ScanForm) -> Log:
    """Read a log by its name: a folder is rosbag2's, *.mcap an MCAP file, all else CSV.

    Raises ConfigError with one line that names file, line or topic, and what is wrong.
    """
    if not path.exists():
        raise ConfigError(f"--log: {path}: no such file")
    if path.is_dir() or path.suffix == ".mcap":
        return _read_bag(path)
    return _read_csv(path, form)


def _read_csv(path: Path, form: ScanForm) -> Log:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            header = next(rows, [])
            beams = _beams_of(path, [name.strip() for name in header])
            entries = list(_csv_entries(path, rows, beams, form))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        said = error.strerror if isinstance(error, OSError) else "must be CSV in UTF-8"
        raise ConfigError(f"--log: {path}: {said}") from error
    if not entries:
        raise ConfigError(f"--log: {path}: has no rows after its header")
    return Log(entries)


def _beams_of(path: Path, header: list[str]) -> int:
    wanted = ",".join(COLUMNS)
    if tuple(header[: len(COLUMNS)]) != COLUMNS:
        raise ConfigError(
            f"--log: {path}:1: header {','.join(header[:4])!r:.80}: must be "
            f"'{wanted},range_0,range_1,...'"
        )
    names = header[len(COLUMNS) :]
    if not 1 <= len(names) <= _MOST_BEAMS:
        raise ConfigError(
            f"--log: {path}:1: {len(names)} columns of ranges: must be 1 to {_MOST_BEAMS}, "
            "range_0 and so on"
        )
    for i, name in enumerate(names):
        if name != f"{_RANGE}{i}":
            raise ConfigError(f"--log: {path}:1: column {name!r:.40}: must be {_RANGE}{i}")
    return len(names)


def _csv_entries(path: Path, rows: Any, beams: int, form: ScanForm) -> Iterator[Entry]:
    last_s = -math.inf
    increment = form.angle_increment_rad
    if increment is None:
        increment = math.tau / beams
    for row in rows:
        if not row:
            continue
        where = f"--log: {path}:{rows.line_num}"
        if len(row) != len(COLUMNS) + beams:
            raise ConfigError(f"{where}: {len(row)} values: must be {len(COLUMNS) + beams}")
        time_s, x_m, y_m, yaw_rad = (
            _number(where, name, text) for name, text in zip(COLUMNS, row, strict=False)
        )
        if time_s <= last_s:
            raise ConfigError(f"{where}: time_s: {row[0]}: must be later than {last_s:g}")
        last_s = time_s
        scan = None
        cells = row[len(COLUMNS) :]
        if any(cell.strip() for cell in cells):
            scan = LoggedScan(
                _ranges(where, cells), form.angle_min_rad, increment, form.range_min_m,
                form.range_max_m,
            )  # fmt: skip
        yield Entry(round(time_s * 1e9), SE2(x_m, y_m, yaw_rad), scan)


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= 1e9:
        raise ConfigError(f"{where}: {name}: {text!r:.40}: must be a finite number")
    return value


def _ranges(where: str, cells: list[str]) -> NDArray[np.float32]:
    try:
        return np.array([float(cell) if cell.strip() else math.inf for cell in cells], np.float32)
    except ValueError:
        wrong = next(i for i, cell in enumerate(cells) if not _is_range(cell))
        raise ConfigError(
            f"{where}: {_RANGE}{wrong}: {cells[wrong]!r:.40}: must be metres, inf or empty"
        ) from None


def _is_range(cell: str) -> bool:
    try:
        float(cell.strip() or "inf")
    except ValueError:
        return False
    return True


def _read_bag(path: Path) -> Log:
    from rosbags.rosbag2 import Reader, ReaderError  # noqa: PLC0415 - for bags alone
    from rosbags.rosbag2.storage_mcap import McapReader  # noqa: PLC0415

    log = Log([])
    seen: set[str] = set()
    try:
        reader: Any = Reader(path) if path.is_dir() else McapReader(path)
        reader.open()
        try:
            wanted = [c for c in reader.connections if c.topic in _TYPES]
            _check_types(path, wanted)
            for connection, _, data in reader.messages(wanted) if wanted else ():
                seen.add(connection.topic)
                _add(log, connection.topic, _decoded(path, connection, bytes(data)))
        finally:
            reader.close()
    except ConfigError:
        raise
    except (ReaderError, OSError, AssertionError, ValueError, KeyError, RuntimeError) as error:
        raise ConfigError(f"--log: {path}: is no MCAP file that can be read: {error}") from error
    for topic in (_ODOM, _SCAN):
        if topic not in seen:
            raise ConfigError(f"--log: {path}: has no {_TYPES[topic]} on {topic}")
    log.entries.sort(key=lambda entry: (entry.stamp_ns, entry.scan is not None))
    frames = {entry.scan.frame_id for entry in log.entries if entry.scan}
    log.base_from_scan = _base_from(log.frames, sorted(frames)[0])
    return log


def _check_types(path: Path, connections: list[Any]) -> None:
    for connection in connections:
        if connection.msgtype != _TYPES[connection.topic]:
            raise ConfigError(
                f"--log: {path}: {connection.topic} is {connection.msgtype}: must be "
                f"{_TYPES[connection.topic]}"
            )


def _decoded(path: Path, connection: Any, data: bytes) -> Any:
    try:
        return msg.TYPESTORE.deserialize_cdr(data, connection.msgtype)
    except Exception as error:
        raise ConfigError(
            f"--log: {path}: a message on {connection.topic} is damaged: {error}"
        ) from error


def _add(log: Log, topic: str, message: Any) -> None:
    if topic == _STATIC:
        for transform in message.transforms:
            matrix = msg.matrix_from_transform(transform.transform)
            log.frames[transform.child_frame_id] = (
                transform.header.frame_id,
                _planar(matrix),
            )
        return
    stamp_ns = msg.ns_from_time(message.header.stamp)
    if topic == _ODOM:
        log.entries.append(Entry(stamp_ns, msg.se2_from_pose(message.pose.pose), None))
        return
    scan = LoggedScan(
        np.asarray(message.ranges, np.float32),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        message.header.frame_id,
    )
    log.entries.append(Entry(stamp_ns, None, scan))


def _base_from(frames: dict[str, tuple[str, SE2]], frame: str) -> SE2 | None:
    """base_footprint or base_link from a frame, by the static transforms; None if unknown."""
    pose, found = SE2(0.0, 0.0, 0.0), False
    for _ in range(16):
        if frame == "base_footprint" or (frame == "base_link" and frame not in frames):
            return pose if found else None
        if frame not in frames:
            return None
        frame, parent_from_frame = frames[frame]
        pose, found = parent_from_frame @ pose, True
    return None


def _planar(matrix: NDArray[np.float64]) -> SE2:
    """The planar part of a rigid (4, 4) matrix."""
    yaw_rad = math.atan2(float(matrix[1, 0]), float(matrix[0, 0]))
    return SE2(float(matrix[0, 3]), float(matrix[1, 3]), yaw_rad)
