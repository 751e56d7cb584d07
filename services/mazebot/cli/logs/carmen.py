"""Logs of CARMEN, as most of the public ones of robots with a SICK scanner are.

A line holds a message: FLASER and ROBOTLASER1 a scan with the laser's and the robot's pose in
odometry, RAWLASER1 a scan alone, ODOM odometry alone. Those of one kind are used, of the lidar in
front: RLASER and ROBOTLASER2 are of one behind. What FLASER does not say follows CARMEN's
readlog.c.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.logs.headings import IN_DEGREES, first_in_degrees
from mazebot.cli.logs.log import CLOCK_SET_S, Entry, Log, LoggedScan, ScanForm, Where, growing
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array, wrap_angle, wrap_angles

_SCANS = ("ROBOTLASER1", "FLASER", "RAWLASER1")
"""Of kinds that a log has equally many of, the first is used."""
_RAW = "RAWLASER1"
_OTHER_SCANS = (
    "RLASER", "LASER3", "LASER4", "LASER5", *(f"ROBOTLASER{i}" for i in range(2, 6)),
    *(f"RAWLASER{i}" for i in range(2, 6)),
)  # fmt: skip
_KEYWORDS = {*_SCANS, *_OTHER_SCANS, "ODOM", "PARAM", "SYNC", "TRUEPOS"}
_OFFSET = "robot_frontlaser_offset"
_MOST_BEAMS = 20_000
_LARGEST = 1e10
_FARTHEST_M = 80.0
"""CARMEN's maximum range of a SICK; 81.83 and more are its codes for no return, dazzling, etc."""
_RANGE_MIN_M = 0.05
_SICKS = ((91, math.pi), (181, math.pi), (361, math.pi), (401, math.radians(100.0)))
"""Readings of a SICK, and its field of view."""
_TOP = 0.0015
_TOP_SHARE = 0.01
"""So many of all readings within so little of the longest one are a code, not walls."""
_SAME_OFFSET = 0.01


_Times = tuple[float, float]
"""The IPC's, of the measurement, and the logger's, s; one for both where the other is missing."""


@dataclass(frozen=True)
class _Sweep:
    line: int
    times_s: _Times
    ranges_m: NDArray[np.float32]
    start_rad: float
    step_rad: float
    farthest_m: float
    laser: SE2 | None
    robot: SE2 | None


@dataclass
class _Found:
    """What the lines say."""

    sweeps: dict[str, list[_Sweep]] = field(default_factory=lambda: {kind: [] for kind in _SCANS})
    odometry: list[tuple[int, _Times, SE2]] = field(default_factory=list)
    """Line, times and pose."""
    robots: list[tuple[int, float, float, float]] = field(default_factory=list)
    """Line and pose of the robot, as it is written."""
    offset_m: float | None = None
    others: Counter[str] = field(default_factory=Counter)
    """Lines with scans of other lidars."""

    @property
    def kind(self) -> str:
        """The kind of which there are the most scans; those without a pose of their own count half.
        Empty: there are none.
        """

        def weight(kind: str) -> int:
            return len(self.sweeps[kind]) * (1 if kind == _RAW else 2)

        return max((kind for kind in _SCANS if self.sweeps[kind]), key=weight, default="")

    @property
    def unused(self) -> str:
        """What to say of scans of other kinds and lidars, in one line; empty: there are none."""
        counts = {kind: len(self.sweeps[kind]) for kind in _SCANS if kind != self.kind}
        told = [f"{count} {kind}" for kind, count in (counts | self.others).items() if count]
        if not told:
            return ""
        return f"lines not used: {', '.join(told)}: the scans are those of {self.kind}"


def is_carmen(text: str) -> bool:
    """Whether the begin of a file holds a line of CARMEN."""
    return any(
        line.startswith("# CARMEN") or line.split(maxsplit=1)[0] in _KEYWORDS
        for line in text.splitlines()
        if line.strip()
    )


def read(path: Path, lines: Iterable[str], form: ScanForm) -> Log:
    """Read a log; a last line that is cut off is left out.

    The scans of some logs are not in the order of their times. They are sorted where the odometry
    is a shorter way then; else the file's order holds, also where times are equal, rounded or not
    set: they get times between those of the lines around, and are counted.

    Raises ConfigError with one line that names file, line and value, and what is wrong.
    """
    found, where, damage = _Found(), Where(path, 0), None
    for line in lines:
        where.line += 1
        words = line.split()
        if not words:
            continue
        if damage is not None:
            raise damage
        try:
            _add(found, where, words, whole=line.endswith(("\n", "\r")))
        except ConfigError as error:
            damage = error
    kind = found.kind
    if not kind:
        raise damage or ConfigError(f"--log: {path}: has no line {', '.join(_SCANS)}")
    sweeps = found.sweeps[kind]
    if kind == _RAW and not found.odometry:
        raise ConfigError(f"--log: {path}: has RAWLASER1 without ODOM: must have both")
    _check_headings(path, found)
    place = _base_from_scan(sweeps, found.offset_m)
    entries, retimed = _in_time(sweeps, form, [] if sweeps[0].robot else found.odometry, place)
    assumed = _assumed(sweeps, form) if kind == "FLASER" else ""
    return Log(entries, int(damage is not None), retimed, assumed=assumed, unused=found.unused)


def _add(found: _Found, where: Where, words: list[str], whole: bool) -> None:
    keyword = words[0]
    if keyword == "PARAM" and len(words) > 2 and words[1] == _OFFSET:
        (found.offset_m,) = _numbers(where, _OFFSET, words[2:3])
    elif keyword == "ODOM":
        pose = _robot(found, where, "pose", words[1:4])
        found.odometry.append((where.line, _times_s(where, words[7:10], whole), pose))
    elif keyword == "FLASER":
        ranges, rest = _readings(where, words, 1)
        step, fov = _sick_form(len(ranges))
        laser, robot = _pose(where, "laser", rest[:3]), _robot(found, where, "robot", rest[3:6])
        times_s = _times_s(where, rest[6:9], whole)
        found.sweeps[keyword].append(
            _Sweep(where.line, times_s, ranges, -fov / 2.0, step, _FARTHEST_M, laser, robot)
        )
    elif keyword in _OTHER_SCANS:
        found.others[keyword] += 1
    elif keyword in _SCANS:
        start, fov, step, farthest = _numbers(where, "laser", words[2:6], 4)
        ranges, rest = _readings(where, words, 8)
        (remissions,) = _numbers(where, "num_remissions", rest[:1])
        rest = rest[1 + max(0, int(remissions)) :]
        poses: tuple[SE2, SE2] | tuple[None, None] = (None, None)
        if keyword == "ROBOTLASER1":
            poses = _pose(where, "laser", rest[:3]), _robot(found, where, "robot", rest[3:6])
            rest = rest[11:]
        times_s = _times_s(where, rest[:3], whole)
        if step <= 0.0:
            step = fov / max(1, len(ranges) - 1)
        if not 0.0 < step <= math.pi:
            raise where.wrong(f"angular_resolution: {words[4]!r:.40}: must be radians > 0")
        found.sweeps[keyword].append(
            _Sweep(where.line, times_s, ranges, start, step, farthest, *poses)
        )


def _assumed(sweeps: list[_Sweep], form: ScanForm) -> str:
    """What to say of scans whose angles are a guess, in one line; empty: they are known."""
    if None not in (form.angle_min_rad, form.angle_increment_rad):
        return ""
    known = {beams for whole, _ in _SICKS for beams in (whole - 1, whole)}
    unknown = next((one for one in sweeps if len(one.ranges_m) not in known), None)
    if unknown is None:
        return ""
    return (
        f"line {unknown.line}: FLASER has {len(unknown.ranges_m)} readings and no angles: they are "
        "taken to be of 180 degrees, ahead: --angle-min and --angle-increment say what they are"
    )


def _sick_form(beams: int) -> tuple[float, float]:
    """Angle between two beams and the field of view they are centred in, by their number.

    Of 180, 360 and 400 beams it is the last of 181, 361 and 401 that is missing.
    """
    for whole, fov in _SICKS:
        if beams in (whole, whole - 1):
            return fov / (whole - 1), fov
    return math.pi / max(1, beams - 1), math.pi


def _readings(where: Where, words: list[str], at: int) -> tuple[NDArray[np.float32], list[str]]:
    """The ranges after their number at words[at], and the words after them."""
    (count,) = _numbers(where, "num_readings", words[at : at + 1])
    if count != int(count) or not 1 <= count <= _MOST_BEAMS:
        raise where.wrong(f"num_readings: {words[at]!r:.40}: must be 1 to {_MOST_BEAMS}")
    texts = words[at + 1 : at + 1 + int(count)]
    if len(texts) < count:
        raise where.wrong(f"{len(texts)} readings: must be {int(count)} (num_readings)")
    try:
        return np.array(texts, np.float32), words[at + 1 + int(count) :]
    except ValueError:
        wrong = next(i for i, text in enumerate(texts) if not _is_number(text))
        raise where.wrong(f"reading {wrong}: {texts[wrong]!r:.40}: must be metres") from None


def _pose(where: Where, name: str, texts: list[str]) -> SE2:
    x_m, y_m, yaw_rad = _numbers(where, name, texts, 3)
    return SE2(x_m, y_m, wrap_angle(yaw_rad))


def _robot(found: _Found, where: Where, name: str, texts: list[str]) -> SE2:
    x_m, y_m, yaw_rad = _numbers(where, name, texts, 3)
    found.robots.append((where.line, x_m, y_m, yaw_rad))
    return SE2(x_m, y_m, wrap_angle(yaw_rad))


def _check_headings(path: Path, found: _Found) -> None:
    poses = np.array(found.robots).reshape(-1, 4)
    wrong = first_in_degrees(poses[:, 1:])
    if wrong is not None:
        line, _, _, yaw = found.robots[wrong]
        raise Where(path, line).wrong(f"theta: {yaw:g}: {IN_DEGREES}")


def _times_s(where: Where, texts: list[str], whole: bool) -> _Times:
    """The IPC's time and the logger's; one for both where the other is missing or not set."""
    if len(texts) < 3 and not whole:
        raise where.wrong(f"timestamp: {' '.join(texts)!r:.40}: must have a host and a time after")
    (time_s,) = _numbers(where, "ipc_timestamp", texts[:1])
    if len(texts) < 3:
        return time_s, time_s
    (logged_s,) = _numbers(where, "logger_timestamp", texts[2:3])
    return time_s if time_s > 0.0 else logged_s, logged_s


def _numbers(where: Where, name: str, texts: Sequence[str], count: int = 1) -> list[float]:
    if len(texts) < count:
        raise where.wrong(f"{name}: {' '.join(texts)!r:.40}: must be {count} numbers")
    values = []
    for text in texts[:count]:
        value = float(text) if _is_number(text) else math.nan
        if not abs(value) <= _LARGEST:
            raise where.wrong(f"{name}: {text!r:.40}: must be a finite number")
        values.append(value)
    return values


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _in_time(
    sweeps: list[_Sweep], form: ScanForm, odometry: list[tuple[int, _Times, SE2]], place: SE2
) -> tuple[list[Entry], int]:
    """Entries with times that grow, and how many scans have no time of their own."""
    by_ipc, by_logger = (_steps_on(sweeps, clock) for clock in (0, 1))
    clock = 1 if 2 * by_ipc < len(sweeps) - 1 and by_logger > by_ipc else 0
    ordered = sorted(sweeps, key=lambda sweep: sweep.times_s[clock])
    if ordered != sweeps and (_way(ordered) > _way(sweeps) or _clock_was_set(sweeps, clock)):
        ordered = sweeps
    limit_m = _no_return_m(ordered)
    scans = [_scan(sweep, limit_m, form, place) for sweep in ordered]
    times_s, retimed = growing([sweep.times_s[clock] for sweep in ordered])
    odometry_s, _ = growing([both[clock] for _, both, _ in odometry])
    if odometry and 2 * retimed > len(sweeps):
        # Without times, the order of the lines says which odometry a scan lies between.
        lines = [sweep.line for sweep in ordered] + [line for line, _, _ in odometry]
        raw_s = [sweep.times_s[clock] for sweep in ordered] + [t[clock] for _, t, _ in odometry]
        order = sorted(range(len(lines)), key=lines.__getitem__)
        together, _ = growing([raw_s[i] for i in order])
        placed = dict(zip(order, together, strict=True))
        times_s = [placed[i] for i in range(len(ordered))]
        odometry_s = [placed[i] for i in range(len(ordered), len(lines))]
    entries = [
        Entry(round(time_s * 1e9), sweep.robot, scan)
        for time_s, sweep, scan in zip(times_s, ordered, scans, strict=True)
    ]
    entries += [
        Entry(round(time_s * 1e9), pose, None)
        for time_s, (_, _, pose) in zip(odometry_s, odometry, strict=True)
    ]
    entries.sort(key=lambda entry: (entry.stamp_ns, entry.scan is not None))
    return entries, retimed


def _steps_on(sweeps: list[_Sweep], clock: int) -> int:
    """How many scans are later than the one before, by one of the two clocks."""
    times_s = np.array([sweep.times_s[clock] for sweep in sweeps])
    return int(np.count_nonzero(np.diff(times_s) > 0.0))


def _clock_was_set(sweeps: list[_Sweep], clock: int) -> bool:
    """Whether scans without poses are much later in the file than by their times."""
    if sweeps[0].robot is not None:
        return False
    times_s = np.array([sweep.times_s[clock] for sweep in sweeps])
    return bool(np.any(np.diff(times_s) < -CLOCK_SET_S))


def _way(sweeps: list[_Sweep]) -> float:
    """Metres and radians from pose to pose, summed up; 0 where the scans have no poses."""
    poses = np.array([sweep.robot for sweep in sweeps if sweep.robot is not None])
    if not len(poses):
        return 0.0
    steps = np.diff(poses, axis=0)
    turns = wrap_angles(steps[:, 2])
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum() + np.abs(turns).sum())


def _no_return_m(sweeps: list[_Sweep]) -> float:
    """Readings from here on are codes for no return, in all scans."""
    values = np.concatenate([sweep.ranges_m for sweep in sweeps])
    values = values[np.isfinite(values)]
    if not len(values):
        return _FARTHEST_M
    top = float(values.max()) * (1.0 - _TOP)
    if np.count_nonzero(values >= top) < _TOP_SHARE * len(values):
        return _FARTHEST_M
    return min(_FARTHEST_M, top)


def _scan(sweep: _Sweep, limit_m: float, form: ScanForm, place: SE2) -> LoggedScan:
    """A SICK's no return may be dark or dazzled: it measured nothing, not even free space."""
    farthest = min(limit_m, sweep.farthest_m) if sweep.farthest_m > 0.0 else limit_m
    ranges = sweep.ranges_m.copy()
    with np.errstate(invalid="ignore"):
        ranges[~((ranges > 0.0) & (ranges < farthest))] = np.nan
    least, longest = form.ranges_m(_RANGE_MIN_M, farthest)
    return LoggedScan(
        ranges,
        sweep.start_rad if form.angle_min_rad is None else form.angle_min_rad,
        sweep.step_rad if form.angle_increment_rad is None else form.angle_increment_rad,
        least,
        longest,
        base_from_scan=place,
    )


def _base_from_scan(sweeps: list[_Sweep], offset_m: float | None) -> SE2:
    """The laser's pose on the robot: between the two poses of a line where it is always the same.

    In a log whose laser poses were corrected afterwards, or that has none, it is what PARAM says.
    """
    between: Array = np.array(
        [s.robot.inverse() @ s.laser for s in sweeps if s.robot is not None and s.laser is not None]
    ).reshape(-1, 3)
    if len(between) and (np.ptp(between, axis=0) <= _SAME_OFFSET).all():
        middle = SE2(*np.median(between, axis=0).tolist())
        if any(abs(value) > 1e-6 for value in middle):
            return middle
    return SE2(offset_m or 0.0, 0.0, 0.0)
